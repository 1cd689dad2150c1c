/* SPDX-License-Identifier: MIT */
/* kinds.c: the kinds of lobes, and how a texel's values are laid out. */
#include "lafortune.h"

#include <math.h>
#include <string.h>

/* Below this, the quotients of the classical models are held: they grow without bound at the horizon, where
 * nothing is measured. The first is the library's own bound for division by the cosine. */
#define SMALLEST_COSINE 0.02f
#define SMALLEST_COSINES (SMALLEST_COSINE * SMALLEST_COSINE)
#define SMALLEST_HALF_COSINE 1e-3f

uint32_t btfi_lafortune_shape_values(uint32_t kind) {
  switch (kind) {
  case LAF_DIAGONAL:
    return 4;
  case LAF_FULL:
    return 10;
  case LAF_WARD:
    return 2;
  default:
    return 1;
  }
}

uint32_t btfi_lafortune_term_count(uint32_t kind) {
  switch (kind) {
  case LAF_DIAGONAL:
    return 3;
  case LAF_FULL:
    return 9;
  case LAF_WARD:
    return 2;
  default:
    return 1;
  }
}

static float at_least(float value, float least) {
  return value > least ? value : least;
}

/* The half vector, of any length. */
static void half_terms(uint32_t kind, const float light[3], const float view[3], btfi_lafortune_terms *out) {
  const float x = light[0] + view[0], y = light[1] + view[1], z = light[2] + view[2];
  if (kind == LAF_BLINN_PHONG) {
    const float length = sqrtf(x * x + y * y + z * z);
    out->term[0] = length > 0.0f ? z / length : 0.0f;
  } else {
    const float square = at_least(z * z, SMALLEST_HALF_COSINE * SMALLEST_HALF_COSINE);
    out->term[0] = x * x / square;
    out->term[1] = y * y / square;
  }
}

void btfi_lafortune_terms_of(uint32_t kind, bool times_cosine, const float light[3], const float view[3],
                             btfi_lafortune_terms *out) {
  out->diffuse = out->lobe = times_cosine ? light[2] : 1.0f;
  switch (kind) {
  case LAF_DIAGONAL:
    for (int i = 0; i < 3; i++) out->term[i] = view[i] * light[i];
    break;
  case LAF_FULL:
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) out->term[3 * i + j] = view[i] * light[j];
    break;
  case LAF_WARD:
    half_terms(kind, light, view, out);
    out->lobe /= sqrtf(at_least(light[2] * view[2], SMALLEST_COSINES));
    break;
  case LAF_BLINN_PHONG:
    half_terms(kind, light, view, out);
    out->lobe /= at_least(light[2], SMALLEST_COSINE);
    break;
  default:
    out->term[0] = view[2] * light[2] - view[0] * light[0] - view[1] * light[1];
    if (kind == LAF_PHONG) out->lobe /= at_least(light[2], SMALLEST_COSINE);
    break;
  }
}

void btfi_lafortune_layout_of(uint32_t kind, uint32_t lobes, uint32_t colour, uint32_t storage,
                              uint32_t channels, btfi_lafortune_layout *out) {
  memset(out, 0, sizeof *out);
  out->kind = kind;
  out->lobes = lobes;
  out->colour = colour;
  out->storage = storage;
  out->channels = channels;
  out->groups = colour == LAF_CHANNEL ? channels : 1;
  out->group_channels = channels / out->groups;
  out->shape = btfi_lafortune_shape_values(kind);
  out->group_values = lobes * out->shape + (1 + lobes) * out->group_channels;
  out->values = out->groups * out->group_values;
  out->value_bytes = storage == LAF_F16 ? 2 : 4;
}
