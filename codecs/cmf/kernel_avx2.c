/* SPDX-License-Identifier: MIT */
/* kernel_avx2.c: AVX2 with FMA and F16C. Four channels of two neighbouring texels of a map fill a vector. */
#include "cmf.h"

#if defined(__x86_64__)
#include <immintrin.h>

#define TARGET __attribute__((target("avx2,fma,f16c")))
#define INLINE static inline __attribute__((always_inline)) TARGET

/* Moves the values of two texels of `channels` values of 1 or 2 bytes to the two halves of eight. */
INLINE __m128i spread_control(uint32_t channels, uint32_t bytes) {
  unsigned char control[16];
  memset(control, 0x80, sizeof control);
  for (uint32_t texel = 0; texel < 2; texel++)
    for (uint32_t i = 0; i < channels * bytes; i++)
      control[texel * 4 * bytes + i] = (unsigned char)(texel * channels * bytes + i);
  return _mm_loadu_si128((const __m128i *)(const void *)control);
}

/* Up to four channels: both texels with one load. */
INLINE __m256 read_packed(uint32_t storage, const unsigned char *p, uint32_t channels, __m128i control) {
  if (storage == CMF_U8) {
    const __m128i bytes = _mm_loadl_epi64((const __m128i *)(const void *)p);
    return _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_shuffle_epi8(bytes, control)));
  }
  if (storage == CMF_F16) {
    const __m128i halves = _mm_loadu_si128((const __m128i *)(const void *)p);
    return _mm256_cvtph_ps(_mm_shuffle_epi8(halves, control));
  }
  const float *values = (const float *)(const void *)p;
  return _mm256_set_m128(_mm_loadu_ps(values + channels), _mm_loadu_ps(values));
}

INLINE __m128i load_4_bytes(const unsigned char *p) {
  int32_t word;
  memcpy(&word, p, sizeof word);
  return _mm_cvtsi32_si128(word);
}

/* Four channels of more. */
INLINE __m256 read_wide(uint32_t storage, const unsigned char *p, uint32_t channels) {
  if (storage == CMF_U8)
    return _mm256_cvtepi32_ps(
        _mm256_cvtepu8_epi32(_mm_unpacklo_epi32(load_4_bytes(p), load_4_bytes(p + channels))));
  if (storage == CMF_F16) {
    const __m128i left = _mm_loadl_epi64((const __m128i *)(const void *)p);
    const __m128i right = _mm_loadl_epi64((const __m128i *)(const void *)(p + 2 * (size_t)channels));
    return _mm256_cvtph_ps(_mm_unpacklo_epi64(left, right));
  }
  return read_packed(CMF_F32, p, channels, _mm_setzero_si128());
}

INLINE __m128 look_up(const btfi_cmf_state *s, uint32_t storage, bool packed, __m128i control,
                      const unsigned char *map, const btfi_cmf_at *at, uint32_t channel) {
  const size_t bytes = storage == CMF_U8 ? 1 : storage == CMF_F16 ? 2 : 4;
  const unsigned char *top = map + bytes * ((size_t)at->offset + channel),
                      *bottom = top + bytes * s->row_values;
  const __m256 a =
      packed ? read_packed(storage, top, s->channels, control) : read_wide(storage, top, s->channels);
  const __m256 b =
      packed ? read_packed(storage, bottom, s->channels, control) : read_wide(storage, bottom, s->channels);
  const __m256 sum =
      _mm256_fmadd_ps(b, _mm256_loadu_ps(at->weight + 8), _mm256_mul_ps(a, _mm256_loadu_ps(at->weight)));
  return _mm_add_ps(_mm256_castps256_ps128(sum), _mm256_extractf128_ps(sum, 1));
}

INLINE __m128 texel_value(const btfi_cmf_state *s, uint32_t storage, bool packed, __m128i control,
                          const unsigned char *const *entry, const float *scale, __m128 weight,
                          const btfi_cmf_at *at, uint32_t channel) {
  __m128 product = _mm_mul_ps(weight, _mm_loadu_ps(scale + channel));
  __m128 stage = _mm_setzero_ps(), term = stage;
  for (uint32_t i = 0; i < s->factors; i++) {
    const btfi_cmf_state_factor *f = &s->factor[i];
    __m128 value = look_up(s, storage, packed, control, entry[i], &at[f->projection], channel);
    if (storage == CMF_U8) value = _mm_fmadd_ps(value, _mm_set1_ps(f->gain), _mm_set1_ps(f->offset));
    if (f->opens_term && f->ratio > 0)
      value = _mm_mul_ps(value, _mm_loadu_ps(scale + (size_t)f->ratio * s->channels + channel));
    term = f->opens_term ? value : _mm_mul_ps(term, value);
    if (f->ends_term) stage = f->term > 0 ? _mm_add_ps(stage, term) : term;
    if (f->ends_stage) product = _mm_mul_ps(product, stage);
  }
  return product;
}

INLINE void blend_packed(const btfi_cmf_state *s, uint32_t storage, const unsigned char *const *entry,
                         const float *scale, float weight, const btfi_cmf_at *at, float *out) {
  const __m128i control = spread_control(s->channels, storage == CMF_U8 ? 1 : 2);
  const __m128 value = texel_value(s, storage, true, control, entry, scale, _mm_set1_ps(weight), at, 0);
  _mm_storeu_ps(out, _mm_add_ps(_mm_loadu_ps(out), value));
}

INLINE void blend_wide(const btfi_cmf_state *s, uint32_t storage, const unsigned char *const *entry,
                       const float *scale, float weight, const btfi_cmf_at *at, float *out) {
  const __m128i lanes = _mm_setr_epi32(0, 1, 2, 3);
  for (uint32_t c = 0; c < s->channels; c += 4) {
    /* The last four channels may overlap the ones before, which must not be added twice. */
    const uint32_t first = c + 4 <= s->channels ? c : s->channels - 4;
    const __m128i done = _mm_cmpgt_epi32(_mm_set1_epi32((int)(c - first)), lanes);
    const __m128 of_lane = _mm_andnot_ps(_mm_castsi128_ps(done), _mm_set1_ps(weight));
    const __m128 value = texel_value(s, storage, false, lanes, entry, scale, of_lane, at, first);
    _mm_storeu_ps(out + first, _mm_add_ps(_mm_loadu_ps(out + first), value));
  }
}

#define KERNELS(name, storage)                                                                               \
  TARGET static void packed_##name(const btfi_cmf_state *s, const unsigned char *const *entry,               \
                                   const float *scale, float weight, const btfi_cmf_at *at, float *out) {    \
    blend_packed(s, storage, entry, scale, weight, at, out);                                                 \
  }                                                                                                          \
  TARGET static void wide_##name(const btfi_cmf_state *s, const unsigned char *const *entry,                 \
                                 const float *scale, float weight, const btfi_cmf_at *at, float *out) {      \
    blend_wide(s, storage, entry, scale, weight, at, out);                                                   \
  }
KERNELS(u8, CMF_U8)
KERNELS(f16, CMF_F16)
KERNELS(f32, CMF_F32)

/* Loads of packed texels reach beyond the second texel. In the last two rows of a map the unit circle is
 * narrower than 2 sqrt(6 / edge), so that behind the first texel there are at least (0.5 - sqrt(1.5 / edge))
 * * edge - 1 more: 3 for an edge of 16 and 8 for one of 32. Those rows of a cube map end at 3/4 of the edge,
 * with edge / 4 - 1/2 more behind: 4 and 8. */
btfi_cmf_blend_fn btfi_cmf_blend_avx2(uint32_t storage, uint32_t channels, uint32_t edge) {
  static const btfi_cmf_blend_fn packed[] = {packed_u8, packed_f16, packed_f32};
  static const btfi_cmf_blend_fn wide[] = {wide_u8, wide_f16, wide_f32};
  if (channels >= 4) return wide[storage];
  return edge >= (channels >= 2 ? 16u : 32u) ? packed[storage] : NULL;
}
#else
typedef int btfi_cmf_no_avx2;
#endif
