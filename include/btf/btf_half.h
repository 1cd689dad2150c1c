/* SPDX-License-Identifier: MIT */
/* btf_half.h: IEEE 754 binary16, for sources and codecs that handle half floats. Rounds to nearest even. */
#ifndef LIBBTF_BTF_HALF_H
#define LIBBTF_BTF_HALF_H

#include <stdint.h>
#include <string.h>

static inline float btf_half_to_float(uint16_t half) {
  const uint32_t sign = (uint32_t)(half & 0x8000u) << 16;
  const uint32_t magnitude = half & 0x7fffu;
  uint32_t bits;
  float value;
  if (magnitude >= 0x7c00u) {
    bits = 0x7f800000u | (magnitude & 0x3ffu) << 13;
  } else {
    /* Scaling by 2^112 moves the exponent and normalises subnormals in one step. */
    const uint32_t scale_bits = 0x77800000u;
    float scale;
    bits = magnitude << 13;
    memcpy(&value, &bits, sizeof value);
    memcpy(&scale, &scale_bits, sizeof scale);
    value *= scale;
    memcpy(&bits, &value, sizeof bits);
  }
  bits |= sign;
  memcpy(&value, &bits, sizeof value);
  return value;
}

/** Value i of halves at an address of any alignment. */
static inline float btf_half_at(const void *halves, uint64_t i) {
  uint16_t half;
  memcpy(&half, (const unsigned char *)halves + 2 * i, sizeof half);
  return btf_half_to_float(half);
}

static inline uint16_t btf_float_to_half(float value) {
  uint32_t bits, magnitude;
  uint16_t sign;
  memcpy(&bits, &value, sizeof bits);
  sign = (uint16_t)(bits >> 16 & 0x8000u);
  magnitude = bits & 0x7fffffffu;
  if (magnitude > 0x7f800000u) return (uint16_t)(sign | 0x7e00u);
  if (magnitude >= 0x477ff000u) return (uint16_t)(sign | 0x7c00u);
  if (magnitude < 0x38800000u) {
    /* Adding 0.5 lets the float adder round to the spacing of half subnormals. */
    const uint32_t half_bits = 0x3f000000u;
    float sum, half;
    memcpy(&sum, &magnitude, sizeof sum);
    memcpy(&half, &half_bits, sizeof half);
    sum += half;
    memcpy(&magnitude, &sum, sizeof magnitude);
    return (uint16_t)(sign | (magnitude - half_bits));
  }
  magnitude += 0xfffu + (magnitude >> 13 & 1u);
  return (uint16_t)(sign | (magnitude - 0x38000000u) >> 13);
}

#endif
