/* SPDX-License-Identifier: MIT */
/* picture_jpeg_memory.h: memory of libjpeg from the host, which counts it. Private to picture_jpeg*.c. */
#ifndef BTF_FORMATS_PICTURE_JPEG_MEMORY_H
#define BTF_FORMATS_PICTURE_JPEG_MEMORY_H

#include <stdio.h>

#include <jpeglib.h>

#include "source/source_file.h"

enum { JPEG_MOST_MIB = 200 }; /* the coefficients of 2^25 pixels in three channels, and what is beside them */

typedef struct jpeg_block jpeg_block;
typedef struct jpeg_memory {
  const btf_host *host;
  btf_context *ctx;
  uint64_t used;
  bool over; /* more than JPEG_MOST_MIB were wanted */
  jpeg_block *pools[JPOOL_NUMPOOLS];
  struct jvirt_barray_control *arrays;
  void (*free_pool)(j_common_ptr info, int pool);
  void (*self_destruct)(j_common_ptr info);
} jpeg_memory;

/* After jpeg_create_decompress, whose few objects of fixed size stay libjpeg's own. All is freed by
 * jpeg_destroy_decompress; JERR_OUT_OF_MEMORY is raised without memory. The first member of what client_data
 * points to is `memory`. */
void jpeg_memory_use(struct jpeg_decompress_struct *info, jpeg_memory *memory);

#endif
