/* SPDX-License-Identifier: MIT */
/* image_files.h: decoders of one format each, for image.c. */
#ifndef BTF_TOOLS_IMAGE_FILES_H
#define BTF_TOOLS_IMAGE_FILES_H

#include <stddef.h>

#include "image.h"

typedef struct image_bytes {
  const char *path;
  unsigned char *data;
  size_t size;
} image_bytes;

int image_decode_hdr(const image_bytes *file, image *out);
int image_decode_exr(const image_bytes *file, image *out);

#endif
