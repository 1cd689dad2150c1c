/* SPDX-License-Identifier: MIT */
#include "dataset/convert.h"

#include <math.h>
#include <string.h>

#include <btf/btf_half.h>
#include <btf/btf_plugin.h>

uint32_t btfi_sample_size(uint32_t sample_type) {
  switch (sample_type) {
  case BTF_SAMPLE_U8:
    return 1;
  case BTF_SAMPLE_U16:
    return 2;
  case BTF_SAMPLE_F16:
    return 2;
  case BTF_SAMPLE_F32:
    return 4;
  default:
    return 0;
  }
}

float btfi_sample_to_float(uint32_t sample_type, const void *src) {
  uint16_t half;
  float value;
  switch (sample_type) {
  case BTF_SAMPLE_U8:
    return (float)*(const uint8_t *)src / 255.0f;
  case BTF_SAMPLE_U16:
    memcpy(&half, src, sizeof half);
    return (float)half / 65535.0f;
  case BTF_SAMPLE_F16:
    memcpy(&half, src, sizeof half);
    return btf_half_to_float(half);
  default:
    memcpy(&value, src, sizeof value);
    return value;
  }
}

/* Samples may lie at any address (a host's own strides), so every access goes through memcpy. */

static bool unpack_u8(const void *src, float *dst, size_t n) {
  const uint8_t *in = src;
  for (size_t i = 0; i < n; ++i) dst[i] = (float)in[i] / 255.0f;
  return true;
}

static bool unpack_u16(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  for (size_t i = 0; i < n; ++i) {
    uint16_t sample;
    memcpy(&sample, in + 2 * i, sizeof sample);
    dst[i] = (float)sample / 65535.0f;
  }
  return true;
}

static bool unpack_f16(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  bool finite = true;
  for (size_t i = 0; i < n; ++i) {
    uint16_t sample;
    memcpy(&sample, in + 2 * i, sizeof sample);
    finite &= (sample & 0x7c00u) != 0x7c00u;
    dst[i] = btf_half_to_float(sample);
  }
  return finite;
}

static bool unpack_f32(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  uint32_t bad = 0;
  for (size_t i = 0; i < n; ++i) {
    uint32_t bits;
    memcpy(&bits, in + 4 * i, sizeof bits);
    bad |= (bits & 0x7f800000u) == 0x7f800000u;
    memcpy(dst + i, &bits, sizeof bits);
  }
  return bad == 0;
}

/* Rounds half up after clamping; integer types hold nothing outside 0..1, but NaN has no place there either.
 */
static bool pack_u8(const float *src, void *dst, size_t n) {
  uint8_t *out = dst;
  bool finite = true;
  for (size_t i = 0; i < n; ++i) {
    const float clamped = src[i] > 0.0f ? (src[i] < 1.0f ? src[i] : 1.0f) : 0.0f;
    finite &= fabsf(src[i]) <= 3.402823466e38f;
    out[i] = (uint8_t)(int32_t)(clamped * 255.0f + 0.5f);
  }
  return finite;
}

static bool pack_u16(const float *src, void *dst, size_t n) {
  unsigned char *out = dst;
  bool finite = true;
  for (size_t i = 0; i < n; ++i) {
    const float clamped = src[i] > 0.0f ? (src[i] < 1.0f ? src[i] : 1.0f) : 0.0f;
    /* In double, for 65534.5 + 0.5 and its like need one bit more than a float has to round exactly. */
    const uint16_t sample = (uint16_t)(int32_t)((double)clamped * 65535.0 + 0.5);
    finite &= fabsf(src[i]) <= 3.402823466e38f;
    memcpy(out + 2 * i, &sample, sizeof sample);
  }
  return finite;
}

static bool pack_f16(const float *src, void *dst, size_t n) {
  unsigned char *out = dst;
  bool fits = true;
  for (size_t i = 0; i < n; ++i) {
    const uint16_t sample = btf_float_to_half(src[i]);
    fits &= (sample & 0x7c00u) != 0x7c00u;
    memcpy(out + 2 * i, &sample, sizeof sample);
  }
  return fits;
}

static bool pack_f32(const float *src, void *dst, size_t n) {
  const bool finite = unpack_f32(src, (float *)dst, n);
  return finite;
}

static void transpose(const float *in, ptrdiff_t in_stride, float *out, ptrdiff_t out_stride, size_t rows,
                      size_t columns) {
  for (size_t i = 0; i < rows; ++i) {
    float *row = out + (ptrdiff_t)i * out_stride;
    for (size_t j = 0; j < columns; ++j) row[j] = in[(ptrdiff_t)j * in_stride + (ptrdiff_t)i];
  }
}

static void split3(const float *in, float *out0, float *out1, float *out2, size_t n) {
  for (size_t i = 0; i < n; ++i) {
    out0[i] = in[3 * i];
    out1[i] = in[3 * i + 1];
    out2[i] = in[3 * i + 2];
  }
}

btfi_convert_kernels btfi_convert_select(uint32_t sample_type, uint32_t isa) {
  static const btfi_unpack_fn unpack[] = {NULL, unpack_u8, unpack_f16, unpack_f32, unpack_u16};
  static const btfi_pack_fn pack[] = {NULL, pack_u8, pack_f16, pack_f32, pack_u16};
  btfi_convert_kernels kernels = {
      unpack[sample_type], pack[sample_type], transpose, split3, sample_type, btfi_sample_size(sample_type)};
#if defined(__x86_64__)
  btfi_convert_select_x86(&kernels, isa);
#else
  (void)isa;
#endif
  return kernels;
}
