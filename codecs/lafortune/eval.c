/* SPDX-License-Identifier: MIT */
/* eval.c: the texels around a query, each evaluated for the query's own directions, then blended. Lobes are
 * functions of the directions: nothing is interpolated between measured ones. */
#include "lafortune.h"

#include <string.h>

#include <btf/btf_sampling.h>

static void tap(const btfi_lafortune_state *s, uint32_t level, uint32_t x, uint32_t y, float weight,
                btfi_lafortune_taps *taps, uint32_t i) {
  const uint64_t bytes = (uint64_t)s->layout.values * s->layout.value_bytes;
  const unsigned char *const texel =
      s->texels[level] + ((uint64_t)y * btf_sampling_level_size(s->width, level) + x) * bytes;
  taps->texel[i] = texel;
  taps->weight[i] = weight;
  taps->near_end[i] = texel >= s->safe_end[level];
}

static void tap_one(const btfi_lafortune_state *s, uint32_t level, uint32_t x, uint32_t y,
                    btfi_lafortune_taps *taps) {
  for (uint32_t i = 0; i < 4; i++) tap(s, level, x, y, i == 0 ? s->scale[level] : 0.0f, taps, i);
}

static void eval_level(const btfi_lafortune_state *s, const btfi_lafortune_terms *terms, uint32_t level,
                       float level_weight, float u, float v, float *out) {
  const float weight = level_weight * s->scale[level];
  btfi_lafortune_taps taps;
  btf_bilinear at;
  btf_sampling_bilinear(u, v, btf_sampling_level_size(s->width, level),
                        btf_sampling_level_size(s->height, level), s->wrap, &at);
  for (uint32_t i = 0; i < 4; i++)
    tap(s, level, at.x[i & 1], at.y[i >> 1], weight * (at.wx[i & 1] * at.wy[i >> 1]), &taps, i);
  s->kernels->eval(s, terms, &taps, out);
}

static inline void evaluate(const btfi_lafortune_state *s, const float light[3], const float view[3], float u,
                            float v, float lod, uint32_t flags, float *out) {
  btfi_lafortune_terms terms;
  btfi_lafortune_terms_of(s->layout.kind, s->times_cosine, light, view, &terms);
  for (uint32_t c = 0; c < s->layout.channels; c++) out[c] = 0.0f;
  if (flags & BTF_QUERY_NEAREST) {
    const uint32_t level = btf_sampling_nearest_level(lod, s->levels);
    btfi_lafortune_taps taps;
    tap_one(s, level, btf_sampling_nearest(u, btf_sampling_level_size(s->width, level), s->wrap),
            btf_sampling_nearest(v, btf_sampling_level_size(s->height, level), s->wrap), &taps);
    s->kernels->eval(s, &terms, &taps, out);
    return;
  }
  btf_level_pair pair;
  btf_sampling_levels(lod, s->levels, &pair);
  eval_level(s, &terms, pair.level[0], pair.weight[0], u, v, out);
  if (pair.weight[1] != 0.0f) eval_level(s, &terms, pair.level[1], pair.weight[1], u, v, out);
}

/* With BTF_QUERY_NEAREST the directions are those of the nearest samples, as of every codec. */
static void nearest_directions(const btfi_lafortune_state *s, float light[3], float view[3]) {
  const uint32_t l = s->host->dirset_nearest(s->light_set, light),
                 v = s->host->dirset_nearest(s->view_set, view);
  memcpy(light, s->host->dirset_directions(s->light_set) + 3 * (size_t)l, 3 * sizeof *light);
  memcpy(view, s->host->dirset_directions(s->view_set) + 3 * (size_t)v, 3 * sizeof *view);
}

void btfi_lafortune_eval(const void *state, const btf_query *query, float *out) {
  float light[3], view[3];
  memcpy(light, query->light, sizeof light);
  memcpy(view, query->view, sizeof view);
  if (query->flags & BTF_QUERY_NEAREST) nearest_directions(state, light, view);
  evaluate(state, light, view, query->uv[0], query->uv[1], query->lod, query->flags, out);
}

void btfi_lafortune_eval_n(const void *state, const btf_batch *batch, float *const *out) {
  const btfi_lafortune_state *s = state;
  const uint32_t channels = s->layout.channels;
  float values[LAF_MAX_CHANNELS];
  for (size_t q = 0; q < batch->count; q++) {
    float light[3] = {batch->light[0][q], batch->light[1][q], batch->light[2][q]};
    float view[3] = {batch->view[0][q], batch->view[1][q], batch->view[2][q]};
    if (batch->flags & BTF_QUERY_NEAREST) nearest_directions(s, light, view);
    evaluate(s, light, view, batch->uv[0][q], batch->uv[1][q], batch->lod != NULL ? batch->lod[q] : 0.0f,
             batch->flags, values);
    for (uint32_t c = 0; c < channels; c++) out[c][q] = values[c];
  }
}

void btfi_lafortune_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                          uint32_t view, float *out) {
  const btfi_lafortune_state *s = state;
  btfi_lafortune_terms terms;
  btfi_lafortune_taps taps;
  btfi_lafortune_terms_of(s->layout.kind, s->times_cosine,
                          s->host->dirset_directions(s->light_set) + 3 * (size_t)light,
                          s->host->dirset_directions(s->view_set) + 3 * (size_t)view, &terms);
  tap_one(s, level, x, y, &taps);
  for (uint32_t c = 0; c < s->layout.channels; c++) out[c] = 0.0f;
  s->kernels->eval(s, &terms, &taps, out);
}
