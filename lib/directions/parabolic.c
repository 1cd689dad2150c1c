/* SPDX-License-Identifier: MIT */
#include "directions/dirset.h"

bool btfi_parabolic_unusual(float x, float y, float z, btfi_parabolic *out) {
  if (!isfinite(x) || !isfinite(y) || !isfinite(z)) return false;
  const double up = z > 0.0f ? z : 0.0;
  const double length = sqrt((double)x * x + (double)y * y + up * up);
  out->px = length > 0.0 ? (float)(x / (length + up)) : 1.0f;
  out->py = length > 0.0 ? (float)(y / (length + up)) : 0.0f;
  return true;
}

void btfi_parabolic_direction(float px, float py, float dir[3]) {
  const double x = px, y = py, r2 = x * x + y * y;
  if (r2 >= 1.0) {
    const double r = sqrt(r2);
    dir[0] = (float)(x / r);
    dir[1] = (float)(y / r);
    dir[2] = 0.0f;
    return;
  }
  dir[0] = (float)(2.0 * x / (1.0 + r2));
  dir[1] = (float)(2.0 * y / (1.0 + r2));
  dir[2] = (float)((1.0 - r2) / (1.0 + r2));
}

void btfi_parabolic_texel(uint32_t size, uint32_t x, uint32_t y, float dir[3]) {
  btfi_parabolic_direction((float)((2.0 * x + 1.0) / size - 1.0), (float)((2.0 * y + 1.0) / size - 1.0), dir);
}

void btfi_dirset_rasterise(const btf_dirset *set, uint32_t size, btf_interp *out) {
  for (uint32_t y = 0; y < size; y++) {
    for (uint32_t x = 0; x < size; x++) {
      float dir[3];
      btfi_parabolic_texel(size, x, y, dir);
      btf_dirset_locate(set, dir, &out[(size_t)y * size + x]);
    }
  }
}
