/* SPDX-License-Identifier: MIT */
/* eval.c: STAR eq. 13 at each texel around a query, then the colours blended: weights of different clusters
 * have nothing in common. One query and a batch run the same arithmetic in the same order. */
#include "lpca.h"

#include <string.h>

#include <btf/btf_sampling.h>

enum {
  BATCH = BTF_RUN_DIRECTIONS, /* queries located together */
  PREFETCH_AHEAD = 4,         /* queries between asking for rows and using them */
  RING = 8                    /* taps alive; a power of two above PREFETCH_AHEAD */
};

/* Two rows of texels and their weights: all queries of a scan line share them. */
typedef struct texel_rows {
  float v;
  uint32_t level, y[2];
  float weight[2];
} texel_rows;

static uint32_t cluster_of(const btfi_lpca_state *s, uint32_t level, uint64_t texel) {
  const unsigned char *index = s->index[level] + texel * s->layout.index_bytes;
  return s->layout.index_bytes == 1 ? index[0] : index[0] | (uint32_t)index[1] << 8;
}

static void tap_texel(const btfi_lpca_state *s, uint32_t level, uint64_t texel, float weight,
                      btfi_lpca_taps *t) {
  t->cluster[t->texels] = cluster_of(s, level, texel);
  t->weights[t->texels] = s->weights[level] + texel * s->layout.texel_bytes;
  t->texel_weight[t->texels] = weight;
}

static void tap_nearest(const btfi_lpca_state *s, const float uv[2], float lod, btfi_lpca_taps *t) {
  const btfi_lpca_layout *l = &s->layout;
  const uint32_t level = btf_sampling_nearest_level(lod, l->levels);
  const uint32_t x = btf_sampling_nearest(uv[0], l->level_width[level], s->wrap);
  const uint32_t y = btf_sampling_nearest(uv[1], l->level_height[level], s->wrap);
  memset(t->texel_weight, 0, sizeof t->texel_weight);
  t->texels = 0;
  tap_texel(s, level, (uint64_t)y * l->level_width[level] + x, 1.0f, t);
  t->texels = 1;
}

/* The texels of btf_sampling_texels, in its order. */
static inline __attribute__((always_inline)) void tap_texels(const btfi_lpca_state *s, const float uv[2],
                                                             float lod, texel_rows *rows, btfi_lpca_taps *t) {
  const btfi_lpca_layout *l = &s->layout;
  btf_level_pair pair;
  btf_sampling_levels(lod, l->levels, &pair);
  memset(t->texel_weight, 0, sizeof t->texel_weight);
  t->texels = 0;
  for (uint32_t k = 0; k < 2; k++) {
    const uint32_t level = pair.level[k], width = l->level_width[level];
    uint32_t x[2];
    float wx[2];
    if (!(pair.weight[k] > 0.0f)) continue;
    if (rows->level != level || memcmp(&rows->v, &uv[1], sizeof(float)) != 0) {
      btf_sampling_linear(uv[1], l->level_height[level], s->wrap, rows->y, rows->weight);
      rows->level = level;
      rows->v = uv[1];
    }
    btf_sampling_linear(uv[0], width, s->wrap, x, wx);
    for (uint32_t i = 0; i < 4; i++) {
      const float weight = pair.weight[k] * (rows->weight[i / 2] * wx[i % 2]);
      tap_texel(s, level, (uint64_t)rows->y[i / 2] * width + x[i % 2], weight, t);
      t->texels += weight > 0.0f; /* or the next takes its place */
    }
  }
}

static void tap_row(const btfi_lpca_state *s, uint32_t light, uint32_t view, btfi_lpca_taps *t) {
  t->row[0] = ((uint64_t)view * s->layout.lights + light) * s->layout.row_bytes;
  t->row_weight[0] = 1.0f;
  t->rows = 1;
}

static void tap_directions(const btfi_lpca_state *s, const btf_interp *light, const btf_interp *view,
                           btfi_lpca_taps *t) {
  const uint64_t row_bytes = s->layout.row_bytes, view_bytes = row_bytes * s->layout.lights;
  uint32_t count = 0;
  for (uint32_t j = 0; j < 3; j++)
    for (uint32_t i = 0; i < 3; i++) {
      t->row[count] = light->index[i] * row_bytes + view->index[j] * view_bytes;
      t->row_weight[count] = view->weight[j] * light->weight[i];
      count += (view->weight[j] != 0.0f) & (light->weight[i] != 0.0f);
    }
  t->rows = count;
}

void btfi_lpca_eval(const void *state, const btf_query *query, float *out) {
  const btfi_lpca_state *s = state;
  btfi_lpca_taps t = {.texels = 0};
  if ((query->flags & BTF_QUERY_NEAREST) != 0) {
    tap_nearest(s, query->uv, query->lod, &t);
    tap_row(s, s->host->dirset_nearest(s->light_set, query->light),
            s->host->dirset_nearest(s->view_set, query->view), &t);
  } else {
    texel_rows rows = {.level = UINT32_MAX};
    btf_interp light, view;
    tap_texels(s, query->uv, query->lod, &rows, &t);
    s->host->dirset_locate(s->light_set, query->light, &light);
    s->host->dirset_locate(s->view_set, query->view, &view);
    tap_directions(s, &light, &view, &t);
  }
  s->shade(s, &t, out);
}

void btfi_lpca_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                     float *out) {
  const btfi_lpca_state *s = state;
  btfi_lpca_taps t = {.texels = 0};
  tap_texel(s, level, (uint64_t)y * s->layout.level_width[level] + x, 1.0f, &t);
  t.texels = 1;
  tap_row(s, light, view, &t);
  s->shade(s, &t, out);
}

/* ---- batches ---- */

/* A batch on its way: directions are located BATCH queries at a time, taps are made one by one,
 * PREFETCH_AHEAD queries before they are used. */
typedef struct batch_front {
  const btfi_lpca_state *state;
  const btf_batch *batch;
  size_t first, located; /* queries whose directions are known: first .. located - 1 */
  texel_rows rows;
  uint64_t asked; /* bit k % 64: the rows at hand have been asked for in a cluster k */
  uint8_t light_run[BATCH], view_run[BATCH];
  btf_interp light[BATCH], view[BATCH];
} batch_front;

static void locate_more(batch_front *front) {
  const btfi_lpca_state *s = front->state;
  const size_t left = front->batch->count - front->located;
  const uint32_t count = left < BATCH ? (uint32_t)left : (uint32_t)BATCH;
  front->first = front->located;
  front->located += count;
  btf_locate_runs(s->host, s->light_set, front->batch->light, front->first, count, front->light_run,
                  front->light);
  btf_locate_runs(s->host, s->view_set, front->batch->view, front->first, count, front->view_run,
                  front->view);
}

/* Into the second level of the cache: the first is too small for the rows of several queries. Rows that
 * queries just before have asked for are on their way. */
static void prefetch(batch_front *front, const btfi_lpca_taps *t, bool rows_are_new) {
  const btfi_lpca_state *s = front->state;
  const uint64_t row_bytes = s->layout.row_data_bytes;
  if (rows_are_new) front->asked = 0;
  for (uint32_t i = 0; i < t->texels; i++) {
    const uint64_t bit = UINT64_C(1) << t->cluster[i] % 64;
    __builtin_prefetch(t->weights[i], 0, 2);
    if ((front->asked & bit) != 0) continue;
    front->asked |= bit;
    const unsigned char *factors = s->factors + t->cluster[i] * s->layout.cluster_bytes;
    for (uint32_t r = 0; r < t->rows; r++) {
      __builtin_prefetch(factors + t->row[r], 0, 2);
      for (uint64_t at = 64; at < row_bytes; at += 64) __builtin_prefetch(factors + t->row[r] + at, 0, 2);
    }
  }
}

static void tap_query(batch_front *front, size_t q, btfi_lpca_taps *ring) {
  const btfi_lpca_state *s = front->state;
  const btf_batch *batch = front->batch;
  const float uv[2] = {batch->uv[0][q], batch->uv[1][q]}, lod = batch->lod != NULL ? batch->lod[q] : 0.0f;
  const btfi_lpca_taps *before = &ring[(q + RING - 1) % RING];
  btfi_lpca_taps *t = &ring[q % RING];
  bool rows_are_new = true;
  if ((batch->flags & BTF_QUERY_NEAREST) != 0) {
    const float light[3] = {batch->light[0][q], batch->light[1][q], batch->light[2][q]};
    const float view[3] = {batch->view[0][q], batch->view[1][q], batch->view[2][q]};
    tap_nearest(s, uv, lod, t);
    tap_row(s, s->host->dirset_nearest(s->light_set, light), s->host->dirset_nearest(s->view_set, view), t);
  } else {
    if (q == front->located) locate_more(front);
    const size_t i = q - front->first;
    const uint8_t *light_run = front->light_run + i, *view_run = front->view_run + i;
    tap_texels(s, uv, lod, &front->rows, t);
    if (i > 0 && light_run[0] == light_run[-1] && view_run[0] == view_run[-1]) {
      memcpy(t->row, before->row, sizeof t->row);
      memcpy(t->row_weight, before->row_weight, sizeof t->row_weight);
      t->rows = before->rows;
      rows_are_new = false;
    } else {
      tap_directions(s, &front->light[*light_run], &front->view[*view_run], t);
    }
  }
  if (rows_are_new && q > 0 && t->rows == before->rows) {
    uint64_t differences = 0;
    for (uint32_t r = 0; r < t->rows; r++) differences |= t->row[r] ^ before->row[r];
    rows_are_new = differences != 0;
  }
  prefetch(front, t, rows_are_new);
}

void btfi_lpca_eval_n(const void *state, const btf_batch *batch, float *const *out) {
  const btfi_lpca_state *s = state;
  float values[LPCA_MAX_CHANNELS];
  btfi_lpca_taps ring[RING];
  memset(ring, 0, sizeof ring);
  batch_front front = {.state = s, .batch = batch, .rows = {.level = UINT32_MAX}};
  size_t tapped = 0;
  for (size_t q = 0; q < batch->count; q++) {
    for (; tapped < batch->count && tapped <= q + PREFETCH_AHEAD; tapped++) tap_query(&front, tapped, ring);
    s->shade(s, &ring[q % RING], values);
    for (uint32_t c = 0; c < s->layout.channels; c++) out[c][q] = values[c];
  }
}
