/* SPDX-License-Identifier: MIT */
/* Polynomial texture maps: files of known coefficients against the polynomial, and damaged headers. */
#include "../source/test_format.h"

#include <unistd.h>

#include <btf/btf_formats.h>

enum { WIDTH = 3, HEIGHT = 2, TEXELS = WIDTH * HEIGHT };

typedef struct ptm_case {
  const char *label, *header;
  int separate, together;
} ptm_case;

#define SCALES "0.5 1 2 1.5e0 0.25 1.25"
#define BIASES "128 100 90 120.0 +110 5"
static const ptm_case cases[] = {
    {"LRGB", "PTM_1.2\nPTM_FORMAT_LRGB\n3\n2\n" SCALES "\n" BIASES "\n", 0, 0},
    {"LRGB, shared lines, CR LF", "PTM_1.2\r\nPTM_FORMAT_LRGB\r\n3 2\r\n" SCALES " " BIASES " \r\n", 0, 0},
    {"LRGB 1.1", "PTM_1.1\nPTM_FORMAT_LRGB\n3\n2\n" SCALES "\n" BIASES "\n", 0, 1},
    {"RGB", "PTM_1.2\nPTM_FORMAT_RGB\n3 2\n" SCALES "\n" BIASES "\n", 1, 0},
};
static const double scales[6] = {0.5, 1, 2, 1.5, 0.25, 1.25}, biases[6] = {128, 100, 90, 120, 110, 5};

/* Bytes of block `block`; the first ones look like blanks, which the header does not swallow. */
static unsigned char coefficient(int block, int texel, int term) {
  if (block == 0 && texel == 0 && term < 3) return "\n \r"[term];
  return (unsigned char)(17 + 71 * block + 29 * texel + 43 * term);
}
static unsigned char colour(int texel, int channel) {
  return (unsigned char)(60 + 31 * texel + 53 * channel);
}

static size_t write_case(const ptm_case *c, const char *path, unsigned char image[4096]) {
  size_t size = strlen(c->header);
  memcpy(image, c->header, size);
  for (int block = 0; block < (c->separate ? 3 : 1); block++)
    for (int t = 0; t < TEXELS; t++) {
      for (int i = 0; i < 6; i++) image[size++] = coefficient(block, t, i);
      for (int i = 0; i < 3 && c->together; i++) image[size++] = colour(t, i);
    }
  for (int t = 0; t < TEXELS && !c->separate && !c->together; t++)
    for (int i = 0; i < 3; i++) image[size++] = colour(t, i);
  test_write_bytes(path, image, size);
  return size;
}

/* On the camera's scale, 0 to 1; row 0 is the file's first, the bottom. */
static double recorded(const ptm_case *c, const float *light, int texel, int channel) {
  const double lx = light[0], ly = light[1];
  double a[6];
  for (int i = 0; i < 6; i++)
    a[i] = scales[i] * (coefficient(c->separate ? channel : 0, texel, i) - biases[i]);
  const double value = a[0] * lx * lx + a[1] * ly * ly + a[2] * lx * ly + a[3] * lx + a[4] * ly + a[5];
  return c->separate ? value / 255 : value * colour(texel, channel) / 255 / 255;
}

static double decoded(double v) {
  const double s = fabs(v), l = s <= 0.04045 ? s / 12.92 : pow((s + 0.055) / 1.055, 2.4);
  return v < 0 ? -l : l;
}

static void check(const ptm_case *c, int linear) {
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("map.dat");
  const btf_format *format;
  btf_options *options;
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  unsigned char image[4096];
  static float samples[81 * TEXELS * 3];
  write_case(c, path, image);
  assert_ok(btf_format_detect(ctx, path, &format));
  assert_string_equal(btf_format_id(format), "rti-ptm");
  assert_ok(btf_format_options_create(format, &options));
  if (linear) assert_ok(btf_options_set(options, "transfer", "linear"));
  assert_ok(btf_format_open(ctx, path, format, options, &ds));
  btf_options_release(options);
  assert_ok(btf_dataset_describe(ds, &d));
  assert_int_equal(d.width, WIDTH);
  assert_int_equal(d.height, HEIGHT);
  assert_int_equal(d.quantity, BTF_QUANTITY_BRDF_COS);
  assert_int_equal(btf_dirset_count(d.views), 1);
  assert_int_equal(btf_dirset_count(d.lights), 81);
  const btf_block all = {0, 1, 0, 81, 0, 0, WIDTH, HEIGHT};
  const btf_strides strides = {0, 12 * TEXELS, 12 * WIDTH, 12, 4};
  assert_ok(btf_dataset_read(ds, &all, samples, &strides));
  for (int l = 0; l < 81; l++)
    for (int t = 0; t < TEXELS; t++)
      for (int k = 0; k < 3; k++) {
        const double value = recorded(c, btf_dirset_directions(d.lights) + 3 * l, t, k);
        /* One rounding to float, and the sums of doubles. */
        const double expected = linear ? value : decoded(value);
        assert_near(samples[(l * TEXELS + t) * 3 + k], expected, 1e-7 * fmax(1, fabs(expected)));
      }
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void test_values(void **state) {
  (void)state;
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
    for (int linear = 0; linear < 2; linear++) check(&cases[i], linear);
}

static void test_sizes(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("size.dat");
  unsigned char image[4096];
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    const size_t whole = write_case(&cases[i], path, image);
    assert_int_equal(truncate(path, (off_t)whole + 1), 0);
    format_expect_refusal(ctx, path, "rti-ptm");
    for (size_t size = whole; size-- > 0;) {
      assert_int_equal(truncate(path, (off_t)size), 0);
      format_expect_refusal(ctx, path, "rti-ptm");
    }
  }
  test_context_done(ctx, &memory);
}

static void test_headers(void **state) {
  (void)state;
  static const char *const sizes[] = {"0 2",
                                      "3 0",
                                      "-3 2",
                                      "3 -2",
                                      "3.5 2",
                                      "x 2",
                                      "3 2x",
                                      "1e30 2",
                                      "nan 2",
                                      "3 inf",
                                      "2147483648 2",
                                      "4294967296 2",
                                      "1048577 1",
                                      "0x3 2",
                                      "3e 2",
                                      "4294967297 4294967297",
                                      "1000000 1000000",
                                      "2 3 1"};
  static const char *const kinds[] = {"PTM_1.3\nPTM_FORMAT_LRGB",      "PTM_1.\nPTM_FORMAT_LRGB",
                                      "PTM_2.0\nPTM_FORMAT_LRGB",      "PTM_1.2\nPTM_FORMAT_LUM",
                                      "PTM_1.2\nPTM_FORMAT_JPEG_LRGB", "PTM_1.2\nLRGB",
                                      "PTM_1.22\nPTM_FORMAT_RGB",      "#HSH1.2\nPTM_FORMAT_RGB"};
  static const char *const numbers[] = {"nan", "inf", "1e999", "--1", "1,5", "e5", ".", "1.5.5"};
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("header.dat");
  char text[512] = "";
  for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
    const int length =
        snprintf(text, 400, "PTM_1.2\nPTM_FORMAT_LRGB\n%s\n" SCALES "\n" BIASES "\n", sizes[i]);
    test_write_bytes(path, text, (size_t)length + 54);
    format_expect_refusal(ctx, path, "rti-ptm");
  }
  for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
    const int length = snprintf(text, 400, "%s\n3 2\n" SCALES "\n" BIASES "\n", kinds[i]);
    test_write_bytes(path, text, (size_t)length + 54);
    format_expect_refusal(ctx, path, "rti-ptm");
    if (strstr(kinds[i], "JPEG") != NULL) assert_message_has("PTM_FORMAT_JPEG_LRGB; PTM_FORMAT_RGB");
  }
  for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
    const int length =
        snprintf(text, 400, "PTM_1.2\nPTM_FORMAT_LRGB\n3 2\n" SCALES " 1 2 3 4 5 %s\n", numbers[i]);
    test_write_bytes(path, text, (size_t)length + 54);
    format_expect_refusal(ctx, path, "rti-ptm");
  }
  test_context_done(ctx, &memory);
}

static void test_allocations(void **state) {
  (void)state;
  const char *path = test_path("whole.dat");
  unsigned char image[4096];
  write_case(&cases[0], path, image);
  format_check_allocations(path, "rti-ptm", 5);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_values), cmocka_unit_test(test_sizes),
                                     cmocka_unit_test(test_headers), cmocka_unit_test(test_allocations)};
  return btf_run("rti_ptm", tests);
}
