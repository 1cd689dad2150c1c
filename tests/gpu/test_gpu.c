/* SPDX-License-Identifier: MIT */
/*
 * Exports of every codec, evaluated by software GL from their folders alone and compared with the C
 * evaluation, in each dialect of GLSL. Faults planted in the shader show that the comparison notices them.
 */
#include "../btf_test.h"
#include "../codec_cases.h"
#include "gl_host.h"

enum { QUERIES = 20480, RGB = CHANNELS(3) };

/* Single precision on either side and the sampler's filter leave 1e-5 or so; what the contract of exports
 * allows is this much of the 99.9th percentile. */
#define TOLERANCE 1e-3

static const btf_context_desc defaults = BTF_CONTEXT_DESC_INIT;
static float queries[QUERIES][9], expected[QUERIES][3], got[QUERIES][3], magnitude[QUERIES * 3];
static float divisor[QUERIES]; /* of stored values */

static double uniform(uint64_t *state) {
  *state = *state * 6364136223846793005u + 1442695040888963407u;
  return (double)(*state >> 40) / 16777216.0;
}

/* Uniform over the hemisphere; one in eight grazes and one in sixteen lies below the horizon. */
static void direction(uint64_t *state, float out[3]) {
  const double kind = uniform(state), phi = 6.283185307179586 * uniform(state);
  const double z = kind < 1.0 / 16   ? -uniform(state)
                   : kind < 3.0 / 16 ? 1e-3 + 0.05 * uniform(state)
                                     : uniform(state);
  const double r = sqrt(1.0 - z * z);
  out[0] = (float)(r * cos(phi));
  out[1] = (float)(r * sin(phi));
  out[2] = (float)z;
}

/* Positions inside, in other tiles and on the borders of texels; levels before the first, whole, between and
 * beyond. */
static void make_queries(const btf_model_info *info) {
  uint64_t state = 20;
  for (int i = 0; i < QUERIES; i++) {
    float *q = queries[i];
    direction(&state, q);
    direction(&state, q + 3);
    for (int k = 0; k < 2; k++) {
      const uint32_t size = k == 0 ? info->width : info->height;
      const double place = uniform(&state);
      q[6 + k] = (float)(i % 3 == 0   ? 6.0 * place - 3.0
                         : i % 3 == 1 ? place
                                      : floor(place * size * 2.0) / (size * 2.0));
    }
    const double lod = uniform(&state) * (info->levels + 2.0) - 1.0;
    q[8] = (float)(i % 2 == 0 ? lod : floor(lod));
    divisor[i] = info->quantity == BTF_QUANTITY_BRDF_COS ? fmaxf(q[2], 0.02f) : 1.0f;
  }
}

static void evaluate(const btf_model *model, uint32_t channels) {
  for (int i = 0; i < QUERIES; i++) {
    const float *q = queries[i];
    const btf_query query = {{q[0], q[1], q[2]}, {q[3], q[4], q[5]}, {q[6], q[7]}, q[8], 0};
    float f[64];
    btf_model_eval(model, &query, f);
    for (uint32_t c = 0; c < 3; c++) expected[i][c] = channels == 1 ? f[0] : c < channels ? f[c] : 0.0f;
  }
}

static int compare_floats(const void *a, const void *b) {
  const float x = *(const float *)a, y = *(const float *)b;
  return (x > y) - (x < y);
}

static double percentile(float *values, size_t count) {
  qsort(values, count, sizeof *values, compare_floats);
  return values[(size_t)((double)count * 0.999)];
}

typedef struct errors {
  double peak, largest, percentile;
  double beyond; /* what rounding explains; the largest of it */
} errors;

static errors compare(double rounding) {
  errors e = {.beyond = 0.0};
  for (int i = 0; i < QUERIES; i++)
    for (int c = 0; c < 3; c++) magnitude[3 * i + c] = fabsf(expected[i][c]);
  e.peak = percentile(magnitude, QUERIES * 3);
  for (int i = 0; i < QUERIES; i++)
    for (int c = 0; c < 3; c++) {
      const float difference = fabsf(got[i][c] - expected[i][c]);
      magnitude[3 * i + c] = isfinite(difference) ? difference : INFINITY;
      e.beyond = fmax(e.beyond, (double)magnitude[3 * i + c] - rounding / (double)divisor[i]);
    }
  e.percentile = percentile(magnitude, QUERIES * 3);
  e.largest = magnitude[QUERIES * 3 - 1];
  return e;
}

static errors run(gl_host *host, const char *folder, char *(*edit)(char *), double rounding) {
  const char *wrong = gl_host_load(host, folder, edit);
  if (wrong == NULL) wrong = gl_host_eval(host, queries[0], QUERIES, got[0]);
  if (wrong != NULL) fail_msg("%s: %s", folder, wrong);
  return compare(rounding);
}

static gl_host *open_host(gl_dialect dialect) {
  const char *why;
  gl_host *host = gl_host_open(dialect, &why);
  if (host != NULL) return host;
  print_message("%s: %s\n", gl_dialect_name(dialect), why);
  return NULL;
}

static const char *export_for(const btf_model *model, const btf_gpu_target *target, int32_t zstd,
                              btf_gpu_cost *cost) {
  btf_gpu_export *e;
  const char *folder = test_path("export");
  assert_ok(btf_gpu_export_create(model, target, &e));
  *cost = (btf_gpu_cost)BTF_GPU_COST_INIT;
  assert_ok(btf_gpu_export_cost(e, cost));
  assert_ok(btf_gpu_export_write(e, folder, zstd));
  btf_gpu_export_release(e);
  return folder;
}

static const char *export_to(const btf_model *model, const char *layout, int32_t zstd, btf_gpu_cost *cost) {
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  target.layout = layout;
  return export_for(model, &target, zstd, cost);
}

/* ---- every codec ---- */

/* Settings whose shaders differ from those of all rows of the table. */
static const codec_case more_cases[] = {
    {.codec = "lafortune", .options = "kind=full,lobes=1,storage=f32", .channels = CHANNELS(3)},
    {.codec = "lafortune",
     .options = "color=channel,lobes=1",
     .channels = CHANNELS(1) | CHANNELS(2) | CHANNELS(3)},
    {.codec = "lafortune", .options = "lobes=3", .channels = CHANNELS(4)},
    {.codec = "lafortune", .options = "kind=phong", .channels = CHANNELS(3)},
    {.codec = "lafortune", .options = "kind=blinn_phong,color=channel", .channels = CHANNELS(2)},
    {.codec = "lafortune", .options = "kind=ward,lobes=2", .channels = CHANNELS(3)},
    {.codec = "lafortune", .options = "kind=lewis", .channels = CHANNELS(2)},
    {.codec = "cmf",
     .options = "edge=8,resolution=8,codebook=8,rotate=true,storage=f16",
     .channels = CHANNELS(3)},
    {.codec = "cmf",
     .options = "edge=8,resolution=8,codebook=0,rotate=true,levels=2",
     .channels = CHANNELS(3)},
    {.codec = "cmf", .options = "edge=7,resolution=8,codebook=8,chain=hd:3", .channels = CHANNELS(3)},
    {.codec = "cmf",
     .options = "edge=6,resolution=8,codebook=9,factors=4,map=cube,storage=f32",
     .channels = CHANNELS(3)},
    {.codec = "cmf", .options = "edge=8,codebook=16,method=homomorphic", .channels = CHANNELS(3)},
    {.codec = "lpca", .options = "clusters=5,components=6,storage=q8", .channels = CHANNELS(3)},
    {.codec = "lpca",
     .options = "clusters=3,components=3,storage=f32,packing=tight",
     .channels = CHANNELS(3)},
};

static void check_layout(gl_host *host, const btf_model *model, const codec_case *row, const char *layout,
                         const char *material) {
  btf_gpu_cost cost;
  const char *folder = export_to(model, layout, 3, &cost);
  const errors e = run(host, folder, NULL, cost.rounding);
  print_message("%s %s, %s, %s: largest %.2g, 99.9th percentile %.2g of %.3g, rounding %.2g; %.0f fetches, "
                "%.0f bytes, %.0f operations\n",
                row->codec, row->options, layout, material, e.largest / e.peak, e.percentile / e.peak, e.peak,
                cost.rounding / e.peak, cost.fetches, cost.bytes, cost.flops);
  if (!(e.beyond <= TOLERANCE * e.peak))
    fail_msg("%s: layout %s differs by %.3g of %.3g", row->codec, layout, e.largest, e.peak);
  assert_true(cost.fetches > 0 && cost.bytes > 0 && cost.flops > 0);
}

static void check_row(gl_host *host, btf_context *ctx, const codec_case *row, uint32_t material,
                      uint32_t channels) {
  const codec_dataset_recipe recipe = {material, channels, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  btf_model_info info = BTF_MODEL_INFO_INIT;
  const char *layout;
  btf_model *model;
  const btf_status status = codec_case_fit(ctx, row, &recipe, NULL, NULL, &model);
  if (status == BTF_E_UNSUPPORTED) return;
  assert_ok(status);
  assert_ok(btf_model_describe(model, &info));
  make_queries(&info);
  evaluate(model, channels);
  for (uint32_t i = 0; (layout = btf_codec_gpu_layout(btf_codec_find(ctx, row->codec), i, NULL)) != NULL; i++)
    check_layout(host, model, row, layout, codec_materials[material].name);
  btf_model_release(model);
}

static bool exports(btf_context *ctx, const codec_case *row) {
  const btf_codec *codec = btf_codec_find(ctx, row->codec);
  return codec != NULL && btf_codec_gpu_layout(codec, 0, NULL) != NULL;
}

/* Indices of two bytes. */
#define CMF_LARGE "edge=4,resolution=4,codebook=300,sweeps=0,levels=3"
static const codec_case large_rows[] = {
    {.codec = "cmf", .options = CMF_LARGE, .channels = CHANNELS(3)},
    {.codec = "lpca", .options = "clusters=300,components=2", .channels = CHANNELS(3)},
};

static void check_materials(gl_host *host, btf_context *ctx, const codec_case *row, const uint32_t *materials,
                            size_t count) {
  for (size_t m = 0; m < count; m++) check_row(host, ctx, row, materials[m], codec_case_channels(row, 3));
}

static void every_codec(void **state) {
  static const uint32_t materials[] = {MATERIAL_SMOOTH, MATERIAL_COSINE, MATERIAL_CLAMPED,
                                       MATERIAL_PAIR,   MATERIAL_ROW,    MATERIAL_TEXEL};
  gl_host *host = open_host(GL_ES_300);
  btf_context *ctx;
  uint32_t tried = 0;
  (void)state;
  if (host == NULL) skip();
  print_message("%s\n", gl_host_renderer(host));
  assert_ok(codec_case_context(&defaults, &ctx));
  for (size_t r = 0; r < codec_case_count; r++) {
    const codec_case *row = &codec_cases[r];
    if (!exports(ctx, row)) continue;
    check_materials(host, ctx, row, materials, sizeof materials / sizeof *materials);
    if (codec_case_channels(row, 1) == 1) check_row(host, ctx, row, MATERIAL_SMOOTH, 1);
    tried++;
  }
  for (size_t r = 0; r < sizeof more_cases / sizeof *more_cases; r++) {
    const codec_case *row = &more_cases[r];
    if (!exports(ctx, row)) continue;
    for (uint32_t n = codec_case_channels(row, 1); n != 0; n = codec_case_channels(row, n + 1)) {
      check_row(host, ctx, row, MATERIAL_SMOOTH, n);
      check_row(host, ctx, row, MATERIAL_COSINE, n);
    }
  }
  assert_true(tried > 0);
  for (size_t r = 0; r < sizeof large_rows / sizeof *large_rows; r++)
    if (exports(ctx, &large_rows[r])) check_row(host, ctx, &large_rows[r], MATERIAL_LARGE, 3);
  btf_context_release(ctx);
  gl_host_close(host);
}

/* The first row of each codec in every dialect. */
static void every_dialect(void **state) {
  btf_context *ctx;
  (void)state;
  assert_ok(codec_case_context(&defaults, &ctx));
  for (int d = 0; d < GL_DIALECTS; d++) {
    gl_host *host = open_host((gl_dialect)d);
    if (host == NULL) skip();
    print_message("%s\n", gl_dialect_name((gl_dialect)d));
    for (size_t r = 0; r < codec_case_count; r++) {
      const codec_case *row = &codec_cases[r];
      if (r > 0 && strcmp(row->codec, codec_cases[r - 1].codec) == 0) continue;
      if (!exports(ctx, row)) continue;
      check_row(host, ctx, row, MATERIAL_SMOOTH, codec_case_channels(row, 3));
    }
    gl_host_close(host);
  }
  btf_context_release(ctx);
}

/* ---- small targets ---- */

/* Targets whose limits are just above what a texture must have, so that the rest goes to more layers and more
 * textures; or below it. */
static void small_targets(void **state) {
  static const struct {
    codec_case row;
    btf_gpu_target target;
    bool fits;
  } trials[] = {
      /* 48 maps of 8 x 8, nine in a layer */
      {{.codec = "cmf", .options = "edge=8,resolution=8,codebook=16"},
       {.layout = "atlas", .max_2d = 24, .max_layers = 2},
       true},
      {{.codec = "cmf", .options = "edge=8,resolution=8,codebook=16"},
       {.layout = "stacks", .max_3d = 8},
       false},
      /* 4 x 3 views of 3 groups each */
      {{.codec = "pvpca", .options = "components=8"}, {.layout = "views", .max_layers = 7}, true},
      {{.codec = "pvpca", .options = "components=8"},
       {.layout = "views", .max_layers = 7, .max_textures = 8},
       false},
      /* 4 clusters of 2 groups in 3 channels */
      {{.codec = "lpca", .options = "clusters=4,components=8"}, {.layout = "full", .max_layers = 5}, true},
      {{.codec = "lpca", .options = "clusters=20"}, {.layout = "bytes", .max_3d = 17}, false},
  };
  const codec_dataset_recipe recipe = {MATERIAL_SMOOTH, 3, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  gl_host *host = open_host(GL_ES_300);
  btf_context *ctx;
  (void)state;
  if (host == NULL) skip();
  assert_ok(codec_case_context(&defaults, &ctx));
  for (size_t i = 0; i < sizeof trials / sizeof *trials; i++) {
    btf_gpu_target target = trials[i].target;
    btf_model_info info = BTF_MODEL_INFO_INIT;
    btf_gpu_export *refused;
    btf_gpu_cost cost;
    btf_model *model;
    target.struct_size = sizeof target;
    if (btf_codec_find(ctx, trials[i].row.codec) == NULL) continue;
    assert_ok(codec_case_fit(ctx, &trials[i].row, &recipe, NULL, NULL, &model));
    if (trials[i].fits) {
      assert_ok(btf_model_describe(model, &info));
      make_queries(&info);
      evaluate(model, 3);
      const char *folder = export_for(model, &target, 0, &cost);
      const errors e = run(host, folder, NULL, cost.rounding);
      print_message("%s %s: largest %.2g\n", trials[i].row.codec, target.layout, e.largest / e.peak);
      assert_true(e.beyond <= TOLERANCE * e.peak);
    } else {
      assert_status(btf_gpu_export_create(model, &target, &refused), BTF_E_LIMIT);
    }
    btf_model_release(model);
  }
  btf_context_release(ctx);
  gl_host_close(host);
}

/* ---- planted faults ---- */

/* Replaces each occurrence; fails the test if there is none. */
static char *replace(char *text, const char *what, const char *with) {
  char *out = calloc(strlen(text) * 2 + 1024, 1), *to = out;
  int count = 0;
  assert_non_null(out);
  for (const char *from = text; *from != '\0';) {
    if (strncmp(from, what, strlen(what)) == 0) {
      to = stpcpy(to, with);
      from += strlen(what);
      count++;
    } else {
      *to++ = *from++;
    }
  }
  free(text);
  if (count == 0) fail_msg("the shader has no \"%s\"", what);
  return out;
}

static char *without_a_weight(char *glsl) {
  return replace(glsl, "weight.yz = vec2(b, c) * second.zw;", "weight.yz = vec2(b, 0.0) * second.zw;");
}
static char *without_a_level(char *glsl) {
  return replace(
      replace(glsl, "level.x = int(clamped);", "level.x = min(int(clamped) + 1, int(btf_size.z) - 1);"),
      ", lod);\n}\nvec4", ", lod + 1.0);\n}\nvec4");
}
static char *with_the_next_slice(char *glsl) {
  return replace(glsl, "ivec3(x, y, slice)", "ivec3(x, y, slice + 1)");
}

static char *without_a_quadrant(char *glsl) {
  return replace(glsl, "quadrant == 2 ? size.y : 0", "0");
}
static char *with_a_finer_band(char *glsl) {
  return replace(glsl, "int k = levels.x;", "int k = max(levels.x - 1, 0);");
}
static char *with_another_exponent(char *glsl) {
  return replace(glsl, "t1.w", "t0.w");
}

static char *with_the_next_map(char *glsl) {
  return replace(glsl, "t.texel.y + 1, map, 0)", "t.texel.y + 1, map + 1, 0)");
}
static char *without_the_high_byte(char *glsl) {
  return replace(glsl, "256 * id", "0 * id");
}
static char *with_the_views_of_another(char *glsl) {
  return replace(glsl, "btf_view_layers(v[j] ", "btf_view_layers(v[0] ");
}
static char *with_one_cluster(char *glsl) {
  return replace(glsl, "if (clusters[k] == cluster)", "if (clusters[k] >= 0)");
}

static void faults_are_noticed(void **state) {
  static const struct {
    const char *name;
    char *(*edit)(char *);
    uint32_t material;
    codec_case row;
  } faults[] = {
      {"one weight of a triangle is 0",
       without_a_weight,
       MATERIAL_SMOOTH,
       {.codec = "fmf", .options = "components=8"}},
      {"one level too coarse", without_a_level, MATERIAL_SMOOTH, {.codec = "fmf", .options = "components=8"}},
      {"the slice after", with_the_next_slice, MATERIAL_SMOOTH, {.codec = "fmf", .options = "components=8"}},
      {"one texel of the map after",
       with_the_next_map,
       MATERIAL_SMOOTH,
       {.codec = "cmf", .options = "edge=8,resolution=8,codebook=8"}},
      {"indices of one byte", without_the_high_byte, MATERIAL_LARGE, {.codec = "cmf", .options = CMF_LARGE}},
      {"textures of another view",
       with_the_views_of_another,
       MATERIAL_SMOOTH,
       {.codec = "pvpca", .options = ""}},
      {"all texels of one cluster",
       with_one_cluster,
       MATERIAL_SMOOTH,
       {.codec = "lpca", .options = "clusters=5"}},
      {"the exponent of another lobe",
       with_another_exponent,
       MATERIAL_SMOOTH,
       {.codec = "lafortune", .options = ""}},
      {"chroma from the quadrant of luma",
       without_a_quadrant,
       MATERIAL_SMOOTH,
       {.codec = "laplacian", .options = ""}},
      {"one band too many",
       with_a_finer_band,
       MATERIAL_SMOOTH,
       {.codec = "laplacian", .options = "psnr=30,mean=table,filter=paper,levels=2,storage=f32"}},
  };
  gl_host *host = open_host(GL_ES_300);
  btf_context *ctx;
  (void)state;
  if (host == NULL) skip();
  assert_ok(codec_case_context(&defaults, &ctx));
  for (size_t i = 0; i < sizeof faults / sizeof *faults; i++) {
    const codec_dataset_recipe recipe = {faults[i].material, 3, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
    btf_model_info info = BTF_MODEL_INFO_INIT;
    btf_gpu_cost cost;
    btf_model *model;
    if (!exports(ctx, &faults[i].row)) continue;
    assert_ok(codec_case_fit(ctx, &faults[i].row, &recipe, NULL, NULL, &model));
    assert_ok(btf_model_describe(model, &info));
    make_queries(&info);
    evaluate(model, 3);
    const errors e = run(host, export_to(model, NULL, 0, &cost), faults[i].edit, 0.0);
    print_message("%s, %s: largest %.2g, 99.9th percentile %.2g\n", faults[i].row.codec, faults[i].name,
                  e.largest / e.peak, e.percentile / e.peak);
    assert_true(e.largest > 10 * TOLERANCE * e.peak);
    btf_model_release(model);
  }
  btf_context_release(ctx);
  gl_host_close(host);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(every_codec), cmocka_unit_test(every_dialect),
                                     cmocka_unit_test(small_targets), cmocka_unit_test(faults_are_noticed)};
  return btf_run("gpu", tests);
}
