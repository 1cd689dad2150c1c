/* SPDX-License-Identifier: MIT */
/* Models: evaluation against the papers' formulas in double, batches against single queries, instruction
 * sets, levels, sizes, errors, strange data and budgets. */
#include "test_lobes.h"

#include <btf/btf_half.h>
#include <btf/btf_sampling.h>

static test_memory memory;

enum { QUERIES = 300 };

/* Sets of options that reach every path of fit and evaluation. */
static const char *const settings_list[] = {"",
                                            "lobes=1 storage=f32",
                                            "lobes=3 starts=1",
                                            "lobes=4 color=channel storage=f32 starts=1",
                                            "kind=full starts=1 iterations=20",
                                            "kind=full lobes=3 storage=f32 starts=1 iterations=10",
                                            "kind=phong starts=1",
                                            "kind=blinn_phong storage=f32",
                                            "kind=ward lobes=2 weights=log starts=1",
                                            "kind=lewis color=channel weights=cosine starts=1",
                                            "kind=ward lobes=3 storage=f32 starts=1 iterations=10",
                                            "psnr=25 rmse=0.02 levels=2 starts=1 iterations=20"};
enum { SETTINGS = sizeof settings_list / sizeof *settings_list };

/* Data of a material that no lobe fits exactly, of any number of channels. */
static material noisy(btf_context *ctx, const char *directions, uint32_t width, uint32_t height,
                      uint32_t channels, uint32_t quantity, uint32_t wrap) {
  test_seed(3);
  return material_create(ctx, plant_two_lobes, 0.05, directions, width, height, channels, quantity, wrap);
}

/* ---- evaluation ---- */

/* A stored record, decoded by the book. */
static void record_of(const btfi_lafortune_state *s, uint32_t level, uint32_t x, uint32_t y, uint32_t group,
                      planted *out) {
  const btfi_lafortune_layout *layout = &s->layout;
  const unsigned char *at = s->texels[level] +
                            ((size_t)y * s->level_width[level] + x) * layout->values * layout->value_bytes +
                            (size_t)group * layout->group_values * layout->value_bytes;
  double value[LAF_MAX_VARIABLES + 8 * LAF_MAX_ALBEDOS];
  for (uint32_t i = 0; i < layout->group_values; i++) {
    if (layout->storage == LAF_F16) {
      uint16_t half;
      memcpy(&half, at + 2 * i, sizeof half);
      value[i] = (double)btf_half_to_float(half);
    } else {
      float number;
      memcpy(&number, at + 4 * i, sizeof number);
      value[i] = (double)number;
    }
  }
  const double *next = value;
  out->kind = layout->kind;
  out->lobes = layout->lobes;
  out->channels = layout->group_channels;
  for (uint32_t j = 0; j < layout->lobes; j++)
    for (uint32_t i = 0; i < layout->shape; i++) out->shape[j][i] = *next++;
  for (uint32_t j = 0; j <= layout->lobes; j++)
    for (uint32_t c = 0; c < layout->group_channels; c++)
      out->albedo[j][c] = *next++ * (double)s->scale[level];
}

/* What evaluation may be off by: the rounding of a base (4 * 6e-8) and of a logarithm (2.1e-7) times the
 * exponent and the logarithm, which together stay below (2.4e-7 exponent + 2.1e-7 * 126 ln 2) where the lobe
 * is not 0; and the rounding of the weights, 1e-6. */
static double tolerance_of(const planted *p) {
  double exponent = 1.0;
  for (uint32_t j = 0; j < p->lobes; j++)
    exponent = fmax(exponent, p->shape[j][btfi_lafortune_shape_values(p->kind) - 1]);
  return 2.4e-7 * exponent + 2.1e-5;
}

/* The query's texels, evaluated for its own directions and blended, in double. */
static void by_the_book(const btf_model *model, uint32_t width, uint32_t height, uint32_t channels,
                        uint32_t wrap, const btf_query *q, double *out, double *tolerance) {
  const btfi_lafortune_state *s = lafortune_state(model);
  btf_texel_set texels;
  btf_sampling_texels(q->uv, q->lod, 0, width, height, wrap, s->levels, &texels);
  for (uint32_t c = 0; c < channels; c++) out[c] = tolerance[c] = 0.0;
  for (uint32_t t = 0; t < texels.count; t++)
    for (uint32_t c = 0; c < channels; c++) {
      planted p;
      record_of(s, texels.level[t], texels.x[t], texels.y[t], c / s->layout.group_channels, &p);
      const double f = planted_value(&p, c % s->layout.group_channels, q->light, q->view) *
                       (s->times_cosine ? (double)q->light[2] : 1.0);
      out[c] += (double)texels.weight[t] * f;
      tolerance[c] += (double)texels.weight[t] * f * (tolerance_of(&p) + 2e-6);
    }
}

static btf_query random_query(void) {
  btf_query q = {{0}, {0}, {0}, 0.0f, 0};
  test_random_direction(q.light);
  test_random_direction(q.view);
  /* The classical models' bounds at the horizon have a test of their own. */
  for (int i = 0; i < 2; i++) {
    float *d = i == 0 ? q.light : q.view;
    if (d[2] < 0.1f) d[2] = 0.1f;
    const float scale = 1.0f / sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (int k = 0; k < 3; k++) d[k] *= scale;
  }
  q.uv[0] = (float)(4.0 * test_random() - 2.0);
  q.uv[1] = (float)(4.0 * test_random() - 2.0);
  if (test_random() < 0.5) q.lod = (float)(4.0 * test_random() - 0.5);
  return q;
}

static void test_formula(void **unused) {
  (void)unused;
  const char *const sets[] = {"scalar", "avx2"};
  const uint32_t channel_counts[] = {3, 1, 3, 5};
  for (size_t isa = 0; isa < 2; isa++) {
    btf_context *ctx = test_context_with(&memory, sets[isa], 2);
    for (uint32_t i = 0; i < SETTINGS; i++) {
      const uint32_t channels = i == 0 ? 3 : channel_counts[i % 4],
                     wrap = i % 2 ? BTF_WRAP_CLAMP : BTF_WRAP_PERIODIC;
      material m = noisy(ctx, "grid:5x3", 5, 3, channels,
                         i % 3 == 1 ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF, wrap);
      btf_model *model = lafortune_fit(ctx, &m, settings_list[i]);
      for (int n = 0; n < QUERIES; n++) {
        const btf_query q = random_query();
        float got[64];
        double expected[64], tolerance[64];
        btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
        by_the_book(model, 5, 3, channels, wrap, &q, expected, tolerance);
        for (uint32_t c = 0; c < channels; c++)
          if (fabs((double)got[c] - expected[c]) > tolerance[c] + 1e-30)
            fail_msg("%s, %s, query %d, channel %u: %.9g instead of %.9g within %.3g", sets[isa],
                     settings_list[i], n, c, (double)got[c], expected[c], tolerance[c]);
      }
      btf_model_release(model);
      material_release(&m);
    }
    test_context_done(ctx, &memory);
  }
}

/* Bit for bit, for batches of many lengths, hostile queries among them; and 0 at and below the horizon. */
static void test_batch_equals_single(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float results[8][QUERIES];
  float *out[8];
  const float strange[] = {NAN, INFINITY, -INFINITY, 1e38f, -1e-42f, 0.0f, -1.0f};
  const char *const sets[] = {"scalar", "avx2"};
  for (int c = 0; c < 8; c++) out[c] = results[c];
  for (size_t isa = 0; isa < 2; isa++) {
    btf_context *ctx = test_context_with(&memory, sets[isa], 1);
    for (uint32_t i = 0; i < SETTINGS; i++) {
      const uint32_t channels = i % 2 ? 2 : 3;
      material m = noisy(ctx, "grid:4x2", 4, 3, channels, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
      btf_model *model = lafortune_fit(ctx, &m, settings_list[i]);
      for (int n = 0; n < QUERIES; n++) {
        queries[n] = random_query();
        float *const fields = (float *)(void *)&queries[n];
        if (n % 9 == 0) fields[n / 9 % 9] = strange[n / 9 % 7];
      }
      for (uint32_t flags = 0; flags < 2; flags++)
        for (size_t count = 0; count <= QUERIES; count = count < 20 ? count + 1 : count + 140) {
          suite_eval_batch(model, queries, count, flags ? BTF_QUERY_NEAREST : 0, out);
          for (size_t n = 0; n < count; n++) {
            float single[8];
            queries[n].flags = flags ? BTF_QUERY_NEAREST : 0;
            btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, single);
            for (uint32_t c = 0; c < channels; c++) {
              if (memcmp(&single[c], &results[c][n], sizeof single[c]) != 0)
                fail_msg("%s %s, query %zu of %zu, channel %u: %.9g and %.9g", sets[isa], settings_list[i], n,
                         count, c, (double)single[c], (double)results[c][n]);
              assert_true(isfinite(single[c]));
              if (!(queries[n].light[2] > 0.0f) || !(queries[n].view[2] > 0.0f))
                assert_true(single[c] == 0.0f);
            }
          }
        }
      btf_model_release(model);
      material_release(&m);
    }
    test_context_done(ctx, &memory);
  }
}

/* NEAREST and texel() are the record at the set's own directions. */
static void test_nearest(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = noisy(ctx, "grid:5x3", 6, 5, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  btf_model *model = lafortune_fit(ctx, &m, "");
  const float *xyz = btf_dirset_directions(m.directions);
  for (int n = 0; n < 100; n++) {
    btf_query q = random_query();
    float got[3], sample[3];
    q.flags = BTF_QUERY_NEAREST;
    const uint32_t light = btf_dirset_nearest(m.directions, q.light),
                   view = btf_dirset_nearest(m.directions, q.view);
    const uint32_t level = btf_sampling_nearest_level(q.lod, 3);
    const uint32_t x = btf_sampling_nearest(q.uv[0], 6u >> level, BTF_WRAP_PERIODIC),
                   y = btf_sampling_nearest(q.uv[1], 5u >> level, BTF_WRAP_PERIODIC);
    btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
    btf_model_texel(model, level, x, y, light, view, sample);
    assert_memory_equal(got, sample, sizeof got);
    /* At a texel's centre and measured directions nothing is left to interpolate. */
    q.flags = 0;
    q.lod = (float)level;
    q.uv[0] = ((float)x + 0.5f) / (float)(6u >> level);
    q.uv[1] = ((float)y + 0.5f) / (float)(5u >> level);
    memcpy(q.light, xyz + 3 * light, sizeof q.light);
    memcpy(q.view, xyz + 3 * view, sizeof q.view);
    btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
    assert_memory_equal(got, sample, sizeof got);
  }
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

static uint32_t s_lobes(const btf_model *model) {
  return lafortune_state(model)->layout.lobes;
}

/* Quotients of the classical models are held at the horizon: values stay finite and do not jump. */
static void test_horizon(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = noisy(ctx, "grid:5x3", 2, 2, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  for (uint32_t i = 0; i < SETTINGS; i++) {
    btf_model *model = lafortune_fit(ctx, &m, settings_list[i]);
    for (int n = 0; n < 60; n++) {
      btf_query q = {
          {1.0f, 0.0f, powf(10.0f, -0.6f * (float)n)}, {-1.0f, 0.0f, 1e-3f}, {0.3f, 0.3f}, 0.0f, 0};
      float f[3];
      btf_model_eval(model, &q, f);
      /* The data are below 5; a lobe may be e^4 times higher beyond them, and a quotient 50 or 6 times that
       * at 15 degrees. */
      for (int c = 0; c < 3; c++)
        if (!(f[c] >= 0.0f && f[c] < 5.0f * 55.0f * 50.0f * (float)s_lobes(model)))
          fail_msg("%s, light z %g: %g", settings_list[i], (double)q.light[2], (double)f[c]);
    }
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ---- fitting whole materials ---- */

static void plant_one_lobe(uint32_t x, uint32_t y, planted *out) {
  plant_two_lobes(x, y, out);
  out->lobes = 1;
}

/* A planted material comes back, T08: also when the data contain the cosine, as the same f. Halves: 2^-11 of
 * an exponent of up to 22 is felt as 22 * 2^-11 = 1 % of a lobe at most, which the albedos make up for at its
 * peak. */
static void test_planted_material(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const struct {
    const char *settings;
    double tolerance;
  } cases[] = {{"lobes=1 storage=f32 tolerance=1e-8 iterations=200", 1e-3},
               {"lobes=1 tolerance=1e-8 iterations=200", 4e-3},
               {"lobes=1 weights=cosine storage=f32 tolerance=1e-8 iterations=200", 1e-3},
               {"lobes=1 weights=log storage=f32 tolerance=1e-8 iterations=200", 1e-3},
               {"lobes=1 color=channel storage=f32 tolerance=1e-8 iterations=200", 1e-3},
               {"rmse=0.001 storage=f32 tolerance=1e-8 iterations=200", 1e-3}};
  for (int quantity = BTF_QUANTITY_BRDF; quantity <= BTF_QUANTITY_BRDF_COS; quantity++) {
    material m =
        material_create(ctx, plant_one_lobe, 0.0, "grid:8x4", 7, 5, 3, (uint32_t)quantity, BTF_WRAP_PERIODIC);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
      btf_model *model = lafortune_fit(ctx, &m, cases[i].settings);
      const double error = sqrt(lafortune_squared_error(model, &m) / material_energy(&m));
      if (error > cases[i].tolerance) fail_msg("%s: relative error %.3g", cases[i].settings, error);
      assert_int_equal(lafortune_state(model)->layout.lobes, 1);
      float f[3];
      planted p;
      const btf_query q = {{0.36f, 0.48f, 0.8f}, {-0.6f, 0.0f, 0.8f}, {2.5f / 7.0f, 3.5f / 5.0f}, 0.0f, 0};
      btf_model_eval(model, &q, f);
      plant_one_lobe(2, 3, &p);
      for (uint32_t c = 0; c < 3; c++)
        assert_relative((double)f[c], planted_value(&p, c, q.light, q.view), 5.0 * cases[i].tolerance);
      btf_model_release(model);
    }
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* ANA02, FOM06: N_t (3 + k (3 + 3 + 1)) values a level, and about 2 MB for 256 x 256 texels and two lobes.
 * ANA04: size and error of both colours. */
static void test_sizes(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = noisy(ctx, "grid:5x3", 9, 6, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  btfi_lafortune_layout layout;
  for (uint32_t lobes = 1; lobes <= 4; lobes++) {
    btfi_lafortune_layout_of(LAF_DIAGONAL, lobes, LAF_LUMINANCE, LAF_F16, 3, &layout);
    assert_int_equal(layout.values, 3 + lobes * (3 + 3 + 1));
    btfi_lafortune_layout_of(LAF_DIAGONAL, lobes, LAF_CHANNEL, LAF_F16, 3, &layout);
    assert_int_equal(layout.values, 3 * (1 + lobes * (3 + 1 + 1)));
    btfi_lafortune_layout_of(LAF_FULL, lobes, LAF_LUMINANCE, LAF_F16, 3, &layout);
    assert_int_equal(layout.values, 3 + lobes * (9 + 3 + 1));
  }
  btfi_lafortune_layout_of(LAF_DIAGONAL, 2, LAF_LUMINANCE, LAF_F16, 3, &layout);
  assert_int_equal(256 * 256 * layout.values * layout.value_bytes, 2228224);
  double error[2];
  for (int colour = 0; colour < 2; colour++) {
    btf_model *model = lafortune_fit(ctx, &m, colour ? "color=channel" : "color=luminance");
    const btfi_lafortune_state *s = lafortune_state(model);
    const uint64_t texels = 9 * 6 + 4 * 3 + 2 * 1 + 1;
    assert_int_equal(s->levels, 4);
    assert_int_equal(s->resident - sizeof *s, texels * s->layout.values * 2);
    error[colour] = sqrt(lafortune_squared_error(model, &m) / material_energy(&m));
    printf("two lobes, %s: %u values of a texel, relative error %.4f\n", colour ? "channel" : "luminance",
           s->layout.values, error[colour]);
    /* What the header says is what is decoded, and ANA13 is told of it: kernels are off by some 1e-6 of the
     * values, in either direction of an error of some hundredths. */
    assert_relative(s->head.energy, material_energy(&m), 1e-6);
    assert_near(sqrt(s->head.squared_error / s->head.energy), error[colour], 1e-6);
    btf_model_release(model);
  }
  /* More freedom, and the luminance fit as one of its points, but for other local minima. */
  assert_true(error[1] < 1.01 * error[0]);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Error of records at a level against the area averages of the samples; `averaged` replaces the level's
 * records by means of the finest records' values. */
static double level_error(const btf_model *model, const material *m, int averaged) {
  const btfi_lafortune_state *s = lafortune_state(model);
  const float *xyz = btf_dirset_directions(m->directions);
  double error = 0.0;
  for (uint32_t y = 0; y < m->height / 2; y++)
    for (uint32_t x = 0; x < m->width / 2; x++) {
      planted p, quarter;
      record_of(s, 1, x, y, 0, &p);
      if (averaged) {
        memset(p.shape, 0, sizeof p.shape);
        memset(p.albedo, 0, sizeof p.albedo);
        for (uint32_t t = 0; t < 4; t++) {
          record_of(s, 0, 2 * x + t % 2, 2 * y + t / 2, 0, &quarter);
          for (uint32_t j = 0; j <= p.lobes; j++) {
            for (uint32_t i = 0; j < p.lobes && i < 4; i++) p.shape[j][i] += 0.25 * quarter.shape[j][i];
            for (uint32_t c = 0; c < 3; c++) p.albedo[j][c] += 0.25 * quarter.albedo[j][c];
          }
        }
      }
      for (uint32_t v = 0; v < m->count; v++)
        for (uint32_t l = 0; l < m->count; l++)
          for (uint32_t c = 0; c < 3; c++) {
            double mean = 0.0;
            for (uint32_t t = 0; t < 4; t++)
              mean += 0.25 * (double)material_sample(m, 2 * x + t % 2, 2 * y + t / 2, l, v, c);
            const double left = planted_value(&p, c, xyz + 3 * l, xyz + 3 * v) - mean;
            error += left * left;
          }
    }
  return error;
}

/* INT04: a level's own fit is better than averages of parameters. */
static void test_level_refit(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m =
      material_create(ctx, plant_two_lobes, 0.0, "grid:8x4", 8, 6, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  btf_model *model = lafortune_fit(ctx, &m, "storage=f32 levels=2 starts=8");
  const double refit = level_error(model, &m, 0), averaged = level_error(model, &m, 1);
  printf("level 1: squared error %.4g of its own fit, %.4g of averaged parameters\n", refit, averaged);
  assert_true(refit < averaged);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ANA12: what a query costs, by kind; FOM10. */
static void test_cost(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = noisy(ctx, "grid:4x2", 2, 2, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  const char *const rising[] = {"kind=lewis", "lobes=1",           "lobes=2",
                                "lobes=3",    "lobes=3 kind=full", "lobes=3 kind=full color=channel"};
  btf_eval_cost cost = BTF_EVAL_COST_INIT, before = BTF_EVAL_COST_INIT;
  for (size_t i = 0; i < sizeof rising / sizeof *rising; i++) {
    btf_model *model = lafortune_fit(ctx, &m, rising[i]);
    assert_ok(btf_model_cost(model, 0, &cost));
    printf("%-34s %4.0f bytes in %.0f places, %5.0f operations\n", rising[i], cost.bytes, cost.rows,
           cost.flops);
    assert_true(cost.flops > before.flops && cost.bytes > before.bytes);
    assert_true(cost.rows == 4.0);
    if (i == 2) assert_true(cost.bytes == 4 * 34 && cost.values == 4 * 17);
    before = cost;
    assert_ok(btf_model_cost(model, BTF_QUERY_NEAREST, &cost));
    assert_true(4 * cost.flops == before.flops && 4 * cost.bytes == before.bytes);
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ANA12: of every kind, number of lobes and way with colours. A texel is read four times: the diffuse albedo,
 * and of each lobe its shape (of a diagonal matrix 3 and an exponent, of a full one 9, of Ward's two
 * roughnesses, of the others an exponent) and its albedo. Every lobe costs the same again, and more
 * parameters cost no less. */
static void test_cost_of_every_kind(void **unused) {
  static const struct {
    const char *name;
    uint32_t shape;
  } kinds[] = {{"lewis", 1}, {"phong", 1}, {"blinn_phong", 1}, {"ward", 2}, {"diagonal", 4}, {"full", 10}};
  enum { KINDS = 6, LOBES = 4 };
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = noisy(ctx, "grid:4x2", 2, 2, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  for (uint32_t by_channel = 0; by_channel < 2; by_channel++) {
    double flops[KINDS][LOBES];
    for (uint32_t k = 0; k < KINDS; k++)
      for (uint32_t lobes = 1; lobes <= LOBES; lobes++) {
        char settings[80];
        snprintf(settings, sizeof settings, "kind=%s lobes=%u color=%s levels=1 storage=f32", kinds[k].name,
                 lobes, by_channel ? "channel" : "luminance");
        btf_model *model = lafortune_fit(ctx, &m, settings);
        btf_eval_cost cost = BTF_EVAL_COST_INIT;
        assert_ok(btf_model_cost(model, 0, &cost));
        const uint32_t shapes = (by_channel ? 3 : 1) * lobes * kinds[k].shape, albedos = 3 * (1 + lobes);
        assert_true(cost.values == 4.0 * (shapes + albedos) && cost.bytes == 4.0 * cost.values);
        assert_true(cost.rows == 4.0);
        flops[k][lobes - 1] = cost.flops;
        btf_model_release(model);
      }
    for (uint32_t k = 0; k < KINDS; k++)
      for (uint32_t lobes = 1; lobes <= LOBES; lobes++) {
        const double *const of_kind = flops[k];
        if (lobes > 1) assert_true(of_kind[lobes - 1] > of_kind[lobes - 2]);
        if (lobes > 2)
          assert_near(of_kind[lobes - 1] - of_kind[lobes - 2], of_kind[1] - of_kind[0], 1e-9 * of_kind[0]);
        if (k > 0) assert_true(of_kind[lobes - 1] >= flops[k - 1][lobes - 1]);
        if (k > 3) assert_true(of_kind[lobes - 1] > flops[k - 1][lobes - 1]);
      }
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ---- strange data ---- */

static void plant_constant(uint32_t x, uint32_t y, planted *out) {
  plant_two_lobes(x, y, out);
  memset(out->albedo[1], 0, 4 * sizeof out->albedo[1]);
}

static void plant_nothing(uint32_t x, uint32_t y, planted *out) {
  plant_constant(x, y, out);
  memset(out->albedo, 0, sizeof out->albedo);
}

static void plant_negative(uint32_t x, uint32_t y, planted *out) {
  plant_constant(x, y, out);
  for (int c = 0; c < 8; c++) out->albedo[0][c] = -0.3;
}

static void plant_huge(uint32_t x, uint32_t y, planted *out) {
  plant_two_lobes(x, y, out);
  for (int j = 0; j < 3; j++)
    for (int c = 0; c < 8; c++) out->albedo[j][c] *= 1e30;
}

static void plant_tiny(uint32_t x, uint32_t y, planted *out) {
  plant_two_lobes(x, y, out);
  for (int j = 0; j < 3; j++)
    for (int c = 0; c < 8; c++) out->albedo[j][c] *= 1e-30;
}

static void test_strange_data(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const struct {
    plant_fn plant;
    const char *directions;
    uint32_t width, height, channels;
    double relative; /* largest relative error with two diagonal lobes */
  } cases[] = {{plant_constant, "grid:5x3", 3, 2, 3, 1e-3},  {plant_nothing, "grid:5x3", 3, 2, 3, 0.0},
               {plant_negative, "grid:5x3", 3, 2, 1, 1.001}, {plant_huge, "grid:5x3", 3, 5, 3, 0.05},
               {plant_tiny, "grid:5x3", 3, 5, 3, 0.05},      {plant_two_lobes, "one", 3, 3, 3, 1e-3},
               {plant_two_lobes, "grid:5x3", 1, 1, 3, 0.05}, {plant_two_lobes, "grid:3x1", 1, 3, 64, 0.05}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    material m = material_create(ctx, cases[i].plant, 0.0, cases[i].directions, cases[i].width,
                                 cases[i].height, cases[i].channels, BTF_QUANTITY_BRDF, BTF_WRAP_CLAMP);
    for (uint32_t k = 0; k < SETTINGS; k++) {
      btf_model *model = lafortune_fit(ctx, &m, settings_list[k]);
      const double energy = material_energy(&m), error = lafortune_squared_error(model, &m);
      /* A diffuse part alone would leave no more than the energy. */
      if (!(error <= 1.0001 * energy))
        fail_msg("case %zu, %s: error %g of %g", i, settings_list[k], error, energy);
      if (k == 0 && !(sqrt(error) <= cases[i].relative * sqrt(energy)))
        fail_msg("case %zu: relative error %g", i, sqrt(error / energy));
      btf_model_release(model);
    }
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* ---- jobs ---- */

static int warnings, infos;

static void count_messages(void *user, int32_t level, btf_status code, const char *message) {
  (void)user;
  (void)code;
  warnings += level == BTF_LOG_WARNING && strstr(message, "relative error") != NULL;
  infos += level == BTF_LOG_INFO && strstr(message, "relative error") != NULL;
}

/* ANA13: the error is told, and above `advise` the advice to take another codec. */
static void test_advice(void **unused) {
  (void)unused;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  desc.log = count_messages;
  assert_ok(btf_context_create(&desc, &ctx));
  material m = noisy(ctx, "grid:5x3", 3, 3, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  warnings = infos = 0;
  btf_model_release(lafortune_fit(ctx, &m, "advise=0.5"));
  assert_int_equal(warnings, 0);
  assert_int_equal(infos, 1);
  btf_model_release(lafortune_fit(ctx, &m, "advise=0.001"));
  assert_int_equal(warnings, 1);
  material_release(&m);
  btf_context_release(ctx);
}

/* Threads and budgets change nothing; a budget that is too small says what would do, and that does. */
static void test_budget_and_threads(void **unused) {
  (void)unused;
  static float reference[9 * 5 * 2 * 3], got[9 * 5 * 2 * 3];
  for (uint32_t threads = 1; threads <= 3; threads += 2) {
    btf_context *ctx = test_context_with(&memory, NULL, threads);
    material m = noisy(ctx, "grid:5x3", 9, 5, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    job.max_working_set = 1000;
    assert_status(lafortune_try_fit(ctx, m.ds, "", &job, &model), BTF_E_LIMIT);
    assert_null(model);
    const char *needed = strstr(btf_error_message(), "at least ");
    assert_non_null(needed);
    const uint64_t least = strtoull(needed + strlen("at least "), NULL, 10);
    for (int i = 0; i < 2; i++) {
      job.max_working_set = i == 0 ? least : 0;
      assert_ok(lafortune_try_fit(ctx, m.ds, "", &job, &model));
      for (uint32_t t = 0; t < 45; t++)
        for (uint32_t k = 0; k < 2; k++)
          btf_model_texel(model, 0, t % 9, t / 9, k, 3 + k, got + 3 * (2 * t + k));
      if (threads == 1 && i == 0) memcpy(reference, got, sizeof got);
      assert_memory_equal(got, reference, sizeof got);
      btf_model_release(model);
    }
    material_release(&m);
    test_context_done(ctx, &memory);
  }
}

static int32_t cancel_at_once(void *user, double fraction, const char *stage) {
  (void)fraction;
  (void)stage;
  ++*(int *)user;
  return 1;
}

static void test_cancel(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = noisy(ctx, "grid:8x4", 16, 16, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  btf_job job = BTF_JOB_INIT;
  btf_model *model;
  int calls = 0;
  job.progress = cancel_at_once;
  job.user = &calls;
  assert_status(
      lafortune_try_fit(ctx, m.ds, "starts=64 iterations=10000 tolerance=1e-9 lobes=4", &job, &model),
      BTF_E_CANCELLED);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Every allocation of fit and load fails in turn: a status, no model, no leak. */
static void test_allocation_failures(void **unused) {
  (void)unused;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  material m = noisy(ctx, "grid:3x2", 3, 2, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  const char *const settings[] = {"starts=1 iterations=2", "psnr=120 kind=ward starts=1 iterations=2"};
  for (size_t i = 0; i < 2; i++) {
    int finished = 0;
    for (long n = 1; n < 400 && !finished; n++) {
      btf_model *model;
      memory.fail_at = memory.total_allocations + n;
      const btf_status status = lafortune_try_fit(ctx, m.ds, settings[i], NULL, &model);
      memory.fail_at = 0;
      finished = status == BTF_OK;
      if (status != BTF_OK) {
        assert_int_equal(status, BTF_E_NOMEM);
        assert_null(model);
      }
      btf_model_release(model);
    }
    assert_true(finished);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_formula),
                                     cmocka_unit_test(test_batch_equals_single),
                                     cmocka_unit_test(test_nearest),
                                     cmocka_unit_test(test_horizon),
                                     cmocka_unit_test(test_planted_material),
                                     cmocka_unit_test(test_sizes),
                                     cmocka_unit_test(test_level_refit),
                                     cmocka_unit_test(test_cost),
                                     cmocka_unit_test(test_cost_of_every_kind),
                                     cmocka_unit_test(test_strange_data),
                                     cmocka_unit_test(test_advice),
                                     cmocka_unit_test(test_budget_and_threads),
                                     cmocka_unit_test(test_cancel),
                                     cmocka_unit_test(test_allocation_failures)};
  return btf_run("lafortune_eval", tests);
}
