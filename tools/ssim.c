/* SPDX-License-Identifier: MIT */
/* ssim.c: structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004). Moments are in double: variances are
 * small differences of them. */
#include <math.h>

#include "metrics.h"

enum { window = 11, reach = 5, moments = 5 };

size_t ssim_scratch(uint32_t width, uint32_t height) {
  /* Five filtered maps, and one row of each before filtering with the wrap on both sides. */
  return (size_t)moments * ((size_t)width * height + width + 2 * reach) + (size_t)moments * width;
}

static void gaussian(double weights[window]) {
  double sum = 0, w[window];
  for (int i = 0; i < window; i++) sum += w[i] = exp(-(i - reach) * (i - reach) / (2 * 1.5 * 1.5));
  for (int i = 0; i < window; i++) weights[i] = w[i] / sum;
}

/* Row y of the maps a, b, a*a, b*b, a*b, filtered along x. */
static void filter_row(const float *a, const float *b, uint32_t width, const double weights[window],
                       double *padded, double *const maps[moments], size_t at) {
  const size_t stride = (size_t)width + 2 * reach;
  for (size_t i = 0; i < stride; i++) {
    const size_t x = (i + (size_t)width * reach - reach) % width;
    const double value_a = a[x], value_b = b[x];
    padded[i] = value_a;
    padded[stride + i] = value_b;
    padded[2 * stride + i] = value_a * value_a;
    padded[3 * stride + i] = value_b * value_b;
    padded[4 * stride + i] = value_a * value_b;
  }
  for (int m = 0; m < moments; m++) {
    const double *row = padded + (size_t)m * stride;
    double *dst = maps[m] + at;
    for (uint32_t x = 0; x < width; x++) dst[x] = 0;
    for (int k = 0; k < window; k++)
      for (uint32_t x = 0; x < width; x++) dst[x] += weights[k] * row[x + (uint32_t)k];
  }
}

double ssim_mean(const float *a, const float *b, uint32_t width, uint32_t height, double *scratch) {
  const double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
  const size_t pixels = (size_t)width * height;
  double weights[window];
  double *maps[moments], *sums[moments];
  double *padded = scratch + (size_t)moments * pixels;
  double total = 0;
  gaussian(weights);
  for (int m = 0; m < moments; m++) {
    maps[m] = scratch + (size_t)m * pixels;
    sums[m] = padded + (size_t)moments * (width + 2 * reach) + (size_t)m * width;
  }
  for (uint32_t y = 0; y < height; y++)
    filter_row(a + (size_t)y * width, b + (size_t)y * width, width, weights, padded, maps, (size_t)y * width);
  for (uint32_t y = 0; y < height; y++) {
    for (int m = 0; m < moments; m++) {
      for (uint32_t x = 0; x < width; x++) sums[m][x] = 0;
      for (uint32_t k = 0; k < window; k++) {
        const size_t row = ((size_t)y + (size_t)height * reach + k - reach) % height;
        const double *src = maps[m] + row * width;
        for (uint32_t x = 0; x < width; x++) sums[m][x] += weights[k] * src[x];
      }
    }
    for (uint32_t x = 0; x < width; x++) {
      const double mean_a = sums[0][x], mean_b = sums[1][x];
      const double variance_a = sums[2][x] - mean_a * mean_a, variance_b = sums[3][x] - mean_b * mean_b;
      const double covariance = sums[4][x] - mean_a * mean_b;
      const double similarity = (2 * mean_a * mean_b + c1) * (2 * covariance + c2) /
                                ((mean_a * mean_a + mean_b * mean_b + c1) * (variance_a + variance_b + c2));
      total += similarity < 1 ? similarity : 1; /* above 1 by rounding alone */
    }
  }
  return total / (double)pixels;
}
