/* SPDX-License-Identifier: MIT */
#include "container_image.h"

#include <stdlib.h>
#include <string.h>

#include "base/base.h"
#include "btf_test.h"
#include "copy_codec.h"

enum { ENTRY = 64 };

void image_init(image *im) {
  memset(im, 0, sizeof *im);
  im->reported_size = -2;
}

void image_free(image *im) {
  free(im->bytes);
  image_init(im);
}

static void need(image *im, size_t size) {
  size_t capacity = im->capacity != 0 ? im->capacity : 4096;
  unsigned char *bytes;
  if (size <= im->capacity) return;
  while (capacity < size) capacity *= 2;
  bytes = aligned_alloc(4096, capacity);
  assert_non_null(bytes);
  memset(bytes, 0, capacity);
  if (im->size != 0) memcpy(bytes, im->bytes, im->size);
  free(im->bytes);
  im->bytes = bytes;
  im->capacity = capacity;
}

/* ---- btf_io ---- */

static int64_t image_size(void *user) {
  const image *im = user;
  return im->reported_size == -2 ? (int64_t)im->size : im->reported_size;
}

int64_t image_read_uncounted(void *user, void *dst, size_t n, uint64_t offset) {
  const image *im = user;
  size_t got;
  if (offset >= im->size) return 0;
  got = im->size - (size_t)offset < n ? im->size - (size_t)offset : n;
  if (got > 1000) got = 1000; /* short reads are legal */
  memcpy(dst, im->bytes + offset, got);
  return (int64_t)got;
}

static int64_t image_read(void *user, void *dst, size_t n, uint64_t offset) {
  image *im = user;
  if (++im->reads == im->fail_read) return -1;
  return image_read_uncounted(user, dst, n, offset);
}

static int64_t image_write(void *user, const void *src, size_t n, uint64_t offset) {
  image *im = user;
  if (++im->writes == im->fail_write) return -1;
  if (n > 1000) n = 1000; /* and so are short writes */
  need(im, (size_t)offset + n);
  memcpy(im->bytes + offset, src, n);
  if (offset + n > im->size) im->size = (size_t)offset + n;
  return (int64_t)n;
}

static const void *image_map(void *user, uint64_t offset, size_t n) {
  const image *im = user;
  return offset <= im->size && n <= im->size - offset ? im->bytes + offset : NULL;
}

static int32_t image_close(void *user, int32_t failed) {
  image *im = user;
  im->closes++;
  if (failed) im->failed_closes++;
  return im->fail_close ? -1 : 0;
}

btf_io image_sink(image *im) {
  btf_io io = BTF_IO_INIT;
  io.user = im;
  io.write = image_write;
  io.close = image_close;
  io.name = "image";
  return io;
}

btf_io image_source(image *im, int with_map) {
  btf_io io = BTF_IO_INIT;
  io.user = im;
  io.size = image_size;
  io.read = image_read;
  io.map = with_map ? image_map : NULL;
  io.close = image_close;
  io.name = "image";
  return io;
}

/* ---- making ---- */

void image_register_codecs(btf_context *ctx) {
  if (btf_codec_find(ctx, copy_codec.id) != NULL) return;
  assert_ok(btf_context_register(ctx, &copy_codec));
  assert_ok(btf_context_register(ctx, &copy_codec_single));
}

void image_of_model(btf_context *ctx, image *im, const char *storage, uint32_t width, uint32_t height,
                    uint32_t channels) {
  btf_dataset *ds;
  btf_options *options;
  btf_model *model;
  btf_writer *w;
  btf_io io;
  image_init(im);
  image_register_codecs(ctx);
  ds = copy_codec_dataset(ctx, width, height, channels, BTF_QUANTITY_BRDF);
  assert_non_null(ds);
  assert_ok(btf_options_create(btf_codec_find(ctx, copy_codec.id), &options));
  assert_ok(btf_options_set(options, "storage", storage));
  assert_ok(btf_model_fit(ds, btf_codec_find(ctx, copy_codec.id), options, NULL, &model));
  io = image_sink(im);
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  assert_ok(btf_writer_metadata(w, "btf.command", "btf encode"));
  assert_ok(btf_writer_metadata(w, "shop", "W\xc3\xbcrzburg"));
  assert_ok(btf_writer_model(w, model, NULL));
  assert_ok(btf_writer_finish(w));
  assert_int_equal(im->closes, 1);
  assert_int_equal(im->failed_closes, 0);
  btf_model_release(model);
  btf_options_release(options);
  btf_dataset_release(ds);
}

/* ---- patching ---- */

uint64_t image_get(const image *im, size_t offset, int bytes) {
  uint64_t value = 0;
  assert_true(offset + (size_t)bytes <= im->size);
  for (int i = 0; i < bytes; i++) value |= (uint64_t)im->bytes[offset + (size_t)i] << 8 * i;
  return value;
}

void image_put(image *im, size_t offset, int bytes, uint64_t value) {
  assert_true(offset + (size_t)bytes <= im->size);
  for (int i = 0; i < bytes; i++) im->bytes[offset + (size_t)i] = (unsigned char)(value >> 8 * i);
}

uint32_t image_chunks(const image *im) {
  return (uint32_t)image_get(im, 20, 4);
}
size_t image_entry(const image *im, uint32_t i) {
  return (size_t)image_get(im, 24, 8) + (size_t)i * ENTRY;
}

uint32_t image_find(const image *im, uint32_t type, uint32_t tag) {
  for (uint32_t i = 0; i < image_chunks(im); i++)
    if (image_get(im, image_entry(im, i), 4) == type &&
        (tag == 0 || image_get(im, image_entry(im, i) + 4, 4) == tag))
      return i;
  fail_msg("no chunk of type %08x", type);
  return 0;
}

void image_repair(image *im) {
  const size_t directory = (size_t)image_get(im, 24, 8), size = (size_t)image_get(im, 20, 4) * ENTRY;
  if (directory + size <= im->size) image_put(im, 48, 8, btfi_xxh64_of(im->bytes + directory, size));
  image_put(im, 56, 8, btfi_xxh64_of(im->bytes, 56));
  image_put(im, im->size - 24, 8, image_get(im, 24, 8));
  image_put(im, im->size - 16, 8, image_get(im, 40, 8));
  image_put(im, im->size - 8, 8, btfi_xxh64_of(im->bytes + im->size - 32, 24));
}

void image_put_entry(image *im, uint32_t i, size_t field, int bytes, uint64_t value) {
  const size_t entry = image_entry(im, i), head = (size_t)image_get(im, entry + 24, 8) - ENTRY;
  image_put(im, entry + field, bytes, value);
  image_put(im, entry + 56, 8, btfi_xxh64_of(im->bytes + entry, 56));
  memcpy(im->bytes + head, im->bytes + entry, ENTRY);
  image_repair(im);
}

void image_repair_chunk(image *im, uint32_t i) {
  const size_t entry = image_entry(im, i);
  image_put_entry(
      im, i, 48, 8,
      btfi_xxh64_of(im->bytes + image_get(im, entry + 24, 8), (size_t)image_get(im, entry + 32, 8)));
}

void image_replace_chunk(image *im, uint32_t i, const void *stored, size_t size, uint32_t method,
                         uint64_t raw) {
  const size_t entry = image_entry(im, i), offset = (size_t)image_get(im, entry + 24, 8);
  const size_t old_end = (offset + (size_t)image_get(im, entry + 32, 8) + 63) & ~(size_t)63;
  const size_t new_end = (offset + size + 63) & ~(size_t)63, rest = im->size - old_end;
  const uint32_t chunks = image_chunks(im);
  const int64_t shift = (int64_t)new_end - (int64_t)old_end;
  unsigned char *tail = malloc(rest);
  assert_non_null(tail);
  memcpy(tail, im->bytes + old_end, rest);
  need(im, new_end + rest);
  memset(im->bytes + offset, 0, new_end - offset);
  if (size != 0) memcpy(im->bytes + offset, stored, size);
  memcpy(im->bytes + new_end, tail, rest);
  free(tail);
  im->size = new_end + rest;
  image_put(im, 24, 8, image_get(im, 24, 8) + (uint64_t)shift);
  image_put(im, 40, 8, im->size);
  for (uint32_t k = i + 1; k < chunks; k++) {
    /* The head has moved already; the entry has yet to say so. */
    const size_t at = image_entry(im, k);
    image_put(im, at + 24, 8, image_get(im, at + 24, 8) + (uint64_t)shift);
    image_put_entry(im, k, 24, 8, image_get(im, at + 24, 8));
  }
  image_put_entry(im, i, 20, 4, method);
  image_put_entry(im, i, 32, 8, size);
  image_put_entry(im, i, 40, 8, raw);
  image_repair_chunk(im, i);
}

/* ---- reading ---- */

btf_status image_read_all(btf_context *ctx, image *im, int with_map) {
  const btf_io io = image_source(im, with_map);
  btf_query query = {{0.0f, 0.6f, 0.8f}, {0.6f, 0.0f, 0.8f}, {0.3f, 0.7f}, 0.0f, 0};
  float values[64];
  btf_file *file;
  btf_status status = btf_file_open(ctx, &io, 0, &file);
  if (status != BTF_OK) {
    assert_null(file);
    return status;
  }
  status = btf_file_validate(file, NULL, NULL);
  for (uint32_t i = 0; i < btf_file_model_count(file) && status == BTF_OK; i++) {
    btf_model *model;
    status = btf_file_load_model(file, i, &model);
    if (status == BTF_OK)
      btf_model_eval(model, &query, values);
    else
      assert_null(model);
    btf_model_release(model);
  }
  btf_file_close(file);
  return status;
}
