/* SPDX-License-Identifier: MIT */
/* reader.h: inside of an open container, private to this layer. */
#ifndef BTFI_READER_H
#define BTFI_READER_H

#include "container/payload.h"

struct btf_file {
  btf_context *ctx;
  btfi_source *source;
  btfi_header header;
  btfi_entry *entries; /* header.count, ascending in offset */
  uint32_t *order;     /* entries by (type, model, tag, index) */
  btf_dirset **sets;
  uint32_t set_count;
  btfi_payload **models;
  uint32_t model_count;
  btfi_metadata metadata;
};

/* Header, footer and directory (directory.c). */
btf_status btfi_read_structure(btf_file *f);

/* The first entry in `order` of a type and model, and how many there are. */
uint32_t btfi_file_range(const btf_file *file, uint32_t type, uint32_t model, uint32_t *first);

#endif
