/* SPDX-License-Identifier: MIT */
/*
 * mesh.h: triangle meshes with texture coordinates. World space is right-handed with z up; u and v are in
 * tiles of the material, so that 0..4 repeats it four times.
 */
#ifndef BTF_TOOLS_RENDER_MESH_H
#define BTF_TOOLS_RENDER_MESH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "trace/vec3.h"

typedef struct mesh_vertex {
  vec3 position, normal;
  float u, v;
} mesh_vertex;

typedef struct mesh {
  mesh_vertex *vertices;
  uint32_t *triangles; /* three indices each, counter-clockwise seen from outside */
  uint32_t vertex_count, triangle_count;
  /* A sphere around the origin whose hits are moved onto the true surface; 0 = none. */
  float sphere_radius;
  float sphere_repeat_u, sphere_repeat_v; /* tiles along half the equator, and from pole to pole */
} mesh;

/* All return an exit status of cli.h, and have printed their line when it is not EXIT_DONE. `repeat` is the
 * number of tiles across the plane, around half the sphere's equator, and across the cloth; as many go up as
 * across. */
int mesh_plane(float repeat, mesh *out);
int mesh_sphere(float repeat, mesh *out);
int mesh_cloth(float repeat, mesh *out);
/* Wavefront OBJ: polygons are split; missing normals are averaged; missing texture coordinates are an error.
 * The mesh is moved and scaled into the unit sphere. `repeat` multiplies the texture coordinates. */
int mesh_obj(const char *path, float repeat, mesh *out);
void mesh_free(mesh *m);

/* Multiplies all v: with width / height of a material its texels are as high as wide. */
void mesh_scale_v(mesh *m, float factor);

/* Room for vertices and triangles; false when out of memory. */
bool mesh_reserve(mesh *m, uint32_t vertices, uint32_t triangles);
/* Normals as area-weighted averages over the triangles around a vertex. */
void mesh_smooth_normals(mesh *m);

#endif
