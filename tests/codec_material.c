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

static float polish_of(const codec_material *m, uint32_t x, uint32_t y) {
  const float turn = 6.2831853f, s = turn * (float)x / (float)m->width,
              t = turn * (float)y / (float)m->height;
  return 0.6f + 0.3f * cosf(s - t);
}

static float paint_of(const codec_material *m, uint32_t x, uint32_t y, uint32_t channel) {
  const float turn = 6.2831853f, s = turn * (float)x / (float)m->width,
              t = turn * (float)y / (float)m->height;
  return 0.5f + 0.4f * sinf(s + 0.8f * (float)channel) * cosf(t);
}

static float lobe_of(const float light[3], const float view[3], float polish) {
  const float h[3] = {light[0] + view[0], light[1] + view[1], light[2] + view[2]};
  const float length = sqrtf(h[0] * h[0] + h[1] * h[1] + h[2] * h[2]);
  return powf(h[2] / length, 6.0f + 2.0f * polish);
}

static float value_of(const codec_material *m, const float light[3], float paint, float polish, float lobe) {
  const float f = m->least + m->contrast * paint + m->gloss * polish * lobe;
  return m->quantity == BTF_QUANTITY_BRDF_COS ? f * light[2] : f;
}

float codec_material_value(const codec_material *m, const float light[3], const float view[3], uint32_t x,
                           uint32_t y, uint32_t channel) {
  const float polish = polish_of(m, x, y);
  return value_of(m, light, paint_of(m, x, y, channel), polish, lobe_of(light, view, polish));
}

/* ---- as a data set ---- */

enum { MOST_CHANNELS = 32 };

/* Samples are kept where they are streamed, too, out of sight of the context: fits with little memory read
 * them dozens of times. */
typedef struct source {
  const codec_material *material;
  btf_dirset *lights, *views;
  uint32_t channels;
  float *samples;
  btf_strides strides; /* of these */
} source;

static btf_status read_block(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  const source *from = user;
  const btf_strides *own = &from->strides;
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++) {
        const char *src = (const char *)from->samples + (ptrdiff_t)(b->view0 + v) * own->view +
                          (ptrdiff_t)(b->light0 + l) * own->light + (ptrdiff_t)(b->y0 + y) * own->y +
                          (ptrdiff_t)b->x0 * own->x;
        char *to = (char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y;
        for (uint32_t x = 0; x < b->width; x++, src += own->x, to += s->x)
          for (uint32_t c = 0; c < from->channels; c++)
            *(float *)(void *)(to + (ptrdiff_t)c * s->channel) =
                *(const float *)(const void *)(src + (ptrdiff_t)c * own->channel);
      }
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

static void fill_texel(const source *from, uint32_t x, uint32_t y) {
  const codec_material *m = from->material;
  const float *lights = btf_dirset_directions(from->lights), *views = btf_dirset_directions(from->views);
  const float polish = polish_of(m, x, y);
  float paint[MOST_CHANNELS];
  for (uint32_t c = 0; c < from->channels; c++) paint[c] = paint_of(m, x, y, c);
  char *texel = (char *)from->samples + (ptrdiff_t)y * from->strides.y + (ptrdiff_t)x * from->strides.x;
  for (uint32_t v = 0; v < btf_dirset_count(from->views); v++)
    for (uint32_t l = 0; l < btf_dirset_count(from->lights); l++) {
      const float *light = lights + 3 * (size_t)l;
      const float lobe = lobe_of(light, views + 3 * (size_t)v, polish);
      char *to = texel + (ptrdiff_t)v * from->strides.view + (ptrdiff_t)l * from->strides.light;
      for (uint32_t c = 0; c < from->channels; c++)
        *(float *)(void *)(to + (ptrdiff_t)c * from->strides.channel) =
            value_of(m, light, paint[c], polish, lobe);
    }
}

static btf_status fill(source *from, const codec_dataset_recipe *recipe) {
  const codec_material *m = from->material;
  const ptrdiff_t lights = (ptrdiff_t)btf_dirset_count(from->lights),
                  views = (ptrdiff_t)btf_dirset_count(from->views);
  const uint64_t count = codec_material_samples(recipe->material, from->channels);
  btf_strides *s = &from->strides;
  from->samples = malloc(count * sizeof(float));
  if (from->samples == NULL) return BTF_E_NOMEM;
  s->channel = sizeof(float);
  if (recipe->source == SOURCE_IMAGES) {
    s->x = s->channel * (ptrdiff_t)from->channels;
    s->y = s->x * (ptrdiff_t)m->width;
    s->light = s->y * (ptrdiff_t)m->height;
    s->view = s->light * lights;
  } else {
    s->light = s->channel * (ptrdiff_t)from->channels;
    s->view = s->light * lights;
    s->x = s->view * views;
    s->y = s->x * (ptrdiff_t)m->width;
  }
  for (uint32_t y = 0; y < m->height; y++)
    for (uint32_t x = 0; x < m->width; x++) fill_texel(from, x, y);
  for (uint64_t i = 0; recipe->scale != 0.0f && i < count; i++) from->samples[i] *= recipe->scale;
  if (recipe->odd_sample != 0) from->samples[recipe->odd_sample - 1] = recipe->odd;
  return BTF_OK;
}

btf_status codec_material_dataset(btf_context *ctx, const codec_dataset_recipe *recipe, btf_dataset **out) {
  const codec_material *m = &codec_materials[recipe->material];
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_status status;
  *out = NULL;
  if (recipe->channels > MOST_CHANNELS) return BTF_E_INVALID_ARG;
  source *from = calloc(1, sizeof *from);
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
  if (status == BTF_OK) status = fill(from, recipe);
  if (recipe->source == SOURCE_RESIDENT) {
    desc.data = from->samples;
    desc.strides = from->strides;
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
