/* SPDX-License-Identifier: MIT */
/* cli_session.c: failures, context with plug-ins, progress bar, interruption. */
#include "cli_session.h"
#include "cli.h"

#include <errno.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <btf/btf_formats.h>
#include <btf/btf_plugin.h>

#include "plugin_path.h"
#include "safe_text.h"

#ifdef BTF_TOOL_OPENBLAS
#include <cblas.h>
#endif

/* ---- failures ---- */

static volatile sig_atomic_t bar_is_drawn; /* read by the signal handler */

static void erase_bar(void) {
  if (bar_is_drawn) fputs("\r\033[K", stderr);
  bar_is_drawn = 0;
}

/* One line whatever the message holds: control characters of hostile names become '?'. */
static void print_line(const char *format, va_list arguments) {
  char line[2048];
  vsnprintf(line, sizeof line, format, arguments);
  safe_text_clean(line);
  erase_bar();
  fprintf(stderr, "btf: %s\n", line);
}

int cli_fail(int exit_status, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  print_line(format, arguments);
  va_end(arguments);
  return exit_status;
}

int cli_usage(const cli *c, const char *format, ...) {
  char text[1024];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  return cli_fail(EXIT_USAGE, "%s: %s (see btf %s --help)", c->command->name, text, c->command->name);
}

void cli_note(const cli *c, const char *format, ...) {
  va_list arguments;
  if (c->quiet) return;
  va_start(arguments, format);
  print_line(format, arguments);
  va_end(arguments);
}

void cli_warn(cli *c, const char *format, ...) {
  va_list arguments;
  atomic_fetch_add(&c->warnings, 1);
  va_start(arguments, format);
  print_line(format, arguments);
  va_end(arguments);
}

int cli_exit_of(btf_status status) {
  switch (status) {
  case BTF_OK:
    return EXIT_DONE;
  case BTF_E_IO:
    return EXIT_IO;
  case BTF_E_NOMEM:
  case BTF_E_LIMIT:
    return EXIT_LIMIT;
  case BTF_E_CANCELLED:
    return EXIT_INTERRUPTED;
  default:
    break;
  }
  if (status >= 1 && status < 10) return EXIT_USAGE;
  if (status >= 20 && status < 30) return EXIT_MALFORMED;
  if (status >= 30 && status < 40) return EXIT_UNSUPPORTED;
  return EXIT_FAILED;
}

int cli_fail_library(btf_status status) {
  const char *message = btf_error_message();
  if (status == BTF_E_CANCELLED) return cli_fail_interrupted();
  if (message[0] == '\0') message = btf_status_name(status);
  return cli_fail(cli_exit_of(status), "%s", message);
}

int cli_out_of_memory(void) {
  return cli_fail(EXIT_LIMIT, "out of memory");
}

int cli_flush(void) {
  if (fflush(stdout) == 0 && !ferror(stdout)) return EXIT_DONE;
  if (errno == EPIPE) {
    signal(SIGPIPE, SIG_DFL);
    raise(SIGPIPE);
  }
  return cli_fail(EXIT_IO, "standard output: could not be written: %s", strerror(errno));
}

double cli_seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* ---- interruption ---- */

static volatile sig_atomic_t interrupted, interrupts_held;

/* `line` begins with what erases a bar. */
static void leave(const char *line, size_t length, int status) {
  const size_t erase = bar_is_drawn ? 0 : 4;
  const ssize_t written = write(STDERR_FILENO, line + erase, length - erase);
  (void)written;
  _exit(status);
}

static void on_interrupt(int signal_number) {
  static const char line[] = "\r\033[Kbtf: interrupted\n";
  (void)signal_number;
  interrupted = 1;
  if (interrupts_held == 0) leave(line, sizeof line - 1, EXIT_INTERRUPTED);
}

/* A page of a mapped file is no longer there. */
static void on_lost_page(int signal_number) {
  static const char line[] = "\r\033[Kbtf: a file became shorter, or its disk failed, while it was read\n";
  (void)signal_number;
  leave(line, sizeof line - 1, EXIT_IO);
}

void cli_session_begin(void) {
  struct sigaction action;
  memset(&action, 0, sizeof action);
  sigemptyset(&action.sa_mask);
  action.sa_handler = on_interrupt;
  sigaction(SIGINT, &action, NULL);
  sigaction(SIGTERM, &action, NULL);
  sigaction(SIGHUP, &action, NULL);
  action.sa_handler = on_lost_page;
  sigaction(SIGBUS, &action, NULL);
  /* A write that fails is reported, and cleaned up after, where it was made. */
  signal(SIGPIPE, SIG_IGN);
#ifdef SIGXFSZ
  signal(SIGXFSZ, SIG_IGN);
#endif
}

void cli_hold_interrupts(void) {
  interrupts_held++;
}
void cli_release_interrupts(void) {
  interrupts_held--;
}
bool cli_interrupted(void) {
  return interrupted != 0;
}
int cli_fail_interrupted(void) {
  return cli_fail(EXIT_INTERRUPTED, "interrupted");
}

/* ---- progress ---- */

static double bar_started, bar_shown;
static char bar_stage[64];

static bool bar_wanted(const cli *c) {
  static int terminal = -1;
  if (terminal < 0) terminal = isatty(STDERR_FILENO);
  return terminal && !c->quiet;
}

static void draw_bar(double fraction, const char *stage) {
  enum { cells = 30 };
  const double now = cli_seconds();
  char bar[cells + 1];
  double elapsed;
  if (stage == NULL) stage = "";
  if (!bar_is_drawn) bar_started = now;
  if (bar_is_drawn && strncmp(stage, bar_stage, sizeof bar_stage - 1) == 0 && now - bar_shown < 0.15) return;
  snprintf(bar_stage, sizeof bar_stage, "%s", stage); /* a module's own words */
  bar_shown = now;
  elapsed = now - bar_started;
  fraction = fraction > 0 ? (fraction < 1 ? fraction : 1) : 0;
  for (int i = 0; i < cells; i++) bar[i] = i < (int)(fraction * cells) ? '#' : '.';
  bar[cells] = '\0';
  fprintf(stderr, "\r\033[K[%s] %3d %%  %d:%02d  ", bar, (int)(100 * fraction), (int)(elapsed / 60),
          (int)elapsed % 60);
  safe_text_put(stderr, bar_stage);
  fflush(stderr);
  bar_is_drawn = 1;
}

bool cli_progress(cli *c, double fraction, const char *stage) {
  if (interrupted) return true;
  if (bar_wanted(c)) draw_bar(fraction, stage);
  return false;
}

static int32_t job_progress(void *user, double fraction, const char *stage) {
  return cli_progress(user, fraction, stage) ? 1 : 0;
}

void cli_job(cli *c, btf_job *job) {
  job->progress = job_progress;
  job->user = c;
}

void cli_progress_done(cli *c) {
  (void)c;
  erase_bar();
}

/* ---- context ---- */

static void on_log(void *user, int32_t level, btf_status code, const char *message) {
  cli *c = user;
  /* Failures come back as statuses and are printed once, by whoever gives up because of them. */
  (void)code;
  if (level == BTF_LOG_WARNING) cli_warn(c, "warning: %s", message);
  if (level == BTF_LOG_INFO && c->verbose) cli_note(c, "%s", message);
}

int cli_context(cli *c, btf_context **out) {
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_status status;
  *out = c->context;
  if (c->context != NULL) return EXIT_DONE;
  desc.max_threads = c->threads;
  desc.log = on_log;
  desc.log_user = c;
  status = btf_context_create(&desc, &c->context);
  if (status != BTF_OK) return cli_fail_library(status);
  c->threads = btf_context_threads(c->context);
#ifdef BTF_TOOL_OPENBLAS
  /* The library divides large work among its own threads, which wait without spinning. What the user gave
   * OpenBLAS itself stays. */
  if (getenv("OPENBLAS_NUM_THREADS") == NULL) openblas_set_num_threads(1);
#endif
#ifdef BTF_TOOL_FORMATS
  status = btf_formats_register(c->context);
  if (status != BTF_OK) return cli_fail_library(status);
#endif
  for (int i = 0; i < cli_count(c, "plugin"); i++) {
    const char *path = cli_value_at(c, "plugin", i);
    if (path[0] != '/') return cli_usage(c, "--plugin is \"%s\"; it takes an absolute path", path);
    if (access(path, R_OK) != 0)
      return cli_fail(EXIT_IO, "%s: could not be opened: %s", path, strerror(errno));
    status = btf_context_load_plugin(c->context, path);
    if (status != BTF_OK) return cli_fail_library(status);
  }
  plugin_path_load(c);
  *out = c->context;
  return EXIT_DONE;
}
