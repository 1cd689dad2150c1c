/* SPDX-License-Identifier: MIT */
#include "test_one_view.h"

static double decoded(double v) {
  const double s = fabs(v), l = s <= 0.04045 ? s / 12.92 : pow((s + 0.055) / 1.055, 2.4);
  return v < 0 ? -l : l;
}

/* How much faster than v itself decoded(v) grows around v. */
static double slope(double v) {
  const double s = fabs(v);
  return s <= 0.04045 ? 1 / 12.92 : 2.4 / 1.055 * pow((s + 0.055) / 1.055, 1.4);
}

void one_view_check_all(const char *path, const char *id, const char *const *settings, int width, int height,
                        one_view_recorded recorded, const void *user, double relative) {
  for (int linear = 0; linear < 2; linear++) {
    test_memory memory;
    btf_context *ctx = format_context(&memory);
    const btf_format *format;
    btf_dataset *ds;
    btf_dataset_desc d = BTF_DATASET_DESC_INIT;
    const char *all_settings[16] = {"transfer", linear ? "linear" : "srgb"};
    for (int i = 0; settings != NULL && settings[i] != NULL && i < 12; i++) all_settings[2 + i] = settings[i];
    assert_ok(btf_format_detect(ctx, path, &format));
    assert_string_equal(btf_format_id(format), id);
    assert_ok(format_try(ctx, path, id, all_settings, &ds));
    assert_ok(btf_dataset_describe(ds, &d));
    assert_int_equal(d.width, width);
    assert_int_equal(d.height, height);
    assert_int_equal(d.channels, 3);
    assert_int_equal(d.quantity, BTF_QUANTITY_BRDF_COS);
    assert_int_equal(btf_dirset_count(d.views), 1);
    const uint32_t lights = btf_dirset_count(d.lights);
    float *samples = malloc((size_t)lights * (size_t)(width * height) * 3 * sizeof *samples);
    assert_non_null(samples);
    const btf_block all = {0, 1, 0, lights, 0, 0, (uint32_t)width, (uint32_t)height};
    const btf_strides strides = {0, 12 * width * height, 12 * width, 12, 4};
    assert_ok(btf_dataset_read(ds, &all, samples, &strides));
    const float *sample = samples;
    for (uint32_t l = 0; l < lights; l++) {
      const float *direction = btf_dirset_directions(d.lights) + 3 * (size_t)l;
      const double light[3] = {direction[0], direction[1], direction[2]};
      for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++)
          for (int k = 0; k < 3; k++, sample++) {
            const double value = recorded(user, light, x, y, k);
            const double expected = linear ? value : decoded(value);
            /* One rounding to float beside the sums of doubles, which the curve makes steeper. */
            const double tolerance = 1e-7 * fmax(1, fabs(expected)) +
                                     relative * fmax(1, fabs(value)) * (linear ? 1 : slope(value));
            if (!(fabs((double)*sample - expected) <= tolerance))
              fail_msg("light %u, texel %d %d, channel %d: %.9g instead of %.9g", l, x, y, k, (double)*sample,
                       expected);
          }
    }
    free(samples);
    btf_dataset_release(ds);
    test_context_done(ctx, &memory);
  }
}

/* P of degree l and order m without the sign (-1)^m, by recursion over the degree. */
static double legendre(int l, int m, double x) {
  double before = 0, p = 1;
  for (int i = 1; i <= m; i++) p *= (2 * i - 1) * sqrt(1 - x * x);
  for (int n = m + 1; n <= l; n++) {
    const double next = ((2 * n - 1) * x * p - (n + m - 1) * before) / (n - m);
    before = p;
    p = next;
  }
  return p;
}

void one_view_harmonics(const double light[3], double out[16]) {
  const double c = fmin(light[2], 1), phi = atan2(light[1], light[0]);
  int term = 0;
  for (int l = 0; l < 4; l++)
    for (int i = -l; i <= l; i++) {
      const int m = abs(i);
      double ratio = (2 * l + 1) / (2 * 3.14159265358979323846);
      for (int k = l - m + 1; k <= l + m; k++) ratio /= k;
      /* Cosines come before the order 0 and sines after it; the files have order 2 turned about. */
      out[term++] = sqrt(ratio * (m > 0 ? 2 : 1)) * legendre(l, m, 2 * c - 1) *
                    (i < 0   ? cos(m * phi)
                     : i > 0 ? sin(m * phi)
                             : 1) *
                    (m == 2 ? -1 : 1);
    }
}
