/* SPDX-License-Identifier: MIT */
/* audit_parts.h: what the files of the audit share. */
#ifndef BTF_TOOLS_AUDIT_PARTS_H
#define BTF_TOOLS_AUDIT_PARTS_H

#include "audit.h"

/* The integral over the hemisphere of a function that is interpolated between the lights, times the cosine if
 * the stored quantity is without it, is the sum of its samples with these weights. */
void audit_light_weights(const sample_source *source, double *weights);
/* Reciprocity and flicker, from the means for each pair of directions. */
int audit_directions(const sample_source *source, audit *a);

/* For a pair of a light and a view, the pair with both exchanged; false if no direction is close enough to
 * it. */
bool audit_exchanged(const sample_source *source, uint32_t light, uint32_t view, uint32_t *light_there,
                     uint32_t *view_there);

#endif
