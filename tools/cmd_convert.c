/* SPDX-License-Identifier: MIT */
/* cmd_convert.c: the same data in another form, without compressing it anew. */
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "commands.h"
#include "input.h"
#include "output_file.h"
#include "safe_text.h"

static bool ends_with(const char *path, const char *ending) {
  const size_t length = strlen(path), end = strlen(ending);
  return length > end && strcmp(path + length - end, ending) == 0;
}

/* What IN is: a data set, be it of what a model decodes to. */
static int open_source(cli *c, input *in) {
  const char *path = c->operands[0];
  const int failed = cli_has(c, "from") || cli_has(c, "from-param")
                         ? input_open_measured(c, path, "from", "from-param", in)
                         : input_open(c, path, in);
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
  if (ends_with(path, ".btfz")) return choose_codec(in, to);
  return cli_usage(c, "%s: its name does not tell what to convert to; --to does", path);
}

static void print_report(const char *path, const char *to, double seconds) {
  const uint64_t bytes = input_bytes_on_disk(path);
  safe_text_put(stdout, path);
  printf(": %s, %" PRIu64 " bytes (%.2f MiB), %.2f s\n", to, bytes, (double)bytes / 1048576, seconds);
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
  int failed = cli_set_options(c, "param", options);
  if (!failed) failed = output_try(path);
  if (!failed) failed = save_model(c, in, codec, options, path);
  btf_options_release(options);
  return failed;
}

/* ---- the command ---- */

static int convert(cli *c, const input *in, const char *path) {
  const double started = cli_seconds();
  const char *to;
  int failed = choose_target(c, in, path, &to);
  if (failed) return failed;
  const btf_codec *codec = btf_codec_find(c->context, to);
  if (codec == NULL) return cli_unknown_codec(c, c->context, to);
  cli_hold_interrupts();
  failed = to_container(c, in, codec, path);
  cli_release_interrupts();
  if (!failed) print_report(path, to, cli_seconds() - started);
  return failed;
}

static int run(cli *c) {
  const char *path = c->operands[1];
  input in = {0};
  c->operand_count = 1; /* where the result lies is not recorded in it */
  int failed = open_source(c, &in);
  if (!failed) failed = convert(c, &in, path);
  input_close(&in);
  return failed;
}

static const cli_option options_table[] = {
    {"to", 0, "NAME", "what to convert to: a codec that keeps factors", 0},
    {"param", 'p', "KEY=VALUE", "set a parameter of that; may be repeated", 0},
    {"from", 0, "NAME", "the format of IN, instead of recognising it from the content", 0},
    {"from-param", 0, "KEY=VALUE", "set a parameter of that format; may be repeated", 0},
    CLI_OPTIONS_END};

const cli_command cmd_convert = {"convert",
                                 "changes the form of data without compressing it anew",
                                 "IN OUT [--to NAME] [-p KEY=VALUE]... [options]",
                                 "IN is a data set, measured data or a container. Factorised measurements "
                                 "become a model that holds the same\n"
                                 "factors, with values equal to those of IN: fmf, or pvpca where each view "
                                 "is factorised by itself. Without\n"
                                 "--to that is what a name OUT.btfz gets.",
                                 options_table,
                                 2,
                                 2,
                                 run};
