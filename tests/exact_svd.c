/* SPDX-License-Identifier: MIT */
#include "exact_svd.h"

#include <lapacke.h>

#include "btf_test.h"

double *exact_singular_values(double *matrix, size_t rows, size_t columns) {
  const size_t count = rows < columns ? rows : columns;
  double *sigma = malloc(count * sizeof *sigma), vectors; /* none are asked for */
  assert_non_null(sigma);
  assert_int_equal(LAPACKE_dgesdd(LAPACK_ROW_MAJOR, 'N', (lapack_int)rows, (lapack_int)columns, matrix,
                                  (lapack_int)columns, sigma, &vectors, 1, &vectors, (lapack_int)columns),
                   0);
  return sigma;
}

double exact_tail(const double *sigma, size_t count, size_t kept) {
  double tail = 0.0;
  for (size_t k = kept; k < count; k++) tail += sigma[k] * sigma[k];
  return tail;
}
