/* SPDX-License-Identifier: MIT */
#include "mesh.h"

#include <stdlib.h>

#include "cli.h"

bool mesh_reserve(mesh *m, uint32_t vertices, uint32_t triangles) {
  m->vertices = calloc(vertices, sizeof *m->vertices);
  m->triangles = calloc(triangles, 3 * sizeof *m->triangles);
  if (m->vertices == NULL || m->triangles == NULL) {
    mesh_free(m);
    return false;
  }
  m->vertex_count = vertices;
  m->triangle_count = triangles;
  return true;
}

void mesh_free(mesh *m) {
  free(m->vertices);
  free(m->triangles);
  *m = (mesh){0};
}

void mesh_smooth_normals(mesh *m) {
  for (uint32_t i = 0; i < m->vertex_count; i++) m->vertices[i].normal = vec3_make(0.0f, 0.0f, 0.0f);
  for (uint32_t t = 0; t < m->triangle_count; t++) {
    mesh_vertex *corner[3];
    for (int k = 0; k < 3; k++) corner[k] = &m->vertices[m->triangles[3 * t + k]];
    const vec3 area = vec3_cross(vec3_sub(corner[1]->position, corner[0]->position),
                                 vec3_sub(corner[2]->position, corner[0]->position));
    for (int k = 0; k < 3; k++) corner[k]->normal = vec3_add(corner[k]->normal, area);
  }
  for (uint32_t i = 0; i < m->vertex_count; i++)
    m->vertices[i].normal = vec3_normalize(m->vertices[i].normal);
}

void mesh_scale_v(mesh *m, float factor) {
  for (uint32_t i = 0; i < m->vertex_count; i++) m->vertices[i].v *= factor;
  m->sphere_repeat_v *= factor;
}

int mesh_plane(float repeat, mesh *out) {
  static const float corners[4][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  static const uint32_t triangles[6] = {0, 1, 2, 0, 2, 3};
  *out = (mesh){0};
  if (!mesh_reserve(out, 4, 2)) return cli_out_of_memory();
  for (int i = 0; i < 4; i++) {
    const float u = corners[i][0], v = corners[i][1];
    out->vertices[i] =
        (mesh_vertex){{2.0f * u - 1.0f, 2.0f * v - 1.0f, 0.0f}, {0, 0, 1}, u * repeat, v * repeat};
  }
  for (int i = 0; i < 6; i++) out->triangles[i] = triangles[i];
  return EXIT_DONE;
}

/* Rows of latitude and columns of longitude. The positions only have to be close: hits are moved onto the
 * sphere. */
int mesh_sphere(float repeat, mesh *out) {
  enum { ROWS = 192, COLUMNS = 384 };
  *out = (mesh){0};
  if (!mesh_reserve(out, (ROWS + 1) * (COLUMNS + 1), 2 * ROWS * COLUMNS)) return cli_out_of_memory();
  out->sphere_radius = 1.0f;
  out->sphere_repeat_u = out->sphere_repeat_v = repeat;
  for (uint32_t row = 0; row <= ROWS; row++)
    for (uint32_t column = 0; column <= COLUMNS; column++) {
      const double latitude = 3.14159265358979 * ((double)row / ROWS - 0.5);
      const double longitude = 2.0 * 3.14159265358979 * ((double)column / COLUMNS);
      const vec3 p = vec3_make((float)(cos(latitude) * cos(longitude)),
                               (float)(cos(latitude) * sin(longitude)), (float)sin(latitude));
      out->vertices[row * (COLUMNS + 1) + column] =
          (mesh_vertex){p, p, 2.0f * repeat * (float)column / COLUMNS, repeat * (float)row / ROWS};
    }
  uint32_t *index = out->triangles;
  for (uint32_t row = 0; row < ROWS; row++)
    for (uint32_t column = 0; column < COLUMNS; column++) {
      const uint32_t a = row * (COLUMNS + 1) + column, b = a + 1, c = b + COLUMNS + 1, d = a + COLUMNS + 1;
      const uint32_t quad[6] = {a, b, c, a, c, d};
      for (int k = 0; k < 6; k++) *index++ = quad[k];
    }
  return EXIT_DONE;
}
