/* SPDX-License-Identifier: MIT */
/* Coefficient textures, and payloads that are wrong: missing and misshapen chunks, wild numbers, flipped
 * bits. The loader is called through the codec's table with chunks in memory, below all checksums. */
#include "test_lobes.h"

#include "hostile_payload.h"

#include <btf/btf_half.h>

static test_memory memory;

extern const btf_codec_vtbl btf_codec_lafortune;

/* ---- coefficient textures ---- */

typedef struct export_case {
  const char *settings;
  uint32_t kind, lobes, shape, channels, groups; /* as exported; groups of one channel, or one of all */
  uint32_t layers, value_bytes;
} export_case;

/* Value i of a texel: four to a layer. */
static double exported_value(const export_case *row, const btf_gpu_level *level, uint32_t x, uint32_t y,
                             uint32_t i) {
  const size_t texel = ((size_t)(i / 4) * level->height + y) * level->width + x;
  const unsigned char *at = (const unsigned char *)level->data + (texel * 4 + i % 4) * row->value_bytes;
  uint16_t half;
  float number;
  if (row->value_bytes == 4) {
    memcpy(&number, at, sizeof number);
    return (double)number;
  }
  memcpy(&half, at, sizeof half);
  return (double)btf_half_to_float(half);
}

static void decode_texel(const export_case *row, const btf_gpu_level *level, double scale, uint32_t x,
                         uint32_t y, uint32_t group, planted *out) {
  const uint32_t channels = row->channels / row->groups;
  uint32_t next = group * (row->lobes * row->shape + (1 + row->lobes) * channels);
  *out = (planted){.kind = row->kind, .lobes = row->lobes, .channels = channels};
  for (uint32_t j = 0; j < row->lobes; j++)
    for (uint32_t i = 0; i < row->shape; i++) out->shape[j][i] = exported_value(row, level, x, y, next++);
  for (uint32_t j = 0; j <= row->lobes; j++)
    for (uint32_t c = 0; c < channels; c++)
      out->albedo[j][c] = scale * exported_value(row, level, x, y, next++);
}

static void check_level(const export_case *row, const btf_model *model, const material *m, uint32_t number,
                        const btf_gpu_level *level, double scale) {
  const float *xyz = btf_dirset_directions(m->directions);
  assert_int_equal(level->size, (uint64_t)level->width * level->height * row->layers * 4 * row->value_bytes);
  for (uint32_t turn = 0; turn < 60; turn++) {
    const uint32_t x = turn % level->width, y = turn / 3 % level->height;
    const uint32_t light = turn * 5 % m->count, view = turn / 2 % m->count;
    float got[8];
    btf_model_texel(model, number, x, y, light, view, got);
    for (uint32_t c = 0; c < row->channels; c++) {
      planted texel;
      decode_texel(row, level, scale, x, y, row->groups > 1 ? c : 0, &texel);
      /* Exponents of this material stay below 100: 2.4e-7 of a base make 2.4e-5 of a power, and values are
       * below 2. */
      assert_near(got[c], planted_value(&texel, row->groups > 1 ? 0 : c, xyz + 3 * light, xyz + 3 * view),
                  6e-5);
    }
  }
}

/* REN08: what is decoded from the texture by the book is what the model gives; sizes to the byte. */
static void test_coefficient_textures(void **unused) {
  static const export_case cases[] = {
      {"", LAF_DIAGONAL, 2, 4, 3, 1, 5, 2},
      {"lobes=3 storage=f32", LAF_DIAGONAL, 3, 4, 3, 1, 6, 4},
      {"kind=full lobes=2 starts=1 iterations=20", LAF_FULL, 2, 10, 3, 1, 8, 2},
      {"color=channel lobes=1", LAF_DIAGONAL, 1, 4, 3, 3, 5, 2},
      {"kind=ward storage=f32", LAF_WARD, 1, 2, 3, 1, 2, 4},
      {"kind=lewis color=channel", LAF_LEWIS, 1, 1, 3, 3, 3, 2},
  };
  btf_context *ctx = test_context(&memory);
  (void)unused;
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
    for (uint32_t channels = 3; channels < 5; channels++) { /* of four, three are exported */
      const export_case *row = &cases[i];
      material m = material_create(ctx, plant_two_lobes, 0.0, "grid:4x3", 6, 4, channels, BTF_QUANTITY_BRDF,
                                   BTF_WRAP_PERIODIC);
      btf_model *model = lafortune_fit(ctx, &m, row->settings);
      btf_gpu_texture t = BTF_GPU_TEXTURE_INIT;
      btf_gpu_export *e;
      assert_ok(btf_gpu_export_create(model, NULL, &e));
      assert_int_equal(btf_gpu_texture_count(e), 1);
      assert_ok(btf_gpu_texture_at(e, 0, &t));
      assert_string_equal(t.name, "btf_lobes_map");
      assert_int_equal(t.texel, row->value_bytes == 2 ? BTF_TEXEL_RGBA16_FLOAT : BTF_TEXEL_RGBA32_FLOAT);
      assert_int_equal(t.layers, row->layers);
      assert_int_equal(t.level_count, 3);
      for (uint32_t k = 0; k < t.level_count; k++)
        check_level(row, model, &m, k, &t.levels[k], (double)lafortune_state(model)->scale[k]);
      btf_gpu_export_release(e);
      btf_model_release(model);
      material_release(&m);
    }
  test_context_done(ctx, &memory);
}

/* ---- wrong payloads ---- */

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
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_coefficient_textures),
                                     cmocka_unit_test(test_sizes), cmocka_unit_test(test_numbers),
                                     cmocka_unit_test(test_bits), cmocka_unit_test(test_files)};
  return btf_run("lafortune_payload", tests);
}
