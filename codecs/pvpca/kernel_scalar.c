/* SPDX-License-Identifier: MIT */
/* kernel_scalar.c: the reference that the vector kernels are tested against, and the choice between them. */
#include "pvpca.h"

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

static float read_q8(const unsigned char *row, uint32_t i) {
  int8_t byte;
  memcpy(&byte, row + i, sizeof byte);
  return (float)byte;
}

#define DEFINE_WEIGH(storage)                                                                                \
  static void weigh_##storage(const btfi_pvpca_taps *t, uint32_t channels, uint32_t padded, float *lambda) { \
    for (uint32_t k = 0; k < t->views; k++) {                                                                \
      const btfi_pvpca_tap *view = &t->view[k];                                                              \
      for (uint32_t c = 0; c < channels; c++, lambda += padded) {                                            \
        for (uint32_t i = 0; i < view->terms; i++) {                                                         \
          float sum = 0.0f;                                                                                  \
          for (uint32_t r = 0; r < t->lights; r++)                                                           \
            sum += t->light_weight[r] * read_##storage(view->g[r], c * view->terms + i);                     \
          lambda[i] = sum * (view->scale[i] * view->weight);                                                 \
        }                                                                                                    \
      }                                                                                                      \
    }                                                                                                        \
  }
DEFINE_WEIGH(f32)
DEFINE_WEIGH(f16)

#define DEFINE_SHADE(storage)                                                                                \
  static float texels_##storage(const btfi_pvpca_taps *t, const btfi_pvpca_tap *view, uint32_t i) {          \
    float sum = 0.0f;                                                                                        \
    for (uint32_t r = 0; r < t->texels; r++) sum += t->texel_weight[r] * read_##storage(view->h[r], i);      \
    return sum;                                                                                              \
  }                                                                                                          \
  static void shade_lights_##storage(const btfi_pvpca_taps *t, uint32_t channels, uint32_t padded,           \
                                     const float *lambda, float *out) {                                      \
    float mean = 0.0f;                                                                                       \
    for (uint32_t c = 0; c < channels; c++) out[c] = 0.0f;                                                   \
    for (uint32_t k = 0; k < t->views; k++) {                                                                \
      const btfi_pvpca_tap *view = &t->view[k];                                                              \
      const uint32_t first = view->columns - view->terms;                                                    \
      if (first != 0) mean += view->mean_weight * texels_##storage(t, view, 0);                              \
      for (uint32_t i = 0; i < view->terms; i++) {                                                           \
        const float h = texels_##storage(t, view, first + i);                                                \
        for (uint32_t c = 0; c < channels; c++)                                                              \
          out[c] += h * lambda[((size_t)k * channels + c) * padded + i];                                     \
      }                                                                                                      \
    }                                                                                                        \
    for (uint32_t c = 0; c < channels; c++) out[c] += mean;                                                  \
  }                                                                                                          \
  static void shade_texels_##storage(const btfi_pvpca_taps *t, uint32_t channels, uint32_t padded,           \
                                     const float *lambda, float *out) {                                      \
    for (uint32_t c = 0; c < channels; c++) {                                                                \
      float sum = 0.0f, mean = 0.0f;                                                                         \
      for (uint32_t k = 0; k < t->views; k++) {                                                              \
        const btfi_pvpca_tap *view = &t->view[k];                                                            \
        const uint32_t first = view->columns - view->terms, at = c * view->columns;                          \
        if (first != 0) mean += view->mean_weight * texels_##storage(t, view, at);                           \
        for (uint32_t i = 0; i < view->terms; i++)                                                           \
          sum += texels_##storage(t, view, at + first + i) * lambda[(size_t)k * padded + i];                 \
      }                                                                                                      \
      out[c] = sum + mean;                                                                                   \
    }                                                                                                        \
  }
DEFINE_SHADE(f32)
DEFINE_SHADE(f16)
DEFINE_SHADE(q8)

const btfi_pvpca_kernels btfi_pvpca_scalar = {{weigh_f32, weigh_f16, NULL},
                                              {{shade_lights_f32, shade_lights_f16, shade_lights_q8},
                                               {shade_texels_f32, shade_texels_f16, shade_texels_q8}}};

const btfi_pvpca_kernels *btfi_pvpca_kernels_of(uint32_t isa) {
#if defined(__x86_64__)
  if (isa == BTF_ISA_AVX2 || isa == BTF_ISA_AVX512) return &btfi_pvpca_avx2;
#endif
  (void)isa;
  return &btfi_pvpca_scalar;
}
