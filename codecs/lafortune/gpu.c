/* SPDX-License-Identifier: MIT */
/* gpu.c: coefficient textures (Mueller et al. 2004, sect. 5.4.1): the values of a record, four in a texel.
 * The shader evaluates each texel around a position for the query's own directions and blends what they give.
 */
#include "lafortune.h"

#include <stdio.h>
#include <string.h>

#include <btf/btf_codec.h>

enum {
  EXPORTED_CHANNELS = 3,
  MAX_VALUES = EXPORTED_CHANNELS * (LAF_MAX_LOBES * LAF_MAX_SHAPE + LAF_MAX_ALBEDOS),
  NAME_BYTES = 16
};

static const btf_gpu_layout_desc coefficients = {
    "coefficients", "shapes and albedos of all lobes, four in a texel; evaluated by texel, then blended"};
const btf_gpu_layout_desc *const btfi_lafortune_gpu_layouts[] = {&coefficients, NULL};

/* What of a record is exported, in the order of the record: the groups and channels that a shader returns. */
typedef struct selection {
  uint32_t groups, group_channels, group_values, lobe_shape, lobes;
  uint32_t values;
  uint32_t source[MAX_VALUES]; /* number in the record */
} selection;

static void select_values(const btfi_lafortune_layout *l, selection *out) {
  *out = (selection){.groups = l->groups < EXPORTED_CHANNELS ? l->groups : EXPORTED_CHANNELS,
                     .group_channels =
                         l->group_channels < EXPORTED_CHANNELS ? l->group_channels : EXPORTED_CHANNELS,
                     .lobe_shape = l->shape,
                     .lobes = l->lobes};
  for (uint32_t g = 0; g < out->groups; g++) {
    const uint32_t start = g * l->group_values, shapes = l->lobes * l->shape;
    for (uint32_t i = 0; i < shapes; i++) out->source[out->values++] = start + i;
    for (uint32_t j = 0; j <= l->lobes; j++)
      for (uint32_t c = 0; c < out->group_channels; c++)
        out->source[out->values++] = start + shapes + j * l->group_channels + c;
  }
  out->group_values = out->values / out->groups;
}

static btf_status put_texels(const btf_host *host, const btfi_lafortune_state *s, const selection *sel,
                             btf_gpu_builder *b) {
  const uint32_t bytes = s->layout.value_bytes;
  const btf_gpu_table table = {.struct_size = sizeof table,
                               .name = "btf_lobes",
                               .texel = bytes == 2 ? BTF_TEXEL_RGBA16_FLOAT : BTF_TEXEL_RGBA32_FLOAT,
                               .width = s->level_width[0],
                               .height = s->level_height[0],
                               .slices = (sel->values + 3) / 4,
                               .levels = s->levels,
                               .wrap = s->wrap,
                               .flags = BTF_GPU_MATERIAL};
  uint32_t number;
  BTF_TRY(host->gpu_table(b, &table, &number));
  for (uint32_t level = 0; level < s->levels; level++) {
    const uint64_t texels = (uint64_t)s->level_width[level] * s->level_height[level];
    for (uint32_t i = 0; i < sel->values; i++) {
      unsigned char *dst = host->gpu_slice(b, number, level, i / 4);
      const unsigned char *src = s->texels[level] + (uint64_t)sel->source[i] * bytes;
      dst += (uint64_t)(i % 4) * bytes;
      for (uint64_t t = 0; t < texels; t++)
        memcpy(dst + t * 4 * bytes, src + t * s->layout.values * bytes, bytes);
    }
  }
  return BTF_OK;
}

/* ---- the shader ---- */

/* Value i of the selection, in the shader. */
static const char *value_name(uint32_t i, char name[NAME_BYTES]) {
  snprintf(name, NAME_BYTES, "t%u.%c", i / 4, "xyzw"[i % 4]);
  return name;
}

static btf_status put_matrix_row(const btf_host *host, uint32_t at, btf_gpu_builder *b) {
  char x[NAME_BYTES], y[NAME_BYTES], z[NAME_BYTES];
  return host->gpu_source(b, "vec3(%s, %s, %s)", value_name(at, x), value_name(at + 1, y),
                          value_name(at + 2, z));
}

/* The lobe whose shape begins at value `at`. */
static btf_status put_lobe(const btf_host *host, uint32_t kind, uint32_t at, btf_gpu_builder *b) {
  char first[NAME_BYTES], second[NAME_BYTES];
  switch (kind) {
  case LAF_DIAGONAL:
    BTF_TRY(host->gpu_source(b, "btf_power(dot("));
    BTF_TRY(put_matrix_row(host, at, b));
    return host->gpu_source(b, ", term), %s)", value_name(at + 3, first));
  case LAF_FULL:
    BTF_TRY(host->gpu_source(b, "btf_power(dot(view, vec3("));
    for (uint32_t i = 0; i < 3; i++) {
      BTF_TRY(host->gpu_source(b, i == 0 ? "dot(" : ", dot("));
      BTF_TRY(put_matrix_row(host, at + 3 * i, b));
      BTF_TRY(host->gpu_source(b, ", light)"));
    }
    return host->gpu_source(b, ")), %s)", value_name(at + 9, first));
  case LAF_WARD:
    value_name(at, first);
    value_name(at + 1, second);
    return host->gpu_source(b, "exp(-(term.x / (%s * %s) + term.y / (%s * %s))) * (0.0795774715 / (%s * %s))",
                            first, first, second, second, first, second);
  case LAF_LEWIS:
    value_name(at, first);
    return host->gpu_source(b, "btf_power(term.x, %s) * ((%s + 2.0) * 0.159154943)", first, first);
  default:
    return host->gpu_source(b, "btf_power(term.x, %s)", value_name(at, first));
  }
}

/* Albedos of a group's channels that begin at value `at`, as a colour. */
static btf_status put_albedo(const btf_host *host, const selection *sel, uint32_t group, uint32_t at,
                             btf_gpu_builder *b) {
  char x[NAME_BYTES], y[NAME_BYTES], z[NAME_BYTES];
  value_name(at, x);
  if (sel->groups > 1) {
    return group == 0   ? host->gpu_source(b, "vec3(%s, 0.0, 0.0)", x)
           : group == 1 ? host->gpu_source(b, "vec3(0.0, %s, 0.0)", x)
                        : host->gpu_source(b, "vec3(0.0, 0.0, %s)", x);
  }
  if (sel->group_channels == 1) return host->gpu_source(b, "vec3(%s, 0.0, 0.0)", x);
  if (sel->group_channels == 2) return host->gpu_source(b, "vec3(%s, %s, 0.0)", x, value_name(at + 1, y));
  return host->gpu_source(b, "vec3(%s, %s, %s)", x, value_name(at + 1, y), value_name(at + 2, z));
}

/* One texel for given directions: term is what lobes of the kind are made of, lobe_factor multiplies them. */
static btf_status put_texel_function(const btf_host *host, uint32_t kind, const selection *sel,
                                     btf_gpu_builder *b) {
  BTF_TRY(host->gpu_source(
      b, "vec3 btf_texel(int x, int y, int level, vec3 light, vec3 view, vec3 term, float lobe_factor) {\n"));
  for (uint32_t i = 0; i < (sel->values + 3) / 4; i++)
    BTF_TRY(host->gpu_source(b, "  vec4 t%u = btf_lobes(x, y, %u, level);\n", i, i));
  BTF_TRY(host->gpu_source(b, "  vec3 sum = vec3(0.0);\n"));
  for (uint32_t g = 0; g < sel->groups; g++) {
    const uint32_t shapes = g * sel->group_values, albedos = shapes + sel->lobes * sel->lobe_shape;
    BTF_TRY(host->gpu_source(b, "  sum += "));
    BTF_TRY(put_albedo(host, sel, g, albedos, b));
    BTF_TRY(host->gpu_source(b, ";\n"));
    for (uint32_t j = 0; j < sel->lobes; j++) {
      BTF_TRY(host->gpu_source(b, "  sum += lobe_factor * "));
      BTF_TRY(put_lobe(host, kind, shapes + j * sel->lobe_shape, b));
      BTF_TRY(host->gpu_source(b, " * "));
      BTF_TRY(put_albedo(host, sel, g, albedos + (j + 1) * sel->group_channels, b));
      BTF_TRY(host->gpu_source(b, ";\n"));
    }
  }
  return host->gpu_source(b, "  return sum;\n}\n");
}

/* As btfi_lafortune_terms_of; the cosine comes last. */
static const char *terms_of(uint32_t kind) {
  switch (kind) {
  case LAF_DIAGONAL:
    return "  vec3 term = view * light;\n  float lobe_factor = 1.0;\n";
  case LAF_FULL:
    return "  vec3 term = vec3(0.0);\n  float lobe_factor = 1.0;\n";
  case LAF_WARD:
    return "  vec3 middle = light + view;\n"
           "  vec3 term = vec3(middle.xy * middle.xy / max(middle.z * middle.z, 1e-6), 0.0);\n"
           "  float lobe_factor = 1.0 / sqrt(max(light.z * view.z, 0.0004));\n";
  case LAF_BLINN_PHONG:
    return "  vec3 term = vec3((light.z + view.z) / length(light + view));\n"
           "  float lobe_factor = 1.0 / max(light.z, 0.02);\n";
  case LAF_PHONG:
    return "  vec3 term = vec3(dot(view, vec3(-light.xy, light.z)));\n"
           "  float lobe_factor = 1.0 / max(light.z, 0.02);\n";
  default:
    return "  vec3 term = vec3(dot(view, vec3(-light.xy, light.z)));\n  float lobe_factor = 1.0;\n";
  }
}

static btf_status put_shader(const btf_host *host, const btfi_lafortune_state *s, const selection *sel,
                             btf_gpu_builder *b) {
  BTF_TRY(put_texel_function(host, s->layout.kind, sel, b));
  BTF_TRY(host->gpu_source(b, "vec3 btf_stored(vec3 light, vec3 view, vec2 uv, float lod) {\n%s",
                           terms_of(s->layout.kind)));
  return host->gpu_source(
      b,
      "  btf_place p = btf_place_of(uv, lod);\n"
      "  vec3 sum = vec3(0.0);\n"
      "  for (int i = 0; i < 4; ++i)\n"
      "    sum += p.weight0[i] *\n"
      "           btf_texel(p.x0[i & 1], p.y0[i >> 1], p.level.x, light, view, term, lobe_factor);\n"
      "  sum *= btf_albedo_scale[p.level.x];\n"
      "  if (p.share > 0.0) {\n"
      "    vec3 coarse = vec3(0.0);\n"
      "    for (int i = 0; i < 4; ++i)\n"
      "      coarse += p.weight1[i] *\n"
      "                btf_texel(p.x1[i & 1], p.y1[i >> 1], p.level.y, light, view, term, lobe_factor);\n"
      "    sum += coarse * btf_albedo_scale[p.level.y];\n"
      "  }\n"
      "  return sum%s;\n"
      "}\n",
      s->times_cosine ? " * light.z" : "");
}

/* Operations of a lobe, a power or exponential counted as 20. */
static double lobe_flops(uint32_t kind) {
  return kind == LAF_DIAGONAL ? 25.0 : kind == LAF_FULL ? 40.0 : kind == LAF_WARD ? 30.0 : 23.0;
}

btf_status btfi_lafortune_gpu(const btf_host *host, btf_context *ctx, const void *state,
                              const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                              btf_gpu_builder *out) {
  const btfi_lafortune_state *s = state;
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  selection sel;
  (void)ctx, (void)shape, (void)layout, (void)target;
  select_values(&s->layout, &sel);
  BTF_TRY(put_texels(host, s, &sel, out));
  /* Two at least, which makes it an array. */
  BTF_TRY(
      host->gpu_uniform(out, "btf_albedo_scale", BTF_UNIFORM_FLOAT, s->levels > 1 ? s->levels : 2, s->scale));
  BTF_TRY(put_shader(host, s, &sel, out));
  cost.fetches = 4.0 * ((sel.values + 3) / 4);
  cost.bytes = cost.fetches * 4.0 * s->layout.value_bytes;
  cost.flops = 4.0 * (sel.groups * (sel.lobes * (lobe_flops(s->layout.kind) + 9.0) + 3.0) + 6.0) + 20.0;
  host->gpu_cost(out, &cost);
  return BTF_OK;
}
