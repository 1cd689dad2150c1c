/* SPDX-License-Identifier: MIT */
/* plaster.c: a stand-in for rough plaster: a trowelled ground, grains, and holes with steep rims. */
#include "mesostructure.h"
#include "noise.h"
#include "trace/sampling.h"

#define HOLE_CELLS 9
#define HOLE_DEPTH 0.075f

/* 0 outside holes, 1 at their bottom. */
static float hole(float u, float v, uint32_t cells, float share, uint32_t seed) {
  const float wobble = 0.05f * noise_octaves(u, v, 14, 14, 2, 0.6f, seed + 1);
  const noise_cell cell = noise_cells(u + wobble, v + wobble, cells, seed);
  const float size = sampling_unit(cell.id);
  if (size > share) return 0.0f;
  const float radius = 0.16f + 0.30f * size / share;
  return 1.0f - noise_step(0.55f * radius, radius, cell.nearest);
}

static float height(float u, float v, const void *user) {
  const uint32_t seed = *(const uint32_t *)user;
  const float ground = 0.016f * noise_octaves(u, v, 3, 5, 4, 0.5f, seed);
  const float grain = 0.0045f * noise_octaves(u, v, 48, 48, 3, 0.75f, seed + 3);
  const float large = hole(u, v, HOLE_CELLS, 0.32f, seed + 5), small = hole(u, v, 26, 0.22f, seed + 9);
  return ground + grain - HOLE_DEPTH * large - 0.025f * small;
}

static btf_status build(mesostructure *m) {
  const uint32_t seed = (uint32_t)m->seed + 211;
  meso_add_height_field(m, 0, 512, height, &seed);
  return BTF_OK;
}

static void shade(surface_hit *hit, surface_brdf *out) {
  const float stain = noise_octaves(hit->s, hit->t, 4, 4, 3, 0.6f, 23u);
  const float dust = noise_octaves(hit->s, hit->t, 90, 90, 2, 0.8f, 29u);
  const float deep = noise_step(-0.02f, -0.07f, hit->position.z);
  const float tone = (1.0f + 0.10f * stain + 0.10f * dust) * (1.0f - 0.25f * deep);
  out->diffuse[0] = 0.74f * tone;
  out->diffuse[1] = (0.68f - 0.03f * stain) * tone;
  out->diffuse[2] = (0.57f - 0.07f * stain) * tone;
  out->f0[0] = out->f0[1] = out->f0[2] = 0.04f;
  out->gloss = 0.5f;
  out->alpha = 0.6f;
}

const synth_material synth_plaster = {
    .name = "plaster",
    .summary = "stand-in for rough plaster: grainy ground with holes",
    .tile_mm = 40.0,
    .build = build,
    .shade = shade,
};
