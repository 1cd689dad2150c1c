/* SPDX-License-Identifier: MIT */
/* Clustering is the same for any threads, storage and blocks, keeps to its budget, and ends cleanly where
 * memory fails or it is cancelled. */
#include "test_cmf_vectors.h"

#include "base/base.h"

static test_memory memory;

static void expect_same(const btfi_cmf_codebook *a, const btfi_cmf_codebook *b, uint64_t count) {
  assert_int_equal(a->entries, b->entries);
  assert_int_equal(a->iterations, b->iterations);
  assert_memory_equal(a->values, b->values, (size_t)a->entries * a->length * sizeof(float));
  assert_memory_equal(a->index, b->index, count * sizeof *a->index);
  assert_true(a->inertia == b->inertia);
}

static void test_threads_and_bytes(void **unused) {
  (void)unused;
  sample s = sample_curves(900, 70, 31), bytes = {900, 70, NULL, malloc(900 * 70)};
  for (uint32_t i = 0; i < 900 * 70; i++) {
    bytes.bytes[i] = (uint8_t)lrintf(s.values[i] * 200.0f);
    s.values[i] = (float)bytes.bytes[i] / 255.0f;
  }
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
    test_memory first, second;
    btf_context *one = test_context_with(&first, NULL, 1), *three = test_context_with(&second, NULL, 3);
    btfi_cmf_codebook a = make_codebook(one, &s, method, 50, 6),
                      b = make_codebook(three, &bytes, method, 50, 6);
    expect_same(&a, &b, 900);
    free_codebook(one, &a);
    free_codebook(three, &b);
    test_context_done(one, &first);
    test_context_done(three, &second);
  }
  free(s.values);
  free(bytes.bytes);
}

static void test_budget(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const sample s = sample_curves(400, 90, 41);
  const btfi_cmf_vectors vectors = vectors_of(&s);
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
    btfi_cmf_cluster_options options = {.method = method, .entries = 30, .seed = 1, .max_working_set = 10000};
    btfi_cmf_codebook small, large = make_codebook(ctx, &s, method, 30, 1);
    assert_status(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &small),
                  BTF_E_LIMIT);
    const char *named = strstr(btf_error_message(), "working set of ");
    assert_non_null(named);
    options.max_working_set = strtoull(named + strlen("working set of "), NULL, 10);
    assert_true(options.max_working_set < 1000000);
    assert_ok(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &small));
    expect_same(&small, &large, 400); /* blocks of other sizes */
    free_codebook(ctx, &small);
    free_codebook(ctx, &large);
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
  sample s = sample_curves(60, 20, 51);
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
        free_codebook(ctx, &book);
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
  const sample s = sample_curves(200, 30, 61);
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
      free_codebook(ctx, &book);
    }
  }
  free(s.values);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_threads_and_bytes),
      cmocka_unit_test(test_budget),
      cmocka_unit_test(test_allocation_failures),
      cmocka_unit_test(test_progress_and_cancel),
  };
  return btf_run("cmf_cluster_runs", tests);
}
