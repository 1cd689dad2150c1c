/* SPDX-License-Identifier: MIT */
/* Folders of images written from samples, read back and compared with what went in. */
#include "images_case.h"
#include "../source/test_format.h"

#include <dirent.h>
#include <errno.h>
#include <sys/stat.h>
#include <unistd.h>

#include "io/io.h"

enum { WIDTH = 9, HEIGHT = 5, MOST_CHANNELS = 4 };

typedef struct writing {
  btf_context *ctx;
  test_memory memory;
  btf_dataset *ds;
  btf_dataset_desc desc;
  const char *path;  /* written */
  const char *place; /* the folder that it is in, and nothing else */
  uint32_t reads, failing_read;
  uint32_t most_lights; /* of any block asked for */
  float brightest;      /* what the values go up to */
  uint32_t warnings;
  char warning[512];
} writing;

/* ---- samples ---- */

/* 0 to 1 in 4099 steps, denser toward 0, where codes of a curve are; with `brightest` 1 the ends are in it.
 */
static float value_of(const writing *t, uint32_t view, uint32_t light, uint32_t x, uint32_t y, uint32_t c) {
  const uint32_t step =
      (view * 7919u + light * 104729u + x * 1299709u + y * 15485863u + c * 32452843u) % 4100;
  const float u = (float)step / 4099;
  return t->brightest * u * u;
}

static btf_status read_values(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  writing *t = user;
  if (++t->reads == t->failing_read) return btf_source_error(BTF_E_CORRUPT, "the source broke");
  if (b->lights > t->most_lights) t->most_lights = b->lights;
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++)
          for (uint32_t c = 0; c < t->desc.channels; c++)
            *(float *)((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y +
                       (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel) =
                value_of(t, b->view0 + v, b->light0 + l, b->x0 + x, b->y0 + y, c);
  return BTF_OK;
}

static void note_warning(void *user, int32_t level, btf_status code, const char *message) {
  writing *t = user;
  (void)code;
  if (level != BTF_LOG_WARNING) return;
  t->warnings++;
  snprintf(t->warning, sizeof t->warning, "%s", message);
}

/* The 81 directions from their angles, the last first if `reversed`. */
static btf_dirset *directions_of(btf_context *ctx, bool reversed) {
  float xyz[3 * CASE_DIRECTIONS];
  btf_dirset *set;
  for (uint32_t i = 0; i < CASE_DIRECTIONS; i++) {
    unsigned theta, phi;
    case_angles(reversed ? CASE_DIRECTIONS - 1 - i : i, &theta, &phi);
    const double degree = acos(-1) / 180, t = theta * degree, p = phi * degree;
    xyz[3 * i] = (float)(sin(t) * cos(p));
    xyz[3 * i + 1] = (float)(sin(t) * sin(p));
    xyz[3 * i + 2] = (float)cos(t);
  }
  assert_ok(btf_dirset_create(ctx, xyz, CASE_DIRECTIONS, &set));
  return set;
}

/* Views come in reverse order, which the names have to undo. */
static void begin(writing *t, uint32_t channels, uint32_t quantity) {
  *t = (writing){.desc = BTF_DATASET_DESC_INIT, .brightest = 1};
  const btf_allocator allocator = test_allocator(&t->memory);
  btf_context_desc context = BTF_CONTEXT_DESC_INIT;
  context.allocator = &allocator;
  context.log = note_warning;
  context.log_user = t;
  context.max_threads = 2;
  assert_ok(btf_context_create(&context, &t->ctx));
  assert_ok(btf_formats_register(t->ctx));
  t->place = test_path("place");
  t->path = test_path("place/written");
  (void)mkdir(t->place, 0700);
  btf_dirset *lights = directions_of(t->ctx, false), *views = directions_of(t->ctx, true);
  t->desc.lights = lights;
  t->desc.views = views;
  t->desc.width = WIDTH;
  t->desc.height = HEIGHT;
  t->desc.channels = channels;
  t->desc.quantity = quantity;
  t->desc.read = read_values;
  t->desc.user = t;
  assert_ok(btf_dataset_create(t->ctx, &t->desc, &t->ds));
  btf_dirset_release(lights);
  btf_dirset_release(views);
}

static void remove_folder(const char *path) {
  char file[1024];
  DIR *folder = opendir(path);
  if (folder == NULL) return;
  for (struct dirent *entry; (entry = readdir(folder)) != NULL;) {
    snprintf(file, sizeof file, "%s/%s", path, entry->d_name);
    if (entry->d_name[0] != '.') unlink(file);
  }
  closedir(folder);
  rmdir(path);
}

static void end(writing *t) {
  btf_dataset_release(t->ds);
  remove_folder(t->path);
  assert_int_equal(test_count_entries(t->place), 0);
  test_context_done(t->ctx, &t->memory);
}

/* `settings` is name, value, ..., NULL. */
static btf_status write_as(const writing *t, const btf_dataset *ds, const char *path,
                           const char *const *settings, const btf_job *job) {
  const btf_format *format = btf_format_find(t->ctx, "bonn-images");
  btf_options *options;
  btf_status status = btf_format_write_options_create(format, &options);
  for (size_t i = 0; status == BTF_OK && settings[i] != NULL; i += 2)
    status = btf_options_set(options, settings[i], settings[i + 1]);
  if (status == BTF_OK) status = btf_format_write(t->ctx, path, format, options, ds, job);
  btf_options_release(options);
  return status;
}

static btf_status write_with(const writing *t, const char *const *settings, const btf_job *job) {
  return write_as(t, t->ds, t->path, settings, job);
}

static const char *const defaults[] = {NULL};

/* ---- precision ---- */

typedef struct kind_case {
  const char *label, *kind, *transfer;
  uint32_t channels, quantity;
  double most; /* code; 0: Radiance */
} kind_case;
static const kind_case kinds[] = {
    {"8 bits, sRGB", "png8", "srgb", 3, BTF_QUANTITY_BRDF_COS, 255},
    {"8 bits, linear, grey", "png8", "linear", 1, BTF_QUANTITY_BRDF_COS, 255},
    {"16 bits, sRGB, no cosine yet", "png16", "srgb", 3, BTF_QUANTITY_BRDF, 65535},
    {"16 bits, linear", "png16", "linear", 3, BTF_QUANTITY_BRDF_COS, 65535},
    {"16 bits, sRGB, grey", "png16", "srgb", 1, BTF_QUANTITY_BRDF_COS, 65535},
    {"Radiance", "hdr", "linear", 3, BTF_QUANTITY_BRDF_COS, 0},
    {"Radiance, no cosine yet", "hdr", "linear", 3, BTF_QUANTITY_BRDF, 0},
};

/* The code, without rounding, that stands for a value: where the curve of IEC 61966-2-1 meets it. */
static double code_of(const kind_case *k, double value) {
  if (strcmp(k->transfer, "linear") == 0) return k->most * value;
  return k->most * (value <= 0.04045 / 12.92 ? 12.92 * value : 1.055 * pow(value, 1 / 2.4) - 0.055);
}

/* PNG: half a code between the nearest and the value's. Beyond that: what is read, the cosine and its product
 * are rounded to floats, 3 * 2^-24 of a value, which is no more of the whole scale in codes (E'(v) v <= 1 for
 * both curves), 0.012 codes of 16 bits; and between the two constants in use for where the pieces of the sRGB
 * curve meet, these are 0.002 codes of 16 bits apart. 0.014 < 0.015. Radiance: half of 2^-8 of the power of
 * two above the largest channel, besides the cosine's roundings. */
static void check_pixel(const kind_case *k, const double *in, const float *out) {
  double most = 0;
  int exponent;
  for (uint32_t c = 0; c < k->channels; c++) most = fmax(most, in[c]);
  frexp(most * (1 + 0x1p-22), &exponent);
  for (uint32_t c = 0; c < k->channels; c++) {
    const double off = k->most > 0 ? fabs(code_of(k, in[c]) - code_of(k, (double)out[c]))
                                   : fabs(in[c] - (double)out[c]) / ldexp(1, exponent - 8);
    if (!(off <= 0.5 + 0.015))
      fail_msg("%s: %.9g became %.9g, %.3g codes off", k->label, in[c], (double)out[c], off);
  }
}

static void check_view(const writing *t, const kind_case *k, const btf_dataset *again, uint32_t view) {
  static float samples[CASE_DIRECTIONS * HEIGHT * WIDTH * MOST_CHANNELS];
  const ptrdiff_t c = sizeof(float), x = c * (ptrdiff_t)k->channels, y = x * WIDTH, light = y * HEIGHT;
  const btf_strides strides = {light * CASE_DIRECTIONS, light, y, x, c};
  const btf_block block = {view, 1, 0, CASE_DIRECTIONS, 0, 0, WIDTH, HEIGHT};
  const float *out = samples;
  assert_ok(btf_dataset_read(again, &block, samples, &strides));
  for (uint32_t l = 0; l < CASE_DIRECTIONS; l++) {
    unsigned theta, phi;
    case_angles(l, &theta, &phi);
    const double cosine = k->quantity == BTF_QUANTITY_BRDF ? cos(theta * acos(-1) / 180) : 1;
    for (uint32_t row = 0; row < HEIGHT; row++)
      for (uint32_t column = 0; column < WIDTH; column++, out += k->channels) {
        double in[MOST_CHANNELS];
        for (uint32_t ch = 0; ch < k->channels; ch++)
          in[ch] = cosine * (double)value_of(t, CASE_DIRECTIONS - 1 - view, l, column, row, ch);
        check_pixel(k, in, out);
      }
  }
}

static void check_kind(const kind_case *k) {
  writing t;
  const char *const settings[] = {"kind", k->kind, "transfer", k->transfer, NULL};
  const char *const reading[] = {"type", "f32", "transfer", k->transfer, NULL};
  btf_dataset *again;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  const btf_format *format;
  begin(&t, k->channels, k->quantity);
  if (k->most == 0) t.brightest = 3000;
  assert_ok(write_with(&t, settings, NULL));
  assert_int_equal(t.warnings, 0);
  assert_int_equal(test_count_entries(t.path), CASE_PAIRS);
  assert_ok(btf_format_detect(t.ctx, t.path, &format));
  assert_string_equal(btf_format_id(format), "bonn-images");
  assert_ok(format_try(t.ctx, t.path, "bonn-images", reading, &again));
  assert_int_equal(t.warnings, 0); /* counters fit */
  assert_ok(btf_dataset_describe(again, &d));
  assert_int_equal(d.width, WIDTH);
  assert_int_equal(d.height, HEIGHT);
  assert_int_equal(d.channels, k->channels);
  assert_int_equal(d.quantity, BTF_QUANTITY_BRDF_COS);
  for (uint32_t view = 0; view < CASE_DIRECTIONS; view++) check_view(&t, k, again, view);
  btf_dataset_release(again);
  end(&t);
}

static void test_kinds(void **state) {
  (void)state;
  for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) check_kind(&kinds[i]);
}

/* What was read comes out again as the same files, and in the place of those. */
static void test_again(void **state) {
  (void)state;
  writing t;
  btf_dataset *again;
  static const char *const name = "/06560 tl075 pl345 tv075 pv345.png",
                           *const first = "/00001 tl000 pl000 tv015 pv000.png";
  const char *const hdr[] = {"kind", "hdr", NULL};
  const char *files[] = {name, first};
  begin(&t, 3, BTF_QUANTITY_BRDF_COS);
  assert_ok(write_with(&t, defaults, NULL));
  assert_ok(btf_format_open(t.ctx, t.path, NULL, NULL, &again));
  unsigned char *before[2];
  size_t sizes[2];
  for (int i = 0; i < 2; i++) {
    char file[512];
    snprintf(file, sizeof file, "%s%s", t.path, files[i]);
    before[i] = test_read_bytes(file, &sizes[i]);
  }
  assert_ok(write_as(&t, again, t.path, defaults, NULL)); /* over what it reads */
  for (int i = 0; i < 2; i++) {
    char file[512];
    size_t size;
    snprintf(file, sizeof file, "%s%s", t.path, files[i]);
    unsigned char *after = test_read_bytes(file, &size);
    assert_int_equal(size, sizes[i]);
    assert_memory_equal(after, before[i], size);
    free(after);
    free(before[i]);
  }
  btf_dataset_release(again);
  assert_ok(write_with(&t, hdr, NULL));
  assert_int_equal(test_count_entries(t.path), CASE_PAIRS); /* no PNG is left */
  assert_int_equal(test_count_entries(t.place), 1);
  end(&t);
}

/* ---- other directions ---- */

/* Nearest point of a segment to p, as weights of its ends; returns the squared distance. */
static double nearest_of_edge(const double p[2], const double a[2], const double b[2], double *to_b) {
  const double e[2] = {b[0] - a[0], b[1] - a[1]};
  *to_b = fmin(1, fmax(0, ((p[0] - a[0]) * e[0] + (p[1] - a[1]) * e[1]) / (e[0] * e[0] + e[1] * e[1])));
  const double x = a[0] + *to_b * e[0] - p[0], y = a[1] + *to_b * e[1] - p[1];
  return x * x + y * y;
}

static void to_plane(const double d[3], double p[2]) {
  for (int k = 0; k < 2; k++) p[k] = d[k] / (1 + d[2]);
}

/* Weights of a set's samples around direction i of the 81: barycentric in the triangle that holds it in
 * parabolic coordinates or, outside of all, those of the nearest point of any edge. */
static bool plain_weights(const btf_dirset *set, uint32_t i, uint32_t index[3], double weight[3]) {
  uint32_t triangles;
  unsigned theta, phi;
  const uint32_t *corner = btf_dirset_triangles(set, &triangles);
  case_angles(i, &theta, &phi);
  const double degree = acos(-1) / 180, t = theta * degree, f = phi * degree;
  double p[2], nearest = INFINITY;
  to_plane((const double[3]){sin(t) * cos(f), sin(t) * sin(f), cos(t)}, p);
  for (uint32_t n = 0; n < triangles; n++, corner += 3) {
    double at[3][2], area = 0, w[3];
    for (int k = 0; k < 3; k++) {
      const float *d = btf_dirset_directions(set) + 3 * (size_t)corner[k];
      to_plane((const double[3]){d[0], d[1], d[2]}, at[k]);
    }
    for (int k = 0; k < 3; k++) {
      const double *a = at[(k + 1) % 3], *b = at[(k + 2) % 3];
      double to_b;
      w[k] = (a[0] - p[0]) * (b[1] - p[1]) - (a[1] - p[1]) * (b[0] - p[0]);
      area += w[k];
      const double distance = nearest_of_edge(p, a, b, &to_b);
      if (distance >= nearest) continue;
      nearest = distance;
      memcpy(index, corner, 3 * sizeof *index);
      weight[k] = 0;
      weight[(k + 1) % 3] = 1 - to_b;
      weight[(k + 2) % 3] = to_b;
    }
    if (w[0] < 0 || w[1] < 0 || w[2] < 0) continue;
    memcpy(index, corner, 3 * sizeof *index);
    for (int k = 0; k < 3; k++) weight[k] = w[k] / area;
    return true;
  }
  return false;
}

static double blend_of(const writing *t, uint32_t view, uint32_t light, uint32_t x, uint32_t y, uint32_t c,
                       size_t *clamped) {
  uint32_t v[3], l[3];
  double view_weight[3], light_weight[3], sum = 0;
  const bool views_inside = plain_weights(t->desc.views, view, v, view_weight);
  const bool lights_inside = plain_weights(t->desc.lights, light, l, light_weight);
  *clamped += !views_inside || !lights_inside;
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++)
      sum += view_weight[i] * light_weight[k] * (double)value_of(t, v[i], l[k], x, y, c);
  return sum;
}

/* Codes are linear of 16 bits: half a code, 0.015 as of check_pixel, and what weights in float are off by,
 * some 3e-6 for points rounded to 2^-24 in triangles of height 0.07 and more, of lights and of views, times
 * values up to 1: 6e-6 * 65535 = 0.4 codes. */
static void check_blends(const writing *t, const btf_dataset *again, size_t *clamped) {
  const btf_strides strides = {0, 0, WIDTH * 4, 4, 4};
  for (uint32_t view = 0; view < CASE_DIRECTIONS; view += 5)
    for (uint32_t light = 0; light < CASE_DIRECTIONS; light++) {
      float got[HEIGHT * WIDTH];
      unsigned theta, phi;
      const btf_block block = {view, 1, light, 1, 0, 0, WIDTH, HEIGHT};
      assert_ok(btf_dataset_read(again, &block, got, &strides));
      case_angles(light, &theta, &phi);
      const double cosine = t->desc.quantity == BTF_QUANTITY_BRDF ? cos(theta * acos(-1) / 180) : 1;
      for (uint32_t i = 0; i < HEIGHT * WIDTH; i += 11) {
        const double expected = cosine * blend_of(t, view, light, i % WIDTH, i / WIDTH, 0, clamped);
        const double off = 65535 * fabs(expected - (double)got[i]);
        if (!(off <= 0.5 + 0.015 + 0.4))
          fail_msg("view %u, light %u, texel %u: %.9g instead of %.9g", view, light, i, (double)got[i],
                   expected);
      }
    }
}

static void check_resampled(const char *lights, const char *views, uint32_t quantity, bool clamps) {
  const char *const settings[] = {"kind", "png16", "transfer", "linear", NULL};
  const char *const reading[] = {"type", "f32", "transfer", "linear", NULL};
  writing t;
  btf_dirset *light_set, *view_set;
  btf_dataset *again;
  btf_job job = BTF_JOB_INIT;
  size_t clamped = 0;
  begin(&t, 1, quantity);
  btf_dataset_release(t.ds);
  assert_ok(btf_dirset_create_named(t.ctx, lights, &light_set));
  assert_ok(btf_dirset_create_named(t.ctx, views, &view_set));
  t.desc.lights = light_set;
  t.desc.views = view_set;
  assert_ok(btf_dataset_create(t.ctx, &t.desc, &t.ds));
  assert_ok(write_with(&t, settings, NULL));
  assert_int_equal(t.warnings, 1);
  assert_true(strstr(t.warning, "degrees away") != NULL);
  assert_true(t.reads <= 3 * CASE_DIRECTIONS * btf_dirset_count(light_set));
  for (int small = 0; small < 2; small++) {
    assert_ok(format_try(t.ctx, t.path, "bonn-images", reading, &again));
    check_blends(&t, again, &clamped);
    btf_dataset_release(again);
    job.max_working_set = (1u << 20) + 8192; /* as in test_budget: a picture or a few */
    if (!small) assert_ok(write_with(&t, settings, &job));
  }
  assert_true((clamped > 0) == clamps);
  btf_dirset_release(light_set);
  btf_dirset_release(view_set);
  end(&t);
}

static void test_resampling(void **state) {
  (void)state;
  check_resampled("ubo151", "grid:7x4", BTF_QUANTITY_BRDF, true);
  check_resampled("ubo81", "grid:5x3", BTF_QUANTITY_BRDF_COS, true);
}

/* ---- clipping ---- */

static void test_clipping(void **state) {
  (void)state;
  writing t;
  char expected[64];
  uint64_t above = 0, below = 0;
  const char *const png16[] = {"kind", "png16", NULL}, *const hdr[] = {"kind", "hdr", NULL};
  begin(&t, 3, BTF_QUANTITY_BRDF_COS);
  for (int sign = 1; sign >= -1; sign -= 2) {
    t.brightest = 1.25F * (float)sign;
    above = below = 0;
    for (uint32_t v = 0; v < CASE_DIRECTIONS; v++)
      for (uint32_t l = 0; l < CASE_DIRECTIONS; l++)
        for (uint32_t y = 0; y < HEIGHT; y++)
          for (uint32_t x = 0; x < WIDTH; x++)
            for (uint32_t c = 0; c < 3; c++) {
              const float value = value_of(&t, v, l, x, y, c);
              above += value > 1;
              below += value < 0;
            }
    assert_true(above + below > 1000);
    t.warnings = 0;
    assert_ok(write_with(&t, png16, NULL));
    assert_int_equal(t.warnings, 1);
    snprintf(expected, sizeof expected, " %llu of %llu samples", (unsigned long long)(above + below),
             (unsigned long long)CASE_PAIRS * HEIGHT * WIDTH * 3);
    if (strstr(t.warning, expected) == NULL) fail_msg("\"%s\" lacks \"%s\"", t.warning, expected);
  }
  t.warnings = 0;
  assert_ok(write_with(&t, hdr, NULL)); /* negative ones */
  assert_int_equal(t.warnings, 1);
  assert_true(strstr(t.warning, expected) != NULL);
  t.brightest = 1.25F;
  t.warnings = 0;
  assert_ok(write_with(&t, hdr, NULL));
  assert_int_equal(t.warnings, 0);
  end(&t);
}

/* ---- memory ---- */

static void test_budget(void **state) {
  (void)state;
  writing t;
  btf_job job = BTF_JOB_INIT;
  begin(&t, 3, BTF_QUANTITY_BRDF_COS);
  assert_ok(write_with(&t, defaults, NULL));
  assert_int_equal(t.most_lights, CASE_DIRECTIONS);
  assert_int_equal(t.reads, CASE_DIRECTIONS);
  /* Half a MiB for the library in each of two threads; below 8 KiB each: samples and file. */
  job.max_working_set = (1u << 20) + 8192;
  t.most_lights = 0;
  t.reads = 0;
  assert_ok(write_with(&t, defaults, &job));
  assert_int_equal(t.most_lights, 1);
  assert_int_equal(t.reads, CASE_PAIRS);
  job.max_working_set = 1u << 20;
  assert_status(write_with(&t, defaults, &job), BTF_E_LIMIT);
  assert_message_has("would do");
  assert_int_equal(test_count_entries(t.path), CASE_PAIRS);
  end(&t);
}

/* ---- what is refused ---- */

static void expect_refusal(uint32_t channels, const char *const *settings, btf_status expected,
                           const char *words) {
  writing t;
  begin(&t, channels, BTF_QUANTITY_BRDF_COS);
  assert_status(write_with(&t, settings, NULL), expected);
  assert_message_has(words);
  assert_int_equal(t.reads, 0);
  assert_int_equal(test_count_entries(t.place), 0);
  end(&t);
}

static void test_refusals(void **state) {
  (void)state;
  const char *const hdr[] = {"kind", "hdr", NULL}, *const curved[] = {"kind", "hdr", "transfer", "srgb",
                                                                      NULL};
  writing t;
  expect_refusal(4, defaults, BTF_E_UNSUPPORTED, "4 channels");
  expect_refusal(1, hdr, BTF_E_UNSUPPORTED, "1 channels");
  expect_refusal(3, curved, BTF_E_INVALID_ARG, "linear");
  begin(&t, 3, BTF_QUANTITY_BRDF_COS);
  t.brightest = INFINITY;
  assert_status(write_with(&t, defaults, NULL), BTF_E_CORRUPT);
  assert_int_equal(test_count_entries(t.place), 0);
  assert_status(write_as(&t, t.ds, test_path("none/x"), defaults, NULL), BTF_E_IO);
  end(&t);
}

/* Neither a file, an empty folder nor one with anything else in it is replaced. */
static void test_places(void **state) {
  (void)state;
  writing t;
  char own[512], other[512];
  begin(&t, 1, BTF_QUANTITY_BRDF_COS);
  test_write_bytes(t.path, "x", 1);
  assert_status(write_with(&t, defaults, NULL), BTF_E_IO);
  unlink(t.path);
  assert_int_equal(mkdir(t.path, 0700), 0);
  assert_status(write_with(&t, defaults, NULL), BTF_E_IO);
  snprintf(own, sizeof own, "%s/00000 tl000 pl000 tv000 pv000.png", t.path);
  snprintf(other, sizeof other, "%s/00001 tl000 pl000 tv000 pv000.png",
           t.path); /* a counter that is not ours */
  test_write_bytes(own, "x", 1);
  test_write_bytes(other, "x", 1);
  assert_status(write_with(&t, defaults, NULL), BTF_E_IO);
  assert_message_has("not replaced");
  assert_true(test_exists(own) && test_exists(other));
  assert_int_equal(t.reads, 0);
  assert_int_equal(test_count_entries(t.place), 1);
  unlink(other);
  assert_ok(write_with(&t, defaults, NULL));
  assert_int_equal(test_count_entries(t.path), CASE_PAIRS);
  end(&t);
}

/* ---- failures ---- */

static long calls, failing_call;

static int fail_call(const char *call) {
  (void)call;
  return ++calls == failing_call ? ENOSPC : 0;
}

static btf_status write_failing(const writing *t, long at) {
  calls = 0;
  failing_call = at;
  btfi_io_fault = fail_call;
  const btf_status status = write_with(t, defaults, NULL);
  btfi_io_fault = NULL;
  return status;
}

/* The first calls and the last one by one, and a few of the thousands alike between them. */
static long next_fault(long at, long all) {
  return at < 9 || at + 5 > all ? at + 1 : at + all / 3 < all - 4 ? at + all / 3 : all - 4;
}

static void test_failing_calls(void **state) {
  (void)state;
  writing t;
  begin(&t, 1, BTF_QUANTITY_BRDF_COS);
  for (int there = 0; there < 2; there++) {
    const size_t left = there ? 1 : 0;
    assert_ok(write_failing(&t, 0));
    const long all = calls;
    assert_true(all > 3 * CASE_PAIRS);
    if (!there) remove_folder(t.path);
    for (long at = 1; at <= all; at = next_fault(at, all)) {
      assert_status(write_failing(&t, at), BTF_E_IO);
      assert_int_equal(test_count_entries(t.place), left);
      if (there) assert_int_equal(test_count_entries(t.path), CASE_PAIRS);
    }
    assert_ok(write_failing(&t, 0));
  }
  end(&t);
}

static int32_t cancel(void *user, double fraction, const char *stage) {
  (void)user, (void)stage;
  return fraction > 0;
}

static void test_failures(void **state) {
  (void)state;
  writing t;
  btf_job job = BTF_JOB_INIT;
  begin(&t, 1, BTF_QUANTITY_BRDF_COS);
  job.progress = cancel;
  assert_status(write_with(&t, defaults, &job), BTF_E_CANCELLED);
  assert_int_equal(test_count_entries(t.place), 0);
  t.failing_read = t.reads + 60;
  assert_status(write_with(&t, defaults, NULL), BTF_E_CORRUPT);
  assert_message_has("the source broke");
  assert_int_equal(test_count_entries(t.place), 0);
  t.failing_read = 0;
  long before = t.memory.total_allocations;
  assert_ok(write_with(&t, defaults, NULL));
  const long all = t.memory.total_allocations - before;
  remove_folder(t.path);
  assert_true(all > 2 * CASE_PAIRS); /* those of libpng are among them */
  /* Threads take turns, so the last few may come in another order, but not in another number. */
  for (long at = 1; at <= all; at = at < 40 ? at + 1 : at + all / 4) {
    t.memory.fail_at = t.memory.total_allocations + at;
    assert_status(write_with(&t, defaults, NULL), BTF_E_NOMEM);
    assert_int_equal(test_count_entries(t.place), 0);
  }
  t.memory.fail_at = 0;
  end(&t);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_kinds),         cmocka_unit_test(test_again),
      cmocka_unit_test(test_clipping),      cmocka_unit_test(test_budget),
      cmocka_unit_test(test_refusals),      cmocka_unit_test(test_places),
      cmocka_unit_test(test_failing_calls), cmocka_unit_test(test_failures),
      cmocka_unit_test(test_resampling),
  };
  /* Removing thousands of files that were synchronised takes minutes on some disks. */
  if (access("/dev/shm", W_OK | X_OK) == 0) (void)setenv("TMPDIR", "/dev/shm", 0);
  return btf_run("bonn_images_write", tests);
}
