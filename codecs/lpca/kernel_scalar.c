/* SPDX-License-Identifier: MIT */
/* kernel_scalar.c: the reference that the vector kernels are tested against, and the choice between them. */
#include "lpca.h"

#include <btf/btf_half.h>

static float read_f32(const unsigned char *values, uint64_t i) {
  float value;
  memcpy(&value, values + 4 * i, sizeof value);
  return value;
}

static float read_f16(const unsigned char *values, uint64_t i) {
  return btf_half_at(values, i);
}

static float read_q8(const unsigned char *values, uint64_t i) {
  int8_t byte;
  memcpy(&byte, values + i, sizeof byte);
  return (float)byte;
}

/* For each cluster among the texels: their weights blended, then per channel the mean and the components of
 * all rows. */
#define DEFINE_SHADE(storage, value)                                                                         \
  static void shade_##storage(const btfi_lpca_state *s, const btfi_lpca_taps *t, float *out) {               \
    const btfi_lpca_layout *layout = &s->layout;                                                             \
    uint32_t left = (1u << t->texels) - 1;                                                                   \
    for (uint32_t c = 0; c < layout->channels; c++) out[c] = 0.0f;                                           \
    while (left != 0) {                                                                                      \
      const uint32_t cluster = t->cluster[__builtin_ctz(left)];                                              \
      const float *scale = s->scales + (size_t)cluster * (layout->padded + LPCA_LANES);                      \
      const unsigned char *factors = s->factors + cluster * layout->cluster_bytes;                           \
      float weight[LPCA_MAX_COMPONENTS] = {0}, total = 0.0f;                                                 \
      for (uint32_t i = 0; i < t->texels; i++) {                                                             \
        if ((left >> i & 1) == 0 || t->cluster[i] != cluster) continue;                                      \
        left &= ~(1u << i);                                                                                  \
        total += t->texel_weight[i];                                                                         \
        for (uint32_t j = 0; j < layout->components; j++)                                                    \
          weight[j] += t->texel_weight[i] * read_##value(t->weights[i], j);                                  \
      }                                                                                                      \
      for (uint32_t j = 0; j < layout->components; j++) weight[j] *= scale[j];                               \
      total *= scale[layout->padded];                                                                        \
      for (uint32_t c = 0; c < layout->channels; c++) {                                                      \
        float mean = 0.0f, sum = 0.0f;                                                                       \
        for (uint32_t r = 0; r < t->rows; r++)                                                               \
          mean += t->row_weight[r] * read_##value(factors + t->row[r] + layout->mean_at, c);                 \
        for (uint32_t j = 0; j < layout->components; j++) {                                                  \
          float blended = 0.0f;                                                                              \
          for (uint32_t r = 0; r < t->rows; r++)                                                             \
            blended += t->row_weight[r] * read_##storage(factors + t->row[r] + c * s->channel_bytes, j);     \
          sum += weight[j] * blended;                                                                        \
        }                                                                                                    \
        out[c] += sum + total * mean;                                                                        \
      }                                                                                                      \
    }                                                                                                        \
  }
DEFINE_SHADE(f16, f16)
DEFINE_SHADE(f32, f32)
DEFINE_SHADE(q8, f16)

const btfi_lpca_shade_fn btfi_lpca_scalar[LPCA_STORAGES] = {shade_f16, shade_f32, shade_q8};

btfi_lpca_shade_fn btfi_lpca_shade_of(uint32_t isa, uint32_t storage) {
#if defined(__x86_64__)
  if (isa == BTF_ISA_AVX2 || isa == BTF_ISA_AVX512) return btfi_lpca_avx2[storage];
#endif
  (void)isa;
  return btfi_lpca_scalar[storage];
}
