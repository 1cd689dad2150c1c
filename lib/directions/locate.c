/* SPDX-License-Identifier: MIT */
#include "directions/dirset.h"

/* A weight this small next to the others is rounding. */
#define DUST 1e-12

typedef struct facet_weights {
  double b, c; /* their signs decide */
  double weight[3];
  bool holds;
} facet_weights;

static inline facet_weights weigh(const btfi_facet *f, double x, double y) {
  const double px = x - (double)f->x, py = y - (double)f->y;
  facet_weights w;
  w.b = px * f->cy - py * f->cx;
  w.c = f->bx * py - f->by * px;
  w.weight[1] = w.b * f->b_scale;
  w.weight[2] = w.c * f->c_scale;
  w.weight[0] = 1.0 - w.weight[1] - w.weight[2];
  w.holds = (w.b >= 0.0) & (w.c >= 0.0) & (w.weight[0] >= -DUST);
  return w;
}

/* For walks that do not end: steps lower the power of the point to the circles of exact Delaunay triangles,
 * so they do end there, but settled ties and peeled rims are Delaunay up to rounding only. */
static __attribute__((noinline, cold)) uint32_t search_everywhere(const btf_dirset *set, double x, double y) {
  for (uint32_t i = 0; i < set->facet_count; i++)
    if (weigh(&set->facet[i], x, y).holds) return i;
  return 0;
}

uint32_t btfi_dirset_locate_from(const btf_dirset *set, uint32_t facet, double x, double y, btf_interp *out) {
  const btfi_facet *f = &set->facet[facet];
  facet_weights w = weigh(f, x, y);
  for (uint32_t steps = 0; !w.holds; steps++) {
    const bool lost = steps >= set->facet_count;
    facet = w.b < 0.0 ? f->next[1] : w.c < 0.0 ? f->next[2] : f->next[0];
    if (__builtin_expect(lost, 0)) facet = search_everywhere(set, x, y);
    f = &set->facet[facet];
    w = weigh(f, x, y);
    if (__builtin_expect(lost, 0)) break;
  }
  out->index[0] = f->vertex[0];
  out->index[1] = f->vertex[1];
  out->index[2] = f->vertex[2];
  /* At a sample one product is 1 within what a float can tell, another is exactly 0. */
  out->weight[0] = (float)(w.weight[0] > DUST ? w.weight[0] : 0.0);
  out->weight[1] = (float)w.weight[1];
  out->weight[2] = (float)w.weight[2];
  return facet;
}

void btf_dirset_locate(const btf_dirset *set, const float dir[3], btf_interp *out) {
  btfi_parabolic p;
  if (!btfi_parabolic_of(dir[0], dir[1], dir[2], &p)) {
    *out = (btf_interp){{0, 0, 0}, {1.0f, 0.0f, 0.0f}};
    return;
  }
  const btfi_cell *leaf = btfi_raster_leaf(set, p.px, p.py);
  btfi_dirset_locate_from(set, leaf->facet, btfi_to_units(p.px), btfi_to_units(p.py), out);
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
