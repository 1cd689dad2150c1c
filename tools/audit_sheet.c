/* SPDX-License-Identifier: MIT */
/* audit_sheet.c: the tables of the audit as pictures. */
#include <math.h>

#include "audit_parts.h"
#include "image/image.h"

enum { GAP = 8, LABEL = 16 };
/* An error of this |log| and more is white: a factor of e. */
static const double white_error = 1;

static float shade(const sample_source *s, const audit *a, int picture, double largest, uint32_t light,
                   uint32_t view) {
  const double here = a->mean[(size_t)view * s->lights + light];
  uint32_t light_there, view_there;
  if (picture == 0) return (float)fmax(0, here / largest);
  if (!audit_exchanged(s, light, view, &light_there, &view_there)) return 0;
  const double there = a->mean[(size_t)view_there * s->lights + light_there];
  const float *lights = btf_dirset_directions(s->light_set);
  if (!(here > 0) || !(there > 0)) return 0;
  double ratio = log(here / there);
  if (picture == 2) ratio -= log((double)lights[3 * light + 2] / (double)lights[3 * light_there + 2]);
  return tone_from_srgb((float)fmin(1, fabs(ratio) / white_error));
}

int audit_write_sheet(const sample_source *source, const audit *a, const char *path) {
  static const char *const labels[] = {"mean: views down, lights across", "reciprocity error as stored",
                                       "with the cosine divided out"};
  static const float ink[3] = {0.8f, 0.8f, 0.8f};
  const uint32_t longer = source->lights > source->views ? source->lights : source->views;
  const uint32_t times = longer < 240 ? 240 / longer : 1;
  const uint32_t width = source->lights * times, height = source->views * times;
  const uint32_t column = width > 200 ? width : 200;
  image sheet;
  double largest = 0;
  for (size_t i = 0; i < (size_t)source->views * source->lights; i++) largest = fmax(largest, a->mean[i]);
  int failed = image_create(&sheet, 3 * (column + GAP) + GAP, height + LABEL + GAP);
  if (failed) return failed;
  for (uint32_t p = 0; p < 3; p++) {
    const uint32_t left = GAP + p * (column + GAP);
    font_draw(&sheet, left, 4, 1, ink, labels[p]);
    for (uint32_t y = 0; y < height; y++)
      for (uint32_t x = 0; x < width; x++) {
        const float value = shade(source, a, (int)p, largest > 0 ? largest : 1, x / times, y / times);
        float *pixel = image_pixel(&sheet, left + x, LABEL + y);
        pixel[0] = pixel[1] = pixel[2] = value;
      }
  }
  failed = image_write(&sheet, path);
  image_free(&sheet);
  return failed;
}
