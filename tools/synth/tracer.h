/* SPDX-License-Identifier: MIT */
/*
 * tracer.h: samples of a mesostructure for one texel, one view and all lights at once.
 *
 * The path from the viewer does not depend on the light, so one path serves all lights: at each of its
 * vertices every light gets a shadow ray. Noise of the interreflection is then the same for all lights and
 * spoils no light slice.
 */
#ifndef BTF_TOOLS_SYNTH_TRACER_H
#define BTF_TOOLS_SYNTH_TRACER_H

#include "mesostructure.h"

typedef struct tracer_lights {
  uint32_t count, padded; /* padded to a multiple of 16 with directions below the horizon */
  float *x, *y, *z, *inverse_x, *inverse_y, *inverse_z;
} tracer_lights;

btf_status tracer_lights_create(const btf_dirset *set, tracer_lights **out);
void tracer_lights_free(tracer_lights *lights);

/* What a run keeps of its shadow rays, to ask Embree for them again without shading. */
typedef struct ray_record {
  struct RTCRay16 *packets;
  uint32_t count, room;
} ray_record;

/* Working state of one thread. */
typedef struct tracer {
  const mesostructure *meso;
  const tracer_lights *lights;
  uint32_t width, height, spp, bounces, sampling;
  uint32_t seed;
  struct RTCRay16 *packet;
  int *valid;
  float *memory, *cosine_r, *cosine_g, *cosine_b, *visible, *sum_r, *sum_g, *sum_b;
  uint32_t *asked;
  uint64_t path_rays, shadow_rays, packets;
  ray_record record;  /* room 0 = nothing is kept */
  synth_watch *watch; /* NULL = nobody asks to stop */
} tracer;

btf_status tracer_create(const mesostructure *meso, const tracer_lights *lights, const synth_desc *desc,
                         uint32_t recorded_packets, tracer **out);
void tracer_free(tracer *t);

/* f of one texel and view for every light; the sample of light l and channel c goes to dst[l * light_step +
 * c * channel_step]. When the watch stops it, what is written is of no use. */
void tracer_texel(tracer *t, uint32_t x, uint32_t y, vec3 view, float *dst, size_t light_step,
                  size_t channel_step);
/* The first hit behind a point of the reference plane. */
bool tracer_first_hit(const tracer *t, float u, float v, vec3 view, surface_hit *hit);

/* Rays a second of Embree alone on the recorded packets of one thread. */
double tracer_embree_rate(const mesostructure *meso, const ray_record *record);

#endif
