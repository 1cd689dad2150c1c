/* SPDX-License-Identifier: MIT */
/* Payloads that are wrong: every chunk missing, of another size, with wild bytes and flipped bits. The loader
 * is called through the codec's table with chunks in memory, below all checksums. */
#include "test_cmf_fits.h"

#include "hostile_payload.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_cmf;

static void with_models(void (*check)(hostile_payload *payload)) {
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:4x2", 4, 3, 3);
  for (size_t k = 0; k < CMF_CASES; k++) {
    char settings[160];
    cmf_case_with(k, "resolution=6", "edge=16 levels=2", settings, sizeof settings);
    hostile_with(ctx, &btf_codec_cmf, cmf_fit(ctx, &m, settings), check);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void test_sizes(void **unused) {
  (void)unused;
  with_models(hostile_sizes);
}

/* Any single changed byte is refused or harmless: of the small chunks all, of the large ones some. */
static void check_bytes(hostile_payload *p) {
  for (uint32_t i = 0; i < p->count; i++) {
    const uint64_t size = p->chunk[i].size;
    for (uint64_t at = 0; at<size; at += size> 200 ? size / 23 + 1 : 1) {
      unsigned char *byte = p->chunk[i].data + at;
      const unsigned char wild[] = {0xff, 0x7f, 0x80, (unsigned char)(*byte ^ 1)};
      for (size_t n = 0; n < sizeof wild; n++) {
        const btf_status status = hostile_change(p, byte, &wild[n], 1);
        assert_true(status == BTF_OK || status == BTF_E_CORRUPT);
      }
    }
  }
}

static void test_bytes(void **unused) {
  (void)unused;
  with_models(check_bytes);
}

static void flip_bits(hostile_payload *p) {
  hostile_bits(p, 300, 0);
}

static void test_bits(void **unused) {
  (void)unused;
  with_models(flip_bits);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes), cmocka_unit_test(test_bytes),
                                     cmocka_unit_test(test_bits)};
  return btf_run("cmf_payload", tests);
}
