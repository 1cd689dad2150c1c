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
#include <btf/btf_codec.h>
#include <btf/btf_sampling.h>

#define ID "org.example.mean"
#define TEXTURE BTF_TAG('T', 'E', 'X', ' ') /* height x width x channels floats */
#define ANGULAR BTF_TAG('A', 'N', 'G', ' ') /* views x lights x channels floats, 1 on average */

BTF_PARAM(contrast, BTF_PARAM_FLOAT, "how much of the texture is kept: 1 all of it, 0 its mean colour", NULL,
          "1", NULL, 0.0, 1.0);
static const btf_param_desc *const params[] = {&contrast, NULL};

/* The data set is read image by image, so that any size of it fits in memory. */
static btf_status mean_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                           const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  BTF_TRY(host->dataset_describe(ds, &desc));
  const uint32_t lights = host->dirset_count(desc.lights), n = desc.channels;
  const uint64_t pairs = (uint64_t)host->dirset_count(desc.views) * lights;
  const uint64_t values = (uint64_t)desc.width * desc.height * n;
  const btf_strides strides = {0, 0, 4 * (ptrdiff_t)n * desc.width, 4 * (ptrdiff_t)n, 4};
  const double keep = host->option(options, "contrast");
  void *texture_chunk, *angular_chunk;
  double mean[64] = {0.0};
  /* Memory of the payload, zeroed; in place means: used straight from the file when it is mapped. */
  BTF_TRY(host->reserve(payload, TEXTURE, 0, BTF_PAYLOAD_IN_PLACE, values * sizeof(float), &texture_chunk));
  BTF_TRY(host->reserve(payload, ANGULAR, 0, 0, pairs * n * sizeof(float), &angular_chunk));
  float *texture = texture_chunk, *angular = angular_chunk;
  double *sum = host->alloc(ctx, values, sizeof *sum);
  if (sum == NULL) return BTF_E_NOMEM; /* the host has set the message */
  memset(sum, 0, values * sizeof *sum);

  btf_status status = host->progress(job, 0.0, "averages");
  for (uint64_t pair = 0; pair < pairs && status == BTF_OK; pair++) {
    const uint32_t view = (uint32_t)(pair / lights), light = (uint32_t)(pair % lights);
    const btf_block block = {view, 1, light, 1, 0, 0, desc.width, desc.height};
    double colour[64] = {0.0};
    status = host->dataset_read(ds, &block, texture, &strides); /* its room holds an image until the end */
    for (uint64_t i = 0; i < values && status == BTF_OK; i++) {
      sum[i] += texture[i] / (double)pairs;
      colour[i % n] += texture[i] * (double)n / (double)values;
    }
    for (uint32_t c = 0; c < n; c++) {
      angular[pair * n + c] = (float)colour[c];
      mean[c] += colour[c] / (double)pairs;
    }
    if (status == BTF_OK) status = host->progress(job, (double)(pair + 1) / (double)pairs, "averages");
  }
  for (uint64_t i = 0; i < values; i++) texture[i] = (float)(mean[i % n] + keep * (sum[i] - mean[i % n]));
  for (uint64_t i = 0; i < pairs * n; i++)
    angular[i] = mean[i % n] != 0.0 ? (float)(angular[i] / mean[i % n]) : 0.0f;
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

/* Sizes are checked against the shape: evaluation trusts them from then on. There is one format so far. */
static btf_status mean_load(const btf_host *host, btf_context *ctx, uint32_t format,
                            const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  const uint32_t lights = host->dirset_count(shape->lights);
  const uint64_t texture_bytes = (uint64_t)shape->width * shape->height * shape->channels * sizeof(float);
  const uint64_t angular_bytes =
      (uint64_t)host->dirset_count(shape->views) * lights * shape->channels * sizeof(float);
  const void *texture, *angular;
  (void)format;
  BTF_TRY(btf_get_chunk(host, ctx, payload, ID, TEXTURE, 0, texture_bytes, &texture));
  BTF_TRY(btf_get_chunk(host, ctx, payload, ID, ANGULAR, 0, angular_bytes, &angular));
  mean_state *s = host->alloc(ctx, 1, sizeof *s);
  if (s == NULL) return BTF_E_NOMEM;
  *s = (mean_state){host, *shape, lights, texture_bytes + angular_bytes, texture, angular};
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
static void mean_eval(const void *state, const btf_query *q, float *out) {
  const mean_state *s = state;
  const uint32_t n = s->shape.channels, nearest = q->flags & BTF_QUERY_NEAREST;
  btf_interp light = {{s->host->dirset_nearest(s->shape.lights, q->light), 0, 0}, {1.0f, 0.0f, 0.0f}};
  btf_interp view = {{s->host->dirset_nearest(s->shape.views, q->view), 0, 0}, {1.0f, 0.0f, 0.0f}};
  btf_texel_set at;
  if (!nearest) s->host->dirset_locate(s->shape.lights, q->light, &light);
  if (!nearest) s->host->dirset_locate(s->shape.views, q->view, &view);
  btf_sampling_texels(q->uv, 0.0f, (int)nearest, s->shape.width, s->shape.height, s->shape.wrap, 1, &at);
  for (uint32_t c = 0; c < n; c++) {
    float texture = 0.0f, angular = 0.0f;
    for (uint32_t i = 0; i < at.count; i++)
      texture += at.weight[i] * s->texture[((uint64_t)at.y[i] * s->shape.width + at.x[i]) * n + c];
    for (int i = 0; i < 9; i++)
      angular += view.weight[i / 3] * light.weight[i % 3] *
                 s->angular[((uint64_t)view.index[i / 3] * s->lights + light.index[i % 3]) * n + c];
    out[c] = texture * angular;
  }
}

static const btf_codec_vtbl mean_codec = {.struct_size = sizeof(btf_codec_vtbl),
                                          .abi = LIBBTF_ABI,
                                          .id = ID,
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
static const btf_plugin_info info = {.struct_size = sizeof info,
                                     .abi = LIBBTF_ABI,
                                     .name = "mean",
                                     .license = "MIT",
                                     .codecs = codecs,
                                     .codec_count = 1,
                                     .host_size_needed = sizeof(btf_host)};

/* The one symbol the library looks for. NULL would say: not with a library of this generation. */
LIBBTF_API const btf_plugin_info *BTF_PLUGIN_ENTRY(uint32_t host_abi);
const btf_plugin_info *BTF_PLUGIN_ENTRY(uint32_t host_abi) {
  return host_abi == LIBBTF_ABI ? &info : NULL;
}
