/* SPDX-License-Identifier: MIT */
#include "render/render.h"

#include <math.h>
#include <stdlib.h>

#include "parallel.h"
#include "trace/sampling.h"

enum { TILE = 16, CAPACITY = 2048 };

/* Queries of a tile, evaluated in batches: what each adds to its pixel is f times its weight. */
typedef struct gathering {
  float light[3][CAPACITY], view[3][CAPACITY], uv[2][CAPACITY], lod[CAPACITY];
  float weight[3][CAPACITY];
  uint32_t pixel[CAPACITY];
  uint32_t count;
  float *values; /* channels x CAPACITY */
  float sum[TILE * TILE][3];
} gathering;

typedef struct picture {
  const render_desc *desc;
  cli *c;
  uint32_t channels, tiles_x, tiles_y;
  gathering **threads;
  float *rgb;
} picture;

render_camera render_camera_at(vec3 target, float azimuth, float elevation, float distance,
                               float vertical_field) {
  render_camera camera;
  const vec3 back =
      vec3_make(cosf(elevation) * cosf(azimuth), cosf(elevation) * sinf(azimuth), sinf(elevation));
  camera.position = vec3_along(target, distance, back);
  camera.forward = vec3_scale(back, -1.0f);
  /* taken from the azimuth alone, so that looking straight down is no special case */
  camera.right = vec3_make(-sinf(azimuth), cosf(azimuth), 0.0f);
  camera.up = vec3_cross(camera.right, camera.forward);
  camera.half_height = tanf(0.5f * vertical_field);
  return camera;
}

static vec3 camera_ray(const render_desc *d, float x, float y) {
  const float scale = 2.0f * d->camera.half_height / (float)d->height;
  const float right = (x - 0.5f * (float)d->width) * scale, up = (0.5f * (float)d->height - y) * scale;
  return vec3_normalize(vec3_along(vec3_along(d->camera.forward, right, d->camera.right), up, d->camera.up));
}

/* How u and v change from a point to where a neighbouring ray meets its tangent plane. */
static void footprint(const render_desc *d, const scene_point *p, vec3 neighbour, float scale, float duv[2]) {
  const float facing = vec3_dot(neighbour, p->facet_normal);
  duv[0] = duv[1] = 0.0f;
  if (facing >= -1e-3f) return;
  const float distance = vec3_dot(vec3_sub(p->position, d->camera.position), p->facet_normal) / facing;
  const vec3 moved = vec3_sub(vec3_along(d->camera.position, distance, neighbour), p->position);
  const float uu = vec3_dot(p->dpdu, p->dpdu), uv = vec3_dot(p->dpdu, p->dpdv),
              vv = vec3_dot(p->dpdv, p->dpdv);
  const float determinant = uu * vv - uv * uv;
  if (determinant <= 1e-12f * uu * vv) return;
  const float mu = vec3_dot(moved, p->dpdu), mv = vec3_dot(moved, p->dpdv);
  duv[0] = scale * (mu * vv - mv * uv) / determinant;
  duv[1] = scale * (mv * uu - mu * uv) / determinant;
}

static vec3 to_local(const scene_point *p, vec3 world) {
  return vec3_make(vec3_dot(world, p->tangent), vec3_dot(world, p->bitangent), vec3_dot(world, p->normal));
}

static void flush(const picture *p, gathering *g) {
  btf_batch batch = BTF_BATCH_INIT;
  float *out[64];
  batch.count = g->count;
  for (int k = 0; k < 3; k++) {
    batch.light[k] = g->light[k];
    batch.view[k] = g->view[k];
  }
  batch.uv[0] = g->uv[0];
  batch.uv[1] = g->uv[1];
  batch.lod = g->lod;
  for (uint32_t c = 0; c < p->channels; c++) out[c] = g->values + (size_t)c * CAPACITY;
  btf_model_eval_n(p->desc->model, &batch, BTF_VALUE_BRDF, out);
  for (int c = 0; c < 3; c++) {
    const float *f = out[p->channels >= 3 ? c : 0];
    for (uint32_t i = 0; i < g->count; i++) g->sum[g->pixel[i]][c] += f[i] * g->weight[c][i];
  }
  g->count = 0;
}

/* Adds f * cos * irradiance of light from a direction, if it arrives. */
static void gather(const picture *p, gathering *g, uint32_t pixel, const scene_point *point, vec3 view,
                   float lod, vec3 direction, vec3 irradiance) {
  const vec3 light = to_local(point, direction);
  /* The horizon is that of the smooth surface: facets stand for it only. */
  if (light.z <= 0.0f || scene_blocked(p->desc->surface, point, direction)) return;
  if (g->count == CAPACITY) flush(p, g);
  const uint32_t i = g->count++;
  const float light_axes[3] = {light.x, light.y, light.z}, view_axes[3] = {view.x, view.y, view.z};
  const float weights[3] = {irradiance.x, irradiance.y, irradiance.z};
  for (int k = 0; k < 3; k++) {
    g->light[k][i] = light_axes[k];
    g->view[k][i] = view_axes[k];
    g->weight[k][i] = weights[k] * light.z;
  }
  g->uv[0][i] = point->u;
  g->uv[1][i] = point->v;
  g->lod[i] = lod;
  g->pixel[i] = pixel;
}

/* One light from the map and one from the cosine, weighted by the balance heuristic (Veach and Guibas 1995).
 */
static void gather_environment(const picture *p, gathering *g, uint32_t pixel, const scene_point *point,
                               vec3 view, float lod, uint32_t seed, uint32_t sample) {
  const environment *e = p->desc->environment;
  for (uint32_t strategy = 0; strategy < 2; strategy++) {
    float x, y, density;
    vec3 direction;
    sampling_pair(sampling_hash(seed, strategy + 1), sample, &x, &y);
    if (strategy == 0) {
      density = environment_sample(e, x, y, &direction);
    } else {
      direction = vec3_from_frame(point->tangent, point->bitangent, point->normal, sampling_cosine(x, y));
      density = environment_density(e, direction);
    }
    const float cosine = vec3_dot(direction, point->normal);
    if (cosine <= 0.0f) continue;
    const vec3 radiance = environment_radiance(e, direction);
    gather(p, g, pixel, point, view, lod, direction,
           vec3_scale(radiance, 1.0f / (density + cosine / SAMPLING_PI)));
  }
}

static void shade(const picture *p, gathering *g, uint32_t pixel, float x, float y, uint32_t seed,
                  uint32_t sample) {
  const render_desc *d = p->desc;
  const vec3 ray = camera_ray(d, x, y);
  scene_point point;
  if (!scene_hit(d->surface, d->camera.position, ray, &point)) {
    const vec3 seen = d->show_environment && d->environment != NULL
                          ? environment_radiance(d->environment, ray)
                          : d->background;
    g->sum[pixel][0] += seen.x;
    g->sum[pixel][1] += seen.y;
    g->sum[pixel][2] += seen.z;
    return;
  }
  vec3 view = to_local(&point, vec3_scale(ray, -1.0f));
  /* An interpolated normal can turn away where its facet does not: such points are seen at grazing angle. */
  view.z = fmaxf(view.z, 1e-3f);
  view = vec3_normalize(view);
  float lod = 0.0f;
  if (!d->finest_level) {
    /* each sample stands for its share of the pixel */
    const float share = 1.0f / sqrtf((float)d->spp);
    float duvdx[2], duvdy[2];
    footprint(d, &point, camera_ray(d, x + 1.0f, y), share, duvdx);
    footprint(d, &point, camera_ray(d, x, y + 1.0f), share, duvdy);
    lod = btf_model_lod(d->model, duvdx, duvdy);
  }
  if (d->light_irradiance > 0.0f) {
    const float e = d->light_irradiance;
    gather(p, g, pixel, &point, view, lod, d->light, vec3_make(e, e, e));
  }
  if (d->environment != NULL) gather_environment(p, g, pixel, &point, view, lod, seed, sample);
}

static bool render_tile(void *user, uint64_t index, uint32_t thread) {
  const picture *p = user;
  const render_desc *d = p->desc;
  gathering *g = p->threads[thread];
  const uint32_t x0 = (uint32_t)(index % p->tiles_x) * TILE, y0 = (uint32_t)(index / p->tiles_x) * TILE;
  if (thread == 0 && cli_progress(p->c, (double)index / ((double)p->tiles_x * p->tiles_y), "rendering"))
    return false;
  for (uint32_t i = 0; i < TILE * TILE; i++) g->sum[i][0] = g->sum[i][1] = g->sum[i][2] = 0.0f;
  for (uint32_t y = y0; y < y0 + TILE && y < d->height; y++)
    for (uint32_t x = x0; x < x0 + TILE && x < d->width; x++) {
      const uint32_t seed = sampling_hash(d->seed, sampling_hash(x, y));
      for (uint32_t sample = 0; sample < d->spp; sample++) {
        float jitter_x = 0.5f, jitter_y = 0.5f;
        if (d->spp > 1) sampling_pair(seed, sample, &jitter_x, &jitter_y);
        shade(p, g, (y - y0) * TILE + (x - x0), (float)x + jitter_x, (float)y + jitter_y, seed, sample);
      }
    }
  flush(p, g);
  for (uint32_t y = y0; y < y0 + TILE && y < d->height; y++)
    for (uint32_t x = x0; x < x0 + TILE && x < d->width; x++)
      for (int c = 0; c < 3; c++)
        p->rgb[3 * ((size_t)y * d->width + x) + (size_t)c] =
            g->sum[(y - y0) * TILE + (x - x0)][c] / (float)d->spp;
  return !cli_interrupted();
}

int render_picture(cli *c, const render_desc *desc, float *rgb) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_model_describe(desc->model, &info);
  picture p = {desc, c,  info.channels, (desc->width + TILE - 1) / TILE, (desc->height + TILE - 1) / TILE,
               NULL, rgb};
  int status = EXIT_DONE;
  p.threads = calloc(desc->threads, sizeof *p.threads);
  if (p.threads == NULL) return cli_out_of_memory();
  for (uint32_t t = 0; t < desc->threads; t++) {
    p.threads[t] = calloc(1, sizeof **p.threads);
    if (p.threads[t] != NULL) p.threads[t]->values = malloc(sizeof(float) * CAPACITY * p.channels);
    if (p.threads[t] == NULL || p.threads[t]->values == NULL) status = cli_out_of_memory();
    if (status != EXIT_DONE) break;
  }
  if (status == EXIT_DONE && !parallel_for(desc->threads, (uint64_t)p.tiles_x * p.tiles_y, render_tile, &p))
    status = cli_fail_interrupted();
  cli_progress_done(c);
  for (uint32_t t = 0; t < desc->threads; t++) {
    if (p.threads[t] != NULL) free(p.threads[t]->values);
    free(p.threads[t]);
  }
  free(p.threads);
  return status;
}
