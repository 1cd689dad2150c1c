/* SPDX-License-Identifier: MIT */
/* Runs a fuzz target over the files named, and over the files of the folders named, in the order of their
 * names. */
#include "fuzz.h"

#include <dirent.h>
#include <errno.h>
#include <string.h>
#include <sys/stat.h>

static size_t inputs;

static void die(const char *path) {
  fprintf(stderr, "%s: %s\n", path, strerror(errno));
  exit(2);
}

static void run_file(const char *path, size_t size) {
  FILE *file = fopen(path, "rb");
  uint8_t *data =
      malloc(size ? size : 1); /* of exactly this size, so that a sanitizer sees a read past the end */
  if (!file || !data || fread(data, 1, size, file) != size) die(path);
  fclose(file);
  fprintf(stderr, "%s\n", path); /* the last name is the guilty one */
  LLVMFuzzerTestOneInput(data, size);
  free(data);
  inputs++;
}

static int is_visible(const struct dirent *entry) {
  return entry->d_name[0] != '.';
}

static void run_path(const char *path) {
  struct stat entry;
  struct dirent **names;
  if (stat(path, &entry) != 0) die(path);
  if (!S_ISDIR(entry.st_mode)) {
    run_file(path, (size_t)entry.st_size);
    return;
  }
  const int count = scandir(path, &names, is_visible, alphasort);
  if (count < 0) die(path);
  for (int i = 0; i < count; i++) {
    const size_t length = strlen(path) + strlen(names[i]->d_name) + 2;
    char *child = malloc(length);
    if (!child) die(path);
    snprintf(child, length, "%s/%s", path, names[i]->d_name);
    run_path(child);
    free(child);
    free(names[i]);
  }
  free(names);
}

int main(int argc, char **argv) {
  const uint8_t nothing = 0;
  LLVMFuzzerTestOneInput(&nothing, 0);
  for (int i = 1; i < argc; i++) run_path(argv[i]);
  printf("%zu inputs\n", inputs);
  if (inputs > 0) return 0;
  fprintf(stderr, "no inputs; expected files or folders of them\n");
  return 2;
}
