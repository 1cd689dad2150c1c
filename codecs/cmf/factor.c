/* SPDX-License-Identifier: MIT */
/* factor.c: chained matrix factorisation of one ABRDF: its stages in order, and again. */
#include <math.h>

#include "factor_parts.h"
#include "nonnegative.h"

/* ---- scratch ---- */

static uint64_t largest_matrix(const btfi_cmf_geometry *g, uint32_t *domain) {
  uint64_t cells = 1;
  *domain = 1;
  for (uint32_t i = 0; i < g->settings.stage_count; i++) {
    const btfi_cmf_stage_geometry *s = &g->stage[i];
    if (s->rows > *domain) *domain = s->rows;
    if (s->columns > *domain) *domain = s->columns;
    if (!s->stage.mean && (uint64_t)s->rows * s->columns > cells) cells = (uint64_t)s->rows * s->columns;
  }
  return cells;
}

static uint32_t largest_stage(const btfi_cmf_geometry *g) {
  uint32_t most = 0;
  for (uint32_t i = 0; i < g->settings.stage_count; i++)
    if (btfi_cmf_stage_factors(&g->settings.stage[i]) > most)
      most = btfi_cmf_stage_factors(&g->settings.stage[i]);
  return most;
}

/* Places the arrays at `base`, or with NULL only counts their bytes. */
static uint64_t place(const btfi_cmf_geometry *g, unsigned char *base, btfi_cmf_scratch *out) {
  uint32_t domain;
  const bool nonnegative = g->settings.method == CMF_NONNEGATIVE;
  const bool factored = g->settings.method != CMF_HOMOMORPHIC;
  const uint64_t cells = factored ? largest_matrix(g, &domain) : 1, pairs = g->pairs, texels = g->map_texels;
  const uint64_t hals = nonnegative ? btfi_cmf_nonnegative_scratch(domain, domain) : 0;
  if (!factored) domain = 1;
  struct {
    void *where;
    uint64_t bytes;
  } const list[] = {
      {&out->f, 16 * pairs},
      {&out->approximation, 16 * pairs},
      {&out->values, 16 * pairs * g->settings.stage_count},
      {&out->old_value, 16 * pairs},
      {&out->old_maps, 16 * texels * largest_stage(g)},
      {&out->ratio, 16 * pairs},
      {&out->weight, 16 * pairs},
      {&out->matrix, 16 * cells},
      {&out->matrix_weight, 16 * cells},
      {&out->row, 16ull * domain},
      {&out->column, 16ull * domain},
      {&out->before, 16ull * domain},
      {&out->scale, 16ull * domain},
      {&out->map[0], 16 * texels},
      {&out->map[1], 16 * texels},
      {&out->change, 16 * texels},
      {&out->at[0], 16 * pairs},
      {&out->at[1], 16 * pairs},
      {&out->plain, nonnegative ? 8 * cells : 0},
      {&out->p, nonnegative ? 16ull * CMF_MAX_TERMS * domain : 0},
      {&out->q, nonnegative ? 16ull * CMF_MAX_TERMS * domain : 0},
      {&out->hals, 4 * hals},
  };
  uint64_t at = 0;
  for (size_t i = 0; i < sizeof list / sizeof *list; i++) {
    void *array = base != NULL ? base + at : NULL;
    memcpy(list[i].where, &array, sizeof array);
    at += (list[i].bytes + 63) / 64 * 64;
  }
  return at;
}

uint64_t btfi_cmf_scratch_bytes(const btfi_cmf_geometry *geometry) {
  btfi_cmf_scratch unused;
  return place(geometry, NULL, &unused);
}

/* ---- an ABRDF ---- */

static void load_group(const btfi_cmf_group *c, const float *abrdf, v4 *f, v4 *peak) {
  const uint32_t pairs = c->g->pairs;
  *peak = splat(0.0f);
  for (uint32_t p = 0; p < pairs; p++) {
    v4 value = splat(0.0f);
    for (uint32_t k = 0; k < c->count; k++) value[k] = abrdf[(size_t)p * c->channels + c->first + k];
    f[p] = value;
    *peak = largest(*peak, magnitude(value));
  }
}

/* Errors of the approximation, in units of `peak`. */
static void add_errors(const btfi_cmf_group *c, btfi_cmf_report *report) {
  v4 squared = splat(0.0f), energy = splat(0.0f), absolute = splat(0.0f);
  double relative = 0.0;
  for (uint32_t p = 0; p < c->g->pairs; p++) {
    const v4 f = c->s->f[p], d = magnitude(f - c->s->approximation[p]);
    squared += d * d;
    energy += f * f;
    absolute += d;
    for (uint32_t k = 0; k < c->count; k++) {
      if (!(f[k] > 0.0f)) continue;
      relative += (double)(d[k] / f[k]);
      report->positive++;
    }
  }
  for (uint32_t k = 0; k < c->count; k++) {
    const double peak = (double)c->peak[k];
    report->squared_error += (double)squared[k] * peak * peak;
    report->squared_energy += (double)energy[k] * peak * peak;
    report->absolute_error += (double)absolute[k] * peak;
  }
  report->relative_error += relative;
  report->samples += (uint64_t)c->g->pairs * c->count;
}

static void load_map(const btfi_cmf_group *c, const float *maps, uint32_t factor, v4 *map) {
  const float *from = maps + (size_t)factor * c->g->map_texels * c->channels + c->first;
  for (uint32_t t = 0; t < c->g->map_texels; t++) {
    map[t] = splat(0.0f);
    for (uint32_t k = 0; k < c->count; k++) map[t][k] = from[(size_t)t * c->channels + k];
  }
}

/* The product of all stages but one (or of all, if there is no such stage). */
static void multiply_stages(const btfi_cmf_group *c, uint32_t but) {
  v4 *const product = c->s->approximation;
  for (uint32_t p = 0; p < c->g->pairs; p++) product[p] = splat(1.0f);
  for (uint32_t stage = 0; stage < c->g->settings.stage_count; stage++) {
    const v4 *value = c->s->values + (size_t)stage * c->g->pairs;
    for (uint32_t p = 0; p < c->g->pairs && stage != but; p++) product[p] *= value[p];
  }
}

static v4 stage_error(const btfi_cmf_group *c, const v4 *value) {
  v4 error = splat(0.0f);
  for (uint32_t p = 0; p < c->g->pairs; p++) {
    const v4 d = c->s->f[p] - c->s->approximation[p] * value[p];
    error += d * d;
  }
  return error;
}

/* Fits a stage again, to what all the others leave; channels that gain nothing keep what they had. Returns
 * whether a channel gained more than a thousandth. */
static bool refit_stage(btfi_cmf_group *c, uint32_t stage, uint32_t first_factor, btfi_cmf_report *report) {
  const btfi_cmf_geometry *g = c->g;
  const uint32_t factors = btfi_cmf_stage_factors(&g->settings.stage[stage]);
  v4 *const value = c->s->values + (size_t)stage * g->pairs;
  bool gained = false;
  multiply_stages(c, stage);
  memcpy(c->s->old_value, value, g->pairs * sizeof *value);
  for (uint32_t i = 0; i < factors; i++)
    load_map(c, c->maps, first_factor + i, c->s->old_maps + (size_t)i * g->map_texels);
  const v4 before = stage_error(c, value);
  c->factor = first_factor;
  btfi_cmf_fit_stage(c, stage, false, true, report);
  const v4 after = stage_error(c, value);
  for (uint32_t k = 0; k < c->count; k++) {
    gained = gained || after[k] < 0.999f * before[k];
    if (after[k] < before[k]) continue;
    for (uint32_t p = 0; p < g->pairs; p++) value[p][k] = c->s->old_value[p][k];
    for (uint32_t i = 0; i < factors; i++) {
      const v4 *map = c->s->old_maps + (size_t)i * g->map_texels;
      float *to = c->maps + (size_t)(first_factor + i) * g->map_texels * c->channels + c->first + k;
      for (uint32_t t = 0; t < g->map_texels; t++) to[(size_t)t * c->channels] = map[t][k];
    }
  }
  return gained;
}

static void factor_group(btfi_cmf_group *c, const float *abrdf, btfi_cmf_report *report) {
  const btfi_cmf_geometry *g = c->g;
  const uint32_t stages = g->settings.stage_count;
  btfi_cmf_scratch *s = c->s;
  load_group(c, abrdf, s->f, &c->peak);
  for (uint32_t p = 0; p < g->pairs; p++) {
    s->f[p] = quotient(s->f[p], c->peak);
    s->approximation[p] = splat(1.0f);
  }
  for (uint32_t stage = 0; stage < stages; stage++) {
    btfi_cmf_fit_stage(c, stage, stage == 0, stage > 0 && g->settings.residue == CMF_WEIGHTED, report);
    for (uint32_t p = 0; p < g->pairs; p++) s->approximation[p] *= s->value[p];
  }
  bool gained = stages > 1;
  for (uint32_t sweep = 0; sweep < g->settings.sweeps && gained; sweep++) {
    uint32_t factor = 0;
    gained = false;
    for (uint32_t stage = 0; stage < stages; stage++) {
      gained |= refit_stage(c, stage, factor, report);
      factor += btfi_cmf_stage_factors(&g->settings.stage[stage]);
    }
  }
  if (g->settings.sweeps > 0) multiply_stages(c, stages);
  add_errors(c, report);
}

void btfi_cmf_factor_abrdf(const btfi_cmf_geometry *geometry, uint32_t channels, const float *abrdf,
                           void *memory, float *maps, btfi_cmf_report *report) {
  btfi_cmf_scratch s;
  (void)place(geometry, memory, &s);
  for (uint32_t first = 0; first < channels; first += 4) {
    btfi_cmf_group c = {.g = geometry, .s = &s, .channels = channels, .first = first, .maps = maps};
    c.count = channels - first < 4 ? channels - first : 4;
    factor_group(&c, abrdf, report);
  }
}

static void measure_group(btfi_cmf_group *c, const float *abrdf, const float *maps, btfi_cmf_report *report) {
  const btfi_cmf_geometry *g = c->g;
  btfi_cmf_scratch *s = c->s;
  load_group(c, abrdf, s->f, &c->peak);
  c->peak = splat(1.0f);
  for (uint32_t p = 0; p < g->pairs; p++) s->approximation[p] = splat(1.0f);
  for (uint32_t stage = 0; stage < g->settings.stage_count; stage++) {
    const btfi_cmf_stage_geometry *geometry = &g->stage[stage];
    s->value = s->values;
    for (uint32_t term = 0; term < geometry->stage.terms; term++) {
      for (uint32_t k = 0; k < geometry->sides; k++) {
        load_map(c, maps, c->factor++, s->map[k]);
        btfi_cmf_look_up(g, &geometry->side[k], s->map[k], s->at[k]);
      }
      btfi_cmf_add_term(g, geometry, s->at, term == 0, s->value);
    }
    for (uint32_t p = 0; p < g->pairs; p++) s->approximation[p] *= s->value[p];
  }
  add_errors(c, report);
}

void btfi_cmf_measure(const btfi_cmf_geometry *geometry, uint32_t channels, const float *abrdf, void *memory,
                      const float *maps, btfi_cmf_report *report) {
  btfi_cmf_scratch s;
  (void)place(geometry, memory, &s);
  for (uint32_t first = 0; first < channels; first += 4) {
    btfi_cmf_group c = {.g = geometry, .s = &s, .channels = channels, .first = first};
    c.count = channels - first < 4 ? channels - first : 4;
    measure_group(&c, abrdf, maps, report);
  }
}
