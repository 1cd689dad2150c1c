/* SPDX-License-Identifier: MIT */
#include "sample_source.h"

#include <math.h>
#include <string.h>

int sample_source_open(input *in, sample_source *out) {
  memset(out, 0, sizeof *out);
  out->path = in->path;
  if (in->dataset != NULL) {
    btf_dataset_desc d = BTF_DATASET_DESC_INIT;
    btf_dataset_describe(in->dataset, &d);
    out->dataset = in->dataset;
    out->light_set = d.lights;
    out->view_set = d.views;
    out->width = d.width;
    out->height = d.height;
    out->channels = d.channels;
    out->levels = 1;
    out->quantity = d.quantity;
    out->wrap = d.wrap;
    out->sample_type = d.sample_type;
    out->texel_major = (d.flags & BTF_DATASET_IMAGE_MAJOR) == 0;
  } else {
    btf_model_info m = BTF_MODEL_INFO_INIT;
    const int failed = input_load(in);
    if (failed) return failed;
    btf_model_describe(in->model, &m);
    out->model = in->model;
    out->light_set = m.lights;
    out->view_set = m.views;
    out->width = m.width;
    out->height = m.height;
    out->channels = m.channels;
    out->levels = m.levels;
    out->quantity = m.quantity;
    out->wrap = m.wrap;
  }
  out->lights = btf_dirset_count(out->light_set);
  out->views = btf_dirset_count(out->view_set);
  return EXIT_DONE;
}

void sample_source_set_level(sample_source *s, uint32_t level) {
  for (; s->level < level; s->level++) {
    if (s->width > 1) s->width /= 2;
    if (s->height > 1) s->height /= 2;
  }
}

uint32_t sample_source_block_lights(const sample_source *s) {
  /* A block of images that lie as such stays in the caches; where texels lie one by one, few lights of each
   * would be read from lines that hold many. */
  const uint64_t block_values = UINT64_C(1) << (s->texel_major ? 22 : 18);
  const uint64_t lights = block_values / sample_source_image_values(s);
  return lights < 1 ? 1 : lights > s->lights ? s->lights : (uint32_t)lights;
}

btf_status sample_source_read(const sample_source *s, uint32_t view, uint32_t light0, uint32_t lights,
                              float *dst) {
  if (s->dataset != NULL) {
    const btf_block block = {view, 1, light0, lights, 0, 0, s->width, s->height};
    const ptrdiff_t pixel = (ptrdiff_t)s->channels * (ptrdiff_t)sizeof(float);
    const ptrdiff_t row = pixel * (ptrdiff_t)s->width, picture = row * (ptrdiff_t)s->height;
    const btf_strides strides = {picture * (ptrdiff_t)lights, picture, row, pixel, sizeof(float)};
    return btf_dataset_read(s->dataset, &block, dst, &strides);
  }
  for (uint32_t l = light0; l < light0 + lights; l++)
    for (uint32_t y = 0; y < s->height; y++)
      for (uint32_t x = 0; x < s->width; x++, dst += s->channels)
        if (btf_model_texel(s->model, s->level, x, y, l, view, dst) > 0 && s->marks_defects) dst[0] = NAN;
  return BTF_OK;
}
