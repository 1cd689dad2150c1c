/* SPDX-License-Identifier: MIT */
/* test_cmf_fits.h: materials, fits and errors that the suites of the codec share. */
#ifndef TEST_CMF_FITS_H
#define TEST_CMF_FITS_H

#include "cmf.h"

#include "codec_suite.h"
#include "model/model.h"

float cmf_draw(void);
void cmf_draw_direction(float d[3]);

enum { BUMPS, ZERO, CONSTANT, ROTATED };

typedef struct material {
  btf_dataset *ds;
  btf_dirset *set;
  uint32_t count, width, height, channels;
  float *samples; /* [y][x][view][light][channel], owned by ds */
} material;

/* `directions`: a named set for lights and views, or "one". */
material material_create(btf_context *ctx, int kind, const char *directions, uint32_t width, uint32_t height,
                         uint32_t channels);
void material_release(material *m);

/* Options as in "codebook=8 levels=1". */
btf_status cmf_try_fit(btf_context *ctx, const material *m, const char *settings, const btf_job *job,
                       btf_model **out);
btf_model *cmf_fit(btf_context *ctx, const material *m, const char *settings);

double sample_count(const material *m);
/* Of the decoded finest level. */
double squared_error(const btf_model *model, const material *m);
double relative_error(const btf_model *model, const material *m);

static inline const btfi_cmf_state *state_of(const btf_model *model) {
  return model->state;
}

/* Settings that between them reach every storage, method and kind of codebook. */
enum { CMF_CASES = 8 };
extern const char *const cmf_cases[CMF_CASES];
/* One of them with more options; `of_stages` are those that homomorphic factors do not have. */
void cmf_case_with(size_t index, const char *of_stages, const char *others, char *text, size_t size);

#endif
