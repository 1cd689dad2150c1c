/* SPDX-License-Identifier: MIT */
/* visit.c: the ABRDFs of one level of detail, a slab of texels at a time. */
#include <inttypes.h>
#include <string.h>

#include "dataset/dataset.h"
#include "directions/directions.h"

#include <btf/btf_sampling.h>

/* A round of texels between two reports of progress is to take this long, whatever a texel takes. */
static const double round_ns = 5e7;
enum {
  most_growth = 8, /* of a round over the one before: the first texels may be easy ones */
  most_slab_texels = 1 << 24
};

typedef struct abrdf_visit {
  btf_context *ctx;
  const btf_dataset *ds;
  btf_abrdf_fn visit;
  void *user;
  const btf_job *job;
  const char *stage;
  double from, to;
  uint64_t visited, texels; /* of the level */
  uint32_t at_once;         /* texels of a round */
  uint32_t level, width, height, level_width, level_height;
  uint32_t views, lights, channels;
  uint64_t length; /* values of an ABRDF */
  btf_block slab;  /* texels of the level, in x0 .. height */
  float *values;   /* ABRDFs of the slab, or of a strip of finest texels */
  double *sums;    /* of the slab's texels; NULL at level 0 */
  float *averages; /* an ABRDF for each thread */
  /* The strip at hand: finest texels strip_x .. of row strip_y. */
  uint32_t strip_x, strip_width, strip_y, strip_most;
} abrdf_visit;

/* Some texels of the slab at a time, so that progress is told between. */
typedef struct visit_round {
  abrdf_visit *w;
  uint32_t first;
} visit_round;

static btf_status read_texels(abrdf_visit *w, uint32_t x0, uint32_t y0, uint32_t width, uint32_t height) {
  const ptrdiff_t channel = sizeof(float), light = channel * (ptrdiff_t)w->channels,
                  view = light * (ptrdiff_t)w->lights, x = view * (ptrdiff_t)w->views,
                  y = x * (ptrdiff_t)width;
  const btf_block block = {0, w->views, 0, w->lights, x0, y0, width, height};
  const btf_strides strides = {view, light, y, x, channel};
  return btf_dataset_read(w->ds, &block, w->values, &strides);
}

static uint32_t next_round(const abrdf_visit *w, uint32_t texels, int64_t elapsed_ns) {
  const double growth = BTFI_MIN(round_ns / (double)BTFI_MAX(elapsed_ns, 1), (double)most_growth);
  const double wanted = growth * texels, least = btfi_thread_count(w->ctx);
  return (uint32_t)BTFI_MIN(BTFI_MAX(wanted, least), (double)most_slab_texels);
}

/* Calls task for each texel of the slab, some at a time. */
static btf_status visit_slab(abrdf_visit *w, btf_task_fn task) {
  const uint32_t count = w->slab.width * w->slab.height;
  visit_round round = {w, 0};
  while (round.first < count) {
    const uint32_t texels = BTFI_MIN(w->at_once, count - round.first);
    const int64_t start = btfi_now_ns();
    BTFI_TRY(btfi_progress(w->job, w->from + (w->to - w->from) * (double)w->visited / (double)w->texels,
                           w->stage));
    BTFI_TRY(btfi_parallel(w->ctx, texels, task, &round));
    round.first += texels;
    w->visited += texels;
    if (texels == w->at_once) w->at_once = next_round(w, texels, btfi_now_ns() - start);
  }
  return BTF_OK;
}

static void visit_finest(void *job, uint32_t index, uint32_t thread) {
  const visit_round *round = job;
  const abrdf_visit *w = round->w;
  const uint32_t i = round->first + index;
  w->visit(w->user, 0, w->slab.x0 + i % w->slab.width, w->slab.y0 + i / w->slab.width,
           w->values + i * w->length, thread);
}

static void visit_average(void *job, uint32_t index, uint32_t thread) {
  const visit_round *round = job;
  const abrdf_visit *w = round->w;
  const uint32_t i = round->first + index;
  const double area = (double)w->width / w->level_width * ((double)w->height / w->level_height);
  const double *sum = w->sums + i * w->length;
  float *average = w->averages + thread * w->length;
  for (uint64_t k = 0; k < w->length; k++) average[k] = (float)(sum[k] / area);
  w->visit(w->user, w->level, w->slab.x0 + i % w->slab.width, w->slab.y0 + i / w->slab.width, average,
           thread);
}

/* Adds the strip to the texels of one column of the slab. */
static void add_strip(void *job, uint32_t index, uint32_t thread) {
  const abrdf_visit *w = job;
  btfi_mip_span sx, sy;
  (void)thread;
  btfi_mip_span_of(w->width, w->level_width, w->slab.x0 + index, &sx);
  for (uint32_t row = 0; row < w->slab.height; row++) {
    btfi_mip_span_of(w->height, w->level_height, w->slab.y0 + row, &sy);
    if (w->strip_y < sy.first || w->strip_y >= sy.first + sy.count) continue;
    double *sum = w->sums + ((uint64_t)row * w->slab.width + index) * w->length;
    for (uint32_t k = 0; k < sx.count; k++) {
      const uint32_t x = sx.first + k;
      if (x < w->strip_x || x >= w->strip_x + w->strip_width) continue;
      const double weight = btfi_mip_weight(&sx, k) * btfi_mip_weight(&sy, w->strip_y - sy.first);
      const float *value = w->values + (x - w->strip_x) * w->length;
      for (uint64_t i = 0; i < w->length; i++) sum[i] += weight * (double)value[i];
    }
  }
}

static btf_status sum_slab(abrdf_visit *w) {
  btfi_mip_span first_x, last_x, first_y, last_y;
  btfi_mip_span_of(w->width, w->level_width, w->slab.x0, &first_x);
  btfi_mip_span_of(w->width, w->level_width, w->slab.x0 + w->slab.width - 1, &last_x);
  btfi_mip_span_of(w->height, w->level_height, w->slab.y0, &first_y);
  btfi_mip_span_of(w->height, w->level_height, w->slab.y0 + w->slab.height - 1, &last_y);
  const uint32_t end_x = last_x.first + last_x.count, end_y = last_y.first + last_y.count;
  memset(w->sums, 0, (size_t)w->slab.width * w->slab.height * w->length * sizeof *w->sums);
  for (w->strip_y = first_y.first; w->strip_y < end_y; w->strip_y++) {
    for (w->strip_x = first_x.first; w->strip_x < end_x; w->strip_x += w->strip_width) {
      w->strip_width = BTFI_MIN(w->strip_most, end_x - w->strip_x);
      BTFI_TRY(read_texels(w, w->strip_x, w->strip_y, w->strip_width, 1));
      BTFI_TRY(btfi_parallel(w->ctx, w->slab.width, add_strip, w));
    }
    BTFI_TRY(btfi_progress(w->job, w->from + (w->to - w->from) * (double)w->visited / (double)w->texels,
                           w->stage));
  }
  return BTF_OK;
}

/* Sizes of slab and strip within the budget, and their room. */
static btf_status plan_visit(abrdf_visit *w, uint64_t budget) {
  const uint64_t item = w->length * sizeof(float), threads = w->level > 0 ? btfi_thread_count(w->ctx) : 0;
  const uint64_t level_texel = w->level > 0 ? w->length * sizeof(double) : item;
  const uint64_t least = level_texel + (w->level > 0 ? (threads + 1) * item : 0);
  if (budget < least)
    return btfi_fail(w->ctx, BTF_E_LIMIT,
                     "a working set of %" PRIu64 " bytes is too small for ABRDFs of %" PRIu64
                     " values; at least %" PRIu64 " bytes are needed",
                     budget, w->length, least);
  const uint64_t room = budget - threads * item;
  uint64_t slab = (w->level > 0 ? room / 2 : room) / level_texel;
  slab = BTFI_MIN(BTFI_MAX(slab, 1u), (uint64_t)most_slab_texels);
  w->slab.width = (uint32_t)BTFI_MIN(slab, (uint64_t)w->level_width);
  w->slab.height = (uint32_t)BTFI_MIN(BTFI_MAX(slab / w->slab.width, 1u), (uint64_t)w->level_height);
  uint64_t held = (uint64_t)w->slab.width * w->slab.height;
  if (w->level > 0) {
    if ((w->sums = btfi_alloc(w->ctx, held, w->length * sizeof *w->sums)) == NULL) return btfi_alloc_status();
    if ((w->averages = btfi_alloc(w->ctx, threads, item)) == NULL) return btfi_alloc_status();
    held = BTFI_MIN((room - held * level_texel) / item, (uint64_t)w->width);
    w->strip_most = (uint32_t)held;
  }
  return (w->values = btfi_alloc(w->ctx, held, item)) != NULL ? BTF_OK : btfi_alloc_status();
}

static btf_status visit_all(abrdf_visit *w, uint64_t budget) {
  BTFI_TRY(plan_visit(w, budget));
  const uint32_t most_width = w->slab.width, most_height = w->slab.height;
  for (w->slab.y0 = 0; w->slab.y0 < w->level_height; w->slab.y0 += most_height) {
    w->slab.height = BTFI_MIN(most_height, w->level_height - w->slab.y0);
    for (w->slab.x0 = 0; w->slab.x0 < w->level_width; w->slab.x0 += most_width) {
      w->slab.width = BTFI_MIN(most_width, w->level_width - w->slab.x0);
      BTFI_TRY(w->level > 0 ? sum_slab(w)
                            : read_texels(w, w->slab.x0, w->slab.y0, w->slab.width, w->slab.height));
      BTFI_TRY(visit_slab(w, w->level > 0 ? visit_average : visit_finest));
    }
  }
  return btfi_progress(w->job, w->to, w->stage);
}

btf_status btfi_visit_abrdfs(btf_context *ctx, const btf_dataset *ds, uint32_t level,
                             uint64_t max_working_set, btf_abrdf_fn visit, void *user, const btf_job *job,
                             double from, double to, const char *stage) {
  const btf_dataset_desc *desc = btfi_dataset_desc(ds);
  abrdf_visit w = {.ctx = ctx,
                   .ds = ds,
                   .visit = visit,
                   .user = user,
                   .job = job,
                   .stage = stage,
                   .from = from,
                   .to = to,
                   .level = level,
                   .at_once = btfi_thread_count(ctx),
                   .width = desc->width,
                   .height = desc->height,
                   .views = btf_dirset_count(desc->views),
                   .lights = btf_dirset_count(desc->lights),
                   .channels = desc->channels};
  if (level >= btfi_mip_count(w.width, w.height))
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "level %u of a data set that has %u", level,
                     btfi_mip_count(w.width, w.height));
  w.level_width = btf_sampling_level_size(w.width, level);
  w.level_height = btf_sampling_level_size(w.height, level);
  w.texels = (uint64_t)w.level_width * w.level_height;
  if (!btfi_mul((uint64_t)w.views * w.lights, w.channels, &w.length) || w.length > SIZE_MAX / sizeof(double))
    return btfi_fail(ctx, BTF_E_LIMIT, "an ABRDF of %u x %u x %u values is too large", w.views, w.lights,
                     w.channels);
  const btf_status status = visit_all(&w, max_working_set != 0 ? max_working_set : (uint64_t)1 << 30);
  btfi_free(ctx, w.values);
  btfi_free(ctx, w.sums);
  btfi_free(ctx, w.averages);
  return status;
}
