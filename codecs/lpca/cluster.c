/* SPDX-License-Identifier: MIT */
/* cluster.c: assignment of points to the affine subspace that reconstructs them best (Kambhatla and Leen
 * 1997), and the alternation of assignment and refit. */
#include "lpca.h"

#include <math.h>

enum { MOST_BLOCK = 4096, LEAST_BLOCK = 8, MOST_PRODUCTS = 4 << 20, TASK_POINTS = 128, GATHER_RUN = 512 };
/* Rounding of an error that is made of float products, relative to the squared length of the point. */
#define ROUNDING 2e-6f

/* ---- room ---- */

/* Allocates, or with `bytes` only counts. */
static void *need(btfi_lpca_model *m, uint64_t *bytes, bool *ok, uint64_t count, uint64_t size) {
  if (bytes != NULL) {
    *bytes += count * size;
    return NULL;
  }
  void *room = *ok ? m->host->alloc(m->ctx, count, size) : NULL;
  *ok = room != NULL;
  return room;
}

static bool make_rooms(btfi_lpca_model *m, uint64_t max_working_set, uint64_t *bytes) {
  const uint64_t clusters = m->room > m->clusters ? m->room : m->clusters;
  const uint64_t rows = clusters * (m->most_components + 1);
  const uint64_t square = (uint64_t)m->size * m->size;
  const uint64_t room = max_working_set / 8 / sizeof(float);
  uint64_t block = (room < MOST_PRODUCTS ? room : MOST_PRODUCTS) / rows;
  bool ok = true;
  block = block > MOST_BLOCK ? MOST_BLOCK : block < LEAST_BLOCK ? LEAST_BLOCK : block;
  m->block = (uint32_t)(block < m->count ? block : m->count);
  m->threads = m->host->thread_count(m->ctx);
  m->gather_size = (uint64_t)m->size * (m->size > GATHER_RUN ? m->size : GATHER_RUN);
  m->basis = need(m, bytes, &ok, rows * m->size, sizeof *m->basis);
  m->mean_dot = need(m, bytes, &ok, rows, sizeof *m->mean_dot);
  m->values = need(m, bytes, &ok, clusters * LPCA_MAX_COMPONENTS, sizeof *m->values);
  m->trace = need(m, bytes, &ok, clusters, sizeof *m->trace);
  m->cost = need(m, bytes, &ok, clusters, sizeof *m->cost);
  m->start = need(m, bytes, &ok, clusters + 1, sizeof *m->start);
  m->order = need(m, bytes, &ok, m->count, sizeof *m->order);
  m->label = need(m, bytes, &ok, m->count, sizeof *m->label);
  m->second = need(m, bytes, &ok, m->count, sizeof *m->second);
  m->error = need(m, bytes, &ok, m->count, sizeof *m->error);
  m->second_error = need(m, bytes, &ok, m->count, sizeof *m->second_error);
  m->square = need(m, bytes, &ok, m->count, sizeof *m->square);
  m->products = need(m, bytes, &ok, rows * m->block, sizeof *m->products);
  m->gathered = need(m, bytes, &ok, m->threads * m->gather_size, sizeof *m->gathered);
  m->matrix = need(m, bytes, &ok, m->threads * square, sizeof *m->matrix);
  m->eigen = need(m, bytes, &ok, (uint64_t)m->threads * m->size, sizeof *m->eigen);
  m->direction = need(m, bytes, &ok, m->size, sizeof *m->direction);
  m->failed = need(m, bytes, &ok, m->threads, sizeof *m->failed);
  return ok;
}

uint64_t btfi_lpca_model_bytes(const btfi_lpca_model *m, uint64_t max_working_set) {
  btfi_lpca_model counted = *m;
  uint64_t bytes = 0;
  (void)make_rooms(&counted, max_working_set, &bytes);
  /* Eigenvectors: LAPACK works in twice the matrix and a dozen of its rows, for each thread. Splits list the
   * members of two clusters and know three numbers of each. */
  bytes += counted.threads * (2 * (uint64_t)m->size + 12) * (m->size + 1) * sizeof(double);
  return bytes + m->count * sizeof(uint32_t) + 3 * sizeof(double) * m->clusters;
}

btf_status btfi_lpca_model_alloc(btfi_lpca_model *m, uint64_t max_working_set) {
  return make_rooms(m, max_working_set, NULL) ? BTF_OK : BTF_E_NOMEM;
}

void btfi_lpca_model_free(btfi_lpca_model *m) {
  void *const rooms[] = {m->basis,    m->mean_dot, m->values, m->trace, m->cost,         m->start,
                         m->order,    m->label,    m->second, m->error, m->second_error, m->square,
                         m->products, m->gathered, m->matrix, m->eigen, m->failed,       m->direction};
  for (size_t i = 0; i < sizeof rooms / sizeof *rooms; i++) m->host->free(m->ctx, rooms[i]);
}

/* ---- assignment ---- */

typedef struct assignment {
  const btfi_lpca_model *m;
  const float *points; /* of the block */
  uint32_t count;
  bool keep;
  uint32_t *label, *second; /* second and second_error may be NULL */
  float *error, *second_error;
} assignment;

static float square_of(const float *point, uint32_t size) {
  float sum[8] = {0};
  uint32_t i = 0;
  for (; i + 8 <= size; i += 8)
    for (uint32_t k = 0; k < 8; k++) sum[k] += point[i + k] * point[i + k];
  for (; i < size; i++) sum[0] += point[i] * point[i];
  return ((sum[0] + sum[1]) + (sum[2] + sum[3])) + ((sum[4] + sum[5]) + (sum[6] + sum[7]));
}

/* |y - mean|^2 - |E^T (y - mean)|^2 from the products of y with the mean and with E. */
static double error_of(const float *product, const double *mean_dot, uint32_t rows, double square) {
  double error = square - 2.0 * (double)product[0] + mean_dot[0];
  for (uint32_t j = 1; j < rows; j++) {
    const double w = (double)product[j] - mean_dot[j];
    error -= w * w;
  }
  return error > 0.0 ? error : 0.0;
}

static void assign_point(const assignment *a, uint32_t i) {
  const btfi_lpca_model *m = a->m;
  const uint32_t rows = m->components + 1;
  const float *products = m->products + (size_t)i * rows * m->clusters;
  const float square = square_of(a->points + (size_t)i * m->size, m->size);
  uint32_t best = 0, second = 0;
  float best_error = INFINITY, second_error = INFINITY;
  for (uint32_t k = 0; k < m->clusters; k++) {
    const float e =
        (float)error_of(products + (size_t)k * rows, m->mean_dot + (size_t)k * rows, rows, (double)square);
    if (e < best_error) {
      second = best;
      second_error = best_error;
      best = k;
      best_error = e;
    } else if (e < second_error) {
      second = k;
      second_error = e;
    }
  }
  if (a->keep && a->label[i] != best) {
    const uint32_t own = a->label[i];
    const float e = (float)error_of(products + (size_t)own * rows, m->mean_dot + (size_t)own * rows, rows,
                                    (double)square);
    if (e - best_error <= ROUNDING * square) {
      second = best;
      second_error = best_error;
      best = own;
      best_error = e;
    }
  }
  a->label[i] = best;
  a->error[i] = best_error;
  if (a->second != NULL) a->second[i] = second;
  if (a->second_error != NULL) a->second_error[i] = second_error;
}

static void assign_some(void *job, uint32_t index, uint32_t thread) {
  const assignment *a = job;
  const uint32_t first = index * TASK_POINTS;
  const uint32_t end = first + TASK_POINTS < a->count ? first + TASK_POINTS : a->count;
  (void)thread;
  for (uint32_t i = first; i < end; i++) assign_point(a, i);
}

btf_status btfi_lpca_assign(btfi_lpca_model *m, const float *points, uint64_t count, bool keep,
                            uint32_t *label, float *error, uint32_t *second, float *second_error) {
  const uint64_t columns = (uint64_t)m->clusters * (m->components + 1);
  for (uint64_t first = 0; first < count; first += m->block) {
    const uint32_t many = count - first < m->block ? (uint32_t)(count - first) : m->block;
    assignment a = {m,
                    points + first * m->size,
                    many,
                    keep,
                    label + first,
                    second != NULL ? second + first : NULL,
                    error + first,
                    second_error != NULL ? second_error + first : NULL};
    BTF_TRY(m->host->gemm(m->ctx, BTF_TRANSPOSE_B, many, columns, m->size, 1.0f, a.points, m->size, m->basis,
                          m->size, 0.0f, m->products, columns));
    BTF_TRY(m->host->parallel(m->ctx, (many + TASK_POINTS - 1) / TASK_POINTS, assign_some, &a));
  }
  return BTF_OK;
}

typedef struct weighing {
  const btfi_lpca_model *m;
  const float *points;
  uint64_t count;
  const uint32_t *label;
  float *weights, *error;
} weighing;

static void weigh_some(void *job, uint32_t index, uint32_t thread) {
  const weighing *w = job;
  const btfi_lpca_model *m = w->m;
  const uint64_t first = (uint64_t)index * TASK_POINTS;
  const uint64_t end = first + TASK_POINTS < w->count ? first + TASK_POINTS : w->count;
  (void)thread;
  for (uint64_t i = first; i < end; i++) {
    const size_t at = (size_t)w->label[i] * (m->components + 1);
    const float *point = w->points + i * m->size;
    double error = m->mean_dot[at];
    for (uint32_t d = 0; d < m->size; d++) {
      const double away = (double)point[d];
      error += away * (away - 2.0 * (double)m->basis[at * m->size + d]);
    }
    for (uint32_t j = 0; j < m->components; j++) {
      const float *row = m->basis + (at + j + 1) * m->size;
      double sum = -m->mean_dot[at + j + 1];
      for (uint32_t d = 0; d < m->size; d++) sum += (double)row[d] * (double)point[d];
      error -= sum * sum;
      w->weights[i * m->components + j] = (float)sum;
    }
    w->error[i] = error > 0.0 ? (float)error : 0.0f;
  }
}

btf_status btfi_lpca_weights(const btfi_lpca_model *m, const float *points, uint64_t count,
                             const uint32_t *label, float *weights, float *error) {
  weighing w = {m, points, count, label, weights, error};
  return m->host->parallel(m->ctx, (uint32_t)((count + TASK_POINTS - 1) / TASK_POINTS), weigh_some, &w);
}

/* ---- alternation ---- */

double btfi_lpca_cost(const btfi_lpca_model *m) {
  double cost = 0.0;
  for (uint32_t k = 0; k < m->clusters; k++) cost += m->cost[k];
  return cost;
}

double btfi_lpca_cost_with(const btfi_lpca_model *m, uint32_t components) {
  double total = 0.0;
  for (uint32_t k = 0; k < m->clusters; k++) {
    double cost = m->trace[k];
    for (uint32_t j = 0; j < components; j++) cost -= m->values[(size_t)k * LPCA_MAX_COMPONENTS + j];
    total += cost > 0.0 ? cost : 0.0;
  }
  return total;
}

btf_status btfi_lpca_iterate(btfi_lpca_model *m, uint32_t iterations, double least, double *history,
                             uint32_t *steps, double from, double to) {
  BTF_TRY(btfi_lpca_refit(m));
  double cost = btfi_lpca_cost(m), before = INFINITY;
  uint32_t done = 0;
  if (history != NULL) history[0] = cost;
  while (done < iterations) {
    const uint32_t splits = m->splits;
    BTF_TRY(m->host->progress(m->job, from + (to - from) * done / iterations, "clustering"));
    BTF_TRY(btfi_lpca_assign(m, m->points, m->count, true, m->label, m->error, m->second, m->second_error));
    BTF_TRY(btfi_lpca_split(m));
    BTF_TRY(btfi_lpca_refit(m));
    before = cost;
    cost = btfi_lpca_cost(m);
    done++;
    if (history != NULL) history[done] = cost;
    if (before - cost <= least * before && splits == m->splits) break;
  }
  if (steps != NULL) *steps = done + 1;
  return BTF_OK;
}
