/* SPDX-License-Identifier: MIT */
/* kernel_avx2.c: AVX2 with FMA and F16C. Values are taken eight at a time from every start in a table; what
 * is read beyond the terms of a view meets a lambda of 0, since the scales are 0 there. */
#include "pvpca.h"

#if defined(__x86_64__)
#include <immintrin.h>
#include <string.h>

#define TARGET __attribute__((target("avx2,fma,f16c")))
#define INLINE static inline __attribute__((always_inline)) TARGET

enum { LANES = 8 };

INLINE __m256 read8_f32(const unsigned char *p) {
  return _mm256_loadu_ps((const float *)(const void *)p);
}
INLINE __m256 read8_f16(const unsigned char *p) {
  return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(const void *)p));
}
INLINE __m256 read8_q8(const unsigned char *p) {
  return _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)p)));
}
INLINE __m128 read4_f32(const unsigned char *p) {
  return _mm_loadu_ps((const float *)(const void *)p);
}
INLINE __m128 read4_f16(const unsigned char *p) {
  return _mm_cvtph_ps(_mm_loadl_epi64((const __m128i *)(const void *)p));
}
INLINE __m128 read4_q8(const unsigned char *p) {
  int32_t four;
  memcpy(&four, p, sizeof four);
  return _mm_cvtepi32_ps(_mm_cvtepi8_epi32(_mm_cvtsi32_si128(four)));
}

/* Sums over the lanes of four vectors. */
INLINE __m128 sum4(__m256 a, __m256 b, __m256 c, __m256 d) {
  const __m256 ab = _mm256_add_ps(_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
  const __m256 cd = _mm256_add_ps(_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
  const __m256 abcd = _mm256_add_ps(_mm256_shuffle_ps(ab, cd, 0x44), _mm256_shuffle_ps(ab, cd, 0xee));
  return _mm_add_ps(_mm256_castps256_ps128(abcd), _mm256_extractf128_ps(abcd, 1));
}

#define DEFINE_WEIGH(storage, size)                                                                          \
  INLINE void weigh_some_##storage(const btfi_pvpca_taps *t, const uint32_t lights, uint32_t channels,       \
                                   uint32_t padded, float *lambda) {                                         \
    const __m256 w0 = _mm256_set1_ps(t->light_weight[0]),                                                    \
                 w1 = _mm256_set1_ps(t->light_weight[lights > 1 ? 1 : 0]),                                   \
                 w2 = _mm256_set1_ps(t->light_weight[lights > 2 ? 2 : 0]);                                   \
    for (uint32_t k = 0; k < t->views; k++) {                                                                \
      const btfi_pvpca_tap *view = &t->view[k];                                                              \
      const __m256 weight = _mm256_set1_ps(view->weight);                                                    \
      for (uint32_t i = 0; i < view->terms; i += LANES) {                                                    \
        const __m256 scale = _mm256_mul_ps(_mm256_loadu_ps(view->scale + i), weight);                        \
        size_t at = (size_t)i * (size);                                                                      \
        float *dst = lambda + (size_t)k * channels * padded + i;                                             \
        for (uint32_t c = 0; c < channels; c++, at += (size_t)view->terms * (size), dst += padded) {         \
          __m256 sum = _mm256_mul_ps(w0, read8_##storage(view->g[0] + at));                                  \
          if (lights > 1) sum = _mm256_fmadd_ps(w1, read8_##storage(view->g[1] + at), sum);                  \
          if (lights > 2) sum = _mm256_fmadd_ps(w2, read8_##storage(view->g[2] + at), sum);                  \
          _mm256_storeu_ps(dst, _mm256_mul_ps(sum, scale));                                                  \
        }                                                                                                    \
      }                                                                                                      \
    }                                                                                                        \
  }                                                                                                          \
  static TARGET void weigh_##storage(const btfi_pvpca_taps *t, uint32_t channels, uint32_t padded,           \
                                     float *lambda) {                                                        \
    if (t->lights == 3)                                                                                      \
      weigh_some_##storage(t, 3, channels, padded, lambda);                                                  \
    else if (t->lights == 2)                                                                                 \
      weigh_some_##storage(t, 2, channels, padded, lambda);                                                  \
    else                                                                                                     \
      weigh_some_##storage(t, 1, channels, padded, lambda);                                                  \
  }
DEFINE_WEIGH(f32, 4)
DEFINE_WEIGH(f16, 2)

/* Blends of eight values, or of the four that begin with a mean, over `texels` rows: a constant in the
 * commonest case, whose weights then stay in registers. */
#define DEFINE_TEXELS(storage)                                                                               \
  INLINE __m256 texels8_##storage(const btfi_pvpca_taps *t, const btfi_pvpca_tap *view,                      \
                                  const uint32_t texels, size_t at) {                                        \
    __m256 sum = _mm256_mul_ps(_mm256_set1_ps(t->texel_weight[0]), read8_##storage(view->h[0] + at));        \
    for (uint32_t r = 1; r < texels; r++)                                                                    \
      sum = _mm256_fmadd_ps(_mm256_set1_ps(t->texel_weight[r]), read8_##storage(view->h[r] + at), sum);      \
    return sum;                                                                                              \
  }                                                                                                          \
  INLINE __m128 texels4_##storage(const btfi_pvpca_taps *t, const btfi_pvpca_tap *view,                      \
                                  const uint32_t texels, size_t at) {                                        \
    __m128 sum = _mm_mul_ps(_mm_set1_ps(t->texel_weight[0]), read4_##storage(view->h[0] + at));              \
    for (uint32_t r = 1; r < texels; r++)                                                                    \
      sum = _mm_fmadd_ps(_mm_set1_ps(t->texel_weight[r]), read4_##storage(view->h[r] + at), sum);            \
    return sum;                                                                                              \
  }

/* Up to four channels from `lambda` on, whose rows are `padded` apart; h are the blended texels of each view.
 */
INLINE __m128 dot_channels(const btfi_pvpca_taps *t, const float *h, uint32_t padded, const float *lambda,
                           size_t view_step, const uint32_t channels) {
  __m256 a = _mm256_setzero_ps(), b = a, c = a, d = a;
  for (uint32_t k = 0; k < t->views; k++, lambda += view_step) {
    for (uint32_t i = 0; i < t->view[k].terms; i += LANES) {
      const __m256 value = _mm256_loadu_ps(h + (size_t)k * padded + i);
      a = _mm256_fmadd_ps(value, _mm256_loadu_ps(lambda + i), a);
      if (channels > 1) b = _mm256_fmadd_ps(value, _mm256_loadu_ps(lambda + padded + i), b);
      if (channels > 2) c = _mm256_fmadd_ps(value, _mm256_loadu_ps(lambda + 2 * (size_t)padded + i), c);
      if (channels > 3) d = _mm256_fmadd_ps(value, _mm256_loadu_ps(lambda + 3 * (size_t)padded + i), d);
    }
  }
  return sum4(a, b, c, d);
}

INLINE void put_channels(__m128 sum, float mean, const uint32_t channels, float *out) {
  float four[4];
  _mm_storeu_ps(four, _mm_add_ps(sum, _mm_set1_ps(mean)));
  for (uint32_t i = 0; i < channels; i++) out[i] = four[i];
}

#define DEFINE_SHADE_LIGHTS(storage, size)                                                                   \
  INLINE void lights_some_##storage(const btfi_pvpca_taps *t, const uint32_t texels, uint32_t channels,      \
                                    uint32_t padded, const float *lambda, float *out) {                      \
    float h[3 * PVPCA_MAX_TERMS];                                                                            \
    const size_t view_step = (size_t)channels * padded;                                                      \
    __m128 mean = _mm_setzero_ps();                                                                          \
    uint32_t c = 0;                                                                                          \
    for (uint32_t k = 0; k < t->views; k++) {                                                                \
      const btfi_pvpca_tap *view = &t->view[k];                                                              \
      const uint32_t first = view->columns - view->terms;                                                    \
      if (first != 0)                                                                                        \
        mean = _mm_fmadd_ps(texels4_##storage(t, view, texels, 0), _mm_set1_ps(view->mean_weight), mean);    \
      for (uint32_t i = 0; i < view->terms; i += LANES)                                                      \
        _mm256_storeu_ps(h + (size_t)k * padded + i,                                                         \
                         texels8_##storage(t, view, texels, (size_t)(first + i) * (size)));                  \
    }                                                                                                        \
    const float m = _mm_cvtss_f32(mean);                                                                     \
    for (; c + 4 <= channels; c += 4)                                                                        \
      put_channels(dot_channels(t, h, padded, lambda + (size_t)c * padded, view_step, 4), m, 4, out + c);    \
    lambda += (size_t)c * padded;                                                                            \
    if (channels - c == 3)                                                                                   \
      put_channels(dot_channels(t, h, padded, lambda, view_step, 3), m, 3, out + c);                         \
    else if (channels - c == 2)                                                                              \
      put_channels(dot_channels(t, h, padded, lambda, view_step, 2), m, 2, out + c);                         \
    else if (channels - c == 1)                                                                              \
      put_channels(dot_channels(t, h, padded, lambda, view_step, 1), m, 1, out + c);                         \
  }                                                                                                          \
  static TARGET void shade_lights_##storage(const btfi_pvpca_taps *t, uint32_t channels, uint32_t padded,    \
                                            const float *lambda, float *out) {                               \
    if (t->texels == 4)                                                                                      \
      lights_some_##storage(t, 4, channels, padded, lambda, out);                                            \
    else                                                                                                     \
      lights_some_##storage(t, t->texels, channels, padded, lambda, out);                                    \
  }

#define DEFINE_SHADE_TEXELS(storage, size)                                                                   \
  INLINE void texels_some_##storage(const btfi_pvpca_taps *t, const uint32_t texels, uint32_t channels,      \
                                    uint32_t padded, const float *lambda, float *out) {                      \
    for (uint32_t c = 0; c < channels; c++) {                                                                \
      __m256 sum = _mm256_setzero_ps();                                                                      \
      __m128 mean = _mm_setzero_ps();                                                                        \
      for (uint32_t k = 0; k < t->views; k++) {                                                              \
        const btfi_pvpca_tap *view = &t->view[k];                                                            \
        const uint32_t first = view->columns - view->terms;                                                  \
        const size_t at = (size_t)c * view->columns * (size);                                                \
        if (first != 0)                                                                                      \
          mean = _mm_fmadd_ps(texels4_##storage(t, view, texels, at), _mm_set1_ps(view->mean_weight), mean); \
        for (uint32_t i = 0; i < view->terms; i += LANES)                                                    \
          sum = _mm256_fmadd_ps(texels8_##storage(t, view, texels, at + (size_t)(first + i) * (size)),       \
                                _mm256_loadu_ps(lambda + (size_t)k * padded + i), sum);                      \
      }                                                                                                      \
      const __m256 zero = _mm256_setzero_ps();                                                               \
      out[c] = _mm_cvtss_f32(sum4(sum, zero, zero, zero)) + _mm_cvtss_f32(mean);                             \
    }                                                                                                        \
  }                                                                                                          \
  static TARGET void shade_texels_##storage(const btfi_pvpca_taps *t, uint32_t channels, uint32_t padded,    \
                                            const float *lambda, float *out) {                               \
    if (t->texels == 4)                                                                                      \
      texels_some_##storage(t, 4, channels, padded, lambda, out);                                            \
    else                                                                                                     \
      texels_some_##storage(t, t->texels, channels, padded, lambda, out);                                    \
  }

#define DEFINE_SHADE(storage, size)                                                                          \
  DEFINE_TEXELS(storage)                                                                                     \
  DEFINE_SHADE_LIGHTS(storage, size)                                                                         \
  DEFINE_SHADE_TEXELS(storage, size)
DEFINE_SHADE(f32, 4)
DEFINE_SHADE(f16, 2)
DEFINE_SHADE(q8, 1)

const btfi_pvpca_kernels btfi_pvpca_avx2 = {{weigh_f32, weigh_f16, NULL},
                                            {{shade_lights_f32, shade_lights_f16, shade_lights_q8},
                                             {shade_texels_f32, shade_texels_f16, shade_texels_q8}}};
#else
typedef int btfi_pvpca_no_avx2;
#endif
