/* SPDX-License-Identifier: MIT */
/* lpca.h: inside of the local PCA codec (docs/codecs/lpca.md).
 *
 * Every texel's ABRDF belongs to a cluster and is the mean of the cluster plus a combination of the cluster's
 * eigen-ABRDFs. Fitting works on coefficients: the coordinates of all ABRDFs in one common orthonormal basis,
 * in which distances are those of the ABRDFs. */
#ifndef BTFI_LPCA_H
#define BTFI_LPCA_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <btf/btf_codec.h>

enum { LPCA_F16 = 0, LPCA_F32 = 1, LPCA_Q8 = 2, LPCA_STORAGES };
enum { LPCA_ALIGNED = 0, LPCA_TIGHT = 1, LPCA_PACKINGS };
enum {
  LPCA_MAX_CLUSTERS = 1024,
  LPCA_MAX_COMPONENTS = 64,
  LPCA_MAX_SUBSPACE = 4096,
  LPCA_MAX_LEVELS = 32,
  LPCA_MAX_CHANNELS = 64,
  LPCA_LANES = 8, /* components are taken so many at a time */
  LPCA_SLACK = 64 /* zeros behind a table, which kernels may read */
};

/* Payload chunks (docs/codecs/lpca.md). */
#define LPCA_TAG_HEAD BTF_TAG('H', 'E', 'A', 'D')
#define LPCA_TAG_SCALES BTF_TAG('S', 'C', 'A', 'L')
#define LPCA_TAG_FACTORS BTF_TAG('F', 'A', 'C', 'T')
#define LPCA_TAG_CLUSTERS BTF_TAG('C', 'L', 'U', 'S')
#define LPCA_TAG_WEIGHTS BTF_TAG('W', 'G', 'H', 'T')

/* ---- layout of the evaluation tables (layout.c) ---- */

/* A row of the factors belongs to a (cluster, view, light), light fastest. It holds the components of each
 * channel, `stride` apart, then the mean of each channel. */
typedef struct btfi_lpca_layout {
  uint32_t channels, lights, views, width, height;
  uint32_t storage, packing, clusters, components, levels;
  uint32_t stride; /* values from one channel's components to the next */
  uint32_t padded; /* components rounded up to whole vectors */
  uint32_t factor_bytes, mean_bytes, weight_bytes, index_bytes; /* of a value */
  uint64_t mean_at;                                             /* bytes from the start of a row */
  uint64_t row_data_bytes, row_bytes, cluster_bytes, factors_bytes;
  uint64_t texel_bytes; /* weights of a texel */
  uint32_t level_width[LPCA_MAX_LEVELS], level_height[LPCA_MAX_LEVELS];
  uint64_t index_table_bytes[LPCA_MAX_LEVELS], weight_table_bytes[LPCA_MAX_LEVELS];
} btfi_lpca_layout;

/* Takes storage, packing, clusters, components and levels from `out`; false if a size does not fit 64 bits.
 */
bool btfi_lpca_layout_of(const btf_model_shape *shape, uint32_t lights, uint32_t views,
                         btfi_lpca_layout *out);
/* Writes a value within -1 .. 1 in the type of the factors, or of means and weights; returns what is stored.
 */
float btfi_lpca_store_factor(uint32_t storage, float value, unsigned char *dst);
float btfi_lpca_store_value(uint32_t storage, float value, unsigned char *dst);

/* ---- clusters of affine subspaces in the space of coefficients (cluster.c, refit.c, seed.c) ---- */

/* Points and the clusters fitted to them. */
typedef struct btfi_lpca_model {
  const btf_host *host;
  btf_context *ctx;
  const btf_job *job;
  uint64_t count;      /* points */
  uint32_t size;       /* coordinates of a point */
  const float *points; /* count x size */
  uint32_t clusters;
  uint32_t room;            /* clusters that there is room for */
  uint32_t fixed;           /* clusters before this one stay as they are; 0 = none do */
  uint32_t most_components; /* that there is room for */
  uint32_t components;      /* of the fit at hand, 0 for k-means; a refit follows every change */

  /* Of each cluster 1 + components rows of `size` values: the mean and the orthonormal basis. */
  float *basis;
  double *mean_dot; /* mean . row for each row of the basis */
  double *values;   /* of each cluster LPCA_MAX_COMPONENTS: its largest eigenvalues */
  double *trace;    /* of each cluster: the sum of squared distances from its mean */
  double *cost;     /* of each cluster: its squared error */
  uint64_t *start;  /* clusters + 1: members of cluster k are order[start[k]] .. order[start[k + 1] - 1] */
  uint32_t *order;
  /* Of each point: the best cluster and the best but one, their squared errors, the squared length. */
  uint32_t *label, *second;
  float *error, *second_error, *square;

  uint32_t block; /* points projected together, on the bases of all clusters */
  float *products;
  uint32_t threads;
  float *direction;   /* size */
  float *gathered;    /* of each thread: `gather_size` */
  double *matrix;     /* of each thread: size x size */
  double *eigen;      /* of each thread: size */
  btf_status *failed; /* of each thread */
  uint64_t gather_size;
  uint32_t splits; /* clusters that were given to another place since the start */
} btfi_lpca_model;

/* Room for fits of up to `room` clusters and most_components. After a failure, too, the model must be freed.
 */
btf_status btfi_lpca_model_alloc(btfi_lpca_model *m, uint64_t max_working_set);
void btfi_lpca_model_free(btfi_lpca_model *m);
/* What that allocates and fits hold for a while, of a model of which only count, size, clusters, room,
 * most_components and the host are known. */
uint64_t btfi_lpca_model_bytes(const btfi_lpca_model *m, uint64_t max_working_set);
/* Labels as of k-means++: means are points drawn by their squared distance from the means before, each the
 * best of a few draws. */
btf_status btfi_lpca_seed(btfi_lpca_model *m, uint64_t *random, double from, double to);
/* Best clusters of `count` points; second and second_error may be NULL. With `keep`, labels are given and
 * change only for an error that is less by more than rounding. */
btf_status btfi_lpca_assign(btfi_lpca_model *m, const float *points, uint64_t count, bool keep,
                            uint32_t *label, float *error, uint32_t *second, float *second_error);
/* Coordinates in the bases of the clusters they belong to, `components` for each point, and the squared
 * errors. */
btf_status btfi_lpca_weights(const btfi_lpca_model *m, const float *points, uint64_t count,
                             const uint32_t *label, float *weights, float *error);
/* Mean and eigenvectors of each cluster from its members. */
btf_status btfi_lpca_refit(btfi_lpca_model *m);
/* Gives clusters that are of little use, empty ones first, a half of the clusters with the largest error. */
btf_status btfi_lpca_split(btfi_lpca_model *m);
double btfi_lpca_cost(const btfi_lpca_model *m);
/* What the cost would be with another number of components and the same members. */
double btfi_lpca_cost_with(const btfi_lpca_model *m, uint32_t components);
/* Refit, then assignment and refit in turn until the cost falls by less than `least` of itself or
 * `iterations` are done. Costs go to history[0 .. *steps - 1], at most iterations + 1, unless it is NULL. */
btf_status btfi_lpca_iterate(btfi_lpca_model *m, uint32_t iterations, double least, double *history,
                             uint32_t *steps, double from, double to);

/* ---- levels of detail (levels.c) ---- */

/* The texels of the coarser levels, level by level, and the clusters that are theirs alone. */
typedef struct btfi_lpca_coarse {
  uint32_t width, height, levels;
  uint64_t count;
  float *points;                 /* count x size */
  uint32_t *label;               /* of each point */
  uint64_t *start;               /* as in the model */
  uint32_t clusters, components; /* components that are not rounding error */
} btfi_lpca_coarse;

uint64_t btfi_lpca_coarse_texels(uint32_t width, uint32_t height, uint32_t levels);
uint64_t btfi_lpca_coarse_bytes(uint32_t width, uint32_t height, uint32_t levels, uint32_t size);
/* The most clusters that the finest level gives up, of so many. */
uint32_t btfi_lpca_coarse_most(uint32_t clusters);
/* Averages of the points of the model. After a failure, too, it must be freed. */
btf_status btfi_lpca_coarse_make(btfi_lpca_coarse *c, const btfi_lpca_model *m, uint32_t width,
                                 uint32_t height, uint32_t levels);
void btfi_lpca_coarse_free(btfi_lpca_coarse *c, const btf_host *host, btf_context *ctx);
/* Chooses how many clusters the coarser levels get. What is beyond the `spare` ones is taken from the model,
 * which then goes through some iterations. */
btf_status btfi_lpca_coarse_choose(btfi_lpca_coarse *c, btfi_lpca_model *m, uint32_t spare,
                                   uint32_t iterations, double at);
/* Adds these clusters to the model, behind its own, and labels all points with the best of all clusters. */
btf_status btfi_lpca_coarse_fit(btfi_lpca_coarse *c, btfi_lpca_model *m, double at);

/* ---- payload (fit.c, write.c, load.c) ---- */

typedef struct btfi_lpca_head {
  uint32_t storage, packing, clusters, components, levels, reserved;
  double squared_error, energy; /* squared Frobenius norms: predicted error of the model, and the data */
  double outside;               /* of the error, what lies outside of the common subspace */
} btfi_lpca_head;
enum { LPCA_HEAD_BYTES = 48 /* 6 of 32 bits, 3 of 64 */ };

/* Texels of one level. */
typedef struct btfi_lpca_level {
  uint32_t *label;
  float *weights; /* components a texel */
} btfi_lpca_level;

/* A fitted model on its way into a payload. */
typedef struct btfi_lpca_writing {
  const btf_host *host;
  btf_context *ctx;
  btf_chunk_writer *payload;
  btfi_lpca_layout layout;
  const btfi_lpca_model *model;
  const float *center;  /* `size` coefficients that were taken from all points */
  const float *vectors; /* rows of ABRDFs x size: the common basis */
  btfi_lpca_level level[LPCA_MAX_LEVELS];
  btfi_lpca_head head;
  float *lifted;       /* ABRDFs of the cluster at hand, the mean and the components side by side */
  float *center_basis; /* its basis with the center in the mean */
  float *refined; /* of each cluster of the finest level the ABRDFs of the mean and the components one after
                     another, or NULL */
  uint32_t refined_clusters;
  double *mean_dot;     /* while refining: the mean times each of them */
  float *factor_scale;  /* of each cluster the mean and the components: what table values are multiplied by */
  float *weight_scale;  /* of each cluster the components */
  double storage_error; /* squared error that rounding adds */
} btfi_lpca_writing;

/* Replaces bases and the weights of the finest level by better ones in `passes` readings of the data, and the
 * bases of the model by their part in the subspace. Needs memory for all bases twice, of `room` bytes;
 * without it, everything stays. */
btf_status btfi_lpca_refine(btfi_lpca_writing *w, btfi_lpca_model *m, const btf_dataset *ds, uint32_t passes,
                            uint64_t room, double from, double to);
/* Rounds everything: the squared error of storage and, with `tables`, the payload, whose head gains that
 * error. */
btf_status btfi_lpca_write(btfi_lpca_writing *w, bool tables);
/* What that needs beside the payload, for so many rows of an ABRDF. */
uint64_t btfi_lpca_write_bytes(uint64_t rows, uint32_t clusters, uint32_t components, uint32_t size);

btf_status btfi_lpca_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                         const btf_options *options, const btf_job *job, btf_chunk_writer *payload);
btf_status btfi_lpca_load(const btf_host *host, btf_context *ctx, uint32_t format,
                          const btf_model_shape *shape, btf_chunk_reader *payload, void **state);
void btfi_lpca_destroy(const btf_host *host, btf_context *ctx, void *state);

/* ---- evaluation (eval.c, kernel_*.c) ---- */

/* Rows that a query blends, as offsets into a cluster's factors, and texels. None has weight 0 but those
 * beyond the number of texels, which all have. */
typedef struct btfi_lpca_taps {
  uint64_t row[9];
  float row_weight[9];
  uint32_t rows, texels;
  uint32_t cluster[8];
  float texel_weight[8];
  const unsigned char *weights[8]; /* of each texel */
} btfi_lpca_taps;

typedef struct btfi_lpca_state btfi_lpca_state;
/* The colour of a query. Texels of one cluster are taken together: within a cluster the model is linear. */
typedef void (*btfi_lpca_shade_fn)(const btfi_lpca_state *s, const btfi_lpca_taps *taps, float *out);
btfi_lpca_shade_fn btfi_lpca_shade_of(uint32_t isa, uint32_t storage);
extern const btfi_lpca_shade_fn btfi_lpca_scalar[LPCA_STORAGES];
#if defined(__x86_64__)
extern const btfi_lpca_shade_fn btfi_lpca_avx2[LPCA_STORAGES];
#endif

struct btfi_lpca_state {
  const btf_host *host;
  const btf_dirset *light_set, *view_set;
  btfi_lpca_shade_fn shade;
  const unsigned char *factors;
  const unsigned char *index[LPCA_MAX_LEVELS], *weights[LPCA_MAX_LEVELS];
  float *scales; /* of each cluster: the components, padded with 0, then the mean and 7 unused */
  uint32_t wrap;
  uint64_t channel_bytes, resident;
  btfi_lpca_head head;
  btfi_lpca_layout layout;
};

void btfi_lpca_eval(const void *state, const btf_query *query, float *out);
void btfi_lpca_eval_n(const void *state, const btf_batch *batch, float *const *out);
void btfi_lpca_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                     float *out);

/* ---- export for a GPU (gpu.c) ---- */

extern const btf_gpu_layout_desc *const btfi_lpca_gpu_layouts[];
btf_status btfi_lpca_gpu(const btf_host *host, btf_context *ctx, const void *state,
                         const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                         btf_gpu_builder *out);

#endif
