/* SPDX-License-Identifier: MIT */
/* format.c: the formats of a context. */
#include <string.h>

#include "registry/codec.h"

static btf_status check(btf_context *ctx, const btf_format_vtbl *v, bool builtin) {
  BTFI_TRY(btfi_check_id(ctx, "format", v->id, v->title, builtin));
  if (btf_format_find(ctx, v->id) != NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: a format of this id is registered already and is not replaced",
                     v->id);
  if (v->probe == NULL || v->open == NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the required function `%s` is missing", v->id,
                     v->probe == NULL ? "probe" : "open");
  if (v->write == NULL && v->write_params != NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: has parameters of writing without the function `write`", v->id);
  return BTF_OK;
}

btf_status btfi_format_create(btf_context *ctx, const btf_format_vtbl *user, bool builtin, btf_format **out) {
  btf_format *format = btfi_calloc(ctx, 1, sizeof *format);
  *out = NULL;
  if (format == NULL) return btfi_alloc_status();
  format->ctx = ctx;
  btf_status status = btfi_copy_table(ctx, "format", user, BTFI_SIZE_TO(btf_format_vtbl, open), &format->vtbl,
                                      sizeof format->vtbl);
  if (status == BTF_OK) status = check(ctx, &format->vtbl, builtin);
  format->params = (btfi_params){.ctx = ctx, .owner = format->vtbl.id};
  if (status == BTF_OK) status = btfi_params_copy(&format->params, format->vtbl.params);
  format->write_params = (btfi_params){.ctx = ctx, .owner = format->vtbl.id};
  if (status == BTF_OK) status = btfi_params_copy(&format->write_params, format->vtbl.write_params);
  if (status != BTF_OK) {
    btfi_format_destroy(format);
    return status;
  }
  if (format->vtbl.version == NULL) format->vtbl.version = "";
  *out = format;
  return BTF_OK;
}

void btfi_format_destroy(btf_format *format) {
  if (format == NULL) return;
  btfi_params_free(&format->params);
  btfi_params_free(&format->write_params);
  btfi_free(format->ctx, format);
}

btf_status btfi_registry_attach_formats(btf_context *ctx) {
  btf_format *format;
  BTFI_TRY(btfi_registry_reserve_formats(ctx, 1));
  BTFI_TRY(btfi_format_create(ctx, &btfi_format_folder, true, &format));
  btfi_registry_add_format(ctx, format);
  return BTF_OK;
}

uint32_t btf_format_count(const btf_context *ctx) {
  const btfi_registry *r = ctx != NULL ? btfi_context_registry(ctx) : NULL;
  return r != NULL ? r->format_count : 0;
}

const btf_format *btf_format_at(const btf_context *ctx, uint32_t i) {
  const btfi_registry *r = ctx != NULL ? btfi_context_registry(ctx) : NULL;
  return r != NULL && i < r->format_count ? r->formats[i] : NULL;
}

const btf_format *btf_format_find(const btf_context *ctx, const char *id) {
  const btfi_registry *r = ctx != NULL ? btfi_context_registry(ctx) : NULL;
  if (r == NULL || id == NULL) return NULL;
  for (uint32_t i = 0; i < r->format_count; i++)
    if (strcmp(r->formats[i]->vtbl.id, id) == 0) return r->formats[i];
  return NULL;
}

const char *btf_format_id(const btf_format *format) {
  return format->vtbl.id;
}
const char *btf_format_title(const btf_format *format) {
  return format->vtbl.title;
}
uint32_t btf_format_param_count(const btf_format *format) {
  return format->params.count;
}

btf_status btf_format_param(const btf_format *format, uint32_t i, btf_param_desc *io) {
  if (format == NULL) return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_format_param: format must not be NULL");
  return btfi_params_describe(&format->params, i, io);
}
