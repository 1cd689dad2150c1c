/* SPDX-License-Identifier: MIT */
/* codec_rules.h: what every codec must do, one function for each rule, and what they share. */
#ifndef CODEC_RULES_H
#define CODEC_RULES_H

#include "codec_cases.h"
#include "codec_suite.h"

typedef struct codec_rule {
  const char *name;
  void (*check)(const codec_case *row); /* fails by cmocka's assertions */
} codec_rule;
extern const codec_rule codec_eval_rules[], codec_fit_rules[];
extern const size_t codec_eval_rule_count, codec_fit_rule_count;

enum { RULE_CHANNELS = 4, RULE_QUERIES = 2000 };

/* A counting context with the codecs; test_context_done releases it. isa NULL = the best, threads 0 = all. */
btf_context *rule_context(test_memory *memory, const char *isa, uint32_t threads);
/* A model of a material; NULL if the row allows the codec to refuse the material and it does. */
btf_model *rule_fit(btf_context *ctx, const codec_case *row, uint32_t material, uint32_t channels,
                    const char *extra);
/* A container in memory. */
typedef struct rule_file {
  unsigned char *bytes;
  uint64_t size, capacity;
} rule_file;
void rule_save(btf_context *ctx, const btf_model *model, rule_file *out); /* free(out->bytes) */
btf_model *rule_load(btf_context *ctx, const rule_file *file);

btf_model_info rule_describe(const btf_model *model);
/* Largest magnitude of all decoded samples of all levels. */
double rule_largest(const btf_model *model);
/* Root mean square of the data of a level, and of the difference of the decoded samples. */
void rule_errors(const btf_model *model, uint32_t material, uint32_t level, double *rms, double *rmse);
/* The error of level 0 relative to the data, of a model of the material whose samples were multiplied by
 * scale. */
double rule_scaled_error(const btf_model *model, uint32_t material, double scale);
/* Largest difference of the two models over many queries inside the domain. */
double rule_difference(const btf_model *a, const btf_model *b);
/* Fails unless both evaluate every query of the list to the same bits. */
void rule_expect_equal(const btf_model *a, const btf_model *b);

/* RULE_QUERIES queries as a batch. */
typedef struct rule_batch {
  float arrays[9][RULE_QUERIES], results[RULE_CHANNELS][RULE_QUERIES];
  float *out[RULE_CHANNELS];
  btf_batch batch;
} rule_batch;
void rule_batch_make(rule_batch *b, uint32_t first, uint32_t flags);

#endif
