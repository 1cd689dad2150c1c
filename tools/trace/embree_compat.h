/* SPDX-License-Identifier: MIT */
/*
 * embree_compat.h: the few ray queries the tools make, alike for Embree 3 and 4. The build defines
 * BTF_EMBREE_MAJOR as 3 or 4.
 */
#ifndef BTF_TOOLS_TRACE_EMBREE_COMPAT_H
#define BTF_TOOLS_TRACE_EMBREE_COMPAT_H

#include <stdbool.h>
#include <string.h>

#if BTF_EMBREE_MAJOR >= 4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include "vec3.h"

static inline void trace_set_ray(struct RTCRay *ray, vec3 origin, vec3 direction, float near, float far) {
  ray->org_x = origin.x;
  ray->org_y = origin.y;
  ray->org_z = origin.z;
  ray->tnear = near;
  ray->dir_x = direction.x;
  ray->dir_y = direction.y;
  ray->dir_z = direction.z;
  ray->time = 0.0f;
  ray->tfar = far;
  ray->mask = ~0u;
  ray->id = 0;
  ray->flags = 0;
}

/* The first hit between near and far; false if there is none. */
static inline bool trace_first_hit(RTCScene scene, vec3 origin, vec3 direction, float near, float far,
                                   struct RTCRayHit *hit) {
  trace_set_ray(&hit->ray, origin, direction, near, far);
  memset(&hit->hit, 0, sizeof hit->hit);
  hit->hit.geomID = RTC_INVALID_GEOMETRY_ID;
#if BTF_EMBREE_MAJOR >= 4
  rtcIntersect1(scene, hit, NULL);
#else
  struct RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(scene, &context, hit);
#endif
  return hit->hit.geomID != RTC_INVALID_GEOMETRY_ID;
}

/* Whether anything lies between near and far. */
static inline bool trace_is_occluded(RTCScene scene, vec3 origin, vec3 direction, float near, float far) {
  struct RTCRay ray;
  trace_set_ray(&ray, origin, direction, near, far);
#if BTF_EMBREE_MAJOR >= 4
  rtcOccluded1(scene, &ray, NULL);
#else
  struct RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded1(scene, &context, &ray);
#endif
  return ray.tfar < 0.0f;
}

/* Sixteen shadow rays at once, those with valid[i] = -1; tfar of an occluded one becomes -infinity. `valid`
 * must be aligned to 64 bytes. Rays that fan out from one point go faster without Embree's flag for coherent
 * packets. */
static inline void trace_occluded16(RTCScene scene, const int valid[16], struct RTCRay16 *rays) {
#if BTF_EMBREE_MAJOR >= 4
  rtcOccluded16(valid, scene, rays, NULL);
#else
  struct RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded16(valid, scene, &context, rays);
#endif
}

#endif
