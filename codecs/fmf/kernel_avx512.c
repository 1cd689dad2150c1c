/* SPDX-License-Identifier: MIT */
/* kernel_avx512.c: AVX-512 F, BW, VL and DQ. */
#include "fmf.h"

#if defined(__x86_64__)
#include <immintrin.h>

#define NAME(x) x##_avx512
#define TARGET __attribute__((target("avx512f,avx512bw,avx512vl,avx512dq,avx2,fma,f16c")))
#define VECTOR __m512
#define LANES 16
#define REGISTERS 32
#define ZERO _mm512_setzero_ps()
#define SET1(x) _mm512_set1_ps(x)
#define ADD(a, b) _mm512_add_ps((a), (b))
#define MUL(a, b) _mm512_mul_ps((a), (b))
#define FMA(a, b, c) _mm512_fmadd_ps((a), (b), (c))
#define LOAD(p) _mm512_loadu_ps(p)
#define STORE(p, a) _mm512_storeu_ps((p), (a))
#define READ_F16(p) _mm512_cvtph_ps(_mm256_loadu_si256((const __m256i *)(const void *)(p)))
#define READ_Q8(p)                                                                                           \
  _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_loadu_si128((const __m128i *)(const void *)(p))))
#define READ_BF16(p)                                                                                         \
  _mm512_castsi512_ps(                                                                                       \
      _mm512_slli_epi32(_mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i *)(const void *)(p))), 16))
#define WORDS __m512i
#define LOAD_WORDS(p) _mm512_loadu_si512(p)
#define LOW_BF16(words) _mm512_castsi512_ps(_mm512_slli_epi32((words), 16))
#define HIGH_BF16(words) _mm512_castsi512_ps(_mm512_and_si512((words), _mm512_set1_epi32((int)0xffff0000u)))
#define SUM4(a, b, c, d, out) sum4((a), (b), (c), (d), (out))

static inline __attribute__((always_inline)) TARGET void sum4(__m512 a, __m512 b, __m512 c, __m512 d,
                                                              float *out) {
  /* Lane sums of a, b, c, d side by side, then the four 128-bit lanes on top of one another. */
  const __m512 ab = _mm512_add_ps(_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
  const __m512 cd = _mm512_add_ps(_mm512_unpacklo_ps(c, d), _mm512_unpackhi_ps(c, d));
  const __m512 abcd = _mm512_add_ps(_mm512_shuffle_ps(ab, cd, 0x44), _mm512_shuffle_ps(ab, cd, 0xee));
  const __m256 half = _mm256_add_ps(_mm512_castps512_ps256(abcd), _mm512_extractf32x8_ps(abcd, 1));
  _mm_storeu_ps(out, _mm_add_ps(_mm256_castps256_ps128(half), _mm256_extractf128_ps(half, 1)));
}

#include "kernel_template.h"
#else
typedef int btfi_fmf_no_avx512;
#endif
