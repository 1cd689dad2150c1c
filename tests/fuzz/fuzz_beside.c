/* SPDX-License-Identifier: MIT */
#include "fuzz_beside.h"

#include <fcntl.h>
#include <sys/stat.h>

#include "../../formats/source/test_picture.h"

static char folder[32]; /* in memory where the system has such a place */
static int folder_descriptor = -1;
static const char *const pictures[] = {"a.jpg",       "b.jpg",       "c.jpg",       "plane_0.jpg",
                                       "plane_1.jpg", "plane_2.jpg", "plane_3.jpg", "plane_4.jpg",
                                       "plane_5.jpg", "plane_6.jpg", "plane_7.jpg", "plane_8.jpg"};
enum { PICTURES = sizeof pictures / sizeof *pictures };
static unsigned char *picture;
static size_t picture_size;
static const char *input_name;

static unsigned char code(const void *user, int column, int row, int channel) {
  (void)user;
  return (unsigned char)(90 + 31 * column + 17 * row + 41 * channel);
}

static void put(const char *name, const void *data, size_t size) {
  const int file = openat(folder_descriptor, name, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
  fuzz_expect(file >= 0 && write(file, data, size) == (ssize_t)size);
  close(file);
}

static void remove_all(void) {
  for (int i = 0; i < PICTURES; i++) unlinkat(folder_descriptor, pictures[i], 0);
  unlinkat(folder_descriptor, input_name, 0);
  close(folder_descriptor);
  rmdir(folder);
  free(picture);
}

static void make_folder(void) {
  snprintf(folder, sizeof folder, "/dev/shm/btf-fuzz-XXXXXX");
  if (mkdtemp(folder) == NULL) {
    snprintf(folder, sizeof folder, "/tmp/btf-fuzz-XXXXXX");
    fuzz_expect(mkdtemp(folder) != NULL);
  }
  folder_descriptor = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  fuzz_expect(folder_descriptor >= 0);
  picture = test_squares_jpeg(8, 8, 3, code, NULL, &picture_size);
  for (int i = 0; i < PICTURES; i++) put(pictures[i], picture, picture_size);
  atexit(remove_all);
}

fuzz_file fuzz_beside_make(const char *name, const char *changed, const uint8_t *data, size_t size) {
  const uint8_t *end = size > 0 ? memchr(data, '\0', size) : NULL;
  const size_t text = end != NULL ? (size_t)(end - data) : size;
  fuzz_file file = {-1, ""};
  input_name = name;
  if (folder_descriptor < 0) make_folder();
  put(name, data, text);
  if (end != NULL)
    put(changed, end + 1, size - text - 1);
  else
    put(changed, picture, picture_size);
  snprintf(file.path, sizeof file.path, "%s/%s", folder, name);
  return file;
}
