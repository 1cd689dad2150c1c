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
  const btf_dataset *ds;
  uint64_t rows, texels; /* of B */
  btfi_fmf_writing out;
  uint32_t most_components; /* besides the mean */
  bool want_mean, has_target;
  double accuracy;
  float *mean;
  double mean_norm;
  btf_statistics statistics;
} fitting;

/* ---- what is asked for ---- */

static void read_options(fitting *f, const btf_options *options) {
  const btf_host *host = f->host;
  btfi_fmf_read_storage(&f->out, options);
  f->has_target = host->option(options, "psnr") > 0.0 || host->option(options, "rmse") > 0.0;
  f->want_mean = host->option(options, "mean") != 0.0;
  f->accuracy = host->option(options, "accuracy");
  f->most_components = (uint32_t)host->option(options, f->has_target ? "max_components" : "components");
  if (f->want_mean && f->most_components == FMF_MAX_COMPONENTS) f->most_components--;
}

/* The squared error to reach, from the data's own peak. */
static void set_target(fitting *f, const btf_options *options) {
  const double psnr = f->host->option(options, "psnr"), rmse = f->host->option(options, "rmse");
  const double samples = (double)f->rows * (double)f->texels;
  if (rmse > 0.0) f->out.target = rmse * rmse * samples;
  const double of_psnr = pow(f->statistics.peak, 2.0) * pow(10.0, -psnr / 10.0) * samples;
  if (psnr > 0.0 && of_psnr < f->out.target) {
    f->out.target = of_psnr;
    f->out.target_psnr = psnr;
  }
}

/* ---- factors ---- */

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
  const float *const vectors[2] = {svd->element_vectors, svd->item_vectors};
  const double data_norm = sqrt(svd->energy + f->mean_norm * f->mean_norm * (double)f->texels);
  uint32_t kept = svd->rank;
  while (kept > 0 && svd->sigma[kept - 1] <= NEGLIGIBLE * data_norm) kept--;
  const uint32_t components = kept + has_mean > 0 ? kept + has_mean : 1;
  BTF_TRY(btfi_fmf_writing_alloc(&f->out, components));
  f->out.head.energy = data_norm * data_norm;
  if (kept + has_mean == 0) { /* all samples are 0 */
    memset(f->out.values[0], 0, f->rows * sizeof(float));
    memset(f->out.values[1], 0, f->texels * sizeof(float));
    f->out.sigma[0] = 1.0;
    f->out.residual[0] = f->out.residual[1] = svd->energy;
    return BTF_OK;
  }
  if (has_mean) {
    for (uint64_t i = 0; i < f->rows; i++) f->out.values[FMF_SIDE_U][i] = (float)(f->mean[i] / f->mean_norm);
    for (uint64_t i = 0; i < f->texels; i++) f->out.values[FMF_SIDE_V][i] = (float)f->mean_norm;
    f->out.sigma[0] = f->mean_norm * sqrt((double)f->texels);
  }
  for (uint32_t side = 0; side < 2; side++) {
    const uint64_t length = f->out.factors.length[side];
    transposition t = {vectors[side], f->out.values[side] + has_mean * length, length, kept,
                       svd->rank,     side == FMF_SIDE_V ? svd->sigma : NULL};
    BTF_TRY(f->host->parallel(f->ctx, (uint32_t)((length + STRIPE - 1) / STRIPE), transpose_stripe, &t));
  }
  double residual = svd->residual;
  for (uint32_t k = svd->rank; k > kept; k--) residual += svd->sigma[k - 1] * svd->sigma[k - 1];
  for (uint32_t k = components; k > has_mean; k--) {
    f->out.residual[k] = residual;
    f->out.sigma[k - 1] = svd->sigma[k - 1 - has_mean];
    residual += f->out.sigma[k - 1] * f->out.sigma[k - 1];
  }
  f->out.residual[has_mean] = residual;
  if (has_mean) f->out.residual[0] = f->out.head.energy;
  return BTF_OK;
}

static btf_status factorise(fitting *f, double from, double to) {
  btf_svd_desc desc = {.struct_size = sizeof desc,
                       .rank = f->most_components,
                       .tolerance = f->accuracy,
                       .max_working_set = f->job->max_working_set,
                       .seed = f->job->seed};
  btf_svd_result svd = {.struct_size = sizeof svd};
  if (f->has_target) {
    const double floor = btfi_fmf_storage_floor(f->out.head.storage) * f->statistics.energy;
    /* A little more than is needed, so that there is a choice. */
    desc.target_residual =
        fmax(0.98 * (f->out.target - floor) / btfi_fmf_packing_growth(&f->out), 1e-14 * f->statistics.energy);
  }
  BTF_TRY(f->host->svd_dataset(f->ctx, f->ds, f->mean_norm > 0.0 ? f->mean : NULL, &desc, f->job, from, to,
                               &svd));
  const btf_status status = take_triplets(f, &svd);
  f->host->svd_free(f->ctx, &svd);
  return status;
}

/* Takes over the sizes of the data set. */
static btf_status describe(fitting *f) {
  const btf_host *host = f->host;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  uint64_t samples;
  BTF_TRY(host->dataset_describe(f->ds, &desc));
  f->out.views = host->dirset_count(desc.views);
  f->out.lights = host->dirset_count(desc.lights);
  f->out.channels = desc.channels;
  f->out.width = desc.width;
  f->out.height = desc.height;
  f->texels = (uint64_t)desc.width * desc.height;
  if (__builtin_mul_overflow((uint64_t)f->out.views * f->out.lights, (uint64_t)desc.channels, &f->rows) ||
      __builtin_mul_overflow(f->rows, f->texels, &samples))
    return host->fail(f->ctx, BTF_E_LIMIT, "fmf: the data set has more samples than 64 bits can count");
  return BTF_OK;
}

static btf_status fit_all(fitting *f, const btf_options *options) {
  const btf_host *host = f->host;
  double done = 0.0;
  BTF_TRY(describe(f));
  read_options(f, options);
  if (f->want_mean || f->has_target) {
    if (f->want_mean) {
      f->mean = host->alloc(f->ctx, f->rows, sizeof *f->mean);
      if (f->mean == NULL) return BTF_E_NOMEM;
    }
    done = 0.15;
    f->statistics.struct_size = sizeof f->statistics;
    BTF_TRY(
        host->measure(f->ctx, f->ds, f->job->max_working_set, f->mean, &f->statistics, f->job, 0.0, done));
    for (uint64_t i = 0; i < (f->want_mean ? f->rows : 0); i++)
      f->mean_norm += (double)f->mean[i] * f->mean[i];
    f->mean_norm = sqrt(f->mean_norm);
    if (f->mean_norm > 0.0) {
      f->out.head.flags |= FMF_FLAG_MEAN;
    }
    if (f->has_target) set_target(f, options);
  }
  BTF_TRY(factorise(f, done, 0.9));
  BTF_TRY(host->progress(f->job, 0.9, "storing"));
  BTF_TRY(btfi_fmf_choose_components(&f->out));
  BTF_TRY(host->progress(f->job, 0.94, "storing"));
  BTF_TRY(btfi_fmf_write(&f->out));
  host->log(f->ctx, BTF_LOG_INFO, "fmf: %u components, predicted rmse %.6g, relative error %.6g",
            f->out.head.components, sqrt(f->out.head.squared_error / ((double)f->rows * (double)f->texels)),
            f->out.head.energy > 0.0 ? sqrt(f->out.head.squared_error / f->out.head.energy) : 0.0);
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
  f->out = (btfi_fmf_writing){.host = host, .ctx = ctx, .payload = payload, .target = INFINITY};
  f->ds = ds;
  const btf_status status = fit_all(f, options);
  btfi_fmf_writing_free(&f->out);
  host->free(ctx, f->mean);
  host->free(ctx, f);
  return status;
}
