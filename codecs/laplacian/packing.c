/* SPDX-License-Identifier: MIT */
/* packing.c: the paper's two RGBA textures of 32-bit floats (section 3.3, figure 5), for any number of
 * components: planes that the paper does not have go to the right in the eigen map, and to further layers of
 * the weight map. */
#include "laplacian.h"

#include <btf/btf_half.h>

enum { TEXEL_FLOATS = 4, LAYER_PLANES = 3 };

static uint32_t larger(uint32_t a, uint32_t b) {
  return a > b ? a : b;
}

void btfi_laplacian_packing_of(const btfi_laplacian_head *head, const btfi_laplacian_grid *grid,
                               uint32_t lights, uint32_t views, btfi_laplacian_packing *out) {
  uint32_t column = 0, line = 0;
  *out = (btfi_laplacian_packing){.lights = lights, .views = views, .levels = head->levels, .planes = 1};
  for (uint32_t k = 0; k < head->levels && k < LAPLACIAN_MAX_LEVELS; k++) {
    const uint32_t *count = head->count[k];
    out->luma[k] = (count[LAPLACIAN_Y] + 3) / 4;
    out->chroma[k] = (larger(count[LAPLACIAN_CB], count[LAPLACIAN_CR]) + 1) / 2;
    out->planes = larger(out->planes, out->luma[k] + out->chroma[k]);
    out->column[k] = column;
    out->line[k] = line;
    out->width = larger(out->width, column + 2 * grid->width[k]);
    out->height = larger(out->height, line + 2 * grid->height[k]);
    out->level_width[k] = grid->width[k];
    out->level_height[k] = grid->height[k];
    column += grid->width[k];
    line += grid->height[k];
  }
  out->layers = (out->planes + LAYER_PLANES - 1) / LAYER_PLANES;
}

void btfi_laplacian_component_place(const btfi_laplacian_packing *p, uint32_t level, uint32_t channel,
                                    uint32_t component, uint32_t *plane, uint32_t *part) {
  if (channel == LAPLACIAN_Y) {
    *plane = component / 4;
    *part = component % 4;
  } else {
    *plane = p->luma[level] + component / 2;
    *part = 2 * (channel - 1) + component % 2;
  }
}

uint64_t btfi_laplacian_eigen_place(const btfi_laplacian_packing *p, uint32_t level, uint32_t plane,
                                    uint32_t light, uint32_t view) {
  return ((uint64_t)level * p->views + view) * p->planes * p->lights + (uint64_t)plane * p->lights + light;
}

uint64_t btfi_laplacian_weight_place(const btfi_laplacian_packing *p, uint32_t level, uint32_t plane,
                                     uint32_t x, uint32_t y) {
  const uint32_t quadrant = plane % LAYER_PLANES;
  const uint64_t column = (uint64_t)p->column[level] + x + (quadrant == 1 ? p->level_width[level] : 0);
  const uint64_t line = (uint64_t)p->line[level] + y + (quadrant == 2 ? p->level_height[level] : 0);
  return line * p->width + column;
}

static float table_value(const btfi_laplacian_state *s, const unsigned char *row, uint32_t i) {
  if (s->head.storage == LAPLACIAN_F32) return btf_get_f32(row + 4 * (size_t)i);
  return btf_half_to_float((uint16_t)(row[2 * (size_t)i] | row[2 * (size_t)i + 1] << 8));
}

/* Component `value` of a row of a level, from the tables to part `part` of plane `plane`. */
static void pack_eigen(const btfi_laplacian_state *s, const btfi_laplacian_packing *p, uint32_t level,
                       uint32_t value, uint32_t plane, uint32_t part, float *map) {
  const unsigned char *row = s->eigen;
  for (uint32_t view = 0; view < p->views; view++)
    for (uint32_t light = 0; light < p->lights; light++, row += s->layout.row_bytes)
      map[TEXEL_FLOATS * btfi_laplacian_eigen_place(p, level, plane, light, view) + part] =
          table_value(s, row, s->layout.first[level] + value);
}

static void pack_weights(const btfi_laplacian_state *s, const btfi_laplacian_packing *p, uint32_t level,
                         uint32_t value, float scale, uint32_t plane, uint32_t part, float *map) {
  const unsigned char *row = s->weights[level];
  for (uint32_t y = 0; y < p->level_height[level]; y++)
    for (uint32_t x = 0; x < p->level_width[level]; x++, row += s->layout.texel_bytes[level])
      map[TEXEL_FLOATS * btfi_laplacian_weight_place(p, level, plane, x, y) + part] =
          table_value(s, row, value) * scale;
}

void btfi_laplacian_pack(const btfi_laplacian_state *s, const btfi_laplacian_packing *p, float *eigen_map,
                         float *const *weight_layers) {
  for (uint32_t k = 0; k < p->levels; k++)
    for (uint32_t c = 0, value = 0; c < LAPLACIAN_CHANNELS; c++)
      for (uint32_t j = 0; j < s->head.count[k][c]; j++, value++) {
        const float scale = s->scale[(size_t)c * s->scale_stride + s->layout.first[k] + value];
        uint32_t plane, part;
        btfi_laplacian_component_place(p, k, c, j, &plane, &part);
        pack_eigen(s, p, k, value, plane, part, eigen_map);
        pack_weights(s, p, k, value, scale, plane, part, weight_layers[plane / LAYER_PLANES]);
      }
}
