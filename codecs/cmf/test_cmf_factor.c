/* SPDX-License-Identifier: MIT */
/* One ABRDF is factored as well as can be: against LAPACK, planted factors, and what resampling alone costs.
 */
#include <btf/btf_codec.h>

#include "test_cmf_bench.h"

#include "exact_svd.h"

static test_memory memory;
static uint64_t random_state = 1;

static float draw(void) {
  return (float)btf_random_unit(&random_state);
}

/* FAC01: J = 1. Data of rank K are exact and the squared error is the tail of LAPACK's singular values. A map
 * of edge 128 has no texel that two of the directions share, so that looking up gives the factors back. */
static void test_terms_are_singular_pairs(void **unused) {
  (void)unused;
  for (uint32_t terms = 1; terms <= 4; terms++)
    for (int exact = 0; exact < 2; exact++) {
      char chain[8];
      snprintf(chain, sizeof chain, "io:%u", terms);
      btfi_cmf_settings s = settings_of_chain(chain);
      s.edge = 128;
      bench b = bench_open("grid:6x4", &s);
      const uint32_t n = b.count;
      double *matrix = malloc(n * n * sizeof *matrix), energy = 0.0;
      float p[24][4], q[24][4];
      for (uint32_t i = 0; i < n; i++)
        for (int k = 0; k < 4; k++) {
          p[i][k] = 0.1f + draw();
          q[i][k] = 0.1f + draw();
        }
      for (uint32_t i = 0; i < n * n; i++) {
        b.abrdf[i] = exact ? 0.0f : draw();
        for (uint32_t k = 0; exact && k < terms; k++) b.abrdf[i] += p[i / n][k] * q[i % n][k];
        matrix[i] = (double)b.abrdf[i];
        energy += matrix[i] * matrix[i];
      }
      double *const sigma = exact_singular_values(matrix, n, n);
      const double tail = exact_tail(sigma, n, terms);
      const double error = bench_factor(&b);
      /* Floats: rounding of each sample and of the sums, a few eps of the norm; and power iterations that
       * stop at changes of 3e-7, whose effect on the error is quadratic. */
      assert_near(error, sqrt(tail / energy), 1e-6 + 1e-5 * sqrt(tail / energy));
      if (exact) assert_true(error < 1e-6);
      free(matrix);
      free(sigma);
      bench_close(&b);
    }
}

static double p_of(const float d[3]) {
  return 0.7 + 0.25 * (double)d[0] - 0.15 * (double)d[1] + 0.2 * (double)(d[2] * d[0]);
}
static double r_of(const float d[3]) {
  return 0.6 - 0.2 * (double)d[0] + 0.25 * (double)(d[2] * d[2]);
}
static double q_of(const float h[3]) {
  return 0.4 + 0.8 * pow((double)h[2], 6.0) + 0.15 * (double)h[1];
}
static double d_of(const float d[3]) {
  return 0.5 + 0.5 * (double)(d[2] * d[2]) + 0.1 * (double)(d[0] * d[0]);
}

static double four_factors(const float l[3], const float v[3]) {
  float h[3], d[3];
  btfi_cmf_to_hd(l, v, h, d);
  return p_of(l) * r_of(v) * q_of(h) * d_of(d);
}
static double three_factors(const float l[3], const float v[3]) {
  float h[3];
  btfi_cmf_half(l, v, h);
  return p_of(l) * r_of(v) * q_of(h);
}
static double half_difference(const float l[3], const float v[3]) {
  float h[3], d[3];
  btfi_cmf_to_hd(l, v, h, d);
  return q_of(h) * d_of(d);
}

/* What resampling alone costs: the planted table interpolated from the directions of the data to cells of the
 * half-difference tables, against the function itself, by barycentric weights. */
static double resampling_floor(const char *directions, const btfi_cmf_settings *s, planted_fn f) {
  btf_context *ctx = test_context(&memory);
  btf_dirset *set;
  assert_ok(btf_dirset_create_named(ctx, directions, &set));
  const float *xyz = btf_dirset_directions(set);
  const btfi_cmf_map map = btfi_cmf_map_of(s->grid, s->resolution);
  double error = 0.0, energy = 0.0;
  for (uint32_t i = 0; i < btfi_cmf_map_texels(&map); i++)
    for (uint32_t j = 0; j < btfi_cmf_map_texels(&map); j += 3) {
      float h[3], d[3], l[3], v[3];
      btf_interp at_l, at_v;
      if (!btfi_cmf_map_direction(&map, i, h) || !btfi_cmf_map_direction(&map, j, d)) continue;
      if (!btfi_cmf_from_hd(h, d, l, v)) continue;
      btf_dirset_locate(set, l, &at_l);
      btf_dirset_locate(set, v, &at_v);
      double value = 0.0;
      for (int k = 0; k < 9; k++)
        value += (double)at_l.weight[k % 3] * (double)at_v.weight[k / 3] *
                 f(xyz + 3 * at_l.index[k % 3], xyz + 3 * at_v.index[k / 3]);
      const double truth = f(l, v);
      error += (value - truth) * (value - truth);
      energy += truth * truth;
    }
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
  return sqrt(error / energy);
}

/* FAC05, FAC06: planted factors are recovered as well as resampling allows. */
static void test_planted_factors(void **unused) {
  (void)unused;
  const struct {
    const char *chain;
    planted_fn f;
  } cases[] = {{"h,io", three_factors}, {"hd,io", four_factors}};
  for (size_t n = 0; n < 4; n++) {
    const size_t i = n / 2;
    btfi_cmf_settings s = settings_of_chain(cases[i].chain);
    s.map = n % 2 == 0 ? CMF_PARABOLIC : CMF_CUBE;
    s.residue = CMF_WEIGHTED;
    s.resolution = 24;
    s.sweeps = 12;
    const double floor = resampling_floor("ubo81", &s, cases[i].f);
    bench b = bench_open("ubo81", &s);
    bench_plant(&b, cases[i].f);
    const double error = bench_factor(&b);
    bench_expect_positive(&b);
    bench_close(&b);
    s.sweeps = 0;
    const double paper = plant_and_factor("ubo81", &s, cases[i].f);
    print_message("planted %s, %s maps: error %.5f, without sweeps %.5f; resampling alone %.5f\n",
                  cases[i].chain, s.map == CMF_CUBE ? "cube" : "parabolic", error, paper, floor);
    /* The last stage works on the data themselves and makes up for some of what resampling loses. */
    assert_true(error < floor && paper < floor);
  }
}

/* PAR06: on data that are separable in (h, d) a finer table lowers the error, and little is left for later
 * stages. */
static void test_intermediate_resolution(void **unused) {
  (void)unused;
  double before = INFINITY;
  for (uint32_t resolution = 6; resolution <= 24; resolution *= 2) {
    btfi_cmf_settings s = settings_of_chain("hd");
    s.resolution = resolution;
    const double error = plant_and_factor("ubo81", &s, half_difference);
    print_message("table of %u: error %.5f\n", resolution, error);
    assert_true(error < 0.9 * before);
    before = error;
  }
  btfi_cmf_settings s = settings_of_chain("hd,io");
  s.resolution = 24;
  bench b = bench_open("ubo81", &s);
  bench_plant(&b, half_difference);
  (void)bench_factor(&b);
  /* The residue is 1 but for interpolation: so are the factors of light and view, up to one scale. */
  for (uint32_t i = 2; i < 4; i++) {
    double mean = 0.0, deviation = 0.0;
    const float *map = b.maps + i * b.g->map_texels;
    for (uint32_t t = 0; t < b.g->map_texels; t++) mean += (double)map[t] / b.g->map_texels;
    for (uint32_t t = 0; t < b.g->map_texels; t++)
      deviation += ((double)map[t] / mean - 1.0) * ((double)map[t] / mean - 1.0) / b.g->map_texels;
    assert_true(sqrt(deviation) < 3.0 * before);
  }
  bench_close(&b);
}

/* PAR04: a projection of the user's: mirrored light and view. */
static void project_mirrored(const float light[3], const float view[3], float first[3], float second[3]) {
  for (int i = 0; i < 3; i++) {
    first[i] = i < 2 ? -light[i] : light[i];
    second[i] = i < 2 ? -view[i] : view[i];
  }
}
static bool invert_mirrored(const float first[3], const float second[3], float light[3], float view[3]) {
  project_mirrored(first, second, light, view);
  return light[2] > 0.0f && view[2] > 0.0f;
}
static void test_user_projection(void **unused) {
  (void)unused;
  const btfi_cmf_pair mirrored = {"mine", {CMF_OTHER, CMF_OTHER}, project_mirrored, invert_mirrored};
  btfi_cmf_settings s = settings_of_chain("io");
  s.resolution = 32;
  s.stage[0].pair = &mirrored;
  const double error = plant_and_factor("ubo81", &s, three_factors);
  s.stage[0].pair = btfi_cmf_pair_of("io", 2);
  const double known = plant_and_factor("ubo81", &s, three_factors);
  /* The same rank-1 problem through tables: interpolation costs little on smooth data. */
  assert_near(error, known, 0.02);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_terms_are_singular_pairs),
      cmocka_unit_test(test_planted_factors),
      cmocka_unit_test(test_intermediate_resolution),
      cmocka_unit_test(test_user_projection),
  };
  return btf_run("cmf_factor", tests);
}
