/* SPDX-License-Identifier: MIT */
/* Runs `btf info` and `btf import` on the damaged and absurd files that the suites of the formats kept
 * (format_keep_refused): each ends with the status of its fault, says so in one line, takes little time and
 * memory, and leaves nothing behind. Usage: hostile_formats BTF FOLDER; the folder has one for each format.
 */
#include <dirent.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <btf/btf.h>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) || __has_feature(memory_sanitizer)
#define SANITIZED 1
#endif
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

enum { LEAST_VARIANTS = 150, MOST_MIB = 256 };
/* Of the processor, which other work on the machine does not add to. Sanitizers are slow, and count their own
 * memory. */
static const double most_seconds = SANITIZED ? 60 : 2;

enum { MALFORMED = 3 };
static const char *tool, *work;
static unsigned failures;
static double longest;
static long largest;

static void fail(const char *command, const char *path, const char *why) {
  fprintf(stderr, "btf %s %s: %s\n", command, path, why);
  failures++;
}

static void die(const char *what) {
  perror(what);
  exit(2);
}

/* As docs/command-line.md says, by the tens that statuses are numbered in. */
static int exit_of(int status) {
  if (status == BTF_E_IO) return 2;
  if (status == BTF_E_LIMIT || status == BTF_E_NOMEM) return 6;
  return status / 10 == 0 ? 1 : status / 10 == 2 ? MALFORMED : status / 10 == 3 ? 5 : 7;
}

static bool is_empty(const char *folder) {
  DIR *entries = opendir(folder);
  unsigned count = 0;
  if (entries == NULL) die(folder);
  while (readdir(entries) != NULL) count++;
  closedir(entries);
  return count == 2;
}

/* What is on standard error is in `said`. */
static int run(char *const *arguments, char said[4096], struct rusage *usage) {
  int ends[2], status;
  size_t used = 0;
  if (pipe(ends) != 0) die("pipe");
  const pid_t child = fork();
  if (child < 0) die("fork");
  if (child == 0) {
    const int nothing = open("/dev/null", O_WRONLY);
    if (chdir(work) != 0 || dup2(nothing, 1) < 0 || dup2(ends[1], 2) < 0) _exit(126);
    close(ends[0]);
    execv(tool, arguments);
    _exit(127);
  }
  close(ends[1]);
  for (ssize_t got; (got = read(ends[0], said + used, 4095 - used)) > 0;) used += (size_t)got;
  said[used] = '\0';
  close(ends[0]);
  if (wait4(child, &status, 0, usage) != child) die("wait4");
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

static double seconds(struct timeval t) {
  return (double)t.tv_sec + 1e-6 * (double)t.tv_usec;
}

/* With id NULL the format is left to be recognised, which what is damaged need not be. */
static void check(const char *command, const char *id, const char *path, int expected) {
  const char *arguments[8] = {"btf", command, path};
  int used = 3;
  char said[4096], why[256];
  struct rusage usage;
  if (id != NULL) {
    arguments[used++] = "--format";
    arguments[used++] = id;
  }
  if (strcmp(command, "import") == 0) {
    arguments[used++] = "-o";
    arguments[used++] = "out.btfd";
  }
  const int status = run((char *const *)(uintptr_t)arguments, said, &usage);
  const char *end = strchr(said, '\n');
  if (status != expected && (id != NULL || status != MALFORMED)) {
    snprintf(why, sizeof why, "status %d instead of %d: %.150s", status, expected, said);
    fail(command, path, why);
  } else if (strncmp(said, "btf: ", 5) != 0 || end == NULL || end[1] != '\0') {
    snprintf(why, sizeof why, "not one line: %.200s", said);
    fail(command, path, why);
  }
  const double took = seconds(usage.ru_utime) + seconds(usage.ru_stime);
  if (took >= most_seconds) {
    snprintf(why, sizeof why, "took %.2f s", took);
    fail(command, path, why);
  }
  if (!SANITIZED && usage.ru_maxrss >= MOST_MIB * 1024L) {
    snprintf(why, sizeof why, "took %ld KiB", usage.ru_maxrss);
    fail(command, path, why);
  }
  if (took > longest) longest = took;
  if (usage.ru_maxrss > largest) largest = usage.ru_maxrss;
  if (!is_empty(work)) {
    fail(command, path, "left something behind");
    exit(1);
  }
}

static int is_visible(const struct dirent *entry) {
  return entry->d_name[0] != '.';
}

/* STATUS-open-NUMBER, or STATUS-read-NUMBER for what is found when samples are read. */
static unsigned check_format(const char *folder, const char *name) {
  char id[64], path[4096];
  struct dirent **names;
  snprintf(id, sizeof id, "%s", name);
  for (char *p = id; *p != '\0'; p++)
    if (*p == '_') *p = '-';
  snprintf(path, sizeof path, "%s/%s", folder, name);
  const int count = scandir(path, &names, is_visible, alphasort);
  if (count < 0) die(path);
  for (int i = 0; i < count; i++) {
    int status;
    char stage[8];
    if (sscanf(names[i]->d_name, "%d-%7[a-z]-", &status, stage) != 2) die(names[i]->d_name);
    snprintf(path, sizeof path, "%s/%s/%s", folder, name, names[i]->d_name);
    if (strcmp(stage, "open") == 0) check("info", id, path, exit_of(status));
    check("import", i % 2 == 0 ? id : NULL, path, exit_of(status));
    free(names[i]);
  }
  free(names);
  printf("%-12s %d\n", id, count);
  if (count == 0) fail("", id, "no files were kept");
  return (unsigned)count;
}

int main(int argc, char **argv) {
  char empty[] = "/tmp/btf-hostile-XXXXXX";
  struct dirent **names;
  unsigned variants = 0;
  if (argc != 3) return 2;
  tool = argv[1];
  work = mkdtemp(empty);
  if (work == NULL) die(empty);
  const int count = scandir(argv[2], &names, is_visible, alphasort);
  if (count < 0) die(argv[2]);
  for (int i = 0; i < count; i++) {
    variants += check_format(argv[2], names[i]->d_name);
    free(names[i]);
  }
  free(names);
  rmdir(work);
  printf("%u variants refused, %u failures; %.2f s and %ld MiB at most\n", variants, failures, longest,
         largest / 1024);
  if (variants < LEAST_VARIANTS) fail("", argv[2], "too few variants");
  return failures > 0;
}
