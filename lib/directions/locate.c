/* SPDX-License-Identifier: MIT */
#include "directions/dirset.h"

/* Directions whose coordinates are worked out together, so that the compiler can use vectors for that part.
 */
#define BATCH 64

static inline void one_sample(uint32_t vertex, btf_interp *out) {
  *out = (btf_interp){{vertex, vertex, vertex}, {1.0f, 0.0f, 0.0f}};
}

/* Between the two samples of a rim edge that enclose a point, by its projection onto the edge. */
static void along_rim(const btf_dirset *set, const btfi_rim_edge *e, double x, double y, btf_interp *out) {
  const btfi_rim_sample *chain = set->rim_sample + e->chain;
  const double along = (x - e->x) * e->dx + (y - e->y) * e->dy;
  uint32_t low = 0, high = e->chain_count - 1;
  if (along <= 0.0 || high == 0) {
    one_sample(chain[0].vertex, out);
    return;
  }
  if (along >= chain[high].along) {
    one_sample(chain[high].vertex, out);
    return;
  }
  while (high - low > 1) {
    const uint32_t middle = low + (high - low) / 2;
    if (along < chain[middle].along)
      high = middle;
    else
      low = middle;
  }
  const double span = chain[high].along - chain[low].along;
  *out = (btf_interp){
      {chain[low].vertex, chain[high].vertex, chain[low].vertex},
      {(float)((chain[high].along - along) / span), (float)((along - chain[low].along) / span), 0.0f}};
}

/* Nearest point of the hull for a point outside. Seen from there the distance along the visible edges falls
 * and then rises, so stepping toward the projection ends at the nearest; `steps` guards against a damaged set
 * only. Returns the place, or the facet to go on in when the point is inside the edge. */
static uint32_t outside(const btf_dirset *set, uint32_t i, double x, double y, bool *done, btf_interp *out) {
  const btfi_rim_edge *rim = set->rim, *e = &rim[i];
  *done = false;
  if (e->dx * (y - e->y) - e->dy * (x - e->x) > 0.0) return e->inside;
  *done = true;
  for (uint32_t steps = 0; steps < set->rim_count; steps++) {
    const double along = (x - e->x) * e->dx + (y - e->y) * e->dy;
    if (along < 0.0) {
      const uint32_t before = i == 0 ? set->rim_count - 1 : i - 1;
      const btfi_rim_edge *b = &rim[before];
      if ((x - e->x) * b->dx + (y - e->y) * b->dy >= 0.0) break;
      i = before;
    } else if (along > e->length2) {
      const uint32_t after = i + 1 == set->rim_count ? 0 : i + 1;
      const btfi_rim_edge *a = &rim[after];
      if ((x - a->x) * a->dx + (y - a->y) * a->dy <= 0.0) break;
      i = after;
    } else {
      break;
    }
    e = &rim[i];
  }
  along_rim(set, e, x, y, out);
  return BTFI_OUTSIDE | i;
}

/* The place of a point found by looking everywhere: for walks that do not end, which exact triangulations do
 * not have but near-ties might. */
static __attribute__((noinline, cold)) uint32_t search_everywhere(const btf_dirset *set, double x, double y) {
  for (uint32_t i = 0; i < set->rim_count; i++) {
    const btfi_rim_edge *e = &set->rim[i];
    if (e->dx * (y - e->y) - e->dy * (x - e->x) < 0.0) return BTFI_OUTSIDE | i;
  }
  for (uint32_t i = 0; i < set->facet_count; i++) {
    const btfi_facet *f = &set->facet[i];
    bool holds = true;
    for (int k = 0; k < 3; k++) {
      const double ax = f->x[k], ay = f->y[k], dx = (double)f->x[(k + 1) % 3] - ax,
                   dy = (double)f->y[(k + 1) % 3] - ay;
      holds = holds && dx * (y - ay) - dy * (x - ax) >= 0.0;
    }
    if (holds) return i;
  }
  return 0;
}

uint32_t btfi_dirset_locate_from(const btf_dirset *set, uint32_t place, double x, double y, btf_interp *out) {
  if (set->facet_count == 0) {
    along_rim(set, set->rim, x, y, out);
    return place;
  }
  /* Each step lowers the point's power to the circle of the triangle, so none is met twice. */
  for (uint32_t steps = 0;; steps++) {
    if (__builtin_expect(steps > set->facet_count, 0)) place = search_everywhere(set, x, y);
    if (place & BTFI_OUTSIDE) {
      bool done;
      place = outside(set, place & ~BTFI_OUTSIDE, x, y, &done, out);
      if (done) return place;
    }
    const btfi_facet *f = &set->facet[place];
    const double px = x - (double)f->x[0], py = y - (double)f->y[0];
    const double bx = (double)f->x[1] - (double)f->x[0], by = (double)f->y[1] - (double)f->y[0];
    const double cx = (double)f->x[2] - (double)f->x[0], cy = (double)f->y[2] - (double)f->y[0];
    const double b = px * cy - py * cx, c = bx * py - by * px, a = f->area2 - b - c;
    if ((a >= 0.0) & (b >= 0.0) & (c >= 0.0)) {
      if (place >= set->triangle_count) {
        along_rim(set, &set->rim[set->sliver_edge[place - set->triangle_count]], x, y, out);
        return place;
      }
      out->index[0] = f->vertex[0];
      out->index[1] = f->vertex[1];
      out->index[2] = f->vertex[2];
      /* At a corner the product differs from 1 by less than a float can tell. */
      out->weight[0] = (float)(a * f->scale);
      out->weight[1] = (float)(b * f->scale);
      out->weight[2] = (float)(c * f->scale);
      return place;
    }
    place = a < 0.0 ? f->next[0] : b < 0.0 ? f->next[1] : f->next[2];
  }
}

void btf_dirset_locate(const btf_dirset *set, const float dir[3], btf_interp *out) {
  btfi_parabolic p;
  if (!btfi_parabolic_of(dir[0], dir[1], dir[2], &p)) {
    *out = (btf_interp){{0, 0, 0}, {1.0f, 0.0f, 0.0f}};
    return;
  }
  const btfi_cell *leaf = btfi_raster_leaf(set, p.px, p.py);
  btfi_dirset_locate_from(set, leaf->place, btfi_to_units(p.px), btfi_to_units(p.py), out);
}

void btf_dirset_locate_n(const btf_dirset *set, size_t n, const float *x, const float *y, const float *z,
                         btf_interp *out) {
  for (size_t i = 0; i < n; i++) {
    const float dir[3] = {x[i], y[i], z[i]};
    btf_dirset_locate(set, dir, &out[i]);
  }
}

uint32_t btf_dirset_nearest(const btf_dirset *set, const float dir[3]) {
  btfi_parabolic p;
  if (!btfi_parabolic_of(dir[0], dir[1], dir[2], &p)) return 0;
  const btfi_cell *leaf = btfi_raster_leaf(set, p.px, p.py);
  if (leaf->ref & BTFI_CELL_SINGLE) return leaf->ref & ~BTFI_CELL_SINGLE;
  double x = dir[0], y = dir[1];
  const double z = dir[2] > 0.0f ? dir[2] : 0.0;
  if (x == 0.0 && y == 0.0 && z == 0.0) x = 1.0;
  const uint32_t *near = set->nearby + leaf->ref, count = *near++;
  uint32_t best = near[0];
  double best_dot = -INFINITY;
  for (uint32_t i = 0; i < count; i++) {
    const double *u = set->unit[near[i]];
    const double dot = x * u[0] + y * u[1] + z * u[2];
    if (dot > best_dot) {
      best_dot = dot;
      best = near[i];
    }
  }
  return best;
}
