/* SPDX-License-Identifier: MIT */
/* material.h: what a synthetic material is made of. */
#ifndef BTF_TOOLS_SYNTH_MATERIAL_H
#define BTF_TOOLS_SYNTH_MATERIAL_H

#include "brdf.h"
#include "synth.h"

struct mesostructure;

/* A point that a ray met. */
typedef struct surface_hit {
  vec3 position; /* u and v in 0..1 */
  vec3 facet,
      normal;   /* unit, on the side of the viewer; `normal` is the interpolated one and may be changed */
  vec3 tangent; /* unit, along the tube for tubes, along u for height fields */
  float s, t;   /* surface coordinates: along and around tubes; u and v for height fields */
  uint32_t part, object; /* as given to the shape */
} surface_hit;

/* Analytic materials compute blocks of samples without rays: a rectangle of texels for one view and all
 * lights. The sample of light l at column i and row j of the rectangle starts at dst[l * light_step + j *
 * row_step + i * texel_step] and has its three channels side by side. */
typedef struct analytic_block {
  uint32_t x0, y0, width, height;
  const float *view;   /* 3 floats */
  const float *lights; /* 3 floats each */
  uint32_t light_count;
  size_t light_step, row_step, texel_step;
} analytic_block;

typedef struct synth_material {
  const char *name, *summary;
  double tile_mm; /* side of the tile */
  /* Traced: builds shapes into m. */
  btf_status (*build)(struct mesostructure *m);
  /* Traced: reflectance at a hit; may bend hit->normal. */
  void (*shade)(surface_hit *hit, surface_brdf *out);
  /* Analytic: state for a texture size, blocks of samples from several threads, end. */
  btf_status (*prepare)(uint32_t width, uint32_t height, uint64_t seed, void **state);
  void (*fill)(const void *state, const analytic_block *block, float *dst);
  void (*end)(void *state);
} synth_material;

extern const synth_material synth_bumps, synth_lambert;
#ifdef BTF_EMBREE_MAJOR
extern const synth_material synth_checker, synth_rings, synth_tissue, synth_corduroy, synth_knit,
    synth_carpet, synth_plaster, synth_leather, synth_metal, synth_sphere, synth_furnace, synth_plane;
#endif

/* The material of a name, or NULL. */
const synth_material *synth_find(const char *name);

#endif
