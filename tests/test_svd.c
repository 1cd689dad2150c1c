/* SPDX-License-Identifier: MIT */
/* Truncated SVD of a blocked matrix, against LAPACK's full one in double. */
#include "svd_matrices.h"

#include <cblas.h>

typedef struct spectrum_case {
  const char *name;
  double (*spectrum)(uint64_t);
  uint64_t items, length;
  uint32_t rank;
} spectrum_case;

static const spectrum_case spectrum_cases[] = {
    {"fast", spectrum_fast, 300, 200, 12},           {"slow", spectrum_slow, 400, 700, 20},
    {"power", spectrum_power, 700, 400, 32},         {"repeated", spectrum_repeated, 350, 260, 12},
    {"clustered", spectrum_clustered, 260, 350, 10}, {"flat", spectrum_flat, 300, 220, 8},
};

static void test_matches_lapack(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  for (size_t c = 0; c < sizeof spectrum_cases / sizeof spectrum_cases[0]; c++) {
    const spectrum_case *sc = &spectrum_cases[c];
    matrix m = with_spectrum(sc->items, sc->length, sc->spectrum, 40 + c);
    for (m.layout = 0; m.layout < 2; m.layout++) {
      /* Held, and under every sixteenth of the matrix that does not hold it. */
      for (uint64_t part = 0; part < 12; part++) {
        btf_svd_desc desc = describe(&m, sc->rank);
        btf_svd_result r = fresh();
        if (part > 0)
          desc.max_working_set = smallest_budget(ctx, desc) + m.items * m.length * sizeof(float) * part / 16;
        m.items_read = 0;
        assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
        assert_int_equal(r.rank, sc->rank);
        check_result(&m, &r);
        check_optimal(&m, &r, 1.001);
        if (part == 0) {
          /* One reading serves a matrix that is held. */
          assert_int_equal(r.passes, 1);
          assert_int_equal(m.items_read, m.items);
        }
        btfi_svd_free(ctx, &r);
        assert_null(r.item_vectors);
      }
    }
    matrix_free(&m);
  }
  test_context_done(ctx, &memory);
}

static void test_small_budget(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(700, 400, spectrum_power, 7);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    btf_svd_desc desc = describe(&m, 20);
    const uint64_t needed = smallest_budget(ctx, desc);
    desc.max_working_set = needed - 1;
    btf_svd_result r = fresh();
    assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_LIMIT);
    assert_null(r.item_vectors);
    assert_int_equal(m.reads, 0);

    uint64_t before, peak;
    btf_context_memory(ctx, &before, &peak);
    desc.max_working_set = needed;
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    check_result(&m, &r);
    assert_int_equal(r.least_working_set, 0);
    check_optimal(&m, &r, 1.001);
    assert_true(r.passes > 1);
    assert_true(m.largest_read <= 8);
    btf_context_memory(ctx, NULL, &peak);
    /* The threads' pool and the residuals' list come on top. */
    const uint64_t result_bytes = (m.items + m.length) * 20 * sizeof(float);
    assert_true(peak - before <= needed + result_bytes + 8192);
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

/* A target starts with fewer components than it may need; what is named is enough for all of them. */
static void test_small_budget_for_a_target(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(700, 400, spectrum_power, 7);
  btf_svd_desc desc = describe(&m, 20);
  btf_svd_result r = fresh();
  desc.max_working_set = smallest_budget(ctx, desc);
  desc.rank = 200;
  desc.target_residual = 1e-9;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_LIMIT);
  desc.max_working_set = r.least_working_set;
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
  assert_int_equal(r.rank, 200);
  assert_int_equal(r.least_working_set, 0);
  btfi_svd_free(ctx, &r);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_streamed_equals_held(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(640, 300, spectrum_power, 8);
  m.layout = BTF_LAYOUT_ITEM_COLUMNS;
  btf_svd_desc desc = describe(&m, 16);
  desc.tolerance = 1e-6;
  btf_svd_result held = fresh();
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &held));
  const uint64_t needed = smallest_budget(ctx, desc);
  for (uint64_t part = 0; part < 4; part++) {
    btf_svd_result streamed = fresh();
    desc.max_working_set = needed + part * 90000;
    desc.block_items = part % 2 == 0 ? 0 : 12;
    m.items_read = 0;
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &streamed));
    assert_true(m.items_read >= streamed.passes * m.items);
    assert_true(streamed.passes > 1);
    assert_relative(sqrt(streamed.residual), sqrt(held.residual), 1e-5);
    assert_relative(sqrt(explicit_error(&m, &streamed)), sqrt(explicit_error(&m, &held)), 1e-5);
    check_result(&m, &streamed);
    btfi_svd_free(ctx, &streamed);
  }
  btfi_svd_free(ctx, &held);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_rare_features(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_rare_features(3200, 240);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    btf_svd_desc desc = describe(&m, 16);
    /* Far less than the matrix, so that most of the strays come late. */
    desc.max_working_set = smallest_budget(ctx, desc) + 600000;
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    check_result(&m, &r);
    check_optimal(&m, &r, 1.001);
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

/* Items of unequal worth read in order under every budget from the smallest to nearly all: the tolerance must
 * be met by measure and not only by estimate. */
static void test_tolerance_is_met(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_narrow_lobes(40, 300);
  for (uint32_t rank = 8; rank <= 32; rank += 12) {
    static const double tolerances[] = {0.0005, 0.004, 0.02};
    for (size_t t = 0; t < 3; t++) {
      btf_svd_desc desc = describe(&m, rank);
      const uint64_t needed = smallest_budget(ctx, desc), all = m.items * m.length * sizeof(float);
      desc.tolerance = tolerances[t];
      for (uint64_t part = 0; part <= 8; part++) {
        btf_svd_result r = fresh();
        desc.max_working_set = needed + part * part * all / 64;
        assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
        const double ratio = sqrt(explicit_error(&m, &r) / optimum(&m, rank));
        if (!(ratio <= 1 + desc.tolerance))
          fail_msg("rank %u, budget %d: error %.6f of the optimum, tolerance %g", rank, (int)part, ratio,
                   desc.tolerance);
        btfi_svd_free(ctx, &r);
      }
    }
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_rank_deficient(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(200, 150, spectrum_rank_seven, 3);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    btf_svd_desc desc = describe(&m, 20);
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 7);
    check_result(&m, &r);
    for (uint32_t k = 0; k < 7; k++) assert_near(r.sigma[k], m.sigma[k], sigma_rounding(&m));
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);

  /* Whole numbers: an outer product of rank one has no rounding at all. */
  m = matrix_alloc(40, 30);
  for (uint64_t k = 0; k < 1200; k++) m.values[k] = (float)((k / 30 % 5 + 1) * (k % 30 % 3 + 1));
  matrix_measure(&m);
  btf_svd_desc desc = describe(&m, 4);
  btf_svd_result r = fresh();
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
  assert_int_equal(r.rank, 1);
  check_result(&m, &r);
  btfi_svd_free(ctx, &r);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

/* A flat diffuse material: every row one of six multiples of one vector, thousands of times. Sums of equal
 * terms round the same way each time, which random matrices never show. */
static void test_rank_one_of_equal_rows(void **state) {
  static const uint64_t sizes[][2] = {{4096, 24}, {972, 120}, {2048, 512}, {24, 4096}};
  (void)state;
  for (size_t n = 0; n < sizeof sizes / sizeof *sizes; n++) {
    test_memory memory;
    btf_context *ctx = test_context(&memory);
    btfi_random random;
    matrix m = matrix_alloc(sizes[n][0], sizes[n][1]);
    float column[512];
    double energy = 0;
    btfi_random_seed(&random, 5);
    for (uint64_t j = 0; j < m.length; j++) {
      if (j < 512) column[j] = 0.2f + btfi_random_float(&random);
    }
    for (uint64_t i = 0; i < m.items; i++)
      for (uint64_t j = 0; j < m.length; j++)
        m.values[i * m.length + j] =
            (0.1f + 0.07f * (float)(i % 3)) * (i / 3 % 2 ? 0.38f : 0.92f) * column[j % 512];
    for (uint64_t k = 0; k < m.items * m.length; k++) energy += (double)m.values[k] * m.values[k];
    btf_svd_desc desc = describe(&m, 8);
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 1);
    /* Terms are equal, so that the 256 roundings of a run in registers may all fall one way: half of 256 *
     * 2^-24 = 8e-6, since partial sums grow from nothing; the residual says so too. */
    assert_true(sqrt(explicit_error(&m, &r) / energy) <= 1e-5);
    assert_true(r.residual <= 1e-10 * energy);
    btfi_svd_free(ctx, &r);
    matrix_free(&m);
    test_context_done(ctx, &memory);
  }
}

static void count_warnings(void *user, int32_t level, btf_status code, const char *message) {
  (void)code;
  (void)message;
  if (level == BTF_LOG_WARNING) ++*(long *)user;
}

/* Float sums of equal values all err the same way, and each half step seems to gain that much for ever. */
static void test_one_value(void **state) {
  static const uint64_t sizes[][2] = {{24, 256}, {256, 24}, {300, 700}, {1, 50}};
  (void)state;
  for (size_t n = 0; n < sizeof sizes / sizeof *sizes; n++) {
    test_memory memory = {0};
    btf_context_desc settings = BTF_CONTEXT_DESC_INIT;
    btf_context *ctx = NULL;
    long warnings = 0;
    const btf_allocator allocator = test_allocator(&memory);
    settings.allocator = &allocator;
    settings.log = count_warnings;
    settings.log_user = &warnings;
    assert_ok(btf_context_create(&settings, &ctx));
    matrix m = matrix_alloc(sizes[n][0], sizes[n][1]);
    for (uint64_t k = 0; k < m.items * m.length; k++) m.values[k] = 0.17681884765625f;
    for (int tight = 0; tight < 2; tight++) {
      btf_svd_desc desc = describe(&m, 16);
      btf_svd_result r = fresh();
      if (tight) desc.max_working_set = smallest_budget(ctx, desc) + 20000;
      assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
      assert_int_equal(r.rank, 1);
      assert_int_equal(warnings, 0);
      /* A sample or none, a pass, one that sees no growth, and the reading for the residual. */
      assert_true(r.passes <= 4);
      btfi_svd_free(ctx, &r);
    }
    matrix_free(&m);
    test_context_done(ctx, &memory);
  }
}

static void test_small_shapes(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  static const uint64_t sizes[][2] = {{1, 1},   {1, 37},  {37, 1},  {2, 2},
                                      {3, 100}, {100, 3}, {17, 16}, {9, 65}};
  for (size_t c = 0; c < sizeof sizes / sizeof sizes[0]; c++) {
    for (uint32_t layout = 0; layout < 2; layout++) {
      matrix m = with_spectrum(sizes[c][0], sizes[c][1], spectrum_power, 60 + c);
      m.layout = layout;
      for (int tight = 0; tight < 2; tight++) {
        btf_svd_desc desc = describe(&m, 500);
        if (tight) desc.max_working_set = smallest_budget(ctx, desc);
        btf_svd_result r = fresh();
        assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
        assert_int_equal(r.rank, BTFI_MIN(m.items, m.length));
        check_result(&m, &r);
        for (uint32_t k = 0; k < r.rank; k++) assert_near(r.sigma[k], m.sigma[k], sigma_rounding(&m));
        btfi_svd_free(ctx, &r);
      }
      matrix_free(&m);
    }
  }
  test_context_done(ctx, &memory);
}

static void test_zero_matrix(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = matrix_alloc(50, 40);
  btf_svd_desc desc = describe(&m, 5);
  for (int tight = 0; tight < 2; tight++) {
    btf_svd_result r = fresh();
    if (tight) desc.max_working_set = smallest_budget(ctx, desc);
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 0);
    assert_true(r.energy == 0 && r.residual == 0);
    assert_non_null(r.item_vectors);
    assert_non_null(r.element_vectors);
    assert_non_null(r.sigma);
    btfi_svd_free(ctx, &r);
  }
  /* One item of many that is not zero, which no sample need contain. */
  for (uint64_t j = 0; j < 40; j++) m.values[31 * 40 + j] = (float)j;
  matrix_measure(&m);
  desc.max_working_set += 20000;
  btf_svd_result r = fresh();
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
  assert_int_equal(r.rank, 1);
  check_result(&m, &r);
  btfi_svd_free(ctx, &r);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_tiny_residual(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(300, 200, spectrum_fast, 4);
  btf_svd_desc desc = describe(&m, 40);
  for (int tight = 0; tight < 2; tight++) {
    /* sigma_41 is 1.3e-4 of the first: the residual, 5e-8 of the energy, would drown in the difference of
     * energies. */
    btf_svd_result r = fresh();
    if (tight) desc.max_working_set = smallest_budget(ctx, desc) + 100000;
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    /* An element of C is a sum of n = 200 products of size |m| / n and either sign, in any order: each of n
     * roundings is at most 2^-24 of a partial sum, which walks to |m| / sqrt(n), and as they fall together
     * they are 2^-24 |m|. A column of C so errs by 2^-24 ||M|| = 1e-7 sigma_1, 8e-4 of sigma_41 and less of
     * what the first vectors have. That error has the direction of the column by chance only, 1 / sqrt(300):
     * 2 * 8e-4 / sqrt(300) = 9e-5 of the squared Ritz value, and Y does the same again. What lies beyond the
     * panel is summed from differences to the same precision. */
    assert_relative(r.residual, optimum(&m, 40), 2e-4);
    check_result(&m, &r);
    check_optimal(&m, &r, 1.001);
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_target(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(600, 320, spectrum_power, 5);
  const uint64_t roomy = smallest_budget(ctx, describe(&m, 150));
  for (int tight = 0; tight < 2; tight++) {
    static const uint32_t ranks[] = {1, 3, 23, 24, 25, 60, 111};
    for (size_t c = 0; c < sizeof ranks / sizeof ranks[0]; c++) {
      btf_svd_desc desc = describe(&m, 150);
      /* Halfway between what this rank and one less can reach at best; the tolerance is far smaller than the
       * step. */
      desc.target_residual = 0.5 * (optimum(&m, ranks[c]) + optimum(&m, ranks[c] - 1));
      desc.tolerance = 1e-5;
      if (tight) desc.max_working_set = roomy;
      btf_svd_result r = fresh();
      assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
      assert_int_equal(r.rank, ranks[c]);
      assert_true(r.residual <= desc.target_residual);
      check_result(&m, &r);
      btfi_svd_free(ctx, &r);
    }
    /* Out of reach: the most that is allowed. */
    btf_svd_desc desc = describe(&m, 30);
    desc.target_residual = 0.5 * optimum(&m, 30);
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 30);
    assert_true(r.residual > desc.target_residual);
    btfi_svd_free(ctx, &r);
    /* Nothing to do. */
    desc.target_residual = 1.01 * m.energy;
    r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 0);
    assert_relative(r.residual, m.energy, 1e-6);
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_error_falls_with_rank(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(300, 260, spectrum_slow, 6);
  double previous = 2 * m.energy;
  for (uint32_t rank = 1; rank < 60; rank += 4) {
    btf_svd_desc desc = describe(&m, rank);
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_true(r.residual < previous);
    previous = r.residual;
    btfi_svd_free(ctx, &r);
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_deterministic(void **state) {
  (void)state;
  test_memory memory;
  matrix m = with_spectrum(500, 210, spectrum_power, 9);
  for (int tight = 0; tight < 2; tight++) {
    btf_svd_result results[2] = {fresh(), fresh()};
    btf_context *ctx = test_context_with(&memory, NULL, 2);
    btf_svd_desc desc = describe(&m, 12);
    if (tight) desc.max_working_set = smallest_budget(ctx, desc) + 100000;
    for (int run = 0; run < 2; run++) assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &results[run]));
    assert_memory_equal(results[0].sigma, results[1].sigma, 12 * sizeof(double));
    assert_memory_equal(results[0].item_vectors, results[1].item_vectors, m.items * 12 * sizeof(float));
    assert_memory_equal(results[0].element_vectors, results[1].element_vectors,
                        m.length * 12 * sizeof(float));
    assert_true(results[0].residual == results[1].residual && results[0].energy == results[1].energy);
    for (int run = 0; run < 2; run++) btfi_svd_free(ctx, &results[run]);
    test_context_done(ctx, &memory);
  }
  matrix_free(&m);
}

/* Every kernel that this machine has, and BLAS alone, in both layouts. */
static void test_kernels_agree(void **state) {
  (void)state;
  static const char *const isas[] = {"scalar", "avx2", "avx512"};
  matrix m = with_spectrum(333, 217, spectrum_power, 10);
  for (size_t k = 0; k < 3; k++) {
    test_memory memory;
    btf_context *ctx = test_context_with(&memory, isas[k], 2);
    for (m.layout = 0; m.layout < 2; m.layout++) {
      /* Panels of 16, 32, 48, 64, 80 and 112 columns: each mix of tiles. */
      static const uint32_t ranks[] = {6, 20, 36, 52, 70, 100};
      for (size_t c = 0; c < sizeof ranks / sizeof ranks[0]; c++) {
        btf_svd_desc desc = describe(&m, ranks[c]);
        btf_svd_result r = fresh();
        assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
        check_result(&m, &r);
        check_optimal(&m, &r, 1.001);
        btfi_svd_free(ctx, &r);
      }
    }
    test_context_done(ctx, &memory);
  }
  matrix_free(&m);
}

/* A power of two changes no digit of a float, so the results for a scaled matrix must be those of the plain
 * one, scaled; from values whose squares float cannot hold to values that it can hardly hold itself. */
static void test_scale(void **state) {
  (void)state;
  static const int exponents[] = {-120, -100, -60, -40, 40, 60, 100, 126};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(300, 120, spectrum_power, 15);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    for (int tight = 0; tight < 2; tight++) {
      btf_svd_desc desc = describe(&m, 10);
      desc.target_residual = 0.5 * (optimum(&m, 9) + optimum(&m, 8));
      if (tight) desc.max_working_set = smallest_budget(ctx, describe(&m, 30)) + 40000;
      btf_svd_result plain = fresh();
      assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &plain));
      assert_int_equal(plain.rank, 9);
      for (size_t e = 0; e < sizeof exponents / sizeof *exponents; e++) {
        matrix scaled = matrix_alloc(m.items, m.length);
        scaled.layout = m.layout;
        for (uint64_t k = 0; k < m.items * m.length; k++)
          scaled.values[k] = ldexpf(m.values[k], exponents[e]);
        btf_svd_desc other = desc;
        other.user = &scaled;
        other.target_residual = ldexp(desc.target_residual, 2 * exponents[e]);
        btf_svd_result r = fresh();
        assert_ok(btfi_svd(ctx, &other, NULL, 0, 1, &r));
        assert_int_equal(r.rank, plain.rank);
        /* Held, each step of the one is that of the other, scaled, but for what loses digits to float's lower
         * end: values at 2^-120, and at 2^60, which is not scaled yet, the map from Y to V, which is of the
         * size of 2^-120. Otherwise what rounding allows to both. */
        const bool exact = !tight && exponents[e] != -120 && exponents[e] != 60;
        /* Sums of 300 terms of one sign err by 2^-24 sqrt(300) / 3 = 3.4e-7 as they fall, which both may; the
         * residual is a tenth of the energy; a vector turns by that over the gap to the next value, 1 / 9 - 1
         * / 10. */
        const double apart = exact ? 0 : 1e-6;
        for (uint32_t k = 0; k < r.rank; k++)
          assert_relative(ldexp(r.sigma[k], -exponents[e]), plain.sigma[k], apart);
        assert_relative(ldexp(r.energy, -2 * exponents[e]), plain.energy, apart);
        assert_relative(ldexp(r.residual, -2 * exponents[e]), plain.residual, 10 * apart);
        for (uint64_t k = 0; k < m.length * r.rank; k++)
          assert_near(r.element_vectors[k], plain.element_vectors[k], 100 * apart);
        btfi_svd_free(ctx, &r);
        free(scaled.values);
      }
      btfi_svd_free(ctx, &plain);
    }
  }
  matrix_free(&m);
  /* Both ends of the range, and one value of either among zeros that the sample will not show. */
  for (int end = 0; end < 2; end++) {
    m = matrix_alloc(900, 40);
    m.values[777 * 40 + 3] = end == 0 ? 1e-38f : 3e38f;
    btf_svd_desc desc = describe(&m, 3);
    desc.max_working_set = smallest_budget(ctx, desc) + 20000;
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    assert_int_equal(r.rank, 1);
    assert_relative(r.sigma[0], m.values[777 * 40 + 3], 1e-6);
    btfi_svd_free(ctx, &r);
    matrix_free(&m);
  }
  test_context_done(ctx, &memory);
}

/* Each element of a product is summed in one order, whoever does it. */
static void test_threads_agree(void **state) {
  (void)state;
  matrix m = with_rare_features(900, 260);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    for (int tight = 0; tight < 2; tight++) {
      btf_svd_result first = fresh();
      for (uint32_t threads = 1; threads <= 3; threads++) {
        test_memory memory;
        btf_context *ctx = test_context_with(&memory, NULL, threads);
        btf_svd_desc desc = describe(&m, 20);
        if (tight) desc.max_working_set = smallest_budget(ctx, desc) + 200000;
        btf_svd_result r = fresh();
        assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
        if (threads > 1) {
          assert_int_equal(r.rank, first.rank);
          assert_memory_equal(r.sigma, first.sigma, r.rank * sizeof(double));
          assert_memory_equal(r.item_vectors, first.item_vectors, m.items * r.rank * sizeof(float));
          assert_memory_equal(r.element_vectors, first.element_vectors, m.length * r.rank * sizeof(float));
          assert_true(r.residual == first.residual && r.energy == first.energy);
          btfi_svd_free(ctx, &r);
        } else {
          /* Outlives the context that made it. */
          first = r;
          first.sigma = memcpy(malloc(r.rank * sizeof(double)), r.sigma, r.rank * sizeof(double));
          const size_t items = m.items * r.rank * sizeof(float), elements = m.length * r.rank * sizeof(float);
          first.item_vectors = memcpy(malloc(items), r.item_vectors, items);
          first.element_vectors = memcpy(malloc(elements), r.element_vectors, elements);
          btfi_svd_free(ctx, &r);
        }
        test_context_done(ctx, &memory);
      }
      free(first.sigma);
      free(first.item_vectors);
      free(first.element_vectors);
    }
  }
  matrix_free(&m);
}

/* The rest runs with one thread of OpenBLAS: more wait for each other by spinning. */
static void test_threads_of_blas(void **state) {
  (void)state;
  const int usual = openblas_get_num_threads();
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const spectrum_case *sc = &spectrum_cases[2];
  matrix m = with_spectrum(sc->items, sc->length, sc->spectrum, 50);
  openblas_set_num_threads(2);
  for (m.layout = 0; m.layout < 2; m.layout++) {
    const btf_svd_desc desc = describe(&m, sc->rank);
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    check_result(&m, &r);
    check_optimal(&m, &r, 1.001);
    btfi_svd_free(ctx, &r);
  }
  openblas_set_num_threads(usual);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_matches_lapack),
      cmocka_unit_test(test_small_budget),
      cmocka_unit_test(test_streamed_equals_held),
      cmocka_unit_test(test_rare_features),
      cmocka_unit_test(test_tolerance_is_met),
      cmocka_unit_test(test_small_budget_for_a_target),
      cmocka_unit_test(test_rank_deficient),
      cmocka_unit_test(test_rank_one_of_equal_rows),
      cmocka_unit_test(test_one_value),
      cmocka_unit_test(test_small_shapes),
      cmocka_unit_test(test_zero_matrix),
      cmocka_unit_test(test_tiny_residual),
      cmocka_unit_test(test_target),
      cmocka_unit_test(test_error_falls_with_rank),
      cmocka_unit_test(test_deterministic),
      cmocka_unit_test(test_kernels_agree),
      cmocka_unit_test(test_scale),
      cmocka_unit_test(test_threads_agree),
      cmocka_unit_test(test_threads_of_blas),
  };
  return btf_run("svd", tests);
}
