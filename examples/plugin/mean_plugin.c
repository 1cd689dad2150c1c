/* SPDX-License-Identifier: MIT */
/*
 * A codec as a plug-in, in full. "org.example.mean" keeps two averages of a material, its mean colour at each
 * texel and its mean reflectance for each pair of light and view, and evaluates their product: what is left
 * of a material when texture and direction know nothing of each other. Other codecs must do better.
 *
 *   cc -shared -fPIC mean_plugin.c $(pkg-config --cflags libbtf) -o org.example.mean.so
 *   btf encode wool.btfd -o wool.btfz --codec org.example.mean --plugin $PWD/org.example.mean.so
 *
 * A plug-in links against nothing: all it needs of the library comes through the host table.
 */
#include <btf/btf_plugin.h>
#include <btf/btf_sampling.h>

#define TEXTURE BTF_TAG('T', 'E', 'X', ' ') /* height x width x channels floats */
#define ANGULAR BTF_TAG('A', 'N', 'G', ' ') /* views x lights x channels floats, 1 on average */

static const btf_param_desc contrast = {
    .struct_size = sizeof contrast,
    .name = "contrast",
    .type = BTF_PARAM_FLOAT,
    .default_text = "1",
    .maximum = 1.0,
    .summary = "How much of the texture is kept: 1 all of it, 0 its mean colour."};
static const btf_param_desc *const params[] = {&contrast, NULL};

/* The data set is read image by image, so that any size of it fits in memory. */
static btf_status mean_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                           const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_status status = host->dataset_describe(ds, &desc);
  if (status != BTF_OK) return status;
  const uint32_t views = host->dirset_count(desc.views), lights = host->dirset_count(desc.lights);
  const uint32_t channels = desc.channels;
  const uint64_t texels = (uint64_t)desc.width * desc.height, pairs = (uint64_t)views * lights;
  const btf_strides strides = {0, 0, 4 * (ptrdiff_t)channels * desc.width, 4 * (ptrdiff_t)channels, 4};
  const float keep = (float)host->option(options, "contrast");
  void *texture_chunk, *angular_chunk;
  double mean[64] = {0.0};

  /* Memory of the payload, zeroed; in place means: used straight from the file when it is mapped. */
  status = host->reserve(payload, TEXTURE, 0, BTF_PAYLOAD_IN_PLACE, texels * channels * 4, &texture_chunk);
  if (status == BTF_OK) status = host->reserve(payload, ANGULAR, 0, 0, pairs * channels * 4, &angular_chunk);
  if (status != BTF_OK) return status;
  float *texture = texture_chunk, *angular = angular_chunk;
  float *image = host->alloc(ctx, texels, channels * sizeof *image);
  double *sum = host->alloc(ctx, texels, channels * sizeof *sum);
  if (image == NULL || sum == NULL) status = BTF_E_NOMEM; /* the host has set the message */
  for (uint64_t i = 0; status == BTF_OK && i < texels * channels; i++) sum[i] = 0.0;

  for (uint64_t pair = 0; pair < pairs && status == BTF_OK; pair++) {
    const btf_block block = {
        (uint32_t)(pair / lights), 1, (uint32_t)(pair % lights), 1, 0, 0, desc.width, desc.height};
    double pair_sum[64] = {0.0};
    status = host->dataset_read(ds, &block, image, &strides);
    for (uint64_t i = 0; i < texels * channels && status == BTF_OK; i++) {
      sum[i] += image[i];
      pair_sum[i % channels] += image[i];
    }
    for (uint32_t c = 0; c < channels; c++) {
      angular[pair * channels + c] = (float)(pair_sum[c] / (double)texels);
      mean[c] += pair_sum[c] / (double)texels / (double)pairs;
    }
    if (status == BTF_OK) status = host->progress(job, (double)(pair + 1) / (double)pairs, "averages");
  }
  for (uint64_t i = 0; i < texels * channels && status == BTF_OK; i++)
    texture[i] = (float)(mean[i % channels] + keep * (sum[i] / (double)pairs - mean[i % channels]));
  for (uint64_t i = 0; i < pairs * channels && status == BTF_OK; i++)
    angular[i] = mean[i % channels] != 0.0 ? (float)(angular[i] / mean[i % channels]) : 0.0f;
  host->free(ctx, image);
  host->free(ctx, sum);
  return status;
}

typedef struct mean_state {
  const btf_host *host;
  btf_model_shape shape;
  uint32_t lights;
  uint64_t bytes;
  const float *texture, *angular;
} mean_state;

/* Sizes are checked against the shape: evaluation trusts them from then on. */
static btf_status mean_load(const btf_host *host, btf_context *ctx, uint32_t format,
                            const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  const uint64_t texture_size = (uint64_t)shape->width * shape->height * shape->channels * 4;
  const uint64_t angular_size =
      (uint64_t)host->dirset_count(shape->views) * host->dirset_count(shape->lights) * shape->channels * 4;
  const void *texture, *angular;
  uint64_t size[2];
  btf_status status = host->get(payload, TEXTURE, 0, &texture, &size[0]);
  (void)format; /* there is one version so far; the library refuses others */
  if (status == BTF_OK) status = host->get(payload, ANGULAR, 0, &angular, &size[1]);
  if (status != BTF_OK) return status;
  if (size[0] != texture_size || size[1] != angular_size)
    return host->fail(ctx, BTF_E_CORRUPT, "org.example.mean: the averages have another size than the model");
  mean_state *s = host->alloc(ctx, 1, sizeof *s);
  if (s == NULL) return BTF_E_NOMEM;
  *s = (mean_state){host,    *shape, host->dirset_count(shape->lights), texture_size + angular_size,
                    texture, angular};
  *state = s;
  return BTF_OK;
}

static void mean_destroy(const btf_host *host, btf_context *ctx, void *state) {
  host->free(ctx, state);
}
static uint32_t mean_levels(const void *state) {
  return state != NULL;
}
static uint64_t mean_resident_bytes(const void *state) {
  return ((const mean_state *)state)->bytes;
}

static void mean_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                       uint32_t view, float *out) {
  const mean_state *s = state;
  const uint32_t n = s->shape.channels;
  (void)level;
  for (uint32_t c = 0; c < n; c++)
    out[c] = s->texture[((uint64_t)y * s->shape.width + x) * n + c] *
             s->angular[((uint64_t)view * s->lights + light) * n + c];
}

/* Total: host functions take any direction, btf_sampling takes any position, and nothing here fails or
 * allocates. */
static void mean_eval(const void *state, const btf_query *query, float *out) {
  const mean_state *s = state;
  const uint32_t n = s->shape.channels;
  btf_interp light, view;
  btf_bilinear at;
  if (query->flags & BTF_QUERY_NEAREST) {
    mean_texel(s, 0, btf_sampling_nearest(query->uv[0], s->shape.width, s->shape.wrap),
               btf_sampling_nearest(query->uv[1], s->shape.height, s->shape.wrap),
               s->host->dirset_nearest(s->shape.lights, query->light),
               s->host->dirset_nearest(s->shape.views, query->view), out);
    return;
  }
  s->host->dirset_locate(s->shape.lights, query->light, &light);
  s->host->dirset_locate(s->shape.views, query->view, &view);
  btf_sampling_bilinear(query->uv[0], query->uv[1], s->shape.width, s->shape.height, s->shape.wrap, &at);
  for (uint32_t c = 0; c < n; c++) {
    float angular = 0.0f, texture = 0.0f;
    for (int v = 0; v < 3; v++)
      for (int l = 0; l < 3; l++)
        angular += view.weight[v] * light.weight[l] *
                   s->angular[((uint64_t)view.index[v] * s->lights + light.index[l]) * n + c];
    for (int j = 0; j < 2; j++)
      for (int i = 0; i < 2; i++)
        texture += at.wy[j] * at.wx[i] * s->texture[((uint64_t)at.y[j] * s->shape.width + at.x[i]) * n + c];
    out[c] = texture * angular;
  }
}

static const btf_codec_vtbl mean_codec = {.struct_size = sizeof(btf_codec_vtbl),
                                          .abi = LIBBTF_ABI,
                                          .id = "org.example.mean",
                                          .title = "Mean texture times mean reflectance",
                                          .version = "1.0",
                                          .caps = BTF_CAP_FIT | BTF_CAP_STREAM_FIT,
                                          .params = params,
                                          .format_read_min = 1,
                                          .format_write = 1,
                                          .fit = mean_fit,
                                          .load = mean_load,
                                          .destroy = mean_destroy,
                                          .levels = mean_levels,
                                          .resident_bytes = mean_resident_bytes,
                                          .eval = mean_eval,
                                          .texel = mean_texel};
static const btf_codec_vtbl *const codecs[] = {&mean_codec};
static const btf_plugin_info info = {sizeof info, LIBBTF_ABI, "mean", "MIT", codecs, 1, 0};

/* The one symbol the library looks for. NULL would say: not with a library of this generation. */
LIBBTF_API const btf_plugin_info *BTF_PLUGIN_ENTRY(uint32_t host_abi);
const btf_plugin_info *BTF_PLUGIN_ENTRY(uint32_t host_abi) {
  return host_abi == LIBBTF_ABI ? &info : NULL;
}
