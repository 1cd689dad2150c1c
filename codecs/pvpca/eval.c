/* SPDX-License-Identifier: MIT */
/* eval.c: STAR eq. 20 and 21. The weights of 3 lights are blended first, for each of 3 views (eq. 20), the
 * eigen-textures of each of these views over 4 texels of 1 or 2 levels, then one dot product per channel. One
 * query and a batch run the same arithmetic in the same order. */
#include "pvpca.h"

#include <string.h>

#include <btf/btf_codec.h>
#include <btf/btf_sampling.h>

enum {
  BATCH = BTF_RUN_DIRECTIONS, /* queries located together */
  PREFETCH_AHEAD = 6,         /* queries between asking for texels and using them */
  RING = 8,                   /* taps alive; a power of two above PREFETCH_AHEAD */
  SCRATCH = 3 * PVPCA_MAX_CHANNELS * PVPCA_MAX_TERMS
};

/* ---- what a query touches ---- */

static void tap_directions(const btfi_pvpca_state *s, const btf_interp *light, const btf_interp *view,
                           btfi_pvpca_taps *t) {
  uint32_t lights = 0, views = 0, of_light[3];
  for (uint32_t i = 0; i < 3; i++) {
    of_light[lights] = light->index[i];
    t->light_weight[lights] = light->weight[i];
    lights += light->weight[i] != 0.0f;
  }
  for (uint32_t i = 0; i < 3; i++) {
    if (view->weight[i] == 0.0f) continue;
    const btfi_pvpca_view *of = &s->views[view->index[i]];
    btfi_pvpca_tap *tap = &t->view[views++];
    tap->scale = s->scales + of->padded_start;
    tap->terms = of->terms;
    tap->columns = of->columns;
    tap->weight = view->weight[i];
    tap->mean_weight = view->weight[i] * of->mean_scale;
    for (uint32_t k = 0; k < lights; k++)
      tap->g[k] = s->g + of->g_start + (uint64_t)of_light[k] * of->g_light_bytes;
  }
  t->lights = lights;
  t->views = views;
}

/* Texels of the views of t, in the order of its directions. */
static void tap_level(const btfi_pvpca_state *s, const btfi_pvpca_view *const *views, uint32_t level,
                      float level_weight, float u, float v, btfi_pvpca_taps *t) {
  const btfi_pvpca_layout *layout = &s->layout;
  const uint32_t width = layout->level_width[level];
  btf_bilinear at;
  btf_sampling_bilinear(u, v, width, layout->level_height[level], s->wrap, &at);
  for (uint32_t i = 0; i < 4; i++) {
    const float weight = level_weight * (at.wx[i & 1] * at.wy[i >> 1]);
    if (weight == 0.0f) continue;
    const uint64_t texel = (uint64_t)at.y[i >> 1] * width + at.x[i & 1];
    for (uint32_t k = 0; k < t->views; k++)
      t->view[k].h[t->texels] =
          s->h[level] + layout->level_texels[level] * views[k]->h_before + texel * views[k]->h_texel_bytes;
    t->texel_weight[t->texels++] = weight;
  }
}

static void tap_texels(const btfi_pvpca_state *s, const btfi_pvpca_view *const *views, float u, float v,
                       float lod, btfi_pvpca_taps *t) {
  btf_level_pair levels;
  btf_sampling_levels(lod, s->layout.levels, &levels);
  t->texels = 0;
  tap_level(s, views, levels.level[0], levels.weight[0], u, v, t);
  if (levels.weight[1] != 0.0f) tap_level(s, views, levels.level[1], levels.weight[1], u, v, t);
}

static void tap_sample(const btfi_pvpca_state *s, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                       uint32_t view, btfi_pvpca_taps *t) {
  const btfi_pvpca_layout *layout = &s->layout;
  const btfi_pvpca_view *of = &s->views[view];
  const uint64_t texel = (uint64_t)y * layout->level_width[level] + x;
  t->views = t->lights = t->texels = 1;
  t->light_weight[0] = t->texel_weight[0] = 1.0f;
  t->view[0] = (btfi_pvpca_tap){
      .g = {s->g + of->g_start + (uint64_t)light * of->g_light_bytes},
      .h = {s->h[level] + layout->level_texels[level] * of->h_before + texel * of->h_texel_bytes},
      .scale = s->scales + of->padded_start,
      .terms = of->terms,
      .columns = of->columns,
      .weight = 1.0f,
      .mean_weight = of->mean_scale};
  t->same_directions = false;
}

static void tap_nearest(const btfi_pvpca_state *s, const float light[3], const float view[3], float u,
                        float v, float lod, btfi_pvpca_taps *t) {
  const uint32_t level = btf_sampling_nearest_level(lod, s->layout.levels);
  tap_sample(s, level, btf_sampling_nearest(u, s->layout.level_width[level], s->wrap),
             btf_sampling_nearest(v, s->layout.level_height[level], s->wrap),
             s->host->dirset_nearest(s->light_set, light), s->host->dirset_nearest(s->view_set, view), t);
}

static void evaluate(const btfi_pvpca_state *s, const btfi_pvpca_taps *t, float *lambda, float *out) {
  if (!t->same_directions) s->weigh(t, s->layout.g_channels, s->layout.padded, lambda);
  s->shade(t, s->layout.channels, s->layout.padded, lambda, out);
}

/* ---- one query ---- */

/* The views with a weight, in the order of the taps. */
static void views_of(const btfi_pvpca_state *s, const btf_interp *view, const btfi_pvpca_view **out) {
  for (uint32_t i = 0, n = 0; i < 3; i++)
    if (view->weight[i] != 0.0f) out[n++] = &s->views[view->index[i]];
}

void btfi_pvpca_eval(const void *state, const btf_query *query, float *out) {
  const btfi_pvpca_state *s = state;
  float lambda[SCRATCH];
  btfi_pvpca_taps t;
  if (query->flags & BTF_QUERY_NEAREST) {
    tap_nearest(s, query->light, query->view, query->uv[0], query->uv[1], query->lod, &t);
  } else {
    const btfi_pvpca_view *views[3];
    btf_interp light, view;
    s->host->dirset_locate(s->light_set, query->light, &light);
    s->host->dirset_locate(s->view_set, query->view, &view);
    tap_directions(s, &light, &view, &t);
    views_of(s, &view, views);
    tap_texels(s, views, query->uv[0], query->uv[1], query->lod, &t);
    t.same_directions = false;
  }
  evaluate(s, &t, lambda, out);
}

void btfi_pvpca_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                      uint32_t view, float *out) {
  float lambda[SCRATCH];
  btfi_pvpca_taps t;
  tap_sample(state, level, x, y, light, view, &t);
  evaluate(state, &t, lambda, out);
}

/* ---- batches ---- */

/* A batch on its way: directions are located BATCH queries at a time, taps made one by one, PREFETCH_AHEAD
 * queries before they are used. */
typedef struct batch_front {
  const btfi_pvpca_state *state;
  const btf_batch *batch;
  size_t first;   /* query of the first located direction */
  size_t located; /* end of them */
  uint8_t light_run[BATCH], view_run[BATCH];
  btf_interp light[BATCH], view[BATCH];
} batch_front;

static void locate_more(batch_front *front) {
  const btf_batch *batch = front->batch;
  const size_t left = batch->count - front->located;
  const uint32_t count = left < BATCH ? (uint32_t)left : (uint32_t)BATCH;
  front->first = front->located;
  front->located += count;
  btf_locate_runs(front->state->host, front->state->light_set, batch->light, front->first, count,
                  front->light_run, front->light);
  btf_locate_runs(front->state->host, front->state->view_set, batch->view, front->first, count,
                  front->view_run, front->view);
}

/* Into the second level of the cache: the first is too small for the texels of several queries. */
static void prefetch_texels(const btfi_pvpca_state *s, const btfi_pvpca_taps *t) {
  for (uint32_t k = 0; k < t->views; k++) {
    const uint32_t bytes = s->layout.h_channels * t->view[k].columns * s->layout.h_bytes_value;
    for (uint32_t r = 0; r < t->texels; r++) {
      const unsigned char *row = t->view[k].h[r], *const last = row + (bytes > 0 ? bytes - 1 : 0);
      for (; row < last; row += 64) __builtin_prefetch(row, 0, 2);
      __builtin_prefetch(last, 0, 2);
    }
  }
}

/* Finds the rows of query q and asks for them unless they are where those of the query before were. */
static void tap_query(batch_front *front, size_t q, btfi_pvpca_taps *ring) {
  const btfi_pvpca_state *s = front->state;
  const btf_batch *batch = front->batch;
  const float u = batch->uv[0][q], v = batch->uv[1][q], lod = batch->lod != NULL ? batch->lod[q] : 0.0f;
  const btfi_pvpca_taps *before = &ring[(q + RING - 1) % RING]; /* of query 0: zeros */
  btfi_pvpca_taps *t = &ring[q % RING];
  if (batch->flags & BTF_QUERY_NEAREST) {
    const float light[3] = {batch->light[0][q], batch->light[1][q], batch->light[2][q]};
    const float view[3] = {batch->view[0][q], batch->view[1][q], batch->view[2][q]};
    tap_nearest(s, light, view, u, v, lod, t);
  } else {
    const btfi_pvpca_view *views[3];
    if (q == front->located) locate_more(front);
    const size_t i = q - front->first;
    const uint8_t *const light_run = front->light_run + i, *const view_run = front->view_run + i;
    const btf_interp *const view = &front->view[view_run[0]];
    const bool same = i > 0 && light_run[0] == light_run[-1] && view_run[0] == view_run[-1];
    if (same)
      *t = *before;
    else
      tap_directions(s, &front->light[light_run[0]], view, t);
    t->same_directions = same;
    views_of(s, view, views);
    tap_texels(s, views, u, v, lod, t);
  }
  if (t->view[0].h[0] != before->view[0].h[0]) prefetch_texels(s, t);
}

void btfi_pvpca_eval_n(const void *state, const btf_batch *batch, float *const *out) {
  const btfi_pvpca_state *s = state;
  float lambda[SCRATCH], values[PVPCA_MAX_CHANNELS];
  btfi_pvpca_taps ring[RING];
  memset(&ring[RING - 1], 0, sizeof ring[RING - 1]);
  batch_front front = {.state = s, .batch = batch};
  size_t tapped = 0;
  for (size_t q = 0; q < batch->count; q++) {
    for (; tapped < batch->count && tapped <= q + PREFETCH_AHEAD; tapped++) tap_query(&front, tapped, ring);
    evaluate(s, &ring[q % RING], lambda, values);
    for (uint32_t c = 0; c < s->layout.channels; c++) out[c][q] = values[c];
  }
}
