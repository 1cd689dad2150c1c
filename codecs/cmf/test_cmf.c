/* SPDX-License-Identifier: MIT */
/* Fits: sizes, normalisation, codebooks, rotation, targets, levels, edge cases, budgets. */
#include "test_cmf_fits.h"

#include "container/container.h"
#include "registry/registry.h"

static test_memory memory;

static uint64_t chunk_bytes(const btf_model *model, uint32_t tag) {
  uint64_t sum = 0;
  for (uint32_t i = 0; i < btfi_payload_chunk_count(model->payload); i++) {
    btfi_chunk chunk;
    assert_ok(btfi_payload_chunk(model->payload, i, &chunk));
    if (chunk.tag == tag) sum += chunk.size;
  }
  return sum;
}

/* ---- FOM01 ---- */

/* Table 2 of Suykens et al.: 256 entries x 3 factors x 3 channels x 32 x 32 bytes are 2.25 MiB; so are the
 * factors of 16 x 16 texels; those of 64 x 64 are 36 MiB, of which the table, with all else that belongs to
 * it, makes 38. Directions do not count, so few will do. Raw data of 50 x 50 and 128 x 128 pairs are RGB
 * floats: 117.19 and 768 MiB, 52.08 and 341.33 times the codebooks (52:1 and, of the 768.4 MiB that are
 * printed, 342:1). */
static void test_sizes(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material small = material_create(ctx, ROTATED, "grid:5x3", 17, 16, 3);
  material square = material_create(ctx, ROTATED, "grid:4x2", 16, 16, 3);
  material large = material_create(ctx, BUMPS, "grid:4x2", 64, 64, 3);
  btf_model *clustered = cmf_fit(ctx, &small, "codebook=256 levels=1 resolution=4");
  btf_model *own = cmf_fit(ctx, &square, "codebook=0 levels=1 resolution=4");
  btf_model *many = cmf_fit(ctx, &large, "codebook=0 levels=1 resolution=4 sweeps=0");
  btf_model *of_many = cmf_fit(ctx, &large, "codebook=256 levels=1 resolution=4 sweeps=0 samples=600");
  assert_int_equal(chunk_bytes(clustered, CMF_TAG_MAPS), 2359296);
  assert_int_equal(chunk_bytes(clustered, CMF_TAG_INDEX), 3 * 17 * 16);
  assert_int_equal(chunk_bytes(clustered, CMF_TAG_SCALE), 3 * 17 * 16);
  assert_int_equal(chunk_bytes(own, CMF_TAG_MAPS), 2359296);
  assert_int_equal(chunk_bytes(many, CMF_TAG_MAPS), 36 * 1048576);
  assert_int_equal(chunk_bytes(many, CMF_TAG_INDEX), 0);
  assert_int_equal(chunk_bytes(many, CMF_TAG_SCALE), 3 * 64 * 64);
  /* An index and a scale of 24 KiB in all are the part that grows with the texture. */
  assert_int_equal(chunk_bytes(of_many, CMF_TAG_MAPS), 2359296);
  assert_int_equal(chunk_bytes(of_many, CMF_TAG_INDEX), 3 * 64 * 64);
  assert_int_equal(chunk_bytes(of_many, CMF_TAG_SCALE), 3 * 64 * 64);
  const double raw[2] = {12.0 * 64 * 64 * 50 * 50, 12.0 * 64 * 64 * 128 * 128};
  const double ratio[2] = {raw[0] / (double)chunk_bytes(of_many, CMF_TAG_MAPS),
                           raw[1] / (double)chunk_bytes(of_many, CMF_TAG_MAPS)};
  assert_near(raw[0], 117.19 * 1048576, 0.005 * 1048576);
  assert_near(raw[1], 768.0 * 1048576, 0.0);
  assert_near(ratio[0], 52.0, 0.5);
  assert_near(ratio[1] * 768.4 / 768.0, 342.0, 0.5);
  print_message("raw %.2f and %.1f MiB, %.2f:1 and %.2f:1\n", raw[0] / 1048576, raw[1] / 1048576, ratio[0],
                ratio[1]);
  btf_model_release(clustered);
  btf_model_release(own);
  btf_model_release(many);
  btf_model_release(of_many);
  material_release(&small);
  material_release(&square);
  material_release(&large);
  test_context_done(ctx, &memory);
}

/* ---- FAC09 ---- */

enum { SCALES = 400 };

/* The energy that scales lose as bytes of which 255 stands for `full`, by the functions that store and
 * restore. */
static double energy_lost(const float scale[SCALES], const double energy[SCALES], float full) {
  double lost = 0.0;
  for (int t = 0; t < SCALES; t++) {
    const float share = fminf(scale[t] / full, 1.0f);
    unsigned char byte;
    float back;
    btfi_cmf_store(CMF_U8, false, &share, 1, &byte);
    btfi_cmf_restore(CMF_U8, false, &byte, 1, &back);
    const double d = 1.0 - (double)(back * full) / (double)scale[t];
    lost += energy[t] * d * d;
  }
  return lost;
}

/* One scale that is 400 times the others would leave them the bytes 1 and 2. Cut to 8 or less it loses its
 * energy of 1 at most, and the others, which are 1 to 2, half a step of 8 / 255 at most: 399 (4 / 255)^2 =
 * 0.099. If it has the energy of a million others nothing is cut, and neither are scales that are bytes. */
static void test_scales_as_bytes(void **unused) {
  (void)unused;
  float scale[SCALES], bytes[SCALES];
  double energy[SCALES];
  for (int t = 0; t < SCALES; t++) {
    scale[t] = 1.0f + (float)t / SCALES;
    bytes[t] = (float)(1 + t % 255);
    energy[t] = 1.0;
  }
  scale[7] = 400.0f;
  const float full = btfi_cmf_full_byte(SCALES, scale, 1, energy, 1);
  assert_true(energy_lost(scale, energy, full) <= 1.0 + 0.099);
  assert_true(energy_lost(scale, energy, 400.0f) > 10.0);
  energy[7] = 1e6;
  assert_true(btfi_cmf_full_byte(SCALES, scale, 1, energy, 1) == 400.0f);
  energy[7] = 1.0;
  assert_true(btfi_cmf_full_byte(SCALES, bytes, 1, energy, 1) == 255.0f);
  assert_true(btfi_cmf_full_byte(0, scale, 1, energy, 1) == 0.0f);
}

static void check_normalisation(uint32_t map, const char *const models[3]) {
  btf_context *ctx = test_context(&memory);
  /* Azimuths of 45 degrees are on the diagonals of cube maps. */
  material m = material_create(ctx, BUMPS, "grid:8x4", 4, 4, 3);
  btf_model *exact = cmf_fit(ctx, &m, models[0]), *bytes = cmf_fit(ctx, &m, models[1]);
  btf_model *halves = cmf_fit(ctx, &m, models[2]);
  /* In float, normalising changes nothing: the decoded error is that of the maps as they were factored. */
  btfi_cmf_settings settings = {.residue = CMF_WEIGHTED,
                                .grid = CMF_ANGULAR,
                                .resolution = 12,
                                .map = map,
                                .edge = 32,
                                .sweeps = 1,
                                .epsilon = 1e-3};
  btfi_cmf_geometry *g;
  btfi_cmf_report report = {0};
  assert_null(btfi_cmf_parse_chain("h,io", &settings));
  assert_ok(
      btfi_cmf_geometry_create(btfi_host(), ctx, &settings, m.set, m.set, 1u << 30, NULL, 0.0, 1.0, &g));
  void *scratch = aligned_alloc(64, g->scratch_bytes);
  float *maps = malloc(sizeof *maps * g->factors * g->map_texels * 3);
  for (uint32_t t = 0; t < 16; t++)
    btfi_cmf_factor_abrdf(g, 3, m.samples + (size_t)t * m.count * m.count * 3, scratch, maps, &report);
  /* Sums of a few thousand floats, and lookups in float instead of double. */
  assert_relative(squared_error(exact, &m), report.squared_error, 1e-3);
  free(maps);
  free(scratch);
  btfi_cmf_geometry_free(btfi_host(), ctx, g);
  /* A value is G s p q r with s, p, q, r within 0 .. 1 and each off by at most half a step of 1 / 255: the
   * product by at most 4 of them (three for the factors as in the paper, one for the scale), to first order
   * from above since the others are at most 1 + half a step. Halves: 2^-11 relative, so at most that
   * absolute. */
  for (uint32_t i = 0; i < 16 * m.count * m.count; i++) {
    const uint32_t light = i % m.count, view = i / m.count % m.count, t = i / m.count / m.count;
    float a[3], b[3], c[3];
    btf_model_texel(exact, 0, t % 4, t / 4, light, view, a);
    btf_model_texel(bytes, 0, t % 4, t / 4, light, view, b);
    btf_model_texel(halves, 0, t % 4, t / 4, light, view, c);
    for (int k = 0; k < 3; k++) {
      const double most = (double)state_of(exact)->global[k];
      assert_near(b[k], a[k], most * 4.0 * 0.5 / 255.0 * 1.01);
      assert_near(c[k], a[k], most * 4.0 / 2048.0 * 1.01);
    }
  }
  btf_model_release(exact);
  btf_model_release(bytes);
  btf_model_release(halves);
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void test_normalisation(void **unused) {
  static const char *const parabolic[] = {"codebook=0 storage=f32 levels=1 resolution=12",
                                          "codebook=0 storage=u8 levels=1 resolution=12",
                                          "codebook=0 storage=f16 levels=1 resolution=12"};
  static const char *const cube[] = {"codebook=0 storage=f32 levels=1 resolution=12 map=cube",
                                     "codebook=0 storage=u8 levels=1 resolution=12 map=cube",
                                     "codebook=0 storage=f16 levels=1 resolution=12 map=cube"};
  (void)unused;
  check_normalisation(CMF_PARABOLIC, parabolic);
  check_normalisation(CMF_CUBE, cube);
}

/* ---- codebooks: FAC12 to FAC14 ---- */

static void test_codebooks(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:6x3", 12, 12, 3);
  btf_model *own = cmf_fit(ctx, &m, "codebook=0 levels=1 edge=16 resolution=12");
  const double least = relative_error(own, &m);
  const char *const kinds[] = {"kmeans", "tree", "mediancut"};
  btf_model_release(own);
  for (int k = 0; k < 3; k++) {
    double before = INFINITY;
    for (uint32_t entries = 4; entries <= 256; entries *= 8) {
      char settings[96];
      snprintf(settings, sizeof settings, "codebook=%u cluster=%s levels=1 edge=16 resolution=12", entries,
               kinds[k]);
      btf_model *model = cmf_fit(ctx, &m, settings);
      const double error = relative_error(model, &m);
      print_message("%s: relative error %.4f; own maps %.4f\n", settings, error, least);
      assert_true(error < before * 1.001);
      before = error;
      btf_model_release(model);
    }
    /* One entry for each texel: its own maps, in the same bytes, times a gain of 1 but for the rounding of
     * sums. */
    assert_relative(before, least, 1e-5);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Copies of four ABRDFs at all angles: turned first, a quarter of the entries does as well. */
static void test_rotation_shrinks_codebooks(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, ROTATED, "grid:12x4", 10, 10, 1);
  btf_model *turned = cmf_fit(ctx, &m, "codebook=4 rotate=1 levels=1 resolution=16 edge=16");
  btf_model *few = cmf_fit(ctx, &m, "codebook=4 levels=1 resolution=16 edge=16");
  btf_model *many = cmf_fit(ctx, &m, "codebook=16 levels=1 resolution=16 edge=16");
  const double a = relative_error(turned, &m), b = relative_error(few, &m), c = relative_error(many, &m);
  print_message("turned, 4 entries: %.4f; not turned, 4: %.4f, 16: %.4f\n", a, b, c);
  assert_true(a <= c);
  assert_true(a < 0.6 * b);
  btf_model_release(turned);
  btf_model_release(few);
  btf_model_release(many);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ---- levels: INT04 ---- */

/* Coarser levels are fits of averaged ABRDFs, so a data set of those averages has the same finest level. */
static void test_levels_are_refits(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:6x3", 8, 8, 3),
           half = material_create(ctx, ZERO, "grid:6x3", 4, 4, 3);
  const size_t length = (size_t)m.count * m.count * 3;
  for (size_t t = 0; t < 16; t++)
    for (size_t i = 0; i < length; i++) {
      const float *from = m.samples + ((t / 4 * 2) * 8 + t % 4 * 2) * length + i;
      half.samples[t * length + i] = (float)(0.25 * ((double)from[0] + (double)from[length] +
                                                     (double)from[8 * length] + (double)from[9 * length]));
    }
  btf_model *fine = cmf_fit(ctx, &m, "codebook=0 storage=f32"),
            *coarse = cmf_fit(ctx, &half, "codebook=0 storage=f32");
  assert_int_equal(state_of(fine)->levels, 4);
  for (uint32_t i = 0; i < 16 * m.count * m.count; i++) {
    const uint32_t light = i % m.count, view = i / m.count % m.count, t = i / m.count / m.count;
    float a[3], b[3];
    btf_model_texel(fine, 1, t % 4, t / 4, light, view, a);
    btf_model_texel(coarse, 0, t % 4, t / 4, light, view, b);
    /* Averages differ by rounding, by which the few turns of alternating least squares may differ as well. */
    for (int c = 0; c < 3; c++) assert_near(a[c], b[c], 1e-4 * (double)state_of(coarse)->global[c]);
  }
  btf_model_release(fine);
  btf_model_release(coarse);
  material_release(&m);
  material_release(&half);
  test_context_done(ctx, &memory);
}

/* ---- edge cases, budgets, cancelling ---- */

static void test_edge_cases(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const struct {
    int kind;
    const char *directions;
    uint32_t width, height, channels;
    double error; /* largest relative error; 0 for data of 0 */
  } materials[] = {{BUMPS, "one", 3, 1, 3, 0.02},
                   {ZERO, "grid:4x2", 2, 3, 3, 0.0},
                   {CONSTANT, "grid:5x3", 1, 1, 4, 0.02},
                   {BUMPS, "grid:4x2", 5, 1, 1, 0.9},
                   {CONSTANT, "grid:4x2", 3, 2, 64, 0.02}};
  for (size_t i = 0; i < sizeof materials / sizeof *materials; i++) {
    material m = material_create(ctx, materials[i].kind, materials[i].directions, materials[i].width,
                                 materials[i].height, materials[i].channels);
    for (size_t k = 0; k < CMF_CASES; k++) {
      char settings[160];
      cmf_case_with(k, "resolution=6", "edge=10", settings, sizeof settings);
      btf_model *model = cmf_fit(ctx, &m, settings);
      if (materials[i].error == 0.0)
        assert_true(squared_error(model, &m) == 0.0);
      else if (k != CMF_CASES - 1) /* cells below the horizon count as 0 in the mean */
        assert_true(relative_error(model, &m) < materials[i].error);
      else
        (void)relative_error(model, &m);
      btf_model_release(model);
    }
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

static int32_t cancel_late(void *user, double fraction, const char *stage) {
  (void)stage;
  return fraction > *(const double *)user;
}

/* Under a small budget texels are factored in runs; too small a one is refused; cancelling leaves nothing
 * behind. */
static void test_budgets(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  /* The factors of 600 texels are 1.3 MiB, of which about two thirds fit. */
  material m = material_create(ctx, BUMPS, "grid:5x3", 24, 20, 3);
  const char *settings = "codebook=8 resolution=8 levels=2 edge=16 samples=200";
  btf_model *roomy = cmf_fit(ctx, &m, settings), *model;
  const double error = relative_error(roomy, &m);
  btf_job job = BTF_JOB_INIT;
  job.max_working_set = 1700u << 10;
  assert_ok(cmf_try_fit(ctx, &m, settings, &job, &model));
  /* Another choice of texels to learn from. */
  assert_true(relative_error(model, &m) < 1.25 * error);
  btf_model_release(model);
  job.max_working_set = 4096;
  assert_status(cmf_try_fit(ctx, &m, settings, &job, &model), BTF_E_LIMIT);
  assert_message_has("working set");
  job = (btf_job)BTF_JOB_INIT;
  for (double at = 0.0; at < 0.95; at += 0.3) {
    job.progress = cancel_late;
    job.user = &at;
    assert_status(cmf_try_fit(ctx, &m, settings, &job, &model), BTF_E_CANCELLED);
  }
  assert_status(cmf_try_fit(ctx, &m, "chain=hd,xy", NULL, &model), BTF_E_INVALID_ARG);
  assert_message_has("xy");
  assert_status(cmf_try_fit(ctx, &m, "chain=h,io:2 method=homomorphic", NULL, &model), BTF_E_INVALID_ARG);
  btf_model_release(roomy);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* What the method or the chain leaves without effect is refused by name; what has one is not. */
static void test_options_without_effect(void **unused) {
  static const char *const cases[][2] = {{"method=homomorphic residue=ratio", "residue"},
                                         {"method=homomorphic sweeps=1", "sweeps"},
                                         {"method=homomorphic average=valid", "average"},
                                         {"method=homomorphic epsilon=0.01", "epsilon"},
                                         {"method=homomorphic grid=parabolic", "grid"},
                                         {"method=homomorphic resolution=8", "resolution"},
                                         {"method=homomorphic symmetric=true", "symmetric"},
                                         {"lambda=3", "lambda"},
                                         {"method=nonnegative lambda=1", "lambda"},
                                         {"method=svd log_floor=0.01", "log_floor"},
                                         {"chain=io factors=3", "factors"},
                                         {"storage=f16 full_scale=largest", "full_scale"}};
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:4x2", 2, 1, 1);
  btf_model *model;
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    assert_status(cmf_try_fit(ctx, &m, cases[i][0], NULL, &model), BTF_E_INVALID_ARG);
    assert_message_has(cases[i][1]);
    assert_message_has("no effect");
  }
  btf_model_release(cmf_fit(ctx, &m, "method=homomorphic lambda=1 log_floor=0.01 factors=4 edge=8"));
  btf_model_release(cmf_fit(ctx, &m,
                            "residue=ratio sweeps=1 average=valid epsilon=0.01 grid=parabolic resolution=8 "
                            "symmetric=true factors=3 edge=8"));
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Keeps the error that a fit tells before storage. */
static void hear_error(void *user, int32_t level, btf_status code, const char *message) {
  const char *const told = strstr(message, "before storage: rmse ");
  (void)code;
  if (level == BTF_LOG_INFO && told != NULL)
    *(double *)user = strtod(told + strlen("before storage: rmse "), NULL);
}

/* It is that of the finest level, each texel once, whatever other levels there are and however often texels
 * are read: six digits are printed, and floats add up to as many. */
static void test_reported_error(void **unused) {
  static const char *const cases[] = {"codebook=0 storage=f32 resolution=8 edge=16",
                                      "codebook=0 storage=f32 method=homomorphic edge=16"};
  (void)unused;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  btf_model *model;
  btf_job job = BTF_JOB_INIT;
  double told = 0.0;
  desc.log = hear_error;
  desc.log_user = &told;
  assert_ok(btf_context_create(&desc, &ctx));
  material m = material_create(ctx, BUMPS, "grid:5x3", 24, 20, 3);
  for (int i = 0; i < 2; i++) {
    model = cmf_fit(ctx, &m, cases[i]);
    assert_relative(told, sqrt(squared_error(model, &m) / sample_count(&m)), 1e-5);
    btf_model_release(model);
  }
  /* As in test_budgets: a sample is factored for the codebooks, then all texels in runs. */
  const char *const settings = "codebook=8 resolution=8 levels=2 edge=16 samples=200";
  btf_model_release(cmf_fit(ctx, &m, settings));
  const double together = told;
  job.max_working_set = 1700u << 10;
  told = 0.0;
  assert_ok(cmf_try_fit(ctx, &m, settings, &job, &model));
  assert_relative(told, together, 1e-5);
  btf_model_release(model);
  material_release(&m);
  btf_context_release(ctx);
}

static void count_advice(void *user, int32_t level, btf_status code, const char *message) {
  (void)code;
  *(int *)user += level == BTF_LOG_WARNING && strstr(message, "cmf: a relative error of ") == message;
}

/* Above `advise` and without a target a warning names what suits the material better. The error is, to the
 * digits of sums of floats, that of decoding every sample. */
static void test_advice(void **unused) {
  (void)unused;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  int warnings = 0;
  char settings[160];
  desc.log = count_advice;
  desc.log_user = &warnings;
  assert_ok(btf_context_create(&desc, &ctx));
  material m = material_create(ctx, BUMPS, "grid:5x3", 6, 5, 3);
  const char *const exact = "codebook=0 storage=f32 resolution=8 edge=16";
  btf_model *model = cmf_fit(ctx, &m, exact);
  const double error = relative_error(model, &m);
  btf_model_release(model);
  warnings = 0;
  for (int above = 0; above < 2; above++) {
    snprintf(settings, sizeof settings, "%s advise=%.9g", exact, error * (above ? 1.0 - 1e-4 : 1.0 + 1e-4));
    btf_model_release(cmf_fit(ctx, &m, settings));
    assert_int_equal(warnings, above);
  }
  snprintf(settings, sizeof settings, "%s advise=0 psnr=1", exact + strlen("codebook=0 "));
  btf_model_release(cmf_fit(ctx, &m, settings));
  assert_int_equal(warnings, 1);
  material_release(&m);
  btf_context_release(ctx);
}

/* Noise down to 0 and next to no smoothness leave the texels between the samples wild: beyond what S can
 * hold.
 */
static void test_wild_factors(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, CONSTANT, "grid:10x5", 2, 1, 1);
  btf_model *model;
  for (uint32_t i = 0; i < 2 * m.count * m.count; i++) m.samples[i] = fmaxf(0.0f, cmf_draw() - 0.5f);
  assert_status(cmf_try_fit(ctx, &m, "method=homomorphic lambda=0.0001 log_floor=0.000001 levels=1 edge=16",
                            NULL, &model),
                BTF_E_NUMERIC);
  assert_message_has("lambda");
  btf_model_release(cmf_fit(ctx, &m, "method=homomorphic levels=1 edge=16"));
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Every allocation fails in turn. */
static void test_failing_allocations(void **unused) {
  (void)unused;
  const char *const settings[] = {"codebook=3 rotate=1 resolution=4 edge=4 factors=4",
                                  "codebook=0 method=homomorphic edge=4 levels=1",
                                  "rmse=1e-9 max_codebook=2 max_terms=2 resolution=4 edge=4"};
  for (size_t i = 0; i < 3; i++)
    for (long at = 1;; at++) {
      btf_context *ctx = test_context_with(&memory, "scalar", 1);
      material m = material_create(ctx, BUMPS, "grid:4x2", 2, 2, 1);
      btf_options *options;
      btf_model *model;
      assert_ok(suite_options(ctx, "cmf", settings[i], &options));
      memory.total_allocations = 0;
      memory.fail_at = at;
      const btf_status status = btf_model_fit(m.ds, btf_codec_find(ctx, "cmf"), options, NULL, &model);
      const bool failed = memory.total_allocations >= at;
      memory.fail_at = 0;
      assert_status(status, failed ? BTF_E_NOMEM : BTF_OK);
      btf_model_release(model);
      btf_options_release(options);
      material_release(&m);
      test_context_done(ctx, &memory);
      if (!failed) break;
    }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_sizes),
      cmocka_unit_test(test_normalisation),
      cmocka_unit_test(test_scales_as_bytes),
      cmocka_unit_test(test_codebooks),
      cmocka_unit_test(test_rotation_shrinks_codebooks),
      cmocka_unit_test(test_levels_are_refits),
      cmocka_unit_test(test_edge_cases),
      cmocka_unit_test(test_budgets),
      cmocka_unit_test(test_options_without_effect),
      cmocka_unit_test(test_reported_error),
      cmocka_unit_test(test_advice),
      cmocka_unit_test(test_wild_factors),
      cmocka_unit_test(test_failing_allocations),
  };
  return btf_run("cmf", tests);
}
