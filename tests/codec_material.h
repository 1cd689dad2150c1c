/* SPDX-License-Identifier: MIT */
/* codec_material.h: small materials that every codec is tried on, given by a formula. For tests and fuzz
 * targets. */
#ifndef CODEC_MATERIAL_H
#define CODEC_MATERIAL_H

#include <btf/btf.h>

enum {
  MATERIAL_SMOOTH,   /* odd sizes, lights and views differ */
  MATERIAL_TEXEL,    /* one texel */
  MATERIAL_ROW,      /* one texel high */
  MATERIAL_PAIR,     /* one light and one view */
  MATERIAL_CONSTANT, /* the same value everywhere */
  MATERIAL_ZERO,     /* black */
  MATERIAL_BRIGHT,   /* values up to about 1e4 */
  MATERIAL_DARK,     /* values up to about 1e-4 */
  MATERIAL_COSINE,   /* holds f times the cosine of the light */
  MATERIAL_CLAMPED,  /* not periodic */
  MATERIAL_TINY,     /* for loops that fit it thousands of times */
  MATERIAL_LARGE,    /* of 2.8 million samples for three channels, for memory budgets */
  MATERIALS
};

typedef struct codec_material {
  const char *name, *lights, *views; /* named direction sets */
  uint32_t width, height, quantity, wrap;
  float least, contrast, gloss; /* f = least + contrast * texture + gloss * texture * lobe */
} codec_material;
extern const codec_material codec_materials[MATERIALS];

/* Value of the formula. */
float codec_material_value(const codec_material *m, const float light[3], const float view[3], uint32_t x,
                           uint32_t y, uint32_t channel);

enum {
  SOURCE_RESIDENT,  /* texel-major in memory */
  SOURCE_IMAGES,    /* read block by block, images cheap */
  SOURCE_CONCURRENT /* read block by block, from several threads */
};
typedef struct codec_dataset_recipe {
  uint32_t material, channels, source;
  /* 0, or 1 + the number of the sample, in the order of memory, that is `odd` instead. */
  uint64_t odd_sample;
  float odd;
  float scale; /* what samples are multiplied by; 0 = 1 */
} codec_dataset_recipe;
btf_status codec_material_dataset(btf_context *ctx, const codec_dataset_recipe *recipe, btf_dataset **out);
/* Samples of a material. */
uint64_t codec_material_samples(uint32_t material, uint32_t channels);

#endif
