/* SPDX-License-Identifier: MIT */
/* Opening a container: header, directory and footer, then the small chunks that describe its models. */
#include "container/reader.h"

#include <stdio.h>
#include <string.h>

/* ---- the fixed structures ---- */

static btf_status read_header(btfi_source *s, int64_t size, btfi_header *header) {
  unsigned char bytes[BTFI_HEADER_SIZE];
  /* The signature alone first: a source of unknown size may be shorter than a header and of another kind. */
  const uint64_t first = size >= 0 && size < BTFI_HEADER_SIZE ? (uint64_t)size : 8;
  memset(bytes, 0, sizeof bytes);
  BTFI_TRY(btfi_io_read(s->ctx, &s->io, bytes, first, 0));
  if (first == 8) {
    btfi_header unused;
    if (size >= 0 && size < BTFI_HEADER_SIZE) return btfi_header_decode(s->ctx, s->name, bytes, first, &unused);
    if (bytes[0] == 0x93 || bytes[0] == 0x13)
      BTFI_TRY(btfi_io_read(s->ctx, &s->io, bytes + 8, sizeof bytes - 8, 8));
    return btfi_header_decode(s->ctx, s->name, bytes, sizeof bytes, header);
  }
  return btfi_header_decode(s->ctx, s->name, bytes, first, header);
}

static btf_status check_sizes(btfi_source *s, int64_t size, const btfi_header *h) {
  const btf_limits *limits = btfi_limits(s->ctx);
  uint64_t end;
  if (size >= 0 && (uint64_t)size < h->file_size)
    return btfi_fail(s->ctx, BTF_E_TRUNCATED, "%s: %lld bytes of %llu; the end is missing", s->name, (long long)size,
                     (unsigned long long)h->file_size);
  if (size >= 0 && (uint64_t)size > h->file_size)
    return btfi_fail(s->ctx, BTF_E_CORRUPT, "%s: %lld bytes, the header says %llu; something follows the end",
                     s->name, (long long)size, (unsigned long long)h->file_size);
  if (h->count > limits->max_chunks)
    return btfi_fail(s->ctx, BTF_E_LIMIT, "%s: %u chunks are over the limit of %u", s->name, h->count,
                     limits->max_chunks);
  if (h->directory_size != (uint64_t)h->count * BTFI_ENTRY_SIZE || h->directory_offset % BTFI_ALIGNMENT != 0 ||
      h->directory_offset < BTFI_HEADER_SIZE || !btfi_add(h->directory_offset, h->directory_size, &end) ||
      !btfi_add(end, BTFI_FOOTER_SIZE, &end) || end != h->file_size || end > INT64_MAX)
    return btfi_fail(s->ctx, BTF_E_CORRUPT,
                     "%s: the directory (offset %llu, %llu bytes, %u chunks) does not fit a file of %llu bytes",
                     s->name, (unsigned long long)h->directory_offset, (unsigned long long)h->directory_size,
                     h->count, (unsigned long long)h->file_size);
  return BTF_OK;
}

static btf_status check_footer(btfi_source *s, int64_t size, const btfi_header *h) {
  unsigned char expected[BTFI_FOOTER_SIZE], footer[BTFI_FOOTER_SIZE], beyond;
  BTFI_TRY(btfi_io_read(s->ctx, &s->io, footer, sizeof footer, h->file_size - BTFI_FOOTER_SIZE));
  btfi_footer_encode(h, expected);
  if (memcmp(footer, expected, sizeof footer) != 0)
    return btfi_fail(s->ctx, BTF_E_CORRUPT, "%s: the footer differs from the header; the file is damaged", s->name);
  if (size < 0 && s->io.read(s->io.user, &beyond, 1, h->file_size) > 0)
    return btfi_fail(s->ctx, BTF_E_CORRUPT, "%s: something follows the end at %llu bytes", s->name,
                     (unsigned long long)h->file_size);
  return BTF_OK;
}

/* ---- the directory ---- */

static btf_status check_entry(const btf_file *f, const btfi_entry *e, uint64_t previous_end) {
  const btfi_source *s = f->source;
  const bool known = btfi_type_known(e->type);
  char name[BTFI_NAME_SIZE];
  btfi_entry_name(e, name);
  /* Heads stand on the boundary after the chunk before, so this forbids overlaps, gaps and misalignment at once. */
  if (e->offset != btfi_align(previous_end) + BTFI_ENTRY_SIZE || e->offset > f->header.directory_offset ||
      e->stored > f->header.directory_offset - e->offset)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: its %llu bytes do not fit between its neighbours", s->name, name,
                     (unsigned long long)e->stored);
  if (!known && (e->flags & BTFI_CHUNK_CRITICAL) != 0)
    return btfi_fail(f->ctx, BTF_E_NEWER, "%s: %s: needed, and of a type this library does not know", s->name, name);
  if ((e->flags & BTFI_CHUNK_MUST_KNOW & ~BTFI_CHUNK_KNOWN) != 0 && known)
    return btfi_fail(f->ctx, BTF_E_NEWER, "%s: %s: has flags this library does not know (0x%x)", s->name, name,
                     e->flags);
  if (e->method > BTFI_METHOD_ZSTD && known)
    return btfi_fail(f->ctx, BTF_E_NEWER, "%s: %s: packed by method %u, which this library does not know", s->name,
                     name, e->method);
  if (e->method == BTFI_METHOD_RAW && e->stored != e->raw)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: not packed, yet %llu bytes stored and %llu unpacked", s->name,
                     name, (unsigned long long)e->stored, (unsigned long long)e->raw);
  if (known && (e->flags & BTFI_CHUNK_IN_PLACE) != 0 && e->method != BTFI_METHOD_RAW)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: packed, yet marked for use in place", s->name, name);
  if (known && e->type != BTFI_TYPE_PAYLOAD && e->tag != 0)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: this type has no tag", s->name, name);
  if ((e->type == BTFI_TYPE_DIRECTIONS || e->type == BTFI_TYPE_METADATA) && e->model != BTFI_NO_MODEL)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: this type belongs to the file", s->name, name);
  return BTF_OK;
}

static int compare(const btfi_entry *a, const btfi_entry *b) {
  if (a->type != b->type) return a->type < b->type ? -1 : 1;
  if (a->model != b->model) return a->model < b->model ? -1 : 1;
  if (a->tag != b->tag) return a->tag < b->tag ? -1 : 1;
  if (a->index != b->index) return a->index < b->index ? -1 : 1;
  return 0;
}

/* Heap sort: bounded time and no memory, whatever the file says. */
static void sort_entries(const btfi_entry *entries, uint32_t *order, uint32_t count) {
  for (uint32_t i = 0; i < count; i++) order[i] = i;
  for (uint32_t start = count / 2, end = count; end > 1;) {
    uint32_t root, value;
    if (start > 0) {
      value = order[--start];
    } else {
      value = order[--end];
      order[end] = order[0];
    }
    root = start;
    for (uint64_t child = 2 * (uint64_t)root + 1; child < end; child = 2 * (uint64_t)root + 1) {
      if (child + 1 < end && compare(&entries[order[child]], &entries[order[child + 1]]) < 0) child++;
      if (compare(&entries[value], &entries[order[child]]) >= 0) break;
      order[root] = order[child];
      root = (uint32_t)child;
    }
    order[root] = value;
  }
}

uint32_t btfi_file_range(const btf_file *file, uint32_t type, uint32_t model, uint32_t *first) {
  uint32_t bound[2];
  for (int upper = 0; upper < 2; upper++) {
    uint32_t low = 0, high = file->header.count;
    while (low < high) {
      const uint32_t middle = low + (high - low) / 2;
      const btfi_entry *e = &file->entries[file->order[middle]];
      const bool before = e->type != type ? e->type < type : upper ? e->model <= model : e->model < model;
      if (before) low = middle + 1;
      else high = middle;
    }
    bound[upper] = low;
  }
  *first = bound[0];
  return bound[1] - bound[0];
}

static btf_status read_directory(btf_file *f) {
  btfi_source *s = f->source;
  const uint32_t count = f->header.count;
  unsigned char *bytes = btfi_alloc(f->ctx, count, BTFI_ENTRY_SIZE);
  uint64_t end = BTFI_HEADER_SIZE;
  btf_status status;
  if (bytes == NULL) return btfi_alloc_status();
  status = btfi_io_read(f->ctx, &s->io, bytes, f->header.directory_size, f->header.directory_offset);
  if (status == BTF_OK && btfi_xxh64_of(bytes, (size_t)f->header.directory_size) != f->header.directory_checksum)
    status = btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: the checksum of the directory does not match; the file is damaged",
                       s->name);
  if (status == BTF_OK) {
    f->entries = btfi_alloc(f->ctx, count, sizeof *f->entries);
    f->order = f->entries != NULL ? btfi_alloc(f->ctx, count, sizeof *f->order) : NULL;
    if (f->order == NULL) status = btfi_alloc_status();
  }
  for (uint32_t i = 0; i < count && status == BTF_OK; i++) {
    btfi_entry *e = &f->entries[i];
    if (!btfi_entry_decode(bytes + (size_t)i * BTFI_ENTRY_SIZE, e))
      status = btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: directory entry %u: its checksum does not match", s->name, i);
    else
      status = check_entry(f, e, end);
    end = e->offset + e->stored;
  }
  btfi_free(f->ctx, bytes);
  BTFI_TRY(status);
  if (btfi_align(end) != f->header.directory_offset)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: bytes that belong to no chunk before the directory at offset %llu",
                     s->name, (unsigned long long)f->header.directory_offset);
  sort_entries(f->entries, f->order, count);
  for (uint32_t i = 1; i < count; i++)
    if (compare(&f->entries[f->order[i - 1]], &f->entries[f->order[i]]) == 0) {
      char name[BTFI_NAME_SIZE];
      return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: occurs twice", s->name,
                       btfi_entry_name(&f->entries[f->order[i]], name));
    }
  return BTF_OK;
}

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
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: there may be one metadata chunk, of index 0", f->source->name,
                     btfi_entry_name(e, name));
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

static uint64_t record_bytes(const btfi_entry *e) { return btfi_align(e->stored) + 2 * BTFI_ENTRY_SIZE; }

/* Payload chunks of model i, in the order of the file. */
static btf_status collect_payload(btf_file *f, btfi_payload *p, uint32_t first, uint32_t count) {
  btfi_slot *slot;
  /* `order` groups by name, while a copy of the model shall have its chunks as they stood. */
  uint32_t low = f->header.count, high = 0;
  for (uint32_t k = 0; k < count; k++) {
    low = BTFI_MIN(low, f->order[first + k]);
    high = BTFI_MAX(high, f->order[first + k]);
  }
  for (uint32_t k = low; k <= high && count != 0; k++) {
    const btfi_entry *e = &f->entries[k];
    if (e->type != BTFI_TYPE_PAYLOAD || e->model != f->entries[f->order[first]].model) continue;
    BTFI_TRY(btfi_payload_add(p, e->tag, e->index,
                              (e->flags & BTFI_CHUNK_IN_PLACE) != 0 ? BTF_PAYLOAD_IN_PLACE : 0, &slot));
    slot->size = e->raw;
    slot->entry = *e;
    p->stored_bytes += record_bytes(e);
  }
  return BTF_OK;
}

static btf_status read_model(btf_file *f, const btfi_entry *e, btfi_payload *p) {
  uint32_t first, expected = 0;
  const uint32_t count = btfi_file_range(f, BTFI_TYPE_PAYLOAD, e->model, &first);
  char name[BTFI_NAME_SIZE], where[BTFI_NAME_SIZE + 256];
  btf_status status;
  void *data;
  snprintf(where, sizeof where, "%.255s: %s", f->source->name, btfi_entry_name(e, name));
  if (e->index != 0) return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: a model has one header, of index 0", where);
  BTFI_TRY(read_small(f, e, BTFI_MODEL_CHUNK_LIMIT, &data));
  status = btfi_model_header_decode(f->ctx, where, data, e->raw, f->sets, f->set_count, &p->header, &expected);
  btfi_free(f->ctx, data);
  BTFI_TRY(status);
  if (count != expected)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %u payload chunks, the header of the model says %u", where, count,
                     expected);
  p->source = btfi_source_retain(f->source);
  p->sealed = true;
  p->stored_bytes = record_bytes(e);
  for (uint32_t i = 0, of_type = btfi_file_range(f, BTFI_TYPE_DIRECTIONS, BTFI_NO_MODEL, &first); i < of_type; i++)
    if (f->sets[i] == p->header.lights || f->sets[i] == p->header.views)
      p->stored_bytes += record_bytes(&f->entries[f->order[first + i]]);
  btfi_file_range(f, BTFI_TYPE_PAYLOAD, e->model, &first);
  return collect_payload(f, p, first, count);
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
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: the file has %u models, numbered from 0", f->source->name,
                     btfi_entry_name(e, name), count);
  }
  for (uint32_t i = 0; i < count; i++) {
    uint32_t first;
    const uint32_t headers = btfi_file_range(f, BTFI_TYPE_MODEL, i, &first);
    if (headers != 1)
      return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: model %u has %u headers instead of one", f->source->name, i,
                       headers);
    BTFI_TRY(btfi_payload_new(f->ctx, &f->models[i]));
    f->model_count = i + 1;
    BTFI_TRY(read_model(f, &f->entries[f->order[first]], f->models[i]));
  }
  return BTF_OK;
}

/* ---- opening and closing ---- */

static btf_status read_all(btf_file *f) {
  btfi_source *s = f->source;
  const int64_t size = s->io.size != NULL ? s->io.size(s->io.user) : -1;
  BTFI_TRY(read_header(s, size, &f->header));
  BTFI_TRY(check_sizes(s, size, &f->header));
  BTFI_TRY(check_footer(s, size, &f->header));
  BTFI_TRY(read_directory(f));
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

/* ---- queries ---- */

btf_context *btfi_file_context(const btf_file *file) { return file->ctx; }

btf_status btfi_file_payload(const btf_file *file, uint32_t i, btfi_payload **out) {
  *out = NULL;
  if (i >= file->model_count)
    return btfi_fail(file->ctx, BTF_E_INVALID_ARG, "%s: there is no model %u; the file has %u", file->source->name, i,
                     file->model_count);
  btfi_payload_retain(file->models[i]);
  *out = file->models[i];
  return BTF_OK;
}

uint32_t btf_file_model_count(const btf_file *file) { return file != NULL ? file->model_count : 0; }

const char *btf_file_model_codec(const btf_file *file, uint32_t i) {
  return file != NULL && i < file->model_count ? file->models[i]->header.codec_id : NULL;
}

btf_status btf_file_describe_model(const btf_file *file, uint32_t i, btf_model_info *io) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  const btfi_model_header *h;
  if (file == NULL || i >= file->model_count)
    return btfi_fail(file != NULL ? file->ctx : NULL, BTF_E_INVALID_ARG, "btf_file_describe_model: no model %u", i);
  h = &file->models[i]->header;
  info.codec_id = h->codec_id;
  info.color_space = h->color_space;
  info.lights = h->lights;
  info.views = h->views;
  info.stored_bytes = file->models[i]->stored_bytes;
  info.width = h->width;
  info.height = h->height;
  info.channels = h->channels;
  info.quantity = h->quantity;
  info.scale = h->scale;
  info.wrap = h->wrap;
  info.channel_names = (const char *const *)h->channel_names;
  info.name = h->name;
  info.source = h->source;
  info.license = h->license;
  info.texels_per_mm = h->texels_per_mm;
  return btfi_copy_out(file->ctx, "btf_model_info", io, sizeof(btf_model_info), &info, sizeof info);
}

const char *btf_file_metadata(const btf_file *file, const char *key) {
  return file != NULL ? btfi_metadata_find(&file->metadata, key) : NULL;
}

uint32_t btf_file_metadata_count(const btf_file *file) { return file != NULL ? file->metadata.count : 0; }

btf_status btf_file_metadata_at(const btf_file *file, uint32_t i, const char **key, const char **value) {
  if (key != NULL) *key = NULL;
  if (value != NULL) *value = NULL;
  if (file == NULL || i >= file->metadata.count)
    return btfi_fail(file != NULL ? file->ctx : NULL, BTF_E_INVALID_ARG, "btf_file_metadata_at: no pair %u", i);
  if (key != NULL) *key = file->metadata.keys[i];
  if (value != NULL) *value = file->metadata.values[i];
  return BTF_OK;
}

uint32_t btf_file_chunk_count(const btf_file *file) { return file != NULL ? file->header.count : 0; }

btf_status btf_file_chunk(const btf_file *file, uint32_t i, btf_chunk_info *io) {
  btf_chunk_info info;
  const btfi_entry *e;
  if (file == NULL || i >= file->header.count)
    return btfi_fail(file != NULL ? file->ctx : NULL, BTF_E_INVALID_ARG, "btf_file_chunk: no chunk %u", i);
  e = &file->entries[i];
  info = (btf_chunk_info){sizeof info, e->offset, e->stored, e->raw,   e->checksum, e->type,
                          e->tag,      e->index,  e->flags,  e->model, e->method};
  return btfi_copy_out(file->ctx, "btf_chunk_info", io, sizeof(btf_chunk_info), &info, sizeof info);
}
