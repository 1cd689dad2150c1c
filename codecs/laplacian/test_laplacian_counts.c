/* SPDX-License-Identifier: MIT */
/* How many levels and components: the stop rule, targets, and budgets of bytes. */
#include "test_laplacian_fits.h"

#include "container/container.h"
#include "model/model.h"

static test_memory memory;

/* LAP04: 4 x 4 is the last level of 64 x 64 for 8 components. */
static void test_stop_rule(void **unused) {
  (void)unused;
  const struct {
    uint32_t width, height, levels;
    const char *settings;
  } cases[] = {{64, 64, 5, "y=8"}, {64, 64, 6, "y=4"},     {64, 64, 2, "levels=2"}, {32, 4, 3, "y=8"},
               {1, 1, 1, "y=8"},   {8, 8, 4, "levels=25"}, {16, 16, 3, "psnr=10"},  {5, 7, 2, "y=2"}};
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:3x1", cases[i].width, cases[i].height, 3, true,
                                 BTF_WRAP_PERIODIC);
    btf_model *model = laplacian_fit(ctx, &m, cases[i].settings);
    btf_model_info info = BTF_MODEL_INFO_INIT;
    assert_ok(btf_model_describe(model, &info));
    assert_int_equal(info.levels, cases[i].levels);
    btf_model_release(model);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* A target is met by what is decoded, and at most a few per cent of the error is left unused where there are
 * many components to choose from. */
static void test_targets(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 16, 16, 3, true, BTF_WRAP_PERIODIC);
  const size_t samples = (size_t)m.count * m.count * 3 * 256;
  const double peak = suite_peak(m.samples, samples);
  const char *const others[] = {"", "filter=paper", "storage=f32 mean=table", "filter=binomial levels=2"};
  for (size_t i = 0; i < 4; i++)
    for (int psnr = 0; psnr < 2; psnr++) {
      char settings[128];
      const double rmse = psnr ? peak * pow(10.0, -34.0 / 20.0) : 0.02;
      snprintf(settings, sizeof settings, "%s max_components=64 %s", psnr ? "psnr=34" : "rmse=0.02",
               others[i]);
      btf_model *model = laplacian_fit(ctx, &m, settings);
      const double error = sqrt(laplacian_squared_error(model, &m) / (double)samples);
      print_message("%s: rmse %.5f of %.5f\n", settings, error, rmse);
      assert_true(error <= rmse);
      assert_true(error >= 0.9 * rmse);
      assert_relative(sqrt(laplacian_state(model)->head.squared_error / (double)samples), error, 1e-3);
      btf_model_release(model);
    }
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void test_target_out_of_reach(void **unused) {
  (void)unused;
  suite_warnings warnings = {"rmse", 0};
  btf_context *ctx = suite_context_counting(&warnings);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
  btf_model *model = laplacian_fit(ctx, &m, "rmse=1e-4 max_components=3");
  const btfi_laplacian_state *s = laplacian_state(model);
  for (uint32_t k = 0; k < s->grid.levels; k++) assert_int_equal(s->head.count[k][0], 3);
  assert_int_equal(warnings.count, 1);
  btf_model_release(model);
  material_release(&m);
  btf_context_release(ctx);
}

/* Neighbouring texels alike, as in photographs: most is in the coarse bands. And noise without any order. */
static void fill_smooth(material *m) {
  const float *xyz = btf_dirset_directions(m->directions);
  const size_t texels = (size_t)m->width * m->height;
  for (uint32_t pair = 0; pair < m->count * m->count; pair++)
    for (size_t i = 0; i < 3 * texels; i++) {
      const float *l = xyz + 3 * (pair % m->count), *v = xyz + 3 * (pair / m->count);
      const float x = (float)(i / 3 % m->width), y = (float)(i / 3 / m->width), c = (float)(i % 3);
      m->samples[pair * 3 * texels + i] =
          0.5f + 0.3f * sinf(0.39f * x + 2.0f * l[0] + c) * cosf(0.39f * y + 3.0f * v[1] * l[1]) +
          0.1f * sinf(3.0f * v[0] * x) * l[2];
    }
}

static void fill_noise(material *m) {
  const size_t samples = (size_t)m->count * m->count * 3 * m->width * m->height;
  for (size_t i = 0; i < samples; i++) m->samples[i] = test_random();
}

static uint64_t payload_bytes(const btf_model *model) {
  uint64_t bytes = 0;
  for (uint32_t i = 0; i < btfi_payload_chunk_count(model->payload); i++) {
    btfi_chunk chunk;
    assert_ok(btfi_payload_chunk(model->payload, i, &chunk));
    bytes += chunk.size;
  }
  return bytes;
}

/* WISH13: bytes spent where they help most make no larger a table and no larger an error than 8, 2, 2
 * components at every level; on materials that are not alike at all levels and in all channels, a smaller
 * one. */
static void test_adaptive_budget(void **unused) {
  (void)unused;
  const char *const names[] = {"glossy", "smooth", "noise"}, *const others[] = {"", " mean=table storage=f32",
                                                                                " filter=paper y=5 cb=0"};
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < 9; i++) {
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 16, 16, 3, true, BTF_WRAP_PERIODIC);
    if (i % 3 == 1) fill_smooth(&m);
    if (i % 3 == 2) fill_noise(&m);
    double error[2];
    uint64_t bytes[2];
    for (int adaptive = 0; adaptive < 2; adaptive++) {
      char settings[96];
      snprintf(settings, sizeof settings, "budget=%s%s", adaptive ? "adaptive" : "fixed", others[i / 3]);
      btf_model *model = laplacian_fit(ctx, &m, settings);
      bytes[adaptive] = payload_bytes(model);
      error[adaptive] = laplacian_squared_error(model, &m);
      btf_model_release(model);
    }
    print_message("%s%s: %llu and %llu bytes, error %.6g of the fixed one's\n", names[i % 3], others[i / 3],
                  (unsigned long long)bytes[0], (unsigned long long)bytes[1], sqrt(error[1] / error[0]));
    assert_true(bytes[1] <= bytes[0]);
    /* Decoding in the fit and here round in other orders, 1e-6 of values against errors of some hundredths.
     */
    assert_true(error[1] <= error[0] * (1.0 + 1e-3));
    assert_true(i % 3 == 2 || error[1] <= 0.9 * error[0]);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_stop_rule), cmocka_unit_test(test_targets),
                                     cmocka_unit_test(test_target_out_of_reach),
                                     cmocka_unit_test(test_adaptive_budget)};
  return btf_run("laplacian_counts", tests);
}
