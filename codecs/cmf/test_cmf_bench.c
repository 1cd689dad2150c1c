/* SPDX-License-Identifier: MIT */
#include "test_cmf_bench.h"

#include "registry/registry.h"

static test_memory memory;

btfi_cmf_settings settings_of_chain(const char *chain) {
  btfi_cmf_settings s = {.grid = CMF_ANGULAR, .resolution = 32, .edge = 32, .epsilon = 1e-3};
  assert_null(btfi_cmf_parse_chain(chain, &s));
  return s;
}

bench bench_open(const char *directions, const btfi_cmf_settings *settings) {
  bench b = {.ctx = test_context(&memory)};
  assert_ok(btf_dirset_create_named(b.ctx, directions, &b.set));
  b.count = btf_dirset_count(b.set);
  assert_ok(
      btfi_cmf_geometry_create(btfi_host(), b.ctx, settings, b.set, b.set, 1u << 30, NULL, 0.0, 1.0, &b.g));
  b.abrdf = calloc((size_t)b.count * b.count, sizeof *b.abrdf);
  b.maps = calloc((size_t)b.g->factors * b.g->map_texels, sizeof *b.maps);
  b.scratch = aligned_alloc(64, b.g->scratch_bytes);
  return b;
}

void bench_close(bench *b) {
  free(b->abrdf);
  free(b->maps);
  free(b->scratch);
  btfi_cmf_geometry_free(btfi_host(), b->ctx, b->g);
  btf_dirset_release(b->set);
  test_context_done(b->ctx, &memory);
}

void bench_plant(bench *b, planted_fn f) {
  const float *xyz = btf_dirset_directions(b->set);
  for (uint32_t v = 0; v < b->count; v++)
    for (uint32_t l = 0; l < b->count; l++) b->abrdf[v * b->count + l] = (float)f(xyz + 3 * l, xyz + 3 * v);
}

double bench_factor(const bench *b) {
  btfi_cmf_report report = {0};
  btfi_cmf_factor_abrdf(b->g, 1, b->abrdf, b->scratch, b->maps, &report);
  btfi_cmf_report again = {0};
  btfi_cmf_measure(b->g, 1, b->abrdf, b->scratch, b->maps, &again);
  assert_int_equal(report.samples, (uint64_t)b->count * b->count);
  /* Sums of float products in the same order, but for the scale of the data. */
  assert_near(again.squared_error, report.squared_error,
              1e-4 * report.squared_error + 1e-11 * report.squared_energy);
  return sqrt(report.squared_error / report.squared_energy);
}

double plant_and_factor(const char *directions, const btfi_cmf_settings *settings, planted_fn f) {
  bench b = bench_open(directions, settings);
  bench_plant(&b, f);
  const double error = bench_factor(&b);
  bench_close(&b);
  return error;
}

void bench_expect_positive(const bench *b) {
  for (uint32_t i = 0; i < b->g->factors; i++)
    for (uint32_t t = 0; t < b->g->map_texels; t++) {
      const float value = b->maps[i * b->g->map_texels + t];
      assert_true(isfinite(value));
      if (!btfi_cmf_is_signed(b->g->settings.method, b->g->factor[i].term)) assert_true(value >= 0.0f);
    }
}
