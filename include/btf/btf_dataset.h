/* SPDX-License-Identifier: MIT */
/*
 * btf_dataset.h: direction sets and sampled 6D data.
 *
 * Frame: x = tangent (u grows), y = bitangent (v grows), z = normal. `light` points from the surface toward the
 * light, `view` toward the viewer; both unit. Row 0 of a texture is v nearest 0, the bottom row.
 */
#ifndef LIBBTF_BTF_DATASET_H
#define LIBBTF_BTF_DATASET_H

#include "btf_base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- Direction sets ---- */

/** A set of unit vectors of the upper hemisphere with its Delaunay triangulation in parabolic coordinates
 *  (x, y) / (1 + z) (Schwartz 2013, sect. 4). Immutable, reference counted. */
typedef struct btf_dirset btf_dirset;

/** Up to three samples and their weights: weight >= 0, sum 1. Unused entries have weight 0 and a valid index.
 *  FROZEN. */
typedef struct btf_interp {
  uint32_t index[3];
  float weight[3];
} btf_interp;

/** Makes a set of `count` directions from 3 * count floats. Each must have z > 0 and length 1 within 1e-3 (it is
 *  normalised if it is off by more than 1e-5). Two are equal or at least 1e-4 rad apart. Of equal ones, as of a
 *  measurement that was repeated, the first stands for all where a direction is looked up; the others are samples to be
 *  reached by their index. Errors name the offending index: BTF_E_INVALID_ARG, BTF_E_LIMIT, BTF_E_NOMEM. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dirset_create(btf_context *ctx, const float *xyz, uint32_t count,
                                                         btf_dirset **out);

/** Makes a built-in set: "ubo81" (81 directions of the Bonn gonioreflectometer), "ubo151" (the Bonn dome), or
 *  "grid:PxT" (P azimuths phi = 2 pi j / P times T elevations theta = (i + 0.5) / T * pi / 2). Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dirset_create_named(btf_context *ctx, const char *name,
                                                               btf_dirset **out);

/** Adds a reference and returns the set. Threads: const. */
LIBBTF_API btf_dirset *btf_dirset_retain(const btf_dirset *set);
LIBBTF_API void btf_dirset_release(btf_dirset *set);

/** Number of directions. Threads: const. */
LIBBTF_API uint32_t btf_dirset_count(const btf_dirset *set);
/** The directions: 3 * count floats. Threads: const. */
LIBBTF_API const float *btf_dirset_directions(const btf_dirset *set);
/** The triangles, three indices each, counter-clockwise in parabolic coordinates; *count is their number, 0 for
 *  a degenerate set (fewer than three directions, or all on a line). Threads: const. */
LIBBTF_API const uint32_t *btf_dirset_triangles(const btf_dirset *set, uint32_t *count);

/** Interpolation weights for a direction: barycentric in the triangle that holds it in parabolic coordinates;
 *  outside the hull those of the nearest point of the hull. Exact at samples, continuous everywhere. A direction
 *  below the horizon is treated as lying on it, one that is not finite as sample 0. Never fails, allocates or
 *  locks; constant time. Threads: const. */
LIBBTF_API void btf_dirset_locate(const btf_dirset *set, const float dir[3], btf_interp *out);
/** The same for n directions given as three arrays. Threads: const. */
LIBBTF_API void btf_dirset_locate_n(const btf_dirset *set, size_t n, const float *x, const float *y,
                                    const float *z, btf_interp *out);
/** The sample closest in angle; the smaller index on a tie. Total like locate. Threads: const. */
LIBBTF_API uint32_t btf_dirset_nearest(const btf_dirset *set, const float dir[3]);

/* ---- Data sets ---- */

/** A sampled BTF: texel x light x view x channel, resident, mapped or streamed. Immutable, reference counted. */
typedef struct btf_dataset btf_dataset;

/** Sample types. U8 and U16 are linear fractions of their maximum. */
enum { BTF_SAMPLE_U8 = 1, BTF_SAMPLE_F16 = 2, BTF_SAMPLE_F32 = 3, BTF_SAMPLE_U16 = 4 };
/** What a sample means: f (1/sr, no cosine), or f times the cosine of the light. */
enum { BTF_QUANTITY_BRDF = 1, BTF_QUANTITY_BRDF_COS = 2 };
/** Whether f is known up to a factor only. */
enum { BTF_SCALE_RELATIVE = 0, BTF_SCALE_ABSOLUTE = 1 };
/** How positions outside 0..1 are read. */
enum { BTF_WRAP_PERIODIC = 0, BTF_WRAP_CLAMP = 1 };

/** A box of samples: views view0 .. view0 + views - 1, and so on. FROZEN. */
typedef struct btf_block {
  uint32_t view0, views, light0, lights, x0, y0, width, height;
} btf_block;
/** Distance in bytes between neighbours along each axis. FROZEN. */
typedef struct btf_strides {
  ptrdiff_t view, light, y, x, channel;
} btf_strides;

/** Source of a streamed data set: writes the block's samples, in the data set's sample type, to dst at the given
 *  strides. Where the data set has per-view light lists, light0 and lights count within the list of the block's
 *  one view. Returns BTF_OK or a status; it may set the message with btf_source_error(). */
typedef btf_status (*btf_read_block_fn)(void *user, const btf_block *block, void *dst,
                                        const btf_strides *dst_strides);

/* ---- Factors ---- */

/** Sides of a product: directions with their channels, and texels. */
enum { BTF_SIDE_ANGULAR = 0, BTF_SIDE_TEXEL = 1 };

/** Samples as sums of products, as factorised measurements and models have them: of all views in one, or of each view
 *  by itself. Of product p, with angular vectors A_k and texel vectors T_k, a sample is
 *      sum over k < components[p] of  A_k[row] * T_k[y * width + x]
 *  where row = (view * lights + light) * channels + channel if there is one product, and light * channels + channel in
 *  that of the view otherwise. */
typedef struct btf_factors {
  size_t struct_size;
  uint32_t products;          /**< 1, or as many as views */
  uint32_t value_bytes;       /**< 2 if half floats hold the vectors without loss, up to a factor for each; otherwise 4 */
  const uint32_t *components; /**< of each product, at least 1 */
  /** Writes vector k of a side of a product, whole. It cannot fail; called from several threads at once. */
  void (*column)(const void *user, uint32_t product, uint32_t side, uint32_t k, float *dst);
  const void *user;
} btf_factors;
#define BTF_FACTORS_INIT                                                                                     \
  { sizeof(btf_factors), 0, 0, NULL, NULL, NULL }

/** Gives the factors a source is made of, which live as long as it does, or a status with the reason why they do not
 *  stand for its samples exactly (btf_source_error). The struct comes initialised. */
typedef btf_status (*btf_factors_fn)(void *user, btf_factors *out);

/** Flags of a data set. */
enum {
  BTF_DATASET_CONCURRENT_READ = 1u << 0, /**< `read` may be called from several threads at once */
  BTF_DATASET_IMAGE_MAJOR = 1u << 1      /**< whole images are cheap to read, columns of texels are dear */
};

/** Description of a data set; the same struct creates and describes one. */
typedef struct btf_dataset_desc {
  size_t struct_size;
  const btf_dirset *lights, *views; /**< retained */
  uint32_t width, height;           /**< texels */
  uint32_t channels;                /**< 1 to 64 */
  uint32_t sample_type, quantity, scale, wrap, flags;
  const char *const *channel_names; /**< NULL = "Y", or "R", "G", "B", or "C0", "C1" ... */
  const char *color_space;          /**< NULL = "lin_rec709" for RGB, "" otherwise; kept verbatim */
  const char *name, *source, *license; /**< NULL = unknown */
  double texels_per_mm;             /**< 0 = unknown */
  /* Either resident samples, borrowed until `release` is called; strides of any size and sign, all 0 = dense and
   * image-major (view, light, y, x, channel)... */
  const void *data;
  btf_strides strides;
  /* ...or a source pulled block by block. */
  btf_read_block_fn read;
  void *user;
  void (*release)(void *user); /**< may be NULL; called when the data set goes, also when creating it failed */
  /** NULL, or one light set for each view (measured sets whose lights differ between views). Samples are then
   *  read from those and interpolated to `lights`, which stays the set that everybody sees. */
  const btf_dirset *const *view_lights;
  /** NULL, or what is known of the data beside the above: key, text, key, text ..., NULL. */
  const char *const *notes;
  /** NULL, or of a source: the factors that its samples are products of. */
  btf_factors_fn factors;
} btf_dataset_desc;
#define BTF_DATASET_DESC_INIT                                                                                \
  {                                                                                                          \
    sizeof(btf_dataset_desc), NULL, NULL, 0, 0, 0, BTF_SAMPLE_F32, BTF_QUANTITY_BRDF, BTF_SCALE_RELATIVE,    \
        BTF_WRAP_PERIODIC, 0, NULL, NULL, NULL, NULL, NULL, 0.0, NULL, {0, 0, 0, 0, 0}, NULL, NULL, NULL,    \
        NULL, NULL, NULL                                                                                     \
  }

/** Creates a data set from a description. What desc->user stands for is the library's from here on: `release` is
 *  called once, when the data set goes or before a failure returns. Only a description that cannot be read, since its
 *  struct_size is wrong, leaves it with the caller. Errors: BTF_E_INVALID_ARG, BTF_E_LIMIT, BTF_E_ABI, BTF_E_NOMEM. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_create(btf_context *ctx, const btf_dataset_desc *desc,
                                                          btf_dataset **out);

/** Opens a data set on disk: a data-set folder (docs/dataset-folder.md). The samples are mapped, never loaded as
 *  a whole. Errors: BTF_E_IO, BTF_E_NOT_BTF, BTF_E_CORRUPT, BTF_E_TRUNCATED, BTF_E_NEWER, BTF_E_LIMIT. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_open(btf_context *ctx, const char *path, btf_dataset **out);

LIBBTF_API btf_dataset *btf_dataset_retain(const btf_dataset *ds);
LIBBTF_API void btf_dataset_release(btf_dataset *ds);

/** Fills a description (the caller sets struct_size). Pointers live as long as the data set; `read`, `user`, `release`
 *  and `factors` stay NULL, for they belong to this data set. `data` and `strides`
 *  are set when the samples are resident or mapped. Threads: const. */
LIBBTF_API btf_status btf_dataset_describe(const btf_dataset *ds, btf_dataset_desc *io);

/** Reads a block as floats to dst at byte strides (all multiples of 4). Integer samples become fractions. A
 *  sample that is not finite is BTF_E_CORRUPT, and the message names its place.
 *  Threads: const (sources without CONCURRENT_READ are serialised inside). */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_read(const btf_dataset *ds, const btf_block *block, float *dst,
                                                        const btf_strides *dst_strides);

/** Apparent BRDFs of `texels` neighbours of row y from column x on: views * lights * channels floats each, channel
 *  fastest, then light. Threads: const. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_read_abrdf(const btf_dataset *ds, uint32_t x, uint32_t y,
                                                              uint32_t texels, float *dst);

/** The factors that a data set is made of; the caller sets struct_size. They live as long as the data set.
 *  BTF_E_UNSUPPORTED, with the reason, where it has none or they do not stand for its samples. Threads: const. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_factors(const btf_dataset *ds, btf_factors *io);

/** Sets this thread's error message from inside a source's `read` or `factors` and returns `code`. Threads: free. */
LIBBTF_API btf_status btf_source_error(btf_status code, const char *format, ...) LIBBTF_PRINTF(2, 3);

/* ---- Writing a data-set folder ---- */

typedef struct btf_dataset_writer btf_dataset_writer;
/** Order of the samples in samples.bin. */
enum { BTF_ORDER_VLYXC = 1, BTF_ORDER_YXVLC = 2 };

/** Starts a folder beside its final place. Of the description the sizes, directions, sample type and texts are
 *  used. Errors: BTF_E_IO, BTF_E_INVALID_ARG, BTF_E_LIMIT. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_writer_create(btf_context *ctx, const char *path,
                                                                 const btf_dataset_desc *desc, uint32_t order,
                                                                 btf_dataset_writer **out);
/** Writes one block given as floats, converting to the sample type (integers are rounded and clamped to 0..1).
 *  Blocks may come in any order and from several threads; each sample exactly once. NaN and infinity are refused,
 *  and so are values beyond the range of half floats in an f16 folder. Threads: const. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_writer_put(btf_dataset_writer *w, const btf_block *block,
                                                              const float *src, const btf_strides *src_strides);
/** Adds a string to the manifest under a key of the caller's (unknown to readers). Threads: exclusive. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_writer_text(btf_dataset_writer *w, const char *key,
                                                               const char *value);
/** Flushes, renames the folder to its final place (replacing a previous data-set folder) and frees the writer, also on
 *  failure. Fails with BTF_E_STATE when samples are missing. Threads: exclusive. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_writer_finish(btf_dataset_writer *w);
/** Removes what was written and frees the writer; NULL is fine. Threads: exclusive. */
LIBBTF_API void btf_dataset_writer_abort(btf_dataset_writer *w);

#ifdef __cplusplus
}
#endif
#endif
