/* SPDX-License-Identifier: MIT */
/* Evaluation: equation 7 by brute force, continuity, early exit, means and nearest samples, batches,
 * instruction sets, files, threads. */
#include "test_laplacian_fits.h"

#include <pthread.h>

static test_memory memory;
enum { QUERIES = 300 };
static const char *const storage_names[] = {"f16", "f32"};
static const char *const filter_names[] = {"mean", "binomial", "paper"};
static const char *const mean_names[] = {"phong", "table"};

/* Queries of all kinds: random, at samples, on texel centres, repeated directions, outside of every domain.
 */
static void make_queries(const btf_dirset *set, btf_query *queries) {
  const float *xyz = btf_dirset_directions(set);
  const uint32_t count = btf_dirset_count(set);
  for (uint32_t i = 0; i < QUERIES; i++) {
    btf_query q = {{0}, {0}, {0}, 0.0f, 0};
    test_random_direction(q.light);
    test_random_direction(q.view);
    if (i % 5 == 1) memcpy(q.light, xyz + 3 * (i % count), sizeof q.light);
    if (i % 7 == 1) memcpy(q.view, xyz + 3 * (i / 2 % count), sizeof q.view);
    if (i % 3 == 0 && i > 0) memcpy(q.light, queries[i - 1].light, sizeof q.light);
    if (i % 6 == 0 && i > 0) memcpy(q.view, queries[i - 1].view, sizeof q.view);
    q.uv[0] = 4.0f * test_random() - 2.0f;
    q.uv[1] = 4.0f * test_random() - 2.0f;
    if (i % 4 == 2) q.uv[0] = 0.5f / 12.0f;
    if (i % 4 > 1) q.lod = 6.0f * test_random() - 1.0f;
    queries[i] = q;
  }
}

/* ---- equation 7 by definition ---- */

/* Index and share of the two neighbours of a position along an axis of n texels. */
static void neighbours(double u, uint32_t n, uint32_t wrap, int64_t index[2], double weight[2]) {
  if (wrap == BTF_WRAP_CLAMP) u = fmin(1.0, fmax(0.0, u));
  const double at = (u - floor(wrap == BTF_WRAP_CLAMP ? 0.0 : u)) * n - 0.5, below = floor(at);
  weight[1] = at - below;
  weight[0] = 1.0 - weight[1];
  for (int i = 0; i < 2; i++) {
    index[i] = (int64_t)below + i;
    if (wrap == BTF_WRAP_CLAMP)
      index[i] = index[i] < 0 ? 0 : index[i] >= n ? n - 1 : index[i];
    else
      index[i] = (index[i] + n) % n;
  }
}

static double stored(const btfi_laplacian_state *s, const unsigned char *row, uint32_t i) {
  float value;
  uint16_t half;
  if (s->head.storage == LAPLACIAN_F32) {
    memcpy(&value, row + 4 * (size_t)i, sizeof value);
    return value;
  }
  memcpy(&half, row + 2 * (size_t)i, sizeof half);
  /* IEEE half by its parts. */
  const int exponent = half >> 10 & 31, mantissa = half & 1023;
  const double magnitude = exponent == 0 ? ldexp(mantissa, -24) : ldexp(1024 + mantissa, exponent - 25);
  return half & 0x8000 ? -magnitude : magnitude;
}

/* Weight j of level k at (u, v). The paper's filter reads the nearest texel, as each of the nearest finest
 * texels sees it. */
static double weight_at(const btfi_laplacian_state *s, uint32_t k, uint32_t j, double u, double v) {
  const bool paper = s->grid.filter == LAPLACIAN_PAPER_FILTER;
  const uint32_t from = paper ? 0 : k;
  int64_t x[2], y[2];
  double wx[2], wy[2], sum = 0.0;
  neighbours(u, s->grid.width[from], s->grid.wrap, x, wx);
  neighbours(v, s->grid.height[from], s->grid.wrap, y, wy);
  for (int i = 0; i < 4; i++) {
    int64_t tx = x[i % 2], ty = y[i / 2];
    if (paper) {
      tx = (int64_t)floor(((double)tx + 0.5) / s->grid.width[0] * s->grid.width[k]);
      ty = (int64_t)floor(((double)ty + 0.5) / s->grid.height[0] * s->grid.height[k]);
    }
    const unsigned char *row =
        s->weights[k] + (uint64_t)(ty * s->grid.width[k] + tx) * s->layout.texel_bytes[k];
    sum += wx[i % 2] * wy[i / 2] * stored(s, row, j);
  }
  return sum;
}

static double clamp(double x, double low, double high) {
  return fmin(high, fmax(low, x));
}

/* *magnitude: the sum of absolute values of all products. */
static void equation_7(const btf_model *model, const btf_dirset *set, const btf_query *q, double rgb[3],
                       double *magnitude) {
  const btfi_laplacian_state *s = laplacian_state(model);
  const double lambda = clamp(q->lod, 0.0, s->grid.levels - 1.0);
  double ycc[3] = {0.0, 0.0, 0.0};
  btf_interp light, view;
  btf_dirset_locate(set, q->light, &light);
  btf_dirset_locate(set, q->view, &view);
  *magnitude = 1.0;
  for (uint32_t k = 0; k < s->grid.levels; k++) {
    const double w = clamp(1.0 - lambda + k, 0.0, 1.0);
    for (uint32_t c = 0, j = 0; c < 3; c++)
      for (uint32_t i = 0; i < s->head.count[k][c]; i++, j++) {
        double eigen = 0.0;
        for (int n = 0; n < 9; n++)
          eigen += (double)light.weight[n % 3] * view.weight[n / 3] *
                   stored(s,
                          s->eigen + ((uint64_t)view.index[n / 3] * s->layout.lights + light.index[n % 3]) *
                                         s->layout.row_bytes,
                          s->layout.first[k] + j);
        const double scale = s->scale[c * s->scale_stride + s->layout.first[k] + j];
        ycc[c] += w * eigen * weight_at(s, k, j, q->uv[0], q->uv[1]) * scale;
        *magnitude += fabs(scale);
      }
  }
  if (s->head.mean == LAPLACIAN_PHONG) {
    double half[3], length = 0.0;
    for (int k = 0; k < 3; k++) {
      half[k] = (double)q->light[k] + q->view[k];
      length += half[k] * half[k];
    }
    ycc[0] += s->head.phong.ka + s->head.phong.kd * q->light[2] +
              s->head.phong.ks * pow(half[2] / sqrt(length), s->head.phong.alpha);
    ycc[1] += s->head.chroma[0];
    ycc[2] += s->head.chroma[1];
  }
  rgb[0] = ycc[0] + 1.402 * ycc[2];
  rgb[1] = ycc[0] - 0.344136286 * ycc[1] - 0.714136286 * ycc[2];
  rgb[2] = ycc[0] + 1.772 * ycc[1];
}

/* LAP12, T21: for all filters, wraps, storages, means, at the levels of detail that T21 names among others.
 * Each product is rounded some 20 times to 6e-8, and the sum once for each of its values; the power of N.H
 * turns an error of 1e-7 of its base into up to alpha times that. Positions are floats: texels are met with
 * an error of u width 2^-24. */
static void test_equation_7(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static const float lods[] = {0.0f, 0.5f, 1.0f, 4.0f};
  btf_context *ctx = test_context(&memory);
  for (uint32_t kind = 0; kind < 24; kind++) {
    const uint32_t filter = kind % 3, wrap = kind / 3 % 2, storage = kind / 6 % 2, mean = kind / 12;
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", kind % 4 == 1 ? 13 : 16,
                                 kind % 4 == 1 ? 7 : 16, 3, true, wrap);
    char settings[128];
    snprintf(settings, sizeof settings, "y=6 levels=25 filter=%s storage=%s mean=%s", filter_names[filter],
             storage_names[storage], mean_names[mean]);
    btf_model *model = laplacian_fit(ctx, &m, settings);
    const double alpha = laplacian_state(model)->head.phong.alpha;
    make_queries(m.directions, queries);
    for (uint32_t n = 0; n < QUERIES; n++) {
      double expected[3], magnitude;
      float got[3];
      if (n % 2 == 0) queries[n].lod = lods[n / 2 % 4];
      btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
      equation_7(model, m.directions, &queries[n], expected, &magnitude);
      const double tolerance = magnitude * 80.0 * 6e-8 * 2.0 + 2.0 * alpha * 2e-7;
      for (uint32_t c = 0; c < 3; c++)
        if (!(fabs(got[c] - expected[c]) <= tolerance))
          fail_msg("%s, query %u: %.9g instead of %.9g within %.3g", settings, n, got[c], expected[c],
                   tolerance);
    }
    btf_model_release(model);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* The weight of a level by T21. */
static void test_level_weights(void **unused) {
  (void)unused;
  const struct {
    float lod, weight;
    uint32_t first;
  } cases[] = {{0.0f, 1.0f, 0}, {0.5f, 0.5f, 0},  {1.0f, 1.0f, 1}, {4.0f, 1.0f, 4},    {1.25f, 0.75f, 1},
               {9.0f, 1.0f, 4}, {-3.0f, 1.0f, 0}, {NAN, 1.0f, 0},  {INFINITY, 1.0f, 4}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    float weight;
    assert_int_equal(btfi_laplacian_first_level(cases[i].lod, 5, &weight), cases[i].first);
    assert_near(weight, cases[i].weight, 1e-7);
  }
}

/* LAP12: no jump at whole levels of detail: across one float of lambda, at most 1e-6 of values up to 2 (a
 * float of lambda is 4e-7 of a band whose values are below 1, and the rest is rounding). The last level is
 * the BRDF that all texels average to. */
static void test_continuity(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 16, 16, 3, true, BTF_WRAP_PERIODIC);
  for (uint32_t filter = 0; filter < LAPLACIAN_FILTERS; filter++) {
    char settings[128];
    snprintf(settings, sizeof settings,
             "y=64 cb=64 cr=64 levels=5 storage=f32 accuracy=1e-5 mean=table filter=%s",
             filter_names[filter]);
    btf_model *model = laplacian_fit(ctx, &m, settings);
    double largest = 0.0;
    for (int n = 0; n < 300; n++) {
      btf_query q = {{0}, {0}, {test_random(), test_random()}, 0.0f, 0};
      const float whole = (float)(n % 5);
      float got[3][3];
      test_random_direction(q.light);
      test_random_direction(q.view);
      for (int side = 0; side < 3; side++) {
        q.lod = side == 1 ? whole : nextafterf(whole, side == 0 ? -1.0f : 9.0f);
        btf_model_eval_as(model, &q, BTF_VALUE_STORED, got[side]);
      }
      for (int c = 0; c < 3; c++) {
        largest = fmax(largest, fabs((double)got[0][c] - got[1][c]));
        largest = fmax(largest, fabs((double)got[2][c] - got[1][c]));
      }
    }
    print_message("%s filter: largest jump %.3g\n", filter_names[filter], largest);
    assert_true(largest <= 1e-6);
    if (filter == LAPLACIAN_PAPER_FILTER) {
      btf_model_release(model);
      continue;
    }
    for (uint32_t pair = 0; pair < m.count * m.count; pair += 7) {
      const float *xyz = btf_dirset_directions(m.directions);
      btf_query q = {{0}, {0}, {test_random(), test_random()}, 4.0f, 0};
      float got[3];
      memcpy(q.light, xyz + 3 * (pair % m.count), sizeof q.light);
      memcpy(q.view, xyz + 3 * (pair / m.count), sizeof q.view);
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
      for (uint32_t c = 0; c < 3; c++) {
        double mean = 0.0;
        for (uint32_t t = 0; t < 256; t++)
          mean += material_sample(&m, t % 16, t / 16, pair % m.count, pair / m.count, c) / 256.0;
        assert_near(got[c], mean, 2e-6);
      }
    }
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* At the centre of a texel and sample directions, evaluation is the decoded sample of that level; between
 * centres of level 0 the paper's filter blends decoded samples. */
static void test_texels(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint32_t kind = 0; kind < 6; kind++) {
    const uint32_t filter = kind % 3, width = kind < 3 ? 16 : 22, height = kind < 3 ? 8 : 11;
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", width, height, 3, true, kind % 2);
    char settings[64];
    snprintf(settings, sizeof settings, "levels=25 filter=%s", filter_names[filter]);
    btf_model *model = laplacian_fit(ctx, &m, settings);
    const btfi_laplacian_state *s = laplacian_state(model);
    const float *xyz = btf_dirset_directions(m.directions);
    for (uint32_t n = 0; n < 500; n++) {
      const uint32_t k = n % s->grid.levels, x = n * 7 % s->grid.width[k], y = n * 3 % s->grid.height[k];
      const uint32_t light = n % m.count, view = n / 3 % m.count;
      btf_query q = {{0}, {0}, {0}, (float)k, n % 2 ? BTF_QUERY_NEAREST : 0};
      float texel[3], got[3];
      memcpy(q.light, xyz + 3 * light, sizeof q.light);
      memcpy(q.view, xyz + 3 * view, sizeof q.view);
      q.uv[0] = (float)((x + 0.5) / s->grid.width[k]);
      q.uv[1] = (float)((y + 0.5) / s->grid.height[k]);
      btf_model_texel(model, k, x, y, light, view, texel);
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
      for (int c = 0; c < 3; c++) assert_near(got[c], texel[c], 2e-6);
      if (filter != LAPLACIAN_PAPER_FILTER) continue;
      double expected[3] = {0.0, 0.0, 0.0};
      btf_bilinear at;
      q.uv[0] = test_random();
      q.uv[1] = test_random();
      q.lod = 0.0f;
      q.flags = 0;
      btf_sampling_bilinear(q.uv[0], q.uv[1], width, height, kind % 2, &at);
      for (int i = 0; i < 4; i++) {
        btf_model_texel(model, 0, at.x[i % 2], at.y[i / 2], light, view, texel);
        for (int c = 0; c < 3; c++) expected[c] += (double)at.wx[i % 2] * at.wy[i / 2] * texel[c];
      }
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
      for (int c = 0; c < 3; c++) assert_near(got[c], expected[c], 3e-6);
    }
    btf_model_release(model);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* LAP13: values and texels of levels below floor(lambda) are never read, which poisoned tables show, and the
 * number of values falls with every level. */
static void test_early_exit(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 16, 16, 3, true, BTF_WRAP_PERIODIC);
  btf_model *model = laplacian_fit(ctx, &m, "storage=f32 levels=4");
  const btfi_laplacian_state *s = laplacian_state(model);
  uint32_t touched = UINT32_MAX;
  for (uint32_t k = 0; k < 4; k++) {
    const uint32_t now = btfi_laplacian_values_touched(s, (float)k + 0.5f);
    const uint32_t levels_left = k < 3 ? 4 - k : 1;
    assert_true(now < touched);
    assert_true(now <= 12 * levels_left);
    touched = now;
  }
  for (uint32_t k = 1; k < 4; k++) {
    btf_query q = {{0.3f, 0.1f, 0.9486833f}, {-0.2f, 0.4f, 0.8944272f}, {0.31f, 0.77f}, (float)k, 0};
    float before[3], after[3];
    btf_model_eval_as(model, &q, BTF_VALUE_STORED, before);
    for (uint32_t pair = 0; pair < m.count * m.count; pair++) {
      float *row = (float *)(uintptr_t)(s->eigen + pair * s->layout.row_bytes);
      for (uint32_t i = 0; i < s->layout.first[k]; i++) row[i] = NAN;
    }
    memset((void *)(uintptr_t)s->weights[k - 1], 0xff, s->layout.weight_bytes[k - 1]);
    btf_model_eval_as(model, &q, BTF_VALUE_STORED, after);
    assert_memory_equal(before, after, sizeof before);
    assert_true(before[0] != 0.0f);
  }
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* LAP11: the paper's level of detail for a distance d at which a pixel covers d texels is the library's for
 * that footprint, and grows with it. */
static void test_lod_parameter(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:3x1", 64, 64, 3, true, BTF_WRAP_PERIODIC);
  btf_model *model = laplacian_fit(ctx, &m, "y=8");
  double before = 0.0;
  for (double d = 0.25; d < 100.0; d *= 1.1) {
    const float along_x[2] = {(float)(d / 64.0), 0.0f}, along_y[2] = {0.0f, (float)(d / 64.0)};
    const double lambda = fmin(4.0, fmax(log2(d), 0.0)), got = btf_model_lod(model, along_x, along_y);
    assert_near(got, lambda, 1e-5);
    assert_true(got >= before);
    before = got;
  }
  assert_true(before == 4.0);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* The largest step of luma between neighbours on a sweep of the light, with nearest samples, averaged over
 * positions.
 */
static double largest_step(const btf_model *model, float lod) {
  enum { POSITIONS = 25, STEPS = 1000 };
  double sum = 0.0;
  for (int p = 0; p < POSITIONS; p++) {
    float before = 0.0f;
    double largest = 0.0;
    for (int i = 0; i <= STEPS; i++) {
      const float angle = -1.2f + 2.4f * (float)i / STEPS;
      const btf_query q = {{sinf(angle), 0.05f, cosf(angle)},
                           {0.1f, 0.2f, 0.9746794f},
                           {0.1f + 0.2f * (float)(p % 5), 0.1f + 0.2f * (float)(p / 5)},
                           lod,
                           BTF_QUERY_NEAREST};
      float got[3];
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
      const float luma = btfi_laplacian_from_rgb(LAPLACIAN_Y, got[0], got[1], got[2]);
      if (i > 0) largest = fmax(largest, fabs((double)luma - before));
      before = luma;
    }
    sum += largest;
  }
  return sum / POSITIONS;
}

/* INT08, figure 4: with nearest samples an analytic mean steps far less along a sweep than a table of means.
 */
static void test_zigzag(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m =
      material_create(ctx, MATERIAL_TEXTURED_LAMBERT, "grid:10x5", 16, 16, 3, true, BTF_WRAP_PERIODIC);
  btf_model *phong = laplacian_fit(ctx, &m, "levels=5"),
            *table = laplacian_fit(ctx, &m, "levels=5 mean=table");
  for (int lod = 0; lod < 5; lod += 2) {
    const double smooth = largest_step(phong, (float)lod), steps = largest_step(table, (float)lod);
    print_message("lod %d: largest step %.4f with the analytic mean, %.4f with the table\n", lod, smooth,
                  steps);
    assert_true(smooth < (lod == 4 ? 0.05 : 0.6) * steps);
  }
  btf_model_release(phong);
  btf_model_release(table);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Batches of every length equal single queries bit for bit, hostile queries among them. */
static void test_batch_equals_single(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float results[3][QUERIES];
  float *out[3] = {results[0], results[1], results[2]};
  const float strange[] = {NAN, INFINITY, -INFINITY, 1e38f, -1e-42f, 0.0f, -1.0f};
  const char *const sets[] = {"scalar", "avx2"};
  const char *const settings[] = {"y=8", "y=3 cb=0 cr=1 storage=f32 filter=paper",
                                  "y=20 mean=table levels=2"};
  for (size_t isa = 0; isa < 2; isa++) {
    btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
    btf_context *ctx;
    desc.isa = sets[isa];
    if (btf_context_create(&desc, &ctx) != BTF_OK) continue;
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
    for (size_t i = 0; i < 3; i++) {
      btf_model *model = laplacian_fit(ctx, &m, settings[i]);
      make_queries(m.directions, queries);
      for (uint32_t n = 0; n < QUERIES; n += 9)
        ((float *)(void *)&queries[n])[n / 9 % 9] = strange[n / 9 % 7];
      for (uint32_t flags = 0; flags < 2; flags++)
        for (size_t count = 0; count <= QUERIES; count = count < 20 ? count + 1 : count + 70) {
          suite_eval_batch(model, queries, count, flags ? BTF_QUERY_NEAREST : 0, out);
          for (size_t n = 0; n < count; n++) {
            float single[3];
            queries[n].flags = flags ? BTF_QUERY_NEAREST : 0;
            btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, single);
            for (uint32_t c = 0; c < 3; c++)
              if (memcmp(&single[c], &results[c][n], sizeof single[c]) != 0)
                fail_msg("%s %s, query %zu of %zu: %.9g and %.9g", sets[isa], settings[i], n, count,
                         single[c], results[c][n]);
          }
        }
      btf_model_release(model);
    }
    material_release(&m);
    btf_context_release(ctx);
  }
}

/* Kernels on the very same payload agree with the scalar reference: each of a few dozen products is rounded a
 * few times to 6e-8 of at most its scale. */
static void test_instruction_sets(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  btf_context *ctx = test_context_with(&memory, "scalar", 1), *vector;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  desc.isa = "avx2";
  if (btf_context_create(&desc, &vector) != BTF_OK) {
    test_context_done(ctx, &memory);
    skip();
  }
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 16, 16, 3, true, BTF_WRAP_PERIODIC);
  make_queries(m.directions, queries);
  for (uint32_t y = 1; y < 40; y += 3)
    for (uint32_t storage = 0; storage < 2; storage++) {
      char settings[64];
      snprintf(settings, sizeof settings, "y=%u cb=%u cr=%u storage=%s levels=%u", y, y % 4, y % 3,
               storage_names[storage], 1 + y % 5);
      btf_model *scalar = laplacian_fit(ctx, &m, settings), *other = NULL;
      assert_ok(btf_model_save(scalar, test_path("isa.btfz"), 0, NULL, NULL));
      assert_ok(btf_model_load(vector, test_path("isa.btfz"), &other));
      const btfi_laplacian_state *s = laplacian_state(scalar);
      double sum = 1.0;
      for (uint32_t i = 0; i < 3 * s->scale_stride; i++) sum += fabs((double)s->scale[i]);
      for (uint32_t n = 0; n < QUERIES; n++) {
        float a[3], b[3];
        queries[n].flags = n % 3 == 2 ? BTF_QUERY_NEAREST : 0;
        btf_model_eval_as(scalar, &queries[n], BTF_VALUE_STORED, a);
        btf_model_eval_as(other, &queries[n], BTF_VALUE_STORED, b);
        for (int c = 0; c < 3; c++) assert_near(b[c], a[c], 2.0 * 40.0 * 6e-8 * sum);
      }
      btf_model_release(scalar);
      btf_model_release(other);
    }
  material_release(&m);
  btf_context_release(vector);
  test_context_done(ctx, &memory);
}

/* A model in a file evaluates as the one that was saved, bit for bit. */
static void test_saved_equals_fitted(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
  make_queries(m.directions, queries);
  const char *const settings[] = {"y=8", "mean=table storage=f32", "psnr=30"};
  for (size_t i = 0; i < 3; i++) {
    btf_model *fitted = laplacian_fit(ctx, &m, settings[i]), *loaded;
    assert_ok(btf_model_save(fitted, test_path("model.btfz"), 0, NULL, NULL));
    assert_ok(btf_model_load(ctx, test_path("model.btfz"), &loaded));
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
  for (int turn = 0; turn < 20; turn++)
    for (uint32_t n = 0; n < QUERIES; n++) btf_model_eval(r->model, &r->queries[n], r->results[n]);
  return NULL;
}

/* Four threads on one model get what one gets, and evaluation does not allocate. */
static void test_threads(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float results[4][QUERIES][3];
  reader_thread readers[4];
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
  btf_model *model = laplacian_fit(ctx, &m, "y=8");
  make_queries(m.directions, queries);
  const long allocations = memory.total_allocations;
  for (int i = 0; i < 4; i++) {
    readers[i] = (reader_thread){.model = model, .queries = queries, .results = results[i]};
    assert_int_equal(pthread_create(&readers[i].thread, NULL, read_all, &readers[i]), 0);
  }
  for (int i = 0; i < 4; i++) pthread_join(readers[i].thread, NULL);
  for (int i = 1; i < 4; i++) assert_memory_equal(results[0], results[i], sizeof results[0]);
  assert_int_equal(memory.total_allocations, allocations);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_equation_7),       cmocka_unit_test(test_level_weights),
      cmocka_unit_test(test_continuity),       cmocka_unit_test(test_texels),
      cmocka_unit_test(test_early_exit),       cmocka_unit_test(test_lod_parameter),
      cmocka_unit_test(test_zigzag),           cmocka_unit_test(test_batch_equals_single),
      cmocka_unit_test(test_instruction_sets), cmocka_unit_test(test_saved_equals_fitted),
      cmocka_unit_test(test_threads)};
  return btf_run("laplacian_eval", tests);
}
