/* SPDX-License-Identifier: MIT */
/*
 * btf_format.h: reading measured data where it lies, and writing it. A format recognises its files and folders by what they
 * hold, never by their names, and opens them as data sets that are read block by block: nothing is unpacked
 * to disk or held as a whole. Formats are registered in a context like codecs; those of this project come
 * with btf_formats_register() of the library libbtf_formats, since some of them need image and archive
 * libraries that the core goes without.
 */
#ifndef LIBBTF_BTF_FORMAT_H
#define LIBBTF_BTF_FORMAT_H

#include "btf_model.h"

#ifdef __cplusplus
extern "C" {
#endif

/** A registered reader of one kind of measured data. Owned by the context. */
typedef struct btf_format btf_format;

/** Formats of a context; the first is "folder", the data-set folder (docs/dataset-folder.md). Threads: const.
 */
LIBBTF_API uint32_t btf_format_count(const btf_context *ctx);
LIBBTF_API const btf_format *btf_format_at(const btf_context *ctx, uint32_t i);
/** By id; NULL if absent. Threads: const. */
LIBBTF_API const btf_format *btf_format_find(const btf_context *ctx, const char *id);
LIBBTF_API const char *btf_format_id(const btf_format *format);
LIBBTF_API const char *btf_format_title(const btf_format *format);
LIBBTF_API uint32_t btf_format_param_count(const btf_format *format);
/** Describes parameter i; the caller sets io->struct_size. Threads: const. */
LIBBTF_API btf_status btf_format_param(const btf_format *format, uint32_t i, btf_param_desc *io);

/** Values for a format's parameters, set and released like those of a codec. Errors: BTF_E_NOMEM. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_format_options_create(const btf_format *format, btf_options **out);

/** The format that a file or folder is of. BTF_E_NOT_BTF if none of the context's recognises it, BTF_E_IO if
 * it cannot be read. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_format_detect(btf_context *ctx, const char *path,
                                                         const btf_format **out);

/** Opens a file or folder as a data set. `format` NULL = as detected; options NULL = defaults, otherwise made
 * for this format. What the format found out and did (a transfer curve undone, images filled in) is in the
 * description's `notes`. Errors: those of btf_format_detect, BTF_E_CORRUPT, BTF_E_TRUNCATED,
 * BTF_E_UNSUPPORTED, BTF_E_LIMIT, BTF_E_INVALID_ARG, BTF_E_NOMEM. Threads: free. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_format_open(btf_context *ctx, const char *path,
                                                       const btf_format *format, const btf_options *options,
                                                       btf_dataset **out);

/* ---- Writing ---- */

/** 1 if the format can be written. Threads: const. */
LIBBTF_API int32_t btf_format_can_write(const btf_format *format);
/** Parameters of writing, which are others than those of opening, and values for them. */
LIBBTF_API uint32_t btf_format_write_param_count(const btf_format *format);
LIBBTF_API btf_status btf_format_write_param(const btf_format *format, uint32_t i, btf_param_desc *io);
LIBBTF_API LIBBTF_NODISCARD btf_status btf_format_write_options_create(const btf_format *format,
                                                                       btf_options **out);

/** Writes a data set, such as a model is by btf_dataset_from_model, in a format. The result appears complete or not at
 * all. options NULL = defaults, otherwise made by btf_format_write_options_create for this format. Of the job, progress
 * and max_working_set count. Errors: BTF_E_UNSUPPORTED (the format is only read, or does not hold such data; the
 * message says why), BTF_E_IO, BTF_E_CORRUPT (not finite), BTF_E_LIMIT, BTF_E_CANCELLED and what the source returns.
 * Threads: as btf_model_fit. */
LIBBTF_API LIBBTF_NODISCARD btf_status btf_format_write(btf_context *ctx, const char *path,
                                                        const btf_format *format, const btf_options *options,
                                                        const btf_dataset *ds, const btf_job *job);

#ifdef __cplusplus
}
#endif
#endif
