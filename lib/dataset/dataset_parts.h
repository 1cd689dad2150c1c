/* SPDX-License-Identifier: MIT */
/* dataset_parts.h: inside of a data set. */
#ifndef BTFI_DATASET_PARTS_H
#define BTFI_DATASET_PARTS_H

#include <pthread.h>

#include "dataset/convert.h"
#include "dataset/dataset.h"

/* Most that all threads together read from a source at once. */
#define BTFI_SOURCE_SCRATCH_BYTES ((uint64_t)16 << 20)

struct btf_dataset {
  btf_dataset_desc desc; /* complete; its pointers belong to the data set */
  btfi_convert_kernels kernels;
  btf_context *ctx;
  char *label; /* names the data set in messages */
  btf_interp *
      light_weights; /* views x lights: where a sample lies in its view's own list; NULL without such lists */
  btfi_mapping mapping;
  /* Of a reader within a bound (bounded.c): the data set that owns all of the above, and its share. */
  btf_dataset *whole;
  uint64_t scratch_bytes; /* in place of BTFI_SOURCE_SCRATCH_BYTES; 0 = that */
  bool reads_file;        /* instead of its mapping */
  pthread_mutex_t one_reader;
  atomic_uint references;
};

/* What a caller's description owns passes to the data set: `release` is called by it from here on, also on
 * failure. `mapping` may be NULL; it is unmapped on failure. `label` NULL = the name or "data set". */
btf_status btfi_dataset_make(btf_context *ctx, const btf_dataset_desc *user, const char *label,
                             const btfi_mapping *mapping, btf_dataset **out);
/* Checks sizes, type and texts of a description, for data sets and writers alike. */
btf_status btfi_dataset_check_shape(btf_context *ctx, const char *label, const btf_dataset_desc *desc);
/* Deep copy of directions and texts with the defaults filled in; frees what it took on failure. */
btf_status btfi_dataset_copy_texts(btf_context *ctx, btf_dataset_desc *desc);
void btfi_dataset_free_texts(btf_context *ctx, btf_dataset_desc *desc);
/* Strides of dense samples of `size` bytes in an order. */
btf_strides btfi_dense_strides(const btf_dataset_desc *desc, uint32_t order, ptrdiff_t size);

/* read.c: samples as the source has them; lights count within the view's own list where there are such lists.
 */
btf_status btfi_read_samples(const btf_dataset *ds, const btf_block *block, float *dst,
                             const btf_strides *strides);
/* bounded.c: a block of the mapped file to dense samples in the file's own order, run by run. */
btf_status btfi_read_runs(const btf_dataset *ds, const btf_block *block, void *dst);
/* Whether a block lies within the data set and the strides on the floats' side are fit to be used. */
btf_status btfi_dataset_check_block(btf_context *ctx, const char *label, const btf_dataset_desc *d,
                                    const btf_block *b, const btf_strides *s, bool writes_floats);
/* Names the first sample of a block that is not finite. `src` is the sample of the block's first corner. */
btf_status btfi_fail_not_finite(btf_context *ctx, const char *label, uint32_t sample_type,
                                const btf_block *block, uint32_t channels, const void *src,
                                const btf_strides *strides, char *message, size_t message_size);

/* per_view_lights.c */
btf_status btfi_per_view_prepare(btf_dataset *ds);
btf_status btfi_per_view_read(const btf_dataset *ds, const btf_block *block, float *dst,
                              const btf_strides *strides);

#endif
