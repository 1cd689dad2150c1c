/* SPDX-License-Identifier: MIT */
/* Payloads that are wrong: every chunk missing, of another size, with wild numbers, indices and flipped bits.
 * The loader is called through the codec's table with chunks in memory, below all checksums. */
#include "test_clusters.h"

#include "hostile_payload.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_lpca;

static void with_models(void (*check)(hostile_payload *payload)) {
  const char *const settings[] = {"clusters=4 components=3",
                                  "clusters=4 components=9 storage=q8 packing=tight",
                                  "clusters=3 components=2 storage=f32 packing=tight"};
  for (size_t i = 0; i < 6; i++) {
    btf_context *ctx = test_context_with(&memory, i < 3 ? NULL : "scalar", 1);
    material m =
        material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 6, 4, i % 2 ? 3 : 2, true, BTF_WRAP_PERIODIC);
    hostile_with(ctx, &btf_codec_lpca, lpca_fit(ctx, &m, settings[i % 3]), check);
    material_release(&m);
    test_context_done(ctx, &memory);
  }
}

static void test_sizes(void **unused) {
  (void)unused;
  with_models(hostile_sizes);
}

/* Wild values of every field of the header, of scales and of indices. */
static void check_numbers(hostile_payload *p) {
  const uint32_t wild[] = {0, 1, 5, 65, 1025, 0x7fffffff, 0x80000000u, 0xffffffffu};
  unsigned char *head = hostile_data(p, LPCA_TAG_HEAD);
  for (uint32_t field = 0; field < 6; field++)
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      if (memcmp(head + 4 * field, &wild[i], 4) == 0) continue;
      /* Fewer levels than there are chunks, and packings that differ in nothing. */
      const int harmless = (field == 4 && wild[i] == 1) || (field == 1 && wild[i] <= 1);
      const btf_status status = hostile_change(p, head + 4 * field, &wild[i], 4);
      if (status != BTF_E_CORRUPT && !harmless) fail_msg("field %u = %u: status %d", field, wild[i], status);
    }
  const double numbers[] = {NAN, INFINITY, -1.0};
  for (uint32_t i = 0; i < 9; i++)
    assert_status(hostile_change(p, head + 24 + 8 * (i / 3), &numbers[i % 3], 8), BTF_E_CORRUPT);
  const float scales[] = {NAN, INFINITY, -INFINITY};
  unsigned char *scale = hostile_data(p, LPCA_TAG_SCALES);
  for (uint32_t i = 0; i < 6; i++)
    assert_status(hostile_change(p, scale + 4 * (i / 3), &scales[i % 3], 4), BTF_E_CORRUPT);
  for (uint32_t i = 0; i < p->count; i++) {
    if (p->chunk[i].tag != LPCA_TAG_CLUSTERS) continue;
    unsigned char *last = p->chunk[i].data + p->chunk[i].size - 1;
    assert_status(hostile_change(p, last, "\4", 1), BTF_E_CORRUPT);
    assert_message_has("cluster 4 of");
  }
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

static void check_wide_index(hostile_payload *p) {
  assert_status(hostile_change(p, hostile_data(p, LPCA_TAG_CLUSTERS) + 1, "\2", 1), BTF_E_CORRUPT);
}

/* More clusters than a byte can count: two bytes for each texel, checked as well. */
static void test_wide_indices(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:3x1", 20, 16, 1, true, BTF_WRAP_PERIODIC);
  btf_model *model = lpca_fit(ctx, &m, "clusters=300 components=1 storage=f32");
  const btfi_lpca_state *s = lpca_state(model);
  assert_int_equal(s->layout.index_bytes, 2);
  assert_true(model_squared_error(model, &m) < 1e-3 * material_energy(&m));
  hostile_with(ctx, &btf_codec_lpca, model, check_wide_index);
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes), cmocka_unit_test(test_numbers),
                                     cmocka_unit_test(test_bits), cmocka_unit_test(test_wide_indices)};
  return btf_run("lpca_payload", tests);
}
