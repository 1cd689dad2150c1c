/* SPDX-License-Identifier: MIT */
/* load.c: from payload chunks to a state, with every size and every index checked against the shape. */
#include "lpca.h"

#include <math.h>
#include <string.h>

#include <btf/btf_sampling.h>

typedef struct loading {
  const btf_host *host;
  btf_context *ctx;
  const btf_model_shape *shape;
  btf_chunk_reader *payload;
  btfi_lpca_state *state;
} loading;

static btf_status get_head(loading *l) {
  const btf_host *host = l->host;
  btfi_lpca_head *head = &l->state->head;
  const void *data;
  BTF_TRY(btf_get_chunk(host, l->ctx, l->payload, "lpca", LPCA_TAG_HEAD, 0, LPCA_HEAD_BYTES, &data));
  const unsigned char *bytes = data;
  uint32_t *const words[] = {&head->storage,    &head->packing, &head->clusters,
                             &head->components, &head->levels,  &head->reserved};
  double *const numbers[] = {&head->squared_error, &head->energy, &head->outside};
  for (size_t i = 0; i < 6; i++) *words[i] = btf_get_u32(bytes + 4 * i);
  for (size_t i = 0; i < 3; i++) {
    *numbers[i] = btf_get_f64(bytes + 24 + 8 * i);
    if (!isfinite(*numbers[i]) || *numbers[i] < 0.0)
      return host->fail(l->ctx, BTF_E_CORRUPT, "lpca: number %u of the header is not finite or negative",
                        (unsigned)i);
  }
  const uint32_t most_levels = host->mip_count(l->shape->width, l->shape->height);
  if (head->storage >= LPCA_STORAGES || head->packing >= LPCA_PACKINGS || head->reserved != 0)
    return host->fail(l->ctx, BTF_E_CORRUPT, "lpca: unknown storage %u, packing %u or flags %u",
                      head->storage, head->packing, head->reserved);
  if (head->clusters < 1 || head->clusters > LPCA_MAX_CLUSTERS)
    return host->fail(l->ctx, BTF_E_CORRUPT, "lpca: %u clusters; 1 to %d are possible", head->clusters,
                      LPCA_MAX_CLUSTERS);
  if (head->components < 1 || head->components > LPCA_MAX_COMPONENTS)
    return host->fail(l->ctx, BTF_E_CORRUPT, "lpca: %u components; 1 to %d are possible", head->components,
                      LPCA_MAX_COMPONENTS);
  if (head->levels < 1 || head->levels > most_levels || head->levels > LPCA_MAX_LEVELS)
    return host->fail(l->ctx, BTF_E_CORRUPT, "lpca: %u levels of detail; %u are possible", head->levels,
                      most_levels);
  if (l->shape->channels < 1 || l->shape->channels > LPCA_MAX_CHANNELS)
    return host->fail(l->ctx, BTF_E_CORRUPT, "lpca: %u channels; 1 to %d are possible", l->shape->channels,
                      LPCA_MAX_CHANNELS);
  return BTF_OK;
}

/* Scales of tables as kernels take them: 0 beyond the components. */
static btf_status get_scales(loading *l) {
  btfi_lpca_state *s = l->state;
  const uint32_t components = s->layout.components, padded = s->layout.padded, clusters = s->layout.clusters;
  const uint64_t values = (uint64_t)clusters * (padded + LPCA_LANES);
  const float unit = s->layout.storage == LPCA_Q8 ? 1.0f / 127.0f : 1.0f;
  const void *data;
  BTF_TRY(btf_get_chunk(l->host, l->ctx, l->payload, "lpca", LPCA_TAG_SCALES, 0,
                        (uint64_t)clusters * (components + 1) * 4, &data));
  s->scales = l->host->alloc(l->ctx, values, sizeof *s->scales);
  if (s->scales == NULL) return BTF_E_NOMEM;
  memset(s->scales, 0, values * sizeof *s->scales);
  const unsigned char *src = data;
  for (uint32_t k = 0; k < clusters; k++) {
    float *dst = s->scales + (size_t)k * (padded + LPCA_LANES);
    for (uint32_t j = 0; j <= components; j++, src += 4) {
      const float scale = btf_get_f32(src);
      if (!isfinite(scale))
        return l->host->fail(l->ctx, BTF_E_CORRUPT, "lpca: scale %u of cluster %u is not finite", j, k);
      if (j == 0) {
        dst[padded] = scale;
      } else {
        dst[j - 1] = scale * unit;
      }
    }
  }
  return BTF_OK;
}

/* Indices become addresses: all are looked at. */
static btf_status check_indices(loading *l, uint32_t level) {
  const btfi_lpca_layout *layout = &l->state->layout;
  const uint64_t texels = (uint64_t)layout->level_width[level] * layout->level_height[level];
  const unsigned char *index = l->state->index[level];
  uint32_t largest = 0;
  if (layout->index_bytes == 1) {
    for (uint64_t i = 0; i < texels; i++) largest = index[i] > largest ? index[i] : largest;
  } else {
    for (uint64_t i = 0; i < texels; i++) {
      const uint32_t label = index[2 * i] | (uint32_t)index[2 * i + 1] << 8;
      largest = label > largest ? label : largest;
    }
  }
  if (largest < layout->clusters) return BTF_OK;
  return l->host->fail(l->ctx, BTF_E_CORRUPT, "lpca: a texel of level %u is in cluster %u of %u", level,
                       largest, layout->clusters);
}

static btf_status load_state(loading *l) {
  const btf_host *host = l->host;
  btfi_lpca_state *s = l->state;
  const void *data;
  BTF_TRY(get_head(l));
  s->layout.storage = s->head.storage;
  s->layout.packing = s->head.packing;
  s->layout.clusters = s->head.clusters;
  s->layout.components = s->head.components;
  s->layout.levels = s->head.levels;
  if (!btfi_lpca_layout_of(l->shape, host->dirset_count(l->shape->lights),
                           host->dirset_count(l->shape->views), &s->layout))
    return host->fail(l->ctx, BTF_E_CORRUPT, "lpca: the tables of %u clusters would not fit 64 bits",
                      s->head.clusters);
  BTF_TRY(get_scales(l));
  BTF_TRY(
      btf_get_chunk(host, l->ctx, l->payload, "lpca", LPCA_TAG_FACTORS, 0, s->layout.factors_bytes, &data));
  s->factors = data;
  s->resident = sizeof *s + s->layout.factors_bytes +
                sizeof(float) * s->layout.clusters * ((uint64_t)s->layout.padded + LPCA_LANES);
  for (uint32_t level = 0; level < s->layout.levels; level++) {
    BTF_TRY(btf_get_chunk(host, l->ctx, l->payload, "lpca", LPCA_TAG_CLUSTERS, level,
                          s->layout.index_table_bytes[level], &data));
    s->index[level] = data;
    BTF_TRY(check_indices(l, level));
    BTF_TRY(btf_get_chunk(host, l->ctx, l->payload, "lpca", LPCA_TAG_WEIGHTS, level,
                          s->layout.weight_table_bytes[level], &data));
    s->weights[level] = data;
    s->resident += s->layout.index_table_bytes[level] + s->layout.weight_table_bytes[level];
  }
  s->host = host;
  s->light_set = l->shape->lights;
  s->view_set = l->shape->views;
  s->wrap = l->shape->wrap;
  s->channel_bytes = (uint64_t)s->layout.stride * s->layout.factor_bytes;
  s->shade = btfi_lpca_shade_of(host->isa(l->ctx), s->layout.storage);
  return BTF_OK;
}

btf_status btfi_lpca_load(const btf_host *host, btf_context *ctx, uint32_t format,
                          const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  loading l = {host, ctx, shape, payload, host->alloc(ctx, 1, sizeof *l.state)};
  (void)format;
  *state = NULL;
  if (l.state == NULL) return BTF_E_NOMEM;
  memset(l.state, 0, sizeof *l.state);
  const btf_status status = load_state(&l);
  if (status == BTF_OK) {
    *state = l.state;
  } else {
    btfi_lpca_destroy(host, ctx, l.state);
  }
  return status;
}

void btfi_lpca_destroy(const btf_host *host, btf_context *ctx, void *state) {
  btfi_lpca_state *s = state;
  if (s == NULL) return;
  host->free(ctx, s->scales);
  host->free(ctx, s);
}
