/* SPDX-License-Identifier: MIT */
#include "source/one_view.h"

#include "source/srgb.h"

btf_status one_view_open(const btf_host *host, btf_context *ctx, const char *path, size_t size,
                         one_view **out) {
  one_view *map = (host->alloc)(ctx, 1, size);
  if (map == NULL) return BTF_E_NOMEM;
  memset(map, 0, size);
  const btf_status status = source_file_open(host, ctx, path, &map->file);
  if (status == BTF_OK)
    *out = map;
  else
    (host->free)(ctx, map);
  return status;
}

void one_view_close(one_view *map) {
  const btf_host *host = map->file.host;
  btf_context *ctx = map->file.ctx;
  if (map->drop != NULL) map->drop(map);
  (host->dirset_release)(map->lights);
  (host->dirset_release)(map->views);
  source_file_close(&map->file);
  (host->free)(ctx, map);
}

static void release(void *user) {
  one_view_close(user);
}

static btf_status read_block(void *user, const btf_block *block, void *dst, const btf_strides *strides) {
  const one_view *map = user;
  const float *all = (map->file.host->dirset_directions)(map->lights);
  double weights[ONE_VIEW_MOST_WEIGHTS];
  for (uint32_t l = 0; l < block->lights; l++) {
    const float *direction = all + 3 * (size_t)(block->light0 + l);
    const double light[3] = {(double)direction[0], (double)direction[1], (double)direction[2]};
    map->weigh(map, light, weights);
    for (uint32_t row = 0; row < block->height; row++)
      for (uint32_t column = 0; column < block->width; column++) {
        double values[3];
        map->texel(map, block->x0 + column, block->y0 + row, weights, values);
        for (uint32_t c = 0; c < 3; c++) {
          const float value = (float)(map->srgb ? srgb_linear(values[c]) : values[c]);
          memcpy((char *)dst + (ptrdiff_t)l * strides->light + (ptrdiff_t)row * strides->y +
                     (ptrdiff_t)column * strides->x + (ptrdiff_t)c * strides->channel,
                 &value, sizeof value);
        }
      }
  }
  return BTF_OK;
}

btf_status one_view_create(one_view *map, const btf_options *options, const char *path, const char *reader,
                           const char *kind, btf_dataset **out) {
  static const float above[3] = {0, 0, 1};
  const btf_host *host = map->file.host;
  btf_context *ctx = map->file.ctx;
  map->srgb = (int)(host->option)(options, "transfer") == 0;
  const char *const notes[] = {
      "reader", reader, "transfer", map->srgb ? "srgb" : "linear", kind != NULL ? "rti_kind" : NULL,
      kind,     NULL};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  char name[SOURCE_NAME_BYTES];
  btf_status status =
      (host->dirset_create_named)(ctx, (host->option_text)(options, "directions"), &map->lights);
  if (status == BTF_OK) status = (host->dirset_create)(ctx, above, 1, &map->views);
  if (status != BTF_OK) {
    one_view_close(map);
    return status;
  }
  source_name(path, name);
  desc.lights = map->lights;
  desc.views = map->views;
  desc.width = map->width;
  desc.height = map->height;
  desc.channels = 3;
  desc.wrap = BTF_WRAP_CLAMP; /* a photographed thing has no neighbours of its own kind */
  desc.quantity = BTF_QUANTITY_BRDF_COS;
  desc.flags = BTF_DATASET_CONCURRENT_READ;
  desc.name = name;
  desc.read = read_block;
  desc.user = map;
  desc.release = release;
  desc.notes = notes;
  return (host->dataset_create)(ctx, &desc, out);
}
