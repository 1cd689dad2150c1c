/* SPDX-License-Identifier: MIT */
/* The codec-independent header of a model: from a data set, to and from a MODL chunk. */
#include "container/payload.h"

#include <math.h>
#include <string.h>

#define FIXED_SIZE 64u

void btfi_model_header_free(btf_context *ctx, btfi_model_header *h) {
  btfi_free(ctx, h->codec_id);
  btfi_free(ctx, h->color_space);
  btfi_free(ctx, h->name);
  btfi_free(ctx, h->source);
  btfi_free(ctx, h->license);
  if (h->channel_names != NULL)
    for (uint32_t c = 0; c < h->channels; c++) btfi_free(ctx, h->channel_names[c]);
  btfi_free(ctx, h->channel_names);
  for (uint32_t i = 0; h->notes != NULL && h->notes[i] != NULL; i++) btfi_free(ctx, h->notes[i]);
  btfi_free(ctx, h->notes);
  btf_dirset_release(h->lights);
  btf_dirset_release(h->views);
  memset(h, 0, sizeof *h);
}

/* Copies a text; NULL stays NULL. What cannot be stored is refused when the model is made, not when it is
 * saved. */
static btf_status copy_text(btf_context *ctx, const char *what, const char *text, char **out) {
  const size_t size = text != NULL ? strlen(text) : 0;
  if (text == NULL) return BTF_OK;
  if (size > BTFI_TEXT_LIMIT || !btfi_text_valid(text, size))
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s of the data set: not UTF-8 text of at most %u bytes", what,
                     (unsigned)BTFI_TEXT_LIMIT);
  *out = btfi_strdup(ctx, text);
  return *out != NULL ? BTF_OK : btfi_alloc_status();
}

static uint64_t dataset_bytes(const btf_dataset_desc *desc) {
  uint64_t n = btf_dirset_count(desc->lights);
  const bool fits = btfi_mul(n, btf_dirset_count(desc->views), &n) && btfi_mul(n, desc->width, &n) &&
                    btfi_mul(n, desc->height, &n) && btfi_mul(n, desc->channels, &n) &&
                    btfi_mul(n, btfi_sample_size(desc->sample_type), &n);
  return fits ? n : 0;
}

btf_status btfi_model_header_take_notes(btf_context *ctx, const char *const *notes, btfi_model_header *h) {
  uint32_t count = 0;
  while (notes != NULL && notes[count] != NULL) count++;
  if (count == 0) return BTF_OK;
  h->notes = btfi_calloc(ctx, (uint64_t)count + 1, sizeof *h->notes);
  if (h->notes == NULL) return btfi_alloc_status();
  for (uint32_t i = 0, kept = 0; i + 1 < count; i += 2) {
    const size_t key = strlen(notes[i]), text = strlen(notes[i + 1]);
    if (key < 1 || key > 255 || text > BTFI_TEXT_LIMIT || !btfi_text_valid(notes[i], key) ||
        !btfi_text_valid(notes[i + 1], text))
      continue; /* no container could hold it, and the model does without */
    for (uint32_t k = i; k < i + 2; k++)
      if ((h->notes[kept++] = btfi_strdup(ctx, notes[k])) == NULL) return btfi_alloc_status();
  }
  return BTF_OK;
}

static btf_status fill(btf_context *ctx, const btf_dataset_desc *desc, const char *codec_id,
                       btfi_model_header *h) {
  BTFI_TRY(copy_text(ctx, "codec id", codec_id, &h->codec_id));
  BTFI_TRY(
      copy_text(ctx, "color_space", desc->color_space != NULL ? desc->color_space : "", &h->color_space));
  BTFI_TRY(copy_text(ctx, "name", desc->name, &h->name));
  BTFI_TRY(copy_text(ctx, "source", desc->source, &h->source));
  BTFI_TRY(copy_text(ctx, "license", desc->license, &h->license));
  h->channel_names = btfi_calloc(ctx, desc->channels, sizeof *h->channel_names);
  if (h->channel_names == NULL) return btfi_alloc_status();
  for (uint32_t c = 0; c < desc->channels; c++)
    BTFI_TRY(copy_text(ctx, "channel name", desc->channel_names[c], &h->channel_names[c]));
  return btfi_model_header_take_notes(ctx, desc->notes, h);
}

btf_status btfi_model_header_from_dataset(btf_context *ctx, const btf_dataset *ds, const char *codec_id,
                                          uint32_t codec_format, btfi_model_header *out) {
  const btf_dataset_desc *desc = btfi_dataset_desc(ds);
  btf_status status;
  memset(out, 0, sizeof *out);
  out->codec_format = codec_format;
  out->width = desc->width;
  out->height = desc->height;
  out->channels = desc->channels;
  out->quantity = desc->quantity;
  out->scale = desc->scale;
  out->wrap = desc->wrap;
  out->texels_per_mm = desc->texels_per_mm;
  out->dataset_bytes = dataset_bytes(desc);
  out->lights = btf_dirset_retain(desc->lights);
  out->views = btf_dirset_retain(desc->views);
  status = fill(ctx, desc, codec_id, out);
  if (status != BTF_OK) btfi_model_header_free(ctx, out);
  return status;
}

/* A length and the bytes; NULL is told from "" by the length 0xffffffff. */
static void put_text(btfi_buffer *out, const char *text) {
  const size_t size = text != NULL ? strlen(text) : 0;
  btfi_put_u32(out, text != NULL ? (uint32_t)size : 0xffffffffu);
  if (size != 0) btfi_put_bytes(out, text, size);
}

void btfi_model_header_encode(const btfi_model_header *h, const btfi_model_links *links, btfi_buffer *out) {
  btfi_put_u32(out, h->codec_format);
  btfi_put_u32(out, h->width);
  btfi_put_u32(out, h->height);
  btfi_put_u32(out, h->channels);
  btfi_put_u32(out, h->quantity);
  btfi_put_u32(out, h->scale);
  btfi_put_u32(out, h->wrap);
  btfi_put_u32(out, links->light_set);
  btfi_put_u32(out, links->view_set);
  btfi_put_u32(out, links->payload_chunks);
  btfi_put_f64(out, h->texels_per_mm);
  btfi_put_u64(out, h->dataset_bytes);
  btfi_put_u64(out, 0);
  put_text(out, h->codec_id);
  put_text(out, h->color_space);
  put_text(out, h->name);
  put_text(out, h->source);
  put_text(out, h->license);
  for (uint32_t c = 0; c < h->channels; c++) put_text(out, h->channel_names[c]);
}

static btf_status get_text(btf_context *ctx, const char *name, btfi_cursor *c, bool may_be_absent,
                           char **out) {
  const uint32_t size = btfi_get_u32(c);
  const char *text;
  if (size == 0xffffffffu && may_be_absent) return BTF_OK;
  if (c->overrun) return BTF_OK; /* told once, at the end */
  if (size > BTFI_TEXT_LIMIT)
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: a text of %u bytes; at most %u are allowed", name,
                     (unsigned)size, (unsigned)BTFI_TEXT_LIMIT);
  text = btfi_get_bytes(c, size);
  if (c->overrun) return BTF_OK;
  if (!btfi_text_valid(text, size))
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: a text is not valid UTF-8", name);
  *out = btfi_alloc(ctx, (uint64_t)size + 1, 1);
  if (*out == NULL) return btfi_alloc_status();
  if (size != 0) memcpy(*out, text, size);
  (*out)[size] = '\0';
  return BTF_OK;
}

static bool id_valid(const char *id) {
  const size_t size = id != NULL ? strlen(id) : 0;
  return size > 0 && size <= 63 && strspn(id, "abcdefghijklmnopqrstuvwxyz0123456789._-") == size;
}

static btf_status check(btf_context *ctx, const char *name, const btfi_model_header *h,
                        const btfi_model_links *links, uint32_t set_count) {
  const btf_limits *limits = btfi_limits(ctx);
  if (h->width == 0 || h->height == 0 || h->channels == 0)
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: %u x %u texels of %u channels; none may be 0", name, h->width,
                     h->height, h->channels);
  if (h->width > limits->max_dimension || h->height > limits->max_dimension)
    return btfi_fail(ctx, BTF_E_LIMIT, "%s: %u x %u texels are over the limit of %u along a side", name,
                     h->width, h->height, limits->max_dimension);
  if (h->channels > limits->max_channels || h->channels > 64)
    return btfi_fail(ctx, BTF_E_LIMIT, "%s: %u channels; at most %u are read", name, h->channels,
                     BTFI_MIN(limits->max_channels, 64u));
  if (h->quantity != BTF_QUANTITY_BRDF && h->quantity != BTF_QUANTITY_BRDF_COS)
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: quantity %u is neither 1 (brdf) nor 2 (brdf_cos)", name,
                     h->quantity);
  if (h->scale > BTF_SCALE_ABSOLUTE || h->wrap > BTF_WRAP_CLAMP)
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: scale %u or wrap %u is neither 0 nor 1", name, h->scale,
                     h->wrap);
  if (links->light_set >= set_count || links->view_set >= set_count)
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: direction set %u or %u is missing; the file has %u", name,
                     links->light_set, links->view_set, set_count);
  if (!(h->texels_per_mm >= 0.0) || isinf(h->texels_per_mm))
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: texels per mm is not a number from 0 on", name);
  return BTF_OK;
}

btf_status btfi_model_header_decode(btf_context *ctx, const char *name, const void *data, uint64_t size,
                                    btf_dirset *const *sets, uint32_t set_count, btfi_model_header *h,
                                    btfi_model_links *links) {
  btfi_cursor c = {data, size, 0, false};
  memset(h, 0, sizeof *h);
  if (size < FIXED_SIZE)
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: %llu bytes, less than the %u of the fixed part", name,
                     (unsigned long long)size, FIXED_SIZE);
  h->codec_format = btfi_get_u32(&c);
  h->width = btfi_get_u32(&c);
  h->height = btfi_get_u32(&c);
  h->channels = btfi_get_u32(&c);
  h->quantity = btfi_get_u32(&c);
  h->scale = btfi_get_u32(&c);
  h->wrap = btfi_get_u32(&c);
  links->light_set = btfi_get_u32(&c);
  links->view_set = btfi_get_u32(&c);
  links->payload_chunks = btfi_get_u32(&c);
  h->texels_per_mm = btfi_get_f64(&c);
  h->dataset_bytes = btfi_get_u64(&c);
  btfi_get_u64(&c); /* reserved */
  BTFI_TRY(check(ctx, name, h, links, set_count));
  BTFI_TRY(get_text(ctx, name, &c, false, &h->codec_id));
  BTFI_TRY(get_text(ctx, name, &c, false, &h->color_space));
  BTFI_TRY(get_text(ctx, name, &c, true, &h->name));
  BTFI_TRY(get_text(ctx, name, &c, true, &h->source));
  BTFI_TRY(get_text(ctx, name, &c, true, &h->license));
  h->channel_names = btfi_calloc(ctx, h->channels, sizeof *h->channel_names);
  if (h->channel_names == NULL) return btfi_alloc_status();
  for (uint32_t i = 0; i < h->channels; i++) BTFI_TRY(get_text(ctx, name, &c, false, &h->channel_names[i]));
  if (c.overrun) return btfi_fail(ctx, BTF_E_CORRUPT, "%s: the chunk ends within its texts", name);
  if (!id_valid(h->codec_id))
    return btfi_fail(ctx, BTF_E_CORRUPT, "%s: the codec id is not 1 to 63 of [a-z0-9._-]", name);
  h->lights = btf_dirset_retain(sets[links->light_set]);
  h->views = btf_dirset_retain(sets[links->view_set]);
  return BTF_OK;
}
