/* SPDX-License-Identifier: MIT */
/* svd_strays.c: what no sample foresaw, taken up while the matrix is read. */
#include <cblas.h>
#include <math.h>
#include <string.h>

#include "svd/svd_state.h"

/* An item is a stray when its distance from the basis is this many times the average, and this part of the
 * weakest wanted squared singular value: fifty alike would then make a singular vector. */
static const double stray_factor = 8, stray_weight = 0.02;
/* Items farther than this many times the average are of the crowd. One of them is tried for each such part of
 * the weakest wanted squared singular value that they add up to, or of all they have added up to so far. */
static const double crowd_factor = 4, crowd_step = 0.25;
/* What float sums leave of an item is rounding below this part of it. */
static const double item_rounding = 1e-5;
enum { MAX_STRAYS = 64, MAX_TRIALS = 24, STRAY_PASSES = 2 };

void btfi_svd_strays_begin(const svd_state *s, svd_strays *strays) {
  const svd_plan *plan = &s->plan;
  memset(strays, 0, sizeof *strays);
  strays->count =
      plan->width > plan->rank ? BTFI_MIN((plan->width - plan->rank) / 2, (uint32_t)SVD_STRAY_COLUMNS) : 0;
  strays->first = plan->width - strays->count;
  strays->watch = strays->count > 0 && s->readings < STRAY_PASSES && plan->width < s->desc->length;
  strays->stray_floor = fmax(stray_factor * s->mean_rest, stray_weight * s->kept_energy);
  /* Without a sample nothing is known of the rest, and all items far away are strays. */
  strays->crowd_floor = s->kept_energy > 0 ? crowd_factor * s->mean_rest : INFINITY;
}

/* Gives the residual of an item a column. Rows of C before this block, and what they put into Y, become zero:
 * C may have any rows as long as Y = M^T C. */
static bool take_up(svd_state *s, svd_strays *strays, const btfi_slab *slab, uint64_t row, uint64_t item,
                    uint32_t slot) {
  const size_t width = s->plan.width;
  const uint32_t column = strays->first + slot;
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
  strays->energy[slot] = 0;
  strays->before[slot] = strays->crowd;
  if (slot == strays->filled) strays->filled++;
  return true;
}

static bool take_up_stray(svd_state *s, svd_strays *strays, const btfi_slab *slab, uint64_t row,
                          uint64_t item, double rest) {
  uint32_t slot = strays->filled;
  if (strays->taken >= MAX_STRAYS) return false;
  if (slot == strays->count) {
    slot = 0;
    for (uint32_t k = 1; k < strays->count; k++) {
      if (strays->energy[k] < strays->energy[slot]) slot = k;
    }
    if (rest < 2 * strays->energy[slot]) return false;
  }
  if (!take_up(s, strays, slab, row, item, slot)) return false;
  strays->trial[slot] = false;
  strays->taken++;
  return true;
}

/* A column for one of the crowd: a free one, or in turn that of a trial which found little. */
static bool take_up_trial(svd_state *s, svd_strays *strays, const btfi_slab *slab, uint64_t row,
                          uint64_t item) {
  uint32_t slot = strays->filled;
  for (uint32_t k = 0; slot == strays->count && k < strays->count; k++) {
    const uint32_t next = (strays->next + k) % strays->count;
    if (strays->trial[next] && strays->energy[next] < crowd_step * s->kept_energy) {
      slot = next;
      strays->next = next + 1;
      break;
    }
    if (k + 1 == strays->count) return false;
  }
  if (!take_up(s, strays, slab, row, item, slot)) return false;
  strays->trial[slot] = true;
  return true;
}

static double item_rest(const svd_state *s, uint64_t row, uint64_t item) {
  const float *c = s->projection + (row + item) * s->plan.width;
  double rest = s->norms[item];
  for (uint32_t k = 0; k < s->plan.width; k++) rest -= (double)c[k] * c[k];
  return rest < item_rounding * s->norms[item] ? 0 : rest;
}

static bool take_up_strays(svd_state *s, svd_strays *strays, const btfi_slab *slab, uint64_t row,
                           uint64_t items) {
  for (bool changed = false;; changed = true) {
    uint64_t worst = 0;
    double worst_rest = 0, missed = 0;
    for (uint64_t i = 0; i < items; i++) {
      const double rest = item_rest(s, row, i);
      if (rest < strays->stray_floor || rest <= 0) continue;
      missed += rest;
      if (rest > worst_rest) {
        worst_rest = rest;
        worst = i;
      }
    }
    if (worst_rest <= 0 || !take_up_stray(s, strays, slab, row, worst, worst_rest)) {
      strays->missed += missed;
      return changed;
    }
  }
}

static bool in_crowd(const svd_strays *strays, double rest) {
  return rest > strays->crowd_floor && rest < strays->stray_floor;
}

/* Items that are no strays one by one may have a direction in common. It shows when one of them, picked as
 * often as its rest is large, gets a column: the rest of all that are like it goes there. */
static bool try_crowd(svd_state *s, svd_strays *strays, const btfi_slab *slab, uint64_t row, uint64_t items) {
  for (bool changed = false;; changed = true) {
    double crowd = 0;
    for (uint64_t i = 0; i < items; i++) {
      const double rest = item_rest(s, row, i);
      if (in_crowd(strays, rest)) crowd += rest;
    }
    const double step = crowd_step * fmax(s->kept_energy, strays->tried);
    bool more = crowd > 0 && strays->crowd + crowd >= strays->tried + step;
    if (more && strays->trials < MAX_TRIALS) {
      double place = crowd * btfi_random_float(&s->random);
      uint64_t chosen = items;
      for (uint64_t i = 0; i < items && place >= 0; i++) {
        const double rest = item_rest(s, row, i);
        if (!in_crowd(strays, rest)) continue;
        place -= rest;
        chosen = i;
      }
      more = take_up_trial(s, strays, slab, row, chosen);
      strays->refused |= !more;
    } else {
      more = false;
    }
    if (!more) {
      strays->crowd += crowd;
      return changed;
    }
    strays->trials++;
    strays->tried += step;
  }
}

void btfi_svd_strays_take(svd_state *s, svd_strays *strays, const btfi_slab *slab, uint64_t row,
                          uint64_t items) {
  if (!strays->watch) return;
  bool changed = take_up_strays(s, strays, slab, row, items);
  changed |= try_crowd(s, strays, slab, row, items);
  if (changed) btfi_panel_pack(s->ctx, s->basis, s->plan.length_padded, s->plan.width, s->packed_basis);
  for (uint32_t k = 0; k < strays->filled; k++) {
    for (uint64_t i = 0; i < items; i++) {
      const double c = s->projection[(row + i) * s->plan.width + strays->first + k];
      strays->energy[k] += c * c;
    }
  }
}

double btfi_svd_strays_missed(const svd_state *s, const svd_strays *strays) {
  const double weakest = s->found >= s->plan.rank ? s->ritz[s->plan.rank - 1] : 0;
  /* Where no column was to be had for a trial, the whole crowd may be alike. */
  const double missed = strays->missed + (strays->refused ? strays->crowd : 0);
  /* Each direction that strays have in common would put one of the present ones out. */
  double sum = fmax(0, missed - weakest);
  for (uint32_t k = 0; k < strays->filled; k++) {
    const double energy = strays->energy[k], after = strays->crowd - strays->before[k];
    if (!strays->trial[k] || !(energy > 0)) continue;
    /* As much of the crowd before it was alike as of the crowd after it. */
    const double earlier = strays->before[k] * energy / (energy + after);
    sum += fmin(earlier, fmax(0, energy + earlier - weakest));
  }
  return sum;
}
