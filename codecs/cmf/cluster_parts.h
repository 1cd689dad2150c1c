/* SPDX-License-Identifier: MIT */
/* cluster_parts.h: what the clusterings share. */
#ifndef BTFI_CMF_CLUSTER_PARTS_H
#define BTFI_CMF_CLUSTER_PARTS_H

#include "search.h"

typedef struct btfi_cmf_clustering {
  const btf_host *host;
  btf_context *ctx;
  const btfi_cmf_vectors *vectors;
  const btfi_cmf_cluster_options *options; /* without zeros that stand for defaults */
  const btf_job *job;
  double from, to;
  const char *stage;
  uint32_t entries; /* at most as many as vectors */
  btfi_cmf_search search;
  double *distance; /* of each vector to its entry, squared */
  btfi_cmf_codebook *out;
} btfi_cmf_clustering;

/* btfi_cmf_cluster with an assignment that k-means starts from; NULL = find one. Entries it leaves out are
 * filled. */
btf_status btfi_cmf_cluster_from(const btf_host *host, btf_context *ctx, const btfi_cmf_vectors *vectors,
                                 const btfi_cmf_cluster_options *options, const uint32_t *start,
                                 const btf_job *job, double from, double to, const char *stage,
                                 btfi_cmf_codebook *out);
/* What it needs of a budget, but for the search. */
uint64_t btfi_cmf_cluster_bytes(const btfi_cmf_cluster_options *options, int started, uint64_t count,
                                uint32_t length, uint32_t threads);

/* Lloyd's iterations from out->index. Bytes beside the codebook, the search and `distance`; so below. */
uint64_t btfi_cmf_lloyd_bytes(uint64_t count, uint32_t length, uint32_t entries, uint32_t threads);
btf_status btfi_cmf_lloyd(btfi_cmf_clustering *c, double from);
/* Sets out->index to where k-means starts. */
uint64_t btfi_cmf_start_bytes(uint64_t count, uint32_t length, uint32_t entries, uint32_t threads);
btf_status btfi_cmf_start(btfi_cmf_clustering *c, double to);
/* Makes entries; vectors are assigned afterwards. */
uint64_t btfi_cmf_tree_bytes(uint64_t count, uint32_t length, uint32_t entries, uint32_t threads);
btf_status btfi_cmf_tree(btfi_cmf_clustering *c);

/* The sum of the distances. */
double btfi_cmf_inertia(const double *distance, uint64_t count);

#endif
