/* SPDX-License-Identifier: MIT */
/* load.c: from payload chunks to a state, with every size checked against the shape. */
#include "pvpca.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

typedef struct loading {
  const btf_host *host;
  btf_context *ctx;
  const btf_model_shape *shape;
  btf_chunk_reader *payload;
  btfi_pvpca_state *state;
} loading;

static btf_status get_head(loading *l) {
  const btf_host *host = l->host;
  btfi_pvpca_head *head = &l->state->head;
  const void *data;
  BTF_TRY(btf_get_chunk(host, l->ctx, l->payload, "pvpca", PVPCA_TAG_HEAD, 0, PVPCA_HEAD_BYTES, &data));
  const unsigned char *bytes = data;
  head->color = btf_get_u32(bytes);
  head->storage = btf_get_u32(bytes + 4);
  head->levels = btf_get_u32(bytes + 8);
  head->flags = btf_get_u32(bytes + 12);
  head->terms = btf_get_u32(bytes + 16);
  head->squared_error = btf_get_f64(bytes + 24);
  head->energy = btf_get_f64(bytes + 32);
  const uint32_t most_levels = host->mip_count(l->shape->width, l->shape->height);
  if (head->color >= PVPCA_COLORS || head->storage >= PVPCA_STORAGES || head->flags > PVPCA_FLAG_MEAN ||
      btf_get_u32(bytes + 20) != 0)
    return host->fail(l->ctx, BTF_E_CORRUPT, "pvpca: unknown color %u, storage %u or flags %u", head->color,
                      head->storage, head->flags);
  if (head->levels < 1 || head->levels > most_levels || head->levels > PVPCA_MAX_LEVELS)
    return host->fail(l->ctx, BTF_E_CORRUPT, "pvpca: %u levels of detail; %u are possible", head->levels,
                      most_levels);
  if (!isfinite(head->squared_error) || head->squared_error < 0.0 || !isfinite(head->energy) ||
      head->energy < 0.0)
    return host->fail(l->ctx, BTF_E_CORRUPT, "pvpca: an energy of the header is not finite or negative");
  return BTF_OK;
}

static btf_status get_terms(loading *l) {
  btfi_pvpca_state *s = l->state;
  btfi_pvpca_layout *layout = &s->layout;
  const void *data;
  layout->channels = l->shape->channels;
  layout->lights = l->host->dirset_count(l->shape->lights);
  layout->views = l->host->dirset_count(l->shape->views);
  layout->width = l->shape->width;
  layout->height = l->shape->height;
  layout->storage = s->head.storage;
  layout->color = s->head.color;
  layout->levels = s->head.levels;
  layout->has_mean = s->head.flags & PVPCA_FLAG_MEAN;
  if (layout->channels > PVPCA_MAX_CHANNELS)
    return l->host->fail(l->ctx, BTF_E_CORRUPT, "pvpca: %u channels; 1 to %d are possible", layout->channels,
                         PVPCA_MAX_CHANNELS);
  BTF_TRY(btf_get_chunk(l->host, l->ctx, l->payload, "pvpca", PVPCA_TAG_TERMS, 0, 4 * (uint64_t)layout->views,
                        &data));
  s->views = l->host->alloc(l->ctx, layout->views, sizeof *s->views);
  if (s->views == NULL) return BTF_E_NOMEM;
  memset(s->views, 0, layout->views * sizeof *s->views);
  for (uint32_t v = 0; v < layout->views; v++) {
    s->views[v].terms = btf_get_u32((const unsigned char *)data + 4 * (size_t)v);
    if (s->views[v].terms > PVPCA_MAX_TERMS)
      return l->host->fail(l->ctx, BTF_E_CORRUPT, "pvpca: view %u has %u components; up to %d are possible",
                           v, s->views[v].terms, PVPCA_MAX_TERMS);
  }
  if (!btfi_pvpca_layout_of(layout, s->views))
    return l->host->fail(l->ctx, BTF_E_CORRUPT, "pvpca: the tables would not fit 64 bits");
  s->components = l->host->alloc(l->ctx, layout->views, sizeof *s->components);
  if (s->components == NULL) return BTF_E_NOMEM;
  for (uint32_t v = 0; v < layout->views; v++) {
    const uint32_t columns = s->views[v].columns > 0 ? s->views[v].columns : 1;
    s->components[v] = columns * layout->h_channels;
  }
  if (layout->terms != s->head.terms)
    return l->host->fail(l->ctx, BTF_E_CORRUPT, "pvpca: views have %u components in all, the header %u",
                         layout->terms, s->head.terms);
  return BTF_OK;
}

static btf_status get_scales(loading *l) {
  btfi_pvpca_state *s = l->state;
  const float unit = btfi_pvpca_unit(s->layout.storage);
  const void *data;
  BTF_TRY(
      btf_get_chunk(l->host, l->ctx, l->payload, "pvpca", PVPCA_TAG_SCALES, 0, 4 * s->layout.scales, &data));
  s->scales = l->host->alloc(l->ctx, s->layout.padded_scales + 1, sizeof *s->scales);
  if (s->scales == NULL) return BTF_E_NOMEM;
  memset(s->scales, 0, (s->layout.padded_scales + 1) * sizeof *s->scales);
  for (uint32_t v = 0; v < s->layout.views; v++) {
    btfi_pvpca_view *view = &s->views[v];
    for (uint32_t i = 0; i < view->columns; i++) {
      const float scale = btf_get_f32((const unsigned char *)data + 4 * (view->scale_start + i));
      if (!isfinite(scale) || scale < 0.0f)
        return l->host->fail(l->ctx, BTF_E_CORRUPT, "pvpca: scale %u of view %u is not finite or negative", i,
                             v);
      if (i < s->layout.has_mean)
        view->mean_scale = scale / unit;
      else
        s->scales[view->padded_start + i - s->layout.has_mean] = scale / unit;
    }
  }
  return BTF_OK;
}

/* The tables are the chunks themselves. Their values are not looked at, so that loading takes the same time
 * whatever their size. */
static btf_status get_tables(loading *l) {
  btfi_pvpca_state *s = l->state;
  const void *data;
  BTF_TRY(
      btf_get_chunk(l->host, l->ctx, l->payload, "pvpca", PVPCA_TAG_WEIGHTS, 0, s->layout.g_bytes, &data));
  s->g = data;
  s->resident = sizeof *s + s->layout.views * (sizeof *s->views + sizeof *s->components) +
                s->layout.padded_scales * sizeof *s->scales + s->layout.g_bytes;
  for (uint32_t level = 0; level < s->layout.levels; level++) {
    BTF_TRY(btf_get_chunk(l->host, l->ctx, l->payload, "pvpca", PVPCA_TAG_TEXTURES, level,
                          s->layout.h_bytes[level], &data));
    s->h[level] = data;
    s->resident += s->layout.h_bytes[level];
  }
  return BTF_OK;
}

static btf_status load_state(loading *l) {
  btfi_pvpca_state *s = l->state;
  const btfi_pvpca_kernels *kernels = btfi_pvpca_kernels_of(l->host->isa(l->ctx));
  BTF_TRY(get_head(l));
  BTF_TRY(get_terms(l));
  BTF_TRY(get_scales(l));
  BTF_TRY(get_tables(l));
  s->host = l->host;
  s->light_set = l->shape->lights;
  s->view_set = l->shape->views;
  s->wrap = l->shape->wrap;
  s->weigh = kernels->weigh[btfi_pvpca_weight_storage(s->layout.storage)];
  s->shade = kernels->shade[s->layout.color][s->layout.storage];
  return BTF_OK;
}

btf_status btfi_pvpca_load(const btf_host *host, btf_context *ctx, uint32_t format,
                           const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  loading l = {host, ctx, shape, payload, NULL};
  (void)format;
  *state = NULL;
  l.state = host->alloc(ctx, 1, sizeof *l.state);
  if (l.state == NULL) return BTF_E_NOMEM;
  memset(l.state, 0, sizeof *l.state);
  const btf_status status = load_state(&l);
  if (status == BTF_OK)
    *state = l.state;
  else
    btfi_pvpca_destroy(host, ctx, l.state);
  return status;
}

void btfi_pvpca_destroy(const btf_host *host, btf_context *ctx, void *state) {
  btfi_pvpca_state *s = state;
  if (s == NULL) return;
  host->free(ctx, s->views);
  host->free(ctx, s->scales);
  host->free(ctx, s->components);
  host->free(ctx, s);
}
