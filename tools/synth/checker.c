/* SPDX-License-Identifier: MIT */
/* checker.c: the smoothed checkerboard of Suykens 2003, fig. 1: pink and glossy above, blue and dull below.
 */
#include "mesostructure.h"
#include "noise.h"

#define RAISED 0.16f   /* height of the raised squares */
#define SHARPNESS 5.0f /* of the slopes between them */

static float height(float u, float v, const void *user) {
  (void)user;
  const float board = sinf(6.28318530718f * u) * sinf(6.28318530718f * v);
  return RAISED * (0.5f + 0.5f * tanhf(SHARPNESS * board) / tanhf(SHARPNESS));
}

static btf_status build(mesostructure *m) {
  meso_add_height_field(m, 0, 256, height, NULL);
  return BTF_OK;
}

static void shade(surface_hit *hit, surface_brdf *out) {
  static const float low[3] = {0.07f, 0.16f, 0.50f}, high[3] = {0.78f, 0.24f, 0.36f};
  const float t = noise_step(0.35f * RAISED, 0.65f * RAISED, hit->position.z);
  for (int c = 0; c < 3; ++c) {
    out->diffuse[c] = noise_mix(low[c], high[c], t);
    out->f0[c] = noise_mix(0.03f, 0.07f, t);
  }
  out->gloss = noise_mix(0.5f, 1.0f, t);
  out->alpha = noise_mix(0.5f, 0.16f, t);
}

const synth_material synth_checker = {
    .name = "checker",
    .summary = "height field of a smoothed checkerboard: raised pink and glossy, low blue and dull",
    .tile_mm = 10.0,
    .build = build,
    .shade = shade,
};
