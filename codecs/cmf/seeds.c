/* SPDX-License-Identifier: MIT */
/* seeds.c: where k-means starts. Greedy k-means++: each further vector is the best of a few drawn with
 * probability proportional to the squared distance from those taken. Distances are taken in a sketch: every
 * SKETCH-th element is added up with random signs, which keeps squared distances in the mean, within a factor
 * of 1 -+ sqrt(2 / SKETCH) in one standard deviation. That is enough to draw from, and far cheaper than the
 * vectors themselves. */
#include "cluster_parts.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

enum { SKETCH = 64, GROUP = 256 /* vectors of a task */, MOST_TRIALS = 16 };

typedef struct seeding {
  const btfi_cmf_clustering *c;
  uint64_t groups;
  uint32_t width;     /* elements of a sketch */
  const float *sign;  /* of each element */
  float *rows;        /* a vector for each thread */
  float *sketch;      /* element f of vector v at [(v / GROUP * SKETCH + f) * GROUP + v % GROUP] */
  float *nearest;     /* squared distance of each vector to the seeds so far */
  double *sums;       /* of each group */
  double *trial_sums; /* of each group and trial */
  uint32_t trials;
  float trial[MOST_TRIALS][SKETCH];
} seeding;

uint64_t btfi_cmf_seeds_bytes(uint64_t count, uint32_t length, uint32_t threads) {
  const uint64_t groups = (count + GROUP - 1) / GROUP;
  return groups * GROUP * (SKETCH + 1) * sizeof(float) + groups * (1 + MOST_TRIALS) * sizeof(double) +
         (threads + UINT64_C(1)) * length * sizeof(float);
}

static uint32_t group_size(const seeding *s, uint32_t group) {
  const uint64_t left = s->c->vectors->count - (uint64_t)group * GROUP;
  return left < GROUP ? (uint32_t)left : GROUP;
}

static void sketch_group(void *job, uint32_t group, uint32_t thread) {
  const seeding *s = job;
  const btfi_cmf_vectors *vectors = s->c->vectors;
  float *row = s->rows + (size_t)thread * vectors->length, *dst = s->sketch + (size_t)group * SKETCH * GROUP;
  memset(dst, 0, sizeof *dst * SKETCH * GROUP);
  for (uint32_t v = 0; v < group_size(s, group); v++) {
    float sum[SKETCH] = {0};
    vectors->read(vectors->user, (uint64_t)group * GROUP + v, row);
    for (uint32_t i = 0; i < vectors->length; i += s->width) {
      const uint32_t n = vectors->length - i < s->width ? vectors->length - i : s->width;
      for (uint32_t f = 0; f < n; f++) sum[f] += s->sign[i + f] * row[i + f];
    }
    for (uint32_t f = 0; f < s->width; f++) dst[(size_t)f * GROUP + v] = sum[f];
  }
}

/* Squared distances of a group's sketches to one. */
static void measure(const seeding *s, uint32_t group, const float *to, float *d) {
  const float *sketch = s->sketch + (size_t)group * SKETCH * GROUP;
  for (uint32_t v = 0; v < GROUP; v++) d[v] = 0.0f;
  for (uint32_t f = 0; f < s->width; f++) {
    const float *value = sketch + (size_t)f * GROUP, target = to[f];
    for (uint32_t v = 0; v < GROUP; v++) d[v] += (value[v] - target) * (value[v] - target);
  }
}

static void try_group(void *job, uint32_t group, uint32_t thread) {
  const seeding *s = job;
  const float *nearest = s->nearest + (size_t)group * GROUP;
  const uint32_t n = group_size(s, group);
  float d[GROUP];
  (void)thread;
  for (uint32_t t = 0; t < s->trials; t++) {
    double sum = 0.0;
    measure(s, group, s->trial[t], d);
    for (uint32_t v = 0; v < n; v++) sum += (double)(d[v] < nearest[v] ? d[v] : nearest[v]);
    s->trial_sums[(size_t)group * MOST_TRIALS + t] = sum;
  }
}

/* Takes trial 0. */
static void take_group(void *job, uint32_t group, uint32_t thread) {
  const seeding *s = job;
  float *nearest = s->nearest + (size_t)group * GROUP, d[GROUP];
  const uint32_t n = group_size(s, group);
  double sum = 0.0;
  (void)thread;
  measure(s, group, s->trial[0], d);
  for (uint32_t v = 0; v < n; v++) {
    if (d[v] < nearest[v]) nearest[v] = d[v];
    sum += (double)nearest[v];
  }
  s->sums[group] = sum;
}

static void copy_sketch(seeding *s, uint64_t vector, uint32_t trial) {
  const float *sketch = s->sketch + vector / GROUP * SKETCH * GROUP + vector % GROUP;
  for (uint32_t f = 0; f < s->width; f++) s->trial[trial][f] = sketch[(size_t)f * GROUP];
}

/* The vector at a place within the sum of all distances. */
static uint64_t draw(const seeding *s, double place) {
  uint64_t group = 0, last = 0;
  for (; group + 1 < s->groups && place >= s->sums[group]; group++) place -= s->sums[group];
  for (uint64_t v = group * GROUP, end = v + group_size(s, (uint32_t)group); v < end; v++) {
    if (!(s->nearest[v] > 0.0f)) continue;
    last = v;
    place -= (double)s->nearest[v];
    if (place < 0.0) break;
  }
  return last;
}

static btf_status take_seeds(seeding *s, double to, uint32_t *ids) {
  const btfi_cmf_clustering *c = s->c;
  const uint32_t groups = (uint32_t)s->groups;
  uint64_t random = c->options->seed;
  ids[0] = (uint32_t)(btf_random_unit(&random) * (double)c->vectors->count);
  const uint32_t wanted = 2 + (uint32_t)log(c->entries);
  for (uint32_t taken = 0; taken < c->entries; taken++) {
    BTF_TRY(c->host->progress(c->job, c->from + (to - c->from) * (0.2 + 0.8 * taken / c->entries), c->stage));
    if (taken > 0) {
      double total = 0.0;
      uint64_t tried[MOST_TRIALS];
      for (uint32_t g = 0; g < groups; g++) total += s->sums[g];
      if (!(total > 0.0)) {
        for (; taken < c->entries; taken++) ids[taken] = ids[0];
        break;
      }
      s->trials = wanted < MOST_TRIALS ? wanted : MOST_TRIALS;
      for (uint32_t t = 0; t < s->trials; t++) {
        tried[t] = draw(s, btf_random_unit(&random) * total);
        copy_sketch(s, tried[t], t);
      }
      BTF_TRY(c->host->parallel(c->ctx, groups, try_group, s));
      uint32_t best = 0;
      double least = INFINITY;
      for (uint32_t t = 0; t < s->trials; t++) {
        double sum = 0.0;
        for (uint32_t g = 0; g < groups; g++) sum += s->trial_sums[(size_t)g * MOST_TRIALS + t];
        if (sum < least) {
          least = sum;
          best = t;
        }
      }
      ids[taken] = (uint32_t)tried[best];
    }
    copy_sketch(s, ids[taken], 0);
    BTF_TRY(c->host->parallel(c->ctx, groups, take_group, s));
  }
  return BTF_OK;
}

btf_status btfi_cmf_seeds(btfi_cmf_clustering *c, double to, uint32_t *ids) {
  const btf_host *host = c->host;
  const uint32_t length = c->vectors->length, threads = host->thread_count(c->ctx);
  seeding s = {.c = c, .groups = (c->vectors->count + GROUP - 1) / GROUP};
  uint64_t random = c->options->seed ^ UINT64_C(0x5bd1e9955bd1e995);
  btf_status status = BTF_E_NOMEM;
  s.width = length < SKETCH ? length : SKETCH;
  float *sign = host->alloc(c->ctx, length, sizeof *sign);
  s.sign = sign;
  s.rows = host->alloc(c->ctx, threads, length * sizeof *s.rows);
  s.sketch = host->alloc(c->ctx, s.groups, SKETCH * GROUP * sizeof *s.sketch);
  s.nearest = host->alloc(c->ctx, s.groups, GROUP * sizeof *s.nearest);
  s.sums = host->alloc(c->ctx, s.groups, sizeof *s.sums);
  s.trial_sums = host->alloc(c->ctx, s.groups, MOST_TRIALS * sizeof *s.trial_sums);
  if (sign != NULL && s.rows != NULL && s.sketch != NULL && s.nearest != NULL && s.sums != NULL &&
      s.trial_sums != NULL) {
    for (uint32_t i = 0; i < length; i++) sign[i] = btf_random_u64(&random) >> 63 ? -1.0f : 1.0f;
    for (uint64_t v = 0; v < s.groups * GROUP; v++) s.nearest[v] = INFINITY;
    status = host->progress(c->job, c->from, c->stage);
    if (status == BTF_OK) status = host->parallel(c->ctx, (uint32_t)s.groups, sketch_group, &s);
    if (status == BTF_OK) status = take_seeds(&s, to, ids);
  }
  host->free(c->ctx, sign);
  host->free(c->ctx, s.rows);
  host->free(c->ctx, s.sketch);
  host->free(c->ctx, s.nearest);
  host->free(c->ctx, s.sums);
  host->free(c->ctx, s.trial_sums);
  return status;
}
