/* SPDX-License-Identifier: MIT */
/* plain.c: materials with known answers, for checks. */
#include "mesostructure.h"

/* A white sphere on a grey plane: the shadow's edge is known exactly. */
#define SPHERE_RADIUS 0.2f

static btf_status build_sphere(mesostructure *m) {
  meso_add_plane(m, 0, 0.0f);
  meso_add_sphere(m, 1, vec3_make(0.5f, 0.5f, SPHERE_RADIUS), SPHERE_RADIUS);
  return BTF_OK;
}

static void shade_sphere(surface_hit *hit, surface_brdf *out) {
  const float albedo = hit->part == 1 ? 0.8f : 0.5f;
  *out = (surface_brdf){{albedo, albedo, albedo}, {0.0f, 0.0f, 0.0f}, 0.0f, 1.0f};
}

const synth_material synth_sphere = {
    .name = "sphere",
    .summary = "check: an exact white Lambertian sphere of radius 0.2 tiles on a grey Lambertian plane",
    .tile_mm = 10.0,
    .build = build_sphere,
    .shade = shade_sphere,
};

/* A closed height field that absorbs nothing; facet normals, so that the geometry and the shading agree
 * exactly. */
static float waves(float u, float v, const void *user) {
  (void)user;
  const float tau = 6.28318530718f;
  return 0.05f * sinf(tau * u) * cosf(tau * v) + 0.03f * sinf(tau * (2.0f * u + v));
}

static btf_status build_furnace(mesostructure *m) {
  m->parts[0].faceted = true;
  meso_add_height_field(m, 0, 32, waves, NULL);
  return BTF_OK;
}

static void shade_furnace(surface_hit *hit, surface_brdf *out) {
  (void)hit;
  *out = (surface_brdf){{1.0f, 1.0f, 1.0f}, {0.0f, 0.0f, 0.0f}, 0.0f, 1.0f};
}

const synth_material synth_furnace = {
    .name = "furnace",
    .summary = "check: a wavy Lambertian height field of albedo 1; with many bounces it reflects everything",
    .tile_mm = 10.0,
    .build = build_furnace,
    .shade = shade_furnace,
};

/* The traced twin of the analytic `lambert`. */
static btf_status build_plane(mesostructure *m) {
  meso_add_plane(m, 0, 0.0f);
  return BTF_OK;
}

static void shade_plane(surface_hit *hit, surface_brdf *out) {
  (void)hit;
  *out = (surface_brdf){{0.8f, 0.5f, 0.2f}, {0.0f, 0.0f, 0.0f}, 0.0f, 1.0f};
}

const synth_material synth_plane = {
    .name = "plane",
    .summary = "check: a traced Lambertian plane of albedo 0.8, 0.5, 0.2, the same as lambert",
    .tile_mm = 10.0,
    .build = build_plane,
    .shade = shade_plane,
};
