/* SPDX-License-Identifier: MIT */
/* Reading one chunk: head, checksum, sizes, and only then memory and unpacking. */
#include "container/format.h"

#include <string.h>
#include <zstd.h>
#include <zstd_errors.h>

btfi_source *btfi_source_retain(btfi_source *source) {
  atomic_fetch_add_explicit(&source->references, 1, memory_order_relaxed);
  return source;
}

void btfi_source_release(btfi_source *source) {
  btf_context *ctx;
  if (source == NULL || atomic_fetch_sub_explicit(&source->references, 1, memory_order_acq_rel) != 1) return;
  ctx = source->ctx;
  btfi_io_close(ctx, &source->io, false); /* nothing was written, so nothing can be lost */
  btfi_free(ctx, (void *)(uintptr_t)source->name);
  btfi_free(ctx, source);
  btf_context_release(ctx);
}

btf_status btfi_chunk_check_head(btfi_source *source, const btfi_entry *e) {
  unsigned char expected[BTFI_ENTRY_SIZE], head[BTFI_ENTRY_SIZE];
  char name[BTFI_NAME_SIZE];
  BTFI_TRY(btfi_io_read(source->ctx, &source->io, head, sizeof head, e->offset - BTFI_ENTRY_SIZE));
  btfi_entry_encode(e, expected);
  if (memcmp(head, expected, sizeof head) != 0)
    return btfi_fail(source->ctx, BTF_E_CORRUPT,
                     "%s: %s: its head differs from the directory; the file is damaged", source->name,
                     btfi_entry_name(e, name));
  return BTF_OK;
}

static btf_status check_sum(btfi_source *source, const btfi_entry *e, const void *stored) {
  char name[BTFI_NAME_SIZE];
  if (btfi_xxh64_of(stored, (size_t)e->stored) != e->checksum)
    return btfi_fail(source->ctx, BTF_E_CORRUPT, "%s: %s: the checksum does not match; the file is damaged",
                     source->name, btfi_entry_name(e, name));
  return BTF_OK;
}

/* Memory with the stored bytes, verified. */
static btf_status read_stored(btfi_source *source, const btfi_entry *e, void **out) {
  btf_status status;
  *out = btfi_alloc(source->ctx, e->stored, 1);
  if (*out == NULL) return btfi_alloc_status();
  status = btfi_io_read(source->ctx, &source->io, *out, e->stored, e->offset);
  if (status == BTF_OK) status = check_sum(source, e, *out);
  if (status != BTF_OK) {
    btfi_free(source->ctx, *out);
    *out = NULL;
  }
  return status;
}

static btf_status unpack(btfi_source *source, const btfi_entry *e, const void *stored, void **out) {
  btf_context *ctx = source->ctx;
  char name[BTFI_NAME_SIZE];
  const unsigned long long content = ZSTD_getFrameContentSize(stored, (size_t)e->stored);
  size_t frame, got;
  *out = NULL;
  if (content == ZSTD_CONTENTSIZE_ERROR || content == ZSTD_CONTENTSIZE_UNKNOWN)
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: %s: not a zstd frame that states its size", source->name,
                     btfi_entry_name(e, name));
  if (content != e->raw)
    return btfi_fail(ctx, BTF_E_CORRUPT,
                     "%s: %s: the zstd frame unpacks to %llu bytes, the directory says %llu", source->name,
                     btfi_entry_name(e, name), content, (unsigned long long)e->raw);
  frame = ZSTD_findFrameCompressedSize(stored, (size_t)e->stored);
  if (ZSTD_isError(frame) || frame != e->stored)
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: %s: not exactly one zstd frame", source->name,
                     btfi_entry_name(e, name));
  *out = btfi_alloc(ctx, e->raw, 1);
  if (*out == NULL) return btfi_alloc_status();
  got = ZSTD_decompress(*out, (size_t)e->raw, stored, (size_t)e->stored);
  if (!ZSTD_isError(got) && got == e->raw) return BTF_OK;
  btfi_free(ctx, *out);
  *out = NULL;
  if (ZSTD_isError(got) && ZSTD_getErrorCode(got) == ZSTD_error_memory_allocation)
    return btfi_fail(ctx, BTF_E_NOMEM, "%s: %s: no memory to unpack it", source->name,
                     btfi_entry_name(e, name));
  return btfi_fail(ctx, BTF_E_CORRUPT, "%s: %s: zstd cannot unpack it: %s", source->name,
                   btfi_entry_name(e, name), ZSTD_isError(got) ? ZSTD_getErrorName(got) : "too few bytes");
}

btf_status btfi_chunk_read(btfi_source *source, const btfi_entry *e, bool trust, const void **data,
                           bool *owned) {
  btf_context *ctx = source->ctx;
  const uint64_t limit = btfi_limits(ctx)->max_chunk_bytes;
  char name[BTFI_NAME_SIZE];
  void *memory = NULL, *stored;
  *data = NULL;
  *owned = false;
  if (e->raw > limit)
    return btfi_fail(ctx, BTF_E_LIMIT, "%s: %s: %llu bytes are over the limit of %llu", source->name,
                     btfi_entry_name(e, name), (unsigned long long)e->raw, (unsigned long long)limit);
  if (e->raw > SIZE_MAX || e->stored > SIZE_MAX)
    return btfi_fail(ctx, BTF_E_LIMIT, "%s: %s: too large for this machine", source->name,
                     btfi_entry_name(e, name));
  BTFI_TRY(btfi_chunk_check_head(source, e));
  if (e->method == BTFI_METHOD_RAW) {
    if ((e->flags & BTFI_CHUNK_IN_PLACE) != 0 && source->io.map != NULL && e->stored != 0) {
      const void *mapped = source->io.map(source->io.user, e->offset, (size_t)e->stored);
      if (mapped != NULL && (uintptr_t)mapped % BTFI_ALIGNMENT == 0) {
        if (!trust) BTFI_TRY(check_sum(source, e, mapped));
        *data = mapped;
        return BTF_OK;
      }
    }
    BTFI_TRY(read_stored(source, e, &memory));
  } else {
    btf_status status;
    BTFI_TRY(read_stored(source, e, &stored));
    status = unpack(source, e, stored, &memory);
    btfi_free(ctx, stored);
    BTFI_TRY(status);
  }
  *data = memory;
  *owned = true;
  return BTF_OK;
}
