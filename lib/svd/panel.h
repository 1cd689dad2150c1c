/* SPDX-License-Identifier: MIT */
/* panel.h: products of a slab of the matrix with thin panels of vectors. */
#ifndef BTFI_SVD_PANEL_H
#define BTFI_SVD_PANEL_H

#include "base/base.h"

enum {
  BTFI_PANEL_GRAIN = 16, /* columns of a panel come in multiples of this */
  BTFI_TILE_FETCH = 8,
  BTFI_SLAB_GRAIN = 8 /* items and elements of a slab come in multiples of this, the surplus being zero */
};

/* Some items of the matrix: element j of item i at data[i * item_step + j * element_step]. */
typedef struct btfi_slab {
  const float *data;
  size_t item_step, element_step;
  size_t items, length; /* multiples of BTFI_SLAB_GRAIN */
} btfi_slab;

/* Arranges a panel (rows x width, row-major) as the operand that a product reads: in tiles of columns, so
 * that the kernels walk through it without gaps. */
void btfi_panel_pack(btf_context *ctx, const float *panel, size_t rows, uint32_t width, float *packed);

/* projection (items x width) = slab * basis (length x width, packed). With `norms`, also the squared norm of
 * each item. The sums do not depend on the number of threads. */
btf_status btfi_slab_project(btf_context *ctx, const btfi_slab *slab, const float *packed_basis,
                             uint32_t width, float *projection, double *norms);
/* image (length x width) += slab^T * projection (items x width, packed). */
btf_status btfi_slab_accumulate(btf_context *ctx, const btfi_slab *slab, const float *packed_projection,
                                uint32_t width, float *image);

/* The kernels of an instruction set. */
typedef struct btfi_panel_kernels {
  uint32_t rows;   /* of a tile of sums that fits in the registers; divides BTFI_SLAB_GRAIN */
  uint32_t vector; /* floats */
  /* c (rows x vectors) += a (rows x depth) * b (depth x vectors, dense), `vectors` being 1, 2 or 3. Every
   * BTFI_TILE_FETCH terms the line at `fetch`, which moves on by fetch_step, is fetched to L2. */
  void (*tile)(uint32_t vectors, size_t depth, const float *a, size_t a_row, size_t a_step, const float *b,
               float *c, size_t c_row, const float *fetch, size_t fetch_step);
  /* Copies a (count x depth, a row a column), `count` a multiple of BTFI_SLAB_GRAIN, to stripes of `rows`
   * rows, stripe_floats apart and dense: stripe[t * rows + row] = a[t * a_step + row]. With `squares`, adds
   * each row's sum of squares. */
  void (*stripe)(size_t count, size_t depth, const float *a, size_t a_step, float *stripes,
                 size_t stripe_floats, double *squares);
  /* Sum of the squares of `count` floats. */
  double (*square)(const float *a, size_t count);
} btfi_panel_kernels;

/* NULL where the build or the processor has none. */
const btfi_panel_kernels *btfi_panel_kernels_for(uint32_t isa);

#endif
