/* SPDX-License-Identifier: MIT */
/* decompose.c: the decomposition of a data set, by texels or by images, whichever the budget suits. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "dataset/matrix.h"
#include "registry/decompose.h"
#include "svd/svd.h"

typedef struct decomposition {
  btf_context *ctx;
  const btf_dataset *ds;
  const float *mean;
  btf_svd_desc desc;
  const btf_job *job;
  double from, to;
} decomposition;

/* About the bytes that panels and an item at a time take. */
static double bytes_needed(const btfi_matrix *m, bool by_image, uint32_t rank) {
  const double items = (double)(by_image ? m->rows : m->texels),
               length = (double)(by_image ? m->texels : m->rows);
  const double spare = BTFI_MAX(8.0, rank / 4.0), width = fmin(fmin(items, length), rank + spare);
  return sizeof(float) * (length * (3 * width + 2) + items * spare);
}

/* Data is taken as it lies unless that does not fit: a stream can be read no other way, and a mapping of the
 * same samples has to give the same bytes. What is held may be read either way, and sums over items are in
 * float: the fewer, the better. */
static bool prefers_images(const btfi_matrix *as_it_lies, uint32_t rank, uint64_t budget) {
  const bool images = as_it_lies->by_image;
  if (btfi_matrix_is_held(as_it_lies, budget)) return images;
  const double wanted = bytes_needed(as_it_lies, images, rank);
  return wanted > (double)budget && bytes_needed(as_it_lies, !images, rank) < wanted ? !images : images;
}

static btf_status decompose_by(const decomposition *d, bool by_image, btf_svd_result *out) {
  btf_svd_desc desc = d->desc;
  btfi_matrix matrix;
  BTFI_TRY(btfi_matrix_open_by(d->ctx, d->ds, by_image, &matrix));
  matrix.mean = d->mean;
  desc.items = matrix.items;
  desc.length = matrix.length;
  desc.read = btfi_matrix_read;
  desc.user = &matrix;
  desc.layout = matrix.layout;
  desc.block_items = matrix.block_items;
  desc.rank = (uint32_t)BTFI_MIN(BTFI_MIN(matrix.items, matrix.length), (uint64_t)desc.rank);
  const btf_status status = btfi_svd_try(d->ctx, &desc, d->job, d->from, d->to, out);
  btfi_matrix_close(&matrix);
  if (status == BTF_OK && by_image) {
    float *const images = out->item_vectors;
    out->item_vectors = out->element_vectors;
    out->element_vectors = images;
  }
  return status;
}

/* A refused plan has read nothing yet: the other one may fit. Only if neither does is it worth a line in the
 * log. */
static btf_status decompose_either_way(const decomposition *d, btf_svd_result *out) {
  btfi_matrix shape;
  BTFI_TRY(btfi_matrix_open(d->ctx, d->ds, d->desc.max_working_set, &shape));
  const bool by_image = prefers_images(&shape, d->desc.rank, d->desc.max_working_set);
  btfi_matrix_close(&shape);
  const btf_status status = decompose_by(d, by_image, out);
  const uint64_t least = out->least_working_set;
  if (status != BTF_E_LIMIT || least == 0) return status;
  const btf_status second = decompose_by(d, !by_image, out);
  if (second != BTF_E_LIMIT || out->least_working_set == 0) return second;
  out->least_working_set = BTFI_MIN(least, out->least_working_set);
  return btfi_fail(d->ctx, BTF_E_LIMIT,
                   "svd: a working set of %" PRIu64 " bytes is too small for %u components of %" PRIu64
                   " texels with %" PRIu64 " values each; at least %" PRIu64 " bytes are needed",
                   d->desc.max_working_set, d->desc.rank, shape.texels, shape.rows, out->least_working_set);
}

btf_status btfi_decompose(btf_context *ctx, const btf_dataset *ds, const float *mean,
                          const btf_svd_desc *user, const btf_job *job, double from, double to,
                          btf_svd_result *out) {
  decomposition d = {.ctx = ctx, .ds = ds, .mean = mean, .job = job, .from = from, .to = to};
  btf_svd_result result = {.struct_size = sizeof result};
  const size_t minimum = BTFI_SIZE_TO(btf_svd_result, residual);
  BTFI_TRY(btfi_copy_out(ctx, "btf_svd_result", out, minimum, &result, sizeof result));
  BTFI_TRY(
      btfi_copy_in(ctx, "btf_svd_desc", &d.desc, sizeof d.desc, BTFI_SIZE_TO(btf_svd_desc, reserved), user));
  if (d.desc.max_working_set == 0) d.desc.max_working_set = (uint64_t)1 << 30;
  const btf_status status = decompose_either_way(&d, &result);
  const btf_status copied = btfi_copy_out(ctx, "btf_svd_result", out, minimum, &result, sizeof result);
  return status != BTF_OK ? status : copied;
}
