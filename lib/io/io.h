/* SPDX-License-Identifier: MIT */
/* io.h: checked use of btf_io, and files. */
#ifndef BTFI_IO_H
#define BTFI_IO_H

#include "base/base.h"
#include <btf/btf_io.h>

/* Copies the caller's btf_io, checking that the members needed are there. */
btf_status btfi_io_copy(btf_context *ctx, const btf_io *user, bool writing, btf_io *out);
/* Exactly n bytes at an offset, in as many calls as it takes. Short reads are BTF_E_TRUNCATED. */
btf_status btfi_io_read(btf_context *ctx, const btf_io *io, void *dst, uint64_t n, uint64_t offset);
btf_status btfi_io_write(btf_context *ctx, const btf_io *io, const void *src, uint64_t n, uint64_t offset);
const char *btfi_io_name(const btf_io *io); /* never NULL */

/* Whole small file to memory (NUL appended, not counted); limit in bytes. */
btf_status btfi_read_file(btf_context *ctx, const char *path, uint64_t limit, char **data, uint64_t *size);
/* A read-only mapping of a whole file. */
typedef struct btfi_mapping {
  const void *data;
  uint64_t size;
} btfi_mapping;
btf_status btfi_map_file(btf_context *ctx, const char *path, btfi_mapping *out);
void btfi_unmap(btfi_mapping *mapping);

/* Test seam: when set, called before each system call of this layer; a non-zero errno value makes that call fail. */
extern int (*btfi_io_fault)(const char *call);

#endif
