/* SPDX-License-Identifier: MIT */
#include "test_one_texel.h"

btf_context *one_texel_context(test_memory *memory) {
  btf_context *ctx = test_context(memory);
  assert_ok(btf_formats_register(ctx));
  return ctx;
}

btf_status one_texel_try(btf_context *ctx, const char *path, const char *id, const char *const *settings,
                         btf_dataset **out) {
  const btf_format *format = btf_format_find(ctx, id);
  btf_options *options = NULL;
  *out = NULL;
  assert_non_null(format);
  if (settings != NULL) assert_ok(btf_format_options_create(format, &options));
  for (size_t i = 0; settings != NULL && settings[i] != NULL; i += 2)
    assert_ok(btf_options_set(options, settings[i], settings[i + 1]));
  const btf_status status = btf_format_open(ctx, path, format, options, out);
  btf_options_release(options);
  return status;
}

static void to_double(const float *d, double out[3]) {
  const double length = sqrt((double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2]);
  for (int i = 0; i < 3; i++) out[i] = d[i] / length;
}

void one_texel_check_all(const char *path, const char *id, const char *const *settings, uint32_t quantity,
                         one_texel_check check) {
  test_memory memory;
  btf_context *ctx = one_texel_context(&memory);
  const btf_format *format;
  btf_dataset *ds;
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  assert_ok(btf_format_detect(ctx, path, &format));
  assert_string_equal(btf_format_id(format), id);
  assert_ok(one_texel_try(ctx, path, id, settings, &ds));
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

void one_texel_check_allocations(const char *path, const char *id) {
  test_memory memory;
  btf_context *ctx = one_texel_context(&memory);
  const btf_block first = {0, 1, 0, 1, 0, 0, 1, 1};
  const btf_strides strides = {256, 256, 256, 256, 4};
  for (long fail_at = 1;; fail_at++) {
    float samples[64];
    btf_dataset *ds;
    memory.fail_at = memory.total_allocations + fail_at;
    btf_status status = btf_format_open(ctx, path, btf_format_find(ctx, id), NULL, &ds);
    if (status == BTF_OK) {
      status = btf_dataset_read(ds, &first, samples, &strides);
      btf_dataset_release(ds);
    }
    if (status == BTF_OK) {
      assert_true(fail_at > 3);
      break;
    }
    assert_int_equal(status, BTF_E_NOMEM);
  }
  memory.fail_at = 0;
  test_context_done(ctx, &memory);
}

void one_texel_refused(btf_context *ctx, const char *path, const char *id) {
  btf_dataset *ds;
  const btf_status status = one_texel_try(ctx, path, id, NULL, &ds);
  if (status == BTF_OK) fail_msg("%s was opened", path);
  assert_true(status >= BTF_E_NOT_BTF && status < 40);
  assert_null(ds);
  assert_true(strncmp(btf_error_message(), path, strlen(path)) == 0);
  assert_null(strchr(btf_error_message(), '\n'));
}

void one_texel_angles(const double d[3], double *theta, double *phi) {
  const double degrees = 180 / 3.14159265358979323846;
  *theta = acos(fmin(d[2], 1)) * degrees;
  *phi = atan2(d[1], d[0]) * degrees;
  if (*phi < 0) *phi += 360;
}
