/* SPDX-License-Identifier: MIT */
/* load.c: from payload chunks to a state, with every size checked against the shape. */
#include "laplacian.h"

#include <math.h>

#define LARGEST_VALUE 1e30

bool btfi_laplacian_layout_of(const btfi_laplacian_head *head, const btfi_laplacian_grid *grid,
                              uint32_t lights, uint32_t views, btfi_laplacian_layout *out) {
  memset(out, 0, sizeof *out);
  out->lights = lights;
  out->views = views;
  out->value_bytes = head->storage == LAPLACIAN_F32 ? 4 : 2;
  const uint64_t slack = (uint64_t)LAPLACIAN_SLACK * out->value_bytes;
  for (uint32_t k = 0; k < head->levels; k++) {
    uint32_t values = 0;
    for (uint32_t c = 0; c < 3; c++) {
      if (head->count[k][c] > LAPLACIAN_MAX_COMPONENTS + (k + 1 == head->levels ? 1u : 0u)) return false;
      values += head->count[k][c];
    }
    out->first[k + 1] = out->first[k] + values;
    out->texel_bytes[k] = (uint64_t)values * out->value_bytes;
    if (__builtin_mul_overflow(out->texel_bytes[k], (uint64_t)grid->width[k] * grid->height[k],
                               &out->weight_bytes[k]) ||
        __builtin_add_overflow(out->weight_bytes[k], slack, &out->weight_bytes[k]))
      return false;
  }
  /* Rows of 64 bytes or more in whole halves of cache lines, so that fewer lines are met. */
  const uint64_t bytes = (uint64_t)out->first[head->levels] * out->value_bytes, unit = bytes > 64 ? 32 : 8;
  out->row_bytes = (bytes + unit - 1) / unit * unit;
  return !__builtin_mul_overflow(out->row_bytes, (uint64_t)lights * views, &out->eigen_bytes) &&
         !__builtin_add_overflow(out->eigen_bytes, slack, &out->eigen_bytes);
}

/* ---- the little-endian structures ---- */

enum { NUMBERS = 11 };

static double *head_number(btfi_laplacian_head *head, uint32_t i) {
  double *const numbers[NUMBERS] = {&head->phong.ka,      &head->phong.kd,      &head->phong.ks,
                                    &head->phong.alpha,   &head->chroma[0],     &head->chroma[1],
                                    &head->mean_residual, &head->chroma_rms[0], &head->chroma_rms[1],
                                    &head->squared_error, &head->energy};
  return numbers[i];
}

void btfi_laplacian_put_head(const btfi_laplacian_head *head, unsigned char *bytes) {
  const uint32_t words[] = {head->filter, head->mean, head->storage, head->levels};
  btfi_laplacian_head copy = *head;
  for (uint32_t i = 0; i < 4; i++) btf_put_u32(bytes + 4 * i, words[i]);
  for (uint32_t i = 0; i < NUMBERS; i++) btf_put_f64(bytes + 16 + 8 * i, *head_number(&copy, i));
}

void btfi_laplacian_put_level(const btfi_laplacian_head *head, uint32_t k, unsigned char *bytes) {
  for (uint32_t c = 0; c < 3; c++, bytes += LAPLACIAN_LEVEL_BYTES / 3) {
    btf_put_u32(bytes, head->count[k][c]);
    btf_put_u32(bytes + 4, 0);
    btf_put_f64(bytes + 8, head->mean_norm[k][c]);
    btf_put_f64(bytes + 16, head->energy_of[k][c]);
    btf_put_f64(bytes + 24, head->residual[k][c]);
  }
}

/* ---- loading ---- */

typedef struct loading {
  const btf_host *host;
  btf_context *ctx;
  const btf_model_shape *shape;
  btf_chunk_reader *payload;
  btfi_laplacian_state *state;
} loading;

static btf_status get_chunk(const loading *l, uint32_t tag, uint32_t index, uint64_t size,
                            const void **data) {
  return btf_get_chunk(l->host, l->ctx, l->payload, "laplacian", tag, index, size, data);
}

static btf_status get_head(loading *l) {
  const btf_host *host = l->host;
  btfi_laplacian_head *head = &l->state->head;
  const void *data;
  BTF_TRY(get_chunk(l, LAPLACIAN_TAG_HEAD, 0, LAPLACIAN_HEAD_BYTES, &data));
  const unsigned char *bytes = data;
  uint32_t *const words[] = {&head->filter, &head->mean, &head->storage, &head->levels};
  for (uint32_t i = 0; i < 4; i++) *words[i] = btf_get_u32(bytes + 4 * i);
  for (uint32_t i = 0; i < NUMBERS; i++) {
    double *number = head_number(head, i);
    *number = btf_get_f64(bytes + 16 + 8 * i);
    /* What the mean is made of must stay finite as floats. */
    if (!isfinite(*number) || (i < 6 && fabs(*number) > LARGEST_VALUE))
      return host->fail(l->ctx, BTF_E_CORRUPT,
                        "laplacian: number %u of the header is not finite or beyond 1e30", i);
  }
  if (head->filter >= LAPLACIAN_FILTERS || head->mean >= LAPLACIAN_MEANS ||
      head->storage >= LAPLACIAN_STORAGES)
    return host->fail(l->ctx, BTF_E_CORRUPT, "laplacian: unknown filter %u, mean %u or storage %u",
                      head->filter, head->mean, head->storage);
  const uint32_t most = host->mip_count(l->shape->width, l->shape->height);
  if (head->levels < 1 || head->levels > most || head->levels > LAPLACIAN_MAX_LEVELS)
    return host->fail(l->ctx, BTF_E_CORRUPT, "laplacian: %u levels of detail; 1 to %u are possible",
                      head->levels, most);
  if (head->phong.alpha < 1.0 || head->phong.alpha > LAPLACIAN_LARGEST_ALPHA)
    return host->fail(l->ctx, BTF_E_CORRUPT,
                      "laplacian: the exponent of the mean is %g; 1 to %g are possible", head->phong.alpha,
                      LAPLACIAN_LARGEST_ALPHA);
  return BTF_OK;
}

static btf_status get_levels(loading *l) {
  btfi_laplacian_head *head = &l->state->head;
  const void *data;
  BTF_TRY(get_chunk(l, LAPLACIAN_TAG_LEVELS, 0, (uint64_t)LAPLACIAN_LEVEL_BYTES * head->levels, &data));
  const unsigned char *bytes = data;
  for (uint32_t i = 0; i < 3 * head->levels; i++, bytes += LAPLACIAN_LEVEL_BYTES / 3) {
    const uint32_t k = i / 3, c = i % 3;
    head->count[k][c] = btf_get_u32(bytes);
    head->mean_norm[k][c] = btf_get_f64(bytes + 8);
    head->energy_of[k][c] = btf_get_f64(bytes + 16);
    head->residual[k][c] = btf_get_f64(bytes + 24);
    if (!isfinite(head->mean_norm[k][c]) || !isfinite(head->energy_of[k][c]) ||
        !isfinite(head->residual[k][c]))
      return l->host->fail(l->ctx, BTF_E_CORRUPT, "laplacian: a number of level %u is not finite", k);
  }
  return BTF_OK;
}

/* Scales by channel: a value counts for its own channel alone. */
static btf_status get_scales(loading *l) {
  btfi_laplacian_state *s = l->state;
  const uint32_t values = s->layout.first[s->head.levels];
  const void *data;
  BTF_TRY(get_chunk(l, LAPLACIAN_TAG_SCALES, 0, 4 * (uint64_t)values, &data));
  s->scale_stride = values + LAPLACIAN_SLACK;
  s->scale = l->host->alloc(l->ctx, s->scale_stride, 3 * sizeof *s->scale);
  if (s->scale == NULL) return BTF_E_NOMEM;
  memset(s->scale, 0, 3 * (size_t)s->scale_stride * sizeof *s->scale);
  for (uint32_t k = 0, value = 0; k < s->head.levels; k++)
    for (uint32_t c = 0; c < 3; c++)
      for (uint32_t j = 0; j < s->head.count[k][c]; j++, value++) {
        const float scale = btf_get_f32((const unsigned char *)data + 4 * (size_t)value);
        if (!isfinite(scale))
          return l->host->fail(l->ctx, BTF_E_CORRUPT, "laplacian: scale %u is not finite", value);
        s->scale[(size_t)c * s->scale_stride + value] = scale;
      }
  return BTF_OK;
}

/* A table of finite values: rows of weight 0 may be read or left out, which only finite values make alike. */
static btf_status get_table(const loading *l, uint32_t tag, uint32_t index, uint64_t size,
                            const void **data) {
  BTF_TRY(get_chunk(l, tag, index, size, data));
  const bool halves = l->state->head.storage == LAPLACIAN_F16;
  const uint32_t exponent = halves ? 0x7c00u : 0x7f800000u, bytes = halves ? 2 : 4;
  uint32_t defects = 0;
  for (uint64_t at = 0; at + bytes <= size; at += bytes) {
    uint32_t bits = 0;
    memcpy(&bits, (const unsigned char *)*data + at, bytes);
    defects |= (bits & exponent) == exponent;
  }
  if (defects != 0)
    return l->host->fail(l->ctx, BTF_E_CORRUPT, "laplacian: a table holds a value that is not finite");
  return BTF_OK;
}

static btf_status load_state(loading *l) {
  btfi_laplacian_state *s = l->state;
  const btf_host *host = l->host;
  const void *data;
  if (l->shape->channels != 3)
    return host->fail(l->ctx, BTF_E_CORRUPT, "laplacian: the model has %u channels instead of 3",
                      l->shape->channels);
  BTF_TRY(get_head(l));
  BTF_TRY(get_levels(l));
  s->grid = btfi_laplacian_grid_of(s->head.filter, l->shape->wrap, s->head.levels, l->shape->width,
                                   l->shape->height);
  if (!btfi_laplacian_layout_of(&s->head, &s->grid, host->dirset_count(l->shape->lights),
                                host->dirset_count(l->shape->views), &s->layout))
    return host->fail(l->ctx, BTF_E_CORRUPT,
                      "laplacian: a level has more than %d components of a channel, or the "
                      "tables would not fit 64 bits",
                      LAPLACIAN_MAX_COMPONENTS);
  BTF_TRY(get_scales(l));
  /* The tables are the chunks themselves. */
  BTF_TRY(get_table(l, LAPLACIAN_TAG_EIGEN, 0, s->layout.eigen_bytes, &data));
  s->eigen = data;
  s->resident = sizeof *s + 3 * (uint64_t)s->scale_stride * sizeof *s->scale + s->layout.eigen_bytes;
  for (uint32_t k = 0; k < s->head.levels; k++) {
    BTF_TRY(get_table(l, LAPLACIAN_TAG_WEIGHTS, k, s->layout.weight_bytes[k], &data));
    s->weights[k] = data;
    s->resident += s->layout.weight_bytes[k];
  }
  const btfi_laplacian_kernels *kernels = btfi_laplacian_kernels_of(host->isa(l->ctx));
  s->host = host;
  s->light_set = l->shape->lights;
  s->view_set = l->shape->views;
  s->light_xyz = host->dirset_directions(l->shape->lights);
  s->view_xyz = host->dirset_directions(l->shape->views);
  s->blend = kernels->blend[s->head.storage];
  s->blend4 = kernels->blend4[s->head.storage];
  s->dot = kernels->dot;
  return BTF_OK;
}

btf_status btfi_laplacian_load(const btf_host *host, btf_context *ctx, uint32_t format,
                               const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  loading l = {host, ctx, shape, payload, host->alloc(ctx, 1, sizeof *l.state)};
  (void)format;
  *state = NULL;
  if (l.state == NULL) return BTF_E_NOMEM;
  memset(l.state, 0, sizeof *l.state);
  const btf_status status = load_state(&l);
  if (status == BTF_OK)
    *state = l.state;
  else
    btfi_laplacian_destroy(host, ctx, l.state);
  return status;
}

void btfi_laplacian_destroy(const btf_host *host, btf_context *ctx, void *state) {
  btfi_laplacian_state *s = state;
  if (s == NULL) return;
  host->free(ctx, s->scale);
  host->free(ctx, s);
}
