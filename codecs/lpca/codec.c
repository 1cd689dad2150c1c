/* SPDX-License-Identifier: MIT */
/* codec.c: the codec as the registry sees it. */
#include "lpca.h"

#include <math.h>

static const char *const storages[] = {"f16", "f32", "q8", NULL};
static const char *const packings[] = {"aligned", "tight", NULL};

BTF_PARAM(clusters, BTF_PARAM_INT, "clusters of ABRDFs", NULL, "32", NULL, 1, LPCA_MAX_CLUSTERS);
BTF_PARAM(components, BTF_PARAM_INT, "components of each cluster; unused with psnr or rmse", NULL, "8", NULL,
          1, LPCA_MAX_COMPONENTS);
BTF_PARAM(psnr, BTF_PARAM_FLOAT,
          "least quality, which picks the components; peak is the 99.9th percentile of the data", "dB", "0",
          NULL, 0, 200);
BTF_PARAM(rmse, BTF_PARAM_FLOAT, "largest root mean square error, which picks the components", NULL, "0",
          NULL, 0, INFINITY);
BTF_PARAM(max_components, BTF_PARAM_INT, "most components that psnr or rmse may pick", NULL, "64", NULL, 1,
          LPCA_MAX_COMPONENTS);
BTF_PARAM(storage, BTF_PARAM_CHOICE, "values of the tables; q8 has a scale for each factor", NULL, "f16",
          storages, 0, 0);
BTF_PARAM(packing, BTF_PARAM_CHOICE, "rows of the tables on cache lines, or without gaps", NULL, "aligned",
          packings, 0, 0);
BTF_PARAM(subspace, BTF_PARAM_INT,
          "leading components of the whole material that clusters are found in, 0 = all", NULL, "128", NULL,
          0, LPCA_MAX_SUBSPACE);
BTF_PARAM(iterations, BTF_PARAM_INT, "most rounds of assignment and refit", NULL, "60", NULL, 0, 10000);
BTF_PARAM(restarts, BTF_PARAM_INT, "independent starts, of which the best is kept", NULL, "1", NULL, 1, 100);
BTF_PARAM(refine, BTF_PARAM_INT, "readings of the data that improve the components of the clusters", NULL,
          "1", NULL, 0, 20);
BTF_PARAM(levels, BTF_PARAM_INT, "levels of detail, 0 = all", NULL, "0", NULL, 0, LPCA_MAX_LEVELS);

static const btf_param_desc *const params[] = {
    &clusters, &components, &psnr,     &rmse,   &max_components, &storage, &packing,
    &subspace, &iterations, &restarts, &refine, &levels,         NULL};

static uint32_t level_count(const void *state) {
  return ((const btfi_lpca_state *)state)->layout.levels;
}

static uint64_t resident_bytes(const void *state) {
  return ((const btfi_lpca_state *)state)->resident;
}

/* Clusters among the four texels of an interpolation, on the average over the finest level. */
static double mean_clusters(const btfi_lpca_state *s) {
  const uint32_t width = s->layout.width, height = s->layout.height;
  const uint64_t wide = s->layout.index_bytes;
  uint64_t sum = 0;
  for (uint32_t y = 0; y < height; y++)
    for (uint32_t x = 0; x < width; x++) {
      uint64_t at[4];
      for (uint32_t i = 0; i < 4; i++)
        at[i] = wide * ((uint64_t)((y + i / 2) % height) * width + (x + i % 2) % width);
      for (uint32_t i = 0; i < 4; i++) {
        uint32_t seen = 0;
        for (uint32_t k = 0; k < i; k++) seen |= memcmp(s->index[0] + at[k], s->index[0] + at[i], wide) == 0;
        sum += seen == 0;
      }
    }
  return (double)sum / ((double)width * height);
}

static void cost(const void *state, uint32_t flags, btf_eval_cost *out) {
  const btfi_lpca_state *s = state;
  const btfi_lpca_layout *l = &s->layout;
  const bool nearest = (flags & BTF_QUERY_NEAREST) != 0;
  const double taken = nearest ? 1.0 : mean_clusters(s), texels = nearest ? 1.0 : 4.0;
  const double rows = taken * (nearest ? 1.0 : 9.0), row_values = (double)l->channels * (l->components + 1);
  out->rows = rows + texels;
  out->bytes = rows * (double)l->row_data_bytes + texels * (double)(l->texel_bytes + l->index_bytes);
  out->values = rows * row_values + texels * l->components;
  out->flops = 2.0 * (rows + taken) * row_values + 2.0 * texels * l->components;
}

/* A build that only evaluates has no linear algebra, and does not offer to fit. */
#ifdef LIBBTF_FIT
enum { fit_caps = BTF_CAP_FIT | BTF_CAP_STREAM_FIT };
#else
enum { fit_caps = 0 };
#endif

extern const btf_codec_vtbl btf_codec_lpca;
const btf_codec_vtbl btf_codec_lpca = {
    .struct_size = sizeof(btf_codec_vtbl),
    .abi = LIBBTF_ABI,
    .id = "lpca",
    .title = "local PCA (clusters of ABRDFs, each with an affine subspace)",
    .version = "1",
    .caps = fit_caps | BTF_CAP_BATCH | BTF_CAP_LOD | BTF_CAP_HARDENED,
    .params = params,
    .format_read_min = 1,
    .format_write = 1,
#ifdef LIBBTF_FIT
    .fit = btfi_lpca_fit,
#endif
    .load = btfi_lpca_load,
    .destroy = btfi_lpca_destroy,
    .levels = level_count,
    .resident_bytes = resident_bytes,
    .eval = btfi_lpca_eval,
    .eval_n = btfi_lpca_eval_n,
    .texel = btfi_lpca_texel,
    .cost = cost,
    .gpu_layouts = btfi_lpca_gpu_layouts,
    .gpu = btfi_lpca_gpu,
};
