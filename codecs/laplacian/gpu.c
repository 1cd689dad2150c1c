/* SPDX-License-Identifier: MIT */
/* gpu.c: equation 7 in a shader, from the paper's two maps or from arrays of what the tables hold. Bands
 * finer than the level of detail are not read (section 3.4). */
#include "laplacian.h"

enum { MAPS, ARRAYS };

static const btf_gpu_layout_desc maps = {
    "maps", "the paper's two textures of 32-bit floats: eigen map, and weight map of all levels"};
static const btf_gpu_layout_desc arrays = {
    "arrays",
    "eigen-ABRDFs and weights in layers, as the model stores them; halves are filtered by the sampler"};
const btf_gpu_layout_desc *const btfi_laplacian_gpu_layouts[] = {&maps, &arrays, NULL};

typedef struct exporting {
  const btf_host *host;
  btf_context *ctx;
  const btfi_laplacian_state *s;
  btf_gpu_builder *b;
  btfi_laplacian_packing packing;
  uint32_t layout;
  uint32_t first_plane[LAPLACIAN_MAX_LEVELS]; /* of a level among the planes of all */
  uint32_t all_planes;
  bool filtered; /* weights by the sampler */
} exporting;

static bool reads_nearest(const exporting *e) {
  return e->s->grid.filter == LAPLACIAN_PAPER_FILTER;
}

/* ---- the paper's maps ---- */

static btf_status put_maps(const exporting *e, const btf_gpu_target *target) {
  const btfi_laplacian_packing *p = &e->packing;
  btf_gpu_table table = {.struct_size = sizeof table,
                         .name = "btf_eigen",
                         .texel = BTF_TEXEL_RGBA32_FLOAT,
                         .slices = 1,
                         .levels = 1,
                         .wrap = BTF_WRAP_CLAMP};
  float *layers[LAPLACIAN_MAX_LAYERS];
  uint32_t eigen, weights;
  const uint64_t width = (uint64_t)p->planes * p->lights, height = (uint64_t)p->levels * p->views;
  if (width > target->max_2d || height > target->max_2d || p->width > target->max_2d ||
      p->height > target->max_2d)
    return e->host->fail(
        e->ctx, BTF_E_LIMIT,
        "laplacian: maps of %llu x %llu and %u x %u texels are more than the target's %u along "
        "a side; the layout \"%s\" would do",
        (unsigned long long)width, (unsigned long long)height, p->width, p->height, target->max_2d,
        arrays.name);
  table.width = (uint32_t)width;
  table.height = (uint32_t)height;
  BTF_TRY(e->host->gpu_table(e->b, &table, &eigen));
  table.name = "btf_weights";
  table.width = p->width;
  table.height = p->height;
  table.slices = p->layers;
  table.flags = BTF_GPU_SMOOTH;
  BTF_TRY(e->host->gpu_table(e->b, &table, &weights));
  for (uint32_t i = 0; i < p->layers; i++) layers[i] = e->host->gpu_slice(e->b, weights, 0, i);
  btfi_laplacian_pack(e->s, p, e->host->gpu_slice(e->b, eigen, 0, 0), layers);
  return BTF_OK;
}

/* ---- arrays ---- */

/* Every fourth value of a layer, from values `stride` bytes apart. */
static void put_values(unsigned char *layer, uint32_t part, uint32_t bytes, const unsigned char *src,
                       uint64_t stride, uint64_t count) {
  layer += (uint64_t)part * bytes;
  for (uint64_t i = 0; i < count; i++) memcpy(layer + i * 4 * bytes, src + i * stride, bytes);
}

static void put_component(const exporting *e, uint32_t eigen, uint32_t weights, uint32_t k, uint32_t c,
                          uint32_t j, uint32_t value) {
  const btfi_laplacian_layout *l = &e->s->layout;
  uint32_t plane, part;
  btfi_laplacian_component_place(&e->packing, k, c, j, &plane, &part);
  put_values(e->host->gpu_slice(e->b, eigen, 0, e->first_plane[k] + plane), part, l->value_bytes,
             e->s->eigen + (uint64_t)(l->first[k] + value) * l->value_bytes, l->row_bytes,
             (uint64_t)l->lights * l->views);
  put_values(e->host->gpu_slice(e->b, weights, k, plane), part, l->value_bytes,
             e->s->weights[k] + (uint64_t)value * l->value_bytes, l->texel_bytes[k],
             (uint64_t)e->s->grid.width[k] * e->s->grid.height[k]);
}

static btf_status put_scales(const exporting *e) {
  const btfi_laplacian_state *s = e->s;
  const uint32_t count = e->all_planes > 1 ? e->all_planes : 2; /* which makes it an array */
  float *scale = e->host->alloc(e->ctx, count, 4 * sizeof *scale);
  if (scale == NULL) return BTF_E_NOMEM;
  memset(scale, 0, count * 4 * sizeof *scale);
  for (uint32_t k = 0; k < s->head.levels; k++)
    for (uint32_t c = 0, at = s->layout.first[k]; c < LAPLACIAN_CHANNELS; c++)
      for (uint32_t j = 0; j < s->head.count[k][c]; j++, at++) {
        uint32_t plane, part;
        btfi_laplacian_component_place(&e->packing, k, c, j, &plane, &part);
        scale[4 * (size_t)(e->first_plane[k] + plane) + part] = s->scale[(size_t)c * s->scale_stride + at];
      }
  const btf_status status = e->host->gpu_uniform(e->b, "btf_scale", BTF_UNIFORM_VEC4, count, scale);
  e->host->free(e->ctx, scale);
  return status;
}

static btf_status put_arrays(const exporting *e) {
  const btfi_laplacian_state *s = e->s;
  btf_gpu_table table = {.struct_size = sizeof table,
                         .name = "btf_eigen",
                         .texel = s->head.storage == LAPLACIAN_F32 ? BTF_TEXEL_RGBA32_FLOAT
                                                                   : BTF_TEXEL_RGBA16_FLOAT,
                         .width = s->layout.lights,
                         .height = s->layout.views,
                         .slices = e->all_planes > 0 ? e->all_planes : 1,
                         .levels = 1,
                         .wrap = BTF_WRAP_CLAMP};
  uint32_t eigen, weights;
  BTF_TRY(e->host->gpu_table(e->b, &table, &eigen));
  table.name = "btf_weights";
  table.width = s->grid.width[0];
  table.height = s->grid.height[0];
  table.slices = e->packing.planes;
  table.levels = s->grid.levels;
  table.wrap = s->grid.wrap;
  table.flags = BTF_GPU_SMOOTH | (e->filtered ? BTF_GPU_FILTERED : 0u);
  BTF_TRY(e->host->gpu_table(e->b, &table, &weights));
  for (uint32_t k = 0; k < s->head.levels; k++)
    for (uint32_t c = 0, value = 0; c < LAPLACIAN_CHANNELS; c++)
      for (uint32_t j = 0; j < s->head.count[k][c]; j++, value++)
        put_component(e, eigen, weights, k, c, j, value);
  return put_scales(e);
}

/* ---- the shader ---- */

/* x, y: where a level begins in the weight map, or its first layer of eigen-ABRDFs; then planes of luma and
 * of chroma. */
static btf_status put_bands(const exporting *e) {
  const btfi_laplacian_packing *p = &e->packing;
  int32_t band[LAPLACIAN_MAX_LEVELS][4] = {{0}};
  for (uint32_t k = 0; k < p->levels; k++) {
    band[k][0] = (int32_t)(e->layout == MAPS ? p->column[k] : e->first_plane[k]);
    band[k][1] = (int32_t)(e->layout == MAPS ? p->line[k] : 0);
    band[k][2] = (int32_t)p->luma[k];
    band[k][3] = (int32_t)p->chroma[k];
  }
  /* Two at least, which makes it an array. */
  return e->host->gpu_uniform(e->b, "btf_band", BTF_UNIFORM_IVEC4, p->levels > 1 ? p->levels : 2, band);
}

static btf_status put_mean(const exporting *e) {
  const btfi_laplacian_head *head = &e->s->head;
  const float mean[4] = {(float)head->phong.ka, (float)head->phong.kd, (float)head->phong.ks,
                         (float)head->phong.alpha};
  const float chroma[2] = {(float)head->chroma[0], (float)head->chroma[1]};
  if (head->mean != LAPLACIAN_PHONG)
    return e->host->gpu_source(e->b, "vec3 btf_mean_of(vec3 light, vec3 view) { return vec3(0.0); }\n");
  BTF_TRY(e->host->gpu_uniform(e->b, "btf_mean", BTF_UNIFORM_VEC4, 1, mean));
  BTF_TRY(e->host->gpu_uniform(e->b, "btf_mean_chroma", BTF_UNIFORM_VEC2, 1, chroma));
  return e->host->gpu_source(
      e->b, "vec3 btf_mean_of(vec3 light, vec3 view) {\n"
            "  float along = clamp((light.z + view.z) / length(light + view), 0.0, 1.0);\n"
            "  return vec3(btf_mean.x + btf_mean.y * light.z + btf_mean.z * btf_power(along, btf_mean.w),\n"
            "              btf_mean_chroma);\n"
            "}\n");
}

/* The eigen-ABRDF of a plane for one pair of samples, and its weights, by layout. */
static btf_status put_readers(const exporting *e) {
  const btfi_laplacian_packing *p = &e->packing;
  if (e->layout == MAPS) {
    BTF_TRY(e->host->gpu_source(e->b,
                                "vec4 btf_eigen_of(int light, int view, int plane, int level) {\n"
                                "  return btf_eigen(plane * %u + light, level * %u + view, 0, 0);\n"
                                "}\n",
                                p->lights, p->views));
    return e->host->gpu_source(
        e->b,
        "vec4 btf_weights_of(ivec2 x, ivec2 y, vec4 share, int plane, int level) {\n"
        "  int layer = plane / 3, quadrant = plane - 3 * layer;\n"
        "  ivec2 size = btf_level_size(level);\n"
        "  x += btf_band[level].x + (quadrant == 1 ? size.x : 0);\n"
        "  y += btf_band[level].y + (quadrant == 2 ? size.y : 0);\n"
        "  return share.x * btf_weights(x.x, y.x, layer, 0) + share.y * btf_weights(x.y, y.x, layer, 0) +\n"
        "         share.z * btf_weights(x.x, y.y, layer, 0) + share.w * btf_weights(x.y, y.y, layer, 0);\n"
        "}\n");
  }
  BTF_TRY(e->host->gpu_source(e->b, "vec4 btf_eigen_of(int light, int view, int plane, int level) {\n"
                                    "  return btf_eigen(light, view, btf_band[level].x + plane, 0);\n"
                                    "}\n"));
  if (e->filtered) return BTF_OK;
  return e->host->gpu_source(e->b,
                             "vec4 btf_weights_of(ivec2 x, ivec2 y, vec4 share, int plane, int level) {\n"
                             "  vec4 sum = share.x * btf_weights(x.x, y.x, plane, level) +\n"
                             "             share.y * btf_weights(x.y, y.x, plane, level) +\n"
                             "             share.z * btf_weights(x.x, y.y, plane, level) +\n"
                             "             share.w * btf_weights(x.y, y.y, plane, level);\n"
                             "  return sum * btf_scale[btf_band[level].x + plane];\n"
                             "}\n");
}

/* The texels of band k around the position, as btfi_laplacian_taps finds them. */
static const char *taps_of(const exporting *e) {
  if (e->filtered) return "";
  if (!reads_nearest(e))
    return "    ivec2 x, y;\n"
           "    vec4 share;\n"
           "    btf_texels(uv, k, x, y, share);\n";
  return "    ivec2 size = btf_level_size(k);\n"
         "    ivec2 x = (2 * finest_x + 1) * size.x / (2 * finest.x);\n"
         "    ivec2 y = (2 * finest_y + 1) * size.y / (2 * finest.y);\n";
}

static btf_status put_shader(const exporting *e) {
  BTF_TRY(put_readers(e));
  BTF_TRY(e->host->gpu_source(e->b, "vec3 btf_stored(vec3 light, vec3 view, vec2 uv, float lod) {\n"
                                    "  ivec3 l, v;\n"
                                    "  vec3 lw, vw;\n"
                                    "  ivec2 levels;\n"
                                    "  vec2 shares;\n"
                                    "  vec3 sum = btf_mean_of(light, view);\n"
                                    "  btf_locate_light(light, l, lw);\n"
                                    "  btf_locate_view(view, v, vw);\n"
                                    "  btf_levels(lod, levels, shares);\n"));
  if (reads_nearest(e))
    BTF_TRY(e->host->gpu_source(e->b, "  ivec2 finest = btf_level_size(0), finest_x, finest_y;\n"
                                      "  vec4 share;\n"
                                      "  btf_texels(uv, 0, finest_x, finest_y, share);\n"));
  BTF_TRY(e->host->gpu_source(e->b,
                              "  for (int k = levels.x; k < %u; ++k) {\n"
                              "    vec3 band = vec3(0.0);\n"
                              "    int luma = btf_band[k].z, planes = luma + btf_band[k].w;\n%s",
                              e->packing.levels, taps_of(e)));
  BTF_TRY(e->host->gpu_source(e->b,
                              "    for (int plane = 0; plane < planes; ++plane) {\n"
                              "      vec4 eigen = vec4(0.0), weights = %s;\n"
                              "      for (int j = 0; j < 3; ++j)\n"
                              "        eigen += vw[j] * (lw.x * btf_eigen_of(l.x, v[j], plane, k) +\n"
                              "                          lw.y * btf_eigen_of(l.y, v[j], plane, k) +\n"
                              "                          lw.z * btf_eigen_of(l.z, v[j], plane, k));\n",
                              e->filtered
                                  ? "btf_weights_at(uv, plane, float(k)) * btf_scale[btf_band[k].x + plane]"
                                  : "btf_weights_of(x, y, share, plane, k)"));
  return e->host->gpu_source(
      e->b, "      if (plane < luma)\n"
            "        band.x += dot(eigen, weights);\n"
            "      else\n"
            "        band.yz += vec2(dot(eigen.xy, weights.xy), dot(eigen.zw, weights.zw));\n"
            "    }\n"
            "    sum += k == levels.x ? shares.x * band : band;\n"
            "  }\n"
            "  return vec3(sum.x + 1.402 * sum.z, sum.x - 0.344136286 * sum.y - 0.714136286 * sum.z,\n"
            "              sum.x + 1.772 * sum.y);\n"
            "}\n");
}

btf_status btfi_laplacian_gpu(const btf_host *host, btf_context *ctx, const void *state,
                              const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                              btf_gpu_builder *out) {
  exporting e = {.host = host, .ctx = ctx, .s = state, .b = out, .layout = layout};
  const btfi_laplacian_layout *l = &e.s->layout;
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  btfi_laplacian_packing_of(&e.s->head, &e.s->grid, l->lights, l->views, &e.packing);
  for (uint32_t k = 0; k < e.packing.levels; k++) {
    e.first_plane[k] = e.all_planes;
    e.all_planes += e.packing.luma[k] + e.packing.chroma[k];
  }
  /* Samplers of plain WebGL 2 filter halves but not floats. */
  e.filtered = layout == ARRAYS && e.s->head.storage == LAPLACIAN_F16 && !reads_nearest(&e);
  BTF_TRY(layout == MAPS ? put_maps(&e, target) : put_arrays(&e));
  BTF_TRY(host->gpu_directions(out, "light", shape->lights));
  BTF_TRY(host->gpu_directions(out, "view", shape->views));
  BTF_TRY(put_bands(&e));
  BTF_TRY(put_mean(&e));
  BTF_TRY(put_shader(&e));
  /* Of the finest level, which reads all bands. */
  cost.fetches = e.all_planes * (9.0 + (e.filtered ? 1.0 : 4.0));
  cost.bytes = e.all_planes * 13.0 * 4.0 * (layout == MAPS ? 4.0 : l->value_bytes);
  cost.flops = e.all_planes * (9.0 * 8.0 + 6.0 * 4.0 + (e.filtered ? 8.0 : 28.0) + 8.0) + 60.0;
  host->gpu_cost(out, &cost);
  return BTF_OK;
}
