/* SPDX-License-Identifier: MIT */
/* cmd_encode.c: compresses a data set into a container file. */
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "commands.h"
#include "input.h"
#include "json_writer.h"
#include "output_file.h"
#include "safe_text.h"

typedef struct report {
  uint64_t raw_bytes, bytes;
  double fit_seconds, save_seconds;
  const char *codec, *sample_type;
} report;

static void print_report(const cli *c, const char *path, const report *r) {
  const double ratio = r->bytes > 0 ? (double)r->raw_bytes / (double)r->bytes : 0;
  const double seconds = r->fit_seconds + r->save_seconds;
  if (cli_has(c, "json")) {
    json_writer j;
    json_begin(&j, stdout);
    json_object(&j, NULL);
    json_string(&j, "file", path);
    json_string(&j, "codec", r->codec);
    json_integer(&j, "bytes", r->bytes);
    json_integer(&j, "raw_bytes", r->raw_bytes);
    json_string(&j, "raw_type", r->sample_type);
    json_number(&j, "ratio", ratio);
    json_number(&j, "seconds", seconds);
    json_number(&j, "fit_seconds", r->fit_seconds);
    json_number(&j, "save_seconds", r->save_seconds);
    json_integer(&j, "warnings", atomic_load(&c->warnings));
    json_close(&j, '}');
    json_end(&j);
  } else {
    safe_text_put(stdout, path);
    printf(": %" PRIu64 " bytes (%.2f MiB), ratio %.2f to raw %s, %.2f s\n", r->bytes,
           (double)r->bytes / 1048576, ratio, r->sample_type, seconds);
  }
}

static int fit_and_save(cli *c, const btf_dataset *dataset, const btf_codec *codec,
                        const btf_options *options, const btf_job *job, const char *path, report *r) {
  btf_dataset_desc data = BTF_DATASET_DESC_INIT;
  btf_model *model = NULL;
  char *command = cli_recorded_command(c);
  btf_job saving = *job;
  double started = cli_seconds();
  btf_status status;
  if (command == NULL) return cli_out_of_memory();
  btf_dataset_describe(dataset, &data);
  r->sample_type = input_sample_type(data.sample_type);
  r->raw_bytes = input_value_count(btf_dirset_count(data.views), btf_dirset_count(data.lights), data.width,
                                   data.height, data.channels) *
                 input_sample_size(data.sample_type);
  status = btf_model_fit(dataset, codec, options, job, &model);
  r->fit_seconds = cli_seconds() - started;
  started = cli_seconds();
  if (status == BTF_OK) status = btf_model_save(model, path, 0, command, &saving);
  r->save_seconds = cli_seconds() - started;
  btf_model_release(model);
  free(command);
  cli_progress_done(c);
  if (status != BTF_OK) return cli_fail_library(status);
  r->bytes = input_bytes_on_disk(path);
  return EXIT_DONE;
}

static int encode(cli *c, const btf_codec *codec, const btf_options *options, const btf_job *job,
                  const char *path) {
  const char *source = c->operands[0];
  struct stat info;
  input in = {0};
  report r = {0};
  int failed;
  r.codec = btf_codec_id(codec);
  if (!(btf_codec_caps(codec) & BTF_CAP_FIT))
    return cli_fail(EXIT_UNSUPPORTED, "codec %s: cannot compress in this build, only evaluate", r.codec);
  failed = input_open(c, source, &in);
  if (failed) return failed;
  if (in.dataset == NULL)
    failed = cli_fail(EXIT_USAGE,
                      "%s: is compressed already; btf convert %s OUT.btfd makes a data-set folder of it",
                      source, source);
  else if (stat(path, &info) == 0 && S_ISDIR(info.st_mode))
    failed = cli_fail(EXIT_IO, "%s: is a folder; encode writes a file", path);
  if (!failed) failed = output_try(path);
  if (!failed) {
    cli_hold_interrupts();
    failed = fit_and_save(c, in.dataset, codec, options, job, path, &r);
    cli_release_interrupts();
  }
  if (!failed) print_report(c, path, &r);
  input_close(&in);
  return failed;
}

static int run(cli *c) {
  const char *path, *codec_id;
  const btf_codec *codec;
  btf_context *ctx;
  btf_options *options = NULL;
  btf_job job = BTF_JOB_INIT;
  int64_t mebibytes = 0;
  btf_status status;
  int failed = cli_required(c, "output", &path);
  if (!failed) failed = cli_required(c, "codec", &codec_id);
  if (!failed) failed = cli_integer(c, "memory", 1, INT64_C(1) << 40, &mebibytes);
  if (!failed) failed = cli_uint64(c, "seed", &job.seed);
  if (!failed) failed = cli_context(c, &ctx);
  if (failed) return failed;
  codec = btf_codec_find(ctx, codec_id);
  if (codec == NULL) return cli_unknown_codec(c, ctx, codec_id);
  status = btf_options_create(codec, &options);
  if (status != BTF_OK) return cli_fail_library(status);
  cli_job(c, &job);
  job.max_working_set = (uint64_t)mebibytes << 20;
  failed = cli_codec_options(c, options);
  if (!failed) failed = encode(c, codec, options, &job, path);
  btf_options_release(options);
  return failed;
}

static const cli_option options_table[] = {
    CLI_OPTION_OUTPUT("container file to write (.btfz)"),
    {"codec", 'c', "NAME", "the codec; btf codecs lists them", 0},
    {"param", 'p', "KEY=VALUE", "set a parameter of the codec; may be repeated", 0},
    INPUT_OPTIONS,
    {"memory", 'm', "MIB", "working memory of the fit in MiB (default 1024)", 0},
    {"seed", 0, "N", "seed of random choices (default 0)", 0},
    CLI_OPTION_JSON,
    CLI_OPTIONS_END};

const cli_command cmd_encode = {"encode",
                                "compresses a data set",
                                "IN -o OUT.btfz --codec NAME [-p KEY=VALUE]... [options]",
                                "Prints size, ratio (raw bytes at the data set's sample type to bytes on "
                                "disk) and time. The file appears complete\n"
                                "or not at all. It records the command with base names only, so that equal "
                                "input and options give equal bytes.",
                                options_table,
                                1,
                                1,
                                run};
