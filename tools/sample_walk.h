/* SPDX-License-Identifier: MIT */
/* sample_walk.h: visits all samples of one or two sources of the same shape in all threads. */
#ifndef BTF_TOOLS_SAMPLE_WALK_H
#define BTF_TOOLS_SAMPLE_WALK_H

#include "sample_source.h"

/* A block in the hands of one thread: `lights` images from light0 on, seen from `view`. */
typedef struct sample_visit {
  uint32_t thread, view, light0, lights;
  uint64_t image_values;
  const float *a, *b; /* b is NULL in a walk over one source */
} sample_visit;
/* BTF_OK, or a status of the library, with its message, at which the walk ends. */
typedef btf_status (*sample_visit_fn)(void *user, const sample_visit *visit);

typedef struct sample_walk {
  const sample_source *a, *b; /* b may be NULL */
  sample_visit_fn visit;
  void *user;
  const char *stage; /* for the progress bar, which goes from `from` to `to` */
  double from, to;
} sample_walk;

/* Blocks go to threads in a fixed order, so that sums kept per thread are the same in every run. */
int sample_walk_run(cli *c, const sample_walk *walk);

#endif
