/* SPDX-License-Identifier: MIT */
/* Containers: any bytes are opened or refused; what opens is validated, copied, loaded and evaluated.
 * Checksums would stop every mutation at the first gate, so each input is also tried with its checksums made
 * right: read to memory, and used in place with BTF_OPEN_TRUST. */
#include "fuzz.h"

#include <math.h>
#include <string.h>

#include "base/base.h"
#include "copy_codec.h"

enum { HEADER = 64, ENTRY = 64, FOOTER = 32, LARGEST = 1 << 16 };

/* ---- making checksums right ---- */

static uint64_t load(const uint8_t *p, int bytes) {
  uint64_t value = 0;
  for (int i = 0; i < bytes; i++) value |= (uint64_t)p[i] << 8 * i;
  return value;
}

static void store64(uint8_t *p, uint64_t value) {
  for (int i = 0; i < 8; i++) p[i] = (uint8_t)(value >> 8 * i);
}

/* Header, footer and directory keep what they say as far as it fits the file; sums and repeated fields
 * follow. */
static void repair(uint8_t *file, size_t size) {
  static const uint8_t signature[8] = {0x93, 'B', 'T', 'Z', '\r', '\n', 0x1a, '\n'};
  static const uint8_t end_signature[8] = {'\n', 0x1a, 'b', 't', 'z', 'E', 'N', 0x93};
  uint64_t directory, count;
  if (size < HEADER + FOOTER) return;
  memcpy(file, signature, 8);
  memset(file + 11, 0, 5); /* major version 1 in file[8], no required features */
  file[8] = 1;
  file[9] = 0;
  directory = load(file + 24, 8);
  count = load(file + 20, 4);
  if (directory <= size - FOOTER)
    count = (size - FOOTER - (size_t)directory) / ENTRY;
  else
    directory = 0, count = 0;
  file[20] = (uint8_t)count;
  file[21] = (uint8_t)(count >> 8);
  file[22] = file[23] = 0;
  for (uint64_t i = 0; i < count && directory != 0; i++) {
    uint8_t *entry = file + directory + i * ENTRY;
    const uint64_t offset = load(entry + 24, 8), stored = load(entry + 32, 8);
    if (offset <= size && stored <= size - offset)
      store64(entry + 48, btfi_xxh64_of(file + offset, (size_t)stored));
    store64(entry + 56, btfi_xxh64_of(entry, 56));
    if (offset >= ENTRY && offset <= size &&
        (offset <= directory || offset - ENTRY >= directory + count * ENTRY))
      memcpy(file + offset - ENTRY, entry, ENTRY);
  }
  store64(file + 32, count * ENTRY);
  store64(file + 40, size);
  store64(file + 48, btfi_xxh64_of(file + directory, (size_t)(count * ENTRY)));
  store64(file + 56, btfi_xxh64_of(file, 56));
  memcpy(file + size - FOOTER, end_signature, 8);
  store64(file + size - 24, directory);
  store64(file + size - 16, size);
  store64(file + size - 8, btfi_xxh64_of(file + size - FOOTER, 24));
}

/* ---- a sink in memory ---- */

typedef struct sink {
  uint8_t bytes[4 * LARGEST];
  size_t size;
} sink;

static int64_t sink_write(void *user, const void *src, size_t n, uint64_t offset) {
  sink *s = user;
  if (offset > sizeof s->bytes || n > sizeof s->bytes - offset) return -1;
  memcpy(s->bytes + offset, src, n);
  if (offset + n > s->size) s->size = (size_t)offset + n;
  return (int64_t)n;
}

static sink copied;

/* ---- what must hold ---- */

static int refusal(btf_status status) {
  return status / 10 == 2 || status / 10 == 3 || status == BTF_E_LIMIT || status == BTF_E_NOMEM;
}

static void evaluate(const btf_model *model) {
  static const btf_query queries[] = {
      {{0.0f, 0.6f, 0.8f}, {0.6f, 0.0f, 0.8f}, {0.3f, 0.7f}, 0.0f, 0},
      {{0.0f, 0.0f, 1.0f}, {0.99f, 0.0f, 0.01f}, {-7.1f, 1e9f}, 2.5f, 0},
      {{-0.5f, 0.5f, 0.7f}, {0.1f, 0.9f, 0.4f}, {0.999f, 0.001f}, 40.0f, BTF_QUERY_NEAREST},
      {{NAN, 0.0f, 1.0f}, {0.0f, 0.0f, 1.0f}, {0.5f, 0.5f}, 0.0f, 0},
      {{0.0f, 0.0f, INFINITY}, {0.0f, NAN, 1.0f}, {INFINITY, NAN}, -INFINITY, BTF_QUERY_NEAREST},
      {{0.0f, 0.6f, 0.8f}, {1e38f, -1e38f, 1e-38f}, {-0.0f, 1.0f}, 0.5f, 0},
  };
  btf_model_info info = BTF_MODEL_INFO_INIT;
  float out[64];
  fuzz_expect(btf_model_describe(model, &info) == BTF_OK);
  fuzz_expect(info.channels >= 1 && info.channels <= 64 && info.levels >= 1);
  for (size_t i = 0; i < sizeof queries / sizeof *queries; i++) {
    btf_model_eval(model, &queries[i], out);
    for (uint32_t c = 0; c < info.channels; c++) fuzz_expect(isfinite(out[c]));
  }
  for (uint32_t level = 0; level < info.levels; level++) {
    btf_model_texel(model, level, (info.width >> level) - (info.width >> level > 0), 0,
                    btf_dirset_count(info.lights) - 1, btf_dirset_count(info.views) - 1, out);
    for (uint32_t c = 0; c < info.channels; c++) fuzz_expect(isfinite(out[c]));
  }
}

/* A container that is right stays right when it is copied. */
static void copy(btf_context *ctx, const btf_file *file) {
  btf_io io = BTF_IO_INIT;
  btf_writer *w;
  btf_file *again;
  copied.size = 0;
  io.user = &copied;
  io.write = sink_write;
  if (btf_writer_open(ctx, &io, 0, &w) != BTF_OK) return;
  if (btf_writer_copy(w, file) != BTF_OK) {
    btf_writer_abort(w);
    return;
  }
  if (btf_writer_finish(w) != BTF_OK) return;
  fuzz_expect(btf_io_memory(ctx, copied.bytes, copied.size, &io) == BTF_OK);
  fuzz_expect(btf_file_open(ctx, &io, 0, &again) == BTF_OK);
  fuzz_expect(btf_file_validate(again, NULL, NULL) == BTF_OK);
  fuzz_expect(btf_file_model_count(again) == btf_file_model_count(file));
  btf_file_close(again);
}

/* What is told without a codec. */
static void ask(const btf_file *file) {
  const uint32_t models = btf_file_model_count(file), texts = btf_file_metadata_count(file);
  for (uint32_t i = 0; i < models; i++) {
    btf_model_info info = BTF_MODEL_INFO_INIT;
    fuzz_expect(btf_file_describe_model(file, i, &info) == BTF_OK);
    fuzz_expect(strcmp(info.codec_id, btf_file_model_codec(file, i)) == 0);
    fuzz_expect(info.channels >= 1 && info.channels <= 64 && info.width >= 1 && info.height >= 1);
    for (uint32_t c = 0; c < info.channels; c++) fuzz_expect(memchr(info.channel_names[c], 0, 65536) != NULL);
    fuzz_expect(btf_dirset_count(info.lights) >= 1 && btf_dirset_count(info.views) >= 1);
    fuzz_expect(isfinite(info.texels_per_mm));
  }
  fuzz_expect(btf_file_model_codec(file, models) == NULL);
  for (uint32_t i = 0; i < texts; i++) {
    const char *key, *value;
    fuzz_expect(btf_file_metadata_at(file, i, &key, &value) == BTF_OK);
    fuzz_expect(btf_file_metadata(file, key) == value);
  }
  for (uint32_t i = 0; i < btf_file_chunk_count(file); i++) {
    btf_chunk_info chunk = {.struct_size = sizeof chunk};
    fuzz_expect(btf_file_chunk(file, i, &chunk) == BTF_OK);
  }
}

static void use(btf_context *ctx, const uint8_t *data, size_t size, uint32_t flags, int mapped) {
  btf_io io = BTF_IO_INIT;
  btf_file *file;
  btf_status status, valid;
  fuzz_expect(btf_io_memory(ctx, data, size, &io) == BTF_OK);
  if (!mapped) io.map = NULL;
  status = btf_file_open(ctx, &io, flags, &file);
  if (status != BTF_OK) {
    fuzz_expect(refusal(status) && file == NULL);
    return;
  }
  ask(file);
  valid = btf_file_validate(file, NULL, NULL);
  fuzz_expect(valid == BTF_OK || refusal(valid));
  for (uint32_t i = 0; i < btf_file_model_count(file) && i < 8; i++) {
    btf_model *model;
    status = btf_file_load_model(file, i, &model);
    fuzz_expect(status == BTF_OK || refusal(status));
    if (status == BTF_OK) evaluate(model);
    btf_model_release(model);
  }
  if (valid == BTF_OK) copy(ctx, file);
  btf_file_close(file);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static btf_context *ctx;
  uint64_t before, after;
  uint8_t *repaired;
  if (ctx == NULL) { /* one for all inputs: its pool and registry are not what is tested here */
    ctx = fuzz_context((uint64_t)256 << 20);
    fuzz_expect(btf_context_register(ctx, &copy_codec) == BTF_OK);
  }
  if (size > LARGEST) return 0;
  btf_context_memory(ctx, &before, NULL);
  use(ctx, data, size, 0, 1);
  repaired = malloc(size != 0 ? size : 1);
  fuzz_expect(repaired != NULL);
  if (size != 0) memcpy(repaired, data, size);
  repair(repaired, size);
  use(ctx, repaired, size, 0, 0);
  use(ctx, repaired, size, BTF_OPEN_TRUST, 1);
  free(repaired);
  btf_context_memory(ctx, &after, NULL);
  fuzz_expect(before == after);
  return 0;
}
