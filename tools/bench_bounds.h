/* SPDX-License-Identifier: MIT */
/* bench_bounds.h: what this machine does at best, on one core. */
#ifndef BTF_TOOLS_BENCH_BOUNDS_H
#define BTF_TOOLS_BENCH_BOUNDS_H

#include <stddef.h>
#include <stdint.h>

typedef struct bench_bounds {
  double flops;        /* fused multiply-adds in registers, two operations each, per second */
  double half_values;  /* halves converted to floats and added up from cache, per second */
  double float_values; /* floats added up from cache, per second */
  double cache_bytes;  /* read from 256 KiB, per second */
  double memory_bytes; /* read from beyond the caches, per second */
  double random_rows; /* rows of bench_buffers.row_bytes read in random order from as much memory as the model
                         has, per second, each prefetched a few rows ahead */
} bench_bounds;

typedef struct bench_buffers {
  unsigned char *large; /* beyond the caches */
  size_t large_size;
  unsigned char *small;   /* 256 KiB */
  size_t row_bytes, span; /* set by the caller: size of a row, and of the memory the rows are spread over */
} bench_buffers;

/* Allocates and touches the buffers; an exit status. */
int bench_buffers_create(bench_buffers *out);
void bench_buffers_free(bench_buffers *b);
/* Measures once and keeps the better of each figure. */
void bench_bounds_measure(const bench_buffers *b, bench_bounds *best);
/* Instruction set of the kernels above. */
const char *bench_bounds_isa(void);

#endif
