/* SPDX-License-Identifier: MIT */
#include "parallel.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>

typedef struct loop {
  uint64_t count;
  uint32_t threads;
  parallel_task_fn task;
  void *user;
  atomic_bool stopped;
} loop;

typedef struct worker {
  loop *loop;
  uint32_t index;
  bool started;
  pthread_t thread;
} worker;

static void run_share(loop *l, uint32_t thread) {
  for (uint64_t i = thread; i < l->count; i += l->threads) {
    if (atomic_load_explicit(&l->stopped, memory_order_relaxed)) return;
    if (!l->task(l->user, i, thread)) {
      atomic_store_explicit(&l->stopped, true, memory_order_relaxed);
      return;
    }
  }
}

static void *worker_main(void *argument) {
  worker *w = argument;
  run_share(w->loop, w->index);
  return NULL;
}

bool parallel_for(uint32_t threads, uint64_t count, parallel_task_fn task, void *user) {
  loop l = {count, threads > 0 ? threads : 1, task, user, false};
  worker *workers = l.threads > 1 ? calloc(l.threads, sizeof *workers) : NULL;
  for (uint32_t t = 1; workers != NULL && t < l.threads; t++) {
    workers[t].loop = &l;
    workers[t].index = t;
    workers[t].started = pthread_create(&workers[t].thread, NULL, worker_main, &workers[t]) == 0;
  }
  run_share(&l, 0);
  for (uint32_t t = 1; t < l.threads; t++) {
    if (workers != NULL && workers[t].started)
      pthread_join(workers[t].thread, NULL);
    else
      run_share(&l, t);
  }
  free(workers);
  return !atomic_load(&l.stopped);
}
