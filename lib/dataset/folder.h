/* SPDX-License-Identifier: MIT */
/* folder.h: data-set folders on disk. File-system calls that the io layer does not have, behind the same test
 * seam; they set errno like the calls they are named after. */
#ifndef BTFI_FOLDER_H
#define BTFI_FOLDER_H

#include <sys/stat.h>

#include "base/base.h"
#include "io/io.h"

/* folder / name, to be freed with btfi_free. */
btf_status btfi_path_join(btf_context *ctx, const char *folder, const char *name, char **out);
int btfi_folder_stat(const char *path, struct stat *entry);

/* folder_place.c: a new folder beside its final place. */

/* BTF_OK when nothing is at `path`, or a data-set folder, which may be replaced. *exists may be NULL. */
btf_status btfi_folder_may_take(btf_context *ctx, const char *path, bool *exists);
/* Makes the folder .NAME.tmp-XXXXXX beside `path` and returns its path, to be freed with btfi_free. */
btf_status btfi_folder_make_beside(btf_context *ctx, const char *path, char **out);
/* Renames the finished folder to `path`. A previous data set there goes, other files in its folder move over.
 */
btf_status btfi_folder_place(btf_context *ctx, const char *temporary, const char *path);
/* Removes the named files and the folder, as far as they exist. */
void btfi_folder_remove(btf_context *ctx, const char *folder, const char *const *files, int count);

#endif
