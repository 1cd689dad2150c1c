/* SPDX-License-Identifier: MIT */
#include "btf_test.h"

#include <dirent.h>
#include <errno.h>
#include <ftw.h>
#include <locale.h>
#include <pthread.h>
#include <unistd.h>

/* ---- counting allocator ---- */

enum { header_size = 64, longest_poisoned = 1 << 20 };
static const uint64_t live_mark = 0x6c69766562746675u, dead_mark = 0x6465616462746675u;
static pthread_mutex_t count_mutex = PTHREAD_MUTEX_INITIALIZER;

typedef struct block_header {
  uint64_t mark;
  size_t size;
} block_header;

static void die(const char *problem) {
  fprintf(stderr, "test allocator: %s\n", problem);
  abort();
}

static void *counted_alloc(void *user, size_t size, size_t align) {
  test_memory *memory = user;
  if (align == 0 || align > 64 || (align & (align - 1)) != 0) die("alignment is not a power of two up to 64");
  pthread_mutex_lock(&count_mutex);
  const long number = ++memory->total_allocations;
  const int fail =
      memory->fail_at > 0 && (number == memory->fail_at || (memory->persistent && number > memory->fail_at));
  if (!fail) {
    memory->live_blocks++;
    memory->live_bytes += size;
    if (memory->live_bytes > memory->peak_bytes) memory->peak_bytes = memory->live_bytes;
  }
  pthread_mutex_unlock(&count_mutex);
  if (fail) return NULL;

  const size_t total = (size + header_size + 63) & ~(size_t)63;
  unsigned char *block = total > size ? aligned_alloc(64, total) : NULL;
  if (!block) {
    pthread_mutex_lock(&count_mutex);
    memory->live_blocks--;
    memory->live_bytes -= size;
    pthread_mutex_unlock(&count_mutex);
    return NULL;
  }
  const block_header header = {live_mark, size};
  memcpy(block, &header, sizeof header);
  /* Reading what was never written shows as absurd values instead of lucky zeros. */
  memset(block + header_size, 0xa5, size < longest_poisoned ? size : longest_poisoned);
  return block + header_size;
}

static void counted_free(void *user, void *ptr, size_t size) {
  test_memory *memory = user;
  block_header header;
  if (!ptr) die("free of NULL");
  unsigned char *block = (unsigned char *)ptr - header_size;
  memcpy(&header, block, sizeof header);
  if (header.mark != live_mark) die("free of a block that is not live");
  if (header.size != size) die("free with another size than alloc");
  header.mark = dead_mark;
  memcpy(block, &header, sizeof header);
  free(block);
  pthread_mutex_lock(&count_mutex);
  memory->live_blocks--;
  memory->live_bytes -= size;
  pthread_mutex_unlock(&count_mutex);
}

btf_context *test_context_with(test_memory *memory, const char *isa, uint32_t threads) {
  btf_allocator allocator = {memory, counted_alloc, counted_free};
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx = NULL;
  memset(memory, 0, sizeof *memory);
  desc.allocator = &allocator;
  desc.isa = isa;
  desc.max_threads = threads;
  assert_ok(btf_context_create(&desc, &ctx));
  return ctx;
}

btf_context *test_context(test_memory *memory) {
  return test_context_with(memory, NULL, 0);
}

btf_allocator test_allocator(test_memory *memory) {
  const btf_allocator allocator = {memory, counted_alloc, counted_free};
  return allocator;
}

void test_context_done(btf_context *ctx, test_memory *memory) {
  btf_context_release(ctx);
  pthread_mutex_lock(&count_mutex);
  const long live = memory->live_blocks;
  pthread_mutex_unlock(&count_mutex);
  if (live != 0) fail_msg("%ld blocks were not freed", live);
}

/* ---- scratch files ---- */

static char scratch_folder[512];
static pid_t scratch_owner;

static int remove_entry(const char *path, const struct stat *entry, int kind, struct FTW *walk) {
  (void)entry;
  (void)kind;
  (void)walk;
  return remove(path);
}

static void remove_scratch_folder(void) {
  if (getpid() == scratch_owner) nftw(scratch_folder, remove_entry, 16, FTW_DEPTH | FTW_PHYS);
}

const char *test_folder(void) {
  if (scratch_folder[0]) return scratch_folder;
  const char *parent = getenv("TMPDIR");
  snprintf(scratch_folder, sizeof scratch_folder, "%s/btf-test-XXXXXX", parent && *parent ? parent : "/tmp");
  if (!mkdtemp(scratch_folder)) {
    fprintf(stderr, "%s: cannot be made: %s\n", scratch_folder, strerror(errno));
    abort();
  }
  scratch_owner = getpid();
  atexit(remove_scratch_folder);
  return scratch_folder;
}

const char *test_path(const char *name) {
  static char ring[16][1024];
  static unsigned next;
  char *path = ring[next++ % 16];
  snprintf(path, sizeof ring[0], "%s/%s", test_folder(), name);
  return path;
}

int test_set_comma_locale(void) {
  static const char *const names[] = {"de_DE.UTF-8", "de_DE.utf8", "de_DE",
                                      "fr_FR.UTF-8", "fr_FR.utf8", "ru_RU.UTF-8"};
  for (size_t i = 0; i < sizeof names / sizeof *names; i++)
    if (setlocale(LC_ALL, names[i]) != NULL) return 1;
  return 0;
}

void test_write_bytes(const char *path, const void *data, size_t size) {
  FILE *file = fopen(path, "wb");
  if (!file) fail_msg("%s: %s", path, strerror(errno));
  const size_t written = size > 0 ? fwrite(data, 1, size, file) : 0;
  if (fclose(file) != 0 || written != size) fail_msg("%s: %s", path, strerror(errno));
}

unsigned char *test_read_bytes(const char *path, size_t *size) {
  FILE *file = fopen(path, "rb");
  if (!file) fail_msg("%s: %s", path, strerror(errno));
  fseek(file, 0, SEEK_END);
  const long length = ftell(file);
  rewind(file);
  unsigned char *data = malloc(length > 0 ? (size_t)length : 1);
  const size_t got = data && length > 0 ? fread(data, 1, (size_t)length, file) : 0;
  fclose(file);
  if (!data || length < 0 || got != (size_t)length) fail_msg("%s: cannot be read", path);
  *size = got;
  return data;
}

int test_exists(const char *path) {
  return access(path, F_OK) == 0;
}

size_t test_count_entries(const char *folder) {
  size_t count = 0;
  DIR *directory = opendir(folder);
  if (!directory) fail_msg("%s: %s", folder, strerror(errno));
  for (const struct dirent *entry; (entry = readdir(directory));)
    if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0) count++;
  closedir(directory);
  return count;
}

/* ---- running ---- */

static size_t skipped_tests;

void test_note_skip(void) {
  skipped_tests++;
}

int btf_run_group(const char *name, const struct CMUnitTest *tests, size_t count) {
  skipped_tests = 0;
  const int result = _cmocka_run_group_tests(name, tests, count, NULL, NULL);
  const size_t failed = result < 0 ? count : (size_t)result;
  printf("%zu passed, %zu failed", count - failed - skipped_tests, failed);
  if (skipped_tests > 0) printf(", %zu skipped", skipped_tests);
  printf("\n");
  fflush(stdout);
  return failed > 0;
}
