/* SPDX-License-Identifier: MIT */
/* layout.c: where the evaluation tables keep their values, and the storage types. */
#include "pvpca.h"

#include <string.h>

#include <btf/btf_half.h>
#include <btf/btf_sampling.h>

uint32_t btfi_pvpca_value_bytes(uint32_t storage) {
  return storage == PVPCA_F32 ? 4u : storage == PVPCA_F16 ? 2u : 1u;
}

uint32_t btfi_pvpca_weight_storage(uint32_t storage) {
  return storage == PVPCA_Q8 ? (uint32_t)PVPCA_F16 : storage;
}

float btfi_pvpca_unit(uint32_t storage) {
  return storage == PVPCA_Q8 ? 127.0f : 1.0f;
}

bool btfi_pvpca_layout_of(btfi_pvpca_layout *out, btfi_pvpca_view *views) {
  const bool by_light = out->color == PVPCA_COLOR_LIGHTS;
  uint64_t g_bytes = 0;
  if (out->levels > PVPCA_MAX_LEVELS) return false;
  out->g_channels = by_light ? out->channels : 1;
  out->h_channels = by_light ? 1 : out->channels;
  out->h_bytes_value = btfi_pvpca_value_bytes(out->storage);
  out->g_bytes_value = btfi_pvpca_value_bytes(btfi_pvpca_weight_storage(out->storage));
  out->terms = 0;
  out->scales = out->padded_scales = out->h_texel_bytes = 0;
  out->padded = PVPCA_VECTOR;
  for (uint32_t v = 0; v < out->views; v++) {
    btfi_pvpca_view *view = &views[v];
    const uint32_t padded = (view->terms + PVPCA_VECTOR - 1) / PVPCA_VECTOR * PVPCA_VECTOR;
    uint64_t bytes;
    view->columns = out->has_mean + view->terms;
    view->h_texel_bytes = out->h_channels * view->columns * out->h_bytes_value;
    view->g_light_bytes = out->g_channels * view->terms * out->g_bytes_value;
    view->g_start = g_bytes;
    view->h_before = out->h_texel_bytes;
    view->scale_start = out->scales;
    view->padded_start = (uint32_t)out->padded_scales;
    if (__builtin_mul_overflow((uint64_t)out->lights, (uint64_t)view->g_light_bytes, &bytes) ||
        __builtin_add_overflow(g_bytes, bytes, &g_bytes) ||
        __builtin_add_overflow(out->terms, view->terms, &out->terms))
      return false;
    out->h_texel_bytes += view->h_texel_bytes;
    out->scales += view->columns;
    out->padded_scales += padded;
    if (out->padded_scales > UINT32_MAX) return false;
    if (padded > out->padded) out->padded = padded;
  }
  if (__builtin_add_overflow(g_bytes, (uint64_t)PVPCA_TABLE_TAIL, &out->g_bytes)) return false;
  for (uint32_t level = 0; level < out->levels; level++) {
    out->level_width[level] = btf_sampling_level_size(out->width, level);
    out->level_height[level] = btf_sampling_level_size(out->height, level);
    out->level_texels[level] = (uint64_t)out->level_width[level] * out->level_height[level];
    if (__builtin_mul_overflow(out->level_texels[level], out->h_texel_bytes, &out->h_bytes[level]) ||
        __builtin_add_overflow(out->h_bytes[level], (uint64_t)PVPCA_TABLE_TAIL, &out->h_bytes[level]))
      return false;
  }
  return true;
}

static int8_t to_q8(float value) {
  const float bounded = value > -1.0f ? (value < 1.0f ? value : 1.0f) : -1.0f;
  return (int8_t)(bounded * 127.0f + (bounded < 0.0f ? -0.5f : 0.5f));
}

float btfi_pvpca_round(uint32_t storage, float value) {
  if (storage == PVPCA_F16) return btf_half_to_float(btf_float_to_half(value));
  if (storage == PVPCA_Q8) return (float)to_q8(value) * (1.0f / 127.0f);
  return value;
}

void btfi_pvpca_store(uint32_t storage, const float *values, uint64_t n, unsigned char *dst) {
  if (storage == PVPCA_F16) {
    for (uint64_t i = 0; i < n; i++) {
      const uint16_t half = btf_float_to_half(values[i]);
      memcpy(dst + 2 * i, &half, sizeof half);
    }
  } else if (storage == PVPCA_Q8) {
    for (uint64_t i = 0; i < n; i++) {
      const int8_t byte = to_q8(values[i]);
      memcpy(dst + i, &byte, sizeof byte);
    }
  } else {
    memcpy(dst, values, (size_t)n * sizeof *values);
  }
}
