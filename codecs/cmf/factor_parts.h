/* SPDX-License-Identifier: MIT */
/* factor_parts.h: what the parts of factoring one ABRDF share: maps (lookup.c), terms (rank_one.c), stages
 * (stage.c) and their order (factor.c). Four channels are factored side by side, each on its own. */
#ifndef BTFI_CMF_FACTOR_PARTS_H
#define BTFI_CMF_FACTOR_PARTS_H

#include <string.h>

#include "factor.h"

typedef float v4 __attribute__((vector_size(16)));

static inline v4 splat(float value) {
  return (v4){value, value, value, value};
}

static inline v4 largest(v4 a, v4 b) {
  for (int i = 0; i < 4; i++) a[i] = a[i] > b[i] ? a[i] : b[i];
  return a;
}

static inline v4 magnitude(v4 a) {
  return largest(a, -a);
}

/* a / b, 0 where b is 0: there the weights, and with them a, are 0. */
static inline v4 quotient(v4 a, v4 b) {
  for (int i = 0; i < 4; i++) a[i] = b[i] > 0.0f ? a[i] / b[i] : 0.0f;
  return a;
}

/* Arrays of one thread. `pairs` are views x lights, lights fastest. */
typedef struct btfi_cmf_scratch {
  v4 *f, *approximation, *ratio, *weight; /* pairs */
  v4 *values, *value;                     /* pairs of each stage; of the one at work */
  v4 *old_value, *old_maps;               /* of a stage that is fitted again */
  v4 *matrix, *matrix_weight;             /* largest matrix of a stage */
  v4 *row, *column, *before, *scale;      /* largest domain */
  v4 *map[2], *change;                    /* map texels */
  v4 *at[2];                              /* pairs */
  float *plain, *p, *q, *hals;            /* of the non-negative factorisation */
} btfi_cmf_scratch;

/* ---- maps (lookup.c) ---- */

/* Makes a map from samples; `change` has room for one. */
void btfi_cmf_make_map(const btfi_cmf_geometry *g, const btfi_cmf_side *side, v4 *samples,
                       bool may_be_negative, v4 *map, v4 *change);
/* The values of a map at the lights, views or pairs of the data. */
void btfi_cmf_look_up(const btfi_cmf_geometry *g, const btfi_cmf_side *side, const v4 *map, v4 *out);
/* Adds the product of the looked up sides of one term to the value of the stage at every pair. */
void btfi_cmf_add_term(const btfi_cmf_geometry *g, const btfi_cmf_stage_geometry *s, v4 *const at[2],
                       bool first, v4 *value);

/* ---- one term (rank_one.c) ---- */

/* Weighted squared errors of a matrix: numerators are weight times value. */
typedef struct btfi_cmf_weighted {
  uint32_t rows, columns;
  v4 *numerator;       /* weight * value */
  const v4 *weight;    /* of each channel, or NULL */
  const float *shared; /* of all channels, or NULL: 1 */
} btfi_cmf_weighted;

static inline v4 btfi_cmf_weight_at(const btfi_cmf_weighted *m, size_t i) {
  return m->weight != NULL ? m->weight[i] : splat(m->shared[i]);
}

/* The rank-1 approximation of least weighted squared error, by alternating least squares. Without weights
 * this is the power iteration, and the result the first singular pair. `more` terms are to follow: then it
 * must be exact. */
void btfi_cmf_rank_one(const btfi_cmf_weighted *m, bool cancels, bool more, v4 *row, v4 *column, v4 *before,
                       v4 *scale);
/* Takes row column^T away, so that the next term fits what is left. */
void btfi_cmf_deflate(const btfi_cmf_weighted *m, const v4 *row, const v4 *column);

/* ---- one stage (stage.c) ---- */

typedef struct btfi_cmf_group {
  const btfi_cmf_geometry *g;
  btfi_cmf_scratch *s;
  uint32_t channels, first, count; /* channels of all, and those factored here */
  v4 peak;                         /* the data are divided by it */
  float *maps;
  uint32_t factor; /* of the next map */
} btfi_cmf_group;

static inline uint32_t btfi_cmf_stage_factors(const btfi_cmf_stage *stage) {
  return stage->terms * (stage->mean ? 1 : 2);
}
/* Fits a stage to what the approximation leaves, and puts its value at every pair into c->s->values. */
void btfi_cmf_fit_stage(btfi_cmf_group *c, uint32_t stage, bool first, bool has_weight,
                        btfi_cmf_report *report);

#endif
