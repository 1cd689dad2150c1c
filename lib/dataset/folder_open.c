/* SPDX-License-Identifier: MIT */
#include "dataset/dataset_parts.h"
#include "dataset/manifest.h"
#include "io/folder.h"

#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

static btf_status read_manifest(btf_context *ctx, const char *path, const char *file, btfi_manifest *m) {
  struct stat entry;
  char *text = NULL;
  uint64_t size = 0;
  if (btfi_folder_stat(path, &entry) != 0)
    return btfi_fail(ctx, BTF_E_IO, "%s: cannot be opened: %s", path, strerror(errno));
  if (!S_ISDIR(entry.st_mode))
    return btfi_fail(ctx, BTF_E_NOT_BTF, "%s: not a folder; expected a data-set folder", path);
  if (btfi_folder_stat(file, &entry) != 0) {
    if (errno == ENOENT)
      return btfi_fail(ctx, BTF_E_NOT_BTF, "%s: has no " BTFI_MANIFEST_FILE "; expected a data-set folder",
                       path);
    return btfi_fail(ctx, BTF_E_IO, "%s: cannot be opened: %s", file, strerror(errno));
  }
  BTFI_TRY(btfi_read_file(ctx, file, btfi_manifest_most_bytes, &text, &size));
  const btf_status status = btfi_manifest_parse(ctx, file, text, size, m);
  btfi_free(ctx, text);
  return status;
}

static btf_status map_samples(btf_context *ctx, const char *file, const btfi_manifest *m,
                              btfi_mapping *mapping) {
  BTFI_TRY(btfi_map_file(ctx, file, mapping));
  if (mapping->size == m->bytes) return BTF_OK;
  const uint64_t size = mapping->size;
  btfi_unmap(mapping);
  return btfi_fail(ctx, size < m->bytes ? BTF_E_TRUNCATED : BTF_E_CORRUPT,
                   "%s: has %" PRIu64 " bytes; expected %" PRIu64
                   " (%u views x %u lights x %u x %u texels x %u channels"
                   " x %u bytes)",
                   file, size, m->bytes, btf_dirset_count(m->views), btf_dirset_count(m->lights), m->width,
                   m->height, m->channels, btfi_sample_size(m->sample_type));
}

static btf_status make_mapped(btf_context *ctx, const char *path, const char *samples, const btfi_manifest *m,
                              btf_dataset **out) {
  btfi_mapping mapping;
  BTFI_TRY(map_samples(ctx, samples, m, &mapping));
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  desc.lights = m->lights;
  desc.views = m->views;
  desc.width = m->width;
  desc.height = m->height;
  desc.channels = m->channels;
  desc.sample_type = m->sample_type;
  desc.quantity = m->quantity;
  desc.scale = m->scale;
  desc.wrap = m->wrap;
  desc.flags = m->order == BTF_ORDER_VLYXC ? BTF_DATASET_IMAGE_MAJOR : 0;
  desc.channel_names = m->channel_names;
  desc.color_space = m->color_space;
  desc.name = m->name;
  desc.source = m->source;
  desc.license = m->license;
  desc.texels_per_mm = m->texels_per_mm;
  desc.notes = m->notes;
  desc.data = mapping.data;
  desc.strides = btfi_dense_strides(&desc, m->order, (ptrdiff_t)btfi_sample_size(m->sample_type));
  return btfi_dataset_make(ctx, &desc, path, &mapping, out);
}

btf_status btf_dataset_open(btf_context *ctx, const char *path, btf_dataset **out) {
  if (out) *out = NULL;
  if (!ctx || !path || !out)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_dataset_open: context, path and result must not be NULL");
  char *file = NULL, *samples = NULL;
  btfi_manifest manifest;
  BTFI_TRY(btfi_path_join(ctx, path, BTFI_MANIFEST_FILE, &file));
  btf_status status = read_manifest(ctx, path, file, &manifest);
  if (status == BTF_OK) {
    status = btfi_path_join(ctx, path, manifest.samples, &samples);
    if (status == BTF_OK) status = make_mapped(ctx, path, samples, &manifest, out);
    btfi_manifest_free(&manifest);
  }
  btfi_free(ctx, samples);
  btfi_free(ctx, file);
  return status;
}
