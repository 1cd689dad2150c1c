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

typedef struct phong_data {
  const btf_host *host;
  btf_context *ctx;
  uint32_t lights, views;
  const float *light_xyz, *view_xyz;
  const double *values;
  /* A power of two that brings the values near 1: the column of the exponent has their unit and the others
   * have none, and damping weighs them against each other. */
  double unit;
} phong_data;

/* Normal equations J^T J and J^T r over the first n of (ka, kd, ks, log alpha); returns |r|^2. */
static double normal_equations(const phong_data *d, const btfi_laplacian_phong *at, uint32_t n, double *jtj,
                               double *jtr) {
  double cost = 0.0, logarithm = 0.0;
  for (uint32_t i = 0; i < n * n; i++) jtj[i] = 0.0;
  for (uint32_t i = 0; i < n; i++) jtr[i] = 0.0;
  for (uint32_t view = 0; view < d->views; view++)
    for (uint32_t light = 0; light < d->lights; light++) {
      const float *l = d->light_xyz + 3 * (size_t)light;
      const double along = half_z(l, d->view_xyz + 3 * (size_t)view);
      const double lobe = along > 0.0 ? pow(along, at->alpha) : 0.0;
      logarithm = along > 0.0 ? log(along) : 0.0;
      const double row[4] = {1.0, fmax(0.0, (double)l[2]), lobe, at->ks * at->alpha * lobe * logarithm};
      const double rest = d->unit * d->values[3 * ((uint64_t)view * d->lights + light)] - at->ka -
                          at->kd * row[1] - at->ks * lobe;
      cost += rest * rest;
      for (uint32_t i = 0; i < n; i++) {
        jtr[i] += row[i] * rest;
        for (uint32_t j = 0; j <= i; j++) jtj[i * n + j] += row[i] * row[j];
      }
    }
  for (uint32_t i = 0; i < n; i++)
    for (uint32_t j = 0; j < i; j++) jtj[j * n + i] = jtj[i * n + j];
  return cost;
}

/* Solves (J^T J + damping diag) step = J^T r. */
static btf_status damped_step(const phong_data *d, uint32_t n, const double *jtj, const double *jtr,
                              double damping, double *step) {
  double a[16], largest = 0.0;
  for (uint32_t i = 0; i < n; i++) largest = fmax(largest, jtj[i * n + i]);
  memcpy(a, jtj, n * n * sizeof *a);
  /* Columns that vanish or depend on others, as with few directions, get no step of their own. */
  for (uint32_t i = 0; i < n; i++) a[i * n + i] += damping * jtj[i * n + i] + 1e-13 * largest + 1e-300;
  memcpy(step, jtr, n * sizeof *step);
  BTF_TRY(d->host->cholesky(d->ctx, n, a));
  return d->host->cholesky_solve(d->ctx, n, a, 1, step);
}

/* The best of a range of exponents, the rest of the model being linear. */
static btf_status start(const phong_data *d, btfi_laplacian_phong *best, double *cost) {
  enum { STARTS = 25 };
  *cost = INFINITY;
  for (int i = 0; i < STARTS; i++) {
    btfi_laplacian_phong at = {0.0, 0.0, 0.0, pow(LAPLACIAN_LARGEST_ALPHA, (double)i / (STARTS - 1))};
    double jtj[16], jtr[4], step[4];
    normal_equations(d, &at, 3, jtj, jtr);
    BTF_TRY(damped_step(d, 3, jtj, jtr, 1e-12, step));
    at.ka = step[0];
    at.kd = step[1];
    at.ks = step[2];
    const double left = normal_equations(d, &at, 3, jtj, jtr);
    if (left < *cost) {
      *cost = left;
      *best = at;
    }
  }
  return BTF_OK;
}

btf_status btfi_laplacian_fit_phong(const btf_host *host, btf_context *ctx, const btf_dirset *lights,
                                    const btf_dirset *views, const double *values, btfi_laplacian_phong *out,
                                    double *rms) {
  enum { STEPS = 200 };
  const uint64_t pairs = (uint64_t)host->dirset_count(lights) * host->dirset_count(views);
  double largest = 0.0;
  int exponent = 0;
  for (uint64_t i = 0; i < pairs; i++) largest = fmax(largest, fabs(values[3 * i]));
  if (isfinite(largest)) (void)frexp(largest, &exponent);
  const phong_data d = {host,
                        ctx,
                        host->dirset_count(lights),
                        host->dirset_count(views),
                        host->dirset_directions(lights),
                        host->dirset_directions(views),
                        values,
                        ldexp(1.0, -exponent)};
  btfi_laplacian_phong best = {0.0, 0.0, 0.0, 1.0};
  double cost, jtj[16], jtr[4], damping = 1e-3;
  BTF_TRY(start(&d, &best, &cost));
  if (!isfinite(cost))
    return host->fail(ctx, BTF_E_NUMERIC, "laplacian: the samples are too large to fit a mean to");
  normal_equations(&d, &best, 4, jtj, jtr);
  /* Levenberg-Marquardt; ends where no step of any length gains. */
  for (int i = 0; i < STEPS && damping < 1e12; i++) {
    btfi_laplacian_phong next;
    double step[4], next_jtj[16], next_jtr[4];
    BTF_TRY(damped_step(&d, 4, jtj, jtr, damping, step));
    next.ka = best.ka + step[0];
    next.kd = best.kd + step[1];
    next.ks = best.ks + step[2];
    next.alpha = fmin(LAPLACIAN_LARGEST_ALPHA, fmax(1.0, best.alpha * exp(fmax(-1.0, fmin(1.0, step[3])))));
    const double next_cost = normal_equations(&d, &next, 4, next_jtj, next_jtr);
    if (!(next_cost < cost)) {
      damping *= 10.0;
      continue;
    }
    cost = next_cost;
    best = next;
    memcpy(jtj, next_jtj, sizeof jtj);
    memcpy(jtr, next_jtr, sizeof jtr);
    damping = fmax(1e-12, damping * 0.1);
  }
  best.ka = ldexp(best.ka, exponent);
  best.kd = ldexp(best.kd, exponent);
  best.ks = ldexp(best.ks, exponent);
  *out = best;
  *rms = ldexp(sqrt(cost / ((double)d.lights * d.views)), exponent);
  return BTF_OK;
}
