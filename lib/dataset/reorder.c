/* SPDX-License-Identifier: MIT */
/* Blocks of samples between two orders. The axes are merged and sorted first, so that every layout becomes
 * one of two cases: rows that are contiguous on both sides, and tiles that are converted in the samples'
 * order into a buffer that stays in cache and moved from there in the floats' order. */
#include "dataset/convert.h"

#include <string.h>

enum {
  tile_floats = 8192,
  short_run = 16,      /* samples that are not worth a call of a kernel */
  good_run = 128,      /* neighbours on either side that a tile should hold */
  whole_lines = 32,    /* multiples of this many samples of any type fill cache lines */
  slab_floats = 98304, /* what half of a second-level cache holds */
  slab_run = 512,
  longest_fetched = 2048, /* bytes; the processor foresees longer rows by itself */
  lines_ahead = 32,       /* as many as a core waits for at once */
  parallel_from = 1 << 18
};

/* One axis: neighbours are `sample` bytes apart among the samples and `floats` bytes among the floats. */
typedef struct plan_axis {
  size_t count;
  ptrdiff_t sample, floats;
} plan_axis;

typedef struct reorder_plan {
  const btfi_convert_kernels *kernels;
  plan_axis axis[btfi_axes_most];    /* in the samples' order, the closest neighbours first */
  uint32_t by_float[btfi_axes_most]; /* the same in the floats' order */
  size_t tile[btfi_axes_most], slab[btfi_axes_most];
  uint32_t count;
  bool packing;
} reorder_plan;

/* Broadcast axes (stride 0) belong outside. */
static size_t distance(ptrdiff_t stride) {
  return stride == 0 ? SIZE_MAX : (size_t)(stride < 0 ? -stride : stride);
}

static void merge_axes(reorder_plan *p) {
  for (uint32_t i = 0; i < p->count; ++i)
    for (uint32_t j = 0; j < p->count; ++j) {
      const plan_axis a = p->axis[i], b = p->axis[j];
      if (i == j || b.sample != a.sample * (ptrdiff_t)a.count || b.floats != a.floats * (ptrdiff_t)a.count)
        continue;
      p->axis[i].count = a.count * b.count;
      p->axis[j] = p->axis[--p->count];
      merge_axes(p);
      return;
    }
}

static void sort_axes(reorder_plan *p) {
  for (uint32_t i = 1; i < p->count; ++i)
    for (uint32_t j = i; j > 0 && distance(p->axis[j].sample) < distance(p->axis[j - 1].sample); --j) {
      const plan_axis swapped = p->axis[j];
      p->axis[j] = p->axis[j - 1];
      p->axis[j - 1] = swapped;
    }
  for (uint32_t i = 0; i < p->count; ++i) {
    uint32_t j = i;
    for (; j > 0 && distance(p->axis[i].floats) < distance(p->axis[p->by_float[j - 1]].floats); --j)
      p->by_float[j] = p->by_float[j - 1];
    p->by_float[j] = i;
  }
}

/* Extends the tile along axis k to `wanted` neighbours, as far as the buffer has room. */
static void extend_tile(reorder_plan *p, uint32_t k, size_t wanted, size_t *floats) {
  const size_t room = tile_floats / (*floats / p->tile[k]);
  size_t extent = BTFI_MIN(BTFI_MIN(wanted, p->axis[k].count), room);
  if (extent > whole_lines && extent < p->axis[k].count) extent &= ~(size_t)(whole_lines - 1);
  if (extent <= p->tile[k]) return;
  *floats = *floats / p->tile[k] * extent;
  p->tile[k] = extent;
}

static void choose_tile(reorder_plan *p) {
  size_t floats = 1, run = 1;
  for (uint32_t k = 0; k < p->count; ++k) p->tile[k] = 1;
  for (uint32_t k = 0; k < p->count && run < good_run; ++k) {
    extend_tile(p, k, (good_run + run - 1) / run + whole_lines - 1, &floats);
    run *= p->tile[k];
  }
  run = 1;
  for (uint32_t i = 0; i < p->count && run < good_run; ++i) {
    const uint32_t k = p->by_float[i];
    extend_tile(p, k, (good_run + run - 1) / run + whole_lines - 1, &floats);
    run *= p->tile[k];
  }
  for (uint32_t i = 0; i < p->count; ++i) extend_tile(p, p->by_float[i], tile_floats, &floats);
}

/* Tiles follow each other within slabs that stay in the second-level cache, so that lines and pages which one
 * tile touches in part are finished while they are near. */
static void choose_slab(reorder_plan *p) {
  size_t floats = 1, run = 1;
  for (uint32_t k = 0; k < p->count; ++k) floats *= p->slab[k] = p->tile[k];
  for (uint32_t side = 0; side < 2; ++side, run = 1)
    for (uint32_t i = 0; i < p->count && run < slab_run; ++i) {
      const uint32_t k = side == 0 ? p->by_float[i] : i;
      const size_t tiles_wanted = (slab_run / run + p->tile[k] - 1) / p->tile[k];
      const size_t tiles_of_axis = (p->axis[k].count + p->tile[k] - 1) / p->tile[k];
      const size_t room = slab_floats / (floats / p->slab[k]) / p->tile[k];
      const size_t tiles = BTFI_MIN(BTFI_MIN(tiles_wanted, tiles_of_axis), room);
      if (tiles * p->tile[k] > p->slab[k]) {
        floats = floats / p->slab[k] * (tiles * p->tile[k]);
        p->slab[k] = tiles * p->tile[k];
      }
      run *= p->slab[k];
    }
}

static void make_plan(reorder_plan *p) {
  merge_axes(p);
  sort_axes(p);
  choose_tile(p);
  choose_slab(p);
}

/* ---- floats moved inside a tile ---- */

typedef struct move_axis {
  size_t count;
  ptrdiff_t src, dst; /* bytes */
} move_axis;

/* The two innermost axes. */
static void move_plane(const btfi_convert_kernels *kernels, const char *src, char *dst, move_axis a,
                       move_axis b) {
  const ptrdiff_t one = (ptrdiff_t)sizeof(float);
  if (a.src == one && a.dst == one) {
    if (a.count == 3)
      for (size_t j = 0; j < b.count; ++j)
        memcpy(dst + (ptrdiff_t)j * b.dst, src + (ptrdiff_t)j * b.src, 3 * sizeof(float));
    else
      for (size_t j = 0; j < b.count; ++j)
        memcpy(dst + (ptrdiff_t)j * b.dst, src + (ptrdiff_t)j * b.src, a.count * sizeof(float));
  } else if (a.dst == one && b.src == one) {
    if (b.count == 3 && a.src == 3 * one)
      kernels->split3((const float *)(const void *)src, (float *)(void *)dst, (float *)(void *)(dst + b.dst),
                      (float *)(void *)(dst + 2 * b.dst), a.count);
    else
      kernels->transpose((const float *)(const void *)src, a.src / one, (float *)(void *)dst, b.dst / one,
                         b.count, a.count);
  } else {
    for (size_t j = 0; j < b.count; ++j)
      for (size_t i = 0; i < a.count; ++i)
        memcpy(dst + (ptrdiff_t)j * b.dst + (ptrdiff_t)i * a.dst,
               src + (ptrdiff_t)j * b.src + (ptrdiff_t)i * a.src, sizeof(float));
  }
}

static void move_floats(const btfi_convert_kernels *kernels, const char *src, char *dst,
                        const move_axis *axis, uint32_t count) {
  static const move_axis single = {1, 0, 0};
  if (count <= 2) {
    move_axis a = count > 0 ? axis[0] : single, b = count > 1 ? axis[1] : single;
    if (count < 2) b = single;
    if (count == 0) a.src = a.dst = sizeof(float);
    /* The kernels walk the destination row by row. */
    if (b.dst == (ptrdiff_t)sizeof(float) && a.dst != b.dst) {
      const move_axis swapped = a;
      a = b;
      b = swapped;
    }
    move_plane(kernels, src, dst, a, b);
    return;
  }
  const move_axis outer = axis[count - 1];
  for (size_t i = 0; i < outer.count; ++i)
    move_floats(kernels, src + (ptrdiff_t)i * outer.src, dst + (ptrdiff_t)i * outer.dst, axis, count - 1);
}

/* ---- tiles ---- */

typedef struct tile_view {
  const reorder_plan *plan;
  size_t extent[btfi_axes_most], slab[btfi_axes_most]; /* of this tile and this slab */
  size_t run;                                          /* neighbouring samples converted at once */
  uint32_t run_axes;                                   /* axes they take up */
  size_t ahead;                                        /* runs whose lines are asked for before their turn */
} tile_view;

static bool convert_run(const reorder_plan *p, char *samples, float *buffer, size_t run) {
  return p->packing ? p->kernels->pack(buffer, samples, run) : p->kernels->unpack(samples, buffer, run);
}

/* Rows lie pages apart, where the processor foresees nothing, and a wait for each line is what a block of
 * texels of an image-major file would cost. */
static void fetch_run(const tile_view *t, const char *samples) {
  const size_t bytes = t->run * t->plan->kernels->sample_size;
  for (size_t at = 0; at < bytes; at += 64) __builtin_prefetch(samples + at, 0);
  __builtin_prefetch(samples + bytes - 1, 0);
}

/* Converts between the samples and the buffer, which is dense in the samples' order. */
static bool convert_rows(const tile_view *t, uint32_t level, char *samples, float **buffer) {
  if (level == t->run_axes) {
    const bool fine = convert_run(t->plan, samples, *buffer, t->run);
    *buffer += t->run;
    return fine;
  }
  bool fine = true;
  const ptrdiff_t stride = t->plan->axis[level - 1].sample;
  const size_t rows = t->extent[level - 1], ahead = level == t->run_axes + 1 ? t->ahead : 0;
  for (size_t i = 0; i < BTFI_MIN(ahead, rows); ++i) fetch_run(t, samples + (ptrdiff_t)i * stride);
  for (size_t i = 0; i < rows; ++i) {
    if (i + ahead < rows && ahead > 0) fetch_run(t, samples + (ptrdiff_t)(i + ahead) * stride);
    fine &= convert_rows(t, level - 1, samples + (ptrdiff_t)i * stride, buffer);
  }
  return fine;
}

/* One crumb of a fixed size, which the compiler turns into a move or two. */
static inline void copy_crumb(char *dst, const char *src, size_t size) {
  switch (size) {
  case 1:
    memcpy(dst, src, 1);
    break;
  case 2:
    memcpy(dst, src, 2);
    break;
  case 3:
    memcpy(dst, src, 3);
    break;
  case 4:
    memcpy(dst, src, 4);
    break;
  case 6:
    memcpy(dst, src, 6);
    break;
  case 8:
    memcpy(dst, src, 8);
    break;
  case 12:
    memcpy(dst, src, 12);
    break;
  default:
    memcpy(dst, src, size);
    break;
  }
}

/* Moves runs too short for a kernel between the samples and dense ones. */
static char *move_crumbs(const tile_view *t, uint32_t level, char *samples, char *dense) {
  const size_t size = t->run * t->plan->kernels->sample_size;
  if (level == t->run_axes) {
    copy_crumb(t->plan->packing ? samples : dense, t->plan->packing ? dense : samples, size);
    return dense + size;
  }
  const ptrdiff_t stride = t->plan->axis[level - 1].sample;
  for (size_t i = 0; i < t->extent[level - 1]; ++i, samples += stride)
    dense = move_crumbs(t, level - 1, samples, dense);
  return dense;
}

static bool convert_crumbs(const tile_view *t, char *samples, float *buffer, size_t count) {
  _Alignas(64) char dense[tile_floats * sizeof(float)];
  if (!t->plan->packing) move_crumbs(t, t->plan->count, samples, dense);
  const bool fine = convert_run(t->plan, dense, buffer, count);
  if (t->plan->packing) move_crumbs(t, t->plan->count, samples, dense);
  return fine;
}

static bool convert_samples(const tile_view *t, char *samples, float *buffer, size_t count) {
  if (t->run < short_run && t->run < count) return convert_crumbs(t, samples, buffer, count);
  return convert_rows(t, t->plan->count, samples, &buffer);
}

/* Stores that miss the cache wait for each other; asking for a tile's lines before its samples are converted
 * lets them come in together. */
static void fetch_rows(const move_axis *axis, uint32_t count, uint32_t inner, size_t run,
                       const char *floats) {
  if (count > inner) {
    for (size_t i = 0; i < axis[count - 1].count; ++i)
      fetch_rows(axis, count - 1, inner, run, floats + (ptrdiff_t)i * axis[count - 1].dst);
    return;
  }
  for (size_t at = 0; at < run; at += 64) __builtin_prefetch(floats + at, 1);
  __builtin_prefetch(floats + run - 1, 1);
}

static void fetch_floats(const move_axis *axis, uint32_t count, const char *floats) {
  size_t run = sizeof(float);
  uint32_t inner = 0;
  for (; inner < count && axis[inner].dst == (ptrdiff_t)run; ++inner) run *= axis[inner].count;
  if (run <= longest_fetched) fetch_rows(axis, count, inner, run, floats);
}

static bool convert_tile(tile_view *t, char *samples, char *floats) {
  const reorder_plan *p = t->plan;
  _Alignas(64) float buffer[tile_floats];
  move_axis axis[btfi_axes_most] = {{0, 0, 0}};
  ptrdiff_t inside[btfi_axes_most], dense = (ptrdiff_t)sizeof(float);
  for (uint32_t k = 0; k < p->count; ++k) {
    inside[k] = dense;
    dense *= (ptrdiff_t)t->extent[k];
  }
  for (uint32_t i = 0; i < p->count; ++i) {
    const uint32_t k = p->by_float[i];
    axis[i].count = t->extent[k];
    axis[i].src = p->packing ? p->axis[k].floats : inside[k];
    axis[i].dst = p->packing ? inside[k] : p->axis[k].floats;
  }
  if (!p->packing) fetch_floats(axis, p->count, floats);
  /* The axis that is dense in the buffer belongs into the innermost plane, where the kernels transpose. */
  for (uint32_t i = 2; i < p->count; ++i)
    if (p->by_float[i] == 0) {
      const move_axis dense_axis = axis[i];
      memmove(axis + 2, axis + 1, (i - 1) * sizeof axis[0]);
      axis[1] = dense_axis;
      break;
    }
  t->run = 1;
  for (t->run_axes = 0; t->run_axes < p->count; ++t->run_axes) {
    if (p->axis[t->run_axes].sample != (ptrdiff_t)(t->run * p->kernels->sample_size)) break;
    t->run *= t->extent[t->run_axes];
  }
  const size_t run_bytes = t->run * p->kernels->sample_size;
  t->ahead = p->packing || run_bytes > longest_fetched ? 0 : (lines_ahead * 64 + run_bytes - 1) / run_bytes;
  const size_t count = (size_t)dense / sizeof(float);
  if (p->packing) {
    move_floats(p->kernels, floats, (char *)buffer, axis, p->count);
    return convert_samples(t, samples, buffer, count);
  }
  const bool fine = convert_samples(t, samples, buffer, count);
  move_floats(p->kernels, (const char *)buffer, floats, axis, p->count);
  return fine;
}

static bool walk_tiles(tile_view *t, uint32_t level, char *samples, char *floats) {
  if (level == 0) return convert_tile(t, samples, floats);
  const plan_axis axis = t->plan->axis[level - 1];
  const size_t step = t->plan->tile[level - 1], count = t->slab[level - 1];
  bool fine = true;
  for (size_t i = 0; i < count; i += step) {
    t->extent[level - 1] = BTFI_MIN(step, count - i);
    fine &=
        walk_tiles(t, level - 1, samples + (ptrdiff_t)i * axis.sample, floats + (ptrdiff_t)i * axis.floats);
  }
  return fine;
}

static bool walk_slabs(tile_view *t, uint32_t level, char *samples, char *floats) {
  if (level == 0) return walk_tiles(t, t->plan->count, samples, floats);
  const plan_axis axis = t->plan->axis[level - 1];
  const size_t step = t->plan->slab[level - 1];
  bool fine = true;
  for (size_t i = 0; i < axis.count; i += step) {
    t->slab[level - 1] = BTFI_MIN(step, axis.count - i);
    fine &=
        walk_slabs(t, level - 1, samples + (ptrdiff_t)i * axis.sample, floats + (ptrdiff_t)i * axis.floats);
  }
  return fine;
}

static bool walk_rows(const reorder_plan *p, uint32_t level, char *samples, char *floats) {
  if (level <= 1) return convert_run(p, samples, (float *)(void *)floats, p->count ? p->axis[0].count : 1);
  const plan_axis axis = p->axis[level - 1];
  bool fine = true;
  for (size_t i = 0; i < axis.count; ++i)
    fine &=
        walk_rows(p, level - 1, samples + (ptrdiff_t)i * axis.sample, floats + (ptrdiff_t)i * axis.floats);
  return fine;
}

static bool run_plan(const reorder_plan *p, char *samples, char *floats) {
  const bool rows = p->count == 0 || (p->axis[0].sample == (ptrdiff_t)p->kernels->sample_size &&
                                      p->axis[0].floats == (ptrdiff_t)sizeof(float) &&
                                      (p->count == 1 || p->axis[0].count >= 16));
  if (rows) return walk_rows(p, p->count, samples, floats);
  tile_view t = {.plan = p};
  return walk_slabs(&t, p->count, samples, floats);
}

/* ---- blocks ---- */

static void start_plan(reorder_plan *p, const btfi_convert_kernels *kernels, const btfi_axis *axes,
                       uint32_t count, bool packing) {
  memset(p, 0, sizeof *p);
  p->kernels = kernels;
  p->packing = packing;
  for (uint32_t k = 0; k < count; ++k) {
    if (axes[k].count == 1) continue;
    p->axis[p->count].count = axes[k].count;
    p->axis[p->count].sample = packing ? axes[k].dst : axes[k].src;
    p->axis[p->count].floats = packing ? axes[k].src : axes[k].dst;
    p->count++;
  }
  make_plan(p);
}

bool btfi_pack_block(const btfi_convert_kernels *kernels, const btfi_axis *axes, uint32_t axis_count,
                     const void *src, void *dst) {
  reorder_plan plan;
  start_plan(&plan, kernels, axes, axis_count, true);
  return run_plan(&plan, (char *)dst, (char *)(uintptr_t)src);
}

typedef struct unpack_job {
  const reorder_plan *plan;
  char *samples, *floats;
  uint32_t split; /* axis that is divided among the tasks */
  size_t step;
  atomic_bool finite;
} unpack_job;

static void unpack_part(void *user, uint32_t index, uint32_t thread) {
  (void)thread;
  unpack_job *job = user;
  reorder_plan part = *job->plan;
  plan_axis *axis = &part.axis[job->split];
  const size_t first = (size_t)index * job->step;
  axis->count = BTFI_MIN(job->step, axis->count - first);
  if (!run_plan(&part, job->samples + (ptrdiff_t)first * axis->sample,
                job->floats + (ptrdiff_t)first * axis->floats))
    atomic_store_explicit(&job->finite, false, memory_order_relaxed);
}

btf_status btfi_unpack_block(btf_context *ctx, const btfi_convert_kernels *kernels, const btfi_axis *axes,
                             uint32_t axis_count, const void *src, void *dst, bool *finite) {
  reorder_plan plan;
  start_plan(&plan, kernels, axes, axis_count, false);
  char *samples = (char *)(uintptr_t)src;
  size_t total = 1;
  for (uint32_t k = 0; k < plan.count; ++k) total *= plan.axis[k].count;
  const uint32_t parts = 4 * btfi_thread_count(ctx);
  if (total < parallel_from || parts <= 4) {
    *finite = run_plan(&plan, samples, dst);
    return BTF_OK;
  }
  /* The outermost axis that gives every thread some parts keeps each thread's memory together. */
  unpack_job job = {.plan = &plan, .samples = samples, .floats = dst};
  job.split = plan.count - 1;
  for (uint32_t k = plan.count; k-- > 0 && plan.axis[job.split].count < parts;)
    if (plan.axis[k].count > plan.axis[job.split].count) job.split = k;
  const size_t count = plan.axis[job.split].count;
  job.step = (count + parts - 1) / parts;
  if (job.step > 64) job.step = (job.step + 63) & ~(size_t)63;
  atomic_init(&job.finite, true);
  BTFI_TRY(btfi_parallel(ctx, (uint32_t)((count + job.step - 1) / job.step), unpack_part, &job));
  *finite = atomic_load(&job.finite);
  return BTF_OK;
}
