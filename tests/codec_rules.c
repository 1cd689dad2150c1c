/* SPDX-License-Identifier: MIT */
/* What the rules share, and the program: `test_codecs [CODEC...]` checks every row of those codecs. */
#include "codec_rules.h"

#include <btf/btf_sampling.h>

btf_context *rule_context(test_memory *memory, const char *isa, uint32_t threads) {
  const btf_allocator allocator = test_allocator(memory);
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  memset(memory, 0, sizeof *memory);
  desc.allocator = &allocator;
  desc.isa = isa;
  desc.max_threads = threads;
  assert_ok(codec_case_context(&desc, &ctx));
  return ctx;
}

btf_model *rule_fit(btf_context *ctx, const codec_case *row, uint32_t material, uint32_t channels,
                    const char *extra) {
  const codec_dataset_recipe recipe = {material, channels, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  btf_model *model;
  const btf_status status = codec_case_fit(ctx, row, &recipe, extra, NULL, &model);
  if (status == BTF_E_UNSUPPORTED && row->unsupported & 1u << material) {
    assert_message_has(row->codec);
    assert_null(model);
    return NULL;
  }
  if (status != BTF_OK)
    fail_msg("%s, %u channels: %s: %s", codec_materials[material].name, channels, btf_status_name(status),
             btf_error_message());
  return model;
}

/* ---- containers in memory ---- */

static int64_t file_size(void *user) {
  return (int64_t)((rule_file *)user)->size;
}

static int64_t file_read(void *user, void *dst, size_t n, uint64_t offset) {
  const rule_file *file = user;
  if (offset >= file->size) return 0;
  if (n > file->size - offset) n = (size_t)(file->size - offset);
  memcpy(dst, file->bytes + offset, n);
  return (int64_t)n;
}

static int64_t file_write(void *user, const void *src, size_t n, uint64_t offset) {
  rule_file *file = user;
  if (offset + n > file->capacity) {
    const uint64_t capacity = 2 * (offset + n);
    file->bytes = realloc(file->bytes, capacity);
    assert_non_null(file->bytes);
    memset(file->bytes + file->capacity, 0, capacity - file->capacity);
    file->capacity = capacity;
  }
  memcpy(file->bytes + offset, src, n);
  if (offset + n > file->size) file->size = offset + n;
  return (int64_t)n;
}

static int32_t file_close(void *user, int32_t failed) {
  (void)user;
  return failed ? -1 : 0;
}

void rule_save(btf_context *ctx, const btf_model *model, rule_file *out) {
  btf_io io = BTF_IO_INIT;
  btf_writer *writer;
  memset(out, 0, sizeof *out);
  io.user = out;
  io.size = file_size;
  io.read = file_read;
  io.write = file_write;
  io.close = file_close;
  assert_ok(btf_writer_open(ctx, &io, 0, &writer));
  assert_ok(btf_writer_model(writer, model, NULL));
  assert_ok(btf_writer_finish(writer));
}

btf_model *rule_load(btf_context *ctx, const rule_file *file) {
  btf_io io = BTF_IO_INIT;
  btf_file *opened;
  btf_model *model;
  assert_ok(btf_io_memory(ctx, file->bytes, file->size, &io));
  assert_ok(btf_file_open(ctx, &io, 0, &opened));
  assert_ok(btf_file_validate(opened, NULL, NULL));
  assert_ok(btf_file_load_model(opened, 0, &model));
  btf_file_close(opened);
  return model;
}

/* ---- comparing ---- */

btf_model_info rule_describe(const btf_model *model) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  assert_ok(btf_model_describe(model, &info));
  assert_true(info.channels <= RULE_CHANNELS);
  return info;
}

double rule_largest(const btf_model *model) {
  const btf_model_info info = rule_describe(model);
  double largest = 0.0;
  for (uint32_t level = 0; level < info.levels; level++)
    for (uint32_t y = 0; y < btf_sampling_level_size(info.height, level); y++)
      for (uint32_t x = 0; x < btf_sampling_level_size(info.width, level); x++)
        for (uint32_t view = 0; view < btf_dirset_count(info.views); view++)
          for (uint32_t light = 0; light < btf_dirset_count(info.lights); light++) {
            float value[RULE_CHANNELS];
            btf_model_texel(model, level, x, y, light, view, value);
            for (uint32_t c = 0; c < info.channels; c++) {
              assert_true(isfinite(value[c]));
              largest = fmax(largest, fabs((double)value[c]));
            }
          }
  return largest;
}

/* Share of finest texel i in texel k of a level, along one axis. */
static double overlap(uint32_t size, uint32_t level_size, uint32_t k, uint32_t i) {
  const double begin = (double)k * size / level_size, end = (k + 1.0) * size / level_size;
  return fmax(0.0, fmin(end, i + 1.0) - fmax(begin, (double)i)) / (end - begin);
}

void rule_errors(const btf_model *model, uint32_t material, uint32_t level, double *rms, double *rmse) {
  const btf_model_info info = rule_describe(model);
  const codec_material *m = &codec_materials[material];
  const uint32_t width = btf_sampling_level_size(info.width, level),
                 height = btf_sampling_level_size(info.height, level);
  double square = 0.0, error = 0.0, count = 0.0;
  for (uint32_t view = 0; view < btf_dirset_count(info.views); view++)
    for (uint32_t light = 0; light < btf_dirset_count(info.lights); light++)
      for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
          float got[RULE_CHANNELS];
          btf_model_texel(model, level, x, y, light, view, got);
          for (uint32_t c = 0; c < info.channels; c++) {
            double expected = 0.0;
            for (uint32_t ty = 0; ty < info.height; ty++)
              for (uint32_t tx = 0; tx < info.width; tx++) {
                const double share = overlap(info.width, width, x, tx) * overlap(info.height, height, y, ty);
                if (share > 0.0)
                  expected += share * (double)codec_material_value(
                                          m, btf_dirset_directions(info.lights) + 3 * (size_t)light,
                                          btf_dirset_directions(info.views) + 3 * (size_t)view, tx, ty, c);
              }
            square += expected * expected;
            error += (got[c] - expected) * (got[c] - expected);
            count += 1.0;
          }
        }
  *rms = sqrt(square / count);
  *rmse = sqrt(error / count);
}

double rule_scaled_error(const btf_model *model, uint32_t material, double scale) {
  const btf_model_info info = rule_describe(model);
  const codec_material *m = &codec_materials[material];
  double square = 0.0, error = 0.0;
  for (uint32_t view = 0; view < btf_dirset_count(info.views); view++)
    for (uint32_t light = 0; light < btf_dirset_count(info.lights); light++)
      for (uint32_t y = 0; y < info.height; y++)
        for (uint32_t x = 0; x < info.width; x++) {
          float got[RULE_CHANNELS];
          btf_model_texel(model, 0, x, y, light, view, got);
          for (uint32_t c = 0; c < info.channels; c++) {
            const double expected =
                (double)codec_material_value(m, btf_dirset_directions(info.lights) + 3 * (size_t)light,
                                             btf_dirset_directions(info.views) + 3 * (size_t)view, x, y, c);
            square += expected * expected;
            error += (got[c] / scale - expected) * (got[c] / scale - expected);
          }
        }
  return sqrt(error / square);
}

double rule_difference(const btf_model *a, const btf_model *b) {
  const btf_model_info info = rule_describe(a);
  double largest = 0.0;
  for (uint32_t i = 0; i < RULE_QUERIES; i++) {
    btf_query q = codec_case_plain_query(i, (float)(i % 16) * 0.25f - 0.5f);
    float one[RULE_CHANNELS], other[RULE_CHANNELS];
    q.flags = i % 3 == 0 ? BTF_QUERY_NEAREST : 0;
    btf_model_eval(a, &q, one);
    btf_model_eval(b, &q, other);
    for (uint32_t c = 0; c < info.channels; c++) largest = fmax(largest, fabs((double)one[c] - other[c]));
  }
  return largest;
}

void rule_expect_equal(const btf_model *a, const btf_model *b) {
  const btf_model_info info = rule_describe(a);
  for (uint32_t i = 0; i < RULE_QUERIES; i++) {
    btf_query q = codec_case_query(i);
    float one[RULE_CHANNELS], other[RULE_CHANNELS];
    if (i % 5 == 0) q.flags = BTF_QUERY_NEAREST;
    btf_model_eval(a, &q, one);
    btf_model_eval(b, &q, other);
    if (memcmp(one, other, info.channels * sizeof *one) != 0)
      fail_msg("query %u: %.9g and %.9g", i, (double)one[0], (double)other[0]);
  }
}

void rule_batch_make(rule_batch *b, uint32_t first, uint32_t flags) {
  static btf_query queries[RULE_QUERIES];
  float *column[9];
  for (uint32_t i = 0; i < RULE_QUERIES; i++) queries[i] = codec_case_query(first + i);
  for (int k = 0; k < 9; k++) column[k] = b->arrays[k];
  b->batch = suite_batch(queries, RULE_QUERIES, flags, column);
  for (int c = 0; c < RULE_CHANNELS; c++) b->out[c] = b->results[c];
  memset(b->results, 0xee, sizeof b->results);
}
