/* SPDX-License-Identifier: MIT */
/* gpu.c: STAR eq. 19 to 21: the eigen-textures of all views in one stack of layers, four columns in a texel,
 * and the weights of each light and view. The mean of a view is a column whose weight is 1 for every light.
 */
#include "pvpca.h"

#include <string.h>

#include <btf/btf_codec.h>
#include <btf/btf_half.h>

static const btf_gpu_layout_desc views = {
    "views", "eigen-textures of each view, four columns in a texel; halves are filtered by the sampler"};
const btf_gpu_layout_desc *const btfi_pvpca_gpu_layouts[] = {&views, NULL};

enum { ROW = 1024 /* views in a row of their table */ };

typedef struct exporting {
  const btf_host *host;
  const btfi_pvpca_state *s;
  btf_gpu_builder *out;
  uint32_t shown;                  /* channels */
  uint32_t g_channels, h_channels; /* the shown ones that tables have */
  uint32_t most_groups;            /* of a view */
  double groups;                   /* of all views */
  bool filtered;
} exporting;

static uint32_t groups_of(const btfi_pvpca_view *view) {
  return (view->columns + 3) / 4;
}

/* Where the layers of a view begin, and its groups of four columns. */
static btf_status put_views(exporting *e, uint32_t *slices) {
  const btfi_pvpca_layout *l = &e->s->layout;
  const btf_gpu_table table = {.struct_size = sizeof table,
                               .name = "btf_view_layers",
                               .texel = BTF_TEXEL_RG32_FLOAT,
                               .width = l->views < ROW ? l->views : ROW,
                               .height = (l->views + ROW - 1) / ROW,
                               .slices = 1,
                               .levels = 1,
                               .wrap = BTF_WRAP_CLAMP};
  uint32_t number;
  BTF_TRY(e->host->gpu_table(e->out, &table, &number));
  float *entry = e->host->gpu_slice(e->out, number, 0, 0);
  *slices = 0;
  for (uint32_t v = 0; v < l->views; v++) {
    const uint32_t groups = groups_of(&e->s->views[v]);
    entry[2 * v] = (float)*slices;
    entry[2 * v + 1] = (float)groups;
    *slices += groups * e->h_channels;
    e->groups += groups;
    if (groups > e->most_groups) e->most_groups = groups;
  }
  return BTF_OK;
}

/* ---- weights ---- */

static float weight_at(const btfi_pvpca_state *s, const unsigned char *row, uint32_t i) {
  return btfi_pvpca_weight_storage(s->layout.storage) == PVPCA_F32 ? btf_get_f32(row + 4 * (size_t)i)
                                                                   : btf_half_at(row, i);
}

/* The scaled weights of a view and a channel, one texel of four columns for each light. Signed bytes come
 * from a texture as 127ths. */
static void put_weights_of(const exporting *e, uint32_t v, uint32_t channel, uint32_t number) {
  const btfi_pvpca_state *s = e->s;
  const btfi_pvpca_view *view = &s->views[v];
  const float unit = btfi_pvpca_unit(s->layout.storage);
  const uint32_t mean = s->layout.has_mean;
  for (uint32_t column = 0; column < view->columns; column++) {
    float *dst = e->host->gpu_slice(e->out, number, 0, channel * e->most_groups + column / 4);
    dst += 4 * (size_t)v * s->layout.lights + column % 4;
    for (uint32_t light = 0; light < s->layout.lights; light++, dst += 4) {
      const unsigned char *row = s->g + view->g_start + (uint64_t)light * view->g_light_bytes;
      const uint32_t term = column - mean;
      *dst = unit * (column < mean ? view->mean_scale
                                   : s->scales[view->padded_start + term] *
                                         weight_at(s, row, channel * view->terms + term));
    }
  }
}

static btf_status put_weights(exporting *e) {
  const btfi_pvpca_layout *l = &e->s->layout;
  const btf_gpu_table table = {.struct_size = sizeof table,
                               .name = "btf_weights",
                               .texel = BTF_TEXEL_RGBA32_FLOAT,
                               .width = l->lights,
                               .height = l->views,
                               .slices = e->most_groups > 0 ? e->g_channels * e->most_groups : 1,
                               .levels = 1,
                               .wrap = BTF_WRAP_CLAMP};
  uint32_t number;
  BTF_TRY(e->host->gpu_table(e->out, &table, &number));
  for (uint32_t v = 0; v < l->views; v++)
    for (uint32_t c = 0; c < e->g_channels; c++) put_weights_of(e, v, c, number);
  return BTF_OK;
}

/* ---- eigen-textures ---- */

static void put_layers(const exporting *e, uint32_t v, uint32_t level, uint32_t slice, uint32_t number) {
  const btfi_pvpca_layout *l = &e->s->layout;
  const btfi_pvpca_view *view = &e->s->views[v];
  const uint32_t bytes = l->h_bytes_value;
  const unsigned char *textures = e->s->h[level] + l->level_texels[level] * view->h_before;
  for (uint32_t c = 0; c < e->h_channels; c++) {
    for (uint32_t first = 0; first < view->columns; first += 4) {
      const uint32_t columns = view->columns - first < 4 ? view->columns - first : 4;
      const unsigned char *src = textures + ((uint64_t)c * view->columns + first) * bytes;
      unsigned char *dst = e->host->gpu_slice(e->out, number, level, slice++);
      for (uint64_t texel = 0; texel < l->level_texels[level]; texel++)
        memcpy(dst + texel * 4 * bytes, src + texel * view->h_texel_bytes, (size_t)columns * bytes);
    }
  }
}

static btf_status put_textures(exporting *e, uint32_t slices) {
  static const uint32_t texels[PVPCA_STORAGES] = {BTF_TEXEL_RGBA32_FLOAT, BTF_TEXEL_RGBA16_FLOAT,
                                                  BTF_TEXEL_RGBA8_SNORM};
  const btfi_pvpca_layout *l = &e->s->layout;
  const btf_gpu_table table = {.struct_size = sizeof table,
                               .name = "btf_textures",
                               .texel = texels[l->storage],
                               .width = l->width,
                               .height = l->height,
                               .slices = slices > 0 ? slices : 1,
                               .levels = l->levels,
                               .wrap = e->s->wrap,
                               .flags =
                                   BTF_GPU_MATERIAL | BTF_GPU_SMOOTH | (e->filtered ? BTF_GPU_FILTERED : 0u)};
  uint32_t number;
  BTF_TRY(e->host->gpu_table(e->out, &table, &number));
  for (uint32_t level = 0; level < l->levels; level++) {
    uint32_t slice = 0;
    for (uint32_t v = 0; v < l->views; v++) {
      put_layers(e, v, level, slice, number);
      slice += groups_of(&e->s->views[v]) * e->h_channels;
    }
  }
  return BTF_OK;
}

/* ---- shader ---- */

/* The blend of weights over three lights, of one group (eq. 20). */
static btf_status put_blend(exporting *e, uint32_t channel) {
  return e->host->gpu_source(e->out,
                             "      row = lw.x * btf_weights(l.x, v[j], %u + g, 0) + lw.y * btf_weights(l.y, "
                             "v[j], %u + g, 0) +\n            lw.z * btf_weights(l.z, v[j], %u + g, 0);\n",
                             channel * e->most_groups, channel * e->most_groups, channel * e->most_groups);
}

static btf_status put_shader(exporting *e) {
  const bool by_light = e->s->layout.color == PVPCA_COLOR_LIGHTS;
  const char *before = e->filtered ? "btf_textures_at(uv, " : "btf_textures_mix(place, ";
  const char *after = e->filtered ? ", lod)" : ")";
  BTF_TRY(e->host->gpu_source(e->out, "vec3 btf_stored(vec3 light, vec3 view, vec2 uv, float lod) {\n"
                                      "  ivec3 l, v;\n"
                                      "  vec3 lw, vw, sum = vec3(0.0);\n"
                                      "  btf_locate_light(light, l, lw);\n"
                                      "  btf_locate_view(view, v, vw);\n"));
  if (!e->filtered) BTF_TRY(e->host->gpu_source(e->out, "  btf_place place = btf_place_of(uv, lod);\n"));
  BTF_TRY(
      e->host->gpu_source(e->out,
                          "  for (int j = 0; j < 3; ++j) {\n"
                          "    ivec2 layers = ivec2(btf_view_layers(v[j] %% %d, v[j] / %d, 0, 0).rg + 0.5);\n"
                          "    for (int g = 0; g < layers.y; ++g) {\n"
                          "      vec4 row, texel;\n",
                          ROW, ROW));
  if (by_light)
    BTF_TRY(e->host->gpu_source(e->out, "      texel = %slayers.x + g%s;\n", before, after));
  else
    BTF_TRY(put_blend(e, 0));
  for (uint32_t c = 0; c < e->shown; c++) {
    if (by_light)
      BTF_TRY(put_blend(e, c));
    else
      BTF_TRY(
          e->host->gpu_source(e->out, "      texel = %slayers.x + %u * layers.y + g%s;\n", before, c, after));
    BTF_TRY(e->host->gpu_source(e->out, "      sum[%u] += vw[j] * dot(row, texel);\n", c));
  }
  return e->host->gpu_source(e->out, "    }\n  }\n  return sum;\n}\n");
}

/* With as many columns as a view has on average. */
static void put_cost(exporting *e) {
  const btfi_pvpca_layout *l = &e->s->layout;
  const double groups = e->groups / l->views, rows = 9.0 * groups * e->g_channels,
               textures = 3.0 * groups * e->h_channels;
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  cost.fetches = 3.0 + rows + textures * (e->filtered ? 1.0 : 4.0);
  cost.bytes = 3.0 * 8.0 + rows * 16.0 + textures * 4.0 * 4.0 * l->h_bytes_value;
  cost.flops = 8.0 * (rows + 4.0 * textures) + 3.0 * groups * e->shown * 9.0;
  e->host->gpu_cost(e->out, &cost);
}

btf_status btfi_pvpca_gpu(const btf_host *host, btf_context *ctx, const void *state,
                          const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                          btf_gpu_builder *out) {
  const btfi_pvpca_state *s = state;
  const uint32_t shown = s->layout.channels < 3 ? s->layout.channels : 3;
  exporting e = {.host = host, .s = s, .out = out, .shown = shown};
  uint32_t slices;
  (void)ctx, (void)layout, (void)target;
  e.g_channels = s->layout.g_channels > 1 ? shown : 1;
  e.h_channels = s->layout.h_channels > 1 ? shown : 1;
  /* Samplers of plain WebGL 2 filter halves but not floats, and signed bytes with few bits. */
  e.filtered = s->layout.storage == PVPCA_F16;
  BTF_TRY(host->gpu_directions(out, "light", shape->lights));
  BTF_TRY(host->gpu_directions(out, "view", shape->views));
  BTF_TRY(put_views(&e, &slices));
  BTF_TRY(put_weights(&e));
  BTF_TRY(put_textures(&e, slices));
  BTF_TRY(put_shader(&e));
  put_cost(&e);
  return BTF_OK;
}
