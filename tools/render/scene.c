/* SPDX-License-Identifier: MIT */
#include "render/scene.h"

#include <string.h>

#include "cli.h"

/* Shadow rays start this far above: more than floats lose on the way from the camera, far less than any
 * fold. */
static const float ray_offset = 1e-4f;

int scene_create(const mesh *surface, scene *out) {
  *out = (scene){NULL, NULL, surface};
  out->device = rtcNewDevice(NULL);
  if (out->device == NULL)
    return cli_fail(EXIT_FAILED, "Embree did not start (error %d)", (int)rtcGetDeviceError(NULL));
  RTCGeometry geometry = rtcNewGeometry(out->device, RTC_GEOMETRY_TYPE_TRIANGLE);
  float *positions = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                             3 * sizeof(float), surface->vertex_count);
  uint32_t *triangles = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                3 * sizeof(uint32_t), surface->triangle_count);
  out->rays = rtcNewScene(out->device);
  if (positions == NULL || triangles == NULL || out->rays == NULL) {
    rtcReleaseGeometry(geometry);
    scene_free(out);
    return cli_out_of_memory();
  }
  for (uint32_t i = 0; i < surface->vertex_count; i++)
    vec3_store(positions + 3 * (size_t)i, surface->vertices[i].position);
  memcpy(triangles, surface->triangles, 3 * sizeof(uint32_t) * (size_t)surface->triangle_count);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(out->rays, geometry);
  rtcReleaseGeometry(geometry);
  rtcSetSceneFlags(out->rays, RTC_SCENE_FLAG_ROBUST);
  rtcCommitScene(out->rays);
  return EXIT_DONE;
}

void scene_free(scene *s) {
  if (s->rays != NULL) rtcReleaseScene(s->rays);
  if (s->device != NULL) rtcReleaseDevice(s->device);
  *s = (scene){0};
}

/* Derivatives of the position over the triangle by its texture coordinates; any frame where those are
 * degenerate. */
static void triangle_derivatives(const mesh_vertex *const corner[3], scene_point *p) {
  const vec3 e1 = vec3_sub(corner[1]->position, corner[0]->position);
  const vec3 e2 = vec3_sub(corner[2]->position, corner[0]->position);
  const float u1 = corner[1]->u - corner[0]->u, v1 = corner[1]->v - corner[0]->v;
  const float u2 = corner[2]->u - corner[0]->u, v2 = corner[2]->v - corner[0]->v;
  const float determinant = u1 * v2 - u2 * v1;
  if (fabsf(determinant) > 1e-20f) {
    p->dpdu = vec3_scale(vec3_sub(vec3_scale(e1, v2), vec3_scale(e2, v1)), 1.0f / determinant);
    p->dpdv = vec3_scale(vec3_sub(vec3_scale(e2, u1), vec3_scale(e1, u2)), 1.0f / determinant);
  } else {
    vec3_frame(p->normal, &p->dpdu, &p->dpdv);
  }
}

/* Moves a hit on the facets of a sphere to the sphere itself, where everything is known exactly. */
static void refine_sphere(const mesh *m, scene_point *p) {
  const float pi = 3.14159265f;
  p->normal = p->facet_normal = vec3_normalize(p->position);
  p->position = p->lifted = vec3_scale(p->normal, m->sphere_radius);
  const float longitude = atan2f(p->normal.y, p->normal.x), radius = hypotf(p->normal.x, p->normal.y);
  const float latitude = atan2f(p->normal.z, radius);
  p->u = 2.0f * m->sphere_repeat_u * (longitude / (2.0f * pi) + (longitude < 0.0f ? 1.0f : 0.0f));
  p->v = m->sphere_repeat_v * (latitude / pi + 0.5f);
  const float cosine = cosf(longitude), sine = sinf(longitude);
  /* length of one tile along the equator, and of one up */
  const float du = m->sphere_radius * pi / m->sphere_repeat_u,
              dv = m->sphere_radius * pi / m->sphere_repeat_v;
  p->dpdu = vec3_make(-sine * fmaxf(radius, 1e-4f) * du, cosine * fmaxf(radius, 1e-4f) * du, 0.0f);
  p->dpdv = vec3_make(-p->normal.z * cosine * dv, -p->normal.z * sine * dv, radius * dv);
}

/* A point above the facets, close to the smooth surface that they stand for. Where that is convex, facets lie
 * below it, and a ray from a facet toward a low light meets the facets around it although the light is above
 * the smooth horizon: shadows with teeth. The mean of the point's projections onto the tangent planes of the
 * corners it lies below clears them (Hanika 2021, "Hacking the Shadow Terminator"). `side` is -1 if the
 * normals of the corners point away from the viewer. */
static vec3 lift(const mesh_vertex *const corner[3], const float weight[3], float side, vec3 position) {
  vec3 lifted = position;
  for (int k = 0; k < 3; k++) {
    const vec3 normal = vec3_scale(corner[k]->normal, side);
    const float below = -vec3_dot(vec3_sub(position, corner[k]->position), normal);
    if (below > 0.0f) lifted = vec3_along(lifted, weight[k] * below, normal);
  }
  return lifted;
}

bool scene_hit(const scene *s, vec3 origin, vec3 direction, scene_point *out) {
  struct RTCRayHit hit;
  if (!trace_first_hit(s->rays, origin, direction, 0.0f, 1e30f, &hit)) return false;
  const mesh *m = s->surface;
  const mesh_vertex *corner[3];
  for (int k = 0; k < 3; k++) corner[k] = &m->vertices[m->triangles[3 * (size_t)hit.hit.primID + (size_t)k]];
  const float b1 = hit.hit.u, b2 = hit.hit.v, b0 = 1.0f - b1 - b2, weight[3] = {b0, b1, b2};
  out->position = vec3_along(origin, hit.ray.tfar, direction);
  out->facet_normal = vec3_normalize(vec3_make(hit.hit.Ng_x, hit.hit.Ng_y, hit.hit.Ng_z));
  out->normal = vec3_normalize(vec3_along(
      vec3_along(vec3_scale(corner[0]->normal, b0), b1, corner[1]->normal), b2, corner[2]->normal));
  out->u = b0 * corner[0]->u + b1 * corner[1]->u + b2 * corner[2]->u;
  out->v = b0 * corner[0]->v + b1 * corner[1]->v + b2 * corner[2]->v;
  if (vec3_dot(out->facet_normal, direction) > 0.0f) out->facet_normal = vec3_scale(out->facet_normal, -1.0f);
  const float side = vec3_dot(out->normal, out->facet_normal) < 0.0f ? -1.0f : 1.0f;
  out->normal = vec3_scale(out->normal, side);
  if (m->sphere_radius > 0.0f) {
    refine_sphere(m, out); /* seen from outside */
  } else {
    out->lifted = lift(corner, weight, side, out->position);
    triangle_derivatives(corner, out);
  }
  out->tangent = vec3_along(out->dpdu, -vec3_dot(out->dpdu, out->normal), out->normal);
  if (vec3_length(out->tangent) <= 1e-12f * vec3_length(out->dpdu)) {
    vec3 unused;
    vec3_frame(out->normal, &out->tangent, &unused);
  }
  out->tangent = vec3_normalize(out->tangent);
  out->bitangent = vec3_cross(out->normal, out->tangent);
  /* Mirrored texture coordinates, and the back of a sheet: v grows the other way. */
  if (vec3_dot(out->bitangent, out->dpdv) < 0.0f) out->bitangent = vec3_scale(out->bitangent, -1.0f);
  return true;
}

bool scene_blocked(const scene *s, const scene_point *from, vec3 direction) {
  return trace_is_occluded(s->rays, vec3_along(from->lifted, ray_offset, from->normal), direction, 0.0f,
                           1e30f);
}
