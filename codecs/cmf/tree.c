/* SPDX-License-Identifier: MIT */
/* tree.c: codebooks by splitting cells in two, the one of largest distortion first. A tree-structured vector
 * quantiser splits by 2-means, started from the two sides of the mean along the principal direction; median
 * cut splits at the median of the element of largest variance. */
#include "cluster_parts.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <btf/btf_codec.h>

enum { CHUNKS = 16, LEAST_CHUNK = 32, POWER_STEPS = 4, MOST_STEPS = 16 };

typedef struct tree_cell {
  uint64_t first, count; /* in order */
  double score;          /* what the largest is split by; 0 = cannot be split */
  uint32_t detail;       /* the vector farthest from the mean, or the element of largest variance */
} tree_cell;

typedef struct tree {
  btfi_cmf_clustering *c;
  tree_cell *cell;
  uint32_t *heap, cells; /* cells by score */
  uint32_t *order, *spare;
  uint8_t *side;     /* of each place in order */
  float *value;      /* and its element, for median cut */
  float *rows;       /* a vector for each thread */
  double *sums;      /* two rows of elements for each chunk */
  double *direction; /* a row of elements */
  float *means;      /* of two sides */
  double scalar[CHUNKS];
  uint32_t farthest[CHUNKS], moved[CHUNKS];
  uint64_t counts[CHUNKS];
  /* The cell at work. */
  uint64_t first, count, chunk;
  uint32_t chunks, element;
  const float *mean;
  int started; /* sides are those of means, not yet of the direction */
} tree;

uint64_t btfi_cmf_tree_bytes(uint64_t count, uint32_t length, uint32_t entries, uint32_t threads) {
  return count * (2 * sizeof(uint32_t) + sizeof(uint8_t) + sizeof(float)) +
         entries * (uint64_t)(sizeof(tree_cell) + sizeof(uint32_t)) +
         length * (sizeof(float) * (threads + UINT64_C(2)) + sizeof(double) * (2 * CHUNKS + UINT64_C(1)));
}

/* ---- passes over the vectors of a cell, in chunks that depend on their number alone ---- */

static btf_status pass(tree *t, uint64_t first, uint64_t count, btf_task_fn task) {
  t->first = first;
  t->count = count;
  t->chunks = count < CHUNKS * LEAST_CHUNK ? (uint32_t)((count + LEAST_CHUNK - 1) / LEAST_CHUNK) : CHUNKS;
  t->chunk = (count + t->chunks - 1) / t->chunks;
  return t->c->host->parallel(t->c->ctx, t->chunks, task, t);
}

/* The vectors of a chunk: places begin .. end in order. */
static void chunk_range(const tree *t, uint32_t chunk, uint64_t *begin, uint64_t *end) {
  const uint64_t last = t->first + t->count;
  *begin = t->first + chunk * t->chunk;
  *end = *begin + t->chunk < last ? *begin + t->chunk : last;
  if (*begin > last) *begin = last;
}

static const float *read_vector(const tree *t, uint64_t place, uint32_t thread) {
  const btfi_cmf_vectors *vectors = t->c->vectors;
  float *row = t->rows + (size_t)thread * vectors->length;
  vectors->read(vectors->user, t->order[place], row);
  return row;
}

static void add_up(tree *t, uint32_t row, double *sum) {
  const uint32_t length = t->c->vectors->length;
  memset(sum, 0, length * sizeof *sum);
  for (uint32_t chunk = 0; chunk < t->chunks; chunk++) {
    const double *part = t->sums + (2 * (size_t)chunk + row) * length;
    for (uint32_t i = 0; i < length; i++) sum[i] += part[i];
  }
}

static void sum_chunk(void *job, uint32_t chunk, uint32_t thread) {
  tree *t = job;
  const uint32_t length = t->c->vectors->length;
  double *sum = t->sums + 2 * (size_t)chunk * length;
  uint64_t place, end;
  memset(sum, 0, length * sizeof *sum);
  chunk_range(t, chunk, &place, &end);
  for (; place < end; place++) {
    const float *x = read_vector(t, place, thread);
    for (uint32_t i = 0; i < length; i++) sum[i] += (double)x[i];
  }
}

static btf_status make_mean(tree *t, const tree_cell *cell, float *mean) {
  const uint32_t length = t->c->vectors->length;
  BTF_TRY(pass(t, cell->first, cell->count, sum_chunk));
  add_up(t, 0, t->direction);
  for (uint32_t i = 0; i < length; i++) mean[i] = (float)(t->direction[i] / (double)cell->count);
  return BTF_OK;
}

/* ---- distortion ---- */

static void distort_chunk(void *job, uint32_t chunk, uint32_t thread) {
  tree *t = job;
  double largest = -1.0;
  uint64_t place, end;
  t->scalar[chunk] = 0.0;
  chunk_range(t, chunk, &place, &end);
  for (; place < end; place++) {
    const double d =
        btfi_cmf_distance(read_vector(t, place, thread), t->mean, t->c->vectors->length, INFINITY);
    t->scalar[chunk] += d;
    if (d > largest) {
      largest = d;
      t->farthest[chunk] = t->order[place];
    }
  }
}

static void vary_chunk(void *job, uint32_t chunk, uint32_t thread) {
  tree *t = job;
  const uint32_t length = t->c->vectors->length;
  double *sum = t->sums + 2 * (size_t)chunk * length;
  uint64_t place, end;
  memset(sum, 0, length * sizeof *sum);
  chunk_range(t, chunk, &place, &end);
  for (; place < end; place++) {
    const float *x = read_vector(t, place, thread);
    for (uint32_t i = 0; i < length; i++) {
      const double d = (double)x[i] - (double)t->mean[i];
      sum[i] += d * d;
    }
  }
}

static btf_status score_cell(tree *t, uint32_t index) {
  tree_cell *cell = &t->cell[index];
  const uint32_t length = t->c->vectors->length;
  t->mean = t->c->out->values + (size_t)index * length;
  cell->score = 0.0;
  if (cell->count < 2) return BTF_OK;
  if (t->c->options->method == CMF_MEDIAN_CUT) {
    BTF_TRY(pass(t, cell->first, cell->count, vary_chunk));
    add_up(t, 0, t->direction);
    for (uint32_t i = 0; i < length; i++) {
      if (t->direction[i] > cell->score) {
        cell->score = t->direction[i];
        cell->detail = i;
      }
    }
    return BTF_OK;
  }
  BTF_TRY(pass(t, cell->first, cell->count, distort_chunk));
  double largest = 0.0;
  for (uint32_t chunk = 0; chunk < t->chunks; chunk++) cell->score += t->scalar[chunk];
  if (!(cell->score > 0.0)) return BTF_OK;
  for (uint32_t chunk = 0; chunk < t->chunks; chunk++) {
    t->c->vectors->read(t->c->vectors->user, t->farthest[chunk], t->rows);
    const double d = btfi_cmf_distance(t->rows, t->mean, length, INFINITY);
    if (d > largest) {
      largest = d;
      cell->detail = t->farthest[chunk];
    }
  }
  return BTF_OK;
}

/* ---- splitting by 2-means ---- */

/* Sum of (x - mean) times its inner product with the direction. */
static void power_chunk(void *job, uint32_t chunk, uint32_t thread) {
  tree *t = job;
  const uint32_t length = t->c->vectors->length;
  double *sum = t->sums + 2 * (size_t)chunk * length;
  uint64_t place, end;
  memset(sum, 0, length * sizeof *sum);
  chunk_range(t, chunk, &place, &end);
  for (; place < end; place++) {
    const float *x = read_vector(t, place, thread);
    double part[4] = {0}, along;
    uint32_t i = 0;
    for (; i + 4 <= length; i += 4)
      for (uint32_t j = 0; j < 4; j++)
        part[j] += ((double)x[i + j] - (double)t->mean[i + j]) * t->direction[i + j];
    for (; i < length; i++) part[0] += ((double)x[i] - (double)t->mean[i]) * t->direction[i];
    along = (part[0] + part[1]) + (part[2] + part[3]);
    t->side[place] = along > 0.0;
    for (i = 0; i < length; i++) sum[i] += along * ((double)x[i] - (double)t->mean[i]);
  }
}

/* Puts vectors on the side of the nearer mean, once there are means, and adds up both sides. */
static void side_chunk(void *job, uint32_t chunk, uint32_t thread) {
  tree *t = job;
  const uint32_t length = t->c->vectors->length;
  double *sum = t->sums + 2 * (size_t)chunk * length;
  uint64_t place, end;
  memset(sum, 0, 2 * (size_t)length * sizeof *sum);
  t->moved[chunk] = 0;
  t->counts[chunk] = 0;
  chunk_range(t, chunk, &place, &end);
  for (; place < end; place++) {
    const float *x = read_vector(t, place, thread);
    if (t->started) {
      const double d0 = btfi_cmf_distance(x, t->means, length, INFINITY);
      const uint8_t side = btfi_cmf_distance(x, t->means + length, length, d0) < d0;
      t->moved[chunk] += side != t->side[place];
      t->side[place] = side;
    }
    double *to = sum + t->side[place] * (size_t)length;
    t->counts[chunk] += t->side[place];
    for (uint32_t i = 0; i < length; i++) to[i] += (double)x[i];
  }
}

static void normalise(double *direction, uint32_t length) {
  double largest = 0.0;
  for (uint32_t i = 0; i < length; i++) largest = fmax(largest, fabs(direction[i]));
  for (uint32_t i = 0; largest > 0.0 && i < length; i++) direction[i] /= largest;
}

/* Sides along the principal direction, found by a few steps of the power iteration from the farthest vector.
 */
static btf_status principal_sides(tree *t, const tree_cell *cell) {
  const uint32_t length = t->c->vectors->length;
  t->c->vectors->read(t->c->vectors->user, cell->detail, t->rows);
  for (uint32_t i = 0; i < length; i++) t->direction[i] = (double)t->rows[i] - (double)t->mean[i];
  for (uint32_t step = 0; step < POWER_STEPS; step++) {
    normalise(t->direction, length);
    BTF_TRY(pass(t, cell->first, cell->count, power_chunk));
    add_up(t, 0, t->direction);
  }
  return BTF_OK;
}

static btf_status split_in_two_means(tree *t, const tree_cell *cell) {
  const uint32_t length = t->c->vectors->length;
  BTF_TRY(principal_sides(t, cell));
  for (uint32_t step = 0; step < MOST_STEPS; step++) {
    uint64_t moved = 0, counts[2] = {0, 0};
    t->started = step > 0;
    BTF_TRY(pass(t, cell->first, cell->count, side_chunk));
    for (uint32_t chunk = 0; chunk < t->chunks; chunk++) {
      moved += t->moved[chunk];
      counts[1] += t->counts[chunk];
    }
    counts[0] = cell->count - counts[1];
    if (counts[0] == 0 || counts[1] == 0 || (step > 0 && moved * 500 <= cell->count)) break;
    for (uint32_t side = 0; side < 2; side++) {
      add_up(t, side, t->direction);
      for (uint32_t i = 0; i < length; i++)
        t->means[side * (size_t)length + i] = (float)(t->direction[i] / (double)counts[side]);
    }
  }
  return BTF_OK;
}

/* ---- splitting at the median ---- */

static void pick_chunk(void *job, uint32_t chunk, uint32_t thread) {
  tree *t = job;
  uint64_t place, end;
  chunk_range(t, chunk, &place, &end);
  for (; place < end; place++) t->value[place] = read_vector(t, place, thread)[t->element];
}

static int compare_floats(const void *a, const void *b) {
  const float x = *(const float *)a, y = *(const float *)b;
  return (x > y) - (x < y);
}

static btf_status split_at_median(tree *t, const tree_cell *cell) {
  float *sorted = t->value + cell->first;
  uint64_t middle = cell->count / 2;
  t->element = cell->detail;
  BTF_TRY(pass(t, cell->first, cell->count, pick_chunk));
  float *copy = (float *)t->spare + cell->first; /* spare is free until cells are parted */
  memcpy(copy, sorted, cell->count * sizeof *copy);
  qsort(copy, cell->count, sizeof *copy, compare_floats);
  /* The place next to the median where the value changes, since equal ones stay together. */
  uint64_t below = middle, above = middle;
  while (below > 0 && copy[below] == copy[below - 1]) below--;
  while (above < cell->count && (above == 0 || copy[above] == copy[above - 1])) above++;
  if (below == 0 || (above < cell->count && above - middle < middle - below)) below = above;
  const float limit = below < cell->count ? copy[below] : INFINITY;
  for (uint64_t i = 0; i < cell->count; i++) t->side[cell->first + i] = sorted[i] >= limit;
  return BTF_OK;
}

/* ---- the tree ---- */

/* Orders a cell by side; returns how many are on side 0. Where a split left one side empty, one vector, the
 * farthest, is parted from the others. */
static uint64_t part(tree *t, const tree_cell *cell) {
  uint64_t n[2] = {0, 0};
  for (uint64_t i = cell->first; i < cell->first + cell->count; i++) n[t->side[i]]++;
  if (n[0] == 0 || n[1] == 0) {
    const uint32_t apart = t->c->options->method == CMF_MEDIAN_CUT ? t->order[cell->first] : cell->detail;
    for (uint64_t i = cell->first; i < cell->first + cell->count; i++) t->side[i] = t->order[i] == apart;
    n[1] = 1;
    n[0] = cell->count - 1;
  }
  uint64_t at[2] = {cell->first, cell->first + n[0]};
  memcpy(t->spare + cell->first, t->order + cell->first, cell->count * sizeof *t->spare);
  for (uint64_t i = cell->first; i < cell->first + cell->count; i++) t->order[at[t->side[i]]++] = t->spare[i];
  return n[0];
}

static int before(const tree *t, uint32_t a, uint32_t b) {
  if (t->cell[a].score != t->cell[b].score) return t->cell[a].score > t->cell[b].score;
  return a < b;
}

static void sink(tree *t, uint32_t at) {
  for (;;) {
    uint32_t child = 2 * at + 1;
    if (child >= t->cells) return;
    if (child + 1 < t->cells && before(t, t->heap[child + 1], t->heap[child])) child++;
    if (!before(t, t->heap[child], t->heap[at])) return;
    const uint32_t swap = t->heap[child];
    t->heap[child] = t->heap[at];
    t->heap[at] = swap;
    at = child;
  }
}

static void push(tree *t, uint32_t cell) {
  uint32_t at = t->cells++;
  t->heap[at] = cell;
  while (at > 0 && before(t, t->heap[at], t->heap[(at - 1) / 2])) {
    const uint32_t above = t->heap[(at - 1) / 2];
    t->heap[(at - 1) / 2] = t->heap[at];
    t->heap[at] = above;
    at = (at - 1) / 2;
  }
}

static btf_status add_cell(tree *t, uint32_t index, uint64_t first, uint64_t count) {
  t->cell[index] = (tree_cell){.first = first, .count = count};
  BTF_TRY(make_mean(t, &t->cell[index], t->c->out->values + (size_t)index * t->c->vectors->length));
  return score_cell(t, index);
}

static btf_status grow(tree *t) {
  btfi_cmf_clustering *c = t->c;
  for (uint64_t v = 0; v < c->vectors->count; v++) t->order[v] = (uint32_t)v;
  BTF_TRY(add_cell(t, 0, 0, c->vectors->count));
  push(t, 0);
  for (c->out->entries = 1; c->out->entries < c->entries; c->out->entries++) {
    const uint32_t parent = t->heap[0], child = c->out->entries;
    const tree_cell cell = t->cell[parent];
    BTF_TRY(c->host->progress(c->job, c->from + (c->to - c->from) * 0.8 * child / c->entries, c->stage));
    if (!(cell.score > 0.0)) break;
    t->mean = c->out->values + (size_t)parent * c->vectors->length;
    BTF_TRY(c->options->method == CMF_MEDIAN_CUT ? split_at_median(t, &cell) : split_in_two_means(t, &cell));
    const uint64_t left = part(t, &cell);
    BTF_TRY(add_cell(t, parent, cell.first, left));
    BTF_TRY(add_cell(t, child, cell.first + left, cell.count - left));
    sink(t, 0);
    push(t, child);
  }
  return BTF_OK;
}

btf_status btfi_cmf_tree(btfi_cmf_clustering *c) {
  const btf_host *host = c->host;
  const uint64_t count = c->vectors->count;
  const uint32_t length = c->vectors->length, threads = host->thread_count(c->ctx);
  tree t = {.c = c};
  btf_status status = BTF_E_NOMEM;
  t.cell = host->alloc(c->ctx, c->entries, sizeof *t.cell);
  t.heap = host->alloc(c->ctx, c->entries, sizeof *t.heap);
  t.order = host->alloc(c->ctx, count, sizeof *t.order);
  t.spare = host->alloc(c->ctx, count, sizeof *t.spare);
  t.side = host->alloc(c->ctx, count, sizeof *t.side);
  t.value = host->alloc(c->ctx, count, sizeof *t.value);
  t.rows = host->alloc(c->ctx, threads, length * sizeof *t.rows);
  t.sums = host->alloc(c->ctx, 2 * CHUNKS, length * sizeof *t.sums);
  t.direction = host->alloc(c->ctx, length, sizeof *t.direction);
  t.means = host->alloc(c->ctx, 2, length * sizeof *t.means);
  if (t.cell != NULL && t.heap != NULL && t.order != NULL && t.spare != NULL && t.side != NULL &&
      t.value != NULL && t.rows != NULL && t.sums != NULL && t.direction != NULL && t.means != NULL)
    status = grow(&t);
  host->free(c->ctx, t.cell);
  host->free(c->ctx, t.heap);
  host->free(c->ctx, t.order);
  host->free(c->ctx, t.spare);
  host->free(c->ctx, t.side);
  host->free(c->ctx, t.value);
  host->free(c->ctx, t.rows);
  host->free(c->ctx, t.sums);
  host->free(c->ctx, t.direction);
  host->free(c->ctx, t.means);
  return status;
}
