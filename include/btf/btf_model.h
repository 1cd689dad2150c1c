/* SPDX-License-Identifier: MIT */
/*
 * btf_model.h: codecs seen from outside, and the model that every renderer evaluates.
 */
#ifndef LIBBTF_BTF_MODEL_H
#define LIBBTF_BTF_MODEL_H

#include "btf_dataset.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- Codecs ---- */

/** A registered codec, owned by its context. */
typedef struct btf_codec btf_codec;

enum { BTF_PARAM_INT = 1, BTF_PARAM_FLOAT = 2, BTF_PARAM_BOOL = 3, BTF_PARAM_CHOICE = 4, BTF_PARAM_STRING = 5 };

/** All that a command line or a dialog needs to show and check one option of a codec. */
typedef struct btf_param_desc {
  size_t struct_size;
  const char *name, *summary, *unit, *default_text; /**< unit may be NULL */
  const char *const *choices;                       /**< NULL-terminated; BTF_PARAM_CHOICE only */
  double minimum, maximum;                          /**< inclusive; infinite = open */
  uint32_t type, flags; /**< flags must be 0 */
} btf_param_desc;

/** Capabilities. */
enum {
  BTF_CAP_FIT = 1u << 0,        /**< can compress data sets */
  BTF_CAP_STREAM_FIT = 1u << 1, /**< never holds the whole data set */
  BTF_CAP_BATCH = 1u << 2,      /**< has a batch evaluation of its own */
  BTF_CAP_LOD = 1u << 3,        /**< has coarser levels */
  BTF_CAP_LINEAR = 1u << 4,     /**< filtering the representation equals filtering the colours */
  BTF_CAP_RGB_ONLY = 1u << 5,   /**< accepts data of three channels only */
  BTF_CAP_HARDENED = 1u << 6    /**< its loader is fuzzed and safe on hostile files */
};

/** Codecs of a context. Threads: const. */
LIBBTF_API uint32_t btf_codec_count(const btf_context *ctx);
LIBBTF_API const btf_codec *btf_codec_at(const btf_context *ctx, uint32_t i);
/** By id: a short name of ours such as "fmf", or reverse DNS of a third party. NULL if absent. Threads: const. */
LIBBTF_API const btf_codec *btf_codec_find(const btf_context *ctx, const char *id);
LIBBTF_API const char *btf_codec_id(const btf_codec *codec);
LIBBTF_API const char *btf_codec_title(const btf_codec *codec);
LIBBTF_API uint64_t btf_codec_caps(const btf_codec *codec);
LIBBTF_API uint32_t btf_codec_param_count(const btf_codec *codec);
/** Describes parameter i; the caller sets io->struct_size. Threads: const. */
LIBBTF_API btf_status btf_codec_param(const btf_codec *codec, uint32_t i, btf_param_desc *io);

/** Values for a codec's parameters, checked when set. */
typedef struct btf_options btf_options;
LIBBTF_API LIBBTF_NODISCARD btf_status btf_options_create(const btf_codec *codec, btf_options **out);
/** Sets one parameter from text. BTF_E_INVALID_ARG names the parameter and what it takes. Threads: exclusive. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_options_set(btf_options *options, const char *name, const char *value);
/** Writes the value (set or default) to buf, NUL-terminated; BTF_E_LIMIT when it does not fit. Threads: const. */
LIBBTF_API btf_status btf_options_get(const btf_options *options, const char *name, char *buf, size_t size);
LIBBTF_API void btf_options_release(btf_options *options);

/* ---- Models ---- */

/** A compressed BTF, or a data set that is evaluated as it stands. Immutable, reference counted. */
typedef struct btf_model btf_model;

/** Compresses a data set. options NULL = defaults. Cancel, seed and memory budget come with the job.
 *  Errors: BTF_E_UNSUPPORTED (the codec cannot take such data), BTF_E_CORRUPT (samples not finite),
 *  BTF_E_LIMIT (budget too small; the message says what would do), BTF_E_CANCELLED, BTF_E_NUMERIC and what the
 *  source returns. Threads: free; one context runs one fit's parallel work at a time. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_model_fit(const btf_dataset *ds, const btf_codec *codec,
                                                     const btf_options *options, const btf_job *job,
                                                     btf_model **out);

/** Makes a model of a data set that is factorised already, without reading a sample or compressing anew: the codec keeps
 *  the factors as they are, as precisely as its options for storage say. Unless options say otherwise, that is without
 *  loss. Options of a fit are BTF_E_INVALID_ARG. Errors: BTF_E_UNSUPPORTED (the data set has no factors, or the codec
 *  cannot hold such), BTF_E_CORRUPT (a value is not finite), BTF_E_LIMIT, BTF_E_CANCELLED, BTF_E_NUMERIC. Threads: as
 *  btf_model_fit. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_model_from_factors(const btf_dataset *ds, const btf_codec *codec,
                                                              const btf_options *options, const btf_job *job,
                                                              btf_model **out);

/** A data set of what a model decodes to at its finest level, as a source of float samples: for writing it in a format
 *  or compressing it again. It has factors if the codec gives them. Of a model of uncompressed data it is that data.
 *  Errors: BTF_E_NOMEM. Threads: const. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_dataset_from_model(const btf_model *model, btf_dataset **out);

/** Makes a model that evaluates a data set as it stands (codec id "raw"): the reference for every codec.
 *  Resident and mapped data are used in place; a streamed source is read into memory, within the limits.
 *  Float samples are looked at once, all of them, which costs one reading of the data: BTF_E_CORRUPT names the
 *  place of one that is not finite. Other errors: BTF_E_CANCELLED, BTF_E_LIMIT, BTF_E_NOMEM and what the source
 *  returns. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_model_from_dataset(const btf_dataset *ds, const btf_job *job,
                                                              btf_model **out);

LIBBTF_API btf_model *btf_model_retain(const btf_model *model);
LIBBTF_API void btf_model_release(btf_model *model);

/** What a model holds. */
typedef struct btf_model_info {
  size_t struct_size;
  const char *codec_id, *color_space;
  const btf_dirset *lights, *views; /**< the directions of the data it was made from */
  uint64_t resident_bytes;          /**< memory the evaluation may touch */
  uint64_t stored_bytes;            /**< size in a container, 0 if it was never stored */
  uint64_t caps;
  uint32_t width, height, channels, levels, quantity, scale, wrap, flags;
  const char *const *channel_names;
  const char *name, *source, *license; /**< NULL = unknown */
  double texels_per_mm;                /**< 0 = unknown */
} btf_model_info;
#define BTF_MODEL_INFO_INIT                                                                                  \
  { sizeof(btf_model_info), NULL, NULL, NULL, NULL, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, NULL, NULL, NULL, NULL, 0.0 }
/** Fills io; the caller sets struct_size. Pointers live as long as the model. Threads: const. */
LIBBTF_API btf_status btf_model_describe(const btf_model *model, btf_model_info *io);

/* ---- Evaluation: const model, any number of threads; no allocation, no lock, no failure ---- */

enum {
  /** Nearest light, view and texel of the nearest level instead of interpolation. */
  BTF_QUERY_NEAREST = 1u << 0
};

/** One query. Directions are unit vectors of the local frame. uv is in texture units (0..1 is one tile). lod 0 is
 *  the finest level and +1 halves the resolution; btf_model_lod() turns a footprint into one. FROZEN, 40 bytes. */
typedef struct btf_query {
  float light[3], view[3], uv[2];
  float lod;
  uint32_t flags;
} btf_query;

/** Many queries as arrays. lod NULL = 0 for all. */
typedef struct btf_batch {
  size_t struct_size, count;
  const float *light[3], *view[3], *uv[2];
  const float *lod;
  uint32_t flags, reserved; /**< flags of btf_query for all; reserved must be 0 */
} btf_batch;
#define BTF_BATCH_INIT                                                                                       \
  { sizeof(btf_batch), 0, {NULL, NULL, NULL}, {NULL, NULL, NULL}, {NULL, NULL}, NULL, 0, 0 }

/** What evaluation returns. */
enum {
  BTF_VALUE_BRDF = 0,     /**< f, 1/sr, no cosine; a brdf_cos model is divided by max(light z, 0.02) */
  BTF_VALUE_BRDF_COS = 1, /**< f times light z */
  BTF_VALUE_STORED = 2    /**< the quantity the model stores, interpolated */
};

/** f per channel, 1/sr, without the cosine, to out[0 .. channels-1]: 3 lights x 3 views x 4 texels interpolated,
 *  and trilinear between levels (Schwartz 2013, sect. 4 and eq. 5). 0 when light or view is at or below the horizon
 *  (z <= 0), when anything is not finite or when flags has unknown bits. A truncated sum may fall below 0 near dark samples: values are what the
 *  method says, and a renderer that cannot bear negative light takes max(0, f). Threads: const. */
LIBBTF_API void btf_model_eval(const btf_model *model, const btf_query *query, float *out);
/** The same with the value asked for: BTF_VALUE_*. Threads: const. */
LIBBTF_API void btf_model_eval_as(const btf_model *model, const btf_query *query, int32_t value, float *out);
/** Evaluates a batch: out[channel][i]. Equal to the single call bit for bit, and faster. Consecutive queries
 *  of equal directions share work. A batch whose struct_size or reserved is wrong evaluates to nothing: `out` stays as
 *  it was. Threads: const. */
LIBBTF_API void btf_model_eval_n(const btf_model *model, const btf_batch *batch, int32_t value, float *const *out);

/** The stored (BTF_VALUE_STORED) value of one decoded sample; indices out of range give 0. Returns how many channels
 *  decode to something not finite, which only a damaged model has; they are 0 in `out`. Threads: const. */
LIBBTF_API uint32_t btf_model_texel(const btf_model *model, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                                    uint32_t view, float *out);

/** Level of detail for a footprint: duvdx and duvdy are the derivatives of uv along the two screen axes.
 *  lod = log2(max(length of duvdx, length of duvdy)) in finest texels, clamped to 0 .. levels - 1
 *  (Schwartz 2013, eq. 2, with the Euclidean norm); 0 if any derivative is NaN. Threads: const. */
LIBBTF_API float btf_model_lod(const btf_model *model, const float duvdx[2], const float duvdy[2]);

enum {
  BTF_COST_SHARED_DIRECTIONS = 1u << 1 /**< of a query of a batch that has its directions from the one before it */
};
/** What one query costs the method, whatever the caches hold: at a whole level of detail, with interpolation. */
typedef struct btf_eval_cost {
  size_t struct_size;
  double rows;   /**< separate places in memory that are read */
  double bytes;  /**< bytes read */
  double values; /**< stored values turned into floats */
  double flops;  /**< additions and multiplications, a fused pair counting two */
} btf_eval_cost;
#define BTF_EVAL_COST_INIT                                                                                   \
  { sizeof(btf_eval_cost), 0.0, 0.0, 0.0, 0.0 }
/** Fills io for flags of BTF_QUERY_NEAREST and BTF_COST_SHARED_DIRECTIONS; the caller sets struct_size. All 0 if the
 *  codec does not tell. Threads: const. */
LIBBTF_API btf_status btf_model_cost(const btf_model *model, uint32_t flags, btf_eval_cost *io);

/** Draws a light direction for query->view from the numbers xi in [0,1): writes the direction and
 *  weight[c] = f * light z / pdf per channel and returns the pdf per solid angle, 0 if there is none or if a number is
 *  outside [0,1). xi[0] and xi[1] place the direction; xi[2] is for choosing a lobe and has no effect while the
 *  draw is cosine-weighted. Threads: const. */
LIBBTF_API float btf_model_sample(const btf_model *model, const btf_query *query, const float xi[3], float light[3],
                                  float *weight);
/** The pdf with which btf_model_sample draws query->light. Threads: const. */
LIBBTF_API float btf_model_pdf(const btf_model *model, const btf_query *query);

#ifdef __cplusplus
}
#endif
#endif
