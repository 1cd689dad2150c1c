/* SPDX-License-Identifier: MIT */
/* Evaluation: whatever the bits of a query, results are finite, a batch gives what single calls give bit for
 * bit, and sampling gives weights that can be used. Models of every kind are made once. */
#include "fuzz.h"

#include <math.h>

#include "codec_cases.h"
#include "copy_codec.h"

enum { MOST_QUERIES = 80, MODELS_MAX = 64, CHANNELS_MAX = 4 };

/* Of the leak checker, where there is one. */
extern void __lsan_disable(void) __attribute__((weak));
extern void __lsan_enable(void) __attribute__((weak));

static btf_model *models[MODELS_MAX];
static uint32_t model_count;

static void keep(btf_model *model) {
  fuzz_expect(model != NULL && model_count < MODELS_MAX);
  models[model_count++] = model;
}

static void fit(const btf_dataset *ds, const btf_codec *codec, const char *storage, const char *coding) {
  btf_options *options;
  btf_model *model;
  fuzz_expect(btf_options_create(codec, &options) == BTF_OK);
  if (storage != NULL) {
    fuzz_expect(btf_options_set(options, "storage", storage) == BTF_OK);
    fuzz_expect(btf_options_set(options, "coding", coding) == BTF_OK);
    fuzz_expect(btf_options_set(options, "components", "5") == BTF_OK);
  }
  fuzz_expect(btf_model_fit(ds, codec, options, NULL, &model) == BTF_OK);
  btf_options_release(options);
  keep(model);
}

static void set_up(void) {
  btf_context *ctx = fuzz_context((uint64_t)256 << 20);
  btf_model *raw;
  fuzz_expect(btf_context_register(ctx, &copy_codec) == BTF_OK);
  fuzz_expect(btf_context_register(ctx, &copy_codec_single) == BTF_OK);
  btf_dataset *rgb = copy_codec_dataset(ctx, 7, 5, 3, BTF_QUANTITY_BRDF);
  btf_dataset *grey = copy_codec_dataset(ctx, 1, 8, 1, BTF_QUANTITY_BRDF_COS);
  fuzz_expect(rgb != NULL && grey != NULL);
  fuzz_expect(btf_model_from_dataset(rgb, NULL, &raw) == BTF_OK);
  keep(raw);
  fuzz_expect(btf_model_from_dataset(grey, NULL, &raw) == BTF_OK);
  keep(raw);
  fit(rgb, btf_codec_find(ctx, "org.libbtf.copy"), NULL, NULL);
  fit(grey, btf_codec_find(ctx, "org.libbtf.copy1"), NULL, NULL);
  const btf_codec *fmf = btf_codec_find(ctx, "fmf");
  if (fmf != NULL) {
    fit(rgb, fmf, "f32", "packed");
    fit(rgb, fmf, "f16", "plain");
    fit(rgb, fmf, "bf16", "packed");
    fit(grey, fmf, "q8", "plain");
    fit(grey, fmf, "f16", "packed");
  }
  for (size_t i = 0; i < codec_case_count; i++) {
    const codec_case *row = &codec_cases[i];
    const codec_dataset_recipe recipe = {
        MATERIAL_SMOOTH, codec_case_channels(row, 3), SOURCE_RESIDENT, 0, 0.0f, 0.0f};
    btf_model *model;
    if (strcmp(row->codec, "fmf") == 0 || btf_codec_find(ctx, row->codec) == NULL) continue;
    fuzz_expect(codec_case_fit(ctx, row, &recipe, NULL, NULL, &model) == BTF_OK);
    keep(model);
  }
  btf_dataset_release(rgb);
  btf_dataset_release(grey);
  btf_context_release(ctx);
}

/* Sets of values that matter, so that queries inside the domain are not rare. */
static float take_float(fuzz_bytes *in) {
  static const float special[] = {0.0f,        -0.0f,        1.0f,         -1.0f, 0.5f,    1e-38f,
                                  -1e-38f,     1e-45f,       INFINITY,     NAN,   3.4e38f, 1e9f,
                                  16777216.0f, -16777216.0f, 0.999999940f, 2.0f};
  const uint32_t kind = fuzz_u8(in);
  float value;
  if (kind < 16) return special[kind];
  if (kind < 160) return ((float)(kind - 16) + (float)fuzz_u8(in) / 256.0f) / 144.0f;
  if (kind < 208) return -((float)(kind - 160) + (float)fuzz_u8(in) / 256.0f) / 48.0f;
  fuzz_take(in, &value, sizeof value);
  return value;
}

typedef struct queries {
  size_t count;
  float arrays[9][MOST_QUERIES]; /* u, v, light, view, lod */
} queries;

static btf_query query_of(const queries *q, size_t i, uint32_t flags) {
  btf_query query = {.lod = q->arrays[8][i], .flags = flags};
  for (int k = 0; k < 2; k++) query.uv[k] = q->arrays[k][i];
  for (int k = 0; k < 3; k++) query.light[k] = q->arrays[2 + k][i];
  for (int k = 0; k < 3; k++) query.view[k] = q->arrays[5 + k][i];
  return query;
}

static void check_batch(const btf_model *model, uint32_t channels, const queries *q, uint32_t flags,
                        int32_t value, int with_lod) {
  static float results[CHANNELS_MAX][MOST_QUERIES];
  float *out[CHANNELS_MAX] = {results[0], results[1], results[2], results[3]};
  float one[CHANNELS_MAX];
  btf_batch batch = BTF_BATCH_INIT;
  for (int k = 0; k < 2; k++) batch.uv[k] = q->arrays[k];
  for (int k = 0; k < 3; k++) batch.light[k] = q->arrays[2 + k];
  for (int k = 0; k < 3; k++) batch.view[k] = q->arrays[5 + k];
  batch.lod = with_lod ? q->arrays[8] : NULL;
  batch.flags = flags;
  batch.count = q->count;
  btf_model_eval_n(model, &batch, value, out);
  for (size_t i = 0; i < q->count; i++) {
    btf_query query = query_of(q, i, flags);
    if (!with_lod) query.lod = 0.0f;
    btf_model_eval_as(model, &query, value, one);
    for (uint32_t c = 0; c < channels; c++) {
      fuzz_expect(isfinite(one[c]));
      fuzz_expect(memcmp(&one[c], &results[c][i], sizeof(float)) == 0);
      if (!(query.light[2] > 0.0f) || !(query.view[2] > 0.0f)) fuzz_expect(one[c] == 0.0f);
    }
  }
}

static void check_sampling(const btf_model *model, uint32_t channels, const btf_query *query,
                           const float xi[3]) {
  float light[3], weight[CHANNELS_MAX];
  const float pdf = btf_model_pdf(model, query);
  fuzz_expect(isfinite(pdf) && pdf >= 0.0f);
  const float drawn = btf_model_sample(model, query, xi, light, weight);
  fuzz_expect(isfinite(drawn) && drawn >= 0.0f);
  for (uint32_t c = 0; c < channels; c++) fuzz_expect(isfinite(weight[c]));
  for (int k = 0; k < 3; k++) fuzz_expect(isfinite(light[k]));
  const float lod = btf_model_lod(model, xi, query->uv);
  fuzz_expect(lod >= 0.0f && lod <= 32.0f);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static queries q;
  fuzz_bytes in = {data, size};
  btf_model_info info = BTF_MODEL_INFO_INIT;
  uint32_t flags;
  float xi[3];
  if (model_count == 0) {
    /* The models stay, and the data of an empty chunk begin where its memory ends, which looks like a leak.
     */
    if (__lsan_disable) __lsan_disable();
    set_up();
    if (__lsan_enable) __lsan_enable();
  }
  const btf_model *model = models[fuzz_u8(&in) % model_count];
  const uint32_t kind = fuzz_u8(&in);
  flags = kind & 1;
  if (kind & 2) fuzz_take(&in, &flags, sizeof flags);
  const int32_t value = kind & 4 ? (int32_t)fuzz_u8(&in) : (int32_t)(kind >> 3) % 3;
  for (int k = 0; k < 2; k++) xi[k] = take_float(&in);
  xi[2] = xi[0];
  fuzz_expect(btf_model_describe(model, &info) == BTF_OK && info.channels <= CHANNELS_MAX);
  for (q.count = 0; q.count < MOST_QUERIES && in.size > 0; q.count++) {
    const uint32_t repeat = fuzz_u8(&in); /* directions of the query before, which a batch shares */
    for (int k = 0; k < 9; k++)
      q.arrays[k][q.count] =
          repeat & 1 && q.count > 0 && k >= 2 && k < 8 ? q.arrays[k][q.count - 1] : take_float(&in);
  }
  check_batch(model, info.channels, &q, flags, value, kind >> 5 & 1);
  if (q.count > 0) {
    const btf_query first = query_of(&q, 0, flags);
    check_sampling(model, info.channels, &first, xi);
  }
  return 0;
}
