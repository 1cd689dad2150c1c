/* SPDX-License-Identifier: MIT */
/* kernel_scalar.c: the reference that the vector kernels are tested against, and the choice between them. */
#include "laplacian.h"

#include <btf/btf_half.h>

static float read_f16(const unsigned char *row, uint32_t i) {
  return btf_half_at(row, i);
}

static float read_f32(const unsigned char *row, uint32_t i) {
  float value;
  memcpy(&value, row + 4 * (size_t)i, sizeof value);
  return value;
}

#define DEFINE_BLEND(storage)                                                                                \
  static float blend_value_##storage(const unsigned char *const *row, const float *weight, uint32_t count,   \
                                     uint32_t i) {                                                           \
    float sum = weight[0] * read_##storage(row[0], i);                                                       \
    for (uint32_t r = 1; r < count; r++) sum += weight[r] * read_##storage(row[r], i);                       \
    return sum;                                                                                              \
  }                                                                                                          \
  static void blend_##storage(const btfi_laplacian_rows *rows, uint32_t n, float *dst) {                     \
    for (uint32_t i = 0; i < n; i++)                                                                         \
      dst[i] = blend_value_##storage(rows->row, rows->weight, rows->count, i);                               \
  }                                                                                                          \
  static void blend4_##storage(const unsigned char *const row[4], const float weight[4], uint32_t n,         \
                               float *dst) {                                                                 \
    for (uint32_t i = 0; i < n; i++) dst[i] = blend_value_##storage(row, weight, 4, i);                      \
  }
DEFINE_BLEND(f16)
DEFINE_BLEND(f32)

static void dot(const float *eigen, const float *weights, const float *scale, uint32_t stride, uint32_t n,
                float out[3]) {
  for (uint32_t c = 0; c < 3; c++) {
    float sum = 0.0f;
    for (uint32_t i = 0; i < n; i++) sum += eigen[i] * weights[i] * scale[(size_t)c * stride + i];
    out[c] = sum;
  }
}

const btfi_laplacian_kernels btfi_laplacian_scalar = {{blend_f16, blend_f32}, {blend4_f16, blend4_f32}, dot};

const btfi_laplacian_kernels *btfi_laplacian_kernels_of(uint32_t isa) {
#if defined(__x86_64__)
  if (isa == BTF_ISA_AVX2 || isa == BTF_ISA_AVX512) return &btfi_laplacian_avx2;
#endif
  (void)isa;
  return &btfi_laplacian_scalar;
}
