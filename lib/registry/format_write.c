/* SPDX-License-Identifier: MIT */
/* format_write.c: data sets written in a format. */
#include "registry/codec.h"

int32_t btf_format_can_write(const btf_format *format) {
  return format != NULL && format->vtbl.write != NULL;
}

uint32_t btf_format_write_param_count(const btf_format *format) {
  return format->write_params.count;
}

btf_status btf_format_write_param(const btf_format *format, uint32_t i, btf_param_desc *io) {
  if (format == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_format_write_param: format must not be NULL");
  return btfi_params_describe(&format->write_params, i, io);
}

btf_status btf_format_write_options_create(const btf_format *format, btf_options **out) {
  if (out != NULL) *out = NULL;
  if (format == NULL || out == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG,
                     "btf_format_write_options_create: format and out must not be NULL");
  return btfi_options_create(&format->write_params, out);
}

btf_status btf_format_write(btf_context *ctx, const char *path, const btf_format *format,
                            const btf_options *options, const btf_dataset *ds, const btf_job *job) {
  btf_options *defaults = NULL;
  btfi_job running;
  if (ctx == NULL || path == NULL || format == NULL || ds == NULL)
    return btfi_fail(ctx, BTF_E_INVALID_ARG,
                     "btf_format_write: context, path, format and data set must not be NULL");
  if (format->ctx != ctx)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: the format is of another context", format->vtbl.id);
  if (format->vtbl.write == NULL)
    return btfi_fail(ctx, BTF_E_UNSUPPORTED, "%s: this format is only read, not written", format->vtbl.id);
  if (options != NULL && !btfi_options_are_of_params(options, &format->write_params))
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "%s: the options are not for writing it", format->vtbl.id);
  BTFI_TRY(btfi_job_begin(ctx, job, &running));
  if (options == NULL) {
    BTFI_TRY(btf_format_write_options_create(format, &defaults));
    options = defaults;
  }
  btf_status status = btfi_format_write_with(format, path, ds, options, &running.desc);
  if (status == BTF_E_NOMEM) status = btfi_alloc_status();
  btf_options_release(defaults);
  return status;
}
