/* SPDX-License-Identifier: MIT */
#include "codec_material.h"

#include <math.h>
#include <stdlib.h>

#define BRDF BTF_QUANTITY_BRDF
#define PERIODIC BTF_WRAP_PERIODIC
const codec_material codec_materials[MATERIALS] = {
    [MATERIAL_SMOOTH] = {"smooth", "grid:5x3", "grid:4x3", 7, 5, BRDF, PERIODIC, 0.1f, 0.2f, 0.3f},
    [MATERIAL_TEXEL] = {"one texel", "grid:5x3", "grid:4x3", 1, 1, BRDF, PERIODIC, 0.1f, 0.2f, 0.3f},
    [MATERIAL_ROW] = {"one row", "grid:4x3", "grid:5x2", 6, 1, BRDF, PERIODIC, 0.1f, 0.2f, 0.3f},
    [MATERIAL_PAIR] = {"one pair", "grid:1x1", "grid:1x1", 7, 5, BRDF, PERIODIC, 0.1f, 0.2f, 0.3f},
    [MATERIAL_CONSTANT] = {"constant", "grid:5x3", "grid:4x3", 7, 5, BRDF, PERIODIC, 0.3f, 0.0f, 0.0f},
    [MATERIAL_ZERO] = {"zero", "grid:5x3", "grid:4x3", 7, 5, BRDF, PERIODIC, 0.0f, 0.0f, 0.0f},
    [MATERIAL_BRIGHT] = {"bright", "grid:5x3", "grid:4x3", 7, 5, BRDF, PERIODIC, 2e3f, 4e3f, 6e3f},
    [MATERIAL_DARK] = {"dark", "grid:5x3", "grid:4x3", 7, 5, BRDF, PERIODIC, 2e-5f, 4e-5f, 6e-5f},
    [MATERIAL_COSINE] = {"cosine", "grid:5x3", "grid:4x3", 7, 5, BTF_QUANTITY_BRDF_COS, PERIODIC, 0.1f, 0.2f,
                         0.3f},
    [MATERIAL_CLAMPED] = {"clamped", "grid:5x3", "grid:4x3", 7, 5, BRDF, BTF_WRAP_CLAMP, 0.1f, 0.2f, 0.3f},
    [MATERIAL_TINY] = {"tiny", "grid:4x2", "grid:3x2", 3, 2, BRDF, PERIODIC, 0.1f, 0.2f, 0.3f},
    [MATERIAL_LARGE] = {"large", "grid:8x5", "grid:9x4", 31, 21, BRDF, PERIODIC, 0.1f, 0.2f, 0.3f},
};

/* A diffuse and a Blinn-Phong part, whose colours and exponent change slowly over the texture: close to what
 * each of the methods is made for. */
float codec_material_value(const codec_material *m, const float light[3], const float view[3], uint32_t x,
                           uint32_t y, uint32_t channel) {
  const float turn = 6.2831853f, s = turn * (float)x / (float)m->width,
              t = turn * (float)y / (float)m->height;
  const float paint = 0.5f + 0.4f * sinf(s + 0.8f * (float)channel) * cosf(t);
  const float polish = 0.6f + 0.3f * cosf(s - t);
  const float h[3] = {light[0] + view[0], light[1] + view[1], light[2] + view[2]};
  const float length = sqrtf(h[0] * h[0] + h[1] * h[1] + h[2] * h[2]);
  const float lobe = powf(h[2] / length, 6.0f + 2.0f * polish);
  const float f = m->least + m->contrast * paint + m->gloss * polish * lobe;
  return m->quantity == BTF_QUANTITY_BRDF_COS ? f * light[2] : f;
}

/* ---- as a data set ---- */

typedef struct source {
  const codec_material *material;
  btf_dirset *lights, *views;
  uint32_t channels;
  float *samples; /* NULL where it is streamed */
} source;

static btf_status read_block(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  const source *from = user;
  const float *lights = btf_dirset_directions(from->lights), *views = btf_dirset_directions(from->views);
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++)
          for (uint32_t c = 0; c < from->channels; c++)
            *(float *)((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y +
                       (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel) =
                codec_material_value(from->material, lights + 3 * (size_t)(b->light0 + l),
                                     views + 3 * (size_t)(b->view0 + v), b->x0 + x, b->y0 + y, c);
  return BTF_OK;
}

static void release(void *user) {
  source *from = user;
  btf_dirset_release(from->lights);
  btf_dirset_release(from->views);
  free(from->samples);
  free(from);
}

uint64_t codec_material_samples(uint32_t material, uint32_t channels) {
  const codec_material *m = &codec_materials[material];
  const char *const names[2] = {m->lights, m->views};
  uint64_t samples = (uint64_t)m->width * m->height * channels;
  for (int i = 0; i < 2; i++) { /* grid:PxT */
    char *end;
    samples *= strtoul(names[i] + 5, &end, 10);
    samples *= strtoul(end + 1, NULL, 10);
  }
  return samples;
}

static btf_status fill_resident(source *from, const codec_dataset_recipe *recipe, btf_dataset_desc *desc) {
  const uint32_t lights = btf_dirset_count(from->lights), views = btf_dirset_count(from->views);
  const btf_block all = {0, views, 0, lights, 0, 0, desc->width, desc->height};
  btf_strides *s = &desc->strides;
  from->samples = malloc(codec_material_samples(recipe->material, from->channels) * sizeof(float));
  if (from->samples == NULL) return BTF_E_NOMEM;
  s->channel = sizeof(float);
  s->light = s->channel * (ptrdiff_t)from->channels;
  s->view = s->light * (ptrdiff_t)lights;
  s->x = s->view * (ptrdiff_t)views;
  s->y = s->x * (ptrdiff_t)desc->width;
  desc->data = from->samples;
  (void)read_block(from, &all, from->samples, s);
  const uint64_t count = codec_material_samples(recipe->material, from->channels);
  for (uint64_t i = 0; recipe->scale != 0.0f && i < count; i++) from->samples[i] *= recipe->scale;
  if (recipe->odd_sample != 0) from->samples[recipe->odd_sample - 1] = recipe->odd;
  return BTF_OK;
}

btf_status codec_material_dataset(btf_context *ctx, const codec_dataset_recipe *recipe, btf_dataset **out) {
  const codec_material *m = &codec_materials[recipe->material];
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  source *from = calloc(1, sizeof *from);
  btf_status status;
  *out = NULL;
  if (from == NULL) return BTF_E_NOMEM;
  from->material = m;
  from->channels = recipe->channels;
  status = btf_dirset_create_named(ctx, m->lights, &from->lights);
  if (status == BTF_OK) status = btf_dirset_create_named(ctx, m->views, &from->views);
  desc.lights = from->lights;
  desc.views = from->views;
  desc.width = m->width;
  desc.height = m->height;
  desc.channels = recipe->channels;
  desc.quantity = m->quantity;
  desc.wrap = m->wrap;
  desc.name = m->name;
  desc.user = from;
  desc.release = release;
  if (recipe->source == SOURCE_RESIDENT) {
    if (status == BTF_OK) status = fill_resident(from, recipe, &desc);
  } else {
    desc.read = read_block;
    desc.flags = recipe->source == SOURCE_IMAGES ? BTF_DATASET_IMAGE_MAJOR : BTF_DATASET_CONCURRENT_READ;
  }
  if (status != BTF_OK) {
    release(from);
    return status;
  }
  return btf_dataset_create(ctx, &desc, out);
}
