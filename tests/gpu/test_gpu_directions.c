/* SPDX-License-Identifier: MIT */
/*
 * Searches for directions in shaders, in sets that are hard to walk through: rims that are chains of slivers,
 * samples a hundredth of a degree apart, pairs that nearly coincide. Values of neighbours have nothing in
 * common, so that a weight too much shows.
 */
#include "../btf_test.h"
#include "../codec_cases.h"
#include "../dataset_cube.h"
#include "gl_host.h"
#include "trial.h"

enum { QUERIES = 4096, MOST_LIGHTS = 81 * 81 };

/* What parabolic coordinates may be off by on either side: a square root, two sums and a quotient, which
 * shaders may round to 2.5 units, of numbers below 2. */
#define COORDINATE_ERROR 4e-7

typedef struct hard_set {
  const char *name;
  uint32_t (*fill)(float (*light)[3]);
  double at[2], radius; /* of the queries, in parabolic coordinates */
} hard_set;

static float lights[MOST_LIGHTS][3], values[MOST_LIGHTS][3];
static float queries[QUERIES][9], got[QUERIES][3];

/* Of deviation 1; the sum of twelve is near enough to normal. */
static double noise(uint64_t *state) {
  double sum = -6.0;
  for (int i = 0; i < 12; i++) sum += (double)test_uniform(state);
  return sum;
}

static void direction_at(double x, double y, float out[3]) {
  const double r2 = x * x + y * y;
  out[0] = (float)(2.0 * x / (1.0 + r2));
  out[1] = (float)(2.0 * y / (1.0 + r2));
  out[2] = (float)((1.0 - r2) / (1.0 + r2));
}

static uint32_t fill_grid(float (*light)[3], int half, double spacing, double deviation) {
  uint64_t state = 4;
  uint32_t n = 0;
  for (int x = -half; x <= half; x++)
    for (int y = -half; y <= half; y++, n++)
      direction_at(spacing * x + deviation * noise(&state), spacing * y + deviation * noise(&state),
                   light[n]);
  return n;
}

static uint32_t camera_grid(float (*light)[3]) {
  return fill_grid(light, 40, 0.01, 1e-5);
}

static uint32_t narrow_patch(float (*light)[3]) {
  return fill_grid(light, 40, 8e-5, 4e-6);
}

static uint32_t goniometer(float (*light)[3]) {
  const double degree = acos(-1.0) / 180.0;
  uint64_t state = 5;
  uint32_t n = 0;
  for (int ring = 0; ring <= 5; ring++)
    for (int k = 0; k < (ring == 0 ? 1 : 24); k++, n++) {
      const double polar = (15.0 * ring + 0.005 * noise(&state)) * degree,
                   azimuth = (15.0 * k + 0.005 * noise(&state)) * degree, r = tan(0.5 * polar);
      direction_at(r * cos(azimuth), r * sin(azimuth), light[n]);
    }
  return n;
}

static uint32_t near_pairs(float (*light)[3]) {
  uint64_t state = 6;
  for (uint32_t i = 0; i < 80; i++) {
    const double r = 0.95 * sqrt((i + 0.5) / 80.0), x = r * cos(2.4 * i), y = r * sin(2.4 * i);
    direction_at(x, y, light[2 * (size_t)i]);
    direction_at(x + 1e-3 * noise(&state), y + 1e-3 * noise(&state), light[2 * (size_t)i + 1]);
  }
  return 160;
}

static const hard_set sets[] = {
    {"a camera's grid, at its rim", camera_grid, {0.0, 0.4}, 0.05},
    {"a camera's grid, at its corner", camera_grid, {0.4, 0.4}, 0.02},
    {"a camera's grid", camera_grid, {0.0, 0.0}, 0.6},
    /* within its rim, where values change by as much as they can in less than coordinates are off by */
    {"a narrow patch", narrow_patch, {0.0, 0.0}, 0.0031},
    {"a goniometer", goniometer, {0.0, 0.0}, 0.8},
    {"pairs", near_pairs, {0.0, 0.0}, 0.9},
};

/* A texel seen from above; one component holds any values of the lights. */
static btf_model *fit(btf_context *ctx, uint32_t count) {
  static const float above[3] = {0.0f, 0.0f, 1.0f};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_dirset *light_set, *view_set;
  btf_options *options;
  btf_dataset *ds;
  btf_model *model;
  assert_ok(btf_dirset_create(ctx, lights[0], count, &light_set));
  assert_ok(btf_dirset_create(ctx, above, 1, &view_set));
  assert_int_equal(btf_dirset_count(light_set), count);
  desc.lights = light_set;
  desc.views = view_set;
  desc.width = desc.height = 1;
  desc.channels = 3;
  desc.data = values;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  assert_ok(btf_options_create(btf_codec_find(ctx, "fmf"), &options));
  assert_ok(btf_options_set(options, "components", "1"));
  assert_ok(btf_options_set(options, "storage", "f32"));
  assert_ok(btf_model_fit(ds, btf_codec_find(ctx, "fmf"), options, NULL, &model));
  btf_options_release(options);
  btf_dataset_release(ds);
  btf_dirset_release(light_set);
  btf_dirset_release(view_set);
  return model;
}

/* Least and most of what the C evaluation gives for coordinates as far apart as errors may take them. */
static void evaluate_around(const btf_model *model, double x, double y, double low[3], double high[3]) {
  for (int k = 0; k < 3; k++) low[k] = HUGE_VAL, high[k] = -HUGE_VAL;
  for (int i = 0; i < 25; i++) {
    btf_query q = {.view = {0.0f, 0.0f, 1.0f}, .uv = {0.5f, 0.5f}};
    float f[3];
    direction_at(x + COORDINATE_ERROR * (i % 5 - 2) / 2, y + COORDINATE_ERROR * (i / 5 - 2) / 2, q.light);
    btf_model_eval(model, &q, f);
    for (int k = 0; k < 3; k++) {
      low[k] = fmin(low[k], (double)f[k]);
      high[k] = fmax(high[k], (double)f[k]);
    }
  }
}

static void make_queries(const hard_set *set, double (*at)[2]) {
  uint64_t state = 7;
  for (uint32_t i = 0; i < QUERIES; i++) {
    for (int k = 0; k < 2; k++)
      at[i][k] = set->at[k] + set->radius * (2.0 * (double)test_uniform(&state) - 1.0);
    const double r = hypot(at[i][0], at[i][1]);
    for (int k = 0; r > 0.999 && k < 2; k++) at[i][k] *= 0.999 / r;
    memcpy(queries[i], (const float[9]){0, 0, 0, 0, 0, 1, 0.5f, 0.5f, 0}, sizeof queries[i]);
    direction_at(at[i][0], at[i][1], queries[i]);
  }
}

typedef struct outcome {
  uint32_t beyond;
  double farthest;
} outcome;

/* Peaks are 1: what the contract allows is TRIAL_TOLERANCE. */
static outcome compare(const btf_model *model, double (*at)[2]) {
  outcome out = {0, 0.0};
  for (uint32_t i = 0; i < QUERIES; i++) {
    double low[3], high[3], off = 0.0;
    evaluate_around(model, at[i][0], at[i][1], low, high);
    for (int k = 0; k < 3; k++)
      off = fmax(off, fmax(low[k] - (double)got[i][k], (double)got[i][k] - high[k]));
    out.beyond += !(off <= TRIAL_TOLERANCE);
    out.farthest = fmax(out.farthest, off);
  }
  return out;
}

/* A walk that gives up, and one that is content with a neighbour: what follows `before` in
 * its line is written over. */
typedef struct walk_fault {
  const char *what, *before, *text;
} walk_fault;
static const walk_fault faults[] = {
    {"at most 64 facets", "walked < ", "64; ++walked) { //"},
    {"a slack of 1e-5", "slack = -4e-7", " * 25.0; //"},
};

static char *plant(char *glsl, const void *user) {
  const walk_fault *fault = user;
  char *at = strstr(glsl, fault->before);
  assert_non_null(at);
  memcpy(at + strlen(fault->before), fault->text, strlen(fault->text));
  return glsl;
}

static void walks_end_where_c_does(void **state) {
  static double at[QUERIES][2];
  const btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  uint64_t random = 8;
  btf_context *ctx;
  const char *why;
  (void)state;
  gpu_host *host = gl_host_open(GL_ES_300, &why);
  if (host == NULL) skip();
  assert_ok(codec_case_context(&desc, &ctx));
  if (btf_codec_find(ctx, "fmf") == NULL) skip();
  for (uint32_t i = 0; i < MOST_LIGHTS; i++)
    for (int k = 0; k < 3; k++) values[i][k] = test_uniform(&random);
  for (size_t s = 0; s < sizeof sets / sizeof *sets; s++) {
    btf_gpu_export *e;
    btf_model *model = fit(ctx, sets[s].fill(lights));
    assert_ok(btf_gpu_export_create(model, NULL, &e));
    make_queries(&sets[s], at);
    gpu_host_run(host, e, 0, NULL, NULL, queries[0], QUERIES, got[0]);
    const outcome o = compare(model, at);
    print_message("%s: %.2g beyond what coordinates may be off by\n", sets[s].name, o.farthest);
    assert_int_equal(o.beyond, 0);
    for (size_t k = 0; sets[s].fill == narrow_patch && k < sizeof faults / sizeof *faults; k++) {
      gpu_host_run(host, e, 0, plant, &faults[k], queries[0], QUERIES, got[0]);
      const outcome wrong = compare(model, at);
      print_message("%s, %s: %u of %d queries, %.2g\n", sets[s].name, faults[k].what, wrong.beyond, QUERIES,
                    wrong.farthest);
      assert_true(wrong.beyond > 0);
    }
    btf_gpu_export_release(e);
    btf_model_release(model);
  }
  btf_context_release(ctx);
  host->close(host);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(walks_end_where_c_does)};
  return btf_run("gpu_directions", tests);
}
