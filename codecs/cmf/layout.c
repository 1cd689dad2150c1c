/* SPDX-License-Identifier: MIT */
/* layout.c: the header and the storage of values. */
#include <math.h>

#include <btf/btf_half.h>

#include "cmf.h"

enum { CMF_FULL_STEPS = 40 /* of a quarter of an octave: to 1 / 1024 of the largest scale */ };

void btfi_cmf_put_head(const btfi_cmf_head *head, unsigned char bytes[CMF_HEAD_BYTES]) {
  const uint32_t words[] = {head->storage, head->edge, head->levels, head->flags, head->stages};
  for (size_t i = 0; i < 5; i++) btf_put_u32(bytes + 4 * i, words[i]);
  for (size_t s = 0; s < CMF_MAX_STAGES; s++) {
    unsigned char *stage = bytes + 20 + 12 * s;
    for (size_t k = 0; k < 2; k++) btf_put_u32(stage + 4 * k, head->stage[s].projection[k]);
    btf_put_u32(stage + 8, head->stage[s].terms);
  }
}

void btfi_cmf_get_head(const unsigned char bytes[CMF_HEAD_BYTES], btfi_cmf_head *head) {
  uint32_t *const words[] = {&head->storage, &head->edge, &head->levels, &head->flags, &head->stages};
  for (size_t i = 0; i < 5; i++) *words[i] = btf_get_u32(bytes + 4 * i);
  for (size_t s = 0; s < CMF_MAX_STAGES; s++) {
    const unsigned char *stage = bytes + 20 + 12 * s;
    for (size_t k = 0; k < 2; k++) head->stage[s].projection[k] = btf_get_u32(stage + 4 * k);
    head->stage[s].terms = btf_get_u32(stage + 8);
  }
}

uint32_t btfi_cmf_value_bytes(uint32_t storage) {
  return storage == CMF_U8 ? 1 : storage == CMF_F16 ? 2 : 4;
}

void btfi_cmf_decoding(uint32_t storage, bool has_sign, float *gain, float *offset) {
  *gain = storage != CMF_U8 ? 1.0f : has_sign ? 1.0f / 127.0f : 1.0f / 255.0f;
  *offset = storage == CMF_U8 && has_sign ? -128.0f / 127.0f : 0.0f;
}

void btfi_cmf_store(uint32_t storage, bool has_sign, const float *values, uint64_t n, unsigned char *dst) {
  const float gain = has_sign ? 127.0f : 255.0f, zero = has_sign ? 128.0f : 0.0f,
              least = has_sign ? 1.0f : 0.0f;
  for (uint64_t i = 0; i < n; i++) {
    if (storage == CMF_U8) {
      const float scaled = values[i] * gain + zero;
      dst[i] = (unsigned char)lrintf(scaled > least ? (scaled < 255.0f ? scaled : 255.0f) : least);
    } else if (storage == CMF_F16) {
      const uint16_t half = btf_float_to_half(values[i]);
      memcpy(dst + 2 * i, &half, sizeof half);
    } else {
      memcpy(dst + 4 * i, &values[i], sizeof *values);
    }
  }
}

void btfi_cmf_restore(uint32_t storage, bool has_sign, const unsigned char *src, uint64_t n, float *values) {
  float gain, offset;
  btfi_cmf_decoding(storage, has_sign, &gain, &offset);
  for (uint64_t i = 0; i < n; i++) {
    if (storage == CMF_U8) {
      values[i] = (float)src[i] * gain + offset;
    } else if (storage == CMF_F16) {
      values[i] = btf_half_at(src, i);
    } else {
      memcpy(&values[i], src + 4 * i, sizeof *values);
    }
  }
}

/* The energy that scales lose as bytes of which 255 stands for `full`. */
static double byte_loss(uint64_t texels, const float *scale, uint32_t stride, const double *energy,
                        uint32_t energy_stride, float full) {
  double loss = 0.0;
  for (uint64_t t = 0; t < texels; t++) {
    const float s = scale[t * stride];
    if (!(s > 0.0f)) continue;
    const double byte = (double)rintf(fminf(s / full, 1.0f) * 255.0f);
    const double lost = 1.0 - byte / 255.0 * (double)full / (double)s;
    loss += energy[t * energy_stride] * lost * lost;
  }
  return loss;
}

float btfi_cmf_full_byte(uint64_t texels, const float *scale, uint32_t stride, const double *energy,
                         uint32_t energy_stride) {
  float largest = 0.0f, best;
  for (uint64_t t = 0; t < texels; t++) largest = fmaxf(largest, scale[t * stride]);
  best = largest;
  if (!(largest > 0.0f)) return best;
  double least = byte_loss(texels, scale, stride, energy, energy_stride, largest);
  for (int step = 1; step <= CMF_FULL_STEPS; step++) {
    const float full = largest * exp2f(-0.25f * (float)step);
    const double loss = full > 0.0f ? byte_loss(texels, scale, stride, energy, energy_stride, full) : least;
    if (!(loss < least)) continue;
    least = loss;
    best = full;
  }
  return best;
}
