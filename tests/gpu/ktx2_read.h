/* SPDX-License-Identifier: MIT */
/* ktx2_read.h: reads KTX 2.0 files, written from the specification and not from the library's writer. */
#ifndef KTX2_READ_H
#define KTX2_READ_H

#include <stddef.h>
#include <stdint.h>

enum { KTX2_MOST_LEVELS = 16 };

typedef struct ktx2_texture {
  uint32_t vk_format, type_size, width, height, depth, layers, faces, levels, scheme;
  unsigned char *level[KTX2_MOST_LEVELS]; /* decompressed */
  uint64_t level_size[KTX2_MOST_LEVELS];
} ktx2_texture;

/* NULL when everything in the file is as the specification and docs/gpu-export.md want it, otherwise what is
 * wrong. */
const char *ktx2_read(const unsigned char *file, size_t size, ktx2_texture *out);
void ktx2_free(ktx2_texture *t);

#endif
