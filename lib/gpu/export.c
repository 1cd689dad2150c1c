/* SPDX-License-Identifier: MIT */
/* export.c: a model made ready for a GPU. */
#include "gpu/gpu.h"

#include <stdio.h>
#include <string.h>

/* ---- targets ---- */

static uint32_t or_default(uint32_t value, uint32_t otherwise) {
  return value != 0 ? value : otherwise;
}

static btf_status take_target(btf_context *ctx, const btf_gpu_target *user, btf_gpu_target *out) {
  *out = (btf_gpu_target)BTF_GPU_TARGET_INIT;
  if (user != NULL)
    BTFI_TRY(btfi_copy_in(ctx, "btf_gpu_target", out, sizeof *out, BTFI_SIZE_TO(btf_gpu_target, max_textures),
                          user));
  if (out->compress > BTF_GPU_COMPRESS_BC || out->reserved != 0)
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "btf_gpu_target: compress must be 0 or BTF_GPU_COMPRESS_BC, reserved 0");
  out->max_2d = or_default(out->max_2d, 8192);
  out->max_3d = or_default(out->max_3d, 2048);
  out->max_layers = or_default(out->max_layers, 256);
  out->max_textures = or_default(out->max_textures, 16);
  return BTF_OK;
}

static btf_status find_layout(btf_context *ctx, const btf_codec_vtbl *v, const char *name, uint32_t *out) {
  *out = 0;
  if (v == &btfi_raw_codec)
    return btfi_fail(ctx, BTF_E_UNSUPPORTED, "a data set exports nothing; btf encode makes a model of it");
  if (v->gpu == NULL)
    return btfi_fail(ctx, BTF_E_UNSUPPORTED, "%s: this codec exports nothing for a GPU", v->id);
  if (name == NULL) return BTF_OK;
  for (; v->gpu_layouts[*out] != NULL; ++*out)
    if (strcmp(v->gpu_layouts[*out]->name, name) == 0) return BTF_OK;
  char names[160] = "";
  size_t length = 0;
  for (uint32_t i = 0; v->gpu_layouts[i] != NULL && length < sizeof names; i++)
    length += (size_t)snprintf(names + length, sizeof names - length, "%s%s", i > 0 ? ", " : "",
                               v->gpu_layouts[i]->name);
  return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: no layout \"%.80s\"; there are %s", v->id, name, names);
}

const char *btf_codec_gpu_layout(const btf_codec *codec, uint32_t i, const char **summary) {
  const btf_codec_vtbl *v = codec != NULL ? btfi_codec_vtbl(codec) : NULL;
  if (summary != NULL) *summary = NULL;
  if (v == NULL || v->gpu == NULL) return NULL;
  for (uint32_t k = 0; v->gpu_layouts[k] != NULL; k++) {
    if (k != i) continue;
    if (summary != NULL) *summary = v->gpu_layouts[k]->summary;
    return v->gpu_layouts[k]->name;
  }
  return NULL;
}

/* ---- making ---- */

static void free_builder(btf_gpu_builder *b) {
  if (b == NULL) return;
  for (uint32_t i = 0; i < b->texture_count; i++) btfi_gpu_texture_free(b->ctx, &b->texture[i]);
  btfi_buffer_free(&b->source);
  btfi_buffer_free(&b->search);
  btfi_free(b->ctx, b);
}

static btf_status begin_builder(btf_context *ctx, const btf_model *model, const btf_gpu_target *target,
                                btf_gpu_builder **out) {
  const float size[4] = {(float)model->width, (float)model->height, (float)model->levels, 0.0f};
  btf_gpu_builder *b = *out = btfi_calloc(ctx, 1, sizeof *b);
  if (b == NULL) return btfi_alloc_status();
  b->ctx = ctx;
  b->target = *target;
  b->cost = (btf_gpu_cost)BTF_GPU_COST_INIT;
  btfi_buffer_init(&b->source, ctx);
  btfi_buffer_init(&b->search, ctx);
  return btfi_gpu_uniform(b, "btf_size", BTF_UNIFORM_VEC4, 1, size);
}

/* The buffer's text with a NUL, owned by the caller from now on. */
static btf_status take_text(btfi_buffer *buffer, char **out) {
  btfi_put_u8(buffer, 0);
  BTFI_TRY(btfi_buffer_status(buffer));
  *out = (char *)buffer->data;
  btfi_buffer_init(buffer, buffer->ctx);
  return BTF_OK;
}

static btf_status put_texts(btf_gpu_export *e, const btf_model *model, const char *layout) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btfi_buffer text;
  BTFI_TRY(btf_model_describe(model, &info));
  btfi_buffer_init(&text, e->ctx);
  btfi_gpu_put_glsl(e->built, model->shape.wrap, model->shape.channels,
                    model->quantity == BTF_QUANTITY_BRDF_COS, &text);
  btf_status status = take_text(&text, &e->glsl);
  if (status == BTF_OK) {
    btfi_gpu_put_manifest(e, &info, layout, &text);
    status = take_text(&text, &e->manifest);
  }
  btfi_buffer_free(&text);
  return status;
}

static void count_bytes(btf_gpu_builder *b) {
  for (uint32_t i = 0; i < b->texture_count; i++)
    for (uint32_t l = 0; l < b->texture[i].level_count; l++)
      b->cost.texture_bytes += (double)b->texture[i].levels[l].size;
}

static btf_status build(btf_gpu_export *e, const btf_model *model, const btf_gpu_target *user) {
  const btf_codec_vtbl *v = model->vtbl;
  btf_gpu_target target;
  uint32_t layout;
  BTFI_TRY(take_target(e->ctx, user, &target));
  BTFI_TRY(find_layout(e->ctx, v, target.layout, &layout));
  target.layout = v->gpu_layouts[layout]->name;
  BTFI_TRY(begin_builder(e->ctx, model, &target, &e->built));
  BTFI_TRY(v->gpu(btfi_host(), e->ctx, model->state, &model->shape, layout, &target, e->built));
  BTFI_TRY(btfi_buffer_status(&e->built->search));
  BTFI_TRY(btfi_buffer_status(&e->built->source));
  BTFI_TRY(btfi_gpu_check_limits(e->built));
  if (target.compress == BTF_GPU_COMPRESS_BC) BTFI_TRY(btfi_gpu_compress(e->built));
  count_bytes(e->built);
  return put_texts(e, model, target.layout);
}

btf_status btf_gpu_export_create(const btf_model *model, const btf_gpu_target *target, btf_gpu_export **out) {
  if (out != NULL) *out = NULL;
  if (model == NULL || out == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_gpu_export_create: model and out must not be NULL");
  btf_gpu_export *e = btfi_calloc(model->ctx, 1, sizeof *e);
  if (e == NULL) return btfi_alloc_status();
  e->ctx = model->ctx;
  btfi_context_retain(e->ctx);
  const btf_status status = build(e, model, target);
  if (status != BTF_OK) {
    btf_gpu_export_release(e);
    return status;
  }
  *out = e;
  return BTF_OK;
}

void btf_gpu_export_release(btf_gpu_export *e) {
  if (e == NULL) return;
  btf_context *ctx = e->ctx;
  free_builder(e->built);
  btfi_free(ctx, e->glsl);
  btfi_free(ctx, e->manifest);
  btfi_free(ctx, e);
  btf_context_release(ctx);
}

/* ---- asking ---- */

uint32_t btf_gpu_texture_count(const btf_gpu_export *e) {
  return e->built->texture_count;
}

btf_status btf_gpu_texture_at(const btf_gpu_export *e, uint32_t i, btf_gpu_texture *io) {
  if (i >= e->built->texture_count)
    return btfi_fail(e->ctx, BTF_E_INVALID_ARG, "btf_gpu_texture_at: there is no texture %u", (unsigned)i);
  const btfi_gpu_texture *t = &e->built->texture[i];
  const bool is_stack = t->dimension == BTF_TEXTURE_3D;
  const uint32_t filter = t->filtered ? BTF_FILTER_LINEAR : BTF_FILTER_NEAREST;
  const btf_gpu_texture texture = {.struct_size = sizeof texture,
                                   .name = t->name,
                                   .levels = t->levels,
                                   .dimension = t->dimension,
                                   .texel = t->texel,
                                   .width = t->width,
                                   .height = t->height,
                                   .depth = is_stack ? t->slices : 1,
                                   .layers = is_stack ? 1 : t->slices,
                                   .level_count = t->level_count,
                                   .min_filter = filter,
                                   .mag_filter = filter,
                                   .wrap = {t->wrap, t->wrap, BTF_WRAP_CLAMP},
                                   .binding = i + 1,
                                   .psnr_db = t->psnr_db};
  return btfi_copy_out(e->ctx, "btf_gpu_texture", io, BTFI_SIZE_TO(btf_gpu_texture, reserved), &texture,
                       sizeof texture);
}

const char *btf_gpu_glsl(const btf_gpu_export *e) {
  return e->glsl;
}

const char *btf_gpu_manifest(const btf_gpu_export *e) {
  return e->manifest;
}

const void *btf_gpu_uniforms(const btf_gpu_export *e, size_t *size) {
  *size = (e->built->block_size + 15) & ~(size_t)15;
  return e->built->block;
}

const btf_gpu_uniform *btf_gpu_uniform_fields(const btf_gpu_export *e, uint32_t *count) {
  *count = e->built->uniform_count;
  return e->built->uniform;
}

btf_status btf_gpu_export_cost(const btf_gpu_export *e, btf_gpu_cost *io) {
  return btfi_copy_out(e->ctx, "btf_gpu_cost", io, BTFI_SIZE_TO(btf_gpu_cost, rounding), &e->built->cost,
                       sizeof e->built->cost);
}

btf_status btf_gpu_texture_ktx2(const btf_gpu_export *e, uint32_t i, int32_t zstd_level, void **data,
                                size_t *size) {
  btfi_buffer file;
  *data = NULL;
  *size = 0;
  if (i >= e->built->texture_count || zstd_level < 0 || zstd_level > 22)
    return btfi_fail(e->ctx, BTF_E_INVALID_ARG,
                     "btf_gpu_texture_ktx2: there is no texture %u or zstd level %d", (unsigned)i,
                     (int)zstd_level);
  btfi_buffer_init(&file, e->ctx);
  const btf_status status = btfi_gpu_put_ktx2(&e->built->texture[i], zstd_level, &file);
  if (status != BTF_OK) {
    btfi_buffer_free(&file);
    return status;
  }
  *data = file.data;
  *size = file.size;
  return BTF_OK;
}

void btf_gpu_free(const btf_gpu_export *e, void *data) {
  btfi_free(e->ctx, data);
}
