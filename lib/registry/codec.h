/* SPDX-License-Identifier: MIT */
/* codec.h: inside of a registered codec and of the registry, private to this layer. */
#ifndef BTFI_CODEC_H
#define BTFI_CODEC_H

#include "registry/registry.h"

struct btf_codec {
  btf_context *ctx; /* which owns it */
  btf_codec_vtbl vtbl;
  btf_param_desc *params; /* full-size copies */
  uint32_t param_count;
};

typedef struct btfi_registry {
  btf_codec **codecs;
  uint32_t count, capacity;
  void **modules; /* handles, closed with the context */
  uint32_t module_count, module_capacity;
} btfi_registry;

/* The one door: checks everything about a codec and makes a private copy that is not yet visible. `builtin`
 * allows ids without a dot. */
btf_status btfi_codec_create(btf_context *ctx, const btf_codec_vtbl *user, bool builtin, btf_codec **out);
void btfi_codec_destroy(btf_codec *codec);

/* Room for n more codecs or modules, so that adding them cannot fail half way. */
btf_status btfi_registry_reserve_codecs(btf_context *ctx, uint32_t n);
btf_status btfi_registry_reserve_module(btf_context *ctx);
void btfi_registry_add(btf_context *ctx, btf_codec *codec); /* after a reserve */

/* A parameter's value from text. */
typedef struct btfi_value {
  char *text; /* as given; NULL = the default */
  double number;
} btfi_value;
/* Parses and checks; `number` becomes the number, 0 or 1, or the index of the choice. The message names the
 * parameter, the value and what it takes. */
btf_status btfi_param_parse(btf_context *ctx, const btf_param_desc *param, const char *text, double *number);

#endif
