/* SPDX-License-Identifier: MIT */
/* Files for reading: btf_io by path, whole files, mappings. */
#include "io/file_writer.h"
#include "io/system.h"

#include <errno.h>
#include <inttypes.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

typedef struct file_reader {
  btf_context *ctx;
  char *path;
  int fd;
  uint64_t size;
  _Atomic(void *) mapping; /* of the whole file, made on first use; NULL before */
} file_reader;

static int64_t reader_size(void *user) {
  return (int64_t)((file_reader *)user)->size;
}

static int64_t reader_read(void *user, void *dst, size_t n, uint64_t offset) {
  return btfi_sys_read(((file_reader *)user)->fd, dst, n, offset);
}

static const void *reader_map(void *user, uint64_t offset, size_t n) {
  file_reader *r = user;
  if (offset > r->size || n > r->size - offset) return NULL;
  if (n == 0) return "";
  void *mapping = atomic_load_explicit(&r->mapping, memory_order_acquire);
  if (!mapping) {
    void *made = btfi_sys_map(r->fd, r->size);
    if (made == MAP_FAILED) return NULL;
    if (atomic_compare_exchange_strong_explicit(&r->mapping, &mapping, made, memory_order_acq_rel,
                                                memory_order_acquire))
      mapping = made;
    else
      munmap(made, (size_t)r->size); /* another thread was first */
  }
  return (const unsigned char *)mapping + offset;
}

static int32_t reader_close(void *user, int32_t failed) {
  file_reader *r = user;
  btf_context *ctx = r->ctx;
  (void)failed;
  void *mapping = atomic_load(&r->mapping);
  if (mapping) munmap(mapping, (size_t)r->size);
  close(r->fd); /* nothing was written that could be lost */
  btfi_free(ctx, r->path);
  btfi_free(ctx, r);
  btf_context_release(ctx);
  return 0;
}

static btf_status open_reader(btf_context *ctx, const char *path, btf_io *out) {
  file_reader *r = btfi_calloc(ctx, 1, sizeof *r);
  if (!r) return btfi_alloc_status();
  r->path = btfi_strdup(ctx, path);
  const btf_status status = r->path ? btfi_open_regular(ctx, path, &r->fd, &r->size) : btfi_alloc_status();
  if (status != BTF_OK) {
    btfi_free(ctx, r->path);
    btfi_free(ctx, r);
    return status;
  }
  r->ctx = ctx;
  btfi_context_retain(ctx);
  atomic_init(&r->mapping, NULL);
  out->user = r;
  out->size = reader_size;
  out->read = reader_read;
  out->map = reader_map;
  out->close = reader_close;
  out->name = r->path;
  return BTF_OK;
}

btf_status btf_io_file(btf_context *ctx, const char *path, uint32_t mode, btf_io *io) {
  btf_io made = BTF_IO_INIT;
  if (!ctx) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_io_file: ctx is NULL");
  BTFI_TRY(btfi_copy_out(ctx, "btf_io", io, BTFI_SIZE_TO(btf_io, name), &made, sizeof made));
  if (!path || !*path) return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_io_file: the path is empty");
  if (mode == BTF_IO_READ)
    BTFI_TRY(open_reader(ctx, path, &made));
  else if (mode == BTF_IO_WRITE)
    BTFI_TRY(btfi_file_writer_open(ctx, path, &made));
  else
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_io_file: mode is %u; expected BTF_IO_READ or BTF_IO_WRITE",
                     (unsigned)mode);
  return btfi_copy_out(ctx, "btf_io", io, BTFI_SIZE_TO(btf_io, name), &made, sizeof made);
}

btf_status btfi_read_file(btf_context *ctx, const char *path, uint64_t limit, char **data, uint64_t *size) {
  uint64_t bytes = 0, done = 0;
  int fd;
  *data = NULL;
  *size = 0;
  BTFI_TRY(btfi_open_regular(ctx, path, &fd, &bytes));
  btf_status status = BTF_OK;
  char *text = NULL;
  if (bytes > limit)
    status = btfi_fail(ctx, BTF_E_LIMIT, "%s: has %" PRIu64 " bytes; expected at most %" PRIu64, path, bytes,
                       limit);
  else if (!(text = btfi_alloc(ctx, bytes + 1, 1)))
    status = btfi_alloc_status();
  while (status == BTF_OK && done < bytes) {
    const int64_t got =
        btfi_sys_read(fd, text + done, (size_t)BTFI_MIN(bytes - done, (uint64_t)1 << 30), done);
    if (got < 0)
      status = btfi_fail(ctx, BTF_E_IO, "%s: cannot be read: %s", path, strerror(errno));
    else if (got == 0)
      status = btfi_fail(ctx, BTF_E_TRUNCATED,
                         "%s: ends at byte %" PRIu64 " of %" PRIu64 ", it was cut while being read", path,
                         done, bytes);
    else
      done += (uint64_t)got;
  }
  close(fd);
  if (status != BTF_OK) {
    btfi_free(ctx, text);
    return status;
  }
  text[bytes] = '\0';
  *data = text;
  *size = bytes;
  return BTF_OK;
}

btf_status btfi_map_file(btf_context *ctx, const char *path, btfi_mapping *out) {
  uint64_t size = 0;
  int fd;
  out->data = NULL;
  out->size = 0;
  BTFI_TRY(btfi_open_regular(ctx, path, &fd, &size));
  const void *data = size > 0 ? btfi_sys_map(fd, size) : "";
  const int code = errno;
  if (size == 0 || data == MAP_FAILED) close(fd);
  if (data == MAP_FAILED) return btfi_fail(ctx, BTF_E_IO, "%s: cannot be mapped: %s", path, strerror(code));
  out->data = data;
  out->size = size;
  out->fd = fd;
  return BTF_OK;
}

bool btfi_mapping_read(const btfi_mapping *mapping, void *dst, uint64_t n, uint64_t offset) {
  for (uint64_t done = 0; done < n;) {
    const int64_t got = btfi_sys_read(mapping->fd, (char *)dst + done,
                                      (size_t)BTFI_MIN(n - done, (uint64_t)1 << 30), offset + done);
    if (got == 0) errno = 0;
    if (got <= 0) return false;
    done += (uint64_t)got;
  }
  return true;
}

void btfi_mapping_let_go(const btfi_mapping *mapping) {
  if (mapping->size > 0) madvise((void *)(uintptr_t)mapping->data, (size_t)mapping->size, MADV_DONTNEED);
}

void btfi_unmap(btfi_mapping *mapping) {
  if (mapping->size > 0) {
    munmap((void *)(uintptr_t)mapping->data, (size_t)mapping->size);
    close(mapping->fd);
  }
  mapping->data = NULL;
  mapping->size = 0;
}
