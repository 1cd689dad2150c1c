/* SPDX-License-Identifier: MIT */
/* svd_pass.c: readings of the whole matrix. */
#include <cblas.h>
#include <math.h>
#include <string.h>

#include "svd/svd_state.h"

btf_status btfi_svd_report(svd_state *s, double fraction) {
  s->reached = s->from + (s->to - s->from) * fraction;
  return btfi_progress(s->job, s->reached, "svd");
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

btf_status btfi_svd_pass(svd_state *s, double first, double last, double *missed) {
  const svd_plan *plan = &s->plan;
  const size_t width = plan->width;
  svd_strays strays;
  double energy = 0;
  btfi_svd_strays_begin(s, &strays);

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
    btfi_svd_strays_take(s, &strays, &slab, row, items);
    btfi_svd_pack_projection(s, row, items, &slab);
    BTFI_TRY(btfi_slab_accumulate(s->ctx, &slab, s->packed_projection, plan->width, s->image));
  }
  if (!isfinite(energy)) return btfi_svd_not_finite(s);
  s->energy = energy;
  s->passes++;
  s->readings++;
  s->partial_first = strays.first;
  s->partial_count = strays.filled;
  BTFI_TRY(btfi_svd_ritz(s, (size_t)s->desc->items));
  BTFI_TRY(btfi_svd_next_basis(s));
  *missed = btfi_svd_strays_missed(s, &strays);
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
  s->readings++;
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
