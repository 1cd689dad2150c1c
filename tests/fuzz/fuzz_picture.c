/* SPDX-License-Identifier: MIT */
/* JPEG, PNG and Radiance pictures of measured data, decoded in every way. In an archive their checksum would
 * keep changed ones from being decoded. */
#include "fuzz.h"

#include <math.h>

#include "registry/registry.h"

#include "source/picture.h"

/* A few bytes may truly code a large picture, which would take long here. */
enum { MOST_PIXELS = 1 << 16, MOST_SAMPLES = 3 * MOST_PIXELS };

static void decode_all(btf_context *ctx, const uint8_t *data, size_t size) {
  /* A guard behind each half of the samples. */
  static uint16_t table16[1 << 16], halves[MOST_SAMPLES + 1];
  static float table32[1 << 16], floats[MOST_SAMPLES + 1];
  const source_file file = {.host = btfi_host(), .ctx = ctx, .data = data, .size = size};
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
    const btf_status decoded = picture_decode(&file, &info, &rules, half ? (void *)halves : floats, &fault);
    fuzz_expect(decoded == fault.status && (decoded == BTF_OK) == (fault.why[0] == '\0'));
    fuzz_expect(halves[count] == 0xabcd && floats[count] == 12345);
    if (decoded == BTF_OK && !half && info.kind == PICTURE_HDR)
      for (size_t i = 0; i < count; i++) fuzz_expect(isfinite(floats[i]) && floats[i] >= 0);
  }
  if (info.depth == 8) {
    static unsigned char codes[MOST_SAMPLES + 1];
    const picture_rules rules = {.sample_size = 1};
    codes[count] = 0xab;
    fault = (picture_fault){BTF_OK, ""};
    const btf_status decoded = picture_decode(&file, &info, &rules, codes, &fault);
    fuzz_expect(decoded == fault.status && codes[count] == 0xab);
  }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  btf_context *ctx = fuzz_context((uint64_t)64 << 20);
  uint64_t before, now;
  btf_context_memory(ctx, &before, NULL);
  decode_all(ctx, data, size);
  btf_context_memory(ctx, &now, NULL);
  fuzz_expect(now == before);
  btf_context_release(ctx);
  return 0;
}
