/* SPDX-License-Identifier: MIT */
#include "codec_suite.h"

btf_status suite_options(btf_context *ctx, const char *codec, const char *settings, btf_options **out) {
  char text[512], *rest = NULL;
  assert_true(strlen(settings) < sizeof text);
  strcpy(text, settings);
  btf_status status = btf_options_create(btf_codec_find(ctx, codec), out);
  for (char *word = strtok_r(text, " ", &rest); word != NULL && status == BTF_OK;
       word = strtok_r(NULL, " ", &rest)) {
    char *value = strchr(word, '=');
    assert_non_null(value);
    *value++ = '\0';
    status = btf_options_set(*out, word, value);
    if (status == BTF_OK) continue;
    btf_options_release(*out);
    *out = NULL;
  }
  return status;
}

btf_status suite_try_fit(btf_context *ctx, const char *codec, const btf_dataset *ds, const char *settings,
                         const btf_job *job, btf_model **out) {
  btf_options *options;
  *out = NULL;
  btf_status status = suite_options(ctx, codec, settings, &options);
  if (status != BTF_OK) return status;
  status = btf_model_fit(ds, btf_codec_find(ctx, codec), options, job, out);
  btf_options_release(options);
  return status;
}

btf_model *suite_fit(btf_context *ctx, const char *codec, const btf_dataset *ds, const char *settings) {
  btf_model *model;
  assert_ok(suite_try_fit(ctx, codec, ds, settings, NULL, &model));
  return model;
}

btf_batch suite_batch(const btf_query *queries, size_t count, uint32_t flags, float *const column[9]) {
  btf_batch batch = BTF_BATCH_INIT;
  for (size_t i = 0; i < count; i++) {
    for (int k = 0; k < 3; k++) {
      column[k][i] = queries[i].light[k];
      column[3 + k][i] = queries[i].view[k];
    }
    for (int k = 0; k < 2; k++) column[6 + k][i] = queries[i].uv[k];
    column[8][i] = queries[i].lod;
  }
  for (int k = 0; k < 3; k++) {
    batch.light[k] = column[k];
    batch.view[k] = column[3 + k];
  }
  for (int k = 0; k < 2; k++) batch.uv[k] = column[6 + k];
  batch.lod = column[8];
  batch.count = count;
  batch.flags = flags;
  return batch;
}

/* Columns end with the batch, so that a sanitizer sees reads beyond it. */
void suite_eval_batch(const btf_model *model, const btf_query *queries, size_t count, uint32_t flags,
                      float **out) {
  float *column[9];
  for (int k = 0; k < 9; k++) {
    column[k] = malloc(count > 0 ? count * sizeof(float) : 1);
    assert_non_null(column[k]);
  }
  const btf_batch batch = suite_batch(queries, count, flags, column);
  btf_model_eval_n(model, &batch, BTF_VALUE_STORED, out);
  for (int k = 0; k < 9; k++) free(column[k]);
}

int suite_compare_floats(const void *a, const void *b) {
  const float x = *(const float *)a, y = *(const float *)b;
  return (x > y) - (x < y);
}

double suite_peak(const float *samples, size_t count) {
  float *sorted = malloc(count * sizeof *sorted);
  assert_non_null(sorted);
  memcpy(sorted, samples, count * sizeof *sorted);
  qsort(sorted, count, sizeof *sorted, suite_compare_floats);
  const double peak = (double)sorted[count - 1 - count / 1000];
  free(sorted);
  return peak;
}

static void count_warnings(void *user, int32_t level, btf_status code, const char *message) {
  suite_warnings *warnings = user;
  (void)code;
  warnings->count += level == BTF_LOG_WARNING && strstr(message, warnings->words) != NULL;
}

btf_context *suite_context_counting(suite_warnings *warnings) {
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  desc.log = count_warnings;
  desc.log_user = warnings;
  assert_ok(btf_context_create(&desc, &ctx));
  return ctx;
}
