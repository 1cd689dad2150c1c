/* SPDX-License-Identifier: MIT */
/* new_folder.h: a folder of files given whole, which appears complete or not at all; the host table has it
 * for formats (btf_plugin.h). */
#ifndef BTFI_IO_NEW_FOLDER_H
#define BTFI_IO_NEW_FOLDER_H

#include "io/folder.h"

typedef struct btf_new_folder btf_new_folder;
btf_status btfi_new_folder_begin(btf_context *ctx, const char *path, const char *title,
                                 int32_t (*is_own)(const char *name), btf_new_folder **out);
/* A folder that `kind` tells apart, which may hold files of other names beside its own. */
btf_status btfi_new_folder_begin_kind(btf_context *ctx, const char *path, const btfi_folder_kind *kind,
                                      btf_new_folder **out);
btf_status btfi_new_folder_put(btf_new_folder *folder, const char *name, const void *data, uint64_t size);
btf_status btfi_new_folder_end(btf_new_folder *folder, int32_t failed);

#endif
