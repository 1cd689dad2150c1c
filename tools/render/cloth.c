/* SPDX-License-Identifier: MIT */
/*
 * A square cloth that falls over a ball on a floor: positions under gravity, with the lengths of threads and
 * diagonals kept by repeated projection (Jakobsen 2001, "Advanced character physics"). It is computed anew
 * each time, always alike.
 *
 * Folds turn by tens of degrees from one particle to the next. What is rendered is therefore not the net of
 * particles but the bicubic B-spline surface that it controls, whose normal and curvature are continuous, cut
 * into facets that turn by a degree or two.
 */
#include "mesh.h"

#include <stdlib.h>

#include "cli.h"

enum { SIDE = 121, STEPS = 420, PROJECTIONS = 24 };
enum { FACETS = 6, FINE_SIDE = (SIDE - 1) * FACETS + 1 }; /* facets between two particles */

static const float ball_radius = 0.55f;
static const float floor_height = -0.62f;
static const float half_side = 1.15f;

typedef struct cloth {
  vec3 now[SIDE * SIDE], before[SIDE * SIDE];
} cloth;

static void keep_distance(cloth *c, uint32_t a, uint32_t b, float rest) {
  const vec3 apart = vec3_sub(c->now[b], c->now[a]);
  const float length = vec3_length(apart);
  if (length <= 0.0f) return;
  const vec3 half_excess = vec3_scale(apart, 0.5f * (length - rest) / length);
  c->now[a] = vec3_add(c->now[a], half_excess);
  c->now[b] = vec3_sub(c->now[b], half_excess);
}

static void collide(cloth *c) {
  for (uint32_t i = 0; i < SIDE * SIDE; i++) {
    const float distance = vec3_length(c->now[i]);
    if (distance < ball_radius) {
      c->now[i] = vec3_scale(c->now[i], ball_radius / fmaxf(distance, 1e-6f));
      c->before[i] = vec3_along(c->before[i], 0.6f, vec3_sub(c->now[i], c->before[i])); /* friction */
    }
    if (c->now[i].z < floor_height) {
      c->now[i].z = floor_height;
      c->before[i] = c->now[i];
    }
  }
}

static void step(cloth *c) {
  const float gravity = 2.5e-4f, damping = 0.985f;
  for (uint32_t i = 0; i < SIDE * SIDE; i++) {
    const vec3 moved = vec3_scale(vec3_sub(c->now[i], c->before[i]), damping);
    c->before[i] = c->now[i];
    c->now[i] = vec3_add(c->now[i], moved);
    c->now[i].z -= gravity;
  }
  const float rest = 2.0f * half_side / (SIDE - 1), diagonal = rest * 1.41421356f;
  for (int pass = 0; pass < PROJECTIONS; pass++) {
    for (uint32_t y = 0; y < SIDE; y++)
      for (uint32_t x = 0; x < SIDE; x++) {
        const uint32_t i = y * SIDE + x;
        if (x + 1 < SIDE) keep_distance(c, i, i + 1, rest);
        if (y + 1 < SIDE) keep_distance(c, i, i + SIDE, rest);
        if (x + 1 < SIDE && y + 1 < SIDE) {
          keep_distance(c, i, i + SIDE + 1, diagonal);
          keep_distance(c, i + 1, i + SIDE, diagonal);
        }
        /* bending: threads resist folds tighter than four meshes */
        if (x + 4 < SIDE && pass % 4 == 0 && vec3_length(vec3_sub(c->now[i + 4], c->now[i])) < 3.2f * rest)
          keep_distance(c, i, i + 4, 3.2f * rest);
        if (y + 4 < SIDE && pass % 4 == 0 &&
            vec3_length(vec3_sub(c->now[i + 4 * SIDE], c->now[i])) < 3.2f * rest)
          keep_distance(c, i, i + 4 * SIDE, 3.2f * rest);
      }
    collide(c);
  }
}

/* A particle, also one beyond the border, where the cloth goes on straight. */
static vec3 particle(const cloth *c, int x, int y) {
  if (x < 0) return vec3_along(vec3_scale(particle(c, 0, y), 2.0f), -1.0f, particle(c, 1, y));
  if (x >= SIDE)
    return vec3_along(vec3_scale(particle(c, SIDE - 1, y), 2.0f), -1.0f, particle(c, SIDE - 2, y));
  if (y < 0) return vec3_along(vec3_scale(c->now[x], 2.0f), -1.0f, c->now[SIDE + x]);
  if (y >= SIDE)
    return vec3_along(vec3_scale(c->now[(SIDE - 1) * SIDE + x], 2.0f), -1.0f, c->now[(SIDE - 2) * SIDE + x]);
  return c->now[y * SIDE + x];
}

/* Uniform cubic B-spline: weights of four control points, and their derivatives. */
static void spline_weights(float t, float weight[4], float slope[4]) {
  const float s = 1.0f - t;
  weight[0] = s * s * s / 6.0f;
  weight[1] = (3.0f * t * t * t - 6.0f * t * t + 4.0f) / 6.0f;
  weight[2] = (3.0f * s * s * s - 6.0f * s * s + 4.0f) / 6.0f;
  weight[3] = t * t * t / 6.0f;
  slope[0] = -0.5f * s * s;
  slope[1] = 0.5f * t * (3.0f * t - 4.0f);
  slope[2] = -0.5f * s * (3.0f * s - 4.0f);
  slope[3] = 0.5f * t * t;
}

/* Point `index` of FINE_SIDE along one side: the first of its four control points, and the place after the
 * second. */
static int place_on_side(uint32_t index, float *t) {
  const uint32_t span = index / FACETS < SIDE - 2 ? index / FACETS : SIDE - 2;
  *t = (float)(index - span * FACETS) / FACETS;
  return (int)span - 1;
}

static void surface_point(const cloth *c, uint32_t x, uint32_t y, mesh_vertex *out) {
  float tx, ty, wx[4], wy[4], sx[4], sy[4];
  const int x0 = place_on_side(x, &tx), y0 = place_on_side(y, &ty);
  vec3 along_x = {0}, along_y = {0};
  spline_weights(tx, wx, sx);
  spline_weights(ty, wy, sy);
  out->position = vec3_make(0.0f, 0.0f, 0.0f);
  for (int j = 0; j < 4; j++)
    for (int i = 0; i < 4; i++) {
      const vec3 p = particle(c, x0 + i, y0 + j);
      out->position = vec3_along(out->position, wx[i] * wy[j], p);
      along_x = vec3_along(along_x, sx[i] * wy[j], p);
      along_y = vec3_along(along_y, wx[i] * sy[j], p);
    }
  out->normal = vec3_normalize(vec3_cross(along_x, along_y));
}

static void fall(cloth *c) {
  for (uint32_t y = 0; y < SIDE; y++)
    for (uint32_t x = 0; x < SIDE; x++) {
      const float u = (float)x / (SIDE - 1), v = (float)y / (SIDE - 1);
      /* turned a little and barely uneven, so that it does not fall symmetrically */
      const float px = (2.0f * u - 1.0f) * half_side, py = (2.0f * v - 1.0f) * half_side;
      c->now[y * SIDE + x] = vec3_make(0.94f * px - 0.342f * py, 0.342f * px + 0.94f * py,
                                       ball_radius + 0.02f + 0.004f * sinf(7.0f * u + 3.0f * v));
    }
  for (uint32_t i = 0; i < SIDE * SIDE; i++) c->before[i] = c->now[i];
  for (int i = 0; i < STEPS; i++) step(c);
}

int mesh_cloth(float repeat, mesh *out) {
  *out = (mesh){0};
  cloth *c = malloc(sizeof *c);
  if (c == NULL || !mesh_reserve(out, FINE_SIDE * FINE_SIDE, 2 * (FINE_SIDE - 1) * (FINE_SIDE - 1))) {
    free(c);
    return cli_out_of_memory();
  }
  fall(c);
  for (uint32_t y = 0; y < FINE_SIDE; y++)
    for (uint32_t x = 0; x < FINE_SIDE; x++) {
      mesh_vertex *vertex = &out->vertices[y * FINE_SIDE + x];
      surface_point(c, x, y, vertex);
      vertex->u = (float)x / (FINE_SIDE - 1) * repeat;
      vertex->v = (float)y / (FINE_SIDE - 1) * repeat;
    }
  free(c);
  uint32_t *index = out->triangles;
  for (uint32_t y = 0; y + 1 < FINE_SIDE; y++)
    for (uint32_t x = 0; x + 1 < FINE_SIDE; x++) {
      const uint32_t a = y * FINE_SIDE + x,
                     quad[6] = {a, a + 1, a + FINE_SIDE + 1, a, a + FINE_SIDE + 1, a + FINE_SIDE};
      for (int k = 0; k < 6; k++) *index++ = quad[k];
    }
  return EXIT_DONE;
}
