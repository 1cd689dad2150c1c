/* SPDX-License-Identifier: MIT */
#include "dataset/manifest.h"

#include <string.h>

static void put_text(btfi_buffer *b, const char *key, const char *value) {
  if (!value) return;
  btfi_put_text(b, "  ");
  btfi_json_put_string(b, key);
  btfi_put_text(b, ": ");
  btfi_json_put_string(b, value);
  btfi_put_text(b, ",\n");
}

static void put_directions(btfi_buffer *b, const char *key, const btf_dirset *set) {
  const float *d = btf_dirset_directions(set);
  const uint32_t count = btf_dirset_count(set);
  btfi_put_text(b, "  \"%s\": [\n", key);
  for (uint32_t i = 0; i < count; ++i, d += 3)
    btfi_put_text(b, "    [%.9g, %.9g, %.9g]%s\n", (double)d[0], (double)d[1], (double)d[2],
                  i + 1 < count ? "," : "");
  btfi_put_text(b, "  ]");
}

static const char *type_name(uint32_t sample_type) {
  return sample_type == BTF_SAMPLE_U8    ? "u8"
         : sample_type == BTF_SAMPLE_U16 ? "u16"
         : sample_type == BTF_SAMPLE_F16 ? "f16"
                                         : "f32";
}

void btfi_manifest_put(btfi_buffer *b, const btf_dataset_desc *d, uint32_t order, const char *samples,
                       const btfi_manifest_text *texts, uint32_t text_count) {
  btfi_put_text(b, "{\n");
  put_text(b, "format", BTFI_MANIFEST_FORMAT);
  btfi_put_text(b, "  \"version\": %d,\n", btfi_manifest_version);
  put_text(b, "name", d->name);
  put_text(b, "source", d->source);
  put_text(b, "license", d->license);
  btfi_put_text(b, "  \"width\": %u,\n  \"height\": %u,\n  \"channels\": [", d->width, d->height);
  for (uint32_t c = 0; c < d->channels; ++c) {
    if (c > 0) btfi_put_text(b, ", ");
    btfi_json_put_string(b, d->channel_names[c]);
  }
  btfi_put_text(b, "],\n");
  put_text(b, "type", type_name(d->sample_type));
  put_text(b, "order", order == BTF_ORDER_YXVLC ? "yxvlc" : "vlyxc");
  put_text(b, "quantity", d->quantity == BTF_QUANTITY_BRDF_COS ? "brdf_cos" : "brdf");
  put_text(b, "scale", d->scale == BTF_SCALE_ABSOLUTE ? "absolute" : "relative");
  if (d->wrap == BTF_WRAP_CLAMP) put_text(b, "wrap", "clamp");
  if (d->color_space && d->color_space[0]) put_text(b, "color_space", d->color_space);
  if (d->texels_per_mm > 0.0) btfi_put_text(b, "  \"texels_per_mm\": %.9g,\n", d->texels_per_mm);
  for (uint32_t i = 0; i < text_count; ++i) put_text(b, texts[i].key, texts[i].value);
  put_text(b, "samples", samples);
  put_directions(b, "views", d->views);
  btfi_put_text(b, ",\n");
  put_directions(b, "lights", d->lights);
  btfi_put_text(b, "\n}\n");
}

bool btfi_manifest_key_is_taken(const char *key) {
  static const char *const taken[] = {"format",   "version", "name",     "source",      "license",
                                      "width",    "height",  "channels", "type",        "order",
                                      "quantity", "scale",   "wrap",     "color_space", "texels_per_mm",
                                      "samples",  "views",   "lights"};
  for (size_t i = 0; i < sizeof taken / sizeof taken[0]; ++i)
    if (strcmp(key, taken[i]) == 0) return true;
  return false;
}
