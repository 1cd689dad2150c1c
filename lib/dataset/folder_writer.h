/* SPDX-License-Identifier: MIT */
/* folder_writer.h: inside of a writer of data-set folders. */
#ifndef BTFI_FOLDER_WRITER_H
#define BTFI_FOLDER_WRITER_H

#include <pthread.h>

#include "dataset/convert.h"
#include "dataset/manifest.h"

typedef struct btfi_write_stage btfi_write_stage;

struct btf_dataset_writer {
  btf_context *ctx;
  btf_dataset_desc desc; /* with texts of its own */
  btfi_convert_kernels kernels;
  btf_strides file; /* of the samples in the file */
  uint32_t order;
  char *path, *temporary, *samples_path;
  int fd;
  btfi_manifest_text *texts;
  uint32_t text_count;
  /* Every cell (texel x light x view) has a key, the product of four random numbers. The sum over all blocks
   * is that over all cells only when each came once; sums of keys are kept from 0 on, so that a block's is a
   * product of four differences. */
  uint64_t *key_sums[4]; /* view, light, y, x */
  uint64_t cells;
  atomic_uint_least64_t written_cells, written_keys;
  btfi_write_stage *stage;
};

/* n bytes at an offset of the samples file. */
btf_status btfi_writer_pwrite(const btf_dataset_writer *w, const void *src, uint64_t n, uint64_t offset);
/* Names the first value of a block that the sample type cannot hold. */
btf_status btfi_writer_fail_value(const btf_dataset_writer *w, const btf_block *block, const float *src,
                                  const btf_strides *strides);

/* write_stage.c: blocks that would be written in crumbs gather in memory until they make longer runs. */

/* Memory of one window; tests make it small. */
extern uint64_t btfi_stage_window_bytes;
btf_status btfi_stage_create(btf_dataset_writer *w);
void btfi_stage_free(btf_dataset_writer *w);
/* Whether a block is one to be gathered. */
bool btfi_stage_wants(const btf_dataset_writer *w, const btf_block *block);
btf_status btfi_stage_put(btf_dataset_writer *w, const btf_block *block, const float *src,
                          const btf_strides *strides);
btf_status btfi_stage_flush(btf_dataset_writer *w);

#endif
