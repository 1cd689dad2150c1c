/* SPDX-License-Identifier: MIT */
#include "machine_bounds.h"

#include <time.h>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

enum { TURNS = 200000, VECTORS = 16, FETCHES = 1 << 16, AHEAD = 16 };

static volatile float sink;

double machine_now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

double machine_cpu_time(void) {
  struct timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static inline void keep_larger(double *best, double value) {
  if (value > *best) *best = value;
}

#if defined(__x86_64__)
/* Keeps the compiler from lifting the loads out of the loop. */
#define TOUCH(buffer) __asm__ volatile("" ::"r"(buffer) : "memory")

#define ACCUMULATE(vector, lanes, zero, expression, first, result)                                           \
  do {                                                                                                       \
    vector s0 = zero, s1 = zero, s2 = zero, s3 = zero, s4 = zero, s5 = zero, s6 = zero, s7 = zero;             \
    const double start = machine_cpu_time();                                                                 \
    for (int turn = 0; turn < TURNS; turn++) {                                                               \
      TOUCH(buffer);                                                                                         \
      s0 = expression(0, s0);                                                                                \
      s1 = expression(1, s1);                                                                                \
      s2 = expression(2, s2);                                                                                \
      s3 = expression(3, s3);                                                                                \
      s4 = expression(4, s4);                                                                                \
      s5 = expression(5, s5);                                                                                \
      s6 = expression(6, s6);                                                                                \
      s7 = expression(7, s7);                                                                                \
    }                                                                                                        \
    keep_larger(&(result), 8.0 * lanes * TURNS / (machine_cpu_time() - start));                              \
    sink = first(s0) + first(s1) + first(s2) + first(s3) + first(s4) + first(s5) + first(s6) + first(s7);    \
  } while (0)

#define F16_512(i, s)                                                                                        \
  _mm512_fmadd_ps(w, _mm512_cvtph_ps(_mm256_loadu_si256((const __m256i *)(const void *)(buffer + 32 * (i)))), s)
#define BF16_512(i, s)                                                                                       \
  _mm512_fmadd_ps(w,                                                                                         \
                  _mm512_castsi512_ps((i) % 2 ? _mm512_and_si512(_mm512_loadu_si512(buffer + 32 * ((i) & ~1)), high) \
                                              : _mm512_slli_epi32(_mm512_loadu_si512(buffer + 32 * (i)), 16)),       \
                  s)
#define Q8_512(i, s)                                                                                         \
  _mm512_fmadd_ps(                                                                                           \
      w,                                                                                                     \
      _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_loadu_si128((const __m128i *)(const void *)(buffer + 16 * (i))))), s)
#define FMA_512(i, s) _mm512_fmadd_ps(w, w, s)

__attribute__((target("avx512f,avx512bw,avx512vl,avx512dq"))) static void
round_avx512(const unsigned char *buffer, machine_bounds *best) {
  const __m512 w = _mm512_set1_ps(0.5f);
  const __m512i high = _mm512_set1_epi32((int)0xffff0000u);
  ACCUMULATE(__m512, 16, _mm512_setzero_ps(), F16_512, _mm512_cvtss_f32, best->convert_f16);
  ACCUMULATE(__m512, 16, _mm512_setzero_ps(), BF16_512, _mm512_cvtss_f32, best->convert_bf16);
  ACCUMULATE(__m512, 16, _mm512_setzero_ps(), Q8_512, _mm512_cvtss_f32, best->convert_q8);
  ACCUMULATE(__m512, 16, _mm512_setzero_ps(), FMA_512, _mm512_cvtss_f32, best->fma_values);
}

#define F16_256(i, s)                                                                                        \
  _mm256_fmadd_ps(w, _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(const void *)(buffer + 16 * (i)))), s)
#define LOAD_256(i) _mm256_loadu_si256((const __m256i *)(const void *)(buffer + 16 * (i)))
#define BF16_256(i, s)                                                                                       \
  _mm256_fmadd_ps(w,                                                                                         \
                  _mm256_castsi256_ps((i) % 2 ? _mm256_and_si256(LOAD_256((i) & ~1), high)                   \
                                              : _mm256_slli_epi32(LOAD_256(i), 16)),                         \
                  s)
#define Q8_256(i, s)                                                                                         \
  _mm256_fmadd_ps(                                                                                           \
      w,                                                                                                     \
      _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)(buffer + 8 * (i))))), s)
#define FMA_256(i, s) _mm256_fmadd_ps(w, w, s)

__attribute__((target("avx2,fma,f16c"))) static void round_avx2(const unsigned char *buffer, machine_bounds *best) {
  const __m256 w = _mm256_set1_ps(0.5f);
  const __m256i high = _mm256_set1_epi32((int)0xffff0000u);
  ACCUMULATE(__m256, 8, _mm256_setzero_ps(), F16_256, _mm256_cvtss_f32, best->convert_f16);
  ACCUMULATE(__m256, 8, _mm256_setzero_ps(), BF16_256, _mm256_cvtss_f32, best->convert_bf16);
  ACCUMULATE(__m256, 8, _mm256_setzero_ps(), Q8_256, _mm256_cvtss_f32, best->convert_q8);
  ACCUMULATE(__m256, 8, _mm256_setzero_ps(), FMA_256, _mm256_cvtss_f32, best->fma_values);
}
#endif

void machine_measure(const char *isa, machine_bounds *best) {
#if defined(__x86_64__)
  static _Alignas(64) unsigned char buffer[1024];
  if (isa[0] == 'a' && isa[3] == '5') round_avx512(buffer, best);
  else if (isa[0] == 'a') round_avx2(buffer, best);
#else
  (void)best;
#endif
  (void)isa;
  (void)keep_larger;
}

double machine_fetch(const unsigned char *table, uint64_t rows, size_t row_step, size_t row_bytes) {
  static uint32_t order[FETCHES + AHEAD];
  uint64_t state = 1;
  unsigned sum = 0;
  for (size_t i = 0; i < sizeof order / sizeof *order; i++) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    order[i] = (uint32_t)((state >> 32) * rows >> 32);
  }
  const double start = machine_cpu_time();
  for (size_t i = 0; i < FETCHES; i++) {
    const unsigned char *ahead = table + order[i + AHEAD] * (uint64_t)row_step;
    const unsigned char *row = table + order[i] * (uint64_t)row_step;
    for (size_t at = 0; at < row_bytes; at += 64) __builtin_prefetch(ahead + at, 0, 2);
    for (size_t at = 0; at < row_bytes; at += 64) sum += row[at];
  }
  const double seconds = (machine_cpu_time() - start) / FETCHES;
  sink = (float)sum;
  return seconds;
}
