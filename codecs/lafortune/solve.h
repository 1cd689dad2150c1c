/* SPDX-License-Identifier: MIT */
/* solve.h: what the parts of the fit of one group of channels of one texel share. Albedos are linear given
 * the lobes and solved inside (variable projection); of the samples only products of columns are needed,
 * which are the same for all channels. */
#ifndef BTFI_LAFORTUNE_SOLVE_H
#define BTFI_LAFORTUNE_SOLVE_H

#include "kernel.h"

enum {
  LAF_MAX_COLUMNS = LAF_MAX_ALBEDOS + LAF_MAX_VARIABLES,
  LAF_MAX_PAIRS = LAF_CANDIDATES * (LAF_CANDIDATES - 1) / 2,
  LAF_MAX_STARTS = 64
};
/* Shares of the data's energy: what sums of products of floats are off by, and those of what is left of the
 * data. */
#define LAF_SUM_ERROR 1e-10
#define LAF_REFINED_SUM_ERROR 1e-15

/* Lobes with what is known of them. Columns of the sums: the diffuse part, then each lobe and its
 * derivatives. */
typedef struct btfi_lafortune_point {
  btfi_lafortune_lobe lobe[LAF_MAX_LOBES];
  double cost;
  double albedo[LAF_MAX_ALBEDOS][LAF_MAX_CHANNELS];
  double gram[LAF_MAX_COLUMNS * LAF_MAX_COLUMNS]; /* upper half */
  /* Products with the data, or if refined with what the albedos leave of them. */
  double cross[LAF_MAX_COLUMNS * LAF_MAX_CHANNELS];
  bool refined;
} btfi_lafortune_point;

typedef struct btfi_lafortune_start {
  uint32_t candidate[LAF_MAX_LOBES];
  double cost;
} btfi_lafortune_start;

struct btfi_lafortune_scratch {
  const btfi_lafortune_shared *shared;
  btfi_lafortune_trace_fn trace;
  void *trace_user;
  uint32_t channels, lobes, variables; /* variables of a lobe */
  uint32_t columns;
  double unit;         /* data are divided by it, so that their squares are ordinary numbers */
  double energy;       /* of these */
  const float *values; /* of the group at hand */
  uint32_t stride;
  float *data; /* channels, times the roots of weights */
  float *root; /* of the weights */
  const float *lobe_factor, *diffuse_factor;
  float *own_factor[2]; /* where weights follow the data */
  float *base;          /* of each lobe */
  float *chunk;         /* columns */
  float *left;          /* of the data of a chunk */
  btfi_lafortune_point points[3];
  btfi_lafortune_start pair[LAF_MAX_PAIRS];
  double candidate_gram[(1 + LAF_CANDIDATES) * (1 + LAF_CANDIDATES)];
  double candidate_cross[(1 + LAF_CANDIDATES) * LAF_MAX_CHANNELS];
};

static inline uint32_t btfi_lafortune_lobe_column(const btfi_lafortune_scratch *s, uint32_t lobe) {
  return 1 + lobe * (1 + s->variables);
}

/* Column of albedo i: the diffuse part, then the lobes. */
static inline uint32_t btfi_lafortune_albedo_column(const btfi_lafortune_scratch *s, uint32_t i) {
  return i == 0 ? 0 : btfi_lafortune_lobe_column(s, i - 1);
}

static inline double btfi_lafortune_gram_of(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p,
                                            uint32_t i, uint32_t j) {
  return i < j ? p->gram[i * s->columns + j] : p->gram[j * s->columns + i];
}

/* ---- points (point.c) ---- */

void btfi_lafortune_take_data(btfi_lafortune_scratch *s, const float *values, uint32_t stride,
                              uint32_t channels);
/* Columns of all lobes for samples first .. first + n - 1, in the chunk. */
void btfi_lafortune_make_chunk(btfi_lafortune_scratch *s, const btfi_lafortune_point *p, uint32_t first,
                               uint32_t n);
/* Cholesky factor of the products of the columns with albedos above 0; which[] are those, lobe[] the
 * albedos. */
uint32_t btfi_lafortune_factor_active(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p,
                                      uint32_t channel, uint32_t which[LAF_MAX_ALBEDOS],
                                      uint32_t lobe[LAF_MAX_ALBEDOS],
                                      double l[LAF_MAX_ALBEDOS][LAF_MAX_ALBEDOS]);
/* Sums, albedos and cost of the lobes; false if a lobe must not be, whose sums are not made unless it is
 * `forced`. */
bool btfi_lafortune_evaluate(btfi_lafortune_scratch *s, btfi_lafortune_point *p, bool forced);

/* ---- steps (descend.c) ---- */

typedef struct btfi_lafortune_equations {
  uint32_t n;
  double matrix[LAF_MAX_VARIABLES * LAF_MAX_VARIABLES];
  double slope[LAF_MAX_VARIABLES]; /* minus half the gradient of the cost */
} btfi_lafortune_equations;

void btfi_lafortune_make_equations(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p,
                                   btfi_lafortune_equations *e);
/* Derivatives by a coefficient belong to a lobe whose coefficients are divided by its peak. */
double btfi_lafortune_unit_of(const btfi_lafortune_scratch *s, const btfi_lafortune_point *p, uint32_t v);
/* From points[0], whose lobes are set, to a minimum, left in points[0]. Returns the number of iterations. */
uint32_t btfi_lafortune_descend(btfi_lafortune_scratch *s, const btfi_lafortune_settings *settings,
                                uint32_t start, bool only_diagonal);

/* ---- starts (starts.c) ---- */

/* The best sets of candidates: one or two of all, further ones one by one. Returns how many. */
uint32_t btfi_lafortune_choose_starts(btfi_lafortune_scratch *s, uint32_t wanted, btfi_lafortune_start *out);

#endif
