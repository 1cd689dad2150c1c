/* SPDX-License-Identifier: MIT */
/* fit.c: the working set, and the order of things. */
#include "fit.h"

#include <math.h>

#include "cluster_parts.h"
#include "search.h"

enum { SEARCH_ROWS = 64 /* that a search for nearest entries takes at once at least */ };

static btf_status open_data(btfi_cmf_fitting *f, const btf_dataset_desc *desc) {
  const uint32_t most = f->host->mip_count(desc->width, desc->height);
  f->width = desc->width;
  f->height = desc->height;
  f->channels = desc->channels;
  f->lights = f->host->dirset_count(desc->lights);
  f->views = f->host->dirset_count(desc->views);
  if ((uint64_t)f->lights * f->views > (uint64_t)1 << 26)
    return f->host->fail(f->ctx, BTF_E_LIMIT, "cmf: %u x %u directions; at most 2^26 pairs are possible",
                         f->lights, f->views);
  f->pairs = f->lights * f->views;
  if (f->settings.symmetric) {
    const size_t bytes = 3 * sizeof(float) * f->lights;
    if (f->lights != f->views ||
        memcmp(f->host->dirset_directions(desc->lights), f->host->dirset_directions(desc->views), bytes) != 0)
      return f->host->fail(f->ctx, BTF_E_UNSUPPORTED,
                           "cmf: symmetric factors need the same directions for lights and views");
  }
  if (f->levels == 0 || f->levels > most) f->levels = most;
  if (f->levels > CMF_MAX_LEVELS) f->levels = CMF_MAX_LEVELS;
  for (uint32_t level = 0; level < f->levels; level++)
    f->level_first[level + 1] = f->level_first[level] + (uint64_t)btf_sampling_level_size(f->width, level) *
                                                            btf_sampling_level_size(f->height, level);
  if (f->level_first[f->levels] > UINT32_MAX)
    return f->host->fail(f->ctx, BTF_E_LIMIT, "cmf: %llu texels; at most 2^32 - 1 are possible",
                         (unsigned long long)f->level_first[f->levels]);
  return BTF_OK;
}

/* Takes memory that counts against the working set. */
static void *take(btfi_cmf_fitting *f, uint64_t count, uint64_t size) {
  f->used += count * size;
  return f->host->alloc(f->ctx, count, size);
}

/* ---- the homomorphic method ---- */

/* Texels of the maps that are unknowns: a lookup reads no others. */
static uint64_t count_unknowns(const btfi_cmf_fitting *f) {
  const btfi_cmf_map map = btfi_cmf_map_of(f->settings.map, f->settings.edge);
  uint64_t count = 0;
  for (uint32_t i = 0; i < f->geometry->map_texels; i++) count += btfi_cmf_map_reads(&map, i);
  return f->factors * count;
}

/* Four taps of each factor's map for each pair. */
static uint64_t tap_bytes(const btfi_cmf_fitting *f) {
  return (uint64_t)f->pairs * f->factors * 4 * (sizeof(uint32_t) + sizeof(float));
}

/* What the method is made from: the taps, and which texels of the maps are unknowns. */
static uint64_t source_bytes(const btfi_cmf_fitting *f) {
  return tap_bytes(f) + (uint64_t)f->factors * f->geometry->map_texels;
}

/* Bytes of an ABRDF that waits for the others, with its place. */
static uint64_t collected_bytes(const btfi_cmf_fitting *f) {
  return (uint64_t)f->pairs * f->channels * sizeof(float) + sizeof(uint64_t);
}

/* What stays of the method beside what is collected; with `making` what making it takes, which is freed
 * before the rest is there: its taps and, as LAPACK works on a copy, the matrix twice. */
static uint64_t hf_bytes(const btfi_cmf_fitting *f, bool making) {
  const uint64_t n = count_unknowns(f);
  const uint64_t kept = 8 * n * n + 8 * n + 4 * (uint64_t)f->pairs +
                        4 * (uint64_t)f->factors * f->geometry->map_texels + tap_bytes(f);
  if (making) return kept + 8 * n * n + 12 * n + source_bytes(f);
  const uint64_t solving = btfi_cmf_hf_solve_bytes(f->host, f->ctx, n, CMF_SOLVE_TOGETHER, f->channels);
  return kept + solving + CMF_SOLVE_TOGETHER * (uint64_t)f->factors * f->map_values * sizeof(float);
}

/* `rest` is what all that follows needs. */
static btf_status create_hf(btfi_cmf_fitting *f, uint64_t rest) {
  const btfi_cmf_geometry *g = f->geometry;
  btfi_cmf_hf_geometry hf = {
      .pairs = f->pairs, .maps = f->factors, .width = f->settings.edge, .height = f->settings.edge};
  const uint64_t taps = (uint64_t)f->pairs * f->factors * 4;
  uint32_t *texel = f->host->alloc(f->ctx, taps, sizeof *texel);
  float *weight = f->host->alloc(f->ctx, taps, sizeof *weight);
  uint8_t *use_texel = f->host->alloc(f->ctx, (uint64_t)f->factors * g->map_texels, sizeof *use_texel);
  btf_status status = texel != NULL && weight != NULL && use_texel != NULL ? BTF_OK : BTF_E_NOMEM;
  const btfi_cmf_map map = btfi_cmf_map_of(f->settings.map, f->settings.edge);
  for (uint32_t i = 0; i < f->factors * g->map_texels && status == BTF_OK; i++)
    use_texel[i] = btfi_cmf_map_reads(&map, i % g->map_texels);
  for (uint32_t i = 0; i < f->factors && status == BTF_OK; i++) {
    const btfi_cmf_side *side = &g->stage[g->factor[i].stage].side[g->factor[i].side];
    for (uint32_t p = 0; p < f->pairs; p++) {
      const uint32_t at = side->at_kind == CMF_AT_LIGHT  ? p % f->lights
                          : side->at_kind == CMF_AT_VIEW ? p / f->lights
                                                         : p;
      const size_t to = ((size_t)p * f->factors + i) * 4;
      memcpy(texel + to, side->at[at].index, 4 * sizeof *texel);
      memcpy(weight + to, side->at[at].weight, 4 * sizeof *weight);
    }
  }
  hf.texel = texel;
  hf.weight = weight;
  hf.use_texel = use_texel;
  if (status == BTF_OK)
    status = btfi_cmf_hf_create(f->host, f->ctx, &hf, f->lambda, btfi_cmf_left(f) - source_bytes(f), &f->hf);
  f->host->free(f->ctx, texel);
  f->host->free(f->ctx, weight);
  f->host->free(f->ctx, use_texel);
  BTF_TRY(status);
  f->used += hf_bytes(f, false);
  f->collect = 1 + (btfi_cmf_left(f) - collected_bytes(f) - rest) / 4 / collected_bytes(f);
  if (f->collect > f->level_first[1]) f->collect = f->level_first[1];
  f->used += f->collect * sizeof(uint64_t);
  f->collected = take(f, f->collect, collected_bytes(f) - sizeof(uint64_t));
  return f->collected != NULL ? BTF_OK : BTF_E_NOMEM;
}

/* ---- room ---- */

btf_status btfi_cmf_prepare_geometry(btfi_cmf_fitting *f, const btf_dataset_desc *desc, double from,
                                     double to) {
  const btf_host *host = f->host;
  /* Small tables are made in any case: then what all would need is known. */
  const uint64_t small = (uint64_t)64 << 20, table_budget = f->budget > small ? f->budget : small;
  BTF_TRY(btfi_cmf_geometry_create(host, f->ctx, &f->settings, desc->lights, desc->views, table_budget,
                                   f->job, from, to, &f->geometry));
  f->used = f->geometry->bytes;
  f->factors = f->geometry->factors;
  f->map_values = f->geometry->map_texels * f->channels;
  f->scales = 1;
  for (uint32_t i = 0; i < f->factors; i++) {
    const btfi_cmf_factor *factor = &f->geometry->factor[i];
    f->has_sign[i] = btfi_cmf_is_signed(f->settings.method, factor->term);
    if (factor->term > 0) f->term_scale[i] = factor->side == 0 ? f->scales++ : f->scales - 1;
  }
  if (f->rotate) {
    BTF_TRY(btfi_cmf_rotation_create(host, f->ctx, desc->lights, desc->views, &f->rotation));
    f->used += (uint64_t)CMF_TURN * ((uint64_t)f->lights + f->views) * sizeof(btf_interp) + 16ull * f->pairs;
  }
  return BTF_OK;
}

uint64_t btfi_cmf_visit_bytes(const btfi_cmf_fitting *f) {
  return (uint64_t)f->pairs * f->channels * (8 + 4 * (f->threads + 1ull));
}

/* What reading and clustering need, which take turns, beside the factors of `capacity` texels. */
static uint64_t turn_bytes(const btfi_cmf_fitting *f, uint64_t samples, uint64_t capacity) {
  const btfi_cmf_cluster_options options = {.method = f->clustering, .entries = f->entries};
  const uint32_t entries = f->entries < samples ? f->entries : (uint32_t)samples;
  const uint64_t search = btfi_cmf_search_bytes(entries, f->map_values, SEARCH_ROWS);
  const uint64_t train =
      btfi_cmf_cluster_bytes(&options, 0, samples, f->map_values, f->threads) + 4 * samples;
  const uint64_t books = f->factors * (4 * (uint64_t)entries * f->map_values + 4 * samples);
  const uint64_t assign = 4 * (uint64_t)f->factors * capacity, most = train > assign ? train : assign;
  const uint64_t visit = btfi_cmf_visit_bytes(f);
  return books + (search + most > visit ? search + most : visit);
}

/* The fewest texels that codebooks can be made from. */
static uint64_t least_samples(const btfi_cmf_fitting *f) {
  return f->entries < f->level_first[1] ? f->entries : f->level_first[1];
}

static uint64_t bytes_with(const btfi_cmf_fitting *f, uint64_t samples) {
  return turn_bytes(f, samples, samples) + samples * f->record_bytes;
}

/* Room for the factors of as many texels as leave enough for the rest; if that is little, fewer samples. It
 * is known that there is room for the fewest. */
static btf_status make_store(btfi_cmf_fitting *f) {
  const uint64_t texels = f->level_first[f->levels], finest = f->level_first[1], least = least_samples(f);
  f->samples = f->wanted_samples < texels ? f->wanted_samples : texels;
  f->capacity = texels;
  while (f->capacity * f->record_bytes + turn_bytes(f, f->samples, f->capacity) > btfi_cmf_left(f)) {
    if (f->samples > finest) f->samples = finest;
    /* Each texel more takes its record and its place in the index. */
    const uint64_t fixed = bytes_with(f, f->samples);
    if (fixed <= btfi_cmf_left(f) || f->samples <= least) {
      const uint64_t more = fixed <= btfi_cmf_left(f) ? btfi_cmf_left(f) - fixed : 0;
      f->capacity = f->samples + more / (f->record_bytes + 4 * (uint64_t)f->factors);
      break;
    }
    f->samples = f->samples / 2 > least ? f->samples / 2 : least;
  }
  if (f->capacity > texels) f->capacity = texels;
  f->store = take(f, f->capacity, f->record_bytes);
  return f->store != NULL ? BTF_OK : BTF_E_NOMEM;
}

/* Ends the fit since the working set does not hold that much more. */
static btf_status fail_for_room(btfi_cmf_fitting *f, uint64_t bytes) {
  const unsigned long long needed = (unsigned long long)((f->used + bytes) >> 10) + 1;
  if (f->entries > 0)
    return f->host->fail(f->ctx, BTF_E_LIMIT, "cmf: codebooks of %u entries need a working set of %llu KiB",
                         f->entries, needed);
  return f->host->fail(f->ctx, BTF_E_LIMIT, "cmf: %s need a working set of %llu KiB",
                       f->settings.method == CMF_HOMOMORPHIC ? "homomorphic factors" : "tables and reading",
                       needed);
}

/* What make_room takes beside the store, and its parts. */
typedef struct room {
  uint64_t scales; /* values */
  uint64_t energies;
  uint64_t rest; /* what reading, or reading and clustering, need at least */
  uint64_t all;  /* bytes */
} room;

static room plan_room(btfi_cmf_fitting *f) {
  const uint64_t texels = f->level_first[f->levels];
  const uint64_t abrdf = ((uint64_t)f->pairs * f->channels * sizeof(float) + 63) / 64 * 64;
  const uint64_t maps = ((uint64_t)f->factors * f->map_values * sizeof(float) + 63) / 64 * 64;
  room r = {.scales = texels * f->scales * f->channels,
            .energies = f->storage == CMF_U8 && !f->full_is_largest ? texels * f->channels : 0};
  f->threads = f->host->thread_count(f->ctx);
  f->thread_bytes = f->geometry->scratch_bytes + maps + (f->rotate ? 2 * abrdf : 0);
  f->store_kind = f->storage == CMF_U8 ? CMF_U8 : CMF_F16;
  f->record_bytes = (uint64_t)f->factors * f->map_values * btfi_cmf_value_bytes(f->store_kind);
  const uint64_t arrays = f->threads * (f->thread_bytes + sizeof *f->report) +
                          r.scales * sizeof *f->scale * (f->has_target ? 2 : 1) +
                          r.energies * sizeof *f->energy + (f->rotate ? texels : 0);
  r.rest = f->entries > 0 ? bytes_with(f, least_samples(f)) : btfi_cmf_visit_bytes(f);
  uint64_t most = r.rest;
  if (f->settings.method == CMF_HOMOMORPHIC) {
    const uint64_t making = hf_bytes(f, true), kept = hf_bytes(f, false) + collected_bytes(f) + r.rest;
    most = making > kept ? making : kept;
  }
  r.all = arrays + most;
  return r;
}

bool btfi_cmf_has_room(btfi_cmf_fitting *f) {
  return plan_room(f).all <= btfi_cmf_left(f);
}

btf_status btfi_cmf_make_room(btfi_cmf_fitting *f) {
  const room r = plan_room(f);
  const uint64_t texels = f->level_first[f->levels];
  if (r.all > btfi_cmf_left(f)) return fail_for_room(f, r.all);
  f->scratch = take(f, f->threads, f->thread_bytes);
  f->report = take(f, f->threads, sizeof *f->report);
  f->scale = take(f, r.scales, sizeof *f->scale);
  if (f->scratch == NULL || f->report == NULL || f->scale == NULL) return BTF_E_NOMEM;
  memset(f->report, 0, f->threads * sizeof *f->report);
  if (r.energies > 0) {
    f->energy = take(f, r.energies, sizeof *f->energy);
    if (f->energy == NULL) return BTF_E_NOMEM;
  }
  if (f->has_target) {
    f->kept_scale = take(f, r.scales, sizeof *f->kept_scale);
    if (f->kept_scale == NULL) return BTF_E_NOMEM;
  }
  if (f->rotate) {
    f->angle = take(f, texels, 1);
    if (f->angle == NULL) return BTF_E_NOMEM;
    memset(f->angle, 0, texels);
  }
  if (f->settings.method == CMF_HOMOMORPHIC) BTF_TRY(create_hf(f, r.rest));
  return f->entries > 0 ? make_store(f) : BTF_OK;
}

/* Of the finest level: coarser ones are other data. */
static void log_report(const btfi_cmf_fitting *f) {
  btfi_cmf_report sum = {0};
  for (uint32_t i = 0; i < f->threads; i++) {
    const btfi_cmf_report *r = &f->report[i];
    sum.squared_error += r->squared_error;
    sum.squared_energy += r->squared_energy;
    sum.absolute_error += r->absolute_error;
    sum.relative_error += r->relative_error;
    sum.samples += r->samples;
    sum.positive += r->positive;
    sum.masked += r->masked;
    sum.divided += r->divided;
  }
  const double samples = fmax((double)sum.samples, 1.0);
  f->host->log(f->ctx, BTF_LOG_INFO,
               "cmf: %u factors, the finest level before storage: rmse %.6g, mean absolute error %.6g, mean "
               "relative error %.4g; "
               "%.3g of the cells have no valid pair, %.3g of the divisors were masked",
               f->factors, sqrt(sum.squared_error / samples), sum.absolute_error / samples,
               sum.relative_error / fmax((double)sum.positive, 1.0), f->geometry->invalid,
               (double)sum.masked / fmax((double)sum.divided, 1.0));
  if (!f->has_target && sum.squared_energy > 0.0)
    btf_warn_unfit(
        f->host, f->ctx, "cmf", sqrt(sum.squared_error / sum.squared_energy), f->advise,
        "a product of maps cannot follow noise, shadows and parallax; more terms (chain=h,io:3, or psnr, "
        "which picks them) or another factorisation (fmf, lpca, pvpca) suit this material better");
}

void btfi_cmf_unprepare(btfi_cmf_fitting *f) {
  btfi_cmf_geometry_free(f->host, f->ctx, f->geometry);
  btfi_cmf_hf_free(f->host, f->ctx, f->hf);
  btfi_cmf_rotation_free(f->host, f->ctx, &f->rotation);
  void *const arrays[] = {f->scratch,    f->report, f->scale, f->energy,
                          f->kept_scale, f->angle,  f->store, f->collected};
  for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++) f->host->free(f->ctx, arrays[i]);
  f->geometry = NULL;
  f->hf = NULL;
  memset(&f->rotation, 0, sizeof f->rotation);
  f->scratch = f->angle = f->store = NULL;
  f->report = NULL;
  f->scale = f->kept_scale = f->collected = NULL;
  f->energy = NULL;
  f->has_records = false;
  f->used = 0;
}

/* The squared error to reach, from the data's own peak. */
static btf_status set_target(btfi_cmf_fitting *f, const btf_options *options, double to) {
  const btf_host *host = f->host;
  const double psnr = host->option(options, "psnr"), rmse = host->option(options, "rmse");
  const double samples = (double)f->level_first[1] * f->pairs * f->channels;
  f->target = rmse > 0.0 ? rmse * rmse * samples : INFINITY;
  if (psnr > 0.0) {
    btf_statistics statistics = {.struct_size = sizeof statistics};
    BTF_TRY(host->measure(f->ctx, f->ds, f->budget, NULL, &statistics, f->job, 0.0, to));
    const double of_psnr = statistics.peak * statistics.peak * pow(10.0, -psnr / 10.0) * samples;
    if (of_psnr < f->target) {
      f->target = of_psnr;
      f->target_psnr = psnr;
    }
  }
  return BTF_OK;
}

static btf_status fit_all(btfi_cmf_fitting *f, const btf_options *options) {
  const double measured = 0.05;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  BTF_TRY(f->host->dataset_describe(f->ds, &desc));
  BTF_TRY(btfi_cmf_read_options(f, options));
  BTF_TRY(open_data(f, &desc));
  if (f->has_target) {
    BTF_TRY(set_target(f, options, measured));
    BTF_TRY(btfi_cmf_meet_target(f, &desc, (uint32_t)f->host->option(options, "max_codebook"),
                                 (uint32_t)f->host->option(options, "max_terms"), measured));
  } else {
    BTF_TRY(f->host->progress(f->job, 0.0, "preparing"));
    BTF_TRY(btfi_cmf_prepare_geometry(f, &desc, 0.0, 0.02));
    BTF_TRY(btfi_cmf_make_room(f));
    BTF_TRY(btfi_cmf_write(f, 0.02, 0.98));
  }
  log_report(f);
  return f->host->progress(f->job, 1.0, "storing");
}

btf_status btfi_cmf_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                        const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  btfi_cmf_fitting *f = host->alloc(ctx, 1, sizeof *f);
  if (f == NULL) return BTF_E_NOMEM;
  memset(f, 0, sizeof *f);
  f->host = host;
  f->ctx = ctx;
  f->ds = ds;
  f->job = job;
  f->payload = payload;
  f->budget = job->max_working_set;
  const btf_status status = fit_all(f, options);
  btfi_cmf_unprepare(f);
  host->free(ctx, f);
  return status;
}
