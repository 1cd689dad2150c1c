/* SPDX-License-Identifier: MIT */
/* The paper's textures, and payloads that are wrong: every chunk missing, of another size, with wild numbers
 * and flipped bits. The loader is called through the codec's table with chunks in memory, below all
 * checksums. */
#include "test_laplacian_fits.h"

#include "hostile_payload.h"

static test_memory memory;

extern const btf_codec_vtbl btf_codec_laplacian;

/* ---- packing ---- */

static btfi_laplacian_packing packing_of(uint32_t width, uint32_t height, uint32_t levels, uint32_t y,
                                         uint32_t cb, uint32_t cr) {
  const btfi_laplacian_grid grid =
      btfi_laplacian_grid_of(LAPLACIAN_PAPER_FILTER, BTF_WRAP_PERIODIC, levels, width, height);
  btfi_laplacian_head head = {.levels = levels};
  btfi_laplacian_packing packing;
  for (uint32_t k = 0; k < levels; k++) {
    head.count[k][LAPLACIAN_Y] = y;
    head.count[k][LAPLACIAN_CB] = cb;
    head.count[k][LAPLACIAN_CR] = cr;
  }
  btfi_laplacian_packing_of(&head, &grid, 9, 7, &packing);
  return packing;
}

/* Pairs and texels of full rank that take next to no memory: a sample is the entry of one list at the sum of
 * its places. */
static material list_material(btf_context *ctx, uint32_t side) {
  material m = {.width = side, .height = side, .channels = 3};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  assert_ok(btf_dirset_create_named(ctx, "ubo81", &m.directions));
  m.count = btf_dirset_count(m.directions);
  const uint32_t steps[5] = {211, 7, 3, 97, 1};
  const size_t values = (m.count - 1) * (steps[0] + steps[1]) + (side - 1) * (steps[2] + steps[3]) + 3;
  m.samples = malloc(values * sizeof *m.samples);
  for (size_t i = 0; i < values; i++) m.samples[i] = test_random();
  desc.lights = desc.views = m.directions;
  desc.width = desc.height = side;
  desc.channels = 3;
  desc.wrap = BTF_WRAP_PERIODIC;
  desc.quantity = BTF_QUANTITY_BRDF;
  desc.data = desc.user = m.samples;
  desc.release = free;
  desc.strides = (btf_strides){4 * (ptrdiff_t)steps[0], 4 * (ptrdiff_t)steps[1], 4 * (ptrdiff_t)steps[3],
                               4 * (ptrdiff_t)steps[2], 4};
  assert_ok(btf_dataset_create(ctx, &desc, &m.ds));
  return m;
}

static btf_gpu_texture exported(const btf_gpu_export *e, const char *name) {
  for (uint32_t i = 0; i < btf_gpu_texture_count(e); i++) {
    btf_gpu_texture t = BTF_GPU_TEXTURE_INIT;
    assert_ok(btf_gpu_texture_at(e, i, &t));
    if (strcmp(t.name, name) == 0) return t;
  }
  fail_msg("no texture %s", name);
  return (btf_gpu_texture)BTF_GPU_TEXTURE_INIT;
}

static uint64_t exported_bytes(const btf_gpu_export *e, const char *name, uint32_t width, uint32_t height) {
  const btf_gpu_texture t = exported(e, name);
  assert_int_equal(t.dimension, BTF_TEXTURE_2D);
  assert_int_equal(t.texel, BTF_TEXEL_RGBA32_FLOAT);
  assert_int_equal(t.width, width);
  assert_int_equal(t.height, height);
  assert_int_equal(t.level_count, 1);
  return t.levels[0].size;
}

/* LAP08, LAP09, LAP10, FOM11: an export of the paper's settings has the printed sizes, to the byte. */
static void test_sizes_of_maps(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = list_material(ctx, 64);
  btf_model *model = laplacian_fit(ctx, &m, "filter=paper levels=5 accuracy=0.1");
  btf_gpu_export *e;
  assert_ok(btf_gpu_export_create(model, NULL, &e));
  const uint64_t eigen = exported_bytes(e, "btf_eigen_map", 3 * 81, 5 * 81);
  const uint64_t weights = exported_bytes(e, "btf_weights_map", 128, 128);
  assert_int_equal(eigen, 1574640);
  assert_int_equal(weights, 262144);
  assert_int_equal(eigen + weights, 1836784);
  const double ratio = 80621568.0 / (double)(eigen + weights);
  assert_near(ratio, 43.9, 0.05);
  const btfi_laplacian_packing large = packing_of(256, 256, 5, 8, 2, 2);
  assert_near(81.0 * 81.0 * 256.0 * 256.0 * 3.0 / (double)(eigen + 16 * (uint64_t)large.width * large.height),
              223.6, 0.05);
  print_message("eigen map %llu bytes, weight map %llu bytes, %.1f times smaller than the images\n",
                (unsigned long long)eigen, (unsigned long long)weights, ratio);
  btf_gpu_export_release(e);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* A model whose maps are too large for a target says so, and that the other layout would do. */
static void test_maps_beyond_a_target(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 20, 6, 3, true, BTF_WRAP_PERIODIC);
  btf_model *model = laplacian_fit(ctx, &m, "levels=2");
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  btf_gpu_export *e;
  target.max_2d = 39; /* of 40 */
  assert_status(btf_gpu_export_create(model, &target, &e), BTF_E_LIMIT);
  assert_non_null(strstr(btf_error_message(), "\"arrays\""));
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

static unsigned char *unused_places(uint64_t places) {
  unsigned char *used = calloc(places, 1);
  assert_non_null(used);
  return used;
}

/* LAP09: every component has a place of its own; five levels of 64 x 64 fill 3.996 of 4 r^2 texels. */
static void test_layout_is_free_of_collisions(void **unused) {
  (void)unused;
  const uint32_t shapes[][4] = {{64, 64, 5, 3}, {16, 8, 4, 3}, {12, 7, 3, 3}, {1, 9, 4, 3},
                                {33, 2, 6, 3},  {1, 1, 1, 3},  {16, 8, 4, 7}, {5, 64, 7, 8}};
  for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++) {
    const uint32_t width = shapes[i][0], height = shapes[i][1], levels = shapes[i][2], planes = shapes[i][3];
    const btfi_laplacian_packing p = packing_of(width, height, levels, 4 * planes - 4, 2, 1);
    const uint64_t places = (uint64_t)p.width * p.height;
    unsigned char *used = unused_places(places * p.layers);
    uint64_t filled = 0;
    assert_int_equal(p.planes, planes);
    assert_int_equal(p.layers, (planes + 2) / 3);
    for (uint32_t k = 0; k < levels; k++)
      for (uint32_t plane = 0; plane < planes; plane++)
        for (uint32_t y = 0; y < btf_sampling_level_size(height, k); y++)
          for (uint32_t x = 0; x < btf_sampling_level_size(width, k); x++, filled++) {
            const uint64_t place = btfi_laplacian_weight_place(&p, k, plane, x, y);
            assert_true(place < places);
            assert_int_equal(used[plane / 3 * places + place]++, 0);
          }
    if (i == 0) assert_int_equal(filled, 16368);
    /* Beyond the paper's size only where levels stay one texel wide. */
    if ((width >> (levels - 1)) > 0) assert_int_equal(p.width, 2 * width);
    if ((height >> (levels - 1)) > 0) assert_int_equal(p.height, 2 * height);
    free(used);
  }
  const btfi_laplacian_packing p = packing_of(8, 8, 3, 8, 2, 2);
  const uint64_t places = 3 * 3 * 9 * 7;
  unsigned char *used = unused_places(places);
  for (uint32_t n = 0; n < places; n++) {
    const uint64_t place = btfi_laplacian_eigen_place(&p, n / 189, n / 63 % 3, n % 9, n / 9 % 7);
    assert_true(place < places);
    assert_int_equal(used[place]++, 0);
  }
  free(used);
}

/* LAP08: what a shader decodes from the two maps is what the tables decode. */
static void check_packed(const btf_model *model, const material *m) {
  const btfi_laplacian_state *s = laplacian_state(model);
  const uint32_t levels = s->grid.levels, n = m->count;
  btfi_laplacian_packing p;
  float *layers[LAPLACIAN_MAX_LAYERS];
  btfi_laplacian_packing_of(&s->head, &s->grid, n, n, &p);
  float *eigen = calloc((size_t)p.planes * n * n * levels, 16);
  for (uint32_t i = 0; i < p.layers; i++) layers[i] = calloc((size_t)p.width * p.height, 16);
  btfi_laplacian_pack(s, &p, eigen, layers);
  for (uint32_t turn = 0; turn < 400; turn++) {
    const uint32_t level = turn % levels, light = turn * 7 % n, view = turn / 3 % n;
    const uint32_t x = turn * 5 % s->grid.width[level], y = turn / 2 % s->grid.height[level];
    const float *xyz = btf_dirset_directions(m->directions);
    double sums[3] = {0.0};
    for (uint32_t k = level; k < levels; k++)
      for (uint32_t plane = 0; plane < p.planes; plane++) {
        const float *e = eigen + 4 * btfi_laplacian_eigen_place(&p, k, plane, light, view);
        const float *w = layers[plane / 3] +
                         4 * btfi_laplacian_weight_place(&p, k, plane, x >> (k - level), y >> (k - level));
        for (int part = 0; part < 4; part++)
          sums[4 * plane < s->head.count[k][LAPLACIAN_Y] ? 0 : 1 + part / 2] += (double)e[part] * w[part];
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
  for (uint32_t i = 0; i < p.layers; i++) free(layers[i]);
}

static void test_packed_equals_tables(void **unused) {
  (void)unused;
  /* Sizes are powers of two, so that a texel of a coarser level is that of halved numbers. */
  static const struct {
    uint32_t width, height;
    const char *settings;
  } cases[] = {{16, 16, "filter=paper levels=4"},
               {16, 16, "filter=paper storage=f32 levels=3 y=5 cr=1"},
               {16, 16, "filter=paper storage=f32 levels=3 y=9 cb=3 cr=4"},
               {16, 1, "filter=paper levels=5"},
               {2, 16, "filter=paper storage=f32 levels=5 y=9"}};
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", cases[i].width, cases[i].height, 3, true,
                                 BTF_WRAP_PERIODIC);
    btf_model *model = laplacian_fit(ctx, &m, cases[i].settings);
    check_packed(model, &m);
    btf_model_release(model);
    material_release(&m);
  }
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
                                     cmocka_unit_test(test_maps_beyond_a_target),
                                     cmocka_unit_test(test_layout_is_free_of_collisions),
                                     cmocka_unit_test(test_packed_equals_tables),
                                     cmocka_unit_test(test_sizes),
                                     cmocka_unit_test(test_numbers),
                                     cmocka_unit_test(test_bits)};
  return btf_run("laplacian_payload", tests);
}
