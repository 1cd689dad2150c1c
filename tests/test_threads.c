/* SPDX-License-Identifier: MIT */
/* The parallel loop: every index exactly once, whoever runs it. The suite is linked with pthread_create
 * wrapped. */
#include "btf_test.h"

#include "base/base.h"

#include <pthread.h>
#include <time.h>

static atomic_int threads_allowed = 1000000;
int __real_pthread_create(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
int __wrap_pthread_create(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
int __wrap_pthread_create(pthread_t *thread, const pthread_attr_t *settings, void *(*start)(void *),
                          void *user) {
  if (atomic_fetch_sub(&threads_allowed, 1) <= 0) return 11; /* EAGAIN */
  return __real_pthread_create(thread, settings, start, user);
}

enum { most_indices = 1000, most_threads = 8 };

typedef struct tally {
  btf_context *ctx;
  atomic_int runs[most_indices];
  atomic_int running[most_threads];
  atomic_int faults;
  uint32_t thread_limit;
} tally;

static void tally_begin(tally *t, btf_context *ctx) {
  memset(t, 0, sizeof *t);
  t->ctx = ctx;
  t->thread_limit = btfi_thread_count(ctx);
}

static void count_index(void *job, uint32_t index, uint32_t thread) {
  tally *t = job;
  if (index >= most_indices || thread >= t->thread_limit) {
    atomic_fetch_add(&t->faults, 1);
    return;
  }
  if (atomic_fetch_add(&t->running[thread], 1) != 0)
    atomic_fetch_add(&t->faults, 1); /* two tasks on one thread */
  atomic_fetch_add(&t->runs[index], 1);
  atomic_fetch_sub(&t->running[thread], 1);
}

static void expect_each_once(tally *t, uint32_t count) {
  assert_int_equal(atomic_load(&t->faults), 0);
  for (uint32_t i = 0; i < most_indices; i++) assert_int_equal(atomic_load(&t->runs[i]), i < count);
}

static void every_index_runs_exactly_once(void **state) {
  (void)state;
  static const uint32_t counts[] = {0, 1, 2, 3, 7, 64, 1000};
  for (uint32_t threads = 1; threads <= most_threads; threads++) {
    test_memory memory;
    btf_context *ctx = test_context_with(&memory, NULL, threads);
    assert_int_equal(btfi_thread_count(ctx), threads);
    assert_int_equal(btf_context_threads(ctx), threads);
    for (int repeat = 0; repeat < 20; repeat++)
      for (size_t c = 0; c < sizeof counts / sizeof counts[0]; c++) {
        tally t;
        tally_begin(&t, ctx);
        assert_ok(btfi_parallel(ctx, counts[c], count_index, &t));
        expect_each_once(&t, counts[c]);
      }
    test_context_done(ctx, &memory);
  }
}

/* Each task waits until all four run at once, which only four threads can bring about. */
static void meet(void *job, uint32_t index, uint32_t thread) {
  tally *t = job;
  (void)thread;
  atomic_fetch_add(&t->runs[index], 1);
  for (int waited = 0; waited < 10000; waited++) {
    int met = 0;
    for (int i = 0; i < 4; i++) met += atomic_load(&t->runs[i]);
    if (met == 4) return;
    nanosleep(&(struct timespec){0, 1000000}, NULL);
  }
  atomic_fetch_add(&t->faults, 1);
}

static void tasks_run_at_the_same_time(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 4);
  tally t;
  tally_begin(&t, ctx);
  assert_ok(btfi_parallel(ctx, 4, meet, &t));
  expect_each_once(&t, 4);
  test_context_done(ctx, &memory);
}

static void linger(void *job, uint32_t index, uint32_t thread) {
  tally *t = job;
  if (thread >= t->thread_limit || atomic_fetch_add(&t->running[thread], 1) != 0)
    atomic_fetch_add(&t->faults, 1);
  nanosleep(&(struct timespec){0, thread == 0 ? 500000 : 4000000}, NULL);
  atomic_fetch_add(&t->runs[index], 1);
  atomic_fetch_sub(&t->running[thread % most_threads], 1);
}

static void the_call_returns_when_all_tasks_are_done(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 4);
  for (int repeat = 0; repeat < 30; repeat++) { /* the caller, on thread 0, is mostly done first */
    tally t;
    tally_begin(&t, ctx);
    assert_ok(btfi_parallel(ctx, 16, linger, &t));
    expect_each_once(&t, 16);
  }
  test_context_done(ctx, &memory);
}

/* Two of these run at once and share `inner`, so their inner tasks must be given different threads. */
typedef struct nesting {
  tally outer, inner;
  btf_context *inner_context;
  pthread_t first_thread[most_indices];
} nesting;

static void nest_inner(void *job, uint32_t index, uint32_t thread) {
  nesting *n = job;
  (void)index;
  linger(&n->inner, 0, thread);
  if (!pthread_equal(pthread_self(), n->first_thread[thread])) atomic_fetch_add(&n->inner.faults, 1);
}
static void nest_shared(void *job, uint32_t index, uint32_t thread) {
  nesting *n = job;
  n->first_thread[thread] = pthread_self();
  if (btfi_parallel(n->inner_context, 2, nest_inner, n) != BTF_OK) atomic_fetch_add(&n->outer.faults, 1);
  count_index(&n->outer, index, thread);
}

static void inner_tasks_stay_on_their_thread(void **state) {
  (void)state;
  test_memory memory, other_memory;
  btf_context *ctx = test_context_with(&memory, NULL, 4);
  btf_context *other = test_context_with(&other_memory, NULL, 4);
  for (int foreign = 0; foreign < 2; foreign++) {
    nesting *n = calloc(1, sizeof *n);
    tally_begin(&n->outer, ctx);
    tally_begin(&n->inner, ctx);
    n->inner_context = foreign ? other : ctx;
    assert_ok(btfi_parallel(ctx, 40, nest_shared, n));
    expect_each_once(&n->outer, 40);
    assert_int_equal(atomic_load(&n->inner.faults), 0);
    assert_int_equal(atomic_load(&n->inner.runs[0]), 80);
    free(n);
  }
  test_context_done(ctx, &memory);
  test_context_done(other, &other_memory);
}

static void nest(void *job, uint32_t index, uint32_t thread) {
  tally *outer = job;
  tally *inner = malloc(sizeof *inner);
  tally_begin(inner, outer->ctx);
  if (btfi_parallel(outer->ctx, 50, count_index, inner) != BTF_OK) atomic_fetch_add(&outer->faults, 1);
  for (int i = 0; i < 50; i++)
    if (atomic_load(&inner->runs[i]) != 1) atomic_fetch_add(&outer->faults, 1);
  atomic_fetch_add(&outer->faults, atomic_load(&inner->faults));
  free(inner);
  count_index(job, index, thread);
}

static void a_loop_inside_a_task_runs_serially(void **state) {
  (void)state;
  for (uint32_t threads = 1; threads <= 4; threads++) {
    test_memory memory;
    btf_context *ctx = test_context_with(&memory, NULL, threads);
    tally t;
    tally_begin(&t, ctx);
    assert_ok(btfi_parallel(ctx, 200, nest, &t));
    expect_each_once(&t, 200);
    test_context_done(ctx, &memory);
  }
}

static void *call_often(void *user) {
  btf_context *ctx = user;
  tally *t = malloc(sizeof *t);
  intptr_t faults = 0;
  for (int repeat = 0; repeat < 100; repeat++) {
    tally_begin(t, ctx);
    if (btfi_parallel(ctx, 100, count_index, t) != BTF_OK) faults++;
    for (int i = 0; i < 100; i++) faults += atomic_load(&t->runs[i]) != 1;
    faults += atomic_load(&t->faults);
  }
  free(t);
  return (void *)faults;
}

static void several_callers_do_not_wait_for_each_other(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 3);
  pthread_t callers[4];
  for (int i = 0; i < 4; i++) assert_int_equal(pthread_create(&callers[i], NULL, call_often, ctx), 0);
  for (int i = 0; i < 4; i++) {
    void *faults;
    pthread_join(callers[i], &faults);
    assert_null(faults);
  }
  test_context_done(ctx, &memory);
}

static void missing_threads_are_done_without(void **state) {
  (void)state;
  for (int allowed = 0; allowed < 4; allowed++) {
    test_memory memory;
    btf_context *ctx = test_context_with(&memory, NULL, 8);
    tally t;
    tally_begin(&t, ctx);
    atomic_store(&threads_allowed, allowed);
    assert_ok(btfi_parallel(ctx, 300, count_index, &t));
    atomic_store(&threads_allowed, 1000000);
    expect_each_once(&t, 300);
    test_context_done(ctx, &memory);
  }
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 8);
  tally t;
  tally_begin(&t, ctx);
  memory.fail_at = memory.total_allocations + 1;
  assert_status(btfi_parallel(ctx, 300, count_index, &t), BTF_E_NOMEM);
  expect_each_once(&t, 0);
  assert_ok(btfi_parallel(ctx, 300, count_index, &t)); /* and the next call has its threads */
  expect_each_once(&t, 300);
  test_context_done(ctx, &memory);
}

/* ---- the host's pool ---- */

typedef struct host_pool {
  int calls;
  enum { runs_all, refuses, skips_one, repeats_one, odd_thread, odd_index } manner;
} host_pool;

typedef struct host_share {
  uint32_t begin, end, thread;
  btf_task_fn task;
  void *job;
} host_share;

static void *run_share(void *user) {
  const host_share *s = user;
  for (uint32_t i = s->begin; i < s->end; i++) s->task(s->job, i, s->thread);
  return NULL;
}

static btf_status host_parallel(void *user, uint32_t count, btf_task_fn task, void *job) {
  host_pool *pool = user;
  pool->calls++;
  if (pool->manner == refuses) return BTF_E_NOMEM;
  host_share shares[2] = {{0, count / 2, 1, task, job}, {count / 2, count, 0, task, job}};
  if (pool->manner == skips_one) shares[1].end--;
  if (pool->manner == odd_index) shares[1].end++;
  if (pool->manner == odd_thread) shares[0].thread = 2;
  pthread_t second;
  assert_int_equal(pthread_create(&second, NULL, run_share, &shares[0]), 0);
  run_share(&shares[1]);
  pthread_join(second, NULL);
  if (pool->manner == repeats_one) task(job, 0, 0);
  return BTF_OK;
}

static btf_context *context_with_host(host_pool *pool) {
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx = NULL;
  desc.parallel = host_parallel;
  desc.parallel_user = pool;
  desc.max_threads = 2;
  assert_ok(btf_context_create(&desc, &ctx));
  return ctx;
}

static void the_hosts_pool_is_used_and_never_nested(void **state) {
  (void)state;
  host_pool pool = {0, runs_all};
  btf_context *ctx = context_with_host(&pool);
  tally t;
  tally_begin(&t, ctx);
  assert_ok(btfi_parallel(ctx, 100, nest, &t));
  expect_each_once(&t, 100);
  assert_int_equal(pool.calls, 1);
  btf_context_release(ctx);
}

static void a_host_pool_that_misbehaves_is_found_out(void **state) {
  (void)state;
  host_pool pool = {0, refuses};
  btf_context *ctx = context_with_host(&pool);
  tally t;
  tally_begin(&t, ctx);
  assert_status(btfi_parallel(ctx, 100, count_index, &t), BTF_E_NOMEM);
  for (int manner = skips_one; manner <= odd_index; manner++) {
    pool.manner = manner;
    tally_begin(&t, ctx);
    assert_status(btfi_parallel(ctx, 100, count_index, &t), BTF_E_STATE);
    assert_int_equal(atomic_load(&t.faults), 0); /* what was out of range never reached a task */
  }
  pool.manner = runs_all;
  tally_begin(&t, ctx);
  assert_ok(btfi_parallel(ctx, 100, count_index, &t));
  expect_each_once(&t, 100);
  btf_context_release(ctx);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_index_runs_exactly_once),
      cmocka_unit_test(tasks_run_at_the_same_time),
      cmocka_unit_test(the_call_returns_when_all_tasks_are_done),
      cmocka_unit_test(inner_tasks_stay_on_their_thread),
      cmocka_unit_test(a_loop_inside_a_task_runs_serially),
      cmocka_unit_test(several_callers_do_not_wait_for_each_other),
      cmocka_unit_test(missing_threads_are_done_without),
      cmocka_unit_test(the_hosts_pool_is_used_and_never_nested),
      cmocka_unit_test(a_host_pool_that_misbehaves_is_found_out),
  };
  return btf_run("threads", tests);
}
