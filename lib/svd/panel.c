/* SPDX-License-Identifier: MIT */
/* panel.c: panel products split among threads and caches, with BLAS where there is no kernel of our own. */
#include "svd/panel.h"

#include <cblas.h>
#include <string.h>

#include <btf/btf_plugin.h>

enum {
  DEPTH = 512, /* terms summed in registers between two writes: a basis of this many rows stays in L2 */
  LINE = 16    /* floats in a cache line */
};

typedef struct product_job {
  const btfi_slab *slab;
  const float *packed; /* the panel that is not written */
  float *projection, *image;
  double *norms;
  uint32_t width;
  size_t grains_per_task;
  btfi_tile_fn tile;
} product_job;

/* Vectors of the next tile of columns. Four are taken as two and two: a single one would wait for the
 * broadcasts. */
static uint32_t tile_vectors(uint32_t left) {
  return left == 4 ? 2 : BTFI_MIN(left, 3u);
}

/* One stripe of eight rows of c += a * b, where b is packed and `b_rows` rows high, of which those from
 * b_first on are meant. */
static void sweep_columns(const product_job *job, size_t depth, const float *a, size_t a_row, size_t a_step,
                          size_t b_rows, size_t b_first, float *c) {
  uint32_t vectors;
  for (uint32_t column = 0; column < job->width; column += vectors * BTFI_PANEL_GRAIN) {
    vectors = tile_vectors((job->width - column) / BTFI_PANEL_GRAIN);
    const size_t tile_width = (size_t)vectors * BTFI_PANEL_GRAIN;
    job->tile(vectors, depth, a, a_row, a_step, job->packed + b_rows * column + b_first * tile_width,
              tile_width, c + column, job->width);
  }
}

/* Squares of up to DEPTH elements are summed in float, the runs in double. */
static void add_norms(const btfi_slab *slab, size_t first, size_t last, size_t element, size_t count,
                      double *norms) {
  if (slab->element_step == 1) {
    for (size_t i = first; i < last; i++) {
      const float *x = slab->data + i * slab->item_step + element;
      float lane[16] = {0};
      size_t j = 0;
      for (; j + 16 <= count; j += 16)
        for (size_t l = 0; l < 16; l++) lane[l] += x[j + l] * x[j + l];
      double sum = 0;
      for (; j < count; j++) sum += (double)x[j] * x[j];
      for (size_t l = 0; l < 16; l++) sum += lane[l];
      norms[i] += sum;
    }
    return;
  }
  enum { RUN = 128 };
  for (size_t i = first; i < last; i += RUN) {
    const size_t run = BTFI_MIN((size_t)RUN, last - i);
    float lane[RUN] = {0};
    for (size_t j = 0; j < count; j++) {
      const float *x = slab->data + i + (element + j) * slab->element_step;
      for (size_t l = 0; l < run; l++) lane[l] += x[l] * x[l];
    }
    for (size_t l = 0; l < run; l++) norms[i + l] += lane[l];
  }
}

/* Fetches the next lines to L2 while the present ones are at work: slabs come from L3, in runs too short for
 * the processor to see them coming. */
static void fetch_lines(const float *from, size_t runs, size_t run_step, size_t run_length) {
  for (size_t run = 0; run < runs; run++) {
    for (size_t k = 0; k < run_length; k += LINE) __builtin_prefetch(from + run * run_step + k, 0, 2);
  }
}

/* stripes[s][t * 8 + row] = a[(8 s + row) + t * step] for one or two stripes of eight rows that lie side by
 * side. */
static void pack_stripes(size_t stripe_count, size_t depth, const float *a, size_t step, const float *next,
                         float (*stripes)[DEPTH * BTFI_SLAB_GRAIN]) {
  for (size_t t = 0; t < depth; t++) {
    if (next != NULL) __builtin_prefetch(next + t * step, 0, 2);
    for (size_t s = 0; s < stripe_count; s++)
      memcpy(stripes[s] + t * BTFI_SLAB_GRAIN, a + t * step + s * BTFI_SLAB_GRAIN,
             BTFI_SLAB_GRAIN * sizeof(float));
  }
}

/* c (rows x width) += a (rows x depth) * b (depth x width) for `rows` rows of a; `after` is where the next
 * call will begin. */
static void multiply_rows(const product_job *job, size_t rows, size_t depth, const float *a, size_t a_row,
                          size_t a_step, const float *after, size_t b_rows, size_t b_first, float *c) {
  if (a_row != 1) {
    for (size_t row = 0; row < rows; row += BTFI_SLAB_GRAIN) {
      const float *next = row + BTFI_SLAB_GRAIN < rows ? a + (row + BTFI_SLAB_GRAIN) * a_row : after;
      if (next != NULL) fetch_lines(next, BTFI_SLAB_GRAIN, a_row, depth);
      sweep_columns(job, depth, a + row * a_row, a_row, a_step, b_rows, b_first, c + row * job->width);
    }
    return;
  }
  float stripes[2][DEPTH * BTFI_SLAB_GRAIN];
  for (size_t row = 0; row < rows; row += 2 * BTFI_SLAB_GRAIN) {
    const size_t count = row + BTFI_SLAB_GRAIN < rows ? 2 : 1;
    const float *next = row + 2 * BTFI_SLAB_GRAIN < rows ? a + row + 2 * BTFI_SLAB_GRAIN : after;
    pack_stripes(count, depth, a + row, a_step, next, stripes);
    for (size_t s = 0; s < count; s++)
      sweep_columns(job, depth, stripes[s], 1, BTFI_SLAB_GRAIN, b_rows, b_first,
                    c + (row + s * BTFI_SLAB_GRAIN) * job->width);
  }
}

static void project_task(void *user, uint32_t index, uint32_t thread) {
  const product_job *job = user;
  const btfi_slab *slab = job->slab;
  (void)thread;
  const size_t first = (size_t)index * job->grains_per_task * BTFI_SLAB_GRAIN;
  const size_t last = BTFI_MIN(slab->items, first + job->grains_per_task * BTFI_SLAB_GRAIN);
  if (job->tile != NULL)
    memset(job->projection + first * job->width, 0, (last - first) * job->width * sizeof(float));
  if (job->norms != NULL) memset(job->norms + first, 0, (last - first) * sizeof(double));
  for (size_t element = 0; element < slab->length; element += DEPTH) {
    const size_t depth = BTFI_MIN((size_t)DEPTH, slab->length - element);
    if (job->tile != NULL) {
      const float *a = slab->data + first * slab->item_step + element * slab->element_step;
      const float *after = element + 2 * DEPTH <= slab->length ? a + DEPTH * slab->element_step : NULL;
      multiply_rows(job, last - first, depth, a, slab->item_step, slab->element_step, after, slab->length,
                    element, job->projection + first * job->width);
    }
    if (job->norms != NULL) add_norms(slab, first, last, element, depth, job->norms);
  }
}

static void accumulate_task(void *user, uint32_t index, uint32_t thread) {
  const product_job *job = user;
  const btfi_slab *slab = job->slab;
  (void)thread;
  const size_t first = (size_t)index * job->grains_per_task * BTFI_SLAB_GRAIN;
  const size_t last = BTFI_MIN(slab->length, first + job->grains_per_task * BTFI_SLAB_GRAIN);
  for (size_t i = 0; i < slab->items; i += DEPTH) {
    const size_t depth = BTFI_MIN((size_t)DEPTH, slab->items - i);
    multiply_rows(job, last - first, depth, slab->data + i * slab->item_step + first * slab->element_step,
                  slab->element_step, slab->item_step, NULL, slab->items, i, job->image + first * job->width);
  }
}

static btf_status share_out(btf_context *ctx, product_job *job, size_t extent, btf_task_fn task) {
  const size_t grains = extent / BTFI_SLAB_GRAIN, threads = btfi_thread_count(ctx);
  /* Long tasks, since each reads all of the other operand; a few more than threads only where there is
   * plenty. */
  const size_t tasks =
      BTFI_MAX((size_t)1, grains >= 64 * threads ? 2 * threads : BTFI_MIN(grains / 4, threads));
  job->grains_per_task = (grains + tasks - 1) / tasks;
  const uint32_t count = (uint32_t)((grains + job->grains_per_task - 1) / job->grains_per_task);
  if (count == 1) {
    task(job, 0, 0);
    return BTF_OK;
  }
  return btfi_parallel(ctx, count, task, job);
}

void btfi_panel_pack(btf_context *ctx, const float *panel, size_t rows, uint32_t width, float *packed) {
  if (btfi_panel_tile(btfi_isa(ctx)) == NULL) {
    memcpy(packed, panel, rows * width * sizeof(float));
    return;
  }
  uint32_t vectors;
  for (uint32_t column = 0; column < width; column += vectors * BTFI_PANEL_GRAIN) {
    vectors = tile_vectors((width - column) / BTFI_PANEL_GRAIN);
    const size_t tile_width = (size_t)vectors * BTFI_PANEL_GRAIN;
    float *tile = packed + rows * column;
    for (size_t row = 0; row < rows; row++)
      memcpy(tile + row * tile_width, panel + row * width + column, tile_width * sizeof(float));
  }
}

btf_status btfi_slab_project(btf_context *ctx, const btfi_slab *slab, const float *packed_basis,
                             uint32_t width, float *projection, double *norms) {
  product_job job = {
      .slab = slab, .packed = packed_basis, .projection = projection, .norms = norms, .width = width};
  job.tile = btfi_panel_tile(btfi_isa(ctx));
  if (job.tile == NULL) {
    const int items = (int)slab->items, length = (int)slab->length, columns = (int)width;
    if (slab->element_step == 1)
      cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, items, columns, length, 1, slab->data,
                  (int)slab->item_step, packed_basis, columns, 0, projection, columns);
    else
      cblas_sgemm(CblasRowMajor, CblasTrans, CblasNoTrans, items, columns, length, 1, slab->data,
                  (int)slab->element_step, packed_basis, columns, 0, projection, columns);
    if (norms == NULL) return BTF_OK;
  }
  return share_out(ctx, &job, slab->items, project_task);
}

btf_status btfi_slab_accumulate(btf_context *ctx, const btfi_slab *slab, const float *packed_projection,
                                uint32_t width, float *image) {
  product_job job = {.slab = slab, .packed = packed_projection, .image = image, .width = width};
  job.tile = btfi_panel_tile(btfi_isa(ctx));
  if (job.tile != NULL) return share_out(ctx, &job, slab->length, accumulate_task);
  const int items = (int)slab->items, length = (int)slab->length, columns = (int)width;
  if (slab->element_step == 1)
    cblas_sgemm(CblasRowMajor, CblasTrans, CblasNoTrans, length, columns, items, 1, slab->data,
                (int)slab->item_step, packed_projection, columns, 1, image, columns);
  else
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, length, columns, items, 1, slab->data,
                (int)slab->element_step, packed_projection, columns, 1, image, columns);
  return BTF_OK;
}
