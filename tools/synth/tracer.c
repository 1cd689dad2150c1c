/* SPDX-License-Identifier: MIT */
#include "tracer.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "clones.h"
#include "trace/sampling.h"

/* Of every RECORD_PERIOD packets the first RECORD_RUN are kept, so that they are neighbours as in the run. */
#define RECORD_PERIOD 16384
#define RECORD_RUN 256
/* Gloss met after the first hit is at least this rough: sharp highlights seen by way of another surface would
 * be rare bright sparks at any affordable number of samples. The surface stays reciprocal and reflects as
 * much. */
#define ROUGHNESS_AFTER_BOUNCE 0.35f

static float inverse(float x) {
  return fabsf(x) > 1e-20f ? 1.0f / x : 1e20f;
}

btf_status tracer_lights_create(const btf_dirset *set, tracer_lights **out) {
  const uint32_t count = btf_dirset_count(set), padded = (count + 15) / 16 * 16;
  const float *xyz = btf_dirset_directions(set);
  tracer_lights *lights = calloc(1, sizeof *lights);
  float *memory = calloc((size_t)padded * 6, sizeof *memory);
  *out = NULL;
  if (lights == NULL || memory == NULL) {
    free(lights);
    free(memory);
    return btf_source_error(BTF_E_NOMEM, "lights: out of memory");
  }
  lights->count = count;
  lights->padded = padded;
  lights->x = memory;
  lights->y = memory + padded;
  lights->z = memory + 2 * (size_t)padded;
  lights->inverse_x = memory + 3 * (size_t)padded;
  lights->inverse_y = memory + 4 * (size_t)padded;
  lights->inverse_z = memory + 5 * (size_t)padded;
  for (uint32_t i = 0; i < padded; ++i) {
    lights->x[i] = i < count ? xyz[3 * i] : 0.0f;
    lights->y[i] = i < count ? xyz[3 * i + 1] : 0.0f;
    lights->z[i] = i < count ? xyz[3 * i + 2] : -1.0f;
    lights->inverse_x[i] = inverse(lights->x[i]);
    lights->inverse_y[i] = inverse(lights->y[i]);
    lights->inverse_z[i] = inverse(lights->z[i]);
  }
  *out = lights;
  return BTF_OK;
}

void tracer_lights_free(tracer_lights *lights) {
  if (lights == NULL) return;
  free(lights->x);
  free(lights);
}

btf_status tracer_create(const mesostructure *meso, const tracer_lights *lights, const synth_desc *desc,
                         uint32_t recorded_packets, tracer **out) {
  const size_t n = lights->padded;
  tracer *t = calloc(1, sizeof *t);
  *out = NULL;
  if (t != NULL) {
    t->meso = meso;
    t->lights = lights;
    t->width = desc->width;
    t->height = desc->height;
    t->spp = desc->spp;
    t->bounces = desc->bounces;
    t->sampling = desc->sampling;
    t->seed = sampling_hash((uint32_t)desc->seed, (uint32_t)(desc->seed >> 32));
    t->packet = aligned_alloc(64, sizeof *t->packet);
    t->valid = aligned_alloc(64, 16 * sizeof *t->valid);
    t->memory = aligned_alloc(64, 7 * n * sizeof *t->memory);
    t->asked = malloc(n * sizeof *t->asked);
    if (recorded_packets > 0) {
      t->record.packets = aligned_alloc(64, (size_t)recorded_packets * sizeof *t->record.packets);
      if (t->record.packets != NULL) t->record.room = recorded_packets;
    }
  }
  if (t == NULL || t->packet == NULL || t->valid == NULL || t->memory == NULL || t->asked == NULL) {
    tracer_free(t);
    return btf_source_error(BTF_E_NOMEM, "tracer: out of memory");
  }
  t->cosine_r = t->memory;
  t->cosine_g = t->memory + n;
  t->cosine_b = t->memory + 2 * n;
  t->visible = t->memory + 3 * n;
  t->sum_r = t->memory + 4 * n;
  t->sum_g = t->memory + 5 * n;
  t->sum_b = t->memory + 6 * n;
  memset(t->packet, 0, sizeof *t->packet);
  for (int i = 0; i < 16; ++i) t->packet->mask[i] = ~0u;
  *out = t;
  return BTF_OK;
}

void tracer_free(tracer *t) {
  if (t == NULL) return;
  free(t->packet);
  free(t->valid);
  free(t->memory);
  free(t->asked);
  free(t->record.packets);
  free(t);
}

/* Sends one ray to each of the `asked` lights (at most 16) and notes those that arrive. */
static void ask_packet(tracer *t, vec3 origin, const uint32_t *asked, uint32_t count) {
  const mesostructure *m = t->meso;
  const tracer_lights *lights = t->lights;
  struct RTCRay16 *rays = t->packet;
  const float to_top = m->top - origin.z;
  const float ahead_x = 1.0f + m->margin - origin.x, behind_x = -m->margin - origin.x;
  const float ahead_y = 1.0f + m->margin - origin.y, behind_y = -m->margin - origin.y;
  float vertical[16], sideways[16];
  for (uint32_t i = 0; i < 16; ++i) {
    const uint32_t l = asked[i < count ? i : 0];
    const float x = lights->x[l], y = lights->y[l];
    const float across_x = (x > 0.0f ? ahead_x : behind_x) * lights->inverse_x[l];
    const float across_y = (y > 0.0f ? ahead_y : behind_y) * lights->inverse_y[l];
    const float across = fabsf(across_x) < fabsf(across_y) ? fabsf(across_x) : fabsf(across_y);
    vertical[i] = to_top * lights->inverse_z[l];
    sideways[i] = across;
    t->valid[i] = i < count ? -1 : 0;
    rays->org_x[i] = origin.x;
    rays->org_y[i] = origin.y;
    rays->org_z[i] = origin.z;
    rays->dir_x[i] = x;
    rays->dir_y[i] = y;
    rays->dir_z[i] = lights->z[l];
    rays->tfar[i] = vertical[i] < across ? vertical[i] : across;
  }
  if (t->record.count < t->record.room && t->packets % RECORD_PERIOD < RECORD_RUN && count == 16)
    t->record.packets[t->record.count++] = *rays;
  ++t->packets;
  t->shadow_rays += count;
  trace_occluded16(m->scene, t->valid, rays);
  for (uint32_t i = 0; i < count; ++i) {
    const uint32_t l = asked[i];
    bool arrives = rays->tfar[i] >= 0.0f;
    if (arrives && sideways[i] < vertical[i]) {
      const vec3 direction = vec3_make(lights->x[l], lights->y[l], lights->z[l]);
      arrives = !meso_occluded(m, vec3_along(origin, sideways[i], direction), direction);
    }
    t->visible[l] = arrives ? 1.0f : 0.0f;
  }
}

/* Which lights reach a point whose cosines are in cosine_*; `visible` is 0 or 1 for each. */
static void ask_lights(tracer *t, vec3 origin) {
  const uint32_t count = t->lights->count;
  uint32_t asked = 0;
  memset(t->visible, 0, t->lights->padded * sizeof *t->visible);
  for (uint32_t l = 0; l < count; ++l)
    if (t->cosine_r[l] + t->cosine_g[l] + t->cosine_b[l] > 0.0f) t->asked[asked++] = l;
  /* Nothing lies above the top. */
  if (origin.z >= t->meso->top) {
    for (uint32_t i = 0; i < asked; ++i) t->visible[t->asked[i]] = 1.0f;
    return;
  }
  for (uint32_t i = 0; i < asked; i += 16)
    ask_packet(t, origin, t->asked + i, asked - i < 16 ? asked - i : 16);
}

VECTOR_CLONES
static void add_lit(uint32_t count, float weight, const float *restrict visible, const float *restrict cosine,
                    float *restrict sum) {
  for (uint32_t i = 0; i < count; ++i) sum[i] += weight * visible[i] * cosine[i];
}

bool tracer_first_hit(const tracer *t, float u, float v, vec3 view, surface_hit *hit) {
  /* Starting a little before the reference plane, along the same line, keeps surfaces in the plane in sight.
   */
  const vec3 start = vec3_along(vec3_make(u, v, t->meso->top), 16.0f * MESO_OFFSET, view);
  return meso_first_hit(t->meso, start, vec3_scale(view, -1.0f), hit);
}

/* The path of one sample, adding what all lights send along it. */
static void trace_path(tracer *t, float u, float v, vec3 view, uint32_t texel_seed, uint32_t sample) {
  float carried[3] = {1.0f, 1.0f, 1.0f};
  vec3 out = view;
  surface_hit hit;
  ++t->path_rays;
  if (!tracer_first_hit(t, u, v, view, &hit)) return;
  for (uint32_t bounce = 0;; ++bounce) {
    const tracer_lights *lights = t->lights;
    surface_brdf brdf;
    t->meso->material->shade(&hit, &brdf);
    if (bounce > 0) brdf.alpha = fmaxf(brdf.alpha, ROUGHNESS_AFTER_BOUNCE);
    /* An interpolated or bent normal that turns away from the viewer is no use. */
    if (vec3_dot(hit.normal, out) < 1e-3f) hit.normal = hit.facet;
    vec3 origin = vec3_along(hit.position, MESO_OFFSET, hit.facet);
    origin.x = meso_wrap(origin.x);
    origin.y = meso_wrap(origin.y);
    brdf_times_cosine(&brdf, hit.normal, hit.facet, out, lights->padded, lights->x, lights->y, lights->z,
                      t->cosine_r, t->cosine_g, t->cosine_b);
    ask_lights(t, origin);
    add_lit(lights->padded, carried[0], t->visible, t->cosine_r, t->sum_r);
    add_lit(lights->padded, carried[1], t->visible, t->cosine_g, t->sum_g);
    add_lit(lights->padded, carried[2], t->visible, t->cosine_b, t->sum_b);
    if (bounce == t->bounces) return;

    float choice, spare, x, y, weight[3];
    vec3 tangent, bitangent, local;
    sampling_pair(sampling_hash(texel_seed, 2 * bounce + 1), sample, &choice, &spare);
    sampling_pair(sampling_hash(texel_seed, 2 * bounce + 2), sample, &x, &y);
    vec3_frame(hit.normal, &tangent, &bitangent);
    const vec3 from = vec3_make(vec3_dot(out, tangent), vec3_dot(out, bitangent), vec3_dot(out, hit.normal));
    if (!brdf_sample(&brdf, from, choice, x, y, &local, weight)) return;
    const vec3 next = vec3_normalize(vec3_from_frame(tangent, bitangent, hit.normal, local));
    if (!(vec3_dot(next, hit.facet) > 0.0f)) return;
    for (int c = 0; c < 3; ++c) carried[c] *= weight[c];
    if (!(carried[0] + carried[1] + carried[2] > 0.0f)) return;
    ++t->path_rays;
    if (!meso_first_hit(t->meso, origin, next, &hit)) return;
    out = vec3_scale(next, -1.0f);
  }
}

void tracer_texel(tracer *t, uint32_t x, uint32_t y, vec3 view, float *dst, size_t light_step,
                  size_t channel_step) {
  const tracer_lights *lights = t->lights;
  const uint32_t texel_seed = sampling_hash(sampling_hash(t->seed, x), y);
  memset(t->sum_r, 0, 3 * (size_t)lights->padded * sizeof *t->sum_r);
  for (uint32_t sample = 0; sample < t->spp && !synth_watch_stops(t->watch); ++sample) {
    float jx = 0.5f, jy = 0.5f;
    if (t->sampling == SYNTH_SAMPLING_AREA) sampling_pair(sampling_hash(texel_seed, 0), sample, &jx, &jy);
    trace_path(t, ((float)x + jx) / (float)t->width, ((float)y + jy) / (float)t->height, view, texel_seed,
               sample);
  }
  for (uint32_t l = 0; l < lights->count; ++l) {
    const float scale = lights->inverse_z[l] / (float)t->spp;
    float *sample = dst + l * light_step;
    sample[0] = t->sum_r[l] * scale;
    sample[channel_step] = t->sum_g[l] * scale;
    sample[2 * channel_step] = t->sum_b[l] * scale;
  }
}

double tracer_embree_rate(const mesostructure *meso, const ray_record *record) {
  int *valid = aligned_alloc(64, 16 * sizeof *valid);
  struct RTCRay16 *rays = aligned_alloc(64, sizeof *rays);
  struct timespec start, now;
  double seconds = 0.0;
  uint64_t traced = 0;
  if (valid != NULL && rays != NULL && record->count > 0) {
    for (int i = 0; i < 16; ++i) valid[i] = -1;
    clock_gettime(CLOCK_MONOTONIC, &start);
    do {
      for (uint32_t i = 0; i < record->count; ++i) {
        *rays = record->packets[i];
        trace_occluded16(meso->scene, valid, rays);
      }
      traced += 16 * (uint64_t)record->count;
      clock_gettime(CLOCK_MONOTONIC, &now);
      seconds = (double)(now.tv_sec - start.tv_sec) + 1e-9 * (double)(now.tv_nsec - start.tv_nsec);
    } while (seconds < 0.1);
  }
  free(valid);
  free(rays);
  return seconds > 0.0 ? (double)traced / seconds : 0.0;
}
