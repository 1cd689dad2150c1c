/* SPDX-License-Identifier: MIT */
/* accessors.c: the shader's functions that read tables: page by page, and out of what compression made of
 * them. */
#include "gpu/gpu.h"

#include <stdio.h>

/* The texel of a page by numbers, or around a position by the sampler. */
static void put_read(btfi_buffer *out, const btfi_gpu_texture *texture, bool filtered, const char *slice) {
  const char *t = texture->name;
  if (!filtered) {
    if (texture->dimension == BTF_TEXTURE_2D)
      btfi_put_text(out, "return texelFetch(%s, ivec2(x, y), level);\n", t);
    else
      btfi_put_text(out, "return texelFetch(%s, ivec3(x, y, %s), level);\n", t, slice);
  } else if (texture->dimension == BTF_TEXTURE_2D) {
    btfi_put_text(out, "return textureLod(%s, uv, lod);\n", t);
  } else if (texture->dimension == BTF_TEXTURE_2D_ARRAY) {
    btfi_put_text(out, "return textureLod(%s, vec3(uv, float(%s)), lod);\n", t, slice);
  } else { /* a slice's centre, where its neighbours have no weight (Suykens et al. 2003, sect. 6) */
    btfi_put_text(out, "return textureLod(%s, vec3(uv, (float(%s) + 0.5) / %u.0), lod);\n", t, slice,
                  (unsigned)texture->slices);
  }
}

/* What a function is called and takes. */
typedef struct way {
  bool filtered;
  const char *suffix, *parameters, *arguments;
} way;
static const way by_numbers = {false, "", "int x, int y, int slice, int level", "x, y, slice, level"};
static const way by_sampler = {true, "_at", "vec2 uv, int slice, float lod", "uv, slice, lod"};

static void put_pages(const btf_gpu_builder *b, const btfi_gpu_pages *t, const way *w, btfi_buffer *out) {
  btfi_put_text(out, "vec4 %s%s%s(%s) {\n", t->name, t->packing == BTFI_GPU_PLAIN ? "" : "_block", w->suffix,
                w->parameters);
  for (uint32_t p = 0; p < t->pages; p++) {
    char slice[64] = "slice";
    if (p > 0) snprintf(slice, sizeof slice, "slice - %u", (unsigned)(p * t->page));
    if (p + 1 < t->pages)
      btfi_put_text(out, "  if (slice < %u) ", (unsigned)((p + 1) * t->page));
    else
      btfi_put_text(out, "  ");
    put_read(out, &b->texture[t->first + p], w->filtered, slice);
  }
  btfi_put_text(out, "}\n");
}

static void put_unpacked(const btf_gpu_builder *b, const btfi_gpu_pages *t, const way *w, btfi_buffer *out) {
  const unsigned number = (unsigned)(t - b->table);
  btfi_put_text(out, "vec4 %s%s(%s) {\n  vec4 texel = %s_block%s(%s);\n", t->name, w->suffix, w->parameters,
                t->name, w->suffix, w->arguments);
  if (t->packing == BTFI_GPU_COLORS)
    btfi_put_text(out, "  return vec4(texel.rgb, 0.0);\n}\n");
  else
    btfi_put_text(out, "  int at = %s;\n  return btf_range%u[at] + btf_range%u[at + 1] * texel;\n}\n",
                  t->ranges > 1 ? "2 * slice" : "0", number, number);
}

static void put_accessor(const btf_gpu_builder *b, const btfi_gpu_pages *t, const way *w, btfi_buffer *out) {
  put_pages(b, t, w, out);
  if (t->packing != BTFI_GPU_PLAIN) put_unpacked(b, t, w, out);
}

/* The blend of a table's texels around a position. */
static void put_mix(const char *name, btfi_buffer *out) {
  static const char corners[4][2] = {{'x', 'x'}, {'y', 'x'}, {'x', 'y'}, {'y', 'y'}};
  static const char weights[4] = {'x', 'y', 'z', 'w'};
  btfi_put_text(out, "vec4 %s_mix(btf_place p, int slice) {\n  vec4 sum = vec4(0.0);\n", name);
  for (int level = 0; level < 2; level++) {
    if (level == 1) btfi_put_text(out, "  if (p.share > 0.0) {\n");
    for (int i = 0; i < 4; i++)
      btfi_put_text(out, "  sum += p.weight%d.%c * %s(p.x%d.%c, p.y%d.%c, slice, p.level.%c);\n", level,
                    weights[i], name, level, corners[i][0], level, corners[i][1], level == 0 ? 'x' : 'y');
  }
  btfi_put_text(out, "  }\n  return sum;\n}\n");
}

void btfi_gpu_put_accessors(const btf_gpu_builder *b, btfi_buffer *out) {
  for (uint32_t i = 0; i < b->table_count; i++) {
    const btfi_gpu_pages *t = &b->table[i];
    const bool is_filtered = (t->flags & BTF_GPU_FILTERED) != 0,
               by_hand = is_filtered && !b->texture[t->first].filtered;
    put_accessor(b, t, &by_numbers, out);
    if (is_filtered && !by_hand) put_accessor(b, t, &by_sampler, out);
    if ((t->flags & BTF_GPU_MATERIAL) != 0 || by_hand) put_mix(t->name, out);
    if (by_hand) /* the texture is larger than the table */
      btfi_put_text(out,
                    "vec4 %s_at(vec2 uv, int slice, float lod) {\n"
                    "  return %s_mix(btf_place_of(uv, lod), slice);\n"
                    "}\n",
                    t->name, t->name);
  }
}
