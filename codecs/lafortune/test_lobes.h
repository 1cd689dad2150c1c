/* SPDX-License-Identifier: MIT */
/* test_lobes.h: planted materials, and a model of the lobes in double that owes the codec nothing. */
#ifndef LAFORTUNE_TEST_LOBES_H
#define LAFORTUNE_TEST_LOBES_H

#include "codec_suite.h"

#include "lafortune.h"

/* Uniform in 0 .. 1, the same in every run. */
double test_random(void);
void test_seed(uint64_t seed);
void test_random_direction(float d[3]);

/* Lobes of one texel and channel group, in the terms of the papers: shapes as docs/codecs/lafortune.md has
 * them. */
typedef struct planted {
  uint32_t kind, lobes, channels;
  double shape[LAF_MAX_LOBES][LAF_MAX_SHAPE];
  double albedo[LAF_MAX_ALBEDOS][8];
} planted;

/* The lobe itself, without albedo or cosine. */
double planted_lobe(uint32_t kind, const double *shape, const float *light, const float *view);
double planted_value(const planted *p, uint32_t channel, const float *light, const float *view);

/* One ABRDF: pairs (view, light, channel) as the codec takes them. */
typedef struct abrdf {
  btf_dirset *directions;
  uint32_t count, channels;
  const float *xyz;
  float *values;
} abrdf;
abrdf abrdf_create(btf_context *ctx, const char *directions, uint32_t channels);
void abrdf_fill(abrdf *a, const planted *p, double noise);
void abrdf_release(abrdf *a);

/* A fitter of single ABRDFs. */
typedef struct fitter {
  btf_context *ctx;
  btfi_lafortune_shared *shared;
  void *memory;
  btfi_lafortune_scratch *scratch;
  btfi_lafortune_settings settings;
} fitter;
fitter fitter_create(btf_context *ctx, const abrdf *a, uint32_t kind, uint32_t weights, uint32_t lobes,
                     uint32_t quantity);
void fitter_release(fitter *f);

/* A data set with a planted lobe model at each texel, which varies over the texture. */
typedef struct material {
  btf_dataset *ds;
  btf_dirset *directions;
  uint32_t count, width, height, channels;
  float *samples; /* owned by ds; texel-major */
} material;
typedef void (*plant_fn)(uint32_t x, uint32_t y, planted *out);
material material_create(btf_context *ctx, plant_fn plant, double noise, const char *directions,
                         uint32_t width, uint32_t height, uint32_t channels, uint32_t quantity,
                         uint32_t wrap);
void material_release(material *m);
float material_sample(const material *m, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                      uint32_t channel);
double material_energy(const material *m);
/* Two diagonal lobes, coarse changes over the texture; the channels have different colours. */
void plant_two_lobes(uint32_t x, uint32_t y, planted *out);

btf_status lafortune_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings,
                             const btf_job *job, btf_model **out);
btf_model *lafortune_fit(btf_context *ctx, const material *m, const char *settings);
double lafortune_squared_error(const btf_model *model, const material *m);
const btfi_lafortune_state *lafortune_state(const btf_model *model);

#endif
