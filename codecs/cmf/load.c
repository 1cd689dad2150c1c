/* SPDX-License-Identifier: MIT */
/* load.c: from payload chunks to a state, with every size, count and index checked. */
#include <math.h>

#include <btf/btf_half.h>

#include "cmf.h"

/* Beyond any product of scales, so that no value overflows. */
#define CMF_LARGEST_VALUE 1e30

typedef struct loading {
  const btf_host *host;
  btf_context *ctx;
  const btf_model_shape *shape;
  btf_chunk_reader *payload;
  btfi_cmf_state *state;
  btfi_cmf_head head;
} loading;

static uint64_t level_texels(const loading *l, uint32_t level) {
  return (uint64_t)btf_sampling_level_size(l->shape->width, level) *
         btf_sampling_level_size(l->shape->height, level);
}

static btf_status get_head(loading *l) {
  btfi_cmf_head *head = &l->head;
  const void *data;
  BTF_TRY(btf_get_chunk(l->host, l->ctx, l->payload, "cmf", CMF_TAG_HEAD, 0, CMF_HEAD_BYTES, &data));
  btfi_cmf_get_head(data, head);
  const uint32_t flags = CMF_FLAG_CODEBOOK | CMF_FLAG_ROTATED | CMF_FLAG_SIGNED | CMF_FLAG_CUBE;
  const uint32_t most_levels = l->host->mip_count(l->shape->width, l->shape->height);
  if (head->storage >= CMF_STORAGES || (head->flags & ~flags) != 0)
    return l->host->fail(l->ctx, BTF_E_CORRUPT, "cmf: unknown storage %u or flags %u", head->storage,
                         head->flags);
  if (head->edge < CMF_MIN_EDGE || head->edge > CMF_MAX_EDGE)
    return l->host->fail(l->ctx, BTF_E_CORRUPT, "cmf: maps of edge %u; %d to %d are possible", head->edge,
                         CMF_MIN_EDGE, CMF_MAX_EDGE);
  if (head->levels < 1 || head->levels > most_levels || head->levels > CMF_MAX_LEVELS)
    return l->host->fail(l->ctx, BTF_E_CORRUPT, "cmf: %u levels of detail; %u are possible", head->levels,
                         most_levels);
  if (head->stages < 1 || head->stages > CMF_MAX_STAGES)
    return l->host->fail(l->ctx, BTF_E_CORRUPT, "cmf: %u stages; 1 to %d are possible", head->stages,
                         CMF_MAX_STAGES);
  for (uint32_t s = 0; s < head->stages; s++) {
    const uint32_t *projection = head->stage[s].projection;
    if (projection[0] >= CMF_PROJECTIONS || (projection[1] >= CMF_PROJECTIONS && projection[1] != CMF_ONE) ||
        head->stage[s].terms < 1 || head->stage[s].terms > CMF_MAX_TERMS)
      return l->host->fail(l->ctx, BTF_E_CORRUPT, "cmf: stage %u has projections %u and %u and %u terms", s,
                           projection[0], projection[1], head->stage[s].terms);
  }
  return BTF_OK;
}

static void make_factors(loading *l) {
  btfi_cmf_state *s = l->state;
  s->scales = 1;
  for (uint32_t stage = 0; stage < l->head.stages; stage++) {
    const uint32_t terms = l->head.stage[stage].terms;
    const uint32_t sides = l->head.stage[stage].projection[1] == CMF_ONE ? 1 : 2;
    for (uint32_t term = 0; term < terms; term++) {
      const uint32_t ratio = term > 0 ? s->scales++ : 0;
      for (uint32_t side = 0; side < sides; side++) {
        btfi_cmf_state_factor *f = &s->factor[s->factors++];
        f->projection = l->head.stage[stage].projection[side];
        f->stage = stage;
        f->term = term;
        f->ratio = ratio;
        f->opens_term = side == 0;
        f->opens_stage = f->opens_term && term == 0;
        f->ends_term = side + 1 == sides;
        f->ends_stage = f->ends_term && term + 1 == terms;
        btfi_cmf_decoding(s->storage, term > 0 && (l->head.flags & CMF_FLAG_SIGNED), &f->gain, &f->offset);
        s->projections |= 1u << f->projection;
      }
    }
  }
}

/* Stored floats must be finite and within -1 .. 1. */
static btf_status check_values(const loading *l, const char *what, const unsigned char *data,
                               uint64_t count) {
  bool good = true;
  if (l->head.storage == CMF_F16) {
    for (uint64_t i = 0; i < count; i++) {
      uint16_t half;
      memcpy(&half, data + 2 * i, sizeof half);
      good &= (half & 0x7fff) <= 0x3c00;
    }
  } else if (l->head.storage == CMF_F32) {
    for (uint64_t i = 0; i < count; i++) {
      uint32_t bits;
      memcpy(&bits, data + 4 * i, sizeof bits);
      good &= (bits & 0x7fffffff) <= 0x3f800000;
    }
  }
  return good ? BTF_OK : l->host->fail(l->ctx, BTF_E_CORRUPT, "cmf: %s hold a value beyond -1 .. 1", what);
}

/* Largest values of the scales: S, then the ratios. */
static btf_status get_globals(loading *l) {
  btfi_cmf_state *s = l->state;
  const uint32_t count = s->scales * s->channels;
  const void *data;
  BTF_TRY(btf_get_chunk(l->host, l->ctx, l->payload, "cmf", CMF_TAG_GLOBAL, 0, 4 * (uint64_t)count, &data));
  for (uint32_t i = 0; i < count; i++) {
    s->global[i] = btf_get_f32((const unsigned char *)data + 4 * (size_t)i);
    if (!(s->global[i] >= 0.0f && s->global[i] <= (float)CMF_LARGEST_VALUE))
      return l->host->fail(l->ctx, BTF_E_CORRUPT, "cmf: scale %u is negative or beyond 1e30", i);
  }
  for (uint32_t c = 0; c < s->channels; c++) {
    double most = (double)s->global[c], stage = 0.0;
    for (uint32_t f = 0; f < s->factors; f++) {
      const btfi_cmf_state_factor *factor = &s->factor[f];
      if (!factor->opens_term) continue;
      if (factor->opens_stage) most *= fmax(stage, 1.0);
      stage = (factor->opens_stage ? 0.0 : stage) +
              (factor->ratio > 0 ? (double)s->global[factor->ratio * s->channels + c] : 1.0);
    }
    if (!(most * fmax(stage, 1.0) <= CMF_LARGEST_VALUE))
      return l->host->fail(l->ctx, BTF_E_CORRUPT, "cmf: the values of channel %u could exceed 1e30", c);
  }
  return BTF_OK;
}

static btf_status get_codebooks(loading *l) {
  btfi_cmf_state *s = l->state;
  uint32_t most = 1;
  for (uint32_t f = 0; f < s->factors; f++) {
    const void *data;
    uint64_t size;
    BTF_TRY(l->host->get(l->payload, CMF_TAG_MAPS, f, &data, &size));
    const uint64_t entries = size / s->entry_bytes;
    if (entries < 1 || entries > CMF_MAX_CODEBOOK || entries * s->entry_bytes != size)
      return l->host->fail(l->ctx, BTF_E_CORRUPT,
                           "cmf: codebook %u has %llu bytes; 1 to %d entries of %llu are possible", f,
                           (unsigned long long)size, CMF_MAX_CODEBOOK, (unsigned long long)s->entry_bytes);
    BTF_TRY(check_values(l, "codebooks", data, size / btfi_cmf_value_bytes(s->storage)));
    s->codebook[f] = data;
    s->entries[f] = (uint32_t)entries;
    if (s->entries[f] > most) most = s->entries[f];
    s->resident += size;
  }
  s->index_bytes = most <= 256 ? 1 : 2;
  return BTF_OK;
}

static btf_status get_indices(loading *l, uint32_t level) {
  btfi_cmf_state *s = l->state;
  const uint64_t count = level_texels(l, level) * s->factors;
  const void *data;
  BTF_TRY(
      btf_get_chunk(l->host, l->ctx, l->payload, "cmf", CMF_TAG_INDEX, level, count * s->index_bytes, &data));
  const unsigned char *bytes = data;
  for (uint64_t i = 0; i < count; i++) {
    const uint32_t entry = s->index_bytes == 1 ? bytes[i] : bytes[2 * i] | (uint32_t)bytes[2 * i + 1] << 8;
    if (entry >= s->entries[i % s->factors])
      return l->host->fail(l->ctx, BTF_E_CORRUPT, "cmf: index %u of level %u, codebook %u has %u entries",
                           entry, level, (uint32_t)(i % s->factors), s->entries[i % s->factors]);
  }
  s->index[level] = bytes;
  s->resident += count * s->index_bytes;
  return BTF_OK;
}

static btf_status get_tables(loading *l, uint32_t level) {
  btfi_cmf_state *s = l->state;
  const uint64_t size = level_texels(l, level) * s->entry_bytes;
  for (uint32_t f = 0; f < s->factors; f++) {
    const void *data;
    BTF_TRY(btf_get_chunk(l->host, l->ctx, l->payload, "cmf", CMF_TAG_MAPS, level * CMF_MAX_FACTORS + f, size,
                          &data));
    BTF_TRY(check_values(l, "maps", data, size / btfi_cmf_value_bytes(s->storage)));
    s->table[level][f] = data;
    s->resident += size;
  }
  return BTF_OK;
}

static btf_status get_level(loading *l, uint32_t level) {
  btfi_cmf_state *s = l->state;
  const uint64_t scales = level_texels(l, level) * s->scales * s->channels;
  const uint64_t bytes = scales * btfi_cmf_value_bytes(s->storage);
  const void *data;
  BTF_TRY(l->head.flags & CMF_FLAG_CODEBOOK ? get_indices(l, level) : get_tables(l, level));
  BTF_TRY(btf_get_chunk(l->host, l->ctx, l->payload, "cmf", CMF_TAG_SCALE, level, bytes, &data));
  BTF_TRY(check_values(l, "scales", data, scales));
  s->scale[level] = data;
  s->resident += bytes;
  if (!(l->head.flags & CMF_FLAG_ROTATED)) return BTF_OK;
  BTF_TRY(
      btf_get_chunk(l->host, l->ctx, l->payload, "cmf", CMF_TAG_ANGLE, level, level_texels(l, level), &data));
  s->angle[level] = data;
  s->resident += level_texels(l, level);
  return BTF_OK;
}

static btf_status load_state(loading *l) {
  btfi_cmf_state *s = l->state;
  BTF_TRY(get_head(l));
  s->host = l->host;
  s->light_set = l->shape->lights;
  s->view_set = l->shape->views;
  s->width = l->shape->width;
  s->height = l->shape->height;
  s->channels = l->shape->channels;
  s->wrap = l->shape->wrap;
  s->levels = l->head.levels;
  s->storage = l->head.storage;
  s->edge = l->head.edge;
  s->cube = (l->head.flags & CMF_FLAG_CUBE) != 0;
  s->row_values = s->channels * s->edge;
  s->entry_bytes = (uint64_t)s->row_values * s->edge * btfi_cmf_value_bytes(s->storage);
  s->resident = sizeof *s;
  make_factors(l);
  BTF_TRY(get_globals(l));
  if (l->head.flags & CMF_FLAG_CODEBOOK) BTF_TRY(get_codebooks(l));
  for (uint32_t level = 0; level < s->levels; level++) BTF_TRY(get_level(l, level));
  for (int i = 0; i < CMF_TURN; i++) {
    const double angle = 2.0 * 3.14159265358979323846 * i / CMF_TURN;
    s->cosine[i] = (float)cos(angle);
    s->sine[i] = (float)sin(angle);
  }
  s->blend = btfi_cmf_blend_of(l->host->isa(l->ctx), s->storage, s->channels, s->edge);
  return BTF_OK;
}

btf_status btfi_cmf_load(const btf_host *host, btf_context *ctx, uint32_t format,
                         const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  loading l = {.host = host, .ctx = ctx, .shape = shape, .payload = payload};
  (void)format;
  *state = NULL;
  l.state = host->alloc(ctx, 1, sizeof *l.state);
  if (l.state == NULL) return BTF_E_NOMEM;
  memset(l.state, 0, sizeof *l.state);
  const btf_status status = load_state(&l);
  if (status == BTF_OK) {
    *state = l.state;
  } else {
    btfi_cmf_destroy(host, ctx, l.state);
  }
  return status;
}

void btfi_cmf_destroy(const btf_host *host, btf_context *ctx, void *state) {
  host->free(ctx, state);
}
