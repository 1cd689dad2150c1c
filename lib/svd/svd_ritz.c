/* SPDX-License-Identifier: MIT */
/* svd_ritz.c: the small dense steps, in double. Panels are float, but their Gram matrices are exact sums of
 * exact products, so that directions down to float's own resolution can be told apart. */
#include <cblas.h>
#include <lapacke.h>
#include <math.h>
#include <string.h>

#include "dense/dense.h"
#include "svd/svd_state.h"

/* Squared ratio below which a direction of a float panel is rounding: (3e-7)^2. */
static const double resolution = 1e-13;
/* The same for columns scaled to one length, where what is kept must also agree with the image of the panel.
 */
static const double independence = 1e-10;
/* And for two bases side by side: where they agree to 3e-3, their difference holds more rounding than news.
 */
static const double novelty = 1e-5;

void btfi_svd_gram(svd_state *s, const float *panel, size_t rows, double *gram) {
  const uint32_t width = s->plan.width;
  memset(gram, 0, (size_t)width * width * sizeof(double));
  for (size_t first = 0; first < rows; first += SVD_GRAM_ROWS) {
    const size_t count = BTFI_MIN((size_t)SVD_GRAM_ROWS, rows - first);
    const float *src = panel + first * width;
    for (size_t k = 0; k < count * width; k++) s->rows[k] = src[k];
    cblas_dsyrk(CblasRowMajor, CblasUpper, CblasTrans, (int)width, (int)count, 1, s->rows, (int)width, 1,
                gram, (int)width);
  }
  for (uint32_t i = 0; i < width; i++) {
    for (uint32_t j = 0; j < i; j++) gram[(size_t)i * width + j] = gram[(size_t)j * width + i];
  }
}

btf_status btfi_svd_not_finite(svd_state *s) {
  s->overflowed = true;
  return btfi_fail(s->ctx, BTF_E_NUMERIC,
                   "svd: the matrix has values that are not finite or beyond float's range");
}

/* Eigenvalues, descending, and row-major eigenvectors in columns, in place. */
static btf_status eigen(svd_state *s, double *a, uint32_t n, uint32_t ld, double *values) {
  if (!btfi_is_finite(n, a, ld)) return btfi_svd_not_finite(s);
  BTFI_TRY(btfi_symmetric_eigen_in(s->ctx, n, a, ld, values, s->rows));
  for (uint32_t i = 0; i < n; i++) {
    for (uint32_t j = 0; j < i; j++) {
      const double value = a[(size_t)i * ld + j];
      a[(size_t)i * ld + j] = a[(size_t)j * ld + i];
      a[(size_t)j * ld + i] = value;
    }
  }
  return BTF_OK;
}

/* map (width x *kept, rows of width) such that panel * map is orthonormal, from the panel's Gram matrix
 * (overwritten). *spread is the ratio of the scaled Gram matrix's extreme eigenvalues. */
static btf_status whitening(svd_state *s, uint32_t width, double *gram, double *map, double *scale,
                            double *values, double threshold, uint32_t *kept, double *spread) {
  double largest = 0;
  for (uint32_t i = 0; i < width; i++) largest = fmax(largest, gram[(size_t)i * width + i]);
  if (!isfinite(largest)) return btfi_svd_not_finite(s);
  for (uint32_t i = 0; i < width; i++) {
    const double square = gram[(size_t)i * width + i];
    scale[i] = square > resolution * largest && square > 0 ? 1 / sqrt(square) : 0;
  }
  for (uint32_t i = 0; i < width; i++) {
    for (uint32_t j = 0; j < width; j++) gram[(size_t)i * width + j] *= scale[i] * scale[j];
  }
  BTFI_TRY(eigen(s, gram, width, width, values));
  *kept = 0;
  while (*kept < width && values[*kept] > threshold * values[0] && values[*kept] > 0) ++*kept;
  *spread = *kept > 0 ? values[0] / values[*kept - 1] : 1;
  memset(map, 0, (size_t)width * width * sizeof(double));
  for (uint32_t i = 0; i < width; i++) {
    for (uint32_t j = 0; j < *kept; j++)
      map[(size_t)i * width + j] = scale[i] * gram[(size_t)i * width + j] / sqrt(values[j]);
  }
  return BTF_OK;
}

void btfi_svd_apply(svd_state *s, float *panel, size_t rows, const double *map, uint32_t columns) {
  const uint32_t width = s->plan.width;
  float *chunk = (float *)s->rows;
  float *factor = chunk + (size_t)SVD_GRAM_ROWS * width;
  /* `rows` holds max(SVD_GRAM_ROWS, width) x width doubles: room for the chunk and for the map in float. */
  for (size_t k = 0; k < (size_t)width * width; k++) factor[k] = 0;
  for (uint32_t i = 0; i < width; i++) {
    for (uint32_t j = 0; j < columns; j++) factor[(size_t)i * width + j] = (float)map[(size_t)i * width + j];
  }
  for (size_t first = 0; first < rows; first += SVD_GRAM_ROWS) {
    const size_t count = BTFI_MIN((size_t)SVD_GRAM_ROWS, rows - first);
    memcpy(chunk, panel + first * width, count * width * sizeof(float));
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)count, (int)width, (int)width, 1, chunk,
                (int)width, factor, (int)width, 0, panel + first * width, (int)width);
  }
}

btf_status btfi_svd_orthonormalise(svd_state *s, float *panel, size_t rows, uint32_t *kept) {
  const size_t matrix = (size_t)s->plan.width * s->plan.width;
  double *gram = s->small, *map = s->small + matrix;
  double *scale = s->theta + 2 * (size_t)s->plan.width, *values = scale + s->plan.width;
  double spread = 1;
  /* What is left of a nearly dependent panel is orthonormal to the rounding of the first map only: go over it
   * again. */
  for (int round = 0; round < 3; round++) {
    btfi_svd_gram(s, panel, rows, gram);
    BTFI_TRY(whitening(s, s->plan.width, gram, map, scale, values, resolution, kept, &spread));
    btfi_svd_apply(s, panel, rows, map, *kept);
    if (spread < 30) break;
  }
  return BTF_OK;
}

/* out = a^T b a for n x n matrices, with `half` as room. */
static void congruence(int n, const double *a, const double *b, double *half, double *out) {
  cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, n, n, n, 1, b, n, a, n, 0, half, n);
  cblas_dgemm(CblasRowMajor, CblasTrans, CblasNoTrans, n, n, n, 1, a, n, half, n, 0, out, n);
}

btf_status btfi_svd_ritz(svd_state *s, size_t rows) {
  const uint32_t width = s->plan.width;
  const size_t matrix = (size_t)width * width;
  double *gram = s->small, *whiten = gram + matrix, *gram_image = whiten + matrix,
         *half = gram_image + matrix;
  double *inner = half + matrix;
  double *scale = s->theta + 2 * (size_t)width, *values = scale + width;
  uint32_t kept;
  s->ritz = s->theta;
  s->ritz_before = s->theta + width;
  s->left = inner + matrix;
  s->right = s->left + matrix;

  btfi_svd_gram(s, s->projection, rows, gram);
  memcpy(half, gram, matrix * sizeof(double));
  BTFI_TRY(whitening(s, s->plan.width, gram, whiten, scale, values, independence, &kept, &s->spread));
  BTFI_TRY(eigen(s, half, width, width, s->ritz_before));

  btfi_svd_gram(s, s->image, s->plan.length_padded, gram_image);
  congruence((int)width, whiten, gram_image, half, inner);
  memset(s->ritz, 0, width * sizeof(double));
  BTFI_TRY(eigen(s, inner, kept, width, s->ritz));
  s->found = 0;
  while (s->found < kept && s->ritz[s->found] > resolution * s->ritz[0] && s->ritz[s->found] > 0) s->found++;
  /* A direction that C holds no more of than rounding is not one, however clear it looks when magnified. */
  while (s->found > 0 && !(s->ritz_before[s->found - 1] > resolution * s->ritz_before[0])) s->found--;

  memset(s->left, 0, matrix * sizeof(double));
  memset(s->right, 0, matrix * sizeof(double));
  if (s->found == 0) return BTF_OK;
  cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)width, (int)s->found, (int)kept, 1, whiten,
              (int)width, inner, (int)width, 0, s->left, (int)width);
  for (uint32_t i = 0; i < width; i++) {
    for (uint32_t j = 0; j < s->found; j++)
      s->right[(size_t)i * width + j] = s->left[(size_t)i * width + j] / sqrt(s->ritz[j]);
  }
  return BTF_OK;
}

btf_status btfi_svd_straighten(svd_state *s, float *panel, size_t rows, uint32_t columns) {
  const uint32_t width = s->plan.width;
  double *gram = s->small;
  btfi_svd_gram(s, panel, rows, gram);
  double worst = 0;
  for (uint32_t i = 0; i < columns; i++) {
    for (uint32_t j = 0; j < columns; j++) worst = fmax(worst, fabs(gram[(size_t)i * width + j] - (i == j)));
  }
  if (!btfi_is_finite(columns, gram, width)) return btfi_svd_not_finite(s);
  if (worst <= 5e-7) return BTF_OK;
  /* Cholesky keeps the order: a weak vector gives way to a strong one and never the other way, which would
   * put the weak one's rounding into the strong one's place. */
  /* The upper half by rows is the lower half by columns, which LAPACKE need not copy. */
  if (LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', (lapack_int)columns, gram, (lapack_int)width) != 0 ||
      LAPACKE_dtrtri(LAPACK_COL_MAJOR, 'L', 'N', (lapack_int)columns, gram, (lapack_int)width) != 0) {
    s->lost = true;
    return btfi_fail(s->ctx, BTF_E_NUMERIC, "svd: singular vectors lost their orthogonality");
  }
  for (uint32_t i = 0; i < columns; i++) {
    for (uint32_t j = 0; j < i; j++) gram[(size_t)i * width + j] = 0;
  }
  btfi_svd_apply(s, panel, rows, gram, columns);
  return BTF_OK;
}

/* The corner of `gram` (twice the width) that starts at (row, column) = a^T b in double. */
static void corner(svd_state *s, const float *a, const float *b, size_t rows, double *gram, size_t row,
                   size_t column) {
  const size_t width = s->plan.width, half = SVD_GRAM_ROWS / 2;
  double *left = s->rows, *right = s->rows + half * width;
  double *out = gram + row * 2 * width + column;
  for (size_t i = 0; i < width; i++) memset(out + i * 2 * width, 0, width * sizeof(double));
  for (size_t first = 0; first < rows; first += half) {
    const size_t count = BTFI_MIN(half, rows - first);
    for (size_t k = 0; k < count * width; k++) {
      left[k] = a[first * width + k];
      right[k] = b[first * width + k];
    }
    cblas_dgemm(CblasRowMajor, CblasTrans, CblasNoTrans, (int)width, (int)width, (int)count, 1, left,
                (int)width, right, (int)width, 1, out, 2 * (int)width);
  }
}

static void pair_gram(svd_state *s, const float *a, const float *b, size_t rows, double *gram) {
  const size_t width = s->plan.width, both = 2 * width;
  corner(s, a, a, rows, gram, 0, 0);
  corner(s, a, b, rows, gram, 0, width);
  corner(s, b, b, rows, gram, width, width);
  for (size_t i = 0; i < both; i++) {
    const bool partial = i >= width + s->partial_first && i < width + s->partial_first + s->partial_count;
    for (size_t j = i; j < both; j++) {
      const bool other = j >= width + s->partial_first && j < width + s->partial_first + s->partial_count;
      /* Columns of C that miss some items are no image of theirs. */
      if (partial || other) gram[i * both + j] = 0;
      gram[j * both + i] = gram[i * both + j];
    }
  }
}

/* a = a * map + b * (map + width * width) by rows. */
static void combine(svd_state *s, float *a, const float *b, size_t rows, const float *map) {
  const size_t width = s->plan.width;
  float *chunk = (float *)s->rows;
  for (size_t first = 0; first < rows; first += SVD_GRAM_ROWS) {
    const int count = (int)BTFI_MIN((size_t)SVD_GRAM_ROWS, rows - first), n = (int)width;
    memcpy(chunk, a + first * width, (size_t)count * width * sizeof(float));
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, count, n, n, 1, chunk, n, map, n, 0,
                a + first * width, n);
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, count, n, n, 1, b + first * width, n,
                map + width * width, n, 1, a + first * width, n);
  }
}

btf_status btfi_svd_ritz_pair(svd_state *s) {
  const uint32_t width = s->plan.width, both = 2 * width;
  const size_t matrix = (size_t)both * both, items = (size_t)s->desc->items;
  double *gram = s->wide, *whiten = gram + matrix, *image = whiten + matrix, *half = image + matrix;
  double *inner = half + matrix, *scale = inner + matrix, *values = scale + both, *ritz = values + both;
  uint32_t kept;
  pair_gram(s, s->basis, s->image, s->plan.length_padded, gram);
  BTFI_TRY(whitening(s, both, gram, whiten, scale, values, novelty, &kept, &s->spread));
  pair_gram(s, s->second_projection, s->projection, items, image);
  congruence((int)both, whiten, image, half, inner);
  BTFI_TRY(eigen(s, inner, kept, both, ritz));

  s->found = 0;
  while (s->found < BTFI_MIN(kept, width) && ritz[s->found] > resolution * ritz[0] && ritz[s->found] > 0)
    s->found++;
  memset(s->ritz, 0, width * sizeof(double));
  memset(s->left, 0, (size_t)width * width * sizeof(double));
  if (s->found == 0) return BTF_OK;
  cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)both, (int)s->found, (int)kept, 1, whiten,
              (int)both, inner, (int)both, 0, half, (int)both);
  float *map = (float *)gram;
  for (size_t i = 0; i < both; i++) {
    for (size_t j = 0; j < width; j++) map[i * width + j] = j < s->found ? (float)half[i * both + j] : 0;
  }
  /* The new C is the image of the new basis: its columns are orthogonal, as long as the singular values. */
  combine(s, s->second_projection, s->projection, items, map);
  float *swap = s->projection;
  s->projection = s->second_projection;
  s->second_projection = swap;
  combine(s, s->basis, s->image, s->plan.length_padded, map);
  for (uint32_t k = 0; k < s->found; k++) {
    s->ritz[k] = ritz[k];
    s->left[(size_t)k * width + k] = 1 / sqrt(ritz[k]);
  }
  return btfi_svd_straighten(s, s->basis, s->plan.length_padded, s->found);
}
