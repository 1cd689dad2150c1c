/* SPDX-License-Identifier: MIT */
#include "io/new_folder.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <unistd.h>

#include "io/system.h"

struct btf_new_folder {
  btfi_folder_kind kind;               /* first, so that find_own gets at the rest */
  int32_t (*is_own)(const char *name); /* of kinds that are told by the names of their files; or NULL */
  btf_context *ctx;
  char *path, *temporary;
  int fd;            /* of the temporary folder */
  btfi_buffer files; /* names in it */
};

static btf_status find_own(btf_context *ctx, const btfi_folder_kind *kind, const char *path,
                           btfi_buffer *files) {
  const btf_new_folder *folder = (const btf_new_folder *)(const void *)kind;
  DIR *there = opendir(path);
  struct dirent *entry;
  bool all = true, any = false;
  (void)ctx;
  if (!there) return BTF_E_IO;
  errno = 0;
  while (all && (entry = readdir(there)) != NULL) {
    const char *name = entry->d_name;
    if (!strcmp(name, ".") || !strcmp(name, "..")) continue;
    any = true;
    all = folder->is_own(name) != 0;
    if (all) btfi_put_bytes(files, name, strlen(name) + 1);
    errno = 0;
  }
  const bool complete = errno == 0;
  closedir(there);
  return all && any && complete ? BTF_OK : BTF_E_INVALID_ARG;
}

static void free_folder(btf_new_folder *folder) {
  btf_context *ctx = folder->ctx;
  if (folder->fd >= 0) close(folder->fd);
  btfi_buffer_free(&folder->files);
  btfi_free(ctx, folder->temporary);
  btfi_free(ctx, folder->path);
  btfi_free(ctx, folder);
}

static btf_status fail_io(const btf_new_folder *folder, const char *name, const char *problem) {
  const int code = errno;
  return btfi_fail(folder->ctx, BTF_E_IO, "%s/%s: %s: %s", folder->path, name, problem, strerror(code));
}

static btf_status open_folder(btf_new_folder *folder, const char *path) {
  size_t length = strlen(path);
  while (length > 1 && path[length - 1] == '/') --length;
  folder->path = btfi_alloc(folder->ctx, length + 1, 1);
  if (!folder->path) return btfi_alloc_status();
  memcpy(folder->path, path, length);
  folder->path[length] = '\0';
  BTFI_TRY(btfi_folder_may_take(folder->ctx, &folder->kind, folder->path, NULL));
  BTFI_TRY(btfi_folder_make_beside(folder->ctx, folder->path, &folder->temporary));
  folder->fd = btfi_sys_open(AT_FDCWD, folder->temporary, O_RDONLY | O_DIRECTORY, 0);
  return folder->fd >= 0 ? BTF_OK : fail_io(folder, "", "cannot be opened");
}

static void remove_folder(btf_new_folder *folder) {
  if (folder->temporary)
    btfi_folder_remove(folder->ctx, folder->temporary, (const char *)folder->files.data, folder->files.size);
}

static btf_status begin(btf_context *ctx, const char *path, const btfi_folder_kind *kind,
                        int32_t (*is_own)(const char *name), btf_new_folder **out) {
  btf_new_folder *folder = btfi_calloc(ctx, 1, sizeof *folder);
  *out = NULL;
  if (!folder) return btfi_alloc_status();
  folder->kind = *kind;
  folder->is_own = is_own;
  folder->ctx = ctx;
  folder->fd = -1;
  btfi_buffer_init(&folder->files, ctx);
  const btf_status status = open_folder(folder, path);
  if (status == BTF_OK) {
    *out = folder;
  } else {
    remove_folder(folder);
    free_folder(folder);
  }
  return status;
}

btf_status btfi_new_folder_begin(btf_context *ctx, const char *path, const char *title,
                                 int32_t (*is_own)(const char *name), btf_new_folder **out) {
  return begin(ctx, path, &(btfi_folder_kind){title, find_own}, is_own, out);
}

btf_status btfi_new_folder_begin_kind(btf_context *ctx, const char *path, const btfi_folder_kind *kind,
                                      btf_new_folder **out) {
  return begin(ctx, path, kind, NULL, out);
}

static btf_status put_bytes(btf_new_folder *folder, int fd, const char *name, const void *data,
                            uint64_t size) {
  const char *from = data;
  for (uint64_t offset = 0; offset < size;) {
    const int64_t written =
        btfi_sys_write(fd, from + offset, (size_t)BTFI_MIN(size - offset, (uint64_t)1 << 30), offset);
    if (written == 0) errno = ENOSPC;
    if (written <= 0) return fail_io(folder, name, "cannot be written");
    offset += (uint64_t)written;
  }
  return BTF_OK;
}

btf_status btfi_new_folder_put(btf_new_folder *folder, const char *name, const void *data, uint64_t size) {
  if (name[0] == '\0' || strchr(name, '/') || (folder->is_own && !folder->is_own(name)))
    return btfi_fail(folder->ctx, BTF_E_INVALID_ARG, "%s: \"%s\" is not a name of its files", folder->path,
                     name);
  btfi_put_bytes(&folder->files, name, strlen(name) + 1); /* before the file: what is there gets removed */
  BTFI_TRY(btfi_buffer_status(&folder->files));
  const int fd = btfi_sys_open(folder->fd, name, O_WRONLY | O_CREAT | O_EXCL, 0666);
  if (fd < 0) return fail_io(folder, name, "cannot be made");
  btf_status status = put_bytes(folder, fd, name, data, size);
  if (btfi_sys_close(fd) != 0 && status == BTF_OK) status = fail_io(folder, name, "cannot be written");
  return status;
}

/* One call for thousands of files. */
static btf_status sync_files(btf_new_folder *folder) {
  const int code = btfi_io_fault ? btfi_io_fault("syncfs") : 0;
  if (code) errno = code;
  return code || syncfs(folder->fd) != 0 ? fail_io(folder, "", "cannot be synchronised") : BTF_OK;
}

btf_status btfi_new_folder_end(btf_new_folder *folder, int32_t failed) {
  btf_status status = BTF_OK;
  if (!failed) status = sync_files(folder);
  if (!failed && status == BTF_OK)
    status = btfi_folder_place(folder->ctx, &folder->kind, folder->temporary, folder->path);
  if (failed || status != BTF_OK) remove_folder(folder);
  free_folder(folder);
  return status;
}
