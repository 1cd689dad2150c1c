/* SPDX-License-Identifier: MIT */
/* seeds.c: where k-means starts. Two assignments are found and improved in a sketch of the vectors, and the
 * better one is taken: that of greedy k-means++, whose seeds are single vectors and find clusters that stand
 * apart; and that of a tree, whose cells are averages and follow variation that is hidden in noise.
 *
 * In the sketch, every SKETCH-th element is added up with random signs. That keeps squared distances in the
 * mean, within a factor of 1 -+ sqrt(2 / SKETCH) in one standard deviation: enough to start from, and far
 * cheaper than the vectors. */
#include "cluster_parts.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

enum { SKETCH = 256, GROUP = 256 /* vectors of a task */, MOST_TRIALS = 4, STEPS = 8, SEARCH_ROWS = 128 };

typedef struct seeding {
  const btfi_cmf_clustering *c;
  uint64_t groups;
  uint32_t width;     /* elements of a sketch */
  const float *sign;  /* of each element */
  float *rows;        /* a vector for each thread */
  float *sketch;      /* element f of vector v at [(v / GROUP * width + f) * GROUP + v % GROUP] */
  float *nearest;     /* squared distance of each vector to the seeds so far */
  uint32_t *owner;    /* and which seed it is */
  double *sums;       /* of each group */
  double *trial_sums; /* of each group and trial */
  uint32_t trials;
  uint32_t taken; /* seeds so far */
  float trial[MOST_TRIALS][SKETCH];
} seeding;

static btfi_cmf_cluster_options sketch_options(uint32_t method, uint32_t entries) {
  const btfi_cmf_cluster_options options = {.method = method, .entries = entries, .max_iterations = STEPS};
  return options;
}

static uint32_t width_of(uint32_t length) {
  return length < SKETCH ? length : SKETCH;
}

/* What one clustering of the sketches may use. */
static uint64_t sketch_bytes(uint64_t count, uint32_t width, uint32_t entries, uint32_t threads) {
  const btfi_cmf_cluster_options tree = sketch_options(CMF_TSVQ, entries),
                                 kmeans = sketch_options(CMF_KMEANS, entries);
  const uint64_t a = btfi_cmf_cluster_bytes(&tree, 1, count, width, threads),
                 b = btfi_cmf_cluster_bytes(&kmeans, 1, count, width, threads);
  return (a > b ? a : b) + btfi_cmf_search_bytes(entries, width, SEARCH_ROWS);
}

uint64_t btfi_cmf_start_bytes(uint64_t count, uint32_t length, uint32_t entries, uint32_t threads) {
  const uint64_t groups = (count + GROUP - 1) / GROUP, width = width_of(length);
  const uint64_t kept = entries * (width * sizeof(float)) + count * sizeof(uint32_t) + STEPS * sizeof(double);
  return groups * GROUP * ((width + 1) * sizeof(float) + sizeof(uint32_t)) +
         groups * (1 + MOST_TRIALS) * sizeof(double) + (threads + UINT64_C(1)) * length * sizeof(float) +
         2 * kept + sketch_bytes(count, (uint32_t)width, entries, threads);
}

static uint32_t group_size(const seeding *s, uint32_t group) {
  const uint64_t left = s->c->vectors->count - (uint64_t)group * GROUP;
  return left < GROUP ? (uint32_t)left : GROUP;
}

static void sketch_group(void *job, uint32_t group, uint32_t thread) {
  const seeding *s = job;
  const btfi_cmf_vectors *vectors = s->c->vectors;
  float *row = s->rows + (size_t)thread * vectors->length,
        *dst = s->sketch + (size_t)group * s->width * GROUP;
  memset(dst, 0, sizeof *dst * s->width * GROUP);
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
  const float *sketch = s->sketch + (size_t)group * s->width * GROUP;
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
    if (d[v] < nearest[v]) {
      nearest[v] = d[v];
      s->owner[(size_t)group * GROUP + v] = s->taken;
    }
    sum += (double)nearest[v];
  }
  s->sums[group] = sum;
}

static void copy_sketch(seeding *s, uint64_t vector, uint32_t trial) {
  const float *sketch = s->sketch + vector / GROUP * s->width * GROUP + vector % GROUP;
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

static btf_status take_seeds(seeding *s, double to) {
  const btfi_cmf_clustering *c = s->c;
  const uint32_t groups = (uint32_t)s->groups, wanted = 2 + (uint32_t)log(c->entries);
  uint64_t random = c->options->seed;
  uint64_t seed = (uint64_t)(btf_random_unit(&random) * (double)c->vectors->count);
  for (s->taken = 0; s->taken < c->entries; s->taken++) {
    BTF_TRY(c->host->progress(c->job, c->from + (to - c->from) * s->taken / c->entries, c->stage));
    if (s->taken > 0) {
      double total = 0.0, least = INFINITY;
      uint64_t tried[MOST_TRIALS];
      for (uint32_t g = 0; g < groups; g++) total += s->sums[g];
      if (!(total > 0.0)) break;
      s->trials = wanted < MOST_TRIALS ? wanted : MOST_TRIALS;
      for (uint32_t t = 0; t < s->trials; t++) {
        tried[t] = draw(s, btf_random_unit(&random) * total);
        copy_sketch(s, tried[t], t);
      }
      BTF_TRY(c->host->parallel(c->ctx, groups, try_group, s));
      seed = tried[0];
      for (uint32_t t = 0; t < s->trials; t++) {
        double sum = 0.0;
        for (uint32_t g = 0; g < groups; g++) sum += s->trial_sums[(size_t)g * MOST_TRIALS + t];
        if (sum < least) {
          least = sum;
          seed = tried[t];
        }
      }
    }
    copy_sketch(s, seed, 0);
    BTF_TRY(c->host->parallel(c->ctx, groups, take_group, s));
  }
  return BTF_OK;
}

/* ---- the two starts, improved ---- */

static void read_sketch(const void *user, uint64_t index, float *dst) {
  const seeding *s = user;
  const float *sketch = s->sketch + index / GROUP * s->width * GROUP + index % GROUP;
  for (uint32_t f = 0; f < s->width; f++) dst[f] = sketch[(size_t)f * GROUP];
}

static btf_status improve(const seeding *s, const uint32_t *start, double from, double to,
                          btfi_cmf_codebook *out) {
  const btfi_cmf_clustering *c = s->c;
  const btfi_cmf_vectors vectors = {c->vectors->count, s->width, read_sketch, s};
  btfi_cmf_cluster_options options = sketch_options(CMF_KMEANS, c->entries);
  options.max_working_set =
      sketch_bytes(c->vectors->count, s->width, c->entries, c->host->thread_count(c->ctx));
  return btfi_cmf_cluster_from(c->host, c->ctx, &vectors, &options, start, c->job, from, to, c->stage, out);
}

static btf_status grow_and_improve(const seeding *s, double from, double to, btfi_cmf_codebook *out) {
  const btfi_cmf_clustering *c = s->c;
  const btfi_cmf_vectors vectors = {c->vectors->count, s->width, read_sketch, s};
  btfi_cmf_cluster_options options = sketch_options(CMF_TSVQ, c->entries);
  btfi_cmf_codebook tree;
  const double middle = 0.5 * (from + to);
  options.max_working_set =
      sketch_bytes(c->vectors->count, s->width, c->entries, c->host->thread_count(c->ctx));
  BTF_TRY(btfi_cmf_cluster_from(c->host, c->ctx, &vectors, &options, NULL, c->job, from, middle, c->stage,
                                &tree));
  const btf_status status = improve(s, tree.index, middle, to, out);
  btfi_cmf_codebook_free(c->host, c->ctx, &tree);
  return status;
}

static btf_status find_start(seeding *s, double to) {
  const btfi_cmf_clustering *c = s->c;
  const double step = (to - c->from) / 8.0;
  btfi_cmf_codebook seeded = {0}, grown = {0};
  btf_status status = c->host->progress(c->job, c->from, c->stage);
  if (status == BTF_OK) status = c->host->parallel(c->ctx, (uint32_t)s->groups, sketch_group, s);
  if (status == BTF_OK) status = take_seeds(s, c->from + 4.0 * step);
  if (status == BTF_OK) status = improve(s, s->owner, c->from + 4.0 * step, c->from + 5.0 * step, &seeded);
  if (status == BTF_OK) status = grow_and_improve(s, c->from + 5.0 * step, to, &grown);
  if (status == BTF_OK)
    memcpy(c->out->index, grown.inertia < seeded.inertia ? grown.index : seeded.index,
           c->vectors->count * sizeof *grown.index);
  btfi_cmf_codebook_free(c->host, c->ctx, &seeded);
  btfi_cmf_codebook_free(c->host, c->ctx, &grown);
  return status;
}

btf_status btfi_cmf_start(btfi_cmf_clustering *c, double to) {
  const btf_host *host = c->host;
  const uint32_t length = c->vectors->length, threads = host->thread_count(c->ctx);
  seeding s = {.c = c, .groups = (c->vectors->count + GROUP - 1) / GROUP};
  uint64_t random = c->options->seed ^ UINT64_C(0x5bd1e9955bd1e995);
  btf_status status = BTF_E_NOMEM;
  s.width = width_of(length);
  float *sign = host->alloc(c->ctx, length, sizeof *sign);
  s.sign = sign;
  s.rows = host->alloc(c->ctx, threads, length * sizeof *s.rows);
  s.sketch = host->alloc(c->ctx, s.groups, (uint64_t)s.width * GROUP * sizeof *s.sketch);
  s.nearest = host->alloc(c->ctx, s.groups, GROUP * sizeof *s.nearest);
  s.owner = host->alloc(c->ctx, s.groups, GROUP * sizeof *s.owner);
  s.sums = host->alloc(c->ctx, s.groups, sizeof *s.sums);
  s.trial_sums = host->alloc(c->ctx, s.groups, MOST_TRIALS * sizeof *s.trial_sums);
  if (sign != NULL && s.rows != NULL && s.sketch != NULL && s.nearest != NULL && s.owner != NULL &&
      s.sums != NULL && s.trial_sums != NULL) {
    for (uint32_t i = 0; i < length; i++) sign[i] = btf_random_u64(&random) >> 63 ? -1.0f : 1.0f;
    for (uint64_t v = 0; v < s.groups * GROUP; v++) s.nearest[v] = INFINITY;
    memset(s.owner, 0, s.groups * GROUP * sizeof *s.owner);
    status = find_start(&s, to);
  }
  host->free(c->ctx, sign);
  host->free(c->ctx, s.rows);
  host->free(c->ctx, s.sketch);
  host->free(c->ctx, s.nearest);
  host->free(c->ctx, s.owner);
  host->free(c->ctx, s.sums);
  host->free(c->ctx, s.trial_sums);
  return status;
}
