/* SPDX-License-Identifier: MIT */
/* folder.h: folders that appear as a whole or not at all, and file-system calls for them behind the same test
 * seam; they set errno like the calls they are named after. */
#ifndef BTFI_IO_FOLDER_H
#define BTFI_IO_FOLDER_H

#include <sys/stat.h>

#include "io/io.h"

/* folder / name, to be freed with btfi_free. */
btf_status btfi_path_join(btf_context *ctx, const char *folder, const char *name, char **out);
int btfi_folder_stat(const char *path, struct stat *entry);

/* What kind of folder is made: only an earlier one of the same kind is replaced. */
typedef struct btfi_folder_kind {
  const char *title; /* "data-set folder" */
  /* BTF_OK if the folder is of this kind, and BTF_E_NOMEM where that cannot be found out; everything else is
   * "no". Appends the names of its own files, each with its NUL. */
  btf_status (*find)(btf_context *ctx, const struct btfi_folder_kind *kind, const char *path,
                     btfi_buffer *files);
} btfi_folder_kind;

/* BTF_OK when nothing is at `path`, or a folder of the kind, which may be replaced. *exists may be NULL. */
btf_status btfi_folder_may_take(btf_context *ctx, const btfi_folder_kind *kind, const char *path,
                                bool *exists);
/* Makes the folder .NAME.tmp-XXXXXX beside `path` and returns its path, to be freed with btfi_free. */
btf_status btfi_folder_make_beside(btf_context *ctx, const char *path, char **out);
/* Renames the finished folder to `path`. A previous one there goes, other files in it move over. */
btf_status btfi_folder_place(btf_context *ctx, const btfi_folder_kind *kind, const char *temporary,
                             const char *path);
/* Removes the named files (each with its NUL, `size` bytes in all) and the folder, as far as they exist. */
void btfi_folder_remove(btf_context *ctx, const char *folder, const char *files, uint64_t size);

#endif
