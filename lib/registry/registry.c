/* SPDX-License-Identifier: MIT */
/* The codecs of a context, and room for its formats. */
#include "registry/codec.h"

#include <dlfcn.h>
#include <string.h>

extern const btf_codec_vtbl *const btfi_builtin_codecs[];

static void destroy(btf_context *ctx, void *user) {
  btfi_registry *r = user;
  for (uint32_t i = 0; i < r->count; i++) btfi_codec_destroy(r->codecs[i]);
  for (uint32_t i = 0; i < r->format_count; i++) btfi_format_destroy(r->formats[i]);
  for (uint32_t i = 0; i < r->module_count; i++) dlclose(r->modules[i]);
  btfi_free(ctx, r->codecs);
  btfi_free(ctx, r->formats);
  btfi_free(ctx, r->modules);
  btfi_free(ctx, r);
}

static btf_status reserve(btf_context *ctx, void **array, uint32_t count, uint32_t *capacity, uint32_t more) {
  const uint64_t wanted = (uint64_t)count + more;
  void *copy;
  if (wanted <= *capacity) return BTF_OK;
  if (wanted > 65536) return btfi_fail(ctx, BTF_E_LIMIT, "a context holds at most 65536 codecs or formats");
  copy = btfi_alloc(ctx, wanted + 8, sizeof(void *));
  if (copy == NULL) return btfi_alloc_status();
  if (count != 0) memcpy(copy, *array, count * sizeof(void *));
  btfi_free(ctx, *array);
  *array = copy;
  *capacity = (uint32_t)wanted + 8;
  return BTF_OK;
}

btf_status btfi_registry_reserve_codecs(btf_context *ctx, uint32_t n) {
  btfi_registry *r = btfi_context_registry(ctx);
  void *array = r->codecs;
  BTFI_TRY(reserve(ctx, &array, r->count, &r->capacity, n));
  r->codecs = array;
  return BTF_OK;
}

btf_status btfi_registry_reserve_formats(btf_context *ctx, uint32_t n) {
  btfi_registry *r = btfi_context_registry(ctx);
  void *array = r->formats;
  BTFI_TRY(reserve(ctx, &array, r->format_count, &r->format_capacity, n));
  r->formats = array;
  return BTF_OK;
}

btf_status btfi_registry_reserve_module(btf_context *ctx) {
  btfi_registry *r = btfi_context_registry(ctx);
  void *array = r->modules;
  BTFI_TRY(reserve(ctx, &array, r->module_count, &r->module_capacity, 1));
  r->modules = array;
  return BTF_OK;
}

void btfi_registry_add(btf_context *ctx, btf_codec *codec) {
  btfi_registry *r = btfi_context_registry(ctx);
  r->codecs[r->count++] = codec;
}

void btfi_registry_add_format(btf_context *ctx, btf_format *format) {
  btfi_registry *r = btfi_context_registry(ctx);
  r->formats[r->format_count++] = format;
}

static btf_status add(btf_context *ctx, const btf_codec_vtbl *vtbl, bool builtin) {
  btf_codec *codec;
  BTFI_TRY(btfi_registry_reserve_codecs(ctx, 1));
  BTFI_TRY(btfi_codec_create(ctx, vtbl, builtin, &codec));
  btfi_registry_add(ctx, codec);
  return BTF_OK;
}

btf_status btfi_registry_attach(btf_context *ctx) {
  btfi_registry *r = btfi_calloc(ctx, 1, sizeof *r);
  if (r == NULL) return btfi_alloc_status();
  btfi_context_set_registry(ctx, r, destroy);
  for (const btf_codec_vtbl *const *codec = btfi_builtin_codecs; *codec != NULL; codec++)
    BTFI_TRY(add(ctx, *codec, true));
  return btfi_registry_attach_formats(ctx);
}

btf_status btf_context_register(btf_context *ctx, const btf_codec_vtbl *codec) {
  if (ctx == NULL || codec == NULL)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_context_register: context and codec must not be NULL");
  return add(ctx, codec, false);
}

uint32_t btf_codec_count(const btf_context *ctx) {
  const btfi_registry *r = ctx != NULL ? btfi_context_registry(ctx) : NULL;
  return r != NULL ? r->count : 0;
}

const btf_codec *btf_codec_at(const btf_context *ctx, uint32_t i) {
  const btfi_registry *r = ctx != NULL ? btfi_context_registry(ctx) : NULL;
  return r != NULL && i < r->count ? r->codecs[i] : NULL;
}

const btf_codec *btf_codec_find(const btf_context *ctx, const char *id) {
  const btfi_registry *r = ctx != NULL ? btfi_context_registry(ctx) : NULL;
  if (r == NULL || id == NULL) return NULL;
  for (uint32_t i = 0; i < r->count; i++)
    if (strcmp(r->codecs[i]->vtbl.id, id) == 0) return r->codecs[i];
  return NULL;
}

const char *btf_codec_id(const btf_codec *codec) {
  return codec->vtbl.id;
}
const char *btf_codec_title(const btf_codec *codec) {
  return codec->vtbl.title;
}
uint64_t btf_codec_caps(const btf_codec *codec) {
  return codec->vtbl.caps;
}
uint32_t btf_codec_param_count(const btf_codec *codec) {
  return codec->params.count;
}

btf_status btf_codec_param(const btf_codec *codec, uint32_t i, btf_param_desc *io) {
  if (codec == NULL) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_codec_param: codec must not be NULL");
  return btfi_params_describe(&codec->params, i, io);
}

const btf_codec_vtbl *btfi_codec_vtbl(const btf_codec *codec) {
  return &codec->vtbl;
}
btf_context *btfi_codec_context(const btf_codec *codec) {
  return codec->ctx;
}
