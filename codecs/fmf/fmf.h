/* SPDX-License-Identifier: MIT */
/* fmf.h: inside of the full matrix factorisation codec (docs/codecs/fmf.md).
 *
 * B = U S V^T. Rows of B are (view, light, channel), columns are texels. Evaluation works on `columns`
 * products U_k V_k scale_k: the components, and where storage is coarse, the rounding errors of the leading
 * ones as columns of their own. */
#ifndef BTFI_FMF_H
#define BTFI_FMF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <btf/btf_codec.h>

enum { FMF_F32 = 0, FMF_F16 = 1, FMF_BF16 = 2, FMF_Q8 = 3, FMF_STORAGES };
enum { FMF_PACKED = 0, FMF_PLAIN = 1, FMF_CODINGS };
enum { FMF_MAX_COMPONENTS = 1024, FMF_MAX_COLUMNS = 1088, FMF_MAX_LEVELS = 32, FMF_MAX_CHANNELS = 64 };

/* Payload chunks (docs/codecs/fmf.md). */
#define FMF_TAG_HEAD BTF_TAG('H', 'E', 'A', 'D')
#define FMF_TAG_SIGMA BTF_TAG('S', 'I', 'G', 'M')
#define FMF_TAG_COLUMNS BTF_TAG('C', 'O', 'L', 'S') /* plain */
#define FMF_TAG_U BTF_TAG('U', 'R', 'O', 'W')
#define FMF_TAG_V BTF_TAG('V', 'R', 'O', 'W')
#define FMF_TAG_PACKED_U BTF_TAG('U', 'P', 'A', 'K') /* packed */
#define FMF_TAG_PACKED_V BTF_TAG('V', 'P', 'A', 'K')

/* ---- layout of the evaluation tables (layout.c) ---- */

/* Tables hold `columns` values a row in the storage type, U for each channel. Kernels take 16 values at a
 * time; what they read beyond the columns is zero in V and its scale. */
typedef struct btfi_fmf_layout {
  uint32_t channels, lights, views, width, height;
  uint32_t storage, columns, levels;
  uint32_t stride; /* columns rounded up to 4: channel c of a row of U starts at value c * stride */
  uint32_t
      padded; /* columns rounded up to 16: values in a row of V; so many are readable from every start in U */
  uint64_t u_row_bytes;                  /* odd number of cache lines, to spread rows over cache sets */
  uint64_t u_data_bytes;                 /* of these, the bytes that hold values */
  uint64_t u_bytes;                      /* the table */
  uint64_t v_texel_bytes;                /* one row of V */
  uint64_t v_line_bytes[FMF_MAX_LEVELS]; /* one line of texels of a level, an odd number of cache lines */
  uint64_t v_bytes[FMF_MAX_LEVELS];
  uint32_t level_width[FMF_MAX_LEVELS], level_height[FMF_MAX_LEVELS];
} btfi_fmf_layout;

/* false if a size does not fit 64 bits. */
bool btfi_fmf_layout_of(const btf_model_shape *shape, uint32_t lights, uint32_t views, uint32_t storage,
                        uint32_t columns, uint32_t levels, btfi_fmf_layout *out);
uint32_t btfi_fmf_value_bytes(uint32_t storage);
/* Writes n values within -1 .. 1. */
void btfi_fmf_store(uint32_t storage, const float *values, uint64_t n, unsigned char *dst);
/* What storage makes of a value within -1 .. 1. */
float btfi_fmf_round(uint32_t storage, float value);

/* ---- kernels (kernel_*.c) ---- */

/* One to nine rows and their weights, added in order. */
typedef struct btfi_fmf_rows {
  const unsigned char *row[9];
  float weight[9];
  uint32_t count;
} btfi_fmf_rows;

/* dst[i] = scale[i] * sum over rows of weight * row[i], for `padded` values. Kernels may keep them in an
 * order of their own, which permute() gives the scale. */
typedef void (*btfi_fmf_blend_fn)(const btfi_fmf_rows *v, uint32_t padded, const float *scale, float *dst);
/* The dot product of each channel of the blended rows of U with v; with `keep`, the blended rows themselves
 * as well, `padded` values per channel. Channels are channel_bytes apart. */
typedef void (*btfi_fmf_project_fn)(const btfi_fmf_rows *u, uint64_t channel_bytes, uint32_t channels,
                                    const float *v, uint32_t padded, float *keep, float *out);
/* What both make of one row each. */
typedef void (*btfi_fmf_sample_fn)(const unsigned char *u, uint64_t channel_bytes, uint32_t channels,
                                   const unsigned char *v, uint32_t padded, const float *scale, float *out);
/* The same as project from rows that were kept. */
typedef void (*btfi_fmf_dot_fn)(const float *kept, uint32_t channels, const float *v, uint32_t padded,
                                float *out);
typedef struct btfi_fmf_kernels {
  btfi_fmf_blend_fn blend[FMF_STORAGES];
  btfi_fmf_project_fn project[FMF_STORAGES];
  btfi_fmf_sample_fn sample[FMF_STORAGES];
  btfi_fmf_dot_fn dot;
  void (*permute)(uint32_t storage, uint32_t padded, const float *natural, float *out);
} btfi_fmf_kernels;
/* Kernels of an instruction set of the processor, the scalar ones where there are none. */
const btfi_fmf_kernels *btfi_fmf_kernels_of(uint32_t isa);
extern const btfi_fmf_kernels btfi_fmf_scalar;
#if defined(__x86_64__)
extern const btfi_fmf_kernels btfi_fmf_avx2, btfi_fmf_avx512;
#endif
#if defined(__aarch64__)
extern const btfi_fmf_kernels btfi_fmf_neon;
#endif

/* ---- from components to columns of the tables (columns.c) ---- */

enum { FMF_SIDE_U = 0, FMF_SIDE_V = 1 };
enum { FMF_LARGEST_INTEGER = 1 << 22 }; /* of the packed coding */

/* Components of a factorisation: B = sum over k of U_k V_k^T. U_k has rows = views * lights * channels
 * values, V_k one for each texel. */
typedef struct btfi_fmf_factors {
  uint32_t components;
  uint64_t length[2]; /* values of a component on each side */
  /* Writes component k of a side. Called from several threads. */
  void (*column)(const void *user, uint32_t side, uint32_t k, float *dst);
  const void *user;
  /* A column is divided by a power of two instead where that loses less: of values that were rounded before,
   * nothing at all. */
  bool by_powers;
} btfi_fmf_factors;

/* A column of the tables: a component as rounded by the storage, or what the rounding of one side left. */
typedef struct btfi_fmf_column {
  uint32_t component;
  uint8_t rest[2]; /* of each side: 0 = the values, 1 = what their rounding left */
  float scale[2];  /* of each side: the table holds values divided by this */
} btfi_fmf_column;

typedef struct btfi_fmf_plan {
  uint32_t columns;
  double squared_error; /* that storage adds to the squared Frobenius error */
  btfi_fmf_column column[FMF_MAX_COLUMNS];
} btfi_fmf_plan;

/* Chooses the columns: the components, then the rounding errors that matter most, as many as the padding of
 * rows holds, and for 8-bit storage until they are at most `tolerated` or 64 are added. */
btf_status btfi_fmf_plan_columns(const btf_host *host, btf_context *ctx, const btfi_fmf_factors *factors,
                                 uint32_t storage, double tolerated, btfi_fmf_plan *out);
/* What a stored 1 of a side stands for, and the product of both sides. */
float btfi_fmf_side_scale(uint32_t storage, const btfi_fmf_column *column, uint32_t side);
float btfi_fmf_column_scale(uint32_t storage, const btfi_fmf_column *column);
/* Fills the tables, which are zero, from the factors; levels of V by filtering its finest. */
btf_status btfi_fmf_fill_tables(const btf_host *host, btf_context *ctx, const btfi_fmf_factors *factors,
                                const btfi_fmf_plan *plan, const btfi_fmf_layout *layout, unsigned char *u,
                                unsigned char *const *v);

/* ---- packed coding (packed.c) ---- */

/* Where a value's neighbours are. */
typedef struct btfi_fmf_grid {
  uint32_t channels, inner, outer; /* values are outer x inner x channels: view, light, channel, or y, x, 1 */
} btfi_fmf_grid;

/* Integers of one side, column by column; decodes to floats through btfi_fmf_factors. */
typedef struct btfi_fmf_packed {
  btfi_fmf_grid grid[2];
  const unsigned char *data[2];
  uint64_t *start[2]; /* offset of each column in data */
  double step[2];
  const double *sigma; /* U is stored times its singular value, which decoding divides by */
} btfi_fmf_packed;

/* Rounds the columns of a side, each times weight[k] (NULL = 1), to multiples of step and appends them to a
 * chunk. */
btf_status btfi_fmf_pack(const btf_host *host, btf_context *ctx, const btfi_fmf_factors *factors,
                         uint32_t side, const btfi_fmf_grid *grid, const double *weight, double step,
                         btf_chunk_writer *writer, uint32_t tag);
/* Checks a chunk and finds its columns; `start` has room for the components. */
btf_status btfi_fmf_unpack(const btf_host *host, btf_context *ctx, const char *name, const void *data,
                           uint64_t size, const btfi_fmf_grid *grid, uint32_t components, uint64_t *start);
/* btfi_fmf_factors.column of a btfi_fmf_packed. */
void btfi_fmf_packed_column(const void *packed, uint32_t side, uint32_t k, float *dst);

/* ---- payload (load.c, write.c) ---- */

typedef struct btfi_fmf_head {
  uint32_t coding, storage, components, columns, levels, flags; /* columns: 0 in packed coding */
  double step[2];                                               /* packed: of U S and V S */
  double squared_error, energy; /* squared Frobenius norms: predicted error of the model, and the data */
  double tolerated;             /* squared error that 8-bit storage may add */
} btfi_fmf_head;
enum { FMF_HEAD_BYTES = 64 /* 6 of 32 bits, 5 of 64 */, FMF_COLUMN_BYTES = 16, FMF_FLAG_MEAN = 1 };

void btfi_fmf_put_head(const btfi_fmf_head *head, unsigned char bytes[FMF_HEAD_BYTES]);
void btfi_fmf_put_columns(const btfi_fmf_plan *plan, unsigned char *bytes);
void btfi_fmf_put_sigma(const double *sigma, uint32_t components, unsigned char *bytes);
btf_status btfi_fmf_load(const btf_host *host, btf_context *ctx, uint32_t format,
                         const btf_model_shape *shape, btf_chunk_reader *payload, void **state);
void btfi_fmf_destroy(const btf_host *host, btf_context *ctx, void *state);
/* Factors on their way into a payload. */
typedef struct btfi_fmf_writing {
  const btf_host *host;
  btf_context *ctx;
  btf_chunk_writer *payload;
  uint32_t views, lights, channels, width, height;
  double loss;        /* relative growth of the error by packing */
  double target;      /* squared Frobenius error to reach with as few components as possible, or INFINITY */
  double target_psnr; /* what it stands for; 0 = an rmse */
  btfi_fmf_head head; /* given: coding, storage, levels, flags, energy */
  /* Column k of a side at values[side] + k * length[side]; U orthonormal, V with its singular value. */
  btfi_fmf_factors factors;
  float *values[2];
  double *sigma;
  double *residual; /* squared error of the first k components at [k] */
  btfi_fmf_plan plan;
} btfi_fmf_writing;

/* What is asked of the payload: coding, storage, levels, loss. */
void btfi_fmf_read_storage(btfi_fmf_writing *f, const btf_options *options);
/* The sizes of the factors, and room for what is known of each; freed also after a failure. */
btf_status btfi_fmf_writing_open(btfi_fmf_writing *f, uint32_t components);
/* The same with room for the factors themselves. */
btf_status btfi_fmf_writing_alloc(btfi_fmf_writing *f, uint32_t components);
void btfi_fmf_writing_free(btfi_fmf_writing *f);
/* Squared relative error of rounding both factors, about; it only shifts where the choice of components
 * begins. */
double btfi_fmf_storage_floor(uint32_t storage);
double btfi_fmf_packing_growth(const btfi_fmf_writing *f);
btf_status btfi_fmf_choose_components(btfi_fmf_writing *f);
btf_status btfi_fmf_write(btfi_fmf_writing *f);

btf_status btfi_fmf_fit(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                        const btf_options *options, const btf_job *job, btf_chunk_writer *payload);

/* ---- given factors (factors.c) ---- */

btf_status btfi_fmf_from_factors(const btf_host *host, btf_context *ctx, const btf_model_shape *shape,
                                 const btf_factors *given, const btf_options *options, const btf_job *job,
                                 btf_chunk_writer *payload);
btf_status btfi_fmf_factors_of(const void *state, btf_factors *out);

/* ---- state and evaluation (eval.c) ---- */

typedef struct btfi_fmf_state {
  const btf_host *host;
  const btf_dirset *light_set, *view_set;
  btfi_fmf_blend_fn blend;
  btfi_fmf_project_fn project;
  btfi_fmf_sample_fn sample;
  btfi_fmf_dot_fn dot;
  const unsigned char *u;
  const unsigned char *v[FMF_MAX_LEVELS];
  uint64_t channel_bytes;
  bool can_keep; /* the blended rows of all channels fit the scratch of a batch */
  uint32_t wrap, components, coding;
  uint64_t resident;
  btfi_fmf_layout layout;
  void *owned[FMF_MAX_LEVELS + 1];           /* decoded tables; NULL where the payload is used in place */
  float side_scale[2][FMF_MAX_COLUMNS];      /* of each side, in the order of the columns */
  float column_scale[FMF_MAX_COLUMNS];       /* 0 beyond the columns */
  _Alignas(64) float scale[FMF_MAX_COLUMNS]; /* the same as the kernels want them */
} btfi_fmf_state;

/* Derives the members that evaluation needs from `layout`, the shape and the scales of the columns. */
void btfi_fmf_state_ready(btfi_fmf_state *state, const btf_host *host, btf_context *ctx,
                          const btf_model_shape *shape, const float *scale);
void btfi_fmf_eval(const void *state, const btf_query *query, float *out);
void btfi_fmf_eval_n(const void *state, const btf_batch *batch, float *const *out);
void btfi_fmf_texel(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light, uint32_t view,
                    float *out);

/* ---- export for a GPU (gpu.c) ---- */

extern const btf_gpu_layout_desc *const btfi_fmf_gpu_layouts[];
btf_status btfi_fmf_gpu(const btf_host *host, btf_context *ctx, const void *state,
                        const btf_model_shape *shape, uint32_t layout, const btf_gpu_target *target,
                        btf_gpu_builder *out);

#endif
