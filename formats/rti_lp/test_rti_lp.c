/* SPDX-License-Identifier: MIT */
/* Photographs of known codes with lists of their lights, and lists and photographs that are wrong. */
#include "../bonn_images/images_case.h"
#include "../source/test_format.h"
#include "../source/test_picture.h"

#include <sys/stat.h>
#include <unistd.h>

enum { WIDTH = 19, HEIGHT = 11, LIGHTS = 4 };

/* Their directions, and how a list may write them. */
static const double lights[LIGHTS][3] = {{0.6, 0, 0.8}, {0, 0.6, 0.8}, {-0.48, 0.36, 0.8}, {0, 0, 1}};

typedef enum photograph_kind { JPEG, GREY_JPEG, PNG, PNG16 } photograph_kind;
typedef struct lp_case {
  const char *label;
  photograph_kind kind;
  const char *list;
  const char *names[LIGHTS];
} lp_case;

static const lp_case cases[] = {
    {"with a count",
     JPEG,
     "4\na.jpg 0.6 0 0.8\nb.jpg 0 0.6 0.8\nc.jpg -0.48 0.36 0.8\nd.jpg 0 0 1\n",
     {"a.jpg", "b.jpg", "c.jpg", "d.jpg"}},
    {"without a count; CR LF, tabs, blanks, paths of elsewhere, lengths",
     GREY_JPEG,
     "photo 2.jpg\t6e0 0 8\r\n\r\n  C:\\scans\\photo 10.jpg\t\t0 +600 800 \r\n/home/x/a b c.jpg -.48e-3 "
     "0.36e-3 0.0008\r\n"
     "../../last.JPG 0 0 1e200",
     {"photo 2.jpg", "photo 10.jpg", "a b c.jpg", "last.JPG"}},
    {"PNG",
     PNG,
     " 4 \n1 0.6 0 0.8\n2.png 0 0.6 0.8\n3.png -0.48 0.36 0.8\n4.png 0 0 1\n",
     {"1", "2.png", "3.png", "4.png"}},
    {"PNG of 16 bits",
     PNG16,
     "4\n1.p 0.6 0 0.8\n2.p 0 0.6 0.8\n3.p -0.48 0.36 0.8\n4.p 0 0 1\n",
     {"1.p", "2.p", "3.p", "4.p"}},
};
enum { CASES = sizeof cases / sizeof *cases };

static unsigned char code8(int light, int column, int row, int channel) {
  return (unsigned char)(17 + 61 * light + 29 * column + 83 * row + 47 * channel);
}
static unsigned char jpeg_code(const void *user, int column, int row, int channel) {
  return code8(*(const int *)user, column, row, channel);
}
static uint32_t png_code(uint32_t view, uint32_t light, uint32_t x, uint32_t row, uint32_t channel) {
  const uint32_t code = code8((int)light, (int)x / 8, (int)row / 8, (int)channel);
  return view == 16 ? code * 256 + 77 : code;
}

static const char *file_in(const char *folder, const char *name) {
  static char path[4096];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  return path;
}

static void write_photograph(const char *folder, const char *name, photograph_kind kind, int light, int width,
                             int height) {
  if (kind == JPEG || kind == GREY_JPEG) {
    size_t size;
    unsigned char *data = test_squares_jpeg(width, height, kind == JPEG ? 3 : 1, jpeg_code, &light, &size);
    test_write_bytes(file_in(folder, name), data, size);
    free(data);
    return;
  }
  const picture_case picture = {kind == PNG ? CASE_PNG : CASE_PNG16, (uint32_t)width, (uint32_t)height, 3,
                                png_code};
  case_bytes bytes = {0};
  case_picture(&picture, kind == PNG16 ? 16 : 8, (uint32_t)light, &bytes);
  test_write_bytes(file_in(folder, name), bytes.data, bytes.size);
  case_free(&bytes);
}

static const char *write_case(const lp_case *c, const char *name) {
  const char *folder = test_path(name);
  (void)mkdir(folder, 0777);
  test_write_bytes(file_in(folder, "lights.lp"), c->list, strlen(c->list));
  for (int i = 0; i < LIGHTS; i++) write_photograph(folder, c->names[i], c->kind, i, WIDTH, HEIGHT);
  return folder;
}

static double decoded(double v) {
  return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
}

static void check(const lp_case *c, const char *path, int linear) {
  const char *const settings[] = {"transfer", linear ? "linear" : "srgb", NULL};
  const int channels = c->kind == GREY_JPEG ? 1 : 3;
  static float samples[LIGHTS * WIDTH * HEIGHT * 3];
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const btf_format *format;
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  assert_ok(btf_format_detect(ctx, path, &format));
  assert_string_equal(btf_format_id(format), "rti-lp");
  assert_ok(format_try(ctx, path, "rti-lp", settings, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  assert_int_equal(d.width, WIDTH);
  assert_int_equal(d.height, HEIGHT);
  assert_int_equal(d.channels, channels);
  assert_int_equal(d.quantity, BTF_QUANTITY_BRDF_COS);
  assert_int_equal(btf_dirset_count(d.views), 1);
  assert_int_equal(btf_dirset_count(d.lights), LIGHTS);
  for (int i = 0; i < LIGHTS; i++) /* some lists give them in a few digits of another length */
    for (int k = 0; k < 3; k++) assert_near(btf_dirset_directions(d.lights)[3 * i + k], lights[i][k], 1e-7);
  const btf_block all = {0, 1, 0, LIGHTS, 0, 0, WIDTH, HEIGHT};
  const ptrdiff_t x = 4 * channels, y = x * WIDTH, light = y * HEIGHT;
  const btf_strides strides = {0, light, y, x, 4};
  assert_ok(btf_dataset_read(ds, &all, samples, &strides));
  const float *sample = samples;
  for (int l = 0; l < LIGHTS; l++)
    for (int row = 0; row < HEIGHT; row++)
      for (int column = 0; column < WIDTH; column++)
        for (int k = 0; k < channels; k++, sample++) {
          const int code = code8(l, column / 8, (HEIGHT - 1 - row) / 8, k);
          const double value = c->kind == PNG16 ? (code * 256 + 77) / 65535.0 : code / 255.0;
          const double expected = linear ? value : decoded(value);
          /* Half floats: half of the last of 11 bits, or of the smallest one. */
          assert_near(*sample, expected, expected * 0x1p-11 + 0x1p-25);
        }
  /* Parts, from the last light to the first. */
  for (uint32_t l = LIGHTS; l-- > 0;) {
    float part[3];
    const btf_block one = {0, 1, l, 1, WIDTH - 1, HEIGHT - 1, 1, 1};
    assert_ok(btf_dataset_read(ds, &one, part, &strides));
    assert_true(part[0] == samples[(size_t)(l + 1) * WIDTH * HEIGHT * (size_t)channels - (size_t)channels]);
  }
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void test_values(void **state) {
  (void)state;
  for (int i = 0; i < CASES; i++)
    for (int linear = 0; linear < 2; linear++) {
      char name[32];
      snprintf(name, sizeof name, "values-%d", i);
      const char *folder = write_case(&cases[i], name);
      if (i != 2) check(&cases[i], folder, linear);
      if (i != 2) check(&cases[i], file_in(folder, "lights.lp"), linear);
    }
  /* A name without a point is not enough to know a list by; asked for, it is read. */
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const btf_format *format;
  btf_dataset *ds;
  assert_status(btf_format_detect(ctx, file_in(test_path("values-2"), "lights.lp"), &format), BTF_E_NOT_BTF);
  assert_ok(format_try(ctx, test_path("values-2"), "rti-lp", NULL, &ds));
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void test_lists(void **state) {
  (void)state;
  static const char *const lists[] = {
      "",
      "\n \r\n",
      "0\n",
      "1\n",
      "2\na.jpg 0 0 1\n",
      "0\na.jpg 0 0 1\n",
      "-1\na.jpg 0 0 1\n",
      "1.5\na.jpg 0 0 1\n",
      "2147483648\na.jpg 0 0 1\n",
      "4294967295\na.jpg 0 0 1\n",
      "4294967297\na.jpg 0 0 1\n",
      "18446744073709551617\na.jpg 0 0 1\n",
      "1e300\na.jpg 0 0 1\n",
      "1\n1\na.jpg 0 0 1\n",
      "a.jpg 0 0\n",
      "0 0 1\n",
      "a.jpg 0 0 one\n",
      "a.jpg 0 0 nan\n",
      "a.jpg nan nan nan\n",
      "a.jpg 0 0 inf\n",
      "a.jpg 0 0 1e999\n",
      "a.jpg 0 0 0x1\n",
      "a.jpg 0 0 1,5\n",
      "a.jpg 0 0 0\n",
      "a.jpg 0 0 1e-400\n",
      "a.jpg 0 0 -1\n",
      "a.jpg 1 0 0\n",
      "a.jpg 1e300 0 1\n",
      "a.jpg 0 0 1\nb.jpg 1e-6 0 1\n",
      "absent.jpg 0 0 1\n",
      "/etc/passwd 0 0 1\n",
      "../ 0 0 1\n",
      ".. 0 0 1\n",
      ". 0 0 1\n",
      "/ 0 0 1\n",
      "lights.lp 0 0 1\n",
      "a\001.jpg 0 0 1\n",
      "a.jpg 0 0 00000000000000000000000000000000000000000000000000000000000000000000000001\n",
  };
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *folder = write_case(&cases[0], "lists"), *list = test_path("lists/lights.lp");
  for (size_t i = 0; i < sizeof lists / sizeof *lists; i++) {
    test_write_bytes(list, lists[i], strlen(lists[i]));
    format_expect_refusal(ctx, folder, "rti-lp");
    format_expect_refusal(ctx, list, "rti-lp");
  }
  test_write_bytes(list, "a.jpg\0 0 0 1\n", 13);
  format_expect_refusal(ctx, list, "rti-lp");
  /* A list with a count, cut: the lines are too few, or the last one is not whole. */
  const char *whole = cases[0].list;
  for (size_t size = strlen(whole) - 2; size-- > 0;) {
    test_write_bytes(list, whole, size);
    format_expect_refusal(ctx, list, "rti-lp");
  }
  /* More lights than are read, and a long file. */
  static char many[(1 << 20) + 2];
  size_t used = 0;
  for (int i = 0; i < 4097; i++) used += (size_t)snprintf(many + used, sizeof many - used, "a.jpg 0 0 1\n");
  test_write_bytes(list, many, used);
  format_expect_status(ctx, list, "rti-lp", BTF_E_LIMIT);
  memset(many, '\n', sizeof many);
  test_write_bytes(list, many, sizeof many);
  format_expect_status(ctx, list, "rti-lp", BTF_E_LIMIT);
  /* Two lists, or none. */
  test_write_bytes(list, whole, strlen(whole));
  test_write_bytes(file_in(folder, "other.LP"), whole, strlen(whole));
  format_expect_refusal(ctx, folder, "rti-lp");
  assert_int_equal(unlink(file_in(folder, "other.LP")), 0);
  assert_int_equal(unlink(list), 0);
  format_expect_refusal(ctx, folder, "rti-lp");
  assert_int_equal(mkdir(list, 0777), 0);
  format_expect_status(ctx, folder, "rti-lp", BTF_E_IO);
  test_context_done(ctx, &memory);
}

static void test_photographs(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *folder = write_case(&cases[0], "photographs");
  size_t size;
  unsigned char *whole = test_read_bytes(file_in(folder, "c.jpg"), &size);
  for (size_t cut = 0; cut < size; cut++) {
    btf_dataset *ds;
    test_write_bytes(file_in(folder, "c.jpg"), whole, cut);
    btf_status status = format_try(ctx, folder, "rti-lp", NULL, &ds);
    if (status == BTF_OK) { /* its head is there: it is refused where it is read, and the others are read */
      float samples[3];
      const btf_block third = {0, 1, 2, 1, 3, 3, 1, 1}, last = {0, 1, 3, 1, 3, 3, 1, 1};
      const btf_strides strides = {12, 12, 12, 12, 4};
      assert_ok(btf_dataset_read(ds, &last, samples, &strides));
      status = btf_dataset_read(ds, &third, samples, &strides);
      assert_true(status == BTF_E_CORRUPT || status == BTF_E_TRUNCATED);
      assert_message_has("c.jpg");
      assert_ok(btf_dataset_read(ds, &last, samples, &strides));
      btf_dataset_release(ds);
      if (cut % 16 == 0) format_keep_refused(folder, status, true);
    } else {
      format_expect_refusal(ctx, folder, "rti-lp");
      assert_message_has("c.jpg");
    }
  }
  write_photograph(folder, "c.jpg", JPEG, 2, WIDTH + 1, HEIGHT);
  format_expect_refusal(ctx, folder, "rti-lp");
  write_photograph(folder, "c.jpg", JPEG, 2, WIDTH, HEIGHT - 1);
  format_expect_refusal(ctx, folder, "rti-lp");
  write_photograph(folder, "c.jpg", GREY_JPEG, 2, WIDTH, HEIGHT);
  format_expect_refusal(ctx, folder, "rti-lp");
  write_photograph(folder, "c.jpg", PNG, 2, WIDTH, HEIGHT);
  format_expect_refusal(ctx, folder, "rti-lp");
  /* All of them as large as their heads can say. */
  for (int i = 0; i < LIGHTS; i++)
    test_write_bytes(file_in(folder, cases[0].names[i]),
                     "\xff\xd8\xff\xc0\0\x11\x08\x20\0\x20\0\x03\x01\x11\0\x02\x11\0\x03\x11\0", 21);
  format_expect_status(ctx, folder, "rti-lp", BTF_E_LIMIT);
  assert_message_has("pixels");
  test_write_bytes(file_in(folder, "a.jpg"),
                   "\xff\xd8\xff\xc0\0\x11\x08\xff\xff\xff\xff\x03\x01\x11\0\x02\x11\0\x03\x11\0", 21);
  format_expect_status(ctx, folder, "rti-lp", BTF_E_LIMIT);
  folder = write_case(&cases[0], "photographs");
  assert_int_equal(unlink(file_in(folder, "c.jpg")), 0);
  format_expect_refusal(ctx, folder, "rti-lp");
  assert_int_equal(mkdir(file_in(folder, "c.jpg"), 0777), 0);
  format_expect_status(ctx, folder, "rti-lp", BTF_E_IO);
  free(whole);
  test_context_done(ctx, &memory);
}

static void test_allocations(void **state) {
  (void)state;
  format_check_allocations(write_case(&cases[0], "allocations"), "rti-lp", 10);
}

static void test_count(void **state) {
  (void)state;
  format_check_refusals(100);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_values), cmocka_unit_test(test_lists),
                                     cmocka_unit_test(test_photographs), cmocka_unit_test(test_allocations),
                                     cmocka_unit_test(test_count)};
  return btf_run("rti_lp", tests);
}
