/* SPDX-License-Identifier: MIT */
/* exact_svd.h: singular values by LAPACK in double, which the optima of factorisations are told by. */
#ifndef EXACT_SVD_H
#define EXACT_SVD_H

#include <stddef.h>

/* The min(rows, columns) singular values of a row-major matrix, which is overwritten. From malloc. */
double *exact_singular_values(double *matrix, size_t rows, size_t columns);
/* Squared error of the best approximation with `kept` terms. */
double exact_tail(const double *sigma, size_t count, size_t kept);

#endif
