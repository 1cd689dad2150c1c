/* SPDX-License-Identifier: MIT */
/* cmd_import.c: reads measured data into a data-set folder. */
#include "commands.h"
#include "folder_copy.h"
#include "safe_text.h"

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
  const char *path;
  uint32_t sample_type;
  input in;
  if (cli_has(c, "list")) return list(c);
  if (c->operand_count == 0) return cli_usage(c, "PATH is missing");
  int failed = cli_required(c, "output", &path);
  if (!failed) failed = folder_copy_type(c, &sample_type);
  if (!failed) failed = input_open_import(c, c->operands[0], &in);
  if (failed) return failed;
  cli_hold_interrupts();
  failed = folder_copy(c, &in, path, sample_type);
  cli_release_interrupts();
  input_close(&in);
  return failed;
}

static const cli_option options[] = {
    CLI_OPTION_OUTPUT("data-set folder to write"),
    {"format", 0, "NAME", "the format, instead of recognising it from the content", 0},
    {"param", 'p', "KEY=VALUE", "set a parameter of the format; may be repeated", 0},
    INPUT_OPTIONS_SHORT,
    CLI_OPTION_SAMPLE_TYPE,
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
