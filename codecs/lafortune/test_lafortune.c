/* SPDX-License-Identifier: MIT */
/* The fitter of single ABRDFs, against finite differences, planted lobes, brute force and a slow reference.
 */
#include "test_lobes.h"

#include "kernel.h"

static test_memory memory;

/* ---- a reference in double ---- */

enum { MOST_SAMPLES = 26 * 26, MOST_CHANNELS = 3, MOST_VARIABLES = 20 };

typedef struct reference {
  const abrdf *a;
  uint32_t kind, lobes, variables; /* variables of a lobe */
} reference;

/* Shapes from logarithms of exponents and coefficients. */
static void reference_shapes(const reference *r, const double *x, double shape[][LAF_MAX_SHAPE]) {
  for (uint32_t j = 0; j < r->lobes; j++, x += r->variables)
    for (uint32_t i = 0; i < r->variables; i++) {
      const int logarithm = r->kind != LAF_WARD && i == r->variables - 1;
      shape[j][i] = r->kind == LAF_WARD ? exp(-0.5 * x[i]) : logarithm ? exp(x[i]) : x[i];
    }
}

/* Least squares over a >= 0 by trying every set of positive unknowns (Gauss with pivots), for one right side.
 */
static void brute_force_albedos(uint32_t n, const double *gram, const double *h, double *best) {
  double least = 0.0;
  memset(best, 0, n * sizeof *best);
  for (uint32_t set = 1; set < 1u << n; set++) {
    double m[5][6] = {{0}}, cost = 0.0;
    uint32_t which[5], count = 0;
    for (uint32_t i = 0; i < n; i++)
      if (set >> i & 1) which[count++] = i;
    for (uint32_t i = 0; i < count; i++) {
      for (uint32_t j = 0; j < count; j++) m[i][j] = gram[which[i] * n + which[j]];
      m[i][count] = h[which[i]];
    }
    int usable = 1;
    for (uint32_t k = 0; k < count && usable; k++) {
      uint32_t pivot = k;
      for (uint32_t i = k; i < count; i++)
        if (fabs(m[i][k]) > fabs(m[pivot][k])) pivot = i;
      for (uint32_t j = 0; j <= count; j++) {
        const double swap = m[k][j];
        m[k][j] = m[pivot][j];
        m[pivot][j] = swap;
      }
      usable = fabs(m[k][k]) > 1e-9 * gram[which[k] * n + which[k]];
      for (uint32_t i = 0; i < count && usable; i++) {
        if (i == k) continue;
        const double factor = m[i][k] / m[k][k];
        for (uint32_t j = k; j <= count; j++) m[i][j] -= factor * m[k][j];
      }
    }
    for (uint32_t i = 0; i < count && usable; i++) {
      const double a = m[i][count] / m[i][i];
      usable = a >= 0.0;
      cost -= a * h[which[i]];
    }
    if (!usable || cost >= least) continue;
    least = cost;
    memset(best, 0, n * sizeof *best);
    for (uint32_t i = 0; i < count; i++) best[which[i]] = m[i][count] / m[i][i];
  }
}

/* Residuals with the best albedos, sample by sample and channel by channel; returns their squared norm. */
static double reference_residuals(const reference *r, const double *x, double *residual) {
  static double column[5][MOST_SAMPLES];
  const abrdf *a = r->a;
  const uint32_t n = a->count * a->count, k = 1 + r->lobes;
  double shape[LAF_MAX_LOBES][LAF_MAX_SHAPE], gram[25], cost = 0.0;
  reference_shapes(r, x, shape);
  for (uint32_t i = 0; i < n; i++) {
    column[0][i] = 1.0;
    for (uint32_t j = 0; j < r->lobes; j++)
      column[1 + j][i] =
          planted_lobe(r->kind, shape[j], a->xyz + 3 * (i % a->count), a->xyz + 3 * (i / a->count));
  }
  for (uint32_t i = 0; i < k; i++)
    for (uint32_t j = 0; j < k; j++) {
      gram[i * k + j] = 0.0;
      for (uint32_t s = 0; s < n; s++) gram[i * k + j] += column[i][s] * column[j][s];
    }
  for (uint32_t c = 0; c < a->channels; c++) {
    double h[5] = {0}, albedo[5];
    for (uint32_t i = 0; i < k; i++)
      for (uint32_t s = 0; s < n; s++) h[i] += column[i][s] * (double)a->values[s * a->channels + c];
    brute_force_albedos(k, gram, h, albedo);
    for (uint32_t s = 0; s < n; s++) {
      double left = (double)a->values[s * a->channels + c];
      for (uint32_t i = 0; i < k; i++) left -= albedo[i] * column[i][s];
      if (residual != NULL) residual[s * a->channels + c] = left;
      cost += left * left;
    }
  }
  return cost;
}

/* ---- the gradient ---- */

static void random_shape(uint32_t kind, double *shape) {
  for (int i = 0; i < 9; i++) shape[i] = 0.3 * (2.0 * test_random() - 1.0);
  switch (kind) {
  case LAF_DIAGONAL:
    shape[0] = -0.6 - 0.5 * test_random();
    shape[1] = -0.6 - 0.5 * test_random();
    shape[2] = 0.7 + 0.3 * test_random();
    shape[3] = 2.0 + 20.0 * test_random();
    break;
  case LAF_FULL:
    shape[0] = -0.6 - 0.5 * test_random();
    shape[4] = -0.6 - 0.5 * test_random();
    shape[8] = 0.7 + 0.3 * test_random();
    shape[9] = 2.0 + 10.0 * test_random();
    break;
  case LAF_WARD:
    shape[0] = 0.15 + 0.4 * test_random();
    shape[1] = 0.15 + 0.4 * test_random();
    break;
  default:
    shape[0] = 2.0 + 20.0 * test_random();
    break;
  }
}

static planted random_planted(uint32_t kind, uint32_t lobes, uint32_t channels) {
  planted p = {.kind = kind, .lobes = lobes, .channels = channels};
  for (uint32_t j = 0; j < lobes; j++) random_shape(kind, p.shape[j]);
  for (uint32_t c = 0; c < channels; c++)
    for (uint32_t j = 0; j <= lobes; j++) p.albedo[j][c] = 0.1 + 0.5 * test_random();
  return p;
}

/* Against central differences of the reference's cost. The codec's gradient is made of float columns (a few
 * 1e-7 of their values, n times that for powers: 1e-5) and sums of products that cancel; differences with a
 * step of 1e-4 are exact to about 1e-8 relative to the second derivatives, which are of the size of the cost.
 */
static void test_gradient(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint32_t kind = 0; kind < LAF_KINDS; kind++) {
    for (uint32_t lobes = 1; lobes <= 2; lobes++) {
      abrdf a = abrdf_create(ctx, "grid:6x4", 3);
      const uint32_t variables = btfi_lafortune_variables(kind);
      const reference r = {&a, kind, lobes, variables};
      test_seed(kind * 7 + lobes);
      planted at = random_planted(kind, lobes, 3);
      planted data = random_planted(kind, lobes, 3);
      abrdf_fill(&a, &data, 0.05);
      fitter f = fitter_create(ctx, &a, kind, LAF_UNIFORM, lobes, BTF_QUANTITY_BRDF);
      float shape[LAF_MAX_LOBES][LAF_MAX_SHAPE];
      double x[MOST_VARIABLES], gradient[LAF_MAX_VARIABLES], largest = 0.0;
      for (uint32_t j = 0; j < lobes; j++)
        for (uint32_t i = 0; i < LAF_MAX_SHAPE; i++) shape[j][i] = (float)at.shape[j][i];
      for (uint32_t j = 0; j < lobes; j++)
        for (uint32_t i = 0; i < variables; i++) {
          const double value = (double)shape[j][i];
          x[j * variables + i] = kind == LAF_WARD     ? -2.0 * log(value)
                                 : i == variables - 1 ? log(value)
                                                      : value;
        }
      const double cost = btfi_lafortune_cost_gradient(f.scratch, a.values, 3, 3,
                                                       (const float(*)[LAF_MAX_SHAPE])shape, gradient);
      assert_relative(cost, reference_residuals(&r, x, NULL), 1e-4);
      for (uint32_t v = 0; v < lobes * variables; v++) largest = fmax(largest, fabs(gradient[v]));
      assert_true(largest > 1e-3 * cost);
      for (uint32_t v = 0; v < lobes * variables; v++) {
        const double step = 1e-4, middle = x[v];
        x[v] = middle + step;
        const double above = reference_residuals(&r, x, NULL);
        x[v] = middle - step;
        const double below = reference_residuals(&r, x, NULL);
        x[v] = middle;
        const double expected = (above - below) / (2.0 * step);
        if (fabs(gradient[v] - expected) > 2e-3 * largest)
          fail_msg("kind %u, %u lobes, variable %u: %.9g, differences give %.9g", kind, lobes, v, gradient[v],
                   expected);
      }
      fitter_release(&f);
      abrdf_release(&a);
    }
  }
  test_context_done(ctx, &memory);
}

/* ---- planted lobes ---- */

/* The lobes have their own scale: their coefficients are compared divided by the largest base of the samples.
 */
static void normalise(const abrdf *a, uint32_t kind, double *shape, double *albedo, uint32_t channels,
                      uint32_t stride) {
  double largest = 0.0;
  const uint32_t terms = btfi_lafortune_free_terms(kind);
  if (terms == 0) return;
  const double exponent = shape[terms];
  double one[LAF_MAX_SHAPE];
  memcpy(one, shape, sizeof one);
  one[terms] = 1.0;
  for (uint32_t i = 0; i < a->count * a->count; i++)
    largest =
        fmax(largest, planted_lobe(kind, one, a->xyz + 3 * (i % a->count), a->xyz + 3 * (i / a->count)));
  for (uint32_t i = 0; i < terms; i++) shape[i] /= largest;
  for (uint32_t c = 0; c < channels; c++) albedo[c * stride] *= pow(largest, exponent);
}

static void check_recovery(btf_context *ctx, const planted *truth, const char *directions, double tolerance) {
  abrdf a = abrdf_create(ctx, directions, truth->channels);
  abrdf_fill(&a, truth, 0.0);
  fitter f = fitter_create(ctx, &a, truth->kind, LAF_UNIFORM, truth->lobes, BTF_QUANTITY_BRDF);
  btfi_lafortune_fitted fitted;
  const uint32_t values = btfi_lafortune_shape_values(truth->kind);
  f.settings.starts = 8;
  f.settings.iterations = 300;
  f.settings.tolerance = 1e-9;
  btfi_lafortune_fit_group(f.scratch, &f.settings, a.values, truth->channels, truth->channels, &fitted);
  bool taken[LAF_MAX_LOBES] = {false};
  for (uint32_t c = 0; c < truth->channels; c++)
    assert_relative(fitted.albedo[0][c], truth->albedo[0][c], tolerance);
  for (uint32_t j = 0; j < truth->lobes; j++) {
    double expected[LAF_MAX_SHAPE], scale[8], least = INFINITY;
    uint32_t match = 0;
    memcpy(expected, truth->shape[j], sizeof expected);
    for (uint32_t c = 0; c < truth->channels; c++) scale[c] = truth->albedo[1 + j][c];
    normalise(&a, truth->kind, expected, scale, truth->channels, 1);
    /* The order of the lobes is the fitter's own. */
    for (uint32_t i = 0; i < truth->lobes; i++) {
      double distance = 0.0;
      for (uint32_t k = 0; k < values; k++) distance += fabs((double)fitted.shape[i][k] - expected[k]);
      if (!taken[i] && distance < least) {
        least = distance;
        match = i;
      }
    }
    taken[match] = true;
    const double norm = btfi_lafortune_free_terms(truth->kind) > 0 ? 1.0 : 0.0;
    for (uint32_t k = 0; k < values; k++) {
      /* Coefficients relative to the largest of them. */
      const double size = k + 1 < values && norm > 0.0 ? fmax(norm, fabs(expected[k])) : fabs(expected[k]);
      if (fabs((double)fitted.shape[match][k] - expected[k]) > tolerance * size)
        fail_msg("kind %u, lobe %u, value %u: %.9g instead of %.9g", truth->kind, j, k,
                 (double)fitted.shape[match][k], expected[k]);
    }
    for (uint32_t c = 0; c < truth->channels; c++)
      assert_relative(fitted.albedo[1 + match][c], scale[c], tolerance);
  }
  fitter_release(&f);
  abrdf_release(&a);
}

/* ANA01, ANA02, ANA11: recovered to 1e-3 relative. */
static void test_planted(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const planted one = {LAF_DIAGONAL, 1, 3, {{-0.9, -1.0, 0.8, 15.0}}, {{0.2, 0.15, 0.1}, {0.5, 0.4, 0.6}}};
  const planted two = {LAF_DIAGONAL,
                       2,
                       3,
                       {{-1.0, -0.9, 0.95, 20.0}, {0.9, 1.0, 0.7, 6.0}},
                       {{0.2, 0.15, 0.1}, {0.5, 0.4, 0.6}, {0.3, 0.1, 0.2}}};
  const planted full = {LAF_FULL,
                        1,
                        3,
                        {{-0.9, 0.15, 0.1, -0.2, -1.0, 0.05, 0.12, -0.08, 0.9, 9.0}},
                        {{0.2, 0.15, 0.1}, {0.5, 0.4, 0.6}}};
  check_recovery(ctx, &one, "grid:10x5", 1e-3);
  check_recovery(ctx, &two, "grid:10x5", 1e-3);
  check_recovery(ctx, &full, "grid:10x5", 1e-3);
  for (uint32_t kind = LAF_PHONG; kind < LAF_KINDS; kind++) {
    for (uint64_t seed = 0; seed < 6; seed++) {
      test_seed(seed);
      const planted p = random_planted(kind, 1, 3);
      check_recovery(ctx, &p, "grid:10x5", 1e-3);
    }
  }
  for (uint64_t seed = 0; seed < 10; seed++) {
    test_seed(seed);
    const planted p = random_planted(LAF_DIAGONAL, 1, 2);
    check_recovery(ctx, &p, "grid:10x5", 1e-3);
  }
  test_context_done(ctx, &memory);
}

/* ---- a slow independent solver ---- */

/* Solves (m + damping diag) step = b by Gauss with pivots. */
static void reference_step(uint32_t n, const double *m, double damping, const double *b, double *step) {
  double g[MOST_VARIABLES][MOST_VARIABLES + 1];
  for (uint32_t i = 0; i < n; i++) {
    for (uint32_t j = 0; j < n; j++) g[i][j] = m[i * n + j] + (i == j ? damping * m[i * n + i] + 1e-12 : 0.0);
    g[i][n] = b[i];
  }
  for (uint32_t k = 0; k < n; k++) {
    uint32_t pivot = k;
    for (uint32_t i = k; i < n; i++)
      if (fabs(g[i][k]) > fabs(g[pivot][k])) pivot = i;
    for (uint32_t j = 0; j <= n; j++) {
      const double swap = g[k][j];
      g[k][j] = g[pivot][j];
      g[pivot][j] = swap;
    }
    for (uint32_t i = 0; i < n; i++) {
      if (i == k) continue;
      const double factor = g[i][k] / g[k][k];
      for (uint32_t j = k; j <= n; j++) g[i][j] -= factor * g[k][j];
    }
  }
  for (uint32_t i = 0; i < n; i++) step[i] = g[i][n] / g[i][i];
}

/* Levenberg and Marquardt with a Jacobian by differences, from one point. */
static double reference_descend(const reference *r, double *x) {
  enum { MOST_RESIDUALS = MOST_SAMPLES * MOST_CHANNELS };
  static double residual[MOST_RESIDUALS], moved[MOST_RESIDUALS], jacobian[MOST_VARIABLES][MOST_RESIDUALS];
  const uint32_t n = r->lobes * r->variables, m = r->a->count * r->a->count * r->a->channels;
  double cost = reference_residuals(r, x, residual), damping = 1e-2;
  for (int iteration = 0; iteration < 25; iteration++) {
    double matrix[MOST_VARIABLES * MOST_VARIABLES], slope[MOST_VARIABLES], step[MOST_VARIABLES],
        next[MOST_VARIABLES];
    for (uint32_t v = 0; v < n; v++) {
      const double h = 1e-5, middle = x[v];
      x[v] = middle + h;
      (void)reference_residuals(r, x, moved);
      x[v] = middle;
      for (uint32_t i = 0; i < m; i++) jacobian[v][i] = (moved[i] - residual[i]) / h;
    }
    for (uint32_t v = 0; v < n; v++) {
      slope[v] = 0.0;
      for (uint32_t i = 0; i < m; i++) slope[v] -= jacobian[v][i] * residual[i];
      for (uint32_t u = 0; u < n; u++) {
        matrix[v * n + u] = 0.0;
        for (uint32_t i = 0; i < m; i++) matrix[v * n + u] += jacobian[v][i] * jacobian[u][i];
      }
    }
    double trial = INFINITY;
    while (damping < 1e6) {
      reference_step(n, matrix, damping, slope, step);
      for (uint32_t v = 0; v < n; v++) next[v] = x[v] + fmax(-1.0, fmin(1.0, step[v]));
      for (uint32_t v = r->variables - 1; v < n; v += r->variables)
        next[v] = fmax(log(LAF_MIN_EXPONENT), fmin(log(LAF_MAX_EXPONENT), next[v]));
      trial = reference_residuals(r, next, NULL);
      if (trial < cost) break;
      damping *= 8.0;
    }
    if (!(trial < cost)) break;
    const double gained = cost - trial;
    memcpy(x, next, n * sizeof *x);
    cost = reference_residuals(r, x, residual);
    damping = fmax(1e-9, damping / 8.0);
    if (gained < 1e-5 * cost) break;
  }
  return cost;
}

/* ANA03: 100 random problems, one or two lobes, noise of all sizes. */
static void test_reference_minimum(void **unused) {
  (void)unused;
  enum { STARTS = 8 };
  btf_context *ctx = test_context(&memory);
  double worst = 0.0;
  uint32_t above = 0;
  for (uint32_t problem = 0; problem < 100; problem++) {
    abrdf a = abrdf_create(ctx, "grid:5x3", 1 + problem % 2);
    const uint32_t lobes = 1 + problem / 2 % 2;
    const reference r = {&a, LAF_DIAGONAL, lobes, 4};
    test_seed(problem + 1000);
    planted p = random_planted(LAF_DIAGONAL, 2, a.channels);
    abrdf_fill(&a, &p, problem % 5 == 0 ? 0.4 : 0.02 + 0.1 * test_random());
    double best = INFINITY;
    for (int start = 0; start < STARTS; start++) {
      double x[MOST_VARIABLES];
      for (uint32_t j = 0; j < lobes; j++) {
        for (int i = 0; i < 3; i++) x[4 * j + i] = 2.0 * test_random() - 1.0;
        x[4 * j + 2] = fabs(x[4 * j + 2]);
        x[4 * j + 3] = 3.5 * test_random();
        if (start == 0)
          for (int i = 0; i < 4; i++) x[4 * j + i] = i == 3 ? log(p.shape[j][3]) : p.shape[j][i];
      }
      best = fmin(best, reference_descend(&r, x));
    }
    fitter f = fitter_create(ctx, &a, LAF_DIAGONAL, LAF_UNIFORM, lobes, BTF_QUANTITY_BRDF);
    btfi_lafortune_fitted fitted;
    f.settings.starts = 64;
    btfi_lafortune_fit_group(f.scratch, &f.settings, a.values, a.channels, a.channels, &fitted);
    worst = fmax(worst, fitted.cost / best);
    above += fitted.cost > 1.01 * best;
    fitter_release(&f);
    abrdf_release(&a);
  }
  printf("100 problems: worst cost %.4f of the reference's, %u above by more than 1 %%\n", worst, above);
  assert_int_equal(above, 0);
  test_context_done(ctx, &memory);
}

/* ---- parts ---- */

typedef struct cost_trace {
  uint32_t start, points;
  double cost;
  int rises;
} cost_trace;

static void trace_cost(void *user, uint32_t start, double cost) {
  cost_trace *t = user;
  if (t->points > 0 && start == t->start && !(cost <= t->cost)) t->rises++;
  t->start = start;
  t->cost = cost;
  t->points++;
}

/* ANA03: no accepted point is worse than the one before, and bounds hold. */
static void test_monotone(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint32_t kind = 0; kind < LAF_KINDS; kind++) {
    for (uint32_t weights = 0; weights < 3; weights++) {
      abrdf a = abrdf_create(ctx, "grid:6x4", 3);
      const uint32_t lobes = 1 + (kind + weights) % 3;
      test_seed(kind + 10 * weights);
      planted p = random_planted(kind, 2, 3);
      abrdf_fill(&a, &p, 0.1);
      fitter f = fitter_create(ctx, &a, kind, weights, lobes, BTF_QUANTITY_BRDF);
      cost_trace trace = {0};
      btfi_lafortune_fitted fitted;
      btfi_lafortune_scratch_trace(f.scratch, trace_cost, &trace);
      btfi_lafortune_fit_group(f.scratch, &f.settings, a.values, 3, 3, &fitted);
      assert_int_equal(trace.rises, 0);
      assert_true(trace.points >= 6);
      assert_true(fitted.cost >= 0.0);
      for (uint32_t j = 0; j < lobes; j++) {
        const float exponent = fitted.shape[j][btfi_lafortune_shape_values(kind) - 1];
        if (kind == LAF_WARD)
          assert_true((double)exponent >= 0.999 * LAF_MIN_ROUGHNESS &&
                      (double)exponent <= 1.001 * LAF_MAX_ROUGHNESS);
        else
          assert_true((double)exponent >= LAF_MIN_EXPONENT && (double)exponent <= LAF_MAX_EXPONENT);
        for (uint32_t c = 0; c < 3; c++) assert_true(fitted.albedo[j][c] >= 0.0);
      }
      fitter_release(&f);
      abrdf_release(&a);
    }
  }
  test_context_done(ctx, &memory);
}

/* Albedos against every set of positive unknowns. */
static void test_nonnegative(void **unused) {
  (void)unused;
  uint32_t bound = 0;
  test_seed(5);
  for (int turn = 0; turn < 3000; turn++) {
    const uint32_t n = 1 + (uint32_t)turn % 5, rows = 8;
    double column[5][8], gram[25], h[5], a[5], expected[5], got = 0.0, best = 0.0;
    for (uint32_t i = 0; i < n; i++)
      for (uint32_t s = 0; s < rows; s++)
        column[i][s] = turn % 3 == 0 ? test_random() : 2.0 * test_random() - 0.7;
    if (turn % 17 == 0 && n > 2) memcpy(column[2], column[0], sizeof column[2]);
    if (turn % 19 == 0) memset(column[n - 1], 0, sizeof column[0]);
    for (uint32_t i = 0; i < n; i++) {
      h[i] = 0.0;
      for (uint32_t s = 0; s < rows; s++) h[i] += column[i][s] * cos(3.0 * s + turn);
      for (uint32_t j = 0; j < n; j++) {
        gram[i * n + j] = 0.0;
        for (uint32_t s = 0; s < rows; s++) gram[i * n + j] += column[i][s] * column[j][s];
      }
    }
    btfi_lafortune_nonnegative(n, gram, n, h, 1, a);
    brute_force_albedos(n, gram, h, expected);
    for (uint32_t i = 0; i < n; i++) {
      assert_true(a[i] >= 0.0);
      bound += a[i] == 0.0;
      got -= 2.0 * a[i] * h[i];
      best -= expected[i] * h[i];
      for (uint32_t j = 0; j < n; j++) got += a[i] * a[j] * gram[i * n + j];
    }
    /* Rounding of sums of a few products of numbers of size 10. */
    if (got > best + 1e-9) fail_msg("turn %d: %.12g instead of %.12g", turn, got, best);
  }
  assert_true(bound > 1000);
}

/* Kernels of this machine against the scalar ones. Bases: a rounding error a term. Lobes: the error of the
 * base (4 roundings of 6e-8) times the exponent, and that of the power, at most 60 * 3e-7 in the exponent
 * of 2. Derivatives the same; that by the exponent takes its logarithm of a share of the peak, which is off
 * by 3 roundings, even where it is 0. Sums: 8 lanes of up to 32 float additions. */
static void test_kernels(void **unused) {
  (void)unused;
  const btfi_lafortune_kernels *fast = btfi_lafortune_kernels_of(BTF_ISA_AVX2),
                               *plain = &btfi_lafortune_scalar;
#if defined(__x86_64__)
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma") || !__builtin_cpu_supports("f16c"))
    skip();
#endif
  enum { N = LAF_CHUNK };
  static float terms[9][N], factor[N], base[2][N], column[2][11 * LAF_LD];
  const float *term[9];
  test_seed(11);
  for (int k = 0; k < 9; k++) {
    term[k] = terms[k];
    for (int i = 0; i < N; i++) terms[k][i] = (float)(2.0 * test_random() - 1.0);
  }
  for (int i = 0; i < N; i++) factor[i] = (float)test_random();
  for (uint32_t kind = 0; kind < LAF_KINDS; kind++) {
    for (int turn = 0; turn < 50; turn++) {
      btfi_lafortune_lobe lobe = {.kind = kind, .terms = btfi_lafortune_term_count(kind)};
      lobe.exponent = (float)(0.5 * pow(2000.0, test_random()));
      for (uint32_t k = 0; k < lobe.terms; k++)
        lobe.coefficient[k] =
            kind == LAF_WARD ? (float)(-20.0 * test_random()) : (float)(2.0 * test_random() - 1.0);
      const uint32_t n = 8 * (1 + (uint32_t)(test_random() * (N / 8 - 1)));
      const float largest = plain->base(&lobe, term, n, base[0]);
      assert_near((double)fast->base(&lobe, term, n, base[1]), (double)largest, 1e-5 * (double)lobe.terms);
      for (uint32_t i = 0; i < n; i++)
        assert_near((double)base[1][i], (double)base[0][i], 1e-6 * (kind == LAF_WARD ? 40.0 : 9.0));
      lobe.peak = kind == LAF_WARD || largest > 0.0f ? largest : 1.0f;
      const uint32_t columns = 1 + btfi_lafortune_variables(kind);
      plain->columns(&lobe, term, factor, base[0], 0, n, column[0]);
      fast->columns(&lobe, term, factor, base[0], 0, n, column[1]);
      for (uint32_t k = 0; k < columns; k++)
        for (uint32_t i = 0; i < n; i++) {
          const double expected = (double)column[0][k * LAF_LD + i], got = (double)column[1][k * LAF_LD + i];
          /* Either may count a lobe of 2^-60 as 0; its derivative is larger by exponent / least base. */
          const double negligible =
              1e-18 * (k == 0 ? 1.0 : (double)lobe.exponent * 1e4 / (double)fabsf(lobe.peak));
          const double of_share =
              k + 1 == columns && kind != LAF_WARD ? 2e-7 * (double)(lobe.exponent * factor[i]) : 0.0;
          if (fabs(got - expected) >
              (2e-5 + 2e-7 * (double)lobe.exponent) * fabs(expected) + negligible + of_share)
            fail_msg("kind %u, column %u, sample %u: %.9g instead of %.9g", kind, k, i, got, expected);
        }
    }
  }
  for (uint32_t rows = 1; rows <= 7; rows++)
    for (uint32_t columns = 1; columns <= 9; columns++)
      for (int upper = 0; upper < 2; upper++) {
        double sums[2][81] = {{0}};
        const uint32_t a_count = upper ? columns : rows;
        const size_t ld = LAF_LD;
        for (size_t i = 0; i < 9 * ld; i++) column[0][i] = (float)(2.0 * test_random() - 1.0);
        plain->dots(column[0], ld, a_count, column[0], ld, columns, N, upper, sums[0], columns);
        fast->dots(column[0], ld, a_count, column[0], ld, columns, N, upper, sums[1], columns);
        for (uint32_t i = 0; i < a_count; i++)
          for (uint32_t j = upper ? i : 0; j < columns; j++)
            assert_near(sums[1][i * columns + j], sums[0][i * columns + j], 36 * 6e-8 * N);
      }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_gradient), cmocka_unit_test(test_planted),
      cmocka_unit_test(test_monotone), cmocka_unit_test(test_nonnegative),
      cmocka_unit_test(test_kernels),  cmocka_unit_test(test_reference_minimum)};
  return btf_run("lafortune", tests);
}
