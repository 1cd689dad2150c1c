/* SPDX-License-Identifier: MIT */
/* The file is a matrix of cells (the channels of one texel, light and view): rows are texels and columns
 * direction pairs in a texel-major file, and the other way round in an image-major one. A block with few
 * columns of many rows, such as an image for a texel-major file, would take one tiny write for each row. Such
 * blocks gather in windows of neighbouring columns, which are written when they are full or when the room is
 * needed. */
#include "dataset/folder_writer.h"

#include <string.h>

enum { windows_most = 2, window_bytes_most = 64 << 20, good_columns = 32, short_run = 1024 };

uint64_t btfi_stage_window_bytes = (uint64_t)32 << 20;

typedef struct stage_window {
  uint64_t number; /* columns number * columns .. of the file; meaningless while `filled` is 0 */
  uint64_t filled; /* cells */
  uint64_t used;   /* clock of the last use */
  char *cells;     /* rows x columns; NULL until first used */
  uint64_t *bits;  /* cells that are filled, one row after another */
} stage_window;

struct btfi_write_stage {
  pthread_mutex_t mutex;
  uint64_t rows, columns; /* of the file */
  uint64_t window_columns;
  uint64_t cell; /* bytes */
  uint64_t clock;
  uint32_t window_count;
  stage_window windows[windows_most];
};

btf_status btfi_stage_create(btf_dataset_writer *w) {
  const uint64_t texels = (uint64_t)w->desc.width * w->desc.height;
  const uint64_t pairs = (uint64_t)btf_dirset_count(w->desc.views) * btf_dirset_count(w->desc.lights);
  btfi_write_stage *stage = btfi_calloc(w->ctx, 1, sizeof *stage);
  if (!stage) return btfi_alloc_status();
  const bool texel_rows = w->order == BTF_ORDER_YXVLC;
  stage->rows = texel_rows ? texels : pairs;
  stage->columns = texel_rows ? pairs : texels;
  stage->cell = (uint64_t)w->desc.channels * w->kernels.sample_size;
  const uint64_t column_bytes = stage->rows * stage->cell; /* at most the size of the file */
  uint64_t columns = btfi_stage_window_bytes / column_bytes;
  stage->window_count = windows_most;
  if (columns < good_columns) {
    columns = BTFI_MIN((uint64_t)good_columns, window_bytes_most / column_bytes);
    stage->window_count = 1;
  }
  stage->window_columns = BTFI_MIN(columns, stage->columns);
  pthread_mutex_init(&stage->mutex, NULL);
  w->stage = stage;
  return BTF_OK;
}

void btfi_stage_free(btf_dataset_writer *w) {
  if (!w->stage) return;
  for (uint32_t i = 0; i < windows_most; ++i) {
    btfi_free(w->ctx, w->stage->windows[i].cells);
    btfi_free(w->ctx, w->stage->windows[i].bits);
  }
  pthread_mutex_destroy(&w->stage->mutex);
  btfi_free(w->ctx, w->stage);
  w->stage = NULL;
}

/* The two axes of a block that make columns (neighbours in the file first) and the two that make rows. */
typedef struct stage_block {
  uint32_t column0[2], columns[2], row0[2], rows[2];
  uint32_t columns_inner, rows_inner; /* sizes of the inner axes in the file */
  ptrdiff_t column_stride[2], row_stride[2];
} stage_block;

static stage_block arrange(const btf_dataset_writer *w, const btf_block *b, const btf_strides *s) {
  const stage_block pair_columns = {{b->light0, b->view0},
                                    {b->lights, b->views},
                                    {b->x0, b->y0},
                                    {b->width, b->height},
                                    btf_dirset_count(w->desc.lights),
                                    w->desc.width,
                                    {s->light, s->view},
                                    {s->x, s->y}};
  const stage_block texel_columns = {{b->x0, b->y0},        {b->width, b->height},
                                     {b->light0, b->view0}, {b->lights, b->views},
                                     w->desc.width,         btf_dirset_count(w->desc.lights),
                                     {s->x, s->y},          {s->light, s->view}};
  return w->order == BTF_ORDER_YXVLC ? pair_columns : texel_columns;
}

bool btfi_stage_wants(const btf_dataset_writer *w, const btf_block *block) {
  static const btf_strides unused = {0, 0, 0, 0, 0};
  const btfi_write_stage *stage = w->stage;
  const stage_block b = arrange(w, block, &unused);
  uint64_t run = b.columns[0];
  if (b.columns[0] == b.columns_inner) run *= b.columns[1];
  return run < stage->columns && run * stage->cell < short_run && stage->window_columns > run &&
         (uint64_t)b.rows[0] * b.rows[1] >= 16;
}

/* ---- windows ---- */

static bool bit_at(const stage_window *window, uint64_t i) {
  return window->bits[i / 64] >> (i % 64) & 1u;
}

static btf_status flush_row(btf_dataset_writer *w, const stage_window *window, uint64_t row,
                            uint64_t columns) {
  const btfi_write_stage *stage = w->stage;
  const uint64_t start = row * stage->window_columns;
  for (uint64_t i = 0; i < columns; ++i) {
    if (!bit_at(window, start + i)) continue;
    uint64_t end = i + 1;
    while (end < columns && bit_at(window, start + end)) ++end;
    const uint64_t offset = (row * stage->columns + window->number * stage->window_columns + i) * stage->cell;
    BTFI_TRY(
        btfi_writer_pwrite(w, window->cells + (start + i) * stage->cell, (end - i) * stage->cell, offset));
    i = end;
  }
  return BTF_OK;
}

static uint64_t columns_of(const btfi_write_stage *stage, uint64_t number) {
  return BTFI_MIN(stage->window_columns, stage->columns - number * stage->window_columns);
}

static btf_status flush_window(btf_dataset_writer *w, stage_window *window) {
  btfi_write_stage *stage = w->stage;
  if (window->filled == 0) return BTF_OK;
  for (uint64_t row = 0; row < stage->rows; ++row)
    BTFI_TRY(flush_row(w, window, row, columns_of(stage, window->number)));
  memset(window->bits, 0, (stage->rows * stage->window_columns + 63) / 64 * sizeof *window->bits);
  window->filled = 0;
  return BTF_OK;
}

static btf_status find_window(btf_dataset_writer *w, uint64_t number, stage_window **out) {
  btfi_write_stage *stage = w->stage;
  stage_window *oldest = &stage->windows[0];
  for (uint32_t i = 0; i < stage->window_count; ++i) {
    stage_window *window = &stage->windows[i];
    if (window->filled > 0 && window->number == number) {
      *out = window;
      window->used = ++stage->clock;
      return BTF_OK;
    }
    if (window->filled == 0 ? oldest->filled > 0 : oldest->filled > 0 && window->used < oldest->used)
      oldest = window;
  }
  BTFI_TRY(flush_window(w, oldest));
  const uint64_t cells = stage->rows * stage->window_columns;
  if (!oldest->cells) oldest->cells = btfi_alloc(w->ctx, cells, stage->cell);
  if (oldest->cells && !oldest->bits)
    oldest->bits = btfi_calloc(w->ctx, (cells + 63) / 64, sizeof *oldest->bits);
  if (!oldest->bits) return btfi_alloc_status();
  oldest->number = number;
  oldest->used = ++stage->clock;
  *out = oldest;
  return BTF_OK;
}

static void mark(stage_window *window, uint64_t start, uint64_t n) {
  for (uint64_t i = start; i < start + n; ++i) {
    const uint64_t bit = (uint64_t)1 << (i % 64);
    if (!(window->bits[i / 64] & bit)) ++window->filled;
    window->bits[i / 64] |= bit;
  }
}

/* Columns first .. first + n - 1 of the file, all in one window; src is the sample of the first of the
 * block's rows. */
static btf_status put_columns(btf_dataset_writer *w, const stage_block *b, uint64_t first, uint64_t n,
                              const char *src, ptrdiff_t channel_stride, bool *fits) {
  btfi_write_stage *stage = w->stage;
  stage_window *window = NULL;
  BTFI_TRY(find_window(w, first / stage->window_columns, &window));
  const uint64_t column = first % stage->window_columns;
  const ptrdiff_t cell = (ptrdiff_t)stage->cell, row = cell * (ptrdiff_t)stage->window_columns;
  const uint64_t row0 = (uint64_t)b->row0[1] * b->rows_inner + b->row0[0];
  const btfi_axis axes[4] = {{w->desc.channels, channel_stride, (ptrdiff_t)w->kernels.sample_size},
                             {(size_t)n, b->column_stride[0], cell},
                             {b->rows[0], b->row_stride[0], row},
                             {b->rows[1], b->row_stride[1], row * (ptrdiff_t)b->rows_inner}};
  *fits = btfi_pack_block(&w->kernels, axes, 4, src,
                          window->cells + (ptrdiff_t)row0 * row + (ptrdiff_t)column * cell);
  if (!*fits) return BTF_OK;
  for (uint64_t j = 0; j < b->rows[1]; ++j)
    for (uint64_t i = 0; i < b->rows[0]; ++i)
      mark(window, (row0 + j * b->rows_inner + i) * stage->window_columns + column, n);
  return window->filled == stage->rows * columns_of(stage, window->number) ? flush_window(w, window) : BTF_OK;
}

static btf_status put_locked(btf_dataset_writer *w, const stage_block *b, const char *src,
                             ptrdiff_t channel_stride, bool *fits) {
  const uint64_t window_columns = w->stage->window_columns;
  for (uint32_t j = 0; j < b->columns[1]; ++j) {
    const uint64_t line = (uint64_t)(b->column0[1] + j) * b->columns_inner + b->column0[0];
    for (uint64_t i = 0; i < b->columns[0] && *fits;) {
      const uint64_t room = window_columns - (line + i) % window_columns;
      const uint64_t n = BTFI_MIN(room, b->columns[0] - i);
      BTFI_TRY(put_columns(w, b, line + i, n,
                           src + (ptrdiff_t)j * b->column_stride[1] + (ptrdiff_t)i * b->column_stride[0],
                           channel_stride, fits));
      i += n;
    }
  }
  return BTF_OK;
}

btf_status btfi_stage_put(btf_dataset_writer *w, const btf_block *block, const float *src,
                          const btf_strides *strides) {
  const stage_block b = arrange(w, block, strides);
  bool fits = true;
  pthread_mutex_lock(&w->stage->mutex);
  const btf_status status = put_locked(w, &b, (const char *)src, strides->channel, &fits);
  pthread_mutex_unlock(&w->stage->mutex);
  return status == BTF_OK && !fits ? btfi_writer_fail_value(w, block, src, strides) : status;
}

btf_status btfi_stage_flush(btf_dataset_writer *w) {
  for (uint32_t i = 0; i < w->stage->window_count; ++i) BTFI_TRY(flush_window(w, &w->stage->windows[i]));
  return BTF_OK;
}
