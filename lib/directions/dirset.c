/* SPDX-License-Identifier: MIT */
#include "directions/dirset.h"

#include <string.h>

/* Lengths may differ from 1 by this much; beyond SAME_LENGTH the direction is normalised, below it stays as
 * given so that sets survive a trip through a file unchanged. */
#define LENGTH_TOLERANCE 1e-3
#define SAME_LENGTH 1e-5

btf_context *btfi_dirset_context(const btf_dirset *set) {
  return set->ctx;
}
uint32_t btf_dirset_count(const btf_dirset *set) {
  return set->count;
}
const float *btf_dirset_directions(const btf_dirset *set) {
  return set->direction;
}

const uint32_t *btf_dirset_triangles(const btf_dirset *set, uint32_t *count) {
  *count = set->triangle_count;
  return set->triangle;
}

bool btfi_dirset_equal(const btf_dirset *a, const btf_dirset *b) {
  return a == b || (a->count == b->count &&
                    memcmp(a->direction, b->direction, 3 * (size_t)a->count * sizeof *a->direction) == 0);
}

btf_dirset *btf_dirset_retain(const btf_dirset *set) {
  btf_dirset *s = (btf_dirset *)(uintptr_t)set;
  atomic_fetch_add_explicit(&s->references, 1, memory_order_relaxed);
  return s;
}

void btf_dirset_release(btf_dirset *set) {
  if (!set || atomic_fetch_sub_explicit(&set->references, 1, memory_order_acq_rel) != 1) return;
  btf_context *ctx = set->ctx;
  btfi_free(ctx, set->nearby);
  btfi_free(ctx, set->cell);
  btfi_free(ctx, set->triangle);
  btfi_free(ctx, set->facet);
  btfi_free(ctx, set->point);
  btfi_free(ctx, set->unit);
  btfi_free(ctx, set->direction);
  btfi_free(ctx, set);
  btf_context_release(ctx);
}

/* Takes over one direction, or says what is wrong with it. */
static btf_status take_direction(btf_dirset *set, uint32_t i, const float *xyz) {
  const double x = xyz[0], y = xyz[1], z = xyz[2], length = sqrt(x * x + y * y + z * z);
  if (!isfinite(length))
    return btfi_fail(set->ctx, BTF_E_INVALID_ARG, "direction %u: (%g, %g, %g), expected finite numbers", i, x,
                     y, z);
  if (fabs(length - 1.0) > LENGTH_TOLERANCE)
    return btfi_fail(set->ctx, BTF_E_INVALID_ARG, "direction %u: length %.6g, expected 1 within 0.001", i,
                     length);
  if (z <= 0.0)
    return btfi_fail(set->ctx, BTF_E_INVALID_ARG,
                     "direction %u: z is %g, expected above 0 (the upper hemisphere)", i, z);
  float *d = set->direction + 3 * (size_t)i;
  const double scale = 1.0 / length, change = fabs(length - 1.0) > SAME_LENGTH ? scale : 1.0;
  for (int k = 0; k < 3; k++) {
    d[k] = (float)(xyz[k] * change);
    set->unit[i][k] = xyz[k] * scale;
  }
  btfi_parabolic p;
  if (!btfi_parabolic_of(d[0], d[1], d[2], &p)) p = (btfi_parabolic){0.0f, 0.0f};
  set->point[i][0] = (int32_t)btfi_to_units(p.px);
  set->point[i][1] = (int32_t)btfi_to_units(p.py);
  return BTF_OK;
}

static double angle_between(const double a[3], const double b[3]) {
  const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return 2.0 * asin(fmin(1.0, 0.5 * sqrt(x * x + y * y + z * z)));
}

/* The pair of a sample with one of a run of keys, or BTF_OK. */
static btf_status check_run(const btf_dirset *set, uint32_t i, const btfi_keyed *run, uint64_t last_key) {
  for (; run->key <= last_key; run++) {
    if (run->item == i) continue;
    const double angle = angle_between(set->unit[i], set->unit[run->item]);
    if (angle < BTFI_SMALLEST_ANGLE)
      return btfi_fail(set->ctx, BTF_E_INVALID_ARG,
                       "directions %u and %u: %.3g rad apart, expected at least 0.0001 rad",
                       BTFI_MIN(i, run->item), BTFI_MAX(i, run->item), angle);
  }
  return BTF_OK;
}

/* Parabolic distance is at most the angle, so a pair that is too close lies in one cell of that size or in
 * two neighbours. A cell without such a pair holds a handful of samples. */
static btf_status refuse_neighbours(const btf_dirset *set, const uint32_t *distinct, uint32_t n) {
  btfi_keyed *list = btfi_alloc(set->ctx, 2 * ((uint64_t)n + 1), sizeof *list);
  if (!list) return btfi_alloc_status();
  const int32_t size = (int32_t)(BTFI_SMALLEST_ANGLE * BTFI_UNITS) + 4;
  for (uint32_t i = 0; i < n; i++) {
    const int32_t *point = set->point[distinct[i]];
    const uint64_t column = (uint64_t)((point[0] + BTFI_DELAUNAY_RANGE) / size) + 1,
                   row = (uint64_t)((point[1] + BTFI_DELAUNAY_RANGE) / size) + 1;
    list[i] = (btfi_keyed){row << 32 | column, distinct[i]};
  }
  btfi_sort_keyed(list, list + n + 1, n);
  list[n] = (btfi_keyed){UINT64_MAX, UINT32_MAX};
  btf_status status = BTF_OK;
  uint32_t above = 0;
  for (uint32_t i = 0; i < n && status == BTF_OK; i++) {
    const uint64_t key = list[i].key, up = key + (UINT64_C(1) << 32);
    while (list[above].key < up - 1) above++;
    status = check_run(set, list[i].item, list + i + 1, key + 1);
    if (status == BTF_OK) status = check_run(set, list[i].item, list + above, up + 1);
  }
  btfi_free(set->ctx, list);
  return status;
}

static btf_status build(btf_dirset *set, uint32_t *distinct) {
  uint32_t count;
  BTFI_TRY(btfi_dirset_find_distinct(set, distinct, &count));
  BTFI_TRY(refuse_neighbours(set, distinct, count));
  if (count < set->count) return btfi_dirset_build_distinct(set, distinct, count);
  BTFI_TRY(btfi_dirset_build_facets(set));
  return btfi_dirset_build_raster(set);
}

static btf_status fill(btf_dirset *set, const float *xyz) {
  btf_context *ctx = set->ctx;
  const uint32_t n = set->count;
  set->direction = btfi_alloc(ctx, n, 3 * sizeof *set->direction);
  if (!set->direction) return btfi_alloc_status();
  set->unit = btfi_alloc(ctx, n, sizeof *set->unit);
  if (!set->unit) return btfi_alloc_status();
  set->point = btfi_alloc(ctx, n, sizeof *set->point);
  if (!set->point) return btfi_alloc_status();
  for (uint32_t i = 0; i < n; i++) BTFI_TRY(take_direction(set, i, xyz + 3 * (size_t)i));
  uint32_t *distinct = btfi_alloc(ctx, n, sizeof *distinct);
  if (!distinct) return btfi_alloc_status();
  const btf_status status = build(set, distinct);
  btfi_free(ctx, distinct);
  return status;
}

btf_status btf_dirset_create(btf_context *ctx, const float *xyz, uint32_t count, btf_dirset **out) {
  if (!out) return btfi_fail(ctx, BTF_E_INVALID_ARG, "direction set: out is NULL");
  *out = NULL;
  if (!ctx) return btfi_fail(NULL, BTF_E_INVALID_ARG, "direction set: the context is NULL");
  if (!xyz || count == 0)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "direction set: no directions given, expected at least one");
  const uint32_t most = BTFI_MIN(btfi_limits(ctx)->max_directions, UINT32_MAX / 16);
  if (count > most)
    return btfi_fail(ctx, BTF_E_LIMIT, "direction set: %u directions, expected at most %u", count, most);
  btf_dirset *set = btfi_calloc(ctx, 1, sizeof *set);
  if (!set) return btfi_alloc_status();
  btfi_context_retain(ctx);
  set->ctx = ctx;
  atomic_init(&set->references, 1);
  set->count = count;
  const btf_status status = fill(set, xyz);
  if (status != BTF_OK) {
    btf_dirset_release(set);
    return status;
  }
  *out = set;
  return BTF_OK;
}
