/* SPDX-License-Identifier: MIT */
/* Data sets that are factors: kept by a codec as they are, given back by its models, written in other
 * storage, and everything refused that would not be kept. */
#include "codec_suite.h"

#include <btf/btf_half.h>

enum { LIGHTS = 5, VIEWS = 4, WIDTH = 6, HEIGHT = 3, CHANNELS = 2, MOST = 9 };
enum { ROWS = VIEWS * LIGHTS * CHANNELS, TEXELS = WIDTH * HEIGHT };

/* A_k and T_k at [k], of one product or of each view. */
typedef struct source {
  uint32_t products, components[VIEWS];
  float angular[MOST][ROWS], texel[VIEWS][MOST][TEXELS];
  btf_status refuses;
  uint32_t value_bytes;
  const char *lens; /* a note of it, with which the setup is another; NULL = none */
} source;

static float gaussian(uint64_t *seed) {
  double sum = 0;
  for (int i = 0; i < 12; i++) {
    *seed = *seed * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    sum += (double)(*seed >> 40) / 16777216.0;
  }
  return (float)(sum - 6);
}

static double sample(const source *s, uint32_t view, uint32_t light, uint32_t texel, uint32_t channel) {
  const uint32_t row = (view * LIGHTS + light) * CHANNELS + channel, p = s->products == 1 ? 0 : view;
  double sum = 0;
  for (uint32_t k = 0; k < s->components[p]; k++) sum += (double)s->angular[k][row] * s->texel[p][k][texel];
  return sum;
}

static btf_status read_block(void *user, const btf_block *b, void *dst, const btf_strides *st) {
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++)
          for (uint32_t c = 0; c < CHANNELS; c++)
            *(float *)(void *)((char *)dst + (ptrdiff_t)v * st->view + (ptrdiff_t)l * st->light +
                               (ptrdiff_t)y * st->y + (ptrdiff_t)x * st->x + (ptrdiff_t)c * st->channel) =
                (float)sample(user, b->view0 + v, b->light0 + l, (b->y0 + y) * WIDTH + b->x0 + x, c);
  return BTF_OK;
}

static void column(const void *user, uint32_t product, uint32_t side, uint32_t k, float *dst) {
  const source *s = user;
  const uint32_t rows = ROWS / s->products;
  if (side == BTF_SIDE_TEXEL)
    memcpy(dst, s->texel[product][k], sizeof s->texel[product][k]);
  else
    memcpy(dst, s->angular[k] + product * rows, rows * sizeof *dst);
}

static btf_status factors(void *user, btf_factors *out) {
  source *s = user;
  if (s->refuses != BTF_OK) return btf_source_error(s->refuses, "these are no factors");
  out->products = s->products;
  out->value_bytes = s->value_bytes;
  out->components = s->components;
  out->column = column;
  out->user = s;
  return BTF_OK;
}

static void fill(source *s, uint32_t products, uint32_t components) {
  uint64_t seed = 7;
  memset(s, 0, sizeof *s);
  s->products = products;
  s->value_bytes = 4;
  for (uint32_t p = 0; p < products; p++) s->components[p] = components - (products > 1 ? p : 0);
  for (uint32_t k = 0; k < components; k++) {
    /* Vectors of very different length, as of a decomposition and its values of a file. */
    for (uint32_t i = 0; i < ROWS; i++) s->angular[k][i] = gaussian(&seed) / (float)(1 << k);
    for (uint32_t p = 0; p < products; p++)
      for (uint32_t i = 0; i < TEXELS; i++) s->texel[p][k][i] = gaussian(&seed);
  }
}

static btf_status make(btf_context *ctx, source *s, btf_dataset **out) {
  const char *const notes[] = {
      "setup",           s->lens != NULL ? "an arm" : "a dome", "",      "no key", "btf.command",
      "not ours to set", s->lens != NULL ? "lens" : NULL,       s->lens, NULL};
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  btf_dirset *lights, *views;
  float xyz[2][3 * LIGHTS];
  for (uint32_t i = 0; i < LIGHTS; i++)
    for (int set = 0; set < 2; set++) {
      const double z = 0.95 - 0.15 * i, phi = 2.1 * i + set, r = sqrt(1 - z * z);
      xyz[set][3 * i] = (float)(r * cos(phi));
      xyz[set][3 * i + 1] = (float)(r * sin(phi));
      xyz[set][3 * i + 2] = (float)z;
    }
  assert_ok(btf_dirset_create(ctx, xyz[0], LIGHTS, &lights));
  assert_ok(btf_dirset_create(ctx, xyz[1], VIEWS, &views));
  d.lights = lights;
  d.views = views;
  d.width = WIDTH;
  d.height = HEIGHT;
  d.channels = CHANNELS;
  d.quantity = BTF_QUANTITY_BRDF_COS;
  d.name = "given";
  d.notes = notes;
  d.read = read_block;
  d.factors = factors;
  d.user = s;
  const btf_status status = btf_dataset_create(ctx, &d, out);
  btf_dirset_release(lights);
  btf_dirset_release(views);
  return status;
}

static btf_status keep(const btf_dataset *ds, btf_context *ctx, const char *codec, const char *settings,
                       const btf_job *job, btf_model **out) {
  btf_options *options;
  *out = NULL;
  btf_status status = suite_options(ctx, codec, settings, &options);
  if (status != BTF_OK) return status;
  status = btf_model_from_factors(ds, btf_codec_find(ctx, codec), options, job, out);
  btf_options_release(options);
  return status;
}

/* The largest error, in units of what rounding a product of largest magnitudes by 1 would make. */
static double worst(const source *s, const btf_model *model) {
  double largest = 0;
  for (uint32_t v = 0; v < VIEWS; v++) {
    const uint32_t p = s->products == 1 ? 0 : v, rows = ROWS / s->products;
    double unit = 0;
    for (uint32_t k = 0; k < s->components[p]; k++) {
      float a = 0, t = 0;
      for (uint32_t i = 0; i < rows; i++) a = fmaxf(a, fabsf(s->angular[k][p * rows + i]));
      for (uint32_t i = 0; i < TEXELS; i++) t = fmaxf(t, fabsf(s->texel[p][k][i]));
      unit += (double)a * t;
    }
    for (uint32_t l = 0; l < LIGHTS; l++)
      for (uint32_t t = 0; t < TEXELS; t++) {
        float got[CHANNELS];
        assert_int_equal(btf_model_texel(model, 0, t % WIDTH, t / WIDTH, l, v, got), 0);
        for (uint32_t c = 0; c < CHANNELS; c++)
          largest = fmax(largest, fabs(got[c] - sample(s, v, l, t, c)) / unit);
      }
  }
  return largest;
}

/* Both vectors of a product are rounded to so much of their largest magnitudes, and every product and sum of
 * at most 16 columns to 2^-24. 8-bit tables keep what rounding left in columns of their own, up to 64. Packed
 * factors are within 1e-7 of the norm of all, a part of the unit. */
static const struct storage {
  const char *settings;
  double bound;
} storages[] = {{"", 20 * 0x1p-24},
                {"storage=f32 levels=1", 20 * 0x1p-24},
                {"storage=f16", 2 * 0x1p-11},
                {"storage=bf16", 2 * 0x1p-8},
                {"storage=q8", 2.0 / 254 / 254 + 80 * 0x1p-24},
                {"coding=packed storage=f32", 1e-6},
                {"coding=packed", 1e-6}};

static void test_storages(void **state) {
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds;
  fill(&s, 1, MOST);
  assert_ok(make(ctx, &s, &ds));
  for (size_t i = 0; i < sizeof storages / sizeof *storages; i++) {
    btf_model *model;
    btf_model_info info = BTF_MODEL_INFO_INIT;
    assert_ok(keep(ds, ctx, "fmf", storages[i].settings, NULL, &model));
    assert_ok(btf_model_describe(model, &info));
    assert_int_equal(info.quantity, BTF_QUANTITY_BRDF_COS);
    assert_string_equal(info.name, "given");
    if (worst(&s, model) > storages[i].bound)
      fail_msg("fmf %s: %g instead of %g", storages[i].settings, worst(&s, model), storages[i].bound);
    btf_model_release(model);
  }
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

/* Coarser levels are the averages of the finest one's values: of 6 x 3 texels, 3 x 1 of two by three. */
static void test_levels(void **state) {
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds;
  btf_model *model;
  fill(&s, 1, 3);
  assert_ok(make(ctx, &s, &ds));
  assert_ok(keep(ds, ctx, "fmf", "", NULL, &model));
  for (uint32_t x = 0; x < 3; x++) {
    float got[CHANNELS];
    double sum = 0;
    for (uint32_t y = 0; y < 3; y++)
      for (uint32_t k = 0; k < 2; k++) sum += sample(&s, 2, 3, y * WIDTH + 2 * x + k, 1);
    btf_model_texel(model, 1, x, 0, 3, 2, got);
    assert_near(got[1], sum / 6, 1e-5);
  }
  btf_model_release(model);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void expect_equal(const btf_model *a, const btf_model *b) {
  for (uint32_t v = 0; v < VIEWS; v++)
    for (uint32_t l = 0; l < LIGHTS; l++)
      for (uint32_t t = 0; t < TEXELS; t++) {
        float of_a[CHANNELS], of_b[CHANNELS];
        btf_model_texel(a, 0, t % WIDTH, t / WIDTH, l, v, of_a);
        btf_model_texel(b, 0, t % WIDTH, t / WIDTH, l, v, of_b);
        for (uint32_t c = 0; c < CHANNELS; c++) assert_near(of_b[c], of_a[c], 2e-5);
      }
}

/* A model is a data set: its samples are what it decodes to, and its factors, kept again in the same storage,
 * lose nothing more. The bound is for floats: halves that were rounded anew would be off by 2^-11 of the
 * largest. */
static void test_models_are_data(void **state) {
  static const char *const settings[] = {"storage=f32", "storage=f16", "coding=packed storage=f16"};
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds, *decoded;
  fill(&s, 1, 4);
  assert_ok(make(ctx, &s, &ds));
  for (size_t i = 0; i < sizeof settings / sizeof *settings; i++) {
    btf_model *model, *again, *fitted;
    btf_dataset_desc d = BTF_DATASET_DESC_INIT;
    const btf_block whole = {0, VIEWS, 0, LIGHTS, 0, 0, WIDTH, HEIGHT};
    const btf_strides strides = {sizeof(float) * LIGHTS * TEXELS * CHANNELS,
                                 sizeof(float) * TEXELS * CHANNELS, sizeof(float) * WIDTH * CHANNELS,
                                 sizeof(float) * CHANNELS, sizeof(float)};
    static float samples[VIEWS][LIGHTS][TEXELS][CHANNELS];
    assert_ok(keep(ds, ctx, "fmf", settings[i], NULL, &model));
    assert_ok(btf_dataset_from_model(model, &decoded));
    assert_ok(btf_dataset_describe(decoded, &d));
    assert_int_equal(d.quantity, BTF_QUANTITY_BRDF_COS);
    assert_string_equal(d.name, "given");
    assert_ok(btf_dataset_read(decoded, &whole, samples[0][0][0], &strides));
    for (uint32_t t = 0; t < TEXELS; t++) {
      float got[CHANNELS];
      btf_model_texel(model, 0, t % WIDTH, t / WIDTH, 4, 2, got);
      assert_memory_equal(got, samples[2][4][t], sizeof got);
    }
    btf_model_release(model); /* the data set keeps it */
    assert_ok(keep(decoded, ctx, "fmf", "", NULL, &again));
    assert_ok(btf_model_from_dataset(decoded, NULL, &fitted));
    expect_equal(again, fitted);
    btf_model_release(again);
    /* Of uncompressed data it is the data itself. */
    btf_dataset *same;
    assert_ok(btf_dataset_from_model(fitted, &same));
    assert_ptr_equal(same, decoded);
    btf_dataset_release(same);
    btf_model_release(fitted);
    btf_dataset_release(decoded);
  }
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void expect_note(const btf_model *model) {
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  assert_ok(btf_dataset_from_model(model, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  assert_non_null(d.notes);
  assert_string_equal(d.notes[0], "setup");
  assert_string_equal(d.notes[1], "a dome");
  btf_dataset_release(ds);
}

/* What is known of the data goes with the model, into a file's metadata and back; keys of the library's own
 * and such as no container holds do not. */
static void test_notes(void **state) {
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds;
  btf_model *model;
  btf_file *file;
  fill(&s, 1, 3);
  assert_ok(make(ctx, &s, &ds));
  assert_ok(keep(ds, ctx, "fmf", "", NULL, &model));
  btf_dataset_release(ds);
  expect_note(model);
  for (int again = 0; again < 2; again++) {
    const char *path = test_path("notes.btfz");
    assert_ok(btf_model_save(model, path, 0, "a test", NULL));
    btf_model_release(model);
    assert_ok(btf_file_open_path(ctx, path, 0, &file));
    assert_string_equal(btf_file_metadata(file, "setup"), "a dome");
    assert_string_equal(btf_file_metadata(file, "btf.command"), "a test");
    assert_null(btf_file_metadata(file, ""));
    assert_int_equal(btf_file_metadata_count(file), 3); /* and btf.writer */
    assert_ok(btf_file_load_model(file, 0, &model));
    btf_file_close(file);
    expect_note(model);
  }
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

static void expect_notes(const btf_file *file, uint32_t number, const char *setup, const char *lens) {
  btf_model *model;
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  uint32_t texts = 0;
  assert_ok(btf_file_load_model(file, number, &model));
  assert_ok(btf_dataset_from_model(model, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  while (d.notes[texts] != NULL) texts++;
  assert_int_equal(texts, lens != NULL ? 4 : 2);
  assert_string_equal(d.notes[0], "setup");
  assert_string_equal(d.notes[1], setup);
  if (lens != NULL) assert_string_equal(d.notes[2], "lens");
  if (lens != NULL) assert_string_equal(d.notes[3], lens);
  btf_dataset_release(ds);
  btf_model_release(model);
}

static btf_writer *start_file(btf_context *ctx, const char *path) {
  btf_io io = BTF_IO_INIT;
  btf_writer *w;
  assert_ok(btf_io_file(ctx, path, BTF_IO_WRITE, &io));
  assert_ok(btf_writer_open(ctx, &io, 0, &w));
  return w;
}

/* Models in one file have notes of their own, also when they are copied behind others. */
static void test_notes_of_each_model(void **state) {
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_model *models[2];
  btf_file *file;
  for (int i = 0; i < 2; i++) {
    btf_dataset *ds;
    fill(&s, 1, 3);
    s.lens = i == 1 ? "wide" : NULL;
    assert_ok(make(ctx, &s, &ds));
    assert_ok(keep(ds, ctx, "fmf", "", NULL, &models[i]));
    btf_dataset_release(ds);
  }
  const char *two = test_path("two.btfz"), *five = test_path("five.btfz");
  btf_writer *w = start_file(ctx, two);
  for (int i = 0; i < 2; i++) assert_ok(btf_writer_model(w, models[i], NULL));
  assert_ok(btf_writer_finish(w));
  assert_ok(btf_file_open_path(ctx, two, 0, &file));
  assert_string_equal(btf_file_metadata(file, "btf.note.1.lens"), "wide");
  assert_null(btf_file_metadata(file, "lens"));
  expect_notes(file, 0, "a dome", NULL);
  expect_notes(file, 1, "an arm", "wide");
  w = start_file(ctx, five);
  assert_ok(btf_writer_model(w, models[1], NULL));
  assert_ok(btf_writer_copy(w, file));
  assert_ok(btf_writer_copy(w, file));
  btf_file_close(file);
  assert_ok(btf_writer_finish(w));
  assert_ok(btf_file_open_path(ctx, five, 0, &file));
  assert_int_equal(btf_file_model_count(file), 5);
  for (uint32_t i = 0; i < 5; i++)
    expect_notes(file, i, i % 2 == 1 ? "a dome" : "an arm", i % 2 == 1 ? NULL : "wide");
  btf_file_close(file);
  for (int i = 0; i < 2; i++) btf_model_release(models[i]);
  test_context_done(ctx, &memory);
}

static void test_zeros(void **state) {
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds;
  for (int all = 0; all < 2; all++)
    for (int packed = 0; packed < 2; packed++) {
      btf_model *model;
      fill(&s, 1, 3);
      for (uint32_t k = all ? 0 : 1; k < 3; k += 2) memset(s.angular[k], 0, sizeof s.angular[k]);
      if (all) memset(s.texel[0][1], 0, sizeof s.texel[0][1]);
      assert_ok(make(ctx, &s, &ds));
      assert_ok(keep(ds, ctx, "fmf", packed ? "coding=packed storage=f32" : "", NULL, &model));
      if (!all) assert_true(worst(&s, model) < 1e-6);
      float got[CHANNELS];
      btf_model_texel(model, 0, 1, 1, 1, 1, got);
      if (all) assert_true(got[0] == 0 && got[1] == 0);
      btf_model_release(model);
      btf_dataset_release(ds);
    }
  test_context_done(ctx, &memory);
}

static void expect_refusal(btf_context *ctx, source *s, const char *codec, const char *settings,
                           const btf_job *job, btf_status expected, const char *words) {
  btf_dataset *ds;
  btf_model *model;
  assert_ok(make(ctx, s, &ds));
  assert_status(keep(ds, ctx, codec, settings, job, &model), expected);
  assert_message_has(words);
  assert_null(model);
  btf_dataset_release(ds);
}

static int32_t cancel(void *user, double fraction, const char *stage) {
  (void)user, (void)stage;
  return fraction > 0.1;
}

static void test_refusals(void **state) {
  static const char *const of_fit[] = {"components=3", "psnr=40",      "rmse=0.1",
                                       "mean=true",    "accuracy=0.1", "max_components=4"};
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_job job = BTF_JOB_INIT;
  fill(&s, 1, 3);
  for (size_t i = 0; i < sizeof of_fit / sizeof *of_fit; i++)
    expect_refusal(ctx, &s, "fmf", of_fit[i], NULL, BTF_E_INVALID_ARG, "no effect");
  job.max_working_set = 64;
  expect_refusal(ctx, &s, "fmf", "", &job, BTF_E_LIMIT, "would do");
  job.max_working_set = 0;
  job.progress = cancel;
  expect_refusal(ctx, &s, "fmf", "", &job, BTF_E_CANCELLED, "cancel");
  if (btf_codec_find(ctx, "lafortune") != NULL)
    expect_refusal(ctx, &s, "lafortune", "", NULL, BTF_E_UNSUPPORTED, "cannot hold given factors");
  s.refuses = BTF_E_UNSUPPORTED;
  expect_refusal(ctx, &s, "fmf", "", NULL, BTF_E_UNSUPPORTED, "these are no factors");
  s.refuses = BTF_OK;
  s.products = 3;
  expect_refusal(ctx, &s, "fmf", "", NULL, BTF_E_INVALID_ARG, "3 products");
  s.products = 1;
  s.value_bytes = 8;
  expect_refusal(ctx, &s, "fmf", "", NULL, BTF_E_INVALID_ARG, "8 bytes");
  s.value_bytes = 4;
  s.components[0] = 0;
  expect_refusal(ctx, &s, "fmf", "", NULL, BTF_E_INVALID_ARG, "no components");
  s.components[0] = 1025;
  expect_refusal(ctx, &s, "fmf", "", NULL, BTF_E_UNSUPPORTED, "1025");
  s.components[0] = 3;
  s.texel[0][1][5] = NAN;
  expect_refusal(ctx, &s, "fmf", "", NULL, BTF_E_CORRUPT, "component 1");
  s.texel[0][1][5] = 3e38f;
  s.angular[1][0] = 3e38f;
  expect_refusal(ctx, &s, "fmf", "", NULL, BTF_E_NUMERIC, "component 1");
  fill(&s, VIEWS, 4);
  expect_refusal(ctx, &s, "fmf", "", NULL, BTF_E_UNSUPPORTED, "each view");
  test_context_done(ctx, &memory);
}

static void test_arguments(void **state) {
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds, *held;
  btf_model *model;
  btf_factors f = BTF_FACTORS_INIT;
  static float samples[ROWS * TEXELS];
  fill(&s, 1, 3);
  assert_ok(make(ctx, &s, &ds));
  assert_ok(btf_dataset_factors(ds, &f));
  assert_int_equal(f.products, 1);
  assert_int_equal(f.components[0], 3);
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  assert_ok(btf_dataset_describe(ds, &d));
  assert_true(d.factors == NULL && d.read == NULL); /* they belong to this data set */
  d.data = samples;
  assert_ok(btf_dataset_create(ctx, &d, &held));
  assert_status(btf_dataset_factors(held, &f), BTF_E_UNSUPPORTED);
  assert_message_has("given: holds samples and no factors");
  btf_dataset_release(held);
  d.factors = factors;
  assert_status(btf_dataset_create(ctx, &d, &held), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_factors(NULL, &f), BTF_E_INVALID_ARG);
  f.struct_size = 8;
  assert_status(btf_dataset_factors(ds, &f), BTF_E_ABI);
  const btf_codec *fmf = btf_codec_find(ctx, "fmf");
  assert_status(btf_model_from_factors(NULL, fmf, NULL, NULL, &model), BTF_E_INVALID_ARG);
  assert_status(btf_model_from_factors(ds, NULL, NULL, NULL, &model), BTF_E_INVALID_ARG);
  assert_status(btf_model_from_factors(ds, fmf, NULL, NULL, NULL), BTF_E_INVALID_ARG);
  assert_status(btf_dataset_from_model(NULL, &held), BTF_E_INVALID_ARG);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

/* As storages of fmf, of up to 9 columns; of 8 bits are textures, weights are halves then. Views differ in
 * their number of components. */
static void test_views(void **state) {
  static const struct storage of_views[] = {{"", 12 * 0x1p-24},
                                            {"storage=f32 levels=1", 12 * 0x1p-24},
                                            {"storage=f16", 2 * 0x1p-11},
                                            {"storage=q8", 1.0 / 254 + 0x1p-11}};
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds, *decoded;
  btf_job job = BTF_JOB_INIT;
  btf_model *again;
  if (btf_codec_find(ctx, "pvpca") == NULL) {
    test_context_done(ctx, &memory);
    skip();
  }
  fill(&s, VIEWS, MOST);
  memset(s.texel[1][2], 0, sizeof s.texel[1][2]); /* goes */
  assert_ok(make(ctx, &s, &ds));
  for (size_t i = 0; i < sizeof of_views / sizeof *of_views; i++) {
    btf_model *model;
    assert_ok(keep(ds, ctx, "pvpca", of_views[i].settings, NULL, &model));
    if (worst(&s, model) > of_views[i].bound)
      fail_msg("pvpca %s: %g instead of %g", of_views[i].settings, worst(&s, model), of_views[i].bound);
    assert_ok(btf_dataset_from_model(model, &decoded));
    btf_factors f = BTF_FACTORS_INIT;
    assert_ok(btf_dataset_factors(decoded, &f));
    assert_int_equal(f.products, VIEWS);
    assert_int_equal(f.components[0], MOST);
    assert_int_equal(f.components[1], MOST - 2);
    assert_int_equal(f.value_bytes, strstr(of_views[i].settings, "f32") || i == 0 ? 4 : 2);
    assert_ok(keep(decoded, ctx, "pvpca", "", NULL, &again));
    expect_equal(model, again);
    btf_model_release(again);
    btf_dataset_release(decoded);
    btf_model_release(model);
  }
  btf_dataset_release(ds);
  job.progress = cancel;
  expect_refusal(ctx, &s, "pvpca", "", &job, BTF_E_CANCELLED, "cancel");
  s.components[2] = 65;
  expect_refusal(ctx, &s, "pvpca", "", NULL, BTF_E_UNSUPPORTED, "65 components of view 2");
  s.components[2] = 3;
  s.texel[3][1][5] = 3e38f;
  s.angular[1][ROWS - 1] = 3e38f;
  expect_refusal(ctx, &s, "pvpca", "", NULL, BTF_E_NUMERIC, "component 1 of view 3");
  s.texel[3][1][5] = INFINITY;
  expect_refusal(ctx, &s, "pvpca", "", NULL, BTF_E_CORRUPT, "component 1 of the factors of view 3");
  /* Nothing but zeros. */
  memset(s.texel, 0, sizeof s.texel);
  s.angular[1][ROWS - 1] = 1;
  assert_ok(make(ctx, &s, &ds));
  assert_ok(keep(ds, ctx, "pvpca", "", NULL, &again));
  float got[CHANNELS];
  assert_int_equal(btf_model_texel(again, 0, 1, 1, 2, 0, got), 0);
  assert_true(got[0] == 0 && got[1] == 0);
  btf_model_release(again);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static uint64_t resident(const btf_model *model) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  assert_ok(btf_model_describe(model, &info));
  return info.resident_bytes;
}

/* From 2^-24, the least, to the largest of each column: kept in half the room, and exact but for the sums. */
static void test_halves_of_views(void **state) {
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds;
  btf_model *model, *wide;
  if (btf_codec_find(ctx, "pvpca") == NULL) {
    test_context_done(ctx, &memory);
    skip();
  }
  fill(&s, VIEWS, 4);
  s.value_bytes = 2;
  for (uint32_t k = 0; k < 4; k++) {
    for (uint32_t i = 0; i < ROWS; i++)
      s.angular[k][i] = btf_half_to_float(btf_float_to_half(ldexpf(s.angular[k][i], -(int)(i % 14))));
    for (uint32_t v = 0; v < VIEWS; v++)
      for (uint32_t i = 0; i < TEXELS; i++)
        s.texel[v][k][i] = btf_half_to_float(btf_float_to_half(ldexpf(s.texel[v][k][i], -(int)(i % 14))));
  }
  assert_ok(make(ctx, &s, &ds));
  assert_ok(keep(ds, ctx, "pvpca", "levels=1", NULL, &model));
  assert_ok(keep(ds, ctx, "pvpca", "levels=1 storage=f32", NULL, &wide));
  assert_true(resident(model) < resident(wide));
  assert_true(worst(&s, model) <= 12 * 0x1p-24);
  btf_model_release(model);
  btf_model_release(wide);
  /* Numbers that are none, whatever the source says, make floats. */
  s.texel[2][1][3] = 0.1f;
  assert_ok(keep(ds, ctx, "pvpca", "levels=1", NULL, &model));
  assert_true(worst(&s, model) <= 12 * 0x1p-24);
  btf_model_release(model);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

/* Tiny and huge vectors whose products are near 1 lose nothing by their magnitudes. */
static void test_magnitudes_of_views(void **state) {
  (void)state;
  static source s;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *ds;
  btf_model *model;
  if (btf_codec_find(ctx, "pvpca") == NULL) {
    test_context_done(ctx, &memory);
    skip();
  }
  fill(&s, VIEWS, 4);
  for (uint32_t i = 0; i < ROWS; i++) s.angular[0][i] *= 1e-30f;
  for (uint32_t v = 0; v < VIEWS; v++)
    for (uint32_t i = 0; i < TEXELS; i++) s.texel[v][0][i] *= 1e30f;
  assert_ok(make(ctx, &s, &ds));
  assert_ok(keep(ds, ctx, "pvpca", "", NULL, &model));
  assert_true(worst(&s, model) <= 12 * 0x1p-24);
  btf_model_release(model);
  assert_ok(keep(ds, ctx, "pvpca", "storage=f16", NULL, &model));
  assert_true(worst(&s, model) <= 2 * 0x1p-11);
  btf_model_release(model);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void test_allocations(void **state) {
  static const char *const kinds[][2] = {{"fmf", ""}, {"fmf", "coding=packed storage=f16"}, {"pvpca", ""}};
  (void)state;
  static source s;
  for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
    fill(&s, i == 2 ? VIEWS : 1, 4);
    test_memory memory;
    btf_context *ctx = test_context_with(&memory, NULL, 2);
    btf_dataset *ds;
    btf_status status = BTF_E_NOMEM;
    long fail_at = 0;
    assert_ok(make(ctx, &s, &ds));
    const int there = btf_codec_find(ctx, kinds[i][0]) != NULL;
    while (there && status != BTF_OK) {
      btf_model *model = NULL;
      btf_dataset *decoded = NULL;
      memory.fail_at = memory.total_allocations + ++fail_at;
      status = keep(ds, ctx, kinds[i][0], kinds[i][1], NULL, &model);
      if (status == BTF_OK) status = btf_dataset_from_model(model, &decoded);
      btf_dataset_release(decoded);
      btf_model_release(model);
      if (status != BTF_OK) assert_int_equal(status, BTF_E_NOMEM);
    }
    if (there) assert_true(fail_at > 20);
    memory.fail_at = 0;
    btf_dataset_release(ds);
    test_context_done(ctx, &memory);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_storages),
      cmocka_unit_test(test_levels),
      cmocka_unit_test(test_models_are_data),
      cmocka_unit_test(test_notes),
      cmocka_unit_test(test_notes_of_each_model),
      cmocka_unit_test(test_zeros),
      cmocka_unit_test(test_refusals),
      cmocka_unit_test(test_arguments),
      cmocka_unit_test(test_allocations),
      cmocka_unit_test(test_views),
      cmocka_unit_test(test_halves_of_views),
      cmocka_unit_test(test_magnitudes_of_views),
  };
  return btf_run("factors", tests);
}
