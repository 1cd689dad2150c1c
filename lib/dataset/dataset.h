/* SPDX-License-Identifier: MIT */
/* dataset.h: what upper layers need of data sets, and mip filtering. */
#ifndef BTFI_DATASET_H
#define BTFI_DATASET_H

#include "base/base.h"
#include "directions/directions.h"
#include "io/io.h"
#include <btf/btf_plugin.h>

btf_context *btfi_dataset_context(const btf_dataset *ds);
/* The description inside, complete (names and color space filled in, `data` set when resident or mapped). */
const btf_dataset_desc *btfi_dataset_desc(const btf_dataset *ds);
/* Views x lights entries that tell where a common light lies in its view's own list; NULL without such lists.
 */
const btf_interp *btfi_dataset_light_weights(const btf_dataset *ds);
/* The same samples for a reader of its own that is to keep within so many bytes: where a mapping has more,
 * its file is read instead, and that and sources through a small part of them. 0 = no bound, and the data set
 * itself is retained. Values do not depend on it. */
btf_status btfi_dataset_within(const btf_dataset *ds, uint64_t bytes, btf_dataset **out);
/* BTF_E_CORRUPT, naming the place, if a resident or mapped sample is not finite; reads all of them once.
 * Samples of a source are checked when they are read. */
btf_status btfi_dataset_check_finite(const btf_dataset *ds, const btf_job *job);
uint32_t btfi_sample_size(uint32_t sample_type); /* bytes, 0 if unknown */
/* One sample of any type at a byte address, as float. */
float btfi_sample_to_float(uint32_t sample_type, const void *src);

/* ---- mip levels (mip.c) ---- */

uint32_t btfi_mip_count(uint32_t width, uint32_t height);
/* Texel i of a level of `level_size` texels over `size` finest ones covers i * size / level_size to
 * (i + 1) * size / level_size on the finest axis: texels first .. first + count - 1, of which the first and
 * the last count by the fraction given (first_weight alone when count is 1) and those between by 1. The sum
 * of all is size / level_size. */
typedef struct btfi_mip_span {
  uint32_t first, count;
  double first_weight, last_weight;
} btfi_mip_span;
void btfi_mip_span_of(uint32_t size, uint32_t level_size, uint32_t i, btfi_mip_span *out);
static inline double btfi_mip_weight(const btfi_mip_span *span, uint32_t k) {
  return k == 0 ? span->first_weight : k + 1 == span->count ? span->last_weight : 1.0;
}
/* Filters n interleaved floats per texel from the finest level straight to `level`, every texel the area
 * average of what it covers. Texels are src_ld (dst_ld) >= n floats apart and follow each other row by row
 * without gaps. Sums in double. */
btf_status btfi_mip_filter(btf_context *ctx, const float *src, size_t src_ld, uint32_t width, uint32_t height,
                           uint32_t n, uint32_t level, float *dst, size_t dst_ld);

/* ---- ABRDFs (visit.c): btf_host.visit_abrdfs ---- */

btf_status btfi_visit_abrdfs(btf_context *ctx, const btf_dataset *ds, uint32_t level,
                             uint64_t max_working_set, btf_abrdf_fn visit, void *user, const btf_job *job,
                             double from, double to, const char *stage);

#endif
