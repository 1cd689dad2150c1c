/* SPDX-License-Identifier: MIT */
/* manifest.c: what is in an export, as JSON (docs/gpu-export.md). */
#include "gpu/gpu.h"

#include <string.h>

#include "dataset/manifest.h"

static const char *dimension_name(uint32_t dimension) {
  return dimension == BTF_TEXTURE_3D         ? "3d"
         : dimension == BTF_TEXTURE_CUBE     ? "cube"
         : dimension == BTF_TEXTURE_2D_ARRAY ? "2d_array"
                                             : "2d";
}

static void put_pair(btfi_buffer *b, const char *key, const char *value, const char *after) {
  btfi_json_put_string(b, key);
  btfi_put_text(b, ": ");
  btfi_json_put_string(b, value);
  btfi_put_text(b, "%s", after);
}

static void put_texture(btfi_buffer *b, const btf_gpu_texture *t) {
  const char *filter = t->min_filter == BTF_FILTER_LINEAR ? "linear" : "nearest";
  const char *wrap = t->wrap[0] == BTF_WRAP_CLAMP ? "clamp" : "repeat";
  btfi_put_text(b, "    {\"name\": \"%s\", \"file\": \"%s.ktx2\", \"dimension\": \"%s\", \"vk_format\": %u,",
                t->name, t->name, dimension_name(t->dimension), (unsigned)t->texel);
  btfi_put_text(b, " \"width\": %u, \"height\": %u, \"depth\": %u, \"layers\": %u, \"levels\": %u,",
                (unsigned)t->width, (unsigned)t->height, (unsigned)t->depth, (unsigned)t->layers,
                (unsigned)t->level_count);
  btfi_put_text(b, " \"min_filter\": \"%s\", \"mag_filter\": \"%s\", \"wrap\": [\"%s\", \"%s\", \"clamp\"],",
                filter, filter, wrap, wrap);
  if (t->psnr_db != 0.0) btfi_put_text(b, " \"psnr_db\": %.4g,", t->psnr_db);
  btfi_put_text(b, " \"binding\": %u}", (unsigned)t->binding);
}

static void put_textures(btfi_buffer *b, const btf_gpu_export *e) {
  const uint32_t count = btf_gpu_texture_count(e);
  btfi_put_text(b, "  \"textures\": [\n");
  for (uint32_t i = 0; i < count; i++) {
    btf_gpu_texture t = BTF_GPU_TEXTURE_INIT;
    if (btf_gpu_texture_at(e, i, &t) != BTF_OK) continue;
    put_texture(b, &t);
    btfi_put_text(b, i + 1 < count ? ",\n" : "\n");
  }
  btfi_put_text(b, "  ],\n");
}

static void put_number(btfi_buffer *b, const unsigned char *bytes, bool is_integer) {
  float real;
  int32_t whole;
  memcpy(&real, bytes, sizeof real);
  memcpy(&whole, bytes, sizeof whole);
  if (is_integer)
    btfi_put_text(b, "%d", (int)whole);
  else
    btfi_put_text(b, "%.9g", (double)real);
}

static void put_uniform(btfi_buffer *b, const btf_gpu_uniform *u, const unsigned char *block) {
  static const struct {
    uint32_t type, components;
    bool is_integer;
    const char *name;
  } types[] = {{BTF_UNIFORM_FLOAT, 1, false, "float"}, {BTF_UNIFORM_VEC2, 2, false, "vec2"},
               {BTF_UNIFORM_VEC3, 3, false, "vec3"},   {BTF_UNIFORM_VEC4, 4, false, "vec4"},
               {BTF_UNIFORM_INT, 1, true, "int"},      {BTF_UNIFORM_IVEC4, 4, true, "ivec4"}};
  for (size_t k = 0; k < sizeof types / sizeof *types; k++) {
    if (types[k].type != u->type) continue;
    btfi_put_text(b, "    {\"name\": \"%s\", \"type\": \"%s\", \"offset\": %u, \"count\": %u, \"value\": [",
                  u->name, types[k].name, (unsigned)u->offset, (unsigned)u->count);
    for (uint32_t i = 0; i < u->count * types[k].components; i++) {
      const uint32_t element = i / types[k].components, component = i % types[k].components;
      btfi_put_text(b, i > 0 ? ", " : "");
      put_number(b, block + u->offset + element * 16 + component * 4, types[k].is_integer);
    }
    btfi_put_text(b, "]}");
  }
}

void btfi_gpu_put_manifest(const btf_gpu_export *e, const btf_model_info *model, const char *layout,
                           btfi_buffer *b) {
  const btf_gpu_builder *built = e->built;
  btfi_put_text(b, "{\n  \"format\": \"" BTFI_EXPORT_FORMAT "\",\n  \"version\": 1,\n  ");
  put_pair(b, "codec", model->codec_id, ",\n  ");
  put_pair(b, "layout", layout, ",\n  ");
  if (model->name != NULL) put_pair(b, "name", model->name, ",\n  ");
  btfi_put_text(b, "\"width\": %u,\n  \"height\": %u,\n  \"levels\": %u,\n  ", (unsigned)model->width,
                (unsigned)model->height, (unsigned)model->levels);
  btfi_put_text(b, "\"channels\": %u,\n  \"exported_channels\": %u,\n  ", (unsigned)model->channels,
                (unsigned)BTFI_MIN(model->channels, 3u));
  put_pair(b, "quantity", model->quantity == BTF_QUANTITY_BRDF_COS ? "brdf_cos" : "brdf", ",\n  ");
  put_pair(b, "scale", model->scale == BTF_SCALE_ABSOLUTE ? "absolute" : "relative", ",\n  ");
  put_pair(b, "wrap", model->wrap == BTF_WRAP_CLAMP ? "clamp" : "repeat", ",\n  ");
  if (model->color_space != NULL && model->color_space[0] != '\0')
    put_pair(b, "color_space", model->color_space, ",\n  ");
  put_pair(b, "shader", "btf.glsl", ",\n");
  btfi_put_text(b, "  \"cost\": {\"fetches\": %.9g, \"bytes\": %.9g, \"flops\": %.9g, \"rounding\": %.9g,\n",
                built->cost.fetches, built->cost.bytes, built->cost.flops, built->cost.rounding);
  btfi_put_text(b, "    \"texture_bytes\": %.15g", built->cost.texture_bytes);
  if (built->cost.psnr_db != 0.0)
    btfi_put_text(b, ", \"saved_bytes\": %.15g, \"psnr_db\": %.4g", built->cost.saved_bytes,
                  built->cost.psnr_db);
  btfi_put_text(b, "},\n");
  put_textures(b, e);
  btfi_put_text(b, "  \"uniform_block\": {\"name\": \"btf_uniforms\", \"binding\": 0, \"size\": %u},\n",
                (unsigned)((built->block_size + 15) & ~15u));
  btfi_put_text(b, "  \"uniforms\": [\n");
  for (uint32_t i = 0; i < built->uniform_count; i++) {
    put_uniform(b, &built->uniform[i], built->block);
    btfi_put_text(b, i + 1 < built->uniform_count ? ",\n" : "\n");
  }
  btfi_put_text(b, "  ]\n}\n");
}
