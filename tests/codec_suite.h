/* SPDX-License-Identifier: MIT */
/* codec_suite.h: what the suites of the single codecs share: fits by options in one line, batches, the peak
 * that a PSNR is told of, warnings. */
#ifndef CODEC_SUITE_H
#define CODEC_SUITE_H

#include "btf_test.h"

/* Options as "name=value name=value", and a model with them. */
btf_status suite_options(btf_context *ctx, const char *codec, const char *settings, btf_options **out);
btf_status suite_try_fit(btf_context *ctx, const char *codec, const btf_dataset *ds, const char *settings,
                         const btf_job *job, btf_model **out);
btf_model *suite_fit(btf_context *ctx, const char *codec, const btf_dataset *ds, const char *settings);

/* Queries as a batch, whose columns (light, view, uv, lod) are filled; flags stand instead of their own. */
btf_batch suite_batch(const btf_query *queries, size_t count, uint32_t flags, float *const column[9]);
/* The stored quantity of such a batch: out[channel][query]. */
void suite_eval_batch(const btf_model *model, const btf_query *queries, size_t count, uint32_t flags,
                      float **out);

/* The 99.9th percentile, by sorting a copy. */
double suite_peak(const float *samples, size_t count);
int suite_compare_floats(const void *a, const void *b); /* for qsort */

/* A context whose log counts the warnings with these words in them; both may be changed between fits. */
typedef struct suite_warnings {
  const char *words;
  int count;
} suite_warnings;
btf_context *suite_context_counting(suite_warnings *warnings);

#endif
