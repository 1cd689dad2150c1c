/* SPDX-License-Identifier: MIT */
/* container_image.h: containers in memory for tests: written through a sink that can fail, patched with right
 * checksums, read through sources of several kinds. */
#ifndef CONTAINER_IMAGE_H
#define CONTAINER_IMAGE_H

#include <btf/btf.h>

/* A growing file in memory, and what happened to it. */
typedef struct image {
  unsigned char *bytes; /* page-aligned, so that in-place chunks are aligned as in a file's mapping */
  size_t size, capacity;
  long writes, reads, closes, failed_closes;
  long fail_write, fail_read; /* the call with this number (from 1) fails; 0 = none */
  int fail_close;
  int64_t reported_size; /* what size() says; -2 = the true size */
} image;

void image_init(image *im);
void image_free(image *im);
btf_io image_sink(image *im);
btf_io image_source(image *im, int with_map);
/* A read function for sources that several threads use: it neither counts nor fails. */
int64_t image_read_uncounted(void *user, void *dst, size_t n, uint64_t offset);

/* Fits a copy_codec model ("plain" or "packed" storage) of width x height texels and writes it with metadata.
 */
void image_of_model(btf_context *ctx, image *im, const char *storage, uint32_t width, uint32_t height,
                    uint32_t channels);
void image_register_codecs(btf_context *ctx);

/* Little-endian numbers of `bytes` bytes. */
uint64_t image_get(const image *im, size_t offset, int bytes);
void image_put(image *im, size_t offset, int bytes, uint64_t value);

uint32_t image_chunks(const image *im);
/* Offset of entry i in the directory; its head is 64 bytes before its stored bytes. */
size_t image_entry(const image *im, uint32_t i);
/* The first chunk of a type (and tag unless 0). */
uint32_t image_find(const image *im, uint32_t type, uint32_t tag);
/* Changes a field of an entry in the directory and in the head alike, with all checksums made right again. */
void image_put_entry(image *im, uint32_t i, size_t field, int bytes, uint64_t value);
/* Makes the checksum of chunk i's stored bytes, and all above it, right again. */
void image_repair_chunk(image *im, uint32_t i);
void image_repair(image *im); /* directory, footer and header checksums */
/* Replaces the stored bytes of chunk i by `size` others; method and raw size are set as given. */
void image_replace_chunk(image *im, uint32_t i, const void *bytes, size_t size, uint32_t method,
                         uint64_t raw);

/* Opens, validates, loads and evaluates everything; the first status that is not BTF_OK. */
btf_status image_read_all(btf_context *ctx, image *im, int with_map);

#endif
