/* SPDX-License-Identifier: MIT */
/* The triangulation as numbers that a shader reads. */
#include "directions/dirset.h"

uint32_t btfi_dirset_facet_count(const btf_dirset *set) {
  return set->facet_count;
}

/* A form of a facet as a distance, and what makes it a weight, 0 where only its sign counts. */
static float normalise(double x, double y, double scale, float out[2]) {
  const double length = hypot(x, y), by = length > 0.0 ? 1.0 / length : 0.0;
  out[0] = (float)(x * by);
  out[1] = (float)(y * by);
  return (float)(scale * length * BTFI_UNITS);
}

void btfi_dirset_facet_table(const btf_dirset *set, float *out) {
  for (uint32_t i = 0; i < set->facet_count; i++, out += BTFI_FACET_FLOATS) {
    const btfi_facet *f = &set->facet[i];
    out[0] = (float)((double)f->x / BTFI_UNITS);
    out[1] = (float)((double)f->y / BTFI_UNITS);
    out[6] = normalise(f->cx, f->cy, f->b_scale, out + 2);
    out[7] = normalise(f->bx, f->by, f->c_scale, out + 4);
    for (uint32_t k = 0; k < 3; k++) {
      out[8 + k] = (float)f->vertex[k];
      out[12 + k] = (float)f->next[k];
    }
    out[11] = out[15] = 0.0f;
  }
}

void btfi_dirset_facet_map(const btf_dirset *set, uint32_t size, float *out) {
  uint32_t facet = 0;
  for (uint32_t y = 0; y < size; y++) {
    for (uint32_t x = 0; x < size; x++) {
      btf_interp unused;
      const double px = (2.0 * x + 1.0) / size - 1.0, py = (2.0 * y + 1.0) / size - 1.0;
      facet = btfi_dirset_locate_from(set, facet, rint(px * BTFI_UNITS), rint(py * BTFI_UNITS), &unused);
      out[(size_t)y * size + x] = (float)facet;
    }
  }
}
