/* SPDX-License-Identifier: MIT */
#include "input.h"

#include <dirent.h>
#include <errno.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

uint64_t input_bytes_on_disk(const char *path) {
  struct stat info;
  uint64_t total = 0;
  DIR *folder;
  if (stat(path, &info) != 0) return 0;
  if (!S_ISDIR(info.st_mode)) return (uint64_t)info.st_size;
  folder = opendir(path);
  if (folder == NULL) return 0;
  for (struct dirent *entry; (entry = readdir(folder)) != NULL;)
    if (fstatat(dirfd(folder), entry->d_name, &info, 0) == 0 && S_ISREG(info.st_mode))
      total += (uint64_t)info.st_size;
  closedir(folder);
  return total;
}

/* Whether a file lies beside a data set's manifest, or is one. */
static bool is_part_of_folder(const char *path, char folder[4096]) {
  char manifest[4096 + 16];
  const char *slash = strrchr(path, '/');
  const size_t length = slash != NULL ? (size_t)(slash - path) : 0;
  if (length >= 4096) return false;
  snprintf(folder, 4096, "%.*s", (int)(slash != NULL ? length : 1), slash != NULL ? path : ".");
  snprintf(manifest, sizeof manifest, "%s/manifest.json", folder);
  return access(manifest, F_OK) == 0;
}

/* A file that is no container. A part of a data set is a wrong word on the command line rather than a bad
 * file.
 */
static int fail_file(const cli *c, const char *path, btf_status status) {
  char folder[4096];
  if (status == BTF_E_NOT_BTF && is_part_of_folder(path, folder))
    return cli_usage(c, "%s: is a part of a data set; give its folder, %s", path, folder);
  return cli_fail_library(status);
}

/* What is no container may be measured data. */
static btf_status open_measured(btf_context *ctx, const char *path, input *out) {
  const btf_status status = btf_format_detect(ctx, path, &out->format);
  return status == BTF_OK ? btf_format_open(ctx, path, out->format, NULL, &out->dataset) : status;
}

/* Containers first: they are what is opened most, and known by their first bytes. */
static btf_status open_any(btf_context *ctx, const char *path, bool is_folder, input *out) {
  char message[512];
  btf_status status = is_folder ? BTF_E_NOT_BTF : btf_file_open_path(ctx, path, 0, &out->file);
  if (status != BTF_E_NOT_BTF) return status;
  snprintf(message, sizeof message, "%s", btf_error_message());
  status = open_measured(ctx, path, out);
  if (status != BTF_E_NOT_BTF || out->format != NULL) return status;
  /* Of what is nothing that is known, the message says what it is not, as a folder of ours or as a container.
   */
  if (is_folder) return btf_dataset_open(ctx, path, &out->dataset);
  return btf_source_error(status, "%s", message);
}

int input_open(cli *c, const char *path, input *out) {
  btf_context *ctx;
  struct stat info;
  btf_status status;
  int failed;
  memset(out, 0, sizeof *out);
  failed = cli_context(c, &ctx);
  if (failed) return failed;
  if (stat(path, &info) != 0) return cli_fail(EXIT_IO, "%s: could not be opened: %s", path, strerror(errno));
  out->path = path;
  status = open_any(ctx, path, S_ISDIR(info.st_mode), out);
  if (status != BTF_OK) {
    failed = S_ISDIR(info.st_mode) ? cli_fail_library(status) : fail_file(c, path, status);
    input_close(out);
    return failed;
  }
  out->bytes = input_bytes_on_disk(path);
  return EXIT_DONE;
}

static int unknown_format(const cli *c, const btf_context *ctx, const char *id) {
  enum { most = 64 };
  const char *words[most + 1];
  uint32_t count = btf_format_count(ctx);
  if (count > most) count = most;
  for (uint32_t i = 0; i < count; i++) words[i] = btf_format_id(btf_format_at(ctx, i));
  words[count] = NULL;
  const char *nearest = cli_near_miss(id, words);
  if (nearest != NULL) return cli_usage(c, "no format \"%s\"; did you mean %s?", id, nearest);
  return cli_usage(c, "no format \"%s\"; btf import --list shows those of this build", id);
}

int input_open_measured(cli *c, const char *path, const char *format_option, const char *param_option,
                        input *out) {
  const char *id = cli_value(c, format_option);
  btf_options *options = NULL;
  btf_context *ctx;
  btf_status status = BTF_OK;
  memset(out, 0, sizeof *out);
  int failed = cli_context(c, &ctx);
  if (failed) return failed;
  if (id != NULL && (out->format = btf_format_find(ctx, id)) == NULL) return unknown_format(c, ctx, id);
  if (out->format == NULL) status = btf_format_detect(ctx, path, &out->format);
  if (status == BTF_OK) status = btf_format_options_create(out->format, &options);
  if (status != BTF_OK) return cli_fail_library(status);
  failed = cli_set_options(c, param_option, options);
  if (!failed) {
    status = btf_format_open(ctx, path, out->format, options, &out->dataset);
    if (status != BTF_OK) failed = cli_fail_library(status);
  }
  btf_options_release(options);
  out->path = path;
  out->bytes = input_bytes_on_disk(path);
  return failed;
}

int input_load(input *in) {
  btf_status status;
  if (in->model != NULL) return EXIT_DONE;
  if (in->file == NULL) {
    status = btf_model_from_dataset(in->dataset, NULL, &in->model);
  } else {
    if (btf_file_model_count(in->file) == 0) return cli_fail(EXIT_MALFORMED, "%s: holds no model", in->path);
    status = btf_file_load_model(in->file, 0, &in->model);
  }
  return status == BTF_OK ? EXIT_DONE : cli_fail_library(status);
}

int input_open_model(cli *c, const char *path, input *out) {
  int failed = input_open(c, path, out);
  if (failed) return failed;
  failed = input_load(out);
  if (failed) input_close(out);
  return failed;
}

void input_close(input *in) {
  btf_model_release(in->model);
  btf_file_close(in->file);
  btf_dataset_release(in->dataset);
  memset(in, 0, sizeof *in);
}

const char *input_sample_type(uint32_t sample_type) {
  switch (sample_type) {
  case BTF_SAMPLE_U8:
    return "u8";
  case BTF_SAMPLE_U16:
    return "u16";
  case BTF_SAMPLE_F16:
    return "f16";
  default:
    return "f32";
  }
}

uint32_t input_sample_size(uint32_t sample_type) {
  return sample_type == BTF_SAMPLE_U8 ? 1 : sample_type == BTF_SAMPLE_F32 ? 4 : 2;
}

const char *input_quantity(uint32_t quantity) {
  return quantity == BTF_QUANTITY_BRDF_COS ? "brdf_cos" : "brdf";
}
const char *input_scale(uint32_t scale) {
  return scale == BTF_SCALE_ABSOLUTE ? "absolute" : "relative";
}

uint64_t input_value_count(uint32_t views, uint32_t lights, uint32_t width, uint32_t height,
                           uint32_t channels) {
  const uint32_t factors[] = {views, lights, width, height, channels};
  uint64_t product = 1;
  for (int i = 0; i < 5; i++)
    if (__builtin_mul_overflow(product, (uint64_t)factors[i], &product)) return 0;
  return product;
}
