/* SPDX-License-Identifier: MIT */
/* stage.c: one stage of the chain: the residue, resampled to the parameterisation of the stage, as a mean or
 * a sum of products, whose factors become maps. */
#include "factor_parts.h"
#include "nonnegative.h"

enum { NONNEGATIVE_SWEEPS = 60 };

static void store_map(const btfi_cmf_group *c, const v4 *map, v4 scale) {
  float *to = c->maps + (size_t)c->factor * c->g->map_texels * c->channels + c->first;
  for (uint32_t t = 0; t < c->g->map_texels; t++) {
    const v4 value = map[t] * scale;
    for (uint32_t k = 0; k < c->count; k++) to[(size_t)t * c->channels + k] = value[k];
  }
}

/* What is left for a stage: f over the approximation so far, or the numerators and weights of its least
 * squares. */
static void make_residue(const btfi_cmf_group *c, bool first, bool has_weight, btfi_cmf_report *report) {
  const btfi_cmf_geometry *g = c->g;
  btfi_cmf_scratch *s = c->s;
  const v4 least = splat((float)g->settings.epsilon);
  for (uint32_t p = 0; p < g->pairs; p++) {
    const v4 floor = largest(s->approximation[p], least);
    if (first) {
      s->ratio[p] = s->f[p];
    } else if (has_weight) {
      s->ratio[p] = s->f[p] * floor;
      s->weight[p] = floor * floor;
    } else {
      s->ratio[p] = s->f[p] / floor;
    }
    for (uint32_t k = 0; k < c->count && !first; k++) report->masked += s->approximation[p][k] < least[k];
  }
  if (!first) report->divided += (uint64_t)g->pairs * c->count;
}

static void mean_stage(const btfi_cmf_group *c, const btfi_cmf_stage_geometry *s, bool has_weight) {
  for (uint32_t i = 0; i < s->rows; i++) {
    v4 sum = splat(0.0f), weight = splat(0.0f);
    for (uint32_t e = s->start[i]; e < s->start[i + 1]; e++) {
      sum += c->s->ratio[s->pair[e]] * s->pair_weight[e];
      if (has_weight) weight += c->s->weight[s->pair[e]] * s->pair_weight[e];
    }
    c->s->row[i] = has_weight ? quotient(sum, weight) : sum;
  }
}

static void resample(const btfi_cmf_geometry *g, const btfi_cmf_stage_geometry *s, const v4 *pairs, v4 *out) {
  const size_t cells = (size_t)s->rows * s->columns;
  for (size_t i = 0; i < cells; i++) {
    const btfi_cmf_cell *cell = &s->cell[i];
    v4 sum = splat(0.0f);
    if (s->cell_weight[i] > 0.0f)
      for (int j = 0; j < 3; j++) {
        const v4 *line = pairs + (size_t)cell->view[j] * g->lights;
        if (cell->view_weight[j] > 0.0f)
          sum +=
              (line[cell->light[0]] * cell->light_weight[0] + line[cell->light[1]] * cell->light_weight[1] +
               line[cell->light[2]] * cell->light_weight[2]) *
              cell->view_weight[j];
      }
    out[i] = sum * s->cell_weight[i];
  }
}

/* P and R alike: both the matrix and its weights made symmetric. */
static void symmetrise(v4 *matrix, uint32_t n) {
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < i; j++) {
      v4 *a = &matrix[(size_t)i * n + j], *b = &matrix[(size_t)j * n + i];
      *a = *b = 0.5f * (*a + *b);
    }
}

static btfi_cmf_weighted make_matrix(const btfi_cmf_group *c, const btfi_cmf_stage_geometry *s,
                                     bool has_weight) {
  btfi_cmf_scratch *t = c->s;
  btfi_cmf_weighted m = {c->g->views, c->g->lights, t->matrix, has_weight ? t->matrix_weight : NULL, NULL};
  if (s->native) {
    memcpy(t->matrix, t->ratio, c->g->pairs * sizeof *t->matrix);
    if (has_weight) memcpy(t->matrix_weight, t->weight, c->g->pairs * sizeof *t->matrix);
    if (c->g->settings.symmetric) {
      symmetrise(t->matrix, m.rows);
      if (has_weight) symmetrise(t->matrix_weight, m.rows);
    }
    return m;
  }
  m.rows = s->rows;
  m.columns = s->columns;
  resample(c->g, s, t->ratio, t->matrix);
  if (has_weight) resample(c->g, s, t->weight, t->matrix_weight);
  if (!has_weight) m.shared = s->cell_weight;
  return m;
}

/* Maps of one term from its row and column factors, and its contribution to the stage. */
static void finish_term(btfi_cmf_group *c, const btfi_cmf_stage_geometry *s, uint32_t stage, uint32_t term) {
  /* Matrices of the data's own directions have the views as rows. */
  const bool swapped = s->native && s->stage.pair->projection[0] == CMF_LIGHT;
  v4 *const samples[2] = {swapped ? c->s->column : c->s->row, swapped ? c->s->row : c->s->column};
  const bool may_be_negative = btfi_cmf_is_signed(c->g->settings.method, term);
  for (uint32_t k = 0; k < s->sides; k++) {
    btfi_cmf_make_map(c->g, &s->side[k], samples[k], may_be_negative, c->s->map[k], c->s->change);
    store_map(c, c->s->map[k], stage == 0 && k == 0 ? c->peak : splat(1.0f));
    btfi_cmf_look_up(c->g, &s->side[k], c->s->map[k], c->s->at[k]);
    c->factor++;
  }
  btfi_cmf_add_term(c->g, s, c->s->at, term == 0, c->s->value);
}

/* Each channel through the non-negative factorisation, whose terms come out together. */
static void nonnegative_terms(const btfi_cmf_group *c, const btfi_cmf_stage_geometry *s,
                              const btfi_cmf_weighted *m) {
  const size_t cells = (size_t)m->rows * m->columns;
  float *const weight = m->weight != NULL || m->shared != NULL ? c->s->plain + cells : NULL;
  const uint32_t terms = s->stage.terms;
  for (uint32_t channel = 0; channel < c->count; channel++) {
    uint32_t done;
    for (size_t i = 0; i < cells; i++) {
      const float w = weight != NULL ? btfi_cmf_weight_at(m, i)[channel] : 1.0f;
      c->s->plain[i] = w > 0.0f ? m->numerator[i][channel] / w : 0.0f;
      if (weight != NULL) weight[i] = w;
    }
    btfi_cmf_nonnegative(m->rows, m->columns, c->s->plain, m->columns, weight, terms, NONNEGATIVE_SWEEPS,
                         1e-5, c->s->hals, c->s->p + (size_t)channel * terms * m->rows,
                         c->s->q + (size_t)channel * terms * m->columns, NULL, &done);
  }
}

/* One term of what nonnegative_terms left. */
static void take_term(const btfi_cmf_group *c, const btfi_cmf_weighted *m, uint32_t terms, uint32_t term) {
  memset(c->s->row, 0, m->rows * sizeof *c->s->row);
  memset(c->s->column, 0, m->columns * sizeof *c->s->column);
  for (uint32_t channel = 0; channel < c->count; channel++) {
    const float *p = c->s->p + (size_t)channel * terms * m->rows;
    const float *q = c->s->q + (size_t)channel * terms * m->columns;
    for (uint32_t i = 0; i < m->rows; i++) c->s->row[i][channel] = p[(size_t)i * terms + term];
    for (uint32_t j = 0; j < m->columns; j++) c->s->column[j][channel] = q[(size_t)j * terms + term];
  }
}

static void matrix_stage(btfi_cmf_group *c, const btfi_cmf_stage_geometry *s, uint32_t stage,
                         bool has_weight) {
  const btfi_cmf_weighted m = make_matrix(c, s, has_weight);
  const uint32_t terms = s->stage.terms;
  const bool together = c->g->settings.method == CMF_NONNEGATIVE && terms > 1;
  if (together) nonnegative_terms(c, s, &m);
  for (uint32_t term = 0; term < terms; term++) {
    if (together) {
      take_term(c, &m, terms, term);
    } else {
      btfi_cmf_rank_one(&m, term > 0, terms > 1, c->s->row, c->s->column, c->s->before, c->s->scale);
      if (term + 1 < terms) btfi_cmf_deflate(&m, c->s->row, c->s->column);
    }
    finish_term(c, s, stage, term);
  }
}

void btfi_cmf_fit_stage(btfi_cmf_group *c, uint32_t stage, bool first, bool has_weight,
                        btfi_cmf_report *report) {
  const btfi_cmf_stage_geometry *geometry = &c->g->stage[stage];
  c->s->value = c->s->values + (size_t)stage * c->g->pairs;
  make_residue(c, first, has_weight, report);
  if (geometry->stage.mean) {
    mean_stage(c, geometry, has_weight);
    finish_term(c, geometry, stage, 0);
  } else {
    matrix_stage(c, geometry, stage, has_weight);
  }
}
