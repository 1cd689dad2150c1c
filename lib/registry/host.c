/* SPDX-License-Identifier: MIT */
/* The host table: what codecs may call. */
#include "registry/registry.h"
#ifdef LIBBTF_FIT
#include "svd/svd.h"
#else

#include <string.h>

static btf_status btfi_svd(btf_context *ctx, const btf_svd_desc *desc, const btf_job *job, double from,
                           double to, btf_svd_result *out) {
  (void)desc;
  (void)job;
  (void)from;
  (void)to;
  if (out != NULL) memset(out, 0, sizeof *out);
  return btfi_fail(ctx, BTF_E_UNSUPPORTED,
                   "this build of libbtf evaluates only; it was made without LIBBTF_FIT");
}

static void btfi_svd_free(btf_context *ctx, btf_svd_result *result) {
  (void)ctx;
  (void)result;
}
#endif

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
};

const btf_host *btfi_host(void) {
  return &host;
}
