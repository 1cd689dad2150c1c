/* SPDX-License-Identifier: MIT */
/* Codebooks of each method: planted clusters are found, inertia falls to a fixed point, none is wasted. */
#include <float.h>

#include "test_cmf_vectors.h"

static test_memory memory;

/* ---- k-means ---- */

/* FAC12. Rounding an entry to floats adds at most count * length * (2^-24 largest element)^2 to the least
 * inertia. */
static void test_inertia_never_rises(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint64_t seed = 1; seed <= 4; seed++) {
    const sample s = sample_curves(700, 96, seed);
    const btfi_cmf_vectors vectors = vectors_of(&s);
    const btfi_cmf_cluster_options options = {.entries = 24, .tolerance = 1e-9, .seed = seed};
    btfi_cmf_codebook book;
    const double rounding = 700 * 96 * pow(1.5 * ldexp(1.0, -24), 2);
    double inertia = 0.0;
    uint32_t bad_start[700];
    for (uint32_t v = 0; v < 700; v++) bad_start[v] = v % 24;
    assert_ok(btfi_cmf_cluster_from(btfi_host(), ctx, &vectors, &options, bad_start, NULL, 0, 1, "", &book));
    assert_int_equal(book.entries, 24);
    assert_true(book.iterations > 5);
    for (uint32_t i = 1; i < book.iterations; i++)
      assert_true(book.history[i] <= book.history[i - 1] + rounding);
    assert_true(book.history[book.iterations - 1] < 0.8 * book.history[0]);
    expect_nearest(&s, book.values, book.entries, book.index, NULL);
    for (uint64_t v = 0; v < s.count; v++) inertia += distance_to(&s, v, book.values + book.index[v] * 96);
    assert_relative(book.inertia, inertia, 96 * DBL_EPSILON);
    assert_true(book.inertia == book.history[book.iterations - 1]);
    free_codebook(ctx, &book);
    free(s.values);
  }
  test_context_done(ctx, &memory);
}

/* Converged entries are the means of their vectors: no iteration is cut short by the bounds that skip
 * vectors. */
static void test_fixed_point_of_lloyd(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const sample s = sample_curves(500, 40, 11);
  const btfi_cmf_vectors vectors = vectors_of(&s);
  const btfi_cmf_cluster_options options = {
      .entries = 12, .tolerance = 1e-300, .max_iterations = 1000, .seed = 3};
  btfi_cmf_codebook book;
  assert_ok(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &book));
  assert_true(book.iterations < 1000);
  expect_nearest(&s, book.values, book.entries, book.index, NULL);
  for (uint32_t e = 0; e < book.entries; e++) {
    for (uint32_t i = 0; i < s.length; i++) {
      double sum = 0.0, n = 0.0;
      for (uint64_t v = 0; v < s.count; v++) {
        if (book.index[v] != e) continue;
        sum += (double)s.values[v * s.length + i];
        n++;
      }
      /* half a unit of the last place of values below 1 */
      assert_near(book.values[e * s.length + i], sum / n, ldexp(1.0, -25) * (1.0 + 1e-6));
    }
  }
  free_codebook(ctx, &book);
  free(s.values);
  test_context_done(ctx, &memory);
}

/* Centres are at least `apart` from each other and vectors within 0.05 apart of them: the planted partition
 * is the best. */
static sample planted(uint32_t clusters, uint32_t each, uint32_t length, double offset, uint64_t seed,
                      float *means) {
  sample s = sample_create((uint64_t)clusters * each, length);
  double *sum = calloc(length, sizeof *sum);
  for (uint32_t c = 0; c < clusters; c++) {
    float *centre = means + (size_t)c * length;
    for (uint32_t i = 0; i < length; i++) centre[i] = (float)(offset + random_normal(&seed));
    memset(sum, 0, length * sizeof *sum);
    for (uint32_t n = 0; n < each; n++) {
      float *value = s.values + (c + (size_t)n * clusters) * length; /* clusters take turns */
      for (uint32_t i = 0; i < length; i++) {
        value[i] = (float)((double)centre[i] + 0.03 * random_normal(&seed));
        sum[i] += (double)value[i];
      }
    }
    for (uint32_t i = 0; i < length; i++) centre[i] = (float)(sum[i] / each);
  }
  free(sum);
  return s;
}

static void test_planted_clusters_are_found(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  enum { clusters = 40, each = 25, length = 150 };
  float *means = malloc(sizeof *means * clusters * length);
  for (uint64_t seed = 1; seed <= 6; seed++) {
    const double offset = seed % 2 ? 0.0 : 30.0;
    const sample s = planted(clusters, each, length, offset, seed, means);
    btfi_cmf_codebook book = make_codebook(ctx, &s, CMF_KMEANS, clusters, seed);
    assert_int_equal(book.entries, clusters);
    uint32_t entry_of[clusters];
    for (uint32_t c = 0; c < clusters; c++) entry_of[c] = book.index[c];
    for (uint32_t c = 0; c < clusters; c++)
      for (uint32_t d = 0; d < c; d++) assert_int_not_equal(entry_of[c], entry_of[d]);
    for (uint64_t v = 0; v < s.count; v++) assert_int_equal(book.index[v], entry_of[v % clusters]);
    /* Sums in double of other order: the float next to it at most. */
    for (uint32_t c = 0; c < clusters; c++)
      for (uint32_t i = 0; i < length; i++)
        assert_near(book.values[(size_t)entry_of[c] * length + i], means[(size_t)c * length + i],
                    ldexp(fabs((double)means[(size_t)c * length + i]), -23));
    free_codebook(ctx, &book);
    free(s.values);
  }
  free(means);
  test_context_done(ctx, &memory);
}

static void test_few_distinct_vectors(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const uint32_t lengths[] = {1, 3, 200};
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
    for (uint32_t l = 0; l < 3; l++) {
      /* Five distinct vectors, one of them 80 times of 100; then all distinct. */
      for (uint32_t distinct = 5; distinct <= 100; distinct += 95) {
        sample s = sample_create(100, lengths[l]);
        for (uint64_t v = 0; v < 100; v++) {
          const uint64_t kind = distinct == 100 ? v : v < 80 ? 0 : (v - 80) / 5 + 1;
          for (uint32_t i = 0; i < s.length; i++) s.values[v * s.length + i] = (float)(kind * kind + i);
        }
        const uint32_t wanted[] = {distinct, distinct + 3, 100, 4000};
        for (uint32_t w = 0; w < 4; w++) {
          btfi_cmf_codebook book = make_codebook(ctx, &s, method, wanted[w], 9);
          assert_int_equal(book.entries, distinct);
          assert_true(book.inertia == 0.0);
          for (uint64_t v = 0; v < 100; v++)
            assert_memory_equal(book.values + book.index[v] * s.length, s.values + v * s.length,
                                s.length * sizeof(float));
          free_codebook(ctx, &book);
        }
        free(s.values);
      }
    }
  }
  test_context_done(ctx, &memory);
}

/* Starts that miss most of the distinct vectors: all in one cluster, or found where vectors cannot be told
 * apart (the start adds up elements that are 256 apart, with signs). */
static void test_empty_clusters_are_filled(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  enum { count = 64, length = 1024 };
  sample s = sample_create(2 * count, length);
  const btfi_cmf_vectors vectors = vectors_of(&s);
  const btfi_cmf_cluster_options options = {.entries = count};
  const uint32_t together[2 * count] = {0};
  memset(s.values, 0, 2 * count * length * sizeof *s.values);
  for (uint64_t v = 0; v < 2 * count; v++)
    s.values[v * length + v % count / 4 + 256 * (v % 4)] = 1.0f; /* all twice */
  for (uint64_t seed = 0; seed < 10; seed++) {
    btfi_cmf_codebook book = make_codebook(ctx, &s, CMF_KMEANS, count, seed);
    assert_int_equal(book.entries, count);
    assert_true(book.inertia == 0.0);
    free_codebook(ctx, &book);
  }
  btfi_cmf_codebook book;
  assert_ok(btfi_cmf_cluster_from(btfi_host(), ctx, &vectors, &options, together, NULL, 0, 1, "", &book));
  assert_int_equal(book.entries, count);
  assert_true(book.inertia == 0.0);
  assert_true(book.iterations > 1);
  free_codebook(ctx, &book);
  free(s.values);
  test_context_done(ctx, &memory);
}

static void test_one_entry_is_the_mean(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const sample s = sample_curves(130, 33, 5);
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
    btfi_cmf_codebook book = make_codebook(ctx, &s, method, 1, 2);
    assert_int_equal(book.entries, 1);
    for (uint32_t i = 0; i < 33; i++) {
      double sum = 0.0;
      for (uint64_t v = 0; v < 130; v++) sum += (double)s.values[v * 33 + i];
      assert_near(book.values[i], sum / 130, ldexp(1.0, -24));
    }
    free_codebook(ctx, &book);
  }
  free(s.values);
  test_context_done(ctx, &memory);
}

/* ---- trees ---- */

/* Eight points of a box of unequal sides, each with near neighbours: every split of the tree separates one
 * side. */
static void test_tree_finds_nested_clusters(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  uint64_t seed = 4;
  sample s = sample_create(400, 30);
  for (uint64_t v = 0; v < 400; v++)
    for (uint32_t i = 0; i < 30; i++) {
      const double side = i == 0 ? 16.0 : i == 1 ? 8.0 : i == 2 ? 4.0 : 0.0;
      s.values[v * 30 + i] = (float)(side * (double)(v >> (i < 3 ? i : 0) & 1) + 0.02 * random_normal(&seed));
    }
  for (uint32_t method = CMF_TSVQ; method <= CMF_MEDIAN_CUT; method++) {
    btfi_cmf_codebook book = make_codebook(ctx, &s, method, 8, 0);
    assert_int_equal(book.entries, 8);
    for (uint64_t v = 8; v < 400; v++) assert_int_equal(book.index[v], book.index[v % 8]);
    for (uint64_t v = 0; v < 8; v++)
      for (uint64_t w = 0; w < v; w++) assert_int_not_equal(book.index[v], book.index[w]);
    free_codebook(ctx, &book);
  }
  free(s.values);
  test_context_done(ctx, &memory);
}

/* Numbers 0 to 15 are cut into runs of four. */
static void test_median_cut_of_numbers(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  sample s = sample_create(16, 1);
  for (uint32_t v = 0; v < 16; v++) s.values[v] = (float)(v * 7 % 16);
  btfi_cmf_codebook book = make_codebook(ctx, &s, CMF_MEDIAN_CUT, 4, 0);
  assert_int_equal(book.entries, 4);
  for (uint32_t v = 0; v < 16; v++)
    assert_true(book.values[book.index[v]] == floorf(s.values[v] / 4.0f) * 4.0f + 1.5f);
  free_codebook(ctx, &book);
  free(s.values);
  test_context_done(ctx, &memory);
}

/* FAC13: k-means is better than the trees (Suykens et al., section 5), and the tree that follows the data
 * better than median cut. Every method is far better than one entry. */
static void test_methods_compared(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint64_t seed = 1; seed <= 3; seed++) {
    const sample s = sample_curves(1500, 120, 77 + seed);
    double inertia[CMF_CLUSTERINGS];
    btfi_cmf_codebook one = make_codebook(ctx, &s, CMF_TSVQ, 1, seed);
    for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
      btfi_cmf_codebook book = make_codebook(ctx, &s, method, 64, seed);
      assert_int_equal(book.entries, 64);
      expect_nearest(&s, book.values, book.entries, book.index, NULL);
      inertia[method] = book.inertia;
      free_codebook(ctx, &book);
    }
    print_message("inertia with 64 of 1500 entries, in parts of that with one: k-means %.4f, tree %.4f, "
                  "median cut %.4f\n",
                  inertia[CMF_KMEANS] / one.inertia, inertia[CMF_TSVQ] / one.inertia,
                  inertia[CMF_MEDIAN_CUT] / one.inertia);
    assert_true(inertia[CMF_KMEANS] < inertia[CMF_TSVQ]);
    assert_true(inertia[CMF_TSVQ] < inertia[CMF_MEDIAN_CUT]);
    assert_true(inertia[CMF_MEDIAN_CUT] < 0.5 * one.inertia);
    free_codebook(ctx, &one);
    free(s.values);
  }
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_inertia_never_rises),        cmocka_unit_test(test_fixed_point_of_lloyd),
      cmocka_unit_test(test_planted_clusters_are_found), cmocka_unit_test(test_few_distinct_vectors),
      cmocka_unit_test(test_empty_clusters_are_filled),  cmocka_unit_test(test_one_entry_is_the_mean),
      cmocka_unit_test(test_tree_finds_nested_clusters), cmocka_unit_test(test_median_cut_of_numbers),
      cmocka_unit_test(test_methods_compared),
  };
  return btf_run("cmf_cluster", tests);
}
