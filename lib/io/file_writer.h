/* SPDX-License-Identifier: MIT */
#ifndef BTFI_FILE_WRITER_H
#define BTFI_FILE_WRITER_H

#include "io/io.h"

/* Fills `out` with a sink that appears under `path` as a whole or not at all. */
btf_status btfi_file_writer_open(btf_context *ctx, const char *path, btf_io *out);

#endif
