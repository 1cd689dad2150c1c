/* SPDX-License-Identifier: MIT */
/* render.h: pictures of a material on a surface, lit directly: L = sum over lights of f * cos * E *
 * visibility. */
#ifndef BTF_TOOLS_RENDER_H
#define BTF_TOOLS_RENDER_H

#include <stdbool.h>
#include <stdint.h>

#include <btf/btf.h>

#include "cli.h"
#include "render/environment.h"
#include "render/scene.h"

typedef struct render_camera {
  vec3 position, right, up, forward; /* unit vectors */
  float half_height;                 /* of the picture at distance 1 */
} render_camera;

typedef struct render_desc {
  const btf_model *model;
  const scene *surface;
  render_camera camera;
  uint32_t width, height, spp;
  /* A distant light: direction toward it, and irradiance across its beam. pi makes a white diffuse surface
   * that faces it 1. */
  vec3 light;
  float light_irradiance;         /* 0 = none */
  const environment *environment; /* NULL = none */
  vec3 background;
  bool show_environment; /* behind the subject, instead of the background */
  bool finest_level;     /* ignore footprints */
  uint32_t seed, threads;
} render_desc;

/* A camera that looks at a point from azimuth and elevation (radians, azimuth from +x toward +y) and a
 * distance. */
render_camera render_camera_at(vec3 target, float azimuth, float elevation, float distance,
                               float vertical_field);

/* Renders width * height RGB, top row first. */
int render_picture(cli *c, const render_desc *desc, float *rgb);

#endif
