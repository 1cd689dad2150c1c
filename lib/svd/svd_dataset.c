/* SPDX-License-Identifier: MIT */
/* svd_dataset.c: the decomposition of a data set, whichever way it is read. */
#include "dataset/matrix.h"
#include "svd/svd.h"

btf_status btfi_svd_dataset(btf_context *ctx, const btf_dataset *ds, const float *mean,
                            const btf_svd_desc *desc, const btf_job *job, double from, double to,
                            btf_svd_result *out) {
  btf_svd_desc of_matrix;
  btfi_matrix matrix;
  BTFI_TRY(btfi_copy_in(ctx, "btf_svd_desc", &of_matrix, sizeof of_matrix,
                        BTFI_SIZE_TO(btf_svd_desc, reserved), desc));
  if (of_matrix.max_working_set == 0) of_matrix.max_working_set = (uint64_t)1 << 30;
  BTFI_TRY(btfi_matrix_open(ctx, ds, of_matrix.max_working_set, &matrix));
  matrix.mean = mean;
  of_matrix.items = matrix.items;
  of_matrix.length = matrix.length;
  of_matrix.read = btfi_matrix_read;
  of_matrix.user = &matrix;
  of_matrix.layout = matrix.layout;
  of_matrix.block_items = matrix.block_items;
  const uint64_t most = BTFI_MIN(matrix.items, matrix.length);
  if (of_matrix.rank > most) of_matrix.rank = (uint32_t)most;
  const btf_status status = btfi_svd(ctx, &of_matrix, job, from, to, out);
  btfi_matrix_close(&matrix);
  if (status == BTF_OK && matrix.by_image) {
    float *const images = out->item_vectors;
    out->item_vectors = out->element_vectors;
    out->element_vectors = images;
  }
  return status;
}
