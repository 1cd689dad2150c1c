/* SPDX-License-Identifier: MIT */
/* directions.c: the triangulation of a direction set in textures (Schwartz 2013, sect. 4), in two ways. As
 * facets: a map gives the facet at its texels' centres; from there the shader goes on until its facet holds
 * the direction, and computes the weights, so that the map's size has no effect on values. Or as the paper
 * has it: the three samples and the three weights at the centres of a map's texels. */
#include "gpu/gpu.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <btf/btf_half.h>

#include "directions/directions.h"

enum {
  MAP = 256,    /* texels along a side of the map of facets */
  RASTER = 512, /* and of those of samples and weights */
  ROW = 256     /* facets in a row of their table */
};

/* ---- as facets ---- */

/* Of a search that ends where it begins: the map, and three texels of the facet. */
static const btf_gpu_cost search = {
    .struct_size = sizeof search, .fetches = 4.0, .bytes = 4.0 + 3.0 * 16.0, .flops = 36.0};

/* The slack keeps a point that rounding puts outside of both facets of an edge from going to and fro. The
 * corner is exact, so that what q is rounded by is a share of it: 2^-25. With the rounded forms, products and
 * sums, distances are off by 6 * 2^-25 of |q.x| + |q.y|, the third weight, in distances, by as much again;
 * nothing is lost where the facets around the point are small. A walk that does not end all the same is
 * followed by a search everywhere, as in locate.c; what fills up the last row holds everything, and names
 * sample 0. */
static void put_walk(btfi_buffer *out, const char *n) {
  btfi_put_text(out, "void btf_locate_%s(vec3 direction, out ivec3 index, out vec3 weight) {\n", n);
  btfi_put_text(out,
                "  vec2 p = btf_parabolic(direction);\n"
                "  ivec2 cell = clamp(ivec2((p * 0.5 + 0.5) * %d.0), ivec2(0), ivec2(%d));\n",
                MAP, MAP - 1);
  btfi_put_text(out, "  int facet = int(btf_%s_near(cell.x, cell.y, 0, 0).r + 0.5), x = 0, y = 0;\n", n);
  btfi_put_text(out,
                "  ivec2 size = textureSize(btf_%s_facet_map, 0);\n"
                "  int facets = size.x / 4 * size.y;\n"
                "  for (int walked = 0; walked < 2 * facets; ++walked) {\n"
                "    if (walked >= facets) facet = walked - facets;\n"
                "    x = (facet & %d) * 4;\n"
                "    y = facet >> 8;\n",
                n, ROW - 1);
  btfi_put_text(out,
                "    vec4 first = btf_%s_facet(x, y, 0, 0), second = btf_%s_facet(x + 1, y, 0, 0);\n"
                "    vec2 q = p - first.xy;\n"
                "    float b = q.x * first.w - q.y * first.z, c = second.x * q.y - second.y * q.x;\n"
                "    float slack = -4e-7 * (abs(q.x) + abs(q.y));\n"
                "    weight.yz = vec2(b, c) * second.zw;\n"
                "    weight.x = 1.0 - weight.y - weight.z;\n"
                "    if (min(b, c) >= slack && weight.x >= slack * (second.z + second.w)) break;\n",
                n, n);
  btfi_put_text(out,
                "    vec4 next = btf_%s_facet(x + 3, y, 0, 0);\n"
                "    facet = int((b < slack ? next.y : c < slack ? next.z : next.x) + 0.5);\n"
                "  }\n"
                "  weight = max(weight, vec3(0.0));\n"
                "  weight /= weight.x + weight.y + weight.z;\n"
                "  index = ivec3(btf_%s_facet(x + 2, y, 0, 0).xyz + 0.5);\n"
                "}\n",
                n, n);
}

static btf_status put_facets(btf_gpu_builder *b, const char *name, const btf_dirset *set) {
  char table_name[BTFI_GPU_NAME];
  const uint32_t facets = btfi_dirset_facet_count(set);
  uint32_t number;
  snprintf(table_name, sizeof table_name, "btf_%s_facet", name);
  btf_gpu_table table = {.struct_size = sizeof table,
                         .name = table_name,
                         .texel = BTF_TEXEL_RGBA32_FLOAT,
                         .width = 4 * BTFI_MIN(facets, (uint32_t)ROW),
                         .height = (facets + ROW - 1) / ROW,
                         .slices = 1,
                         .levels = 1,
                         .wrap = BTF_WRAP_CLAMP};
  BTFI_TRY(btfi_gpu_table(b, &table, &number));
  btfi_dirset_facet_table(set, btfi_gpu_slice(b, number, 0, 0));
  snprintf(table_name, sizeof table_name, "btf_%s_near", name);
  table.texel = BTF_TEXEL_R32_FLOAT;
  table.width = table.height = MAP;
  BTFI_TRY(btfi_gpu_table(b, &table, &number));
  btfi_dirset_facet_map(set, MAP, btfi_gpu_slice(b, number, 0, 0));
  put_walk(&b->search, name);
  return BTF_OK;
}

/* ---- as rasters ---- */

/* Numbers of samples are whole bytes where these are enough. */
static uint32_t samples_texel(const btf_dirset *set) {
  return btf_dirset_count(set) <= 256 ? BTF_TEXEL_RGBA8_UNORM : BTF_TEXEL_RGBA32_FLOAT;
}

static void put_samples(const btf_interp *at, uint32_t texel, void *dst) {
  unsigned char *bytes = dst;
  float *floats = dst;
  for (size_t i = 0; i < (size_t)RASTER * RASTER; i++)
    for (size_t k = 0; k < 3; k++)
      if (texel == BTF_TEXEL_RGBA8_UNORM)
        bytes[4 * i + k] = (unsigned char)at[i].index[k];
      else
        floats[4 * i + k] = (float)at[i].index[k];
}

static void put_weights(const btf_interp *at, uint16_t *dst) {
  for (size_t i = 0; i < (size_t)RASTER * RASTER; i++)
    for (size_t k = 0; k < 3; k++) dst[4 * i + k] = btf_float_to_half(at[i].weight[k]);
}

static btf_status put_raster(btf_gpu_builder *b, const char *name, const btf_dirset *set,
                             const btf_interp *at) {
  char table_name[BTFI_GPU_NAME];
  uint32_t number;
  snprintf(table_name, sizeof table_name, "btf_%s_samples", name);
  btf_gpu_table table = {.struct_size = sizeof table,
                         .name = table_name,
                         .texel = samples_texel(set),
                         .width = RASTER,
                         .height = RASTER,
                         .slices = 1,
                         .levels = 1,
                         .wrap = BTF_WRAP_CLAMP};
  BTFI_TRY(btfi_gpu_table(b, &table, &number));
  put_samples(at, table.texel, btfi_gpu_slice(b, number, 0, 0));
  snprintf(table_name, sizeof table_name, "btf_%s_weights", name);
  table.texel = BTF_TEXEL_RGBA16_FLOAT;
  BTFI_TRY(btfi_gpu_table(b, &table, &number));
  put_weights(at, btfi_gpu_slice(b, number, 0, 0));
  btfi_put_text(&b->search,
                "void btf_locate_%s(vec3 direction, out ivec3 index, out vec3 weight) {\n"
                "  vec2 p = btf_parabolic(direction);\n"
                "  ivec2 cell = clamp(ivec2((p * 0.5 + 0.5) * %d.0), ivec2(0), ivec2(%d));\n"
                "  index = ivec3(btf_%s_samples(cell.x, cell.y, 0, 0).xyz%s + 0.5);\n"
                "  weight = btf_%s_weights(cell.x, cell.y, 0, 0).xyz;\n"
                "  weight /= weight.x + weight.y + weight.z;\n"
                "}\n",
                name, RASTER, RASTER - 1, name, samples_texel(set) == BTF_TEXEL_RGBA8_UNORM ? " * 255.0" : "",
                name);
  return BTF_OK;
}

static btf_status put_raster_tables(btf_gpu_builder *b, const char *name, const btf_dirset *set) {
  if (b->target.max_2d < RASTER)
    return btfi_fail(b->ctx, BTF_E_LIMIT,
                     "GPU export: maps of directions have %d texels along a side, more than the target's %u; "
                     "a layout that computes weights would do",
                     RASTER, (unsigned)b->target.max_2d);
  btf_interp *at = btfi_alloc(b->ctx, (uint64_t)RASTER * RASTER, sizeof *at);
  if (at == NULL) return btfi_alloc_status();
  btfi_dirset_rasterise(set, RASTER, at);
  const btf_status status = put_raster(b, name, set, at);
  btfi_free(b->ctx, at);
  return status;
}

/* How fast a weight of a facet changes at most, per unit of parabolic coordinates. Forms that tell only a
 * side have no weight (facet_table.c). */
static double steepest(const float *facet) {
  const double second[2] = {(double)facet[6] * (double)facet[3], -(double)facet[6] * (double)facet[2]};
  const double third[2] = {-(double)facet[7] * (double)facet[5], (double)facet[7] * (double)facet[4]};
  const double first = hypot(second[0] + third[0], second[1] + third[1]);
  return fmax(first, fmax(hypot(second[0], second[1]), hypot(third[0], third[1])));
}

/* The most weight that a raster gives to other samples than it should. Weights sum to 1, so that of what they
 * change by along a line within a facet as much is added as taken away, at most the steepest slope times the
 * length; a texel's centre is no farther than half its diagonal, and a centre outside the disc is moved
 * nearer. Halves change a weight by 2^-11 of it at most, and what they sum to by no more: 2^-10 of all weight
 * is added or taken away, half of it each. */
static btf_status find_shift(btf_gpu_builder *b, const btf_dirset *set, double *shift) {
  const uint32_t facets = btfi_dirset_facet_count(set);
  float *table = btfi_alloc(b->ctx, facets, BTFI_FACET_FLOATS * sizeof *table);
  double slope = 0.0;
  if (table == NULL) return btfi_alloc_status();
  btfi_dirset_facet_table(set, table);
  for (uint32_t i = 0; i < facets; i++) slope = fmax(slope, steepest(table + (size_t)i * BTFI_FACET_FLOATS));
  btfi_free(b->ctx, table);
  /* A thousandth for the rounding of floats in either computation. */
  *shift = fmin(1.0, 1.001 * (slope * sqrt(2.0) / RASTER + 1.0 / 2048));
  return BTF_OK;
}

/* ---- both ---- */

typedef btf_status (*put_tables_fn)(btf_gpu_builder *b, const char *name, const btf_dirset *set);

static btf_status put_set(btf_gpu_builder *b, const char *name, const btf_dirset *set, put_tables_fn put) {
  if (name == NULL || strlen(name) == 0 || strlen(name) > 24)
    return btfi_fail(b->ctx, BTF_E_PLUGIN, "GPU export: a direction set needs a name of 1 to 24 letters");
  for (uint32_t i = 0; i < b->set_count; i++) {
    if (!btfi_dirset_equal(b->set[i], set)) continue;
    btfi_put_text(&b->search,
                  "void btf_locate_%s(vec3 direction, out ivec3 index, out vec3 weight) {\n"
                  "  btf_locate_%s(direction, index, weight);\n"
                  "}\n",
                  name, b->set_name[i]);
    return btfi_buffer_status(&b->search);
  }
  if (b->set_count == sizeof b->set / sizeof *b->set)
    return btfi_fail(b->ctx, BTF_E_PLUGIN, "GPU export: more than two direction sets");
  BTFI_TRY(put(b, name, set));
  b->set[b->set_count] = set;
  snprintf(b->set_name[b->set_count++], BTFI_GPU_NAME, "%s", name);
  return btfi_buffer_status(&b->search);
}

btf_status btfi_gpu_directions(btf_gpu_builder *b, const char *name, const btf_dirset *set) {
  btfi_gpu_cost(b, &search);
  return put_set(b, name, set, put_facets);
}

btf_status btfi_gpu_direction_maps(btf_gpu_builder *b, const char *name, const btf_dirset *set,
                                   double *shift) {
  btf_gpu_cost look_up = {.struct_size = sizeof look_up, .fetches = 2.0, .bytes = 8.0, .flops = 15.0};
  look_up.bytes += samples_texel(set) == BTF_TEXEL_RGBA8_UNORM ? 4.0 : 16.0;
  btfi_gpu_cost(b, &look_up);
  BTFI_TRY(find_shift(b, set, shift));
  return put_set(b, name, set, put_raster_tables);
}
