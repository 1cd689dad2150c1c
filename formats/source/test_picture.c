/* SPDX-License-Identifier: MIT */
#include <stdio.h>
#include <stdlib.h>

#include <jpeglib.h>

#include "test_picture.h"

unsigned char *test_squares_jpeg(int width, int height, int channels, test_code_fn code, const void *user,
                                 size_t *size) {
  struct jpeg_compress_struct jpeg;
  struct jpeg_error_mgr errors;
  unsigned char *data = NULL, *line = malloc((size_t)width * (size_t)channels);
  unsigned long bytes = 0;
  if (line == NULL) abort();
  jpeg.err = jpeg_std_error(&errors);
  jpeg_create_compress(&jpeg);
  jpeg_mem_dest(&jpeg, &data, &bytes);
  jpeg.image_width = (JDIMENSION)width;
  jpeg.image_height = (JDIMENSION)height;
  jpeg.input_components = channels;
  jpeg.in_color_space = channels == 3 ? JCS_RGB : JCS_GRAYSCALE;
  jpeg_set_defaults(&jpeg);
  jpeg_set_colorspace(&jpeg, jpeg.in_color_space);
  jpeg_set_quality(&jpeg, 100, TRUE);
  jpeg_start_compress(&jpeg, TRUE);
  for (int row = 0; row < height; row++) {
    for (int i = 0; i < width * channels; i++) line[i] = code(user, i / channels / 8, row / 8, i % channels);
    JSAMPROW lines[1] = {line};
    (void)jpeg_write_scanlines(&jpeg, lines, 1);
  }
  jpeg_finish_compress(&jpeg);
  jpeg_destroy_compress(&jpeg);
  free(line);
  *size = bytes;
  return data;
}
