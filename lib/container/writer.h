/* SPDX-License-Identifier: MIT */
/* writer.h: inside of a container being written, private to this layer. */
#ifndef BTFI_WRITER_H
#define BTFI_WRITER_H

#include "container/payload.h"

struct btf_writer {
  btf_context *ctx;
  btf_io io;
  char *name; /* of the sink, for messages */
  uint64_t position;
  int32_t zstd_level; /* 0 = as the payload wishes */
  uint32_t optional_features;
  btfi_entry *entries;
  uint32_t entry_count, entry_capacity;
  btf_dirset **sets;
  uint32_t set_count, set_capacity;
  uint32_t model_count;
  btfi_metadata metadata;
  btf_status status; /* the first failure; everything after it only passes it on */
};

/* Appends an entry's head; sets e->offset. The stored bytes follow through btfi_writer_bytes. */
btf_status btfi_writer_head(btf_writer *w, btfi_entry *e);
btf_status btfi_writer_bytes(btf_writer *w, const void *src, uint64_t size);
/* Appends a chunk of bytes at hand: fills stored, raw, method and checksum of e. */
btf_status btfi_writer_raw_chunk(btf_writer *w, btfi_entry *e, const void *data, uint64_t size);
/* Number of an equal direction set already written, or of the next (*is_new); the caller writes it. */
btf_status btfi_writer_set_number(btf_writer *w, const btf_dirset *set, uint32_t *number, bool *is_new);
/* Sets the sticky status. */
btf_status btfi_writer_fail(btf_writer *w, btf_status status);

#endif
