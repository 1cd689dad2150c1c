/* SPDX-License-Identifier: MIT */
/* Conversion kernels for AVX2 with F16C, and for AVX-512. They finish a row with the scalar code, whose bits
 * they share: every conversion is exact or rounds once to nearest even. */
#include "dataset/convert.h"

#if defined(__x86_64__)

#include <immintrin.h>
#include <string.h>

#include <btf/btf_half.h>
#include <btf/btf_plugin.h>

#define AVX2 __attribute__((target("avx2,fma,f16c")))
#define AVX512 __attribute__((target("avx512f,avx512bw,avx512vl,avx512dq,avx2,fma,f16c")))

static bool unpack_rest(uint32_t sample_type, const unsigned char *in, float *dst, size_t n, bool finite) {
  const btfi_convert_kernels scalar = btfi_convert_select(sample_type, BTF_ISA_SCALAR);
  return n == 0 ? finite : scalar.unpack(in, dst, n) && finite;
}

/* ---- samples to floats ---- */

AVX2 static bool unpack_u8_avx2(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  const __m256 most = _mm256_set1_ps(255.0f);
  size_t i = 0;
  for (; i + 8 <= n; i += 8) {
    const __m256i wide = _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)(in + i)));
    _mm256_storeu_ps(dst + i, _mm256_div_ps(_mm256_cvtepi32_ps(wide), most));
  }
  return unpack_rest(BTF_SAMPLE_U8, in + i, dst + i, n - i, true);
}

AVX512 static bool unpack_u8_avx512(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  const __m512 most = _mm512_set1_ps(255.0f);
  size_t i = 0;
  for (; i + 16 <= n; i += 16) {
    const __m512i wide = _mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i *)(const void *)(in + i)));
    _mm512_storeu_ps(dst + i, _mm512_div_ps(_mm512_cvtepi32_ps(wide), most));
  }
  return unpack_rest(BTF_SAMPLE_U8, in + i, dst + i, n - i, true);
}

AVX2 static bool unpack_u16_avx2(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  const __m256 most = _mm256_set1_ps(65535.0f);
  size_t i = 0;
  for (; i + 8 <= n; i += 8) {
    const __m256i wide = _mm256_cvtepu16_epi32(_mm_loadu_si128((const __m128i *)(const void *)(in + 2 * i)));
    _mm256_storeu_ps(dst + i, _mm256_div_ps(_mm256_cvtepi32_ps(wide), most));
  }
  return unpack_rest(BTF_SAMPLE_U16, in + 2 * i, dst + i, n - i, true);
}

AVX512 static bool unpack_u16_avx512(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  const __m512 most = _mm512_set1_ps(65535.0f);
  size_t i = 0;
  for (; i + 16 <= n; i += 16) {
    const __m512i wide =
        _mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i *)(const void *)(in + 2 * i)));
    _mm512_storeu_ps(dst + i, _mm512_div_ps(_mm512_cvtepi32_ps(wide), most));
  }
  return unpack_rest(BTF_SAMPLE_U16, in + 2 * i, dst + i, n - i, true);
}

AVX2 static bool unpack_f16_avx2(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  const __m256i exponent = _mm256_set1_epi16(0x7c00);
  __m256i bad = _mm256_setzero_si256();
  size_t i = 0;
  for (; i + 16 <= n; i += 16) {
    const __m256i halves = _mm256_loadu_si256((const __m256i *)(const void *)(in + 2 * i));
    bad = _mm256_or_si256(bad, _mm256_cmpeq_epi16(_mm256_and_si256(halves, exponent), exponent));
    _mm256_storeu_ps(dst + i, _mm256_cvtph_ps(_mm256_castsi256_si128(halves)));
    _mm256_storeu_ps(dst + i + 8, _mm256_cvtph_ps(_mm256_extracti128_si256(halves, 1)));
  }
  return unpack_rest(BTF_SAMPLE_F16, in + 2 * i, dst + i, n - i, _mm256_testz_si256(bad, bad));
}

AVX512 static bool unpack_f16_avx512(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  const __m512i exponent = _mm512_set1_epi16(0x7c00);
  __mmask32 bad = 0;
  size_t i = 0;
  for (; i + 32 <= n; i += 32) {
    const __m512i halves = _mm512_loadu_si512(in + 2 * i);
    bad |= _mm512_cmpeq_epi16_mask(_mm512_and_si512(halves, exponent), exponent);
    _mm512_storeu_ps(dst + i, _mm512_cvtph_ps(_mm512_castsi512_si256(halves)));
    _mm512_storeu_ps(dst + i + 16, _mm512_cvtph_ps(_mm512_extracti64x4_epi64(halves, 1)));
  }
  if (i < n) {
    const uint32_t left = (uint32_t)(n - i);
    const __mmask32 lanes = (__mmask32)((1ull << left) - 1u);
    const __m512i halves = _mm512_maskz_loadu_epi16(lanes, in + 2 * i);
    bad |= _mm512_cmpeq_epi16_mask(_mm512_and_si512(halves, exponent), exponent);
    _mm512_mask_storeu_ps(dst + i, (__mmask16)lanes, _mm512_cvtph_ps(_mm512_castsi512_si256(halves)));
    if (left > 16)
      _mm512_mask_storeu_ps(dst + i + 16, (__mmask16)(lanes >> 16),
                            _mm512_cvtph_ps(_mm512_extracti64x4_epi64(halves, 1)));
  }
  return bad == 0;
}

AVX2 static bool unpack_f32_avx2(const void *src, float *dst, size_t n) {
  const unsigned char *in = src;
  const __m256i exponent = _mm256_set1_epi32(0x7f800000);
  __m256i bad = _mm256_setzero_si256();
  size_t i = 0;
  for (; i + 8 <= n; i += 8) {
    const __m256i bits = _mm256_loadu_si256((const __m256i *)(const void *)(in + 4 * i));
    bad = _mm256_or_si256(bad, _mm256_cmpeq_epi32(_mm256_and_si256(bits, exponent), exponent));
    _mm256_storeu_si256((__m256i *)(void *)(dst + i), bits);
  }
  return unpack_rest(BTF_SAMPLE_F32, in + 4 * i, dst + i, n - i, _mm256_testz_si256(bad, bad));
}

/* ---- floats to halves ---- */

AVX2 static bool pack_f16_avx2(const float *src, void *dst, size_t n) {
  const btfi_convert_kernels scalar = btfi_convert_select(BTF_SAMPLE_F16, BTF_ISA_SCALAR);
  unsigned char *out = dst;
  const __m128i exponent = _mm_set1_epi16(0x7c00);
  __m128i bad = _mm_setzero_si128();
  size_t i = 0;
  for (; i + 8 <= n; i += 8) {
    const __m128i halves = _mm256_cvtps_ph(_mm256_loadu_ps(src + i), _MM_FROUND_TO_NEAREST_INT);
    bad = _mm_or_si128(bad, _mm_cmpeq_epi16(_mm_and_si128(halves, exponent), exponent));
    _mm_storeu_si128((__m128i *)(void *)(out + 2 * i), halves);
  }
  const bool fits = _mm_testz_si128(bad, bad);
  return i == n ? fits : scalar.pack(src + i, out + 2 * i, n - i) && fits;
}

/* ---- reordering ---- */

AVX2 static void transpose_8x8(const float *in, ptrdiff_t in_stride, float *out, ptrdiff_t out_stride) {
  __m256 r[8], s[8];
  for (int k = 0; k < 8; ++k) r[k] = _mm256_loadu_ps(in + k * in_stride);
  for (int k = 0; k < 4; ++k) {
    s[2 * k] = _mm256_unpacklo_ps(r[2 * k], r[2 * k + 1]);
    s[2 * k + 1] = _mm256_unpackhi_ps(r[2 * k], r[2 * k + 1]);
  }
  for (int k = 0; k < 2; ++k) {
    r[4 * k] = _mm256_shuffle_ps(s[4 * k], s[4 * k + 2], 0x44);
    r[4 * k + 1] = _mm256_shuffle_ps(s[4 * k], s[4 * k + 2], 0xee);
    r[4 * k + 2] = _mm256_shuffle_ps(s[4 * k + 1], s[4 * k + 3], 0x44);
    r[4 * k + 3] = _mm256_shuffle_ps(s[4 * k + 1], s[4 * k + 3], 0xee);
  }
  for (int k = 0; k < 4; ++k) {
    _mm256_storeu_ps(out + k * out_stride, _mm256_permute2f128_ps(r[k], r[k + 4], 0x20));
    _mm256_storeu_ps(out + (k + 4) * out_stride, _mm256_permute2f128_ps(r[k], r[k + 4], 0x31));
  }
}

AVX2 static void transpose_avx2(const float *in, ptrdiff_t in_stride, float *out, ptrdiff_t out_stride,
                                size_t rows, size_t columns) {
  const size_t whole_rows = rows & ~(size_t)7, whole_columns = columns & ~(size_t)7;
  for (size_t i = 0; i < whole_rows; i += 8)
    for (size_t j = 0; j < whole_columns; j += 8)
      transpose_8x8(in + (ptrdiff_t)j * in_stride + i, in_stride, out + (ptrdiff_t)i * out_stride + j,
                    out_stride);
  for (size_t i = 0; i < rows; ++i)
    for (size_t j = i < whole_rows ? whole_columns : 0; j < columns; ++j)
      out[(ptrdiff_t)i * out_stride + (ptrdiff_t)j] = in[(ptrdiff_t)j * in_stride + (ptrdiff_t)i];
}

AVX2 static void split3_avx2(const float *in, float *out0, float *out1, float *out2, size_t n) {
  size_t i = 0;
  for (; i + 8 <= n; i += 8) {
    const __m256 a = _mm256_loadu_ps(in + 3 * i);      /* 0 1 2 0 1 2 0 1 */
    const __m256 b = _mm256_loadu_ps(in + 3 * i + 8);  /* 2 0 1 2 0 1 2 0 */
    const __m256 c = _mm256_loadu_ps(in + 3 * i + 16); /* 1 2 0 1 2 0 1 2 */
    /* Lane k of each blend holds the wanted channel of texel 3 k mod 8 or its like; one permutation sorts
     * them. */
    const __m256 x = _mm256_blend_ps(_mm256_blend_ps(a, b, 0x92), c, 0x24);
    const __m256 y = _mm256_blend_ps(_mm256_blend_ps(a, b, 0x24), c, 0x49);
    const __m256 z = _mm256_blend_ps(_mm256_blend_ps(a, b, 0x49), c, 0x92);
    _mm256_storeu_ps(out0 + i, _mm256_permutevar8x32_ps(x, _mm256_setr_epi32(0, 3, 6, 1, 4, 7, 2, 5)));
    _mm256_storeu_ps(out1 + i, _mm256_permutevar8x32_ps(y, _mm256_setr_epi32(1, 4, 7, 2, 5, 0, 3, 6)));
    _mm256_storeu_ps(out2 + i, _mm256_permutevar8x32_ps(z, _mm256_setr_epi32(2, 5, 0, 3, 6, 1, 4, 7)));
  }
  for (; i < n; ++i) {
    out0[i] = in[3 * i];
    out1[i] = in[3 * i + 1];
    out2[i] = in[3 * i + 2];
  }
}

void btfi_convert_select_x86(btfi_convert_kernels *kernels, uint32_t isa) {
  if (isa != BTF_ISA_AVX2 && isa != BTF_ISA_AVX512) return;
  const bool avx512 = isa == BTF_ISA_AVX512;
  switch (kernels->sample_type) {
  case BTF_SAMPLE_U8:
    kernels->unpack = avx512 ? unpack_u8_avx512 : unpack_u8_avx2;
    break;
  case BTF_SAMPLE_U16:
    kernels->unpack = avx512 ? unpack_u16_avx512 : unpack_u16_avx2;
    break;
  case BTF_SAMPLE_F16:
    kernels->unpack = avx512 ? unpack_f16_avx512 : unpack_f16_avx2;
    kernels->pack = pack_f16_avx2;
    break;
  default:
    kernels->unpack = unpack_f32_avx2;
    break;
  }
  kernels->transpose = transpose_avx2;
  kernels->split3 = split3_avx2;
}

#else
typedef int btfi_convert_x86_is_for_x86_64;
#endif
