/* SPDX-License-Identifier: MIT */
/*
 * sampling.h: random numbers that depend on names and not on order (texel, sample, dimension), so that any
 * number of threads draws the same ones, and the directions drawn with them.
 */
#ifndef BTF_TOOLS_TRACE_SAMPLING_H
#define BTF_TOOLS_TRACE_SAMPLING_H

#include <stdint.h>

#include "vec3.h"

#define SAMPLING_PI 3.14159265358979f

static inline uint32_t sampling_mix(uint32_t h) {
  h ^= h >> 16;
  h *= 0x7feb352du;
  h ^= h >> 15;
  h *= 0x846ca68bu;
  h ^= h >> 16;
  return h;
}
static inline uint32_t sampling_hash(uint32_t a, uint32_t b) {
  return sampling_mix(a ^ sampling_mix(b + 0x9e3779b9u));
}
/* 24 bits, so that the float stays below 1. */
static inline float sampling_unit(uint32_t bits) {
  return (float)(bits >> 8) * 0x1p-24f;
}

static inline uint32_t sampling_reverse_bits(uint32_t v) {
  v = (v >> 1 & 0x55555555u) | (v & 0x55555555u) << 1;
  v = (v >> 2 & 0x33333333u) | (v & 0x33333333u) << 2;
  v = (v >> 4 & 0x0f0f0f0fu) | (v & 0x0f0f0f0fu) << 4;
  v = (v >> 8 & 0x00ff00ffu) | (v & 0x00ff00ffu) << 8;
  return v >> 16 | v << 16;
}

/* A random Owen scrambling of bit-reversed fractions: a bit is flipped or not depending on the bits below it
 * only (the multipliers are even, sums and products carry upward). */
static inline uint32_t sampling_scramble_reversed(uint32_t v, uint32_t seed) {
  v += seed;
  v ^= v * 0x6c50b47cu;
  v ^= v * 0xb82f1e52u;
  v ^= v * 0xc7afe638u;
  v ^= v * 0x8d22f6e6u;
  return v;
}

/* Point `index` of a scrambled two-dimensional Sobol sequence: any 2^k consecutive points from a multiple of
 * 2^k on are stratified in every elementary interval. Sequences of different seeds are independent. */
static inline void sampling_pair(uint32_t seed, uint32_t index, float *x, float *y) {
  const uint32_t shuffled =
      sampling_reverse_bits(sampling_scramble_reversed(sampling_reverse_bits(index), sampling_mix(seed)));
  uint32_t second = 0, column = 0x80000000u, rest = shuffled;
  for (; rest != 0; rest >>= 1, column ^= column >> 1)
    if (rest & 1u) second ^= column;
  *x = sampling_unit(
      sampling_reverse_bits(sampling_scramble_reversed(shuffled, sampling_mix(seed ^ 0xa511e9b3u))));
  *y = sampling_unit(sampling_reverse_bits(
      sampling_scramble_reversed(sampling_reverse_bits(second), sampling_mix(seed ^ 0x63d83595u))));
}

/* A direction around +z with density cos(theta) / pi; z > 0. */
static inline vec3 sampling_cosine(float x, float y) {
  const float radius = sqrtf(x), phi = 2.0f * SAMPLING_PI * y;
  return vec3_make(radius * cosf(phi), radius * sinf(phi), sqrtf(fmaxf(1.0f - x, 1e-8f)));
}

#endif
