/* SPDX-License-Identifier: MIT */
#include "dense/dense.h"

#include <limits.h>

#include <cblas.h>
#include <lapacke.h>

#include <btf/btf_plugin.h>

enum { gram_run = 512 }; /* rows whose squares a float may sum: rounding grows with the square root of it */

static bool fits_int(uint64_t n) {
  return n <= INT_MAX;
}

btf_status btfi_gemm(btf_context *ctx, uint32_t flags, uint64_t m, uint64_t n, uint64_t k, float alpha,
                     const float *a, size_t a_ld, const float *b, size_t b_ld, float beta, float *c,
                     size_t c_ld) {
  if (!fits_int(m) || !fits_int(n) || !fits_int(k) || !fits_int(a_ld) || !fits_int(b_ld) || !fits_int(c_ld))
    return btfi_fail(ctx, BTF_E_LIMIT, "gemm: a matrix has more than %d rows or columns", INT_MAX);
  if (m == 0 || n == 0) return BTF_OK;
  cblas_sgemm(CblasRowMajor, flags & BTF_TRANSPOSE_A ? CblasTrans : CblasNoTrans,
              flags & BTF_TRANSPOSE_B ? CblasTrans : CblasNoTrans, (int)m, (int)n, (int)k, alpha, a,
              (int)a_ld, b, (int)b_ld, beta, c, (int)c_ld);
  return BTF_OK;
}

btf_status btfi_gram(btf_context *ctx, uint64_t rows, uint32_t columns, const float *a, size_t a_ld,
                     double *g) {
  if (!fits_int(columns) || !fits_int(a_ld))
    return btfi_fail(ctx, BTF_E_LIMIT, "gram: a matrix has more than %d columns", INT_MAX);
  float *part = btfi_alloc(ctx, (uint64_t)columns * columns, sizeof *part);
  if (part == NULL) return btfi_alloc_status();
  for (uint64_t first = 0; first < rows; first += gram_run) {
    const int count = (int)BTFI_MIN((uint64_t)gram_run, rows - first);
    cblas_ssyrk(CblasRowMajor, CblasLower, CblasTrans, (int)columns, count, 1.0f, a + first * a_ld, (int)a_ld,
                0.0f, part, (int)columns);
    for (size_t i = 0; i < columns; i++)
      for (size_t j = 0; j <= i; j++) g[i * columns + j] += (double)part[i * columns + j];
  }
  for (size_t i = 0; i < columns; i++)
    for (size_t j = 0; j < i; j++) g[j * columns + i] = g[i * columns + j];
  btfi_free(ctx, part);
  return BTF_OK;
}

btf_status btfi_symmetric_eigen(btf_context *ctx, uint32_t n, double *a, double *values) {
  if (n == 0) return BTF_OK;
  if (!fits_int(n))
    return btfi_fail(ctx, BTF_E_LIMIT, "eigenvectors: a matrix has more than %d rows", INT_MAX);
  for (size_t i = 0; i < (size_t)n * n; i++)
    if (!(a[i] - a[i] == 0.0)) return btfi_fail(ctx, BTF_E_NUMERIC, "eigenvectors: a matrix is not finite");
  /* Column-major, the vectors are columns, which are rows here; LAPACK sorts upwards. */
  if (LAPACKE_dsyevd(LAPACK_COL_MAJOR, 'V', 'L', (lapack_int)n, a, (lapack_int)n, values) != 0)
    return btfi_fail(ctx, BTF_E_NUMERIC, "eigenvectors: LAPACK found none of a matrix of %u rows", n);
  for (size_t i = 0, j = n - 1; i < j; i++, j--) {
    const double value = values[i];
    values[i] = values[j];
    values[j] = value;
    cblas_dswap((int)n, a + i * n, 1, a + j * n, 1);
  }
  return BTF_OK;
}

btf_status btfi_cholesky(btf_context *ctx, uint32_t n, double *a) {
  if (n == 0) return BTF_OK;
  if (!fits_int(n)) return btfi_fail(ctx, BTF_E_LIMIT, "cholesky: a matrix has more than %d rows", INT_MAX);
  if (LAPACKE_dpotrf(LAPACK_ROW_MAJOR, 'L', (lapack_int)n, a, (lapack_int)n) != 0)
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
