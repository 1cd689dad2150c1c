/* SPDX-License-Identifier: MIT */
/* delaunay.h: Delaunay triangulation of points with integer coordinates, exact in all its decisions. */
#ifndef BTFI_DELAUNAY_H
#define BTFI_DELAUNAY_H

#include "base/base.h"

#define BTFI_NO_TRIANGLE UINT32_MAX

/* Largest magnitude of a coordinate: products of two differences then fit a double without rounding. */
#define BTFI_DELAUNAY_RANGE ((1 << 24) + 64)

/* Triangles in counter-clockwise order; next[t][k] is the neighbour across the edge opposite to vertex[t][k],
 * or BTFI_NO_TRIANGLE on the hull. Empty when all points lie on a line. */
typedef struct btfi_triangulation {
  uint32_t count;
  uint32_t (*vertex)[3];
  uint32_t (*next)[3];
} btfi_triangulation;

/* The points must be distinct. Where four points lie on a circle within `tie` units, the diagonal that holds
 * the smallest index wins, so that the noise of rounded rings does not choose. The result is the same on
 * every machine. */
btf_status btfi_delaunay(btf_context *ctx, const int32_t (*point)[2], uint32_t count, double tie,
                         btfi_triangulation *out);
void btfi_triangulation_free(btf_context *ctx, btfi_triangulation *t);

/* Settles the ties; called by btfi_delaunay. */
btf_status btfi_delaunay_settle_ties(btf_context *ctx, const int32_t (*point)[2], double tie,
                                     btfi_triangulation *t);

/* Twice the signed area of a, b, c; positive when counter-clockwise. */
static inline int64_t btfi_area2(const int32_t a[2], const int32_t b[2], const int32_t c[2]) {
  return (int64_t)(b[0] - a[0]) * (c[1] - a[1]) - (int64_t)(b[1] - a[1]) * (c[0] - a[0]);
}

__extension__ typedef __int128 btfi_wide;

/* Positive when d lies inside the circle through the counter-clockwise a, b, c. Below 2^106. */
static inline btfi_wide btfi_in_circle(const int32_t a[2], const int32_t b[2], const int32_t c[2],
                                       const int32_t d[2]) {
  const int64_t ax = a[0] - d[0], ay = a[1] - d[1], bx = b[0] - d[0], by = b[1] - d[1], cx = c[0] - d[0],
                cy = c[1] - d[1];
  return (btfi_wide)(ax * ax + ay * ay) * (bx * cy - cx * by) -
         (btfi_wide)(bx * bx + by * by) * (ax * cy - cx * ay) +
         (btfi_wide)(cx * cx + cy * cy) * (ax * by - bx * ay);
}

/* An item with its sorting key. */
typedef struct btfi_keyed {
  uint64_t key;
  uint32_t item;
} btfi_keyed;
/* Sorts by key, stable; `scratch` has room for n. */
void btfi_sort_keyed(btfi_keyed *list, btfi_keyed *scratch, uint32_t n);

#endif
