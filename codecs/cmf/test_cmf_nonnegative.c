/* SPDX-License-Identifier: MIT */
/* Non-negative factorisation: signs, monotone cost, planted factors, the optimum of rank 1. */
#include "btf_test.h"

#include <float.h>

#include <lapacke.h>

#include "nonnegative.h"

static double random_unit(uint64_t *state) {
  *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (double)(*state >> 11) / 9007199254740992.0;
}

enum { most_sweeps = 3000 };
static double cost[most_sweeps + 1];
static uint32_t sweeps_done;

static double factor(uint32_t rows, uint32_t columns, const float *a, const float *weight, uint32_t rank,
                     double tolerance, float *p, float *q) {
  float *scratch = malloc(btfi_cmf_nonnegative_scratch(rows, columns) * sizeof *scratch);
  double error = 0.0, energy = 0.0;
  btfi_cmf_nonnegative(rows, columns, a, columns, weight, rank, most_sweeps, tolerance, scratch, p, q, cost,
                       &sweeps_done);
  free(scratch);
  for (uint32_t i = 0; i < rows * rank; i++) assert_true(p[i] >= 0.0f && isfinite(p[i]));
  for (uint32_t j = 0; j < columns * rank; j++) assert_true(q[j] >= 0.0f && isfinite(q[j]));
  for (uint32_t i = 0; i < rows; i++) {
    for (uint32_t j = 0; j < columns; j++) {
      const double w = weight != NULL ? (double)weight[i * columns + j] : 1.0;
      double d = (double)a[i * columns + j];
      energy += w * d * d;
      for (uint32_t k = 0; k < rank; k++) d -= (double)p[i * rank + k] * (double)q[j * rank + k];
      error += w * d * d;
    }
  }
  /* What is left is kept in floats: a component leaves it and returns once a sweep, at 2^-24 of the elements
   * each; the cost moves by twice that times its root. */
  const double rounding = 2.0 * sqrt(energy) * ldexp(1.0, -24) * rank * (sweeps_done + 1.0);
  for (uint32_t s = 1; s <= sweeps_done; s++)
    assert_true(cost[s] <= cost[s - 1] + 2.0 * sqrt(cost[s - 1]) * rounding + rounding * rounding);
  assert_near(sqrt(error), sqrt(cost[sweeps_done]), rounding);
  return error;
}

/* FAC02: factors are not negative and the cost falls, for data of any sign, rank and weight. */
static void test_cost_falls(void **unused) {
  (void)unused;
  enum { rows = 30, columns = 21 };
  uint64_t seed = 1;
  float a[rows * columns], weight[rows * columns], p[rows * 6], q[columns * 6];
  for (uint32_t rank = 1; rank <= 6; rank++) {
    for (uint32_t kind = 0; kind < 3; kind++) {
      for (uint32_t i = 0; i < rows * columns; i++) {
        a[i] = (float)(random_unit(&seed) - (kind == 1 ? 0.5 : 0.0));
        weight[i] = random_unit(&seed) < 0.3 ? 0.0f : (float)random_unit(&seed);
      }
      factor(rows, columns, a, kind == 2 ? weight : NULL, rank, 1e-7, p, q);
      assert_true(sweeps_done > 0);
      assert_true(cost[sweeps_done] < cost[0] || rank == 1);
    }
  }
}

/* The non-negative optimum of rank 1 of a positive matrix is its singular pair (Perron and Frobenius; T06).
 */
static void test_rank_one_is_the_singular_pair(void **unused) {
  (void)unused;
  enum { rows = 40, columns = 25 };
  uint64_t seed = 5;
  float a[rows * columns], p[rows], q[columns];
  double copy[rows * columns], sigma[columns], u[rows * columns], vt[columns * columns], work[columns],
      tail = 0.0;
  for (uint32_t i = 0; i < rows * columns; i++) copy[i] = (double)(a[i] = (float)(0.1 + random_unit(&seed)));
  assert_int_equal(LAPACKE_dgesvd(LAPACK_ROW_MAJOR, 'S', 'S', rows, columns, copy, columns, sigma, u, columns,
                                  vt, columns, work),
                   0);
  for (uint32_t k = 1; k < columns; k++) tail += sigma[k] * sigma[k];
  const double error = factor(rows, columns, a, NULL, 1, 1e-12, p, q);
  assert_relative(error, tail, 1e-5); /* floats: 2^-24 of the matrix, whose norm is 5 times its tail's */
  for (uint32_t i = 0; i < rows; i++)
    for (uint32_t j = 0; j < columns; j++)
      assert_near((double)p[i] * (double)q[j], sigma[0] * u[i * columns] * vt[j], 1e-5);
}

/* A planted factorisation whose factors have their own supports is unique; weights hide what is spoilt. */
static void test_planted_factors(void **unused) {
  (void)unused;
  enum { rows = 36, columns = 28, rank = 3 };
  for (uint64_t seed = 1; seed <= 5; seed++) {
    float a[rows * columns], weight[rows * columns], p[rows * rank], q[columns * rank];
    double energy = 0.0;
    uint64_t random = seed;
    memset(a, 0, sizeof a);
    for (uint32_t k = 0; k < rank; k++) {
      float row[rows], column[columns];
      /* Each component alone in a third of the rows and columns, and shared in some. */
      for (uint32_t i = 0; i < rows; i++)
        row[i] = i * rank / rows == k || i % 5 == 0 ? (float)(0.5 + random_unit(&random)) : 0.0f;
      for (uint32_t j = 0; j < columns; j++)
        column[j] = j * rank / columns == k || j % 4 == 0 ? (float)(0.5 + random_unit(&random)) : 0.0f;
      for (uint32_t i = 0; i < rows * columns; i++) a[i] += row[i / columns] * column[i % columns];
    }
    for (uint32_t i = 0; i < rows * columns; i++) {
      weight[i] = random_unit(&random) < 0.15 ? 0.0f : 1.0f;
      energy += (double)a[i] * (double)a[i];
      if (weight[i] == 0.0f) a[i] = 50.0f;
    }
    const double error = factor(rows, columns, a, weight, rank, 1e-9, p, q);
    /* Convergence is linear; what is left is far below any component (a third of the energy). */
    if (!(error < 1e-6 * energy)) fail_msg("seed %u: relative error %.3g", (unsigned)seed, error / energy);
  }
}

static void test_degenerate(void **unused) {
  (void)unused;
  float a[12] = {0}, p[24], q[24], weight[12] = {0};
  assert_true(factor(3, 4, a, NULL, 2, 1e-6, p, q) == 0.0);
  for (int i = 0; i < 12; i++) a[i] = -1.0f;
  assert_true(factor(3, 4, a, NULL, 2, 1e-6, p, q) == 12.0); /* nothing is better than 0 */
  for (int i = 0; i < 12; i++) a[i] = 1.0f;
  assert_true(factor(3, 4, a, weight, 2, 1e-6, p, q) == 0.0);
  assert_true(factor(12, 1, a, NULL, 2, 1e-6, p, q) < 1e-12);
  assert_true(factor(1, 12, a, NULL, 2, 1e-6, p, q) < 1e-12);
  assert_true(factor(3, 4, a, NULL, 6, 1e-6, p, q) < 1e-12); /* more components than rows */
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_cost_falls),
      cmocka_unit_test(test_rank_one_is_the_singular_pair),
      cmocka_unit_test(test_planted_factors),
      cmocka_unit_test(test_degenerate),
  };
  return btf_run("cmf_nonnegative", tests);
}
