/* SPDX-License-Identifier: MIT */
/* svd_blocks.c: blocks of the matrix, read once or again and again, and the sample. */
#include <math.h>
#include <string.h>

#include "svd/svd_state.h"

uint64_t btfi_svd_block_size(const svd_state *s, uint64_t block) {
  return BTFI_MIN((uint64_t)s->plan.block_items, s->desc->items - block * s->plan.block_items);
}

btfi_slab btfi_svd_slab(const svd_state *s, const float *data, uint64_t items) {
  const size_t grain = BTFI_SLAB_GRAIN;
  btfi_slab slab = {data, 1, 1, ((size_t)items + grain - 1) / grain * grain, s->plan.length_padded};
  if (s->desc->layout == BTF_LAYOUT_ITEM_ROWS)
    slab.item_step = s->plan.block_ld;
  else
    slab.element_step = s->plan.block_ld;
  return slab;
}

void btfi_svd_clear_block(const svd_state *s, float *data) {
  memset(data, 0, s->plan.block_floats * sizeof(float));
}

/* A short block may lie where a longer one was. */
static void clear_behind(const svd_state *s, float *data, uint64_t items) {
  const btfi_slab slab = btfi_svd_slab(s, data, items);
  for (size_t i = (size_t)items; i < slab.items; i++) {
    for (size_t j = 0; j < slab.length; j++) data[i * slab.item_step + j * slab.element_step] = 0;
  }
}

/* Multiplies items just read by 2^-exponent, in two factors that are floats themselves. */
static void scale_items(const svd_state *s, float *data, uint64_t items) {
  if (s->exponent == 0) return;
  const float first = ldexpf(1, -s->exponent / 2), second = ldexpf(1, -s->exponent - -s->exponent / 2);
  const bool rows = s->desc->layout == BTF_LAYOUT_ITEM_ROWS;
  const uint64_t lines = rows ? items : s->desc->length, run = rows ? s->desc->length : items;
  for (uint64_t i = 0; i < lines; i++) {
    float *line = data + i * s->plan.block_ld;
    for (uint64_t j = 0; j < run; j++) line[j] = line[j] * first * second;
  }
}

btf_status btfi_svd_find_largest(svd_state *s, float *largest) {
  *largest = 0;
  for (uint64_t b = 0; b < s->plan.block_count; b++) {
    btfi_slab slab;
    BTFI_TRY(btfi_svd_fetch(s, b, &slab));
    for (size_t i = 0; i < slab.items; i++) {
      for (size_t j = 0; j < slab.length; j++) {
        const float value = slab.data[i * slab.item_step + j * slab.element_step];
        if (!isfinite(value))
          return btfi_fail(s->ctx, BTF_E_NUMERIC, "svd: the matrix has values that are not finite");
        *largest = fmaxf(*largest, fabsf(value));
      }
    }
  }
  s->passes += s->plan.held ? 0 : 1;
  return BTF_OK;
}

btf_status btfi_svd_fetch(svd_state *s, uint64_t block, btfi_slab *slab) {
  const uint64_t items = btfi_svd_block_size(s, block);
  float *data = s->plan.held ? s->blocks + block * s->plan.block_floats : s->window;
  *slab = btfi_svd_slab(s, data, items);
  if (s->plan.held && s->loaded) return BTF_OK;
  BTFI_TRY(s->desc->read(s->desc->user, block * s->plan.block_items, items, data, s->plan.block_ld));
  scale_items(s, data, items);
  clear_behind(s, data, items);
  return BTF_OK;
}

btf_status btfi_svd_read_sample(svd_state *s) {
  const svd_plan *plan = &s->plan;
  const uint64_t run = plan->run_items, runs_in_block = plan->block_items / run;
  const uint64_t runs = plan->sample_blocks * runs_in_block, places = s->desc->items / run;
  for (uint64_t r = 0; r < runs; r++) {
    /* One run from each of `runs` equal parts, so that no region of the material is left out. */
    const uint64_t first = places * r / runs, last = places * (r + 1) / runs;
    const uint64_t place = first + btfi_random_below(&s->random, last - first);
    float *data = s->blocks + r / runs_in_block * plan->block_floats;
    const size_t offset = (size_t)(r % runs_in_block * run);
    float *dst = data + (s->desc->layout == BTF_LAYOUT_ITEM_ROWS ? offset * plan->block_ld : offset);
    BTFI_TRY(s->desc->read(s->desc->user, place * run, run, dst, plan->block_ld));
    scale_items(s, dst, run);
    if (r % runs_in_block + 1 == runs_in_block) {
      clear_behind(s, data, plan->block_items);
      BTFI_TRY(btfi_svd_report(s, 0.1 * (double)(r + 1) / (double)runs));
    }
  }
  return BTF_OK;
}
