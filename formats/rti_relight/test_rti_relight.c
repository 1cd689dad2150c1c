/* SPDX-License-Identifier: MIT */
/* relight's folders of every kind, written from the description, against the formulas; and damaged ones. */
#include "../source/test_one_view.h"
#include "../source/test_picture.h"

#include <sys/stat.h>
#include <unistd.h>

enum { WIDTH = 19, HEIGHT = 11, LIGHTS = 7, GRID = 4, MOST_PLANES = 27 };

typedef enum type { PTM, HSH, RBF, BILINEAR } type;
typedef enum colour { RGB, LRGB, MRGB, MYCC } colour;
typedef struct relight_case {
  const char *label;
  type type;
  colour colour;
  int planes, y, chroma;
  int basis_file; /* materials.bin instead of a list */
} relight_case;

static const relight_case cases[] = {
    {"ptm rgb", PTM, RGB, 18, 0, 0, 0},
    {"ptm lrgb", PTM, LRGB, 9, 0, 0, 0},
    {"hsh rgb", HSH, RGB, 27, 0, 0, 0},
    {"hsh lrgb", HSH, LRGB, 12, 0, 0, 0},
    {"rbf mrgb", RBF, MRGB, 6, 0, 0, 0},
    {"rbf mycc", RBF, MYCC, 12, 6, 3, 1},
    {"bilinear mrgb", BILINEAR, MRGB, 5, 0, 0, 1},
    {"bilinear mycc", BILINEAR, MYCC, 7, 3, 2, 0},
};
enum { CASES = sizeof cases / sizeof *cases };

/* ---- contents ---- */

/* Of a plane, by squares of 8 x 8; row 0 is the top one. */
static unsigned char plane_code(int plane, int column, int row) {
  return (unsigned char)(13 + 37 * plane + 59 * column + 101 * row);
}
static double scale_of(int plane) {
  return 0.5 + 0.25 * (plane % 4);
}
static double bias_of(int plane) {
  return 0.0625 * (plane % 7);
}
static double range_of(int plane) {
  return 300 + 25 * plane;
}
static const double sigma = 0.5;
static const double lights[LIGHTS][3] = {{0, 0, 1},          {0.6, 0, 0.8},      {0, 0.6, 0.8},
                                         {-0.48, 0.36, 0.8}, {0.28, -0.96, 0.1}, {-0.8, -0.6, 0},
                                         {0.8, 0.48, 0.36}};
static int sample_count(const relight_case *c) {
  return c->type == RBF ? LIGHTS : GRID * GRID;
}
static unsigned char basis_code(int plane, int sample, int k) {
  return (unsigned char)(plane == 0 ? 30 + 11 * sample + 17 * k : 5 + 83 * plane + 47 * sample + 29 * k);
}

/* ---- the folder ---- */

typedef struct setting {
  const char *name;
  char value[8192];
} setting;
enum { SETTINGS = 11 };

static void put_list(char *out, size_t room, int count, double (*number)(int)) {
  size_t used = (size_t)snprintf(out, room, "[");
  for (int i = 0; i < count; i++)
    used += (size_t)snprintf(out + used, room - used, "%s%.9g", i > 0 ? "," : "", number(i));
  snprintf(out + used, room - used, "]");
}

static double light_number(int i) {
  return lights[i / 3][i % 3];
}

static const relight_case *basis_case;
static double basis_number(int i) {
  const int samples = sample_count(basis_case);
  return basis_code(i / 3 / samples, i / 3 % samples, i % 3);
}

static void describe(const relight_case *c, setting s[SETTINGS]) {
  static const char *const types[] = {"\"ptm\"", "\"hsh\"", "\"rbf\"", "\"bilinear\""};
  static const char *const colours[] = {"\"rgb\"", "\"lrgb\"", "\"mrgb\"", "\"mycc\""};
  static const char *const names[SETTINGS] = {"width",      "height",    "format", "type",
                                              "colorspace", "sigma",     "lights", "resolution",
                                              "planes",     "materials", "basis"};
  char scale[1024], bias[1024], range[1024];
  for (int i = 0; i < SETTINGS; i++) s[i].name = names[i];
  put_list(scale, sizeof scale, c->planes, scale_of);
  put_list(bias, sizeof bias, c->planes, bias_of);
  put_list(range, sizeof range, c->planes, range_of);
  snprintf(s[0].value, sizeof s->value, "%d", WIDTH);
  snprintf(s[1].value, sizeof s->value, "%d", HEIGHT);
  snprintf(s[2].value, sizeof s->value, "\"jpg\"");
  snprintf(s[3].value, sizeof s->value, "%s", types[c->type]);
  snprintf(s[4].value, sizeof s->value, "%s", colours[c->colour]);
  snprintf(s[5].value, sizeof s->value, "%.9g", sigma);
  put_list(s[6].value, sizeof s->value, 3 * LIGHTS, light_number);
  snprintf(s[7].value, sizeof s->value, "%d", GRID);
  s[8].name = c->colour == MYCC ? "yccplanes" : "nplanes";
  if (c->colour == MYCC)
    snprintf(s[8].value, sizeof s->value, "[%d, %d, %d]", c->y, c->chroma, c->chroma);
  else
    snprintf(s[8].value, sizeof s->value, "%d", c->planes);
  snprintf(s[9].value, sizeof s->value, "[{\"scale\":%s,\"bias\":%s,\"range\":%s}]", scale, bias, range);
  basis_case = c;
  s[10].value[0] = '\0';
  if (c->type >= RBF && !c->basis_file)
    put_list(s[10].value, sizeof s->value, (c->planes + 1) * sample_count(c) * 3, basis_number);
}

static const char *file_in(const char *folder, const char *name) {
  static char path[4096];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  return path;
}

/* Settings without a value are left out. */
static size_t write_info(const char *folder, const setting s[SETTINGS], char text[32768]) {
  size_t used = 0;
  for (int i = 0; i < SETTINGS; i++)
    if (s[i].value[0] != '\0')
      used += (size_t)snprintf(text + used, 32768 - used, "%s\"%s\": %s", used == 0 ? "{\n" : ",\n",
                               s[i].name, s[i].value);
  used += (size_t)snprintf(text + used, 32768 - used, "}");
  test_write_bytes(file_in(folder, "info.json"), text, used);
  return used;
}

static unsigned char picture_code(const void *user, int column, int row, int channel) {
  return plane_code(3 * *(const int *)user + channel, column, row);
}

static void write_plane(const char *folder, int index, int width, int height, int channels) {
  char name[32];
  size_t size;
  unsigned char *data = test_squares_jpeg(width, height, channels, picture_code, &index, &size);
  snprintf(name, sizeof name, "plane_%d.jpg", index);
  test_write_bytes(file_in(folder, name), data, size);
  free(data);
}

static const char *write_case(const relight_case *c, const char *name) {
  static char text[32768];
  static setting settings[SETTINGS];
  const char *folder = test_path(name);
  unsigned char basis[MOST_PLANES * 64 * 3];
  (void)mkdir(folder, 0777);
  describe(c, settings);
  write_info(folder, settings, text);
  for (int i = 0; i < (c->planes + 2) / 3; i++) write_plane(folder, i, WIDTH, HEIGHT, 3);
  const int size = (c->planes + 1) * sample_count(c) * 3;
  for (int i = 0; i < size; i++) basis[i] = (unsigned char)basis_number(i);
  if (c->basis_file) test_write_bytes(file_in(folder, "materials.bin"), basis, (size_t)size);
  return folder;
}

/* ---- the formulas, on the scale 0 to 255 ---- */

static double value_of(int plane, int x, int y) {
  const double byte = plane_code(plane, x / 8, (HEIGHT - 1 - y) / 8);
  return 255 * (byte / 255 - bias_of(plane)) * scale_of(plane);
}

static double formula(const relight_case *c, const double light[3], int x, int y, int channel) {
  const double lx = light[0], ly = light[1];
  double terms[16] = {1, lx, ly, lx * lx, lx * ly, ly * ly}, sum = 0;
  if (c->type == HSH) one_view_harmonics(light, terms);
  if (c->colour == RGB) {
    for (int p = channel; p < c->planes; p += 3) sum += terms[p / 3] * value_of(p, x, y);
    return sum;
  }
  for (int p = 3; p < c->planes; p++) sum += terms[p - 3] * value_of(p, x, y);
  return plane_code(channel, x / 8, (HEIGHT - 1 - y) / 8) * sum / 255;
}

static void sample_weights(const relight_case *c, const double light[3], double *w) {
  const int count = sample_count(c);
  double sum = 0, kept = 0;
  if (c->type == BILINEAR) {
    const double length = fabs(light[0]) + fabs(light[1]) + fabs(light[2]);
    const double x = ((light[0] + light[1]) / length + 1) / 2 * (GRID - 1);
    const double y = ((light[1] - light[0]) / length + 1) / 2 * (GRID - 1);
    for (int d = 0; d < count; d++)
      w[d] = fmax(0, 1 - fabs(x - d % GRID)) * fmax(0, 1 - fabs(y - d / GRID)); /* tents */
    return;
  }
  for (int d = 0; d < count; d++) {
    double square = 0;
    for (int i = 0; i < 3; i++) square += pow(light[i] - lights[d][i], 2);
    sum += w[d] = exp(-square / (sigma * sigma));
  }
  for (int d = 0; d < count; d++) {
    w[d] = w[d] / sum > 0.001 ? w[d] / sum : 0;
    kept += w[d];
  }
  for (int d = 0; d < count; d++) w[d] /= kept;
}

static double recorded(const void *user, const double light[3], int x, int y, int channel) {
  const relight_case *c = user;
  double w[64], rgb[3] = {0, 0, 0};
  if (c->type == PTM || c->type == HSH) return formula(c, light, x, y, channel) / 255;
  sample_weights(c, light, w);
  for (int d = 0; d < sample_count(c); d++)
    for (int k = 0; k < 3; k++) {
      double sum = basis_code(0, d, k);
      for (int p = 0; p < c->planes; p++)
        if (c->colour == MRGB || k == (p < 3 * c->chroma ? p % 3 : 0))
          sum += value_of(p, x, y) * (basis_code(p + 1, d, k) - 127) / range_of(p);
      rgb[k] += w[d] * sum;
    }
  if (c->colour == MYCC) {
    const double t = rgb[0] - rgb[2] / 2, green = rgb[2] + t, blue = t - rgb[1] / 2;
    rgb[0] = blue + rgb[1];
    rgb[1] = green;
    rgb[2] = blue;
  }
  return rgb[channel] / 255;
}

/* ---- tests ---- */

static void test_values(void **state) {
  (void)state;
  for (int i = 0; i < CASES; i++) {
    const char *const settings[] = {"directions", i % 2 == 0 ? "grid:9x5" : "ubo81", NULL};
    char name[32];
    snprintf(name, sizeof name, "values-%d", i);
    const char *folder = write_case(&cases[i], name);
    /* Harmonics near the zenith are as exact as half of a double's digits; the rest are sums of doubles. */
    const double tolerance = cases[i].type == HSH ? 1e-7 : 1e-12;
    one_view_check_all(folder, "rti-relight", settings, WIDTH, HEIGHT, recorded, &cases[i], tolerance);
    /* The file is as good as the folder. */
    one_view_check_all(file_in(folder, "info.json"), "rti-relight", settings, WIDTH, HEIGHT, recorded,
                       &cases[i], tolerance);
  }
}

static void test_info_cut(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *folder = write_case(&cases[5], "cut");
  struct stat about;
  assert_int_equal(stat(file_in(folder, "info.json"), &about), 0);
  for (off_t size = about.st_size; size-- > 0;) {
    assert_int_equal(truncate(file_in(folder, "info.json"), size), 0);
    format_expect_refusal(ctx, folder, "rti-relight");
  }
  assert_int_equal(unlink(file_in(folder, "info.json")), 0);
  format_expect_status(ctx, folder, "rti-relight", BTF_E_IO);
  assert_int_equal(mkdir(file_in(folder, "info.json"), 0777), 0);
  format_expect_status(ctx, folder, "rti-relight", BTF_E_IO);
  test_context_done(ctx, &memory);
}

typedef struct lie {
  int of; /* case */
  const char *name, *value;
} lie;

static void test_lies(void **state) {
  (void)state;
  static const lie lies[] = {
      {0, "width", "0"},
      {0, "width", "-19"},
      {0, "width", "19.5"},
      {0, "width", "2147483648"},
      {0, "width", "4294967295"},
      {0, "width", "4294967315"},
      {0, "width", "1e300"},
      {0, "width", "\"19\""},
      {0, "width", "NaN"},
      {0, "width", "20"},
      {0, "width", "8192"},
      {0, "width", ""},
      {0, "height", "12"},
      {0, "height", "4294967295"},
      {0, "height", "[11]"},
      {0, "format", "\"dzi\""},
      {0, "format", "1"},
      {0, "type", "\"sh\""},
      {0, "type", "\"dmd\""},
      {0, "type", "3"},
      {0, "type", ""},
      {0, "type", "\"rbf\""},
      {0, "colorspace", "\"ycc\""},
      {0, "colorspace", "\"mrgb\""},
      {0, "colorspace", ""},
      {0, "nplanes", "0"},
      {0, "nplanes", "17"},
      {0, "nplanes", "21"},
      {0, "nplanes", "15"},
      {0, "nplanes", "2147483648"},
      {0, "nplanes", "4294967295"},
      {0, "nplanes", ""},
      {0, "materials", "[]"},
      {0, "materials", "{}"},
      {0, "materials", "[{\"scale\":[1],\"bias\":[0]}]"},
      {0, "materials", "[{\"scale\":\"x\",\"bias\":[0]}]"},
      {0, "materials", ""},
      {1, "nplanes", "3"},
      {1, "nplanes", "10"},
      {2, "nplanes", "54"},
      {4, "sigma", "0"},
      {4, "sigma", "-1"},
      {4, "sigma", "1e-200"},
      {4, "sigma", ""},
      {4, "lights", "[]"},
      {4, "lights", "[0, 0]"},
      {4, "lights", "[0, 0, 1]"},
      {4, "lights", "[0, 0, 1e30]"},
      {4, "lights", "[0, 0, \"1\"]"},
      {4, "lights", "7"},
      {4, "lights", ""},
      {4, "nplanes", "7"},
      {4, "nplanes", "129"},
      {4, "basis", "[]"},
      {4, "basis", "[1, 2, 256]"},
      {4, "basis", "\"AAAA\""},
      {4, "basis", ""},
      {5, "yccplanes", "[6, 3]"},
      {5, "yccplanes", "[6, 3, 2]"},
      {5, "yccplanes", "[2, 3, 3]"},
      {5, "yccplanes", "[6, 0, 0]"},
      {5, "yccplanes", "[6.5, 3, 3]"},
      {5, "yccplanes", "[4294967295, 1, 1]"},
      {5, "yccplanes", "[2147483648, 2147483648, 2147483648]"},
      {5, "yccplanes", "12"},
      {6, "resolution", "1"},
      {6, "resolution", "5"},
      {6, "resolution", "65"},
      {6, "resolution", "65536"},
      {6, "resolution", "4294967295"},
      {6, "resolution", ""},
  };
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  static setting s[SETTINGS];
  static char text[32768];
  for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
    const char *folder = write_case(&cases[lies[i].of], "lies");
    describe(&cases[lies[i].of], s);
    int found = 0;
    for (int k = 0; k < SETTINGS; k++)
      if (strcmp(s[k].name, lies[i].name) == 0 && ++found)
        snprintf(s[k].value, sizeof s->value, "%s", lies[i].value);
    assert_int_equal(found, 1);
    write_info(folder, s, text);
    format_expect_refusal(ctx, folder, "rti-relight");
    assert_int_equal(unlink(file_in(folder, "info.json")), 0);
    (void)unlink(file_in(folder, "materials.bin"));
  }
  /* A byte of the basis that is none, a range of 0, one number too many. */
  for (int i = 0; i < 3; i++) {
    static const char *const changes[][2] = {
        {"[30,", "[256,"}, {"\"range\":[300,", "\"range\":[0,"}, {"[30,", "[30,30,"}};
    const char *folder = write_case(&cases[4], "lies");
    describe(&cases[4], s);
    const size_t size = write_info(folder, s, text);
    const char *place = strstr(text, changes[i][0]);
    assert_non_null(place);
    static char changed[33000];
    const size_t before = (size_t)(place - text), old = strlen(changes[i][0]);
    const int length = snprintf(changed, sizeof changed, "%.*s%s%.*s", (int)before, text, changes[i][1],
                                (int)(size - before - old), place + old);
    test_write_bytes(file_in(folder, "info.json"), changed, (size_t)length);
    format_expect_refusal(ctx, folder, "rti-relight");
  }
  test_context_done(ctx, &memory);
}

static void test_planes(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *folder = write_case(&cases[5], "planes");
  size_t size;
  unsigned char *whole = test_read_bytes(file_in(folder, "plane_2.jpg"), &size);
  for (size_t cut = 0; cut < size; cut++) {
    test_write_bytes(file_in(folder, "plane_2.jpg"), whole, cut);
    format_expect_refusal(ctx, folder, "rti-relight");
    assert_message_has("plane_2.jpg");
  }
  test_write_bytes(file_in(folder, "plane_2.jpg"), "\x89PNG\r\n\x1a\n____________________________", 36);
  format_expect_refusal(ctx, folder, "rti-relight");
  write_plane(folder, 2, WIDTH, HEIGHT, 1);
  format_expect_refusal(ctx, folder, "rti-relight");
  write_plane(folder, 2, WIDTH + 1, HEIGHT, 3);
  format_expect_refusal(ctx, folder, "rti-relight");
  write_plane(folder, 2, HEIGHT, WIDTH, 3);
  format_expect_refusal(ctx, folder, "rti-relight");
  write_plane(folder, 2, WIDTH, 1, 3);
  format_expect_refusal(ctx, folder, "rti-relight");
  assert_int_equal(unlink(file_in(folder, "plane_2.jpg")), 0);
  format_expect_refusal(ctx, folder, "rti-relight");
  assert_int_equal(mkdir(file_in(folder, "plane_2.jpg"), 0777), 0);
  format_expect_status(ctx, folder, "rti-relight", BTF_E_IO);
  assert_int_equal(rmdir(file_in(folder, "plane_2.jpg")), 0);
  test_write_bytes(file_in(folder, "plane_2.jpg"), whole, size);
  unsigned char *basis = test_read_bytes(file_in(folder, "materials.bin"), &size);
  for (size_t cut = 0; cut < size; cut++) {
    test_write_bytes(file_in(folder, "materials.bin"), basis, cut);
    format_expect_refusal(ctx, folder, "rti-relight");
  }
  test_write_bytes(file_in(folder, "materials.bin"), whole, size + 1);
  format_expect_refusal(ctx, folder, "rti-relight");
  assert_int_equal(unlink(file_in(folder, "materials.bin")), 0);
  format_expect_refusal(ctx, folder, "rti-relight");
  free(whole);
  free(basis);
  test_context_done(ctx, &memory);
}

static void test_allocations(void **state) {
  (void)state;
  format_check_allocations(write_case(&cases[4], "allocations-list"), "rti-relight", 10);
  format_check_allocations(write_case(&cases[5], "allocations-file"), "rti-relight", 10);
}

static void test_count(void **state) {
  (void)state;
  format_check_refusals(100);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_values),      cmocka_unit_test(test_info_cut),
                                     cmocka_unit_test(test_lies),        cmocka_unit_test(test_planes),
                                     cmocka_unit_test(test_allocations), cmocka_unit_test(test_count)};
  return btf_run("rti_relight", tests);
}
