/* SPDX-License-Identifier: MIT */
/* Matrices whose singular values are known, how they are read in blocks, and what every result must be. */
#ifndef SVD_MATRICES_H
#define SVD_MATRICES_H

#include "btf_test.h"

#include "svd/svd.h"

typedef struct matrix {
  uint64_t items, length;
  float *values; /* items x length */
  double *sigma; /* of the float values, by LAPACK */
  double energy;
  long reads, fail_at;
  btf_status fail_with; /* BTF_OK stands for BTF_E_IO */
  uint64_t items_read, largest_read;
  uint32_t layout;
} matrix;

matrix matrix_alloc(uint64_t items, uint64_t length);
void matrix_measure(matrix *m); /* fills sigma and energy from the values */
void matrix_free(matrix *m);
/* Squared error of the best approximation of this rank. */
double optimum(const matrix *m, uint32_t rank);

/* U diag(spectrum) V^T with random U and V. */
matrix with_spectrum(uint64_t items, uint64_t length, double (*spectrum)(uint64_t), uint64_t seed);
double spectrum_fast(uint64_t k);
double spectrum_slow(uint64_t k);
double spectrum_power(uint64_t k);
double spectrum_repeated(uint64_t k);
double spectrum_clustered(uint64_t k);
double spectrum_flat(uint64_t k);
double spectrum_rank_seven(uint64_t k);
matrix with_rare_features(uint64_t items, uint64_t length);
matrix with_narrow_lobes(uint64_t side, uint64_t length);
/* 65536 items of 400 elements with 350 components that fall by 0.86 from one to the next. The items listed
 * have a direction of their own beside, with `weight` of the 32nd squared value each. */
matrix with_some_alike(const uint64_t *alike, size_t count, double weight);

btf_svd_desc describe(matrix *m, uint32_t rank);
btf_svd_result fresh(void);
/* Bytes that the panels need at least, as the refusal names them. */
uint64_t smallest_budget(btf_context *ctx, btf_svd_desc desc);

/* ||M - U S V^T||^2, entry by entry. */
double explicit_error(const matrix *m, const btf_svd_result *r);
/* What float panels may put wrong in a singular value. */
double sigma_rounding(const matrix *m);
void check_result(const matrix *m, const btf_svd_result *r);
void check_optimal(const matrix *m, const btf_svd_result *r, double ratio);

#endif
