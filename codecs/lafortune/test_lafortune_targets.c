/* SPDX-License-Identifier: MIT */
/* Targets: the fewest lobes whose decoded samples have the quality that was asked for. */
#include "test_lobes.h"

static test_memory memory;

/* Lobes around the mirrored light, back to the light and askew, so that each of them counts. */
static void plant_four_lobes(uint32_t x, uint32_t y, planted *out) {
  const double u = sin(0.7 * x) * 0.5 + 0.5, v = cos(0.9 * y) * 0.5 + 0.5;
  const planted p = {LAF_DIAGONAL,
                     4,
                     3,
                     {{-1.0, -1.0, 1.0, 30.0 + 10.0 * v},
                      {0.9, 1.0, 0.8, 8.0 + 2.0 * u},
                      {-1.0, 1.0, 0.4, 4.0},
                      {1.0, -1.0, 0.4, 5.0}},
                     {{0.1 + 0.1 * u, 0.2, 0.1 * v + 0.05},
                      {0.8, 0.6 - 0.2 * v, 0.4},
                      {0.4, 0.5, 0.3 + 0.1 * u},
                      {0.3, 0.2, 0.4},
                      {0.2, 0.3, 0.1 + 0.1 * u}}};
  *out = p;
}

static material four_lobes(btf_context *ctx) {
  test_seed(5);
  return material_create(ctx, plant_four_lobes, 0.03, "grid:8x4", 4, 3, 3, BTF_QUANTITY_BRDF,
                         BTF_WRAP_PERIODIC);
}

static size_t sample_count(const material *m) {
  return (size_t)m->count * m->count * m->channels * m->width * m->height;
}

static double rmse_of(const btf_model *model, const material *m) {
  return sqrt(lafortune_squared_error(model, m) / (double)sample_count(m));
}

/* For every number of lobes a target between what it and one lobe fewer reach: that number is taken, what is
 * decoded meets the target, and with a lobe fewer it does not. The peak is the lower edge of a bin a
 * thousandth wide, which makes a PSNR stricter by that. */
static void test_fewest_lobes(void **unused) {
  (void)unused;
  const char *const others[] = {"", "storage=f32 levels=1", "color=channel weights=cosine levels=2"};
  btf_context *ctx = test_context(&memory);
  material m = four_lobes(ctx);
  const double peak = suite_peak(m.samples, sample_count(&m));
  for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
    double reached[LAF_MAX_LOBES + 1] = {0.0};
    char settings[128];
    reached[0] = 1.1 * sqrt(material_energy(&m) / (double)sample_count(&m));
    for (uint32_t lobes = 1; lobes <= LAF_MAX_LOBES; lobes++) {
      snprintf(settings, sizeof settings, "lobes=%u %s", lobes, others[i]);
      btf_model *model = lafortune_fit(ctx, &m, settings);
      reached[lobes] = rmse_of(model, &m);
      btf_model_release(model);
    }
    print_message("%s: rmse of 1 to 4 lobes %.5f %.5f %.5f %.5f\n", others[i], reached[1], reached[2],
                  reached[3], reached[4]);
    for (uint32_t lobes = 1; lobes <= LAF_MAX_LOBES; lobes++)
      for (int psnr = 0; psnr < 2; psnr++) {
        const double target = sqrt(reached[lobes] * reached[lobes - 1]);
        assert_true(reached[lobes] < (1.0 - 2e-3) * target);
        if (psnr)
          snprintf(settings, sizeof settings, "psnr=%.9f %s", 20.0 * log10(peak / target), others[i]);
        else
          snprintf(settings, sizeof settings, "rmse=%.9g lobes=4 %s", target, others[i]);
        btf_model *model = lafortune_fit(ctx, &m, settings);
        assert_int_equal(lafortune_state(model)->layout.lobes, lobes);
        assert_true(rmse_of(model, &m) <= target);
        assert_true(reached[lobes - 1] > target);
        btf_model_release(model);
      }
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Of two targets the stricter one counts, whichever that is. */
static void test_stricter_target(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = four_lobes(ctx);
  const double peak = suite_peak(m.samples, sample_count(&m));
  for (int strict = 0; strict < 2; strict++) {
    char settings[128];
    const double loose_rmse = 0.5 * peak, strict_rmse = 0.035;
    snprintf(settings, sizeof settings, "rmse=%.9g psnr=%.9f levels=1", strict ? strict_rmse : loose_rmse,
             20.0 * log10(peak / (strict ? loose_rmse : strict_rmse)));
    btf_model *model = lafortune_fit(ctx, &m, settings);
    assert_true(rmse_of(model, &m) <= strict_rmse);
    assert_in_range(lafortune_state(model)->layout.lobes, 2, 4);
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void test_out_of_reach(void **unused) {
  (void)unused;
  const char *const settings[] = {"rmse=1e-6", "psnr=120 kind=ward", "rmse=1e-6 psnr=10"};
  suite_warnings warnings = {"was asked for", 0};
  btf_context *ctx = suite_context_counting(&warnings);
  material m = four_lobes(ctx);
  for (size_t i = 0; i < sizeof settings / sizeof *settings; i++) {
    char text[96];
    snprintf(text, sizeof text, "%s levels=1 starts=1 iterations=10", settings[i]);
    warnings.count = 0;
    btf_model *model = lafortune_fit(ctx, &m, text);
    assert_int_equal(lafortune_state(model)->layout.lobes, 4);
    assert_int_equal(warnings.count, 1);
    btf_model_release(model);
  }
  warnings.count = 0;
  btf_model_release(lafortune_fit(ctx, &m, "psnr=10 levels=1"));
  assert_int_equal(warnings.count, 0);
  material_release(&m);
  btf_context_release(ctx);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_fewest_lobes),
                                     cmocka_unit_test(test_stricter_target),
                                     cmocka_unit_test(test_out_of_reach)};
  return btf_run("lafortune_targets", tests);
}
