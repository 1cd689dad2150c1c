/* SPDX-License-Identifier: MIT */
/* repeats.c: sets in which a direction occurs more than once. Triangles, strips and cells are built of the
 * distinct directions and then speak of the first sample of each; the others are samples of the set like any,
 * which no direction leads to. */
#include "directions/dirset.h"

#include <string.h>

/* +0 and -0 are one direction. */
static bool same_direction(const btf_dirset *set, uint32_t a, uint32_t b) {
  const float *p = set->direction + 3 * (size_t)a, *q = set->direction + 3 * (size_t)b;
  return p[0] == q[0] && p[1] == q[1] && p[2] == q[2];
}

static uint64_t key_of(const btf_dirset *set, uint32_t i) {
  float d[3];
  for (int k = 0; k < 3; k++) d[k] = set->direction[3 * (size_t)i + (size_t)k] + 0.0f;
  return btfi_xxh64_of(d, sizeof d);
}

btf_status btfi_dirset_find_distinct(const btf_dirset *set, uint32_t *distinct, uint32_t *count) {
  const uint32_t n = set->count;
  btfi_keyed *list = btfi_alloc(set->ctx, 2 * (uint64_t)n, sizeof *list);
  if (!list) return btfi_alloc_status();
  for (uint32_t i = 0; i < n; i++) list[i] = (btfi_keyed){key_of(set, i), i};
  btfi_sort_keyed(list, list + n, n);
  for (uint32_t i = 0; i < n; i++) distinct[i] = 1;
  /* Equal keys of different directions would leave repeats to be refused as too close, and nothing worse. */
  for (uint32_t i = 0, first = 0; i < n; i++) {
    if (list[i].key != list[first].key) first = i;
    if (i != first && same_direction(set, list[first].item, list[i].item)) distinct[list[i].item] = 0;
  }
  *count = 0;
  for (uint32_t i = 0; i < n; i++)
    if (distinct[i]) distinct[(*count)++] = i;
  btfi_free(set->ctx, list);
  return BTF_OK;
}

/* The samples of `part` become those that they are copies of. Their order stays, and with it that of ties. */
static void rename_samples(btf_dirset *part, const uint32_t *distinct) {
  for (uint32_t i = 0; i < part->facet_count; i++)
    for (int k = 0; k < 3; k++) part->facet[i].vertex[k] = distinct[part->facet[i].vertex[k]];
  for (size_t i = 0; i < 3 * (size_t)part->triangle_count; i++)
    part->triangle[i] = distinct[part->triangle[i]];
  for (uint32_t i = 0; i < part->cell_count; i++) {
    btfi_cell *cell = &part->cell[i];
    if (cell->ref & BTFI_CELL_SPLIT) continue;
    if (cell->ref & BTFI_CELL_SINGLE) {
      cell->ref = BTFI_CELL_SINGLE | distinct[cell->ref & ~BTFI_CELL_SINGLE];
      continue;
    }
    uint32_t *list = part->nearby + cell->ref;
    for (uint32_t k = 1; k <= list[0]; k++) list[k] = distinct[list[k]];
  }
}

static btf_status build_part(btf_dirset *part, const btf_dirset *set, const uint32_t *distinct) {
  part->unit = btfi_alloc(set->ctx, part->count, sizeof *part->unit);
  part->point = part->unit ? btfi_alloc(set->ctx, part->count, sizeof *part->point) : NULL;
  if (!part->point) return btfi_alloc_status();
  for (uint32_t i = 0; i < part->count; i++) {
    memcpy(part->unit[i], set->unit[distinct[i]], sizeof *part->unit);
    memcpy(part->point[i], set->point[distinct[i]], sizeof *part->point);
  }
  BTFI_TRY(btfi_dirset_build_facets(part));
  BTFI_TRY(btfi_dirset_build_raster(part));
  rename_samples(part, distinct);
  return BTF_OK;
}

btf_status btfi_dirset_build_distinct(btf_dirset *set, const uint32_t *distinct, uint32_t count) {
  btf_dirset part = {.ctx = set->ctx, .count = count};
  const btf_status status = build_part(&part, set, distinct);
  btfi_free(set->ctx, part.point);
  btfi_free(set->ctx, part.unit);
  set->facet = part.facet;
  set->facet_count = part.facet_count;
  set->triangle = part.triangle;
  set->triangle_count = part.triangle_count;
  set->cell = part.cell;
  set->cell_count = part.cell_count;
  set->nearby = part.nearby;
  return status;
}
