/* SPDX-License-Identifier: MIT */
/* scene.h: a mesh that rays are traced against. */
#ifndef BTF_TOOLS_RENDER_SCENE_H
#define BTF_TOOLS_RENDER_SCENE_H

#include <stdbool.h>

#include "render/mesh.h"
#include "trace/embree_compat.h"

typedef struct scene {
  RTCDevice device;
  RTCScene rays;
  const mesh *surface;
} scene;

/* Where a ray met the surface. The frame is that of the material: tangent along growing u, bitangent along
 * growing v; the normal is on the viewer's side. */
typedef struct scene_point {
  vec3 position, facet_normal;
  vec3 lifted; /* where shadow rays start, but for a small step along the normal */
  vec3 tangent, bitangent, normal;
  vec3 dpdu, dpdv; /* change of the position with u and v, in tiles */
  float u, v;
} scene_point;

int scene_create(const mesh *surface, scene *out);
void scene_free(scene *s);
bool scene_hit(const scene *s, vec3 origin, vec3 direction, scene_point *out);
/* Whether the way from a point toward a direction above its tangent plane is blocked. */
bool scene_blocked(const scene *s, const scene_point *from, vec3 direction);

#endif
