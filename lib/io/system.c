/* SPDX-License-Identifier: MIT */
#include "io/system.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

int (*btfi_io_fault)(const char *call);

static bool fault(const char *call) {
  const int code = btfi_io_fault ? btfi_io_fault(call) : 0;
  if (code) errno = code;
  return code != 0;
}

int btfi_sys_open(int folder, const char *path, int flags, unsigned mode) {
  int fd;
  if (fault("open")) return -1;
  do fd = openat(folder, path, flags | O_CLOEXEC, (mode_t)mode);
  while (fd < 0 && errno == EINTR);
  return fd;
}

int64_t btfi_sys_regular_size(int fd) {
  struct stat entry;
  if (fault("fstat") || fstat(fd, &entry) != 0) return -1;
  if (S_ISREG(entry.st_mode)) return (int64_t)entry.st_size;
  errno = S_ISDIR(entry.st_mode) ? EISDIR : EINVAL;
  return -1;
}

void *btfi_sys_map(int fd, uint64_t size) {
  if (fault("mmap")) return MAP_FAILED;
  if (size > SIZE_MAX) {
    errno = ENOMEM;
    return MAP_FAILED;
  }
  return mmap(NULL, (size_t)size, PROT_READ, MAP_SHARED, fd, 0);
}

int64_t btfi_sys_read(int fd, void *dst, size_t n, uint64_t offset) {
  ssize_t got;
  if (fault("pread")) return -1;
  do got = pread(fd, dst, n, (off_t)offset);
  while (got < 0 && errno == EINTR);
  return got;
}

int64_t btfi_sys_write(int fd, const void *src, size_t n, uint64_t offset) {
  ssize_t written;
  if (fault("pwrite")) return -1;
  do written = pwrite(fd, src, n, (off_t)offset);
  while (written < 0 && errno == EINTR);
  return written;
}

int btfi_sys_fsync(int fd) {
  int result;
  if (fault("fsync")) return -1;
  do result = fsync(fd);
  while (result != 0 && errno == EINTR);
  /* Some file systems cannot synchronise a folder; then there is nothing to wait for. */
  return result != 0 && (errno == EINVAL || errno == ENOTSUP) ? 0 : result;
}

int btfi_sys_close(int fd) {
  const int result = close(fd);
  if (fault("close")) return -1;
  return result != 0 && errno != EINTR ? -1 : 0;
}

int btfi_sys_rename(int folder, const char *from, const char *to) {
  if (fault("rename")) return -1;
  return renameat(folder, from, folder, to);
}

btf_status btfi_open_regular(btf_context *ctx, const char *path, int *fd, uint64_t *size) {
  /* Without O_NONBLOCK, opening a pipe would wait for its writer. */
  *fd = btfi_sys_open(AT_FDCWD, path, O_RDONLY | O_NONBLOCK | O_NOCTTY, 0);
  if (*fd < 0) return btfi_fail(ctx, BTF_E_IO, "%s: cannot be opened: %s", path, strerror(errno));
  const int64_t bytes = btfi_sys_regular_size(*fd);
  if (bytes >= 0) {
    *size = (uint64_t)bytes;
    return BTF_OK;
  }
  const int code = errno;
  close(*fd);
  *fd = -1;
  return btfi_fail(ctx, BTF_E_IO, "%s: %s; expected a regular file", path,
                   code == EISDIR   ? "is a folder"
                   : code == EINVAL ? "is a device, a pipe or the like"
                                    : strerror(code));
}
