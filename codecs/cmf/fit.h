/* SPDX-License-Identifier: MIT */
/* fit.h: from a data set to a payload: texels are factored (texels.c), normalised, and written as they are or
 * as entries of codebooks (write.c). */
#ifndef BTFI_CMF_FIT_H
#define BTFI_CMF_FIT_H

#include "cluster.h"
#include "cmf.h"
#include "homomorphic.h"

enum { CMF_SOLVE_TOGETHER = 64 /* texels that one homomorphic solution takes */ };

/* Below what the loader takes; a material that has it is refused. */
#define CMF_LARGEST_SCALE 1e29f

/* Turns ABRDFs to their direction of maximal anisotropy (rotate.c). */
typedef struct btfi_cmf_rotation {
  uint32_t lights, views;
  btf_interp *light, *view; /* CMF_TURN x directions: where each comes from */
  float *moment;            /* pairs x 4: x and y of l + v and of h */
} btfi_cmf_rotation;

btf_status btfi_cmf_rotation_create(const btf_host *host, btf_context *ctx, const btf_dirset *lights,
                                    const btf_dirset *views, btfi_cmf_rotation *out);
void btfi_cmf_rotation_free(const btf_host *host, btf_context *ctx, btfi_cmf_rotation *r);
/* The angle, in 1 / CMF_TURN, of the direction in which an ABRDF differs most from its mean over azimuths. */
uint32_t btfi_cmf_anisotropy(const btfi_cmf_rotation *r, uint32_t channels, const float *abrdf);
/* out(l, v) = abrdf(R l, R v), R turning by `angle`; `half_way` has room for an ABRDF. */
void btfi_cmf_rotate(const btfi_cmf_rotation *r, uint32_t channels, uint32_t angle, const float *abrdf,
                     float *half_way, float *out);

/* Which texels of a level are wanted, and their places: a range, or one of each of `count` strata. */
typedef struct btfi_cmf_choice {
  bool sampled;
  uint64_t first, count; /* texels `first` on; or the number of strata */
  uint64_t texels;       /* of the level */
  uint64_t seed;
} btfi_cmf_choice;
/* The place of a texel, or UINT64_MAX. */
uint64_t btfi_cmf_place(const btfi_cmf_choice *choice, uint64_t texel);

typedef struct btfi_cmf_fitting {
  const btf_host *host;
  btf_context *ctx;
  const btf_dataset *ds;
  const btf_job *job;
  btf_chunk_writer *payload;
  btfi_cmf_settings settings;
  uint32_t storage, clustering, entries; /* entries: of a codebook, 0 = none */
  bool rotate;
  uint64_t wanted_samples,
      samples; /* texels that codebooks are trained on; those of them there is room for */
  bool has_target;
  double target;      /* squared error of the finest level */
  double target_psnr; /* that it stands for, 0 if it is an rmse */
  double lambda, floor;
  bool full_is_largest; /* what byte 255 of a scale stands for */
  double advise;        /* relative error above which the log warns */
  uint32_t width, height, channels, lights, views, pairs;
  uint32_t levels;
  uint64_t level_first[CMF_MAX_LEVELS + 1]; /* texels of finer levels */
  uint64_t budget, used;                    /* bytes of the working set, and those taken */

  btfi_cmf_geometry *geometry;
  btfi_cmf_hf *hf;
  btfi_cmf_rotation rotation;
  uint32_t factors, scales, threads;
  uint32_t map_values;                  /* channels * texels of a map */
  uint32_t term_scale[CMF_MAX_FACTORS]; /* the scale that a factor's term has: 0 = S */
  bool has_sign[CMF_MAX_FACTORS];
  unsigned char *scratch; /* threads x thread_bytes */
  uint64_t thread_bytes;
  btfi_cmf_report
      *report;    /* threads: what the finest level's factors lose, as of the last time they were made */
  float *scale;   /* texels of all levels x scales x channels */
  double *energy; /* squared samples, of texels of all levels x channels; NULL unless scales become bytes */
  unsigned char *angle; /* texels of all levels, or NULL */

  unsigned char *table[CMF_MAX_LEVELS][CMF_MAX_FACTORS]; /* payload without codebooks */
  unsigned char *store;                                  /* capacity records of factors, for codebooks */
  uint32_t store_kind;                                   /* their storage */
  uint64_t record_bytes, capacity;
  uint64_t store_first; /* the record of place 0 */
  bool to_store;        /* factoring goes to the store, not to `table` */
  float *kept_scale;    /* with a target: the scales of the records, which all sizes are made from */
  bool has_records;     /* the store holds all texels, and kept_scale their scales */
  float *collected;     /* HF: ABRDFs */
  uint64_t collect;
} btfi_cmf_fitting;

static inline uint64_t btfi_cmf_level_texels(const btfi_cmf_fitting *f, uint32_t level) {
  return f->level_first[level + 1] - f->level_first[level];
}

/* Reads the options of a fit; refuses those that have no effect beside others. */
btf_status btfi_cmf_read_options(btfi_cmf_fitting *f, const btf_options *options);

/* Factors the chosen texels of a level, each into its place: the record of that number, or without codebooks
 * the texel's place in the payload. */
btf_status btfi_cmf_factor_texels(btfi_cmf_fitting *f, uint32_t level, const btfi_cmf_choice *choice,
                                  double from, double to);
/* Factors all texels and writes the payload. */
btf_status btfi_cmf_write(btfi_cmf_fitting *f, double from, double to);

/* Makes what the stages need, then what factoring and clustering do; with f->entries the most entries of
 * codebooks. unprepare frees it. */
btf_status btfi_cmf_prepare_geometry(btfi_cmf_fitting *f, const btf_dataset_desc *desc, double from,
                                     double to);
btf_status btfi_cmf_make_room(btfi_cmf_fitting *f);
/* Whether it would succeed, as far as the working set goes. */
bool btfi_cmf_has_room(btfi_cmf_fitting *f);
void btfi_cmf_unprepare(btfi_cmf_fitting *f);
/* What reading needs of the working set: an ABRDF, and for averages sums in double and one more for each
 * thread. */
uint64_t btfi_cmf_visit_bytes(const btfi_cmf_fitting *f);

/* Writes the smallest payload found whose error is at most f->target: of the fewest terms, and of these the
 * smallest power of two of entries, or maps of every texel's own. A warning if there is none. */
btf_status btfi_cmf_meet_target(btfi_cmf_fitting *f, const btf_dataset_desc *desc, uint32_t most_entries,
                                uint32_t most_terms, double from);
/* Bytes of the working set that are left, 0 if there are none. */
static inline uint64_t btfi_cmf_left(const btfi_cmf_fitting *f) {
  return f->budget > f->used ? f->budget - f->used : 0;
}

#endif
