/* SPDX-License-Identifier: MIT */
/* eval.c: the texels around a query, each evaluated for the query's own directions, then blended. Lobes are
 * functions of the directions: nothing is interpolated between measured ones. One query and a batch run the
 * same arithmetic. */
#include "lafortune.h"

#include <string.h>

#include <btf/btf_sampling.h>

enum { BATCH = 16 /* queries whose taps are made before they are evaluated */ };

typedef struct place {
  float u, v, lod;
} place;

static inline void tap(const btfi_lafortune_state *s, uint32_t level, const uint32_t x[2],
                       const uint32_t y[2], btfi_lafortune_taps *taps) {
  const uint64_t bytes = (uint64_t)s->layout.values * s->layout.value_bytes;
  const unsigned char *const line0 = s->texels[level] + y[0] * (s->level_width[level] * bytes),
                             *const line1 = s->texels[level] + y[1] * (s->level_width[level] * bytes);
  const unsigned char *const end = s->safe_end[level];
  taps->texel[0] = line0 + x[0] * bytes;
  taps->texel[1] = line0 + x[1] * bytes;
  taps->texel[2] = line1 + x[0] * bytes;
  taps->texel[3] = line1 + x[1] * bytes;
  taps->near_end =
      (taps->texel[0] >= end) | (taps->texel[1] >= end) | (taps->texel[2] >= end) | (taps->texel[3] >= end);
}

static inline void tap_one(const btfi_lafortune_state *s, uint32_t level, uint32_t x, uint32_t y,
                           btfi_lafortune_taps *taps) {
  const uint32_t xs[2] = {x, x}, ys[2] = {y, y};
  tap(s, level, xs, ys, taps);
  memset(taps->weight, 0, sizeof taps->weight);
  taps->weight[0] = s->scale[level];
}

static inline void tap_level(const btfi_lafortune_state *s, uint32_t level, float level_weight,
                             const place *at, btfi_lafortune_taps *taps) {
  const float weight = level_weight * s->scale[level];
  btf_bilinear texels;
  btf_sampling_bilinear(at->u, at->v, s->level_width[level], s->level_height[level], s->wrap, &texels);
  tap(s, level, texels.x, texels.y, taps);
  for (uint32_t i = 0; i < 4; i++) taps->weight[i] = weight * (texels.wx[i & 1] * texels.wy[i >> 1]);
}

static inline void make_terms(const btfi_lafortune_state *s, const float light[3], const float view[3],
                              btfi_lafortune_terms *out) {
  if (s->layout.kind != LAF_DIAGONAL) {
    btfi_lafortune_terms_of(s->layout.kind, s->times_cosine, light, view, out);
    return;
  }
  for (int i = 0; i < 3; i++) out->term[i] = view[i] * light[i];
  out->diffuse = out->lobe = s->times_cosine ? light[2] : 1.0f;
}

/* The directions of the nearest samples and the nearest texel. */
static void tap_nearest(const btfi_lafortune_state *s, const float light[3], const float view[3],
                        const place *at, btfi_lafortune_taps *taps) {
  const uint32_t l = s->host->dirset_nearest(s->light_set, light),
                 v = s->host->dirset_nearest(s->view_set, view);
  const uint32_t level = btf_sampling_nearest_level(at->lod, s->levels);
  make_terms(s, s->host->dirset_directions(s->light_set) + 3 * (size_t)l,
             s->host->dirset_directions(s->view_set) + 3 * (size_t)v, &taps->terms);
  tap_one(s, level, btf_sampling_nearest(at->u, s->level_width[level], s->wrap),
          btf_sampling_nearest(at->v, s->level_height[level], s->wrap), taps);
}

/* Taps of the finer level. */
static inline void tap_finer(const btfi_lafortune_state *s, const float light[3], const float view[3],
                             const place *at, btf_level_pair *levels, btfi_lafortune_taps *taps) {
  btf_sampling_levels(at->lod, s->levels, levels);
  make_terms(s, light, view, &taps->terms);
  tap_level(s, levels->level[0], levels->weight[0], at, taps);
}

static inline void add_coarser(const btfi_lafortune_state *s, const place *at, const btf_level_pair *levels,
                               btfi_lafortune_taps *taps, float *out) {
  if (levels->weight[1] == 0.0f) return;
  tap_level(s, levels->level[1], levels->weight[1], at, taps);
  s->kernels->eval(s, taps, 1, true, out);
}

void btfi_lafortune_eval(const void *state, const btf_query *query, float *out) {
  const btfi_lafortune_state *s = state;
  const place at = {query->uv[0], query->uv[1], query->lod};
  btfi_lafortune_taps taps;
  btf_level_pair levels = {{0, 0}, {1.0f, 0.0f}};
  if (query->flags & BTF_QUERY_NEAREST)
    tap_nearest(s, query->light, query->view, &at, &taps);
  else
    tap_finer(s, query->light, query->view, &at, &levels, &taps);
  s->kernels->eval(s, &taps, 1, false, out);
  add_coarser(s, &at, &levels, &taps, out);
}

void btfi_lafortune_eval_n(const void *state, const btf_batch *batch, float *const *out) {
  const btfi_lafortune_state *s = state;
  const uint32_t channels = s->layout.channels;
  btfi_lafortune_taps taps[BATCH];
  btf_level_pair levels[BATCH];
  place at[BATCH];
  float values[BATCH * LAF_MAX_CHANNELS];
  for (size_t first = 0; first < batch->count; first += BATCH) {
    const uint32_t n = batch->count - first < BATCH ? (uint32_t)(batch->count - first) : BATCH;
    for (uint32_t i = 0; i < n; i++) {
      const size_t q = first + i;
      const float light[3] = {batch->light[0][q], batch->light[1][q], batch->light[2][q]};
      const float view[3] = {batch->view[0][q], batch->view[1][q], batch->view[2][q]};
      at[i] = (place){batch->uv[0][q], batch->uv[1][q], batch->lod != NULL ? batch->lod[q] : 0.0f};
      levels[i].weight[1] = 0.0f;
      if (batch->flags & BTF_QUERY_NEAREST)
        tap_nearest(s, light, view, &at[i], &taps[i]);
      else
        tap_finer(s, light, view, &at[i], &levels[i], &taps[i]);
    }
    s->kernels->eval(s, taps, n, false, values);
    for (uint32_t i = 0; i < n; i++) add_coarser(s, &at[i], &levels[i], &taps[i], values + i * channels);
    for (uint32_t c = 0; c < channels; c++)
      for (uint32_t i = 0; i < n; i++) out[c][first + i] = values[i * channels + c];
  }
}

void btfi_lafortune_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                          uint32_t view, float *out) {
  const btfi_lafortune_state *s = state;
  btfi_lafortune_taps taps;
  make_terms(s, s->host->dirset_directions(s->light_set) + 3 * (size_t)light,
             s->host->dirset_directions(s->view_set) + 3 * (size_t)view, &taps.terms);
  tap_one(s, level, x, y, &taps);
  s->kernels->eval(s, &taps, 1, false, out);
}
