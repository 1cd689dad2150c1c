/* SPDX-License-Identifier: MIT */
/* codec.c: the codec as the registry sees it. */
#include <math.h>

#include "cmf.h"

static const char *const methods[] = {"svd", "nonnegative", "homomorphic", NULL};
static const char *const residues[] = {"ratio", "weighted", NULL};
static const char *const averages[] = {"valid", "uniform", NULL};
static const char *const grids[] = {"parabolic", "angular", NULL};
static const char *const map_kinds[] = {"parabolic", "cube", NULL};
static const char *const storages[] = {"u8", "f16", "f32", NULL};
static const char *const full_scales[] = {"least_loss", "largest", NULL};
static const char *const clusterings[] = {"kmeans", "tree", "mediancut", NULL};

BTF_PARAM(factors, BTF_PARAM_INT, "3: P(light) Q(half) R(view); 4: D(difference) as well; not with chain",
          NULL, "3", NULL, 3, 4);
BTF_PARAM(chain, BTF_PARAM_STRING,
          "stages in order, with numbers of terms: io, oi, ih, oh, hd, dh (light, view, half, difference), "
          "means i, "
          "o, h, d; as in hd:2,io",
          NULL, "", NULL, 0, 0);
BTF_PARAM(method, BTF_PARAM_CHOICE,
          "how a stage is factored; homomorphic fits the logarithm of all stages at once", NULL, "svd",
          methods, 0, 0);
BTF_PARAM(residue, BTF_PARAM_CHOICE,
          "later stages fit data over approximation, or that weighted by the approximation: the error itself",
          NULL, "weighted", residues, 0, 0);
BTF_PARAM(sweeps, BTF_PARAM_INT, "times that every stage is fitted again to what the others leave, weighted",
          NULL, "1", NULL, 0, 100);
BTF_PARAM(average, BTF_PARAM_CHOICE,
          "cells of resampled tables: valid ones by solid angle, or all alike with 0 below the horizon", NULL,
          "valid", averages, 0, 0);
BTF_PARAM(symmetric, BTF_PARAM_BOOL, "the same factor for light and view in a stage io", NULL, "false", NULL,
          0, 1);
BTF_PARAM(grid, BTF_PARAM_CHOICE, "tables of half and difference vectors while factoring", NULL, "angular",
          grids, 0, 0);
BTF_PARAM(resolution, BTF_PARAM_INT, "edge of those tables; angular ones have half as many elevations", NULL,
          "32", NULL, 4, 64);
BTF_PARAM(map, BTF_PARAM_CHOICE, "maps of the hemisphere", NULL, "parabolic", map_kinds, 0, 0);
BTF_PARAM(edge, BTF_PARAM_INT, "edge of the maps", "texel", "32", NULL, CMF_MIN_EDGE, CMF_MAX_EDGE);
BTF_PARAM(epsilon, BTF_PARAM_FLOAT, "least divisor of a residue, relative to the largest value of the ABRDF",
          NULL, "0.001", NULL, 1e-6, 1);
BTF_PARAM(lambda, BTF_PARAM_FLOAT, "smoothness of homomorphic factors; of no other method", NULL, "10", NULL,
          1e-4, 1e4);
BTF_PARAM(log_floor, BTF_PARAM_FLOAT,
          "least value to take the logarithm of, relative to the largest of the ABRDF", NULL, "0.003", NULL,
          1e-6, 1);
BTF_PARAM(storage, BTF_PARAM_CHOICE, "values of maps and scales", NULL, "u8", storages, 0, 0);
BTF_PARAM(full_scale, BTF_PARAM_CHOICE,
          "what byte 255 of a texel's scale stands for: what loses least, cutting scales above it, or the "
          "largest; with storage=u8",
          NULL, "least_loss", full_scales, 0, 0);
BTF_PARAM(codebook, BTF_PARAM_INT,
          "entries of each factor's codebook, unused with psnr or rmse; 0 = maps of every texel's own", NULL,
          "256", NULL, 0, CMF_MAX_CODEBOOK);
BTF_PARAM(psnr, BTF_PARAM_FLOAT,
          "least quality, which picks the codebook and if need be more terms of the last stage; peak is the "
          "99.9th percentile of the data",
          "dB", "0", NULL, 0, 200);
BTF_PARAM(rmse, BTF_PARAM_FLOAT, "largest root mean square error, which picks them", NULL, "0", NULL, 0,
          INFINITY);
BTF_PARAM(max_codebook, BTF_PARAM_INT,
          "most entries that psnr or rmse may pick short of maps of every texel's own; 0 = these only", NULL,
          "4096", NULL, 0, CMF_MAX_CODEBOOK);
BTF_PARAM(max_terms, BTF_PARAM_INT, "most terms of the last stage that psnr or rmse may pick", NULL, "8",
          NULL, 1, CMF_MAX_TERMS);
BTF_PARAM(cluster, BTF_PARAM_CHOICE, "how codebooks are made", NULL, "kmeans", clusterings, 0, 0);
BTF_PARAM(samples, BTF_PARAM_INT, "texels that codebooks are made from, 0 = all", "texel", "8192", NULL, 0,
          4294967295.0);
BTF_PARAM(rotate, BTF_PARAM_BOOL, "turn each ABRDF to its direction of maximal anisotropy first", NULL,
          "false", NULL, 0, 1);
BTF_PARAM(levels, BTF_PARAM_INT, "levels of detail, 0 = all", NULL, "0", NULL, 0, CMF_MAX_LEVELS);
BTF_PARAM(
    advise, BTF_PARAM_FLOAT,
    "relative error, before storage and without psnr or rmse, above which a warning says what suits the "
    "material better",
    NULL, "0.4", NULL, 0, INFINITY);

static const btf_param_desc *const params[] = {
    &factors,      &chain,     &method,  &residue, &sweeps,    &average, &symmetric, &grid,       &resolution,
    &map,          &edge,      &epsilon, &lambda,  &log_floor, &storage, &codebook,  &psnr,       &rmse,
    &max_codebook, &max_terms, &cluster, &samples, &rotate,    &levels,  &advise,    &full_scale, NULL};

static uint32_t level_count(const void *state) {
  return ((const btfi_cmf_state *)state)->levels;
}

static uint64_t resident_bytes(const void *state) {
  return ((const btfi_cmf_state *)state)->resident;
}

/* Each factor of each texel is two places: the upper and the lower two texels of its map. */
static void cost(const void *state, uint32_t flags, btf_eval_cost *out) {
  const btfi_cmf_state *s = state;
  const double texels = flags & BTF_QUERY_NEAREST ? 1 : 4, maps = s->factors, channels = s->channels;
  const double values = texels * channels * (4 * maps + s->scales), indices = texels * maps * s->index_bytes;
  out->rows = texels * (2 * maps + 2);
  out->values = values;
  out->bytes = values * btfi_cmf_value_bytes(s->storage) + indices;
  /* Blending four values and decoding the result, then the product; and the projections. */
  out->flops = texels * channels * (10 * maps + 2) + (flags & BTF_COST_SHARED_DIRECTIONS ? 0 : 60);
}

/* A build that only evaluates has no linear algebra, and does not offer to fit. */
#ifdef LIBBTF_FIT
enum { fit_caps = BTF_CAP_FIT | BTF_CAP_STREAM_FIT };
#else
enum { fit_caps = 0 };
#endif

extern const btf_codec_vtbl btf_codec_cmf;
const btf_codec_vtbl btf_codec_cmf = {
    .struct_size = sizeof(btf_codec_vtbl),
    .abi = LIBBTF_ABI,
    .id = "cmf",
    .title = "chained matrix factorisation of each texel into hemispherical maps",
    .version = "1",
    .caps = fit_caps | BTF_CAP_BATCH | BTF_CAP_LOD | BTF_CAP_HARDENED,
    .params = params,
    .format_read_min = CMF_FORMAT,
    .format_write = CMF_FORMAT,
#ifdef LIBBTF_FIT
    .fit = btfi_cmf_fit,
#endif
    .load = btfi_cmf_load,
    .destroy = btfi_cmf_destroy,
    .levels = level_count,
    .resident_bytes = resident_bytes,
    .eval = btfi_cmf_eval,
    .eval_n = btfi_cmf_eval_n,
    .texel = btfi_cmf_texel,
    .cost = cost,
    .gpu_layouts = btfi_cmf_gpu_layouts,
    .gpu = btfi_cmf_gpu,
};
