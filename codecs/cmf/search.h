/* SPDX-License-Identifier: MIT */
/* search.h: exact nearest entries of a codebook, for the clusterings of cluster.h. */
#ifndef BTFI_CMF_SEARCH_H
#define BTFI_CMF_SEARCH_H

#include "cluster.h"

/* Inner products of blocks of vectors with all entries come from gemm. They bracket each squared distance;
 * only entries whose bracket reaches down to the lowest upper end are measured exactly. Vectors and entries
 * are taken relative to the mean entry: brackets grow with the lengths. */
typedef struct btfi_cmf_search {
  const btf_host *host;
  btf_context *ctx;
  const btfi_cmf_vectors *vectors;
  uint32_t capacity, entries, rows; /* rows: vectors of a block */
  const float *values;              /* entries x length */
  float *origin, *centred;          /* mean entry; entries minus it */
  float *lowest, *highest, *slope;  /* of each entry, for the bracket */
  float *raw, *block, *product;     /* rows x length, the same minus origin, rows x entries */
} btfi_cmf_search;

/* What a search needs of max_working_set for blocks of that many rows. */
uint64_t btfi_cmf_search_bytes(uint32_t entries, uint32_t length, uint32_t rows);
/* Chooses the rows of a block for the bytes that are left; BTF_E_LIMIT names the budget that would do, of
 * which `used` are the caller's. */
btf_status btfi_cmf_search_create(const btf_host *host, btf_context *ctx, const btfi_cmf_vectors *vectors,
                                  uint32_t entries, uint64_t max_working_set, uint64_t used,
                                  btfi_cmf_search *out);
void btfi_cmf_search_free(btfi_cmf_search *search);
/* Takes `values`, which stay the caller's and must not change until the search is done. */
btf_status btfi_cmf_search_prepare(btfi_cmf_search *search, const float *values, uint32_t entries);

typedef struct btfi_cmf_search_report {
  const btf_job *job;
  double from, to;
  const char *stage;
} btfi_cmf_search_report;

/* Nearest entries of `count` vectors: those of `ids`, or the first ones if it is NULL. Results go to the
 * vectors' places: entry, squared distance, and (unless NULL) a lower bound of the distance to every other
 * entry. */
btf_status btfi_cmf_search_run(btfi_cmf_search *search, const uint32_t *ids, uint64_t count,
                               const btfi_cmf_search_report *report, uint32_t *index, double *distance,
                               double *others);

/* Sum of squared differences, in the same order everywhere; may stop once it exceeds `enough`. */
double btfi_cmf_distance(const float *a, const float *b, uint32_t length, double enough);

#endif
