/* SPDX-License-Identifier: MIT */
/* hemisphere.h: hemispherical harmonics of a light, as relighting files have them. */
#ifndef BTF_FORMATS_HEMISPHERE_H
#define BTF_FORMATS_HEMISPHERE_H

#include <stdint.h>

enum { HEMISPHERE_MOST_TERMS = 16 };
/* All terms of a unit vector; z below 0 counts as 0. */
void hemisphere_terms(const double light[3], double out[HEMISPHERE_MOST_TERMS]);

#endif
