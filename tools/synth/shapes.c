/* SPDX-License-Identifier: MIT */
#include <stdlib.h>
#include <string.h>

#include "mesostructure.h"

#define MOST_ELEMENTS (1u << 26)

/* Room for `more` elements of `size` bytes behind `count`; the array moves. */
static bool make_room(mesostructure *m, void **array, uint32_t count, uint32_t *room, uint32_t more,
                      size_t size) {
  if (m->failed || more > MOST_ELEMENTS || count > MOST_ELEMENTS - more) {
    m->failed = true;
    return false;
  }
  if (count + more > *room) {
    const uint32_t wanted = count + more > 2 * *room ? count + more : 2 * *room;
    void *moved = realloc(*array, (size_t)wanted * size);
    if (moved == NULL) {
      m->failed = true;
      return false;
    }
    *array = moved;
    *room = wanted;
  }
  return true;
}

static bool room_for_mesh(mesostructure *m, meso_part *part, uint32_t vertices, uint32_t triangles) {
  void *v = part->vertices, *t = part->triangles;
  uint32_t index_room = part->triangle_room;
  const bool fits =
      make_room(m, &v, part->vertex_count, &part->vertex_room, vertices, sizeof *part->vertices);
  part->vertices = v;
  if (!fits) return false;
  const bool both =
      make_room(m, &t, part->triangle_count, &index_room, triangles, 3 * sizeof *part->triangles);
  part->triangles = t;
  part->triangle_room = index_room;
  return both;
}

static void add_triangle(meso_part *part, uint32_t a, uint32_t b, uint32_t c) {
  uint32_t *corner = part->triangles + 3 * (size_t)part->triangle_count++;
  corner[0] = a;
  corner[1] = b;
  corner[2] = c;
}

void meso_add_height_field(mesostructure *m, uint32_t part_index, uint32_t cells, meso_height_fn height,
                           const void *user) {
  meso_part *part = &m->parts[part_index];
  const uint32_t side = cells + 1, first = part->vertex_count;
  float *heights;
  if (!room_for_mesh(m, part, side * side, 2 * cells * cells)) return;
  heights = malloc((size_t)cells * cells * sizeof *heights);
  if (heights == NULL) {
    m->failed = true;
    return;
  }
  const float step = 1.0f / (float)cells;
  for (uint32_t y = 0; y < cells; ++y) {
    if (synth_watch_stops(m->watch)) {
      free(heights);
      return;
    }
    for (uint32_t x = 0; x < cells; ++x)
      heights[y * cells + x] = height((float)x * step, (float)y * step, user);
  }
#define HEIGHT(x, y) heights[((y) % cells) * cells + (x) % cells]
  for (uint32_t y = 0; y < side; ++y)
    for (uint32_t x = 0; x < side; ++x) {
      meso_vertex *vertex = &part->vertices[part->vertex_count++];
      const float dx = (HEIGHT(x + 1, y) - HEIGHT(x + cells - 1, y)) * 0.5f * (float)cells;
      const float dy = (HEIGHT(x, y + 1) - HEIGHT(x, y + cells - 1)) * 0.5f * (float)cells;
      memset(vertex, 0, sizeof *vertex);
      vec3_store(vertex->p, vec3_make((float)x * step, (float)y * step, HEIGHT(x, y)));
      vec3_store(vertex->n, vec3_normalize(vec3_make(-dx, -dy, 1.0f)));
      vec3_store(vertex->tangent, vec3_normalize(vec3_make(1.0f, 0.0f, dx)));
      vertex->s = (float)x * step;
      vertex->t = (float)y * step;
    }
#undef HEIGHT
  free(heights);
  for (uint32_t y = 0; y < cells; ++y)
    for (uint32_t x = 0; x < cells; ++x) {
      const uint32_t a = first + y * side + x, b = a + 1, c = a + side, d = c + 1;
      /* The flatter diagonal follows ridges. */
      if (fabsf(part->vertices[a].p[2] - part->vertices[d].p[2]) <=
          fabsf(part->vertices[b].p[2] - part->vertices[c].p[2])) {
        add_triangle(part, a, b, d);
        add_triangle(part, a, d, c);
      } else {
        add_triangle(part, a, b, c);
        add_triangle(part, b, d, c);
      }
    }
}

static float level(float u, float v, const void *user) {
  (void)u;
  (void)v;
  return *(const float *)user;
}

void meso_add_plane(mesostructure *m, uint32_t part, float z) {
  meso_add_height_field(m, part, 2, level, &z);
}

/* Point i of a tube, also before its first and after its last. */
static tube_point point_of_tube(const tube_point *points, uint32_t count, const vec3 *repeat, int i) {
  const int last = (int)count - 1;
  if (repeat == NULL || (i >= 0 && i <= last)) return points[i < 0 ? 0 : i > last ? last : i];
  tube_point p = points[i < 0 ? i + (int)count : i - (int)count];
  p.center = vec3_along(p.center, i < 0 ? -1.0f : 1.0f, *repeat);
  /* The surface coordinate goes on by the step that led to the end. */
  p.s = i < 0 ? 2.0f * points[0].s - points[1].s : 2.0f * points[last].s - points[last - 1].s;
  return p;
}

void meso_add_tube(mesostructure *m, uint32_t part_index, uint32_t object, const tube_point *points,
                   uint32_t count, uint32_t sides, const vec3 *repeat, vec3 up) {
  meso_part *part = &m->parts[part_index];
  const uint32_t rings = repeat != NULL ? count + 1 : count, first = part->vertex_count;
  if (synth_watch_stops(m->watch) || !room_for_mesh(m, part, rings * (sides + 1), 2 * (rings - 1) * sides))
    return;
  for (uint32_t i = 0; i < rings; ++i) {
    const tube_point before = point_of_tube(points, count, repeat, (int)i - 1);
    const tube_point here = point_of_tube(points, count, repeat, (int)i);
    const tube_point after = point_of_tube(points, count, repeat, (int)i + 1);
    const vec3 along = vec3_normalize(vec3_sub(after.center, before.center));
    const vec3 side = vec3_normalize(vec3_cross(up, along)), over = vec3_cross(along, side);
    /* Where the radius changes the surface leans along the tube. */
    const float reach = vec3_length(vec3_sub(after.center, before.center));
    const float lean = reach > 0.0f ? (before.radius - after.radius) / reach : 0.0f;
    for (uint32_t j = 0; j <= sides; ++j) {
      const float phi = 6.28318530718f * (float)(j % sides) / (float)sides;
      const vec3 out = vec3_along(vec3_scale(side, cosf(phi)), sinf(phi), over);
      meso_vertex *vertex = &part->vertices[part->vertex_count++];
      vec3_store(vertex->p, vec3_along(here.center, here.radius, out));
      vec3_store(vertex->n, vec3_normalize(vec3_along(out, lean, along)));
      vec3_store(vertex->tangent, along);
      vertex->s = here.s;
      vertex->t = (float)j / (float)sides;
      vertex->object = object;
    }
  }
  for (uint32_t i = 0; i + 1 < rings; ++i)
    for (uint32_t j = 0; j < sides; ++j) {
      const uint32_t a = first + i * (sides + 1) + j, b = a + 1, c = a + sides + 1, d = c + 1;
      add_triangle(part, a, b, d);
      add_triangle(part, a, d, c);
    }
}

void meso_add_yarn(mesostructure *m, uint32_t part, uint32_t first_object, const yarn *y) {
  tube_point *points = malloc(y->count * sizeof *points);
  if (points == NULL) {
    m->failed = true;
    return;
  }
  for (uint32_t ply = 0; ply < y->plies; ++ply) {
    for (uint32_t i = 0; i < y->count; ++i) {
      const vec3 before = i > 0 ? y->centre[i - 1] : vec3_sub(y->centre[y->count - 1], y->repeat);
      const vec3 after = i + 1 < y->count ? y->centre[i + 1] : vec3_add(y->centre[0], y->repeat);
      const vec3 along = vec3_normalize(vec3_sub(after, before));
      const vec3 side = vec3_normalize(vec3_cross(y->up, along)), over = vec3_cross(along, side);
      const float s = (float)i / (float)y->count;
      const float phi = 6.28318530718f * ((float)ply / (float)y->plies + y->turns * s + y->phase);
      vec3 p = vec3_along(y->centre[i], y->spread_side * cosf(phi), side);
      p = vec3_along(p, y->spread_up * sinf(phi), over);
      points[i] = (tube_point){p, y->radius, s};
    }
    meso_add_tube(m, part, first_object + ply, points, y->count, 12, &y->repeat, y->up);
  }
  free(points);
}

void meso_add_sphere(mesostructure *m, uint32_t part_index, vec3 center, float radius) {
  meso_part *part = &m->parts[part_index];
  void *spheres = part->spheres;
  const bool fits = make_room(m, &spheres, part->sphere_count, &part->sphere_room, 1, sizeof *part->spheres);
  part->spheres = spheres;
  if (fits) part->spheres[part->sphere_count++] = (meso_sphere){center.x, center.y, center.z, radius};
}
