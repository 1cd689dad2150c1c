/* SPDX-License-Identifier: MIT */
/* builder.c: what a codec adds to an export: tables of texels, numbers, shader text. */
#include "gpu/gpu.h"

#include <stdio.h>
#include <string.h>

#include <btf/btf_sampling.h>

static const btfi_texel_format formats[] = {
    {BTF_TEXEL_R8_UNORM, 1, 1, false, false, 1},    {BTF_TEXEL_RG8_UNORM, 2, 1, false, false, 1},
    {BTF_TEXEL_RGBA8_UNORM, 4, 1, false, false, 1}, {BTF_TEXEL_RGBA8_SNORM, 4, 1, false, true, 1},
    {BTF_TEXEL_R16_FLOAT, 1, 2, true, true, 1},     {BTF_TEXEL_RG16_FLOAT, 2, 2, true, true, 1},
    {BTF_TEXEL_RGBA16_FLOAT, 4, 2, true, true, 1},  {BTF_TEXEL_R32_FLOAT, 1, 4, true, true, 1},
    {BTF_TEXEL_RG32_FLOAT, 2, 4, true, true, 1},    {BTF_TEXEL_RGBA32_FLOAT, 4, 4, true, true, 1},
    {BTF_TEXEL_BC6H_UFLOAT, 1, 16, true, false, 4}, {BTF_TEXEL_BC6H_SFLOAT, 1, 16, true, true, 4},
    {BTF_TEXEL_BC7_UNORM, 1, 16, false, false, 4},
};

const btfi_texel_format *btfi_texel_format_of(uint32_t texel) {
  for (size_t i = 0; i < sizeof formats / sizeof *formats; i++)
    if (formats[i].vk == texel) return &formats[i];
  return NULL;
}

static btf_status take_name(btf_gpu_builder *b, const char *name, char out[BTFI_GPU_NAME]) {
  const size_t length = name != NULL ? strlen(name) : 0;
  /* Pages append up to four characters, accessors some more. */
  if (length < 5 || length >= BTFI_GPU_NAME - 16 || strncmp(name, "btf_", 4) != 0)
    return btfi_fail(b->ctx, BTF_E_PLUGIN, "GPU export: \"%.80s\" is no name of a texture or number",
                     name != NULL ? name : "");
  memcpy(out, name, length + 1);
  return BTF_OK;
}

/* ---- textures ---- */

static btf_status check_table(btf_gpu_builder *b, const btf_gpu_table *t) {
  const uint32_t most_levels = (t->flags & BTF_GPU_STACK) != 0 ? 1 : 32;
  const btfi_texel_format *format = btfi_texel_format_of(t->texel);
  if (format == NULL || format->side > 1 || t->width == 0 || t->height == 0 || t->slices == 0 ||
      t->levels == 0 || t->levels > most_levels ||
      (t->flags & ~(uint32_t)(BTF_GPU_STACK | BTF_GPU_FILTERED | BTF_GPU_MATERIAL | BTF_GPU_SMOOTH |
                              BTF_GPU_WIDE)) != 0 ||
      t->reserved != 0 || (t->wrap != BTF_WRAP_PERIODIC && t->wrap != BTF_WRAP_CLAMP))
    return btfi_fail(b->ctx, BTF_E_PLUGIN, "GPU export: table %s makes no sense", t->name);
  return BTF_OK;
}

/* Sizes of all levels and where each begins; false on overflow. */
static bool measure_levels(btfi_gpu_texture *texture, uint64_t *total) {
  const btfi_texel_format *format = btfi_texel_format_of(texture->texel);
  *total = 0;
  for (uint32_t l = 0; l < texture->level_count; l++) {
    btf_gpu_level *level = &texture->levels[l];
    uint64_t padded;
    level->width = btf_sampling_level_size(texture->width, l);
    level->height = btf_sampling_level_size(texture->height, l);
    level->depth = texture->slices;
    level->reserved = 0;
    /* Pixels or blocks of them. */
    if (!btfi_mul((level->width + format->side - 1) / format->side,
                  (level->height + format->side - 1) / format->side, &level->size) ||
        !btfi_mul(level->size, level->depth, &level->size) ||
        !btfi_mul(level->size, (uint64_t)format->channels * format->bytes, &level->size) ||
        !btfi_add(level->size, 63, &padded) || !btfi_add(*total, padded & ~(uint64_t)63, total))
      return false;
  }
  return true;
}

btf_status btfi_gpu_texture_allocate(btf_context *ctx, btfi_gpu_texture *texture) {
  uint64_t total, offset = 0;
  texture->levels = btfi_calloc(ctx, texture->level_count, sizeof *texture->levels);
  if (texture->levels == NULL) return btfi_alloc_status();
  if (!measure_levels(texture, &total))
    return btfi_fail(ctx, BTF_E_LIMIT, "GPU export: %s is beyond any memory", texture->name);
  texture->data = btfi_calloc(ctx, total, 1);
  if (texture->data == NULL) return btfi_alloc_status();
  for (uint32_t l = 0; l < texture->level_count; l++) {
    texture->levels[l].data = texture->data + offset;
    offset += (texture->levels[l].size + 63) & ~(uint64_t)63;
  }
  return BTF_OK;
}

void btfi_gpu_texture_free(btf_context *ctx, btfi_gpu_texture *texture) {
  btfi_free(ctx, texture->levels);
  btfi_free(ctx, texture->data);
}

void btfi_gpu_page_name(const btfi_gpu_pages *table, uint32_t page, char out[BTFI_GPU_NAME]) {
  /* The name fits: take_name left room for what pages append. */
  snprintf(out, BTFI_GPU_NAME, table->pages > 1 ? "%.48s_map%u" : "%.48s_map", table->name, (unsigned)page);
}

static btf_status make_texture(btf_gpu_builder *b, const btf_gpu_table *t, const btfi_gpu_pages *pages,
                               uint32_t page) {
  btfi_gpu_texture *texture = &b->texture[b->texture_count];
  char name[BTFI_GPU_NAME];
  btfi_gpu_page_name(pages, page, name);
  if (b->texture_count == BTFI_GPU_TEXTURES)
    return btfi_fail(
        b->ctx, BTF_E_LIMIT,
        "GPU export: %s would be a texture more than the %d that an export has; a model with fewer "
        "components or a target with more layers would do",
        name, BTFI_GPU_TEXTURES);
  memcpy(texture->name, name, sizeof name);
  texture->dimension = (t->flags & BTF_GPU_STACK) != 0 ? BTF_TEXTURE_3D
                       : t->slices > 1                 ? BTF_TEXTURE_2D_ARRAY
                                                       : BTF_TEXTURE_2D;
  texture->texel = t->texel;
  texture->width = t->width;
  texture->height = t->height;
  texture->slices = BTFI_MIN(pages->page, t->slices - page * pages->page);
  texture->level_count = t->levels;
  texture->wrap = t->wrap;
  texture->filtered = (t->flags & BTF_GPU_FILTERED) != 0;
  b->texture_count++; /* from here on destroyed with the builder */
  return btfi_gpu_texture_allocate(b->ctx, texture);
}

btf_status btfi_gpu_table(btf_gpu_builder *b, const btf_gpu_table *user, uint32_t *number) {
  btf_gpu_table t;
  char name[BTFI_GPU_NAME];
  *number = UINT32_MAX;
  BTFI_TRY(btfi_copy_in(b->ctx, "btf_gpu_table", &t, sizeof t, BTFI_SIZE_TO(btf_gpu_table, reserved), user));
  BTFI_TRY(take_name(b, t.name, name));
  t.name = name;
  BTFI_TRY(check_table(b, &t));
  if (b->table_count == BTFI_GPU_TEXTURES)
    return btfi_fail(b->ctx, BTF_E_PLUGIN, "GPU export: more than %d tables", BTFI_GPU_TEXTURES);
  btfi_gpu_pages *pages = &b->table[b->table_count];
  *pages = (btfi_gpu_pages){.first = b->texture_count, .flags = t.flags, .slices = t.slices};
  memcpy(pages->name, name, sizeof name);
  pages->page = (t.flags & BTF_GPU_STACK) != 0 ? t.slices : BTFI_MIN(t.slices, b->target.max_layers);
  pages->pages = (t.slices + pages->page - 1) / pages->page;
  for (uint32_t p = 0; p < pages->pages; p++) BTFI_TRY(make_texture(b, &t, pages, p));
  *number = b->table_count++;
  return BTF_OK;
}

static btf_status check_sides(const btf_gpu_builder *b, bool stacks, uint32_t most) {
  const btfi_gpu_texture *largest = NULL;
  uint32_t needed = most;
  bool only_material = true;
  for (uint32_t i = 0; i < b->table_count; i++) {
    const btfi_gpu_texture *t = &b->texture[b->table[i].first];
    const bool is_stack = t->dimension == BTF_TEXTURE_3D;
    const uint32_t side = BTFI_MAX(BTFI_MAX(t->width, t->height), is_stack ? t->slices : 1);
    if (is_stack != stacks || side <= most) continue;
    only_material = only_material && (b->table[i].flags & BTF_GPU_MATERIAL) != 0;
    if (side <= needed) continue;
    needed = side;
    largest = t;
  }
  if (largest == NULL) return BTF_OK;
  return btfi_fail(b->ctx, BTF_E_LIMIT,
                   "GPU export: %s would have %u texels along a side, more than the %u of the target's %s "
                   "textures; %sa target of at least %u would do",
                   largest->name, (unsigned)needed, (unsigned)most, stacks ? "3D" : "2D",
                   only_material ? "a smaller material or " : "", (unsigned)needed);
}

btf_status btfi_gpu_check_limits(const btf_gpu_builder *b) {
  BTFI_TRY(check_sides(b, false, b->target.max_2d));
  BTFI_TRY(check_sides(b, true, b->target.max_3d));
  if (b->texture_count <= b->target.max_textures) return BTF_OK;
  return btfi_fail(
      b->ctx, BTF_E_LIMIT,
      "GPU export: there would be %u textures, more than the target's %u; %sa target of at least "
      "%u would do",
      (unsigned)b->texture_count, (unsigned)b->target.max_textures,
      b->table_count <= b->target.max_textures
          ? "a model with fewer components, a target with more layers or "
          : "",
      (unsigned)b->texture_count);
}

void *btfi_gpu_slice(btf_gpu_builder *b, uint32_t number, uint32_t level, uint32_t slice) {
  if (number >= b->table_count) return NULL;
  const btfi_gpu_pages *pages = &b->table[number];
  const uint32_t p = slice / pages->page;
  if (p >= pages->pages) return NULL;
  const btfi_gpu_texture *texture = &b->texture[pages->first + p];
  const uint32_t within = slice - p * pages->page;
  if (level >= texture->level_count || within >= texture->slices) return NULL;
  const btf_gpu_level *l = &texture->levels[level];
  return texture->data + ((const unsigned char *)l->data - texture->data) + l->size / l->depth * within;
}

/* ---- numbers ---- */

typedef struct uniform_layout {
  uint32_t components, align, size; /* align and size of one in std140, in bytes */
} uniform_layout;

static bool uniform_layout_of(uint32_t type, uniform_layout *out) {
  switch (type) {
  case BTF_UNIFORM_FLOAT:
  case BTF_UNIFORM_INT:
    *out = (uniform_layout){1, 4, 4};
    return true;
  case BTF_UNIFORM_VEC2:
    *out = (uniform_layout){2, 8, 8};
    return true;
  case BTF_UNIFORM_VEC3:
    *out = (uniform_layout){3, 16, 12};
    return true;
  case BTF_UNIFORM_VEC4:
  case BTF_UNIFORM_IVEC4:
    *out = (uniform_layout){4, 16, 16};
    return true;
  default:
    return false;
  }
}

btf_status btfi_gpu_uniform(btf_gpu_builder *b, const char *name, uint32_t type, uint32_t count,
                            const void *values) {
  uniform_layout layout;
  if (b->uniform_count == BTFI_GPU_UNIFORMS || count == 0 || count > BTFI_GPU_BLOCK_BYTES / 4 ||
      values == NULL || !uniform_layout_of(type, &layout))
    return btfi_fail(b->ctx, BTF_E_PLUGIN, "GPU export: number \"%.80s\" makes no sense", name);
  BTFI_TRY(take_name(b, name, b->uniform_name[b->uniform_count]));
  const uint32_t align = count > 1 ? 16 : layout.align;
  const uint32_t stride = count > 1 ? 16 : layout.size;
  const uint32_t offset = (b->block_size + align - 1) / align * align;
  if (offset > BTFI_GPU_BLOCK_BYTES || count * stride > BTFI_GPU_BLOCK_BYTES - offset)
    return btfi_fail(b->ctx, BTF_E_LIMIT, "GPU export: the uniform block would be larger than %d bytes",
                     BTFI_GPU_BLOCK_BYTES);
  for (uint32_t i = 0; i < count; i++)
    memcpy(b->block + offset + i * stride, (const unsigned char *)values + (size_t)i * layout.components * 4,
           (size_t)layout.components * 4);
  b->block_size = offset + count * stride;
  b->uniform[b->uniform_count] = (btf_gpu_uniform){b->uniform_name[b->uniform_count], type, offset, count, 0};
  b->uniform_count++;
  return BTF_OK;
}

/* ---- text ---- */

btf_status btfi_gpu_source(btf_gpu_builder *b, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  btfi_put_text_of(&b->source, format, arguments);
  va_end(arguments);
  return btfi_buffer_status(&b->source);
}

void btfi_gpu_cost(btf_gpu_builder *b, const btf_gpu_cost *cost) {
  b->cost.fetches += cost->fetches;
  b->cost.bytes += cost->bytes;
  b->cost.flops += cost->flops;
  b->cost.rounding += cost->rounding;
}
