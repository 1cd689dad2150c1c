/* SPDX-License-Identifier: MIT */
/*
 * watch.h: progress and the wish to stop, from anywhere in a run.
 *
 * The job's callback belongs to the thread that started the run: only there it is called, at most ten times a
 * second, so that inner loops may ask. All threads see the answer.
 */
#ifndef BTF_TOOLS_SYNTH_WATCH_H
#define BTF_TOOLS_SYNTH_WATCH_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>

#include <btf/btf.h>

typedef struct synth_watch {
  const btf_job *job; /* NULL = nobody to ask */
  pthread_t owner;
  atomic_bool stopped;
  /* Of the owner: */
  const char *stage;
  double fraction, asked; /* asked: when the job was asked last, in seconds */
} synth_watch;

/* Starts a watch whose owner is the calling thread. */
void synth_watch_begin(synth_watch *w, const btf_job *job);
/* Whether the run is to stop; on the owner's thread the job is asked. A watch that is NULL never stops. */
bool synth_watch_stops(synth_watch *w);

#endif
