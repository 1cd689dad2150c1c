/* SPDX-License-Identifier: MIT */
/* The raster gives a direction a triangle close to its own and the few samples one of which is its nearest.
 */
#include "directions/dirset.h"

#include <string.h>

/* A leaf with more candidates than this is split while there is room. */
#define CROWDED 8

/* Rounding of a direction's parabolic coordinates, with much to spare. */
#define MARGIN 1e-6

/* A cell whose list of candidates is known and that may still be split. */
typedef struct pending_cell {
  uint32_t cell, count;
  uint64_t list; /* start in the level's lists */
  double x, y, half;
} pending_cell;

/* An array that grows through the context. */
typedef struct growing {
  void *data;
  uint64_t used, room;
} growing;

typedef struct builder {
  btf_dirset *set;
  growing cells, nearby;
  growing pending[2], lists[2]; /* of this level and of the next */
  uint64_t cell_budget, list_budget;
} builder;

static btf_status reserve(btf_context *ctx, growing *g, uint64_t more, uint64_t size) {
  if (more <= g->room - g->used) return BTF_OK;
  uint64_t room;
  if (!btfi_add(g->used, more, &room) || !btfi_add(room, room / 2, &room)) room = UINT64_MAX;
  void *data = btfi_alloc(ctx, room, size);
  if (!data) return btfi_alloc_status();
  if (g->used) memcpy(data, g->data, g->used * size);
  btfi_free(ctx, g->data);
  g->data = data;
  g->room = room;
  return BTF_OK;
}

/* The samples of a list that can be the nearest of some direction in a cell. With c the cell's centre and s
 * the sample nearest to it, i cannot be nearer than s anywhere at a chord of at most r from c if c . (s - i)
 * > r |s - i|. Returns their number. */
static uint32_t candidates(const btf_dirset *set, const uint32_t *list, uint32_t n, double x, double y,
                           double half, uint32_t *out) {
  const double r2 = x * x + y * y, reach = half * sqrt(2.0) + MARGIN;
  const double closest = fmax(0.0, sqrt(r2) - reach);
  const double c[3] = {2.0 * x / (1.0 + r2), 2.0 * y / (1.0 + r2), (1.0 - r2) / (1.0 + r2)};
  const double chord = 2.0 * reach / sqrt((1.0 + r2) * (1.0 + closest * closest));
  const double *s = NULL;
  double s_dot = -INFINITY;
  for (uint32_t i = 0; i < n; i++) {
    const double *u = set->unit[list[i]], dot = c[0] * u[0] + c[1] * u[1] + c[2] * u[2];
    if (dot > s_dot) {
      s_dot = dot;
      s = u;
    }
  }
  uint32_t kept = 0;
  for (uint32_t i = 0; i < n; i++) {
    const double *u = set->unit[list[i]], dx = s[0] - u[0], dy = s[1] - u[1], dz = s[2] - u[2];
    const double lead = c[0] * dx + c[1] * dy + c[2] * dz - 1e-12;
    if (lead <= 0.0 || lead * lead <= chord * chord * (dx * dx + dy * dy + dz * dz)) out[kept++] = list[i];
  }
  return kept;
}

/* No direction has a cell whose nearest point is beyond the rim of the disc. */
static bool is_reachable(double x, double y, double half) {
  const double nx = fmax(0.0, fabs(x) - half), ny = fmax(0.0, fabs(y) - half);
  return nx * nx + ny * ny < 1.0 + 2.0 * MARGIN;
}

static btf_status store_leaf(builder *b, uint32_t index, const uint32_t *list, uint32_t count) {
  btf_context *ctx = b->set->ctx;
  BTFI_TRY(reserve(ctx, &b->nearby, (uint64_t)count + 1, sizeof(uint32_t)));
  if (b->nearby.used >= BTFI_CELL_SINGLE)
    return btfi_fail(ctx, BTF_E_LIMIT,
                     "direction set: too many samples are equally near to too many directions");
  uint32_t *nearby = (uint32_t *)b->nearby.data + b->nearby.used;
  ((btfi_cell *)b->cells.data)[index].ref = (uint32_t)b->nearby.used;
  nearby[0] = count;
  memcpy(nearby + 1, list, count * sizeof *list);
  b->nearby.used += (uint64_t)count + 1;
  return BTF_OK;
}

/* Fills a cell as a leaf, or puts it off if it is crowded. `from` must not lie in the lists of the same
 * level. */
static btf_status fill_cell(builder *b, uint32_t index, const uint32_t *from, uint32_t n, double x, double y,
                            double half, uint32_t facet, int level) {
  btf_dirset *set = b->set;
  growing *lists = &b->lists[level & 1], *pending = &b->pending[level & 1];
  btfi_cell *cell = (btfi_cell *)b->cells.data + index;
  cell->facet = facet;
  cell->ref = BTFI_CELL_SINGLE;
  if (!is_reachable(x, y, half)) return BTF_OK;
  btf_interp unused;
  cell->facet = btfi_dirset_locate_from(set, facet, rint(x * BTFI_UNITS), rint(y * BTFI_UNITS), &unused);
  BTFI_TRY(reserve(set->ctx, lists, n, sizeof(uint32_t)));
  uint32_t *kept = (uint32_t *)lists->data + lists->used;
  const uint32_t count = candidates(set, from, n, x, y, half, kept);
  if (count == 1) {
    cell->ref = BTFI_CELL_SINGLE | kept[0];
    return BTF_OK;
  }
  if (count > CROWDED && level < BTFI_RASTER_DEPTH) {
    BTFI_TRY(reserve(set->ctx, pending, 1, sizeof(pending_cell)));
    ((pending_cell *)pending->data)[pending->used++] = (pending_cell){index, count, lists->used, x, y, half};
    lists->used += count;
    return BTF_OK;
  }
  return store_leaf(b, index, kept, count);
}

/* Root cells, by way of 8 x 8 coarse ones so that not every cell looks at every sample. */
static btf_status fill_root(builder *b, const uint32_t *all, uint32_t *coarse) {
  btf_dirset *set = b->set;
  const uint32_t n = BTFI_RASTER_ROOT, group = 8;
  const double half = 0.5 / BTFI_RASTER_SCALE;
  uint32_t facet = 0;
  for (uint32_t row = 0; row < n; row += group) {
    for (uint32_t column = 0; column < n; column += group) {
      const uint32_t kept = candidates(set, all, set->count, (2 * column + group) * half - 1.0,
                                       (2 * row + group) * half - 1.0, group * half, coarse);
      for (uint32_t i = 0; i < group * group; i++) {
        const uint32_t c = column + i % group, r = row + i / group;
        BTFI_TRY(fill_cell(b, r * n + c, coarse, kept, (2 * c + 1) * half - 1.0, (2 * r + 1) * half - 1.0,
                           half, facet, 0));
        facet = ((btfi_cell *)b->cells.data)[r * n + c].facet;
      }
    }
  }
  return BTF_OK;
}

static btf_status split_cell(builder *b, const pending_cell *p, int level) {
  btf_dirset *set = b->set;
  const uint32_t n = BTFI_RASTER_SPLIT, children = n * n;
  BTFI_TRY(reserve(set->ctx, &b->cells, children, sizeof(btfi_cell)));
  const uint32_t first = (uint32_t)b->cells.used;
  b->cells.used += children;
  uint32_t facet = ((btfi_cell *)b->cells.data)[p->cell].facet;
  for (uint32_t i = 0; i < children; i++) {
    const double half = p->half / n;
    const double x = p->x - p->half + (2 * (i % n) + 1) * half, y = p->y - p->half + (2 * (i / n) + 1) * half;
    const uint32_t *list = (const uint32_t *)b->lists[level & 1].data + p->list;
    BTFI_TRY(fill_cell(b, first + i, list, p->count, x, y, half, facet, level + 1));
    facet = ((btfi_cell *)b->cells.data)[first + i].facet;
  }
  ((btfi_cell *)b->cells.data)[p->cell].ref = BTFI_CELL_SPLIT | first;
  return BTF_OK;
}

/* Level by level, so that a budget that runs out leaves all regions equally fine. */
static btf_status fill_levels(builder *b) {
  for (int level = 0; level <= BTFI_RASTER_DEPTH; level++) {
    growing *pending = &b->pending[level & 1];
    b->pending[(level + 1) & 1].used = b->lists[(level + 1) & 1].used = 0;
    for (uint64_t i = 0; i < pending->used; i++) {
      const pending_cell p = ((const pending_cell *)pending->data)[i];
      const uint64_t lists = b->nearby.used + b->lists[0].used + b->lists[1].used;
      if (b->cells.used < b->cell_budget && lists < b->list_budget) {
        BTFI_TRY(split_cell(b, &p, level));
      } else {
        BTFI_TRY(store_leaf(b, p.cell, (const uint32_t *)b->lists[level & 1].data + p.list, p.count));
      }
    }
  }
  return BTF_OK;
}

btf_status btfi_dirset_build_raster(btf_dirset *set) {
  btf_context *ctx = set->ctx;
  const uint64_t roots = BTFI_RASTER_ROOT * BTFI_RASTER_ROOT;
  builder b = {.set = set,
               .cell_budget = 3 * roots + 8 * (uint64_t)set->count,
               .list_budget = 16 * roots + 64 * (uint64_t)set->count};
  uint32_t *all = btfi_alloc(ctx, 2 * (uint64_t)set->count, sizeof *all);
  btf_status status = all ? reserve(ctx, &b.cells, roots, sizeof(btfi_cell)) : btfi_alloc_status();
  if (status == BTF_OK) {
    for (uint32_t i = 0; i < set->count; i++) all[i] = i;
    b.cells.used = roots;
    status = fill_root(&b, all, all + set->count);
  }
  if (status == BTF_OK) status = fill_levels(&b);
  for (int i = 0; i < 2; i++) {
    btfi_free(ctx, b.pending[i].data);
    btfi_free(ctx, b.lists[i].data);
  }
  btfi_free(ctx, all);
  set->cell = b.cells.data;
  set->cell_count = (uint32_t)b.cells.used;
  set->nearby = b.nearby.data;
  return status;
}
