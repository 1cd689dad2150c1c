/* SPDX-License-Identifier: MIT */
/* eval.c: Schwartz 2013, eq. 5: rows of U blended over 3 views x 3 lights, rows of V over 4 texels of 1 or 2
 * levels, then one dot product per channel. One query and a batch run the same arithmetic in the same order.
 */
#include "fmf.h"

#include <string.h>

#include <btf/btf_sampling.h>

enum {
  GROUP = 16,                   /* queries located together */
  PREFETCH_AHEAD = 6,           /* queries between asking for rows and using them */
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
  float natural[FMF_MAX_COLUMNS] = {0};
  state->host = host;
  state->light_set = shape->lights;
  state->view_set = shape->views;
  state->wrap = shape->wrap;
  state->blend = kernels->blend[layout->storage];
  state->project = kernels->project[layout->storage];
  state->dot = kernels->dot;
  state->channel_bytes = (uint64_t)layout->stride * btfi_fmf_value_bytes(layout->storage);
  state->channels_at_once =
      SCRATCH / layout->padded < layout->channels ? SCRATCH / layout->padded : layout->channels;
  memcpy(natural, scale, layout->columns * sizeof *scale);
  kernels->permute(layout->storage, layout->padded, natural, state->scale);
}

static const unsigned char *u_row(const btfi_fmf_state *s, uint32_t light, uint32_t view) {
  return s->u + ((uint64_t)view * s->layout.lights + light) * s->layout.u_row_bytes;
}

static const unsigned char *v_row(const btfi_fmf_state *s, uint32_t level, uint32_t x, uint32_t y) {
  return s->v[level] + y * s->layout.v_line_bytes[level] + x * s->layout.v_texel_bytes;
}

static void tap_directions(const btfi_fmf_state *s, const btf_interp *light, const btf_interp *view,
                           taps *t) {
  t->u.count = 0;
  for (uint32_t j = 0; j < 3; j++) {
    if (view->weight[j] == 0.0f) continue;
    for (uint32_t i = 0; i < 3; i++) {
      if (light->weight[i] == 0.0f) continue;
      t->u.row[t->u.count] = u_row(s, light->index[i], view->index[j]);
      t->u.weight[t->u.count++] = view->weight[j] * light->weight[i];
    }
  }
}

static void tap_texels(const btfi_fmf_state *s, float u, float v, float lod, taps *t) {
  btf_level_pair levels;
  btf_sampling_levels(lod, s->layout.levels, &levels);
  t->v.count = 0;
  for (uint32_t k = 0; k < 2; k++) {
    const uint32_t level = levels.level[k];
    btf_bilinear texels;
    if (levels.weight[k] == 0.0f) continue;
    btf_sampling_bilinear(u, v, s->layout.level_width[level], s->layout.level_height[level], s->wrap,
                          &texels);
    for (uint32_t i = 0; i < 4; i++) {
      const float weight = levels.weight[k] * (texels.wx[i & 1] * texels.wy[i >> 1]);
      if (weight == 0.0f) continue;
      t->v.row[t->v.count] = v_row(s, level, texels.x[i & 1], texels.y[i >> 1]);
      t->v.weight[t->v.count++] = weight;
    }
  }
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

/* Asks for the rows that the query before did not have in the same place. */
static void prefetch_rows(const btfi_fmf_rows *rows, const btfi_fmf_rows *before, uint64_t bytes) {
  for (uint32_t i = 0; i < rows->count; i++)
    if (before == NULL || i >= before->count || rows->row[i] != before->row[i])
      prefetch_row(rows->row[i], bytes);
}

static void prefetch(const btfi_fmf_state *s, const taps *t, const taps *before) {
  if (!t->same_u) prefetch_rows(&t->u, before != NULL ? &before->u : NULL, s->layout.u_data_bytes);
  prefetch_rows(&t->v, before != NULL ? &before->v : NULL, s->layout.v_texel_bytes);
}

static void evaluate(const btfi_fmf_state *s, const taps *t, float *out) {
  _Alignas(64) float v[FMF_MAX_COLUMNS];
  s->blend(&t->v, s->layout.padded, s->scale, v);
  s->project(&t->u, 0, s->channel_bytes, s->layout.channels, v, s->layout.padded, NULL, out);
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
  prefetch(s, &t, NULL);
  evaluate(s, &t, out);
}

void btfi_fmf_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                    float *out) {
  taps t;
  tap_sample(state, level, x, y, light, view, &t);
  evaluate(state, &t, out);
}

/* ---- batches ---- */

/* The distinct directions among consecutive ones of a group. */
typedef struct runs {
  float x[GROUP], y[GROUP], z[GROUP];
  uint8_t run[GROUP]; /* of each query */
  uint32_t count;
} runs;

static bool same_bits(float a, float b) {
  return memcmp(&a, &b, sizeof a) == 0;
}

static void find_runs(const float *const direction[3], size_t first, uint32_t count, runs *r) {
  r->count = 0;
  for (uint32_t i = 0; i < count; i++) {
    const float x = direction[0][first + i], y = direction[1][first + i], z = direction[2][first + i];
    const uint32_t last = r->count - 1;
    if (i == 0 || !same_bits(x, r->x[last]) || !same_bits(y, r->y[last]) || !same_bits(z, r->z[last])) {
      r->x[r->count] = x;
      r->y[r->count] = y;
      r->z[r->count] = z;
      r->count++;
    }
    r->run[i] = (uint8_t)(r->count - 1);
  }
}

/* The rows of up to GROUP queries from `first` on; returns how many. */
static uint32_t locate(const btfi_fmf_state *s, const btf_batch *batch, size_t first, taps *group) {
  const uint32_t count = batch->count - first < GROUP ? (uint32_t)(batch->count - first) : (uint32_t)GROUP;
  if (count == 0) return 0;
  if (batch->flags & BTF_QUERY_NEAREST) {
    for (uint32_t i = 0; i < count; i++) {
      const size_t q = first + i;
      const float light[3] = {batch->light[0][q], batch->light[1][q], batch->light[2][q]};
      const float view[3] = {batch->view[0][q], batch->view[1][q], batch->view[2][q]};
      tap_nearest(s, light, view, batch->uv[0][q], batch->uv[1][q], batch->lod != NULL ? batch->lod[q] : 0.0f,
                  &group[i]);
    }
    return count;
  }
  runs lights, views;
  btf_interp light[GROUP], view[GROUP];
  find_runs(batch->light, first, count, &lights);
  find_runs(batch->view, first, count, &views);
  s->host->dirset_locate_n(s->light_set, lights.count, lights.x, lights.y, lights.z, light);
  s->host->dirset_locate_n(s->view_set, views.count, views.x, views.y, views.z, view);
  for (uint32_t i = 0; i < count; i++) {
    const size_t q = first + i;
    taps *t = &group[i];
    t->same_u = i > 0 && lights.run[i] == lights.run[i - 1] && views.run[i] == views.run[i - 1];
    if (!t->same_u) {
      tap_directions(s, &light[lights.run[i]], &view[views.run[i]], t);
    } else {
      t->u = group[i - 1].u;
    }
    tap_texels(s, batch->uv[0][q], batch->uv[1][q], batch->lod != NULL ? batch->lod[q] : 0.0f, t);
  }
  return count;
}

void btfi_fmf_eval_n(const void *state, const btf_batch *batch, float *const *out) {
  const btfi_fmf_state *s = state;
  const uint32_t channels = s->layout.channels, padded = s->layout.padded;
  _Alignas(64) float kept[SCRATCH], v[FMF_MAX_COLUMNS];
  taps group[2]
            [GROUP]; /* the next group is located before this one is evaluated, to have its rows on the way */
  uint32_t count[2], now = 0;
  count[0] = locate(s, batch, 0, group[0]);
  for (uint32_t i = 0; i < count[0] && i < PREFETCH_AHEAD; i++)
    prefetch(s, &group[0][i], i > 0 ? &group[0][i - 1] : NULL);
  for (size_t first = 0; first < batch->count; first += GROUP, now ^= 1) {
    const uint32_t here = count[now];
    const taps *t = group[now], *next = group[now ^ 1];
    count[now ^ 1] = first + here < batch->count ? locate(s, batch, first + here, group[now ^ 1]) : 0;
    for (uint32_t channel = 0; channel < channels; channel += s->channels_at_once) {
      const uint32_t left = channels - channel,
                     part = left < s->channels_at_once ? left : s->channels_at_once;
      for (uint32_t i = 0; i < here; i++) {
        float values[FMF_MAX_CHANNELS];
        if (channel == 0) {
          const uint32_t ahead = i + PREFETCH_AHEAD;
          if (ahead < here) {
            prefetch(s, &t[ahead], &t[ahead - 1]);
          } else if (ahead - here < count[now ^ 1]) {
            prefetch(s, &next[ahead - here], ahead > here ? &next[ahead - here - 1] : &t[here - 1]);
          }
        }
        s->blend(&t[i].v, padded, s->scale, v);
        if (t[i].same_u) {
          s->dot(kept, part, v, padded, values);
        } else {
          float *keep = i + 1 < here && t[i + 1].same_u ? kept : NULL;
          s->project(&t[i].u, channel * s->channel_bytes, s->channel_bytes, part, v, padded, keep, values);
        }
        for (uint32_t c = 0; c < part; c++) out[channel + c][first + i] = values[c];
      }
    }
  }
}
