/* SPDX-License-Identifier: MIT */
#include "svd_reference.h"

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cblas.h>
#include <lapacke.h>

#include <btf/btf.h>

enum { BLOCK_BYTES = 64 << 20, LANCZOS_WIDTH = 32, LANCZOS_STEPS = 64 };

/* What may be wrong with the residual, as a part of it, when the iteration ends. */
static const double accuracy = 1e-9;

static int tell(const char *what) {
  fprintf(stderr, "bench_svd: %s\n", what);
  return -1;
}

/* Items whose block of values of this size has about BLOCK_BYTES: a power of two. */
static uint64_t items_at_once(const btf_svd_desc *matrix, size_t value_bytes) {
  uint64_t items = 1;
  while (items < matrix->items && 2 * items * matrix->length * value_bytes <= BLOCK_BYTES) items *= 2;
  return items;
}

static double sum_of_squares(const float *values, size_t count) {
  enum { LANES = 8 };
  double lane[LANES] = {0}, sum = 0;
  size_t k = 0;
  for (; k + LANES <= count; k += LANES) {
    for (size_t l = 0; l < LANES; l++) lane[l] += (double)values[k + l] * values[k + l];
  }
  for (; k < count; k++) sum += (double)values[k] * values[k];
  for (size_t l = 0; l < LANES; l++) sum += lane[l];
  return sum;
}

/* ---- the error reached ---- */

int reference_error(const btf_svd_desc *matrix, const btf_svd_result *triplets, double *error) {
  const int length = (int)matrix->length, rank = (int)triplets->rank;
  const bool rows = matrix->layout == BTF_LAYOUT_ITEM_ROWS;
  const uint64_t most = items_at_once(matrix, sizeof(float));
  float *block = malloc(most * matrix->length * sizeof *block);
  float *left = malloc(most * ((size_t)rank + 1) * sizeof *left);
  double energy = 0, rest = 0;
  int status = block != NULL && left != NULL ? 0 : tell("no memory to measure the error in");
  for (uint64_t first = 0, items; first < matrix->items && status == 0; first += items) {
    items = matrix->items - first < most ? matrix->items - first : most;
    const int count = (int)items, ld = rows ? length : count;
    const float *u = triplets->item_vectors + first * triplets->rank;
    if (matrix->read(matrix->user, first, items, block, (size_t)ld) != BTF_OK) {
      status = tell(btf_error_message());
      break;
    }
    energy += sum_of_squares(block, items * matrix->length);
    for (size_t k = 0; k < items * triplets->rank; k++)
      left[k] = (float)(u[k] * triplets->sigma[k % triplets->rank]);
    if (rank > 0 && rows)
      cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, count, length, rank, -1, left, rank,
                  triplets->element_vectors, rank, 1, block, ld);
    else if (rank > 0)
      cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, length, count, rank, -1, triplets->element_vectors,
                  rank, left, rank, 1, block, ld);
    rest += sum_of_squares(block, items * matrix->length);
  }
  *error = energy > 0 ? sqrt(rest / energy) : 0;
  free(block);
  free(left);
  return status;
}

/* ---- the optimum ---- */

/* Panels are column-major. `basis` has room for `capacity` columns, and the block that comes next follows
 * those in use; `inner` is basis^T M^T M basis, column-major with `capacity` rows. */
typedef struct lanczos {
  const btf_svd_desc *matrix;
  size_t length, capacity, used;
  uint64_t most; /* items at once */
  float *read;
  double *block, *projection;
  double *basis, *image, *inner, *along;
  double *triangle, *tau;
  double *small, *values, *vectors;
  double energy;
} lanczos;

/* image = M^T M (last block of the basis), in one reading. */
static int apply(lanczos *l, const double *basis) {
  const btf_svd_desc *matrix = l->matrix;
  const bool rows = matrix->layout == BTF_LAYOUT_ITEM_ROWS;
  const int length = (int)l->length;
  double energy = 0;
  memset(l->image, 0, l->length * LANCZOS_WIDTH * sizeof(double));
  for (uint64_t first = 0, items; first < matrix->items; first += items) {
    items = matrix->items - first < l->most ? matrix->items - first : l->most;
    const int count = (int)items, ld = rows ? length : count;
    if (matrix->read(matrix->user, first, items, l->read, (size_t)ld) != BTF_OK)
      return tell(btf_error_message());
    for (size_t k = 0; k < items * l->length; k++) l->block[k] = l->read[k];
    energy += sum_of_squares(l->read, items * l->length);
    /* Item rows by column-major rules are items in columns. */
    cblas_dgemm(CblasColMajor, rows ? CblasTrans : CblasNoTrans, CblasNoTrans, count, LANCZOS_WIDTH, length,
                1, l->block, ld, basis, length, 0, l->projection, count);
    cblas_dgemm(CblasColMajor, rows ? CblasNoTrans : CblasTrans, CblasNoTrans, length, LANCZOS_WIDTH, count,
                1, l->block, ld, l->projection, count, 1, l->image, length);
  }
  l->energy = energy;
  return 0;
}

/* panel = orthonormal * triangle, in place. */
static int factor(lanczos *l, double *panel) {
  const lapack_int length = (lapack_int)l->length, width = LANCZOS_WIDTH;
  if (LAPACKE_dgeqrf(LAPACK_COL_MAJOR, length, width, panel, length, l->tau) != 0)
    return tell("the basis cannot be made orthonormal");
  for (size_t j = 0; j < LANCZOS_WIDTH; j++)
    for (size_t i = 0; i < LANCZOS_WIDTH; i++)
      l->triangle[j * LANCZOS_WIDTH + i] = i <= j ? panel[j * l->length + i] : 0;
  return LAPACKE_dorgqr(LAPACK_COL_MAJOR, length, width, width, panel, length, l->tau) == 0
             ? 0
             : tell("the basis cannot be made orthonormal");
}

/* Takes the image's part within the basis out of it, twice, and adds it to the last columns of `inner`. */
static void orthogonalise(lanczos *l) {
  const int length = (int)l->length, used = (int)l->used;
  double *inner = l->inner + (l->used - LANCZOS_WIDTH) * l->capacity;
  for (int round = 0; round < 2; round++) {
    cblas_dgemm(CblasColMajor, CblasTrans, CblasNoTrans, used, LANCZOS_WIDTH, length, 1, l->basis, length,
                l->image, length, 0, l->along, used);
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasNoTrans, length, LANCZOS_WIDTH, used, -1, l->basis, length,
                l->along, used, 1, l->image, length);
    for (size_t j = 0; j < LANCZOS_WIDTH; j++)
      for (size_t i = 0; i < l->used; i++) inner[j * l->capacity + i] += l->along[j * l->used + i];
  }
}

/* The sum of the leading Ritz values, and what it may lack: with R the residuals of the Ritz vectors, no more
 * than the sum of their lengths, nor, once the space holds the leading ones, than |R|^2 over the gap to the
 * next value. */
static int leading(lanczos *l, uint32_t rank, double *sum, double *lacking) {
  const lapack_int used = (lapack_int)l->used, wanted = (lapack_int)rank + 1;
  lapack_int found = 0, support[2 * LANCZOS_WIDTH * LANCZOS_STEPS];
  for (size_t j = 0; j < l->used; j++)
    for (size_t i = 0; i <= j; i++) l->small[j * l->used + i] = l->inner[j * l->capacity + i];
  if (LAPACKE_dsyevr(LAPACK_COL_MAJOR, 'V', 'I', 'U', used, l->small, used, 0, 0, used - wanted + 1, used, 0,
                     &found, l->values, l->vectors, used, support) != 0 ||
      found != wanted)
    return tell("the Ritz values cannot be found");
  double lengths = 0, squares = 0;
  *sum = 0;
  for (lapack_int k = 1; k < wanted; k++) { /* ascending; the first is the one beyond */
    const double *last = l->vectors + (size_t)k * l->used + (l->used - LANCZOS_WIDTH);
    double residual[LANCZOS_WIDTH];
    cblas_dgemv(CblasColMajor, CblasNoTrans, LANCZOS_WIDTH, LANCZOS_WIDTH, 1, l->triangle, LANCZOS_WIDTH,
                last, 1, 0, residual, 1);
    const double square = cblas_ddot(LANCZOS_WIDTH, residual, 1, residual, 1);
    lengths += sqrt(square);
    squares += square;
    *sum += l->values[k];
  }
  const double gap = l->values[1] - l->values[0];
  *lacking = gap > 0 ? fmin(lengths, squares / gap) : lengths;
  return 0;
}

static int iterate(lanczos *l, uint32_t rank, double *error) {
  double *next = l->basis;
  uint64_t random = 1;
  for (size_t k = 0; k < l->length * LANCZOS_WIDTH; k++) {
    random = random * 6364136223846793005u + 1442695040888963407u;
    next[k] = (double)(random >> 40) - (double)(1 << 23);
  }
  if (factor(l, next) != 0) return -1;
  while (l->used + LANCZOS_WIDTH <= l->capacity) {
    double sum, lacking;
    if (apply(l, next) != 0) return -1;
    l->used += LANCZOS_WIDTH;
    orthogonalise(l);
    next = l->basis + l->used * l->length;
    memcpy(next, l->image, l->length * LANCZOS_WIDTH * sizeof(double));
    if (factor(l, next) != 0) return -1;
    if (l->used < rank + LANCZOS_WIDTH) continue;
    if (leading(l, rank, &sum, &lacking) != 0) return -1;
    const double rest = l->energy - sum;
    fprintf(stderr, "bench_svd: %zu Lanczos vectors: error %.9f, its square exact to %.1e of it\n", l->used,
            sqrt(fmax(0, rest) / l->energy), lacking / rest);
    *error = sqrt(fmax(0, rest) / l->energy);
    if (lacking <= accuracy * rest) return 0;
  }
  return tell("the Lanczos iteration did not converge");
}

int reference_optimum(const btf_svd_desc *matrix, uint32_t rank, double *error) {
  lanczos l = {
      .matrix = matrix, .length = (size_t)matrix->length, .most = items_at_once(matrix, sizeof(double))};
  const size_t steps = l.length / LANCZOS_WIDTH < LANCZOS_STEPS ? l.length / LANCZOS_WIDTH : LANCZOS_STEPS;
  l.capacity = steps * LANCZOS_WIDTH;
  if (l.capacity < (size_t)rank + LANCZOS_WIDTH) return tell("the matrix is too small for Lanczos blocks");
  l.read = malloc(l.most * l.length * sizeof(float));
  l.block = malloc(l.most * l.length * sizeof(double));
  l.projection = malloc(l.most * LANCZOS_WIDTH * sizeof(double));
  l.basis = malloc(l.length * (l.capacity + LANCZOS_WIDTH) * sizeof(double));
  l.image = malloc(l.length * LANCZOS_WIDTH * sizeof(double));
  l.inner = calloc(l.capacity * l.capacity, sizeof(double));
  l.along = malloc(l.capacity * LANCZOS_WIDTH * sizeof(double));
  l.triangle = malloc((LANCZOS_WIDTH + 1) * LANCZOS_WIDTH * sizeof(double));
  l.small = malloc(l.capacity * l.capacity * sizeof(double));
  l.values = malloc(l.capacity * sizeof(double));
  l.vectors = malloc(l.capacity * ((size_t)rank + 1) * sizeof(double));
  int status = -1;
  if (l.read == NULL || l.block == NULL || l.projection == NULL || l.basis == NULL || l.image == NULL ||
      l.inner == NULL || l.along == NULL || l.triangle == NULL || l.small == NULL || l.values == NULL ||
      l.vectors == NULL) {
    tell("no memory for the Lanczos iteration");
  } else {
    l.tau = l.triangle + LANCZOS_WIDTH * LANCZOS_WIDTH;
    status = iterate(&l, rank, error);
  }
  free(l.read);
  free(l.block);
  free(l.projection);
  free(l.basis);
  free(l.image);
  free(l.inner);
  free(l.along);
  free(l.triangle);
  free(l.small);
  free(l.values);
  free(l.vectors);
  return status;
}
