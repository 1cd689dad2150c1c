/* SPDX-License-Identifier: MIT */
/* read.c: samples of a block, decoded tile by tile: a product of factors for each channel, then colours. */
#include "bonn_btf/bonn_btf.h"

enum { TILE_LIGHTS = 256, TILE_TEXELS = 1024 };

typedef struct tile {
  float *angular, *texel; /* rows of both sides as floats, k apart */
  float *values;          /* channels x lights x texels */
  float angular_mean[TILE_LIGHTS], texel_mean[TILE_TEXELS];
  uint64_t texels[TILE_TEXELS]; /* numbers of the texels in the file */
} tile;

static void fetch_row(const bonn_factor *factor, const bonn_side *side, uint64_t row, float *dst,
                      float *mean) {
  const unsigned char *p = side->rows + row * factor->k * factor->scalar_size;
  for (uint32_t i = 0; i < factor->k; i++)
    dst[i] = bonn_scalar(p + (size_t)i * factor->scalar_size, factor->scalar_size);
  *mean = side->mean != NULL ? bonn_scalar(side->mean + row * factor->scalar_size, factor->scalar_size) : 0;
}

/* c = a b^T; the library's product, or a plain one in a build without BLAS. */
static btf_status multiply(const bonn_file *bonn, size_t lights, size_t texels, size_t k, const tile *t,
                           float *out) {
  const btf_status status = (bonn->file.host->gemm)(bonn->file.ctx, BTF_TRANSPOSE_B, lights, texels, k, 1,
                                                    t->angular, k, t->texel, k, 0, out, texels);
  if (status != BTF_E_UNSUPPORTED) return status;
  for (size_t l = 0; l < lights; l++)
    for (size_t x = 0; x < texels; x++) {
      float sum = 0;
      for (size_t i = 0; i < k; i++) sum += t->angular[l * k + i] * t->texel[x * k + i];
      out[l * texels + x] = sum;
    }
  return BTF_OK;
}

static btf_status decode_channel(const bonn_file *bonn, uint32_t view, uint32_t light0, uint32_t lights,
                                 size_t texels, uint32_t channel, tile *t, float *out) {
  const bool mixed = bonn->family != BONN_DFMF; /* the channel is part of a row's number */
  const bonn_factor *factor = &bonn->factors[bonn->family == BONN_PVF    ? view
                                             : bonn->family == BONN_DFMF ? channel
                                                                         : 0];
  const uint64_t first = (bonn->family == BONN_PVF ? 0 : bonn->lights[view].before) + light0;
  const bool by_texel = mixed && factor->channels_by_texel, by_angle = mixed && !factor->channels_by_texel;
  for (uint32_t l = 0; l < lights; l++)
    fetch_row(factor, &factor->angular, by_angle ? channel + bonn->channels * (first + l) : first + l,
              t->angular + (size_t)l * factor->k, &t->angular_mean[l]);
  for (size_t x = 0; x < texels; x++)
    fetch_row(factor, &factor->texel, by_texel ? channel + bonn->channels * t->texels[x] : t->texels[x],
              t->texel + x * factor->k, &t->texel_mean[x]);
  BTF_TRY(multiply(bonn, lights, texels, factor->k, t, out));
  for (uint32_t l = 0; l < lights; l++)
    for (size_t x = 0; x < texels; x++) out[l * texels + x] += t->angular_mean[l] + t->texel_mean[x];
  return BTF_OK;
}

/* Texels that are not there are black. */
static void copy_fields(const bonn_file *bonn, uint32_t view, uint32_t light0, uint32_t lights, size_t texels,
                        const tile *t, float *out) {
  const uint64_t field = bonn->channels * bonn->pairs;
  const uint64_t first = (bonn->lights[view].before + light0) * bonn->channels;
  const uint64_t chunk_texels = (uint64_t)bonn->fields.chunk_rows * bonn->width;
  for (size_t x = 0; x < texels; x++) {
    const uint64_t texel = t->texels[x], chunk = texel / chunk_texels;
    const uint64_t rank = bonn->fields.rank != NULL ? bonn->fields.rank[texel] : texel - chunk * chunk_texels;
    const bool there = rank != UINT32_MAX;
    const unsigned char *p = there ? bonn->fields.chunks[chunk] + 2 * (rank * field + first) : NULL;
    for (uint32_t l = 0; l < lights; l++)
      for (uint32_t c = 0; c < bonn->channels; c++)
        out[((size_t)c * lights + l) * texels + x] =
            there ? bonn_scalar(p + 2 * ((size_t)l * bonn->channels + c), 2) : 0.0f;
  }
}

static btf_status decode_tile(const bonn_file *bonn, uint32_t view, uint32_t light0, uint32_t lights,
                              size_t texels, tile *t) {
  float *planes[64];
  if (bonn->family == BONN_BDI) {
    copy_fields(bonn, view, light0, lights, texels, t, t->values);
    return BTF_OK;
  }
  for (uint32_t c = 0; c < bonn->channels; c++) {
    planes[c] = t->values + (size_t)c * lights * texels;
    BTF_TRY(decode_channel(bonn, view, light0, lights, texels, c, t, planes[c]));
  }
  bonn_to_reflectance(bonn, planes, lights * texels);
  return BTF_OK;
}

static void put_sample(const bonn_file *bonn, float value, char *to) {
  if (bonn->gives_halves) {
    const uint16_t half = btf_float_to_half(value);
    memcpy(to, &half, sizeof half);
  } else {
    memcpy(to, &value, sizeof value);
  }
}

static btf_status read_tiles(const bonn_file *bonn, const btf_block *block, tile *t, char *dst,
                             const btf_strides *strides) {
  const uint64_t texels = (uint64_t)block->width * block->height;
  for (uint64_t from = 0; from < texels; from += TILE_TEXELS) {
    const size_t count = texels - from < TILE_TEXELS ? (size_t)(texels - from) : TILE_TEXELS;
    for (size_t i = 0; i < count; i++) {
      const uint64_t x = block->x0 + (from + i) % block->width, y = block->y0 + (from + i) / block->width;
      t->texels[i] = (bonn->height - 1 - y) * bonn->width + x; /* the file's first row is the top one */
    }
    for (uint32_t v = 0; v < block->views; v++)
      for (uint32_t l0 = 0; l0 < block->lights; l0 += TILE_LIGHTS) {
        const uint32_t lights = block->lights - l0 < TILE_LIGHTS ? block->lights - l0 : TILE_LIGHTS;
        BTF_TRY(decode_tile(bonn, block->view0 + v, block->light0 + l0, lights, count, t));
        for (uint32_t c = 0; c < bonn->channels; c++)
          for (uint32_t l = 0; l < lights; l++)
            for (size_t i = 0; i < count; i++) {
              const ptrdiff_t x = (ptrdiff_t)((from + i) % block->width),
                              y = (ptrdiff_t)((from + i) / block->width);
              char *to = dst + (ptrdiff_t)v * strides->view + (ptrdiff_t)(l0 + l) * strides->light +
                         y * strides->y + x * strides->x + (ptrdiff_t)c * strides->channel;
              put_sample(bonn, t->values[((size_t)c * lights + l) * count + i], to);
            }
      }
  }
  return BTF_OK;
}

btf_status bonn_read(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  const bonn_file *bonn = user;
  const btf_host *host = bonn->file.host;
  btf_context *ctx = bonn->file.ctx;
  const uint64_t texels = (uint64_t)block->width * block->height;
  const uint64_t most_texels = texels < TILE_TEXELS ? texels : TILE_TEXELS;
  const uint64_t most_lights = block->lights < TILE_LIGHTS ? block->lights : TILE_LIGHTS;
  uint64_t k = 1;
  for (uint32_t i = 0; i < bonn->factor_count; i++)
    if (bonn->factors[i].k > k) k = bonn->factors[i].k;
  tile *t = (host->alloc)(ctx, 1, sizeof *t);
  if (t == NULL) return BTF_E_NOMEM;
  t->angular = (host->alloc)(ctx, most_lights * k, sizeof(float));
  t->texel = (host->alloc)(ctx, most_texels * k, sizeof(float));
  t->values = (host->alloc)(ctx, most_lights * most_texels * bonn->channels, sizeof(float));
  const btf_status status = t->angular != NULL && t->texel != NULL && t->values != NULL
                                ? read_tiles(bonn, block, t, dst, strides)
                                : BTF_E_NOMEM;
  (host->free)(ctx, t->angular);
  (host->free)(ctx, t->texel);
  (host->free)(ctx, t->values);
  (host->free)(ctx, t);
  return status;
}
