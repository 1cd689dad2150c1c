/* SPDX-License-Identifier: MIT */
/* solve.c: Levenberg and Marquardt's method for the lobes of one group of channels of one texel. Albedos are
 * linear given the lobes and solved inside (variable projection); of the samples only products of columns are
 * needed, which are the same for all channels. */
#include "lafortune.h"

#include <math.h>
#include <string.h>

#include "kernel.h"

enum {
  MAX_COLUMNS = LAF_MAX_ALBEDOS + LAF_MAX_VARIABLES,
  MAX_PAIRS = LAF_CANDIDATES * (LAF_CANDIDATES - 1) / 2,
  MAX_STARTS = 64
};
#define FIRST_DAMPING 1e-2
#define LEAST_DAMPING 1e-7
#define MOST_DAMPING 1e7
/* No lobe that is allowed is lower at its peak. */
#define LOWEST_HEIGHT 1e-7
/* Shares of the data's energy: what sums of products of floats are off by, and those of what is left of the
 * data; below the last share, what is left is worth making anew. */
#define SUM_ERROR 1e-10
#define REFINED_SUM_ERROR 1e-15
#define WORTH_REFINING 1e-4

/* Lobes with what is known of them. Columns of the sums: the diffuse part, then each lobe and its
 * derivatives. */
typedef struct point {
  btfi_lafortune_lobe lobe[LAF_MAX_LOBES];
  double cost;
  double albedo[LAF_MAX_ALBEDOS][LAF_MAX_CHANNELS];
  double gram[MAX_COLUMNS * MAX_COLUMNS];       /* upper half */
  double cross[MAX_COLUMNS * LAF_MAX_CHANNELS]; /* with the data, or with what the albedos leave of them */
  bool refined;                                 /* the latter */
} point;

typedef struct start_point {
  uint32_t candidate[LAF_MAX_LOBES];
  double cost;
} start_point;

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
  point points[3];
  start_point pair[MAX_PAIRS];
  double candidate_gram[(1 + LAF_CANDIDATES) * (1 + LAF_CANDIDATES)];
  double candidate_cross[(1 + LAF_CANDIDATES) * LAF_MAX_CHANNELS];
};

/* ---- room ---- */

static uint32_t column_count(uint32_t kind, uint32_t lobes) {
  return 1 + lobes * (1 + btfi_lafortune_variables(kind));
}

static uint64_t chunk_columns(uint32_t kind, uint32_t lobes) {
  const uint32_t own = column_count(kind, lobes), start = 1 + LAF_CANDIDATES;
  return own > start ? own : start;
}

uint64_t btfi_lafortune_scratch_bytes(const btfi_lafortune_shared *shared, uint32_t lobes,
                                      uint32_t channels) {
  const uint64_t floats = ((uint64_t)channels + 3 + lobes) * shared->padded;
  const uint64_t bytes = ((sizeof(btfi_lafortune_scratch) + 63) & ~(uint64_t)63) +
                         4 * (floats + (chunk_columns(shared->kind, lobes) + channels) * LAF_LD);
  return (bytes + 63) & ~(uint64_t)63;
}

btfi_lafortune_scratch *btfi_lafortune_scratch_init(void *memory, const btfi_lafortune_shared *shared,
                                                    uint32_t lobes, uint32_t channels) {
  btfi_lafortune_scratch *s = memory;
  const size_t ld = shared->padded;
  memset(s, 0, sizeof *s);
  s->shared = shared;
  s->lobes = lobes;
  s->variables = btfi_lafortune_variables(shared->kind);
  s->columns = column_count(shared->kind, lobes);
  s->chunk = (float *)(void *)((unsigned char *)memory + ((sizeof *s + 63) & ~(size_t)63));
  s->left = s->chunk + chunk_columns(shared->kind, lobes) * LAF_LD;
  s->data = s->left + (size_t)channels * LAF_LD;
  s->root = s->data + channels * ld;
  s->own_factor[0] = s->root + ld;
  s->own_factor[1] = s->own_factor[0] + ld;
  s->base = s->own_factor[1] + ld;
  return s;
}

void btfi_lafortune_scratch_trace(btfi_lafortune_scratch *scratch, btfi_lafortune_trace_fn trace,
                                  void *user) {
  scratch->trace = trace;
  scratch->trace_user = user;
}

/* ---- data ---- */

/* Weights of LAF_LOG: an error counts by its ratio to the value, the first order of a difference of
 * logarithms. A twentieth of the mean keeps dark samples from ruling. */
static void relative_roots(btfi_lafortune_scratch *s) {
  const btfi_lafortune_shared *shared = s->shared;
  double mean = 0.0;
  for (uint32_t i = 0; i < shared->samples; i++) {
    double sum = 0.0;
    for (uint32_t c = 0; c < s->channels; c++) sum += fabs((double)s->values[(size_t)i * s->stride + c]);
    s->root[i] = (float)(sum / s->channels);
    mean += sum / s->channels / shared->samples;
  }
  const double offset = mean > 0.0 ? 0.05 * mean : 1.0;
  for (uint32_t i = 0; i < shared->samples; i++)
    s->root[i] = (float)(shared->weight[i] * offset / ((double)s->root[i] + offset));
  for (uint32_t i = shared->samples; i < shared->padded; i++) s->root[i] = 0.0f;
  for (uint32_t i = 0; i < shared->padded; i++) {
    s->own_factor[0][i] = shared->lobe[i] * s->root[i];
    s->own_factor[1][i] = shared->diffuse[i] * s->root[i];
  }
  s->lobe_factor = s->own_factor[0];
  s->diffuse_factor = s->own_factor[1];
}

static void take_data(btfi_lafortune_scratch *s, const float *values, uint32_t stride, uint32_t channels) {
  const btfi_lafortune_shared *shared = s->shared;
  s->values = values;
  s->stride = stride;
  s->channels = channels;
  if (shared->relative) {
    relative_roots(s);
  } else {
    memcpy(s->root, shared->weight, shared->padded * sizeof *s->root);
    s->lobe_factor = shared->lobe;
    s->diffuse_factor = shared->diffuse;
  }
  float largest = 0.0f;
  for (uint32_t i = 0; i < shared->samples; i++)
    for (uint32_t c = 0; c < channels; c++) largest = fmaxf(largest, fabsf(values[(size_t)i * stride + c]));
  s->unit = largest > 1e-37f ? (double)largest : 1e-37;
  s->energy = 0.0;
  const float factor = (float)(1.0 / s->unit);
  for (uint32_t c = 0; c < channels; c++) {
    float *to = s->data + (size_t)c * shared->padded;
    double sum = 0.0;
    for (uint32_t i = 0; i < shared->samples; i++) {
      to[i] = values[(size_t)i * stride + c] * factor * s->root[i];
      sum += (double)to[i] * (double)to[i];
    }
    for (uint32_t i = shared->samples; i < shared->padded; i++) to[i] = 0.0f;
    s->energy += sum;
  }
}

/* ---- a point: sums, albedos, cost ---- */

static uint32_t lobe_column(const btfi_lafortune_scratch *s, uint32_t lobe) {
  return 1 + lobe * (1 + s->variables);
}

/* Column of albedo i: the diffuse part, then the lobes. */
static uint32_t albedo_column(const btfi_lafortune_scratch *s, uint32_t i) {
  return i == 0 ? 0 : lobe_column(s, i - 1);
}

static double gram_of(const btfi_lafortune_scratch *s, const point *p, uint32_t i, uint32_t j) {
  return i < j ? p->gram[i * s->columns + j] : p->gram[j * s->columns + i];
}

static void make_chunk(btfi_lafortune_scratch *s, const point *p, uint32_t first, uint32_t n) {
  memcpy(s->chunk, s->diffuse_factor + first, n * sizeof *s->chunk);
  for (uint32_t j = 0; j < s->lobes; j++)
    s->shared->kernels->columns(&p->lobe[j], s->shared->term, s->lobe_factor,
                                s->base + (size_t)j * s->shared->padded, first, n,
                                s->chunk + (size_t)lobe_column(s, j) * LAF_LD);
}

static void solve_albedos(const btfi_lafortune_scratch *s, point *p) {
  double gram[LAF_MAX_ALBEDOS * LAF_MAX_ALBEDOS], explained = 0.0;
  const uint32_t n = 1 + s->lobes;
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < n; j++)
      gram[i * n + j] = gram_of(s, p, albedo_column(s, i), albedo_column(s, j));
  for (uint32_t c = 0; c < s->channels; c++) {
    double h[LAF_MAX_ALBEDOS], a[LAF_MAX_ALBEDOS];
    for (uint32_t i = 0; i < n; i++) h[i] = p->cross[albedo_column(s, i) * s->channels + c];
    btfi_lafortune_nonnegative(n, gram, n, h, 1, a);
    for (uint32_t i = 0; i < n; i++) {
      p->albedo[i][c] = a[i];
      explained += a[i] * h[i];
    }
  }
  p->cost = s->energy > explained ? s->energy - explained : 0.0;
}

/* Cholesky factor of the products of the columns with albedos above 0; which[] are those, lobe[] the
 * albedos. */
static uint32_t factor_active(const btfi_lafortune_scratch *s, const point *p, uint32_t channel,
                              uint32_t which[LAF_MAX_ALBEDOS], uint32_t lobe[LAF_MAX_ALBEDOS],
                              double l[LAF_MAX_ALBEDOS][LAF_MAX_ALBEDOS]) {
  uint32_t n = 0;
  for (uint32_t i = 0; i <= s->lobes; i++) {
    if (!(p->albedo[i][channel] > 0.0)) continue;
    const uint32_t column = albedo_column(s, i);
    double pivot = p->gram[column * s->columns + column];
    const double norm = pivot;
    for (uint32_t j = 0; j < n; j++) {
      double sum = gram_of(s, p, which[j], column);
      for (uint32_t k = 0; k < j; k++) sum -= l[n][k] * l[j][k];
      l[n][j] = sum / l[j][j];
      pivot -= l[n][j] * l[n][j];
    }
    if (!(pivot > 1e-12 * norm)) continue;
    l[n][n] = sqrt(pivot);
    lobe[n] = i;
    which[n++] = column;
  }
  return n;
}

/* Columns of what is left of the data behind those of the chunk. Returns its squared norm. */
static double make_left(btfi_lafortune_scratch *s, const point *p, uint32_t first, uint32_t n) {
  double norm = 0.0;
  for (uint32_t c = 0; c < s->channels; c++) {
    const float *data = s->data + (size_t)c * s->shared->padded + first;
    float *left = s->left + (size_t)c * LAF_LD;
    for (uint32_t i = 0; i < n; i++) {
      double value = (double)data[i];
      for (uint32_t j = 0; j <= s->lobes; j++)
        value -= p->albedo[j][c] * (double)s->chunk[(size_t)albedo_column(s, j) * LAF_LD + i];
      left[i] = (float)value;
      norm += value * value;
    }
  }
  return norm;
}

/* Where the model nearly is the data, their products cancel. Products with what is left of the data do not;
 * they also correct the albedos, where those may grow and shrink. */
static void refine(btfi_lafortune_scratch *s, point *p) {
  const btfi_lafortune_shared *shared = s->shared;
  p->cost = 0.0;
  memset(p->cross, 0, (size_t)s->columns * s->channels * sizeof *p->cross);
  for (uint32_t first = 0; first < shared->padded; first += LAF_CHUNK) {
    const uint32_t n = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
    make_chunk(s, p, first, n);
    p->cost += make_left(s, p, first, n);
    shared->kernels->dots(s->chunk, LAF_LD, s->columns, s->left, LAF_LD, s->channels, n, false, p->cross,
                          s->channels);
  }
  p->refined = true;
  for (uint32_t c = 0; c < s->channels; c++) {
    uint32_t which[LAF_MAX_ALBEDOS], lobe[LAF_MAX_ALBEDOS];
    double l[LAF_MAX_ALBEDOS][LAF_MAX_ALBEDOS], step[LAF_MAX_ALBEDOS];
    const uint32_t active = factor_active(s, p, c, which, lobe, l);
    bool stays = true;
    for (uint32_t i = 0; i < active; i++) {
      step[i] = p->cross[which[i] * s->channels + c];
      for (uint32_t k = 0; k < i; k++) step[i] -= l[i][k] * step[k];
      step[i] /= l[i][i];
    }
    for (uint32_t i = active; i-- > 0;) {
      for (uint32_t k = i + 1; k < active; k++) step[i] -= l[k][i] * step[k];
      step[i] /= l[i][i];
      stays = stays && p->albedo[lobe[i]][c] + step[i] >= 0.0;
    }
    for (uint32_t i = 0; i < active && stays; i++) {
      p->albedo[lobe[i]][c] += step[i];
      p->cost = fmax(0.0, p->cost - step[i] * p->cross[which[i] * s->channels + c]);
    }
    for (uint32_t v = 0; v < s->columns && stays; v++)
      for (uint32_t i = 0; i < active; i++)
        if (v != which[i]) p->cross[v * s->channels + c] -= step[i] * gram_of(s, p, which[i], v);
  }
}

/* false if a lobe must not be, whose sums are not made unless it is `forced`. */
static bool evaluate(btfi_lafortune_scratch *s, point *p, bool forced) {
  const btfi_lafortune_shared *shared = s->shared;
  for (uint32_t j = 0; j < s->lobes; j++)
    if (!btfi_lafortune_make_base(shared, &p->lobe[j], s->base + (size_t)j * shared->padded) && !forced)
      return false;
  memset(p->gram, 0, (size_t)s->columns * s->columns * sizeof *p->gram);
  memset(p->cross, 0, (size_t)s->columns * s->channels * sizeof *p->cross);
  for (uint32_t first = 0; first < shared->padded; first += LAF_CHUNK) {
    const uint32_t n = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
    make_chunk(s, p, first, n);
    shared->kernels->dots(s->chunk, LAF_LD, s->columns, s->chunk, LAF_LD, s->columns, n, true, p->gram,
                          s->columns);
    shared->kernels->dots(s->chunk, LAF_LD, s->columns, s->data + first, shared->padded, s->channels, n,
                          false, p->cross, s->channels);
  }
  p->refined = false;
  solve_albedos(s, p);
  if (p->cost < WORTH_REFINING * s->energy) refine(s, p);
  return true;
}

/* ---- the normal equations of the lobes ---- */

typedef struct normal_equations {
  uint32_t n;
  double matrix[LAF_MAX_VARIABLES * LAF_MAX_VARIABLES];
  double slope[LAF_MAX_VARIABLES]; /* minus half the gradient of the cost */
} normal_equations;

static uint32_t variable_column(const btfi_lafortune_scratch *s, uint32_t v) {
  return lobe_column(s, v / s->variables) + 1 + v % s->variables;
}

/* What is left of the products of derivatives once albedos have followed, summed over the channels. */
static void add_channel(const btfi_lafortune_scratch *s, const point *p, uint32_t channel,
                        normal_equations *e) {
  uint32_t which[LAF_MAX_ALBEDOS], lobes[LAF_MAX_ALBEDOS];
  double l[LAF_MAX_ALBEDOS][LAF_MAX_ALBEDOS], w[LAF_MAX_VARIABLES][LAF_MAX_ALBEDOS],
      factor[LAF_MAX_VARIABLES];
  const uint32_t active = factor_active(s, p, channel, which, lobes, l);
  for (uint32_t v = 0; v < e->n; v++) {
    const uint32_t lobe = v / s->variables, column = variable_column(s, v);
    double residual = p->cross[column * s->channels + channel];
    factor[v] = p->albedo[1 + lobe][channel];
    for (uint32_t i = 0; i <= s->lobes && !p->refined; i++)
      residual -= p->albedo[i][channel] * gram_of(s, p, albedo_column(s, i), column);
    for (uint32_t i = 0; i < active; i++) {
      double sum = gram_of(s, p, which[i], column);
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

/* Derivatives by a coefficient belong to a lobe whose coefficients are divided by its peak. */
static double unit_of(const btfi_lafortune_scratch *s, const point *p, uint32_t v) {
  return v % s->variables < btfi_lafortune_free_terms(s->shared->kind)
             ? (double)p->lobe[v / s->variables].peak
             : 1.0;
}

static void make_equations(const btfi_lafortune_scratch *s, const point *p, normal_equations *e) {
  e->n = s->lobes * s->variables;
  memset(e->matrix, 0, (size_t)e->n * e->n * sizeof *e->matrix);
  memset(e->slope, 0, sizeof e->slope);
  for (uint32_t c = 0; c < s->channels; c++) add_channel(s, p, c, e);
  for (uint32_t v = 0; v < e->n; v++) {
    e->slope[v] *= unit_of(s, p, v);
    for (uint32_t u = v; u < e->n; u++) e->matrix[v * e->n + u] *= unit_of(s, p, v) * unit_of(s, p, u);
  }
}

static void divide_by_peaks(const btfi_lafortune_scratch *s, point *p) {
  const uint32_t free_terms = btfi_lafortune_free_terms(s->shared->kind);
  for (uint32_t j = 0; j < s->lobes && free_terms > 0; j++) {
    btfi_lafortune_lobe *lobe = &p->lobe[j];
    for (uint32_t k = 0; k < free_terms; k++) lobe->coefficient[k] /= lobe->peak;
    lobe->peak = 1.0f;
  }
}

/* Solves (matrix + damping * its diagonal) step = slope. Variables that nothing depends on, or that are held,
 * stay. */
static void solve_damped(const normal_equations *e, const bool *held, double damping, double *step) {
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

static void hold_bounds(const btfi_lafortune_scratch *s, const point *p, const normal_equations *e,
                        bool only_diagonal, bool *held) {
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

static void take_step(const btfi_lafortune_scratch *s, const point *from, const double *step, point *to) {
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

/* From points[0], whose lobes are set, to a minimum, left in points[0]. Returns the number of iterations. */
static uint32_t descend(btfi_lafortune_scratch *s, const btfi_lafortune_settings *settings, uint32_t start,
                        bool only_diagonal) {
  point *current = &s->points[0], *trial = &s->points[1];
  normal_equations equations;
  double damping = FIRST_DAMPING, step[LAF_MAX_VARIABLES];
  bool held[LAF_MAX_VARIABLES];
  uint32_t iteration = 0;
  if (!evaluate(s, current, false)) {
    current->cost = INFINITY;
    return 0;
  }
  if (s->trace != NULL) s->trace(s->trace_user, start, current->cost * (s->unit * s->unit));
  make_equations(s, current, &equations);
  divide_by_peaks(s, current);
  while (iteration < settings->iterations && damping < MOST_DAMPING &&
         current->cost > REFINED_SUM_ERROR * s->energy) {
    iteration++;
    hold_bounds(s, current, &equations, only_diagonal, held);
    solve_damped(&equations, held, damping, step);
    take_step(s, current, step, trial);
    if (!evaluate(s, trial, false) || !(trial->cost < current->cost)) {
      damping *= 6.0;
      /* No more to gain than the sums are exact to. */
      double promised = 0.0;
      for (uint32_t v = 0; v < equations.n; v++) promised += equations.slope[v] * step[v];
      if (promised < settings->tolerance * current->cost +
                         (current->refined ? REFINED_SUM_ERROR : SUM_ERROR) * s->energy)
        break;
      continue;
    }
    const double gained = current->cost - trial->cost;
    point *swap = current;
    current = trial;
    trial = swap;
    if (s->trace != NULL) s->trace(s->trace_user, start, current->cost * (s->unit * s->unit));
    make_equations(s, current, &equations);
    divide_by_peaks(s, current);
    damping = fmax(LEAST_DAMPING, damping / 8.0);
    if (gained < settings->tolerance * current->cost) break;
  }
  if (current != &s->points[0]) memcpy(&s->points[0], current, sizeof *current);
  return iteration;
}

/* ---- starts ---- */

/* Products of the candidates and the data. */
static const double *candidate_products(btfi_lafortune_scratch *s) {
  const btfi_lafortune_shared *shared = s->shared;
  const uint32_t n = 1 + shared->candidates, ld = 1 + LAF_CANDIDATES;
  memset(s->candidate_cross, 0, sizeof s->candidate_cross);
  if (!shared->relative) {
    btfi_lafortune_add_dots(shared, shared->column, n, s->data, s->channels, false, s->candidate_cross,
                            s->channels);
    return shared->gram;
  }
  memset(s->candidate_gram, 0, sizeof s->candidate_gram);
  for (uint32_t first = 0; first < shared->padded; first += LAF_CHUNK) {
    const uint32_t rows = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
    for (uint32_t i = 0; i < n; i++)
      for (uint32_t k = 0; k < rows; k++)
        s->chunk[i * LAF_LD + k] =
            shared->column[(size_t)i * shared->padded + first + k] * s->root[first + k];
    shared->kernels->dots(s->chunk, LAF_LD, n, s->chunk, LAF_LD, n, rows, true, s->candidate_gram, ld);
    shared->kernels->dots(s->chunk, LAF_LD, n, s->data + first, shared->padded, s->channels, rows, false,
                          s->candidate_cross, s->channels);
  }
  return s->candidate_gram;
}

/* What a set of candidates explains of the sum over the channels, negated. */
static double rate_set(const double *gram, const double *h, const uint32_t *candidate, uint32_t count) {
  double g[LAF_MAX_ALBEDOS * LAF_MAX_ALBEDOS] = {0}, a[LAF_MAX_ALBEDOS] = {0}, b[LAF_MAX_ALBEDOS] = {0},
                             explained = 0.0;
  uint32_t at[LAF_MAX_ALBEDOS] = {0};
  const uint32_t n = 1 + count;
  for (uint32_t i = 0; i < count; i++) at[1 + i] = 1 + candidate[i];
  for (uint32_t i = 0; i < n; i++) {
    b[i] = h[at[i]];
    for (uint32_t j = 0; j < n; j++)
      g[i * n + j] =
          gram[at[i] < at[j] ? at[i] * (1 + LAF_CANDIDATES) + at[j] : at[j] * (1 + LAF_CANDIDATES) + at[i]];
  }
  btfi_lafortune_nonnegative(n, g, n, b, 1, a);
  for (uint32_t i = 0; i < n; i++) explained += a[i] * b[i];
  return -explained;
}

static bool holds(const start_point *start, uint32_t count, uint32_t candidate) {
  for (uint32_t i = 0; i < count; i++)
    if (start->candidate[i] == candidate) return true;
  return false;
}

/* The best sets of candidates: one or two of all, further ones one by one. Returns how many. */
static uint32_t choose_starts(btfi_lafortune_scratch *s, uint32_t wanted, start_point *out) {
  const uint32_t candidates = s->shared->candidates, first_lobes = s->lobes < 2 ? 1 : 2;
  const double *gram = candidate_products(s);
  double h[1 + LAF_CANDIDATES];
  uint32_t sets = 0, chosen = 0;
  for (uint32_t i = 0; i <= candidates; i++) {
    h[i] = 0.0;
    for (uint32_t c = 0; c < s->channels; c++) h[i] += s->candidate_cross[i * s->channels + c];
  }
  for (uint32_t i = 0; i < candidates; i++)
    for (uint32_t j = first_lobes == 2 ? i + 1 : candidates - 1; j < candidates; j++) {
      start_point *set = &s->pair[sets++];
      set->candidate[0] = i;
      set->candidate[1] = j;
      set->cost = rate_set(gram, h, set->candidate, first_lobes);
    }
  while (chosen < wanted && chosen < sets) {
    uint32_t best = sets;
    for (uint32_t k = 0; k < sets; k++)
      if (best == sets || s->pair[k].cost < s->pair[best].cost) best = k;
    if (s->pair[best].cost == INFINITY) break;
    start_point *start = &out[chosen++];
    *start = s->pair[best];
    s->pair[best].cost = INFINITY;
    for (uint32_t n = first_lobes; n < s->lobes; n++) {
      uint32_t next = 0;
      double least = INFINITY;
      for (uint32_t i = 0; i < candidates; i++) {
        if (holds(start, n, i)) continue;
        start->candidate[n] = i;
        const double cost = rate_set(gram, h, start->candidate, n + 1);
        if (cost < least) {
          least = cost;
          next = i;
        }
      }
      start->candidate[n] = next;
    }
  }
  return chosen;
}

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
static double carried(const btfi_lafortune_scratch *s, const point *p, uint32_t lobe) {
  const uint32_t column = lobe_column(s, lobe);
  double sum = 0.0;
  for (uint32_t c = 0; c < s->channels; c++) sum += p->albedo[1 + lobe][c];
  return sum * sqrt(p->gram[column * s->columns + column]);
}

static void give_albedos(const btfi_lafortune_scratch *s, const point *p, const uint32_t *order,
                         btfi_lafortune_fitted *out) {
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
  start_point start[MAX_STARTS];
  point *best = &s->points[2];
  memset(out, 0, sizeof *out);
  take_data(s, values, stride, channels);
  const uint32_t starts =
      choose_starts(s, settings->starts < MAX_STARTS ? settings->starts : MAX_STARTS, start);
  best->cost = INFINITY;
  for (uint32_t i = 0; i < starts; i++) {
    for (uint32_t j = 0; j < s->lobes; j++)
      btfi_lafortune_lobe_of(s->shared->kind, s->shared->candidate[start[i].candidate[j]],
                             &s->points[0].lobe[j]);
    out->iterations += descend(s, settings, 2 * i, s->shared->kind == LAF_FULL);
    if (s->shared->kind == LAF_FULL && s->points[0].cost < INFINITY)
      out->iterations += descend(s, settings, 2 * i + 1, false);
    if (s->points[0].cost < best->cost) memcpy(best, &s->points[0], sizeof *best);
  }
  if (best->cost == INFINITY) { /* no lobe of this kind shows: its albedo is 0 */
    for (uint32_t j = 0; j < s->lobes; j++)
      btfi_lafortune_lobe_of(s->shared->kind, s->shared->candidate[0], &best->lobe[j]);
    (void)evaluate(s, best, true);
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
  (void)evaluate(s, &s->points[0], true);
}

/* Errors sample by sample, in double. */
static void measure(btfi_lafortune_scratch *s, const point *p, btfi_lafortune_fitted *out) {
  const btfi_lafortune_shared *shared = s->shared;
  out->cost = out->squared_error = out->energy = 0.0;
  for (uint32_t first = 0; first < shared->samples; first += LAF_CHUNK) {
    const uint32_t padded = shared->padded - first < LAF_CHUNK ? shared->padded - first : LAF_CHUNK;
    const uint32_t n = shared->samples - first < padded ? shared->samples - first : padded;
    make_chunk(s, p, first, padded);
    for (uint32_t c = 0; c < s->channels; c++) {
      const float *data = s->data + (size_t)c * shared->padded + first;
      for (uint32_t i = 0; i < n; i++) {
        double left = (double)data[i];
        for (uint32_t j = 0; j <= s->lobes; j++)
          left -= p->albedo[j][c] * (double)s->chunk[(size_t)albedo_column(s, j) * LAF_LD + i];
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
  point *p = &s->points[0];
  evaluate_shapes(s, (const float(*)[LAF_MAX_SHAPE])io->shape);
  give_albedos(s, p, order, io);
  measure(s, p, io);
}

double btfi_lafortune_cost_gradient(btfi_lafortune_scratch *s, const float *values, uint32_t stride,
                                    uint32_t channels, const float (*shape)[LAF_MAX_SHAPE],
                                    double *gradient) {
  normal_equations e;
  btfi_lafortune_fitted fitted;
  take_data(s, values, stride, channels);
  evaluate_shapes(s, shape);
  make_equations(s, &s->points[0], &e);
  for (uint32_t v = 0; v < e.n; v++)
    gradient[v] = -2.0 * (s->unit * s->unit) * e.slope[v] / unit_of(s, &s->points[0], v);
  measure(s, &s->points[0], &fitted);
  return fitted.cost;
}
