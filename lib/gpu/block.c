/* SPDX-License-Identifier: MIT */
/* block.c: lines through the texels of a block, which BC7 and BC6H have in common. */
#include "gpu/block.h"

#include <string.h>

uint32_t btfi_bits_next(btfi_bits *b, uint32_t count, uint32_t value) {
  uint32_t out = 0;
  for (uint32_t i = 0; i < count; i++, b->at++) {
    unsigned char *byte = &b->block[b->at / 8];
    const uint32_t shift = b->at % 8;
    if (b->is_writing) *byte = (unsigned char)(*byte | (value >> i & 1u) << shift);
    out |= (uint32_t)(*byte >> shift & 1) << i;
  }
  return out;
}

const uint8_t *btfi_block_weights(uint32_t index_bits) {
  static const uint8_t two[] = {0, 21, 43, 64}, three[] = {0, 9, 18, 27, 37, 46, 55, 64},
                       four[] = {0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64};
  return index_bits == 2 ? two : index_bits == 3 ? three : four;
}

/* Squared distances to four entries from the `first` on. */
static void add_distances(const float texel[4], const float weight[4], const btfi_palette *palette,
                          uint32_t first, float distance[4]) {
  for (int c = 0; c < 4; c++)
    for (uint32_t k = 0; k < 4; k++) {
      const float difference = texel[c] - palette->value[c][first + k];
      distance[k] += weight[c] * difference * difference;
    }
}

float btfi_block_nearest(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t members, const float weight[4],
                         const btfi_palette *palette, uint8_t index[BTFI_BLOCK_TEXELS]) {
  float sum = 0.0f;
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
    float distance[16] = {0.0f};
    uint32_t nearest = 0;
    if ((members >> i & 1u) == 0) continue;
    for (uint32_t first = 0; first < palette->count; first += 4)
      add_distances(texels[i], weight, palette, first, distance + first);
    float least = distance[0];
    for (uint32_t k = 1; k < palette->count; k++) {
      nearest = distance[k] < least ? k : nearest;
      least = distance[k] < least ? distance[k] : least;
    }
    index[i] = (uint8_t)nearest;
    sum += least;
  }
  return sum;
}

/* ---- lines ---- */

void btfi_moments_add(btfi_moments *m, const float texel[4], const float weight[4]) {
  m->count += 1.0f;
  for (int a = 0; a < 4; a++) {
    const float value = weight[a] * texel[a];
    m->sum[a] += value;
    for (int c = 0; c < 4; c++) m->product[a][c] += value * (weight[c] * texel[c]);
  }
}

void btfi_moments_join(btfi_moments *m, const btfi_moments *other, float times) {
  m->count += times * other->count;
  for (int a = 0; a < 4; a++) {
    m->sum[a] += times * other->sum[a];
    for (int c = 0; c < 4; c++) m->product[a][c] += times * other->product[a][c];
  }
}

/* The power method; a start along the channel of the largest variance cannot be orthogonal to the axis unless
 * the channels are uncorrelated, and then it is the axis. */
float btfi_moments_residual(const btfi_moments *m, float axis[4]) {
  const int steps = axis != NULL ? 6 : 2;
  float covariance[4][4], direction[4] = {0.0f}, trace = 0.0f, largest = 0.0f, length = 0.0f;
  int first = 0;
  if (axis != NULL) memset(axis, 0, 4 * sizeof *axis);
  if (!(m->count > 0.0f)) return 0.0f;
  for (int a = 0; a < 4; a++) {
    for (int c = 0; c < 4; c++) covariance[a][c] = m->product[a][c] - m->sum[a] * m->sum[c] / m->count;
    trace += covariance[a][a];
    if (covariance[a][a] > covariance[first][first]) first = a;
  }
  if (!(covariance[first][first] > 0.0f)) return 0.0f;
  memcpy(direction, covariance[first], sizeof direction);
  for (int step = 0; step < steps; step++) {
    float next[4] = {0.0f}, squares = 0.0f;
    for (int a = 0; a < 4; a++) squares += direction[a] * direction[a];
    length = sqrtf(squares);
    if (!(length > 0.0f)) return 0.0f;
    for (int c = 0; c < 4; c++) direction[c] /= length;
    for (int a = 0; a < 4; a++)
      for (int c = 0; c < 4; c++) next[a] += covariance[c][a] * direction[c];
    largest = 0.0f;
    for (int c = 0; c < 4; c++) largest += next[c] * direction[c];
    if (step + 1 < steps) memcpy(direction, next, sizeof direction);
  }
  if (axis != NULL) memcpy(axis, direction, sizeof direction);
  return trace > largest ? trace - largest : 0.0f;
}

void btfi_block_line(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t members, const float weight[4],
                     float end[2][4]) {
  btfi_moments m = {.count = 0.0f};
  float axis[4], mean[4], least = 0.0f, most = 0.0f;
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++)
    if (members >> i & 1u) btfi_moments_add(&m, texels[i], weight);
  btfi_moments_residual(&m, axis);
  for (int c = 0; c < 4; c++) mean[c] = m.count > 0.0f ? m.sum[c] / m.count : 0.0f;
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
    float along = 0.0f;
    if ((members >> i & 1u) == 0) continue;
    for (int c = 0; c < 4; c++) along += axis[c] * (weight[c] * texels[i][c] - mean[c]);
    least = fminf(least, along);
    most = fmaxf(most, along);
  }
  for (int c = 0; c < 4; c++) {
    end[0][c] = mean[c] + least * axis[c];
    end[1][c] = mean[c] + most * axis[c];
  }
}

void btfi_block_refine(const float texels[BTFI_BLOCK_TEXELS][4], uint32_t members,
                       const uint8_t index[BTFI_BLOCK_TEXELS], uint32_t index_bits, float end[2][4]) {
  const uint8_t *weights = btfi_block_weights(index_bits);
  float first = 0.0f, both = 0.0f, second = 0.0f, sum[2][4] = {{0.0f}};
  for (uint32_t i = 0; i < BTFI_BLOCK_TEXELS; i++) {
    const float w = (float)weights[index[i]] / 64.0f;
    if ((members >> i & 1u) == 0) continue;
    first += (1.0f - w) * (1.0f - w);
    both += w * (1.0f - w);
    second += w * w;
    for (int c = 0; c < 4; c++) {
      sum[0][c] += (1.0f - w) * texels[i][c];
      sum[1][c] += w * texels[i][c];
    }
  }
  const float determinant = first * second - both * both;
  if (!(determinant > 1e-3f)) return;
  for (int c = 0; c < 4; c++) {
    end[0][c] = (second * sum[0][c] - both * sum[1][c]) / determinant;
    end[1][c] = (first * sum[1][c] - both * sum[0][c]) / determinant;
  }
}
