/* SPDX-License-Identifier: MIT */
/* codec.c: the codec as the registry sees it. */
#include "pvpca.h"

#include <math.h>

#include <btf/btf_codec.h>

static const char *const storages[] = {"f32", "f16", "q8", NULL};
static const char *const colors[] = {"lights", "texels", NULL};
static const char *const budgets[] = {"fixed", "adaptive", NULL};

BTF_PARAM(components, BTF_PARAM_INT,
          "components of a view beside its mean, on average if adaptive; unused with psnr or rmse", NULL, "8",
          NULL, 1, PVPCA_MAX_TERMS);
BTF_PARAM(psnr, BTF_PARAM_FLOAT,
          "least quality, which picks the components; peak is the 99.9th percentile of the data", "dB", "0",
          NULL, 0, 200);
BTF_PARAM(rmse, BTF_PARAM_FLOAT, "largest root mean square error, which picks the components", NULL, "0",
          NULL, 0, INFINITY);
BTF_PARAM(max_components, BTF_PARAM_INT, "most components of a view that psnr, rmse or adaptive may pick",
          NULL, "32", NULL, 1, PVPCA_MAX_TERMS);
BTF_PARAM(budget, BTF_PARAM_CHOICE,
          "the same number of components for every view, or spread over views where they help most", NULL,
          "fixed", budgets, 0, 0);
BTF_PARAM(mean, BTF_PARAM_BOOL, "take the mean texture of each view away first (principal components)", NULL,
          "true", NULL, 0, 1);
BTF_PARAM(color, BTF_PARAM_CHOICE,
          "colours in the weights of lights (scalar eigen-textures) or in the texels (coloured ones)", NULL,
          "lights", colors, 0, 0);
BTF_PARAM(storage, BTF_PARAM_CHOICE, "values of the eigen-textures", NULL, "f16", storages, 0, 0);
BTF_PARAM(levels, BTF_PARAM_INT, "levels of detail, 0 = all", NULL, "0", NULL, 0, PVPCA_MAX_LEVELS);

static const btf_param_desc *const params[] = {&components, &psnr,  &rmse,    &max_components, &budget,
                                               &mean,       &color, &storage, &levels,         NULL};

static uint32_t level_count(const void *state) {
  return ((const btfi_pvpca_state *)state)->layout.levels;
}

static uint64_t resident_bytes(const void *state) {
  return ((const btfi_pvpca_state *)state)->resident;
}

/* With as many terms as a view has on average. */
static void cost(const void *state, uint32_t flags, btf_eval_cost *out) {
  const btfi_pvpca_layout *layout = &((const btfi_pvpca_state *)state)->layout;
  const bool nearest = (flags & BTF_QUERY_NEAREST) != 0;
  const double views = nearest ? 1 : 3, texels = views * (nearest ? 1 : 4);
  const double lights = flags & BTF_COST_SHARED_DIRECTIONS ? 0 : views * (nearest ? 1 : 3);
  const double terms = (double)layout->terms / layout->views;
  const double weights = lights * layout->g_channels * terms;
  const double textures = texels * layout->h_channels * (layout->has_mean + terms);
  out->rows = lights + texels;
  out->values = weights + textures;
  out->bytes = weights * layout->g_bytes_value + textures * layout->h_bytes_value;
  out->flops = 2 * (out->values + views * layout->channels * terms);
}

/* A build that only evaluates has no eigenvectors, and does not offer to fit. */
#ifdef LIBBTF_FIT
enum { fit_caps = BTF_CAP_FIT | BTF_CAP_STREAM_FIT };
#else
enum { fit_caps = 0 };
#endif

extern const btf_codec_vtbl btf_codec_pvpca;
const btf_codec_vtbl btf_codec_pvpca = {
    .struct_size = sizeof(btf_codec_vtbl),
    .abi = LIBBTF_ABI,
    .id = "pvpca",
    .title = "per-view factorisation (principal components of the textures of each view)",
    .version = "1",
    .caps = fit_caps | BTF_CAP_BATCH | BTF_CAP_LOD | BTF_CAP_LINEAR | BTF_CAP_HARDENED,
    .params = params,
    .format_read_min = 1,
    .format_write = 1,
#ifdef LIBBTF_FIT
    .fit = btfi_pvpca_fit,
#endif
    .load = btfi_pvpca_load,
    .destroy = btfi_pvpca_destroy,
    .levels = level_count,
    .resident_bytes = resident_bytes,
    .eval = btfi_pvpca_eval,
    .eval_n = btfi_pvpca_eval_n,
    .texel = btfi_pvpca_texel,
    .cost = cost,
    .gpu_layouts = btfi_pvpca_gpu_layouts,
    .gpu = btfi_pvpca_gpu,
    .from_factors = btfi_pvpca_from_factors,
    .factors = btfi_pvpca_factors_of,
};
