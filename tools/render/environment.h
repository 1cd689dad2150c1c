/* SPDX-License-Identifier: MIT */
/*
 * environment.h: light from all around. Maps are latitude-longitude pictures: the middle column lies toward
 * +y, which is what a camera at -y sees behind its subject; columns to the right turn toward +x; the top row
 * is +z.
 */
#ifndef BTF_TOOLS_RENDER_ENVIRONMENT_H
#define BTF_TOOLS_RENDER_ENVIRONMENT_H

#include <stdbool.h>
#include <stdint.h>

#include "trace/vec3.h"

typedef struct environment {
  uint32_t width, height;
  float *radiance;      /* width * height RGB, top row first */
  float *row_integral;  /* height + 1, 0 .. 1 */
  float *cell_integral; /* height rows of width + 1, 0 .. 1 */
  float rotation;       /* radians about z, counter-clockwise seen from above */
  double power;         /* sum of the sampling density over the map */
} environment;

/* "studio" and "sky" are built in; anything else is the path of a Radiance HDR or OpenEXR picture. */
int environment_load(const char *name, environment *out);
void environment_free(environment *e);

/* Radiance that comes from a direction, bilinear. */
vec3 environment_radiance(const environment *e, vec3 direction);
/* Draws a direction in proportion to luminance; returns the density per solid angle. */
float environment_sample(const environment *e, float x, float y, vec3 *direction);
float environment_density(const environment *e, vec3 direction);

#endif
