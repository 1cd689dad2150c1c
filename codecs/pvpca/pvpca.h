/* SPDX-License-Identifier: MIT */
/* pvpca.h: inside of the per-view factorisation codec (docs/codecs/pvpca.md).
 *
 * For each view v, f(x, v, l) = mean_v(x) + sum over j of g_vj(l) h_vj(x). The matrix of a view has m rows
 * and p columns: with colours in the weights (view, light, channel) against texels, with colours in the
 * textures lights against (texel, channel). Its table G has m x terms values, its table H p x (mean, terms).
 */
#ifndef BTFI_PVPCA_H
#define BTFI_PVPCA_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <btf/btf_plugin.h>

enum { PVPCA_F32 = 0, PVPCA_F16 = 1, PVPCA_Q8 = 2, PVPCA_STORAGES };
enum { PVPCA_COLOR_LIGHTS = 0, PVPCA_COLOR_TEXELS = 1, PVPCA_COLORS };
enum { PVPCA_FIXED = 0, PVPCA_ADAPTIVE = 1 };
enum { PVPCA_MAX_TERMS = 64, PVPCA_MAX_LEVELS = 32, PVPCA_MAX_CHANNELS = 64 };

/* Payload chunks (docs/codecs/pvpca.md). */
#define PVPCA_TAG_HEAD BTF_TAG('H', 'E', 'A', 'D')
#define PVPCA_TAG_TERMS BTF_TAG('T', 'E', 'R', 'M')
#define PVPCA_TAG_SCALES BTF_TAG('S', 'C', 'A', 'L')
#define PVPCA_TAG_WEIGHTS BTF_TAG('W', 'G', 'H', 'T')
#define PVPCA_TAG_TEXTURES BTF_TAG('T', 'E', 'X', 'H') /* one for each level */

typedef struct btfi_pvpca_head {
  uint32_t color, storage, levels, flags, terms; /* terms: of all views */
  double squared_error, energy; /* squared Frobenius norms: predicted error of the model, and the data */
} btfi_pvpca_head;
enum { PVPCA_HEAD_BYTES = 40 /* 5 of 32 bits, 4 unused, 2 of 64 */, PVPCA_FLAG_MEAN = 1 };
enum { PVPCA_TABLE_TAIL = 64 }; /* zeros behind a table: kernels read whole vectors from every start in it */

/* ---- layout of the evaluation tables (layout.c) ---- */

/* A texel of H is `h_channels` runs of `columns` values, the mean first; a light of G is `g_channels` runs of
 * `terms` values. Views follow each other, so that neighbouring texels of a view are neighbours in memory. */
typedef struct btfi_pvpca_view {
  uint32_t terms, columns;
  uint32_t h_texel_bytes, g_light_bytes;
  uint64_t g_start;      /* byte of the table of weights */
  uint64_t h_before;     /* bytes a texel has in the views before */
  uint64_t scale_start;  /* in the scales of the payload */
  uint32_t padded_start; /* in the scales of the state */
  float mean_scale;
} btfi_pvpca_view;

typedef struct btfi_pvpca_layout {
  uint32_t channels, lights, views, width, height;
  uint32_t storage, color, levels, has_mean;
  uint32_t g_channels, h_channels;
  uint32_t h_bytes_value, g_bytes_value;
  uint32_t padded; /* the most terms of a view, rounded up to whole vectors */
  uint32_t terms;  /* of all views */
  uint64_t scales, padded_scales;
  uint64_t h_texel_bytes; /* of all views */
  uint64_t g_bytes, h_bytes[PVPCA_MAX_LEVELS];
  uint64_t level_texels[PVPCA_MAX_LEVELS];
  uint32_t level_width[PVPCA_MAX_LEVELS], level_height[PVPCA_MAX_LEVELS];
} btfi_pvpca_layout;

enum { PVPCA_VECTOR = 8 }; /* values that terms are padded to in scratch */

/* `out` has the shape, storage, color, levels and has_mean, `views` the terms; derives the rest. false if a
 * size does not fit. */
bool btfi_pvpca_layout_of(btfi_pvpca_layout *out, btfi_pvpca_view *views);
uint32_t btfi_pvpca_value_bytes(uint32_t storage);
/* Storage of the weights: they are few, and 8 bits of them would cost more than they save. */
uint32_t btfi_pvpca_weight_storage(uint32_t storage);
/* What a stored 1 decodes to before it is scaled. */
float btfi_pvpca_unit(uint32_t storage);
/* Writes n values within -1 .. 1. */
void btfi_pvpca_store(uint32_t storage, const float *values, uint64_t n, unsigned char *dst);
/* What storage makes of a value within -1 .. 1. */
float btfi_pvpca_round(uint32_t storage, float value);

/* ---- kernels (kernel_*.c) ---- */

/* A column whose values are all below this is stored as zeros, so that its inverse is finite. */
#define PVPCA_SMALLEST 1e-37f

/* What one query blends: up to 3 views, of each up to 3 lights and up to 4 texels of 2 levels. */
typedef struct btfi_pvpca_tap {
  const unsigned char *g[3], *h[8];
  const float *scale; /* of the terms; 0 beyond them */
  uint32_t terms, columns;
  float weight, mean_weight; /* of the view; times the scale of the mean, 0 without one */
} btfi_pvpca_tap;

typedef struct btfi_pvpca_taps {
  uint32_t views, lights, texels;
  float light_weight[3], texel_weight[8];
  btfi_pvpca_tap view[3];
  bool same_directions; /* as the query before, bit for bit */
} btfi_pvpca_taps;

/* STAR eq. 20: lambda[(view * channels + channel) * padded + term], times the weight of the view. */
typedef void (*btfi_pvpca_weigh_fn)(const btfi_pvpca_taps *t, uint32_t channels, uint32_t padded,
                                    float *lambda);
/* STAR eq. 21 for blended texels: the value of each channel. */
typedef void (*btfi_pvpca_shade_fn)(const btfi_pvpca_taps *t, uint32_t channels, uint32_t padded,
                                    const float *lambda, float *out);
typedef struct btfi_pvpca_kernels {
  btfi_pvpca_weigh_fn weigh[PVPCA_STORAGES]; /* of the weights: f32 and f16 */
  btfi_pvpca_shade_fn shade[PVPCA_COLORS][PVPCA_STORAGES];
} btfi_pvpca_kernels;
extern const btfi_pvpca_kernels btfi_pvpca_scalar;
#if defined(__x86_64__)
extern const btfi_pvpca_kernels btfi_pvpca_avx2;
#endif
const btfi_pvpca_kernels *btfi_pvpca_kernels_of(uint32_t isa);

/* ---- fitting ---- */

/* One term that a view may have. */
typedef struct btfi_pvpca_candidate {
  double gain;  /* squared error that it takes away */
  double error; /* and that its storage adds; 0 where that does not matter */
  uint32_t view, term;
} btfi_pvpca_candidate;

typedef struct btfi_pvpca_fit_job {
  const btf_host *host;
  btf_context *ctx;
  const btf_dataset *ds;
  const btf_job *job;
  btf_chunk_writer *payload;
  /* what is asked for */
  uint32_t components, most_terms, budget;
  bool has_target, want_peak, two_passes;
  /* the matrix of a view */
  uint64_t rows, columns, texels; /* m and p */
  uint32_t texel_columns;         /* columns of a texel: p / texels */
  uint32_t side;                  /* min(m, p): size of the Gram matrix */
  bool by_columns;                /* p < m: the Gram matrix is of columns */
  uint32_t keep;                  /* leading eigenvectors kept of a view */
  uint64_t block_texels;          /* read at once; all of them if a view fits the budget */
  double done, step;              /* progress before a view, and of it */
  /* buffers */
  float *block; /* of X^T: block columns x m, less the mean */
  double *gram, *eigenvalues;
  float *gram_part;  /* by_columns only */
  float *vectors;    /* side x keep, of one view or of all */
  float *means;      /* of each column of a view */
  float *textures;   /* a view's H: p x (mean + terms) */
  float *weights;    /* a view's G: m x terms */
  float *level;      /* a coarser level of H */
  double *part_sums; /* scratch of parallel passes */
  uint32_t *counts;  /* histogram of samples, for each thread */
  uint64_t *histogram;
  /* what is known of the views */
  double energy;                      /* of all samples */
  double *centred;                    /* for each view, squared norm of X less its mean */
  double *mean_error;                 /* for each view, what storing its mean adds */
  btfi_pvpca_candidate *candidates;   /* keep for each view */
  double target;                      /* squared error, or INFINITY */
  double target_psnr;                 /* what it stands for; 0 = an rmse */
  float largest[PVPCA_MAX_TERMS + 1]; /* magnitudes in the columns of `textures` */
  /* what is written */
  btfi_pvpca_layout layout; /* its sizes are of the data from the start */
  btfi_pvpca_view *view;    /* terms of each are what is chosen */
  unsigned char *g, *h[PVPCA_MAX_LEVELS], *scales;
  double squared_error;
} btfi_pvpca_fit_job;

/* view.c: one view's matrix */

enum { PVPCA_PARTS = 16 }; /* sums are made in so many parts, whatever the number of threads */

/* Reads the view and leaves its leading eigenvectors in `vectors`, its eigenvalues, energies and samples in
 * the job. `block` holds the view if it fits. */
btf_status btfi_pvpca_analyse(btfi_pvpca_fit_job *f, uint32_t view, float *vectors);
/* Fills `textures` and `weights` with `terms` terms from the eigenvectors; reads the view again unless it is
 * in `block`. */
btf_status btfi_pvpca_project(btfi_pvpca_fit_job *f, uint32_t view, const float *vectors, uint32_t terms,
                              bool in_block);
btf_status btfi_pvpca_progress(const btfi_pvpca_fit_job *f, double of_view);

/* store.c: rounding and writing */

/* Of what project left: the gain and error of each term as candidates, the error of the mean. */
btf_status btfi_pvpca_measure(btfi_pvpca_fit_job *f, uint32_t view, uint32_t terms);
/* Room in the payload for the terms of all views. */
btf_status btfi_pvpca_reserve(btfi_pvpca_fit_job *f);
/* Writes what project left and measure measured. */
btf_status btfi_pvpca_write_view(btfi_pvpca_fit_job *f, uint32_t view);
btf_status btfi_pvpca_write_head(const btfi_pvpca_fit_job *f);
/* Store the tables of a view and its levels, each column times `inverse`, or as it is without. */
btf_status btfi_pvpca_store_weights(btfi_pvpca_fit_job *f, uint32_t view, const float *inverse);
btf_status btfi_pvpca_store_textures(btfi_pvpca_fit_job *f, uint32_t view, const float *inverse);

/* choose.c */

/* Sets the terms of each view from the candidates. */
btf_status btfi_pvpca_choose(btfi_pvpca_fit_job *f);

btf_status btfi_pvpca_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                          const btf_options *options, const btf_job *job, btf_chunk_writer *payload);

/* factors.c: without a fit. */
btf_status btfi_pvpca_from_factors(const btf_host *host, btf_context *ctx, const btf_model_shape *shape,
                                   const btf_factors *given, const btf_options *options, const btf_job *job,
                                   btf_chunk_writer *payload);

/* ---- payload, state and evaluation ---- */

typedef struct btfi_pvpca_state {
  const btf_host *host;
  const btf_dirset *light_set, *view_set;
  btfi_pvpca_weigh_fn weigh;
  btfi_pvpca_shade_fn shade;
  const unsigned char *g, *h[PVPCA_MAX_LEVELS];
  uint32_t wrap;
  uint64_t resident;
  btfi_pvpca_head head;
  btfi_pvpca_layout layout;
  btfi_pvpca_view *views;
  float *scales;        /* of the terms of each view, padded with zeros */
  uint32_t *components; /* of each view as factors */
} btfi_pvpca_state;

btf_status btfi_pvpca_load(const btf_host *host, btf_context *ctx, uint32_t format,
                           const btf_model_shape *shape, btf_chunk_reader *payload, void **state);
btf_status btfi_pvpca_factors_of(const void *state, btf_factors *out);
void btfi_pvpca_destroy(const btf_host *host, btf_context *ctx, void *state);
void btfi_pvpca_eval(const void *state, const btf_query *query, float *out);
void btfi_pvpca_eval_n(const void *state, const btf_batch *batch, float *const *out);
void btfi_pvpca_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                      uint32_t view, float *out);

/* ---- export for a GPU (gpu.c) ---- */

extern const btf_gpu_layout_desc *const btfi_pvpca_gpu_layouts[];
btf_status btfi_pvpca_gpu(const btf_host *host, btf_context *ctx, const void *state,
                          const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                          btf_gpu_builder *out);

#endif
