/* SPDX-License-Identifier: MIT */
/* kernel_avx2.c: AVX2 with FMA and F16C. */
#include "lafortune.h"

#if defined(__x86_64__)
#include <immintrin.h>
#include <math.h>
#include <string.h>

#include "kernel.h"

#define TARGET __attribute__((target("avx2,fma,f16c")))
#define INLINE static inline __attribute__((always_inline)) TARGET

/* ---- powers ---- */

/* log2 of x > 0, normal: the exponent, and log2(1 + m) = m p(m) with 1 + m in [sqrt 1/2, sqrt 2). p is a
 * minimax polynomial of degree 8 with a relative error of 2.7e-8; evaluating it adds at most 2 rounding
 * errors of its result, as its terms fall off. So the relative error stays below 2.7e-8 + 3 * 6e-8 < 2.1e-7,
 * also near 1, where the result is small. */
INLINE __m256 log2_of(__m256 x) {
  const __m256i bits = _mm256_castps_si256(x);
  /* Bits of sqrt 1/2 as the start of an octave. */
  const __m256i octave = _mm256_srai_epi32(_mm256_sub_epi32(bits, _mm256_set1_epi32(0x3f3504f3)), 23);
  const __m256 m = _mm256_sub_ps(_mm256_castsi256_ps(_mm256_sub_epi32(bits, _mm256_slli_epi32(octave, 23))),
                                 _mm256_set1_ps(1.0f));
  /* Pairs of terms first, so that few additions wait for each other. */
  const __m256 m2 = _mm256_mul_ps(m, m), m4 = _mm256_mul_ps(m2, m2);
  const __m256 p01 = _mm256_fmadd_ps(m, _mm256_set1_ps(-7.213473468e-01f), _mm256_set1_ps(1.442695004e+00f));
  const __m256 p23 = _mm256_fmadd_ps(m, _mm256_set1_ps(-3.607036827e-01f), _mm256_set1_ps(4.809106429e-01f));
  const __m256 p45 = _mm256_fmadd_ps(m, _mm256_set1_ps(-2.389448241e-01f), _mm256_set1_ps(2.879162479e-01f));
  const __m256 p67 = _mm256_fmadd_ps(m, _mm256_set1_ps(-2.072697286e-01f), _mm256_set1_ps(2.157156111e-01f));
  const __m256 p03 = _mm256_fmadd_ps(m2, p23, p01), p47 = _mm256_fmadd_ps(m2, p67, p45);
  const __m256 p48 = _mm256_fmadd_ps(m4, _mm256_set1_ps(1.258369832e-01f), p47);
  return _mm256_fmadd_ps(m, _mm256_fmadd_ps(m4, p48, p03), _mm256_cvtepi32_ps(octave));
}

/* 2^x for -126 <= x <= 127: whole part as exponent, and a minimax polynomial of degree 6 for the rest, within
 * 1/2 of 0, of relative error 2e-9; with rounding below 2 * 6e-8. */
INLINE __m256 exp2_of(__m256 x) {
  const __m256 whole = _mm256_round_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
  const __m256 r = _mm256_sub_ps(x, whole), r2 = _mm256_mul_ps(r, r);
  const __m256 p01 = _mm256_fmadd_ps(r, _mm256_set1_ps(6.931472057e-01f), _mm256_set1_ps(1.000000001e+00f));
  const __m256 p23 = _mm256_fmadd_ps(r, _mm256_set1_ps(5.550328777e-02f), _mm256_set1_ps(2.402264689e-01f));
  const __m256 p45 = _mm256_fmadd_ps(r, _mm256_set1_ps(1.339993122e-03f), _mm256_set1_ps(9.618488958e-03f));
  const __m256 p46 = _mm256_fmadd_ps(r2, _mm256_set1_ps(1.534581183e-04f), p45);
  const __m256 p = _mm256_fmadd_ps(r2, _mm256_fmadd_ps(r2, p46, p23), p01);
  const __m256i exponent = _mm256_slli_epi32(_mm256_cvtps_epi32(whole), 23);
  return _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(p), exponent));
}

/* 2^x for any x: 0 below -126, at most 2^127. */
INLINE __m256 bounded_exp2(__m256 x) {
  const __m256 lowest = _mm256_set1_ps(-126.0f);
  const __m256 inside = _mm256_cmp_ps(x, lowest, _CMP_GE_OQ);
  const __m256 bounded = _mm256_min_ps(_mm256_max_ps(x, lowest), _mm256_set1_ps(127.0f));
  return _mm256_and_ps(exp2_of(bounded), inside);
}

/* ---- fitting ---- */

static TARGET float base_of(const btfi_lafortune_lobe *lobe, const float *const *term, uint32_t n,
                            float *base) {
  __m256 largest = _mm256_set1_ps(-INFINITY);
  float lanes[8], result;
  if (lobe->terms == 3) {
    const __m256 x = _mm256_set1_ps(lobe->coefficient[0]), y = _mm256_set1_ps(lobe->coefficient[1]),
                 z = _mm256_set1_ps(lobe->coefficient[2]);
    for (uint32_t i = 0; i < n; i += 8) {
      __m256 sum = _mm256_mul_ps(x, _mm256_loadu_ps(term[0] + i));
      sum = _mm256_fmadd_ps(y, _mm256_loadu_ps(term[1] + i), sum);
      sum = _mm256_fmadd_ps(z, _mm256_loadu_ps(term[2] + i), sum);
      _mm256_storeu_ps(base + i, sum);
      largest = _mm256_max_ps(largest, sum);
    }
  } else {
    for (uint32_t i = 0; i < n; i += 8) {
      __m256 sum = _mm256_mul_ps(_mm256_set1_ps(lobe->coefficient[0]), _mm256_loadu_ps(term[0] + i));
      for (uint32_t k = 1; k < lobe->terms; k++)
        sum = _mm256_fmadd_ps(_mm256_set1_ps(lobe->coefficient[k]), _mm256_loadu_ps(term[k] + i), sum);
      _mm256_storeu_ps(base + i, sum);
      largest = _mm256_max_ps(largest, sum);
    }
  }
  _mm256_storeu_ps(lanes, largest);
  result = lanes[0];
  for (int k = 1; k < 8; k++) result = lanes[k] > result ? lanes[k] : result;
  return result;
}

INLINE void power_columns(const btfi_lafortune_lobe *lobe, const float *const *term, const float *factor,
                          const float *base, uint32_t first, uint32_t n, const uint32_t coefficients,
                          float *columns) {
  const __m256 exponent = _mm256_set1_ps(lobe->exponent), over_peak = _mm256_set1_ps(1.0f / lobe->peak);
  const __m256 least = _mm256_set1_ps(lobe->peak * LAF_SMALLEST_BASE), ln2 = _mm256_set1_ps(LAF_LN2);
  const __m256 smallest = _mm256_set1_ps(LAF_SMALLEST_LOG), tiny = _mm256_set1_ps(1e-30f);
  for (uint32_t i = 0; i < n; i += 8) {
    const __m256 a = _mm256_loadu_ps(base + first + i);
    const __m256 share = _mm256_max_ps(_mm256_mul_ps(a, over_peak), tiny);
    const __m256 log_value = _mm256_mul_ps(exponent, log2_of(share));
    const __m256 alive = _mm256_and_ps(_mm256_cmp_ps(log_value, smallest, _CMP_GT_OQ),
                                       _mm256_cmp_ps(a, _mm256_setzero_ps(), _CMP_GT_OQ));
    const __m256 bounded = _mm256_max_ps(log_value, smallest);
    const __m256 value =
        _mm256_and_ps(_mm256_mul_ps(_mm256_loadu_ps(factor + first + i), exp2_of(bounded)), alive);
    _mm256_storeu_ps(columns + i, value);
    if (coefficients > 0) {
      const __m256 by_base = _mm256_div_ps(_mm256_mul_ps(value, exponent), _mm256_max_ps(a, least));
      for (uint32_t k = 0; k < coefficients; k++)
        _mm256_storeu_ps(columns + (k + 1) * LAF_LD + i,
                         _mm256_mul_ps(by_base, _mm256_loadu_ps(term[k] + first + i)));
    }
    _mm256_storeu_ps(columns + (coefficients + 1) * LAF_LD + i,
                     _mm256_mul_ps(_mm256_mul_ps(value, bounded), ln2));
  }
}

INLINE void ward_columns(const btfi_lafortune_lobe *lobe, const float *const *term, const float *factor,
                         const float *base, uint32_t first, uint32_t n, float *columns) {
  const __m256 peak = _mm256_set1_ps(lobe->peak), smallest = _mm256_set1_ps(LAF_SMALLEST_LOG);
  for (uint32_t i = 0; i < n; i += 8) {
    const __m256 log_value =
        _mm256_mul_ps(_mm256_sub_ps(_mm256_loadu_ps(base + first + i), peak), _mm256_set1_ps(LAF_LOG2_E));
    const __m256 alive = _mm256_cmp_ps(log_value, smallest, _CMP_GT_OQ);
    const __m256 power = exp2_of(_mm256_max_ps(log_value, smallest));
    const __m256 value = _mm256_and_ps(_mm256_mul_ps(_mm256_loadu_ps(factor + first + i), power), alive);
    _mm256_storeu_ps(columns + i, value);
    for (uint32_t k = 0; k < 2; k++) {
      const __m256 part =
          _mm256_mul_ps(_mm256_set1_ps(lobe->coefficient[k]), _mm256_loadu_ps(term[k] + first + i));
      _mm256_storeu_ps(columns + (k + 1) * LAF_LD + i, _mm256_mul_ps(value, part));
    }
  }
}

static TARGET void columns_of(const btfi_lafortune_lobe *lobe, const float *const *term, const float *factor,
                              const float *base, uint32_t first, uint32_t n, float *columns) {
  switch (lobe->kind) {
  case LAF_DIAGONAL:
    power_columns(lobe, term, factor, base, first, n, 3, columns);
    break;
  case LAF_FULL:
    power_columns(lobe, term, factor, base, first, n, 9, columns);
    break;
  case LAF_WARD:
    ward_columns(lobe, term, factor, base, first, n, columns);
    break;
  default:
    power_columns(lobe, term, factor, base, first, n, 0, columns);
    break;
  }
}

/* Sums over the lanes of four vectors. */
INLINE __m128 sum4(__m256 a, __m256 b, __m256 c, __m256 d) {
  const __m256 ab = _mm256_add_ps(_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
  const __m256 cd = _mm256_add_ps(_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
  const __m256 all = _mm256_add_ps(_mm256_shuffle_ps(ab, cd, 0x44), _mm256_shuffle_ps(ab, cd, 0xee));
  return _mm_add_ps(_mm256_castps256_ps128(all), _mm256_extractf128_ps(all, 1));
}

/* Three columns with four: twelve sums in registers. Columns that are not there repeat the last one. */
INLINE void block_of_dots(const float *const a[3], const float *const b[4], uint32_t n,
                          const uint32_t a_count, const uint32_t b_count, double *sums, size_t ld) {
  __m256 s[3][4];
  for (uint32_t i = 0; i < 3; i++)
    for (uint32_t j = 0; j < 4; j++) s[i][j] = _mm256_setzero_ps();
  for (uint32_t k = 0; k < n; k += 8) {
    const __m256 b0 = _mm256_loadu_ps(b[0] + k), b1 = _mm256_loadu_ps(b[1] + k),
                 b2 = _mm256_loadu_ps(b[2] + k), b3 = _mm256_loadu_ps(b[3] + k);
    for (uint32_t i = 0; i < a_count; i++) {
      const __m256 x = _mm256_loadu_ps(a[i] + k);
      s[i][0] = _mm256_fmadd_ps(x, b0, s[i][0]);
      if (b_count > 1) s[i][1] = _mm256_fmadd_ps(x, b1, s[i][1]);
      if (b_count > 2) s[i][2] = _mm256_fmadd_ps(x, b2, s[i][2]);
      if (b_count > 3) s[i][3] = _mm256_fmadd_ps(x, b3, s[i][3]);
    }
  }
  for (uint32_t i = 0; i < a_count; i++) {
    float lanes[4];
    _mm_storeu_ps(lanes, sum4(s[i][0], s[i][1], s[i][2], s[i][3]));
    for (uint32_t j = 0; j < b_count; j++) sums[i * ld + j] += (double)lanes[j];
  }
}

#define DOTS_OF(rows)                                                                                        \
  switch (columns) {                                                                                         \
  case 1:                                                                                                    \
    block_of_dots(pa, pb, n, rows, 1, to, sums_ld);                                                          \
    break;                                                                                                   \
  case 2:                                                                                                    \
    block_of_dots(pa, pb, n, rows, 2, to, sums_ld);                                                          \
    break;                                                                                                   \
  case 3:                                                                                                    \
    block_of_dots(pa, pb, n, rows, 3, to, sums_ld);                                                          \
    break;                                                                                                   \
  default:                                                                                                   \
    block_of_dots(pa, pb, n, rows, 4, to, sums_ld);                                                          \
    break;                                                                                                   \
  }

static TARGET void dots(const float *a, size_t a_ld, uint32_t a_count, const float *b, size_t b_ld,
                        uint32_t b_count, uint32_t n, bool upper, double *sums, size_t sums_ld) {
  for (uint32_t i = 0; i < a_count; i += 3) {
    const uint32_t rows = a_count - i < 3 ? a_count - i : 3;
    const float *const pa[3] = {a + i * a_ld, a + (i + (rows > 1 ? 1 : 0)) * a_ld, a + (i + rows - 1) * a_ld};
    for (uint32_t j = upper ? i : 0; j < b_count; j += 4) {
      const uint32_t columns = b_count - j < 4 ? b_count - j : 4;
      const float *const pb[4] = {b + j * b_ld, b + (j + (columns > 1 ? 1 : 0)) * b_ld,
                                  b + (j + (columns > 2 ? 2 : columns - 1)) * b_ld,
                                  b + (j + columns - 1) * b_ld};
      double *to = sums + i * sums_ld + j;
      if (rows == 3) {
        DOTS_OF(3)
      } else if (rows == 2) {
        DOTS_OF(2)
      } else {
        DOTS_OF(1)
      }
    }
  }
}

/* ---- evaluation ---- */

enum { MAX_GROUP_VALUES = LAF_MAX_VARIABLES + LAF_MAX_ALBEDOS * LAF_MAX_CHANNELS };

INLINE __m256 load8(const uint32_t storage, const unsigned char *record, size_t i) {
  if (storage == LAF_F16)
    return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(const void *)(record + 2 * i)));
  return _mm256_loadu_ps((const float *)(const void *)(record + 4 * i));
}

static inline int half_at(const unsigned char *record, size_t i) {
  uint16_t half;
  memcpy(&half, record + 2 * i, sizeof half);
  return half;
}

static inline float float_at(const unsigned char *record, size_t i) {
  float value;
  memcpy(&value, record + 4 * i, sizeof value);
  return value;
}

/* Value i of four texels, and value k of the same: two lobes. */
INLINE __m256 gather8(const uint32_t storage, const unsigned char *const *r, size_t i, size_t k) {
  if (storage == LAF_F16)
    return _mm256_cvtph_ps(_mm_setr_epi16(
        (short)half_at(r[0], i), (short)half_at(r[1], i), (short)half_at(r[2], i), (short)half_at(r[3], i),
        (short)half_at(r[0], k), (short)half_at(r[1], k), (short)half_at(r[2], k), (short)half_at(r[3], k)));
  return _mm256_setr_ps(float_at(r[0], i), float_at(r[1], i), float_at(r[2], i), float_at(r[3], i),
                        float_at(r[0], k), float_at(r[1], k), float_at(r[2], k), float_at(r[3], k));
}

INLINE __m256 power_of(__m256 base, __m256 exponent) {
  const __m256 alive = _mm256_cmp_ps(base, _mm256_setzero_ps(), _CMP_GT_OQ);
  const __m256 log_base = log2_of(_mm256_max_ps(base, _mm256_set1_ps(1.17549435e-38f)));
  return _mm256_and_ps(bounded_exp2(_mm256_mul_ps(exponent, log_base)), alive);
}

/* Lobes `first` and the one after it of four texels: lane t + 4 (lobe - first). Without a second one, its
 * lanes hold what nobody looks at. */
INLINE __m256 lobe_pair(const btfi_lafortune_layout *layout, const uint32_t kind, const uint32_t storage,
                        const btfi_lafortune_terms *terms, const unsigned char *const *r,
                        const uint32_t first) {
  if (kind == LAF_DIAGONAL) {
    /* A texel's two lobes are 8 values in a row. */
    const __m256 v0 = load8(storage, r[0], 4 * first), v1 = load8(storage, r[1], 4 * first),
                 v2 = load8(storage, r[2], 4 * first), v3 = load8(storage, r[3], 4 * first);
    const __m256 low01 = _mm256_unpacklo_ps(v0, v1), high01 = _mm256_unpackhi_ps(v0, v1),
                 low23 = _mm256_unpacklo_ps(v2, v3), high23 = _mm256_unpackhi_ps(v2, v3);
    const __m256 x = _mm256_shuffle_ps(low01, low23, 0x44), y = _mm256_shuffle_ps(low01, low23, 0xee),
                 z = _mm256_shuffle_ps(high01, high23, 0x44), n = _mm256_shuffle_ps(high01, high23, 0xee);
    __m256 base = _mm256_mul_ps(x, _mm256_set1_ps(terms->term[0]));
    base = _mm256_fmadd_ps(y, _mm256_set1_ps(terms->term[1]), base);
    base = _mm256_fmadd_ps(z, _mm256_set1_ps(terms->term[2]), base);
    return power_of(base, n);
  }
  const size_t shape = layout->shape, i = first * shape, k = first + 1 < layout->lobes ? i + shape : i;
  if (kind == LAF_WARD) {
    const __m256 x = gather8(storage, r, i, k), y = gather8(storage, r, i + 1, k + 1);
    const __m256 along_x = _mm256_div_ps(_mm256_set1_ps(terms->term[0]), _mm256_mul_ps(x, x));
    const __m256 along_y = _mm256_div_ps(_mm256_set1_ps(terms->term[1]), _mm256_mul_ps(y, y));
    const __m256 power =
        bounded_exp2(_mm256_mul_ps(_mm256_add_ps(along_x, along_y), _mm256_set1_ps(-LAF_LOG2_E)));
    return _mm256_mul_ps(power, _mm256_div_ps(_mm256_set1_ps(LAF_WARD_NORM), _mm256_mul_ps(x, y)));
  }
  const uint32_t coefficients = btfi_lafortune_free_terms(kind);
  const __m256 n = gather8(storage, r, i + coefficients, k + coefficients);
  __m256 base = _mm256_set1_ps(terms->term[0]);
  if (coefficients > 0) {
    base = _mm256_mul_ps(gather8(storage, r, i, k), base);
    for (uint32_t c = 1; c < coefficients; c++)
      base = _mm256_fmadd_ps(gather8(storage, r, i + c, k + c), _mm256_set1_ps(terms->term[c]), base);
  }
  const __m256 power = power_of(base, n);
  if (kind != LAF_LEWIS) return power;
  return _mm256_mul_ps(power,
                       _mm256_mul_ps(_mm256_add_ps(n, _mm256_set1_ps(2.0f)), _mm256_set1_ps(LAF_LEWIS_NORM)));
}

INLINE void eval_group(const btfi_lafortune_state *state, const uint32_t kind, const uint32_t storage,
                       const bool many, const btfi_lafortune_taps *taps, const unsigned char *const *r,
                       bool add, float *out) {
  const btfi_lafortune_layout *layout = &state->layout;
  const btfi_lafortune_terms *terms = &taps->terms;
  const uint32_t channels = layout->group_channels, albedos = (1 + layout->lobes) * channels;
  const __m128 weights = _mm_loadu_ps(taps->weight);
  const __m256 lobe_weights = _mm256_mul_ps(_mm256_set_m128(weights, weights), _mm256_set1_ps(terms->lobe));
  const __m256 first = _mm256_mul_ps(lobe_pair(layout, kind, storage, terms, r, 0), lobe_weights);
  const __m256 second =
      many ? _mm256_mul_ps(lobe_pair(layout, kind, storage, terms, r, 2), lobe_weights) : first;
  _Alignas(32) float sums[LAF_MAX_ALBEDOS * LAF_MAX_CHANNELS + 8];
  const size_t start = (size_t)layout->lobes * layout->shape;
  for (uint32_t i = 0; i < albedos; i += 8) {
    const __m256i lobe = _mm256_loadu_si256((const __m256i *)(const void *)(state->lobe_of + i));
    const __m256i lane = _mm256_slli_epi32(_mm256_and_si256(lobe, _mm256_set1_epi32(1)), 2);
    const __m256 diffuse = _mm256_castsi256_ps(lobe); /* by its sign */
    const __m256 upper = _mm256_castsi256_ps(_mm256_slli_epi32(lobe, 30));
    __m256 sum = _mm256_setzero_ps();
    for (int t = 0; t < 4; t++) {
      const __m256i from = _mm256_add_epi32(lane, _mm256_set1_epi32(t));
      __m256 factor = _mm256_permutevar8x32_ps(first, from);
      if (many) factor = _mm256_blendv_ps(factor, _mm256_permutevar8x32_ps(second, from), upper);
      factor = _mm256_blendv_ps(factor, _mm256_set1_ps(taps->weight[t] * terms->diffuse), diffuse);
      sum = _mm256_fmadd_ps(load8(storage, r[t], start + i), factor, sum);
    }
    _mm256_store_ps(sums + i, sum);
  }
  for (uint32_t c = 0; c < channels; c++) {
    float sum = sums[c];
    for (uint32_t j = 1; j <= layout->lobes; j++) sum += sums[j * channels + c];
    out[c] = add ? out[c] + sum : sum;
  }
}

/* Copies of the records of a group at the end of the table, with room behind them. */
typedef struct roomy_records {
  _Alignas(32) unsigned char bytes[4][4 * MAX_GROUP_VALUES + 32];
} roomy_records;

static void copy_records(size_t bytes, roomy_records *room, const unsigned char **r) {
  for (int t = 0; t < 4; t++) {
    memcpy(room->bytes[t], r[t], bytes);
    memset(room->bytes[t] + bytes, 0, 32);
    r[t] = room->bytes[t];
  }
}

INLINE void eval_groups(const btfi_lafortune_state *state, const uint32_t kind, const uint32_t storage,
                        const bool many, const btfi_lafortune_taps *taps, uint32_t count, bool add,
                        float *out) {
  const btfi_lafortune_layout *layout = &state->layout;
  const size_t bytes = (size_t)layout->group_values * layout->value_bytes;
  roomy_records room;
  for (uint32_t i = 0; i < count; i++)
    for (uint32_t g = 0; g < layout->groups; g++, out += layout->group_channels) {
      const unsigned char *r[4];
      for (int t = 0; t < 4; t++) r[t] = taps[i].texel[t] + g * bytes;
      if (taps[i].near_end) copy_records(bytes, &room, r);
      eval_group(state, kind, storage, many, &taps[i], r, add, out);
    }
}

enum { USUAL_BLOCK = 16 };

/* Where the records of a query are, copied if need be. */
static inline void usual_records(const btfi_lafortune_taps *taps, size_t bytes, roomy_records *room,
                                 const unsigned char **r) {
  for (int t = 0; t < 4; t++) r[t] = taps->texel[t];
  if (__builtin_expect(taps->near_end, false)) copy_records(bytes, room, r);
}

/* Two diagonal lobes of halves shared by three channels: the usual case. A record is 8 values of shape, then
 * the albedos as 8 and 1: diffuse R G B, first lobe R G B, second lobe R G, B. The lobes of all queries come
 * first, then their colours: a power is a long chain of operations, and those of one query leave room for the
 * next. */
static TARGET void eval_usual(const btfi_lafortune_state *state, const btfi_lafortune_taps *taps,
                              uint32_t count, bool add, float *out) {
  const size_t bytes = (size_t)state->layout.group_values * 2;
  const __m256i of_texel[4] = {
      _mm256_setr_epi32(0, 0, 0, 0, 0, 0, 4, 4), _mm256_setr_epi32(1, 1, 1, 1, 1, 1, 5, 5),
      _mm256_setr_epi32(2, 2, 2, 2, 2, 2, 6, 6), _mm256_setr_epi32(3, 3, 3, 3, 3, 3, 7, 7)};
  const __m256i second_third = _mm256_setr_epi32(3, 4, 5, 5, 6, 7, 7, 7);
  __m256 lobes[USUAL_BLOCK];
  roomy_records room;
  const unsigned char *r[4];
  for (uint32_t i = 0; i < count; i++) {
    const btfi_lafortune_terms *terms = &taps[i].terms;
    usual_records(&taps[i], bytes, &room, r);
    const __m128 weights = _mm_mul_ps(_mm_loadu_ps(taps[i].weight), _mm_set1_ps(terms->lobe));
    lobes[i] = _mm256_mul_ps(lobe_pair(&state->layout, LAF_DIAGONAL, LAF_F16, terms, r, 0),
                             _mm256_set_m128(weights, weights));
  }
  for (uint32_t i = 0; i < count; i++, out += 3) {
    usual_records(&taps[i], bytes, &room, r);
    const __m128 diffuse = _mm_mul_ps(_mm_loadu_ps(taps[i].weight), _mm_set1_ps(taps[i].terms.diffuse));
    const __m256 both = _mm256_set_m128(diffuse, diffuse);
#define FACTOR(t, spread)                                                                                    \
  _mm256_blend_ps(_mm256_permutevar8x32_ps(lobes[i], of_texel[t]), _mm256_permute_ps(both, spread), 0x07)
    const __m256 sum0 = _mm256_mul_ps(load8(LAF_F16, r[0], 8), FACTOR(0, 0x00)),
                 sum1 = _mm256_mul_ps(load8(LAF_F16, r[1], 8), FACTOR(1, 0x55)),
                 sum2 = _mm256_fmadd_ps(load8(LAF_F16, r[2], 8), FACTOR(2, 0xaa), sum0),
                 sum3 = _mm256_fmadd_ps(load8(LAF_F16, r[3], 8), FACTOR(3, 0xff), sum1);
#undef FACTOR
    const __m256 sum = _mm256_add_ps(sum2, sum3);
    const __m128i last = _mm_setr_epi16((short)half_at(r[0], 16), (short)half_at(r[1], 16),
                                        (short)half_at(r[2], 16), (short)half_at(r[3], 16), 0, 0, 0, 0);
    const __m128 blue = _mm_mul_ps(_mm_cvtph_ps(last), _mm256_extractf128_ps(lobes[i], 1));
    const __m128 blue2 = _mm_add_ps(blue, _mm_movehl_ps(blue, blue));
    const __m128 blue1 = _mm_add_ss(blue2, _mm_movehdup_ps(blue2));
    const __m256 shifted = _mm256_permutevar8x32_ps(sum, second_third); /* 3 4 5 - 6 7 - - */
    const __m128 third = _mm_insert_ps(_mm256_extractf128_ps(shifted, 1), blue1, 0x20);
    const __m128 rgb =
        _mm_add_ps(_mm_add_ps(_mm256_castps256_ps128(sum), _mm256_castps256_ps128(shifted)), third);
    float channel[4];
    _mm_storeu_ps(channel, rgb);
    for (int c = 0; c < 3; c++) out[c] = add ? out[c] + channel[c] : channel[c];
  }
}

#define EVAL_KIND(kind)                                                                                      \
  case kind:                                                                                                 \
    if (layout->storage == LAF_F16) {                                                                        \
      if (layout->lobes > 2)                                                                                 \
        eval_groups(state, kind, LAF_F16, true, taps, count, add, out);                                      \
      else                                                                                                   \
        eval_groups(state, kind, LAF_F16, false, taps, count, add, out);                                     \
    } else {                                                                                                 \
      if (layout->lobes > 2)                                                                                 \
        eval_groups(state, kind, LAF_F32, true, taps, count, add, out);                                      \
      else                                                                                                   \
        eval_groups(state, kind, LAF_F32, false, taps, count, add, out);                                     \
    }                                                                                                        \
    break;

static TARGET void eval(const btfi_lafortune_state *state, const btfi_lafortune_taps *taps, uint32_t count,
                        bool add, float *out) {
  const btfi_lafortune_layout *layout = &state->layout;
  if (layout->kind == LAF_DIAGONAL && layout->storage == LAF_F16 && layout->lobes == 2 &&
      layout->group_channels == 3 && layout->groups == 1) {
    for (uint32_t i = 0; i < count; i += USUAL_BLOCK)
      eval_usual(state, taps + i, count - i < USUAL_BLOCK ? count - i : USUAL_BLOCK, add, out + 3 * i);
    return;
  }
  switch (layout->kind) {
    EVAL_KIND(LAF_DIAGONAL)
    EVAL_KIND(LAF_FULL)
    EVAL_KIND(LAF_WARD)
    EVAL_KIND(LAF_LEWIS)
  default:
    EVAL_KIND(LAF_PHONG) /* and LAF_BLINN_PHONG: their terms differ alone */
  }
}

const btfi_lafortune_kernels btfi_lafortune_avx2 = {base_of, columns_of, dots, eval};
#else
typedef int btfi_lafortune_no_avx2;
#endif
