/* SPDX-License-Identifier: MIT */
/* starts.c: sets of lobes of the dictionary from which to start. */
#include "solve.h"

#include <math.h>
#include <string.h>

/* Products of the candidates and the data. */
static const double *candidate_products(btfi_lafortune_scratch *s) {
  const btfi_lafortune_shared *shared = s->shared;
  const uint32_t n = 1 + shared->candidates, ld = 1 + LAF_CANDIDATES;
  memset(s->candidate_cross, 0, sizeof s->candidate_cross);
  if (!shared->relative) {
    btfi_lafortune_add_dots(shared, shared->column, n, s->data, s->channels, false, s->candidate_cross,
                            s->channels);
    return shared->gram;
  }
  memset(s->candidate_gram, 0, sizeof s->candidate_gram);
  for (uint32_t first = 0; first < shared->padded; first += LAF_CHUNK) {
    const uint32_t rows = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
    for (uint32_t i = 0; i < n; i++)
      for (uint32_t k = 0; k < rows; k++)
        s->chunk[i * LAF_LD + k] =
            shared->column[(size_t)i * shared->padded + first + k] * s->root[first + k];
    shared->kernels->dots(s->chunk, LAF_LD, n, s->chunk, LAF_LD, n, rows, true, s->candidate_gram, ld);
    shared->kernels->dots(s->chunk, LAF_LD, n, s->data + first, shared->padded, s->channels, rows, false,
                          s->candidate_cross, s->channels);
  }
  return s->candidate_gram;
}

/* What a set of candidates explains of the sum over the channels, negated. */
static double rate_set(const double *gram, const double *h, const uint32_t *candidate, uint32_t count) {
  double g[LAF_MAX_ALBEDOS * LAF_MAX_ALBEDOS] = {0}, a[LAF_MAX_ALBEDOS] = {0}, b[LAF_MAX_ALBEDOS] = {0},
                             explained = 0.0;
  uint32_t at[LAF_MAX_ALBEDOS] = {0};
  const uint32_t n = 1 + count;
  for (uint32_t i = 0; i < count; i++) at[1 + i] = 1 + candidate[i];
  for (uint32_t i = 0; i < n; i++) {
    b[i] = h[at[i]];
    for (uint32_t j = 0; j < n; j++)
      g[i * n + j] =
          gram[at[i] < at[j] ? at[i] * (1 + LAF_CANDIDATES) + at[j] : at[j] * (1 + LAF_CANDIDATES) + at[i]];
  }
  btfi_lafortune_nonnegative(n, g, n, b, 1, a);
  for (uint32_t i = 0; i < n; i++) explained += a[i] * b[i];
  return -explained;
}

static bool holds(const btfi_lafortune_start *start, uint32_t count, uint32_t candidate) {
  for (uint32_t i = 0; i < count; i++)
    if (start->candidate[i] == candidate) return true;
  return false;
}

uint32_t btfi_lafortune_choose_starts(btfi_lafortune_scratch *s, uint32_t wanted, btfi_lafortune_start *out) {
  const uint32_t candidates = s->shared->candidates, first_lobes = s->lobes < 2 ? 1 : 2;
  const double *gram = candidate_products(s);
  double h[1 + LAF_CANDIDATES];
  uint32_t sets = 0, chosen = 0;
  for (uint32_t i = 0; i <= candidates; i++) {
    h[i] = 0.0;
    for (uint32_t c = 0; c < s->channels; c++) h[i] += s->candidate_cross[i * s->channels + c];
  }
  for (uint32_t i = 0; i < candidates; i++)
    for (uint32_t j = first_lobes == 2 ? i + 1 : candidates - 1; j < candidates; j++) {
      btfi_lafortune_start *set = &s->pair[sets++];
      set->candidate[0] = i;
      set->candidate[1] = j;
      set->cost = rate_set(gram, h, set->candidate, first_lobes);
    }
  while (chosen < wanted && chosen < sets) {
    uint32_t best = sets;
    for (uint32_t k = 0; k < sets; k++)
      if (best == sets || s->pair[k].cost < s->pair[best].cost) best = k;
    if (s->pair[best].cost == INFINITY) break;
    btfi_lafortune_start *start = &out[chosen++];
    *start = s->pair[best];
    s->pair[best].cost = INFINITY;
    for (uint32_t n = first_lobes; n < s->lobes; n++) {
      uint32_t next = 0;
      double least = INFINITY;
      for (uint32_t i = 0; i < candidates; i++) {
        if (holds(start, n, i)) continue;
        start->candidate[n] = i;
        const double cost = rate_set(gram, h, start->candidate, n + 1);
        if (cost < least) {
          least = cost;
          next = i;
        }
      }
      start->candidate[n] = next;
    }
  }
  return chosen;
}
