/* SPDX-License-Identifier: MIT */
/* leather.c: a stand-in for grained leather: rounded pebbles parted by creases, fine wrinkles, pores. */
#include "mesostructure.h"
#include "noise.h"

#define PEBBLES 10

/* 0 in a crease, 1 on top of a pebble. */
static float pebble(float u, float v, uint32_t cells, uint32_t seed) {
  const float bend = 0.022f * noise_octaves(u, v, 6, 6, 2, 0.6f, seed + 1);
  const float turn = 0.022f * noise_octaves(u, v, 6, 6, 2, 0.6f, seed + 2);
  const noise_cell cell = noise_cells(u + bend, v + turn, cells, seed);
  return 1.0f - expf(-9.0f * fmaxf(cell.border, 0.0f));
}

static float height(float u, float v, const void *user) {
  const uint32_t seed = *(const uint32_t *)user;
  const float coarse = pebble(u, v, PEBBLES, seed), fine = pebble(u, v, 29, seed + 7);
  const noise_cell pore = noise_cells(u, v, 31, seed + 13);
  const float pores = (pore.id & 3u) == 0 ? 1.0f - noise_step(0.05f, 0.16f, pore.nearest) : 0.0f;
  return 0.030f * coarse + 0.007f * fine * coarse + 0.004f * noise_smooth(u, v, 3, 3, seed + 17) -
         0.006f * pores;
}

static btf_status build(mesostructure *m) {
  const uint32_t seed = (uint32_t)m->seed + 307;
  meso_add_height_field(m, 0, 512, height, &seed);
  return BTF_OK;
}

static void shade(surface_hit *hit, surface_brdf *out) {
  static const float hide[3] = {0.23f, 0.088f, 0.040f}, crease[3] = {0.080f, 0.028f, 0.014f};
  const float t = noise_step(0.002f, 0.020f, hit->position.z);
  const float tone = 1.0f + 0.18f * noise_octaves(hit->s, hit->t, 5, 5, 3, 0.6f, 37u);
  for (int c = 0; c < 3; ++c) {
    out->diffuse[c] = noise_mix(crease[c], hide[c], t) * tone;
    out->f0[c] = 0.05f;
  }
  out->gloss = noise_mix(0.45f, 1.0f, t);
  out->alpha = noise_mix(0.45f, 0.27f, t);
}

const synth_material synth_leather = {
    .name = "leather",
    .summary = "stand-in for grained leather: brown pebbles, creases and pores",
    .tile_mm = 15.0,
    .build = build,
    .shade = shade,
};
