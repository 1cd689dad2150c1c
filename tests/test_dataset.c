/* SPDX-License-Identifier: MIT */
/* The block reader against an index formula: every sample type, order, source, stride and instruction set. */
#include "dataset_cube.h"

#include <pthread.h>

#include "dataset/convert.h"
#include "dataset/dataset.h"
#include <btf/btf_half.h>
#include <btf/btf_plugin.h>

static const uint32_t sample_types[] = {BTF_SAMPLE_U8, BTF_SAMPLE_F16, BTF_SAMPLE_F32, BTF_SAMPLE_U16};
static const uint32_t orders[] = {BTF_ORDER_VLYXC, BTF_ORDER_YXVLC};
static const char *const isas[] = {"scalar", "avx2", "avx512"};

/* ---- blocks ---- */

static btf_block random_block(const test_cube *cube, uint64_t *random) {
  const uint32_t size[4] = {cube->views, cube->lights, cube->width, cube->height};
  uint32_t first[4], count[4];
  for (int k = 0; k < 4; ++k) {
    first[k] = test_random(random) % size[k];
    count[k] = 1 + test_random(random) % (size[k] - first[k]);
    if (test_random(random) % 3 == 0) {
      first[k] = 0;
      count[k] = size[k];
    }
  }
  const btf_block b = {first[0], count[0], first[1], count[1], first[2], first[3], count[2], count[3]};
  return b;
}

/* Strides in a random order of the axes, with gaps and signs; *origin is where the first sample goes, of
 * *size floats. */
static btf_strides random_strides(const test_cube *cube, const btf_block *b, uint64_t *random, size_t *origin,
                                  size_t *size) {
  const uint32_t count[5] = {b->views, b->lights, b->height, b->width, cube->channels};
  ptrdiff_t stride[5], next = 1, start = 0;
  int axis[5] = {0, 1, 2, 3, 4};
  for (int k = 4; k > 0; --k) {
    const int other = (int)(test_random(random) % (uint32_t)(k + 1)), swapped = axis[k];
    axis[k] = axis[other];
    axis[other] = swapped;
  }
  for (int k = 0; k < 5; ++k) {
    stride[axis[k]] = next;
    next = next * (ptrdiff_t)count[axis[k]] +
           (ptrdiff_t)(test_random(random) % 4 == 0 ? test_random(random) % 5 : 0);
    if (test_random(random) % 4 == 0) {
      start += stride[axis[k]] * (ptrdiff_t)(count[axis[k]] - 1);
      stride[axis[k]] = -stride[axis[k]];
    }
  }
  *origin = (size_t)start;
  *size = (size_t)next;
  const btf_strides s = {4 * stride[0], 4 * stride[1], 4 * stride[2], 4 * stride[3], 4 * stride[4]};
  return s;
}

static const float untouched = -12345.678f;

static void expect_block(const test_cube *cube, const btf_dataset *ds, const btf_block *b,
                         const btf_strides *s, size_t origin, size_t size) {
  float *dst = malloc(size * sizeof *dst);
  size_t written = 0;
  for (size_t i = 0; i < size; ++i) dst[i] = untouched;
  assert_ok(btf_dataset_read(ds, b, dst + origin, s));
  for (uint32_t v = 0; v < b->views; ++v)
    for (uint32_t l = 0; l < b->lights; ++l)
      for (uint32_t y = 0; y < b->height; ++y)
        for (uint32_t x = 0; x < b->width; ++x)
          for (uint32_t c = 0; c < cube->channels; ++c) {
            float *got = dst + (ptrdiff_t)origin +
                         ((ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y +
                          (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel) /
                             4;
            const float expected =
                test_cube_value(cube, b->view0 + v, b->light0 + l, b->y0 + y, b->x0 + x, c);
            if (memcmp(got, &expected, sizeof expected) != 0)
              fail_msg("type %u at %u %u %u %u %u: %.9g instead of %.9g", cube->type, v, l, y, x, c,
                       (double)*got, (double)expected);
            *got = untouched;
            ++written;
          }
  for (size_t i = 0; i < size; ++i)
    if (dst[i] != untouched) fail_msg("float %zu outside of the block was written", i);
  assert_true(written > 0);
  free(dst);
}

static void check_source(btf_context *ctx, const test_cube *cube, uint32_t order, int source, int trials) {
  btf_dataset *ds = test_cube_dataset(ctx, cube, order, source, test_path("cube.btfd"));
  uint64_t random = 7u * order + (uint64_t)source;
  for (int i = 0; i < trials; ++i) {
    const btf_block b = random_block(cube, &random);
    size_t origin, size;
    const btf_strides s = random_strides(cube, &b, &random, &origin, &size);
    expect_block(cube, ds, &b, &s, origin, size);
  }
  btf_dataset_release(ds);
}

static void every_source_reads_what_the_formula_says(void **state) {
  (void)state;
  static const uint32_t channels[] = {1, 2, 3, 4, 5, 8, 31, 64};
  for (size_t i = 0; i < sizeof isas / sizeof isas[0]; ++i) {
    test_memory memory;
    btf_context *ctx = test_context_with(&memory, isas[i], 2);
    for (size_t t = 0; t < 4; ++t)
      for (size_t c = 0; c < sizeof channels / sizeof channels[0]; ++c) {
        test_cube cube;
        test_cube_make(ctx, &cube, sample_types[t], 4, 6, 7, 19, channels[c], t + 10 * c);
        for (int order = 0; order < 2; ++order)
          for (int source = 0; source < TEST_SOURCES; ++source)
            check_source(ctx, &cube, orders[order], source, 3);
        test_cube_free(&cube);
      }
    test_context_done(ctx, &memory);
  }
}

/* Large enough that blocks are divided among threads and cut into several tiles along every axis. */
static void large_blocks_are_read_by_several_threads(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 4);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 9, 33, 17, 70, 3, 5);
  static const int axes_of_order[][5] = {
      {4, 3, 2, 1, 0}, {4, 1, 0, 3, 2}, {3, 2, 4, 1, 0}, {1, 0, 4, 3, 2}, {1, 4, 0, 2, 3}};
  for (int source = 0; source < TEST_SOURCES; ++source)
    for (int order = 0; order < 2; ++order) {
      btf_dataset *ds = test_cube_dataset(ctx, &cube, orders[order], source, test_path("large.btfd"));
      for (size_t k = 0; k < sizeof axes_of_order / sizeof axes_of_order[0]; ++k) {
        const btf_block all = {0, cube.views, 0, cube.lights, 0, 0, cube.width, cube.height};
        const uint32_t count[5] = {cube.views, cube.lights, cube.height, cube.width, cube.channels};
        ptrdiff_t stride[5], next = 4;
        for (int i = 0; i < 5; ++i) {
          stride[axes_of_order[k][i]] = next;
          next *= (ptrdiff_t)count[axes_of_order[k][i]];
        }
        const btf_strides s = {stride[0], stride[1], stride[2], stride[3], stride[4]};
        expect_block(&cube, ds, &all, &s, 0, (size_t)next / 4);
      }
      btf_dataset_release(ds);
    }
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void abrdfs_are_read_by_texel(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_U16, 5, 4, 3, 6, 2, 3);
  btf_dataset *ds = test_cube_dataset(ctx, &cube, BTF_ORDER_VLYXC, TEST_RESIDENT, NULL);
  float got[2 * 5 * 4 * 2];
  assert_ok(btf_dataset_read_abrdf(ds, 3, 2, 2, got));
  size_t i = 0;
  for (uint32_t x = 3; x < 5; ++x)
    for (uint32_t v = 0; v < 5; ++v)
      for (uint32_t l = 0; l < 4; ++l)
        for (uint32_t c = 0; c < 2; ++c) assert_true(got[i++] == test_cube_value(&cube, v, l, 2, x, c));
  assert_status(btf_dataset_read_abrdf(ds, 5, 2, 2, got), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_read_abrdf(NULL, 0, 0, 1, got), BTF_E_INVALID_ARG);
  btf_dataset_release(ds);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void resident_samples_may_lie_at_any_stride(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F32, 3, 5, 6, 7, 3, 9);
  /* Planar, rows from the top, four bytes off alignment, and all views the same image. */
  const size_t plane = 6 * 7, image = 3 * plane;
  unsigned char *data = malloc(5 * image * 4 + 2);
  for (uint32_t l = 0; l < 5; ++l)
    for (uint32_t y = 0; y < 6; ++y)
      for (uint32_t x = 0; x < 7; ++x)
        for (uint32_t c = 0; c < 3; ++c) {
          const float value = test_cube_value(&cube, 0, l, y, x, c);
          memcpy(data + 2 + 4 * (l * image + c * plane + (5 - y) * 7 + x), &value, 4);
        }
  btf_dataset_desc desc = test_cube_desc(&cube);
  desc.data = data + 2 + 4 * 5 * 7;
  desc.strides = (btf_strides){0, (ptrdiff_t)(4 * image), -4 * 7, 4, (ptrdiff_t)(4 * plane)};
  btf_dataset *ds;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  float *got = malloc(cube.count * sizeof *got);
  const btf_block all = {0, 3, 0, 5, 0, 0, 7, 6};
  const btf_strides dense = test_cube_strides(&cube, BTF_ORDER_VLYXC, 4);
  assert_ok(btf_dataset_read(ds, &all, got, &dense));
  const float *next = got;
  for (uint32_t v = 0; v < 3; ++v)
    for (uint32_t l = 0; l < 5; ++l)
      for (uint32_t y = 0; y < 6; ++y)
        for (uint32_t x = 0; x < 7; ++x)
          for (uint32_t c = 0; c < 3; ++c) assert_true(*next++ == test_cube_value(&cube, 0, l, y, x, c));
  free(got);
  free(data);
  btf_dataset_release(ds);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

/* ---- conversion ---- */

/* All 65536 samples of two bytes, and floats of every exponent, at lengths around the width of a vector. */
static void instruction_sets_agree_bit_for_bit(void **state) {
  (void)state;
  enum { most = 65536 };
  static unsigned char samples[most * 4];
  static float expected[most], got[most];
  for (size_t t = 0; t < 4; ++t) {
    const uint32_t type = sample_types[t];
    const uint32_t size = btfi_sample_size(type);
    for (uint32_t i = 0; i < most; ++i) {
      const uint32_t bits = type == BTF_SAMPLE_F32 ? i * 65537u : i;
      memcpy(samples + (size_t)i * size, &bits, size);
    }
    const btfi_convert_kernels scalar = btfi_convert_select(type, BTF_ISA_SCALAR);
    scalar.unpack(samples, expected, most);
    for (uint32_t isa = BTF_ISA_AVX2; isa <= BTF_ISA_AVX512 && isa <= btfi_isa_of_machine(); ++isa) {
      const btfi_convert_kernels vector = btfi_convert_select(type, isa);
      for (size_t first = 0; first < most;) {
        const size_t n = BTFI_MIN(1 + first % 71, most - first);
        for (size_t i = 0; i < n + 1 && first + i < most; ++i) got[first + i] = untouched;
        const bool finite = vector.unpack(samples + first * size, got + first, n);
        bool all = true;
        for (size_t i = first; i < first + n; ++i) {
          all = all && isfinite(expected[i]);
          if (isfinite(expected[i])) assert_memory_equal(&got[i], &expected[i], sizeof got[i]);
        }
        assert_int_equal(finite, all);
        assert_int_equal(scalar.unpack(samples + first * size, got, n), all);
        if (first + n < most && first > 0) got[first + n] = untouched;
        first += n;
      }
    }
    for (uint32_t i = 0; i < most; ++i)
      if (isfinite(expected[i]))
        assert_true(btfi_sample_to_float(type, samples + (size_t)i * size) == expected[i]);
  }
}

static void packing_rounds_to_nearest_everywhere(void **state) {
  (void)state;
  enum { n = 4096 };
  static float values[n], back[n];
  static unsigned char scalar_bytes[4 * n], vector_bytes[4 * n];
  uint64_t random = 4;
  for (size_t i = 0; i < n; ++i)
    values[i] = ldexpf(test_uniform(&random) * 2.0f - 1.0f, (int)(test_random(&random) % 40) - 24);
  for (size_t t = 0; t < 4; ++t) {
    const uint32_t type = sample_types[t], size = btfi_sample_size(type);
    const btfi_convert_kernels scalar = btfi_convert_select(type, BTF_ISA_SCALAR);
    assert_true(scalar.pack(values, scalar_bytes, n));
    assert_true(scalar.unpack(scalar_bytes, back, n));
    for (size_t i = 0; i < n; ++i) {
      const double clamped = values[i] < 0.0f ? 0.0 : values[i] > 1.0f ? 1.0 : (double)values[i];
      /* Half a step of the type, which for halves is 2^-11 of the number or 2^-25. */
      if (type == BTF_SAMPLE_U8) assert_near(back[i], clamped, 0.5 / 255.0 + 1e-7);
      if (type == BTF_SAMPLE_U16) assert_near(back[i], clamped, 0.5 / 65535.0 + 1e-7);
      if (type == BTF_SAMPLE_F16)
        assert_near(back[i], values[i], fabs((double)values[i]) / 2048.0 + ldexp(1.0, -25));
      if (type == BTF_SAMPLE_F32) assert_true(back[i] == values[i]);
    }
    for (uint32_t isa = BTF_ISA_AVX2; isa <= BTF_ISA_AVX512 && isa <= btfi_isa_of_machine(); ++isa) {
      const btfi_convert_kernels vector = btfi_convert_select(type, isa);
      for (size_t length = n - 40; length <= n; ++length) {
        memset(vector_bytes, 0, sizeof vector_bytes);
        assert_true(vector.pack(values, vector_bytes, length));
        assert_memory_equal(vector_bytes, scalar_bytes, length * size);
      }
      for (size_t place = 0; place < 40; ++place) {
        static const float bad[] = {NAN, INFINITY, -INFINITY};
        const float kept = values[place];
        for (int k = 0; k < 3; ++k) {
          values[place] = bad[k];
          assert_false(vector.pack(values, vector_bytes, 40));
          assert_false(scalar.pack(values, vector_bytes, 40));
        }
        values[place] = 65520.0f;
        assert_int_equal(vector.pack(values, vector_bytes, 40), type != BTF_SAMPLE_F16);
        values[place] = 65519.99f;
        assert_true(vector.pack(values, vector_bytes, 40));
        values[place] = kept;
      }
    }
  }
}

/* Every value an integer type can hold comes back as itself. */
static void integers_survive_the_way_through_floats(void **state) {
  (void)state;
  for (uint32_t i = 0; i < 65536; ++i) {
    const uint16_t two = (uint16_t)i;
    const uint8_t one = (uint8_t)i;
    uint16_t two_back = 0;
    uint8_t one_back = 0;
    const float fraction16 = btfi_sample_to_float(BTF_SAMPLE_U16, &two),
                fraction8 = btfi_sample_to_float(BTF_SAMPLE_U8, &one);
    assert_true(btfi_convert_select(BTF_SAMPLE_U16, 0).pack(&fraction16, &two_back, 1));
    assert_true(btfi_convert_select(BTF_SAMPLE_U8, 0).pack(&fraction8, &one_back, 1));
    assert_int_equal(two_back, two);
    assert_int_equal(one_back, one);
  }
}

/* ---- what is refused ---- */

static void samples_that_are_not_finite_are_named(void **state) {
  (void)state;
  for (size_t i = 0; i < sizeof isas / sizeof isas[0]; ++i) {
    test_memory memory;
    btf_context *ctx = test_context_with(&memory, isas[i], 2);
    for (int f32 = 0; f32 < 2; ++f32) {
      test_cube cube;
      test_cube_make(ctx, &cube, f32 ? BTF_SAMPLE_F32 : BTF_SAMPLE_F16, 4, 8, 9, 40, 3, 1);
      const size_t image = ((((size_t)3 * 8 + 7) * 9 + 2) * 40 + 9) * 3 + 1;
      const size_t texel = ((((size_t)2 * 40 + 9) * 4 + 3) * 8 + 7) * 3 + 1;
      const float infinity = -INFINITY;
      const uint16_t nan_half = 0x7e00u;
      memcpy(cube.image_major + image * cube.size, f32 ? (const void *)&infinity : (const void *)&nan_half,
             cube.size);
      memcpy(cube.texel_major + texel * cube.size, f32 ? (const void *)&infinity : (const void *)&nan_half,
             cube.size);
      const btf_block all = {0, 4, 0, 8, 0, 0, 40, 9}, clean = {0, 3, 0, 8, 0, 0, 40, 9},
                      from = {2, 2, 6, 2, 5, 1, 20, 8};
      float *dst = malloc(cube.count * sizeof *dst);
      const btf_strides dense = test_cube_strides(&cube, BTF_ORDER_VLYXC, 4),
                        planar = {4 * 8 * 9 * 40 * 3, 4 * 9 * 40 * 3, 4 * 40, 4, 4 * 9 * 40};
      for (int order = 0; order < 2; ++order)
        for (int source = 0; source < TEST_SOURCES; ++source) {
          btf_dataset *ds = test_cube_dataset(ctx, &cube, orders[order], source, test_path("bad.btfd"));
          for (int k = 0; k < 2; ++k) {
            assert_status(btf_dataset_read(ds, &all, dst, k ? &planar : &dense), BTF_E_CORRUPT);
            assert_message_has(source == TEST_MAPPED ? "bad.btfd: sample at" : "data set: sample at");
            assert_message_has("sample at view 3, light 7, row 2, column 9, channel 1 is not finite");
            assert_status(btf_dataset_read(ds, &from, dst, k ? &planar : &dense), BTF_E_CORRUPT);
            assert_message_has("view 3, light 7, row 2, column 9, channel 1");
            assert_ok(btf_dataset_read(ds, &clean, dst, k ? &planar : &dense));
          }
          btf_dataset_release(ds);
        }
      free(dst);
      test_cube_free(&cube);
    }
    test_context_done(ctx, &memory);
  }
}

static void blocks_and_strides_are_checked(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_U8, 2, 3, 4, 5, 1, 1);
  btf_dataset *ds = test_cube_dataset(ctx, &cube, BTF_ORDER_VLYXC, TEST_RESIDENT, NULL);
  const btf_strides dense = test_cube_strides(&cube, BTF_ORDER_VLYXC, 4);
  const btf_block fine = {0, 2, 0, 3, 0, 0, 5, 4};
  float dst[120];
  static const struct {
    btf_block block;
    const char *message;
  } outside[] = {{{1, 2, 0, 3, 0, 0, 5, 4}, "views 1 to 2; expected 0 to 1"},
                 {{0, 2, 4294967295u, 2, 0, 0, 5, 4}, "lights 4294967295 to 4294967296; expected 0 to 2"},
                 {{0, 2, 0, 3, 1, 0, 5, 4}, "columns 1 to 5; expected 0 to 4"},
                 {{0, 2, 0, 3, 0, 1, 5, 4}, "rows 1 to 4; expected 0 to 3"},
                 {{0, 2, 0, 3, 0, 0, 4294967295u, 4}, "columns"}};
  for (size_t i = 0; i < sizeof outside / sizeof outside[0]; ++i) {
    assert_status(btf_dataset_read(ds, &outside[i].block, dst, &dense), BTF_E_INVALID_ARG);
    assert_message_has(outside[i].message);
  }
  btf_strides odd = dense, zero = dense;
  odd.light = 6;
  zero.y = 0;
  assert_status(btf_dataset_read(ds, &fine, dst, &odd), BTF_E_INVALID_ARG);
  assert_message_has("stride of 6 bytes between lights; expected a multiple of 4 other than 0");
  assert_status(btf_dataset_read(ds, &fine, dst, &zero), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_read(ds, &fine, NULL, &dense), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_read(ds, NULL, dst, &dense), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_read(ds, &fine, dst, NULL), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_read(NULL, &fine, dst, &dense), BTF_E_INVALID_ARG);
  const btf_block empty = {2, 0, 0, 3, 0, 0, 5, 4};
  dst[0] = untouched;
  assert_ok(btf_dataset_read(ds, &empty, dst, &dense));
  assert_true(dst[0] == untouched);
  btf_dataset_release(ds);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static int releases;
static void count_release(void *user) {
  (void)user;
  ++releases;
}

static void descriptions_are_checked(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_U8, 2, 3, 4, 5, 3, 1);
  btf_dataset_desc good = test_cube_desc(&cube);
  good.data = cube.image_major;
  good.release = count_release;
  static const char *const unnamed[3] = {"R", NULL, "B"};
  releases = 0;
  for (int k = 0; k < 17; ++k) {
    btf_dataset_desc d = good;
    btf_status expected = BTF_E_INVALID_ARG;
    switch (k) {
    case 0:
      d.lights = NULL;
      break;
    case 1:
      d.views = NULL;
      break;
    case 2:
      d.width = 0;
      break;
    case 3:
      d.height = 0;
      break;
    case 4:
      d.channels = 0;
      break;
    case 5:
      d.channels = 65, expected = BTF_E_LIMIT;
      break;
    case 6:
      d.width = 65537, expected = BTF_E_LIMIT;
      break;
    case 7:
      d.sample_type = 0;
      break;
    case 8:
      d.sample_type = 5;
      break;
    case 9:
      d.quantity = 3;
      break;
    case 10:
      d.scale = 2;
      break;
    case 11:
      d.wrap = 2;
      break;
    case 12:
      d.flags = 4;
      break;
    case 13:
      d.data = NULL;
      break;
    case 14:
      d.strides.light = PTRDIFF_MAX;
      break;
    case 15:
      d.texels_per_mm = NAN;
      break;
    default:
      d.channel_names = unnamed;
      break;
    }
    btf_dataset *ds = (btf_dataset *)&d;
    assert_status(btf_dataset_create(ctx, &d, &ds), expected);
    assert_null(ds);
    assert_int_equal(releases, k + 1);
  }
  btf_dataset *ds;
  btf_dataset_desc unknown_size = good;
  unknown_size.struct_size = 3;
  assert_status(btf_dataset_create(ctx, &unknown_size, &ds), BTF_E_ABI);
  assert_status(btf_dataset_create(ctx, NULL, &ds), BTF_E_INVALID_ARG);
  assert_int_equal(releases, 17); /* what cannot be read stays the caller's */
  assert_status(btf_dataset_create(NULL, &good, &ds), BTF_E_INVALID_ARG);
  assert_int_equal(releases, 18);
  assert_status(btf_dataset_create(ctx, &good, NULL), BTF_E_INVALID_ARG);
  assert_int_equal(releases, 19);
  assert_status(btf_dataset_create(NULL, &unknown_size, &ds), BTF_E_INVALID_ARG);
  assert_int_equal(releases, 19);
  assert_ok(btf_dataset_create(ctx, &good, &ds));
  assert_int_equal(releases, 19);
  assert_ptr_equal(btf_dataset_retain(ds), ds);
  btf_dataset_release(ds);
  assert_int_equal(releases, 19);
  btf_dataset_release(ds);
  assert_int_equal(releases, 20);
  btf_dataset_release(NULL);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void descriptions_come_back_complete(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_U8, 2, 3, 4, 5, 3, 1);
  btf_dataset_desc desc = test_cube_desc(&cube), got = BTF_DATASET_DESC_INIT;
  desc.data = cube.image_major;
  desc.name = "wool";
  desc.wrap = BTF_WRAP_CLAMP;
  btf_dataset *ds;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  assert_ok(btf_dataset_describe(ds, &got));
  assert_string_equal(got.channel_names[0], "R");
  assert_string_equal(got.channel_names[2], "B");
  assert_string_equal(got.color_space, "lin_rec709");
  assert_string_equal(got.name, "wool");
  assert_null(got.source);
  assert_ptr_equal(got.data, cube.image_major);
  const btf_strides dense = test_cube_strides(&cube, BTF_ORDER_VLYXC, 1);
  assert_memory_equal(&got.strides, &dense, sizeof dense);
  assert_int_equal(got.flags, BTF_DATASET_CONCURRENT_READ | BTF_DATASET_IMAGE_MAJOR);
  assert_int_equal(got.wrap, BTF_WRAP_CLAMP);
  btf_dataset_release(ds);
  static const char *const names[] = {"X", "Y", "Z"};
  desc.channel_names = names;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  assert_ok(btf_dataset_describe(ds, &got));
  assert_string_equal(got.channel_names[1], "Y");
  assert_string_equal(got.color_space, "");
  btf_dataset_release(ds);
  desc.channel_names = NULL;
  desc.channels = 2;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  assert_ok(btf_dataset_describe(ds, &got));
  assert_string_equal(got.channel_names[1], "C1");
  btf_dataset_release(ds);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

/* ---- sources ---- */

typedef struct watched_source {
  const test_cube *cube;
  atomic_int inside, most_inside, calls;
  atomic_size_t most_bytes;
  btf_status status;
  int say_why;
} watched_source;

static btf_status watched_read(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  watched_source *source = user;
  const int inside = atomic_fetch_add(&source->inside, 1) + 1;
  if (inside > atomic_load(&source->most_inside)) atomic_store(&source->most_inside, inside);
  atomic_fetch_add(&source->calls, 1);
  const size_t bytes =
      (size_t)b->views * b->lights * b->width * b->height * source->cube->channels * source->cube->size;
  if (bytes > atomic_load(&source->most_bytes)) atomic_store(&source->most_bytes, bytes);
  for (size_t i = 0; i<bytes; i += bytes> 4096 ? 4096 : 1) ((unsigned char *)dst)[i] = 1;
  (void)s;
  memset(dst, 1, bytes); /* dense, as the reader asks for it */
  atomic_fetch_sub(&source->inside, 1);
  if (source->status != BTF_OK && source->say_why)
    return btf_source_error(source->status, "tape %d is torn", 7);
  return source->status;
}

static btf_dataset *watched_dataset(btf_context *ctx, const test_cube *cube, watched_source *source,
                                    uint32_t flags) {
  btf_dataset_desc desc = test_cube_desc(cube);
  btf_dataset *ds;
  desc.read = watched_read;
  desc.user = source;
  desc.flags = flags;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  return ds;
}

static void sources_are_read_in_bounded_pieces(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 3);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_U8, 2, 4, 1500, 1600, 1, 1);
  float *dst = malloc(cube.count * sizeof *dst);
  const btf_block all = {0, 2, 0, 4, 0, 0, 1600, 1500};
  const btf_strides dense = test_cube_strides(&cube, BTF_ORDER_VLYXC, 4);
  for (uint32_t flags = 0; flags < 4; ++flags) {
    watched_source source = {.cube = &cube};
    btf_dataset *ds = watched_dataset(ctx, &cube, &source, flags);
    assert_ok(btf_dataset_read(ds, &all, dst, &dense));
    for (size_t i = 0; i < cube.count; ++i)
      if (dst[i] != 1.0f / 255.0f) fail_msg("sample %zu is %g", i, (double)dst[i]);
    assert_true(atomic_load(&source.calls) >= 2);
    assert_true(atomic_load(&source.most_bytes) <= 16 << 20);
    if (!(flags & BTF_DATASET_CONCURRENT_READ)) assert_int_equal(atomic_load(&source.most_inside), 1);
    btf_dataset_release(ds);
  }
  free(dst);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void what_a_source_says_reaches_the_caller(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 3);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_U8, 2, 4, 1500, 1600, 1, 1);
  float *dst = malloc(cube.count * sizeof *dst);
  const btf_block all = {0, 2, 0, 4, 0, 0, 1600, 1500};
  const btf_strides dense = test_cube_strides(&cube, BTF_ORDER_VLYXC, 4);
  for (uint32_t flags = 0; flags < 4; ++flags)
    for (int say_why = 0; say_why < 2; ++say_why) {
      watched_source source = {.cube = &cube, .status = BTF_E_IO, .say_why = say_why};
      btf_dataset *ds = watched_dataset(ctx, &cube, &source, flags);
      assert_status(btf_dataset_read(ds, &all, dst, &dense), BTF_E_IO);
      assert_message_has(say_why ? "tape 7 is torn"
                                 : "data set: the source failed with BTF_E_IO on a block from view");
      btf_dataset_release(ds);
    }
  free(dst);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

typedef struct reading_thread {
  const btf_dataset *ds;
  const test_cube *cube;
  int wrong;
} reading_thread;

static void *read_by_images(void *user) {
  reading_thread *t = user;
  const test_cube *cube = t->cube;
  float dst[7 * 19 * 3];
  const btf_strides s = test_cube_strides(cube, BTF_ORDER_VLYXC, 4);
  for (uint32_t round = 0; round < 20; ++round)
    for (uint32_t v = 0; v < cube->views; ++v)
      for (uint32_t l = 0; l < cube->lights; ++l) {
        const btf_block b = {v, 1, l, 1, 0, 0, cube->width, cube->height};
        if (btf_dataset_read(t->ds, &b, dst, &s) != BTF_OK) t->wrong++;
        if (dst[17 * 3 + 1] != test_cube_value(cube, v, l, 0, 17, 1)) t->wrong++;
      }
  return NULL;
}

static void many_threads_read_one_data_set(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 4, 6, 7, 19, 3, 2);
  for (int source = 0; source < TEST_SOURCES; ++source) {
    btf_dataset *ds = test_cube_dataset(ctx, &cube, BTF_ORDER_YXVLC, source, test_path("threads.btfd"));
    reading_thread threads[4];
    pthread_t handle[4];
    for (int i = 0; i < 4; ++i) {
      threads[i] = (reading_thread){ds, &cube, 0};
      assert_int_equal(pthread_create(&handle[i], NULL, read_by_images, &threads[i]), 0);
    }
    for (int i = 0; i < 4; ++i) {
      pthread_join(handle[i], NULL);
      assert_int_equal(threads[i].wrong, 0);
    }
    btf_dataset_release(ds);
  }
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

/* ---- lights that differ between views ---- */

/* A function linear in the parabolic coordinates of the light, different for every texel, channel and view.
 */
static float linear_value(const float *light, uint32_t v, uint32_t y, uint32_t x, uint32_t c) {
  const double px = light[0] / (1.0 + light[2]), py = light[1] / (1.0 + light[2]);
  return (float)(1.0 + 0.1 * v + (0.3 + 0.01 * x) * px - (0.2 + 0.02 * y) * py + 0.5 * c);
}

typedef struct per_view {
  btf_dirset *lights, *views, *own[5];
} per_view;

static btf_status read_own(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  const per_view *sets = user;
  if (b->views != 1) return btf_source_error(BTF_E_STATE, "%u views at once", b->views);
  const btf_dirset *own = sets->own[b->view0];
  if (b->light0 + b->lights > btf_dirset_count(own))
    return btf_source_error(BTF_E_STATE, "light out of range");
  for (uint32_t l = 0; l < b->lights; ++l)
    for (uint32_t y = 0; y < b->height; ++y)
      for (uint32_t x = 0; x < b->width; ++x)
        for (uint32_t c = 0; c < 2; ++c) {
          const float value = linear_value(btf_dirset_directions(own) + 3 * (size_t)(b->light0 + l), b->view0,
                                           b->y0 + y, b->x0 + x, c);
          memcpy((char *)dst + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y + (ptrdiff_t)x * s->x +
                     (ptrdiff_t)c * s->channel,
                 &value, sizeof value);
        }
  return BTF_OK;
}

/* Lights of a small cap, inside the hull of every view's own lights, so that interpolation stays linear. */
static void make_per_view(btf_context *ctx, per_view *sets) {
  float xyz[3 * 9];
  for (int i = 0; i < 9; ++i) {
    const double r = 0.1 * i / 2.0, phi = 2.0 * i;
    xyz[3 * i] = (float)(sin(r) * cos(phi));
    xyz[3 * i + 1] = (float)(sin(r) * sin(phi));
    xyz[3 * i + 2] = (float)cos(r);
  }
  assert_ok(btf_dirset_create(ctx, xyz, 9, &sets->lights));
  sets->views = test_spiral(ctx, 5, 0.0);
  for (uint32_t v = 0; v < 5; ++v) sets->own[v] = test_spiral(ctx, 20 + 7 * v, v);
}

static void free_per_view(per_view *sets) {
  btf_dirset_release(sets->lights);
  btf_dirset_release(sets->views);
  for (int v = 0; v < 5; ++v) btf_dirset_release(sets->own[v]);
}

static btf_dataset_desc per_view_desc(const per_view *sets) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  desc.lights = sets->lights;
  desc.views = sets->views;
  desc.width = 6;
  desc.height = 5;
  desc.channels = 2;
  desc.view_lights = (const btf_dirset *const *)sets->own;
  return desc;
}

static void expect_linear(const btf_dataset *ds, const per_view *sets) {
  static const btf_block blocks[] = {
      {0, 5, 0, 9, 0, 0, 6, 5}, {2, 2, 3, 4, 1, 2, 3, 2}, {4, 1, 8, 1, 5, 4, 1, 1}};
  for (size_t k = 0; k < 3; ++k) {
    const btf_block b = blocks[k];
    float dst[5 * 9 * 6 * 5 * 2];
    const ptrdiff_t w = b.width, h = b.height, l9 = b.lights;
    const btf_strides planar = {4 * 2 * w * h * l9, 4 * 2 * w * h, 4 * w, 4, 4 * w * h};
    assert_ok(btf_dataset_read(ds, &b, dst, &planar));
    for (uint32_t v = 0; v < b.views; ++v)
      for (uint32_t l = 0; l < b.lights; ++l)
        for (uint32_t c = 0; c < 2; ++c)
          for (uint32_t y = 0; y < b.height; ++y)
            for (uint32_t x = 0; x < b.width; ++x) {
              const float got = dst[(((v * b.lights + l) * 2 + c) * b.height + y) * b.width + x];
              /* Three products and sums of floats below 2, and weights good to 1e-6. */
              assert_near(got,
                          linear_value(btf_dirset_directions(sets->lights) + 3 * (size_t)(b.light0 + l),
                                       b.view0 + v, b.y0 + y, b.x0 + x, c),
                          5e-6);
            }
  }
}

static void lights_of_each_view_are_interpolated(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  per_view sets;
  make_per_view(ctx, &sets);
  for (uint32_t flags = 0; flags < 4; ++flags) {
    btf_dataset_desc desc = per_view_desc(&sets);
    btf_dataset *ds;
    desc.read = read_own;
    desc.user = &sets;
    desc.flags = flags;
    assert_ok(btf_dataset_create(ctx, &desc, &ds));
    expect_linear(ds, &sets);
    btf_dataset_release(ds);
  }
  free_per_view(&sets);
  test_context_done(ctx, &memory);
}

static void resident_lights_of_each_view_are_interpolated(void **state) {
  (void)state;
  enum { most_lights = 48 };
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  per_view sets;
  make_per_view(ctx, &sets);
  btf_dataset_desc desc = per_view_desc(&sets);
  btf_dataset *ds;
  float *data = malloc(sizeof(float) * 5 * most_lights * 60);
  desc.data = data;
  desc.strides = (btf_strides){4 * 60 * most_lights, 4 * 60, 4 * 12, 4 * 2, 4};
  for (uint32_t v = 0; v < 5; ++v) {
    const btf_block b = {v, 1, 0, btf_dirset_count(sets.own[v]), 0, 0, 6, 5};
    assert_ok(read_own(&sets, &b, data + (size_t)v * most_lights * 60, &desc.strides));
  }
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  expect_linear(ds, &sets);
  btf_dataset_release(ds);
  /* The same directions in both sets: exactly the view's own samples. */
  desc.lights = sets.own[1];
  for (uint32_t v = 0; v < 5; ++v)
    btf_dirset_release(sets.own[v]), sets.own[v] = btf_dirset_retain(desc.lights);
  for (uint32_t v = 0; v < 5; ++v) {
    const btf_block b = {v, 1, 0, 27, 0, 0, 6, 5};
    assert_ok(read_own(&sets, &b, data + (size_t)v * most_lights * 60, &desc.strides));
  }
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  float image[60];
  for (uint32_t l = 0; l < 27; ++l) {
    const btf_block b = {3, 1, l, 1, 0, 0, 6, 5};
    assert_ok(btf_dataset_read(ds, &b, image, &desc.strides));
    assert_memory_equal(image, data + ((size_t)3 * most_lights + l) * 60, sizeof image);
  }
  btf_dataset_release(ds);
  desc.strides = (btf_strides){0, 0, 0, 0, 0};
  assert_status(btf_dataset_create(ctx, &desc, &ds), BTF_E_INVALID_ARG);
  assert_message_has("lights per view need strides");
  free(data);
  free_per_view(&sets);
  test_context_done(ctx, &memory);
}

/* ---- memory ---- */

static void failing_allocations_leave_nothing(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  per_view sets;
  make_per_view(ctx, &sets);
  btf_dataset_desc desc = per_view_desc(&sets);
  desc.read = read_own;
  desc.user = &sets;
  desc.name = "wool";
  desc.release = count_release;
  const btf_block b = {0, 5, 0, 9, 0, 0, 6, 5};
  const btf_strides s = {4 * 540, 4 * 60, 4 * 12, 4 * 2, 4};
  static float dst[2700];
  long fail_at = 1;
  for (;; ++fail_at) {
    btf_dataset *ds = NULL;
    const long before = memory.live_blocks;
    releases = 0;
    memory.fail_at = memory.total_allocations + fail_at;
    btf_status status = btf_dataset_create(ctx, &desc, &ds);
    if (status == BTF_OK) status = btf_dataset_read(ds, &b, dst, &s);
    const int failed = memory.total_allocations >= memory.fail_at;
    memory.fail_at = 0;
    btf_dataset_release(ds);
    assert_int_equal(releases, 1);
    assert_int_equal(memory.live_blocks, before);
    if (!failed) {
      assert_ok(status);
      break;
    }
    assert_int_equal(status, BTF_E_NOMEM);
  }
  assert_true(fail_at > 10);
  free_per_view(&sets);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_source_reads_what_the_formula_says),
      cmocka_unit_test(large_blocks_are_read_by_several_threads),
      cmocka_unit_test(abrdfs_are_read_by_texel),
      cmocka_unit_test(resident_samples_may_lie_at_any_stride),
      cmocka_unit_test(instruction_sets_agree_bit_for_bit),
      cmocka_unit_test(packing_rounds_to_nearest_everywhere),
      cmocka_unit_test(integers_survive_the_way_through_floats),
      cmocka_unit_test(samples_that_are_not_finite_are_named),
      cmocka_unit_test(blocks_and_strides_are_checked),
      cmocka_unit_test(descriptions_are_checked),
      cmocka_unit_test(descriptions_come_back_complete),
      cmocka_unit_test(sources_are_read_in_bounded_pieces),
      cmocka_unit_test(what_a_source_says_reaches_the_caller),
      cmocka_unit_test(many_threads_read_one_data_set),
      cmocka_unit_test(lights_of_each_view_are_interpolated),
      cmocka_unit_test(resident_lights_of_each_view_are_interpolated),
      cmocka_unit_test(failing_allocations_leave_nothing),
  };
  return btf_run("dataset", tests);
}
