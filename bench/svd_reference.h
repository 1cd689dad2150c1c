/* SPDX-License-Identifier: MIT */
/* svd_reference.h: what a truncated SVD is measured by, without anything of the library's own solver. */
#ifndef BENCH_SVD_REFERENCE_H
#define BENCH_SVD_REFERENCE_H

#include <btf/btf_plugin.h>

/* Relative Frobenius error of the best approximation of this rank: from the leading eigenvalues of M^T M by
 * block Lanczos in double, every new block made orthogonal to all before it. 0, or -1 with a message on
 * stderr. */
int reference_optimum(const btf_svd_desc *matrix, uint32_t rank, double *error);

/* Relative Frobenius error of the triplets: from the differences M - U diag(sigma) V^T, squared and added up
 * in double. 0, or -1 with a message on stderr. */
int reference_error(const btf_svd_desc *matrix, const btf_svd_result *triplets, double *error);

#endif
