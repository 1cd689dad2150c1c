/* SPDX-License-Identifier: MIT */
/* rings.c: gold-like tori lying on a glossy blue plane; concentric around the tile's centre, and around its
 * corners so that no lane of bare plane runs between the tiles. */
#include "mesostructure.h"

#define TUBE 0.05f

enum { PLANE = 0, GOLD = 1 };

static void add_torus(mesostructure *m, float x, float y, float radius) {
  enum { STEPS = 192, SIDES = 32 };
  const vec3 closed = {0.0f, 0.0f, 0.0f};
  tube_point points[STEPS];
  for (int i = 0; i < STEPS; ++i) {
    const float phi = 6.28318530718f * (float)i / STEPS;
    points[i] = (tube_point){vec3_make(x + radius * cosf(phi), y + radius * sinf(phi), TUBE), TUBE, phi};
  }
  meso_add_tube(m, GOLD, 0, points, STEPS, SIDES, &closed, vec3_make(0.0f, 0.0f, 1.0f));
}

static btf_status build(mesostructure *m) {
  static const float centre[] = {0.08f, 0.22f, 0.36f}, corner[] = {0.10f, 0.24f};
  meso_add_plane(m, PLANE, 0.0f);
  for (unsigned i = 0; i < sizeof centre / sizeof *centre; ++i) add_torus(m, 0.5f, 0.5f, centre[i]);
  for (unsigned i = 0; i < sizeof corner / sizeof *corner; ++i) add_torus(m, 0.0f, 0.0f, corner[i]);
  return BTF_OK;
}

static void shade(surface_hit *hit, surface_brdf *out) {
  if (hit->part == GOLD)
    *out = (surface_brdf){{0.0f, 0.0f, 0.0f}, {1.0f, 0.70f, 0.28f}, 0.97f, 0.28f};
  else
    *out = (surface_brdf){{0.03f, 0.09f, 0.42f}, {0.06f, 0.06f, 0.06f}, 1.0f, 0.14f};
}

const synth_material synth_rings = {
    .name = "rings",
    .summary = "concentric gold-like tori on a glossy blue plane (with overhangs)",
    .tile_mm = 20.0,
    .build = build,
    .shade = shade,
};
