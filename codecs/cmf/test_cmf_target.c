/* SPDX-License-Identifier: MIT */
/* A target quality: met by what is decoded, missed by the next smaller size; out of reach; in a small working
 * set. */
#include "test_cmf_fits.h"

static test_memory memory;

static double rmse_of(const btf_model *model, const material *m) {
  return sqrt(squared_error(model, m) / sample_count(m));
}

static double rmse_with(btf_context *ctx, const material *m, const char *size, const char *others) {
  char settings[400];
  snprintf(settings, sizeof settings, "%s %s", size, others);
  btf_model *model = cmf_fit(ctx, m, settings);
  const double rmse = rmse_of(model, m);
  btf_model_release(model);
  return rmse;
}

/* The power of two of entries that a model was made with, since those without a texel are dropped; 0 = maps
 * of every texel's own. */
static uint32_t entries_of(const btf_model *model) {
  const btfi_cmf_state *s = state_of(model);
  uint32_t most = 0, power = 1;
  for (uint32_t f = 0; f < s->factors; f++)
    if (s->entries[f] > most) most = s->entries[f];
  while (power < most) power *= 2;
  return most > 0 ? power : 0;
}

static uint32_t terms_of(const btf_model *model) {
  const btfi_cmf_state *s = state_of(model);
  return s->factor[s->factors - 1].term + 1;
}

typedef struct size {
  uint32_t entries, terms;
} size;

/* `target` (an rmse of `wanted`) is met, and missed by half the entries, and by one term less. */
static size check_target(btf_context *ctx, const material *m, const char *target, const char *others,
                         double wanted) {
  char text[320];
  snprintf(text, sizeof text, "%s %s", target, others);
  btf_model *model = cmf_fit(ctx, m, text);
  const size found = {entries_of(model), terms_of(model)};
  const double reached = rmse_of(model, m);
  print_message("%s: %u entries, %u terms, rmse %.6g of %.6g\n", text, found.entries, found.terms, reached,
                wanted);
  if (!(reached <= wanted)) fail_msg("%s: rmse %.9g above %.9g", text, reached, wanted);
  btf_model_release(model);
  uint32_t fewer = found.entries / 2;
  if (found.entries == 0) /* the largest codebook of fewer entries than texels */
    for (fewer = 1; 2 * fewer < m->width * m->height;) fewer *= 2;
  snprintf(text, sizeof text, "codebook=%u chain=h,io:%u", found.entries, found.terms);
  /* The same maps and codebooks, decoded alike. */
  assert_relative(rmse_with(ctx, m, text, others), reached, 1e-12);
  if (fewer > 0) {
    snprintf(text, sizeof text, "codebook=%u chain=h,io:%u", fewer, found.terms);
    const double missed = rmse_with(ctx, m, text, others);
    if (missed <= wanted) fail_msg("%s reaches %.9g as well, %.9g was asked", text, missed, wanted);
  }
  if (found.terms > 1) {
    snprintf(text, sizeof text, "codebook=0 chain=h,io:%u", found.terms - 1);
    const double missed = rmse_with(ctx, m, text, others);
    if (missed <= wanted) fail_msg("%s reaches %.9g as well, %.9g was asked", text, missed, wanted);
  }
  return found;
}

/* Each way to meet a target: a codebook, maps of every texel's own, more terms. */
static void test_targets(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:6x3", 9, 7, 3);
  const char *const others[] = {"edge=16 resolution=12 storage=u8",
                                "edge=16 resolution=12 storage=f32 levels=2",
                                "edge=16 resolution=12 storage=f16 rotate=1 cluster=tree levels=1"};
  char target[64];
  for (size_t i = 0; i < 3; i++) {
    const double own = rmse_with(ctx, &m, "codebook=0", others[i]);
    const double few = rmse_with(ctx, &m, "codebook=8", others[i]);
    const double more = rmse_with(ctx, &m, "codebook=0 chain=h,io:2", others[i]);
    assert_true(more < own && own < few);
    snprintf(target, sizeof target, "rmse=%.17g", few * (1.0 + 1e-9));
    size found = check_target(ctx, &m, target, others[i], few * (1.0 + 1e-9));
    assert_true(found.entries > 0 && found.entries <= 8 && found.terms == 1);
    snprintf(target, sizeof target, "rmse=%.17g max_codebook=4", own * (1.0 + 1e-9));
    found = check_target(ctx, &m, target, others[i], own * (1.0 + 1e-9));
    assert_true(found.entries == 0 && found.terms == 1);
    const double between = 0.5 * (more + own);
    snprintf(target, sizeof target, "rmse=%.17g", between);
    found = check_target(ctx, &m, target, others[i], between);
    assert_int_equal(found.terms, 2);
  }
  const double peak = suite_peak(m.samples, (size_t)sample_count(&m)),
               wanted = peak * pow(10.0, -27.0 / 20.0);
  (void)check_target(ctx, &m, "psnr=27", others[0], wanted);
  /* The stricter one of both counts. */
  snprintf(target, sizeof target, "psnr=20 rmse=%.17g", wanted);
  (void)check_target(ctx, &m, target, others[0], wanted);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Out of reach: the best of the sizes that were allowed, and a warning; also where there is but one number of
 * terms. */
static void test_target_out_of_reach(void **unused) {
  (void)unused;
  const struct {
    const char *settings, *best, *others;
  } cases[] = {
      {"rmse=1e-9 max_terms=3", "codebook=0 chain=h,io:3", "edge=12 storage=f32 resolution=8"},
      {"psnr=200 max_codebook=4 chain=i,o", "codebook=0 chain=i,o", "edge=12 storage=f32 resolution=8"},
      {"rmse=1e-9 method=homomorphic max_codebook=0", "codebook=0 method=homomorphic",
       "edge=12 storage=f32"}};
  suite_warnings warnings = {"reach", 0};
  btf_context *ctx = suite_context_counting(&warnings);
  material m = material_create(ctx, BUMPS, "grid:5x3", 4, 3, 2);
  for (size_t i = 0; i < 3; i++) {
    char settings[128];
    snprintf(settings, sizeof settings, "%s %s", cases[i].settings, cases[i].others);
    warnings.count = 0;
    warnings.words = strncmp(settings, "psnr", 4) == 0 ? "reach a psnr of" : "reach an rmse of";
    btf_model *model = cmf_fit(ctx, &m, settings);
    assert_int_equal(warnings.count, 1);
    assert_relative(rmse_of(model, &m), rmse_with(ctx, &m, cases[i].best, cases[i].others), 1e-12);
    btf_model_release(model);
  }
  warnings.count = 0;
  warnings.words = "reach";
  material black = material_create(ctx, ZERO, "grid:4x2", 3, 2, 3);
  assert_true(rmse_with(ctx, &black, "psnr=50", "edge=8 resolution=8") == 0.0);
  assert_int_equal(warnings.count, 0);
  material_release(&black);
  material_release(&m);
  btf_context_release(ctx);
}

static int32_t cancel_after(void *user, double fraction, const char *stage) {
  (void)stage;
  return fraction > *(const double *)user;
}

/* Where the factors of all texels do not fit, codebooks are made of a sample and every one tried factors the
 * texels again. */
static void test_small_working_set(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:5x3", 24, 20, 3);
  const char *const others = "resolution=8 levels=2 edge=16 samples=200";
  const double wanted = 0.15; /* 8 entries of all texels have 0.144 */
  char settings[160];
  btf_job job = BTF_JOB_INIT;
  btf_model *model;
  snprintf(settings, sizeof settings, "rmse=%g max_codebook=16 %s", wanted, others);
  job.max_working_set = 1900u << 10;
  uint64_t before, after, peak;
  btf_context_memory(ctx, &before, NULL);
  assert_ok(cmf_try_fit(ctx, &m, settings, &job, &model));
  btf_context_memory(ctx, &after, &peak);
  /* Beside the result; and the lists and options of a fit, which are not counted. */
  assert_true(peak - before <= job.max_working_set + (after - before) + (64u << 10));
  assert_true(rmse_of(model, &m) <= wanted);
  assert_true(entries_of(model) > 0);
  btf_model_release(model);
  job.max_working_set = 4096;
  assert_status(cmf_try_fit(ctx, &m, settings, &job, &model), BTF_E_LIMIT);
  assert_message_has("working set");
  job = (btf_job)BTF_JOB_INIT;
  for (double at = 0.0; at < 0.8; at += 0.2) {
    job.progress = cancel_after;
    job.user = &at;
    assert_status(cmf_try_fit(ctx, &m, settings, &job, &model), BTF_E_CANCELLED);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void count_errors(void *user, int32_t level, btf_status code, const char *message) {
  (void)code;
  (void)message;
  *(int *)user += level == BTF_LOG_ERROR;
}

/* Terms that the working set does not hold are not tried: that is no error, of which neither the log nor the
 * message of a fit that succeeds may tell. */
static void test_terms_that_do_not_fit(void **unused) {
  (void)unused;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  int errors = 0, fewer = 0, all = 0;
  desc.log = count_errors;
  desc.log_user = &errors;
  assert_ok(btf_context_create(&desc, &ctx));
  material m = material_create(ctx, BUMPS, "grid:5x3", 8, 6, 3);
  btf_job job = BTF_JOB_INIT;
  for (uint64_t kib = 2048; kib <= 4096; kib += kib / 12) {
    btf_model *model;
    errors = 0;
    job.max_working_set = kib << 10;
    const btf_status status =
        cmf_try_fit(ctx, &m, "rmse=1e-9 max_terms=4 resolution=8 levels=1 edge=16", &job, &model);
    assert_true(status == BTF_OK || status == BTF_E_LIMIT);
    assert_int_equal(errors, status != BTF_OK);
    if (status != BTF_OK) continue;
    fewer += terms_of(model) < 4;
    all += terms_of(model) == 4;
    btf_model_release(model);
  }
  assert_true(fewer > 0 && all > 0);
  material_release(&m);
  btf_context_release(ctx);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_targets),
      cmocka_unit_test(test_target_out_of_reach),
      cmocka_unit_test(test_small_working_set),
      cmocka_unit_test(test_terms_that_do_not_fit),
  };
  return btf_run("cmf_target", tests);
}
