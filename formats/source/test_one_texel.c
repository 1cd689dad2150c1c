/* SPDX-License-Identifier: MIT */
#include "test_one_texel.h"

static void to_double(const float *d, double out[3]) {
  const double length = sqrt((double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2]);
  for (int i = 0; i < 3; i++) out[i] = d[i] / length;
}

void one_texel_check_all(const char *path, const char *id, const char *const *settings, uint32_t quantity,
                         one_texel_check check) {
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const btf_format *format;
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  assert_ok(btf_format_detect(ctx, path, &format));
  assert_string_equal(btf_format_id(format), id);
  assert_ok(format_try(ctx, path, id, settings, &ds));
  assert_ok(btf_dataset_describe(ds, &d));
  assert_int_equal(d.width, 1);
  assert_int_equal(d.height, 1);
  assert_int_equal(d.quantity, quantity);
  const uint32_t lights = btf_dirset_count(d.lights), views = btf_dirset_count(d.views);
  float *samples = malloc((size_t)lights * d.channels * sizeof *samples);
  assert_non_null(samples);
  const ptrdiff_t channel = sizeof(float), light = channel * (ptrdiff_t)d.channels,
                  view = light * (ptrdiff_t)lights;
  const btf_strides strides = {view, light, view, view, channel};
  for (uint32_t v = 0; v < views; v++) {
    const btf_block block = {v, 1, 0, lights, 0, 0, 1, 1};
    double to_view[3], to_light[3];
    assert_ok(btf_dataset_read(ds, &block, samples, &strides));
    to_double(btf_dirset_directions(d.views) + 3 * (size_t)v, to_view);
    for (uint32_t l = 0; l < lights; l++) {
      to_double(btf_dirset_directions(d.lights) + 3 * (size_t)l, to_light);
      check(to_light, to_view, samples + (size_t)l * d.channels);
    }
  }
  free(samples);
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

void one_texel_angles(const double d[3], double *theta, double *phi) {
  const double degrees = 180 / 3.14159265358979323846;
  *theta = acos(fmin(d[2], 1)) * degrees;
  *phi = atan2(d[1], d[0]) * degrees;
  if (*phi < 0) *phi += 360;
}
