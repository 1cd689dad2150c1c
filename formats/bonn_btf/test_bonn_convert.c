/* SPDX-License-Identifier: MIT */
/* Factored files as models, against brute force from the description of the format: every family and colour
 * model that converts, and the reasons of those that do not. */
#include "bonn_case.h"
#include "../source/test_format.h"
#include "codec_suite.h"

/* Of the sum of the sizes of all products in a sample. Each of up to 100 products, or of 12 with a colour
 * model, is rounded once when it is added, and its two numbers and the colour weight once each: (100 + 3) *
 * 2^-24 = 6.2e-6 at most. */
static const double exact = 1e-5;

typedef struct conversion {
  bonn_case c;
  btf_context *ctx;
  test_memory memory;
  const char *path;
  btf_dataset *ds;
} conversion;

static void begin(conversion *t, const bonn_case *c) {
  t->c = *c;
  t->ctx = format_context(&t->memory);
  t->path = test_path("factored.dat");
  bonn_bytes bytes = bonn_case_write(c);
  test_write_bytes(t->path, bytes.data, bytes.size);
  free(bytes.data);
  assert_ok(btf_format_open(t->ctx, t->path, NULL, NULL, &t->ds));
}

static void end(conversion *t) {
  btf_dataset_release(t->ds);
  test_context_done(t->ctx, &t->memory);
}

static btf_status convert(const conversion *t, const char *codec, const char *settings, const btf_job *job,
                          btf_model **out) {
  btf_options *options;
  assert_ok(suite_options(t->ctx, codec, settings, &options));
  const btf_status status = btf_model_from_factors(t->ds, btf_codec_find(t->ctx, codec), options, job, out);
  btf_options_release(options);
  return status;
}

/* Whether a description says that reflectance is linear in what is stored. */
static bool converts(const bonn_case *c) {
  const bool linear =
      c->colour_model == 0 || c->colour_model == 1 || c->colour_model == 3 || c->colour_model == 4;
  return c->family != BONN_CASE_BDI && linear && c->dynamic_range == 0;
}

static uint32_t below(uint64_t *seed, uint32_t n) {
  *seed = *seed * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (uint32_t)((*seed >> 33) % n);
}

/* `storage` is what storing makes of values of about 1, or `exact`. */
static void compare(const conversion *t, const btf_model *model, double storage) {
  const bonn_case *c = &t->c;
  uint64_t seed = 1;
  double worst = 0;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  assert_ok(btf_model_describe(model, &info));
  assert_int_equal(info.quantity, c->cosine ? BTF_QUANTITY_BRDF_COS : BTF_QUANTITY_BRDF);
  for (int i = 0; i < 10000; i++) {
    const uint32_t view = below(&seed, c->views), light = below(&seed, c->lights);
    const uint32_t x = below(&seed, c->width), y = below(&seed, c->height);
    const float *l = btf_dirset_directions(info.lights) + 3 * light,
                *v = btf_dirset_directions(info.views) + 3 * view;
    const btf_query query = {{l[0], l[1], l[2]},
                             {v[0], v[1], v[2]},
                             {((float)x + 0.5f) / (float)c->width, ((float)y + 0.5f) / (float)c->height},
                             0,
                             BTF_QUERY_NEAREST};
    float texel[64], value[64];
    assert_int_equal(btf_model_texel(model, 0, x, y, light, view, texel), 0);
    btf_model_eval_as(model, &query, BTF_VALUE_STORED, value);
    for (uint32_t k = 0; k < c->channels; k++) {
      const double expected = bonn_case_sample(c, view, light, x, y, k);
      const double unit = storage > exact ? fmax(1, fabs(expected)) : bonn_case_size(c, view, light, x, y, k),
                   bound = storage * unit;
      worst = fmax(worst, fmax(fabs(texel[k] - expected), fabs(value[k] - expected)) / unit);
      if (!(fabs(texel[k] - expected) <= bound) || !(fabs(value[k] - expected) <= bound))
        fail_msg("%s: view %u light %u texel %u %u channel %u: %.9g and %.9g instead of %.9g", c->label, view,
                 light, x, y, k, (double)texel[k], (double)value[k], expected);
    }
  }
  print_message("%s%s, %u bytes a number: largest difference of 10000 samples %.3g, relative to %s\n",
                c->label, c->uneven ? ", all bits" : "", c->scalar_size, worst,
                storage > exact ? "the larger of 1 and the value" : "the sum of the sizes of its products");
}

/* Between the samples, the model interpolates what the file's samples are as a model of their own. */
static void compare_between(const conversion *t, const btf_model *model, double tolerance) {
  btf_model *raw;
  uint64_t seed = 2;
  assert_ok(btf_model_from_dataset(t->ds, NULL, &raw));
  for (int i = 0; i < 1000; i++) {
    btf_query query = {.lod = 0};
    float direction[2][3], expected[64], got[64];
    for (int k = 0; k < 2; k++) {
      const double z = 0.2 + 0.8 * below(&seed, 1000) / 1000.0, phi = 6.2831853 * below(&seed, 1000) / 1000.0;
      direction[k][0] = (float)(sqrt(1 - z * z) * cos(phi));
      direction[k][1] = (float)(sqrt(1 - z * z) * sin(phi));
      direction[k][2] = (float)z;
    }
    memcpy(query.light, direction[0], sizeof query.light);
    memcpy(query.view, direction[1], sizeof query.view);
    query.uv[0] = (float)below(&seed, 1000) / 1000;
    query.uv[1] = (float)below(&seed, 1000) / 1000;
    btf_model_eval_as(raw, &query, BTF_VALUE_STORED, expected);
    btf_model_eval_as(model, &query, BTF_VALUE_STORED, got);
    for (uint32_t k = 0; k < t->c.channels; k++)
      assert_near(got[k], expected[k], tolerance * fmax(1, fabs((double)expected[k])));
  }
  btf_model_release(raw);
}

static uint64_t resident(const btf_model *model) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  assert_ok(btf_model_describe(model, &info));
  return info.resident_bytes;
}

static void test_every_case(void **state) {
  (void)state;
  size_t converted = 0, views_converted = 0;
  for (size_t i = 0; i < bonn_case_count; i++) {
    conversion t;
    btf_model *model;
    begin(&t, &bonn_cases[i]);
    if (!converts(&t.c)) {
      assert_status(convert(&t, "fmf", "", NULL, &model), BTF_E_UNSUPPORTED);
      assert_null(model);
      assert_message_has(t.path);
      assert_message_has(t.c.family == BONN_CASE_BDI ? "samples"
                         : t.c.dynamic_range != 0    ? "logarithms"
                                                     : "not linear");
    } else if (t.c.family == BONN_CASE_PVF) {
      assert_status(convert(&t, "fmf", "", NULL, &model), BTF_E_UNSUPPORTED);
      assert_message_has("each view");
      assert_ok(convert(&t, "pvpca", "", NULL, &model));
      compare(&t, model, exact);
      compare_between(&t, model, exact);
      btf_model_release(model);
      views_converted++;
    } else {
      assert_status(convert(&t, "pvpca", "", NULL, &model), BTF_E_UNSUPPORTED);
      assert_message_has("fmf");
      assert_ok(convert(&t, "fmf", "", NULL, &model));
      compare(&t, model, exact);
      compare_between(&t, model, exact);
      btf_model_release(model);
      converted++;
    }
    end(&t);
  }
  assert_int_equal(converted, 11);
  assert_int_equal(views_converted, 3);
}

/* Numbers of all bits: 10000 samples of files of floats and of halves. Products of 24 bits are rounded, and
 * up to four are added: 7 roundings of sums below 4 are within 7 * 2^-23 < exact. */
static void test_uneven(void **state) {
  (void)state;
  static const char *const labels[] = {
      "FMF float, cosine", "FMF half", "FMF double, xml", "DFMF RGB", "DFMF YUV",
      "FMF by texel",      "PVF",      "PVF by texel"};
  for (size_t i = 0; i < sizeof labels / sizeof *labels; i++) {
    conversion t;
    btf_model *model;
    bonn_case c = bonn_case_named(labels[i]);
    c.uneven = true;
    begin(&t, &c);
    assert_ok(convert(&t, c.family == BONN_CASE_PVF ? "pvpca" : "fmf", "", NULL, &model));
    compare(&t, model, exact);
    compare_between(&t, model, exact);
    btf_model_release(model);
    end(&t);
  }
}

/* Storage of the caller's choice, and what halves make of colour weights that are none: each of two vectors
 * of a product rounds to 2^-11 of its largest magnitude, and the magnitudes of a channel sum up to 12.3. */
static void test_storage(void **state) {
  (void)state;
  conversion t;
  btf_model *model;
  const bonn_case yuv = bonn_case_named("DFMF YUV"), half = bonn_case_named("FMF half");
  begin(&t, &yuv);
  assert_ok(convert(&t, "fmf", "storage=f16", NULL, &model));
  compare(&t, model, 12.3 * (2 * 0x1p-11 + 0x1p-22));
  btf_model_release(model);
  assert_ok(convert(&t, "fmf", "storage=f32 coding=packed", NULL, &model));
  compare(&t, model, exact);
  btf_model_release(model);
  end(&t);
  /* Halves stay halves without a loss, and take half the memory. */
  begin(&t, &half);
  btf_model *wide;
  assert_ok(convert(&t, "fmf", "", NULL, &model));
  assert_ok(convert(&t, "fmf", "storage=f32", NULL, &wide));
  assert_true(resident(model) < resident(wide));
  compare(&t, model, exact);
  btf_model_release(model);
  btf_model_release(wide);
  end(&t);
}

/* 100 components, each channel by itself: 300 of ours. */
static void test_many_components(void **state) {
  (void)state;
  conversion t;
  btf_model *model;
  bonn_case c = bonn_case_named("DFMF RGB");
  c.views = 12;
  c.lights = 10;
  c.width = 12;
  c.height = 11;
  c.components = 100;
  begin(&t, &c);
  assert_ok(convert(&t, "fmf", "", NULL, &model));
  compare(&t, model, exact);
  btf_model_release(model);
  end(&t);
  c.views = c.lights = 19;
  c.width = c.height = 19;
  c.components = 342;
  begin(&t, &c);
  assert_status(convert(&t, "fmf", "", NULL, &model), BTF_E_UNSUPPORTED);
  assert_message_has("1026");
  end(&t);
}

static void test_not_finite(void **state) {
  (void)state;
  conversion t;
  btf_model *model;
  const bonn_case c = bonn_case_named("FMF float, cosine");
  begin(&t, &c);
  btf_dataset_release(t.ds);
  bonn_bytes bytes = bonn_case_write(&c);
  memset(bytes.data + bytes.size - 4, 0xff, 4);
  test_write_bytes(t.path, bytes.data, bytes.size);
  free(bytes.data);
  assert_ok(btf_format_open(t.ctx, t.path, NULL, NULL, &t.ds));
  assert_status(convert(&t, "fmf", "", NULL, &model), BTF_E_CORRUPT);
  assert_message_has("not finite");
  assert_null(model);
  end(&t);
}

/* Values are 0 or of magnitude 1/64 to 1 and multiples of 1/64. */
static void test_views_storage(void **state) {
  (void)state;
  conversion t;
  btf_model *model, *wide;
  const bonn_case half = bonn_case_named("PVF"), single = bonn_case_named("PVF by texel");
  begin(&t, &half);
  assert_ok(convert(&t, "pvpca", "", NULL, &model));
  assert_ok(convert(&t, "pvpca", "storage=f32", NULL, &wide));
  assert_true(resident(model) < resident(wide));
  compare(&t, wide, exact);
  compare_between(&t, wide, exact);
  btf_model_release(model);
  btf_model_release(wide);
  /* Of three components and the mean, bytes lose up to 1/254 of a texture's 1 times a weight of at most 1;
   * the texture of the mean is 1 everywhere, which 127 is. */
  assert_ok(convert(&t, "pvpca", "storage=q8 levels=1", NULL, &model));
  compare(&t, model, 3 / 254.0 + exact);
  btf_model_release(model);
  end(&t);
  begin(&t, &single);
  assert_ok(convert(&t, "pvpca", "", NULL, &model));
  assert_ok(convert(&t, "pvpca", "storage=f16", NULL, &wide));
  assert_true(resident(wide) < resident(model)); /* a file of floats is kept in floats */
  compare(&t, wide, exact);                      /* which are halves here */
  btf_model_release(model);
  btf_model_release(wide);
  end(&t);
}

/* Every view as a sum of components too many, and at the limit. */
static void test_many_in_a_view(void **state) {
  (void)state;
  conversion t;
  btf_model *model;
  bonn_case c = bonn_case_named("PVF");
  c.lights = 30;
  c.width = c.height = 9;
  c.components = 63; /* and the mean */
  begin(&t, &c);
  assert_ok(convert(&t, "pvpca", "", NULL, &model));
  compare(&t, model, exact);
  btf_model_release(model);
  end(&t);
  c.components = 64;
  begin(&t, &c);
  assert_status(convert(&t, "pvpca", "", NULL, &model), BTF_E_UNSUPPORTED);
  assert_message_has("65 components of view 0");
  assert_null(model);
  end(&t);
}

/* Area averages of the finest level, of a size that halves evenly: those of the samples. Four products and
 * their mean round as the samples do; so do averages that halves hold, to 2^-11 of sums up to 4. */
static void test_levels_of_views(void **state) {
  (void)state;
  conversion t;
  btf_model *model;
  bonn_case c = bonn_case_named("PVF");
  c.width = c.height = 4;
  begin(&t, &c);
  assert_ok(convert(&t, "pvpca", "", NULL, &model));
  btf_model_info info = BTF_MODEL_INFO_INIT;
  assert_ok(btf_model_describe(model, &info));
  assert_int_equal(info.levels, 3);
  for (uint32_t v = 0; v < c.views; v++)
    for (uint32_t l = 0; l < c.lights; l++)
      for (uint32_t level = 1; level < 3; level++) {
        const uint32_t side = 4u >> level, run = 1u << level;
        for (uint32_t i = 0; i < side * side; i++) {
          float texel[64];
          assert_int_equal(btf_model_texel(model, level, i % side, i / side, l, v, texel), 0);
          for (uint32_t k = 0; k < c.channels; k++) {
            double mean = 0;
            for (uint32_t y = 0; y < run; y++)
              for (uint32_t x = 0; x < run; x++)
                mean += bonn_case_sample(&c, v, l, i % side * run + x, i / side * run + y, k) / (run * run);
            assert_near(texel[k], mean, 4 * 0x1p-11);
          }
        }
      }
  btf_model_release(model);
  end(&t);
}

/* A model's factors are what it decodes, whatever its tables look like: fitted halves and bytes, the mean
 * apart, colours on either side. Samples are up to 4 and a texel of a view has 15, so that no product of an
 * eigenvector and its projection is beyond 4 * sqrt(15) < 16; up to 10 are added, rounded 4 times each. */
static void test_factors_of_models(void **state) {
  (void)state;
  static const char *const fits[] = {"components=2", "components=2 color=texels storage=f32",
                                     "components=3 storage=q8", "components=1 mean=false budget=adaptive",
                                     "components=3 color=texels storage=q8 budget=adaptive"};
  conversion t;
  const bonn_case c = bonn_case_named("PVF");
  begin(&t, &c);
  btf_dataset *const measured = t.ds;
  for (size_t i = 0; i < sizeof fits / sizeof *fits; i++) {
    btf_model *fitted, *kept;
    btf_options *options;
    assert_ok(suite_options(t.ctx, "pvpca", fits[i], &options));
    assert_ok(btf_model_fit(measured, btf_codec_find(t.ctx, "pvpca"), options, NULL, &fitted));
    btf_options_release(options);
    assert_ok(btf_dataset_from_model(fitted, &t.ds));
    assert_ok(convert(&t, "pvpca", "", NULL, &kept));
    for (uint32_t v = 0; v < c.views; v++)
      for (uint32_t l = 0; l < c.lights; l++)
        for (uint32_t y = 0; y < c.height; y++)
          for (uint32_t x = 0; x < c.width; x++) {
            float expected[64], got[64];
            assert_int_equal(btf_model_texel(fitted, 0, x, y, l, v, expected), 0);
            assert_int_equal(btf_model_texel(kept, 0, x, y, l, v, got), 0);
            for (uint32_t k = 0; k < c.channels; k++) assert_near(got[k], expected[k], 10 * 16 * 0x1p-22);
          }
    if (i == 0) { /* halves stay halves: all columns are as wide as before, and the mean has weights now */
      assert_true(resident(kept) < resident(fitted) + (uint64_t)c.views * (2u * c.channels * c.lights + 40));
    }
    btf_model_release(kept);
    btf_model_release(fitted);
    btf_dataset_release(t.ds);
  }
  t.ds = measured;
  end(&t);
}

static void test_views_refusals(void **state) {
  (void)state;
  static const char *const of_fit[][2] = {
      {"components=3", "components"}, {"psnr=40", "psnr"},
      {"rmse=0.1", "rmse"},           {"max_components=9", "max_components"},
      {"budget=adaptive", "budget"},  {"mean=false", "mean"},
      {"color=texels", "color"}};
  conversion t;
  btf_model *model;
  bonn_case c = bonn_case_named("PVF");
  c.width = c.height = 64;
  begin(&t, &c);
  for (size_t i = 0; i < sizeof of_fit / sizeof *of_fit; i++) {
    assert_status(convert(&t, "pvpca", of_fit[i][0], NULL, &model), BTF_E_INVALID_ARG);
    assert_message_has(of_fit[i][1]);
    assert_message_has("no effect");
    assert_null(model);
  }
  btf_job job = BTF_JOB_INIT;
  job.max_working_set = 65536;
  assert_status(convert(&t, "pvpca", "", &job, &model), BTF_E_LIMIT);
  assert_message_has("1 MiB would do");
  job.max_working_set = 1 << 20;
  assert_ok(convert(&t, "pvpca", "", &job, &model));
  btf_model_release(model);
  btf_dataset_release(t.ds);
  bonn_bytes bytes = bonn_case_write(&c);
  memset(bytes.data + bytes.size - 2, 0xff, 2);
  test_write_bytes(t.path, bytes.data, bytes.size);
  free(bytes.data);
  assert_ok(btf_format_open(t.ctx, t.path, NULL, NULL, &t.ds));
  assert_status(convert(&t, "pvpca", "", NULL, &model), BTF_E_CORRUPT);
  assert_message_has("of view 3 is not finite");
  assert_null(model);
  end(&t);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_every_case),        cmocka_unit_test(test_uneven),
      cmocka_unit_test(test_storage),           cmocka_unit_test(test_many_components),
      cmocka_unit_test(test_not_finite),        cmocka_unit_test(test_views_storage),
      cmocka_unit_test(test_many_in_a_view),    cmocka_unit_test(test_levels_of_views),
      cmocka_unit_test(test_factors_of_models), cmocka_unit_test(test_views_refusals)};
  return btf_run("bonn_convert", tests);
}
