/* SPDX-License-Identifier: MIT */
/* test_cmf_vectors.h: vectors to cluster, and a search for the nearest entries of a codebook of its own. */
#ifndef TEST_CMF_VECTORS_H
#define TEST_CMF_VECTORS_H

#include "btf_test.h"

#include "cluster_parts.h"
#include "registry/registry.h"

double random_normal(uint64_t *state);

typedef struct sample {
  uint64_t count;
  uint32_t length;
  float *values;
  uint8_t *bytes; /* instead of values */
} sample;

btfi_cmf_vectors vectors_of(const sample *s);
sample sample_create(uint64_t count, uint32_t length); /* free(values) */
/* Smooth curves of four random waves that differ in phase and amplitude, as factors of similar texels do. */
sample sample_curves(uint64_t count, uint32_t length, uint64_t seed);

double distance_to(const sample *s, uint64_t v, const float *entry); /* squared */
/* Every vector is with its nearest entry, ties with the lowest, and distances (may be NULL) are right. */
void expect_nearest(const sample *s, const float *values, uint32_t entries, const uint32_t *index,
                    const double *distance);

btfi_cmf_codebook make_codebook(btf_context *ctx, const sample *s, uint32_t method, uint32_t entries,
                                uint64_t seed);
void free_codebook(btf_context *ctx, btfi_cmf_codebook *codebook);

#endif
