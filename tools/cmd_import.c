/* SPDX-License-Identifier: MIT */
/* cmd_import.c: answers for readers of measured formats. */
#include "commands.h"

static int run(cli *c) {
  return cli_fail(
      EXIT_UNSUPPORTED,
      "import: %s: reading measured formats comes with a later version of btf; this one reads data-set "
      "folders (docs/dataset-folder.md)",
      c->operands[0]);
}

static const cli_option options[] = {CLI_OPTION_OUTPUT("data-set folder to write"),
                                     {"format", 0, "NAME", "the format, instead of detecting it", 0},
                                     CLI_OPTIONS_END};

const cli_command cmd_import = {
    "import",
    "reads a measured format into a data-set folder (in a later version)",
    "PATH -o OUT.btfd [options]",
    "This version of btf has no readers of measured formats: the command ends with status 5.",
    options,
    1,
    1,
    run};
