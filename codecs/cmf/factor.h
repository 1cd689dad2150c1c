/* SPDX-License-Identifier: MIT */
/* factor.h: chained matrix factorisation of one ABRDF (docs/codecs/cmf.md; Suykens et al. 2003, section 4.2).
 *
 * f(l, v) ~ product over stages of sum over terms k of P_k(p1(l, v)) Q_k(p2(l, v)). A stage factors what the
 * stages before it leave. All that depends on the directions alone is a btfi_cmf_geometry, made once:
 * resampling weights between parameterisations, where pairs fall into the maps, and which cells have no valid
 * pair. */
#ifndef BTFI_CMF_FACTOR_H
#define BTFI_CMF_FACTOR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <btf/btf_plugin.h>

#include "parabolic.h"

/* Projections of a pair of directions to one (Suykens et al. 2003, table 1). CMF_OTHER is known by its
 * functions alone and cannot be stored in a model. */
enum {
  CMF_LIGHT = 0,
  CMF_VIEW = 1,
  CMF_HALF = 2,
  CMF_DIFFERENCE = 3,
  CMF_PROJECTIONS = 4,
  CMF_OTHER = 254,
  CMF_ONE = 255 /* the factor is 1 */
};
enum { CMF_MAX_STAGES = 8, CMF_MAX_TERMS = 8, CMF_MAX_FACTORS = 2 * CMF_MAX_STAGES * CMF_MAX_TERMS };

/* Two projections that together tell light and view (the STAR's pi_1 and pi_2, eq. 8 to 10). */
typedef struct btfi_cmf_pair {
  const char *name;
  uint32_t projection[2];
  void (*project)(const float light[3], const float view[3], float first[3], float second[3]);
  /* false if there is no such pair of directions above the horizon. */
  bool (*invert)(const float first[3], const float second[3], float light[3], float view[3]);
} btfi_cmf_pair;

/* One stage; with `mean` the second factor is 1 and the first the mean over the second projection. */
typedef struct btfi_cmf_stage {
  const btfi_cmf_pair *pair;
  bool mean;
  uint32_t terms;
} btfi_cmf_stage;

enum { CMF_SVD = 0, CMF_NONNEGATIVE = 1, CMF_HOMOMORPHIC = 2, CMF_METHODS };
enum { CMF_RATIO = 0, CMF_WEIGHTED = 1 };
enum { CMF_VALID = 0, CMF_UNIFORM = 1 };

typedef struct btfi_cmf_settings {
  uint32_t stage_count;
  btfi_cmf_stage stage[CMF_MAX_STAGES];
  uint32_t method, residue, average;
  bool symmetric;
  uint32_t grid, resolution; /* CMF_ANGULAR or CMF_PARABOLIC tables between stages, and their edge */
  uint32_t map, edge;        /* CMF_PARABOLIC or CMF_CUBE maps, and their edge */
  uint32_t sweeps;           /* over all stages, each fitted again to what the others leave */
  double epsilon; /* least approximation to divide by, relative to the largest value of the ABRDF */
} btfi_cmf_settings;

/* A map of the result: term `term` of stage `stage`, its first (0) or second (1) factor. */
typedef struct btfi_cmf_factor {
  uint32_t stage, term, side, projection;
} btfi_cmf_factor;

/* Parses "hd:2,io" into settings->stage; returns NULL or what is wrong. */
const char *btfi_cmf_parse_chain(const char *text, btfi_cmf_settings *settings);
const btfi_cmf_pair *btfi_cmf_pair_of(const char *name, size_t length);
/* The direction that a stored projection makes of a light and a view. */
void btfi_cmf_project(uint32_t projection, const float light[3], const float view[3], float out[3]);
/* Factors of the stages in order: of each stage its terms, of each term its one or two sides. Returns their
 * number. */
uint32_t btfi_cmf_list_factors(const btfi_cmf_settings *settings, btfi_cmf_factor list[CMF_MAX_FACTORS]);
/* Factors that may be negative: terms after the first of a singular value decomposition. */
bool btfi_cmf_is_signed(uint32_t method, uint32_t term);

/* Samples of one projection: the directions of the data set, or the centres of a table. */
typedef struct btfi_cmf_domain {
  uint32_t count;
  bool native;
  btfi_cmf_map map;      /* of the table */
  const btf_dirset *set; /* of the data set */
} btfi_cmf_domain;

/* A cell of a resampled matrix: which pairs it is interpolated from. */
typedef struct btfi_cmf_cell {
  uint32_t light[3], view[3];
  float light_weight[3], view_weight[3];
} btfi_cmf_cell;

enum { CMF_AT_LIGHT = 0, CMF_AT_VIEW = 1, CMF_AT_PAIR = 2 };

/* One side of a stage: from samples of its projection to a map, and from the map to the pairs of the data. */
typedef struct btfi_cmf_side {
  btfi_cmf_domain domain;
  uint32_t *source;     /* domain: the sample to copy where no pair is valid */
  btfi_cmf_tap *to_map; /* map texels: interpolation from the samples */
  uint32_t at_kind;     /* taps are for each light, each view or each pair */
  btfi_cmf_tap *at;     /* into the map */
  float *texel_share;   /* map texels: 1 / sum of the weights that directions of the data have in it, or 0 */
} btfi_cmf_side;

typedef struct btfi_cmf_stage_geometry {
  btfi_cmf_stage stage;
  uint32_t sides, rows, columns; /* samples of the first and second projection */
  bool native;                   /* rows are lights or views, columns the others: no resampling */
  btfi_cmf_side side[2];
  btfi_cmf_cell *cell;    /* rows x columns, or NULL if native or a mean */
  float *cell_weight;     /* rows x columns: 0 = no valid pair */
  uint32_t *start, *pair; /* of a mean: entries of each row */
  float *pair_weight;
} btfi_cmf_stage_geometry;

typedef struct btfi_cmf_geometry {
  btfi_cmf_settings settings;
  uint32_t lights, views, pairs;
  uint32_t map_texels, factors;
  btfi_cmf_factor factor[CMF_MAX_FACTORS];
  btfi_cmf_stage_geometry stage[CMF_MAX_STAGES];
  uint64_t bytes;         /* of all tables */
  uint64_t scratch_bytes; /* for one thread */
  double invalid;         /* fraction of cells of resampled matrices without a valid pair */
} btfi_cmf_geometry;

/* BTF_E_LIMIT if the tables would take more than `budget` bytes, naming what would do. Progress goes from
 * `from` to `to`. */
btf_status btfi_cmf_geometry_create(const btf_host *host, btf_context *ctx, const btfi_cmf_settings *settings,
                                    const btf_dirset *lights, const btf_dirset *views, uint64_t budget,
                                    const btf_job *job, double from, double to, btfi_cmf_geometry **out);
void btfi_cmf_geometry_free(const btf_host *host, btf_context *ctx, btfi_cmf_geometry *geometry);

/* Bytes that factoring needs for one thread. */
uint64_t btfi_cmf_scratch_bytes(const btfi_cmf_geometry *geometry);

/* Sums over ABRDFs. */
typedef struct btfi_cmf_report {
  double squared_error;                  /* of the float maps looked up at the directions of the data */
  double squared_energy;                 /* of the data */
  double absolute_error, relative_error; /* sums over samples; relative ones over samples > 0 */
  uint64_t samples, positive;
  uint64_t masked, divided; /* divisions by epsilon times the maximum, and all divisions */
} btfi_cmf_report;

/* Factors abrdf[(view * lights + light) * channels + c] into maps[(factor * map_texels + texel) * channels +
 * c]. `scratch` has geometry->scratch_bytes bytes on a 64-byte boundary. Adds to *report. Not for
 * CMF_HOMOMORPHIC. */
void btfi_cmf_factor_abrdf(const btfi_cmf_geometry *geometry, uint32_t channels, const float *abrdf,
                           void *scratch, float *maps, btfi_cmf_report *report);
/* Adds the errors of given maps to *report. */
void btfi_cmf_measure(const btfi_cmf_geometry *geometry, uint32_t channels, const float *abrdf, void *scratch,
                      const float *maps, btfi_cmf_report *report);

#endif
