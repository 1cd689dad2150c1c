/* SPDX-License-Identifier: MIT */
/* gpu_folder.h: an export as its folder alone has it, read without the library's writer; and what renders it.
 */
#ifndef GPU_FOLDER_H
#define GPU_FOLDER_H

#include <stdbool.h>

#include <btf/btf.h>

#include "ktx2_read.h"

enum { FOLDER_MOST_TEXTURES = 32, FOLDER_MOST_BLOCK = 16384 };

typedef struct folder_texture {
  char name[64];
  uint32_t dimension; /* BTF_TEXTURE_* */
  uint32_t slices;    /* depth, layers, or 1 */
  uint32_t binding;
  bool filtered, repeat[2];
  ktx2_texture file;
} folder_texture;

typedef struct gpu_folder {
  char *glsl;
  folder_texture textures[FOLDER_MOST_TEXTURES];
  uint32_t texture_count, block_size;
  unsigned char block[FOLDER_MOST_BLOCK];
} gpu_folder;

/* NULL when everything is as the documentation wants it, otherwise what is wrong. A missing file fails the
 * test. */
const char *gpu_folder_read(const char *path, gpu_folder *out);
void gpu_folder_free(gpu_folder *f);

/* A renderer without a window, which evaluates queries by an export. Functions return NULL when done,
 * otherwise what is wrong. */
typedef struct gpu_host gpu_host;
struct gpu_host {
  const char *(*load)(gpu_host *host, const gpu_folder *folder);
  /* `count` queries of 9 floats (light, view, u, v, lod) to 3 floats each. */
  const char *(*eval)(gpu_host *host, const float *queries, size_t count, float *out);
  void (*close)(gpu_host *host);
  char name[256];
};

/* Changes a shader's text from malloc. */
typedef char *(*gpu_edit)(char *glsl, const void *user);
/* Writes an export to a folder, reads it and evaluates queries by it; `edit` may be NULL. Whatever goes wrong
 * fails the test. */
void gpu_host_run(gpu_host *host, const btf_gpu_export *e, int32_t zstd_level, gpu_edit edit,
                  const void *user, const float *queries, size_t count, float *out);

#endif
