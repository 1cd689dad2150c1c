/* SPDX-License-Identifier: MIT */
/* bc6h.c: BC6H in its modes of one region, 11 to 14: two ends of three halves, the second of which may be
 * stored as a difference, and indices of four bits. Interpolation is linear in the halves' bits, thus about
 * logarithmic in values: it suits values whose relative error counts. */
#include "gpu/block.h"

#include <float.h>
#include <stdlib.h>
#include <string.h>

enum { MODES = 4, INDEX_BITS = 4, REFINEMENTS = 3, MOST_HALF = 0x7bff };

/* Ends of `bits`; the second as a difference of `delta` bits, unless it is as long as the first. */
typedef struct bc6h_mode {
  uint8_t tag, bits, delta;
} bc6h_mode;
static const bc6h_mode modes[MODES] = {{0x03, 10, 10}, {0x07, 11, 9}, {0x0b, 12, 8}, {0x0f, 16, 4}};

typedef struct bc6h_block {
  uint32_t mode;
  uint32_t end[2][3]; /* as stored: `bits`, two's complement */
  uint8_t index[BTFI_BLOCK_TEXELS];
} bc6h_block;

/* ---- bits ---- */

static void walk(btfi_bits *bits, bc6h_block *b) {
  const bc6h_mode *mode = &modes[b->mode];
  for (int c = 0; c < 3; c++) {
    const uint32_t low = btfi_bits_next(bits, 10, b->end[0][c]);
    if (!bits->is_writing) b->end[0][c] = low;
  }
  for (int c = 0; c < 3; c++) {
    b->end[1][c] = btfi_bits_next(bits, mode->delta, b->end[1][c]);
    /* The first end's bits beyond ten, the highest first. */
    for (uint32_t at = mode->bits; at-- > 10;) {
      const uint32_t bit = btfi_bits_next(bits, 1, b->end[0][c] >> at);
      if (!bits->is_writing) b->end[0][c] |= bit << at;
    }
  }
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
    b->index[i] = (uint8_t)btfi_bits_next(bits, i == 0 ? INDEX_BITS - 1 : INDEX_BITS, b->index[i]);
}

static int32_t sign_extend(uint32_t value, uint32_t bits) {
  const uint32_t top = 1u << (bits - 1);
  return (int32_t)((value & ((1u << bits) - 1u)) ^ top) - (int32_t)top;
}

/* The stored second end to the whole one. */
static uint32_t whole_end(const bc6h_mode *mode, uint32_t first, uint32_t second) {
  if (mode->delta == mode->bits) return second;
  return (first + (uint32_t)sign_extend(second, mode->delta)) & ((1u << mode->bits) - 1u);
}

/* ---- the space in which ends are blended: 16 bits without sign, 15 with one ---- */

static int32_t unquantize(uint32_t stored, uint32_t bits, bool is_signed) {
  if (!is_signed) {
    const uint32_t most = (1u << bits) - 1u;
    if (bits >= 15 || stored == 0) return (int32_t)stored;
    return stored == most ? 0xffff : (int32_t)(((stored << 16) + 0x8000u) >> bits);
  }
  const int32_t value = sign_extend(stored, bits), magnitude = abs(value);
  int32_t out = magnitude;
  if (bits < 16 && magnitude != 0)
    out = magnitude >= (1 << (bits - 1)) - 1 ? 0x7fff : ((magnitude << 15) + 0x4000) >> (bits - 1);
  return value < 0 ? -out : out;
}

/* The stored end whose value is nearest. */
static uint32_t quantize(float value, uint32_t bits, bool is_signed) {
  if (!is_signed) {
    const float most = (float)((1u << bits) - 1u);
    const float scaled = bits == 16 ? value : value * (float)(1u << bits) / 65536.0f - 0.5f;
    return (uint32_t)(btfi_clamp(scaled, 0.0f, most) + 0.5f);
  }
  const float most = (float)((1u << (bits - 1)) - 1u), magnitude = fabsf(value);
  const float scaled = bits == 16 ? magnitude : magnitude * (float)(1u << (bits - 1)) / 32768.0f - 0.5f;
  const int32_t whole = (int32_t)(btfi_clamp(scaled, 0.0f, most) + 0.5f);
  return (uint32_t)(value < 0.0f ? -whole : whole) & ((1u << bits) - 1u);
}

static int32_t between(int32_t first, int32_t second, int32_t weight) {
  return (first * (64 - weight) + second * weight + 32) >> 6;
}

static uint16_t finish(int32_t value, bool is_signed) {
  if (!is_signed) return (uint16_t)((value * 31) >> 6);
  const int32_t magnitude = (abs(value) * 31) >> 5;
  return (uint16_t)(value < 0 ? 0x8000 | magnitude : magnitude);
}

/* In the middle of what `finish` makes the half of. */
static float start(uint16_t half, bool is_signed) {
  const int32_t magnitude = half & 0x7fff;
  const float bounded = (float)(magnitude < MOST_HALF ? magnitude : MOST_HALF) + 0.5f;
  if (!is_signed) return half >> 15 || magnitude == 0 ? 0.0f : bounded * (64.0f / 31.0f);
  if (magnitude == 0) return 0.0f;
  return half >> 15 ? -bounded * (32.0f / 31.0f) : bounded * (32.0f / 31.0f);
}

bool btfi_bc6h_decode(const unsigned char block[BTFI_BLOCK_BYTES], bool is_signed,
                      uint16_t texels[BTFI_BLOCK_TEXELS][3]) {
  const uint8_t *weights = btfi_block_weights(INDEX_BITS);
  unsigned char copy[BTFI_BLOCK_BYTES];
  bc6h_block b = {.mode = 0};
  btfi_bits bits = {copy, 0, false};
  memcpy(copy, block, sizeof copy);
  const uint32_t tag = btfi_bits_next(&bits, 5, 0);
  while (b.mode < MODES && modes[b.mode].tag != tag) b.mode++;
  if (b.mode == MODES) return false;
  const bc6h_mode *mode = &modes[b.mode];
  walk(&bits, &b);
  for (int c = 0; c < 3; c++) {
    const int32_t first = unquantize(b.end[0][c], mode->bits, is_signed),
                  second = unquantize(whole_end(mode, b.end[0][c], b.end[1][c]), mode->bits, is_signed);
    for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
      texels[i][c] = finish(between(first, second, weights[b.index[i]]), is_signed);
  }
  return true;
}

/* ---- encoding ---- */

static const float weight[4] = {1.0f, 1.0f, 1.0f, 0.0f};

/* False where the mode's differences are too short for these ends. */
static bool store_ends(const bc6h_mode *mode, bool is_signed, const float ends[2][4], bc6h_block *b) {
  for (int c = 0; c < 3; c++) {
    b->end[0][c] = quantize(ends[0][c], mode->bits, is_signed);
    b->end[1][c] = quantize(ends[1][c], mode->bits, is_signed);
    if (mode->delta == mode->bits) continue;
    const uint32_t second = b->end[1][c], difference = second - b->end[0][c];
    b->end[1][c] = difference & ((1u << mode->delta) - 1u);
    if (whole_end(mode, b->end[0][c], b->end[1][c]) != second) return false;
    /* Around the end of the range the difference may come out right by wrapping. */
    if (!is_signed && abs((int32_t)difference) >= 1 << mode->delta) return false;
  }
  return true;
}

static float try_block(const float texels[BTFI_BLOCK_TEXELS][4], bool is_signed, bc6h_block *b) {
  const bc6h_mode *mode = &modes[b->mode];
  const uint8_t *weights = btfi_block_weights(INDEX_BITS);
  btfi_palette palette = {.count = 1u << INDEX_BITS};
  for (int c = 0; c < 3; c++) {
    const int32_t first = unquantize(b->end[0][c], mode->bits, is_signed),
                  second = unquantize(whole_end(mode, b->end[0][c], b->end[1][c]), mode->bits, is_signed);
    for (uint32_t k = 0; k < palette.count; k++)
      palette.value[c][k] = start(finish(between(first, second, weights[k]), is_signed), is_signed);
  }
  return btfi_block_nearest(texels, 0xffffu, weight, &palette, b->index);
}

/* The first texel's index must be in the lower half: the ends change places, and what is then the difference
 * may not fit, as its range has one more below 0. */
static bool normalize(const bc6h_mode *mode, bc6h_block *b) {
  if (b->index[0] < 8) return true;
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) b->index[i] = (uint8_t)(15 - b->index[i]);
  for (int c = 0; c < 3; c++) {
    const uint32_t first = b->end[0][c], second = whole_end(mode, first, b->end[1][c]);
    b->end[0][c] = second;
    b->end[1][c] = mode->delta == mode->bits ? first : (first - second) & ((1u << mode->delta) - 1u);
    if (whole_end(mode, second, b->end[1][c]) != first) return false;
  }
  return true;
}

static float fit(const float texels[BTFI_BLOCK_TEXELS][4], bool is_signed, bc6h_block *best) {
  float ends[2][4], least = FLT_MAX;
  btfi_block_line(texels, 0xffffu, weight, ends);
  for (int round = 0; round < REFINEMENTS; round++) {
    bool is_better = false;
    for (uint32_t mode = 0; mode < MODES; mode++) {
      bc6h_block tried = {.mode = mode};
      if (!store_ends(&modes[mode], is_signed, (const float(*)[4])ends, &tried)) continue;
      const float error = try_block(texels, is_signed, &tried);
      if (!(error < least) || !normalize(&modes[mode], &tried)) continue;
      least = error;
      *best = tried;
      is_better = true;
    }
    if (!is_better || !(least > 0.0f)) break;
    btfi_block_refine(texels, 0xffffu, best->index, INDEX_BITS, ends);
  }
  return least;
}

void btfi_bc6h_encode(const uint16_t texels[BTFI_BLOCK_TEXELS][3], bool is_signed,
                      unsigned char block[BTFI_BLOCK_BYTES]) {
  bc6h_block best = {.mode = 0};
  btfi_bits bits = {block, 0, true};
  float values[BTFI_BLOCK_TEXELS][4];
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
    for (int c = 0; c < 3; c++) values[i][c] = start(texels[i][c], is_signed);
    values[i][3] = 0.0f;
  }
  fit((const float(*)[4])values, is_signed, &best);
  memset(block, 0, BTFI_BLOCK_BYTES);
  btfi_bits_next(&bits, 5, modes[best.mode].tag);
  walk(&bits, &best);
}
