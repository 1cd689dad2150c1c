/* SPDX-License-Identifier: MIT */
/* metal.c: a stand-in for brushed steel: fine grooves along u, a few scratches across them. */
#include "mesostructure.h"
#include "noise.h"

static float scratch(float u, float v, uint32_t seed) {
  float deepest = 0.0f;
  for (uint32_t i = 0; i < 5; ++i) {
    /* Each runs along a closed line of the torus with whole-numbered slope, so that it repeats. */
    const float slope = (float)((seed + i) % 3u + 1u) * ((i & 1u) != 0 ? -1.0f : 1.0f);
    const float shift = 0.31f * (float)i + 0.01f * noise_smooth(u, v, 2, 2, seed + i);
    const float across = (v - slope * u - shift) - floorf(v - slope * u - shift) - 0.5f;
    const float run = noise_step(0.15f, 0.35f, noise_smooth(u, v, 2, 2, seed + 40 + i));
    deepest =
        fmaxf(deepest, run * (1.0f - noise_step(0.0f, 0.007f * sqrtf(1.0f + slope * slope), fabsf(across))));
  }
  return deepest;
}

static float height(float u, float v, const void *user) {
  const uint32_t seed = *(const uint32_t *)user;
  const float grooves = 0.0009f * noise_smooth(u, v, 2, 128, seed) +
                        0.0014f * noise_smooth(u, v, 3, 64, seed + 1) +
                        0.0016f * noise_smooth(u, v, 2, 23, seed + 2);
  return grooves - 0.0035f * scratch(u, v, seed + 3);
}

static btf_status build(mesostructure *m) {
  const uint32_t seed = (uint32_t)m->seed + 401;
  meso_add_height_field(m, 0, 512, height, &seed);
  return BTF_OK;
}

static void shade(surface_hit *hit, surface_brdf *out) {
  const float streak = noise_smooth(hit->s, hit->t, 2, 96, 41u);
  *out = (surface_brdf){{0.02f, 0.02f, 0.02f}, {0.60f, 0.585f, 0.56f}, 0.98f, 0.20f + 0.05f * streak};
}

const synth_material synth_metal = {
    .name = "metal",
    .summary = "stand-in for brushed steel: grooves along u and a few scratches",
    .tile_mm = 8.0,
    .build = build,
    .shade = shade,
};
