/* SPDX-License-Identifier: MIT */
/* lookup.c: a pair of directions as half and difference angles, and the bins they fall into. */
#include "merl/merl.h"

static const double pi = 3.14159265358979323846;
/* Directions are floats: closer than this to a pole an azimuth is noise, and 0 stands for it. */
static const double pole = 1e-6;

static double dot(const double a[3], const double b[3]) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Places in units of bins, 0 .. number of bins. */
static void locate(const double light[3], const double view[3], double place[3]) {
  double h[3] = {light[0] + view[0], light[1] + view[1], light[2] + view[2]};
  const double length = sqrt(dot(h, h));
  for (int i = 0; i < 3; i++) h[i] /= length;
  const double sine = hypot(h[0], h[1]);
  const double cos_phi = sine < pole ? 1 : h[0] / sine, sin_phi = sine < pole ? 0 : h[1] / sine;
  /* The axes that turning h to the normal takes to x and y. */
  const double meridian[3] = {h[2] * cos_phi, h[2] * sin_phi, -sine}, parallel[3] = {-sin_phi, cos_phi, 0};
  const double x = dot(light, meridian), y = dot(light, parallel), off = hypot(x, y);
  double phi = off < pole ? 0 : atan2(y, x);
  if (phi < 0) phi += pi; /* the other half turn is the same by reciprocity */
  place[0] = sqrt(atan2(sine, h[2]) / (pi / 2)) * MERL_THETA_H;
  place[1] = atan2(off, dot(light, h)) / (pi / 2) * MERL_THETA_D;
  place[2] = phi / pi * MERL_PHI_D;
}

static uint32_t bin(double place, uint32_t count) {
  return place < count ? (uint32_t)place : count - 1;
}

static double stored(const one_texel *brdf, int channel, uint32_t i, uint32_t j, uint32_t k) {
  const uint64_t element =
      (uint64_t)channel * MERL_BINS + k + (uint64_t)MERL_PHI_D * (j + (uint64_t)MERL_THETA_D * i);
  return btf_get_f64(brdf->file.data + MERL_HEADER + 8 * element);
}

/* Minus infinity is damage and not the mark of a bin without a measurement. */
static bool is_missing(double value) {
  return value < 0 && isfinite(value);
}

static const double scales[3] = {1 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0};

void merl_nearest(const one_texel *brdf, const double light[3], const double view[3], double *out) {
  double place[3];
  locate(light, view, place);
  for (int c = 0; c < 3; c++) {
    const double value =
        stored(brdf, c, bin(place[0], MERL_THETA_H), bin(place[1], MERL_THETA_D), bin(place[2], MERL_PHI_D));
    out[c] = is_missing(value) ? 0 : value * scales[c];
  }
}

/* The bin below a place and how far it is to the next; held at both ends. */
static uint32_t between(double place, uint32_t count, double *weight) {
  const double centre = fmin(fmax(place - 0.5, 0), count - 1);
  const uint32_t below = centre < count - 2 ? (uint32_t)centre : count - 2;
  *weight = centre - below;
  return below;
}

void merl_linear(const one_texel *brdf, const double light[3], const double view[3], double *out) {
  double place[3], weight[3], sum[3] = {0, 0, 0}, total[3] = {0, 0, 0};
  locate(light, view, place);
  const uint32_t i = between(place[0], MERL_THETA_H, &weight[0]),
                 j = between(place[1], MERL_THETA_D, &weight[1]);
  /* Half a turn on, the difference azimuth begins anew. */
  const double turn = place[2] < 0.5 ? place[2] - 0.5 + MERL_PHI_D : place[2] - 0.5;
  const uint32_t k = bin(turn, MERL_PHI_D);
  weight[2] = fmin(turn - k, 1);
  for (uint32_t corner = 0; corner < 8; corner++) {
    const uint32_t a = corner & 1, b = corner >> 1 & 1, d = corner >> 2;
    const double w =
        (a ? weight[0] : 1 - weight[0]) * (b ? weight[1] : 1 - weight[1]) * (d ? weight[2] : 1 - weight[2]);
    for (int c = 0; c < 3 && w > 0; c++) {
      const double value = stored(brdf, c, i + a, j + b, (k + d) % MERL_PHI_D);
      if (is_missing(value)) continue;
      sum[c] += w * value;
      total[c] += w;
    }
  }
  for (int c = 0; c < 3; c++) out[c] = total[c] > 0 ? sum[c] / total[c] * scales[c] : 0;
}
