/* SPDX-License-Identifier: MIT */
#include "copy_codec.h"

#include <stdlib.h>
#include <string.h>

#include <btf/btf_sampling.h>

enum { TAG_SAMPLES = BTF_TAG('S', 'M', 'P', 'L'), TAG_GAIN = BTF_TAG('G', 'A', 'I', 'N') };

typedef struct copy_state {
  const btf_host *host;
  btf_model_shape shape;
  const float *samples; /* view, light, y, x, channel */
  float gain;
} copy_state;

static const btf_param_desc gain = {sizeof gain, "gain", "Factor of every sample.", NULL, "1", NULL,
                                    0.0,         10.0,   BTF_PARAM_FLOAT,           0};
static const btf_param_desc rounds = {
    sizeof rounds, "rounds", "How often progress is told.", NULL, "3", NULL, 1.0, 1024.0, BTF_PARAM_INT, 0};
static const btf_param_desc blocked = {
    sizeof blocked, "blocked", "Read view by view.", NULL, "false", NULL, 0.0, 0.0, BTF_PARAM_BOOL, 0};
static const char *const storages[] = {"plain", "packed", NULL};
static const btf_param_desc storage = {
    sizeof storage,   "storage", "How samples are stored.", NULL, "plain", storages, 0.0, 0.0,
    BTF_PARAM_CHOICE, 0};
static const btf_param_desc note = {sizeof note, "note", "Kept by nobody.", NULL, "", NULL,
                                    0.0,         0.0,    BTF_PARAM_STRING,  0};
static const btf_param_desc *const params[] = {&gain, &rounds, &blocked, &storage, &note, NULL};

static btf_status copy_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                           const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  const int plain = host->option(options, "storage") == 0.0;
  const uint32_t stages = (uint32_t)host->option(options, "rounds");
  const float factor = (float)host->option(options, "gain");
  btf_block block;
  btf_strides strides;
  uint64_t count;
  void *samples;
  btf_status status = host->dataset_describe(ds, &desc);
  if (status != BTF_OK) return status;
  block = (btf_block){
      0, host->dirset_count(desc.views), 0, host->dirset_count(desc.lights), 0, 0, desc.width, desc.height};
  strides.channel = 4;
  strides.x = 4 * (ptrdiff_t)desc.channels;
  strides.y = strides.x * (ptrdiff_t)desc.width;
  strides.light = strides.y * (ptrdiff_t)desc.height;
  strides.view = strides.light * (ptrdiff_t)block.lights;
  count = (uint64_t)block.views * (uint64_t)strides.view / 4;
  status = host->reserve(payload, TAG_SAMPLES, 0, plain ? BTF_PAYLOAD_IN_PLACE : 0, count * 4, &samples);
  if (status != BTF_OK) return status;
  for (uint32_t i = 0; i < stages; i++) {
    status = host->progress(job, (double)i / stages, i % 2 == 0 ? "even" : "odd");
    if (status != BTF_OK) return status;
  }
  if (host->option(options, "blocked") != 0.0) {
    const uint32_t views = block.views;
    for (block.view0 = 0, block.views = 1; block.view0 < views && status == BTF_OK; block.view0++)
      status =
          host->dataset_read(ds, &block, (float *)((char *)samples + block.view0 * strides.view), &strides);
  } else {
    status = host->dataset_read(ds, &block, samples, &strides);
  }
  if (status != BTF_OK) return status;
  for (uint64_t i = 0; i < count; i++) ((float *)samples)[i] *= factor;
  status = host->put(payload, TAG_GAIN, 0, 0, &factor, sizeof factor);
  if (status == BTF_OK) status = host->put(payload, TAG_GAIN, 7, 0, NULL, 0);
  (void)ctx;
  return status;
}

static btf_status copy_load(const btf_host *host, btf_context *ctx, uint32_t format,
                            const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  const uint64_t expected = (uint64_t)host->dirset_count(shape->views) * host->dirset_count(shape->lights) *
                            shape->width * shape->height * shape->channels * 4;
  const void *samples, *factor;
  uint64_t size, factor_size;
  copy_state *s;
  btf_status status = host->get(payload, TAG_SAMPLES, 0, &samples, &size);
  (void)format;
  if (status == BTF_OK) status = host->get(payload, TAG_GAIN, 0, &factor, &factor_size);
  if (status != BTF_OK) return status;
  if (size != expected || factor_size != 4)
    return host->fail(ctx, BTF_E_CORRUPT, "copy: %llu bytes of samples; expected %llu",
                      (unsigned long long)size, (unsigned long long)expected);
  if (!host->has(payload, TAG_GAIN, 7) || host->has(payload, TAG_GAIN, 8))
    return host->fail(ctx, BTF_E_CORRUPT, "copy: the empty chunk is missing");
  s = host->alloc(ctx, 1, sizeof *s);
  if (s == NULL) return BTF_E_NOMEM;
  s->host = host;
  s->shape = *shape;
  s->samples = samples;
  memcpy(&s->gain, factor, 4);
  *state = s;
  return BTF_OK;
}

static void copy_destroy(const btf_host *host, btf_context *ctx, void *state) {
  host->free(ctx, state);
}
static uint32_t copy_levels(const void *state) {
  return state != NULL ? 1u : 0u;
}
static uint64_t copy_resident(const void *state) {
  const copy_state *s = state;
  return (uint64_t)s->host->dirset_count(s->shape.views) * s->host->dirset_count(s->shape.lights) *
         s->shape.width * s->shape.height * s->shape.channels * 4;
}

static void fetch(const copy_state *s, uint32_t x, uint32_t y, uint32_t light, uint32_t view, float *out,
                  size_t stride) {
  const uint64_t lights = s->host->dirset_count(s->shape.lights);
  const float *p = s->samples + ((((view * lights + light) * s->shape.height + y) * s->shape.width + x)) *
                                    s->shape.channels;
  for (uint32_t c = 0; c < s->shape.channels; c++) out[c * stride] = p[c];
}

static void copy_eval(const void *state, const btf_query *q, float *out) {
  const copy_state *s = state;
  fetch(s, btf_sampling_nearest(q->uv[0], s->shape.width, s->shape.wrap),
        btf_sampling_nearest(q->uv[1], s->shape.height, s->shape.wrap),
        s->host->dirset_nearest(s->shape.lights, q->light), s->host->dirset_nearest(s->shape.views, q->view),
        out, 1);
}

static void copy_eval_n(const void *state, const btf_batch *b, float *const *out) {
  const copy_state *s = state;
  for (size_t i = 0; i < b->count; i++) {
    const float light[3] = {b->light[0][i], b->light[1][i], b->light[2][i]};
    const float view[3] = {b->view[0][i], b->view[1][i], b->view[2][i]};
    float values[64];
    fetch(s, btf_sampling_nearest(b->uv[0][i], s->shape.width, s->shape.wrap),
          btf_sampling_nearest(b->uv[1][i], s->shape.height, s->shape.wrap),
          s->host->dirset_nearest(s->shape.lights, light), s->host->dirset_nearest(s->shape.views, view),
          values, 1);
    for (uint32_t c = 0; c < s->shape.channels; c++) out[c][i] = values[c];
  }
}

static void copy_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                       uint32_t view, float *out) {
  (void)level;
  fetch(state, x, y, light, view, out, 1);
}

#define COPY_CODEC(id_, caps_, eval_n_)                                                                      \
  {                                                                                                          \
    .struct_size = sizeof(btf_codec_vtbl), .abi = LIBBTF_ABI, .id = id_, .title = "Keeps every sample",      \
    .version = "1", .caps = caps_, .params = params, .format_read_min = 1, .format_write = 2,                \
    .fit = copy_fit, .load = copy_load, .destroy = copy_destroy, .levels = copy_levels,                      \
    .resident_bytes = copy_resident, .eval = copy_eval, .eval_n = eval_n_, .texel = copy_texel               \
  }

const btf_codec_vtbl copy_codec = COPY_CODEC("org.libbtf.copy", BTF_CAP_FIT | BTF_CAP_BATCH, copy_eval_n);
const btf_codec_vtbl copy_codec_single = COPY_CODEC("org.libbtf.copy1", BTF_CAP_FIT, NULL);

const float *copy_codec_samples(const void *state) {
  return ((const copy_state *)state)->samples;
}

/* ---- data ---- */

typedef struct copy_source {
  uint32_t channels;
} copy_source;

float copy_codec_sample(uint32_t view, uint32_t light, uint32_t x, uint32_t y, uint32_t channel) {
  return 0.25f + 0.125f * (float)((view * 5u + light * 3u + x * 7u + y * 11u + channel * 13u) % 31u) +
         (float)(view + light) / 64.0f;
}

static btf_status read_block(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  const copy_source *source = user;
  for (uint32_t v = 0; v < block->views; v++)
    for (uint32_t l = 0; l < block->lights; l++)
      for (uint32_t y = 0; y < block->height; y++)
        for (uint32_t x = 0; x < block->width; x++)
          for (uint32_t c = 0; c < source->channels; c++) {
            const float value =
                copy_codec_sample(block->view0 + v, block->light0 + l, block->x0 + x, block->y0 + y, c);
            memcpy((char *)dst + (ptrdiff_t)v * strides->view + (ptrdiff_t)l * strides->light +
                       (ptrdiff_t)y * strides->y + (ptrdiff_t)x * strides->x +
                       (ptrdiff_t)c * strides->channel,
                   &value, sizeof value);
          }
  return BTF_OK;
}

static void release_source(void *user) {
  free(user);
}

btf_dataset *copy_codec_dataset(btf_context *ctx, uint32_t width, uint32_t height, uint32_t channels,
                                uint32_t quantity) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_dirset *set;
  btf_dataset *ds = NULL;
  copy_source *source = malloc(sizeof *source);
  if (source == NULL) return NULL;
  source->channels = channels;
  if (btf_dirset_create_named(ctx, "grid:3x2", &set) != BTF_OK) {
    free(source);
    return NULL;
  }
  desc.lights = desc.views = set;
  desc.width = width;
  desc.height = height;
  desc.channels = channels;
  desc.quantity = quantity;
  desc.read = read_block;
  desc.user = source;
  desc.release = release_source;
  desc.name = "test cloth";
  desc.license = "CC0";
  desc.texels_per_mm = 2.5;
  if (btf_dataset_create(ctx, &desc, &ds) != BTF_OK) ds = NULL;
  btf_dirset_release(set);
  return ds;
}
