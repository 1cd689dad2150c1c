/* SPDX-License-Identifier: MIT */
/* svd_pass.c: a reading of the whole matrix, and items that no sample foresaw. */
#include <cblas.h>
#include <math.h>
#include <string.h>

#include "svd/svd_state.h"

/* An item is a stray when its distance from the basis is this many times the average, and this part of the
 * weakest wanted squared singular value: fifty alike would then make a singular vector. */
static const double stray_factor = 8, stray_weight = 0.02;
enum { MAX_STRAYS = 64, STRAY_PASSES = 2 };

typedef struct stray_slots {
  uint32_t first, count;  /* columns that strays may take */
  uint32_t filled, taken; /* slots in use, directions taken up so far */
  double energy[32];      /* captured along each */
} stray_slots;

btf_status btfi_svd_report(const svd_state *s, double fraction) {
  return btfi_progress(s->job, s->from + (s->to - s->from) * fraction, "svd");
}

void btfi_svd_pack_projection(svd_state *s, uint64_t row, uint64_t items, const btfi_slab *slab) {
  const size_t width = s->plan.width;
  float *padding = s->projection + (row + items) * width;
  /* The padding belongs to the next block, which is written later. */
  memset(padding, 0, (slab->items - items) * width * sizeof(float));
  btfi_panel_pack(s->ctx, s->projection + row * width, slab->items, s->plan.width, s->packed_projection);
}

btf_status btfi_svd_next_basis(svd_state *s) {
  float *next = s->image;
  btfi_svd_apply(s, next, s->plan.length_padded, s->right, s->found);
  s->image = s->basis;
  s->basis = next;
  return btfi_svd_straighten(s, s->basis, s->plan.length_padded, s->found);
}

/* Gives the residual of an item a column. Rows of C before this block, and what they put into Y, become zero:
 * C may have any rows as long as Y = M^T C. */
static bool take_up(svd_state *s, stray_slots *slots, const btfi_slab *slab, uint64_t row, uint64_t item,
                    double rest) {
  const size_t width = s->plan.width;
  uint32_t slot = slots->filled;
  if (slots->taken >= MAX_STRAYS) return false;
  if (slot == slots->count) {
    slot = 0;
    for (uint32_t k = 1; k < slots->count; k++) {
      if (slots->energy[k] < slots->energy[slot]) slot = k;
    }
    if (rest < 2 * slots->energy[slot]) return false;
  }
  const uint32_t column = slots->first + slot;
  float *direction = s->direction;
  for (size_t j = 0; j < slab->length; j++)
    direction[j] = slab->data[item * slab->item_step + j * slab->element_step];
  if (!btfi_svd_set_direction(s, direction, column)) return false;

  for (uint64_t i = 0; i < row; i++) s->projection[i * width + column] = 0;
  for (size_t j = 0; j < slab->length; j++) s->image[j * width + column] = 0;
  const float *basis = s->basis + column;
  const int items = (int)slab->items, length = (int)slab->length;
  float *along = s->projection + row * width + column;
  if (slab->element_step == 1)
    cblas_sgemv(CblasRowMajor, CblasNoTrans, items, length, 1, slab->data, (int)slab->item_step, basis,
                (int)width, 0, along, (int)width);
  else
    cblas_sgemv(CblasRowMajor, CblasTrans, length, items, 1, slab->data, (int)slab->element_step, basis,
                (int)width, 0, along, (int)width);
  slots->energy[slot] = 0;
  if (slot == slots->filled) slots->filled++;
  slots->taken++;
  return true;
}

static double item_rest(const svd_state *s, uint64_t row, uint64_t item) {
  const float *c = s->projection + (row + item) * s->plan.width;
  double rest = s->norms[item];
  for (uint32_t k = 0; k < s->plan.width; k++) rest -= (double)c[k] * c[k];
  return rest;
}

static double take_up_strays(svd_state *s, stray_slots *slots, const btfi_slab *slab, uint64_t row,
                             uint64_t items) {
  const double floor_rest = fmax(stray_factor * s->mean_rest, stray_weight * s->kept_energy);
  double missed;
  for (bool changed = false;; changed = true) {
    uint64_t worst = 0;
    double worst_rest = 0;
    missed = 0;
    for (uint64_t i = 0; i < items; i++) {
      const double rest = item_rest(s, row, i);
      /* What is left of an item after float sums is rounding below this. */
      if (rest < floor_rest || rest < 1e-5 * s->norms[i]) continue;
      missed += rest;
      if (rest > worst_rest) {
        worst_rest = rest;
        worst = i;
      }
    }
    if (worst_rest <= 0 || !take_up(s, slots, slab, row, worst, worst_rest)) {
      if (changed) btfi_panel_pack(s->ctx, s->basis, s->plan.length_padded, s->plan.width, s->packed_basis);
      break;
    }
  }
  for (uint32_t k = 0; k < slots->filled; k++) {
    for (uint64_t i = 0; i < items; i++) {
      const double c = s->projection[(row + i) * s->plan.width + slots->first + k];
      slots->energy[k] += c * c;
    }
  }
  return missed;
}

btf_status btfi_svd_pass(svd_state *s, double first, double last, double *missed) {
  const svd_plan *plan = &s->plan;
  const size_t width = plan->width;
  stray_slots slots = {0};
  slots.count = plan->width > plan->rank ? BTFI_MIN((plan->width - plan->rank) / 2, 32u) : 0;
  slots.first = plan->width - slots.count;
  const bool watch = slots.count > 0 && s->passes < STRAY_PASSES && plan->width < s->desc->length;
  double energy = 0;
  *missed = 0;

  btfi_panel_pack(s->ctx, s->basis, plan->length_padded, plan->width, s->packed_basis);
  memset(s->image, 0, plan->length_padded * width * sizeof(float));
  for (uint64_t b = 0; b < plan->block_count; b++) {
    const uint64_t items = btfi_svd_block_size(s, b), row = b * plan->block_items;
    btfi_slab slab;
    BTFI_TRY(btfi_svd_report(s, first + (last - first) * (double)b / (double)plan->block_count));
    BTFI_TRY(btfi_svd_fetch(s, b, &slab));
    BTFI_TRY(btfi_slab_project(s->ctx, &slab, s->packed_basis, plan->width, s->projection + row * width,
                               s->norms));
    for (uint64_t i = 0; i < items; i++) energy += s->norms[i];
    if (watch) *missed += take_up_strays(s, &slots, &slab, row, items);
    btfi_svd_pack_projection(s, row, items, &slab);
    BTFI_TRY(btfi_slab_accumulate(s->ctx, &slab, s->packed_projection, plan->width, s->image));
  }
  if (!isfinite(energy))
    return btfi_fail(s->ctx, BTF_E_NUMERIC,
                     "svd: the matrix has values that are not finite or beyond float's range");
  s->energy = energy;
  s->passes++;
  s->partial_first = slots.first;
  s->partial_count = slots.filled;
  BTFI_TRY(btfi_svd_ritz(s, (size_t)s->desc->items));
  BTFI_TRY(btfi_svd_next_basis(s));
  s->kept_energy = s->found >= plan->rank ? s->ritz[plan->rank - 1] : 0;
  double captured = 0;
  for (uint32_t i = 0; i < s->found; i++) captured += s->ritz[i];
  s->mean_rest = fmax(0, energy - captured) / (double)s->desc->items;
  return BTF_OK;
}

btf_status btfi_svd_refine(svd_state *s, double first, double last) {
  const svd_plan *plan = &s->plan;
  btfi_panel_pack(s->ctx, s->basis, plan->length_padded, plan->width, s->packed_basis);
  for (uint64_t b = 0; b < plan->block_count; b++) {
    btfi_slab slab;
    BTFI_TRY(btfi_svd_report(s, first + (last - first) * (double)b / (double)plan->block_count));
    BTFI_TRY(btfi_svd_fetch(s, b, &slab));
    BTFI_TRY(btfi_slab_project(s->ctx, &slab, s->packed_basis, plan->width,
                               s->second_projection + b * plan->block_items * plan->width, NULL));
  }
  s->passes++;
  return btfi_svd_ritz_pair(s);
}

btf_status btfi_svd_explicit_rest(svd_state *s, double first, double last, double *rest) {
  const svd_plan *plan = &s->plan;
  const int width = (int)plan->width, length = (int)plan->length_padded;
  float *data = s->window, *scaled = s->packed_projection;
  *rest = 0;
  for (uint64_t b = 0; b < plan->block_count; b++) {
    const uint64_t count = btfi_svd_block_size(s, b);
    const float *left = s->projection + b * plan->block_items * plan->width;
    btfi_slab slab;
    BTFI_TRY(btfi_svd_report(s, first + (last - first) * (double)b / (double)plan->block_count));
    BTFI_TRY(btfi_svd_fetch(s, b, &slab));
    /* The held matrix is needed no more after this, but in the same place for all blocks it stays simple. */
    if (plan->held) memcpy(data, slab.data, plan->block_floats * sizeof(float));
    const int items = (int)slab.items;
    memset(scaled, 0, slab.items * plan->width * sizeof(float));
    for (size_t i = 0; i < count; i++) {
      for (size_t k = 0; k < s->found; k++)
        scaled[i * plan->width + k] = (float)(left[i * plan->width + k] * sqrt(s->ritz[k]));
    }
    if (slab.element_step == 1)
      cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, items, length, width, -1, scaled, width, s->basis,
                  width, 1, data, (int)plan->block_ld);
    else
      cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, length, items, width, -1, s->basis, width, scaled,
                  width, 1, data, (int)plan->block_ld);
    for (size_t i = 0; i < count; i++) {
      for (size_t j = 0; j < slab.length; j++) {
        const double difference = data[i * slab.item_step + j * slab.element_step];
        *rest += difference * difference;
      }
    }
    btfi_svd_clear_block(s, data);
  }
  s->passes += plan->held ? 0 : 1;
  return BTF_OK;
}
