/* SPDX-License-Identifier: MIT */
/* rotate.c: Suykens et al. 2003, section 5: many factors are alike but for a rotation, so each ABRDF is
 * turned into its direction of maximal anisotropy first. */
#include <math.h>

#include "fit.h"

static void locate_turned(const btf_host *host, const btf_dirset *set, uint32_t count, btf_interp *out) {
  const float *xyz = host->dirset_directions(set);
  for (uint32_t k = 0; k < CMF_TURN; k++) {
    const double angle = 2.0 * 3.14159265358979323846 * k / CMF_TURN;
    const float c = (float)cos(angle), s = (float)sin(angle);
    for (uint32_t i = 0; i < count; i++) {
      const float *d = xyz + 3 * (size_t)i;
      const float turned[3] = {c * d[0] - s * d[1], s * d[0] + c * d[1], d[2]};
      host->dirset_locate(set, turned, &out[(size_t)k * count + i]);
    }
  }
}

btf_status btfi_cmf_rotation_create(const btf_host *host, btf_context *ctx, const btf_dirset *lights,
                                    const btf_dirset *views, btfi_cmf_rotation *out) {
  const float *l = host->dirset_directions(lights), *v = host->dirset_directions(views);
  out->lights = host->dirset_count(lights);
  out->views = host->dirset_count(views);
  out->light = host->alloc(ctx, (uint64_t)CMF_TURN * out->lights, sizeof *out->light);
  out->view = host->alloc(ctx, (uint64_t)CMF_TURN * out->views, sizeof *out->view);
  out->moment = host->alloc(ctx, (uint64_t)out->lights * out->views, 4 * sizeof *out->moment);
  if (out->light == NULL || out->view == NULL || out->moment == NULL) return BTF_E_NOMEM;
  locate_turned(host, lights, out->lights, out->light);
  locate_turned(host, views, out->views, out->view);
  for (uint32_t j = 0; j < out->views; j++)
    for (uint32_t i = 0; i < out->lights; i++) {
      float *moment = out->moment + 4 * ((size_t)j * out->lights + i), half[3];
      btfi_cmf_half(l + 3 * (size_t)i, v + 3 * (size_t)j, half);
      moment[0] = l[3 * i] + v[3 * j];
      moment[1] = l[3 * i + 1] + v[3 * j + 1];
      moment[2] = half[0];
      moment[3] = half[1];
    }
  return BTF_OK;
}

void btfi_cmf_rotation_free(const btf_host *host, btf_context *ctx, btfi_cmf_rotation *r) {
  host->free(ctx, r->light);
  host->free(ctx, r->view);
  host->free(ctx, r->moment);
}

uint32_t btfi_cmf_anisotropy(const btfi_cmf_rotation *r, uint32_t channels, const float *abrdf) {
  /* First harmonic of the values over the azimuth of l + v, second harmonic over that of h: both turn with
   * the ABRDF. */
  double first[2] = {0.0, 0.0}, second[2] = {0.0, 0.0}, best = -INFINITY, size = 0.0;
  uint32_t angle = 0;
  const size_t pairs = (size_t)r->lights * r->views;
  for (size_t p = 0; p < pairs; p++) {
    const float *m = r->moment + 4 * p;
    double value = 0.0;
    for (uint32_t c = 0; c < channels; c++) value += (double)abrdf[p * channels + c];
    first[0] += value * (double)m[0];
    first[1] += value * (double)m[1];
    second[0] += value * (double)(m[2] * m[2] - m[3] * m[3]);
    second[1] += value * (double)(2.0f * m[2] * m[3]);
    size += fabs(value);
  }
  for (uint32_t k = 0; k < CMF_TURN; k++) {
    const double turn = 2.0 * 3.14159265358979323846 * k / CMF_TURN;
    const double along = first[0] * cos(turn) + first[1] * sin(turn) + second[0] * cos(2.0 * turn) +
                         second[1] * sin(2.0 * turn);
    /* Rounding alone must not turn what is isotropic. */
    if (along > best + 1e-6 * size) {
      best = along;
      angle = k;
    }
  }
  return best > 1e-4 * size ? angle : 0;
}

void btfi_cmf_rotate(const btfi_cmf_rotation *r, uint32_t channels, uint32_t angle, const float *abrdf,
                     float *half_way, float *out) {
  const btf_interp *of_light = r->light + (size_t)angle * r->lights;
  const btf_interp *of_view = r->view + (size_t)angle * r->views;
  const size_t line = (size_t)r->lights * channels;
  for (uint32_t j = 0; j < r->views; j++)
    for (uint32_t i = 0; i < r->lights; i++) {
      const float *from = abrdf + j * line, *const w = of_light[i].weight;
      float *to = half_way + j * line + (size_t)i * channels;
      const float *a = from + (size_t)of_light[i].index[0] * channels,
                  *b = from + (size_t)of_light[i].index[1] * channels,
                  *d = from + (size_t)of_light[i].index[2] * channels;
      for (uint32_t c = 0; c < channels; c++) to[c] = a[c] * w[0] + b[c] * w[1] + d[c] * w[2];
    }
  for (uint32_t j = 0; j < r->views; j++) {
    const float *const w = of_view[j].weight;
    const float *a = half_way + of_view[j].index[0] * line, *b = half_way + of_view[j].index[1] * line,
                *d = half_way + of_view[j].index[2] * line;
    float *to = out + j * line;
    for (size_t i = 0; i < line; i++) to[i] = a[i] * w[0] + b[i] * w[1] + d[i] * w[2];
  }
}
