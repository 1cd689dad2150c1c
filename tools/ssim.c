/* SPDX-License-Identifier: MIT */
/* ssim.c: structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004). */
#include <math.h>

#include "metrics.h"

enum { window = 11, reach = 5, moments = 5 };

size_t ssim_scratch(uint32_t width, uint32_t height) {
  /* Five filtered maps, and one row of each before filtering with the wrap on both sides. */
  return (size_t)moments * ((size_t)width * height + width + 2 * reach) + (size_t)moments * width;
}

static void gaussian(float weights[window]) {
  double sum = 0, w[window];
  for (int i = 0; i < window; i++) sum += w[i] = exp(-(i - reach) * (i - reach) / (2 * 1.5 * 1.5));
  for (int i = 0; i < window; i++) weights[i] = (float)(w[i] / sum);
}

/* Row y of the maps a, b, a*a, b*b, a*b, filtered along x. */
static void filter_row(const float *a, const float *b, uint32_t width, const float weights[window],
                       float *padded, float *const maps[moments], size_t at) {
  const size_t stride = (size_t)width + 2 * reach;
  for (size_t i = 0; i < stride; i++) {
    const size_t x = (i + (size_t)width * reach - reach) % width;
    padded[i] = a[x];
    padded[stride + i] = b[x];
    padded[2 * stride + i] = a[x] * a[x];
    padded[3 * stride + i] = b[x] * b[x];
    padded[4 * stride + i] = a[x] * b[x];
  }
  for (int m = 0; m < moments; m++) {
    const float *row = padded + (size_t)m * stride;
    float *dst = maps[m] + at;
    for (uint32_t x = 0; x < width; x++) dst[x] = 0;
    for (int k = 0; k < window; k++)
      for (uint32_t x = 0; x < width; x++) dst[x] += weights[k] * row[x + (uint32_t)k];
  }
}

double ssim_mean(const float *a, const float *b, uint32_t width, uint32_t height, float *scratch) {
  const float c1 = 0.01f * 0.01f, c2 = 0.03f * 0.03f;
  const size_t pixels = (size_t)width * height;
  float weights[window];
  float *maps[moments], *sums[moments];
  float *padded = scratch + (size_t)moments * pixels;
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
        const float *src = maps[m] + row * width;
        for (uint32_t x = 0; x < width; x++) sums[m][x] += weights[k] * src[x];
      }
    }
    for (uint32_t x = 0; x < width; x++) {
      const float mean_a = sums[0][x], mean_b = sums[1][x];
      const float variance_a = sums[2][x] - mean_a * mean_a, variance_b = sums[3][x] - mean_b * mean_b;
      const float covariance = sums[4][x] - mean_a * mean_b;
      total += (double)((2 * mean_a * mean_b + c1) * (2 * covariance + c2) /
                        ((mean_a * mean_a + mean_b * mean_b + c1) * (variance_a + variance_b + c2)));
    }
  }
  return total / (double)pixels;
}
