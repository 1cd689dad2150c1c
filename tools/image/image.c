/* SPDX-License-Identifier: MIT */
/* image.c: pictures in memory, and reading by content. */
#include "image.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "../cli.h"
#include "../output_file.h"
#include "image_files.h"

enum { most_file_bytes = 1 << 30 };

int image_create(image *out, uint32_t width, uint32_t height) {
  memset(out, 0, sizeof *out);
  if (width < 1 || height < 1 || width > 65535 || height > 65535 ||
      (uint64_t)width * height > UINT64_C(1) << 28)
    return cli_fail(EXIT_LIMIT, "picture of %u x %u pixels: at most 65535 along a side and 2^28 in all",
                    (unsigned)width, (unsigned)height);
  out->rgb = calloc((size_t)width * height, 3 * sizeof(float));
  if (out->rgb == NULL) return cli_out_of_memory();
  out->width = width;
  out->height = height;
  return EXIT_DONE;
}

void image_free(image *picture) {
  free(picture->rgb);
  memset(picture, 0, sizeof *picture);
}

void image_fill(image *picture, const float rgb[3]) {
  const size_t pixels = (size_t)picture->width * picture->height;
  for (size_t i = 0; i < pixels; i++) memcpy(picture->rgb + 3 * i, rgb, 3 * sizeof *rgb);
}

void image_paste(image *picture, const image *source, uint32_t x, uint32_t y) {
  if (x >= picture->width) return;
  for (uint32_t row = 0; row < source->height && (uint64_t)y + row < picture->height; row++) {
    const uint32_t room = picture->width - x;
    const uint32_t width = source->width < room ? source->width : room;
    memcpy(image_pixel(picture, x, y + row), image_pixel(source, 0, row), 3 * sizeof(float) * width);
  }
}

int image_enlarge(const image *source, uint32_t times, image *out) {
  int failed;
  if ((uint64_t)source->width * times > 65535 || (uint64_t)source->height * times > 65535) times = 1;
  failed = image_create(out, source->width * times, source->height * times);
  if (failed) return failed;
  for (uint32_t y = 0; y < out->height; y++)
    for (uint32_t x = 0; x < out->width; x++)
      memcpy(image_pixel(out, x, y), image_pixel(source, x / times, y / times), 3 * sizeof(float));
  return EXIT_DONE;
}

bool image_path_is_known(const char *path) {
  return output_ends_with(path, ".png") || output_ends_with(path, ".exr");
}

int image_write(const image *picture, const char *path) {
  if (output_ends_with(path, ".exr")) return image_write_exr(picture, path, false);
  return image_write_png(picture, path, 8);
}

static int read_whole(const char *path, image_bytes *out) {
  FILE *stream = fopen(path, "rbe");
  struct stat info;
  int failed = EXIT_DONE;
  memset(out, 0, sizeof *out);
  out->path = path;
  if (stream == NULL) return cli_fail(EXIT_IO, "%s: could not be opened: %s", path, strerror(errno));
  if (fstat(fileno(stream), &info) != 0 || !S_ISREG(info.st_mode))
    failed = cli_fail(EXIT_IO, "%s: is not a regular file", path);
  else if (info.st_size > most_file_bytes)
    failed = cli_fail(EXIT_LIMIT, "%s: larger than 1 GiB, the most a picture may have", path);
  if (!failed) {
    out->data = malloc((size_t)info.st_size + 1);
    if (out->data == NULL) failed = cli_out_of_memory();
  }
  if (!failed) {
    out->size = fread(out->data, 1, (size_t)info.st_size, stream);
    if (ferror(stream)) failed = cli_fail(EXIT_IO, "%s: could not be read: %s", path, strerror(errno));
  }
  fclose(stream);
  return failed;
}

int image_read(const char *path, image *out, uint64_t *repaired) {
  static const unsigned char exr_magic[4] = {0x76, 0x2f, 0x31, 0x01};
  image_bytes file;
  uint64_t count = 0;
  int failed = read_whole(path, &file);
  memset(out, 0, sizeof *out);
  if (!failed) {
    if (file.size >= 4 && memcmp(file.data, exr_magic, 4) == 0)
      failed = image_decode_exr(&file, out);
    else if (file.size >= 2 && memcmp(file.data, "#?", 2) == 0)
      failed = image_decode_hdr(&file, out);
    else
      failed = cli_fail(EXIT_MALFORMED, "%s: neither an OpenEXR nor a Radiance .hdr file", path);
  }
  free(file.data);
  if (failed) {
    image_free(out);
    return failed;
  }
  for (size_t i = 0; i < (size_t)out->width * out->height * 3; i++) {
    if (out->rgb[i] >= 0 && isfinite(out->rgb[i])) continue;
    out->rgb[i] = 0;
    count++;
  }
  if (repaired != NULL) *repaired = count;
  return EXIT_DONE;
}
