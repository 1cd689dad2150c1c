/* SPDX-License-Identifier: MIT */
/* fuzz_file.h: an input as a file in memory, for readers that take a path. */
#ifndef BTF_FUZZ_FILE_H
#define BTF_FUZZ_FILE_H

#include "fuzz.h"

#include <sys/mman.h>
#include <unistd.h>

typedef struct fuzz_file {
  int descriptor; /* -1 if it is a file of a folder, which stays */
  char path[64];
} fuzz_file;

static inline fuzz_file fuzz_file_make(const uint8_t *data, size_t size) {
  fuzz_file file = {memfd_create("input", MFD_CLOEXEC), ""};
  fuzz_expect(file.descriptor >= 0);
  fuzz_expect(write(file.descriptor, data, size) == (ssize_t)size);
  snprintf(file.path, sizeof file.path, "/proc/self/fd/%d", file.descriptor);
  return file;
}

static inline void fuzz_file_drop(fuzz_file *file) {
  if (file->descriptor >= 0) close(file->descriptor);
}

#endif
