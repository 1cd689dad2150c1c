/* SPDX-License-Identifier: MIT */
/* lookup.c: maps from samples of their projection, and their values at the directions of the data. */
#include "factor_parts.h"

enum { MAP_SWEEPS = 4 };

static v4 blend(const v4 *values, const btfi_cmf_tap *tap) {
  return values[tap->index[0]] * tap->weight[0] + values[tap->index[1]] * tap->weight[1] +
         values[tap->index[2]] * tap->weight[2] + values[tap->index[3]] * tap->weight[3];
}

/* Makes a map from samples. Directions of the data lie between texels: sweeps (simultaneous algebraic
 * reconstruction) move the texels until looking them up gives the samples. */
void btfi_cmf_make_map(const btfi_cmf_geometry *g, const btfi_cmf_side *side, v4 *samples,
                       bool may_be_negative, v4 *map, v4 *change) {
  const uint32_t texels = g->map_texels;
  if (side->source != NULL)
    for (uint32_t i = 0; i < side->domain.count; i++) samples[i] = samples[side->source[i]];
  for (uint32_t t = 0; t < texels; t++) map[t] = blend(samples, &side->to_map[t]);
  for (int sweep = 0; sweep < MAP_SWEEPS && side->domain.native; sweep++) {
    memset(change, 0, texels * sizeof *change);
    for (uint32_t i = 0; i < side->domain.count; i++) {
      const btfi_cmf_tap *tap = &side->at[i];
      const v4 missing = samples[i] - blend(map, tap);
      for (int k = 0; k < 4; k++) change[tap->index[k]] += missing * tap->weight[k];
    }
    for (uint32_t t = 0; t < texels; t++) map[t] += change[t] * side->texel_share[t];
  }
  /* Signs of a singular pair are arbitrary only together; here both are those of positive data. */
  for (uint32_t t = 0; t < texels && !may_be_negative; t++) map[t] = largest(map[t], splat(0.0f));
}

static uint32_t at_count(const btfi_cmf_geometry *g, const btfi_cmf_side *side) {
  return side->at_kind == CMF_AT_LIGHT ? g->lights : side->at_kind == CMF_AT_VIEW ? g->views : g->pairs;
}

void btfi_cmf_look_up(const btfi_cmf_geometry *g, const btfi_cmf_side *side, const v4 *map, v4 *out) {
  const uint32_t count = at_count(g, side);
  for (uint32_t i = 0; i < count; i++) out[i] = blend(map, &side->at[i]);
}

void btfi_cmf_add_term(const btfi_cmf_geometry *g, const btfi_cmf_stage_geometry *s, v4 *const at[2],
                       bool first, v4 *value) {
  /* Strides over the light and over the view. */
  const size_t over_light[2] = {s->side[0].at_kind != CMF_AT_VIEW, s->side[1].at_kind != CMF_AT_VIEW};
  size_t over_view[2];
  for (int k = 0; k < 2; k++)
    over_view[k] = s->side[k].at_kind == CMF_AT_PAIR ? g->lights : s->side[k].at_kind == CMF_AT_VIEW;
  for (size_t v = 0; v < g->views; v++)
    for (size_t l = 0; l < g->lights; l++) {
      v4 product = at[0][l * over_light[0] + v * over_view[0]];
      if (s->sides == 2) product *= at[1][l * over_light[1] + v * over_view[1]];
      v4 *to = &value[v * g->lights + l];
      *to = first ? product : *to + product;
    }
}
