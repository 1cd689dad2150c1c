/* SPDX-License-Identifier: MIT */
/* load.c: from payload chunks to a state. */
#include "lafortune.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>
#include <btf/btf_half.h>
#include <btf/btf_sampling.h>

/* Bytes that a kernel may read beyond a record: vectors of 8 floats. */
enum { READ_BEYOND = 32 };

static btf_status get_head(const btf_host *host, btf_context *ctx, const btf_model_shape *shape,
                           btf_chunk_reader *payload, btfi_lafortune_head *head) {
  const void *data;
  BTF_TRY(btf_get_chunk(host, ctx, payload, "lafortune", LAF_TAG_HEAD, 0, LAF_HEAD_BYTES, &data));
  const unsigned char *bytes = data;
  uint32_t *const words[] = {&head->kind,    &head->lobes,  &head->colour,
                             &head->storage, &head->levels, &head->flags};
  for (size_t i = 0; i < 6; i++) *words[i] = btf_get_u32(bytes + 4 * i);
  head->squared_error = btf_get_f64(bytes + 24);
  head->energy = btf_get_f64(bytes + 32);
  const uint32_t most_levels = host->mip_count(shape->width, shape->height);
  if (head->kind >= LAF_KINDS || head->colour > LAF_CHANNEL || head->storage > LAF_F16 || head->flags != 0)
    return host->fail(ctx, BTF_E_CORRUPT, "lafortune: unknown kind %u, colour %u, storage %u or flags %u",
                      head->kind, head->colour, head->storage, head->flags);
  if (head->lobes < 1 || head->lobes > LAF_MAX_LOBES)
    return host->fail(ctx, BTF_E_CORRUPT, "lafortune: %u lobes; 1 to %d are possible", head->lobes,
                      LAF_MAX_LOBES);
  if (head->levels < 1 || head->levels > most_levels || head->levels > LAF_MAX_LEVELS)
    return host->fail(ctx, BTF_E_CORRUPT, "lafortune: %u levels of detail; %u are possible", head->levels,
                      most_levels);
  if (!(head->squared_error >= 0.0 && head->squared_error < INFINITY && head->energy >= 0.0 &&
        head->energy < INFINITY))
    return host->fail(ctx, BTF_E_CORRUPT, "lafortune: the error in the header is negative or not finite");
  return BTF_OK;
}

static bool all_finite(uint32_t storage, const unsigned char *values, uint64_t count) {
  bool finite = true;
  if (storage == LAF_F16) {
    for (uint64_t i = 0; i < count; i++) {
      uint16_t half;
      memcpy(&half, values + 2 * i, sizeof half);
      finite &= (half & 0x7c00u) != 0x7c00u;
    }
  } else {
    for (uint64_t i = 0; i < count; i++) {
      uint32_t bits;
      memcpy(&bits, values + 4 * i, sizeof bits);
      finite &= (bits & 0x7f800000u) != 0x7f800000u;
    }
  }
  return finite;
}

static btf_status load_levels(const btf_host *host, btf_context *ctx, const btf_model_shape *shape,
                              btf_chunk_reader *payload, btfi_lafortune_state *s) {
  const btfi_lafortune_layout *layout = &s->layout;
  const uint64_t record = (uint64_t)layout->values * layout->value_bytes;
  const void *scales;
  BTF_TRY(btf_get_chunk(host, ctx, payload, "lafortune", LAF_TAG_SCALE, 0, 4 * (uint64_t)s->levels, &scales));
  for (uint32_t level = 0; level < s->levels && level < LAF_MAX_LEVELS; level++) {
    s->level_width[level] = btf_sampling_level_size(shape->width, level);
    s->level_height[level] = btf_sampling_level_size(shape->height, level);
    const uint64_t texels = (uint64_t)s->level_width[level] * s->level_height[level];
    const void *data;
    uint64_t size;
    if (__builtin_mul_overflow(texels, record, &size))
      return host->fail(ctx, BTF_E_CORRUPT, "lafortune: the texels of level %u would not fit 64 bits", level);
    BTF_TRY(btf_get_chunk(host, ctx, payload, "lafortune", LAF_TAG_TEXELS, level, size, &data));
    if (!all_finite(layout->storage, data, texels * layout->values))
      return host->fail(ctx, BTF_E_CORRUPT, "lafortune: level %u has a value that is not finite", level);
    s->scale[level] = btf_get_f32((const unsigned char *)scales + 4 * level);
    if (!(s->scale[level] > 0.0f && s->scale[level] < INFINITY))
      return host->fail(ctx, BTF_E_CORRUPT, "lafortune: the scale of level %u is not a positive number",
                        level);
    s->texels[level] = data;
    s->safe_end[level] = s->texels[level] + (size > record + READ_BEYOND ? size - record - READ_BEYOND : 0);
    s->resident += size;
  }
  return BTF_OK;
}

static btf_status load_state(const btf_host *host, btf_context *ctx, const btf_model_shape *shape,
                             btf_chunk_reader *payload, btfi_lafortune_state *s) {
  BTF_TRY(get_head(host, ctx, shape, payload, &s->head));
  btfi_lafortune_layout_of(s->head.kind, s->head.lobes, s->head.colour, s->head.storage, shape->channels,
                           &s->layout);
  s->host = host;
  s->light_set = shape->lights;
  s->view_set = shape->views;
  s->kernels = btfi_lafortune_kernels_of(host->isa(ctx));
  s->times_cosine = shape->quantity == BTF_QUANTITY_BRDF_COS;
  s->wrap = shape->wrap;
  s->levels = s->head.levels;
  s->resident = sizeof *s;
  for (uint32_t i = 0; i < (1 + s->layout.lobes) * s->layout.group_channels; i++)
    s->lobe_of[i] = (int32_t)(i / s->layout.group_channels) - 1;
  return load_levels(host, ctx, shape, payload, s);
}

btf_status btfi_lafortune_load(const btf_host *host, btf_context *ctx, uint32_t format,
                               const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  btfi_lafortune_state *s = host->alloc(ctx, 1, sizeof *s);
  (void)format;
  *state = NULL;
  if (s == NULL) return BTF_E_NOMEM;
  memset(s, 0, sizeof *s);
  const btf_status status = load_state(host, ctx, shape, payload, s);
  if (status == BTF_OK)
    *state = s;
  else
    host->free(ctx, s);
  return status;
}

void btfi_lafortune_destroy(const btf_host *host, btf_context *ctx, void *state) {
  host->free(ctx, state);
}
