/* SPDX-License-Identifier: MIT */
/* lafortune.h: inside of the codec of analytic lobes (docs/codecs/lafortune.md).
 *
 * A texel is f(v, l) = rho_d + sum over lobes j of rho_s,j s_j(v, l), s_j = factor * max0(base_j)^n_j, with
 * one rho per channel. Lobes belong to a group of channels: all of them, or each channel alone. */
#ifndef BTFI_LAFORTUNE_H
#define BTFI_LAFORTUNE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <btf/btf_plugin.h>

enum {
  LAF_DIAGONAL = 0,
  LAF_FULL = 1,
  LAF_PHONG = 2,
  LAF_BLINN_PHONG = 3,
  LAF_WARD = 4,
  LAF_LEWIS = 5,
  LAF_KINDS
};
enum { LAF_LUMINANCE = 0, LAF_CHANNEL = 1 };
enum { LAF_F32 = 0, LAF_F16 = 1 };
enum { LAF_UNIFORM = 0, LAF_COSINE = 1, LAF_LOG = 2 };
enum {
  LAF_MAX_LOBES = 4,
  LAF_MAX_TERMS = 9,  /* products of directions that make a base */
  LAF_MAX_SHAPE = 10, /* values that shape a lobe */
  LAF_MAX_CHANNELS = 64,
  LAF_MAX_LEVELS = 32,
  LAF_MAX_VARIABLES = LAF_MAX_LOBES * LAF_MAX_SHAPE,
  LAF_MAX_ALBEDOS = 1 + LAF_MAX_LOBES, /* of one channel */
  LAF_CANDIDATES = 24
};
#define LAF_MIN_EXPONENT 0.5
#define LAF_MAX_EXPONENT 1024.0
#define LAF_MIN_ROUGHNESS 0.02
#define LAF_MAX_ROUGHNESS 2.0

/* Payload chunks. */
#define LAF_TAG_HEAD BTF_TAG('H', 'E', 'A', 'D')
#define LAF_TAG_SCALE BTF_TAG('S', 'C', 'A', 'L')
#define LAF_TAG_TEXELS BTF_TAG('T', 'E', 'X', 'L')

/* ---- kinds of lobes (kinds.c) ---- */

/* What the directions of a sample give the lobes: terms whose weighted sum is the base, and the factors of
 * lobes and of the diffuse part that turn f into the stored quantity. */
typedef struct btfi_lafortune_terms {
  float term[LAF_MAX_TERMS];
  float diffuse, lobe;
} btfi_lafortune_terms;

/* Values that shape a lobe: coefficients of the terms and the exponent; the exponent; Ward's two roughnesses.
 */
uint32_t btfi_lafortune_shape_values(uint32_t kind);
uint32_t btfi_lafortune_term_count(uint32_t kind);
/* Total: any bits give some bits. */
void btfi_lafortune_terms_of(uint32_t kind, bool times_cosine, const float light[3], const float view[3],
                             btfi_lafortune_terms *out);

/* ---- layout of a texel ---- */

/* Group after group: the shapes of its lobes, then the albedos, diffuse ones first, channel by channel. */
typedef struct btfi_lafortune_layout {
  uint32_t kind, lobes, colour, storage;
  uint32_t channels, groups, group_channels;
  uint32_t shape;        /* values that shape a lobe */
  uint32_t group_values; /* of one group */
  uint32_t values;       /* of a texel */
  uint32_t value_bytes;
} btfi_lafortune_layout;
void btfi_lafortune_layout_of(uint32_t kind, uint32_t lobes, uint32_t colour, uint32_t storage,
                              uint32_t channels, btfi_lafortune_layout *out);

/* ---- what all texels of a fit share (shared.c) ---- */

/* A lobe while it is fitted. */
typedef struct btfi_lafortune_lobe {
  uint32_t kind, terms;
  float coefficient[LAF_MAX_TERMS];
  float exponent;
  float peak; /* what the exponent applies to is divided by, or added to, so that its largest value is 1 */
} btfi_lafortune_lobe;

/* Arrays have `padded` entries, those beyond the samples 0. */
typedef struct btfi_lafortune_shared {
  uint32_t kind, terms;
  uint32_t samples, padded;         /* pairs of directions, and these rounded up to a vector */
  const float *term[LAF_MAX_TERMS]; /* as btfi_lafortune_terms has them */
  const float *lobe, *diffuse;      /* factors, times the root of the weight */
  const float *weight;              /* roots of the weights of samples */
  bool relative;                    /* weights follow the data, too (LAF_LOG) */
  uint32_t candidates;              /* lobes to start from */
  float candidate[LAF_CANDIDATES][LAF_MAX_SHAPE];
  const float *column;                                      /* diffuse part, then each candidate */
  double gram[(1 + LAF_CANDIDATES) * (1 + LAF_CANDIDATES)]; /* of these; unused if relative */
  float *memory;
  const struct btfi_lafortune_kernels *kernels;
} btfi_lafortune_shared;

/* Bytes that a shared description takes. */
uint64_t btfi_lafortune_shared_bytes(uint32_t kind, uint32_t samples);
/* Samples are pairs (view, light), light fastest. */
btf_status btfi_lafortune_shared_create(const btf_host *host, btf_context *ctx, uint32_t kind,
                                        uint32_t quantity, uint32_t weights, const float *lights,
                                        uint32_t light_count, const float *views, uint32_t view_count,
                                        btfi_lafortune_shared *out);
void btfi_lafortune_shared_free(const btf_host *host, btf_context *ctx, btfi_lafortune_shared *shared);

/* From the values that shape it. */
void btfi_lafortune_lobe_of(uint32_t kind, const float *shape, btfi_lafortune_lobe *out);
/* The base of all samples, and the lobe's peak. false if the lobe fits between the samples, so that its
 * height would be a guess. */
bool btfi_lafortune_make_base(const btfi_lafortune_shared *shared, btfi_lafortune_lobe *lobe, float *base);
/* Adds products of columns of all samples, `padded` floats apart, to sums. */
void btfi_lafortune_add_dots(const btfi_lafortune_shared *shared, const float *a, uint32_t a_count,
                             const float *b, uint32_t b_count, bool upper, double *sums, size_t sums_ld);

/* ---- fit of one group of channels of one texel (solve.c, point.c, albedos.c) ---- */

typedef struct btfi_lafortune_settings {
  uint32_t lobes, starts, iterations;
  double tolerance; /* relative fall of the cost below which a start has converged */
} btfi_lafortune_settings;

typedef struct btfi_lafortune_fitted {
  double cost;                               /* weighted squared error */
  double squared_error, energy;              /* without weights, and of the data itself; by measure */
  float shape[LAF_MAX_LOBES][LAF_MAX_SHAPE]; /* as stored, in descending order of what lobes carry */
  double albedo[LAF_MAX_ALBEDOS][LAF_MAX_CHANNELS];
  uint32_t iterations; /* of all starts */
} btfi_lafortune_fitted;

/* Receives the cost of each point that a descent accepts; for tests. Full matrices descend twice from a
 * start. */
typedef void (*btfi_lafortune_trace_fn)(void *user, uint32_t descent, double cost);

typedef struct btfi_lafortune_scratch btfi_lafortune_scratch;
uint64_t btfi_lafortune_scratch_bytes(const btfi_lafortune_shared *shared, uint32_t lobes, uint32_t channels);
/* `memory` of that many bytes, aligned to 64. */
btfi_lafortune_scratch *btfi_lafortune_scratch_init(void *memory, const btfi_lafortune_shared *shared,
                                                    uint32_t lobes, uint32_t channels);
void btfi_lafortune_scratch_trace(btfi_lafortune_scratch *scratch, btfi_lafortune_trace_fn trace, void *user);
/* values[sample * stride + channel] for `channels` of them. */
void btfi_lafortune_fit_group(btfi_lafortune_scratch *scratch, const btfi_lafortune_settings *settings,
                              const float *values, uint32_t stride, uint32_t channels,
                              btfi_lafortune_fitted *out);
/* Albedos of lobes as they are in `shape`, after fit_group of the same values. */
void btfi_lafortune_fit_albedos(btfi_lafortune_scratch *scratch, btfi_lafortune_fitted *io);
/* Cost, error and energy with the albedos as they are in `io`, after fit_albedos of the same lobes. */
void btfi_lafortune_measure(btfi_lafortune_scratch *scratch, btfi_lafortune_fitted *io);
/* The least cost over all albedos of lobes of these shapes, and its gradient by the variables of each lobe:
 * its coefficients and the logarithm of its exponent, or the logarithms of Ward's 1 / roughness^2. For tests.
 */
double btfi_lafortune_cost_gradient(btfi_lafortune_scratch *scratch, const float *values, uint32_t stride,
                                    uint32_t channels, const float (*shape)[LAF_MAX_SHAPE], double *gradient);

/* Minimises a^T G a - 2 a^T h over a >= 0; columns that depend on others to rounding stay 0. n <= 5. */
void btfi_lafortune_nonnegative(uint32_t n, const double *gram, size_t gram_ld, const double *h,
                                size_t h_stride, double *a);

/* ---- kernels (kernel_*.c) ---- */

/* Samples whose columns are made before they are multiplied, and floats from one column to the next: not a
 * power of two, which would crowd them into few sets of the cache. */
enum { LAF_CHUNK = 256, LAF_LD = LAF_CHUNK + 16 };

/* Four records of one level, and what the directions of a query give. Records of weight 0 are of some texel.
 */
typedef struct btfi_lafortune_taps {
  btfi_lafortune_terms terms;
  float weight[4]; /* scale of the level's albedos included */
  const unsigned char *texel[4];
  bool near_end; /* reading vectors from anywhere in some record may pass the end of the table */
} btfi_lafortune_taps;

struct btfi_lafortune_state;
typedef struct btfi_lafortune_kernels {
  /* base[i] = weighted sum of the terms; returns the largest. n is a multiple of 8. */
  float (*base)(const btfi_lafortune_lobe *lobe, const float *const *term, uint32_t n, float *base);
  /* Columns of one lobe for samples first .. first + n - 1 (n <= LAF_CHUNK, a multiple of 8): the lobe, then
   * its derivatives by its variables, LAF_LD floats apart. */
  void (*columns)(const btfi_lafortune_lobe *lobe, const float *const *term, const float *factor,
                  const float *base, uint32_t first, uint32_t n, float *columns);
  /* sums[i * sums_ld + j] += a_i . b_j over n samples; with `upper` only for j >= i need be right. */
  void (*dots)(const float *a, size_t a_ld, uint32_t a_count, const float *b, size_t b_ld, uint32_t b_count,
               uint32_t n, bool upper, double *sums, size_t sums_ld);
  /* out[i * channels + channel] = what taps i give, or with `add` that much more. */
  void (*eval)(const struct btfi_lafortune_state *state, const btfi_lafortune_taps *taps, uint32_t count,
               bool add, float *out);
} btfi_lafortune_kernels;
const btfi_lafortune_kernels *btfi_lafortune_kernels_of(uint32_t isa);
extern const btfi_lafortune_kernels btfi_lafortune_scalar;
#if defined(__x86_64__)
extern const btfi_lafortune_kernels btfi_lafortune_avx2;
#endif

/* ---- payload (fit.c, load.c) ---- */

typedef struct btfi_lafortune_head {
  uint32_t kind, lobes, colour, storage, levels, flags; /* flags: 0 */
  double squared_error, energy;                         /* of the finest level, without weights */
} btfi_lafortune_head;
enum { LAF_HEAD_BYTES = 40 };

btf_status btfi_lafortune_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                              const btf_options *options, const btf_job *job, btf_chunk_writer *payload);
btf_status btfi_lafortune_load(const btf_host *host, btf_context *ctx, uint32_t format,
                               const btf_model_shape *shape, btf_chunk_reader *payload, void **state);
void btfi_lafortune_destroy(const btf_host *host, btf_context *ctx, void *state);

/* ---- state and evaluation (eval.c) ---- */

typedef struct btfi_lafortune_state {
  const btf_host *host;
  const btf_dirset *light_set, *view_set;
  const btfi_lafortune_kernels *kernels;
  btfi_lafortune_layout layout;
  bool times_cosine;
  uint32_t wrap, levels;
  uint32_t level_width[LAF_MAX_LEVELS], level_height[LAF_MAX_LEVELS];
  uint64_t resident;
  const unsigned char *texels[LAF_MAX_LEVELS];
  const unsigned char *safe_end[LAF_MAX_LEVELS]; /* records from here on are near_end */
  float scale[LAF_MAX_LEVELS];                   /* of the albedos */
  btfi_lafortune_head head;
  /* For vector kernels: which lobe multiplies value i of the albedos of a group, -1 for none. */
  int32_t lobe_of[LAF_MAX_ALBEDOS * LAF_MAX_CHANNELS + 8];
} btfi_lafortune_state;

void btfi_lafortune_eval(const void *state, const btf_query *query, float *out);
void btfi_lafortune_eval_n(const void *state, const btf_batch *batch, float *const *out);
void btfi_lafortune_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                          uint32_t view, float *out);

/* ---- GPU (gpu.c) ---- */

extern const btf_gpu_layout_desc *const btfi_lafortune_gpu_layouts[];
btf_status btfi_lafortune_gpu(const btf_host *host, btf_context *ctx, const void *state,
                              const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                              btf_gpu_builder *out);

#endif
