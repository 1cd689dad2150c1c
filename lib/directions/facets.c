/* SPDX-License-Identifier: MIT */
#include "directions/dirset.h"

#include <string.h>

static double dot_from(const int32_t from[2], const int32_t to[2], double dx, double dy) {
  return (double)(to[0] - from[0]) * dx + (double)(to[1] - from[1]) * dy;
}

static uint32_t farthest(const btf_dirset *set, uint32_t from) {
  uint32_t best = from;
  double best_distance = -1.0;
  for (uint32_t i = 0; i < set->count; i++) {
    const double x = set->point[i][0] - set->point[from][0], y = set->point[i][1] - set->point[from][1];
    if (x * x + y * y > best_distance) {
      best_distance = x * x + y * y;
      best = i;
    }
  }
  return best;
}

/* Whether all samples lie on the line from a to b as far as rounding can tell. */
static bool on_a_line(const btf_dirset *set, uint32_t a, uint32_t b) {
  const double dx = set->point[b][0] - set->point[a][0], dy = set->point[b][1] - set->point[a][1];
  const double allowed = BTFI_RIM_UNITS * sqrt(dx * dx + dy * dy);
  for (uint32_t i = 0; i < set->count; i++)
    if (fabs((double)btfi_area2(set->point[a], set->point[b], set->point[i])) > allowed) return false;
  return true;
}

static void start_rim_edge(btf_dirset *set, btfi_rim_edge *e, uint32_t from, uint32_t to) {
  e->x = set->point[from][0];
  e->y = set->point[from][1];
  e->dx = set->point[to][0] - e->x;
  e->dy = set->point[to][1] - e->y;
  e->length2 = e->dx * e->dx + e->dy * e->dy;
}

/* Copies samples sorted along an edge to the rim. Bits of doubles that are not negative sort like their
 * values. */
static void store_chain(btf_dirset *set, btfi_rim_edge *e, uint32_t start, btfi_keyed *list,
                        btfi_keyed *scratch, uint32_t n) {
  btfi_sort_keyed(list, scratch, n);
  e->chain = start;
  e->chain_count = n;
  for (uint32_t i = 0; i < n; i++) {
    btfi_rim_sample *s = &set->rim_sample[start + i];
    memcpy(&s->along, &list[i].key, sizeof s->along);
    s->vertex = list[i].item;
  }
}

static btfi_keyed key_along(const btf_dirset *set, const btfi_rim_edge *e, uint32_t vertex) {
  btfi_keyed k = {0, vertex};
  const double along =
      (set->point[vertex][0] - e->x) * e->dx + (set->point[vertex][1] - e->y) * e->dy + 0.0; /* no -0 */
  memcpy(&k.key, &along, sizeof k.key);
  return k;
}

static btf_status build_line(btf_dirset *set, uint32_t a, uint32_t b) {
  btf_context *ctx = set->ctx;
  set->rim = btfi_calloc(ctx, 1, sizeof *set->rim);
  if (!set->rim) return btfi_alloc_status();
  set->rim_count = 1;
  set->rim_sample = btfi_alloc(ctx, set->count, sizeof *set->rim_sample);
  if (!set->rim_sample) return btfi_alloc_status();
  btfi_keyed *list = btfi_alloc(ctx, 2 * (uint64_t)set->count, sizeof *list);
  if (!list) return btfi_alloc_status();
  start_rim_edge(set, set->rim, a, b);
  for (uint32_t i = 0; i < set->count; i++) list[i] = key_along(set, set->rim, i);
  store_chain(set, set->rim, 0, list, list + set->count, set->count);
  btfi_free(ctx, list);
  return BTF_OK;
}

/* What is known while the rim is built. */
typedef struct rim_work {
  btf_dirset *set;
  btfi_triangulation t;
  uint64_t *rim_side;  /* by edge of the rim: triangle << 2 | corner opposite */
  uint64_t *pending;   /* sides in the same form */
  uint32_t *hull_edge; /* by vertex: the edge that starts there */
  uint32_t *sliver;    /* by triangle: hull edge it belongs to, or NO_TRIANGLE */
  uint32_t *number;    /* by triangle: its facet */
  uint8_t *on_rim;     /* by vertex */
  btfi_keyed *keyed;
} rim_work;

/* Goes round the hull once, from its smallest vertex. */
static btf_status walk_hull(rim_work *w) {
  btf_dirset *set = w->set;
  uint32_t n = 0, first = UINT32_MAX;
  for (uint32_t t = 0; t < w->t.count; t++) {
    for (uint32_t k = 0; k < 3; k++) {
      if (w->t.next[t][k] != BTFI_NO_TRIANGLE) continue;
      const uint32_t from = w->t.vertex[t][(k + 1) % 3];
      w->pending[n] = (uint64_t)t << 2 | k;
      w->hull_edge[from] = n++;
      first = BTFI_MIN(first, from);
    }
  }
  set->rim = btfi_calloc(set->ctx, n, sizeof *set->rim);
  if (!set->rim) return btfi_alloc_status();
  set->rim_count = n;
  uint32_t v = first;
  for (uint32_t i = 0; i < n; i++) {
    w->rim_side[i] = w->pending[w->hull_edge[v]];
    const uint32_t t = (uint32_t)(w->rim_side[i] >> 2), k = (uint32_t)(w->rim_side[i] & 3);
    const uint32_t to = w->t.vertex[t][(k + 2) % 3];
    start_rim_edge(set, &set->rim[i], v, to);
    w->on_rim[v] = 1;
    v = to;
  }
  return BTF_OK;
}

/* Takes the thin triangles off one hull edge, so that samples which rounding moved inward by a hair still
 * count as lying on it: without this, directions outside the hull would skip them. */
static uint32_t peel_edge(rim_work *w, uint32_t edge, uint32_t chain) {
  btf_dirset *set = w->set;
  btfi_rim_edge *e = &set->rim[edge];
  const uint32_t side = (uint32_t)(w->rim_side[edge] & 3), *ends = w->t.vertex[w->rim_side[edge] >> 2];
  const uint32_t from = ends[(side + 1) % 3];
  const int32_t *start = set->point[from];
  const double allowed = BTFI_RIM_UNITS * sqrt(e->length2);
  uint32_t found = 0, pending = 0;
  w->keyed[found++] = key_along(set, e, from);
  w->keyed[found++] = key_along(set, e, ends[(side + 2) % 3]);
  w->pending[pending++] = w->rim_side[edge];
  while (pending > 0) {
    const uint64_t open = w->pending[--pending];
    const uint32_t t = (uint32_t)(open >> 2), k = (uint32_t)(open & 3), apex = w->t.vertex[t][k];
    const int32_t *a = set->point[apex];
    const double away = e->dx * (double)(a[1] - start[1]) - e->dy * (double)(a[0] - start[0]);
    const double along = dot_from(start, a, e->dx, e->dy);
    if (w->on_rim[apex] || away > allowed ||
        along <= dot_from(start, set->point[w->t.vertex[t][(k + 1) % 3]], e->dx, e->dy) ||
        along >= dot_from(start, set->point[w->t.vertex[t][(k + 2) % 3]], e->dx, e->dy))
      continue;
    w->sliver[t] = edge;
    w->on_rim[apex] = 1;
    w->keyed[found++] = key_along(set, e, apex);
    for (uint32_t s = 1; s < 3; s++) {
      const uint32_t behind = w->t.next[t][(k + s) % 3], *back = w->t.next[behind];
      w->pending[pending++] = (uint64_t)behind << 2 | (back[0] == t ? 0u : back[1] == t ? 1u : 2u);
    }
  }
  store_chain(set, e, chain, w->keyed, w->keyed + set->count, found);
  return chain + found;
}

static btf_status store_facets(rim_work *w) {
  btf_dirset *set = w->set;
  btf_context *ctx = set->ctx;
  uint32_t proper = 0;
  for (uint32_t t = 0; t < w->t.count; t++)
    if (w->sliver[t] == BTFI_NO_TRIANGLE) w->number[t] = proper++;
  uint32_t n = proper;
  for (uint32_t t = 0; t < w->t.count; t++)
    if (w->sliver[t] != BTFI_NO_TRIANGLE) w->number[t] = n++;
  set->facet = btfi_alloc(ctx, n, sizeof *set->facet);
  if (!set->facet) return btfi_alloc_status();
  set->triangle = btfi_alloc(ctx, proper, 3 * sizeof *set->triangle);
  if (!set->triangle) return btfi_alloc_status();
  set->sliver_edge = btfi_alloc(ctx, n - proper, sizeof *set->sliver_edge);
  if (!set->sliver_edge) return btfi_alloc_status();
  set->triangle_count = proper;
  set->facet_count = n;
  for (uint32_t t = 0; t < n; t++) {
    const uint32_t at = w->number[t], *v = w->t.vertex[t];
    btfi_facet *f = &set->facet[at];
    for (uint32_t k = 0; k < 3; k++) {
      const uint32_t across = w->t.next[t][k];
      f->x[k] = (float)set->point[v[k]][0];
      f->y[k] = (float)set->point[v[k]][1];
      f->vertex[k] = v[k];
      f->next[k] = across == BTFI_NO_TRIANGLE ? 0 : w->number[across];
      if (at < proper) set->triangle[3 * (size_t)at + k] = v[k];
    }
    f->area2 = (double)btfi_area2(set->point[v[0]], set->point[v[1]], set->point[v[2]]);
    f->scale = 1.0 / f->area2;
    if (at >= proper) set->sliver_edge[at - proper] = w->sliver[t];
  }
  for (uint32_t i = 0; i < set->rim_count; i++) {
    const uint32_t at = w->number[w->rim_side[i] >> 2];
    set->rim[i].inside = at;
    set->facet[at].next[w->rim_side[i] & 3] = BTFI_OUTSIDE | i;
  }
  return BTF_OK;
}

static btf_status build_rim(rim_work *w) {
  btf_dirset *set = w->set;
  BTFI_TRY(walk_hull(w));
  /* Each vertex lies on the rim at most once as a start; chains repeat their ends. */
  set->rim_sample = btfi_alloc(set->ctx, (uint64_t)set->count + set->rim_count, sizeof *set->rim_sample);
  if (!set->rim_sample) return btfi_alloc_status();
  for (uint32_t t = 0; t < w->t.count; t++) w->sliver[t] = BTFI_NO_TRIANGLE;
  uint32_t chain = 0;
  for (uint32_t i = 0; i < set->rim_count; i++) chain = peel_edge(w, i, chain);
  return store_facets(w);
}

btf_status btfi_dirset_build_facets(btf_dirset *set) {
  btf_context *ctx = set->ctx;
  const uint32_t a = farthest(set, 0), b = farthest(set, a);
  if (on_a_line(set, a, b)) return build_line(set, a, b);
  rim_work w = {.set = set};
  BTFI_TRY(btfi_delaunay(ctx, (const int32_t(*)[2])set->point, set->count, BTFI_TIE_UNITS, &w.t));
  const uint64_t triangles = w.t.count, sides = 3 * triangles, vertices = set->count;
  w.rim_side = btfi_alloc(ctx, vertices, sizeof *w.rim_side);
  w.pending = w.rim_side ? btfi_alloc(ctx, sides, sizeof *w.pending) : NULL;
  w.hull_edge = w.pending ? btfi_alloc(ctx, vertices, sizeof *w.hull_edge) : NULL;
  w.sliver = w.hull_edge ? btfi_alloc(ctx, triangles, sizeof *w.sliver) : NULL;
  w.number = w.sliver ? btfi_alloc(ctx, triangles, sizeof *w.number) : NULL;
  w.on_rim = w.number ? btfi_calloc(ctx, vertices, 1) : NULL;
  w.keyed = w.on_rim ? btfi_alloc(ctx, 2 * vertices, sizeof *w.keyed) : NULL;
  const btf_status status = w.keyed ? build_rim(&w) : btfi_alloc_status();
  btfi_free(ctx, w.keyed);
  btfi_free(ctx, w.on_rim);
  btfi_free(ctx, w.number);
  btfi_free(ctx, w.sliver);
  btfi_free(ctx, w.hull_edge);
  btfi_free(ctx, w.pending);
  btfi_free(ctx, w.rim_side);
  btfi_triangulation_free(ctx, &w.t);
  return status;
}
