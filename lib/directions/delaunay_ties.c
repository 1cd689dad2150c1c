/* SPDX-License-Identifier: MIT */
#include "directions/delaunay.h"

#include <math.h>

static double distance(const int32_t a[2], const int32_t b[2]) {
  const double x = b[0] - a[0], y = b[1] - a[1];
  return sqrt(x * x + y * y);
}

/* How far, in units, one of four points lies from the circle of the others. The determinant divided by the
 * product of a triple's sides is the distance of the fourth from its circle; the best conditioned triple
 * speaks. Symmetric in all four, so the answer is the same for both diagonals. */
static double distance_from_circle(const int32_t a[2], const int32_t b[2], const int32_t c[2],
                                   const int32_t d[2]) {
  const double ab = distance(a, b), bc = distance(b, c), ca = distance(c, a), ad = distance(a, d),
               bd = distance(b, d), cd = distance(c, d);
  const double best = fmax(fmax(ab * bc * ca, ab * bd * ad), fmax(bc * cd * bd, ca * ad * cd));
  return fabs((double)btfi_in_circle(a, b, c, d)) / best;
}

/* Whether a, b, c is counter-clockwise and thicker than what rounding can turn over. */
static bool is_thick(const int32_t a[2], const int32_t b[2], const int32_t c[2]) {
  const double longest = fmax(distance(a, b), fmax(distance(b, c), distance(c, a)));
  return (double)btfi_area2(a, b, c) > 64.0 * longest;
}

static inline uint32_t corner_toward(const btfi_triangulation *t, uint32_t triangle, uint32_t neighbour) {
  const uint32_t *n = t->next[triangle];
  return n[0] == neighbour ? 0 : n[1] == neighbour ? 1 : 2;
}

static void relink(btfi_triangulation *t, uint32_t triangle, uint32_t was, uint32_t is) {
  if (triangle != BTFI_NO_TRIANGLE) t->next[triangle][corner_toward(t, triangle, was)] = is;
}

static void set_triangle(btfi_triangulation *t, uint32_t i, const uint32_t v[3], const uint32_t n[3]) {
  const uint32_t turn = v[0] < v[1] ? (v[0] < v[2] ? 0 : 2) : (v[1] < v[2] ? 1 : 2);
  for (uint32_t k = 0; k < 3; k++) {
    t->vertex[i][k] = v[(k + turn) % 3];
    t->next[i][k] = n[(k + turn) % 3];
  }
}

/* Turns the edge of triangle i opposite to corner k if it is the wrong one of a tie. */
static bool turn_edge(const int32_t (*point)[2], double tie, btfi_triangulation *t, uint32_t i, uint32_t k) {
  const uint32_t j = t->next[i][k];
  if (j == BTFI_NO_TRIANGLE) return false;
  const uint32_t m = corner_toward(t, j, i);
  const uint32_t p = t->vertex[i][k], a = t->vertex[i][(k + 1) % 3], b = t->vertex[i][(k + 2) % 3],
                 q = t->vertex[j][m];
  if (BTFI_MIN(a, b) < BTFI_MIN(p, q)) return false;
  if (!is_thick(point[p], point[a], point[q]) || !is_thick(point[p], point[q], point[b])) return false;
  if (distance_from_circle(point[p], point[a], point[b], point[q]) > tie) return false;
  const uint32_t across_pa = t->next[i][(k + 2) % 3], across_bp = t->next[i][(k + 1) % 3],
                 across_aq = t->next[j][(m + 1) % 3], across_qb = t->next[j][(m + 2) % 3];
  set_triangle(t, i, (const uint32_t[3]){p, a, q}, (const uint32_t[3]){across_aq, j, across_pa});
  set_triangle(t, j, (const uint32_t[3]){p, q, b}, (const uint32_t[3]){across_qb, across_bp, i});
  relink(t, across_aq, j, i);
  relink(t, across_bp, i, j);
  return true;
}

btf_status btfi_delaunay_settle_ties(btf_context *ctx, const int32_t (*point)[2], double tie,
                                     btfi_triangulation *t) {
  if (t->count < 2) return BTF_OK;
  uint32_t *waiting = btfi_alloc(ctx, t->count, sizeof *waiting);
  if (!waiting) return btfi_alloc_status();
  uint8_t *is_waiting = btfi_alloc(ctx, t->count, 1);
  if (!is_waiting) {
    btfi_free(ctx, waiting);
    return btfi_alloc_status();
  }
  uint32_t n = t->count;
  for (uint32_t i = 0; i < n; i++) {
    waiting[i] = n - 1 - i;
    is_waiting[i] = 1;
  }
  /* Every turn lowers the smaller index of an edge, so this ends; large regular rings are cut off before
   * that. */
  uint64_t turns_left = 16 * (uint64_t)t->count;
  while (n > 0) {
    const uint32_t i = waiting[--n];
    is_waiting[i] = 0;
    for (uint32_t k = 0; k < 3; k++) {
      const uint32_t j = t->next[i][k];
      if (turns_left == 0 || !turn_edge(point, tie, t, i, k)) continue;
      turns_left--;
      const uint32_t touched[8] = {
          i, j, t->next[i][0], t->next[i][1], t->next[i][2], t->next[j][0], t->next[j][1], t->next[j][2]};
      for (uint32_t s = 0; s < 8; s++) {
        if (touched[s] == BTFI_NO_TRIANGLE || is_waiting[touched[s]]) continue;
        is_waiting[touched[s]] = 1;
        waiting[n++] = touched[s];
      }
      break;
    }
  }
  btfi_free(ctx, is_waiting);
  btfi_free(ctx, waiting);
  return BTF_OK;
}
