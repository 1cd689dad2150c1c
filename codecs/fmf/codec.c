/* SPDX-License-Identifier: MIT */
/* codec.c: the codec as the registry sees it. */
#include "fmf.h"

#include <math.h>

static const char *const storages[] = {"f32", "f16", "bf16", "q8", NULL};
static const char *const codings[] = {"packed", "plain", NULL};

BTF_PARAM(components, BTF_PARAM_INT, "number of components; unused with psnr or rmse", NULL, "32", NULL, 1,
          FMF_MAX_COMPONENTS);
BTF_PARAM(psnr, BTF_PARAM_FLOAT,
          "least quality, which picks the components; peak is the 99.9th percentile of the data", "dB", "0",
          NULL, 0, 200);
BTF_PARAM(rmse, BTF_PARAM_FLOAT, "largest root mean square error, which picks the components", NULL, "0",
          NULL, 0, INFINITY);
BTF_PARAM(max_components, BTF_PARAM_INT, "most components that psnr or rmse may pick", NULL, "256", NULL, 1,
          FMF_MAX_COMPONENTS);
BTF_PARAM(mean, BTF_PARAM_BOOL, "keep the mean ABRDF apart (principal components) in a column of its own",
          NULL, "false", NULL, 0, 1);
BTF_PARAM(storage, BTF_PARAM_CHOICE, "values in memory while evaluating", NULL, "f16", storages, 0, 0);
BTF_PARAM(coding, BTF_PARAM_CHOICE,
          "small in a file and unpacked when loaded, or as in memory and used from the mapping", NULL,
          "packed", codings, 0, 0);
BTF_PARAM(loss, BTF_PARAM_FLOAT, "relative growth of the error by packing", NULL, "0.003", NULL, 1e-6, 1);
BTF_PARAM(levels, BTF_PARAM_INT, "levels of detail, 0 = all", NULL, "0", NULL, 0, FMF_MAX_LEVELS);
BTF_PARAM(accuracy, BTF_PARAM_FLOAT, "error of the decomposition above the optimum, relative", NULL, "0.0005",
          NULL, 1e-6, 1);
BTF_PARAM(zstd, BTF_PARAM_INT, "zstd level of the packed factors, 0 = default", NULL, "0", NULL, 0, 22);

static const btf_param_desc *const params[] = {&components, &psnr, &rmse,   &max_components, &mean, &storage,
                                               &coding,     &loss, &levels, &accuracy,       &zstd, NULL};

static uint32_t level_count(const void *state) {
  return ((const btfi_fmf_state *)state)->layout.levels;
}

static uint64_t resident_bytes(const void *state) {
  return ((const btfi_fmf_state *)state)->resident;
}

/* Rows of U hold the channels of a pair of directions beside each other. */
static void cost(const void *state, uint32_t flags, btf_eval_cost *out) {
  const btfi_fmf_layout *layout = &((const btfi_fmf_state *)state)->layout;
  const bool nearest = (flags & BTF_QUERY_NEAREST) != 0;
  const double pairs = flags & BTF_COST_SHARED_DIRECTIONS ? 0 : nearest ? 1 : 9, texels = nearest ? 1 : 4;
  const double columns = layout->columns, channels = layout->channels;
  out->rows = pairs + texels;
  out->values = (pairs * channels + texels) * columns;
  out->bytes = out->values * btfi_fmf_value_bytes(layout->storage);
  out->flops = 2 * (out->values + channels * columns);
}

/* A build that only evaluates has no singular value decomposition, and does not offer to fit. */
#ifdef LIBBTF_FIT
enum { fit_caps = BTF_CAP_FIT | BTF_CAP_STREAM_FIT };
#else
enum { fit_caps = 0 };
#endif

extern const btf_codec_vtbl btf_codec_fmf;
const btf_codec_vtbl btf_codec_fmf = {
    .struct_size = sizeof(btf_codec_vtbl),
    .abi = LIBBTF_ABI,
    .id = "fmf",
    .title = "full matrix factorisation (truncated SVD of all ABRDFs)",
    .version = "1",
    .caps = fit_caps | BTF_CAP_BATCH | BTF_CAP_LOD | BTF_CAP_LINEAR | BTF_CAP_HARDENED,
    .params = params,
    .format_read_min = 1,
    .format_write = 1,
#ifdef LIBBTF_FIT
    .fit = btfi_fmf_fit,
#endif
    .load = btfi_fmf_load,
    .destroy = btfi_fmf_destroy,
    .levels = level_count,
    .resident_bytes = resident_bytes,
    .eval = btfi_fmf_eval,
    .eval_n = btfi_fmf_eval_n,
    .texel = btfi_fmf_texel,
    .cost = cost,
    .gpu_layouts = btfi_fmf_gpu_layouts,
    .gpu = btfi_fmf_gpu,
    .from_factors = btfi_fmf_from_factors,
    .factors = btfi_fmf_factors_of,
};
