/* SPDX-License-Identifier: MIT */
/* test_materials.h: data sets and fits for the suites of this codec. */
#ifndef FMF_TEST_MATERIALS_H
#define FMF_TEST_MATERIALS_H

#include "codec_suite.h"

#include "fmf.h"

/* A data set with its samples beside it, texel-major or image-major in memory. */
typedef struct material {
  btf_dataset *ds;
  btf_dirset *directions; /* lights and views */
  uint32_t count, width, height, channels;
  bool image_major;
  float *samples; /* owned by ds */
} material;

enum { MATERIAL_GLOSSY, MATERIAL_RANK_5, MATERIAL_CONSTANT, MATERIAL_TEXTURED_LAMBERT };

/* directions as btf_dirset_create_named takes them, or "one". */
material material_create(btf_context *ctx, int kind, const char *directions, uint32_t width, uint32_t height,
                         uint32_t channels, bool image_major, uint32_t wrap);
void material_release(material *m);
float material_sample(const material *m, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                      uint32_t channel);
double material_energy(const material *m);

/* Options as "name=value name=value". */
btf_status fmf_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings, const btf_job *job,
                       btf_model **out);
btf_model *fmf_fit(btf_context *ctx, const material *m, const char *settings);
/* Squared Frobenius error of a model, by decoding every sample. */
double fmf_squared_error(const btf_model *model, const material *m);
const btfi_fmf_state *fmf_state(const btf_model *model);
/* Saves the model, loads it in another context. */
btf_model *fmf_reload(const btf_model *model, btf_context *ctx);

/* Uniform in 0 .. 1, the same in every run. */
float test_random(void);
void test_random_direction(float d[3]);

#endif
