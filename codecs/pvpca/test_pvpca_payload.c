/* SPDX-License-Identifier: MIT */
/* Payloads that are wrong: every chunk missing, of another size, with wild numbers and flipped bits. The
 * loader is called through the codec's table with chunks in memory, below all checksums. */
#include "test_views.h"

#include "hostile_payload.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_pvpca;

static void with_models(void (*check)(hostile_payload *payload)) {
  const char *const settings[] = {"components=6 storage=f16", "components=6 storage=q8 mean=false",
                                  "components=1 storage=f32", "components=5 storage=f16 color=texels",
                                  "components=3 storage=q8 color=texels budget=adaptive"};
  for (size_t isa = 0; isa < 2; isa++) {
    btf_context *ctx = test_context_with(&memory, isa ? "scalar" : NULL, 1);
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 6, 4, 3, true, BTF_WRAP_PERIODIC);
    for (size_t i = 0; i < 5; i++)
      hostile_with(ctx, &btf_codec_pvpca, pvpca_fit(ctx, &m, settings[i]), check);
    material_release(&m);
    test_context_done(ctx, &memory);
  }
}

static void test_sizes(void **unused) {
  (void)unused;
  with_models(hostile_sizes);
}

/* Wild values of every field of the header: refused, but for what changes nothing that is read: fewer levels,
 * and 0 flags where there is no mean. Another storage or color changes the sizes. */
static void check_header(hostile_payload *p) {
  const uint32_t wild[] = {0, 1, 2, 3, 7, 1025, 0x7fffffff, 0x80000000u, 0xffffffffu};
  unsigned char *head = hostile_data(p, PVPCA_TAG_HEAD);
  for (uint32_t field = 0; field < 6; field++)
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      if (memcmp(head + 4 * (size_t)field, &wild[i], 4) == 0) continue;
      const int harmless = field == 2 && wild[i] < 4 && wild[i] > 0;
      const btf_status status = hostile_change(p, head + 4 * (size_t)field, &wild[i], 4);
      if (status != (harmless ? BTF_OK : BTF_E_CORRUPT))
        fail_msg("field %u = %u: status %d", field, wild[i], status);
    }
  const double numbers[] = {NAN, INFINITY, -1.0};
  for (uint32_t field = 0; field < 2; field++)
    for (size_t i = 0; i < 3; i++)
      assert_status(hostile_change(p, head + 24 + 8 * (size_t)field, &numbers[i], 8), BTF_E_CORRUPT);
}

static void test_header(void **unused) {
  (void)unused;
  with_models(check_header);
}

/* Numbers of terms that do not fit the tables or exceed what scratch holds; scales that are not finite. */
static void check_numbers(hostile_payload *p) {
  unsigned char *terms = hostile_data(p, PVPCA_TAG_TERMS), *scale = hostile_data(p, PVPCA_TAG_SCALES);
  const uint32_t wild[] = {0, 4, 64, 65, 0x10000, 0x40000000, 0xffffffffu};
  const float wrong[] = {NAN, INFINITY, -INFINITY, -1.0f};
  for (uint32_t view = 0; view < 8; view += 7)
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      if (memcmp(terms + 4 * (size_t)view, &wild[i], 4) == 0) continue;
      assert_status(hostile_change(p, terms + 4 * (size_t)view, &wild[i], 4), BTF_E_CORRUPT);
    }
  for (size_t i = 0; i < 4; i++) assert_status(hostile_change(p, scale, &wrong[i], 4), BTF_E_CORRUPT);
}

static void test_numbers(void **unused) {
  (void)unused;
  with_models(check_numbers);
}

static void flip_bits(hostile_payload *p) {
  hostile_bits(p, 300, 1);
}

static void test_bits(void **unused) {
  (void)unused;
  with_models(flip_bits);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes), cmocka_unit_test(test_header),
                                     cmocka_unit_test(test_numbers), cmocka_unit_test(test_bits)};
  return btf_run("pvpca_payload", tests);
}
