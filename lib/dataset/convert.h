/* SPDX-License-Identifier: MIT */
/* convert.h: kernels between sample types and floats, and blocks of samples moved between two orders. */
#ifndef BTFI_CONVERT_H
#define BTFI_CONVERT_H

#include "base/base.h"
#include "dataset/dataset.h"

/* n neighbouring samples to floats; false when one of them is not finite. */
typedef bool (*btfi_unpack_fn)(const void *src, float *dst, size_t n);
/* n neighbouring floats to samples; false when one of them cannot be represented (not finite, or beyond
 * halves). */
typedef bool (*btfi_pack_fn)(const float *src, void *dst, size_t n);
/* out[i * out_stride + j] = in[j * in_stride + i] (strides in floats) for i < rows, j < columns: what was
 * column i of the tile becomes row i of the output. */
typedef void (*btfi_transpose_fn)(const float *in, ptrdiff_t in_stride, float *out, ptrdiff_t out_stride,
                                  size_t rows, size_t columns);
/* n triples to three rows. */
typedef void (*btfi_split3_fn)(const float *in, float *out0, float *out1, float *out2, size_t n);

typedef struct btfi_convert_kernels {
  btfi_unpack_fn unpack;
  btfi_pack_fn pack;
  btfi_transpose_fn transpose;
  btfi_split3_fn split3;
  uint32_t sample_type, sample_size;
} btfi_convert_kernels;
/* Kernels for a sample type under an instruction set; all sets give the same bits. */
btfi_convert_kernels btfi_convert_select(uint32_t sample_type, uint32_t isa);

/* convert_x86.c: replaces what the processor does better. */
void btfi_convert_select_x86(btfi_convert_kernels *kernels, uint32_t isa);

/* A block of samples seen along up to five axes: how many, and how far apart in source and destination
 * (bytes). */
typedef struct btfi_axis {
  size_t count;
  ptrdiff_t src, dst;
} btfi_axis;
enum { btfi_axes_most = 5 };

/* Moves samples at src to floats at dst. False when a sample is not finite (dst then holds it as well). Both
 * sides are walked in pieces that stay in cache whatever the two orders are. Uses several threads when it
 * pays. */
btf_status btfi_unpack_block(btf_context *ctx, const btfi_convert_kernels *kernels, const btfi_axis *axes,
                             uint32_t axis_count, const void *src, void *dst, bool *finite);
/* The same from floats to samples, on the calling thread; false when a value cannot be represented. */
bool btfi_pack_block(const btfi_convert_kernels *kernels, const btfi_axis *axes, uint32_t axis_count,
                     const void *src, void *dst);

#endif
