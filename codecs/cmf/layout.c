/* SPDX-License-Identifier: MIT */
/* layout.c: the header and the storage of values. */
#include <math.h>

#include <btf/btf_half.h>

#include "cmf.h"

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
