/* SPDX-License-Identifier: MIT */
/* fit.c: from a data set to the payload. */
#include "fmf.h"

#include <math.h>
#include <string.h>

/* A component below this share of the norm of the data is rounding error. */
#define NEGLIGIBLE 3e-7

typedef struct fitting {
  const btf_host *host;
  btf_context *ctx;
  const btf_job *job;
  btf_chunk_writer *payload;
  btfi_fmf_matrix matrix;
  btfi_fmf_head head;
  uint32_t most_components; /* besides the mean */
  bool want_mean, has_target;
  double loss, accuracy;
  double target; /* squared Frobenius error that must be reached */
  float *mean;
  double mean_norm;
  btfi_fmf_statistics statistics;
  /* Column k of a side at values[side] + k * length[side]; V with its singular value. */
  btfi_fmf_factors factors;
  float *values[2];
  double *sigma;
  double *residual; /* squared error of the first k components at [k], as far as they reach */
  btfi_fmf_plan plan;
} fitting;

static void copy_column(const void *user, uint32_t side, uint32_t k, float *dst) {
  const fitting *f = user;
  memcpy(dst, f->values[side] + k * f->factors.length[side], f->factors.length[side] * sizeof *dst);
}

/* ---- what is asked for ---- */

static btf_status read_options(fitting *f, const btf_options *options) {
  const btf_host *host = f->host;
  const uint32_t all_levels = host->mip_count(f->matrix.width, f->matrix.height);
  const double zstd = host->option(options, "zstd");
  f->has_target = host->option(options, "psnr") > 0.0 || host->option(options, "rmse") > 0.0;
  f->want_mean = host->option(options, "mean") != 0.0;
  f->loss = host->option(options, "loss");
  f->accuracy = host->option(options, "accuracy");
  f->most_components = (uint32_t)host->option(options, f->has_target ? "max_components" : "components");
  if (f->want_mean && f->most_components == FMF_MAX_COMPONENTS) f->most_components--;
  f->head.storage = (uint32_t)host->option(options, "storage");
  f->head.coding = (uint32_t)host->option(options, "coding");
  f->head.levels = (uint32_t)host->option(options, "levels");
  if (f->head.levels == 0 || f->head.levels > all_levels) f->head.levels = all_levels;
  if (zstd != 0.0) host->set_zstd_level(f->payload, (int32_t)zstd);
  return BTF_OK;
}

/* The squared error to reach, from the data's own peak. */
static void set_target(fitting *f, const btf_options *options) {
  const double psnr = f->host->option(options, "psnr"), rmse = f->host->option(options, "rmse");
  const double samples = (double)f->matrix.rows * (double)f->matrix.texels;
  f->target = INFINITY;
  if (rmse > 0.0) f->target = rmse * rmse * samples;
  if (psnr > 0.0)
    f->target = fmin(f->target, pow(f->statistics.peak, 2.0) * pow(10.0, -psnr / 10.0) * samples);
}

/* Squared relative error of rounding both factors, about; it only shifts where the choice of components
 * begins. */
static double storage_floor(uint32_t storage) {
  switch (storage) {
  case FMF_F16:
    return 1e-7;
  case FMF_BF16:
    return 6e-6;
  case FMF_Q8:
    return 1e-6;
  default:
    return 1e-14;
  }
}

static double packing_growth(const fitting *f) {
  return f->head.coding == FMF_PACKED ? (1.0 + f->loss) * (1.0 + f->loss) : 1.0;
}

/* ---- factors ---- */

static btf_status alloc_factors(fitting *f, uint32_t components) {
  f->factors.components = components;
  f->factors.length[FMF_SIDE_U] = f->matrix.rows;
  f->factors.length[FMF_SIDE_V] = f->matrix.texels;
  f->factors.column = copy_column;
  f->factors.user = f;
  for (uint32_t side = 0; side < 2; side++) {
    f->values[side] = f->host->alloc(f->ctx, f->factors.length[side], components * sizeof(float));
    if (f->values[side] == NULL) return BTF_E_NOMEM;
  }
  f->sigma = f->host->alloc(f->ctx, components, sizeof *f->sigma);
  f->residual = f->host->alloc(f->ctx, components + 1ull, sizeof *f->residual);
  return f->sigma != NULL && f->residual != NULL ? BTF_OK : BTF_E_NOMEM;
}

typedef struct transposition {
  const float *src; /* length x stride, row-major */
  float *dst;
  uint64_t length;
  uint32_t columns, stride;
  const double *scale; /* of each column, or NULL */
} transposition;

enum { STRIPE = 1024 };

static void transpose_stripe(void *job, uint32_t stripe, uint32_t thread) {
  const transposition *t = job;
  const uint64_t first = (uint64_t)stripe * STRIPE,
                 last = first + STRIPE < t->length ? first + STRIPE : t->length;
  (void)thread;
  for (uint32_t k = 0; k < t->columns; k++) {
    const double scale = t->scale != NULL ? t->scale[k] : 1.0;
    for (uint64_t i = first; i < last; i++)
      t->dst[k * t->length + i] = (float)(t->src[i * t->stride + k] * scale);
  }
}

/* Takes over the leading triplets that carry more than rounding error, behind the column of the mean. */
static btf_status take_triplets(fitting *f, const btf_svd_result *svd) {
  const uint32_t has_mean = f->mean_norm > 0.0 ? 1 : 0;
  const float *const vectors[2] = {f->matrix.by_image ? svd->item_vectors : svd->element_vectors,
                                   f->matrix.by_image ? svd->element_vectors : svd->item_vectors};
  const double data_norm = sqrt(svd->energy + f->mean_norm * f->mean_norm * (double)f->matrix.texels);
  uint32_t kept = svd->rank;
  while (kept > 0 && svd->sigma[kept - 1] <= NEGLIGIBLE * data_norm) kept--;
  const uint32_t components = kept + has_mean > 0 ? kept + has_mean : 1;
  FMF_TRY(alloc_factors(f, components));
  f->head.energy = data_norm * data_norm;
  if (kept + has_mean == 0) { /* all samples are 0 */
    memset(f->values[0], 0, f->matrix.rows * sizeof(float));
    memset(f->values[1], 0, f->matrix.texels * sizeof(float));
    f->sigma[0] = 1.0;
    f->residual[0] = f->residual[1] = svd->energy;
    return BTF_OK;
  }
  if (has_mean) {
    for (uint64_t i = 0; i < f->matrix.rows; i++)
      f->values[FMF_SIDE_U][i] = (float)(f->mean[i] / f->mean_norm);
    for (uint64_t i = 0; i < f->matrix.texels; i++) f->values[FMF_SIDE_V][i] = (float)f->mean_norm;
    f->sigma[0] = f->mean_norm * sqrt((double)f->matrix.texels);
  }
  for (uint32_t side = 0; side < 2; side++) {
    const uint64_t length = f->factors.length[side];
    transposition t = {vectors[side], f->values[side] + has_mean * length,   length, kept,
                       svd->rank,     side == FMF_SIDE_V ? svd->sigma : NULL};
    FMF_TRY(f->host->parallel(f->ctx, (uint32_t)((length + STRIPE - 1) / STRIPE), transpose_stripe, &t));
  }
  double residual = svd->residual;
  for (uint32_t k = svd->rank; k > kept; k--) residual += svd->sigma[k - 1] * svd->sigma[k - 1];
  for (uint32_t k = components; k > has_mean; k--) {
    f->residual[k] = residual;
    f->sigma[k - 1] = svd->sigma[k - 1 - has_mean];
    residual += f->sigma[k - 1] * f->sigma[k - 1];
  }
  f->residual[has_mean] = residual;
  if (has_mean) f->residual[0] = f->head.energy;
  return BTF_OK;
}

static btf_status factorise(fitting *f, double from, double to) {
  btf_svd_desc desc = {.struct_size = sizeof desc,
                       .items = f->matrix.items,
                       .length = f->matrix.length,
                       .read = btfi_fmf_matrix_read,
                       .user = &f->matrix,
                       .layout = BTF_LAYOUT_ITEM_ROWS,
                       .rank = f->most_components,
                       .tolerance = f->accuracy,
                       .max_working_set = f->job->max_working_set,
                       .seed = f->job->seed,
                       .block_items = f->matrix.block_items};
  btf_svd_result svd = {.struct_size = sizeof svd};
  const uint64_t most = f->matrix.items < f->matrix.length ? f->matrix.items : f->matrix.length;
  if (desc.rank > most) desc.rank = (uint32_t)most;
  if (f->has_target) {
    const double floor = storage_floor(f->head.storage) * f->statistics.energy;
    /* A little more than is needed, so that there is a choice. */
    desc.target_residual = fmax(0.98 * (f->target - floor) / packing_growth(f), 1e-14 * f->statistics.energy);
  }
  FMF_TRY(f->host->svd(f->ctx, &desc, f->job, from, to, &svd));
  const btf_status status = take_triplets(f, &svd);
  f->host->svd_free(f->ctx, &svd);
  return status;
}

/* ---- how many components, and at which steps ---- */

static double tolerated_by_q8(const fitting *f, uint32_t components) {
  return 0.01 * f->residual[components];
}

/* The predicted squared error with the first `components`: truncation, storage and packing. */
static btf_status predict_error(fitting *f, uint32_t components, double *out) {
  btfi_fmf_factors factors = f->factors;
  factors.components = components;
  f->head.tolerated = tolerated_by_q8(f, components);
  FMF_TRY(btfi_fmf_plan_columns(f->host, f->ctx, &factors, f->head.storage, f->head.tolerated, &f->plan));
  *out = (f->residual[components] + f->plan.squared_error) * packing_growth(f);
  return BTF_OK;
}

static btf_status choose_components(fitting *f) {
  const uint32_t available = f->factors.components;
  uint32_t components = available;
  if (f->has_target) {
    const double floor = storage_floor(f->head.storage) * f->head.energy;
    while (components > 1 && f->residual[components - 1] * packing_growth(f) + floor <= f->target)
      components--;
  }
  double error;
  FMF_TRY(predict_error(f, components, &error));
  while (f->has_target && error > f->target && components < available)
    FMF_TRY(predict_error(f, ++components, &error));
  /* The estimate of the storage error may have been too careful. */
  while (f->has_target && error <= f->target && components > 1) {
    double without_last;
    FMF_TRY(predict_error(f, components - 1, &without_last));
    if (without_last > f->target) {
      FMF_TRY(predict_error(f, components, &error));
      break;
    }
    error = without_last;
    components--;
  }
  f->factors.components = components;
  f->head.squared_error = error;
  if (f->has_target && error > f->target) {
    const double samples = (double)f->matrix.rows * (double)f->matrix.texels;
    f->host->log(
        f->ctx, BTF_LOG_WARNING,
        "fmf: %u components reach an rmse of %.6g; %.6g was asked for (more max_components, another storage)",
        components, sqrt(error / samples), sqrt(f->target / samples));
  }
  return BTF_OK;
}

typedef struct step_trial {
  const fitting *f;
  double step;
  double *error; /* squared, of each side and component */
} step_trial;

static void measure_step(void *job, uint32_t index, uint32_t thread) {
  const step_trial *t = job;
  const uint32_t side = index % 2, k = index / 2;
  const uint64_t length = t->f->factors.length[side];
  const float *values = t->f->values[side] + k * length;
  const double factor = (side == FMF_SIDE_U ? t->f->sigma[k] : 1.0) / t->step;
  double error = 0.0;
  (void)thread;
  for (uint64_t i = 0; i < length; i++) {
    const double value = values[i] * factor, left = value - rint(value);
    error += left * left;
  }
  t->error[index] = error * t->step * t->step;
}

/* Squared Frobenius error of rounding U S and V S to multiples of a step. */
static btf_status error_of_step(const fitting *f, double step, double *error, double *out) {
  step_trial trial = {f, step, error};
  *out = 0.0;
  FMF_TRY(f->host->parallel(f->ctx, 2 * f->factors.components, measure_step, &trial));
  for (uint32_t k = 0; k < f->factors.components; k++) {
    const double u = error[2 * k], v = error[2 * k + 1];
    *out += u + v + u * v / (f->sigma[k] * f->sigma[k]);
  }
  return BTF_OK;
}

/* The largest step, within a percent or so, that adds no more than the loss. */
static btf_status choose_step(fitting *f) {
  const double without = f->head.squared_error / packing_growth(f);
  const double budget = fmax(f->head.squared_error - without, 1e-14 * f->head.energy);
  const double values = ((double)f->matrix.rows + (double)f->matrix.texels) * f->factors.components;
  double step = sqrt(12.0 * budget / values), safe = 0.0, error = 0.0;
  double *errors = f->host->alloc(f->ctx, 2 * (uint64_t)f->factors.components, sizeof *errors);
  btf_status status = errors != NULL ? BTF_OK : BTF_E_NOMEM;
  if (budget == 0.0) step = 1.0;
  for (int turn = 0; turn < 12 && status == BTF_OK && budget > 0.0; turn++) {
    status = error_of_step(f, step, errors, &error);
    if (error <= budget) {
      safe = step;
      if (error >= 0.97 * budget || turn >= 3) break;
    }
    step *= error > 0.0 ? fmin(2.0, 0.995 * sqrt(budget / error)) : 2.0;
  }
  f->host->free(f->ctx, errors);
  f->head.step[0] = f->head.step[1] = safe > 0.0 ? safe : step;
  return status;
}

/* ---- payload ---- */

static btf_status write_packed(fitting *f) {
  const btfi_fmf_grid directions = {f->matrix.channels, f->matrix.lights, f->matrix.views};
  const btfi_fmf_grid texels = {1, f->matrix.width, f->matrix.height};
  FMF_TRY(choose_step(f));
  FMF_TRY(btfi_fmf_pack(f->host, f->ctx, &f->factors, FMF_SIDE_U, &directions, f->sigma, f->head.step[0],
                        f->payload, FMF_TAG_PACKED_U));
  return btfi_fmf_pack(f->host, f->ctx, &f->factors, FMF_SIDE_V, &texels, NULL, f->head.step[1], f->payload,
                       FMF_TAG_PACKED_V);
}

static btf_status write_plain(fitting *f) {
  const btf_model_shape shape = {
      .width = f->matrix.width, .height = f->matrix.height, .channels = f->matrix.channels};
  btfi_fmf_layout layout;
  void *u, *chunk, *columns;
  unsigned char *v[FMF_MAX_LEVELS];
  f->head.columns = f->plan.columns;
  if (!btfi_fmf_layout_of(&shape, f->matrix.lights, f->matrix.views, f->head.storage, f->plan.columns,
                          f->head.levels, &layout))
    return f->host->fail(f->ctx, BTF_E_LIMIT, "fmf: the tables would not fit 64 bits");
  FMF_TRY(f->host->reserve(f->payload, FMF_TAG_COLUMNS, 0, 0, (uint64_t)FMF_COLUMN_BYTES * f->plan.columns,
                           &columns));
  btfi_fmf_put_columns(&f->plan, columns);
  FMF_TRY(f->host->reserve(f->payload, FMF_TAG_U, 0, BTF_PAYLOAD_IN_PLACE, layout.u_bytes, &u));
  for (uint32_t level = 0; level < layout.levels; level++) {
    FMF_TRY(
        f->host->reserve(f->payload, FMF_TAG_V, level, BTF_PAYLOAD_IN_PLACE, layout.v_bytes[level], &chunk));
    v[level] = chunk;
  }
  return btfi_fmf_fill_tables(f->host, f->ctx, &f->factors, &f->plan, &layout, u, v);
}

static btf_status write_payload(fitting *f) {
  unsigned char head[FMF_HEAD_BYTES];
  void *sigma;
  FMF_TRY(f->host->reserve(f->payload, FMF_TAG_SIGMA, 0, 0, 8 * (uint64_t)f->factors.components, &sigma));
  btfi_fmf_put_sigma(f->sigma, f->factors.components, sigma);
  f->head.components = f->factors.components;
  FMF_TRY(f->head.coding == FMF_PACKED ? write_packed(f) : write_plain(f));
  if (f->mean_norm > 0.0) f->head.flags |= FMF_FLAG_MEAN;
  btfi_fmf_put_head(&f->head, head);
  return f->host->put(f->payload, FMF_TAG_HEAD, 0, 0, head, sizeof head);
}

static btf_status fit_all(fitting *f, const btf_dataset *ds, const btf_options *options) {
  const btf_host *host = f->host;
  double done = 0.0;
  FMF_TRY(btfi_fmf_matrix_open(host, f->ctx, ds, &f->matrix));
  FMF_TRY(read_options(f, options));
  if (f->want_mean || f->has_target) {
    if (f->want_mean) {
      f->mean = host->alloc(f->ctx, f->matrix.rows, sizeof *f->mean);
      if (f->mean == NULL) return BTF_E_NOMEM;
    }
    done = 0.15;
    FMF_TRY(btfi_fmf_measure(&f->matrix, f->job, 0.0, done, f->mean, &f->statistics));
    for (uint64_t i = 0; i < (f->want_mean ? f->matrix.rows : 0); i++)
      f->mean_norm += (double)f->mean[i] * f->mean[i];
    f->mean_norm = sqrt(f->mean_norm);
    if (f->mean_norm > 0.0) f->matrix.mean = f->mean;
    if (f->has_target) set_target(f, options);
  }
  FMF_TRY(factorise(f, done, 0.9));
  FMF_TRY(host->progress(f->job, 0.9, "storing"));
  FMF_TRY(choose_components(f));
  FMF_TRY(host->progress(f->job, 0.94, "storing"));
  FMF_TRY(write_payload(f));
  host->log(f->ctx, BTF_LOG_INFO, "fmf: %u components, predicted rmse %.6g, relative error %.6g",
            f->head.components,
            sqrt(f->head.squared_error / ((double)f->matrix.rows * (double)f->matrix.texels)),
            f->head.energy > 0.0 ? sqrt(f->head.squared_error / f->head.energy) : 0.0);
  return host->progress(f->job, 1.0, "storing");
}

btf_status btfi_fmf_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                        const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  fitting *f = host->alloc(ctx, 1, sizeof *f);
  if (f == NULL) return BTF_E_NOMEM;
  memset(f, 0, sizeof *f);
  f->host = host;
  f->ctx = ctx;
  f->job = job;
  f->payload = payload;
  f->matrix.host = host;
  f->matrix.ctx = ctx;
  const btf_status status = fit_all(f, ds, options);
  btfi_fmf_matrix_close(&f->matrix);
  for (uint32_t side = 0; side < 2; side++) host->free(ctx, f->values[side]);
  host->free(ctx, f->sigma);
  host->free(ctx, f->residual);
  host->free(ctx, f->mean);
  host->free(ctx, f);
  return status;
}
