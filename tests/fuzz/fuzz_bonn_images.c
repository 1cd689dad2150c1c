/* SPDX-License-Identifier: MIT */
/* Images in a zip: an even first byte is followed by an archive, which is opened as it is and with gaps
 * allowed, and read in parts; an odd one by a picture, which is decoded in every way. */
#include "fuzz_file.h"

#include <math.h>

#include <btf/btf_formats.h>

#include "bonn_images/picture.h"

/* A few bytes may truly code a large picture, which would take long here. */
enum { MOST_PIXELS = 1 << 16, MOST_SAMPLES = 3 * MOST_PIXELS };

static void expect_refusal(btf_status status) {
  fuzz_expect(status == BTF_E_IO || status == BTF_E_LIMIT || status == BTF_E_NOMEM ||
              status == BTF_E_NOT_BTF || status == BTF_E_CORRUPT || status == BTF_E_TRUNCATED ||
              status == BTF_E_UNSUPPORTED);
  fuzz_expect(btf_error_message()[0] != '\0' && strchr(btf_error_message(), '\n') == NULL);
}

static void read_parts(const btf_dataset *ds) {
  static float samples[2][MOST_SAMPLES];
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  fuzz_expect(btf_dataset_describe(ds, &d) == BTF_OK);
  fuzz_expect(d.channels == 1 || d.channels == 3);
  if ((uint64_t)d.width * d.height > MOST_PIXELS) return;
  const size_t count = (size_t)d.width * d.height * d.channels;
  const ptrdiff_t x = 4 * (ptrdiff_t)d.channels, y = x * (ptrdiff_t)d.width;
  const btf_strides strides = {.view = y, .light = y, .y = y, .x = x, .channel = 4};
  for (uint32_t pair = 0; pair < 81; pair += 8) {
    const btf_block block = {pair, 1, 80 - pair, 1, 0, 0, d.width, d.height};
    const btf_status status = btf_dataset_read(ds, &block, samples[0], &strides);
    if (status != BTF_OK) {
      expect_refusal(status);
      continue;
    }
    for (size_t i = 0; i < count; i++) fuzz_expect(isfinite(samples[0][i]) && samples[0][i] >= 0);
    fuzz_expect(btf_dataset_read(ds, &block, samples[1], &strides) == BTF_OK);
    fuzz_expect(memcmp(samples[0], samples[1], count * sizeof(float)) == 0);
  }
}

static void run_archive(const uint8_t *data, size_t size) {
  fuzz_file file = fuzz_file_make(data, size);
  btf_context *ctx = fuzz_context(256u << 20);
  fuzz_expect(btf_formats_register(ctx) == BTF_OK);
  const btf_format *format = btf_format_find(ctx, "bonn-images"), *found = NULL;
  const btf_status detected = btf_format_detect(ctx, file.path, &found);
  fuzz_expect(detected == BTF_OK || detected == BTF_E_NOT_BTF);
  for (int lenient = 0; lenient < 2; lenient++) {
    btf_options *options;
    btf_dataset *ds = NULL;
    fuzz_expect(btf_format_options_create(format, &options) == BTF_OK);
    fuzz_expect(btf_options_set(options, "allow_missing", lenient ? "true" : "false") == BTF_OK);
    fuzz_expect(btf_options_set(options, "duplicates", lenient ? "first" : "refuse") == BTF_OK);
    const btf_status status = btf_format_open(ctx, file.path, format, options, &ds);
    if (status == BTF_OK)
      read_parts(ds);
    else
      expect_refusal(status);
    btf_dataset_release(ds);
    btf_options_release(options);
  }
  btf_context_release(ctx);
  fuzz_file_drop(&file);
}

static void run_picture(const uint8_t *data, size_t size) {
  /* A guard behind each half of the samples. */
  static uint16_t table16[1 << 16], halves[MOST_SAMPLES + 1];
  static float table32[1 << 16], floats[MOST_SAMPLES + 1];
  picture_info info;
  picture_fault fault = {BTF_OK, ""};
  bool complete;
  const btf_status status = picture_look(data, size, &info, &complete, &fault);
  if (status != BTF_OK) fuzz_expect(status == fault.status && fault.why[0] != '\0');
  if (status != BTF_OK || !complete || (uint64_t)info.width * info.height > MOST_PIXELS) return;
  const size_t count = (size_t)info.width * info.height * info.channels;
  for (int way = 0; way < 8; way++) {
    const bool half = (way & 1) != 0;
    const picture_rules rules = {.sample_size = half ? 2 : 4,
                                 .upside_down = (way & 2) != 0,
                                 .columns_as_rows =
                                     info.by_columns && info.width == info.height && (way & 4) != 0,
                                 .table = half ? (const void *)table16 : table32};
    halves[count] = 0xabcd;
    floats[count] = 12345;
    fault = (picture_fault){BTF_OK, ""};
    const btf_status decoded =
        picture_decode(data, size, &info, &rules, half ? (void *)halves : floats, &fault);
    fuzz_expect(decoded == fault.status && (decoded == BTF_OK) == (fault.why[0] == '\0'));
    fuzz_expect(halves[count] == 0xabcd && floats[count] == 12345);
    if (decoded == BTF_OK && !half && info.kind == PICTURE_HDR)
      for (size_t i = 0; i < count; i++) fuzz_expect(isfinite(floats[i]) && floats[i] >= 0);
  }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  if (size == 0) return 0;
  if ((data[0] & 1) == 0)
    run_archive(data + 1, size - 1);
  else
    run_picture(data + 1, size - 1);
  return 0;
}
