/* SPDX-License-Identifier: MIT */
/* Copying containers: stored bytes move as they are, only the numbers of models and direction sets may
 * change. */
#include "container/reader.h"
#include "container/writer.h"

#include <string.h>

#define PIECE ((uint64_t)1 << 20)

typedef struct copying {
  btf_writer *w;
  const btf_file *file;
  uint32_t first_model;
  uint32_t *sets;        /* numbers in the copy of the file's sets */
  unsigned char *buffer; /* PIECE bytes */
} copying;

static btf_status copy_stored(const copying *c, const btfi_entry *from) {
  btfi_source *s = c->file->source;
  btfi_entry e = *from;
  btfi_xxh64 sum;
  char name[BTFI_NAME_SIZE];
  if (e.model != BTFI_NO_MODEL) e.model += c->first_model;
  if (e.type == BTFI_TYPE_DIRECTIONS) e.index = c->sets[from->index];
  if (!btfi_type_known(e.type))
    for (uint32_t i = 0; i < c->w->entry_count; i++) {
      const btfi_entry *other = &c->w->entries[i];
      if (other->type == e.type && other->model == e.model && other->tag == e.tag && other->index == e.index)
        return btfi_fail(c->w->ctx, BTF_E_STATE, "%s: %s: the copy already holds a chunk of this name",
                         s->name, btfi_entry_name(from, name));
    }
  BTFI_TRY(btfi_chunk_check_head(s, from));
  BTFI_TRY(btfi_writer_head(c->w, &e));
  btfi_xxh64_init(&sum, 0);
  for (uint64_t done = 0; done < e.stored;) {
    const uint64_t n = BTFI_MIN(e.stored - done, PIECE);
    BTFI_TRY(btfi_io_read(c->w->ctx, &s->io, c->buffer, n, from->offset + done));
    btfi_xxh64_update(&sum, c->buffer, (size_t)n);
    BTFI_TRY(btfi_writer_bytes(c->w, c->buffer, n));
    done += n;
  }
  if (btfi_xxh64_digest(&sum) != from->checksum)
    return btfi_fail(c->w->ctx, BTF_E_CORRUPT, "%s: %s: the checksum does not match; the file is damaged",
                     s->name, btfi_entry_name(from, name));
  return BTF_OK;
}

static btf_status write_renumbered(const copying *c, btfi_entry *e, unsigned char *data) {
  static const uint32_t places[2] = {BTFI_MODEL_LIGHT_SET, BTFI_MODEL_VIEW_SET};
  for (int k = 0; k < 2; k++) {
    unsigned char *p = data + places[k];
    const uint32_t old = p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
    const uint32_t number = c->sets[old]; /* opening the file has checked its range */
    for (int b = 0; b < 4; b++) p[b] = (unsigned char)(number >> 8 * b);
  }
  e->model += c->first_model;
  return btfi_writer_raw_chunk(c->w, e, data, e->raw);
}

/* A model's header names its direction sets by number; all else in it is kept, also what a later version
 * added. */
static btf_status copy_header(const copying *c, const btfi_entry *from) {
  btfi_entry e = *from;
  const void *data;
  bool owned;
  btf_status status;
  e.flags &= ~BTFI_CHUNK_IN_PLACE;
  BTFI_TRY(btfi_chunk_check_head(c->file->source, from));
  BTFI_TRY(btfi_chunk_read(c->file->source, &e, false, &data, &owned));
  e.flags = from->flags;
  status = write_renumbered(c, &e, (unsigned char *)(uintptr_t)data);
  btfi_free(c->file->ctx, (void *)(uintptr_t)data);
  return status;
}

static btf_status copy_sets(const copying *c) {
  uint32_t first;
  const uint32_t count = btfi_file_range(c->file, BTFI_TYPE_DIRECTIONS, BTFI_NO_MODEL, &first);
  for (uint32_t i = 0; i < count; i++) {
    bool is_new;
    BTFI_TRY(btfi_writer_set_number(c->w, c->file->sets[i], &c->sets[i], &is_new));
    if (is_new) BTFI_TRY(copy_stored(c, &c->file->entries[c->file->order[first + i]]));
  }
  return BTF_OK;
}

/* Notes go with their models. What the caller set himself stays. */
static btf_status copy_metadata(const copying *c) {
  const btfi_metadata *m = &c->file->metadata;
  for (uint32_t i = 0; i < m->count; i++) {
    const char *rest;
    char key[256];
    const uint32_t of = btfi_note_model_of(m->keys[i], &rest);
    const bool is_note = c->file->model_count > 0 && (of != 0 || strncmp(rest, "btf.", 4) != 0);
    if (!btfi_note_key_put(is_note ? c->first_model + of : 0, is_note ? rest : m->keys[i], key)) continue;
    if (btfi_metadata_find(&c->w->metadata, key) == NULL)
      BTFI_TRY(btfi_metadata_set(&c->w->metadata, key, m->values[i]));
  }
  return BTF_OK;
}

static btf_status copy_all(const copying *c) {
  const btf_file *f = c->file;
  bool renumbered = c->first_model != 0;
  BTFI_TRY(copy_sets(c));
  for (uint32_t i = 0; i < f->set_count; i++) renumbered = renumbered || c->sets[i] != i;
  for (uint32_t i = 0; i < f->header.count; i++) {
    const btfi_entry *e = &f->entries[i];
    if (e->type == BTFI_TYPE_DIRECTIONS || e->type == BTFI_TYPE_METADATA) continue;
    if (e->type == BTFI_TYPE_MODEL && renumbered)
      BTFI_TRY(copy_header(c, e));
    else
      BTFI_TRY(copy_stored(c, e));
  }
  BTFI_TRY(copy_metadata(c));
  c->w->optional_features |= f->header.optional;
  c->w->model_count += f->model_count;
  return BTF_OK;
}

btf_status btf_writer_copy(btf_writer *w, const btf_file *file) {
  copying c = {w, file, 0, NULL, NULL};
  btf_status status;
  if (w == NULL || file == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_writer_copy: writer and file must not be NULL");
  if (w->status != BTF_OK)
    return btfi_fail(w->ctx, w->status, "%s: an earlier step of writing failed; nothing will be kept",
                     w->name);
  c.first_model = w->model_count;
  c.sets = btfi_alloc(w->ctx, file->set_count, sizeof *c.sets);
  c.buffer = c.sets != NULL ? btfi_alloc(w->ctx, PIECE, 1) : NULL;
  status = c.buffer != NULL ? copy_all(&c) : btfi_alloc_status();
  btfi_free(w->ctx, c.sets);
  btfi_free(w->ctx, c.buffer);
  return status == BTF_OK ? BTF_OK : btfi_writer_fail(w, status);
}
