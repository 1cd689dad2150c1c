/* SPDX-License-Identifier: MIT */
/* laplacian.h: inside of the Laplacian level-of-detail codec (docs/codecs/laplacian.md; Ma et al. 2005).
 *
 * Each image is taken to YCbCr, each of its channels to a Laplacian pyramid: bands 0 .. levels - 1, of which
 * the last is the low-pass image. The matrix of a band has a row for each (view, light) and a column for each
 * texel of its level; it is kept as a few products of an eigen-ABRDF and a map of weights. */
#ifndef BTFI_LAPLACIAN_H
#define BTFI_LAPLACIAN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <btf/btf_codec.h>
#include <btf/btf_plugin.h>
#include <btf/btf_sampling.h>

enum { LAPLACIAN_Y, LAPLACIAN_CB, LAPLACIAN_CR, LAPLACIAN_CHANNELS };
enum { LAPLACIAN_MEAN_FILTER, LAPLACIAN_BINOMIAL_FILTER, LAPLACIAN_PAPER_FILTER, LAPLACIAN_FILTERS };
enum { LAPLACIAN_PHONG, LAPLACIAN_TABLE, LAPLACIAN_MEANS };
enum { LAPLACIAN_F16, LAPLACIAN_F32, LAPLACIAN_STORAGES };
enum { LAPLACIAN_FIXED, LAPLACIAN_ADAPTIVE };
enum {
  LAPLACIAN_MAX_LEVELS = 25,     /* of a texture 2^24 texels wide */
  LAPLACIAN_MAX_COMPONENTS = 64, /* of a channel of a level; the top level may have the mean besides */
  LAPLACIAN_MAX_VALUES = 3 * (LAPLACIAN_MAX_COMPONENTS * LAPLACIAN_MAX_LEVELS + 1),
  LAPLACIAN_SLACK = 8 /* values that kernels may read and write beyond the last */
};

/* Payload chunks (docs/codecs/laplacian.md). */
#define LAPLACIAN_TAG_HEAD BTF_TAG('H', 'E', 'A', 'D')
#define LAPLACIAN_TAG_LEVELS BTF_TAG('L', 'E', 'V', 'S')
#define LAPLACIAN_TAG_SCALES BTF_TAG('S', 'C', 'A', 'L')
#define LAPLACIAN_TAG_EIGEN BTF_TAG('E', 'I', 'G', 'N')
#define LAPLACIAN_TAG_WEIGHTS BTF_TAG('W', 'G', 'H', 'T') /* index: level */

/* ---- colour: JPEG's full range of BT.601, chroma around 0 ---- */

static inline float btfi_laplacian_from_rgb(uint32_t channel, float r, float g, float b) {
  const float y = 0.299f * r + 0.587f * g + 0.114f * b;
  return channel == LAPLACIAN_Y    ? y
         : channel == LAPLACIAN_CB ? (b - y) * (float)(1.0 / 1.772)
                                   : (r - y) * (float)(1.0 / 1.402);
}

static inline void btfi_laplacian_to_rgb(float y, float cb, float cr, float rgb[3]) {
  rgb[0] = y + 1.402f * cr;
  rgb[1] = y - (float)(0.114 * 1.772 / 0.587) * cb - (float)(0.299 * 1.402 / 0.587) * cr;
  rgb[2] = y + 1.772f * cb;
}

/* ---- the levels and how positions meet their texels ---- */

typedef struct btfi_laplacian_grid {
  uint32_t filter, wrap, levels;
  uint32_t width[LAPLACIAN_MAX_LEVELS], height[LAPLACIAN_MAX_LEVELS];
} btfi_laplacian_grid;

static inline btfi_laplacian_grid btfi_laplacian_grid_of(uint32_t filter, uint32_t wrap, uint32_t levels,
                                                         uint32_t width, uint32_t height) {
  btfi_laplacian_grid grid = {.filter = filter, .wrap = wrap, .levels = levels};
  for (uint32_t k = 0; k < levels && k < LAPLACIAN_MAX_LEVELS; k++) {
    grid.width[k] = btf_sampling_level_size(width, k);
    grid.height[k] = btf_sampling_level_size(height, k);
  }
  return grid;
}

/* Share of the way along an axis, 0 .. 1, below 1 unless clamped. Total, as all of btf_sampling.h. */
static inline double btfi_laplacian_share(float u, uint32_t wrap) {
  return btf_sampling_position(u, 1, wrap);
}

/* What btf_sampling_linear finds at that share of `size` texels, without branches: evaluation does this for
 * every level, and which of two texels is nearer cannot be foreseen. */
static inline void btfi_laplacian_linear(double share, uint32_t size, uint32_t wrap, uint32_t index[2],
                                         float weight[2]) {
  const double shifted = share * (double)size + 0.5, below_float = (double)size * (1.0 / 16777216.0);
  const int32_t above = (int32_t)shifted;
  const double fraction = shifted - (double)above;
  const uint32_t last = size - 1u, clamp = wrap == (uint32_t)BTF_WRAP_CLAMP;
  const uint32_t before = clamp ? 0u : last, past = clamp ? last : 0u;
  const double snapped = fraction < below_float ? 0.0 : fraction > 1.0 - below_float ? 1.0 : fraction;
  index[0] = above > 0 ? (uint32_t)above - 1u : before;
  index[1] = (uint32_t)above < size ? (uint32_t)above : past;
  weight[1] = (float)snapped;
  weight[0] = 1.0f - weight[1];
}

/* The one rule by which a band is read, in the pyramid and in evaluation: linear between texels of the band;
 * with the paper's filter the texel that holds each of the two nearest finest texels. `finest` are the linear
 * taps of level 0, which that filter needs. */
static inline void btfi_laplacian_taps(const btfi_laplacian_grid *grid, const uint32_t *sizes, uint32_t level,
                                       double share, const uint32_t finest[2], const float finest_weight[2],
                                       uint32_t index[2], float weight[2]) {
  if (grid->filter != LAPLACIAN_PAPER_FILTER) {
    btfi_laplacian_linear(share, sizes[level], grid->wrap, index, weight);
    return;
  }
  for (int i = 0; i < 2; i++) {
    index[i] = (uint32_t)((2 * (uint64_t)finest[i] + 1) * sizes[level] / (2 * (uint64_t)sizes[0]));
    weight[i] = finest_weight[i];
  }
}

/* ---- pyramids of images (pyramid.c) ---- */

typedef struct btfi_laplacian_pyramid btfi_laplacian_pyramid;
btf_status btfi_laplacian_pyramid_create(const btf_host *host, btf_context *ctx,
                                         const btfi_laplacian_grid *grid, btfi_laplacian_pyramid **out);
void btfi_laplacian_pyramid_destroy(btfi_laplacian_pyramid *pyramid);
/* Floats of the planes of all levels together; plane of level k starts at offset(k). */
uint64_t btfi_laplacian_pyramid_floats(const btfi_laplacian_pyramid *pyramid);
uint64_t btfi_laplacian_pyramid_offset(const btfi_laplacian_pyramid *pyramid, uint32_t level);
/* Floats of scratch for the functions below. */
uint64_t btfi_laplacian_pyramid_scratch(const btfi_laplacian_pyramid *pyramid);
/* planes holds the image at level 0; makes bands of all levels from `lowest` on, low-pass images below it. */
void btfi_laplacian_analyse(const btfi_laplacian_pyramid *pyramid, uint32_t lowest, float *planes,
                            float *scratch);
/* planes holds bands; level `level` becomes the image. */
void btfi_laplacian_synthesise(const btfi_laplacian_pyramid *pyramid, uint32_t level, float *planes,
                               float *scratch);

/* ---- Blinn-Phong (phong.c) ---- */

/* Equation 5: ka + kd max(0, N.L) + ks max(0, N.H)^alpha. */
typedef struct btfi_laplacian_phong {
  double ka, kd, ks, alpha;
} btfi_laplacian_phong;
#define LAPLACIAN_LARGEST_ALPHA 4096.0
/* Least squares over all pairs of values[(view * lights + light) * 3]; *rms is what is left. Where directions
 * do not tell terms apart, ka goes before kd, and kd before ka for data that hold the cosine; ks comes last.
 * No lobe is more than twice as high between the samples as at the highest of them. */
btf_status btfi_laplacian_fit_phong(const btf_host *host, btf_context *ctx, const btf_dirset *lights,
                                    const btf_dirset *views, uint32_t quantity, const double *values,
                                    btfi_laplacian_phong *out, double *rms);
float btfi_laplacian_phong_value(const btfi_laplacian_phong *phong, const float light[3],
                                 const float view[3]);

/* ---- the data set by images (source.c) ---- */

/* The band of one level and channel, if it is resident. */
typedef struct btfi_laplacian_band {
  uint32_t level, channel;
  float *data; /* pairs x texels */
} btfi_laplacian_band;

typedef struct btfi_laplacian_source {
  const btf_host *host;
  btf_context *ctx;
  const btf_dataset *ds;
  uint32_t views, lights;
  uint64_t pairs;
  btfi_laplacian_grid grid;
  btfi_laplacian_pyramid *pyramid;
  uint32_t images;            /* that are read together */
  uint64_t buffers;           /* bytes held */
  uint64_t least_working_set; /* of which one image and the pyramids are the share this takes */
  float *rgb;                 /* images x 3 planes */
  float *scratch;             /* of each thread: planes of three channels, then what the pyramid wants */
  uint64_t scratch_floats;
  /* What the low-pass image loses before its decomposition, pairs x 3; NULL = nothing. */
  const float *mean;
  uint32_t read_level, read_channel; /* of btfi_laplacian_read */
} btfi_laplacian_source;

btf_status btfi_laplacian_source_open(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                                      const btf_dataset_desc *desc, const btfi_laplacian_grid *grid,
                                      uint64_t max_working_set, btfi_laplacian_source *out);
void btfi_laplacian_source_close(btfi_laplacian_source *source);
/* A btf_matrix_read_fn of band (read_level, read_channel): items are pairs. */
btf_status btfi_laplacian_read(void *source, uint64_t item0, uint64_t items, float *dst, size_t ld);

/* Called from tasks for pair `pair` of the data set; rgb are its planes, planes and scratch the thread's. */
typedef void (*btfi_laplacian_image_fn)(void *user, const btfi_laplacian_source *source, uint64_t pair,
                                        const float *rgb, float *planes, float *scratch, uint32_t thread);
btf_status btfi_laplacian_each_image(btfi_laplacian_source *source, const btf_job *job, double from,
                                     double to, const char *stage, btfi_laplacian_image_fn visit, void *user);
/* One channel of an image. */
void btfi_laplacian_plane(const btfi_laplacian_source *source, const float *rgb, uint32_t channel,
                          float *dst);

/* ---- what a fit knows (fit.c, target.c, write.c) ---- */

typedef struct btfi_laplacian_head {
  uint32_t filter, mean, storage, levels;
  btfi_laplacian_phong phong;
  double chroma[2];                    /* equation 6 */
  double mean_residual, chroma_rms[2]; /* root mean square of what the fitted means leave of the true ones */
  double squared_error, energy;        /* of RGB; the error is negative where it was not measured */
  uint32_t count[LAPLACIAN_MAX_LEVELS][3];
  double mean_norm[LAPLACIAN_MAX_LEVELS][3]; /* rms over pairs of the mean of a band below the top */
  double energy_of[LAPLACIAN_MAX_LEVELS][3], residual[LAPLACIAN_MAX_LEVELS][3]; /* of the bands' matrices */
} btfi_laplacian_head;
enum { LAPLACIAN_HEAD_BYTES = 16 + 11 * 8, LAPLACIAN_LEVEL_BYTES = 3 * 32 };

void btfi_laplacian_put_head(const btfi_laplacian_head *head, unsigned char *bytes);
void btfi_laplacian_put_level(const btfi_laplacian_head *head, uint32_t level, unsigned char *bytes);

/* Components of a band, strongest first: the sum of eigen_j weights_j scale_j. Both vectors have a largest
 * magnitude of 1 and are rounded to the storage. */
typedef struct btfi_laplacian_factors {
  uint32_t rank;  /* found */
  float *eigen;   /* component j at eigen + j * pairs */
  float *weights; /* and at weights + j * texels */
  float *scale;
  double *sigma; /* singular values */
} btfi_laplacian_factors;

typedef struct btfi_laplacian_fitting {
  const btf_host *host;
  btf_context *ctx;
  const btf_job *job;
  btf_chunk_writer *payload;
  btfi_laplacian_source source;
  btfi_laplacian_head head;
  btfi_laplacian_factors factors[LAPLACIAN_MAX_LEVELS][3];
  float *mean;             /* pairs x 3: what is taken from the low-pass image */
  float mean_scale[3];     /* largest magnitude of a table's means */
  uint64_t least_for_band; /* 0, or what the decomposition needs that had too little memory */
  bool has_target, adaptive;
  double target;      /* squared RGB error, or 0 */
  double target_psnr; /* what it stands for; 0 = an rmse */
  double peak;        /* 99.9th percentile of the samples, if a target needs it */
} btfi_laplacian_fitting;

/* Picks counts by greatest reduction of the error per byte until what is decoded meets the target. */
btf_status btfi_laplacian_meet_target(btfi_laplacian_fitting *f, double from, double to);
/* Spends the bytes of the counts as they are on those that reduce the error most, if that is better. */
btf_status btfi_laplacian_spend_budget(btfi_laplacian_fitting *f, double from, double to);
/* The head as written: with the means of a table among the components. */
btfi_laplacian_head btfi_laplacian_stored_head(const btfi_laplacian_fitting *f);
/* What storage makes of a value. */
float btfi_laplacian_round(uint32_t storage, float value);
btf_status btfi_laplacian_write(btfi_laplacian_fitting *f);
btf_status btfi_laplacian_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                              const btf_options *options, const btf_job *job, btf_chunk_writer *payload);

/* ---- layout of the evaluation tables (load.c) ---- */

/* A row of the eigen table holds all levels of one (view, light), finest first, and within a level the
 * components of Y, Cb, Cr. A texel of level k has the weights of its level in the same order. */
typedef struct btfi_laplacian_layout {
  uint32_t lights, views, value_bytes;
  uint32_t first[LAPLACIAN_MAX_LEVELS + 1]; /* value where a level begins in a row; the end */
  uint64_t row_bytes, eigen_bytes;          /* bytes with slack */
  uint64_t texel_bytes[LAPLACIAN_MAX_LEVELS], weight_bytes[LAPLACIAN_MAX_LEVELS];
} btfi_laplacian_layout;
/* false if a size does not fit 64 bits or there are too many values. */
bool btfi_laplacian_layout_of(const btfi_laplacian_head *head, const btfi_laplacian_grid *grid,
                              uint32_t lights, uint32_t views, btfi_laplacian_layout *out);

/* ---- kernels (kernel_*.c) ---- */

/* One to nine rows and their weights. */
typedef struct btfi_laplacian_rows {
  const unsigned char *row[9];
  float weight[9];
  uint32_t count;
} btfi_laplacian_rows;

/* dst[i] = sum of weight * row[i] for i < n, added in order. May write LAPLACIAN_SLACK - 1 values more. */
typedef void (*btfi_laplacian_blend_fn)(const btfi_laplacian_rows *rows, uint32_t n, float *dst);
/* The same for four rows. */
typedef void (*btfi_laplacian_blend4_fn)(const unsigned char *const row[4], const float weight[4], uint32_t n,
                                         float *dst);
/* out[c] = sum of eigen[i] * weights[i] * scale[c * stride + i] for i < n. */
typedef void (*btfi_laplacian_dot_fn)(const float *eigen, const float *weights, const float *scale,
                                      uint32_t stride, uint32_t n, float out[3]);
typedef struct btfi_laplacian_kernels {
  btfi_laplacian_blend_fn blend[LAPLACIAN_STORAGES];
  btfi_laplacian_blend4_fn blend4[LAPLACIAN_STORAGES];
  btfi_laplacian_dot_fn dot;
} btfi_laplacian_kernels;
const btfi_laplacian_kernels *btfi_laplacian_kernels_of(uint32_t isa);
extern const btfi_laplacian_kernels btfi_laplacian_scalar;
#if defined(__x86_64__)
extern const btfi_laplacian_kernels btfi_laplacian_avx2;
#endif

/* ---- state and evaluation (load.c, eval.c) ---- */

typedef struct btfi_laplacian_state {
  const btf_host *host;
  const btf_dirset *light_set, *view_set;
  const float *light_xyz, *view_xyz;
  btfi_laplacian_blend_fn blend;
  btfi_laplacian_blend4_fn blend4;
  btfi_laplacian_dot_fn dot;
  btfi_laplacian_head head;
  btfi_laplacian_grid grid;
  btfi_laplacian_layout layout;
  const unsigned char *eigen;
  const unsigned char *weights[LAPLACIAN_MAX_LEVELS];
  float *scale; /* 3 x scale_stride: of each value for each channel, 0 for values of the other channels */
  uint32_t scale_stride;
  uint64_t resident;
} btfi_laplacian_state;

btf_status btfi_laplacian_load(const btf_host *host, btf_context *ctx, uint32_t format,
                               const btf_model_shape *shape, btf_chunk_reader *payload, void **state);
void btfi_laplacian_destroy(const btf_host *host, btf_context *ctx, void *state);
void btfi_laplacian_eval(const void *state, const btf_query *query, float *out);
void btfi_laplacian_eval_n(const void *state, const btf_batch *batch, float *const *out);
void btfi_laplacian_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                          uint32_t view, float *out);
/* Equation 7: the finest level that counts at a level of detail, and its weight; coarser ones have weight 1.
 */
uint32_t btfi_laplacian_first_level(float lod, uint32_t levels, float *weight);
/* Values of a row that a level of detail touches. */
uint32_t btfi_laplacian_values_touched(const btfi_laplacian_state *state, float lod);

/* ---- the paper's textures (packing.c) ---- */

/* Where components go. A level has planes of RGBA: four components of Y in each, then two of Cb and two of
 * Cr; at the paper's settings Y1-4, Y5-8, Cb1-2 with Cr1-2. */
typedef struct btfi_laplacian_packing {
  uint32_t lights, views, levels;
  uint32_t planes; /* of the level that has most, at least 1: the eigen map is planes * lights wide */
  uint32_t luma[LAPLACIAN_MAX_LEVELS], chroma[LAPLACIAN_MAX_LEVELS]; /* planes of a level */
  /* Of the weight map: three quadrants of a level's planes, the levels after it in the fourth; a layer for
   * every three planes. Twice the material's size, unless levels stay one texel wide. */
  uint32_t width, height, layers;
  uint32_t column[LAPLACIAN_MAX_LEVELS], line[LAPLACIAN_MAX_LEVELS]; /* where a level begins */
  uint32_t level_width[LAPLACIAN_MAX_LEVELS], level_height[LAPLACIAN_MAX_LEVELS];
} btfi_laplacian_packing;
enum {
  LAPLACIAN_MAX_LAYERS = ((LAPLACIAN_MAX_COMPONENTS + 4) / 4 + (LAPLACIAN_MAX_COMPONENTS + 2) / 2 + 2) / 3
};
void btfi_laplacian_packing_of(const btfi_laplacian_head *head, const btfi_laplacian_grid *grid,
                               uint32_t lights, uint32_t views, btfi_laplacian_packing *out);
/* Plane of a component in its level, and which of the four it is there. */
void btfi_laplacian_component_place(const btfi_laplacian_packing *p, uint32_t level, uint32_t channel,
                                    uint32_t component, uint32_t *plane, uint32_t *part);
/* Index of an RGBA texel in the eigen map, levels * views high. */
uint64_t btfi_laplacian_eigen_place(const btfi_laplacian_packing *p, uint32_t level, uint32_t plane,
                                    uint32_t light, uint32_t view);
/* Index of an RGBA texel in its layer of the weight map. */
uint64_t btfi_laplacian_weight_place(const btfi_laplacian_packing *p, uint32_t level, uint32_t plane,
                                     uint32_t x, uint32_t y);
/* Fills both maps, which come zeroed. Weights carry the scales. */
void btfi_laplacian_pack(const btfi_laplacian_state *state, const btfi_laplacian_packing *p, float *eigen_map,
                         float *const *weight_layers);

/* ---- GPU (gpu.c) ---- */

extern const btf_gpu_layout_desc *const btfi_laplacian_gpu_layouts[];
btf_status btfi_laplacian_gpu(const btf_host *host, btf_context *ctx, const void *state,
                              const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                              btf_gpu_builder *out);

#endif
