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

/* Bytes beside the codebook, the search and 12 bytes a vector. */
uint64_t btfi_cmf_kmeans_bytes(uint64_t count, uint32_t length, uint32_t entries, uint32_t threads);
uint64_t btfi_cmf_tree_bytes(uint64_t count, uint32_t length, uint32_t entries, uint32_t threads);
btf_status btfi_cmf_kmeans(btfi_cmf_clustering *c);
/* Makes entries; vectors are assigned afterwards. */
btf_status btfi_cmf_tree(btfi_cmf_clustering *c);

/* Starting entries of k-means (seeds.c). Bytes beside that. */
uint64_t btfi_cmf_seeds_bytes(uint64_t count, uint32_t length, uint32_t threads);
/* Vectors that start k-means. Places that remain when all distances are 0 get the first one again. */
btf_status btfi_cmf_seeds(btfi_cmf_clustering *c, double to, uint32_t *ids);

/* The sum of the distances. */
double btfi_cmf_inertia(const double *distance, uint64_t count);

#endif
