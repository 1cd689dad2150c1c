/* SPDX-License-Identifier: MIT */
/*
 * What exports say of themselves against what their shaders do in software GL: texels and bytes read, counted
 * by the shader at run time; weights of a raster's texels, computed anew; queries that are not
 * finite; and slices of a stack that the sampler filters.
 */
#include "../btf_test.h"
#include "../codec_cases.h"
#include "../copy_codec.h"
#include "gl_host.h"

#include <btf/btf_codec.h>
#include <btf/btf_half.h>

enum { QUERIES = 2048 };

static float queries[QUERIES][9], got[QUERIES][3];

static void take_query(uint32_t i, const btf_query *q) {
  const float members[9] = {q->light[0], q->light[1], q->light[2], q->view[0], q->view[1],
                            q->view[2],  q->uv[0],    q->uv[1],    q->lod};
  memcpy(queries[i], members, sizeof members);
}

static void evaluate(gpu_host *host, const btf_gpu_export *e, gpu_edit edit) {
  gpu_host_run(host, e, 0, edit, e, queries[0], QUERIES, got[0]);
}

/* ---- counting ---- */

static uint32_t texel_bytes(const btf_gpu_export *e, const char *name, size_t length) {
  for (uint32_t i = 0; i < btf_gpu_texture_count(e); i++) {
    btf_gpu_texture t = BTF_GPU_TEXTURE_INIT;
    assert_ok(btf_gpu_texture_at(e, i, &t));
    if (strlen(t.name) == length && strncmp(t.name, name, length) == 0)
      return (uint32_t)(t.levels[0].size / ((uint64_t)t.width * t.height * t.depth * t.layers));
  }
  fail_msg("a texture of another name");
  return 0;
}

/* Every read of a texture adds to two counters first; a filtered one blends four texels of a level. The
 * results are the counters instead of the colour. */
static char *with_counters(char *glsl, const void *user) {
  static const char *const reads[] = {"texelFetch(", "textureLod("};
  char *out = calloc(strlen(glsl) * 3 + 4096, 1), *to = out;
  assert_non_null(out);
  to = stpcpy(to, "int counted = 0, counted_bytes = 0;\n"
                  "bool count(int bytes) { ++counted; counted_bytes += bytes; return true; }\n");
  for (const char *from = glsl; *from != '\0';) {
    for (uint32_t k = 0; k < 2; k++) {
      if (strncmp(from, reads[k], strlen(reads[k])) != 0) continue;
      const char *name = from + strlen(reads[k]);
      to += sprintf(
          to, "!count(%u) ? vec4(0.0) : ", (k == 0 ? 1 : 4) * texel_bytes(user, name, strcspn(name, ",")));
    }
    if (strncmp(from, "vec3 btf_eval(", 14) == 0) {
      to = stpcpy(to, "vec3 whole_eval(");
      from += 14;
    } else {
      *to++ = *from++;
    }
  }
  stpcpy(to, "vec3 btf_eval(vec3 light, vec3 view, vec2 uv, float lod) {\n"
             "  vec3 f = whole_eval(light, view, uv, lod);\n"
             "  return vec3(float(counted), float(counted_bytes), f.x);\n}\n");
  free(glsl);
  return out;
}

/* What else an evaluation reads depends on. */
enum {
  NOTHING,
  CLUSTERS, /* of more than one texel; said is what a single one takes */
  VIEWS     /* which have vectors of different numbers; said is the average */
};

static int varies_with(const codec_case *row, const btf_model_info *info) {
  if (strcmp(row->codec, "lpca") == 0 && info->width > 1) return CLUSTERS;
  const bool chosen = strstr(row->options, "psnr=") != NULL || strstr(row->options, "rmse=") != NULL ||
                      strstr(row->options, "budget=adaptive") != NULL;
  return strcmp(row->codec, "pvpca") == 0 && chosen ? VIEWS : NOTHING;
}

/* The search for a direction reads three texels more of 16 bytes for each facet that it leaves. */
static void check_cost(gpu_host *host, const btf_gpu_export *e, const codec_case *row,
                       const btf_model_info *info, const char *layout) {
  const int varies = varies_with(row, info);
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  double least[2] = {INFINITY, INFINITY}, most[2] = {0.0, 0.0};
  uint32_t without_steps = 0;
  assert_ok(btf_gpu_export_cost(e, &cost));
  evaluate(host, e, with_counters);
  for (uint32_t i = 0; i < QUERIES; i++) {
    const double more = (double)got[i][0] - cost.fetches;
    for (int k = 0; k < 2; k++) {
      least[k] = fmin(least[k], (double)got[i][k]);
      most[k] = fmax(most[k], (double)got[i][k]);
    }
    without_steps += more == 0.0;
    if (varies == NOTHING && (fmod(more, 3.0) != 0.0 || (double)got[i][1] - cost.bytes != more * 16.0))
      fail_msg("%s, %s: %.0f texels of %.0f bytes, said are %.0f of %.0f", row->codec, layout,
               (double)got[i][0], (double)got[i][1], cost.fetches, cost.bytes);
  }
  print_message(
      "%s %s, %s: %.0f fetches, %.0f bytes, %.0f operations said; %.0f to %.0f, %.0f to %.0f counted\n",
      row->codec, row->options, layout, cost.fetches, cost.bytes, cost.flops, least[0], most[0], least[1],
      most[1]);
  if (varies == VIEWS) {
    assert_true(least[0] <= cost.fetches && cost.fetches <= most[0]);
    assert_true(least[1] <= cost.bytes && cost.bytes <= most[1]);
    return;
  }
  if (varies == CLUSTERS) {
    assert_true(least[0] >= cost.fetches && least[1] >= cost.bytes);
    return;
  }
  assert_true(least[0] == cost.fetches && least[1] == cost.bytes);
  /* A figure that only the luckiest query meets would be no cost of an evaluation. */
  assert_true(without_steps > QUERIES / 4);
}

/* Fewer bands are read at every coarser level. */
static void check_levels(gpu_host *host, const btf_gpu_export *e, uint32_t levels) {
  float before = INFINITY;
  for (uint32_t level = 0; level < levels; level++) {
    float least = INFINITY;
    for (uint32_t i = 0; i < QUERIES; i++) queries[i][8] = (float)level;
    evaluate(host, e, with_counters);
    for (uint32_t i = 0; i < QUERIES; i++) least = fminf(least, got[i][0]);
    print_message("  level %u: %.0f fetches\n", level, (double)least);
    assert_true(least < before);
    before = least;
  }
}

/* Finite queries inside the domain, at the finest level. */
static void plain_queries(void) {
  for (uint32_t i = 0; i < QUERIES; i++) {
    const btf_query q = codec_case_plain_query(i, 0.0f);
    take_query(i, &q);
  }
}

typedef void (*check_fn)(gpu_host *host, const btf_gpu_export *e, const btf_model *model,
                         const codec_case *row, const char *layout);

static void each_layout(uint32_t material, check_fn check) {
  const btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  const char *why, *layout;
  uint32_t layouts = 0;
  btf_context *ctx;
  gpu_host *host = gl_host_open(GL_ES_300, &why);
  if (host == NULL) {
    print_message("%s\n", why);
    skip();
  }
  assert_ok(codec_case_context(&desc, &ctx));
  for (size_t r = 0; r < codec_case_count; r++) {
    const codec_case *row = &codec_cases[r];
    const btf_codec *codec = btf_codec_find(ctx, row->codec);
    const codec_dataset_recipe recipe = {.material = material, .channels = codec_case_channels(row, 3)};
    btf_model *model;
    if (codec == NULL || btf_codec_gpu_layout(codec, 0, NULL) == NULL) continue;
    const btf_status status = codec_case_fit(ctx, row, &recipe, NULL, NULL, &model);
    if (status == BTF_E_UNSUPPORTED) continue;
    assert_ok(status);
    for (uint32_t i = 0; (layout = btf_codec_gpu_layout(codec, i, NULL)) != NULL; i++, layouts++) {
      btf_gpu_target target = BTF_GPU_TARGET_INIT;
      btf_gpu_export *e;
      target.layout = layout;
      assert_ok(btf_gpu_export_create(model, &target, &e));
      check(host, e, model, row, layout);
      btf_gpu_export_release(e);
    }
    btf_model_release(model);
  }
  btf_context_release(ctx);
  host->close(host);
  if (layouts == 0) skip();
}

static void count_reads(gpu_host *host, const btf_gpu_export *e, const btf_model *model,
                        const codec_case *row, const char *layout) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  assert_ok(btf_model_describe(model, &info));
  plain_queries();
  check_cost(host, e, row, &info, layout);
  if (strcmp(row->codec, "laplacian") == 0) check_levels(host, e, info.levels);
}

static void costs_are_what_shaders_read(void **state) {
  (void)state;
  each_layout(MATERIAL_SMOOTH, count_reads);
  each_layout(MATERIAL_TEXEL, count_reads);
}

/* ---- rasters ---- */

enum { RASTER = 512 }; /* docs/gpu-export.md */

/* Samples and weights at the centre of the texel that holds a direction; false so near its border that
 * rounding of floats decides. */
static bool locate_centre(const btf_dirset *set, const float d[3], btf_interp *out) {
  const double length =
      sqrt((double)d[0] * (double)d[0] + (double)d[1] * (double)d[1] + (double)d[2] * (double)d[2]);
  double p[2], r2 = 0.0;
  float centre[3];
  for (int k = 0; k < 2; k++) {
    const double at = ((double)d[k] / (length + (double)d[2]) + 1.0) / 2.0 * RASTER, cell = floor(at);
    if (fabs(at - cell - 0.5) > 0.499) return false;
    p[k] = (2.0 * cell + 1.0) / RASTER - 1.0;
    r2 += p[k] * p[k];
  }
  for (int k = 0; k < 2; k++) centre[k] = (float)(r2 < 1.0 ? 2.0 * p[k] / (1.0 + r2) : p[k] / sqrt(r2));
  centre[2] = (float)(r2 < 1.0 ? (1.0 - r2) / (1.0 + r2) : 0.0);
  btf_dirset_locate(set, centre, out);
  return true;
}

/* What the model gives at nine pairs of samples, blended. */
static void blend_samples(const btf_model *model, const btf_dirset *const set[2], const btf_interp at[2],
                          const btf_query *query, double sum[3]) {
  const float *lights = btf_dirset_directions(set[0]), *views = btf_dirset_directions(set[1]);
  for (int c = 0; c < 3; c++) sum[c] = 0.0;
  for (int l = 0; l < 3; l++)
    for (int v = 0; v < 3; v++) {
      btf_query q = *query;
      float f[3];
      memcpy(q.light, lights + 3 * (size_t)at[0].index[l], sizeof q.light);
      memcpy(q.view, views + 3 * (size_t)at[1].index[v], sizeof q.view);
      btf_model_eval(model, &q, f);
      for (int c = 0; c < 3; c++) sum[c] += (double)at[0].weight[l] * (double)at[1].weight[v] * (double)f[c];
    }
}

static void rasters_have_the_weights_of_centres(void **state) {
  const btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  const codec_case row = {.codec = "fmf", .options = "components=8"};
  const codec_dataset_recipe recipe = {.material = MATERIAL_SMOOTH, .channels = 3};
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  btf_dirset *lights, *views;
  btf_gpu_export *e;
  btf_context *ctx;
  btf_model *model;
  double largest = 0.0, difference = 0.0, from_exact = 0.0;
  uint32_t compared = 0;
  const char *why;
  (void)state;
  gpu_host *host = gl_host_open(GL_ES_300, &why);
  if (host == NULL) skip();
  assert_ok(codec_case_context(&desc, &ctx));
  if (btf_codec_find(ctx, "fmf") == NULL) skip();
  assert_ok(btf_dirset_create_named(ctx, codec_materials[MATERIAL_SMOOTH].lights, &lights));
  assert_ok(btf_dirset_create_named(ctx, codec_materials[MATERIAL_SMOOTH].views, &views));
  const btf_dirset *const set[2] = {lights, views};
  assert_ok(codec_case_fit(ctx, &row, &recipe, NULL, NULL, &model));
  target.layout = "raster";
  assert_ok(btf_gpu_export_create(model, &target, &e));
  for (uint32_t i = 0; i < QUERIES; i++) {
    btf_query q = codec_case_plain_query(i, (float)(i % 4) / 2.0f);
    if (i % 4 == 0) q.light[2] = 1e-3f; /* beyond the hull, near the disc's rim */
    take_query(i, &q);
  }
  evaluate(host, e, NULL);
  for (uint32_t i = 0; i < QUERIES; i++) {
    const float *m = queries[i];
    const btf_query q = {{m[0], m[1], m[2]}, {m[3], m[4], m[5]}, {m[6], m[7]}, m[8], 0};
    btf_interp at[2];
    double sum[3];
    float f[3];
    if (!locate_centre(lights, q.light, &at[0]) || !locate_centre(views, q.view, &at[1])) continue;
    blend_samples(model, set, at, &q, sum);
    btf_model_eval(model, &q, f);
    for (int c = 0; c < 3; c++) {
      largest = fmax(largest, fabs(sum[c]));
      difference = fmax(difference, fabs((double)got[i][c] - sum[c]));
      from_exact = fmax(from_exact, fabs((double)got[i][c] - (double)f[c]));
    }
    compared++;
  }
  print_message("%u queries: %.2g of %.3g from the weights of centres, %.2g from those of directions\n",
                compared, difference, largest, from_exact);
  assert_true(compared > QUERIES * 9 / 10);
  /* Weights in halves, of lights and of views, move 2^-11 of all weight each, between values of 0 and more.
   */
  assert_true(difference <= largest * 2.0 / 2048);
  assert_true(from_exact > 2.0 * difference);
  btf_gpu_export_release(e);
  btf_model_release(model);
  btf_dirset_release(lights);
  btf_dirset_release(views);
  btf_context_release(ctx);
  host->close(host);
}

/* ---- queries of every kind ---- */

static bool is_finite_query(const float *members) {
  for (int k = 0; k < 9; k++)
    if (!isfinite(members[k])) return false;
  return true;
}

static void compare_strange(gpu_host *host, const btf_gpu_export *e, const btf_model *model,
                            const codec_case *row, const char *layout) {
  uint32_t strange = 0, below = 0;
  for (uint32_t i = 0; i < QUERIES; i++) {
    btf_query q = codec_case_query(i);
    q.flags = 0;
    take_query(i, &q);
  }
  evaluate(host, e, NULL);
  for (uint32_t i = 0; i < QUERIES; i++) {
    const float *m = queries[i];
    const bool finite = is_finite_query(m), above = m[2] > 0.0f && m[5] > 0.0f;
    const btf_query q = {{m[0], m[1], m[2]}, {m[3], m[4], m[5]}, {m[6], m[7]}, m[8], 0};
    float f[64];
    btf_model_eval(model, &q, f);
    for (int c = 0; c < 3; c++) {
      if (!isfinite(got[i][c]) || ((!finite || !above) && (got[i][c] != 0.0f || f[c] != 0.0f)))
        fail_msg("%s, %s: query %u gives %g, the model %g", row->codec, layout, i, (double)got[i][c],
                 (double)f[c]);
    }
    strange += !finite;
    below += finite && !above;
  }
  assert_true(strange > 20 && below > 20);
}

static void what_is_not_finite_is_black(void **state) {
  (void)state;
  each_layout(MATERIAL_SMOOTH, compare_strange);
}

/* ---- stacks that the sampler filters ---- */

enum { EDGE = 4, SLICES = 5 };

/* Exact in halves, and very different from one slice to the next. */
static float stack_value(uint32_t slice, uint32_t x, uint32_t y) {
  return (float)(1 + x + EDGE * y) * (slice % 2 == 0 ? 1.0f : 64.0f);
}

/* The slice is what a query has as its level of detail. */
static btf_status stack_gpu(const btf_host *host, btf_context *ctx, const void *state,
                            const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                            btf_gpu_builder *out) {
  const btf_gpu_table table = {.struct_size = sizeof table,
                               .name = "btf_stack",
                               .texel = BTF_TEXEL_R16_FLOAT,
                               .width = EDGE,
                               .height = EDGE,
                               .slices = SLICES,
                               .levels = 1,
                               .wrap = BTF_WRAP_CLAMP,
                               .flags = BTF_GPU_STACK | BTF_GPU_FILTERED};
  uint32_t number;
  (void)ctx, (void)state, (void)shape, (void)layout, (void)target;
  BTF_TRY(host->gpu_table(out, &table, &number));
  for (uint32_t slice = 0; slice < SLICES; slice++) {
    uint16_t *texels = host->gpu_slice(out, number, 0, slice);
    for (uint32_t i = 0; i < EDGE * EDGE; i++)
      texels[i] = btf_float_to_half(stack_value(slice, i % EDGE, i / EDGE));
  }
  return host->gpu_source(
      out,
      "vec3 btf_stored(vec3 light, vec3 view, vec2 uv, float lod) {\n"
      "  ivec2 at = ivec2(uv * %d.0);\n"
      "  return vec3(btf_stack_at(uv, int(lod), 0.0).r, btf_stack(at.x, at.y, int(lod), 0).r,\n"
      "              btf_stack_at(uv + vec2(0.5 / %d.0, 0.0), int(lod), 0.0).r);\n"
      "}\n",
      EDGE, EDGE);
}

static void filtered_slices_do_not_mix(void **state) {
  static const btf_gpu_layout_desc stack = {"stack", "for a test"};
  static const btf_gpu_layout_desc *const layouts[] = {&stack, NULL};
  const btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_codec_vtbl codec = copy_codec;
  btf_gpu_export *e;
  btf_context *ctx;
  btf_model *model;
  const char *why;
  (void)state;
  gpu_host *host = gl_host_open(GL_ES_300, &why);
  if (host == NULL) skip();
  codec.id = "org.libbtf.stack";
  codec.gpu_layouts = layouts;
  codec.gpu = stack_gpu;
  assert_ok(btf_context_create(&desc, &ctx));
  assert_ok(btf_context_register(ctx, &codec));
  btf_dataset *ds = copy_codec_dataset(ctx, EDGE, EDGE, 3, BTF_QUANTITY_BRDF);
  assert_ok(btf_model_fit(ds, btf_codec_find(ctx, codec.id), NULL, NULL, &model));
  assert_ok(btf_gpu_export_create(model, NULL, &e));
  for (uint32_t i = 0; i < QUERIES; i++) {
    btf_query q = codec_case_plain_query(i, (float)(i / (EDGE * EDGE) % SLICES));
    q.uv[0] = ((float)(i % EDGE) + 0.5f) / EDGE;
    q.uv[1] = ((float)(i / EDGE % EDGE) + 0.5f) / EDGE;
    take_query(i, &q);
  }
  evaluate(host, e, NULL);
  for (uint32_t i = 0; i < QUERIES; i++) {
    const uint32_t slice = i / (EDGE * EDGE) % SLICES, x = i % EDGE, y = i / EDGE % EDGE;
    const float next = stack_value(slice, x + 1 < EDGE ? x + 1 : x, y);
    assert_true(got[i][0] == stack_value(slice, x, y) && got[i][1] == got[i][0]);
    assert_true(got[i][2] == 0.5f * (got[i][0] + next)); /* which the sampler alone can make */
  }
  btf_gpu_export_release(e);
  btf_model_release(model);
  btf_dataset_release(ds);
  btf_context_release(ctx);
  host->close(host);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(costs_are_what_shaders_read), cmocka_unit_test(rasters_have_the_weights_of_centres),
      cmocka_unit_test(filtered_slices_do_not_mix), cmocka_unit_test(what_is_not_finite_is_black)};
  return btf_run("gpu_claims", tests);
}
