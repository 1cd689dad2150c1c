/* SPDX-License-Identifier: MIT */
/* layout.c: where the evaluation tables keep their values, and the storage types. */
#include "lpca.h"

#include <btf/btf_half.h>
#include <btf/btf_sampling.h>

enum { CACHE_LINE = 64 };

/* Rows that fit a cache line do not cross one, longer ones begin with one. */
static uint64_t aligned_row(uint64_t bytes) {
  uint64_t unit = 16;
  if (bytes > CACHE_LINE) return (bytes + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE;
  while (unit < bytes) unit *= 2;
  return unit;
}

/* count * size + LPCA_SLACK */
static bool table_bytes(uint64_t count, uint64_t size, uint64_t *out) {
  return !__builtin_mul_overflow(count, size, out) &&
         !__builtin_add_overflow(*out, (uint64_t)LPCA_SLACK, out);
}

bool btfi_lpca_layout_of(const btf_model_shape *shape, uint32_t lights, uint32_t views,
                         btfi_lpca_layout *out) {
  const bool tight = out->packing == LPCA_TIGHT;
  uint64_t pairs;
  if (out->levels > LPCA_MAX_LEVELS) return false;
  out->channels = shape->channels;
  out->lights = lights;
  out->views = views;
  out->width = shape->width;
  out->height = shape->height;
  out->stride = tight ? out->components : (out->components + 3u) & ~3u;
  out->padded = (out->components + LPCA_LANES - 1u) / LPCA_LANES * LPCA_LANES;
  out->factor_bytes = out->storage == LPCA_F32 ? 4u : out->storage == LPCA_F16 ? 2u : 1u;
  out->mean_bytes = out->weight_bytes = out->storage == LPCA_F32 ? 4u : 2u;
  out->index_bytes = out->clusters <= 256 ? 1u : 2u;
  out->mean_at = (uint64_t)out->channels * out->stride * out->factor_bytes;
  out->row_data_bytes = out->mean_at + (uint64_t)out->channels * out->mean_bytes;
  out->row_bytes = tight ? out->row_data_bytes : aligned_row(out->row_data_bytes);
  if (__builtin_mul_overflow((uint64_t)lights, (uint64_t)views, &pairs) ||
      __builtin_mul_overflow(pairs, out->row_bytes, &out->cluster_bytes) ||
      !table_bytes(out->cluster_bytes, out->clusters, &out->factors_bytes))
    return false;
  out->texel_bytes = (uint64_t)out->components * out->weight_bytes;
  for (uint32_t level = 0; level < out->levels; level++) {
    out->level_width[level] = btf_sampling_level_size(shape->width, level);
    out->level_height[level] = btf_sampling_level_size(shape->height, level);
    const uint64_t texels = (uint64_t)out->level_width[level] * out->level_height[level];
    out->index_table_bytes[level] = texels * out->index_bytes;
    if (!table_bytes(texels, out->texel_bytes, &out->weight_table_bytes[level])) return false;
  }
  return true;
}

float btfi_lpca_store_value(uint32_t storage, float value, unsigned char *dst) {
  if (storage == LPCA_F32) {
    btf_put_f32(dst, value);
    return value;
  }
  const uint16_t half = btf_float_to_half(value);
  dst[0] = (unsigned char)half;
  dst[1] = (unsigned char)(half >> 8);
  return btf_half_to_float(half);
}

float btfi_lpca_store_factor(uint32_t storage, float value, unsigned char *dst) {
  if (storage != LPCA_Q8) return btfi_lpca_store_value(storage, value, dst);
  const int8_t byte = (int8_t)(value * 127.0f + (value < 0.0f ? -0.5f : 0.5f));
  *dst = (unsigned char)byte;
  return (float)byte * (1.0f / 127.0f);
}
