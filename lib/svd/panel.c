/* SPDX-License-Identifier: MIT */
/* panel.c: panel products split among threads and caches, with BLAS where there is no kernel of our own. */
#include "svd/panel.h"

#include <cblas.h>
#include <string.h>

#include <btf/btf_plugin.h>

enum {
  DEPTH = 256, /* terms summed in registers between two writes: a tile of columns this deep stays in L1 */
  ROWS = 64,   /* rows of the slab that meet all columns while they are in L2 */
  LINE = 16    /* floats in a cache line */
};

typedef struct product_job {
  const btfi_slab *slab;
  const float *packed; /* the panel that is not written */
  float *projection, *image;
  double *norms;
  uint32_t width;
  size_t grains_per_task;
  const btfi_panel_kernels *kernels;
} product_job;

/* Vectors of the next tile of columns. Four are taken as two and two: a single one would wait for the
 * broadcasts. */
static uint32_t tile_vectors(uint32_t left) {
  return left == 4 ? 2 : BTFI_MIN(left, 3u);
}

/* A part of the slab: element t of row i at data[i * row + t * step]. */
typedef struct part {
  const float *data;
  size_t row, step, rows, depth;
} part;

/* The lines of the part that comes next, for each tile to fetch some to L2 while it is at work: slabs come
 * from L3 or memory, in runs too short for the processor to see them coming. A tile takes one line of each of
 * some runs. */
typedef struct fetch_list {
  const float *data;
  size_t run_step, runs, lines; /* lines of a run */
  size_t share;                 /* runs for each tile */
} fetch_list;

static fetch_list fetch_list_of(const part *next, size_t depth) {
  const bool columns = next->row == 1;
  fetch_list list = {next->data, columns ? next->step : next->row, columns ? next->depth : next->rows, 0,
                     (depth + BTFI_TILE_FETCH - 1) / BTFI_TILE_FETCH};
  list.lines = ((columns ? next->rows : next->depth) + LINE - 1) / LINE;
  return list;
}

/* Where tile number `tile` starts. Beyond the end, anything will do that is in L2 already. */
static const float *fetch_start(const fetch_list *list, size_t tile, const float *otherwise, size_t *step) {
  const size_t run = list->lines == 0 ? 0 : tile / list->lines * list->share;
  *step = 0;
  if (run >= list->runs) return otherwise;
  *step = list->run_step;
  return list->data + run * list->run_step + tile % list->lines * LINE;
}

/* c (rows x width) += a * b, where b is packed and b_rows rows high, of which those from b_first on are
 * meant. */
static void multiply_part(const product_job *job, const part *a, const part *next, size_t b_rows,
                          size_t b_first, float *c, double *norms) {
  /* Stripes a multiple of 4 KiB apart would meet in one set of the cache. */
  enum { STRIPE_PAD = LINE };
  _Alignas(64) float stripes[ROWS * (DEPTH + STRIPE_PAD / 4)];
  const btfi_panel_kernels *kernels = job->kernels;
  const size_t rows = kernels->rows, vector = kernels->vector;
  const float *from = a->data;
  size_t row = a->row, step = a->step, stripe = rows * a->row;
  if (a->row == 1) {
    from = stripes;
    step = rows;
    stripe = rows * DEPTH + STRIPE_PAD;
    kernels->stripe(a->rows, a->depth, a->data, a->step, stripes, stripe, norms);
  } else if (norms != NULL) {
    for (size_t i = 0; i < a->rows; i++) norms[i] += kernels->square(a->data + i * a->row, a->depth);
  }
  const fetch_list list = fetch_list_of(next, a->depth);
  size_t tile = 0, fetch_step;
  uint32_t vectors;
  for (uint32_t column = 0; column < job->width; column += vectors * (uint32_t)vector) {
    vectors = tile_vectors((job->width - column) / (uint32_t)vector);
    const size_t columns = vectors * vector;
    const float *b = job->packed + b_rows * column + b_first * columns;
    for (size_t i = 0; i < a->rows; i += rows) {
      float *sums = c + i * job->width + column;
      if (i + rows < a->rows) {
        for (size_t k = rows; k < 2 * rows; k++) {
          for (size_t j = 0; j < columns; j += LINE) __builtin_prefetch(sums + k * job->width + j, 1);
        }
      }
      const float *fetch = fetch_start(&list, tile++, from, &fetch_step);
      kernels->tile(vectors, a->depth, from + i / rows * stripe, row, step, b, sums, job->width, fetch,
                    fetch_step);
    }
  }
}

/* c (rows x width) += a (rows x depth) * b (depth x width). */
static void multiply(const product_job *job, const part *a, float *c, double *norms) {
  part now = *a, next;
  for (size_t t = 0, i = 0; t < a->depth;) {
    now.data = a->data + i * a->row + t * a->step;
    now.rows = BTFI_MIN((size_t)ROWS, a->rows - i);
    now.depth = BTFI_MIN((size_t)DEPTH, a->depth - t);
    const size_t here = i, first = t;
    i += now.rows;
    if (i == a->rows) {
      i = 0;
      t += now.depth;
    }
    next = now;
    next.data = a->data + i * a->row + t * a->step;
    next.rows = t < a->depth ? BTFI_MIN((size_t)ROWS, a->rows - i) : 0;
    next.depth = t < a->depth ? BTFI_MIN((size_t)DEPTH, a->depth - t) : 0;
    multiply_part(job, &now, &next, a->depth, first, c + here * job->width,
                  norms == NULL ? NULL : norms + here);
  }
}

/* Short runs of squares are summed in float, the runs in double. */
static void add_norms(const btfi_slab *slab, double *norms) {
  enum { RUN = 16 };
  memset(norms, 0, slab->items * sizeof(double));
  for (size_t element = 0; element < slab->length; element += RUN) {
    const size_t last = BTFI_MIN(slab->length, element + RUN);
    for (size_t i = 0; i < slab->items; i += BTFI_SLAB_GRAIN) {
      float lane[BTFI_SLAB_GRAIN] = {0};
      for (size_t j = element; j < last; j++) {
        const float *x = slab->data + i * slab->item_step + j * slab->element_step;
        for (size_t l = 0; l < BTFI_SLAB_GRAIN; l++)
          lane[l] += x[l * slab->item_step] * x[l * slab->item_step];
      }
      for (size_t l = 0; l < BTFI_SLAB_GRAIN; l++) norms[i + l] += lane[l];
    }
  }
}

static void project_task(void *user, uint32_t index, uint32_t thread) {
  const product_job *job = user;
  const btfi_slab *slab = job->slab;
  (void)thread;
  const size_t first = (size_t)index * job->grains_per_task * BTFI_SLAB_GRAIN;
  const size_t last = BTFI_MIN(slab->items, first + job->grains_per_task * BTFI_SLAB_GRAIN);
  memset(job->projection + first * job->width, 0, (last - first) * job->width * sizeof(float));
  if (job->norms != NULL) memset(job->norms + first, 0, (last - first) * sizeof(double));
  const part a = {slab->data + first * slab->item_step, slab->item_step, slab->element_step, last - first,
                  slab->length};
  multiply(job, &a, job->projection + first * job->width, job->norms == NULL ? NULL : job->norms + first);
}

static void accumulate_task(void *user, uint32_t index, uint32_t thread) {
  const product_job *job = user;
  const btfi_slab *slab = job->slab;
  (void)thread;
  const size_t first = (size_t)index * job->grains_per_task * BTFI_SLAB_GRAIN;
  const size_t last = BTFI_MIN(slab->length, first + job->grains_per_task * BTFI_SLAB_GRAIN);
  const part a = {slab->data + first * slab->element_step, slab->element_step, slab->item_step, last - first,
                  slab->items};
  multiply(job, &a, job->image + first * job->width, NULL);
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
  const btfi_panel_kernels *kernels = btfi_panel_kernels_for(btfi_isa(ctx));
  if (kernels == NULL) {
    memcpy(packed, panel, rows * width * sizeof(float));
    return;
  }
  uint32_t vectors;
  for (uint32_t column = 0; column < width; column += vectors * kernels->vector) {
    vectors = tile_vectors((width - column) / kernels->vector);
    const size_t tile_width = (size_t)vectors * kernels->vector;
    float *tile = packed + rows * column;
    for (size_t row = 0; row < rows; row++)
      memcpy(tile + row * tile_width, panel + row * width + column, tile_width * sizeof(float));
  }
}

btf_status btfi_slab_project(btf_context *ctx, const btfi_slab *slab, const float *packed_basis,
                             uint32_t width, float *projection, double *norms) {
  product_job job = {
      .slab = slab, .packed = packed_basis, .projection = projection, .norms = norms, .width = width};
  job.kernels = btfi_panel_kernels_for(btfi_isa(ctx));
  if (job.kernels != NULL) return share_out(ctx, &job, slab->items, project_task);
  const int items = (int)slab->items, length = (int)slab->length, columns = (int)width;
  if (slab->element_step == 1)
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, items, columns, length, 1, slab->data,
                (int)slab->item_step, packed_basis, columns, 0, projection, columns);
  else
    cblas_sgemm(CblasRowMajor, CblasTrans, CblasNoTrans, items, columns, length, 1, slab->data,
                (int)slab->element_step, packed_basis, columns, 0, projection, columns);
  if (norms != NULL) add_norms(slab, norms);
  return BTF_OK;
}

btf_status btfi_slab_accumulate(btf_context *ctx, const btfi_slab *slab, const float *packed_projection,
                                uint32_t width, float *image) {
  product_job job = {.slab = slab, .packed = packed_projection, .image = image, .width = width};
  job.kernels = btfi_panel_kernels_for(btfi_isa(ctx));
  if (job.kernels != NULL) return share_out(ctx, &job, slab->length, accumulate_task);
  const int items = (int)slab->items, length = (int)slab->length, columns = (int)width;
  if (slab->element_step == 1)
    cblas_sgemm(CblasRowMajor, CblasTrans, CblasNoTrans, length, columns, items, 1, slab->data,
                (int)slab->item_step, packed_projection, columns, 1, image, columns);
  else
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, length, columns, items, 1, slab->data,
                (int)slab->element_step, packed_projection, columns, 1, image, columns);
  return BTF_OK;
}
