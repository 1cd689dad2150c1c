/* SPDX-License-Identifier: MIT */
/* The door of the registry: nothing becomes visible before everything about it was checked. */
#include "registry/codec.h"

#include <string.h>

#define KNOWN_CAPS                                                                                           \
  ((uint64_t)(BTF_CAP_FIT | BTF_CAP_STREAM_FIT | BTF_CAP_BATCH | BTF_CAP_LOD | BTF_CAP_LINEAR |              \
              BTF_CAP_RGB_ONLY | BTF_CAP_HARDENED))

static btf_status check_identity(btf_context *ctx, const btf_codec_vtbl *v, bool builtin) {
  BTFI_TRY(btfi_check_id(ctx, "codec", v->id, v->title, builtin));
  if (strcmp(v->id, "raw") == 0)
    return btfi_fail(ctx, BTF_E_PLUGIN, "raw: this id stands for data sets evaluated as they are");
  if (btf_codec_find(ctx, v->id) != NULL)
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: a codec of this id is registered already and is not replaced",
                     v->id);
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
  if ((v->gpu != NULL) != (v->gpu_layouts != NULL && v->gpu_layouts[0] != NULL))
    return btfi_fail(ctx, BTF_E_PLUGIN, "%s: `gpu` and `gpu_layouts` must come together", v->id);
  return BTF_OK;
}

btf_status btfi_codec_create(btf_context *ctx, const btf_codec_vtbl *user, bool builtin, btf_codec **out) {
  btf_codec *codec = btfi_calloc(ctx, 1, sizeof *codec);
  btf_status status;
  *out = NULL;
  if (codec == NULL) return btfi_alloc_status();
  codec->ctx = ctx;
  status = btfi_copy_table(ctx, "codec", user, BTFI_SIZE_TO(btf_codec_vtbl, texel), &codec->vtbl,
                           sizeof codec->vtbl);
  if (status == BTF_OK) status = check_identity(ctx, &codec->vtbl, builtin);
  if (status == BTF_OK) status = check_slots(ctx, &codec->vtbl);
  codec->params = (btfi_params){.ctx = ctx, .owner = codec->vtbl.id};
  if (status == BTF_OK) status = btfi_params_copy(&codec->params, codec->vtbl.params);
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
  btfi_params_free(&codec->params);
  btfi_free(codec->ctx, codec);
}
