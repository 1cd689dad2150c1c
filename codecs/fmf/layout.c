/* SPDX-License-Identifier: MIT */
/* layout.c: where the evaluation tables keep their values, and the storage types. */
#include "fmf.h"

#include <math.h>
#include <string.h>

#include <btf/btf_half.h>
#include <btf/btf_sampling.h>

enum { CACHE_LINE = 64 };

uint32_t btfi_fmf_value_bytes(uint32_t storage) {
  return storage == FMF_F32 ? 4u : storage == FMF_Q8 ? 1u : 2u;
}

static bool round_up(uint64_t value, uint64_t multiple, uint64_t *out) {
  if (__builtin_add_overflow(value, multiple - 1, out)) return false;
  *out -= *out % multiple;
  return true;
}

/* Rounds up to an odd number of cache lines. */
static bool odd_lines(uint64_t bytes, uint64_t *out) {
  if (!round_up(bytes, CACHE_LINE, out)) return false;
  if ((*out / CACHE_LINE) % 2 == 1) return true;
  return !__builtin_add_overflow(*out, (uint64_t)CACHE_LINE, out);
}

bool btfi_fmf_layout_of(const btf_model_shape *shape, uint32_t lights, uint32_t views, uint32_t storage,
                        uint32_t columns, uint32_t levels, btfi_fmf_layout *out) {
  const uint32_t value_bytes = btfi_fmf_value_bytes(storage);
  uint64_t values, pairs;
  memset(out, 0, sizeof *out);
  if (levels > FMF_MAX_LEVELS) return false;
  out->channels = shape->channels;
  out->lights = lights;
  out->views = views;
  out->width = shape->width;
  out->height = shape->height;
  out->storage = storage;
  out->columns = columns;
  out->levels = levels;
  out->stride = (columns + 3u) & ~3u;
  out->padded = (columns + 15u) & ~15u;
  out->u_data_bytes = ((uint64_t)(shape->channels - 1) * out->stride + out->padded) * value_bytes;
  if (!odd_lines(out->u_data_bytes, &out->u_row_bytes)) return false;
  if (__builtin_mul_overflow((uint64_t)lights, (uint64_t)views, &pairs) ||
      __builtin_mul_overflow(pairs, out->u_row_bytes, &out->u_bytes))
    return false;
  out->v_texel_bytes = (uint64_t)out->padded * value_bytes;
  for (uint32_t level = 0; level < levels; level++) {
    out->level_width[level] = btf_sampling_level_size(shape->width, level);
    out->level_height[level] = btf_sampling_level_size(shape->height, level);
    if (__builtin_mul_overflow((uint64_t)out->level_width[level], out->v_texel_bytes, &values) ||
        !odd_lines(values, &out->v_line_bytes[level]) ||
        __builtin_mul_overflow((uint64_t)out->level_height[level], out->v_line_bytes[level],
                               &out->v_bytes[level]))
      return false;
  }
  return true;
}

/* The bfloat16 nearest to a value, which is finite and far from overflow. */
static uint16_t to_bf16(float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return (uint16_t)((bits + 0x7fffu + (bits >> 16 & 1u)) >> 16);
}

/* Total: values of a hostile file may be infinite or NaN before it is refused. */
static int8_t to_q8(float value) {
  const float bounded = value > -1.0f ? (value < 1.0f ? value : 1.0f) : -1.0f;
  return (int8_t)(bounded * 127.0f + (bounded < 0.0f ? -0.5f : 0.5f));
}

float btfi_fmf_round(uint32_t storage, float value) {
  switch (storage) {
  case FMF_F16:
    return btf_half_to_float(btf_float_to_half(value));
  case FMF_BF16: {
    const uint32_t bits = (uint32_t)to_bf16(value) << 16;
    float rounded;
    memcpy(&rounded, &bits, sizeof rounded);
    return rounded;
  }
  case FMF_Q8:
    return (float)to_q8(value) * (1.0f / 127.0f);
  default:
    return value;
  }
}

void btfi_fmf_store(uint32_t storage, const float *values, uint64_t n, unsigned char *dst) {
  switch (storage) {
  case FMF_F16:
    for (uint64_t i = 0; i < n; i++) {
      const uint16_t half = btf_float_to_half(values[i]);
      memcpy(dst + 2 * i, &half, sizeof half);
    }
    break;
  case FMF_BF16:
    for (uint64_t i = 0; i < n; i++) {
      const uint16_t half = to_bf16(values[i]);
      memcpy(dst + 2 * i, &half, sizeof half);
    }
    break;
  case FMF_Q8:
    for (uint64_t i = 0; i < n; i++) {
      const int8_t byte = to_q8(values[i]);
      memcpy(dst + i, &byte, sizeof byte);
    }
    break;
  default:
    memcpy(dst, values, (size_t)n * sizeof *values);
    break;
  }
}
