/* SPDX-License-Identifier: MIT */
/* relight.h: a folder of info.json and pictures plane_0.jpg, plane_1.jpg ..., whose channels are planes of
 * coefficients. */
#ifndef BTF_FORMATS_RELIGHT_H
#define BTF_FORMATS_RELIGHT_H

#include "source/one_view.h"

enum {
  RELIGHT_MOST_PLANES = 128,
  RELIGHT_MOST_IMAGES = (RELIGHT_MOST_PLANES + 2) / 3,
  RELIGHT_MOST_SAMPLES = 4096
};

typedef enum relight_type { RELIGHT_PTM, RELIGHT_HSH, RELIGHT_RBF, RELIGHT_BILINEAR } relight_type;
typedef enum relight_colour { RELIGHT_RGB, RELIGHT_LRGB, RELIGHT_MRGB, RELIGHT_MYCC } relight_colour;

typedef struct relight_file {
  one_view map;
  relight_type type;
  relight_colour colour;
  uint32_t plane_count, image_count;
  uint32_t terms;  /* of the formula, for a colour */
  uint32_t chroma; /* planes of each chroma */
  double scale[RELIGHT_MOST_PLANES], bias[RELIGHT_MOST_PLANES], range[RELIGHT_MOST_PLANES];
  double sigma;
  uint32_t resolution;
  uint32_t samples;                           /* lights that the basis has values for */
  double *lights;                             /* of the samples, x y z */
  unsigned char *basis;                       /* [plane, the first of which is the mean][sample][3] */
  unsigned char *planes[RELIGHT_MOST_IMAGES]; /* rows from the bottom, three bytes a texel */
} relight_file;

/* Reads info.json, and materials.bin where it is needed. */
btf_status relight_read_info(relight_file *r);
/* Decodes all planes, after a look at the head of each. */
btf_status relight_read_planes(relight_file *r);

#endif
