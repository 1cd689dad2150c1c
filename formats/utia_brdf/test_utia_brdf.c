/* SPDX-License-Identifier: MIT */
/* UTIA BRDF tables: a product of one function of each angle, which interpolation in four angles keeps. */
#include "../source/test_one_texel.h"

#include <unistd.h>

enum { SIDE = 288, COUNT = 3 * SIDE * SIDE, SIZE = 8 * COUNT };

/* Samples of the functions of light elevation and azimuth and of view elevation and azimuth. */
static double light_ring(int i) {
  return 2.0 - 0.36 * i; /* negative beyond 83 degrees */
}
static double light_step(int i) {
  return 1 + (double)(i * i % 11);
}
static double view_ring(int i) {
  return 1 + 0.5 * (i % 3);
}
static double view_step(int i) {
  return 1 + (double)(7 * i % 13);
}

static double *table(void) {
  double *values = malloc(SIZE), *at = values;
  assert_non_null(values);
  for (int plane = 0; plane < 3; plane++)
    for (int ti = 0; ti < 6; ti++)
      for (int pi = 0; pi < 48; pi++)
        for (int tv = 0; tv < 6; tv++)
          for (int pv = 0; pv < 48; pv++)
            *at++ = (plane + 1) * light_ring(ti) * light_step(pi) * view_ring(tv) * view_step(pv);
  return values;
}

/* The polygon through the samples, in a straight line beyond the last. */
static double ring_at(double (*f)(int), double theta) {
  const double x = theta / 15;
  const int i = x >= 4 ? 4 : (int)x;
  return f(i) + (x - i) * (f(i + 1) - f(i));
}

/* The sum of all samples times hats of one step's width on the circle. */
static double step_at(double (*f)(int), double phi) {
  double sum = 0;
  for (int i = 0; i < 48; i++) {
    const double off = fabs(phi / 7.5 - i), near = off > 24 ? 48 - off : off;
    if (near < 1) sum += (1 - near) * f(i);
  }
  return sum;
}

static int negative; /* samples that were clamped */

static void check(const double light[3], const double view[3], const float *sample) {
  double tl, pl, tv, pv;
  one_texel_angles(light, &tl, &pl);
  one_texel_angles(view, &tv, &pv);
  if (tl < 1e-3) pl = 0; /* at the normal the first azimuth counts */
  if (tv < 1e-3) pv = 0;
  const double product =
      ring_at(light_ring, tl) * step_at(light_step, pl) * ring_at(view_ring, tv) * step_at(view_step, pv);
  negative += product < 0;
  /* Angles within 1e-5 degrees at functions of slopes below 2 per degree and values up to 2 x 11 x 2 x 13 x
   * 3; floats keep 6e-8 of that. */
  for (int c = 0; c < 3; c++) assert_near(sample[c], fmax(0, (c + 1) * product), 0.01);
}

static void test_values(void **state) {
  (void)state;
  const char *path = test_path("table.dat");
  const char *const grid[] = {"directions", "grid:11x13", NULL};
  const char *const inside[] = {"cosine", "inside", NULL};
  double *values = table();
  test_write_bytes(path, values, SIZE);
  free(values);
  one_texel_check_all(path, "utia-brdf", NULL, BTF_QUANTITY_BRDF, check);
  assert_int_equal(negative, 0);
  one_texel_check_all(path, "utia-brdf", grid, BTF_QUANTITY_BRDF, check);
  assert_true(negative > 0);
  one_texel_check_all(path, "utia-brdf", inside, BTF_QUANTITY_BRDF_COS, check);
  format_check_allocations(path, "utia-brdf", 3);
}

static void test_sizes(void **state) {
  (void)state;
  static const off_t off_by[] = {1, 2, 4, 7, 8, 9, 64, 4096, 8 * SIDE, 8 * SIDE * SIDE, 16 * SIDE * SIDE};
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("damaged.dat");
  for (int sign = -1; sign <= 1; sign += 2)
    for (size_t k = 0; k < sizeof off_by / sizeof *off_by; k++) {
      const btf_format *format;
      test_write_bytes(path, "", 0);
      assert_int_equal(truncate(path, SIZE + sign * off_by[k]), 0);
      format_expect_refusal(ctx, path, "utia-brdf");
      assert_status(btf_format_detect(ctx, path, &format), BTF_E_NOT_BTF);
    }
  test_write_bytes(path, "", 0);
  format_expect_refusal(ctx, path, "utia-brdf");
  test_context_done(ctx, &memory);
}

/* The size alone does not make a table, and a number that is not finite is named where it is read. */
static void test_contents(void **state) {
  (void)state;
  static const double odd[] = {NAN, INFINITY, -INFINITY, 1e7, -1e9, 1e-13, 4e-310, 1e300};
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("odd.dat");
  double *values = table();
  for (size_t k = 0; k < sizeof odd / sizeof *odd; k++) {
    const btf_format *format;
    btf_dataset *ds;
    float sample[3];
    const btf_block first = {0, 1, 0, 1, 0, 0, 1, 1};
    const btf_strides strides = {12, 12, 12, 12, 4};
    values[0] = odd[k];
    test_write_bytes(path, values, SIZE);
    assert_status(btf_format_detect(ctx, path, &format), BTF_E_NOT_BTF);
    assert_ok(format_try(ctx, path, "utia-brdf", NULL, &ds));
    const int named = !(fabs(odd[k]) < 1e38);
    assert_status(btf_dataset_read(ds, &first, sample, &strides), named ? BTF_E_CORRUPT : BTF_OK);
    btf_dataset_release(ds);
  }
  free(values);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_values), cmocka_unit_test(test_sizes),
                                     cmocka_unit_test(test_contents)};
  return btf_run("utia_brdf", tests);
}
