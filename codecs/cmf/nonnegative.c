/* SPDX-License-Identifier: MIT */
/* nonnegative.c: hierarchical alternating least squares (Cichocki and Phan 2009): each column of a factor has
 * a closed form while all others are fixed, and its non-negative optimum is the positive part of that. */
#include "nonnegative.h"

#include <math.h>
#include <string.h>

enum { START_STEPS = 12 }; /* power iterations for a component's start */

uint64_t btfi_cmf_nonnegative_scratch(uint32_t rows, uint32_t columns) {
  return (uint64_t)rows * columns + rows + 4 * (uint64_t)columns;
}

typedef struct hals {
  uint32_t rows, columns, rank;
  const float *weight;
  float *left; /* a - p q^T, rows x columns */
  float *p, *q;
  float *p_column, *q_column; /* of the component at work, without gaps */
  double *sums;               /* columns values, in the scratch of twice as many floats */
} hals;

static float weight_of(const hals *h, size_t i) {
  return h->weight != NULL ? h->weight[i] : 1.0f;
}

/* What is left with the component put back, times `sign`. */
static void add_component(hals *h, float sign) {
  for (uint32_t i = 0; i < h->rows; i++) {
    float *left = h->left + (size_t)i * h->columns;
    const float p = sign * h->p_column[i];
    if (p == 0.0f) continue;
    for (uint32_t j = 0; j < h->columns; j++) left[j] += p * h->q_column[j];
  }
}

/* p = max(0, (left q) / (q q)), row by row with its weights. */
static void solve_p(hals *h) {
  for (uint32_t i = 0; i < h->rows; i++) {
    const float *left = h->left + (size_t)i * h->columns;
    double product = 0.0, square = 0.0;
    for (uint32_t j = 0; j < h->columns; j++) {
      const double wq = (double)weight_of(h, (size_t)i * h->columns + j) * (double)h->q_column[j];
      product += wq * (double)left[j];
      square += wq * (double)h->q_column[j];
    }
    h->p_column[i] = product > 0.0 && square > 0.0 ? (float)(product / square) : 0.0f;
  }
}

static void solve_q(hals *h) {
  double *product = h->sums, uniform = 0.0;
  memset(product, 0, h->columns * sizeof *product);
  for (uint32_t i = 0; i < h->rows; i++) {
    const size_t first = (size_t)i * h->columns;
    const double p = (double)h->p_column[i];
    uniform += p * p;
    if (p == 0.0) continue;
    for (uint32_t j = 0; j < h->columns; j++)
      product[j] += p * (double)weight_of(h, first + j) * (double)h->left[first + j];
  }
  for (uint32_t j = 0; j < h->columns; j++) {
    double square = uniform;
    if (h->weight != NULL) {
      square = 0.0;
      for (uint32_t i = 0; i < h->rows; i++)
        square +=
            (double)h->p_column[i] * (double)h->p_column[i] * (double)h->weight[(size_t)i * h->columns + j];
    }
    h->q_column[j] = product[j] > 0.0 && square > 0.0 ? (float)(product[j] / square) : 0.0f;
  }
}

static void take_column(hals *h, uint32_t k) {
  for (uint32_t i = 0; i < h->rows; i++) h->p_column[i] = h->p[(size_t)i * h->rank + k];
  for (uint32_t j = 0; j < h->columns; j++) h->q_column[j] = h->q[(size_t)j * h->rank + k];
}

static void put_column(hals *h, uint32_t k) {
  for (uint32_t i = 0; i < h->rows; i++) h->p[(size_t)i * h->rank + k] = h->p_column[i];
  for (uint32_t j = 0; j < h->columns; j++) h->q[(size_t)j * h->rank + k] = h->q_column[j];
}

static double cost_of(const hals *h) {
  const size_t n = (size_t)h->rows * h->columns;
  double sum = 0.0;
  for (size_t i = 0; i < n; i++) sum += (double)weight_of(h, i) * (double)h->left[i] * (double)h->left[i];
  return sum;
}

/* The heaviest row of what is left, its positive part, starts the power iteration. */
static void start_component(hals *h) {
  uint32_t best = 0;
  double most = -1.0;
  for (uint32_t i = 0; i < h->rows; i++) {
    double sum = 0.0;
    for (uint32_t j = 0; j < h->columns; j++) {
      const double value = (double)h->left[(size_t)i * h->columns + j];
      if (value > 0.0) sum += (double)weight_of(h, (size_t)i * h->columns + j) * value * value;
    }
    if (sum > most) {
      most = sum;
      best = i;
    }
  }
  for (uint32_t j = 0; j < h->columns; j++) {
    const size_t at = (size_t)best * h->columns + j;
    h->q_column[j] = h->left[at] > 0.0f && weight_of(h, at) > 0.0f ? h->left[at] : 0.0f;
  }
  for (uint32_t step = 0; step < START_STEPS; step++) {
    solve_p(h);
    solve_q(h);
  }
}

/* A column of zeros has no better partner than zeros: such a component would stay so. */
static int has_vanished(const hals *h) {
  for (uint32_t j = 0; j < h->columns; j++)
    if (h->q_column[j] > 0.0f) return 0;
  return 1;
}

void btfi_cmf_nonnegative(uint32_t rows, uint32_t columns, const float *a, size_t a_ld, const float *weight,
                          uint32_t rank, uint32_t sweeps, double tolerance, float *scratch, float *p,
                          float *q, double *cost, uint32_t *done) {
  hals h = {.rows = rows, .columns = columns, .rank = rank, .weight = weight, .p = p, .q = q};
  double before, now;
  uint32_t sweep = 0;
  h.sums = (double *)(void *)scratch; /* first, for its alignment */
  h.left = scratch + 2 * (size_t)columns;
  h.p_column = h.left + (size_t)rows * columns;
  h.q_column = h.p_column + rows;
  for (uint32_t i = 0; i < rows; i++) memcpy(h.left + (size_t)i * columns, a + i * a_ld, columns * sizeof *a);
  for (uint32_t k = 0; k < rank; k++) {
    start_component(&h);
    put_column(&h, k);
    add_component(&h, -1.0f);
  }
  now = cost_of(&h);
  if (cost != NULL) cost[0] = now;
  for (; sweep < sweeps && now > 0.0; sweep++) {
    before = now;
    for (uint32_t k = 0; k < rank; k++) {
      take_column(&h, k);
      add_component(&h, 1.0f);
      if (has_vanished(&h)) {
        start_component(&h);
      } else {
        solve_p(&h);
        solve_q(&h);
      }
      put_column(&h, k);
      add_component(&h, -1.0f);
    }
    now = cost_of(&h);
    if (cost != NULL) cost[sweep + 1] = now;
    if (before - now <= tolerance * before) {
      sweep++;
      break;
    }
  }
  *done = sweep;
}
