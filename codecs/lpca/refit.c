/* SPDX-License-Identifier: MIT */
/* refit.c: principal components of each cluster, and clusters given to where they are needed. */
#include "lpca.h"

#include <math.h>
#include <string.h>

enum { GATHER_RUN = 512 };
/* Eigenvalues below this share of their sum are rounding error. */
#define NEGLIGIBLE 1e-12

/* ---- one cluster ---- */

/* A principal component analysis in the scratch of a thread. */
typedef struct analysis {
  btfi_lpca_model *m;
  const uint32_t *members;
  uint64_t count;
  const float *mean;
  float *gathered;
  double *matrix; /* eigenvectors, one a row of `order` values */
  double *eigen;
  uint32_t order; /* of the matrix: coordinates, or members where these are fewer */
  bool by_member;
  double trace;
} analysis;

static void mean_of(const btfi_lpca_model *m, const uint32_t *members, uint64_t count, double *sum,
                    float *mean) {
  for (uint32_t d = 0; d < m->size; d++) sum[d] = 0.0;
  for (uint64_t i = 0; i < count; i++) {
    const float *point = m->points + (size_t)members[i] * m->size;
    for (uint32_t d = 0; d < m->size; d++) sum[d] += (double)point[d];
  }
  for (uint32_t d = 0; d < m->size; d++) mean[d] = count > 0 ? (float)(sum[d] / (double)count) : 0.0f;
}

/* The matrix of inner products of the coordinates (or of the members), less the mean. */
static btf_status inner_products(analysis *a) {
  const btfi_lpca_model *m = a->m;
  const uint32_t size = m->size;
  a->by_member = a->count < size;
  a->order = a->by_member ? (uint32_t)a->count : size;
  memset(a->matrix, 0, (size_t)a->order * a->order * sizeof *a->matrix);
  if (a->by_member) {
    for (uint32_t i = 0; i < a->order; i++) {
      const float *point = m->points + (size_t)a->members[i] * size;
      for (uint32_t d = 0; d < size; d++) a->gathered[(size_t)d * a->order + i] = point[d] - a->mean[d];
    }
    BTF_TRY(m->host->gram(m->ctx, size, a->order, a->gathered, a->order, a->matrix));
  } else {
    for (uint64_t first = 0; first < a->count; first += GATHER_RUN) {
      const uint64_t many = a->count - first < GATHER_RUN ? a->count - first : GATHER_RUN;
      for (uint64_t i = 0; i < many; i++) {
        const float *point = m->points + (size_t)a->members[first + i] * size;
        float *dst = a->gathered + i * size;
        for (uint32_t d = 0; d < size; d++) dst[d] = point[d] - a->mean[d];
      }
      BTF_TRY(m->host->gram(m->ctx, many, size, a->gathered, size, a->matrix));
    }
  }
  a->trace = 0.0;
  for (uint32_t i = 0; i < a->order; i++) a->trace += a->matrix[(size_t)i * a->order + i];
  return BTF_OK;
}

static btf_status analyse(analysis *a) {
  BTF_TRY(inner_products(a));
  return a->m->host->symmetric_eigen(a->m->ctx, a->order, a->matrix, a->eigen);
}

static analysis analysis_of(btfi_lpca_model *m, const uint32_t *members, uint64_t count, const float *mean,
                            uint32_t thread) {
  return (analysis){.m = m,
                    .members = members,
                    .count = count,
                    .mean = mean,
                    .gathered = m->gathered + thread * m->gather_size,
                    .matrix = m->matrix + (uint64_t)thread * m->size * m->size,
                    .eigen = m->eigen + (uint64_t)thread * m->size};
}

/* Eigenvector j as a direction of the space of points, not normalised. */
static void direction_of(const analysis *a, uint32_t j, float *dst) {
  const double *vector = a->matrix + (size_t)j * a->order;
  for (uint32_t d = 0; d < a->m->size; d++) {
    if (a->by_member) {
      double sum = 0.0;
      for (uint32_t i = 0; i < a->order; i++)
        sum += vector[i] * (double)a->gathered[(size_t)d * a->order + i];
      dst[d] = (float)sum;
    } else {
      dst[d] = (float)vector[d];
    }
  }
}

static double dot(const float *a, const float *b, uint32_t size) {
  double sum = 0.0;
  for (uint32_t d = 0; d < size; d++) sum += (double)a[d] * (double)b[d];
  return sum;
}

/* Makes `row` orthogonal to those before it and of length 1, in two rounds: one loses as many digits as it
 * takes away. */
static void orthonormalise(const float *basis, uint32_t before, uint32_t size, float *row) {
  for (int round = 0; round < 2; round++) {
    for (uint32_t j = 0; j < before; j++) {
      const double along = dot(basis + (size_t)j * size, row, size);
      for (uint32_t d = 0; d < size; d++) row[d] -= (float)(along * (double)basis[(size_t)j * size + d]);
    }
    const double length = sqrt(dot(row, row, size));
    for (uint32_t d = 0; d < size; d++) row[d] = length > 0.0 ? (float)((double)row[d] / length) : 0.0f;
  }
}

/* The cluster in place k made from its members. */
static btf_status refit_cluster(btfi_lpca_model *m, uint32_t k, const uint32_t *members, uint64_t count,
                                uint32_t thread) {
  const uint32_t size = m->size, rows = m->components + 1;
  float *mean = m->basis + (size_t)k * rows * size, *basis = mean + size;
  double *values = m->values + (size_t)k * LPCA_MAX_COMPONENTS, *mean_dot = m->mean_dot + (size_t)k * rows;
  analysis a = analysis_of(m, members, count, mean, thread);
  memset(mean, 0, (size_t)rows * size * sizeof *mean);
  memset(values, 0, LPCA_MAX_COMPONENTS * sizeof *values);
  m->trace[k] = m->cost[k] = 0.0;
  mean_of(m, members, count, a.eigen, mean);
  if (m->components == 0) {
    for (uint64_t i = 0; i < count; i++) {
      const float *point = m->points + (size_t)members[i] * size;
      for (uint32_t d = 0; d < size; d++) {
        const double away = (double)point[d] - (double)mean[d];
        m->trace[k] += away * away;
      }
    }
    m->cost[k] = m->trace[k];
  } else if (count > 0) {
    BTF_TRY(analyse(&a));
    m->trace[k] = a.trace;
    double captured = 0.0;
    for (uint32_t j = 0; j < a.order && j < LPCA_MAX_COMPONENTS; j++) {
      if (!(a.eigen[j] > NEGLIGIBLE * a.trace)) break;
      values[j] = a.eigen[j];
      if (j >= m->components) continue;
      direction_of(&a, j, basis + (size_t)j * size);
      orthonormalise(basis, j, size, basis + (size_t)j * size);
      captured += a.eigen[j];
    }
    m->cost[k] = a.trace > captured ? a.trace - captured : 0.0;
  }
  for (uint32_t j = 0; j < rows; j++) mean_dot[j] = dot(mean, mean + (size_t)j * size, size);
  return BTF_OK;
}

/* ---- all clusters ---- */

static void refit_task(void *job, uint32_t k, uint32_t thread) {
  btfi_lpca_model *m = job;
  if (k < m->fixed || m->failed[thread] != BTF_OK) return;
  m->failed[thread] = refit_cluster(m, k, m->order + m->start[k], m->start[k + 1] - m->start[k], thread);
}

/* Sorts points by their labels. */
static void collect_members(btfi_lpca_model *m) {
  memset(m->start, 0, ((size_t)m->clusters + 1) * sizeof *m->start);
  for (uint64_t i = 0; i < m->count; i++) m->start[m->label[i] + 1]++;
  for (uint32_t k = 0; k < m->clusters; k++) m->start[k + 1] += m->start[k];
  for (uint64_t i = 0; i < m->count; i++) m->order[m->start[m->label[i]]++] = (uint32_t)i;
  for (uint32_t k = m->clusters; k > 0; k--) m->start[k] = m->start[k - 1];
  m->start[0] = 0;
}

btf_status btfi_lpca_refit(btfi_lpca_model *m) {
  collect_members(m);
  /* Of clusters that stay, what the assignment found. */
  for (uint32_t k = 0; k < m->fixed; k++) {
    m->cost[k] = 0.0;
    for (uint64_t i = m->start[k]; i < m->start[k + 1]; i++) m->cost[k] += (double)m->error[m->order[i]];
  }
  for (uint32_t t = 0; t < m->threads; t++) m->failed[t] = BTF_OK;
  BTF_TRY(m->host->parallel(m->ctx, m->clusters, refit_task, m));
  for (uint32_t t = 0; t < m->threads; t++)
    if (m->failed[t] != BTF_OK)
      return m->host->fail(m->ctx, m->failed[t],
                           "lpca: the principal components of a cluster could not be found");
  return BTF_OK;
}

/* ---- splits ---- */

/* Sorts members by the side of their mean they are on along a direction: the first *half are below it. */
static void halve(const btfi_lpca_model *m, const float *mean, const float *direction, uint32_t *members,
                  uint64_t count, uint64_t *half) {
  uint64_t low = 0, high = count;
  while (low < high) {
    const float *point = m->points + (size_t)members[low] * m->size;
    double along = 0.0;
    for (uint32_t d = 0; d < m->size; d++)
      along += ((double)point[d] - (double)mean[d]) * (double)direction[d];
    if (along < 0.0) {
      low++;
    } else {
      const uint32_t other = members[--high];
      members[high] = members[low];
      members[low] = other;
    }
  }
  *half = low;
}

/* Members of the worst cluster, and those of the least useful that would go there. */
static uint64_t gather_union(const btfi_lpca_model *m, uint32_t worst, uint32_t least, uint32_t *members,
                             double *cost) {
  uint64_t count = 0;
  *cost = 0.0;
  for (uint64_t i = 0; i < m->count; i++) {
    if (m->label[i] != worst && !(m->label[i] == least && m->second[i] == worst)) continue;
    *cost += (double)(m->label[i] == worst ? m->error[i] : m->second_error[i]);
    members[count++] = (uint32_t)i;
  }
  return count;
}

/* Splits `members` and makes the halves the clusters worst and least. */
static btf_status try_halves(btfi_lpca_model *m, uint32_t worst, uint32_t least, uint32_t *members,
                             uint64_t count, uint64_t *half) {
  float *mean = m->basis + (size_t)worst * (m->components + 1) * m->size;
  analysis a;
  *half = 0;
  mean_of(m, members, count, m->eigen, mean);
  a = analysis_of(m, members, count, mean, 0);
  BTF_TRY(analyse(&a));
  /* Across the directions that the cluster has: along the strongest that it lacks. */
  const uint32_t along = m->components < a.order ? m->components : a.order - 1;
  direction_of(&a, along, m->direction);
  halve(m, mean, m->direction, members, count, half);
  if (*half == 0 || *half == count) return BTF_OK;
  BTF_TRY(refit_cluster(m, worst, members, *half, 0));
  return refit_cluster(m, least, members + *half, count - *half, 0);
}

typedef struct candidate {
  double cost, loss; /* squared error, and what it would grow by without the cluster */
  bool touched;
} candidate;

static btf_status split_once(btfi_lpca_model *m, candidate *c, uint32_t *members, double margin, bool *done) {
  uint32_t worst = UINT32_MAX, least = UINT32_MAX;
  *done = true;
  for (uint32_t k = 0; k < m->clusters; k++)
    if (!c[k].touched && (least == UINT32_MAX || c[k].loss < c[least].loss)) least = k;
  for (uint32_t k = 0; k < m->clusters; k++)
    if (!c[k].touched && k != least && (worst == UINT32_MAX || c[k].cost > c[worst].cost)) worst = k;
  if (worst == UINT32_MAX || c[least].loss + margin >= c[worst].cost) return BTF_OK;
  double before;
  uint64_t half;
  const uint64_t count = gather_union(m, worst, least, members, &before);
  if (count < 2) return BTF_OK;
  BTF_TRY(try_halves(m, worst, least, members, count, &half));
  const double after = m->cost[worst] + m->cost[least];
  c[worst].touched = true;
  *done = false;
  if (half == 0 || half == count || before - after <= c[least].loss + margin) return BTF_OK;
  c[least].touched = true;
  /* Members that move on invalidate what is known of where they go; empty clusters have none. */
  *done = m->start[least] > 0;
  for (uint64_t i = 0; i < m->count; i++) {
    if (m->label[i] != least || m->second[i] == worst) continue;
    m->label[i] = m->second[i];
  }
  for (uint64_t i = 0; i < count; i++) m->label[members[i]] = i < half ? worst : least;
  m->splits++;
  return BTF_OK;
}

btf_status btfi_lpca_split(btfi_lpca_model *m) {
  if (m->clusters < 2) return BTF_OK;
  candidate *c = m->host->alloc(m->ctx, m->clusters, sizeof *c);
  uint32_t *members = m->host->alloc(m->ctx, m->count, sizeof *members);
  btf_status status = c != NULL && members != NULL ? BTF_OK : BTF_E_NOMEM;
  if (status == BTF_OK) {
    double total = 0.0;
    uint32_t empty = 0;
    bool done = false;
    memset(c, 0, m->clusters * sizeof *c);
    memset(m->start, 0, ((size_t)m->clusters + 1) * sizeof *m->start);
    for (uint64_t i = 0; i < m->count; i++) {
      c[m->label[i]].cost += (double)m->error[i];
      c[m->label[i]].loss += (double)m->second_error[i] - (double)m->error[i];
      m->start[m->label[i]]++;
      total += (double)m->error[i];
    }
    for (uint32_t k = 0; k < m->clusters; k++) {
      c[k].touched = k < m->fixed;
      empty += !c[k].touched && m->start[k] == 0;
    }
    const uint32_t tries = empty + 1;
    for (uint32_t i = 0; i < tries && !done && status == BTF_OK; i++)
      status = split_once(m, c, members, 1e-4 * total / m->clusters, &done);
  }
  m->host->free(m->ctx, c);
  m->host->free(m->ctx, members);
  return status;
}
