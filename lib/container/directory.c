/* SPDX-License-Identifier: MIT */
/* The fixed structures of a container being opened: header, footer and directory, checked in the order of
 * docs/format.md. */
#include "container/reader.h"

#include <string.h>

static btf_status read_header(btfi_source *s, int64_t size, btfi_header *header) {
  unsigned char bytes[BTFI_HEADER_SIZE];
  /* The signature alone first: a source of unknown size may be shorter than a header and of another kind. */
  const uint64_t first = size >= 0 && size < BTFI_HEADER_SIZE ? (uint64_t)size : 8;
  memset(bytes, 0, sizeof bytes);
  BTFI_TRY(btfi_io_read(s->ctx, &s->io, bytes, first, 0));
  if (first == 8) {
    btfi_header unused;
    if (size >= 0 && size < BTFI_HEADER_SIZE)
      return btfi_header_decode(s->ctx, s->name, bytes, first, &unused);
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
    return btfi_fail(s->ctx, BTF_E_TRUNCATED, "%s: %lld bytes of %llu; the end is missing", s->name,
                     (long long)size, (unsigned long long)h->file_size);
  if (size >= 0 && (uint64_t)size > h->file_size)
    return btfi_fail(s->ctx, BTF_E_CORRUPT, "%s: %lld bytes, the header says %llu; something follows the end",
                     s->name, (long long)size, (unsigned long long)h->file_size);
  if (h->count > limits->max_chunks)
    return btfi_fail(s->ctx, BTF_E_LIMIT, "%s: %u chunks are over the limit of %u", s->name, h->count,
                     limits->max_chunks);
  if (h->directory_size != (uint64_t)h->count * BTFI_ENTRY_SIZE ||
      h->directory_offset % BTFI_ALIGNMENT != 0 || h->directory_offset < BTFI_HEADER_SIZE ||
      !btfi_add(h->directory_offset, h->directory_size, &end) || !btfi_add(end, BTFI_FOOTER_SIZE, &end) ||
      end != h->file_size || end > INT64_MAX)
    return btfi_fail(
        s->ctx, BTF_E_CORRUPT,
        "%s: the directory (offset %llu, %llu bytes, %u chunks) does not fit a file of %llu bytes", s->name,
        (unsigned long long)h->directory_offset, (unsigned long long)h->directory_size, h->count,
        (unsigned long long)h->file_size);
  return BTF_OK;
}

static btf_status check_footer(btfi_source *s, int64_t size, const btfi_header *h) {
  unsigned char expected[BTFI_FOOTER_SIZE], footer[BTFI_FOOTER_SIZE], beyond;
  BTFI_TRY(btfi_io_read(s->ctx, &s->io, footer, sizeof footer, h->file_size - BTFI_FOOTER_SIZE));
  btfi_footer_encode(h, expected);
  if (memcmp(footer, expected, sizeof footer) != 0)
    return btfi_fail(s->ctx, BTF_E_CORRUPT, "%s: the footer differs from the header; the file is damaged",
                     s->name);
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
  /* Heads stand on the boundary after the chunk before, so this forbids overlaps, gaps and misalignment at
   * once. */
  if (e->offset != btfi_align(previous_end) + BTFI_ENTRY_SIZE || e->offset > f->header.directory_offset ||
      e->stored > f->header.directory_offset - e->offset)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: its %llu bytes do not fit between its neighbours",
                     s->name, name, (unsigned long long)e->stored);
  if (!known && (e->flags & BTFI_CHUNK_CRITICAL) != 0)
    return btfi_fail(f->ctx, BTF_E_NEWER, "%s: %s: needed, and of a type this library does not know", s->name,
                     name);
  if ((e->flags & BTFI_CHUNK_MUST_KNOW & ~BTFI_CHUNK_KNOWN) != 0 && known)
    return btfi_fail(f->ctx, BTF_E_NEWER, "%s: %s: has flags this library does not know (0x%x)", s->name,
                     name, e->flags);
  if (e->method > BTFI_METHOD_ZSTD && known)
    return btfi_fail(f->ctx, BTF_E_NEWER, "%s: %s: packed by method %u, which this library does not know",
                     s->name, name, e->method);
  if (e->method == BTFI_METHOD_RAW && e->stored != e->raw)
    return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: not packed, yet %llu bytes stored and %llu unpacked",
                     s->name, name, (unsigned long long)e->stored, (unsigned long long)e->raw);
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
      if (before)
        low = middle + 1;
      else
        high = middle;
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
  if (status == BTF_OK &&
      btfi_xxh64_of(bytes, (size_t)f->header.directory_size) != f->header.directory_checksum)
    status = btfi_fail(f->ctx, BTF_E_CORRUPT,
                       "%s: the checksum of the directory does not match; the file is damaged", s->name);
  if (status == BTF_OK) {
    f->entries = btfi_alloc(f->ctx, count, sizeof *f->entries);
    f->order = f->entries != NULL ? btfi_alloc(f->ctx, count, sizeof *f->order) : NULL;
    if (f->order == NULL) status = btfi_alloc_status();
  }
  for (uint32_t i = 0; i < count && status == BTF_OK; i++) {
    btfi_entry *e = &f->entries[i];
    if (!btfi_entry_decode(bytes + (size_t)i * BTFI_ENTRY_SIZE, e))
      status =
          btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: directory entry %u: its checksum does not match", s->name, i);
    else
      status = check_entry(f, e, end);
    end = e->offset + e->stored;
  }
  btfi_free(f->ctx, bytes);
  BTFI_TRY(status);
  if (btfi_align(end) != f->header.directory_offset)
    return btfi_fail(f->ctx, BTF_E_CORRUPT,
                     "%s: bytes that belong to no chunk before the directory at offset %llu", s->name,
                     (unsigned long long)f->header.directory_offset);
  sort_entries(f->entries, f->order, count);
  for (uint32_t i = 1; i < count; i++)
    if (compare(&f->entries[f->order[i - 1]], &f->entries[f->order[i]]) == 0) {
      char name[BTFI_NAME_SIZE];
      return btfi_fail(f->ctx, BTF_E_CORRUPT, "%s: %s: occurs twice", s->name,
                       btfi_entry_name(&f->entries[f->order[i]], name));
    }
  return BTF_OK;
}

btf_status btfi_read_structure(btf_file *f) {
  btfi_source *s = f->source;
  const int64_t size = s->io.size != NULL ? s->io.size(s->io.user) : -1;
  BTFI_TRY(read_header(s, size, &f->header));
  BTFI_TRY(check_sizes(s, size, &f->header));
  BTFI_TRY(check_footer(s, size, &f->header));
  return read_directory(f);
}
