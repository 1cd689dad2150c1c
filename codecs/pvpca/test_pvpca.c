/* SPDX-License-Identifier: MIT */
/* Fits: optimality of every view, terms and sizes, targets, budgets of terms and of memory, edge cases. */
#include "test_views.h"

#include "exact_svd.h"

static test_memory memory;

/* Singular values of a view's matrix, of its columns less their mean if centred, by LAPACK in double. */
static double *singular_values(const material *m, uint32_t view, int by_light, int centred, uint32_t *count) {
  const size_t texels = (size_t)m->width * m->height;
  const size_t rows = by_light ? (size_t)m->count * m->channels : m->count;
  const size_t columns = by_light ? texels : texels * m->channels;
  double *a = malloc(rows * columns * sizeof *a);
  *count = (uint32_t)(rows < columns ? rows : columns);
  for (size_t t = 0; t < texels; t++)
    for (uint32_t light = 0; light < m->count; light++)
      for (uint32_t c = 0; c < m->channels; c++) {
        const size_t row = by_light ? (size_t)light * m->channels + c : light;
        const size_t column = by_light ? t : t * m->channels + c;
        a[row * columns + column] =
            material_sample(m, (uint32_t)(t % m->width), (uint32_t)(t / m->width), light, view, c);
      }
  for (size_t column = 0; centred && column < columns; column++) {
    double mean = 0.0;
    for (size_t row = 0; row < rows; row++) mean += a[row * columns + column] / (double)rows;
    for (size_t row = 0; row < rows; row++) a[row * columns + column] -= mean;
  }
  double *const sigma = exact_singular_values(a, rows, columns);
  free(a);
  return sigma;
}

static double view_energy(const material *m, uint32_t view) {
  double energy = 0.0;
  for (uint32_t light = 0; light < m->count; light++)
    for (uint32_t t = 0; t < m->width * m->height; t++)
      for (uint32_t c = 0; c < m->channels; c++)
        energy += pow(material_sample(m, t % m->width, t / m->width, light, view, c), 2.0);
  return energy;
}

/* FAC23: the squared error of each view is the tail of its singular values, with colours on either side, more
 * texels than lights and fewer, and both orders of samples. */
static void test_error_is_the_tail(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const uint32_t sizes[][2] = {{9, 7}, {5, 3}}; /* 63 and 15 texels, 63 and 45 values; 48 and 16 rows */
  for (uint32_t i = 0; i < 16; i++) {
    const uint32_t *size = sizes[i & 1];
    const int by_light = i >> 1 & 1, centred = i >> 2 & 1, image_major = i >> 3 & 1;
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:8x2", size[0], size[1], 3, image_major,
                                 BTF_WRAP_PERIODIC);
    for (uint32_t terms = 1; terms <= 8; terms += 3) {
      char settings[128];
      snprintf(settings, sizeof settings, "components=%u storage=f32 color=%s mean=%d", terms,
               by_light ? "lights" : "texels", centred);
      btf_model *model = pvpca_fit(ctx, &m, settings);
      double predicted = 0.0;
      for (uint32_t view = 0; view < m.count; view++) {
        uint32_t count;
        double *sigma = singular_values(&m, view, by_light, centred, &count);
        const double tail = exact_tail(sigma, count, terms), energy = view_energy(&m, view);
        /* Float products in the Gram matrix are off by d = 2^-24 of sqrt(512 rows) of the energy at most,
         * which turns eigenvectors and costs less than d; so do values and the sums of terms, 8 eps of the
         * norm of the data, which change the square of an error e by 2 d e. */
        const double eps = ldexp(1.0, -24), gram = 23.0 * eps * exact_tail(sigma, count, 0);
        assert_near(pvpca_view_error(model, &m, view), tail,
                    gram + 16.0 * eps * sqrt(energy * tail) + 64.0 * eps * eps * energy);
        predicted += tail;
        free(sigma);
      }
      /* The header tells it without decoding. */
      assert_relative(pvpca_state(model)->head.squared_error, predicted, 1e-3);
      assert_relative(pvpca_state(model)->head.energy, material_energy(&m), 1e-6);
      btf_model_release(model);
    }
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* With all components of a view every sample comes back, whatever is on the shorter side. */
static void test_full_rank_is_exact(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint32_t i = 0; i < 4; i++) {
    const uint32_t side = i & 1 ? 3 : 7;
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:8x2", side, side, 3, true, BTF_WRAP_PERIODIC);
    btf_model *model = pvpca_fit(ctx, &m,
                                 i >> 1 ? "components=48 storage=f32 color=lights"
                                        : "components=16 storage=f32 color=texels");
    /* An orthonormal basis in floats: sums of 48 products, a few eps of the norm. */
    assert_true(sqrt(fmf_squared_error(model, &m) / material_energy(&m)) < 1e-6);
    btf_model_release(model);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* T15: 81 views of 16 components are 1296 terms; in the file, too. */
static void test_terms(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "ubo81", 5, 4, 1, true, BTF_WRAP_PERIODIC);
  btf_model *model = pvpca_fit(ctx, &m, "components=16"), *loaded = fmf_reload(model, ctx);
  uint32_t terms = 0;
  assert_int_equal(pvpca_state(model)->layout.views, 81);
  for (uint32_t v = 0; v < 81; v++) terms += pvpca_state(loaded)->views[v].terms;
  assert_int_equal(terms, 1296);
  assert_int_equal(pvpca_state(loaded)->head.terms, 1296);
  btf_model_release(model);
  btf_model_release(loaded);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* T14: 81 views of 8 coloured eigen-textures and a mean, 256 x 256 texels in 8 bit, are 143.3 MB. */
static void test_printed_size(void **unused) {
  (void)unused;
  btfi_pvpca_layout layout = {.channels = 3, .lights = 81, .views = 81, .width = 256, .height = 256};
  btfi_pvpca_view views[81];
  layout.storage = PVPCA_Q8;
  layout.color = PVPCA_COLOR_TEXELS;
  layout.levels = 1;
  layout.has_mean = 1;
  memset(views, 0, sizeof views);
  for (uint32_t v = 0; v < 81; v++) views[v].terms = 8;
  assert_true(btfi_pvpca_layout_of(&layout, views));
  assert_int_equal(layout.h_bytes[0] - PVPCA_TABLE_TAIL, 81u * (8 + 1) * 256 * 256 * 3);
  assert_near((double)layout.h_bytes[0] / 1e6, 143.3, 0.05);
  /* Coloured weights hold as many values of a texel in 26 scalar components and a mean. */
  btfi_pvpca_layout by_light = layout;
  by_light.color = PVPCA_COLOR_LIGHTS;
  for (uint32_t v = 0; v < 81; v++) views[v].terms = 26;
  assert_true(btfi_pvpca_layout_of(&by_light, views));
  assert_int_equal(by_light.h_bytes[0], layout.h_bytes[0]);
}

/* Coloured weights are at least as good as coloured eigen-textures of the same bytes: C coloured terms are a
 * special case of C times as many scalar ones. */
static void test_color_at_equal_bytes(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (int relief = 0; relief < 2; relief++) {
    material m = relief
                     ? relief_create(ctx, "grid:8x3", 12, 3)
                     : material_create(ctx, MATERIAL_GLOSSY, "grid:8x3", 12, 12, 3, true, BTF_WRAP_PERIODIC);
    btf_model *texels = pvpca_fit(ctx, &m, "color=texels components=4 mean=false storage=f32"),
              *lights = pvpca_fit(ctx, &m, "color=lights components=12 mean=false storage=f32");
    const double of_texels = fmf_squared_error(texels, &m), of_lights = fmf_squared_error(lights, &m);
    assert_int_equal(pvpca_state(texels)->layout.h_bytes[0], pvpca_state(lights)->layout.h_bytes[0]);
    print_message("equal bytes: error of coloured weights %.3f of that of coloured textures\n",
                  sqrt(of_lights / of_texels));
    assert_true(of_lights <= of_texels);
    btf_model_release(texels);
    btf_model_release(lights);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* FAC23: with as many components, a factorisation of each view is better than one of all: by construction,
 * and by 3 dB and more where what is seen moves with the view. */
static void test_better_than_fmf(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = relief_create(ctx, "grid:8x3", 12, 3);
  for (uint32_t components = 2; components <= 8; components += 3) {
    char settings[64];
    snprintf(settings, sizeof settings, "components=%u storage=f32", components);
    btf_model *per_view = pvpca_fit(ctx, &m, settings), *whole = fmf_fit(ctx, &m, settings);
    const double ratio = sqrt(fmf_squared_error(per_view, &m) / fmf_squared_error(whole, &m));
    print_message("%u components: error %.3f of that of fmf\n", components, ratio);
    assert_true(20.0 * log10(ratio) < -3.0);
    btf_model_release(per_view);
    btf_model_release(whole);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* FAC23, FAC25: of the five codecs of the STAR's figure 14 at its sizes, this one errs least where what is
 * seen moves with the view; the others follow in its order. Maps of every texel's own in floats, and levels
 * that are not compared left out, are to the others' advantage. */
static void test_least_error_of_all(void **unused) {
  static const char *const others[][2] = {{"lpca", "clusters=32 components=8 levels=1"},
                                          {"cmf", "codebook=0 storage=f32 levels=1"},
                                          {"lafortune", "lobes=2 levels=1"}};
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = relief_create(ctx, "grid:8x3", 48, 3);
  btf_model *model = pvpca_fit(ctx, &m, "components=8");
  double before = fmf_squared_error(model, &m), energy = material_energy(&m);
  print_message("relative error: pvpca %.4f", sqrt(before / energy));
  btf_model_release(model);
  for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
    if (btf_codec_find(ctx, others[i][0]) == NULL) continue; /* not in this build */
    model = suite_fit(ctx, others[i][0], m.ds, others[i][1]);
    const double error = fmf_squared_error(model, &m);
    print_message(", %s %.4f", others[i][0], sqrt(error / energy));
    assert_true(error > before);
    before = error;
    btf_model_release(model);
  }
  print_message("\n");
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* FAC26: more components, less error and more bytes. */
static void test_error_falls(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
  for (int storage = 0; storage < 2; storage++) {
    double before = material_energy(&m);
    uint64_t bytes = 0;
    for (uint32_t components = 1; components <= 16; components++) {
      char settings[64];
      snprintf(settings, sizeof settings, "components=%u storage=%s", components, storage ? "f16" : "f32");
      btf_model *model = pvpca_fit(ctx, &m, settings);
      const double error = fmf_squared_error(model, &m);
      assert_true(error < before);
      assert_true(pvpca_state(model)->resident > bytes);
      before = error;
      bytes = pvpca_state(model)->resident;
      btf_model_release(model);
    }
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* The same bytes of textures, spread over views: never worse, and better where views differ. */
static void test_adaptive_budget(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (int relief = 0; relief < 2; relief++) {
    material m = relief
                     ? relief_create(ctx, "grid:8x3", 12, 3)
                     : material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 12, 3, true, BTF_WRAP_PERIODIC);
    for (uint32_t components = 1; components <= 9; components += 4) {
      for (int texels = 0; texels < 2; texels++) {
        char settings[128];
        snprintf(settings, sizeof settings, "storage=f32 components=%u color=%s", components,
                 texels ? "texels" : "lights");
        btf_model *fixed = pvpca_fit(ctx, &m, settings);
        strcat(settings, " budget=adaptive");
        btf_model *adaptive = pvpca_fit(ctx, &m, settings);
        const double a = fmf_squared_error(adaptive, &m), f = fmf_squared_error(fixed, &m);
        assert_int_equal(pvpca_state(adaptive)->layout.h_bytes[0], pvpca_state(fixed)->layout.h_bytes[0]);
        assert_int_equal(pvpca_state(adaptive)->layout.g_bytes, pvpca_state(fixed)->layout.g_bytes);
        /* Eigenvalues choose, with an error of some eps of the energy: components of equal use may change
         * places. */
        assert_true(a <= f + 1e-6 * material_energy(&m));
        if (!relief && components > 1) assert_true(a < 0.99 * f);
        btf_model_release(fixed);
        btf_model_release(adaptive);
      }
    }
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* A target is met by what is decoded, rounding included; adaptive needs no more terms than fixed, and one
 * term in each view fewer misses it. */
static void test_targets(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
  const size_t count = (size_t)m.count * m.count * 3 * 120;
  const double samples = (double)count, peak = suite_peak(m.samples, count);
  const char *const others[] = {"storage=f32", "storage=f16", "storage=q8", "storage=f16 color=texels",
                                "storage=f32 mean=false"};
  for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
    for (int psnr = 0; psnr < 2; psnr++) {
      const double rmse = psnr ? peak * pow(10.0, -33.0 / 20.0) : 0.012;
      char settings[128];
      snprintf(settings, sizeof settings, "%s %s", psnr ? "psnr=33" : "rmse=0.012", others[i]);
      btf_model *fixed = pvpca_fit(ctx, &m, settings);
      strcat(settings, " budget=adaptive");
      btf_model *adaptive = pvpca_fit(ctx, &m, settings);
      const uint32_t terms = pvpca_state(fixed)->views[0].terms;
      const double got = sqrt(fmf_squared_error(fixed, &m) / samples);
      if (got > rmse) fail_msg("%s: rmse %g instead of %g", settings, got, rmse);
      assert_true(sqrt(fmf_squared_error(adaptive, &m) / samples) <= rmse);
      assert_true(pvpca_state(adaptive)->head.terms <= pvpca_state(fixed)->head.terms);
      assert_true(terms > 1 && terms < 32);
      snprintf(settings, sizeof settings, "components=%u %s", terms - 1, others[i]);
      btf_model *fewer = pvpca_fit(ctx, &m, settings);
      assert_true(sqrt(fmf_squared_error(fewer, &m) / samples) > 0.998 * rmse);
      btf_model_release(fixed);
      btf_model_release(adaptive);
      btf_model_release(fewer);
    }
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
  for (int adaptive = 0; adaptive < 2; adaptive++) {
    btf_model *model = pvpca_fit(
        ctx, &m, adaptive ? "rmse=1e-5 max_components=7 budget=adaptive" : "rmse=1e-5 max_components=7");
    assert_int_equal(pvpca_state(model)->head.terms, 7 * m.count);
    assert_int_equal(warnings.count, 1 + adaptive);
    btf_model_release(model);
  }
  material_release(&m);
  btf_context_release(ctx);
}

/* What a storage adds is what the header says. Rounding to halves is at most 2^-11 of each of two factors. */
static void test_storages(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:8x4", 16, 12, 3, true, BTF_WRAP_PERIODIC);
  const double energy = material_energy(&m);
  for (int texels = 0; texels < 2; texels++) {
    double error[PVPCA_STORAGES];
    const char *const names[] = {"f32", "f16", "q8"};
    for (size_t i = 0; i < PVPCA_STORAGES; i++) {
      char settings[96];
      snprintf(settings, sizeof settings, "components=12 storage=%s color=%s", names[i],
               texels ? "texels" : "lights");
      btf_model *model = pvpca_fit(ctx, &m, settings);
      error[i] = fmf_squared_error(model, &m);
      /* Errors of factors that are orthogonal to some eps add up to as much. */
      assert_near(pvpca_state(model)->head.squared_error, error[i], 1e-3 * error[i] + 1e-9 * energy);
      btf_model_release(model);
    }
    assert_true(error[PVPCA_F16] <= error[PVPCA_F32] + energy * ldexp(1.0, -20));
    /* A step is 1/127 of the largest value, which is at most 8 times the root mean square of these textures:
     * an error of 8^2 / 127^2 / 12 of the energy. */
    assert_true(error[PVPCA_Q8] <= error[PVPCA_F32] + energy * 64.0 / (127.0 * 127.0 * 12.0));
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* What keeping the factors of a fit in coarser storage adds is what the header says: they are orthogonal, and
 * so is what the fit left. Energies are those of what the fit holds. */
static void test_given_factors(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:8x4", 16, 12, 3, true, BTF_WRAP_PERIODIC);
  const double energy = material_energy(&m);
  for (int mean = 0; mean < 2; mean++) {
    btf_model *fitted =
        pvpca_fit(ctx, &m, mean ? "components=12 storage=f32" : "components=12 storage=f32 mean=false");
    const double left = fmf_squared_error(fitted, &m);
    btf_dataset *ds;
    assert_ok(btf_dataset_from_model(fitted, &ds));
    for (uint32_t storage = 0; storage < PVPCA_STORAGES; storage++) {
      static const char *const names[] = {"storage=f32", "storage=f16", "storage=q8"};
      btf_options *options;
      btf_model *model;
      assert_ok(suite_options(ctx, "pvpca", names[storage], &options));
      assert_ok(btf_model_from_factors(ds, btf_codec_find(ctx, "pvpca"), options, NULL, &model));
      btf_options_release(options);
      const btfi_pvpca_head *head = &pvpca_state(model)->head;
      const double error = fmf_squared_error(model, &m);
      assert_int_equal(head->storage, storage);
      assert_near(left + head->squared_error, error, 1e-3 * error + 1e-9 * energy);
      assert_relative(head->energy, energy - left, 1e-5);
      btf_model_release(model);
    }
    btf_dataset_release(ds);
    btf_model_release(fitted);
  }
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
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++) {
    for (uint32_t k = 0; k < 24; k++) {
      const int image_major = k & 1, texels = k >> 1 & 1, mean = k >> 2 & 1;
      const char *const storages[] = {"f32", "f16", "q8"};
      const double tolerance[] = {1e-6, 1e-3, 2e-2};
      char settings[128];
      material m =
          material_create(ctx, MATERIAL_GLOSSY, shapes[i].directions, shapes[i].width, shapes[i].height,
                          shapes[i].channels, image_major, image_major ? BTF_WRAP_CLAMP : BTF_WRAP_PERIODIC);
      snprintf(settings, sizeof settings, "components=64 storage=%s color=%s mean=%d", storages[k >> 3],
               texels ? "texels" : "lights", mean);
      btf_model *model = pvpca_fit(ctx, &m, settings);
      const double relative = sqrt(fmf_squared_error(model, &m) / material_energy(&m));
      if (relative > tolerance[k >> 3]) fail_msg("shape %zu, %s: %g", i, settings, relative);
      btf_model_release(model);
      material_release(&m);
    }
  }
  test_context_done(ctx, &memory);
}

static const char *const all_kinds[] = {"components=8",
                                        "mean=false storage=q8",
                                        "psnr=40",
                                        "storage=q8 rmse=0.1 color=texels",
                                        "budget=adaptive mean=false",
                                        "psnr=40 mean=false budget=adaptive storage=f32"};
enum { KINDS = sizeof all_kinds / sizeof *all_kinds };

/* Black, and one value everywhere: decoded as they are. */
static void test_flat(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (int black = 0; black < 2; black++) {
    material m = material_create(ctx, MATERIAL_CONSTANT, "grid:4x2", 4, 4, 3, true, BTF_WRAP_PERIODIC);
    if (black) memset(m.samples, 0, (size_t)m.count * m.count * 3 * 16 * sizeof(float));
    for (size_t i = 0; i < KINDS; i++) {
      btf_model *model = pvpca_fit(ctx, &m, all_kinds[i]);
      const double error = sqrt(fmf_squared_error(model, &m));
      if (black) assert_true(error == 0.0);
      /* 1e-3 holds the rounding of halves and of scaled bytes at their own maximum; 0.1 and 40 dB are asked
       * for. */
      const double samples = sqrt((double)m.count * m.count * 3 * 16);
      assert_true(error <= samples * (i == 3 ? 0.1 : i == 2 || i == 5 ? 0.24 * 0.01 : 1e-3));
      btf_model_release(model);
    }
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

static void test_determinism(void **unused) {
  (void)unused;
  for (size_t i = 0; i < KINDS; i++) {
    unsigned char *bytes[2];
    size_t size[2];
    for (int turn = 0; turn < 2; turn++) {
      btf_context *ctx = test_context_with(&memory, NULL, 2);
      const char *path = test_path("same.btfz");
      material m = relief_create(ctx, "grid:6x2", 12, 3);
      btf_model *model = pvpca_fit(ctx, &m, all_kinds[i]);
      assert_ok(btf_model_save(model, path, 0, NULL, NULL));
      bytes[turn] = test_read_bytes(path, &size[turn]);
      btf_model_release(model);
      material_release(&m);
      test_context_done(ctx, &memory);
    }
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(bytes[0], bytes[1], size[0]);
    free(bytes[0]);
    free(bytes[1]);
  }
}

/* A fit holds no more than its working set and its result; blocks change nothing but rounding. Too small a
 * budget is refused with the one that would do, and that one does. */
static void test_budget(void **unused) {
  (void)unused;
  for (int kind = 0; kind < 3; kind++) {
    const char *const settings[] = {"components=4",
                                    "components=3 color=texels budget=adaptive max_components=5",
                                    "psnr=32 max_components=16"};
    const double view_bytes = 8.0 * 3.0 * 120 * 100 * 4;
    double error[2] = {0.0, 0.0};
    for (int turn = 0; turn < 2; turn++) {
      btf_context *ctx = test_context_with(&memory, NULL, 2);
      material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 120, 100, 3, turn, BTF_WRAP_PERIODIC);
      btf_job job = BTF_JOB_INIT;
      btf_model *model;
      uint64_t before, peak;
      if (turn == 1) {
        job.max_working_set = 1 << 10;
        assert_status(pvpca_try_fit(ctx, m.ds, settings[kind], &job, &model), BTF_E_LIMIT);
        assert_message_has("MiB would do");
        const char *const named = strstr(btf_error_message(), "; ");
        job.max_working_set = (uint64_t)strtoul(named + 2, NULL, 10) << 20;
        assert_true(job.max_working_set >= 1u << 20 && job.max_working_set <= 8u << 20);
        if (kind == 0) assert_true((double)job.max_working_set < view_bytes);
      }
      btf_context_memory(ctx, &before, NULL);
      assert_ok(pvpca_try_fit(ctx, m.ds, settings[kind], &job, &model));
      btf_context_memory(ctx, NULL, &peak);
      error[turn] = fmf_squared_error(model, &m);
      if (turn == 1) {
        const uint64_t result = pvpca_state(model)->resident;
        print_message("a view is %.2f MiB, budget %.0f MiB, peak %.2f MiB, result %.2f MiB\n",
                      view_bytes / 1048576.0, (double)job.max_working_set / 1048576.0,
                      (double)(peak - before) / 1048576.0, (double)result / 1048576.0);
        /* The library's own scratch for reordering a block is beside it. */
        assert_true(peak - before <= job.max_working_set + result + (1u << 20));
      }
      btf_model_release(model);
      material_release(&m);
      test_context_done(ctx, &memory);
    }
    /* Float sums in another order. */
    assert_relative(error[0], error[1], 1e-4);
  }
}

/* ---- a stream of images ---- */

typedef struct stream {
  const float *xyz;
  long reads;
} stream;

static btf_status read_stream(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  stream *st = user;
  st->reads++;
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++) {
      const float *view = st->xyz + 3 * (size_t)(b->view0 + v),
                  *light = st->xyz + 3 * (size_t)(b->light0 + l);
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++)
          for (uint32_t c = 0; c < 3; c++) {
            const float a = sinf((float)((b->x0 + x) * 7 + (b->y0 + y) * 3)) * 0.3f;
            *(float *)(void *)((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light +
                               (ptrdiff_t)y * s->y + (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel) =
                light[2] * (0.5f + a) + 0.1f * (float)c * light[0] * (view[1] + a * a) + 0.2f * a * view[0];
          }
    }
  return BTF_OK;
}

/* 151 x 151 images pulled from a source, under a small budget. The matrix of a view has rank 3. */
static void test_stream(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_dirset *directions;
  stream source = {0};
  assert_ok(btf_dirset_create_named(ctx, "ubo151", &directions));
  source.xyz = btf_dirset_directions(directions);
  desc.lights = desc.views = directions;
  desc.width = desc.height = 6;
  desc.channels = 3;
  desc.flags = BTF_DATASET_IMAGE_MAJOR;
  desc.read = read_stream;
  desc.user = &source;
  btf_dataset *ds;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  const char *const settings[] = {"components=3 storage=f32 color=lights",
                                  "components=4 storage=f32 color=texels levels=1"};
  for (size_t i = 0; i < 2; i++) {
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    job.max_working_set = 1 << 20;
    source.reads = 0;
    assert_ok(pvpca_try_fit(ctx, ds, settings[i], &job, &model));
    assert_true(source.reads >= 151);
    double error = 0.0, energy = 0.0;
    for (uint32_t view = 0; view < 151; view += 10)
      for (uint32_t light = 0; light < 151; light += 3)
        for (uint32_t t = 0; t < 36; t++) {
          float truth[3], got[3];
          const btf_block block = {view, 1, light, 1, t % 6, t / 6, 1, 1};
          const btf_strides strides = {12, 12, 12, 12, 4};
          assert_ok(read_stream(&source, &block, truth, &strides));
          btf_model_texel(model, 0, t % 6, t / 6, light, view, got);
          for (int c = 0; c < 3; c++) {
            error += pow((double)got[c] - (double)truth[c], 2.0);
            energy += pow((double)truth[c], 2.0);
          }
        }
    /* Of low rank; the Gram matrix of floats finds the last directions to the root of its own rounding. */
    assert_true(sqrt(error / energy) < 2e-4);
    btf_model_release(model);
  }
  btf_dataset_release(ds);
  btf_dirset_release(directions);
  test_context_done(ctx, &memory);
}

/* ---- stopping and failing ---- */

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
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 8, 6, 3, true, BTF_WRAP_PERIODIC);
  for (size_t i = 0; i < KINDS; i++) {
    int cancelled = 0;
    for (int calls = 0; calls < 400; calls++) {
      cancel_after c = {calls, 0, 0.0};
      btf_job job = BTF_JOB_INIT;
      btf_model *model;
      job.progress = cancel_progress;
      job.user = &c;
      const btf_status status = pvpca_try_fit(ctx, m.ds, all_kinds[i], &job, &model);
      if (status == BTF_OK) {
        assert_true(c.last == 1.0);
        btf_model_release(model);
        break;
      }
      assert_int_equal(status, BTF_E_CANCELLED);
      assert_null(model);
      cancelled++;
    }
    assert_in_range(cancelled, 1, 399);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Every allocation of fit, save and load fails in turn: a status, and no leak. */
static void test_failing_allocations(void **unused) {
  (void)unused;
  const char *const settings[] = {"components=6", "psnr=30 budget=adaptive storage=q8 color=texels"};
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  for (size_t i = 0; i < 4; i++) {
    /* 24 texels and fewer than lights times channels. */
    material m = material_create(ctx, MATERIAL_GLOSSY, i < 2 ? "grid:4x1" : "grid:4x2", 6, i < 2 ? 4 : 2, 3,
                                 true, BTF_WRAP_PERIODIC);
    long failures = 0;
    for (long at = 1; at < 5000; at++) {
      const long live = memory.live_blocks;
      btf_model *model = NULL, *loaded = NULL;
      memory.fail_at = memory.total_allocations + at;
      btf_status status = pvpca_try_fit(ctx, m.ds, settings[i & 1], NULL, &model);
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
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_error_is_the_tail),
                                     cmocka_unit_test(test_full_rank_is_exact),
                                     cmocka_unit_test(test_terms),
                                     cmocka_unit_test(test_printed_size),
                                     cmocka_unit_test(test_color_at_equal_bytes),
                                     cmocka_unit_test(test_better_than_fmf),
                                     cmocka_unit_test(test_least_error_of_all),
                                     cmocka_unit_test(test_error_falls),
                                     cmocka_unit_test(test_adaptive_budget),
                                     cmocka_unit_test(test_targets),
                                     cmocka_unit_test(test_target_out_of_reach),
                                     cmocka_unit_test(test_storages),
                                     cmocka_unit_test(test_given_factors),
                                     cmocka_unit_test(test_shapes),
                                     cmocka_unit_test(test_flat),
                                     cmocka_unit_test(test_determinism),
                                     cmocka_unit_test(test_budget),
                                     cmocka_unit_test(test_stream),
                                     cmocka_unit_test(test_cancel),
                                     cmocka_unit_test(test_failing_allocations)};
  return btf_run("pvpca", tests);
}
