/* SPDX-License-Identifier: MIT */
/* kernel_scalar.c: the reference that the vector kernels are tested against, and the choice between them. */
#include "fmf.h"

#include <string.h>

#include <btf/btf_half.h>

static float read_f32(const unsigned char *row, uint32_t i) {
  float value;
  memcpy(&value, row + 4 * (size_t)i, sizeof value);
  return value;
}

static float read_f16(const unsigned char *row, uint32_t i) {
  return btf_half_at(row, i);
}

static float read_bf16(const unsigned char *row, uint32_t i) {
  uint16_t half;
  uint32_t bits;
  float value;
  memcpy(&half, row + 2 * (size_t)i, sizeof half);
  bits = (uint32_t)half << 16;
  memcpy(&value, &bits, sizeof value);
  return value;
}

static float read_q8(const unsigned char *row, uint32_t i) {
  int8_t byte;
  memcpy(&byte, row + i, sizeof byte);
  return (float)byte;
}

#define DEFINE_KERNELS(storage)                                                                              \
  static float blend_value_##storage(const btfi_fmf_rows *rows, uint64_t offset, uint32_t i) {               \
    float sum = rows->weight[0] * read_##storage(rows->row[0] + offset, i);                                  \
    for (uint32_t r = 1; r < rows->count; r++)                                                               \
      sum += rows->weight[r] * read_##storage(rows->row[r] + offset, i);                                     \
    return sum;                                                                                              \
  }                                                                                                          \
  static void blend_##storage(const btfi_fmf_rows *rows, uint32_t padded, const float *scale, float *dst) {  \
    for (uint32_t i = 0; i < padded; i++) dst[i] = blend_value_##storage(rows, 0, i) * scale[i];             \
  }                                                                                                          \
  static void project_##storage(const btfi_fmf_rows *rows, uint64_t channel_bytes, uint32_t channels,        \
                                const float *v, uint32_t padded, float *keep, float *out) {                  \
    uint64_t start = 0;                                                                                      \
    for (uint32_t channel = 0; channel < channels; channel++, start += channel_bytes) {                      \
      float sum = 0.0f;                                                                                      \
      for (uint32_t i = 0; i < padded; i++) {                                                                \
        const float u = blend_value_##storage(rows, start, i);                                               \
        if (keep != NULL) keep[(size_t)channel * padded + i] = u;                                            \
        sum += u * v[i];                                                                                     \
      }                                                                                                      \
      out[channel] = sum;                                                                                    \
    }                                                                                                        \
  }                                                                                                          \
  static void sample_##storage(const unsigned char *u, uint64_t channel_bytes, uint32_t channels,            \
                               const unsigned char *v, uint32_t padded, const float *scale, float *out) {    \
    for (uint32_t channel = 0; channel < channels; channel++, u += channel_bytes) {                          \
      out[channel] = 0.0f;                                                                                   \
      for (uint32_t i = 0; i < padded; i++)                                                                  \
        out[channel] += read_##storage(u, i) * (read_##storage(v, i) * scale[i]);                            \
    }                                                                                                        \
  }
DEFINE_KERNELS(f32)
DEFINE_KERNELS(f16)
DEFINE_KERNELS(bf16)
DEFINE_KERNELS(q8)

static void dot(const float *kept, uint32_t channels, const float *v, uint32_t padded, float *out) {
  for (uint32_t channel = 0; channel < channels; channel++, kept += padded) {
    float sum = 0.0f;
    for (uint32_t i = 0; i < padded; i++) sum += kept[i] * v[i];
    out[channel] = sum;
  }
}

static void permute(uint32_t storage, uint32_t padded, const float *natural, float *out) {
  (void)storage;
  memcpy(out, natural, padded * sizeof *out);
}

const btfi_fmf_kernels btfi_fmf_scalar = {{blend_f32, blend_f16, blend_bf16, blend_q8},
                                          {project_f32, project_f16, project_bf16, project_q8},
                                          {sample_f32, sample_f16, sample_bf16, sample_q8},
                                          dot,
                                          permute};

const btfi_fmf_kernels *btfi_fmf_kernels_of(uint32_t isa) {
#if defined(__x86_64__)
  if (isa == BTF_ISA_AVX512) return &btfi_fmf_avx512;
  if (isa == BTF_ISA_AVX2) return &btfi_fmf_avx2;
#elif defined(__aarch64__)
  if (isa == BTF_ISA_NEON) return &btfi_fmf_neon;
#endif
  (void)isa;
  return &btfi_fmf_scalar;
}
