/* SPDX-License-Identifier: MIT */
/* target.c: how many components each band gets: as few bytes as meet a target, or the best of given bytes. */
#include "laplacian.h"

#include <math.h>

enum { TRIES = 8 };

/* Squared length of the RGB change of a unit of each YCbCr channel. */
static const double rgb_gain[3] = {3.0, 1.772 * 1.772 + 0.344136 * 0.344136,
                                   1.402 * 1.402 + 0.714136 * 0.714136};

typedef struct measurement {
  const btfi_laplacian_fitting *fitting;
  double *error; /* of each pair */
} measurement;

static void add_components(const btfi_laplacian_fitting *f, uint32_t k, uint32_t c, uint64_t pair,
                           float *dst) {
  const btfi_laplacian_factors *factors = &f->factors[k][c];
  const uint64_t texels = (uint64_t)f->source.grid.width[k] * f->source.grid.height[k];
  const float mean = k + 1 == f->head.levels ? f->mean[3 * pair + c] : 0.0f;
  for (uint64_t i = 0; i < texels; i++) dst[i] = mean;
  for (uint32_t j = 0; j < f->head.count[k][c]; j++) {
    const float factor = factors->eigen[j * f->source.pairs + pair] * factors->scale[j];
    const float *weights = factors->weights + j * texels;
    for (uint64_t i = 0; i < texels; i++) dst[i] += factor * weights[i];
  }
}

static void measure_image(void *user, const btfi_laplacian_source *s, uint64_t pair, const float *rgb,
                          float *planes, float *scratch, uint32_t thread) {
  const measurement *m = user;
  const uint64_t texels = (uint64_t)s->grid.width[0] * s->grid.height[0],
                 floats = btfi_laplacian_pyramid_floats(s->pyramid);
  double error = 0.0;
  (void)thread;
  for (uint32_t c = 0; c < 3; c++) {
    float *channel = planes + c * floats;
    for (uint32_t k = 0; k < s->grid.levels; k++)
      add_components(m->fitting, k, c, pair, channel + btfi_laplacian_pyramid_offset(s->pyramid, k));
    btfi_laplacian_synthesise(s->pyramid, 0, channel, scratch);
  }
  for (uint64_t i = 0; i < texels; i++) {
    float decoded[3];
    btfi_laplacian_to_rgb(planes[i], planes[floats + i], planes[2 * floats + i], decoded);
    for (uint32_t c = 0; c < 3; c++) {
      const double rest = (double)decoded[c] - rgb[c * texels + i];
      error += rest * rest;
    }
  }
  m->error[pair] = error;
}

/* Error of level 0 by decoding every image. */
static btf_status measure(btfi_laplacian_fitting *f, double from, double to, double *squared_error) {
  measurement m = {f, f->host->alloc(f->ctx, f->source.pairs, sizeof *m.error)};
  if (m.error == NULL) return BTF_E_NOMEM;
  const btf_status status =
      btfi_laplacian_each_image(&f->source, f->job, from, to, "measuring", measure_image, &m);
  *squared_error = 0.0;
  for (uint64_t i = 0; status == BTF_OK && i < f->source.pairs; i++) *squared_error += m.error[i];
  f->host->free(f->ctx, m.error);
  return status;
}

/* What a squared error of a band is worth at level 0: each of its texels covers many. */
static double worth(const btfi_laplacian_fitting *f, uint32_t k, uint32_t c) {
  const btfi_laplacian_grid *grid = &f->source.grid;
  return rgb_gain[c] * ((double)grid->width[0] * grid->height[0]) /
         ((double)grid->width[k] * grid->height[k]);
}

static double band_cost(const btfi_laplacian_fitting *f, uint32_t k) {
  return (double)f->source.pairs + (double)f->source.grid.width[k] * f->source.grid.height[k];
}

/* The band whose next component takes most of the error for its bytes, and what it takes; 0 = none is left
 * among those that are not `closed`. */
static double best_component(const btfi_laplacian_fitting *f, bool closed[LAPLACIAN_MAX_LEVELS][3],
                             uint32_t *level, uint32_t *channel) {
  double best = 0.0, gain = 0.0;
  for (uint32_t k = 0; k < f->head.levels; k++)
    for (uint32_t c = 0; c < 3; c++) {
      const uint32_t next = f->head.count[k][c];
      if (closed[k][c] || next >= f->factors[k][c].rank) continue;
      const double less = worth(f, k, c) * f->factors[k][c].sigma[next] * f->factors[k][c].sigma[next];
      if (less / band_cost(f, k) <= best) continue;
      best = less / band_cost(f, k);
      gain = less;
      *level = k;
      *channel = c;
    }
  return gain;
}

/* Adds components by error per byte until the error, as if bands did not overlap, is at most `allowed`;
 * returns it. */
static double choose(btfi_laplacian_fitting *f, double allowed) {
  bool closed[LAPLACIAN_MAX_LEVELS][3] = {{false}};
  double error = 0.0;
  for (uint32_t k = 0; k < f->head.levels; k++)
    for (uint32_t c = 0; c < 3; c++) {
      f->head.count[k][c] = 0;
      error += worth(f, k, c) * f->head.residual[k][c];
      for (uint32_t j = 0; j < f->factors[k][c].rank; j++)
        error += worth(f, k, c) * f->factors[k][c].sigma[j] * f->factors[k][c].sigma[j];
    }
  while (error > allowed) {
    uint32_t level = 0, channel = 0;
    const double gain = best_component(f, closed, &level, &channel);
    if (gain == 0.0) break;
    f->head.count[level][channel]++;
    error -= gain;
  }
  return fmax(error, 0.0);
}

/* Bytes of the tables with the counts as they are. */
static uint64_t table_bytes(const btfi_laplacian_fitting *f) {
  const btfi_laplacian_head head = btfi_laplacian_stored_head(f);
  btfi_laplacian_layout layout;
  if (!btfi_laplacian_layout_of(&head, &f->source.grid, f->source.lights, f->source.views, &layout))
    return UINT64_MAX;
  uint64_t bytes = layout.eigen_bytes + 4 * (uint64_t)layout.first[head.levels];
  for (uint32_t k = 0; k < head.levels; k++) bytes += layout.weight_bytes[k];
  return bytes;
}

btf_status btfi_laplacian_spend_budget(btfi_laplacian_fitting *f, double from, double to) {
  const uint64_t budget = table_bytes(f);
  bool closed[LAPLACIAN_MAX_LEVELS][3] = {{false}};
  uint32_t fixed[LAPLACIAN_MAX_LEVELS][3], level = 0, channel = 0;
  double fixed_error;
  memcpy(fixed, f->head.count, sizeof fixed);
  BTF_TRY(measure(f, from, 0.5 * (from + to), &fixed_error));
  memset(f->head.count, 0, sizeof f->head.count);
  while (best_component(f, closed, &level, &channel) > 0.0) {
    f->head.count[level][channel]++;
    if (table_bytes(f) <= budget) continue;
    f->head.count[level][channel]--; /* and no more of that band: tables only grow */
    closed[level][channel] = true;
  }
  BTF_TRY(measure(f, 0.5 * (from + to), to, &f->head.squared_error));
  /* Bands overlap, which the choice does not know. */
  if (f->head.squared_error <= fixed_error) return BTF_OK;
  memcpy(f->head.count, fixed, sizeof fixed);
  f->head.squared_error = fixed_error;
  return BTF_OK;
}

static bool all_taken(const btfi_laplacian_fitting *f) {
  for (uint32_t k = 0; k < f->head.levels; k++)
    for (uint32_t c = 0; c < 3; c++)
      if (f->head.count[k][c] < f->factors[k][c].rank) return false;
  return true;
}

btf_status btfi_laplacian_meet_target(btfi_laplacian_fitting *f, double from, double to) {
  double allowed = f->target, best_cost = INFINITY, best_error = INFINITY;
  uint32_t best[LAPLACIAN_MAX_LEVELS][3];
  bool met = false;
  memcpy(best, f->head.count, sizeof best);
  for (int i = 0; i < TRIES; i++) {
    double error, cost = 0.0;
    const double predicted = choose(f, allowed);
    BTF_TRY(measure(f, from + (to - from) * i / TRIES, from + (to - from) * (i + 1) / TRIES, &error));
    for (uint32_t k = 0; k < f->head.levels; k++)
      for (uint32_t c = 0; c < 3; c++) cost += band_cost(f, k) * f->head.count[k][c];
    const bool meets = error <= f->target;
    if (meets ? !met || cost < best_cost : !met && error < best_error) {
      memcpy(best, f->head.count, sizeof best);
      best_cost = cost;
      best_error = error;
    }
    met = met || meets;
    if (!meets && all_taken(f)) break;
    /* Close enough that another component would hardly fit, or nothing to correct by. */
    if (meets && (error >= 0.97 * f->target || error <= 0.0 || cost == 0.0)) break;
    if (met && !meets) { /* between the two */
      allowed = 0.5 * (allowed + fmin(allowed, predicted * f->target / error));
      continue;
    }
    allowed = fmin(error > 0.0 ? predicted * f->target / error : allowed, meets ? INFINITY : 0.98 * allowed);
  }
  memcpy(f->head.count, best, sizeof best);
  f->head.squared_error = best_error;
  if (!met) {
    const double samples = 3.0 * (double)f->source.pairs * f->source.grid.width[0] * f->source.grid.height[0];
    uint32_t most = 0;
    for (uint32_t k = 0; k < f->head.levels; k++)
      for (uint32_t c = 0; c < 3; c++) most = f->head.count[k][c] > most ? f->head.count[k][c] : most;
    btf_warn_missed(f->host, f->ctx, "laplacian", most, "components of a channel and level", best_error,
                    f->target, samples, f->target_psnr);
  }
  return BTF_OK;
}
