/* SPDX-License-Identifier: MIT */
/* factor.c: chained matrix factorisation of one ABRDF. Four channels are factored side by side, each on its
 * own. */
#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

#include "factor.h"
#include "nonnegative.h"

typedef float v4 __attribute__((vector_size(16)));

enum { MAP_SWEEPS = 4, NONNEGATIVE_SWEEPS = 60 };

/* Arrays of one thread. `pairs` are views x lights, lights fastest. */
typedef struct scratch {
  v4 *f, *approximation, *ratio, *weight; /* pairs */
  v4 *values, *value;                     /* pairs of each stage; of the one at work */
  v4 *old_value, *old_maps;               /* of a stage that is fitted again */
  v4 *matrix, *matrix_weight;             /* largest matrix of a stage */
  v4 *row, *column, *before, *scale;      /* largest domain */
  v4 *map[2], *change;                    /* map texels */
  v4 *at[2];                              /* pairs */
  float *plain, *p, *q, *hals;            /* of the non-negative factorisation */
} scratch;

static v4 splat(float value) {
  return (v4){value, value, value, value};
}

static v4 largest(v4 a, v4 b) {
  for (int i = 0; i < 4; i++) a[i] = a[i] > b[i] ? a[i] : b[i];
  return a;
}

static v4 magnitude(v4 a) {
  return largest(a, -a);
}

/* a / b, 0 where b is 0: there the weights, and with them a, are 0. */
static v4 quotient(v4 a, v4 b) {
  for (int i = 0; i < 4; i++) a[i] = b[i] > 0.0f ? a[i] / b[i] : 0.0f;
  return a;
}

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

static uint32_t stage_factors(const btfi_cmf_stage *stage) {
  return stage->terms * (stage->mean ? 1 : 2);
}

static uint32_t largest_stage(const btfi_cmf_geometry *g) {
  uint32_t most = 0;
  for (uint32_t i = 0; i < g->settings.stage_count; i++)
    if (stage_factors(&g->settings.stage[i]) > most) most = stage_factors(&g->settings.stage[i]);
  return most;
}

/* Places the arrays at `base`, or with NULL only counts their bytes. */
static uint64_t place(const btfi_cmf_geometry *g, unsigned char *base, scratch *out) {
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
  scratch unused;
  return place(geometry, NULL, &unused);
}

/* ---- maps ---- */

static v4 blend(const v4 *values, const btfi_cmf_tap *tap) {
  return values[tap->index[0]] * tap->weight[0] + values[tap->index[1]] * tap->weight[1] +
         values[tap->index[2]] * tap->weight[2] + values[tap->index[3]] * tap->weight[3];
}

/* Makes a map from samples. Directions of the data lie between texels: sweeps (simultaneous algebraic
 * reconstruction) move the texels until looking them up gives the samples. */
static void make_map(const btfi_cmf_geometry *g, const btfi_cmf_side *side, v4 *samples, bool may_be_negative,
                     v4 *map, v4 *change) {
  const uint32_t texels = g->map_texels;
  if (side->source != NULL)
    for (uint32_t i = 0; i < side->domain.count; i++) samples[i] = samples[side->source[i]];
  for (uint32_t t = 0; t < texels; t++) map[t] = blend(samples, &side->to_map[t]);
  for (int sweep = 0; sweep < MAP_SWEEPS && side->domain.native; sweep++) {
    memset(change, 0, texels * sizeof *change);
    for (uint32_t i = 0; i < side->domain.count; i++) {
      const btfi_cmf_tap *tap = &side->at[i];
      const v4 missing = samples[i] - blend(map, tap);
      for (int k = 0; k < 4; k++) change[tap->index[k]] += missing * tap->weight[k];
    }
    for (uint32_t t = 0; t < texels; t++) map[t] += change[t] * side->texel_share[t];
  }
  /* Signs of a singular pair are arbitrary only together; here both are those of positive data. */
  for (uint32_t t = 0; t < texels && !may_be_negative; t++) map[t] = largest(map[t], splat(0.0f));
}

static uint32_t at_count(const btfi_cmf_geometry *g, const btfi_cmf_side *side) {
  return side->at_kind == CMF_AT_LIGHT ? g->lights : side->at_kind == CMF_AT_VIEW ? g->views : g->pairs;
}

static void look_up(const btfi_cmf_geometry *g, const btfi_cmf_side *side, const v4 *map, v4 *out) {
  const uint32_t count = at_count(g, side);
  for (uint32_t i = 0; i < count; i++) out[i] = blend(map, &side->at[i]);
}

/* Adds the product of the looked up sides of one term to the value of the stage at every pair. */
static void add_term(const btfi_cmf_geometry *g, const btfi_cmf_stage_geometry *s, v4 *const at[2],
                     bool first, v4 *value) {
  /* Strides over the light and over the view. */
  const size_t over_light[2] = {s->side[0].at_kind != CMF_AT_VIEW, s->side[1].at_kind != CMF_AT_VIEW};
  size_t over_view[2];
  for (int k = 0; k < 2; k++)
    over_view[k] = s->side[k].at_kind == CMF_AT_PAIR ? g->lights : s->side[k].at_kind == CMF_AT_VIEW;
  for (size_t v = 0; v < g->views; v++)
    for (size_t l = 0; l < g->lights; l++) {
      v4 product = at[0][l * over_light[0] + v * over_view[0]];
      if (s->sides == 2) product *= at[1][l * over_light[1] + v * over_view[1]];
      v4 *to = &value[v * g->lights + l];
      *to = first ? product : *to + product;
    }
}

/* ---- one term ---- */

/* Weighted squared errors of a matrix: numerators are weight times value. */
typedef struct weighted {
  uint32_t rows, columns;
  v4 *numerator;       /* weight * value */
  const v4 *weight;    /* of each channel, or NULL */
  const float *shared; /* of all channels, or NULL: 1 */
} weighted;

static v4 weight_at(const weighted *m, size_t i) {
  return m->weight != NULL ? m->weight[i] : splat(m->shared[i]);
}

/* The row factor of least error for a given column factor. */
static void fit_rows(const weighted *m, const v4 *column, v4 *row) {
  v4 square = splat(0.0f);
  for (uint32_t j = 0; j < m->columns; j++) square += column[j] * column[j];
  for (uint32_t i = 0; i < m->rows; i++) {
    const size_t at = (size_t)i * m->columns;
    v4 sum = splat(0.0f), other = splat(0.0f), scale = square;
    uint32_t j = 0;
    for (; j + 1 < m->columns; j += 2) {
      sum += m->numerator[at + j] * column[j];
      other += m->numerator[at + j + 1] * column[j + 1];
    }
    if (j < m->columns) sum += m->numerator[at + j] * column[j];
    if (m->weight != NULL || m->shared != NULL) {
      scale = splat(0.0f);
      for (j = 0; j < m->columns; j++) scale += weight_at(m, at + j) * (column[j] * column[j]);
    }
    row[i] = quotient(sum + other, scale);
  }
}

/* The column factor of least error for a given row factor; `scale` has room for the columns. */
static void fit_columns(const weighted *m, const v4 *row, v4 *column, v4 *scale) {
  const bool uniform = m->weight == NULL && m->shared == NULL;
  v4 square = splat(0.0f);
  memset(column, 0, m->columns * sizeof *column);
  if (!uniform) memset(scale, 0, m->columns * sizeof *scale);
  for (uint32_t i = 0; i < m->rows; i++) {
    const size_t at = (size_t)i * m->columns;
    const v4 r = row[i], r2 = r * r;
    square += r2;
    for (uint32_t j = 0; j < m->columns; j++) column[j] += m->numerator[at + j] * r;
    for (uint32_t j = 0; j < m->columns && !uniform; j++) scale[j] += weight_at(m, at + j) * r2;
  }
  for (uint32_t j = 0; j < m->columns; j++) column[j] = quotient(column[j], uniform ? square : scale[j]);
}

/* First column factor: the sums of columns, or where they may cancel the row of most energy. */
static void start_columns(const weighted *m, bool cancels, v4 *column) {
  v4 most = splat(-1.0f);
  memset(column, 0, m->columns * sizeof *column);
  for (uint32_t i = 0; i < m->rows; i++) {
    const v4 *numerator = m->numerator + (size_t)i * m->columns;
    if (!cancels) {
      for (uint32_t j = 0; j < m->columns; j++) column[j] += numerator[j];
      continue;
    }
    v4 energy = splat(0.0f);
    for (uint32_t j = 0; j < m->columns; j++) energy += numerator[j] * numerator[j];
    for (int k = 0; k < 4; k++) {
      if (!(energy[k] > most[k])) continue;
      most[k] = energy[k];
      for (uint32_t j = 0; j < m->columns; j++) column[j][k] = numerator[j][k];
    }
  }
  /* Lengths of 1, so that nothing under- or overflows on the way. */
  v4 peak = splat(0.0f);
  for (uint32_t j = 0; j < m->columns; j++) peak = largest(peak, magnitude(column[j]));
  for (uint32_t j = 0; j < m->columns; j++) column[j] = quotient(column[j], peak);
}

/* The rank-1 approximation of least weighted squared error, by alternating least squares. Without weights
 * this is the power iteration, and the result the first singular pair. `more` terms are to follow: then it
 * must be exact. */
static void rank_one(const weighted *m, bool cancels, bool more, v4 *row, v4 *column, v4 *before, v4 *scale) {
  const int most = more ? 2000 : 60;
  const float tolerance = more ? 1e-13f : 1e-9f;
  start_columns(m, cancels, column);
  for (int turn = 0; turn < most; turn++) {
    v4 moved = splat(0.0f), length = splat(0.0f);
    memcpy(before, column, m->columns * sizeof *before);
    fit_rows(m, column, row);
    fit_columns(m, row, column, scale);
    for (uint32_t j = 0; j < m->columns; j++) {
      const v4 d = column[j] - before[j];
      moved += d * d;
      length += column[j] * column[j];
    }
    bool done = turn > 0;
    for (int k = 0; k < 4; k++) done = done && !(moved[k] > tolerance * length[k]);
    if (done) break;
  }
}

/* Takes row column^T away, so that the next term fits what is left. */
static void deflate(const weighted *m, const v4 *row, const v4 *column) {
  for (uint32_t i = 0; i < m->rows; i++)
    for (uint32_t j = 0; j < m->columns; j++) {
      const size_t at = (size_t)i * m->columns + j;
      const v4 product = row[i] * column[j];
      m->numerator[at] -= m->weight == NULL && m->shared == NULL ? product : weight_at(m, at) * product;
    }
}

/* ---- stages ---- */

typedef struct group {
  const btfi_cmf_geometry *g;
  scratch *s;
  uint32_t channels, first, count; /* channels of all, and those factored here */
  v4 peak;                         /* the data are divided by it */
  float *maps;
  uint32_t factor; /* of the next map */
} group;

static void store_map(const group *c, const v4 *map, v4 scale) {
  float *to = c->maps + (size_t)c->factor * c->g->map_texels * c->channels + c->first;
  for (uint32_t t = 0; t < c->g->map_texels; t++) {
    const v4 value = map[t] * scale;
    for (uint32_t k = 0; k < c->count; k++) to[(size_t)t * c->channels + k] = value[k];
  }
}

/* What is left for a stage: f over the approximation so far, or the numerators and weights of its least
 * squares. */
static void make_residue(const group *c, bool first, bool has_weight, btfi_cmf_report *report) {
  const btfi_cmf_geometry *g = c->g;
  scratch *s = c->s;
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

static void mean_stage(const group *c, const btfi_cmf_stage_geometry *s, bool has_weight) {
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

static weighted make_matrix(const group *c, const btfi_cmf_stage_geometry *s, bool has_weight) {
  scratch *t = c->s;
  weighted m = {c->g->views, c->g->lights, t->matrix, has_weight ? t->matrix_weight : NULL, NULL};
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
static void finish_term(group *c, const btfi_cmf_stage_geometry *s, uint32_t stage, uint32_t term) {
  /* Matrices of the data's own directions have the views as rows. */
  const bool swapped = s->native && s->stage.pair->projection[0] == CMF_LIGHT;
  v4 *const samples[2] = {swapped ? c->s->column : c->s->row, swapped ? c->s->row : c->s->column};
  const bool may_be_negative = btfi_cmf_is_signed(c->g->settings.method, term);
  for (uint32_t k = 0; k < s->sides; k++) {
    make_map(c->g, &s->side[k], samples[k], may_be_negative, c->s->map[k], c->s->change);
    store_map(c, c->s->map[k], stage == 0 && k == 0 ? c->peak : splat(1.0f));
    look_up(c->g, &s->side[k], c->s->map[k], c->s->at[k]);
    c->factor++;
  }
  add_term(c->g, s, c->s->at, term == 0, c->s->value);
}

/* Each channel through the non-negative factorisation, whose terms come out together. */
static void nonnegative_terms(const group *c, const btfi_cmf_stage_geometry *s, const weighted *m) {
  const size_t cells = (size_t)m->rows * m->columns;
  float *const weight = m->weight != NULL || m->shared != NULL ? c->s->plain + cells : NULL;
  const uint32_t terms = s->stage.terms;
  for (uint32_t channel = 0; channel < c->count; channel++) {
    uint32_t done;
    for (size_t i = 0; i < cells; i++) {
      const float w = weight != NULL ? weight_at(m, i)[channel] : 1.0f;
      c->s->plain[i] = w > 0.0f ? m->numerator[i][channel] / w : 0.0f;
      if (weight != NULL) weight[i] = w;
    }
    btfi_cmf_nonnegative(m->rows, m->columns, c->s->plain, m->columns, weight, terms, NONNEGATIVE_SWEEPS,
                         1e-5, c->s->hals, c->s->p + (size_t)channel * terms * m->rows,
                         c->s->q + (size_t)channel * terms * m->columns, NULL, &done);
  }
}

/* One term of what nonnegative_terms left. */
static void take_term(const group *c, const weighted *m, uint32_t terms, uint32_t term) {
  memset(c->s->row, 0, m->rows * sizeof *c->s->row);
  memset(c->s->column, 0, m->columns * sizeof *c->s->column);
  for (uint32_t channel = 0; channel < c->count; channel++) {
    const float *p = c->s->p + (size_t)channel * terms * m->rows;
    const float *q = c->s->q + (size_t)channel * terms * m->columns;
    for (uint32_t i = 0; i < m->rows; i++) c->s->row[i][channel] = p[(size_t)i * terms + term];
    for (uint32_t j = 0; j < m->columns; j++) c->s->column[j][channel] = q[(size_t)j * terms + term];
  }
}

static void matrix_stage(group *c, const btfi_cmf_stage_geometry *s, uint32_t stage, bool has_weight) {
  const weighted m = make_matrix(c, s, has_weight);
  const uint32_t terms = s->stage.terms;
  const bool together = c->g->settings.method == CMF_NONNEGATIVE && terms > 1;
  if (together) nonnegative_terms(c, s, &m);
  for (uint32_t term = 0; term < terms; term++) {
    if (together) {
      take_term(c, &m, terms, term);
    } else {
      rank_one(&m, term > 0, terms > 1, c->s->row, c->s->column, c->s->before, c->s->scale);
      if (term + 1 < terms) deflate(&m, c->s->row, c->s->column);
    }
    finish_term(c, s, stage, term);
  }
}

/* ---- an ABRDF ---- */

static void load_group(const group *c, const float *abrdf, v4 *f, v4 *peak) {
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
static void add_errors(const group *c, btfi_cmf_report *report) {
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

static void load_map(const group *c, const float *maps, uint32_t factor, v4 *map) {
  const float *from = maps + (size_t)factor * c->g->map_texels * c->channels + c->first;
  for (uint32_t t = 0; t < c->g->map_texels; t++) {
    map[t] = splat(0.0f);
    for (uint32_t k = 0; k < c->count; k++) map[t][k] = from[(size_t)t * c->channels + k];
  }
}

static void fit_stage(group *c, uint32_t stage, bool first, bool has_weight, btfi_cmf_report *report) {
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

/* The product of all stages but one (or of all, if there is no such stage). */
static void multiply_stages(const group *c, uint32_t but) {
  v4 *const product = c->s->approximation;
  for (uint32_t p = 0; p < c->g->pairs; p++) product[p] = splat(1.0f);
  for (uint32_t stage = 0; stage < c->g->settings.stage_count; stage++) {
    const v4 *value = c->s->values + (size_t)stage * c->g->pairs;
    for (uint32_t p = 0; p < c->g->pairs && stage != but; p++) product[p] *= value[p];
  }
}

static v4 stage_error(const group *c, const v4 *value) {
  v4 error = splat(0.0f);
  for (uint32_t p = 0; p < c->g->pairs; p++) {
    const v4 d = c->s->f[p] - c->s->approximation[p] * value[p];
    error += d * d;
  }
  return error;
}

/* Fits a stage again, to what all the others leave; channels that gain nothing keep what they had. Returns
 * whether a channel gained more than a thousandth. */
static bool refit_stage(group *c, uint32_t stage, uint32_t first_factor, btfi_cmf_report *report) {
  const btfi_cmf_geometry *g = c->g;
  const uint32_t factors = stage_factors(&g->settings.stage[stage]);
  v4 *const value = c->s->values + (size_t)stage * g->pairs;
  bool gained = false;
  multiply_stages(c, stage);
  memcpy(c->s->old_value, value, g->pairs * sizeof *value);
  for (uint32_t i = 0; i < factors; i++)
    load_map(c, c->maps, first_factor + i, c->s->old_maps + (size_t)i * g->map_texels);
  const v4 before = stage_error(c, value);
  c->factor = first_factor;
  fit_stage(c, stage, false, true, report);
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

static void factor_group(group *c, const float *abrdf, btfi_cmf_report *report) {
  const btfi_cmf_geometry *g = c->g;
  const uint32_t stages = g->settings.stage_count;
  scratch *s = c->s;
  load_group(c, abrdf, s->f, &c->peak);
  for (uint32_t p = 0; p < g->pairs; p++) {
    s->f[p] = quotient(s->f[p], c->peak);
    s->approximation[p] = splat(1.0f);
  }
  for (uint32_t stage = 0; stage < stages; stage++) {
    fit_stage(c, stage, stage == 0, stage > 0 && g->settings.residue == CMF_WEIGHTED, report);
    for (uint32_t p = 0; p < g->pairs; p++) s->approximation[p] *= s->value[p];
  }
  bool gained = stages > 1;
  for (uint32_t sweep = 0; sweep < g->settings.sweeps && gained; sweep++) {
    uint32_t factor = 0;
    gained = false;
    for (uint32_t stage = 0; stage < stages; stage++) {
      gained |= refit_stage(c, stage, factor, report);
      factor += stage_factors(&g->settings.stage[stage]);
    }
  }
  if (g->settings.sweeps > 0) multiply_stages(c, stages);
  add_errors(c, report);
}

void btfi_cmf_factor_abrdf(const btfi_cmf_geometry *geometry, uint32_t channels, const float *abrdf,
                           void *memory, float *maps, btfi_cmf_report *report) {
  scratch s;
  (void)place(geometry, memory, &s);
  for (uint32_t first = 0; first < channels; first += 4) {
    group c = {.g = geometry, .s = &s, .channels = channels, .first = first, .maps = maps};
    c.count = channels - first < 4 ? channels - first : 4;
    factor_group(&c, abrdf, report);
  }
}

static void measure_group(group *c, const float *abrdf, const float *maps, btfi_cmf_report *report) {
  const btfi_cmf_geometry *g = c->g;
  scratch *s = c->s;
  load_group(c, abrdf, s->f, &c->peak);
  c->peak = splat(1.0f);
  for (uint32_t p = 0; p < g->pairs; p++) s->approximation[p] = splat(1.0f);
  for (uint32_t stage = 0; stage < g->settings.stage_count; stage++) {
    const btfi_cmf_stage_geometry *geometry = &g->stage[stage];
    s->value = s->values;
    for (uint32_t term = 0; term < geometry->stage.terms; term++) {
      for (uint32_t k = 0; k < geometry->sides; k++) {
        load_map(c, maps, c->factor++, s->map[k]);
        look_up(g, &geometry->side[k], s->map[k], s->at[k]);
      }
      add_term(g, geometry, s->at, term == 0, s->value);
    }
    for (uint32_t p = 0; p < g->pairs; p++) s->approximation[p] *= s->value[p];
  }
  add_errors(c, report);
}

void btfi_cmf_measure(const btfi_cmf_geometry *geometry, uint32_t channels, const float *abrdf, void *memory,
                      const float *maps, btfi_cmf_report *report) {
  scratch s;
  (void)place(geometry, memory, &s);
  for (uint32_t first = 0; first < channels; first += 4) {
    group c = {.g = geometry, .s = &s, .channels = channels, .first = first};
    c.count = channels - first < 4 ? channels - first : 4;
    measure_group(&c, abrdf, maps, report);
  }
}
