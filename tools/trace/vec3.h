/* SPDX-License-Identifier: MIT */
/* vec3.h: three floats, for rays. */
#ifndef BTF_TOOLS_TRACE_VEC3_H
#define BTF_TOOLS_TRACE_VEC3_H

#include <math.h>

typedef struct vec3 {
  float x, y, z;
} vec3;

static inline vec3 vec3_make(float x, float y, float z) {
  const vec3 v = {x, y, z};
  return v;
}
static inline vec3 vec3_load(const float *p) {
  return vec3_make(p[0], p[1], p[2]);
}
static inline void vec3_store(float *p, vec3 v) {
  p[0] = v.x;
  p[1] = v.y;
  p[2] = v.z;
}
static inline vec3 vec3_add(vec3 a, vec3 b) {
  return vec3_make(a.x + b.x, a.y + b.y, a.z + b.z);
}
static inline vec3 vec3_sub(vec3 a, vec3 b) {
  return vec3_make(a.x - b.x, a.y - b.y, a.z - b.z);
}
static inline vec3 vec3_scale(vec3 a, float s) {
  return vec3_make(a.x * s, a.y * s, a.z * s);
}
/* a + s b */
static inline vec3 vec3_along(vec3 a, float s, vec3 b) {
  return vec3_make(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}
static inline float vec3_dot(vec3 a, vec3 b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
static inline vec3 vec3_cross(vec3 a, vec3 b) {
  return vec3_make(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static inline float vec3_length(vec3 a) {
  return sqrtf(vec3_dot(a, a));
}
/* The zero vector becomes +z. */
static inline vec3 vec3_normalize(vec3 a) {
  const float length = vec3_length(a);
  return length > 0.0f ? vec3_scale(a, 1.0f / length) : vec3_make(0.0f, 0.0f, 1.0f);
}

/* Two unit vectors that make a right-handed frame with the unit vector n (t x b = n), without a singularity.
 */
static inline void vec3_frame(vec3 n, vec3 *t, vec3 *b) {
  const float sign = copysignf(1.0f, n.z);
  const float a = -1.0f / (sign + n.z), c = n.x * n.y * a;
  *t = vec3_make(1.0f + sign * n.x * n.x * a, sign * c, -sign * n.x);
  *b = vec3_make(c, sign + n.y * n.y * a, -n.y);
}
static inline vec3 vec3_from_frame(vec3 t, vec3 b, vec3 n, vec3 local) {
  return vec3_along(vec3_along(vec3_scale(t, local.x), local.y, b), local.z, n);
}

#endif
