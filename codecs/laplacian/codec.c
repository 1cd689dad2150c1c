/* SPDX-License-Identifier: MIT */
/* codec.c: the codec as the registry sees it. */
#include "laplacian.h"

#include <math.h>

static const char *const filters[] = {"mean", "binomial", "paper", NULL};
static const char *const means[] = {"phong", "table", NULL};
static const char *const budgets[] = {"fixed", "adaptive", NULL};
static const char *const storages[] = {"f16", "f32", NULL};

BTF_PARAM(y, BTF_PARAM_INT, "components of luma at each level; unused with psnr or rmse", NULL, "8", NULL, 1,
          LAPLACIAN_MAX_COMPONENTS);
BTF_PARAM(cb, BTF_PARAM_INT, "components of blue chroma at each level; unused with psnr or rmse", NULL, "2",
          NULL, 0, LAPLACIAN_MAX_COMPONENTS);
BTF_PARAM(cr, BTF_PARAM_INT, "components of red chroma at each level; unused with psnr or rmse", NULL, "2",
          NULL, 0, LAPLACIAN_MAX_COMPONENTS);
BTF_PARAM(psnr, BTF_PARAM_FLOAT,
          "least quality, which picks the components; peak is the 99.9th percentile of the data", "dB", "0",
          NULL, 0, 200);
BTF_PARAM(rmse, BTF_PARAM_FLOAT, "largest root mean square error, which picks the components", NULL, "0",
          NULL, 0, INFINITY);
BTF_PARAM(max_components, BTF_PARAM_INT,
          "most components of a channel and level that psnr, rmse or adaptive may pick", NULL, "32", NULL, 1,
          LAPLACIAN_MAX_COMPONENTS);
BTF_PARAM(
    budget, BTF_PARAM_CHOICE,
    "y, cb and cr components at each level, or as many bytes spread over levels and channels where they "
    "help most",
    NULL, "fixed", budgets, 0, 0);
BTF_PARAM(filter, BTF_PARAM_CHOICE,
          "of the pyramid: area mean or binomial with linear upsampling, or the paper's 3x3 box with nearest",
          NULL, "mean", filters, 0, 0);
BTF_PARAM(mean, BTF_PARAM_CHOICE,
          "of the coarsest level: a Blinn-Phong luma with constant chroma, or a table by directions", NULL,
          "phong", means, 0, 0);
BTF_PARAM(levels, BTF_PARAM_INT,
          "levels of the pyramid; 0 = as long as one has at least y (8 with a target) texels", NULL, "0",
          NULL, 0, LAPLACIAN_MAX_LEVELS);
BTF_PARAM(storage, BTF_PARAM_CHOICE, "values in the file and while evaluating", NULL, "f16", storages, 0, 0);
BTF_PARAM(accuracy, BTF_PARAM_FLOAT, "error of each decomposition above the optimum, relative", NULL, "0.005",
          NULL, 1e-6, 1);

static const btf_param_desc *const params[] = {
    &y, &cb, &cr, &psnr, &rmse, &max_components, &budget, &filter, &mean, &levels, &storage, &accuracy, NULL};

static uint32_t level_count(const void *state) {
  return ((const btfi_laplacian_state *)state)->grid.levels;
}

static uint64_t resident_bytes(const void *state) {
  return ((const btfi_laplacian_state *)state)->resident;
}

static void cost(const void *state, uint32_t flags, btf_eval_cost *out) {
  const btfi_laplacian_state *s = state;
  const bool nearest = (flags & BTF_QUERY_NEAREST) != 0;
  const double values = s->layout.first[s->grid.levels], texels = nearest ? 1.0 : 4.0;
  const double rows = flags & BTF_COST_SHARED_DIRECTIONS ? 0.0 : nearest ? 1.0 : 9.0;
  out->rows = rows + texels * s->grid.levels;
  out->values = (rows + texels) * values;
  out->bytes = out->values * s->layout.value_bytes;
  /* Blends, then two products and a sum for each value, the mean, and back to RGB. */
  out->flops = 2.0 * out->values + 3.0 * values + 30.0;
}

/* A build that only evaluates has no singular value decomposition, and does not offer to fit. */
#ifdef LIBBTF_FIT
enum { fit_caps = BTF_CAP_FIT | BTF_CAP_STREAM_FIT };
#else
enum { fit_caps = 0 };
#endif

extern const btf_codec_vtbl btf_codec_laplacian;
const btf_codec_vtbl btf_codec_laplacian = {
    .struct_size = sizeof(btf_codec_vtbl),
    .abi = LIBBTF_ABI,
    .id = "laplacian",
    .title = "Laplacian pyramids of images, principal components of each level (Ma et al. 2005)",
    .version = "1",
    .caps = fit_caps | BTF_CAP_BATCH | BTF_CAP_LOD | BTF_CAP_LINEAR | BTF_CAP_RGB_ONLY | BTF_CAP_HARDENED,
    .params = params,
    .format_read_min = 1,
    .format_write = 1,
#ifdef LIBBTF_FIT
    .fit = btfi_laplacian_fit,
#endif
    .load = btfi_laplacian_load,
    .destroy = btfi_laplacian_destroy,
    .levels = level_count,
    .resident_bytes = resident_bytes,
    .eval = btfi_laplacian_eval,
    .eval_n = btfi_laplacian_eval_n,
    .texel = btfi_laplacian_texel,
    .cost = cost,
    .gpu_layouts = btfi_laplacian_gpu_layouts,
    .gpu = btfi_laplacian_gpu,
};
