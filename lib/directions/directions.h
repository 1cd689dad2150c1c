/* SPDX-License-Identifier: MIT */
/* directions.h: parts of a direction set that upper layers share. */
#ifndef BTFI_DIRECTIONS_H
#define BTFI_DIRECTIONS_H

#include "base/base.h"
#include <btf/btf_dataset.h>

btf_context *btfi_dirset_context(const btf_dirset *set);
bool btfi_dirset_equal(const btf_dirset *a,
                       const btf_dirset *b); /* same directions, bit for bit, in the same order */

/* ---- parabolic maps (parabolic.c) ---- */

/* The unit vector of the upper hemisphere at a point of the unit disc; a point outside is moved to its rim.
 */
void btfi_parabolic_direction(float px, float py, float dir[3]);
/* Direction at the centre of texel (x, y) of a size x size map over [-1, 1]^2, row 0 at y near -1. Texels
 * whose centre lies outside the disc get the nearest horizon direction, so that filtering never meets an
 * empty one. */
void btfi_parabolic_texel(uint32_t size, uint32_t x, uint32_t y, float dir[3]);
/* Interpolation weights at the centres of all texels of such a map, size * size entries. */
void btfi_dirset_rasterise(const btf_dirset *set, uint32_t size, btf_interp *out);

/* ---- the triangulation as numbers (facet_table.c) ---- */

/* Pieces of the plane: triangles, strips outside the hull's edges, cones outside its vertices. */
uint32_t btfi_dirset_facet_count(const btf_dirset *set);
enum { BTFI_FACET_FLOATS = 16 };
/* Sixteen floats for each, in four groups: the corner x, y and (cx, cy); (bx, by), s, t; three samples, 0;
 * where to go on when the weight of the first, second, third is negative, 0. With p = point - corner, the
 * distances B = p x (cx, cy) and C = (bx, by) x p, the point lies within if B >= 0, C >= 0 and s B + t C <= 1;
 * then the weights of the second and third sample are s B and t C. */
void btfi_dirset_facet_table(const btf_dirset *set, float *out);
/* Facets at the centres of the texels of a size x size map over [-1, 1]^2, row 0 at y near -1. */
void btfi_dirset_facet_map(const btf_dirset *set, uint32_t size, float *out);

#endif
