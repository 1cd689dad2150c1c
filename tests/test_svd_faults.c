/* SPDX-License-Identifier: MIT */
/* Truncated SVD that is cancelled, cannot read or allocate, or is asked for nonsense. */
#include "svd_matrices.h"

typedef struct canceller {
  long calls, cancel_at;
  double last;
} canceller;

static int32_t count_progress(void *user, double fraction, const char *stage) {
  canceller *c = user;
  assert_string_equal(stage, "svd");
  assert_true(fraction >= c->last && fraction >= 0.25 - 1e-12 && fraction <= 0.75 + 1e-12);
  c->last = fraction;
  return ++c->calls == c->cancel_at;
}

static void test_cancel(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(300, 120, spectrum_power, 11);
  btf_svd_desc desc = describe(&m, 8);
  desc.max_working_set = smallest_budget(ctx, desc) + 60000;
  long total = 1;
  for (long at = 0; at <= total; at++) {
    canceller c = {0, at, 0};
    btf_job user = BTF_JOB_INIT;
    btfi_job job;
    user.progress = count_progress;
    user.user = &c;
    assert_ok(btfi_job_begin(ctx, &user, &job));
    btf_svd_result r = fresh();
    const btf_status status = btfi_svd(ctx, &desc, &job.desc, 0.25, 0.75, &r);
    if (at == 0) {
      assert_ok(status);
      total = c.calls;
      assert_true(total >= 1);
      btfi_svd_free(ctx, &r);
    } else {
      /* Reports are thinned by the clock, so a later run may make fewer. */
      if (status == BTF_OK) {
        assert_true(c.calls < at);
        btfi_svd_free(ctx, &r);
        continue;
      }
      assert_int_equal(status, BTF_E_CANCELLED);
      assert_null(r.item_vectors);
      assert_null(r.sigma);
    }
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

typedef struct every_report {
  btfi_job *job;
  long calls;
  double last;
} every_report;

static int32_t watch_progress(void *user, double fraction, const char *stage) {
  every_report *c = user;
  (void)stage;
  assert_true(fraction >= c->last && fraction <= 0.75 + 1e-12);
  c->last = fraction;
  c->calls++;
  /* Reports are thinned by the clock: the last one seems long ago. */
  c->job->last_report_ns -= (int64_t)3600 * 1000000000;
  return 0;
}

/* Panels that grow towards a target, readings for residuals and for the scale: progress never goes back and
 * ends where it shall. */
static void test_progress(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  static const int exponents[] = {0, 70, -70};
  for (size_t e = 0; e < 3; e++) {
    matrix m = with_spectrum(600, 320, e == 0 ? spectrum_power : spectrum_fast, 5);
    /* 1e-9 of the energy needs some 45 components of the fast spectrum, and a reading for the residual. */
    const double target = e == 0 ? optimum(&m, 100) : 1e-9 * m.energy;
    for (uint64_t k = 0; k < m.items * m.length; k++) m.values[k] = ldexpf(m.values[k], exponents[e]);
    for (int tight = 0; tight < 3; tight++) {
      btf_svd_desc desc = describe(&m, 150);
      if (tight > 0) desc.max_working_set = smallest_budget(ctx, desc) + (tight == 1 ? 0 : 60000);
      desc.target_residual = ldexp(target, 2 * exponents[e]);
      btfi_job job;
      every_report c = {&job, 0, 0.25};
      btf_job user = BTF_JOB_INIT;
      user.progress = watch_progress;
      user.user = &c;
      assert_ok(btfi_job_begin(ctx, &user, &job));
      btf_svd_result r = fresh();
      assert_ok(btfi_svd(ctx, &desc, &job.desc, 0.25, 0.75, &r));
      assert_true(r.rank > 24);
      assert_near(c.last, 0.75, 1e-12);
      assert_true(c.calls >= 10); /* of reading, sample, passes and end */
      btfi_svd_free(ctx, &r);
    }
    matrix_free(&m);
  }
  test_context_done(ctx, &memory);
}

static void test_read_failure(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(120, 60, spectrum_power, 12);
  for (int tight = 0; tight < 2; tight++) {
    btf_svd_desc desc = describe(&m, 6);
    if (tight) desc.max_working_set = smallest_budget(ctx, desc) + 20000;
    m.reads = 0;
    btf_svd_result r = fresh();
    assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
    btfi_svd_free(ctx, &r);
    const long total = m.reads;
    for (long at = 1; at <= total; at++) {
      m.reads = 0;
      m.fail_at = at;
      assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_IO);
      assert_message_has("is gone");
      assert_null(r.element_vectors);
      assert_int_equal(m.reads, at);
    }
    /* What the reader fails with is passed on, also where it is what an overflow would be. */
    m.reads = 0;
    m.fail_at = total;
    m.fail_with = BTF_E_NUMERIC;
    assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_NUMERIC);
    assert_message_has("is gone");
    assert_int_equal(m.reads, total);
    m.fail_at = 0;
    m.fail_with = BTF_OK;
  }
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_allocation_failure(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  matrix m = with_spectrum(90, 50, spectrum_power, 13);
  btf_svd_desc desc = describe(&m, 30);
  desc.target_residual = optimum(&m, 28); /* makes the panels grow once */
  btf_svd_result r = fresh();
  const long before = memory.total_allocations;
  assert_ok(btfi_svd(ctx, &desc, NULL, 0, 1, &r));
  const long count = memory.total_allocations - before;
  btfi_svd_free(ctx, &r);
  const long live = memory.live_blocks;
  assert_true(count > 15);
  for (long at = 1; at <= count; at++) {
    memory.fail_at = memory.total_allocations + at;
    r = fresh();
    assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_NOMEM);
    assert_null(r.item_vectors);
    assert_null(r.element_vectors);
    assert_null(r.sigma);
    assert_int_equal(memory.live_blocks, live);
  }
  memory.fail_at = 0;
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

static void test_bad_arguments(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  matrix m = with_spectrum(20, 10, spectrum_power, 14);
  const btf_svd_desc good = describe(&m, 3);
  btf_svd_result r = fresh();
  btf_svd_desc desc = good;
  desc.read = NULL;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.items = 0;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.rank = 0;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.reserved = 1;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.layout = 2;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.tolerance = -1;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.target_residual = NAN;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  desc = good;
  desc.items = UINT64_MAX;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_LIMIT);
  desc = good;
  desc.length = (uint64_t)1 << 40;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_LIMIT);
  desc = good;
  desc.struct_size = 8;
  assert_status(btfi_svd(ctx, &desc, NULL, 0, 1, &r), BTF_E_ABI);
  assert_status(btfi_svd(ctx, NULL, NULL, 0, 1, &r), BTF_E_INVALID_ARG);
  assert_status(btfi_svd(ctx, &good, NULL, 0, 1, NULL), BTF_E_INVALID_ARG);

  /* A reader that breaks its promise is found out. */
  m.values[33] = NAN;
  assert_status(btfi_svd(ctx, &good, NULL, 0, 1, &r), BTF_E_NUMERIC);
  m.values[33] = INFINITY;
  assert_status(btfi_svd(ctx, &good, NULL, 0, 1, &r), BTF_E_NUMERIC);
  matrix_free(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_cancel),        cmocka_unit_test(test_progress),
      cmocka_unit_test(test_read_failure),  cmocka_unit_test(test_allocation_failure),
      cmocka_unit_test(test_bad_arguments),
  };
  return btf_run("svd_faults", tests);
}
