/* SPDX-License-Identifier: MIT */
/*
 * brdf.h: reflectance of the facets of a structure: Lambertian under a GGX gloss coat or metal. Reciprocal
 * and energy conserving; without gloss exactly Lambertian.
 */
#ifndef BTF_TOOLS_SYNTH_BRDF_H
#define BTF_TOOLS_SYNTH_BRDF_H

#include <stdbool.h>
#include <stdint.h>

#include "trace/vec3.h"

typedef struct surface_brdf {
  float diffuse[3];
  float f0[3]; /* reflectance of the gloss at normal incidence */
  float gloss; /* 0 = none, 1 = full: scales f0 and its rise to grazing angles */
  float alpha; /* GGX roughness */
} surface_brdf;

/* f times cos(theta_l) about the normal for `count` lights given as arrays; 0 where the light is below the
 * normal's or the facet's horizon. `count` must be a multiple of 16. */
void brdf_times_cosine(const surface_brdf *b, vec3 normal, vec3 facet, vec3 view, uint32_t count,
                       const float *light_x, const float *light_y, const float *light_z, float *red,
                       float *green, float *blue);

/* f for one pair of directions in the frame of the normal. */
void brdf_value(const surface_brdf *b, vec3 light, vec3 view, float f[3]);

/* Draws a light for a view, both in the frame of the normal: weight = f cos / density. False if the path
 * ends. */
bool brdf_sample(const surface_brdf *b, vec3 view, float choice, float x, float y, vec3 *light,
                 float weight[3]);

#endif
