/* SPDX-License-Identifier: MIT */
/* Chains of stages: how they are written, that their order and symmetry matter, data that are degenerate,
 * cancelling what is prepared for them. */
#include "test_cmf_bench.h"

#include "registry/registry.h"

static test_memory memory;

static void test_chains(void **unused) {
  (void)unused;
  btfi_cmf_settings s;
  assert_null(btfi_cmf_parse_chain("hd:3,io,h", &s));
  assert_int_equal(s.stage_count, 3);
  assert_int_equal(s.stage[0].terms, 3);
  assert_true(s.stage[2].mean);
  btfi_cmf_factor list[CMF_MAX_FACTORS];
  assert_int_equal(btfi_cmf_list_factors(&s, list), 9);
  assert_int_equal(list[8].projection, CMF_HALF);
  const char *const wrong[] = {"",      "hd,", "x",     "hd:0", "hd:9",
                               "hd:12", "h:2", "hd io", "id",   "io,io,io,io,io,io,io,io,io"};
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++)
    assert_non_null(btfi_cmf_parse_chain(wrong[i], &s));
}

/* A texel at an edge: one facet or the other is seen, depending on the view alone. */
static double edge_texel(const float l[3], const float v[3]) {
  const double left = fmax(0.0, 0.6 * (double)l[2] + 0.8 * (double)l[0]);
  const double right = fmax(0.0, 0.6 * (double)l[2] - 0.8 * (double)l[0]);
  const double seen = 1.0 / (1.0 + exp(-6.0 * (double)v[0]));
  return 0.05 + seen * left + (1.0 - seen) * right;
}
static double flat_texel(const float l[3], const float v[3]) {
  float h[3];
  btfi_cmf_half(l, v, h);
  return 0.3 + pow((double)h[2], 20.0);
}

/* FAC07: the order of stages matters. FAC08: factors of the light cannot stand for the view. */
static void test_order_and_symmetry(void **unused) {
  (void)unused;
  btfi_cmf_settings hd_io = settings_of_chain("hd,io"), io_hd = settings_of_chain("io,hd"),
                    plain = settings_of_chain("h,io");
  hd_io.resolution = io_hd.resolution = 16;
  const double last_original = plant_and_factor("ubo81", &hd_io, edge_texel);
  const double first_original = plant_and_factor("ubo81", &io_hd, edge_texel);
  print_message("hd,io: %.5f; io,hd: %.5f\n", last_original, first_original);
  assert_true(fabs(last_original - first_original) > 1e-3);
  const double separate = plant_and_factor("ubo81", &plain, edge_texel);
  const double flat_separate = plant_and_factor("ubo81", &plain, flat_texel);
  plain.symmetric = true;
  const double same = plant_and_factor("ubo81", &plain, edge_texel);
  const double flat_same = plant_and_factor("ubo81", &plain, flat_texel);
  print_message("edge: separate %.4f, symmetric %.4f; flat: %.4f, %.4f\n", separate, same, flat_separate,
                flat_same);
  assert_true(same > 1.05 * separate);
  assert_near(flat_same, flat_separate, 1e-3);
}

/* FAC08: an edge that factors of light and view on their own hold exactly, P(l) R(v): what is seen depends on
 * the view alone. A symmetric factor can do no better than the symmetric matrix of rank one nearest to P R^T.
 * Between the unit vectors p and r of these, with <p, r> = c, the symmetric part of p r^T has the eigenvalue
 * (1 + c) / 2, so that matrix leaves sqrt(1 - ((1 + c) / 2)^2) of the whole: no map can leave less at the
 * samples. */
static double edge_light(const float l[3]) {
  return 0.2 + 0.8 * (double)l[2];
}
static double edge_view(const float v[3]) {
  return 0.05 + 0.95 / (1.0 + exp(-8.0 * (double)v[0]));
}
static double edge_product(const float l[3], const float v[3]) {
  return edge_light(l) * edge_view(v);
}

static void test_edge_is_not_symmetric(void **unused) {
  (void)unused;
  btfi_cmf_settings s = settings_of_chain("io");
  s.edge = 128; /* no two directions share a texel: as exact as in test_terms_are_singular_pairs */
  bench b = bench_open("ubo81", &s);
  const float *xyz = btf_dirset_directions(b.set);
  double pp = 0.0, rr = 0.0, pr = 0.0;
  for (uint32_t i = 0; i < b.count; i++) {
    const double p = edge_light(xyz + 3 * i), r = edge_view(xyz + 3 * i);
    pp += p * p;
    rr += r * r;
    pr += p * r;
  }
  const double kept = 0.5 * (1.0 + pr / sqrt(pp * rr)), bound = sqrt(1.0 - kept * kept);
  bench_close(&b);
  const double separate = plant_and_factor("ubo81", &s, edge_product);
  s.symmetric = true;
  const double same = plant_and_factor("ubo81", &s, edge_product);
  print_message("an edge: separate %.1e, symmetric %.4f, at least %.4f\n", separate, same, bound);
  assert_true(bound > 0.1);
  assert_true(separate < 1e-6);
  /* Sums of 6561 floats of the same sign, and lookups in floats. */
  assert_true(same >= bound * (1.0 - 1e-5));
}

/* PAR05: cell (m, n) of a stage's matrix is one pair of directions, and that pair's projections are sample m
 * of the rows and n of the columns again, for every pair of projections and both kinds of tables. */
static uint32_t sample_of(const btfi_cmf_domain *domain, const float direction[3]) {
  btfi_cmf_tap tap;
  uint32_t best = 0;
  if (domain->native) return btf_dirset_nearest(domain->set, direction);
  btfi_cmf_map_locate(&domain->map, direction, &tap);
  for (uint32_t i = 1; i < 4; i++)
    if (tap.weight[i] > tap.weight[best]) best = i;
  return tap.index[best];
}

static bool direction_of_sample(const btfi_cmf_domain *domain, uint32_t sample, float direction[3]) {
  if (!domain->native) return btfi_cmf_map_direction(&domain->map, sample, direction);
  memcpy(direction, btf_dirset_directions(domain->set) + 3 * (size_t)sample, 3 * sizeof *direction);
  return true;
}

static void check_matrix(const char *chain, uint32_t grid) {
  btfi_cmf_settings s = settings_of_chain(chain);
  s.grid = grid;
  s.resolution = 12;
  bench b = bench_open("grid:8x4", &s);
  const btfi_cmf_stage_geometry *stage = &b.g->stage[0];
  uint32_t valid = 0;
  for (uint32_t m = 0; m < stage->rows; m++)
    for (uint32_t n = 0; n < stage->columns; n++) {
      float first[3], second[3], light[3], view[3], again[2][3];
      const bool exists = direction_of_sample(&stage->side[0].domain, m, first) &&
                          direction_of_sample(&stage->side[1].domain, n, second);
      if (!exists || !stage->stage.pair->invert(first, second, light, view)) {
        if (stage->cell_weight != NULL)
          assert_true(stage->cell_weight[(size_t)m * stage->columns + n] == 0.0f);
        continue;
      }
      stage->stage.pair->project(light, view, again[0], again[1]);
      if (sample_of(&stage->side[0].domain, again[0]) != m ||
          sample_of(&stage->side[1].domain, again[1]) != n)
        fail_msg("%s: cell %u, %u is another one's pair", chain, m, n);
      valid++;
    }
  /* Of the directions of the data every pair is there; of half vectors those that leave both above the
   * horizon. */
  if (stage->native) assert_int_equal(valid, b.count * b.count);
  assert_true(valid >= stage->rows);
  bench_close(&b);
}

static void test_matrix_is_invertible(void **unused) {
  static const char *const names[] = {"io", "oi", "ih", "oh", "hd", "dh"};
  (void)unused;
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    check_matrix(names[i], CMF_ANGULAR);
    check_matrix(names[i], CMF_PARABOLIC);
  }
}

/* FAC07: chains of more stages and of one-sided ones; several terms lower the error; FAC02: non-negative
 * terms. */
static void test_general_chains(void **unused) {
  (void)unused;
  const char *const chains[] = {"i,o", "h,io", "h,io:2", "h,io:3", "ih,oh", "h,d,io", "hd,io,ih"};
  double error[7];
  for (size_t i = 0; i < 7; i++) {
    for (uint32_t method = CMF_SVD; method <= CMF_NONNEGATIVE; method++)
      for (uint32_t average = CMF_VALID; average <= CMF_UNIFORM; average++) {
        btfi_cmf_settings s = settings_of_chain(chains[i]);
        s.method = method;
        s.average = average;
        s.residue = CMF_WEIGHTED;
        s.resolution = 12;
        s.grid = average == CMF_VALID ? CMF_ANGULAR : CMF_PARABOLIC;
        bench b = bench_open("grid:8x4", &s);
        bench_plant(&b, edge_texel);
        const double e = bench_factor(&b);
        /* What a constant leaves: every chain holds that and more. */
        double sum = 0.0, squares = 0.0;
        const double pairs = (double)b.count * b.count;
        for (uint32_t p = 0; p < b.count * b.count; p++) {
          sum += (double)b.abrdf[p];
          squares += (double)b.abrdf[p] * (double)b.abrdf[p];
        }
        const double constant = sqrt(1.0 - sum * sum / pairs / squares);
        print_message("%s, method %u, average %u: %.4f of %.4f\n", chains[i], method, average, e, constant);
        assert_true(e < constant);
        bench_expect_positive(&b);
        if (method == CMF_SVD && average == CMF_VALID) error[i] = e;
        bench_close(&b);
      }
  }
  assert_true(error[2] < 0.8 * error[1] && error[3] < error[2]);
}

/* Data that are 0, constant, negative or tiny, in one channel of several. */
static void test_degenerate_data(void **unused) {
  (void)unused;
  btfi_cmf_settings s = settings_of_chain("h,io:2");
  s.residue = CMF_WEIGHTED;
  s.sweeps = 2;
  bench b = bench_open("grid:6x3", &s);
  const uint32_t pairs = b.count * b.count, channels = 5;
  float *abrdf = malloc(pairs * channels * sizeof *abrdf);
  float *maps = malloc((size_t)b.g->factors * b.g->map_texels * channels * sizeof *maps);
  for (uint32_t p = 0; p < pairs; p++) {
    const float values[] = {0.0f, 0.25f, -1.0f, 1e-30f, p == 7 ? 1e30f : 0.0f};
    memcpy(abrdf + p * channels, values, sizeof values);
  }
  btfi_cmf_report report = {0};
  btfi_cmf_factor_abrdf(b.g, channels, abrdf, b.scratch, maps, &report);
  for (size_t i = 0; i < (size_t)b.g->factors * b.g->map_texels * channels; i++)
    assert_true(isfinite(maps[i]));
  for (uint32_t t = 0; t < b.g->map_texels; t++) assert_true(maps[t * channels] == 0.0f);
  free(abrdf);
  free(maps);
  bench_close(&b);
}

typedef struct reports {
  double last;
  long calls, cancel_at;
} reports;
static reports told;

static btf_status note_progress(const btf_job *job, double fraction, const char *stage) {
  (void)job;
  assert_string_equal(stage, "preparing");
  assert_true(fraction >= told.last && fraction <= 0.75);
  told.last = fraction;
  return ++told.calls == told.cancel_at ? BTF_E_CANCELLED : BTF_OK;
}

/* Every row of a table is a chance to cancel, which leaves nothing behind. */
static void test_preparing_can_be_cancelled(void **unused) {
  (void)unused;
  btfi_cmf_settings settings = settings_of_chain("hd,h,io");
  btf_host host = *btfi_host();
  host.progress = note_progress;
  settings.resolution = 6;
  settings.edge = 6;
  btf_status status = BTF_E_CANCELLED;
  for (long at = 1; status == BTF_E_CANCELLED; at++) {
    btf_context *ctx = test_context(&memory);
    btf_dirset *set;
    btfi_cmf_geometry *g;
    told = (reports){.last = 0.25, .cancel_at = at};
    assert_ok(btf_dirset_create_named(ctx, "grid:4x2", &set));
    status = btfi_cmf_geometry_create(&host, ctx, &settings, set, set, 1u << 30, NULL, 0.25, 0.75, &g);
    if (status == BTF_OK) {
      assert_int_equal(told.calls, 3 * 18); /* tables of 6 x 3: of hd, and twice of h */
      btfi_cmf_geometry_free(&host, ctx, g);
    } else {
      assert_null(g);
      assert_int_equal(told.calls, at);
    }
    btf_dirset_release(set);
    test_context_done(ctx, &memory);
  }
  assert_ok(status);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_chains),
      cmocka_unit_test(test_order_and_symmetry),
      cmocka_unit_test(test_edge_is_not_symmetric),
      cmocka_unit_test(test_matrix_is_invertible),
      cmocka_unit_test(test_general_chains),
      cmocka_unit_test(test_degenerate_data),
      cmocka_unit_test(test_preparing_can_be_cancelled),
  };
  return btf_run("cmf_chains", tests);
}
