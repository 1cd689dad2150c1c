/* SPDX-License-Identifier: MIT */
/* fit.c: from a data set to the payload, level by level, each from its own ABRDFs. */
#include "lafortune.h"

#include <math.h>
#include <string.h>

#include <btf/btf_codec.h>
#include <btf/btf_half.h>
#include <btf/btf_sampling.h>

/* Albedos of a level are divided by a power of two that brings the largest to 2^12 or below: far from
 * overflow, and dark texels far from where halves lose their precision. */
enum { LARGEST_EXPONENT = 12 };
/* Work of a reading, as a share of that of fitting a level. */
#define READING_SHARE 0.05

typedef struct texel_error {
  double squared, energy;
} texel_error;

typedef struct fitting {
  const btf_host *host;
  btf_context *ctx;
  const btf_dataset *ds;
  const btf_job *job;
  btf_chunk_writer *payload;
  btf_dataset_desc desc;
  btfi_lafortune_settings settings;
  btfi_lafortune_layout layout;
  btfi_lafortune_head head;
  btfi_lafortune_shared shared;
  uint32_t weights, threads;
  bool has_target;
  double rmse, psnr; /* to reach, if there is a target, and what it stands for; 0 = an rmse */
  double advise;
  uint64_t scratch_bytes, visit_budget;
  unsigned char *scratch;
  /* Of the level at hand: */
  uint32_t level_width;
  float *values;      /* records */
  texel_error *error; /* of each texel, summed in the end in their order */
  double done, all;   /* texels fitted, and of all levels */
} fitting;

static uint64_t level_texels(const fitting *f, uint32_t level) {
  return (uint64_t)btf_sampling_level_size(f->desc.width, level) *
         btf_sampling_level_size(f->desc.height, level);
}

/* ---- options and room ---- */

static void read_options(fitting *f, const btf_options *options) {
  const btf_host *host = f->host;
  const uint32_t all_levels = host->mip_count(f->desc.width, f->desc.height);
  f->head.kind = (uint32_t)host->option(options, "kind");
  f->head.colour = (uint32_t)host->option(options, "color");
  f->head.storage = (uint32_t)host->option(options, "storage");
  f->head.lobes = (uint32_t)host->option(options, "lobes");
  if (f->head.kind > LAF_FULL && !host->option_is_set(options, "lobes")) f->head.lobes = 1;
  f->head.levels = (uint32_t)host->option(options, "levels");
  if (f->head.levels == 0 || f->head.levels > all_levels) f->head.levels = all_levels;
  f->weights = (uint32_t)host->option(options, "weights");
  f->has_target = host->option(options, "psnr") > 0.0 || host->option(options, "rmse") > 0.0;
  f->advise = host->option(options, "advise");
  f->settings.starts = (uint32_t)host->option(options, "starts");
  f->settings.iterations = (uint32_t)host->option(options, "iterations");
  f->settings.tolerance = host->option(options, "tolerance");
}

/* Of the two targets the stricter one counts. The peak takes a reading of its own. */
static btf_status set_target(fitting *f, const btf_options *options) {
  const double psnr = f->host->option(options, "psnr"), rmse = f->host->option(options, "rmse");
  f->rmse = rmse > 0.0 ? rmse : INFINITY;
  if (psnr > 0.0) {
    btf_statistics statistics = {.struct_size = sizeof statistics};
    f->done = READING_SHARE * (double)level_texels(f, 0);
    BTF_TRY(f->host->measure(f->ctx, f->ds, f->job->max_working_set, NULL, &statistics, f->job, 0.0,
                             f->done / f->all));
    const double error = statistics.peak * pow(10.0, -psnr / 20.0);
    if (error < f->rmse) {
      f->rmse = error;
      f->psnr = psnr;
    }
  }
  return BTF_OK;
}

static void set_lobes(fitting *f, uint32_t lobes) {
  f->settings.lobes = f->head.lobes = lobes;
  btfi_lafortune_layout_of(f->head.kind, lobes, f->head.colour, f->head.storage, f->desc.channels,
                           &f->layout);
}

/* Room for the largest number of lobes that may come; what is left of the budget is for reading. */
static btf_status make_room(fitting *f) {
  const btf_host *host = f->host;
  const uint32_t lights = host->dirset_count(f->desc.lights), views = host->dirset_count(f->desc.views);
  const uint32_t most_lobes = f->has_target ? LAF_MAX_LOBES : f->head.lobes;
  const uint64_t pairs = (uint64_t)lights * views, texels = level_texels(f, 0);
  if (pairs > UINT32_MAX / 2)
    return host->fail(f->ctx, BTF_E_LIMIT,
                      "lafortune: %llu pairs of directions; at most 2^31 - 1 can be fitted",
                      (unsigned long long)pairs);
  set_lobes(f, most_lobes);
  f->threads = host->thread_count(f->ctx);
  f->shared.kind = f->head.kind;
  f->shared.padded = ((uint32_t)pairs + 7u) & ~7u;
  f->scratch_bytes = btfi_lafortune_scratch_bytes(&f->shared, most_lobes, f->layout.group_channels);
  const uint64_t own = btfi_lafortune_shared_bytes(f->head.kind, (uint32_t)pairs) +
                       f->threads * f->scratch_bytes +
                       texels * (f->layout.values * sizeof(float) + sizeof(texel_error));
  /* As visit_abrdfs needs for a texel of a coarser level. */
  const uint64_t abrdf = pairs * f->desc.channels, least = own + abrdf * (8 + 4 * (1 + (uint64_t)f->threads));
  if (f->job->max_working_set < least)
    return host->fail(f->ctx, BTF_E_LIMIT,
                      "lafortune: a working set of %llu bytes is too small for %llu texels and %llu pairs of "
                      "directions; at least %llu bytes are needed",
                      (unsigned long long)f->job->max_working_set, (unsigned long long)texels,
                      (unsigned long long)pairs, (unsigned long long)least);
  f->visit_budget = f->job->max_working_set - own;
  BTF_TRY(btfi_lafortune_shared_create(host, f->ctx, f->head.kind, f->desc.quantity, f->weights,
                                       host->dirset_directions(f->desc.lights), lights,
                                       host->dirset_directions(f->desc.views), views, &f->shared));
  f->scratch = host->alloc(f->ctx, f->threads, f->scratch_bytes);
  f->values = host->alloc(f->ctx, texels, f->layout.values * sizeof *f->values);
  f->error = host->alloc(f->ctx, texels, sizeof *f->error);
  return f->scratch != NULL && f->values != NULL && f->error != NULL ? BTF_OK : BTF_E_NOMEM;
}

/* ---- texels ---- */

static float stored(const fitting *f, float value) {
  return f->head.storage == LAF_F16 ? btf_half_to_float(btf_float_to_half(value)) : value;
}

/* As the payload holds it: levels are scaled by powers of two. */
static float stored_albedo(const fitting *f, double albedo) {
  const float value = (float)fmin(albedo, 1e38);
  int exponent;
  const float share = frexpf(value, &exponent);
  return ldexpf(stored(f, share), exponent);
}

static void fit_texel(void *user, uint32_t level, uint32_t x, uint32_t y, const float *abrdf,
                      uint32_t thread) {
  fitting *f = user;
  const btfi_lafortune_layout *layout = &f->layout;
  const uint64_t texel = (uint64_t)y * f->level_width + x;
  float *to = f->values + texel * layout->values;
  texel_error *error = &f->error[texel];
  btfi_lafortune_scratch *scratch = btfi_lafortune_scratch_init(
      f->scratch + thread * f->scratch_bytes, &f->shared, layout->lobes, layout->group_channels);
  (void)level;
  error->squared = error->energy = 0.0;
  for (uint32_t g = 0; g < layout->groups; g++) {
    btfi_lafortune_fitted fitted;
    btfi_lafortune_fit_group(scratch, &f->settings, abrdf + g * layout->group_channels, f->desc.channels,
                             layout->group_channels, &fitted);
    /* Albedos of the lobes as they are stored make up for most of what rounding did to them. */
    for (uint32_t j = 0; j < layout->lobes; j++)
      for (uint32_t i = 0; i < layout->shape; i++) *to++ = fitted.shape[j][i] = stored(f, fitted.shape[j][i]);
    btfi_lafortune_fit_albedos(scratch, &fitted);
    for (uint32_t j = 0; j <= layout->lobes; j++)
      for (uint32_t c = 0; c < layout->group_channels; c++) {
        *to = stored_albedo(f, fitted.albedo[j][c]);
        fitted.albedo[j][c] = (double)*to++;
      }
    btfi_lafortune_measure(scratch, &fitted);
    error->squared += fitted.squared_error;
    error->energy += fitted.energy;
  }
}

static btf_status fit_level(fitting *f, uint32_t level) {
  const double texels = (double)level_texels(f, level), from = f->done;
  f->done += texels;
  f->level_width = btf_sampling_level_size(f->desc.width, level);
  return f->host->visit_abrdfs(f->ctx, f->ds, level, f->visit_budget, fit_texel, f, f->job, from / f->all,
                               f->done / f->all, "fitting lobes");
}

/* ---- payload ---- */

static bool is_albedo(const btfi_lafortune_layout *layout, uint64_t i) {
  return i % layout->group_values >= layout->lobes * layout->shape;
}

/* The power of two that brings all albedos of the level to 2^LARGEST_EXPONENT or below. */
static float scale_of(const fitting *f, uint64_t values) {
  float largest = 0.0f;
  int exponent;
  if (f->head.storage != LAF_F16) return 1.0f;
  for (uint64_t i = 0; i < values; i++)
    if (is_albedo(&f->layout, i) && f->values[i] > largest) largest = f->values[i];
  if (!(largest > 0.0f)) return 1.0f;
  (void)frexpf(largest, &exponent);
  exponent -= LARGEST_EXPONENT;
  return ldexpf(1.0f, exponent > -126 ? exponent : -126);
}

static btf_status write_level(fitting *f, uint32_t level, unsigned char *scale_bytes) {
  const uint64_t values = level_texels(f, level) * f->layout.values;
  const float scale = scale_of(f, values);
  void *chunk;
  BTF_TRY(f->host->reserve(f->payload, LAF_TAG_TEXELS, level, BTF_PAYLOAD_IN_PLACE,
                           values * f->layout.value_bytes, &chunk));
  unsigned char *to = chunk;
  btf_put_f32(scale_bytes, scale);
  for (uint64_t i = 0; i < values; i++, to += f->layout.value_bytes) {
    const float value = is_albedo(&f->layout, i) ? f->values[i] / scale : f->values[i];
    if (f->head.storage == LAF_F16) {
      const uint16_t half = btf_float_to_half(value);
      memcpy(to, &half, sizeof half);
    } else {
      memcpy(to, &value, sizeof value);
    }
  }
  return BTF_OK;
}

static void put_head(const btfi_lafortune_head *head, unsigned char bytes[LAF_HEAD_BYTES]) {
  const uint32_t words[] = {head->kind, head->lobes, head->colour, head->storage, head->levels, head->flags};
  for (size_t i = 0; i < 6; i++) btf_put_u32(bytes + 4 * i, words[i]);
  btf_put_f64(bytes + 24, head->squared_error);
  btf_put_f64(bytes + 32, head->energy);
}

/* ---- the whole ---- */

static void sum_errors(fitting *f) {
  f->head.squared_error = f->head.energy = 0.0;
  for (uint64_t i = 0; i < level_texels(f, 0); i++) {
    f->head.squared_error += f->error[i].squared;
    f->head.energy += f->error[i].energy;
  }
  f->head.squared_error = fmin(f->head.squared_error, 1e300);
  f->head.energy = fmin(f->head.energy, 1e300);
}

static double sample_count(const fitting *f) {
  return (double)level_texels(f, 0) * f->shared.samples * f->desc.channels;
}

/* The finest level; with an error to reach, one lobe more until it is reached. */
static btf_status fit_finest(fitting *f) {
  const uint32_t most = f->has_target ? LAF_MAX_LOBES : f->head.lobes;
  for (uint32_t lobes = f->has_target ? 1 : most; lobes <= most; lobes++) {
    set_lobes(f, lobes);
    BTF_TRY(fit_level(f, 0));
    sum_errors(f);
    if (sqrt(f->head.squared_error / sample_count(f)) <= f->rmse) return BTF_OK;
  }
  if (f->has_target)
    btf_warn_missed(f->host, f->ctx, "lafortune", f->head.lobes, "lobes", f->head.squared_error,
                    f->rmse * f->rmse * sample_count(f), sample_count(f), f->psnr);
  return BTF_OK;
}

static void report(const fitting *f) {
  const double relative = f->head.energy > 0.0 ? sqrt(f->head.squared_error / f->head.energy) : 0.0;
  f->host->log(f->ctx, BTF_LOG_INFO, "lafortune: %u lobes, rmse %.6g, relative error %.6g", f->head.lobes,
               sqrt(f->head.squared_error / sample_count(f)), relative);
  btf_warn_unfit(
      f->host, f->ctx, "lafortune", relative, f->advise,
      "lobes cannot follow shadows and parallax of a deep relief; a factorisation (fmf, lpca, pvpca) "
      "suits this material better");
}

static btf_status fit_all(fitting *f, const btf_options *options) {
  unsigned char head[LAF_HEAD_BYTES], scales[4 * LAF_MAX_LEVELS];
  f->desc.struct_size = sizeof f->desc;
  BTF_TRY(f->host->dataset_describe(f->ds, &f->desc));
  read_options(f, options);
  for (uint32_t level = 0; level < f->head.levels; level++) f->all += (double)level_texels(f, level);
  if (f->has_target) f->all += (LAF_MAX_LOBES - 1 + READING_SHARE) * (double)level_texels(f, 0);
  BTF_TRY(set_target(f, options));
  BTF_TRY(make_room(f));
  BTF_TRY(fit_finest(f));
  BTF_TRY(write_level(f, 0, scales));
  for (uint32_t level = 1; level < f->head.levels; level++) {
    BTF_TRY(fit_level(f, level));
    BTF_TRY(write_level(f, level, scales + 4 * level));
  }
  put_head(&f->head, head);
  BTF_TRY(f->host->put(f->payload, LAF_TAG_SCALE, 0, 0, scales, 4 * (uint64_t)f->head.levels));
  BTF_TRY(f->host->put(f->payload, LAF_TAG_HEAD, 0, 0, head, sizeof head));
  report(f);
  return f->host->progress(f->job, 1.0, "fitting lobes");
}

btf_status btfi_lafortune_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                              const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  fitting *f = host->alloc(ctx, 1, sizeof *f);
  if (f == NULL) return BTF_E_NOMEM;
  memset(f, 0, sizeof *f);
  f->host = host;
  f->ctx = ctx;
  f->ds = ds;
  f->job = job;
  f->payload = payload;
  const btf_status status = fit_all(f, options);
  btfi_lafortune_shared_free(host, ctx, &f->shared);
  host->free(ctx, f->scratch);
  host->free(ctx, f->values);
  host->free(ctx, f->error);
  host->free(ctx, f);
  return status;
}
