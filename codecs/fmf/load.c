/* SPDX-License-Identifier: MIT */
/* load.c: from payload chunks to a state, with every size checked against the shape. */
#include "fmf.h"

#include <math.h>
#include <string.h>
#if defined(__linux__)
#include <sys/mman.h>
#endif

#include <btf/btf_sampling.h>

/* ---- the little-endian structures ---- */

void btfi_fmf_put_head(const btfi_fmf_head *head, unsigned char bytes[FMF_HEAD_BYTES]) {
  const uint32_t words[] = {head->coding,  head->storage, head->components,
                            head->columns, head->levels,  head->flags};
  const double numbers[] = {head->step[0], head->step[1], head->squared_error, head->energy, head->tolerated};
  for (size_t i = 0; i < 6; i++) btf_put_u32(bytes + 4 * i, words[i]);
  for (size_t i = 0; i < 5; i++) btf_put_f64(bytes + 24 + 8 * i, numbers[i]);
}

void btfi_fmf_put_columns(const btfi_fmf_plan *plan, unsigned char *bytes) {
  for (uint32_t i = 0; i < plan->columns; i++, bytes += FMF_COLUMN_BYTES) {
    const btfi_fmf_column *column = &plan->column[i];
    btf_put_u32(bytes, column->component);
    btf_put_u32(bytes + 4, column->rest[0] | (uint32_t)column->rest[1] << 8);
    btf_put_f32(bytes + 8, column->scale[0]);
    btf_put_f32(bytes + 12, column->scale[1]);
  }
}

void btfi_fmf_put_sigma(const double *sigma, uint32_t components, unsigned char *bytes) {
  for (uint32_t k = 0; k < components; k++) btf_put_f64(bytes + 8 * (size_t)k, sigma[k]);
}

/* ---- loading ---- */

#define FMF_LARGEST_VALUE 1e30f

typedef struct loading {
  const btf_host *host;
  btf_context *ctx;
  const btf_model_shape *shape;
  btf_chunk_reader *payload;
  btfi_fmf_state *state;
  btfi_fmf_head head;
  double *sigma;
  float scale[FMF_MAX_COLUMNS];
} loading;

static btf_status get_chunk(const loading *l, uint32_t tag, uint32_t index, uint64_t size,
                            const void **data) {
  return btf_get_chunk(l->host, l->ctx, l->payload, "fmf", tag, index, size, data);
}

static btf_status get_head(loading *l) {
  const btf_host *host = l->host;
  btfi_fmf_head *head = &l->head;
  const void *data;
  BTF_TRY(get_chunk(l, FMF_TAG_HEAD, 0, FMF_HEAD_BYTES, &data));
  const unsigned char *bytes = data;
  uint32_t *const words[] = {&head->coding,  &head->storage, &head->components,
                             &head->columns, &head->levels,  &head->flags};
  double *const numbers[] = {&head->step[0], &head->step[1], &head->squared_error, &head->energy,
                             &head->tolerated};
  for (size_t i = 0; i < 6; i++) *words[i] = btf_get_u32(bytes + 4 * i);
  for (size_t i = 0; i < 5; i++) {
    *numbers[i] = btf_get_f64(bytes + 24 + 8 * i);
    if (!isfinite(*numbers[i]) || *numbers[i] < 0.0)
      return host->fail(l->ctx, BTF_E_CORRUPT, "fmf: number %u of the header is not finite or negative",
                        (unsigned)i);
  }
  const uint32_t most_levels = host->mip_count(l->shape->width, l->shape->height);
  if (head->coding >= FMF_CODINGS || head->storage >= FMF_STORAGES || head->flags > FMF_FLAG_MEAN)
    return host->fail(l->ctx, BTF_E_CORRUPT, "fmf: unknown coding %u, storage %u or flags %u", head->coding,
                      head->storage, head->flags);
  if (head->components < 1 || head->components > FMF_MAX_COMPONENTS)
    return host->fail(l->ctx, BTF_E_CORRUPT, "fmf: %u components; 1 to %d are possible", head->components,
                      FMF_MAX_COMPONENTS);
  if (head->levels < 1 || head->levels > most_levels || head->levels > FMF_MAX_LEVELS)
    return host->fail(l->ctx, BTF_E_CORRUPT, "fmf: %u levels of detail; %u are possible", head->levels,
                      most_levels);
  if (head->coding == FMF_PLAIN && (head->columns < head->components || head->columns > FMF_MAX_COLUMNS))
    return host->fail(l->ctx, BTF_E_CORRUPT, "fmf: %u columns for %u components", head->columns,
                      head->components);
  if (head->coding == FMF_PACKED && (head->step[0] <= 0.0 || head->step[1] <= 0.0))
    return host->fail(l->ctx, BTF_E_CORRUPT, "fmf: the step of the packed factors must be more than 0");
  return BTF_OK;
}

static btf_status get_sigma(loading *l) {
  const void *data;
  BTF_TRY(get_chunk(l, FMF_TAG_SIGMA, 0, 8 * (uint64_t)l->head.components, &data));
  for (uint32_t k = 0; k < l->head.components; k++) {
    l->sigma[k] = btf_get_f64((const unsigned char *)data + 8 * (size_t)k);
    if (!isfinite(l->sigma[k]) || l->sigma[k] <= 0.0 || !isfinite(l->head.step[0] / l->sigma[k]))
      return l->host->fail(l->ctx, BTF_E_CORRUPT,
                           "fmf: singular value %u is not a positive number or too small", k);
  }
  return BTF_OK;
}

static btf_status make_layout(loading *l, uint32_t columns) {
  if (btfi_fmf_layout_of(l->shape, l->host->dirset_count(l->shape->lights),
                         l->host->dirset_count(l->shape->views), l->head.storage, columns, l->head.levels,
                         &l->state->layout))
    return BTF_OK;
  return l->host->fail(l->ctx, BTF_E_CORRUPT, "fmf: the tables of %u columns would not fit 64 bits", columns);
}

static btf_status check_scale(loading *l, uint32_t i, const btfi_fmf_column *column) {
  l->scale[i] = btfi_fmf_column_scale(l->head.storage, column);
  for (uint32_t side = 0; side < 2; side++)
    l->state->side_scale[side][i] = btfi_fmf_side_scale(l->head.storage, column, side);
  if (isfinite(l->scale[i])) return BTF_OK;
  return l->host->fail(l->ctx, BTF_E_CORRUPT, "fmf: the scale of column %u is not finite", i);
}

/* The tables are the chunks themselves. Their values are not looked at, so that loading takes the same time
 * whatever their size. */
static btf_status load_plain(loading *l) {
  btfi_fmf_state *state = l->state;
  const void *data;
  BTF_TRY(get_chunk(l, FMF_TAG_COLUMNS, 0, (uint64_t)FMF_COLUMN_BYTES * l->head.columns, &data));
  for (uint32_t i = 0; i < l->head.columns; i++) {
    const unsigned char *bytes = (const unsigned char *)data + (size_t)FMF_COLUMN_BYTES * i;
    const uint32_t rest = btf_get_u32(bytes + 4);
    const btfi_fmf_column column = {
        btf_get_u32(bytes), {rest & 1, rest >> 8 & 1}, {btf_get_f32(bytes + 8), btf_get_f32(bytes + 12)}};
    if (column.component >= l->head.components || (rest & ~0x101u) != 0)
      return l->host->fail(l->ctx, BTF_E_CORRUPT, "fmf: column %u has an impossible description", i);
    BTF_TRY(check_scale(l, i, &column));
  }
  BTF_TRY(make_layout(l, l->head.columns));
  BTF_TRY(get_chunk(l, FMF_TAG_U, 0, state->layout.u_bytes, &data));
  state->u = data;
  for (uint32_t level = 0; level < l->head.levels; level++) {
    BTF_TRY(get_chunk(l, FMF_TAG_V, level, state->layout.v_bytes[level], &data));
    state->v[level] = data;
  }
  return BTF_OK;
}

/* Zeroed memory for a table. Rows are fetched at random, so large pages save much of the address translation.
 */
static unsigned char *alloc_table(const loading *l, uint64_t size) {
  unsigned char *table = l->host->alloc(l->ctx, size, 1);
  if (table == NULL) return NULL;
#if defined(__linux__) && defined(MADV_HUGEPAGE)
  const uint64_t large = (uint64_t)2 << 20;
  if (size >= 2 * large) {
    unsigned char *first = table + (large - (uintptr_t)table % large) % large;
    const uint64_t whole = (size - (uint64_t)(first - table)) / large * large;
    (void)madvise(first, whole, MADV_HUGEPAGE);
  }
#endif
  memset(table, 0, size);
  return table;
}

static btf_status build_tables(loading *l, const btfi_fmf_factors *factors, btfi_fmf_plan *plan) {
  btfi_fmf_state *state = l->state;
  unsigned char *v[FMF_MAX_LEVELS] = {NULL}, *u;
  BTF_TRY(btfi_fmf_plan_columns(l->host, l->ctx, factors, l->head.storage, l->head.tolerated, plan));
  for (uint32_t i = 0; i < plan->columns; i++) {
    /* Far from overflow, so that no value of the tables and no sum of them while filtering is infinite. */
    const btfi_fmf_column *column = &plan->column[i];
    if (!(column->scale[0] <= FMF_LARGEST_VALUE && column->scale[1] <= FMF_LARGEST_VALUE))
      return l->host->fail(l->ctx, BTF_E_CORRUPT, "fmf: component %u has values beyond 1e30",
                           column->component);
    BTF_TRY(check_scale(l, i, column));
  }
  BTF_TRY(make_layout(l, plan->columns));
  state->owned[0] = u = alloc_table(l, state->layout.u_bytes);
  if (u == NULL) return BTF_E_NOMEM;
  state->u = u;
  for (uint32_t level = 0; level < l->head.levels; level++) {
    state->owned[1 + level] = v[level] = alloc_table(l, state->layout.v_bytes[level]);
    if (v[level] == NULL) return BTF_E_NOMEM;
    state->v[level] = v[level];
  }
  return btfi_fmf_fill_tables(l->host, l->ctx, factors, plan, &state->layout, u, v);
}

static btf_status load_packed(loading *l) {
  const uint32_t components = l->head.components, channels = l->shape->channels;
  const uint32_t lights = l->host->dirset_count(l->shape->lights),
                 views = l->host->dirset_count(l->shape->views);
  const uint32_t tags[2] = {FMF_TAG_PACKED_U, FMF_TAG_PACKED_V};
  const char *const names[2] = {"UPAK", "VPAK"};
  btfi_fmf_packed packed = {.grid = {{channels, lights, views}, {1, l->shape->width, l->shape->height}},
                            .step = {l->head.step[0], l->head.step[1]},
                            .sigma = l->sigma};
  const btfi_fmf_factors factors = {
      .components = components,
      .length = {(uint64_t)views * lights * channels, (uint64_t)l->shape->width * l->shape->height},
      .column = btfi_fmf_packed_column,
      .user = &packed};
  uint64_t *start = l->host->alloc(l->ctx, 2 * (uint64_t)components, sizeof *start);
  btfi_fmf_plan *plan = l->host->alloc(l->ctx, 1, sizeof *plan);
  btf_status status = start != NULL && plan != NULL ? BTF_OK : BTF_E_NOMEM;
  for (uint32_t side = 0; side < 2 && status == BTF_OK; side++) {
    const void *data;
    uint64_t size;
    status = l->host->get(l->payload, tags[side], 0, &data, &size);
    if (status != BTF_OK) break;
    packed.data[side] = data;
    packed.start[side] = start + side * components;
    status = btfi_fmf_unpack(l->host, l->ctx, names[side], data, size, &packed.grid[side], components,
                             packed.start[side]);
  }
  if (status == BTF_OK) status = build_tables(l, &factors, plan);
  l->host->free(l->ctx, start);
  l->host->free(l->ctx, plan);
  return status;
}

static btf_status load_state(loading *l) {
  btfi_fmf_state *state = l->state;
  BTF_TRY(get_head(l));
  l->sigma = l->host->alloc(l->ctx, l->head.components, sizeof *l->sigma);
  if (l->sigma == NULL) return BTF_E_NOMEM;
  BTF_TRY(get_sigma(l));
  BTF_TRY(l->head.coding == FMF_PLAIN ? load_plain(l) : load_packed(l));
  state->components = l->head.components;
  state->coding = l->head.coding;
  state->resident = sizeof *state + state->layout.u_bytes;
  for (uint32_t level = 0; level < l->head.levels; level++) state->resident += state->layout.v_bytes[level];
  btfi_fmf_state_ready(state, l->host, l->ctx, l->shape, l->scale);
  return BTF_OK;
}

btf_status btfi_fmf_load(const btf_host *host, btf_context *ctx, uint32_t format,
                         const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  loading *l = host->alloc(ctx, 1, sizeof *l);
  btf_status status = BTF_E_NOMEM;
  (void)format;
  *state = NULL;
  if (l == NULL) return BTF_E_NOMEM;
  memset(l, 0, sizeof *l);
  l->host = host;
  l->ctx = ctx;
  l->shape = shape;
  l->payload = payload;
  l->state = host->alloc(ctx, 1, sizeof *l->state);
  if (l->state != NULL) {
    memset(l->state, 0, sizeof *l->state);
    status = load_state(l);
  }
  if (status == BTF_OK) {
    *state = l->state;
  } else {
    btfi_fmf_destroy(host, ctx, l->state);
  }
  host->free(ctx, l->sigma);
  host->free(ctx, l);
  return status;
}

void btfi_fmf_destroy(const btf_host *host, btf_context *ctx, void *state) {
  btfi_fmf_state *s = state;
  if (s == NULL) return;
  for (size_t i = 0; i < sizeof s->owned / sizeof *s->owned; i++) host->free(ctx, s->owned[i]);
  host->free(ctx, s);
}
