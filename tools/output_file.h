/* SPDX-License-Identifier: MIT */
/* output_file.h: a file that appears at its place complete or not at all. */
#ifndef BTF_TOOLS_OUTPUT_FILE_H
#define BTF_TOOLS_OUTPUT_FILE_H

#include <stdbool.h>
#include <stdio.h>

typedef struct output_file {
  FILE *stream;
  char *path, *beside; /* final place, and the temporary file in the same folder */
} output_file;

/* Creates the temporary file. Interruptions are held until commit or abort. */
int output_open(output_file *out, const char *path);
/* Whether the file could be created: a place that cannot be written is better found before hours of work. */
int output_try(const char *path);
/* Flushes, syncs and renames; on failure removes the file. */
int output_commit(output_file *out);
/* Removes the temporary file; fine on a zeroed struct and after commit. */
void output_abort(output_file *out);
/* Whether a path has more than the ending, and the ending in small letters or capitals. */
bool output_ends_with(const char *path, const char *ending);
/* All of the above for bytes in memory. */
int output_write(const char *path, const void *data, size_t size);

#endif
