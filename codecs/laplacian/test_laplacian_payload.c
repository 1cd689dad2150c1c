/* SPDX-License-Identifier: MIT */
/* The paper's textures, and payloads that are wrong: every chunk missing, of another size, with wild numbers
 * and flipped bits. The loader is called through the codec's table with chunks in memory, below all
 * checksums. */
#include "test_laplacian_fits.h"

#include "hostile_payload.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_laplacian;

/* ---- packing ---- */

/* LAP08, LAP09, LAP10, FOM11: the printed sizes, to the byte. */
static void test_sizes_of_maps(void **unused) {
  (void)unused;
  const uint64_t eigen = btfi_laplacian_eigen_map_bytes(81, 81, 5),
                 weights = btfi_laplacian_weight_map_bytes(64, 64);
  assert_int_equal(eigen, 1574640);
  assert_int_equal(weights, 262144);
  assert_int_equal(eigen + weights, 1836784);
  const double ratio = 80621568.0 / (double)(eigen + weights);
  assert_near(ratio, 43.9, 0.05);
  assert_near(81.0 * 81.0 * 256.0 * 256.0 * 3.0 / (double)(eigen + btfi_laplacian_weight_map_bytes(256, 256)),
              223.6, 0.05);
  print_message("eigen map %llu bytes, weight map %llu bytes, %.1f times smaller than the images\n",
                (unsigned long long)eigen, (unsigned long long)weights, ratio);
}

/* LAP09: every component has a place of its own; five levels of 64 x 64 fill 3.996 of 4 r^2 texels. */
static void test_layout_is_free_of_collisions(void **unused) {
  (void)unused;
  const uint32_t shapes[][3] = {{64, 64, 5}, {16, 8, 4}, {12, 7, 3}, {1, 9, 4}, {33, 2, 6}, {1, 1, 1}};
  for (size_t i = 0; i < 6; i++) {
    const uint32_t width = shapes[i][0], height = shapes[i][1], levels = shapes[i][2];
    const uint64_t places = btfi_laplacian_weight_map_bytes(width, height) / 16;
    unsigned char *used = calloc(places, 1);
    uint64_t filled = 0;
    for (uint32_t k = 0; k < levels; k++)
      for (uint32_t plane = 0; plane < LAPLACIAN_PLANES; plane++)
        for (uint32_t y = 0; y < btf_sampling_level_size(height, k); y++)
          for (uint32_t x = 0; x < btf_sampling_level_size(width, k); x++, filled++) {
            const uint64_t place = btfi_laplacian_weight_place(width, height, k, plane, x, y);
            /* Levels that stay one texel wide grow beyond the quadrants of a paper that has squares alone. */
            if (k > 0 && (width >> k == 0 || height >> k == 0)) continue;
            assert_true(place < places);
            assert_int_equal(used[place]++, 0);
          }
    if (i == 0) assert_int_equal(filled, 16368);
    free(used);
  }
  const uint64_t places = btfi_laplacian_eigen_map_bytes(9, 7, 3) / 16;
  unsigned char *used = calloc(places, 1);
  for (uint32_t n = 0; n < 3 * 3 * 9 * 7; n++) {
    const uint64_t place = btfi_laplacian_eigen_place(9, 7, n / 189, n / 63 % 3, n % 9, n / 9 % 7);
    assert_true(place < places);
    assert_int_equal(used[place]++, 0);
  }
  free(used);
}

/* LAP08: what a shader decodes from the two maps is what the tables decode. */
static void test_packed_equals_tables(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 16, 16, 3, true, BTF_WRAP_PERIODIC);
  const char *const settings[] = {"filter=paper levels=4", "filter=paper storage=f32 levels=3 y=5 cr=1"};
  for (size_t i = 0; i < 2; i++) {
    btf_model *model = laplacian_fit(ctx, &m, settings[i]);
    const btfi_laplacian_state *s = laplacian_state(model);
    const uint32_t levels = s->grid.levels, n = m.count;
    float *eigen = malloc(btfi_laplacian_eigen_map_bytes(n, n, levels));
    float *weights = malloc(btfi_laplacian_weight_map_bytes(16, 16));
    assert_true(btfi_laplacian_pack(s, eigen, weights));
    for (uint32_t turn = 0; turn < 400; turn++) {
      const uint32_t level = turn % levels, light = turn * 7 % n, view = turn / 3 % n;
      const uint32_t x = turn * 5 % (16u >> level), y = turn / 2 % (16u >> level);
      const float *xyz = btf_dirset_directions(m.directions);
      double sums[4] = {0.0};
      for (uint32_t k = level; k < levels; k++)
        for (uint32_t plane = 0; plane < 3; plane++) {
          const float *e = eigen + 4 * btfi_laplacian_eigen_place(n, n, k, plane, light, view);
          const float *w =
              weights + 4 * btfi_laplacian_weight_place(16, 16, k, plane, x >> (k - level), y >> (k - level));
          for (int part = 0; part < 4; part++)
            sums[plane < 2 ? 0 : 1 + part / 2] += (double)e[part] * w[part];
        }
      sums[0] += btfi_laplacian_phong_value(&s->head.phong, xyz + 3 * light, xyz + 3 * view);
      sums[1] += s->head.chroma[0];
      sums[2] += s->head.chroma[1];
      float got[3];
      btf_model_texel(model, level, x, y, light, view, got);
      /* 48 products of values below 1, in float here and there. */
      assert_near(got[0], sums[0] + 1.402 * sums[2], 4e-6);
      assert_near(got[1], sums[0] - 0.344136286 * sums[1] - 0.714136286 * sums[2], 4e-6);
      assert_near(got[2], sums[0] + 1.772 * sums[1], 4e-6);
    }
    free(eigen);
    free(weights);
    btf_model_release(model);
  }
  btf_model *large = laplacian_fit(ctx, &m, "y=9");
  assert_false(btfi_laplacian_pack(laplacian_state(large), NULL, NULL));
  btf_model_release(large);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ---- hostile payloads ---- */

static void with_models(void (*check)(hostile_payload *payload)) {
  const char *const settings[] = {"y=3 cb=1 levels=3", "y=3 storage=f32 filter=paper mean=table levels=2",
                                  "filter=binomial y=1 cb=0 cr=0 levels=1"};
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 6, 4, 3, true, BTF_WRAP_PERIODIC);
  for (size_t i = 0; i < 3; i++)
    hostile_with(ctx, &btf_codec_laplacian, laplacian_fit(ctx, &m, settings[i]), check);
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void test_sizes(void **unused) {
  (void)unused;
  with_models(hostile_sizes);
}

/* Wild values of every field of the header and of the levels: refused, but for those that change nothing that
 * is read. */
static void check_numbers(hostile_payload *p) {
  const uint32_t wild[] = {0, 1, 2, 3, 9, 26, 0x7fffffff, 0x80000000u, 0xffffffffu};
  const double wrong[] = {NAN, INFINITY, -INFINITY};
  unsigned char *head = hostile_data(p, LAPLACIAN_TAG_HEAD);
  unsigned char *levels = hostile_data(p, LAPLACIAN_TAG_LEVELS);
  for (uint32_t field = 0; field < 4; field++)
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      const bool known = field < 3 && wild[i] < 3, same = memcmp(head + 4 * field, &wild[i], 4) == 0;
      const btf_status status = hostile_change(p, head + 4 * field, &wild[i], 4);
      /* Another filter or mean reads the same tables in another way. */
      if (status != BTF_E_CORRUPT && !same && !(known && field != 2))
        fail_msg("field %u = %u loads", field, wild[i]);
    }
  for (uint32_t field = 0; field < 11; field++)
    for (size_t i = 0; i < 3; i++)
      assert_status(hostile_change(p, head + 16 + 8 * field, &wrong[i], 8), BTF_E_CORRUPT);
  const double exponents[] = {0.5, 1e6, -3.0, 1e31};
  for (size_t i = 0; i < 4; i++)
    assert_status(hostile_change(p, head + 16 + 24, &exponents[i], 8), BTF_E_CORRUPT);
  for (uint32_t c = 0; c < 3; c++) {
    for (size_t i = 0; i < sizeof wild / sizeof *wild; i++) {
      if (memcmp(levels + 32 * c, &wild[i], 4) == 0) continue;
      assert_status(hostile_change(p, levels + 32 * c, &wild[i], 4), BTF_E_CORRUPT);
    }
    for (uint32_t n = 0; n < 3; n++)
      assert_status(hostile_change(p, levels + 32 * c + 8 + 8 * n, &wrong[n], 8), BTF_E_CORRUPT);
  }
  unsigned char *scale = hostile_data(p, LAPLACIAN_TAG_SCALES);
  for (size_t i = 0; i < 3; i++) {
    const float value = (float)wrong[i];
    assert_status(hostile_change(p, scale, &value, 4), BTF_E_CORRUPT);
  }
}

static void test_numbers(void **unused) {
  (void)unused;
  with_models(check_numbers);
}

static void flip_bits(hostile_payload *p) {
  hostile_bits(p, 600, 0);
}

static void test_bits(void **unused) {
  (void)unused;
  with_models(flip_bits);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_sizes_of_maps),
                                     cmocka_unit_test(test_layout_is_free_of_collisions),
                                     cmocka_unit_test(test_packed_equals_tables),
                                     cmocka_unit_test(test_sizes),
                                     cmocka_unit_test(test_numbers),
                                     cmocka_unit_test(test_bits)};
  return btf_run("laplacian_payload", tests);
}
