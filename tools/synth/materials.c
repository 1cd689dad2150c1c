/* SPDX-License-Identifier: MIT */
#include <string.h>

#include "material.h"

static const synth_material *const materials[] = {
#ifdef BTF_EMBREE_MAJOR
    &synth_checker, &synth_rings,   &synth_tissue,  &synth_corduroy, &synth_knit,
    &synth_carpet,  &synth_plaster, &synth_leather, &synth_metal,
#endif
    &synth_bumps,   &synth_lambert,
#ifdef BTF_EMBREE_MAJOR
    &synth_plane,   &synth_sphere,  &synth_furnace,
#endif
};
#define MATERIAL_COUNT (sizeof materials / sizeof *materials)

const char *synth_name(uint32_t index) {
  return index < MATERIAL_COUNT ? materials[index]->name : NULL;
}
const char *synth_summary(uint32_t index) {
  return index < MATERIAL_COUNT ? materials[index]->summary : NULL;
}

const synth_material *synth_find(const char *name) {
  for (size_t i = 0; i < MATERIAL_COUNT; ++i)
    if (strcmp(materials[i]->name, name) == 0) return materials[i];
  return NULL;
}

bool synth_needs_rays(const char *name) {
  static const char *const traced[] = {"checker", "rings",   "tissue", "corduroy", "knit",   "carpet",
                                       "plaster", "leather", "metal",  "plane",    "sphere", "furnace"};
  if (synth_find(name) != NULL) return false;
  for (size_t i = 0; i < sizeof traced / sizeof *traced; ++i)
    if (strcmp(traced[i], name) == 0) return true;
  return false;
}
