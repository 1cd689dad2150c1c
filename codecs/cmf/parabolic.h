/* SPDX-License-Identifier: MIT */
/* parabolic.h: maps of the hemisphere and the half-difference frame (docs/codecs/cmf.md).
 *
 * A map is a grid of texels whose centres are directions of the upper hemisphere:
 * - parabolic, edge x edge: (a, b) = (x, y) / (1 + z), a and b from -1 to 1; texels beyond the unit circle
 * are no directions and hold extrapolated values;
 * - cube, edge x edge: the upper half of a cube, unfolded: the top within |a|, |b| <= 1/2 and the sides
 * around it, down to the horizon at |a| = 1 or |b| = 1; texels of the corners lie in the plane of the side
 * that is next to them, beyond its edge, so that lookups on a side stay on it;
 * - angular, azimuths x elevations: phi = 2 pi (column + 0.5) / width, theta = pi / 2 (row + 0.5) / height.
 * Texel (x, y) has index y * width + x. Lookups are bilinear between texel centres, clamped at borders;
 * azimuths wrap around. All functions are total. */
#ifndef BTFI_CMF_PARABOLIC_H
#define BTFI_CMF_PARABOLIC_H

#include <stdbool.h>
#include <stdint.h>

enum { CMF_PARABOLIC = 0, CMF_ANGULAR = 1, CMF_CUBE = 2, CMF_MAP_KINDS };

typedef struct btfi_cmf_map {
  uint32_t kind, width, height;
} btfi_cmf_map;

/* Four texels and their weights, which are >= 0 and sum to 1. */
typedef struct btfi_cmf_tap {
  uint32_t index[4]; /* (x0, y0), (x1, y0), (x0, y1), (x1, y1) */
  float weight[4];
} btfi_cmf_tap;

/* A parabolic or cube map of edge x edge texels, or an angular one of `edge` azimuths and half as many
 * elevations. */
btfi_cmf_map btfi_cmf_map_of(uint32_t kind, uint32_t edge);
static inline uint32_t btfi_cmf_map_texels(const btfi_cmf_map *map) {
  return map->width * map->height;
}
/* The unit vector of a texel's centre, and whether it is a part of the hemisphere of its own; beyond the
 * circle it is the direction on the horizon of the same azimuth, in corners of a cube map one of the next
 * side. */
bool btfi_cmf_map_direction(const btfi_cmf_map *map, uint32_t index, float direction[3]);
/* Solid angle of a texel, 0 beyond the circle and in corners. */
double btfi_cmf_map_solid_angle(const btfi_cmf_map *map, uint32_t index);
/* Whether any direction's lookup reads a texel. */
bool btfi_cmf_map_reads(const btfi_cmf_map *map, uint32_t index);
/* Where a direction is looked up. One below the horizon is treated as lying on it. */
void btfi_cmf_map_locate(const btfi_cmf_map *map, const float direction[3], btfi_cmf_tap *tap);
/* source[i]: the texel to copy into texel i: itself where known[i], otherwise the nearest known texel (by
 * distance in the map, wrapping in azimuth). false if none is known. */
bool btfi_cmf_map_sources(const btfi_cmf_map *map, const unsigned char *known, uint32_t *source);

/* Parabolic coordinates of a direction, within the unit circle; and back. */
void btfi_cmf_parabolic(const float direction[3], float ab[2]);
void btfi_cmf_from_parabolic(const float ab[2], float direction[3]);
/* The same of a cube map. */
void btfi_cmf_cube(const float direction[3], float ab[2]);
void btfi_cmf_from_cube(const float ab[2], float direction[3]);
/* Which side of the cube a direction near a diagonal is on is decided by this much in favour of x, so that
 * rounding does not. */
#define CMF_CUBE_BIAS 1.000001f

/* Half vector of two unit vectors; N for opposite ones. */
void btfi_cmf_half(const float light[3], const float view[3], float half[3]);
/* Gram-Schmidt half-angle difference: z' = h, x' = T - <T, h> h normalised, y' = z' x x'; d is the light in
 * that frame. The view is (-d.x, -d.y, d.z) in it. */
void btfi_cmf_frame(const float half[3], float x[3], float y[3]);
void btfi_cmf_to_hd(const float light[3], const float view[3], float half[3], float difference[3]);
/* Light and view of a half vector and a difference vector; false if either is on or below the horizon. */
bool btfi_cmf_from_hd(const float half[3], const float difference[3], float light[3], float view[3]);

#endif
