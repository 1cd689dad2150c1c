/* SPDX-License-Identifier: MIT */
/* tissue.c: plain weave. Each yarn is a bundle of twisted plies swept along its path; warp runs along v and
 * lies on top where i + j is even, weft runs along u. */
#include "mesostructure.h"
#include "noise.h"
#include "trace/sampling.h"

enum { WARP = 0, WEFT = 1, BASE = 2 };

#define YARNS 4 /* each way; even, so that the weave repeats */
#define PLIES 5
#define BUNDLE_WIDTH 0.066f  /* of the plies' centres around the yarn's, across the cloth */
#define BUNDLE_HEIGHT 0.024f /* and through it */
#define PLY 0.036f
#define SWING 0.060f /* of the yarn's centre through the cloth */
#define TWIST 6.0f   /* turns of the plies over the tile */

static vec3 yarn_centre(bool warp, uint32_t index, float along) {
  const float pi = SAMPLING_PI, across = ((float)index + 0.5f) / YARNS;
  const float swing = SWING * cosf(pi * ((float)YARNS * along - 0.5f) + pi * (float)index);
  return warp ? vec3_make(across, along, swing) : vec3_make(along, across, -swing);
}

static void add_yarn(mesostructure *m, bool warp, uint32_t index) {
  vec3 centre[128];
  yarn y = {.centre = centre,
            .count = sizeof centre / sizeof *centre,
            .repeat = warp ? vec3_make(0.0f, 1.0f, 0.0f) : vec3_make(1.0f, 0.0f, 0.0f),
            .up = vec3_make(0.0f, 0.0f, 1.0f),
            .plies = PLIES,
            .radius = PLY,
            .spread_side = BUNDLE_WIDTH,
            .spread_up = BUNDLE_HEIGHT,
            .turns = TWIST,
            .phase = 0.37f * (float)index};
  for (uint32_t i = 0; i < y.count; ++i) centre[i] = yarn_centre(warp, index, (float)i / (float)y.count);
  meso_add_yarn(m, warp ? WARP : WEFT, PLIES * index, &y);
}

static btf_status build(mesostructure *m) {
  for (uint32_t i = 0; i < YARNS; ++i) {
    add_yarn(m, true, i);
    add_yarn(m, false, i);
  }
  meso_add_plane(m, BASE, -(SWING + BUNDLE_HEIGHT + PLY));
  return BTF_OK;
}

static void shade(surface_hit *hit, surface_brdf *out) {
  static const float warp[3] = {0.62f, 0.53f, 0.38f}, weft[3] = {0.34f, 0.05f, 0.06f},
                     base[3] = {0.05f, 0.04f, 0.04f};
  const float *colour = hit->part == WARP ? warp : hit->part == WEFT ? weft : base;
  float shade = 1.0f;
  if (hit->part != BASE) {
    /* Fibres run around the ply at a slant: they bend the normal along the tube and vary in brightness. */
    const float fibre = 6.28318530718f * (40.0f * hit->s + 2.0f * hit->t);
    const float speck = noise_smooth(hit->s, hit->t, 160, 6, hit->object + 11u);
    hit->normal = vec3_normalize(vec3_along(hit->normal, 0.28f * sinf(fibre) + 0.25f * speck, hit->tangent));
    shade = 0.88f + 0.12f * cosf(fibre) + 0.15f * speck;
  }
  for (int c = 0; c < 3; ++c) {
    out->diffuse[c] = fminf(colour[c] * shade, 0.9f);
    out->f0[c] = 0.045f;
  }
  out->gloss = hit->part == BASE ? 0.0f : 1.0f;
  out->alpha = 0.38f;
}

const synth_material synth_tissue = {
    .name = "tissue",
    .summary = "plain weave of cream warp and red weft, yarns of twisted plies",
    .tile_mm = 6.0,
    .build = build,
    .shade = shade,
};
