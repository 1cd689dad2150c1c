/* SPDX-License-Identifier: MIT */
/* directions.c: the triangulation of a direction set in textures, and the walk that finds a direction's
 * samples and weights in it (Schwartz 2013, sect. 4). A map gives the facet at its texels' centres; from
 * there the shader goes on until its facet holds the direction, and computes the weights, so that the map's
 * size has no effect on values. */
#include "gpu/gpu.h"

#include <stdio.h>
#include <string.h>

#include "directions/directions.h"

enum { MAP = 256 /* texels along a side */, ROW = 256 /* facets in a row of their table */ };

/* Of a search that ends where it begins: the map, and three texels of the facet. */
static const btf_gpu_cost search = {
    .struct_size = sizeof search, .fetches = 4.0, .bytes = 4.0 + 3.0 * 16.0, .flops = 30.0};

static btf_status put_tables(btf_gpu_builder *b, const char *name, const btf_dirset *set) {
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
  return BTF_OK;
}

static void put_walk(btfi_buffer *out, const char *n) {
  btfi_put_text(out, "void btf_locate_%s(vec3 direction, out ivec3 index, out vec3 weight) {\n", n);
  btfi_put_text(out,
                "  vec2 p = btf_parabolic(direction);\n"
                "  ivec2 cell = clamp(ivec2((p * 0.5 + 0.5) * %d.0), ivec2(0), ivec2(%d));\n",
                MAP, MAP - 1);
  btfi_put_text(out, "  int facet = int(btf_%s_near(cell.x, cell.y, 0, 0).r + 0.5), x = 0, y = 0;\n", n);
  btfi_put_text(out,
                "  for (int walked = 0; walked < 64; ++walked) {\n"
                "    x = (facet & %d) * 4;\n"
                "    y = facet >> 8;\n",
                ROW - 1);
  btfi_put_text(out,
                "    vec4 first = btf_%s_facet(x, y, 0, 0), second = btf_%s_facet(x + 1, y, 0, 0);\n"
                "    vec2 q = p - first.xy;\n"
                "    float b = q.x * first.w - q.y * first.z, c = second.x * q.y - second.y * q.x;\n"
                "    weight.yz = vec2(b, c) * second.zw;\n"
                "    weight.x = 1.0 - weight.y - weight.z;\n"
                "    if (min(min(b, c), weight.x) >= -1e-5) break;\n",
                n, n);
  btfi_put_text(out,
                "    vec4 next = btf_%s_facet(x + 3, y, 0, 0);\n"
                "    facet = int((b < -1e-5 ? next.y : c < -1e-5 ? next.z : next.x) + 0.5);\n"
                "  }\n"
                "  weight = max(weight, vec3(0.0));\n"
                "  weight /= weight.x + weight.y + weight.z;\n"
                "  index = ivec3(btf_%s_facet(x + 2, y, 0, 0).xyz + 0.5);\n"
                "}\n",
                n, n);
}

btf_status btfi_gpu_directions(btf_gpu_builder *b, const char *name, const btf_dirset *set) {
  if (name == NULL || strlen(name) == 0 || strlen(name) > 24)
    return btfi_fail(b->ctx, BTF_E_PLUGIN, "GPU export: a direction set needs a name of 1 to 24 letters");
  btfi_gpu_cost(b, &search);
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
  BTFI_TRY(put_tables(b, name, set));
  put_walk(&b->search, name);
  b->set[b->set_count] = set;
  snprintf(b->set_name[b->set_count++], BTFI_GPU_NAME, "%s", name);
  return btfi_buffer_status(&b->search);
}
