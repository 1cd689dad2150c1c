/* SPDX-License-Identifier: MIT */
/* Fits: planted clusters, cost, PCA by LAPACK, the subspace against the data themselves, targets, storages,
 * sizes, edge cases, budget, cancelling, failures. */
#include "test_clusters.h"

#include "exact_svd.h"

static test_memory memory;

/* ---- against independent results ---- */

/* Squared error of the best affine subspace of some columns of B, by LAPACK in double: the tail of the
 * singular values of the columns less their mean. */
static double affine_tail(const material *m, const uint32_t *texels, uint32_t count, uint32_t components) {
  const uint32_t rows = m->count * m->count * m->channels, few = rows < count ? rows : count;
  double *b = malloc((size_t)rows * count * sizeof *b);
  for (uint32_t row = 0; row < rows; row++) {
    double mean = 0.0;
    for (uint32_t i = 0; i < count; i++) {
      b[(size_t)row * count + i] = material_row(m, texels[i], row);
      mean += b[(size_t)row * count + i] / count;
    }
    for (uint32_t i = 0; i < count; i++) b[(size_t)row * count + i] -= mean;
  }
  double *const sigma = exact_singular_values(b, rows, count);
  const double tail = exact_tail(sigma, few, components);
  free(b);
  free(sigma);
  return tail;
}

/* The optimum for the labels of a model: the sum of the tails of its clusters. */
static double optimum_for_labels(const material *m, const btf_model *model) {
  const btfi_lpca_state *s = lpca_state(model);
  const uint32_t texels = m->width * m->height;
  uint32_t *members = malloc(texels * sizeof *members);
  double sum = 0.0;
  for (uint32_t k = 0; k < s->layout.clusters; k++) {
    uint32_t count = 0;
    for (uint32_t t = 0; t < texels; t++)
      if (lpca_label(s, 0, t) == k) members[count++] = t;
    assert_true(count > 0);
    sum += affine_tail(m, members, count, s->layout.components);
  }
  free(members);
  return sum;
}

/* One cluster is principal component analysis: the error is LAPACK's tail. */
static void test_one_cluster_is_pca(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (int image_major = 0; image_major < 2; image_major++) {
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 12, 10, 3, image_major, BTF_WRAP_PERIODIC);
    uint32_t all[120];
    for (uint32_t t = 0; t < 120; t++) all[t] = t;
    for (uint32_t components = 1; components <= 33; components += 8) {
      char settings[96];
      snprintf(settings, sizeof settings, "clusters=1 components=%u storage=f32 subspace=0 refine=0",
               components);
      btf_model *model = lpca_fit(ctx, &m, settings);
      const double tail = affine_tail(&m, all, 120, components), energy = material_energy(&m);
      /* Float32: a rounding error d (a few eps of the data's norm) changes the square of the error e by 2 d
       * e. */
      assert_relative(model_squared_error(model, &m), tail, 2.0 * 8.0 * 1.2e-7 * sqrt(energy / tail) + 1e-6);
      btf_model_release(model);
    }
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* FAC24: ABRDFs planted on affine subspaces of 3 dimensions are exact with as many clusters and components,
 * and every cluster of the model holds texels of one planted cluster alone. */
static void test_planted_clusters(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = planted_material(ctx, 16, 16, 5, 3);
  btf_model *model = lpca_fit(ctx, &m, "clusters=5 components=3 storage=f32 restarts=6");
  const btfi_lpca_state *s = lpca_state(model);
  uint32_t of_label[5] = {9, 9, 9, 9, 9};
  assert_int_equal(s->layout.clusters, 5);
  for (uint32_t t = 0; t < 256; t++) {
    const uint32_t label = lpca_label(s, 0, t);
    if (of_label[label] == 9) of_label[label] = t % 5;
    assert_int_equal(of_label[label], t % 5);
  }
  /* Exact but for float rounding of bases, weights and sums: some eps of the norm. */
  assert_true(sqrt(model_squared_error(model, &m) / material_energy(&m)) < 2e-6);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void model_of_points(btfi_lpca_model *model, btf_context *ctx, const float *points, uint64_t count,
                            uint32_t size, uint32_t clusters, uint32_t components) {
  memset(model, 0, sizeof *model);
  model->host = btfi_host();
  model->ctx = ctx;
  model->points = points;
  model->count = count;
  model->size = size;
  model->clusters = clusters;
  model->most_components = components;
  assert_ok(btfi_lpca_model_alloc(model, 1 << 24));
}

/* FAC24: the cost never rises, whatever the start: random labels, seeded ones, all points in one cluster so
 * that all others are empty, clusters of one point. */
static void test_cost_is_monotone(void **unused) {
  (void)unused;
  enum { COUNT = 700, SIZE = 24, CLUSTERS = 12, COMPONENTS = 3, ROUNDS = 40 };
  btf_context *ctx = test_context(&memory);
  float *points = malloc(COUNT * SIZE * sizeof *points);
  double energy = 0.0;
  for (uint32_t i = 0; i < COUNT * SIZE; i++) {
    const uint32_t d = i % SIZE;
    points[i] = (test_random() - 0.5f + (float)((i / SIZE * 7 + d) % 5)) / (1.0f + 0.3f * (float)d);
    energy += (double)points[i] * points[i];
  }
  for (int start = 0; start < 4; start++) {
    btfi_lpca_model model;
    double history[ROUNDS + 1];
    uint32_t steps, used = 0;
    uint64_t random = 7;
    model_of_points(&model, ctx, points, COUNT, SIZE, CLUSTERS, COMPONENTS);
    if (start == 0) assert_ok(btfi_lpca_seed(&model, &random, 0.0, 1.0));
    for (uint32_t i = 0; i < COUNT && start > 0; i++)
      model.label[i] = start == 1     ? (uint32_t)(test_random() * CLUSTERS)
                       : start == 2   ? 0
                       : i < CLUSTERS ? i
                                      : 0;
    model.components = COMPONENTS;
    assert_ok(btfi_lpca_iterate(&model, ROUNDS, 0.0, history, &steps, 0.0, 1.0));
    assert_true(steps > 3);
    /* Gram matrices are float sums over runs of 512: the square root of that many roundings. */
    for (uint32_t i = 1; i < steps; i++) assert_true(history[i] <= history[i - 1] + 2e-6 * energy);
    assert_true(history[steps - 1] < (start == 0 ? 1.0 : 0.8) * history[0]);
    for (uint32_t k = 0; k < CLUSTERS; k++) used += model.start[k + 1] > model.start[k];
    assert_int_equal(used, CLUSTERS);
    if (start == 2) assert_true(model.splits >= CLUSTERS - 1);
    btfi_lpca_model_free(&model);
  }
  free(points);
  test_context_done(ctx, &memory);
}

/* Assignment takes the cluster of least error, as found by projecting on every basis in double. */
static void test_assignment(void **unused) {
  (void)unused;
  enum { COUNT = 300, SIZE = 19, CLUSTERS = 7, COMPONENTS = 4 };
  btf_context *ctx = test_context(&memory);
  float *points = malloc(COUNT * SIZE * sizeof *points),
        *weights = malloc(COUNT * COMPONENTS * sizeof *weights);
  float *errors = malloc(COUNT * sizeof *errors);
  btfi_lpca_model model;
  uint64_t random = 3;
  for (uint32_t i = 0; i < COUNT * SIZE; i++) points[i] = test_random() - 0.5f;
  model_of_points(&model, ctx, points, COUNT, SIZE, CLUSTERS, COMPONENTS);
  assert_ok(btfi_lpca_seed(&model, &random, 0.0, 1.0));
  model.components = COMPONENTS;
  assert_ok(btfi_lpca_refit(&model));
  assert_ok(btfi_lpca_assign(&model, points, COUNT, false, model.label, model.error, model.second,
                             model.second_error));
  assert_ok(btfi_lpca_weights(&model, points, COUNT, model.label, weights, errors));
  for (uint32_t i = 0; i < COUNT; i++) {
    double best = INFINITY, second = INFINITY;
    for (uint32_t k = 0; k < CLUSTERS; k++) {
      const float *mean = model.basis + k * (COMPONENTS + 1) * SIZE;
      double error = 0.0;
      for (uint32_t d = 0; d < SIZE; d++) error += pow((double)points[i * SIZE + d] - mean[d], 2.0);
      for (uint32_t j = 1; j <= COMPONENTS; j++) {
        double w = 0.0;
        for (uint32_t d = 0; d < SIZE; d++)
          w += ((double)points[i * SIZE + d] - mean[d]) * mean[j * SIZE + d];
        error -= w * w;
        if (k == model.label[i]) assert_near(weights[i * COMPONENTS + j - 1], w, 1e-5);
      }
      second = fmin(second, fmax(best, error));
      best = fmin(best, error);
    }
    /* Products of float, lengths below 2. */
    assert_near(model.error[i], best, 2e-6);
    assert_near(model.second_error[i], second, 2e-6);
    assert_near(errors[i], best, 2e-6);
  }
  btfi_lpca_model_free(&model);
  free(points);
  free(weights);
  free(errors);
  test_context_done(ctx, &memory);
}

/* The subspace loses nothing that matters. For given labels the error lies between the optimum on the data
 * and that plus what lies outside of the subspace; refined on the data, it comes within 2 % of the optimum
 * even in a subspace that leaves a good part of the data outside. */
static void test_subspace_against_data(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 16, 16, 3, true, BTF_WRAP_PERIODIC);
  btf_model *exact = lpca_fit(ctx, &m, "clusters=6 components=4 storage=f32 subspace=0 refine=0 levels=1");
  const double exact_error = model_squared_error(exact, &m), exact_optimum = optimum_for_labels(&m, exact);
  assert_relative(exact_error, exact_optimum, 1e-4);
  for (uint32_t subspace = 12; subspace <= 48; subspace *= 2) {
    for (uint32_t refine = 0; refine <= 3; refine += 3) {
      char settings[96];
      snprintf(settings, sizeof settings,
               "clusters=6 components=4 storage=f32 subspace=%u refine=%u levels=1", subspace, refine);
      btf_model *model = lpca_fit(ctx, &m, settings);
      const btfi_lpca_state *s = lpca_state(model);
      const double error = model_squared_error(model, &m), optimum = optimum_for_labels(&m, model);
      print_message(
          "subspace %u, %u refinements: squared error %.4f, optimum for its labels %.4f, for all %.4f, "
          "outside %.4f\n",
          subspace, refine, error, optimum, exact_error, s->head.outside);
      assert_true(error >= optimum * (1.0 - 1e-4));
      assert_true(error <= optimum + s->head.outside * 1.001);
      assert_relative(s->head.squared_error, error, 2e-3);
      if (refine > 0) assert_true(error <= 1.02 * optimum);
      if (subspace == 48 && refine > 0) assert_true(error <= 1.05 * exact_error);
      btf_model_release(model);
    }
  }
  btf_model_release(exact);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* FAC24, FOM08: with 8 components, 32 clusters are closer than one matrix for all, by at least 2 dB. A sample
 * costs the mean of its cluster more to decode, 9 values a channel for 8. */
static void test_better_than_fmf(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const int kinds[] = {MATERIAL_GLOSSY, MATERIAL_TWO_CLOTHS, MATERIAL_CHECKS};
  for (size_t i = 0; i < 3; i++) {
    material m = material_of(ctx, kinds[i], "grid:5x3", 32, 32);
    btf_model *fmf = fmf_fit(ctx, &m, "components=8 coding=plain"), *lpca = lpca_fit(ctx, &m, "");
    const double gain = 10.0 * log10(model_squared_error(fmf, &m) / model_squared_error(lpca, &m));
    print_message("material %zu: 32 x 8 is %.1f dB better than fmf with 8\n", i, gain);
    assert_true(gain >= 2.0);
    btf_eval_cost of_fmf = BTF_EVAL_COST_INIT, of_lpca = BTF_EVAL_COST_INIT;
    assert_ok(btf_model_cost(fmf, BTF_QUERY_NEAREST, &of_fmf));
    assert_ok(btf_model_cost(lpca, BTF_QUERY_NEAREST, &of_lpca));
    assert_true(8.0 * of_lpca.values <= 9.0 * of_fmf.values);
    btf_model_release(fmf);
    btf_model_release(lpca);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* FAC26: error falls and size grows with components and with clusters. */
static void test_quality_knobs(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 16, 16, 3, true, BTF_WRAP_PERIODIC);
  const char *const knobs[] = {"storage=f32 packing=tight subspace=48 clusters=4 components",
                               "storage=f32 packing=tight subspace=48 components=4 clusters"};
  for (size_t i = 0; i < 2; i++) {
    double before = INFINITY;
    uint64_t size = 0;
    for (uint32_t value = 1; value <= 16; value *= 2) {
      char settings[96];
      snprintf(settings, sizeof settings, "%s=%u", knobs[i], value);
      btf_model *model = lpca_fit(ctx, &m, settings);
      const double error = model_squared_error(model, &m);
      const uint64_t bytes = lpca_state(model)->layout.factors_bytes;
      if (!(error < before && bytes > size))
        fail_msg("%s: %g after %g, %llu bytes after %llu", settings, error, before, (unsigned long long)bytes,
                 (unsigned long long)size);
      before = error;
      size = bytes;
      btf_model_release(model);
    }
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* A target is met by what is decoded. */
static void test_targets(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 12, 3, true, BTF_WRAP_PERIODIC);
  const double samples = (double)m.count * m.count * 3 * 144;
  const double limits[] = {0.02, 0.008};
  const char *const storages[] = {"f16", "q8"};
  for (size_t i = 0; i < 4; i++) {
    char settings[96];
    snprintf(settings, sizeof settings, "clusters=4 refine=0 subspace=48 rmse=%g storage=%s", limits[i % 2],
             storages[i / 2]);
    btf_model *model = lpca_fit(ctx, &m, settings);
    const uint32_t components = lpca_state(model)->layout.components;
    const double error = sqrt(model_squared_error(model, &m) / samples);
    print_message("%s: %u components, %.5f\n", settings, components, error);
    assert_true(error <= limits[i % 2]);
    btf_model_release(model);
    /* Far fewer would miss it. */
    assert_true(components > 3);
    snprintf(settings, sizeof settings, "clusters=4 refine=0 subspace=48 components=%u storage=%s",
             components - 3, storages[i / 2]);
    model = lpca_fit(ctx, &m, settings);
    assert_true(sqrt(model_squared_error(model, &m) / samples) > limits[i % 2]);
    btf_model_release(model);
  }
  btf_model *model = lpca_fit(ctx, &m, "clusters=4 subspace=48 psnr=40");
  btf_statistics statistics = {.struct_size = sizeof statistics};
  assert_ok(btfi_host()->measure(ctx, m.ds, 0, NULL, &statistics, NULL, 0.0, 1.0));
  assert_true(sqrt(model_squared_error(model, &m) / samples) <= statistics.peak * 0.01);
  btf_model_release(model);
  model = lpca_fit(ctx, &m,
                   "clusters=2 subspace=48 rmse=1e-9 max_components=3"); /* out of reach: the best there is */
  assert_int_equal(lpca_state(model)->layout.components, 3);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ---- sizes and storages ---- */

/* T14: 32 clusters of 8 components and a mean, 16 bits a value, and one byte and 8 weights for each texel are
 * 12.45 MB for 256 x 256 texels and 81 x 81 directions, 103.6 times less than 8-bit samples. A tight model
 * has exactly these bytes and a slack of 64 for each table. */
static void test_sizes(void **unused) {
  (void)unused;
  btf_model_shape shape = {.width = 256, .height = 256, .channels = 3};
  btfi_lpca_layout l = {
      .storage = LPCA_F16, .packing = LPCA_TIGHT, .clusters = 32, .components = 8, .levels = 1};
  assert_true(btfi_lpca_layout_of(&shape, 81, 81, &l));
  const uint64_t bytes = l.factors_bytes + l.index_table_bytes[0] + l.weight_table_bytes[0] - 2 * LPCA_SLACK;
  assert_int_equal(bytes, 12451520);
  assert_int_equal(bytes, 32 * 9 * 81 * 81 * 3 * 2 + 65536 * (8 * 2 + 1));
  assert_near(81.0 * 81.0 * 3.0 * 65536.0 / (double)bytes, 103.6, 0.05);
  /* One cache line for each row of the aligned tables. */
  l.packing = LPCA_ALIGNED;
  assert_true(btfi_lpca_layout_of(&shape, 81, 81, &l));
  assert_int_equal(l.row_bytes, 64);
  l.storage = LPCA_Q8;
  assert_true(btfi_lpca_layout_of(&shape, 81, 81, &l));
  assert_int_equal(l.row_bytes, 32);
  /* And in a model: as many bytes in the chunks, and the same values. */
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
  const char *const storages[] = {"f16", "f32", "q8"};
  for (int i = 0; i < 3; i++) {
    char settings[96];
    snprintf(settings, sizeof settings, "clusters=4 components=5 levels=1 storage=%s packing=tight",
             storages[i]);
    btf_model *tight = lpca_fit(ctx, &m, settings);
    snprintf(settings, sizeof settings, "clusters=4 components=5 levels=1 storage=%s", storages[i]);
    btf_model *aligned = lpca_fit(ctx, &m, settings);
    const uint32_t factor = i == 0 ? 2 : i == 1 ? 4 : 1, value = i == 1 ? 4 : 2;
    uint64_t chunks = 0;
    for (uint32_t k = 0; k < btfi_payload_chunk_count(tight->payload); k++) {
      btfi_chunk chunk;
      assert_ok(btfi_payload_chunk(tight->payload, k, &chunk));
      chunks += chunk.size;
    }
    assert_int_equal(chunks, 4 * 15 * 15 * 3 * (5 * factor + value) + 84 * (5 * value + 1) + 2 * LPCA_SLACK +
                                 LPCA_HEAD_BYTES + 4 * 6 * 4);
    for (uint32_t t = 0; t < 84; t++) {
      float a[3], b[3];
      btf_model_texel(tight, 0, t % 12, t / 12, t % 15, t / 6, a);
      btf_model_texel(aligned, 0, t % 12, t / 12, t % 15, t / 6, b);
      assert_memory_equal(a, b, sizeof a);
    }
    btf_model_release(tight);
    btf_model_release(aligned);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* REN14: a factor has 8 bits and a scale, its largest value; its rounding is at most half a step of 1 / 127.
 * Weights and the mean are halves: 2^-11 of each and, below 2^-14 of the largest, 2^-25 of that. */
static void test_quantisation_bound(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
  const char *const names[] = {"f16", "f32", "q8"};
  btf_model *exact = lpca_fit(ctx, &m, "clusters=4 components=6 storage=f32");
  const btfi_lpca_state *s = lpca_state(exact);
  double worst = 0.0;
  for (int i = 0; i < 3; i += 2) {
    char settings[64];
    snprintf(settings, sizeof settings, "clusters=4 components=6 storage=%s", names[i]);
    btf_model *rounded = lpca_fit(ctx, &m, settings);
    const double factor = i == 2 ? 0.5 / 127.0 : 4.9e-4 + 3e-8, half = 4.9e-4 + 3e-8;
    for (uint32_t t = 0; t < 84; t++) {
      const float *scale = s->scales + lpca_label(s, 0, t) * (s->layout.padded + LPCA_LANES);
      double bound = half * fabs((double)scale[s->layout.padded]) + 1e-6;
      for (uint32_t j = 0; j < 6; j++) {
        float weight;
        memcpy(&weight, s->weights[0] + t * s->layout.texel_bytes + 4 * j, sizeof weight);
        /* (f + df) (w + dw) - f w, |f| <= 1 */
        bound += fabs((double)scale[j]) * (factor * fabs((double)weight) + half * (1.0 + factor));
      }
      for (uint32_t pair = 0; pair < 225; pair += 4) {
        float a[3], b[3];
        btf_model_texel(exact, 0, t % 12, t / 12, pair % 15, pair / 15, a);
        btf_model_texel(rounded, 0, t % 12, t / 12, pair % 15, pair / 15, b);
        for (int c = 0; c < 3; c++) {
          worst = fmax(worst, fabs((double)a[c] - b[c]) / bound);
          assert_near(b[c], a[c], bound);
        }
      }
    }
    btf_model_release(rounded);
  }
  print_message("largest error over its bound: %.2f\n", worst);
  assert_true(worst > 0.05); /* the bound is not idle */
  btf_model_release(exact);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ---- edges ---- */

static void test_shapes(void **unused) {
  (void)unused;
  const struct {
    const char *directions;
    uint32_t width, height, channels;
  } shapes[] = {{"grid:4x2", 5, 3, 1}, {"grid:4x2", 3, 7, 5}, {"grid:3x1", 4, 2, 64}, {"grid:4x2", 1, 1, 3},
                {"one", 6, 5, 3},      {"one", 1, 1, 1},      {"grid:4x2", 1, 9, 2},  {"grid:3x2", 33, 2, 3}};
  const char *const settings[] = {
      "components=64 clusters=2 storage=f32 refine=2", "components=64 clusters=1024 storage=f32 refine=2",
      "components=64 clusters=1", "components=64 clusters=5 storage=q8 packing=tight"};
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++)
    for (int image_major = 0; image_major < 2; image_major++) {
      material m = material_create(ctx, MATERIAL_GLOSSY, shapes[i].directions, shapes[i].width,
                                   shapes[i].height, shapes[i].channels, image_major, BTF_WRAP_CLAMP);
      for (size_t k = 0; k < 4; k++) {
        btf_model *model = lpca_fit(ctx, &m, settings[k]);
        const double relative = sqrt(model_squared_error(model, &m) / material_energy(&m));
        if (relative > (k < 2 ? 2e-6 : k == 2 ? 1e-3 : 1e-2))
          fail_msg("shape %zu, %s: %g", i, settings[k], relative);
        btf_model_release(model);
      }
      material_release(&m);
    }
  test_context_done(ctx, &memory);
}

/* Constant, black, and all texels equal: clusters that nothing would go to are dropped. */
static void test_degenerate(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const char *const settings[] = {"", "storage=q8", "clusters=7 subspace=0 storage=f32", "psnr=40",
                                  "rmse=0.1"};
  for (size_t i = 0; i < 5; i++) {
    for (int black = 0; black < 2; black++) {
      material m = material_create(ctx, MATERIAL_CONSTANT, "grid:4x2", 6, 4, 3, true, BTF_WRAP_PERIODIC);
      if (black) memset(m.samples, 0, (size_t)m.count * m.count * 3 * 24 * sizeof(float));
      btf_model *model = lpca_fit(ctx, &m, settings[i]);
      const double error = model_squared_error(model, &m);
      if (black) assert_true(error == 0.0);
      /* The mean as a half of its largest value. */
      if (!black) assert_true(sqrt(error / material_energy(&m)) < 5e-4);
      btf_model_release(model);
      material_release(&m);
    }
  }
  test_context_done(ctx, &memory);
}

static void test_determinism(void **unused) {
  (void)unused;
  const char *const settings[] = {"clusters=6 components=4", "clusters=6 psnr=38 storage=q8 restarts=2"};
  for (size_t i = 0; i < 2; i++) {
    unsigned char *bytes[2];
    size_t size[2];
    for (int turn = 0; turn < 2; turn++) {
      btf_context *ctx = test_context_with(&memory, NULL, 2);
      material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
      btf_model *model = lpca_fit(ctx, &m, settings[i]);
      assert_ok(btf_model_save(model, test_path("same.btfz"), 0, NULL, NULL));
      bytes[turn] = test_read_bytes(test_path("same.btfz"), &size[turn]);
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

/* A fit holds its working set and the payload. With the subspace of its choice it comes near the optimum all
 * the same; one that is asked for is refused where the matrices of eight threads, 8 x 400^2 bytes each and
 * twice that for LAPACK, leave no room for it, though the decomposition has enough. */
static void test_budget(void **unused) {
  (void)unused;
  const char *const settings[] = {"clusters=4 components=8", "clusters=4 components=8 subspace=400"};
  for (uint32_t i = 0; i < 2; i++) {
    btf_context *ctx = test_context_with(&memory, NULL, i == 0 ? 2 : 8);
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:12x4", 32, 24, 3, true, BTF_WRAP_PERIODIC);
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    uint64_t before, peak;
    size_t payload;
    job.max_working_set = i == 0 ? 8u << 20 : 40u << 20;
    btf_context_memory(ctx, &before, NULL);
    if (i == 1) {
      assert_status(lpca_try_fit(ctx, m.ds, settings[i], &job, &model), BTF_E_LIMIT);
      const char *at = strstr(btf_error_message(), "working set of ");
      assert_non_null(at);
      job.max_working_set = strtoull(at + 15, NULL, 10) << 20;
    }
    assert_ok(lpca_try_fit(ctx, m.ds, settings[i], &job, &model));
    btf_context_memory(ctx, NULL, &peak);
    const double error = model_squared_error(model, &m);
    assert_ok(btf_model_save(model, test_path("budget.btfz"), 0, NULL, NULL));
    free(test_read_bytes(test_path("budget.btfz"), &payload));
    print_message("budget %.1f MiB, payload %.1f MiB, peak %.2f MiB\n",
                  (double)job.max_working_set / 1048576.0, (double)payload / 1048576.0,
                  (double)peak / 1048576.0);
    /* Beside: what the data set holds, and some KiB for options, the state and the list of chunks. */
    assert_true(peak <= before + job.max_working_set + payload + (64u << 10));
    btf_model_release(model);
    if (i == 0) {
      assert_true((double)m.count * m.count * 3 * 768 * 4 > 2.5 * (8 << 20)); /* of data */
      model = lpca_fit(ctx, &m, settings[i]);
      assert_true(error <= 1.1 * model_squared_error(model, &m)); /* the subspace shrank, no more */
      btf_model_release(model);
    }
    material_release(&m);
    test_context_done(ctx, &memory);
  }
}

/* Whatever the budget, a fit works, or names a budget that does: with a subspace of its choice, and with one
 * that is asked for, wide and long data, streamed by images and by texels. */
static void test_named_budget(void **unused) {
  (void)unused;
  const char *const settings[] = {"clusters=3 components=4 iterations=1 refine=0",
                                  "clusters=3 components=4 iterations=1 refine=0 subspace=60"};
  btf_context *ctx = test_context_with(&memory, NULL, 2);
  int refused = 0;
  for (int shape = 0; shape < 4; shape++) {
    material m = material_create(ctx, MATERIAL_GLOSSY, shape / 2 == 0 ? "grid:8x3" : "grid:3x2",
                                 shape / 2 == 0 ? 16 : 64, 16, 3, shape % 2 == 0, BTF_WRAP_PERIODIC);
    for (size_t i = 0; i < 2; i++)
      for (uint64_t budget = 50000; budget < 5000000; budget *= 4) {
        btf_job job = BTF_JOB_INIT;
        btf_model *model;
        job.max_working_set = budget;
        btf_status status = lpca_try_fit(ctx, m.ds, settings[i], &job, &model);
        if (status == BTF_E_LIMIT) {
          const char *at = strstr(btf_error_message(), "working set of ");
          assert_non_null(at);
          job.max_working_set = strtoull(at + 15, NULL, 10) << 20;
          assert_true(job.max_working_set > budget);
          status = lpca_try_fit(ctx, m.ds, settings[i], &job, &model);
          refused++;
        }
        if (status != BTF_OK)
          fail_msg("shape %d, %s, %llu bytes: %s", shape, settings[i], (unsigned long long)budget,
                   btf_error_message());
        btf_model_release(model);
      }
    material_release(&m);
  }
  assert_true(refused > 4);
  test_context_done(ctx, &memory);
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
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 8, 8, 3, true, BTF_WRAP_PERIODIC);
  const char *const settings[] = {"clusters=4 components=3 restarts=2", "clusters=4 psnr=35"};
  for (size_t i = 0; i < 2; i++) {
    int cancelled = 0;
    for (int calls = 0; calls < 500; calls += 1 + calls / 8) {
      cancel_after c = {calls, 0, 0.0};
      btf_job job = BTF_JOB_INIT;
      btf_model *model;
      job.progress = cancel_progress;
      job.user = &c;
      const btf_status status = lpca_try_fit(ctx, m.ds, settings[i], &job, &model);
      if (status == BTF_OK) {
        assert_true(c.last == 1.0);
        btf_model_release(model);
        break;
      }
      assert_int_equal(status, BTF_E_CANCELLED);
      assert_null(model);
      cancelled++;
    }
    assert_in_range(cancelled, 3, 499);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Every allocation of fit, save and load fails in turn: a status, and no leak. */
static void test_failing_allocations(void **unused) {
  (void)unused;
  const char *const settings[] = {"clusters=3 components=2",
                                  "clusters=3 psnr=30 storage=q8 restarts=2 refine=1"};
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 6, 4, 3, true, BTF_WRAP_PERIODIC);
  for (size_t i = 0; i < 2; i++) {
    long failures = 0;
    for (long at = 1; at < 20000; at += 1 + at / 40) {
      const long live = memory.live_blocks;
      btf_model *model = NULL, *loaded = NULL;
      memory.fail_at = memory.total_allocations + at;
      btf_status status = lpca_try_fit(ctx, m.ds, settings[i], NULL, &model);
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

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_one_cluster_is_pca),
                                     cmocka_unit_test(test_planted_clusters),
                                     cmocka_unit_test(test_cost_is_monotone),
                                     cmocka_unit_test(test_assignment),
                                     cmocka_unit_test(test_subspace_against_data),
                                     cmocka_unit_test(test_better_than_fmf),
                                     cmocka_unit_test(test_quality_knobs),
                                     cmocka_unit_test(test_targets),
                                     cmocka_unit_test(test_sizes),
                                     cmocka_unit_test(test_quantisation_bound),
                                     cmocka_unit_test(test_shapes),
                                     cmocka_unit_test(test_degenerate),
                                     cmocka_unit_test(test_determinism),
                                     cmocka_unit_test(test_budget),
                                     cmocka_unit_test(test_named_budget),
                                     cmocka_unit_test(test_cancel),
                                     cmocka_unit_test(test_failing_allocations)};
  return btf_run("lpca", tests);
}
