/* SPDX-License-Identifier: MIT */
/* sheet.h: a contact sheet of a reference beside its encodings and their differences. */
#ifndef BTF_TOOLS_SHEET_H
#define BTF_TOOLS_SHEET_H

#include "metrics.h"

typedef struct sheet_column {
  const sample_source *source;
  const char *name, *codec;
  uint64_t bytes;
  const metrics *result; /* NULL for the reference */
} sheet_column;

/* Columns: the reference, which comes first, the encodings, and the differences of these to the reference,
 * inverted and enlarged by the gain in their label. Rows: four lights seen from above, then the same seen
 * from aside. */
int sheet_write(const char *path, const sheet_column *columns, int count);

#endif
