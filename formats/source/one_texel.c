/* SPDX-License-Identifier: MIT */
#include "source/one_texel.h"

enum { MOST_CHANNELS = 64 };

btf_status one_texel_open(const btf_host *host, btf_context *ctx, const char *path, size_t size,
                          one_texel **out) {
  one_texel *brdf = (host->alloc)(ctx, 1, size);
  if (brdf == NULL) return BTF_E_NOMEM;
  memset(brdf, 0, size);
  const btf_status status = source_file_open(host, ctx, path, &brdf->file);
  if (status == BTF_OK)
    *out = brdf;
  else
    (host->free)(ctx, brdf);
  return status;
}

void one_texel_close(one_texel *brdf) {
  const btf_host *host = brdf->file.host;
  btf_context *ctx = brdf->file.ctx;
  if (brdf->drop != NULL) brdf->drop(brdf);
  (host->dirset_release)(brdf->directions);
  source_file_close(&brdf->file);
  (host->free)(ctx, brdf);
}

static void release(void *user) {
  one_texel_close(user);
}

/* Directions of a set have length 1 to a float's precision; angles near a pole see the difference. */
static void unit(const float *direction, double out[3]) {
  double square = 0;
  for (int i = 0; i < 3; i++) square += (double)direction[i] * (double)direction[i];
  for (int i = 0; i < 3; i++) out[i] = (double)direction[i] / sqrt(square);
}

static btf_status read_block(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  const one_texel *brdf = user;
  const float *directions = (brdf->file.host->dirset_directions)(brdf->directions);
  double light[3], view[3], values[MOST_CHANNELS];
  for (uint32_t v = 0; v < block->views; v++) {
    unit(directions + 3 * (size_t)(block->view0 + v), view);
    for (uint32_t l = 0; l < block->lights; l++) {
      unit(directions + 3 * (size_t)(block->light0 + l), light);
      brdf->eval(brdf, light, view, values);
      for (uint32_t c = 0; c < brdf->channels; c++) {
        const float value = (float)values[c];
        memcpy((char *)dst + (ptrdiff_t)v * strides->view + (ptrdiff_t)l * strides->light +
                   (ptrdiff_t)c * strides->channel,
               &value, sizeof value);
      }
    }
  }
  return BTF_OK;
}

btf_status one_texel_create(one_texel *brdf, const btf_options *options, const btf_dataset_desc *about,
                            btf_dataset **out) {
  const btf_host *host = brdf->file.host;
  btf_context *ctx = brdf->file.ctx;
  char name[SOURCE_NAME_BYTES];
  btf_dataset_desc desc = *about;
  const btf_status status =
      (host->dirset_create_named)(ctx, (host->option_text)(options, "directions"), &brdf->directions);
  if (status != BTF_OK) {
    one_texel_close(brdf);
    return status;
  }
  desc.lights = desc.views = brdf->directions;
  desc.width = desc.height = 1;
  desc.channels = brdf->channels;
  desc.flags = BTF_DATASET_CONCURRENT_READ;
  if (desc.name == NULL) {
    source_name(brdf->file.path, name);
    desc.name = name;
  }
  desc.read = read_block;
  desc.user = brdf;
  desc.release = release;
  return (host->dataset_create)(ctx, &desc, out);
}
