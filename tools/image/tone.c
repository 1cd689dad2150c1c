/* SPDX-License-Identifier: MIT */
/* tone.c: sRGB coding and tone curves. */
#include <math.h>
#include <string.h>

#include "image.h"

float tone_to_srgb(float linear) {
  if (!(linear > 0)) return 0;
  if (linear >= 1) return 1;
  return linear <= 0.0031308f ? 12.92f * linear : 1.055f * powf(linear, 1 / 2.4f) - 0.055f;
}

float tone_from_srgb(float encoded) {
  if (!(encoded > 0)) return 0;
  if (encoded >= 1) return 1;
  return encoded <= 0.04045f ? encoded / 12.92f : powf((encoded + 0.055f) / 1.055f, 2.4f);
}

void tone_map(image *picture, double stops, int curve) {
  const float gain = (float)exp2(stops);
  const float white = 4;
  const size_t count = (size_t)picture->width * picture->height * 3;
  for (size_t i = 0; i < count; i++) {
    float value = picture->rgb[i] * gain;
    if (curve == TONE_FILMIC) value = value > 0 ? value * (1 + value / (white * white)) / (1 + value) : 0;
    picture->rgb[i] = value;
  }
}

/* Floats of one sign are ordered as their bits are: a histogram for each byte finds the value exactly. */
float tone_percentile(const image *picture, double fraction) {
  const size_t count = (size_t)picture->width * picture->height * 3;
  uint64_t histogram[256], below = 0;
  uint64_t rank = (uint64_t)(fraction * (double)(count > 0 ? count - 1 : 0));
  uint32_t prefix = 0;
  float value;
  for (int shift = 24; shift >= 0; shift -= 8) {
    uint32_t chosen = 255;
    memset(histogram, 0, sizeof histogram);
    for (size_t i = 0; i < count; i++) {
      uint32_t bits;
      const float clipped = picture->rgb[i] > 0 ? picture->rgb[i] : 0;
      memcpy(&bits, &clipped, sizeof bits);
      if (shift == 24 || bits >> (shift + 8) == prefix) histogram[bits >> shift & 255]++;
    }
    for (uint32_t b = 0; b < 256; b++) {
      if (below + histogram[b] > rank) {
        chosen = b;
        break;
      }
      below += histogram[b];
    }
    prefix = prefix << 8 | chosen;
  }
  memcpy(&value, &prefix, sizeof value);
  return value;
}
