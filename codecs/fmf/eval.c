/* SPDX-License-Identifier: MIT */
/* eval.c: Schwartz 2013, eq. 5: rows of U blended over 3 views x 3 lights, rows of V over 4 texels of 1 or 2
 * levels, then one dot product per channel. One query and a batch run the same arithmetic in the same order.
 */
#include "fmf.h"

#include <string.h>

#include <btf/btf_sampling.h>

enum {
  BATCH = BTF_RUN_DIRECTIONS,   /* queries located together */
  PREFETCH_AHEAD = 6,           /* queries between asking for rows and using them */
  RING = 8,                     /* taps alive; a power of two above PREFETCH_AHEAD */
  SCRATCH = 8 * FMF_MAX_COLUMNS /* floats for blended rows of U that several queries share */
};

/* The rows that one query blends. Those of weight 0 are left out. */
typedef struct taps {
  btfi_fmf_rows u, v;
  bool same_u; /* directions are those of the query before, bit for bit */
} taps;

void btfi_fmf_state_ready(btfi_fmf_state *state, const btf_host *host, btf_context *ctx,
                          const btf_model_shape *shape, const float *scale) {
  const btfi_fmf_layout *layout = &state->layout;
  const btfi_fmf_kernels *kernels = btfi_fmf_kernels_of(host->isa(ctx));
  state->host = host;
  state->light_set = shape->lights;
  state->view_set = shape->views;
  state->wrap = shape->wrap;
  state->blend = kernels->blend[layout->storage];
  state->project = kernels->project[layout->storage];
  state->sample = kernels->sample[layout->storage];
  state->dot = kernels->dot;
  state->channel_bytes = (uint64_t)layout->stride * btfi_fmf_value_bytes(layout->storage);
  state->can_keep = (uint64_t)layout->channels * layout->padded <= SCRATCH;
  memset(state->column_scale, 0, sizeof state->column_scale);
  memcpy(state->column_scale, scale, layout->columns * sizeof *scale);
  kernels->permute(layout->storage, layout->padded, state->column_scale, state->scale);
}

static const unsigned char *u_row(const btfi_fmf_state *s, uint32_t light, uint32_t view) {
  return s->u + ((uint64_t)view * s->layout.lights + light) * s->layout.u_row_bytes;
}

static const unsigned char *v_row(const btfi_fmf_state *s, uint32_t level, uint32_t x, uint32_t y) {
  return s->v[level] + y * s->layout.v_line_bytes[level] + x * s->layout.v_texel_bytes;
}

static void tap_directions(const btfi_fmf_state *s, const btf_interp *light, const btf_interp *view,
                           taps *t) {
  const uint64_t row_bytes = s->layout.u_row_bytes, view_bytes = row_bytes * s->layout.lights;
  const unsigned char *const of_light[3] = {s->u + light->index[0] * row_bytes,
                                            s->u + light->index[1] * row_bytes,
                                            s->u + light->index[2] * row_bytes};
  uint32_t count = 0;
  for (uint32_t j = 0; j < 3; j++) {
    if (view->weight[j] == 0.0f) continue;
    for (uint32_t i = 0; i < 3; i++) {
      t->u.row[count] = of_light[i] + view->index[j] * view_bytes;
      t->u.weight[count] = view->weight[j] * light->weight[i];
      count += light->weight[i] != 0.0f;
    }
  }
  t->u.count = count;
}

static void tap_level(const btfi_fmf_state *s, uint32_t level, float level_weight, float u, float v,
                      taps *t) {
  const unsigned char *const rows = s->v[level];
  const uint64_t line_bytes = s->layout.v_line_bytes[level], texel_bytes = s->layout.v_texel_bytes;
  uint32_t count = t->v.count;
  btf_bilinear texels;
  btf_sampling_bilinear(u, v, s->layout.level_width[level], s->layout.level_height[level], s->wrap, &texels);
  for (uint32_t i = 0; i < 4; i++) {
    const float weight = level_weight * (texels.wx[i & 1] * texels.wy[i >> 1]);
    t->v.row[count] = rows + texels.y[i >> 1] * line_bytes + texels.x[i & 1] * texel_bytes;
    t->v.weight[count] = weight;
    count += weight != 0.0f;
  }
  t->v.count = count;
}

static void tap_texels(const btfi_fmf_state *s, float u, float v, float lod, taps *t) {
  btf_level_pair levels;
  btf_sampling_levels(lod, s->layout.levels, &levels);
  t->v.count = 0;
  tap_level(s, levels.level[0], levels.weight[0], u, v, t);
  if (levels.weight[1] != 0.0f) tap_level(s, levels.level[1], levels.weight[1], u, v, t);
}

static void tap_sample(const btfi_fmf_state *s, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                       uint32_t view, taps *t) {
  t->u.row[0] = u_row(s, light, view);
  t->v.row[0] = v_row(s, level, x, y);
  t->u.weight[0] = t->v.weight[0] = 1.0f;
  t->u.count = t->v.count = 1;
  t->same_u = false;
}

static void tap_nearest(const btfi_fmf_state *s, const float light[3], const float view[3], float u, float v,
                        float lod, taps *t) {
  const uint32_t level = btf_sampling_nearest_level(lod, s->layout.levels);
  tap_sample(s, level, btf_sampling_nearest(u, s->layout.level_width[level], s->wrap),
             btf_sampling_nearest(v, s->layout.level_height[level], s->wrap),
             s->host->dirset_nearest(s->light_set, light), s->host->dirset_nearest(s->view_set, view), t);
}

static void prefetch_row(const unsigned char *row, uint64_t bytes) {
  const unsigned char *end = row + bytes;
  /* Into the second level: the first is too small for the rows of several queries. */
  for (row -= (uintptr_t)row % 64; row < end; row += 64) __builtin_prefetch(row, 0, 2);
}

static void prefetch_rows(const btfi_fmf_rows *rows, uint64_t bytes) {
  for (uint32_t i = 0; i < rows->count; i++) prefetch_row(rows->row[i], bytes);
}

static bool is_sample(const taps *t) {
  return t->u.count == 1 && t->v.count == 1 && t->u.weight[0] == 1.0f && t->v.weight[0] == 1.0f;
}

static void evaluate_sample(const btfi_fmf_state *s, const taps *t, float *out) {
  s->sample(t->u.row[0], s->channel_bytes, s->layout.channels, t->v.row[0], s->layout.padded, s->scale, out);
}

static void evaluate(const btfi_fmf_state *s, const taps *t, float *out) {
  if (is_sample(t)) {
    evaluate_sample(s, t, out);
    return;
  }
  _Alignas(64) float v[FMF_MAX_COLUMNS];
  s->blend(&t->v, s->layout.padded, s->scale, v);
  s->project(&t->u, s->channel_bytes, s->layout.channels, v, s->layout.padded, NULL, out);
}

void btfi_fmf_eval(const void *state, const btf_query *query, float *out) {
  const btfi_fmf_state *s = state;
  taps t;
  if (query->flags & BTF_QUERY_NEAREST) {
    tap_nearest(s, query->light, query->view, query->uv[0], query->uv[1], query->lod, &t);
  } else {
    btf_interp light, view;
    s->host->dirset_locate(s->light_set, query->light, &light);
    s->host->dirset_locate(s->view_set, query->view, &view);
    tap_directions(s, &light, &view, &t);
    tap_texels(s, query->uv[0], query->uv[1], query->lod, &t);
    t.same_u = false;
  }
  prefetch_rows(&t.u, s->layout.u_data_bytes);
  prefetch_rows(&t.v, s->layout.v_texel_bytes);
  evaluate(s, &t, out);
}

void btfi_fmf_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                    float *out) {
  taps t;
  tap_sample(state, level, x, y, light, view, &t);
  evaluate(state, &t, out);
}

/* ---- batches ---- */

/* A batch on its way: directions are located BATCH queries at a time, taps made one by one, PREFETCH_AHEAD
 * queries before they are used. */
typedef struct batch_front {
  const btfi_fmf_state *state;
  const btf_batch *batch;
  size_t first;   /* query of the first located direction */
  size_t located; /* end of them */
  uint8_t light_run[BATCH], view_run[BATCH];
  btf_interp light[BATCH], view[BATCH];
} batch_front;

static void locate_more(batch_front *front) {
  const btfi_fmf_state *s = front->state;
  const btf_batch *batch = front->batch;
  const size_t left = batch->count - front->located;
  const uint32_t count = left < BATCH ? (uint32_t)left : (uint32_t)BATCH;
  front->first = front->located;
  front->located += count;
  btf_locate_runs(s->host, s->light_set, batch->light, front->first, count, front->light_run, front->light);
  btf_locate_runs(s->host, s->view_set, batch->view, front->first, count, front->view_run, front->view);
}

static bool same_indices(const btf_interp *a, const btf_interp *b) {
  return a->index[0] == b->index[0] && a->index[1] == b->index[1] && a->index[2] == b->index[2];
}

/* Finds the rows of query q and asks for them unless the query before had the same. */
static void tap_query(batch_front *front, size_t q, taps *ring) {
  const btfi_fmf_state *s = front->state;
  const btf_batch *batch = front->batch;
  const float u = batch->uv[0][q], v = batch->uv[1][q], lod = batch->lod != NULL ? batch->lod[q] : 0.0f;
  const taps *before = &ring[(q + RING - 1) % RING]; /* of query 0: zeros */
  taps *t = &ring[q % RING];
  bool known_u = false;
  if (batch->flags & BTF_QUERY_NEAREST) {
    const float light[3] = {batch->light[0][q], batch->light[1][q], batch->light[2][q]};
    const float view[3] = {batch->view[0][q], batch->view[1][q], batch->view[2][q]};
    tap_nearest(s, light, view, u, v, lod, t);
    known_u = t->u.row[0] == before->u.row[0];
  } else {
    if (q == front->located) locate_more(front);
    const size_t i = q - front->first;
    const uint8_t *const light_run = front->light_run + i, *const view_run = front->view_run + i;
    t->same_u = i > 0 && light_run[0] == light_run[-1] && view_run[0] == view_run[-1];
    if (t->same_u) {
      t->u = before->u;
      known_u = true;
    } else {
      tap_directions(s, &front->light[light_run[0]], &front->view[view_run[0]], t);
      known_u = i > 0 && same_indices(&front->light[light_run[0]], &front->light[light_run[-1]]) &&
                same_indices(&front->view[view_run[0]], &front->view[view_run[-1]]);
    }
    tap_texels(s, u, v, lod, t);
  }
  if (!known_u) prefetch_rows(&t->u, s->layout.u_data_bytes);
  if (t->v.row[0] != before->v.row[0]) prefetch_rows(&t->v, s->layout.v_texel_bytes);
}

void btfi_fmf_eval_n(const void *state, const btf_batch *batch, float *const *out) {
  const btfi_fmf_state *s = state;
  const uint32_t channels = s->layout.channels, padded = s->layout.padded;
  _Alignas(64) float kept[SCRATCH], v[FMF_MAX_COLUMNS];
  float values[FMF_MAX_CHANNELS];
  taps ring[RING];
  memset(&ring[RING - 1], 0, sizeof ring[RING - 1]);
  batch_front front = {.state = s, .batch = batch};
  size_t tapped = 0;
  for (size_t q = 0; q < batch->count; q++) {
    const taps *t = &ring[q % RING];
    for (; tapped < batch->count && tapped <= q + PREFETCH_AHEAD; tapped++) tap_query(&front, tapped, ring);
    if (batch->flags & BTF_QUERY_NEAREST) {
      evaluate_sample(s, t, values);
      for (uint32_t c = 0; c < channels; c++) out[c][q] = values[c];
      continue;
    }
    s->blend(&t->v, padded, s->scale, v);
    if (t->same_u && s->can_keep) {
      s->dot(kept, channels, v, padded, values);
    } else {
      const bool shared = q + 1 < batch->count && ring[(q + 1) % RING].same_u && s->can_keep;
      s->project(&t->u, s->channel_bytes, channels, v, padded, shared ? kept : NULL, values);
    }
    for (uint32_t c = 0; c < channels; c++) out[c][q] = values[c];
  }
}
