/* SPDX-License-Identifier: MIT */
/* gpu.c: Suykens et al. 2003, sect. 6 and 7: a map of indices, one of scales and stacks of factors, one for
 * each projection. Indices cannot be filtered, so that the texels around a position are evaluated whole and
 * blended. */
#include <stdio.h>

#include "cmf.h"

enum { STACKS = 0, ATLAS = 1 };
static const btf_gpu_layout_desc stacks = {"stacks",
                                           "a 3D texture of factors for each projection, as in the paper"};
static const btf_gpu_layout_desc atlas = {
    "atlas", "factors side by side in layers, for more of them than a stack has slices"};
const btf_gpu_layout_desc *const btfi_cmf_gpu_layouts[] = {&stacks, &atlas, NULL};

static const char *const projection_name[CMF_PROJECTIONS] = {"light", "view", "half", "difference"};
static const char *const projection_direction[CMF_PROJECTIONS] = {"light", "view", "halfway", "difference"};

typedef struct exporting {
  const btf_host *host;
  btf_context *ctx;
  const btfi_cmf_state *s;
  btf_gpu_builder *out;
  const btf_gpu_target *target;
  uint32_t layout, texel, texel_bytes; /* of maps and scales */
  uint32_t shown_bytes;                /* of a texel, those of the first three channels */
  uint32_t index_slices;
  uint64_t maps[CMF_MAX_FACTORS];       /* of each factor */
  uint64_t start[CMF_MAX_FACTORS];      /* its first in its stack, or in the atlas */
  uint64_t stack_maps[CMF_PROJECTIONS]; /* in the atlas all are in the first */
  int32_t level_start[CMF_MAX_LEVELS];  /* maps of a factor before those of a level, without codebooks */
  uint32_t across, down;                /* maps in a layer of the atlas */
} exporting;

static bool has_codebooks(const btfi_cmf_state *s) {
  return s->index[0] != NULL;
}

static uint64_t level_texels(const btfi_cmf_state *s, uint32_t level) {
  return (uint64_t)btf_sampling_level_size(s->width, level) * btf_sampling_level_size(s->height, level);
}

/* ---- where maps go ---- */

static btf_status number_maps(exporting *e) {
  const btfi_cmf_state *s = e->s;
  uint64_t own = 0;
  for (uint32_t level = 0; level < s->levels; level++) {
    if (own > INT32_MAX)
      return e->host->fail(e->ctx, BTF_E_LIMIT,
                           "cmf: more maps than a shader can number; a codebook would do");
    e->level_start[level] = (int32_t)own;
    own += level_texels(s, level);
  }
  for (uint32_t f = 0; f < s->factors; f++) {
    const uint32_t stack = e->layout == ATLAS ? 0 : s->factor[f].projection;
    e->maps[f] = has_codebooks(s) ? s->entries[f] : own;
    e->start[f] = e->stack_maps[stack];
    e->stack_maps[stack] += e->maps[f];
    if (e->stack_maps[stack] > INT32_MAX)
      return e->host->fail(e->ctx, BTF_E_LIMIT,
                           "cmf: more maps than a shader can number; a codebook would do");
  }
  return BTF_OK;
}

/* Layers about square, of a size that leaves little of the last one empty. */
static void shape_atlas(exporting *e) {
  const uint64_t maps = e->stack_maps[0];
  const uint32_t side = e->target->max_2d < 4096 ? e->target->max_2d : 4096;
  const uint32_t most = side / e->s->edge > 0 ? side / e->s->edge : 1;
  e->across = 1;
  while (e->across < most && (uint64_t)e->across * e->across < maps) e->across++;
  const uint64_t rows = (maps + e->across - 1) / e->across;
  e->down = rows < most ? (uint32_t)rows : most;
}

static const unsigned char *map_of(const exporting *e, uint32_t f, uint32_t level, uint64_t i) {
  const btfi_cmf_state *s = e->s;
  return (has_codebooks(s) ? s->codebook[f] : s->table[level][f]) + i * s->entry_bytes;
}

/* The shown channels of n texels that are src_step bytes apart. */
static void put_texels(const exporting *e, const unsigned char *src, uint64_t src_step, uint64_t n,
                       unsigned char *dst) {
  for (uint64_t i = 0; i < n; i++) memcpy(dst + i * e->texel_bytes, src + i * src_step, e->shown_bytes);
}

static void put_map(const exporting *e, uint32_t number, uint64_t slot, const unsigned char *map) {
  const btfi_cmf_state *s = e->s;
  const uint64_t step = s->entry_bytes / s->edge / s->edge;
  const uint32_t layer_maps = e->across * e->down, within = (uint32_t)(slot % layer_maps);
  const uint64_t pitch = (uint64_t)e->across * s->edge * e->texel_bytes;
  unsigned char *dst = e->host->gpu_slice(e->out, number, 0, (uint32_t)(slot / layer_maps));
  dst += within / e->across * s->edge * pitch + (uint64_t)(within % e->across) * s->edge * e->texel_bytes;
  for (uint32_t y = 0; y < s->edge; y++)
    put_texels(e, map + (uint64_t)y * s->edge * step, step, s->edge, dst + y * pitch);
}

static void put_factor(const exporting *e, uint32_t number, uint32_t f) {
  uint64_t slot = e->start[f];
  for (uint32_t level = 0; level < (has_codebooks(e->s) ? 1u : e->s->levels); level++) {
    const uint64_t maps = has_codebooks(e->s) ? e->maps[f] : level_texels(e->s, level);
    for (uint64_t i = 0; i < maps; i++) put_map(e, number, slot++, map_of(e, f, level, i));
  }
}

static btf_status put_stack(exporting *e, uint32_t stack) {
  const btfi_cmf_state *s = e->s;
  const bool is_stack = e->layout == STACKS;
  char name[32] = "btf_factors";
  uint32_t number;
  if (is_stack) {
    snprintf(name, sizeof name, "btf_%s_factors", projection_name[stack]);
    e->across = e->down = 1;
    if (e->stack_maps[stack] > e->target->max_3d)
      return e->host->fail(
          e->ctx, BTF_E_LIMIT,
          "cmf: %llu maps of one projection, the target's 3D textures have %u slices; a smaller "
          "codebook or layout \"atlas\" would do",
          (unsigned long long)e->stack_maps[stack], e->target->max_3d);
  } else {
    shape_atlas(e);
  }
  const uint64_t layer_maps = (uint64_t)e->across * e->down;
  const btf_gpu_table table = {.struct_size = sizeof table,
                               .name = name,
                               .texel = e->texel,
                               .width = e->across * s->edge,
                               .height = e->down * s->edge,
                               .slices = (uint32_t)((e->stack_maps[stack] + layer_maps - 1) / layer_maps),
                               .levels = 1,
                               .wrap = BTF_WRAP_CLAMP,
                               .flags = BTF_GPU_SMOOTH | BTF_GPU_WIDE | (is_stack ? BTF_GPU_STACK : 0u)};
  BTF_TRY(e->host->gpu_table(e->out, &table, &number));
  for (uint32_t f = 0; f < s->factors; f++)
    if (!is_stack || s->factor[f].projection == stack) put_factor(e, number, f);
  return BTF_OK;
}

/* ---- what texels have ---- */

static btf_status material_table(exporting *e, const char *name, uint32_t texel, uint32_t slices,
                                 uint32_t *number) {
  const btf_gpu_table table = {.struct_size = sizeof table,
                               .name = name,
                               .texel = texel,
                               .width = e->s->width,
                               .height = e->s->height,
                               .slices = slices,
                               .levels = e->s->levels,
                               .wrap = e->s->wrap};
  return e->host->gpu_table(e->out, &table, number);
}

/* The indices of all factors, low bytes first, then the angle: four bytes in a texel. */
static btf_status put_indices(exporting *e) {
  const btfi_cmf_state *s = e->s;
  const uint32_t indices = has_codebooks(s) ? s->factors * s->index_bytes : 0;
  const uint32_t bytes = indices + (s->angle[0] != NULL);
  uint32_t number;
  e->index_slices = (bytes + 3) / 4;
  if (bytes == 0) return BTF_OK;
  BTF_TRY(material_table(e, "btf_index", BTF_TEXEL_RGBA8_UNORM, e->index_slices, &number));
  for (uint32_t level = 0; level < s->levels; level++) {
    for (uint32_t b = 0; b < bytes; b++) {
      const unsigned char *src = b < indices ? s->index[level] + b : s->angle[level];
      const uint32_t step = b < indices ? indices : 1;
      unsigned char *dst = e->host->gpu_slice(e->out, number, level, b / 4);
      for (uint64_t i = 0; i < level_texels(s, level); i++) dst[4 * i + b % 4] = src[i * step];
    }
  }
  return BTF_OK;
}

static btf_status put_scales(exporting *e) {
  const btfi_cmf_state *s = e->s;
  const uint64_t step = (uint64_t)s->channels * btfi_cmf_value_bytes(s->storage);
  float global[4 * (CMF_MAX_SCALES + 1)] = {0};
  uint32_t number;
  BTF_TRY(material_table(e, "btf_scale", e->texel, s->scales, &number));
  for (uint32_t level = 0; level < s->levels; level++)
    for (uint32_t k = 0; k < s->scales; k++)
      put_texels(e, s->scale[level] + k * step, s->scales * step, level_texels(s, level),
                 e->host->gpu_slice(e->out, number, level, k));
  for (uint32_t k = 0; k < s->scales; k++)
    for (uint32_t c = 0; c < s->channels && c < 3; c++) global[4 * k + c] = s->global[k * s->channels + c];
  /* Two at least, which makes it an array. */
  return e->host->gpu_uniform(e->out, "btf_largest", BTF_UNIFORM_VEC4, s->scales > 1 ? s->scales : 2, global);
}

static btf_status put_numbers(exporting *e) {
  const btfi_cmf_state *s = e->s;
  if (!has_codebooks(s))
    BTF_TRY(e->host->gpu_uniform(e->out, "btf_level_start", BTF_UNIFORM_INT, CMF_MAX_LEVELS, e->level_start));
  if (s->angle[0] == NULL) return BTF_OK;
  float turn[2 * CMF_TURN];
  for (uint32_t i = 0; i < CMF_TURN; i++) {
    turn[2 * i] = s->cosine[i];
    turn[2 * i + 1] = s->sine[i];
  }
  return e->host->gpu_uniform(e->out, "btf_turns", BTF_UNIFORM_VEC4, CMF_TURN / 2, turn);
}

/* ---- shader ---- */

static btf_status put_projection(exporting *e) {
  const btfi_cmf_state *s = e->s;
  const btf_host *host = e->host;
  BTF_TRY(host->gpu_source(e->out, "/* Four texels of maps, the first of them, and their weights. */\n"
                                   "struct btf_taps {\n  ivec2 texel;\n  vec4 weight;\n};\n"
                                   "btf_taps btf_taps_of(vec3 d) {\n"
                                   "  d.z = max(d.z, 0.0);\n"));
  BTF_TRY(host->gpu_source(
      e->out, "%s",
      s->cube
          ? "  vec2 across = abs(d.xy), p;\n"
            "  if (d.z >= across.x && d.z >= across.y)\n"
            "    p = 0.5 * d.xy / d.z;\n"
            "  else if (across.x * 1.000001 >= across.y)\n"
            "    p = vec2((d.x < 0.0 ? -1.0 : 1.0) * (1.0 - 0.5 * d.z / across.x), 0.5 * d.y / across.x);\n"
            "  else\n"
            "    p = vec2(0.5 * d.x / across.y, (d.y < 0.0 ? -1.0 : 1.0) * (1.0 - 0.5 * d.z / across.y));\n"
          : "  vec2 p = d.xy / (1.0 + d.z);\n"
            "  float r2 = dot(p, p);\n"
            "  if (r2 > 1.0) p /= sqrt(r2);\n"));
  BTF_TRY(host->gpu_source(
      e->out,
      "  p = clamp((p * 0.5 + 0.5) * %u.0 - 0.5, 0.0, %u.0);\n"
      "  btf_taps t;\n"
      "  t.texel = min(ivec2(p), ivec2(%u));\n"
      "  p -= vec2(t.texel);\n"
      "  t.weight = vec4(1.0 - p.x, p.x, 1.0 - p.x, p.x) * vec4(1.0 - p.y, 1.0 - p.y, p.y, p.y);\n"
      "  return t;\n}\n",
      s->edge, s->edge - 1, s->edge - 2));
  BTF_TRY(host->gpu_source(e->out, "void btf_project(vec3 light, vec3 view, out btf_taps t[4]) {\n"));
  if (s->projections & (1u << CMF_HALF | 1u << CMF_DIFFERENCE))
    BTF_TRY(host->gpu_source(
        e->out, "  vec3 h = light + view;\n"
                "  vec3 halfway = dot(h, h) > 0.0 ? h / sqrt(dot(h, h)) : vec3(0.0, 0.0, 1.0);\n"));
  if (s->projections & 1u << CMF_DIFFERENCE)
    BTF_TRY(host->gpu_source(
        e->out, "  h = halfway;\n"
                "  float across = sqrt(h.y * h.y + h.z * h.z);\n"
                "  vec2 side = across > 0.0 ? h.yz / across : vec2(0.0, 1.0);\n"
                "  vec3 difference = vec3(light.x * across - h.x * dot(light.yz, side),\n"
                "                         light.y * side.y - light.z * side.x, dot(light, h));\n"));
  for (uint32_t p = 0; p < CMF_PROJECTIONS; p++)
    BTF_TRY(host->gpu_source(e->out, "  t[%u] = btf_taps_of(%s);\n", p,
                             s->projections & 1u << p ? projection_direction[p] : "light"));
  return host->gpu_source(e->out, "}\n");
}

/* Reads a map: NAME_value of stack NAME. */
static btf_status put_look_up(exporting *e, const char *name) {
  const uint32_t layer_maps = e->across * e->down;
  BTF_TRY(e->host->gpu_source(e->out, "vec3 btf_%s_value(btf_taps t, int map) {\n", name));
  if (layer_maps > 1)
    BTF_TRY(e->host->gpu_source(e->out,
                                "  int within = map %% %u;\n"
                                "  map /= %u;\n"
                                "  t.texel += ivec2(within %% %u, within / %u) * %u;\n",
                                layer_maps, layer_maps, e->across, e->across, e->s->edge));
  BTF_TRY(e->host->gpu_source(e->out, "  return ("));
  for (uint32_t i = 0; i < 4; i++)
    BTF_TRY(e->host->gpu_source(e->out, "%st.weight.%c * btf_%s(t.texel.x%s, t.texel.y%s, map, 0)",
                                i > 0 ? " +\n          " : "", "xyzw"[i], name, i % 2 ? " + 1" : "",
                                i / 2 ? " + 1" : ""));
  return e->host->gpu_source(e->out, ").rgb;\n}\n");
}

/* A byte of a texel of indices. */
static void name_byte(uint32_t byte, char out[24]) {
  snprintf(out, 24, "id%u.%c", (unsigned)(byte / 4), "xyzw"[byte % 4]);
}

static btf_status put_factor_text(exporting *e, uint32_t f) {
  const btfi_cmf_state *s = e->s;
  const btf_host *host = e->host;
  const btfi_cmf_state_factor *factor = &s->factor[f];
  const bool is_signed = factor->offset != 0.0f;
  char map[64] = "own", low[24], high[24];
  if (has_codebooks(s)) {
    name_byte(f * s->index_bytes, low);
    name_byte(f * s->index_bytes + s->index_bytes - 1, high);
    snprintf(map, sizeof map, s->index_bytes == 1 ? "%s" : "%s + 256 * %s", low, high);
  }
  if (factor->opens_term && factor->ratio > 0)
    BTF_TRY(host->gpu_source(e->out, "  term = btf_scale(x, y, %u, level).rgb * btf_largest[%u].rgb;\n",
                             factor->ratio, factor->ratio));
  BTF_TRY(host->gpu_source(e->out, "  term %s%sbtf_%s%s_value(t[%u], %u + %s)%s;\n",
                           factor->opens_term && factor->ratio == 0 ? "= " : "*= ", is_signed ? "(" : "",
                           e->layout == ATLAS ? "" : projection_name[factor->projection],
                           e->layout == ATLAS ? "factors" : "_factors", factor->projection,
                           (unsigned)e->start[f], map, is_signed ? " * 255.0 - 128.0) / 127.0" : ""));
  if (factor->ends_term)
    BTF_TRY(host->gpu_source(e->out, "  stage %s term;\n", factor->term > 0 ? "+=" : "="));
  if (factor->ends_stage) BTF_TRY(host->gpu_source(e->out, "  product *= stage;\n"));
  return BTF_OK;
}

/* The value of one texel. Rotated ABRDFs see directions of their own. */
static btf_status put_texel(exporting *e) {
  const btfi_cmf_state *s = e->s;
  const btf_host *host = e->host;
  const bool rotated = s->angle[0] != NULL;
  BTF_TRY(host->gpu_source(e->out, "vec3 btf_texel(%s, int x, int y, int level) {\n",
                           rotated ? "vec3 light, vec3 view" : "btf_taps t[4]"));
  for (uint32_t i = 0; i < e->index_slices; i++)
    BTF_TRY(
        host->gpu_source(e->out, "  ivec4 id%u = ivec4(btf_index(x, y, %u, level) * 255.0 + 0.5);\n", i, i));
  if (!has_codebooks(s))
    BTF_TRY(
        host->gpu_source(e->out, "  int own = btf_level_start[level] + y * btf_level_size(level).x + x;\n"));
  if (rotated) {
    char angle[24];
    name_byte(has_codebooks(s) ? s->factors * s->index_bytes : 0, angle);
    BTF_TRY(
        host->gpu_source(e->out,
                         "  btf_taps t[4];\n"
                         "  vec4 turns = btf_turns[%s >> 1];\n"
                         "  vec2 turn = (%s & 1) == 0 ? turns.xy : turns.zw;\n"
                         "  mat2 back = mat2(turn.x, -turn.y, turn.y, turn.x);\n"
                         "  btf_project(vec3(back * light.xy, light.z), vec3(back * view.xy, view.z), t);\n",
                         angle, angle));
  }
  BTF_TRY(host->gpu_source(
      e->out, "  vec3 product = btf_scale(x, y, 0, level).rgb * btf_largest[0].rgb, stage, term;\n"));
  for (uint32_t f = 0; f < s->factors; f++) BTF_TRY(put_factor_text(e, f));
  return host->gpu_source(e->out, "  return product;\n}\n");
}

static btf_status put_shader(exporting *e) {
  const bool rotated = e->s->angle[0] != NULL;
  BTF_TRY(put_texel(e));
  return e->host->gpu_source(
      e->out,
      "vec3 btf_stored(vec3 light, vec3 view, vec2 uv, float lod) {\n"
      "  btf_place place = btf_place_of(uv, lod);\n"
      "%s"
      "  vec3 sum = vec3(0.0);\n"
      "  for (int i = 0; i < 8; ++i) {\n"
      "    float weight;\n"
      "    ivec3 texel = btf_place_texel(place, i, weight);\n"
      "    if (weight > 0.0) sum += weight * btf_texel(%s, texel.x, texel.y, texel.z);\n"
      "  }\n  return sum;\n}\n",
      rotated ? "" : "  btf_taps t[4];\n  btf_project(light, view, t);\n", rotated ? "light, view" : "t");
}

/* ---- the export ---- */

/* Texels of one, two or four values; the fourth is not used. */
static void choose_texel(exporting *e) {
  static const uint32_t texels[CMF_STORAGES][3] = {
      {BTF_TEXEL_R8_UNORM, BTF_TEXEL_RG8_UNORM, BTF_TEXEL_RGBA8_UNORM},
      {BTF_TEXEL_R16_FLOAT, BTF_TEXEL_RG16_FLOAT, BTF_TEXEL_RGBA16_FLOAT},
      {BTF_TEXEL_R32_FLOAT, BTF_TEXEL_RG32_FLOAT, BTF_TEXEL_RGBA32_FLOAT}};
  const uint32_t shown = e->s->channels < 3 ? e->s->channels : 3, bytes = btfi_cmf_value_bytes(e->s->storage);
  e->texel = texels[e->s->storage][shown - 1];
  e->texel_bytes = (shown < 3 ? shown : 4) * bytes;
  e->shown_bytes = shown * bytes;
}

static void put_cost(exporting *e) {
  const btfi_cmf_state *s = e->s;
  const double maps = 4.0 * s->factors, projections = s->angle[0] != NULL ? 4.0 : 1.0;
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  cost.fetches = 4.0 * (e->index_slices + s->scales + maps);
  cost.bytes = 4.0 * (4.0 * e->index_slices + (s->scales + maps) * e->texel_bytes);
  cost.flops = 40.0 * projections + 4.0 * 3.0 * (2.0 * maps + s->factors + 2.0 * s->scales + 2.0);
  e->host->gpu_cost(e->out, &cost);
}

btf_status btfi_cmf_gpu(const btf_host *host, btf_context *ctx, const void *state,
                        const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                        btf_gpu_builder *out) {
  exporting e = {.host = host, .ctx = ctx, .s = state, .out = out, .target = target, .layout = layout};
  (void)shape;
  choose_texel(&e);
  BTF_TRY(number_maps(&e));
  BTF_TRY(put_indices(&e));
  BTF_TRY(put_scales(&e));
  BTF_TRY(put_numbers(&e));
  BTF_TRY(put_projection(&e));
  for (uint32_t p = 0; p < CMF_PROJECTIONS; p++) {
    char name[32] = "factors";
    if (e.stack_maps[p] == 0) continue;
    BTF_TRY(put_stack(&e, p));
    if (layout == STACKS) snprintf(name, sizeof name, "%s_factors", projection_name[p]);
    BTF_TRY(put_look_up(&e, name));
  }
  BTF_TRY(put_shader(&e));
  put_cost(&e);
  return BTF_OK;
}
