/* SPDX-License-Identifier: MIT */
#include "bench_bounds.h"

#include <stdlib.h>
#include <string.h>

#include <btf/btf_half.h>

#include "cli.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

enum { small_size = 256 << 10, large_megabytes = 256 };

int bench_buffers_create(bench_buffers *out) {
  out->large_size = (size_t)large_megabytes << 20;
  out->large = aligned_alloc(64, out->large_size);
  out->small = aligned_alloc(64, small_size);
  if (out->large == NULL || out->small == NULL) {
    bench_buffers_free(out);
    return cli_out_of_memory();
  }
  /* Small positive halves and floats: nothing subnormal. */
  memset(out->large, 0x35, out->large_size);
  memset(out->small, 0x35, small_size);
  return EXIT_DONE;
}

void bench_buffers_free(bench_buffers *b) {
  free(b->large);
  free(b->small);
  memset(b, 0, sizeof *b);
}

/* Each kernel returns a value that depends on all it read, so that nothing is left out. */
typedef struct bound_kernels {
  const char *isa;
  float (*sum_floats)(const float *src, size_t n);
  float (*sum_halves)(const uint16_t *src, size_t n);
  float (*sum_rows)(const unsigned char *memory, size_t lines, size_t row_lines, size_t rows);
  float (*multiply_add)(size_t rounds);
  size_t operations_per_round;
} bound_kernels;

/* ---- plain C ---- */

static float plain_sum_floats(const float *src, size_t n) {
  float sum[16] = {0}, total = 0;
  for (size_t i = 0; i < n; i += 16)
    for (int k = 0; k < 16; k++) sum[k] += src[i + (size_t)k];
  for (int k = 0; k < 16; k++) total += sum[k];
  return total;
}

static float plain_sum_halves(const uint16_t *src, size_t n) {
  float sum[16] = {0}, total = 0;
  for (size_t i = 0; i < n; i += 16)
    for (int k = 0; k < 16; k++) sum[k] += btf_half_to_float(src[i + (size_t)k]);
  for (int k = 0; k < 16; k++) total += sum[k];
  return total;
}

static float plain_multiply_add(size_t rounds) {
  float value[32], total = 0;
  for (int k = 0; k < 32; k++) value[k] = (float)k;
  for (size_t i = 0; i < rounds; i++)
    for (int k = 0; k < 32; k++) value[k] = value[k] * 0.999f + 0.001f;
  for (int k = 0; k < 32; k++) total += value[k];
  return total;
}

typedef float cache_line __attribute__((vector_size(64), may_alias));
enum { line_bytes = sizeof(cache_line), rows_ahead = 8 };

static inline size_t next_row(uint64_t *state, size_t positions) {
  *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (size_t)((*state >> 32) * positions >> 32);
}

/* Rows of whole cache lines at random places among `lines`. */
static inline __attribute__((always_inline)) float sum_rows(const unsigned char *memory, size_t lines,
                                                            size_t row_lines, size_t rows) {
  const cache_line *all = (const cache_line *)(const void *)memory;
  const size_t positions = lines - row_lines + 1;
  cache_line sum = {0}, sum2 = {0};
  uint64_t now = 1, ahead = 1;
  float total = 0;
  for (int i = 0; i < rows_ahead; i++) (void)next_row(&ahead, positions);
  for (size_t r = 0; r < rows; r++) {
    const cache_line *row = all + next_row(&now, positions), *later = all + next_row(&ahead, positions);
    size_t i = 0;
    for (size_t k = 0; k < row_lines; k++) __builtin_prefetch(later + k, 0, 2);
    for (; i + 2 <= row_lines; i += 2) {
      sum += row[i];
      sum2 += row[i + 1];
    }
    if (i < row_lines) sum += row[i];
  }
  sum += sum2;
  for (size_t k = 0; k < line_bytes / sizeof(float); k++) total += sum[k];
  return total;
}

static float plain_sum_rows(const unsigned char *memory, size_t lines, size_t row_lines, size_t rows) {
  return sum_rows(memory, lines, row_lines, rows);
}

static const bound_kernels plain_kernels = {"plain",        plain_sum_floats,   plain_sum_halves,
                                            plain_sum_rows, plain_multiply_add, 64};

#if defined(__x86_64__)
#define AVX2 __attribute__((target("avx2,fma,f16c")))
#define AVX512 __attribute__((target("avx512f")))

AVX2 static float avx2_total(__m256 v) {
  float lane[8], total = 0;
  _mm256_storeu_ps(lane, v);
  for (int k = 0; k < 8; k++) total += lane[k];
  return total;
}

AVX2 static float avx2_sum_floats(const float *src, size_t n) {
  __m256 s0 = _mm256_setzero_ps(), s1 = s0, s2 = s0, s3 = s0, s4 = s0, s5 = s0, s6 = s0, s7 = s0;
  for (size_t i = 0; i < n; i += 64) {
    s0 = _mm256_add_ps(s0, _mm256_load_ps(src + i));
    s1 = _mm256_add_ps(s1, _mm256_load_ps(src + i + 8));
    s2 = _mm256_add_ps(s2, _mm256_load_ps(src + i + 16));
    s3 = _mm256_add_ps(s3, _mm256_load_ps(src + i + 24));
    s4 = _mm256_add_ps(s4, _mm256_load_ps(src + i + 32));
    s5 = _mm256_add_ps(s5, _mm256_load_ps(src + i + 40));
    s6 = _mm256_add_ps(s6, _mm256_load_ps(src + i + 48));
    s7 = _mm256_add_ps(s7, _mm256_load_ps(src + i + 56));
  }
  s0 = _mm256_add_ps(_mm256_add_ps(s0, s1), _mm256_add_ps(s2, s3));
  s4 = _mm256_add_ps(_mm256_add_ps(s4, s5), _mm256_add_ps(s6, s7));
  return avx2_total(_mm256_add_ps(s0, s4));
}

AVX2 static float avx2_sum_halves(const uint16_t *src, size_t n) {
  __m256 s0 = _mm256_setzero_ps(), s1 = s0, s2 = s0, s3 = s0, s4 = s0, s5 = s0, s6 = s0, s7 = s0;
  for (size_t i = 0; i < n; i += 64) {
    s0 = _mm256_add_ps(s0, _mm256_cvtph_ps(_mm_load_si128((const __m128i *)(src + i))));
    s1 = _mm256_add_ps(s1, _mm256_cvtph_ps(_mm_load_si128((const __m128i *)(src + i + 8))));
    s2 = _mm256_add_ps(s2, _mm256_cvtph_ps(_mm_load_si128((const __m128i *)(src + i + 16))));
    s3 = _mm256_add_ps(s3, _mm256_cvtph_ps(_mm_load_si128((const __m128i *)(src + i + 24))));
    s4 = _mm256_add_ps(s4, _mm256_cvtph_ps(_mm_load_si128((const __m128i *)(src + i + 32))));
    s5 = _mm256_add_ps(s5, _mm256_cvtph_ps(_mm_load_si128((const __m128i *)(src + i + 40))));
    s6 = _mm256_add_ps(s6, _mm256_cvtph_ps(_mm_load_si128((const __m128i *)(src + i + 48))));
    s7 = _mm256_add_ps(s7, _mm256_cvtph_ps(_mm_load_si128((const __m128i *)(src + i + 56))));
  }
  s0 = _mm256_add_ps(_mm256_add_ps(s0, s1), _mm256_add_ps(s2, s3));
  s4 = _mm256_add_ps(_mm256_add_ps(s4, s5), _mm256_add_ps(s6, s7));
  return avx2_total(_mm256_add_ps(s0, s4));
}

AVX2 static float avx2_multiply_add(size_t rounds) {
  const __m256 a = _mm256_set1_ps(0.999f), b = _mm256_set1_ps(0.001f);
  __m256 v[12];
  __m256 total = b;
  for (int k = 0; k < 12; k++) v[k] = _mm256_set1_ps((float)k);
  for (size_t i = 0; i < rounds; i++)
    for (int k = 0; k < 12; k++) v[k] = _mm256_fmadd_ps(v[k], a, b);
  for (int k = 0; k < 12; k++) total = _mm256_add_ps(total, v[k]);
  return avx2_total(total);
}

AVX512 static float avx512_sum_floats(const float *src, size_t n) {
  __m512 s0 = _mm512_setzero_ps(), s1 = s0, s2 = s0, s3 = s0, s4 = s0, s5 = s0, s6 = s0, s7 = s0;
  for (size_t i = 0; i < n; i += 128) {
    s0 = _mm512_add_ps(s0, _mm512_load_ps(src + i));
    s1 = _mm512_add_ps(s1, _mm512_load_ps(src + i + 16));
    s2 = _mm512_add_ps(s2, _mm512_load_ps(src + i + 32));
    s3 = _mm512_add_ps(s3, _mm512_load_ps(src + i + 48));
    s4 = _mm512_add_ps(s4, _mm512_load_ps(src + i + 64));
    s5 = _mm512_add_ps(s5, _mm512_load_ps(src + i + 80));
    s6 = _mm512_add_ps(s6, _mm512_load_ps(src + i + 96));
    s7 = _mm512_add_ps(s7, _mm512_load_ps(src + i + 112));
  }
  s0 = _mm512_add_ps(_mm512_add_ps(s0, s1), _mm512_add_ps(s2, s3));
  s4 = _mm512_add_ps(_mm512_add_ps(s4, s5), _mm512_add_ps(s6, s7));
  return _mm512_reduce_add_ps(_mm512_add_ps(s0, s4));
}

AVX512 static float avx512_sum_halves(const uint16_t *src, size_t n) {
  __m512 s0 = _mm512_setzero_ps(), s1 = s0, s2 = s0, s3 = s0, s4 = s0, s5 = s0, s6 = s0, s7 = s0;
  for (size_t i = 0; i < n; i += 128) {
    s0 = _mm512_add_ps(s0, _mm512_cvtph_ps(_mm256_load_si256((const __m256i *)(src + i))));
    s1 = _mm512_add_ps(s1, _mm512_cvtph_ps(_mm256_load_si256((const __m256i *)(src + i + 16))));
    s2 = _mm512_add_ps(s2, _mm512_cvtph_ps(_mm256_load_si256((const __m256i *)(src + i + 32))));
    s3 = _mm512_add_ps(s3, _mm512_cvtph_ps(_mm256_load_si256((const __m256i *)(src + i + 48))));
    s4 = _mm512_add_ps(s4, _mm512_cvtph_ps(_mm256_load_si256((const __m256i *)(src + i + 64))));
    s5 = _mm512_add_ps(s5, _mm512_cvtph_ps(_mm256_load_si256((const __m256i *)(src + i + 80))));
    s6 = _mm512_add_ps(s6, _mm512_cvtph_ps(_mm256_load_si256((const __m256i *)(src + i + 96))));
    s7 = _mm512_add_ps(s7, _mm512_cvtph_ps(_mm256_load_si256((const __m256i *)(src + i + 112))));
  }
  s0 = _mm512_add_ps(_mm512_add_ps(s0, s1), _mm512_add_ps(s2, s3));
  s4 = _mm512_add_ps(_mm512_add_ps(s4, s5), _mm512_add_ps(s6, s7));
  return _mm512_reduce_add_ps(_mm512_add_ps(s0, s4));
}

AVX512 static float avx512_multiply_add(size_t rounds) {
  const __m512 a = _mm512_set1_ps(0.999f), b = _mm512_set1_ps(0.001f);
  __m512 v[16];
  __m512 total = b;
  for (int k = 0; k < 16; k++) v[k] = _mm512_set1_ps((float)k);
  for (size_t i = 0; i < rounds; i++)
    for (int k = 0; k < 16; k++) v[k] = _mm512_fmadd_ps(v[k], a, b);
  for (int k = 0; k < 16; k++) total = _mm512_add_ps(total, v[k]);
  return _mm512_reduce_add_ps(total);
}

AVX2 static float avx2_sum_rows(const unsigned char *memory, size_t lines, size_t row_lines, size_t rows) {
  return sum_rows(memory, lines, row_lines, rows);
}
AVX512 static float avx512_sum_rows(const unsigned char *memory, size_t lines, size_t row_lines,
                                    size_t rows) {
  return sum_rows(memory, lines, row_lines, rows);
}

static const bound_kernels avx2_kernels = {"avx2",        avx2_sum_floats,   avx2_sum_halves,
                                           avx2_sum_rows, avx2_multiply_add, 2 * 8 * 12};
static const bound_kernels avx512_kernels = {"avx512",        avx512_sum_floats,   avx512_sum_halves,
                                             avx512_sum_rows, avx512_multiply_add, 2 * 16 * 16};
#endif

static const bound_kernels *kernels(void) {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx512f")) return &avx512_kernels;
  /* Every processor with AVX2 converts halves (F16C); clang 14 cannot ask for that. */
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return &avx2_kernels;
#endif
  return &plain_kernels;
}

const char *bench_bounds_isa(void) {
  return kernels()->isa;
}

static void keep_best(double *best, double amount, double started) {
  const double seconds = cli_seconds() - started;
  const double rate = seconds > 0 ? amount / seconds : 0;
  if (rate > *best) *best = rate;
}

void bench_bounds_measure(const bench_buffers *b, bench_bounds *best) {
  enum { rounds = 100000, repeats = 200 };
  const bound_kernels *k = kernels();
  const size_t halves = small_size / sizeof(uint16_t), floats = small_size / sizeof(float);
  volatile float sink = 0;
  double started = cli_seconds();
  sink += k->multiply_add(rounds);
  keep_best(&best->flops, (double)rounds * (double)k->operations_per_round, started);
  /* Halves and floats of 16 KiB stay in the first cache: conversion is measured, not reading. */
  started = cli_seconds();
  for (int i = 0; i < 16 * repeats; i++)
    sink += k->sum_halves((const uint16_t *)(const void *)b->small, halves / 16);
  keep_best(&best->half_values, (double)repeats * (double)halves, started);
  started = cli_seconds();
  for (int i = 0; i < 16 * repeats; i++)
    sink += k->sum_floats((const float *)(const void *)b->small, floats / 16);
  keep_best(&best->float_values, (double)repeats * (double)floats, started);
  started = cli_seconds();
  for (int i = 0; i < repeats; i++) sink += k->sum_floats((const float *)(const void *)b->small, floats);
  keep_best(&best->cache_bytes, (double)repeats * small_size, started);
  started = cli_seconds();
  sink += k->sum_floats((const float *)(const void *)b->large, b->large_size / sizeof(float));
  keep_best(&best->memory_bytes, (double)b->large_size, started);
  if (b->row_bytes > 0 && b->span / line_bytes >= b->row_bytes / line_bytes + 1) {
    const size_t row_lines = (b->row_bytes + line_bytes - 1) / line_bytes;
    const size_t span = b->span < b->large_size ? b->span : b->large_size;
    const size_t rows = 4000000 / row_lines + 1;
    started = cli_seconds();
    sink += k->sum_rows(b->large, span / line_bytes, row_lines, rows);
    keep_best(&best->random_rows, (double)rows, started);
  }
  (void)sink;
}
