/* SPDX-License-Identifier: MIT */
/* kernel_avx2.c: AVX2 with FMA and F16C. */
#include "fmf.h"

#if defined(__x86_64__)
#include <immintrin.h>

#define NAME(x) x##_avx2
#define TARGET __attribute__((target("avx2,fma,f16c")))
#define VECTOR __m256
#define LANES 8
#define REGISTERS 16
#define ZERO _mm256_setzero_ps()
#define SET1(x) _mm256_set1_ps(x)
#define ADD(a, b) _mm256_add_ps((a), (b))
#define MUL(a, b) _mm256_mul_ps((a), (b))
#define FMA(a, b, c) _mm256_fmadd_ps((a), (b), (c))
#define LOAD(p) _mm256_loadu_ps(p)
#define STORE(p, a) _mm256_storeu_ps((p), (a))
#define READ_F16(p) _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(const void *)(p)))
#define READ_Q8(p)                                                                                           \
  _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)(p))))
#define READ_BF16(p)                                                                                         \
  _mm256_castsi256_ps(                                                                                       \
      _mm256_slli_epi32(_mm256_cvtepu16_epi32(_mm_loadu_si128((const __m128i *)(const void *)(p))), 16))
#define WORDS __m256i
#define LOAD_WORDS(p) _mm256_loadu_si256((const __m256i *)(const void *)(p))
#define LOW_BF16(words) _mm256_castsi256_ps(_mm256_slli_epi32((words), 16))
#define HIGH_BF16(words) _mm256_castsi256_ps(_mm256_and_si256((words), _mm256_set1_epi32((int)0xffff0000u)))
#define SUM4(a, b, c, d, out) sum4((a), (b), (c), (d), (out))

static inline __attribute__((always_inline)) TARGET void sum4(__m256 a, __m256 b, __m256 c, __m256 d,
                                                              float *out) {
  const __m256 ab = _mm256_add_ps(_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
  const __m256 cd = _mm256_add_ps(_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
  const __m256 abcd = _mm256_add_ps(_mm256_shuffle_ps(ab, cd, 0x44), _mm256_shuffle_ps(ab, cd, 0xee));
  _mm_storeu_ps(out, _mm_add_ps(_mm256_castps256_ps128(abcd), _mm256_extractf128_ps(abcd, 1)));
}

#include "kernel_template.h"
#else
typedef int btfi_fmf_no_avx2;
#endif
