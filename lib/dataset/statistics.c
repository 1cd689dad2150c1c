/* SPDX-License-Identifier: MIT */
/* statistics.c: mean ABRDF, energy and peak of a data set in one reading. */
#include "dataset/matrix.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

enum { BINS = BTF_PEAK_BINS, PARTS = 16, BUDGET_OVER_COUNTS = 4, BLOCK_FLOATS = 4 << 20 };

typedef struct statistics_pass {
  const btfi_matrix *matrix;
  const float *block;
  uint64_t items;
  double *sums; /* of each row of B */
  double energy[PARTS];
  uint32_t lanes;      /* each takes its parts one after another */
  uint32_t *counts;    /* BINS for each lane, of the blocks since they were last added up */
  uint64_t *histogram; /* BINS */
} statistics_pass;

/* Takes one of PARTS ranges of the rows of B, so that sums do not depend on who makes them. */
static void take_part(statistics_pass *pass, uint32_t part, uint32_t *counts) {
  const btfi_matrix *m = pass->matrix;
  const uint64_t rows = m->by_image ? pass->items : m->rows, others = m->by_image ? m->texels : pass->items;
  const bool columns = m->layout == BTF_LAYOUT_ITEM_COLUMNS;
  const uint64_t row_step = m->by_image ? m->length : columns ? pass->items : 1;
  const uint64_t other_step = m->by_image || columns ? 1 : m->length;
  const uint64_t first = rows * part / PARTS, last = rows * (part + 1) / PARTS;
  double energy = 0.0;
  for (uint64_t row = first; row < last; row++) {
    const float *value = pass->block + row * row_step;
    double sum = 0.0;
    for (uint64_t i = 0; i < others; i++, value += other_step) {
      sum += *value;
      energy += (double)*value * *value;
      if (*value > 0.0f) counts[btf_peak_bin(*value)]++;
    }
    pass->sums[row] += sum;
  }
  pass->energy[part] += energy;
}

static void take_lane(void *job, uint32_t lane, uint32_t thread) {
  statistics_pass *pass = job;
  (void)thread;
  for (uint32_t part = lane; part < PARTS; part += pass->lanes)
    take_part(pass, part, pass->counts + (uint64_t)lane * BINS);
}

static void add_up_counts(statistics_pass *pass) {
  for (uint32_t lane = 0; lane < pass->lanes; lane++)
    for (uint32_t bin = 0; bin < BINS; bin++)
      pass->histogram[bin] += pass->counts[(uint64_t)lane * BINS + bin];
  memset(pass->counts, 0, (uint64_t)pass->lanes * BINS * sizeof *pass->counts);
}

static btf_status read_all(btfi_matrix *m, const btf_job *job, double from, double to, statistics_pass *pass,
                           float *block, uint64_t block_items) {
  double *const row_sums = pass->sums;
  uint64_t counted = 0;
  for (uint64_t item = 0; item < m->items; item += block_items) {
    pass->items = m->items - item < block_items ? m->items - item : block_items;
    BTFI_TRY(btfi_progress(job, from + (to - from) * (double)item / (double)m->items, "statistics"));
    BTFI_TRY(btfi_matrix_read(m, item, pass->items, block,
                              m->layout == BTF_LAYOUT_ITEM_COLUMNS ? pass->items : m->length));
    pass->sums = m->by_image ? row_sums + item : row_sums;
    if (counted > UINT32_MAX - pass->items * m->length) {
      add_up_counts(pass);
      counted = 0;
    }
    counted += pass->items * m->length;
    BTFI_TRY(btfi_parallel(m->ctx, pass->lanes, take_lane, pass));
  }
  add_up_counts(pass);
  pass->sums = row_sums;
  return BTF_OK;
}

static btf_status measure(btfi_matrix *m, uint64_t max_working_set, float *mean, btf_statistics *out,
                          const btf_job *job, double from, double to) {
  const uint64_t lanes = max_working_set / BUDGET_OVER_COUNTS / (BINS * sizeof(uint32_t));
  const uint64_t most_lanes = BTFI_MIN(btfi_thread_count(m->ctx), (uint32_t)PARTS);
  const uint64_t budget = max_working_set / 4 / sizeof(float);
  const uint64_t block_floats = budget < BLOCK_FLOATS ? budget : BLOCK_FLOATS;
  const uint64_t unit = m->by_image ? m->channels : 1;
  uint64_t block_items = block_floats / m->length / unit * unit;
  statistics_pass pass = {.matrix = m, .lanes = (uint32_t)BTFI_MIN(BTFI_MAX(lanes, 1u), most_lanes)};
  btf_status status = BTF_E_NOMEM;
  if (block_items < unit) block_items = unit;
  if (block_items > m->items) block_items = m->items;
  float *block = btfi_alloc(m->ctx, block_items, m->length * sizeof *block);
  pass.block = block;
  pass.sums = btfi_alloc(m->ctx, m->rows, sizeof *pass.sums);
  pass.counts = btfi_alloc(m->ctx, (uint64_t)pass.lanes * BINS, sizeof *pass.counts);
  pass.histogram = btfi_alloc(m->ctx, BINS, sizeof *pass.histogram);
  if (block != NULL && pass.sums != NULL && pass.counts != NULL && pass.histogram != NULL) {
    memset(pass.sums, 0, m->rows * sizeof *pass.sums);
    memset(pass.counts, 0, (uint64_t)pass.lanes * BINS * sizeof *pass.counts);
    memset(pass.histogram, 0, BINS * sizeof *pass.histogram);
    status = read_all(m, job, from, to, &pass, block, block_items);
  }
  if (status == BTF_OK) {
    out->energy = out->centred_energy = 0.0;
    for (uint32_t part = 0; part < PARTS; part++) out->energy += pass.energy[part];
    out->centred_energy = out->energy;
    for (uint64_t row = 0; row < m->rows; row++) {
      const double average = pass.sums[row] / (double)m->texels;
      out->centred_energy -= average * average * (double)m->texels;
      if (mean != NULL) mean[row] = (float)average;
    }
    out->centred_energy = fmax(0.0, out->centred_energy);
    out->peak = btf_peak_of(pass.histogram, m->rows * m->texels);
  }
  btfi_free(m->ctx, block);
  btfi_free(m->ctx, pass.sums);
  btfi_free(m->ctx, pass.counts);
  btfi_free(m->ctx, pass.histogram);
  return status;
}

btf_status btfi_measure(btf_context *ctx, const btf_dataset *ds, uint64_t max_working_set, float *mean,
                        btf_statistics *out, const btf_job *job, double from, double to) {
  btf_statistics all = {.struct_size = sizeof all};
  btfi_matrix matrix;
  if (max_working_set == 0) max_working_set = (uint64_t)1 << 30;
  BTFI_TRY(btfi_matrix_open(ctx, ds, max_working_set, &matrix));
  const btf_status status = measure(&matrix, max_working_set, mean, &all, job, from, to);
  btfi_matrix_close(&matrix);
  if (status != BTF_OK) return status;
  return btfi_copy_out(ctx, "btf_statistics", out, BTFI_SIZE_TO(btf_statistics, peak), &all, sizeof all);
}
