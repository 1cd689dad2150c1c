/* SPDX-License-Identifier: MIT */
/* Bonn's containers: every family and variant against brute force, and damaged files. */
#include "bonn_case.h"
#include "../source/test_format.h"

#include <unistd.h>

#include <btf/btf_formats.h>

static const char *write_case(const bonn_case *c) {
  const char *path = test_path("material.dat"); /* the name tells nothing */
  bonn_bytes bytes = bonn_case_write(c);
  test_write_bytes(path, bytes.data, bytes.size);
  free(bytes.data);
  return path;
}

/* Float products of up to 4 terms of at most 1 are within 4 * 2^-23 of exact; an exponential of up to 4
 * multiplies that by its slope, e^4 = 55, and colours add three of them with factors of up to 3.2: 2.6e-4 at
 * most where values are near 170, so relative to the larger of 1 and the value 1e-5 holds with room. */
static const double tolerance = 1e-5;

static void check_samples(const bonn_case *c, const btf_dataset *ds, const btf_block *b) {
  const size_t count = (size_t)b->views * b->lights * b->width * b->height * c->channels;
  float *samples = malloc(count * sizeof *samples);
  const ptrdiff_t ch = sizeof(float), light = ch * (ptrdiff_t)c->channels,
                  view = light * (ptrdiff_t)b->lights, x = view * (ptrdiff_t)b->views,
                  y = x * (ptrdiff_t)b->width;
  const btf_strides strides = {.view = view, .light = light, .y = y, .x = x, .channel = ch};
  assert_non_null(samples);
  assert_ok(btf_dataset_read(ds, b, samples, &strides));
  size_t i = 0;
  for (uint32_t row = 0; row < b->height; row++)
    for (uint32_t column = 0; column < b->width; column++)
      for (uint32_t v = 0; v < b->views; v++)
        for (uint32_t l = 0; l < b->lights; l++)
          for (uint32_t k = 0; k < c->channels; k++, i++) {
            const double expected =
                bonn_case_sample(c, b->view0 + v, b->light0 + l, b->x0 + column, b->y0 + row, k);
            if (!(fabs(samples[i] - expected) <= tolerance * fmax(1, fabs(expected))))
              fail_msg("%s: view %u light %u texel %u %u channel %u: %.9g instead of %.9g", c->label,
                       b->view0 + v, b->light0 + l, b->x0 + column, b->y0 + row, k, (double)samples[i],
                       expected);
          }
  free(samples);
}

static void test_variants(void **state) {
  (void)state;
  for (size_t i = 0; i < bonn_case_count; i++) {
    const bonn_case *c = &bonn_cases[i];
    test_memory memory;
    btf_context *ctx = format_context(&memory);
    const char *path = write_case(c);
    const btf_format *format;
    btf_dataset *ds;
    btf_dataset_desc d = BTF_DATASET_DESC_INIT;
    assert_ok(btf_format_detect(ctx, path, &format));
    assert_string_equal(btf_format_id(format), "bonn-btf");
    assert_ok(btf_format_open(ctx, path, NULL, NULL, &ds));
    assert_ok(btf_dataset_describe(ds, &d));
    assert_int_equal(d.width, c->width);
    assert_int_equal(d.height, c->height);
    assert_int_equal(d.channels, c->channels);
    assert_string_equal(d.channel_names[0], c->version > 3 ? "410" : "R");
    assert_int_equal(d.sample_type, c->family == BONN_CASE_BDI ? BTF_SAMPLE_F16 : BTF_SAMPLE_F32);
    assert_int_equal(d.quantity, c->cosine ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF);
    assert_near(d.texels_per_mm, c->legacy ? 0 : 7.5, 0);
    assert_string_equal(format_note(&d, "bonn_setup"), c->legacy ? "" : "a dome");
    bonn_case_check_directions(d.views, c->views, false);
    bonn_case_check_directions(d.lights, c->lights, true);
    const btf_block whole = {0, c->views, 0, c->lights, 0, 0, c->width, c->height};
    const btf_block inner = {1, c->views - 2, 1, c->lights - 2, 1, 1, c->width - 1, c->height - 1};
    assert_string_equal(format_note(&d, "lights_resampled"), "");
    check_samples(c, ds, &whole);
    check_samples(c, ds, &inner);
    btf_dataset_release(ds);
    test_context_done(ctx, &memory);
  }
}

static void test_cosine(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = write_case(&bonn_cases[0]);
  const btf_format *format = btf_format_find(ctx, "bonn-btf");
  btf_options *options;
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  assert_ok(btf_format_options_create(format, &options));
  assert_ok(btf_options_set(options, "cosine", "inside"));
  assert_ok(btf_format_open(ctx, path, format, options, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  assert_int_equal(d.quantity, BTF_QUANTITY_BRDF_COS);
  btf_dataset_release(ds);
  assert_status(btf_options_set(options, "sine", "inside"), BTF_E_INVALID_ARG);
  btf_options_release(options);
  test_context_done(ctx, &memory);
}

/* ---- lights of each view ---- */

static bonn_case with_own_lights(size_t i) {
  bonn_case c = bonn_cases[i];
  c.own_lights = true;
  c.views = 5;
  if (c.family == BONN_CASE_PVF) c.components = 1; /* of one light there are no more */
  return c;
}

/* All cases, and then all with lights of each view. */
static bonn_case either(size_t i) {
  return i < bonn_case_count ? bonn_cases[i] : with_own_lights(i - bonn_case_count);
}

static void unit_of(const bonn_case *c, uint32_t view, uint32_t light, double d[3]) {
  float theta, phi;
  bonn_case_light(c, view, light, &theta, &phi);
  d[0] = sin(theta) * cos(phi);
  d[1] = sin(theta) * sin(phi);
  d[2] = cos(theta);
}

/* Barycentric coordinates of p in a triangle in the plane; false outside. */
static bool inside(const double p[2], double corner[3][2], double weight[3]) {
  double area = 0;
  for (int i = 0; i < 3; i++) {
    const double *a = corner[(i + 1) % 3], *b = corner[(i + 2) % 3];
    weight[i] = (a[0] - p[0]) * (b[1] - p[1]) - (a[1] - p[1]) * (b[0] - p[0]);
    area += weight[i];
  }
  for (int i = 0; i < 3; i++) weight[i] /= area;
  return fmin(weight[0], fmin(weight[1], weight[2])) >= -1e-6;
}

/* Weights of a view's own lights for a direction, in parabolic coordinates; false outside of all of them.
 * There is one way to triangulate three points, and one to do so with a fourth inside. */
static bool own_weights(const bonn_case *c, uint32_t view, const float *direction, double weight[4]) {
  const uint32_t count = bonn_case_lights(c, view);
  const double p[2] = {direction[0] / (1.0 + direction[2]), direction[1] / (1.0 + direction[2])};
  double at[4][2];
  for (uint32_t i = 0; i < count; i++) {
    double d[3];
    unit_of(c, view, i, d);
    for (int k = 0; k < 2; k++) at[i][k] = d[k] / (1 + d[2]);
  }
  for (int i = 0; i < 4; i++) weight[i] = count == 1 && i == 0;
  for (uint32_t i = 0; i < (count == 4 ? 3u : count / 3); i++) {
    const uint32_t number[3] = {i, (i + 1) % 3, count == 4 ? 3 : (i + 2) % 3};
    double corner[3][2], w[3];
    for (int k = 0; k < 3; k++) memcpy(corner[k], at[number[k]], sizeof corner[k]);
    if (!inside(p, corner, w)) continue;
    for (int k = 0; k < 3; k++) weight[number[k]] = w[k];
    return true;
  }
  return count == 1;
}

/* Weights are off by what directions in floats and points rounded to 2^-24 are, some 2e-7, against triangles
 * of height 0.07 and more: 3e-6. Samples themselves are within `tolerance`. Returns how many were inside of
 * their view's lights. */
static size_t check_resampled(const bonn_case *c, const btf_dataset *ds) {
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  size_t compared = 0;
  assert_ok(btf_dataset_describe(ds, &d));
  const uint32_t lights = btf_dirset_count(d.lights);
  const btf_strides strides = {256, 256, 256, 256, 4};
  for (uint32_t v = 0; v < c->views; v++)
    for (uint32_t l = 0; l < lights; l++) {
      double weight[4];
      if (!own_weights(c, v, btf_dirset_directions(d.lights) + 3 * (size_t)l, weight)) continue;
      compared++;
      for (uint32_t y = 0; y < c->height; y++)
        for (uint32_t x = 0; x < c->width; x++) {
          float got[64];
          const btf_block one = {v, 1, l, 1, x, y, 1, 1};
          assert_ok(btf_dataset_read(ds, &one, got, &strides));
          for (uint32_t k = 0; k < c->channels; k++) {
            double expected = 0, bound = 0;
            for (uint32_t i = 0; i < bonn_case_lights(c, v); i++) {
              const double sample = bonn_case_sample(c, v, i, x, y, k);
              expected += weight[i] * sample;
              bound += (weight[i] * tolerance + 3e-6) * fmax(1, fabs(sample));
            }
            if (!(fabs(got[k] - expected) <= bound))
              fail_msg("%s: view %u light %u texel %u %u channel %u: %.9g instead of %.9g", c->label, v, l, x,
                       y, k, (double)got[k], expected);
          }
        }
    }
  return compared;
}

/* Degrees to the nearest light of the view where that is farthest. */
static double largest_angle(const bonn_case *c, uint32_t common) {
  double largest = 0;
  for (uint32_t v = 0; v < c->views; v++)
    for (uint32_t l = 0; l < bonn_case_lights(c, common); l++) {
      double to[3], nearest = 4;
      unit_of(c, common, l, to);
      for (uint32_t i = 0; i < bonn_case_lights(c, v); i++) {
        double own[3];
        unit_of(c, v, i, own);
        nearest = fmin(nearest, acos(fmin(1, own[0] * to[0] + own[1] * to[1] + own[2] * to[2])));
      }
      largest = fmax(largest, nearest);
    }
  return largest * 180 / acos(-1.0);
}

static void expect_note(const btf_dataset *ds, const char *begin, double angle) {
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  assert_ok(btf_dataset_describe(ds, &d));
  const char *note = format_note(&d, "lights_resampled"), *number = strstr(note, "up to ");
  assert_int_equal(strncmp(note, begin, strlen(begin)), 0);
  assert_non_null(number);
  assert_near(strtod(number + 6, NULL), angle, 0.005 * angle); /* three digits */
}

static void test_own_lights(void **state) {
  (void)state;
  for (size_t i = 0; i < bonn_case_count; i++) {
    const bonn_case c = with_own_lights(i);
    test_memory memory;
    btf_context *ctx = format_context(&memory);
    const char *path = write_case(&c);
    const char *const first[] = {"lights", "first", NULL}, *const named[] = {"lights", "grid:4x3", NULL},
                      *const unknown[] = {"lights", "some", NULL};
    btf_dataset *ds;
    btf_factors factors = BTF_FACTORS_INIT;
    assert_ok(format_try(ctx, path, "bonn-btf", NULL, &ds));
    expect_note(ds, "at the 4 of view 1, in 3 of 5 views; ", largest_angle(&c, 1));
    assert_int_equal(check_resampled(&c, ds), 5 * 4); /* all are inside */
    assert_status(btf_dataset_factors(ds, &factors), BTF_E_UNSUPPORTED);
    assert_message_has("lights of their own");
    btf_dataset_release(ds);
    assert_ok(format_try(ctx, path, "bonn-btf", first, &ds));
    expect_note(ds, "at the 3 of view 0, in 4 of 5 views; ", largest_angle(&c, 0));
    assert_true(check_resampled(&c, ds) >= 3 + 3);
    btf_dataset_release(ds);
    assert_ok(format_try(ctx, path, "bonn-btf", named, &ds));
    assert_true(check_resampled(&c, ds) >= 2 * 4 + 12);
    btf_dataset_release(ds);
    assert_status(format_try(ctx, path, "bonn-btf", unknown, &ds), BTF_E_INVALID_ARG);
    assert_message_has("some");
    test_context_done(ctx, &memory);
  }
}

/* A file without lights of each view is resampled if that is asked for. */
static void test_named_lights(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *const named[] = {"lights", "grid:4x2", NULL};
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  assert_ok(format_try(ctx, write_case(&bonn_cases[0]), "bonn-btf", named, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  assert_int_equal(btf_dirset_count(d.lights), 8);
  assert_int_equal(strncmp(format_note(&d, "lights_resampled"), "at the 8 of grid:4x2, in 4 of 4 views", 37),
                   0);
  btf_dataset_release(ds);
  bonn_case many = bonn_cases[0];
  many.views = 65; /* times 4096 is more than 2^18 */
  const char *const fine[] = {"lights", "grid:64x64", NULL};
  assert_status(format_try(ctx, write_case(&many), "bonn-btf", fine, &ds), BTF_E_LIMIT);
  assert_message_has("262144 pairs");
  many = with_own_lights(0);
  many.views = 1710; /* of five, three have lists that no other view has */
  assert_status(format_try(ctx, write_case(&many), "bonn-btf", NULL, &ds), BTF_E_LIMIT);
  assert_message_has("1024 changes");
  test_context_done(ctx, &memory);
}

/* Neighbouring views within the tolerance are not alike over many. */
static void test_drifting_lights(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  bonn_case c = bonn_cases[0];
  btf_dataset *ds;
  char begin[64];
  c.views = 120;
  c.drift = 9e-5f;
  snprintf(begin, sizeof begin, "at the %u of view 0, in 118 of 120 views; ", (unsigned)c.lights);
  assert_ok(format_try(ctx, write_case(&c), "bonn-btf", NULL, &ds));
  /* View 119 has the set of view 118. */
  expect_note(ds, begin, 118 * 9e-5 * 180 / acos(-1.0));
  btf_dataset_release(ds);
  c.views = 4;
  c.drift = 0.5f;
  format_expect_refusal(ctx, write_case(&c), "bonn-btf");
  assert_message_has("degrees from the normal; expected less than 90");
  test_context_done(ctx, &memory);
}

/* ---- damaged files ---- */

/* A file that ends early is never taken, wherever it ends. */
static void test_truncation(void **state) {
  (void)state;
  for (size_t i = 0; i < 2 * bonn_case_count; i++) {
    test_memory memory;
    btf_context *ctx = format_context(&memory);
    const char *path = test_path("short.dat");
    const bonn_case c = either(i);
    bonn_bytes bytes = bonn_case_write(&c);
    /* Shrinking one file is much faster than writing as many. */
    test_write_bytes(path, bytes.data, bytes.size);
    for (size_t size = bytes.size; size-- > 0;) {
      assert_int_equal(truncate(path, (off_t)size), 0);
      format_expect_refusal(ctx, path, "bonn-btf");
    }
    free(bytes.data);
    test_context_done(ctx, &memory);
  }
}

static void test_trailing_bytes(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("long.dat");
  for (size_t i = 0; i < 2 * bonn_case_count; i++) {
    const bonn_case c = either(i);
    bonn_bytes bytes = bonn_case_write(&c);
    bytes.data[bytes.size] = 0;
    test_write_bytes(path, bytes.data, bytes.size + 1);
    format_expect_refusal(ctx, path, "bonn-btf");
    free(bytes.data);
  }
  test_context_done(ctx, &memory);
}

static void put(FILE *file, size_t offset, const unsigned char bytes[4]) {
  assert_int_equal(fseek(file, (long)offset, SEEK_SET), 0);
  assert_int_equal(fwrite(bytes, 1, 4, file), 4);
  assert_int_equal(fflush(file), 0);
}

static bool opens(btf_context *ctx, const char *path) {
  float sample[64];
  btf_dataset *ds = NULL;
  const btf_block first = {0, 1, 0, 1, 0, 0, 1, 1};
  const btf_strides strides = {.view = 256, .light = 256, .y = 256, .x = 256, .channel = 4};
  if (btf_format_open(ctx, path, NULL, NULL, &ds) != BTF_OK) return false;
  (void)!btf_dataset_read(ds, &first, sample, &strides);
  btf_dataset_release(ds);
  return true;
}

/* Every count replaced by what would overflow, wrap round or be absurd. What still opens must be readable. */
static void test_counts(void **state) {
  static const uint32_t lies[] = {0, 1, 0x52, 0x7fffffff, 0x80000000, 0xffffffff, 0x10000001, 0x55555556};
  (void)state;
  size_t refused = 0;
  for (size_t i = 0; i < 2 * bonn_case_count; i++) {
    test_memory memory;
    btf_context *ctx = format_context(&memory);
    const char *path = test_path("lie.dat");
    const bonn_case c = either(i);
    bonn_bytes bytes = bonn_case_write(&c);
    test_write_bytes(path, bytes.data, bytes.size);
    FILE *file = fopen(path, "r+b");
    assert_non_null(file);
    for (uint32_t m = 0; m < bytes.mark_count; m++)
      for (size_t k = 0; k < sizeof lies / sizeof *lies; k++) {
        const unsigned char lie[4] = {(unsigned char)lies[k], (unsigned char)(lies[k] >> 8),
                                      (unsigned char)(lies[k] >> 16), (unsigned char)(lies[k] >> 24)};
        put(file, bytes.marks[m], lie);
        refused += !opens(ctx, path);
        put(file, bytes.marks[m], bytes.data + bytes.marks[m]);
      }
    fclose(file);
    free(bytes.data);
    test_context_done(ctx, &memory);
  }
  assert_true(refused > 1000);
}

static void test_refusals(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("odd.dat");
  btf_dataset *ds = NULL;
  bonn_case c = bonn_cases[7];
  c.colour_model = 2;
  bonn_bytes bytes = bonn_case_write(&c);
  test_write_bytes(path, bytes.data, bytes.size);
  assert_status(btf_format_open(ctx, path, NULL, NULL, &ds), BTF_E_UNSUPPORTED);
  assert_message_has("Lab");
  free(bytes.data);
  /* A NaN among the factors: the structure is sound, the sample is not. */
  c = bonn_cases[1];
  bytes = bonn_case_write(&c);
  memset(bytes.data + bytes.size - 4, 0xff, 4);
  test_write_bytes(path, bytes.data, bytes.size);
  assert_ok(btf_format_open(ctx, path, NULL, NULL, &ds));
  float sample[3];
  const btf_block last = {0, 1, 0, 1, c.width - 1, 0, 1, 1};
  const btf_strides strides = {.view = 12, .light = 12, .y = 12, .x = 12, .channel = 4};
  assert_status(btf_dataset_read(ds, &last, sample, &strides), BTF_E_CORRUPT);
  btf_dataset_release(ds);
  free(bytes.data);
  test_context_done(ctx, &memory);
}

static void test_allocations(void **state) {
  (void)state;
  const size_t cases[] = {0, 8, 18, 22};
  for (size_t k = 0; k < sizeof cases / sizeof *cases; k++)
    format_check_allocations(write_case(&bonn_cases[cases[k]]), "bonn-btf", 5);
  const bonn_case own = with_own_lights(0);
  format_check_allocations(write_case(&own), "bonn-btf", 20);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_variants),        cmocka_unit_test(test_cosine),
      cmocka_unit_test(test_own_lights),      cmocka_unit_test(test_named_lights),
      cmocka_unit_test(test_drifting_lights), cmocka_unit_test(test_truncation),
      cmocka_unit_test(test_trailing_bytes),  cmocka_unit_test(test_counts),
      cmocka_unit_test(test_refusals),        cmocka_unit_test(test_allocations),
  };
  return btf_run("bonn_btf", tests);
}
