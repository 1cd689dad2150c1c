/* SPDX-License-Identifier: MIT */
/* Maps of the hemisphere, the half-difference frame, and the factorisation of one ABRDF against planted
 * factors, LAPACK, and what resampling alone costs. */
#include <btf/btf_codec.h>

#include "btf_test.h"

#include "exact_svd.h"

#include "factor.h"
#include "registry/registry.h"

static test_memory memory;
static uint64_t random_state = 1;

static float draw(void) {
  return (float)btf_random_unit(&random_state);
}

static void draw_direction(float d[3]) {
  const double z = (double)draw(), phi = 6.283185307179586 * (double)draw(), r = sqrt(1.0 - z * z);
  d[0] = (float)(r * cos(phi));
  d[1] = (float)(r * sin(phi));
  d[2] = (float)z;
}

static double distance(const float a[3], const float b[3]) {
  double sum = 0.0;
  for (int i = 0; i < 3; i++) sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
  return sqrt(sum);
}

/* ---- maps: PAR01, PAR07 ---- */

static void test_maps_are_bijections(void **unused) {
  (void)unused;
  for (int n = 0; n < 20000; n++) {
    float d[3], back[3], ab[2], again[2];
    draw_direction(d);
    btfi_cmf_parabolic(d, ab);
    assert_true(ab[0] * ab[0] + ab[1] * ab[1] <= 1.0f + 1e-6f);
    btfi_cmf_from_parabolic(ab, back);
    assert_near(distance(d, back), 0.0, 1e-6);
    btfi_cmf_cube(d, ab);
    assert_true(fmaxf(fabsf(ab[0]), fabsf(ab[1])) <= 1.0f);
    assert_true(fminf(fabsf(ab[0]), fabsf(ab[1])) <= 0.5f * CMF_CUBE_BIAS);
    btfi_cmf_from_cube(ab, back);
    assert_near(distance(d, back), 0.0, 1e-6);
    /* Every place of the cross is that of one direction. */
    const float place[2] = {2.0f * draw() - 1.0f, draw() - 0.5f};
    for (int k = 0; k < 2; k++) {
      const float here[2] = {place[k], place[1 - k]};
      btfi_cmf_from_cube(here, d);
      btfi_cmf_cube(d, again);
      assert_near(here[0], again[0], 1e-6);
      assert_near(here[1], again[1], 1e-6);
    }
  }
  /* Over the edge of the top and over the horizon nothing jumps. */
  float above[2], below[2];
  btfi_cmf_cube((const float[]){0.6f, 0.1f, 0.6000001f}, above);
  btfi_cmf_cube((const float[]){0.6f, 0.1f, 0.5999999f}, below);
  assert_near(above[0], below[0], 1e-6);
  assert_near(above[1], below[1], 1e-6);
  /* Beside a diagonal the side is that of x, whichever way a direction was rounded. */
  btfi_cmf_cube((const float[]){0.6f, 0.6000002f, 0.5f}, above);
  btfi_cmf_cube((const float[]){0.6000002f, 0.6f, 0.5f}, below);
  assert_near(above[0], below[0], 1e-6);
  assert_near(above[1], below[1], 1e-6);
  const float strange[][3] = {{NAN, 0, 1}, {INFINITY, 0, 1}, {0, 0, -1}, {1e38f, -1e38f, 0}, {0, 0, 0}};
  for (size_t i = 0; i < 5; i++) {
    btfi_cmf_tap tap;
    for (uint32_t kind = 0; kind < CMF_MAP_KINDS; kind++) {
      const btfi_cmf_map map = btfi_cmf_map_of(kind, 9);
      btfi_cmf_map_locate(&map, strange[i], &tap);
      for (int k = 0; k < 4; k++) assert_true(tap.index[k] < btfi_cmf_map_texels(&map));
    }
  }
}

/* Texel centres are looked up as themselves, weights sum to 1, and solid angles to the hemisphere's. */
static void test_maps(void **unused) {
  (void)unused;
  for (uint32_t kind = 0; kind < CMF_MAP_KINDS; kind++)
    for (uint32_t edge = 4; edge <= 33; edge += 7) {
      const btfi_cmf_map map = btfi_cmf_map_of(kind, edge);
      double sphere = 0.0;
      for (uint32_t i = 0; i < btfi_cmf_map_texels(&map); i++) {
        float d[3];
        btfi_cmf_tap tap;
        sphere += btfi_cmf_map_solid_angle(&map, i);
        if (!btfi_cmf_map_direction(&map, i, d)) continue;
        btfi_cmf_map_locate(&map, d, &tap);
        double itself = 0.0, sum = 0.0;
        for (int k = 0; k < 4; k++) {
          itself += tap.index[k] == i ? (double)tap.weight[k] : 0.0;
          sum += (double)tap.weight[k];
        }
        /* Directions are floats: 1e-7 of the map's side, in texels, on each axis. */
        assert_near(itself, 1.0, 4e-7 * edge);
        assert_near(sum, 1.0, 3e-7);
      }
      /* Midpoint rule and the jagged rim: one texel's width around the horizon, where a texel is (2 /
       * edge)^2. */
      assert_near(sphere, 6.283185307, kind == CMF_ANGULAR ? 1e-6 : 6.2832 * 2.0 / edge);
    }
}

/* No lookup of the hemisphere reads a texel that is said not to be read; all others are read by one. */
static void test_texels_that_are_read(void **unused) {
  (void)unused;
  for (uint32_t kind = 0; kind < CMF_MAP_KINDS; kind++)
    for (uint32_t edge = 5; edge <= 16; edge += 11) {
      const btfi_cmf_map map = btfi_cmf_map_of(kind, edge), fine = btfi_cmf_map_of(kind, 64 * edge);
      unsigned char is_read[256] = {0};
      for (uint32_t i = 0; i < btfi_cmf_map_texels(&fine); i++) {
        float d[3];
        btfi_cmf_tap tap;
        (void)btfi_cmf_map_direction(&fine, i, d); /* directions of the horizon beyond the circle */
        btfi_cmf_map_locate(&map, d, &tap);
        for (int k = 0; k < 4; k++) is_read[tap.index[k]] |= tap.weight[k] > 0.0f;
      }
      for (uint32_t i = 0; i < btfi_cmf_map_texels(&map); i++)
        assert_int_equal(btfi_cmf_map_reads(&map, i), is_read[i]);
    }
}

/* Texels outside the circle hold the value of the nearest one within, by brute force; never 0. */
static void test_corners_are_extrapolated(void **unused) {
  (void)unused;
  for (uint32_t kind = 0; kind < CMF_MAP_KINDS; kind++) {
    const btfi_cmf_map map = btfi_cmf_map_of(kind, 16);
    const uint32_t n = btfi_cmf_map_texels(&map);
    unsigned char known[256];
    uint32_t source[256];
    for (uint32_t i = 0; i < n; i++) {
      float d[3];
      known[i] = btfi_cmf_map_direction(&map, i, d) && (kind == CMF_PARABOLIC || i % 5 == 0);
    }
    assert_true(btfi_cmf_map_sources(&map, known, source));
    for (uint32_t i = 0; i < n; i++) {
      int best = 1 << 30;
      int to_source = 0;
      for (uint32_t j = 0; j < n; j++) {
        int dx = abs((int)(i % map.width) - (int)(j % map.width));
        const int dy = abs((int)(i / map.width) - (int)(j / map.width));
        if (kind == CMF_ANGULAR && dx > (int)map.width / 2) dx = (int)map.width - dx;
        if (j == source[i]) to_source = dx * dx + dy * dy;
        if (known[j] && dx * dx + dy * dy < best) best = dx * dx + dy * dy;
      }
      assert_true(known[source[i]]);
      assert_int_equal(to_source, best);
    }
    memset(known, 0, sizeof known);
    assert_false(btfi_cmf_map_sources(&map, known, source));
  }
}

/* ---- directions: PAR02, PAR03 ---- */

static void test_half_difference(void **unused) {
  (void)unused;
  for (int n = 0; n < 20000; n++) {
    float l[3], v[3], h[3], d[3], h2[3], l2[3], v2[3];
    draw_direction(l);
    draw_direction(v);
    if (n % 4 == 0) memcpy(v, (const float[]){-l[0], -l[1], l[2]}, sizeof v); /* h = N */
    if (n % 16 == 1) memcpy(v, l, sizeof v);                                  /* d = N */
    if (l[2] < 1e-3f || v[2] < 1e-3f) continue;
    btfi_cmf_half(l, v, h);
    btfi_cmf_half(v, l, h2);
    assert_memory_equal(h, h2, sizeof h);
    btfi_cmf_to_hd(l, v, h, d);
    if (n % 4 == 0) assert_near(h[2], 1.0, 1e-6);
    assert_true(btfi_cmf_from_hd(h, d, l2, v2));
    assert_near(distance(l, l2), 0.0, 1e-6);
    assert_near(distance(v, v2), 0.0, 1e-6);
    /* The other way round the difference vector turns by half a turn. */
    float d2[3];
    btfi_cmf_to_hd(v, l, h, d2);
    assert_near(distance(d2, (const float[]){-d[0], -d[1], d[2]}), 0.0, 1e-6);
  }
  /* Half vectors toward the tangent: the frame stays orthonormal. */
  const float steep[][3] = {{1, 0, 0}, {-1, 0, 0}, {0.9999999f, 0, 4e-4f}, {0.6f, 0, 0.8f}};
  for (size_t i = 0; i < 4; i++) {
    float x[3], y[3];
    btfi_cmf_frame(steep[i], x, y);
    assert_near(distance(x, y), sqrt(2.0), 1e-6);
    assert_near(distance(x, steep[i]), sqrt(2.0), 1e-6);
  }
  float l[3], v[3];
  const float up[3] = {0, 0, 1}, low[3] = {0.999f, 0, 0.0447f}, grazing[3] = {0.8f, 0, 0.6f};
  assert_false(btfi_cmf_from_hd(low, grazing, l, v));
  assert_true(btfi_cmf_from_hd(up, grazing, l, v));
}

/* Every built-in pair of projections is inverted by its own inverse; PAR04, PAR05. */
static void test_pairs(void **unused) {
  (void)unused;
  const char *const names[] = {"io", "oi", "ih", "oh", "hd", "dh"};
  for (size_t i = 0; i < 6; i++) {
    const btfi_cmf_pair *pair = btfi_cmf_pair_of(names[i], 2);
    assert_non_null(pair);
    for (int n = 0; n < 2000; n++) {
      float l[3], v[3], l2[3], v2[3], first[3], second[3], stored[3];
      draw_direction(l);
      draw_direction(v);
      if (l[2] < 0.05f || v[2] < 0.05f) continue;
      pair->project(l, v, first, second);
      assert_true(pair->invert(first, second, l2, v2));
      assert_near(distance(l, l2), 0.0, 1e-6);
      assert_near(distance(v, v2), 0.0, 1e-6);
      btfi_cmf_project(pair->projection[0], l, v, stored);
      assert_near(distance(stored, first), 0.0, 1e-7);
      btfi_cmf_project(pair->projection[1], l, v, stored);
      assert_near(distance(stored, second), 0.0, 1e-7);
    }
  }
  assert_null(btfi_cmf_pair_of("id", 2));
}

static void test_chains(void **unused) {
  (void)unused;
  btfi_cmf_settings s;
  assert_null(btfi_cmf_parse_chain("hd:3,io,h", &s));
  assert_int_equal(s.stage_count, 3);
  assert_int_equal(s.stage[0].terms, 3);
  assert_true(s.stage[2].mean);
  btfi_cmf_factor list[CMF_MAX_FACTORS];
  assert_int_equal(btfi_cmf_list_factors(&s, list), 9);
  assert_int_equal(list[8].projection, CMF_HALF);
  const char *const wrong[] = {"",      "hd,", "x",     "hd:0", "hd:9",
                               "hd:12", "h:2", "hd io", "id",   "io,io,io,io,io,io,io,io,io"};
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++)
    assert_non_null(btfi_cmf_parse_chain(wrong[i], &s));
}

/* ---- factoring ---- */

typedef struct bench {
  btf_context *ctx;
  btf_dirset *set;
  uint32_t count;
  btfi_cmf_geometry *g;
  float *abrdf, *maps;
  void *scratch;
} bench;

static btfi_cmf_settings settings_of(const char *chain) {
  btfi_cmf_settings s = {.grid = CMF_ANGULAR, .resolution = 32, .edge = 32, .epsilon = 1e-3};
  assert_null(btfi_cmf_parse_chain(chain, &s));
  return s;
}

static bench bench_open(const char *directions, const btfi_cmf_settings *settings) {
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

static void bench_close(bench *b) {
  free(b->abrdf);
  free(b->maps);
  free(b->scratch);
  btfi_cmf_geometry_free(btfi_host(), b->ctx, b->g);
  btf_dirset_release(b->set);
  test_context_done(b->ctx, &memory);
}

/* ---- progress of what is made beforehand ---- */

typedef struct reports {
  double last;
  long calls, cancel_at;
} reports;
static reports told;

static btf_status note_progress(const btf_job *job, double fraction, const char *stage) {
  (void)job;
  assert_string_equal(stage, "preparing");
  assert_true(fraction >= told.last && fraction <= 0.75);
  told.last = fraction;
  return ++told.calls == told.cancel_at ? BTF_E_CANCELLED : BTF_OK;
}

/* Every row of a table is a chance to cancel, which leaves nothing behind. */
static void test_preparing_can_be_cancelled(void **unused) {
  (void)unused;
  btfi_cmf_settings settings = settings_of("hd,h,io");
  btf_host host = *btfi_host();
  host.progress = note_progress;
  settings.resolution = 6;
  settings.edge = 6;
  btf_status status = BTF_E_CANCELLED;
  for (long at = 1; status == BTF_E_CANCELLED; at++) {
    btf_context *ctx = test_context(&memory);
    btf_dirset *set;
    btfi_cmf_geometry *g;
    told = (reports){.last = 0.25, .cancel_at = at};
    assert_ok(btf_dirset_create_named(ctx, "grid:4x2", &set));
    status = btfi_cmf_geometry_create(&host, ctx, &settings, set, set, 1u << 30, NULL, 0.25, 0.75, &g);
    if (status == BTF_OK) {
      assert_int_equal(told.calls, 3 * 18); /* tables of 6 x 3: of hd, and twice of h */
      btfi_cmf_geometry_free(&host, ctx, g);
    } else {
      assert_null(g);
      assert_int_equal(told.calls, at);
    }
    btf_dirset_release(set);
    test_context_done(ctx, &memory);
  }
  assert_ok(status);
}

typedef double (*planted_fn)(const float l[3], const float v[3]);

static void plant(bench *b, planted_fn f) {
  const float *xyz = btf_dirset_directions(b->set);
  for (uint32_t v = 0; v < b->count; v++)
    for (uint32_t l = 0; l < b->count; l++) b->abrdf[v * b->count + l] = (float)f(xyz + 3 * l, xyz + 3 * v);
}

/* Relative RMS error of the factorisation. */
static double factor(const bench *b) {
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

static double plant_and_factor(const char *directions, const btfi_cmf_settings *settings, planted_fn f) {
  bench b = bench_open(directions, settings);
  plant(&b, f);
  const double error = factor(&b);
  bench_close(&b);
  return error;
}

/* FAC01: J = 1. Data of rank K are exact and the squared error is the tail of LAPACK's singular values. A map
 * of edge 128 has no texel that two of the directions share, so that looking up gives the factors back. */
static void test_terms_are_singular_pairs(void **unused) {
  (void)unused;
  for (uint32_t terms = 1; terms <= 4; terms++)
    for (int exact = 0; exact < 2; exact++) {
      char chain[8];
      snprintf(chain, sizeof chain, "io:%u", terms);
      btfi_cmf_settings s = settings_of(chain);
      s.edge = 128;
      bench b = bench_open("grid:6x4", &s);
      const uint32_t n = b.count;
      double *matrix = malloc(n * n * sizeof *matrix), energy = 0.0;
      float p[24][4], q[24][4];
      for (uint32_t i = 0; i < n; i++)
        for (int k = 0; k < 4; k++) {
          p[i][k] = 0.1f + draw();
          q[i][k] = 0.1f + draw();
        }
      for (uint32_t i = 0; i < n * n; i++) {
        b.abrdf[i] = exact ? 0.0f : draw();
        for (uint32_t k = 0; exact && k < terms; k++) b.abrdf[i] += p[i / n][k] * q[i % n][k];
        matrix[i] = (double)b.abrdf[i];
        energy += matrix[i] * matrix[i];
      }
      double *const sigma = exact_singular_values(matrix, n, n);
      const double tail = exact_tail(sigma, n, terms);
      const double error = factor(&b);
      /* Floats: rounding of each sample and of the sums, a few eps of the norm; and power iterations that
       * stop at changes of 3e-7, whose effect on the error is quadratic. */
      assert_near(error, sqrt(tail / energy), 1e-6 + 1e-5 * sqrt(tail / energy));
      if (exact) assert_true(error < 1e-6);
      free(matrix);
      free(sigma);
      bench_close(&b);
    }
}

/* T06: the first term of positive data is positive, also in maps. */
static void check_positive(const bench *b) {
  for (uint32_t i = 0; i < b->g->factors; i++)
    for (uint32_t t = 0; t < b->g->map_texels; t++) {
      const float value = b->maps[i * b->g->map_texels + t];
      assert_true(isfinite(value));
      if (!btfi_cmf_is_signed(b->g->settings.method, b->g->factor[i].term)) assert_true(value >= 0.0f);
    }
}

static double p_of(const float d[3]) {
  return 0.7 + 0.25 * (double)d[0] - 0.15 * (double)d[1] + 0.2 * (double)(d[2] * d[0]);
}
static double r_of(const float d[3]) {
  return 0.6 - 0.2 * (double)d[0] + 0.25 * (double)(d[2] * d[2]);
}
static double q_of(const float h[3]) {
  return 0.4 + 0.8 * pow((double)h[2], 6.0) + 0.15 * (double)h[1];
}
static double d_of(const float d[3]) {
  return 0.5 + 0.5 * (double)(d[2] * d[2]) + 0.1 * (double)(d[0] * d[0]);
}

static double four_factors(const float l[3], const float v[3]) {
  float h[3], d[3];
  btfi_cmf_to_hd(l, v, h, d);
  return p_of(l) * r_of(v) * q_of(h) * d_of(d);
}
static double three_factors(const float l[3], const float v[3]) {
  float h[3];
  btfi_cmf_half(l, v, h);
  return p_of(l) * r_of(v) * q_of(h);
}
static double half_difference(const float l[3], const float v[3]) {
  float h[3], d[3];
  btfi_cmf_to_hd(l, v, h, d);
  return q_of(h) * d_of(d);
}

/* What resampling alone costs: the planted table interpolated from the directions of the data to cells of the
 * half-difference tables, against the function itself, by barycentric weights. */
static double resampling_floor(const char *directions, const btfi_cmf_settings *s, planted_fn f) {
  btf_context *ctx = test_context(&memory);
  btf_dirset *set;
  assert_ok(btf_dirset_create_named(ctx, directions, &set));
  const float *xyz = btf_dirset_directions(set);
  const btfi_cmf_map map = btfi_cmf_map_of(s->grid, s->resolution);
  double error = 0.0, energy = 0.0;
  for (uint32_t i = 0; i < btfi_cmf_map_texels(&map); i++)
    for (uint32_t j = 0; j < btfi_cmf_map_texels(&map); j += 3) {
      float h[3], d[3], l[3], v[3];
      btf_interp at_l, at_v;
      if (!btfi_cmf_map_direction(&map, i, h) || !btfi_cmf_map_direction(&map, j, d)) continue;
      if (!btfi_cmf_from_hd(h, d, l, v)) continue;
      btf_dirset_locate(set, l, &at_l);
      btf_dirset_locate(set, v, &at_v);
      double value = 0.0;
      for (int k = 0; k < 9; k++)
        value += (double)at_l.weight[k % 3] * (double)at_v.weight[k / 3] *
                 f(xyz + 3 * at_l.index[k % 3], xyz + 3 * at_v.index[k / 3]);
      const double truth = f(l, v);
      error += (value - truth) * (value - truth);
      energy += truth * truth;
    }
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
  return sqrt(error / energy);
}

/* FAC05, FAC06: planted factors are recovered as well as resampling allows. */
static void test_planted_factors(void **unused) {
  (void)unused;
  const struct {
    const char *chain;
    planted_fn f;
  } cases[] = {{"h,io", three_factors}, {"hd,io", four_factors}};
  for (size_t n = 0; n < 4; n++) {
    const size_t i = n / 2;
    btfi_cmf_settings s = settings_of(cases[i].chain);
    s.map = n % 2 == 0 ? CMF_PARABOLIC : CMF_CUBE;
    s.residue = CMF_WEIGHTED;
    s.resolution = 24;
    s.sweeps = 12;
    const double floor = resampling_floor("ubo81", &s, cases[i].f);
    bench b = bench_open("ubo81", &s);
    plant(&b, cases[i].f);
    const double error = factor(&b);
    check_positive(&b);
    bench_close(&b);
    s.sweeps = 0;
    const double paper = plant_and_factor("ubo81", &s, cases[i].f);
    print_message("planted %s, %s maps: error %.5f, without sweeps %.5f; resampling alone %.5f\n",
                  cases[i].chain, s.map == CMF_CUBE ? "cube" : "parabolic", error, paper, floor);
    assert_true(error < floor);
    assert_true(paper < 2.0 * floor);
  }
}

/* PAR06: on data that are separable in (h, d) a finer table lowers the error, and little is left for later
 * stages. */
static void test_intermediate_resolution(void **unused) {
  (void)unused;
  double before = INFINITY;
  for (uint32_t resolution = 6; resolution <= 24; resolution *= 2) {
    btfi_cmf_settings s = settings_of("hd");
    s.resolution = resolution;
    const double error = plant_and_factor("ubo81", &s, half_difference);
    print_message("table of %u: error %.5f\n", resolution, error);
    assert_true(error < 0.9 * before);
    before = error;
  }
  btfi_cmf_settings s = settings_of("hd,io");
  s.resolution = 24;
  bench b = bench_open("ubo81", &s);
  plant(&b, half_difference);
  (void)factor(&b);
  /* The residue is 1 but for interpolation: so are the factors of light and view, up to one scale. */
  for (uint32_t i = 2; i < 4; i++) {
    double mean = 0.0, deviation = 0.0;
    const float *map = b.maps + i * b.g->map_texels;
    for (uint32_t t = 0; t < b.g->map_texels; t++) mean += (double)map[t] / b.g->map_texels;
    for (uint32_t t = 0; t < b.g->map_texels; t++)
      deviation += ((double)map[t] / mean - 1.0) * ((double)map[t] / mean - 1.0) / b.g->map_texels;
    assert_true(sqrt(deviation) < 3.0 * before);
  }
  bench_close(&b);
}

/* A texel at an edge: one facet or the other is seen, depending on the view alone. */
static double edge_texel(const float l[3], const float v[3]) {
  const double left = fmax(0.0, 0.6 * (double)l[2] + 0.8 * (double)l[0]);
  const double right = fmax(0.0, 0.6 * (double)l[2] - 0.8 * (double)l[0]);
  const double seen = 1.0 / (1.0 + exp(-6.0 * (double)v[0]));
  return 0.05 + seen * left + (1.0 - seen) * right;
}
static double flat_texel(const float l[3], const float v[3]) {
  float h[3];
  btfi_cmf_half(l, v, h);
  return 0.3 + pow((double)h[2], 20.0);
}

/* FAC07: the order of stages matters. FAC08: factors of the light cannot stand for the view. */
static void test_order_and_symmetry(void **unused) {
  (void)unused;
  btfi_cmf_settings hd_io = settings_of("hd,io"), io_hd = settings_of("io,hd"), plain = settings_of("h,io");
  hd_io.resolution = io_hd.resolution = 16;
  const double last_original = plant_and_factor("ubo81", &hd_io, edge_texel);
  const double first_original = plant_and_factor("ubo81", &io_hd, edge_texel);
  print_message("hd,io: %.5f; io,hd: %.5f\n", last_original, first_original);
  assert_true(fabs(last_original - first_original) > 1e-3);
  const double separate = plant_and_factor("ubo81", &plain, edge_texel);
  const double flat_separate = plant_and_factor("ubo81", &plain, flat_texel);
  plain.symmetric = true;
  const double same = plant_and_factor("ubo81", &plain, edge_texel);
  const double flat_same = plant_and_factor("ubo81", &plain, flat_texel);
  print_message("edge: separate %.4f, symmetric %.4f; flat: %.4f, %.4f\n", separate, same, flat_separate,
                flat_same);
  assert_true(same > 1.05 * separate);
  assert_near(flat_same, flat_separate, 1e-3);
}

/* FAC07: chains of more stages and of one-sided ones; several terms lower the error; FAC02: non-negative
 * terms. */
static void test_general_chains(void **unused) {
  (void)unused;
  const char *const chains[] = {"i,o", "h,io", "h,io:2", "h,io:3", "ih,oh", "h,d,io", "hd,io,ih"};
  double error[7];
  for (size_t i = 0; i < 7; i++) {
    for (uint32_t method = CMF_SVD; method <= CMF_NONNEGATIVE; method++)
      for (uint32_t average = CMF_VALID; average <= CMF_UNIFORM; average++) {
        btfi_cmf_settings s = settings_of(chains[i]);
        s.method = method;
        s.average = average;
        s.residue = CMF_WEIGHTED;
        s.resolution = 12;
        s.grid = average == CMF_VALID ? CMF_ANGULAR : CMF_PARABOLIC;
        bench b = bench_open("grid:8x4", &s);
        plant(&b, edge_texel);
        const double e = factor(&b);
        assert_true(e < 0.9);
        check_positive(&b);
        if (method == CMF_SVD && average == CMF_VALID) error[i] = e;
        bench_close(&b);
      }
  }
  assert_true(error[2] < 0.8 * error[1] && error[3] < error[2]);
}

/* PAR04: a projection of the user's: mirrored light and view. */
static void project_mirrored(const float light[3], const float view[3], float first[3], float second[3]) {
  for (int i = 0; i < 3; i++) {
    first[i] = i < 2 ? -light[i] : light[i];
    second[i] = i < 2 ? -view[i] : view[i];
  }
}
static bool invert_mirrored(const float first[3], const float second[3], float light[3], float view[3]) {
  project_mirrored(first, second, light, view);
  return light[2] > 0.0f && view[2] > 0.0f;
}
static void test_user_projection(void **unused) {
  (void)unused;
  const btfi_cmf_pair mirrored = {"mine", {CMF_OTHER, CMF_OTHER}, project_mirrored, invert_mirrored};
  btfi_cmf_settings s = settings_of("io");
  s.resolution = 32;
  s.stage[0].pair = &mirrored;
  const double error = plant_and_factor("ubo81", &s, three_factors);
  s.stage[0].pair = btfi_cmf_pair_of("io", 2);
  const double known = plant_and_factor("ubo81", &s, three_factors);
  /* The same rank-1 problem through tables: interpolation costs little on smooth data. */
  assert_near(error, known, 0.02);
}

/* Data that are 0, constant, negative or tiny, in one channel of several. */
static void test_degenerate_data(void **unused) {
  (void)unused;
  btfi_cmf_settings s = settings_of("h,io:2");
  s.residue = CMF_WEIGHTED;
  s.sweeps = 2;
  bench b = bench_open("grid:6x3", &s);
  const uint32_t pairs = b.count * b.count, channels = 5;
  float *abrdf = malloc(pairs * channels * sizeof *abrdf);
  float *maps = malloc((size_t)b.g->factors * b.g->map_texels * channels * sizeof *maps);
  for (uint32_t p = 0; p < pairs; p++) {
    const float values[] = {0.0f, 0.25f, -1.0f, 1e-30f, p == 7 ? 1e30f : 0.0f};
    memcpy(abrdf + p * channels, values, sizeof values);
  }
  btfi_cmf_report report = {0};
  btfi_cmf_factor_abrdf(b.g, channels, abrdf, b.scratch, maps, &report);
  for (size_t i = 0; i < (size_t)b.g->factors * b.g->map_texels * channels; i++)
    assert_true(isfinite(maps[i]));
  for (uint32_t t = 0; t < b.g->map_texels; t++) assert_true(maps[t * channels] == 0.0f);
  free(abrdf);
  free(maps);
  bench_close(&b);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_maps_are_bijections),
      cmocka_unit_test(test_maps),
      cmocka_unit_test(test_texels_that_are_read),
      cmocka_unit_test(test_corners_are_extrapolated),
      cmocka_unit_test(test_half_difference),
      cmocka_unit_test(test_pairs),
      cmocka_unit_test(test_chains),
      cmocka_unit_test(test_preparing_can_be_cancelled),
      cmocka_unit_test(test_terms_are_singular_pairs),
      cmocka_unit_test(test_planted_factors),
      cmocka_unit_test(test_intermediate_resolution),
      cmocka_unit_test(test_order_and_symmetry),
      cmocka_unit_test(test_general_chains),
      cmocka_unit_test(test_user_projection),
      cmocka_unit_test(test_degenerate_data),
  };
  return btf_run("cmf_factor", tests);
}
