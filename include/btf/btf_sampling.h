/* SPDX-License-Identifier: MIT */
/*
 * btf_sampling.h: the one rule by which a texture position becomes texels and a level of detail becomes
 * levels. Data sets that are evaluated as they stand and all codecs share it, so that differences between
 * them are differences of the data alone.
 *
 * All functions are total: NaN counts as 0, infinities and huge numbers are legal. Sizes are 1 to 2^24. Texel
 * (x, y) has its centre at u = (x + 0.5) / width, v = (y + 0.5) / height. Since u is a float, a centre is hit
 * exactly when u is the float nearest to it: distances below width / 2^24 texels, which a float cannot
 * express near 1, count as 0. Threads: free.
 */
#ifndef LIBBTF_BTF_SAMPLING_H
#define LIBBTF_BTF_SAMPLING_H

#include "btf_dataset.h"

/** Four texels (x[i], y[j]) of weight wx[i] * wy[j]. Weights are >= 0, each pair sums to 1, indices are in
 * range. The two indices of an axis are equal where the texture is one texel wide and at clamped borders.
 * FROZEN. */
typedef struct btf_bilinear {
  uint32_t x[2], y[2];
  float wx[2], wy[2];
} btf_bilinear;

/** Two levels and their weights, as btf_bilinear has them; weight[1] is 0 when level[0] alone is meant.
 * FROZEN. */
typedef struct btf_level_pair {
  uint32_t level[2];
  float weight[2];
} btf_level_pair;

/** Up to eight texels of up to two levels, each with a weight above 0; the weights sum to 1. FROZEN. */
typedef struct btf_texel_set {
  uint32_t count;
  uint32_t level[8], x[8], y[8];
  float weight[8];
} btf_texel_set;

/** Texels along one side of a level: max(1, size >> level). */
static inline uint32_t btf_sampling_level_size(uint32_t size, uint32_t level) {
  const uint32_t shifted = level < 32u ? size >> level : 0u;
  return shifted != 0u ? shifted : 1u;
}

/** Position along one axis as number of texels from the border: 0 <= result <= size, result < size unless
 * clamped. */
static inline double btf_sampling_position(float u, uint32_t size, uint32_t wrap) {
  double fraction;
  if (wrap == (uint32_t)BTF_WRAP_CLAMP) {
    fraction = u > 0.0f ? (u < 1.0f ? (double)u : 1.0) : 0.0;
  } else if (u > -16777216.0f && u < 16777216.0f) {
    fraction = (double)u - (double)(int32_t)u;
    if (fraction < 0.0) fraction += 1.0;
    if (fraction >= 1.0) fraction = 0.0; /* a negative number too small to be told from 0 */
  } else {
    fraction = 0.0; /* floats of this size are whole numbers; NaN and infinities come here too */
  }
  return fraction * (double)size;
}

/** Texel that holds a position along one axis. */
static inline uint32_t btf_sampling_nearest(float u, uint32_t size, uint32_t wrap) {
  const uint32_t texel = (uint32_t)(int32_t)btf_sampling_position(u, size, wrap);
  return texel < size ? texel : size - 1u;
}

/** Two texels along one axis and their weights. */
static inline void btf_sampling_linear(float u, uint32_t size, uint32_t wrap, uint32_t index[2],
                                       float weight[2]) {
  const double position = btf_sampling_position(u, size, wrap);
  const uint32_t truncated = (uint32_t)(int32_t)position;
  const uint32_t texel = truncated < size ? truncated : size - 1u;
  const uint32_t past = wrap == (uint32_t)BTF_WRAP_CLAMP ? size - 1u : 0u; /* index after the last */
  const uint32_t before = wrap == (uint32_t)BTF_WRAP_CLAMP ? 0u : size - 1u;
  const double offset = position - (double)texel - 0.5; /* from the centre, -0.5 .. 0.5 */
  const double below_float = (double)size * (1.0 / 16777216.0);
  /* Choices instead of branches: neighbouring pixels fall on either side of a centre. */
  const int below = offset < -below_float;
  const uint32_t left = texel > 0u ? texel - 1u : before, right = texel + 1u < size ? texel + 1u : past;
  const float distance = (float)(below ? -offset : offset);
  const float away = below || offset > below_float ? distance : 0.0f;
  index[0] = below ? left : texel;
  index[1] = below ? texel : right;
  weight[0] = below ? away : 1.0f - away;
  weight[1] = below ? 1.0f - away : away;
}

/** Four texels around (u, v) and their weights. */
static inline void btf_sampling_bilinear(float u, float v, uint32_t width, uint32_t height, uint32_t wrap,
                                         btf_bilinear *out) {
  btf_sampling_linear(u, width, wrap, out->x, out->wx);
  btf_sampling_linear(v, height, wrap, out->y, out->wy);
}

/** Two levels around a level of detail, clamped to 0 .. levels - 1. */
static inline void btf_sampling_levels(float lod, uint32_t levels, btf_level_pair *out) {
  const uint32_t last = levels > 1u ? levels - 1u : 0u;
  const float clamped = lod > 0.0f ? (lod < (float)last ? lod : (float)last) : 0.0f;
  const uint32_t level = (uint32_t)(int32_t)clamped;
  out->level[0] = level;
  out->level[1] = level < last ? level + 1u : last;
  out->weight[1] = clamped - (float)level;
  out->weight[0] = 1.0f - out->weight[1];
}

/** Level nearest to a level of detail; the coarser on a tie. */
static inline uint32_t btf_sampling_nearest_level(float lod, uint32_t levels) {
  const uint32_t last = levels > 1u ? levels - 1u : 0u;
  const float clamped = lod > 0.0f ? (lod < (float)last ? lod : (float)last) : 0.0f;
  const uint32_t level = (uint32_t)(int32_t)(clamped + 0.5f);
  return level < last ? level : last;
}

/** The texels that a position and level of detail (or `nearest`) are made of, for codecs that evaluate each
 * texel and blend the results. */
static inline void btf_sampling_texels(const float uv[2], float lod, int nearest, uint32_t width,
                                       uint32_t height, uint32_t wrap, uint32_t levels, btf_texel_set *out) {
  btf_level_pair pair;
  out->count = 0;
  if (nearest) {
    const uint32_t level = btf_sampling_nearest_level(lod, levels);
    out->count = 1;
    out->level[0] = level;
    out->x[0] = btf_sampling_nearest(uv[0], btf_sampling_level_size(width, level), wrap);
    out->y[0] = btf_sampling_nearest(uv[1], btf_sampling_level_size(height, level), wrap);
    out->weight[0] = 1.0f;
    return;
  }
  btf_sampling_levels(lod, levels, &pair);
  for (int k = 0; k < 2; k++) {
    btf_bilinear at;
    if (!(pair.weight[k] > 0.0f)) continue;
    btf_sampling_bilinear(uv[0], uv[1], btf_sampling_level_size(width, pair.level[k]),
                          btf_sampling_level_size(height, pair.level[k]), wrap, &at);
    for (int j = 0; j < 2; j++)
      for (int i = 0; i < 2; i++) {
        const float weight = pair.weight[k] * (at.wy[j] * at.wx[i]);
        if (!(weight > 0.0f)) continue;
        out->level[out->count] = pair.level[k];
        out->x[out->count] = at.x[i];
        out->y[out->count] = at.y[j];
        out->weight[out->count] = weight;
        out->count++;
      }
  }
}

#endif
