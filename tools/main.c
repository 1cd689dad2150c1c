/* SPDX-License-Identifier: MIT */
/* main.c: the btf program: finds the subcommand and runs it. */
#include <string.h>

#include "cli.h"
#include "cli_session.h"
#include "commands.h"

static const cli_command *const commands[] = {
    &cmd_codecs,
#ifdef BTF_TOOL_SYNTH
    &cmd_synth,
#endif
    &cmd_import, &cmd_convert, &cmd_encode, &cmd_info,  &cmd_eval, &cmd_fetch, &cmd_compare,
#ifdef BTF_TOOL_RENDER
    &cmd_render,
#endif
    &cmd_export, &cmd_verify,  &cmd_check,  &cmd_bench,
};
enum { command_count = sizeof commands / sizeof *commands };

static void print_program_help(FILE *out) {
  fputs("Usage: btf COMMAND [options] [arguments]\n"
        "       btf help COMMAND\n"
        "\n"
        "Compresses, measures and evaluates bidirectional texture functions.\n"
        "\n"
        "Commands:\n",
        out);
  for (int i = 0; i < command_count; i++)
    fprintf(out, "  %-10s%s\n", commands[i]->name, commands[i]->summary);
  fputs("\n"
        "Options:\n"
        "  -h, --help      show this help; btf COMMAND --help shows that of a command\n"
        "  -V, --version   show the version\n"
        "\n"
        "Exit status: 0 done, 1 wrong command line, 2 file not read or written, 3 malformed file, 4 work "
        "failed,\n"
        "5 unsupported or newer than this build, 6 limit hit, 7 compare or verify found a difference,\n"
        "130 interrupted.\n",
        out);
}

static const cli_command *find_command(const char *name) {
  for (int i = 0; i < command_count; i++)
    if (strcmp(commands[i]->name, name) == 0) return commands[i];
  return NULL;
}

static int unknown_command(const char *name) {
  const char *words[command_count + 1];
  const char *nearest;
  for (int i = 0; i < command_count; i++) words[i] = commands[i]->name;
  words[command_count] = NULL;
  nearest = cli_near_miss(name, words);
  if (nearest != NULL) return cli_fail(EXIT_USAGE, "unknown command \"%s\"; did you mean %s?", name, nearest);
  return cli_fail(EXIT_USAGE, "unknown command \"%s\"; btf --help lists the commands", name);
}

int main(int argc, char **argv) {
  const cli_command *command;
  const char *word = argc > 1 ? argv[1] : "";
  cli_session_begin();
  if (argc < 2) {
    print_program_help(stderr);
    return EXIT_USAGE;
  }
  if (strcmp(word, "--version") == 0 || strcmp(word, "-V") == 0) {
    const uint32_t version = btf_version();
    printf("btf %u.%u.%u\n", (unsigned)(version >> 16), (unsigned)(version >> 8 & 0xff),
           (unsigned)(version & 0xff));
    return cli_flush();
  }
  if (strcmp(word, "--help") == 0 || strcmp(word, "-h") == 0 || (strcmp(word, "help") == 0 && argc == 2)) {
    print_program_help(stdout);
    return cli_flush();
  }
  if (strcmp(word, "help") == 0) {
    command = find_command(argv[2]);
    if (command == NULL) return unknown_command(argv[2]);
    cli_print_help(command, stdout);
    return cli_flush();
  }
  if (word[0] == '-')
    return cli_fail(EXIT_USAGE, "unknown option %s before a command; btf --help lists the commands", word);
  command = find_command(word);
  if (command == NULL) return unknown_command(word);
  return cli_run(command, argc - 2, argv + 2);
}
