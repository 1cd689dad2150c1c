/* SPDX-License-Identifier: MIT */
/* codec.h: inside of registered codecs and formats and of the registry, private to this layer. */
#ifndef BTFI_CODEC_H
#define BTFI_CODEC_H

#include <stdatomic.h>

#include "registry/registry.h"

/* The parameters of a codec or a format. */
typedef struct btfi_params {
  btf_context *ctx;     /* which owns their owner */
  const char *owner;    /* its id */
  btf_param_desc *list; /* full-size copies */
  uint32_t count;
} btfi_params;

struct btf_codec {
  btf_context *ctx; /* which owns it */
  btf_codec_vtbl vtbl;
  btfi_params params;
};

struct btf_format {
  btf_context *ctx;
  btf_format_vtbl vtbl;
  btfi_params params, write_params;
};

typedef struct btfi_registry {
  btf_codec **codecs;
  uint32_t count, capacity;
  btf_format **formats;
  uint32_t format_count, format_capacity;
  void **modules; /* handles, closed with the context */
  uint32_t module_count, module_capacity;
} btfi_registry;

/* The one door: checks everything about a codec and makes a private copy that is not yet visible. `builtin`
 * allows ids without a dot. */
btf_status btfi_codec_create(btf_context *ctx, const btf_codec_vtbl *user, bool builtin, btf_codec **out);
void btfi_codec_destroy(btf_codec *codec);

/* The same for a format. */
btf_status btfi_format_create(btf_context *ctx, const btf_format_vtbl *user, bool builtin, btf_format **out);
void btfi_format_destroy(btf_format *format);
btf_status btfi_registry_attach_formats(btf_context *ctx); /* those that are always there */
extern const btf_format_vtbl btfi_format_folder;

/* Room for n more codecs, formats or modules, so that adding them cannot fail half way. */
btf_status btfi_registry_reserve_codecs(btf_context *ctx, uint32_t n);
btf_status btfi_registry_reserve_formats(btf_context *ctx, uint32_t n);
btf_status btfi_registry_reserve_module(btf_context *ctx);
void btfi_registry_add(btf_context *ctx, btf_codec *codec); /* after a reserve */
void btfi_registry_add_format(btf_context *ctx, btf_format *format);

/* What codecs and formats have in common (described_check.c). `what` is the word for messages.
 * Copies a table of `known` bytes as far as its author's header knew it, at least `least`. */
btf_status btfi_copy_table(btf_context *ctx, const char *what, const void *user, size_t least, void *out,
                           size_t known);
btf_status btfi_check_id(btf_context *ctx, const char *what, const char *id, const char *title, bool builtin);
btf_status btfi_params_copy(btfi_params *params, const btf_param_desc *const *list);
void btfi_params_free(btfi_params *params);
btf_status btfi_params_describe(const btfi_params *params, uint32_t i, btf_param_desc *io);

bool btfi_options_are_of_params(const btf_options *options, const btfi_params *params);
btf_status btfi_options_create(const btfi_params *params, btf_options **out);
/* For the time of a fit or an opening: the same values, with the mistakes of who asks for them noted. */
typedef struct btfi_wrong_name {
  atomic_flag taken; /* by the first */
  char text[64];
} btfi_wrong_name;

/* A parameter's value from text. */
typedef struct btfi_value {
  char *text; /* as given; NULL = the default */
  double number;
} btfi_value;
/* Parses and checks; `number` becomes the number, 0 or 1, or the index of the choice. The message names the
 * parameter, the value and what it takes. */
btf_status btfi_param_parse(btf_context *ctx, const btf_param_desc *param, const char *text, double *number);

#endif
