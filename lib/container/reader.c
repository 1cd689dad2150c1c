/* SPDX-License-Identifier: MIT */
/* Opening a container: its structure, then the small chunks that describe its models. */
#include "container/reader.h"

#include <stdio.h>
#include <string.h>

/* ---- the small chunks ---- */

/* Reads one of them whole; `limit` bounds it further than the context does. */
static btf_status read_small(btf_file *f, const btfi_entry *e, uint64_t limit, void **data) {
  char name[BTFI_NAME_SIZE];
  const void *read;
  bool owned;
  btfi_entry copy = *e;
  *data = NULL;
  if (e->raw > limit)
    return btfi_fail(f->ctx, BTF_E_LIMIT, "%s: %s: %llu bytes; this type has at most %llu", f->source->name,
                     btfi_entry_name(e, name), (unsigned long long)e->raw, (unsigned long long)limit);
  BTFI_TRY(btfi_chunk_check_head(f->source, e));
  copy.flags &= ~BTFI_CHUNK_IN_PLACE; /* these are always verified, and freed here */
  BTFI_TRY(btfi_chunk_read(f->source, &copy, false, &read, &owned));
  *data = (void *)(uintptr_t)read;
  return BTF_OK;
}

static btf_status read_metadata(btf_file *f) {
  uint32_t first;
  const uint32_t count = btfi_file_range(f, BTFI_TYPE_METADATA, BTFI_NO_MODEL, &first);
  const btfi_entry *e;
  char name[BTFI_NAME_SIZE];
  void *data;
  btf_status status;
  if (count == 0) return BTF_OK;
  e = &f->entries[f->order[first]];
  if (count > 1 || e->index != 0)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: there may be one metadata chunk, of index 0",
                     f->source->name, btfi_entry_name(e, name));
  BTFI_TRY(read_small(f, e, BTFI_METADATA_LIMIT, &data));
  status = btfi_metadata_decode(&f->metadata, f->source->name, data, e->raw);
  btfi_free(f->ctx, data);
  return status;
}

static btf_status read_directions(btf_file *f) {
  uint32_t first;
  const uint32_t count = btfi_file_range(f, BTFI_TYPE_DIRECTIONS, BTFI_NO_MODEL, &first);
  const uint64_t most = (uint64_t)btfi_limits(f->ctx)->max_directions * 12;
  f->sets = btfi_calloc(f->ctx, count, sizeof *f->sets);
  if (f->sets == NULL) return btfi_alloc_status();
  f->set_count = count;
  for (uint32_t i = 0; i < count; i++) {
    const btfi_entry *e = &f->entries[f->order[first + i]];
    char name[BTFI_NAME_SIZE];
    void *data;
    float *xyz;
    btfi_cursor c;
    btf_status status;
    btfi_entry_name(e, name);
    if (e->index != i)
      return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: direction sets are numbered from 0 without gaps",
                       f->source->name, name);
    if (e->raw == 0 || e->raw % 12 != 0)
      return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: %llu bytes are no whole number of directions",
                       f->source->name, name, (unsigned long long)e->raw);
    BTFI_TRY(read_small(f, e, most, &data));
    xyz = btfi_alloc(f->ctx, e->raw / 4, sizeof *xyz);
    if (xyz == NULL) {
      btfi_free(f->ctx, data);
      return btfi_alloc_status();
    }
    c = (btfi_cursor){data, e->raw, 0, false};
    for (uint64_t k = 0; k < e->raw / 4; k++) xyz[k] = btfi_get_f32(&c);
    status = btf_dirset_create(f->ctx, xyz, (uint32_t)(e->raw / 12), &f->sets[i]);
    btfi_free(f->ctx, xyz);
    btfi_free(f->ctx, data);
    if (status == BTF_E_INVALID_ARG) {
      char reason[256];
      strncpy(reason, btf_error_message(), sizeof reason - 1);
      reason[sizeof reason - 1] = '\0';
      status = btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: %s", f->source->name, name, reason);
    }
    BTFI_TRY(status);
  }
  return BTF_OK;
}

/* ---- models ---- */

static uint64_t record_bytes(const btfi_entry *e) {
  return btfi_align(e->stored) + 2 * BTFI_ENTRY_SIZE;
}

/* Gives the payload chunks to their models, in the order of the file, which a copy of a model shall keep. */
static btf_status hand_out_payload(btf_file *f) {
  for (uint32_t i = 0; i < f->header.count; i++) {
    const btfi_entry *e = &f->entries[i];
    btfi_payload *p;
    btfi_slot *slot;
    if (e->type != BTFI_TYPE_PAYLOAD) continue;
    p = f->models[e->model];
    BTFI_TRY(btfi_payload_add(p, e->tag, e->index,
                              (e->flags & BTFI_CHUNK_IN_PLACE) != 0 ? BTF_PAYLOAD_IN_PLACE : 0, &slot));
    slot->size = e->raw;
    slot->entry = *e;
    p->stored_bytes += record_bytes(e);
  }
  return BTF_OK;
}

/* The texts of a model, as many as a data set may have: of the first all but the library's own. */
static btf_status take_notes(const btf_file *f, uint32_t model, btfi_model_header *h) {
  enum { MOST = 256 };
  const char *notes[2 * MOST + 1];
  uint32_t count = 0;
  for (uint32_t i = 0; i < f->metadata.count && count < 2 * MOST; i++) {
    const char *key;
    const uint32_t of = btfi_note_model_of(f->metadata.keys[i], &key);
    if (of != model || (of == 0 && strncmp(key, "btf.", 4) == 0)) continue;
    notes[count++] = key;
    notes[count++] = f->metadata.values[i];
  }
  notes[count] = NULL;
  return btfi_model_header_take_notes(f->ctx, notes, h);
}

static btf_status read_model(btf_file *f, const btfi_entry *e, btfi_payload *p) {
  uint32_t first;
  btfi_model_links links = {0, 0, 0};
  const uint32_t count = btfi_file_range(f, BTFI_TYPE_PAYLOAD, e->model, &first);
  char name[BTFI_NAME_SIZE], where[BTFI_NAME_SIZE + 256];
  btf_status status;
  void *data;
  snprintf(where, sizeof where, "%.255s: %s", f->source->name, btfi_entry_name(e, name));
  if (e->index != 0) return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: a model has one header, of index 0", where);
  BTFI_TRY(read_small(f, e, BTFI_MODEL_CHUNK_LIMIT, &data));
  status = btfi_model_header_decode(f->ctx, where, data, e->raw, f->sets, f->set_count, &p->header, &links);
  btfi_free(f->ctx, data);
  if (status == BTF_OK) status = take_notes(f, e->model, &p->header);
  BTFI_TRY(status);
  if (count != links.payload_chunks)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %u payload chunks, the header of the model says %u", where,
                     count, links.payload_chunks);
  p->source = btfi_source_retain(f->source);
  p->sealed = true;
  p->stored_bytes = record_bytes(e);
  btfi_file_range(f, BTFI_TYPE_DIRECTIONS, BTFI_NO_MODEL, &first);
  p->stored_bytes += record_bytes(&f->entries[f->order[first + links.light_set]]);
  if (links.view_set != links.light_set)
    p->stored_bytes += record_bytes(&f->entries[f->order[first + links.view_set]]);
  return BTF_OK;
}

static btf_status read_models(btf_file *f) {
  uint32_t count = 0;
  for (uint32_t i = 0; i < f->header.count; i++) count += f->entries[i].type == BTFI_TYPE_MODEL;
  f->models = btfi_calloc(f->ctx, count, sizeof *f->models);
  if (f->models == NULL) return btfi_alloc_status();
  for (uint32_t i = 0; i < f->header.count; i++) {
    const btfi_entry *e = &f->entries[i];
    char name[BTFI_NAME_SIZE];
    if (e->type == BTFI_TYPE_DIRECTIONS || e->type == BTFI_TYPE_METADATA || e->model < count) continue;
    if (!btfi_type_known(e->type) && e->model == BTFI_NO_MODEL) continue;
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: the file has %u models, numbered from 0",
                     f->source->name, btfi_entry_name(e, name), count);
  }
  for (uint32_t i = 0; i < count; i++) {
    uint32_t first;
    const uint32_t headers = btfi_file_range(f, BTFI_TYPE_MODEL, i, &first);
    if (headers != 1)
      return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: model %u has %u headers instead of one", f->source->name,
                       i, headers);
    BTFI_TRY(btfi_payload_new(f->ctx, &f->models[i]));
    f->model_count = i + 1;
    BTFI_TRY(read_model(f, &f->entries[f->order[first]], f->models[i]));
  }
  return hand_out_payload(f);
}

/* ---- opening and closing ---- */

static btf_status read_all(btf_file *f) {
  BTFI_TRY(btfi_read_structure(f));
  BTFI_TRY(read_metadata(f));
  BTFI_TRY(read_directions(f));
  return read_models(f);
}

btf_status btf_file_open(btf_context *ctx, const btf_io *io, uint32_t flags, btf_file **out) {
  btf_status status;
  btf_io checked;
  btf_file *f;
  if (out != NULL) *out = NULL;
  if (ctx == NULL || io == NULL || out == NULL)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_file_open: context, io and out must not be NULL");
  BTFI_TRY(btfi_io_copy(ctx, io, false, &checked));
  if ((flags & ~(uint32_t)BTF_OPEN_TRUST) != 0) {
    status = btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_file_open: unknown flags 0x%x", (unsigned)flags);
    goto close_io;
  }
  f = btfi_calloc(ctx, 1, sizeof *f);
  if (f == NULL) {
    status = btfi_alloc_status();
    goto close_io;
  }
  f->ctx = f->metadata.ctx = ctx;
  f->source = btfi_calloc(ctx, 1, sizeof *f->source);
  if (f->source != NULL) f->source->name = btfi_strdup(ctx, btfi_io_name(&checked));
  if (f->source == NULL || f->source->name == NULL) {
    status = btfi_alloc_status();
    btfi_free(ctx, f->source);
    btfi_free(ctx, f);
    goto close_io;
  }
  atomic_init(&f->source->references, 1);
  f->source->ctx = ctx;
  f->source->io = checked;
  f->source->io.name = f->source->name;
  f->source->trust = (flags & BTF_OPEN_TRUST) != 0;
  btfi_context_retain(ctx); /* the source's */
  btfi_context_retain(ctx); /* the file's */
  status = read_all(f);
  if (status != BTF_OK) {
    btf_file_close(f);
    return status;
  }
  *out = f;
  return BTF_OK;

close_io:
  btfi_io_close(ctx, &checked, false);
  return status;
}

btf_status btf_file_open_path(btf_context *ctx, const char *path, uint32_t flags, btf_file **out) {
  btf_io io = BTF_IO_INIT;
  if (out != NULL) *out = NULL;
  BTFI_TRY(btf_io_file(ctx, path, BTF_IO_READ, &io));
  return btf_file_open(ctx, &io, flags, out);
}

void btf_file_close(btf_file *f) {
  btf_context *ctx;
  if (f == NULL) return;
  ctx = f->ctx;
  for (uint32_t i = 0; i < f->model_count; i++) btfi_payload_release(f->models[i]);
  for (uint32_t i = 0; i < f->set_count; i++) btf_dirset_release(f->sets[i]);
  btfi_free(ctx, f->models);
  btfi_free(ctx, f->sets);
  btfi_metadata_free(&f->metadata);
  btfi_free(ctx, f->entries);
  btfi_free(ctx, f->order);
  btfi_source_release(f->source);
  btfi_free(ctx, f);
  btf_context_release(ctx);
}
