/* SPDX-License-Identifier: MIT */
/* carpet.c: a stand-in for a cut-pile carpet: tufts of bent strands standing on a backing. */
#include "mesostructure.h"
#include "noise.h"
#include "trace/sampling.h"

enum { PILE = 0, BACKING = 1 };

#define TUFTS 9 /* each way */
#define STRANDS 26
#define PILE_HEIGHT 0.13f
#define STRAND 0.0120f

static float draw(uint32_t *state) {
  *state = sampling_hash(*state, 1u);
  return sampling_unit(*state);
}

static void add_strand(mesostructure *m, float x, float y, uint32_t object, uint32_t *random) {
  enum { STEPS = 7, SIDES = 6 };
  tube_point points[STEPS];
  const float tau = 6.28318530718f, around = tau * draw(random), out = sqrtf(draw(random));
  const float foot = 0.34f / TUFTS * out, lean = 0.022f * out + 0.024f * draw(random);
  const float turn = around + 0.9f * (draw(random) - 0.5f),
              tall = PILE_HEIGHT * (0.78f + 0.22f * draw(random));
  const vec3 root = vec3_make(x + foot * cosf(around), y + foot * sinf(around), 0.0f);
  const vec3 aside = vec3_make(-sinf(turn), cosf(turn), 0.0f);
  for (int i = 0; i < STEPS; ++i) {
    const float s = (float)i / (STEPS - 1), bend = lean * s * s;
    points[i].center =
        vec3_add(root, vec3_make(bend * cosf(turn), bend * sinf(turn), tall * s * (1.0f - 0.1f * s * out)));
    points[i].radius = STRAND * (i == STEPS - 1 ? 0.35f : 1.0f - 0.25f * s);
    points[i].s = s;
  }
  meso_add_tube(m, PILE, object, points, STEPS, SIDES, NULL, aside);
  /* The cut end is closed by a small cap. */
  tube_point cap[2] = {points[STEPS - 1], points[STEPS - 1]};
  cap[1].center.z += 0.2f * STRAND;
  cap[1].radius = 0.0f;
  meso_add_tube(m, PILE, object, cap, 2, SIDES, NULL, vec3_make(1.0f, 0.0f, 0.0f));
}

static btf_status build(mesostructure *m) {
  uint32_t random = sampling_hash((uint32_t)m->seed, 77u);
  for (uint32_t row = 0; row < TUFTS; ++row)
    for (uint32_t column = 0; column < TUFTS; ++column) {
      const float x = ((float)column + 0.5f + 0.25f * (draw(&random) - 0.5f)) / TUFTS;
      const float y = ((float)row + 0.5f + 0.25f * (draw(&random) - 0.5f)) / TUFTS;
      for (uint32_t i = 0; i < STRANDS; ++i)
        add_strand(m, x, y, (row * TUFTS + column) * STRANDS + i, &random);
    }
  meso_add_plane(m, BACKING, 0.0f);
  return BTF_OK;
}

static void shade(surface_hit *hit, surface_brdf *out) {
  static const float palette[4][3] = {
      {0.66f, 0.54f, 0.38f}, {0.60f, 0.46f, 0.30f}, {0.72f, 0.62f, 0.47f}, {0.20f, 0.27f, 0.36f}};
  const uint32_t tuft = sampling_mix(hit->object / STRANDS + 5u);
  const float *colour = palette[tuft % 9u < 2u ? 3u : tuft % 3u];
  const float tone = 0.78f + 0.3f * sampling_unit(sampling_mix(hit->object));
  for (int c = 0; c < 3; ++c) {
    out->diffuse[c] = hit->part == PILE ? colour[c] * tone * (0.7f + 0.3f * hit->s) : 0.06f;
    out->f0[c] = 0.05f;
  }
  out->gloss = hit->part == PILE ? 0.8f : 0.0f;
  out->alpha = 0.45f;
}

const synth_material synth_carpet = {
    .name = "carpet",
    .summary = "stand-in for a cut-pile carpet: tufts of bent strands, two tones",
    .tile_mm = 30.0,
    .build = build,
    .shade = shade,
};
