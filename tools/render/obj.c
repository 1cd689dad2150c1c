/* SPDX-License-Identifier: MIT */
/* Reader of Wavefront OBJ: v, vt, vn and f; everything else is passed over. */
#include "mesh.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cli.h"

enum { MAXIMUM = 1 << 26 };

/* A growing array of `width` floats or integers an entry. */
typedef struct series {
  void *data;
  size_t count, capacity, entry;
} series;

static void *series_add(series *s) {
  if (s->count == s->capacity) {
    const size_t capacity = s->capacity != 0 ? 2 * s->capacity : 1024;
    void *grown = s->count < MAXIMUM ? realloc(s->data, capacity * s->entry) : NULL;
    if (grown == NULL) return NULL;
    s->data = grown;
    s->capacity = capacity;
  }
  return (char *)s->data + s->entry * s->count++;
}

typedef struct obj_corner {
  int32_t position, texture, normal; /* normal -1 = none */
} obj_corner;

typedef struct obj_file {
  const char *path;
  unsigned long line;
  series positions, textures, normals, corners; /* three corners a triangle */
} obj_file;

static int bad_line(const obj_file *f, const char *what) {
  return cli_fail(EXIT_MALFORMED, "%s: line %lu: %s", f->path, f->line, what);
}

static int read_floats(obj_file *f, const char *text, series *to, int count) {
  float *entry = series_add(to);
  if (entry == NULL) return cli_out_of_memory();
  for (int i = 0; i < count; i++) {
    char *end;
    entry[i] = strtof(text, &end);
    if (end == text || !isfinite(entry[i])) return bad_line(f, "expected numbers");
    text = end;
  }
  return EXIT_DONE;
}

/* One index of a face: 1-based, or counted back from the last. False if it is out of range. */
static bool read_index(const char **text, size_t count, int32_t *out) {
  char *end;
  const long value = strtol(*text, &end, 10);
  if (end == *text) return false;
  *text = end;
  const long long index = value > 0 ? (long long)value - 1 : (long long)count + value;
  if (value == 0 || index < 0 || index >= (long long)count) return false;
  *out = (int32_t)index;
  return true;
}

static int read_face(obj_file *f, const char *text) {
  obj_corner first = {0}, previous = {0};
  for (int number = 0;; number++) {
    text += strspn(text, " \t\r\n");
    if (*text == '\0') return number >= 3 ? EXIT_DONE : bad_line(f, "a face needs three corners");
    obj_corner corner = {0, -1, -1};
    if (!read_index(&text, f->positions.count, &corner.position)) return bad_line(f, "no such vertex");
    if (*text == '/' && text[1] != '/') {
      text++;
      if (!read_index(&text, f->textures.count, &corner.texture))
        return bad_line(f, "no such texture coordinate");
    } else if (*text == '/') {
      text++;
    }
    if (*text == '/') {
      text++;
      if (!read_index(&text, f->normals.count, &corner.normal)) return bad_line(f, "no such normal");
    }
    if (corner.texture < 0)
      return bad_line(f, "a corner without texture coordinate; the material needs them");
    if (number == 0) first = corner;
    if (number >= 2) {
      const obj_corner triangle[3] = {first, previous, corner};
      for (int k = 0; k < 3; k++) {
        obj_corner *slot = series_add(&f->corners);
        if (slot == NULL) return cli_out_of_memory();
        *slot = triangle[k];
      }
    }
    previous = corner;
  }
}

static int read_lines(obj_file *f, FILE *stream) {
  char *line = NULL;
  size_t room = 0;
  int status = EXIT_DONE;
  while (status == EXIT_DONE && getline(&line, &room, stream) >= 0) {
    f->line++;
    const char *text = line + strspn(line, " \t");
    if (strncmp(text, "v ", 2) == 0)
      status = read_floats(f, text + 2, &f->positions, 3);
    else if (strncmp(text, "vt ", 3) == 0)
      status = read_floats(f, text + 3, &f->textures, 2);
    else if (strncmp(text, "vn ", 3) == 0)
      status = read_floats(f, text + 3, &f->normals, 3);
    else if (strncmp(text, "f ", 2) == 0)
      status = read_face(f, text + 2);
  }
  free(line);
  if (status == EXIT_DONE && ferror(stream)) status = cli_fail(EXIT_IO, "%s: %s", f->path, strerror(errno));
  return status;
}

/* Of length 1, whatever the length was; +z for 0. */
static vec3 unit(vec3 v) {
  const double length = sqrt((double)v.x * v.x + (double)v.y * v.y + (double)v.z * v.z);
  if (!(length > 0.0)) return vec3_make(0.0f, 0.0f, 1.0f);
  return vec3_make((float)(v.x / length), (float)(v.y / length), (float)(v.z / length));
}

/* Moves and scales the positions that are used into the unit sphere; as doubles, whose range holds the
 * squares of all floats. */
static void place(const obj_file *f, mesh *out) {
  const float(*positions)[3] = f->positions.data;
  const obj_corner *corners = f->corners.data;
  double low[3], high[3], centre[3], square = 0.0;
  for (int axis = 0; axis < 3; axis++) {
    low[axis] = high[axis] = positions[corners[0].position][axis];
    for (size_t i = 1; i < f->corners.count; i++) {
      low[axis] = fmin(low[axis], positions[corners[i].position][axis]);
      high[axis] = fmax(high[axis], positions[corners[i].position][axis]);
    }
    centre[axis] = 0.5 * (low[axis] + high[axis]);
    square += (high[axis] - low[axis]) * (high[axis] - low[axis]);
  }
  const double radius = square > 0.0 ? 0.5 * sqrt(square) : 1.0;
  for (size_t i = 0; i < f->corners.count; i++) {
    const float *p = positions[corners[i].position];
    out->vertices[i].position =
        vec3_make((float)((p[0] - centre[0]) / radius), (float)((p[1] - centre[1]) / radius),
                  (float)((p[2] - centre[2]) / radius));
  }
}

/* Every corner becomes a vertex of its own; normals that the file lacks are averaged over its positions. */
static int assemble(const obj_file *f, float repeat, mesh *out) {
  const float(*textures)[2] = f->textures.data;
  const float(*normals)[3] = f->normals.data;
  const obj_corner *corners = f->corners.data;
  if (f->corners.count == 0)
    return cli_fail(EXIT_MALFORMED, "%s: holds no faces; expected a Wavefront OBJ", f->path);
  vec3 *averages = calloc(f->positions.count, sizeof *averages);
  if (averages == NULL || !mesh_reserve(out, (uint32_t)f->corners.count, (uint32_t)(f->corners.count / 3))) {
    free(averages);
    return cli_out_of_memory();
  }
  place(f, out);
  for (size_t i = 0; i < f->corners.count; i += 3) {
    const vec3 p = out->vertices[i].position;
    const vec3 area =
        vec3_cross(vec3_sub(out->vertices[i + 1].position, p), vec3_sub(out->vertices[i + 2].position, p));
    for (int k = 0; k < 3; k++) {
      vec3 *average = &averages[corners[i + k].position];
      *average = vec3_add(*average, area);
    }
  }
  for (size_t i = 0; i < f->corners.count; i++) {
    const obj_corner *c = &corners[i];
    mesh_vertex *v = &out->vertices[i];
    v->normal = unit(c->normal >= 0 ? vec3_load(normals[c->normal]) : averages[c->position]);
    v->u = textures[c->texture][0] * repeat;
    v->v = textures[c->texture][1] * repeat;
    out->triangles[i] = (uint32_t)i;
  }
  free(averages);
  return EXIT_DONE;
}

int mesh_obj(const char *path, float repeat, mesh *out) {
  *out = (mesh){0};
  FILE *stream = fopen(path, "r");
  if (stream == NULL) return cli_fail(EXIT_IO, "%s: %s", path, strerror(errno));
  obj_file f = {.path = path,
                .positions.entry = 3 * sizeof(float),
                .textures.entry = 2 * sizeof(float),
                .normals.entry = 3 * sizeof(float),
                .corners.entry = sizeof(obj_corner)};
  int status = read_lines(&f, stream);
  fclose(stream);
  if (status == EXIT_DONE) status = assemble(&f, repeat, out);
  free(f.positions.data);
  free(f.textures.data);
  free(f.normals.data);
  free(f.corners.data);
  return status;
}
