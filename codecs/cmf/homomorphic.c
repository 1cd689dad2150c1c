/* SPDX-License-Identifier: MIT */
/* homomorphic.c: least squares in the logarithm, with one Cholesky factor for all texels. */
#include "homomorphic.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

/* Part of the mean diagonal of M^T M that is added to the diagonal: it decides what neither data nor
 * smoothness do, such as texels without neighbours, and is too small to be seen where they do. */
static const double ridge_part = 1e-9;
static const uint32_t not_unknown = UINT32_MAX;

struct btfi_cmf_hf {
  uint32_t pairs, maps, texels; /* pairs in use; texels of all maps */
  uint32_t unknowns;
  uint32_t *pair;    /* which pairs are in use */
  uint32_t *place;   /* of each texel its unknown, or not_unknown */
  uint32_t *unknown; /* pairs x maps x 4 */
  float *weight;     /* likewise */
  double *sums;      /* M^T 1 */
  double *factor;    /* unknowns x unknowns, lower half */
};

void btfi_cmf_hf_free(const btf_host *host, btf_context *ctx, btfi_cmf_hf *hf) {
  if (hf == NULL) return;
  host->free(ctx, hf->pair);
  host->free(ctx, hf->place);
  host->free(ctx, hf->unknown);
  host->free(ctx, hf->weight);
  host->free(ctx, hf->sums);
  host->free(ctx, hf->factor);
  host->free(ctx, hf);
}

uint32_t btfi_cmf_hf_unknowns(const btfi_cmf_hf *hf) {
  return hf->unknowns;
}

/* ---- the system ---- */

static int uses_pair(const btfi_cmf_hf_geometry *g, uint32_t pair) {
  return g->use_pair == NULL || g->use_pair[pair];
}

/* Chooses pairs and numbers the unknowns map by map. */
static void number_unknowns(const btfi_cmf_hf_geometry *g, btfi_cmf_hf *hf) {
  const uint32_t map_texels = g->width * g->height, taps = 4 * g->maps;
  hf->pairs = hf->unknowns = 0;
  for (uint32_t i = 0; i < hf->texels; i++)
    hf->place[i] = g->use_texel == NULL || g->use_texel[i] ? 0 : not_unknown;
  for (uint32_t p = 0; p < g->pairs; p++) {
    if (!uses_pair(g, p)) continue;
    hf->pair[hf->pairs++] = p;
    for (uint32_t i = 0; i < taps; i++)
      if (g->weight[(size_t)p * taps + i] != 0.0f)
        hf->place[i / 4 * map_texels + g->texel[(size_t)p * taps + i]] = 0;
  }
  for (uint32_t i = 0; i < hf->texels; i++)
    if (hf->place[i] != not_unknown) hf->place[i] = hf->unknowns++;
}

static void copy_taps(const btfi_cmf_hf_geometry *g, btfi_cmf_hf *hf) {
  const uint32_t map_texels = g->width * g->height, taps = 4 * g->maps;
  for (uint32_t p = 0; p < hf->pairs; p++) {
    for (uint32_t i = 0; i < taps; i++) {
      const size_t from = (size_t)hf->pair[p] * taps + i, to = (size_t)p * taps + i;
      const float weight = g->weight[from];
      hf->weight[to] = weight;
      hf->unknown[to] = weight != 0.0f ? hf->place[i / 4 * map_texels + g->texel[from]] : 0;
      hf->sums[hf->unknown[to]] += (double)weight;
    }
  }
}

/* Adds scale * row^T row of a sparse row to the lower half. */
static void add_row(btfi_cmf_hf *hf, uint32_t n, const uint32_t *unknown, const double *value, double scale) {
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < n; j++)
      if (unknown[j] <= unknown[i])
        hf->factor[(size_t)unknown[i] * hf->unknowns + unknown[j]] += scale * value[i] * value[j];
}

/* The Laplacian at one texel: the differences to its neighbours among the unknowns. */
static void add_laplacian(const btfi_cmf_hf_geometry *g, btfi_cmf_hf *hf, uint32_t texel, double scale) {
  const uint32_t map_texels = g->width * g->height, first = texel / map_texels * map_texels;
  const uint32_t x = texel % map_texels % g->width, y = texel % map_texels / g->width;
  uint32_t unknown[5], n = 1, near[4], count = 0;
  double value[5] = {0};
  if (x > 0 || g->wrap) near[count++] = y * g->width + (x > 0 ? x : g->width) - 1;
  if (x + 1 < g->width || g->wrap) near[count++] = y * g->width + (x + 1 < g->width ? x + 1 : 0);
  if (y > 0) near[count++] = (y - 1) * g->width + x;
  if (y + 1 < g->height) near[count++] = (y + 1) * g->width + x;
  unknown[0] = hf->place[texel];
  for (uint32_t i = 0; i < count; i++) {
    const uint32_t other = hf->place[first + near[i]];
    if (other == not_unknown) continue;
    unknown[n] = other;
    value[n++] = -1.0;
    value[0] += 1.0;
  }
  add_row(hf, n, unknown, value, scale);
}

/* A constant may pass from one map to another without a change of the product. All maps get the same mean
 * logarithm: any solution can be brought to that form, so that data and smoothness are fitted as well as
 * without. */
static btf_status add_equal_means(const btf_host *host, btf_context *ctx, btfi_cmf_hf *hf, double scale) {
  const uint32_t map_texels = hf->texels / hf->maps;
  uint32_t *unknown = host->alloc(ctx, hf->unknowns, sizeof *unknown), previous[2] = {0, 0};
  double *value = host->alloc(ctx, hf->unknowns, sizeof *value);
  btf_status status = unknown != NULL && value != NULL ? BTF_OK : BTF_E_NOMEM;
  for (uint32_t map = 0; status == BTF_OK && map < hf->maps; map++) {
    uint32_t first = UINT32_MAX, count = 0;
    for (uint32_t i = map * map_texels; i < (map + 1) * map_texels; i++) {
      if (hf->place[i] == not_unknown) continue;
      if (count++ == 0) first = hf->place[i];
    }
    if (count == 0) continue;
    if (previous[1] > 0) {
      for (uint32_t i = 0; i < previous[1]; i++) {
        unknown[i] = previous[0] + i;
        value[i] = 1.0 / previous[1];
      }
      for (uint32_t i = 0; i < count; i++) {
        unknown[previous[1] + i] = first + i;
        value[previous[1] + i] = -1.0 / count;
      }
      add_row(hf, previous[1] + count, unknown, value, scale);
    }
    previous[0] = first;
    previous[1] = count;
  }
  host->free(ctx, unknown);
  host->free(ctx, value);
  return status;
}

/* The lower half of M^T M + lambda^2 L^T L and what makes it definite. */
static btf_status assemble(const btf_host *host, btf_context *ctx, const btfi_cmf_hf_geometry *g,
                           btfi_cmf_hf *hf, double lambda) {
  const uint32_t taps = 4 * g->maps;
  const size_t n = hf->unknowns;
  double trace = 0.0;
  memset(hf->factor, 0, n * n * sizeof *hf->factor);
  for (uint32_t p = 0; p < hf->pairs; p++) {
    double value[4 * CMF_HF_MAX_MAPS];
    for (uint32_t i = 0; i < taps; i++) value[i] = (double)hf->weight[(size_t)p * taps + i];
    add_row(hf, taps, hf->unknown + (size_t)p * taps, value, 1.0);
  }
  for (size_t i = 0; i < n; i++) trace += hf->factor[i * n + i];
  for (uint32_t i = 0; i < hf->texels; i++)
    if (hf->place[i] != not_unknown) add_laplacian(g, hf, i, lambda * lambda);
  for (size_t i = 0; i < n; i++) hf->factor[i * n + i] += ridge_part * trace / (double)n;
  return add_equal_means(host, ctx, hf, trace);
}

static btf_status build(const btf_host *host, btf_context *ctx, const btfi_cmf_hf_geometry *g, double lambda,
                        uint64_t max_working_set, btfi_cmf_hf *hf) {
  const uint64_t taps = 4 * (uint64_t)g->maps;
  hf->maps = g->maps;
  hf->texels = g->maps * g->width * g->height;
  hf->pair = host->alloc(ctx, g->pairs, sizeof *hf->pair);
  hf->place = host->alloc(ctx, hf->texels, sizeof *hf->place);
  if (hf->pair == NULL || hf->place == NULL) return BTF_E_NOMEM;
  number_unknowns(g, hf);
  if (hf->pairs == 0)
    return host->fail(ctx, BTF_E_UNSUPPORTED,
                      "cmf: homomorphic factorisation needs at least one pair of directions");
  /* LAPACK works on a copy of the matrix. */
  const uint64_t n = hf->unknowns, need = 2 * n * n * sizeof(double) + hf->pairs * taps * 8 +
                                          (uint64_t)hf->texels * 4 + (uint64_t)g->pairs * 4 + n * 20;
  if (need > max_working_set)
    return host->fail(
        ctx, BTF_E_LIMIT,
        "cmf: homomorphic factorisation with %u unknowns needs a working set of %llu bytes; %llu are "
        "allowed",
        hf->unknowns, (unsigned long long)need, (unsigned long long)max_working_set);
  hf->unknown = host->alloc(ctx, hf->pairs, taps * sizeof *hf->unknown);
  hf->weight = host->alloc(ctx, hf->pairs, taps * sizeof *hf->weight);
  hf->sums = host->alloc(ctx, n, sizeof *hf->sums);
  hf->factor = host->alloc(ctx, n, n * sizeof *hf->factor);
  if (hf->unknown == NULL || hf->weight == NULL || hf->sums == NULL || hf->factor == NULL) return BTF_E_NOMEM;
  memset(hf->sums, 0, n * sizeof *hf->sums);
  copy_taps(g, hf);
  BTF_TRY(assemble(host, ctx, g, hf, lambda));
  return host->cholesky(ctx, hf->unknowns, hf->factor);
}

btf_status btfi_cmf_hf_create(const btf_host *host, btf_context *ctx, const btfi_cmf_hf_geometry *geometry,
                              double lambda, uint64_t max_working_set, btfi_cmf_hf **out) {
  *out = NULL;
  btfi_cmf_hf *hf = host->alloc(ctx, 1, sizeof *hf);
  if (hf == NULL) return BTF_E_NOMEM;
  memset(hf, 0, sizeof *hf);
  const btf_status status =
      build(host, ctx, geometry, lambda, max_working_set != 0 ? max_working_set : UINT64_C(1) << 30, hf);
  if (status == BTF_OK)
    *out = hf;
  else
    btfi_cmf_hf_free(host, ctx, hf);
  return status;
}

/* ---- texels ---- */

typedef struct hf_solve {
  const btfi_cmf_hf *hf;
  uint32_t channels, columns;
  const float *f;
  uint64_t f_step;
  double floor;
  double *right; /* unknowns x columns: right sides, then solutions */
  double *sums;  /* unknowns x channels for each thread */
  double *means; /* of the logarithms of each column; -infinity for one that is 0 */
  float *maps;
  uint64_t maps_step;
} hf_solve;

uint64_t btfi_cmf_hf_solve_bytes(const btf_host *host, btf_context *ctx, uint64_t unknowns, uint32_t texels,
                                 uint32_t channels) {
  return sizeof(double) * channels *
         ((texels + (uint64_t)host->thread_count(ctx)) * unknowns + (uint64_t)texels);
}

/* M^T (log f - mean): the mean is taken out and shared among the maps afterwards, so that all that the data
 * leave open stays near it. */
static void make_right_side(void *job, uint32_t texel, uint32_t thread) {
  const hf_solve *s = job;
  const btfi_cmf_hf *hf = s->hf;
  const uint32_t channels = s->channels, taps = 4 * hf->maps;
  const float *f = s->f + texel * s->f_step;
  double *sums = s->sums + (size_t)thread * hf->unknowns * channels,
         *means = s->means + (size_t)texel * channels;
  double largest = 0.0;
  memset(sums, 0, (size_t)hf->unknowns * channels * sizeof *sums);
  for (uint32_t c = 0; c < channels; c++) {
    double most = 0.0;
    for (uint32_t p = 0; p < hf->pairs; p++) most = fmax(most, (double)f[(size_t)hf->pair[p] * channels + c]);
    means[c] = most > 0.0 ? 0.0 : -INFINITY;
    largest = fmax(largest, most);
  }
  const double least = fmax(s->floor * fmin(largest, FLT_MAX), FLT_MIN);
  for (uint32_t p = 0; p < hf->pairs; p++) {
    const float *value = f + (size_t)hf->pair[p] * channels, *weight = hf->weight + (size_t)p * taps;
    const uint32_t *unknown = hf->unknown + (size_t)p * taps;
    for (uint32_t c = 0; c < channels; c++) {
      const double logarithm = log(fmin(fmax((double)value[c], least), FLT_MAX));
      means[c] += logarithm;
      for (uint32_t i = 0; i < taps; i++)
        sums[(size_t)unknown[i] * channels + c] += (double)weight[i] * logarithm;
    }
  }
  for (uint32_t c = 0; c < channels; c++) means[c] /= hf->pairs;
  for (uint32_t i = 0; i < hf->unknowns; i++) {
    double *right = s->right + (size_t)i * s->columns + (size_t)texel * channels;
    for (uint32_t c = 0; c < channels; c++)
      right[c] = means[c] > -INFINITY ? sums[(size_t)i * channels + c] - means[c] * hf->sums[i] : 0.0;
  }
}

static void write_maps(void *job, uint32_t texel, uint32_t thread) {
  const hf_solve *s = job;
  const btfi_cmf_hf *hf = s->hf;
  const uint32_t channels = s->channels;
  const double *means = s->means + (size_t)texel * channels;
  float *maps = s->maps + texel * s->maps_step;
  (void)thread;
  for (uint32_t i = 0; i < hf->texels; i++) {
    for (uint32_t c = 0; c < channels; c++) {
      float value = 0.0f;
      if (hf->place[i] != not_unknown && means[c] > -INFINITY) {
        const double x = s->right[(size_t)hf->place[i] * s->columns + (size_t)texel * channels + c];
        value = (float)exp(fmin(fmax(x + means[c] / hf->maps, -87.0), 88.0)); /* within normal floats */
      }
      maps[(size_t)i * channels + c] = value;
    }
  }
}

btf_status btfi_cmf_hf_solve(const btf_host *host, btf_context *ctx, const btfi_cmf_hf *hf, uint32_t texels,
                             uint32_t channels, const float *f, uint64_t f_step, double floor, float *maps,
                             uint64_t maps_step) {
  hf_solve s = {.hf = hf,
                .channels = channels,
                .columns = texels * channels,
                .f = f,
                .f_step = f_step,
                .floor = floor,
                .maps = maps,
                .maps_step = maps_step};
  btf_status status = BTF_E_NOMEM;
  s.right = host->alloc(ctx, hf->unknowns, s.columns * sizeof *s.right);
  s.sums = host->alloc(ctx, host->thread_count(ctx), (uint64_t)hf->unknowns * channels * sizeof *s.sums);
  s.means = host->alloc(ctx, s.columns, sizeof *s.means);
  if (s.right != NULL && s.sums != NULL && s.means != NULL)
    status = host->parallel(ctx, texels, make_right_side, &s);
  if (status == BTF_OK) status = host->cholesky_solve(ctx, hf->unknowns, hf->factor, s.columns, s.right);
  if (status == BTF_OK) status = host->parallel(ctx, texels, write_maps, &s);
  host->free(ctx, s.right);
  host->free(ctx, s.sums);
  host->free(ctx, s.means);
  return status;
}
