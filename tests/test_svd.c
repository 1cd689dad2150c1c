/* SPDX-License-Identifier: MIT */
/* Truncated SVD of a blocked matrix, against LAPACK's full one in double. */
#include "btf_test.h"

#include <cblas.h>
#include <lapacke.h>

#include "svd/svd.h"

/* ---- matrices ---- */

typedef struct matrix {
  uint64_t items, length;
  float *values; /* items x length */
  double *sigma; /* of the float values, by LAPACK */
  double energy;
  long reads, fail_at;
  uint64_t items_read, largest_read;
  uint32_t layout;
} matrix;

static matrix matrix_alloc(uint64_t items, uint64_t length) {
  matrix m = {.items = items, .length = length};
  m.values = calloc(items * length, sizeof(float));
  assert_non_null(m.values);
  return m;
}

static void matrix_measure(matrix *m) {
  const uint64_t smaller = BTFI_MIN(m->items, m->length);
  double *copy = malloc(m->items * m->length * sizeof(double));
  m->sigma = malloc(smaller * sizeof(double));
  m->energy = 0;
  for (uint64_t k = 0; k < m->items * m->length; k++) {
    copy[k] = m->values[k];
    m->energy += copy[k] * copy[k];
  }
  assert_int_equal(LAPACKE_dgesdd(LAPACK_COL_MAJOR, 'N', (int)m->length, (int)m->items, copy, (int)m->length,
                                  m->sigma, NULL, 1, NULL, 1),
                   0);
  free(copy);
}

static void matrix_free(matrix *m) {
  free(m->values);
  free(m->sigma);
}

/* Squared error of the best approximation of this rank. */
static double optimum(const matrix *m, uint32_t rank) {
  double sum = 0;
  for (uint64_t k = BTFI_MIN(m->items, m->length); k-- > rank;) sum += m->sigma[k] * m->sigma[k];
  return sum;
}

/* Orthonormal columns (rows x columns, row-major, double) from a seeded Gaussian by Householder. */
static double *random_frame(btfi_random *random, uint64_t rows, uint64_t columns) {
  double *a = malloc(rows * columns * sizeof(double)), *tau = malloc(columns * sizeof(double));
  for (uint64_t k = 0; k < rows * columns; k++) a[k] = btfi_random_normal(random);
  LAPACKE_dgeqrf(LAPACK_ROW_MAJOR, (int)rows, (int)columns, a, (int)columns, tau);
  LAPACKE_dorgqr(LAPACK_ROW_MAJOR, (int)rows, (int)columns, (int)columns, a, (int)columns, tau);
  free(tau);
  return a;
}

/* U diag(spectrum) V^T with random U and V. */
static matrix with_spectrum(uint64_t items, uint64_t length, double (*spectrum)(uint64_t), uint64_t seed) {
  const uint64_t smaller = BTFI_MIN(items, length);
  matrix m = matrix_alloc(items, length);
  btfi_random random;
  btfi_random_seed(&random, seed);
  double *u = random_frame(&random, items, smaller), *v = random_frame(&random, length, smaller);
  double *product = malloc(items * length * sizeof(double));
  for (uint64_t i = 0; i < items; i++)
    for (uint64_t k = 0; k < smaller; k++) u[i * smaller + k] *= spectrum(k);
  cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasTrans, (int)items, (int)length, (int)smaller, 1, u,
              (int)smaller, v, (int)smaller, 0, product, (int)length);
  for (uint64_t k = 0; k < items * length; k++) m.values[k] = (float)product[k];
  free(u);
  free(v);
  free(product);
  matrix_measure(&m);
  return m;
}

static double spectrum_fast(uint64_t k) {
  return pow(0.8, (double)k);
}
static double spectrum_slow(uint64_t k) {
  return pow((double)k + 1, -0.5);
}
static double spectrum_power(uint64_t k) {
  return 1 / ((double)k + 1);
}
/* Every value five times, 1, .5, .25 ... down to a floor. */
static double spectrum_repeated(uint64_t k) {
  return pow(0.5, fmin((double)(k / 5), 12));
}
/* A tight cluster that straddles rank 10, over a slow tail. */
static double spectrum_clustered(uint64_t k) {
  if (k < 6) return 1;
  return k < 14 ? 0.3 + 1e-4 * (double)(14 - k) : 0.1 / sqrt((double)(k - 12));
}
static double spectrum_flat(uint64_t k) {
  return k < 1 ? 1.0 : 0.05;
}
static double spectrum_rank_seven(uint64_t k) {
  return k < 7 ? 1.0 / (double)(k + 1) : 0;
}

/* A smooth material of which three items in four hundred have behaviour of their own, and two elements flare
 * up. */
static matrix with_rare_features(uint64_t items, uint64_t length) {
  matrix m = with_spectrum(items, length, spectrum_power, 99);
  btfi_random random;
  btfi_random_seed(&random, 5);
  free(m.sigma);
  const double scale = sqrt(m.energy / (double)items);
  for (uint64_t k = 0; k < 3; k++) {
    const uint64_t item = btfi_random_below(&random, items);
    for (uint64_t j = 0; j < length; j++)
      m.values[item * length + j] +=
          (float)(scale * 4 * sin(0.37 * (double)(j * (k + 1))) / sqrt((double)length));
  }
  for (uint64_t i = 0; i < items; i++) {
    m.values[i * length + 17] += (float)(0.2 * scale * btfi_random_normal(&random));
    if (i % 50 == 7) m.values[i * length + 40] += (float)(2 * scale);
  }
  matrix_measure(&m);
  return m;
}

/* Items as images of a glossy, rough line: a light and a view per item, a normal and an albedo per element,
 * and a lobe so narrow that the item of each half vector picks elements of its own. A few images hold most of
 * the energy, the spectrum falls slowly, and a sample of items tells little of the rest. */
static matrix with_narrow_lobes(uint64_t side, uint64_t length) {
  matrix m = matrix_alloc(side * side, length);
  btfi_random random;
  btfi_random_seed(&random, 21);
  double *normal = malloc(length * sizeof *normal), *albedo = malloc(length * sizeof *albedo);
  for (uint64_t j = 0; j < length; j++) {
    normal[j] = 0.5 * btfi_random_normal(&random);
    albedo[j] = 0.2 + 0.1 * btfi_random_float(&random);
  }
  for (uint64_t i = 0; i < m.items; i++) {
    const double light = 2.8 * (double)(i / side) / (double)(side - 1) - 1.4;
    const double view = 2.8 * (double)(i % side) / (double)(side - 1) - 1.4;
    for (uint64_t j = 0; j < length; j++) {
      const double off = (0.5 * (light + view) - normal[j]) / 0.04;
      const double lit = fmax(0, cos(light - normal[j])) * (cos(view - normal[j]) > 0);
      m.values[i * length + j] = (float)(lit * (albedo[j] + 2 * exp(-off * off) / (0.1 + cos(view))));
    }
  }
  free(normal);
  free(albedo);
  matrix_measure(&m);
  return m;
}

/* ---- reading and running ---- */

static btf_status read_matrix(void *user, uint64_t item0, uint64_t items, float *dst, size_t ld) {
  matrix *m = user;
  assert_true(item0 + items <= m->items && items > 0);
  m->reads++;
  m->items_read += items;
  m->largest_read = BTFI_MAX(m->largest_read, items);
  if (m->fail_at > 0 && m->reads == m->fail_at)
    return btfi_fail(NULL, BTF_E_IO, "wool: block %ld is gone", m->reads);
  for (uint64_t i = 0; i < items; i++) {
    for (uint64_t j = 0; j < m->length; j++) {
      const float value = m->values[(item0 + i) * m->length + j];
      if (m->layout == BTF_LAYOUT_ITEM_ROWS)
        dst[i * ld + j] = value;
      else
        dst[j * ld + i] = value;
    }
  }
  return BTF_OK;
}

static btf_svd_desc describe(matrix *m, uint32_t rank) {
  btf_svd_desc desc = {.struct_size = sizeof desc};
  desc.items = m->items;
  desc.length = m->length;
  desc.read = read_matrix;
  desc.user = m;
  desc.layout = m->layout;
  desc.rank = rank;
  desc.seed = 1;
  m->reads = m->fail_at = 0;
  m->items_read = m->largest_read = 0;
  return desc;
}

static btf_svd_result fresh(void) {
  const btf_svd_result result = {.struct_size = sizeof result};
  return result;
}

static double frame_error(const float *vectors, uint64_t rows, uint32_t columns) {
  double worst = 0;
  for (uint32_t a = 0; a < columns; a++) {
    for (uint32_t b = 0; b <= a; b++) {
      double dot = 0;
      for (uint64_t i = 0; i < rows; i++) dot += (double)vectors[i * columns + a] * vectors[i * columns + b];
      worst = fmax(worst, fabs(dot - (a == b)));
    }
  }
  return worst;
}

/* ||M - U S V^T||^2, entry by entry. */
static double explicit_error(const matrix *m, const btf_svd_result *r) {
  double *left = malloc(m->items * (r->rank + 1) * sizeof(double));
  double *right = malloc(m->length * (r->rank + 1) * sizeof(double));
  double *difference = malloc(m->items * m->length * sizeof(double)), sum = 0;
  for (uint64_t i = 0; i < m->items * r->rank; i++) left[i] = r->item_vectors[i] * r->sigma[i % r->rank];
  for (uint64_t i = 0; i < m->length * r->rank; i++) right[i] = r->element_vectors[i];
  for (uint64_t k = 0; k < m->items * m->length; k++) difference[k] = m->values[k];
  if (r->rank > 0)
    cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasTrans, (int)m->items, (int)m->length, (int)r->rank, -1,
                left, (int)r->rank, right, (int)r->rank, 1, difference, (int)m->length);
  for (uint64_t k = 0; k < m->items * m->length; k++) sum += difference[k] * difference[k];
  free(left);
  free(right);
  free(difference);
  return sum;
}

/* What every result must be: frames orthonormal (float columns of unit length carry 1e-7 each; 1e-5 is the
 * promise), values descending, signs fixed, and a residual that is the error indeed. */
static void check_result(const matrix *m, const btf_svd_result *r) {
  assert_relative(r->energy, m->energy, 1e-6);
  assert_true(frame_error(r->item_vectors, m->items, r->rank) < 1e-5);
  assert_true(frame_error(r->element_vectors, m->length, r->rank) < 1e-5);
  for (uint32_t k = 0; k < r->rank; k++) {
    double sum = 0;
    assert_true(isfinite(r->sigma[k]) && r->sigma[k] > 0);
    if (k > 0) assert_true(r->sigma[k] <= r->sigma[k - 1]);
    for (uint64_t j = 0; j < m->length; j++) sum += r->element_vectors[j * r->rank + k];
    assert_true(sum >= -1e-6);
  }
  /* A residual above 5e-6 of the energy is a difference of energies. Each is a sum in double of float sums
   * over runs of 16 runs of 16 squares at most. The roundings of a run of 16 add up to 2.4e-8 sqrt(16 / 3) of
   * it as they fall, both levels to 8e-8, and over the 300 runs and more of these matrices to 8e-8 /
   * sqrt(300) = 5e-9. The captured energy errs like that again: 7e-9 / 5e-6 = 1.4e-3. Smaller residuals are
   * summed from the differences themselves, and test_tiny_residual has the bound for those. */
  assert_near(r->residual, explicit_error(m, r), 2e-3 * r->residual + 1e-13 * m->energy);
}

static void check_optimal(const matrix *m, const btf_svd_result *r, double ratio) {
  const double error = explicit_error(m, r), best = optimum(m, r->rank);
  if (!(error <= ratio * best + 1e-13 * m->energy))
    fail_msg("rank %u: error %.9g is %.6f of the optimum %.9g", r->rank, error, error / best, best);
}

/* ---- tests ---- */

typedef struct spectrum_case {
  const char *name;
  double (*spectrum)(uint64_t);
  uint64_t items, length;
  uint32_t rank;
} spectrum_case;

static const spectrum_case spectrum_cases[] = {
    {"fast", spectrum_fast, 300, 200, 12},           {"slow", spectrum_slow, 400, 700, 20},
    {"power", spectrum_power, 700, 400, 32},         {"repeated", spectrum_repeated, 350, 260, 12},
    {"clustered", spectrum_clustered, 260, 350, 10}, {"flat", spectrum_flat, 300, 220, 8},
};

static void test_matches_lapack(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  for (size_t c = 0; c < sizeof spectrum_cases / sizeof spectrum_cases[0]; c++) {
    const spectrum_case *sc = &spectrum_cases[c];
    matrix m = with_spectrum(sc->items, sc->length, sc->spectrum, 40 + c);
    for (m.layout = 0; m.layout < 2; m.layout++) {
      btf_svd_desc desc = describe(&m, sc->rank);
      btf_svd_result r = fresh();
      assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
      assert_int_equal(r.rank, sc->rank);
      check_result(&m, &r);
      check_optimal(&m, &r, 1.001);
      /* One reading serves a matrix that is held. */
      assert_int_equal(r.passes, 1);
      assert_int_equal(m.items_read, m.items);
      btfi_svd_free(ctx, &r);
      assert_null(r.item_vectors);
    }
    matrix_free(&m);
  }
  test_context_done(ctx, &memory);
}

/* Bytes that the panels need at least, as the refusal names them. */
static uint64_t smallest_budget(btf_context *ctx, btf_svd_desc desc) {
  btf_svd_result r = fresh();
  unsigned long long needed = 0;
  desc.max_working_set = 1;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_LIMIT);
  const char *figure = strstr(btf_error_message(), "at least ");
  assert_non_null(figure);
  assert_int_equal(sscanf(figure, "at least %llu bytes", &needed), 1);
  assert_int_equal(r.least_working_set, needed);
  return needed;
}

static void test_small_budget(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(700, 400, spectrum_power, 7);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    btf_svd_desc desc = describe(&m, 20);
    const uint64_t needed = smallest_budget(ctx, desc);
    desc.max_working_set = needed - 1;
    btf_svd_result r = fresh();
    assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_LIMIT);
    assert_null(r.item_vectors);
    assert_int_equal(m.reads, 0);

    uint64_t before, peak;
    btf_context_memory(ctx, &before, &peak);
    desc.max_working_set = needed;
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    check_result(&m, &r);
    assert_int_equal(r.least_working_set, 0);
    check_optimal(&m, &r, 1.001);
    assert_true(r.passes > 1);
    assert_true(m.largest_read <= 8);
    btf_context_memory(ctx, NULL, &peak);
    /* The threads' pool and the residuals' list come on top. */
    const uint64_t result_bytes = (m.items + m.length) * 20 * sizeof(float);
    assert_true(peak - before <= needed + result_bytes + 8192);
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

/* A target starts with fewer components than it may need; what is named is enough for all of them. */
static void test_small_budget_for_a_target(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(700, 400, spectrum_power, 7);
  btf_svd_desc desc = describe(&m, 20);
  btf_svd_result r = fresh();
  desc.max_working_set = smallest_budget(ctx, desc);
  desc.rank = 200;
  desc.target_residual = 1e-9;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_LIMIT);
  desc.max_working_set = r.least_working_set;
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
  assert_int_equal(r.rank, 200);
  assert_int_equal(r.least_working_set, 0);
  btfi_svd_free(ctx, &r);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_streamed_equals_held(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(640, 300, spectrum_power, 8);
  m.layout = BTF_LAYOUT_ITEM_COLUMNS;
  btf_svd_desc desc = describe(&m, 16);
  desc.tolerance = 1e-6;
  btf_svd_result held = fresh();
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &held));
  const uint64_t needed = smallest_budget(ctx, desc);
  for (uint64_t part = 0; part < 4; part++) {
    btf_svd_result streamed = fresh();
    desc.max_working_set = needed + part * 90000;
    desc.block_items = part % 2 == 0 ? 0 : 12;
    m.items_read = 0;
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &streamed));
    assert_true(m.items_read >= streamed.passes * m.items);
    assert_true(streamed.passes > 1);
    assert_relative(sqrt(streamed.residual), sqrt(held.residual), 1e-5);
    assert_relative(sqrt(explicit_error(&m, &streamed)), sqrt(explicit_error(&m, &held)), 1e-5);
    check_result(&m, &streamed);
    btfi_svd_free(ctx, &streamed);
  }
  btfi_svd_free(ctx, &held);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_rare_features(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_rare_features(3200, 240);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    btf_svd_desc desc = describe(&m, 16);
    /* Room for a sample of a tenth of the items, so that most of the strays are not in it. */
    desc.max_working_set = smallest_budget(ctx, desc) + 600000;
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    check_result(&m, &r);
    check_optimal(&m, &r, 1.001);
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

/* Items of unequal worth read in order under every budget from the smallest to nearly all: the tolerance must
 * be met by measure and not only by estimate. */
static void test_tolerance_is_met(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_narrow_lobes(40, 300);
  for (uint32_t rank = 8; rank <= 32; rank += 12) {
    static const double tolerances[] = {0.0005, 0.004, 0.02};
    for (size_t t = 0; t < 3; t++) {
      btf_svd_desc desc = describe(&m, rank);
      const uint64_t needed = smallest_budget(ctx, desc), all = m.items * m.length * sizeof(float);
      desc.tolerance = tolerances[t];
      for (uint64_t part = 0; part <= 8; part++) {
        btf_svd_result r = fresh();
        desc.max_working_set = needed + part * part * all / 64;
        assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
        const double ratio = sqrt(explicit_error(&m, &r) / optimum(&m, rank));
        if (!(ratio <= 1 + desc.tolerance))
          fail_msg("rank %u, budget %d: error %.6f of the optimum, tolerance %g", rank, (int)part, ratio,
                   desc.tolerance);
        btfi_svd_free(ctx, &r);
      }
    }
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_rank_deficient(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(200, 150, spectrum_rank_seven, 3);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    btf_svd_desc desc = describe(&m, 20);
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 7);
    check_result(&m, &r);
    for (uint32_t k = 0; k < 7; k++) assert_relative(r.sigma[k], m.sigma[k], 1e-5);
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);

  /* Whole numbers: an outer product of rank one has no rounding at all. */
  m = matrix_alloc(40, 30);
  for (uint64_t k = 0; k < 1200; k++) m.values[k] = (float)((k / 30 % 5 + 1) * (k % 30 % 3 + 1));
  matrix_measure(&m);
  btf_svd_desc desc = describe(&m, 4);
  btf_svd_result r = fresh();
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
  assert_int_equal(r.rank, 1);
  check_result(&m, &r);
  btfi_svd_free(ctx, &r);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

/* A flat diffuse material: every row one of six multiples of one vector, thousands of times. Sums of equal
 * terms round the same way each time, which random matrices never show. */
static void test_rank_one_of_equal_rows(void **state) {
  static const uint64_t sizes[][2] = {{4096, 24}, {972, 120}, {2048, 512}, {24, 4096}};
  (void)state;
  for (size_t n = 0; n < sizeof sizes / sizeof *sizes; n++) {
    test_memory memory;
    btf_context *ctx = test_context(&memory);
    btfi_random random;
    matrix m = matrix_alloc(sizes[n][0], sizes[n][1]);
    float column[512];
    double energy = 0;
    btfi_random_seed(&random, 5);
    for (uint64_t j = 0; j < m.length; j++) {
      if (j < 512) column[j] = 0.2f + btfi_random_float(&random);
    }
    for (uint64_t i = 0; i < m.items; i++)
      for (uint64_t j = 0; j < m.length; j++)
        m.values[i * m.length + j] =
            (0.1f + 0.07f * (float)(i % 3)) * (i / 3 % 2 ? 0.38f : 0.92f) * column[j % 512];
    for (uint64_t k = 0; k < m.items * m.length; k++) energy += (double)m.values[k] * m.values[k];
    btf_svd_desc desc = describe(&m, 8);
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 1);
    /* Runs of 512 float sums: 512 * 2^-24 = 3e-5 at the very worst, a few 1e-6 as they fall; the residual
     * says so too. */
    assert_true(sqrt(explicit_error(&m, &r) / energy) <= 1e-5);
    assert_true(r.residual <= 1e-10 * energy);
    btfi_svd_free(ctx, &r);
    matrix_free(&m);
    test_context_done(ctx, &memory);
  }
}

static void test_small_shapes(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  static const uint64_t sizes[][2] = {{1, 1},   {1, 37},  {37, 1},  {2, 2},
                                      {3, 100}, {100, 3}, {17, 16}, {9, 65}};
  for (size_t c = 0; c < sizeof sizes / sizeof sizes[0]; c++) {
    for (uint32_t layout = 0; layout < 2; layout++) {
      matrix m = with_spectrum(sizes[c][0], sizes[c][1], spectrum_power, 60 + c);
      m.layout = layout;
      for (int tight = 0; tight < 2; tight++) {
        btf_svd_desc desc = describe(&m, 500);
        if (tight) desc.max_working_set = smallest_budget(ctx, desc);
        btf_svd_result r = fresh();
        assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
        assert_int_equal(r.rank, BTFI_MIN(m.items, m.length));
        check_result(&m, &r);
        for (uint32_t k = 0; k < r.rank; k++) assert_near(r.sigma[k], m.sigma[k], 2e-6 * m.sigma[0]);
        btfi_svd_free(ctx, &r);
      }
      matrix_free(&m);
    }
  }
  test_context_done(ctx, &memory);
}

static void test_zero_matrix(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = matrix_alloc(50, 40);
  btf_svd_desc desc = describe(&m, 5);
  for (int tight = 0; tight < 2; tight++) {
    btf_svd_result r = fresh();
    if (tight) desc.max_working_set = smallest_budget(ctx, desc);
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 0);
    assert_true(r.energy == 0 && r.residual == 0);
    assert_non_null(r.item_vectors);
    assert_non_null(r.element_vectors);
    assert_non_null(r.sigma);
    btfi_svd_free(ctx, &r);
  }
  /* One item of many that is not zero, which no sample need contain. */
  for (uint64_t j = 0; j < 40; j++) m.values[31 * 40 + j] = (float)j;
  matrix_measure(&m);
  desc.max_working_set += 20000;
  btf_svd_result r = fresh();
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
  assert_int_equal(r.rank, 1);
  check_result(&m, &r);
  btfi_svd_free(ctx, &r);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_tiny_residual(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(300, 200, spectrum_fast, 4);
  btf_svd_desc desc = describe(&m, 40);
  for (int tight = 0; tight < 2; tight++) {
    /* sigma_41 is 1.3e-4 of the first: the residual, 5e-8 of the energy, would drown in the difference of
     * energies. */
    btf_svd_result r = fresh();
    if (tight) desc.max_working_set = smallest_budget(ctx, desc) + 100000;
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    /* An element of C is a sum of n = 200 products of size |m| / n and either sign, in any order: each of n
     * roundings is at most 2^-24 of a partial sum, which walks to |m| / sqrt(n), and as they fall together
     * they are 2^-24 |m|. A column of C so errs by 2^-24 ||M|| = 1e-7 sigma_1, 8e-4 of sigma_41 and less of
     * what the first vectors have. That error has the direction of the column by chance only, 1 / sqrt(300):
     * 2 * 8e-4 / sqrt(300) = 9e-5 of the squared Ritz value, and Y does the same again. What lies beyond the
     * panel is summed from differences to the same precision. */
    assert_relative(r.residual, optimum(&m, 40), 2e-4);
    check_result(&m, &r);
    check_optimal(&m, &r, 1.001);
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_target(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(600, 320, spectrum_power, 5);
  const uint64_t roomy = smallest_budget(ctx, describe(&m, 150));
  for (int tight = 0; tight < 2; tight++) {
    static const uint32_t ranks[] = {1, 3, 23, 24, 25, 60, 111};
    for (size_t c = 0; c < sizeof ranks / sizeof ranks[0]; c++) {
      btf_svd_desc desc = describe(&m, 150);
      /* Halfway between what this rank and one less can reach at best; the tolerance is far smaller than the
       * step. */
      desc.target_residual = 0.5 * (optimum(&m, ranks[c]) + optimum(&m, ranks[c] - 1));
      desc.tolerance = 1e-5;
      if (tight) desc.max_working_set = roomy;
      btf_svd_result r = fresh();
      assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
      assert_int_equal(r.rank, ranks[c]);
      assert_true(r.residual <= desc.target_residual);
      check_result(&m, &r);
      btfi_svd_free(ctx, &r);
    }
    /* Out of reach: the most that is allowed. */
    btf_svd_desc desc = describe(&m, 30);
    desc.target_residual = 0.5 * optimum(&m, 30);
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 30);
    assert_true(r.residual > desc.target_residual);
    btfi_svd_free(ctx, &r);
    /* Nothing to do. */
    desc.target_residual = 1.01 * m.energy;
    r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 0);
    assert_relative(r.residual, m.energy, 1e-6);
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_error_falls_with_rank(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(300, 260, spectrum_slow, 6);
  double previous = 2 * m.energy;
  for (uint32_t rank = 1; rank < 60; rank += 4) {
    btf_svd_desc desc = describe(&m, rank);
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_true(r.residual < previous);
    previous = r.residual;
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_deterministic(void **state) {
  (void)state;
  test_memory memory;
  matrix m = with_spectrum(500, 210, spectrum_power, 9);
  for (int tight = 0; tight < 2; tight++) {
    btf_svd_result results[2] = {fresh(), fresh()};
    btf_context *ctx = test_context_with(&memory, NULL, 2);
    btf_svd_desc desc = describe(&m, 12);
    if (tight) desc.max_working_set = smallest_budget(ctx, desc) + 100000;
    for (int run = 0; run < 2; run++) assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &results[run]));
    assert_memory_equal(results[0].sigma, results[1].sigma, 12 * sizeof(double));
    assert_memory_equal(results[0].item_vectors, results[1].item_vectors, m.items * 12 * sizeof(float));
    assert_memory_equal(results[0].element_vectors, results[1].element_vectors,
                        m.length * 12 * sizeof(float));
    assert_true(results[0].residual == results[1].residual && results[0].energy == results[1].energy);
    for (int run = 0; run < 2; run++) btfi_svd_free(ctx, &results[run]);
    test_context_done(ctx, &memory);
  }
  matrix_free(&m);
}

/* Every kernel that this machine has, and BLAS alone, in both layouts. */
static void test_kernels_agree(void **state) {
  (void)state;
  static const char *const isas[] = {"scalar", "avx2", "avx512"};
  matrix m = with_spectrum(333, 217, spectrum_power, 10);
  for (size_t k = 0; k < 3; k++) {
    test_memory memory;
    btf_context *ctx = test_context_with(&memory, isas[k], 2);
    for (m.layout = 0; m.layout < 2; m.layout++) {
      /* Panels of 16, 32, 48, 64, 80 and 112 columns: each mix of tiles. */
      static const uint32_t ranks[] = {6, 20, 36, 52, 70, 100};
      for (size_t c = 0; c < sizeof ranks / sizeof ranks[0]; c++) {
        btf_svd_desc desc = describe(&m, ranks[c]);
        btf_svd_result r = fresh();
        assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
        check_result(&m, &r);
        check_optimal(&m, &r, 1.001);
        btfi_svd_free(ctx, &r);
      }
    }
    test_context_done(ctx, &memory);
  }
  matrix_free(&m);
}

/* A power of two changes no digit of a float, so the results for a scaled matrix must be those of the plain
 * one, scaled; from values whose squares float cannot hold to values that it can hardly hold itself. */
static void test_scale(void **state) {
  (void)state;
  static const int exponents[] = {-120, -100, -60, -40, 40, 60, 100, 126};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(300, 120, spectrum_power, 15);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    for (int tight = 0; tight < 2; tight++) {
      btf_svd_desc desc = describe(&m, 10);
      desc.target_residual = 0.5 * (optimum(&m, 9) + optimum(&m, 8));
      if (tight) desc.max_working_set = smallest_budget(ctx, describe(&m, 30)) + 40000;
      btf_svd_result plain = fresh();
      assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &plain));
      assert_int_equal(plain.rank, 9);
      for (size_t e = 0; e < sizeof exponents / sizeof *exponents; e++) {
        matrix scaled = matrix_alloc(m.items, m.length);
        scaled.layout = m.layout;
        for (uint64_t k = 0; k < m.items * m.length; k++)
          scaled.values[k] = ldexpf(m.values[k], exponents[e]);
        btf_svd_desc other = desc;
        other.user = &scaled;
        other.target_residual = ldexp(desc.target_residual, 2 * exponents[e]);
        btf_svd_result r = fresh();
        assert_ok(btfi_svd(ctx, &other, NULL, 0, 1, &r));
        assert_int_equal(r.rank, plain.rank);
        /* The scale chosen may differ from the plain one by a power of two of its own; at 2^-120, values
         * below 2^-6 lose digits to float's lower end: 2^-24 of the largest. */
        for (uint32_t k = 0; k < r.rank; k++)
          assert_relative(ldexp(r.sigma[k], -exponents[e]), plain.sigma[k], 1e-6);
        assert_relative(ldexp(r.energy, -2 * exponents[e]), plain.energy, 1e-6);
        assert_relative(ldexp(r.residual, -2 * exponents[e]), plain.residual, 1e-5);
        for (uint64_t k = 0; k < m.length * r.rank; k++)
          assert_near(r.element_vectors[k], plain.element_vectors[k], 1e-4);
        btfi_svd_free(ctx, &r);
        free(scaled.values);
      }
      btfi_svd_free(ctx, &plain);
    }
  }
  matrix_free(&m);
  /* Both ends of the range, and one value of either among zeros that the sample will not show. */
  for (int end = 0; end < 2; end++) {
    m = matrix_alloc(900, 40);
    m.values[777 * 40 + 3] = end == 0 ? 1e-38f : 3e38f;
    btf_svd_desc desc = describe(&m, 3);
    desc.max_working_set = smallest_budget(ctx, desc) + 20000;
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 1);
    assert_relative(r.sigma[0], m.values[777 * 40 + 3], 1e-6);
    btfi_svd_free(ctx, &r);
    matrix_free(&m);
  }
  test_context_done(ctx, &memory);
}

/* Each element of a product is summed in one order, whoever does it. */
static void test_threads_agree(void **state) {
  (void)state;
  matrix m = with_rare_features(900, 260);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    for (int tight = 0; tight < 2; tight++) {
      btf_svd_result first = fresh();
      for (uint32_t threads = 1; threads <= 3; threads++) {
        test_memory memory;
        btf_context *ctx = test_context_with(&memory, NULL, threads);
        btf_svd_desc desc = describe(&m, 20);
        if (tight) desc.max_working_set = smallest_budget(ctx, desc) + 200000;
        btf_svd_result r = fresh();
        assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
        if (threads > 1) {
          assert_int_equal(r.rank, first.rank);
          assert_memory_equal(r.sigma, first.sigma, r.rank * sizeof(double));
          assert_memory_equal(r.item_vectors, first.item_vectors, m.items * r.rank * sizeof(float));
          assert_memory_equal(r.element_vectors, first.element_vectors, m.length * r.rank * sizeof(float));
          assert_true(r.residual == first.residual && r.energy == first.energy);
          btfi_svd_free(ctx, &r);
        } else {
          /* Outlives the context that made it. */
          first = r;
          first.sigma = memcpy(malloc(r.rank * sizeof(double)), r.sigma, r.rank * sizeof(double));
          const size_t items = m.items * r.rank * sizeof(float), elements = m.length * r.rank * sizeof(float);
          first.item_vectors = memcpy(malloc(items), r.item_vectors, items);
          first.element_vectors = memcpy(malloc(elements), r.element_vectors, elements);
          btfi_svd_free(ctx, &r);
        }
        test_context_done(ctx, &memory);
      }
      free(first.sigma);
      free(first.item_vectors);
      free(first.element_vectors);
    }
  }
  matrix_free(&m);
}

typedef struct canceller {
  long calls, cancel_at;
  double last;
} canceller;

static int32_t count_progress(void *user, double fraction, const char *stage) {
  canceller *c = user;
  assert_string_equal(stage, "svd");
  assert_true(fraction >= c->last && fraction >= 0.25 - 1e-12 && fraction <= 0.75 + 1e-12);
  c->last = fraction;
  return ++c->calls == c->cancel_at;
}

static void test_cancel(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(300, 120, spectrum_power, 11);
  btf_svd_desc desc = describe(&m, 8);
  desc.max_working_set = smallest_budget(ctx, desc) + 60000;
  long total = 1;
  for (long at = 0; at <= total; at++) {
    canceller c = {0, at, 0};
    btf_job user = BTF_JOB_INIT;
    btfi_job job;
    user.progress = count_progress;
    user.user = &c;
    assert_ok(btfi_job_begin(ctx, &user, &job));
    btf_svd_result r = fresh();
    const btf_status status = btfi_svd(ctx, &desc, &job.desc, 0.25, 0.75, &r);
    if (at == 0) {
      assert_ok(status);
      total = c.calls;
      assert_true(total >= 1);
      btfi_svd_free(ctx, &r);
    } else {
      /* Reports are thinned by the clock, so a later run may make fewer. */
      if (status == BTF_OK) {
        assert_true(c.calls < at);
        btfi_svd_free(ctx, &r);
        continue;
      }
      assert_int_equal(status, BTF_E_CANCELLED);
      assert_null(r.item_vectors);
      assert_null(r.sigma);
    }
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_read_failure(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(120, 60, spectrum_power, 12);
  for (int tight = 0; tight < 2; tight++) {
    btf_svd_desc desc = describe(&m, 6);
    if (tight) desc.max_working_set = smallest_budget(ctx, desc) + 20000;
    m.reads = 0;
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    btfi_svd_free(ctx, &r);
    const long total = m.reads;
    for (long at = 1; at <= total; at++) {
      m.reads = 0;
      m.fail_at = at;
      assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_IO);
      assert_message_has("is gone");
      assert_null(r.element_vectors);
      assert_int_equal(m.reads, at);
    }
    m.fail_at = 0;
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_allocation_failure(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  matrix m = with_spectrum(90, 50, spectrum_power, 13);
  btf_svd_desc desc = describe(&m, 30);
  desc.target_residual = optimum(&m, 28); /* makes the panels grow once */
  btf_svd_result r = fresh();
  const long before = memory.total_allocations;
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
  const long count = memory.total_allocations - before;
  btfi_svd_free(ctx, &r);
  const long live = memory.live_blocks;
  assert_true(count > 15);
  for (long at = 1; at <= count; at++) {
    memory.fail_at = memory.total_allocations + at;
    r = fresh();
    assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_NOMEM);
    assert_null(r.item_vectors);
    assert_null(r.element_vectors);
    assert_null(r.sigma);
    assert_int_equal(memory.live_blocks, live);
  }
  memory.fail_at = 0;
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_bad_arguments(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(20, 10, spectrum_power, 14);
  const btf_svd_desc good = describe(&m, 3);
  btf_svd_result r = fresh();
  btf_svd_desc desc = good;
  desc.read = NULL;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.items = 0;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.rank = 0;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.layout = 2;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.tolerance = -1;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.target_residual = NAN;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.items = UINT64_MAX;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_LIMIT);
  desc = good;
  desc.length = (uint64_t)1 << 40;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_LIMIT);
  desc = good;
  desc.struct_size = 8;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_ABI);
  assert_status(btfi_svd(ctx, NULL, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  assert_status(btfi_svd(ctx, &good, NULL, 0, 1, NULL), BTF_E_INVALID_ARG);

  /* A reader that breaks its promise is found out. */
  m.values[33] = NAN;
  assert_status(btfi_svd(ctx, &good, NULL, 0, 1, &r), BTF_E_NUMERIC);
  m.values[33] = INFINITY;
  assert_status(btfi_svd(ctx, &good, NULL, 0, 1, &r), BTF_E_NUMERIC);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_matches_lapack),
      cmocka_unit_test(test_small_budget),
      cmocka_unit_test(test_streamed_equals_held),
      cmocka_unit_test(test_rare_features),
      cmocka_unit_test(test_tolerance_is_met),
      cmocka_unit_test(test_small_budget_for_a_target),
      cmocka_unit_test(test_rank_deficient),
      cmocka_unit_test(test_rank_one_of_equal_rows),
      cmocka_unit_test(test_small_shapes),
      cmocka_unit_test(test_zero_matrix),
      cmocka_unit_test(test_tiny_residual),
      cmocka_unit_test(test_target),
      cmocka_unit_test(test_error_falls_with_rank),
      cmocka_unit_test(test_deterministic),
      cmocka_unit_test(test_kernels_agree),
      cmocka_unit_test(test_scale),
      cmocka_unit_test(test_threads_agree),
      cmocka_unit_test(test_cancel),
      cmocka_unit_test(test_read_failure),
      cmocka_unit_test(test_allocation_failure),
      cmocka_unit_test(test_bad_arguments),
  };
  return btf_run("svd", tests);
}
