/* SPDX-License-Identifier: MIT */
/*
 * Exports of models as large as the papers': they fit what every driver takes, take no more memory than their
 * textures, and give in software GL what the model gives. What does not fit is refused with the limit and
 * what would do. Textures whose bytes a paper states have them.
 */
#include "../btf_test.h"
#include "../codec_cases.h"
#include "gl_host.h"

#include <btf/btf_sampling.h>

/* What docs/gpu-export.md promises where the target says nothing. */
enum { MOST_2D = 8192, MOST_3D = 2048, MOST_LAYERS = 256, MOST_TEXTURES = 16 };
enum { QUERIES = 400, MIB = 1 << 20 };

/* As test_gpu.c has it: of the largest value here. */
#define TOLERANCE 1e-3

static float queries[QUERIES][9], got[QUERIES][3];

/* ---- a material given as factors ---- */

enum { SIDE = 1024, DIRECTIONS = 151, COMPONENTS = 100, LEVELS = 11 };
static const uint32_t component_count = COMPONENTS;

/* Vectors of falling length without any order, so that no component can be left out. */
static void column(const void *user, uint32_t product, uint32_t side, uint32_t k, float *dst) {
  const uint32_t length = side == BTF_SIDE_TEXEL ? SIDE * SIDE : DIRECTIONS * DIRECTIONS * 3;
  const float scale = side == BTF_SIDE_TEXEL ? 1.0f : 0.2f / (float)(k + 1);
  uint32_t state = 2 * k + side + 1;
  (void)user, (void)product;
  for (uint32_t i = 0; i < length; i++) {
    state = state * 1664525u + 1013904223u;
    dst[i] = scale * ((float)(state >> 8) / 8388608.0f - 0.9f);
  }
}

static btf_status factors(void *user, btf_factors *out) {
  (void)user;
  out->products = 1;
  out->value_bytes = 4;
  out->components = &component_count;
  out->column = column;
  return BTF_OK;
}

static btf_status no_samples(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  (void)user, (void)block, (void)dst, (void)strides;
  return btf_source_error(BTF_E_IO, "there are factors");
}

static void make_large_fmf(btf_context *ctx, const btf_codec *fmf, btf_model **out) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_options *options;
  btf_dirset *set;
  btf_dataset *ds;
  assert_ok(btf_dirset_create_named(ctx, "ubo151", &set));
  desc.lights = desc.views = set;
  desc.width = desc.height = SIDE;
  desc.channels = 3;
  desc.read = no_samples;
  desc.factors = factors;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  assert_ok(btf_options_create(fmf, &options));
  assert_ok(btf_options_set(options, "storage", "f16"));
  assert_ok(btf_model_from_factors(ds, fmf, options, NULL, out));
  btf_options_release(options);
  btf_dataset_release(ds);
  btf_dirset_release(set);
}

/* ---- what is checked ---- */

/* Bytes of all textures, each of which is within the limits. */
static uint64_t expect_within_limits(const btf_gpu_export *e) {
  uint64_t bytes = 0;
  assert_in_range(btf_gpu_texture_count(e), 1, MOST_TEXTURES);
  for (uint32_t i = 0; i < btf_gpu_texture_count(e); i++) {
    btf_gpu_texture t = BTF_GPU_TEXTURE_INIT;
    assert_ok(btf_gpu_texture_at(e, i, &t));
    const uint32_t side = t.dimension == BTF_TEXTURE_3D ? MOST_3D : MOST_2D;
    assert_in_range(t.width, 1, side);
    assert_in_range(t.height, 1, side);
    assert_in_range(t.depth, 1, t.dimension == BTF_TEXTURE_3D ? MOST_3D : 1);
    assert_in_range(t.layers, 1, t.dimension == BTF_TEXTURE_2D_ARRAY ? MOST_LAYERS : 1);
    for (uint32_t l = 0; l < t.level_count; l++) bytes += t.levels[l].size;
    print_message("  %s: %u x %u x %u, %u levels\n", t.name, t.width, t.height, t.depth * t.layers,
                  t.level_count);
  }
  return bytes;
}

static void texture_named(const btf_gpu_export *e, const char *name, btf_gpu_texture *out) {
  for (uint32_t i = 0; i < btf_gpu_texture_count(e); i++) {
    *out = (btf_gpu_texture)BTF_GPU_TEXTURE_INIT;
    assert_ok(btf_gpu_texture_at(e, i, out));
    if (strcmp(out->name, name) == 0) return;
  }
  fail_msg("no texture %s", name);
}

/* Through files and software GL, where there is one. */
static void expect_equal_to_model(const btf_gpu_export *e, const btf_model *model, uint32_t levels) {
  const char *why;
  gpu_host *host = gl_host_open(GL_ES_300, &why);
  double largest = 0.0, difference = 0.0;
  if (host == NULL) {
    print_message("  not compared: %s\n", why);
    return;
  }
  for (uint32_t i = 0; i < QUERIES; i++) {
    const btf_query q = codec_case_plain_query(i, (float)(i % (2 * levels)) / 2.0f);
    const float members[9] = {q.light[0], q.light[1], q.light[2], q.view[0], q.view[1],
                              q.view[2],  q.uv[0],    q.uv[1],    q.lod};
    memcpy(queries[i], members, sizeof members);
  }
  gpu_host_run(host, e, 0, NULL, NULL, queries[0], QUERIES, got[0]);
  for (uint32_t i = 0; i < QUERIES; i++) {
    const btf_query q = codec_case_plain_query(i, queries[i][8]);
    float f[3];
    btf_model_eval(model, &q, f);
    for (int c = 0; c < 3; c++) {
      assert_true(isfinite(got[i][c]));
      largest = fmax(largest, fabs((double)f[c]));
      difference = fmax(difference, fabs((double)got[i][c] - (double)f[c]));
    }
  }
  print_message("  largest difference %.2g of %.3g\n", difference, largest);
  assert_true(largest > 0.0 && difference <= TOLERANCE * largest);
  host->close(host);
}

/* ---- exports that fit ---- */

static void fmf_as_large_as_the_papers(void **state) {
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 2);
  const btf_codec *fmf = btf_codec_find(ctx, "fmf");
  const char *layout;
  btf_model *model;
  uint64_t v_texels = 0;
  (void)state;
  if (fmf == NULL) skip();
  make_large_fmf(ctx, fmf, &model);
  for (uint32_t l = 0; l < LEVELS; l++) v_texels += (uint64_t)(SIDE >> l) * (SIDE >> l);
  for (uint32_t i = 0; (layout = btf_codec_gpu_layout(fmf, i, NULL)) != NULL; i++) {
    btf_gpu_target target = BTF_GPU_TARGET_INIT;
    btf_gpu_texture u, v;
    btf_gpu_export *e;
    target.layout = layout;
    uint64_t before, held;
    btf_context_memory(ctx, &before, NULL);
    assert_ok(btf_gpu_export_create(model, &target, &e));
    print_message("fmf, %s:\n", layout);
    const uint64_t bytes = expect_within_limits(e);
    btf_context_memory(ctx, &held, NULL);
    held -= before;
    print_message("  %llu bytes in textures, %llu held\n", (unsigned long long)bytes,
                  (unsigned long long)held);
    assert_in_range(held, bytes, bytes + MIB); /* texts, and the block of numbers */
    texture_named(e, "btf_u_map", &u);
    texture_named(e, "btf_v_map", &v);
    /* 100 columns are 25 texels of four; rests of rounding fill rows up to 112 columns at most. */
    assert_in_range(v.layers, COMPONENTS / 4, 28);
    assert_int_equal(u.layers, 3 * v.layers);
    assert_true(u.width == DIRECTIONS && u.height == DIRECTIONS && v.width == SIDE && v.height == SIDE);
    assert_int_equal(v.level_count, LEVELS);
    /* All but the directions' textures, of 6 MiB at most, are the factors in halves. */
    assert_in_range(bytes - 8 * v.layers * (v_texels + 3 * DIRECTIONS * DIRECTIONS), 1, 6 * MIB);
    if (i == 0) expect_equal_to_model(e, model, LEVELS);
    btf_gpu_export_release(e);
  }
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

static void fit(btf_context *ctx, const char *codec, const char *options, uint32_t material,
                btf_model **out) {
  const codec_case row = {.codec = codec, .options = options};
  const codec_dataset_recipe recipe = {.material = material, .channels = 3};
  assert_ok(codec_case_fit(ctx, &row, &recipe, NULL, NULL, out));
}

static void cmf_of_256_entries(void **state) {
  static const char *const stacks[] = {"btf_light_factors_map", "btf_half_factors_map",
                                       "btf_view_factors_map"};
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  btf_gpu_texture t;
  btf_gpu_export *e;
  btf_model *model;
  (void)state;
  assert_ok(codec_case_context(&desc, &ctx));
  if (btf_codec_find(ctx, "cmf") == NULL) skip();
  fit(ctx, "cmf", "edge=8,resolution=8,codebook=256,sweeps=0", MATERIAL_LARGE, &model);
  assert_ok(btf_gpu_export_create(model, NULL, &e));
  print_message("cmf:\n");
  expect_within_limits(e);
  for (size_t i = 0; i < sizeof stacks / sizeof *stacks; i++) {
    texture_named(e, stacks[i], &t);
    assert_true(t.dimension == BTF_TEXTURE_3D && t.depth == 256 && t.texel == BTF_TEXEL_RGBA8_UNORM);
  }
  texture_named(e, "btf_index_map", &t);
  assert_true(t.layers == 1 && t.texel == BTF_TEXEL_RGBA8_UNORM);
  texture_named(e, "btf_scale_map", &t);
  assert_true(t.layers == 1 && t.texel == BTF_TEXEL_RGBA8_UNORM);
  expect_equal_to_model(e, model, t.level_count);
  btf_gpu_export_release(e);
  btf_model_release(model);
  btf_context_release(ctx);
}

/* Samples without any order, so that every level has all components. */
static btf_status noise(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  (void)user;
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++)
          for (uint32_t c = 0; c < 3; c++) {
            uint32_t at = ((((b->view0 + v) * 64 + b->light0 + l) * 64 + b->y0 + y) * 64 + b->x0 + x) * 4 + c;
            at = (at ^ at >> 15) * 0x2c1b3c6du;
            at = (at ^ at >> 12) * 0x297a2d39u;
            *(float *)(void *)((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light +
                               (ptrdiff_t)y * s->y + (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel) =
                (float)(at >> 8) / 16777216.0f;
          }
  return BTF_OK;
}

/* Ma et al. 2005, sect. 3.3: 48 p q (lmax + 1) bytes and 64 r^2. */
static void laplacian_maps_have_the_papers_bytes(void **state) {
  enum { P = 8, Q = 6, R = 16 };
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_dirset *lights, *views;
  btf_options *options;
  btf_context *ctx;
  btf_dataset *ds;
  btf_model *model;
  btf_gpu_texture eigen, weights;
  btf_gpu_export *e;
  (void)state;
  assert_ok(codec_case_context(&desc, &ctx));
  const btf_codec *laplacian = btf_codec_find(ctx, "laplacian");
  if (laplacian == NULL) skip();
  assert_ok(btf_dirset_create_named(ctx, "grid:4x2", &lights));
  assert_ok(btf_dirset_create_named(ctx, "grid:3x2", &views));
  d.lights = lights;
  d.views = views;
  d.width = d.height = R;
  d.channels = 3;
  d.read = noise;
  assert_ok(btf_dataset_create(ctx, &d, &ds));
  assert_ok(btf_options_create(laplacian, &options));
  assert_ok(btf_model_fit(ds, laplacian, options, NULL, &model));
  assert_ok(btf_model_describe(model, &info));
  assert_ok(btf_gpu_export_create(model, NULL, &e));
  texture_named(e, "btf_eigen_map", &eigen);
  texture_named(e, "btf_weights_map", &weights);
  print_message("laplacian: %u levels, %llu and %llu bytes\n", info.levels,
                (unsigned long long)eigen.levels[0].size, (unsigned long long)weights.levels[0].size);
  assert_true(info.levels > 1 && eigen.levels[0].size == 48u * P * Q * info.levels);
  assert_true(weights.levels[0].size == 64u * R * R && weights.width == 2 * R && weights.height == 2 * R);
  assert_true(eigen.level_count == 1 && weights.level_count == 1);
  btf_gpu_export_release(e);
  btf_model_release(model);
  btf_options_release(options);
  btf_dataset_release(ds);
  btf_dirset_release(lights);
  btf_dirset_release(views);
  btf_context_release(ctx);
}

/* ---- refusals ---- */

/* "a target of at least N": N is enough, and one less is not. */
static void expect_least_to_do(const btf_model *model, const btf_gpu_target *refused, uint32_t *limit) {
  const char *said = strstr(btf_error_message(), "a target of at least ");
  const uint32_t given = *limit;
  btf_gpu_export *e;
  assert_non_null(said);
  const uint32_t least = (uint32_t)strtoul(said + strlen("a target of at least "), NULL, 10);
  assert_in_range(least, given + 1, 1 << 20);
  *limit = least;
  assert_ok(btf_gpu_export_create(model, refused, &e));
  btf_gpu_export_release(e);
  *limit = least - 1;
  assert_status(btf_gpu_export_create(model, refused, &e), BTF_E_LIMIT);
  *limit = given;
}

static void refusals_say_what_would_do(void **state) {
  static const struct {
    const char *codec, *options;
    btf_gpu_target target;
    const char *limit, *would_do;
    btf_gpu_target fits; /* as the message says; nothing where it says a least target only */
    size_t least; /* where the member of a target is that the message has the least value of; 0 = none */
  } trials[] = {
      /* The map of facets has 256 texels along a side, whatever the model. */
      {"fmf",
       "components=8",
       {.max_2d = 100},
       "btf_light_near_map would have 256 texels along a side, more than the 100",
       "textures; a target of at least 256 would do",
       {0},
       offsetof(btf_gpu_target, max_2d)},
      /* Other textures are too large, too. */
      {"fmf",
       "components=8",
       {.max_2d = 3},
       "256 texels along a side, more than the 3",
       "textures; a target of at least",
       {0},
       offsetof(btf_gpu_target, max_2d)},
      {"fmf",
       "components=8",
       {.layout = "raster", .max_2d = 500},
       "512 texels along a side, more than the target's 500",
       "layout",
       {.layout = "rgba", .max_2d = 500},
       0},
      {"fmf",
       "components=30",
       {.max_layers = 1, .max_textures = 9},
       " textures, more than the target's 9",
       "fewer components, a target with more layers or",
       {.max_textures = 9},
       offsetof(btf_gpu_target, max_textures)},
      /* More layers do not help, nor fewer components. */
      {"pvpca",
       "components=8",
       {.max_textures = 2},
       " textures, more than the target's 2",
       "2; a target of at least",
       {0},
       offsetof(btf_gpu_target, max_textures)},
      {"cmf",
       "edge=8,resolution=8,codebook=16",
       {.layout = "stacks", .max_3d = 15},
       "16 maps of one projection, the target's 3D textures have 15 slices",
       "\"atlas\" would do",
       {.layout = "atlas", .max_3d = 15},
       0},
      {"cmf",
       "edge=8,resolution=8,codebook=0",
       {.layout = "stacks", .max_3d = 15},
       "15 slices",
       "\"atlas\" would do",
       {.layout = "atlas", .max_3d = 15},
       0},
      /* Few maps, of many texels. */
      {"cmf",
       "edge=16,resolution=16,codebook=2",
       {.layout = "stacks", .max_3d = 5},
       "more than the 5 of the target's 3D textures",
       "textures; a target of at least",
       {0},
       offsetof(btf_gpu_target, max_3d)},
      {"lpca",
       "clusters=9,components=8",
       {.layout = "bytes", .max_3d = 17},
       "stacks of 18 slices, the target's 3D textures have 17",
       "\"full\" would do",
       {.layout = "full", .max_3d = 17},
       0},
      {"laplacian",
       "levels=3",
       {.layout = "maps", .max_2d = 30},
       "more than the target's 30",
       "\"arrays\" would do",
       {.layout = "arrays", .max_2d = 256},
       0},
      {"pvpca",
       "components=8",
       {.max_layers = 2, .max_textures = 7},
       " textures, more than the target's 7",
       "a target with more layers or",
       {.max_textures = 7},
       offsetof(btf_gpu_target, max_textures)},
      {"lafortune",
       "lobes=3",
       {.max_2d = 6},
       "7 texels along a side, more than the 6",
       "a smaller material or",
       {0},
       offsetof(btf_gpu_target, max_2d)},
  };
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  (void)state;
  assert_ok(codec_case_context(&desc, &ctx));
  for (size_t i = 0; i < sizeof trials / sizeof *trials; i++) {
    btf_gpu_target target = trials[i].target, fits = trials[i].fits;
    btf_gpu_export *e;
    btf_model *model;
    if (btf_codec_find(ctx, trials[i].codec) == NULL) continue;
    target.struct_size = fits.struct_size = sizeof target;
    fit(ctx, trials[i].codec, trials[i].options, MATERIAL_SMOOTH, &model);
    assert_status(btf_gpu_export_create(model, &target, &e), BTF_E_LIMIT);
    assert_null(e);
    assert_message_has(trials[i].limit);
    assert_message_has(trials[i].would_do);
    if (trials[i].least != 0)
      expect_least_to_do(model, &target, (uint32_t *)(void *)((char *)&target + trials[i].least));
    if (trials[i].fits.max_2d + trials[i].fits.max_3d + trials[i].fits.max_textures != 0) {
      assert_ok(btf_gpu_export_create(model, &fits, &e));
      btf_gpu_export_release(e);
    }
    btf_model_release(model);
  }
  btf_context_release(ctx);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(fmf_as_large_as_the_papers), cmocka_unit_test(cmf_of_256_entries),
      cmocka_unit_test(laplacian_maps_have_the_papers_bytes), cmocka_unit_test(refusals_say_what_would_do)};
  return btf_run("gpu_limits", tests);
}
