/* SPDX-License-Identifier: MIT */
/* lambert.c: constant f = albedo / pi, the material whose answers are known without any computation. */
#include "material.h"

static btf_status prepare(uint32_t width, uint32_t height, uint64_t seed, void **state) {
  (void)width;
  (void)height;
  (void)seed;
  *state = NULL;
  return BTF_OK;
}

static void fill(const void *state, const analytic_block *block, float *dst) {
  static const double albedo[3] = {0.8, 0.5, 0.2};
  (void)state;
  for (uint32_t l = 0; l < block->light_count; ++l)
    for (uint32_t j = 0; j < block->height; ++j)
      for (uint32_t i = 0; i < block->width; ++i)
        for (int c = 0; c < 3; ++c)
          dst[l * block->light_step + j * block->row_step + i * block->texel_step + (size_t)c] =
              (float)(albedo[c] / 3.14159265358979323846);
}

static void end(void *state) {
  (void)state;
}

const synth_material synth_lambert = {
    .name = "lambert",
    .summary = "analytic: constant f = albedo / pi with albedo 0.8, 0.5, 0.2",
    .tile_mm = 10.0,
    .prepare = prepare,
    .fill = fill,
    .end = end,
};
