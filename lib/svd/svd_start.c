/* SPDX-License-Identifier: MIT */
/* svd_start.c: a first basis from a sample of the items. */
#include <cblas.h>
#include <math.h>
#include <string.h>

#include "svd/svd_state.h"

enum { SAMPLE_ROUNDS = 8, COARSE = 4 };
/* Of the Gram matrix of C with columns of one length: beyond it, float's rounding is magnified too much. */
static const double raw_spread = 1e4;
/* The least part of a round's gain that the next one is taken to bring. */
static const double slowest_fall = 0.1;

static uint64_t sample_block(const svd_state *s, uint64_t b) {
  return s->plan.held ? b * s->plan.block_count / s->plan.sample_blocks : b;
}

/* Blocks of a sample are full but for the last one of a held matrix. */
static uint64_t sample_block_size(const svd_state *s, uint64_t b) {
  return s->plan.held ? btfi_svd_block_size(s, sample_block(s, b)) : s->plan.block_items;
}

static const float *sample_data(const svd_state *s, uint64_t b) {
  return s->blocks + sample_block(s, b) * s->plan.block_floats;
}

static void random_panel(svd_state *s, float *panel) {
  const size_t width = s->plan.width, used = (size_t)s->desc->length * width;
  for (size_t k = 0; k < used; k++) panel[k] = btfi_random_normal(&s->random);
  memset(panel + used, 0, (s->plan.length_padded * width - used) * sizeof(float));
}

bool btfi_svd_set_direction(svd_state *s, float *direction, uint32_t slot) {
  const int width = (int)s->plan.width, length = (int)s->plan.length_padded;
  float *along = (float *)s->rows;
  for (int j = 0; j < length; j++) s->basis[(size_t)j * s->plan.width + slot] = 0;
  for (int round = 0; round < 2; round++) {
    const double norm = sqrt(cblas_dsdot(length, direction, 1, direction, 1));
    if (!(norm > 0) || !isfinite(norm)) return false;
    cblas_sscal(length, (float)(1 / norm), direction, 1);
    cblas_sgemv(CblasRowMajor, CblasTrans, length, width, 1, s->basis, width, direction, 1, 0, along, 1);
    cblas_sgemv(CblasRowMajor, CblasNoTrans, length, width, -1, s->basis, width, along, 1, 1, direction, 1);
  }
  const double norm = sqrt(cblas_dsdot(length, direction, 1, direction, 1));
  /* Of what the second round left next to nothing of, the rest is rounding. */
  if (!(norm > 0.1)) return false;
  for (int j = 0; j < length; j++) s->basis[(size_t)j * s->plan.width + slot] = (float)(direction[j] / norm);
  return true;
}

/* One step of subspace iteration within every step-th block of the sample. */
static btf_status sample_round(svd_state *s, uint64_t step, bool raw, double *energy) {
  const svd_plan *plan = &s->plan;
  uint64_t rows = 0;
  uint32_t kept;
  *energy = 0;
  btfi_panel_pack(s->ctx, s->basis, plan->length_padded, plan->width, s->packed_basis);
  for (uint64_t b = 0; b < plan->sample_blocks; b += step) {
    const uint64_t items = sample_block_size(s, b);
    const btfi_slab slab = btfi_svd_slab(s, sample_data(s, b), items);
    BTFI_TRY(btfi_slab_project(s->ctx, &slab, s->packed_basis, plan->width,
                               s->projection + rows * plan->width, s->norms));
    for (uint64_t i = 0; i < items; i++) *energy += s->norms[i];
    rows += items;
  }
  /* What a raw basis holds of weak directions would drown in strong ones. Near singular vectors the columns
   * of C are nearly orthogonal as they are. */
  if (raw) BTFI_TRY(btfi_svd_orthonormalise(s, s->projection, (size_t)rows, &kept));
  memset(s->image, 0, plan->length_padded * plan->width * sizeof(float));
  rows = 0;
  for (uint64_t b = 0; b < plan->sample_blocks; b += step) {
    const uint64_t items = sample_block_size(s, b);
    const btfi_slab slab = btfi_svd_slab(s, sample_data(s, b), items);
    btfi_svd_pack_projection(s, rows, items, &slab);
    BTFI_TRY(btfi_slab_accumulate(s->ctx, &slab, s->packed_projection, plan->width, s->image));
    rows += items;
  }
  BTFI_TRY(btfi_svd_ritz(s, (size_t)rows));
  return btfi_svd_next_basis(s);
}

/* Orthonormal columns from `first` on, of random directions outside those before. */
static btf_status fill_at_random(svd_state *s, uint32_t first, uint32_t end) {
  const size_t width = s->plan.width, length = (size_t)s->desc->length;
  if (first >= end) return BTF_OK;
  /* That many elements make random columns nearly orthogonal, and all can be straightened at once. */
  if (length >= 8 * (size_t)end) {
    const float scale = (float)(1 / sqrt((double)length));
    for (size_t j = 0; j < length; j++)
      for (uint32_t c = first; c < end; c++) s->basis[j * width + c] = scale * btfi_random_normal(&s->random);
    return btfi_svd_straighten(s, s->basis, s->plan.length_padded, end);
  }
  for (uint32_t c = first; c < end; c++) {
    for (size_t j = 0; j < s->plan.length_padded; j++)
      s->direction[j] = j < length ? btfi_random_normal(&s->random) : 0;
    btfi_svd_set_direction(s, s->direction, c);
  }
  return BTF_OK;
}

btf_status btfi_svd_start(svd_state *s) {
  const svd_plan *plan = &s->plan;
  const uint64_t smaller = BTFI_MIN(s->desc->items, s->desc->length);
  uint32_t kept;
  s->kept_energy = 0;
  s->mean_rest = 0;
  random_panel(s, s->basis);
  if (plan->sample_blocks == 0) return btfi_svd_orthonormalise(s, s->basis, plan->length_padded, &kept);

  double energy = 0, captured = 0;
  uint64_t items = 0;
  for (uint64_t b = 0; b < plan->sample_blocks; b++) items += sample_block_size(s, b);
  /* Most of the way can be gone on a part of the sample. */
  uint64_t step = items / COARSE >= (uint64_t)COARSE * plan->width ? COARSE : 1;
  bool raw = true;
  for (;;) {
    const double items_used = (double)items / (double)step;
    double gain_before = 0;
    for (int round = 0; round < SAMPLE_ROUNDS; round++) {
      BTFI_TRY(sample_round(s, step, raw, &energy));
      captured = 0;
      double gain = 0;
      for (uint32_t i = 0; i < BTFI_MIN(s->found, plan->rank); i++) {
        captured += s->ritz[i];
        gain += fmax(0, s->ritz[i] - s->ritz_before[i]);
      }
      BTFI_TRY(btfi_svd_report(s, 0.1 + 0.05 * (round + 1) / SAMPLE_ROUNDS + (step > 1 ? 0 : 0.05)));
      /* The sample differs from the matrix by about rank / items of the rest or more: no use in being much
       * more exact in it. Gains fall from round to round, if not as fast for ever as from the first to the
       * second. */
      const double noise = fmax(0, energy - captured) * plan->rank / items_used;
      const double next = gain * fmax(slowest_fall, gain_before > 0 ? gain / gain_before : 1);
      if (!raw && next <= fmax(noise, 1e-7 * energy)) break;
      raw = s->spread > raw_spread;
      gain_before = gain;
    }
    if (step == 1) break;
    step = 1;
  }
  const double scale = (double)s->desc->items / (double)items;
  s->sample_rest = fmax(0, energy - captured) * scale;
  s->kept_energy = s->found >= plan->rank ? s->ritz[plan->rank - 1] * scale : 0;
  double within = 0;
  for (uint32_t i = 0; i < s->found; i++) within += s->ritz[i];
  s->mean_rest = fmax(0, energy - within) / (double)items;

  /* A sample poorer than the matrix may be leaves columns free: they take random directions. */
  return fill_at_random(s, s->found, (uint32_t)BTFI_MIN(plan->width, smaller));
}
