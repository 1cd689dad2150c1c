/* SPDX-License-Identifier: MIT */
/* FAC10, FAC11: chained against homomorphic factorisation on traced materials, in floats and in bytes. */
#include "btf_test.h"

#include "synth/synth.h"

static test_memory memory;

enum { SIZE = 6 };

typedef struct errors {
  double rms, absolute, relative; /* root mean square; mean; mean of the relative ones over samples > 0 */
} errors;

static btf_dataset *trace(btf_context *ctx, const char *name) {
  btf_dirset *set;
  btf_dataset *ds;
  assert_ok(btf_dirset_create_named(ctx, "grid:10x5", &set));
  synth_desc d = {
      .name = name, .lights = set, .views = set, .width = SIZE, .height = SIZE, .spp = 4, .threads = 1};
  d.sample_type = BTF_SAMPLE_F32;
  d.order = BTF_ORDER_VLYXC;
  d.bounces = 1;
  assert_ok(synth_run(ctx, &d, test_path("traced.btfd"), NULL, NULL));
  assert_ok(btf_dataset_open(ctx, test_path("traced.btfd"), &ds));
  btf_dirset_release(set);
  return ds;
}

static errors measure(btf_context *ctx, const btf_dataset *ds, const char *method, const char *residue,
                      const char *sweeps, const char *storage) {
  const char *const settings[][2] = {{"method", method},   {"residue", residue}, {"sweeps", sweeps},
                                     {"storage", storage}, {"codebook", "0"},    {"levels", "1"}};
  btf_options *options;
  btf_model *model;
  errors e = {0.0, 0.0, 0.0};
  uint32_t positive = 0;
  enum { DIRECTIONS = 50, VALUES = DIRECTIONS * DIRECTIONS * 3 };
  float *abrdf = malloc(VALUES * sizeof *abrdf);
  assert_ok(btf_options_create(btf_codec_find(ctx, "cmf"), &options));
  for (size_t i = 0; i < 6; i++) assert_ok(btf_options_set(options, settings[i][0], settings[i][1]));
  assert_ok(btf_model_fit(ds, btf_codec_find(ctx, "cmf"), options, NULL, &model));
  for (uint32_t t = 0; t < SIZE * SIZE; t++) {
    assert_ok(btf_dataset_read_abrdf(ds, t % SIZE, t / SIZE, 1, abrdf));
    for (uint32_t p = 0; p < DIRECTIONS * DIRECTIONS; p++) {
      float out[3];
      btf_model_texel(model, 0, t % SIZE, t / SIZE, p % DIRECTIONS, p / DIRECTIONS, out);
      for (uint32_t c = 0; c < 3; c++) {
        const double truth = (double)abrdf[3 * p + c], d = fabs((double)out[c] - truth);
        e.rms += d * d;
        e.absolute += d;
        if (truth <= 0.0) continue;
        e.relative += d / truth;
        positive++;
      }
    }
  }
  e.rms = sqrt(e.rms / (VALUES * SIZE * SIZE));
  e.absolute /= VALUES * SIZE * SIZE;
  e.relative /= positive;
  free(abrdf);
  btf_model_release(model);
  btf_options_release(options);
  return e;
}

static void test_methods_on_materials(void **unused) {
  (void)unused;
  const char *const names[] = {"checker", "rings", "tissue"};
  for (int i = 0; i < 3; i++) {
    btf_context *ctx = test_context(&memory);
    btf_dataset *ds = trace(ctx, names[i]);
    errors chained[2], homomorphic[2], best;
    print_message("%s, 50 x 50 directions     RMS   mean abs.  mean rel.\n", names[i]);
    for (int bytes = 0; bytes < 2; bytes++) {
      const char *storage = bytes ? "u8" : "f32";
      chained[bytes] = measure(ctx, ds, "svd", "ratio", "0", storage);
      homomorphic[bytes] = measure(ctx, ds, "homomorphic", "ratio", "0", storage);
      print_message("  chained as in the paper, %s  %.4f  %.4f  %.3f\n", storage, chained[bytes].rms,
                    chained[bytes].absolute, chained[bytes].relative);
      print_message("  homomorphic, %s              %.4f  %.4f  %.3f\n", storage, homomorphic[bytes].rms,
                    homomorphic[bytes].absolute, homomorphic[bytes].relative);
    }
    best = measure(ctx, ds, "svd", "weighted", "1", "f32");
    print_message("  chained, weighted, f32       %.4f  %.4f  %.3f\n", best.rms, best.absolute,
                  best.relative);
    const double chained_drop = 20.0 * log10(chained[1].rms / chained[0].rms);
    print_message("  bytes: %+.2f dB chained, mean absolute error x %.2f and x %.2f homomorphic\n",
                  chained_drop, chained[1].absolute / chained[0].absolute,
                  homomorphic[1].absolute / homomorphic[0].absolute);
    assert_true(chained_drop <= 1.0);
    /* Mean absolute errors: a few samples near the horizon, which no product fits, rule the squared ones. The
     * paper's material is the checker; how far homomorphic factors range on the others depends on the texels
     * drawn. */
    const double lost = chained[1].absolute / chained[0].absolute;
    const double lost_by_logarithms = homomorphic[1].absolute / homomorphic[0].absolute;
    assert_true(lost < 1.05);
    assert_true(lost_by_logarithms > (i == 0 ? 1.5 : lost + 0.005));
    /* The least squares of the error itself, which the paper's quotient only approximates. */
    assert_true(best.rms <= chained[0].rms);
    if (i == 0) {
      assert_relative(chained[0].rms, homomorphic[0].rms, 0.2);
      assert_relative(chained[0].absolute, homomorphic[0].absolute, 0.2);
    }
    btf_dataset_release(ds);
    test_context_done(ctx, &memory);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_methods_on_materials)};
  return btf_run("cmf_materials", tests);
}
