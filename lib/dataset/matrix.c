/* SPDX-License-Identifier: MIT */
/* matrix.c: a data set read as a matrix, in the direction that its samples lie in. */
#include "dataset/matrix.h"
#include "dataset/dataset_parts.h"

#include <string.h>

static bool lies_by_image(const btf_dataset_desc *desc) {
  return (desc->flags & BTF_DATASET_IMAGE_MAJOR) != 0 ||
         (desc->data != NULL && desc->strides.view > desc->strides.y && desc->strides.view > desc->strides.x);
}

static btf_status measure_shape(btf_context *ctx, const btf_dataset *ds, const btf_dataset_desc *desc,
                                btfi_matrix *out) {
  uint64_t samples;
  memset(out, 0, sizeof *out);
  out->ctx = ctx;
  out->ds = ds;
  out->views = btf_dirset_count(desc->views);
  out->lights = btf_dirset_count(desc->lights);
  out->channels = desc->channels;
  out->width = desc->width;
  out->height = desc->height;
  out->texels = (uint64_t)desc->width * desc->height;
  if (__builtin_mul_overflow((uint64_t)out->views * out->lights, (uint64_t)out->channels, &out->rows) ||
      __builtin_mul_overflow(out->rows, out->texels, &samples) || samples > UINT64_MAX / sizeof(float))
    return btfi_fail(ctx, BTF_E_LIMIT, "the data set has more samples than 64 bits can count");
  return BTF_OK;
}

static void take_direction(btfi_matrix *m, const btf_dataset_desc *desc, bool by_image) {
  m->by_image = by_image;
  m->layout = lies_by_image(desc) && !by_image ? BTF_LAYOUT_ITEM_COLUMNS : BTF_LAYOUT_ITEM_ROWS;
  m->items = by_image ? m->rows : m->texels;
  m->length = by_image ? m->texels : m->rows;
  m->block_items = by_image ? m->channels : lies_by_image(desc) ? m->width : 0;
}

btf_status btfi_matrix_open_by(btf_context *ctx, const btf_dataset *ds, bool by_image, btfi_matrix *out) {
  const btf_dataset_desc *desc = btfi_dataset_desc(ds);
  BTFI_TRY(measure_shape(ctx, ds, desc, out));
  take_direction(out, desc, by_image);
  return BTF_OK;
}

btf_status btfi_matrix_open(btf_context *ctx, const btf_dataset *ds, uint64_t max_working_set,
                            btfi_matrix *out) {
  const btf_dataset_desc *desc = btfi_dataset_desc(ds);
  BTFI_TRY(measure_shape(ctx, ds, desc, out));
  take_direction(out, desc,
                 btfi_matrix_is_held(out, max_working_set) ? out->rows <= out->texels : lies_by_image(desc));
  return BTF_OK;
}

bool btfi_matrix_is_held(const btfi_matrix *m, uint64_t max_working_set) {
  return m->rows * m->texels <= max_working_set / 2 / sizeof(float);
}

void btfi_matrix_close(btfi_matrix *matrix) {
  btfi_free(matrix->ctx, matrix->partial);
  matrix->partial = NULL;
}

/* Images of whole (view, light) pairs. A run of pairs is a box only within one view or over whole views. */
static btf_status read_pairs(const btfi_matrix *m, uint64_t pair0, uint64_t pairs, float *dst, size_t ld) {
  const ptrdiff_t image = (ptrdiff_t)(ld * sizeof *dst), pair_step = image * m->channels;
  const btf_strides strides = {pair_step * m->lights, pair_step, (ptrdiff_t)(m->width * sizeof *dst),
                               (ptrdiff_t)sizeof *dst, image};
  while (pairs > 0) {
    const uint32_t view = (uint32_t)(pair0 / m->lights), light = (uint32_t)(pair0 % m->lights);
    btf_block block = {view, 1, light, m->lights - light, 0, 0, m->width, m->height};
    if (light == 0 && pairs >= m->lights) {
      block.views = (uint32_t)(pairs / m->lights);
    } else if (pairs < block.lights) {
      block.lights = (uint32_t)pairs;
    }
    const uint64_t done = (uint64_t)block.views * block.lights;
    BTFI_TRY(btf_dataset_read(m->ds, &block, dst, &strides));
    dst += done * m->channels * ld;
    pair0 += done;
    pairs -= done;
  }
  return BTF_OK;
}

/* Some channels of one pair. */
static btf_status read_channels(btfi_matrix *m, uint64_t pair, uint32_t channel, uint32_t channels,
                                float *dst, size_t ld) {
  if (m->partial == NULL) {
    m->partial = btfi_alloc(m->ctx, m->texels, m->channels * sizeof *m->partial);
    if (m->partial == NULL) return btfi_alloc_status();
  }
  BTFI_TRY(read_pairs(m, pair, 1, m->partial, m->texels));
  for (uint32_t c = 0; c < channels; c++)
    memcpy(dst + c * ld, m->partial + (channel + c) * m->texels, m->texels * sizeof *dst);
  return BTF_OK;
}

static btf_status read_images(btfi_matrix *m, uint64_t item0, uint64_t items, float *dst, size_t ld) {
  while (items > 0) {
    const uint64_t pair = item0 / m->channels;
    const uint32_t channel = (uint32_t)(item0 % m->channels);
    uint64_t done;
    if (channel == 0 && items >= m->channels) {
      done = items / m->channels * m->channels;
      BTFI_TRY(read_pairs(m, pair, done / m->channels, dst, ld));
    } else {
      done = m->channels - channel < items ? m->channels - channel : items;
      BTFI_TRY(read_channels(m, pair, channel, (uint32_t)done, dst, ld));
    }
    dst += done * ld;
    item0 += done;
    items -= done;
  }
  return BTF_OK;
}

/* ABRDFs. A run of texels is a box only within one line or over whole lines. */
static btf_status read_texels(const btfi_matrix *m, uint64_t item0, uint64_t items, float *dst, size_t ld) {
  const bool columns = m->layout == BTF_LAYOUT_ITEM_COLUMNS;
  const ptrdiff_t near = sizeof *dst, far = (ptrdiff_t)(ld * sizeof *dst);
  const ptrdiff_t value = columns ? far : near, texel = columns ? near : far;
  const btf_strides strides = {value * m->channels * m->lights, value * m->channels, texel * m->width, texel,
                               value};
  while (items > 0) {
    const uint32_t y = (uint32_t)(item0 / m->width), x = (uint32_t)(item0 % m->width);
    btf_block block = {0, m->views, 0, m->lights, x, y, m->width - x, 1};
    if (x == 0 && items >= m->width) {
      block.height = (uint32_t)(items / m->width);
    } else if (items < block.width) {
      block.width = (uint32_t)items;
    }
    const uint64_t done = (uint64_t)block.width * block.height;
    BTFI_TRY(btf_dataset_read(m->ds, &block, dst, &strides));
    dst += columns ? done : done * ld;
    item0 += done;
    items -= done;
  }
  return BTF_OK;
}

btf_status btfi_matrix_read(void *matrix, uint64_t item0, uint64_t items, float *dst, size_t ld) {
  btfi_matrix *m = matrix;
  BTFI_TRY(m->by_image ? read_images(m, item0, items, dst, ld) : read_texels(m, item0, items, dst, ld));
  if (m->mean == NULL) return BTF_OK;
  const bool row_by_row = m->by_image || m->layout == BTF_LAYOUT_ITEM_COLUMNS;
  const uint64_t lines = m->by_image || !row_by_row ? items : m->length;
  const uint64_t run = m->by_image || !row_by_row ? m->length : items;
  for (uint64_t i = 0; i < lines; i++, dst += ld) {
    if (row_by_row) {
      const float mean = m->mean[m->by_image ? item0 + i : i];
      for (uint64_t j = 0; j < run; j++) dst[j] -= mean;
    } else {
      for (uint64_t j = 0; j < run; j++) dst[j] -= m->mean[j];
    }
  }
  return BTF_OK;
}
