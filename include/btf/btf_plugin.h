/* SPDX-License-Identifier: MIT */
/*
 * btf_plugin.h: for authors of codecs and formats, built in or loaded as modules. A codec includes this header and nothing of
 * the library's inside; it calls the library through the host table it is handed, so one binary works with the
 * static and the shared library. CONTRIBUTING.md shows how to add a codec step by step.
 *
 * A model is a set of payload chunks. `fit` writes them; `load` turns them into a state for evaluation. A fresh
 * fit is loaded from the same bytes that a file would hold, so that both evaluate alike bit for bit.
 */
#ifndef LIBBTF_BTF_PLUGIN_H
#define LIBBTF_BTF_PLUGIN_H

#include "btf_format.h"
#include "btf_gpu.h"
#include "btf_io.h"
#include "btf_model.h"

#ifdef __cplusplus
extern "C" {
#endif

/** Collects the payload of one model while it is fitted. */
typedef struct btf_chunk_writer btf_chunk_writer;
/** Gives the payload of one model while it is loaded. */
typedef struct btf_chunk_reader btf_chunk_reader;

/** FourCC of a chunk, first letter in the low byte. */
#define BTF_TAG(a, b, c, d)                                                                                  \
  ((uint32_t)(unsigned char)(a) | (uint32_t)(unsigned char)(b) << 8 | (uint32_t)(unsigned char)(c) << 16 |   \
   (uint32_t)(unsigned char)(d) << 24)

enum {
  /** Stored as it is on a 64-byte boundary and used straight from a mapping; otherwise zstd when that is smaller. */
  BTF_PAYLOAD_IN_PLACE = 1u << 0
};

/** Instruction sets for kernels, as capped by the context. Each includes those below it of its family. */
enum { BTF_ISA_SCALAR = 0, BTF_ISA_AVX2 = 1 /* with FMA and F16C */, BTF_ISA_AVX512 = 2 /* F, BW, VL, DQ */,
       BTF_ISA_NEON = 16 };

/** What every model has; given to `load`. FROZEN. */
typedef struct btf_model_shape {
  const btf_dirset *lights, *views;
  uint32_t width, height, channels, quantity, wrap, reserved;
} btf_model_shape;

/** Reads items item0 .. item0 + items - 1 of a matrix as floats, laid out as btf_svd_desc.layout says, with rows
 *  `ld` floats apart. Called from one thread. Values must be finite. */
typedef btf_status (*btf_matrix_read_fn)(void *user, uint64_t item0, uint64_t items, float *dst, size_t ld);
enum {
  BTF_LAYOUT_ITEM_ROWS = 0,   /**< element j of item i at dst[i * ld + j], ld >= length */
  BTF_LAYOUT_ITEM_COLUMNS = 1 /**< element j of item i at dst[j * ld + i], ld >= items */
};
/** A matrix of `items` vectors of `length` elements that is read in blocks of items, and what to compute of it. */
typedef struct btf_svd_desc {
  size_t struct_size;
  uint64_t items, length;
  btf_matrix_read_fn read;
  void *user;
  uint32_t layout;
  uint32_t rank; /**< triplets wanted; with a target, the most */
  /** 0, or a squared Frobenius residual: the smallest rank that reaches it is returned (or `rank`). */
  double target_residual;
  /** Accepted ratio of the Frobenius error to the optimal one, minus 1; 0 = 0.0005. */
  double tolerance;
  uint64_t max_working_set; /**< bytes beside the result; 0 = 1 GiB */
  uint64_t seed;
  uint32_t block_items; /**< preferred multiple of items per read, 0 = any */
  uint32_t reserved;    /**< must be 0 */
} btf_svd_desc;
/** A truncated singular value decomposition. Arrays are owned by the result. */
typedef struct btf_svd_result {
  size_t struct_size;
  uint32_t rank;
  uint32_t passes;      /**< complete readings of the matrix */
  float *item_vectors;    /**< items x rank, row-major, orthonormal columns */
  float *element_vectors; /**< length x rank, row-major, orthonormal columns */
  double *sigma;          /**< rank singular values, descending */
  double energy;          /**< squared Frobenius norm of the matrix */
  double residual;        /**< squared Frobenius error of the truncation */
  /** 0, or where max_working_set was too small (BTF_E_LIMIT) the least that would do. Filled although the call
   *  fails, for callers that can give only a share of their own budget and name the whole. */
  uint64_t least_working_set;
} btf_svd_result;

/** What one reading of a data set tells. */
typedef struct btf_statistics {
  size_t struct_size;
  double energy, centred_energy; /**< sums of squares, of the samples and of what the mean ABRDF leaves of them */
  double peak;                   /**< 99.9th percentile of all samples, from below */
} btf_statistics;

/** Receives the ABRDF of texel (x, y) of a level: abrdf[(view * lights + light) * channels + channel]. Called from
 *  tasks of `parallel`; `thread` is as there. It cannot fail: room it needs is made before, one for each thread. */
typedef void (*btf_abrdf_fn)(void *user, uint32_t level, uint32_t x, uint32_t y, const float *abrdf, uint32_t thread);

enum { BTF_TRANSPOSE_A = 1u << 0, BTF_TRANSPOSE_B = 1u << 1 };

/** A value of a JSON document. */
typedef struct btf_json btf_json;
enum { BTF_JSON_NULL, BTF_JSON_BOOL, BTF_JSON_NUMBER, BTF_JSON_STRING, BTF_JSON_ARRAY, BTF_JSON_OBJECT };

/** A folder that is being written. */
typedef struct btf_new_folder btf_new_folder;

/** Collects textures, numbers and shader text of one model while they are made ready for a GPU. */
typedef struct btf_gpu_builder btf_gpu_builder;

enum {
  /** One 3D texture instead of layers: what the papers call a stack. Never filtered along its depth. */
  BTF_GPU_STACK = 1u << 0,
  /** The sampler filters within a slice, and between levels. */
  BTF_GPU_FILTERED = 1u << 1,
  /** Its texels and levels are those of the material. */
  BTF_GPU_MATERIAL = 1u << 2,
  /** Numbers that are multiplied, added and blended, so that small errors of texels make small errors of results: the
   *  table may be compressed if the target wants it (as array layers then, whatever BTF_GPU_STACK says, and padded). */
  BTF_GPU_SMOOTH = 1u << 3,
  /** With BTF_GPU_SMOOTH: the relative error of values counts, as in factors of products. */
  BTF_GPU_WIDE = 1u << 4
};
/** Texels that the shader reads by their numbers: `levels` times `slices` images of width x height, halved as
 *  btf_level_pair says. What exceeds the layers of one texture becomes several. In the shader, with `name` btf_u:
 *    vec4 btf_u(int x, int y, int slice, int level)
 *    vec4 btf_u_mix(btf_place p, int slice)            the blend around p = btf_place_of(uv, lod), fetch by fetch, with
 *                                                     BTF_GPU_MATERIAL
 *    vec4 btf_u_at(vec2 uv, int slice, float lod)      the same by the sampler, with BTF_GPU_FILTERED */
typedef struct btf_gpu_table {
  size_t struct_size;
  const char *name; /**< begins with btf_ */
  uint32_t texel, width, height, slices, levels, wrap, flags;
  uint32_t reserved; /**< must be 0 */
} btf_gpu_table;

/** A layout that a codec exports. FROZEN. */
typedef struct btf_gpu_layout_desc {
  const char *name, *summary;
} btf_gpu_layout_desc;

/** What the library offers a codec. Grows at its end only. */
typedef struct btf_host {
  uint32_t struct_size, abi;

  /* Memory, counted against the context's limit; 64-byte aligned; NULL with the message set. */
  void *(*alloc)(btf_context *ctx, uint64_t count, uint64_t size);
  void (*free)(btf_context *ctx, void *ptr);

  /* Sets the message (one line, no newline) and returns `code`. */
  btf_status (*fail)(btf_context *ctx, btf_status code, const char *format, ...) LIBBTF_PRINTF(3, 4);
  void (*log)(btf_context *ctx, int32_t level, const char *format, ...) LIBBTF_PRINTF(3, 4);

  /* Threads. `thread` of a task is below thread_count. Calls from inside a task run serially. */
  btf_status (*parallel)(btf_context *ctx, uint32_t count, btf_task_fn task, void *job);
  uint32_t (*thread_count)(const btf_context *ctx);
  /* BTF_ISA_*: kernels for more than this must not run. */
  uint32_t (*isa)(const btf_context *ctx);
  /* BTF_OK to go on, BTF_E_CANCELLED to stop. Fraction of the whole fit. From the thread that called `fit`.
   * Here and below, `job` is the one that `fit` was given or a copy of it that lives no longer, for a codec that narrows
   * max_working_set for a part of its work. Reports go to the caller of the fit whatever progress and user the copy
   * has. A job made otherwise is BTF_E_INVALID_ARG. */
  btf_status (*progress)(const btf_job *job, double fraction, const char *stage);

  /* Data sets, as in btf_dataset.h. */
  btf_status (*dataset_describe)(const btf_dataset *ds, btf_dataset_desc *io);
  btf_status (*dataset_read)(const btf_dataset *ds, const btf_block *block, float *dst, const btf_strides *strides);

  /* Options by parameter name: number, bool or index of the choice; or text. The name must be one of the codec's: any
   * other gives 0 or NULL, and the fit ends with BTF_E_INVALID_ARG, naming codec and option. */
  double (*option)(const btf_options *options, const char *name);
  const char *(*option_text)(const btf_options *options, const char *name);
  /* 1 if the caller set the option, 0 if it has its default. */
  int32_t (*option_is_set)(const btf_options *options, const char *name);

  /* Directions, as in btf_dataset.h. */
  uint32_t (*dirset_count)(const btf_dirset *set);
  const float *(*dirset_directions)(const btf_dirset *set);
  void (*dirset_locate)(const btf_dirset *set, const float dir[3], btf_interp *out);
  void (*dirset_locate_n)(const btf_dirset *set, size_t n, const float *x, const float *y, const float *z,
                          btf_interp *out);
  uint32_t (*dirset_nearest)(const btf_dirset *set, const float dir[3]);

  /* Payload. put copies; reserve returns zeroed memory of the chunk to fill in place until `fit` returns. A tag and
   * index name a chunk and may be used once. get returns a pointer that lives as long as the model, aligned to 64
   * bytes; a chunk that is not there is BTF_E_CORRUPT. has returns 1 if it is there. */
  btf_status (*put)(btf_chunk_writer *w, uint32_t tag, uint32_t index, uint32_t flags, const void *src, uint64_t size);
  btf_status (*reserve)(btf_chunk_writer *w, uint32_t tag, uint32_t index, uint32_t flags, uint64_t size, void **dst);
  btf_status (*get)(btf_chunk_reader *r, uint32_t tag, uint32_t index, const void **data, uint64_t *size);
  int32_t (*has)(const btf_chunk_reader *r, uint32_t tag, uint32_t index);
  /* zstd level for this model's chunks when it is stored without a level of the caller's; 0 = default. */
  void (*set_zstd_level)(btf_chunk_writer *w, int32_t level);

  /* Truncated SVD under a memory budget (lib/svd). svd_free takes what svd filled. `job` may be NULL; its progress is
   * reported between the fractions from and to. */
  btf_status (*svd)(btf_context *ctx, const btf_svd_desc *desc, const btf_job *job, double from, double to,
                    btf_svd_result *out);
  void (*svd_free)(btf_context *ctx, btf_svd_result *result);

  /* Mip levels of a texture of n interleaved floats per texel. Level l has max(1, w >> l) x max(1, h >> l) texels,
   * each the area average of the finest texels it covers. mip_count is the number of levels down to 1 x 1. Texels
   * are src_ld (dst_ld) >= n floats apart, row after row without gaps. */
  uint32_t (*mip_count)(uint32_t width, uint32_t height);
  btf_status (*mip_filter)(btf_context *ctx, const float *src, size_t src_ld, uint32_t width, uint32_t height,
                           uint32_t n, uint32_t level, float *dst, size_t dst_ld);

  /* Hands every texel's ABRDF of one level of detail to `visit`, each once, in no particular order. The data set is
   * read once, in blocks that fit max_working_set (0 = 1 GiB). Coarser levels are area averages as of mip_filter,
   * summed in double. Progress goes from `from` to `to`. BTF_E_LIMIT names the budget that would do. */
  btf_status (*visit_abrdfs)(btf_context *ctx, const btf_dataset *ds, uint32_t level, uint64_t max_working_set,
                             btf_abrdf_fn visit, void *user, const btf_job *job, double from, double to,
                             const char *stage);

  /* Dense linear algebra through BLAS and LAPACK on row-major matrices; absent (BTF_E_UNSUPPORTED) in a build without
   * fitting. Large gemm and gram calls outside of tasks are divided among the context's threads, with results that do
   * not depend on their number while OpenBLAS has one thread; inside of tasks they run on the task's own.
   * gemm: c (m x n) = alpha op(a) op(b) + beta c, op transposes with BTF_TRANSPOSE_* (other flags are
   * BTF_E_INVALID_ARG); k is the inner size.
   * gram: g (columns x columns, both halves) += a^T a, in float over short runs of rows and in double beyond; runs
   * whose squares a float cannot hold are scaled by a power of two.
   * symmetric_eigen: a (n x n, both halves) becomes eigenvectors, one a row, of descending `values`.
   * cholesky: a (n x n, its lower half) becomes L with a = L L^T; BTF_E_NUMERIC unless it is positive definite.
   * cholesky_solve: solves L L^T x = b for `columns` right sides, b n x columns, in place. */
  btf_status (*gemm)(btf_context *ctx, uint32_t flags, uint64_t m, uint64_t n, uint64_t k, float alpha, const float *a,
                     size_t a_ld, const float *b, size_t b_ld, float beta, float *c, size_t c_ld);
  btf_status (*gram)(btf_context *ctx, uint64_t rows, uint32_t columns, const float *a, size_t a_ld, double *g);
  btf_status (*symmetric_eigen)(btf_context *ctx, uint32_t n, double *a, double *values);
  btf_status (*cholesky)(btf_context *ctx, uint32_t n, double *a);
  btf_status (*cholesky_solve)(btf_context *ctx, uint32_t n, const double *factor, uint32_t columns, double *b);

  /* The data set as a matrix of a row for each (view, light, channel), channel fastest, and a column for each texel, x
   * fastest. Both stay within max_working_set (0 = 1 GiB).
   * measure: energy, peak and, unless it is NULL, the mean of each row, in one reading in the direction the samples lie
   * in. It takes 4 MiB and a few rows or columns at least.
   * svd_dataset: svd of the matrix, with `mean` (or NULL) taken from each row; items are texels and elements are rows
   * in the result. It is read by texels or by images, as the budget suits; least_working_set is that of the better. Of desc, items, length, read, user, layout and block_items are not looked at. */
  btf_status (*measure)(btf_context *ctx, const btf_dataset *ds, uint64_t max_working_set, float *mean,
                        btf_statistics *out, const btf_job *job, double from, double to);
  btf_status (*svd_dataset)(btf_context *ctx, const btf_dataset *ds, const float *mean, const btf_svd_desc *desc,
                            const btf_job *job, double from, double to, btf_svd_result *out);

  /* For formats, as in btf_dataset.h. source_error is for a source's `read`, whose context is its own affair. */
  btf_status (*dirset_create)(btf_context *ctx, const float *xyz, uint32_t count, btf_dirset **out);
  btf_status (*dirset_create_named)(btf_context *ctx, const char *name, btf_dirset **out);
  void (*dirset_release)(btf_dirset *set);
  btf_status (*dataset_create)(btf_context *ctx, const btf_dataset_desc *desc, btf_dataset **out);
  btf_status (*source_error)(btf_status code, const char *format, ...) LIBBTF_PRINTF(2, 3);

  /* 1 with the value of a finite decimal number, whatever the locale: [+-] digits [. digits] [e [+-] digits] and nothing
   * else; 0 and *out untouched otherwise. */
  int32_t (*number)(const char *text, double *out);
  /* JSON. parse takes a whole document of RFC 8259 in UTF-8, 64 levels at most, no name twice in an object; a failure is
   * BTF_E_CORRUPT with line and column behind `name`. What it gives lives until free. The rest takes NULL and values of
   * other kinds: length is of arrays and objects, else 0; at is NULL out of range, get NULL without that member, number 0
   * and string NULL for values that are none (or have a NUL inside). */
  btf_status (*json_parse)(btf_context *ctx, const char *name, const char *text, uint64_t size, btf_json **out);
  void (*json_free)(btf_json *document);
  int32_t (*json_type)(const btf_json *value);
  uint64_t (*json_length)(const btf_json *value);
  const btf_json *(*json_at)(const btf_json *value, uint64_t i);
  const btf_json *(*json_get)(const btf_json *object, const char *name);
  double (*json_number)(const btf_json *value);
  const char *(*json_string)(const btf_json *value);

  /* For `gpu` of a codec (docs/gpu-export.md). Names are copied.
   * gpu_table: *number names the table in gpu_slice, which returns where the texels of one image go, zeroed, rows
   * without gaps; NULL for an image that the table does not have. gpu_uniform: `count` > 1 makes an array; values are
   * packed floats or int32_t, std140 is seen to. gpu_directions: the shader gets
   *   void btf_locate_NAME(vec3 direction, out ivec3 index, out vec3 weight)
   * for a set of directions; equal sets share textures. gpu_cost adds to what their search costs.
   * gpu_source appends shader text; it defines
   *   vec3 btf_stored(vec3 light, vec3 view, vec2 uv, float lod)
   * and may call what docs/gpu-export.md lists. Of a model of fewer than three channels only those are used. */
  btf_status (*gpu_table)(btf_gpu_builder *b, const btf_gpu_table *table, uint32_t *number);
  void *(*gpu_slice)(btf_gpu_builder *b, uint32_t number, uint32_t level, uint32_t slice);
  btf_status (*gpu_uniform)(btf_gpu_builder *b, const char *name, uint32_t type, uint32_t count, const void *values);
  btf_status (*gpu_directions)(btf_gpu_builder *b, const char *name, const btf_dirset *set);
  btf_status (*gpu_source)(btf_gpu_builder *b, const char *format, ...) LIBBTF_PRINTF(2, 3);
  void (*gpu_cost)(btf_gpu_builder *b, const btf_gpu_cost *cost);

  /* For formats that write, as in btf_dataset.h and btf_io.h. io_file with BTF_IO_WRITE gives a file beside its place,
   * which close(user, 0) renames. Its write and close set errno. */
  btf_status (*dataset_factors)(const btf_dataset *ds, btf_factors *io);
  btf_status (*io_file)(btf_context *ctx, const char *path, uint32_t mode, btf_io *io);

  /* A folder of files that appears complete or not at all. folder_begin makes it beside `path`, where nothing may be but
   * a folder in which `is_own` is 1 for the name of every entry, and of one at least; `title` says in messages what
   * that is. It and `is_own` are used until the end. folder_put writes a whole file. folder_end, called once, puts the
   * folder in its place or, with `failed` or when that fails, removes it. Not from several threads at once. */
  btf_status (*folder_begin)(btf_context *ctx, const char *path, const char *title, int32_t (*is_own)(const char *name),
                             btf_new_folder **out);
  btf_status (*folder_put)(btf_new_folder *folder, const char *name, const void *data, uint64_t size);
  btf_status (*folder_end)(btf_new_folder *folder, int32_t failed);

  /* gpu_directions with samples and weights from maps, those at the nearest texel's centre: *shift = the most weight, of
   * 1, that then lies on other samples than it should. What the weights of a set blend is off by no more than shift times
   * the largest difference between two of its samples' values. */
  btf_status (*gpu_direction_maps)(btf_gpu_builder *b, const char *name, const btf_dirset *set, double *shift);
} btf_host;

/** A codec. Copied at registration; optional slots may be NULL. Grows at its end only. `state` is what load made.
 *  Evaluation slots are total: whatever the bits of a query (NaN, infinities, below the horizon), they neither
 *  fail, allocate, lock nor touch memory outside the state; the library sets results outside the domain to 0. */
typedef struct btf_codec_vtbl {
  uint32_t struct_size, abi; /**< these two never move */
  const char *id;            /**< [a-z0-9._-], at most 63 bytes; without a dot for codecs of this project only */
  const char *title;         /**< one line */
  const char *version;
  uint64_t caps;
  const btf_param_desc *const *params; /**< NULL-terminated list of pointers; may be NULL */
  uint32_t format_read_min, format_write; /**< payload versions read (up to format_write) and written */
  /** Compresses. Optional: NULL without BTF_CAP_FIT. */
  btf_status (*fit)(const btf_host *host, btf_context *ctx, const btf_dataset *ds, const btf_options *options,
                    const btf_job *job, btf_chunk_writer *payload);
  /** Checks the payload and makes a state. The host table, the shape and the payload outlive the state. */
  btf_status (*load)(const btf_host *host, btf_context *ctx, uint32_t format, const btf_model_shape *shape,
                     btf_chunk_reader *payload, void **state);
  void (*destroy)(const btf_host *host, btf_context *ctx, void *state);
  /** Levels of detail of the state, at least 1. */
  uint32_t (*levels)(const void *state);
  /** Memory evaluation may touch, in bytes. */
  uint64_t (*resident_bytes)(const void *state);
  /** Stored quantity of one query, `channels` floats. lod beyond the last level means the last level. */
  void (*eval)(const void *state, const btf_query *query, float *out);
  /** Optional: the same for a batch, equal to eval bit for bit. The batch is complete (no NULL but lod). */
  void (*eval_n)(const void *state, const btf_batch *batch, float *const *out);
  /** One decoded sample; indices are in range. */
  void (*texel)(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light, uint32_t view, float *out);
  /** Optional: what a query costs, as btf_model_cost. `out` comes zeroed with struct_size set. */
  void (*cost)(const void *state, uint32_t flags, btf_eval_cost *out);
  /** Optional: layouts for a GPU, the default first, NULL-terminated; and what makes layout number `layout`. The target
   *  comes without zeros. Both or none. */
  const btf_gpu_layout_desc *const *gpu_layouts;
  btf_status (*gpu)(const btf_host *host, btf_context *ctx, const void *state, const btf_model_shape *shape,
                    uint32_t layout, const btf_gpu_target *target, btf_gpu_builder *out);
  /** Optional: writes the payload of given factors, kept as they are and unless the options say otherwise without loss.
   *  Options that only a fit looks at are refused when they are set. BTF_E_UNSUPPORTED, with the reason, for factors of
   *  a kind the codec does not hold; the library has checked them otherwise, but for values that are not finite. */
  btf_status (*from_factors)(const btf_host *host, btf_context *ctx, const btf_model_shape *shape,
                             const btf_factors *factors, const btf_options *options, const btf_job *job,
                             btf_chunk_writer *payload);
  /** Optional: the factors of a state's finest level, which live as long as it does. `out` comes initialised. */
  btf_status (*factors)(const void *state, btf_factors *out);
} btf_codec_vtbl;

/** What a format sees of a file or folder before it says whether it is its own. FROZEN. */
typedef struct btf_probe {
  const char *path;
  int32_t is_folder;
  uint32_t head_size;        /**< bytes of head; 0 for folders and empty files */
  const unsigned char *head; /**< how the file begins, up to 4096 bytes */
  uint64_t size;             /**< of the file */
} btf_probe;

/** A format. Copied at registration; optional slots may be NULL. Grows at its end only. */
typedef struct btf_format_vtbl {
  uint32_t struct_size, abi; /**< these two never move */
  const char *id;            /**< as of a codec */
  const char *title;         /**< one line */
  const char *version;
  const btf_param_desc *const *params; /**< NULL-terminated list of pointers; may be NULL */
  /** How sure it is, from the content, that the path is of this format: 0 no to 100, a signature of its own. The surest
   *  format opens it; of equally sure ones the one registered first. Cheap; fails silently with 0. */
  uint32_t (*probe)(const btf_host *host, btf_context *ctx, const btf_probe *probe);
  /** Checks the whole structure and makes a data set that reads samples when asked. The message of a failure begins with
   *  the path. */
  btf_status (*open)(const btf_host *host, btf_context *ctx, const char *path, const btf_options *options,
                     btf_dataset **out);
  const btf_param_desc *const *write_params; /**< for `write`; may be NULL */
  /** Optional: writes a data set, block by block within job->max_working_set, or the factors it has. What it writes
   *  appears complete or not at all, and replaces a file at the path, and a folder only if it is of its kind. Messages begin with the
   *  path; reports and cancelling by host->progress. */
  btf_status (*write)(const btf_host *host, btf_context *ctx, const char *path, const btf_dataset *ds,
                      const btf_options *options, const btf_job *job);
} btf_format_vtbl;

/** What a module exports. Names beginning with "libbtf " are for this project's own modules, whose codecs may have ids
 *  without a dot. */
typedef struct btf_plugin_info {
  uint32_t struct_size, abi;
  const char *name, *license;
  const btf_codec_vtbl *const *codecs;
  uint32_t codec_count;
  /** Bytes of btf_host that the codecs use: sizeof(btf_host) unless they look at host->struct_size themselves. A library
   *  whose table is shorter refuses the module. */
  uint32_t host_size_needed;
  const btf_format_vtbl *const *formats; /**< may be NULL; a module offers one codec or format at least */
  uint32_t format_count, reserved;       /**< reserved must be 0 */
} btf_plugin_info;
/** Name of a module's one entry point; the ABI generation is part of it. */
#define BTF_PLUGIN_ENTRY btf_plugin_entry_1
#define BTF_PLUGIN_ENTRY_NAME "btf_plugin_entry_1"
typedef const btf_plugin_info *(*btf_plugin_entry_fn)(uint32_t host_abi);

/** Registers a codec in a context after checking it: ABI, required slots, id, parameters and their defaults,
 *  capabilities against slots. A built-in or earlier codec cannot be replaced. BTF_E_PLUGIN, BTF_E_ABI.
 *  Threads: exclusive, before the context's codecs are used. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_context_register(btf_context *ctx, const btf_codec_vtbl *codec);

/** Registers what a description offers, linked in instead of loaded: all of it or nothing. It need not outlive the call,
 *  what it points to must outlive the context. BTF_E_PLUGIN, BTF_E_ABI. Threads: exclusive. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_context_register_plugin(btf_context *ctx, const btf_plugin_info *plugin);

/** Loads a module by absolute path and registers its codecs and formats: all of them or none. Loading runs the module's code;
 *  no file that libbtf opens can cause it. The module stays loaded as long as the context lives. Threads: exclusive. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_context_load_plugin(btf_context *ctx, const char *absolute_path);

#ifdef __cplusplus
}
#endif
#endif
