/* SPDX-License-Identifier: MIT */
/* cmd_export.c: answers for GPU export. */
#include "commands.h"

static int run(cli *c) {
  return cli_fail(EXIT_UNSUPPORTED, "export: %s: GPU textures and shaders come with a later version of btf",
                  c->operands[0]);
}

static const cli_option options[] = {CLI_OPTION_OUTPUT("folder to write"), CLI_OPTIONS_END};

const cli_command cmd_export = {"export",
                                "writes GPU textures and a shader (in a later version)",
                                "FILE -o DIR",
                                "This version of btf has no GPU export: the command ends with status 5.",
                                options,
                                1,
                                1,
                                run};
