/* SPDX-License-Identifier: MIT */
/* What a model decodes to, as a data set. */
#include "model/model.h"

static btf_status read_block(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  const btf_model *model = user;
  float values[64];
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++) {
          char *sample = (char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light +
                         (ptrdiff_t)y * s->y + (ptrdiff_t)x * s->x;
          if (btf_model_texel(model, 0, b->x0 + x, b->y0 + y, b->light0 + l, b->view0 + v, values) != 0)
            return btf_source_error(BTF_E_CORRUPT,
                                    "%s: light %u, view %u of texel %u, %u decodes to what is not finite",
                                    model->vtbl->id, b->light0 + l, b->view0 + v, b->x0 + x, b->y0 + y);
          for (uint32_t c = 0; c < model->channels; c++)
            *(float *)(void *)(sample + (ptrdiff_t)c * s->channel) = values[c];
        }
  return BTF_OK;
}

static btf_status factors_of(void *user, btf_factors *out) {
  const btf_model *model = user;
  if (model->vtbl->factors == NULL)
    return btf_source_error(BTF_E_UNSUPPORTED, "%s: this codec gives no factors", model->vtbl->id);
  return model->vtbl->factors(model->state, out);
}

static void release(void *user) {
  btf_model_release(user);
}

btf_status btf_dataset_from_model(const btf_model *model, btf_dataset **out) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  if (out != NULL) *out = NULL;
  if (model == NULL || out == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_dataset_from_model: model and out must not be NULL");
  if (model->dataset != NULL) {
    *out = btf_dataset_retain(model->dataset);
    return BTF_OK;
  }
  BTFI_TRY(btf_model_describe(model, &info));
  desc.lights = info.lights;
  desc.views = info.views;
  desc.width = info.width;
  desc.height = info.height;
  desc.channels = info.channels;
  desc.quantity = info.quantity;
  desc.scale = info.scale;
  desc.wrap = info.wrap;
  desc.flags = BTF_DATASET_CONCURRENT_READ;
  desc.channel_names = info.channel_names;
  desc.color_space = info.color_space;
  desc.name = info.name;
  desc.source = info.source;
  desc.license = info.license;
  desc.texels_per_mm = info.texels_per_mm;
  desc.notes = (const char *const *)btfi_payload_header(model->payload)->notes;
  desc.read = read_block;
  desc.factors = factors_of;
  desc.user = btf_model_retain(model);
  desc.release = release;
  return btf_dataset_create(model->ctx, &desc, out);
}
