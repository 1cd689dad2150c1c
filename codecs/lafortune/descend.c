/* SPDX-License-Identifier: MIT */
/* descend.c: Levenberg and Marquardt's method for the shapes of the lobes. */
#include "solve.h"

#include <math.h>
#include <string.h>

#define FIRST_DAMPING 1e-2
#define LEAST_DAMPING 1e-7
#define MOST_DAMPING 1e7

/* ---- the normal equations of the lobes ---- */

static uint32_t variable_column(const btfi_lafortune_scratch *s, uint32_t v) {
  return btfi_lafortune_lobe_column(s, v / s->variables) + 1 + v % s->variables;
}

/* What is left of the products of derivatives once albedos have followed, summed over the channels. */
static void add_channel(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p, uint32_t channel,
                        btfi_lafortune_equations *e) {
  uint32_t which[LAF_MAX_ALBEDOS], lobes[LAF_MAX_ALBEDOS];
  double l[LAF_MAX_ALBEDOS][LAF_MAX_ALBEDOS], w[LAF_MAX_VARIABLES][LAF_MAX_ALBEDOS],
      factor[LAF_MAX_VARIABLES];
  const uint32_t active = btfi_lafortune_factor_active(s, p, channel, which, lobes, l);
  for (uint32_t v = 0; v < e->n; v++) {
    const uint32_t lobe = v / s->variables, column = variable_column(s, v);
    double residual = p->cross[column * s->channels + channel];
    factor[v] = p->albedo[1 + lobe][channel];
    for (uint32_t i = 0; i <= s->lobes && !p->refined; i++)
      residual -=
          p->albedo[i][channel] * btfi_lafortune_gram_of(s, p, btfi_lafortune_albedo_column(s, i), column);
    for (uint32_t i = 0; i < active; i++) {
      double sum = btfi_lafortune_gram_of(s, p, which[i], column);
      for (uint32_t k = 0; k < i; k++) sum -= l[i][k] * w[v][k];
      w[v][i] = sum / l[i][i];
    }
    e->slope[v] += factor[v] * residual;
  }
  for (uint32_t v = 0; v < e->n; v++) {
    if (factor[v] == 0.0) continue;
    const uint32_t column = variable_column(s, v);
    for (uint32_t u = v; u < e->n; u++) {
      double product = p->gram[column * s->columns + variable_column(s, u)];
      for (uint32_t i = 0; i < active; i++) product -= w[v][i] * w[u][i];
      e->matrix[v * e->n + u] += factor[v] * factor[u] * product;
    }
  }
}

double btfi_lafortune_unit_of(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p, uint32_t v) {
  return v % s->variables < btfi_lafortune_free_terms(s->shared->kind)
             ? (double)p->lobe[v / s->variables].peak
             : 1.0;
}

void btfi_lafortune_make_equations(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p,
                                   btfi_lafortune_equations *e) {
  e->n = s->lobes * s->variables;
  memset(e->matrix, 0, (size_t)e->n * e->n * sizeof *e->matrix);
  memset(e->slope, 0, sizeof e->slope);
  for (uint32_t c = 0; c < s->channels; c++) add_channel(s, p, c, e);
  for (uint32_t v = 0; v < e->n; v++) {
    e->slope[v] *= btfi_lafortune_unit_of(s, p, v);
    for (uint32_t u = v; u < e->n; u++)
      e->matrix[v * e->n + u] *= btfi_lafortune_unit_of(s, p, v) * btfi_lafortune_unit_of(s, p, u);
  }
}

static void divide_by_peaks(const btfi_lafortune_scratch *s, btfi_lafortune_point *p) {
  const uint32_t free_terms = btfi_lafortune_free_terms(s->shared->kind);
  for (uint32_t j = 0; j < s->lobes && free_terms > 0; j++) {
    btfi_lafortune_lobe *lobe = &p->lobe[j];
    for (uint32_t k = 0; k < free_terms; k++) lobe->coefficient[k] /= lobe->peak;
    lobe->peak = 1.0f;
  }
}

/* Solves (matrix + damping * its diagonal) step = slope. Variables that nothing depends on, or that are held,
 * stay. */
static void solve_damped(const btfi_lafortune_equations *e, const bool *held, double damping, double *step) {
  double l[LAF_MAX_VARIABLES][LAF_MAX_VARIABLES];
  bool used[LAF_MAX_VARIABLES];
  for (uint32_t i = 0; i < e->n; i++) {
    const double norm = e->matrix[i * e->n + i];
    double pivot = norm * (1.0 + damping), sum = e->slope[i];
    step[i] = 0.0;
    used[i] = false;
    if (held[i] || !(norm > 0.0)) continue;
    for (uint32_t j = 0; j < i; j++) {
      if (!used[j]) continue;
      double product = e->matrix[j * e->n + i];
      for (uint32_t k = 0; k < j; k++)
        if (used[k]) product -= l[i][k] * l[j][k];
      l[i][j] = product / l[j][j];
      pivot -= l[i][j] * l[i][j];
      sum -= l[i][j] * step[j];
    }
    if (!(pivot > 1e-10 * norm)) continue;
    used[i] = true;
    l[i][i] = sqrt(pivot);
    step[i] = sum / l[i][i];
  }
  for (uint32_t i = e->n; i-- > 0;) {
    if (!used[i]) continue;
    for (uint32_t k = i + 1; k < e->n; k++)
      if (used[k]) step[i] -= l[k][i] * step[k];
    step[i] /= l[i][i];
  }
}

/* ---- steps within the bounds ---- */

static double limited(double value, double most) {
  return fmax(-most, fmin(most, value));
}

static bool is_log_exponent(const btfi_lafortune_scratch *s, uint32_t v) {
  return s->shared->kind != LAF_WARD && v % s->variables == s->variables - 1;
}

/* Off-diagonal coefficients of full matrices wait for the diagonal ones. */
static bool is_off_diagonal(const btfi_lafortune_scratch *s, uint32_t v) {
  return s->shared->kind == LAF_FULL && v % s->variables < 9 && v % s->variables % 4 != 0;
}

static const double least_ward = 1.0 / (LAF_MAX_ROUGHNESS * LAF_MAX_ROUGHNESS),
                    most_ward = 1.0 / (LAF_MIN_ROUGHNESS * LAF_MIN_ROUGHNESS);

static void hold_bounds(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p,
                        const btfi_lafortune_equations *e, bool only_diagonal, bool *held) {
  for (uint32_t v = 0; v < e->n; v++) {
    const btfi_lafortune_lobe *lobe = &p->lobe[v / s->variables];
    held[v] = only_diagonal && is_off_diagonal(s, v);
    if (is_log_exponent(s, v))
      held[v] = e->slope[v] > 0.0 ? lobe->exponent >= (float)LAF_MAX_EXPONENT
                                  : lobe->exponent <= (float)LAF_MIN_EXPONENT;
    if (s->shared->kind == LAF_WARD) {
      const double value = -(double)lobe->coefficient[v % 2];
      held[v] = e->slope[v] > 0.0 ? value >= most_ward * (1 - 1e-6) : value <= least_ward * (1 + 1e-6);
    }
  }
}

static void take_step(const btfi_lafortune_scratch *s, const btfi_lafortune_point *from, const double *step,
                      btfi_lafortune_point *to) {
  memcpy(to->lobe, from->lobe, sizeof to->lobe);
  for (uint32_t v = 0; v < s->lobes * s->variables; v++) {
    btfi_lafortune_lobe *lobe = &to->lobe[v / s->variables];
    if (is_log_exponent(s, v)) {
      const double exponent = (double)lobe->exponent * exp(limited(step[v], 1.5));
      lobe->exponent = (float)fmax(LAF_MIN_EXPONENT, fmin(LAF_MAX_EXPONENT, exponent));
    } else if (s->shared->kind == LAF_WARD) {
      const double value = -(double)lobe->coefficient[v % 2] * exp(limited(step[v], 1.5));
      lobe->coefficient[v % 2] = (float)-fmax(least_ward, fmin(most_ward, value));
    } else {
      lobe->coefficient[v % s->variables] =
          (float)limited((double)lobe->coefficient[v % s->variables] + limited(step[v], 1.0), 1e4);
    }
  }
}

uint32_t btfi_lafortune_descend(btfi_lafortune_scratch *s, const btfi_lafortune_settings *settings,
                                uint32_t start, bool only_diagonal) {
  btfi_lafortune_point *current = &s->points[0], *trial = &s->points[1];
  btfi_lafortune_equations equations;
  double damping = FIRST_DAMPING, step[LAF_MAX_VARIABLES];
  bool held[LAF_MAX_VARIABLES];
  uint32_t iteration = 0;
  if (!btfi_lafortune_evaluate(s, current, false)) {
    current->cost = INFINITY;
    return 0;
  }
  if (s->trace != NULL) s->trace(s->trace_user, start, current->cost * (s->unit * s->unit));
  btfi_lafortune_make_equations(s, current, &equations);
  divide_by_peaks(s, current);
  while (iteration < settings->iterations && damping < MOST_DAMPING &&
         current->cost > LAF_REFINED_SUM_ERROR * s->energy) {
    iteration++;
    hold_bounds(s, current, &equations, only_diagonal, held);
    solve_damped(&equations, held, damping, step);
    take_step(s, current, step, trial);
    if (!btfi_lafortune_evaluate(s, trial, false) || !(trial->cost < current->cost)) {
      damping *= 6.0;
      /* No more to gain than the sums are exact to. */
      double promised = 0.0;
      for (uint32_t v = 0; v < equations.n; v++) promised += equations.slope[v] * step[v];
      if (promised < settings->tolerance * current->cost +
                         (current->refined ? LAF_REFINED_SUM_ERROR : LAF_SUM_ERROR) * s->energy)
        break;
      continue;
    }
    const double gained = current->cost - trial->cost;
    btfi_lafortune_point *swap = current;
    current = trial;
    trial = swap;
    if (s->trace != NULL) s->trace(s->trace_user, start, current->cost * (s->unit * s->unit));
    btfi_lafortune_make_equations(s, current, &equations);
    divide_by_peaks(s, current);
    damping = fmax(LEAST_DAMPING, damping / 8.0);
    if (gained < settings->tolerance * current->cost) break;
  }
  if (current != &s->points[0]) memcpy(&s->points[0], current, sizeof *current);
  return iteration;
}
