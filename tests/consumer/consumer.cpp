// SPDX-License-Identifier: MIT
// The headers as C++11, after the names of the kernel's and SuiteSparse's btf.h.
#ifdef __linux__
#include <linux/btf.h>
#endif
#include <btf/btf.h>
#include <btf/btf_half.h>
#include <btf/btf_plugin.h>
#include <btf/btf_sampling.h>

int main() {
  btf_context *ctx = nullptr;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_job job = BTF_JOB_INIT;
  btf_limits limits = BTF_LIMITS_INIT;
  btf_io io = BTF_IO_INIT;
  btf_batch batch = BTF_BATCH_INIT;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_dataset_desc dataset = BTF_DATASET_DESC_INIT;
  (void)job, (void)limits, (void)io, (void)batch, (void)info, (void)dataset;
  if (btf_context_create(&desc, &ctx) != BTF_OK) return 1;
  btf_context_release(ctx);
  return btf_half_to_float(btf_float_to_half(0.5f)) == 0.5f ? 0 : 1;
}
