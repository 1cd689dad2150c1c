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
  uint32_t vk, channels, bytes; /* bytes of a channel */
  bool is_float, is_signed;
} btfi_texel_format;
const btfi_texel_format *btfi_texel_format_of(uint32_t texel); /* NULL = not one of ours */

typedef struct btfi_gpu_texture {
  char name[BTFI_GPU_NAME];
  uint32_t dimension, texel, width, height, slices, level_count, wrap;
  bool filtered;
  btf_gpu_level *levels;
  unsigned char *data; /* all levels, each 64-byte aligned */
} btfi_gpu_texture;

/* A table of a codec: textures first .. first + pages - 1, each with `page` slices but the last. */
typedef struct btfi_gpu_pages {
  uint32_t first, pages, page;
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
  btfi_buffer source;   /* the codec's text */
  btfi_buffer accessor; /* the functions of tables and direction sets */
  btf_gpu_cost cost;
};

struct btf_gpu_export {
  btf_context *ctx;
  btf_gpu_builder *built;
  char *glsl, *manifest;
};

/* ---- the parts of an export ---- */

/* glsl.c: the whole shader; `divide` by the light's cosine. */
void btfi_gpu_put_glsl(const btf_gpu_builder *b, uint32_t wrap, uint32_t channels, bool divide,
                       btfi_buffer *out);
/* manifest.c */
void btfi_gpu_put_manifest(const btf_gpu_export *e, const btf_model_info *model, const char *layout,
                           btfi_buffer *out);
/* ktx2.c: one texture as a file. */
btf_status btfi_gpu_put_ktx2(const btfi_gpu_texture *texture, int32_t zstd_level, btfi_buffer *out);

#endif
