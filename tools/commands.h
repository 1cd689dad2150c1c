/* SPDX-License-Identifier: MIT */
/* commands.h: the subcommands, one C file each. */
#ifndef BTF_TOOLS_COMMANDS_H
#define BTF_TOOLS_COMMANDS_H

#include "cli.h"

extern const cli_command cmd_bench;
extern const cli_command cmd_check;
extern const cli_command cmd_codecs;
extern const cli_command cmd_compare;
extern const cli_command cmd_convert;
extern const cli_command cmd_encode;
extern const cli_command cmd_eval;
extern const cli_command cmd_export;
extern const cli_command cmd_fetch;
extern const cli_command cmd_import;
extern const cli_command cmd_info;
extern const cli_command cmd_render;
extern const cli_command cmd_synth;
extern const cli_command cmd_verify;

#endif
