/* SPDX-License-Identifier: MIT */
/* gpu.h: inside of an export for GPUs. */
#ifndef BTFI_GPU_H
#define BTFI_GPU_H

#include "model/model.h"
#include <btf/btf_gpu.h>

enum {
  BTFI_GPU_TEXTURES = 64,       /* in one export */
  BTFI_GPU_UNIFORMS = 64,       /* members of the block */
  BTFI_GPU_BLOCK_BYTES = 16384, /* of the block: what every implementation takes */
  BTFI_GPU_NAME = 64            /* bytes of a name with its NUL */
};

/* What texels of a format take and are. */
typedef struct btfi_texel_format {
  uint32_t vk, channels, bytes; /* bytes of a channel; blocks count as texels of one */
  bool is_float, is_signed;
  uint32_t side; /* of a block; 1 = texels */
} btfi_texel_format;
const btfi_texel_format *btfi_texel_format_of(uint32_t texel); /* NULL = not one of ours */

typedef struct btfi_gpu_texture {
  char name[BTFI_GPU_NAME];
  uint32_t dimension, texel, width, height, slices, level_count, wrap;
  bool filtered;
  double psnr_db; /* 0 = not compressed */
  btf_gpu_level *levels;
  unsigned char *data; /* all levels, each 64-byte aligned */
} btfi_gpu_texture;

/* What texels of a table hold. */
typedef enum btfi_gpu_packing {
  BTFI_GPU_PLAIN,  /* four values */
  BTFI_GPU_RANGES, /* four values, each between the ends of a range: the block's members btf_rangeN, two for a
                      slice */
  BTFI_GPU_COLORS  /* three; the fourth is 0 everywhere */
} btfi_gpu_packing;

/* A table of a codec: textures first .. first + pages - 1, each with `page` layers but the last. */
typedef struct btfi_gpu_pages {
  char name[BTFI_GPU_NAME];
  uint32_t first, pages, page, flags, slices;
  btfi_gpu_packing packing;
  uint32_t ranges; /* as many as slices, or one for all */
} btfi_gpu_pages;

struct btf_gpu_builder {
  btf_context *ctx;
  btf_gpu_target target; /* without zeros */
  uint32_t texture_count, table_count, uniform_count, set_count;
  btfi_gpu_texture texture[BTFI_GPU_TEXTURES];
  btfi_gpu_pages table[BTFI_GPU_TEXTURES];
  btf_gpu_uniform uniform[BTFI_GPU_UNIFORMS];
  char uniform_name[BTFI_GPU_UNIFORMS][BTFI_GPU_NAME];
  const btf_dirset *set[2]; /* distinct ones, with the names that their textures bear */
  char set_name[2][BTFI_GPU_NAME];
  uint32_t block_size;
  unsigned char block[BTFI_GPU_BLOCK_BYTES];
  btfi_buffer source; /* the codec's text */
  btfi_buffer search; /* the functions of direction sets */
  btf_gpu_cost cost;
};

struct btf_gpu_export {
  btf_context *ctx;
  btf_gpu_builder *built;
  char *glsl, *manifest;
};

/* ---- textures (builder.c) ---- */

/* Levels and data by sizes, format and number of levels. */
btf_status btfi_gpu_texture_allocate(btf_context *ctx, btfi_gpu_texture *texture);
void btfi_gpu_texture_free(btf_context *ctx, btfi_gpu_texture *texture);
/* Refuses what is beyond the target, with what would do: after the codec's work, which tells how large all of
 * it is. */
btf_status btfi_gpu_check_limits(const btf_gpu_builder *b);
void btfi_gpu_page_name(const btfi_gpu_pages *table, uint32_t page, char out[BTFI_GPU_NAME]);

/* ---- the parts of an export ---- */

/* compress.c: turns tables into blocks where their codec allows it and bytes are saved; after the codec's
 * work. */
btf_status btfi_gpu_compress(btf_gpu_builder *b);
/* accessors.c: the functions that read tables. */
void btfi_gpu_put_accessors(const btf_gpu_builder *b, btfi_buffer *out);

/* glsl.c: the whole shader; `divide` by the light's cosine. */
void btfi_gpu_put_glsl(const btf_gpu_builder *b, uint32_t wrap, uint32_t channels, bool divide,
                       btfi_buffer *out);
/* manifest.c */
void btfi_gpu_put_manifest(const btf_gpu_export *e, const btf_model_info *model, const char *layout,
                           btfi_buffer *out);
/* ktx2.c: one texture as a file. */
btf_status btfi_gpu_put_ktx2(const btfi_gpu_texture *texture, int32_t zstd_level, btfi_buffer *out);

#endif
