/* SPDX-License-Identifier: MIT */
/* eval.c: Suykens et al. 2003, sections 6 and 7: directions are projected into the maps once, then the four
 * texels around a position, of one or two levels, are evaluated whole and their colours blended: indices and
 * products of factors cannot be filtered. */
#include <math.h>

#include <btf/btf_half.h>

#include "cmf.h"

enum {
  SLACK = 4,          /* that kernels touch beyond the channels */
  BATCH_FACTORS = 16, /* most factors whose maps are asked for ahead */
  AHEAD = 4,
  RING = 8
};

/* ---- directions ---- */

static void parabolic(float x, float y, float z, float position[2]) {
  const float up = 1.0f + z;
  position[0] = x / up;
  position[1] = y / up;
  const float r2 = position[0] * position[0] + position[1] * position[1];
  const float within = r2 > 1.0f ? 1.0f / sqrtf(r2) : 1.0f;
  position[0] *= within;
  position[1] *= within;
}

static void cube(float x, float y, float z, float position[2]) {
  const float across_x = fabsf(x), across_y = fabsf(y);
  if (z >= across_x && z >= across_y) {
    position[0] = 0.5f * x / z;
    position[1] = 0.5f * y / z;
  } else if (across_x * CMF_CUBE_BIAS >= across_y) {
    position[0] = copysignf(1.0f - 0.5f * z / across_x, x);
    position[1] = 0.5f * y / across_x;
  } else {
    position[0] = 0.5f * x / across_y;
    position[1] = copysignf(1.0f - 0.5f * z / across_y, y);
  }
}

static void locate(const btfi_cmf_state *s, float x, float y, float z, btfi_cmf_at *at) {
  const float above = z > 0.0f ? z : 0.0f, last = (float)(s->edge - 1);
  float position[2];
  uint32_t texel[2];
  if (s->cube)
    cube(x, y, above, position);
  else
    parabolic(x, y, above, position);
  float part[2];
  for (int i = 0; i < 2; i++) {
    const float p = 0.5f * (position[i] + 1.0f) * (float)s->edge - 0.5f;
    const float clamped = p > 0.0f ? (p < last ? p : last) : 0.0f; /* 0 also for a NaN */
    const uint32_t whole = (uint32_t)(int32_t)clamped;
    texel[i] = whole < s->edge - 2 ? whole : s->edge - 2;
    part[i] = clamped - (float)texel[i];
  }
  at->offset = texel[1] * s->row_values + texel[0] * s->channels;
  const float weight[4] = {(1.0f - part[0]) * (1.0f - part[1]), part[0] * (1.0f - part[1]),
                           (1.0f - part[0]) * part[1], part[0] * part[1]};
  for (int i = 0; i < 16; i++) at->weight[i] = weight[i / 4];
}

/* h; N where light and view are opposite. */
static void half_vector(const float light[3], const float view[3], float h[3]) {
  for (int i = 0; i < 3; i++) h[i] = light[i] + view[i];
  const float square = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
  if (square > 0.0f) {
    const float scale = 1.0f / sqrtf(square);
    for (int i = 0; i < 3; i++) h[i] *= scale;
  } else {
    h[0] = h[1] = 0.0f;
    h[2] = 1.0f;
  }
}

/* The light in the Gram-Schmidt frame of h. */
static void difference(const float light[3], const float h[3], float d[3]) {
  const float across = sqrtf(h[1] * h[1] + h[2] * h[2]);
  const float scale = across > 0.0f ? 1.0f / across : 0.0f;
  /* x' = (across, -hx hy / across, -hx hz / across), y' = z' x x' = (0, hz, -hy) / across. */
  const float y = h[1] * scale, z = across > 0.0f ? h[2] * scale : 1.0f;
  d[0] = light[0] * across - h[0] * (light[1] * y + light[2] * z);
  d[1] = light[1] * z - light[2] * y;
  d[2] = light[0] * h[0] + light[1] * h[1] + light[2] * h[2];
}

static void project(const btfi_cmf_state *s, const float light[3], const float view[3],
                    btfi_cmf_at at[CMF_PROJECTIONS]) {
  float h[3], d[3];
  if (s->projections & 1u << CMF_LIGHT) locate(s, light[0], light[1], light[2], &at[CMF_LIGHT]);
  if (s->projections & 1u << CMF_VIEW) locate(s, view[0], view[1], view[2], &at[CMF_VIEW]);
  if (!(s->projections & (1u << CMF_HALF | 1u << CMF_DIFFERENCE))) return;
  half_vector(light, view, h);
  if (s->projections & 1u << CMF_HALF) locate(s, h[0], h[1], h[2], &at[CMF_HALF]);
  if (!(s->projections & 1u << CMF_DIFFERENCE)) return;
  difference(light, h, d);
  locate(s, d[0], d[1], d[2], &at[CMF_DIFFERENCE]);
}

/* Into the frame of an ABRDF that was rotated before it was factored. */
static void rotate_back(const btfi_cmf_state *s, uint32_t angle, const float d[3], float out[3]) {
  out[0] = s->cosine[angle] * d[0] + s->sine[angle] * d[1];
  out[1] = s->cosine[angle] * d[1] - s->sine[angle] * d[0];
  out[2] = d[2];
}

/* ---- texels ---- */

static const unsigned char *entry_of(const btfi_cmf_state *s, uint32_t level, uint64_t texel,
                                     uint32_t factor) {
  if (s->index[level] == NULL) return s->table[level][factor] + texel * s->entry_bytes;
  const unsigned char *index = s->index[level] + (texel * s->factors + factor) * s->index_bytes;
  const uint32_t entry = s->index_bytes == 1 ? index[0] : index[0] | (uint32_t)index[1] << 8;
  return s->codebook[factor] + entry * s->entry_bytes;
}

static void get_scales(const btfi_cmf_state *s, uint32_t level, uint64_t texel, float *out) {
  const uint32_t count = s->scales * s->channels;
  if (s->storage == CMF_U8) {
    const unsigned char *bytes = s->scale[level] + texel * count;
    for (uint32_t i = 0; i < count; i++) out[i] = (float)bytes[i] * (1.0f / 255.0f) * s->global[i];
  } else if (s->storage == CMF_F16) {
    const unsigned char *bytes = s->scale[level] + 2 * texel * count;
    for (uint32_t i = 0; i < count; i++) out[i] = btf_half_at(bytes, i) * s->global[i];
  } else {
    memcpy(out, s->scale[level] + 4 * texel * count, count * sizeof *out);
    for (uint32_t i = 0; i < count; i++) out[i] *= s->global[i];
  }
}

static uint64_t texel_of(const btfi_cmf_state *s, const btf_texel_set *set, uint32_t i) {
  return (uint64_t)set->y[i] * btf_sampling_level_size(s->width, set->level[i]) + set->x[i];
}

static void add_texel(const btfi_cmf_state *s, const float light[3], const float view[3],
                      const btfi_cmf_at *at, uint32_t level, uint64_t texel, float weight, float *out) {
  float scale[CMF_MAX_SCALES * CMF_MAX_CHANNELS + SLACK];
  const unsigned char *entry[CMF_MAX_FACTORS];
  for (uint32_t f = 0; f < s->factors; f++) entry[f] = entry_of(s, level, texel, f);
  get_scales(s, level, texel, scale);
  for (uint32_t i = 0; i < SLACK; i++) scale[s->scales * s->channels + i] = 0.0f;
  if (s->angle[level] != NULL && s->angle[level][texel] != 0) {
    float l[3], v[3];
    btfi_cmf_at turned[CMF_PROJECTIONS];
    rotate_back(s, s->angle[level][texel], light, l);
    rotate_back(s, s->angle[level][texel], view, v);
    project(s, l, v, turned);
    s->blend(s, entry, scale, weight, turned, out);
  } else {
    s->blend(s, entry, scale, weight, at, out);
  }
}

static void evaluate(const btfi_cmf_state *s, const float light[3], const float view[3],
                     const btfi_cmf_at *at, const btf_texel_set *set, float *out) {
  for (uint32_t c = 0; c < s->channels + SLACK; c++) out[c] = 0.0f;
  for (uint32_t i = 0; i < set->count; i++)
    add_texel(s, light, view, at, set->level[i], texel_of(s, set, i), set->weight[i], out);
}

/* ---- queries ---- */

/* A direction as evaluation takes it: with `nearest` the closest one of the data. */
static void take_direction(const btfi_cmf_state *s, const btf_dirset *set, bool nearest, const float given[3],
                           float out[3]) {
  memcpy(out, given, 3 * sizeof *out);
  if (!nearest) return;
  const uint32_t sample = s->host->dirset_nearest(set, given);
  memcpy(out, s->host->dirset_directions(set) + 3 * (size_t)sample, 3 * sizeof *out);
}

void btfi_cmf_eval(const void *state, const btf_query *query, float *out) {
  const btfi_cmf_state *s = state;
  const bool nearest = (query->flags & BTF_QUERY_NEAREST) != 0;
  float light[3], view[3], values[CMF_MAX_CHANNELS + SLACK];
  btfi_cmf_at at[CMF_PROJECTIONS];
  btf_texel_set set;
  take_direction(s, s->light_set, nearest, query->light, light);
  take_direction(s, s->view_set, nearest, query->view, view);
  project(s, light, view, at);
  btf_sampling_texels(query->uv, query->lod, nearest, s->width, s->height, s->wrap, s->levels, &set);
  evaluate(s, light, view, at, &set, values);
  memcpy(out, values, s->channels * sizeof *out);
}

void btfi_cmf_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                    float *out) {
  const btfi_cmf_state *s = state;
  const btf_texel_set set = {.count = 1, .level = {level}, .x = {x}, .y = {y}, .weight = {1.0f}};
  const float *l = s->host->dirset_directions(s->light_set) + 3 * (size_t)light;
  const float *v = s->host->dirset_directions(s->view_set) + 3 * (size_t)view;
  float values[CMF_MAX_CHANNELS + SLACK];
  btfi_cmf_at at[CMF_PROJECTIONS];
  project(s, l, v, at);
  evaluate(s, l, v, at, &set, values);
  memcpy(out, values, s->channels * sizeof *out);
}

/* A query of a batch, made ready before it is evaluated. */
typedef struct ready {
  float light[3], view[3];
  btfi_cmf_at at[CMF_PROJECTIONS];
  btf_texel_set set;
} ready;

/* Asks for the texels of maps that a query will read. */
static void prefetch(const btfi_cmf_state *s, const ready *r) {
  const uint32_t bytes = btfi_cmf_value_bytes(s->storage);
  for (uint32_t i = 0; i < r->set.count; i++) {
    const uint64_t texel = texel_of(s, &r->set, i);
    for (uint32_t f = 0; f < s->factors && f < BATCH_FACTORS; f++) {
      const unsigned char *map =
          entry_of(s, r->set.level[i], texel, f) + (size_t)bytes * r->at[s->factor[f].projection].offset;
      __builtin_prefetch(map, 0, 3);
      __builtin_prefetch(map + (size_t)bytes * s->row_values, 0, 3);
    }
  }
}

static void make_ready(const btfi_cmf_state *s, const btf_batch *batch, size_t q, const ready *before,
                       ready *r) {
  const bool nearest = (batch->flags & BTF_QUERY_NEAREST) != 0;
  const float light[3] = {batch->light[0][q], batch->light[1][q], batch->light[2][q]};
  const float view[3] = {batch->view[0][q], batch->view[1][q], batch->view[2][q]};
  const float uv[2] = {batch->uv[0][q], batch->uv[1][q]};
  take_direction(s, s->light_set, nearest, light, r->light);
  take_direction(s, s->view_set, nearest, view, r->view);
  if (before != NULL && memcmp(before->light, r->light, sizeof r->light) == 0 &&
      memcmp(before->view, r->view, sizeof r->view) == 0)
    memcpy(r->at, before->at, sizeof r->at);
  else
    project(s, r->light, r->view, r->at);
  btf_sampling_texels(uv, batch->lod != NULL ? batch->lod[q] : 0.0f, nearest, s->width, s->height, s->wrap,
                      s->levels, &r->set);
  prefetch(s, r);
}

void btfi_cmf_eval_n(const void *state, const btf_batch *batch, float *const *out) {
  const btfi_cmf_state *s = state;
  float values[CMF_MAX_CHANNELS + SLACK];
  ready ring[RING];
  size_t made = 0;
  for (size_t q = 0; q < batch->count; q++) {
    for (; made < batch->count && made <= q + AHEAD; made++)
      make_ready(s, batch, made, made > 0 ? &ring[(made - 1) % RING] : NULL, &ring[made % RING]);
    const ready *r = &ring[q % RING];
    evaluate(s, r->light, r->view, r->at, &r->set, values);
    for (uint32_t c = 0; c < s->channels; c++) out[c][q] = values[c];
  }
}
