/* SPDX-License-Identifier: MIT */
/* direction_recipes.h: sets to test with, and their geometry by brute force. The checks recompute parabolic
 * coordinates in double precision; the library rounds them to multiples of 2^-24 after a float division, so
 * the two differ by at most 2e-7. */
#ifndef DIRECTION_RECIPES_H
#define DIRECTION_RECIPES_H

#include "btf_test.h"

#include "directions/directions.h"

#define PARABOLIC_ERROR 2e-7

extern btfi_random dice;

typedef struct plane_set {
  uint32_t n, triangles, rim;
  double (*p)[2];
  const uint32_t *t;
  uint32_t (*edge)[2]; /* of the rim, inside on the left */
} plane_set;

void unit(float x, float y, float z, float d[3]);
void random_direction(float d[3]);
/* Parabolic coordinates of a direction, below the horizon as if on it. */
void parabolic(const float d[3], double p[2]);
btf_dirset *named(btf_context *ctx, const char *name);
/* A half hemisphere whose straight side is rounded at an odd angle: the rim is straight up to noise. */
btf_dirset *half_set(btf_context *ctx);
void at_angles(double theta, double phi, float d[3]);
/* Runs a check on every set: built in, random, rings, clusters, straight sides. */
void for_each_set(void (*check)(const btf_dirset *set, const char *name));
/* Twice the area of a, b, c. */
double cross(const double a[2], const double b[2], const double c[2]);
plane_set plane_of(const btf_dirset *set);
void plane_done(plane_set *s);
/* Distance to a segment and the point of it that is nearest. */
double nearest_on_segment(const double a[2], const double b[2], const double q[2], double out[2]);
/* The point of the hull nearest to q, by looking at every triangle and edge. */
void onto_hull(const plane_set *s, const double q[2], double out[2]);
/* The position that weights stand for. */
void interpolated(const plane_set *s, const btf_interp *w, double out[2]);
/* Weights of a partition of unity, indices in range. */
void assert_valid(const btf_interp *w, uint32_t n);

#endif
