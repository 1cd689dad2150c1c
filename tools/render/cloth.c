/* SPDX-License-Identifier: MIT */
/*
 * A square cloth that falls over a ball on a floor: positions under gravity, with the lengths of threads and
 * diagonals kept by repeated projection (Jakobsen 2001, "Advanced character physics"). It is computed anew
 * each time, always alike.
 */
#include "mesh.h"

#include <stdlib.h>

#include "cli.h"

enum { SIDE = 121, STEPS = 420, PROJECTIONS = 24 };

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

int mesh_cloth(float repeat, mesh *out) {
  *out = (mesh){0};
  cloth *c = malloc(sizeof *c);
  if (c == NULL || !mesh_reserve(out, SIDE * SIDE, 2 * (SIDE - 1) * (SIDE - 1))) {
    free(c);
    return cli_out_of_memory();
  }
  for (uint32_t y = 0; y < SIDE; y++)
    for (uint32_t x = 0; x < SIDE; x++) {
      const float u = (float)x / (SIDE - 1), v = (float)y / (SIDE - 1);
      /* turned a little and barely uneven, so that it does not fall symmetrically */
      const float px = (2.0f * u - 1.0f) * half_side, py = (2.0f * v - 1.0f) * half_side;
      c->now[y * SIDE + x] = vec3_make(0.94f * px - 0.342f * py, 0.342f * px + 0.94f * py,
                                       ball_radius + 0.02f + 0.004f * sinf(7.0f * u + 3.0f * v));
      out->vertices[y * SIDE + x].u = u * repeat;
      out->vertices[y * SIDE + x].v = v * repeat;
    }
  for (uint32_t i = 0; i < SIDE * SIDE; i++) c->before[i] = c->now[i];
  for (int i = 0; i < STEPS; i++) step(c);
  for (uint32_t i = 0; i < SIDE * SIDE; i++) out->vertices[i].position = c->now[i];
  free(c);
  uint32_t *index = out->triangles;
  for (uint32_t y = 0; y + 1 < SIDE; y++)
    for (uint32_t x = 0; x + 1 < SIDE; x++) {
      const uint32_t a = y * SIDE + x, quad[6] = {a, a + 1, a + SIDE + 1, a, a + SIDE + 1, a + SIDE};
      for (int k = 0; k < 6; k++) *index++ = quad[k];
    }
  mesh_smooth_normals(out);
  return EXIT_DONE;
}
