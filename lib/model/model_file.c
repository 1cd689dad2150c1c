/* SPDX-License-Identifier: MIT */
/* Models and container files. */
#include "model/model.h"

#include <string.h>
#include <sys/stat.h>

/* A codec speaks of its payload only; the reader of the message wants to know which file. */
static btf_status name_file(btf_context *ctx, const btfi_payload *payload, btf_status status) {
  const char *file = btfi_payload_source_name(payload);
  char reason[512];
  if (status == BTF_OK || file == NULL || strncmp(btf_error_message(), file, strlen(file)) == 0)
    return status;
  strncpy(reason, btf_error_message(), sizeof reason - 1);
  reason[sizeof reason - 1] = '\0';
  return btfi_fail(ctx, status, "%s: %s", file, reason);
}

btf_status btf_file_load_model(const btf_file *file, uint32_t i, btf_model **out) {
  btfi_payload *payload;
  const btf_codec *codec;
  const char *id;
  btf_context *ctx;
  btf_status status;
  if (out != NULL) *out = NULL;
  if (file == NULL || out == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_file_load_model: file and out must not be NULL");
  ctx = btfi_file_context(file);
  BTFI_TRY(btfi_file_payload(file, i, &payload));
  id = btfi_payload_header(payload)->codec_id;
  codec = btf_codec_find(ctx, id);
  if (codec == NULL)
    status =
        btfi_fail(ctx, BTF_E_UNKNOWN_CODEC, "%s: model %u needs the codec \"%s\", which is not registered",
                  btfi_payload_source_name(payload), (unsigned)i, id);
  else
    status = name_file(ctx, payload, btfi_model_from_payload(codec, payload, out));
  btfi_payload_release(payload);
  return status;
}

btf_status btf_writer_model(btf_writer *w, const btf_model *model, const btf_job *job) {
  btfi_job running;
  if (w == NULL || model == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_writer_model: writer and model must not be NULL");
  if (model->payload == NULL)
    return btfi_fail(
        model->ctx, BTF_E_UNSUPPORTED,
        "a data set that is evaluated as it stands is no compressed model and cannot be stored as one");
  BTFI_TRY(btfi_job_begin(model->ctx, job, &running));
  return btfi_writer_payload(w, model->payload, &running.desc);
}

static btf_status load_folder(btf_context *ctx, const char *path, btf_model **out) {
  btf_dataset *ds;
  btf_status status;
  BTFI_TRY(btf_dataset_open(ctx, path, &ds));
  status = btf_model_from_dataset(ds, NULL, out);
  btf_dataset_release(ds);
  return status;
}

btf_status btf_model_load(btf_context *ctx, const char *path, btf_model **out) {
  struct stat info;
  btf_file *file;
  btf_status status;
  if (out != NULL) *out = NULL;
  if (ctx == NULL || path == NULL || out == NULL)
    return btfi_fail(ctx, BTF_E_INVALID_ARG, "btf_model_load: context, path and out must not be NULL");
  if (stat(path, &info) == 0 && S_ISDIR(info.st_mode)) return load_folder(ctx, path, out);
  BTFI_TRY(btf_file_open_path(ctx, path, 0, &file));
  if (btf_file_model_count(file) == 0)
    status = btfi_fail(ctx, BTF_E_UNSUPPORTED, "%s: holds no model", path);
  else
    status = btf_file_load_model(file, 0, out);
  btf_file_close(file);
  return status;
}

static btf_status write_file(btf_writer *w, const btf_model *model, const char *command, const btf_job *job) {
  if (command != NULL) BTFI_TRY(btf_writer_metadata(w, "btf.command", command));
  return btf_writer_model(w, model, job);
}

btf_status btf_model_save(const btf_model *model, const char *path, int32_t zstd_level, const char *command,
                          const btf_job *job) {
  btf_io io = BTF_IO_INIT;
  btf_writer *w;
  btf_status status;
  if (model == NULL || path == NULL)
    return btfi_fail(NULL, BTF_E_INVALID_ARG, "btf_model_save: model and path must not be NULL");
  BTFI_TRY(btf_io_file(model->ctx, path, BTF_IO_WRITE, &io));
  BTFI_TRY(btf_writer_open(model->ctx, &io, zstd_level, &w));
  status = write_file(w, model, command, job);
  if (status != BTF_OK) {
    btf_writer_abort(w);
    return status;
  }
  return btf_writer_finish(w);
}
