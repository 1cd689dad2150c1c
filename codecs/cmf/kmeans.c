/* SPDX-License-Identifier: MIT */
/* kmeans.c: Lloyd's iterations. Vectors whose entry cannot have changed are left out of the search (Hamerly
 * 2010): the distance to their own entry is less than the lower bound of those to all others, which falls by
 * no more than the others move. */
#include "cluster_parts.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <btf/btf_codec.h>

enum { GROUP = 32 /* vectors of a task */ };

typedef struct lloyd {
  btfi_cmf_clustering *c;
  uint32_t entries;
  double *sums;        /* a row of elements for each thread */
  float *rows;         /* and one vector */
  double *others;      /* of each vector: lower bound of the distance to entries not its own */
  uint32_t *order;     /* vectors by entry; then those to search */
  uint32_t *before;    /* index before a search */
  uint64_t *start;     /* entries + 1: where an entry's vectors begin in order */
  double *moved;       /* of each entry, how far its last update moved it */
  uint8_t *changed;    /* of each entry: its vectors are no longer the ones that were averaged */
  double most[2];      /* largest and second largest move */
  uint32_t most_entry; /* whose the largest is */
} lloyd;

typedef struct far_vector {
  double distance;
  uint32_t id;
} far_vector;

uint64_t btfi_cmf_lloyd_bytes(uint64_t count, uint32_t length, uint32_t entries, uint32_t threads) {
  const uint64_t filling = count * sizeof(far_vector) + 2 * (uint64_t)length * sizeof(float);
  return count * (sizeof(double) + 2 * sizeof(uint32_t)) + (entries + UINT64_C(1)) * 17 +
         (uint64_t)threads * length * (sizeof(double) + sizeof(float)) + filling;
}

double btfi_cmf_inertia(const double *distance, uint64_t count) {
  double sum = 0.0;
  for (uint64_t first = 0; first < count; first += 256) {
    double part = 0.0;
    for (uint64_t i = first; i < count && i < first + 256; i++) part += distance[i];
    sum += part;
  }
  return sum;
}

/* ---- update ---- */

static void order_by_entry(lloyd *k) {
  const uint32_t *index = k->c->out->index;
  const uint64_t count = k->c->vectors->count;
  memset(k->start, 0, (k->entries + UINT64_C(1)) * sizeof *k->start);
  for (uint64_t v = 0; v < count; v++) k->start[index[v] + 1]++;
  for (uint32_t e = 0; e < k->entries; e++) k->start[e + 1] += k->start[e];
  for (uint64_t v = 0; v < count; v++) k->order[k->start[index[v]]++] = (uint32_t)v;
  for (uint32_t e = k->entries; e > 0; e--) k->start[e] = k->start[e - 1];
  k->start[0] = 0;
}

static int farther_first(const void *a, const void *b) {
  const far_vector *x = a, *y = b;
  if (x->distance != y->distance) return x->distance > y->distance ? -1 : 1;
  return x->id < y->id ? -1 : 1;
}

/* Gives each entry without vectors one of the vectors farthest from theirs, no two that are the same. */
static btf_status fill_empty(lloyd *k, uint32_t empty) {
  btfi_cmf_clustering *c = k->c;
  const btfi_cmf_vectors *vectors = c->vectors;
  const size_t length = vectors->length;
  uint64_t n = 0;
  uint32_t e = 0, *left = k->before; /* vectors of each entry */
  far_vector *far = c->host->alloc(c->ctx, vectors->count, sizeof *far);
  float *pair = c->host->alloc(c->ctx, 2, length * sizeof *pair);
  if (far == NULL || pair == NULL) {
    c->host->free(c->ctx, far);
    c->host->free(c->ctx, pair);
    return BTF_E_NOMEM;
  }
  for (uint64_t v = 0; v < vectors->count; v++)
    if (c->distance[v] > 0.0) far[n++] = (far_vector){c->distance[v], (uint32_t)v};
  qsort(far, n, sizeof *far, farther_first);
  for (uint32_t i = 0; i < k->entries; i++) left[i] = (uint32_t)(k->start[i + 1] - k->start[i]);
  double last = INFINITY;
  for (uint64_t i = 0; i < n && empty > 0; i++) {
    const uint32_t v = far[i].id, from = c->out->index[v];
    float *here = pair + length, *before = pair;
    if (left[from] < 2) continue;
    vectors->read(vectors->user, v, here);
    if (far[i].distance == last && memcmp(here, before, length * sizeof *here) == 0) continue;
    while (left[e] > 0) e++;
    left[from]--;
    left[e] = 1;
    c->out->index[v] = e;
    c->distance[v] = k->others[v] = 0.0;
    k->changed[from] = k->changed[e] = 1;
    memcpy(before, here, length * sizeof *here);
    last = far[i].distance;
    empty--;
  }
  c->host->free(c->ctx, far);
  c->host->free(c->ctx, pair);
  order_by_entry(k);
  return BTF_OK;
}

static void average_entry(void *job, uint32_t e, uint32_t thread) {
  lloyd *k = job;
  const btfi_cmf_vectors *vectors = k->c->vectors;
  const uint32_t length = vectors->length;
  const uint64_t first = k->start[e], last = k->start[e + 1];
  double *sum = k->sums + (size_t)thread * length, moved = 0.0;
  float *row = k->rows + (size_t)thread * length, *value = k->c->out->values + (size_t)e * length;
  k->moved[e] = 0.0;
  if (!k->changed[e] || first == last) return;
  memset(sum, 0, length * sizeof *sum);
  for (uint64_t i = first; i < last; i++) {
    vectors->read(vectors->user, k->order[i], row);
    for (uint32_t j = 0; j < length; j++) sum[j] += (double)row[j];
  }
  for (uint32_t j = 0; j < length; j++) {
    const float mean = (float)(sum[j] / (double)(last - first));
    const double step = (double)mean - (double)value[j];
    moved += step * step;
    value[j] = mean;
  }
  k->moved[e] = sqrt(moved) * (1.0 + 1e-12);
}

static btf_status update_entries(lloyd *k) {
  btfi_cmf_clustering *c = k->c;
  uint32_t empty = 0;
  order_by_entry(k);
  for (uint32_t e = 0; e < k->entries; e++) empty += k->start[e + 1] == k->start[e];
  if (empty > 0) BTF_TRY(fill_empty(k, empty));
  BTF_TRY(c->host->parallel(c->ctx, k->entries, average_entry, k));
  k->most[0] = k->most[1] = 0.0;
  k->most_entry = 0;
  for (uint32_t e = 0; e < k->entries; e++) {
    if (k->moved[e] > k->most[0]) {
      k->most[1] = k->most[0];
      k->most[0] = k->moved[e];
      k->most_entry = e;
    } else if (k->moved[e] > k->most[1]) {
      k->most[1] = k->moved[e];
    }
  }
  return BTF_OK;
}

/* ---- assignment ---- */

/* The distances to entries that changed, and the bounds after their moves. */
static void measure_group(void *job, uint32_t group, uint32_t thread) {
  lloyd *k = job;
  btfi_cmf_clustering *c = k->c;
  const btfi_cmf_vectors *vectors = c->vectors;
  const uint32_t length = vectors->length;
  float *row = k->rows + (size_t)thread * length;
  for (uint64_t v = (uint64_t)group * GROUP; v < vectors->count && v < (group + UINT64_C(1)) * GROUP; v++) {
    const uint32_t e = c->out->index[v];
    const double bound = k->others[v] - k->most[e == k->most_entry];
    k->others[v] = bound > 0.0 ? bound * (1.0 - 1e-12) : 0.0;
    if (!k->changed[e]) continue;
    vectors->read(vectors->user, v, row);
    c->distance[v] = btfi_cmf_distance(row, c->out->values + (size_t)e * length, length, INFINITY);
  }
}

static btf_status assign_vectors(lloyd *k, const btfi_cmf_search_report *report) {
  btfi_cmf_clustering *c = k->c;
  const uint64_t count = c->vectors->count;
  uint64_t active = 0;
  BTF_TRY(c->host->parallel(c->ctx, (uint32_t)((count + GROUP - 1) / GROUP), measure_group, k));
  memset(k->changed, 0, k->entries);
  for (uint64_t v = 0; v < count; v++) {
    if (sqrt(c->distance[v]) * (1.0 + 1e-12) < k->others[v]) continue;
    k->before[active] = c->out->index[v];
    k->order[active++] = (uint32_t)v;
  }
  BTF_TRY(btfi_cmf_search_prepare(&c->search, c->out->values, k->entries));
  BTF_TRY(btfi_cmf_search_run(&c->search, k->order, active, report, c->out->index, c->distance, k->others));
  for (uint64_t i = 0; i < active; i++) {
    const uint32_t now = c->out->index[k->order[i]];
    if (now != k->before[i]) k->changed[now] = k->changed[k->before[i]] = 1;
  }
  return BTF_OK;
}

static int has_empty(const lloyd *k) {
  uint32_t used = 0;
  uint8_t *seen = (uint8_t *)k->moved; /* free between an assignment and an update */
  memset(seen, 0, k->entries);
  for (uint64_t v = 0; v < k->c->vectors->count; v++) {
    used += !seen[k->c->out->index[v]];
    seen[k->c->out->index[v]] = 1;
  }
  return used < k->entries;
}

/* How far along after that many iterations: their number is not known in advance. */
static double along(const btfi_cmf_clustering *c, double from, uint32_t iterations) {
  return from + (c->to - from) * iterations / (iterations + 8.0);
}

/* Entries from the assignment that is given; any without vectors begin as the first vector. */
static btf_status start_entries(lloyd *k) {
  const btfi_cmf_clustering *c = k->c;
  memset(k->changed, 1, k->entries);
  order_by_entry(k);
  for (uint32_t e = 0; e < k->entries; e++)
    if (k->start[e + 1] == k->start[e])
      c->vectors->read(c->vectors->user, 0, c->out->values + (size_t)e * c->vectors->length);
  return c->host->parallel(c->ctx, k->entries, average_entry, k);
}

static btf_status iterate(lloyd *k, double from) {
  btfi_cmf_clustering *c = k->c;
  const uint64_t count = c->vectors->count;
  btfi_cmf_codebook *out = c->out;
  btfi_cmf_search_report report = {c->job, from, along(c, from, 1), c->stage};
  BTF_TRY(start_entries(k));
  BTF_TRY(btfi_cmf_search_prepare(&c->search, out->values, k->entries));
  BTF_TRY(btfi_cmf_search_run(&c->search, NULL, count, &report, out->index, c->distance, k->others));
  out->history[out->iterations++] = out->inertia = btfi_cmf_inertia(c->distance, count);
  memset(k->changed, 1, k->entries);
  while (out->iterations < c->options->max_iterations && out->inertia > 0.0) {
    const double before = out->inertia;
    report.from = along(c, from, out->iterations);
    report.to = along(c, from, out->iterations + 1);
    BTF_TRY(update_entries(k));
    BTF_TRY(assign_vectors(k, &report));
    out->history[out->iterations++] = out->inertia = btfi_cmf_inertia(c->distance, count);
    if (before - out->inertia <= c->options->tolerance * before && !has_empty(k)) break;
  }
  return BTF_OK;
}

btf_status btfi_cmf_lloyd(btfi_cmf_clustering *c, double from) {
  const btf_host *host = c->host;
  const uint64_t count = c->vectors->count;
  const uint32_t length = c->vectors->length, threads = host->thread_count(c->ctx);
  lloyd k = {.c = c, .entries = c->entries};
  btf_status status = BTF_E_NOMEM;
  c->out->entries = k.entries;
  k.sums = host->alloc(c->ctx, threads, length * sizeof *k.sums);
  k.rows = host->alloc(c->ctx, threads, length * sizeof *k.rows);
  k.others = host->alloc(c->ctx, count, sizeof *k.others);
  k.order = host->alloc(c->ctx, count, sizeof *k.order);
  k.before = host->alloc(c->ctx, count, sizeof *k.before);
  k.start = host->alloc(c->ctx, k.entries + UINT64_C(1), sizeof *k.start);
  k.moved = host->alloc(c->ctx, k.entries, sizeof *k.moved);
  k.changed = host->alloc(c->ctx, k.entries, sizeof *k.changed);
  if (k.sums != NULL && k.rows != NULL && k.others != NULL && k.order != NULL && k.before != NULL &&
      k.start != NULL && k.moved != NULL && k.changed != NULL)
    status = iterate(&k, from);
  host->free(c->ctx, k.sums);
  host->free(c->ctx, k.rows);
  host->free(c->ctx, k.others);
  host->free(c->ctx, k.order);
  host->free(c->ctx, k.before);
  host->free(c->ctx, k.start);
  host->free(c->ctx, k.moved);
  host->free(c->ctx, k.changed);
  return status;
}
