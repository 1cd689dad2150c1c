/* SPDX-License-Identifier: MIT */
#include "svd_matrices.h"

#include <cblas.h>
#include <lapacke.h>

matrix matrix_alloc(uint64_t items, uint64_t length) {
  matrix m = {.items = items, .length = length};
  m.values = calloc(items * length, sizeof(float));
  assert_non_null(m.values);
  return m;
}

/* Of a tall matrix, from the eigenvalues of M^T M: in double they are exact to 1e-16 sigma_1^2 or so. */
static void measure_tall(matrix *m) {
  enum { ROWS = 1024 };
  const size_t length = (size_t)m->length;
  double *gram = calloc(length * length, sizeof *gram), *rows = malloc(ROWS * length * sizeof *rows);
  m->sigma = malloc(length * sizeof *m->sigma);
  m->energy = 0;
  for (uint64_t first = 0; first < m->items; first += ROWS) {
    const size_t count = (size_t)BTFI_MIN((uint64_t)ROWS, m->items - first);
    for (size_t k = 0; k < count * length; k++) rows[k] = m->values[first * length + k];
    cblas_dsyrk(CblasRowMajor, CblasUpper, CblasTrans, (int)length, (int)count, 1, rows, (int)length, 1, gram,
                (int)length);
  }
  for (size_t j = 0; j < length; j++) m->energy += gram[j * length + j];
  assert_int_equal(LAPACKE_dsyevd(LAPACK_ROW_MAJOR, 'N', 'U', (int)length, gram, (int)length, m->sigma), 0);
  for (size_t i = 0, j = length - 1; i < j; i++, j--) {
    const double value = m->sigma[i];
    m->sigma[i] = m->sigma[j];
    m->sigma[j] = value;
  }
  for (size_t j = 0; j < length; j++) m->sigma[j] = sqrt(fmax(0, m->sigma[j]));
  free(gram);
  free(rows);
}

void matrix_measure(matrix *m) {
  if (m->items > 64 * m->length) {
    measure_tall(m);
    return;
  }
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

void matrix_free(matrix *m) {
  free(m->values);
  free(m->sigma);
}

double optimum(const matrix *m, uint32_t rank) {
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

matrix with_spectrum(uint64_t items, uint64_t length, double (*spectrum)(uint64_t), uint64_t seed) {
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

double spectrum_fast(uint64_t k) {
  return pow(0.8, (double)k);
}
double spectrum_slow(uint64_t k) {
  return pow((double)k + 1, -0.5);
}
double spectrum_power(uint64_t k) {
  return 1 / ((double)k + 1);
}
/* Every value five times, 1, .5, .25 ... down to a floor. */
double spectrum_repeated(uint64_t k) {
  return pow(0.5, fmin((double)(k / 5), 12));
}
/* A tight cluster that straddles rank 10, over a slow tail. */
double spectrum_clustered(uint64_t k) {
  if (k < 6) return 1;
  return k < 14 ? 0.3 + 1e-4 * (double)(14 - k) : 0.1 / sqrt((double)(k - 12));
}
double spectrum_flat(uint64_t k) {
  return k < 1 ? 1.0 : 0.05;
}
double spectrum_rank_seven(uint64_t k) {
  return k < 7 ? 1.0 / (double)(k + 1) : 0;
}

/* A smooth material of which three items in four hundred have behaviour of their own, and two elements flare
 * up. */
matrix with_rare_features(uint64_t items, uint64_t length) {
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
matrix with_narrow_lobes(uint64_t side, uint64_t length) {
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

matrix with_some_alike(const uint64_t *alike, size_t count, double weight) {
  enum { ITEMS = 65536, LENGTH = 400, BACKGROUND = 350, RANK = 32 };
  matrix m = matrix_alloc(ITEMS, LENGTH);
  btfi_random random;
  btfi_random_seed(&random, 7);
  double *v = random_frame(&random, LENGTH, BACKGROUND + 1), weakest = 0;
  float *factor = malloc(sizeof(float) * BACKGROUND * LENGTH);
  float *weights = malloc(sizeof(float) * ITEMS * BACKGROUND);
  for (size_t k = 0; k < BACKGROUND; k++) {
    const double sigma = 100 * pow(0.86, (double)k) + 0.02;
    if (k == RANK - 1) weakest = sigma;
    for (size_t j = 0; j < LENGTH; j++)
      factor[k * LENGTH + j] = (float)(sigma / sqrt(ITEMS) * v[j * (BACKGROUND + 1) + k]);
  }
  for (size_t k = 0; k < (size_t)ITEMS * BACKGROUND; k++) weights[k] = btfi_random_normal(&random);
  cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, ITEMS, LENGTH, BACKGROUND, 1, weights, BACKGROUND,
              factor, LENGTH, 0, m.values, LENGTH);
  for (size_t c = 0; c < count; c++) {
    for (size_t j = 0; j < LENGTH; j++)
      m.values[alike[c] * LENGTH + j] +=
          (float)(sqrt(weight) * weakest * v[j * (BACKGROUND + 1) + BACKGROUND]);
  }
  free(weights);
  free(factor);
  free(v);
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
    return btfi_fail(NULL, m->fail_with != BTF_OK ? m->fail_with : BTF_E_IO, "wool: block %ld is gone",
                     m->reads);
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

btf_svd_desc describe(matrix *m, uint32_t rank) {
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

btf_svd_result fresh(void) {
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

double explicit_error(const matrix *m, const btf_svd_result *r) {
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

/* P, C and Y as they are stored, and the map from Y to V: each errs by 2^-24 of its length. The elements of C
 * and Y are float sums of n products: where all have one sign, partial sums grow evenly, and n roundings,
 * each evenly spread within 2^-24 of one, add up to 2^-24 sqrt(n) / 3 of the sum as they fall. */
double sigma_rounding(const matrix *m) {
  return (4 + (sqrt((double)m->items) + sqrt((double)m->length)) / 3) * 0x1p-24 * sqrt(m->energy);
}

/* Dots within 5e-7 of the identity are left as they are. Otherwise columns are combined by a map near the
 * identity: its elements, as floats, err by 2^-24, and so do those of the product, twice each in a square: 4
 * * 2^-24 = 2.4e-7. Both together are below 1e-6. */
static const double largest_frame_error = 1e-6;

/* What every result must be: frames orthonormal, values descending, signs fixed, and a residual that is the
 * error indeed. */
void check_result(const matrix *m, const btf_svd_result *r) {
  assert_relative(r->energy, m->energy, 1e-6);
  assert_true(frame_error(r->item_vectors, m->items, r->rank) < largest_frame_error);
  assert_true(frame_error(r->element_vectors, m->length, r->rank) < largest_frame_error);
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

void check_optimal(const matrix *m, const btf_svd_result *r, double ratio) {
  const double error = explicit_error(m, r), best = optimum(m, r->rank);
  if (!(error <= ratio * best + 1e-13 * m->energy))
    fail_msg("rank %u: error %.9g is %.6f of the optimum %.9g", r->rank, error, error / best, best);
}

uint64_t smallest_budget(btf_context *ctx, btf_svd_desc desc) {
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
