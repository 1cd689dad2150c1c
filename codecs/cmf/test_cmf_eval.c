/* SPDX-License-Identifier: MIT */
/* Evaluation: interpolation over index maps, batches, instruction sets. */
#include "test_cmf_fits.h"

static test_memory memory;

/* ---- evaluation: INT02, INT03 ---- */

static btf_query query_of(float u, float v, float lod) {
  btf_query q = {{0}, {0}, {u, v}, lod, 0};
  cmf_draw_direction(q.light);
  cmf_draw_direction(q.view);
  return q;
}

/* Colours of whole texels are blended, of two levels as well: indices are never filtered. */
static void test_blends_texels(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:5x3", 8, 4, 3);
  for (size_t i = 0; i < CMF_CASES; i++) {
    btf_model *model = cmf_fit(ctx, &m, cmf_cases[i]);
    for (int n = 0; n < 60; n++) {
      const btf_query q = query_of(cmf_draw(), cmf_draw(), n % 2 ? 2.5f * cmf_draw() : 0.0f);
      btf_texel_set set;
      float got[3];
      double expected[3] = {0.0, 0.0, 0.0}, most = 0.0;
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
      btf_sampling_texels(q.uv, q.lod, 0, 8, 4, BTF_WRAP_PERIODIC, state_of(model)->levels, &set);
      for (uint32_t t = 0; t < set.count; t++) {
        btf_query at = q;
        float value[3];
        at.uv[0] = ((float)set.x[t] + 0.5f) / (float)btf_sampling_level_size(8, set.level[t]);
        at.uv[1] = ((float)set.y[t] + 0.5f) / (float)btf_sampling_level_size(4, set.level[t]);
        at.lod = (float)set.level[t];
        btf_model_eval_as(model, &at, BTF_VALUE_STORED, value);
        for (int c = 0; c < 3; c++) {
          expected[c] += (double)set.weight[t] * (double)value[c];
          most = fmax(most, fabs((double)value[c]));
        }
      }
      /* Eight products and sums of floats. */
      for (int c = 0; c < 3; c++) assert_near(got[c], expected[c], 1e-6 * most);
    }
    /* At the directions of the data, evaluation and decoding are the same. */
    const float *xyz = btf_dirset_directions(m.set);
    for (uint32_t l = 0; l < m.count; l++) {
      btf_query q = query_of(2.5f / 8.0f, 1.5f / 4.0f, 0.0f);
      float a[3], b[3];
      memcpy(q.light, xyz + 3 * l, sizeof q.light);
      memcpy(q.view, xyz + 3 * ((l + 4) % m.count), sizeof q.view);
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, a);
      btf_model_texel(model, 0, 2, 1, l, (l + 4) % m.count, b);
      assert_memory_equal(a, b, sizeof a);
      q.flags = BTF_QUERY_NEAREST;
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, a);
      assert_memory_equal(a, b, sizeof a);
    }
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

enum { QUERIES = 200 };

static void make_queries(btf_query *queries) {
  const float strange[] = {NAN, INFINITY, -INFINITY, 1e38f, -1e-42f, 0.0f, -1.0f};
  for (uint32_t n = 0; n < QUERIES; n++) {
    queries[n] =
        query_of(4.0f * cmf_draw() - 2.0f, 4.0f * cmf_draw() - 2.0f, n % 3 ? 0.0f : 6.0f * cmf_draw() - 1.0f);
    if (n % 4 == 1) memcpy(&queries[n], &queries[n - 1], 6 * sizeof(float));
    if (n % 9 == 5) ((float *)(void *)&queries[n])[n / 9 % 9] = strange[n / 9 % 7];
  }
}

/* Batches equal single queries bit for bit, and all instruction sets agree with the scalar reference to
 * rounding. */
static void test_batches_and_instruction_sets(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float reference[QUERIES][8], columns[8][QUERIES];
  const char *const sets[] = {"scalar", "avx2", "avx512", "neon"};
  const uint32_t channels[CMF_CASES] = {3, 1, 5, 4, 2, 1, 2, 8};
  float *out[8];
  for (int c = 0; c < 8; c++) out[c] = columns[c];
  make_queries(queries);
  for (size_t i = 0; i < CMF_CASES; i++) {
    btf_context *ctx = test_context(&memory);
    material m = material_create(ctx, BUMPS, "grid:5x3", 7, 4, channels[i]);
    btf_model *fitted = cmf_fit(ctx, &m, cmf_cases[i]);
    const char *path = test_path("model.btfz");
    double most = 0.0;
    assert_ok(btf_model_save(fitted, path, 0, NULL, NULL));
    for (uint32_t c = 0; c < channels[i]; c++) most = fmax(most, (double)state_of(fitted)->global[c]);
    for (uint32_t k = 1; k < state_of(fitted)->scales; k++)
      for (uint32_t c = 0; c < channels[i]; c++)
        most *= c == 0 ? 1.0 + (double)state_of(fitted)->global[k * channels[i]] : 1.0;
    for (size_t isa = 0; isa < 4; isa++) {
      btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
      btf_context *other;
      btf_model *model;
      desc.isa = sets[isa];
      if (btf_context_create(&desc, &other) != BTF_OK) continue;
      assert_ok(btf_model_load(other, path, &model));
      for (uint32_t flags = 0; flags < 2; flags++) {
        for (size_t count = 0; count <= QUERIES; count = count < 12 ? count + 1 : count + 94) {
          suite_eval_batch(model, queries, count, flags ? BTF_QUERY_NEAREST : 0, out);
          for (size_t n = 0; n < count; n++) {
            float single[8];
            queries[n].flags = flags ? BTF_QUERY_NEAREST : 0;
            btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, single);
            for (uint32_t c = 0; c < channels[i]; c++)
              assert_memory_equal(&single[c], &columns[c][n], sizeof(float));
          }
        }
      }
      for (size_t n = 0; n < QUERIES; n++) {
        float got[8];
        queries[n].flags = n % 3 == 2 ? BTF_QUERY_NEAREST : 0;
        btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
        if (isa == 0) memcpy(reference[n], got, sizeof got);
        /* Factors are at most 1 and take 4 products and sums each, 8 factors and 8 texels at most: 48
         * roundings of 2^-24 of the largest possible value. */
        for (uint32_t c = 0; c < channels[i]; c++) {
          assert_true(isfinite(got[c]));
          assert_near(got[c], reference[n][c], most * 48.0 / 16777216.0);
        }
      }
      btf_model_release(model);
      btf_context_release(other);
    }
    btf_model_release(fitted);
    material_release(&m);
    test_context_done(ctx, &memory);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_blends_texels),
      cmocka_unit_test(test_batches_and_instruction_sets),
  };
  return btf_run("cmf_eval", tests);
}
