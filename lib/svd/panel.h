/* SPDX-License-Identifier: MIT */
/* panel.h: products of a slab of the matrix with thin panels of vectors. */
#ifndef BTFI_SVD_PANEL_H
#define BTFI_SVD_PANEL_H

#include "base/base.h"

enum {
  BTFI_PANEL_GRAIN = 16, /* columns of a panel come in multiples of this */
  BTFI_SLAB_GRAIN = 8    /* items and elements of a slab come in multiples of this, the surplus being zero */
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

/* c (8 x 16 vectors) += a (8 x depth) * b (depth x 16 vectors), `vectors` being 1, 2 or 3. */
typedef void (*btfi_tile_fn)(uint32_t vectors, size_t depth, const float *a, size_t a_row, size_t a_step,
                             const float *b, size_t b_row, float *c, size_t c_row);
/* NULL where the build or the processor has no such kernel. */
btfi_tile_fn btfi_panel_tile(uint32_t isa);

#endif
