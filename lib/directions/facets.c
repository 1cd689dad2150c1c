/* SPDX-License-Identifier: MIT */
#include "directions/dirset.h"

#include <string.h>

/* ---- facets ---- */

static btfi_facet triangle_facet(const int32_t a[2], const int32_t b[2], const int32_t c[2],
                                 const uint32_t v[3]) {
  const double scale = 1.0 / (double)btfi_area2(a, b, c);
  return (btfi_facet){.x = (float)a[0],
                      .y = (float)a[1],
                      .bx = b[0] - a[0],
                      .by = b[1] - a[1],
                      .cx = c[0] - a[0],
                      .cy = c[1] - a[1],
                      .b_scale = scale,
                      .c_scale = scale,
                      .vertex = {v[0], v[1], v[2]}};
}

/* An edge of the hull. */
typedef struct rim_edge {
  const int32_t *start;
  int32_t dx, dy;
  double length2;
  uint32_t first, count; /* its samples in rim_work.sample */
} rim_edge;

/* A sample on it: (sample - start) . d, which sorts like its bits as it is not negative. */
static double along_edge(const rim_edge *e, const int32_t p[2]) {
  return (double)(p[0] - e->start[0]) * e->dx + (double)(p[1] - e->start[1]) * e->dy + 0.0; /* no -0 */
}

static btfi_keyed key_along(const rim_edge *e, const int32_t p[2], uint32_t vertex) {
  btfi_keyed k = {0, vertex};
  const double along = along_edge(e, p);
  memcpy(&k.key, &along, sizeof k.key);
  return k;
}

/* The half-strip outside a hull edge between two of its samples: b grows along the edge, c away from (ex,
 * ey). */
static btfi_facet strip_facet(const btf_dirset *set, const rim_edge *e, uint32_t from, uint32_t to,
                              int32_t ex, int32_t ey) {
  const int32_t *p = set->point[from];
  return (btfi_facet){.x = (float)p[0],
                      .y = (float)p[1],
                      .bx = -ex,
                      .by = -ey,
                      .cx = -e->dy,
                      .cy = e->dx,
                      .b_scale = 1.0 / (along_edge(e, set->point[to]) - along_edge(e, p)),
                      .vertex = {from, to, from}};
}

/* What lies beyond the end of one edge and before the start of the next: nearest to the vertex between them.
 */
static btfi_facet cone_facet(const btf_dirset *set, uint32_t vertex, int32_t before_x, int32_t before_y,
                             int32_t after_x, int32_t after_y) {
  return (btfi_facet){.x = (float)set->point[vertex][0],
                      .y = (float)set->point[vertex][1],
                      .bx = -after_y,
                      .by = after_x,
                      .cx = -before_y,
                      .cy = before_x,
                      .vertex = {vertex, vertex, vertex}};
}

static rim_edge edge_between(const btf_dirset *set, uint32_t from, uint32_t to) {
  rim_edge e = {.start = set->point[from]};
  e.dx = set->point[to][0] - e.start[0];
  e.dy = set->point[to][1] - e.start[1];
  e.length2 = (double)e.dx * e.dx + (double)e.dy * e.dy;
  return e;
}

/* ---- sets on a line ---- */

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

/* Strips that reach to both sides of the line, and a cone at either end; one sample is a cone that holds all.
 */
static btf_status build_line(btf_dirset *set, uint32_t a, uint32_t b) {
  btf_context *ctx = set->ctx;
  const uint32_t n = set->count, start = n - 1, end = n;
  set->facet = btfi_alloc(ctx, (uint64_t)n + 1, sizeof *set->facet);
  if (!set->facet) return btfi_alloc_status();
  btfi_keyed *order = btfi_alloc(ctx, 2 * (uint64_t)n, sizeof *order);
  if (!order) return btfi_alloc_status();
  const rim_edge e = edge_between(set, a, b);
  for (uint32_t i = 0; i < n; i++) order[i] = key_along(&e, set->point[i], i);
  btfi_sort_keyed(order, order + n, n);
  for (uint32_t i = 0; i + 1 < n; i++) {
    set->facet[i] = strip_facet(set, &e, order[i].item, order[i + 1].item, 0, 0);
    set->facet[i].next[0] = i + 2 < n ? i + 1 : end;
    set->facet[i].next[1] = i > 0 ? i - 1 : start;
  }
  set->facet[start] = cone_facet(set, a, -e.dx, -e.dy, 0, 0);
  set->facet[end] = cone_facet(set, b, e.dx, e.dy, 0, 0);
  set->facet[start].next[1] = 0;
  set->facet[end].next[1] = n > 1 ? n - 2 : start;
  set->facet_count = n + 1;
  btfi_free(ctx, order);
  return BTF_OK;
}

/* ---- sets with triangles ---- */

typedef struct rim_work {
  btf_dirset *set;
  btfi_triangulation t;
  uint32_t rim_count, sample_count, proper_count;
  rim_edge *rim;      /* counter-clockwise */
  uint64_t *rim_side; /* by edge of the rim: triangle << 2 | corner opposite */
  uint64_t *pending;  /* sides in the same form */
  uint32_t *starts;   /* by vertex: the hull edge, later the strip, that starts there */
  uint32_t *number;   /* by triangle: its facet, or NO_TRIANGLE for a sliver on the rim */
  uint8_t *on_rim;    /* by vertex */
  btfi_keyed *sample; /* samples of the edges, edge by edge, both ends included */
  btfi_keyed *scratch;
} rim_work;

/* Goes round the hull once, from its smallest vertex. */
static void walk_hull(rim_work *w) {
  uint32_t n = 0, v = UINT32_MAX;
  for (uint32_t t = 0; t < w->t.count; t++) {
    for (uint32_t k = 0; k < 3; k++) {
      if (w->t.next[t][k] != BTFI_NO_TRIANGLE) continue;
      const uint32_t from = w->t.vertex[t][(k + 1) % 3];
      w->pending[n] = (uint64_t)t << 2 | k;
      w->starts[from] = n++;
      v = BTFI_MIN(v, from);
    }
  }
  w->rim_count = n;
  for (uint32_t i = 0; i < n; i++) {
    w->rim_side[i] = w->pending[w->starts[v]];
    const uint32_t to = w->t.vertex[w->rim_side[i] >> 2][((w->rim_side[i] & 3) + 2) % 3];
    w->rim[i] = edge_between(w->set, v, to);
    w->on_rim[v] = 1;
    v = to;
  }
}

/* Takes the thin triangles off one hull edge, so that samples which rounding moved inward by a hair still
 * count as lying on it: without this, directions outside the hull would skip them. */
static void peel_edge(rim_work *w, uint32_t edge) {
  const btf_dirset *set = w->set;
  rim_edge *e = &w->rim[edge];
  const uint32_t side = (uint32_t)(w->rim_side[edge] & 3), *ends = w->t.vertex[w->rim_side[edge] >> 2];
  const double allowed = BTFI_RIM_UNITS * sqrt(e->length2);
  uint32_t pending = 0;
  e->first = w->sample_count;
  for (uint32_t k = 1; k < 3; k++) {
    const uint32_t v = ends[(side + k) % 3];
    w->sample[w->sample_count++] = key_along(e, set->point[v], v);
  }
  w->pending[pending++] = w->rim_side[edge];
  while (pending > 0) {
    const uint64_t open = w->pending[--pending];
    const uint32_t t = (uint32_t)(open >> 2), k = (uint32_t)(open & 3), *v = w->t.vertex[t];
    const int32_t *apex = set->point[v[k]];
    const double away = (double)e->dx * (apex[1] - e->start[1]) - (double)e->dy * (apex[0] - e->start[0]);
    const double along = along_edge(e, apex);
    if (w->on_rim[v[k]] || away > allowed || along <= along_edge(e, set->point[v[(k + 1) % 3]]) ||
        along >= along_edge(e, set->point[v[(k + 2) % 3]]))
      continue;
    w->number[t] = BTFI_NO_TRIANGLE;
    w->proper_count--;
    w->on_rim[v[k]] = 1;
    w->sample[w->sample_count++] = key_along(e, apex, v[k]);
    for (uint32_t s = 1; s < 3; s++) {
      const uint32_t behind = w->t.next[t][(k + s) % 3], *back = w->t.next[behind];
      w->pending[pending++] = (uint64_t)behind << 2 | (back[0] == t ? 0u : back[1] == t ? 1u : 2u);
    }
  }
  e->count = w->sample_count - e->first;
  btfi_sort_keyed(w->sample + e->first, w->scratch, e->count);
}

/* Strips follow the triangles, edge by edge; the cone at the start of edge i is number cones + i. */
static void store_outside(rim_work *w) {
  btf_dirset *set = w->set;
  const uint32_t cones = w->proper_count + w->sample_count - w->rim_count;
  uint32_t strip = w->proper_count;
  for (uint32_t i = 0; i < w->rim_count; i++) {
    const uint32_t after = i + 1 < w->rim_count ? i + 1 : 0, before = i > 0 ? i - 1 : w->rim_count - 1;
    const rim_edge *e = &w->rim[i], *b = &w->rim[before];
    const btfi_keyed *s = w->sample + e->first;
    btfi_facet *cone = &set->facet[cones + i];
    *cone = cone_facet(set, s[0].item, b->dx, b->dy, e->dx, e->dy);
    cone->next[2] = strip;
    for (uint32_t k = 0; k + 1 < e->count; k++, strip++) {
      const int32_t *p = set->point[s[k].item], *q = set->point[s[k + 1].item];
      btfi_facet *f = &set->facet[strip];
      *f = strip_facet(set, e, s[k].item, s[k + 1].item, q[0] - p[0], q[1] - p[1]);
      f->next[0] = k + 2 < e->count ? strip + 1 : cones + after;
      f->next[1] = k > 0 ? strip - 1 : cones + i;
      w->starts[s[k].item] = strip;
    }
  }
  for (uint32_t i = 0; i < w->rim_count; i++) {
    const uint32_t before = i > 0 ? i - 1 : w->rim_count - 1,
                   last = w->rim[before].first + w->rim[before].count - 2;
    set->facet[cones + i].next[1] = w->starts[w->sample[last].item];
  }
}

static void store_triangles(rim_work *w) {
  btf_dirset *set = w->set;
  for (uint32_t t = 0; t < w->t.count; t++) {
    const uint32_t at = w->number[t], *v = w->t.vertex[t];
    if (at == BTFI_NO_TRIANGLE) continue;
    btfi_facet *f = &set->facet[at];
    *f = triangle_facet(set->point[v[0]], set->point[v[1]], set->point[v[2]], v);
    memcpy(set->triangle + 3 * (size_t)at, v, 3 * sizeof *v);
    for (uint32_t k = 0; k < 3; k++) {
      const uint32_t across = w->t.next[t][k];
      f->next[k] = across == BTFI_NO_TRIANGLE ? BTFI_NO_TRIANGLE : w->number[across];
      if (f->next[k] != BTFI_NO_TRIANGLE) continue;
      f->next[k] = w->starts[v[(k + 1) % 3]];
      set->facet[f->next[k]].next[2] = at;
    }
  }
}

static btf_status build_outside(rim_work *w) {
  btf_dirset *set = w->set;
  walk_hull(w);
  for (uint32_t t = 0; t < w->t.count; t++) w->number[t] = 0;
  w->proper_count = w->t.count;
  for (uint32_t i = 0; i < w->rim_count; i++) peel_edge(w, i);
  uint32_t n = 0;
  for (uint32_t t = 0; t < w->t.count; t++)
    if (w->number[t] != BTFI_NO_TRIANGLE) w->number[t] = n++;
  /* An edge with k samples has k - 1 strips, and one cone. */
  set->facet = btfi_alloc(set->ctx, (uint64_t)n + w->sample_count, sizeof *set->facet);
  if (!set->facet) return btfi_alloc_status();
  set->triangle = btfi_alloc(set->ctx, n, 3 * sizeof *set->triangle);
  if (!set->triangle) return btfi_alloc_status();
  set->triangle_count = n;
  set->facet_count = n + w->sample_count;
  store_outside(w);
  store_triangles(w);
  return BTF_OK;
}

btf_status btfi_dirset_build_facets(btf_dirset *set) {
  btf_context *ctx = set->ctx;
  const uint32_t a = farthest(set, 0), b = farthest(set, a);
  if (on_a_line(set, a, b)) return build_line(set, a, b);
  rim_work w = {.set = set};
  BTFI_TRY(btfi_delaunay(ctx, (const int32_t(*)[2])set->point, set->count, BTFI_TIE_UNITS, &w.t));
  const uint64_t triangles = w.t.count, vertices = set->count;
  w.rim = btfi_alloc(ctx, vertices, sizeof *w.rim);
  w.rim_side = w.rim ? btfi_alloc(ctx, vertices, sizeof *w.rim_side) : NULL;
  w.pending = w.rim_side ? btfi_alloc(ctx, 3 * triangles, sizeof *w.pending) : NULL;
  w.starts = w.pending ? btfi_alloc(ctx, vertices, sizeof *w.starts) : NULL;
  w.number = w.starts ? btfi_alloc(ctx, triangles, sizeof *w.number) : NULL;
  w.on_rim = w.number ? btfi_calloc(ctx, vertices, 1) : NULL;
  /* Each sample of the rim starts one strip; the ends of edges count twice. */
  w.sample = w.on_rim ? btfi_alloc(ctx, 2 * vertices, sizeof *w.sample) : NULL;
  w.scratch = w.sample ? btfi_alloc(ctx, vertices + 1, sizeof *w.scratch) : NULL;
  const btf_status status = w.scratch ? build_outside(&w) : btfi_alloc_status();
  btfi_free(ctx, w.scratch);
  btfi_free(ctx, w.sample);
  btfi_free(ctx, w.on_rim);
  btfi_free(ctx, w.number);
  btfi_free(ctx, w.starts);
  btfi_free(ctx, w.pending);
  btfi_free(ctx, w.rim_side);
  btfi_free(ctx, w.rim);
  btfi_triangulation_free(ctx, &w.t);
  return status;
}
