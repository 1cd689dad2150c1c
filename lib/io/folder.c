/* SPDX-License-Identifier: MIT */
#include "io/folder.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "io/system.h"

static bool fault(const char *call) {
  const int code = btfi_io_fault ? btfi_io_fault(call) : 0;
  if (code) errno = code;
  return code != 0;
}

static btf_status fail_io(btf_context *ctx, const char *path, const char *problem) {
  const int code = errno;
  return btfi_fail(ctx, BTF_E_IO, "%s: %s: %s", path, problem, strerror(code));
}

btf_status btfi_path_join(btf_context *ctx, const char *folder, const char *name, char **out) {
  size_t length = strlen(folder);
  while (length > 1 && folder[length - 1] == '/') --length;
  const size_t size = length + strlen(name) + 2;
  *out = btfi_alloc(ctx, size, 1);
  if (!*out) return btfi_alloc_status();
  snprintf(*out, size, "%.*s/%s", (int)length, folder, name);
  return BTF_OK;
}

int btfi_folder_stat(const char *path, struct stat *entry) {
  return fault("stat") ? -1 : stat(path, entry);
}

static btf_status find(btf_context *ctx, const btfi_folder_kind *kind, const char *path, btfi_buffer *files) {
  const btf_status status = kind->find(ctx, kind, path, files);
  return status == BTF_OK ? btfi_buffer_status(files) : status;
}

/* For callers that do not ask for the folder's files. */
static btf_status is_of(btf_context *ctx, const btfi_folder_kind *kind, const char *path) {
  btfi_buffer files;
  btfi_buffer_init(&files, ctx);
  const btf_status status = find(ctx, kind, path, &files);
  btfi_buffer_free(&files);
  return status;
}

btf_status btfi_folder_may_take(btf_context *ctx, const btfi_folder_kind *kind, const char *path,
                                bool *exists) {
  struct stat entry;
  if (exists) *exists = false;
  if (fault("stat") || lstat(path, &entry) != 0)
    return errno == ENOENT ? BTF_OK : fail_io(ctx, path, "cannot be looked at");
  if (exists) *exists = true;
  const btf_status status = S_ISDIR(entry.st_mode) ? is_of(ctx, kind, path) : BTF_E_INVALID_ARG;
  if (status == BTF_OK || status == BTF_E_NOMEM) return status;
  return btfi_fail(ctx, BTF_E_IO, "%s: exists and is not a %s; it is not replaced", path, kind->title);
}

/* The path without slashes at its end, up to its last name, and that name. */
static void split_path(const char *path, int *parent, int *name, int *name_length) {
  int length = (int)strlen(path);
  while (length > 1 && path[length - 1] == '/') --length;
  int start = length;
  while (start > 0 && path[start - 1] != '/') --start;
  *parent = start;
  *name = start;
  *name_length = length - start;
}

/* A path beside another: PARENT/.NAME.KIND-XXXXXX. */
static char *beside(btf_context *ctx, const char *path, const char *kind, uint64_t number) {
  static const char digits[] = "abcdefghijklmnopqrstuvwxyz012345";
  int parent, name, name_length;
  char suffix[7];
  split_path(path, &parent, &name, &name_length);
  for (int i = 0; i < 6; ++i, number >>= 5) suffix[i] = digits[number & 31u];
  suffix[6] = '\0';
  const size_t size = strlen(path) + strlen(kind) + 16;
  char *out = btfi_alloc(ctx, size, 1);
  if (out) snprintf(out, size, "%.*s.%.*s.%s-%s", parent, path, name_length, path + name, kind, suffix);
  return out;
}

/* Only names of temporary folders depend on it. */
static void seed_names(btfi_random *random) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  btfi_random_seed(random, (uint64_t)now.tv_nsec ^ (uint64_t)now.tv_sec << 30 ^ (uint64_t)getpid() << 50 ^
                               (uint64_t)(uintptr_t)random);
}

btf_status btfi_folder_make_beside(btf_context *ctx, const char *path, char **out) {
  btfi_random random;
  seed_names(&random);
  for (int attempt = 0; attempt < 100; ++attempt) {
    *out = beside(ctx, path, "tmp", btfi_random_u64(&random));
    if (!*out) return btfi_alloc_status();
    if (!fault("mkdir") && mkdir(*out, 0777) == 0) return BTF_OK;
    const int code = errno;
    btfi_free(ctx, *out);
    *out = NULL;
    errno = code;
    if (code != EEXIST) break;
  }
  return fail_io(ctx, path, "a folder beside it cannot be made");
}

void btfi_folder_remove(btf_context *ctx, const char *folder, const char *files, uint64_t size) {
  /* Without the seam and without a result: nothing better can be done when cleaning up fails. */
  for (uint64_t at = 0; at < size; at += strlen(files + at) + 1) {
    const char *name = files + at;
    char path[PATH_MAX];
    if (snprintf(path, sizeof path, "%s/%s", folder, name) < (int)sizeof path) unlink(path);
  }
  if (rmdir(folder) != 0 && errno != ENOENT)
    btfi_log(ctx, BTF_LOG_WARNING, "%s: cannot be removed: %s", folder, strerror(errno));
}

static bool is_listed(const char *name, const btfi_buffer *files) {
  for (uint64_t at = 0; at < files->size; at += strlen((const char *)files->data + at) + 1)
    if (strcmp(name, (const char *)files->data + at) == 0) return true;
  return false;
}

/* Files beside ours, such as notes or pictures, belong to somebody else. */
static void move_other_files(const char *from, const char *to, const btfi_buffer *files) {
  DIR *folder = opendir(from);
  struct dirent *entry;
  char old_path[PATH_MAX], new_path[PATH_MAX];
  if (!folder) return;
  while ((entry = readdir(folder)) != NULL) {
    const char *name = entry->d_name;
    struct stat there;
    if (!strcmp(name, ".") || !strcmp(name, "..") || is_listed(name, files)) continue;
    if (snprintf(old_path, sizeof old_path, "%s/%s", from, name) < (int)sizeof old_path &&
        snprintf(new_path, sizeof new_path, "%s/%s", to, name) < (int)sizeof new_path &&
        lstat(new_path, &there) != 0 && rename(old_path, new_path) != 0)
      continue;
  }
  closedir(folder);
}

static btf_status exchange(btf_context *ctx, const char *temporary, const char *path, const char *old,
                           const btfi_buffer *files) {
  if (btfi_sys_rename(AT_FDCWD, path, old) != 0) return fail_io(ctx, path, "cannot be replaced");
  if (btfi_sys_rename(AT_FDCWD, temporary, path) != 0) {
    const btf_status status = fail_io(ctx, path, "cannot be put in place");
    if (rename(old, path) != 0) btfi_log(ctx, BTF_LOG_WARNING, "%s: what was there is now %s", path, old);
    return status;
  }
  move_other_files(old, path, files);
  btfi_folder_remove(ctx, old, (const char *)files->data, files->size);
  return BTF_OK;
}

static btf_status replace(btf_context *ctx, const btfi_folder_kind *kind, const char *temporary,
                          const char *path) {
  btfi_random random;
  btfi_buffer files;
  btfi_buffer_init(&files, ctx);
  btf_status status = find(ctx, kind, path, &files);
  if (status != BTF_OK) {
    btfi_buffer_free(&files);
    if (status == BTF_E_NOMEM) return status;
    return btfi_fail(ctx, BTF_E_IO, "%s: is no longer a %s; it is not replaced", path, kind->title);
  }
  seed_names(&random);
  char *old = beside(ctx, path, "old", btfi_random_u64(&random));
  status = old ? exchange(ctx, temporary, path, old, &files) : btfi_alloc_status();
  btfi_free(ctx, old);
  btfi_buffer_free(&files);
  return status;
}

/* So that the new name survives a crash; the data set is in place either way. */
static void sync_parent(btf_context *ctx, const char *path) {
  int parent, name, name_length;
  char folder[PATH_MAX] = ".";
  split_path(path, &parent, &name, &name_length);
  if (parent > 0 && snprintf(folder, sizeof folder, "%.*s", parent, path) >= (int)sizeof folder) return;
  const int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  if (fsync(fd) != 0 && errno != EINVAL && errno != ENOTSUP)
    btfi_log(ctx, BTF_LOG_WARNING, "%s: cannot be synchronised: %s", folder, strerror(errno));
  close(fd);
}

btf_status btfi_folder_place(btf_context *ctx, const btfi_folder_kind *kind, const char *temporary,
                             const char *path) {
  bool exists;
  BTFI_TRY(btfi_folder_may_take(ctx, kind, path, &exists));
  if (exists)
    BTFI_TRY(replace(ctx, kind, temporary, path));
  else if (btfi_sys_rename(AT_FDCWD, temporary, path) != 0)
    return fail_io(ctx, path, "cannot be put in place");
  sync_parent(ctx, path);
  return BTF_OK;
}
