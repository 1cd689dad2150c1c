/* SPDX-License-Identifier: MIT */
/* audit.h: what a measurer would want to know about the samples of a BTF. */
#ifndef BTF_TOOLS_AUDIT_H
#define BTF_TOOLS_AUDIT_H

#include "sample_source.h"

typedef struct audit_place {
  uint32_t x, y, light, view;
} audit_place;

typedef enum audit_cosine { AUDIT_COSINE_UNKNOWN, AUDIT_COSINE_OUTSIDE, AUDIT_COSINE_INSIDE } audit_cosine;

typedef struct audit {
  uint64_t values; /* samples times channels */
  uint64_t not_finite, negative;
  audit_place first_not_finite, first_negative; /* in the order of views, lights and texels */
  double least, most;
  uint64_t at_most;                  /* values equal to the largest */
  float most_low, most_high;         /* cosines of the lights they are seen under */
  uint32_t most_views, most_in_view; /* how many views have them, and the last one that does */
  /* Some of these are of texels that have other values as well, in some views only or under lights of several
   * elevations: a matte surface that the cosine is in has its largest values under the highest lights, in all
   * views. */
  bool cut_off;
  uint32_t missing; /* pictures that are black all over */
  audit_place first_missing;
  uint64_t dead; /* texels that have one value for all directions */
  audit_place first_dead;
  /* Reciprocity of the mean over texels: median |log| of the ratio of (l, v) to (v, l), of the values as
   * stored, with the cosine of the light divided out, and with it multiplied in. */
  uint32_t pairs;
  double reciprocity, reciprocity_divided, reciprocity_multiplied;
  audit_cosine cosine; /* where it is, judged from that */
  /* Directional albedo, of the brighter channels' mean, averaged over texels for the brightest view, and of
   * the worst texel. */
  double albedo;
  uint32_t albedo_view;
  double albedo_but_one; /* the largest average without the light that gives most of it */
  double worst_albedo;
  audit_place worst_texel;
  /* How much brighter a light or view is than its neighbours are: |log|, the median over the directions of
   * the other side. */
  double flicker_light, flicker_view;
  double flicker_light_usual, flicker_view_usual; /* of the others: their median */
  uint32_t flicker_light_index, flicker_view_index;
  double *mean; /* views x lights: mean over texels and channels; NaN where nothing is finite */
} audit;

/* Reads or decodes every sample once, of the finest level. */
int audit_run(cli *c, const sample_source *source, audit *out);
void audit_free(audit *result);
/* Three pictures side by side: the mean for each pair, its reciprocity error as stored and with the cosine
 * divided out. */
int audit_write_sheet(const sample_source *source, const audit *result, const char *path);

#endif
