/* SPDX-License-Identifier: MIT */
/* point.c: lobes, the best albedos for them and their cost (variable projection). */
#include "solve.h"

#include <math.h>
#include <string.h>

/* Share of the data's energy below which what is left of them is worth making anew. */
#define WORTH_REFINING 1e-4

/* ---- room ---- */

static uint32_t column_count(uint32_t kind, uint32_t lobes) {
  return 1 + lobes * (1 + btfi_lafortune_variables(kind));
}

static uint64_t chunk_columns(uint32_t kind, uint32_t lobes) {
  const uint32_t own = column_count(kind, lobes), start = 1 + LAF_CANDIDATES;
  return own > start ? own : start;
}

uint64_t btfi_lafortune_scratch_bytes(const btfi_lafortune_shared *shared, uint32_t lobes,
                                      uint32_t channels) {
  const uint64_t floats = ((uint64_t)channels + 3 + lobes) * shared->padded;
  const uint64_t bytes = ((sizeof(btfi_lafortune_scratch) + 63) & ~(uint64_t)63) +
                         4 * (floats + (chunk_columns(shared->kind, lobes) + channels) * LAF_LD);
  return (bytes + 63) & ~(uint64_t)63;
}

btfi_lafortune_scratch *btfi_lafortune_scratch_init(void *memory, const btfi_lafortune_shared *shared,
                                                    uint32_t lobes, uint32_t channels) {
  btfi_lafortune_scratch *s = memory;
  const size_t ld = shared->padded;
  memset(s, 0, sizeof *s);
  s->shared = shared;
  s->lobes = lobes;
  s->variables = btfi_lafortune_variables(shared->kind);
  s->columns = column_count(shared->kind, lobes);
  s->chunk = (float *)(void *)((unsigned char *)memory + ((sizeof *s + 63) & ~(size_t)63));
  s->left = s->chunk + chunk_columns(shared->kind, lobes) * LAF_LD;
  s->data = s->left + (size_t)channels * LAF_LD;
  s->root = s->data + channels * ld;
  s->own_factor[0] = s->root + ld;
  s->own_factor[1] = s->own_factor[0] + ld;
  s->base = s->own_factor[1] + ld;
  return s;
}

void btfi_lafortune_scratch_trace(btfi_lafortune_scratch *scratch, btfi_lafortune_trace_fn trace,
                                  void *user) {
  scratch->trace = trace;
  scratch->trace_user = user;
}

/* ---- data ---- */

/* Weights of LAF_LOG: an error counts by its ratio to the value, the first order of a difference of
 * logarithms. A twentieth of the mean keeps dark samples from ruling. */
static void relative_roots(btfi_lafortune_scratch *s) {
  const btfi_lafortune_shared *shared = s->shared;
  double mean = 0.0;
  for (uint32_t i = 0; i < shared->samples; i++) {
    double sum = 0.0;
    for (uint32_t c = 0; c < s->channels; c++) sum += fabs((double)s->values[(size_t)i * s->stride + c]);
    s->root[i] = (float)(sum / s->channels);
    mean += sum / s->channels / shared->samples;
  }
  const double offset = mean > 0.0 ? 0.05 * mean : 1.0;
  for (uint32_t i = 0; i < shared->samples; i++)
    s->root[i] = (float)(shared->weight[i] * offset / ((double)s->root[i] + offset));
  for (uint32_t i = shared->samples; i < shared->padded; i++) s->root[i] = 0.0f;
  for (uint32_t i = 0; i < shared->padded; i++) {
    s->own_factor[0][i] = shared->lobe[i] * s->root[i];
    s->own_factor[1][i] = shared->diffuse[i] * s->root[i];
  }
  s->lobe_factor = s->own_factor[0];
  s->diffuse_factor = s->own_factor[1];
}

void btfi_lafortune_take_data(btfi_lafortune_scratch *s, const float *values, uint32_t stride,
                              uint32_t channels) {
  const btfi_lafortune_shared *shared = s->shared;
  s->values = values;
  s->stride = stride;
  s->channels = channels;
  if (shared->relative) {
    relative_roots(s);
  } else {
    memcpy(s->root, shared->weight, shared->padded * sizeof *s->root);
    s->lobe_factor = shared->lobe;
    s->diffuse_factor = shared->diffuse;
  }
  float largest = 0.0f;
  for (uint32_t i = 0; i < shared->samples; i++)
    for (uint32_t c = 0; c < channels; c++) largest = fmaxf(largest, fabsf(values[(size_t)i * stride + c]));
  s->unit = largest > 1e-37f ? (double)largest : 1e-37;
  s->energy = 0.0;
  const float factor = (float)(1.0 / s->unit);
  for (uint32_t c = 0; c < channels; c++) {
    float *to = s->data + (size_t)c * shared->padded;
    double sum = 0.0;
    for (uint32_t i = 0; i < shared->samples; i++) {
      to[i] = values[(size_t)i * stride + c] * factor * s->root[i];
      sum += (double)to[i] * (double)to[i];
    }
    for (uint32_t i = shared->samples; i < shared->padded; i++) to[i] = 0.0f;
    s->energy += sum;
  }
}

/* ---- a point: sums, albedos, cost ---- */

void btfi_lafortune_make_chunk(btfi_lafortune_scratch *s, const btfi_lafortune_point *p, uint32_t first,
                               uint32_t n) {
  memcpy(s->chunk, s->diffuse_factor + first, n * sizeof *s->chunk);
  for (uint32_t j = 0; j < s->lobes; j++)
    s->shared->kernels->columns(&p->lobe[j], s->shared->term, s->lobe_factor,
                                s->base + (size_t)j * s->shared->padded, first, n,
                                s->chunk + (size_t)btfi_lafortune_lobe_column(s, j) * LAF_LD);
}

static void solve_albedos(const btfi_lafortune_scratch *s, btfi_lafortune_point *p) {
  double gram[LAF_MAX_ALBEDOS * LAF_MAX_ALBEDOS], explained = 0.0;
  const uint32_t n = 1 + s->lobes;
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < n; j++)
      gram[i * n + j] = btfi_lafortune_gram_of(s, p, btfi_lafortune_albedo_column(s, i),
                                               btfi_lafortune_albedo_column(s, j));
  for (uint32_t c = 0; c < s->channels; c++) {
    double h[LAF_MAX_ALBEDOS], a[LAF_MAX_ALBEDOS];
    for (uint32_t i = 0; i < n; i++) h[i] = p->cross[btfi_lafortune_albedo_column(s, i) * s->channels + c];
    btfi_lafortune_nonnegative(n, gram, n, h, 1, a);
    for (uint32_t i = 0; i < n; i++) {
      p->albedo[i][c] = a[i];
      explained += a[i] * h[i];
    }
  }
  p->cost = s->energy > explained ? s->energy - explained : 0.0;
}

uint32_t btfi_lafortune_factor_active(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p,
                                      uint32_t channel, uint32_t which[LAF_MAX_ALBEDOS],
                                      uint32_t lobe[LAF_MAX_ALBEDOS],
                                      double l[LAF_MAX_ALBEDOS][LAF_MAX_ALBEDOS]) {
  uint32_t n = 0;
  for (uint32_t i = 0; i <= s->lobes; i++) {
    if (!(p->albedo[i][channel] > 0.0)) continue;
    const uint32_t column = btfi_lafortune_albedo_column(s, i);
    double pivot = p->gram[column * s->columns + column];
    const double norm = pivot;
    for (uint32_t j = 0; j < n; j++) {
      double sum = btfi_lafortune_gram_of(s, p, which[j], column);
      for (uint32_t k = 0; k < j; k++) sum -= l[n][k] * l[j][k];
      l[n][j] = sum / l[j][j];
      pivot -= l[n][j] * l[n][j];
    }
    if (!(pivot > 1e-12 * norm)) continue;
    l[n][n] = sqrt(pivot);
    lobe[n] = i;
    which[n++] = column;
  }
  return n;
}

/* Columns of what is left of the data behind those of the chunk. Returns its squared norm. */
static double make_left(btfi_lafortune_scratch *s, const btfi_lafortune_point *p, uint32_t first,
                        uint32_t n) {
  double norm = 0.0;
  for (uint32_t c = 0; c < s->channels; c++) {
    const float *data = s->data + (size_t)c * s->shared->padded + first;
    float *left = s->left + (size_t)c * LAF_LD;
    for (uint32_t i = 0; i < n; i++) {
      double value = (double)data[i];
      for (uint32_t j = 0; j <= s->lobes; j++)
        value -= p->albedo[j][c] * (double)s->chunk[(size_t)btfi_lafortune_albedo_column(s, j) * LAF_LD + i];
      left[i] = (float)value;
      norm += value * value;
    }
  }
  return norm;
}

/* Where the model nearly is the data, their products cancel. Products with what is left of the data do not;
 * they also correct the albedos, where those may grow and shrink. */
static void refine(btfi_lafortune_scratch *s, btfi_lafortune_point *p) {
  const btfi_lafortune_shared *shared = s->shared;
  p->cost = 0.0;
  memset(p->cross, 0, (size_t)s->columns * s->channels * sizeof *p->cross);
  for (uint32_t first = 0; first < shared->padded; first += LAF_CHUNK) {
    const uint32_t n = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
    btfi_lafortune_make_chunk(s, p, first, n);
    p->cost += make_left(s, p, first, n);
    shared->kernels->dots(s->chunk, LAF_LD, s->columns, s->left, LAF_LD, s->channels, n, false, p->cross,
                          s->channels);
  }
  p->refined = true;
  for (uint32_t c = 0; c < s->channels; c++) {
    uint32_t which[LAF_MAX_ALBEDOS], lobe[LAF_MAX_ALBEDOS];
    double l[LAF_MAX_ALBEDOS][LAF_MAX_ALBEDOS], step[LAF_MAX_ALBEDOS];
    const uint32_t active = btfi_lafortune_factor_active(s, p, c, which, lobe, l);
    bool stays = true;
    for (uint32_t i = 0; i < active; i++) {
      step[i] = p->cross[which[i] * s->channels + c];
      for (uint32_t k = 0; k < i; k++) step[i] -= l[i][k] * step[k];
      step[i] /= l[i][i];
    }
    for (uint32_t i = active; i-- > 0;) {
      for (uint32_t k = i + 1; k < active; k++) step[i] -= l[k][i] * step[k];
      step[i] /= l[i][i];
      stays = stays && p->albedo[lobe[i]][c] + step[i] >= 0.0;
    }
    for (uint32_t i = 0; i < active && stays; i++) {
      p->albedo[lobe[i]][c] += step[i];
      p->cost = fmax(0.0, p->cost - step[i] * p->cross[which[i] * s->channels + c]);
    }
    for (uint32_t v = 0; v < s->columns && stays; v++)
      for (uint32_t i = 0; i < active; i++)
        if (v != which[i])
          p->cross[v * s->channels + c] -= step[i] * btfi_lafortune_gram_of(s, p, which[i], v);
  }
}

bool btfi_lafortune_evaluate(btfi_lafortune_scratch *s, btfi_lafortune_point *p, bool forced) {
  const btfi_lafortune_shared *shared = s->shared;
  for (uint32_t j = 0; j < s->lobes; j++)
    if (!btfi_lafortune_make_base(shared, &p->lobe[j], s->base + (size_t)j * shared->padded) && !forced)
      return false;
  memset(p->gram, 0, (size_t)s->columns * s->columns * sizeof *p->gram);
  memset(p->cross, 0, (size_t)s->columns * s->channels * sizeof *p->cross);
  for (uint32_t first = 0; first < shared->padded; first += LAF_CHUNK) {
    const uint32_t n = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
    btfi_lafortune_make_chunk(s, p, first, n);
    shared->kernels->dots(s->chunk, LAF_LD, s->columns, s->chunk, LAF_LD, s->columns, n, true, p->gram,
                          s->columns);
    shared->kernels->dots(s->chunk, LAF_LD, s->columns, s->data + first, shared->padded, s->channels, n,
                          false, p->cross, s->channels);
  }
  p->refined = false;
  solve_albedos(s, p);
  if (p->cost < WORTH_REFINING * s->energy) refine(s, p);
  return true;
}
