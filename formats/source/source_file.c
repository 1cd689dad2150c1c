/* SPDX-License-Identifier: MIT */
#include "source/source_file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

static btf_status fail_system(source_file *file) {
  const int error = errno;
  const btf_status status =
      (file->host->fail)(file->ctx, BTF_E_IO, "%s: could not be read: %s", file->path, strerror(error));
  source_file_close(file);
  return status;
}

btf_status source_file_open(const btf_host *host, btf_context *ctx, const char *path, source_file *out) {
  struct stat info;
  *out = (source_file){.host = host, .ctx = ctx};
  const size_t length = strlen(path) + 1;
  out->path = (host->alloc)(ctx, length, 1);
  if (out->path == NULL) return BTF_E_NOMEM;
  memcpy(out->path, path, length);
  /* A pipe must not be waited for. */
  const int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) return fail_system(out);
  if (fstat(fd, &info) != 0 || !S_ISREG(info.st_mode)) {
    if (!S_ISREG(info.st_mode)) errno = EINVAL;
    close(fd);
    return fail_system(out);
  }
  out->size = (uint64_t)info.st_size;
  if (out->size > 0) {
    void *data = mmap(NULL, out->size, PROT_READ, MAP_PRIVATE, fd, 0);
    if (data == MAP_FAILED) {
      close(fd);
      out->size = 0;
      return fail_system(out);
    }
    out->data = data;
  }
  close(fd);
  return BTF_OK;
}

btf_status source_file_open_beside(const source_file *file, const char *name, source_file *out) {
  const char *slash = strrchr(file->path, '/');
  const size_t folder = slash != NULL ? (size_t)(slash - file->path) + 1 : 0, size = strlen(name) + 1;
  char *path = (file->host->alloc)(file->ctx, folder + size, 1);
  if (path == NULL) return BTF_E_NOMEM;
  memcpy(path, file->path, folder);
  memcpy(path + folder, name, size);
  const btf_status status = source_file_open(file->host, file->ctx, path, out);
  const bool there = status == BTF_OK || access(path, F_OK) == 0;
  (file->host->free)(file->ctx, path);
  if (status == BTF_OK || status == BTF_E_NOMEM) return status;
  return (file->host->fail)(file->ctx, there ? status : BTF_E_CORRUPT, "%s: %s %s", file->path, name,
                            there ? "could not be read" : "is missing beside it");
}

void source_file_close(source_file *file) {
  if (file->data != NULL) munmap((void *)(uintptr_t)file->data, file->size);
  if (file->path != NULL) (file->host->free)(file->ctx, file->path);
  file->data = NULL;
  file->path = NULL;
}

void source_name(const char *path, char name[SOURCE_NAME_BYTES]) {
  size_t end = strlen(path);
  while (end > 1 && path[end - 1] == '/') end--;
  size_t begin = end;
  while (begin > 0 && path[begin - 1] != '/') begin--;
  const size_t length = end - begin < SOURCE_NAME_BYTES ? end - begin : SOURCE_NAME_BYTES - 1;
  snprintf(name, SOURCE_NAME_BYTES, "%.*s", (int)length, path + begin);
}

uint64_t cursor_left(const cursor *c) {
  return c->ended ? 0 : c->file->size - c->at;
}

const unsigned char *cursor_take(cursor *c, uint64_t count, uint64_t size) {
  uint64_t bytes;
  if (__builtin_mul_overflow(count, size, &bytes) || bytes > cursor_left(c)) {
    c->ended = true;
    return NULL;
  }
  const unsigned char *data = c->file->data + c->at;
  c->at += bytes;
  return data;
}

uint8_t cursor_u8(cursor *c) {
  const unsigned char *p = cursor_take(c, 1, 1);
  return p != NULL ? *p : 0;
}

uint32_t cursor_u32(cursor *c) {
  const unsigned char *p = cursor_take(c, 1, 4);
  return p != NULL ? btf_get_u32(p) : 0;
}

float cursor_f32(cursor *c) {
  const unsigned char *p = cursor_take(c, 1, 4);
  return p != NULL ? btf_get_f32(p) : 0;
}

void cursor_word(cursor *c, char word[CURSOR_WORD_BYTES]) {
  size_t length = 0;
  while (cursor_left(c) > 0 && is_blank(c->file->data[c->at])) c->at++;
  while (cursor_left(c) > 0 && !is_blank(c->file->data[c->at])) {
    const char letter = (char)cursor_u8(c);
    if (length < CURSOR_WORD_BYTES - 1) word[length++] = letter;
  }
  word[length] = '\0';
}

void cursor_line_end(cursor *c) {
  uint8_t letter = cursor_u8(c);
  if (letter == ' ' || letter == '\t') letter = cursor_u8(c);
  if (letter == '\r') letter = cursor_u8(c);
  if (letter != '\n') c->ended = true;
}

bool cursor_count(cursor *c, uint32_t most, uint32_t *out) {
  char word[CURSOR_WORD_BYTES];
  double value;
  cursor_word(c, word);
  if (!(c->file->host->number)(word, &value) || !(value >= 1 && value <= most) || value != floor(value))
    return false;
  *out = (uint32_t)value;
  return true;
}
