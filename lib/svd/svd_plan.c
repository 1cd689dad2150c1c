/* SPDX-License-Identifier: MIT */
/* svd_plan.c: sizes under a byte budget, and the memory of them. */
#include <inttypes.h>
#include <string.h>

#include "dense/dense.h"
#include "svd/svd_state.h"

enum {
  BLOCK_BYTES = 20 << 20, /* met twice, so much of it should be in L3 still; wider ones read longer runs */
  SMALLEST_BLOCK = 64,
  LARGEST_BLOCK = 8192,
  RUN = 32,
  SAMPLE_MIN = 2048,
  SAMPLE_MAX = 8192,
  SAMPLE_PER_COLUMN = 112
};

static uint64_t round_up(uint64_t value, uint64_t grain) {
  return (value + grain - 1) / grain * grain;
}

static void shape_block(const btf_svd_desc *desc, svd_plan *plan, uint64_t items) {
  plan->block_items = (size_t)items;
  plan->block_count = (desc->items + items - 1) / items;
  const size_t padded = (size_t)round_up(items, BTFI_SLAB_GRAIN);
  if (desc->layout == BTF_LAYOUT_ITEM_ROWS) {
    plan->block_ld = plan->length_padded + 16;
    plan->block_floats = padded * plan->block_ld;
  } else {
    /* One more cache line, and never a power of two: rows would fall into the same sets of the cache. */
    plan->block_ld = (size_t)round_up(padded, 16) + 16;
    plan->block_floats = plan->length_padded * plan->block_ld;
  }
}

/* Doubles of the scratch for panels met in double, and for LAPACK between; 0 if LAPACK cannot count so many.
 */
static uint64_t scratch_doubles(const svd_plan *plan) {
  const uint64_t width = plan->width, rows = BTFI_MAX((uint64_t)SVD_GRAM_ROWS, width) * width;
  const uint64_t room = width <= UINT32_MAX / 2 ? btfi_eigen_room((plan->refine ? 2 : 1) * plan->width) : 0;
  return room > 0 ? BTFI_MAX(rows, room) : 0;
}

/* Bytes beside the result with `blocks` blocks held; false beyond 64 bits. */
static bool count_bytes(const btf_svd_desc *desc, const svd_plan *plan, uint64_t blocks, uint64_t *bytes) {
  const uint64_t width = plan->width, padded = round_up(plan->block_items, BTFI_SLAB_GRAIN);
  const uint64_t scratch = scratch_doubles(plan);
  uint64_t held, surplus, panels;
  if (scratch == 0) return false;
  if (!btfi_mul((uint64_t)plan->block_floats * sizeof(float), blocks + 1, &held)) return false;
  if (!btfi_mul(desc->items, (width - plan->rank) * sizeof(float), &surplus)) return false;
  if (!btfi_mul(plan->length_padded, (3 * width + 1) * sizeof(float), &panels)) return false;
  const uint64_t both = 2 * width;
  uint64_t second = 0;
  if (plan->refine && !btfi_mul(desc->items + BTFI_SLAB_GRAIN, width * sizeof(float), &second)) return false;
  if (plan->refine && !btfi_add(second, (SVD_WIDE * both + 4) * both * sizeof(double), &second)) return false;
  if (!btfi_add(surplus, second, &surplus)) return false;
  const uint64_t small = (padded + BTFI_SLAB_GRAIN) * width * sizeof(float) + padded * sizeof(double) +
                         ((SVD_SMALL * width + 5) * width + scratch) * sizeof(double) + 16 * 128;
  return btfi_add(held, surplus, bytes) && btfi_add(*bytes, panels, bytes) && btfi_add(*bytes, small, bytes);
}

btf_status btfi_svd_plan(btf_context *ctx, const btf_svd_desc *desc, uint32_t rank, bool quiet,
                         svd_plan *plan) {
  const uint64_t smaller = BTFI_MIN(desc->items, desc->length);
  /* Columns beyond the rank speed up convergence, and give strays room. */
  const uint32_t spare = BTFI_MAX(8u, rank / 4);
  memset(plan, 0, sizeof *plan);
  plan->rank = rank;
  plan->width = (uint32_t)round_up(BTFI_MIN(smaller, rank + spare), BTFI_PANEL_GRAIN);
  plan->length_padded = (size_t)round_up(desc->length, BTFI_SLAB_GRAIN);
  if (scratch_doubles(plan) == 0)
    return btfi_fail(ctx, BTF_E_LIMIT, "svd: %u components are more than LAPACK can count", rank);

  const uint64_t item_bytes = plan->length_padded * sizeof(float);
  uint64_t run = BTFI_MIN(desc->block_items > 0 ? desc->block_items : RUN, desc->items), bytes = UINT64_MAX;
  uint64_t block =
      BTFI_MAX((uint64_t)SMALLEST_BLOCK, BTFI_MIN((uint64_t)LARGEST_BLOCK, BLOCK_BYTES / item_bytes));
  block = BTFI_MIN(BTFI_MAX(block / run, 1) * run, round_up(desc->items, run));
  bool fits;
  for (;;) {
    shape_block(desc, plan, block);
    fits = count_bytes(desc, plan, 0, &bytes) && bytes <= desc->max_working_set;
    if (fits || block == 1) break;
    /* Half the runs, and when one is left half the run. */
    if (block > run) {
      block = BTFI_MAX(block / run / 2, 1) * run;
    } else {
      run = (run + 1) / 2;
      block = run;
    }
  }
  if (!fits) {
    plan->least_bytes = bytes;
    return btfi_fail(quiet ? NULL : ctx, BTF_E_LIMIT,
                     "svd: a working set of %" PRIu64 " bytes is too small for %u components of %" PRIu64
                     " x %" PRIu64 " values; at least %" PRIu64 " bytes are needed",
                     desc->max_working_set, rank, desc->items, desc->length, bytes);
  }
  plan->run_items = (uint32_t)run;
  /* The second image is worth its room where the sample keeps three quarters of it. */
  plan->refine = true;
  plan->refine = count_bytes(desc, plan, 0, &bytes) && bytes <= desc->max_working_set / 4;

  plan->held = count_bytes(desc, plan, plan->block_count, &bytes) && bytes <= desc->max_working_set;
  const uint64_t wanted =
      BTFI_MIN(BTFI_MAX((uint64_t)SAMPLE_PER_COLUMN * plan->width, SAMPLE_MIN), SAMPLE_MAX);
  uint64_t sample = (wanted + block - 1) / block;
  if (plan->held) {
    /* Whole blocks of a held matrix cost nothing, so take them all where that is hardly more work. */
    plan->sample_blocks = sample * 2 > plan->block_count ? plan->block_count : sample;
  } else {
    const uint64_t full_blocks = desc->items / block;
    sample = BTFI_MIN(sample, BTFI_MAX(full_blocks / 4, 1));
    sample = BTFI_MIN(sample, full_blocks);
    while (sample > 0 && !(count_bytes(desc, plan, sample, &bytes) && bytes <= desc->max_working_set))
      sample--;
    if (sample * block < plan->width + 16) sample = 0;
    plan->sample_blocks = sample;
  }
  return count_bytes(desc, plan, plan->held ? plan->block_count : plan->sample_blocks, &plan->bytes)
             ? BTF_OK
             : btfi_fail(ctx, BTF_E_LIMIT, "svd: the matrix is too large to address");
}

void btfi_svd_end_state(svd_state *s) {
  btfi_free(s->ctx, s->blocks);
  btfi_free(s->ctx, s->window);
  btfi_free(s->ctx, s->projection);
  btfi_free(s->ctx, s->basis);
  btfi_free(s->ctx, s->image);
  btfi_free(s->ctx, s->second_projection);
  btfi_free(s->ctx, s->wide);
  btfi_free(s->ctx, s->packed_basis);
  btfi_free(s->ctx, s->packed_projection);
  btfi_free(s->ctx, s->direction);
  btfi_free(s->ctx, s->norms);
  btfi_free(s->ctx, s->small);
  btfi_free(s->ctx, s->rows);
  btfi_free(s->ctx, s->theta);
  s->blocks = s->window = s->projection = s->basis = s->image = NULL;
  s->second_projection = NULL;
  s->wide = NULL;
  s->packed_basis = s->packed_projection = s->direction = NULL;
  s->norms = s->small = s->rows = s->theta = NULL;
  s->loaded = false;
}

btf_status btfi_svd_begin_state(svd_state *s) {
  const svd_plan *plan = &s->plan;
  const uint64_t width = plan->width, padded = round_up(plan->block_items, BTFI_SLAB_GRAIN);
  const uint64_t panel = plan->length_padded * width * sizeof(float);
  const uint64_t kept_blocks = plan->held ? plan->block_count : plan->sample_blocks;
  if ((s->window = btfi_alloc(s->ctx, plan->block_floats, sizeof(float))) == NULL ||
      (s->blocks = btfi_alloc(s->ctx, plan->block_floats * sizeof(float), kept_blocks)) == NULL ||
      (s->projection = btfi_alloc(s->ctx, s->desc->items + BTFI_SLAB_GRAIN, width * sizeof(float))) == NULL ||
      (s->basis = btfi_alloc(s->ctx, panel, 1)) == NULL ||
      (s->image = btfi_alloc(s->ctx, panel, 1)) == NULL ||
      (s->packed_basis = btfi_alloc(s->ctx, panel, 1)) == NULL ||
      (s->packed_projection = btfi_alloc(s->ctx, padded * width, sizeof(float))) == NULL ||
      (s->direction = btfi_alloc(s->ctx, plan->length_padded, sizeof(float))) == NULL ||
      (s->norms = btfi_alloc(s->ctx, padded, sizeof(double))) == NULL ||
      (s->small = btfi_alloc(s->ctx, SVD_SMALL * width * width, sizeof(double))) == NULL ||
      (s->rows = btfi_alloc(s->ctx, scratch_doubles(plan), sizeof(double))) == NULL ||
      (s->theta = btfi_alloc(s->ctx, 5 * width, sizeof(double))) == NULL)
    return btfi_alloc_status();
  s->previous = s->theta + 4 * width;
  s->readings = 0;
  const uint64_t both = 2 * width;
  if (plan->refine && ((s->second_projection = btfi_alloc(s->ctx, s->desc->items + BTFI_SLAB_GRAIN,
                                                          width * sizeof(float))) == NULL ||
                       (s->wide = btfi_alloc(s->ctx, (SVD_WIDE * both + 4) * both, sizeof(double))) == NULL))
    return btfi_alloc_status();
  btfi_svd_clear_block(s, s->window);
  for (uint64_t b = 0; b < kept_blocks; b++) btfi_svd_clear_block(s, s->blocks + b * plan->block_floats);
  return BTF_OK;
}
