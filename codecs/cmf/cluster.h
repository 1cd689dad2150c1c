/* SPDX-License-Identifier: MIT */
/* cluster.h: codebooks of vectors (docs/codecs/cmf.md): k-means and two trees.
 *
 * Vectors are read whenever they are needed, so they may be kept as bytes or halves. Assignments are the
 * exact ones of the codebook, ties to the lower entry; results depend on the seed but not on the number of
 * threads. */
#ifndef BTFI_CMF_CLUSTER_H
#define BTFI_CMF_CLUSTER_H

#include <stddef.h>
#include <stdint.h>

#include <btf/btf_plugin.h>

enum { CMF_KMEANS = 0, CMF_TSVQ = 1, CMF_MEDIAN_CUT = 2, CMF_CLUSTERINGS };
enum { CMF_MAX_ENTRIES = 65536, CMF_MAX_VECTOR = 1 << 24 };

/* `read` writes the `length` values of a vector, which must be finite. It is called from several tasks at
 * once and cannot fail. */
typedef struct btfi_cmf_vectors {
  uint64_t count; /* 1 .. 2^32 - 1 */
  uint32_t length;
  void (*read)(const void *user, uint64_t index, float *dst);
  const void *user;
} btfi_cmf_vectors;

typedef struct btfi_cmf_cluster_options {
  uint32_t method;         /* CMF_KMEANS .. */
  uint32_t entries;        /* wanted, 1 .. CMF_MAX_ENTRIES */
  uint32_t max_iterations; /* of k-means; 0 = 100 */
  double tolerance; /* k-means stops when an iteration gains less than this part of the inertia; 0 = 1e-4 */
  uint64_t seed;
  uint64_t max_working_set; /* bytes beside the vectors and with the result; 0 = 1 GiB */
} btfi_cmf_cluster_options;

/* What btfi_cmf_cluster makes. Every entry is used, so there are fewer than wanted where there are fewer
 * distinct vectors. Arrays are owned by the result. */
typedef struct btfi_cmf_codebook {
  uint32_t entries, length;
  float *values;   /* entries x length */
  uint32_t *index; /* of each vector, the entry nearest to it */
  double inertia;  /* sum of squared distances to it */
  uint32_t iterations;
  double *history; /* iterations values: the inertia that each found, k-means only */
} btfi_cmf_codebook;

/* Progress goes from `from` to `to` with the name `stage`. BTF_E_LIMIT names the budget that would do. */
btf_status btfi_cmf_cluster(const btf_host *host, btf_context *ctx, const btfi_cmf_vectors *vectors,
                            const btfi_cmf_cluster_options *options, const btf_job *job, double from,
                            double to, const char *stage, btfi_cmf_codebook *out);
void btfi_cmf_codebook_free(const btf_host *host, btf_context *ctx, btfi_cmf_codebook *codebook);

/* The nearest of `entries` x vectors->length values for each vector and, unless NULL, the squared distance to
 * it. */
btf_status btfi_cmf_assign(const btf_host *host, btf_context *ctx, const btfi_cmf_vectors *vectors,
                           const float *values, uint32_t entries, uint64_t max_working_set,
                           const btf_job *job, double from, double to, const char *stage, uint32_t *index,
                           double *distance);

#endif
