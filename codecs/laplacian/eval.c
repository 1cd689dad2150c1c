/* SPDX-License-Identifier: MIT */
/* eval.c: equation 7. Eigen-ABRDFs blended over 3 views x 3 lights, weights over 4 texels of each level that
 * counts, one dot product for each channel, the mean of the coarsest level, then RGB. One query and a batch
 * run the same arithmetic in the same order. */
#include "laplacian.h"

#include <math.h>

enum { BATCH = BTF_RUN_DIRECTIONS, SCRATCH = LAPLACIAN_MAX_VALUES + 4 * LAPLACIAN_SLACK };

uint32_t btfi_laplacian_first_level(float lod, uint32_t levels, float *weight) {
  btf_level_pair pair;
  btf_sampling_levels(lod, levels, &pair);
  *weight = pair.weight[0];
  return pair.level[0];
}

uint32_t btfi_laplacian_values_touched(const btfi_laplacian_state *s, float lod) {
  float weight;
  return s->layout.first[s->grid.levels] -
         s->layout.first[btfi_laplacian_first_level(lod, s->grid.levels, &weight)];
}

/* The kernels go on to whole vectors: what they leave behind the last value is of other rows, or nobody's. */
static void clear_slack(const btfi_laplacian_state *s, float *values) {
  memset(values + s->layout.first[s->grid.levels], 0, LAPLACIAN_SLACK * sizeof *values);
}

/* ---- directions ---- */

static void tap_directions(const btfi_laplacian_state *s, const btf_interp *light, const btf_interp *view,
                           btfi_laplacian_rows *rows) {
  const uint64_t row_bytes = s->layout.row_bytes, view_bytes = row_bytes * s->layout.lights;
  uint32_t count = 0;
  for (uint32_t j = 0; j < 3; j++) {
    if (view->weight[j] == 0.0f) continue;
    const unsigned char *of_view = s->eigen + view->index[j] * view_bytes;
    for (uint32_t i = 0; i < 3; i++) {
      rows->row[count] = of_view + light->index[i] * row_bytes;
      rows->weight[count] = view->weight[j] * light->weight[i];
      count += light->weight[i] != 0.0f;
    }
  }
  rows->count = count;
}

static void tap_sample(const btfi_laplacian_state *s, uint32_t light, uint32_t view,
                       btfi_laplacian_rows *rows) {
  rows->row[0] = s->eigen + ((uint64_t)view * s->layout.lights + light) * s->layout.row_bytes;
  rows->weight[0] = 1.0f;
  rows->count = 1;
}

/* Luma of the fitted mean; its chroma is constant. A table of means is among the components. */
static float luma_mean(const btfi_laplacian_state *s, const float light[3], const float view[3]) {
  return s->head.mean == LAPLACIAN_PHONG ? btfi_laplacian_phong_value(&s->head.phong, light, view) : 0.0f;
}

/* ---- texels ---- */

/* Blended eigen-ABRDFs of all levels from the value `at` on, each where it is in a row. */
static void blend_eigen(const btfi_laplacian_state *s, const btfi_laplacian_rows *rows, uint32_t at,
                        float *eigen) {
  btfi_laplacian_rows from_first = *rows;
  for (uint32_t r = 0; r < rows->count; r++) from_first.row[r] += (uint64_t)at * s->layout.value_bytes;
  s->blend(&from_first, s->layout.first[s->grid.levels] - at, eigen + at);
  clear_slack(s, eigen);
}

/* Weights of all levels from `first` on, each where its values are in a row. */
static void blend_weights(const btfi_laplacian_state *s, float u, float v, uint32_t first, float first_weight,
                          float *weights) {
  const btfi_laplacian_grid *grid = &s->grid;
  const double share_x = btfi_laplacian_share(u, grid->wrap), share_y = btfi_laplacian_share(v, grid->wrap);
  uint32_t finest_x[2] = {0, 0}, finest_y[2] = {0, 0};
  float finest_wx[2] = {1.0f, 0.0f}, finest_wy[2] = {1.0f, 0.0f};
  if (grid->filter == LAPLACIAN_PAPER_FILTER) {
    btfi_laplacian_linear(share_x, grid->width[0], grid->wrap, finest_x, finest_wx);
    btfi_laplacian_linear(share_y, grid->height[0], grid->wrap, finest_y, finest_wy);
  }
  for (uint32_t k = first; k < grid->levels; k++) {
    const float level_weight = k == first ? first_weight : 1.0f;
    const uint64_t texel_bytes = s->layout.texel_bytes[k], line_bytes = texel_bytes * grid->width[k];
    uint32_t x[2], y[2];
    float wx[2], wy[2];
    btfi_laplacian_taps(grid, grid->width, k, share_x, finest_x, finest_wx, x, wx);
    btfi_laplacian_taps(grid, grid->height, k, share_y, finest_y, finest_wy, y, wy);
    const unsigned char *const lines[2] = {s->weights[k] + y[0] * line_bytes,
                                           s->weights[k] + y[1] * line_bytes};
    const unsigned char *const row[4] = {lines[0] + x[0] * texel_bytes, lines[0] + x[1] * texel_bytes,
                                         lines[1] + x[0] * texel_bytes, lines[1] + x[1] * texel_bytes};
    wy[0] *= level_weight;
    wy[1] *= level_weight;
    const float weight[4] = {wx[0] * wy[0], wx[1] * wy[0], wx[0] * wy[1], wx[1] * wy[1]};
    s->blend4(row, weight, s->layout.first[k + 1] - s->layout.first[k], weights + s->layout.first[k]);
  }
  clear_slack(s, weights);
}

/* ---- the sum ---- */

static void finish(const btfi_laplacian_state *s, const float *eigen, const float *weights, uint32_t first,
                   float luma, float *out) {
  const uint32_t at = s->layout.first[first], n = s->layout.first[s->grid.levels] - at;
  float ycc[3];
  s->dot(eigen + at, weights + at, s->scale + at, s->scale_stride, n, ycc);
  ycc[0] += luma;
  if (s->head.mean == LAPLACIAN_PHONG) {
    ycc[1] += (float)s->head.chroma[0];
    ycc[2] += (float)s->head.chroma[1];
  }
  btfi_laplacian_to_rgb(ycc[0], ycc[1], ycc[2], out);
}

static void evaluate(const btfi_laplacian_state *s, const btfi_laplacian_rows *rows, float u, float v,
                     uint32_t first, float first_weight, float luma, float *out) {
  _Alignas(64) float eigen[SCRATCH], weights[SCRATCH];
  blend_eigen(s, rows, s->layout.first[first], eigen);
  blend_weights(s, u, v, first, first_weight, weights);
  finish(s, eigen, weights, first, luma, out);
}

/* Position of a texel's centre, whole level and sample directions. */
void btfi_laplacian_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                          uint32_t view, float *out) {
  const btfi_laplacian_state *s = state;
  btfi_laplacian_rows rows;
  tap_sample(s, light, view, &rows);
  evaluate(s, &rows, (float)((x + 0.5) / s->grid.width[level]), (float)((y + 0.5) / s->grid.height[level]),
           level, 1.0f, luma_mean(s, s->light_xyz + 3 * (size_t)light, s->view_xyz + 3 * (size_t)view), out);
}

static float texel_centre(float u, uint32_t size, uint32_t wrap) {
  return (float)((btf_sampling_nearest(u, size, wrap) + 0.5) / size);
}

/* The paper's: nearest samples of the components, the mean at the directions themselves. */
static void evaluate_nearest(const btfi_laplacian_state *s, const float light[3], const float view[3],
                             float u, float v, float lod, float *out) {
  const uint32_t level = btf_sampling_nearest_level(lod, s->grid.levels);
  btfi_laplacian_rows rows;
  tap_sample(s, s->host->dirset_nearest(s->light_set, light), s->host->dirset_nearest(s->view_set, view),
             &rows);
  evaluate(s, &rows, texel_centre(u, s->grid.width[level], s->grid.wrap),
           texel_centre(v, s->grid.height[level], s->grid.wrap), level, 1.0f, luma_mean(s, light, view), out);
}

void btfi_laplacian_eval(const void *state, const btf_query *query, float *out) {
  const btfi_laplacian_state *s = state;
  if (query->flags & BTF_QUERY_NEAREST) {
    evaluate_nearest(s, query->light, query->view, query->uv[0], query->uv[1], query->lod, out);
    return;
  }
  btf_interp light, view;
  btfi_laplacian_rows rows;
  float weight;
  const uint32_t first = btfi_laplacian_first_level(query->lod, s->grid.levels, &weight);
  s->host->dirset_locate(s->light_set, query->light, &light);
  s->host->dirset_locate(s->view_set, query->view, &view);
  tap_directions(s, &light, &view, &rows);
  evaluate(s, &rows, query->uv[0], query->uv[1], first, weight, luma_mean(s, query->light, query->view), out);
}

/* ---- batches ---- */

static void batch_direction(const btf_batch *batch, size_t q, float light[3], float view[3]) {
  for (int k = 0; k < 3; k++) {
    light[k] = batch->light[k][q];
    view[k] = batch->view[k][q];
  }
}

/* Queries first .. first + count - 1, which share what they have in common: blended eigen-ABRDFs of all
 * levels from `kept` on serve every query of the same directions that begins at that level or a coarser one.
 */
static void evaluate_block(const btfi_laplacian_state *s, const btf_batch *batch, size_t begin,
                           uint32_t count, float *const *out) {
  _Alignas(64) float eigen[SCRATCH], weights[SCRATCH];
  btf_interp light[BATCH], view[BATCH];
  uint8_t light_run[BATCH], view_run[BATCH];
  btfi_laplacian_rows rows = {.count = 0};
  uint32_t kept = UINT32_MAX;
  float luma = 0.0f;
  btf_locate_runs(s->host, s->light_set, batch->light, begin, count, light_run, light);
  btf_locate_runs(s->host, s->view_set, batch->view, begin, count, view_run, view);
  for (uint32_t i = 0; i < count; i++) {
    const size_t q = begin + i;
    const bool same = i > 0 && light_run[i] == light_run[i - 1] && view_run[i] == view_run[i - 1];
    float weight, values[3];
    const uint32_t first =
        btfi_laplacian_first_level(batch->lod != NULL ? batch->lod[q] : 0.0f, s->grid.levels, &weight);
    if (!same) {
      float l[3], v[3];
      batch_direction(batch, q, l, v);
      tap_directions(s, &light[light_run[i]], &view[view_run[i]], &rows);
      luma = luma_mean(s, l, v);
      kept = UINT32_MAX;
    }
    if (first < kept) {
      blend_eigen(s, &rows, s->layout.first[first], eigen);
      kept = first;
    }
    blend_weights(s, batch->uv[0][q], batch->uv[1][q], first, weight, weights);
    finish(s, eigen, weights, first, luma, values);
    for (int c = 0; c < 3; c++) out[c][q] = values[c];
  }
}

void btfi_laplacian_eval_n(const void *state, const btf_batch *batch, float *const *out) {
  const btfi_laplacian_state *s = state;
  if (batch->flags & BTF_QUERY_NEAREST) {
    for (size_t q = 0; q < batch->count; q++) {
      float light[3], view[3], values[3];
      batch_direction(batch, q, light, view);
      evaluate_nearest(s, light, view, batch->uv[0][q], batch->uv[1][q],
                       batch->lod != NULL ? batch->lod[q] : 0.0f, values);
      for (int c = 0; c < 3; c++) out[c][q] = values[c];
    }
    return;
  }
  for (size_t q = 0; q < batch->count; q += BATCH) {
    const size_t left = batch->count - q;
    evaluate_block(s, batch, q, left < BATCH ? (uint32_t)left : (uint32_t)BATCH, out);
  }
}
