/* SPDX-License-Identifier: MIT */
/* eval.c: STAR eq. 13 at each texel around a query, then the colours blended: weights of different clusters
 * have nothing in common. One query and a batch run the same arithmetic in the same order. */
#include "lpca.h"

#include <string.h>

#include <btf/btf_sampling.h>

enum {
  BATCH = 64,         /* queries located together */
  PREFETCH_AHEAD = 4, /* queries between asking for rows and using them */
  RING = 8            /* taps alive; a power of two above PREFETCH_AHEAD */
};

static void tap_texel(const btfi_lpca_state *s, uint32_t level, uint32_t x, uint32_t y, float weight,
                      btfi_lpca_taps *t) {
  const uint64_t texel = (uint64_t)y * s->layout.level_width[level] + x;
  const unsigned char *index = s->index[level] + texel * s->layout.index_bytes;
  t->cluster[t->texels] = s->layout.index_bytes == 1 ? index[0] : index[0] | (uint32_t)index[1] << 8;
  t->weights[t->texels] = s->weights[level] + texel * s->layout.texel_bytes;
  t->texel_weight[t->texels++] = weight;
}

static void tap_texels(const btfi_lpca_state *s, const float uv[2], float lod, int nearest,
                       btfi_lpca_taps *t) {
  btf_texel_set set;
  btf_sampling_texels(uv, lod, nearest, s->layout.width, s->layout.height, s->wrap, s->layout.levels, &set);
  t->texels = 0;
  memset(t->texel_weight, 0, sizeof t->texel_weight);
  for (uint32_t i = 0; i < set.count; i++) tap_texel(s, set.level[i], set.x[i], set.y[i], set.weight[i], t);
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
  for (uint32_t j = 0; j < 3; j++) {
    if (view->weight[j] == 0.0f) continue;
    for (uint32_t i = 0; i < 3; i++) {
      t->row[count] = light->index[i] * row_bytes + view->index[j] * view_bytes;
      t->row_weight[count] = view->weight[j] * light->weight[i];
      count += light->weight[i] != 0.0f;
    }
  }
  t->rows = count;
}

void btfi_lpca_eval(const void *state, const btf_query *query, float *out) {
  const btfi_lpca_state *s = state;
  const int nearest = (query->flags & BTF_QUERY_NEAREST) != 0;
  btfi_lpca_taps t = {.texels = 0};
  tap_texels(s, query->uv, query->lod, nearest, &t);
  if (nearest) {
    tap_row(s, s->host->dirset_nearest(s->light_set, query->light),
            s->host->dirset_nearest(s->view_set, query->view), &t);
  } else {
    btf_interp light, view;
    s->host->dirset_locate(s->light_set, query->light, &light);
    s->host->dirset_locate(s->view_set, query->view, &view);
    tap_directions(s, &light, &view, &t);
  }
  s->shade(s, &t, out);
}

void btfi_lpca_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                     float *out) {
  btfi_lpca_taps t = {.texels = 0};
  tap_texel(state, level, x, y, 1.0f, &t);
  tap_row(state, light, view, &t);
  ((const btfi_lpca_state *)state)->shade(state, &t, out);
}

/* ---- batches ---- */

/* A batch on its way: directions are located BATCH queries at a time, taps are made one by one,
 * PREFETCH_AHEAD queries before they are used. */
typedef struct batch_front {
  const btfi_lpca_state *state;
  const btf_batch *batch;
  size_t first, located; /* queries whose directions are known: first .. located - 1 */
  uint8_t light_run[BATCH], view_run[BATCH];
  btf_interp light[BATCH], view[BATCH];
} batch_front;

/* Locates `count` directions from `first` on, each run of equal ones once; run[i] is the place of the i-th.
 */
static void locate_runs(const btfi_lpca_state *s, const btf_dirset *set, const float *const direction[3],
                        size_t first, uint32_t count, uint8_t *run, btf_interp *out) {
  float xyz[3][BATCH];
  uint32_t runs = 0;
  for (uint32_t i = 0; i < count; i++) {
    bool repeats = i > 0;
    for (int k = 0; k < 3; k++) {
      /* The place stays free when it repeats the one before. */
      xyz[k][runs] = direction[k][first + i];
      repeats = repeats && memcmp(&xyz[k][runs], &xyz[k][runs - 1], sizeof(float)) == 0;
    }
    runs += !repeats;
    run[i] = (uint8_t)(runs - 1);
  }
  s->host->dirset_locate_n(set, runs, xyz[0], xyz[1], xyz[2], out);
}

static void locate_more(batch_front *front) {
  const btfi_lpca_state *s = front->state;
  const size_t left = front->batch->count - front->located;
  const uint32_t count = left < BATCH ? (uint32_t)left : (uint32_t)BATCH;
  front->first = front->located;
  front->located += count;
  locate_runs(s, s->light_set, front->batch->light, front->first, count, front->light_run, front->light);
  locate_runs(s, s->view_set, front->batch->view, front->first, count, front->view_run, front->view);
}

/* Into the second level of the cache: the first is too small for the rows of several queries. */
static void prefetch(const btfi_lpca_state *s, const btfi_lpca_taps *t) {
  uint32_t seen = UINT32_MAX;
  for (uint32_t i = 0; i < t->texels; i++) {
    __builtin_prefetch(t->weights[i], 0, 2);
    if (t->cluster[i] == seen) continue;
    seen = t->cluster[i];
    const unsigned char *factors = s->factors + seen * s->layout.cluster_bytes;
    for (uint32_t r = 0; r < t->rows; r++)
      for (uint64_t at = 0; at < s->layout.row_data_bytes; at += 64)
        __builtin_prefetch(factors + t->row[r] + at, 0, 2);
  }
}

/* What the query before uses is on its way. */
static bool same_places(const btfi_lpca_taps *a, const btfi_lpca_taps *b) {
  uint64_t differences = (a->rows ^ b->rows) | (a->texels ^ b->texels);
  if (differences != 0) return false;
  for (uint32_t r = 0; r < a->rows; r++) differences |= a->row[r] ^ b->row[r];
  for (uint32_t i = 0; i < a->texels; i++) differences |= a->cluster[i] ^ b->cluster[i];
  return differences == 0;
}

static void tap_query(batch_front *front, size_t q, btfi_lpca_taps *ring) {
  const btfi_lpca_state *s = front->state;
  const btf_batch *batch = front->batch;
  const float uv[2] = {batch->uv[0][q], batch->uv[1][q]}, lod = batch->lod != NULL ? batch->lod[q] : 0.0f;
  const btfi_lpca_taps *before = &ring[(q + RING - 1) % RING];
  btfi_lpca_taps *t = &ring[q % RING];
  const int nearest = (batch->flags & BTF_QUERY_NEAREST) != 0;
  tap_texels(s, uv, lod, nearest, t);
  if (nearest) {
    const float light[3] = {batch->light[0][q], batch->light[1][q], batch->light[2][q]};
    const float view[3] = {batch->view[0][q], batch->view[1][q], batch->view[2][q]};
    tap_row(s, s->host->dirset_nearest(s->light_set, light), s->host->dirset_nearest(s->view_set, view), t);
  } else {
    if (q == front->located) locate_more(front);
    const size_t i = q - front->first;
    const uint8_t *light_run = front->light_run + i, *view_run = front->view_run + i;
    if (i > 0 && light_run[0] == light_run[-1] && view_run[0] == view_run[-1]) {
      memcpy(t->row, before->row, sizeof t->row);
      memcpy(t->row_weight, before->row_weight, sizeof t->row_weight);
      t->rows = before->rows;
    } else {
      tap_directions(s, &front->light[*light_run], &front->view[*view_run], t);
    }
  }
  if (q == 0 || !same_places(t, before)) prefetch(s, t);
}

void btfi_lpca_eval_n(const void *state, const btf_batch *batch, float *const *out) {
  const btfi_lpca_state *s = state;
  float values[LPCA_MAX_CHANNELS];
  btfi_lpca_taps ring[RING];
  memset(ring, 0, sizeof ring);
  batch_front front = {.state = s, .batch = batch};
  size_t tapped = 0;
  for (size_t q = 0; q < batch->count; q++) {
    for (; tapped < batch->count && tapped <= q + PREFETCH_AHEAD; tapped++) tap_query(&front, tapped, ring);
    s->shade(s, &ring[q % RING], values);
    for (uint32_t c = 0; c < s->layout.channels; c++) out[c][q] = values[c];
  }
}
