/* SPDX-License-Identifier: MIT */
/* Zips and folders of images: every kind against what was put in, gaps, duplicates, threads, and what is
 * refused. */
#include "images_case.h"
#include "images_hostile.h"
#include "../source/test_format.h"

#include <pthread.h>
#include <sys/stat.h>

#include <btf/btf_half.h>

#include "bonn_images/bonn_images.h"

typedef struct archive_case {
  const char *label, *extension;
  case_names names;
  picture_case picture;
  bool deflated, zip64, folder;
  const char *option, *value; /* or NULL */
  const char *transfer;       /* as noted */
} archive_case;

#define PICTURE(kind, w, h, c)                                                                               \
  { kind, w, h, c, case_code }
static const archive_case cases[] = {
    {"jpeg", "jpg", CASE_UBO, PICTURE(CASE_JPEG, 7, 5, 3), false, false, false, NULL, NULL, "power 2.2"},
    {"jpeg, deflated, linear", "JPEG", CASE_WOOL, PICTURE(CASE_JPEG, 7, 5, 3), true, false, false, "transfer",
     "linear", "linear"},
    {"grey jpeg, flipped", "jpg", CASE_HOME, PICTURE(CASE_JPEG, 7, 5, 1), false, false, false, "flip", "true",
     "power 2.2"},
    {"png, zip64", "png", CASE_UTIA, PICTURE(CASE_PNG, 7, 5, 3), true, true, false, NULL, NULL, "srgb"},
    {"png in a folder", "png", CASE_UTIA, PICTURE(CASE_PNG, 7, 5, 3), false, false, true, "power", "1.8",
     "power 1.8"},
    {"grey png of 16 bits, floats", "png", CASE_SPECTRAL, PICTURE(CASE_PNG16, 7, 5, 1), true, false, false,
     "type", "f32", "srgb"},
    {"hdr by columns, turned", "hdr", CASE_UBO, PICTURE(CASE_HDR_COLUMNS, 8, 8, 3), true, false, false, NULL,
     NULL, "linear"},
    {"hdr by columns, as its header says", "hdr", CASE_UBO, PICTURE(CASE_HDR_COLUMNS, 8, 8, 3), false, false,
     false, "hdr_axes", "header", "linear"},
    {"hdr by columns, not square", "hdr", CASE_UBO, PICTURE(CASE_HDR_COLUMNS, 5, 9, 3), false, false, false,
     NULL, NULL, "linear"},
    {"hdr", "hdr", CASE_UTIA, PICTURE(CASE_HDR, 9, 5, 3), false, false, false, "type", "f32", "linear"},
    {"plain hdr, names with backslashes", "hdr", CASE_BACKSLASHES, PICTURE(CASE_HDR_PLAIN, 9, 5, 3), true,
     false, false, NULL, NULL, "linear"},
};
enum { CASES = sizeof cases / sizeof *cases };

/* ---- writing ---- */

static void make_parents(const char *path) {
  char folder[512];
  for (const char *slash = strchr(path + 1, '/'); slash != NULL; slash = strchr(slash + 1, '/')) {
    snprintf(folder, sizeof folder, "%.*s", (int)(slash - path), path);
    (void)mkdir(folder, 0700);
  }
}

/* Which pairs have no good picture, and what they have instead. */
typedef struct gap_rule {
  bool (*at)(uint32_t view, uint32_t light);
  enum { LEFT_OUT, DAMAGED, WIDER } how;
} gap_rule;

enum { OTHER_SIZE = 5, DAMAGES };
/* Each is by itself reason enough not to take a picture. */
static void damage(const archive_case *c, uint32_t way, case_bytes *picture, uint32_t *crc_lie) {
  picture_case other = c->picture;
  switch (way) {
  case 0:
    picture->size /= 2;
    return;
  case 1:
    picture->size = 0;
    return;
  case 2:
    picture->data[picture->size - 20] ^= 0x55; /* in the compressed data of a PNG */
    return;
  case 3:
    memset(picture->data, 'x', picture->size);
    return;
  case 4:
    *crc_lie = 1;
    return;
  default:
    other.width += way - OTHER_SIZE + 1;
    picture->size = 0;
    case_picture(&other, 0, 0, picture);
  }
}

/* Pairs in an order that is neither that of views nor of lights: 6561 and 1000 have no common factor. */
static const char *write_case(const archive_case *c, const char *base, const gap_rule *gap) {
  const char *path = test_path(base);
  zip_writer zip = {.count = 0};
  bool has_folder[CASE_DIRECTIONS] = {false};
  for (uint32_t i = 0; i < CASE_PAIRS; i++) {
    const uint32_t pair = i * 1000 % CASE_PAIRS, view = pair / CASE_DIRECTIONS,
                   light = pair % CASE_DIRECTIONS;
    char name[128], file[512];
    case_bytes picture = {0};
    uint32_t crc_lie = 0;
    const bool has_none = gap != NULL && (gap->at)(view, light);
    if (has_none && gap->how == LEFT_OUT) continue;
    case_picture(&c->picture, view, light, &picture);
    if (has_none) damage(c, gap->how == WIDER ? OTHER_SIZE + i % 2 : i % DAMAGES, &picture, &crc_lie);
    case_name(c->names, c->extension, view, light, name);
    if (c->folder) {
      snprintf(file, sizeof file, "%s/%s", path, name);
      if (!has_folder[view]) make_parents(file);
      has_folder[view] = true;
      test_write_bytes(file, picture.data, picture.size);
    } else {
      zip_add(&zip, &(zip_member){.name = name,
                                  .data = picture.data,
                                  .size = picture.size,
                                  .crc_lie = crc_lie,
                                  .deflated = c->deflated,
                                  .zip64 = c->zip64});
    }
    case_free(&picture);
  }
  if (!c->folder) {
    zip_add(&zip, &(zip_member){.name = "__MACOSX/._tl000 pl000 tv000 pv000.jpg", .data = "x", .size = 1});
    zip_add(&zip, &(zip_member){.name = "Thumbs.db", .data = "x", .size = 1});
    zip_end(&zip, c->zip64);
    test_write_bytes(path, zip.bytes.data, zip.bytes.size);
  }
  zip_free(&zip);
  return path;
}

/* With one option, or without if its name is NULL. */
static btf_status open_with(btf_context *ctx, const char *path, const char *option, const char *value,
                            btf_dataset **out) {
  const char *const settings[] = {option, value, NULL};
  return format_try(ctx, path, "bonn-images", settings, out);
}

/* ---- values ---- */

static double curve(const char *transfer, double code) {
  if (strcmp(transfer, "srgb") == 0) return code <= 0.04045 ? code / 12.92 : pow((code + 0.055) / 1.055, 2.4);
  if (strcmp(transfer, "linear") == 0) return code;
  return pow(code, strtod(transfer + 6, NULL));
}

/* Bounds of a sample: row 0 is the bottom one. */
static void expected(const archive_case *c, uint32_t view, uint32_t light, uint32_t x, uint32_t y,
                     uint32_t channel, double *low, double *high) {
  const picture_case *p = &c->picture;
  const bool flipped = c->option != NULL && strcmp(c->option, "flip") == 0;
  const bool floats = c->option != NULL && strcmp(c->option, "type") == 0;
  uint32_t column = x, row = flipped ? y : p->height - 1 - y;
  if (p->kind == CASE_HDR_COLUMNS && p->width == p->height && c->option == NULL) {
    /* Stored line n has column n of the picture; turned, it becomes row n from the bottom. */
    column = y;
    row = x;
  }
  const double code = p->code(view, light, column, row, channel);
  /* Steps of 1 in the 64 coefficients of each component put a pixel off by 1/2 in the mean; a step of chroma
   * counts up to 1.77 in a channel, and both conversions of colour round: 3 codes. Others have their code
   * exactly. */
  const double off = p->kind == CASE_JPEG ? 3 : 0;
  /* Of the type stored, subnormal half floats included. */
  const double rounding = floats ? ldexp(1, -23) : ldexp(1, -11), least = floats ? 0 : ldexp(1, -25);
  const double most = p->kind == CASE_PNG16 ? 65535 : 255;
  if (p->kind >= CASE_HDR) {
    *low = *high = (code + 0.5) / 256;
    return;
  }
  *low = curve(c->transfer, fmax(code - off, 0) / most) * (1 - rounding) - least;
  *high = curve(c->transfer, fmin(code + off, most) / most) * (1 + rounding) + least;
}

static void check_samples(const archive_case *c, const btf_dataset *ds, const btf_block *b) {
  const size_t count = (size_t)b->views * b->lights * b->width * b->height * c->picture.channels;
  float *samples = malloc(count * sizeof *samples);
  const ptrdiff_t light = sizeof(float), ch = light * (ptrdiff_t)b->lights,
                  view = ch * (ptrdiff_t)c->picture.channels, y = view * (ptrdiff_t)b->views,
                  x = y * (ptrdiff_t)b->height;
  const btf_strides strides = {.view = view, .light = light, .y = y, .x = x, .channel = ch};
  assert_non_null(samples);
  assert_ok(btf_dataset_read(ds, b, samples, &strides));
  size_t i = 0;
  for (uint32_t column = 0; column < b->width; column++)
    for (uint32_t r = 0; r < b->height; r++)
      for (uint32_t v = 0; v < b->views; v++)
        for (uint32_t k = 0; k < c->picture.channels; k++)
          for (uint32_t l = 0; l < b->lights; l++, i++) {
            double low, high;
            expected(c, b->view0 + v, b->light0 + l, b->x0 + column, b->y0 + r, k, &low, &high);
            if (!(samples[i] >= low && samples[i] <= high))
              fail_msg("%s: view %u light %u texel %u %u channel %u: %.9g instead of %.9g to %.9g", c->label,
                       b->view0 + v, b->light0 + l, b->x0 + column, b->y0 + r, k, (double)samples[i], low,
                       high);
          }
  free(samples);
}

static void check_directions(const btf_dirset *set) {
  assert_int_equal(btf_dirset_count(set), CASE_DIRECTIONS);
  for (uint32_t i = 0; i < CASE_DIRECTIONS; i++) {
    const float *d = btf_dirset_directions(set) + 3 * (size_t)i;
    const double degree = acos(-1) / 180;
    unsigned theta, phi;
    case_angles(i, &theta, &phi);
    assert_near(d[0], sin(theta * degree) * cos(phi * degree), 1e-6);
    assert_near(d[1], sin(theta * degree) * sin(phi * degree), 1e-6);
    assert_near(d[2], cos(theta * degree), 1e-6);
  }
}

static void test_kinds(void **state) {
  (void)state;
  for (size_t i = 0; i < CASES; i++) {
    const archive_case *c = &cases[i];
    const picture_case *p = &c->picture;
    test_memory memory;
    btf_context *ctx = format_context(&memory);
    const btf_format *format;
    btf_dataset *ds;
    btf_dataset_desc d = BTF_DATASET_DESC_INIT;
    const char *path = write_case(c, c->folder ? "pictures" : "pictures.dat", NULL);
    assert_ok(btf_format_detect(ctx, path, &format));
    assert_string_equal(btf_format_id(format), "bonn-images");
    assert_ok(open_with(ctx, path, c->option, c->value, &ds));
    assert_ok(btf_dataset_describe(ds, &d));
    assert_int_equal(d.width, p->width);
    assert_int_equal(d.height, p->height);
    assert_int_equal(d.channels, p->channels);
    assert_int_equal(d.sample_type,
                     c->option != NULL && strcmp(c->option, "type") == 0 ? BTF_SAMPLE_F32 : BTF_SAMPLE_F16);
    assert_int_equal(d.quantity, BTF_QUANTITY_BRDF_COS);
    assert_int_equal(d.scale, BTF_SCALE_RELATIVE);
    assert_string_equal(format_note(&d, "images_transfer"), c->transfer);
    assert_string_equal(format_note(&d, "images_filled"), "");
    check_directions(d.lights);
    check_directions(d.views);
    const btf_block whole = {0, 81, 0, 81, 0, 0, p->width, p->height};
    const btf_block inner = {1, 33, 40, 40, 1, 2, p->width - 2, p->height - 3};
    check_samples(c, ds, &whole);
    check_samples(c, ds, &inner);
    btf_dataset_release(ds);
    test_context_done(ctx, &memory);
  }
}

/* ---- names ---- */

static void test_names(void **state) {
  static const struct {
    const char *name;
    image_name is;
    uint32_t view, light;
  } names[] = {
      {"UBO2003/MANYFILES/tv030_pv030/00008 tl000 pl000 tv030 pv030.jpg", IMAGE_NAME_PAIR, 8, 0},
      {"WoolPKNT256_00084_tl015_pl000_tv015_pv120.jpg", IMAGE_NAME_PAIR, 3, 1},
      {"tv000_pv000/tl000_pl000_tv000_pv000.PNG", IMAGE_NAME_PAIR, 0, 0},
      {"tv045.0_pv020.0_tl015.0_pl120.0.exr", IMAGE_NAME_PAIR, 20, 3},
      {"img_tv0_pv0_tl15_pl0.jpg", IMAGE_NAME_PAIR, 0, 1},
      {"TV75PV345TL60PL342.hdr", IMAGE_NAME_PAIR, 80, 56},
      {"tl015_pl360_tv075_pv345.png", IMAGE_NAME_PAIR, 80, 1},
      {"tv000_pv000/preview.jpg", IMAGE_NAME_OTHER, 0, 0},
      {"tl000_pl000_tv000_pv000.txt", IMAGE_NAME_OTHER, 0, 0},
      {"tl000_pl000_tv000_pv000", IMAGE_NAME_OTHER, 0, 0},
      {"__MACOSX/._tl000_pl000_tv000_pv000.jpg", IMAGE_NAME_OTHER, 0, 0},
      {"tl000_pl000_tv000_pv000/", IMAGE_NAME_OTHER, 0, 0},
      {"tl000_pl000_tv000.jpg", IMAGE_NAME_BAD, 0, 0},
      {"tl000_pl000_tv000_pv000_tl015.jpg", IMAGE_NAME_BAD, 0, 0},
      {"tl010_pl000_tv000_pv000.jpg", IMAGE_NAME_BAD, 0, 0},
      {"tl015_pl030_tv000_pv000.jpg", IMAGE_NAME_BAD, 0, 0},
      {"tl015_pl059.9_tv000_pv000.jpg", IMAGE_NAME_BAD, 0, 0},
      {"tl999999999999_pl0_tv0_pv0.jpg", IMAGE_NAME_BAD, 0, 0},
      {"tl0_pl0_tv90_pv0.jpg", IMAGE_NAME_BAD, 0, 0},
  };
  (void)state;
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    uint32_t pair = images_none;
    bool differs = false;
    picture_fault fault = {BTF_OK, ""};
    const image_name is = images_parse_name(names[i].name, &pair, &differs, &fault);
    if (is != names[i].is) fail_msg("%s: %d instead of %d", names[i].name, (int)is, (int)names[i].is);
    if (is == IMAGE_NAME_PAIR) assert_int_equal(pair, names[i].view * 81 + names[i].light);
    if (is == IMAGE_NAME_BAD) assert_true(fault.status != BTF_OK && fault.why[0] != '\0');
    assert_false(differs);
  }
  uint32_t pair;
  bool differs = false;
  picture_fault fault;
  assert_int_equal(images_parse_name("00648 tl000 pl000 tv030 pv030.jpg", &pair, &differs, &fault),
                   IMAGE_NAME_PAIR);
  assert_true(differs); /* that counts lights fastest */
}

/* ---- gaps ---- */

/* Codes of 16 bits that are linear in parabolic coordinates, in which interpolation is. */
static double linear_in(uint32_t direction) {
  unsigned theta, phi;
  const double degree = acos(-1) / 180;
  case_angles(direction, &theta, &phi);
  const double radius = tan(theta * degree / 2);
  return 0.5 + 0.3 * radius * cos(phi * degree) - 0.2 * radius * sin(phi * degree);
}
static uint32_t linear_code(uint32_t view, uint32_t light, uint32_t x, uint32_t row, uint32_t channel) {
  (void)row, (void)channel;
  return (uint32_t)(65535 * linear_in(x == 0 ? light : view) + 0.5);
}
/* Lights inside of the hull, for three views, and a whole view. */
static bool has_gap(uint32_t view, uint32_t light) {
  return view == 30 || (view == 4 && (light == 0 || light == 25)) || (view == 80 && light > 18 && light < 37);
}
static const archive_case linear = {
    .label = "linear", .extension = "png", .names = CASE_UTIA, .picture = {CASE_PNG16, 2, 1, 1, linear_code}};

static const gap_rule left_out = {has_gap, LEFT_OUT};

static void check_filled(btf_context *ctx, const char *path, const char *damaged) {
  static const char *const settings[] = {"allow_missing", "true", "transfer", "linear", "type", "f32", NULL};
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  float samples[81 * 81 * 2];
  assert_ok(format_try(ctx, path, "bonn-images", settings, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  assert_string_equal(format_note(&d, "images_filled"), "101");
  assert_string_equal(format_note(&d, "images_damaged"), damaged);
  const btf_block whole = {0, 81, 0, 81, 0, 0, 2, 1};
  const btf_strides strides = {.view = 648, .light = 8, .y = 8, .x = 4, .channel = 4};
  assert_ok(btf_dataset_read(ds, &whole, samples, &strides));
  /* Codes are off by half a step; weights, sums and directions of floats by a few 2^-24 each. */
  const double tolerance = 0.5 / 65535 + 1e-6;
  for (uint32_t view = 0; view < 81; view++)
    for (uint32_t light = 0; light < 81; light++) {
      const float *sample = samples + 2 * ((size_t)view * 81 + light);
      assert_near(sample[0], linear_in(light), tolerance);
      assert_near(sample[1], linear_in(view), tolerance);
    }
  btf_dataset_release(ds);
}

static void test_missing(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const char *path = write_case(&linear, "gaps.zip", &left_out);
  btf_dataset *ds;
  assert_status(open_with(ctx, path, NULL, NULL, &ds), BTF_E_CORRUPT);
  assert_message_has("101 of 6561");
  assert_message_has("tl000 pl000 tv015 pv180");
  assert_message_has("tl045 pl120 tv015 pv180");
  assert_message_has("allow_missing");
  check_filled(ctx, path, "");
  test_context_done(ctx, &memory);
}

/* Damaged pictures are filled like missing ones. */
static void test_damaged(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  btf_dataset *ds;
  const char *path = write_case(&linear, "damaged.zip", &(gap_rule){has_gap, DAMAGED});
  assert_status(open_with(ctx, path, NULL, NULL, &ds), BTF_E_CORRUPT);
  check_filled(ctx, path, "101");
  test_context_done(ctx, &memory);
}

static bool half_of_them(uint32_t view, uint32_t light) {
  return (view * 81 + light) % 2 == 0;
}

/* Which of several sizes is the right one is not guessed: here a half, nearly, and two quarters. */
static void test_several_sizes(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  btf_dataset *ds;
  const char *path = write_case(&linear, "half.zip", &(gap_rule){half_of_them, WIDER});
  assert_status(open_with(ctx, path, NULL, NULL, &ds), BTF_E_CORRUPT);
  assert_message_has("unlike");
  assert_status(open_with(ctx, path, "allow_missing", "true", &ds), BTF_E_CORRUPT);
  assert_message_has("several sizes");
  test_context_done(ctx, &memory);
}

static bool all_but_one(uint32_t view, uint32_t light) {
  return view != 3 || light != 5;
}

static void test_nearly_all_missing(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  btf_dataset *ds;
  const char *path = write_case(&linear, "one.zip", &(gap_rule){all_but_one, LEFT_OUT});
  assert_status(open_with(ctx, path, "allow_missing", "true", &ds), BTF_E_CORRUPT);
  assert_message_has("too many images are missing");
  test_context_done(ctx, &memory);
}

/* ---- threads, memory, the folder that is imported ---- */

typedef struct reading {
  const btf_dataset *ds;
  uint32_t seed;
  bool failed;
} reading;

static void *read_many(void *user) {
  reading *r = user;
  const archive_case *c = &cases[3];
  for (uint32_t i = 0; i < 2000; i++) {
    const uint32_t pair = (i / 4 * 7919 + r->seed) % 64; /* few pairs, so that threads meet */
    const btf_block block = {pair / 8, 1, pair % 8, 1, i % 7, i % 5, 1, 1};
    const btf_strides strides = {.view = 12, .light = 12, .y = 12, .x = 12, .channel = 4};
    float sample[3];
    if (btf_dataset_read(r->ds, &block, sample, &strides) != BTF_OK) r->failed = true;
    for (uint32_t k = 0; k < 3 && !r->failed; k++) {
      double low, high;
      expected(c, block.view0, block.light0, block.x0, block.y0, k, &low, &high);
      if (!(sample[k] >= low && sample[k] <= high)) r->failed = true;
    }
  }
  return NULL;
}

static void test_threads(void **state) {
  enum { THREADS = 4 };
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  btf_dataset *ds;
  pthread_t threads[THREADS];
  reading readings[THREADS];
  const char *path = write_case(&cases[3], "threads.zip", NULL);
  assert_ok(open_with(ctx, path, NULL, NULL, &ds));
  for (uint32_t i = 0; i < THREADS; i++) {
    readings[i] = (reading){ds, i / 2, false};
    assert_int_equal(pthread_create(&threads[i], NULL, read_many, &readings[i]), 0);
  }
  for (uint32_t i = 0; i < THREADS; i++) {
    assert_int_equal(pthread_join(threads[i], NULL), 0);
    assert_false(readings[i].failed);
  }
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void test_allocations(void **state) {
  (void)state;
  const char *path = write_case(&linear, "gaps.zip", &left_out);
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const btf_format *format = btf_format_find(ctx, "bonn-images");
  btf_options *options;
  assert_ok(btf_format_options_create(format, &options));
  assert_ok(btf_options_set(options, "allow_missing", "true"));
  /* Each of the first few, later ones ever farther apart: heads are looked at a hundred times alike. */
  for (long fail_at = 1;; fail_at += 1 + fail_at / 8) {
    float samples[2];
    btf_dataset *ds = NULL;
    const btf_block filled = {30, 1, 0, 1, 0, 0, 2, 1};
    const btf_strides strides = {.view = 8, .light = 8, .y = 8, .x = 4, .channel = 4};
    memory.fail_at = memory.total_allocations + fail_at;
    btf_status status = btf_format_open(ctx, path, format, options, &ds);
    if (status == BTF_OK) status = btf_dataset_read(ds, &filled, samples, &strides);
    btf_dataset_release(ds);
    const bool reached = memory.total_allocations >= memory.fail_at;
    if (!reached) {
      assert_int_equal(status, BTF_OK);
      assert_true(fail_at > 100);
      break;
    }
    if (status != BTF_OK) assert_int_equal(status, BTF_E_NOMEM);
  }
  memory.fail_at = 0;
  btf_options_release(options);
  test_context_done(ctx, &memory);
}

static void import(btf_context *ctx, const btf_dataset *ds, const char *path) {
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  btf_dataset_writer *writer;
  assert_ok(btf_dataset_describe(ds, &d));
  assert_ok(btf_dataset_writer_create(ctx, path, &d, BTF_ORDER_VLYXC, &writer));
  for (uint32_t i = 0; d.notes != NULL && d.notes[i] != NULL; i += 2)
    assert_ok(btf_dataset_writer_text(writer, d.notes[i], d.notes[i + 1]));
  const ptrdiff_t x = 4 * (ptrdiff_t)d.channels, y = x * (ptrdiff_t)d.width, light = y * (ptrdiff_t)d.height;
  const btf_strides strides = {.view = 81 * light, .light = light, .y = y, .x = x, .channel = 4};
  float *samples = malloc(81 * (size_t)light);
  assert_non_null(samples);
  for (uint32_t view = 0; view < 81; view++) {
    const btf_block block = {view, 1, 0, 81, 0, 0, d.width, d.height};
    assert_ok(btf_dataset_read(ds, &block, samples, &strides));
    assert_ok(btf_dataset_writer_put(writer, &block, samples, &strides));
  }
  free(samples);
  assert_ok(btf_dataset_writer_finish(writer));
}

static unsigned char *encode(btf_context *ctx, const btf_codec *codec, const btf_dataset *ds,
                             const char *path, size_t *size) {
  btf_model *model;
  assert_ok(btf_model_fit(ds, codec, NULL, NULL, &model));
  assert_ok(btf_model_save(model, path, 0, NULL, NULL));
  btf_model_release(model);
  (void)ctx;
  return test_read_bytes(path, size);
}

/* An archive is encoded to the same bytes as the folder imported from it. */
static void test_encoding_alike(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const btf_codec *codec = btf_codec_find(ctx, "fmf");
  if (codec == NULL || (btf_codec_caps(codec) & BTF_CAP_FIT) == 0) {
    test_context_done(ctx, &memory);
    skip();
    return;
  }
  const char *path = write_case(&cases[0], "material", NULL), *folder = test_path("imported/material");
  btf_dataset *ds, *imported;
  size_t size, size_imported;
  make_parents(folder);
  assert_ok(open_with(ctx, path, NULL, NULL, &ds));
  import(ctx, ds, folder);
  assert_ok(btf_dataset_open(ctx, folder, &imported));
  unsigned char *model = encode(ctx, codec, ds, test_path("a.btfz"), &size);
  unsigned char *model_imported = encode(ctx, codec, imported, test_path("b.btfz"), &size_imported);
  assert_int_equal(size, size_imported);
  assert_memory_equal(model, model_imported, size);
  free(model);
  free(model_imported);
  btf_dataset_release(ds);
  btf_dataset_release(imported);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_names),
      cmocka_unit_test(test_kinds),
      cmocka_unit_test(test_missing),
      cmocka_unit_test(test_damaged),
      cmocka_unit_test(test_several_sizes),
      cmocka_unit_test(test_nearly_all_missing),
      cmocka_unit_test(test_threads),
      cmocka_unit_test(test_allocations),
      cmocka_unit_test(test_encoding_alike),
      cmocka_unit_test(test_hostile_archives),
      cmocka_unit_test(test_hostile_pictures),
      cmocka_unit_test(test_truncation),
      cmocka_unit_test(test_duplicates),
      cmocka_unit_test(test_odd_folders),
      cmocka_unit_test(test_count_refusals),
  };
  return btf_run("bonn_images", tests);
}
