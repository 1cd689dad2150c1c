/* SPDX-License-Identifier: MIT */
#include "watch.h"

#include "cli.h"

void synth_watch_begin(synth_watch *w, const btf_job *job) {
  w->job = job != NULL && job->progress != NULL ? job : NULL;
  w->owner = pthread_self();
  atomic_init(&w->stopped, false);
  w->stage = "";
  w->fraction = 0.0;
  w->asked = 0.0;
}

bool synth_watch_stops(synth_watch *w) {
  double now;
  if (w == NULL || w->job == NULL) return false;
  if (atomic_load_explicit(&w->stopped, memory_order_relaxed)) return true;
  if (!pthread_equal(pthread_self(), w->owner)) return false;
  now = cli_seconds();
  if (now - w->asked < 0.1) return false;
  w->asked = now;
  if (w->job->progress(w->job->user, w->fraction, w->stage) == 0) return false;
  atomic_store_explicit(&w->stopped, true, memory_order_relaxed);
  return true;
}
