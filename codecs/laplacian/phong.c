/* SPDX-License-Identifier: MIT */
/* phong.c: equation 5. The paper calls it Phong; with N.H it is Blinn's. */
#include "laplacian.h"

#include <math.h>

/* Along the half vector of two directions, its component on the normal. */
static double half_z(const float *light, const float *view) {
  const double x = (double)light[0] + view[0], y = (double)light[1] + view[1], z = (double)light[2] + view[2];
  const double length = sqrt(x * x + y * y + z * z);
  return length > 0.0 ? fmax(0.0, fmin(1.0, z / length)) : 0.0;
}

float btfi_laplacian_phong_value(const btfi_laplacian_phong *phong, const float light[3],
                                 const float view[3]) {
  const float x = light[0] + view[0], y = light[1] + view[1], z = light[2] + view[2];
  const float length = sqrtf(x * x + y * y + z * z);
  const float along = length > 0.0f ? fmaxf(0.0f, fminf(1.0f, z / length)) : 0.0f;
  return (float)phong->ka + (float)phong->kd * fmaxf(0.0f, light[2]) +
         (float)phong->ks * powf(along, (float)phong->alpha);
}

enum { PARAMETERS = 4 };
/* A column of whose squared norm those before it leave less than this depends on them. Cosines of one
 * elevation differ by the rounding of floats, whose square is 1e-15. */
#define DEPENDENT 1e-10
/* What a term must take away, as a share of the energy: more than samples that are rounded to floats and
 * their luma by products and sums can be off, (4 * 2^-24)^2. */
#define ROUNDING 6e-14

typedef struct phong_data {
  uint32_t lights, views;
  const float *light_xyz, *view_xyz;
  const double *values;
  bool cosine_first;
  double most_alpha;
} phong_data;

/* The model by its first one, two or three terms: what makes the reflectance constant, the other of a
 * constant and a cosine, the lobe. Directions of one elevation cannot tell the first two apart. */
typedef struct parameters {
  uint32_t terms;
  double diffuse[2], ks, alpha;
} parameters;

/* Normal equations J^T J and J^T r of (diffuse, ks, log alpha); returns |r|^2. */
static double normal_equations(const phong_data *d, const parameters *at, double jtj[PARAMETERS][PARAMETERS],
                               double jtr[PARAMETERS]) {
  double cost = 0.0;
  memset(jtj, 0, PARAMETERS * sizeof *jtj);
  memset(jtr, 0, PARAMETERS * sizeof *jtr);
  for (uint32_t view = 0; view < d->views; view++)
    for (uint32_t light = 0; light < d->lights; light++) {
      const float *l = d->light_xyz + 3 * (size_t)light;
      const double along = half_z(l, d->view_xyz + 3 * (size_t)view), cosine = fmax(0.0, (double)l[2]);
      const double lobe = along > 0.0 ? pow(along, at->alpha) : 0.0;
      const double logarithm = along > 0.0 ? log(along) : 0.0;
      const double row[PARAMETERS] = {d->cosine_first ? cosine : 1.0, d->cosine_first ? 1.0 : cosine, lobe,
                                      at->ks * at->alpha * lobe * logarithm};
      const double rest = d->values[3 * ((uint64_t)view * d->lights + light)] - at->diffuse[0] * row[0] -
                          at->diffuse[1] * row[1] - at->ks * lobe;
      cost += rest * rest;
      for (uint32_t i = 0; i < PARAMETERS; i++) {
        jtr[i] += row[i] * rest;
        for (uint32_t j = 0; j <= i; j++) jtj[i][j] += row[i] * row[j];
      }
    }
  return cost;
}

/* Cholesky's factor of J^T J + damping diag of the columns in use. Those that depend on earlier ones leave.
 */
static void factorise(double jtj[PARAMETERS][PARAMETERS], double damping, bool used[PARAMETERS],
                      double l[PARAMETERS][PARAMETERS]) {
  for (uint32_t i = 0; i < PARAMETERS; i++) {
    double pivot = jtj[i][i] * (1.0 + damping);
    for (uint32_t j = 0; j < i && used[i]; j++) {
      if (!used[j]) continue;
      l[i][j] = jtj[i][j];
      for (uint32_t k = 0; k < j; k++)
        if (used[k]) l[i][j] -= l[i][k] * l[j][k];
      l[i][j] /= l[j][j];
      pivot -= l[i][j] * l[i][j];
    }
    used[i] = used[i] && pivot > DEPENDENT * jtj[i][i];
    if (used[i]) l[i][i] = sqrt(pivot);
  }
}

/* Solves (J^T J + damping diag) step = J^T r; columns that are not `used` or depend on others get no step.
 * What depends is told without damping, which would share a height among them. */
static void damped_step(double jtj[PARAMETERS][PARAMETERS], const double jtr[PARAMETERS], double damping,
                        bool used[PARAMETERS], double step[PARAMETERS]) {
  double l[PARAMETERS][PARAMETERS] = {{0.0}};
  factorise(jtj, 0.0, used, l);
  if (damping > 0.0) factorise(jtj, damping, used, l);
  for (uint32_t i = 0; i < PARAMETERS; i++) {
    step[i] = 0.0;
    if (!used[i]) continue;
    step[i] = jtr[i];
    for (uint32_t k = 0; k < i; k++)
      if (used[k]) step[i] -= l[i][k] * step[k];
    step[i] /= l[i][i];
  }
  for (uint32_t i = PARAMETERS; i-- > 0;) {
    if (!used[i]) continue;
    for (uint32_t k = i + 1; k < PARAMETERS; k++)
      if (used[k]) step[i] -= l[k][i] * step[k];
    step[i] /= l[i][i];
  }
}

/* The fewest terms and the least exponent of a range beyond which nothing but rounding is gained; given the
 * exponent the model is linear. Returns what is left. */
static double start(const phong_data *d, double energy, parameters *best) {
  enum { EXPONENTS = 25 };
  double cost = energy;
  *best = (parameters){1, {0.0, 0.0}, 0.0, 1.0};
  for (int i = 0; i < 2 + EXPONENTS; i++) {
    parameters at = {i < 2 ? 1 + (uint32_t)i : 3, {0.0, 0.0}, 0.0, 1.0};
    double jtj[PARAMETERS][PARAMETERS], jtr[PARAMETERS], step[PARAMETERS];
    bool used[PARAMETERS] = {true, at.terms > 1, at.terms > 2, false};
    if (i >= 2) at.alpha = pow(d->most_alpha, (double)(i - 2) / (EXPONENTS - 1));
    normal_equations(d, &at, jtj, jtr);
    damped_step(jtj, jtr, 0.0, used, step);
    at.diffuse[0] = step[0];
    at.diffuse[1] = step[1];
    at.ks = step[2];
    const double left = normal_equations(d, &at, jtj, jtr);
    if (!(left < cost - ROUNDING * energy)) continue;
    cost = left;
    *best = at;
  }
  return cost;
}

/* Levenberg-Marquardt; ends where no step of any length gains. Returns what is left. */
static double descend(const phong_data *d, double cost, parameters *best) {
  enum { STEPS = 200 };
  double jtj[PARAMETERS][PARAMETERS], jtr[PARAMETERS], damping = 1e-3;
  normal_equations(d, best, jtj, jtr);
  for (int i = 0; i < STEPS && damping < 1e12; i++) {
    const bool at_bound = jtr[3] > 0.0 ? best->alpha >= d->most_alpha : best->alpha <= 1.0;
    bool used[PARAMETERS] = {true, best->terms > 1, best->terms > 2, best->terms > 2 && !at_bound};
    double step[PARAMETERS], next_jtj[PARAMETERS][PARAMETERS], next_jtr[PARAMETERS];
    parameters next = *best;
    damped_step(jtj, jtr, damping, used, step);
    for (int k = 0; k < 2; k++) next.diffuse[k] += step[k];
    next.ks += step[2];
    next.alpha = fmin(d->most_alpha, fmax(1.0, best->alpha * exp(fmax(-1.0, fmin(1.0, step[3])))));
    const double next_cost = normal_equations(d, &next, next_jtj, next_jtr);
    if (!(next_cost < cost)) {
      damping *= 10.0;
      continue;
    }
    cost = next_cost;
    *best = next;
    memcpy(jtj, next_jtj, sizeof jtj);
    memcpy(jtr, next_jtr, sizeof jtr);
    damping = fmax(1e-12, damping * 0.1);
  }
  return cost;
}

/* The exponent at which a lobe is twice as high between the samples as at the highest of them. */
static double most_alpha(const phong_data *d) {
  double along = 0.0;
  for (uint32_t view = 0; view < d->views; view++)
    for (uint32_t light = 0; light < d->lights; light++)
      along = fmax(along, half_z(d->light_xyz + 3 * (size_t)light, d->view_xyz + 3 * (size_t)view));
  const double most = along > 0.0 && along < 1.0 ? log(0.5) / log(along) : LAPLACIAN_LARGEST_ALPHA;
  return fmax(1.0, fmin(LAPLACIAN_LARGEST_ALPHA, most));
}

btf_status btfi_laplacian_fit_phong(const btf_host *host, btf_context *ctx, const btf_dirset *lights,
                                    const btf_dirset *views, uint32_t quantity, const double *values,
                                    btfi_laplacian_phong *out, double *rms) {
  phong_data d = {host->dirset_count(lights),
                  host->dirset_count(views),
                  host->dirset_directions(lights),
                  host->dirset_directions(views),
                  values,
                  quantity == BTF_QUANTITY_BRDF_COS,
                  LAPLACIAN_LARGEST_ALPHA};
  const uint64_t pairs = (uint64_t)d.lights * d.views;
  double energy = 0.0;
  for (uint64_t i = 0; i < pairs; i++) energy += values[3 * i] * values[3 * i];
  if (!isfinite(energy))
    return host->fail(ctx, BTF_E_NUMERIC, "laplacian: the samples are too large to fit a mean to");
  d.most_alpha = most_alpha(&d);
  parameters best;
  double cost = start(&d, energy, &best);
  cost = descend(&d, cost, &best);
  out->ka = best.diffuse[d.cosine_first ? 1 : 0];
  out->kd = best.diffuse[d.cosine_first ? 0 : 1];
  out->ks = best.ks;
  out->alpha = best.alpha;
  *rms = sqrt(cost / (double)pairs);
  return BTF_OK;
}
