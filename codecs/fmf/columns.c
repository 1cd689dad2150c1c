/* SPDX-License-Identifier: MIT */
/* columns.c: from components to the columns of the evaluation tables. Each side of a column is divided by its
 * largest magnitude. A coarse storage rounds the leading components by more than the last ones are worth;
 * what its rounding left of one side, rounded in turn and scaled to its own range, is then worth a column. */
#include "fmf.h"

#include <math.h>
#include <string.h>

enum { SLICE = 16, EXTRA_COLUMNS = 64, STRIPES = 64 };

/* ---- planning ---- */

typedef struct side_statistics {
  double square;   /* of the values */
  double rounding; /* squared error of rounding them */
  double rest;     /* squared error of rounding them with their rest kept as well */
  float scale, rest_scale;
} side_statistics;

typedef struct planning {
  const btfi_fmf_factors *factors;
  uint32_t storage, side;
  uint64_t longest;
  float *values; /* of each thread */
  side_statistics *statistics;
} planning;

static float scale_of(float largest) {
  return largest > 0.0f ? largest : 1.0f;
}

/* The smallest power of two that is not below. */
static float power_of(float largest) {
  int exponent;
  const float fraction = frexpf(largest, &exponent);
  if (fraction == 0.5f) exponent--;
  return exponent < 128 ? ldexpf(1.0f, exponent) : largest;
}

/* The rest of a value after rounding, as the tables will hold it. */
static float rest_of(uint32_t storage, float value, float scale) {
  return value - btfi_fmf_round(storage, value / scale) * scale;
}

static double rounding_of(uint32_t storage, const float *values, uint64_t length, float scale) {
  double error = 0.0;
  for (uint64_t i = 0; i < length; i++) {
    const double left = rest_of(storage, values[i], scale);
    error += left * left;
  }
  return error;
}

/* The scale of a column of largest magnitude `scale`, or a power of two: 8 bits would lose range by it. */
static float finer_scale(uint32_t storage, const float *values, uint64_t length, float scale) {
  const float power = power_of(scale);
  if (storage == FMF_Q8) return scale;
  if (storage == FMF_F32) return power;
  return rounding_of(storage, values, length, power) < rounding_of(storage, values, length, scale) ? power
                                                                                                   : scale;
}

static void measure_column(void *job, uint32_t index, uint32_t thread) {
  const planning *p = job;
  const uint32_t side = index % 2, k = index / 2;
  const uint64_t length = p->factors->length[side];
  float *values = p->values + thread * p->longest;
  side_statistics *s = &p->statistics[index];
  float largest = 0.0f, largest_rest = 0.0f;
  memset(s, 0, sizeof *s);
  p->factors->column(p->factors->user, side, k, values);
  for (uint64_t i = 0; i < length; i++) {
    largest = fmaxf(largest, fabsf(values[i]));
    s->square += (double)values[i] * values[i];
  }
  s->scale = scale_of(largest);
  if (p->factors->by_powers) s->scale = finer_scale(p->storage, values, length, s->scale);
  s->rest_scale = 1.0f;
  if (p->storage == FMF_F32) return;
  for (uint64_t i = 0; i < length; i++) {
    values[i] = rest_of(p->storage, values[i], s->scale);
    largest_rest = fmaxf(largest_rest, fabsf(values[i]));
    s->rounding += (double)values[i] * values[i];
  }
  s->rest_scale = scale_of(largest_rest);
  s->rest = rounding_of(p->storage, values, length, s->rest_scale);
}

/* Squared error that a column for the rest of one side of component k removes. */
static double gain_of(const side_statistics *statistics, uint32_t k, uint32_t side) {
  const side_statistics *here = &statistics[2 * k + side], *other = &statistics[2 * k + 1 - side];
  return (here->rounding - here->rest) * other->square;
}

static void choose_columns(const side_statistics *statistics, uint32_t components, uint32_t storage,
                           double tolerated, btfi_fmf_plan *plan) {
  /* Rows of a few components are short whatever they hold. */
  const uint32_t in_padding = components <= 8 ? 8 : (components + 3u) & ~3u;
  uint32_t most = storage == FMF_Q8 ? components + EXTRA_COLUMNS : in_padding;
  uint8_t kept[FMF_MAX_COMPONENTS][2] = {{0}};
  if (storage == FMF_F32) most = components;
  if (most > FMF_MAX_COLUMNS) most = FMF_MAX_COLUMNS;
  plan->squared_error = 0.0;
  for (uint32_t k = 0; k < components; k++) {
    const side_statistics *u = &statistics[2 * k], *v = &statistics[2 * k + 1];
    plan->column[k] = (btfi_fmf_column){k, {0, 0}, {u->scale, v->scale}};
    plan->squared_error += u->rounding * v->square + v->rounding * u->square;
  }
  for (plan->columns = components; plan->columns < most;) {
    uint32_t best = 0, best_side = 0;
    double largest = 0.0;
    for (uint32_t k = 0; k < components; k++) {
      for (uint32_t side = 0; side < 2; side++) {
        const double gain = kept[k][side] ? 0.0 : gain_of(statistics, k, side);
        if (gain > largest) {
          largest = gain;
          best = k;
          best_side = side;
        }
      }
    }
    if (largest == 0.0) break;
    if (plan->columns % 4 == 0 && plan->columns >= in_padding && plan->squared_error <= tolerated) break;
    kept[best][best_side] = 1;
    btfi_fmf_column *column = &plan->column[plan->columns++];
    *column = plan->column[best];
    column->rest[best_side] = 1;
    column->scale[best_side] = statistics[2 * best + best_side].rest_scale;
    plan->squared_error = fmax(0.0, plan->squared_error - largest);
  }
}

btf_status btfi_fmf_plan_columns(const btf_host *host, btf_context *ctx, const btfi_fmf_factors *factors,
                                 uint32_t storage, double tolerated, btfi_fmf_plan *out) {
  planning p = {factors, storage, 0, 0, NULL, NULL};
  btf_status status = BTF_E_NOMEM;
  p.longest = factors->length[0] > factors->length[1] ? factors->length[0] : factors->length[1];
  p.values = host->alloc(ctx, p.longest * host->thread_count(ctx), sizeof *p.values);
  p.statistics = host->alloc(ctx, 2 * (uint64_t)factors->components, sizeof *p.statistics);
  if (p.values != NULL && p.statistics != NULL)
    status = host->parallel(ctx, 2 * factors->components, measure_column, &p);
  if (status == BTF_OK) choose_columns(p.statistics, factors->components, storage, tolerated, out);
  host->free(ctx, p.values);
  host->free(ctx, p.statistics);
  return status;
}

float btfi_fmf_side_scale(uint32_t storage, const btfi_fmf_column *column, uint32_t side) {
  return storage == FMF_Q8 ? column->scale[side] * (1.0f / 127.0f) : column->scale[side];
}

float btfi_fmf_column_scale(uint32_t storage, const btfi_fmf_column *column) {
  return btfi_fmf_side_scale(storage, column, FMF_SIDE_U) * btfi_fmf_side_scale(storage, column, FMF_SIDE_V);
}

/* ---- filling ---- */

typedef struct filling {
  const btfi_fmf_factors *factors;
  const btfi_fmf_plan *plan;
  const btfi_fmf_layout *layout;
  uint32_t side, first, columns; /* the slice of columns at work */
  uint64_t length;
  uint64_t longest;
  float *values;      /* of each thread */
  float *slice;       /* length x columns, a row for each value's place */
  const float *level; /* what is stored now: the slice or a filtered one */
  uint64_t items;     /* of it */
  uint32_t level_index;
  unsigned char *table;
} filling;

/* One column of the slice, scaled to -1 .. 1. */
static void make_column(void *job, uint32_t index, uint32_t thread) {
  const filling *f = job;
  const btfi_fmf_column *column = &f->plan->column[f->first + index];
  const uint32_t storage = f->layout->storage;
  const float scale = column->scale[f->side];
  float *values = f->values + thread * f->longest, whole_scale = scale;
  f->factors->column(f->factors->user, f->side, column->component, values);
  if (column->rest[f->side]) whole_scale = f->plan->column[column->component].scale[f->side];
  for (uint64_t i = 0; i < f->length; i++) {
    const float value = column->rest[f->side] ? rest_of(storage, values[i], whole_scale) : values[i];
    f->slice[i * f->columns + index] = value / scale;
  }
}

static uint64_t share(uint64_t count, uint32_t stripe) {
  return count / STRIPES * stripe + count % STRIPES * stripe / STRIPES;
}

/* Columns of a slice are stored in whole runs of 4, the last one with zeros. */
static void store_slice(const filling *f, const float *values, unsigned char *dst) {
  float run[SLICE] = {0};
  memcpy(run, values, f->columns * sizeof *run);
  btfi_fmf_store(f->layout->storage, run, (f->columns + 3u) & ~3u, dst);
}

static void store_u(void *job, uint32_t stripe, uint32_t thread) {
  const filling *f = job;
  const btfi_fmf_layout *layout = f->layout;
  const uint64_t value_bytes = btfi_fmf_value_bytes(layout->storage);
  (void)thread;
  for (uint64_t i = share(f->items, stripe); i < share(f->items, stripe + 1); i++) {
    const uint64_t row = i / layout->channels, channel = i % layout->channels;
    store_slice(f, f->level + i * f->columns,
                f->table + row * layout->u_row_bytes + (channel * layout->stride + f->first) * value_bytes);
  }
}

static void store_v(void *job, uint32_t stripe, uint32_t thread) {
  const filling *f = job;
  const btfi_fmf_layout *layout = f->layout;
  const uint64_t width = layout->level_width[f->level_index];
  (void)thread;
  for (uint64_t i = share(f->items, stripe); i < share(f->items, stripe + 1); i++)
    store_slice(f, f->level + i * f->columns,
                f->table + i / width * layout->v_line_bytes[f->level_index] +
                    i % width * layout->v_texel_bytes +
                    f->first * (uint64_t)btfi_fmf_value_bytes(layout->storage));
}

static btf_status fill_levels(const btf_host *host, btf_context *ctx, filling *f, unsigned char *const *v) {
  const btfi_fmf_layout *layout = f->layout;
  btf_status status = BTF_OK;
  float *filtered = NULL;
  if (layout->levels > 1) {
    filtered = host->alloc(ctx, (uint64_t)layout->level_width[1] * layout->level_height[1],
                           f->columns * sizeof *filtered);
    if (filtered == NULL) return BTF_E_NOMEM;
  }
  for (uint32_t level = 0; level < layout->levels && status == BTF_OK; level++) {
    f->level_index = level;
    f->items = (uint64_t)layout->level_width[level] * layout->level_height[level];
    f->level = level == 0 ? f->slice : filtered;
    f->table = v[level];
    if (level > 0)
      status = host->mip_filter(ctx, f->slice, f->columns, layout->width, layout->height, f->columns, level,
                                filtered, f->columns);
    if (status == BTF_OK) status = host->parallel(ctx, STRIPES, store_v, f);
  }
  host->free(ctx, filtered);
  return status;
}

btf_status btfi_fmf_fill_tables(const btf_host *host, btf_context *ctx, const btfi_fmf_factors *factors,
                                const btfi_fmf_plan *plan, const btfi_fmf_layout *layout, unsigned char *u,
                                unsigned char *const *v) {
  filling f = {.factors = factors, .plan = plan, .layout = layout};
  btf_status status = BTF_OK;
  f.longest = factors->length[0] > factors->length[1] ? factors->length[0] : factors->length[1];
  f.values = host->alloc(ctx, f.longest * host->thread_count(ctx), sizeof *f.values);
  f.slice = host->alloc(ctx, f.longest, SLICE * sizeof *f.slice);
  if (f.values == NULL || f.slice == NULL) status = BTF_E_NOMEM;
  for (f.side = 0; f.side < 2 && status == BTF_OK; f.side++) {
    f.length = factors->length[f.side];
    for (f.first = 0; f.first < plan->columns && status == BTF_OK; f.first += SLICE) {
      f.columns = plan->columns - f.first < SLICE ? plan->columns - f.first : SLICE;
      status = host->parallel(ctx, f.columns, make_column, &f);
      if (status != BTF_OK) break;
      if (f.side == FMF_SIDE_V) {
        status = fill_levels(host, ctx, &f, v);
      } else {
        f.level = f.slice;
        f.items = f.length;
        f.table = u;
        status = host->parallel(ctx, STRIPES, store_u, &f);
      }
    }
  }
  host->free(ctx, f.values);
  host->free(ctx, f.slice);
  return status;
}
