/* SPDX-License-Identifier: MIT */
/* refine.c: bases refined on the data themselves. What of a cluster's ABRDFs lies outside of the common
 * subspace is out of reach for bases inside of it. With labels as they are, each pass over the data replaces
 * weights by projections (the first pass has them) and then bases by the least squares solution for these
 * weights. Neither raises the error. */
#include "lpca.h"

#include <math.h>
#include <string.h>

/* Directions whose share of their cluster's variance is less are rounding error. */
#define NEGLIGIBLE 1e-10
/* Weights that vary by less than a thousandth of their own size belong to members that are alike: sums of
 * products with them, in float, hold a rounding of 6e-8 of the ABRDFs, which is then divided by that
 * thousandth and less. */
#define LEAST_VARIANCE 1e-6

typedef struct refinement {
  btfi_lpca_writing *w;
  const btf_dataset *ds;
  const btf_host *host;
  btf_context *ctx;
  uint64_t rows;             /* of an ABRDF */
  uint32_t columns;          /* the mean and the components */
  uint32_t width, height;    /* of a block of texels */
  float *sums;               /* of each cluster `columns` ABRDFs: the data times 1 and times each weight */
  double *moments;           /* of each cluster columns x columns */
  float *block, *gathered;   /* ABRDFs of texels, one a row */
  float *factors, *products; /* 1 and the weights of gathered texels */
  uint32_t *member;          /* texels of the block by cluster */
  float *turn;               /* columns x columns */
  double *a, *b, *values;
  double captured; /* squared norm of the model */
} refinement;

/* ---- one pass ---- */

static btf_status read_block(const refinement *r, const btf_block *block) {
  const btfi_lpca_layout *l = &r->w->layout;
  const ptrdiff_t value = sizeof(float), light = value * (ptrdiff_t)l->channels,
                  view = light * (ptrdiff_t)l->lights;
  const ptrdiff_t texel = value * (ptrdiff_t)r->rows;
  const btf_strides strides = {view, light, texel * (ptrdiff_t)block->width, texel, value};
  return r->host->dataset_read(r->ds, block, r->block, &strides);
}

/* Some texels of cluster k, gathered: `first` is the texel of the block's corner. */
static btf_status take_members(refinement *r, uint32_t k, const uint32_t *texel, uint32_t count,
                               bool project) {
  const uint32_t columns = r->columns, components = columns - 1;
  const float *basis = r->w->refined + (uint64_t)k * columns * r->rows;
  float *weights = r->w->level[0].weights;
  double *moments = r->moments + (size_t)k * columns * columns;
  if (project)
    BTF_TRY(r->host->gemm(r->ctx, BTF_TRANSPOSE_B, count, columns, r->rows, 1.0f, r->gathered, r->rows, basis,
                          r->rows, 0.0f, r->products, columns));
  for (uint32_t i = 0; i < count; i++) {
    float *factor = r->factors + (size_t)i * columns, *weight = weights + (size_t)texel[i] * components;
    factor[0] = 1.0f;
    for (uint32_t j = 0; j < components; j++) {
      if (project)
        weight[j] = (float)((double)r->products[(size_t)i * columns + j + 1] -
                            r->w->mean_dot[(size_t)k * columns + j + 1]);
      factor[j + 1] = weight[j];
    }
    for (uint32_t p = 0; p < columns; p++)
      for (uint32_t q = 0; q < columns; q++)
        moments[p * columns + q] += (double)factor[p] * (double)factor[q];
  }
  return r->host->gemm(r->ctx, BTF_TRANSPOSE_A, columns, r->rows, count, 1.0f, r->factors, columns,
                       r->gathered, r->rows, 1.0f, r->sums + (uint64_t)k * columns * r->rows, r->rows);
}

static btf_status take_block(refinement *r, const btf_block *block, bool project) {
  const btfi_lpca_layout *l = &r->w->layout;
  const uint32_t *label = r->w->level[0].label;
  const uint32_t count = block->width * block->height;
  BTF_TRY(read_block(r, block));
  for (uint32_t k = 0; k < l->clusters; k++) {
    uint32_t many = 0;
    for (uint32_t i = 0; i < count; i++) {
      const uint64_t texel =
          (uint64_t)(block->y0 + i / block->width) * l->width + block->x0 + i % block->width;
      if (label[texel] != k) continue;
      memcpy(r->gathered + many * r->rows, r->block + i * r->rows, r->rows * sizeof *r->gathered);
      r->member[many++] = (uint32_t)texel;
    }
    if (many > 0) BTF_TRY(take_members(r, k, r->member, many, project));
  }
  return BTF_OK;
}

/* ---- bases from sums ---- */

/* g = A A^T of the rows 1 .. columns - 1 of a cluster's sums, each divided by d. */
static btf_status products_of_sums(refinement *r, const float *sums, const double *d, double *g) {
  const uint32_t n = r->columns - 1;
  BTF_TRY(r->host->gemm(r->ctx, BTF_TRANSPOSE_B, n, n, r->rows, 1.0f, sums + r->rows, r->rows, sums + r->rows,
                        r->rows, 0.0f, r->turn, n));
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < n; j++)
      g[i * n + j] = d[i] > 0.0 && d[j] > 0.0 ? (double)r->turn[i * n + j] / (d[i] * d[j]) : 0.0;
  return BTF_OK;
}

/* a := a^-1/2 for a correlation matrix; directions without variance become 0. */
static btf_status inverse_root(refinement *r, double *a) {
  const uint32_t n = r->columns - 1;
  double *vector = r->b;
  memcpy(vector, a, (size_t)n * n * sizeof *a);
  BTF_TRY(r->host->symmetric_eigen(r->ctx, n, vector, r->values));
  memset(a, 0, (size_t)n * n * sizeof *a);
  for (uint32_t e = 0; e < n; e++) {
    if (r->values[e] <= 1e-6) continue;
    const double scale = 1.0 / sqrt(r->values[e]);
    for (uint32_t i = 0; i < n; i++)
      for (uint32_t j = 0; j < n; j++) a[i * n + j] += scale * vector[e * n + i] * vector[e * n + j];
  }
  return BTF_OK;
}

/* With weights W of no mean, W^T W = D C D (D diagonal, C correlations) and A = W^T Y, the least squares
 * basis is (W^T W)^-1 A. From the eigenvectors Z of C^-1/2 D^-1 A A^T D^-1 C^-1/2 = Z L Z^T the orthonormal
 * basis L^-1/2 Z^T C^-1/2 D^-1 A and the weights W D^-1 C^-1/2 Z L^1/2 make the same products. */
static btf_status solve_cluster(refinement *r, uint32_t k) {
  const btfi_lpca_model *m = r->w->model;
  const uint32_t columns = r->columns, n = columns - 1;
  float *sums = r->sums + (uint64_t)k * columns * r->rows,
        *basis = r->w->refined + (uint64_t)k * columns * r->rows;
  const double *moments = r->moments + (size_t)k * columns * columns;
  const double count = moments[0];
  double average[LPCA_MAX_COMPONENTS], deviation[LPCA_MAX_COMPONENTS];
  double *root = r->a, *z = r->b, *turn = r->a + (size_t)n * n;
  double mean_square = 0.0;
  for (uint64_t i = 0; i < r->rows; i++) {
    basis[i] = (float)((double)sums[i] / count);
    mean_square += (double)basis[i] * (double)basis[i];
  }
  r->captured += count * mean_square;
  for (uint32_t j = 0; j < n; j++) {
    average[j] = moments[j + 1] / count;
    const double variance = moments[(j + 1) * columns + j + 1] - count * average[j] * average[j];
    deviation[j] = variance > LEAST_VARIANCE * moments[(j + 1) * columns + j + 1] ? sqrt(variance) : 0.0;
    float *row = sums + (j + 1) * r->rows;
    for (uint64_t i = 0; i < r->rows; i++) row[i] -= (float)(average[j] * (double)sums[i]);
  }
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < n; j++) {
      const double covariance = moments[(i + 1) * columns + j + 1] - count * average[i] * average[j];
      const double scale = deviation[i] * deviation[j];
      root[i * n + j] = i == j ? 1.0 : scale > 0.0 ? covariance / scale : 0.0;
    }
  BTF_TRY(inverse_root(r, root));
  BTF_TRY(products_of_sums(r, sums, deviation, turn));
  /* z = root turn root, then its eigenvectors. */
  double *half = turn + (size_t)n * n;
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < n; j++) {
      half[i * n + j] = 0.0;
      for (uint32_t e = 0; e < n; e++) half[i * n + j] += root[i * n + e] * turn[e * n + j];
    }
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < n; j++) {
      z[i * n + j] = 0.0;
      for (uint32_t e = 0; e < n; e++) z[i * n + j] += half[i * n + e] * root[e * n + j];
    }
  BTF_TRY(r->host->symmetric_eigen(r->ctx, n, z, r->values));
  /* turn = Z^T root D^-1 */
  for (uint32_t i = 0; i < n; i++) {
    const double value = r->values[i];
    const bool used = value > NEGLIGIBLE * r->values[0] && value > 0.0;
    if (used) r->captured += value;
    for (uint32_t j = 0; j < n; j++) {
      double sum = 0.0;
      for (uint32_t e = 0; e < n; e++) sum += z[i * n + e] * root[e * n + j];
      turn[i * n + j] = used && deviation[j] > 0.0 ? sum / deviation[j] : 0.0;
      r->turn[i * n + j] = used ? (float)(turn[i * n + j] / sqrt(value)) : 0.0f;
    }
  }
  BTF_TRY(r->host->gemm(r->ctx, 0, n, r->rows, n, 1.0f, r->turn, n, sums + r->rows, r->rows, 0.0f,
                        basis + r->rows, r->rows));
  float *weights = r->w->level[0].weights;
  for (uint64_t i = m->start[k]; i < m->start[k + 1]; i++) {
    float *weight = weights + (size_t)m->order[i] * n;
    double turned[LPCA_MAX_COMPONENTS];
    for (uint32_t j = 0; j < n; j++) {
      turned[j] = 0.0;
      for (uint32_t e = 0; e < n; e++) turned[j] += ((double)weight[e] - average[e]) * turn[j * n + e];
    }
    for (uint32_t j = 0; j < n; j++) weight[j] = (float)(turned[j] * sqrt(fmax(0.0, r->values[j])));
  }
  double *mean_dot = r->w->mean_dot + (size_t)k * columns;
  for (uint32_t j = 0; j < columns; j++) {
    const float *row = basis + j * r->rows;
    mean_dot[j] = 0.0;
    for (uint64_t i = 0; i < r->rows; i++) mean_dot[j] += (double)basis[i] * (double)row[i];
  }
  return BTF_OK;
}

/* ---- all of it ---- */

static btf_status lift_all(refinement *r) {
  const btfi_lpca_model *m = r->w->model;
  for (uint32_t k = 0; k < m->clusters; k++) {
    float *basis = r->w->center_basis;
    memcpy(basis, m->basis + (size_t)k * r->columns * m->size, (size_t)r->columns * m->size * sizeof *basis);
    for (uint32_t d = 0; d < m->size; d++) basis[d] += r->w->center[d];
    BTF_TRY(r->host->gemm(r->ctx, BTF_TRANSPOSE_B, r->columns, r->rows, m->size, 1.0f, basis, m->size,
                          r->w->vectors, m->size, 0.0f, r->w->refined + (uint64_t)k * r->columns * r->rows,
                          r->rows));
  }
  return BTF_OK;
}

/* The model as points see it: what of the bases lies in the subspace, with the inner products that they have
 * outside of it as well. */
static btf_status update_model(refinement *r, btfi_lpca_model *m) {
  for (uint32_t k = 0; k < m->clusters; k++) {
    float *basis = m->basis + (size_t)k * r->columns * m->size;
    double *mean_dot = m->mean_dot + (size_t)k * r->columns;
    BTF_TRY(r->host->gemm(r->ctx, 0, r->columns, m->size, r->rows, 1.0f,
                          r->w->refined + (uint64_t)k * r->columns * r->rows, r->rows, r->w->vectors, m->size,
                          0.0f, basis, m->size));
    for (uint32_t j = 0; j < r->columns; j++) {
      double along = 0.0;
      for (uint32_t d = 0; d < m->size; d++)
        along += (double)basis[(size_t)j * m->size + d] * (double)r->w->center[d];
      mean_dot[j] = r->w->mean_dot[(size_t)k * r->columns + j] - along * (j == 0 ? 2.0 : 1.0);
    }
    for (uint32_t d = 0; d < m->size; d++) {
      mean_dot[0] += (double)r->w->center[d] * (double)r->w->center[d];
      basis[d] -= r->w->center[d];
    }
  }
  return BTF_OK;
}

static btf_status passes(refinement *r, uint32_t count, double from, double to) {
  const btfi_lpca_layout *l = &r->w->layout;
  const uint64_t sum_values = (uint64_t)l->clusters * r->columns * r->rows;
  BTF_TRY(lift_all(r));
  for (uint32_t pass = 0; pass < count; pass++) {
    memset(r->sums, 0, sum_values * sizeof *r->sums);
    memset(r->moments, 0, (size_t)l->clusters * r->columns * r->columns * sizeof *r->moments);
    for (uint32_t y = 0; y < l->height; y += r->height)
      for (uint32_t x = 0; x < l->width; x += r->width) {
        const btf_block block = {0,
                                 l->views,
                                 0,
                                 l->lights,
                                 x,
                                 y,
                                 l->width - x < r->width ? l->width - x : r->width,
                                 l->height - y < r->height ? l->height - y : r->height};
        const double done = ((double)y + (double)x / l->width) / l->height;
        BTF_TRY(r->host->progress(r->w->model->job, from + (to - from) * ((double)pass + done) / count,
                                  "refining"));
        BTF_TRY(take_block(r, &block, pass > 0));
      }
    r->captured = 0.0;
    for (uint32_t k = 0; k < l->clusters; k++) BTF_TRY(solve_cluster(r, k));
  }
  r->w->head.squared_error = fmax(0.0, r->w->head.energy - r->captured);
  return BTF_OK;
}

btf_status btfi_lpca_refine(btfi_lpca_writing *w, btfi_lpca_model *m, const btf_dataset *ds, uint32_t count,
                            uint64_t room, double from, double to) {
  const btf_host *host = w->host;
  const btfi_lpca_layout *l = &w->layout;
  refinement r = {.w = w, .ds = ds, .host = host, .ctx = w->ctx, .columns = l->components + 1};
  r.rows = (uint64_t)l->views * l->lights * l->channels;
  const uint64_t tables = 2 * sizeof(float) * r.rows * r.columns * l->clusters;
  const uint64_t texel = 2 * sizeof(float) * (r.rows + r.columns) + sizeof(uint32_t);
  if (count == 0 || tables + texel > room) {
    if (count > 0)
      host->log(w->ctx, BTF_LOG_WARNING, "lpca: too little memory to refine the clusters on the data");
    return BTF_OK;
  }
  uint64_t texels = (room - tables) / texel;
  const uint64_t most = ((uint64_t)64 << 20) / texel + 1;
  if (texels > most) texels = most;
  r.width = texels < l->width ? (uint32_t)texels : l->width;
  r.height = texels / r.width < l->height ? (uint32_t)(texels / r.width) : l->height;
  texels = (uint64_t)r.width * r.height;
  const uint64_t square = (uint64_t)r.columns * r.columns;
  w->refined = host->alloc(w->ctx, r.rows * r.columns * l->clusters, sizeof *w->refined);
  w->mean_dot = host->alloc(w->ctx, (uint64_t)l->clusters * r.columns, sizeof *w->mean_dot);
  w->center_basis = host->alloc(w->ctx, (uint64_t)r.columns * m->size, sizeof *w->center_basis);
  r.sums = host->alloc(w->ctx, r.rows * r.columns * l->clusters, sizeof *r.sums);
  r.moments = host->alloc(w->ctx, square * l->clusters, sizeof *r.moments);
  r.block = host->alloc(w->ctx, texels * r.rows, sizeof *r.block);
  r.gathered = host->alloc(w->ctx, texels * r.rows, sizeof *r.gathered);
  r.factors = host->alloc(w->ctx, texels * r.columns, sizeof *r.factors);
  r.products = host->alloc(w->ctx, texels * r.columns, sizeof *r.products);
  r.member = host->alloc(w->ctx, texels, sizeof *r.member);
  r.turn = host->alloc(w->ctx, square, sizeof *r.turn);
  r.a = host->alloc(w->ctx, 3 * square, sizeof *r.a);
  r.b = host->alloc(w->ctx, square, sizeof *r.b);
  r.values = host->alloc(w->ctx, r.columns, sizeof *r.values);
  btf_status status = BTF_E_NOMEM;
  if (w->refined != NULL && w->mean_dot != NULL && w->center_basis != NULL && r.sums != NULL &&
      r.moments != NULL && r.block != NULL && r.gathered != NULL && r.factors != NULL && r.products != NULL &&
      r.member != NULL && r.turn != NULL && r.a != NULL && r.b != NULL && r.values != NULL)
    status = passes(&r, count, from, to);
  if (status == BTF_OK) status = update_model(&r, m);
  w->refined_clusters = l->clusters;
  void *const rooms[] = {w->center_basis, w->mean_dot, r.sums, r.moments, r.block, r.gathered, r.factors,
                         r.products,      r.member,    r.turn, r.a,       r.b,     r.values};
  for (size_t i = 0; i < sizeof rooms / sizeof *rooms; i++) host->free(w->ctx, rooms[i]);
  w->center_basis = NULL;
  w->mean_dot = NULL;
  return status;
}
