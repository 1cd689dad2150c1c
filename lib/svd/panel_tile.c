/* SPDX-License-Identifier: MIT */
/* panel_tile.c: register tiles of the panel products. BLAS packs both operands, which costs as much as the
 * product itself when a panel is a few dozen columns wide; here the slab is broadcast from where it lies. */
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
                                 size_t b_row, float *c, size_t c_row) {                                     \
    __m512 sum[8][vectors];                                                                                  \
    UNROLL for (int row = 0; row < 8; row++) {                                                               \
      UNROLL for (int v = 0; v < (vectors); v++) sum[row][v] = _mm512_setzero_ps();                          \
    }                                                                                                        \
    const float *a_far = a + 4 * a_row;                                                                      \
    for (size_t t = 0; t < depth; t++, a += a_step, a_far += a_step, b += b_row) {                           \
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
                        const float *b, size_t b_row, float *c, size_t c_row) {
  if (vectors == 3)
    tile_avx512_48(depth, a, a_row, a_step, b, b_row, c, c_row);
  else if (vectors == 2)
    tile_avx512_32(depth, a, a_row, a_step, b, b_row, c, c_row);
  else
    tile_avx512_16(depth, a, a_row, a_step, b, b_row, c, c_row);
}

/* Four rows by 24 columns: the best of twelve accumulators in sixteen registers. */
#define DEFINE_TILE_AVX2(name, vectors)                                                                      \
  TARGET_AVX2 static void name(size_t depth, const float *a, size_t a_row, size_t a_step, const float *b,    \
                               size_t b_row, float *c, size_t c_row) {                                       \
    __m256 sum[4][vectors];                                                                                  \
    UNROLL for (int row = 0; row < 4; row++) {                                                               \
      UNROLL for (int v = 0; v < (vectors); v++) sum[row][v] = _mm256_setzero_ps();                          \
    }                                                                                                        \
    for (size_t t = 0; t < depth; t++, a += a_step, b += b_row) {                                            \
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
DEFINE_TILE_AVX2(tile_avx2_16, 2)
DEFINE_TILE_AVX2(tile_avx2_24, 3)

static void tile_avx2(uint32_t vectors, size_t depth, const float *a, size_t a_row, size_t a_step,
                      const float *b, size_t b_row, float *c, size_t c_row) {
  for (size_t row = 0; row < 8; row += 4) {
    const float *rows = a + row * a_row;
    float *sums = c + row * c_row;
    if (vectors == 3) {
      tile_avx2_24(depth, rows, a_row, a_step, b, b_row, sums, c_row);
      tile_avx2_24(depth, rows, a_row, a_step, b + 24, b_row, sums + 24, c_row);
    } else {
      for (uint32_t v = 0; v < vectors; v++)
        tile_avx2_16(depth, rows, a_row, a_step, b + 16 * v, b_row, sums + 16 * v, c_row);
    }
  }
}

btfi_tile_fn btfi_panel_tile(uint32_t isa) {
  if (isa == BTF_ISA_AVX512) return tile_avx512;
  if (isa == BTF_ISA_AVX2) return tile_avx2;
  return NULL;
}

#else

btfi_tile_fn btfi_panel_tile(uint32_t isa) {
  (void)isa;
  return NULL;
}

#endif
