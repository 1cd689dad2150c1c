/* SPDX-License-Identifier: MIT */
/* system.h: the system calls of this layer, behind the test seam, retried when a signal interrupts them. All
 * return what the call returns and set errno. */
#ifndef BTFI_IO_SYSTEM_H
#define BTFI_IO_SYSTEM_H

#include "io/io.h"

int btfi_sys_open(int folder, const char *path, int flags, unsigned mode);
/* Size of a regular file; -1 with EISDIR for a folder and EINVAL for a device, a pipe or the like. */
int64_t btfi_sys_regular_size(int fd);
void *btfi_sys_map(int fd, uint64_t size);
int64_t btfi_sys_read(int fd, void *dst, size_t n, uint64_t offset);
int64_t btfi_sys_write(int fd, const void *src, size_t n, uint64_t offset);
int btfi_sys_fsync(int fd);
int btfi_sys_close(int fd); /* the descriptor is gone either way */
int btfi_sys_rename(int folder, const char *from, const char *to);

/* Opens a regular file for reading and tells its size, or fails with the message set. */
btf_status btfi_open_regular(btf_context *ctx, const char *path, int *fd, uint64_t *size);

#endif
