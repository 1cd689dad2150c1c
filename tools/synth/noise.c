/* SPDX-License-Identifier: MIT */
#include "noise.h"

#include <math.h>

#include "trace/sampling.h"

static float corner(uint32_t ix, uint32_t iy, uint32_t seed, float dx, float dy) {
  const float phi = 6.28318530718f * sampling_unit(sampling_hash(sampling_hash(seed, ix), iy));
  return cosf(phi) * dx + sinf(phi) * dy;
}

static float fade(float t) {
  return t * t * t * (t * (t * 6.0f - 15.0f) + 10.0f);
}

float noise_smooth(float u, float v, uint32_t nu, uint32_t nv, uint32_t seed) {
  const float x = (u - floorf(u)) * (float)nu, y = (v - floorf(v)) * (float)nv;
  const uint32_t x0 = (uint32_t)x % nu, y0 = (uint32_t)y % nv, x1 = (x0 + 1) % nu, y1 = (y0 + 1) % nv;
  const float fx = x - floorf(x), fy = y - floorf(y), tx = fade(fx), ty = fade(fy);
  const float low = noise_mix(corner(x0, y0, seed, fx, fy), corner(x1, y0, seed, fx - 1.0f, fy), tx);
  const float high =
      noise_mix(corner(x0, y1, seed, fx, fy - 1.0f), corner(x1, y1, seed, fx - 1.0f, fy - 1.0f), tx);
  return 1.41421356f * noise_mix(low, high, ty);
}

float noise_octaves(float u, float v, uint32_t nu, uint32_t nv, uint32_t octaves, float gain, uint32_t seed) {
  float sum = 0.0f, amplitude = 1.0f, total = 0.0f;
  for (uint32_t i = 0; i < octaves; ++i) {
    sum += amplitude * noise_smooth(u, v, nu << i, nv << i, sampling_hash(seed, i));
    total += amplitude;
    amplitude *= gain;
  }
  return sum / total;
}

noise_cell noise_cells(float u, float v, uint32_t n, uint32_t seed) {
  const float x = (u - floorf(u)) * (float)n, y = (v - floorf(v)) * (float)n;
  const int cx = (int)x, cy = (int)y;
  noise_cell cell = {8.0f, 8.0f, 0};
  float to[25][2]; /* from here to the feature points of the cells around */
  int own = 0;
  for (int i = 0; i < 25; ++i) {
    const int ox = i % 5 - 2, oy = i / 5 - 2;
    const uint32_t ix = (uint32_t)(cx + ox + 2 * (int)n) % n, iy = (uint32_t)(cy + oy + 2 * (int)n) % n;
    const uint32_t bits = sampling_hash(sampling_hash(seed, ix), iy);
    to[i][0] = (float)(cx + ox) + sampling_unit(bits) - x;
    to[i][1] = (float)(cy + oy) + sampling_unit(sampling_mix(bits + 1)) - y;
    const float distance = sqrtf(to[i][0] * to[i][0] + to[i][1] * to[i][1]);
    if (distance < cell.nearest) {
      cell.nearest = distance;
      cell.id = sampling_mix(bits + 2);
      own = i;
    }
  }
  for (int i = 0; i < 25; ++i) {
    const float ax = to[i][0] - to[own][0], ay = to[i][1] - to[own][1], apart = sqrtf(ax * ax + ay * ay);
    if (i == own || apart < 1e-6f) continue;
    /* Distance to the line half-way between the two points. */
    const float mx = 0.5f * (to[i][0] + to[own][0]), my = 0.5f * (to[i][1] + to[own][1]);
    cell.border = fminf(cell.border, (mx * ax + my * ay) / apart);
  }
  return cell;
}
