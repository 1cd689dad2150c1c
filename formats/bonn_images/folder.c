/* SPDX-License-Identifier: MIT */
/* folder.c: the files of a folder that are pictures. Links to folders are not followed. */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include "bonn_images/bonn_images.h"

enum { MOST_DEPTH = 4, MOST_FILES = 65536, MOST_PROBED = 256 };

/* Called for each file with its path below the top; not BTF_OK ends the walk. */
typedef btf_status (*visit_fn)(void *user, const char *path, int folder, const char *base);

typedef struct walk {
  visit_fn visit;
  void *user;
  char path[IMAGES_NAME_BYTES];
  int error;     /* of the system, when the walk itself failed */
  bool too_long; /* a path */
} walk;

static btf_status walk_folder(walk *w, int descriptor, size_t length, int depth);

static btf_status fail_walk(walk *w) {
  w->error = errno;
  return BTF_E_IO;
}

static btf_status walk_member(walk *w, int folder, const char *base, size_t length, int depth) {
  struct stat info;
  if (strcmp(base, ".") == 0 || strcmp(base, "..") == 0) return BTF_OK;
  if (fstatat(folder, base, &info, AT_SYMLINK_NOFOLLOW) != 0) return BTF_OK; /* gone in the meantime */
  const int written =
      snprintf(w->path + length, sizeof w->path - length, "%s%s", length > 0 ? "/" : "", base);
  if (written < 0 || (size_t)written >= sizeof w->path - length) {
    w->too_long = true;
    return BTF_E_LIMIT;
  }
  if (!S_ISDIR(info.st_mode)) return w->visit(w->user, w->path, folder, base);
  if (depth == MOST_DEPTH || base[0] == '.') return BTF_OK;
  const int inner = openat(folder, base, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  return inner < 0 ? fail_walk(w) : walk_folder(w, inner, length + (size_t)written, depth + 1);
}

/* Takes over the descriptor. */
static btf_status walk_folder(walk *w, int descriptor, size_t length, int depth) {
  DIR *folder = fdopendir(descriptor);
  btf_status status = BTF_OK;
  if (folder == NULL) {
    (void)fail_walk(w);
    close(descriptor);
    return BTF_E_IO;
  }
  for (struct dirent *member; status == BTF_OK && (errno = 0, member = readdir(folder)) != NULL;)
    status = walk_member(w, descriptor, member->d_name, length, depth);
  if (status == BTF_OK && errno != 0) status = fail_walk(w);
  closedir(folder);
  return status;
}

static btf_status add_file(void *user, const char *path, int folder, const char *base) {
  images_file *file = user;
  image_entry entry = {0};
  picture_fault fault = {BTF_OK, ""};
  struct stat info;
  const image_name name = images_parse_name(path, &entry.pair, &entry.counter_differs, &fault);
  if (name == IMAGE_NAME_OTHER && ++file->list.skipped <= MOST_FILES) return BTF_OK;
  if (file->list.skipped > MOST_FILES || file->list.count >= MOST_FILES)
    return (file->host->fail)(file->ctx, BTF_E_LIMIT, "%s: the folder has more than %d files", file->path,
                              MOST_FILES);
  if (name == IMAGE_NAME_BAD)
    return (file->host->fail)(file->ctx, fault.status, "%s: %s: %s", file->path, path, fault.why);
  if (fstatat(folder, base, &info, 0) != 0 || !S_ISREG(info.st_mode) || info.st_size < 0)
    return (file->host->fail)(file->ctx, BTF_E_IO, "%s: %s: is not a file that can be read", file->path,
                              path);
  entry.size = entry.packed = (uint64_t)info.st_size;
  return images_list_add(file, path, &entry);
}

typedef struct name_order {
  const image_list *list;
  uint64_t index;
} name_order;

static int by_name(const void *a, const void *b) {
  const name_order *first = a, *second = b;
  const image_list *list = first->list;
  return strcmp(list->text + list->entries[first->index].name,
                list->text + list->entries[second->index].name);
}

/* A folder lists its files in any order; by name they come as before on every machine. */
static btf_status sort_by_name(images_file *file) {
  image_list *list = &file->list;
  if (list->count == 0) return BTF_OK;
  name_order *order = (file->host->alloc)(file->ctx, list->count, sizeof *order);
  image_entry *sorted = (file->host->alloc)(file->ctx, list->count, sizeof *sorted);
  const bool there = order != NULL && sorted != NULL;
  if (there) {
    for (uint64_t i = 0; i < list->count; i++) order[i] = (name_order){list, i};
    qsort(order, list->count, sizeof *order, by_name);
    for (uint64_t i = 0; i < list->count; i++) sorted[i] = list->entries[order[i].index];
    memcpy(list->entries, sorted, list->count * sizeof *sorted);
  }
  (file->host->free)(file->ctx, order);
  (file->host->free)(file->ctx, sorted);
  return there ? BTF_OK : BTF_E_NOMEM;
}

btf_status images_list_folder(images_file *file) {
  walk w = {.visit = add_file, .user = file};
  const int descriptor = openat(file->descriptor, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0)
    return (file->host->fail)(file->ctx, BTF_E_IO, "%s: could not be read: %s", file->path, strerror(errno));
  const btf_status status = walk_folder(&w, descriptor, 0, 0);
  if (w.error != 0)
    return (file->host->fail)(file->ctx, status, "%s: %s: could not be read: %s", file->path, w.path,
                              strerror(w.error));
  if (w.too_long)
    return (file->host->fail)(file->ctx, status, "%s: a file's path has more than %zu bytes", file->path,
                              sizeof w.path - 1);
  return status == BTF_OK ? sort_by_name(file) : status;
}

typedef struct probing {
  uint32_t seen;
  bool found;
} probing;

static btf_status probe_file(void *user, const char *path, int folder, const char *base) {
  probing *p = user;
  uint32_t pair;
  bool differs;
  picture_fault fault;
  (void)folder, (void)base;
  p->found = images_parse_name(path, &pair, &differs, &fault) == IMAGE_NAME_PAIR;
  return p->found || ++p->seen >= MOST_PROBED ? BTF_E_STATE : BTF_OK;
}

bool images_folder_looks_right(const char *path) {
  probing p = {0, false};
  walk w = {.visit = probe_file, .user = &p};
  const int descriptor = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor >= 0) (void)!walk_folder(&w, descriptor, 0, 0);
  return p.found;
}
