/* SPDX-License-Identifier: MIT */
/* Payloads that are wrong: every chunk missing, of another size, with wild numbers and flipped bits. The
 * loader is called through the codec's table with chunks in memory, below all checksums. */
#include "test_materials.h"

#include "hostile_payload.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_fmf;

static bool is_plain(const hostile_payload *p) {
  return hostile_data(p, FMF_TAG_HEAD)[0] == FMF_PLAIN;
}

static void with_models(void (*check)(hostile_payload *payload)) {
  const char *const settings[] = {"components=6 storage=f16", "components=6 storage=q8 mean=true",
                                  "components=6 storage=f16 coding=plain",
                                  "components=6 storage=bf16 coding=plain",
                                  "components=6 storage=q8 coding=plain"};
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 6, 4, 3, true, BTF_WRAP_PERIODIC);
  for (size_t i = 0; i < 5; i++) hostile_with(ctx, &btf_codec_fmf, fmf_fit(ctx, &m, settings[i]), check);
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void test_sizes(void **unused) {
  (void)unused;
  with_models(hostile_sizes);
}

/* Wild values of every field of the header: refused, but for those that change nothing that is read. */
static void check_header(hostile_payload *p) {
  const uint32_t wild[] = {0, 3, 7, 1025, 0x7fffffff, 0x80000000u, 0xffffffffu};
  const bool plain = is_plain(p);
  unsigned char *head = hostile_data(p, FMF_TAG_HEAD);
  for (uint32_t field = 0; field < 6; field++) {
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      if (memcmp(head + 4 * field, &wild[i], 4) == 0) continue;
      const int harmless = (field == 5 && wild[i] == 0) || (field == 3 && !plain) ||
                           (field == 4 && wild[i] < 4 && wild[i] > 0) ||
                           (field == 1 && wild[i] < 4 && !plain);
      const btf_status status = hostile_change(p, head + 4 * field, &wild[i], 4);
      if (status != BTF_E_CORRUPT && !harmless) fail_msg("field %u = %u: status %d", field, wild[i], status);
    }
  }
  const double numbers[] = {NAN, INFINITY, -1.0};
  for (uint32_t field = 0; field < 5; field++) {
    for (size_t i = 0; i < 3; i++)
      assert_status(hostile_change(p, head + 24 + 8 * field, &numbers[i], 8), BTF_E_CORRUPT);
  }
}

static void test_header(void **unused) {
  (void)unused;
  with_models(check_header);
}

/* Singular values and scales that are not finite, columns of components that do not exist. */
static void check_numbers(hostile_payload *p) {
  const double wrong[] = {NAN, INFINITY, 0.0, -3.0};
  unsigned char *sigma = hostile_data(p, FMF_TAG_SIGMA);
  for (size_t i = 0; i < 4; i++) assert_status(hostile_change(p, sigma, &wrong[i], 8), BTF_E_CORRUPT);
  if (!is_plain(p)) return;
  unsigned char *column = hostile_data(p, FMF_TAG_COLUMNS);
  const float scales[] = {NAN, INFINITY, -INFINITY};
  for (size_t i = 0; i < 3; i++) {
    for (uint32_t side = 0; side < 2; side++)
      assert_status(hostile_change(p, column + 8 + 4 * side, &scales[i], 4), BTF_E_CORRUPT);
  }
  assert_status(hostile_change(p, column, "\310", 1), BTF_E_CORRUPT); /* component 200 */
  assert_status(hostile_change(p, column + 4, "\2", 1), BTF_E_CORRUPT);
}

static void test_numbers(void **unused) {
  (void)unused;
  with_models(check_numbers);
}

static void flip_bits(hostile_payload *p) {
  hostile_bits(p, 400, 1);
}

static void test_bits(void **unused) {
  (void)unused;
  with_models(flip_bits);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes), cmocka_unit_test(test_header),
                                     cmocka_unit_test(test_numbers), cmocka_unit_test(test_bits)};
  return btf_run("fmf_payload", tests);
}
