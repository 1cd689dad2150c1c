/* SPDX-License-Identifier: MIT */
/* write.c: from factors to the payload: how many of them, how finely, and in which chunks. */
#include "fmf.h"

#include <math.h>
#include <string.h>

static void copy_column(const void *user, uint32_t side, uint32_t k, float *dst) {
  const btfi_fmf_writing *f = user;
  memcpy(dst, f->values[side] + k * f->factors.length[side], f->factors.length[side] * sizeof *dst);
}

void btfi_fmf_read_storage(btfi_fmf_writing *f, const btf_options *options) {
  const btf_host *host = f->host;
  const uint32_t all_levels = host->mip_count(f->width, f->height);
  const double zstd = host->option(options, "zstd");
  f->loss = host->option(options, "loss");
  f->head.storage = (uint32_t)host->option(options, "storage");
  f->head.coding = (uint32_t)host->option(options, "coding");
  f->head.levels = (uint32_t)host->option(options, "levels");
  if (f->head.levels == 0 || f->head.levels > all_levels) f->head.levels = all_levels;
  if (zstd != 0.0) host->set_zstd_level(f->payload, (int32_t)zstd);
}

btf_status btfi_fmf_writing_open(btfi_fmf_writing *f, uint32_t components) {
  f->factors.components = components;
  f->factors.length[FMF_SIDE_U] = (uint64_t)f->views * f->lights * f->channels;
  f->factors.length[FMF_SIDE_V] = (uint64_t)f->width * f->height;
  f->sigma = f->host->alloc(f->ctx, components, sizeof *f->sigma);
  f->residual = f->host->alloc(f->ctx, components + 1ull, sizeof *f->residual);
  return f->sigma != NULL && f->residual != NULL ? BTF_OK : BTF_E_NOMEM;
}

btf_status btfi_fmf_writing_alloc(btfi_fmf_writing *f, uint32_t components) {
  BTF_TRY(btfi_fmf_writing_open(f, components));
  f->factors.column = copy_column;
  f->factors.user = f;
  for (uint32_t side = 0; side < 2; side++) {
    f->values[side] = f->host->alloc(f->ctx, f->factors.length[side], components * sizeof(float));
    if (f->values[side] == NULL) return BTF_E_NOMEM;
  }
  return BTF_OK;
}

void btfi_fmf_writing_free(btfi_fmf_writing *f) {
  for (uint32_t side = 0; side < 2; side++) f->host->free(f->ctx, f->values[side]);
  f->host->free(f->ctx, f->sigma);
  f->host->free(f->ctx, f->residual);
}

/* Squared relative error of rounding both factors, about; it only shifts where the choice of components
 * begins. */
double btfi_fmf_storage_floor(uint32_t storage) {
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

double btfi_fmf_packing_growth(const btfi_fmf_writing *f) {
  return f->head.coding == FMF_PACKED ? (1.0 + f->loss) * (1.0 + f->loss) : 1.0;
}

static bool has_target(const btfi_fmf_writing *f) {
  return f->target < INFINITY;
}

/* ---- how many components, and at which steps ---- */

static double tolerated_by_q8(const btfi_fmf_writing *f, uint32_t components) {
  return 0.01 * f->residual[components];
}

/* The predicted squared error with the first `components`: truncation, storage and packing. */
static btf_status predict_error(btfi_fmf_writing *f, uint32_t components, double *out) {
  btfi_fmf_factors factors = f->factors;
  factors.components = components;
  f->head.tolerated = tolerated_by_q8(f, components);
  BTF_TRY(btfi_fmf_plan_columns(f->host, f->ctx, &factors, f->head.storage, f->head.tolerated, &f->plan));
  *out = (f->residual[components] + f->plan.squared_error) * btfi_fmf_packing_growth(f);
  return BTF_OK;
}

btf_status btfi_fmf_choose_components(btfi_fmf_writing *f) {
  const uint32_t available = f->factors.components;
  uint32_t components = available;
  if (has_target(f)) {
    const double floor = btfi_fmf_storage_floor(f->head.storage) * f->head.energy;
    while (components > 1 && f->residual[components - 1] * btfi_fmf_packing_growth(f) + floor <= f->target)
      components--;
  }
  double error;
  BTF_TRY(predict_error(f, components, &error));
  while (has_target(f) && error > f->target && components < available)
    BTF_TRY(predict_error(f, ++components, &error));
  /* The estimate of the storage error may have been too careful. */
  while (has_target(f) && error <= f->target && components > 1) {
    double without_last;
    BTF_TRY(predict_error(f, components - 1, &without_last));
    if (without_last > f->target) {
      BTF_TRY(predict_error(f, components, &error));
      break;
    }
    error = without_last;
    components--;
  }
  f->factors.components = components;
  f->head.squared_error = error;
  if (has_target(f) && error > f->target) {
    const double samples = (double)f->factors.length[FMF_SIDE_U] * (double)f->factors.length[FMF_SIDE_V];
    btf_warn_missed(f->host, f->ctx, "fmf", components, "components", error, f->target, samples,
                    f->target_psnr);
  }
  return BTF_OK;
}

typedef struct step_trial {
  const btfi_fmf_writing *f;
  double step;
  uint64_t longest;
  float *values; /* of each thread */
  double *error; /* squared, of each side and component */
} step_trial;

static void measure_step(void *job, uint32_t index, uint32_t thread) {
  const step_trial *t = job;
  const uint32_t side = index % 2, k = index / 2;
  const uint64_t length = t->f->factors.length[side];
  float *values = t->values + thread * t->longest;
  const double factor = (side == FMF_SIDE_U ? t->f->sigma[k] : 1.0) / t->step;
  double error = 0.0;
  t->f->factors.column(t->f->factors.user, side, k, values);
  for (uint64_t i = 0; i < length; i++) {
    const double value = values[i] * factor, left = value - rint(value);
    error += left * left;
  }
  t->error[index] = error * t->step * t->step;
}

/* Squared Frobenius error of rounding U S and V S to multiples of a step. */
static btf_status error_of_step(step_trial *trial, double *out) {
  const btfi_fmf_writing *f = trial->f;
  *out = 0.0;
  BTF_TRY(f->host->parallel(f->ctx, 2 * f->factors.components, measure_step, trial));
  for (uint32_t k = 0; k < f->factors.components; k++) {
    const double u = trial->error[2 * k], v = trial->error[2 * k + 1];
    *out += u + v + u * v / (f->sigma[k] * f->sigma[k]);
  }
  return BTF_OK;
}

/* The smallest step whose integers are as exact as floats and still fit the file: what a nearly exact
 * factorisation of few texels would otherwise undercut. */
static double smallest_step(const btfi_fmf_writing *f, uint32_t side) {
  double largest = 0.0; /* the plan has the largest magnitude of each column, or a little more */
  for (uint32_t k = 0; k < f->factors.components; k++)
    largest = fmax(largest, f->plan.column[k].scale[side] * (side == FMF_SIDE_U ? f->sigma[k] : 1.0));
  return largest / FMF_LARGEST_INTEGER;
}

/* The largest step, within a percent or so, that adds no more than the loss. */
static btf_status choose_step(btfi_fmf_writing *f) {
  const double without = f->head.squared_error / btfi_fmf_packing_growth(f);
  /* Less than is allowed, for what the prediction leaves out: products of errors of different components. */
  const double budget = fmax(0.94 * (f->head.squared_error - without), 1e-14 * f->head.energy);
  const double values =
      ((double)f->factors.length[FMF_SIDE_U] + (double)f->factors.length[FMF_SIDE_V]) * f->factors.components;
  double step = sqrt(12.0 * budget / values), safe = 0.0, error = 0.0;
  const uint64_t *length = f->factors.length;
  step_trial trial = {.f = f, .longest = length[0] > length[1] ? length[0] : length[1]};
  trial.error = f->host->alloc(f->ctx, 2 * (uint64_t)f->factors.components, sizeof *trial.error);
  trial.values = f->host->alloc(f->ctx, trial.longest * f->host->thread_count(f->ctx), sizeof *trial.values);
  btf_status status = trial.error != NULL && trial.values != NULL ? BTF_OK : BTF_E_NOMEM;
  if (budget == 0.0) step = 1.0;
  for (int turn = 0; turn < 12 && status == BTF_OK && budget > 0.0; turn++) {
    trial.step = step;
    status = error_of_step(&trial, &error);
    if (error <= budget) {
      safe = step;
      if (error >= 0.97 * budget || turn >= 3) break;
    }
    step *= error > 0.0 ? fmin(2.0, 0.995 * sqrt(budget / error)) : 2.0;
  }
  f->host->free(f->ctx, trial.error);
  f->host->free(f->ctx, trial.values);
  if (safe > 0.0) step = safe;
  for (uint32_t side = 0; side < 2; side++) f->head.step[side] = fmax(step, smallest_step(f, side));
  return status;
}

/* ---- payload ---- */

static btf_status write_packed(btfi_fmf_writing *f) {
  const btfi_fmf_grid directions = {f->channels, f->lights, f->views};
  const btfi_fmf_grid texels = {1, f->width, f->height};
  BTF_TRY(choose_step(f));
  BTF_TRY(btfi_fmf_pack(f->host, f->ctx, &f->factors, FMF_SIDE_U, &directions, f->sigma, f->head.step[0],
                        f->payload, FMF_TAG_PACKED_U));
  return btfi_fmf_pack(f->host, f->ctx, &f->factors, FMF_SIDE_V, &texels, NULL, f->head.step[1], f->payload,
                       FMF_TAG_PACKED_V);
}

static btf_status write_plain(btfi_fmf_writing *f) {
  const btf_model_shape shape = {.width = f->width, .height = f->height, .channels = f->channels};
  btfi_fmf_layout layout;
  void *u, *chunk, *columns;
  unsigned char *v[FMF_MAX_LEVELS];
  f->head.columns = f->plan.columns;
  if (!btfi_fmf_layout_of(&shape, f->lights, f->views, f->head.storage, f->plan.columns, f->head.levels,
                          &layout))
    return f->host->fail(f->ctx, BTF_E_LIMIT, "fmf: the tables would not fit 64 bits");
  BTF_TRY(f->host->reserve(f->payload, FMF_TAG_COLUMNS, 0, 0, (uint64_t)FMF_COLUMN_BYTES * f->plan.columns,
                           &columns));
  btfi_fmf_put_columns(&f->plan, columns);
  BTF_TRY(f->host->reserve(f->payload, FMF_TAG_U, 0, BTF_PAYLOAD_IN_PLACE, layout.u_bytes, &u));
  for (uint32_t level = 0; level < layout.levels; level++) {
    BTF_TRY(
        f->host->reserve(f->payload, FMF_TAG_V, level, BTF_PAYLOAD_IN_PLACE, layout.v_bytes[level], &chunk));
    v[level] = chunk;
  }
  return btfi_fmf_fill_tables(f->host, f->ctx, &f->factors, &f->plan, &layout, u, v);
}

btf_status btfi_fmf_write(btfi_fmf_writing *f) {
  unsigned char head[FMF_HEAD_BYTES];
  void *sigma;
  BTF_TRY(f->host->reserve(f->payload, FMF_TAG_SIGMA, 0, 0, 8 * (uint64_t)f->factors.components, &sigma));
  btfi_fmf_put_sigma(f->sigma, f->factors.components, sigma);
  f->head.components = f->factors.components;
  BTF_TRY(f->head.coding == FMF_PACKED ? write_packed(f) : write_plain(f));
  btfi_fmf_put_head(&f->head, head);
  return f->host->put(f->payload, FMF_TAG_HEAD, 0, 0, head, sizeof head);
}
