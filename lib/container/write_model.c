/* SPDX-License-Identifier: MIT */
/* Appending a model: direction sets that are not there yet, header, and its chunks packed in parallel. */
#include "container/writer.h"

#include <string.h>
#include <zstd.h>
#include <zstd_errors.h>

enum { DEFAULT_LEVEL = 3, WAVE_CHUNKS = 64 };
/* Room for packed chunks of one wave; a single chunk may take more. */
#define WAVE_BYTES ((uint64_t)128 << 20)

typedef struct packing {
  btfi_chunk chunk;
  void *packed; /* NULL: stored as it is */
  uint64_t room;
  size_t stored; /* what zstd made of it, or its error code */
} packing;

typedef struct wave {
  packing items[WAVE_CHUNKS];
  uint32_t count;
  int level;
} wave;

static void pack(void *job, uint32_t index, uint32_t thread) {
  wave *w = job;
  packing *p = &w->items[index];
  (void)thread;
  if (p->packed != NULL)
    p->stored = ZSTD_compress(p->packed, (size_t)p->room, p->chunk.data, (size_t)p->chunk.size, w->level);
}

static btf_status write_packed(btf_writer *w, const packing *p) {
  btfi_entry e = {
      BTFI_TYPE_PAYLOAD, p->chunk.tag, p->chunk.index, 0, w->model_count, BTFI_METHOD_RAW, 0, 0, 0, 0};
  if ((p->chunk.flags & BTF_PAYLOAD_IN_PLACE) != 0) e.flags |= BTFI_CHUNK_IN_PLACE;
  if (p->packed != NULL && ZSTD_isError(p->stored) &&
      ZSTD_getErrorCode(p->stored) == ZSTD_error_memory_allocation)
    return btfi_fail(w->ctx, BTF_E_NOMEM, "%s: no memory to pack a chunk", w->name);
  if (p->packed == NULL || ZSTD_isError(p->stored) || p->stored >= p->chunk.size)
    return btfi_writer_raw_chunk(w, &e, p->chunk.data, p->chunk.size);
  e.method = BTFI_METHOD_ZSTD;
  e.raw = p->chunk.size;
  e.stored = p->stored;
  e.checksum = btfi_xxh64_of(p->packed, p->stored);
  BTFI_TRY(btfi_writer_head(w, &e));
  return btfi_writer_bytes(w, p->packed, e.stored);
}

/* Takes chunks from `first` on as long as the packed ones fit the budget. */
static btf_status gather(btf_writer *w, btfi_payload *p, uint32_t first, wave *out) {
  const uint32_t all = btfi_payload_chunk_count(p);
  uint64_t bytes = 0;
  for (uint32_t i = first; i < all && out->count < WAVE_CHUNKS; i++) {
    packing *item = &out->items[out->count];
    uint64_t room = 0;
    memset(item, 0, sizeof *item);
    BTFI_TRY(btfi_payload_chunk(p, i, &item->chunk));
    if ((item->chunk.flags & BTF_PAYLOAD_IN_PLACE) == 0 && item->chunk.size != 0)
      room = ZSTD_compressBound((size_t)item->chunk.size);
    if (out->count != 0 && bytes + room > WAVE_BYTES) break;
    bytes += room;
    out->count++;
    if (room == 0) continue;
    item->room = room;
    item->packed = btfi_alloc(w->ctx, room, 1);
    if (item->packed == NULL) return btfi_alloc_status();
  }
  return BTF_OK;
}

static btf_status write_wave(btf_writer *w, btfi_payload *p, uint32_t first, wave *scratch) {
  btf_status status = gather(w, p, first, scratch);
  if (status == BTF_OK) status = btfi_parallel(w->ctx, scratch->count, pack, scratch);
  for (uint32_t i = 0; i < scratch->count; i++) {
    if (status == BTF_OK) status = write_packed(w, &scratch->items[i]);
    btfi_free(w->ctx, scratch->items[i].packed);
  }
  return status;
}

static btf_status write_set(btf_writer *w, const btf_dirset *set, uint32_t *number) {
  btfi_entry e = {BTFI_TYPE_DIRECTIONS, 0, 0, 0, BTFI_NO_MODEL, 0, 0, 0, 0, 0};
  btfi_buffer bytes;
  btf_status status;
  bool is_new;
  BTFI_TRY(btfi_writer_set_number(w, set, number, &is_new));
  if (!is_new) return BTF_OK;
  e.index = *number;
  btfi_buffer_init(&bytes, w->ctx);
  for (uint32_t i = 0; i < 3 * btf_dirset_count(set); i++)
    btfi_put_f32(&bytes, btf_dirset_directions(set)[i]);
  status = bytes.status;
  if (status == BTF_OK) status = btfi_writer_raw_chunk(w, &e, bytes.data, bytes.size);
  btfi_buffer_free(&bytes);
  return status;
}

static btf_status write_header(btf_writer *w, const btfi_payload *p) {
  btfi_entry e = {BTFI_TYPE_MODEL, 0, 0, 0, w->model_count, 0, 0, 0, 0, 0};
  const btfi_model_header *h = btfi_payload_header(p);
  btfi_model_links links = {0, 0, btfi_payload_chunk_count(p)};
  btfi_buffer bytes;
  btf_status status;
  BTFI_TRY(write_set(w, h->lights, &links.light_set));
  BTFI_TRY(write_set(w, h->views, &links.view_set));
  btfi_buffer_init(&bytes, w->ctx);
  btfi_model_header_encode(h, &links, &bytes);
  status = bytes.status;
  if (status == BTF_OK && bytes.size > BTFI_MODEL_CHUNK_LIMIT)
    status =
        btfi_fail(w->ctx, BTF_E_LIMIT, "%s: the texts of the model take %llu bytes; at most %u are stored",
                  w->name, (unsigned long long)bytes.size, BTFI_MODEL_CHUNK_LIMIT);
  if (status == BTF_OK) status = btfi_writer_raw_chunk(w, &e, bytes.data, bytes.size);
  btfi_buffer_free(&bytes);
  return status;
}

static btf_status write_chunks(btf_writer *w, btfi_payload *p, const btf_job *job) {
  const uint32_t count = btfi_payload_chunk_count(p);
  int32_t level = w->zstd_level != 0 ? w->zstd_level : p->zstd_level;
  btf_status status = BTF_OK;
  wave *scratch = btfi_alloc(w->ctx, 1, sizeof *scratch);
  if (scratch == NULL) return btfi_alloc_status();
  level = level != 0 ? level : DEFAULT_LEVEL;
  scratch->level = BTFI_MAX(1, BTFI_MIN(level, 22));
  for (uint32_t first = 0; first < count && status == BTF_OK; first += scratch->count) {
    scratch->count = 0;
    status = btfi_progress(job, (double)first / (double)count, "write");
    if (status == BTF_OK) status = write_wave(w, p, first, scratch);
  }
  btfi_free(w->ctx, scratch);
  if (status == BTF_OK) status = btfi_progress(job, 1.0, "write");
  return status;
}

/* What the caller set himself stays. */
static btf_status write_notes(btf_writer *w, const btfi_model_header *h) {
  char key[256];
  for (uint32_t i = 0; h->notes != NULL && h->notes[i] != NULL; i += 2)
    if (strncmp(h->notes[i], "btf.", 4) != 0 && btfi_note_key_put(w->model_count, h->notes[i], key) &&
        btfi_metadata_find(&w->metadata, key) == NULL)
      BTFI_TRY(btfi_metadata_set(&w->metadata, key, h->notes[i + 1]));
  return BTF_OK;
}

btf_status btfi_writer_payload(btf_writer *w, btfi_payload *p, const btf_job *job) {
  btf_status status;
  if (w->status != BTF_OK)
    return btfi_fail(w->ctx, w->status, "%s: an earlier step of writing failed; nothing will be kept",
                     w->name);
  status = write_header(w, p);
  if (status == BTF_OK) status = write_chunks(w, p, job);
  if (status == BTF_OK) status = write_notes(w, btfi_payload_header(p));
  if (status != BTF_OK) return btfi_writer_fail(w, status);
  w->model_count++;
  return BTF_OK;
}
