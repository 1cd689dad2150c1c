/* SPDX-License-Identifier: MIT */
/* Writing a container front to back: header of zeros, chunks, directory, footer, and at last the header. */
#include "container/writer.h"

#include <stdio.h>
#include <string.h>

btf_status btfi_writer_fail(btf_writer *w, btf_status status) {
  if (w->status == BTF_OK) w->status = status;
  return status;
}

static btf_status refuse_after_failure(btf_writer *w) {
  return btfi_fail(w->ctx, w->status, "%s: an earlier step of writing failed; nothing will be kept", w->name);
}

static void destroy(btf_writer *w) {
  btf_context *ctx = w->ctx;
  for (uint32_t i = 0; i < w->set_count; i++) btf_dirset_release(w->sets[i]);
  btfi_free(ctx, w->sets);
  btfi_free(ctx, w->entries);
  btfi_metadata_free(&w->metadata);
  btfi_free(ctx, w->name);
  btfi_free(ctx, w);
  btf_context_release(ctx);
}

btf_status btfi_writer_bytes(btf_writer *w, const void *src, uint64_t size) {
  if (size != 0) BTFI_TRY(btfi_io_write(w->ctx, &w->io, src, size, w->position));
  w->position += size;
  return BTF_OK;
}

/* Zeros up to the next boundary. */
static btf_status pad(btf_writer *w) {
  static const unsigned char zeros[BTFI_ALIGNMENT];
  return btfi_writer_bytes(w, zeros, btfi_align(w->position) - w->position);
}

static btf_status grow(btf_context *ctx, void **array, uint32_t count, uint32_t *capacity, size_t size) {
  const uint32_t larger = *capacity != 0 ? 2 * *capacity : 16;
  void *copy;
  if (count < *capacity) return BTF_OK;
  copy = btfi_alloc(ctx, larger, size);
  if (copy == NULL) return btfi_alloc_status();
  if (count != 0) memcpy(copy, *array, count * size);
  btfi_free(ctx, *array);
  *array = copy;
  *capacity = larger;
  return BTF_OK;
}

btf_status btfi_writer_head(btf_writer *w, btfi_entry *e) {
  unsigned char bytes[BTFI_ENTRY_SIZE];
  void *entries = w->entries;
  if (w->entry_count >= btfi_limits(w->ctx)->max_chunks)
    return btfi_fail(w->ctx, BTF_E_LIMIT, "%s: the limit of %u chunks is reached", w->name,
                     btfi_limits(w->ctx)->max_chunks);
  BTFI_TRY(grow(w->ctx, &entries, w->entry_count, &w->entry_capacity, sizeof *w->entries));
  w->entries = entries;
  e->offset = btfi_align(w->position) + BTFI_ENTRY_SIZE;
  BTFI_TRY(pad(w));
  btfi_entry_encode(e, bytes);
  BTFI_TRY(btfi_writer_bytes(w, bytes, sizeof bytes));
  w->entries[w->entry_count++] = *e;
  return BTF_OK;
}

btf_status btfi_writer_raw_chunk(btf_writer *w, btfi_entry *e, const void *data, uint64_t size) {
  e->method = BTFI_METHOD_RAW;
  e->stored = e->raw = size;
  e->checksum = btfi_xxh64_of(data, (size_t)size);
  BTFI_TRY(btfi_writer_head(w, e));
  return btfi_writer_bytes(w, data, size);
}

btf_status btfi_writer_set_number(btf_writer *w, const btf_dirset *set, uint32_t *number, bool *is_new) {
  void *sets = w->sets;
  *is_new = false;
  for (*number = 0; *number < w->set_count; ++*number)
    if (btfi_dirset_equal(w->sets[*number], set)) return BTF_OK;
  BTFI_TRY(grow(w->ctx, &sets, w->set_count, &w->set_capacity, sizeof *w->sets));
  w->sets = sets;
  w->sets[w->set_count++] = btf_dirset_retain(set);
  *is_new = true;
  return BTF_OK;
}

btf_status btf_writer_open(btf_context *ctx, const btf_io *io, int32_t zstd_level, btf_writer **out) {
  unsigned char bytes[BTFI_HEADER_SIZE];
  btfi_header unfinished = {BTFI_FORMAT_MAJOR, BTFI_FORMAT_MINOR, 0, 0, 0, 0, 0, 0, 0};
  btf_status status = BTF_OK;
  btf_writer *w = NULL;
  btf_io checked;
  if (out != NULL) *out = NULL;
  if (ctx == NULL || io == NULL || out == NULL)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_writer_open: context, io and out must not be NULL");
  BTFI_TRY(btfi_io_copy(ctx, io, true, &checked));
  if (zstd_level < 0 || zstd_level > 22)
    status =
        btfi_fail(ctx, BTF_E_INVALID_ARG, "zstd level: %d is outside 1 to 22 (0 = default)", (int)zstd_level);
  if (status == BTF_OK && (w = btfi_calloc(ctx, 1, sizeof *w)) == NULL) status = btfi_alloc_status();
  if (status == BTF_OK && (w->name = btfi_strdup(ctx, btfi_io_name(&checked))) == NULL)
    status = btfi_alloc_status();
  if (status != BTF_OK) {
    btfi_free(ctx, w);
    btfi_io_close(ctx, &checked, true);
    return status;
  }
  w->ctx = w->metadata.ctx = ctx;
  btfi_context_retain(ctx);
  w->io = checked;
  w->io.name = w->name;
  w->zstd_level = zstd_level;
  /* A directory at 0 says that writing was never finished. */
  btfi_header_encode(&unfinished, bytes);
  status = btfi_writer_bytes(w, bytes, sizeof bytes);
  if (status != BTF_OK) {
    btf_writer_abort(w);
    return status;
  }
  *out = w;
  return BTF_OK;
}

btf_status btf_writer_metadata(btf_writer *w, const char *key, const char *value) {
  if (w == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_writer_metadata: the writer must not be NULL");
  if (w->status != BTF_OK) return refuse_after_failure(w);
  return btfi_metadata_set(&w->metadata, key, value);
}

static btf_status write_metadata(btf_writer *w) {
  btfi_entry e = {BTFI_TYPE_METADATA, 0, 0, 0, BTFI_NO_MODEL, 0, 0, 0, 0, 0};
  btfi_buffer bytes;
  btf_status status;
  char writer[32];
  snprintf(writer, sizeof writer, "libbtf %d.%d.%d", LIBBTF_VERSION_MAJOR, LIBBTF_VERSION_MINOR,
           LIBBTF_VERSION_PATCH);
  BTFI_TRY(btfi_metadata_set(&w->metadata, "btf.writer", writer));
  btfi_buffer_init(&bytes, w->ctx);
  btfi_metadata_encode(&w->metadata, &bytes);
  status = bytes.status;
  if (status == BTF_OK && bytes.size > BTFI_METADATA_LIMIT)
    status = btfi_fail(w->ctx, BTF_E_LIMIT, "%s: %llu bytes of metadata are over the limit of %u", w->name,
                       (unsigned long long)bytes.size, BTFI_METADATA_LIMIT);
  if (status == BTF_OK) status = btfi_writer_raw_chunk(w, &e, bytes.data, bytes.size);
  btfi_buffer_free(&bytes);
  return status;
}

static btf_status write_end(btf_writer *w) {
  btfi_header header = {
      BTFI_FORMAT_MAJOR, BTFI_FORMAT_MINOR, 0, w->optional_features, w->entry_count, 0, 0, 0, 0};
  unsigned char *directory, bytes[BTFI_HEADER_SIZE], footer[BTFI_FOOTER_SIZE];
  btf_status status;
  BTFI_TRY(pad(w));
  header.directory_offset = w->position;
  header.directory_size = (uint64_t)w->entry_count * BTFI_ENTRY_SIZE;
  header.file_size = header.directory_offset + header.directory_size + BTFI_FOOTER_SIZE;
  directory = btfi_alloc(w->ctx, w->entry_count, BTFI_ENTRY_SIZE);
  if (directory == NULL) return btfi_alloc_status();
  for (uint32_t i = 0; i < w->entry_count; i++)
    btfi_entry_encode(&w->entries[i], directory + (size_t)i * BTFI_ENTRY_SIZE);
  header.directory_checksum = btfi_xxh64_of(directory, (size_t)header.directory_size);
  status = btfi_writer_bytes(w, directory, header.directory_size);
  btfi_free(w->ctx, directory);
  BTFI_TRY(status);
  btfi_footer_encode(&header, footer);
  BTFI_TRY(btfi_writer_bytes(w, footer, sizeof footer));
  btfi_header_encode(&header, bytes);
  return btfi_io_write(w->ctx, &w->io, bytes, sizeof bytes, 0);
}

btf_status btf_writer_finish(btf_writer *w) {
  btf_status status;
  if (w == NULL) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_writer_finish: the writer must not be NULL");
  status = w->status != BTF_OK ? refuse_after_failure(w) : write_metadata(w);
  if (status == BTF_OK) status = write_end(w);
  if (status == BTF_OK)
    status = btfi_io_close(w->ctx, &w->io, false);
  else
    btfi_io_close(w->ctx, &w->io, true);
  destroy(w);
  return status;
}

void btf_writer_abort(btf_writer *w) {
  if (w == NULL) return;
  btfi_io_close(w->ctx, &w->io, true);
  destroy(w);
}
