/* SPDX-License-Identifier: MIT */
/* Dense linear algebra of the host table against straightforward loops in double. */
#include "btf_test.h"

#include <cblas.h>

#include "registry/registry.h"

static const double float_unit = 1.0 / 16777216.0; /* 2^-24: error of one rounding */
static const double double_unit = 1.0 / 9007199254740992.0;

static uint64_t random_state = 5;

/* -1 .. 1 */
static double random_value(void) {
  random_state = random_state * 6364136223846793005u + 1442695040888963407u;
  return (double)(int32_t)(random_state >> 32) / 2147483648.0;
}

static float *random_floats(size_t n) {
  float *values = malloc((n + 1) * sizeof *values);
  assert_non_null(values);
  for (size_t i = 0; i < n; i++) values[i] = (float)random_value();
  return values;
}

/* ---- gemm ---- */

static void check_gemm(btf_context *ctx, uint32_t flags, uint64_t m, uint64_t n, uint64_t k, float alpha,
                       float beta) {
  const bool ta = (flags & BTF_TRANSPOSE_A) != 0, tb = (flags & BTF_TRANSPOSE_B) != 0;
  const size_t a_ld = (ta ? m : k) + 3, b_ld = (tb ? k : n) + 1, c_ld = n + 2;
  float *a = random_floats((ta ? k : m) * a_ld), *b = random_floats((tb ? n : k) * b_ld),
        *c = random_floats(m * c_ld), *before = malloc((m * c_ld + 1) * sizeof *before);
  memcpy(before, c, m * c_ld * sizeof *c);
  assert_ok(btfi_host()->gemm(ctx, flags, m, n, k, alpha, a, a_ld, b, b_ld, beta, c, c_ld));
  for (uint64_t i = 0; i < m; i++)
    for (uint64_t j = 0; j < c_ld; j++) {
      const float was = before[i * c_ld + j], got = c[i * c_ld + j];
      double sum = 0.0, magnitude = 0.0;
      if (j >= n) { /* between the rows */
        assert_true(got == was);
        continue;
      }
      for (uint64_t l = 0; l < k; l++) {
        const double product =
            (double)a[ta ? l * a_ld + i : i * a_ld + l] * (double)b[tb ? j * b_ld + l : l * b_ld + j];
        sum += product;
        magnitude += fabs(product);
      }
      /* k products and sums in any order, two more for alpha and beta. */
      const double bound =
          (double)(k + 3) * float_unit * (fabs((double)alpha) * magnitude + fabs((double)beta * (double)was));
      assert_near(got, (double)alpha * sum + (double)beta * (double)was, bound);
    }
  free(a);
  free(b);
  free(c);
  free(before);
}

/* The same for OpenBLAS with threads of its own and with one, where the library divides large calls. */
static void with_either_threads(void (*check)(btf_context *ctx)) {
  const int usual = openblas_get_num_threads();
  test_memory memory;
  for (int threads = 1; threads <= 2; threads++) {
    btf_context *ctx = test_context_with(&memory, NULL, 3);
    openblas_set_num_threads(threads);
    check(ctx);
    test_context_done(ctx, &memory);
  }
  openblas_set_num_threads(usual);
}

/* Divided by rows, by columns, and with a last part of another size. */
static void check_large_products(btf_context *ctx) {
  for (uint32_t flags = 0; flags < 4; flags++) {
    check_gemm(ctx, flags, 701, 90, 131, -0.75f, 1.5f);
    check_gemm(ctx, flags, 90, 701, 131, 1.0f, 0.0f);
    check_gemm(ctx, flags, 5000, 3, 700, 1.0f, 0.0f);
  }
}

static void large_products(void **state) {
  (void)state;
  with_either_threads(check_large_products);
}

/* The threads of the context change no bit. */
static void threads_change_nothing(void **state) {
  enum { ROWS = 1500, COLUMNS = 200, SQUARES = COLUMNS * COLUMNS };
  static float product[2][SQUARES];
  static double gram[2][SQUARES];
  const int usual = openblas_get_num_threads();
  float *a = random_floats((size_t)ROWS * COLUMNS);
  test_memory memory;
  (void)state;
  openblas_set_num_threads(1);
  memset(gram, 0, sizeof gram);
  for (uint32_t i = 0; i < 2; i++) {
    btf_context *ctx = test_context_with(&memory, NULL, i == 0 ? 1 : 3);
    assert_ok(btfi_host()->gemm(ctx, BTF_TRANSPOSE_A, COLUMNS, COLUMNS, ROWS, 1.0f, a, COLUMNS, a, COLUMNS,
                                0.0f, product[i], COLUMNS));
    assert_ok(btfi_host()->gram(ctx, ROWS, COLUMNS, a, COLUMNS, gram[i]));
    test_context_done(ctx, &memory);
  }
  assert_memory_equal(product[0], product[1], sizeof product[0]);
  assert_memory_equal(gram[0], gram[1], sizeof gram[0]);
  openblas_set_num_threads(usual);
  free(a);
}

static void products(void **state) {
  static const uint64_t sizes[][3] = {{1, 1, 1},     {3, 5, 7},    {64, 33, 17},
                                      {2, 200, 130}, {50, 1, 300}, {4, 4, 0}};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  (void)state;
  for (uint32_t flags = 0; flags < 4; flags++)
    for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++)
      for (int k = 0; k < 3; k++)
        check_gemm(ctx, flags, sizes[s][0], sizes[s][1], sizes[s][2], k == 0 ? 1.0f : -0.75f,
                   k == 2 ? 1.5f : 0.0f);
  assert_ok(btfi_host()->gemm(ctx, 0, 0, 3, 3, 1.0f, NULL, 3, NULL, 3, 0.0f, NULL, 3));
  assert_status(btfi_host()->gemm(ctx, 0, (uint64_t)1 << 31, 3, 3, 1.0f, NULL, 3, NULL, 3, 0.0f, NULL, 3),
                BTF_E_LIMIT);
  assert_status(btfi_host()->gemm(ctx, 4, 0, 3, 3, 1.0f, NULL, 3, NULL, 3, 0.0f, NULL, 3), BTF_E_INVALID_ARG);
  assert_message_has("flags 0x4");
  test_context_done(ctx, &memory);
}

/* ---- gram ---- */

static void check_gram(btf_context *ctx, uint64_t rows, uint32_t columns, double offset) {
  const size_t ld = columns + 2;
  float *a = random_floats(rows * ld);
  double *g = malloc(((size_t)columns * columns + 1) * sizeof *g);
  for (size_t i = 0; i < rows * ld; i++) a[i] = (float)(a[i] + offset);
  for (size_t i = 0; i < (size_t)columns * columns; i++)
    g[i] = (double)(i / columns + i % columns); /* is added to */
  assert_ok(btfi_host()->gram(ctx, rows, columns, a, ld, g));
  for (uint32_t i = 0; i < columns; i++)
    for (uint32_t j = 0; j < columns; j++) {
      double sum = 0.0, magnitude = 0.0;
      for (uint64_t r = 0; r < rows; r++) {
        const double product = (double)a[r * ld + i] * (double)a[r * ld + j];
        sum += product;
        magnitude += fabs(product);
      }
      /* Float sums run over 512 rows at most, whatever the number of rows. */
      assert_near(g[i * columns + j], i + j + sum, 514.0 * float_unit * magnitude + 1e-12);
      assert_true(g[i * columns + j] == g[j * columns + i]);
    }
  free(a);
  free(g);
}

/* Powers of two change no bit but the exponents', whatever the squares of floats can hold. */
static void check_scaled_gram(btf_context *ctx, int exponent) {
  enum { ROWS = 700, COLUMNS = 5 };
  float *a = random_floats((size_t)ROWS * COLUMNS);
  double plain[COLUMNS * COLUMNS] = {0.0}, scaled[COLUMNS * COLUMNS] = {0.0};
  assert_ok(btfi_host()->gram(ctx, ROWS, COLUMNS, a, COLUMNS, plain));
  for (size_t i = 0; i < (size_t)ROWS * COLUMNS; i++) a[i] = ldexpf(a[i], exponent);
  assert_ok(btfi_host()->gram(ctx, ROWS, COLUMNS, a, COLUMNS, scaled));
  for (size_t i = 0; i < (size_t)COLUMNS * COLUMNS; i++)
    assert_true(scaled[i] == ldexp(plain[i], 2 * exponent));
  free(a);
}

static void check_large_grams(btf_context *ctx) {
  check_gram(ctx, 700, 200, 0.0);
  check_gram(ctx, 513, 65, 0.5);
}

static void large_squares(void **state) {
  (void)state;
  with_either_threads(check_large_grams);
}

static void squares(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  (void)state;
  check_gram(ctx, 0, 4, 0.0);
  check_gram(ctx, 1, 1, 0.0);
  check_gram(ctx, 511, 7, 0.0);
  check_gram(ctx, 513, 16, 0.5);
  check_gram(ctx, 20000, 9, 3.0); /* all of one sign: a plain float sum would be off by 1e-4 */
  check_gram(ctx, 60, 130, 0.0);
  check_scaled_gram(ctx, 100);
  check_scaled_gram(ctx, 127);
  check_scaled_gram(ctx, -90); /* the least of 3500 values within -1 .. 1 is still a normal number */
  double g[1] = {0.0};
  const float tiny[1] = {1e-30f};
  for (long n = 1; n <= 2; n++) { /* the sums of a run, and the run scaled */
    memory.fail_at = memory.total_allocations + n;
    assert_status(btfi_host()->gram(ctx, 1, 1, tiny, 1, g), BTF_E_NOMEM);
  }
  memory.fail_at = 0;
  test_context_done(ctx, &memory);
}

/* ---- eigenvectors ---- */

/* Q diag(values) Q^T with Q from Householder reflections. */
static double *planted(uint32_t n, const double *values) {
  double *a = calloc((size_t)n * n + 1, sizeof *a), *u = malloc((n + 1) * sizeof *u);
  for (uint32_t i = 0; i < n; i++) a[(size_t)i * n + i] = values[i];
  for (int turn = 0; turn < 3; turn++) {
    double norm = 0.0;
    for (uint32_t i = 0; i < n; i++) {
      u[i] = random_value();
      norm += u[i] * u[i];
    }
    for (int side = 0; side < 2; side++)
      for (uint32_t j = 0; j < n; j++) {
        double dot = 0.0;
        for (uint32_t i = 0; i < n; i++) dot += u[i] * a[side ? (size_t)j * n + i : (size_t)i * n + j];
        for (uint32_t i = 0; i < n; i++)
          a[side ? (size_t)j * n + i : (size_t)i * n + j] -= 2.0 * dot / norm * u[i];
      }
  }
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < i; j++) a[(size_t)j * n + i] = a[(size_t)i * n + j];
  free(u);
  return a;
}

static void check_eigen(btf_context *ctx, uint32_t n, double (*value)(uint32_t)) {
  double *expected = malloc((n + 1) * sizeof *expected), *values = malloc((n + 1) * sizeof *values);
  double largest = 0.0;
  for (uint32_t i = 0; i < n; i++) {
    expected[i] = value(i);
    largest = fmax(largest, fabs(expected[i]));
  }
  double *a = planted(n, expected), *v = malloc(((size_t)n * n + 1) * sizeof *v);
  memcpy(v, a, (size_t)n * n * sizeof *v);
  assert_ok(btfi_host()->symmetric_eigen(ctx, n, v, values));
  /* LAPACK promises a modest multiple of n eps |A|; making the matrix costs as much. */
  const double bound = 60.0 * n * double_unit * largest + 1e-300;
  for (uint32_t k = 0; k < n; k++) {
    const double *vector = v + (size_t)k * n;
    assert_near(values[k], expected[k], bound);
    if (k > 0) assert_true(values[k] <= values[k - 1]);
    for (uint32_t i = 0; i < n; i++) {
      double product = 0.0;
      for (uint32_t j = 0; j < n; j++) product += a[(size_t)i * n + j] * vector[j];
      assert_near(product, values[k] * vector[i], bound);
    }
    for (uint32_t other = 0; other <= k; other++) {
      double dot = 0.0;
      for (uint32_t i = 0; i < n; i++) dot += vector[i] * v[(size_t)other * n + i];
      assert_near(dot, other == k ? 1.0 : 0.0, 60.0 * n * double_unit);
    }
  }
  free(expected);
  free(values);
  free(a);
  free(v);
}

static double falling(uint32_t i) {
  return 3.0 / (1.0 + i) - 0.2;
}
static double repeated(uint32_t i) {
  return 5.0 - (double)(i / 3);
}
static double wide(uint32_t i) {
  return ldexp(1.0, 20 - (int)i);
}

static void eigenvectors(void **state) {
  static const uint32_t sizes[] = {1, 2, 3, 17, 60};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  double bad[4] = {1.0, NAN, NAN, 1.0}, values[2];
  (void)state;
  for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
    check_eigen(ctx, sizes[i], falling);
    check_eigen(ctx, sizes[i], repeated);
    check_eigen(ctx, sizes[i], wide);
  }
  assert_ok(btfi_host()->symmetric_eigen(ctx, 0, NULL, NULL));
  double one[1] = {2.0};
  memory.fail_at = memory.total_allocations + 1; /* work space is the context's */
  assert_status(btfi_host()->symmetric_eigen(ctx, 1, one, values), BTF_E_NOMEM);
  memory.fail_at = 0;
  assert_status(btfi_host()->symmetric_eigen(ctx, 2, bad, values), BTF_E_NUMERIC);
  test_context_done(ctx, &memory);
}

/* ---- Cholesky ---- */

static double positive(uint32_t i) {
  return 4.0 / (1.0 + i);
}
static double one_negative(uint32_t i) {
  return i == 0 ? 2.0 : i == 1 ? 1.0 : -0.5;
}

static void check_cholesky(btf_context *ctx, uint32_t n, uint32_t columns) {
  double *diagonal = malloc((n + 1) * sizeof *diagonal);
  for (uint32_t i = 0; i < n; i++) diagonal[i] = positive(i);
  double *a = planted(n, diagonal), *l = malloc(((size_t)n * n + 1) * sizeof *l);
  double *b = malloc(((size_t)n * columns + 1) * sizeof *b),
         *x = malloc(((size_t)n * columns + 1) * sizeof *x);
  for (size_t i = 0; i < (size_t)n * columns; i++) b[i] = x[i] = random_value();
  memcpy(l, a, (size_t)n * n * sizeof *l);
  for (uint32_t i = 0; i < n; i++) /* only the lower half is looked at */
    for (uint32_t j = i + 1; j < n; j++) l[(size_t)i * n + j] = NAN;
  assert_ok(btfi_host()->cholesky(ctx, n, l));
  /* |L| |L^T| has a diagonal of that of A, at most 4: n + 1 roundings. */
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j <= i; j++) {
      double sum = 0.0;
      for (uint32_t k = 0; k <= j; k++) sum += l[(size_t)i * n + k] * l[(size_t)j * n + k];
      assert_near(sum, a[(size_t)i * n + j], 8.0 * (n + 1) * double_unit * 4.0);
    }
  assert_ok(btfi_host()->cholesky_solve(ctx, n, l, columns, x));
  for (uint32_t c = 0; c < columns; c++) {
    double largest = 0.0;
    for (uint32_t i = 0; i < n; i++) largest = fmax(largest, fabs(x[(size_t)i * columns + c]));
    for (uint32_t i = 0; i < n; i++) {
      double sum = 0.0;
      for (uint32_t j = 0; j < n; j++) sum += a[(size_t)i * n + j] * x[(size_t)j * columns + c];
      /* Backward stable: the residual is some n eps of |L| |L^T| |x|, whose rows add up to 4 n |x| at most.
       */
      assert_near(sum, b[(size_t)i * columns + c], 8.0 * n * double_unit * 4.0 * n * largest + 1e-14);
    }
  }
  free(diagonal);
  free(a);
  free(l);
  free(b);
  free(x);
}

static void positive_definite_systems(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  double diagonal[3] = {one_negative(0), one_negative(1), one_negative(2)}, *bad = planted(3, diagonal);
  (void)state;
  check_cholesky(ctx, 1, 1);
  check_cholesky(ctx, 5, 3);
  check_cholesky(ctx, 40, 1);
  check_cholesky(ctx, 77, 20);
  check_cholesky(ctx, 4, 0);
  assert_ok(btfi_host()->cholesky(ctx, 0, NULL));
  assert_status(btfi_host()->cholesky(ctx, 3, bad), BTF_E_NUMERIC);
  bad[0] = NAN;
  assert_status(btfi_host()->cholesky(ctx, 3, bad), BTF_E_NUMERIC);
  free(bad);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(products),
      cmocka_unit_test(large_products),
      cmocka_unit_test(squares),
      cmocka_unit_test(large_squares),
      cmocka_unit_test(threads_change_nothing),
      cmocka_unit_test(eigenvectors),
      cmocka_unit_test(positive_definite_systems),
  };
  return btf_run("dense", tests);
}
