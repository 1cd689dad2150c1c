/* SPDX-License-Identifier: MIT */
#include "trial.h"

enum { QUERIES = 20480, PICTURE = 128, SAMPLES = 8 };

static float queries[QUERIES][9], expected[QUERIES][3], got[QUERIES][3], magnitude[QUERIES * 3];
static float divisor[QUERIES]; /* of stored values */
static int query_count;

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
static void random_queries(const btf_model_info *info) {
  uint64_t state = 20;
  query_count = QUERIES;
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
  }
}

static double dot(const double a[3], const double b[3]) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* The direction from `at` to `to` in the frame of a normal: T is across the picture, B up. */
static void local_direction(const double normal[3], const double at[3], const double to[3], float out[3]) {
  const double d[3] = {to[0] - at[0], to[1] - at[1], to[2] - at[2]}, length = sqrt(dot(d, d));
  const double across = hypot(normal[0], normal[2]);
  const double t[3] = {normal[2] / across, 0.0, -normal[0] / across};
  const double b[3] = {normal[1] * t[2], normal[2] * t[0] - normal[0] * t[2], -normal[1] * t[0]};
  out[0] = (float)(dot(d, t) / length);
  out[1] = (float)(dot(d, b) / length);
  out[2] = (float)(dot(d, normal) / length);
}

/* A sphere that fills the picture under one lamp, in SAMPLES x SAMPLES samples a pixel. Tiles lie flat behind
 * it, one and a half across, and what a pixel covers grows towards the rim. Around the sphere the view is
 * below the horizon. */
static void picture_queries(const btf_model_info *info) {
  static const double eye[3] = {0.0, 0.0, 8.0}, lamp[3] = {2.0, 1.5, 2.5};
  query_count = PICTURE * PICTURE;
  for (int i = 0; i < query_count; i++) {
    const double x = 2.1 * ((i % PICTURE + 0.5) / PICTURE - 0.5);
    const double y = 2.1 * ((double)(i / PICTURE) + 0.5 - 0.5 * PICTURE) / PICTURE;
    const double squares = x * x + y * y, z = squares < 1.0 ? sqrt(1.0 - squares) : 1.0 - squares - 0.2;
    const double length = sqrt(squares + z * z), normal[3] = {x / length, y / length, z / length};
    const double texels = 1.5 / PICTURE * SAMPLES * (info->width > info->height ? info->width : info->height);
    float *q = queries[i];
    local_direction(normal, normal, lamp, q);
    local_direction(normal, normal, eye, q + 3);
    q[6] = (float)(1.5 / 2.1 * x);
    q[7] = (float)(1.5 / 2.1 * y);
    q[8] = (float)log2(texels / fmax(fabs(normal[2]), 1.0 / 64));
  }
}

static void make_queries(const btf_model_info *info, trial_queries kind) {
  (kind == TRIAL_PICTURE ? picture_queries : random_queries)(info);
  for (int i = 0; i < query_count; i++)
    divisor[i] = info->quantity == BTF_QUANTITY_BRDF_COS ? fmaxf(queries[i][2], 0.02f) : 1.0f;
}

static void evaluate(const btf_model *model, uint32_t channels) {
  for (int i = 0; i < query_count; i++) {
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

static trial_errors compare(double rounding) {
  trial_errors e = {.beyond = 0.0};
  const size_t values = 3 * (size_t)query_count;
  for (int i = 0; i < query_count; i++)
    for (int c = 0; c < 3; c++) magnitude[3 * i + c] = fabsf(expected[i][c]);
  e.peak = percentile(magnitude, values);
  for (int i = 0; i < query_count; i++)
    for (int c = 0; c < 3; c++) {
      const float difference = fabsf(got[i][c] - expected[i][c]);
      magnitude[3 * i + c] = isfinite(difference) ? difference : INFINITY;
      e.beyond = fmax(e.beyond, (double)magnitude[3 * i + c] - rounding / (double)divisor[i]);
    }
  e.percentile = percentile(magnitude, values);
  e.largest = magnitude[values - 1];
  return e;
}

/* Replaces each occurrence; fails the test if there is none. */
static char *plant(char *glsl, const void *user) {
  const trial_fault *fault = user;
  const size_t size = strlen(fault->text), growth = strlen(fault->replacement) + 1;
  char *out = calloc(strlen(glsl) + 1, growth), *to = out;
  int count = 0;
  assert_non_null(out);
  for (const char *from = glsl; *from != '\0';) {
    if (strncmp(from, fault->text, size) == 0) {
      to = stpcpy(to, fault->replacement);
      from += size;
      count++;
    } else {
      *to++ = *from++;
    }
  }
  free(glsl);
  if (count == 0) fail_msg("the shader has no \"%s\"", fault->text);
  return out;
}

trial_errors trial_run(gpu_host *host, const btf_model *model, const btf_gpu_target *target, int32_t zstd,
                       trial_queries kind, const trial_fault *fault, btf_gpu_cost *cost) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_gpu_export *e;
  assert_ok(btf_model_describe(model, &info));
  make_queries(&info, kind);
  evaluate(model, info.channels);
  *cost = (btf_gpu_cost)BTF_GPU_COST_INIT;
  assert_ok(btf_gpu_export_create(model, target, &e));
  assert_ok(btf_gpu_export_cost(e, cost));
  gpu_host_run(host, e, zstd, fault != NULL ? plant : NULL, fault, queries[0], query_count, got[0]);
  btf_gpu_export_release(e);
  return compare(cost->rounding);
}

static void try_layout(gpu_host *host, const btf_model *model, const codec_case *row, const char *layout,
                       const char *material, trial_queries kind) {
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  btf_gpu_cost cost;
  target.layout = layout;
  const trial_errors e = trial_run(host, model, &target, 3, kind, NULL, &cost);
  print_message("%s %s, %s, %s%s: largest %.2g, 99.9th percentile %.2g of %.3g, rounding %.2g; %.0f fetches, "
                "%.0f bytes, %.0f operations\n",
                row->codec, row->options, layout, material, kind == TRIAL_PICTURE ? ", picture" : "",
                e.largest / e.peak, e.percentile / e.peak, e.peak, cost.rounding / e.peak, cost.fetches,
                cost.bytes, cost.flops);
  if (!(e.beyond <= TRIAL_TOLERANCE * e.peak))
    fail_msg("%s: layout %s differs by %.3g of %.3g", row->codec, layout, e.largest, e.peak);
  assert_true(cost.fetches > 0 && cost.bytes > 0 && cost.flops > 0);
}

void trial_row(gpu_host *host, btf_context *ctx, const codec_case *row, uint32_t material, uint32_t channels,
               trial_queries kind) {
  const codec_dataset_recipe recipe = {material, channels, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  const char *layout;
  btf_model *model;
  const btf_status status = codec_case_fit(ctx, row, &recipe, NULL, NULL, &model);
  if (status == BTF_E_UNSUPPORTED && material != MATERIAL_SMOOTH) return;
  assert_ok(status);
  for (uint32_t i = 0; (layout = btf_codec_gpu_layout(btf_codec_find(ctx, row->codec), i, NULL)) != NULL; i++)
    try_layout(host, model, row, layout, codec_materials[material].name, kind);
  btf_model_release(model);
}

bool trial_exports(btf_context *ctx, const codec_case *row) {
  const btf_codec *codec = btf_codec_find(ctx, row->codec);
  if (codec != NULL && btf_codec_gpu_layout(codec, 0, NULL) == NULL)
    fail_msg("%s exports nothing", row->codec);
  return codec != NULL;
}

void trial_first_rows(gpu_host *host, btf_context *ctx, trial_queries kind) {
  uint32_t tried = 0;
  for (size_t r = 0; r < codec_case_count; r++) {
    const codec_case *row = &codec_cases[r];
    if (r > 0 && strcmp(row->codec, codec_cases[r - 1].codec) == 0) continue;
    if (!trial_exports(ctx, row)) continue;
    trial_row(host, ctx, row, MATERIAL_SMOOTH, codec_case_channels(row, 3), kind);
    tried++;
  }
  assert_int_equal(tried, btf_codec_count(ctx));
  assert_true(tried > 0 && tried >= TRIAL_STATIC_CODECS);
}

#define FMF_ROW                                                                                              \
  { .codec = "fmf", .options = "components=8" }
#define LPCA_ROW                                                                                             \
  { .codec = "lpca", .options = "clusters=5" }
const trial_fault trial_faults[TRIAL_FAULTS] = {
    {FMF_ROW, "rgba", MATERIAL_SMOOTH, "one weight of a triangle is 0", "weight.yz = vec2(b, c) * second.zw;",
     "weight.yz = vec2(b, 0.0) * second.zw;"},
    {FMF_ROW, "rgba", MATERIAL_SMOOTH, "one level too coarse, by the sampler", ", lod);\n}\nvec4",
     ", lod + 1.0);\n}\nvec4"},
    {{.codec = "fmf", .options = "components=8,storage=f32"},
     "rgba",
     MATERIAL_SMOOTH,
     "one level too coarse",
     "level.x = int(clamped);",
     "level.x = min(int(clamped) + 1, int(btf_size.z) - 1);"},
    {FMF_ROW, "rgba", MATERIAL_SMOOTH, "the slice after", "ivec3(x, y, slice)", "ivec3(x, y, slice + 1)"},
    {{.codec = "cmf", .options = "edge=8,resolution=8,codebook=8"},
     "stacks",
     MATERIAL_SMOOTH,
     "one texel of the map after",
     "t.texel.y + 1, map, 0)",
     "t.texel.y + 1, map + 1, 0)"},
    {{.codec = "cmf", .options = TRIAL_CMF_LARGE},
     "stacks",
     MATERIAL_LARGE,
     "indices of one byte",
     "256 * id",
     "0 * id"},
    {{.codec = "pvpca", .options = ""},
     "views",
     MATERIAL_SMOOTH,
     "textures of another view",
     "btf_view_layers(v[j] ",
     "btf_view_layers(v[0] "},
    {LPCA_ROW, "full", MATERIAL_SMOOTH, "all texels of one cluster", "if (clusters[k] == cluster)",
     "if (clusters[k] >= 0)"},
    {FMF_ROW, "raster", MATERIAL_SMOOTH, "one weight from a map is 0", "_weights(cell.x, cell.y, 0, 0).xyz;",
     "_weights(cell.x, cell.y, 0, 0).xyz * vec3(1.0, 0.0, 1.0);"},
    {FMF_ROW, "raster", MATERIAL_SMOOTH, "samples from a map in another order",
     "_samples(cell.x, cell.y, 0, 0).xyz", "_samples(cell.x, cell.y, 0, 0).yxz"},
    {LPCA_ROW, "bytes", MATERIAL_SMOOTH, "the scales of another cluster", "btf_scale(g + 1, cluster, 0, 0)",
     "btf_scale(g + 1, cluster == 0 ? 1 : 0, 0, 0)"},
    {LPCA_ROW, "bytes", MATERIAL_SMOOTH, "the factors of another cluster", "(cluster * 1 + 0)",
     "((cluster == 0 ? 1 : 0) * 1 + 0)"},
    {{.codec = "lafortune", .options = ""},
     "coefficients",
     MATERIAL_SMOOTH,
     "the exponent of another lobe",
     "t1.w",
     "t0.w"},
    {{.codec = "laplacian", .options = ""},
     "maps",
     MATERIAL_SMOOTH,
     "chroma from the quadrant of luma",
     "quadrant == 2 ? size.y : 0",
     "0"},
    {{.codec = "laplacian", .options = "psnr=30,mean=table,filter=paper,levels=2,storage=f32"},
     "maps",
     MATERIAL_SMOOTH,
     "one band too many",
     "int k = levels.x;",
     "int k = max(levels.x - 1, 0);"},
};

void trial_plant(gpu_host *host, btf_context *ctx, const trial_fault *fault) {
  const codec_dataset_recipe recipe = {fault->material, 3, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  btf_gpu_cost cost;
  btf_model *model;
  if (!trial_exports(ctx, &fault->row)) return;
  target.layout = fault->layout;
  assert_ok(codec_case_fit(ctx, &fault->row, &recipe, NULL, NULL, &model));
  const trial_errors e = trial_run(host, model, &target, 0, TRIAL_RANDOM, fault, &cost);
  print_message("%s %s, %s, fault: %s: largest %.2g, %.2g allowed; 99.9th percentile %.2g\n",
                fault->row.codec, fault->row.options, fault->layout, fault->what, e.largest / e.peak,
                TRIAL_TOLERANCE + cost.rounding / e.peak, e.percentile / e.peak);
  assert_true(e.beyond > 10 * TRIAL_TOLERANCE * e.peak);
  btf_model_release(model);
}
