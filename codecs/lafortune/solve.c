/* SPDX-License-Identifier: MIT */
/* solve.c: the fit of one group of channels of one texel, and what is told of it. */
#include "solve.h"

#include <math.h>
#include <string.h>

/* No lobe that is allowed is lower at its peak. */
#define LOWEST_HEIGHT 1e-7

/* ---- results ---- */

/* The value of a lobe as stored at its peak, by which fitted albedos are divided. */
static double height_of(const btfi_lafortune_lobe *lobe) {
  if (lobe->kind == LAF_WARD)
    return exp((double)lobe->peak) * (double)LAF_WARD_NORM *
           sqrt((double)lobe->coefficient[0] * (double)lobe->coefficient[1]);
  const double height = pow((double)lobe->peak, (double)lobe->exponent);
  return lobe->kind == LAF_LEWIS ? height * ((double)lobe->exponent + 2.0) * (double)LAF_LEWIS_NORM : height;
}

static void shape_of(const btfi_lafortune_lobe *lobe, float *shape) {
  const uint32_t free_terms = btfi_lafortune_free_terms(lobe->kind);
  if (lobe->kind == LAF_WARD) {
    for (uint32_t i = 0; i < 2; i++) shape[i] = 1.0f / sqrtf(-lobe->coefficient[i]);
    return;
  }
  for (uint32_t i = 0; i < free_terms; i++) shape[i] = lobe->coefficient[i];
  shape[free_terms] = lobe->exponent;
}

/* What a lobe adds to the norm of the model. */
static double carried(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p, uint32_t lobe) {
  const uint32_t column = btfi_lafortune_lobe_column(s, lobe);
  double sum = 0.0;
  for (uint32_t c = 0; c < s->channels; c++) sum += p->albedo[1 + lobe][c];
  return sum * sqrt(p->gram[column * s->columns + column]);
}

static void give_albedos(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p,
                         const uint32_t *order, btfi_lafortune_fitted *out) {
  for (uint32_t c = 0; c < s->channels; c++) {
    out->albedo[0][c] = p->albedo[0][c] * s->unit;
    for (uint32_t j = 0; j < s->lobes; j++) {
      const double albedo = p->albedo[1 + order[j]][c], height = height_of(&p->lobe[order[j]]);
      out->albedo[1 + j][c] = height > LOWEST_HEIGHT ? albedo / height * s->unit : 0.0;
    }
  }
}

void btfi_lafortune_fit_group(btfi_lafortune_scratch *s, const btfi_lafortune_settings *settings,
                              const float *values, uint32_t stride, uint32_t channels,
                              btfi_lafortune_fitted *out) {
  btfi_lafortune_start start[LAF_MAX_STARTS];
  btfi_lafortune_point *best = &s->points[2];
  memset(out, 0, sizeof *out);
  btfi_lafortune_take_data(s, values, stride, channels);
  const uint32_t starts = btfi_lafortune_choose_starts(
      s, settings->starts < LAF_MAX_STARTS ? settings->starts : LAF_MAX_STARTS, start);
  best->cost = INFINITY;
  for (uint32_t i = 0; i < starts; i++) {
    for (uint32_t j = 0; j < s->lobes; j++)
      btfi_lafortune_lobe_of(s->shared->kind, s->shared->candidate[start[i].candidate[j]],
                             &s->points[0].lobe[j]);
    out->iterations += btfi_lafortune_descend(s, settings, 2 * i, s->shared->kind == LAF_FULL);
    if (s->shared->kind == LAF_FULL && s->points[0].cost < INFINITY)
      out->iterations += btfi_lafortune_descend(s, settings, 2 * i + 1, false);
    if (s->points[0].cost < best->cost) memcpy(best, &s->points[0], sizeof *best);
  }
  if (best->cost == INFINITY) { /* no lobe of this kind shows: its albedo is 0 */
    for (uint32_t j = 0; j < s->lobes; j++)
      btfi_lafortune_lobe_of(s->shared->kind, s->shared->candidate[0], &best->lobe[j]);
    (void)btfi_lafortune_evaluate(s, best, true);
  }
  uint32_t order[LAF_MAX_LOBES] = {0, 1, 2, 3};
  for (uint32_t i = 1; i < s->lobes; i++)
    for (uint32_t j = i; j > 0 && carried(s, best, order[j]) > carried(s, best, order[j - 1]); j--) {
      const uint32_t swap = order[j];
      order[j] = order[j - 1];
      order[j - 1] = swap;
    }
  out->cost = best->cost * (s->unit * s->unit);
  for (uint32_t j = 0; j < s->lobes; j++) shape_of(&best->lobe[order[j]], out->shape[j]);
  give_albedos(s, best, order, out);
}

/* ---- albedos of given lobes, and the gradient ---- */

static void evaluate_shapes(btfi_lafortune_scratch *s, const float (*shape)[LAF_MAX_SHAPE]) {
  for (uint32_t j = 0; j < s->lobes; j++)
    btfi_lafortune_lobe_of(s->shared->kind, shape[j], &s->points[0].lobe[j]);
  /* Rounding may have pushed a lobe over the edge of what may be. */
  (void)btfi_lafortune_evaluate(s, &s->points[0], true);
}

/* Errors sample by sample, in double. */
static void measure_point(btfi_lafortune_scratch *s, const btfi_lafortune_point *p,
                          btfi_lafortune_fitted *out) {
  const btfi_lafortune_shared *shared = s->shared;
  out->cost = out->squared_error = out->energy = 0.0;
  for (uint32_t first = 0; first < shared->samples; first += LAF_CHUNK) {
    const uint32_t padded = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
    const uint32_t n = shared->samples - first < padded ? shared->samples - first : padded;
    btfi_lafortune_make_chunk(s, p, first, padded);
    for (uint32_t c = 0; c < s->channels; c++) {
      const float *data = s->data + (size_t)c * shared->padded + first;
      for (uint32_t i = 0; i < n; i++) {
        double left = (double)data[i];
        for (uint32_t j = 0; j <= s->lobes; j++)
          left -= p->albedo[j][c] * (double)s->chunk[(size_t)btfi_lafortune_albedo_column(s, j) * LAF_LD + i];
        const double root = (double)s->root[first + i],
                     value = (double)s->values[(size_t)(first + i) * s->stride + c] / s->unit;
        out->cost += left * left;
        out->squared_error += left * left / (root * root);
        out->energy += value * value;
      }
    }
  }
  out->cost *= s->unit * s->unit;
  out->squared_error *= s->unit * s->unit;
  out->energy *= s->unit * s->unit;
}

void btfi_lafortune_fit_albedos(btfi_lafortune_scratch *s, btfi_lafortune_fitted *io) {
  const uint32_t order[LAF_MAX_LOBES] = {0, 1, 2, 3};
  btfi_lafortune_point *p = &s->points[0];
  evaluate_shapes(s, (const float(*)[LAF_MAX_SHAPE])io->shape);
  give_albedos(s, p, order, io);
}

void btfi_lafortune_measure(btfi_lafortune_scratch *s, btfi_lafortune_fitted *io) {
  btfi_lafortune_point *p = &s->points[0];
  for (uint32_t c = 0; c < s->channels; c++) {
    p->albedo[0][c] = io->albedo[0][c] / s->unit;
    for (uint32_t j = 0; j < s->lobes; j++)
      p->albedo[1 + j][c] = io->albedo[1 + j][c] * height_of(&p->lobe[j]) / s->unit;
  }
  measure_point(s, p, io);
}

double btfi_lafortune_cost_gradient(btfi_lafortune_scratch *s, const float *values, uint32_t stride,
                                    uint32_t channels, const float (*shape)[LAF_MAX_SHAPE],
                                    double *gradient) {
  btfi_lafortune_equations e;
  btfi_lafortune_fitted fitted;
  btfi_lafortune_take_data(s, values, stride, channels);
  evaluate_shapes(s, shape);
  btfi_lafortune_make_equations(s, &s->points[0], &e);
  for (uint32_t v = 0; v < e.n; v++)
    gradient[v] = -2.0 * (s->unit * s->unit) * e.slope[v] / btfi_lafortune_unit_of(s, &s->points[0], v);
  measure_point(s, &s->points[0], &fitted);
  return fitted.cost;
}
