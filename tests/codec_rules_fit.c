/* SPDX-License-Identifier: MIT */
/* Rules of fitting: parameters, repeatability, memory, refusals. */
#include "codec_rules.h"

#include <ctype.h>
#include <time.h>

/* ---- parameters ---- */

static void unknown_parameters(const codec_case *row) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 1);
  btf_options *options;
  char text[64];
  assert_ok(codec_case_options(ctx, row, NULL, &options));
  assert_status(btf_options_set(options, "no_such_parameter", "1"), BTF_E_INVALID_ARG);
  assert_message_has("no_such_parameter");
  assert_message_has(row->codec);
  assert_status(btf_options_set(options, "", "1"), BTF_E_INVALID_ARG);
  assert_status(btf_options_get(options, "no_such_parameter", text, sizeof text), BTF_E_INVALID_ARG);
  btf_options_release(options);
  test_context_done(ctx, &memory);
}

typedef struct patience {
  struct timespec start;
} patience;

/* Parameters at their bounds may ask for hours of work. */
static int32_t give_up(void *user, double fraction, const char *stage) {
  const patience *p = user;
  struct timespec now;
  (void)fraction, (void)stage;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec - p->start.tv_sec >= 2;
}

/* Fits the smallest material: it must work or be refused, with reasons. */
static void fit_with(btf_context *ctx, const codec_case *row, const char *name, const char *value) {
  const codec_dataset_recipe recipe = {MATERIAL_TINY, codec_case_channels(row, 1), SOURCE_RESIDENT, 0, 0.0f,
                                       0.0f};
  btf_job job = BTF_JOB_INIT;
  patience waiting;
  btf_model *model;
  char setting[256];
  snprintf(setting, sizeof setting, "%s=%s", name, value);
  clock_gettime(CLOCK_MONOTONIC, &waiting.start);
  job.progress = give_up;
  job.user = &waiting;
  const btf_status status = codec_case_fit(ctx, row, &recipe, setting, &job, &model);
  if (status == BTF_OK) {
    for (uint32_t i = 0; i < 100; i++) {
      const btf_query q = codec_case_query(i);
      float f[RULE_CHANNELS];
      btf_model_eval(model, &q, f);
      for (uint32_t c = 0; c < recipe.channels; c++) assert_true(isfinite(f[c]));
    }
  } else if ((status != BTF_E_INVALID_ARG && status != BTF_E_UNSUPPORTED && status != BTF_E_LIMIT &&
              status != BTF_E_NUMERIC && status != BTF_E_CANCELLED) ||
             strchr(btf_error_message(), '\n') != NULL || btf_error_message()[0] == '\0') {
    fail_msg("%s: %s: %s", setting, btf_status_name(status), btf_error_message());
  }
  btf_model_release(model);
}

static void expect_taken(btf_options *options, const char *name, const char *value) {
  char text[128];
  assert_ok(btf_options_set(options, name, value));
  assert_ok(btf_options_get(options, name, text, sizeof text));
  assert_string_equal(text, value);
}

static void expect_refused(btf_options *options, const char *name, const char *value) {
  if (btf_options_set(options, name, value) != BTF_E_INVALID_ARG)
    fail_msg("%s=%s is not refused", name, value);
  assert_message_has(name);
}

static void number_bounds(btf_context *ctx, const codec_case *row, btf_options *options,
                          const btf_param_desc *p) {
  const double ends[2] = {p->minimum, p->maximum};
  const double step = p->type == BTF_PARAM_INT ? 1.0 : 0.25;
  char text[64];
  assert_true(p->minimum <= p->maximum);
  for (int i = 0; i < 2; i++) {
    if (isinf(ends[i])) {
      expect_taken(options, p->name, p->type == BTF_PARAM_INT ? "1000000" : "1e30");
      continue;
    }
    snprintf(text, sizeof text, "%.17g", ends[i]);
    expect_taken(options, p->name, text);
    fit_with(ctx, row, p->name, text);
    snprintf(text, sizeof text, "%.17g", ends[i] + (i == 0 ? -step : step));
    expect_refused(options, p->name, text);
  }
  if (p->type == BTF_PARAM_INT) expect_refused(options, p->name, "1.5");
  expect_refused(options, p->name, "nan");
  expect_refused(options, p->name, "");
  expect_refused(options, p->name, "12x");
}

static void parameter_bounds(const codec_case *row) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  const btf_codec *codec = btf_codec_find(ctx, row->codec);
  for (uint32_t i = 0; i < btf_codec_param_count(codec); i++) {
    btf_param_desc p = {.struct_size = sizeof p};
    btf_options *options;
    assert_ok(btf_codec_param(codec, i, &p));
    assert_non_null(p.name);
    assert_true(p.summary != NULL && strlen(p.summary) > 3);
    for (const char *at = p.name; *at != '\0'; at++)
      assert_true(islower((unsigned char)*at) || isdigit((unsigned char)*at) || *at == '_');
    assert_ok(btf_options_create(codec, &options));
    switch (p.type) {
    case BTF_PARAM_INT:
    case BTF_PARAM_FLOAT:
      number_bounds(ctx, row, options, &p);
      break;
    case BTF_PARAM_BOOL:
      expect_taken(options, p.name, "true");
      expect_taken(options, p.name, "false");
      expect_refused(options, p.name, "maybe");
      fit_with(ctx, row, p.name, strcmp(p.default_text, "true") == 0 ? "false" : "true");
      break;
    case BTF_PARAM_CHOICE:
      for (uint32_t k = 0; p.choices[k] != NULL; k++) {
        expect_taken(options, p.name, p.choices[k]);
        fit_with(ctx, row, p.name, p.choices[k]);
      }
      expect_refused(options, p.name, "no_such_choice");
      break;
    default:
      fit_with(ctx, row, p.name, "garbage");
      break;
    }
    btf_options_release(options);
  }
  test_context_done(ctx, &memory);
}

/* ---- repeatability ---- */

static btf_model *fit_job(btf_context *ctx, const codec_case *row, uint32_t material, uint32_t source,
                          uint64_t seed) {
  const codec_dataset_recipe recipe = {material, codec_case_channels(row, 1), source, 0, 0.0f, 0.0f};
  btf_job job = BTF_JOB_INIT;
  btf_model *model;
  job.seed = seed;
  assert_ok(codec_case_fit(ctx, row, &recipe, NULL, &job, &model));
  return model;
}

static void same_seed_same_bytes(const codec_case *row) {
  for (uint32_t threads = 1; threads <= 2; threads++) {
    test_memory memory;
    btf_context *ctx = rule_context(&memory, NULL, threads);
    rule_file files[2];
    for (int i = 0; i < 2; i++) {
      btf_model *model = fit_job(ctx, row, MATERIAL_SMOOTH, SOURCE_RESIDENT, 7);
      rule_save(ctx, model, &files[i]);
      btf_model_release(model);
    }
    assert_int_equal(files[0].size, files[1].size);
    if (memcmp(files[0].bytes, files[1].bytes, files[0].size) != 0)
      fail_msg("two fits of one seed by %u threads differ", threads);
    free(files[0].bytes);
    free(files[1].bytes);
    test_context_done(ctx, &memory);
  }
}

static void expect_close(const btf_model *a, const btf_model *b, double tolerance, const char *what) {
  const double largest = rule_largest(a), difference = rule_difference(a, b);
  if (!(difference <= tolerance * largest))
    fail_msg("%s: they differ by %.3g of the largest value, expected at most %.3g", what,
             difference / largest, tolerance);
}

static void threads_agree(const codec_case *row) {
  test_memory one_memory, two_memory;
  btf_context *one = rule_context(&one_memory, NULL, 1), *two = rule_context(&two_memory, NULL, 2);
  btf_model *a = fit_job(one, row, MATERIAL_SMOOTH, SOURCE_RESIDENT, 3),
            *b = fit_job(two, row, MATERIAL_SMOOTH, SOURCE_RESIDENT, 3);
  expect_close(a, b, row->threads, "one thread and two");
  btf_model_release(a);
  btf_model_release(b);
  test_context_done(one, &one_memory);
  test_context_done(two, &two_memory);
}

static void streamed_equals_resident(const codec_case *row) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  btf_model *resident = fit_job(ctx, row, MATERIAL_SMOOTH, SOURCE_RESIDENT, 3);
  for (uint32_t source = SOURCE_IMAGES; source <= SOURCE_CONCURRENT; source++) {
    btf_model *streamed = fit_job(ctx, row, MATERIAL_SMOOTH, source, 3);
    double rms, rmse, streamed_rmse;
    expect_close(resident, streamed, row->streamed, source == SOURCE_IMAGES ? "images" : "texels");
    rule_errors(resident, MATERIAL_SMOOTH, 0, &rms, &rmse);
    rule_errors(streamed, MATERIAL_SMOOTH, 0, &rms, &streamed_rmse);
    /* The same quality: 1e-5 relative to the data, which holds for fits that go other ways as well. */
    assert_near(streamed_rmse, rmse, 1e-5 * rms + 1e-3 * rmse);
    btf_model_release(streamed);
  }
  btf_model_release(resident);
  test_context_done(ctx, &memory);
}

/* ---- refusals ---- */

static void samples_must_be_finite(const codec_case *row) {
  static const float odd[] = {NAN, INFINITY, -INFINITY};
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  const uint32_t channels = codec_case_channels(row, 1);
  const uint64_t count = codec_material_samples(MATERIAL_SMOOTH, channels);
  const uint64_t places[] = {1, count / 2, count};
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++) {
      const codec_dataset_recipe recipe = {MATERIAL_SMOOTH, channels, SOURCE_RESIDENT,
                                           places[i],       odd[k],   0.0f};
      btf_model *model;
      assert_status(codec_case_fit(ctx, row, &recipe, NULL, NULL, &model), BTF_E_CORRUPT);
      assert_null(model);
    }
  test_context_done(ctx, &memory);
}

static void channels_it_cannot_take(const codec_case *row) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  const btf_codec *codec = btf_codec_find(ctx, row->codec);
  for (uint32_t channels = 1; channels <= 4; channels++) {
    const codec_dataset_recipe recipe = {MATERIAL_TINY, channels, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
    btf_model *model;
    const btf_status status = codec_case_fit(ctx, row, &recipe, NULL, NULL, &model);
    if (channels != 3 && btf_codec_caps(codec) & BTF_CAP_RGB_ONLY)
      assert_int_equal(status, BTF_E_UNSUPPORTED);
    else if (status != BTF_OK && (row->channels & CHANNELS(channels) || status != BTF_E_UNSUPPORTED))
      fail_msg("%u channels: %s: %s", channels, btf_status_name(status), btf_error_message());
    btf_model_release(model);
  }
  test_context_done(ctx, &memory);
}

/* ---- progress ---- */

typedef struct reports {
  double last;
  long calls, cancel_at;
} reports;

static int32_t report(void *user, double fraction, const char *stage) {
  reports *r = user;
  assert_true(stage != NULL && stage[0] != '\0');
  assert_true(fraction >= r->last && fraction <= 1.0); /* never back */
  r->last = fraction;
  return ++r->calls == r->cancel_at;
}

static void progress_and_cancelling(const codec_case *row) {
  const codec_dataset_recipe recipe = {
      MATERIAL_SMOOTH, codec_case_channels(row, 1), SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  long calls = 1;
  for (reports r = {.cancel_at = 1}; r.cancel_at <= calls + 20; r.cancel_at++) {
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    job.progress = report;
    job.user = &r;
    r.last = 0.0;
    r.calls = 0;
    const btf_status status = codec_case_fit(ctx, row, &recipe, NULL, &job, &model);
    calls = r.calls;
    btf_model_release(model);
    if (status == BTF_OK) {
      assert_true(r.calls < r.cancel_at && r.calls >= 1);
      assert_true(r.last == 1.0);
      break;
    }
    assert_int_equal(status, BTF_E_CANCELLED);
    assert_null(model);
    assert_int_equal(r.calls, r.cancel_at); /* and nothing is reported after that */
  }
  test_context_done(ctx, &memory);
}

/* ---- memory ---- */

/* The largest size in the message, in bytes or with a unit. */
static uint64_t named_size(void) {
  uint64_t largest = 0;
  for (const char *at = btf_error_message(); *at != '\0';) {
    if (!isdigit((unsigned char)*at)) {
      at++;
      continue;
    }
    char *end;
    const uint64_t number = strtoull(at, &end, 10);
    const uint64_t unit = strncmp(end, " KiB", 4) == 0   ? UINT64_C(1) << 10
                          : strncmp(end, " MiB", 4) == 0 ? UINT64_C(1) << 20
                          : strncmp(end, " GiB", 4) == 0 ? UINT64_C(1) << 30
                                                         : 1;
    if (number * unit > largest) largest = number * unit;
    at = end;
  }
  return largest;
}

/* The data are streamed, so that all memory beyond the base is the fit's. */
static void working_set_is_kept(const codec_case *row) {
  static const uint64_t budgets[] = {64 << 10, 512 << 10, 4 << 20};
  const uint32_t channels = codec_case_channels(row, 1);
  const codec_dataset_recipe recipe = {MATERIAL_LARGE, channels, SOURCE_CONCURRENT, 0, 0.0f, 0.0f};
  uint64_t last = 0;
  for (size_t i = 0; i < sizeof budgets / sizeof *budgets; i++) {
    test_memory memory;
    btf_context *ctx = rule_context(&memory, NULL, 2);
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    uint64_t base, now, peak;
    job.max_working_set = budgets[i];
    btf_context_memory(ctx, &base, NULL);
    btf_status status = codec_case_fit(ctx, row, &recipe, NULL, &job, &model);
    if (status == BTF_E_LIMIT) {
      /* It says what would do, and that does. */
      job.max_working_set = named_size();
      if (job.max_working_set <= budgets[i]) fail_msg("no size that would do in: %s", btf_error_message());
      if (job.max_working_set == last) { /* as for the budget before, whose fit this would repeat */
        test_context_done(ctx, &memory);
        continue;
      }
      status = codec_case_fit(ctx, row, &recipe, NULL, &job, &model);
    }
    last = job.max_working_set;
    if (status != BTF_OK)
      fail_msg("%llu bytes: %s: %s", (unsigned long long)job.max_working_set, btf_status_name(status),
               btf_error_message());
    btf_context_memory(ctx, &now, &peak);
    /* The result is the payload and the state made of it. */
    if (peak - base > job.max_working_set + (now - base) + row->slack)
      fail_msg("a fit held %llu bytes beside its result of %llu; the working set is %llu and %llu more",
               (unsigned long long)(peak - now), (unsigned long long)(now - base),
               (unsigned long long)job.max_working_set, (unsigned long long)row->slack);
    btf_model_release(model);
    test_context_done(ctx, &memory);
  }
}

/* ---- quality on demand ---- */

/* The 99.9th percentile of the samples. */
static double peak_of(const btf_model_info *info, uint32_t material) {
  const codec_material *m = &codec_materials[material];
  const uint64_t count = codec_material_samples(material, info->channels);
  float *values = malloc(count * sizeof *values);
  size_t n = 0;
  assert_non_null(values);
  for (uint32_t v = 0; v < btf_dirset_count(info->views); v++)
    for (uint32_t l = 0; l < btf_dirset_count(info->lights); l++)
      for (uint32_t y = 0; y < m->height; y++)
        for (uint32_t x = 0; x < m->width; x++)
          for (uint32_t c = 0; c < info->channels; c++)
            values[n++] = codec_material_value(m, btf_dirset_directions(info->lights) + 3 * (size_t)l,
                                               btf_dirset_directions(info->views) + 3 * (size_t)v, x, y, c);
  assert_int_equal(n, count);
  qsort(values, n, sizeof *values, suite_compare_floats);
  const double peak = values[(size_t)(0.999 * (double)(n - 1))];
  free(values);
  return peak;
}

static void quality_on_demand(const codec_case *row) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  btf_options *options;
  char text[64];
  assert_ok(codec_case_options(ctx, row, NULL, &options));
  const int has_target = btf_options_get(options, "psnr", text, sizeof text) == BTF_OK;
  btf_options_release(options);
  const double wanted[2] = {25.0, row->most_psnr > 0.0 ? row->most_psnr : 40.0};
  for (int i = 0; has_target && i < 2; i++) {
    const double psnr = wanted[i];
    double rms, rmse;
    snprintf(text, sizeof text, "psnr=%g", psnr);
    btf_model *model = rule_fit(ctx, row, MATERIAL_SMOOTH, codec_case_channels(row, 3), text);
    const btf_model_info info = rule_describe(model);
    rule_errors(model, MATERIAL_SMOOTH, 0, &rms, &rmse);
    const double reached = 20.0 * log10(peak_of(&info, MATERIAL_SMOOTH) / rmse);
    /* Codecs find the peak in a histogram whose bins are a hundredth or two wide: 0.2 dB. */
    if (!(reached >= psnr - 0.2)) fail_msg("%.2f dB, asked for were %g", reached, psnr);
    btf_model_release(model);
  }
  test_context_done(ctx, &memory);
}

/* ---- units ---- */

/* Samples in other units give the same model in those units. Powers of two change no bit of a sample, so what
 * is left are floats that leave their range inside of a fit: 2^50 and 2^-50, about 1e15 and 1e-15, leave room
 * for squares, while at 2^66 and 2^-83, 7e19 and 1e-25, those are beyond it. A fit may say that it cannot. */
static void scales(const codec_case *row) {
  static const int exponents[] = {0, 50, -50, 66, -83};
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  btf_options *options;
  char rmse[64];
  double at_one = 0.0;
  assert_ok(codec_case_options(ctx, row, NULL, &options));
  const double wanted =
      btf_options_get(options, "rmse", rmse, sizeof rmse) == BTF_OK ? strtod(rmse, NULL) : 0.0;
  btf_options_release(options);
  for (size_t i = 0; i < sizeof exponents / sizeof *exponents; i++) {
    const double scale = ldexp(1.0, exponents[i]);
    const codec_dataset_recipe recipe = {
        MATERIAL_SMOOTH, codec_case_channels(row, 3), SOURCE_RESIDENT, 0, 0.0f, (float)scale};
    btf_model *model;
    snprintf(rmse, sizeof rmse, "rmse=%.17g", wanted * scale); /* the one option that has a unit */
    const btf_status status = codec_case_fit(ctx, row, &recipe, wanted > 0.0 ? rmse : NULL, NULL, &model);
    if (i > 0 && (status == BTF_E_NUMERIC || status == BTF_E_UNSUPPORTED)) {
      assert_true(strlen(btf_error_message()) > 10 && strchr(btf_error_message(), '\n') == NULL);
      continue;
    }
    if (status != BTF_OK)
      fail_msg("times 2^%d: %s: %s", exponents[i], btf_status_name(status), btf_error_message());
    const double error = rule_scaled_error(model, MATERIAL_SMOOTH, scale);
    if (i == 0) at_one = error;
    /* As for streamed data: the same quality, though a fit may go other ways. */
    if (!(fabs(error - at_one) <= 1e-5 + 1e-3 * at_one))
      fail_msg("times 2^%d: relative error %.6g, times 1 %.6g", exponents[i], error, at_one);
    btf_model_release(model);
  }
  test_context_done(ctx, &memory);
}

const codec_rule codec_fit_rules[] = {
    {"unknown parameters", unknown_parameters},
    {"parameter bounds", parameter_bounds},
    {"same seed, same bytes", same_seed_same_bytes},
    {"threads agree", threads_agree},
    {"streamed equals resident", streamed_equals_resident},
    {"samples must be finite", samples_must_be_finite},
    {"channels it cannot take", channels_it_cannot_take},
    {"progress and cancelling", progress_and_cancelling},
    {"working set is kept", working_set_is_kept},
    {"quality on demand", quality_on_demand},
    {"scales", scales},
};
const size_t codec_fit_rule_count = sizeof codec_fit_rules / sizeof *codec_fit_rules;
