/* SPDX-License-Identifier: MIT */
/* chain.c: projections, pairs of them, and the text that names a chain of stages. */
#include <string.h>

#include "factor.h"

static void copy(const float *from, float *to) {
  memcpy(to, from, 3 * sizeof *to);
}

/* The mirror image of `direction` about h. */
static bool reflect(const float direction[3], const float h[3], float out[3]) {
  const float along = direction[0] * h[0] + direction[1] * h[1] + direction[2] * h[2];
  for (int i = 0; i < 3; i++) out[i] = 2.0f * along * h[i] - direction[i];
  return along > 0.0f && direction[2] > 0.0f && out[2] > 0.0f;
}

static void project_io(const float light[3], const float view[3], float first[3], float second[3]) {
  copy(light, first);
  copy(view, second);
}

static bool invert_io(const float first[3], const float second[3], float light[3], float view[3]) {
  copy(first, light);
  copy(second, view);
  return light[2] > 0.0f && view[2] > 0.0f;
}

static void project_oi(const float light[3], const float view[3], float first[3], float second[3]) {
  project_io(view, light, first, second);
}

static bool invert_oi(const float first[3], const float second[3], float light[3], float view[3]) {
  return invert_io(second, first, light, view);
}

static void project_ih(const float light[3], const float view[3], float first[3], float second[3]) {
  copy(light, first);
  btfi_cmf_half(light, view, second);
}

static bool invert_ih(const float first[3], const float second[3], float light[3], float view[3]) {
  copy(first, light);
  return reflect(first, second, view);
}

static void project_oh(const float light[3], const float view[3], float first[3], float second[3]) {
  copy(view, first);
  btfi_cmf_half(light, view, second);
}

static bool invert_oh(const float first[3], const float second[3], float light[3], float view[3]) {
  copy(first, view);
  return reflect(first, second, light);
}

static void project_dh(const float light[3], const float view[3], float first[3], float second[3]) {
  btfi_cmf_to_hd(light, view, second, first);
}

static bool invert_dh(const float first[3], const float second[3], float light[3], float view[3]) {
  return btfi_cmf_from_hd(second, first, light, view);
}

static const btfi_cmf_pair pairs[] = {
    {"io", {CMF_LIGHT, CMF_VIEW}, project_io, invert_io},
    {"oi", {CMF_VIEW, CMF_LIGHT}, project_oi, invert_oi},
    {"ih", {CMF_LIGHT, CMF_HALF}, project_ih, invert_ih},
    {"oh", {CMF_VIEW, CMF_HALF}, project_oh, invert_oh},
    {"hd", {CMF_HALF, CMF_DIFFERENCE}, btfi_cmf_to_hd, btfi_cmf_from_hd},
    {"dh", {CMF_DIFFERENCE, CMF_HALF}, project_dh, invert_dh},
};

const btfi_cmf_pair *btfi_cmf_pair_of(const char *name, size_t length) {
  for (size_t i = 0; i < sizeof pairs / sizeof *pairs; i++)
    if (strlen(pairs[i].name) == length && memcmp(pairs[i].name, name, length) == 0) return &pairs[i];
  return NULL;
}

void btfi_cmf_project(uint32_t projection, const float light[3], const float view[3], float out[3]) {
  float half[3];
  switch (projection) {
  case CMF_LIGHT:
    copy(light, out);
    break;
  case CMF_VIEW:
    copy(view, out);
    break;
  case CMF_HALF:
    btfi_cmf_half(light, view, out);
    break;
  default:
    btfi_cmf_to_hd(light, view, half, out);
    break;
  }
}

/* A single letter is the mean over the projection that completes it. */
static bool parse_stage(const char *word, size_t length, btfi_cmf_stage *stage) {
  static const char *const of_single[][2] = {{"i", "io"}, {"o", "oi"}, {"h", "hd"}, {"d", "dh"}};
  stage->mean = length == 1;
  stage->pair = NULL;
  for (size_t i = 0; i < 4 && length == 1; i++)
    if (*of_single[i][0] == *word) stage->pair = btfi_cmf_pair_of(of_single[i][1], 2);
  if (length == 2) stage->pair = btfi_cmf_pair_of(word, length);
  return stage->pair != NULL;
}

const char *btfi_cmf_parse_chain(const char *text, btfi_cmf_settings *settings) {
  settings->stage_count = 0;
  for (;;) {
    const size_t length = strcspn(text, ":,");
    if (settings->stage_count == CMF_MAX_STAGES) return "it has more than 8 stages";
    btfi_cmf_stage *stage = &settings->stage[settings->stage_count++];
    if (!parse_stage(text, length, stage))
      return "stages are io, oi, ih, oh, hd, dh or the means i, o, h, d, with commas between them";
    text += length;
    stage->terms = 1;
    if (*text == ':') {
      if (text[1] < '1' || text[1] > '0' + CMF_MAX_TERMS || (text[2] != ',' && text[2] != '\0'))
        return "a stage takes 1 to 8 terms, as in hd:2";
      stage->terms = (uint32_t)(text[1] - '0');
      text += 2;
    }
    if (stage->mean && stage->terms > 1) return "a mean has one term";
    if (*text == '\0') return NULL;
    text++;
  }
}

uint32_t btfi_cmf_list_factors(const btfi_cmf_settings *settings, btfi_cmf_factor list[CMF_MAX_FACTORS]) {
  uint32_t count = 0;
  for (uint32_t s = 0; s < settings->stage_count; s++) {
    const btfi_cmf_stage *stage = &settings->stage[s];
    for (uint32_t term = 0; term < stage->terms; term++)
      for (uint32_t side = 0; side < (stage->mean ? 1u : 2u); side++)
        list[count++] = (btfi_cmf_factor){s, term, side, stage->pair->projection[side]};
  }
  return count;
}

bool btfi_cmf_is_signed(uint32_t method, uint32_t term) {
  return method == CMF_SVD && term > 0;
}
