/* SPDX-License-Identifier: MIT */
/* metrics.h: how far one set of samples is from another. docs/command-line.md defines each figure. */
#ifndef BTF_TOOLS_METRICS_H
#define BTF_TOOLS_METRICS_H

#include "sample_source.h"

typedef struct metrics {
  uint64_t values, different; /* compared, and not equal */
  double peak;                /* 99.9th percentile of the reference */
  double rmse, relative_rmse, psnr, mean_relative_error, largest_error;
  double ssim;
  uint64_t ssim_images;
  bool has_colour; /* three channels */
  double rmse_y, rmse_cb, rmse_cr;
  uint32_t worst_x, worst_y, worst_light, worst_view;
  double worst_texel_rmse, worst_pair_rmse;
} metrics;

/* The 99.9th percentile of all values, interpolated between the two ranks around it. Reads everything once,
 * and again where the sample type is finer than half floats. */
int metrics_peak(cli *c, const sample_source *reference, double *peak);

/* Compares sources of the same shape. SSIM is taken over `ssim_images` images spread evenly over all pairs of
 * directions, all if there are no more. */
int metrics_compare(cli *c, const sample_source *reference, const sample_source *other, double peak,
                    uint64_t ssim_images, metrics *out);

/* "Different" in words if the shapes differ, NULL if they are the same; the text is static. */
const char *metrics_shape_difference(const sample_source *a, const sample_source *b);

/* Mean structural similarity of two images of values in 0..1: Gaussian windows of 11 x 11 with sigma 1.5 that
 * wrap around, k1 = 0.01, k2 = 0.03. scratch holds ssim_scratch doubles. */
size_t ssim_scratch(uint32_t width, uint32_t height);
double ssim_mean(const float *a, const float *b, uint32_t width, uint32_t height, double *scratch);

#endif
