/* SPDX-License-Identifier: MIT */
/* noise.h: periodic noise over the unit square. */
#ifndef BTF_TOOLS_SYNTH_NOISE_H
#define BTF_TOOLS_SYNTH_NOISE_H

#include <stdint.h>

/* Smooth noise of about -1..1 with nu x nv cells over the unit square. */
float noise_smooth(float u, float v, uint32_t nu, uint32_t nv, uint32_t seed);
/* Octaves of smooth noise: cells double, amplitudes shrink by `gain`; about -1..1. */
float noise_octaves(float u, float v, uint32_t nu, uint32_t nv, uint32_t octaves, float gain, uint32_t seed);

typedef struct noise_cell {
  float nearest; /* distance to the nearest feature point, in cells */
  float border;  /* to the border between its region and the neighbours', in cells */
  uint32_t id;   /* random bits of the nearest feature point */
} noise_cell;
/* Feature points, one in each of n x n cells. */
noise_cell noise_cells(float u, float v, uint32_t n, uint32_t seed);

static inline float noise_mix(float a, float b, float t) {
  return a + (b - a) * t;
}
/* 0 below lo, 1 above hi, smooth between. */
static inline float noise_step(float lo, float hi, float x) {
  const float t = (x - lo) / (hi - lo), c = t < 0.0f ? 0.0f : t > 1.0f ? 1.0f : t;
  return c * c * (3.0f - 2.0f * c);
}

#endif
