/* SPDX-License-Identifier: MIT */
/* Fits: optimality, targets, storages, codings, edge cases, budget, cancelling, failures. */
#include "test_materials.h"

#include "exact_svd.h"

static test_memory memory;

/* Singular values of B, of its columns less their mean if centred, by LAPACK in double precision. */
static double *singular_values(const material *m, bool centred, uint32_t *count) {
  const size_t rows = (size_t)m->count * m->count * m->channels, texels = (size_t)m->width * m->height;
  double *b = malloc(rows * texels * sizeof *b);
  *count = (uint32_t)(rows < texels ? rows : texels);
  for (size_t row = 0; row < rows; row++) {
    const uint32_t c = (uint32_t)(row % m->channels), light = (uint32_t)(row / m->channels % m->count),
                   view = (uint32_t)(row / m->channels / m->count);
    double mean = 0.0;
    for (size_t t = 0; t < texels; t++) {
      b[row * texels + t] =
          material_sample(m, (uint32_t)(t % m->width), (uint32_t)(t / m->width), light, view, c);
      mean += b[row * texels + t] / (double)texels;
    }
    for (size_t t = 0; centred && t < texels; t++) b[row * texels + t] -= mean;
  }
  double *const sigma = exact_singular_values(b, rows, texels);
  free(b);
  return sigma;
}

/* FAC15: the squared error is the tail of the singular values, from both directions of reading. */
static void test_error_is_the_tail(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (int image_major = 0; image_major < 2; image_major++) {
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, image_major, BTF_WRAP_PERIODIC);
    uint32_t count;
    double *sigma = singular_values(&m, false, &count), *centred = singular_values(&m, true, &count);
    const double energy = material_energy(&m);
    const uint32_t components[] = {1, 5, 20, 50};
    for (size_t i = 0; i < 4; i++) {
      for (int mean = 0; mean < 2; mean++) {
        char settings[128];
        snprintf(settings, sizeof settings, "components=%u storage=f32 coding=plain accuracy=1e-6 mean=%d",
                 components[i], mean);
        btf_model *model = fmf_fit(ctx, &m, settings);
        const double tail = exact_tail(mean ? centred : sigma, count, components[i]);
        /* The accuracy asked for twice since squares are compared, and float32: a rounding error d (a few eps
         * of the data's norm) changes the square of the error e by at most 2 d e. */
        const double tolerance = 2.1e-6 + 2.0 * 8.0 * 1.2e-7 * sqrt(energy / tail);
        assert_relative(fmf_squared_error(model, &m), tail, tolerance);
        btf_model_release(model);
      }
    }
    free(sigma);
    free(centred);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* Data of rank 5 is exact with 5 components, and no component of rounding noise is kept beyond them. */
static void test_low_rank_is_exact(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_RANK_5, "grid:6x3", 16, 9, 3, true, BTF_WRAP_PERIODIC);
  const char *const settings[] = {"components=5 storage=f32 coding=plain", "components=5 storage=f32",
                                  "components=32 storage=f32 coding=plain",
                                  "components=32 mean=true storage=f32"};
  for (size_t i = 0; i < 4; i++) {
    btf_model *model = fmf_fit(ctx, &m, settings[i]);
    /* float32 factors: a few eps each; packing may add 1e-7 of the norm. */
    assert_true(sqrt(fmf_squared_error(model, &m) / material_energy(&m)) < 1e-6);
    assert_true(fmf_state(model)->components <= 6);
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* FAC26: more components, less error. */
static void test_error_falls(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
  double before = material_energy(&m);
  for (uint32_t components = 1; components <= 40; components += 3) {
    char settings[64];
    snprintf(settings, sizeof settings, "components=%u", components);
    btf_model *model = fmf_fit(ctx, &m, settings);
    const double error = fmf_squared_error(model, &m);
    assert_true(error < before);
    before = error;
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* A target is met by what is decoded, storage and packing included, and two components fewer miss it. */
static void check_target(btf_context *ctx, const material *m, const char *target, const char *others,
                         double rmse) {
  const double samples = (double)m->count * m->count * m->channels * m->width * m->height;
  char settings[192];
  snprintf(settings, sizeof settings, "%s %s", target, others);
  btf_model *model = fmf_fit(ctx, m, settings);
  const uint32_t components = fmf_state(model)->components, mean = strstr(others, "mean=1") != NULL;
  const double error = sqrt(fmf_squared_error(model, m) / samples);
  if (error > rmse) fail_msg("%s: rmse %.9g above %.9g", settings, error, rmse);
  btf_model_release(model);
  assert_true(components > mean + 2);
  snprintf(settings, sizeof settings, "components=%u %s", components - mean - 2, others);
  model = fmf_fit(ctx, m, settings);
  const double error_with_less = sqrt(fmf_squared_error(model, m) / samples);
  if (error_with_less <= rmse)
    fail_msg("%s reaches %.9g as well, %.9g was asked", settings, error_with_less, rmse);
  btf_model_release(model);
}

static void test_targets(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
  const char *const others[] = {"storage=f16", "storage=f32 coding=plain", "storage=q8 coding=plain",
                                "storage=bf16 mean=1", "storage=f16 mean=1"};
  const double peak = suite_peak(m.samples, (size_t)m.count * m.count * m.channels * m.width * m.height);
  for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
    check_target(ctx, &m, "psnr=38", others[i], peak * pow(10.0, -38.0 / 20.0));
    check_target(ctx, &m, "rmse=0.01", others[i], 0.01);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Out of reach: the best there is, and a warning. */
static void test_target_out_of_reach(void **unused) {
  (void)unused;
  suite_warnings warnings = {"rmse", 0};
  btf_context *ctx = suite_context_counting(&warnings);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
  btf_model *model = fmf_fit(ctx, &m, "rmse=1e-4 max_components=7");
  assert_int_equal(fmf_state(model)->components, 7);
  assert_int_equal(warnings.count, 1);
  btf_model_release(model);
  material_release(&m);
  btf_context_release(ctx);
}

/* What each storage may add. Rounding is relative for f16 and bf16: at most 2^-11 and 2^-8 of each value of
 * either factor (2^-8 is a unit of bf16's 8 bits, halved by rounding), so at most twice that of the norm
 * where the components' errors do not conspire. q8 keeps the rests of the leading components until storage
 * adds 1 % to the squared error. */
static void test_storages(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:8x4", 16, 12, 3, true, BTF_WRAP_PERIODIC);
  const double energy = material_energy(&m);
  for (int packed = 0; packed < 2; packed++) {
    const char *const coding = packed ? "components=24 coding=packed" : "components=24 coding=plain";
    double error[FMF_STORAGES];
    const char *const names[] = {"f32", "f16", "bf16", "q8"};
    for (size_t i = 0; i < FMF_STORAGES; i++) {
      char settings[96];
      snprintf(settings, sizeof settings, "%s storage=%s", coding, names[i]);
      btf_model *model = fmf_fit(ctx, &m, settings);
      error[i] = fmf_squared_error(model, &m);
      btf_model_release(model);
    }
    assert_true(error[FMF_F16] <= error[FMF_F32] * 1.001 + energy * pow(2.0, -20));
    assert_true(error[FMF_BF16] <= error[FMF_F32] * 1.001 + energy * pow(2.0, -14));
    assert_true(error[FMF_Q8] <= error[FMF_F32] * 1.02);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

static long file_size(const char *path) {
  FILE *file = fopen(path, "rb");
  assert_non_null(file);
  fseek(file, 0, SEEK_END);
  const long size = ftell(file);
  fclose(file);
  return size;
}

/* Packed: a whole file at least 2.7 times smaller than the factors as halves, at 0.3 % more error than plain
 * halves. */
static void test_packed_size(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "ubo81", 32, 32, 3, true, BTF_WRAP_PERIODIC);
  const double halves = 2.0 * 32.0 * (81.0 * 81.0 * 3.0 + 32.0 * 32.0);
  btf_model *packed = fmf_fit(ctx, &m, "components=32"),
            *plain = fmf_fit(ctx, &m, "components=32 coding=plain");
  const char *path = test_path("packed.btfz");
  assert_ok(btf_model_save(packed, path, 0, NULL, NULL));
  const double ratio = halves / (double)file_size(path);
  const double growth = sqrt(fmf_squared_error(packed, &m) / fmf_squared_error(plain, &m));
  print_message("packed: %.2f times smaller than halves, error grows by %.3f %%\n", ratio,
                100.0 * (growth - 1.0));
  assert_true(ratio >= 2.7);
  assert_true(growth <= 1.003);
  btf_model_release(packed);
  btf_model_release(plain);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* T28: with f32 storage the columns of U are orthonormal to float32; coarse packing costs about the rounding.
 */
static void test_u_is_orthonormal(void **unused) {
  (void)unused;
  btf_context *ctx = test_context_with(&memory, "scalar", 1);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
  btf_model *model = fmf_fit(ctx, &m, "components=20 storage=f32 coding=plain");
  const btfi_fmf_state *s = fmf_state(model);
  const btfi_fmf_layout *layout = &s->layout;
  double gram[20][20] = {{0}}, v_square[20] = {0}, worst = 0.0;
  uint32_t count;
  double *sigma = singular_values(&m, false, &count);
  for (uint32_t pair = 0; pair < layout->lights * layout->views; pair++)
    for (uint32_t c = 0; c < layout->channels; c++) {
      const float *row =
          (const float *)(const void *)(s->u + pair * layout->u_row_bytes) + c * layout->stride;
      for (int i = 0; i < 20; i++)
        for (int j = 0; j < 20; j++) gram[i][j] += (double)row[i] * row[j];
    }
  for (uint32_t y = 0; y < m.height; y++)
    for (uint32_t x = 0; x < m.width; x++) {
      const float *row =
          (const float *)(const void *)(s->v[0] + y * layout->v_line_bytes[0] + x * layout->v_texel_bytes);
      for (int i = 0; i < 20; i++) v_square[i] += (double)row[i] * row[i];
    }
  /* The tables hold columns scaled to a largest magnitude of 1; lengths and scale make the singular value. */
  for (int i = 0; i < 20; i++) {
    assert_relative(sqrt(gram[i][i] * v_square[i]) * s->scale[i], sigma[i], 1e-4);
    for (int j = 0; j < 20; j++)
      if (i != j) worst = fmax(worst, fabs(gram[i][j]) / sqrt(gram[i][i] * gram[j][j]));
  }
  print_message("largest entry of U^T U - I: %.2g\n", worst);
  assert_true(worst < 2e-6); /* float32 columns: some eps, larger where singular values are close */
  free(sigma);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Sizes at the edges: channels, shapes, one texel, one direction. Enough components make each exact. */
static void test_shapes(void **unused) {
  (void)unused;
  const struct {
    const char *directions;
    uint32_t width, height, channels;
  } shapes[] = {{"grid:4x2", 5, 3, 1}, {"grid:4x2", 3, 7, 5}, {"grid:3x1", 4, 2, 64}, {"grid:4x2", 1, 1, 3},
                {"one", 6, 5, 3},      {"one", 1, 1, 1},      {"grid:4x2", 1, 9, 2},  {"grid:3x2", 33, 2, 3}};
  const char *const settings[] = {"components=80 storage=f32 coding=plain", "components=80 storage=f32",
                                  "components=80 storage=f16", "components=80 storage=q8 mean=true"};
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++) {
    for (int image_major = 0; image_major < 2; image_major++) {
      material m =
          material_create(ctx, MATERIAL_GLOSSY, shapes[i].directions, shapes[i].width, shapes[i].height,
                          shapes[i].channels, image_major, image_major ? BTF_WRAP_CLAMP : BTF_WRAP_PERIODIC);
      for (size_t k = 0; k < 4; k++) {
        btf_model *model = fmf_fit(ctx, &m, settings[k]);
        const double relative = sqrt(fmf_squared_error(model, &m) / material_energy(&m));
        if (relative > (k < 2 ? 1e-6 : 2e-3)) fail_msg("shape %zu, %s: %g", i, settings[k], relative);
        btf_model_release(model);
      }
      material_release(&m);
    }
  }
  test_context_done(ctx, &memory);
}

/* A Lambertian material survives with the default options: its rank-1 factors are refined in the padding of
 * rows. */
static void test_lambertian(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const int kinds[] = {MATERIAL_CONSTANT, MATERIAL_TEXTURED_LAMBERT};
  const char *const settings[2][4] = {
      {"components=32", "coding=plain", "storage=bf16 coding=plain", "storage=q8 coding=plain"},
      {"mean=1", "coding=plain mean=1", "storage=bf16 coding=plain mean=1",
       "storage=q8 coding=plain mean=1"}};
  for (size_t i = 0; i < 2; i++) {
    material m = material_create(ctx, kinds[i], "grid:4x2", 6, 4, 3, true, BTF_WRAP_PERIODIC);
    for (size_t k = 0; k < 4; k++) {
      btf_model *model = fmf_fit(ctx, &m, settings[i][k]);
      /* Float sums over 192 rows: 192 times 2^-24 at most. Of the storage, rests of rests remain: 2^-18 for
       * the 9 bits of bf16, 127^-2 / 2 for q8, of the largest value and on both sides. */
      const float tolerance = 1.15e-5f + (k < 2 ? 0.0f : k == 2 ? 2 * 3.9e-6f : 2 * 3.1e-5f);
      for (uint32_t pair = 0; pair < 64; pair++) {
        float out[3];
        btf_model_texel(model, 0, pair % 6, pair % 4, pair % 8, pair / 8, out);
        for (uint32_t c = 0; c < 3; c++) {
          const float truth = material_sample(&m, pair % 6, pair % 4, pair % 8, pair / 8, c);
          if (fabsf(out[c] - truth) > tolerance * (i == 0 || k < 2 ? truth : 0.24f * 1.2f))
            fail_msg("material %zu, %s: %.9g instead of %.9g, %u components", i, settings[i][k], out[c],
                     truth, fmf_state(model)->components);
        }
      }
      btf_model_release(model);
    }
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* All samples 0. */
static void test_black(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_CONSTANT, "grid:4x2", 4, 4, 3, true, BTF_WRAP_PERIODIC);
  memset(m.samples, 0, (size_t)m.count * m.count * 3 * 16 * sizeof(float));
  const char *const settings[] = {"components=8", "coding=plain", "mean=true", "psnr=40",
                                  "storage=q8 rmse=0.1"};
  for (size_t i = 0; i < 5; i++) {
    btf_model *model = fmf_fit(ctx, &m, settings[i]);
    assert_true(fmf_squared_error(model, &m) == 0.0);
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* The same input gives the same bytes. */
static void test_determinism(void **unused) {
  (void)unused;
  const char *const settings[] = {"components=12", "psnr=35 mean=true",
                                  "components=12 coding=plain storage=q8"};
  for (size_t i = 0; i < 3; i++) {
    char *bytes[2];
    long size[2];
    for (int turn = 0; turn < 2; turn++) {
      btf_context *ctx = test_context_with(&memory, NULL, 2);
      const char *path = test_path("same.btfz");
      material m = material_create(ctx, MATERIAL_CONSTANT, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
      for (size_t n = 0; n < (size_t)m.count * m.count * 3 * 120; n++)
        m.samples[n] = sinf((float)n * 0.37f) + 1.0f;
      btf_model *model = fmf_fit(ctx, &m, settings[i]);
      assert_ok(btf_model_save(model, path, 0, NULL, NULL));
      size[turn] = file_size(path);
      bytes[turn] = malloc((size_t)size[turn]);
      FILE *file = fopen(path, "rb");
      assert_int_equal(fread(bytes[turn], 1, (size_t)size[turn], file), size[turn]);
      fclose(file);
      btf_model_release(model);
      material_release(&m);
      test_context_done(ctx, &memory);
    }
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(bytes[0], bytes[1], (size_t)size[0]);
    free(bytes[0]);
    free(bytes[1]);
  }
}

/* A fit holds no more than its working set, its result twice (factors, then payload and tables) and the
 * histogram of its statistics; the budget does not change the error. */
static void test_budget(void **unused) {
  (void)unused;
  const uint64_t budgets[] = {0, 6u << 20};
  double error[2], data = 0.0;
  for (int turn = 0; turn < 2; turn++) {
    btf_context *ctx = test_context_with(&memory, NULL, 2);
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:12x4", 32, 24, 3, true, BTF_WRAP_PERIODIC);
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    uint64_t peak;
    job.max_working_set = budgets[turn];
    assert_ok(fmf_try_fit(ctx, m.ds, "components=24 mean=true", &job, &model));
    btf_context_memory(ctx, NULL, &peak);
    error[turn] = fmf_squared_error(model, &m);
    data = (double)m.count * m.count * 3 * 768 * 4;
    print_message("data %.1f MiB, budget %.1f MiB, peak %.1f MiB\n", data / 1048576.0,
                  (double)budgets[turn] / 1048576.0, (double)peak / 1048576.0);
    const uint64_t factors = ((uint64_t)m.count * m.count * 3 + 768) * 41 * 4;
    if (turn == 1) assert_true(peak <= budgets[turn] + 3 * factors + (5u << 20));
    btf_model_release(model);
    material_release(&m);
    test_context_done(ctx, &memory);
  }
  assert_true(data > 3.0 * (double)budgets[1]);
  /* Both within 0.05 % of the optimum; packing may differ by a part of its 0.3 %. Squares: */
  assert_relative(error[0], error[1], 2.0 * (0.0005 + 0.0005));
}

typedef struct cancel_after {
  int calls, seen;
  double last;
} cancel_after;

static int32_t cancel_progress(void *user, double fraction, const char *stage) {
  cancel_after *c = user;
  assert_non_null(stage);
  assert_true(fraction >= c->last && fraction <= 1.0);
  c->last = fraction;
  return ++c->seen > c->calls;
}

static void test_cancel(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
  int cancelled = 0;
  for (int calls = 0; calls < 200; calls++) {
    cancel_after c = {calls, 0, 0.0};
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    job.progress = cancel_progress;
    job.user = &c;
    const btf_status status = fmf_try_fit(ctx, m.ds, "psnr=35 mean=true", &job, &model);
    if (status == BTF_OK) {
      assert_true(c.last == 1.0);
      btf_model_release(model);
      break;
    }
    assert_int_equal(status, BTF_E_CANCELLED);
    assert_null(model);
    cancelled++;
  }
  assert_in_range(cancelled, 3, 199);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Every allocation of fit, save and load fails in turn: a status, and no leak. */
static void test_failing_allocations(void **unused) {
  (void)unused;
  const char *const settings[] = {"components=6", "psnr=30 mean=true storage=q8 coding=plain"};
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 6, 4, 3, true, BTF_WRAP_PERIODIC);
  for (size_t i = 0; i < 2; i++) {
    long failures = 0;
    for (long at = 1; at < 5000; at++) {
      const long live = memory.live_blocks;
      btf_model *model = NULL, *loaded = NULL;
      memory.fail_at = memory.total_allocations + at;
      btf_status status = fmf_try_fit(ctx, m.ds, settings[i], NULL, &model);
      if (status == BTF_OK) status = btf_model_save(model, test_path("failing.btfz"), 0, NULL, NULL);
      if (status == BTF_OK) status = btf_model_load(ctx, test_path("failing.btfz"), &loaded);
      const int untouched = memory.total_allocations < memory.fail_at;
      memory.fail_at = 0;
      btf_model_release(model);
      btf_model_release(loaded);
      assert_int_equal(memory.live_blocks, live);
      if (untouched) {
        assert_ok(status);
        break;
      }
      if (status != BTF_OK) assert_int_equal(status, BTF_E_NOMEM);
      failures += status != BTF_OK;
    }
    assert_true(failures > 20);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* A fit that a limit of the context stops says so: BTF_E_LIMIT, not BTF_E_NOMEM, whichever allocation meets
 * it. */
static void test_memory_limit(void **unused) {
  (void)unused;
  btf_allocator allocator = test_allocator(&memory);
  uint32_t refused = 0;
  for (uint64_t limit = 1u << 17;; limit += limit / 4) {
    btf_limits limits = BTF_LIMITS_INIT;
    btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
    btf_context *ctx;
    btf_model *model;
    memory = (test_memory){0};
    limits.max_memory = limit;
    desc.limits = &limits;
    desc.allocator = &allocator;
    desc.max_threads = 1;
    assert_ok(btf_context_create(&desc, &ctx));
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 6, 4, 3, true, BTF_WRAP_PERIODIC);
    const btf_status status = fmf_try_fit(ctx, m.ds, "components=6", NULL, &model);
    btf_model_release(model);
    material_release(&m);
    test_context_done(ctx, &memory);
    if (status == BTF_OK) break;
    assert_int_equal(status, BTF_E_LIMIT);
    refused++;
  }
  assert_true(refused > 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_error_is_the_tail),
                                     cmocka_unit_test(test_low_rank_is_exact),
                                     cmocka_unit_test(test_error_falls),
                                     cmocka_unit_test(test_targets),
                                     cmocka_unit_test(test_target_out_of_reach),
                                     cmocka_unit_test(test_storages),
                                     cmocka_unit_test(test_packed_size),
                                     cmocka_unit_test(test_u_is_orthonormal),
                                     cmocka_unit_test(test_shapes),
                                     cmocka_unit_test(test_lambertian),
                                     cmocka_unit_test(test_black),
                                     cmocka_unit_test(test_determinism),
                                     cmocka_unit_test(test_budget),
                                     cmocka_unit_test(test_cancel),
                                     cmocka_unit_test(test_failing_allocations),
                                     cmocka_unit_test(test_memory_limit)};
  return btf_run("fmf", tests);
}
