/* SPDX-License-Identifier: MIT */
#include "test_laplacian_fits.h"

#include "model/model.h"

btf_status laplacian_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings,
                             const btf_job *job, btf_model **out) {
  return suite_try_fit(ctx, "laplacian", ds, settings, job, out);
}

btf_model *laplacian_fit(btf_context *ctx, const material *m, const char *settings) {
  return suite_fit(ctx, "laplacian", m->ds, settings);
}

const btfi_laplacian_state *laplacian_state(const btf_model *model) {
  return model->state;
}

double laplacian_squared_error(const btf_model *model, const material *m) {
  return fmf_squared_error(model, m);
}

static uint32_t wrapped(int64_t i, uint32_t size, uint32_t wrap) {
  if (wrap == BTF_WRAP_CLAMP) return i < 0 ? 0 : i >= size ? size - 1 : (uint32_t)i;
  return (uint32_t)((i % size + size) % size);
}

static double *half_size(const double *image, uint32_t width, uint32_t height, uint32_t filter,
                         uint32_t wrap) {
  const uint32_t w = width > 1 ? width / 2 : 1, h = height > 1 ? height / 2 : 1;
  double *out = malloc((size_t)w * h * sizeof *out);
  for (uint32_t y = 0; y < h; y++)
    for (uint32_t x = 0; x < w; x++) {
      double sum = 0.0, weights = 0.0;
      const int from = filter == LAPLACIAN_MEAN_FILTER ? 0 : -1,
                to = filter == LAPLACIAN_BINOMIAL_FILTER ? 2 : 1;
      for (int dy = from; dy <= to; dy++)
        for (int dx = from; dx <= to; dx++) {
          const double binomial = ((dx == 0 || dx == 1) ? 3.0 : 1.0) * ((dy == 0 || dy == 1) ? 3.0 : 1.0);
          const double weight = filter == LAPLACIAN_BINOMIAL_FILTER ? binomial : 1.0;
          sum += weight * image[(size_t)wrapped((int64_t)2 * y + dy, height, wrap) * width +
                                wrapped((int64_t)2 * x + dx, width, wrap)];
          weights += weight;
        }
      out[(size_t)y * w + x] = sum / weights;
    }
  return out;
}

double *low_pass(const double *image, uint32_t width, uint32_t height, uint32_t filter, uint32_t wrap,
                 uint32_t level) {
  double *now = malloc((size_t)width * height * sizeof *now);
  memcpy(now, image, (size_t)width * height * sizeof *now);
  for (uint32_t k = 0; k < level; k++) {
    double *next =
        half_size(now, btf_sampling_level_size(width, k), btf_sampling_level_size(height, k), filter, wrap);
    free(now);
    now = next;
  }
  return now;
}

double *image_channel(const material *m, uint32_t light, uint32_t view, uint32_t channel) {
  static const double matrix[3][3] = {
      {0.299, 0.587, 0.114}, {-0.168735892, -0.331264108, 0.5}, {0.5, -0.418687589, -0.081312411}};
  double *out = malloc((size_t)m->width * m->height * sizeof *out);
  for (uint32_t y = 0; y < m->height; y++)
    for (uint32_t x = 0; x < m->width; x++) {
      double sum = 0.0;
      for (uint32_t c = 0; c < 3; c++) sum += matrix[channel][c] * material_sample(m, x, y, light, view, c);
      out[(size_t)y * m->width + x] = sum;
    }
  return out;
}
