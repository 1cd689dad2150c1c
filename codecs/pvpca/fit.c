/* SPDX-License-Identifier: MIT */
/* fit.c: from a data set to the payload, view by view. */
#include "pvpca.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>

enum { SMALLEST_BLOCK = 64 /* texels; fewer would read the data in crumbs */ };

/* ---- what is asked for ---- */

static btf_status describe(btfi_pvpca_fit_job *f, const btf_options *options) {
  const btf_host *host = f->host;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btfi_pvpca_layout *layout = &f->layout;
  uint64_t samples, all;
  BTF_TRY(host->dataset_describe(f->ds, &desc));
  layout->views = host->dirset_count(desc.views);
  layout->lights = host->dirset_count(desc.lights);
  layout->channels = desc.channels;
  layout->width = desc.width;
  layout->height = desc.height;
  layout->storage = (uint32_t)host->option(options, "storage");
  layout->color = (uint32_t)host->option(options, "color");
  layout->has_mean = host->option(options, "mean") != 0.0;
  const uint32_t all_levels = host->mip_count(desc.width, desc.height);
  layout->levels = (uint32_t)host->option(options, "levels");
  if (layout->levels == 0 || layout->levels > all_levels) layout->levels = all_levels;
  f->components = (uint32_t)host->option(options, "components");
  f->most_terms = (uint32_t)host->option(options, "max_components");
  f->budget = (uint32_t)host->option(options, "budget");
  f->want_peak = host->option(options, "psnr") > 0.0;
  f->has_target = f->want_peak || host->option(options, "rmse") > 0.0;
  f->two_passes = f->has_target || f->budget == PVPCA_ADAPTIVE;

  const bool by_light = layout->color == PVPCA_COLOR_LIGHTS;
  f->texels = (uint64_t)desc.width * desc.height;
  f->texel_columns = by_light ? 1 : desc.channels;
  f->rows = by_light ? (uint64_t)layout->lights * desc.channels : layout->lights;
  f->columns = f->texels * f->texel_columns;
  f->by_columns = f->columns < f->rows;
  if (__builtin_mul_overflow(f->rows, f->columns, &samples) ||
      __builtin_mul_overflow(samples, layout->views * sizeof(float), &all) || f->rows > UINT32_MAX)
    return host->fail(f->ctx, BTF_E_LIMIT, "pvpca: the data set has more samples than 64 bits can count");
  f->side = (uint32_t)(f->by_columns ? f->columns : f->rows);
  f->keep = !f->two_passes                                   ? f->components
            : f->has_target || f->most_terms > f->components ? f->most_terms
                                                             : f->components;
  if (f->keep > f->side) f->keep = f->side;
  return BTF_OK;
}

/* ---- memory ---- */

static uint64_t texture_values(const btfi_pvpca_fit_job *f) {
  return f->columns * (f->layout.has_mean + f->keep);
}

static uint64_t level_values(const btfi_pvpca_fit_job *f) {
  const uint64_t width = f->layout.width > 1 ? f->layout.width / 2 : 1,
                 height = f->layout.height > 1 ? f->layout.height / 2 : 1;
  return f->layout.levels > 1 ? width * height * f->texel_columns * (f->layout.has_mean + f->keep) : 0;
}

/* Everything but the block: the Gram matrix thrice more inside of the host's routines, tables of a view, and
 * what is kept of all views. */
static double fixed_bytes(const btfi_pvpca_fit_job *f) {
  const double side = f->side, views = f->layout.views, held = f->two_passes ? views : 1;
  return side * side * (8 + 4 + 16 + (f->by_columns ? 4 : 0)) + 4.0 * side * f->keep * held +
         4.0 * ((double)texture_values(f) + (double)level_values(f) + (double)f->columns) +
         4.0 * (double)f->rows * f->keep + views * f->keep * 2.0 * sizeof(btfi_pvpca_candidate) +
         views * (sizeof(btfi_pvpca_view) + 16.0) +
         (f->want_peak ? BTF_PEAK_BINS * (8.0 + 4.0 * f->host->thread_count(f->ctx)) : 0.0);
}

static btf_status choose_block(btfi_pvpca_fit_job *f) {
  const double texel_bytes = 4.0 * (double)f->rows * f->texel_columns, fixed = fixed_bytes(f);
  const double budget = (double)f->job->max_working_set;
  const uint64_t least = f->by_columns || f->texels < SMALLEST_BLOCK ? f->texels : SMALLEST_BLOCK;
  const double needed = fixed + texel_bytes * (double)least;
  if (needed > budget)
    return f->host->fail(f->ctx, BTF_E_LIMIT,
                         "pvpca: a working set of %.0f MiB is too small for this data set; %.0f MiB would do",
                         budget / 1048576.0, ceil(needed / 1048576.0));
  const double texels = (budget - fixed) / texel_bytes;
  f->block_texels = texels < (double)f->texels ? (uint64_t)texels : f->texels;
  if (f->block_texels < f->texels && f->block_texels > f->layout.width)
    f->block_texels -= f->block_texels % f->layout.width;
  return BTF_OK;
}

static void *make(const btfi_pvpca_fit_job *f, uint64_t count, uint64_t size, btf_status *status) {
  void *made = *status == BTF_OK ? f->host->alloc(f->ctx, count > 0 ? count : 1, size) : NULL;
  if (made == NULL) *status = BTF_E_NOMEM;
  return made;
}

static btf_status make_buffers(btfi_pvpca_fit_job *f) {
  const uint64_t views = f->layout.views, squares = (uint64_t)f->side * f->side;
  const uint32_t threads = f->host->thread_count(f->ctx);
  btf_status status = BTF_OK;
  f->block = make(f, f->block_texels * f->texel_columns * f->rows, sizeof *f->block, &status);
  f->gram = make(f, squares, sizeof *f->gram, &status);
  f->eigenvalues = make(f, f->side, sizeof *f->eigenvalues, &status);
  if (f->by_columns) f->gram_part = make(f, squares, sizeof *f->gram_part, &status);
  f->vectors = make(f, (f->two_passes ? views : 1) * f->side * f->keep, sizeof *f->vectors, &status);
  f->means = make(f, f->columns, sizeof *f->means, &status);
  f->textures = make(f, texture_values(f), sizeof *f->textures, &status);
  f->weights = make(f, f->rows * f->keep, sizeof *f->weights, &status);
  f->level = make(f, level_values(f), sizeof *f->level, &status);
  f->part_sums = make(f, 2 * (uint64_t)PVPCA_PARTS * (1 + f->keep), sizeof *f->part_sums, &status);
  f->centred = make(f, 2 * views, sizeof *f->centred, &status);
  f->candidates = make(f, views * f->keep, sizeof *f->candidates, &status);
  f->view = make(f, views, sizeof *f->view, &status);
  if (f->want_peak) {
    f->counts = make(f, (uint64_t)threads * BTF_PEAK_BINS, sizeof *f->counts, &status);
    f->histogram = make(f, BTF_PEAK_BINS, sizeof *f->histogram, &status);
  }
  if (status != BTF_OK) return status;
  memset(f->centred, 0, 2 * views * sizeof *f->centred);
  f->mean_error = f->centred + views;
  memset(f->view, 0, views * sizeof *f->view);
  if (f->want_peak) {
    memset(f->counts, 0, (size_t)threads * BTF_PEAK_BINS * sizeof *f->counts);
    memset(f->histogram, 0, BTF_PEAK_BINS * sizeof *f->histogram);
  }
  return BTF_OK;
}

static void free_buffers(btfi_pvpca_fit_job *f) {
  void *const buffers[] = {f->block,   f->gram,       f->eigenvalues, f->gram_part, f->vectors,
                           f->means,   f->textures,   f->weights,     f->level,     f->part_sums,
                           f->centred, f->candidates, f->view,        f->counts,    f->histogram};
  for (size_t i = 0; i < sizeof buffers / sizeof *buffers; i++) f->host->free(f->ctx, buffers[i]);
}

/* ---- passes ---- */

/* A number of terms that does not depend on the data: each view is read once if it fits the budget. */
static btf_status fit_in_one_pass(btfi_pvpca_fit_job *f) {
  const bool in_block = f->block_texels == f->texels;
  for (uint32_t v = 0; v < f->layout.views; v++) f->view[v].terms = f->keep;
  BTF_TRY(btfi_pvpca_reserve(f));
  f->step = 0.99 / f->layout.views;
  for (uint32_t v = 0; v < f->layout.views; v++) {
    f->done = f->step * v;
    BTF_TRY(btfi_pvpca_analyse(f, v, f->vectors));
    BTF_TRY(btfi_pvpca_project(f, v, f->vectors, f->keep, in_block));
    BTF_TRY(btfi_pvpca_measure(f, v, f->keep));
    BTF_TRY(btfi_pvpca_write_view(f, v));
  }
  return BTF_OK;
}

/* Eigenvectors of all views, then the choice of terms, then the eigen-textures. */
static btf_status fit_in_two_passes(btfi_pvpca_fit_job *f, const btf_options *options) {
  const bool in_block = f->block_texels == f->texels;
  const uint64_t one_view = (uint64_t)f->side * f->keep;
  const double samples = (double)f->layout.views * (double)f->rows * (double)f->columns;
  f->step = 0.6 / f->layout.views;
  for (uint32_t v = 0; v < f->layout.views; v++) {
    float *vectors = f->vectors + v * one_view;
    f->done = f->step * v;
    BTF_TRY(btfi_pvpca_analyse(f, v, vectors));
    for (uint32_t j = 0; j < f->keep; j++)
      f->candidates[(size_t)v * f->keep + j] =
          (btfi_pvpca_candidate){fmax(0.0, f->eigenvalues[j]), 0.0, v, j};
    if (!f->has_target) continue;
    BTF_TRY(btfi_pvpca_project(f, v, vectors, f->keep, in_block));
    BTF_TRY(btfi_pvpca_measure(f, v, f->keep));
  }
  if (f->has_target) {
    const double psnr = f->host->option(options, "psnr"), rmse = f->host->option(options, "rmse");
    f->target = rmse > 0.0 ? rmse * rmse * samples : INFINITY;
    const double of_psnr = psnr > 0.0 ? pow(btf_peak_of(f->histogram, (uint64_t)samples), 2.0) *
                                            pow(10.0, -psnr / 10.0) * samples
                                      : INFINITY;
    if (of_psnr < f->target) {
      f->target = of_psnr;
      f->target_psnr = psnr;
    }
  }
  BTF_TRY(btfi_pvpca_choose(f));
  BTF_TRY(btfi_pvpca_reserve(f));
  f->step = 0.39 / f->layout.views;
  for (uint32_t v = 0; v < f->layout.views; v++) {
    f->done = 0.6 + f->step * v;
    BTF_TRY(btfi_pvpca_progress(f, 0.0));
    BTF_TRY(btfi_pvpca_project(f, v, f->vectors + v * one_view, f->view[v].terms, false));
    BTF_TRY(btfi_pvpca_measure(f, v, f->view[v].terms));
    BTF_TRY(btfi_pvpca_write_view(f, v));
  }
  return BTF_OK;
}

static btf_status fit_all(btfi_pvpca_fit_job *f, const btf_options *options) {
  BTF_TRY(describe(f, options));
  BTF_TRY(choose_block(f));
  BTF_TRY(make_buffers(f));
  BTF_TRY(f->two_passes ? fit_in_two_passes(f, options) : fit_in_one_pass(f));
  BTF_TRY(btfi_pvpca_write_head(f));
  const double samples = (double)f->layout.views * (double)f->rows * (double)f->columns;
  f->host->log(f->ctx, BTF_LOG_INFO,
               "pvpca: %u components in %u views, predicted rmse %.6g, relative error %.6g", f->layout.terms,
               f->layout.views, sqrt(f->squared_error / samples),
               f->energy > 0.0 ? sqrt(f->squared_error / f->energy) : 0.0);
  return f->host->progress(f->job, 1.0, "views");
}

btf_status btfi_pvpca_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                          const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  btfi_pvpca_fit_job *f = host->alloc(ctx, 1, sizeof *f);
  if (f == NULL) return BTF_E_NOMEM;
  memset(f, 0, sizeof *f);
  f->host = host;
  f->ctx = ctx;
  f->ds = ds;
  f->job = job;
  f->payload = payload;
  f->target = INFINITY;
  const btf_status status = fit_all(f, options);
  free_buffers(f);
  host->free(ctx, f);
  return status;
}
