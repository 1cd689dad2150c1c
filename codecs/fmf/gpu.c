/* SPDX-License-Identifier: MIT */
/* gpu.c: eigen-textures and eigen-ABRDFs, four components in a texel (Schwartz 2013, sect. 4): U by light and
 * view, V by texel and level. The blend over nine direction pairs is done once for all channels' rows, then
 * comes a dot product for each channel. */
#include "fmf.h"

#include <math.h>
#include <string.h>

#include <btf/btf_half.h>

enum { RGBA = 0, RASTER = 1 };
static const btf_gpu_layout_desc rgba = {"rgba",
                                         "four components in a texel; halves are filtered by the sampler"};
static const btf_gpu_layout_desc raster = {
    "raster", "the same with samples and weights of directions from maps, as in the paper"};
const btf_gpu_layout_desc *const btfi_fmf_gpu_layouts[] = {&rgba, &raster, NULL};

/* Texels that hold the values of a storage without loss; bfloat16 loses what is below 2^-25 of the largest.
 */
static uint32_t texel_of(uint32_t storage) {
  return storage == FMF_F32  ? BTF_TEXEL_RGBA32_FLOAT
         : storage == FMF_Q8 ? BTF_TEXEL_RGBA8_SNORM
                             : BTF_TEXEL_RGBA16_FLOAT;
}

/* Four values of a row of a table, as texels want them. */
static void put_group(uint32_t storage, const unsigned char *src, unsigned char *dst) {
  if (storage != FMF_BF16) {
    memcpy(dst, src, 4 * (size_t)btfi_fmf_value_bytes(storage));
    return;
  }
  for (int i = 0; i < 4; i++) {
    uint16_t top;
    float value;
    memcpy(&top, src + 2 * i, sizeof top);
    const uint32_t bits = (uint32_t)top << 16;
    memcpy(&value, &bits, sizeof value);
    const uint16_t half = btf_float_to_half(value);
    memcpy(dst + 2 * i, &half, sizeof half);
  }
}

static btf_status put_u(const btf_host *host, const btfi_fmf_state *s, uint32_t channels,
                        btf_gpu_builder *b) {
  const btfi_fmf_layout *l = &s->layout;
  const uint32_t groups = l->stride / 4, group_bytes = 4 * btfi_fmf_value_bytes(l->storage);
  const btf_gpu_table table = {.struct_size = sizeof table,
                               .name = "btf_u",
                               .texel = texel_of(l->storage),
                               .width = l->lights,
                               .height = l->views,
                               .slices = channels * groups,
                               .levels = 1,
                               .wrap = BTF_WRAP_CLAMP};
  uint32_t number;
  BTF_TRY(host->gpu_table(b, &table, &number));
  for (uint32_t c = 0; c < channels; c++) {
    for (uint32_t g = 0; g < groups; g++) {
      unsigned char *dst = host->gpu_slice(b, number, 0, c * groups + g);
      const unsigned char *row = s->u + c * s->channel_bytes + (uint64_t)g * group_bytes;
      for (uint64_t pair = 0; pair < (uint64_t)l->lights * l->views; pair++, dst += group_bytes)
        put_group(l->storage, row + pair * l->u_row_bytes, dst);
    }
  }
  return BTF_OK;
}

static btf_status put_v(const btf_host *host, const btfi_fmf_state *s, bool filtered, btf_gpu_builder *b) {
  const btfi_fmf_layout *l = &s->layout;
  const uint32_t groups = l->stride / 4, group_bytes = 4 * btfi_fmf_value_bytes(l->storage);
  const btf_gpu_table table = {.struct_size = sizeof table,
                               .name = "btf_v",
                               .texel = texel_of(l->storage),
                               .width = l->width,
                               .height = l->height,
                               .slices = groups,
                               .levels = l->levels,
                               .wrap = s->wrap,
                               .flags =
                                   BTF_GPU_MATERIAL | BTF_GPU_SMOOTH | (filtered ? BTF_GPU_FILTERED : 0u)};
  uint32_t number;
  BTF_TRY(host->gpu_table(b, &table, &number));
  for (uint32_t level = 0; level < l->levels; level++) {
    for (uint32_t g = 0; g < groups; g++) {
      unsigned char *dst = host->gpu_slice(b, number, level, g);
      for (uint32_t y = 0; y < l->level_height[level]; y++) {
        const unsigned char *row = s->v[level] + y * l->v_line_bytes[level] + (uint64_t)g * group_bytes;
        for (uint32_t x = 0; x < l->level_width[level]; x++, dst += group_bytes)
          put_group(l->storage, row + x * l->v_texel_bytes, dst);
      }
    }
  }
  return BTF_OK;
}

static btf_status put_shader(const btf_host *host, uint32_t groups, uint32_t channels, bool filtered,
                             btf_gpu_builder *b) {
  BTF_TRY(host->gpu_source(b, "vec3 btf_stored(vec3 light, vec3 view, vec2 uv, float lod) {\n"
                              "  ivec3 l, v;\n"
                              "  vec3 lw, vw, sum = vec3(0.0);\n"
                              "  btf_locate_light(light, l, lw);\n"
                              "  btf_locate_view(view, v, vw);\n"));
  if (!filtered) BTF_TRY(host->gpu_source(b, "  btf_place place = btf_place_of(uv, lod);\n"));
  BTF_TRY(host->gpu_source(b, "  for (int g = 0; g < %u; ++g) {\n    vec4 texel = %s * btf_scale[g];\n",
                           groups, filtered ? "btf_v_at(uv, g, lod)" : "btf_v_mix(place, g)"));
  for (uint32_t c = 0; c < channels; c++)
    BTF_TRY(host->gpu_source(b,
                             "    vec4 row%u = vec4(0.0);\n"
                             "    for (int j = 0; j < 3; ++j)\n"
                             "      row%u += vw[j] * (lw.x * btf_u(l.x, v[j], %u + g, 0) +"
                             " lw.y * btf_u(l.y, v[j], %u + g, 0) + lw.z * btf_u(l.z, v[j], %u + g, 0));\n"
                             "    sum[%u] += dot(row%u, texel);\n",
                             c, c, c * groups, c * groups, c * groups, c, c));
  return host->gpu_source(b, "  }\n  return sum;\n}\n");
}

/* Signed bytes come from a texture as 127ths. */
static btf_status put_scale(const btf_host *host, const btfi_fmf_state *s, uint32_t groups,
                            btf_gpu_builder *b) {
  const float unit = s->layout.storage == FMF_Q8 ? 127.0f * 127.0f : 1.0f;
  float scale[FMF_MAX_COLUMNS];
  for (uint32_t k = 0; k < FMF_MAX_COLUMNS; k++) scale[k] = s->column_scale[k] * unit;
  /* Two at least, which makes it an array. */
  return host->gpu_uniform(b, "btf_scale", BTF_UNIFORM_VEC4, groups > 1 ? groups : 2, scale);
}

/* ---- what weights from maps cost ---- */

/* Rows of both sides times the square roots of their columns' scales: a value is the product of one of U and
 * one of V, so that two rows of U make values that differ by at most their distance times the length of V's
 * row. Rows have the order of the kernels, which no length depends on. */
typedef struct rooted {
  const btfi_fmf_state *s;
  float root[FMF_MAX_COLUMNS];
} rooted;

static void root_row(const rooted *r, const unsigned char *row, float *out) {
  const btfi_fmf_rows rows = {.row = {row}, .weight = {1.0f}, .count = 1};
  r->s->blend(&rows, r->s->layout.padded, r->root, out);
}

/* Of the longest row of V. Blends of texels are no longer. */
static double longest_texel(const rooted *r) {
  const btfi_fmf_layout *l = &r->s->layout;
  float row[FMF_MAX_COLUMNS];
  double longest = 0.0;
  for (uint32_t level = 0; level < l->levels; level++)
    for (uint32_t y = 0; y < l->level_height[level]; y++)
      for (uint32_t x = 0; x < l->level_width[level]; x++) {
        double squares = 0.0;
        root_row(r, r->s->v[level] + y * l->v_line_bytes[level] + x * l->v_texel_bytes, row);
        for (uint32_t k = 0; k < l->padded; k++) squares += (double)row[k] * (double)row[k];
        longest = fmax(longest, squares);
      }
  return sqrt(longest);
}

/* The largest distance of `count` rows of U from their mean; two of them are twice as far apart at most. */
static double radius(const rooted *r, const unsigned char *first, uint64_t step, uint32_t count) {
  const uint32_t padded = r->s->layout.padded;
  float row[FMF_MAX_COLUMNS];
  double mean[FMF_MAX_COLUMNS] = {0.0}, largest = 0.0;
  for (uint32_t i = 0; i < count; i++) {
    root_row(r, first + i * step, row);
    for (uint32_t k = 0; k < padded; k++) mean[k] += (double)row[k] / count;
  }
  for (uint32_t i = 0; i < count; i++) {
    double squares = 0.0;
    root_row(r, first + i * step, row);
    for (uint32_t k = 0; k < padded; k++) squares += ((double)row[k] - mean[k]) * ((double)row[k] - mean[k]);
    largest = fmax(largest, squares);
  }
  return sqrt(largest);
}

/* The most that rounded weights make of any value: first the lights' are exchanged, then the views'. */
static double largest_rounding(const btfi_fmf_state *s, uint32_t channels, double light_shift,
                               double view_shift) {
  const btfi_fmf_layout *l = &s->layout;
  const uint64_t view_bytes = l->lights * l->u_row_bytes;
  double light_radius = 0.0, view_radius = 0.0;
  rooted r = {.s = s};
  for (uint32_t k = 0; k < l->padded; k++) r.root[k] = sqrtf(fabsf(s->scale[k]));
  for (uint32_t c = 0; c < channels; c++) {
    const unsigned char *u = s->u + c * s->channel_bytes;
    for (uint32_t v = 0; v < l->views; v++)
      light_radius = fmax(light_radius, radius(&r, u + v * view_bytes, l->u_row_bytes, l->lights));
    for (uint32_t i = 0; i < l->lights; i++)
      view_radius = fmax(view_radius, radius(&r, u + i * l->u_row_bytes, view_bytes, l->views));
  }
  return 2.0 * longest_texel(&r) * (light_shift * light_radius + view_shift * view_radius);
}

static btf_status put_directions(const btf_host *host, const btfi_fmf_state *s, const btf_model_shape *shape,
                                 uint32_t layout, uint32_t channels, btf_gpu_builder *out) {
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  double light_shift, view_shift;
  if (layout == RGBA) {
    BTF_TRY(host->gpu_directions(out, "light", shape->lights));
    return host->gpu_directions(out, "view", shape->views);
  }
  BTF_TRY(host->gpu_direction_maps(out, "light", shape->lights, &light_shift));
  BTF_TRY(host->gpu_direction_maps(out, "view", shape->views, &view_shift));
  cost.rounding = largest_rounding(s, channels, light_shift, view_shift);
  host->gpu_cost(out, &cost);
  return BTF_OK;
}

btf_status btfi_fmf_gpu(const btf_host *host, btf_context *ctx, const void *state,
                        const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                        btf_gpu_builder *out) {
  const btfi_fmf_state *s = state;
  const btfi_fmf_layout *l = &s->layout;
  const uint32_t channels = l->channels < 3 ? l->channels : 3, groups = l->stride / 4;
  /* Samplers of plain WebGL 2 filter halves but not floats, and signed bytes with few bits. */
  const bool filtered = l->storage == FMF_F16 || l->storage == FMF_BF16;
  const double texels = (9.0 * channels + (filtered ? 1 : 4)) * groups;
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  (void)ctx, (void)target;
  BTF_TRY(put_directions(host, s, shape, layout, channels, out));
  BTF_TRY(put_u(host, s, channels, out));
  BTF_TRY(put_v(host, s, filtered, out));
  BTF_TRY(put_scale(host, s, groups, out));
  BTF_TRY(put_shader(host, groups, channels, filtered, out));
  cost.fetches = texels;
  cost.bytes = (9.0 * channels + 4.0) * groups * 4 * btfi_fmf_value_bytes(l->storage);
  cost.flops = groups * 4 * (channels * 20.0 + 9.0);
  host->gpu_cost(out, &cost);
  return BTF_OK;
}
