/* SPDX-License-Identifier: MIT */
/* Data sets evaluated as they stand, against sums over all samples in double. */
#include "dataset_cube.h"

#include "model/model.h"

static const uint32_t sample_types[] = {BTF_SAMPLE_U8, BTF_SAMPLE_F16, BTF_SAMPLE_F32, BTF_SAMPLE_U16};
static const uint32_t orders[] = {BTF_ORDER_VLYXC, BTF_ORDER_YXVLC};

/* Values of a size whose sums mean something: random bits give floats of all exponents. */
static void tame(test_cube *cube, uint64_t seed) {
  const btf_strides image = test_cube_strides(cube, BTF_ORDER_VLYXC, (ptrdiff_t)cube->size),
                    texel = test_cube_strides(cube, BTF_ORDER_YXVLC, (ptrdiff_t)cube->size);
  if (cube->type == BTF_SAMPLE_U8 || cube->type == BTF_SAMPLE_U16) return;
  unsigned char *from = cube->image_major;
  for (uint32_t v = 0; v < cube->views; ++v)
    for (uint32_t l = 0; l < cube->lights; ++l)
      for (uint32_t y = 0; y < cube->height; ++y)
        for (uint32_t x = 0; x < cube->width; ++x)
          for (uint32_t c = 0; c < cube->channels; ++c, from += cube->size) {
            const float value = test_uniform(&seed);
            const uint16_t half = (uint16_t)(0x3000u | (test_random(&seed) & 0x7ffu)); /* 0.125 .. 0.5 */
            memcpy(from, cube->type == BTF_SAMPLE_F16 ? (const void *)&half : (const void *)&value,
                   cube->size);
            memcpy(cube->texel_major + (ptrdiff_t)v * texel.view + (ptrdiff_t)l * texel.light +
                       (ptrdiff_t)y * texel.y + (ptrdiff_t)x * texel.x + (ptrdiff_t)c * texel.channel,
                   from, cube->size);
          }
  (void)image;
}

static uint32_t level_size(uint32_t size, uint32_t level) {
  return size >> level ? size >> level : 1;
}

static double overlap(double a0, double a1, double b0, double b1) {
  const double low = a0 > b0 ? a0 : b0, high = a1 < b1 ? a1 : b1;
  return high > low ? high - low : 0.0;
}

/* A texel of a level as the integral over its area. */
static double level_texel(const test_cube *cube, uint32_t v, uint32_t l, uint32_t level, uint32_t x,
                          uint32_t y, uint32_t c) {
  const double sx = (double)cube->width / level_size(cube->width, level),
               sy = (double)cube->height / level_size(cube->height, level);
  double sum = 0.0;
  for (uint32_t j = 0; j < cube->height; ++j) {
    const double wy = overlap(j, j + 1.0, y * sy, (y + 1) * sy);
    for (uint32_t i = 0; i < cube->width && wy > 0.0; ++i) {
      const double wx = overlap(i, i + 1.0, x * sx, (x + 1) * sx);
      if (wx > 0.0) sum += wx * wy * (double)test_cube_value(cube, v, l, j, i, c);
    }
  }
  return sum / (sx * sy);
}

static uint32_t wrapped(double i, uint32_t size, uint32_t wrap) {
  if (wrap == BTF_WRAP_CLAMP) return i < 0.0 ? 0 : i >= size ? size - 1 : (uint32_t)i;
  return (uint32_t)(i - floor(i / size) * size);
}

static double bilinear(const test_cube *cube, uint32_t v, uint32_t l, uint32_t level, const float uv[2],
                       uint32_t wrap, uint32_t c) {
  const uint32_t w = level_size(cube->width, level), h = level_size(cube->height, level);
  double u = uv[0], t = uv[1], sum = 0.0;
  if (wrap == BTF_WRAP_CLAMP) u = fmin(fmax(u, 0.0), 1.0), t = fmin(fmax(t, 0.0), 1.0);
  const double x = u * w - 0.5, y = t * h - 0.5, fx = x - floor(x), fy = y - floor(y);
  for (int j = 0; j < 2; ++j)
    for (int i = 0; i < 2; ++i)
      sum +=
          (i ? fx : 1.0 - fx) * (j ? fy : 1.0 - fy) *
          level_texel(cube, v, l, level, wrapped(floor(x) + i, w, wrap), wrapped(floor(y) + j, h, wrap), c);
  return sum;
}

static double reference(const test_cube *cube, const btf_query *q, uint32_t wrap, uint32_t levels,
                        uint32_t c) {
  btf_interp lights, views;
  btf_dirset_locate(cube->light_set, q->light, &lights);
  btf_dirset_locate(cube->view_set, q->view, &views);
  const double lod = fmin(fmax((double)q->lod, 0.0), levels - 1.0), f = lod - floor(lod);
  double sum = 0.0;
  for (uint32_t k = 0; k < 2; ++k) {
    const double wk = k ? f : 1.0 - f;
    for (int i = 0; i < 3 && wk > 0.0; ++i)
      for (int j = 0; j < 3; ++j)
        sum += wk * (double)lights.weight[i] * (double)views.weight[j] *
               bilinear(cube, views.index[j], lights.index[i], (uint32_t)floor(lod) + k, q->uv, wrap, c);
  }
  return sum;
}

static void random_direction(uint64_t *random, float d[3]) {
  const double z = 0.02 + 0.98 * (double)test_uniform(random), r = sqrt(fmax(0.0, 1.0 - z * z)),
               phi = 6.28318 * (double)test_uniform(random);
  d[0] = (float)(r * cos(phi));
  d[1] = (float)(r * sin(phi));
  d[2] = (float)z;
}

static btf_query random_query(uint64_t *random, float lods) {
  btf_query q = {{0, 0, 1}, {0, 0, 1}, {0, 0}, 0.0f, 0};
  random_direction(random, q.light);
  random_direction(random, q.view);
  q.uv[0] = 3.0f * test_uniform(random) - 1.0f;
  q.uv[1] = 3.0f * test_uniform(random) - 1.0f;
  q.lod = lods * test_uniform(random) - 0.5f;
  return q;
}

static btf_model *cube_model(btf_context *ctx, const test_cube *cube, uint32_t order, int source,
                             uint32_t wrap) {
  btf_dataset *ds = test_cube_dataset(ctx, cube, order, source, test_path("raw.btfd"));
  btf_model *model = NULL;
  if (wrap != BTF_WRAP_PERIODIC) {
    btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
    btf_dataset *clamped;
    assert_ok(btf_dataset_describe(ds, &desc));
    desc.wrap = wrap;
    assert_ok(btf_dataset_create(ctx, &desc, &clamped));
    btf_dataset_release(ds);
    ds = clamped;
  }
  assert_ok(btf_model_from_dataset(ds, NULL, &model));
  btf_dataset_release(ds);
  return model;
}

static void every_query_is_the_weighted_sum_of_samples(void **state) {
  (void)state;
  static const uint32_t shapes[][3] = {{7, 5, 3}, {8, 8, 1}, {1, 6, 4}, {12, 3, 64}};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  uint64_t random = 1;
  for (size_t t = 0; t < 4; ++t)
    for (size_t k = 0; k < 4; ++k)
      for (int source = 0; source < TEST_SOURCES; ++source) {
        test_cube cube;
        const uint32_t *shape = shapes[k];
        const uint32_t wrap = source == TEST_RESIDENT && k % 2 ? BTF_WRAP_CLAMP : BTF_WRAP_PERIODIC;
        test_cube_make(ctx, &cube, sample_types[t], 9, 11, shape[1], shape[0], shape[2], t + k);
        tame(&cube, t + k);
        btf_model *model = cube_model(ctx, &cube, orders[source % 2], source, wrap);
        btf_model_info info = BTF_MODEL_INFO_INIT;
        assert_ok(btf_model_describe(model, &info));
        assert_int_equal(info.channels, shape[2]);
        assert_string_equal(info.codec_id, "raw");
        assert_int_equal(info.levels, k == 3 || k == 1 ? 4 : 3);
        for (int i = 0; i < 60; ++i) {
          const btf_query q = random_query(&random, i % 2 ? 6.0f : 0.0f);
          float got[64];
          btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
          for (uint32_t c = 0; c < shape[2]; c += 7) /* float weights and one rounding of a value below 1 */
            assert_near(got[c], reference(&cube, &q, wrap, info.levels, c), 2e-6);
        }
        btf_model_release(model);
        test_cube_free(&cube);
      }
  test_context_done(ctx, &memory);
}

static void samples_are_met_exactly(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  for (size_t t = 0; t < 4; ++t)
    for (int source = 0; source < TEST_SOURCES; ++source) {
      test_cube cube;
      test_cube_make(ctx, &cube, sample_types[t], 5, 6, 7, 9, 3, 3);
      btf_model *model = cube_model(ctx, &cube, orders[source & 1], source, BTF_WRAP_PERIODIC);
      for (uint32_t v = 0; v < 5; ++v)
        for (uint32_t l = 0; l < 6; ++l)
          for (uint32_t y = 0; y < 7; ++y)
            for (uint32_t x = 0; x < 9; ++x) {
              btf_query q = {
                  {0, 0, 0}, {0, 0, 0}, {((float)x + 0.5f) / 9.0f, ((float)y + 0.5f) / 7.0f}, 0.0f, 0};
              float got[3], nearest[3], texel[3];
              memcpy(q.light, btf_dirset_directions(cube.light_set) + 3 * (size_t)l, sizeof q.light);
              memcpy(q.view, btf_dirset_directions(cube.view_set) + 3 * (size_t)v, sizeof q.view);
              btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
              btf_model_texel(model, 0, x, y, l, v, texel);
              q.flags = BTF_QUERY_NEAREST;
              q.uv[0] += 0.04f; /* of 0.055 to the border of the texel */
              q.lod = 0.4f;
              btf_model_eval_as(model, &q, BTF_VALUE_STORED, nearest);
              for (uint32_t c = 0; c < 3; ++c) {
                const float expected = test_cube_value(&cube, v, l, y, x, c);
                assert_true(got[c] == expected && nearest[c] == expected && texel[c] == expected);
              }
            }
      btf_model_release(model);
      test_cube_free(&cube);
    }
  test_context_done(ctx, &memory);
}

static void parabolic(const float d[3], double p[2]) {
  p[0] = d[0] / (1.0 + d[2]);
  p[1] = d[1] / (1.0 + d[2]);
}

static double linear_function(const float light[3], const float view[3]) {
  double a[2], b[2];
  parabolic(light, a);
  parabolic(view, b);
  return (1.0 + 0.5 * a[0] - 0.7 * a[1]) * (2.0 - 0.4 * b[0] + 0.3 * b[1]);
}

static void functions_linear_in_parabolic_coordinates_are_reproduced(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 60, 70, 1, 1, 1, 1);
  float *samples = (float *)(void *)cube.image_major;
  for (uint32_t v = 0; v < 60; ++v)
    for (uint32_t l = 0; l < 70; ++l)
      samples[v * 70 + l] = (float)linear_function(btf_dirset_directions(cube.light_set) + 3 * (size_t)l,
                                                   btf_dirset_directions(cube.view_set) + 3 * (size_t)v);
  btf_model *model = cube_model(ctx, &cube, BTF_ORDER_VLYXC, TEST_RESIDENT, BTF_WRAP_PERIODIC);
  uint64_t random = 5;
  double worst = 0.0;
  int inside = 0;
  for (int i = 0; i < 20000; ++i) {
    const btf_query q = random_query(&random, 3.0f);
    if (q.light[2] < 0.35f || q.view[2] < 0.35f) continue; /* well inside both hulls */
    float got;
    btf_model_eval(model, &q, &got);
    worst = fmax(worst, fabs((double)got - linear_function(q.light, q.view)));
    ++inside;
  }
  assert_true(inside > 5000);
  assert_near(worst, 0.0, 1e-5);
  btf_model_release(model);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void coarser_levels_are_means_of_finer_ones(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 3, 4, 8, 16, 2, 1);
  tame(&cube, 4);
  btf_model *model = cube_model(ctx, &cube, BTF_ORDER_YXVLC, TEST_MAPPED, BTF_WRAP_PERIODIC);
  for (uint32_t level = 1; level < 5; ++level) {
    const uint32_t w = level_size(16, level), h = level_size(8, level), down = level < 4 ? 2 : 1;
    for (uint32_t y = 0; y < h; ++y)
      for (uint32_t x = 0; x < w; ++x) {
        float coarse[2], fine[2];
        double mean[2] = {0.0, 0.0};
        btf_model_texel(model, level, x, y, 1, 2, coarse);
        for (uint32_t j = 0; j < down; ++j)
          for (uint32_t i = 0; i < 2; ++i) {
            btf_model_texel(model, level - 1, 2 * x + i, down * y + j, 1, 2, fine);
            for (int c = 0; c < 2; ++c) mean[c] += (double)fine[c] / (2.0 * down);
          }
        for (int c = 0; c < 2; ++c) assert_near(coarse[c], mean[c], 6e-8); /* roundings of values below 0.5 */
      }
  }
  /* Between levels nothing jumps, and at a level there is that level alone. */
  uint64_t random = 2;
  for (int i = 0; i < 200; ++i) {
    btf_query q = random_query(&random, 0.0f);
    float before[2], at[2], after[2];
    q.lod = (float)(1 + i % 3) - 1e-4f;
    btf_model_eval(model, &q, before);
    q.lod = (float)(1 + i % 3);
    btf_model_eval(model, &q, at);
    q.lod += 1e-4f;
    btf_model_eval(model, &q, after);
    for (int c = 0; c < 2; ++c) {
      assert_near(before[c], at[c], 1.1e-4); /* 1e-4 times a difference below 1 */
      assert_near(after[c], at[c], 1.1e-4);
    }
  }
  btf_model_release(model);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void textures_repeat_or_end(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 3, 4, 4, 8, 1, 1);
  tame(&cube, 4);
  btf_model *periodic = cube_model(ctx, &cube, BTF_ORDER_VLYXC, TEST_RESIDENT, BTF_WRAP_PERIODIC),
            *clamped = cube_model(ctx, &cube, BTF_ORDER_VLYXC, TEST_RESIDENT, BTF_WRAP_CLAMP);
  uint64_t random = 8;
  for (int i = 0; i < 300; ++i) {
    btf_query q = random_query(&random, 4.0f), moved;
    float here, there;
    q.uv[0] = (float)(test_random(&random) % 256) / 256.0f; /* exact however far it is moved */
    q.uv[1] = (float)(test_random(&random) % 256) / 256.0f;
    moved = q;
    moved.uv[0] += (float)(test_random(&random) % 9) - 4.0f;
    moved.uv[1] += (float)(test_random(&random) % 9) - 4.0f;
    btf_model_eval(periodic, &q, &here);
    btf_model_eval(periodic, &moved, &there);
    assert_true(here == there);
    q.uv[0] = -1.0f - test_uniform(&random);
    q.uv[1] = 0.0f;
    moved = q;
    moved.uv[0] = 0.0f;
    moved.uv[1] = -100.0f;
    btf_model_eval(clamped, &q, &here);
    btf_model_eval(clamped, &moved, &there);
    assert_true(here == there);
  }
  btf_query corner = {{0, 0, 1}, {0, 0, 1}, {7.0f, 9.0f}, 0.0f, 0};
  float got, expected = test_cube_value(&cube, 1, 2, 3, 7, 0);
  memcpy(corner.light, btf_dirset_directions(cube.light_set) + 3 * 2, sizeof corner.light);
  memcpy(corner.view, btf_dirset_directions(cube.view_set) + 3 * 1, sizeof corner.view);
  btf_model_eval(clamped, &corner, &got);
  assert_true(got == expected);
  btf_model_release(periodic);
  btf_model_release(clamped);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void hostile_queries_and_samples_give_finite_values(void **state) {
  (void)state;
  static const float hostile[] = {NAN, INFINITY, -INFINITY, 0.0f, -1.0f, 1e38f, -1e38f, 3e-39f, 0.5f};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 5, 6, 7, 9, 2, 3);
  uint64_t random = 5;
  uint16_t *samples = (uint16_t *)(void *)cube.image_major;
  tame(&cube, 4);
  btf_model *model = cube_model(ctx, &cube, BTF_ORDER_VLYXC, TEST_RESIDENT, BTF_WRAP_PERIODIC);
  /* Data that is damaged once the model has been made. */
  for (size_t i = 0; i < cube.count; i += 3) samples[i] = test_random(&random) % 2 ? 0x7c00u : 0xfe01u;
  const long allocations = memory.total_allocations;
  for (int i = 0; i < 200000; ++i) {
    union {
      btf_query query;
      float numbers[9];
    } q;
    float got[3] = {0.0f, 0.0f, 12.0f};
    q.query = random_query(&random, 8.0f);
    for (uint32_t n = test_random(&random) % 4; n > 0; --n)
      q.numbers[test_random(&random) % 9] = hostile[test_random(&random) % 9];
    q.query.flags = test_random(&random) % 2;
    model->vtbl->eval(model->state, &q.query, got);
    if (!isfinite(got[0]) || !isfinite(got[1]) || got[2] != 12.0f)
      fail_msg("query %d gives %g %g", i, (double)got[0], (double)got[1]);
  }
  assert_int_equal(memory.total_allocations, allocations);
  float texel[2];
  btf_model_texel(model, 0, 0, 0, 0, 0, texel);
  assert_true(texel[0] == 0.0f && texel[1] == test_cube_value(&cube, 0, 0, 0, 0, 1));
  btf_model_release(model);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

/* ---- samples that are not finite ---- */

static void expect_place(const btf_dataset *ds, const char *place) {
  btf_model *model;
  assert_status(btf_model_from_dataset(ds, NULL, &model), BTF_E_CORRUPT);
  assert_null(model);
  assert_message_has(place);
  assert_message_has("is not finite");
}

static void samples_not_finite_are_refused(void **state) {
  (void)state;
  static const uint16_t bad_half[] = {0x7c00u, 0xfc00u, 0x7e00u, 0xfc01u},
                        good_half[] = {0x7bffu, 0xfbffu, 1u, 0x8000u};
  static const uint32_t bad_float[] = {0x7f800000u, 0xff800000u, 0x7fc00000u, 0xff800001u},
                        good_float[] = {0x7f7fffffu, 0xff7fffffu, 1u, 0x80000000u};
  for (uint32_t threads = 1; threads <= 3; threads += 2)
    for (int wide = 0; wide < 2; ++wide)
      for (int order = 0; order < 2; ++order)
        for (int source = TEST_RESIDENT; source <= TEST_MAPPED; source += TEST_MAPPED - TEST_RESIDENT) {
          test_memory memory;
          btf_context *ctx = test_context_with(&memory, NULL, threads);
          test_cube cube;
          test_cube_make(ctx, &cube, wide ? BTF_SAMPLE_F32 : BTF_SAMPLE_F16, 5, 6, 7, 9, 3, 3);
          tame(&cube, 8);
          const btf_strides s = test_cube_strides(&cube, orders[order], (ptrdiff_t)cube.size);
          unsigned char *samples = orders[order] == BTF_ORDER_VLYXC ? cube.image_major : cube.texel_major;
          unsigned char *sample = samples + 4 * s.view + 2 * s.light + 5 * s.y + 3 * s.x + s.channel;
          for (int k = 0; k < 8; ++k) {
            const void *value = wide ? (k < 4 ? &bad_float[k] : &good_float[k - 4])
                                     : (const void *)(k < 4 ? &bad_half[k] : &good_half[k - 4]);
            memcpy(sample, value, cube.size);
            btf_dataset *ds = test_cube_dataset(ctx, &cube, orders[order], source, test_path("raw.btfd"));
            btf_model *model = NULL;
            if (k < 4)
              expect_place(ds, "view 4, light 2, row 5, column 3, channel 1");
            else
              assert_ok(btf_model_from_dataset(ds, NULL, &model));
            btf_model_release(model);
            btf_dataset_release(ds);
          }
          test_cube_free(&cube);
          test_context_done(ctx, &memory);
        }
}

/* Many pieces, strides of every sign, and the same place whatever the number of threads. */
static void the_first_place_is_named(void **state) {
  (void)state;
  enum { views = 6, lights = 5, height = 64, width = 512, count = views * lights * height * width };
  float *data = malloc(count * sizeof *data);
  assert_non_null(data);
  for (uint32_t threads = 1; threads <= 4; threads += 3)
    for (int turned = 0; turned < 2; ++turned) {
      test_memory memory;
      btf_context *ctx = test_context_with(&memory, NULL, threads);
      btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
      btf_dataset *ds;
      btf_model *model;
      const ptrdiff_t f = (ptrdiff_t)sizeof(float), image = f * height * width;
      desc.views = test_spiral(ctx, views, 0.0);
      desc.lights = test_spiral(ctx, lights, 0.5);
      desc.width = width;
      desc.height = height;
      desc.channels = 1;
      desc.data = data;
      if (turned) { /* the last row first */
        desc.data = data + (size_t)(height - 1) * width;
        desc.strides = (btf_strides){image * lights, image, -f * width, f, f};
      }
      for (size_t i = 0; i < count; ++i) data[i] = 0.5f;
      assert_ok(btf_dataset_create(ctx, &desc, &ds));
      assert_ok(btf_model_from_dataset(ds, NULL, &model));
      btf_model_release(model);
      data[count - 1] = NAN;
      expect_place(ds, turned ? "view 5, light 4, row 0, column 511, channel 0"
                              : "view 5, light 4, row 63, column 511, channel 0");
      data[((3 * lights + 2) * height + 7) * width + 100] = INFINITY;
      expect_place(ds, turned ? "view 3, light 2, row 56, column 100, channel 0"
                              : "view 3, light 2, row 7, column 100, channel 0");
      data[0] = -INFINITY;
      expect_place(ds, turned ? "view 0, light 0, row 63, column 0, channel 0"
                              : "view 0, light 0, row 0, column 0, channel 0");
      btf_dataset_release(ds);
      btf_dirset_release((btf_dirset *)(uintptr_t)desc.views);
      btf_dirset_release((btf_dirset *)(uintptr_t)desc.lights);
      test_context_done(ctx, &memory);
    }
  free(data);
}

/* ---- sources that are read into memory ---- */

static int32_t cancel_later(void *user, double fraction, const char *stage) {
  (void)stage;
  return ++*(int *)user > 1 || fraction >= 1.0;
}

static void streamed_sources_are_read_whole(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 5, 6, 7, 9, 3, 3);
  btf_dataset *ds = test_cube_dataset(ctx, &cube, BTF_ORDER_VLYXC, TEST_CALLBACK, NULL);
  btf_model *model = NULL;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  assert_ok(btf_model_from_dataset(ds, NULL, &model));
  assert_ok(btf_model_describe(model, &info));
  assert_int_equal(info.resident_bytes, cube.count * 2);
  btf_model_release(model);

  int reports = 0;
  btf_job job = BTF_JOB_INIT;
  job.progress = cancel_later;
  job.user = &reports;
  assert_status(btf_model_from_dataset(ds, &job, &model), BTF_E_CANCELLED);
  assert_null(model);

  for (long fail_at = 1;; ++fail_at) {
    const long live = memory.live_blocks;
    memory.fail_at = memory.total_allocations + fail_at;
    const btf_status status = btf_model_from_dataset(ds, NULL, &model);
    const int failed = memory.total_allocations >= memory.fail_at;
    memory.fail_at = 0;
    btf_model_release(model);
    assert_int_equal(memory.live_blocks, live);
    if (!failed) {
      assert_ok(status);
      assert_true(fail_at > 3);
      break;
    }
    assert_int_equal(status, BTF_E_NOMEM);
  }
  const uint16_t infinite = 0x7c00u;
  memcpy(cube.image_major + 2 * 500, &infinite, 2);
  assert_status(btf_model_from_dataset(ds, NULL, &model), BTF_E_CORRUPT);
  assert_message_has("is not finite");
  btf_dataset_release(ds);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static btf_status read_resident(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  const btf_dataset_desc *d = user;
  for (uint32_t v = 0; v < b->views; ++v)
    for (uint32_t l = 0; l < b->lights; ++l)
      for (uint32_t y = 0; y < b->height; ++y)
        for (uint32_t x = 0; x < b->width; ++x)
          memcpy((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y +
                     (ptrdiff_t)x * s->x,
                 (const char *)d->data + (ptrdiff_t)(b->view0 + v) * d->strides.view +
                     (ptrdiff_t)(b->light0 + l) * d->strides.light + (ptrdiff_t)(b->y0 + y) * d->strides.y +
                     (ptrdiff_t)(b->x0 + x) * d->strides.x,
                 sizeof(float));
  return BTF_OK;
}

/* With lights of its own for each view, a model in place, one in memory and the block reader agree. */
static void lights_of_each_view_are_evaluated(void **state) {
  (void)state;
  enum { views = 4, own = 9, lights = 7, w = 3, h = 2 };
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  static float data[views * own * w * h];
  btf_dirset *sets[views];
  uint64_t random = 3;
  for (size_t i = 0; i < views * own * w * h; ++i) data[i] = test_uniform(&random);
  for (uint32_t v = 0; v < views; ++v) sets[v] = test_spiral(ctx, own - v, v);
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  desc.views = test_spiral(ctx, views, 0.0);
  desc.lights = test_spiral(ctx, lights, 0.5);
  desc.width = w;
  desc.height = h;
  desc.channels = 1;
  desc.view_lights = (const btf_dirset *const *)sets;
  desc.data = data;
  desc.strides = (btf_strides){4 * own * w * h, 4 * w * h, 4 * w, 4, 4};
  btf_dataset_desc streamed = desc;
  streamed.data = NULL;
  streamed.read = read_resident;
  streamed.user = &desc;
  btf_dataset *ds[2];
  btf_model *model[2];
  assert_ok(btf_dataset_create(ctx, &desc, &ds[0]));
  assert_ok(btf_dataset_create(ctx, &streamed, &ds[1]));
  for (int k = 0; k < 2; ++k) assert_ok(btf_model_from_dataset(ds[k], NULL, &model[k]));
  for (uint32_t v = 0; v < views; ++v)
    for (uint32_t l = 0; l < lights; ++l)
      for (uint32_t i = 0; i < w * h; ++i) {
        const btf_block b = {v, 1, l, 1, i % w, i / w, 1, 1};
        const btf_strides s = {4, 4, 4, 4, 4};
        float read, in_place, in_memory;
        assert_ok(btf_dataset_read(ds[0], &b, &read, &s));
        btf_model_texel(model[0], 0, i % w, i / w, l, v, &in_place);
        btf_model_texel(model[1], 0, i % w, i / w, l, v, &in_memory);
        assert_true(in_memory == read);
        assert_near(in_place, read,
                    1.8e-7); /* three products and sums in float against double, values below 1 */
      }
  for (int i = 0; i < 500; ++i) {
    const btf_query q = random_query(&random, 3.0f);
    float got[2];
    for (int k = 0; k < 2; ++k) btf_model_eval(model[k], &q, &got[k]);
    assert_near(got[0], got[1], 2.5e-7); /* the same, and one rounding more */
  }
  float *last = &data[(views - 1) * own * w * h];
  last[(own - views) * w * h + 1] = NAN; /* the last view's last light */
  expect_place(ds[0], "view 3, light 5, row 0, column 1, channel 0");
  for (int k = 0; k < 2; ++k) {
    btf_model_release(model[k]);
    btf_dataset_release(ds[k]);
  }
  for (int v = 0; v < views; ++v) btf_dirset_release(sets[v]);
  btf_dirset_release((btf_dirset *)(uintptr_t)desc.views);
  btf_dirset_release((btf_dirset *)(uintptr_t)desc.lights);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_query_is_the_weighted_sum_of_samples),
      cmocka_unit_test(samples_are_met_exactly),
      cmocka_unit_test(functions_linear_in_parabolic_coordinates_are_reproduced),
      cmocka_unit_test(coarser_levels_are_means_of_finer_ones),
      cmocka_unit_test(textures_repeat_or_end),
      cmocka_unit_test(hostile_queries_and_samples_give_finite_values),
      cmocka_unit_test(samples_not_finite_are_refused),
      cmocka_unit_test(the_first_place_is_named),
      cmocka_unit_test(streamed_sources_are_read_whole),
      cmocka_unit_test(lights_of_each_view_are_evaluated),
  };
  return btf_run("raw", tests);
}
