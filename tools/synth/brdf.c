/* SPDX-License-Identifier: MIT */
#include "brdf.h"

#include <string.h>

#include "clones.h"
#include "trace/sampling.h"

#define INVERSE_PI 0.318309886183790672f

/* Schlick's rise from f0 to 1 toward grazing angles. The diffuse part gets what the gloss lets through, on
 * the way in and on the way out: reciprocal, and together never above 1. */
static inline float pow5(float x) {
  return x * x * x * x * x;
}
/* fminf and fmaxf keep loops from being vectorised. */
static inline float lesser(float a, float b) {
  return a < b ? a : b;
}
static inline float greater(float a, float b) {
  return a > b ? a : b;
}
static inline float fresnel(const surface_brdf *b, int channel, float rise) {
  return b->gloss * (b->f0[channel] + (1.0f - b->f0[channel]) * rise);
}

VECTOR_CLONES
static void diffuse_times_cosine(const float diffuse[3], uint32_t count, const float *restrict cosine,
                                 float *restrict red, float *restrict green, float *restrict blue) {
  const float r = diffuse[0] * INVERSE_PI, g = diffuse[1] * INVERSE_PI, b = diffuse[2] * INVERSE_PI;
  for (uint32_t i = 0; i < count; ++i) {
    red[i] = r * cosine[i];
    green[i] = g * cosine[i];
    blue[i] = b * cosine[i];
  }
}

VECTOR_CLONES
static void light_cosines(vec3 normal, vec3 facet, uint32_t count, const float *restrict x,
                          const float *restrict y, const float *restrict z, float *restrict cosine) {
  for (uint32_t i = 0; i < count; ++i) {
    const float shading = normal.x * x[i] + normal.y * y[i] + normal.z * z[i];
    const float geometric = facet.x * x[i] + facet.y * y[i] + facet.z * z[i];
    cosine[i] = geometric > 0.0f && shading > 0.0f ? shading : 0.0f;
  }
}

/* The cosine arrives in `blue` and is replaced last. */
VECTOR_CLONES
static void gloss_times_cosine(const surface_brdf *restrict b, vec3 normal, vec3 view, uint32_t count,
                               const float *restrict x, const float *restrict y, const float *restrict z,
                               float *restrict red, float *restrict green, float *restrict blue) {
  const float cv = fmaxf(vec3_dot(normal, view), 1e-4f), a2 = b->alpha * b->alpha;
  const float view_rise = pow5(1.0f - cv), view_smith = sqrtf(cv * cv * (1.0f - a2) + a2), gloss = b->gloss;
  const float f0r = b->f0[0], f0g = b->f0[1], f0b = b->f0[2];
  const float dr = b->diffuse[0] * INVERSE_PI * (1.0f - fresnel(b, 0, view_rise));
  const float dg = b->diffuse[1] * INVERSE_PI * (1.0f - fresnel(b, 1, view_rise));
  const float db = b->diffuse[2] * INVERSE_PI * (1.0f - fresnel(b, 2, view_rise));
  for (uint32_t i = 0; i < count; ++i) {
    const float c = blue[i];
    const float between = greater(x[i] * view.x + y[i] * view.y + z[i] * view.z, -0.9999f);
    const float half2 = 2.0f + 2.0f * between; /* |l + v|^2 */
    const float nh2 = lesser((c + cv) * (c + cv) / half2, 1.0f);
    const float lh = 0.5f * sqrtf(half2);
    const float bracket = nh2 * (a2 - 1.0f) + 1.0f;
    const float smith = c * view_smith + cv * sqrtf(c * c * (1.0f - a2) + a2);
    /* D V cos = a^2 / (pi bracket^2) * 0.5 / smith * cos */
    const float lobe = gloss * c * a2 * 0.5f * INVERSE_PI / (bracket * bracket * smith);
    const float rise = pow5(1.0f - lh), light_rise = pow5(1.0f - lesser(c, 1.0f));
    red[i] = lobe * (f0r + (1.0f - f0r) * rise) + c * dr * (1.0f - gloss * (f0r + (1.0f - f0r) * light_rise));
    green[i] =
        lobe * (f0g + (1.0f - f0g) * rise) + c * dg * (1.0f - gloss * (f0g + (1.0f - f0g) * light_rise));
    blue[i] =
        lobe * (f0b + (1.0f - f0b) * rise) + c * db * (1.0f - gloss * (f0b + (1.0f - f0b) * light_rise));
  }
}

void brdf_times_cosine(const surface_brdf *b, vec3 normal, vec3 facet, vec3 view, uint32_t count,
                       const float *light_x, const float *light_y, const float *light_z, float *red,
                       float *green, float *blue) {
  light_cosines(normal, facet, count, light_x, light_y, light_z, blue);
  if (b->gloss > 0.0f) {
    gloss_times_cosine(b, normal, view, count, light_x, light_y, light_z, red, green, blue);
  } else {
    /* `blue` is input and output: the copy keeps the loop free of aliases. */
    float cosine[64];
    for (uint32_t i = 0; i < count; i += 16) {
      memcpy(cosine, blue + i, 16 * sizeof *cosine);
      diffuse_times_cosine(b->diffuse, 16, cosine, red + i, green + i, blue + i);
    }
  }
}

static float ggx_lobe(float alpha, float cl, float cv, float between) {
  const float a2 = alpha * alpha, half2 = 2.0f + 2.0f * fmaxf(between, -0.9999f);
  const float nh2 = fminf((cl + cv) * (cl + cv) / half2, 1.0f), bracket = nh2 * (a2 - 1.0f) + 1.0f;
  const float smith = cl * sqrtf(cv * cv * (1.0f - a2) + a2) + cv * sqrtf(cl * cl * (1.0f - a2) + a2);
  return a2 * 0.5f * INVERSE_PI / (bracket * bracket * smith);
}

void brdf_value(const surface_brdf *b, vec3 light, vec3 view, float f[3]) {
  const float cl = light.z, cv = fmaxf(view.z, 1e-4f);
  if (!(cl > 0.0f)) {
    f[0] = f[1] = f[2] = 0.0f;
    return;
  }
  const float between = vec3_dot(light, view), lh = sqrtf(fmaxf(0.5f + 0.5f * between, 0.0f));
  const float lobe = b->gloss > 0.0f ? ggx_lobe(b->alpha, cl, cv, between) : 0.0f;
  for (int i = 0; i < 3; ++i)
    f[i] = lobe * fresnel(b, i, pow5(1.0f - lh)) + b->diffuse[i] * INVERSE_PI *
                                                       (1.0f - fresnel(b, i, pow5(1.0f - fminf(cl, 1.0f)))) *
                                                       (1.0f - fresnel(b, i, pow5(1.0f - cv)));
}

/* A normal of the facets that the view sees, in proportion to their visible area: the view is stretched to a
 * hemisphere, a point of its projected disc is drawn and the normal there is stretched back. */
static vec3 visible_facet(float alpha, vec3 view, float x, float y) {
  vec3 tangent, bitangent;
  const vec3 stretched = vec3_normalize(vec3_make(alpha * view.x, alpha * view.y, view.z));
  const float radius = sqrtf(x), phi = 2.0f * SAMPLING_PI * y, side = 0.5f * (1.0f + stretched.z);
  const float p = radius * cosf(phi);
  const float q = (1.0f - side) * sqrtf(fmaxf(1.0f - p * p, 0.0f)) + side * radius * sinf(phi);
  const float level = stretched.x * stretched.x + stretched.y * stretched.y;
  tangent = level > 0.0f ? vec3_scale(vec3_make(-stretched.y, stretched.x, 0.0f), 1.0f / sqrtf(level))
                         : vec3_make(1.0f, 0.0f, 0.0f);
  bitangent = vec3_cross(stretched, tangent);
  const vec3 n = vec3_from_frame(tangent, bitangent, stretched,
                                 vec3_make(p, q, sqrtf(fmaxf(1.0f - p * p - q * q, 0.0f))));
  return vec3_normalize(vec3_make(alpha * n.x, alpha * n.y, fmaxf(n.z, 1e-6f)));
}

bool brdf_sample(const surface_brdf *b, vec3 view, float choice, float x, float y, vec3 *light,
                 float weight[3]) {
  const float cv = fmaxf(view.z, 1e-4f);
  float gloss_share = 0.0f;
  if (b->gloss > 0.0f) {
    const float rise = pow5(1.0f - cv);
    float gloss = 0.0f, diffuse = 0.0f;
    for (int i = 0; i < 3; ++i) {
      const float f = fresnel(b, i, rise);
      gloss += f;
      diffuse += b->diffuse[i] * (1.0f - f);
    }
    gloss_share = diffuse > 0.0f ? fminf(fmaxf(gloss / (gloss + diffuse), 0.05f), 0.95f) : 1.0f;
  }
  if (choice < gloss_share) {
    const vec3 m = visible_facet(b->alpha, view, x, y);
    *light = vec3_sub(vec3_scale(m, 2.0f * vec3_dot(view, m)), view);
  } else {
    *light = sampling_cosine(x, y);
  }
  if (!(light->z > 0.0f)) return false;
  if (gloss_share == 0.0f) {
    memcpy(weight, b->diffuse, 3 * sizeof *weight); /* exact: white stays white */
    return true;
  }
  /* Density of the visible facets, reflected: G1(v) D / (4 cos v); both draws are weighed together. */
  const float a2 = b->alpha * b->alpha, half2 = 2.0f + 2.0f * fmaxf(vec3_dot(*light, view), -0.9999f);
  const float nh2 = fminf((light->z + cv) * (light->z + cv) / half2, 1.0f),
              bracket = nh2 * (a2 - 1.0f) + 1.0f;
  const float d = a2 * INVERSE_PI / (bracket * bracket);
  const float gloss_density = d * 0.5f / (cv + sqrtf(cv * cv * (1.0f - a2) + a2));
  const float density = gloss_share * gloss_density + (1.0f - gloss_share) * light->z * INVERSE_PI;
  float f[3];
  brdf_value(b, *light, view, f);
  for (int i = 0; i < 3; ++i) weight[i] = f[i] * light->z / density;
  return true;
}
