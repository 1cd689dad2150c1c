/* SPDX-License-Identifier: MIT */
/* viewer_page.c: files of an export go into the page as elements of base64 text, which needs no escapes. */
#include "viewer_page.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cli.h"

static const char mark[] = "<!-- files -->";

/* A text that grows; text is NULL once memory ran out. */
typedef struct page_text {
  char *text;
  size_t size, room;
} page_text;

static void put(page_text *p, const char *text, size_t size) {
  if (p->text == NULL) return;
  if (size > p->room - p->size) {
    const size_t room = size > SIZE_MAX / 4 || p->room > SIZE_MAX / 4 ? 0 : 2 * p->room + size;
    char *grown = room > 0 ? realloc(p->text, room) : NULL;
    if (grown == NULL) {
      free(p->text);
      p->text = NULL;
      return;
    }
    p->text = grown;
    p->room = room;
  }
  memcpy(p->text + p->size, text, size);
  p->size += size;
}

static void put_base64(page_text *p, const void *data, size_t size) {
  static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  const unsigned char *bytes = data;
  for (size_t i = 0; i < size; i += 3) {
    const size_t left = size - i;
    const uint32_t group = (uint32_t)bytes[i] << 16 | (left > 1 ? (uint32_t)bytes[i + 1] << 8 : 0u) |
                           (left > 2 ? (uint32_t)bytes[i + 2] : 0u);
    const char four[4] = {digits[group >> 18], digits[group >> 12 & 63],
                          left > 1 ? digits[group >> 6 & 63] : '=', left > 2 ? digits[group & 63] : '='};
    put(p, four, sizeof four);
  }
}

static void put_file(page_text *p, const char *name, const char *ending, const void *data, size_t size) {
  char start[256];
  const int length =
      snprintf(start, sizeof start, "<script type=\"text/plain\" data-file=\"%s%s\">", name, ending);
  if (length > 0 && (size_t)length < sizeof start) put(p, start, (size_t)length);
  put_base64(p, data, size);
  put(p, "</script>\n", 10);
}

static btf_status put_files(const btf_gpu_export *e, int32_t zstd_level, page_text *p) {
  const char *manifest = btf_gpu_manifest(e), *shader = btf_gpu_glsl(e);
  put_file(p, "manifest.json", "", manifest, strlen(manifest));
  put_file(p, "btf.glsl", "", shader, strlen(shader));
  for (uint32_t i = 0; i < btf_gpu_texture_count(e); i++) {
    btf_gpu_texture t = BTF_GPU_TEXTURE_INIT;
    void *data;
    size_t size;
    btf_status status = btf_gpu_texture_at(e, i, &t);
    if (status == BTF_OK) status = btf_gpu_texture_ktx2(e, i, zstd_level, &data, &size);
    if (status != BTF_OK) return status;
    put_file(p, t.name, ".ktx2", data, size);
    btf_gpu_free(e, data);
  }
  return BTF_OK;
}

int viewer_page_create(const btf_gpu_export *e, int32_t zstd_level, char **page, size_t *size) {
  const char *head = (const char *)viewer_template, *after = strstr(head, mark);
  page_text p = {malloc(1 << 20), 0, 1 << 20};
  *page = NULL;
  if (after == NULL) {
    free(p.text);
    return cli_fail(EXIT_FAILED, "this build has no viewer page");
  }
  put(&p, head, (size_t)(after - head));
  const btf_status status = put_files(e, zstd_level, &p);
  if (status != BTF_OK) {
    free(p.text);
    return cli_fail_library(status);
  }
  after += sizeof mark - 1;
  put(&p, after, strlen(after));
  if (p.text == NULL) return cli_out_of_memory();
  *page = p.text;
  *size = p.size;
  return EXIT_DONE;
}
