/* SPDX-License-Identifier: MIT */
/* ktx2.c: a texture as a KTX 2.0 file (registry.khronos.org/KTX/specs/2.0/ktxspec.v2.html). */
#include "gpu/gpu.h"

#include <limits.h>
#include <string.h>

#include <zstd.h>

enum {
  HEADER_BYTES = 80,
  LEVEL_BYTES = 24, /* of an entry of the level index */
  SCHEME_NONE = 0,
  SCHEME_ZSTD = 2,
  MODEL_RGBSDA = 1,
  MODEL_BC6H = 133,
  MODEL_BC7 = 134,
  TRANSFER_LINEAR = 1,
  QUALIFIER_SIGNED = 0x40,
  QUALIFIER_FLOAT = 0x80
};

/* Where a level went. */
typedef struct placed_level {
  uint64_t offset, size;
} placed_level;

static void put_u16(btfi_buffer *b, uint32_t v) {
  btfi_put_u8(b, (uint8_t)v);
  btfi_put_u8(b, (uint8_t)(v >> 8));
}

static void pad_to(btfi_buffer *b, uint64_t multiple) {
  while (btfi_buffer_status(b) == BTF_OK && b->size % multiple != 0) btfi_put_u8(b, 0);
}

/* ---- what the texels are: a basic data format descriptor ---- */

static void put_channel(btfi_buffer *b, const btfi_texel_format *f, uint32_t channel) {
  static const uint8_t ids[4] = {0, 1, 2, 15}; /* red, green, blue, alpha */
  uint32_t lower = 0, upper = f->side > 1 ? UINT32_MAX : 255;
  if (f->is_float) {
    lower = f->is_signed ? 0xbf800000u : 0; /* -1 and 1 as floats */
    upper = 0x3f800000u;
  } else if (f->is_signed) {
    lower = (uint32_t)-127;
    upper = 127;
  }
  put_u16(b, channel * f->bytes * 8);
  btfi_put_u8(b, (uint8_t)(f->bytes * 8 - 1));
  btfi_put_u8(b, (uint8_t)(ids[channel] | (f->is_float ? QUALIFIER_FLOAT : 0) |
                           (f->is_signed ? QUALIFIER_SIGNED : 0)));
  btfi_put_u32(b, 0); /* sample position */
  btfi_put_u32(b, lower);
  btfi_put_u32(b, upper);
}

static void put_descriptor(btfi_buffer *b, const btfi_texel_format *f) {
  const uint32_t block = 24 + 16 * f->channels;
  btfi_put_u32(b, 4 + block);
  btfi_put_u32(b, 0); /* Khronos, basic */
  put_u16(b, 2);      /* version */
  put_u16(b, block);
  btfi_put_u8(b, f->side == 1 ? MODEL_RGBSDA : f->is_float ? MODEL_BC6H : MODEL_BC7);
  btfi_put_u8(b, 0); /* primaries: not specified */
  btfi_put_u8(b, TRANSFER_LINEAR);
  btfi_put_u8(b, 0);                        /* alpha is not premultiplied */
  btfi_put_u32(b, (f->side - 1) * 0x0101u); /* sides of a block, less one */
  btfi_put_u8(b, (uint8_t)(f->channels * f->bytes));
  for (int plane = 1; plane < 8; plane++) btfi_put_u8(b, 0);
  for (uint32_t c = 0; c < f->channels; c++) put_channel(b, f, c);
}

static void put_pair(btfi_buffer *b, const char *key, const char *value) {
  const size_t size = strlen(key) + 1 + strlen(value) + 1;
  btfi_put_u32(b, (uint32_t)size);
  btfi_put_bytes(b, key, strlen(key) + 1);
  btfi_put_bytes(b, value, strlen(value) + 1);
  pad_to(b, 4);
}

static void put_pairs(btfi_buffer *b, const btfi_gpu_texture *t) {
  /* Row 0 is that of the smallest v. */
  put_pair(b, "KTXorientation", t->dimension == BTF_TEXTURE_3D ? "rui" : "ru");
  put_pair(b, "KTXwriter",
           "libbtf " BTFI_STRINGIFY(LIBBTF_VERSION_MAJOR) "." BTFI_STRINGIFY(
               LIBBTF_VERSION_MINOR) "." BTFI_STRINGIFY(LIBBTF_VERSION_PATCH));
}

/* ---- levels ---- */

static btf_status put_compressed(btfi_buffer *b, const btf_gpu_level *level, int32_t zstd_level) {
  const size_t bound = ZSTD_compressBound(level->size);
  if (ZSTD_isError(bound)) return btfi_fail(b->ctx, BTF_E_LIMIT, "KTX2: a level is too large for zstd");
  void *packed = btfi_alloc(b->ctx, bound, 1);
  if (packed == NULL) return btfi_alloc_status();
  const size_t size = ZSTD_compress(packed, bound, level->data, level->size, zstd_level);
  const btf_status status =
      ZSTD_isError(size) ? btfi_fail(b->ctx, BTF_E_NOMEM, "KTX2: zstd: %s", ZSTD_getErrorName(size)) : BTF_OK;
  if (status == BTF_OK) btfi_put_bytes(b, packed, size);
  btfi_free(b->ctx, packed);
  return status;
}

static btf_status put_levels(btfi_buffer *b, const btfi_gpu_texture *t, int32_t zstd_level,
                             placed_level *placed) {
  const btfi_texel_format *f = btfi_texel_format_of(t->texel);
  const uint32_t texel = f->channels * f->bytes;
  for (uint32_t i = t->level_count; i-- > 0;) {
    /* Texels are 1, 2, 4, 8 or 16 bytes: the least common multiple with 4. */
    if (zstd_level == 0) pad_to(b, BTFI_MAX(texel, 4u));
    placed[i].offset = b->size;
    if (zstd_level != 0)
      BTFI_TRY(put_compressed(b, &t->levels[i], zstd_level));
    else
      btfi_put_bytes(b, t->levels[i].data, t->levels[i].size);
    placed[i].size = b->size - placed[i].offset;
  }
  return btfi_buffer_status(b);
}

static void put_header(btfi_buffer *b, const btfi_gpu_texture *t, int32_t zstd_level,
                       uint32_t descriptor_size, uint32_t pairs_offset, uint32_t pairs_size) {
  static const unsigned char identifier[12] = {0xab, 'K',  'T',  'X',  ' ',  '2',
                                               '0',  0xbb, '\r', '\n', 0x1a, '\n'};
  const btfi_texel_format *f = btfi_texel_format_of(t->texel);
  btfi_put_bytes(b, identifier, sizeof identifier);
  btfi_put_u32(b, t->texel);
  btfi_put_u32(b, f->side > 1 ? 1 : f->bytes);
  btfi_put_u32(b, t->width);
  btfi_put_u32(b, t->height);
  btfi_put_u32(b, t->dimension == BTF_TEXTURE_3D ? t->slices : 0);
  btfi_put_u32(b, t->dimension == BTF_TEXTURE_2D_ARRAY ? t->slices : 0);
  btfi_put_u32(b, 1); /* faces */
  btfi_put_u32(b, t->level_count);
  btfi_put_u32(b, zstd_level != 0 ? SCHEME_ZSTD : SCHEME_NONE);
  btfi_put_u32(b, pairs_offset - descriptor_size);
  btfi_put_u32(b, descriptor_size);
  btfi_put_u32(b, pairs_offset);
  btfi_put_u32(b, pairs_size);
  btfi_put_u64(b, 0); /* no global data */
  btfi_put_u64(b, 0);
}

/* The parts before the levels have sizes that are known; only the level index waits for what zstd makes. */
static btf_status assemble(const btfi_gpu_texture *t, int32_t zstd_level, btfi_buffer *pairs,
                           placed_level *placed, btfi_buffer *out) {
  const btfi_texel_format *f = btfi_texel_format_of(t->texel);
  const uint32_t index_end = HEADER_BYTES + LEVEL_BYTES * t->level_count,
                 descriptor_size = 28 + 16 * f->channels;
  put_pairs(pairs, t);
  BTFI_TRY(btfi_buffer_status(pairs));
  put_header(out, t, zstd_level, descriptor_size, index_end + descriptor_size, (uint32_t)pairs->size);
  for (uint32_t i = 0; i < LEVEL_BYTES * t->level_count; i++) btfi_put_u8(out, 0);
  put_descriptor(out, f);
  btfi_put_bytes(out, pairs->data, pairs->size);
  BTFI_TRY(put_levels(out, t, zstd_level, placed));
  const uint64_t size = out->size;
  out->size = HEADER_BYTES;
  for (uint32_t i = 0; i < t->level_count; i++) {
    btfi_put_u64(out, placed[i].offset);
    btfi_put_u64(out, placed[i].size);
    btfi_put_u64(out, t->levels[i].size);
  }
  out->size = size;
  return btfi_buffer_status(out);
}

btf_status btfi_gpu_put_ktx2(const btfi_gpu_texture *t, int32_t zstd_level, btfi_buffer *out) {
  placed_level placed[32];
  btfi_buffer pairs;
  btfi_buffer_init(&pairs, out->ctx);
  const btf_status status = assemble(t, zstd_level, &pairs, placed, out);
  btfi_buffer_free(&pairs);
  return status;
}
