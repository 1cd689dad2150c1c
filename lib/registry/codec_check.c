/* SPDX-License-Identifier: MIT */
/* The door of the registry: nothing becomes visible before everything about it was checked. */
#include "registry/codec.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#define ID_CHARACTERS "abcdefghijklmnopqrstuvwxyz0123456789._-"
#define NAME_CHARACTERS "abcdefghijklmnopqrstuvwxyz0123456789_"
#define KNOWN_CAPS                                                                                           \
  ((uint64_t)(BTF_CAP_FIT | BTF_CAP_STREAM_FIT | BTF_CAP_BATCH | BTF_CAP_LOD | BTF_CAP_LINEAR |              \
              BTF_CAP_RGB_ONLY | BTF_CAP_HARDENED))

/* Copies the table as far as the codec's header knew it; what it did not know is NULL. A tail this library
 * does not know may only be empty, since ignoring it would change what the codec does. */
static btf_status copy_vtbl(btf_context *ctx, const btf_codec_vtbl *user, btf_codec_vtbl *out) {
  const unsigned char *bytes = (const unsigned char *)user;
  const size_t least = BTFI_SIZE_TO(btf_codec_vtbl, texel);
  if (user->abi != LIBBTF_ABI)
    return btfi_fail(ctx, BTF_E_ABI, "codec: made for ABI %u; this library has ABI %u", (unsigned)user->abi,
                     LIBBTF_ABI);
  if (user->struct_size < least)
    return btfi_fail(ctx, BTF_E_ABI, "codec: its table has %u bytes; the first version had %u",
                     (unsigned)user->struct_size, (unsigned)least);
  if (user->struct_size > sizeof *out + 4096)
    return btfi_fail(ctx, BTF_E_ABI, "codec: its table claims an absurd %u bytes",
                     (unsigned)user->struct_size);
  for (uint32_t i = sizeof *out; i < user->struct_size; i++)
    if (bytes[i] != 0)
      return btfi_fail(ctx, BTF_E_ABI,
                       "codec: its table has entries this library does not know; a newer one is needed");
  memset(out, 0, sizeof *out);
  memcpy(out, user, BTFI_MIN(user->struct_size, sizeof *out));
  out->struct_size = sizeof *out;
  return BTF_OK;
}

static btf_status check_identity(btf_context *ctx, const btf_codec_vtbl *v, bool builtin) {
  const size_t size = v->id != NULL ? strlen(v->id) : 0;
  if (size == 0 || size > 63 || strspn(v->id, ID_CHARACTERS) != size)
    return btfi_fail(ctx, BTF_E_PLUGIN, "codec: the id \"%.80s\" is not 1 to 63 of [a-z0-9._-]",
                     v->id != NULL ? v->id : "");
  if (!builtin && strchr(v->id, '.') == NULL)
    return btfi_fail(
        ctx, BTF_E_PLUGIN,
        "%s: an id without a dot belongs to libbtf's own codecs; expected one such as org.example.%s", v->id,
        v->id);
  if (strcmp(v->id, "raw") == 0)
    return btfi_fail(ctx, BTF_E_PLUGIN, "raw: this id stands for data sets evaluated as they are");
  if (btf_codec_find(ctx, v->id) != NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: a codec of this id is registered already and is not replaced",
                     v->id);
  if (v->title == NULL || *v->title == '\0' || strchr(v->title, '\n') != NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the codec needs a title of one line", v->id);
  if (v->format_read_min > v->format_write)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: reads payload versions from %u on, yet writes %u", v->id,
                     (unsigned)v->format_read_min, (unsigned)v->format_write);
  return BTF_OK;
}

static btf_status check_slots(btf_context *ctx, const btf_codec_vtbl *v) {
  const struct {
    const char *name;
    bool there;
  } required[] = {{"load", v->load != NULL},     {"destroy", v->destroy != NULL},
                  {"levels", v->levels != NULL}, {"resident_bytes", v->resident_bytes != NULL},
                  {"eval", v->eval != NULL},     {"texel", v->texel != NULL}};
  for (size_t i = 0; i < sizeof required / sizeof *required; i++)
    if (!required[i].there)
      return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the required function `%s` is missing", v->id,
                       required[i].name);
  if ((v->caps & ~KNOWN_CAPS) != 0)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: unknown capability bits 0x%llx", v->id,
                     (unsigned long long)(v->caps & ~KNOWN_CAPS));
  if (((v->caps & BTF_CAP_FIT) != 0) != (v->fit != NULL))
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: BTF_CAP_FIT and the function `fit` must come together", v->id);
  if (((v->caps & BTF_CAP_BATCH) != 0) != (v->eval_n != NULL))
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: BTF_CAP_BATCH and the function `eval_n` must come together",
                     v->id);
  if ((v->caps & BTF_CAP_STREAM_FIT) != 0 && v->fit == NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: BTF_CAP_STREAM_FIT without the function `fit`", v->id);
  return BTF_OK;
}

static btf_status check_range(btf_context *ctx, const char *id, const btf_param_desc *p) {
  const bool number = p->type == BTF_PARAM_INT || p->type == BTF_PARAM_FLOAT;
  const double most = 9007199254740992.0; /* 2^53: up to here doubles hold every whole number */
  if (!number) return BTF_OK;
  if (!(p->minimum <= p->maximum))
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: parameter %s: its range from %g to %g is empty", id, p->name,
                     p->minimum, p->maximum);
  if (p->type == BTF_PARAM_INT && ((isfinite(p->minimum) && fabs(p->minimum) > most) ||
                                   (isfinite(p->maximum) && fabs(p->maximum) > most)))
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: parameter %s: whole numbers reach from -2^53 to 2^53", id,
                     p->name);
  return BTF_OK;
}

static btf_status check_choices(btf_context *ctx, const char *id, const btf_param_desc *p) {
  if ((p->type == BTF_PARAM_CHOICE) != (p->choices != NULL && p->choices[0] != NULL))
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: parameter %s: %s", id, p->name,
                     p->type == BTF_PARAM_CHOICE ? "a choice needs at least one name"
                                                 : "only a choice has names");
  for (uint32_t i = 0; p->choices != NULL && p->choices[i] != NULL; i++)
    for (uint32_t k = 0; k < i; k++)
      if (strcmp(p->choices[i], p->choices[k]) == 0)
        return btfi_fail(ctx, BTF_E_PLUGIN, "%s: parameter %s: the choice \"%s\" occurs twice", id, p->name,
                         p->choices[i]);
  return BTF_OK;
}

static btf_status check_param(btf_context *ctx, const btf_codec *codec, uint32_t i) {
  const char *id = codec->vtbl.id;
  const btf_param_desc *p = &codec->params[i];
  const size_t size = p->name != NULL ? strlen(p->name) : 0;
  double number;
  if (size == 0 || size > 63 || strspn(p->name, NAME_CHARACTERS) != size)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the name \"%.80s\" of parameter %u is not 1 to 63 of [a-z0-9_]",
                     id, p->name != NULL ? p->name : "", (unsigned)i);
  for (uint32_t k = 0; k < i; k++)
    if (strcmp(codec->params[k].name, p->name) == 0)
      return btfi_fail(ctx, BTF_E_PLUGIN, "%s: parameter %s occurs twice", id, p->name);
  if (p->type < BTF_PARAM_INT || p->type > BTF_PARAM_STRING)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: parameter %s: unknown type %u", id, p->name, (unsigned)p->type);
  if (p->flags != 0)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: parameter %s: flags is %#x; expected 0", id, p->name,
                     (unsigned)p->flags);
  if (p->summary == NULL || p->default_text == NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: parameter %s: summary and default must not be NULL", id,
                     p->name);
  BTFI_TRY(check_range(ctx, id, p));
  BTFI_TRY(check_choices(ctx, id, p));
  if (btfi_param_parse(NULL, p, p->default_text, &number) != BTF_OK) {
    char reason[256];
    strncpy(reason, btf_error_message(), sizeof reason - 1);
    reason[sizeof reason - 1] = '\0';
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the default of parameter %s", id, reason);
  }
  return BTF_OK;
}

static btf_status copy_params(btf_context *ctx, btf_codec *codec) {
  uint32_t count = 0;
  while (codec->vtbl.params != NULL && codec->vtbl.params[count] != NULL)
    if (++count > 1024) return btfi_fail(ctx, BTF_E_PLUGIN, "%s: more than 1024 parameters", codec->vtbl.id);
  codec->params = btfi_calloc(ctx, count, sizeof *codec->params);
  if (codec->params == NULL) return btfi_alloc_status();
  codec->param_count = count;
  for (uint32_t i = 0; i < count; i++) {
    BTFI_TRY(btfi_copy_in(ctx, "btf_param_desc", &codec->params[i], sizeof *codec->params,
                          BTFI_SIZE_TO(btf_param_desc, flags), codec->vtbl.params[i]));
    BTFI_TRY(check_param(ctx, codec, i));
  }
  return BTF_OK;
}

btf_status btfi_codec_create(btf_context *ctx, const btf_codec_vtbl *user, bool builtin, btf_codec **out) {
  btf_codec *codec = btfi_calloc(ctx, 1, sizeof *codec);
  btf_status status;
  *out = NULL;
  if (codec == NULL) return btfi_alloc_status();
  codec->ctx = ctx;
  status = copy_vtbl(ctx, user, &codec->vtbl);
  if (status == BTF_OK) status = check_identity(ctx, &codec->vtbl, builtin);
  if (status == BTF_OK) status = check_slots(ctx, &codec->vtbl);
  if (status == BTF_OK) status = copy_params(ctx, codec);
  if (status != BTF_OK) {
    btfi_codec_destroy(codec);
    return status;
  }
  if (codec->vtbl.version == NULL) codec->vtbl.version = "";
  *out = codec;
  return BTF_OK;
}

void btfi_codec_destroy(btf_codec *codec) {
  if (codec == NULL) return;
  btfi_free(codec->ctx, codec->params);
  btfi_free(codec->ctx, codec);
}
