/* SPDX-License-Identifier: MIT */
/* planes.c: the pictures of coefficients. A texel needs all of them, so they stay decoded, as bytes. */
#include <stdio.h>

#include "source/picture.h"

#include "rti_relight/relight.h"

static const uint64_t most_bytes = (uint64_t)1 << 30;

static btf_status look(const relight_file *r, const source_file *file, picture_info *info,
                       picture_fault *fault) {
  bool complete;
  BTF_TRY(picture_look(file->data, file->size, info, &complete, fault));
  if (!complete) return picture_fail(fault, BTF_E_TRUNCATED, "ends before it says its size");
  if (info->kind != PICTURE_JPEG || info->channels != 3 || info->width != r->map.width ||
      info->height != r->map.height)
    return picture_fail(fault, BTF_E_CORRUPT, "is not a JPEG of %u x %u in three channels", r->map.width,
                        r->map.height);
  return BTF_OK;
}

/* Looks at a plane's head or, with room for it, decodes it. */
static btf_status read_plane(const relight_file *r, uint32_t index, unsigned char *codes) {
  static const picture_rules rules = {.sample_size = 1};
  source_file file;
  picture_info info;
  picture_fault fault = {BTF_OK, ""};
  char name[32];
  snprintf(name, sizeof name, "plane_%u.jpg", index);
  BTF_TRY(source_file_open_beside(&r->map.file, name, &file));
  btf_status status = look(r, &file, &info, &fault);
  if (status == BTF_OK && codes != NULL) status = picture_decode(&file, &info, &rules, codes, &fault);
  source_file_close(&file);
  if (status == BTF_OK) return BTF_OK;
  return (r->map.file.host->fail)(r->map.file.ctx, status, "%s: %s: %s", r->map.file.path, name, fault.why);
}

btf_status relight_read_planes(relight_file *r) {
  const source_file *file = &r->map.file;
  const uint64_t texels = (uint64_t)r->map.width * r->map.height;
  if (texels * 3 * r->image_count > most_bytes)
    return (file->host->fail)(file->ctx, BTF_E_LIMIT, "%s: its planes take more than 1 GiB", file->path);
  for (uint32_t i = 0; i < r->image_count; i++) BTF_TRY(read_plane(r, i, NULL));
  for (uint32_t i = 0; i < r->image_count; i++) {
    r->planes[i] = (file->host->alloc)(file->ctx, texels, 3);
    if (r->planes[i] == NULL) return BTF_E_NOMEM;
    BTF_TRY(read_plane(r, i, r->planes[i]));
  }
  return BTF_OK;
}
