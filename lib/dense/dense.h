/* SPDX-License-Identifier: MIT */
/* dense.h: the dense linear algebra that codecs reach through the host table; btf_plugin.h says what each
 * does. */
#ifndef BTFI_DENSE_H
#define BTFI_DENSE_H

#include "base/base.h"

btf_status btfi_gemm(btf_context *ctx, uint32_t flags, uint64_t m, uint64_t n, uint64_t k, float alpha,
                     const float *a, size_t a_ld, const float *b, size_t b_ld, float beta, float *c,
                     size_t c_ld);
btf_status btfi_gram(btf_context *ctx, uint64_t rows, uint32_t columns, const float *a, size_t a_ld,
                     double *g);
btf_status btfi_symmetric_eigen(btf_context *ctx, uint32_t n, double *a, double *values);
/* The same for rows `ld` apart that are finite, with memory of the caller's: btfi_eigen_room(n) doubles,
 * which is 0 if n is too large for LAPACK. */
btf_status btfi_symmetric_eigen_in(btf_context *ctx, uint32_t n, double *a, size_t ld, double *values,
                                   double *room);
uint64_t btfi_eigen_room(uint32_t n);
bool btfi_is_finite(uint32_t n, const double *a, size_t ld);
btf_status btfi_cholesky(btf_context *ctx, uint32_t n, double *a);
btf_status btfi_cholesky_solve(btf_context *ctx, uint32_t n, const double *factor, uint32_t columns,
                               double *b);

#endif
