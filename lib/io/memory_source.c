/* SPDX-License-Identifier: MIT */
#include "io/io.h"

#include <string.h>

typedef struct memory_source {
  btf_context *ctx;
  const unsigned char *data;
  uint64_t size;
} memory_source;

static int64_t memory_size(void *user) {
  return (int64_t)((memory_source *)user)->size;
}

static int64_t memory_read(void *user, void *dst, size_t n, uint64_t offset) {
  const memory_source *m = user;
  if (offset >= m->size) return 0;
  const size_t got = (size_t)BTFI_MIN((uint64_t)n, m->size - offset);
  memcpy(dst, m->data + offset, got);
  return (int64_t)got;
}

static const void *memory_map(void *user, uint64_t offset, size_t n) {
  const memory_source *m = user;
  if (offset > m->size || n > m->size - offset) return NULL;
  return n == 0 ? (const void *)"" : m->data + offset;
}

static int32_t memory_close(void *user, int32_t failed) {
  memory_source *m = user;
  btf_context *ctx = m->ctx;
  (void)failed;
  btfi_free(ctx, m);
  btf_context_release(ctx);
  return 0;
}

btf_status btf_io_memory(btf_context *ctx, const void *data, size_t size, btf_io *io) {
  btf_io made = BTF_IO_INIT;
  if (!ctx) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_io_memory: ctx is NULL");
  BTFI_TRY(btfi_copy_out(ctx, "btf_io", io, BTFI_SIZE_TO(btf_io, name), &made, sizeof made));
  if ((!data && size > 0) || size > INT64_MAX)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_io_memory: data is NULL or its size absurd");
  memory_source *m = btfi_alloc(ctx, 1, sizeof *m);
  if (!m) return btfi_alloc_status();
  m->ctx = ctx;
  m->data = data;
  m->size = size;
  btfi_context_retain(ctx);
  made.user = m;
  made.size = memory_size;
  made.read = memory_read;
  made.map = memory_map;
  made.close = memory_close;
  made.name = "memory";
  return btfi_copy_out(ctx, "btf_io", io, BTFI_SIZE_TO(btf_io, name), &made, sizeof made);
}
