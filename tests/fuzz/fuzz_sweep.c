/* SPDX-License-Identifier: MIT */
/* Goes through single changes of a codec's payloads one by one, as far as they can be told beforehand: each
 * chunk gone, swapped, renamed or of another size, each number at its beginning replaced, each shape. What a
 * search finds by chance at any place is the fuzz target's. */
#include "fuzz.h"

#include "fuzz_codec.h"

enum { HEAD = 96 /* bytes of a chunk's beginning whose numbers are replaced */ };

static size_t inputs;

static void run(const uint8_t *bytes, size_t size) {
  uint8_t *data = malloc(size); /* of exactly this size, for the sanitizer */
  fuzz_expect(data != NULL);
  memcpy(data, bytes, size);
  LLVMFuzzerTestOneInput(data, size);
  free(data);
  inputs++;
}

static void change_chunk(uint8_t model, uint8_t chunk, uint8_t chunks) {
  static const uint16_t sizes[] = {0, 1, 4, 63, 1000, 65535};
  static const uint8_t nudges[] = {0, 2, 3, 7, 128, 131, 132, 135}; /* 1, 3, 4 and 8 more or less */
  for (uint8_t at = 0; at < HEAD; at = (uint8_t)(at + 4)) {
    for (uint8_t k = 0; k < SPECIALS; k++) {
      run((const uint8_t[]){model, EDIT_SPECIAL_WORD, chunk, at, 0, k}, 6);
      if (at % 8 == 0) run((const uint8_t[]){model, EDIT_SPECIAL_DOUBLE, chunk, at, 0, k}, 6);
    }
    run((const uint8_t[]){model, EDIT_NUDGE, chunk, at, 0, 0}, 6);
    run((const uint8_t[]){model, EDIT_NUDGE, chunk, at, 0, 1}, 6);
    for (uint8_t byte = 0; byte < 4; byte++)
      run((const uint8_t[]){model, EDIT_BYTE, chunk, (uint8_t)(at + byte), 0, 0xff}, 6);
  }
  for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++)
    run((const uint8_t[]){model, EDIT_RESIZE, chunk, 0, 0, sizes[i] & 0xff, (uint8_t)(sizes[i] >> 8)}, 7);
  for (size_t i = 0; i < sizeof nudges; i++)
    run((const uint8_t[]){model, EDIT_NUDGE_SIZE, chunk, 0, 0, nudges[i]}, 6);
  run((const uint8_t[]){model, EDIT_FILL, chunk, 0, 0, 0xff, 0xff, 0xff}, 8);
  run((const uint8_t[]){model, EDIT_FILL, chunk, 0, 0, 0xff, 0xff, 0x00}, 8);
  run((const uint8_t[]){model, EDIT_FILL, chunk, 0, 0, 0xff, 0xff, 0x7f}, 8);
  run((const uint8_t[]){model, EDIT_DROP, chunk, 0, 0, 0}, 6);
  run((const uint8_t[]){model, EDIT_RENAME, chunk, 0, 0, 200}, 6);
  for (uint8_t other = 0; other < chunks; other++)
    run((const uint8_t[]){model, EDIT_SWAP, chunk, 0, 0, other}, 6);
}

int main(void) {
  const uint8_t nothing = 0;
  LLVMFuzzerTestOneInput(&nothing, 0);
  for (uint8_t model = 0; model < 255 && fuzz_codec_chunks(model) > 0; model++) {
    const uint8_t chunks = (uint8_t)(fuzz_codec_chunks(model) < 24 ? fuzz_codec_chunks(model) : 24);
    run(&model, 1);
    for (uint8_t chunk = 0; chunk < chunks; chunk++) change_chunk(model, chunk, chunks);
    for (uint8_t what = 0; what < 8; what++)
      for (uint8_t value = 0; value < 12; value++)
        run((const uint8_t[]){model, EDIT_SHAPE, what, value, EDIT_STOP}, 5);
  }
  printf("%zu inputs\n", inputs);
  return inputs > 100 ? 0 : 1;
}
