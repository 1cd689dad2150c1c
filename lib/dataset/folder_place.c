/* SPDX-License-Identifier: MIT */
#include "dataset/folder.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "dataset/manifest.h"
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

/* What the samples of the data set in a folder are called; false when there is no data set. */
static bool find_samples(btf_context *ctx, const char *path, char *samples, size_t samples_size) {
  char *file = NULL, *text = NULL;
  uint64_t size = 0;
  bool ours = false;
  if (btfi_path_join(ctx, path, BTFI_MANIFEST_FILE, &file) != BTF_OK) return false;
  if (btfi_read_file(ctx, file, btfi_manifest_most_bytes, &text, &size) == BTF_OK)
    ours = btfi_manifest_is_ours(ctx, file, text, size, samples, samples_size);
  btfi_free(ctx, text);
  btfi_free(ctx, file);
  return ours;
}

btf_status btfi_folder_may_take(btf_context *ctx, const char *path, bool *exists) {
  struct stat entry;
  char samples[NAME_MAX + 1];
  if (exists) *exists = false;
  if (fault("stat") || lstat(path, &entry) != 0)
    return errno == ENOENT ? BTF_OK : fail_io(ctx, path, "cannot be looked at");
  if (exists) *exists = true;
  if (S_ISDIR(entry.st_mode) && find_samples(ctx, path, samples, sizeof samples)) return BTF_OK;
  return btfi_fail(ctx, BTF_E_IO, "%s: exists and is not a data-set folder; it is not replaced", path);
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

void btfi_folder_remove(btf_context *ctx, const char *folder, const char *const *files, int count) {
  /* Without the seam and without a result: nothing better can be done when cleaning up fails. */
  for (int i = 0; i < count; ++i) {
    char path[PATH_MAX];
    if (snprintf(path, sizeof path, "%s/%s", folder, files[i]) < (int)sizeof path) unlink(path);
  }
  if (rmdir(folder) != 0 && errno != ENOENT)
    btfi_log(ctx, BTF_LOG_WARNING, "%s: cannot be removed: %s", folder, strerror(errno));
}

/* Files beside a data set, such as notes or pictures, belong to somebody else. */
static void move_other_files(const char *from, const char *to, const char *samples) {
  DIR *folder = opendir(from);
  struct dirent *entry;
  char old_path[PATH_MAX], new_path[PATH_MAX];
  if (!folder) return;
  while ((entry = readdir(folder)) != NULL) {
    const char *name = entry->d_name;
    struct stat there;
    if (!strcmp(name, ".") || !strcmp(name, "..") || !strcmp(name, BTFI_MANIFEST_FILE) ||
        !strcmp(name, samples))
      continue;
    if (snprintf(old_path, sizeof old_path, "%s/%s", from, name) < (int)sizeof old_path &&
        snprintf(new_path, sizeof new_path, "%s/%s", to, name) < (int)sizeof new_path &&
        lstat(new_path, &there) != 0 && rename(old_path, new_path) != 0)
      continue;
  }
  closedir(folder);
}

static btf_status replace(btf_context *ctx, const char *temporary, const char *path) {
  char samples[NAME_MAX + 1];
  btfi_random random;
  if (!find_samples(ctx, path, samples, sizeof samples))
    return btfi_fail(ctx, BTF_E_IO, "%s: is no longer a data-set folder; it is not replaced", path);
  seed_names(&random);
  char *old = beside(ctx, path, "old", btfi_random_u64(&random));
  if (!old) return btfi_alloc_status();
  btf_status status = BTF_OK;
  if (btfi_sys_rename(AT_FDCWD, path, old) != 0) {
    status = fail_io(ctx, path, "cannot be replaced");
  } else if (btfi_sys_rename(AT_FDCWD, temporary, path) != 0) {
    status = fail_io(ctx, path, "cannot be put in place");
    if (rename(old, path) != 0)
      btfi_log(ctx, BTF_LOG_WARNING, "%s: the previous data set is now %s", path, old);
  } else {
    const char *const files[] = {BTFI_MANIFEST_FILE, samples};
    move_other_files(old, path, samples);
    btfi_folder_remove(ctx, old, files, 2);
  }
  btfi_free(ctx, old);
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

btf_status btfi_folder_place(btf_context *ctx, const char *temporary, const char *path) {
  bool exists;
  BTFI_TRY(btfi_folder_may_take(ctx, path, &exists));
  if (exists)
    BTFI_TRY(replace(ctx, temporary, path));
  else if (btfi_sys_rename(AT_FDCWD, temporary, path) != 0)
    return fail_io(ctx, path, "cannot be put in place");
  sync_parent(ctx, path);
  return BTF_OK;
}
