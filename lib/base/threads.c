/* SPDX-License-Identifier: MIT */
#include "base/context.h"

#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <string.h>
#include <unistd.h>

/* One call of btfi_parallel in progress. */
typedef struct task_run {
  btf_task_fn task;
  void *job;
  uint32_t count, thread_limit;
  atomic_uint next;     /* first index nobody took yet */
  atomic_uint finished; /* indices done, counted for the host's pool only */
  atomic_bool bad_call; /* the host passed an index or thread out of range */
} task_run;

typedef struct pool_thread {
  pthread_t handle;
  btfi_pool *pool;
  uint32_t thread;
} pool_thread;

struct btfi_pool {
  pthread_mutex_t mutex;
  pthread_cond_t work, idle;
  /* All below under the mutex. */
  task_run *run; /* NULL while there is nothing to join */
  uint64_t generation;
  uint32_t joined; /* threads working on `run` */
  bool stop;
  uint32_t thread_count;
  pool_thread threads[];
};

/* 1 + number of the task's thread while this thread is inside a task, else 0. */
static _Thread_local uint32_t inside_task;

uint32_t btfi_processor_count(void) {
  long count = 0;
#if defined(__linux__)
  cpu_set_t allowed;
  if (sched_getaffinity(0, sizeof allowed, &allowed) == 0) count = CPU_COUNT(&allowed);
#endif
  if (count < 1) count = sysconf(_SC_NPROCESSORS_ONLN);
  return count < 1 ? 1 : (uint32_t)BTFI_MIN(count, (long)BTFI_MAX_THREADS);
}

uint32_t btfi_thread_count(const btf_context *ctx) {
  return ctx->max_threads;
}

static void run_one(btf_task_fn task, void *job, uint32_t index, uint32_t thread) {
  const uint32_t outside = inside_task;
  inside_task = thread + 1;
  task(job, index, thread);
  inside_task = outside;
}

static void run_shared(task_run *run, uint32_t thread) {
  for (;;) {
    /* A plain add could wrap around when many threads overshoot a count near 2^32. */
    uint32_t index = atomic_load_explicit(&run->next, memory_order_relaxed);
    do {
      if (index >= run->count) return;
    } while (!atomic_compare_exchange_weak_explicit(&run->next, &index, index + 1, memory_order_relaxed,
                                                    memory_order_relaxed));
    run_one(run->task, run->job, index, thread);
  }
}

static void *pool_thread_main(void *argument) {
  const pool_thread *self = argument;
  btfi_pool *pool = self->pool;
  uint64_t seen = 0;
  pthread_mutex_lock(&pool->mutex);
  for (;;) {
    while (!pool->stop && (!pool->run || pool->generation == seen))
      pthread_cond_wait(&pool->work, &pool->mutex);
    if (pool->stop) break;
    task_run *run = pool->run;
    seen = pool->generation;
    pool->joined++;
    pthread_mutex_unlock(&pool->mutex);
    run_shared(run, self->thread);
    pthread_mutex_lock(&pool->mutex);
    if (--pool->joined == 0) pthread_cond_signal(&pool->idle);
  }
  pthread_mutex_unlock(&pool->mutex);
  return NULL;
}

/* Starts as many threads as the system gives; the caller is one of them. */
static btf_status start_pool(btf_context *ctx) {
  const uint32_t wanted = ctx->max_threads - 1;
  btfi_pool *pool = btfi_calloc(ctx, 1, sizeof *pool + wanted * sizeof pool->threads[0]);
  if (!pool) return btfi_alloc_status();
  pthread_mutex_init(&pool->mutex, NULL);
  pthread_cond_init(&pool->work, NULL);
  pthread_cond_init(&pool->idle, NULL);

  /* The program's signals are for the program's threads. */
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  uint32_t started = 0;
  while (started < wanted) {
    pool_thread *t = &pool->threads[started];
    t->pool = pool;
    t->thread = started + 1;
    if (pthread_create(&t->handle, NULL, pool_thread_main, t) != 0) break;
    started++;
  }
  pthread_sigmask(SIG_SETMASK, &before, NULL);

  pool->thread_count = started;
  ctx->pool = pool;
  if (started < wanted)
    btfi_log(ctx, BTF_LOG_WARNING, "threads: %u of %u could be started", (unsigned)started + 1,
             (unsigned)wanted + 1);
  return BTF_OK;
}

void btfi_pool_stop(btf_context *ctx) {
  btfi_pool *pool = ctx->pool;
  if (!pool) return;
  pthread_mutex_lock(&pool->mutex);
  pool->stop = true;
  pthread_cond_broadcast(&pool->work);
  pthread_mutex_unlock(&pool->mutex);
  for (uint32_t i = 0; i < pool->thread_count; i++) pthread_join(pool->threads[i].handle, NULL);
  pthread_cond_destroy(&pool->idle);
  pthread_cond_destroy(&pool->work);
  pthread_mutex_destroy(&pool->mutex);
  btfi_free(ctx, pool);
  ctx->pool = NULL;
}

static void run_in_pool(btfi_pool *pool, task_run *run) {
  pthread_mutex_lock(&pool->mutex);
  pool->run = run;
  pool->generation++;
  pthread_cond_broadcast(&pool->work);
  pthread_mutex_unlock(&pool->mutex);

  run_shared(run, 0);

  /* Threads that did not wake in time have nothing left to do and are not waited for. */
  pthread_mutex_lock(&pool->mutex);
  pool->run = NULL;
  while (pool->joined > 0) pthread_cond_wait(&pool->idle, &pool->mutex);
  pthread_mutex_unlock(&pool->mutex);
}

static void host_task(void *job, uint32_t index, uint32_t thread) {
  task_run *run = job;
  if (index >= run->count || thread >= run->thread_limit) {
    atomic_store(&run->bad_call, true);
    return;
  }
  run_one(run->task, run->job, index, thread);
  atomic_fetch_add(&run->finished, 1);
}

static btf_status run_by_host(btf_context *ctx, task_run *run) {
  const btf_status status = ctx->host_parallel(ctx->host_parallel_user, run->count, host_task, run);
  if (status != BTF_OK)
    return btfi_fail(ctx, status, "threads: the program's parallel function failed with %s",
                     btf_status_name(status));
  const uint32_t finished = atomic_load(&run->finished);
  if (atomic_load(&run->bad_call) || finished != run->count)
    return btfi_fail(
        ctx, BTF_E_STATE,
        "threads: the program's parallel function ran %u of %u tasks%s; expected each once, on a thread "
        "below %u",
        (unsigned)finished, (unsigned)run->count,
        atomic_load(&run->bad_call) ? " and passed an index or thread out of range" : "",
        (unsigned)run->thread_limit);
  return BTF_OK;
}

btf_status btfi_parallel(btf_context *ctx, uint32_t count, btf_task_fn task, void *job) {
  /* Tasks of a task, and calls that meet another thread's, run here: nobody ever waits for somebody's turn.
   */
  if (count <= 1 || ctx->max_threads == 1 || inside_task ||
      atomic_flag_test_and_set_explicit(&ctx->threads_busy, memory_order_acquire)) {
    const uint32_t thread = inside_task && inside_task <= ctx->max_threads ? inside_task - 1 : 0;
    for (uint32_t i = 0; i < count; i++) run_one(task, job, i, thread);
    return BTF_OK;
  }

  task_run run;
  memset(&run, 0, sizeof run);
  run.task = task;
  run.job = job;
  run.count = count;
  run.thread_limit = ctx->max_threads;
  atomic_init(&run.next, 0);
  atomic_init(&run.finished, 0);
  atomic_init(&run.bad_call, false);

  btf_status status = BTF_OK;
  if (ctx->host_parallel) {
    status = run_by_host(ctx, &run);
  } else {
    if (!ctx->pool) status = start_pool(ctx);
    if (status == BTF_OK) run_in_pool(ctx->pool, &run);
  }
  atomic_flag_clear_explicit(&ctx->threads_busy, memory_order_release);
  return status;
}
