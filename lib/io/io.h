/* SPDX-License-Identifier: MIT */
/* io.h: checked use of btf_io, and files. */
#ifndef BTFI_IO_H
#define BTFI_IO_H

#include "base/base.h"
#include <btf/btf_io.h>

/* Copies the caller's btf_io, checking that the members needed are there: read, or write. On failure the
 * caller's close has been called, as far as struct_size let it be found; on success *out owes that call. */
btf_status btfi_io_copy(btf_context *ctx, const btf_io *user, bool writing, btf_io *out);
/* The one call of close; does nothing on an io that is closed, all zero or has no close. Without `failed`,
 * BTF_E_IO if the data could not be made durable; with it, always BTF_OK and this thread's message stays. */
btf_status btfi_io_close(btf_context *ctx, btf_io *io, bool failed);
/* Exactly n bytes at an offset, in as many calls as it takes. Short reads are BTF_E_TRUNCATED. */
btf_status btfi_io_read(btf_context *ctx, const btf_io *io, void *dst, uint64_t n, uint64_t offset);
btf_status btfi_io_write(btf_context *ctx, const btf_io *io, const void *src, uint64_t n, uint64_t offset);
const char *btfi_io_name(const btf_io *io); /* never NULL */

/* Whole small regular file to memory (NUL appended, not counted), freed with btfi_free; BTF_E_LIMIT above
 * `limit` bytes. */
btf_status btfi_read_file(btf_context *ctx, const char *path, uint64_t limit, char **data, uint64_t *size);
/* A read-only mapping of a whole regular file, which may be empty. */
typedef struct btfi_mapping {
  const void *data;
  uint64_t size;
  int fd; /* of the file, where size is not 0 */
} btfi_mapping;
btf_status btfi_map_file(btf_context *ctx, const char *path, btfi_mapping *out);
void btfi_unmap(btfi_mapping *mapping);
/* Gives the mapping's pages back; they stay in the system's cache and return when touched. */
void btfi_mapping_let_go(const btfi_mapping *mapping);
/* Bytes of the file itself, which makes no page resident. False with errno set, 0 where the file has become
 * shorter. */
bool btfi_mapping_read(const btfi_mapping *mapping, void *dst, uint64_t n, uint64_t offset);

/* Test seam: when set, called before each system call of this layer ("open", "fstat", "mmap", "pread",
 * "pwrite", "fsync", "close", "rename"; undoing never fails by it); a non-zero errno value makes that call
 * fail. */
extern int (*btfi_io_fault)(const char *call);

#endif
