/* SPDX-License-Identifier: MIT */
/* Payloads that are wrong: missing and misshapen chunks, wild numbers, flipped bits. The loader is called
 * through the codec's table with chunks in memory, below all checksums. */
#include "test_lobes.h"

#include "hostile_payload.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_lafortune;

static void with_models(void (*check)(hostile_payload *payload)) {
  /* Records of 3 values and more, of both storages: the last ones lie nearer to the end than kernels read. */
  const struct {
    const char *settings;
    uint32_t channels;
  } cases[] = {{"", 3},
               {"kind=phong", 1},
               {"lobes=3 storage=f32", 3},
               {"kind=full storage=f32", 2},
               {"kind=ward", 3},
               {"color=channel", 3},
               {"lobes=1", 1},
               {"kind=lewis storage=f32", 1}};
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    material m = material_create(ctx, plant_two_lobes, 0.0, "grid:3x2", 3, 2, cases[i].channels,
                                 BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
    hostile_with(ctx, &btf_codec_lafortune, lafortune_fit(ctx, &m, cases[i].settings), check);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

static void test_sizes(void **unused) {
  (void)unused;
  with_models(hostile_sizes);
}

/* Wild values of every field of the header, scales and records. */
static void check_numbers(hostile_payload *p) {
  const uint32_t wild[] = {6, 33, 0x7fffffff, 0x80000000u, 0xffffffffu};
  const double numbers[] = {NAN, INFINITY, -1.0};
  const float scales[] = {NAN, INFINITY, -1.0f, 0.0f};
  unsigned char *head = hostile_data(p, LAF_TAG_HEAD);
  for (uint32_t field = 0; field < 6; field++)
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++)
      assert_status(hostile_change(p, head + 4 * field, &wild[i], 4), BTF_E_CORRUPT);
  /* Legal values that do not go with the chunks. */
  for (uint32_t field = 0; field < 4; field++)
    for (uint32_t value = 0; value < 6; value++) {
      const uint32_t mine = head[4 * field];
      const unsigned char byte = (unsigned char)value;
      const btf_status status = hostile_change(p, head + 4 * field, &byte, 1);
      /* Phong, Blinn-Phong and Lewis have records of the same size, and colours do of one channel. */
      assert_true(status == BTF_E_CORRUPT ||
                  (status == BTF_OK && (value == mine || field == 0 || field == 2)));
    }
  for (uint32_t field = 0; field < 2; field++)
    for (size_t i = 0; i < 3; i++)
      assert_status(hostile_change(p, head + 24 + 8 * field, &numbers[i], 8), BTF_E_CORRUPT);
  unsigned char *scale = hostile_data(p, LAF_TAG_SCALE);
  for (size_t i = 0; i < 4; i++) assert_status(hostile_change(p, scale, &scales[i], 4), BTF_E_CORRUPT);
  const uint32_t texels = hostile_find(p, LAF_TAG_TEXELS);
  const uint64_t last = p->chunk[texels].size - 4;
  for (int end = 0; end < 2; end++) {
    unsigned char *value = p->chunk[texels].data + (end ? last : 0);
    assert_status(hostile_change(p, value, "\377\377\377\377", 4), BTF_E_CORRUPT);
  }
}

static void test_numbers(void **unused) {
  (void)unused;
  with_models(check_numbers);
}

static void flip_bits(hostile_payload *p) {
  hostile_bits(p, 300, 0);
}

static void test_bits(void **unused) {
  (void)unused;
  with_models(flip_bits);
}

/* A file, loaded as a copy and from a mapping, evaluates as the fresh fit does. */
static void test_files(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m =
      material_create(ctx, plant_two_lobes, 0.0, "grid:5x3", 5, 4, 3, BTF_QUANTITY_BRDF, BTF_WRAP_PERIODIC);
  btf_model *model = lafortune_fit(ctx, &m, ""), *loaded;
  const char *path = test_path("lobes.btfz");
  assert_ok(btf_model_save(model, path, 0, NULL, NULL));
  assert_ok(btf_model_load(ctx, path, &loaded));
  for (int i = 0; i < 200; i++) {
    btf_query q = {{0}, {0}, {(float)test_random(), (float)test_random()}, (float)(2.0 * test_random()), 0};
    float a[3], b[3];
    test_random_direction(q.light);
    test_random_direction(q.view);
    btf_model_eval(model, &q, a);
    btf_model_eval(loaded, &q, b);
    assert_memory_equal(a, b, sizeof a);
  }
  btf_model_release(loaded);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes), cmocka_unit_test(test_numbers),
                                     cmocka_unit_test(test_bits), cmocka_unit_test(test_files)};
  return btf_run("lafortune_payload", tests);
}
