/* SPDX-License-Identifier: MIT */
/* test_cmf_bench.h: one ABRDF, planted or given, and its factorisation by a chain. */
#ifndef TEST_CMF_BENCH_H
#define TEST_CMF_BENCH_H

#include "btf_test.h"

#include "factor.h"

typedef struct bench {
  btf_context *ctx;
  btf_dirset *set;
  uint32_t count;
  btfi_cmf_geometry *g;
  float *abrdf, *maps;
  void *scratch;
} bench;

/* Tables of 32 in angles, maps of edge 32. */
btfi_cmf_settings settings_of_chain(const char *chain);
bench bench_open(const char *directions, const btfi_cmf_settings *settings);
void bench_close(bench *b); /* and expects that no memory is left */

typedef double (*planted_fn)(const float l[3], const float v[3]);
void bench_plant(bench *b, planted_fn f);
/* Relative RMS error of the factorisation. */
double bench_factor(const bench *b);
double plant_and_factor(const char *directions, const btfi_cmf_settings *settings, planted_fn f);
/* T06: the first term of positive data is positive, also in maps. */
void bench_expect_positive(const bench *b);

#endif
