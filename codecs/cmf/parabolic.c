/* SPDX-License-Identifier: MIT */
/* parabolic.c: maps of the hemisphere and the half-difference frame. Positions are computed in double, so
 * that maps and lookups of a fit agree with each other to the last bit of a float. */
#include "parabolic.h"

#include <math.h>

#define PI 3.14159265358979323846

btfi_cmf_map btfi_cmf_map_of(uint32_t kind, uint32_t edge) {
  const btfi_cmf_map map = {kind, edge, kind == CMF_ANGULAR ? (edge + 1) / 2 : edge};
  return map;
}

static void unit(double x, double y, double z, float out[3]) {
  const double length = sqrt(x * x + y * y + z * z);
  if (!(length > 0.0)) {
    out[0] = out[1] = 0.0f;
    out[2] = 1.0f;
    return;
  }
  out[0] = (float)(x / length);
  out[1] = (float)(y / length);
  out[2] = (float)(z / length);
}

static double dot(const float a[3], const float b[3]) {
  return (double)a[0] * (double)b[0] + (double)a[1] * (double)b[1] + (double)a[2] * (double)b[2];
}

/* ---- maps ---- */

static double centre(uint32_t i, uint32_t n) {
  return (2.0 * i + 1.0) / n - 1.0;
}

/* Diagonals are of the sides of x. */
static bool is_corner(double a, double b) {
  return fabs(a) >= 0.5 && fabs(b) > 0.5;
}

static void from_cube(double a, double b, float direction[3]) {
  if (fabs(a) <= 0.5 && fabs(b) <= 0.5)
    unit(2.0 * a, 2.0 * b, 1.0, direction);
  else if (fabs(a) >= fabs(b))
    unit(a > 0.0 ? 1.0 : -1.0, 2.0 * b, 2.0 * (1.0 - fabs(a)), direction);
  else
    unit(2.0 * a, b > 0.0 ? 1.0 : -1.0, 2.0 * (1.0 - fabs(b)), direction);
}

bool btfi_cmf_map_direction(const btfi_cmf_map *map, uint32_t index, float direction[3]) {
  const uint32_t x = index % map->width, y = index / map->width;
  if (map->kind == CMF_PARABOLIC) {
    const double a = centre(x, map->width), b = centre(y, map->height), r2 = a * a + b * b;
    if (r2 <= 1.0) {
      unit(2.0 * a, 2.0 * b, 1.0 - r2, direction);
      return true;
    }
    unit(a, b, 0.0, direction);
    return false;
  }
  if (map->kind == CMF_CUBE) {
    const double a = centre(x, map->width), b = centre(y, map->height);
    from_cube(a, b, direction);
    return !is_corner(a, b);
  }
  const double phi = 2.0 * PI * (x + 0.5) / map->width, theta = 0.5 * PI * (y + 0.5) / map->height;
  unit(sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta), direction);
  return true;
}

double btfi_cmf_map_solid_angle(const btfi_cmf_map *map, uint32_t index) {
  const uint32_t x = index % map->width, y = index / map->width;
  if (map->kind == CMF_PARABOLIC) {
    const double a = centre(x, map->width), b = centre(y, map->height), r2 = a * a + b * b;
    const double side = 2.0 / map->width;
    return r2 <= 1.0 ? 4.0 / ((1.0 + r2) * (1.0 + r2)) * side * side : 0.0;
  }
  if (map->kind == CMF_CUBE) {
    /* On the plane of a face at distance 1: dp dq / (1 + p^2 + q^2)^(3/2). */
    const double a = fabs(centre(x, map->width)), b = fabs(centre(y, map->height));
    const double p = a <= 0.5 ? 2.0 * a : 2.0 * (1.0 - a), q = b <= 0.5 ? 2.0 * b : 2.0 * (1.0 - b);
    const double side = 4.0 / map->width;
    return is_corner(a, b) ? 0.0 : side * side / pow(1.0 + p * p + q * q, 1.5);
  }
  const double step = 0.5 * PI / map->height;
  return (cos(y * step) - cos((y + 1.0) * step)) * 2.0 * PI / map->width;
}

bool btfi_cmf_map_reads(const btfi_cmf_map *map, uint32_t index) {
  if (map->kind == CMF_ANGULAR) return true;
  /* Lookups reach one texel to each side. */
  const double a = fmax(fabs(centre(index % map->width, map->width)) - 2.0 / map->width, 0.0);
  const double b = fmax(fabs(centre(index / map->width, map->height)) - 2.0 / map->height, 0.0);
  return map->kind == CMF_CUBE ? !is_corner(a, b) : a * a + b * b <= 1.0;
}

/* Two neighbours on an axis of n texels at a position counted from the border. */
static void along(double position, uint32_t n, bool wrap, uint32_t index[2], double weight[2]) {
  double p = position - 0.5;
  if (wrap) {
    if (!(p >= 0.0)) p += n;
    if (!(p >= 0.0 && p < n)) p = 0.0;
  } else {
    p = p > 0.0 ? (p < n - 1.0 ? p : n - 1.0) : 0.0;
  }
  uint32_t i = (uint32_t)p;
  if (!wrap && i + 1 >= n) i = n >= 2 ? n - 2 : 0;
  index[0] = i;
  index[1] = wrap ? (i + 1) % n : (i + 1 < n ? i + 1 : i);
  weight[1] = p - i;
  weight[0] = 1.0 - weight[1];
}

void btfi_cmf_map_locate(const btfi_cmf_map *map, const float direction[3], btfi_cmf_tap *tap) {
  uint32_t x[2], y[2];
  double wx[2], wy[2];
  if (map->kind != CMF_ANGULAR) {
    float ab[2];
    (map->kind == CMF_PARABOLIC ? btfi_cmf_parabolic : btfi_cmf_cube)(direction, ab);
    along(0.5 * ((double)ab[0] + 1.0) * map->width, map->width, false, x, wx);
    along(0.5 * ((double)ab[1] + 1.0) * map->height, map->height, false, y, wy);
  } else {
    const double across = sqrt((double)direction[0] * direction[0] + (double)direction[1] * direction[1]);
    const double theta = atan2(across, direction[2] > 0.0f ? (double)direction[2] : 0.0);
    const double turn = atan2((double)direction[1], (double)direction[0]) / (2.0 * PI);
    along((turn < 0.0 ? turn + 1.0 : turn) * map->width, map->width, true, x, wx);
    along(theta / (0.5 * PI) * map->height, map->height, false, y, wy);
  }
  for (int j = 0; j < 2; j++)
    for (int i = 0; i < 2; i++) {
      tap->index[2 * j + i] = y[j] * map->width + x[i];
      tap->weight[2 * j + i] = (float)(wx[i] * wy[j]);
    }
}

/* The known texel nearest to (x, y) among those at a distance of `ring` along at least one axis. */
static void search_ring(const btfi_cmf_map *map, const unsigned char *known, uint32_t x, uint32_t y,
                        int64_t ring, int64_t *best, uint32_t *found) {
  const int64_t width = map->width, height = map->height;
  for (int64_t dy = -ring; dy <= ring; dy++) {
    const int64_t yy = (int64_t)y + dy;
    if (yy < 0 || yy >= height) continue;
    const int64_t step = dy == -ring || dy == ring || ring == 0 ? 1 : 2 * ring;
    for (int64_t dx = -ring; dx <= ring; dx += step) {
      int64_t xx = (int64_t)x + dx;
      if (map->kind == CMF_ANGULAR) xx = ((xx % width) + width) % width;
      if (xx < 0 || xx >= width || !known[yy * width + xx]) continue;
      if (dx * dx + dy * dy < *best) {
        *best = dx * dx + dy * dy;
        *found = (uint32_t)(yy * width + xx);
      }
    }
  }
}

bool btfi_cmf_map_sources(const btfi_cmf_map *map, const unsigned char *known, uint32_t *source) {
  const uint32_t texels = btfi_cmf_map_texels(map);
  const int64_t most = map->width > map->height ? map->width : map->height;
  for (uint32_t i = 0; i < texels; i++) {
    int64_t best = INT64_MAX;
    source[i] = i;
    /* A texel of a later ring can be nearer than one in a corner of this ring. */
    for (int64_t ring = 0; ring <= most && (best == INT64_MAX || ring * ring < best); ring++)
      search_ring(map, known, i % map->width, i / map->width, ring, &best, &source[i]);
    if (best == INT64_MAX) return false;
  }
  return true;
}

/* ---- directions ---- */

void btfi_cmf_parabolic(const float direction[3], float ab[2]) {
  const double z = direction[2] > 0.0f ? (double)direction[2] : 0.0;
  double a = (double)direction[0] / (1.0 + z), b = (double)direction[1] / (1.0 + z);
  const double r2 = a * a + b * b;
  if (!(r2 <= 1.0)) {
    const double r = sqrt(r2);
    a = r < INFINITY ? a / r : 0.0;
    b = r < INFINITY ? b / r : 0.0;
  }
  ab[0] = (float)a;
  ab[1] = (float)b;
}

void btfi_cmf_from_parabolic(const float ab[2], float direction[3]) {
  const double a = (double)ab[0], b = (double)ab[1];
  unit(2.0 * a, 2.0 * b, 1.0 - a * a - b * b, direction);
}

void btfi_cmf_cube(const float direction[3], float ab[2]) {
  const double x = (double)direction[0], y = (double)direction[1];
  const double z = direction[2] > 0.0f ? (double)direction[2] : 0.0;
  if (z >= fabs(x) && z >= fabs(y)) {
    ab[0] = z > 0.0 ? (float)(0.5 * x / z) : 0.0f;
    ab[1] = z > 0.0 ? (float)(0.5 * y / z) : 0.0f;
  } else if (fabs(x) * (double)CMF_CUBE_BIAS >= fabs(y)) {
    ab[0] = (float)copysign(1.0 - 0.5 * z / fabs(x), x);
    ab[1] = (float)(0.5 * y / fabs(x));
  } else {
    ab[0] = (float)(0.5 * x / fabs(y));
    ab[1] = (float)copysign(1.0 - 0.5 * z / fabs(y), y);
  }
}

void btfi_cmf_from_cube(const float ab[2], float direction[3]) {
  from_cube((double)ab[0], (double)ab[1], direction);
}

void btfi_cmf_half(const float light[3], const float view[3], float half[3]) {
  unit((double)light[0] + (double)view[0], (double)light[1] + (double)view[1],
       (double)light[2] + (double)view[2], half);
}

void btfi_cmf_frame(const float half[3], float x[3], float y[3]) {
  const double hx = (double)half[0], hy = (double)half[1], hz = (double)half[2];
  /* T - <T, h> h = (hy^2 + hz^2, -hx hy, -hx hz). On the tangent itself: the limit along its meridian. */
  if (hy * hy + hz * hz > 1e-24) {
    unit(hy * hy + hz * hz, -hx * hy, -hx * hz, x);
  } else {
    unit(0.0, 0.0, hx > 0.0 ? -1.0 : 1.0, x);
  }
  const double xx = (double)x[0], xy = (double)x[1], xz = (double)x[2];
  unit(hy * xz - hz * xy, hz * xx - hx * xz, hx * xy - hy * xx, y);
}

void btfi_cmf_to_hd(const float light[3], const float view[3], float half[3], float difference[3]) {
  float x[3], y[3];
  btfi_cmf_half(light, view, half);
  btfi_cmf_frame(half, x, y);
  unit(dot(light, x), dot(light, y), dot(light, half), difference);
}

bool btfi_cmf_from_hd(const float half[3], const float difference[3], float light[3], float view[3]) {
  float x[3], y[3];
  double l[3], v[3];
  btfi_cmf_frame(half, x, y);
  for (int i = 0; i < 3; i++) {
    const double along_h = (double)difference[2] * (double)half[i];
    const double across = (double)difference[0] * (double)x[i] + (double)difference[1] * (double)y[i];
    l[i] = along_h + across;
    v[i] = along_h - across;
  }
  unit(l[0], l[1], l[2], light);
  unit(v[0], v[1], v[2], view);
  return light[2] > 0.0f && view[2] > 0.0f;
}
