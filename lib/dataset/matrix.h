/* SPDX-License-Identifier: MIT */
/* matrix.h: a data set as a matrix that is read in blocks, and its statistics. */
#ifndef BTFI_DATASET_MATRIX_H
#define BTFI_DATASET_MATRIX_H

#include <stdbool.h>

#include "dataset/dataset.h"

/* Rows of the matrix are (view, light, channel), columns are texels. Items are images (rows) where those are
 * cheap to read, otherwise texels (columns). */
typedef struct btfi_matrix {
  btf_context *ctx;
  const btf_dataset *ds;
  uint32_t views, lights, channels, width, height;
  bool by_image;
  uint32_t layout;        /* BTF_LAYOUT_* of what is read */
  uint64_t rows, texels;  /* of the matrix */
  uint64_t items, length; /* of what is read: (rows, texels) or (texels, rows) */
  uint32_t block_items;   /* items that are best read together */
  const float *mean;      /* `rows` values to take away, or NULL */
  float *partial;         /* channels x texels, for reads that begin or end within a pixel's channels */
} btfi_matrix;

/* In the direction that its samples lie in; one that a decomposition may hold, with the fewer items. */
btf_status btfi_matrix_open(btf_context *ctx, const btf_dataset *ds, uint64_t max_working_set,
                            btfi_matrix *out);
btf_status btfi_matrix_open_by(btf_context *ctx, const btf_dataset *ds, bool by_image, btfi_matrix *out);
/* Whether the matrix is so small beside a budget that it is read once and kept. */
bool btfi_matrix_is_held(const btfi_matrix *matrix, uint64_t max_working_set);
void btfi_matrix_close(btfi_matrix *matrix);
/* A btf_matrix_read_fn in the matrix's layout; `matrix` is a btfi_matrix. */
btf_status btfi_matrix_read(void *matrix, uint64_t item0, uint64_t items, float *dst, size_t ld);

/* btf_host.measure (statistics.c) */
btf_status btfi_measure(btf_context *ctx, const btf_dataset *ds, uint64_t max_working_set, float *mean,
                        btf_statistics *out, const btf_job *job, double from, double to);

#endif
