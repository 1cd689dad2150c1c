/* SPDX-License-Identifier: MIT */
/* block.h: blocks of 4 x 4 texels in 16 bytes: BC7 and BC6H (Khronos Data Format Specification 1.3, BPTC).
 * Same texels, same bytes, on any number of threads. */
#ifndef BTFI_BLOCK_H
#define BTFI_BLOCK_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

enum { BTFI_BLOCK_SIDE = 4, BTFI_BLOCK_TEXELS = 16, BTFI_BLOCK_BYTES = 16 };

/* Finite texels of four values in 0 .. 255. `counts` has a bit for each channel whose error counts; what the
 * others decode to is left open. Returns the sum of squared errors. */
float btfi_bc7_encode(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t counts,
                      unsigned char block[BTFI_BLOCK_BYTES]);
/* False for the modes that are never written: 0, 2 and 8. */
bool btfi_bc7_decode(const unsigned char block[BTFI_BLOCK_BYTES], unsigned char texels[BTFI_BLOCK_TEXELS][4]);

/* Finite halves; without a sign, what is below 0 counts as 0. */
void btfi_bc6h_encode(const uint16_t texels[BTFI_BLOCK_TEXELS][3], bool is_signed,
                      unsigned char block[BTFI_BLOCK_BYTES]);
/* False for the modes that are never written: all but 11 to 14. */
bool btfi_bc6h_decode(const unsigned char block[BTFI_BLOCK_BYTES], bool is_signed,
                      uint16_t texels[BTFI_BLOCK_TEXELS][3]);

/* ---- what both have (block.c) ---- */

/* Reads or writes a block from its lowest bit on. */
typedef struct btfi_bits {
  unsigned char *block;
  uint32_t at;
  bool is_writing;
} btfi_bits;
/* The next `count` bits of at most 16: writes and returns `value`, or returns what is there. */
uint32_t btfi_bits_next(btfi_bits *b, uint32_t count, uint32_t value);

/* Sixty-fourths of the second end for the indices of 2, 3 or 4 bits. */
const uint8_t *btfi_block_weights(uint32_t index_bits);

/* Palettes lie channel by channel. */
typedef struct btfi_palette {
  float value[4][16];
  uint32_t count; /* a multiple of 4 */
} btfi_palette;
/* The nearest entry for each of the `members`, by the channels' weights; returns the sum of squared errors.
 */
float btfi_block_nearest(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t members, const float weight[4],
                         const btfi_palette *palette, uint8_t index[BTFI_BLOCK_TEXELS]);

/* Ends of the line of the members' greatest variance, where they reach along it. */
void btfi_block_line(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t members, const float weight[4],
                     float end[2][4]);
/* The ends that suit given indices best (least squares); unchanged where all indices are the same. */
void btfi_block_refine(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t members,
                       const uint8_t index[BTFI_BLOCK_TEXELS], uint32_t index_bits, float end[2][4]);

/* Sums over texels, from which the spread around the best line follows. */
typedef struct btfi_moments {
  float count, sum[4], product[4][4];
} btfi_moments;
void btfi_moments_add(btfi_moments *m, const float texel[4], const float weight[4]);
/* Adds `times` the sums of others. */
void btfi_moments_join(btfi_moments *m, const btfi_moments *other, float times);
/* Squared distances from the line of the greatest variance; `axis` gets its direction, or is NULL where an
 * estimate will do. */
float btfi_moments_residual(const btfi_moments *m, float axis[4]);

static inline float btfi_clamp(float value, float low, float high) {
  return value > low ? (value < high ? value : high) : low;
}

#endif
