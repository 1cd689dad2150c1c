/* SPDX-License-Identifier: MIT */
/* levels.c: levels of detail. A texel of a coarser level is an average of ABRDFs. One over several clusters
 * lies in none of their subspaces, so that some clusters are kept for the coarser levels alone where they
 * need them. */
#include "lpca.h"

#include <math.h>
#include <string.h>

#include <btf/btf_sampling.h>

/* Of the clusters, at most this part is taken from the finest level. */
enum { SHARE = 8, ROUNDS = 20, MOST_STARTS = LPCA_MAX_CLUSTERS + LPCA_MAX_CLUSTERS / SHARE + 1 };
#define LEAST_GAIN 1e-2
/* Of the finest level's clusters after some are given up: finer than at first, which makes up for most of the
 * loss. */
#define LEAST_GAIN_AFTER 1e-4
/* What a gain of the coarser levels, on the average over them, counts for against a loss of the finest. */
#define WORTH 0.25
/* A cluster that lowers the errors by less than this share is not worth its table. */
#define LEAST_USE 0.1
/* Errors below this share of the mean square of the points are float rounding. */
#define ROUNDING 1e-7

static uint64_t level_texels(uint32_t width, uint32_t height, uint32_t level) {
  return (uint64_t)btf_sampling_level_size(width, level) * btf_sampling_level_size(height, level);
}

uint64_t btfi_lpca_coarse_texels(uint32_t width, uint32_t height, uint32_t levels) {
  uint64_t count = 0;
  for (uint32_t level = 1; level < levels; level++) count += level_texels(width, height, level);
  return count;
}

uint64_t btfi_lpca_coarse_bytes(uint32_t width, uint32_t height, uint32_t levels, uint32_t size) {
  const uint64_t count = btfi_lpca_coarse_texels(width, height, levels);
  return count * (size * sizeof(float) + sizeof(uint32_t)) + MOST_STARTS * sizeof(uint64_t);
}

uint32_t btfi_lpca_coarse_most(uint32_t clusters) {
  return clusters < 2 ? 0 : clusters < SHARE ? 1 : clusters / SHARE;
}

btf_status btfi_lpca_coarse_make(btfi_lpca_coarse *c, const btfi_lpca_model *m, uint32_t width,
                                 uint32_t height, uint32_t levels) {
  c->width = width;
  c->height = height;
  c->levels = levels;
  c->count = btfi_lpca_coarse_texels(width, height, levels);
  if (c->count == 0) return BTF_OK;
  c->points = m->host->alloc(m->ctx, c->count, m->size * sizeof *c->points);
  c->label = m->host->alloc(m->ctx, c->count, sizeof *c->label);
  c->start = m->host->alloc(m->ctx, MOST_STARTS, sizeof *c->start);
  if (c->points == NULL || c->label == NULL || c->start == NULL) return BTF_E_NOMEM;
  float *points = c->points;
  for (uint32_t level = 1; level < levels; level++) {
    BTF_TRY(m->host->mip_filter(m->ctx, m->points, m->size, width, height, m->size, level, points, m->size));
    points += level_texels(width, height, level) * m->size;
  }
  return BTF_OK;
}

void btfi_lpca_coarse_free(btfi_lpca_coarse *c, const btf_host *host, btf_context *ctx) {
  host->free(ctx, c->points);
  host->free(ctx, c->label);
  host->free(ctx, c->start);
}

/* The model with the points of the coarser levels, which leaves the clusters of the finest as they are. */
static btfi_lpca_model view_of(const btfi_lpca_coarse *c, const btfi_lpca_model *m) {
  btfi_lpca_model view = *m;
  view.points = c->points;
  view.count = c->count;
  view.label = c->label;
  view.start = c->start;
  view.fixed = m->clusters;
  return view;
}

/* One more cluster for the coarser levels. The first one starts with all of their texels, others with a half
 * of the one that is worst. */
static btf_status add_cluster(btfi_lpca_model *view, double at) {
  if (view->clusters == view->fixed)
    for (uint64_t i = 0; i < view->count; i++) view->label[i] = view->fixed;
  view->clusters++;
  BTF_TRY(btfi_lpca_iterate(view, ROUNDS, LEAST_GAIN, NULL, NULL, at, at));
  return btfi_lpca_assign(view, view->points, view->count, true, view->label, view->error, view->second,
                          view->second_error);
}

/* Mean squared errors of the levels, as assigned: the mean of these and the worst. */
static double level_errors(const btfi_lpca_coarse *c, const btfi_lpca_model *view, double *worst) {
  const float *error = view->error;
  double mean = 0.0;
  *worst = 0.0;
  for (uint32_t level = 1; level < c->levels; level++) {
    const uint64_t texels = level_texels(c->width, c->height, level);
    double sum = 0.0;
    for (uint64_t i = 0; i < texels; i++) sum += (double)error[i];
    error += texels;
    mean += sum / (double)texels / (c->levels - 1);
    *worst = fmax(*worst, sum / (double)texels);
  }
  return mean;
}

/* What the finest level would lose with each cluster, as mean squared error. */
static btf_status find_losses(btfi_lpca_model *m, double *losses) {
  memset(losses, 0, m->clusters * sizeof *losses);
  BTF_TRY(btfi_lpca_assign(m, m->points, m->count, true, m->label, m->error, m->second, m->second_error));
  for (uint64_t i = 0; i < m->count; i++)
    losses[m->label[i]] += ((double)m->second_error[i] - (double)m->error[i]) / (double)m->count;
  return BTF_OK;
}

static uint32_t least_of(const double *losses, uint32_t count) {
  uint32_t least = 0;
  for (uint32_t k = 1; k < count; k++)
    if (losses[k] < losses[least]) least = k;
  return least;
}

/* Texels of a cluster that is given up go to their second best or, if that is gone as well, wherever the next
 * assignment sends them; the last cluster gets the place. */
static void give_up(btfi_lpca_model *m, uint32_t k) {
  const uint32_t last = --m->clusters;
  for (uint64_t i = 0; i < m->count; i++) {
    if (m->label[i] == k) m->label[i] = m->second[i] == UINT32_MAX ? 0 : m->second[i];
    if (m->label[i] == last) m->label[i] = k < last ? k : 0;
    m->second[i] = m->second[i] == k ? UINT32_MAX : m->second[i] == last ? k : m->second[i];
  }
}

static btf_status choose(btfi_lpca_coarse *c, btfi_lpca_model *m, uint32_t spare, uint32_t iterations,
                         double *losses, double at) {
  const uint32_t taken = btfi_lpca_coarse_most(m->clusters + spare), most = spare > taken ? spare : taken;
  btfi_lpca_model view = view_of(c, m);
  double square = 0.0, finest = 0.0, worst;
  BTF_TRY(find_losses(m, losses));
  for (uint64_t i = 0; i < m->count; i++) finest += (double)m->error[i] / (double)m->count;
  for (uint64_t i = 0; i < m->count * m->size; i++)
    square += (double)m->points[i] * (double)m->points[i] / (double)m->count;
  BTF_TRY(btfi_lpca_assign(&view, c->points, c->count, false, c->label, view.error, NULL, NULL));
  double mean = level_errors(c, &view, &worst);
  while (c->clusters < most && worst > finest + ROUNDING * square) {
    const double before = mean;
    BTF_TRY(add_cluster(&view, at));
    mean = level_errors(c, &view, &worst);
    if (before - mean < LEAST_USE * before) break;
    if (c->clusters >= spare) {
      const uint32_t least = least_of(losses, m->clusters);
      if (m->clusters < 2 || WORTH * (before - mean) <= losses[least]) break;
      losses[least] = INFINITY;
    }
    c->clusters++;
    for (uint32_t k = view.fixed; k < view.clusters; k++)
      for (uint32_t j = 0; j < m->components; j++)
        if (view.values[(size_t)k * LPCA_MAX_COMPONENTS + j] > ROUNDING * square && j >= c->components)
          c->components = j + 1;
  }
  if (c->clusters <= spare) return btfi_lpca_refit(m);
  /* The view has the model's room for errors and second bests. */
  BTF_TRY(btfi_lpca_assign(m, m->points, m->count, true, m->label, m->error, m->second, m->second_error));
  for (uint32_t k = m->clusters; k-- > 0;)
    if (isinf(losses[k])) give_up(m, k);
  return btfi_lpca_iterate(m, iterations, LEAST_GAIN_AFTER, NULL, NULL, at, at);
}

btf_status btfi_lpca_coarse_choose(btfi_lpca_coarse *c, btfi_lpca_model *m, uint32_t spare,
                                   uint32_t iterations, double at) {
  c->clusters = c->components = 0;
  if (c->count == 0 || m->clusters < 2) return BTF_OK;
  double *losses = m->host->alloc(m->ctx, m->clusters, sizeof *losses);
  if (losses == NULL) return BTF_E_NOMEM;
  const btf_status status = choose(c, m, spare, iterations, losses, at);
  m->host->free(m->ctx, losses);
  return status;
}

btf_status btfi_lpca_coarse_fit(btfi_lpca_coarse *c, btfi_lpca_model *m, double at) {
  if (c->count == 0) return BTF_OK;
  btfi_lpca_model view = view_of(c, m);
  const size_t rows = m->components + 1u;
  for (uint32_t k = 0; k < c->clusters; k++) BTF_TRY(add_cluster(&view, at));
  /* Those that stayed empty make room. */
  uint32_t used = m->clusters;
  for (uint32_t k = m->clusters; k < view.clusters; k++) {
    if (view.start[k + 1] == view.start[k]) continue;
    memmove(m->basis + used * rows * m->size, m->basis + k * rows * m->size,
            rows * m->size * sizeof *m->basis);
    memmove(m->mean_dot + used * rows, m->mean_dot + k * rows, rows * sizeof *m->mean_dot);
    used++;
  }
  c->clusters = used - m->clusters;
  for (; m->clusters < used; m->clusters++) m->start[m->clusters + 1] = m->count;
  view.clusters = used;
  return btfi_lpca_assign(&view, c->points, c->count, false, c->label, view.error, NULL, NULL);
}
