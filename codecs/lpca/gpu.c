/* SPDX-License-Identifier: MIT */
/* gpu.c: STAR sect. 5.4.5: a map of clusters, the coefficients of texels, and for each cluster stacks of
 * factors by light and view, four components in a texel. The eight texels around a position are taken
 * together where they are of one cluster; colours of different ones are blended. */
#include "lpca.h"

#include <btf/btf_half.h>

enum { FULL = 0, BYTES = 1 };
static const btf_gpu_layout_desc full = {"full", "values as the model stores them"};
static const btf_gpu_layout_desc bytes = {
    "bytes", "3D textures of components in signed bytes with a scale each, as in the papers"};
const btf_gpu_layout_desc *const btfi_lpca_gpu_layouts[] = {&full, &bytes, NULL};

typedef struct exporting {
  const btf_host *host;
  btf_context *ctx;
  const btfi_lpca_state *s;
  btf_gpu_builder *out;
  const btf_gpu_target *target;
  uint32_t layout, shown, groups; /* shown: channels */
  uint32_t value_texel, factor_texel;
  /* Largest rounding of each cluster's components, before they are scaled. */
  float *rounding;
} exporting;

static btf_status table(exporting *e, const char *name, uint32_t texel, uint32_t width, uint32_t height,
                        uint32_t slices, uint32_t flags, uint32_t *number) {
  const bool of_material = (flags & BTF_GPU_MATERIAL) != 0;
  const btf_gpu_table description = {.struct_size = sizeof description,
                                     .name = name,
                                     .texel = texel,
                                     .width = width,
                                     .height = height,
                                     .slices = slices,
                                     .levels = of_material ? e->s->layout.levels : 1,
                                     .wrap = of_material ? e->s->wrap : (uint32_t)BTF_WRAP_CLAMP,
                                     .flags = flags};
  return e->host->gpu_table(e->out, &description, number);
}

static uint64_t level_texels(const exporting *e, uint32_t level) {
  return (uint64_t)e->s->layout.level_width[level] * e->s->layout.level_height[level];
}

static uint32_t cluster_of(const btfi_lpca_state *s, uint32_t level, uint64_t texel) {
  const unsigned char *index = s->index[level] + texel * s->layout.index_bytes;
  return s->layout.index_bytes == 1 ? index[0] : index[0] | (uint32_t)index[1] << 8;
}

static float value_at(uint32_t storage, const unsigned char *src, uint32_t i) {
  return storage == LPCA_F32 ? btf_get_f32(src + 4 * (size_t)i) : btf_half_at(src, i);
}

/* ---- what texels have ---- */

static btf_status put_clusters(exporting *e) {
  const btfi_lpca_layout *l = &e->s->layout;
  uint32_t number;
  BTF_TRY(table(e, "btf_cluster", l->index_bytes == 1 ? BTF_TEXEL_R8_UNORM : BTF_TEXEL_RG8_UNORM, l->width,
                l->height, 1, BTF_GPU_MATERIAL, &number));
  for (uint32_t level = 0; level < l->levels; level++)
    memcpy(e->host->gpu_slice(e->out, number, level, 0), e->s->index[level],
           level_texels(e, level) * l->index_bytes);
  return BTF_OK;
}

static btf_status put_coefficients(exporting *e) {
  const btfi_lpca_layout *l = &e->s->layout;
  const uint32_t value_bytes = l->weight_bytes;
  uint32_t number;
  BTF_TRY(table(e, "btf_coefficients", e->value_texel, l->width, l->height, e->groups,
                BTF_GPU_MATERIAL | BTF_GPU_SMOOTH, &number));
  for (uint32_t level = 0; level < l->levels; level++)
    for (uint32_t g = 0; g < e->groups; g++) {
      const uint32_t values = l->components - 4 * g < 4 ? l->components - 4 * g : 4;
      const unsigned char *src = e->s->weights[level] + 4 * (size_t)g * value_bytes;
      unsigned char *dst = e->host->gpu_slice(e->out, number, level, g);
      for (uint64_t i = 0; i < level_texels(e, level); i++)
        memcpy(dst + i * 4 * value_bytes, src + i * l->texel_bytes, (size_t)values * value_bytes);
    }
  return BTF_OK;
}

/* What a component or mean (j = 0) is multiplied by. Signed bytes come from a texture as 127ths. */
static float scale_of(const btfi_lpca_state *s, uint32_t cluster, uint32_t j) {
  const float *scale = s->scales + (size_t)cluster * (s->layout.padded + LPCA_LANES);
  if (j == 0) return scale[s->layout.padded];
  return scale[j - 1] * (s->layout.storage == LPCA_Q8 ? 127.0f : 1.0f);
}

/* A row for each cluster: the mean's, then those of groups of components. */
static btf_status put_scales(exporting *e) {
  const btfi_lpca_layout *l = &e->s->layout;
  uint32_t number;
  BTF_TRY(table(e, "btf_scale", BTF_TEXEL_RGBA32_FLOAT, e->groups + 1, l->clusters, 1, 0, &number));
  float *dst = e->host->gpu_slice(e->out, number, 0, 0);
  for (uint32_t k = 0; k < l->clusters; k++, dst += 4 * ((size_t)e->groups + 1))
    for (uint32_t j = 0; j <= l->components; j++) dst[j == 0 ? 0 : 3 + j] = scale_of(e->s, k, j);
  return BTF_OK;
}

/* ---- factors ---- */

/* Component j of a channel in a row, as the model has it or as a byte. */
static void put_component(exporting *e, uint32_t cluster, const unsigned char *row, uint32_t channel,
                          uint32_t j, unsigned char *dst) {
  const btfi_lpca_state *s = e->s;
  const btfi_lpca_layout *l = &s->layout;
  const unsigned char *src = row + channel * s->channel_bytes + (size_t)j * l->factor_bytes;
  if (e->layout == FULL || l->storage == LPCA_Q8) {
    memcpy(dst, src, l->factor_bytes);
    return;
  }
  const float value = value_at(l->storage, src, 0);
  const float bounded = value > -1.0f ? (value < 1.0f ? value : 1.0f) : -1.0f;
  float *rounding = &e->rounding[(size_t)cluster * l->components + j];
  const float difference = fabsf(btfi_lpca_store_factor(LPCA_Q8, bounded, dst) - value);
  if (difference > *rounding) *rounding = difference;
}

/* Images by light and view: the means of all channels, or components 4 * group and after of a channel. The
 * mean stays as it is: it is the largest summand, and no weight makes its rounding less. */
static void put_mean(exporting *e, uint32_t cluster, unsigned char *dst) {
  const btfi_lpca_layout *l = &e->s->layout;
  const unsigned char *src = e->s->factors + cluster * l->cluster_bytes + l->mean_at;
  for (uint64_t pair = 0; pair < (uint64_t)l->lights * l->views; pair++)
    memcpy(dst + pair * 4 * l->mean_bytes, src + pair * l->row_bytes, (size_t)e->shown * l->mean_bytes);
}

static void put_components(exporting *e, uint32_t cluster, uint32_t channel, uint32_t group,
                           unsigned char *dst) {
  const btfi_lpca_layout *l = &e->s->layout;
  const uint32_t size = e->layout == BYTES ? 1 : l->factor_bytes;
  const uint32_t first = 4 * group, left = l->components - first, values = left < 4 ? left : 4;
  const unsigned char *row = e->s->factors + cluster * l->cluster_bytes;
  for (uint64_t pair = 0; pair < (uint64_t)l->lights * l->views; pair++, row += l->row_bytes, dst += 4 * size)
    for (uint32_t i = 0; i < values; i++) put_component(e, cluster, row, channel, first + i, dst + i * size);
}

static btf_status put_means(exporting *e) {
  const btfi_lpca_layout *l = &e->s->layout;
  uint32_t number;
  BTF_TRY(table(e, "btf_mean", e->value_texel, l->lights, l->views, l->clusters,
                BTF_GPU_SMOOTH | (e->layout == BYTES ? BTF_GPU_STACK : 0u), &number));
  for (uint32_t k = 0; k < l->clusters; k++) put_mean(e, k, e->host->gpu_slice(e->out, number, 0, k));
  return BTF_OK;
}

/* All channels in one table of layers, or a stack for each. */
static btf_status put_factors(exporting *e) {
  const btfi_lpca_layout *l = &e->s->layout;
  const uint32_t together = e->layout == FULL ? e->shown : 1;
  for (uint32_t c = 0; c < e->shown; c += together) {
    char name[] = "btf_factors0";
    uint32_t number;
    name[sizeof name - 2] = (char)('0' + c);
    BTF_TRY(table(e, name, e->factor_texel, l->lights, l->views, l->clusters * together * e->groups,
                  BTF_GPU_SMOOTH | (e->layout == BYTES ? BTF_GPU_STACK : 0u), &number));
    for (uint32_t k = 0; k < l->clusters; k++)
      for (uint32_t i = 0; i < together; i++)
        for (uint32_t g = 0; g < e->groups; g++)
          put_components(e, k, c + i, g,
                         e->host->gpu_slice(e->out, number, 0, (k * together + i) * e->groups + g));
  }
  return BTF_OK;
}

static btf_status check_stacks(const exporting *e) {
  const btfi_lpca_layout *l = &e->s->layout;
  if (e->layout == FULL || l->clusters * e->groups <= e->target->max_3d) return BTF_OK;
  return e->host->fail(
      e->ctx, BTF_E_LIMIT,
      "lpca: %u clusters of %u components make stacks of %u slices, the target's 3D textures have "
      "%u; layout \"full\" would do",
      l->clusters, l->components, l->clusters * e->groups, e->target->max_3d);
}

/* ---- shader ---- */

/* The sums over the texels of one cluster, times its blended factors. */
static btf_status put_cluster_text(exporting *e) {
  const btf_host *host = e->host;
  const uint32_t together = e->layout == FULL ? e->shown : 1;
  BTF_TRY(host->gpu_source(
      e->out,
      "    vec3 mean = vec3(0.0);\n"
      "    for (int r = 0; r < 9; ++r)\n"
      "      mean += rw[r] * btf_mean(rows[r].x, rows[r].y, cluster, 0).rgb;\n"
      "    sum += total * btf_scale(0, cluster, 0, 0).r * mean;\n"
      "    for (int g = 0; g < %u; ++g) {\n"
      "      vec4 w = vec4(0.0);\n"
      "      for (int k = i; k < 8; ++k)\n"
      "        if (clusters[k] == cluster)\n"
      "          w += weights[k] * btf_coefficients(texels[k].x, texels[k].y, g, texels[k].z);\n"
      "      w *= btf_scale(g + 1, cluster, 0, 0);\n",
      e->groups));
  for (uint32_t c = 0; c < e->shown; c++)
    BTF_TRY(host->gpu_source(e->out,
                             "      for (int r = 0; r < 9; ++r)\n"
                             "        sum[%u] += rw[r] * dot(w, btf_factors%u(rows[r].x, rows[r].y, "
                             "(cluster * %u + %u) * %u + g, 0));\n",
                             c, e->layout == FULL ? 0 : c, together, e->layout == FULL ? c : 0, e->groups));
  return host->gpu_source(e->out, "    }\n");
}

static btf_status put_shader(exporting *e) {
  BTF_TRY(e->host->gpu_source(
      e->out,
      "vec3 btf_stored(vec3 light, vec3 view, vec2 uv, float lod) {\n"
      "  btf_place place = btf_place_of(uv, lod);\n"
      "  ivec3 l, v, texels[8];\n"
      "  ivec2 rows[9];\n"
      "  int clusters[8];\n"
      "  float weights[8], rw[9];\n"
      "  vec3 lw, vw, sum = vec3(0.0);\n"
      "  btf_locate_light(light, l, lw);\n"
      "  btf_locate_view(view, v, vw);\n"
      "  for (int r = 0; r < 9; ++r) {\n"
      "    rows[r] = ivec2(l[r %% 3], v[r / 3]);\n"
      "    rw[r] = lw[r %% 3] * vw[r / 3];\n"
      "  }\n"
      "  for (int i = 0; i < 8; ++i) {\n"
      "    texels[i] = btf_place_texel(place, i, weights[i]);\n"
      "    clusters[i] = -1;\n"
      "    if (!(weights[i] > 0.0)) continue;\n"
      "    ivec2 id = ivec2(btf_cluster(texels[i].x, texels[i].y, 0, texels[i].z).rg * 255.0 + 0.5);\n"
      "    clusters[i] = id.x + 256 * id.y;\n"
      "  }\n"
      "  for (int i = 0; i < 8; ++i) {\n"
      "    int cluster = clusters[i];\n"
      "    float total = 0.0;\n"
      "    if (cluster < 0) continue;\n"
      "    for (int k = i; k < 8; ++k)\n"
      "      if (clusters[k] == cluster) total += weights[k];\n"));
  BTF_TRY(put_cluster_text(e));
  return e->host->gpu_source(e->out, "    for (int k = i; k < 8; ++k)\n"
                                     "      if (clusters[k] == cluster) clusters[k] = -1;\n"
                                     "  }\n  return sum;\n}\n");
}

/* ---- the export ---- */

/* The most that rounded components make of any texel: a blend of texels, lights and views is no farther off.
 */
static double largest_rounding(const exporting *e) {
  const btfi_lpca_layout *l = &e->s->layout;
  double largest = 0.0;
  for (uint32_t level = 0; level < l->levels; level++)
    for (uint64_t i = 0; i < level_texels(e, level); i++) {
      const uint32_t cluster = cluster_of(e->s, level, i);
      const float *rounding = e->rounding + (size_t)cluster * l->components;
      const unsigned char *weights = e->s->weights[level] + i * l->texel_bytes;
      double sum = 0.0;
      for (uint32_t j = 0; j < l->components; j++)
        sum += fabs((double)value_at(l->storage, weights, j) * (double)scale_of(e->s, cluster, j + 1) *
                    (double)rounding[j]);
      largest = fmax(largest, sum);
    }
  return largest;
}

/* With four texels of one cluster. */
static void put_cost(exporting *e) {
  const btfi_lpca_layout *l = &e->s->layout;
  const double factors = 9.0 * e->shown * e->groups;
  const uint32_t factor_bytes = e->layout == BYTES ? 1 : l->factor_bytes;
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  cost.fetches = 4.0 * (1.0 + e->groups) + e->groups + 1.0 + 9.0 + factors;
  cost.bytes = 4.0 * (l->index_bytes + 4.0 * e->groups * l->weight_bytes) + 16.0 * (e->groups + 1.0) +
               4.0 * (9.0 * l->mean_bytes + factors * factor_bytes);
  cost.flops = 9.0 * factors + 54.0 + e->groups * 36.0;
  cost.rounding = largest_rounding(e);
  e->host->gpu_cost(e->out, &cost);
}

static btf_status put_all(exporting *e, const btf_model_shape *shape) {
  BTF_TRY(check_stacks(e));
  BTF_TRY(e->host->gpu_directions(e->out, "light", shape->lights));
  BTF_TRY(e->host->gpu_directions(e->out, "view", shape->views));
  BTF_TRY(put_clusters(e));
  BTF_TRY(put_coefficients(e));
  BTF_TRY(put_scales(e));
  BTF_TRY(put_means(e));
  BTF_TRY(put_factors(e));
  BTF_TRY(put_shader(e));
  put_cost(e);
  return BTF_OK;
}

btf_status btfi_lpca_gpu(const btf_host *host, btf_context *ctx, const void *state,
                         const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                         btf_gpu_builder *out) {
  const btfi_lpca_state *s = state;
  const btfi_lpca_layout *l = &s->layout;
  const uint64_t components = (uint64_t)l->clusters * l->components;
  exporting e = {.host = host, .ctx = ctx, .s = s, .out = out, .target = target, .layout = layout};
  e.shown = l->channels < 3 ? l->channels : 3;
  e.groups = (l->components + 3) / 4;
  e.value_texel = l->storage == LPCA_F32 ? BTF_TEXEL_RGBA32_FLOAT : BTF_TEXEL_RGBA16_FLOAT;
  e.factor_texel = layout == BYTES || l->storage == LPCA_Q8 ? (uint32_t)BTF_TEXEL_RGBA8_SNORM : e.value_texel;
  e.rounding = host->alloc(ctx, components, sizeof *e.rounding);
  if (e.rounding == NULL) return BTF_E_NOMEM;
  memset(e.rounding, 0, components * sizeof *e.rounding);
  const btf_status status = put_all(&e, shape);
  host->free(ctx, e.rounding);
  return status;
}
