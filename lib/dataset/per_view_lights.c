/* SPDX-License-Identifier: MIT */
/* Measured sets whose lights differ between views: a sample at one of the common lights is interpolated from
 * up to three lights of its view's own list, in parabolic coordinates. */
#include "dataset/dataset_parts.h"

#include <string.h>

enum { slab_bytes = 16 << 20 };

btf_status btfi_per_view_prepare(btf_dataset *ds) {
  const uint32_t views = btf_dirset_count(ds->desc.views), lights = btf_dirset_count(ds->desc.lights);
  const float *direction = btf_dirset_directions(ds->desc.lights);
  ds->light_weights = btfi_alloc(ds->ctx, (uint64_t)views * lights, sizeof *ds->light_weights);
  if (!ds->light_weights) return btfi_alloc_status();
  for (uint32_t v = 0; v < views; ++v)
    for (uint32_t l = 0; l < lights; ++l)
      btf_dirset_locate(ds->desc.view_lights[v], direction + 3 * (size_t)l,
                        &ds->light_weights[(size_t)v * lights + l]);
  return BTF_OK;
}

/* Rows of one view of a block: the lights of its own that it needs lie in `own`, `texels` of them each. */
typedef struct view_slab {
  const btf_dataset *ds;
  const btf_interp *weights; /* of the view */
  uint32_t *slot;            /* of each of the view's own lights; UINT32_MAX = not needed */
  float *own, *mixed;
  size_t row; /* floats of one light */
} view_slab;

static uint32_t assign_slots(const view_slab *slab, uint32_t own_lights, uint32_t light0, uint32_t lights) {
  uint32_t used = 0;
  for (uint32_t m = 0; m < own_lights; ++m) slab->slot[m] = UINT32_MAX;
  for (uint32_t l = light0; l < light0 + lights; ++l)
    for (int k = 0; k < 3; ++k)
      if (slab->weights[l].weight[k] > 0.0f) slab->slot[slab->weights[l].index[k]] = 0;
  for (uint32_t m = 0; m < own_lights; ++m)
    if (slab->slot[m] != UINT32_MAX) slab->slot[m] = used++;
  return used;
}

static btf_status read_own_lights(const view_slab *slab, const btf_block *part, uint32_t own_lights) {
  const ptrdiff_t channels = (ptrdiff_t)slab->ds->desc.channels, size = (ptrdiff_t)sizeof(float);
  btf_strides s = {0, (ptrdiff_t)slab->row * size, channels * size * (ptrdiff_t)part->width, channels * size,
                   size};
  s.view = s.light;
  for (uint32_t m = 0; m < own_lights; ++m) {
    if (slab->slot[m] == UINT32_MAX) continue;
    uint32_t end = m + 1;
    while (end < own_lights && slab->slot[end] != UINT32_MAX) ++end;
    btf_block b = *part;
    b.light0 = m;
    b.lights = end - m;
    BTFI_TRY(btfi_read_samples(slab->ds, &b, slab->own + slab->slot[m] * slab->row, &s));
    m = end;
  }
  return BTF_OK;
}

static void mix(const view_slab *slab, const btf_interp *weights) {
  memset(slab->mixed, 0, slab->row * sizeof(float));
  for (int k = 0; k < 3; ++k) {
    const float weight = weights->weight[k];
    if (!(weight > 0.0f)) continue;
    const float *own = slab->own + slab->slot[weights->index[k]] * slab->row;
    for (size_t i = 0; i < slab->row; ++i) slab->mixed[i] += weight * own[i];
  }
}

static btf_status read_rows(view_slab *slab, const btf_block *part, uint32_t own_lights, char *dst,
                            const btf_strides *out) {
  const ptrdiff_t channels = (ptrdiff_t)slab->ds->desc.channels, size = (ptrdiff_t)sizeof(float);
  const btfi_convert_kernels kernels = btfi_convert_select(BTF_SAMPLE_F32, btfi_isa(slab->ds->ctx));
  const btfi_axis axes[3] = {{slab->ds->desc.channels, size, out->channel},
                             {part->width, channels * size, out->x},
                             {part->height, channels * size * (ptrdiff_t)part->width, out->y}};
  slab->row = (size_t)part->width * part->height * slab->ds->desc.channels;
  BTFI_TRY(read_own_lights(slab, part, own_lights));
  for (uint32_t l = 0; l < part->lights; ++l) {
    bool finite;
    mix(slab, &slab->weights[part->light0 + l]);
    BTFI_TRY(btfi_unpack_block(slab->ds->ctx, &kernels, axes, 3, slab->mixed, dst + (ptrdiff_t)l * out->light,
                               &finite));
    if (!finite)
      return btfi_fail(slab->ds->ctx, BTF_E_CORRUPT,
                       "%s: view %u, light %u: interpolation between samples overflows", slab->ds->label,
                       part->view0, part->light0 + l);
  }
  return BTF_OK;
}

static btf_status read_view(view_slab *slab, const btf_block *block, char *dst, const btf_strides *out) {
  const uint32_t own_lights = btf_dirset_count(slab->ds->desc.view_lights[block->view0]);
  const uint32_t used = assign_slots(slab, own_lights, block->light0, block->lights);
  /* The part of a row or the rows whose lights fit into memory together; `own` holds slab_bytes, or one
   * texel. */
  const uint64_t texel_bytes = (uint64_t)(used + 1) * slab->ds->desc.channels * sizeof(float);
  const uint64_t texels = BTFI_MAX(slab_bytes / texel_bytes, 1u);
  const uint32_t columns = (uint32_t)BTFI_MIN(texels, block->width);
  const uint32_t rows = (uint32_t)BTFI_MIN(BTFI_MAX(texels / columns, 1u), block->height);
  slab->own = btfi_alloc(slab->ds->ctx, (uint64_t)columns * rows, texel_bytes);
  if (!slab->own) return btfi_alloc_status();
  slab->mixed = slab->own + (size_t)used * columns * rows * slab->ds->desc.channels;
  btf_status status = BTF_OK;
  for (uint32_t y = 0; y < block->height && status == BTF_OK; y += rows)
    for (uint32_t x = 0; x < block->width && status == BTF_OK; x += columns) {
      btf_block part = *block;
      part.x0 += x;
      part.y0 += y;
      part.width = BTFI_MIN(columns, block->width - x);
      part.height = BTFI_MIN(rows, block->height - y);
      status = read_rows(slab, &part, own_lights, dst + (ptrdiff_t)y * out->y + (ptrdiff_t)x * out->x, out);
    }
  btfi_free(slab->ds->ctx, slab->own);
  return status;
}

btf_status btfi_per_view_read(const btf_dataset *ds, const btf_block *block, float *dst,
                              const btf_strides *strides) {
  const uint32_t lights = btf_dirset_count(ds->desc.lights);
  uint32_t most = 0;
  for (uint32_t v = 0; v < block->views; ++v)
    most = BTFI_MAX(most, btf_dirset_count(ds->desc.view_lights[block->view0 + v]));
  view_slab slab = {.ds = ds};
  slab.slot = btfi_alloc(ds->ctx, most, sizeof *slab.slot);
  if (!slab.slot) return btfi_alloc_status();
  btf_status status = BTF_OK;
  for (uint32_t v = 0; v < block->views && status == BTF_OK; ++v) {
    btf_block one = *block;
    one.view0 += v;
    one.views = 1;
    slab.weights = ds->light_weights + (size_t)one.view0 * lights;
    status = read_view(&slab, &one, (char *)dst + (ptrdiff_t)v * strides->view, strides);
  }
  btfi_free(ds->ctx, slab.slot);
  return status;
}
