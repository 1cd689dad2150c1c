/* SPDX-License-Identifier: MIT */
#include "dense/dense.h"

#include <limits.h>
#include <math.h>

#include <cblas.h>
#include <lapacke.h>

#include <btf/btf_plugin.h>

enum { gram_run = 512 }; /* rows whose squares a float may sum: rounding grows with the square root of it */
/* Powers of two of the largest magnitudes whose squares a run may sum as they are: 2^119 at most, and what is
 * lost to the smallest float is below 2^-69 of the largest square. */
enum { gram_least_exponent = -40, gram_most_exponent = 55 };

static bool fits_int(uint64_t n) {
  return n <= INT_MAX;
}

/* OpenBLAS divides large calls among threads of its own when it has any. Those wait for each other by giving
 * up the processor again and again, which on a machine with other work takes many times as long as the work
 * itself; a host does better to leave it one thread, as the command does, and then calls are divided here
 * among the context's. */
static bool blas_has_threads(void) {
  return openblas_get_num_threads() > 1;
}

/* ---- products ---- */

/* Operations of a part that outweigh handing it out. */
enum { part_operations = 4 << 20, part_grain = 32 };

typedef struct product {
  uint32_t flags;
  uint64_t m, n, k;
  float alpha, beta;
  const float *a, *b;
  float *c;
  size_t a_ld, b_ld, c_ld;
  bool by_rows;
  uint64_t part; /* rows or columns of c in one */
} product;

static void multiply(const product *p, uint64_t i, uint64_t rows, uint64_t j, uint64_t columns) {
  const bool ta = (p->flags & BTF_TRANSPOSE_A) != 0, tb = (p->flags & BTF_TRANSPOSE_B) != 0;
  cblas_sgemm(CblasRowMajor, ta ? CblasTrans : CblasNoTrans, tb ? CblasTrans : CblasNoTrans, (int)rows,
              (int)columns, (int)p->k, p->alpha, p->a + (ta ? i : i * p->a_ld), (int)p->a_ld,
              p->b + (tb ? j * p->b_ld : j), (int)p->b_ld, p->beta, p->c + i * p->c_ld + j, (int)p->c_ld);
}

static void multiply_part(void *user, uint32_t index, uint32_t thread) {
  const product *p = user;
  const uint64_t first = index * p->part;
  (void)thread;
  if (p->by_rows)
    multiply(p, first, BTFI_MIN(p->part, p->m - first), 0, p->n);
  else
    multiply(p, 0, p->m, first, BTFI_MIN(p->part, p->n - first));
}

/* Parts whose sizes do not depend on the number of threads, so that neither does the result. */
static btf_status multiply_in_parts(btf_context *ctx, product *p) {
  const uint64_t side = BTFI_MAX(p->m, p->n), other = BTFI_MIN(p->m, p->n);
  const double operations = (double)other * (double)p->k;
  const double least = operations > 0.0 ? (double)part_operations / operations : (double)side;
  p->by_rows = p->m >= p->n;
  p->part = least < (double)side ? ((uint64_t)least / part_grain + 1) * part_grain : side;
  const uint64_t parts = (side + p->part - 1) / p->part;
  if (parts < 2 || parts > UINT32_MAX || blas_has_threads()) {
    multiply(p, 0, p->m, 0, p->n);
    return BTF_OK;
  }
  return btfi_parallel(ctx, (uint32_t)parts, multiply_part, p);
}

btf_status btfi_gemm(btf_context *ctx, uint32_t flags, uint64_t m, uint64_t n, uint64_t k, float alpha,
                     const float *a, size_t a_ld, const float *b, size_t b_ld, float beta, float *c,
                     size_t c_ld) {
  product p = {flags, m, n, k, alpha, beta, a, b, c, a_ld, b_ld, c_ld, true, 0};
  if (flags & ~(uint32_t)(BTF_TRANSPOSE_A | BTF_TRANSPOSE_B))
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "gemm: unknown flags %#x", (unsigned)flags);
  if (!fits_int(m) || !fits_int(n) || !fits_int(k) || !fits_int(a_ld) || !fits_int(b_ld) || !fits_int(c_ld))
    return btfi_fail(ctx, BTF_E_LIMIT, "gemm: a matrix has more than %d rows or columns", INT_MAX);
  if (m == 0 || n == 0) return BTF_OK;
  return multiply_in_parts(ctx, &p);
}

/* ---- Gram matrices ---- */

static float largest_magnitude(const float *a, size_t a_ld, int rows, uint32_t columns) {
  float largest = 0.0f;
  for (int r = 0; r < rows; r++)
    for (uint32_t c = 0; c < columns; c++) {
      const float magnitude = fabsf(a[(size_t)r * a_ld + c]);
      largest = magnitude > largest ? magnitude : largest;
    }
  return largest;
}

/* The power of two that brings a run near 1, or 0 if its squares are fine. */
static int run_exponent(const float *a, size_t a_ld, int rows, uint32_t columns) {
  const float largest = largest_magnitude(a, a_ld, rows, columns);
  int exponent;
  if (!(largest > 0.0f) || isinf(largest)) return 0;
  (void)frexpf(largest, &exponent);
  return exponent < gram_least_exponent || exponent > gram_most_exponent ? exponent : 0;
}

static void scale_run(const float *a, size_t a_ld, int rows, uint32_t columns, int exponent, float *dst) {
  for (int r = 0; r < rows; r++)
    for (uint32_t c = 0; c < columns; c++)
      dst[(size_t)r * columns + c] = ldexpf(a[(size_t)r * a_ld + c], -exponent);
}

/* One run's share of the lower half of the matrix, in strips of rows. */
typedef struct gram_job {
  uint32_t columns, strip;
  int rows;
  const float *run;
  size_t run_ld;
  double unit;
  float *part; /* columns x columns */
  double *g;
} gram_job;

static void add_strip(void *user, uint32_t index, uint32_t thread) {
  const gram_job *job = user;
  const uint32_t first = index * job->strip, n = BTFI_MIN(job->strip, job->columns - first);
  const size_t columns = job->columns;
  float *const part = job->part + first * columns;
  (void)thread;
  if (first > 0)
    cblas_sgemm(CblasRowMajor, CblasTrans, CblasNoTrans, (int)n, (int)first, job->rows, 1.0f,
                job->run + first, (int)job->run_ld, job->run, (int)job->run_ld, 0.0f, part, (int)columns);
  cblas_ssyrk(CblasRowMajor, CblasLower, CblasTrans, (int)n, job->rows, 1.0f, job->run + first,
              (int)job->run_ld, 0.0f, part + first, (int)columns);
  for (size_t i = first; i < first + n; i++)
    for (size_t j = 0; j <= i; j++) job->g[i * columns + j] += job->unit * (double)job->part[i * columns + j];
}

/* Strips for at least this many columns; fewer are not worth dividing. */
enum { gram_strip = 64 };

btf_status btfi_gram(btf_context *ctx, uint64_t rows, uint32_t columns, const float *a, size_t a_ld,
                     double *g) {
  if (!fits_int(columns) || !fits_int(a_ld))
    return btfi_fail(ctx, BTF_E_LIMIT, "gram: a matrix has more than %d columns", INT_MAX);
  float *part = btfi_alloc(ctx, (uint64_t)columns * columns, sizeof *part);
  if (part == NULL) return btfi_alloc_status();
  float *scaled = NULL;
  btf_status status = BTF_OK;
  for (uint64_t first = 0; first < rows && status == BTF_OK; first += gram_run) {
    gram_job job = {.columns = columns,
                    .strip = blas_has_threads() ? columns : gram_strip,
                    .rows = (int)BTFI_MIN((uint64_t)gram_run, rows - first),
                    .run = a + first * a_ld,
                    .run_ld = a_ld,
                    .part = part,
                    .g = g};
    const int exponent = run_exponent(job.run, a_ld, job.rows, columns);
    if (exponent != 0) {
      if (scaled == NULL) scaled = btfi_alloc(ctx, (uint64_t)gram_run * columns, sizeof *scaled);
      if (scaled == NULL) {
        status = btfi_alloc_status();
        break;
      }
      scale_run(job.run, a_ld, job.rows, columns, exponent, scaled);
      job.run = scaled;
      job.run_ld = columns;
    }
    job.unit = ldexp(1.0, 2 * exponent);
    status = btfi_parallel(ctx, (columns + job.strip - 1) / job.strip, add_strip, &job);
  }
  for (size_t i = 0; i < columns; i++)
    for (size_t j = 0; j < i; j++) g[j * columns + i] = g[i * columns + j];
  btfi_free(ctx, scaled);
  btfi_free(ctx, part);
  return status;
}

bool btfi_is_finite(uint32_t n, const double *a, size_t ld) {
  for (size_t i = 0; i < n; i++)
    for (size_t j = 0; j < n; j++)
      if (!(a[i * ld + j] - a[i * ld + j] == 0.0)) return false;
  return true;
}

/* What dsyevd documents as enough. */
static uint64_t eigen_reals(uint32_t n) {
  return 1 + 6 * (uint64_t)n + 2 * (uint64_t)n * n;
}
static uint64_t eigen_integers(uint32_t n) {
  return 3 + 5 * (uint64_t)n;
}

uint64_t btfi_eigen_room(uint32_t n) {
  const uint64_t integers = eigen_integers(n) * sizeof(lapack_int);
  if (!fits_int(n) || !fits_int(eigen_reals(n))) return 0;
  return eigen_reals(n) + (integers + sizeof(double) - 1) / sizeof(double);
}

btf_status btfi_symmetric_eigen_in(btf_context *ctx, uint32_t n, double *a, size_t ld, double *values,
                                   double *room) {
  if (n == 0) return BTF_OK;
  if (btfi_eigen_room(n) == 0 || !fits_int(ld))
    return btfi_fail(ctx, BTF_E_LIMIT, "eigenvectors: a matrix of %u rows is too large for LAPACK", n);
  const uint64_t reals = eigen_reals(n);
  /* Column-major, the vectors are columns, which are rows here; LAPACK sorts upwards. The other forms of this
   * call allocate what the context does not know of. */
  if (LAPACKE_dsyevd_work(LAPACK_COL_MAJOR, 'V', 'L', (lapack_int)n, a, (lapack_int)ld, values, room,
                          (lapack_int)reals, (lapack_int *)(void *)(room + reals),
                          (lapack_int)eigen_integers(n)) != 0)
    return btfi_fail(ctx, BTF_E_NUMERIC, "eigenvectors: LAPACK found none of a matrix of %u rows", n);
  for (size_t i = 0, j = n - 1; i < j; i++, j--) {
    const double value = values[i];
    values[i] = values[j];
    values[j] = value;
    cblas_dswap((int)n, a + i * ld, 1, a + j * ld, 1);
  }
  return BTF_OK;
}

btf_status btfi_symmetric_eigen(btf_context *ctx, uint32_t n, double *a, double *values) {
  if (n == 0) return BTF_OK;
  if (btfi_eigen_room(n) == 0)
    return btfi_fail(ctx, BTF_E_LIMIT, "eigenvectors: a matrix of %u rows is too large for LAPACK", n);
  if (!btfi_is_finite(n, a, n)) return btfi_fail(ctx, BTF_E_NUMERIC, "eigenvectors: a matrix is not finite");
  double *const room = btfi_alloc(ctx, btfi_eigen_room(n), sizeof *room);
  if (room == NULL) return btfi_alloc_status();
  const btf_status status = btfi_symmetric_eigen_in(ctx, n, a, n, values, room);
  btfi_free(ctx, room);
  return status;
}

btf_status btfi_cholesky(btf_context *ctx, uint32_t n, double *a) {
  if (n == 0) return BTF_OK;
  if (!fits_int(n)) return btfi_fail(ctx, BTF_E_LIMIT, "cholesky: a matrix has more than %d rows", INT_MAX);
  /* The lower half by rows is the upper half by columns, and L is U^T: LAPACKE would transpose rows into a
   * second matrix that the context does not know of. */
  if (LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'U', (lapack_int)n, a, (lapack_int)n) != 0)
    return btfi_fail(ctx, BTF_E_NUMERIC, "cholesky: a matrix of %u rows is not positive definite", n);
  return BTF_OK;
}

btf_status btfi_cholesky_solve(btf_context *ctx, uint32_t n, const double *factor, uint32_t columns,
                               double *b) {
  if (n == 0 || columns == 0) return BTF_OK;
  if (!fits_int(n) || !fits_int(columns))
    return btfi_fail(ctx, BTF_E_LIMIT, "cholesky: a matrix has more than %d rows or columns", INT_MAX);
  cblas_dtrsm(CblasRowMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, (int)n, (int)columns, 1.0,
              factor, (int)n, b, (int)columns);
  cblas_dtrsm(CblasRowMajor, CblasLeft, CblasLower, CblasTrans, CblasNonUnit, (int)n, (int)columns, 1.0,
              factor, (int)n, b, (int)columns);
  return BTF_OK;
}
