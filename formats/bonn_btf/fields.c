/* SPDX-License-Identifier: MIT */
/* fields.c: the uncompressed reflectance fields of BDI. */
#include "bonn_btf/bonn_btf.h"

enum { FULL = 0, BZIP2 = 1, SPARSE = 2 };

/* Texels of one chunk that are there. */
static uint64_t count_present(const unsigned char *mask, uint64_t from, uint64_t to, uint32_t *rank) {
  uint32_t present = 0;
  for (uint64_t i = from; i < to; i++) rank[i] = mask[i] != 0 ? present++ : UINT32_MAX;
  return present;
}

btf_status bonn_parse_fields(bonn_file *bonn, cursor *c) {
  const btf_host *host = bonn->file.host;
  bonn_fields *fields = &bonn->fields;
  const uint64_t texels = (uint64_t)bonn->width * bonn->height;
  const uint64_t field_bytes = 2 * bonn->channels * bonn->pairs;
  fields->chunk_rows = cursor_u32(c);
  const uint8_t compression = cursor_u8(c);
  const unsigned char *mask = cursor_take(c, texels, 1);
  bonn->rotations = cursor_u32(c);
  cursor_take(c, bonn->rotations, 36);
  if (c->ended) return bonn_truncated(bonn, "the head of the samples");
  if (compression == BZIP2)
    return (host->fail)(bonn->file.ctx, BTF_E_UNSUPPORTED, "%s: its samples are packed with bzip2",
                        bonn->file.path);
  if (compression != FULL && compression != SPARSE)
    return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: compression %u is unknown", bonn->file.path,
                        (unsigned)compression);
  if (fields->chunk_rows < 1)
    return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: chunks of no rows", bonn->file.path);
  if (fields->chunk_rows > bonn->height) fields->chunk_rows = bonn->height;
  const uint32_t chunks = (bonn->height - 1) / fields->chunk_rows + 1;
  fields->chunks = (host->alloc)(bonn->file.ctx, chunks, sizeof *fields->chunks);
  if (fields->chunks == NULL) return BTF_E_NOMEM;
  if (compression == SPARSE) {
    fields->rank = (host->alloc)(bonn->file.ctx, texels, sizeof *fields->rank);
    if (fields->rank == NULL) return BTF_E_NOMEM;
  }
  for (uint32_t i = 0; i < chunks; i++) {
    const uint64_t from = (uint64_t)i * fields->chunk_rows * bonn->width;
    const uint64_t whole = from + (uint64_t)fields->chunk_rows * bonn->width,
                   to = whole < texels ? whole : texels;
    const uint64_t present = fields->rank != NULL ? count_present(mask, from, to, fields->rank) : to - from;
    const uint32_t bytes = cursor_u32(c);
    fields->chunks[i] = cursor_take(c, present, field_bytes);
    if (c->ended) return bonn_truncated(bonn, "the samples");
    if (bytes != present * field_bytes)
      return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: chunk %u has %u bytes; expected %llu",
                          bonn->file.path, (unsigned)i, (unsigned)bytes,
                          (unsigned long long)(present * field_bytes));
  }
  if (cursor_left(c) != 0)
    return (host->fail)(bonn->file.ctx, BTF_E_CORRUPT, "%s: %llu bytes follow the last chunk",
                        bonn->file.path, (unsigned long long)cursor_left(c));
  return BTF_OK;
}
