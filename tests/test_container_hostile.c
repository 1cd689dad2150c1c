/* SPDX-License-Identifier: MIT */
/* Containers made to mislead: every field wrong in turn, with all checksums right. */
#include "btf_test.h"

#include "base/base.h"
#include "container_image.h"
#include "copy_codec.h"

#include <zstd.h>

enum {
  TYPE_DATA = BTF_TAG('D', 'A', 'T', 'A'),
  TYPE_MODEL = BTF_TAG('M', 'O', 'D', 'L'),
  TYPE_DIRS = BTF_TAG('D', 'I', 'R', 'S'),
  TYPE_META = BTF_TAG('M', 'E', 'T', 'A'),
  TAG_SAMPLES = BTF_TAG('S', 'M', 'P', 'L')
};

/* Fields of an entry. */
enum {
  E_TYPE = 0,
  E_TAG = 4,
  E_INDEX = 8,
  E_FLAGS = 12,
  E_MODEL = 16,
  E_METHOD = 20,
  E_OFFSET = 24,
  E_STORED = 32,
  E_RAW = 40
};

typedef struct fixture {
  test_memory memory;
  btf_context *ctx;
  image im;
} fixture;

static void begin(fixture *f, const char *storage) {
  f->ctx = test_context_with(&f->memory, NULL, 1);
  image_of_model(f->ctx, &f->im, storage, 5, 4, 3);
  assert_ok(image_read_all(f->ctx, &f->im, 1));
}

static void end(fixture *f) {
  image_free(&f->im);
  test_context_done(f->ctx, &f->memory);
}

/* Reads the image and expects a status, without more than 1 MiB of memory on the way, and puts the bytes
 * back. */
static void expect(fixture *f, btf_status expected, const char *part) {
  uint64_t peak_before, peak_after;
  test_memory fresh_memory;
  btf_context *fresh = test_context_with(&fresh_memory, NULL, 1);
  btf_status status;
  image_register_codecs(fresh);
  btf_context_memory(fresh, NULL, &peak_before);
  status = image_read_all(fresh, &f->im, 1);
  if (status != expected)
    fail_msg("%s instead of %s: %s", btf_status_name(status), btf_status_name(expected), btf_error_message());
  if (part != NULL) assert_message_has(part);
  btf_context_memory(fresh, NULL, &peak_after);
  assert_true(peak_after < 3u << 20); /* validation's buffer is 1 MiB, the file has less than 0.1 MiB */
  test_context_done(fresh, &fresh_memory);
}

typedef struct change {
  size_t offset;
  int bytes;
  uint64_t value;
  btf_status expected;
  const char *part;
} change;

static void header_fields(void **state) {
  fixture f;
  const unsigned char crlf[] = {0x93, 'B', 'T', 'Z', '\n', 0x1a, '\n', 1};
  unsigned char *saved;
  (void)state;
  begin(&f, "plain");
  saved = malloc(f.im.size);
  assert_non_null(saved);
  memcpy(saved, f.im.bytes, f.im.size);
  {
    const uint64_t directory = image_get(&f.im, 24, 8);
    const change changes[] = {
        {8, 2, 2, BTF_E_NEWER, "version 2.0"},
        {8, 2, 0, BTF_E_CORRUPT, "version 0"},
        {10, 2, 65535, BTF_OK, NULL},
        {12, 4, 1, BTF_E_NEWER, "features"},
        {12, 4, 0x80000000u, BTF_E_NEWER, "features"},
        {16, 4, 0xffffffffu, BTF_OK, NULL},
        {20, 4, 0, BTF_E_CORRUPT, "directory"},
        {20, 4, 5, BTF_E_CORRUPT, "directory"},
        {20, 4, 7, BTF_E_CORRUPT, "directory"},
        {20, 4, 65536, BTF_E_CORRUPT, "directory"},
        {20, 4, 65537, BTF_E_LIMIT, "65537 chunks"},
        {20, 4, 0xffffffffu, BTF_E_LIMIT, "4294967295 chunks"},
        {24, 8, 0, BTF_E_TRUNCATED, "never finished"},
        {24, 8, directory + 64, BTF_E_CORRUPT, "directory"},
        {24, 8, directory - 64, BTF_E_CORRUPT, "directory"},
        {24, 8, UINT64_MAX - 63, BTF_E_CORRUPT, "directory"},
        {24, 8, (uint64_t)INT64_MAX - 63, BTF_E_CORRUPT, "directory"},
        {32, 8, 0, BTF_E_CORRUPT, "directory"},
        {32, 8, UINT64_MAX, BTF_E_CORRUPT, "directory"},
        {40, 8, f.im.size + 1, BTF_E_TRUNCATED, "the end is missing"},
        {40, 8, UINT64_MAX, BTF_E_TRUNCATED, "the end is missing"},
        {40, 8, f.im.size - 1, BTF_E_CORRUPT, "follows the end"},
        {40, 8, 0, BTF_E_CORRUPT, "follows the end"},
    };
    for (size_t i = 0; i < sizeof changes / sizeof *changes; i++) {
      image_put(&f.im, changes[i].offset, changes[i].bytes, changes[i].value);
      image_put(&f.im, 56, 8, btfi_xxh64_of(f.im.bytes, 56)); /* the header alone: the rest must object */
      expect(&f, changes[i].expected, changes[i].part);
      memcpy(f.im.bytes, saved, f.im.size);
    }
  }
  /* The same without right checksums is damage, not another version. */
  image_put(&f.im, 8, 2, 2);
  expect(&f, BTF_E_CORRUPT, "checksum");
  memcpy(f.im.bytes, saved, f.im.size);
  memcpy(f.im.bytes, crlf, sizeof crlf);
  expect(&f, BTF_E_CORRUPT, "text mode");
  memcpy(f.im.bytes, "PK\3\4", 4);
  expect(&f, BTF_E_NOT_BTF, "not a .btfz container");
  memcpy(f.im.bytes, saved, f.im.size);
  f.im.bytes[f.im.size - 20] ^= 1;
  expect(&f, BTF_E_CORRUPT, "footer");
  free(saved);
  end(&f);
}

static void short_files_of_other_kinds(void **state) {
  static const char *const texts[] = {"x", "hello",
                                      "not a container at all, and yet longer than a signature"};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  (void)state;
  for (size_t i = 0; i < 3; i++)
    for (int sized = 0; sized < 2; sized++) {
      image im;
      image_init(&im);
      im.bytes = (unsigned char *)(uintptr_t)texts[i];
      im.size = strlen(texts[i]);
      im.reported_size = sized ? -2 : -1;
      /* Without a size the end shows only when the signature cannot be read whole. */
      assert_status(image_read_all(ctx, &im, 0), sized || im.size >= 8 ? BTF_E_NOT_BTF : BTF_E_TRUNCATED);
    }
  test_context_done(ctx, &memory);
}

static void entry_fields(void **state) {
  fixture f;
  unsigned char *saved;
  (void)state;
  begin(&f, "plain");
  saved = malloc(f.im.size);
  assert_non_null(saved);
  memcpy(saved, f.im.bytes, f.im.size);
  {
    const uint32_t samples = image_find(&f.im, TYPE_DATA, TAG_SAMPLES),
                   model = image_find(&f.im, TYPE_MODEL, 0), dirs = image_find(&f.im, TYPE_DIRS, 0),
                   meta = image_find(&f.im, TYPE_META, 0);
    const struct {
      uint32_t chunk;
      change c;
    } changes[] = {
        {samples, {E_METHOD, 4, 2, BTF_E_NEWER, "method 2"}},
        {samples, {E_METHOD, 4, 1, BTF_E_CORRUPT, "in place"}},
        {samples, {E_FLAGS, 4, 0, BTF_OK, NULL}},
        {samples, {E_FLAGS, 4, 4, BTF_E_NEWER, "flags"}},
        {samples, {E_FLAGS, 4, 0x00010002u, BTF_OK, NULL}},
        {samples, {E_RAW, 8, 1, BTF_E_CORRUPT, "not packed"}},
        {samples, {E_STORED, 8, UINT64_MAX, BTF_E_CORRUPT, "do not fit"}},
        {samples, {E_STORED, 8, UINT64_MAX - 4096, BTF_E_CORRUPT, "do not fit"}},
        {samples, {E_STORED, 8, 0, BTF_E_CORRUPT, NULL}},
        {samples, {E_INDEX, 4, 1, BTF_E_CORRUPT, "missing in the model"}},
        {samples, {E_MODEL, 4, 1, BTF_E_CORRUPT, "the file has 1 models"}},
        {samples, {E_MODEL, 4, 0xffffffffu, BTF_E_CORRUPT, "the file has 1 models"}},
        {samples, {E_TYPE, 4, BTF_TAG('Z', 'Z', 'Z', 'Z'), BTF_E_CORRUPT, "2 payload chunks"}},
        {model, {E_TYPE, 4, BTF_TAG('Z', 'Z', 'Z', 'Z'), BTF_E_CORRUPT, "the file has 0 models"}},
        {model, {E_MODEL, 4, 1, BTF_E_CORRUPT, "the file has 1 models"}},
        {model, {E_INDEX, 4, 1, BTF_E_CORRUPT, "index 0"}},
        {model, {E_TAG, 4, 1, BTF_E_CORRUPT, "no tag"}},
        {dirs, {E_INDEX, 4, 1, BTF_E_CORRUPT, "without gaps"}},
        {dirs, {E_MODEL, 4, 0, BTF_E_CORRUPT, "belongs to the file"}},
        {dirs, {E_TYPE, 4, BTF_TAG('Z', 'Z', 'Z', 'Z'), BTF_E_CORRUPT, "direction set"}},
        {meta, {E_INDEX, 4, 2, BTF_E_CORRUPT, "one metadata chunk"}},
        {meta, {E_MODEL, 4, 0, BTF_E_CORRUPT, "belongs to the file"}},
        {meta, {E_TYPE, 4, TYPE_MODEL, BTF_E_CORRUPT, NULL}},
    };
    for (size_t i = 0; i < sizeof changes / sizeof *changes; i++) {
      const change *c = &changes[i].c;
      image_put_entry(&f.im, changes[i].chunk, c->offset, c->bytes, c->value);
      expect(&f, c->expected, c->part);
      memcpy(f.im.bytes, saved, f.im.size);
    }
    /* Unknown and critical. */
    image_put_entry(&f.im, meta, E_TYPE, 4, BTF_TAG('N', 'E', 'W', '!'));
    expect(&f, BTF_OK, NULL);
    image_put_entry(&f.im, meta, E_FLAGS, 4, 1);
    expect(&f, BTF_E_NEWER, "NEW!");
    memcpy(f.im.bytes, saved, f.im.size);
    /* Two chunks of one name. */
    image_put_entry(&f.im, samples + 1, E_TAG, 4, TAG_SAMPLES);
    image_put_entry(&f.im, samples + 1, E_INDEX, 4, 0);
    expect(&f, BTF_E_CORRUPT, "occurs twice");
    memcpy(f.im.bytes, saved, f.im.size);
    /* Offsets that point elsewhere; the head cannot follow, so only the directory is changed. */
    for (int k = 0; k < 4; k++) {
      const uint64_t offset = image_get(&f.im, image_entry(&f.im, samples) + E_OFFSET, 8);
      const uint64_t others[] = {offset + 64, offset - 64, 0, UINT64_MAX - 63};
      image_put(&f.im, image_entry(&f.im, samples) + E_OFFSET, 8, others[k]);
      image_put(&f.im, image_entry(&f.im, samples) + 56, 8,
                btfi_xxh64_of(f.im.bytes + image_entry(&f.im, samples), 56));
      image_repair(&f.im);
      expect(&f, BTF_E_CORRUPT, "do not fit");
      memcpy(f.im.bytes, saved, f.im.size);
    }
    /* An entry's own checksum. */
    f.im.bytes[image_entry(&f.im, meta) + 60] ^= 1;
    image_repair(&f.im);
    expect(&f, BTF_E_CORRUPT, "directory entry");
  }
  free(saved);
  end(&f);
}

static void model_header_fields(void **state) {
  fixture f;
  unsigned char *saved;
  size_t at;
  uint32_t model;
  (void)state;
  begin(&f, "plain");
  saved = malloc(f.im.size);
  assert_non_null(saved);
  memcpy(saved, f.im.bytes, f.im.size);
  model = image_find(&f.im, TYPE_MODEL, 0);
  at = (size_t)image_get(&f.im, image_entry(&f.im, model) + E_OFFSET, 8);
  {
    const change changes[] = {
        {0, 4, 1, BTF_OK, NULL}, /* the codec reads payload versions 1 and 2 */
        {0, 4, 3, BTF_E_NEWER, "payload version 3"},
        {0, 4, 0, BTF_E_UNSUPPORTED, "payload version 0"},
        {4, 4, 0, BTF_E_CORRUPT, "none may be 0"},
        {4, 4, 6, BTF_E_CORRUPT, "bytes of samples"},
        {4, 4, 65537, BTF_E_LIMIT, "65537"},
        {8, 4, 0xffffffffu, BTF_E_LIMIT, "4294967295"},
        {12, 4, 0, BTF_E_CORRUPT, "none may be 0"},
        {12, 4, 65, BTF_E_LIMIT, "65 channels"},
        {12, 4, 0xffffffffu, BTF_E_LIMIT, "channels"},
        {12, 4, 64, BTF_E_CORRUPT, NULL},
        {16, 4, 0, BTF_E_CORRUPT, "quantity 0"},
        {16, 4, 3, BTF_E_CORRUPT, "quantity 3"},
        {20, 4, 2, BTF_E_CORRUPT, "scale 2"},
        {24, 4, 2, BTF_E_CORRUPT, "wrap 2"},
        {28, 4, 1, BTF_E_CORRUPT, "direction set 1"},
        {32, 4, 0xffffffffu, BTF_E_CORRUPT, "direction set"},
        {36, 4, 2, BTF_E_CORRUPT, "3 payload chunks"},
        {36, 4, 4, BTF_E_CORRUPT, "3 payload chunks"},
        {40, 8, 0x7ff8000000000000u, BTF_E_CORRUPT, "texels per mm"},
        {40, 8, 0x7ff0000000000000u, BTF_E_CORRUPT, "texels per mm"},
        {40, 8, 0xbff0000000000000u, BTF_E_CORRUPT, "texels per mm"},
        {56, 8, 12345, BTF_OK, NULL}, /* reserved: ignored */
        {64, 4, 0, BTF_E_CORRUPT, NULL},
        {64, 4, 0xffffffffu, BTF_E_CORRUPT, "text"},
        {64, 4, 65535, BTF_E_CORRUPT, "ends within"},
        {68, 1, 'O', BTF_E_CORRUPT, "codec id"},
        {68, 1, 0, BTF_E_CORRUPT, "UTF-8"},
        {68, 1, 0xff, BTF_E_CORRUPT, "UTF-8"},
        {68, 1, 'p', BTF_E_UNKNOWN_CODEC, "\"prg.libbtf.copy\""},
    };
    for (size_t i = 0; i < sizeof changes / sizeof *changes; i++) {
      image_put(&f.im, at + changes[i].offset, changes[i].bytes, changes[i].value);
      image_repair_chunk(&f.im, model);
      expect(&f, changes[i].expected, changes[i].part);
      memcpy(f.im.bytes, saved, f.im.size);
    }
  }
  /* Bytes after the last text belong to a later version and are no fault; a chunk cut anywhere is. */
  for (size_t size = 0; size <= image_get(&f.im, image_entry(&f.im, model) + E_STORED, 8) + 9; size++) {
    const size_t whole = (size_t)image_get(&f.im, image_entry(&f.im, model) + E_STORED, 8);
    unsigned char *bytes = calloc(1, size + 1);
    image shorter = {0};
    assert_non_null(bytes);
    memcpy(bytes, f.im.bytes + at, size < whole ? size : whole);
    shorter = f.im;
    shorter.bytes = NULL;
    shorter.capacity = shorter.size = 0;
    {
      btf_io sink = image_sink(&shorter);
      for (size_t done = 0; done < f.im.size;)
        done += (size_t)sink.write(sink.user, f.im.bytes + done, f.im.size - done, done);
    }
    image_replace_chunk(&shorter, model, bytes, size, 0, size);
    assert_status(image_read_all(f.ctx, &shorter, 1), size < whole ? BTF_E_CORRUPT : BTF_OK);
    image_free(&shorter);
    free(bytes);
  }
  free(saved);
  end(&f);
}

static void direction_sets(void **state) {
  fixture f;
  float xyz[18];
  uint32_t dirs;
  size_t at;
  (void)state;
  begin(&f, "plain");
  dirs = image_find(&f.im, TYPE_DIRS, 0);
  at = (size_t)image_get(&f.im, image_entry(&f.im, dirs) + E_OFFSET, 8);
  memcpy(xyz, f.im.bytes + at, sizeof xyz);
  {
    const float wrong[][3] = {{0.6f, 0.0f, -0.8f},
                              {0.6f, 0.0f, 0.7f},
                              {NAN, 0.0f, 1.0f},
                              {xyz[3] + 1e-5f, xyz[4], xyz[5]}, /* too close to the second */
                              {0.0f, 0.0f, INFINITY}};
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
      memcpy(f.im.bytes + at, wrong[i], sizeof wrong[i]);
      image_repair_chunk(&f.im, dirs);
      expect(&f, BTF_E_CORRUPT, "chunk DIRS 0 at offset 128");
    }
  }
  memcpy(f.im.bytes + at, xyz + 3, 3 * sizeof *xyz); /* the second again */
  image_repair_chunk(&f.im, dirs);
  expect(&f, BTF_OK, NULL);
  memcpy(f.im.bytes + at, xyz, sizeof xyz);
  image_replace_chunk(&f.im, dirs, xyz, 70, 0, 70);
  expect(&f, BTF_E_CORRUPT, "whole number of directions");
  image_replace_chunk(&f.im, dirs, xyz, 0, 0, 0);
  expect(&f, BTF_E_CORRUPT, "whole number of directions");
  image_replace_chunk(&f.im, dirs, xyz, 60, 0, 60); /* five directions, and samples for six */
  expect(&f, BTF_E_CORRUPT, "bytes of samples");
  end(&f);
}

static void metadata_chunks(void **state) {
  static const struct {
    const char *bytes;
    size_t size;
    btf_status expected;
    const char *part;
  } cases[] = {
      {"", 0, BTF_E_CORRUPT, "ends within"},
      {"\0\0\0\0", 4, BTF_OK, NULL},
      {"\1\0\0\0", 4, BTF_E_CORRUPT, "ends within"},
      {"\377\377\377\377", 4, BTF_E_LIMIT, "4294967295 metadata pairs"},
      {"\1\0\0\0\1\0\0\0\1\0\0\0kv", 14, BTF_OK, NULL},
      {"\1\0\0\0\1\0\0\0\1\0\0\0k", 13, BTF_E_CORRUPT, "ends within"},
      {"\1\0\0\0\0\0\0\0\1\0\0\0v", 13, BTF_E_CORRUPT, "not valid text"},
      {"\1\0\0\0\1\0\0\0\1\0\0\0\0v", 14, BTF_E_CORRUPT, "not valid text"},
      {"\1\0\0\0\1\0\0\0\1\0\0\0k\377", 14, BTF_E_CORRUPT, "not valid text"},
      {"\1\0\0\0\1\0\0\0\377\377\377\377kv", 14, BTF_E_CORRUPT, "ends within"},
      {"\2\0\0\0\1\0\0\0\1\0\0\0kv\1\0\0\0\1\0\0\0kw", 24, BTF_E_CORRUPT, "\"k\" occurs twice"},
  };
  fixture f;
  uint32_t meta;
  (void)state;
  begin(&f, "plain");
  meta = image_find(&f.im, TYPE_META, 0);
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    image_replace_chunk(&f.im, meta, cases[i].bytes, cases[i].size, 0, cases[i].size);
    expect(&f, cases[i].expected, cases[i].part);
  }
  end(&f);
}

/* ---- zstd ---- */

static size_t frame_of(const void *data, size_t size, unsigned char *out, size_t room) {
  const size_t n = ZSTD_compress(out, room, data, size, 3);
  assert_false(ZSTD_isError(n));
  return n;
}

static void packed_payload(void **state) {
  fixture f;
  uint32_t samples;
  size_t raw, frame;
  unsigned char *zeros, packed[65536];
  ZSTD_CStream *stream;
  (void)state;
  begin(&f, "packed");
  samples = image_find(&f.im, TYPE_DATA, TAG_SAMPLES);
  raw = (size_t)image_get(&f.im, image_entry(&f.im, samples) + E_RAW, 8);
  zeros = calloc(1, 4 << 20);
  assert_non_null(zeros);
  frame = frame_of(zeros, raw, packed, sizeof packed);
  image_replace_chunk(&f.im, samples, packed, frame, 1, raw);
  expect(&f, BTF_OK, NULL);
  /* The directory and the frame disagree about the size. */
  image_replace_chunk(&f.im, samples, packed, frame, 1, raw + 1);
  expect(&f, BTF_E_CORRUPT, "the directory says");
  image_replace_chunk(&f.im, samples, packed, frame, 1, (uint64_t)1 << 33);
  expect(&f, BTF_E_CORRUPT, "the directory says");
  image_replace_chunk(&f.im, samples, packed, frame, 1, UINT64_MAX);
  expect(&f, BTF_E_LIMIT, "over the limit");
  /* Something after the frame, a second frame, half a frame, none. */
  memset(packed + frame, 0, 16);
  image_replace_chunk(&f.im, samples, packed, frame + 4, 1, raw);
  expect(&f, BTF_E_CORRUPT, "one zstd frame");
  memcpy(packed + frame, packed, frame);
  image_replace_chunk(&f.im, samples, packed, 2 * frame, 1, raw);
  expect(&f, BTF_E_CORRUPT, "one zstd frame");
  image_replace_chunk(&f.im, samples, packed, frame - 1, 1, raw);
  expect(&f, BTF_E_CORRUPT, "zstd");
  image_replace_chunk(&f.im, samples, packed, 0, 1, raw);
  expect(&f, BTF_E_CORRUPT, "zstd");
  image_replace_chunk(&f.im, samples, "\x50\x2a\x4d\x18\4\0\0\0abcd", 12, 1, 0); /* a skippable frame */
  expect(&f, BTF_E_CORRUPT, NULL);
  /* A frame that does not state its size. */
  stream = ZSTD_createCStream();
  assert_non_null(stream);
  {
    ZSTD_inBuffer in = {zeros, raw, 0};
    ZSTD_outBuffer out = {packed, sizeof packed, 0};
    assert_false(ZSTD_isError(ZSTD_compressStream(stream, &out, &in)));
    assert_int_equal(ZSTD_endStream(stream, &out), 0);
    image_replace_chunk(&f.im, samples, packed, out.pos, 1, raw);
  }
  ZSTD_freeCStream(stream);
  expect(&f, BTF_E_CORRUPT, "states its size");
  /* Damage inside a frame whose checksum in the directory is right. */
  frame = frame_of(f.im.bytes, 600, packed, sizeof packed);
  for (size_t i = 6; i < frame; i += 7) {
    packed[i] ^= 0x55;
    image_replace_chunk(&f.im, samples, packed, frame, 1, 600);
    expect(&f, BTF_E_CORRUPT, NULL);
    packed[i] ^= 0x55;
  }
  free(zeros);
  end(&f);
}

/* A few bytes that honestly unpack to very much stop at the limits of the context, not at those of the
 * machine. */
static void expanding_payload(void **state) {
  static const unsigned char huge[] = {0x28, 0xb5, 0x2f, 0xfd, 0xe0, /* zstd, 8 byte content size follows */
                                       0,    0,    0,    0,    2,    0,
                                       0,    0,    1,    0,    0}; /* 2^33; an empty last block */
  btf_limits limits = BTF_LIMITS_INIT;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  fixture f;
  uint32_t samples;
  (void)state;
  begin(&f, "packed");
  samples = image_find(&f.im, TYPE_DATA, TAG_SAMPLES);
  image_replace_chunk(&f.im, samples, huge, sizeof huge, 1, (uint64_t)1 << 33);
  for (int which = 0; which < 2; which++) {
    btf_context *ctx;
    uint64_t peak;
    limits.max_memory = which == 0 ? 64u << 20 : 0;
    limits.max_chunk_bytes = which == 1 ? 64u << 20 : 0;
    desc.limits = &limits;
    assert_ok(btf_context_create(&desc, &ctx));
    image_register_codecs(ctx);
    assert_status(image_read_all(ctx, &f.im, 0), BTF_E_LIMIT);
    btf_context_memory(ctx, NULL, &peak);
    assert_true(peak < 3u << 20);
    btf_context_release(ctx);
  }
  end(&f);
}

static void limits_of_the_context(void **state) {
  fixture f;
  btf_limits limits = BTF_LIMITS_INIT;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  (void)state;
  begin(&f, "plain");
  desc.limits = &limits;
  for (int which = 0; which < 6; which++) {
    btf_context *ctx;
    memset(&limits, 0, sizeof limits);
    limits.struct_size = sizeof limits;
    if (which == 0) limits.max_chunks = 5;
    if (which == 1) limits.max_dimension = 4;
    if (which == 2) limits.max_channels = 2;
    if (which == 3) limits.max_directions = 5;
    if (which == 4) limits.max_chunk_bytes = 36 * 20 * 3 * 4 - 1;
    if (which == 5) limits.max_memory = 20000;
    assert_ok(btf_context_create(&desc, &ctx));
    image_register_codecs(ctx);
    assert_status(image_read_all(ctx, &f.im, 0), BTF_E_LIMIT);
    btf_context_release(ctx);
  }
  end(&f);
}

static void unknown_codec(void **state) {
  fixture f;
  test_memory memory;
  btf_context *bare = test_context(&memory);
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_model *model;
  btf_file *file;
  btf_io io;
  (void)state;
  begin(&f, "plain");
  io = image_source(&f.im, 1);
  assert_ok(btf_file_open(bare, &io, 0, &file));
  assert_string_equal(btf_file_model_codec(file, 0), "org.libbtf.copy");
  assert_ok(btf_file_describe_model(file, 0, &info));
  assert_int_equal(info.width, 5);
  assert_ok(btf_file_validate(file, NULL, NULL));
  assert_status(btf_file_load_model(file, 0, &model), BTF_E_UNKNOWN_CODEC);
  assert_message_has("\"org.libbtf.copy\"");
  assert_null(model);
  assert_status(btf_file_load_model(file, 1, &model), BTF_E_INVALID_ARG);
  btf_file_close(file);
  test_context_done(bare, &memory);
  end(&f);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(header_fields),         cmocka_unit_test(short_files_of_other_kinds),
      cmocka_unit_test(entry_fields),          cmocka_unit_test(model_header_fields),
      cmocka_unit_test(direction_sets),        cmocka_unit_test(metadata_chunks),
      cmocka_unit_test(packed_payload),        cmocka_unit_test(expanding_payload),
      cmocka_unit_test(limits_of_the_context), cmocka_unit_test(unknown_codec),
  };
  return btf_run("container_hostile", tests);
}
