/* SPDX-License-Identifier: MIT */
/*
 * Eight threads evaluate, describe and retain one model at once, each with its own queries, and get the bits
 * that one thread gets; evaluation allocates nothing. Meant for ThreadSanitizer, and true without it.
 */
#include "btf_test.h"

#include <pthread.h>

enum { SIDE = 16, CHANNELS = 3, THREADS = 8, QUERIES = 400 };

static btf_model *fit_model(btf_context *ctx, const char *storage) {
  static float samples[50 * 50 * SIDE * SIDE * CHANNELS];
  btf_dirset *directions;
  btf_dataset *dataset;
  btf_options *options;
  btf_model *model;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  for (size_t i = 0; i < sizeof samples / sizeof *samples; i++)
    samples[i] = 0.4f + 0.3f * sinf(0.37f * (float)(i % 7919)) * cosf(0.01f * (float)(i % 104729));
  assert_ok(btf_dirset_create_named(ctx, "grid:10x5", &directions));
  desc.lights = desc.views = directions;
  desc.width = desc.height = SIDE;
  desc.channels = CHANNELS;
  desc.data = samples;
  desc.strides.channel = sizeof(float);
  desc.strides.x = CHANNELS * desc.strides.channel;
  desc.strides.y = SIDE * desc.strides.x;
  desc.strides.light = SIDE * desc.strides.y;
  desc.strides.view = 50 * desc.strides.light;
  assert_ok(btf_dataset_create(ctx, &desc, &dataset));
  if (storage == NULL) {
    assert_ok(btf_model_from_dataset(dataset, NULL, &model));
  } else {
    assert_ok(btf_options_create(btf_codec_find(ctx, "fmf"), &options));
    assert_ok(btf_options_set(options, "components", "12"));
    assert_ok(btf_options_set(options, "storage", storage));
    assert_ok(btf_model_fit(dataset, btf_codec_find(ctx, "fmf"), options, NULL, &model));
    btf_options_release(options);
  }
  btf_dataset_release(dataset);
  btf_dirset_release(directions);
  return model;
}

typedef struct evaluation {
  btf_model *model;
  float single[QUERIES][CHANNELS], batch[CHANNELS][QUERIES];
  uint32_t first;
} evaluation;

static btf_query query_number(uint32_t i) {
  const float a = 0.61f * (float)i, b = 1.17f * (float)i, r = 0.9f * fabsf(sinf(0.13f * (float)i));
  const float s = 0.9f * fabsf(cosf(0.29f * (float)i));
  const btf_query q = {{r * cosf(a), r * sinf(a), sqrtf(1.0f - r * r)},
                       {s * cosf(b), s * sinf(b), sqrtf(1.0f - s * s)},
                       {0.07f * (float)i, -0.11f * (float)i},
                       0.01f * (float)(i % 500),
                       0};
  return q;
}

static void *evaluate(void *user) {
  evaluation *e = user;
  static const size_t count = QUERIES;
  float(*columns)[QUERIES] = malloc(9 * sizeof *columns);
  float *out[CHANNELS] = {e->batch[0], e->batch[1], e->batch[2]};
  btf_batch batch = BTF_BATCH_INIT;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_model *mine = btf_model_retain(e->model);
  btf_model_describe(mine, &info);
  for (uint32_t i = 0; i < count; i++) {
    const btf_query q = query_number(e->first + i);
    btf_model_eval(mine, &q, e->single[i]);
    for (int k = 0; k < 3; k++) {
      columns[k][i] = q.light[k];
      columns[3 + k][i] = q.view[k];
    }
    columns[6][i] = q.uv[0];
    columns[7][i] = q.uv[1];
    columns[8][i] = q.lod;
  }
  batch.count = count;
  for (int k = 0; k < 3; k++) {
    batch.light[k] = columns[k];
    batch.view[k] = columns[3 + k];
  }
  batch.uv[0] = columns[6];
  batch.uv[1] = columns[7];
  batch.lod = columns[8];
  btf_model_eval_n(mine, &batch, BTF_VALUE_BRDF, out);
  btf_model_release(mine);
  free(columns);
  return NULL;
}

static void eight_threads(void **state) {
  static const char *const storages[] = {"f32", "f16", "q8", NULL};
  (void)state;
  for (size_t kind = 0; kind < sizeof storages / sizeof *storages; kind++) {
    test_memory memory = {0};
    btf_context *ctx = test_context(&memory);
    btf_model *model = fit_model(ctx, storages[kind]);
    static evaluation work[THREADS], alone;
    pthread_t threads[THREADS];
    const long before = memory.total_allocations;
    for (uint32_t t = 0; t < THREADS; t++) {
      work[t].model = model;
      work[t].first = 1000 * t;
      assert_int_equal(pthread_create(&threads[t], NULL, evaluate, &work[t]), 0);
    }
    for (uint32_t t = 0; t < THREADS; t++) pthread_join(threads[t], NULL);
    for (uint32_t t = 0; t < THREADS; t++) {
      alone.model = model;
      alone.first = 1000 * t;
      evaluate(&alone);
      assert_memory_equal(work[t].single, alone.single, sizeof alone.single);
      assert_memory_equal(work[t].batch, alone.batch, sizeof alone.batch);
      for (uint32_t i = 0; i < QUERIES; i++)
        for (int c = 0; c < CHANNELS; c++)
          assert_memory_equal(&alone.single[i][c], &alone.batch[c][i], sizeof(float));
    }
    assert_int_equal(memory.total_allocations, before);
    btf_model_release(model);
    test_context_done(ctx, &memory);
  }
}

/* Contexts, direction sets and data sets of one context made and dropped by several threads. */
static void *make_and_drop(void *user) {
  btf_context *ctx = user;
  for (int i = 0; i < 20; i++) {
    btf_dirset *directions;
    if (btf_dirset_create_named(ctx, i % 2 ? "ubo81" : "grid:6x3", &directions) != BTF_OK) return user;
    btf_dirset_release(directions);
    if (btf_dirset_create_named(ctx, "nonsense", &directions) == BTF_OK) return user;
    if (strstr(btf_error_message(), "nonsense") == NULL) return user;
  }
  return NULL;
}

static void objects_of_one_context(void **state) {
  test_memory memory = {0};
  btf_context *ctx = test_context(&memory);
  pthread_t threads[THREADS];
  (void)state;
  for (int t = 0; t < THREADS; t++)
    assert_int_equal(pthread_create(&threads[t], NULL, make_and_drop, ctx), 0);
  for (int t = 0; t < THREADS; t++) {
    void *failed;
    pthread_join(threads[t], &failed);
    assert_null(failed);
  }
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(eight_threads),
      cmocka_unit_test(objects_of_one_context),
  };
  return btf_run("concurrency", tests);
}
