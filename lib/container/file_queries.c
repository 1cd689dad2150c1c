/* SPDX-License-Identifier: MIT */
/* What an open container tells about itself. */
#include "container/reader.h"

btf_context *btfi_file_context(const btf_file *file) {
  return file->ctx;
}

btf_status btfi_file_payload(const btf_file *file, uint32_t i, btfi_payload **out) {
  *out = NULL;
  if (i >= file->model_count)
    return btfi_fail(file->ctx, BTF_E_INVALID_ARG, "%s: there is no model %u; the file has %u",
                     file->source->name, i, file->model_count);
  btfi_payload_retain(file->models[i]);
  *out = file->models[i];
  return BTF_OK;
}

uint32_t btf_file_model_count(const btf_file *file) {
  return file != NULL ? file->model_count : 0;
}

const char *btf_file_model_codec(const btf_file *file, uint32_t i) {
  return file != NULL && i < file->model_count ? file->models[i]->header.codec_id : NULL;
}

btf_status btf_file_describe_model(const btf_file *file, uint32_t i, btf_model_info *io) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  const btfi_model_header *h;
  if (file == NULL || i >= file->model_count)
    return btfi_fail(file != NULL ? file->ctx : NULL, BTF_E_INVALID_ARG,
                     "btf_file_describe_model: no model %u", i);
  h = &file->models[i]->header;
  info.codec_id = h->codec_id;
  info.color_space = h->color_space;
  info.lights = h->lights;
  info.views = h->views;
  info.stored_bytes = file->models[i]->stored_bytes;
  info.width = h->width;
  info.height = h->height;
  info.channels = h->channels;
  info.quantity = h->quantity;
  info.scale = h->scale;
  info.wrap = h->wrap;
  info.channel_names = (const char *const *)h->channel_names;
  info.name = h->name;
  info.source = h->source;
  info.license = h->license;
  info.texels_per_mm = h->texels_per_mm;
  return btfi_copy_out(file->ctx, "btf_model_info", io, BTFI_SIZE_TO(btf_model_info, texels_per_mm), &info,
                       sizeof info);
}

const char *btf_file_metadata(const btf_file *file, const char *key) {
  return file != NULL ? btfi_metadata_find(&file->metadata, key) : NULL;
}

uint32_t btf_file_metadata_count(const btf_file *file) {
  return file != NULL ? file->metadata.count : 0;
}

btf_status btf_file_metadata_at(const btf_file *file, uint32_t i, const char **key, const char **value) {
  if (key != NULL) *key = NULL;
  if (value != NULL) *value = NULL;
  if (file == NULL || i >= file->metadata.count)
    return btfi_fail(file != NULL ? file->ctx : NULL, BTF_E_INVALID_ARG, "btf_file_metadata_at: no pair %u",
                     i);
  if (key != NULL) *key = file->metadata.keys[i];
  if (value != NULL) *value = file->metadata.values[i];
  return BTF_OK;
}

uint32_t btf_file_chunk_count(const btf_file *file) {
  return file != NULL ? file->header.count : 0;
}

btf_status btf_file_chunk(const btf_file *file, uint32_t i, btf_chunk_info *io) {
  btf_chunk_info info;
  const btfi_entry *e;
  if (file == NULL || i >= file->header.count)
    return btfi_fail(file != NULL ? file->ctx : NULL, BTF_E_INVALID_ARG, "btf_file_chunk: no chunk %u", i);
  e = &file->entries[i];
  info = (btf_chunk_info){sizeof info, e->offset, e->stored, e->raw,   e->checksum, e->type,
                          e->tag,      e->index,  e->flags,  e->model, e->method};
  return btfi_copy_out(file->ctx, "btf_chunk_info", io, BTFI_SIZE_TO(btf_chunk_info, method), &info,
                       sizeof info);
}
