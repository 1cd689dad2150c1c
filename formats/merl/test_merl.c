/* SPDX-License-Identifier: MIT */
/* MERL tables: a file whose bins hold their own numbers, and damaged files. */
#include "../source/test_one_texel.h"

#include <unistd.h>

enum { SIZE = 12 + 3 * 90 * 90 * 180 * 8 };
static const double pi = 3.14159265358979323846;

typedef double (*bin_fn)(int plane, int i, int j, int k);

static unsigned char *image; /* of the file in the making */

static void put_int(size_t offset, uint32_t value) {
  for (int b = 0; b < 4; b++) image[offset + (size_t)b] = (unsigned char)(value >> (8 * b));
}

/* As the database describes it: three planes, theta_h slowest, phi_d fastest; little-endian hosts only. */
static void write_table(const char *path, bin_fn bin) {
  const uint32_t one = 1;
  unsigned char first;
  memcpy(&first, &one, 1);
  assert_int_equal(first, 1);
  image = malloc(SIZE);
  assert_non_null(image);
  put_int(0, 90);
  put_int(4, 90);
  put_int(8, 180);
  unsigned char *at = image + 12;
  for (int plane = 0; plane < 3; plane++)
    for (int i = 0; i < 90; i++)
      for (int j = 0; j < 90; j++)
        for (int k = 0; k < 180; k++, at += 8) {
          const double value = bin(plane, i, j, k);
          memcpy(at, &value, 8);
        }
  test_write_bytes(path, image, SIZE);
  free(image);
}

static const double stored_per_f[3] = {1500, 1500 / 1.15, 1500 / 1.66};

static double own_number(int plane, int i, int j, int k) {
  return (plane == 0 ? i : plane == 1 ? j : k) * stored_per_f[plane];
}

static double half_missing(int plane, int i, int j, int k) {
  (void)i, (void)j;
  return k % 2 ? -1 : 0.25 * (plane + 1) * stored_per_f[plane];
}

/* Half and difference angles in degrees by the two rotations of the definition. */
static void half_difference(const double light[3], const double view[3], double *theta_h, double *theta_d,
                            double *phi_d) {
  double h[3], length = 0, phi_h;
  for (int i = 0; i < 3; i++) length += (light[i] + view[i]) * (light[i] + view[i]);
  for (int i = 0; i < 3; i++) h[i] = (light[i] + view[i]) / sqrt(length);
  one_texel_angles(h, theta_h, &phi_h);
  if (*theta_h < 1e-4) *theta_h = phi_h = 0;
  const double c = cos(phi_h * pi / 180), s = sin(phi_h * pi / 180);
  const double x = c * light[0] + s * light[1], y = c * light[1] - s * light[0];
  const double ct = cos(*theta_h * pi / 180), st = sin(*theta_h * pi / 180);
  const double d[3] = {ct * x - st * light[2], y, st * x + ct * light[2]};
  one_texel_angles(d, theta_d, phi_d);
  if (*phi_d >= 180) *phi_d -= 180;
}

/* An arc cosine of doubles near 1 is off by up to 1e-8 rad, directions at the normal by up to 1e-7: below
 * 1e-4 degrees. An azimuth is off by that over the sine of its elevation. */
static const double slack = 1e-4;

static void check_nearest(const double light[3], const double view[3], const float *sample) {
  double theta_h, theta_d, phi_d;
  half_difference(light, view, &theta_h, &theta_d, &phi_d);
  const double i = round(sample[0]), j = round(sample[1]), k = round(sample[2]);
  for (int c = 0; c < 3; c++) assert_near(sample[c], round(sample[c]), 1e-4);
  assert_true(theta_h > i * i / 90 - slack && theta_h < (i + 1) * (i + 1) / 90 + slack);
  assert_true(theta_d > j - slack && theta_d < j + 1 + slack);
  if (theta_d < slack) {
    assert_near(k, 0, 0);
    return;
  }
  const double turn = slack / sin(theta_d * pi / 180), off = fabs(phi_d - (k + 0.5));
  assert_true(off < 0.5 + turn || off > 179.5 - turn);
}

static void check_linear(const double light[3], const double view[3], const float *sample) {
  double theta_h, theta_d, phi_d;
  half_difference(light, view, &theta_h, &theta_d, &phi_d);
  /* The root turns 1e-6 degrees above 1/360 degree, where the first centre is, into less than 1e-3 bins. */
  assert_near(sample[0], fmin(fmax(sqrt(theta_h * 90) - 0.5, 0), 89), 1e-3);
  assert_near(sample[1], fmin(fmax(theta_d - 0.5, 0), 89), 1e-3);
  if (theta_d < slack) return;
  const double turn = slack / sin(theta_d * pi / 180);
  const double past = phi_d < 0.5 ? phi_d + 180 : phi_d; /* from 179.5 on it falls from 179 to 0 */
  /* The slope across the seam is 179 per bin. */
  assert_near(sample[2], past < 179.5 ? past - 0.5 : 179 * (180.5 - past),
              past < 179.4 && past > 0.6 ? 1e-3 + turn : 180 * turn + 1e-3);
}

static void check_missing_nearest(const double light[3], const double view[3], const float *sample) {
  (void)light, (void)view;
  for (int c = 0; c < 3; c++)
    if (sample[c] != 0) assert_relative(sample[c], 0.25 * (c + 1), 1e-6);
  assert_true((sample[0] == 0) == (sample[1] == 0) && (sample[0] == 0) == (sample[2] == 0));
}

static void check_missing_linear(const double light[3], const double view[3], const float *sample) {
  (void)light, (void)view;
  for (int c = 0; c < 3; c++) assert_relative(sample[c], 0.25 * (c + 1), 1e-6);
}

static void test_bins(void **state) {
  (void)state;
  const char *path = test_path("table.dat");
  const char *const linear[] = {"lookup", "linear", "directions", "grid:7x9", NULL};
  const char *const nearest[] = {"directions", "grid:7x9", NULL};
  write_table(path, own_number);
  one_texel_check_all(path, "merl", NULL, BTF_QUANTITY_BRDF, check_nearest);
  one_texel_check_all(path, "merl", nearest, BTF_QUANTITY_BRDF, check_nearest);
  one_texel_check_all(path, "merl", linear, BTF_QUANTITY_BRDF, check_linear);
  format_check_allocations(path, "merl", 3);
}

static void test_missing(void **state) {
  (void)state;
  const char *path = test_path("holes.dat");
  const char *const linear[] = {"lookup", "linear", "directions", "grid:7x9", NULL};
  const char *const nearest[] = {"directions", "grid:7x9", NULL};
  write_table(path, half_missing);
  one_texel_check_all(path, "merl", nearest, BTF_QUANTITY_BRDF, check_missing_nearest);
  /* At most every other bin is missing, so an even one is always near, unless a place is an odd centre. */
  one_texel_check_all(path, "merl", linear, BTF_QUANTITY_BRDF, check_missing_linear);
}

static void write_header(const char *path, const uint32_t bins[3], off_t size) {
  unsigned char header[12];
  for (int i = 0; i < 12; i++) header[i] = (unsigned char)(bins[i / 4] >> (8 * (i % 4)));
  test_write_bytes(path, header, sizeof header);
  assert_int_equal(truncate(path, size), 0);
}

static void test_damaged(void **state) {
  (void)state;
  static const uint32_t sound[3] = {90, 90, 180};
  static const uint32_t lies[] = {0, 1, 89, 91, 0x7fffffff, 0x80000000, 0xffffffff, (uint32_t)-90};
  static const off_t sizes[] = {
      0, 1, 4, 11, 12, 20, 11664012, 23328012, SIZE - 8, SIZE - 1, SIZE + 1, (off_t)SIZE + ((off_t)1 << 32)};
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("damaged.dat");
  for (int i = 0; i < 3; i++)
    for (size_t k = 0; k < sizeof lies / sizeof *lies; k++) {
      uint32_t bins[3] = {90, 90, 180};
      bins[i] = lies[k];
      write_header(path, bins, SIZE);
      format_expect_refusal(ctx, path, "merl");
    }
  const uint32_t both[3] = {(uint32_t)-90, (uint32_t)-90, 180}, turned[3] = {180, 90, 90};
  write_header(path, both, SIZE);
  format_expect_refusal(ctx, path, "merl");
  write_header(path, turned, SIZE);
  format_expect_refusal(ctx, path, "merl");
  for (size_t k = 0; k < sizeof sizes / sizeof *sizes; k++) {
    write_header(path, sound, sizes[k]);
    format_expect_refusal(ctx, path, "merl");
  }
  test_context_done(ctx, &memory);
}

/* A number that is not finite is named where it is read; a set that is not there is refused. */
static void test_refusals(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("nan.dat");
  const char *const unknown[] = {"directions", "ubo82", NULL};
  const uint32_t bins[3] = {90, 90, 180};
  float sample[3];
  const btf_block first = {0, 1, 0, 1, 0, 0, 1, 1};
  const btf_strides strides = {12, 12, 12, 12, 4};
  btf_dataset *ds;
  write_header(path, bins, SIZE);
  FILE *file = fopen(path, "r+b");
  assert_non_null(file);
  assert_int_equal(fseek(file, 12, SEEK_SET), 0);
  assert_int_equal(fwrite("\xff\xff\xff\xff\xff\xff\xff\x7f", 1, 8, file), 8);
  fclose(file);
  assert_ok(format_try(ctx, path, "merl", NULL, &ds));
  assert_status(btf_dataset_read(ds, &first, sample, &strides), BTF_E_CORRUPT);
  btf_dataset_release(ds);
  assert_status(format_try(ctx, path, "merl", unknown, &ds), BTF_E_INVALID_ARG);
  assert_message_has("ubo82");
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_bins), cmocka_unit_test(test_missing),
                                     cmocka_unit_test(test_damaged), cmocka_unit_test(test_refusals)};
  return btf_run("merl", tests);
}
