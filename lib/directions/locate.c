/* SPDX-License-Identifier: MIT */
#include "directions/dirset.h"

/* Directions that go through the stages of locate_n together. */
#define BATCH 64

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

static inline void store(const btfi_facet *f, const facet_weights *w, btf_interp *out) {
  out->index[0] = f->vertex[0];
  out->index[1] = f->vertex[1];
  out->index[2] = f->vertex[2];
  /* At a sample one product is 1 within what a float can tell, another is exactly 0. */
  out->weight[0] = (float)(w->weight[0] > DUST ? w->weight[0] : 0.0);
  out->weight[1] = (float)w->weight[1];
  out->weight[2] = (float)w->weight[2];
}

static inline uint32_t step(const btfi_facet *f, const facet_weights *w) {
  return w->b < 0.0 ? f->next[1] : w->c < 0.0 ? f->next[2] : f->next[0];
}

uint32_t btfi_dirset_locate_from(const btf_dirset *set, uint32_t facet, double x, double y, btf_interp *out) {
  const btfi_facet *f = &set->facet[facet];
  facet_weights w = weigh(f, x, y);
  for (uint32_t steps = 0; !w.holds; steps++) {
    const bool lost = steps >= set->facet_count;
    facet = step(f, &w);
    if (__builtin_expect(lost, 0)) facet = search_everywhere(set, x, y);
    f = &set->facet[facet];
    w = weigh(f, x, y);
    if (__builtin_expect(lost, 0)) break;
  }
  store(f, &w, out);
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

/* One batch in passes without branches that depend on the directions, but for the few that need another facet
 * than the raster's. */
static void locate_batch(const btf_dirset *set, int n, const float *x, const float *y, const float *z,
                         btf_interp *out) {
  float px[BATCH], py[BATCH];
  double ux[BATCH], uy[BATCH];
  uint8_t again[BATCH];
  for (int i = 0; i < n; i++) {
    const float up = z[i] < 0.0f ? 0.0f : z[i],
                scale = 1.0f / (sqrtf(x[i] * x[i] + y[i] * y[i] + up * up) + up);
    px[i] = x[i] * scale;
    py[i] = y[i] * scale;
  }
  int unusual = 0;
  for (int i = 0; i < n; i++) unusual |= !btfi_parabolic_is_usual(x[i], y[i], z[i]);
  for (int i = 0; unusual && i < n; i++) {
    btfi_parabolic p = {0.0f, 0.0f};
    btfi_parabolic_of(x[i], y[i], z[i], &p);
    px[i] = p.px;
    py[i] = p.py;
  }
  for (int i = 0; i < n; i++) {
    ux[i] = btfi_to_units(px[i]);
    uy[i] = btfi_to_units(py[i]);
  }
  int left = 0;
  for (int i = 0; i < n; i++) {
    const btfi_facet *f = &set->facet[btfi_raster_leaf(set, px[i], py[i])->facet];
    const facet_weights w = weigh(f, ux[i], uy[i]);
    store(f, &w, &out[i]);
    again[left] = (uint8_t)i;
    left += !w.holds;
  }
  for (int k = 0; k < left; k++) {
    const int i = again[k];
    btfi_dirset_locate_from(set, btfi_raster_leaf(set, px[i], py[i])->facet, ux[i], uy[i], &out[i]);
  }
  for (int i = 0; unusual && i < n; i++)
    if (!isfinite(x[i]) || !isfinite(y[i]) || !isfinite(z[i]))
      out[i] = (btf_interp){{0, 0, 0}, {1.0f, 0.0f, 0.0f}};
}

void btf_dirset_locate_n(const btf_dirset *set, size_t n, const float *x, const float *y, const float *z,
                         btf_interp *out) {
  for (size_t i = 0; i < n; i += BATCH)
    locate_batch(set, (int)BTFI_MIN(n - i, (size_t)BATCH), x + i, y + i, z + i, out + i);
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
