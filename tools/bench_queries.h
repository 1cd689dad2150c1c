/* SPDX-License-Identifier: MIT */
/* bench_queries.h: queries as renderers ask them, for timing. */
#ifndef BTF_TOOLS_BENCH_QUERIES_H
#define BTF_TOOLS_BENCH_QUERIES_H

#include <stdbool.h>

#include <btf/btf.h>

enum {
  BENCH_COHERENT = 0, /* neighbouring pixels: position and directions change little by little */
  BENCH_RANDOM = 1,   /* everything anew for each query */
  BENCH_SHARED = 2,   /* one pair of directions for a batch, neighbouring positions */
  BENCH_ORDERS = 3
};
enum { BENCH_QUERIES = 16384, BENCH_BATCH = 4096 };

typedef struct bench_queries {
  btf_query *single;   /* BENCH_QUERIES */
  float *coordinates;  /* the same as arrays: light, view, uv */
  float *results;      /* channels x BENCH_BATCH */
  float **result_rows; /* channels */
} bench_queries;

/* false when out of memory; free what there is all the same. */
bool bench_queries_create(int order, const btf_model_info *model, bench_queries *out);
void bench_queries_free(bench_queries *q);

/* All queries once, one by one or in batches. */
void bench_queries_single(const bench_queries *q, const btf_model *model, uint32_t flags);
void bench_queries_batch(const bench_queries *q, const btf_model *model, uint32_t flags);

#endif
