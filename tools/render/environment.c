/* SPDX-License-Identifier: MIT */
#include "render/environment.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "cli.h"
#include "image/image.h"

static const float pi = 3.14159265f;

static float luminance(const float *rgb) {
  return 0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2];
}

/* ---- built-in maps ---- */

static float smooth_edge(float low, float high, float x) {
  const float t = fminf(fmaxf((x - low) / (high - low), 0.0f), 1.0f);
  return t * t * (3.0f - 2.0f * t);
}

/* A soft box: a rectangle on the sphere of directions with soft borders. */
static float soft_box(vec3 d, float azimuth, float elevation, float half_width, float half_height) {
  float across = atan2f(d.y, d.x) - azimuth;
  across -= 2.0f * pi * floorf(across / (2.0f * pi) + 0.5f);
  const float up = asinf(fminf(fmaxf(d.z, -1.0f), 1.0f)) - elevation;
  return (1.0f - smooth_edge(half_width, half_width + 0.08f, fabsf(across))) *
         (1.0f - smooth_edge(half_height, half_height + 0.08f, fabsf(up)));
}

/* A large key light at the upper left, a cool fill at the right, a narrow rim light behind, a dim room. */
static vec3 studio(vec3 d) {
  const float key = 14.0f * soft_box(d, -2.45f, 0.75f, 0.38f, 0.30f);
  const float fill = 2.2f * soft_box(d, -0.35f, 0.35f, 0.35f, 0.45f);
  const float rim = 8.0f * soft_box(d, 1.2f, 0.55f, 0.50f, 0.10f);
  const float room = 0.10f + 0.14f * smooth_edge(-0.3f, 1.0f, d.z);
  return vec3_make(room + key + 0.85f * fill + rim, room + 0.96f * key + 0.93f * fill + 0.97f * rim,
                   1.05f * room + 0.88f * key + fill + 0.92f * rim);
}

/* A clear sky with a low sun over a grey ground. */
static vec3 sky(vec3 d) {
  const vec3 sun = vec3_normalize(vec3_make(-0.55f, -0.6f, 0.62f));
  const float toward = vec3_dot(d, sun), up = fmaxf(d.z, 0.0f);
  if (d.z < 0.0f) return vec3_make(0.22f, 0.20f, 0.18f);
  const float haze = expf(-5.0f * up), halo = 0.5f * powf(fmaxf(toward, 0.0f), 24.0f);
  const float disc = 900.0f * smooth_edge(0.9988f, 0.9994f, toward);
  return vec3_make(0.20f + 0.45f * haze + halo + disc, 0.36f + 0.38f * haze + 0.9f * halo + 0.93f * disc,
                   0.75f + 0.15f * haze + 0.7f * halo + 0.80f * disc);
}

static vec3 direction_of(const environment *e, float column, float row) {
  const float longitude = 2.0f * pi * (column / (float)e->width - 0.5f), polar = pi * row / (float)e->height;
  return vec3_make(sinf(polar) * sinf(longitude), sinf(polar) * cosf(longitude), cosf(polar));
}

static int built_in(vec3 (*radiance)(vec3), environment *e) {
  e->width = 1024;
  e->height = 512;
  e->radiance = malloc(sizeof(float) * 3 * (size_t)e->width * e->height);
  if (e->radiance == NULL) return cli_out_of_memory();
  for (uint32_t y = 0; y < e->height; y++)
    for (uint32_t x = 0; x < e->width; x++)
      vec3_store(e->radiance + 3 * ((size_t)y * e->width + x),
                 radiance(direction_of(e, (float)x + 0.5f, (float)y + 0.5f)));
  return EXIT_DONE;
}

/* ---- sampling ---- */

/* Each cell of the map is drawn in proportion to its mean luminance (that of its four corners' lookups is
 * bounded by the cells around, so a share of the neighbours goes in) times its solid angle. */
static float cell_weight(const environment *e, uint32_t x, uint32_t y) {
  float sum = 0.0f;
  for (int dy = -1; dy <= 1; dy++)
    for (int dx = -1; dx <= 1; dx++) {
      const uint32_t row = (uint32_t)fminf(fmaxf((float)((int32_t)y + dy), 0.0f), (float)(e->height - 1));
      const uint32_t column = (x + e->width + (uint32_t)dx) % e->width;
      const float weight = (dx == 0 ? 0.5f : 0.25f) * (dy == 0 ? 0.5f : 0.25f);
      sum += weight * luminance(e->radiance + 3 * ((size_t)row * e->width + column));
    }
  return sum;
}

static float row_solid_angle(const environment *e, uint32_t y) {
  return 2.0f * pi / (float)e->width *
         (cosf(pi * (float)y / (float)e->height) - cosf(pi * (float)(y + 1) / (float)e->height));
}

static int prepare(environment *e) {
  e->row_integral = malloc(sizeof(float) * (e->height + 1));
  e->cell_integral = malloc(sizeof(float) * (size_t)e->height * (e->width + 1));
  double *rows = malloc(sizeof(double) * e->height);
  double *cells = malloc(sizeof(double) * (e->width + 1));
  if (e->row_integral == NULL || e->cell_integral == NULL || rows == NULL || cells == NULL) {
    free(rows);
    free(cells);
    return cli_out_of_memory();
  }
  e->power = 0.0;
  for (uint32_t y = 0; y < e->height; y++) {
    float *integral = e->cell_integral + (size_t)y * (e->width + 1);
    cells[0] = 0.0;
    for (uint32_t x = 0; x < e->width; x++) cells[x + 1] = cells[x] + (double)cell_weight(e, x, y);
    rows[y] = cells[e->width] * (double)row_solid_angle(e, y);
    for (uint32_t x = 0; x <= e->width; x++)
      integral[x] = cells[e->width] > 0.0 ? (float)(cells[x] / cells[e->width]) : (float)x / (float)e->width;
    e->power += rows[y];
  }
  double sum = 0.0;
  for (uint32_t y = 0; y <= e->height; y++) {
    e->row_integral[y] = e->power > 0.0 ? (float)(sum / e->power) : (float)y / (float)e->height;
    if (y < e->height) sum += rows[y];
  }
  free(rows);
  free(cells);
  return EXIT_DONE;
}

/* Index of the interval of an ascending table of count + 1 entries from 0 to 1 that holds x, and the place in
 * it. */
static uint32_t find(const float *table, uint32_t count, float x, float *inside) {
  uint32_t low = 0, high = count;
  while (high - low > 1) {
    const uint32_t middle = low + (high - low) / 2;
    if (table[middle] <= x)
      low = middle;
    else
      high = middle;
  }
  const float width = table[low + 1] - table[low];
  *inside = width > 0.0f ? fminf((x - table[low]) / width, 1.0f) : 0.5f;
  return low;
}

static vec3 turned(vec3 d, float angle) {
  const float c = cosf(angle), s = sinf(angle);
  return vec3_make(c * d.x - s * d.y, s * d.x + c * d.y, d.z);
}

float environment_sample(const environment *e, float x, float y, vec3 *direction) {
  float across, down;
  const uint32_t row = find(e->row_integral, e->height, y, &down);
  const uint32_t column = find(e->cell_integral + (size_t)row * (e->width + 1), e->width, x, &across);
  /* uniform in solid angle within the cell */
  const float top = cosf(pi * (float)row / (float)e->height),
              bottom = cosf(pi * (float)(row + 1) / (float)e->height);
  const float z = top + down * (bottom - top), radius = sqrtf(fmaxf(1.0f - z * z, 0.0f));
  const float longitude = 2.0f * pi * (((float)column + across) / (float)e->width - 0.5f);
  *direction = turned(vec3_make(radius * sinf(longitude), radius * cosf(longitude), z), e->rotation);
  return environment_density(e, *direction);
}

static void place(const environment *e, vec3 direction, float *column, float *row) {
  const vec3 d = turned(direction, -e->rotation);
  *column = (atan2f(d.x, d.y) / (2.0f * pi) + 0.5f) * (float)e->width;
  *row = acosf(fminf(fmaxf(d.z, -1.0f), 1.0f)) / pi * (float)e->height;
}

float environment_density(const environment *e, vec3 direction) {
  float column, row;
  if (!(e->power > 0.0)) return 1.0f / (4.0f * pi);
  place(e, direction, &column, &row);
  const uint32_t x = (uint32_t)fminf(column, (float)(e->width - 1)),
                 y = (uint32_t)fminf(row, (float)(e->height - 1));
  const float *cells = e->cell_integral + (size_t)y * (e->width + 1);
  return (e->row_integral[y + 1] - e->row_integral[y]) * (cells[x + 1] - cells[x]) / row_solid_angle(e, y);
}

vec3 environment_radiance(const environment *e, vec3 direction) {
  float column, row;
  place(e, direction, &column, &row);
  const float x = column - 0.5f, y = fminf(fmaxf(row - 0.5f, 0.0f), (float)(e->height - 1));
  const float fx = x - floorf(x), fy = y - floorf(y);
  const uint32_t x0 = (uint32_t)((int32_t)floorf(x) + (int32_t)e->width) % e->width, x1 = (x0 + 1) % e->width;
  const uint32_t y0 = (uint32_t)y, y1 = y0 + 1 < e->height ? y0 + 1 : y0;
  const float *a = e->radiance + 3 * ((size_t)y0 * e->width + x0),
              *b = e->radiance + 3 * ((size_t)y0 * e->width + x1);
  const float *c = e->radiance + 3 * ((size_t)y1 * e->width + x0),
              *d = e->radiance + 3 * ((size_t)y1 * e->width + x1);
  float rgb[3];
  for (int k = 0; k < 3; k++)
    rgb[k] = (1.0f - fy) * ((1.0f - fx) * a[k] + fx * b[k]) + fy * ((1.0f - fx) * c[k] + fx * d[k]);
  return vec3_load(rgb);
}

int environment_load(const char *name, environment *out) {
  int status;
  *out = (environment){0};
  if (strcmp(name, "studio") == 0) {
    status = built_in(studio, out);
  } else if (strcmp(name, "sky") == 0) {
    status = built_in(sky, out);
  } else {
    image map = {0};
    status = image_read(name, &map, NULL);
    out->width = map.width;
    out->height = map.height;
    out->radiance = map.rgb;
  }
  if (status == EXIT_DONE) status = prepare(out);
  if (status != EXIT_DONE) environment_free(out);
  return status;
}

void environment_free(environment *e) {
  free(e->radiance);
  free(e->row_integral);
  free(e->cell_integral);
  *e = (environment){0};
}
