/* SPDX-License-Identifier: MIT */
/*
 * bumps.c: an analytic material for big data: no rays, all terms cheap rational forms that the compiler
 * vectorises.
 *
 * Two layers. The upper one is a field of bumps of varying size, colour and gloss, shadowed and masked by a
 * horizon that varies over the texture and the azimuth. It covers the lower one, a tinted ground seen and lit
 * through the gaps: parallax shifts the ground with the view, and the shadow of the bumps with the light. A
 * few bumps glint, a few texels are bright specks, so that some of the data is rare.
 */
#include <stdlib.h>
#include <string.h>

#include "clones.h"
#include "material.h"
#include "noise.h"
#include "trace/sampling.h"

#define BUMP_CELLS 14
#define LAYER_GAP 0.010f /* height of the bumps over the ground, in tiles */
#define STEEPEST 6.0f    /* tangent of the flattest ray that shifts the ground further */
#define CHUNK 64u        /* texels computed together */

enum {
  /* Upper layer. */
  SLOPE_X,
  SLOPE_Y,
  UPRIGHT,
  RED,
  GREEN,
  BLUE,
  GLOSS_R,
  GLOSS_G,
  GLOSS_B,
  ALPHA2,
  /* Its horizon: mean, and leaning along x and y. */
  HORIZON,
  LEAN_X,
  LEAN_Y,
  /* How much of the ground it covers. */
  COVER,
  /* Ground. */
  GROUND_X,
  GROUND_Y,
  GROUND_UPRIGHT,
  GROUND_R,
  GROUND_G,
  GROUND_B,
  GROUND_ALPHA2,
  MAPS
};
#define FIRST_GROUND GROUND_X

typedef struct bumps {
  uint32_t width, height;
  size_t row;        /* floats from row to row: the width and a periodic continuation */
  float *maps[MAPS]; /* into memory */
  float memory[];
} bumps;

static float bump_height(float u, float v, uint32_t seed) {
  const noise_cell cell = noise_cells(u, v, BUMP_CELLS, seed);
  const float size = 0.42f + 0.30f * sampling_unit(cell.id), r = cell.nearest / size;
  const float dome = r < 1.0f ? (1.0f - r * r) * (1.0f - r * r) : 0.0f;
  return 0.015f * dome * (0.7f + 0.6f * sampling_unit(sampling_mix(cell.id))) +
         0.0010f * noise_octaves(u, v, 40, 40, 2, 0.6f, seed + 1);
}

static float ground_height(float u, float v, uint32_t seed) {
  return 0.004f * noise_octaves(u, v, 9, 9, 4, 0.6f, seed + 2);
}

static void set_normal(float *slope_x, float *slope_y, float *upright, float dx, float dy) {
  const float scale = 1.0f / sqrtf(1.0f + dx * dx + dy * dy);
  *slope_x = -dx * scale;
  *slope_y = -dy * scale;
  *upright = scale;
}

static void describe_texel(const bumps *b, size_t i, float u, float v, uint32_t seed) {
  static const float palette[4][3] = {
      {0.52f, 0.20f, 0.07f}, {0.62f, 0.43f, 0.12f}, {0.30f, 0.09f, 0.08f}, {0.48f, 0.40f, 0.30f}};
  const float step = 1.0f / 1024.0f, far = 0.025f;
  float *const *map = b->maps;
  const noise_cell cell = noise_cells(u, v, BUMP_CELLS, seed);
  const float here = bump_height(u, v, seed);
  const float size = 0.42f + 0.30f * sampling_unit(cell.id);
  const float *colour = palette[cell.id % 4u];
  const float tone = (0.8f + 0.4f * sampling_unit(sampling_mix(cell.id + 1))) *
                     (1.0f + 0.25f * noise_octaves(u, v, 60, 60, 2, 0.7f, seed + 3));
  const uint32_t dice = sampling_mix(cell.id + 2) % 1000u;
  float alpha = 0.30f + 0.30f * sampling_unit(sampling_mix(cell.id + 3)), dx, dy;
  float gloss[3] = {0.05f, 0.05f, 0.05f};

  dx = (bump_height(u + step, v, seed) - bump_height(u - step, v, seed)) / (2.0f * step);
  dy = (bump_height(u, v + step, seed) - bump_height(u, v - step, seed)) / (2.0f * step);
  for (int c = 0; c < 3; ++c) map[RED + c][i] = colour[c] * tone;
  if (dice < 25u) {
    /* A metal bump. */
    static const float metal[3] = {0.90f, 0.66f, 0.34f};
    memcpy(gloss, metal, sizeof gloss);
    alpha = 0.24f;
    for (int c = 0; c < 3; ++c) map[RED + c][i] *= 0.05f;
  }
  const uint32_t speck =
      sampling_hash(sampling_hash(seed + 4, (uint32_t)(u * 4096.0f)), (uint32_t)(v * 4096.0f));
  if (speck % 512u == 0u) {
    /* A mica flake, turned anyhow. */
    dx = 1.6f * (sampling_unit(sampling_mix(speck + 1)) - 0.5f);
    dy = 1.6f * (sampling_unit(sampling_mix(speck + 2)) - 0.5f);
    for (int c = 0; c < 3; ++c) gloss[c] = 0.5f;
    alpha = 0.16f;
  }
  set_normal(&map[SLOPE_X][i], &map[SLOPE_Y][i], &map[UPRIGHT][i], dx, dy);
  for (int c = 0; c < 3; ++c) map[GLOSS_R + c][i] = gloss[c];
  map[ALPHA2][i] = alpha * alpha;
  map[HORIZON][i] = 0.30f * noise_step(0.015f, 0.0f, here);
  map[LEAN_X][i] = (bump_height(u + far, v, seed) - bump_height(u - far, v, seed)) / (2.0f * far);
  map[LEAN_Y][i] = (bump_height(u, v + far, seed) - bump_height(u, v - far, seed)) / (2.0f * far);
  map[COVER][i] = 1.0f - noise_step(0.85f * size, 1.05f * size, cell.nearest);

  dx = (ground_height(u + step, v, seed) - ground_height(u - step, v, seed)) / (2.0f * step);
  dy = (ground_height(u, v + step, seed) - ground_height(u, v - step, seed)) / (2.0f * step);
  set_normal(&map[GROUND_X][i], &map[GROUND_Y][i], &map[GROUND_UPRIGHT][i], dx, dy);
  const float stain = noise_octaves(u, v, 7, 7, 3, 0.7f, seed + 5);
  map[GROUND_R][i] = 0.06f + 0.05f * stain;
  map[GROUND_G][i] = 0.15f + 0.06f * stain;
  map[GROUND_B][i] = 0.20f - 0.05f * stain;
  map[GROUND_ALPHA2][i] = 0.06f + 0.04f * stain;
}

static btf_status prepare(uint32_t width, uint32_t height, uint64_t seed, void **state) {
  /* Twice the width: a row read from any shift is one run of memory. */
  const size_t row = 2 * (size_t)width, plane = row * height;
  bumps *b = NULL;
  *state = NULL;
  if (plane <= SIZE_MAX / sizeof(float) / (MAPS + 1)) b = malloc(sizeof *b + MAPS * plane * sizeof(float));
  if (b == NULL) return btf_source_error(BTF_E_NOMEM, "bumps: out of memory");
  b->width = width;
  b->height = height;
  b->row = row;
  for (int m = 0; m < MAPS; ++m) b->maps[m] = b->memory + (size_t)m * plane;
  for (uint32_t y = 0; y < height; ++y) {
    for (uint32_t x = 0; x < width; ++x)
      describe_texel(b, y * row + x, ((float)x + 0.5f) / (float)width, ((float)y + 0.5f) / (float)height,
                     (uint32_t)seed + 503);
    for (int m = 0; m < MAPS; ++m)
      memcpy(b->maps[m] + y * row + width, b->maps[m] + y * row, width * sizeof(float));
  }
  *state = b;
  return BTF_OK;
}

/* A map moved by a fraction of the tile: four rows of memory and their bilinear weights. */
typedef struct shifted_row {
  size_t near_row, far_row; /* offsets into a map */
  float x_weight, y_weight;
} shifted_row;

static shifted_row shift_row(const bumps *b, uint32_t x, uint32_t y, float du, float dv) {
  shifted_row s;
  const float sx = (du - floorf(du)) * (float)b->width, sy = (dv - floorf(dv)) * (float)b->height;
  const uint32_t ix = (uint32_t)sx, iy = (uint32_t)sy, row = (y + iy) % b->height;
  const size_t column = (x + ix) % b->width;
  s.near_row = row * b->row + column;
  s.far_row = (row + 1) % b->height * b->row + column;
  s.x_weight = sx - (float)ix;
  s.y_weight = sy - (float)iy;
  return s;
}

VECTOR_CLONES
static void read_shifted(const float *restrict map, const shifted_row *s, uint32_t n, float *restrict dst) {
  const float *near_row = map + s->near_row, *far_row = map + s->far_row;
  const float wx = s->x_weight, wy = s->y_weight;
  for (uint32_t i = 0; i < n; ++i) {
    const float low = near_row[i] + wx * (near_row[i + 1] - near_row[i]);
    const float high = far_row[i] + wx * (far_row[i + 1] - far_row[i]);
    dst[i] = low + wy * (high - low);
  }
}

/* How much of the beam passes the horizon: a smooth step of the elevation above it. */
static inline float passes(float elevation) {
  const float t = 0.5f + 3.0f * elevation, c = t < 0.0f ? 0.0f : t > 1.0f ? 1.0f : t;
  return c * c * (3.0f - 2.0f * c);
}

/* What stays the same for all lights: the view of the upper layer and the ground below it, for CHUNK texels.
 */
typedef struct chunk {
  float coverage[CHUNK], facing[CHUNK], ground_facing[CHUNK], ground[MAPS - FIRST_GROUND][CHUNK];
  float shade[CHUNK], rgb[3][CHUNK];
} chunk;

VECTOR_CLONES
static void look(const bumps *b, size_t at, uint32_t n, vec3 view, chunk *restrict k) {
  const float *slope_x = b->maps[SLOPE_X] + at, *slope_y = b->maps[SLOPE_Y] + at,
              *upright = b->maps[UPRIGHT] + at;
  const float *horizon = b->maps[HORIZON] + at, *lean_x = b->maps[LEAN_X] + at,
              *lean_y = b->maps[LEAN_Y] + at;
  const float *cover = b->maps[COVER] + at;
  const float level = sqrtf(fmaxf(1.0f - view.z * view.z, 0.0f));
  for (uint32_t i = 0; i < n; ++i) {
    const float facing = slope_x[i] * view.x + slope_y[i] * view.y + upright[i] * view.z;
    const float ground = k->ground[0][i] * view.x + k->ground[1][i] * view.y + k->ground[2][i] * view.z;
    const float above = view.z - horizon[i] * level - (lean_x[i] * view.x + lean_y[i] * view.y);
    k->facing[i] = facing > 0.05f ? facing : 0.05f;
    k->ground_facing[i] = ground > 0.05f ? ground : 0.05f;
    k->coverage[i] = cover[i] * (0.25f + 0.75f * passes(above));
  }
}

VECTOR_CLONES
static void light_up(const bumps *b, size_t at, uint32_t n, vec3 light, vec3 view, chunk *restrict k) {
  const float *slope_x = b->maps[SLOPE_X] + at, *slope_y = b->maps[SLOPE_Y] + at,
              *upright = b->maps[UPRIGHT] + at;
  const float *horizon = b->maps[HORIZON] + at, *lean_x = b->maps[LEAN_X] + at,
              *lean_y = b->maps[LEAN_Y] + at;
  const float *red = b->maps[RED] + at, *green = b->maps[GREEN] + at, *blue = b->maps[BLUE] + at;
  const float *gloss_r = b->maps[GLOSS_R] + at, *gloss_g = b->maps[GLOSS_G] + at,
              *gloss_b = b->maps[GLOSS_B] + at;
  const float *alpha2 = b->maps[ALPHA2] + at;
  const float inverse_pi = 0.318309886f, per_cosine = 1.0f / light.z,
              level = sqrtf(fmaxf(1.0f - light.z * light.z, 0.0f));
  const vec3 half = vec3_normalize(vec3_add(light, view));
  const float between = vec3_dot(half, light), away = 1.0f - between;
  const float rise = away * away * away * away * away;
  for (uint32_t i = 0; i < n; ++i) {
    /* Upper layer. */
    const float c0 = slope_x[i] * light.x + slope_y[i] * light.y + upright[i] * light.z;
    const float c = c0 > 0.0f ? c0 : 0.0f, v = k->facing[i];
    const float nh = slope_x[i] * half.x + slope_y[i] * half.y + upright[i] * half.z;
    const float bracket = nh * nh * (alpha2[i] - 1.0f) + 1.0f;
    const float above = light.z - horizon[i] * level - (lean_x[i] * light.x + lean_y[i] * light.y);
    const float lit = (0.06f + 0.94f * passes(above)) * c * per_cosine * k->coverage[i];
    /* Smith's term without roots: c + v + alpha^2 is close for these roughnesses. */
    const float lobe = inverse_pi * alpha2[i] / (bracket * bracket * (c + v + alpha2[i]) * 2.0f * (v + 0.1f));
    /* Ground. */
    const float g0 = k->ground[0][i] * light.x + k->ground[1][i] * light.y + k->ground[2][i] * light.z;
    const float g = g0 > 0.0f ? g0 : 0.0f, gv = k->ground_facing[i];
    const float gh = k->ground[0][i] * half.x + k->ground[1][i] * half.y + k->ground[2][i] * half.z;
    const float ground_alpha2 = k->ground[6][i], ground_bracket = gh * gh * (ground_alpha2 - 1.0f) + 1.0f;
    const float ground_lobe =
        inverse_pi * ground_alpha2 * (0.04f + 0.96f * rise) /
        (ground_bracket * ground_bracket * (g + gv + ground_alpha2) * 2.0f * (gv + 0.1f));
    const float ground_lit = (1.0f - 0.92f * k->shade[i]) * g * per_cosine * (1.0f - k->coverage[i]);
    k->rgb[0][i] = lit * (red[i] * inverse_pi + lobe * (gloss_r[i] + (1.0f - gloss_r[i]) * rise)) +
                   ground_lit * (k->ground[3][i] * inverse_pi + ground_lobe);
    k->rgb[1][i] = lit * (green[i] * inverse_pi + lobe * (gloss_g[i] + (1.0f - gloss_g[i]) * rise)) +
                   ground_lit * (k->ground[4][i] * inverse_pi + ground_lobe);
    k->rgb[2][i] = lit * (blue[i] * inverse_pi + lobe * (gloss_b[i] + (1.0f - gloss_b[i]) * rise)) +
                   ground_lit * (k->ground[5][i] * inverse_pi + ground_lobe);
  }
}

/* Sideways shift of the ground seen or lit along a direction, in tiles. */
static void parallax(vec3 direction, float *du, float *dv) {
  const float level = sqrtf(fmaxf(1.0f - direction.z * direction.z, 0.0f));
  const float tangent = level > 0.0f ? fminf(1.0f / direction.z, STEEPEST / level) : 0.0f;
  *du = LAYER_GAP * tangent * direction.x;
  *dv = LAYER_GAP * tangent * direction.y;
}

static void fill_run(const bumps *b, const analytic_block *block, uint32_t x, uint32_t y, uint32_t n,
                     float *dst) {
  const vec3 view = vec3_load(block->view);
  const size_t at = y * b->row + x;
  float view_u, view_v;
  chunk k;
  parallax(view, &view_u, &view_v);
  const shifted_row seen = shift_row(b, x, y, -view_u, -view_v);
  for (int m = FIRST_GROUND; m < MAPS; ++m) read_shifted(b->maps[m], &seen, n, k.ground[m - FIRST_GROUND]);
  look(b, at, n, view, &k);
  for (uint32_t l = 0; l < block->light_count; ++l) {
    const vec3 light = vec3_load(block->lights + 3 * (size_t)l);
    float light_u, light_v;
    float *sample = dst + l * block->light_step;
    parallax(light, &light_u, &light_v);
    const shifted_row toward_light = shift_row(b, x, y, light_u - view_u, light_v - view_v);
    read_shifted(b->maps[COVER], &toward_light, n, k.shade);
    light_up(b, at, n, light, view, &k);
    for (uint32_t i = 0; i < n; ++i, sample += block->texel_step) {
      sample[0] = k.rgb[0][i];
      sample[1] = k.rgb[1][i];
      sample[2] = k.rgb[2][i];
    }
  }
}

static void fill(const void *state, const analytic_block *block, float *dst) {
  const bumps *b = state;
  for (uint32_t j = 0; j < block->height; ++j)
    for (uint32_t i = 0; i < block->width; i += CHUNK) {
      const uint32_t left = block->width - i, n = left < CHUNK ? left : CHUNK;
      fill_run(b, block, block->x0 + i, block->y0 + j, n, dst + j * block->row_step + i * block->texel_step);
    }
}

const synth_material synth_bumps = {
    .name = "bumps",
    .summary = "analytic: coloured bumps with gloss, masking, shadows and glints over a ground; for big data",
    .tile_mm = 20.0,
    .prepare = prepare,
    .fill = fill,
    .end = free,
};
