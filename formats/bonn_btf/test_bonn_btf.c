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

static void check_directions(const btf_dirset *set, uint32_t count, bool light) {
  assert_int_equal(btf_dirset_count(set), count);
  for (uint32_t i = 0; i < count; i++) {
    const float *d = btf_dirset_directions(set) + 3 * i;
    float theta, phi;
    bonn_case_angles(i, count, light, &theta, &phi);
    assert_near(d[0], sin(theta) * cos(phi), 1e-6);
    assert_near(d[1], sin(theta) * sin(phi), 1e-6);
    assert_near(d[2], cos(theta), 1e-6);
  }
}

static const char *note(const btf_dataset_desc *d, const char *key) {
  for (uint32_t i = 0; d->notes != NULL && d->notes[i] != NULL; i += 2)
    if (strcmp(d->notes[i], key) == 0) return d->notes[i + 1];
  return "";
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
    assert_int_equal(d.quantity, c->cosine ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF);
    assert_near(d.texels_per_mm, c->legacy ? 0 : 7.5, 0);
    assert_string_equal(note(&d, "bonn_setup"), c->legacy ? "" : "a dome");
    check_directions(d.views, c->views, false);
    check_directions(d.lights, c->lights, true);
    const btf_block whole = {0, c->views, 0, c->lights, 0, 0, c->width, c->height};
    const btf_block inner = {1, c->views - 2, 1, c->lights - 2, 1, 1, c->width - 1, c->height - 1};
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

/* A file that ends early is never taken, wherever it ends. */
static void test_truncation(void **state) {
  (void)state;
  for (size_t i = 0; i < bonn_case_count; i++) {
    test_memory memory;
    btf_context *ctx = format_context(&memory);
    const char *path = test_path("short.dat");
    bonn_bytes bytes = bonn_case_write(&bonn_cases[i]);
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
  for (size_t i = 0; i < bonn_case_count; i++) {
    bonn_bytes bytes = bonn_case_write(&bonn_cases[i]);
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
  for (size_t i = 0; i < bonn_case_count; i++) {
    test_memory memory;
    btf_context *ctx = format_context(&memory);
    const char *path = test_path("lie.dat");
    bonn_bytes bytes = bonn_case_write(&bonn_cases[i]);
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
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_variants),       cmocka_unit_test(test_cosine), cmocka_unit_test(test_truncation),
      cmocka_unit_test(test_trailing_bytes), cmocka_unit_test(test_counts), cmocka_unit_test(test_refusals),
      cmocka_unit_test(test_allocations),
  };
  return btf_run("bonn_btf", tests);
}
