/* SPDX-License-Identifier: MIT */
/*
 * synth.h: synthetic mesostructures sampled into data-set folders (Suykens 2003, sect. 3).
 *
 * A sample is f = L_o / (E cos(theta_l)): the radiance that leaves the tile toward the view at a point of the
 * reference plane (the top of the structure), under a directional light whose beam carries the irradiance E
 * across itself. A flat Lambertian plane of albedo rho gives rho / pi for all directions, and a closed
 * structure that absorbs nothing satisfies sum(f cos(theta_l)) = 1 for every view.
 */
#ifndef BTF_TOOLS_SYNTH_H
#define BTF_TOOLS_SYNTH_H

#include <stdbool.h>
#include <stdint.h>

#include <btf/btf.h>

/* Materials of this build: name and one line, for index 0 on; NULL after the last. */
const char *synth_name(uint32_t index);
const char *synth_summary(uint32_t index);
/* Whether a name is known but its material needs Embree, which this build lacks. */
bool synth_needs_rays(const char *name);

enum {
  SYNTH_SAMPLING_AREA = 0, /* `spp` points stratified over the texel */
  SYNTH_SAMPLING_POINT = 1 /* the texel's centre; `spp` paths start there */
};

typedef struct synth_desc {
  const char *name;
  const btf_dirset *lights, *views;
  uint32_t width, height; /* texels over one tile, which is square */
  uint32_t spp, bounces;  /* samples a texel and view; interreflections after the first hit */
  uint32_t sampling, sample_type, order;
  uint32_t threads; /* 0 counts as 1; the bytes do not depend on it */
  uint64_t seed;
  const char *source; /* recorded command */
} synth_desc;

typedef struct synth_stats {
  double seconds;       /* sampling and writing, without building the structure */
  double build_seconds; /* building the structure */
  uint64_t samples;     /* values written / channels */
  uint64_t triangles;   /* 0 for analytic materials, as are the following */
  uint64_t path_rays;   /* first hits and bounces */
  uint64_t shadow_rays;
  double embree_rays_per_second; /* Embree alone, same threads, shadow rays taken from this run */
} synth_stats;

/* Renders into a data-set folder at `path`. Progress and cancellation through `job` (may be NULL). On failure
 * nothing is left behind and btf_error_message() tells. `stats` may be NULL. */
btf_status synth_run(btf_context *ctx, const synth_desc *desc, const char *path, const btf_job *job,
                     synth_stats *stats);

/* Directions from a text file: three numbers a line, '#' starts a comment. */
btf_status synth_directions_load(btf_context *ctx, const char *path, btf_dirset **out);

/* ---- One texel at a time, for tests and pictures ---- */

typedef struct synth_sampler synth_sampler;

/* Of the description name, lights, sizes, spp, bounces, sampling and seed are used. */
btf_status synth_sampler_create(const synth_desc *desc, synth_sampler **out);
/* f for one texel, one view and all lights: 3 floats for each light. One thread at a time for each sampler.
 */
void synth_sampler_texel(synth_sampler *s, uint32_t x, uint32_t y, const float view[3], float *rgb);
/* What the view ray of the texel's centre meets: part number of the structure, position with z = 0 at the
 * reference plane. False for analytic materials. */
bool synth_sampler_hit(synth_sampler *s, uint32_t x, uint32_t y, const float view[3], uint32_t *part,
                       float position[3]);
void synth_sampler_free(synth_sampler *s);

#endif
