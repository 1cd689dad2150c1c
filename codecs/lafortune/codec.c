/* SPDX-License-Identifier: MIT */
/* codec.c: the codec as the registry sees it. */
#include "lafortune.h"

#include <math.h>

#include <btf/btf_codec.h>

static const char *const kinds[] = {"diagonal", "full", "phong", "blinn_phong", "ward", "lewis", NULL};
static const char *const colours[] = {"luminance", "channel", NULL};
static const char *const storages[] = {"f32", "f16", NULL};
static const char *const weightings[] = {"uniform", "cosine", "log", NULL};

BTF_PARAM(lobes, BTF_PARAM_INT,
          "lobes of each texel, for classical kinds 1 unless set; unused with psnr or rmse", NULL, "2", NULL,
          1, LAF_MAX_LOBES);
BTF_PARAM(kind, BTF_PARAM_CHOICE,
          "generalised cosine lobes, diagonal or of a full matrix, or a classical model", NULL, "diagonal",
          kinds, 0, 0);
BTF_PARAM(color, BTF_PARAM_CHOICE, "lobes shared by all channels, or each channel its own", NULL, "luminance",
          colours, 0, 0);
BTF_PARAM(storage, BTF_PARAM_CHOICE, "values in the file and while evaluating", NULL, "f16", storages, 0, 0);
BTF_PARAM(psnr, BTF_PARAM_FLOAT,
          "least quality, which picks the lobes; peak is the 99.9th percentile of the data", "dB", "0", NULL,
          0, 200);
BTF_PARAM(rmse, BTF_PARAM_FLOAT, "largest root mean square error, which picks the lobes", NULL, "0", NULL, 0,
          INFINITY);
BTF_PARAM(weights, BTF_PARAM_CHOICE,
          "errors count alike, times the cosine of the light, or by their ratio to the value", NULL,
          "uniform", weightings, 0, 0);
BTF_PARAM(starts, BTF_PARAM_INT, "starting points tried for each texel", NULL, "3", NULL, 1, 64);
BTF_PARAM(iterations, BTF_PARAM_INT, "most iterations from each starting point", NULL, "60", NULL, 1, 10000);
BTF_PARAM(tolerance, BTF_PARAM_FLOAT, "relative gain of an iteration at which the fit ends", NULL, "1e-4",
          NULL, 1e-9, 0.1);
BTF_PARAM(levels, BTF_PARAM_INT, "levels of detail, each fitted to its own data, 0 = all", NULL, "0", NULL, 0,
          LAF_MAX_LEVELS);
BTF_PARAM(advise, BTF_PARAM_FLOAT,
          "relative error above which a warning names codecs that suit the material better", NULL, "0.25",
          NULL, 0, INFINITY);

static const btf_param_desc *const params[] = {&lobes,  &kind,    &color,  &storage,    &psnr,
                                               &rmse,   &weights, &starts, &iterations, &tolerance,
                                               &levels, &advise,  NULL};

static uint32_t level_count(const void *state) {
  return ((const btfi_lafortune_state *)state)->levels;
}

static uint64_t resident_bytes(const void *state) {
  return ((const btfi_lafortune_state *)state)->resident;
}

/* Of a power and what surrounds it: a logarithm's 9 fused operations, 7 of the exponential, the products
 * between. */
enum { POWER_FLOPS = 2 * 16 + 6 };

static void cost(const void *state, uint32_t flags, btf_eval_cost *out) {
  const btfi_lafortune_layout *layout = &((const btfi_lafortune_state *)state)->layout;
  const double texels = flags & BTF_QUERY_NEAREST ? 1 : 4;
  const double lobe_flops = 2.0 * btfi_lafortune_term_count(layout->kind) + POWER_FLOPS;
  out->rows = texels;
  out->values = texels * layout->values;
  out->bytes = out->values * layout->value_bytes;
  out->flops = texels * layout->groups *
               (layout->lobes * lobe_flops + 2.0 * (1 + layout->lobes) * layout->group_channels);
}

/* A build that only evaluates does not offer to fit. */
#ifdef LIBBTF_FIT
enum { fit_caps = BTF_CAP_FIT | BTF_CAP_STREAM_FIT };
#else
enum { fit_caps = 0 };
#endif

extern const btf_codec_vtbl btf_codec_lafortune;
const btf_codec_vtbl btf_codec_lafortune = {
    .struct_size = sizeof(btf_codec_vtbl),
    .abi = LIBBTF_ABI,
    .id = "lafortune",
    .title = "analytic lobes fitted to each texel (Lafortune and classical models)",
    .version = "1",
    .caps = fit_caps | BTF_CAP_BATCH | BTF_CAP_LOD | BTF_CAP_HARDENED,
    .params = params,
    .format_read_min = 1,
    .format_write = 1,
#ifdef LIBBTF_FIT
    .fit = btfi_lafortune_fit,
#endif
    .load = btfi_lafortune_load,
    .destroy = btfi_lafortune_destroy,
    .levels = level_count,
    .resident_bytes = resident_bytes,
    .eval = btfi_lafortune_eval,
    .eval_n = btfi_lafortune_eval_n,
    .texel = btfi_lafortune_texel,
    .cost = cost,
    .gpu_layouts = btfi_lafortune_gpu_layouts,
    .gpu = btfi_lafortune_gpu,
};
