/* SPDX-License-Identifier: MIT */
/* bc7.c: BC7 in its modes for colours (1, 3), for four channels (6, 7) and for three and one (4, 5). The
 * modes left out, of three subsets, give little on textures that are not pictures. */
#include "gpu/block.h"

#include <float.h>
#include <string.h>

enum { RGB = 7, ALPHA = 8, MODES = 8, PARTITIONS = 64, REFINEMENTS = 3 };
typedef enum bc7_low_bits { LOW_NONE, LOW_SHARED, LOW_EACH } bc7_low_bits; /* of the ends: p-bits */

typedef struct bc7_mode {
  uint8_t subsets, partition_bits, rotation_bits, selection_bits;
  uint8_t color_bits, alpha_bits, index_bits, second_bits;
  bc7_low_bits low;
} bc7_mode;
static const bc7_mode modes[MODES] = {
    [1] = {2, 6, 0, 0, 6, 0, 3, 0, LOW_SHARED}, [3] = {2, 6, 0, 0, 7, 0, 2, 0, LOW_EACH},
    [4] = {1, 0, 2, 1, 5, 6, 2, 3, LOW_NONE},   [5] = {1, 0, 2, 0, 7, 8, 2, 2, LOW_NONE},
    [6] = {1, 0, 0, 0, 7, 7, 4, 0, LOW_EACH},   [7] = {2, 6, 0, 0, 5, 5, 2, 0, LOW_EACH},
};

/* Texels of the second subset, and the one of them whose index has a bit less. */
static const uint16_t partitions[PARTITIONS] = {
    0xcccc, 0x8888, 0xeeee, 0xecc8, 0xc880, 0xfeec, 0xfec8, 0xec80, 0xc800, 0xffec, 0xfe80, 0xe800, 0xffe8,
    0xff00, 0xfff0, 0xf000, 0xf710, 0x008e, 0x7100, 0x08ce, 0x008c, 0x7310, 0x3100, 0x8cce, 0x088c, 0x3110,
    0x6666, 0x366c, 0x17e8, 0x0ff0, 0x718e, 0x399c, 0xaaaa, 0xf0f0, 0x5a5a, 0x33cc, 0x3c3c, 0x55aa, 0x9696,
    0xa55a, 0x73ce, 0x13c8, 0x324c, 0x3bdc, 0x6996, 0xc33c, 0x9966, 0x0660, 0x0272, 0x04e4, 0x4e40, 0x2720,
    0xc936, 0x936c, 0x39c6, 0x639c, 0x9336, 0x9cc6, 0x817e, 0xe718, 0xccf0, 0x0fcc, 0x7744, 0xee22};
static const uint8_t anchors[PARTITIONS] = {15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15,
                                            15, 2,  8,  2,  2,  8,  8,  15, 2,  8,  2,  2,  8,  8,  2,  2,
                                            15, 15, 6,  8,  2,  8,  15, 15, 2,  8,  2,  2,  2,  15, 15, 6,
                                            6,  2,  6,  8,  15, 15, 2,  2,  15, 15, 15, 15, 15, 2,  2,  15};

typedef struct bc7_block {
  uint32_t mode, partition, rotation, selection;
  uint8_t end[2][2][4]; /* of a subset; without their low bits */
  uint8_t low[2][2];
  uint8_t index[2][BTFI_BLOCK_TEXELS]; /* of the first set and, in modes of two, the second */
} bc7_block;

static uint32_t members_of(const bc7_mode *mode, uint32_t partition, uint32_t subset) {
  if (mode->subsets == 1) return 0xffffu;
  return subset == 1 ? partitions[partition] : 0xffffu & ~(uint32_t)partitions[partition];
}

static bool is_anchor(const bc7_block *b, uint32_t texel) {
  return texel == 0 || (modes[b->mode].subsets == 2 && texel == anchors[b->partition]);
}

static uint32_t end_bits(const bc7_mode *mode, int channel) {
  return channel < 3 ? mode->color_bits : mode->alpha_bits;
}

/* ---- bits ---- */

static void walk_indices(btfi_bits *bits, bc7_block *b, int set, uint32_t index_bits) {
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
    const uint32_t count = index_bits - (set == 0 ? is_anchor(b, i) : i == 0);
    b->index[set][i] = (uint8_t)btfi_bits_next(bits, count, b->index[set][i]);
  }
}

/* All after the mode's own bits; writes or reads. */
static void walk(btfi_bits *bits, bc7_block *b) {
  const bc7_mode *mode = &modes[b->mode];
  b->partition = btfi_bits_next(bits, mode->partition_bits, b->partition);
  b->rotation = btfi_bits_next(bits, mode->rotation_bits, b->rotation);
  b->selection = btfi_bits_next(bits, mode->selection_bits, b->selection);
  for (int c = 0; c < 4; c++)
    for (uint32_t e = 0; e < 2u * mode->subsets; e++) {
      uint8_t *end = &b->end[e / 2][e % 2][c];
      *end = (uint8_t)btfi_bits_next(bits, end_bits(mode, c), *end);
    }
  for (uint32_t e = 0; mode->low != LOW_NONE && e < 2u * mode->subsets; e++) {
    uint8_t *low = &b->low[e / 2][e % 2];
    if (mode->low == LOW_SHARED && e % 2 == 1)
      *low = b->low[e / 2][0];
    else
      *low = (uint8_t)btfi_bits_next(bits, 1, *low);
  }
  walk_indices(bits, b, 0, mode->index_bits);
  if (mode->second_bits > 0) walk_indices(bits, b, 1, mode->second_bits);
}

/* An end as a byte: its bits, the low one included, repeated. */
static uint32_t expand(uint32_t value, uint32_t bits) {
  return bits == 0 ? 255 : bits >= 8 ? value : (value << (8 - bits) | value >> (2 * bits - 8));
}

static uint32_t end_byte(const bc7_mode *mode, const uint8_t end[4], uint8_t low, int channel) {
  const uint32_t bits = end_bits(mode, channel);
  if (bits == 0 || mode->low == LOW_NONE) return expand(end[channel], bits);
  return expand((uint32_t)end[channel] << 1 | low, bits + 1);
}

static uint32_t between(uint32_t first, uint32_t second, uint32_t weight) {
  return (first * (64 - weight) + second * weight + 32) >> 6;
}

/* The set of indices that a channel goes by, and its bits. */
static uint32_t index_set(const bc7_mode *mode, uint32_t selection, int channel, uint32_t *bits) {
  const uint32_t set = mode->second_bits > 0 && (channel == 3) != (selection == 1);
  *bits = set == 1 ? mode->second_bits : mode->index_bits;
  return set;
}

static void swap_channels(uint32_t rotation, unsigned char texel[4]) {
  if (rotation == 0) return;
  const unsigned char alpha = texel[3];
  texel[3] = texel[rotation - 1];
  texel[rotation - 1] = alpha;
}

bool btfi_bc7_decode(const unsigned char block[BTFI_BLOCK_BYTES],
                     unsigned char texels[BTFI_BLOCK_TEXELS][4]) {
  unsigned char copy[BTFI_BLOCK_BYTES];
  bc7_block b = {.mode = 0};
  btfi_bits bits = {copy, 0, false};
  memcpy(copy, block, sizeof copy);
  while (b.mode < MODES && btfi_bits_next(&bits, 1, 0) == 0) b.mode++;
  if (b.mode >= MODES || modes[b.mode].subsets == 0) return false;
  const bc7_mode *mode = &modes[b.mode];
  walk(&bits, &b);
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
    const uint32_t s = members_of(mode, b.partition, mode->subsets - 1u) >> i & (mode->subsets - 1u);
    for (int c = 0; c < 4; c++) {
      uint32_t index_bits;
      const uint32_t set = index_set(mode, b.selection, c, &index_bits);
      texels[i][c] = (unsigned char)between(end_byte(mode, b.end[s][0], b.low[s][0], c),
                                            end_byte(mode, b.end[s][1], b.low[s][1], c),
                                            btfi_block_weights(index_bits)[b.index[set][i]]);
    }
    swap_channels(b.rotation, texels[i]);
  }
  return true;
}

/* ---- a line of a block ---- */

/* What one line is fitted to: the channels `counts` of a subset, by one set of indices. */
typedef struct line_problem {
  const float (*texels)[4];
  const bc7_mode *mode;
  uint32_t members, counts, index_bits;
} line_problem;

static void weights_of(uint32_t counts, float weight[4]) {
  for (int c = 0; c < 4; c++) weight[c] = counts >> c & 1u ? 1.0f : 0.0f;
}

static uint8_t nearest_end(const bc7_mode *mode, float value, uint32_t low, int channel) {
  const uint32_t bits = end_bits(mode, channel), has_low = mode->low != LOW_NONE;
  if (bits == 0) return 0;
  const float most = (float)((1u << bits) - 1u), all = (float)((1u << (bits + has_low)) - 1u);
  const float scaled = value * all / 255.0f;
  return (uint8_t)(btfi_clamp(has_low ? (scaled - (float)low) * 0.5f : scaled, 0.0f, most) + 0.5f);
}

static float try_ends(const line_problem *p, const uint8_t end[2][4], const uint8_t low[2],
                      uint8_t index[BTFI_BLOCK_TEXELS]) {
  const uint8_t *weights = btfi_block_weights(p->index_bits);
  btfi_palette palette = {.count = 1u << p->index_bits};
  float weight[4];
  weights_of(p->counts, weight);
  for (int c = 0; c < 4; c++) {
    const uint32_t first = end_byte(p->mode, end[0], low[0], c),
                   second = end_byte(p->mode, end[1], low[1], c);
    for (uint32_t k = 0; k < palette.count; k++)
      palette.value[c][k] = (float)between(first, second, weights[k]);
  }
  return btfi_block_nearest(p->texels, p->members, weight, &palette, index);
}

/* Copies the channels that the line is of: those of the other line stay. */
static void keep_ends(uint32_t counts, const uint8_t from[2][4], uint8_t to[2][4]) {
  for (int c = 0; c < 4; c++) {
    if ((counts >> c & 1u) == 0) continue;
    to[0][c] = from[0][c];
    to[1][c] = from[1][c];
  }
}

/* Every choice of low bits, for the ends that the texels and then the best indices want. */
static float fit_line(const line_problem *p, uint8_t end[2][4], uint8_t low[2],
                      uint8_t index[BTFI_BLOCK_TEXELS]) {
  const uint32_t choices = p->mode->low == LOW_EACH ? 4 : p->mode->low == LOW_SHARED ? 2 : 1;
  float ends[2][4], weight[4], least = FLT_MAX;
  weights_of(p->counts, weight);
  btfi_block_line(p->texels, p->members, weight, ends);
  for (int round = 0; round < REFINEMENTS; round++) {
    bool is_better = false;
    for (uint32_t choice = 0; choice < choices; choice++) {
      const uint8_t tried_low[2] = {(uint8_t)(choice & 1u),
                                    (uint8_t)(p->mode->low == LOW_SHARED ? choice & 1u : choice >> 1)};
      uint8_t tried[2][4], indices[BTFI_BLOCK_TEXELS] = {0};
      for (int e = 0; e < 2; e++)
        for (int c = 0; c < 4; c++) tried[e][c] = nearest_end(p->mode, ends[e][c], tried_low[e], c);
      const float error = try_ends(p, tried, tried_low, indices);
      if (!(error < least)) continue;
      least = error;
      is_better = true;
      keep_ends(p->counts, tried, end);
      memcpy(low, tried_low, sizeof tried_low);
      for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
        if (p->members >> i & 1u) index[i] = indices[i];
    }
    if (!is_better || !(least > 0.0f)) break;
    btfi_block_refine(p->texels, p->members, index, p->index_bits, ends);
  }
  return least;
}

/* ---- blocks ---- */

/* Turns a line around where its anchor's index would need the bit that is not stored. */
static void normalize(bc7_block *b, uint32_t subset, int set, uint32_t index_bits, uint32_t channels) {
  const bc7_mode *mode = &modes[b->mode];
  const uint32_t members = members_of(mode, b->partition, subset), last = (1u << index_bits) - 1u;
  const uint32_t anchor = subset == 0 ? 0 : anchors[b->partition];
  if (b->index[set][anchor] <= last / 2) return;
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
    if (members >> i & 1u) b->index[set][i] = (uint8_t)(last - b->index[set][i]);
  for (int c = 0; c < 4; c++) {
    if ((channels >> c & 1u) == 0) continue;
    const uint8_t first = b->end[subset][0][c];
    b->end[subset][0][c] = b->end[subset][1][c];
    b->end[subset][1][c] = first;
  }
  if (set != 0) return;
  const uint8_t first = b->low[subset][0];
  b->low[subset][0] = b->low[subset][1];
  b->low[subset][1] = first;
}

/* One line in each subset: modes 1, 3, 6, 7. */
static float fit_subsets(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t counts, bc7_block *b) {
  const bc7_mode *mode = &modes[b->mode];
  float sum = 0.0f;
  for (uint32_t s = 0; s < mode->subsets; s++) {
    const line_problem p = {texels, mode, members_of(mode, b->partition, s), counts, mode->index_bits};
    sum += fit_line(&p, b->end[s], b->low[s], b->index[0]);
    normalize(b, s, 0, mode->index_bits, RGB | ALPHA);
  }
  return sum;
}

/* A line for three channels and one for the fourth: modes 4 and 5. */
static float fit_channels(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t counts, bc7_block *b) {
  const bc7_mode *mode = &modes[b->mode];
  float sum = 0.0f, turned[BTFI_BLOCK_TEXELS][4];
  const uint32_t alone = b->rotation == 0 ? 3 : b->rotation - 1;
  memcpy(turned, texels, sizeof turned);
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
    turned[i][3] = texels[i][alone];
    turned[i][alone] = texels[i][3];
  }
  const uint32_t alpha = counts >> 3 & 1u, own = counts >> alone & 1u;
  counts = (counts & ~(1u << alone) & RGB) | (alone < 3 ? alpha << alone : 0) | own << 3;
  for (int part = 0; part < 2; part++) {
    uint32_t index_bits;
    uint8_t low[2] = {0, 0};
    const uint32_t channels = part == 0 ? RGB : ALPHA;
    const uint32_t set = index_set(mode, b->selection, part == 0 ? 0 : 3, &index_bits);
    const line_problem p = {(const float(*)[4])turned, mode, 0xffffu, counts & channels, index_bits};
    sum += fit_line(&p, b->end[0], low, b->index[set]);
    normalize(b, 0, (int)set, index_bits, channels);
  }
  return sum;
}

/* ---- choices ---- */

/* The partition whose lines leave least. */
static uint32_t best_partition(const float texels[BTFI_BLOCK_TEXELS][4], const float weight[4]) {
  btfi_moments of_texel[BTFI_BLOCK_TEXELS], all = {.count = 0.0f};
  float least = FLT_MAX;
  uint32_t best = 0;
  memset(of_texel, 0, sizeof of_texel);
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
    btfi_moments_add(&of_texel[i], texels[i], weight);
    btfi_moments_join(&all, &of_texel[i], 1.0f);
  }
  for (uint32_t k = 0; k < PARTITIONS; k++) {
    btfi_moments second = {.count = 0.0f}, first = all;
    for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
      if (partitions[k] >> i & 1u) btfi_moments_join(&second, &of_texel[i], 1.0f);
    btfi_moments_join(&first, &second, -1.0f);
    const float residual = btfi_moments_residual(&first, NULL) + btfi_moments_residual(&second, NULL);
    if (!(residual < least)) continue;
    least = residual;
    best = k;
  }
  return best;
}

/* The channel that the line of the three others misses most. */
static uint32_t best_rotation(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t counts) {
  uint32_t best = 0;
  float least = FLT_MAX;
  for (uint32_t rotation = 0; rotation < 4; rotation++) {
    btfi_moments m = {.count = 0.0f};
    float weight[4];
    weights_of(counts & ~(1u << (rotation == 0 ? 3 : rotation - 1)), weight);
    for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) btfi_moments_add(&m, texels[i], weight);
    const float residual = btfi_moments_residual(&m, NULL);
    if (!(residual < least)) continue;
    least = residual;
    best = rotation;
  }
  return best;
}

static void keep_better(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t counts, const bc7_block *tried,
                        float *least, bc7_block *best) {
  bc7_block b = *tried;
  const float error =
      modes[b.mode].second_bits > 0 ? fit_channels(texels, counts, &b) : fit_subsets(texels, counts, &b);
  if (!(error < *least)) return;
  *least = error;
  *best = b;
}

float btfi_bc7_encode(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t counts,
                      unsigned char block[BTFI_BLOCK_BYTES]) {
  bc7_block best = {.mode = 6};
  btfi_bits bits = {block, 0, true};
  float least = FLT_MAX, weight[4];
  weights_of(counts, weight);
  keep_better(texels, counts, &best, &least, &best);
  if (least > 0.0f) {
    bc7_block tried = {.rotation = best_rotation(texels, counts), .mode = 5};
    keep_better(texels, counts, &tried, &least, &best);
    tried.mode = 4;
    for (tried.selection = 0; tried.selection < 2; tried.selection++)
      keep_better(texels, counts, &tried, &least, &best);
    tried = (bc7_block){.partition = best_partition(texels, weight), .mode = 7};
    if ((counts & ALPHA) == 0) {
      tried.mode = 1;
      keep_better(texels, counts, &tried, &least, &best);
      tried.mode = 3;
    }
    keep_better(texels, counts, &tried, &least, &best);
  }
  memset(block, 0, BTFI_BLOCK_BYTES);
  btfi_bits_next(&bits, best.mode + 1, 1u << best.mode);
  walk(&bits, &best);
  return least;
}
