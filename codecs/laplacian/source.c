/* SPDX-License-Identifier: MIT */
/* source.c: the images of a data set as rows of the matrices of bands. Bands are made anew for every reading,
 * so that none has to be held. */
#include "laplacian.h"

#include <math.h>

enum { MOST_IMAGES = 64, IMAGE_BYTES = 24 << 20 };

btf_status btfi_laplacian_source_open(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                                      const btf_dataset_desc *desc, const btfi_laplacian_grid *grid,
                                      uint64_t max_working_set, btfi_laplacian_source *out) {
  const uint64_t texels = (uint64_t)grid->width[0] * grid->height[0], threads = host->thread_count(ctx);
  memset(out, 0, sizeof *out);
  out->host = host;
  out->ctx = ctx;
  out->ds = ds;
  out->views = host->dirset_count(desc->views);
  out->lights = host->dirset_count(desc->lights);
  out->pairs = (uint64_t)out->views * out->lights;
  out->grid = *grid;
  BTF_TRY(btfi_laplacian_pyramid_create(host, ctx, grid, &out->pyramid));
  out->scratch_floats =
      3 * btfi_laplacian_pyramid_floats(out->pyramid) + btfi_laplacian_pyramid_scratch(out->pyramid);
  const uint64_t image_bytes = 3 * texels * sizeof(float);
  const uint64_t fixed = threads * out->scratch_floats * sizeof(float);
  out->least_working_set = 4 * (fixed + image_bytes);
  if (max_working_set < out->least_working_set) return BTF_E_LIMIT; /* the caller knows what else is needed */
  uint64_t most = (max_working_set / 4 - fixed) / image_bytes;
  if (most > IMAGE_BYTES / image_bytes) most = IMAGE_BYTES / image_bytes;
  if (most < threads) most = threads < (max_working_set / 4 - fixed) / image_bytes ? threads : most;
  if (most > MOST_IMAGES) most = MOST_IMAGES;
  out->images = most > 0 ? (uint32_t)most : 1;
  out->buffers = fixed + out->images * image_bytes;
  out->rgb = host->alloc(ctx, out->images, image_bytes);
  out->scratch = host->alloc(ctx, threads, out->scratch_floats * sizeof *out->scratch);
  return out->rgb != NULL && out->scratch != NULL ? BTF_OK : BTF_E_NOMEM;
}

void btfi_laplacian_source_close(btfi_laplacian_source *s) {
  if (s->host == NULL) return;
  s->host->free(s->ctx, s->rgb);
  s->host->free(s->ctx, s->scratch);
  btfi_laplacian_pyramid_destroy(s->pyramid);
}

void btfi_laplacian_plane(const btfi_laplacian_source *s, const float *rgb, uint32_t channel,
                          float *restrict dst) {
  const uint64_t texels = (uint64_t)s->grid.width[0] * s->grid.height[0];
  const float *r = rgb, *g = rgb + texels, *b = rgb + 2 * texels;
  switch (channel) { /* a loop for each, so that it has no branch */
  case LAPLACIAN_Y:
    for (uint64_t i = 0; i < texels; i++) dst[i] = btfi_laplacian_from_rgb(LAPLACIAN_Y, r[i], g[i], b[i]);
    break;
  case LAPLACIAN_CB:
    for (uint64_t i = 0; i < texels; i++) dst[i] = btfi_laplacian_from_rgb(LAPLACIAN_CB, r[i], g[i], b[i]);
    break;
  default:
    for (uint64_t i = 0; i < texels; i++) dst[i] = btfi_laplacian_from_rgb(LAPLACIAN_CR, r[i], g[i], b[i]);
  }
}

/* Reads `count` images into rgb. A run of pairs is a box only within one view. */
static btf_status read_images(const btfi_laplacian_source *s, uint64_t pair, uint32_t count) {
  const ptrdiff_t value = sizeof(float), line = value * s->grid.width[0], plane = line * s->grid.height[0];
  const btf_strides strides = {3 * plane * s->lights, 3 * plane, line, value, plane};
  float *dst = s->rgb;
  while (count > 0) {
    const uint32_t view = (uint32_t)(pair / s->lights), light = (uint32_t)(pair % s->lights);
    const uint32_t run = s->lights - light < count ? s->lights - light : count;
    const btf_block block = {view, 1, light, run, 0, 0, s->grid.width[0], s->grid.height[0]};
    BTF_TRY(s->host->dataset_read(s->ds, &block, dst, &strides));
    dst += 3 * (uint64_t)s->grid.width[0] * s->grid.height[0] * run;
    pair += run;
    count -= run;
  }
  return BTF_OK;
}

typedef struct images_job {
  const btfi_laplacian_source *source;
  uint64_t first;
  btfi_laplacian_image_fn visit;
  void *user;
} images_job;

static void visit_image(void *job, uint32_t index, uint32_t thread) {
  const images_job *j = job;
  const btfi_laplacian_source *s = j->source;
  float *planes = s->scratch + thread * s->scratch_floats;
  j->visit(j->user, s, j->first + index, s->rgb + 3 * (uint64_t)s->grid.width[0] * s->grid.height[0] * index,
           planes, planes + 3 * btfi_laplacian_pyramid_floats(s->pyramid), thread);
}

static btf_status some_images(btfi_laplacian_source *s, uint64_t first, uint32_t count,
                              btfi_laplacian_image_fn visit, void *user) {
  images_job job = {s, first, visit, user};
  BTF_TRY(read_images(s, first, count));
  return s->host->parallel(s->ctx, count, visit_image, &job);
}

btf_status btfi_laplacian_each_image(btfi_laplacian_source *s, const btf_job *job, double from, double to,
                                     const char *stage, btfi_laplacian_image_fn visit, void *user) {
  for (uint64_t pair = 0; pair < s->pairs; pair += s->images) {
    BTF_TRY(s->host->progress(job, from + (to - from) * (double)pair / (double)s->pairs, stage));
    const uint64_t left = s->pairs - pair;
    BTF_TRY(some_images(s, pair, left < s->images ? (uint32_t)left : s->images, visit, user));
  }
  return BTF_OK;
}

typedef struct band_rows {
  float *dst;
  size_t ld;
  uint64_t first;
} band_rows;

static void make_band_row(void *user, const btfi_laplacian_source *s, uint64_t pair, const float *rgb,
                          float *planes, float *scratch, uint32_t thread) {
  const band_rows *rows = user;
  const uint32_t k = s->read_level;
  const uint64_t texels = (uint64_t)s->grid.width[k] * s->grid.height[k];
  const float *band = planes + btfi_laplacian_pyramid_offset(s->pyramid, k);
  const float mean = s->mean != NULL && k + 1 == s->grid.levels ? s->mean[3 * pair + s->read_channel] : 0.0f;
  float *dst = rows->dst + (pair - rows->first) * rows->ld;
  (void)thread;
  btfi_laplacian_plane(s, rgb, s->read_channel, planes);
  btfi_laplacian_analyse(s->pyramid, k, planes, scratch);
  for (uint64_t i = 0; i < texels; i++) dst[i] = band[i] - mean;
}

btf_status btfi_laplacian_read(void *source, uint64_t item0, uint64_t items, float *dst, size_t ld) {
  btfi_laplacian_source *s = source;
  band_rows rows = {dst, ld, item0};
  for (uint64_t done = 0; done < items; done += s->images) {
    const uint64_t left = items - done;
    BTF_TRY(
        some_images(s, item0 + done, left < s->images ? (uint32_t)left : s->images, make_band_row, &rows));
  }
  return BTF_OK;
}
