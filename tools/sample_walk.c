/* SPDX-License-Identifier: MIT */
#include "sample_walk.h"

#include <stdlib.h>
#include <string.h>

#include "parallel.h"

enum { message_size = 1024 };

typedef struct walker {
  float *a, *b;
  btf_status status;
  char message[message_size]; /* the library keeps messages by thread */
} walker;

typedef struct walk_state {
  cli *c;
  const sample_walk *walk;
  uint32_t block_lights, blocks_per_view;
  uint64_t blocks;
  walker *walkers;
  bool interrupted;
} walk_state;

static bool note_failure(walker *w, btf_status status) {
  w->status = status;
  snprintf(w->message, sizeof w->message, "%s", btf_error_message());
  return false;
}

static bool visit_block(void *user, uint64_t index, uint32_t thread) {
  walk_state *s = user;
  walker *w = &s->walkers[thread];
  const sample_walk *walk = s->walk;
  sample_visit visit = {0};
  btf_status status;
  visit.thread = thread;
  visit.view = (uint32_t)(index / s->blocks_per_view);
  visit.light0 = (uint32_t)(index % s->blocks_per_view) * s->block_lights;
  visit.lights = walk->a->lights - visit.light0;
  if (visit.lights > s->block_lights) visit.lights = s->block_lights;
  visit.image_values = sample_source_image_values(walk->a);
  status = sample_source_read(walk->a, visit.view, visit.light0, visit.lights, w->a);
  if (status != BTF_OK) return note_failure(w, status);
  if (walk->b != NULL) {
    status = sample_source_read(walk->b, visit.view, visit.light0, visit.lights, w->b);
    if (status != BTF_OK) return note_failure(w, status);
  }
  visit.a = w->a;
  visit.b = w->b;
  status = walk->visit(walk->user, &visit);
  if (status != BTF_OK) return note_failure(w, status);
  /* The bar belongs to the thread of the command. */
  if (thread == 0 &&
      cli_progress(s->c, walk->from + (walk->to - walk->from) * (double)index / (double)s->blocks,
                   walk->stage)) {
    s->interrupted = true;
    return false;
  }
  return true;
}

int sample_walk_run(cli *c, const sample_walk *walk) {
  walk_state s = {0};
  size_t block_values;
  int failed = EXIT_DONE;
  s.c = c;
  s.walk = walk;
  s.block_lights = sample_source_block_lights(walk->a);
  s.blocks_per_view = (walk->a->lights + s.block_lights - 1) / s.block_lights;
  s.blocks = (uint64_t)s.blocks_per_view * walk->a->views;
  block_values = (size_t)sample_source_image_values(walk->a) * s.block_lights;
  s.walkers = calloc(c->threads, sizeof *s.walkers);
  if (s.walkers == NULL) return cli_out_of_memory();
  for (uint32_t t = 0; t < c->threads && !failed; t++) {
    s.walkers[t].a = malloc(block_values * sizeof(float));
    if (walk->b != NULL) s.walkers[t].b = malloc(block_values * sizeof(float));
    if (s.walkers[t].a == NULL || (walk->b != NULL && s.walkers[t].b == NULL)) failed = cli_out_of_memory();
  }
  if (!failed && !parallel_for(c->threads, s.blocks, visit_block, &s)) {
    for (uint32_t t = 0; t < c->threads && !failed; t++)
      if (s.walkers[t].status != BTF_OK)
        failed = cli_fail(cli_exit_of(s.walkers[t].status), "%s", s.walkers[t].message);
    if (!failed) failed = cli_fail_interrupted();
  }
  for (uint32_t t = 0; t < c->threads; t++) {
    free(s.walkers[t].a);
    free(s.walkers[t].b);
  }
  free(s.walkers);
  return failed;
}
