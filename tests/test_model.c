/* SPDX-License-Identifier: MIT */
/* Models: fitting, storing, and the contract of evaluation. */
#include "btf_test.h"

#include <float.h>
#include <sys/stat.h>

#include "copy_codec.h"
#include "model/model.h"

static const float pi = 3.14159265358979f;

static const btf_codec *codec_of(btf_context *ctx, const btf_codec_vtbl *vtbl) {
  if (btf_codec_find(ctx, vtbl->id) == NULL) assert_ok(btf_context_register(ctx, vtbl));
  return btf_codec_find(ctx, vtbl->id);
}

static btf_model *fit(btf_context *ctx, const btf_codec_vtbl *vtbl, uint32_t channels, uint32_t quantity,
                      const char *storage) {
  btf_dataset *ds = copy_codec_dataset(ctx, 5, 4, channels, quantity);
  const btf_codec *codec = codec_of(ctx, vtbl);
  btf_options *options;
  btf_model *model;
  assert_non_null(ds);
  assert_ok(btf_options_create(codec, &options));
  if (vtbl->params != NULL) assert_ok(btf_options_set(options, "storage", storage));
  assert_ok(btf_model_fit(ds, codec, options, NULL, &model));
  btf_options_release(options);
  btf_dataset_release(ds);
  return model;
}

/* ---- making and storing ---- */

static void save_and_load(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  (void)state;
  for (int packed = 0; packed < 2; packed++) {
    btf_model *model = fit(ctx, &copy_codec, 3, BTF_QUANTITY_BRDF, packed ? "packed" : "plain"), *loaded,
              *again;
    btf_model_info info = BTF_MODEL_INFO_INIT;
    struct stat file;
    float expected[3], got[3];
    assert_ok(btf_model_save(model, test_path("a.btfz"), 0, "make it", NULL));
    assert_ok(btf_model_load(ctx, test_path("a.btfz"), &loaded));
    for (uint32_t view = 0; view < 6; view++)
      for (uint32_t light = 0; light < 6; light++)
        for (uint32_t y = 0; y < 4; y++)
          for (uint32_t x = 0; x < 5; x++) {
            btf_model_texel(model, 0, x, y, light, view, expected);
            btf_model_texel(loaded, 0, x, y, light, view, got);
            for (uint32_t c = 0; c < 3; c++) assert_true(got[c] == copy_codec_sample(view, light, x, y, c));
            assert_memory_equal(expected, got, sizeof got);
          }
    assert_ok(btf_model_describe(model, &info));
    assert_int_equal(info.stored_bytes, 0);
    assert_ok(btf_model_describe(loaded, &info));
    assert_int_equal(stat(test_path("a.btfz"), &file), 0);
    assert_true(info.stored_bytes > 500 && info.stored_bytes < (uint64_t)file.st_size);
    assert_string_equal(info.codec_id, "org.libbtf.copy");
    assert_int_equal(info.resident_bytes, 36 * 20 * 3 * 4);
    assert_int_equal(info.caps, BTF_CAP_FIT | BTF_CAP_BATCH);
    assert_int_equal(info.levels, 1);
    assert_string_equal(info.name, "test cloth");
    /* A stored model saved once more gives the same file, and over an old one. */
    assert_ok(btf_model_save(loaded, test_path("b.btfz"), 0, "make it", NULL));
    assert_ok(btf_model_load(ctx, test_path("b.btfz"), &again));
    {
      char *one = malloc((size_t)file.st_size), *two = malloc((size_t)file.st_size);
      FILE *a = fopen(test_path("a.btfz"), "rb"), *b = fopen(test_path("b.btfz"), "rb");
      assert_true(one != NULL && two != NULL && a != NULL && b != NULL);
      assert_int_equal(fread(one, 1, (size_t)file.st_size, a), file.st_size);
      assert_int_equal(fread(two, 1, (size_t)file.st_size, b), file.st_size);
      assert_int_equal(fgetc(b), EOF);
      assert_memory_equal(one, two, (size_t)file.st_size);
      fclose(a);
      fclose(b);
      free(one);
      free(two);
    }
    btf_model_release(again);
    btf_model_release(loaded);
    btf_model_release(model);
  }
  test_context_done(ctx, &memory);
}

static void arguments(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_codec_vtbl rgb = copy_codec, reader = copy_codec;
  btf_dataset *ds = copy_codec_dataset(ctx, 5, 4, 2, BTF_QUANTITY_BRDF);
  btf_options *options;
  btf_model *model, *raw;
  btf_file *file;
  btf_io io = BTF_IO_INIT;
  btf_writer *w;
  (void)state;
  rgb.id = "org.libbtf.rgb";
  rgb.caps |= BTF_CAP_RGB_ONLY;
  reader.id = "org.libbtf.reader";
  reader.caps = BTF_CAP_BATCH;
  reader.fit = NULL;
  assert_status(btf_model_fit(ds, codec_of(ctx, &rgb), NULL, NULL, &model), BTF_E_UNSUPPORTED);
  assert_message_has("3 channels; this data set has 2");
  assert_null(model);
  assert_status(btf_model_fit(ds, codec_of(ctx, &reader), NULL, NULL, &model), BTF_E_UNSUPPORTED);
  assert_ok(btf_options_create(codec_of(ctx, &rgb), &options));
  assert_status(btf_model_fit(ds, codec_of(ctx, &copy_codec), options, NULL, &model), BTF_E_INVALID_ARG);
  assert_message_has("org.libbtf.rgb");
  btf_options_release(options);
  assert_status(btf_model_fit(NULL, codec_of(ctx, &rgb), NULL, NULL, &model), BTF_E_INVALID_ARG);
  assert_ok(btf_model_from_dataset(ds, NULL, &raw));
  assert_status(btf_model_save(raw, test_path("raw.btfz"), 0, NULL, NULL), BTF_E_UNSUPPORTED);
  assert_status(btf_model_load(ctx, test_path("raw.btfz"), &model), BTF_E_IO); /* nothing was left */
  assert_null(model);
  btf_model_release(raw);
  btf_model_release(NULL);
  btf_dataset_release(ds);
  /* A container without a model. */
  assert_ok(btf_io_file(ctx, test_path("empty.btfz"), BTF_IO_WRITE, &io));
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  assert_ok(btf_writer_finish(w));
  assert_status(btf_model_load(ctx, test_path("empty.btfz"), &model), BTF_E_UNSUPPORTED);
  assert_ok(btf_file_open_path(ctx, test_path("empty.btfz"), 0, &file));
  btf_file_close(file);
  test_context_done(ctx, &memory);
}

static void folder_becomes_raw_model(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_dataset_writer *w;
  btf_dirset *set;
  btf_model *model;
  float images[6][6], value;
  const btf_block block = {0, 6, 0, 6, 0, 0, 1, 1};
  const btf_strides strides = {24, 4, 4, 4, 4};
  (void)state;
  assert_ok(btf_dirset_create_named(ctx, "grid:3x2", &set));
  desc.lights = desc.views = set;
  desc.width = desc.height = desc.channels = 1;
  for (int v = 0; v < 6; v++)
    for (int l = 0; l < 6; l++) images[v][l] = (float)(10 * v + l);
  assert_ok(btf_dataset_writer_create(ctx, test_path("d.btfd"), &desc, BTF_ORDER_VLYXC, &w));
  assert_ok(btf_dataset_writer_put(w, &block, &images[0][0], &strides));
  assert_ok(btf_dataset_writer_finish(w));
  assert_ok(btf_model_load(ctx, test_path("d.btfd"), &model));
  assert_ok(btf_model_describe(model, &info));
  assert_string_equal(info.codec_id, "raw");
  btf_model_texel(model, 0, 0, 0, 4, 3, &value);
  assert_true(value == 34.0f);
  btf_model_release(model);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

/* ---- evaluation ---- */

static void values_and_cosines(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const float heights[] = {1.0f, 0.5f, 0.02f, 0.01f, 1e-6f, FLT_MIN};
  (void)state;
  for (int cosine = 0; cosine < 2; cosine++) {
    const uint32_t quantity = cosine ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF;
    btf_model *model = fit(ctx, &copy_codec, 3, quantity, "plain");
    for (size_t i = 0; i < sizeof heights / sizeof *heights; i++) {
      const float z = heights[i], divisor = z > 0.02f ? z : 0.02f;
      const btf_query query = {{sqrtf(1.0f - z * z), 0.0f, z}, {0.0f, 0.0f, 1.0f}, {0.1f, 0.9f}, 0.0f, 0};
      float stored[3], f[3], times[3], plain[3];
      btf_model_eval_as(model, &query, BTF_VALUE_STORED, stored);
      btf_model_eval_as(model, &query, BTF_VALUE_BRDF, f);
      btf_model_eval_as(model, &query, BTF_VALUE_BRDF_COS, times);
      btf_model_eval(model, &query, plain);
      assert_memory_equal(plain, f, sizeof f);
      for (int c = 0; c < 3; c++) {
        assert_true(stored[c] > 0.0f);
        /* One multiplication by a rounded reciprocal: 2^-23 at most. */
        if (cosine)
          assert_relative(f[c], stored[c] / divisor, 1.2e-7);
        else
          assert_true(f[c] == stored[c]);
        if (cosine)
          assert_true(times[c] == stored[c]);
        else
          assert_true(times[c] == stored[c] * z);
      }
      btf_model_eval_as(model, &query, 7, f);
      assert_true(f[0] == 0.0f);
    }
    btf_model_release(model);
  }
  test_context_done(ctx, &memory);
}

/* Queries of every kind: ordinary ones, below and at the horizon, not finite in any member. */
static btf_query odd_query(uint32_t i) {
  static const float odd[] = {NAN, INFINITY, -INFINITY, -0.0f, 0.0f, -0.3f, FLT_MAX, -FLT_MAX, 1e-40f};
  const float a = (float)(i % 97) * 0.0647f, z = 0.05f + (float)(i % 13) * 0.07f;
  btf_query q = {{cosf(a) * sqrtf(1.0f - z * z), sinf(a) * sqrtf(1.0f - z * z), z},
                 {sinf(a) * 0.6f, cosf(a) * 0.6f, 0.8f},
                 {0.013f * (float)i, 3.0f - 0.031f * (float)i},
                 (float)(i % 5) * 0.5f,
                 0};
  float *members[9] = {&q.light[0], &q.light[1], &q.light[2], &q.view[0], &q.view[1],
                       &q.view[2],  &q.uv[0],    &q.uv[1],    &q.lod};
  if (i % 3 == 0) *members[i / 3 % 9] = odd[i / 27 % 9];
  return q;
}

static int inside_domain(const btf_query *q) {
  int finite = 1;
  for (int k = 0; k < 3; k++) finite = finite && isfinite(q->light[k]) && isfinite(q->view[k]);
  return finite && isfinite(q->uv[0]) && isfinite(q->uv[1]) && isfinite(q->lod) && q->light[2] > 0.0f &&
         q->view[2] > 0.0f;
}

enum { MOST = 5000 };
static float soa[9][MOST], results[3][MOST];

static void check_batch(const btf_model *model, size_t count, int32_t value, int with_lod, uint32_t flags) {
  btf_batch batch = BTF_BATCH_INIT;
  float *out[3] = {results[0], results[1], results[2]};
  batch.count = count;
  batch.flags = flags;
  for (int k = 0; k < 3; k++) {
    batch.light[k] = soa[k];
    batch.view[k] = soa[3 + k];
    memset(results[k], 0xee, sizeof results[k]);
  }
  batch.uv[0] = soa[6];
  batch.uv[1] = soa[7];
  batch.lod = with_lod ? soa[8] : NULL;
  for (size_t i = 0; i < count; i++) {
    const btf_query q = odd_query((uint32_t)i);
    for (int k = 0; k < 3; k++) {
      soa[k][i] = q.light[k];
      soa[3 + k][i] = q.view[k];
    }
    soa[6][i] = q.uv[0];
    soa[7][i] = q.uv[1];
    soa[8][i] = q.lod;
  }
  btf_model_eval_n(model, &batch, value, out);
  for (size_t i = 0; i < count; i++) {
    btf_query q = odd_query((uint32_t)i);
    float single[3];
    q.flags = flags;
    if (!with_lod) q.lod = 0.0f;
    btf_model_eval_as(model, &q, value, single);
    for (int c = 0; c < 3; c++) {
      if (memcmp(&single[c], &results[c][i], sizeof(float)) != 0)
        fail_msg("query %zu channel %d: %.9g single, %.9g in a batch", i, c, single[c], results[c][i]);
      assert_true(isfinite(single[c]));
      if (!inside_domain(&q)) assert_true(single[c] == 0.0f && !signbit(single[c]));
    }
  }
  for (int c = 0; c < 3; c++) /* nothing beyond the batch is touched */
    for (size_t i = count; i < MOST; i++) assert_memory_equal(&results[c][i], "\xee\xee\xee\xee", 4);
}

static void batch_equals_single(void **state) {
  static const size_t counts[] = {0, 1, 3, 2047, 2048, 2049, 4500};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  (void)state;
  for (int kind = 0; kind < 3; kind++)
    for (int cosine = 0; cosine < 2; cosine++) {
      const uint32_t quantity = cosine ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF;
      btf_model *model;
      if (kind == 2) {
        btf_dataset *ds = copy_codec_dataset(ctx, 5, 4, 3, quantity);
        assert_ok(btf_model_from_dataset(ds, NULL, &model));
        btf_dataset_release(ds);
      } else {
        model = fit(ctx, kind == 0 ? &copy_codec : &copy_codec_single, 3, quantity, "plain");
      }
      for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
        for (int32_t value = 0; value < 4; value++)
          check_batch(model, counts[i], value, i % 2 != 0, i % 3 == 0 ? BTF_QUERY_NEAREST : 0);
      btf_model_release(model);
    }
  test_context_done(ctx, &memory);
}

static void unusable_batches(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_model *model = fit(ctx, &copy_codec, 1, BTF_QUANTITY_BRDF, "plain");
  struct {
    btf_batch known;
    uint64_t unknown;
  } longer = {BTF_BATCH_INIT, 0};
  const float one[1] = {0.5f};
  float result[1] = {-1.0f}, *out[1] = {result};
  (void)state;
  longer.known.count = 1;
  for (int k = 0; k < 3; k++) longer.known.light[k] = longer.known.view[k] = one;
  longer.known.uv[0] = longer.known.uv[1] = one;
  longer.known.struct_size = sizeof longer;
  longer.unknown = 1;
  btf_model_eval_n(model, &longer.known, 0, out);
  assert_true(result[0] == -1.0f);
  longer.known.struct_size = 8;
  btf_model_eval_n(model, &longer.known, 0, out);
  assert_true(result[0] == -1.0f);
  longer.unknown = 0;
  longer.known.struct_size = sizeof longer;
  btf_model_eval_n(model, &longer.known, 0, out);
  assert_true(result[0] > 0.0f);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* A codec that breaks its word: what it returns is not finite. */
static void wild_eval(const void *state, const btf_query *query, float *out) {
  (void)state;
  (void)query;
  out[0] = NAN;
  out[1] = INFINITY;
  out[2] = -1e38f;
}
static void wild_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                       uint32_t view, float *out) {
  (void)level, (void)x, (void)y, (void)light, (void)view;
  wild_eval(state, NULL, out);
}

static void nothing_infinite_leaves(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_codec_vtbl wild = copy_codec_single;
  btf_model *model;
  const btf_query query = {{0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 1.0f}, {0.5f, 0.5f}, 0.0f, 0};
  const btf_query grazing = {{1.0f, 0.0f, 0.01f}, {0.0f, 0.0f, 1.0f}, {0.5f, 0.5f}, 0.0f, 0};
  float out[3], light[3];
  const float xi[3] = {0.25f, 0.5f, 0.5f};
  (void)state;
  wild.id = "org.libbtf.wild";
  wild.eval = wild_eval;
  wild.texel = wild_texel;
  model = fit(ctx, &wild, 3, BTF_QUANTITY_BRDF_COS, "plain");
  btf_model_eval(model, &query, out);
  assert_true(out[0] == 0.0f && out[1] == 0.0f && out[2] == -1e38f);
  btf_model_eval(model, &grazing, out); /* -1e38 / 0.02 overflows */
  assert_true(out[0] == 0.0f && out[1] == 0.0f && out[2] == 0.0f);
  assert_int_equal(btf_model_texel(model, 0, 0, 0, 0, 0, out), 2);
  assert_true(out[0] == 0.0f && out[1] == 0.0f && out[2] == -1e38f);
  assert_int_equal(btf_model_texel(model, 1, 0, 0, 0, 0, out),
                   0); /* beyond the last level: nothing is decoded */
  assert_true(btf_model_sample(model, &query, xi, light, out) > 0.0f);
  assert_true(out[0] == 0.0f && out[1] == 0.0f && isfinite(out[2]));
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* Codecs that mistype an option, each through another entry of the host table. */
static btf_status mistyped(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                           const btf_options *options, const btf_job *job, btf_chunk_writer *payload,
                           int way) {
  if (way == 0) assert_true(host->option(options, "gian") == 0.0);
  if (way == 1) assert_null(host->option_text(options, "gian"));
  if (way == 2) assert_int_equal(host->option_is_set(options, "gian"), 0);
  if (way == 3) assert_true(host->option(options, NULL) == 0.0);
  return copy_codec.fit(host, ctx, ds, options, job, payload);
}
#define MISTYPED(way)                                                                                        \
  static btf_status mistyped##way(const btf_host *host, btf_context *ctx, const btf_dataset *ds,             \
                                  const btf_options *options, const btf_job *job,                            \
                                  btf_chunk_writer *payload) {                                               \
    return mistyped(host, ctx, ds, options, job, payload, way);                                              \
  }
MISTYPED(0)
MISTYPED(1)
MISTYPED(2)
MISTYPED(3)
MISTYPED(4)

/* Although the fit itself succeeds, and with options of the caller's and defaults; the options are good for
 * the next fit. */
static void mistyped_option_ends_the_fit(void **state) {
  static btf_status (*const fits[])(const btf_host *, btf_context *, const btf_dataset *, const btf_options *,
                                    const btf_job *, btf_chunk_writer *) = {mistyped0, mistyped1, mistyped2,
                                                                            mistyped3, mistyped4};
  static const char *const ids[] = {"org.libbtf.typo0", "org.libbtf.typo1", "org.libbtf.typo2",
                                    "org.libbtf.typo3", "org.libbtf.right"};
  (void)state;
  for (int way = 0; way < 5; way++)
    for (int given = 0; given < 2; given++) {
      test_memory memory;
      btf_context *ctx = test_context(&memory);
      btf_codec_vtbl codec = copy_codec;
      btf_options *options = NULL;
      btf_model *model;
      codec.id = ids[way];
      codec.fit = fits[way];
      assert_ok(btf_context_register(ctx, &codec));
      btf_dataset *ds = copy_codec_dataset(ctx, 3, 2, 1, BTF_QUANTITY_BRDF);
      const btf_codec *found = btf_codec_find(ctx, codec.id);
      if (given) assert_ok(btf_options_create(found, &options));
      for (int again = 0; again < 2; again++) {
        const btf_status status = btf_model_fit(ds, found, options, NULL, &model);
        if (way == 4) {
          assert_ok(status);
        } else {
          assert_status(status, BTF_E_INVALID_ARG);
          assert_null(model);
          assert_message_has(ids[way]);
          assert_message_has(way < 3 ? "\"gian\"" : "\"\"");
        }
        btf_model_release(model);
      }
      btf_options_release(options);
      btf_dataset_release(ds);
      test_context_done(ctx, &memory);
    }
}

/* ---- a codec that narrows its budget in a copy of the job ---- */

static void ignore_abrdf(void *user, uint32_t level, uint32_t x, uint32_t y, const float *abrdf,
                         uint32_t thread) {
  (void)user, (void)level, (void)x, (void)y, (void)abrdf, (void)thread;
}

static int32_t never_called(void *user, double fraction, const char *stage) {
  (void)user, (void)fraction;
  fail_msg("the copy's own progress was called at %s", stage);
  return 1;
}

/* The copy is a heap block of just that size, so that AddressSanitizer sees a step beyond it. */
static btf_status fit_in_part(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                              const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  const btf_job made = BTF_JOB_INIT;
  btf_svd_desc triplets = {.struct_size = sizeof triplets, .rank = 2};
  btf_svd_result result = {.struct_size = sizeof result};
  btf_statistics statistics = {.struct_size = sizeof statistics};
  btf_job *part = malloc(sizeof *part);
  btf_status status;
  assert_non_null(part);
  *part = *job;
  part->max_working_set /= 2;
  part->progress = never_called;
  part->user = NULL;
  status = host->progress(part, 0.1, "a part");
  if (status == BTF_OK)
    status = host->measure(ctx, ds, part->max_working_set, NULL, &statistics, part, 0.1, 0.3);
  if (status == BTF_OK)
    status =
        host->visit_abrdfs(ctx, ds, 0, part->max_working_set, ignore_abrdf, NULL, part, 0.3, 0.5, "visit");
  if (status == BTF_OK) {
    triplets.max_working_set = part->max_working_set;
    status = host->svd_dataset(ctx, ds, NULL, &triplets, part, 0.5, 0.8, &result);
    host->svd_free(ctx, &result);
    if (status == BTF_E_UNSUPPORTED) status = BTF_OK; /* a build that evaluates only */
  }
  if (status == BTF_E_CANCELLED) assert_status(host->progress(job, 1.0, "end"), BTF_E_CANCELLED);
  assert_status(host->progress(&made, 1.0, "end"), BTF_E_INVALID_ARG);
  assert_message_has("`fit` was given");
  free(part);
  return status == BTF_OK ? copy_codec.fit(host, ctx, ds, options, job, payload) : status;
}

typedef struct job_reports {
  int calls, cancel_at;
  char stages[512];
} job_reports;

static int32_t note_report(void *user, double fraction, const char *stage) {
  job_reports *r = user;
  (void)fraction;
  snprintf(r->stages + strlen(r->stages), sizeof r->stages - strlen(r->stages), "%s;", stage);
  return ++r->calls == r->cancel_at;
}

static void job_may_be_copied(void **state) {
  btf_codec_vtbl codec = copy_codec;
  (void)state;
  codec.id = "org.libbtf.part";
  codec.fit = fit_in_part;
  for (int cancel_at = 0; cancel_at < 3; cancel_at++) {
    test_memory memory;
    btf_context *ctx = test_context(&memory);
    job_reports reports = {.cancel_at = cancel_at};
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    btf_dataset *ds = copy_codec_dataset(ctx, 4, 3, 1, BTF_QUANTITY_BRDF);
    assert_ok(btf_context_register(ctx, &codec));
    job.progress = note_report;
    job.user = &reports;
    job.max_working_set = 64 << 20;
    assert_status(btf_model_fit(ds, btf_codec_find(ctx, codec.id), NULL, &job, &model),
                  cancel_at ? BTF_E_CANCELLED : BTF_OK);
    assert_non_null(strstr(reports.stages, "a part;"));
    if (cancel_at)
      assert_int_equal(reports.calls, cancel_at);
    else
      assert_non_null(strstr(reports.stages, "visit;"));
    btf_model_release(model);
    job.running = (btf_running_job *)(void *)&reports;
    assert_status(btf_model_fit(ds, btf_codec_find(ctx, codec.id), NULL, &job, &model), BTF_E_INVALID_ARG);
    assert_message_has("running is set");
    assert_null(model);
    btf_dataset_release(ds);
    test_context_done(ctx, &memory);
  }
}

/* Single and batch alike: a flag of a later version is no value of this one. */
static void unknown_flags_evaluate_to_zero(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_model *model = fit(ctx, &copy_codec, 3, BTF_QUANTITY_BRDF, "plain");
  float x = 0.0f, y = 0.0f, z = 1.0f, half = 0.5f, value[3], batched[3], light[3];
  float *const out[3] = {&batched[0], &batched[1], &batched[2]};
  const float xi[3] = {0.25f, 0.5f, 0.5f};
  (void)state;
  for (uint32_t bit = 0; bit < 32; bit++) {
    const btf_query q = {{x, y, z}, {x, y, z}, {half, half}, 0.0f, UINT32_C(1) << bit};
    const int known = bit == 0; /* BTF_QUERY_NEAREST */
    btf_batch batch = {sizeof batch, 1, {&x, &y, &z}, {&x, &y, &z}, {&half, &half}, NULL, q.flags, 0};
    btf_model_eval(model, &q, value);
    btf_model_eval_n(model, &batch, BTF_VALUE_BRDF, out);
    for (int c = 0; c < 3; c++) {
      assert_true((value[c] != 0.0f) == known);
      assert_memory_equal(&value[c], &batched[c], sizeof(float));
    }
    assert_true((btf_model_pdf(model, &q) > 0.0f) == known);
    assert_true((btf_model_sample(model, &q, xi, light, value) > 0.0f) == known);
  }
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

static void texel_and_level(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_model *model = fit(ctx, &copy_codec, 3, BTF_QUANTITY_BRDF, "plain"), *raw;
  btf_dataset *ds = copy_codec_dataset(ctx, 16, 8, 1, BTF_QUANTITY_BRDF);
  float out[3];
  (void)state;
  for (int outside = 0; outside < 5; outside++) {
    const uint32_t i[5] = {outside == 0, outside == 1 ? 5 : 4, outside == 2 ? 4 : 3, outside == 3 ? 6 : 5,
                           outside == 4 ? UINT32_MAX : 5};
    out[0] = out[1] = out[2] = 9.0f;
    btf_model_texel(model, i[0], i[1], i[2], i[3], i[4], out);
    assert_true(out[0] == 0.0f && out[1] == 0.0f && out[2] == 0.0f);
  }
  btf_model_texel(model, 0, 4, 3, 5, 5, out);
  assert_true(out[2] == copy_codec_sample(5, 5, 4, 3, 2));
  assert_ok(btf_model_from_dataset(ds, NULL, &raw)); /* 16 x 8 texels: five levels */
  {
    const struct {
      float x[2], y[2], lod;
    } cases[] = {
        {{0.0f, 0.0f}, {0.0f, 0.0f}, 0.0f},
        {{1.0f / 16, 0.0f}, {0.0f, 1.0f / 8}, 0.0f},
        {{2.0f / 16, 0.0f}, {0.0f, 1.0f / 8}, 1.0f},
        {{1.0f / 16, 0.0f}, {0.0f, 4.0f / 8}, 2.0f},
        {{3.0f / 16, 4.0f / 8}, {0.0f, 0.0f}, 2.321928095f}, /* log2 of 5 */
        {{100.0f, 0.0f}, {0.0f, 0.0f}, 4.0f},
        {{NAN, 0.0f}, {0.0f, 0.0f}, 0.0f},
        {{INFINITY, 0.0f}, {0.0f, 0.0f}, 4.0f},
        {{0.0f, 0.5f}, {NAN, 0.0f}, 0.0f}, /* NaN anywhere counts, whatever the rest */
        {{0.0f, 0.5f}, {0.0f, NAN}, 0.0f},
        {{NAN, 0.5f}, {0.5f, 0.5f}, 0.0f},
        {{INFINITY, NAN}, {0.5f, 0.0f}, 0.0f},
        {{0.5f, 0.0f}, {NAN, -INFINITY}, 0.0f},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
      assert_near(btf_model_lod(raw, cases[i].x, cases[i].y), cases[i].lod, 1e-6);
    assert_true(btf_model_lod(model, cases[5].x, cases[5].y) == 0.0f); /* one level only */
  }
  btf_model_release(raw);
  btf_dataset_release(ds);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

static void sampling(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_model *model = fit(ctx, &copy_codec, 3, BTF_QUANTITY_BRDF_COS, "plain");
  btf_query query = {{0.0f, 0.0f, 1.0f}, {0.6f, 0.0f, 0.8f}, {0.3f, 0.6f}, 0.0f, 0};
  double mean_z = 0.0, inverse = 0.0;
  float light[3], weight[3], f[3];
  const float wrong[3] = {1.0f, 0.5f, 0.5f}, nan_xi[3] = {0.5f, NAN, 0.5f},
              wrong_lobe[3] = {0.5f, 0.5f, 1.0f};
  enum { SIDE = 64 };
  (void)state;
  for (int i = 0; i < SIDE * SIDE; i++) {
    const float xi[3] = {((float)(i % SIDE) + 0.5f) / SIDE, ((float)(i / SIDE) + 0.5f) / SIDE, 0.5f};
    const float pdf = btf_model_sample(model, &query, xi, light, weight);
    btf_query drawn = query;
    assert_near(light[0] * light[0] + light[1] * light[1] + light[2] * light[2], 1.0, 1e-6);
    assert_true(light[2] > 0.0f);
    memcpy(drawn.light, light, sizeof light);
    assert_true(pdf == btf_model_pdf(model, &drawn));
    btf_model_eval(model, &drawn, f);
    /* weight = f cos / pdf: three roundings. */
    for (int c = 0; c < 3; c++) assert_relative(weight[c], (double)f[c] * light[2] / pdf, 4e-7);
    mean_z += light[2] / (double)(SIDE * SIDE);
    inverse += (double)light[2] / pdf / (SIDE * SIDE);
  }
  /* Moments of the cosine-weighted hemisphere: E[z] = 2/3 (midpoint rule: error below SIDE^-1.5 at the square
   * root's end), and cos / pdf is pi everywhere. */
  assert_near(mean_z, 2.0 / 3.0, 5e-4);
  assert_near(inverse, pi, 1e-5);
  assert_true(btf_model_sample(model, &query, wrong, light, weight) == 0.0f && weight[0] == 0.0f);
  assert_true(btf_model_sample(model, &query, nan_xi, light, weight) == 0.0f && weight[2] == 0.0f);
  assert_true(btf_model_sample(model, &query, wrong_lobe, light, weight) == 0.0f && weight[1] == 0.0f);
  query.view[2] = -0.8f;
  assert_true(btf_model_sample(model, &query, (const float[3]){0.1f, 0.2f, 0.3f}, light, weight) == 0.0f);
  assert_true(btf_model_pdf(model, &query) == 0.0f);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

static void evaluation_allocates_nothing(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_model *model = fit(ctx, &copy_codec_single, 3, BTF_QUANTITY_BRDF_COS, "packed");
  const float xi[3] = {0.3f, 0.4f, 0.5f}, du[2] = {0.1f, 0.0f};
  long before;
  float light[3], out[3];
  (void)state;
  before = memory.total_allocations;
  check_batch(model, 3000, BTF_VALUE_BRDF, 1, 0);
  for (uint32_t i = 0; i < 1000; i++) {
    const btf_query q = odd_query(i);
    btf_model_eval(model, &q, out);
    btf_model_sample(model, &q, xi, light, out);
    btf_model_texel(model, 0, i % 7, i % 5, i % 9, i % 6, out);
    btf_model_lod(model, du, du);
  }
  assert_int_equal(memory.total_allocations, before);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* ---- failures on the way ---- */

static int no_file(const char *name) {
  struct stat info;
  return stat(test_path(name), &info) != 0;
}

/* Each allocation fails in turn, once or from then on, around fit, save, open and load. */
static void out_of_memory(void **state) {
  (void)state;
  for (int persistent = 0; persistent < 2; persistent++)
    for (long n = 1;; n++) {
      test_memory memory;
      btf_context *ctx = test_context_with(&memory, NULL, 1);
      btf_dataset *ds = copy_codec_dataset(ctx, 5, 4, 3, BTF_QUANTITY_BRDF);
      const btf_codec *codec = codec_of(ctx, &copy_codec);
      btf_model *model = NULL, *loaded = NULL;
      btf_status status;
      remove(test_path("m.btfz"));
      memory.persistent = persistent;
      memory.fail_at = memory.total_allocations + n;
      status = btf_model_fit(ds, codec, NULL, NULL, &model);
      if (status != BTF_OK) assert_null(model);
      if (status == BTF_OK) {
        status = btf_model_save(model, test_path("m.btfz"), 0, "c", NULL);
        if (status != BTF_OK) assert_true(no_file("m.btfz"));
      }
      if (status == BTF_OK) {
        status = btf_model_load(ctx, test_path("m.btfz"), &loaded);
        if (status != BTF_OK) assert_null(loaded);
      }
      if (status != BTF_OK) assert_int_equal(status, BTF_E_NOMEM);
      btf_model_release(loaded);
      btf_model_release(model);
      btf_dataset_release(ds);
      test_context_done(ctx, &memory);
      if (status == BTF_OK) {
        assert_true(n > 40);
        break;
      }
    }
}

typedef struct cancelling {
  long calls, cancel_at;
  double last;
} cancelling;

static int32_t cancel(void *user, double fraction, const char *stage) {
  cancelling *c = user;
  assert_non_null(stage);
  assert_true(fraction >= 0.0 && fraction <= 1.0);
  c->last = fraction;
  return ++c->calls == c->cancel_at;
}

static void cancelled_at_every_report(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds = copy_codec_dataset(ctx, 5, 4, 3, BTF_QUANTITY_BRDF);
  const btf_codec *codec = codec_of(ctx, &copy_codec);
  (void)state;
  for (long n = 1;; n++) {
    cancelling c = {0, n, 0.0};
    btf_job job = BTF_JOB_INIT;
    btf_model *model = NULL;
    btf_status status;
    job.progress = cancel;
    job.user = &c;
    remove(test_path("m.btfz"));
    status = btf_model_fit(ds, codec, NULL, &job, &model);
    if (status == BTF_OK) {
      status = btf_model_save(model, test_path("m.btfz"), 0, NULL, &job);
      if (status != BTF_OK) assert_true(no_file("m.btfz"));
    }
    btf_model_release(model);
    if (status == BTF_OK) {
      assert_true(n > 4 && c.last == 1.0);
      break;
    }
    assert_int_equal(status, BTF_E_CANCELLED);
    assert_int_equal(c.calls, n); /* nobody asks again once it was cancelled */
  }
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(save_and_load),
      cmocka_unit_test(arguments),
      cmocka_unit_test(folder_becomes_raw_model),
      cmocka_unit_test(values_and_cosines),
      cmocka_unit_test(batch_equals_single),
      cmocka_unit_test(unusable_batches),
      cmocka_unit_test(nothing_infinite_leaves),
      cmocka_unit_test(mistyped_option_ends_the_fit),
      cmocka_unit_test(job_may_be_copied),
      cmocka_unit_test(unknown_flags_evaluate_to_zero),
      cmocka_unit_test(texel_and_level),
      cmocka_unit_test(sampling),
      cmocka_unit_test(evaluation_allocates_nothing),
      cmocka_unit_test(out_of_memory),
      cmocka_unit_test(cancelled_at_every_report),
  };
  return btf_run("model", tests);
}
