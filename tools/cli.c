/* SPDX-License-Identifier: MIT */
/* cli.c: parsing of a subcommand's arguments, and its help. */
#include "cli.h"

#include <ctype.h>
#include <stdlib.h>
#include <string.h>

#include "cli_session.h"

static const cli_option common_options[] = {
    {"threads", 't', "N", "use at most N threads (default: one per processor)", CLI_OPTION_UNRECORDED},
    {"plugin", 0, "PATH", "load the codec module at this absolute path; may be repeated",
     CLI_OPTION_PATH | CLI_OPTION_UNRECORDED},
    {"quiet", 'q', NULL, "no progress bar and no notes", CLI_OPTION_UNRECORDED},
    {"verbose", 'v', NULL, "print what the library reports on the way", CLI_OPTION_UNRECORDED},
    {"help", 'h', NULL, "show this help", CLI_OPTION_UNRECORDED},
    CLI_OPTIONS_END};

enum { help_column = 30, most_threads = 1024 /* what a context takes */ };

/* ---- looking up ---- */

static const cli_option *find_long(const cli_command *command, const char *name, size_t length) {
  const cli_option *tables[2] = {command->options, common_options};
  for (int t = 0; t < 2; t++)
    for (const cli_option *o = tables[t]; o->name != NULL; o++)
      if (strlen(o->name) == length && memcmp(o->name, name, length) == 0) return o;
  return NULL;
}

static const cli_option *find_letter(const cli_command *command, char letter) {
  const cli_option *tables[2] = {command->options, common_options};
  for (int t = 0; t < 2; t++)
    for (const cli_option *o = tables[t]; o->name != NULL; o++)
      if (o->letter == letter) return o;
  return NULL;
}

/* ---- help ---- */

static void print_option(const cli_option *option, char letter, FILE *out) {
  char left[80];
  const char *rest = option->summary;
  bool first = true;
  const char *argument = option->argument != NULL ? option->argument : "";
  const char *space = option->argument != NULL ? " " : "";
  if (letter != 0)
    snprintf(left, sizeof left, "  -%c, --%s%s%s", letter, option->name, space, argument);
  else
    snprintf(left, sizeof left, "      --%s%s%s", option->name, space, argument);
  if (strlen(left) + 2 > help_column) {
    fprintf(out, "%s\n", left);
    left[0] = '\0';
  }
  while (rest != NULL) {
    const char *line_end = strchr(rest, '\n');
    const int length = line_end != NULL ? (int)(line_end - rest) : (int)strlen(rest);
    fprintf(out, "%-*s%.*s\n", help_column, first ? left : "", length, rest);
    first = false;
    rest = line_end != NULL ? line_end + 1 : NULL;
  }
}

void cli_print_help(const cli_command *command, FILE *out) {
  const char *form = command->usage;
  const char *lead = "Usage:";
  while (form != NULL) {
    const char *line_end = strchr(form, '\n');
    const int length = line_end != NULL ? (int)(line_end - form) : (int)strlen(form);
    fprintf(out, "%s btf %s%s%.*s\n", lead, command->name, length > 0 ? " " : "", length, form);
    lead = "      ";
    form = line_end != NULL ? line_end + 1 : NULL;
  }
  fprintf(out, "\n%c%s.\n\nOptions:\n", toupper((unsigned char)command->summary[0]), command->summary + 1);
  for (const cli_option *o = command->options; o->name != NULL; o++) print_option(o, o->letter, out);
  /* A letter that the command uses itself is not the common option's there. */
  for (const cli_option *o = common_options; o->name != NULL; o++)
    print_option(o, find_letter(command, o->letter) == o ? o->letter : 0, out);
  if (command->details != NULL) fprintf(out, "\n%s\n", command->details);
}

/* ---- near misses ---- */

/* Edit distance with transpositions of neighbours, of words short enough for the table. */
static int edit_distance(const char *a, const char *b) {
  enum { longest = 31 };
  int table[longest + 1][longest + 1];
  const int n = (int)strlen(a), m = (int)strlen(b);
  if (n > longest || m > longest) return longest;
  for (int i = 0; i <= n; i++) {
    for (int j = 0; j <= m; j++) {
      int best;
      if (i == 0 || j == 0) {
        table[i][j] = i + j;
        continue;
      }
      best = table[i - 1][j - 1] + (a[i - 1] != b[j - 1]);
      if (table[i - 1][j] + 1 < best) best = table[i - 1][j] + 1;
      if (table[i][j - 1] + 1 < best) best = table[i][j - 1] + 1;
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] && table[i - 2][j - 2] + 1 < best)
        best = table[i - 2][j - 2] + 1;
      table[i][j] = best;
    }
  }
  return table[n][m];
}

const char *cli_near_miss(const char *given, const char *const *words) {
  const char *nearest = NULL;
  const size_t length = strlen(given);
  int least = length <= 3 ? 2 : length <= 6 ? 3 : 4;
  for (; *words != NULL; words++) {
    int distance = edit_distance(given, *words);
    if (length >= 2 && strncmp(given, *words, length) == 0) distance = 1;
    if (distance < least) {
      least = distance;
      nearest = *words;
    }
  }
  return nearest;
}

/* ---- parsing ---- */

static int unknown_option(const cli *c, const char *name, size_t length) {
  const char *words[64];
  char given[64];
  const char *nearest;
  int count = 0;
  const cli_option *tables[2] = {c->command->options, common_options};
  for (int t = 0; t < 2; t++)
    for (const cli_option *o = tables[t]; o->name != NULL && count < 63; o++) words[count++] = o->name;
  words[count] = NULL;
  snprintf(given, sizeof given, "%.*s", (int)(length < 63 ? length : 63), name);
  nearest = cli_near_miss(given, words);
  if (nearest != NULL) return cli_usage(c, "unknown option --%s; did you mean --%s?", given, nearest);
  return cli_usage(c, "unknown option --%s", given);
}

static void give(cli *c, const cli_option *option, const char *value) {
  c->given[c->given_count].option = option;
  c->given[c->given_count].value = value;
  c->given_count++;
}

/* Takes the next word as the option's value; `dashed` is the option as it was written. What looks like an
 * option is more likely one whose value before it was forgotten; --name=VALUE takes anything. */
static int take_next(cli *c, const cli_option *option, const char *dashed, int argc, char **argv, int *i) {
  if (*i + 1 >= argc) return cli_usage(c, "%s needs a value (%s)", dashed, option->argument);
  const char *value = argv[*i + 1];
  if (value[0] == '-' && (value[1] == '-' || isalpha((unsigned char)value[1])))
    return cli_usage(c, "%s needs a value (%s), not \"%s\"", dashed, option->argument, value);
  ++*i;
  give(c, option, value);
  return EXIT_DONE;
}

static int parse_long(cli *c, int argc, char **argv, int *i) {
  const char *name = argv[*i] + 2;
  const char *equals = strchr(name, '=');
  const size_t length = equals != NULL ? (size_t)(equals - name) : strlen(name);
  const cli_option *option = find_long(c->command, name, length);
  if (option == NULL) return unknown_option(c, name, length);
  if (option->argument == NULL) {
    if (equals != NULL) return cli_usage(c, "--%s takes no value", option->name);
    give(c, option, NULL);
  } else if (equals != NULL) {
    give(c, option, equals + 1);
  } else {
    char dashed[64];
    snprintf(dashed, sizeof dashed, "--%s", option->name);
    return take_next(c, option, dashed, argc, argv, i);
  }
  return EXIT_DONE;
}

static int parse_letters(cli *c, int argc, char **argv, int *i) {
  const char *letters = argv[*i] + 1;
  while (*letters != '\0') {
    const cli_option *option = find_letter(c->command, *letters);
    if (option == NULL) return cli_usage(c, "unknown option -%c", *letters);
    letters++;
    if (option->argument == NULL) {
      give(c, option, NULL);
      continue;
    }
    if (*letters == '=') letters++;
    if (*letters == '\0') {
      const char dashed[] = {'-', option->letter, '\0'};
      return take_next(c, option, dashed, argc, argv, i);
    }
    give(c, option, letters);
    break;
  }
  return EXIT_DONE;
}

static int check_operands(const cli *c) {
  const cli_command *command = c->command;
  if (c->operand_count < command->operands_min)
    return cli_usage(c, "%s; usage: btf %s %.*s",
                     c->operand_count == 0 ? "no file given" : "an argument is missing", command->name,
                     (int)strcspn(command->usage, "\n"), command->usage);
  if (command->operands_max >= 0 && c->operand_count > command->operands_max)
    return cli_usage(c, "unexpected argument \"%s\"", c->operands[command->operands_max]);
  return EXIT_DONE;
}

static int parse(cli *c, int argc, char **argv) {
  bool options_over = false;
  int status = EXIT_DONE;
  int64_t threads = 0;
  for (int i = 0; i < argc && status == EXIT_DONE; i++) {
    const char *word = argv[i];
    if (options_over || word[0] != '-' || word[1] == '\0')
      c->operands[c->operand_count++] = word;
    else if (strcmp(word, "--") == 0)
      options_over = true;
    else if (word[1] == '-')
      status = parse_long(c, argc, argv, &i);
    else
      status = parse_letters(c, argc, argv, &i);
    if (cli_has(c, "help")) return EXIT_DONE;
  }
  if (status != EXIT_DONE) return status;
  c->quiet = cli_has(c, "quiet");
  c->verbose = cli_has(c, "verbose");
  status = cli_integer(c, "threads", 1, most_threads, &threads);
  if (status != EXIT_DONE) return status;
  c->threads = (uint32_t)threads;
  return check_operands(c);
}

int cli_run(const cli_command *command, int argc, char **argv) {
  const size_t room = (size_t)argc + 1;
  size_t letters = 1;
  int status;
  cli c = {0};
  c.command = command;
  /* A word such as -qqq gives one option for each letter. */
  for (int i = 0; i < argc; i++) letters += strlen(argv[i]);
  c.operands = calloc(room, sizeof *c.operands);
  c.given = calloc(letters, sizeof *c.given);
  if (c.operands == NULL || c.given == NULL) {
    status = cli_out_of_memory();
  } else {
    status = parse(&c, argc, argv);
    if (status == EXIT_DONE && cli_has(&c, "help"))
      cli_print_help(command, stdout);
    else if (status == EXIT_DONE)
      status = command->run(&c);
  }
  cli_progress_done(&c);
  if (status == EXIT_DONE || status == EXIT_DIFFERS) {
    const int flushed = cli_flush();
    if (flushed != EXIT_DONE) status = flushed;
  }
  btf_context_release(c.context);
  free(c.operands);
  free(c.given);
  return status;
}

/* ---- the recorded command ---- */

static const char *base_name(const char *path, size_t *length) {
  const char *start;
  size_t end = strlen(path);
  while (end > 1 && path[end - 1] == '/') end--;
  start = path + end;
  while (start > path && start[-1] != '/') start--;
  *length = (size_t)(path + end - start);
  return start;
}

static void put_word(FILE *out, const char *word, size_t length) {
  static const char plain[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-+=:,./@%";
  bool quoted = length == 0;
  for (size_t i = 0; i < length; i++)
    if (strchr(plain, word[i]) == NULL) quoted = true;
  if (quoted) fputc('\'', out);
  for (size_t i = 0; i < length; i++) {
    if (word[i] == '\'')
      fputs("'\\''", out);
    else
      fputc(word[i], out);
  }
  if (quoted) fputc('\'', out);
}

char *cli_recorded_command(const cli *c) {
  char *text = NULL;
  size_t size = 0, length;
  FILE *out = open_memstream(&text, &size);
  if (out == NULL) return NULL;
  fprintf(out, "btf %s", c->command->name);
  for (int i = 0; i < c->operand_count; i++) {
    const char *name = base_name(c->operands[i], &length);
    fputc(' ', out);
    put_word(out, name, length);
  }
  for (const cli_option *o = c->command->options; o->name != NULL; o++) {
    if (o->flags & CLI_OPTION_UNRECORDED) continue;
    for (int i = 0; i < cli_count(c, o->name); i++) {
      const char *value = cli_value_at(c, o->name, i);
      fprintf(out, " --%s", o->name);
      if (value == NULL) continue;
      length = strlen(value);
      if (o->flags & CLI_OPTION_PATH) value = base_name(value, &length);
      fputc(' ', out);
      put_word(out, value, length);
    }
  }
  if (fclose(out) != 0) {
    free(text);
    return NULL;
  }
  return text;
}
