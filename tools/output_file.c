/* SPDX-License-Identifier: MIT */
#include "output_file.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cli.h"

static int fail_write(const output_file *out, const char *what) {
  return cli_fail(EXIT_IO, "%s: %s: %s", out->path, what, strerror(errno));
}

int output_open(output_file *out, const char *path) {
  struct stat existing;
  bool exists;
  int descriptor;
  const mode_t mask = umask(0);
  umask(mask);
  memset(out, 0, sizeof *out);
  exists = stat(path, &existing) == 0;
  if (exists && S_ISDIR(existing.st_mode))
    return cli_fail(EXIT_IO, "%s: is a folder; a file name was expected", path);
  /* Renaming would put a file in the place of a device. */
  if (exists && !S_ISREG(existing.st_mode))
    return cli_fail(EXIT_IO, "%s: is not a regular file and cannot be replaced", path);
  out->path = strdup(path);
  if (out->path == NULL || asprintf(&out->beside, "%s.XXXXXX", path) < 0) {
    out->beside = NULL;
    output_abort(out);
    return cli_out_of_memory();
  }
  cli_hold_interrupts();
  descriptor = mkstemp(out->beside);
  if (descriptor >= 0) {
    (void)fchmod(descriptor, 0666 & ~mask);
    out->stream = fdopen(descriptor, "wb");
    if (out->stream != NULL) return EXIT_DONE;
    close(descriptor);
    unlink(out->beside);
  }
  cli_release_interrupts();
  fail_write(out, "could not be created");
  output_abort(out);
  return EXIT_IO;
}

void output_abort(output_file *out) {
  if (out->stream != NULL) {
    fclose(out->stream);
    unlink(out->beside);
    cli_release_interrupts();
  }
  free(out->path);
  free(out->beside);
  memset(out, 0, sizeof *out);
}

int output_commit(output_file *out) {
  const bool written = fflush(out->stream) == 0 && !ferror(out->stream) && fsync(fileno(out->stream)) == 0;
  if (!written) {
    fail_write(out, "could not be written");
    output_abort(out);
    return EXIT_IO;
  }
  if (fclose(out->stream) != 0 || rename(out->beside, out->path) != 0) {
    fail_write(out, "could not be put in place");
    unlink(out->beside);
    out->stream = NULL;
    cli_release_interrupts();
    output_abort(out);
    return EXIT_IO;
  }
  out->stream = NULL;
  cli_release_interrupts();
  output_abort(out);
  return EXIT_DONE;
}

int output_write(const char *path, const void *data, size_t size) {
  output_file out;
  const int status = output_open(&out, path);
  if (status != EXIT_DONE) return status;
  /* A short write stays on record in the stream, where commit looks. */
  (void)!fwrite(data, 1, size, out.stream);
  return output_commit(&out);
}

int output_try(const char *path) {
  output_file probe;
  const int failed = output_open(&probe, path);
  if (!failed) output_abort(&probe);
  return failed;
}

bool output_ends_with(const char *path, const char *ending) {
  const size_t length = strlen(path), end = strlen(ending);
  return length > end && strcasecmp(path + length - end, ending) == 0;
}
