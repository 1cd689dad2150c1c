/* SPDX-License-Identifier: MIT */
/* dirset.h: the inside of a direction set. Only the files of this folder include it. */
#ifndef BTFI_DIRSET_H
#define BTFI_DIRSET_H

#include "directions/delaunay.h"
#include "directions/directions.h"

#include <math.h>

/* Directions of a set are equal or at least this far apart, in radians. */
#define BTFI_SMALLEST_ANGLE 1e-4

/* Parabolic coordinates are rounded to multiples of 2^-24. Differences then have 26 bits, and cross and dot
 * products of two differences are exact in a double: which triangle holds a point is decided without error,
 * with or without fused multiply-add. */
#define BTFI_UNITS 16777216.0

/* Points of the hull's rim that lie this close to a hull edge count as lying on it (2e-6: what directions
 * written with six digits are off). */
#define BTFI_RIM_UNITS 32.0
/* Four points this close to one circle are a tie (1e-6). */
#define BTFI_TIE_UNITS 16.0

/* A piece of the plane: a triangle, a half-strip outside an edge of the hull, or the cone outside one of its
 * vertices. Together they cover it. With p the point relative to the corner, b = p x (cx, cy) and c = (bx,
 * by) x p are exact; the point lies within if b >= 0, c >= 0 and b b_scale + c c_scale <= 1, and then these
 * are the weights of vertex[1] and vertex[2]. A scale of 0 makes a form a mere bound: strips interpolate
 * along their edge, where the nearest point of the hull lies, and cones hold one vertex. One cache line. */
typedef struct btfi_facet {
  float x, y; /* corner, units */
  int32_t bx, by, cx, cy;
  double b_scale, c_scale;
  uint32_t vertex[3];
  uint32_t next[3]; /* facet to go on in when the weight of that vertex is negative */
} btfi_facet;

/* Cells over parabolic [-1, 1]^2: 64 x 64 at the root, each either a leaf or split 8 x 8. A unit has a little
 * less than 32 of them, so that a coordinate of 1 plus rounding has one too. */
#define BTFI_RASTER_ROOT 64
#define BTFI_RASTER_SCALE 31.999f
#define BTFI_RASTER_SPLIT 8
#define BTFI_RASTER_DEPTH 4
#define BTFI_CELL_SPLIT 0x80000000u  /* ref: the rest is the number of the first child */
#define BTFI_CELL_SINGLE 0x40000000u /* ref: the rest is the only sample that can be the nearest */
typedef struct btfi_cell {
  uint32_t facet; /* where the centre of a leaf lies */
  uint32_t ref;   /* or the start of its list in `nearby`: count, then samples by rising index */
} btfi_cell;

struct btf_dirset {
  btf_context *ctx;
  atomic_uint references;
  uint32_t count;
  float *direction;    /* given */
  double (*unit)[3];   /* of length 1 to double precision */
  int32_t (*point)[2]; /* parabolic, units */
  btfi_facet *facet;   /* triangles first */
  uint32_t facet_count, triangle_count;
  uint32_t *triangle; /* vertices of the triangles */
  btfi_cell *cell;
  uint32_t cell_count;
  uint32_t *nearby;
};

/* A direction in parabolic coordinates. */
typedef struct btfi_parabolic {
  float px, py;
} btfi_parabolic;

/* The rare directions: not finite (false), zero or straight down (as +x), far from unit length. */
bool btfi_parabolic_unusual(float x, float y, float z, btfi_parabolic *out);

/* Finite, not zero, and of a length whose square is a float. */
static inline int btfi_parabolic_is_usual(float x, float y, float z) {
  const float up = z < 0.0f ? 0.0f : z, length2 = x * x + y * y + up * up;
  return (length2 > 1e-20f) & (length2 < 1e20f) & (z > -1e10f);
}

/* False when the direction is not finite. Exactly the same for samples and for queries. */
static inline bool btfi_parabolic_of(float x, float y, float z, btfi_parabolic *out) {
  if (__builtin_expect(!btfi_parabolic_is_usual(x, y, z), 0)) return btfi_parabolic_unusual(x, y, z, out);
  const float up = z < 0.0f ? 0.0f : z, scale = 1.0f / (sqrtf(x * x + y * y + up * up) + up);
  out->px = x * scale;
  out->py = y * scale;
  return true;
}

/* Rounds a parabolic coordinate to whole units: adding 1.5 * 2^52 leaves no room for a fraction. */
static inline double btfi_to_units(float p) {
  const double shift = 0x1.8p52;
  return ((double)p * BTFI_UNITS + shift) - shift;
}

/* The leaf of the raster that holds a parabolic point. */
static inline const btfi_cell *btfi_raster_leaf(const btf_dirset *set, float px, float py) {
  float x = (px + 1.0f) * BTFI_RASTER_SCALE, y = (py + 1.0f) * BTFI_RASTER_SCALE;
  int32_t column = (int32_t)x, row = (int32_t)y;
  const btfi_cell *cell = set->cell + (row * BTFI_RASTER_ROOT + column);
  while (cell->ref & BTFI_CELL_SPLIT) {
    x = (x - (float)column) * BTFI_RASTER_SPLIT;
    y = (y - (float)row) * BTFI_RASTER_SPLIT;
    column = (int32_t)x;
    row = (int32_t)y;
    cell = set->cell + (cell->ref & ~BTFI_CELL_SPLIT) + (row * BTFI_RASTER_SPLIT + column);
  }
  return cell;
}

/* Build facets and raster from the points (facets.c, raster.c). What they allocated stays in the set, which
 * frees it also after a failure. */
btf_status btfi_dirset_build_facets(btf_dirset *set);
btf_status btfi_dirset_build_raster(btf_dirset *set);

/* For sets with repeats (repeats.c). The first sample of each direction, by rising index; `distinct` has room
 * for all. Then facets and raster of these alone. */
btf_status btfi_dirset_find_distinct(const btf_dirset *set, uint32_t *distinct, uint32_t *count);
btf_status btfi_dirset_build_distinct(btf_dirset *set, const uint32_t *distinct, uint32_t count);

/* Weights at a point in whole units, searched from a facet on; returns the facet that holds it (locate.c). */
uint32_t btfi_dirset_locate_from(const btf_dirset *set, uint32_t facet, double x, double y, btf_interp *out);

#endif
