/* SPDX-License-Identifier: MIT */
/* pieces.h: a block cut into pieces that fit a buffer, in the order of the samples. */
#ifndef BTFI_PIECES_H
#define BTFI_PIECES_H

#include "dataset/dataset.h"

typedef struct btfi_pieces {
  btf_block whole;
  uint32_t extent[4], count[4]; /* of a piece, of pieces: along view, light, y, x */
  uint64_t total;               /* number of pieces */
  uint64_t cells;               /* most texels x lights x views of one piece */
} btfi_pieces;
/* Pieces of at most max(1, room) cells, long along the axes that are innermost in `order`. */
void btfi_pieces_cut(btfi_pieces *p, const btf_block *whole, uint32_t order, uint64_t room, bool one_view);
btf_block btfi_pieces_at(const btfi_pieces *p, uint64_t index);
/* Bytes from the first sample of `whole` to that of a block inside it. */
ptrdiff_t btfi_block_offset(const btf_block *whole, const btf_block *part, const btf_strides *strides);
/* Strides of a block that is dense in an order, of `size` bytes a sample. */
btf_strides btfi_block_strides(const btf_block *block, uint32_t channels, uint32_t order, uint32_t size);

#endif
