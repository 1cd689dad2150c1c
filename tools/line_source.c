/* SPDX-License-Identifier: MIT */
#include "line_source.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { buffer_size = 1 << 20 };

int line_source_open(line_source *source, const char *path) {
  memset(source, 0, sizeof *source);
  if (path == NULL || strcmp(path, "-") == 0) {
    source->name = "standard input";
    source->descriptor = STDIN_FILENO;
  } else {
    source->name = path;
    source->descriptor = open(path, O_RDONLY | O_CLOEXEC);
    if (source->descriptor < 0)
      return cli_fail(EXIT_IO, "%s: could not be opened: %s", path, strerror(errno));
  }
  source->buffer = malloc(buffer_size + 1);
  if (source->buffer != NULL) return EXIT_DONE;
  line_source_close(source);
  return cli_out_of_memory();
}

void line_source_close(line_source *source) {
  if (source->descriptor > STDIN_FILENO) close(source->descriptor);
  free(source->buffer);
  memset(source, 0, sizeof *source);
}

int line_source_fill(line_source *source) {
  ssize_t got;
  memmove(source->buffer, source->buffer + source->begin, source->end - source->begin);
  source->end -= source->begin;
  source->begin = 0;
  if (source->end == buffer_size) {
    source->line++;
    return line_fail(source, "longer than %d bytes", buffer_size);
  }
  do got = read(source->descriptor, source->buffer + source->end, buffer_size - source->end);
  while (got < 0 && errno == EINTR && !cli_interrupted());
  if (got < 0) return cli_fail(EXIT_IO, "%s: could not be read: %s", source->name, strerror(errno));
  if (got == 0) {
    source->at_end = true;
    /* A last line without a line break counts. */
    if (source->end > 0 && source->buffer[source->end - 1] != '\n') source->buffer[source->end++] = '\n';
  }
  source->end += (size_t)got;
  return EXIT_DONE;
}

char *line_next(line_source *source) {
  for (;;) {
    char *line = source->buffer + source->begin;
    char *line_end = memchr(line, '\n', source->end - source->begin);
    char *first = line;
    if (line_end == NULL) return NULL;
    source->begin = (size_t)(line_end + 1 - source->buffer);
    source->line++;
    if (line_end > line && line_end[-1] == '\r') line_end--;
    /* A NUL inside must not hide what follows it. */
    for (char *nul = line; (nul = memchr(nul, '\0', (size_t)(line_end - nul))) != NULL;) *nul = '?';
    *line_end = '\0';
    while (*first == ' ' || *first == '\t') first++;
    if (*first != '\0' && *first != '#') return first;
  }
}

int line_fail(const line_source *source, const char *format, ...) {
  char text[512];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  return cli_fail(EXIT_MALFORMED, "%s: line %" PRIu64 ": %s", source->name, source->line, text);
}
