/* SPDX-License-Identifier: MIT */
/* geometry.c: everything of a factorisation that depends on the directions alone. */
#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

#include "factor.h"

/* A direction of a domain, taken once for all cells that it is in. */
typedef struct sample {
  float direction[3];
  bool exists; /* a direction of the data, or a texel of the hemisphere */
  double solid_angle;
} sample;

typedef struct making {
  const btf_host *host;
  btf_context *ctx;
  btfi_cmf_geometry *g;
  const btf_dirset *lights, *views;
  uint64_t budget, planned; /* planned: bytes of all tables but those of means */
  const btf_job *job;
  double from, to;    /* of the stage at work */
  sample *samples[2]; /* of its sides */
} making;

/* Reports that `row` of `rows` is next, in the part of the stage between two shares of it. */
static btf_status report_row(const making *m, uint32_t row, uint32_t rows, double begin, double end) {
  const double share = begin + (end - begin) * row / rows;
  return m->host->progress(m->job, m->from + (m->to - m->from) * share, "preparing");
}

static void *table(making *m, uint64_t count, uint64_t size) {
  m->g->bytes += count * size;
  return m->host->alloc(m->ctx, count, size);
}

static const float *direction_of(const making *m, const btf_dirset *set, uint32_t i) {
  return m->host->dirset_directions(set) + 3 * (size_t)i;
}

static btf_status list_samples(making *m, const btfi_cmf_domain *domain, sample **out) {
  *out = m->host->alloc(m->ctx, domain->count, sizeof **out);
  if (*out == NULL) return BTF_E_NOMEM;
  for (uint32_t i = 0; i < domain->count; i++) {
    sample *s = &(*out)[i];
    s->exists = true;
    s->solid_angle = 1.0;
    if (domain->native) {
      memcpy(s->direction, direction_of(m, domain->set, i), sizeof s->direction);
    } else {
      s->exists = btfi_cmf_map_direction(&domain->map, i, s->direction);
      s->solid_angle = btfi_cmf_map_solid_angle(&domain->map, i);
    }
  }
  return BTF_OK;
}

static void make_domain(making *m, uint32_t projection, btfi_cmf_domain *domain) {
  domain->native = projection == CMF_LIGHT || projection == CMF_VIEW;
  if (domain->native) {
    domain->set = projection == CMF_LIGHT ? m->lights : m->views;
    domain->count = m->host->dirset_count(domain->set);
  } else {
    domain->map = btfi_cmf_map_of(m->g->settings.grid, m->g->settings.resolution);
    domain->count = btfi_cmf_map_texels(&domain->map);
  }
}

/* ---- from samples to maps and from maps to pairs ---- */

/* Interpolation of a domain at a direction, as taps into its samples. */
static void locate(const making *m, const btfi_cmf_domain *domain, const float direction[3],
                   btfi_cmf_tap *tap) {
  if (!domain->native) {
    btfi_cmf_map_locate(&domain->map, direction, tap);
    return;
  }
  btf_interp at;
  m->host->dirset_locate(domain->set, direction, &at);
  for (int i = 0; i < 3; i++) {
    tap->index[i] = at.index[i];
    tap->weight[i] = at.weight[i];
  }
  tap->index[3] = 0;
  tap->weight[3] = 0.0f;
}

static btf_status make_to_map(making *m, btfi_cmf_side *side) {
  const btfi_cmf_map map = btfi_cmf_map_of(m->g->settings.map, m->g->settings.edge);
  side->to_map = table(m, m->g->map_texels, sizeof *side->to_map);
  if (side->to_map == NULL) return BTF_E_NOMEM;
  for (uint32_t i = 0; i < m->g->map_texels; i++) {
    float direction[3];
    (void)btfi_cmf_map_direction(&map, i, direction);
    locate(m, &side->domain, direction, &side->to_map[i]);
  }
  return BTF_OK;
}

/* Where light l and view v fall into the map of one side of a stage. */
static void tap_pair(const making *m, const btfi_cmf_pair *pair, uint32_t which, const float *l,
                     const float *v, btfi_cmf_tap *tap) {
  const btfi_cmf_map map = btfi_cmf_map_of(m->g->settings.map, m->g->settings.edge);
  float projected[2][3];
  pair->project(l, v, projected[0], projected[1]);
  btfi_cmf_map_locate(&map, projected[which], tap);
}

static btf_status make_at(making *m, const btfi_cmf_pair *pair, uint32_t which, btfi_cmf_side *side) {
  const uint32_t projection = pair->projection[which];
  side->at_kind = projection == CMF_LIGHT ? CMF_AT_LIGHT : projection == CMF_VIEW ? CMF_AT_VIEW : CMF_AT_PAIR;
  const uint32_t lights = side->at_kind == CMF_AT_VIEW ? 1 : m->g->lights;
  const uint32_t views = side->at_kind == CMF_AT_LIGHT ? 1 : m->g->views;
  side->at = table(m, (uint64_t)lights * views, sizeof *side->at);
  side->texel_share = table(m, m->g->map_texels, sizeof *side->texel_share);
  if (side->at == NULL || side->texel_share == NULL) return BTF_E_NOMEM;
  memset(side->texel_share, 0, m->g->map_texels * sizeof *side->texel_share);
  for (uint32_t v = 0; v < views; v++)
    for (uint32_t l = 0; l < lights; l++) {
      btfi_cmf_tap *tap = &side->at[(size_t)v * lights + l];
      tap_pair(m, pair, which, direction_of(m, m->lights, l), direction_of(m, m->views, v), tap);
      for (int i = 0; i < 4; i++) side->texel_share[tap->index[i]] += tap->weight[i];
    }
  for (uint32_t i = 0; i < m->g->map_texels; i++)
    side->texel_share[i] = side->texel_share[i] > 1e-6f ? 1.0f / side->texel_share[i] : 0.0f;
  return BTF_OK;
}

/* ---- resampled matrices ---- */

/* The pairs of the data around a cell; false if it has no valid pair. */
static bool make_cell(const making *m, const btfi_cmf_stage_geometry *s, uint32_t row, uint32_t column,
                      btfi_cmf_cell *cell, float *weight) {
  const sample *first = &m->samples[0][row], *second = &m->samples[1][column];
  float light[3], view[3];
  btf_interp at_light, at_view;
  memset(cell, 0, sizeof *cell);
  *weight = 0.0f;
  if (!first->exists || !second->exists) return false;
  if (!s->stage.pair->invert(first->direction, second->direction, light, view)) return false;
  m->host->dirset_locate(m->lights, light, &at_light);
  m->host->dirset_locate(m->views, view, &at_view);
  memcpy(cell->light, at_light.index, sizeof cell->light);
  memcpy(cell->light_weight, at_light.weight, sizeof cell->light_weight);
  memcpy(cell->view, at_view.index, sizeof cell->view);
  memcpy(cell->view_weight, at_view.weight, sizeof cell->view_weight);
  /* Solid angles of light and view that the cell stands for: dl dv = 4 <l, h> dh dd, and dv = 4 <l, h> dh. */
  double measure = first->solid_angle * second->solid_angle;
  if (!(s->side[0].domain.native && s->side[1].domain.native)) {
    float half[3];
    btfi_cmf_half(light, view, half);
    measure *= 4.0 * ((double)light[0] * (double)half[0] + (double)light[1] * (double)half[1] +
                      (double)light[2] * (double)half[2]);
  }
  *weight = (float)measure;
  return *weight > 0.0f;
}

/* Weight of a cell in sums: the paper gives every cell the same, and those without a valid pair a value of 0.
 */
static float weight_of(const making *m, uint32_t row, uint32_t column, bool valid, float weight) {
  if (m->g->settings.average == CMF_VALID) return valid ? weight : 0.0f;
  return m->samples[0][row].exists && m->samples[1][column].exists ? 1.0f : 0.0f;
}

/* Rows or columns that no weight reaches copy the nearest one that is. */
static btf_status make_sources(making *m, btfi_cmf_side *side, const unsigned char *known) {
  const btfi_cmf_domain *domain = &side->domain;
  side->source = table(m, domain->count, sizeof *side->source);
  if (side->source == NULL) return BTF_E_NOMEM;
  if (!domain->native && btfi_cmf_map_sources(&domain->map, known, side->source)) return BTF_OK;
  for (uint32_t i = 0; i < domain->count; i++) {
    float best = -2.0f;
    side->source[i] = i;
    for (uint32_t j = 0; j < domain->count && domain->native && !known[i]; j++) {
      const float *a = direction_of(m, domain->set, i), *b = direction_of(m, domain->set, j);
      const float cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
      if (known[j] && cosine > best) {
        best = cosine;
        side->source[i] = j;
      }
    }
  }
  return BTF_OK;
}

static btf_status make_cells(making *m, btfi_cmf_stage_geometry *s) {
  const uint64_t cells = (uint64_t)s->rows * s->columns;
  uint64_t invalid = 0;
  float largest = 0.0f;
  unsigned char *known = m->host->alloc(m->ctx, (uint64_t)s->rows + s->columns, 1);
  s->cell = table(m, cells, sizeof *s->cell);
  s->cell_weight = table(m, cells, sizeof *s->cell_weight);
  btf_status status = known != NULL && s->cell != NULL && s->cell_weight != NULL ? BTF_OK : BTF_E_NOMEM;
  if (status == BTF_OK) memset(known, 0, (size_t)s->rows + s->columns);
  for (uint32_t row = 0; row < s->rows && status == BTF_OK; row++) {
    status = report_row(m, row, s->rows, 0.0, 1.0);
    for (uint32_t column = 0; column < s->columns && status == BTF_OK; column++) {
      const size_t i = (size_t)row * s->columns + column;
      float weight;
      const bool valid = make_cell(m, s, row, column, &s->cell[i], &weight);
      s->cell_weight[i] = weight_of(m, row, column, valid, weight);
      largest = fmaxf(largest, s->cell_weight[i]);
      invalid += !valid;
      if (valid) known[row] = known[s->rows + column] = 1;
    }
  }
  for (uint64_t i = 0; i < cells && largest > 0.0f && status == BTF_OK; i++) s->cell_weight[i] /= largest;
  if (status == BTF_OK) {
    m->g->invalid = fmax(m->g->invalid, (double)invalid / (double)cells);
    status = make_sources(m, &s->side[0], known);
  }
  if (status == BTF_OK) status = make_sources(m, &s->side[1], known + s->rows);
  m->host->free(m->ctx, known);
  return status;
}

/* ---- means ---- */

/* Adds the pairs of one cell, times `weight`, to the sums over pairs of a row. */
static void add_cell(const btfi_cmf_cell *cell, uint32_t lights, float weight, double *sum) {
  for (int j = 0; j < 3; j++)
    for (int i = 0; i < 3; i++)
      sum[(size_t)cell->view[j] * lights + cell->light[i]] +=
          (double)weight * (double)cell->view_weight[j] * (double)cell->light_weight[i];
}

/* Weights of the pairs in the mean of a row; false if no pair is valid. */
static bool mean_row(making *m, const btfi_cmf_stage_geometry *s, uint32_t row, double *sum) {
  double total = 0.0;
  bool any = false;
  memset(sum, 0, m->g->pairs * sizeof *sum);
  for (uint32_t column = 0; column < s->columns; column++) {
    btfi_cmf_cell cell;
    float weight;
    const bool valid = make_cell(m, s, row, column, &cell, &weight);
    const float share = weight_of(m, row, column, valid, weight);
    if (valid) add_cell(&cell, m->g->lights, share, sum);
    total += (double)share;
    any = any || valid;
  }
  for (uint32_t p = 0; p < m->g->pairs && any; p++) sum[p] /= total;
  return any;
}

/* Counts the entries of all rows, or with `fill` writes them. */
static btf_status walk_means(making *m, btfi_cmf_stage_geometry *s, double *sum, unsigned char *known,
                             bool fill, uint64_t *entries) {
  *entries = 0;
  for (uint32_t row = 0; row < s->rows; row++) {
    BTF_TRY(report_row(m, row, s->rows, fill ? 0.5 : 0.0, fill ? 1.0 : 0.5));
    known[row] = mean_row(m, s, row, sum);
    if (fill) s->start[row] = (uint32_t)*entries;
    for (uint32_t p = 0; p < m->g->pairs && known[row]; p++) {
      if (sum[p] == 0.0) continue;
      if (fill) {
        s->pair[*entries] = p;
        s->pair_weight[*entries] = (float)sum[p];
      }
      ++*entries;
    }
  }
  if (fill) s->start[s->rows] = (uint32_t)*entries;
  return BTF_OK;
}

static btf_status make_means(making *m, btfi_cmf_stage_geometry *s) {
  uint64_t entries = 0;
  double *sum = m->host->alloc(m->ctx, m->g->pairs, sizeof *sum);
  unsigned char *known = m->host->alloc(m->ctx, s->rows, 1);
  btf_status status = sum != NULL && known != NULL ? BTF_OK : BTF_E_NOMEM;
  if (status == BTF_OK) status = walk_means(m, s, sum, known, false, &entries);
  if (status == BTF_OK && (entries > UINT32_MAX || 8 * entries > m->budget - m->planned))
    status =
        m->host->fail(m->ctx, BTF_E_LIMIT,
                      "cmf: the mean over a projection needs %llu MiB of tables; lower resolution or give "
                      "it that working set",
                      (unsigned long long)((m->planned >> 19) + (entries >> 16)) + 64);
  if (status == BTF_OK) m->planned += 8 * entries;
  if (status == BTF_OK) {
    s->start = table(m, s->rows + 1ull, sizeof *s->start);
    s->pair = table(m, entries, sizeof *s->pair);
    s->pair_weight = table(m, entries, sizeof *s->pair_weight);
    if (s->start == NULL || s->pair == NULL || s->pair_weight == NULL) status = BTF_E_NOMEM;
  }
  if (status == BTF_OK) status = walk_means(m, s, sum, known, true, &entries);
  if (status == BTF_OK) status = make_sources(m, &s->side[0], known);
  m->host->free(m->ctx, sum);
  m->host->free(m->ctx, known);
  return status;
}

/* ---- stages ---- */

static void plan_stage(making *m, uint32_t index) {
  btfi_cmf_stage_geometry *s = &m->g->stage[index];
  s->stage = m->g->settings.stage[index];
  s->sides = s->stage.mean ? 1 : 2;
  for (uint32_t k = 0; k < 2; k++) make_domain(m, s->stage.pair->projection[k], &s->side[k].domain);
  s->rows = s->side[0].domain.count;
  s->columns = s->side[1].domain.count;
  s->native = !s->stage.mean && s->side[0].domain.native && s->side[1].domain.native;
}

/* Whether the stage has resampled tables. */
static bool is_resampled(const making *m, const btfi_cmf_stage_geometry *s) {
  return !s->native && m->g->settings.method != CMF_HOMOMORPHIC;
}

static uint64_t cells_of(const making *m, const btfi_cmf_stage_geometry *s) {
  return is_resampled(m, s) && !s->stage.mean ? (uint64_t)s->rows * s->columns : 0;
}

/* Bytes of the tables of a stage but those of a mean, whose size its making tells. */
static uint64_t stage_bytes(const making *m, const btfi_cmf_stage_geometry *s) {
  uint64_t bytes = cells_of(m, s) * (sizeof(btfi_cmf_cell) + sizeof(float));
  if (is_resampled(m, s)) bytes += ((uint64_t)s->rows + s->columns + 1) * sizeof(uint32_t);
  for (uint32_t k = 0; k < s->sides; k++) {
    const uint32_t projection = s->stage.pair->projection[k];
    const uint64_t at = projection == CMF_LIGHT  ? m->g->lights
                        : projection == CMF_VIEW ? m->g->views
                                                 : m->g->pairs;
    bytes += at * sizeof(btfi_cmf_tap) + m->g->map_texels * (sizeof(btfi_cmf_tap) + sizeof(float));
  }
  return bytes;
}

/* The tables of all stages, and two matrices of four channels of the largest for each thread. */
static btf_status plan_stages(making *m) {
  const uint32_t count = m->g->settings.stage_count;
  uint64_t most = 0;
  for (uint32_t i = 0; i < count; i++) {
    plan_stage(m, i);
    m->planned += stage_bytes(m, &m->g->stage[i]);
    const uint64_t cells = cells_of(m, &m->g->stage[i]);
    if (cells > most) most = cells;
  }
  m->planned += 32 * most * m->host->thread_count(m->ctx);
  if (m->planned <= m->budget) return BTF_OK;
  return m->host->fail(m->ctx, BTF_E_LIMIT,
                       "cmf: tables of %u stages, of up to %llu cells, need a working set of %llu MiB; lower "
                       "the resolution or raise it",
                       count, (unsigned long long)most, (unsigned long long)(m->planned >> 19) + 64);
}

static btf_status make_stage(making *m, uint32_t index) {
  btfi_cmf_stage_geometry *s = &m->g->stage[index];
  for (uint32_t k = 0; k < s->sides; k++) {
    BTF_TRY(make_to_map(m, &s->side[k]));
    BTF_TRY(make_at(m, s->stage.pair, k, &s->side[k]));
  }
  if (!is_resampled(m, s)) return BTF_OK;
  btf_status status = list_samples(m, &s->side[0].domain, &m->samples[0]);
  if (status == BTF_OK) status = list_samples(m, &s->side[1].domain, &m->samples[1]);
  if (status == BTF_OK) status = s->stage.mean ? make_means(m, s) : make_cells(m, s);
  for (int k = 0; k < 2; k++) {
    m->host->free(m->ctx, m->samples[k]);
    m->samples[k] = NULL;
  }
  return status;
}

btf_status btfi_cmf_geometry_create(const btf_host *host, btf_context *ctx, const btfi_cmf_settings *settings,
                                    const btf_dirset *lights, const btf_dirset *views, uint64_t budget,
                                    const btf_job *job, double from, double to, btfi_cmf_geometry **out) {
  making m = {.host = host,
              .ctx = ctx,
              .g = host->alloc(ctx, 1, sizeof *m.g),
              .lights = lights,
              .views = views,
              .budget = budget,
              .job = job};
  btf_status status = BTF_OK;
  *out = NULL;
  if (m.g == NULL) return BTF_E_NOMEM;
  memset(m.g, 0, sizeof *m.g);
  m.g->settings = *settings;
  m.g->lights = host->dirset_count(lights);
  m.g->views = host->dirset_count(views);
  m.g->pairs = m.g->lights * m.g->views;
  m.g->map_texels = settings->edge * settings->edge;
  m.g->factors = btfi_cmf_list_factors(settings, m.g->factor);
  status = plan_stages(&m);
  for (uint32_t i = 0; i < settings->stage_count && status == BTF_OK; i++) {
    m.from = from + (to - from) * i / settings->stage_count;
    m.to = from + (to - from) * (i + 1) / settings->stage_count;
    status = make_stage(&m, i);
  }
  if (status != BTF_OK) {
    btfi_cmf_geometry_free(host, ctx, m.g);
    return status;
  }
  m.g->scratch_bytes = btfi_cmf_scratch_bytes(m.g);
  *out = m.g;
  return BTF_OK;
}

void btfi_cmf_geometry_free(const btf_host *host, btf_context *ctx, btfi_cmf_geometry *geometry) {
  if (geometry == NULL) return;
  for (uint32_t i = 0; i < CMF_MAX_STAGES; i++) {
    btfi_cmf_stage_geometry *s = &geometry->stage[i];
    for (uint32_t k = 0; k < 2; k++) {
      host->free(ctx, s->side[k].source);
      host->free(ctx, s->side[k].to_map);
      host->free(ctx, s->side[k].at);
      host->free(ctx, s->side[k].texel_share);
    }
    host->free(ctx, s->cell);
    host->free(ctx, s->cell_weight);
    host->free(ctx, s->start);
    host->free(ctx, s->pair);
    host->free(ctx, s->pair_weight);
  }
  host->free(ctx, geometry);
}
