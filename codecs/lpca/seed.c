/* SPDX-License-Identifier: MIT */
/* seed.c: where clustering starts. */
#include "lpca.h"

#include <math.h>
#include <string.h>

enum { MOST_DRAWS = 8 };

/* Squared distances of a block of points to some points, one row of products each. */
static btf_status multiply(btfi_lpca_model *m, uint64_t first, uint32_t many, const float *means,
                           uint32_t draws) {
  return m->host->gemm(m->ctx, BTF_TRANSPOSE_B, many, draws, m->size, 1.0f, m->points + first * m->size,
                       m->size, means, m->size, 0.0f, m->products, draws);
}

/* A point drawn with the probability of its error; any if all errors are 0. */
static uint64_t draw(const btfi_lpca_model *m, double total, uint64_t *random) {
  double left = btf_random_unit(random) * total;
  if (!(total > 0.0)) return (uint64_t)(btf_random_unit(random) * (double)m->count);
  for (uint64_t i = 0; i < m->count; i++) {
    left -= (double)m->error[i];
    if (left < 0.0) return i;
  }
  return m->count - 1;
}

/* Adds up, for each draw, the errors with it as one more mean. */
static btf_status try_draws(btfi_lpca_model *m, const uint64_t *drawn, const float *means, uint32_t draws,
                            double *totals) {
  for (uint32_t d = 0; d < draws; d++) totals[d] = 0.0;
  for (uint64_t first = 0; first < m->count; first += m->block) {
    const uint32_t many = m->count - first < m->block ? (uint32_t)(m->count - first) : m->block;
    BTF_TRY(multiply(m, first, many, means, draws));
    for (uint32_t i = 0; i < many; i++)
      for (uint32_t d = 0; d < draws; d++) {
        const float distance =
            m->square[first + i] + m->square[drawn[d]] - 2.0f * m->products[(size_t)i * draws + d];
        totals[d] += (double)fmaxf(0.0f, fminf(distance, m->error[first + i]));
      }
  }
  return BTF_OK;
}

/* Cluster k gets the point as its mean, and the points that are nearer to it. */
static btf_status take(btfi_lpca_model *m, uint32_t k, uint64_t drawn, const float *mean, double *total) {
  *total = 0.0;
  for (uint64_t first = 0; first < m->count; first += m->block) {
    const uint32_t many = m->count - first < m->block ? (uint32_t)(m->count - first) : m->block;
    BTF_TRY(multiply(m, first, many, mean, 1));
    for (uint32_t i = 0; i < many; i++) {
      const float distance = fmaxf(0.0f, m->square[first + i] + m->square[drawn] - 2.0f * m->products[i]);
      if (k == 0 || distance < m->error[first + i]) {
        m->error[first + i] = first + i == drawn ? 0.0f : distance;
        m->label[first + i] = k;
      }
      *total += (double)m->error[first + i];
    }
  }
  return BTF_OK;
}

btf_status btfi_lpca_seed(btfi_lpca_model *m, uint64_t *random, double from, double to) {
  const uint64_t rows = (uint64_t)m->clusters * (m->most_components + 1);
  const uint32_t room = rows < MOST_DRAWS ? (uint32_t)rows : (uint32_t)MOST_DRAWS;
  uint32_t draws = 2;
  double total = 0.0;
  for (uint32_t k = m->clusters; k > 1 && draws < MOST_DRAWS; k /= 4) draws++;
  for (uint64_t i = 0; i < m->count; i++) {
    double square = 0.0;
    for (uint32_t d = 0; d < m->size; d++)
      square += (double)m->points[i * m->size + d] * m->points[i * m->size + d];
    m->square[i] = (float)square;
    m->error[i] = 1.0f;
  }
  total = (double)m->count;
  for (uint32_t k = 0; k < m->clusters; k++) {
    uint64_t drawn[MOST_DRAWS];
    double totals[MOST_DRAWS];
    uint32_t best = 0;
    /* The bases are not in use yet: their room takes the draws. */
    const uint32_t many = k == 0 || draws > room ? 1 : draws;
    for (uint32_t d = 0; d < many; d++) {
      drawn[d] = draw(m, total, random);
      memcpy(m->basis + (size_t)d * m->size, m->points + drawn[d] * m->size, m->size * sizeof *m->basis);
    }
    if (many > 1) BTF_TRY(try_draws(m, drawn, m->basis, many, totals));
    for (uint32_t d = 1; d < many; d++)
      if (totals[d] < totals[best]) best = d;
    BTF_TRY(take(m, k, drawn[best], m->basis + (size_t)best * m->size, &total));
    BTF_TRY(m->host->progress(m->job, from + (to - from) * k / m->clusters, "clustering"));
  }
  return BTF_OK;
}
