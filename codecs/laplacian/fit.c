/* SPDX-License-Identifier: MIT */
/* fit.c: from a data set to the payload. The first reading takes the means and the small bands; large bands
 * are decomposed one by one from bands made anew in each reading. */
#include "laplacian.h"

#include <math.h>

#include <btf/btf_half.h>

/* A component below this share of the norm of the data is rounding error. */
#define NEGLIGIBLE 3e-7

enum { MOST_BANDS = 3 * LAPLACIAN_MAX_LEVELS };

/* Bands that a reading keeps, and what the first one measures. */
typedef struct reading {
  btfi_laplacian_band band[MOST_BANDS];
  uint32_t bands, lowest;
  bool first, wanted[3];
  double *mean;          /* pairs x 3, of the low-pass image */
  double *squared_means; /* pairs x levels x 3, of the other bands */
  double *energy;        /* pairs */
  uint64_t *histogram;   /* threads x BTF_PEAK_BINS, or NULL */
} reading;

float btfi_laplacian_round(uint32_t storage, float value) {
  return storage == LAPLACIAN_F16 ? btf_half_to_float(btf_float_to_half(value)) : value;
}

/* ---- readings ---- */

static double plane_mean(const float *plane, uint64_t n) {
  double sum = 0.0;
  for (uint64_t i = 0; i < n; i++) sum += plane[i];
  return sum / (double)n;
}

static void measure_samples(reading *r, uint64_t pair, const float *rgb, uint64_t values, uint32_t thread) {
  double energy = 0.0;
  for (uint64_t i = 0; i < values; i++) energy += (double)rgb[i] * rgb[i];
  r->energy[pair] = energy;
  if (r->histogram == NULL) return;
  uint64_t *bins = r->histogram + (uint64_t)thread * BTF_PEAK_BINS;
  for (uint64_t i = 0; i < values; i++)
    if (rgb[i] > 0.0f) bins[btf_peak_bin(rgb[i])]++;
}

static void read_image(void *user, const btfi_laplacian_source *s, uint64_t pair, const float *rgb,
                       float *planes, float *scratch, uint32_t thread) {
  reading *r = user;
  const uint32_t levels = s->grid.levels;
  if (r->first) measure_samples(r, pair, rgb, 3 * (uint64_t)s->grid.width[0] * s->grid.height[0], thread);
  for (uint32_t c = 0; c < 3; c++) {
    if (!r->first && !r->wanted[c]) continue;
    btfi_laplacian_plane(s, rgb, c, planes);
    btfi_laplacian_analyse(s->pyramid, r->first ? 0 : r->lowest, planes, scratch);
    for (uint32_t k = 0; r->first && k < levels; k++) {
      const double mean = plane_mean(planes + btfi_laplacian_pyramid_offset(s->pyramid, k),
                                     (uint64_t)s->grid.width[k] * s->grid.height[k]);
      if (k + 1 == levels) r->mean[3 * pair + c] = mean;
      r->squared_means[(pair * levels + k) * 3 + c] = mean * mean;
    }
    for (uint32_t b = 0; b < r->bands; b++) {
      const btfi_laplacian_band *band = &r->band[b];
      const uint64_t texels = (uint64_t)s->grid.width[band->level] * s->grid.height[band->level];
      if (band->channel == c)
        memcpy(band->data + pair * texels, planes + btfi_laplacian_pyramid_offset(s->pyramid, band->level),
               texels * sizeof *band->data);
    }
  }
}

/* Bytes of what the first reading measures. */
static uint64_t survey_bytes(const btfi_laplacian_fitting *f, const btf_options *options) {
  const uint64_t bins = (uint64_t)f->host->thread_count(f->ctx) * BTF_PEAK_BINS;
  return f->source.pairs * (4 + 3 * (uint64_t)f->head.levels) * sizeof(double) +
         (f->host->option(options, "psnr") > 0.0 ? bins * sizeof(uint64_t) : 0);
}

static void free_survey(btfi_laplacian_fitting *f, reading *r) {
  f->host->free(f->ctx, r->mean);
  f->host->free(f->ctx, r->squared_means);
  f->host->free(f->ctx, r->energy);
  f->host->free(f->ctx, r->histogram);
  r->mean = r->squared_means = r->energy = NULL;
  r->histogram = NULL;
}

static void free_reading(btfi_laplacian_fitting *f, reading *r) {
  for (uint32_t b = 0; b < r->bands; b++) f->host->free(f->ctx, r->band[b].data);
  free_survey(f, r);
}

/* ---- what the first reading tells ---- */

/* Adds up what the threads have counted. */
static double find_peak(const btfi_laplacian_fitting *f, const reading *r, uint64_t samples) {
  for (uint32_t t = 1; t < f->host->thread_count(f->ctx); t++)
    for (uint32_t bin = 0; bin < BTF_PEAK_BINS; bin++)
      r->histogram[bin] += r->histogram[(uint64_t)t * BTF_PEAK_BINS + bin];
  return btf_peak_of(r->histogram, samples);
}

/* Fits the means of the low-pass image and tells what they leave. */
static btf_status fit_means(btfi_laplacian_fitting *f, const btf_dataset_desc *desc, const double *mean) {
  btfi_laplacian_head *head = &f->head;
  const uint64_t pairs = f->source.pairs;
  for (uint32_t c = 0; c < 3; c++) {
    float largest = 0.0f;
    double sum = 0.0, squares = 0.0;
    for (uint64_t i = 0; i < pairs; i++) {
      largest = fmaxf(largest, fabsf((float)mean[3 * i + c]));
      sum += mean[3 * i + c];
    }
    f->mean_scale[c] = largest;
    for (uint64_t i = 0; i < pairs; i++) squares += pow(mean[3 * i + c] - sum / (double)pairs, 2.0);
    if (c > 0) {
      head->chroma[c - 1] = sum / (double)pairs;
      head->chroma_rms[c - 1] = sqrt(squares / (double)pairs);
    }
  }
  BTF_TRY(btfi_laplacian_fit_phong(f->host, f->ctx, desc->lights, desc->views, desc->quantity, mean,
                                   &head->phong, &head->mean_residual));
  const float *lights = f->host->dirset_directions(desc->lights),
              *views = f->host->dirset_directions(desc->views);
  for (uint64_t i = 0; i < pairs; i++)
    for (uint32_t c = 0; c < 3; c++) {
      float value;
      if (head->mean == LAPLACIAN_TABLE) {
        const float scale = f->mean_scale[c];
        value = scale > 0.0f ? scale * btfi_laplacian_round(head->storage, (float)(mean[3 * i + c] / scale))
                             : 0.0f;
      } else if (c == LAPLACIAN_Y) {
        value = btfi_laplacian_phong_value(&head->phong, lights + 3 * (i % f->source.lights),
                                           views + 3 * (i / f->source.lights));
      } else {
        value = (float)head->chroma[c - 1];
      }
      f->mean[3 * i + c] = value;
    }
  f->source.mean = f->mean;
  return BTF_OK;
}

static btf_status learn(btfi_laplacian_fitting *f, const btf_dataset_desc *desc, const btf_options *options,
                        const reading *r) {
  btfi_laplacian_head *head = &f->head;
  const uint64_t pairs = f->source.pairs;
  const double samples = 3.0 * (double)pairs * f->source.grid.width[0] * f->source.grid.height[0];
  const double psnr = f->host->option(options, "psnr"), rmse = f->host->option(options, "rmse");
  for (uint64_t i = 0; i < pairs; i++) {
    head->energy += r->energy[i];
    for (uint32_t k = 0; k < 3 * head->levels; k++)
      head->mean_norm[k / 3][k % 3] += r->squared_means[i * head->levels * 3 + k];
  }
  if (!isfinite(head->energy))
    return f->host->fail(f->ctx, BTF_E_NUMERIC, "laplacian: the samples are too large to be squared");
  for (uint32_t k = 0; k < 3 * head->levels; k++)
    head->mean_norm[k / 3][k % 3] = sqrt(head->mean_norm[k / 3][k % 3] / (double)pairs);
  if (rmse > 0.0) f->target = rmse * rmse * samples;
  if (psnr > 0.0) {
    f->peak = find_peak(f, r, (uint64_t)samples);
    const double target = f->peak * f->peak * pow(10.0, -psnr / 10.0) * samples;
    if (!(rmse > 0.0) || target < f->target) {
      f->target = target;
      f->target_psnr = psnr;
    }
  }
  return fit_means(f, desc, r->mean);
}

/* ---- decompositions ---- */

typedef struct resident {
  const btfi_laplacian_band *band;
  const btfi_laplacian_fitting *fitting;
  uint64_t texels;
} resident;

static btf_status read_resident(void *user, uint64_t item0, uint64_t items, float *dst, size_t ld) {
  const resident *m = user;
  const bool top = m->band->level + 1 == m->fitting->head.levels;
  for (uint64_t i = item0; i < item0 + items; i++, dst += ld) {
    const float *row = m->band->data + i * m->texels;
    const float mean = top ? m->fitting->mean[3 * i + m->band->channel] : 0.0f;
    for (uint64_t t = 0; t < m->texels; t++) dst[t] = row[t] - mean;
  }
  return BTF_OK;
}

/* Copies a column of an array of rows, divided by its largest magnitude, which is returned. */
static float take_column(const float *rows, uint64_t count, uint32_t stride, uint32_t column,
                         uint32_t storage, float *dst) {
  float largest = 0.0f;
  for (uint64_t i = 0; i < count; i++) largest = fmaxf(largest, fabsf(rows[i * stride + column]));
  for (uint64_t i = 0; i < count; i++)
    dst[i] = largest > 0.0f ? btfi_laplacian_round(storage, rows[i * stride + column] / largest) : 0.0f;
  return largest;
}

static btf_status take_triplets(btfi_laplacian_fitting *f, uint32_t level, uint32_t channel,
                                const btf_svd_result *svd) {
  btfi_laplacian_factors *out = &f->factors[level][channel];
  const btfi_laplacian_grid *grid = &f->source.grid;
  const uint64_t pairs = f->source.pairs, texels = (uint64_t)grid->width[level] * grid->height[level];
  const double norm =
      sqrt(f->head.energy / (double)(grid->width[0] * (uint64_t)grid->height[0]) * (double)texels);
  uint32_t kept = svd->rank;
  while (kept > 0 && svd->sigma[kept - 1] <= NEGLIGIBLE * norm) kept--;
  f->head.energy_of[level][channel] = svd->energy;
  f->head.residual[level][channel] = svd->residual;
  for (uint32_t j = kept; j < svd->rank; j++)
    f->head.residual[level][channel] += svd->sigma[j] * svd->sigma[j];
  if (kept == 0) return BTF_OK;
  out->eigen = f->host->alloc(f->ctx, kept, pairs * sizeof *out->eigen);
  out->weights = f->host->alloc(f->ctx, kept, texels * sizeof *out->weights);
  out->scale = f->host->alloc(f->ctx, kept, sizeof *out->scale);
  out->sigma = f->host->alloc(f->ctx, kept, sizeof *out->sigma);
  if (out->eigen == NULL || out->weights == NULL || out->scale == NULL || out->sigma == NULL)
    return BTF_E_NOMEM;
  out->rank = kept;
  for (uint32_t j = 0; j < kept; j++) {
    const float a =
        take_column(svd->item_vectors, pairs, svd->rank, j, f->head.storage, out->eigen + j * pairs);
    const float b =
        take_column(svd->element_vectors, texels, svd->rank, j, f->head.storage, out->weights + j * texels);
    out->sigma[j] = svd->sigma[j];
    out->scale[j] = (float)((double)a * b * svd->sigma[j]);
    if (!isfinite(out->scale[j]))
      return f->host->fail(f->ctx, BTF_E_NUMERIC, "laplacian: the samples are too large for floats");
  }
  return BTF_OK;
}

/* Decomposes a band from memory, or if it has no data from the data set. */
static btf_status decompose(btfi_laplacian_fitting *f, const btfi_laplacian_band *band, uint32_t rank,
                            double accuracy, uint64_t budget, double from, double to) {
  const btfi_laplacian_grid *grid = &f->source.grid;
  const uint64_t texels = (uint64_t)grid->width[band->level] * grid->height[band->level];
  resident memory = {band, f, texels};
  btf_svd_desc desc = {.struct_size = sizeof desc,
                       .items = f->source.pairs,
                       .length = texels,
                       .read = band->data != NULL ? read_resident : btfi_laplacian_read,
                       .user = band->data != NULL ? (void *)&memory : (void *)&f->source,
                       .layout = BTF_LAYOUT_ITEM_ROWS,
                       .rank = rank,
                       .tolerance = accuracy,
                       .max_working_set = budget,
                       .seed = f->job->seed,
                       .block_items = band->data != NULL ? 0 : f->source.images};
  btf_svd_result svd = {.struct_size = sizeof svd};
  const uint64_t most = desc.items < texels ? desc.items : texels;
  if (desc.rank > most) desc.rank = (uint32_t)most;
  f->source.read_level = band->level;
  f->source.read_channel = band->channel;
  const btf_status decomposed = f->host->svd(f->ctx, &desc, f->job, from, to, &svd);
  f->least_for_band = svd.least_working_set;
  BTF_TRY(decomposed);
  const btf_status status = take_triplets(f, band->level, band->channel, &svd);
  f->host->svd_free(f->ctx, &svd);
  return status;
}

/* ---- the order of it all ---- */

typedef struct plan {
  btfi_laplacian_band band[MOST_BANDS]; /* coarsest first */
  uint32_t rank[MOST_BANDS];
  uint64_t bytes[MOST_BANDS];
  uint32_t bands;
  uint64_t kept;         /* the factors of all bands, those of one more, which the library makes, and means */
  uint64_t room, budget; /* for bands in memory; for all but what is kept and the buffers of images */
  double accuracy, end;  /* fraction of the fit when all bands are done */
} plan;

static const char *const count_names[3] = {"y", "cb", "cr"};

/* Components of a channel that each band is decomposed into: as many as are asked for or may be picked. */
static uint32_t most_components(const btfi_laplacian_fitting *f, const btf_options *options,
                                uint32_t channel) {
  const uint32_t fixed = (uint32_t)f->host->option(options, count_names[channel]),
                 most = (uint32_t)f->host->option(options, "max_components");
  return f->has_target || (f->adaptive && most > fixed) ? most : fixed;
}

/* False if the working set does not hold what the plan keeps and the first reading measures. */
static bool make_plan(const btfi_laplacian_fitting *f, const btf_options *options, plan *p) {
  const uint64_t pairs = f->source.pairs, working_set = f->job->max_working_set;
  uint64_t largest = 0;
  p->bands = 0;
  p->kept = 3 * pairs * sizeof *f->mean;
  for (uint32_t k = f->head.levels; k-- > 0;)
    for (uint32_t c = 0; c < 3; c++) {
      p->rank[p->bands] = most_components(f, options, c);
      p->band[p->bands] = (btfi_laplacian_band){k, c, NULL};
      const uint64_t texels = (uint64_t)f->source.grid.width[k] * f->source.grid.height[k];
      p->bytes[p->bands] = pairs * texels * sizeof(float);
      const uint64_t most = pairs < texels ? pairs : texels;
      const uint64_t rank = p->rank[p->bands] < most ? p->rank[p->bands] : most;
      const uint64_t factors = rank * ((pairs + texels + 1) * sizeof(float) + sizeof(double));
      p->kept += factors;
      if (factors > largest) largest = factors;
      p->bands += p->rank[p->bands] > 0;
    }
  p->kept += largest;
  const uint64_t taken = p->kept + f->source.buffers;
  p->budget = taken < working_set ? working_set - taken : 0;
  p->room = p->budget / 5 * 2;
  p->accuracy = f->host->option(options, "accuracy");
  p->end = f->has_target || f->adaptive ? 0.75 : 0.95;
  return survey_bytes(f, options) <= p->budget - p->room;
}

/* One reading and the decomposition of what it kept: bands first .. last - 1, which may be none. */
static btf_status read_and_decompose(btfi_laplacian_fitting *f, const btf_dataset_desc *desc,
                                     const btf_options *options, const plan *p, uint32_t first, uint32_t last,
                                     bool survey, double from, double to) {
  const btf_host *host = f->host;
  const uint64_t pairs = f->source.pairs;
  reading *r = host->alloc(f->ctx, 1, sizeof *r);
  btf_status status = BTF_OK;
  uint64_t bytes = 0;
  if (r == NULL) return BTF_E_NOMEM;
  memset(r, 0, sizeof *r);
  r->first = survey;
  r->lowest = f->head.levels - 1;
  if (survey) {
    r->mean = host->alloc(f->ctx, 3 * pairs, sizeof *r->mean);
    r->squared_means = host->alloc(f->ctx, 3 * pairs, f->head.levels * sizeof *r->squared_means);
    r->energy = host->alloc(f->ctx, pairs, sizeof *r->energy);
    if (r->mean == NULL || r->squared_means == NULL || r->energy == NULL) status = BTF_E_NOMEM;
    if (status == BTF_OK && host->option(options, "psnr") > 0.0) {
      const uint64_t bins = (uint64_t)host->thread_count(f->ctx) * BTF_PEAK_BINS;
      r->histogram = host->alloc(f->ctx, bins, sizeof *r->histogram);
      if (r->histogram != NULL) memset(r->histogram, 0, bins * sizeof *r->histogram);
      if (r->histogram == NULL) status = BTF_E_NOMEM;
    }
  }
  for (uint32_t b = first; b < last && status == BTF_OK; b++) {
    btfi_laplacian_band *band = &r->band[r->bands];
    *band = p->band[b];
    band->data = host->alloc(f->ctx, p->bytes[b], 1);
    bytes += p->bytes[b];
    if (band->data == NULL) status = BTF_E_NOMEM;
    r->bands += status == BTF_OK;
    r->wanted[band->channel] = true;
    if (band->level < r->lowest) r->lowest = band->level;
  }
  const double middle = survey ? from + 0.6 * (to - from) : from + 0.4 * (to - from);
  if (status == BTF_OK)
    status = btfi_laplacian_each_image(&f->source, f->job, from, middle, "reading", read_image, r);
  if (status == BTF_OK && survey) status = learn(f, desc, options, r);
  free_survey(f, r);
  for (uint32_t b = 0; b < r->bands && status == BTF_OK; b++)
    status = decompose(f, &r->band[b], p->rank[first + b], p->accuracy, p->budget - bytes,
                       middle + (to - middle) * b / r->bands, middle + (to - middle) * (b + 1) / r->bands);
  free_reading(f, r);
  host->free(f->ctx, r);
  return status;
}

static btf_status decompose_all(btfi_laplacian_fitting *f, const btf_dataset_desc *desc,
                                const btf_options *options, const plan *p) {
  bool survey = true;
  uint32_t b = 0, large = 0;
  for (uint32_t i = 0; i < p->bands; i++) large += p->bytes[i] > p->room;
  /* The first reading counts as much as a large band. */
  const double step = p->end / (1.0 + large + (p->bands - large) * 0.05);
  double done = 0.0;
  while (survey || b < p->bands) {
    uint32_t last = b;
    uint64_t bytes = 0;
    while (last < p->bands && p->bytes[last] <= p->room - bytes) bytes += p->bytes[last++];
    const double next = fmin(p->end, done + step * ((survey ? 1.0 : 0.0) + (last - b) * 0.05));
    if (survey || last > b) BTF_TRY(read_and_decompose(f, desc, options, p, b, last, survey, done, next));
    survey = false;
    done = next;
    for (b = last; b < p->bands && p->bytes[b] > p->room; b++) {
      BTF_TRY(decompose(f, &p->band[b], p->rank[b], p->accuracy, p->budget, done, fmin(p->end, done + step)));
      done = fmin(p->end, done + step);
    }
  }
  return BTF_OK;
}

/* LAP04: the pyramid ends where a level would have fewer texels than components. */
static uint32_t stop_level(const btf_dataset_desc *desc, uint32_t components, uint32_t most) {
  uint32_t levels = 1;
  while (levels < most && (uint64_t)btf_sampling_level_size(desc->width, levels) *
                                  btf_sampling_level_size(desc->height, levels) >=
                              components)
    levels++;
  return levels;
}

/* Fails with a working set that is enough for all that follows. Images take a quarter of it at most, and of
 * what else is not kept bands in memory take two fifths: 9/20 less three fifths of what is kept are left for
 * the first reading and for decompositions, of which that of level 0 with the most components needs the
 * most. */
static btf_status working_set_too_small(btfi_laplacian_fitting *f, const btf_options *options,
                                        const plan *p) {
  uint64_t needed = survey_bytes(f, options);
  uint32_t rank = 0;
  for (uint32_t c = 0; c < 3; c++)
    if (rank < most_components(f, options, c)) rank = most_components(f, options, c);
  if (rank > 0) {
    const btfi_laplacian_band finest = {0, LAPLACIAN_Y, NULL};
    const double accuracy = f->host->option(options, "accuracy");
    const btf_status asked = decompose(f, &finest, rank, accuracy, 1, 0.0, 0.0); /* a byte is never enough */
    if (asked != BTF_E_LIMIT || f->least_for_band == 0 || f->least_for_band > UINT64_MAX / 40) return asked;
    if (f->least_for_band > needed) needed = f->least_for_band;
  }
  uint64_t least = (needed * 20 + p->kept * 12 + 8) / 9 + 4;
  if (least < f->source.least_working_set) least = f->source.least_working_set;
  return f->host->fail(f->ctx, BTF_E_LIMIT,
                       "laplacian: a working set of %llu bytes is too small for this data set; %llu would do",
                       (unsigned long long)f->job->max_working_set, (unsigned long long)least);
}

static btf_status fit_all(btfi_laplacian_fitting *f, const btf_dataset *ds, const btf_options *options) {
  const btf_host *host = f->host;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  BTF_TRY(host->dataset_describe(ds, &desc));
  if (desc.channels != 3)
    return host->fail(f->ctx, BTF_E_UNSUPPORTED, "laplacian: takes RGB data; this data set has %u channels",
                      desc.channels);
  const uint32_t most = host->mip_count(desc.width, desc.height);
  f->has_target = host->option(options, "psnr") > 0.0 || host->option(options, "rmse") > 0.0;
  f->adaptive = !f->has_target && host->option(options, "budget") == (double)LAPLACIAN_ADAPTIVE;
  f->head.filter = (uint32_t)host->option(options, "filter");
  f->head.mean = (uint32_t)host->option(options, "mean");
  f->head.storage = (uint32_t)host->option(options, "storage");
  f->head.levels = (uint32_t)host->option(options, "levels");
  if (f->head.levels == 0)
    f->head.levels = stop_level(&desc, f->has_target ? 8 : (uint32_t)host->option(options, "y"), most);
  if (f->head.levels > most) f->head.levels = most;
  if (f->head.levels > LAPLACIAN_MAX_LEVELS) f->head.levels = LAPLACIAN_MAX_LEVELS;
  const btfi_laplacian_grid grid =
      btfi_laplacian_grid_of(f->head.filter, desc.wrap, f->head.levels, desc.width, desc.height);
  btf_status status =
      btfi_laplacian_source_open(host, f->ctx, ds, &desc, &grid, f->job->max_working_set, &f->source);
  plan p;
  const bool fits = make_plan(f, options, &p);
  if (status == BTF_E_LIMIT || (status == BTF_OK && !fits)) return working_set_too_small(f, options, &p);
  BTF_TRY(status);
  f->mean = host->alloc(f->ctx, 3 * f->source.pairs, sizeof *f->mean);
  if (f->mean == NULL) return BTF_E_NOMEM;
  f->head.squared_error = -1.0;
  status = decompose_all(f, &desc, options, &p);
  if (status == BTF_E_LIMIT && f->least_for_band > 0) return working_set_too_small(f, options, &p);
  BTF_TRY(status);
  for (uint32_t k = 0; k < f->head.levels; k++)
    for (uint32_t c = 0; c < 3; c++) {
      const uint32_t asked = (uint32_t)host->option(options, count_names[c]), found = f->factors[k][c].rank;
      f->head.count[k][c] = asked < found ? asked : found;
    }
  if (f->has_target) BTF_TRY(btfi_laplacian_meet_target(f, 0.75, 0.97));
  if (f->adaptive) BTF_TRY(btfi_laplacian_spend_budget(f, 0.75, 0.97));
  BTF_TRY(host->progress(f->job, 0.97, "storing"));
  BTF_TRY(btfi_laplacian_write(f));
  host->log(f->ctx, BTF_LOG_INFO,
            "laplacian: %u levels; luma mean ka %.4g kd %.4g ks %.4g alpha %.4g, rms left %.3g; chroma %.3g "
            "%.3g, left "
            "%.3g %.3g",
            f->head.levels, f->head.phong.ka, f->head.phong.kd, f->head.phong.ks, f->head.phong.alpha,
            f->head.mean_residual, f->head.chroma[0], f->head.chroma[1], f->head.chroma_rms[0],
            f->head.chroma_rms[1]);
  return host->progress(f->job, 1.0, "storing");
}

btf_status btfi_laplacian_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                              const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  btfi_laplacian_fitting *f = host->alloc(ctx, 1, sizeof *f);
  if (f == NULL) return BTF_E_NOMEM;
  memset(f, 0, sizeof *f);
  f->host = host;
  f->ctx = ctx;
  f->job = job;
  f->payload = payload;
  const btf_status status = fit_all(f, ds, options);
  for (uint32_t k = 0; k < LAPLACIAN_MAX_LEVELS; k++)
    for (uint32_t c = 0; c < 3; c++) {
      host->free(ctx, f->factors[k][c].eigen);
      host->free(ctx, f->factors[k][c].weights);
      host->free(ctx, f->factors[k][c].scale);
      host->free(ctx, f->factors[k][c].sigma);
    }
  btfi_laplacian_source_close(&f->source);
  host->free(ctx, f->mean);
  host->free(ctx, f);
  return status;
}
