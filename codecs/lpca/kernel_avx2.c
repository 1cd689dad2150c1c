/* SPDX-License-Identifier: MIT */
/* kernel_avx2.c: AVX2 with FMA and F16C. Components are read in whole vectors; what they read beyond the
 * components is finite in tables that fits write, and its weight is 0. */
#include "lpca.h"

#if defined(__x86_64__)
#include <immintrin.h>

#define TARGET __attribute__((target("avx2,fma,f16c")))
#define INLINE static inline __attribute__((always_inline)) TARGET

INLINE __m256 read_f16(const unsigned char *p) {
  return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(const void *)p));
}

INLINE __m256 read_f32(const unsigned char *p) {
  return _mm256_loadu_ps((const float *)(const void *)p);
}

INLINE __m256 read_q8(const unsigned char *p) {
  return _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)p)));
}

INLINE __m128 read4_f16(const unsigned char *p) {
  return _mm_cvtph_ps(_mm_loadl_epi64((const __m128i *)(const void *)p));
}

INLINE __m128 read4_f32(const unsigned char *p) {
  return _mm_loadu_ps((const float *)(const void *)p);
}

/* Sums over the lanes of three vectors. */
INLINE __m128 sum3(__m256 a, __m256 b, __m256 c) {
  const __m256 zero = _mm256_setzero_ps();
  const __m256 ab = _mm256_add_ps(_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
  const __m256 c0 = _mm256_add_ps(_mm256_unpacklo_ps(c, zero), _mm256_unpackhi_ps(c, zero));
  const __m256 abc = _mm256_add_ps(_mm256_shuffle_ps(ab, c0, 0x44), _mm256_shuffle_ps(ab, c0, 0xee));
  return _mm_add_ps(_mm256_castps256_ps128(abc), _mm256_extractf128_ps(abc, 1));
}

INLINE float total_of(__m256 a) {
  const __m128 four = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps(a, 1));
  const __m128 two = _mm_add_ps(four, _mm_movehl_ps(four, four));
  return _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps(two, two, 1)));
}

/* Three channels of components; fewer than three are counted by `many`, and the others read the first again.
 */
#define DEFINE_SHADE(storage, value, factor_bytes, value_bytes)                                              \
  INLINE __m128 three_##storage(const unsigned char *factors, const btfi_lpca_taps *t, uint64_t second,      \
                                uint64_t third, const float *weight, uint32_t padded) {                      \
    __m256 d0 = _mm256_setzero_ps(), d1 = d0, d2 = d0;                                                       \
    for (uint32_t j = 0; j < padded; j += LPCA_LANES) {                                                      \
      const unsigned char *at = factors + (size_t)j * (factor_bytes);                                        \
      __m256 a0 = _mm256_setzero_ps(), a1 = a0, a2 = a0;                                                     \
      for (uint32_t r = 0; r < t->rows; r++) {                                                               \
        const __m256 w = _mm256_broadcast_ss(&t->row_weight[r]);                                             \
        const unsigned char *row = at + t->row[r];                                                           \
        a0 = _mm256_fmadd_ps(w, read_##storage(row), a0);                                                    \
        a1 = _mm256_fmadd_ps(w, read_##storage(row + second), a1);                                           \
        a2 = _mm256_fmadd_ps(w, read_##storage(row + third), a2);                                            \
      }                                                                                                      \
      const __m256 v = _mm256_load_ps(weight + j);                                                           \
      d0 = _mm256_fmadd_ps(a0, v, d0);                                                                       \
      d1 = _mm256_fmadd_ps(a1, v, d1);                                                                       \
      d2 = _mm256_fmadd_ps(a2, v, d2);                                                                       \
    }                                                                                                        \
    return sum3(d0, d1, d2);                                                                                 \
  }                                                                                                          \
  /* The same for the one vector of up to LPCA_LANES components, and the means beside it in one go: every    \
   * weight and address is fetched once. */                                                                  \
  INLINE __m128 short_##storage(const unsigned char *factors, const btfi_lpca_taps *t, uint64_t second,      \
                                uint64_t means, __m256 weight, __m128 mean_weight) {                         \
    __m256 a0 = _mm256_setzero_ps(), a1 = a0, a2 = a0;                                                       \
    __m128 m = _mm_setzero_ps();                                                                             \
    for (uint32_t r = 0; r < t->rows; r++) {                                                                 \
      const __m256 w = _mm256_broadcast_ss(&t->row_weight[r]);                                               \
      const unsigned char *row = factors + t->row[r];                                                        \
      a0 = _mm256_fmadd_ps(w, read_##storage(row), a0);                                                      \
      a1 = _mm256_fmadd_ps(w, read_##storage(row + second), a1);                                             \
      a2 = _mm256_fmadd_ps(w, read_##storage(row + 2 * second), a2);                                         \
      m = _mm_fmadd_ps(_mm256_castps256_ps128(w), read4_##value(row + means), m);                            \
    }                                                                                                        \
    return _mm_fmadd_ps(                                                                                     \
        mean_weight, m,                                                                                      \
        sum3(_mm256_mul_ps(a0, weight), _mm256_mul_ps(a1, weight), _mm256_mul_ps(a2, weight)));              \
  }                                                                                                          \
  INLINE __m128 means_##storage(const unsigned char *means, const btfi_lpca_taps *t) {                       \
    __m128 m = _mm_setzero_ps();                                                                             \
    for (uint32_t r = 0; r < t->rows; r++)                                                                   \
      m = _mm_fmadd_ps(_mm_broadcast_ss(&t->row_weight[r]), read4_##value(means + t->row[r]), m);            \
    return m;                                                                                                \
  }                                                                                                          \
  TARGET static void shade_##storage(const btfi_lpca_state *s, const btfi_lpca_taps *t, float *out) {        \
    const uint32_t channels = s->layout.channels, padded = s->layout.padded;                                 \
    const uint64_t step = s->channel_bytes;                                                                  \
    _Alignas(32) float weight[LPCA_MAX_COMPONENTS];                                                          \
    _Alignas(32) float own[8];                                                                               \
    const __m256i clusters = _mm256_loadu_si256((const __m256i *)(const void *)t->cluster);                  \
    const __m256 texel_weights = _mm256_loadu_ps(t->texel_weight);                                           \
    _Alignas(16) float sums[LPCA_MAX_CHANNELS + 8];                                                          \
    uint32_t left = (1u << t->texels) - 1;                                                                   \
    __m128 rgb = _mm_setzero_ps();                                                                           \
    if (channels != 3) memset(sums, 0, sizeof sums);                                                         \
    while (left != 0) {                                                                                      \
      const uint32_t cluster = t->cluster[__builtin_ctz(left)];                                              \
      const float *scale = s->scales + (size_t)cluster * (padded + LPCA_LANES);                              \
      const unsigned char *factors = s->factors + cluster * s->layout.cluster_bytes;                         \
      /* Texels of other clusters count as 0: cheaper than unforeseeable branches. */                        \
      const __m256i same = _mm256_cmpeq_epi32(clusters, _mm256_set1_epi32((int)cluster));                    \
      const __m256 mine = _mm256_and_ps(_mm256_castsi256_ps(same), texel_weights);                           \
      left &= ~(uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(same));                                      \
      _mm256_store_ps(own, mine);                                                                            \
      const float total = total_of(mine);                                                                    \
      const __m128 mean_weight = _mm_set1_ps(total * scale[padded]);                                         \
      __m256 v = _mm256_setzero_ps();                                                                        \
      for (uint32_t j = 0; j < padded; j += LPCA_LANES) {                                                    \
        v = _mm256_setzero_ps();                                                                             \
        for (uint32_t i = 0; i < t->texels; i++)                                                             \
          v = _mm256_fmadd_ps(_mm256_broadcast_ss(&own[i]),                                                  \
                              read_##value(t->weights[i] + (size_t)j * (value_bytes)), v);                   \
        v = _mm256_mul_ps(v, _mm256_loadu_ps(scale + j));                                                    \
        _mm256_store_ps(weight + j, v);                                                                      \
      }                                                                                                      \
      if (channels == 3 && padded == LPCA_LANES) {                                                           \
        rgb = _mm_add_ps(rgb, short_##storage(factors, t, step, s->layout.mean_at, v, mean_weight));         \
        continue;                                                                                            \
      }                                                                                                      \
      const unsigned char *means = factors + s->layout.mean_at;                                              \
      if (channels == 3) {                                                                                   \
        const __m128 dots = three_##storage(factors, t, step, 2 * step, weight, padded);                     \
        rgb = _mm_add_ps(rgb, _mm_fmadd_ps(mean_weight, means_##storage(means, t), dots));                   \
        continue;                                                                                            \
      }                                                                                                      \
      for (uint32_t c = 0; c < channels; c += 4) {                                                           \
        const __m128 m = means_##storage(means + (size_t)c * (value_bytes), t);                              \
        _mm_storeu_ps(sums + c, _mm_fmadd_ps(mean_weight, m, _mm_loadu_ps(sums + c)));                       \
      }                                                                                                      \
      for (uint32_t c = 0; c < channels; c += 3) {                                                           \
        const uint64_t second = c + 1 < channels ? step : 0, third = c + 2 < channels ? 2 * step : 0;        \
        const __m128 dots = three_##storage(factors + c * step, t, second, third, weight, padded);           \
        _mm_storeu_ps(sums + c, _mm_add_ps(dots, _mm_loadu_ps(sums + c)));                                   \
      }                                                                                                      \
    }                                                                                                        \
    if (channels == 3) _mm_storeu_ps(sums, rgb);                                                             \
    for (uint32_t c = 0; c < channels; c++) out[c] = sums[c];                                                \
  }

DEFINE_SHADE(f16, f16, 2, 2)
DEFINE_SHADE(f32, f32, 4, 4)
DEFINE_SHADE(q8, f16, 1, 2)

const btfi_lpca_shade_fn btfi_lpca_avx2[LPCA_STORAGES] = {shade_f16, shade_f32, shade_q8};
#else
typedef int btfi_lpca_no_avx2;
#endif
