/* SPDX-License-Identifier: MIT */
/* Containers: what is written comes back, damage is found wherever it is, and nothing half-written stays. */
#include "btf_test.h"

#include "container_image.h"
#include "copy_codec.h"
#include "model/model.h"

#include <pthread.h>
#include <sys/mman.h>
#include <unistd.h>

/* ---- round trips ---- */

static void description_comes_back(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_chunk_info chunk = {sizeof chunk, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};
  const char *key, *value;
  btf_dirset *set;
  btf_file *file;
  btf_io io;
  image im;
  (void)state;
  image_of_model(ctx, &im, "plain", 5, 4, 3);
  io = image_source(&im, 1);
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  assert_int_equal(btf_file_model_count(file), 1);
  assert_string_equal(btf_file_model_codec(file, 0), "org.libbtf.copy");
  assert_null(btf_file_model_codec(file, 1));
  assert_ok(btf_file_describe_model(file, 0, &info));
  assert_int_equal(info.width, 5);
  assert_int_equal(info.height, 4);
  assert_int_equal(info.channels, 3);
  assert_int_equal(info.quantity, BTF_QUANTITY_BRDF);
  assert_int_equal(info.wrap, BTF_WRAP_PERIODIC);
  assert_string_equal(info.color_space, "lin_rec709");
  assert_string_equal(info.channel_names[2], "B");
  assert_string_equal(info.name, "test cloth");
  assert_null(info.source);
  assert_string_equal(info.license, "CC0");
  assert_true(info.texels_per_mm == 2.5);
  assert_int_equal(info.levels, 0);
  assert_int_equal(info.resident_bytes, 0);
  assert_ptr_equal(info.lights, info.views); /* equal sets are stored once */
  assert_ok(btf_dirset_create_named(ctx, "grid:3x2", &set));
  assert_memory_equal(btf_dirset_directions(info.lights), btf_dirset_directions(set), 6 * 3 * sizeof(float));
  btf_dirset_release(set);
  assert_status(btf_file_describe_model(file, 1, &info), BTF_E_INVALID_ARG);
  assert_string_equal(btf_file_metadata(file, "btf.command"), "btf encode");
  assert_string_equal(btf_file_metadata(file, "btf.writer"), "libbtf 0.1.0");
  assert_string_equal(btf_file_metadata(file, "shop"), "W\xc3\xbcrzburg");
  assert_null(btf_file_metadata(file, "shops"));
  assert_int_equal(btf_file_metadata_count(file), 3);
  assert_ok(btf_file_metadata_at(file, 1, &key, &value));
  assert_string_equal(key, "shop");
  assert_status(btf_file_metadata_at(file, 3, &key, &value), BTF_E_INVALID_ARG);
  assert_null(key);
  assert_int_equal(btf_file_chunk_count(file), 6); /* DIRS, MODL, three DATA, META */
  for (uint32_t i = 0; i < 6; i++) {
    assert_ok(btf_file_chunk(file, i, &chunk));
    assert_int_equal(chunk.offset % 64, 0);
  }
  assert_ok(btf_file_chunk(file, 2, &chunk));
  assert_int_equal(chunk.type, BTF_TAG('D', 'A', 'T', 'A'));
  assert_int_equal(chunk.tag, BTF_TAG('S', 'M', 'P', 'L'));
  assert_int_equal(chunk.raw, 36 * 20 * 3 * 4);
  assert_int_equal(chunk.method, 0);
  assert_status(btf_file_chunk(file, 6, &chunk), BTF_E_INVALID_ARG);
  assert_int_equal(im.closes, 1);
  btf_file_close(file);
  assert_int_equal(im.closes, 2); /* once for writing, once for reading */
  image_free(&im);
  test_context_done(ctx, &memory);
}

static void packed_chunks_shrink(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_chunk_info chunk = {sizeof chunk, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0};
  btf_file *file;
  btf_io io;
  image im;
  (void)state;
  image_of_model(ctx, &im, "packed", 16, 16, 3);
  io = image_source(&im, 0);
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  assert_ok(btf_file_chunk(file, 2, &chunk));
  assert_int_equal(chunk.method, 1);
  assert_true(chunk.stored < chunk.raw / 2);
  assert_ok(btf_file_validate(file, NULL, NULL));
  btf_file_close(file);
  assert_ok(image_read_all(ctx, &im, 1));
  image_free(&im);
  test_context_done(ctx, &memory);
}

static void same_input_same_bytes(void **state) {
  test_memory memory[2];
  image first, second;
  (void)state;
  for (int packed = 0; packed < 2; packed++) {
    btf_context *one = test_context_with(&memory[0], "scalar", 1),
                *many = test_context_with(&memory[1], NULL, 7);
    image_of_model(one, &first, packed ? "packed" : "plain", 16, 8, 3);
    image_of_model(many, &second, packed ? "packed" : "plain", 16, 8, 3);
    assert_int_equal(first.size, second.size);
    assert_memory_equal(first.bytes, second.bytes, first.size);
    image_free(&first);
    image_free(&second);
    test_context_done(one, &memory[0]);
    test_context_done(many, &memory[1]);
  }
}

/* ---- damage ---- */

/* Every bit of the file, one at a time. A damaged container is malformed, never newer or unsupported. */
static void every_bit_flip(void **state) {
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  (void)state;
  for (int packed = 0; packed < 2; packed++) {
    image im;
    image_of_model(ctx, &im, packed ? "packed" : "plain", packed ? 3 : 1, packed ? 2 : 1, 1);
    assert_ok(image_read_all(ctx, &im, 1));
    for (size_t bit = 0; bit < 8 * im.size; bit++) {
      btf_status status;
      im.bytes[bit / 8] ^= (unsigned char)(1u << bit % 8);
      status = image_read_all(ctx, &im, bit % 2 != 0);
      if (status / 10 != 2) fail_msg("bit %zu of %zu: %s", bit, 8 * im.size, btf_status_name(status));
      im.bytes[bit / 8] ^= (unsigned char)(1u << bit % 8);
    }
    assert_ok(image_read_all(ctx, &im, 1));
    image_free(&im);
  }
  test_context_done(ctx, &memory);
}

static void every_truncation(void **state) {
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  image im;
  size_t whole;
  (void)state;
  image_of_model(ctx, &im, "packed", 3, 2, 1);
  whole = im.size;
  for (int unknown_size = 0; unknown_size < 2; unknown_size++) {
    im.reported_size = unknown_size ? -1 : -2;
    for (im.size = 0; im.size < whole; im.size++) assert_status(image_read_all(ctx, &im, 0), BTF_E_TRUNCATED);
    im.size = whole;
    assert_ok(image_read_all(ctx, &im, 0));
    im.size = whole + 1; /* the image has room for more */
    assert_status(image_read_all(ctx, &im, 0), BTF_E_CORRUPT);
    im.size = whole;
  }
  image_free(&im);
  test_context_done(ctx, &memory);
}

typedef struct findings {
  uint32_t issue[64];
  int32_t severity[64];
  uint64_t offset[64];
  uint32_t count;
} findings;

static void note_finding(void *user, uint32_t issue, int32_t severity, uint64_t offset, const char *text) {
  findings *f = user;
  assert_non_null(text);
  assert_true(f->count < 64);
  f->issue[f->count] = issue;
  f->severity[f->count] = severity;
  f->offset[f->count++] = offset;
}

/* Flips a byte, validates, and expects one finding of a number and a message that names the chunk. */
static void expect_issue(btf_context *ctx, image *im, size_t byte, uint32_t issue, const char *named) {
  findings found = {{0}, {0}, {0}, 0};
  const btf_io io = image_source(im, 0);
  btf_file *file;
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  im->bytes[byte] ^= 0x10;
  assert_status(btf_file_validate(file, note_finding, &found), BTF_E_CORRUPT);
  assert_message_has(named);
  assert_int_equal(found.count, 1);
  assert_int_equal(found.issue[0], issue);
  assert_int_equal(found.severity[0], BTF_LOG_ERROR);
  im->bytes[byte] ^= 0x10;
  found.count = 0;
  assert_ok(btf_file_validate(file, note_finding, &found));
  assert_int_equal(found.count, 0);
  btf_file_close(file);
}

static void validation_names_the_place(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  image im;
  uint32_t samples;
  size_t offset, stored;
  (void)state;
  image_of_model(ctx, &im, "packed", 3, 2, 1);
  samples = image_find(&im, BTF_TAG('D', 'A', 'T', 'A'), BTF_TAG('S', 'M', 'P', 'L'));
  offset = (size_t)image_get(&im, image_entry(&im, samples) + 24, 8);
  stored = (size_t)image_get(&im, image_entry(&im, samples) + 32, 8);
  assert_true((offset + stored) % 64 != 0);
  expect_issue(ctx, &im, offset + stored, 11, "padding");
  expect_issue(ctx, &im, offset - 3, 12, "chunk DATA SMPL 0 of model 0 at offset ");
  expect_issue(ctx, &im, offset + 5, 13, "chunk DATA SMPL 0 of model 0 at offset ");
  image_free(&im);
  test_context_done(ctx, &memory);
}

/* ---- byte sources and sinks that fail ---- */

static void every_write_fails_once(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds = copy_codec_dataset(ctx, 5, 4, 3, BTF_QUANTITY_BRDF);
  btf_model *model;
  long n = 0;
  btf_status status;
  (void)state;
  image_register_codecs(ctx);
  assert_ok(btf_model_fit(ds, btf_codec_find(ctx, copy_codec.id), NULL, NULL, &model));
  do {
    image im;
    btf_io io;
    btf_writer *w;
    image_init(&im);
    im.fail_write = ++n;
    io = image_sink(&im);
    status = btf_writer_open(ctx, &io, 0, &w);
    if (status == BTF_OK) {
      status = btf_writer_model(w, model, NULL);
      if (status == BTF_OK) {
        status = btf_writer_finish(w);
      } else {
        assert_status(btf_writer_metadata(w, "a", "b"), BTF_E_IO);
        assert_status(btf_writer_finish(w), BTF_E_IO); /* a failed writer does not finish */
      }
    }
    assert_int_equal(im.closes, 1);
    assert_int_equal(im.failed_closes, status != BTF_OK);
    if (status != BTF_OK)
      assert_int_equal(status, BTF_E_IO);
    else
      assert_true(im.writes < n);
    image_free(&im);
  } while (status != BTF_OK);
  assert_true(n > 20);
  btf_model_release(model);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void close_that_fails(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_writer *w;
  btf_io io;
  image im;
  (void)state;
  image_init(&im);
  im.fail_close = 1;
  io = image_sink(&im);
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  assert_status(btf_writer_finish(w), BTF_E_IO);
  assert_int_equal(im.closes, 1);
  image_free(&im);
  io = image_sink(&im);
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  btf_writer_abort(w);
  assert_int_equal(im.failed_closes, 1);
  btf_writer_abort(NULL);
  io = image_sink(&im);
  assert_status(btf_writer_open(ctx, &io, 23, &w), BTF_E_INVALID_ARG);
  assert_null(w);
  assert_int_equal(im.failed_closes, 2);
  image_free(&im);
  test_context_done(ctx, &memory);
}

static void every_read_fails_once(void **state) {
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  image im;
  long n = 0;
  btf_status status;
  (void)state;
  image_of_model(ctx, &im, "packed", 5, 4, 3);
  do {
    im.closes = im.reads = 0;
    im.fail_read = ++n;
    status = image_read_all(ctx, &im, 0);
    assert_int_equal(im.closes, 1);
    if (status != BTF_OK) assert_int_equal(status, BTF_E_IO);
  } while (status != BTF_OK);
  assert_true(n > 20);
  image_free(&im);
  test_context_done(ctx, &memory);
}

static void sources_without_map_or_size(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  image im;
  (void)state;
  image_of_model(ctx, &im, "plain", 5, 4, 3);
  for (int map = 0; map < 2; map++)
    for (int sized = 0; sized < 2; sized++) {
      btf_io io = image_source(&im, map);
      btf_file *file;
      btf_model *model;
      const float *samples;
      if (!sized) io.size = NULL;
      assert_ok(btf_file_open(ctx, &io, 0, &file));
      assert_ok(btf_file_load_model(file, 0, &model));
      btf_file_close(file); /* the model keeps the source */
      assert_int_equal(im.closes, 1);
      samples = copy_codec_samples(model->state);
      assert_int_equal((uintptr_t)samples % 64, 0);
      assert_int_equal((const unsigned char *)samples >= im.bytes &&
                           (const unsigned char *)samples < im.bytes + im.size,
                       map);
      assert_true(samples[7] == copy_codec_sample(0, 0, 2, 0, 1));
      btf_model_release(model);
      assert_int_equal(im.closes, 2);
      im.closes = 1;
    }
  image_free(&im);
  test_context_done(ctx, &memory);
}

typedef struct loading {
  const btf_file *file;
  btf_status status;
  float value[3];
} loading;

static void *load_and_read(void *user) {
  loading *l = user;
  btf_model *model;
  l->status = btf_file_load_model(l->file, 0, &model);
  if (l->status == BTF_OK) btf_model_texel(model, 0, 3, 2, 1, 4, l->value);
  btf_model_release(model);
  return NULL;
}

/* Loading is const: threads share one open file, and the chunks it unpacks. */
static void threads_load_one_file(void **state) {
  enum { THREADS = 8 };
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  loading loads[THREADS];
  pthread_t threads[THREADS];
  btf_file *file;
  btf_io io;
  image im;
  (void)state;
  image_of_model(ctx, &im, "packed", 5, 4, 3);
  io = image_source(&im, 0);
  io.read = image_read_uncounted;
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  for (int i = 0; i < THREADS; i++) {
    loads[i] = (loading){file, BTF_E_STATE, {0.0f, 0.0f, 0.0f}};
    assert_int_equal(pthread_create(&threads[i], NULL, load_and_read, &loads[i]), 0);
  }
  for (int i = 0; i < THREADS; i++) {
    assert_int_equal(pthread_join(threads[i], NULL), 0);
    assert_int_equal(loads[i].status, BTF_OK);
    assert_true(loads[i].value[2] == copy_codec_sample(4, 1, 3, 2, 2));
  }
  btf_file_close(file);
  image_free(&im);
  test_context_done(ctx, &memory);
}

/* A mapping that is not aligned to 64 bytes cannot be used in place; the chunk is read instead. */
static void unaligned_memory(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_io io = BTF_IO_INIT;
  btf_file *file;
  btf_model *model;
  unsigned char *moved;
  image im;
  (void)state;
  image_of_model(ctx, &im, "plain", 5, 4, 3);
  moved = malloc(im.size + 64);
  assert_non_null(moved);
  memcpy(moved + 4, im.bytes, im.size);
  assert_ok(btf_io_memory(ctx, moved + 4, im.size, &io));
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  assert_ok(btf_file_load_model(file, 0, &model));
  assert_int_equal((uintptr_t)copy_codec_samples(model->state) % 64, 0);
  btf_model_release(model);
  btf_file_close(file);
  free(moved);
  image_free(&im);
  test_context_done(ctx, &memory);
}

/* With BTF_OPEN_TRUST the samples are not touched by opening and loading: their pages cannot even be read. */
static void trusted_payload_is_not_read(void **state) {
  const size_t page = (size_t)sysconf(_SC_PAGESIZE);
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_file *file;
  btf_model *model;
  size_t offset, first, last, size;
  unsigned char *mapped;
  btf_io io = BTF_IO_INIT;
  image im;
  float value[3];
  uint32_t samples;
  (void)state;
  image_of_model(ctx, &im, "plain", 16, 16, 3);
  size = (im.size + page - 1) / page * page;
  mapped = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  assert_true(mapped != MAP_FAILED);
  memcpy(mapped, im.bytes, im.size);
  samples = image_find(&im, BTF_TAG('D', 'A', 'T', 'A'), BTF_TAG('S', 'M', 'P', 'L'));
  offset = (size_t)image_get(&im, image_entry(&im, samples) + 24, 8);
  first = (offset + page - 1) / page * page;
  last = (offset + (size_t)image_get(&im, image_entry(&im, samples) + 32, 8)) / page * page;
  assert_true(last > first);
  assert_int_equal(mprotect(mapped + first, last - first, PROT_NONE), 0);
  assert_ok(btf_io_memory(ctx, mapped, im.size, &io));
  assert_ok(btf_file_open(ctx, &io, BTF_OPEN_TRUST, &file));
  assert_ok(btf_file_load_model(file, 0, &model));
  assert_ptr_equal(copy_codec_samples(model->state), mapped + offset);
  assert_int_equal(mprotect(mapped + first, last - first, PROT_READ | PROT_WRITE), 0);
  btf_model_texel(model, 0, 3, 9, 4, 2, value);
  assert_true(value[1] == copy_codec_sample(2, 4, 3, 9, 1));
  btf_model_release(model);
  btf_file_close(file);
  /* Without trust a damaged sample is found when the model is loaded. */
  mapped[first + 1] ^= 1;
  assert_ok(btf_io_memory(ctx, mapped, im.size, &io));
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  assert_status(btf_file_load_model(file, 0, &model), BTF_E_CORRUPT);
  assert_message_has("chunk DATA SMPL 0 of model 0");
  btf_file_close(file);
  munmap(mapped, size);
  image_free(&im);
  test_context_done(ctx, &memory);
}

/* ---- copying ---- */

static void copy_to(btf_context *ctx, image *out, image *const *sources, int count) {
  btf_writer *w;
  btf_io io;
  image_init(out);
  io = image_sink(out);
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  for (int i = 0; i < count; i++) {
    btf_file *file;
    const btf_io source = image_source(sources[i], 0);
    assert_ok(btf_file_open(ctx, &source, 0, &file));
    assert_ok(btf_writer_copy(w, file));
    btf_file_close(file);
  }
  assert_ok(btf_writer_finish(w));
}

static void copy_is_the_same(void **state) {
  test_memory memory, other_memory;
  btf_context *ctx = test_context(&memory), *bare = test_context(&other_memory);
  (void)state;
  for (int packed = 0; packed < 2; packed++) {
    image im, copy, *source = &im;
    image_of_model(ctx, &im, packed ? "packed" : "plain", 5, 4, 3);
    copy_to(bare, &copy, &source, 1); /* this context does not know the codec */
    assert_int_equal(copy.size, im.size);
    assert_memory_equal(copy.bytes, im.bytes, im.size);
    image_free(&im);
    image_free(&copy);
  }
  test_context_done(ctx, &memory);
  test_context_done(bare, &other_memory);
}

static void two_files_become_one(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  image first, second, both, *sources[2] = {&first, &second};
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_model *model;
  btf_file *file;
  btf_io io;
  (void)state;
  image_of_model(ctx, &first, "plain", 5, 4, 3);
  image_of_model(ctx, &second, "packed", 8, 6, 1);
  copy_to(ctx, &both, sources, 2);
  assert_ok(image_read_all(ctx, &both, 1));
  io = image_source(&both, 1);
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  assert_int_equal(btf_file_model_count(file), 2);
  assert_int_equal(btf_file_chunk_count(file), 10); /* one DIRS, two MODL, six DATA, one META */
  for (uint32_t i = 0; i < 2; i++) {
    float value[3];
    assert_ok(btf_file_load_model(file, i, &model));
    assert_ok(btf_model_describe(model, &info));
    assert_int_equal(info.width, i == 0 ? 5 : 8);
    btf_model_texel(model, 0, 4, 3, 1, 5, value);
    assert_true(value[0] == copy_codec_sample(5, 1, 4, 3, 0));
    btf_model_release(model);
  }
  btf_file_close(file);
  image_free(&first);
  image_free(&second);
  image_free(&both);
  test_context_done(ctx, &memory);
}

static void unknown_things_are_kept(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  image im, copy, twice, *sources[2] = {&im, &im};
  findings found = {{0}, {0}, {0}, 0};
  uint32_t meta, unknown;
  btf_file *file;
  btf_writer *w;
  btf_io io;
  (void)state;
  image_of_model(ctx, &im, "plain", 5, 4, 3);
  /* The metadata chunk becomes one of a type of the future, with an optional flag and a method of its own. */
  meta = image_find(&im, BTF_TAG('M', 'E', 'T', 'A'), 0);
  image_put_entry(&im, meta, 0, 4, BTF_TAG('N', 'E', 'W', '!'));
  image_put_entry(&im, meta, 8, 4, 77);
  image_put_entry(&im, meta, 12, 4, 0x40000000u);
  image_put_entry(&im, meta, 20, 4, 9);
  image_put(&im, 10, 2, 3);          /* minor version */
  image_put(&im, 16, 4, 0x80000001); /* optional features */
  image_repair(&im);
  io = image_source(&im, 0);
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  assert_ok(btf_file_validate(file, note_finding, &found));
  assert_int_equal(found.count, 3);
  assert_int_equal(found.issue[0], 22);
  assert_int_equal(found.issue[1], 21);
  assert_int_equal(found.issue[2], 20);
  assert_int_equal(found.severity[2], BTF_LOG_INFO);
  btf_file_close(file);
  copy_to(ctx, &copy, sources, 1);
  assert_int_equal(image_get(&copy, 16, 4), 0x80000001);
  unknown = image_find(&copy, BTF_TAG('N', 'E', 'W', '!'), 0);
  assert_int_equal(image_get(&copy, image_entry(&copy, unknown) + 8, 4), 77);
  assert_int_equal(image_get(&copy, image_entry(&copy, unknown) + 12, 4), 0x40000000u);
  assert_int_equal(image_get(&copy, image_entry(&copy, unknown) + 20, 4), 9);
  assert_memory_equal(copy.bytes + image_get(&copy, image_entry(&copy, unknown) + 24, 8),
                      im.bytes + image_get(&im, image_entry(&im, meta) + 24, 8),
                      (size_t)image_get(&im, image_entry(&im, meta) + 32, 8));
  assert_ok(image_read_all(ctx, &copy, 0));
  /* Two chunks of the same unknown name cannot both be kept, and dropping one would be worse than refusing.
   */
  image_init(&twice);
  io = image_sink(&twice);
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  io = image_source(&im, 0);
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  assert_ok(btf_writer_copy(w, file));
  assert_status(btf_writer_copy(w, file), BTF_E_STATE);
  btf_file_close(file);
  btf_writer_abort(w);
  image_free(&im);
  image_free(&copy);
  image_free(&twice);
  test_context_done(ctx, &memory);
}

static void damage_does_not_get_copied(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  image im, copy;
  btf_file *file;
  btf_writer *w;
  btf_io io;
  (void)state;
  image_of_model(ctx, &im, "plain", 5, 4, 3);
  image_init(&copy);
  io = image_sink(&copy);
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  io = image_source(&im, 0);
  assert_ok(btf_file_open(ctx, &io, 0, &file));
  im.bytes[image_get(&im, image_entry(&im, 2) + 24, 8) + 100] ^= 1;
  assert_status(btf_writer_copy(w, file), BTF_E_CORRUPT);
  assert_message_has("SMPL");
  assert_status(btf_writer_finish(w), BTF_E_CORRUPT);
  assert_int_equal(copy.failed_closes, 1);
  btf_file_close(file);
  image_free(&im);
  image_free(&copy);
  test_context_done(ctx, &memory);
}

static void metadata_rules(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  char long_key[300];
  btf_file *file;
  btf_writer *w;
  btf_io io;
  image im;
  (void)state;
  memset(long_key, 'k', sizeof long_key);
  long_key[256] = '\0';
  image_init(&im);
  io = image_sink(&im);
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  assert_status(btf_writer_metadata(w, "", "x"), BTF_E_INVALID_ARG);
  assert_status(btf_writer_metadata(w, long_key, "x"), BTF_E_INVALID_ARG);
  assert_status(btf_writer_metadata(w, "k", "\xff"), BTF_E_INVALID_ARG);
  assert_status(btf_writer_metadata(w, "k", "\xed\xa0\x80"), BTF_E_INVALID_ARG); /* a lone surrogate */
  assert_status(btf_writer_metadata(w, "k", "\xc0\xaf"), BTF_E_INVALID_ARG);     /* overlong */
  assert_status(btf_writer_metadata(w, NULL, "x"), BTF_E_INVALID_ARG);
  long_key[255] = '\0';
  assert_ok(btf_writer_metadata(w, long_key, ""));
  assert_ok(btf_writer_metadata(w, "k", "first"));
  assert_ok(btf_writer_metadata(w, "k", "second\nline\t\xf0\x9f\xa7\xb5"));
  for (int i = 0; i < 1022; i++) {
    char key[16];
    snprintf(key, sizeof key, "n%d", i);
    assert_ok(btf_writer_metadata(w, key, "x"));
  }
  assert_status(btf_writer_metadata(w, "one more", "x"), BTF_E_LIMIT);
  btf_writer_abort(w);
  image_free(&im);
  io = image_sink(&im);
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  assert_ok(btf_writer_metadata(w, "k", "first"));
  assert_ok(btf_writer_metadata(w, "k", "second"));
  assert_ok(btf_writer_finish(w));
  io = image_source(&im, 0);
  assert_ok(btf_file_open(ctx, &io, 0, &file)); /* a container without models is one */
  assert_int_equal(btf_file_model_count(file), 0);
  assert_string_equal(btf_file_metadata(file, "k"), "second");
  btf_file_close(file);
  image_free(&im);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(description_comes_back),
      cmocka_unit_test(packed_chunks_shrink),
      cmocka_unit_test(same_input_same_bytes),
      cmocka_unit_test(every_bit_flip),
      cmocka_unit_test(every_truncation),
      cmocka_unit_test(validation_names_the_place),
      cmocka_unit_test(every_write_fails_once),
      cmocka_unit_test(close_that_fails),
      cmocka_unit_test(every_read_fails_once),
      cmocka_unit_test(sources_without_map_or_size),
      cmocka_unit_test(threads_load_one_file),
      cmocka_unit_test(unaligned_memory),
      cmocka_unit_test(trusted_payload_is_not_read),
      cmocka_unit_test(copy_is_the_same),
      cmocka_unit_test(two_files_become_one),
      cmocka_unit_test(unknown_things_are_kept),
      cmocka_unit_test(damage_does_not_get_copied),
      cmocka_unit_test(metadata_rules),
  };
  return btf_run("container", tests);
}
