/* SPDX-License-Identifier: MIT */
/* kernel_avx2.c: AVX2 with FMA and F16C. */
#include "laplacian.h"

#if defined(__x86_64__)
#include <immintrin.h>

#define TARGET __attribute__((target("avx2,fma,f16c")))
#define READ_F16(p) _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(const void *)(p)))
#define READ_F32(p) _mm256_loadu_ps((const float *)(const void *)(p))

/* Several vectors side by side hide the latency of their chains of additions. */
#define DEFINE_BLEND(name, READ, size)                                                                       \
  TARGET static void name(const btfi_laplacian_rows *rows, uint32_t n, float *dst) {                         \
    uint32_t i = 0;                                                                                          \
    for (; i + 24 < n; i += 32) {                                                                            \
      const size_t at = (size_t)i * (size);                                                                  \
      __m256 s0 = _mm256_setzero_ps(), s1 = s0, s2 = s0, s3 = s0;                                            \
      for (uint32_t r = 0; r < rows->count; r++) {                                                           \
        const unsigned char *row = rows->row[r] + at;                                                        \
        const __m256 w = _mm256_set1_ps(rows->weight[r]);                                                    \
        s0 = _mm256_fmadd_ps(w, READ(row), s0);                                                              \
        s1 = _mm256_fmadd_ps(w, READ(row + 8 * (size)), s1);                                                 \
        s2 = _mm256_fmadd_ps(w, READ(row + 16 * (size)), s2);                                                \
        s3 = _mm256_fmadd_ps(w, READ(row + 24 * (size)), s3);                                                \
      }                                                                                                      \
      _mm256_storeu_ps(dst + i, s0);                                                                         \
      _mm256_storeu_ps(dst + i + 8, s1);                                                                     \
      _mm256_storeu_ps(dst + i + 16, s2);                                                                    \
      _mm256_storeu_ps(dst + i + 24, s3);                                                                    \
    }                                                                                                        \
    for (; i + 8 < n; i += 16) {                                                                             \
      const size_t at = (size_t)i * (size);                                                                  \
      __m256 s0 = _mm256_setzero_ps(), s1 = s0;                                                              \
      for (uint32_t r = 0; r < rows->count; r++) {                                                           \
        const unsigned char *row = rows->row[r] + at;                                                        \
        const __m256 w = _mm256_set1_ps(rows->weight[r]);                                                    \
        s0 = _mm256_fmadd_ps(w, READ(row), s0);                                                              \
        s1 = _mm256_fmadd_ps(w, READ(row + 8 * (size)), s1);                                                 \
      }                                                                                                      \
      _mm256_storeu_ps(dst + i, s0);                                                                         \
      _mm256_storeu_ps(dst + i + 8, s1);                                                                     \
    }                                                                                                        \
    if (i < n) {                                                                                             \
      const size_t at = (size_t)i * (size);                                                                  \
      __m256 s0 = _mm256_setzero_ps();                                                                       \
      for (uint32_t r = 0; r < rows->count; r++)                                                             \
        s0 = _mm256_fmadd_ps(_mm256_set1_ps(rows->weight[r]), READ(rows->row[r] + at), s0);                  \
      _mm256_storeu_ps(dst + i, s0);                                                                         \
    }                                                                                                        \
  }
DEFINE_BLEND(blend_f16, READ_F16, 2)
DEFINE_BLEND(blend_f32, READ_F32, 4)

#define DEFINE_BLEND4(name, READ, size)                                                                      \
  TARGET static void name(const unsigned char *const row[4], const float weight[4], uint32_t n,              \
                          float *dst) {                                                                      \
    const __m256 w0 = _mm256_set1_ps(weight[0]), w1 = _mm256_set1_ps(weight[1]),                             \
                 w2 = _mm256_set1_ps(weight[2]), w3 = _mm256_set1_ps(weight[3]);                             \
    for (uint32_t i = 0; i < n; i += 8) {                                                                    \
      const size_t at = (size_t)i * (size);                                                                  \
      const __m256 a = _mm256_fmadd_ps(w1, READ(row[1] + at), _mm256_mul_ps(w0, READ(row[0] + at)));         \
      const __m256 b = _mm256_fmadd_ps(w3, READ(row[3] + at), _mm256_mul_ps(w2, READ(row[2] + at)));         \
      _mm256_storeu_ps(dst + i, _mm256_add_ps(a, b));                                                        \
    }                                                                                                        \
  }
DEFINE_BLEND4(blend4_f16, READ_F16, 2)
DEFINE_BLEND4(blend4_f32, READ_F32, 4)

TARGET static void dot(const float *eigen, const float *weights, const float *scale, uint32_t stride,
                       uint32_t n, float out[3]) {
  const float *scale1 = scale + stride, *scale2 = scale1 + stride;
  __m256 y = _mm256_setzero_ps(), cb = y, cr = y;
  for (uint32_t i = 0; i < n; i += 8) {
    const __m256 product = _mm256_mul_ps(_mm256_loadu_ps(eigen + i), _mm256_loadu_ps(weights + i));
    y = _mm256_fmadd_ps(product, _mm256_loadu_ps(scale + i), y);
    cb = _mm256_fmadd_ps(product, _mm256_loadu_ps(scale1 + i), cb);
    cr = _mm256_fmadd_ps(product, _mm256_loadu_ps(scale2 + i), cr);
  }
  const __m256 pair = _mm256_hadd_ps(y, cb), quad = _mm256_hadd_ps(pair, _mm256_hadd_ps(cr, cr));
  float sums[4];
  _mm_storeu_ps(sums, _mm_add_ps(_mm256_castps256_ps128(quad), _mm256_extractf128_ps(quad, 1)));
  out[0] = sums[0];
  out[1] = sums[1];
  out[2] = sums[2];
}

const btfi_laplacian_kernels btfi_laplacian_avx2 = {{blend_f16, blend_f32}, {blend4_f16, blend4_f32}, dot};
#else
typedef int btfi_laplacian_no_avx2;
#endif
