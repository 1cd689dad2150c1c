/* SPDX-License-Identifier: MIT */
/* fit.c: from a data set to the payload. */
#include "lpca.h"

#include <math.h>
#include <string.h>

#include <btf/btf_sampling.h>

/* A component below this share of the norm of the data is rounding error. */
#define NEGLIGIBLE 3e-7
/* Of the decomposition above the optimum, relative: it only turns the subspace a little. */
#define SVD_TOLERANCE 0.01
/* Rounds stop when one gains less than this share of the error. */
#define LEAST_GAIN 1e-3
/* Root mean squares of samples for which fourth powers, and sums of them, are floats far from their limits.
 */
#define LEAST_SAMPLE 1e-8
#define LARGEST_SAMPLE 1e7
enum { KMEANS_ROUNDS = 4, GUESS = 8, SMALL_COLUMNS = 4096 };

typedef struct fitting {
  const btf_host *host;
  btf_context *ctx;
  const btf_job *job;
  const btf_dataset *ds;
  const btf_options *options;
  btf_model_shape shape;
  uint32_t lights, views;
  uint64_t rows, texels;
  uint32_t clusters, components, iterations, restarts, subspace; /* components: the most, with a target */
  double target;                                                 /* squared error, or INFINITY */
  double target_psnr;                                            /* what it stands for; 0 = an rmse */
  btf_svd_result svd;
  float *points, *vectors; /* of svd, or their stand-ins if the data are all 0 */
  float *zeros, *center;
  uint32_t *best_label;
  btfi_lpca_model model;
  btfi_lpca_coarse coarse;
  btfi_lpca_writing out;
} fitting;

/* ---- what is asked for ---- */

static btf_status describe(fitting *f) {
  const btf_host *host = f->host;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  uint64_t samples;
  BTF_TRY(host->dataset_describe(f->ds, &desc));
  f->lights = host->dirset_count(desc.lights);
  f->views = host->dirset_count(desc.views);
  f->shape = (btf_model_shape){
      .width = desc.width, .height = desc.height, .channels = desc.channels, .wrap = desc.wrap};
  f->texels = (uint64_t)desc.width * desc.height;
  if (__builtin_mul_overflow((uint64_t)f->views * f->lights, (uint64_t)desc.channels, &f->rows) ||
      __builtin_mul_overflow(f->rows, f->texels, &samples))
    return host->fail(f->ctx, BTF_E_LIMIT, "lpca: the data set has more samples than 64 bits can count");
  if (f->texels > UINT32_MAX)
    return host->fail(f->ctx, BTF_E_LIMIT, "lpca: the data set has more than 4294967295 texels");
  return BTF_OK;
}

/* Bytes of the coefficients, their mip levels and their basis for each dimension of the subspace. */
static uint64_t dimension_bytes(const fitting *f) {
  const uint64_t coarse = btfi_lpca_coarse_texels(f->shape.width, f->shape.height, f->out.layout.levels);
  return sizeof(float) * (f->texels + coarse + f->rows);
}

/* What clustering in a subspace of `size` dimensions holds until the payload is written. */
static uint64_t clustering_bytes(const fitting *f, uint64_t size, uint64_t budget) {
  const btfi_lpca_layout *layout = &f->out.layout;
  const uint64_t coarse = btfi_lpca_coarse_texels(f->shape.width, f->shape.height, layout->levels);
  const uint32_t room = f->clusters + btfi_lpca_coarse_most(f->clusters);
  const uint32_t components = f->components < size ? f->components : (uint32_t)size;
  const btfi_lpca_model model = {.host = f->host,
                                 .ctx = f->ctx,
                                 .count = f->texels,
                                 .size = (uint32_t)size,
                                 .clusters = f->clusters,
                                 .room = room,
                                 .most_components = components};
  /* Labels and weights of all levels, and the best labels of restarts. */
  const uint64_t levels = (f->texels + coarse) * (1 + components) * sizeof(float) + f->texels * sizeof(float);
  return size * sizeof(float) * (f->texels + f->rows) + btfi_lpca_model_bytes(&model, budget) +
         btfi_lpca_coarse_bytes(f->shape.width, f->shape.height, layout->levels, (uint32_t)size) + levels +
         btfi_lpca_write_bytes(f->rows, room, components, (uint32_t)size) + 3 * sizeof(double) * size;
}

/* Names a budget that does. Beside its result, a decomposition holds no more than panels of less than
 * 4 (size + size / 4 + 32) columns and two blocks of 32 vectors along the longer side of the matrix, and
 * small matrices of that many columns. */
static btf_status too_small(const fitting *f, uint64_t size) {
  const uint64_t columns = size + size / 4 + 32, longer = (f->rows > f->texels ? f->rows : f->texels) + 64;
  const uint64_t working =
      sizeof(float) * longer * (4 * columns + 80) + sizeof(double) * columns * (SMALL_COLUMNS + 16 * columns);
  /* A larger budget lets an eighth of it be taken for larger blocks. */
  const uint64_t clustering = clustering_bytes(f, size, 0);
  return f->host->fail(f->ctx, BTF_E_LIMIT,
                       "lpca: a subspace of %llu dimensions needs a working set of %llu MiB",
                       (unsigned long long)size,
                       (unsigned long long)(2 * (clustering > working ? clustering : working) >> 20) + 1);
}

/* Dimensions that the components of clusters cannot do without. */
static uint64_t least_subspace(const fitting *f, uint64_t most) {
  return f->components + 8u < most ? f->components + 8u : most;
}

/* The subspace that is asked for, or of the default one what a quarter of the budget holds and all of it can
 * cluster. */
static btf_status choose_subspace(fitting *f) {
  const btf_host *host = f->host;
  const uint64_t most = f->rows < f->texels ? f->rows : f->texels, budget = f->job->max_working_set;
  uint64_t size = (uint64_t)host->option(f->options, "subspace");
  if (size == 0 || size > most) size = most;
  if (size > LPCA_MAX_SUBSPACE)
    return host->fail(
        f->ctx, BTF_E_LIMIT,
        "lpca: the whole space of this data set has %llu dimensions; set subspace to at most %d",
        (unsigned long long)size, LPCA_MAX_SUBSPACE);
  if (!host->option_is_set(f->options, "subspace")) {
    const uint64_t least = least_subspace(f, size);
    const uint64_t fits = budget / 4 / dimension_bytes(f);
    size = fits < least ? least : fits < size ? fits : size;
    while (size > least && clustering_bytes(f, size, budget) > budget) size--;
  }
  if (clustering_bytes(f, size, budget) > budget) return too_small(f, size);
  f->subspace = (uint32_t)size;
  return BTF_OK;
}

static void read_options(fitting *f) {
  const btf_host *host = f->host;
  const btf_options *options = f->options;
  btfi_lpca_layout *layout = &f->out.layout;
  const uint32_t all_levels = host->mip_count(f->shape.width, f->shape.height);
  const bool has_target = host->option(options, "psnr") > 0.0 || host->option(options, "rmse") > 0.0;
  f->clusters = (uint32_t)host->option(options, "clusters");
  if (f->clusters > f->texels) f->clusters = (uint32_t)f->texels;
  f->components = (uint32_t)host->option(options, has_target ? "max_components" : "components");
  f->iterations = (uint32_t)host->option(options, "iterations");
  f->restarts = (uint32_t)host->option(options, "restarts");
  f->target = has_target ? 0.0 : INFINITY;
  layout->storage = (uint32_t)host->option(options, "storage");
  layout->packing = (uint32_t)host->option(options, "packing");
  layout->levels = (uint32_t)host->option(options, "levels");
  if (layout->levels == 0 || layout->levels > all_levels) layout->levels = all_levels;
}

/* The squared error to reach, from the data's own peak. */
static btf_status set_target(fitting *f, double to) {
  const btf_host *host = f->host;
  const double psnr = host->option(f->options, "psnr"), rmse = host->option(f->options, "rmse");
  const double samples = (double)f->rows * (double)f->texels;
  f->target = rmse > 0.0 ? rmse * rmse * samples : INFINITY;
  if (psnr > 0.0) {
    btf_statistics statistics = {.struct_size = sizeof statistics};
    BTF_TRY(host->measure(f->ctx, f->ds, f->job->max_working_set, NULL, &statistics, f->job, 0.0, to));
    const double of_psnr = statistics.peak * statistics.peak * pow(10.0, -psnr / 10.0) * samples;
    if (of_psnr < f->target) {
      f->target = of_psnr;
      f->target_psnr = psnr;
    }
  }
  return BTF_OK;
}

/* ---- coefficients ---- */

/* Coefficients less their mean, which is kept. */
static btf_status center_points(fitting *f, uint32_t size) {
  double *sum = f->host->alloc(f->ctx, size, sizeof *sum);
  f->center = f->host->alloc(f->ctx, size, sizeof *f->center);
  if (sum == NULL || f->center == NULL) {
    f->host->free(f->ctx, sum);
    return BTF_E_NOMEM;
  }
  memset(sum, 0, size * sizeof *sum);
  for (uint64_t i = 0; i < f->texels; i++) {
    float *point = f->points + i * size;
    for (uint32_t d = 0; d < size; d++) {
      if (f->svd.rank > 0) point[d] = (float)((double)point[d] * f->svd.sigma[d]);
      sum[d] += (double)point[d];
    }
  }
  for (uint32_t d = 0; d < size; d++) f->center[d] = (float)(sum[d] / (double)f->texels);
  for (uint64_t i = 0; i < f->texels; i++)
    for (uint32_t d = 0; d < size; d++) f->points[i * size + d] -= f->center[d];
  f->host->free(f->ctx, sum);
  return BTF_OK;
}

static btf_status find_coefficients(fitting *f, double from, double to) {
  const btf_host *host = f->host;
  const uint64_t budget = f->job->max_working_set;
  const bool may_shrink = !host->option_is_set(f->options, "subspace");
  for (;;) {
    const uint64_t result = f->subspace * sizeof(float) * (f->texels + f->rows);
    const btf_svd_desc desc = {.struct_size = sizeof desc,
                               .rank = f->subspace,
                               .tolerance = SVD_TOLERANCE,
                               .max_working_set = budget - result,
                               .seed = f->job->seed};
    f->svd.struct_size = sizeof f->svd;
    const btf_status status = host->svd_dataset(f->ctx, f->ds, NULL, &desc, f->job, from, to, &f->svd);
    if (status == BTF_OK) break;
    if (status != BTF_E_LIMIT) return status;
    /* Refused before any work: what is beside the result was too little. */
    const uint32_t least = (uint32_t)least_subspace(f, f->subspace);
    if (!may_shrink || f->subspace == least) return too_small(f, f->subspace);
    f->subspace = f->subspace - f->subspace / 4 > least ? f->subspace - f->subspace / 4 : least;
  }
  f->points = f->svd.item_vectors;
  f->vectors = f->svd.element_vectors;
  if (f->svd.rank == 0) {
    const uint64_t count = f->texels > f->rows ? f->texels : f->rows;
    f->zeros = host->alloc(f->ctx, count, sizeof *f->zeros);
    if (f->zeros == NULL) return BTF_E_NOMEM;
    memset(f->zeros, 0, count * sizeof *f->zeros);
    f->points = f->vectors = f->zeros;
  }
  return center_points(f, f->svd.rank > 0 ? f->svd.rank : 1);
}

/* ---- clusters ---- */

/* The best of some starts: k-means, then rounds with the components. */
static btf_status best_start(fitting *f, uint32_t components, double from, double to) {
  btfi_lpca_model *m = &f->model;
  uint64_t random = f->job->seed;
  double least = INFINITY;
  for (uint32_t start = 0; start < f->restarts; start++) {
    const double step = (to - from) / f->restarts, here = from + step * start;
    m->components = 0;
    BTF_TRY(btfi_lpca_seed(m, &random, here, here + 0.2 * step));
    BTF_TRY(btfi_lpca_iterate(m, f->iterations < KMEANS_ROUNDS ? f->iterations : KMEANS_ROUNDS, LEAST_GAIN,
                              NULL, NULL, here + 0.2 * step, here + 0.3 * step));
    m->components = components;
    BTF_TRY(btfi_lpca_iterate(m, f->iterations, LEAST_GAIN, NULL, NULL, here + 0.3 * step, here + step));
    const double cost = btfi_lpca_cost(m);
    if (f->restarts == 1) return BTF_OK;
    if (cost < least) memcpy(f->best_label, m->label, f->texels * sizeof *m->label);
    if (cost < least) least = cost;
  }
  memcpy(m->label, f->best_label, f->texels * sizeof *m->label);
  return btfi_lpca_refit(m);
}

/* Drops clusters without members and, if asked to, components that are rounding error in all clusters. */
static btf_status trim(fitting *f, bool trim_components) {
  btfi_lpca_model *m = &f->model;
  uint32_t used = 0, components = trim_components ? 1 : m->components;
  for (uint32_t k = 0; k < m->clusters; k++) {
    if (m->start[k + 1] == m->start[k]) continue;
    for (uint64_t i = m->start[k]; i < m->start[k + 1]; i++) m->label[m->order[i]] = used;
    used++;
    for (uint32_t j = components; j < m->components; j++)
      if (m->values[(size_t)k * LPCA_MAX_COMPONENTS + j] > NEGLIGIBLE * NEGLIGIBLE * f->svd.energy)
        components = j + 1;
  }
  if (components < f->coarse.components) components = f->coarse.components;
  if (components > m->components) components = m->components;
  if (used == m->clusters && components == m->components) return BTF_OK;
  m->clusters = used;
  m->components = components;
  return btfi_lpca_refit(m);
}

/* Clusters of the finest level, with as many left for the coarser ones as these need. */
static btf_status cluster(fitting *f, uint32_t components, double from, double to) {
  BTF_TRY(best_start(f, components, from, to));
  BTF_TRY(trim(f, false));
  return btfi_lpca_coarse_choose(&f->coarse, &f->model, f->clusters - f->model.clusters, f->iterations, to);
}

static btf_status set_layout(fitting *f) {
  f->out.layout.clusters = f->model.clusters;
  f->out.layout.components = f->model.components;
  if (!btfi_lpca_layout_of(&f->shape, f->lights, f->views, &f->out.layout))
    return f->host->fail(f->ctx, BTF_E_LIMIT, "lpca: the tables of %u clusters would not fit 64 bits",
                         f->model.clusters);
  return BTF_OK;
}

/* Weights of the finest level, and the error of the model less that of storage. */
static btf_status weigh(fitting *f) {
  btfi_lpca_model *m = &f->model;
  btfi_lpca_level *finest = &f->out.level[0];
  if (finest->weights == NULL)
    finest->weights = f->host->alloc(f->ctx, f->texels, f->components * sizeof(float));
  if (finest->weights == NULL) return BTF_E_NOMEM;
  finest->label = m->label;
  BTF_TRY(btfi_lpca_weights(m, m->points, m->count, m->label, finest->weights, m->error));
  f->out.head.squared_error = f->out.head.outside;
  for (uint64_t i = 0; i < m->count; i++) f->out.head.squared_error += (double)m->error[i];
  return set_layout(f);
}

/* The squared error of what would be decoded. */
static btf_status total_error(fitting *f, double *out) {
  BTF_TRY(weigh(f));
  BTF_TRY(btfi_lpca_write(&f->out, false));
  *out = f->out.head.squared_error + f->out.storage_error;
  return BTF_OK;
}

/* The fewest components that reach the target. More components are tried from the clusters of the last ones:
 * the eigenvalues foretell how many it takes. */
static btf_status search_components(fitting *f, double from, double to) {
  btfi_lpca_model *m = &f->model;
  const uint32_t most = f->components;
  uint32_t too_few = 0, enough = most + 1, components = GUESS < most ? (uint32_t)GUESS : most;
  double error = INFINITY;
  BTF_TRY(cluster(f, components, from, from + 0.5 * (to - from)));
  for (uint32_t turn = 0;; turn++) {
    const double here = from + (to - from) * (1.0 - 0.5 * pow(0.7, turn));
    BTF_TRY(total_error(f, &error));
    if (error <= f->target) {
      enough = components;
      memcpy(f->best_label, m->label, f->texels * sizeof *m->label);
    } else {
      too_few = components;
    }
    if (too_few + 1 >= enough || too_few == most) break;
    const double beside = error - btfi_lpca_cost(m);
    components = too_few + 1;
    while (components + 1 < enough && btfi_lpca_cost_with(m, components) + beside > f->target) components++;
    m->components = components;
    BTF_TRY(btfi_lpca_iterate(m, f->iterations, LEAST_GAIN, NULL, NULL, here, here));
  }
  if (enough > most)
    btf_warn_missed(f->host, f->ctx, "lpca", most, "components", error, f->target,
                    (double)f->rows * (double)f->texels, f->target_psnr);
  if (enough > most || m->components == enough) return BTF_OK;
  m->components = enough;
  memcpy(m->label, f->best_label, f->texels * sizeof *m->label);
  return btfi_lpca_refit(m);
}

static btf_status find_clusters(fitting *f, double from, double to) {
  btfi_lpca_model *m = &f->model;
  const uint32_t size = f->svd.rank > 0 ? f->svd.rank : 1;
  if (f->components > size) f->components = size;
  const double typical = sqrt(f->svd.energy / ((double)f->rows * (double)f->texels));
  if (typical > 0.0 && !(typical >= LEAST_SAMPLE && typical <= LARGEST_SAMPLE))
    return f->host->fail(
        f->ctx, BTF_E_NUMERIC,
        "lpca: samples of %g on average are beyond what it computes with, %g to %g; scale them", typical,
        LEAST_SAMPLE, LARGEST_SAMPLE);
  m->points = f->points;
  m->count = f->texels;
  m->size = size;
  m->clusters = f->clusters;
  m->room = f->clusters + btfi_lpca_coarse_most(f->clusters);
  m->most_components = f->components;
  BTF_TRY(btfi_lpca_model_alloc(m, f->job->max_working_set));
  f->best_label = f->host->alloc(f->ctx, f->texels, sizeof *f->best_label);
  if (f->best_label == NULL) return BTF_E_NOMEM;
  BTF_TRY(btfi_lpca_coarse_make(&f->coarse, m, f->shape.width, f->shape.height, f->out.layout.levels));
  f->out.model = m;
  f->out.center = f->center;
  f->out.vectors = f->vectors;
  f->out.head.energy = f->svd.energy;
  f->out.head.outside = f->svd.residual;
  BTF_TRY(isinf(f->target) ? cluster(f, f->components, from, to) : search_components(f, from, to));
  BTF_TRY(trim(f, true));
  return weigh(f);
}

/* ---- levels of detail ---- */

/* A texel of a coarser level is the average of ABRDFs, whose coefficients are the average of theirs. It gets
 * the cluster that reconstructs it best, from the same tables. */
static btf_status find_levels(fitting *f, double at) {
  const btf_host *host = f->host;
  btfi_lpca_model *m = &f->model;
  btfi_lpca_layout *layout = &f->out.layout;
  const float *points = f->coarse.points;
  const uint32_t *label = f->coarse.label;
  BTF_TRY(btfi_lpca_coarse_fit(&f->coarse, m, at));
  BTF_TRY(set_layout(f));
  for (uint32_t level = 1; level < layout->levels; level++) {
    btfi_lpca_level *l = &f->out.level[level];
    const uint64_t texels = (uint64_t)layout->level_width[level] * layout->level_height[level];
    BTF_TRY(host->progress(f->job, at, "levels of detail"));
    l->label = host->alloc(f->ctx, texels, sizeof *l->label);
    l->weights = host->alloc(f->ctx, texels, m->components * sizeof *l->weights);
    if (l->label == NULL || l->weights == NULL) return BTF_E_NOMEM;
    memcpy(l->label, label, texels * sizeof *l->label);
    BTF_TRY(btfi_lpca_weights(m, points, texels, label, l->weights, m->error));
    points += texels * m->size;
    label += texels;
  }
  return BTF_OK;
}

/* ---- all of it ---- */

static btf_status fit_all(fitting *f) {
  const btf_host *host = f->host;
  double done = 0.0;
  BTF_TRY(describe(f));
  read_options(f);
  BTF_TRY(choose_subspace(f));
  if (!isinf(f->target)) {
    done = 0.1;
    BTF_TRY(set_target(f, done));
  }
  BTF_TRY(find_coefficients(f, done, 0.5));
  BTF_TRY(find_clusters(f, 0.5, 0.8));
  const uint64_t budget = f->job->max_working_set, held = clustering_bytes(f, f->model.size, budget);
  BTF_TRY(btfi_lpca_refine(&f->out, &f->model, f->ds, (uint32_t)host->option(f->options, "refine"),
                           held < budget / 2 ? budget / 2 : budget - held, 0.8, 0.9));
  BTF_TRY(find_levels(f, 0.9));
  BTF_TRY(host->progress(f->job, 0.94, "storing"));
  f->out.head.storage = f->out.layout.storage;
  f->out.head.packing = f->out.layout.packing;
  f->out.head.clusters = f->out.layout.clusters;
  f->out.head.components = f->out.layout.components;
  f->out.head.levels = f->out.layout.levels;
  BTF_TRY(btfi_lpca_write(&f->out, true));
  host->log(f->ctx, BTF_LOG_INFO,
            "lpca: %u clusters (%u for coarser levels alone), %u components, %u splits; predicted rmse %.6g, "
            "relative error %.6g; outside of the "
            "subspace of %u: %.6g",
            f->out.head.clusters, f->coarse.clusters, f->out.head.components, f->model.splits,
            sqrt(f->out.head.squared_error / ((double)f->rows * (double)f->texels)),
            f->out.head.energy > 0.0 ? sqrt(f->out.head.squared_error / f->out.head.energy) : 0.0,
            f->svd.rank, f->out.head.energy > 0.0 ? sqrt(f->out.head.outside / f->out.head.energy) : 0.0);
  return host->progress(f->job, 1.0, "storing");
}

btf_status btfi_lpca_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                         const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  fitting *f = host->alloc(ctx, 1, sizeof *f);
  if (f == NULL) return BTF_E_NOMEM;
  memset(f, 0, sizeof *f);
  f->host = host;
  f->ctx = ctx;
  f->job = job;
  f->ds = ds;
  f->options = options;
  f->out.host = f->model.host = host;
  f->out.ctx = f->model.ctx = ctx;
  f->model.job = job;
  f->out.payload = payload;
  const btf_status status = fit_all(f);
  for (uint32_t level = 0; level < LPCA_MAX_LEVELS; level++) {
    if (level > 0) host->free(ctx, f->out.level[level].label);
    host->free(ctx, f->out.level[level].weights);
  }
  host->free(ctx, f->out.refined);
  btfi_lpca_model_free(&f->model);
  if (f->svd.struct_size != 0) host->svd_free(ctx, &f->svd);
  host->free(ctx, f->zeros);
  host->free(ctx, f->center);
  host->free(ctx, f->best_label);
  btfi_lpca_coarse_free(&f->coarse, host, ctx);
  host->free(ctx, f);
  return status;
}
