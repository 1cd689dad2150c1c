/* SPDX-License-Identifier: MIT */
/* container.h: payload chunks of one model, in memory or in a file. */
#ifndef BTFI_CONTAINER_H
#define BTFI_CONTAINER_H

#include "base/base.h"
#include "dataset/dataset.h"
#include <btf/btf_io.h>
#include <btf/btf_plugin.h>

/* One payload chunk in memory, unpacked, 64-byte aligned. */
typedef struct btfi_chunk {
  uint32_t tag, index, flags;
  const void *data;
  uint64_t size;
} btfi_chunk;

/* What a model is in a container: its header and its chunks. Reference counted; owned memory or a mapping
 * kept open. */
typedef struct btfi_payload btfi_payload;

/* The codec-independent header of a model. Strings and direction sets are owned by the payload. */
typedef struct btfi_model_header {
  char *codec_id;
  uint32_t codec_format;
  uint32_t width, height, channels, quantity, scale, wrap;
  btf_dirset *lights, *views;
  char **channel_names;
  char *color_space, *name, *source, *license;
  char **notes; /* NULL, or key, text, ..., NULL; metadata of the file */
  double texels_per_mm;
  uint64_t dataset_bytes; /* raw size of the data it was made from, at its sample type; 0 = unknown */
} btfi_model_header;

/* A new payload filled in by a fit through btf_chunk_writer. */
btf_status btfi_payload_create(btf_context *ctx, const btf_dataset *ds, const char *codec_id,
                               uint32_t codec_format, btfi_payload **out);
void btfi_payload_retain(btfi_payload *p);
void btfi_payload_release(btfi_payload *p);
const btfi_model_header *btfi_payload_header(const btfi_payload *p);
uint32_t btfi_payload_chunk_count(const btfi_payload *p);
/* The chunk, read, verified and unpacked on first use for payloads of a file; thread-safe. */
btf_status btfi_payload_chunk(btfi_payload *p, uint32_t i, btfi_chunk *out);
const char *btfi_payload_source_name(const btfi_payload *p); /* of the file it came from, NULL otherwise */
uint64_t btfi_payload_stored_bytes(const btfi_payload *p);   /* 0 unless it came from a file */
btf_chunk_writer *btfi_payload_writer(btfi_payload *p);      /* valid until the payload is sealed */
void btfi_payload_seal(btfi_payload *p);
btf_chunk_reader *btfi_payload_reader(btfi_payload *p); /* lives as long as the payload */

/* Host table entries. */
btf_status btfi_chunk_put(btf_chunk_writer *w, uint32_t tag, uint32_t index, uint32_t flags, const void *src,
                          uint64_t size);
btf_status btfi_chunk_reserve(btf_chunk_writer *w, uint32_t tag, uint32_t index, uint32_t flags,
                              uint64_t size, void **dst);
btf_status btfi_chunk_get(btf_chunk_reader *r, uint32_t tag, uint32_t index, const void **data,
                          uint64_t *size);
int32_t btfi_chunk_has(const btf_chunk_reader *r, uint32_t tag, uint32_t index);
void btfi_chunk_set_zstd_level(btf_chunk_writer *w, int32_t level);

btf_context *btfi_file_context(const btf_file *file);
/* The payload of model i: header parsed, chunks on demand. Keeps the byte source open. */
btf_status btfi_file_payload(const btf_file *file, uint32_t i, btfi_payload **out);
/* Appends a model's header and chunks. */
btf_status btfi_writer_payload(btf_writer *w, btfi_payload *p, const btf_job *job);

#endif
