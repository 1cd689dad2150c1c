/* SPDX-License-Identifier: MIT */
/* rank_one.c: the product of two factors of one direction each that is nearest to a matrix. */
#include "factor_parts.h"

/* The row factor of least error for a given column factor. */
static void fit_rows(const btfi_cmf_weighted *m, const v4 *column, v4 *row) {
  v4 square = splat(0.0f);
  for (uint32_t j = 0; j < m->columns; j++) square += column[j] * column[j];
  for (uint32_t i = 0; i < m->rows; i++) {
    const size_t at = (size_t)i * m->columns;
    v4 sum = splat(0.0f), other = splat(0.0f), scale = square;
    uint32_t j = 0;
    for (; j + 1 < m->columns; j += 2) {
      sum += m->numerator[at + j] * column[j];
      other += m->numerator[at + j + 1] * column[j + 1];
    }
    if (j < m->columns) sum += m->numerator[at + j] * column[j];
    if (m->weight != NULL || m->shared != NULL) {
      scale = splat(0.0f);
      for (j = 0; j < m->columns; j++) scale += btfi_cmf_weight_at(m, at + j) * (column[j] * column[j]);
    }
    row[i] = quotient(sum + other, scale);
  }
}

/* The column factor of least error for a given row factor; `scale` has room for the columns. */
static void fit_columns(const btfi_cmf_weighted *m, const v4 *row, v4 *column, v4 *scale) {
  const bool uniform = m->weight == NULL && m->shared == NULL;
  v4 square = splat(0.0f);
  memset(column, 0, m->columns * sizeof *column);
  if (!uniform) memset(scale, 0, m->columns * sizeof *scale);
  for (uint32_t i = 0; i < m->rows; i++) {
    const size_t at = (size_t)i * m->columns;
    const v4 r = row[i], r2 = r * r;
    square += r2;
    for (uint32_t j = 0; j < m->columns; j++) column[j] += m->numerator[at + j] * r;
    for (uint32_t j = 0; j < m->columns && !uniform; j++) scale[j] += btfi_cmf_weight_at(m, at + j) * r2;
  }
  for (uint32_t j = 0; j < m->columns; j++) column[j] = quotient(column[j], uniform ? square : scale[j]);
}

/* First column factor: the sums of columns, or where they may cancel the row of most energy. */
static void start_columns(const btfi_cmf_weighted *m, bool cancels, v4 *column) {
  v4 most = splat(-1.0f);
  memset(column, 0, m->columns * sizeof *column);
  for (uint32_t i = 0; i < m->rows; i++) {
    const v4 *numerator = m->numerator + (size_t)i * m->columns;
    if (!cancels) {
      for (uint32_t j = 0; j < m->columns; j++) column[j] += numerator[j];
      continue;
    }
    v4 energy = splat(0.0f);
    for (uint32_t j = 0; j < m->columns; j++) energy += numerator[j] * numerator[j];
    for (int k = 0; k < 4; k++) {
      if (!(energy[k] > most[k])) continue;
      most[k] = energy[k];
      for (uint32_t j = 0; j < m->columns; j++) column[j][k] = numerator[j][k];
    }
  }
  /* Lengths of 1, so that nothing under- or overflows on the way. */
  v4 peak = splat(0.0f);
  for (uint32_t j = 0; j < m->columns; j++) peak = largest(peak, magnitude(column[j]));
  for (uint32_t j = 0; j < m->columns; j++) column[j] = quotient(column[j], peak);
}

void btfi_cmf_rank_one(const btfi_cmf_weighted *m, bool cancels, bool more, v4 *row, v4 *column, v4 *before,
                       v4 *scale) {
  const int most = more ? 2000 : 60;
  const float tolerance = more ? 1e-13f : 1e-9f;
  start_columns(m, cancels, column);
  for (int turn = 0; turn < most; turn++) {
    v4 moved = splat(0.0f), length = splat(0.0f);
    memcpy(before, column, m->columns * sizeof *before);
    fit_rows(m, column, row);
    fit_columns(m, row, column, scale);
    for (uint32_t j = 0; j < m->columns; j++) {
      const v4 d = column[j] - before[j];
      moved += d * d;
      length += column[j] * column[j];
    }
    bool done = turn > 0;
    for (int k = 0; k < 4; k++) done = done && !(moved[k] > tolerance * length[k]);
    if (done) break;
  }
}

void btfi_cmf_deflate(const btfi_cmf_weighted *m, const v4 *row, const v4 *column) {
  for (uint32_t i = 0; i < m->rows; i++)
    for (uint32_t j = 0; j < m->columns; j++) {
      const size_t at = (size_t)i * m->columns + j;
      const v4 product = row[i] * column[j];
      m->numerator[at] -=
          m->weight == NULL && m->shared == NULL ? product : btfi_cmf_weight_at(m, at) * product;
    }
}
