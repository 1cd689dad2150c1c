/* SPDX-License-Identifier: MIT */
/*
 * mesostructure.h: the geometry of one tile, the unit square in x and y, repeated without end.
 *
 * Shapes may reach across the tile's border; every triangle is repeated over the tile and a margin around it.
 * A ray that leaves the margin is moved back by whole tiles and goes on, so the structure is periodic for any
 * ray, however flat.
 */
#ifndef BTF_TOOLS_SYNTH_MESOSTRUCTURE_H
#define BTF_TOOLS_SYNTH_MESOSTRUCTURE_H

#include "material.h"
#include "trace/embree_compat.h"
#include "watch.h"

#define MESO_MAX_PARTS 4
/* Origins leave the surface by this much, in tiles. Single precision resolves 1e-7. */
#define MESO_OFFSET 1e-5f

typedef struct meso_vertex {
  float p[3], n[3], tangent[3], s, t;
  uint32_t object;
} meso_vertex;

typedef struct meso_sphere {
  float x, y, z, radius;
} meso_sphere;

typedef struct meso_part {
  meso_vertex *vertices;
  uint32_t *triangles; /* three indices each */
  meso_sphere *spheres;
  uint32_t vertex_count, vertex_room, triangle_count, triangle_room, sphere_count, sphere_room;
  bool faceted;                /* normals are those of the triangles */
  unsigned mesh_id, sphere_id; /* Embree's, once committed */
} meso_part;

typedef struct mesostructure {
  const synth_material *material;
  meso_part parts[MESO_MAX_PARTS];
  uint64_t seed;
  RTCDevice device;
  RTCScene scene;
  float top, bottom;  /* highest and lowest point */
  float margin;       /* how far shapes are repeated beyond the tile */
  bool failed;        /* memory ran out while shapes were added */
  synth_watch *watch; /* while it is built; NULL = nobody asks to stop */
} mesostructure;

/* Builds a material's structure. On failure *out is NULL; BTF_E_CANCELLED when the watch said so. */
btf_status meso_create(const synth_material *material, uint64_t seed, synth_watch *watch,
                       mesostructure **out);
void meso_free(mesostructure *m);

/* ---- Shapes, for the materials' build functions. Memory failures are noted in m->failed; after a wish to
 * stop shapes are left out. ---- */

typedef float (*meso_height_fn)(float u, float v, const void *user);
/* A periodic height field of cells x cells squares; cells a power of two, so that copies meet exactly. */
void meso_add_height_field(mesostructure *m, uint32_t part, uint32_t cells, meso_height_fn height,
                           const void *user);
/* A horizontal plane. */
void meso_add_plane(mesostructure *m, uint32_t part, float z);

typedef struct tube_point {
  vec3 center;
  float radius;
  float s; /* surface coordinate along the tube */
} tube_point;
/* A tube with `sides` facets around through `count` points; `up` may not be along the tube anywhere. With
 * `repeat` the tube goes on from its last point to its first one moved by *repeat (zero for a ring, one tile
 * for a yarn); without, it ends, in a tip where the radius is 0. */
void meso_add_tube(mesostructure *m, uint32_t part, uint32_t object, const tube_point *points, uint32_t count,
                   uint32_t sides, const vec3 *repeat, vec3 up);

typedef struct yarn {
  const vec3 *centre; /* count points; the yarn goes on at centre[0] + repeat */
  uint32_t count;
  vec3 repeat, up;
  uint32_t plies;
  float radius;                 /* of a ply */
  float spread_side, spread_up; /* of the plies around the centre, across the yarn and along `up` */
  float turns, phase;           /* of the plies, whole turns over the yarn's length */
} yarn;
/* A bundle of plies, objects first_object on; s runs from 0 to 1 along the yarn. */
void meso_add_yarn(mesostructure *m, uint32_t part, uint32_t first_object, const yarn *y);
/* An exact sphere. */
void meso_add_sphere(mesostructure *m, uint32_t part, vec3 center, float radius);

/* ---- Rays ---- */

/* The first thing a ray meets, wherever it starts; the origin is outside the structure. */
bool meso_first_hit(const mesostructure *m, vec3 origin, vec3 direction, surface_hit *hit);
/* Whether anything lies between a point and the sky. */
bool meso_occluded(const mesostructure *m, vec3 origin, vec3 direction);

/* The coordinate moved into 0..1 by whole tiles. */
static inline float meso_wrap(float x) {
  const float wrapped = x - floorf(x);
  return wrapped < 1.0f ? wrapped : 0.0f;
}

#endif
