/* SPDX-License-Identifier: MIT */
/* UTIA's containers: files of known contents, written from the description of the format, and damaged ones.
 */
#include "../source/test_format.h"

#include <locale.h>
#include <unistd.h>

#include <btf/btf_formats.h>
#include <btf/btf_half.h>

typedef struct mif_case {
  const char *label, *xml;
  unsigned lights, views, width, height, planes, type;
  int backwards; /* images from the last to the first, erased and unknown chunks between them */
} mif_case;

#define UNIFORM                                                                                              \
  "<?xml version=\"1.0\"?><!-- <directions name='Wrong' stepTheta='1'/> -->\n<root version='1'><btf "        \
  "id=\"btf0\"/>"                                                                                            \
  "<directions type=\"list\" name=\"Uniform\" stepTheta=\"45\" stepPhi='90'></directions></root>"
static const mif_case cases[] = {
    {"uniform, float", UNIFORM, 5, 4, 3, 2, 3, 10, 0},
    {"uniform, double, backwards", UNIFORM, 5, 4, 2, 3, 3, 11, 1},
    {"uniform, half, one plane", UNIFORM, 5, 4, 3, 2, 1, 9, 0},
    {"UBO81x81", "<root><directions name='UBO81x81' type='list'/></root>", 81, 81, 2, 1, 1, 9, 0},
};

/* ---- contents ---- */

/* What the reader is to give, from 0.1 to about 2; row 0 is the bottom one. */
static double reflectance(unsigned view, unsigned light, unsigned x, unsigned y, unsigned channel) {
  return 0.1 + 0.21 * (view % 4) + 0.013 * (view / 4) + 0.11 * (light % 5) + 0.007 * (light / 5) + 0.05 * x +
         0.023 * y * (channel + 1) + 0.017 * channel;
}

/* Rec. 709's primaries and white as CIE XYZ: columns are the primaries scaled so that they add up to white.
 */
static void rgb_to_xyz(const double rgb[3], double xyz[3]) {
  static const double x[3] = {0.64, 0.30, 0.15}, y[3] = {0.33, 0.60, 0.06};
  static const double white[3] = {0.95047, 1, 1.08883};
  double m[3][3], s[3];
  for (int k = 0; k < 3; k++) m[0][k] = x[k] / y[k], m[1][k] = 1, m[2][k] = (1 - x[k] - y[k]) / y[k];
  const double det = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
                     m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
                     m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
  for (int k = 0; k < 3; k++) {
    double a[3][3];
    memcpy(a, m, sizeof a);
    for (int i = 0; i < 3; i++) a[i][k] = white[i];
    s[k] = (a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1]) -
            a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0]) +
            a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0])) /
           det;
  }
  for (int i = 0; i < 3; i++)
    xyz[i] = m[i][0] * s[0] * rgb[0] + m[i][1] * s[1] * rgb[1] + m[i][2] * s[2] * rgb[2];
}

/* ---- the file ---- */

typedef struct bytes {
  unsigned char *data;
  size_t size, room;
  size_t marks[512], ends[512]; /* of numbers, and of chunks */
  int mark_count, end_count;
} bytes;

static void put(bytes *b, uint64_t value, int width, int mark) {
  if (b->size + 8 > b->room) {
    b->room = 2 * b->room + 64;
    b->data = realloc(b->data, b->room);
    assert_non_null(b->data);
  }
  if (mark && b->mark_count < 512) b->marks[b->mark_count++] = b->size;
  for (int i = 0; i < width; i++) b->data[b->size++] = (unsigned char)(value >> (8 * i));
}

static void end_chunk(bytes *b) {
  if (b->end_count < 512) b->ends[b->end_count++] = b->size;
}

static void put_xml(bytes *b, const char *xml) {
  put(b, 1, 8, 1);
  put(b, strlen(xml), 8, 1);
  for (; *xml != '\0'; xml++) put(b, (unsigned char)*xml, 1, 0);
  end_chunk(b);
}

static void put_number(bytes *b, double value, unsigned type) {
  const float single = (float)value;
  uint64_t bits = 0;
  if (type == 9) bits = btf_float_to_half(single);
  if (type == 10) memcpy(&bits, &single, 4); /* little-endian hosts only */
  if (type == 11) memcpy(&bits, &value, 8);
  put(b, bits, type == 9 ? 2 : type == 10 ? 4 : 8, 0);
}

static void put_image(bytes *b, const mif_case *c, unsigned index) {
  const unsigned size = c->type == 9 ? 2 : c->type == 10 ? 4 : 8;
  put(b, 0, 8, 1);
  put(b, 48 + (uint64_t)c->width * c->height * c->planes * size, 8, 1);
  put(b, index, 8, 1);
  put(b, 0, 8, 0);
  put(b, c->type, 8, 1);
  put(b, c->height, 8, 1);
  put(b, c->width, 8, 1);
  put(b, c->planes, 8, 1);
  for (unsigned row = 0; row < c->height; row++)
    for (unsigned x = 0; x < c->width; x++) {
      double rgb[3], xyz[3];
      for (unsigned k = 0; k < 3; k++)
        rgb[k] = reflectance(index / c->lights, index % c->lights, x, c->height - 1 - row, k);
      rgb_to_xyz(rgb, xyz);
      for (unsigned k = 0; k < c->planes; k++)
        put_number(b, 100 * (c->planes == 1 ? rgb[0] : xyz[k]), c->type);
    }
  end_chunk(b);
}

static bytes write_case(const mif_case *c) {
  bytes b = {.size = 0};
  const unsigned count = c->lights * c->views;
  for (const char *p = "MIF FILE"; *p != '\0'; p++) put(&b, (unsigned char)*p, 1, 0);
  put(&b, 8, 8, 1);
  put(&b, 1, 8, 1);
  end_chunk(&b);
  if (!c->backwards) put_xml(&b, c->xml);
  for (unsigned i = 0; i < count; i++) {
    put_image(&b, c, c->backwards ? count - 1 - i : i);
    if (!c->backwards) continue;
    put(&b, i % 2 ? UINT64_MAX : 77, 8, 0);
    put(&b, 5, 8, 0);
    put(&b, 0x1122334455, 5, 0);
    end_chunk(&b);
  }
  if (c->backwards) put_xml(&b, c->xml);
  return b;
}

/* ---- tests ---- */

static void check_directions(const btf_dataset_desc *d) {
  const float *views = btf_dirset_directions(d->views), *lights = btf_dirset_directions(d->lights);
  for (unsigned i = 0; i < 4; i++) { /* 45 degrees from the normal, every quarter turn */
    const double x[4] = {1, 0, -1, 0}, y[4] = {0, 1, 0, -1};
    for (int light = 0; light < 2; light++) {
      const float *at = light ? lights + 3 * (i + 1) : views + 3 * i;
      assert_near(at[0], x[i] * sqrt(0.5), 1e-6);
      assert_near(at[1], y[i] * sqrt(0.5), 1e-6);
      assert_near(at[2], sqrt(0.5), 1e-6);
    }
  }
  assert_near(lights[2], 1, 0);
}

static void check_samples(const mif_case *c, const btf_dataset *ds, uint32_t x0, uint32_t width) {
  const btf_block b = {0, c->views, 0, c->lights, x0, 0, width, c->height};
  const ptrdiff_t x = 4 * (ptrdiff_t)c->planes, y = x * width, light = y * (ptrdiff_t)c->height;
  const btf_strides strides = {light * (ptrdiff_t)c->lights, light, y, x, 4};
  float *samples = malloc((size_t)(light * c->lights * c->views)), *at = samples;
  assert_non_null(samples);
  assert_ok(btf_dataset_read(ds, &b, samples, &strides));
  /* The published matrix has seven digits, its sums cancel by a factor of 5; halves have 11 bits. */
  const double tolerance = c->type == 9 ? 1.0 / 2048 : 1e-5;
  for (unsigned v = 0; v < c->views; v++)
    for (unsigned l = 0; l < c->lights; l++)
      for (unsigned row = 0; row < c->height; row++)
        for (unsigned column = 0; column < width; column++)
          for (unsigned k = 0; k < c->planes; k++, at++)
            assert_relative(*at, reflectance(v, l, x0 + column, row, k), tolerance);
  free(samples);
}

static void test_values(void **state) {
  (void)state;
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    const mif_case *c = &cases[i];
    test_memory memory;
    btf_context *ctx = format_context(&memory);
    const char *path = test_path("images.dat");
    const btf_format *format;
    btf_dataset *ds;
    btf_dataset_desc d = BTF_DATASET_DESC_INIT;
    bytes b = write_case(c);
    test_write_bytes(path, b.data, b.size);
    free(b.data);
    assert_ok(btf_format_detect(ctx, path, &format));
    assert_string_equal(btf_format_id(format), "utia-mif");
    assert_ok(btf_format_open(ctx, path, NULL, NULL, &ds));
    assert_ok(btf_dataset_describe(ds, &d));
    assert_int_equal(d.width, c->width);
    assert_int_equal(d.height, c->height);
    assert_int_equal(d.channels, c->planes);
    assert_int_equal(d.quantity, BTF_QUANTITY_BRDF_COS);
    assert_int_equal(btf_dirset_count(d.views), c->views);
    assert_int_equal(btf_dirset_count(d.lights), c->lights);
    if (c->lights == 5) check_directions(&d);
    check_samples(c, ds, 0, c->width);
    check_samples(c, ds, 1, c->width - 1);
    btf_dataset_release(ds);
    test_context_done(ctx, &memory);
  }
}

static void test_options(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const btf_format *format = btf_format_find(ctx, "utia-mif");
  const char *path = test_path("options.dat");
  btf_options *options;
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  bytes b = write_case(&cases[0]);
  test_write_bytes(path, b.data, b.size);
  free(b.data);
  assert_ok(btf_format_options_create(format, &options));
  assert_ok(btf_options_set(options, "colour", "rgb"));
  assert_ok(btf_options_set(options, "cosine", "outside"));
  assert_ok(btf_format_open(ctx, path, format, options, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  assert_int_equal(d.quantity, BTF_QUANTITY_BRDF);
  float sample[3];
  double rgb[3], xyz[3];
  const btf_block one = {2, 1, 3, 1, 1, 1, 1, 1};
  const btf_strides strides = {12, 12, 12, 12, 4};
  assert_ok(btf_dataset_read(ds, &one, sample, &strides));
  for (unsigned k = 0; k < 3; k++) rgb[k] = reflectance(2, 3, 1, 1, k);
  rgb_to_xyz(rgb, xyz);
  for (int k = 0; k < 3; k++) assert_relative(sample[k], xyz[k], 1e-6);
  btf_dataset_release(ds);
  btf_options_release(options);
  test_context_done(ctx, &memory);
}

/* Cut anywhere, also between two chunks. */
static void test_truncation(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("short.dat");
  for (int i = 0; i < 3; i++) {
    bytes b = write_case(&cases[i]);
    test_write_bytes(path, b.data, b.size);
    for (size_t size = b.size; size-- > 0;) {
      assert_int_equal(truncate(path, (off_t)size), 0);
      format_expect_refusal(ctx, path, "utia-mif");
    }
    free(b.data);
  }
  test_context_done(ctx, &memory);
}

/* Every number replaced by what would overflow or be absurd. None is without consequence: sizes and indices
 * must agree. */
static void test_lies(void **state) {
  (void)state;
  static const uint64_t lies[] = {
      7, 13, 0x7fffffff, 0x80000000, 0xffffffff, (uint64_t)1 << 32, (uint64_t)1 << 62, UINT64_MAX};
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("lie.dat");
  bytes b = write_case(&cases[0]);
  test_write_bytes(path, b.data, b.size);
  FILE *file = fopen(path, "r+b");
  assert_non_null(file);
  for (int m = 0; m < b.mark_count; m++)
    for (size_t k = 0; k < sizeof lies / sizeof *lies; k++) {
      uint64_t was;
      memcpy(&was, b.data + b.marks[m], 8);
      if (was == lies[k]) continue;
      assert_int_equal(fseek(file, (long)b.marks[m], SEEK_SET), 0);
      assert_int_equal(fwrite(&lies[k], 1, 8, file), 8);
      assert_int_equal(fflush(file), 0);
      format_expect_refusal(ctx, path, "utia-mif");
      assert_int_equal(fseek(file, (long)b.marks[m], SEEK_SET), 0);
      assert_int_equal(fwrite(&was, 1, 8, file), 8);
    }
  fclose(file);
  free(b.data);
  test_context_done(ctx, &memory);
}

static void test_descriptions(void **state) {
  (void)state;
  static const char *const texts[] = {
      "",
      "<",
      "<directions",
      "<directions name='Uniform' stepTheta='45' stepPhi='90'",
      "<directions name='Uniform stepTheta='45' stepPhi='90'/>",
      "<!-- <directions name='Uniform' stepTheta='45' stepPhi='90'/> -->",
      "<direction name='Uniform' stepTheta='45' stepPhi='90'/>",
      "<directions name='Uniform'/>",
      "<directions name='Uniform' stepTheta='0' stepPhi='90'/>",
      "<directions name='Uniform' stepTheta='-45' stepPhi='90'/>",
      "<directions name='Uniform' stepTheta='44' stepPhi='90'/>",
      "<directions name='Uniform' stepTheta='90' stepPhi='90'/>",
      "<directions name='Uniform' stepTheta='nan' stepPhi='90'/>",
      "<directions name='Uniform' stepTheta='1e999' stepPhi='90'/>",
      "<directions name='Uniform' stepTheta='45' stepPhi='0.001'/>",
      "<directions name='Uniform' stepTheta='1' stepPhi='1'/>",
      "<directions name='CoatingRegular' stepThetaH='5'/>",
      "<directions name='UBO81x81'/>",
      "<mipmap/><directions name='Uniform' stepTheta='45' stepPhi='90'/>",
  };
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("text.dat");
  for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
    mif_case c = cases[0];
    c.xml = texts[i];
    bytes b = write_case(&c);
    test_write_bytes(path, b.data, b.size);
    format_expect_refusal(ctx, path, "utia-mif");
    free(b.data);
  }
  mif_case c = cases[0];
  bytes b = write_case(&c);
  put_image(&b, &c, 3);
  test_write_bytes(path, b.data, b.size);
  format_expect_refusal(ctx, path, "utia-mif");
  assert_message_has("image 3 is there twice");
  free(b.data);
  test_context_done(ctx, &memory);
}

/* A host with a decimal comma reads the same files. */
static void test_locale(void **state) {
  (void)state;
  mif_case c = cases[0];
  c.xml = "<directions name='Uniform' stepTheta='45.0' stepPhi='9.0e1'/>";
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("locale.dat");
  bytes b = write_case(&c);
  test_write_bytes(path, b.data, b.size);
  free(b.data);
  btf_dataset *ds;
  assert_ok(format_try(ctx, path, "utia-mif", NULL, &ds));
  btf_dataset_release(ds);
  const int found = test_set_comma_locale();
  const btf_status status = found ? format_try(ctx, path, "utia-mif", NULL, &ds) : BTF_OK;
  setlocale(LC_ALL, "C");
  assert_ok(status);
  if (found) btf_dataset_release(ds);
  test_context_done(ctx, &memory);
  if (!found) skip();
}

static void test_allocations(void **state) {
  (void)state;
  const char *path = test_path("whole.dat");
  bytes b = write_case(&cases[0]);
  test_write_bytes(path, b.data, b.size);
  free(b.data);
  format_check_allocations(path, "utia-mif", 5);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_values),       cmocka_unit_test(test_options),
                                     cmocka_unit_test(test_truncation),   cmocka_unit_test(test_lies),
                                     cmocka_unit_test(test_descriptions), cmocka_unit_test(test_locale),
                                     cmocka_unit_test(test_allocations)};
  return btf_run("utia_mif", tests);
}
