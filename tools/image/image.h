/* SPDX-License-Identifier: MIT */
/*
 * image.h: pictures of linear RGB floats (Rec.709 primaries), and the files they come from and go to.
 *
 * The first row in memory is the top of the picture. Functions that return an exit status have printed their
 * line when it is not EXIT_DONE. Files are written beside their place and renamed.
 */
#ifndef BTF_TOOLS_IMAGE_H
#define BTF_TOOLS_IMAGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct image {
  uint32_t width, height;
  float *rgb; /* 3 * width * height */
} image;

/* Black. At most 65535 pixels along a side and 2^28 in all. */
int image_create(image *out, uint32_t width, uint32_t height);
void image_free(image *picture);
static inline float *image_pixel(const image *picture, uint32_t x, uint32_t y) {
  return picture->rgb + 3 * ((uint64_t)y * picture->width + x);
}
void image_fill(image *picture, const float rgb[3]);
/* Copies `source` to (x, y), cut at the borders. */
void image_paste(image *picture, const image *source, uint32_t x, uint32_t y);
/* The same picture with every pixel repeated `times` times along both axes. */
int image_enlarge(const image *source, uint32_t times, image *out);

/* Whether a path ends with .png or .exr, be it in capitals. */
bool image_path_is_known(const char *path);
/* Writes by the ending of the path: .exr, or else .png. */
int image_write(const image *picture, const char *path);
/* sRGB, clipped to 0..1, `bits` 8 or 16. */
int image_write_png(const image *picture, const char *path, uint32_t bits);
/* Linear, scan lines, ZIP; half floats (clipped to their range) or floats. */
int image_write_exr(const image *picture, const char *path, bool half);
/* Reads OpenEXR (R, G, B or Y; flat parts) or Radiance .hdr, told apart by content. NaN, infinite and
 * negative values become 0; *repaired, which may be NULL, counts them. */
int image_read(const char *path, image *out, uint64_t *repaired);

/* ---- tone (tone.c) ---- */

float tone_to_srgb(float linear); /* 0..1 to 0..1, clips */
float tone_from_srgb(float encoded);

enum {
  TONE_CLIP = 0,  /* exposure alone: values in 0..1 stay as they are */
  TONE_FILMIC = 1 /* highlights roll off: a rational curve on each channel with slope 1 at 0, white at 4 */
};
/* Multiplies by 2^stops, then applies the curve in place. */
void tone_map(image *picture, double stops, int curve);
/* The value that `fraction` of all channel values are at or below. */
float tone_percentile(const image *picture, double fraction);

/* ---- labels (font.c) ---- */

enum { FONT_WIDTH = 6, FONT_HEIGHT = 8 }; /* of one character with its gap, at scale 1 */
/* How many characters of a text to draw in a row with room for `room` (at least 1), so that it breaks after a
 * word or sign if it can. */
size_t font_break(const char *text, size_t room);
/* Writes text with its top left corner at (x, y). Characters beyond ASCII show as '?'. */
void font_draw(image *picture, int64_t x, int64_t y, uint32_t scale, const float rgb[3], const char *text);

#endif
