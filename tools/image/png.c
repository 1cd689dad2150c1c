/* SPDX-License-Identifier: MIT */
/* png.c: writes PNG through libpng. */
#include <png.h>
#include <setjmp.h>
#include <stdlib.h>

#include "../cli.h"
#include "../output_file.h"
#include "image.h"

static void on_error(png_structp png, png_const_charp message) {
  (void)message;
  longjmp(png_jmpbuf(png), 1);
}
static void on_warning(png_structp png, png_const_charp message) {
  (void)png;
  (void)message;
}

static void encode_row(const image *picture, uint32_t y, uint32_t bits, unsigned char *row) {
  const float *values = image_pixel(picture, 0, y);
  const size_t count = (size_t)picture->width * 3;
  for (size_t i = 0; i < count; i++) {
    const float coded = tone_to_srgb(values[i]);
    if (bits == 8) {
      row[i] = (unsigned char)(coded * 255 + 0.5f);
    } else {
      const unsigned wide = (unsigned)(coded * 65535 + 0.5f);
      row[2 * i] = (unsigned char)(wide >> 8);
      row[2 * i + 1] = (unsigned char)(wide & 255);
    }
  }
}

/* The stream's own error state tells a full disk; false also when libpng runs out of memory. */
static bool encode(const image *picture, uint32_t bits, FILE *stream, unsigned char *row) {
  png_infop info;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, on_error, on_warning);
  if (png == NULL) return false;
  info = png_create_info_struct(png);
  if (info == NULL || setjmp(png_jmpbuf(png))) {
    png_destroy_write_struct(&png, info != NULL ? &info : NULL);
    return false;
  }
  png_init_io(png, stream);
  png_set_IHDR(png, info, picture->width, picture->height, (int)bits, PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_set_sRGB_gAMA_and_cHRM(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
  png_write_info(png, info);
  for (uint32_t y = 0; y < picture->height; y++) {
    encode_row(picture, y, bits, row);
    png_write_row(png, row);
  }
  png_write_end(png, NULL);
  png_destroy_write_struct(&png, &info);
  return true;
}

int image_write_png(const image *picture, const char *path, uint32_t bits) {
  output_file out;
  unsigned char *row = malloc((size_t)picture->width * 6);
  int failed;
  if (row == NULL) return cli_out_of_memory();
  failed = output_open(&out, path);
  if (!failed && !encode(picture, bits, out.stream, row) && !ferror(out.stream)) {
    failed = cli_fail(EXIT_LIMIT, "%s: the PNG encoder ran out of memory", path);
    output_abort(&out);
  }
  free(row);
  return failed ? failed : output_commit(&out);
}
