/* SPDX-License-Identifier: MIT */
#include "ktx2_read.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include <zstd.h>

static uint64_t little(const unsigned char *p, int bytes) {
  uint64_t v = 0;
  for (int i = bytes; i-- > 0;) v = v << 8 | p[i];
  return v;
}

/* Bytes of a texel of the formats that exports use, and of one channel; 0 = none of them. */
static uint32_t texel_bytes(uint32_t vk_format, uint32_t *channel) {
  static const uint32_t table[][3] = {{9, 1, 1},     {16, 2, 1},    {37, 4, 1},   {38, 4, 1},  {76, 2, 2},
                                      {83, 4, 2},    {97, 8, 2},    {100, 4, 4},  {103, 8, 4}, {109, 16, 4},
                                      {143, 16, 16}, {144, 16, 16}, {145, 16, 16}};
  for (size_t i = 0; i < sizeof table / sizeof *table; i++) {
    if (table[i][0] != vk_format) continue;
    *channel = table[i][2];
    return table[i][1];
  }
  return 0;
}

/* BC6H without and with a sign, BC7: a block of 4 x 4 texels is the unit then. */
static bool is_blocks(uint32_t vk_format) {
  return vk_format >= 143 && vk_format <= 145;
}

/* What samples of a format say: qualifiers (bit 7: float, bit 6: signed), and which words stand for 0 or -1
 * and for 1. Of floats these are floats, of bytes with a sign -127 and 127, as -128 means -1, too. */
typedef struct sample_words {
  uint32_t qualifiers, lower, upper;
} sample_words;

static sample_words sample_words_of(uint32_t vk_format) {
  const uint32_t one = 0x3f800000u, minus_one = 0xbf800000u;
  if (vk_format == 145) return (sample_words){0, 0, UINT32_MAX};
  if (vk_format == 143) return (sample_words){0x80, 0, one};
  if (vk_format == 38) return (sample_words){0x40, UINT32_MAX - 126, 127};
  if (vk_format < 38) return (sample_words){0, 0, 255};
  return (sample_words){0xc0, minus_one, one};
}

/* Section 3.10 and the Khronos Data Format specification 1.3: a basic descriptor with a sample for each
 * channel. */
static const char *check_descriptor(const unsigned char *d, uint64_t size, const ktx2_texture *t) {
  uint32_t channel = 0;
  const uint32_t texel = texel_bytes(t->vk_format, &channel), channels = texel / channel;
  if (size != 28 + 16 * (uint64_t)channels || little(d, 4) != size) return "the descriptor has a wrong size";
  if (little(d + 4, 4) != 0 || little(d + 8, 2) != 2 || little(d + 10, 2) != size - 4)
    return "the descriptor is not basic, version 2";
  const uint32_t model = t->vk_format == 145 ? 134 : is_blocks(t->vk_format) ? 133 : 1;
  const uint32_t side = is_blocks(t->vk_format) ? 4 : 1;
  if (d[12] != model || d[14] != 1) return "the texels are not of the format's model, or not linear";
  if (d[13] != 0 || d[15] != 0) return "the texels are colours of some primaries, or premultiplied";
  if (d[16] != side - 1 || d[17] != side - 1 || d[18] != 0 || d[19] != 0) return "blocks of a wrong size";
  if (little(d + 20, 8) != texel) return "there is not one plane with bytes of the texel's size";
  const sample_words words = sample_words_of(t->vk_format);
  for (uint32_t c = 0; c < channels; c++) {
    const unsigned char *s = d + 28 + 16 * c;
    if (little(s, 2) != c * channel * 8 || s[2] != channel * 8 - 1) return "a sample is elsewhere";
    if ((s[3] & 15) != (c == 3 ? 15 : c)) return "a sample is of another channel";
    if ((s[3] & 0xf0) != words.qualifiers || little(s + 4, 4) != 0) return "a sample is of another kind";
    if (little(s + 8, 4) != words.lower || little(s + 12, 4) != words.upper)
      return "a sample has wrong bounds";
  }
  return NULL;
}

/* Columns to the right, rows up, slices inwards: along growing u, v and number. */
static const char *check_pairs(const unsigned char *p, uint64_t size, const ktx2_texture *t) {
  const char *before = "", *orientation = t->depth != 0 ? "rui" : "ru";
  bool has_orientation = false;
  uint64_t at = 0;
  while (at < size) {
    if (size - at < 4) return "a key's length is cut off";
    const uint64_t length = little(p + at, 4), padded = (length + 3) & ~(uint64_t)3;
    if (length < 2 || padded > size - at - 4) return "a key ends outside";
    const char *key = (const char *)p + at + 4;
    const size_t key_length = strnlen(key, length);
    if (key_length == length) return "a key has no end";
    if (strcmp(before, key) >= 0) return "keys are not sorted";
    if (strcmp(key, "KTXorientation") == 0) {
      const size_t value = key_length + 1;
      if (length - value != strlen(orientation) + 1 || memcmp(key + value, orientation, length - value) != 0)
        return "columns, rows or slices go another way";
      has_orientation = true;
    }
    before = key;
    at += 4 + padded;
  }
  if (!has_orientation) return "no orientation";
  return at == size ? NULL : "the keys' length is wrong";
}

static const char *read_level(const unsigned char *file, size_t size, uint32_t i, ktx2_texture *t,
                              uint64_t *end) {
  const unsigned char *entry = file + 80 + 24 * (size_t)i;
  const uint64_t offset = little(entry, 8), stored = little(entry + 8, 8), plain = little(entry + 16, 8);
  uint32_t channel = 0;
  const uint32_t texel = texel_bytes(t->vk_format, &channel), align = texel > 4 ? texel : 4;
  const uint64_t w = t->width >> i ? t->width >> i : 1, h = t->height >> i ? t->height >> i : 1,
                 d = t->depth >> i ? t->depth >> i : 1, n = t->layers ? t->layers : 1;
  const uint64_t side = is_blocks(t->vk_format) ? 4 : 1;
  if (plain != (w + side - 1) / side * ((h + side - 1) / side) * d * n * texel)
    return "a level has a wrong size";
  if (offset > size || stored > size - offset) return "a level lies outside";
  if (t->scheme == 0 && (offset % align != 0 || stored != plain)) return "a level is not aligned";
  if (*end != 0 && offset + stored > *end) return "levels are not stored smallest first";
  *end = offset;
  t->level_size[i] = plain;
  t->level[i] = malloc(plain);
  if (t->level[i] == NULL) return "no memory";
  if (t->scheme == 0)
    memcpy(t->level[i], file + offset, plain);
  else if (ZSTD_decompress(t->level[i], plain, file + offset, stored) != plain)
    return "a level is no zstd frame of its size";
  return NULL;
}

const char *ktx2_read(const unsigned char *file, size_t size, ktx2_texture *t) {
  static const unsigned char identifier[12] = {0xab, 'K',  'T',  'X',  ' ',  '2',
                                               '0',  0xbb, '\r', '\n', 0x1a, '\n'};
  uint32_t channel = 0;
  uint64_t end = 0;
  memset(t, 0, sizeof *t);
  if (size < 104 || memcmp(file, identifier, 12) != 0) return "not a KTX 2.0 file";
  uint32_t *const words[] = {&t->vk_format, &t->type_size, &t->width,  &t->height, &t->depth,
                             &t->layers,    &t->faces,     &t->levels, &t->scheme};
  for (size_t i = 0; i < 9; i++) *words[i] = (uint32_t)little(file + 12 + 4 * i, 4);
  const uint64_t dfd = little(file + 48, 4), dfd_size = little(file + 52, 4);
  const uint64_t kvd = little(file + 56, 4), kvd_size = little(file + 60, 4);
  if (texel_bytes(t->vk_format, &channel) == 0 || t->type_size != (is_blocks(t->vk_format) ? 1 : channel))
    return "an unexpected format";
  if (t->width == 0 || t->height == 0 || t->faces != 1 || t->levels == 0 || t->levels > KTX2_MOST_LEVELS)
    return "sizes make no sense";
  if (t->scheme != 0 && t->scheme != 2) return "an unexpected supercompression";
  if (dfd != 80 + 24 * (uint64_t)t->levels || dfd > size || dfd_size > size - dfd) return "no descriptor";
  if (kvd != dfd + dfd_size || kvd > size || kvd_size > size - kvd) return "no keys";
  const char *wrong = check_descriptor(file + dfd, dfd_size, t);
  if (wrong == NULL) wrong = check_pairs(file + kvd, kvd_size, t);
  for (uint32_t i = 0; wrong == NULL && i < t->levels; i++) wrong = read_level(file, size, i, t, &end);
  if (wrong == NULL && end < kvd + kvd_size) wrong = "levels overlap the keys";
  return wrong;
}

void ktx2_free(ktx2_texture *t) {
  for (uint32_t i = 0; i < KTX2_MOST_LEVELS; i++) free(t->level[i]);
  memset(t, 0, sizeof *t);
}
