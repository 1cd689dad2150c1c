/* SPDX-License-Identifier: MIT */
/* dirset.h: the inside of a direction set. Only the files of this folder include it. */
#ifndef BTFI_DIRSET_H
#define BTFI_DIRSET_H

#include "directions/delaunay.h"
#include "directions/directions.h"

#include <math.h>

/* Parabolic coordinates are rounded to multiples of 2^-24. Differences then have 26 bits, and cross and dot
 * products of two differences are exact in a double: which triangle holds a point is decided without error,
 * with or without fused multiply-add. */
#define BTFI_UNITS 16777216.0

/* Points of the hull's rim that lie this close to a hull edge count as lying on it (2e-6: what directions
 * written with six digits are off). */
#define BTFI_RIM_UNITS 32.0
/* Four points this close to one circle are a tie (1e-6). */
#define BTFI_TIE_UNITS 16.0

/* A place in the triangulation: a triangle, or hull edge i as BTFI_OUTSIDE | i. */
#define BTFI_OUTSIDE 0x80000000u

/* One cache line. Corners in units; floats hold them exactly. */
typedef struct btfi_facet {
  float x[3], y[3];
  double area2, scale; /* twice the area, and its inverse */
  uint32_t vertex[3];
  uint32_t next[3]; /* place across the edge opposite to the corner */
} btfi_facet;

/* Edge from one hull vertex to the next, counter-clockwise. Its chain holds the samples that lie on it, both
 * ends included, by distance along it; outside the hull they interpolate linearly. */
typedef struct btfi_rim_edge {
  double x, y;   /* start, units */
  double dx, dy; /* to the end */
  double length2;
  uint32_t inside; /* facet beside it */
  uint32_t chain, chain_count;
} btfi_rim_edge;
typedef struct btfi_rim_sample {
  double along; /* (sample - start) . d */
  uint32_t vertex;
} btfi_rim_sample;

/* Cells over parabolic [-1, 1]^2: 64 x 64 at the root, each either a leaf or split 8 x 8. */
#define BTFI_RASTER_ROOT 64
#define BTFI_RASTER_SPLIT 8
#define BTFI_RASTER_DEPTH 4
#define BTFI_CELL_SPLIT 0x80000000u  /* ref: the rest is the number of the first child */
#define BTFI_CELL_SINGLE 0x40000000u /* ref: the rest is the only sample that can be the nearest */
typedef struct btfi_cell {
  uint32_t place; /* where the centre of a leaf lies */
  uint32_t ref;   /* or the start of its list in `nearby`: count, then samples by rising index */
} btfi_cell;

struct btf_dirset {
  btf_context *ctx;
  atomic_uint references;
  uint32_t count;
  float *direction;    /* given */
  double (*unit)[3];   /* of length 1 to double precision */
  int32_t (*point)[2]; /* parabolic, units */
  uint32_t *triangle;  /* vertices of the first triangle_count facets */
  btfi_facet *facet;
  uint32_t
      triangle_count; /* facets from here on are slivers on the rim: they interpolate along their hull edge */
  uint32_t facet_count;
  uint32_t *sliver_edge; /* hull edge of facet triangle_count + i */
  btfi_rim_edge *rim;    /* of a set on a line: one edge from end to end */
  btfi_rim_sample *rim_sample;
  uint32_t rim_count;
  btfi_cell *cell;
  uint32_t *nearby;
};

/* A direction in parabolic coordinates. x, y, z are what it is read as: not below the horizon. */
typedef struct btfi_parabolic {
  float px, py;
} btfi_parabolic;

/* The rare directions: not finite (false), zero or straight down (as +x), far from unit length. */
bool btfi_parabolic_unusual(float x, float y, float z, btfi_parabolic *out);

/* False when the direction is not finite. Exactly the same for samples and for queries. */
static inline bool btfi_parabolic_of(float x, float y, float z, btfi_parabolic *out) {
  const float up = z < 0.0f ? 0.0f : z;
  const float length2 = x * x + y * y + up * up;
  if (!(length2 > 1e-20f && length2 < 1e20f && z > -1e10f)) return btfi_parabolic_unusual(x, y, z, out);
  const float scale = 1.0f / (sqrtf(length2) + up);
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
  float x = (px + 1.0f) * (BTFI_RASTER_ROOT / 2), y = (py + 1.0f) * (BTFI_RASTER_ROOT / 2);
  int32_t column = (int32_t)x, row = (int32_t)y;
  column = BTFI_MIN(column, BTFI_RASTER_ROOT - 1);
  row = BTFI_MIN(row, BTFI_RASTER_ROOT - 1);
  const btfi_cell *cell = set->cell + (BTFI_MAX(row, 0) * BTFI_RASTER_ROOT + BTFI_MAX(column, 0));
  while (cell->ref & BTFI_CELL_SPLIT) {
    x = (x - (float)column) * BTFI_RASTER_SPLIT;
    y = (y - (float)row) * BTFI_RASTER_SPLIT;
    column = BTFI_MAX(BTFI_MIN((int32_t)x, BTFI_RASTER_SPLIT - 1), 0);
    row = BTFI_MAX(BTFI_MIN((int32_t)y, BTFI_RASTER_SPLIT - 1), 0);
    cell = set->cell + (cell->ref & ~BTFI_CELL_SPLIT) + (row * BTFI_RASTER_SPLIT + column);
  }
  return cell;
}

/* Builds facets, rim and raster from the points (facets.c, raster.c). What they allocated stays in the set,
 * which frees it also after a failure. */
btf_status btfi_dirset_build_facets(btf_dirset *set);
btf_status btfi_dirset_build_raster(btf_dirset *set);

/* Weights at a point in whole units, searched from a place; returns the place it was found at (locate.c). */
uint32_t btfi_dirset_locate_from(const btf_dirset *set, uint32_t place, double x, double y, btf_interp *out);

#endif
