/* SPDX-License-Identifier: MIT */
/* Codebooks: recovered clusters, exact assignment, memory and failures. */
#include "btf_test.h"

#include <float.h>

#include "base/base.h"
#include "cluster_parts.h"
#include "registry/registry.h"

static test_memory memory;

static double random_unit(uint64_t *state) {
  *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (double)(*state >> 11) / 9007199254740992.0;
}

static double random_normal(uint64_t *state) {
  double sum = -6.0;
  for (int i = 0; i < 12; i++) sum += random_unit(state);
  return sum;
}

typedef struct sample {
  uint64_t count;
  uint32_t length;
  float *values;
  uint8_t *bytes; /* instead of values */
} sample;

static void read_sample(const void *user, uint64_t index, float *dst) {
  const sample *s = user;
  if (s->bytes == NULL)
    memcpy(dst, s->values + index * s->length, s->length * sizeof *dst);
  else
    for (uint32_t i = 0; i < s->length; i++) dst[i] = (float)s->bytes[index * s->length + i] / 255.0f;
}

static btfi_cmf_vectors vectors_of(const sample *s) {
  const btfi_cmf_vectors vectors = {s->count, s->length, read_sample, s};
  return vectors;
}

static sample sample_create(uint64_t count, uint32_t length) {
  sample s = {count, length, NULL, NULL};
  s.values = malloc(count * length * sizeof *s.values);
  return s;
}

/* Smooth curves of four random waves that differ in phase and amplitude, as factors of similar texels do. */
static sample curves(uint64_t count, uint32_t length, uint64_t seed) {
  sample s = sample_create(count, length);
  for (uint64_t v = 0; v < count; v++) {
    double amplitude[4], phase[4];
    for (int w = 0; w < 4; w++) {
      amplitude[w] = random_unit(&seed) / (w + 1);
      phase[w] = random_unit(&seed);
    }
    for (uint32_t i = 0; i < length; i++) {
      double value = 0.5;
      for (int w = 0; w < 4; w++)
        value += 0.2 * amplitude[w] * sin((w + 1) * 6.28 * i / length + 2.0 * phase[w]);
      s.values[v * length + i] = (float)value;
    }
  }
  return s;
}

/* In plain order, unlike the library's. */
static double distance_to(const sample *s, uint64_t v, const float *entry) {
  double sum = 0.0;
  for (uint32_t i = 0; i < s->length; i++) {
    const double d = (double)s->values[v * s->length + i] - (double)entry[i];
    sum += d * d;
  }
  return sum;
}

/* Every vector is with its nearest entry, ties with the lowest, and distances are right. Sums of squares in
 * another order differ by at most length * 2^-53 of themselves, and so do distances called equal. */
static void check_assignment(const sample *s, const float *values, uint32_t entries, const uint32_t *index,
                             const double *distance) {
  const double tolerance = 2.0 * s->length * DBL_EPSILON;
  for (uint64_t v = 0; v < s->count; v++) {
    double best = INFINITY;
    uint32_t nearest = 0;
    for (uint32_t e = 0; e < entries; e++) {
      const double d = distance_to(s, v, values + (size_t)e * s->length);
      if (d < best) {
        best = d;
        nearest = e;
      }
    }
    assert_true(index[v] < entries);
    const double got = distance_to(s, v, values + (size_t)index[v] * s->length);
    if (index[v] != nearest && !(got <= best * (1.0 + tolerance) && got > best))
      fail_msg("vector %u: entry %u at %.17g instead of %u at %.17g", (unsigned)v, index[v], got, nearest,
               best);
    if (distance != NULL) assert_near(distance[v], best, tolerance * best);
  }
}

static btfi_cmf_codebook cluster(btf_context *ctx, const sample *s, uint32_t method, uint32_t entries,
                                 uint64_t seed) {
  const btfi_cmf_vectors vectors = vectors_of(s);
  const btfi_cmf_cluster_options options = {.method = method, .entries = entries, .seed = seed};
  btfi_cmf_codebook out;
  assert_ok(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "clustering", &out));
  assert_int_equal(out.length, s->length);
  assert_in_range(out.entries, 1, entries);
  return out;
}

static void release(btf_context *ctx, btfi_cmf_codebook *codebook) {
  btfi_cmf_codebook_free(btfi_host(), ctx, codebook);
}

/* ---- k-means ---- */

/* FAC12. Rounding an entry to floats adds at most count * length * (2^-24 largest element)^2 to the least
 * inertia. */
static void test_inertia_never_rises(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint64_t seed = 1; seed <= 4; seed++) {
    const sample s = curves(700, 96, seed);
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
    check_assignment(&s, book.values, book.entries, book.index, NULL);
    for (uint64_t v = 0; v < s.count; v++) inertia += distance_to(&s, v, book.values + book.index[v] * 96);
    assert_relative(book.inertia, inertia, 96 * DBL_EPSILON);
    assert_true(book.inertia == book.history[book.iterations - 1]);
    release(ctx, &book);
    free(s.values);
  }
  test_context_done(ctx, &memory);
}

/* Converged entries are the means of their vectors: no iteration is cut short by the bounds that skip
 * vectors. */
static void test_fixed_point_of_lloyd(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const sample s = curves(500, 40, 11);
  const btfi_cmf_vectors vectors = vectors_of(&s);
  const btfi_cmf_cluster_options options = {
      .entries = 12, .tolerance = 1e-300, .max_iterations = 1000, .seed = 3};
  btfi_cmf_codebook book;
  assert_ok(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &book));
  assert_true(book.iterations < 1000);
  check_assignment(&s, book.values, book.entries, book.index, NULL);
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
  release(ctx, &book);
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
    btfi_cmf_codebook book = cluster(ctx, &s, CMF_KMEANS, clusters, seed);
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
    release(ctx, &book);
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
          btfi_cmf_codebook book = cluster(ctx, &s, method, wanted[w], 9);
          assert_int_equal(book.entries, distinct);
          assert_true(book.inertia == 0.0);
          for (uint64_t v = 0; v < 100; v++)
            assert_memory_equal(book.values + book.index[v] * s.length, s.values + v * s.length,
                                s.length * sizeof(float));
          release(ctx, &book);
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
    btfi_cmf_codebook book = cluster(ctx, &s, CMF_KMEANS, count, seed);
    assert_int_equal(book.entries, count);
    assert_true(book.inertia == 0.0);
    release(ctx, &book);
  }
  btfi_cmf_codebook book;
  assert_ok(btfi_cmf_cluster_from(btfi_host(), ctx, &vectors, &options, together, NULL, 0, 1, "", &book));
  assert_int_equal(book.entries, count);
  assert_true(book.inertia == 0.0);
  assert_true(book.iterations > 1);
  release(ctx, &book);
  free(s.values);
  test_context_done(ctx, &memory);
}

static void test_one_entry_is_the_mean(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const sample s = curves(130, 33, 5);
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
    btfi_cmf_codebook book = cluster(ctx, &s, method, 1, 2);
    assert_int_equal(book.entries, 1);
    for (uint32_t i = 0; i < 33; i++) {
      double sum = 0.0;
      for (uint64_t v = 0; v < 130; v++) sum += (double)s.values[v * 33 + i];
      assert_near(book.values[i], sum / 130, ldexp(1.0, -24));
    }
    release(ctx, &book);
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
    btfi_cmf_codebook book = cluster(ctx, &s, method, 8, 0);
    assert_int_equal(book.entries, 8);
    for (uint64_t v = 8; v < 400; v++) assert_int_equal(book.index[v], book.index[v % 8]);
    for (uint64_t v = 0; v < 8; v++)
      for (uint64_t w = 0; w < v; w++) assert_int_not_equal(book.index[v], book.index[w]);
    release(ctx, &book);
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
  btfi_cmf_codebook book = cluster(ctx, &s, CMF_MEDIAN_CUT, 4, 0);
  assert_int_equal(book.entries, 4);
  for (uint32_t v = 0; v < 16; v++)
    assert_true(book.values[book.index[v]] == floorf(s.values[v] / 4.0f) * 4.0f + 1.5f);
  release(ctx, &book);
  free(s.values);
  test_context_done(ctx, &memory);
}

/* FAC13: k-means is better than the trees (Suykens et al., section 5), and the tree that follows the data
 * better than median cut. Every method is far better than one entry. */
static void test_methods_compared(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint64_t seed = 1; seed <= 3; seed++) {
    const sample s = curves(1500, 120, 77 + seed);
    double inertia[CMF_CLUSTERINGS];
    btfi_cmf_codebook one = cluster(ctx, &s, CMF_TSVQ, 1, seed);
    for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
      btfi_cmf_codebook book = cluster(ctx, &s, method, 64, seed);
      assert_int_equal(book.entries, 64);
      check_assignment(&s, book.values, book.entries, book.index, NULL);
      inertia[method] = book.inertia;
      release(ctx, &book);
    }
    print_message("inertia with 64 of 1500 entries, in parts of that with one: k-means %.4f, tree %.4f, "
                  "median cut %.4f\n",
                  inertia[CMF_KMEANS] / one.inertia, inertia[CMF_TSVQ] / one.inertia,
                  inertia[CMF_MEDIAN_CUT] / one.inertia);
    assert_true(inertia[CMF_KMEANS] < inertia[CMF_TSVQ]);
    assert_true(inertia[CMF_TSVQ] < inertia[CMF_MEDIAN_CUT]);
    assert_true(inertia[CMF_MEDIAN_CUT] < 0.5 * one.inertia);
    release(ctx, &one);
    free(s.values);
  }
  test_context_done(ctx, &memory);
}

/* ---- assignment ---- */

static void check_assign(btf_context *ctx, const sample *s, const float *values, uint32_t entries) {
  const btfi_cmf_vectors vectors = vectors_of(s);
  uint32_t *index = malloc(s->count * sizeof *index);
  double *distance = malloc(s->count * sizeof *distance);
  assert_ok(btfi_cmf_assign(btfi_host(), ctx, &vectors, values, entries, 0, NULL, 0, 1, "", index, distance));
  check_assignment(s, values, entries, index, distance);
  free(index);
  free(distance);
}

static void test_assignment_is_exact(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const uint32_t lengths[] = {1, 7, 64, 511, 513, 1100};
  for (uint32_t l = 0; l < 6; l++) {
    uint64_t seed = 100 + l;
    const sample s = curves(90, lengths[l], seed), book = curves(31, lengths[l], seed + 50);
    check_assign(ctx, &s, book.values, 31);
    free(s.values);
    free(book.values);
  }
  /* Entries that differ by far less than they are from zero, among them equal ones; vectors that are some of
   * them. */
  uint64_t seed = 8;
  sample s = sample_create(120, 300), book = sample_create(40, 300);
  for (uint64_t i = 0; i < 40 * 300; i++) book.values[i] = (float)(1000.0 + 0.001 * random_normal(&seed));
  memcpy(book.values + 7 * 300, book.values + 3 * 300, 300 * sizeof(float));
  memcpy(book.values + 39 * 300, book.values, 300 * sizeof(float));
  for (uint64_t i = 0; i < 120 * 300; i++) s.values[i] = (float)(1000.0 + 100.0 * random_normal(&seed));
  for (uint64_t e = 0; e < 40; e++) memcpy(s.values + e * 300, book.values + e * 300, 300 * sizeof(float));
  check_assign(ctx, &s, book.values, 40);
  /* Vectors half-way between two entries: rounding them to floats decides, by less than products in floats
   * can tell. */
  for (uint64_t i = 0; i < 40 * 300; i++) book.values[i] = (float)random_normal(&seed);
  for (uint64_t v = 0; v < 120; v++)
    for (uint64_t i = 0; i < 300; i++)
      s.values[v * 300 + i] =
          0.5f * (book.values[v % 40 * 300 + i] + book.values[(v + 1 + v / 40) % 40 * 300 + i]);
  check_assign(ctx, &s, book.values, 40);
  free(s.values);
  free(book.values);
  test_context_done(ctx, &memory);
}

/* Scaling by powers of two scales everything exactly, as long as squares fit a double. */
static void test_extreme_scales(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const sample s = curves(60, 80, 21), book = curves(10, 80, 22);
  const int exponents[] = {-140, -70, -20, 60, 64, 120, 126};
  uint32_t expected[60], index[60];
  const btfi_cmf_vectors vectors = vectors_of(&s);
  assert_ok(btfi_cmf_assign(btfi_host(), ctx, &vectors, book.values, 10, 0, NULL, 0, 1, "", expected, NULL));
  for (uint32_t e = 0; e < 7; e++) {
    sample scaled = sample_create(60, 80), entries = sample_create(10, 80);
    for (uint32_t i = 0; i < 60 * 80; i++) scaled.values[i] = ldexpf(s.values[i], exponents[e]);
    for (uint32_t i = 0; i < 10 * 80; i++) entries.values[i] = ldexpf(book.values[i], exponents[e]);
    const btfi_cmf_vectors of = vectors_of(&scaled);
    assert_ok(btfi_cmf_assign(btfi_host(), ctx, &of, entries.values, 10, 0, NULL, 0, 1, "", index, NULL));
    if (exponents[e] > -140) /* where elements lose bits, exactness is all that is left */
      assert_memory_equal(index, expected, sizeof index);
    check_assignment(&scaled, entries.values, 10, index, NULL);
    btfi_cmf_codebook made = cluster(ctx, &scaled, CMF_KMEANS, 9, 1);
    check_assignment(&scaled, made.values, made.entries, made.index, NULL);
    release(ctx, &made);
    free(scaled.values);
    free(entries.values);
  }
  /* Products overflow although the entries' squares do not. */
  sample far = sample_create(60, 80);
  for (uint32_t i = 0; i < 60 * 80; i++) far.values[i] = ldexpf(s.values[i], 72);
  for (uint32_t i = 0; i < 10 * 80; i++)
    book.values[i] = ldexpf(book.values[i], 56) * (i / 80 % 2 ? -1.0f : 1.0f);
  check_assign(ctx, &far, book.values, 10);
  free(far.values);
  free(s.values);
  free(book.values);
  test_context_done(ctx, &memory);
}

/* ---- independence of threads, storage and memory ---- */

static void expect_same(const btfi_cmf_codebook *a, const btfi_cmf_codebook *b, uint64_t count) {
  assert_int_equal(a->entries, b->entries);
  assert_int_equal(a->iterations, b->iterations);
  assert_memory_equal(a->values, b->values, (size_t)a->entries * a->length * sizeof(float));
  assert_memory_equal(a->index, b->index, count * sizeof *a->index);
  assert_true(a->inertia == b->inertia);
}

static void test_threads_and_bytes(void **unused) {
  (void)unused;
  sample s = curves(900, 70, 31), bytes = {900, 70, NULL, malloc(900 * 70)};
  for (uint32_t i = 0; i < 900 * 70; i++) {
    bytes.bytes[i] = (uint8_t)lrintf(s.values[i] * 200.0f);
    s.values[i] = (float)bytes.bytes[i] / 255.0f;
  }
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
    test_memory first, second;
    btf_context *one = test_context_with(&first, NULL, 1), *three = test_context_with(&second, NULL, 3);
    btfi_cmf_codebook a = cluster(one, &s, method, 50, 6), b = cluster(three, &bytes, method, 50, 6);
    expect_same(&a, &b, 900);
    release(one, &a);
    release(three, &b);
    test_context_done(one, &first);
    test_context_done(three, &second);
  }
  free(s.values);
  free(bytes.bytes);
}

static void test_budget(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const sample s = curves(400, 90, 41);
  const btfi_cmf_vectors vectors = vectors_of(&s);
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
    btfi_cmf_cluster_options options = {.method = method, .entries = 30, .seed = 1, .max_working_set = 10000};
    btfi_cmf_codebook small, large = cluster(ctx, &s, method, 30, 1);
    assert_status(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &small),
                  BTF_E_LIMIT);
    const char *named = strstr(btf_error_message(), "working set of ");
    assert_non_null(named);
    options.max_working_set = strtoull(named + strlen("working set of "), NULL, 10);
    assert_true(options.max_working_set < 1000000);
    assert_ok(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &small));
    expect_same(&small, &large, 400); /* blocks of other sizes */
    release(ctx, &small);
    release(ctx, &large);
    options.max_working_set--;
    assert_status(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &small),
                  BTF_E_LIMIT);
  }
  btfi_cmf_cluster_options options = {.entries = CMF_MAX_ENTRIES + 1};
  btfi_cmf_codebook none;
  assert_status(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &none), BTF_E_LIMIT);
  free(s.values);
  test_context_done(ctx, &memory);
}

static void test_allocation_failures(void **unused) {
  (void)unused;
  sample s = curves(60, 20, 51);
  for (uint64_t v = 30; v < 60; v++)
    memcpy(s.values + v * 20, s.values, 20 * sizeof(float)); /* empty entries as well */
  const btfi_cmf_vectors vectors = vectors_of(&s);
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
    for (int persistent = 0; persistent < 2; persistent++) {
      long failed = 0;
      for (long at = 1;; at++) {
        const btfi_cmf_cluster_options options = {.method = method, .entries = 40};
        btfi_cmf_codebook book;
        uint32_t index[60];
        btf_context *ctx = test_context(&memory);
        memory.fail_at = memory.total_allocations + at;
        memory.persistent = persistent;
        btf_status status = btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &book);
        if (status == BTF_OK)
          status = btfi_cmf_assign(btfi_host(), ctx, &vectors, book.values, book.entries, 0, NULL, 0, 1, "",
                                   index, NULL);
        const int reached = memory.total_allocations >= memory.fail_at;
        memory.fail_at = 0;
        release(ctx, &book);
        test_context_done(ctx, &memory);
        if (!reached) {
          assert_ok(status);
          break;
        }
        assert_status(status, BTF_E_NOMEM);
        failed++;
      }
      assert_true(failed > 15);
    }
  }
  free(s.values);
}

typedef struct watch {
  double last, stop_at;
  uint32_t reports;
} watch;

static int32_t report(void *user, double fraction, const char *stage) {
  watch *w = user;
  assert_string_equal(stage, "codebook");
  assert_true(fraction >= w->last && fraction >= 0.25 && fraction <= 0.75);
  w->last = fraction;
  w->reports++;
  return fraction >= w->stop_at;
}

static void test_progress_and_cancel(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const sample s = curves(200, 30, 61);
  const btfi_cmf_vectors vectors = vectors_of(&s);
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
    for (int cancel = 0; cancel < 2; cancel++) {
      watch w = {0.0, cancel ? 0.2 : 2.0, 0};
      btf_job job = BTF_JOB_INIT;
      btfi_job begun;
      const btfi_cmf_cluster_options options = {.method = method, .entries = 20};
      btfi_cmf_codebook book;
      job.progress = report;
      job.user = &w;
      assert_ok(btfi_job_begin(ctx, &job, &begun));
      assert_status(
          btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, &begun.desc, 0.25, 0.75, "codebook", &book),
          cancel ? BTF_E_CANCELLED : BTF_OK);
      assert_true(w.reports > 0);
      release(ctx, &book);
    }
  }
  free(s.values);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_inertia_never_rises),
      cmocka_unit_test(test_fixed_point_of_lloyd),
      cmocka_unit_test(test_planted_clusters_are_found),
      cmocka_unit_test(test_few_distinct_vectors),
      cmocka_unit_test(test_empty_clusters_are_filled),
      cmocka_unit_test(test_one_entry_is_the_mean),
      cmocka_unit_test(test_tree_finds_nested_clusters),
      cmocka_unit_test(test_median_cut_of_numbers),
      cmocka_unit_test(test_methods_compared),
      cmocka_unit_test(test_assignment_is_exact),
      cmocka_unit_test(test_extreme_scales),
      cmocka_unit_test(test_threads_and_bytes),
      cmocka_unit_test(test_budget),
      cmocka_unit_test(test_allocation_failures),
      cmocka_unit_test(test_progress_and_cancel),
  };
  return btf_run("cmf_cluster", tests);
}
