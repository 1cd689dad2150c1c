/* SPDX-License-Identifier: MIT */
/* cmd_import.c: reads measured data into a data-set folder. */
#include "commands.h"
#include "folder_copy.h"

static int run(cli *c) {
  const double started = cli_seconds();
  const char *path;
  uint32_t sample_type;
  input in;
  if (cli_has(c, "list")) return cli_list_formats(c, false);
  if (c->operand_count == 0) return cli_usage(c, "PATH is missing");
  int failed = cli_required(c, "output", &path);
  if (!failed) failed = input_open_import(c, c->operands[0], &in);
  if (failed) return failed;
  failed = folder_copy_type(c, &in, false, &sample_type);
  if (!failed) {
    cli_hold_interrupts();
    failed = folder_copy(c, &in, path, sample_type);
    cli_release_interrupts();
  }
  if (!failed && !c->quiet)
    input_print_written(path, input_sample_type(sample_type), cli_seconds() - started);
  input_close(&in);
  return failed;
}

static const cli_option options[] = {
    CLI_OPTION_OUTPUT("data-set folder to write"),
    {"format", 0, "NAME", "the format, instead of recognising it from the content", 0},
    {"param", 'p', "KEY=VALUE", "set a parameter of the format; may be repeated", 0},
    INPUT_OPTIONS_SHORT,
    CLI_OPTION_SAMPLE_TYPE("otherwise f16, or integers if the data are"),
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
