/* SPDX-License-Identifier: MIT */
/* Evaluation: interpolation against brute force, weights first or colours first, continuity, instruction
 * sets, batches, levels, threads. */
#include "test_views.h"

#include <pthread.h>

#include <btf/btf_sampling.h>

#include "dataset/dataset.h"

static test_memory memory;

enum { QUERIES = 300, LAYOUTS = 8 };

/* All storages, colours on both sides, with and without means, even and uneven numbers of terms. */
static const char *const layouts[LAYOUTS] = {"components=8 storage=f16",
                                             "components=8 storage=f32",
                                             "components=8 storage=q8",
                                             "components=5 storage=f16 color=texels",
                                             "components=3 storage=f32 color=texels mean=false",
                                             "components=8 storage=q8 color=texels",
                                             "components=9 storage=f16 budget=adaptive mean=false",
                                             "components=2 storage=f32 budget=adaptive color=texels"};

/* Queries of all kinds: random, at samples, on texel centres, repeated directions, outside of every domain.
 */
static void make_queries(const btf_dirset *set, btf_query *queries) {
  const float *xyz = btf_dirset_directions(set);
  const uint32_t count = btf_dirset_count(set);
  for (uint32_t i = 0; i < QUERIES; i++) {
    btf_query *q = &queries[i];
    memset(q, 0, sizeof *q);
    test_random_direction(q->light);
    test_random_direction(q->view);
    if (i % 5 == 1) memcpy(q->light, xyz + 3 * (size_t)(i % count), sizeof q->light);
    if (i % 7 == 1) memcpy(q->view, xyz + 3 * (size_t)(i / 2 % count), sizeof q->view);
    if (i % 3 == 0 && i > 0) {
      memcpy(q->light, q[-1].light, sizeof q->light);
      if (i % 2 == 0) memcpy(q->view, q[-1].view, sizeof q->view);
    }
    q->uv[0] = i % 4 == 2 ? 0.5f / 12.0f : 4.0f * test_random() - 2.0f;
    q->uv[1] = 4.0f * test_random() - 2.0f;
    if (i % 4 > 1) q->lod = 6.0f * test_random() - 1.0f;
  }
}

/* The colours of all samples around a query, blended in double. */
static void brute_force(const btf_model *model, const material *m, uint32_t wrap, const btf_query *q,
                        double *out) {
  btf_interp light, view;
  btf_level_pair level;
  btf_dirset_locate(m->directions, q->light, &light);
  btf_dirset_locate(m->directions, q->view, &view);
  btf_sampling_levels(q->lod, pvpca_state(model)->layout.levels, &level);
  for (uint32_t c = 0; c < m->channels; c++) out[c] = 0.0;
  for (uint32_t k = 0; k < 2; k++) {
    btf_bilinear at;
    btf_sampling_bilinear(q->uv[0], q->uv[1], btf_sampling_level_size(m->width, level.level[k]),
                          btf_sampling_level_size(m->height, level.level[k]), wrap, &at);
    for (uint32_t i = 0; i < 9; i++)
      for (uint32_t t = 0; t < 4; t++) {
        const double weight = (double)level.weight[k] * (double)light.weight[i % 3] *
                              (double)view.weight[i / 3] * (double)at.wx[t % 2] * (double)at.wy[t / 2];
        float value[64];
        if (weight == 0.0) continue;
        btf_model_texel(model, level.level[k], at.x[t % 2], at.y[t / 2], light.index[i % 3],
                        view.index[i / 3], value);
        for (uint32_t c = 0; c < m->channels; c++) out[c] += weight * (double)value[c];
      }
  }
}

/* Bounds the float rounding of an evaluation: every product of a light, a texel and their weights is rounded
 * a few times and added up with the others: (3 views x columns + 20) halves of eps of the sum of absolute
 * products, whose stored factors are at most 1 (f32, f16) or 127 steps. */
static double rounding_bound(const btf_model *model) {
  const btfi_pvpca_state *s = pvpca_state(model);
  const double unit = s->layout.storage == PVPCA_Q8 ? 127.0 : 1.0;
  double largest = 0.0;
  for (uint32_t v = 0; v < s->layout.views; v++) {
    double sum = (double)s->views[v].mean_scale;
    for (uint32_t i = 0; i < s->views[v].terms; i++) sum += (double)s->scales[s->views[v].padded_start + i];
    largest = fmax(largest, sum * unit);
  }
  return (3.0 * (s->layout.padded + 1.0) + 20.0) * ldexp(1.0, -24) * largest;
}

/* STAR eq. 20 = eq. 19, and INT01, INT06, ANA07, REN12: weights blended first, then eigen-textures, then
 * their product, is the blend of the colours of 3 lights x 3 views x 4 texels x 2 levels. */
static void test_interpolation(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  btf_context *ctx = test_context(&memory);
  const uint32_t channels[] = {3, 1, 5, 64};
  double worst = 0.0, relative = 0.0;
  for (uint32_t i = 0; i < 4; i++)
    for (uint32_t k = 0; k < LAYOUTS; k++) {
      const uint32_t wrap = (i + k) % 2 ? BTF_WRAP_CLAMP : BTF_WRAP_PERIODIC;
      material m = material_create(ctx, MATERIAL_GLOSSY, i == 3 ? "grid:3x1" : "grid:5x3", 12, 7, channels[i],
                                   true, wrap);
      btf_model *model = pvpca_fit(ctx, &m, layouts[k]);
      const double bound = 2.0 * rounding_bound(model); /* of both ways */
      make_queries(m.directions, queries);
      for (uint32_t n = 0; n < QUERIES; n++) {
        double expected[64];
        float got[64];
        btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
        brute_force(model, &m, wrap, &queries[n], expected);
        for (uint32_t c = 0; c < channels[i]; c++) {
          const double difference = fabs((double)got[c] - expected[c]);
          worst = fmax(worst, difference / bound);
          relative = fmax(relative, difference / fmax(1.0, fabs(expected[c])));
          if (difference > bound)
            fail_msg("%s, %u channels, query %u: %.9g instead of %.9g within %.3g", layouts[k], channels[i],
                     n, (double)got[c], expected[c], bound);
        }
      }
      btf_model_release(model);
      material_release(&m);
    }
  print_message("largest difference %.2g, %.2g of the bound\n", relative, worst);
  assert_true(relative <= 1e-6); /* INT06, REN12 */
  test_context_done(ctx, &memory);
}

/* INT01: at measured directions and texel centres the samples themselves; a constant stays one everywhere. */
static void test_exact_at_samples(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 8, 4, 3, true, BTF_WRAP_PERIODIC);
  const float *xyz = btf_dirset_directions(m.directions);
  btf_model *model = pvpca_fit(ctx, &m, "components=45 storage=f32"); /* full rank: 32 texels */
  for (uint32_t light = 0; light < 15; light++)
    for (uint32_t view = 0; view < 15; view++)
      for (uint32_t t = 0; t < 32; t++) {
        btf_query q = {{0}, {0}, {((float)(t % 8) + 0.5f) / 8.0f, ((float)(t / 8) + 0.5f) / 4.0f}, 0.0f, 0};
        float got[3];
        memcpy(q.light, xyz + 3 * (size_t)light, sizeof q.light);
        memcpy(q.view, xyz + 3 * (size_t)view, sizeof q.view);
        btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
        /* Float sums of 32 terms of at most about 1. */
        for (uint32_t c = 0; c < 3; c++)
          assert_near(got[c], material_sample(&m, t % 8, t / 8, light, view, c), 4e-6);
      }
  btf_model_release(model);
  material_release(&m);
  m = material_create(ctx, MATERIAL_CONSTANT, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
  model = pvpca_fit(ctx, &m, "components=2 storage=f32");
  make_queries(m.directions, queries);
  for (uint32_t n = 0; n < QUERIES; n++) {
    float got[3];
    btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
    for (int c = 0; c < 3; c++) assert_near(got[c], 0.1 + 0.07 * c, 1e-6);
  }
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void from_parabolic(double x, double y, float d[3]) {
  const double r = x * x + y * y;
  d[0] = (float)(2.0 * x / (1.0 + r));
  d[1] = (float)(2.0 * y / (1.0 + r));
  d[2] = (float)((1.0 - r) / (1.0 + r));
}

/* INT09: crossing any edge of the triangulation of views changes the value by no more than a linear function
 * on the two triangles can: a step of 2 d times the range of values over the smaller height. */
static void test_continuity(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:8x3", 4, 4, 3, true, BTF_WRAP_PERIODIC);
  const float *xyz = btf_dirset_directions(m.directions);
  uint32_t triangles, crossed = 0;
  const uint32_t *corner = btf_dirset_triangles(m.directions, &triangles);
  btf_model *model = pvpca_fit(ctx, &m, "components=4 storage=f32");
  double range = 0.0;
  for (uint32_t pair = 0; pair < m.count * m.count; pair++)
    for (uint32_t t = 0; t < 16; t++) {
      float value[3];
      btf_model_texel(model, 0, t % 4, t / 4, pair % m.count, pair / m.count, value);
      for (int c = 0; c < 3; c++) range = fmax(range, fabs((double)value[c]));
    }
  range *= 2.0; /* values may be negative */
  for (uint32_t t = 0; t < triangles; t++)
    for (uint32_t e = 0; e < 3; e++) {
      double p[3][2];
      for (uint32_t k = 0; k < 3; k++) {
        const float *d = xyz + 3 * (size_t)corner[3 * t + (e + k) % 3];
        p[k][0] = (double)d[0] / (1.0 + (double)d[2]);
        p[k][1] = (double)d[1] / (1.0 + (double)d[2]);
      }
      const double ex = p[1][0] - p[0][0], ey = p[1][1] - p[0][1], length = hypot(ex, ey);
      /* The least height of a triangle of this set, from its area and longest side. */
      const double area = fabs(ex * (p[2][1] - p[0][1]) - ey * (p[2][0] - p[0][0]));
      const double longest = fmax(length, fmax(hypot(p[2][0] - p[0][0], p[2][1] - p[0][1]),
                                               hypot(p[2][0] - p[1][0], p[2][1] - p[1][1])));
      const double height = area / longest, step = 1e-4;
      for (int k = 1; k < 4; k++) {
        const double x = p[0][0] + ex * k / 4.0, y = p[0][1] + ey * k / 4.0;
        btf_query a = {{0.3f, 0.2f, 0.9327379f}, {0}, {0.3f, 0.7f}, 0.0f, 0}, b = a;
        float va[3], vb[3];
        from_parabolic(x - step * ey / length, y + step * ex / length, a.view);
        from_parabolic(x + step * ey / length, y - step * ex / length, b.view);
        if (a.view[2] <= 0.0f || b.view[2] <= 0.0f) continue;
        btf_model_eval_as(model, &a, BTF_VALUE_STORED, va);
        btf_model_eval_as(model, &b, BTF_VALUE_STORED, vb);
        /* Neighbours of this set have heights within a factor of 4 of each other; floats beside. */
        for (int c = 0; c < 3; c++) assert_near(va[c], vb[c], 2.0 * step * range * 4.0 / height + 1e-5);
        crossed++;
      }
    }
  assert_true(crossed >= 3 * triangles);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Batches of many lengths equal single queries bit for bit, hostile queries among them. */
static void test_batch_equals_single(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float results[64][QUERIES];
  float *out[64];
  const float strange[] = {NAN, INFINITY, -INFINITY, 1e38f, -1e-42f, 0.0f, -1.0f};
  const char *const sets[] = {"scalar", "avx2"};
  for (int c = 0; c < 64; c++) out[c] = results[c];
  for (size_t isa = 0; isa < 2; isa++) {
    btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
    btf_context *ctx;
    desc.isa = sets[isa];
    if (btf_context_create(&desc, &ctx) != BTF_OK) continue;
    for (uint32_t k = 0; k < LAYOUTS; k++) {
      const uint32_t channels = 1 + k % 6;
      material m =
          material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, channels, true, BTF_WRAP_PERIODIC);
      btf_model *model = pvpca_fit(ctx, &m, layouts[k]);
      make_queries(m.directions, queries);
      for (uint32_t n = 0; n < QUERIES; n += 9) {
        float *const fields = (float *)(void *)&queries[n];
        fields[n / 9 % 9] = strange[n / 9 % 7];
      }
      for (uint32_t flags = 0; flags < 2; flags++)
        for (size_t count = 0; count <= QUERIES; count = count < 20 ? count + 3 : count + 93) {
          suite_eval_batch(model, queries, count, flags ? BTF_QUERY_NEAREST : 0, out);
          for (size_t n = 0; n < count; n++) {
            float single[64];
            queries[n].flags = flags ? BTF_QUERY_NEAREST : 0;
            btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, single);
            for (uint32_t c = 0; c < channels; c++)
              if (memcmp(&single[c], &results[c][n], sizeof single[c]) != 0)
                fail_msg("%s %s, query %zu of %zu, channel %u: %.9g and %.9g", sets[isa], layouts[k], n,
                         count, c, (double)single[c], (double)results[c][n]);
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
  static float reference[QUERIES][7];
  const char *const sets[] = {"scalar", "avx2", "avx512", "neon"};
  const uint32_t components[] = {1, 7, 8, 17, 64};
  btf_context *fit_ctx = test_context(&memory);
  for (uint32_t i = 0; i < 30; i++) {
    const uint32_t channels = i % 7 + 1;
    material m =
        material_create(fit_ctx, MATERIAL_RANK_5, "grid:6x3", 12, 12, channels, true, BTF_WRAP_PERIODIC);
    const char *const storages[] = {"f32", "f16", "q8"};
    char settings[96];
    for (size_t n = 0; n < (size_t)m.count * m.count * channels * 144; n++) m.samples[n] = test_random();
    snprintf(settings, sizeof settings, "components=%u storage=%s color=%s", components[i % 5],
             storages[i % 3], i & 1 ? "texels" : "lights");
    btf_model *fitted = pvpca_fit(fit_ctx, &m, settings);
    make_queries(m.directions, queries);
    for (size_t isa = 0; isa < 4; isa++) {
      btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
      btf_context *ctx;
      desc.isa = sets[isa];
      if (btf_context_create(&desc, &ctx) != BTF_OK) continue;
      btf_model *model = fmf_reload(fitted, ctx);
      const double bound = 2.0 * rounding_bound(model);
      for (uint32_t n = 0; n < QUERIES; n++) {
        float got[7];
        queries[n].flags = n % 3 == 2 ? BTF_QUERY_NEAREST : 0;
        btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
        if (isa == 0) memcpy(reference[n], got, sizeof got);
        for (uint32_t c = 0; c < channels; c++)
          if (!(fabs((double)got[c] - (double)reference[n][c]) <= bound))
            fail_msg("%s %s: %.9g instead of %.9g within %.3g", sets[isa], settings, (double)got[c],
                     (double)reference[n][c], bound);
      }
      btf_model_release(model);
      btf_context_release(ctx);
    }
    btf_model_release(fitted);
    material_release(&m);
  }
  test_context_done(fit_ctx, &memory);
}

/* INT05 and INT06: filtered eigen-textures and means decode to filtered colours. */
static void test_levels(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const uint32_t sizes[][2] = {{12, 7}, {16, 16}, {1, 9}};
  for (size_t i = 0; i < 6; i++) {
    const uint32_t width = sizes[i % 3][0], height = sizes[i % 3][1], texels = width * height;
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", width, height, 3, true, BTF_WRAP_PERIODIC);
    btf_model *model =
        pvpca_fit(ctx, &m, i < 3 ? "components=9 storage=f32" : "components=5 storage=f32 color=texels");
    const uint32_t levels = pvpca_state(model)->layout.levels;
    float *finest = malloc(texels * 3 * sizeof *finest), *filtered = malloc(texels * 3 * sizeof *filtered);
    assert_int_equal(levels, btfi_mip_count(width, height));
    for (uint32_t pair = 0; pair < 64; pair += 5) {
      for (uint32_t t = 0; t < texels; t++)
        btf_model_texel(model, 0, t % width, t / width, pair % 8, pair / 8, finest + 3 * (size_t)t);
      for (uint32_t level = 1; level < levels; level++) {
        const uint32_t level_width = btf_sampling_level_size(width, level),
                       level_height = btf_sampling_level_size(height, level);
        assert_ok(btfi_mip_filter(ctx, finest, 3, width, height, 3, level, filtered, 3));
        for (uint32_t t = 0; t < level_width * level_height; t++) {
          float got[3];
          btf_model_texel(model, level, t % level_width, t / level_width, pair % 8, pair / 8, got);
          /* Values around 1, a few roundings of float each. */
          for (uint32_t c = 0; c < 3; c++) assert_near(got[c], filtered[3 * t + c], 1e-6);
        }
      }
    }
    free(finest);
    free(filtered);
    btf_model_release(model);
    btf_model *few = pvpca_fit(ctx, &m, "components=3 levels=2");
    assert_int_equal(pvpca_state(few)->layout.levels, 2);
    btf_model_release(few);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* A model in a file evaluates as the one that was saved, bit for bit. */
static void test_saved_equals_fitted(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
  make_queries(m.directions, queries);
  for (uint32_t k = 0; k < LAYOUTS; k++) {
    btf_model *fitted = pvpca_fit(ctx, &m, layouts[k]), *loaded = fmf_reload(fitted, ctx);
    for (uint32_t n = 0; n < QUERIES; n++) {
      float a[3], b[3];
      btf_model_eval(fitted, &queries[n], a);
      btf_model_eval(loaded, &queries[n], b);
      assert_memory_equal(a, b, sizeof a);
    }
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
  for (int turn = 0; turn < 10; turn++)
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
  btf_model *model = pvpca_fit(ctx, &m, "components=8");
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

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_interpolation),       cmocka_unit_test(test_exact_at_samples),
      cmocka_unit_test(test_continuity),          cmocka_unit_test(test_batch_equals_single),
      cmocka_unit_test(test_instruction_sets),    cmocka_unit_test(test_levels),
      cmocka_unit_test(test_saved_equals_fitted), cmocka_unit_test(test_threads)};
  return btf_run("pvpca_eval", tests);
}
