/* SPDX-License-Identifier: MIT */
/* trial.h: exports of fitted models, evaluated by a renderer and compared with the C evaluation. One trial at
 * a time: queries and results are static. */
#ifndef TRIAL_H
#define TRIAL_H

#include "../btf_test.h"
#include "../codec_cases.h"
#include "gpu_folder.h"

/* Single precision on either side and the sampler's filter leave 1e-5 or so; what the contract of exports
 * allows is this much of the 99.9th percentile. */
#define TRIAL_TOLERANCE 1e-3

typedef struct trial_errors {
  double peak, largest, percentile;
  double beyond; /* what rounding explains; the largest of it */
} trial_errors;

/* Everything anywhere, or what a full-screen picture of a sphere asks. */
typedef enum trial_queries { TRIAL_RANDOM, TRIAL_PICTURE } trial_queries;

/* A part of the shader's text that is replaced wherever it stands, which must be somewhere. */
typedef struct trial_fault {
  codec_case row;
  const char *layout;
  uint32_t material;
  const char *what, *text, *replacement;
} trial_fault;

/* Whether the build has the codec; fails the test if that has no layout. */
bool trial_exports(btf_context *ctx, const codec_case *row);
/* Exports a model to a folder and evaluates it; fault may be NULL. */
trial_errors trial_run(gpu_host *host, const btf_model *model, const btf_gpu_target *target, int32_t zstd,
                       trial_queries kind, const trial_fault *fault, btf_gpu_cost *cost);
/* All layouts of a row's model of a material. */
void trial_row(gpu_host *host, btf_context *ctx, const codec_case *row, uint32_t material, uint32_t channels,
               trial_queries kind);
/* The first row of each codec; none of the build's may be without one. */
void trial_first_rows(gpu_host *host, btf_context *ctx, trial_queries kind);
/* The comparison must notice the fault. Those of weight, level and slice come first. */
void trial_plant(gpu_host *host, btf_context *ctx, const trial_fault *fault);
enum { TRIAL_FAULTS = 15, TRIAL_FIRST_FAULTS = 4 };
extern const trial_fault trial_faults[TRIAL_FAULTS];

/* Indices of two bytes, on MATERIAL_LARGE. */
#define TRIAL_CMF_LARGE "edge=4,resolution=4,codebook=300,sweeps=0,levels=3"

#endif
