/* SPDX-License-Identifier: MIT */
/* cmd_import.c: reads measured data into a data-set folder. */
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "commands.h"
#include "input.h"
#include "safe_text.h"
#include "sample_walk.h"

enum { MESSAGE_BYTES = 512 };

typedef struct copying {
  btf_dataset_writer *writer;
  const sample_source *source;
  atomic_flag failed;
  btf_status status; /* of the thread that took the flag */
  char message[MESSAGE_BYTES];
} copying;

static void put_block(void *user, const sample_visit *visit) {
  copying *copy = user;
  const sample_source *s = copy->source;
  const btf_block block = {.view0 = visit->view,
                           .views = 1,
                           .light0 = visit->light0,
                           .lights = visit->lights,
                           .width = s->width,
                           .height = s->height};
  const ptrdiff_t x = (ptrdiff_t)(s->channels * sizeof(float)), y = x * (ptrdiff_t)s->width;
  const btf_strides strides = {.light = y * (ptrdiff_t)s->height, .y = y, .x = x, .channel = sizeof(float)};
  const btf_status status = btf_dataset_writer_put(copy->writer, &block, visit->a, &strides);
  if (status == BTF_OK || atomic_flag_test_and_set(&copy->failed)) return;
  copy->status = status;
  snprintf(copy->message, sizeof copy->message, "%s", btf_error_message());
}

static btf_status start(cli *c, const input *in, const char *path, uint32_t sample_type,
                        btf_dataset_writer **out) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  char *command = cli_recorded_command(c);
  btf_status status = btf_dataset_describe(in->dataset, &desc);
  const char *const *notes = desc.notes;
  desc.sample_type = sample_type;
  if (status == BTF_OK) status = btf_dataset_writer_create(c->context, path, &desc, BTF_ORDER_VLYXC, out);
  for (uint32_t i = 0; status == BTF_OK && notes != NULL && notes[i] != NULL; i += 2)
    status = btf_dataset_writer_text(*out, notes[i], notes[i + 1]);
  if (status == BTF_OK && command != NULL) status = btf_dataset_writer_text(*out, "command", command);
  free(command);
  return status;
}

static int copy_samples(cli *c, input *in, const char *path, uint32_t sample_type) {
  sample_source source;
  copying copy = {.source = &source, .failed = ATOMIC_FLAG_INIT};
  const sample_walk walk = {.a = &source, .visit = put_block, .user = &copy, .stage = "importing", .to = 1};
  int failed = sample_source_open(in, &source);
  if (failed) return failed;
  btf_status status = start(c, in, path, sample_type, &copy.writer);
  if (status == BTF_OK) {
    failed = sample_walk_run(c, &walk);
    if (!failed && copy.status != BTF_OK) failed = cli_fail(cli_exit_of(copy.status), "%s", copy.message);
    if (!failed) {
      status = btf_dataset_writer_finish(copy.writer);
      copy.writer = NULL;
    }
  }
  cli_progress_done(c);
  if (status != BTF_OK) failed = cli_fail_library(status);
  btf_dataset_writer_abort(copy.writer);
  return failed;
}

static int list(cli *c) {
  btf_context *ctx;
  const int failed = cli_context(c, &ctx);
  if (failed) return failed;
  for (uint32_t i = 0; i < btf_format_count(ctx); i++) {
    const btf_format *format = btf_format_at(ctx, i);
    printf("%s: ", btf_format_id(format));
    safe_text_put(stdout, btf_format_title(format));
    putchar('\n');
    for (uint32_t k = 0; k < btf_format_param_count(format); k++) {
      btf_param_desc p = {.struct_size = sizeof p};
      if (btf_format_param(format, k, &p) == BTF_OK) cli_print_param(&p);
    }
  }
  return EXIT_DONE;
}

static int run(cli *c) {
  static const char *const words[] = {"u8", "u16", "f16", "f32", NULL};
  static const uint32_t types[] = {BTF_SAMPLE_U8, BTF_SAMPLE_U16, BTF_SAMPLE_F16, BTF_SAMPLE_F32};
  const char *path;
  input in;
  int type = 2;
  if (cli_has(c, "list")) return list(c);
  if (c->operand_count == 0) return cli_usage(c, "PATH is missing");
  int failed = cli_required(c, "output", &path);
  if (!failed) failed = cli_choice(c, "type", words, &type);
  if (!failed) failed = input_open_measured(c, c->operands[0], "format", "param", &in);
  if (failed) return failed;
  cli_hold_interrupts();
  failed = copy_samples(c, &in, path, types[type]);
  cli_release_interrupts();
  input_close(&in);
  return failed;
}

static const cli_option options[] = {
    CLI_OPTION_OUTPUT("data-set folder to write"),
    {"format", 0, "NAME", "the format, instead of recognising it from the content", 0},
    {"param", 'p', "KEY=VALUE", "set a parameter of the format; may be repeated", 0},
    {"type", 0, "TYPE", "type of the samples written: u8, u16, f16 (default) or f32", 0},
    {"list", 0, NULL, "list the formats of this build and their parameters", CLI_OPTION_UNRECORDED},
    CLI_OPTIONS_END};

const cli_command cmd_import = {
    "import",
    "reads measured data into a data-set folder",
    "PATH -o OUT.btfd [options]\n--list",
    "The format is recognised from the content, whatever the name. Samples are read and written block by "
    "block.\n"
    "Other commands take measured data as it is; importing makes repeated reading faster.",
    options,
    0,
    1,
    run};
