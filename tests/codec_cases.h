/* SPDX-License-Identifier: MIT */
/*
 * codec_cases.h: which codecs the suites `codecs`, `faults`, `concurrency` and the fuzz targets of payloads
 * go through, with which options, and what is expected of each. A codec of the build without a row fails the
 * suites; a row whose codec is not in the build is passed over.
 */
#ifndef CODEC_CASES_H
#define CODEC_CASES_H

#include <btf/btf.h>

#include "codec_material.h"

#define CHANNELS(n) (1u << (n))
#define MATERIAL(name) (1u << MATERIAL_##name)

typedef struct codec_case {
  const char *codec;
  const char *options;  /* "key=value,key=value"; "" = defaults */
  uint32_t channels;    /* CHANNELS(n) | ...: data it is tried on, n from 1 to 4 */
  uint32_t unsupported; /* MATERIAL(x) | ...: what it may refuse with BTF_E_UNSUPPORTED */
  uint32_t faults; /* 1 = part of the loops that make everything fail in turn; one row of a codec must be */
  /* Largest root mean square error of decoded samples, relative to that of the data, over the materials that
   * are not refused; and of the coarser levels against area averages of the data. */
  double rmse, level_rmse;
  /* What is added to `rmse` for values between the samples, against the data interpolated; 0 = 0.08. */
  double between;
  /* Largest differences of evaluations as shares of the model's largest value: scalar against vector kernels;
   * models fitted by one and by two threads; fitted to resident and to streamed data. 0 = bit for bit. */
  double isa, threads, streamed;
  double most_psnr; /* a quality in dB that options can ask for on the smooth material; 0 = 40 */
  uint64_t slack;   /* bytes a fit may hold beyond its working set and its result */
} codec_case;
extern const codec_case codec_cases[];
extern const size_t codec_case_count;

/* A context; codecs that were built as modules are loaded into it. */
btf_status codec_case_context(const btf_context_desc *desc, btf_context **out);
/* Options of a row with its settings. `extra` is more of them that come after, or NULL. */
btf_status codec_case_options(btf_context *ctx, const codec_case *row, const char *extra, btf_options **out);
/* A model of a material; job as in btf_model_fit. */
btf_status codec_case_fit(btf_context *ctx, const codec_case *row, const codec_dataset_recipe *recipe,
                          const char *extra, const btf_job *job, btf_model **out);
/* The least number of channels from `from` on that a row takes, 0 if there is none. */
uint32_t codec_case_channels(const codec_case *row, uint32_t from);

/* Query i of an endless list that visits every corner: all directions of the hemisphere, grazing and below
 * the horizon, values that are not finite in each place, huge positions, levels before the first and beyond
 * the last, raw bits, and runs of equal directions. */
btf_query codec_case_query(uint32_t i);
/* Queries inside the domain only, with directions off the grazing ones. */
btf_query codec_case_plain_query(uint32_t i, float lod);

#endif
