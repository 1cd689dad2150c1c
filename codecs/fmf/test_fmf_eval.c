/* SPDX-License-Identifier: MIT */
/* Evaluation: interpolation against brute force, instruction sets against the scalar reference, batches
 * against single queries, levels of detail, threads. */
#include "test_materials.h"

#include <pthread.h>

#include <btf/btf_half.h>
#include <btf/btf_sampling.h>

#include "dataset/dataset.h"

static test_memory memory;
static const char *const storage_names[] = {"f32", "f16", "bf16", "q8"};

enum { QUERIES = 400 };

/* Queries of all kinds: random, at samples, on texel centres, repeated directions, outside of every domain.
 */
static btf_query make_query(const btf_dirset *set, uint32_t i, const btf_query *before) {
  const float *xyz = btf_dirset_directions(set);
  const uint32_t count = btf_dirset_count(set);
  btf_query q = {{0}, {0}, {0}, 0.0f, 0};
  test_random_direction(q.light);
  test_random_direction(q.view);
  if (i % 5 == 1) memcpy(q.light, xyz + 3 * (i % count), sizeof q.light);
  if (i % 7 == 1) memcpy(q.view, xyz + 3 * (i / 2 % count), sizeof q.view);
  if (i % 3 == 0 && before != NULL) {
    memcpy(q.light, before->light, sizeof q.light);
    if (i % 2 == 0) memcpy(q.view, before->view, sizeof q.view);
  }
  q.uv[0] = 4.0f * test_random() - 2.0f;
  q.uv[1] = 4.0f * test_random() - 2.0f;
  if (i % 4 == 2) q.uv[0] = 0.5f / 12.0f;
  if (i % 4 > 1) q.lod = 6.0f * test_random() - 1.0f;
  return q;
}

static void make_queries(const btf_dirset *set, btf_query *queries) {
  for (uint32_t i = 0; i < QUERIES; i++) queries[i] = make_query(set, i, i > 0 ? &queries[i - 1] : NULL);
}

/* The colours of all samples around a query, blended in double; *magnitude is the sum of absolute values of
 * what evaluation adds up. */
static void brute_force(const btf_model *model, const material *m, uint32_t wrap, uint32_t levels,
                        const btf_query *q, double *out) {
  btf_interp light, view;
  btf_level_pair level;
  btf_dirset_locate(m->directions, q->light, &light);
  btf_dirset_locate(m->directions, q->view, &view);
  btf_sampling_levels(q->lod, levels, &level);
  for (uint32_t c = 0; c < m->channels; c++) out[c] = 0.0;
  for (uint32_t k = 0; k < 2; k++) {
    btf_bilinear texels;
    btf_sampling_bilinear(q->uv[0], q->uv[1], btf_sampling_level_size(m->width, level.level[k]),
                          btf_sampling_level_size(m->height, level.level[k]), wrap, &texels);
    for (uint32_t i = 0; i < 9; i++) {
      for (uint32_t t = 0; t < 4; t++) {
        const double weight = (double)level.weight[k] * light.weight[i % 3] * view.weight[i / 3] *
                              texels.wx[t % 2] * texels.wy[t / 2];
        float value[64];
        if (weight == 0.0) continue;
        btf_model_texel(model, level.level[k], texels.x[t % 2], texels.y[t / 2], light.index[i % 3],
                        view.index[i / 3], value);
        for (uint32_t c = 0; c < m->channels; c++) out[c] += weight * value[c];
      }
    }
  }
}

/* Bounds the float rounding of an evaluation: every product is rounded a few times, and the sum over the
 * columns once for each: (columns + 20) halves of eps of the sum of absolute products, whose factors are at
 * most 1 times the scales. */
static double rounding_bound(const btf_model *model) {
  const btfi_fmf_state *s = fmf_state(model);
  const double largest = s->layout.storage == FMF_Q8 ? 127.0 * 127.0 : 1.0;
  double sum = 0.0;
  for (uint32_t k = 0; k < s->layout.padded; k++) sum += fabs((double)s->scale[k]) * largest;
  return (s->layout.columns + 20.0) * 6e-8 * sum;
}

/* 3 x 3 x 4 x 2 interpolation is the blend of decoded samples, for all storages, wraps and numbers of
 * channels. */
static void test_interpolation(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  btf_context *ctx = test_context(&memory);
  const uint32_t channels[] = {1, 3, 5, 64};
  for (uint32_t i = 0; i < 4; i++) {
    for (uint32_t storage = 0; storage < FMF_STORAGES; storage++) {
      const uint32_t wrap = (i + storage) % 2 ? BTF_WRAP_CLAMP : BTF_WRAP_PERIODIC;
      material m = material_create(ctx, MATERIAL_GLOSSY, i == 3 ? "grid:3x1" : "grid:5x3", 12, 7, channels[i],
                                   true, wrap);
      char settings[64];
      snprintf(settings, sizeof settings, "components=37 storage=%s", storage_names[storage]);
      btf_model *model = fmf_fit(ctx, &m, settings);
      const double bound = rounding_bound(model);
      make_queries(m.directions, queries);
      for (uint32_t n = 0; n < QUERIES; n++) {
        double expected[64];
        float got[64];
        btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
        brute_force(model, &m, wrap, fmf_state(model)->layout.levels, &queries[n], expected);
        for (uint32_t c = 0; c < channels[i]; c++)
          if (fabs(got[c] - expected[c]) > 2.0 * bound)
            fail_msg("%s, %u channels, query %u: %.9g instead of %.9g within %.3g", settings, channels[i], n,
                     got[c], expected[c], 2.0 * bound);
      }
      btf_model_release(model);
      material_release(&m);
    }
  }
  test_context_done(ctx, &memory);
}

/* Batches of every length equal single queries bit for bit, hostile queries among them. */
static void test_batch_equals_single(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float results[64][QUERIES];
  float *out[64];
  const float strange[] = {NAN, INFINITY, -INFINITY, 1e38f, -1e-42f, 0.0f, -1.0f};
  const char *const sets[] = {"scalar", "avx2", "avx512", "neon"};
  for (int c = 0; c < 64; c++) out[c] = results[c];
  for (size_t isa = 0; isa < 4; isa++) {
    btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
    btf_context *ctx;
    desc.isa = sets[isa];
    if (btf_context_create(&desc, &ctx) != BTF_OK) continue;
    for (uint32_t storage = 0; storage < FMF_STORAGES; storage++) {
      const uint32_t channels = storage % 2 ? 3 : 6;
      material m =
          material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, channels, true, BTF_WRAP_PERIODIC);
      char settings[64];
      snprintf(settings, sizeof settings, "components=%u storage=%s", 3 + 30 * storage,
               storage_names[storage]);
      btf_model *model = fmf_fit(ctx, &m, settings);
      make_queries(m.directions, queries);
      for (uint32_t n = 0; n < QUERIES; n += 9) {
        float *const fields = (float *)(void *)&queries[n];
        fields[n / 9 % 9] = strange[n / 9 % 7];
      }
      for (uint32_t flags = 0; flags < 2; flags++) {
        for (size_t count = 0; count <= QUERIES; count = count < 20 ? count + 1 : count + 95) {
          suite_eval_batch(model, queries, count, flags ? BTF_QUERY_NEAREST : 0, out);
          for (size_t n = 0; n < count; n++) {
            float single[64];
            queries[n].flags = flags ? BTF_QUERY_NEAREST : 0;
            btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, single);
            for (uint32_t c = 0; c < channels; c++)
              if (memcmp(&single[c], &results[c][n], sizeof single[c]) != 0)
                fail_msg("%s %s, query %zu of %zu, channel %u: %.9g and %.9g", sets[isa], settings, n, count,
                         c, single[c], results[c][n]);
          }
        }
      }
      btf_model_release(model);
      material_release(&m);
    }
    btf_context_release(ctx);
  }
}

/* All instruction sets, on the very same payload, agree with the scalar reference to rounding. */
static void test_instruction_sets(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float reference[QUERIES][3];
  const char *const sets[] = {"scalar", "avx2", "avx512", "neon"};
  for (uint32_t storage = 0; storage < FMF_STORAGES; storage++) {
    /* 16-value, 32-value and 64-value runs, and what is left of them, in all combinations. */
    const uint32_t components[] = {3, 16, 20, 41, 53, 75, 100, 130};
    btf_context *fit_ctx = test_context(&memory);
    material m = material_create(fit_ctx, MATERIAL_RANK_5, "grid:5x3", 12, 12, 3, true, BTF_WRAP_PERIODIC);
    for (size_t n = 0; n < (size_t)m.count * m.count * 3 * 144; n++) m.samples[n] = test_random();
    for (size_t i = 0; i < 8; i++) {
      char settings[64];
      snprintf(settings, sizeof settings, "components=%u storage=%s", components[i], storage_names[storage]);
      btf_model *fitted = fmf_fit(fit_ctx, &m, settings);
      make_queries(m.directions, queries);
      for (size_t isa = 0; isa < 4; isa++) {
        btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
        btf_context *ctx;
        desc.isa = sets[isa];
        if (btf_context_create(&desc, &ctx) != BTF_OK) continue;
        btf_model *model = fmf_reload(fitted, ctx);
        const double bound = rounding_bound(model);
        for (uint32_t n = 0; n < QUERIES; n++) {
          float got[3];
          queries[n].flags = n % 3 == 2 ? BTF_QUERY_NEAREST : 0;
          btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
          if (isa == 0) memcpy(reference[n], got, sizeof got);
          for (int c = 0; c < 3; c++)
            if (fabs((double)got[c] - reference[n][c]) > 2.0 * bound)
              fail_msg("%s %s: %.9g instead of %.9g within %.3g", sets[isa], settings, got[c],
                       reference[n][c], 2.0 * bound);
        }
        btf_model_release(model);
        btf_context_release(ctx);
      }
      btf_model_release(fitted);
    }
    material_release(&m);
    test_context_done(fit_ctx, &memory);
  }
}

/* INT05 and INT06: filtered eigen-textures decode to filtered colours. */
static void test_levels(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const uint32_t sizes[][2] = {{12, 7}, {16, 16}, {1, 9}};
  for (size_t i = 0; i < 3; i++) {
    const uint32_t width = sizes[i][0], height = sizes[i][1], texels = width * height;
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", width, height, 3, true, BTF_WRAP_PERIODIC);
    for (int packed = 0; packed < 2; packed++) {
      btf_model *model =
          fmf_fit(ctx, &m, packed ? "components=30 storage=f32" : "components=30 storage=f32 coding=plain");
      const uint32_t levels = fmf_state(model)->layout.levels;
      float *finest = malloc(texels * 3 * sizeof *finest), *filtered = malloc(texels * 3 * sizeof *filtered);
      assert_int_equal(levels, btfi_mip_count(width, height));
      for (uint32_t pair = 0; pair < 64; pair += 5) {
        for (uint32_t t = 0; t < texels; t++)
          btf_model_texel(model, 0, t % width, t / width, pair % 8, pair / 8, finest + 3 * t);
        for (uint32_t level = 1; level < levels; level++) {
          const uint32_t level_width = btf_sampling_level_size(width, level),
                         level_height = btf_sampling_level_size(height, level);
          assert_ok(btfi_mip_filter(ctx, finest, 3, width, height, 3, level, filtered, 3));
          for (uint32_t t = 0; t < level_width * level_height; t++) {
            float got[3];
            btf_model_texel(model, level, t % level_width, t / level_width, pair % 8, pair / 8, got);
            /* Values around 1, a few roundings of float each. */
            for (int c = 0; c < 3; c++) assert_near(got[c], filtered[3 * t + c], 1e-6);
          }
        }
      }
      free(finest);
      free(filtered);
      btf_model_release(model);
    }
    btf_model *few = fmf_fit(ctx, &m, "components=3 levels=2");
    assert_int_equal(fmf_state(few)->layout.levels, 2);
    btf_model_release(few);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* A model in a file evaluates as the one that was saved, bit for bit; plain tables are used where they are
 * mapped. */
static void test_saved_equals_fitted(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
  make_queries(m.directions, queries);
  for (uint32_t i = 0; i < 2 * FMF_STORAGES; i++) {
    char settings[64];
    snprintf(settings, sizeof settings, "components=22 coding=%s storage=%s", i % 2 ? "plain" : "packed",
             storage_names[i / 2]);
    btf_model *fitted = fmf_fit(ctx, &m, settings), *loaded = fmf_reload(fitted, ctx);
    for (uint32_t n = 0; n < QUERIES; n++) {
      float a[3], b[3];
      btf_model_eval(fitted, &queries[n], a);
      btf_model_eval(loaded, &queries[n], b);
      assert_memory_equal(a, b, sizeof a);
    }
    for (size_t k = 0; k < FMF_MAX_LEVELS + 1; k++)
      if (i % 2) assert_null(fmf_state(loaded)->owned[k]);
    btf_model_release(fitted);
    btf_model_release(loaded);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

typedef struct reader_thread {
  pthread_t thread;
  const btf_model *model;
  const btf_query *queries;
  float (*results)[3];
} reader_thread;

static void *read_all(void *user) {
  const reader_thread *r = user;
  for (int turn = 0; turn < 20; turn++)
    for (uint32_t n = 0; n < QUERIES; n++) btf_model_eval(r->model, &r->queries[n], r->results[n]);
  return NULL;
}

/* Eight threads on one model get what one gets, and evaluation does not allocate. */
static void test_threads(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float results[8][QUERIES][3];
  reader_thread readers[8];
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
  btf_model *model = fmf_fit(ctx, &m, "components=22");
  make_queries(m.directions, queries);
  const long allocations = memory.total_allocations;
  for (int i = 0; i < 8; i++) {
    readers[i] = (reader_thread){.model = model, .queries = queries, .results = results[i]};
    assert_int_equal(pthread_create(&readers[i].thread, NULL, read_all, &readers[i]), 0);
  }
  for (int i = 0; i < 8; i++) pthread_join(readers[i].thread, NULL);
  for (int i = 1; i < 8; i++) assert_memory_equal(results[0], results[i], sizeof results[0]);
  assert_int_equal(memory.total_allocations, allocations);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* The most components and channels at once: the scratch of a batch holds 8 such channels. */
static void test_largest(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float results[64][QUERIES];
  float *out[64];
  for (int c = 0; c < 64; c++) out[c] = results[c];
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_RANK_5, "grid:3x1", 34, 32, 64, true, BTF_WRAP_PERIODIC);
  for (size_t n = 0; n < (size_t)m.count * m.count * 64 * 34 * 32; n++) m.samples[n] = test_random();
  btf_model *model = fmf_fit(ctx, &m, "components=1024 storage=q8 coding=plain");
  assert_true(fmf_state(model)->components >= 560);
  make_queries(m.directions, queries);
  suite_eval_batch(model, queries, 40, 0, out);
  for (uint32_t n = 0; n < 40; n++) {
    float single[64];
    btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, single);
    for (int c = 0; c < 64; c++) assert_true(memcmp(&single[c], &results[c][n], sizeof(float)) == 0);
  }
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_interpolation),
                                     cmocka_unit_test(test_batch_equals_single),
                                     cmocka_unit_test(test_instruction_sets),
                                     cmocka_unit_test(test_levels),
                                     cmocka_unit_test(test_saved_equals_fitted),
                                     cmocka_unit_test(test_threads),
                                     cmocka_unit_test(test_largest)};
  return btf_run("fmf_eval", tests);
}
