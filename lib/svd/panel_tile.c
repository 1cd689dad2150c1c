/* SPDX-License-Identifier: MIT */
/* panel_tile.c: register tiles of the panel products. BLAS packs both operands, which costs as much as the
 * product itself when a panel is a few dozen columns wide; here the slab is broadcast from where it lies, or
 * from a copy that only changes its order. */
#include "svd/panel.h"

#include <btf/btf_plugin.h>

#if defined(__x86_64__) && defined(__GNUC__)

#include <immintrin.h>

#if defined(__clang__)
#define UNROLL _Pragma("unroll")
#else
#define UNROLL _Pragma("GCC unroll 8")
#endif

#define TARGET_AVX512 __attribute__((target("avx512f")))
#define TARGET_AVX2 __attribute__((target("avx2,fma")))

/* Eight rows by 16 * vectors columns: 24 accumulators at most, which leaves room for one row of b. */
#define DEFINE_TILE_AVX512(name, vectors)                                                                    \
  TARGET_AVX512 static void name(size_t depth, const float *a, size_t a_row, size_t a_step, const float *b,  \
                                 float *c, size_t c_row, const float *fetch, size_t fetch_step) {            \
    __m512 sum[8][vectors];                                                                                  \
    UNROLL for (int row = 0; row < 8; row++) {                                                               \
      UNROLL for (int v = 0; v < (vectors); v++) sum[row][v] = _mm512_setzero_ps();                          \
    }                                                                                                        \
    const float *a_far = a + 4 * a_row;                                                                      \
    for (size_t t = 0; t < depth; t++, a += a_step, a_far += a_step, b += 16 * (vectors)) {                  \
      if (t % 8 == 0) {                                                                                      \
        _mm_prefetch((const char *)fetch, _MM_HINT_T1);                                                      \
        fetch += fetch_step;                                                                                 \
      }                                                                                                      \
      __m512 line[vectors];                                                                                  \
      UNROLL for (int v = 0; v < (vectors); v++) line[v] = _mm512_loadu_ps(b + 16 * v);                      \
      UNROLL for (int row = 0; row < 4; row++) {                                                             \
        const __m512 near_value = _mm512_set1_ps(a[(size_t)row * a_row]);                                    \
        UNROLL for (int v = 0; v < (vectors); v++) sum[row][v] =                                             \
            _mm512_fmadd_ps(near_value, line[v], sum[row][v]);                                               \
      }                                                                                                      \
      UNROLL for (int row = 0; row < 4; row++) {                                                             \
        const __m512 far_value = _mm512_set1_ps(a_far[(size_t)row * a_row]);                                 \
        UNROLL for (int v = 0; v < (vectors); v++) sum[row + 4][v] =                                         \
            _mm512_fmadd_ps(far_value, line[v], sum[row + 4][v]);                                            \
      }                                                                                                      \
    }                                                                                                        \
    UNROLL for (int row = 0; row < 8; row++) {                                                               \
      UNROLL for (int v = 0; v < (vectors); v++)                                                             \
          _mm512_storeu_ps(c + (size_t)row * c_row + 16 * v,                                                 \
                           _mm512_add_ps(_mm512_loadu_ps(c + (size_t)row * c_row + 16 * v), sum[row][v]));   \
    }                                                                                                        \
  }
DEFINE_TILE_AVX512(tile_avx512_16, 1)
DEFINE_TILE_AVX512(tile_avx512_32, 2)
DEFINE_TILE_AVX512(tile_avx512_48, 3)

static void tile_avx512(uint32_t vectors, size_t depth, const float *a, size_t a_row, size_t a_step,
                        const float *b, float *c, size_t c_row, const float *fetch, size_t fetch_step) {
  if (vectors == 3)
    tile_avx512_48(depth, a, a_row, a_step, b, c, c_row, fetch, fetch_step);
  else if (vectors == 2)
    tile_avx512_32(depth, a, a_row, a_step, b, c, c_row, fetch, fetch_step);
  else
    tile_avx512_16(depth, a, a_row, a_step, b, c, c_row, fetch, fetch_step);
}

/* Four rows by 24 columns: the best of twelve accumulators in sixteen registers. */
#define DEFINE_TILE_AVX2(name, vectors)                                                                      \
  TARGET_AVX2 static void name(size_t depth, const float *a, size_t a_row, size_t a_step, const float *b,    \
                               float *c, size_t c_row, const float *fetch, size_t fetch_step) {              \
    __m256 sum[4][vectors];                                                                                  \
    UNROLL for (int row = 0; row < 4; row++) {                                                               \
      UNROLL for (int v = 0; v < (vectors); v++) sum[row][v] = _mm256_setzero_ps();                          \
    }                                                                                                        \
    for (size_t t = 0; t < depth; t++, a += a_step, b += 8 * (vectors)) {                                    \
      if (t % 8 == 0) {                                                                                      \
        _mm_prefetch((const char *)fetch, _MM_HINT_T1);                                                      \
        fetch += fetch_step;                                                                                 \
      }                                                                                                      \
      __m256 line[vectors];                                                                                  \
      UNROLL for (int v = 0; v < (vectors); v++) line[v] = _mm256_loadu_ps(b + 8 * v);                       \
      UNROLL for (int row = 0; row < 4; row++) {                                                             \
        const __m256 value = _mm256_broadcast_ss(a + (size_t)row * a_row);                                   \
        UNROLL for (int v = 0; v < (vectors); v++) sum[row][v] =                                             \
            _mm256_fmadd_ps(value, line[v], sum[row][v]);                                                    \
      }                                                                                                      \
    }                                                                                                        \
    UNROLL for (int row = 0; row < 4; row++) {                                                               \
      UNROLL for (int v = 0; v < (vectors); v++)                                                             \
          _mm256_storeu_ps(c + (size_t)row * c_row + 8 * v,                                                  \
                           _mm256_add_ps(_mm256_loadu_ps(c + (size_t)row * c_row + 8 * v), sum[row][v]));    \
    }                                                                                                        \
  }
DEFINE_TILE_AVX2(tile_avx2_8, 1)
DEFINE_TILE_AVX2(tile_avx2_16, 2)
DEFINE_TILE_AVX2(tile_avx2_24, 3)

static void tile_avx2(uint32_t vectors, size_t depth, const float *a, size_t a_row, size_t a_step,
                      const float *b, float *c, size_t c_row, const float *fetch, size_t fetch_step) {
  if (vectors == 3)
    tile_avx2_24(depth, a, a_row, a_step, b, c, c_row, fetch, fetch_step);
  else if (vectors == 2)
    tile_avx2_16(depth, a, a_row, a_step, b, c, c_row, fetch, fetch_step);
  else
    tile_avx2_8(depth, a, a_row, a_step, b, c, c_row, fetch, fetch_step);
}

/* ---- reordering and squares, the same for both ---- */

TARGET_AVX2 static void add_squares(const __m256 sum, double *squares) {
  for (int half = 0; half < 2; half++) {
    const __m128 part = half ? _mm256_extractf128_ps(sum, 1) : _mm256_castps256_ps128(sum);
    double *to = squares + 4 * half;
    _mm256_storeu_pd(to, _mm256_add_pd(_mm256_loadu_pd(to), _mm256_cvtps_pd(part)));
  }
}

/* Eight rows at a time; two such groups share a cache line, four are two lines, which come in together.
 * Squares are summed in short runs and these in turn, so that rounding grows by the root of a run's length
 * only. */
enum { SQUARE_RUN = 16 };
#define DEFINE_STRIPE(name, groups, store)                                                                   \
  TARGET_AVX2 static void name(size_t depth, const float *a, size_t a_step, float *stripes,                  \
                               size_t stripe_floats, double *squares) {                                      \
    __m256 sum[groups], run[groups];                                                                         \
    UNROLL for (int g = 0; g < (groups); g++) sum[g] = run[g] = _mm256_setzero_ps();                         \
    for (size_t t = 0; t < depth; t++, a += a_step) {                                                        \
      UNROLL for (int g = 0; g < (groups); g++) {                                                            \
        const __m256 value = _mm256_loadu_ps(a + 8 * g);                                                     \
        run[g] = _mm256_fmadd_ps(value, value, run[g]);                                                      \
        store(g, value)                                                                                      \
      }                                                                                                      \
      if (t % SQUARE_RUN != SQUARE_RUN - 1) continue;                                                        \
      UNROLL for (int g = 0; g < (groups); g++) {                                                            \
        sum[g] = _mm256_add_ps(sum[g], run[g]);                                                              \
        run[g] = _mm256_setzero_ps();                                                                        \
      }                                                                                                      \
    }                                                                                                        \
    if (squares == NULL) return;                                                                             \
    UNROLL for (int g = 0; g < (groups); g++) add_squares(_mm256_add_ps(sum[g], run[g]), squares + 8 * g);   \
  }
#define STORE_FOURS(g, value)                                                                                \
  float *to = stripes + (size_t)(2 * (g)) * stripe_floats + 4 * t;                                           \
  _mm_storeu_ps(to, _mm256_castps256_ps128(value));                                                          \
  _mm_storeu_ps(to + stripe_floats, _mm256_extractf128_ps(value, 1));
#define STORE_EIGHTS(g, value) _mm256_storeu_ps(stripes + (size_t)(g)*stripe_floats + 8 * t, value);
DEFINE_STRIPE(stripe_fours_32, 4, STORE_FOURS)
DEFINE_STRIPE(stripe_fours_8, 1, STORE_FOURS)
DEFINE_STRIPE(stripe_eights_32, 4, STORE_EIGHTS)
DEFINE_STRIPE(stripe_eights_8, 1, STORE_EIGHTS)

static void stripe_fours(size_t count, size_t depth, const float *a, size_t a_step, float *stripes,
                         size_t stripe_floats, double *squares) {
  for (size_t row = 0; row < count;) {
    double *to = squares == NULL ? NULL : squares + row;
    float *stripe = stripes + row / 4 * stripe_floats;
    if (row + 32 <= count) {
      stripe_fours_32(depth, a + row, a_step, stripe, stripe_floats, to);
      row += 32;
    } else {
      stripe_fours_8(depth, a + row, a_step, stripe, stripe_floats, to);
      row += 8;
    }
  }
}

static void stripe_eights(size_t count, size_t depth, const float *a, size_t a_step, float *stripes,
                          size_t stripe_floats, double *squares) {
  for (size_t row = 0; row < count;) {
    double *to = squares == NULL ? NULL : squares + row;
    float *stripe = stripes + row / 8 * stripe_floats;
    if (row + 32 <= count) {
      stripe_eights_32(depth, a + row, a_step, stripe, stripe_floats, to);
      row += 32;
    } else {
      stripe_eights_8(depth, a + row, a_step, stripe, stripe_floats, to);
      row += 8;
    }
  }
}

TARGET_AVX2 static double square(const float *a, size_t count) {
  __m256 sum[4];
  double lanes[8] = {0};
  UNROLL for (int v = 0; v < 4; v++) sum[v] = _mm256_setzero_ps();
  size_t k = 0;
  for (; k + 32 <= count; k += 32) {
    UNROLL for (int v = 0; v < 4; v++) {
      const __m256 value = _mm256_loadu_ps(a + k + 8 * v);
      sum[v] = _mm256_fmadd_ps(value, value, sum[v]);
    }
  }
  UNROLL for (int v = 0; v < 4; v++) add_squares(sum[v], lanes);
  for (; k < count; k++) lanes[k % 8] += (double)a[k] * a[k];
  return ((lanes[0] + lanes[4]) + (lanes[1] + lanes[5])) + ((lanes[2] + lanes[6]) + (lanes[3] + lanes[7]));
}

static const btfi_panel_kernels kernels_avx512 = {8, 16, tile_avx512, stripe_eights, square};
static const btfi_panel_kernels kernels_avx2 = {4, 8, tile_avx2, stripe_fours, square};

const btfi_panel_kernels *btfi_panel_kernels_for(uint32_t isa) {
  return isa == BTF_ISA_AVX512 ? &kernels_avx512 : isa == BTF_ISA_AVX2 ? &kernels_avx2 : NULL;
}

#else

const btfi_panel_kernels *btfi_panel_kernels_for(uint32_t isa) {
  (void)isa;
  return NULL;
}

#endif
