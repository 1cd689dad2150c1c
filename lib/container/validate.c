/* SPDX-License-Identifier: MIT */
/* Verifying every byte of an open container. */
#include "container/reader.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define PIECE ((uint64_t)1 << 20)

typedef struct validation {
  const btf_file *file;
  btf_issue_fn report;
  void *user;
  unsigned char *buffer; /* PIECE bytes */
  btf_status first;
  char message[512];
} validation;

static void finding(validation *v, uint32_t issue, int32_t severity, btf_status status, uint64_t offset,
                    const char *text) {
  if (status != BTF_OK && v->first == BTF_OK) {
    v->first = status;
    snprintf(v->message, sizeof v->message, "%s", text);
  }
  if (v->report != NULL) v->report(v->user, issue, severity, offset, text);
}

static void LIBBTF_PRINTF(5, 6)
    describe(validation *v, uint32_t issue, int32_t severity, uint64_t offset, const char *format, ...) {
  char text[512];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  finding(v, issue, severity, severity == BTF_LOG_ERROR ? BTF_E_CORRUPT : BTF_OK, offset, text);
}

/* A failure of a lower function, whose message is still at hand. */
static void passed_on(validation *v, uint32_t issue, btf_status status, uint64_t offset) {
  char text[512];
  snprintf(text, sizeof text, "%s", btf_error_message());
  if (status == BTF_E_LIMIT || status == BTF_E_NOMEM) issue = BTFI_ISSUE_LIMIT;
  if (status == BTF_E_IO || status == BTF_E_TRUNCATED) issue = BTFI_ISSUE_UNREADABLE;
  finding(v, issue, BTF_LOG_ERROR, status, offset, text);
}

static void check_padding(validation *v, uint64_t from, uint64_t to) {
  btfi_source *s = v->file->source;
  const btf_status status = btfi_io_read(s->ctx, &s->io, v->buffer, to - from, from);
  if (status != BTF_OK) {
    passed_on(v, BTFI_ISSUE_UNREADABLE, status, from);
    return;
  }
  for (uint64_t i = 0; i < to - from; i++)
    if (v->buffer[i] != 0) {
      describe(v, BTFI_ISSUE_PADDING, BTF_LOG_ERROR, from + i,
               "%s: the byte at offset %llu is padding between chunks and must be 0", s->name,
               (unsigned long long)(from + i));
      return;
    }
}

static void check_stored(validation *v, const btfi_entry *e) {
  btfi_source *s = v->file->source;
  btfi_xxh64 sum;
  char name[BTFI_NAME_SIZE];
  btfi_xxh64_init(&sum, 0);
  for (uint64_t done = 0; done < e->stored;) {
    const uint64_t n = BTFI_MIN(e->stored - done, PIECE);
    const btf_status status = btfi_io_read(s->ctx, &s->io, v->buffer, n, e->offset + done);
    if (status != BTF_OK) {
      passed_on(v, BTFI_ISSUE_UNREADABLE, status, e->offset + done);
      return;
    }
    btfi_xxh64_update(&sum, v->buffer, (size_t)n);
    done += n;
  }
  if (btfi_xxh64_digest(&sum) != e->checksum) {
    describe(v, BTFI_ISSUE_CHECKSUM, BTF_LOG_ERROR, e->offset,
             "%s: %s: the checksum does not match; the file is damaged", s->name, btfi_entry_name(e, name));
  } else if (e->method == BTFI_METHOD_ZSTD) {
    const void *data;
    bool owned;
    const btf_status status = btfi_chunk_read(s, e, false, &data, &owned);
    if (status != BTF_OK) passed_on(v, BTFI_ISSUE_CONTENT, status, e->offset);
    if (owned) btfi_free(s->ctx, (void *)(uintptr_t)data);
  }
}

static void check_chunk(validation *v, const btfi_entry *e, uint64_t previous_end) {
  btfi_source *s = v->file->source;
  char name[BTFI_NAME_SIZE];
  btf_status status;
  check_padding(v, previous_end, btfi_align(previous_end));
  status = btfi_chunk_check_head(s, e);
  if (status != BTF_OK) {
    passed_on(v, BTFI_ISSUE_HEAD, status, e->offset - BTFI_ENTRY_SIZE);
    return;
  }
  if (!btfi_type_known(e->type))
    describe(v, BTFI_ISSUE_UNKNOWN_TYPE, BTF_LOG_INFO, e->offset,
             "%s: %s: of a type this library does not know", s->name, btfi_entry_name(e, name));
  check_stored(v, e);
}

btf_status btf_file_validate(const btf_file *file, btf_issue_fn report, void *user) {
  validation v = {file, report, user, NULL, BTF_OK, ""};
  uint64_t end = BTFI_HEADER_SIZE;
  if (file == NULL) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_file_validate: the file must not be NULL");
  v.buffer = btfi_alloc(file->ctx, PIECE, 1);
  if (v.buffer == NULL) return btfi_alloc_status();
  if (file->header.minor > BTFI_FORMAT_MINOR)
    describe(&v, BTFI_ISSUE_NEWER_MINOR, BTF_LOG_INFO, 10,
             "%s: container version %u.%u; this library knows up to %u.%u", file->source->name,
             file->header.major, file->header.minor, (unsigned)BTFI_FORMAT_MAJOR,
             (unsigned)BTFI_FORMAT_MINOR);
  if ((file->header.optional & ~BTFI_KNOWN_OPTIONAL) != 0)
    describe(&v, BTFI_ISSUE_UNKNOWN_FEATURE, BTF_LOG_INFO, 16,
             "%s: uses optional features this library does not have (mask 0x%x)", file->source->name,
             (unsigned)(file->header.optional & ~BTFI_KNOWN_OPTIONAL));
  for (uint32_t i = 0; i < file->header.count; i++) {
    check_chunk(&v, &file->entries[i], end);
    end = file->entries[i].offset + file->entries[i].stored;
  }
  check_padding(&v, end, file->header.directory_offset);
  btfi_free(file->ctx, v.buffer);
  if (v.first != BTF_OK) return btfi_fail(file->ctx, v.first, "%s", v.message);
  return BTF_OK;
}
