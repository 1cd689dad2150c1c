/* SPDX-License-Identifier: MIT */
/* run.c: the loop over views, lights and texels, in blocks that go to disk as soon as they are done. */
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "cli.h"
#include "parallel.h"
#include "source.h"

/* Floats of the block that a thread holds. */
#define BLOCK_FLOATS ((size_t)1 << 20)
#define RECORDED_PACKETS 4096u

/* ---- Blocks ---- */

typedef struct worker {
  float *samples;
#ifdef BTF_EMBREE_MAJOR
  tracer *tracer;
#endif
} worker;

typedef struct run {
  const synth_desc *desc;
  const synth_source *source;
  synth_watch watch;
  btf_dataset_writer *writer;
  worker *workers;
  uint32_t views, width, height;         /* of one block */
  uint32_t blocks_v, blocks_x, blocks_y; /* number of blocks each way */
  atomic_uint_least64_t next;            /* block */
  atomic_uint_least64_t done;            /* texels of a view */
  atomic_int failure;                    /* first failure; the message is its thread's */
  char message[512];
} run;

static uint32_t at_most(size_t wanted, uint32_t limit) {
  return wanted < 1 ? 1 : wanted < limit ? (uint32_t)wanted : limit;
}

/* Blocks follow the order of the file, so that writes are long runs. */
static void plan_blocks(run *r) {
  const synth_desc *d = r->desc;
  const size_t column = (size_t)btf_dirset_count(d->lights) * 3, fit = BLOCK_FLOATS / column;
  const uint32_t views = btf_dirset_count(d->views);
  if (d->order == BTF_ORDER_YXVLC) {
    r->views = at_most(fit, views);
    r->width = at_most(fit / r->views, d->width);
    r->height = at_most(fit / r->views / r->width, d->height);
  } else {
    r->views = 1;
    r->width = at_most(fit, d->width);
    r->height = at_most(fit / r->width, d->height);
  }
  r->blocks_v = (views + r->views - 1) / r->views;
  r->blocks_x = (d->width + r->width - 1) / r->width;
  r->blocks_y = (d->height + r->height - 1) / r->height;
}

static void fail_run(run *r, btf_status status, const char *message) {
  int none = BTF_OK;
  if (atomic_compare_exchange_strong(&r->failure, &none, status))
    snprintf(r->message, sizeof r->message, "%s", message);
}

static uint64_t total_texels(const run *r) {
  return (uint64_t)btf_dirset_count(r->desc->views) * r->desc->width * r->desc->height;
}

static void count_done(run *r, uint64_t texels, uint32_t thread) {
  const uint64_t done = atomic_fetch_add(&r->done, texels) + texels;
  if (thread == 0) r->watch.fraction = (double)done / (double)total_texels(r);
}

/* False if the run is to stop. */
static bool sample_block(run *r, uint32_t thread, const btf_block *b, const btf_strides *bytes) {
  const worker *w = &r->workers[thread];
  const synth_desc *d = r->desc;
  const float *views = btf_dirset_directions(d->views);
  const size_t view_step = (size_t)bytes->view / sizeof(float),
               light_step = (size_t)bytes->light / sizeof(float);
  const size_t row_step = (size_t)bytes->y / sizeof(float), texel_step = (size_t)bytes->x / sizeof(float);
  for (uint32_t v = 0; v < b->views; ++v) {
    const float *view = views + 3 * (size_t)(b->view0 + v);
    float *dst = w->samples + v * view_step;
    if (r->source->material->fill != NULL) {
      const analytic_block block = {
          b->x0,     b->y0,      b->width, b->height, view, btf_dirset_directions(d->lights),
          b->lights, light_step, row_step, texel_step};
      r->source->material->fill(r->source->state, &block, dst);
      count_done(r, (uint64_t)b->width * b->height, thread);
      continue;
    }
#ifdef BTF_EMBREE_MAJOR
    for (uint32_t y = 0; y < b->height && !synth_watch_stops(&r->watch); ++y)
      for (uint32_t x = 0; x < b->width && !synth_watch_stops(&r->watch); ++x) {
        tracer_texel(w->tracer, b->x0 + x, b->y0 + y, vec3_load(view), dst + y * row_step + x * texel_step,
                     light_step, 1);
        count_done(r, 1, thread);
      }
#endif
  }
  return !synth_watch_stops(&r->watch);
}

static bool make_block(run *r, uint64_t index, uint32_t thread) {
  const synth_desc *d = r->desc;
  btf_block b = {0};
  btf_strides bytes;
  const uint64_t x = index % r->blocks_x, rest = index / r->blocks_x;
  const uint64_t y = d->order == BTF_ORDER_YXVLC ? rest / r->blocks_v : rest % r->blocks_y;
  const uint64_t v = d->order == BTF_ORDER_YXVLC ? rest % r->blocks_v : rest / r->blocks_y;
  b.lights = btf_dirset_count(d->lights);
  b.view0 = (uint32_t)v * r->views;
  b.x0 = (uint32_t)x * r->width;
  b.y0 = (uint32_t)y * r->height;
  b.views = at_most(r->views, btf_dirset_count(d->views) - b.view0);
  b.width = at_most(r->width, d->width - b.x0);
  b.height = at_most(r->height, d->height - b.y0);
  bytes.channel = sizeof(float);
  if (d->order == BTF_ORDER_YXVLC) {
    bytes.light = 3 * bytes.channel;
    bytes.view = bytes.light * (ptrdiff_t)b.lights;
    bytes.x = bytes.view * (ptrdiff_t)b.views;
    bytes.y = bytes.x * (ptrdiff_t)b.width;
  } else {
    bytes.x = 3 * bytes.channel;
    bytes.y = bytes.x * (ptrdiff_t)b.width;
    bytes.light = bytes.y * (ptrdiff_t)b.height;
    bytes.view = bytes.light * (ptrdiff_t)b.lights;
  }
  if (!sample_block(r, thread, &b, &bytes)) {
    fail_run(r, BTF_E_CANCELLED, "cancelled");
    return false;
  }
  const btf_status status = btf_dataset_writer_put(r->writer, &b, r->workers[thread].samples, &bytes);
  if (status != BTF_OK) fail_run(r, status, btf_error_message());
  return status == BTF_OK;
}

/* Thread 0 is the caller's. Without blocks left it waits for the others, so that somebody still asks the job.
 */
static void wait_for_others(run *r) {
  const struct timespec moment = {0, 5000000};
  while (atomic_load(&r->done) < total_texels(r) && atomic_load(&r->failure) == BTF_OK) {
    nanosleep(&moment, NULL);
    r->watch.fraction = (double)atomic_load(&r->done) / (double)total_texels(r);
    if (synth_watch_stops(&r->watch)) fail_run(r, BTF_E_CANCELLED, "cancelled");
  }
}

static bool work(void *user, uint64_t index, uint32_t thread) {
  run *r = user;
  const uint64_t total = (uint64_t)r->blocks_v * r->blocks_x * r->blocks_y;
  (void)index;
  for (;;) {
    const uint64_t block = atomic_fetch_add(&r->next, 1);
    if (block >= total || atomic_load(&r->failure) != BTF_OK) break;
    if (!make_block(r, block, thread)) break;
  }
  if (thread == 0) wait_for_others(r);
  return true;
}

static void workers_free(run *r, uint32_t threads) {
  for (uint32_t i = 0; r->workers != NULL && i < threads; ++i) {
    free(r->workers[i].samples);
#ifdef BTF_EMBREE_MAJOR
    tracer_free(r->workers[i].tracer);
#endif
  }
  free(r->workers);
}

static btf_status workers_create(run *r, uint32_t threads) {
  const size_t floats = (size_t)r->views * r->width * r->height * btf_dirset_count(r->desc->lights) * 3;
  r->workers = calloc(threads, sizeof *r->workers);
  if (r->workers == NULL) return btf_source_error(BTF_E_NOMEM, "%s: out of memory", r->desc->name);
  for (uint32_t i = 0; i < threads; ++i) {
    r->workers[i].samples = malloc(floats * sizeof(float));
    if (r->workers[i].samples == NULL)
      return btf_source_error(BTF_E_NOMEM, "%s: out of memory", r->desc->name);
#ifdef BTF_EMBREE_MAJOR
    if (r->source->meso != NULL) {
      const btf_status status =
          tracer_create(r->source->meso, r->source->lights, r->desc, RECORDED_PACKETS, &r->workers[i].tracer);
      if (status != BTF_OK) return status;
      r->workers[i].tracer->watch = &r->watch;
    }
#endif
  }
  return BTF_OK;
}

#ifdef BTF_EMBREE_MAJOR
typedef struct replay {
  const run *run;
  double *rates;
} replay;

static bool replay_one(void *user, uint64_t index, uint32_t thread) {
  const replay *p = user;
  (void)thread;
  p->rates[index] = tracer_embree_rate(p->run->source->meso, &p->run->workers[index].tracer->record);
  return true;
}

static void ray_stats(const run *r, uint32_t threads, synth_stats *stats) {
  double *rates = calloc(threads, sizeof *rates);
  const mesostructure *m = r->source->meso;
  if (m == NULL || rates == NULL) {
    free(rates);
    return;
  }
  replay p = {r, rates};
  parallel_for(threads, threads, replay_one, &p);
  for (uint32_t i = 0; i < threads; ++i) {
    stats->embree_rays_per_second += rates[i];
    stats->path_rays += r->workers[i].tracer->path_rays;
    stats->shadow_rays += r->workers[i].tracer->shadow_rays;
  }
  for (uint32_t i = 0; i < MESO_MAX_PARTS; ++i) stats->triangles += m->parts[i].triangle_count;
  free(rates);
}
#endif

static btf_status create_writer(btf_context *ctx, const synth_desc *desc, const synth_material *material,
                                const char *path, btf_dataset_writer **out) {
  static const char *const rgb[3] = {"R", "G", "B"};
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  d.lights = desc->lights;
  d.views = desc->views;
  d.width = desc->width;
  d.height = desc->height;
  d.channels = 3;
  d.channel_names = rgb;
  d.sample_type = desc->sample_type;
  d.quantity = BTF_QUANTITY_BRDF;
  d.scale = BTF_SCALE_ABSOLUTE;
  d.name = material->name;
  d.source = desc->source;
  d.texels_per_mm = (double)desc->width / material->tile_mm;
  return btf_dataset_writer_create(ctx, path, &d, desc->order, out);
}

btf_status synth_run(btf_context *ctx, const synth_desc *desc, const char *path, const btf_job *job,
                     synth_stats *stats) {
  const uint32_t threads = desc->threads > 0 ? desc->threads : 1;
  const double start = cli_seconds();
  double sampling;
  const synth_material *material;
  synth_source s = {0};
  run r = {.desc = desc, .source = &s};
  synth_stats counted = {0};
  btf_status status = synth_source_find(desc, &material);
  if (stats != NULL) *stats = counted;
  if (status != BTF_OK) return status;
  /* The writer first: a path that cannot be written to is found before the structure is built. */
  status = create_writer(ctx, desc, material, path, &r.writer);
  if (status != BTF_OK) return status;
  synth_watch_begin(&r.watch, job);
  r.watch.stage = "building";
  status = synth_source_open(desc, material, &r.watch, &s);
  counted.build_seconds = cli_seconds() - start;
  sampling = cli_seconds();
  if (status == BTF_OK) {
    plan_blocks(&r);
    r.watch.stage = "sampling";
    status = workers_create(&r, threads);
  }
  if (status == BTF_OK) {
    parallel_for(threads, threads, work, &r);
    status = atomic_load(&r.failure);
    if (status != BTF_OK) btf_source_error(status, "%s", r.message);
  }
  if (status == BTF_OK) {
    status = btf_dataset_writer_finish(r.writer);
    counted.seconds = cli_seconds() - sampling;
    counted.samples =
        (uint64_t)btf_dirset_count(desc->views) * btf_dirset_count(desc->lights) * desc->width * desc->height;
#ifdef BTF_EMBREE_MAJOR
    if (status == BTF_OK && stats != NULL) ray_stats(&r, threads, &counted);
#endif
  } else {
    /* Aborting must not replace the message. */
    char message[512];
    snprintf(message, sizeof message, "%s", btf_error_message());
    btf_dataset_writer_abort(r.writer);
    btf_source_error(status, "%s", message);
  }
  workers_free(&r, threads);
  synth_source_close(&s);
  if (stats != NULL) *stats = counted;
  return status;
}
