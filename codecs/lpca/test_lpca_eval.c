/* SPDX-License-Identifier: MIT */
/* Evaluation: interpolation against brute force, borders of clusters, instruction sets against the scalar
 * reference, batches against single queries, levels of detail against averaged ABRDFs, threads. */
#include "test_clusters.h"

#include <pthread.h>

#include <btf/btf_sampling.h>

#include "dataset/dataset.h"

static test_memory memory;
static const char *const storage_names[] = {"f16", "f32", "q8"};
static const char *const packing_names[] = {"aligned", "tight"};

enum { QUERIES = 300 };

/* Random ones, at samples, on texel centres, repeated directions, outside of every domain. */
static void make_queries(const btf_dirset *set, btf_query *queries) {
  const float *xyz = btf_dirset_directions(set);
  const uint32_t count = btf_dirset_count(set);
  for (uint32_t i = 0; i < QUERIES; i++) {
    btf_query *q = &queries[i];
    *q = (btf_query){{0}, {0}, {4.0f * test_random() - 2.0f, 4.0f * test_random() - 2.0f}, 0.0f, 0};
    test_random_direction(q->light);
    test_random_direction(q->view);
    if (i % 5 == 1) memcpy(q->light, xyz + 3 * (i % count), sizeof q->light);
    if (i % 7 == 1) memcpy(q->view, xyz + 3 * (i / 2 % count), sizeof q->view);
    if (i % 3 == 2) memcpy(q->light, queries[i - 1].light, sizeof q->light);
    if (i % 6 == 2) memcpy(q->view, queries[i - 1].view, sizeof q->view);
    if (i % 4 == 2) q->uv[0] = 0.5f / 12.0f;
    if (i % 4 > 1) q->lod = 6.0f * test_random() - 1.0f;
  }
}

/* Colours of all samples around a query, blended in double. */
static void brute_force(const btf_model *model, const material *m, uint32_t wrap, const btf_query *q,
                        double *out) {
  btf_interp light, view;
  btf_level_pair level;
  btf_dirset_locate(m->directions, q->light, &light);
  btf_dirset_locate(m->directions, q->view, &view);
  btf_sampling_levels(q->lod, lpca_state(model)->layout.levels, &level);
  for (uint32_t c = 0; c < m->channels; c++) out[c] = 0.0;
  for (uint32_t k = 0; k < 2; k++) {
    btf_bilinear texels;
    btf_sampling_bilinear(q->uv[0], q->uv[1], btf_sampling_level_size(m->width, level.level[k]),
                          btf_sampling_level_size(m->height, level.level[k]), wrap, &texels);
    for (uint32_t i = 0; i < 36; i++) {
      const uint32_t l = i % 3, v = i / 3 % 3, t = i / 9;
      const double weight =
          (double)level.weight[k] * light.weight[l] * view.weight[v] * texels.wx[t % 2] * texels.wy[t / 2];
      float value[64];
      if (weight == 0.0) continue;
      btf_model_texel(model, level.level[k], texels.x[t % 2], texels.y[t / 2], light.index[l], view.index[v],
                      value);
      for (uint32_t c = 0; c < m->channels; c++) out[c] += weight * value[c];
    }
  }
}

/* Bounds float rounding: each product is rounded when blended over 8 texels, over 9 rows and summed over
 * components, and factors are at most 1 times the scales of the cluster: (components + 30) halves of eps of
 * their sum. */
static double rounding_bound(const btf_model *model) {
  const btfi_lpca_state *s = lpca_state(model);
  const uint32_t step = s->layout.padded + LPCA_LANES;
  double most = 0.0;
  for (uint32_t k = 0; k < s->layout.clusters; k++) {
    double sum = 0.0;
    for (uint32_t j = 0; j < step; j++)
      sum += fabs((double)s->scales[k * step + j]) *
             (s->layout.storage == LPCA_Q8 && j < s->layout.padded ? 127.0 : 1.0);
    most = fmax(most, sum);
  }
  return (s->layout.components + 30.0) * 6e-8 * most;
}

/* INT01, INT05: 3 x 3 x 4 x 2 interpolation is the blend of decoded samples, for all storages, packings,
 * wraps and numbers of channels. */
static void test_interpolation(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  btf_context *ctx = test_context(&memory);
  const uint32_t channels[] = {1, 3, 5, 64}, components[] = {3, 8, 13, 17};
  for (uint32_t i = 0; i < 4; i++)
    for (uint32_t storage = 0; storage < LPCA_STORAGES; storage++) {
      const uint32_t wrap = (i + storage) % 2 ? BTF_WRAP_CLAMP : BTF_WRAP_PERIODIC;
      material m = material_create(ctx, MATERIAL_GLOSSY, i == 3 ? "grid:3x1" : "grid:5x3", 12, 7, channels[i],
                                   true, wrap);
      char settings[96];
      snprintf(settings, sizeof settings, "clusters=4 components=%u storage=%s packing=%s",
               components[(i + storage) % 4], storage_names[storage], packing_names[(i + storage) % 2]);
      btf_model *model = lpca_fit(ctx, &m, settings);
      const double bound = 2.0 * rounding_bound(model);
      make_queries(m.directions, queries);
      for (uint32_t n = 0; n < QUERIES; n++) {
        double expected[64];
        float got[64];
        btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
        brute_force(model, &m, wrap, &queries[n], expected);
        for (uint32_t c = 0; c < channels[i]; c++)
          if (!(fabs(got[c] - expected[c]) <= bound))
            fail_msg("%s, %u channels, query %u: %.9g instead of %.9g within %.3g", settings, channels[i], n,
                     got[c], expected[c], bound);
      }
      btf_model_release(model);
      material_release(&m);
    }
  test_context_done(ctx, &memory);
}

/* INT06: half way between two texels is the mean of both, within a cluster, where weights are blended, and
 * across borders, where blending weights would smear: it misses by far more. */
static void test_borders(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_of(ctx, MATERIAL_CHECKS, "grid:5x3", 16, 16);
  btf_model *model = lpca_fit(ctx, &m, "clusters=6 components=5 storage=f32");
  const btfi_lpca_state *s = lpca_state(model);
  const float *xyz = btf_dirset_directions(m.directions);
  const double bound = 2.0 * rounding_bound(model);
  double smeared = 0.0, within = 0.0, across = 0.0;
  uint32_t inner = 0, outer = 0;
  for (uint32_t t = 0; t < 256; t++) {
    const uint32_t x = t % 16, y = t / 16, next = y * 16 + (x + 1) % 16, a = lpca_label(s, 0, t),
                   b = lpca_label(s, 0, next);
    for (uint32_t pair = 0; pair < 225; pair += 13) {
      btf_query q = {{0}, {0}, {((float)x + 1.0f) / 16.0f, ((float)y + 0.5f) / 16.0f}, 0.0f, 0};
      float got[3], left[3], right[3], mixed[3] = {0};
      memcpy(q.light, xyz + 3 * (pair % 15), sizeof q.light);
      memcpy(q.view, xyz + 3 * (pair / 15), sizeof q.view);
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
      btf_model_texel(model, 0, x, y, pair % 15, pair / 15, left);
      btf_model_texel(model, 0, (x + 1) % 16, y, pair % 15, pair / 15, right);
      /* What blended weights would make: both texels as if of the first one's cluster. */
      const btfi_lpca_taps taps = {.row = {pair * s->layout.row_bytes},
                                   .row_weight = {1.0f},
                                   .rows = 1,
                                   .texels = 2,
                                   .cluster = {a, a},
                                   .texel_weight = {0.5f, 0.5f},
                                   .weights = {s->weights[0] + t * s->layout.texel_bytes,
                                               s->weights[0] + next * s->layout.texel_bytes}};
      s->shade(s, &taps, mixed);
      for (int c = 0; c < 3; c++) {
        const double mean = 0.5 * ((double)left[c] + right[c]), error = fabs(got[c] - mean);
        assert_true(error <= bound);
        if (a == b) within = fmax(within, error);
        if (a != b) across = fmax(across, error);
        if (a != b) smeared = fmax(smeared, fabs(mixed[c] - mean));
      }
    }
    if (a == b) {
      inner++;
    } else {
      outer++;
    }
  }
  print_message("%u pairs within clusters: %.2g from the mean; %u across: %.2g, by blended weights %.2g\n",
                inner, within, outer, across, smeared);
  assert_true(inner > 20 && outer > 20);
  assert_true(within <= 1e-6 && across <= 1e-6);
  assert_true(smeared > 1e3 * across && smeared > 0.05);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Batches of every length equal single queries bit for bit, hostile queries among them. */
static void test_batch_equals_single(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float results[6][QUERIES];
  float *out[6];
  const float strange[] = {NAN, INFINITY, -INFINITY, 1e38f, -1e-42f, 0.0f, -1.0f};
  const char *const sets[] = {"scalar", "avx2"};
  for (int c = 0; c < 6; c++) out[c] = results[c];
  for (size_t isa = 0; isa < 2; isa++) {
    btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
    btf_context *ctx;
    desc.isa = sets[isa];
    if (btf_context_create(&desc, &ctx) != BTF_OK) continue;
    for (uint32_t storage = 0; storage < LPCA_STORAGES; storage++) {
      const uint32_t channels = storage % 2 ? 3 : 6;
      material m =
          material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, channels, true, BTF_WRAP_PERIODIC);
      char settings[96];
      snprintf(settings, sizeof settings, "clusters=%u components=%u storage=%s", 3 + 2 * storage,
               5 + 6 * storage, storage_names[storage]);
      btf_model *model = lpca_fit(ctx, &m, settings);
      make_queries(m.directions, queries);
      for (uint32_t n = 0; n < QUERIES; n += 9)
        ((float *)(void *)&queries[n])[n / 9 % 9] = strange[n / 9 % 7];
      for (uint32_t flags = 0; flags < 2; flags++)
        for (size_t count = 0; count <= QUERIES; count = count < 20 ? count + 1 : count + 70) {
          suite_eval_batch(model, queries, count, flags ? BTF_QUERY_NEAREST : 0, out);
          for (size_t n = 0; n < count; n++) {
            float single[64];
            queries[n].flags = flags ? BTF_QUERY_NEAREST : 0;
            btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, single);
            for (uint32_t c = 0; c < channels; c++)
              if (memcmp(&single[c], &results[c][n], sizeof single[c]) != 0)
                fail_msg("%s %s, query %zu of %zu, channel %u: %.9g and %.9g", sets[isa], settings, n, count,
                         c, single[c], results[c][n]);
          }
        }
      btf_model_release(model);
      material_release(&m);
    }
    btf_context_release(ctx);
  }
}

static btf_model *reload(const btf_model *model, btf_context *ctx) {
  btf_model *loaded;
  assert_ok(btf_model_save(model, test_path("model.btfz"), 0, NULL, NULL));
  assert_ok(btf_model_load(ctx, test_path("model.btfz"), &loaded));
  return loaded;
}

/* The same payload with every instruction set agrees with the scalar reference to rounding; a model from a
 * file is the fitted one bit for bit. */
static void test_instruction_sets(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float reference[QUERIES][5];
  const char *const sets[] = {"scalar", "avx2", "avx512", NULL};
  for (uint32_t i = 0; i < 12; i++) {
    const uint32_t components[] = {1, 8, 12, 33}, channels = i % 2 ? 5 : 3;
    btf_context *fit_ctx = test_context(&memory);
    material m =
        material_create(fit_ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 12, channels, true, BTF_WRAP_PERIODIC);
    char settings[96];
    snprintf(settings, sizeof settings, "clusters=%u components=%u storage=%s packing=%s", i == 5 ? 144 : 3,
             components[i / 3], storage_names[i % 3], packing_names[i / 2 % 2]);
    btf_model *fitted = lpca_fit(fit_ctx, &m, settings);
    make_queries(m.directions, queries);
    for (size_t isa = 0; isa < 4; isa++) {
      btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
      btf_context *ctx;
      desc.isa = sets[isa];
      if (btf_context_create(&desc, &ctx) != BTF_OK) continue;
      btf_model *model = reload(fitted, ctx);
      const double bound = 2.0 * rounding_bound(model);
      for (uint32_t n = 0; n < QUERIES; n++) {
        float got[5], fresh[5];
        queries[n].flags = n % 3 == 2 ? BTF_QUERY_NEAREST : 0;
        btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
        if (isa == 0) memcpy(reference[n], got, sizeof got);
        for (uint32_t c = 0; c < channels; c++) assert_near(got[c], reference[n][c], bound);
        if (sets[isa] != NULL) continue;
        btf_model_eval_as(fitted, &queries[n], BTF_VALUE_STORED, fresh);
        assert_memory_equal(fresh, got, channels * sizeof *got);
      }
      btf_model_release(model);
      btf_context_release(ctx);
    }
    btf_model_release(fitted);
    material_release(&m);
    test_context_done(fit_ctx, &memory);
  }
}

/* The least error of an ABRDF over all clusters of a model, by solving for the weights in double: factors are
 * read back by evaluation with unit weights. */
static double least_error(const btfi_lpca_state *s, const double *abrdf, uint32_t pairs) {
  const btfi_lpca_layout *l = &s->layout;
  const uint32_t n = l->components, rows = pairs * 3;
  double least = INFINITY;
  double *e = malloc((size_t)(n + 1) * rows * sizeof *e);
  for (uint32_t k = 0; k < l->clusters; k++) {
    for (uint32_t row = 0; row < rows; row++) {
      const unsigned char *at = s->factors + k * l->cluster_bytes + row / 3 * l->row_bytes;
      float value;
      memcpy(&value, at + l->mean_at + 4 * (row % 3), 4);
      e[row] = abrdf[row] - (double)value * s->scales[k * (l->padded + LPCA_LANES) + l->padded];
      for (uint32_t j = 0; j < n; j++) {
        memcpy(&value, at + (row % 3 * l->stride + j) * 4, 4);
        e[(size_t)(j + 1) * rows + row] = value;
      }
    }
    /* Gram-Schmidt: what is left of the ABRDF. */
    double error = 0.0;
    for (uint32_t j = 1; j <= n; j++) {
      double square = 0.0;
      double *v = e + (size_t)j * rows;
      for (uint32_t i = 0; i <= n; i++) {
        double along = 0.0;
        if (i > 0 && i <= j) continue;
        square = 0.0;
        for (uint32_t r = 0; r < rows; r++) {
          along += e[(size_t)i * rows + r] * v[r];
          square += v[r] * v[r];
        }
        if (square <= 0.0) continue;
        for (uint32_t r = 0; r < rows; r++) e[(size_t)i * rows + r] -= along / square * v[r];
      }
    }
    for (uint32_t r = 0; r < rows; r++) error += e[r] * e[r];
    least = fmin(least, error);
  }
  free(e);
  return least;
}

/* INT05: a texel of a coarser level decodes to the affine combination that is nearest to the average of the
 * ABRDFs it covers, of all that the clusters offer. */
static void test_levels(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const uint32_t sizes[][2] = {{12, 7}, {16, 16}, {1, 9}};
  for (size_t i = 0; i < 3; i++) {
    const uint32_t width = sizes[i][0], height = sizes[i][1], texels = width * height, pairs = 64;
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", width, height, 3, true, BTF_WRAP_PERIODIC);
    btf_model *model = lpca_fit(ctx, &m, "clusters=4 components=5 storage=f32");
    const btfi_lpca_state *s = lpca_state(model);
    float *all = malloc((size_t)texels * pairs * 3 * sizeof *all),
          *average = malloc((size_t)texels * pairs * 3 * sizeof *average);
    double sum = 0.0, best = 0.0, energy = 0.0;
    assert_int_equal(s->layout.levels, btfi_mip_count(width, height));
    for (uint32_t t = 0; t < texels; t++)
      for (uint32_t row = 0; row < pairs * 3; row++)
        all[t * pairs * 3 + row] = (float)material_row(&m, t, row);
    for (uint32_t level = 1; level < s->layout.levels; level++) {
      assert_ok(btfi_mip_filter(ctx, all, pairs * 3, width, height, pairs * 3, level, average, pairs * 3));
      for (uint32_t t = 0; t < s->layout.level_width[level] * s->layout.level_height[level]; t++) {
        double abrdf[192], error = 0.0;
        for (uint32_t row = 0; row < 192; row++) {
          float got[3];
          btf_model_texel(model, level, t % s->layout.level_width[level], t / s->layout.level_width[level],
                          row / 3 % 8, row / 3 / 8, got);
          abrdf[row] = average[t * 192 + row];
          error += pow(got[row % 3] - abrdf[row], 2.0);
          energy += abrdf[row] * abrdf[row];
        }
        sum += error;
        best += least_error(s, abrdf, pairs);
      }
    }
    print_message("levels of %u x %u: relative error %.5f, best for the tables %.5f\n", width, height,
                  sqrt(sum / energy), sqrt(best / energy));
    /* Float weights, and coefficients that are all there is of so few ABRDFs. */
    assert_true(sum <= best * 1.001 + 1e-9 * energy);
    assert_true(sum >= best * 0.999 - 1e-9 * energy);
    free(all);
    free(average);
    btf_model_release(model);
    model = lpca_fit(ctx, &m, "clusters=2 components=3 levels=2");
    assert_int_equal(lpca_state(model)->layout.levels, 2);
    btf_model_release(model);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

/* Two materials on affine subspaces of 1 dimension, texel by texel in turn like the squares of a
 * checkerboard. Every coarser texel is a mixture and lies in neither, but all mixtures lie on one of 3
 * dimensions: the two of the materials and the way from one to the other. With a cluster of as many
 * components for them, the coarser levels are what averaging the data's ABRDFs gives, and the finest level is
 * exact all the same. */
static void test_levels_of_mixtures(void **unused) {
  (void)unused;
  enum { SIDE = 16, PAIRS = 64, VALUES = 3 * PAIRS };
  btf_context *ctx = test_context(&memory);
  material m = planted_material(ctx, SIDE, SIDE, 2, 1);
  for (uint32_t t = 0; t < SIDE * SIDE; t += 2)
    for (uint32_t i = 0; i < VALUES && t / SIDE % 2 == 1; i++) {
      float *at = m.samples + ((size_t)(i / 3) * SIDE * SIDE + t) * 3 + i % 3;
      const float left = at[0];
      at[0] = at[3];
      at[3] = left;
    }
  float *all = malloc((size_t)SIDE * SIDE * VALUES * sizeof *all),
        *average = malloc((size_t)SIDE * SIDE * VALUES * sizeof *average);
  for (uint32_t t = 0; t < SIDE * SIDE; t++)
    for (uint32_t row = 0; row < VALUES; row++) all[t * VALUES + row] = (float)material_row(&m, t, row);
  btf_model *model = lpca_fit(ctx, &m, "clusters=8 components=4 storage=f32");
  for (uint32_t level = 0; level < 5; level++) {
    const uint32_t side = SIDE >> level;
    double error = 0.0, energy = 0.0;
    assert_ok(btfi_mip_filter(ctx, all, VALUES, SIDE, SIDE, VALUES, level, average, VALUES));
    for (uint32_t t = 0; t < side * side; t++)
      for (uint32_t pair = 0; pair < PAIRS; pair++) {
        float got[3];
        btf_model_texel(model, level, t % side, t / side, pair % 8, pair / 8, got);
        for (uint32_t c = 0; c < 3; c++) {
          const double expected = average[t * VALUES + pair * 3 + c];
          error += pow(got[c] - expected, 2.0);
          energy += expected * expected;
        }
      }
    print_message("level %u of mixtures: relative error %.3g\n", level, sqrt(error / energy));
    /* Exact but for float rounding of coefficients, bases, weights and sums. A cluster of one material would
     * be off by about the distance of the materials, a third of the norm. */
    assert_true(sqrt(error / energy) < 5e-6);
  }
  btf_model_release(model);
  free(all);
  free(average);
  material_release(&m);
  test_context_done(ctx, &memory);
}

typedef struct reader_thread {
  pthread_t thread;
  const btf_model *model;
  const btf_query *queries;
  float (*results)[3];
} reader_thread;

static void *read_all(void *user) {
  const reader_thread *r = user;
  for (int turn = 0; turn < 20; turn++)
    for (uint32_t n = 0; n < QUERIES; n++) btf_model_eval(r->model, &r->queries[n], r->results[n]);
  return NULL;
}

/* Eight threads on one model get what one gets, and evaluation does not allocate. */
static void test_threads(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float results[8][QUERIES][3];
  reader_thread readers[8];
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:5x3", 12, 7, 3, true, BTF_WRAP_PERIODIC);
  btf_model *model = lpca_fit(ctx, &m, "clusters=5");
  make_queries(m.directions, queries);
  const long allocations = memory.total_allocations;
  for (int i = 0; i < 8; i++) {
    readers[i] = (reader_thread){.model = model, .queries = queries, .results = results[i]};
    assert_int_equal(pthread_create(&readers[i].thread, NULL, read_all, &readers[i]), 0);
  }
  for (int i = 0; i < 8; i++) pthread_join(readers[i].thread, NULL);
  for (int i = 1; i < 8; i++) assert_memory_equal(results[0], results[i], sizeof results[0]);
  assert_int_equal(memory.total_allocations, allocations);
  btf_model_release(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_interpolation),
                                     cmocka_unit_test(test_borders),
                                     cmocka_unit_test(test_batch_equals_single),
                                     cmocka_unit_test(test_instruction_sets),
                                     cmocka_unit_test(test_levels),
                                     cmocka_unit_test(test_levels_of_mixtures),
                                     cmocka_unit_test(test_threads)};
  return btf_run("lpca_eval", tests);
}
