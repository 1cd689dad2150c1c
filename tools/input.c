/* SPDX-License-Identifier: MIT */
#include "input.h"

#include <dirent.h>
#include <errno.h>
#include <inttypes.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "safe_text.h"

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

/* ---- formats and their settings ---- */

/* Options of the command that set the parameter of another name. */
static const char *const shorthands[][2] = {{"allow-missing", "allow_missing"}, {"transfer", "transfer"}};
enum { SHORTHANDS = sizeof shorthands / sizeof *shorthands };

/* The first option given that is for measured data only, or NULL. */
static const char *given_setting(const cli *c) {
  if (cli_has(c, "format")) return "format";
  if (cli_has(c, "input")) return "input";
  for (int i = 0; i < SHORTHANDS; i++)
    if (cli_has(c, shorthands[i][0])) return shorthands[i][0];
  return NULL;
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

/* The format named, or the one recognised; *status tells of the latter. */
static int find_format(const cli *c, btf_context *ctx, const char *path, const btf_format **out,
                       btf_status *status) {
  const char *id = cli_value(c, "format");
  *status = BTF_OK;
  *out = NULL;
  if (id == NULL)
    *status = btf_format_detect(ctx, path, out);
  else if ((*out = btf_format_find(ctx, id)) == NULL)
    return unknown_format(c, ctx, id);
  return EXIT_DONE;
}

static bool has_param(const btf_format *format, const char *name) {
  for (uint32_t i = 0; i < btf_format_param_count(format); i++) {
    btf_param_desc p = {.struct_size = sizeof p};
    if (btf_format_param(format, i, &p) == BTF_OK && strcmp(p.name, name) == 0) return true;
  }
  return false;
}

static int set_shorthands(const cli *c, const btf_format *format, btf_options *options) {
  for (int i = 0; i < SHORTHANDS; i++) {
    const char *option = shorthands[i][0], *name = shorthands[i][1], *value = cli_value(c, option);
    if (!cli_has(c, option)) continue;
    if (!has_param(format, name))
      return cli_usage(c, "--%s: the format %s has no parameter %s", option, btf_format_id(format), name);
    const btf_status status = btf_options_set(options, name, value != NULL ? value : "true");
    if (status != BTF_OK) return cli_fail_library(status);
  }
  return EXIT_DONE;
}

/* Opens the data set out->format, with the keys and values of the option `keys`. */
static int open_measured(const cli *c, btf_context *ctx, const char *path, const char *keys, input *out) {
  btf_options *options = NULL;
  btf_status status = btf_format_options_create(out->format, &options);
  if (status != BTF_OK) return cli_fail_library(status);
  int failed = cli_set_params(c, keys, "btf import --list", options);
  if (!failed) failed = set_shorthands(c, out->format, options);
  if (!failed) {
    status = btf_format_open(ctx, path, out->format, options, &out->dataset);
    if (status != BTF_OK) failed = cli_fail_library(status);
  }
  btf_options_release(options);
  return failed;
}

/* ---- opening ---- */

/* What is no container may be measured data. Settings are for that; of several files they are for those that
 * have any. */
static int open_format(cli *c, btf_context *ctx, const char *path, bool is_folder, input *out) {
  char message[512];
  btf_status status;
  snprintf(message, sizeof message, "%s", btf_error_message());
  const int failed = find_format(c, ctx, path, &out->format, &status);
  if (failed) return failed;
  if (status == BTF_OK) {
    const bool has_none = c->operand_count > 1 && btf_format_param_count(out->format) == 0;
    out->has_settings = !has_none && given_setting(c) != NULL;
    if (!has_none) return open_measured(c, ctx, path, "input", out);
    status = btf_format_open(ctx, path, out->format, NULL, &out->dataset);
    return status == BTF_OK ? EXIT_DONE : cli_fail_library(status);
  }
  if (status != BTF_E_NOT_BTF) return cli_fail_library(status);
  /* Of what is nothing that is known, the message says what it is not, as a folder of ours or as a container.
   */
  if (is_folder) return cli_fail_library(btf_dataset_open(ctx, path, &out->dataset));
  return fail_file(c, path, btf_source_error(status, "%s", message));
}

/* Containers first: they are what is opened most, and known by their first bytes. */
int input_open(cli *c, const char *path, input *out) {
  btf_context *ctx;
  struct stat info;
  memset(out, 0, sizeof *out);
  int failed = cli_context(c, &ctx);
  if (failed) return failed;
  if (stat(path, &info) != 0) return cli_fail(EXIT_IO, "%s: could not be opened: %s", path, strerror(errno));
  out->path = path;
  const bool is_folder = S_ISDIR(info.st_mode);
  const btf_status status = is_folder ? BTF_E_NOT_BTF : btf_file_open_path(ctx, path, 0, &out->file);
  if (status == BTF_E_NOT_BTF)
    failed = open_format(c, ctx, path, is_folder, out);
  else if (status != BTF_OK)
    failed = cli_fail_library(status);
  else if (c->operand_count == 1)
    failed = input_refuse_settings(c, path);
  if (failed)
    input_close(out);
  else
    out->bytes = input_bytes_on_disk(path);
  return failed;
}

int input_refuse_settings(const cli *c, const char *path) {
  const char *option = given_setting(c);
  if (option == NULL) return EXIT_DONE;
  return cli_usage(c, "%s: is no measured data; --%s is for that", path, option);
}

int input_open_import(cli *c, const char *path, input *out) {
  btf_context *ctx;
  btf_status status;
  memset(out, 0, sizeof *out);
  int failed = cli_context(c, &ctx);
  if (!failed) failed = find_format(c, ctx, path, &out->format, &status);
  if (failed) return failed;
  if (status != BTF_OK) return cli_fail_library(status);
  failed = open_measured(c, ctx, path, "param", out);
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

void input_print_written(const char *path, const char *what, double seconds) {
  const uint64_t bytes = input_bytes_on_disk(path);
  safe_text_put(stdout, path);
  printf(": %s, %" PRIu64 " bytes (%.2f MiB), %.2f s\n", what, bytes, (double)bytes / 1048576, seconds);
}
