/* SPDX-License-Identifier: MIT */
/* `.rti` files of known coefficients against harmonics from their definition, and damaged ones. */
#include "../source/test_one_view.h"

#include <unistd.h>

enum { WIDTH = 3, HEIGHT = 2, TEXELS = WIDTH * HEIGHT };

typedef struct hsh_case {
  const char *label, *header;
  int terms;
} hsh_case;

static const hsh_case cases[] = {
    {"4 terms", "#HSH1.2\n3\n3 2 3\n4 2 1\n", 4},
    {"9 terms, CR LF, comments", "#HSH1.2\r\n# of a test\r\n3\r\n3 2 3\r\n9 2 1\r\n", 9},
    {"16 terms", "#HSH1.2\n#\n3\n3 2 3\n16 2 1\n", 16},
};
enum { CASES = sizeof cases / sizeof *cases };

static float scale_of(int term) {
  return 0.25f + 0.5f * (float)(term % 5);
}
static float bias_of(int term) {
  return term == 0 ? 1.5f : 0.125f - 0.0625f * (float)term;
}
/* Rows as in the file, the first on top. */
static unsigned char coefficient(int row, int x, int channel, int term) {
  return (unsigned char)(11 + 97 * row + 41 * x + 67 * channel + 29 * term);
}

static size_t put_float(unsigned char *at, float value) {
  memcpy(at, &value, 4); /* little-endian hosts only */
  return 4;
}

static size_t write_case(const hsh_case *c, const char *path, unsigned char image[4096]) {
  size_t size = strlen(c->header);
  memcpy(image, c->header, size);
  for (int i = 0; i < c->terms; i++) size += put_float(image + size, scale_of(i));
  for (int i = 0; i < c->terms; i++) size += put_float(image + size, bias_of(i));
  for (int row = 0; row < HEIGHT; row++)
    for (int x = 0; x < WIDTH; x++)
      for (int k = 0; k < 3; k++)
        for (int i = 0; i < c->terms; i++) image[size++] = coefficient(row, x, k, i);
  test_write_bytes(path, image, size);
  return size;
}

static double recorded(const void *user, const double light[3], int x, int y, int channel) {
  const hsh_case *c = user;
  double basis[16], sum = 0;
  one_view_harmonics(light, basis);
  for (int i = 0; i < c->terms; i++)
    sum += basis[i] *
           (coefficient(HEIGHT - 1 - y, x, channel, i) / 255.0 * (double)scale_of(i) + (double)bias_of(i));
  return sum;
}

static void test_values(void **state) {
  (void)state;
  unsigned char image[4096];
  const char *path = test_path("map.dat");
  for (int i = 0; i < CASES; i++) {
    const char *const settings[] = {"directions", i == 0 ? "ubo81" : "grid:7x5", NULL};
    write_case(&cases[i], path, image);
    /* s = sqrt(c - c^2) loses half of the digits where a direction's z is 1 but for a rounding: an error of
     * 1e-16 in c is one of 1e-8 in s, times coefficients below 8. */
    one_view_check_all(path, "rti-hsh", settings, WIDTH, HEIGHT, recorded, &cases[i], 2e-7);
  }
}

static void test_sizes(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("size.dat");
  unsigned char image[4096];
  for (int i = 0; i < CASES; i++) {
    const size_t whole = write_case(&cases[i], path, image);
    assert_int_equal(truncate(path, (off_t)whole + 1), 0);
    format_expect_refusal(ctx, path, "rti-hsh");
    for (size_t size = whole; size-- > 0;) {
      assert_int_equal(truncate(path, (off_t)size), 0);
      format_expect_refusal(ctx, path, "rti-hsh");
    }
  }
  test_context_done(ctx, &memory);
}

static void test_headers(void **state) {
  (void)state;
  static const char *const headers[] = {
      "#HSH1.2\n1\n3 2 3\n4 2 1\n",
      "#HSH1.2\n2\n3 2 3\n4 2 1\n",
      "#HSH1.2\n4\n3 2 3\n4 2 1\n",
      "#HSH1.2\n2147483648\n3 2 3\n4 2 1\n",
      "#HSH1.2\n3\n0 2 3\n4 2 1\n",
      "#HSH1.2\n3\n3 0 3\n4 2 1\n",
      "#HSH1.2\n3\n-3 2 3\n4 2 1\n",
      "#HSH1.2\n3\n2147483648 2 3\n4 2 1\n",
      "#HSH1.2\n3\n3 4294967295 3\n4 2 1\n",
      "#HSH1.2\n3\n1048577 1 3\n4 2 1\n",
      "#HSH1.2\n3\n1048576 1048576 3\n16 2 1\n",
      "#HSH1.2\n3\n4294967297 4294967297 3\n4 2 1\n",
      "#HSH1.2\n3\n3 2 1\n4 2 1\n",
      "#HSH1.2\n3\n3 2 4294967295\n4 2 1\n",
      "#HSH1.2\n3\n3 2 3\n0 2 1\n",
      "#HSH1.2\n3\n3 2 3\n5 2 1\n",
      "#HSH1.2\n3\n3 2 3\n25 2 1\n",
      "#HSH1.2\n3\n3 2 3\n4294967295 2 1\n",
      "#HSH1.2\n3\n3 2 3\n2147483648 2 1\n",
      "#HSH1.2\n3\n3 2 3\n4 1 1\n",
      "#HSH1.2\n3\n3 2 3\n4 2 4\n",
      "#HSH1.2\n3\n3 2 3\n4 2 1",
      "#HSH1.2\n3\n3 2 3\n4 2 1x\n",
      "#HSH1.2\n3\n3.5 2 3\n4 2 1\n",
      "#HSH1.2\n3\nnan 2 3\n4 2 1\n",
      "#HSH1.2 3\n3 2 3\n4 2 1\n",
      "HSH1.2\n3\n3 2 3\n4 2 1\n",
      "# HSH1.2\n3\n3 2 3\n4 2 1\n",
      "PTM_1.2\nPTM_FORMAT_RGB\n3 2\n4 2 1\n",
      "#HSH1.2\n",
  };
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("header.dat");
  unsigned char image[4096], whole[4096];
  const size_t size = write_case(&cases[0], path, whole), header = strlen(cases[0].header);
  for (size_t i = 0; i < sizeof headers / sizeof *headers; i++) {
    const size_t length = strlen(headers[i]);
    memcpy(image, headers[i], length);
    memcpy(image + length, whole + header, size - header);
    test_write_bytes(path, image, length + size - header);
    format_expect_refusal(ctx, path, "rti-hsh");
  }
  test_context_done(ctx, &memory);
}

static void test_not_finite(void **state) {
  (void)state;
  const float values[] = {NAN, -NAN, INFINITY, -INFINITY};
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("finite.dat");
  unsigned char image[4096];
  const size_t size = write_case(&cases[1], path, image), header = strlen(cases[1].header);
  for (int at = 0; at < 2 * cases[1].terms; at++)
    for (int i = 0; i < 4; i++) {
      unsigned char changed[4096];
      memcpy(changed, image, size);
      put_float(changed + header + 4 * at, values[i]);
      test_write_bytes(path, changed, size);
      format_expect_refusal(ctx, path, "rti-hsh");
    }
  /* The largest finite ones open; samples beyond the range of a float are refused where they are read. */
  put_float(image + header, 3e38f);
  put_float(image + header + 4 * cases[1].terms, 3e38f);
  test_write_bytes(path, image, size);
  btf_dataset *ds;
  float sample[3];
  const btf_block first = {0, 1, 0, 1, 0, 0, 1, 1};
  const btf_strides strides = {12, 12, 12, 12, 4};
  assert_ok(format_try(ctx, path, "rti-hsh", NULL, &ds));
  assert_status(btf_dataset_read(ds, &first, sample, &strides), BTF_E_CORRUPT);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void test_allocations(void **state) {
  (void)state;
  const char *path = test_path("whole.dat");
  unsigned char image[4096];
  write_case(&cases[0], path, image);
  format_check_allocations(path, "rti-hsh", 5);
}

static void test_count(void **state) {
  (void)state;
  format_check_refusals(100);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_values),      cmocka_unit_test(test_sizes),
                                     cmocka_unit_test(test_headers),     cmocka_unit_test(test_not_finite),
                                     cmocka_unit_test(test_allocations), cmocka_unit_test(test_count)};
  return btf_run("rti_hsh", tests);
}
