/* SPDX-License-Identifier: MIT */
/* kernel_scalar.c: the reference that the vector kernels are tested against, and the choice between them. */
#include <btf/btf_half.h>

#include "cmf.h"

static inline float read_value(uint32_t storage, const unsigned char *map, size_t i) {
  if (storage == CMF_U8) return (float)map[i];
  if (storage == CMF_F16) {
    uint16_t half;
    memcpy(&half, map + 2 * i, sizeof half);
    return btf_half_to_float(half);
  }
  float value;
  memcpy(&value, map + 4 * i, sizeof value);
  return value;
}

static inline float look_up(const btfi_cmf_state *s, uint32_t storage, const unsigned char *map,
                            const btfi_cmf_at *at, uint32_t channel) {
  const size_t first = (size_t)at->offset + channel, below = first + s->row_values;
  const float top = read_value(storage, map, first) * at->weight[0] +
                    read_value(storage, map, first + s->channels) * at->weight[4];
  const float bottom = read_value(storage, map, below) * at->weight[8] +
                       read_value(storage, map, below + s->channels) * at->weight[12];
  return top + bottom;
}

static inline void blend(const btfi_cmf_state *s, uint32_t storage, const unsigned char *const *entry,
                         const float *scale, float weight, const btfi_cmf_at *at, float *out) {
  for (uint32_t c = 0; c < s->channels; c++) {
    float product = weight * scale[c], stage = 0.0f, term = 1.0f;
    for (uint32_t i = 0; i < s->factors; i++) {
      const btfi_cmf_state_factor *f = &s->factor[i];
      const float value = look_up(s, storage, entry[i], &at[f->projection], c) * f->gain + f->offset;
      if (f->opens_term) term = f->ratio > 0 ? scale[f->ratio * s->channels + c] : 1.0f;
      term *= value;
      if (f->ends_term) stage = f->term > 0 ? stage + term : term;
      if (f->ends_stage) product *= stage;
    }
    out[c] += product;
  }
}

static void blend_u8(const btfi_cmf_state *s, const unsigned char *const *entry, const float *scale,
                     float weight, const btfi_cmf_at *at, float *out) {
  blend(s, CMF_U8, entry, scale, weight, at, out);
}

static void blend_f16(const btfi_cmf_state *s, const unsigned char *const *entry, const float *scale,
                      float weight, const btfi_cmf_at *at, float *out) {
  blend(s, CMF_F16, entry, scale, weight, at, out);
}

static void blend_f32(const btfi_cmf_state *s, const unsigned char *const *entry, const float *scale,
                      float weight, const btfi_cmf_at *at, float *out) {
  blend(s, CMF_F32, entry, scale, weight, at, out);
}

btfi_cmf_blend_fn btfi_cmf_blend_of(uint32_t isa, uint32_t storage, uint32_t channels, uint32_t edge) {
  btfi_cmf_blend_fn found = NULL;
#if defined(__x86_64__)
  if (isa == BTF_ISA_AVX2 || isa == BTF_ISA_AVX512) found = btfi_cmf_blend_avx2(storage, channels, edge);
#else
  (void)isa;
  (void)channels;
  (void)edge;
#endif
  if (found != NULL) return found;
  return storage == CMF_U8 ? blend_u8 : storage == CMF_F16 ? blend_f16 : blend_f32;
}
