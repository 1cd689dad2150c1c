/* SPDX-License-Identifier: MIT */
/* dataset.h: what upper layers need of data sets, and mip filtering. */
#ifndef BTFI_DATASET_H
#define BTFI_DATASET_H

#include "base/base.h"
#include "directions/directions.h"
#include "io/io.h"
#include <btf/btf_dataset.h>

btf_context *btfi_dataset_context(const btf_dataset *ds);
/* The description inside, complete (names and color space filled in, `data` set when resident or mapped). */
const btf_dataset_desc *btfi_dataset_desc(const btf_dataset *ds);
uint32_t btfi_sample_size(uint32_t sample_type); /* bytes, 0 if unknown */
/* One sample of any type at a byte address, as float. */
float btfi_sample_to_float(uint32_t sample_type, const void *src);

/* ---- mip levels (mip.c) ---- */

uint32_t btfi_mip_count(uint32_t width, uint32_t height);
/* Texel i of a level of `level_size` texels over `size` finest ones covers finest texels first .. first + count - 1;
 * those between weigh 1 each, the first and last the fractions returned; the total is size / level_size. */
typedef struct btfi_mip_span {
  uint32_t first, count;
  float first_weight, last_weight; /* in finest texels; count 1 uses first_weight */
} btfi_mip_span;
void btfi_mip_span_of(uint32_t size, uint32_t level_size, uint32_t i, btfi_mip_span *out);
btf_status btfi_mip_filter(btf_context *ctx, const float *src, size_t src_ld, uint32_t width, uint32_t height,
                           uint32_t n, uint32_t level, float *dst, size_t dst_ld);

#endif
