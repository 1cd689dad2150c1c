/* SPDX-License-Identifier: MIT */
/* described_check.c: tables, ids and parameters, of codecs and formats alike. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "registry/codec.h"

#define ID_CHARACTERS "abcdefghijklmnopqrstuvwxyz0123456789._-"
#define NAME_CHARACTERS "abcdefghijklmnopqrstuvwxyz0123456789_"

/* What an older header did not know is NULL. A tail this library does not know may only be empty, since
 * ignoring it would change what the table's functions do. */
btf_status btfi_copy_table(btf_context *ctx, const char *what, const void *user, size_t least, void *out,
                           size_t known) {
  const unsigned char *bytes = user;
  uint32_t struct_size, abi;
  memcpy(&struct_size, bytes, sizeof struct_size);
  memcpy(&abi, bytes + sizeof struct_size, sizeof abi);
  if (abi != LIBBTF_ABI)
    return btfi_fail(ctx, BTF_E_ABI, "%s: made for ABI %u; this library has ABI %u", what, (unsigned)abi,
                     LIBBTF_ABI);
  if (struct_size < least)
    return btfi_fail(ctx, BTF_E_ABI, "%s: its table has %u bytes; the first version had %u", what,
                     (unsigned)struct_size, (unsigned)least);
  if (struct_size > known + 4096)
    return btfi_fail(ctx, BTF_E_ABI, "%s: its table claims an absurd %u bytes", what, (unsigned)struct_size);
  for (size_t i = known; i < struct_size; i++)
    if (bytes[i] != 0)
      return btfi_fail(ctx, BTF_E_ABI,
                       "%s: its table has entries this library does not know; a newer one is needed", what);
  memset(out, 0, known);
  memcpy(out, user, BTFI_MIN(struct_size, known));
  const uint32_t full = (uint32_t)known;
  memcpy(out, &full, sizeof full);
  return BTF_OK;
}

btf_status btfi_check_id(btf_context *ctx, const char *what, const char *id, const char *title,
                         bool builtin) {
  const size_t size = id != NULL ? strlen(id) : 0;
  if (size == 0 || size > 63 || strspn(id, ID_CHARACTERS) != size)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the id \"%.80s\" is not 1 to 63 of [a-z0-9._-]", what,
                     id != NULL ? id : "");
  if (!builtin && strchr(id, '.') == NULL)
    return btfi_fail(
        ctx, BTF_E_PLUGIN,
        "%s: an id without a dot belongs to libbtf's own %ss; expected one such as org.example.%s", id, what,
        id);
  if (title == NULL || *title == '\0' || strchr(title, '\n') != NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the %s needs a title of one line", id, what);
  return BTF_OK;
}

/* ---- parameters ---- */

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

static btf_status check_param(btf_context *ctx, const btfi_params *params, uint32_t i) {
  const char *id = params->owner;
  const btf_param_desc *p = &params->list[i];
  const size_t size = p->name != NULL ? strlen(p->name) : 0;
  double number;
  if (size == 0 || size > 63 || strspn(p->name, NAME_CHARACTERS) != size)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: the name \"%.80s\" of parameter %u is not 1 to 63 of [a-z0-9_]",
                     id, p->name != NULL ? p->name : "", (unsigned)i);
  for (uint32_t k = 0; k < i; k++)
    if (strcmp(params->list[k].name, p->name) == 0)
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

btf_status btfi_params_copy(btfi_params *params, const btf_param_desc *const *list) {
  uint32_t count = 0;
  while (list != NULL && list[count] != NULL)
    if (++count > 1024)
      return btfi_fail(params->ctx, BTF_E_PLUGIN, "%s: more than 1024 parameters", params->owner);
  if (count == 0) return BTF_OK;
  params->list = btfi_calloc(params->ctx, count, sizeof *params->list);
  if (params->list == NULL) return btfi_alloc_status();
  params->count = count;
  for (uint32_t i = 0; i < count; i++) {
    BTFI_TRY(btfi_copy_in(params->ctx, "btf_param_desc", &params->list[i], sizeof *params->list,
                          BTFI_SIZE_TO(btf_param_desc, flags), list[i]));
    BTFI_TRY(check_param(params->ctx, params, i));
  }
  return BTF_OK;
}

void btfi_params_free(btfi_params *params) {
  btfi_free(params->ctx, params->list);
}

btf_status btfi_params_describe(const btfi_params *params, uint32_t i, btf_param_desc *io) {
  if (i >= params->count)
    return btfi_fail(params->ctx, BTF_E_INVALID_ARG, "%s: there is no parameter %u", params->owner, i);
  return btfi_copy_out(params->ctx, "btf_param_desc", io, BTFI_SIZE_TO(btf_param_desc, flags),
                       &params->list[i], sizeof *io);
}
