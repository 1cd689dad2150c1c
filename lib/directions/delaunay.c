/* SPDX-License-Identifier: MIT */
/* Divide and conquer after Guibas and Stolfi (1985): O(n log n) for every input, rings and lines included. */
#include "directions/delaunay.h"

#include <string.h>

/* A directed edge; its reverse is the number with the lowest bit flipped. */
typedef struct half_edge {
  uint32_t origin;
  uint32_t ccw, cw; /* next edge around the origin, either way */
} half_edge;

typedef struct mesh {
  const int32_t (*point)[2];
  const btfi_keyed *order; /* points from left to right, then from bottom to top */
  half_edge *edge;
  uint32_t used, spare; /* spare: head of the list of deleted edges, linked through ccw */
} mesh;

#define NO_EDGE UINT32_MAX

static inline uint32_t origin(const mesh *m, uint32_t e) {
  return m->edge[e].origin;
}
static inline uint32_t target(const mesh *m, uint32_t e) {
  return m->edge[e ^ 1u].origin;
}
/* The edge that follows e around the face on its left. */
static inline uint32_t along_left(const mesh *m, uint32_t e) {
  return m->edge[e ^ 1u].cw;
}
static inline uint32_t back_right(const mesh *m, uint32_t e) {
  return m->edge[e ^ 1u].ccw;
}

static uint32_t add_edge(mesh *m, uint32_t from, uint32_t to) {
  uint32_t e = m->spare;
  if (e != NO_EDGE) {
    m->spare = m->edge[e].ccw;
  } else {
    e = m->used;
    m->used += 2;
  }
  m->edge[e] = (half_edge){from, e, e};
  m->edge[e + 1] = (half_edge){to, e + 1, e + 1};
  return e;
}

/* Joins the rings of edges around two origins, or parts them when they are one ring. */
static void splice(mesh *m, uint32_t a, uint32_t b) {
  const uint32_t after_a = m->edge[a].ccw, after_b = m->edge[b].ccw;
  m->edge[a].ccw = after_b;
  m->edge[b].ccw = after_a;
  m->edge[after_b].cw = a;
  m->edge[after_a].cw = b;
}

static uint32_t connect(mesh *m, uint32_t a, uint32_t b) {
  const uint32_t e = add_edge(m, target(m, a), origin(m, b));
  splice(m, e, along_left(m, a));
  splice(m, e ^ 1u, b);
  return e;
}

static void remove_edge(mesh *m, uint32_t e) {
  splice(m, e, m->edge[e].cw);
  splice(m, e ^ 1u, m->edge[e ^ 1u].cw);
  e &= ~1u;
  m->edge[e].origin = m->edge[e + 1].origin = NO_EDGE;
  m->edge[e].ccw = m->spare;
  m->spare = e;
}

static inline int64_t area_of(const mesh *m, uint32_t a, uint32_t b, uint32_t c) {
  return btfi_area2(m->point[a], m->point[b], m->point[c]);
}
static inline bool left_of(const mesh *m, uint32_t p, uint32_t e) {
  return area_of(m, p, origin(m, e), target(m, e)) > 0;
}
static inline bool right_of(const mesh *m, uint32_t p, uint32_t e) {
  return area_of(m, p, target(m, e), origin(m, e)) > 0;
}
static inline bool in_circle(const mesh *m, uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
  return btfi_in_circle(m->point[a], m->point[b], m->point[c], m->point[d]) > 0;
}

/* The hull edge that leaves the leftmost point counter-clockwise and the one that leaves the rightmost
 * clockwise. */
typedef struct hull_ends {
  uint32_t left, right;
} hull_ends;

static hull_ends two_or_three(mesh *m, uint32_t first, uint32_t n) {
  const uint32_t p = m->order[first].item, q = m->order[first + 1].item;
  const uint32_t a = add_edge(m, p, q);
  if (n == 2) return (hull_ends){a, a ^ 1u};
  const uint32_t r = m->order[first + 2].item, b = add_edge(m, q, r);
  splice(m, a ^ 1u, b);
  const int64_t turn = area_of(m, p, q, r);
  if (turn == 0) return (hull_ends){a, b ^ 1u};
  const uint32_t c = connect(m, b, a);
  if (turn > 0) return (hull_ends){a, b ^ 1u};
  return (hull_ends){c ^ 1u, c};
}

/* Sews the two halves together from the common tangent below, upward. */
static void sew(mesh *m, uint32_t base) {
  for (;;) {
    uint32_t l = m->edge[base ^ 1u].ccw;
    const bool l_valid = right_of(m, target(m, l), base);
    if (l_valid) {
      while (in_circle(m, target(m, base), origin(m, base), target(m, l), target(m, m->edge[l].ccw))) {
        const uint32_t next = m->edge[l].ccw;
        remove_edge(m, l);
        l = next;
      }
    }
    uint32_t r = m->edge[base].cw;
    const bool r_valid = right_of(m, target(m, r), base);
    if (r_valid) {
      while (in_circle(m, target(m, base), origin(m, base), target(m, r), target(m, m->edge[r].cw))) {
        const uint32_t next = m->edge[r].cw;
        remove_edge(m, r);
        r = next;
      }
    }
    if (!l_valid && !r_valid) return;
    if (!l_valid || (r_valid && in_circle(m, target(m, l), origin(m, l), origin(m, r), target(m, r))))
      base = connect(m, r, base ^ 1u);
    else
      base = connect(m, base ^ 1u, l ^ 1u);
  }
}

/* Depth of the recursion is the logarithm of n. */
static hull_ends triangulate(mesh *m, uint32_t first, uint32_t n) {
  if (n <= 3) return two_or_three(m, first, n);
  hull_ends a = triangulate(m, first, n / 2), b = triangulate(m, first + n / 2, n - n / 2);
  uint32_t l = a.right, r = b.left;
  for (;;) {
    if (left_of(m, origin(m, r), l))
      l = along_left(m, l);
    else if (right_of(m, origin(m, l), r))
      r = back_right(m, r);
    else
      break;
  }
  const uint32_t base = connect(m, r ^ 1u, l);
  if (origin(m, l) == origin(m, a.left)) a.left = base ^ 1u;
  if (origin(m, r) == origin(m, b.right)) b.right = base;
  sew(m, base);
  return (hull_ends){a.left, b.right};
}

/* Reads the triangles off the edges. `face` has an entry for each directed edge. */
static void collect(const mesh *m, uint32_t *face, btfi_triangulation *t) {
  for (uint32_t e = 0; e < m->used; e++) face[e] = BTFI_NO_TRIANGLE;
  for (uint32_t e = 0; e < m->used; e++) {
    if (face[e] != BTFI_NO_TRIANGLE || origin(m, e) == NO_EDGE) continue;
    const uint32_t f = along_left(m, e), g = along_left(m, f);
    if (along_left(m, g) != e || area_of(m, origin(m, e), origin(m, f), origin(m, g)) <= 0) continue;
    face[e] = face[f] = face[g] = t->count;
    t->vertex[t->count][0] = e; /* edges for now: their faces across are not all known yet */
    t->vertex[t->count][1] = f;
    t->vertex[t->count][2] = g;
    t->count++;
  }
  for (uint32_t i = 0; i < t->count; i++) {
    uint32_t *v = t->vertex[i];
    const uint32_t edges[3] = {v[0], v[1], v[2]};
    uint32_t turn = 0;
    for (uint32_t k = 1; k < 3; k++)
      if (origin(m, edges[k]) < origin(m, edges[turn])) turn = k;
    for (uint32_t k = 0; k < 3; k++) {
      v[k] = origin(m, edges[(k + turn) % 3]);
      t->next[i][k] = face[edges[(k + turn + 1) % 3] ^ 1u];
    }
  }
}

btf_status btfi_delaunay(btf_context *ctx, const int32_t (*point)[2], uint32_t count, double tie,
                         btfi_triangulation *out) {
  memset(out, 0, sizeof *out);
  /* A planar graph of n points has fewer than 3 n edges and 2 n triangles. */
  const uint64_t edges = 6 * (uint64_t)count + 4, triangles = 2 * (uint64_t)count + 1;
  btfi_keyed *order = btfi_alloc(ctx, 2 * (uint64_t)count, sizeof *order);
  half_edge *edge = order ? btfi_alloc(ctx, edges, sizeof *edge) : NULL;
  uint32_t *face = edge ? btfi_alloc(ctx, edges, sizeof *face) : NULL;
  out->vertex = face ? btfi_alloc(ctx, triangles, sizeof *out->vertex) : NULL;
  out->next = out->vertex ? btfi_alloc(ctx, triangles, sizeof *out->next) : NULL;
  btf_status status = BTF_OK;
  if (!out->next) {
    status = btfi_alloc_status();
  } else if (count >= 3) {
    for (uint32_t i = 0; i < count; i++) {
      const uint64_t x = (uint64_t)(point[i][0] + BTFI_DELAUNAY_RANGE),
                     y = (uint64_t)(point[i][1] + BTFI_DELAUNAY_RANGE);
      order[i] = (btfi_keyed){x << 32 | y, i};
    }
    btfi_sort_keyed(order, order + count, count);
    mesh m = {point, order, edge, 0, NO_EDGE};
    triangulate(&m, 0, count);
    collect(&m, face, out);
    status = btfi_delaunay_settle_ties(ctx, point, tie, out);
  }
  btfi_free(ctx, face);
  btfi_free(ctx, edge);
  btfi_free(ctx, order);
  if (status != BTF_OK) btfi_triangulation_free(ctx, out);
  return status;
}

void btfi_triangulation_free(btf_context *ctx, btfi_triangulation *t) {
  btfi_free(ctx, t->vertex);
  btfi_free(ctx, t->next);
  memset(t, 0, sizeof *t);
}

void btfi_sort_keyed(btfi_keyed *list, btfi_keyed *scratch, uint32_t n) {
  btfi_keyed *from = list, *to = scratch;
  for (uint64_t width = 1; width < n; width *= 2) {
    for (uint64_t start = 0; start < n; start += 2 * width) {
      uint64_t a = start, b = BTFI_MIN(start + width, n), out = start;
      const uint64_t a_end = b, b_end = BTFI_MIN(start + 2 * width, n);
      while (a < a_end || b < b_end)
        to[out++] = b == b_end || (a < a_end && from[a].key <= from[b].key) ? from[a++] : from[b++];
    }
    btfi_keyed *swap = from;
    from = to;
    to = swap;
  }
  if (from != list) memcpy(list, from, n * sizeof *list);
}
