/* SPDX-License-Identifier: MIT */
/* corduroy.c: a stand-in for corduroy: soft wales along v with deep furrows between them, of short pile. */
#include "mesostructure.h"
#include "noise.h"

#define WALES 5
#define DEPTH 0.085f

static float height(float u, float v, const void *user) {
  const uint32_t seed = *(const uint32_t *)user;
  const float sway = 0.006f * noise_smooth(u, v, 3, 4, seed);
  const float across = sinf(3.14159265f * WALES * (u + sway));
  const float wale = powf(fabsf(across), 0.55f);
  /* Tufts of pile stand a little apart along the wale. */
  const float tufts = noise_octaves(u, v, 40, 22, 3, 0.7f, seed + 1);
  return DEPTH * wale * (0.95f + 0.06f * noise_smooth(u, v, 5, 9, seed + 2)) +
         0.014f * tufts * (0.35f + 0.65f * wale);
}

static btf_status build(mesostructure *m) {
  const uint32_t seed = (uint32_t)m->seed + 101;
  meso_add_height_field(m, 0, 512, height, &seed);
  return BTF_OK;
}

static void shade(surface_hit *hit, surface_brdf *out) {
  static const float pile[3] = {0.46f, 0.25f, 0.085f}, furrow[3] = {0.20f, 0.10f, 0.045f};
  const float t = noise_step(0.1f * DEPTH, 0.8f * DEPTH, hit->position.z);
  const float speck = 1.0f + 0.22f * noise_octaves(hit->s, hit->t, 96, 64, 2, 0.8f, 17u);
  for (int c = 0; c < 3; ++c) {
    out->diffuse[c] = noise_mix(furrow[c], pile[c], t) * speck;
    out->f0[c] = 0.05f;
  }
  out->gloss = 0.9f;
  out->alpha = 0.55f;
}

const synth_material synth_corduroy = {
    .name = "corduroy",
    .summary = "stand-in for corduroy: wales of short brown pile",
    .tile_mm = 12.0,
    .build = build,
    .shade = shade,
};
