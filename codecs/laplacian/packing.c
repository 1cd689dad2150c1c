/* SPDX-License-Identifier: MIT */
/* packing.c: the paper's two RGBA textures of 32-bit floats (section 3.3, figure 5). */
#include "laplacian.h"

#include <btf/btf_half.h>

enum { TEXEL_FLOATS = 4, TEXEL_BYTES = 16 };
/* What the three planes hold of each channel. */
static const uint32_t plane_components[3] = {8, 2, 2};

uint64_t btfi_laplacian_eigen_map_bytes(uint32_t lights, uint32_t views, uint32_t levels) {
  return (uint64_t)TEXEL_BYTES * LAPLACIAN_PLANES * lights * views * levels;
}

uint64_t btfi_laplacian_weight_map_bytes(uint32_t width, uint32_t height) {
  return (uint64_t)TEXEL_BYTES * 2 * width * 2 * height;
}

uint64_t btfi_laplacian_eigen_place(uint32_t lights, uint32_t views, uint32_t level, uint32_t plane,
                                    uint32_t light, uint32_t view) {
  return ((uint64_t)level * views + view) * LAPLACIAN_PLANES * lights + (uint64_t)plane * lights + light;
}

uint64_t btfi_laplacian_weight_place(uint32_t width, uint32_t height, uint32_t level, uint32_t plane,
                                     uint32_t x, uint32_t y) {
  uint64_t column = x, line = y;
  for (uint32_t k = 0; k < level; k++) {
    column += btf_sampling_level_size(width, k);
    line += btf_sampling_level_size(height, k);
  }
  if (plane == 1) column += btf_sampling_level_size(width, level);
  if (plane == 2) line += btf_sampling_level_size(height, level);
  return line * 2 * width + column;
}

static float table_value(const btfi_laplacian_state *s, const unsigned char *row, uint32_t i) {
  if (s->head.storage == LAPLACIAN_F32) return btf_get_f32(row + 4 * (size_t)i);
  return btf_half_to_float((uint16_t)(row[2 * (size_t)i] | row[2 * (size_t)i + 1] << 8));
}

/* Place of component j of channel c among the floats of the three planes: Cb1 Cb2 Cr1 Cr2 share the last. */
static void component_place(uint32_t c, uint32_t j, uint32_t *plane, uint32_t *part) {
  *plane = c == LAPLACIAN_Y ? j / 4 : 2;
  *part = c == LAPLACIAN_Y ? j % 4 : 2 * (c - 1) + j;
}

static void pack_component(const btfi_laplacian_state *s, uint32_t k, uint32_t c, uint32_t j, uint32_t value,
                           float *eigen_map, float *weight_map) {
  const uint32_t lights = s->layout.lights, views = s->layout.views, at = s->layout.first[k] + value;
  uint32_t plane, part;
  component_place(c, j, &plane, &part);
  for (uint32_t view = 0; view < views; view++)
    for (uint32_t light = 0; light < lights; light++) {
      const unsigned char *row = s->eigen + ((uint64_t)view * lights + light) * s->layout.row_bytes;
      eigen_map[TEXEL_FLOATS * btfi_laplacian_eigen_place(lights, views, k, plane, light, view) + part] =
          table_value(s, row, at);
    }
  for (uint32_t y = 0; y < s->grid.height[k]; y++)
    for (uint32_t x = 0; x < s->grid.width[k]; x++) {
      const unsigned char *row =
          s->weights[k] + ((uint64_t)y * s->grid.width[k] + x) * s->layout.texel_bytes[k];
      const uint64_t place = btfi_laplacian_weight_place(s->grid.width[0], s->grid.height[0], k, plane, x, y);
      weight_map[TEXEL_FLOATS * place + part] =
          table_value(s, row, value) * s->scale[(size_t)c * s->scale_stride + at];
    }
}

bool btfi_laplacian_pack(const btfi_laplacian_state *s, float *eigen_map, float *weight_map) {
  const uint32_t levels = s->head.levels;
  for (uint32_t k = 0; k < levels; k++)
    for (uint32_t c = 0; c < 3; c++)
      if (s->head.count[k][c] > plane_components[c]) return false;
  memset(eigen_map, 0, btfi_laplacian_eigen_map_bytes(s->layout.lights, s->layout.views, levels));
  memset(weight_map, 0, btfi_laplacian_weight_map_bytes(s->grid.width[0], s->grid.height[0]));
  for (uint32_t k = 0; k < levels; k++)
    for (uint32_t c = 0, value = 0; c < 3; c++)
      for (uint32_t j = 0; j < s->head.count[k][c]; j++, value++)
        pack_component(s, k, c, j, value, eigen_map, weight_map);
  return true;
}
