/* SPDX-License-Identifier: MIT */
/* RGL's tensor files: small files of arbitrary asymmetric numbers against the definition of their
 * parameterisation, and damaged files. */
#include "../source/test_one_texel.h"

#include <unistd.h>

static const double pi = 3.14159265358979323846;

enum { VROWS = 4, VCOLUMNS = 5, SIZE = 3, NDF_ROWS = 3, NDF_COLUMNS = 4, SIGMA_ROWS = 4, SIGMA_COLUMNS = 3 };

typedef struct rgl_case {
  const char *label;
  int phis, thetas, bands; /* bands 0: rgb */
  double phi0, phi1;
  int jacobian, symmetry;
} rgl_case;

static const rgl_case cases[] = {
    {"isotropic", 1, 3, 0, 0, 0, 1, 1},
    {"isotropic, two azimuths", 2, 4, 0, -2, 2, 1, 1},
    {"isotropic, one elevation", 1, 1, 0, 0.5, 0.5, 1, 1},
    {"anisotropic", 5, 3, 0, -3.14159265, 3.14159265, 1, 1},
    {"half a turn", 4, 3, 0, -3.14159265, 0, 1, 2},
    {"the other half", 4, 2, 0, 0, 3.14159265, 1, 2},
    {"a quadrant", 3, 3, 0, -3.14159265, -1.57079633, 1, 4},
    {"without jacobian", 1, 3, 0, 0, 0, 0, 1},
    {"spectral", 1, 2, 3, 0, 0, 1, 1},
    {"many wavelengths", 1, 2, 130, 0, 0, 1, 1},
};

/* Contents, from 0.5 to 1.5, by the place in each field. */
static float content(unsigned field, unsigned index) {
  const unsigned x = (index + 1) * 2654435761u ^ field * 0x9e3779b9u;
  return 0.5f + (float)(x >> 12) / (float)(1u << 20);
}

/* ---- the file ---- */

typedef struct bytes {
  unsigned char data[1 << 16];
  size_t size;
  size_t marks[128]; /* offsets of sizes, types and places */
  int widths[128], mark_count;
} bytes;

static void put(bytes *b, uint64_t value, int width, int mark) {
  if (mark) {
    b->widths[b->mark_count] = width;
    b->marks[b->mark_count++] = b->size;
  }
  for (int i = 0; i < width; i++) b->data[b->size++] = (unsigned char)(value >> (8 * i));
}

static void put_float(bytes *b, float value) {
  uint32_t bits;
  memcpy(&bits, &value, 4);
  put(b, bits, 4, 0);
}

enum { DESCRIPTION, JACOBIAN, PHI, THETA, NDF, SIGMA, VNDF, VALUES, WAVES, FIELDS };

static double node(double from, double to, int i, int n) {
  return n == 1 ? from : from + (to - from) * i / (n - 1);
}

static float phi_node(const rgl_case *c, int i) {
  return (float)node(c->phi0, c->phi1, i, c->phis);
}
static float theta_node(const rgl_case *c, int i) {
  return (float)node(0.1, 1.4, i, c->thetas);
}

static void write_case(const rgl_case *c, bytes *b) {
  const unsigned bands = c->bands ? (unsigned)c->bands : 3;
  const unsigned np = (unsigned)c->phis, nt = (unsigned)c->thetas;
  const struct {
    const char *name;
    unsigned type, rank, shape[5];
  } fields[FIELDS] = {{"description", 1, 1, {4}},
                      {"jacobian", 1, 1, {1}},
                      {"phi_i", 10, 1, {np}},
                      {"theta_i", 10, 1, {nt}},
                      {"ndf", 10, 2, {NDF_ROWS, NDF_COLUMNS}},
                      {"sigma", 10, 2, {SIGMA_ROWS, SIGMA_COLUMNS}},
                      {"vndf", 10, 4, {np, nt, VROWS, VCOLUMNS}},
                      {c->bands ? "spectra" : "rgb", 10, 5, {np, nt, bands, SIZE, SIZE}},
                      {"wavelengths", 10, 1, {bands}}};
  const int count = c->bands ? FIELDS : WAVES;
  size_t places[FIELDS];
  b->size = 0;
  b->mark_count = 0;
  memcpy(b->data, "tensor_file", 12);
  b->size = 12;
  put(b, 1, 1, 1);
  put(b, 0, 1, 1);
  put(b, (uint64_t)count, 4, 1);
  for (int f = 0; f < count; f++) {
    put(b, strlen(fields[f].name), 2, 1);
    for (const char *p = fields[f].name; *p != '\0'; p++) put(b, (unsigned char)*p, 1, 0);
    put(b, fields[f].rank, 2, 1);
    put(b, fields[f].type, 1, 1);
    places[f] = b->size;
    put(b, 0, 8, 1);
    for (unsigned i = 0; i < fields[f].rank; i++) put(b, fields[f].shape[i], 8, 1);
  }
  for (int f = 0; f < count; f++) {
    while (b->size % 8) put(b, 0, 1, 0);
    const size_t end = b->size;
    b->size = places[f];
    put(b, end, 8, 0);
    b->size = end;
    unsigned elements = 1;
    for (unsigned i = 0; i < fields[f].rank; i++) elements *= fields[f].shape[i];
    for (unsigned i = 0; i < elements; i++) switch (f) {
      case DESCRIPTION:
        put(b, (unsigned char)"felt"[i], 1, 0);
        break;
      case JACOBIAN:
        put(b, (uint64_t)c->jacobian, 1, 0);
        break;
      case PHI:
        put_float(b, phi_node(c, (int)i));
        break;
      case THETA:
        put_float(b, theta_node(c, (int)i));
        break;
      case WAVES:
        put_float(b, 400 + 2 * (float)i);
        break;
      default:
        put_float(b, content((unsigned)f, i));
      }
    assert_true(b->size < sizeof b->data);
  }
}

/* ---- the definition ---- */

static double hat(double at, int i, int n) { /* weight of node i of n in 0 .. 1 */
  const double off = fabs(fmin(fmax(at, 0), 1) * (n - 1) - i);
  return off < 1 ? 1 - off : 0;
}

/* Weight of node i among n equidistant ones, held at both ends. */
static double slice_weight(double at, double from, double to, int i, int n) {
  return n == 1 ? 1 : hat((at - from) / (to - from), i, n);
}

static double grid(unsigned field, unsigned first, int rows, int columns, double x, double y) {
  double sum = 0;
  for (int r = 0; r < rows; r++)
    for (int k = 0; k < columns; k++)
      sum += hat(x, k, columns) * hat(y, r, rows) * content(field, first + (unsigned)(r * columns + k));
  return sum;
}

static const rgl_case *current;
static double now_phi, now_theta; /* of the first direction */

static double weight_of(int p, int t) {
  return slice_weight(now_phi, current->phi0, current->phi1, p, current->phis) *
         slice_weight(now_theta, 0.1, 1.4, t, current->thetas);
}

/* Density of visible normals over the unit square, from slices of integral 1. */
static double density(double x, double y) {
  double sum = 0;
  for (int p = 0; p < current->phis; p++)
    for (int t = 0; t < current->thetas; t++) {
      const unsigned first = (unsigned)((p * current->thetas + t) * VROWS * VCOLUMNS);
      double total = 0;
      for (int r = 0; r < VROWS; r++)
        for (int k = 0; k < VCOLUMNS; k++)
          total += (r == 0 || r == VROWS - 1 ? 0.5 : 1) * (k == 0 || k == VCOLUMNS - 1 ? 0.5 : 1) *
                   content(VNDF, first + (unsigned)(r * VCOLUMNS + k)) / ((VROWS - 1) * (VCOLUMNS - 1));
      sum += weight_of(p, t) * grid(VNDF, first, VROWS, VCOLUMNS, x, y) / total;
    }
  return sum;
}

/* Integrals from 0, by the trapezoidal rule between nodes, where the density is a straight line. */
static double along_x(double to, double y) {
  double sum = 0;
  for (int k = 0; k < VCOLUMNS - 1; k++) {
    const double a = (double)k / (VCOLUMNS - 1), b = fmin(to, (k + 1.0) / (VCOLUMNS - 1));
    if (b > a) sum += (b - a) * (density(a, y) + density(b, y)) / 2;
  }
  return sum;
}

static double along_y(double to) {
  double sum = 0;
  for (int r = 0; r < VROWS - 1; r++) {
    const double a = (double)r / (VROWS - 1), b = fmin(to, (r + 1.0) / (VROWS - 1));
    if (b > a) sum += (b - a) * (along_x(1, a) + along_x(1, b)) / 2;
  }
  return sum;
}

static double measured(unsigned band, unsigned bands, double x, double y) {
  double sum = 0;
  for (int p = 0; p < current->phis; p++)
    for (int t = 0; t < current->thetas; t++)
      sum +=
          weight_of(p, t) *
          grid(VALUES, ((unsigned)(p * current->thetas + t) * bands + band) * SIZE * SIZE, SIZE, SIZE, x, y);
  return sum;
}

static long checked, passed_over;

static void check(const double light[3], const double view[3], const float *sample) {
  double i[3], o[3], h[3], length = 0;
  memcpy(i, view, sizeof i);
  memcpy(o, light, sizeof o);
  /* The numbers are not periodic, as those of a material are: where a mirrored or wrapped azimuth could be
   * either of two the sample tells nothing. */
  if ((current->symmetry > 1 && fabs(i[1]) < 1e-4) || (current->symmetry > 2 && fabs(i[0]) < 1e-4)) {
    passed_over++;
    return;
  }
  const double half_sign = current->phi1 > 0 ? 1 : -1;
  for (int k = 0; k < 2 && current->symmetry == 2 && view[1] * half_sign < 0; k++) i[k] = -i[k], o[k] = -o[k];
  for (int k = 0; k < 2 && current->symmetry == 4; k++)
    if (view[k] > 0) i[k] = -i[k], o[k] = -o[k];
  for (int k = 0; k < 3; k++) length += (i[k] + o[k]) * (i[k] + o[k]);
  for (int k = 0; k < 3; k++) h[k] = (i[k] + o[k]) / sqrt(length);
  const double theta_h = acos(fmin(h[2], 1));
  now_theta = acos(fmin(i[2], 1));
  now_phi = atan2(i[1], i[0]);
  if (now_theta < 1e-3) now_phi = 0;
  double turn = (atan2(h[1], h[0]) - (current->phis <= 2 ? now_phi : 0)) / (2 * pi) + 0.5;
  turn -= floor(turn);
  if (theta_h < 2e-3 || turn < 1e-4 || turn > 1 - 1e-4 || fabs(now_phi) > pi - 1e-4) {
    passed_over++;
    return;
  }
  checked++;
  const double u = sqrt(theta_h * 2 / pi);
  const double x = along_x(u, turn) / along_x(1, turn), y = along_y(turn);
  const double factor =
      grid(NDF, 0, NDF_ROWS, NDF_COLUMNS, u, turn) /
      (4 * grid(SIGMA, 0, SIGMA_ROWS, SIGMA_COLUMNS, sqrt(now_theta * 2 / pi), (now_phi + pi) / (2 * pi)));
  const unsigned bands = current->bands ? (unsigned)current->bands : 3, step = bands > 64 ? 3 : 1;
  /* Directions of floats give azimuths within 1e-7 over the sine of theta_h > 2e-3, so 5e-5; the numbers vary
   * by 1 in a third of the square at most, through a warp of slope below 3 and a factor below 0.75 times
   * values below 1.5. Where theta_h is larger it is much less. Roots and arc cosines near 0 are off by 1e-8 /
   * 1e-3. */
  for (unsigned c = 0; c * step < bands; c++)
    assert_near(sample[c], measured(c * step, bands, x, y) * (current->jacobian ? factor : 1), 1e-4);
}

static bytes image;

static void test_values(void **state) {
  (void)state;
  const char *const coarse[] = {"directions", "grid:7x4", NULL};
  for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
    const char *path = test_path("material.dat");
    current = &cases[k];
    checked = passed_over = 0;
    write_case(current, &image);
    test_write_bytes(path, image.data, image.size);
    one_texel_check_all(path, "rgl", coarse, BTF_QUANTITY_BRDF_COS, check);
    if (checked < 4 * passed_over)
      fail_msg("%s: %ld passed over, %ld checked", current->label, passed_over, checked);
  }
  format_check_allocations(test_path("material.dat"), "rgl", 3);
}

static void test_description(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("notes.dat");
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  write_case(&cases[9], &image);
  test_write_bytes(path, image.data, image.size);
  assert_ok(format_try(ctx, path, "rgl", NULL, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  assert_int_equal(d.channels, 44);
  assert_string_equal(d.channel_names[1], "406");
  assert_string_equal(d.color_space, "");
  assert_string_equal(d.notes[4], "rgl_description");
  assert_string_equal(d.notes[5], "felt");
  assert_string_equal(d.notes[7], "3");
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

/* The data of the last field end the file, so that no shorter one is whole. */
static void test_truncation(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  for (size_t k = 0; k < 9; k += 2) {
    const char *path = test_path("short.dat");
    write_case(&cases[k], &image);
    test_write_bytes(path, image.data, image.size);
    for (size_t size = image.size; size-- > 0;) {
      assert_int_equal(truncate(path, (off_t)size), 0);
      format_expect_refusal(ctx, path, "rgl");
    }
  }
  test_context_done(ctx, &memory);
}

/* Every count, type and place replaced by what would overflow or be absurd. What still opens can be read. */
static void test_lies(void **state) {
  (void)state;
  static const uint64_t lies[] = {
      0, 1, 2, 7, 12, 0x7fffffff, 0x80000000, 0xffffffff, (uint64_t)1 << 62, UINT64_MAX};
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("lie.dat");
  const btf_block first = {0, 1, 0, 1, 0, 0, 1, 1};
  const btf_strides strides = {256, 256, 256, 256, 4};
  long refused = 0;
  for (size_t k = 0; k < 10; k += 4) {
    write_case(&cases[k], &image);
    for (int m = 0; m < image.mark_count; m++)
      for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        unsigned char kept[8];
        btf_dataset *ds;
        float sample[64];
        memcpy(kept, image.data + image.marks[m], 8);
        for (int b = 0; b < image.widths[m]; b++)
          image.data[image.marks[m] + (size_t)b] = (unsigned char)(lies[i] >> (8 * b));
        test_write_bytes(path, image.data, image.size);
        memcpy(image.data + image.marks[m], kept, 8);
        if (format_try(ctx, path, "rgl", NULL, &ds) != BTF_OK) {
          refused++;
          assert_null(strchr(btf_error_message(), '\n'));
          continue;
        }
        const btf_status status = btf_dataset_read(ds, &first, sample, &strides);
        assert_true(status == BTF_OK || status == BTF_E_CORRUPT);
        btf_dataset_release(ds);
      }
  }
  assert_true(refused > 500);
  test_context_done(ctx, &memory);
}

/* Overwrites the float `index` of a field, found through the file's own list of places. */
static void set_float(const rgl_case *c, int field, unsigned index, float value) {
  /* Every field has marks for the name's length, rank, type, place and each size; three marks come before. */
  static const int ranks[] = {1, 1, 1, 1, 2, 2, 4, 5, 1};
  int mark = 3;
  (void)c;
  for (int f = 0; f < field; f++) mark += 4 + ranks[f];
  const unsigned char *place = image.data + image.marks[mark + 3];
  const size_t at = (size_t)place[0] | (size_t)place[1] << 8, size = image.size;
  image.size = at + 4 * (size_t)index;
  put_float(&image, value);
  image.size = size;
}

static void test_contents(void **state) {
  (void)state;
  static const struct {
    int field;
    unsigned index;
    float value;
  } odd[] = {{PHI, 1, NAN},   {PHI, 1, -4},  {PHI, 4, INFINITY}, {THETA, 0, 2},        {THETA, 1, 0.1f},
             {THETA, 2, NAN}, {VNDF, 0, -1}, {VNDF, 7, NAN},     {VNDF, 299, INFINITY}};
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = test_path("odd.dat");
  btf_dataset *ds;
  float sample[3];
  const btf_block first = {0, 1, 0, 1, 0, 0, 1, 1};
  const btf_strides strides = {12, 12, 12, 12, 4};
  for (size_t i = 0; i < sizeof odd / sizeof *odd; i++) {
    write_case(&cases[3], &image);
    set_float(&cases[3], odd[i].field, odd[i].index, odd[i].value);
    test_write_bytes(path, image.data, image.size);
    format_expect_refusal(ctx, path, "rgl");
  }
  /* An empty distribution for one direction. */
  write_case(&cases[3], &image);
  for (unsigned i = 0; i < VROWS * VCOLUMNS; i++) set_float(&cases[3], VNDF, VROWS * VCOLUMNS * 2 + i, 0);
  test_write_bytes(path, image.data, image.size);
  format_expect_refusal(ctx, path, "rgl");
  /* A value that is not finite is named where it is read. */
  write_case(&cases[0], &image);
  for (unsigned i = 0; i < SIZE * SIZE; i++) set_float(&cases[0], VALUES, i, NAN);
  test_write_bytes(path, image.data, image.size);
  assert_ok(format_try(ctx, path, "rgl", NULL, &ds));
  assert_status(btf_dataset_read(ds, &first, sample, &strides), BTF_E_CORRUPT);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_values), cmocka_unit_test(test_description),
                                     cmocka_unit_test(test_truncation), cmocka_unit_test(test_lies),
                                     cmocka_unit_test(test_contents)};
  return btf_run("rgl", tests);
}
