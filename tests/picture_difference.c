/* SPDX-License-Identifier: MIT */
/* Compares two PNG files pixel by pixel where either shows something else than the corner of the first.
 * Usage: picture_difference A.png B.png LIMIT. Ends with 0 if the mean difference of 8-bit values is at most
 * LIMIT. */
#include <png.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static unsigned char *read_rgb(const char *path, uint32_t *width, uint32_t *height) {
  png_image png = {.version = PNG_IMAGE_VERSION};
  if (!png_image_begin_read_from_file(&png, path)) return NULL;
  png.format = PNG_FORMAT_RGB;
  unsigned char *rgb = malloc(PNG_IMAGE_SIZE(png));
  if (rgb == NULL || !png_image_finish_read(&png, NULL, rgb, 0, NULL)) {
    png_image_free(&png);
    free(rgb);
    return NULL;
  }
  *width = png.width;
  *height = png.height;
  return rgb;
}

int main(int argc, char **argv) {
  uint32_t width = 0, height = 0, other_width = 0, other_height = 0;
  double sum = 0.0;
  size_t values = 0;
  if (argc != 4) return 2;
  unsigned char *a = read_rgb(argv[1], &width, &height), *b = read_rgb(argv[2], &other_width, &other_height);
  if (a == NULL || b == NULL || width != other_width || height != other_height) {
    fprintf(stderr, "%s and %s are no pictures of one size\n", argv[1], argv[2]);
    free(a);
    free(b);
    return 2;
  }
  for (size_t i = 0; i < 3 * (size_t)width * height; i += 3) {
    if (memcmp(a + i, a, 3) == 0 && memcmp(b + i, a, 3) == 0) continue;
    for (size_t c = 0; c < 3; c++) sum += abs(a[i + c] - b[i + c]);
    values += 3;
  }
  free(a);
  free(b);
  if (values > 0) sum /= (double)values;
  printf("mean difference %.3f of 255 over %zu pixels\n", sum, values / 3);
  return values > 0 && sum <= strtod(argv[3], NULL) ? 0 : 1;
}
