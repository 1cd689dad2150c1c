/* SPDX-License-Identifier: MIT */
/* registry.h: codecs of a context, options, and the host table codecs are handed. */
#ifndef BTFI_REGISTRY_H
#define BTFI_REGISTRY_H

#include "base/base.h"
#include "container/container.h"
#include <btf/btf_plugin.h>

const btf_host *btfi_host(void);
const btf_codec_vtbl *btfi_codec_vtbl(const btf_codec *codec); /* full-size copy: absent slots are NULL */
btf_context *btfi_codec_context(const btf_codec *codec);
bool btfi_options_are_of(const btf_options *options, const btf_codec *codec);
const char *btfi_options_owner(const btf_options *options);

/* Runs the codec's fit. BTF_E_INVALID_ARG, whatever the fit returned, if it asked for an option that the
 * codec does not have: what it went on with was no value of anybody's. */
btf_status btfi_codec_fit(const btf_codec *codec, const btf_dataset *ds, const btf_options *options,
                          const btf_job *job, btf_chunk_writer *payload);

/* Runs the codec's from_factors, likewise. */
btf_status btfi_codec_from_factors(const btf_codec *codec, const btf_model_shape *shape,
                                   const btf_factors *factors, const btf_options *options, const btf_job *job,
                                   btf_chunk_writer *payload);

/* Runs the format's open, likewise. */
btf_status btfi_format_open_with(const btf_format *format, const char *path, const btf_options *options,
                                 btf_dataset **out);

/* Runs the format's write, likewise. */
btf_status btfi_format_write_with(const btf_format *format, const char *path, const btf_dataset *ds,
                                  const btf_options *options, const btf_job *job);

/* Host table entries: values by parameter name; 0 or NULL for a name the codec does not have. */
double btfi_option(const btf_options *options, const char *name);
const char *btfi_option_text(const btf_options *options, const char *name);
int32_t btfi_option_is_set(const btf_options *options, const char *name);
/* As btf_host.number. */
int32_t btfi_number(const char *text, double *out);

/* Host table entries that the gpu layer defines. */
btf_status btfi_gpu_table(btf_gpu_builder *b, const btf_gpu_table *table, uint32_t *number);
void *btfi_gpu_slice(btf_gpu_builder *b, uint32_t number, uint32_t level, uint32_t slice);
btf_status btfi_gpu_uniform(btf_gpu_builder *b, const char *name, uint32_t type, uint32_t count,
                            const void *values);
btf_status btfi_gpu_directions(btf_gpu_builder *b, const char *name, const btf_dirset *set);
btf_status btfi_gpu_direction_maps(btf_gpu_builder *b, const char *name, const btf_dirset *set,
                                   double *shift);
btf_status btfi_gpu_source(btf_gpu_builder *b, const char *format, ...) LIBBTF_PRINTF(2, 3);
void btfi_gpu_cost(btf_gpu_builder *b, const btf_gpu_cost *cost);

#endif
