/* SPDX-License-Identifier: MIT */
/* knit.c: a stand-in for a jersey knit: rows of loops, each hanging in the loops of the row below, of two-ply
 * yarn. */
#include "mesostructure.h"
#include "noise.h"

enum { YARN = 0, BASE = 1 };

#define COLUMNS 4
#define ROWS 6
#define OVERHANG 0.205f /* how far a loop's head is wider than its neck, in columns */
#define RISE 0.150f     /* half the height of a loop */
#define DEPTH 0.040f    /* of the loops through the cloth */
#define PLIES 3
#define PLY 0.0215f
#define SPREAD 0.0185f

static btf_status build(mesostructure *m) {
  enum { STEPS = 64 * COLUMNS };
  vec3 centre[STEPS];
  for (uint32_t row = 0; row < ROWS; ++row) {
    const yarn y = {.centre = centre,
                    .count = STEPS,
                    .repeat = vec3_make(1.0f, 0.0f, 0.0f),
                    .up = vec3_make(0.0f, 0.0f, 1.0f),
                    .plies = PLIES,
                    .radius = PLY,
                    .spread_side = SPREAD,
                    .spread_up = SPREAD,
                    .turns = 26.0f,
                    .phase = 0.29f * (float)row};
    for (uint32_t i = 0; i < STEPS; ++i) {
      const float t = 6.28318530718f * (float)i * COLUMNS / STEPS;
      centre[i] = vec3_make(((float)i * COLUMNS / STEPS + OVERHANG * sinf(2.0f * t)) / COLUMNS,
                            ((float)row + 0.5f) / ROWS - RISE * cosf(t), -DEPTH * cosf(2.0f * t));
    }
    meso_add_yarn(m, YARN, PLIES * row, &y);
  }
  meso_add_plane(m, BASE, -(DEPTH + SPREAD + PLY));
  return BTF_OK;
}

static void shade(surface_hit *hit, surface_brdf *out) {
  static const float wool[3] = {0.10f, 0.27f, 0.33f};
  float bright = 1.0f;
  if (hit->part == YARN) {
    const float fibre = 6.28318530718f * (90.0f * hit->s + 3.0f * hit->t);
    const float speck = noise_octaves(hit->s, hit->t, 300, 5, 2, 0.8f, hit->object + 31u);
    hit->normal = vec3_normalize(vec3_along(hit->normal, 0.30f * sinf(fibre) + 0.45f * speck, hit->tangent));
    bright = 0.95f + 0.10f * cosf(fibre) + 0.30f * speck;
  } else {
    bright = 0.15f;
  }
  for (int c = 0; c < 3; ++c) {
    out->diffuse[c] = wool[c] * bright;
    out->f0[c] = 0.04f;
  }
  out->gloss = hit->part == YARN ? 0.8f : 0.0f;
  out->alpha = 0.5f;
}

const synth_material synth_knit = {
    .name = "knit",
    .summary = "stand-in for a jersey knit: interlocked loops of three-ply teal wool",
    .tile_mm = 16.0,
    .build = build,
    .shade = shade,
};
