/* SPDX-License-Identifier: MIT */
/* albedos.c: non-negative least squares of a handful of unknowns from their normal equations. */
#include "lafortune.h"

#include <math.h>
#include <string.h>

/* A column of whose squared norm the others leave less than this depends on them: sums of products of floats
 * tell no more. */
#define DEPENDENT 1e-7

/* Solves the normal equations of the chosen unknowns by Cholesky's method. Columns that depend on those
 * before them leave the choice. */
static void solve_chosen(uint32_t n, const double *gram, size_t ld, const double *h, size_t h_stride,
                         bool *chosen, double *x) {
  double l[LAF_MAX_ALBEDOS][LAF_MAX_ALBEDOS];
  for (uint32_t i = 0; i < n; i++) {
    x[i] = 0.0;
    if (!chosen[i]) continue;
    double pivot = gram[i * ld + i];
    for (uint32_t j = 0; j < i; j++) {
      if (!chosen[j]) continue;
      double sum = gram[j * ld + i];
      for (uint32_t k = 0; k < j; k++)
        if (chosen[k]) sum -= l[i][k] * l[j][k];
      l[i][j] = sum / l[j][j];
      pivot -= l[i][j] * l[i][j];
    }
    if (!(pivot > DEPENDENT * gram[i * ld + i])) {
      chosen[i] = false;
      continue;
    }
    l[i][i] = sqrt(pivot);
    double sum = h[i * h_stride];
    for (uint32_t k = 0; k < i; k++)
      if (chosen[k]) sum -= l[i][k] * x[k];
    x[i] = sum / l[i][i];
  }
  for (uint32_t i = n; i-- > 0;) {
    if (!chosen[i]) continue;
    for (uint32_t k = i + 1; k < n; k++)
      if (chosen[k]) x[i] -= l[k][i] * x[k];
    x[i] /= l[i][i];
  }
}

static bool all_positive(uint32_t n, const bool *chosen, const double *x) {
  for (uint32_t i = 0; i < n; i++)
    if (chosen[i] && !(x[i] > 0.0)) return false;
  return true;
}

/* The unknown whose growth from 0 lowers the error most, or n. */
static uint32_t most_wanted(uint32_t n, const double *gram, size_t ld, const double *h, size_t h_stride,
                            const bool *chosen, const bool *refused, const double *a) {
  uint32_t best = n;
  double most = 0.0;
  for (uint32_t i = 0; i < n; i++) {
    const double norm = gram[i * ld + i];
    if (chosen[i] || refused[i] || !(norm > 0.0)) continue;
    double slope = h[i * h_stride];
    for (uint32_t k = 0; k < n; k++) slope -= a[k] * (k < i ? gram[k * ld + i] : gram[i * ld + k]);
    const double gain = slope > 0.0 ? slope * slope / norm : 0.0;
    if (gain > most) {
      most = gain;
      best = i;
    }
  }
  return best;
}

void btfi_lafortune_nonnegative(uint32_t n, const double *gram, size_t gram_ld, const double *h,
                                size_t h_stride, double *a) {
  bool chosen[LAF_MAX_ALBEDOS], refused[LAF_MAX_ALBEDOS] = {false};
  double x[LAF_MAX_ALBEDOS];
  /* Mostly nothing is bound. */
  for (uint32_t i = 0; i < n; i++) chosen[i] = gram[i * gram_ld + i] > 0.0;
  solve_chosen(n, gram, gram_ld, h, h_stride, chosen, x);
  if (all_positive(n, chosen, x)) {
    memcpy(a, x, n * sizeof *a);
    return;
  }
  /* Lawson and Hanson 1974, algorithm NNLS. Each turn lowers the error, and sets of unknowns are few. */
  for (uint32_t i = 0; i < n; i++) {
    chosen[i] = false;
    a[i] = 0.0;
  }
  for (int turn = 0; turn < 3 << LAF_MAX_ALBEDOS; turn++) {
    const uint32_t wanted = most_wanted(n, gram, gram_ld, h, h_stride, chosen, refused, a);
    if (wanted == n) return;
    chosen[wanted] = true;
    solve_chosen(n, gram, gram_ld, h, h_stride, chosen, x);
    if (!chosen[wanted] || !(x[wanted] > 0.0)) { /* dependent, or a gain of rounding alone */
      chosen[wanted] = false;
      refused[wanted] = true;
      continue;
    }
    while (!all_positive(n, chosen, x)) {
      double step = 1.0;
      uint32_t blocking = n;
      for (uint32_t i = 0; i < n; i++) {
        if (!chosen[i] || x[i] > 0.0) continue;
        const double reach = a[i] / (a[i] - x[i]);
        if (blocking == n || reach < step) {
          step = reach;
          blocking = i;
        }
      }
      for (uint32_t i = 0; i < n; i++)
        if (chosen[i]) a[i] += step * (x[i] - a[i]);
      a[blocking] = 0.0;
      chosen[blocking] = false;
      solve_chosen(n, gram, gram_ld, h, h_stride, chosen, x);
    }
    for (uint32_t i = 0; i < n; i++) a[i] = chosen[i] ? x[i] : 0.0;
    memset(refused, 0, sizeof refused);
  }
}
