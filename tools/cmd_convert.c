/* SPDX-License-Identifier: MIT */
/* cmd_convert.c: the same data in another form, without compressing it anew. */
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "commands.h"
#include "folder_copy.h"
#include "output_file.h"

/* What IN is: a data set, be it of what a model decodes to. */
static int open_source(cli *c, input *in) {
  const char *path = c->operands[0];
  const int failed = input_open(c, path, in);
  if (failed || in->dataset != NULL) return failed;
  const int not_loaded = input_load(in);
  if (not_loaded) return not_loaded;
  const btf_status status = btf_dataset_from_model(in->model, &in->dataset);
  return status == BTF_OK ? EXIT_DONE : cli_fail_library(status);
}

/* The codec for the factors that the data set has. */
static int choose_codec(const input *in, const char **id) {
  btf_factors factors = BTF_FACTORS_INIT;
  const btf_status status = btf_dataset_factors(in->dataset, &factors);
  if (status == BTF_E_UNSUPPORTED)
    return cli_fail(EXIT_UNSUPPORTED, "%s; btf encode compresses it", btf_error_message());
  if (status != BTF_OK) return cli_fail_library(status);
  *id = factors.products == 1 ? "fmf" : "pvpca";
  return EXIT_DONE;
}

static int choose_target(const cli *c, const input *in, const char *path, const char **to) {
  *to = cli_value(c, "to");
  if (*to != NULL) return EXIT_DONE;
  if (output_ends_with(path, ".btfz")) return choose_codec(in, to);
  if (output_ends_with(path, ".btfd")) *to = "folder";
  if (*to != NULL) return EXIT_DONE;
  return cli_usage(c, "%s: its name does not tell what to convert to; --to does (btf convert --list)", path);
}

/* ---- containers ---- */

static int save_model(cli *c, const input *in, const btf_codec *codec, const btf_options *options,
                      const char *path) {
  btf_model *model = NULL;
  btf_job job = BTF_JOB_INIT;
  char *command = cli_recorded_command(c);
  if (command == NULL) return cli_out_of_memory();
  cli_job(c, &job);
  btf_status status = btf_model_from_factors(in->dataset, codec, options, &job, &model);
  if (status == BTF_OK) status = btf_model_save(model, path, 0, command, &job);
  btf_model_release(model);
  free(command);
  cli_progress_done(c);
  return status == BTF_OK ? EXIT_DONE : cli_fail_library(status);
}

static int to_container(cli *c, const input *in, const btf_codec *codec, const char *path) {
  btf_options *options = NULL;
  struct stat info;
  if (stat(path, &info) == 0 && S_ISDIR(info.st_mode))
    return cli_fail(EXIT_IO, "%s: is a folder; a container is a file", path);
  const btf_status status = btf_options_create(codec, &options);
  if (status != BTF_OK) return cli_fail_library(status);
  int failed = cli_codec_options(c, options);
  if (!failed) failed = output_try(path);
  if (!failed) failed = save_model(c, in, codec, options, path);
  btf_options_release(options);
  return failed;
}

/* ---- formats ---- */

static int to_format(cli *c, const input *in, const btf_format *format, const char *path) {
  btf_options *options = NULL;
  btf_job job = BTF_JOB_INIT;
  btf_status status = btf_format_write_options_create(format, &options);
  if (status != BTF_OK) return cli_fail_library(status);
  const int failed = cli_set_params(c, "param", "btf convert --list", options);
  cli_job(c, &job);
  if (!failed) status = btf_format_write(c->context, path, format, options, in->dataset, &job);
  btf_options_release(options);
  cli_progress_done(c);
  return failed ? failed : status == BTF_OK ? EXIT_DONE : cli_fail_library(status);
}

static int to_folder(cli *c, input *in, const char *path) {
  uint32_t sample_type;
  if (cli_has(c, "param")) return cli_usage(c, "--param is not for a folder; --type is");
  const int failed = folder_copy_type(c, in, true, &sample_type);
  return failed ? failed : folder_copy(c, in, path, sample_type);
}

/* ---- the command ---- */

static int unknown_target(const cli *c, const char *to) {
  enum { most = 256 };
  const char *words[most + 1];
  uint32_t count = 0;
  for (uint32_t i = 0; i < btf_codec_count(c->context) && count < most; i++)
    words[count++] = btf_codec_id(btf_codec_at(c->context, i));
  for (uint32_t i = 0; i < btf_format_count(c->context) && count < most; i++)
    words[count++] = btf_format_id(btf_format_at(c->context, i));
  words[count] = NULL;
  const char *nearest = cli_near_miss(to, words);
  if (nearest != NULL) return cli_usage(c, "no codec or format \"%s\"; did you mean %s?", to, nearest);
  return cli_usage(c, "no codec or format \"%s\"; btf codecs and btf convert --list show them", to);
}

static int convert_to(cli *c, input *in, const char *to, const char *path) {
  const btf_codec *codec = btf_codec_find(c->context, to);
  const btf_format *format = btf_format_find(c->context, to);
  if (strcmp(to, "folder") == 0) return to_folder(c, in, path);
  if (cli_has(c, "type")) return cli_usage(c, "--type is for a folder (--to folder)");
  if (codec != NULL) return to_container(c, in, codec, path);
  return format != NULL ? to_format(c, in, format, path) : unknown_target(c, to);
}

static int convert(cli *c, input *in, const char *path) {
  const double started = cli_seconds();
  const char *to;
  int failed = choose_target(c, in, path, &to);
  if (failed) return failed;
  cli_hold_interrupts();
  failed = convert_to(c, in, to, path);
  cli_release_interrupts();
  if (!failed) input_print_written(path, to, cli_seconds() - started);
  return failed;
}

static int run(cli *c) {
  input in = {0};
  if (cli_has(c, "list")) return cli_list_formats(c, true);
  if (c->operand_count == 0) return cli_usage(c, "IN is missing");
  const char *path = cli_value(c, "output");
  if (path != NULL && c->operand_count == 2)
    return cli_usage(c, "OUT is given twice: %s and -o %s", c->operands[1], path);
  if (path == NULL && c->operand_count == 1) return cli_usage(c, "OUT is missing");
  if (path == NULL) path = c->operands[1];
  c->operand_count = 1; /* where the result lies is not recorded in it */
  int failed = open_source(c, &in);
  if (!failed) failed = convert(c, &in, path);
  input_close(&in);
  return failed;
}

static const cli_option options_table[] = {
    CLI_OPTION_OUTPUT("what to write, if OUT is not the second operand"),
    {"to", 0, "NAME", "what to convert to: a codec that keeps factors, a format, or folder", 0},
    {"param", 'p', "KEY=VALUE", "set a parameter of that; may be repeated", 0},
    CLI_OPTION_SAMPLE_TYPE("otherwise the type of IN, f32 of a container"),
    INPUT_OPTIONS,
    {"list", 0, NULL, "list the formats that this build writes and their parameters", CLI_OPTION_UNRECORDED},
    CLI_OPTIONS_END};

const cli_command cmd_convert = {
    "convert",
    "changes the form of data without compressing it anew",
    "IN [-o] OUT [--to NAME] [-p KEY=VALUE]... [options]\n--list",
    "IN is a data set, measured data or a container. Factorised measurements become a model that holds the "
    "same\n"
    "factors, with values equal to those of IN: fmf, or pvpca where each view is factorised by itself. "
    "Without\n"
    "--to that is what a name OUT.btfz gets, and OUT.btfd becomes a data-set folder.",
    options_table,
    0,
    2,
    run};
