/* SPDX-License-Identifier: MIT */
/*
 * cli.h: what every subcommand of btf uses: its description, parsed arguments, failures, context and
 * progress.
 *
 * A function here that returns an exit status has already printed its one line when the status is not
 * EXIT_DONE; callers pass the status on.
 */
#ifndef BTF_TOOLS_CLI_H
#define BTF_TOOLS_CLI_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include <btf/btf.h>

/* Exit status by cause. */
enum {
  EXIT_DONE = 0,
  EXIT_USAGE = 1,
  EXIT_IO = 2,
  EXIT_MALFORMED = 3,
  EXIT_FAILED = 4,
  EXIT_UNSUPPORTED = 5,
  EXIT_LIMIT = 6,
  EXIT_DIFFERS = 7,
  EXIT_INTERRUPTED = 130
};

/* ---- description of a subcommand ---- */

enum {
  CLI_OPTION_PATH = 1u << 0,      /* its value is a path: recorded by base name */
  CLI_OPTION_UNRECORDED = 1u << 1 /* does not change the result: left out of the recorded command */
};

typedef struct cli_option {
  const char *name;     /* long form without dashes; NULL ends the table */
  char letter;          /* short form, 0 = none */
  const char *argument; /* NULL = a switch, otherwise how help names the value, such as "N" */
  const char *summary;  /* for help; '\n' breaks the line */
  uint32_t flags;
} cli_option;

/* Entries of option tables that several commands share. --help, --quiet, --verbose, --threads and --plugin
 * belong to every command and are not listed. */
#define CLI_OPTION_OUTPUT(summary)                                                                           \
  { "output", 'o', "PATH", summary, CLI_OPTION_PATH | CLI_OPTION_UNRECORDED }
#define CLI_OPTION_JSON                                                                                      \
  { "json", 0, NULL, "print the result as JSON", CLI_OPTION_UNRECORDED }
#define CLI_OPTIONS_END                                                                                      \
  { NULL, 0, NULL, NULL, 0 }

typedef struct cli cli;

typedef struct cli_command {
  const char *name;
  const char *summary;            /* one line of `btf --help` */
  const char *usage;              /* what follows `btf NAME`; several forms are separated by '\n' */
  const char *details;            /* paragraphs printed after the options; may be NULL */
  const cli_option *options;      /* ends with CLI_OPTIONS_END */
  int operands_min, operands_max; /* -1 = any number */
  int (*run)(cli *c);             /* returns the exit status */
} cli_command;

/* ---- parsed arguments ---- */

typedef struct cli_given {
  const cli_option *option;
  const char *value; /* NULL for a switch */
} cli_given;

struct cli {
  const cli_command *command;
  const char **operands;
  int operand_count;
  cli_given *given; /* in the order of the command line */
  int given_count;
  bool quiet, verbose;
  atomic_uint warnings; /* of the library so far */
  uint32_t threads;     /* --threads or 0; with a context, how many it works with */
  btf_context *context; /* made by cli_context */
};

/* Number of times an option was given, its i-th value, its last value (NULL if not given). */
int cli_count(const cli *c, const char *name);
const char *cli_value_at(const cli *c, const char *name, int i);
const char *cli_value(const cli *c, const char *name);
static inline bool cli_has(const cli *c, const char *name) {
  return cli_count(c, name) > 0;
}

/* Typed values of an option. Not given: *out stays as it is. Out of range or not a number: EXIT_USAGE. */
int cli_integer(const cli *c, const char *name, int64_t minimum, int64_t maximum, int64_t *out);
int cli_uint32(const cli *c, const char *name, uint32_t minimum, uint32_t maximum, uint32_t *out);
int cli_uint64(const cli *c, const char *name, uint64_t *out);
int cli_number(const cli *c, const char *name, double minimum, double maximum, double *out);
/* "WxH", or "N" for NxN. */
int cli_size(const cli *c, const char *name, uint32_t maximum, uint32_t *width, uint32_t *height);
/* Exactly `count` finite numbers separated by commas. */
int cli_numbers(const cli *c, const char *name, int count, double *out);
/* One of the words of a NULL-terminated list; *out is its index. */
int cli_choice(const cli *c, const char *name, const char *const *choices, int *out);
/* The value of an option that must be there. */
int cli_required(const cli *c, const char *name, const char **out);

/* The command as recorded in files: subcommand, operands by base name, options in the order of the table. No
 * output path, nothing that leaves the result alone. malloc'ed; NULL when out of memory. */
char *cli_recorded_command(const cli *c);

/* The word of a NULL-terminated list that `given` is a likely misspelling of, or NULL. */
const char *cli_near_miss(const char *given, const char *const *words);

/* Shows help of one command on `out`. */
void cli_print_help(const cli_command *command, FILE *out);
/* Parses argv (after the subcommand's name) and runs the command. Returns the exit status. */
int cli_run(const cli_command *command, int argc, char **argv);

/* ---- failures ---- */

/* Prints "btf: " and one line on standard error, and returns `exit_status`. */
int cli_fail(int exit_status, const char *format, ...) LIBBTF_PRINTF(2, 3);
/* Usage error of a command; the line ends with where to find help. */
int cli_usage(const cli *c, const char *format, ...) LIBBTF_PRINTF(2, 3);
/* Prints the library's message of the last failure and returns the exit status for it. */
int cli_fail_library(btf_status status);
/* The exit status of a library status. */
int cli_exit_of(btf_status status);
int cli_out_of_memory(void);
/* A line on standard error unless --quiet. */
void cli_note(const cli *c, const char *format, ...) LIBBTF_PRINTF(2, 3);

/* The same for what must be known even with --quiet: the work was done, but not all that was asked for. */
void cli_warn(cli *c, const char *format, ...) LIBBTF_PRINTF(2, 3);

/* Flushes standard output. EXIT_IO when it could not be written. A reader that closed the pipe ends the
 * process quietly, as it ends every filter. */
int cli_flush(void);

/* ---- context, progress, interruption ---- */

/* The context of the command with --threads and the plug-ins, made on first use and released by cli_run. */
int cli_context(cli *c, btf_context **out);

/* The failure of naming a codec that the context does not have, with the nearest one it has. */
int cli_unknown_codec(const cli *c, const btf_context *ctx, const char *id);

/* Sets the values of the option `name`, which are KEY=VALUE; `lister` is a command that shows the keys. */
int cli_set_params(const cli *c, const char *name, const char *lister, btf_options *options);
/* Sets the values of --param on the options of a codec. */
int cli_codec_options(const cli *c, btf_options *options);
/* A parameter's type as a word; and two lines about it on standard output. */
const char *cli_param_type(uint32_t type);
void cli_print_param(const btf_param_desc *p);
/* The formats that are read or written, with the parameters of that. */
int cli_list_formats(cli *c, bool written);

/* Fills a job whose progress draws the bar and whose return cancels after Ctrl-C. Other members are the
 * caller's. */
void cli_job(cli *c, btf_job *job);
/* For loops of the tool's own, from one thread: draws the bar; true = stop, the user interrupted. */
bool cli_progress(cli *c, double fraction, const char *stage);
/* Removes the bar from the terminal. */
void cli_progress_done(cli *c);

/* Between hold and release an interruption only sets a flag, so that half-made output can be removed; outside
 * it ends the process at once. Calls nest. */
void cli_hold_interrupts(void);
void cli_release_interrupts(void);
bool cli_interrupted(void);
/* The line and status of an interrupted command. */
int cli_fail_interrupted(void);

/* Wall clock in seconds, for durations. */
double cli_seconds(void);

#endif
