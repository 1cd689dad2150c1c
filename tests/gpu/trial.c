/* SPDX-License-Identifier: MIT */
#include "trial.h"

enum { QUERIES = 20480 };

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

static trial_errors compare(double rounding) {
  trial_errors e = {.beyond = 0.0};
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
                       const trial_fault *fault, btf_gpu_cost *cost) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_gpu_export *e;
  assert_ok(btf_model_describe(model, &info));
  make_queries(&info);
  evaluate(model, info.channels);
  *cost = (btf_gpu_cost)BTF_GPU_COST_INIT;
  assert_ok(btf_gpu_export_create(model, target, &e));
  assert_ok(btf_gpu_export_cost(e, cost));
  gpu_host_run(host, e, zstd, fault != NULL ? plant : NULL, fault, queries[0], QUERIES, got[0]);
  btf_gpu_export_release(e);
  return compare(cost->rounding);
}

static void try_layout(gpu_host *host, const btf_model *model, const codec_case *row, const char *layout,
                       const char *material) {
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  btf_gpu_cost cost;
  target.layout = layout;
  const trial_errors e = trial_run(host, model, &target, 3, NULL, &cost);
  print_message("%s %s, %s, %s: largest %.2g, 99.9th percentile %.2g of %.3g, rounding %.2g; %.0f fetches, "
                "%.0f bytes, %.0f operations\n",
                row->codec, row->options, layout, material, e.largest / e.peak, e.percentile / e.peak, e.peak,
                cost.rounding / e.peak, cost.fetches, cost.bytes, cost.flops);
  if (!(e.beyond <= TRIAL_TOLERANCE * e.peak))
    fail_msg("%s: layout %s differs by %.3g of %.3g", row->codec, layout, e.largest, e.peak);
  assert_true(cost.fetches > 0 && cost.bytes > 0 && cost.flops > 0);
}

void trial_row(gpu_host *host, btf_context *ctx, const codec_case *row, uint32_t material,
               uint32_t channels) {
  const codec_dataset_recipe recipe = {material, channels, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  const char *layout;
  btf_model *model;
  const btf_status status = codec_case_fit(ctx, row, &recipe, NULL, NULL, &model);
  if (status == BTF_E_UNSUPPORTED) return;
  assert_ok(status);
  for (uint32_t i = 0; (layout = btf_codec_gpu_layout(btf_codec_find(ctx, row->codec), i, NULL)) != NULL; i++)
    try_layout(host, model, row, layout, codec_materials[material].name);
  btf_model_release(model);
}

bool trial_exports(btf_context *ctx, const codec_case *row) {
  const btf_codec *codec = btf_codec_find(ctx, row->codec);
  return codec != NULL && btf_codec_gpu_layout(codec, 0, NULL) != NULL;
}

void trial_first_rows(gpu_host *host, btf_context *ctx) {
  uint32_t tried = 0;
  for (size_t r = 0; r < codec_case_count; r++) {
    const codec_case *row = &codec_cases[r];
    if (r > 0 && strcmp(row->codec, codec_cases[r - 1].codec) == 0) continue;
    if (!trial_exports(ctx, row)) continue;
    trial_row(host, ctx, row, MATERIAL_SMOOTH, codec_case_channels(row, 3));
    tried++;
  }
  assert_true(tried > 0);
}

#define FMF_ROW                                                                                              \
  { .codec = "fmf", .options = "components=8" }
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
    {{.codec = "lpca", .options = "clusters=5"},
     "full",
     MATERIAL_SMOOTH,
     "all texels of one cluster",
     "if (clusters[k] == cluster)",
     "if (clusters[k] >= 0)"},
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
  const trial_errors e = trial_run(host, model, &target, 0, fault, &cost);
  print_message("%s %s, %s, fault: %s: largest %.2g, 99.9th percentile %.2g, %.2g allowed\n",
                fault->row.codec, fault->row.options, fault->layout, fault->what, e.largest / e.peak,
                e.percentile / e.peak, TRIAL_TOLERANCE + cost.rounding / e.peak);
  assert_true(e.beyond > 10 * TRIAL_TOLERANCE * e.peak);
  btf_model_release(model);
}
