/* SPDX-License-Identifier: MIT */
/* Files written from factors, read back and compared with brute force from what they were made of. */
#include "bonn_case.h"
#include "../source/test_format.h"

#include <errno.h>
#include <sys/stat.h>
#include <unistd.h>

#include "io/io.h"

/* As in test_bonn_convert.c. */
static const double exact = 1e-5;
/* Each of two vectors of a product rounds to 2^-11 of its largest magnitude; those of a channel sum to 12.3.
 */
static const double of_halves = 12.3 * (2 * 0x1p-11 + 0x1p-22);

typedef struct writing {
  bonn_case c;
  btf_context *ctx;
  test_memory memory;
  btf_dataset *ds;
  const char *path; /* written */
} writing;

static void begin(writing *t, const bonn_case *c) {
  t->c = *c;
  t->ctx = format_context(&t->memory);
  t->path = test_path("written.btf");
  const char *source = test_path("source.dat");
  bonn_bytes bytes = bonn_case_write(c);
  test_write_bytes(source, bytes.data, bytes.size);
  free(bytes.data);
  assert_ok(btf_format_open(t->ctx, source, NULL, NULL, &t->ds));
}

static void end(writing *t) {
  btf_dataset_release(t->ds);
  unlink(t->path);
  test_context_done(t->ctx, &t->memory);
}

/* `settings` is name, value, ..., NULL. */
static btf_status write_with(const writing *t, const char *const *settings, const btf_job *job) {
  const btf_format *format = btf_format_find(t->ctx, "bonn-btf");
  btf_options *options;
  btf_status status = btf_format_write_options_create(format, &options);
  for (size_t i = 0; status == BTF_OK && settings[i] != NULL; i += 2)
    status = btf_options_set(options, settings[i], settings[i + 1]);
  if (status == BTF_OK) status = btf_format_write(t->ctx, t->path, format, options, t->ds, job);
  btf_options_release(options);
  return status;
}

static void read_back(const writing *t, const char *family, double tolerance) {
  const bonn_case *c = &t->c;
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT, from = BTF_DATASET_DESC_INIT;
  assert_ok(btf_format_open(t->ctx, t->path, NULL, NULL, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  assert_ok(btf_dataset_describe(t->ds, &from));
  assert_string_equal(format_note(&d, "bonn_family"), family);
  assert_string_equal(format_note(&d, "bonn_setup"), format_note(&from, "bonn_setup"));
  assert_int_equal(d.quantity, from.quantity);
  assert_near(d.texels_per_mm, from.texels_per_mm, 0);
  for (uint32_t k = 0; k < c->channels; k++) assert_string_equal(d.channel_names[k], from.channel_names[k]);
  bonn_case_check_directions(d.views, c->views, false);
  bonn_case_check_directions(d.lights, c->lights, true);
  for (uint32_t v = 0; v < c->views; v++)
    for (uint32_t l = 0; l < c->lights; l++)
      for (uint32_t y = 0; y < c->height; y++)
        for (uint32_t x = 0; x < c->width; x++) {
          float got[64];
          const btf_block one = {v, 1, l, 1, x, y, 1, 1};
          const btf_strides strides = {256, 256, 256, 256, 4};
          assert_ok(btf_dataset_read(ds, &one, got, &strides));
          for (uint32_t k = 0; k < c->channels; k++) {
            const double expected = bonn_case_sample(c, v, l, x, y, k);
            assert_near(got[k], expected, tolerance * fmax(1, fabs(expected)));
          }
        }
  btf_dataset_release(ds);
}

static size_t written_bytes(const writing *t) {
  struct stat info;
  assert_int_equal(stat(t->path, &info), 0);
  return (size_t)info.st_size;
}

static const struct form {
  const char *settings[5], *family;
  bool halves;
} forms[] = {{{"family", "fmf", "scalar", "float"}, "FMF", false},
             {{"family", "dfmf", "scalar", "float"}, "DFMF", false},
             {{"family", "fmf", "scalar", "half"}, "FMF", true},
             {{"family", "dfmf", "scalar", "half"}, "DFMF", true},
             {{NULL}, "FMF", true}};

/* Factors that are halves stay so in every form. Sizes are those of the description: 10 or 11 bytes of
 * signature, 276 and the names, directions, sizes, rotations and counts, and the matrices. */
static void test_forms(void **state) {
  (void)state;
  static const char *const labels[] = {"FMF half", "FMF double, xml", "FMF by texel",
                                       "FMF12 spectral, by texel"};
  for (size_t i = 0; i < sizeof labels / sizeof *labels; i++)
    for (size_t k = 0; k < sizeof forms / sizeof *forms; k++) {
      writing t;
      bonn_case c = bonn_case_named(labels[i]);
      c.width += 4; /* room for components of each channel */
      c.views += 3;
      begin(&t, &c);
      assert_ok(write_with(&t, forms[k].settings, NULL));
      read_back(&t, forms[k].family, exact);
      if (i == 0) {
        const size_t size = forms[k].halves ? 2 : 4, pairs = (size_t)c.views * c.lights,
                     texels = (size_t)c.width * c.height;
        const bool dfmf = forms[k].settings[0] != NULL && strcmp(forms[k].settings[1], "dfmf") == 0;
        const size_t head = 276 + 3 * 5 + 4 + c.views * (12 + 8 * (size_t)c.lights) + 8 + 4 + 4;
        const size_t matrix = 13 + c.components * size * (1 + (dfmf ? pairs : 3 * pairs) + texels);
        assert_int_equal(written_bytes(&t), head + (dfmf ? 10 + 4 + 12 * 4 + 3 * matrix : 9 + matrix));
      }
      end(&t);
    }
}

/* A file of a factorisation for each channel is one again, with as many components. */
static void test_channels(void **state) {
  (void)state;
  writing t;
  bonn_case c = bonn_case_named("DFMF RGB");
  const char *const dfmf[] = {"family", "dfmf", NULL}, *const half[] = {"scalar", "half", NULL},
                    *const by_channel[] = {"family", "dfmf", "scalar", "half", NULL};
  btf_dataset *again;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  c.width += 4;
  begin(&t, &c);
  assert_ok(write_with(&t, dfmf, NULL));
  read_back(&t, "DFMF", exact);
  assert_ok(btf_format_open(t.ctx, t.path, NULL, NULL, &again));
  assert_ok(btf_dataset_describe(again, &d));
  assert_string_equal(format_note(&d, "bonn_components"), "4");
  btf_dataset_release(again);
  end(&t);
  c = bonn_case_named("DFMF YUV");
  c.width += 4;
  begin(&t, &c);
  assert_ok(write_with(&t, dfmf, NULL)); /* these are no halves */
  read_back(&t, "DFMF", exact);
  assert_ok(write_with(&t, half, NULL));
  read_back(&t, "FMF", of_halves);
  assert_ok(write_with(&t, by_channel, NULL));
  read_back(&t, "DFMF", of_halves);
  end(&t);
}

static void test_models(void **state) {
  (void)state;
  writing t;
  bonn_case c = bonn_case_named("FMF float, cosine");
  const char *const defaults[] = {NULL}, *const half[] = {"scalar", "half", NULL};
  begin(&t, &c);
  const btf_codec *fmf = btf_codec_find(t.ctx, "fmf");
  if (fmf == NULL) {
    end(&t);
    skip();
  }
  btf_model *model;
  btf_dataset *measured = t.ds;
  assert_ok(btf_model_from_factors(measured, fmf, NULL, NULL, &model));
  assert_ok(btf_dataset_from_model(model, &t.ds));
  btf_model_release(model);
  assert_ok(write_with(&t, defaults, NULL));
  read_back(&t, "FMF", exact);
  assert_ok(write_with(&t, half, NULL));
  read_back(&t, "FMF", of_halves);
  btf_dataset_release(measured);
  end(&t);
}

/* Whatever the working set, the file is the same and no more than that is allocated, or it is refused before
 * anything that grows with the factors is: 4 vectors of 60 floats and as many of 6 are 1056 bytes. Beside the
 * working set there are options, and a file being written that the library keeps the paths of: 2 KiB. */
static void test_budget(void **state) {
  (void)state;
  enum { BESIDE = 2048 };
  writing t;
  bonn_case c = bonn_case_named("FMF half");
  const char *const defaults[] = {NULL};
  size_t whole_size, size, least = 0;
  btf_job job = BTF_JOB_INIT;
  begin(&t, &c);
  assert_ok(write_with(&t, defaults, NULL));
  unsigned char *whole = test_read_bytes(t.path, &whole_size);
  for (job.max_working_set = 16; job.max_working_set < 16384; job.max_working_set += 16) {
    const size_t before = t.memory.live_bytes;
    t.memory.peak_bytes = before;
    const btf_status status = write_with(&t, defaults, &job);
    const size_t used = t.memory.peak_bytes - before;
    if (status != BTF_OK) {
      assert_int_equal(status, BTF_E_LIMIT);
      assert_message_has("would do");
      assert_int_equal(least, 0); /* more is never too little */
      assert_true(used <= BESIDE);
      continue;
    }
    if (least == 0) least = job.max_working_set;
    assert_true(used <= job.max_working_set + BESIDE);
    unsigned char *rows = test_read_bytes(t.path, &size);
    assert_int_equal(size, whole_size);
    assert_memory_equal(rows, whole, size);
    free(rows);
  }
  assert_true(least > 4 * 60 && least < 2048);
  free(whole);
  end(&t);
}

/* ---- what halves hold ---- */

enum { ROWS = 12, TEXELS = 12, PLANTED = 2 };

/* Two components of given largest magnitudes on either side, with values down to 2^-11 of those. */
typedef struct planted {
  const char *label;
  double magnitude[PLANTED][2]; /* of angular and texel vectors; 0 = the component is 0 */
  bool dyadic;                  /* values of few bits, which halves hold as they are */
  bool halves;                  /* what `auto` makes of it */
} planted;

static double planted_value(const planted *p, uint32_t k, uint32_t side, uint32_t i) {
  const double mantissa = p->dyadic ? 1 : 1 - (double)((i * 7 + k * 5 + side * 3) % 11) / 37;
  return p->magnitude[k][side] * (i % 3 == 1 ? -1 : 1) * ldexp(mantissa, -(int)((i + k) % 12));
}

static void planted_column(const void *user, uint32_t product, uint32_t side, uint32_t k, float *dst) {
  (void)product;
  for (uint32_t i = 0; i < (side == BTF_SIDE_TEXEL ? TEXELS : ROWS); i++)
    dst[i] = (float)planted_value(user, k, side, i);
}

static btf_status planted_factors(void *user, btf_factors *out) {
  static const uint32_t components[] = {PLANTED};
  out->products = 1;
  out->value_bytes = 2;
  out->components = components;
  out->column = planted_column;
  out->user = user;
  return BTF_OK;
}

static btf_status planted_read(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  (void)user, (void)block, (void)dst, (void)strides;
  return btf_source_error(BTF_E_UNSUPPORTED, "only its factors are written");
}

static btf_dataset *planted_dataset(btf_context *ctx, planted *p) {
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  btf_dirset *lights, *views;
  btf_dataset *ds;
  assert_ok(btf_dirset_create_named(ctx, "grid:2x2", &lights));
  assert_ok(btf_dirset_create_named(ctx, "grid:3x1", &views));
  d.lights = lights;
  d.views = views;
  d.width = 4;
  d.height = 3;
  d.channels = 1;
  d.read = planted_read;
  d.factors = planted_factors;
  d.user = p;
  assert_ok(btf_dataset_create(ctx, &d, &ds));
  btf_dirset_release(lights);
  btf_dirset_release(views);
  return ds;
}

/* Every sample is within 2^-10 + 2^-22 times the sum of the products of the largest magnitudes, as the
 * documentation says; beside that, floats round two products and their sum. */
static void check_planted(const writing *t, const planted *p, bool halves) {
  double sum = 0;
  btf_dataset *ds;
  assert_ok(btf_format_open(t->ctx, t->path, NULL, NULL, &ds));
  for (uint32_t k = 0; k < PLANTED; k++) sum += p->magnitude[k][0] * p->magnitude[k][1];
  const double bound = sum * ((halves ? 0x1p-10 + 0x1p-22 : 0) + 6 * 0x1p-24);
  for (uint32_t row = 0; row < ROWS; row++)
    for (uint32_t texel = 0; texel < TEXELS; texel++) {
      float got;
      double expected = 0;
      const btf_block one = {row / 4, 1, row % 4, 1, texel % 4, texel / 4, 1, 1};
      const btf_strides strides = {4, 4, 4, 4, 4};
      assert_ok(btf_dataset_read(ds, &one, &got, &strides));
      for (uint32_t k = 0; k < PLANTED; k++)
        expected += (double)(float)planted_value(p, k, 0, row) * (double)(float)planted_value(p, k, 1, texel);
      if (!(fabs((double)got - expected) <= bound))
        fail_msg("%s: row %u texel %u: %.9g instead of %.9g within %.3g", p->label, row, texel, (double)got,
                 expected, bound);
    }
  btf_dataset_release(ds);
}

static void test_magnitudes(void **state) {
  (void)state;
  const char *const automatic[] = {NULL}, *const half[] = {"scalar", "half", NULL};
  static planted cases[] = {
      {"ordinary", {{1, 1}, {0.5, 0.25}}, false, true},
      {"far apart", {{0x1p-30, 0x1p20}, {0x1p40, 0x1p-50}}, false, true},
      {"small", {{0x1p-20, 0x1p-20}, {0, 0}}, false, false},
      {"all small", {{0x1p-18, 0x1p-20}, {0x1p-60, 0x1p20}}, false, false},
      {"a small one among others", {{1, 1}, {0x1p-20, 0x1p-20}}, false, true},
      {"small, of few bits", {{0x1p-13, 0x1p-13}, {0, 0}}, true, true},
      {"large", {{0x1p20, 0x1p20}, {0, 0}}, false, false},
      {"a large one among others", {{1, 1}, {0x1p30, 0x1p10}}, false, false},
  };
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    planted *p = &cases[i];
    writing t = {.path = test_path("written.btf")};
    t.ctx = format_context(&t.memory);
    t.ds = planted_dataset(t.ctx, p);
    assert_ok(write_with(&t, automatic, NULL));
    check_planted(&t, p, p->halves);
    const size_t automatic_bytes = written_bytes(&t);
    const btf_status status = write_with(&t, half, NULL);
    if (p->halves) {
      assert_int_equal(status, BTF_OK);
      assert_int_equal(written_bytes(&t), automatic_bytes);
      check_planted(&t, p, true);
    } else {
      assert_int_equal(status, BTF_E_UNSUPPORTED);
      assert_message_has(p->magnitude[0][0] < 1 ? "too small for halves" : "too large for halves");
      const char *const floats[] = {"scalar", "float", NULL};
      assert_ok(write_with(&t, floats, NULL));
      assert_int_equal(written_bytes(&t), automatic_bytes);
    }
    end(&t);
  }
}

static void expect_refusal(const bonn_case *c, const char *const *settings, btf_status expected,
                           const char *words) {
  writing t;
  begin(&t, c);
  assert_status(write_with(&t, settings, NULL), expected);
  assert_message_has(words);
  assert_false(test_exists(t.path));
  end(&t);
}

static void test_refusals(void **state) {
  (void)state;
  const char *const defaults[] = {NULL};
  bonn_case c = bonn_case_named("BDI");
  expect_refusal(&c, defaults, BTF_E_UNSUPPORTED, "samples");
  c = bonn_case_named("PVF");
  expect_refusal(&c, defaults, BTF_E_UNSUPPORTED, "each view");
  c = bonn_case_named("DFMF RGB"); /* 12 components in one, of 6 texels */
  expect_refusal(&c, defaults, BTF_E_UNSUPPORTED, "12 components");
  writing t;
  c = bonn_case_named("FMF half");
  begin(&t, &c);
  const btf_format *format = btf_format_find(t.ctx, "bonn-btf");
  btf_options *reading;
  assert_true(btf_format_can_write(format));
  assert_int_equal(btf_format_write_param_count(format), 2);
  btf_param_desc p = {.struct_size = sizeof p};
  assert_ok(btf_format_write_param(format, 0, &p));
  assert_string_equal(p.name, "family");
  assert_ok(btf_format_options_create(format, &reading));
  assert_status(btf_format_write(t.ctx, t.path, format, reading, t.ds, NULL), BTF_E_INVALID_ARG);
  btf_options_release(reading);
  const btf_format *only_read = btf_format_find(t.ctx, "merl");
  if (only_read != NULL) {
    assert_false(btf_format_can_write(only_read));
    assert_status(btf_format_write(t.ctx, t.path, only_read, NULL, t.ds, NULL), BTF_E_UNSUPPORTED);
  }
  assert_status(btf_format_write(t.ctx, NULL, format, NULL, t.ds, NULL), BTF_E_INVALID_ARG);
  assert_status(btf_format_write(t.ctx, test_folder(), format, NULL, t.ds, NULL), BTF_E_IO);
  assert_status(btf_format_write(t.ctx, test_path("none/x.btf"), format, NULL, t.ds, NULL), BTF_E_IO);
  end(&t);
}

static long calls, failing_call;

static int fail_call(const char *call) {
  (void)call;
  return ++calls == failing_call ? ENOSPC : 0;
}

static int32_t cancel(void *user, double fraction, const char *stage) {
  (void)user, (void)stage;
  return fraction > 0;
}

/* What fails leaves nothing behind, and a file that was there as it was. */
static void test_failures(void **state) {
  (void)state;
  writing t;
  const bonn_case c = bonn_case_named("FMF half");
  const char *const dfmf[] = {"family", "dfmf", NULL};
  begin(&t, &c);
  for (int there = 0; there < 2; there++) {
    btf_status status = BTF_E_IO;
    const size_t entries = test_count_entries(test_folder());
    for (failing_call = 1; status != BTF_OK; failing_call++) {
      calls = 0;
      btfi_io_fault = fail_call;
      status = write_with(&t, dfmf, NULL);
      btfi_io_fault = NULL;
      if (status == BTF_OK) break;
      assert_int_equal(status, BTF_E_IO);
      /* The folder is synchronised after the renaming: the file is whole then. */
      if (test_count_entries(test_folder()) != entries) {
        assert_int_equal(test_count_entries(test_folder()), entries + 1);
        read_back(&t, "DFMF", exact);
        if (!there) unlink(t.path);
      }
    }
    assert_true(failing_call > 20);
    read_back(&t, "DFMF", exact);
  }
  unlink(t.path);
  btf_job job = BTF_JOB_INIT;
  job.progress = cancel;
  const size_t entries = test_count_entries(test_folder());
  assert_status(write_with(&t, dfmf, &job), BTF_E_CANCELLED);
  assert_int_equal(test_count_entries(test_folder()), entries);
  btf_status status = BTF_E_NOMEM;
  long fail_at = 0;
  while (status != BTF_OK) {
    t.memory.fail_at = t.memory.total_allocations + ++fail_at;
    status = write_with(&t, dfmf, NULL);
    if (status != BTF_OK) {
      assert_int_equal(status, BTF_E_NOMEM);
      assert_int_equal(test_count_entries(test_folder()), entries);
    }
  }
  t.memory.fail_at = 0;
  assert_true(fail_at > 8);
  end(&t);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_forms),    cmocka_unit_test(test_channels),   cmocka_unit_test(test_models),
      cmocka_unit_test(test_budget),   cmocka_unit_test(test_magnitudes), cmocka_unit_test(test_refusals),
      cmocka_unit_test(test_failures),
  };
  return btf_run("bonn_write", tests);
}
