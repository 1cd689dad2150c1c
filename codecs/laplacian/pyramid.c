/* SPDX-License-Identifier: MIT */
/* pyramid.c: Laplacian pyramids of images (equations 2 and 3). F_{k+1} is F_k filtered and sampled at the
 * texels of level k + 1. Band k is F_k less what evaluation makes of all coarser bands at the texel centres
 * of level k: the upsampling is evaluation's own, so that a decoded level is exact at its texels whatever the
 * sizes. */
#include "laplacian.h"

#include <math.h>

/* 3 times as many texels, when 3 become 1, under a binomial that is twice as wide. */
enum { MOST_TAPS = 8 };

/* Where one texel of level k + 1 comes from along an axis. */
typedef struct down_taps {
  uint32_t count, index[MOST_TAPS];
  float weight[MOST_TAPS];
} down_taps;

/* Where level k reads a coarser band along an axis. */
typedef struct up_taps {
  uint32_t index[2];
  float weight[2];
} up_taps;

struct btfi_laplacian_pyramid {
  const btf_host *host;
  btf_context *ctx;
  btfi_laplacian_grid grid;
  uint64_t offset[LAPLACIAN_MAX_LEVELS + 1];
  uint64_t scratch;
  /* [axis]: from level k to k + 1 all levels after each other, and from each level to each coarser one. */
  down_taps *down[2], *down_of[2][LAPLACIAN_MAX_LEVELS];
  up_taps *up[2], *up_of[2][LAPLACIAN_MAX_LEVELS][LAPLACIAN_MAX_LEVELS];
};

static const uint32_t *sizes_of(const btfi_laplacian_pyramid *p, int axis) {
  return axis == 0 ? p->grid.width : p->grid.height;
}

static void add_tap(down_taps *taps, int64_t index, uint32_t size, uint32_t wrap, double weight) {
  if (index < 0) index = wrap == BTF_WRAP_CLAMP ? 0 : index + size;
  if (index >= size) index = wrap == BTF_WRAP_CLAMP ? (int64_t)size - 1 : index - size;
  /* A texture of one texel is beside itself. */
  if (index < 0 || index >= size) index = 0;
  taps->index[taps->count] = (uint32_t)index;
  taps->weight[taps->count++] = (float)weight;
}

/* Share of fine texel `index` in coarse texel i, not yet divided by their sum. */
static double share(uint32_t filter, double ratio, uint32_t i, int64_t index) {
  if (filter == LAPLACIAN_MEAN_FILTER)
    return fmin((double)index + 1.0, (i + 1.0) * ratio) - fmax((double)index, i * ratio);
  return 1.0 - fabs((double)index + 0.5 - (i + 0.5) * ratio) / ratio;
}

static void make_down(uint32_t filter, uint32_t wrap, uint32_t size, uint32_t coarse, uint32_t i,
                      down_taps *out) {
  out->count = 0;
  if (filter == LAPLACIAN_PAPER_FILTER) {
    /* The paper's box around every second sample; where sizes are odd, around the sample at the same share.
     */
    const int64_t centre = (int64_t)((uint64_t)i * size / coarse);
    for (int64_t d = -1; d <= 1; d++) add_tap(out, centre + d, size, wrap, 1.0 / 3.0);
    return;
  }
  const double ratio = (double)size / coarse;
  const double reach = filter == LAPLACIAN_MEAN_FILTER ? ratio / 2.0 : ratio;
  const int64_t first = (int64_t)floor((i + 0.5) * ratio - reach);
  double sum = 0.0;
  for (int64_t index = first; index < first + MOST_TAPS; index++)
    sum += fmax(0.0, share(filter, ratio, i, index));
  for (int64_t index = first; index < first + MOST_TAPS; index++) {
    const double weight = share(filter, ratio, i, index) / sum;
    if (weight > 1e-9) add_tap(out, index, size, wrap, weight);
  }
}

static void make_up(const btfi_laplacian_grid *grid, const uint32_t *sizes, uint32_t level, uint32_t coarser,
                    uint32_t i, up_taps *out) {
  const double share = btfi_laplacian_share((float)((i + 0.5) / sizes[level]), grid->wrap);
  uint32_t finest[2];
  float finest_weight[2];
  btfi_laplacian_linear(share, sizes[0], grid->wrap, finest, finest_weight);
  btfi_laplacian_taps(grid, sizes, coarser, share, finest, finest_weight, out->index, out->weight);
}

static btf_status make_taps(btfi_laplacian_pyramid *p, int axis) {
  const uint32_t *sizes = sizes_of(p, axis), levels = p->grid.levels;
  uint64_t downs = 1, ups = 1;
  for (uint32_t k = 0; k + 1 < levels; k++) {
    downs += sizes[k + 1];
    ups += (uint64_t)sizes[k] * (levels - 1 - k);
  }
  p->down[axis] = p->host->alloc(p->ctx, downs, sizeof *p->down[axis]);
  p->up[axis] = p->host->alloc(p->ctx, ups, sizeof *p->up[axis]);
  if (p->down[axis] == NULL || p->up[axis] == NULL) return BTF_E_NOMEM;
  down_taps *down = p->down[axis];
  up_taps *up = p->up[axis];
  for (uint32_t k = 0; k + 1 < levels; k++) {
    p->down_of[axis][k] = down;
    for (uint32_t i = 0; i < sizes[k + 1]; i++)
      make_down(p->grid.filter, p->grid.wrap, sizes[k], sizes[k + 1], i, down++);
    for (uint32_t j = k + 1; j < levels; j++) {
      p->up_of[axis][k][j] = up;
      for (uint32_t i = 0; i < sizes[k]; i++) make_up(&p->grid, sizes, k, j, i, up++);
    }
  }
  return BTF_OK;
}

btf_status btfi_laplacian_pyramid_create(const btf_host *host, btf_context *ctx,
                                         const btfi_laplacian_grid *grid, btfi_laplacian_pyramid **out) {
  btfi_laplacian_pyramid *p = host->alloc(ctx, 1, sizeof *p);
  *out = NULL;
  if (p == NULL) return BTF_E_NOMEM;
  memset(p, 0, sizeof *p);
  p->host = host;
  p->ctx = ctx;
  p->grid = *grid;
  /* Lines on their way up: as many as the second level has, as long as the first has. */
  p->scratch = (uint64_t)grid->width[0] * (grid->levels > 1 ? grid->height[1] : 1) + grid->width[0];
  for (uint32_t k = 0; k < grid->levels; k++)
    p->offset[k + 1] = p->offset[k] + (uint64_t)grid->width[k] * grid->height[k];
  btf_status status = make_taps(p, 0);
  if (status == BTF_OK) status = make_taps(p, 1);
  if (status != BTF_OK) {
    btfi_laplacian_pyramid_destroy(p);
    return status;
  }
  *out = p;
  return BTF_OK;
}

void btfi_laplacian_pyramid_destroy(btfi_laplacian_pyramid *p) {
  if (p == NULL) return;
  for (int axis = 0; axis < 2; axis++) {
    p->host->free(p->ctx, p->down[axis]);
    p->host->free(p->ctx, p->up[axis]);
  }
  p->host->free(p->ctx, p);
}

uint64_t btfi_laplacian_pyramid_floats(const btfi_laplacian_pyramid *p) {
  return p->offset[p->grid.levels];
}

uint64_t btfi_laplacian_pyramid_offset(const btfi_laplacian_pyramid *p, uint32_t level) {
  return p->offset[level];
}

uint64_t btfi_laplacian_pyramid_scratch(const btfi_laplacian_pyramid *p) {
  return p->scratch;
}

/* Level k + 1 from level k: lines first, each then along itself. */
static void filter_down(const btfi_laplacian_pyramid *p, uint32_t k, const float *restrict src,
                        float *restrict dst, float *restrict line) {
  const uint32_t width = p->grid.width[k], coarse_width = p->grid.width[k + 1];
  const bool halves = p->grid.filter == LAPLACIAN_MEAN_FILTER && width == 2 * coarse_width;
  for (uint32_t y = 0; y < p->grid.height[k + 1]; y++, dst += coarse_width) {
    const down_taps *rows = &p->down_of[1][k][y];
    const float *row = src + (uint64_t)rows->index[0] * width;
    for (uint32_t x = 0; x < width; x++) line[x] = rows->weight[0] * row[x];
    for (uint32_t t = 1; t < rows->count; t++) {
      const float weight = rows->weight[t];
      row = src + (uint64_t)rows->index[t] * width;
      for (uint32_t x = 0; x < width; x++) line[x] += weight * row[x];
    }
    if (halves) {
      for (uint32_t x = 0; x < coarse_width; x++) dst[x] = 0.5f * (line[2 * x] + line[2 * x + 1]);
      continue;
    }
    for (uint32_t x = 0; x < coarse_width; x++) {
      const down_taps *taps = &p->down_of[0][k][x];
      float sum = 0.0f;
      for (uint32_t t = 0; t < taps->count; t++) sum += taps->weight[t] * line[taps->index[t]];
      dst[x] = sum;
    }
  }
}

/* dst, an image of level k, gains factor times the coarser band j. */
static void add_up(const btfi_laplacian_pyramid *p, uint32_t k, uint32_t j, const float *restrict band,
                   float factor, float *restrict dst, float *restrict lines) {
  const uint32_t width = p->grid.width[k], coarse_width = p->grid.width[j];
  const up_taps *columns = p->up_of[0][k][j], *rows = p->up_of[1][k][j];
  for (uint32_t y = 0; y < p->grid.height[j]; y++) {
    const float *row = band + (uint64_t)y * coarse_width;
    float *line = lines + (uint64_t)y * width;
    for (uint32_t x = 0; x < width; x++)
      line[x] =
          columns[x].weight[0] * row[columns[x].index[0]] + columns[x].weight[1] * row[columns[x].index[1]];
  }
  for (uint32_t y = 0; y < p->grid.height[k]; y++, dst += width) {
    const float *first = lines + (uint64_t)rows[y].index[0] * width,
                *second = lines + (uint64_t)rows[y].index[1] * width;
    const float a = factor * rows[y].weight[0], b = factor * rows[y].weight[1];
    for (uint32_t x = 0; x < width; x++) dst[x] += a * first[x] + b * second[x];
  }
}

void btfi_laplacian_analyse(const btfi_laplacian_pyramid *p, uint32_t lowest, float *planes, float *scratch) {
  const uint32_t levels = p->grid.levels;
  for (uint32_t k = 0; k + 1 < levels; k++)
    filter_down(p, k, planes + p->offset[k], planes + p->offset[k + 1], scratch);
  for (uint32_t k = levels - 1; k-- > lowest;)
    for (uint32_t j = k + 1; j < levels; j++)
      add_up(p, k, j, planes + p->offset[j], -1.0f, planes + p->offset[k], scratch);
}

void btfi_laplacian_synthesise(const btfi_laplacian_pyramid *p, uint32_t level, float *planes,
                               float *scratch) {
  for (uint32_t j = level + 1; j < p->grid.levels; j++)
    add_up(p, level, j, planes + p->offset[j], 1.0f, planes + p->offset[level], scratch);
}
