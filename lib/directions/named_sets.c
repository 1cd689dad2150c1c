/* SPDX-License-Identifier: MIT */
#include "directions/dirset.h"

#include <math.h>
#include <string.h>

/* `count` directions of equal polar angle, at equal steps of azimuth from `first` on; degrees. */
typedef struct ring {
  double theta, first;
  uint32_t count;
} ring;

/* Order and angles of the file names of the Bonn gonioreflectometer. */
static const ring rings_ubo81[] = {{0, 0, 1}, {15, 0, 6}, {30, 0, 12}, {45, 0, 18}, {60, 0, 20}, {75, 0, 24}};

/* The Bonn dome. */
static const ring rings_ubo151[] = {{0, 0, 1},       {11, 15, 6}, {23.5, 0, 12},   {30, 15, 12},
                                    {37.5, 0, 12},   {45, 0, 18}, {52.5, 7.5, 18}, {60, 0, 24},
                                    {67.5, 7.5, 24}, {75, 0, 24}};

/* Multiples of 90 degrees come out a hair beside 0; they mean 0. */
static float without_dust(double v) {
  return fabs(v) < 1e-12 ? 0.0f : (float)v;
}

static float *put_ring(float *xyz, const ring *r) {
  const double degree = acos(-1.0) / 180.0;
  for (uint32_t j = 0; j < r->count; j++) {
    const double theta = r->theta * degree, phi = (r->first + 360.0 * j / r->count) * degree;
    *xyz++ = without_dust(sin(theta) * cos(phi));
    *xyz++ = without_dust(sin(theta) * sin(phi));
    *xyz++ = without_dust(cos(theta));
  }
  return xyz;
}

static btf_status create_rings(btf_context *ctx, const ring *rings, uint32_t ring_count, btf_dirset **out) {
  uint32_t count = 0;
  for (uint32_t i = 0; i < ring_count; i++) count += rings[i].count;
  float *xyz = btfi_alloc(ctx, count, 3 * sizeof *xyz), *end = xyz;
  if (!xyz) return btfi_alloc_status();
  for (uint32_t i = 0; i < ring_count; i++) end = put_ring(end, &rings[i]);
  const btf_status status = btf_dirset_create(ctx, xyz, count, out);
  btfi_free(ctx, xyz);
  return status;
}

static btf_status create_grid(btf_context *ctx, uint32_t azimuths, uint32_t elevations, btf_dirset **out) {
  const uint64_t count = (uint64_t)azimuths * elevations;
  const uint32_t most = btfi_limits(ctx)->max_directions;
  if (count > most)
    return btfi_fail(ctx, BTF_E_LIMIT, "direction set grid:%ux%u: %llu directions, expected at most %u",
                     azimuths, elevations, (unsigned long long)count, most);
  /* The ring nearest the normal has the closest neighbours. */
  const double apart =
      azimuths == 1 ? M_PI : 2.0 * asin(sin(M_PI / (4.0 * elevations)) * sin(M_PI / azimuths));
  if (apart < BTFI_SMALLEST_ANGLE)
    return btfi_fail(
        ctx, BTF_E_INVALID_ARG,
        "direction set grid:%ux%u: neighbours on its innermost ring are %.3g rad apart, expected "
        "at least %g rad",
        azimuths, elevations, apart, BTFI_SMALLEST_ANGLE);
  float *xyz = btfi_alloc(ctx, count, 3 * sizeof *xyz), *end = xyz;
  if (!xyz) return btfi_alloc_status();
  for (uint32_t i = 0; i < elevations; i++)
    end = put_ring(end, &(ring){(i + 0.5) / elevations * 90.0, 0.0, azimuths});
  const btf_status status = btf_dirset_create(ctx, xyz, (uint32_t)count, out);
  btfi_free(ctx, xyz);
  return status;
}

/* A number 1..1024 in plain digits; NULL if there is none, else what follows it. */
static const char *parse_side(const char *text, uint32_t *out) {
  uint32_t value = 0;
  if (*text == '0') return NULL;
  const char *p = text;
  for (; *p >= '0' && *p <= '9'; p++) {
    value = value * 10 + (uint32_t)(*p - '0');
    if (value > 1024) return NULL;
  }
  *out = value;
  return p == text ? NULL : p;
}

btf_status btf_dirset_create_named(btf_context *ctx, const char *name, btf_dirset **out) {
  if (!out) return btfi_fail(ctx, BTF_E_INVALID_ARG, "direction set: out is NULL");
  *out = NULL;
  if (!ctx) return btfi_fail(NULL, BTF_E_INVALID_ARG, "direction set: the context is NULL");
  if (!name) return btfi_fail(ctx, BTF_E_INVALID_ARG, "direction set: the name is NULL");
  if (strcmp(name, "ubo81") == 0)
    return create_rings(ctx, rings_ubo81, sizeof rings_ubo81 / sizeof *rings_ubo81, out);
  if (strcmp(name, "ubo151") == 0)
    return create_rings(ctx, rings_ubo151, sizeof rings_ubo151 / sizeof *rings_ubo151, out);
  if (strncmp(name, "grid:", 5) == 0) {
    uint32_t azimuths, elevations;
    const char *p = parse_side(name + 5, &azimuths);
    p = p && *p == 'x' ? parse_side(p + 1, &elevations) : NULL;
    if (!p || *p)
      return btfi_fail(
          ctx, BTF_E_INVALID_ARG,
          "direction set \"%.40s\": expected grid:PxT with azimuths P and elevations T from 1 to 1024", name);
    return create_grid(ctx, azimuths, elevations, out);
  }
  return btfi_fail(ctx, BTF_E_INVALID_ARG,
                   "direction set \"%.40s\": unknown; known are ubo81, ubo151 and grid:PxT", name);
}
