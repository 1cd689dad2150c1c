/* SPDX-License-Identifier: MIT */
/* line_source.h: lines of a file or of standard input, as many at a time as have arrived. */
#ifndef BTF_TOOLS_LINE_SOURCE_H
#define BTF_TOOLS_LINE_SOURCE_H

#include "cli.h"

typedef struct line_source {
  const char *name; /* for messages */
  int descriptor;
  bool at_end;
  uint64_t line; /* number of the line line_next returned, from 1 */
  char *buffer;
  size_t begin, end; /* unread part of the buffer */
} line_source;

/* path NULL or "-" = standard input. */
int line_source_open(line_source *source, const char *path);
void line_source_close(line_source *source);

/* Waits for more input. Returns EXIT_DONE; then line_next gives what came, and at_end tells that nothing
 * follows. */
int line_source_fill(line_source *source);
/* The next complete line, NUL-terminated, without its line break (LF or CRLF); NULL = call line_source_fill.
 * Lines that are empty or begin with '#' are passed over. */
char *line_next(line_source *source);

/* "NAME: line N: ..." with EXIT_MALFORMED. */
int line_fail(const line_source *source, const char *format, ...) LIBBTF_PRINTF(2, 3);

#endif
