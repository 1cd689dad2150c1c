/* SPDX-License-Identifier: MIT */
/* The host table: what codecs and formats may call. */
#include "dataset/dataset.h"
#include "dataset/matrix.h"
#include "io/new_folder.h"
#include "registry/registry.h"
#ifdef LIBBTF_FIT
#include "dense/dense.h"
#include "registry/decompose.h"
#include "svd/svd.h"
#else

static btf_status evaluates_only(btf_context *ctx) {
  return btfi_fail(ctx, BTF_E_UNSUPPORTED,
                   "this build of libbtf evaluates only; it was made without LIBBTF_FIT");
}

static btf_status btfi_gemm(btf_context *ctx, uint32_t flags, uint64_t m, uint64_t n, uint64_t k, float alpha,
                            const float *a, size_t a_ld, const float *b, size_t b_ld, float beta, float *c,
                            size_t c_ld) {
  (void)flags, (void)m, (void)n, (void)k, (void)alpha, (void)a, (void)a_ld, (void)b, (void)b_ld, (void)beta;
  (void)c, (void)c_ld;
  return evaluates_only(ctx);
}

static btf_status btfi_gram(btf_context *ctx, uint64_t rows, uint32_t columns, const float *a, size_t a_ld,
                            double *g) {
  (void)rows, (void)columns, (void)a, (void)a_ld, (void)g;
  return evaluates_only(ctx);
}

static btf_status btfi_symmetric_eigen(btf_context *ctx, uint32_t n, double *a, double *values) {
  (void)n, (void)a, (void)values;
  return evaluates_only(ctx);
}

static btf_status btfi_cholesky(btf_context *ctx, uint32_t n, double *a) {
  (void)n, (void)a;
  return evaluates_only(ctx);
}

static btf_status btfi_cholesky_solve(btf_context *ctx, uint32_t n, const double *factor, uint32_t columns,
                                      double *b) {
  (void)n, (void)factor, (void)columns, (void)b;
  return evaluates_only(ctx);
}

static btf_status btfi_svd(btf_context *ctx, const btf_svd_desc *desc, const btf_job *job, double from,
                           double to, btf_svd_result *out) {
  const btf_svd_result nothing = {0};
  (void)desc, (void)job, (void)from, (void)to;
  BTFI_TRY(btfi_copy_out(ctx, "btf_svd_result", out, BTFI_SIZE_TO(btf_svd_result, residual), &nothing,
                         sizeof nothing));
  return evaluates_only(ctx);
}

static btf_status btfi_decompose(btf_context *ctx, const btf_dataset *ds, const float *mean,
                                 const btf_svd_desc *desc, const btf_job *job, double from, double to,
                                 btf_svd_result *out) {
  (void)ds, (void)mean;
  return btfi_svd(ctx, desc, job, from, to, out);
}

static void btfi_svd_free(btf_context *ctx, btf_svd_result *result) {
  (void)ctx;
  (void)result;
}
#endif

_Static_assert((int)BTF_JSON_NULL == (int)BTFI_JSON_NULL && (int)BTF_JSON_BOOL == (int)BTFI_JSON_BOOL &&
                   (int)BTF_JSON_NUMBER == (int)BTFI_JSON_NUMBER &&
                   (int)BTF_JSON_STRING == (int)BTFI_JSON_STRING &&
                   (int)BTF_JSON_ARRAY == (int)BTFI_JSON_ARRAY &&
                   (int)BTF_JSON_OBJECT == (int)BTFI_JSON_OBJECT,
               "the kinds of JSON values are the same on both sides");

static const btf_host host = {
    .struct_size = sizeof(btf_host),
    .abi = LIBBTF_ABI,
    .alloc = btfi_alloc,
    .free = btfi_free,
    .fail = btfi_fail,
    .log = btfi_log,
    .parallel = btfi_parallel,
    .thread_count = btfi_thread_count,
    .isa = btfi_isa,
    .progress = btfi_progress,
    .dataset_describe = btf_dataset_describe,
    .dataset_read = btf_dataset_read,
    .option = btfi_option,
    .option_text = btfi_option_text,
    .option_is_set = btfi_option_is_set,
    .dirset_count = btf_dirset_count,
    .dirset_directions = btf_dirset_directions,
    .dirset_locate = btf_dirset_locate,
    .dirset_locate_n = btf_dirset_locate_n,
    .dirset_nearest = btf_dirset_nearest,
    .put = btfi_chunk_put,
    .reserve = btfi_chunk_reserve,
    .get = btfi_chunk_get,
    .has = btfi_chunk_has,
    .set_zstd_level = btfi_chunk_set_zstd_level,
    .svd = btfi_svd,
    .svd_free = btfi_svd_free,
    .mip_count = btfi_mip_count,
    .mip_filter = btfi_mip_filter,
    .visit_abrdfs = btfi_visit_abrdfs,
    .gemm = btfi_gemm,
    .gram = btfi_gram,
    .symmetric_eigen = btfi_symmetric_eigen,
    .cholesky = btfi_cholesky,
    .cholesky_solve = btfi_cholesky_solve,
    .measure = btfi_measure,
    .svd_dataset = btfi_decompose,
    .dirset_create = btf_dirset_create,
    .dirset_create_named = btf_dirset_create_named,
    .dirset_release = btf_dirset_release,
    .dataset_create = btf_dataset_create,
    .source_error = btf_source_error,
    .number = btfi_number,
    .json_parse = btfi_json_parse,
    .json_free = btfi_json_free,
    .json_type = btfi_json_type,
    .json_length = btfi_json_length,
    .json_at = btfi_json_at,
    .json_get = btfi_json_get,
    .json_number = btfi_json_number,
    .json_string = btfi_json_string,
    .gpu_table = btfi_gpu_table,
    .gpu_slice = btfi_gpu_slice,
    .gpu_uniform = btfi_gpu_uniform,
    .gpu_directions = btfi_gpu_directions,
    .gpu_source = btfi_gpu_source,
    .gpu_cost = btfi_gpu_cost,
    .dataset_factors = btf_dataset_factors,
    .io_file = btf_io_file,
    .folder_begin = btfi_new_folder_begin,
    .folder_put = btfi_new_folder_put,
    .folder_end = btfi_new_folder_end,
    .gpu_direction_maps = btfi_gpu_direction_maps,
};

const btf_host *btfi_host(void) {
  return &host;
}
