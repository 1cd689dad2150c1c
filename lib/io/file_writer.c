/* SPDX-License-Identifier: MIT */
/* A file that appears as a whole or not at all: written under a temporary name in its folder, then renamed.
 */
#include "io/file_writer.h"
#include "io/system.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

enum { temporary_name_size = 256, longest_kept_name = 200 };

typedef struct file_writer {
  btf_context *ctx;
  char *path;
  const char *name; /* last part of path */
  int folder, fd;   /* the folder stays open: a relative path keeps its meaning, and no late open can fail */
  char temporary[temporary_name_size];
} file_writer;

static int64_t writer_write(void *user, const void *src, size_t n, uint64_t offset) {
  return btfi_sys_write(((file_writer *)user)->fd, src, n, offset);
}

static void free_writer(file_writer *w) {
  btf_context *ctx = w->ctx;
  if (w->folder >= 0) close(w->folder);
  btfi_free(ctx, w->path);
  btfi_free(ctx, w);
}

/* A folder that cannot be synchronised after the rename is reported too: the file is whole, but may not last.
 */
static int32_t writer_close(void *user, int32_t failed) {
  file_writer *w = user;
  btf_context *ctx = w->ctx;
  int code = 0;
  bool renamed = false;
  if (!failed && btfi_sys_fsync(w->fd) != 0) code = errno;
  if (failed)
    close(w->fd);
  else if (btfi_sys_close(w->fd) != 0 && !code)
    code = errno;
  if (!failed && !code) {
    renamed = btfi_sys_rename(w->folder, w->temporary, w->name) == 0;
    if (!renamed || btfi_sys_fsync(w->folder) != 0) code = errno;
  }
  if (!renamed) unlinkat(w->folder, w->temporary, 0);
  free_writer(w);
  btf_context_release(ctx);
  errno = code;
  return code ? -1 : 0;
}

/* A file of that name may be replaced, anything else may not; an old file's permissions stay. */
static btf_status check_target(file_writer *w, bool *exists, mode_t *mode) {
  struct stat entry;
  *exists = fstatat(w->folder, w->name, &entry, 0) == 0;
  if (!*exists) return BTF_OK;
  *mode = entry.st_mode & 0777;
  if (S_ISREG(entry.st_mode)) return BTF_OK;
  return btfi_fail(w->ctx, BTF_E_IO, "%s: %s; expected a file name", w->path,
                   S_ISDIR(entry.st_mode) ? "is a folder" : "is a device, a pipe or the like");
}

static void choose_temporary_name(file_writer *w, btfi_random *random) {
  static const char letters[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789";
  char unique[7];
  for (int i = 0; i < 6; i++) unique[i] = letters[btfi_random_below(random, sizeof letters - 1)];
  unique[6] = '\0';
  snprintf(w->temporary, sizeof w->temporary, ".%.*s.%s.tmp", longest_kept_name, w->name, unique);
}

static btf_status create_temporary(file_writer *w) {
  uint64_t seed = 0;
  btfi_random random;
  if (getrandom(&seed, sizeof seed, GRND_NONBLOCK) != (ssize_t)sizeof seed)
    seed = (uint64_t)btfi_now_ns() ^ (uint64_t)getpid() << 32;
  btfi_random_seed(&random, seed);
  for (int attempt = 0; attempt < 100; attempt++) {
    choose_temporary_name(w, &random);
    w->fd = btfi_sys_open(w->folder, w->temporary, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW, 0666);
    if (w->fd >= 0) return BTF_OK;
    if (errno != EEXIST) break;
  }
  return btfi_fail(w->ctx, BTF_E_IO, "%s: cannot be created: %s", w->path, strerror(errno));
}

static btf_status open_folder(file_writer *w) {
  char *slash = strrchr(w->path, '/');
  w->name = slash ? slash + 1 : w->path;
  if (!*w->name || strcmp(w->name, ".") == 0 || strcmp(w->name, "..") == 0)
    return btfi_fail(w->ctx, BTF_E_IO, "%s: is a folder; expected a file name", w->path);
  const int flags = O_RDONLY | O_DIRECTORY;
  if (!slash) {
    w->folder = btfi_sys_open(AT_FDCWD, ".", flags, 0);
  } else if (slash == w->path) {
    w->folder = btfi_sys_open(AT_FDCWD, "/", flags, 0);
  } else {
    *slash = '\0';
    w->folder = btfi_sys_open(AT_FDCWD, w->path, flags, 0);
    *slash = '/';
  }
  if (w->folder >= 0) return BTF_OK;
  return btfi_fail(w->ctx, BTF_E_IO, "%s: its folder cannot be opened: %s", w->path, strerror(errno));
}

static btf_status prepare(file_writer *w, const char *path) {
  bool exists = false;
  mode_t mode = 0;
  w->path = btfi_strdup(w->ctx, path);
  if (!w->path) return btfi_alloc_status();
  BTFI_TRY(open_folder(w));
  BTFI_TRY(check_target(w, &exists, &mode));
  BTFI_TRY(create_temporary(w));
  if (exists && fchmod(w->fd, mode) != 0)
    btfi_log(w->ctx, BTF_LOG_WARNING, "%s: cannot keep the permissions: %s", path, strerror(errno));
  return BTF_OK;
}

btf_status btfi_file_writer_open(btf_context *ctx, const char *path, btf_io *out) {
  file_writer *w = btfi_calloc(ctx, 1, sizeof *w);
  if (!w) return btfi_alloc_status();
  w->ctx = ctx;
  w->folder = w->fd = -1;
  const btf_status status = prepare(w, path);
  if (status != BTF_OK) {
    free_writer(w);
    return status;
  }
  btfi_context_retain(ctx);
  out->user = w;
  out->write = writer_write;
  out->close = writer_close;
  out->name = w->path;
  return BTF_OK;
}
