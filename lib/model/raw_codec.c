/* SPDX-License-Identifier: MIT */
/* The reference that every codec is measured against: the samples themselves, interpolated over 3 lights, 3
 * views, 4 texels and 2 levels. Coarser levels are averaged from the finest samples when they are asked for,
 * so that nothing is stored beside the data; all sums are in double. */
#include "model/model.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include <btf/btf_half.h>
#include <btf/btf_plugin.h>
#include <btf/btf_sampling.h>

#include "dataset/dataset.h"

enum { channels_most = 64 };

typedef struct raw_state {
  const char *samples; /* those of the data set, or `copy` */
  btf_strides strides;
  const btf_interp *own_lights; /* of samples whose lights differ between views, else NULL */
  uint32_t sample_type, width, height, channels, levels, wrap, light_count;
  const btf_dirset *lights, *views;
  btf_dataset *dataset;
  void *copy;
  uint64_t bytes;
} raw_state;

/* ---- making ---- */

/* Goes from floats back to the sample type the source had them in: exact, for they came from there. */
static void store(uint32_t sample_type, const float *src, char *dst, size_t n) {
  for (size_t i = 0; i < n; ++i) {
    const uint16_t half = sample_type == BTF_SAMPLE_F16   ? btf_float_to_half(src[i])
                          : sample_type == BTF_SAMPLE_U16 ? (uint16_t)lrintf(src[i] * 65535.0f)
                                                          : 0;
    const uint8_t byte = sample_type == BTF_SAMPLE_U8 ? (uint8_t)lrintf(src[i] * 255.0f) : 0;
    if (sample_type == BTF_SAMPLE_U8)
      memcpy(dst + i, &byte, 1);
    else if (sample_type == BTF_SAMPLE_F32)
      memcpy(dst + 4 * i, &src[i], 4);
    else
      memcpy(dst + 2 * i, &half, 2);
  }
}

/* Reads a streamed source into memory, image by image. Interpolated samples are not of the source's type. */
static btf_status read_all(raw_state *s, const btf_dataset_desc *d, const btf_job *job) {
  btf_context *ctx = btfi_dataset_context(s->dataset);
  const uint32_t views = btf_dirset_count(d->views), lights = btf_dirset_count(d->lights);
  if (d->view_lights) s->sample_type = BTF_SAMPLE_F32;
  const uint32_t size = btfi_sample_size(s->sample_type);
  const uint64_t image = (uint64_t)d->width * d->height * d->channels; /* fits, as the data set has checked */
  uint64_t samples, bytes;
  if (!btfi_mul(image, (uint64_t)views * lights, &samples) || !btfi_mul(samples, size, &bytes) ||
      bytes > INT64_MAX)
    return btfi_fail(ctx, BTF_E_LIMIT, "raw model: the samples do not fit into memory");
  s->copy = btfi_alloc(ctx, samples, size);
  if (!s->copy) return btfi_alloc_status();
  /* As many images at once as fit into 16 MiB, so that texel-major sources are not read again for each. */
  const uint32_t at_once = (uint32_t)BTFI_MIN(BTFI_MAX(((uint64_t)4 << 20) / image, 1u), lights);
  float *floats = btfi_alloc(ctx, image * at_once, sizeof *floats);
  if (!floats) return btfi_alloc_status();
  const ptrdiff_t f = (ptrdiff_t)sizeof(float), c = f * (ptrdiff_t)d->channels, row = c * (ptrdiff_t)d->width,
                  all = row * (ptrdiff_t)d->height;
  const btf_strides dense = {all * (ptrdiff_t)at_once, all, row, c, f};
  btf_status status = BTF_OK;
  for (uint32_t v = 0; v < views && status == BTF_OK; ++v)
    for (uint32_t l = 0; l < lights && status == BTF_OK; l += at_once) {
      const uint32_t n = BTFI_MIN(at_once, lights - l);
      const btf_block block = {v, 1, l, n, 0, 0, d->width, d->height};
      const uint64_t first = (uint64_t)v * lights + l;
      status = btf_dataset_read(s->dataset, &block, floats, &dense);
      if (status == BTF_OK)
        store(s->sample_type, floats, (char *)s->copy + first * image * size, (size_t)(n * image));
      if (status == BTF_OK)
        status = btfi_progress(job, (double)(first + n) / ((double)views * lights), "reading");
    }
  btfi_free(ctx, floats);
  const ptrdiff_t scale = f / (ptrdiff_t)size;
  s->samples = s->copy;
  s->strides.channel = (ptrdiff_t)size;
  s->strides.x = c / scale;
  s->strides.y = row / scale;
  s->strides.light = all / scale;
  s->strides.view = s->strides.light * (ptrdiff_t)lights;
  return status;
}

static void raw_destroy(const btf_host *host, btf_context *ctx, void *state) {
  raw_state *s = state;
  (void)host;
  if (!s) return;
  btfi_free(ctx, s->copy);
  btf_dataset_release(s->dataset);
  btfi_free(ctx, s);
}

btf_status btfi_raw_state(const btf_dataset *ds, const btf_job *job, void **state) {
  btf_context *ctx = btfi_dataset_context(ds);
  const btf_dataset_desc *d = btfi_dataset_desc(ds);
  raw_state *s = btfi_calloc(ctx, 1, sizeof *s);
  *state = NULL;
  if (!s) return btfi_alloc_status();
  s->dataset = btf_dataset_retain(ds);
  s->lights = d->lights;
  s->views = d->views;
  s->light_count = btf_dirset_count(d->lights);
  s->sample_type = d->sample_type;
  s->width = d->width;
  s->height = d->height;
  s->channels = d->channels;
  s->wrap = d->wrap;
  s->levels = btfi_mip_count(d->width, d->height);
  btf_status status = BTF_OK;
  if (d->data) {
    s->samples = d->data;
    s->strides = d->strides;
    s->own_lights = btfi_dataset_light_weights(ds);
    status = btfi_dataset_check_finite(ds, job);
  } else {
    status = read_all(s, d, job);
  }
  if (status != BTF_OK) {
    raw_destroy(NULL, ctx, s);
    return status;
  }
  s->bytes = (uint64_t)btf_dirset_count(d->views) * s->light_count * d->width * d->height * d->channels *
             btfi_sample_size(s->sample_type);
  *state = s;
  return BTF_OK;
}

/* ---- evaluation ---- */

/* Adds weight times the texel of one image, given by its first sample. A sample that is not finite
 * counts as 0: none was there when the model was made, but a mapped file can change. */
static inline void add_texel(const raw_state *s, const char *image, uint32_t x, uint32_t y, double weight,
                             double *sum) {
  const char *sample = image + (ptrdiff_t)y * s->strides.y + (ptrdiff_t)x * s->strides.x;
  for (uint32_t c = 0; c < s->channels; ++c, sample += s->strides.channel) {
    const float value = btfi_sample_to_float(s->sample_type, sample);
    if (fabsf(value) <= FLT_MAX) sum[c] += weight * (double)value;
  }
}

/* Adds weight times one texel of a level: the area average of the finest texels it covers. */
static void add_level_texel(const raw_state *s, const char *image, uint32_t level, uint32_t x, uint32_t y,
                            double weight, double *sum) {
  if (level == 0) {
    add_texel(s, image, x, y, weight, sum);
    return;
  }
  const uint32_t width = btf_sampling_level_size(s->width, level),
                 height = btf_sampling_level_size(s->height, level);
  btfi_mip_span sx, sy;
  btfi_mip_span_of(s->width, width, x, &sx);
  btfi_mip_span_of(s->height, height, y, &sy);
  const double scale = weight / ((double)s->width / width * ((double)s->height / height));
  for (uint32_t j = 0; j < sy.count; ++j)
    for (uint32_t i = 0; i < sx.count; ++i)
      add_texel(s, image, sx.first + i, sy.first + j,
                scale * btfi_mip_weight(&sy, j) * btfi_mip_weight(&sx, i), sum);
}

/* Where an image of the source lies. */
static inline const char *image_at(const raw_state *s, uint32_t light, uint32_t view) {
  return s->samples + (ptrdiff_t)view * s->strides.view + (ptrdiff_t)light * s->strides.light;
}

/* Adds weight times a texel of the sample (light, view) that everybody sees. */
static void add_sample(const raw_state *s, uint32_t light, uint32_t view, uint32_t level, uint32_t x,
                       uint32_t y, double weight, double *sum) {
  if (!s->own_lights) {
    add_level_texel(s, image_at(s, light, view), level, x, y, weight, sum);
    return;
  }
  const btf_interp *own = &s->own_lights[(size_t)view * s->light_count + light];
  for (int k = 0; k < 3; ++k)
    if (own->weight[k] > 0.0f)
      add_level_texel(s, image_at(s, own->index[k], view), level, x, y, weight * (double)own->weight[k], sum);
}

static void write_out(const raw_state *s, const double *sum, float *out) {
  for (uint32_t c = 0; c < s->channels; ++c) out[c] = (float)sum[c];
}

static void add_bilinear(const raw_state *s, uint32_t light, uint32_t view, uint32_t level,
                         const btf_bilinear *texels, double weight, double *sum) {
  for (int j = 0; j < 2; ++j)
    for (int i = 0; i < 2; ++i) {
      const double w = weight * (double)texels->wx[i] * (double)texels->wy[j];
      if (w > 0.0) add_sample(s, light, view, level, texels->x[i], texels->y[j], w, sum);
    }
}

static void eval_nearest(const raw_state *s, const btf_query *q, float *out) {
  double sum[channels_most] = {0.0};
  const uint32_t level = btf_sampling_nearest_level(q->lod, s->levels);
  const uint32_t width = btf_sampling_level_size(s->width, level),
                 height = btf_sampling_level_size(s->height, level);
  add_sample(s, btf_dirset_nearest(s->lights, q->light), btf_dirset_nearest(s->views, q->view), level,
             btf_sampling_nearest(q->uv[0], width, s->wrap), btf_sampling_nearest(q->uv[1], height, s->wrap),
             1.0, sum);
  write_out(s, sum, out);
}

static void raw_eval(const void *state, const btf_query *q, float *out) {
  const raw_state *s = state;
  if (q->flags & BTF_QUERY_NEAREST) {
    eval_nearest(s, q, out);
    return;
  }
  double sum[channels_most] = {0.0};
  btf_interp lights, views;
  btf_level_pair levels;
  btf_dirset_locate(s->lights, q->light, &lights);
  btf_dirset_locate(s->views, q->view, &views);
  btf_sampling_levels(q->lod, s->levels, &levels);
  for (int k = 0; k < 2; ++k) {
    if (!(levels.weight[k] > 0.0f)) continue;
    btf_bilinear texels;
    btf_sampling_bilinear(q->uv[0], q->uv[1], btf_sampling_level_size(s->width, levels.level[k]),
                          btf_sampling_level_size(s->height, levels.level[k]), s->wrap, &texels);
    for (int v = 0; v < 3; ++v)
      for (int l = 0; l < 3; ++l) {
        const double weight = (double)levels.weight[k] * (double)views.weight[v] * (double)lights.weight[l];
        if (weight > 0.0)
          add_bilinear(s, lights.index[l], views.index[v], levels.level[k], &texels, weight, sum);
      }
  }
  write_out(s, sum, out);
}

static void raw_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                      uint32_t view, float *out) {
  const raw_state *s = state;
  double sum[channels_most] = {0.0};
  add_sample(s, light, view, level, x, y, 1.0, sum);
  write_out(s, sum, out);
}

static uint32_t raw_levels(const void *state) {
  return ((const raw_state *)state)->levels;
}
static uint64_t raw_resident_bytes(const void *state) {
  return ((const raw_state *)state)->bytes;
}

const btf_codec_vtbl btfi_raw_codec = {
    .struct_size = sizeof(btf_codec_vtbl),
    .abi = LIBBTF_ABI,
    .id = "raw",
    .title = "the samples of a data set, interpolated",
    .version = "1",
    .caps = BTF_CAP_LOD | BTF_CAP_LINEAR,
    .destroy = raw_destroy,
    .levels = raw_levels,
    .resident_bytes = raw_resident_bytes,
    .eval = raw_eval,
    .texel = raw_texel,
};
