/* SPDX-License-Identifier: MIT */
/* Files that appear whole or not at all, and what sources of the host may do wrong. */
#include "btf_test.h"

#include "io/io.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

static size_t open_descriptors(void) {
  return test_count_entries("/proc/self/fd");
}

/* An empty folder of its own for each test, so that leftovers can be counted. */
static const char *own_folder(const char *name) {
  const char *folder = test_path(name);
  assert_int_equal(mkdir(folder, 0777), 0);
  return folder;
}

static const char *in_folder(const char *folder, const char *name) {
  static char path[2048];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  return path;
}

static void expect_content(const char *path, const char *text) {
  size_t size;
  unsigned char *data = test_read_bytes(path, &size);
  assert_int_equal(size, strlen(text));
  assert_memory_equal(data, text, size);
  free(data);
}

/* ---- files ---- */

static void what_is_written_is_read_back(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const size_t descriptors = open_descriptors();
  const char *folder = own_folder("round");
  const char *path = in_folder(folder, "wool.bin");
  btf_io io = BTF_IO_INIT;
  assert_ok(btf_io_file(ctx, path, BTF_IO_WRITE, &io));
  assert_string_equal(btfi_io_name(&io), path);
  assert_ok(btfi_io_write(ctx, &io, "abrdf", 5, 100000)); /* out of order, with a hole */
  assert_ok(btfi_io_write(ctx, &io, "texel", 5, 0));
  assert_ok(btfi_io_write(ctx, &io, NULL, 0, 3));
  assert_false(test_exists(path));
  assert_int_equal(test_count_entries(folder), 1);
  assert_ok(btfi_io_close(ctx, &io, false));
  assert_int_equal(test_count_entries(folder), 1);
  assert_ok(btfi_io_close(ctx, &io, false)); /* a second close does nothing */

  assert_ok(btf_io_file(ctx, path, BTF_IO_READ, &io));
  char text[5];
  assert_int_equal(io.size(io.user), 100005);
  assert_ok(btfi_io_read(ctx, &io, text, 5, 100000));
  assert_memory_equal(text, "abrdf", 5);
  const char *mapped = io.map(io.user, 0, 100005);
  assert_non_null(mapped);
  assert_memory_equal(mapped, "texel\0", 6);
  assert_memory_equal(mapped + 100000, "abrdf", 5);
  assert_ptr_equal(io.map(io.user, 7, 9), mapped + 7);
  assert_non_null(io.map(io.user, 100005, 0));
  assert_null(io.map(io.user, 100000, 6));
  assert_null(io.map(io.user, 100006, 0));
  assert_null(io.map(io.user, UINT64_MAX, 2));
  assert_status(btfi_io_read(ctx, &io, text, 5, 100001), BTF_E_TRUNCATED);
  assert_message_has("ends at byte 100005; expected 5 bytes at offset 100001");
  assert_status(btfi_io_read(ctx, &io, text, 2, UINT64_MAX), BTF_E_TRUNCATED);
  assert_status(btfi_io_read(ctx, &io, text, 2, INT64_MAX), BTF_E_TRUNCATED);
  assert_ok(btfi_io_read(ctx, &io, text, 0, 0));
  btf_context_release(ctx); /* an open source keeps its context */
  assert_int_equal(io.close(io.user, 0), 0);
  assert_int_equal(memory.live_blocks, 0);
  assert_int_equal(open_descriptors(), descriptors);
}

static void a_file_is_replaced_as_a_whole(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const char *folder = own_folder("replace");
  char path[2048];
  snprintf(path, sizeof path, "%s", in_folder(folder, "m"));
  test_write_bytes(path, "old", 3);
  assert_int_equal(chmod(path, 0640), 0);
  btf_io io = BTF_IO_INIT;
  assert_ok(btf_io_file(ctx, path, BTF_IO_WRITE, &io));
  assert_ok(btfi_io_write(ctx, &io, "newer", 5, 0));
  expect_content(path, "old");
  assert_ok(btfi_io_close(ctx, &io, true)); /* given up */
  expect_content(path, "old");
  assert_int_equal(test_count_entries(folder), 1);

  assert_ok(btf_io_file(ctx, path, BTF_IO_WRITE, &io));
  assert_ok(btfi_io_write(ctx, &io, "newer", 5, 0));
  assert_ok(btfi_io_close(ctx, &io, false));
  expect_content(path, "newer");
  assert_int_equal(test_count_entries(folder), 1);
  struct stat entry;
  assert_int_equal(stat(path, &entry), 0);
  assert_int_equal(entry.st_mode & 0777, 0640);

  /* A new file has the permissions any new file would have. */
  const mode_t mask = umask(027);
  const char *fresh = in_folder(folder, "n");
  assert_ok(btf_io_file(ctx, fresh, BTF_IO_WRITE, &io));
  assert_ok(btfi_io_close(ctx, &io, false));
  umask(mask);
  assert_int_equal(stat(fresh, &entry), 0);
  assert_int_equal(entry.st_mode & 0777, 0640);
  assert_int_equal(entry.st_size, 0);
  test_context_done(ctx, &memory);
}

static void a_relative_path_keeps_its_meaning(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  char before[1024];
  assert_non_null(getcwd(before, sizeof before));
  const char *folder = own_folder("relative");
  assert_int_equal(chdir(folder), 0);
  btf_io io = BTF_IO_INIT;
  char longest[256];
  memset(longest, 'x', 255);
  longest[255] = '\0';
  assert_ok(btf_io_file(ctx, longest, BTF_IO_WRITE, &io)); /* its temporary name must still fit */
  assert_int_equal(chdir("/"), 0);
  assert_ok(btfi_io_close(ctx, &io, false));
  assert_true(test_exists(in_folder(folder, longest)));
  assert_int_equal(chdir(before), 0);
  test_context_done(ctx, &memory);
}

static void what_is_no_file_is_refused(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const size_t descriptors = open_descriptors();
  const char *folder = own_folder("odd");
  char pipe_path[2048];
  snprintf(pipe_path, sizeof pipe_path, "%s", in_folder(folder, "pipe"));
  assert_int_equal(mkfifo(pipe_path, 0600), 0);
  const struct {
    const char *path;
    uint32_t mode;
    const char *message;
  } odd[] = {
      {folder, BTF_IO_READ, "is a folder"},
      {folder, BTF_IO_WRITE, "is a folder"},
      {in_folder(folder, "absent"), BTF_IO_READ, "cannot be opened: No such file"},
      {pipe_path, BTF_IO_READ, "is a device, a pipe"}, /* and opening it does not hang */
      {pipe_path, BTF_IO_WRITE, "is a device, a pipe"},
      {"/dev/null", BTF_IO_READ, "is a device"},
      {"/dev/null", BTF_IO_WRITE, "is a device"},
      {"/no/such/folder/m", BTF_IO_WRITE, "its folder cannot be opened: No such file"},
      {"/", BTF_IO_WRITE, "is a folder"},
      {"..", BTF_IO_WRITE, "is a folder"},
      {"/tmp/", BTF_IO_WRITE, "is a folder"},
  };
  for (size_t i = 0; i < sizeof odd / sizeof odd[0]; i++) {
    btf_io io = BTF_IO_INIT;
    io.user = &memory;
    assert_status(btf_io_file(ctx, odd[i].path, odd[i].mode, &io), BTF_E_IO);
    assert_message_has(odd[i].message);
    assert_message_has(odd[i].path);
    assert_null(io.user);
    assert_null(io.close);
  }
  btf_io io = BTF_IO_INIT;
  assert_status(btf_io_file(ctx, "", BTF_IO_READ, &io), BTF_E_INVALID_ARG);
  assert_status(btf_io_file(ctx, NULL, BTF_IO_READ, &io), BTF_E_INVALID_ARG);
  assert_status(btf_io_file(ctx, "x", 2, &io), BTF_E_INVALID_ARG);
  assert_status(btf_io_file(ctx, "x", BTF_IO_READ, NULL), BTF_E_INVALID_ARG);
  io.struct_size = 4;
  assert_status(btf_io_file(ctx, "x", BTF_IO_READ, &io), BTF_E_ABI);
  assert_int_equal(test_count_entries(folder), 1);
  assert_int_equal(open_descriptors(), descriptors);
  test_context_done(ctx, &memory);
}

static void a_folder_without_permission_is_told(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const char *folder = own_folder("locked");
  assert_int_equal(chmod(test_folder(), 0755), 0);
  assert_int_equal(chmod(folder, 0555), 0);
  const uid_t user = geteuid();
  if (user == 0 && seteuid(65534) != 0) {
    test_context_done(ctx, &memory);
    skip();
  }
  btf_io io = BTF_IO_INIT;
  const btf_status status = btf_io_file(ctx, in_folder(folder, "m"), BTF_IO_WRITE, &io);
  if (user == 0) assert_int_equal(seteuid(0), 0);
  assert_int_equal(chmod(folder, 0755), 0);
  assert_status(status, BTF_E_IO);
  assert_message_has("Permission denied");
  assert_int_equal(test_count_entries(folder), 0);
  test_context_done(ctx, &memory);
}

static void a_full_disk_leaves_nothing(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const char *folder = own_folder("full");
  const char *path = in_folder(folder, "large.btfz");
  struct rlimit before, small;
  static char block[70000];
  assert_int_equal(getrlimit(RLIMIT_FSIZE, &before), 0);
  small = before;
  small.rlim_cur = 65536; /* the first write is cut short there, the next one fails */
  void (*const handler)(int) = signal(SIGXFSZ, SIG_IGN);
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &small), 0);
  btf_io io = BTF_IO_INIT;
  const btf_status opened = btf_io_file(ctx, path, BTF_IO_WRITE, &io);
  const btf_status written = opened == BTF_OK ? btfi_io_write(ctx, &io, block, sizeof block, 0) : opened;
  char message[1024];
  snprintf(message, sizeof message, "%s", btf_error_message());
  const btf_status closed = btfi_io_close(ctx, &io, true);
  setrlimit(RLIMIT_FSIZE, &before);
  signal(SIGXFSZ, handler);
  assert_int_equal(opened, BTF_OK);
  assert_int_equal(written, BTF_E_IO);
  assert_non_null(strstr(message, "large.btfz: cannot write at offset 65536: File too large"));
  assert_int_equal(closed, BTF_OK);
  assert_int_equal(test_count_entries(folder), 0);
  test_context_done(ctx, &memory);
}

/* ---- failing system calls ---- */

static struct {
  int until_failure, code, calls;
  char log[1024];
} faults;

static int fault_at_count(const char *call) {
  faults.calls++;
  strcat(strcat(faults.log, call), " ");
  return --faults.until_failure == 0 ? faults.code : 0;
}

static btf_status write_file(btf_context *ctx, const char *path) {
  btf_io io = BTF_IO_INIT;
  btf_status status = btf_io_file(ctx, path, BTF_IO_WRITE, &io);
  for (uint64_t i = 0; status == BTF_OK && i < 3; i++) status = btfi_io_write(ctx, &io, "new", 3, 3 * i);
  char message[1024];
  snprintf(message, sizeof message, "%s", btf_error_message());
  const btf_status closed = btfi_io_close(ctx, &io, status != BTF_OK);
  if (status != BTF_OK) assert_string_equal(btf_error_message(), message);
  return status != BTF_OK ? status : closed;
}

static void every_failing_call_of_a_writer_leaves_the_old_file(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const size_t descriptors = open_descriptors();
  for (int old = 0; old < 2; old++) {
    const char *folder = own_folder(old ? "fault-old" : "fault-new");
    char path[2048];
    snprintf(path, sizeof path, "%s", in_folder(folder, "m.btfz"));
    int failures = 0;
    for (;; failures++) {
      if (old)
        test_write_bytes(path, "old", 3);
      else
        unlink(path);
      const long live = memory.live_blocks;
      memset(&faults, 0, sizeof faults);
      faults.until_failure = failures + 1;
      faults.code = ENOSPC;
      btfi_io_fault = fault_at_count;
      const btf_status status = write_file(ctx, path);
      btfi_io_fault = NULL;
      assert_int_equal(memory.live_blocks, live);
      assert_int_equal(open_descriptors(), descriptors);
      if (status == BTF_OK) break;
      assert_int_equal(status, BTF_E_IO);
      assert_message_has("m.btfz: ");
      assert_message_has("No space left on device");
      /* Once renamed the file is there, whole, even if the folder's entry may not last. */
      const int renamed = strstr(faults.log, "rename fsync ") != NULL;
      assert_int_equal(test_count_entries(folder), old || renamed);
      if (old || renamed) expect_content(path, renamed ? "newnewnew" : "old");
    }
    assert_string_equal(faults.log, "open open pwrite pwrite pwrite fsync close rename fsync ");
    assert_int_equal(failures, faults.calls);
    expect_content(path, "newnewnew");
  }
  test_context_done(ctx, &memory);
}

static void every_failing_call_of_a_reader_is_told(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const size_t descriptors = open_descriptors();
  const char *path = test_path("source.bin");
  test_write_bytes(path, "texels", 6);
  const long live = memory.live_blocks;
  for (int route = 0; route < 3; route++)
    for (int failing = 1;; failing++) {
      memset(&faults, 0, sizeof faults);
      faults.until_failure = failing;
      faults.code = EIO;
      btfi_io_fault = fault_at_count;
      btf_status status;
      if (route == 0) {
        char *data;
        uint64_t size;
        status = btfi_read_file(ctx, path, 100, &data, &size);
        if (status == BTF_OK) assert_string_equal(data, "texels");
        assert_true((status == BTF_OK) == (data != NULL));
        btfi_free(ctx, data);
      } else if (route == 1) {
        btfi_mapping mapping;
        status = btfi_map_file(ctx, path, &mapping);
        if (status == BTF_OK) assert_memory_equal(mapping.data, "texels", 6);
        assert_int_equal(mapping.size, status == BTF_OK ? 6 : 0);
        btfi_unmap(&mapping);
        assert_null(mapping.data);
      } else {
        btf_io io = BTF_IO_INIT;
        char text[6];
        status = btf_io_file(ctx, path, BTF_IO_READ, &io);
        if (status == BTF_OK) status = btfi_io_read(ctx, &io, text, 6, 0);
        assert_ok(btfi_io_close(ctx, &io, true));
      }
      btfi_io_fault = NULL;
      assert_int_equal(memory.live_blocks, live);
      assert_int_equal(open_descriptors(), descriptors);
      if (status == BTF_OK) {
        assert_int_equal(failing, 4); /* open, fstat and pread or mmap failed in turn */
        break;
      }
      assert_int_equal(status, BTF_E_IO);
      assert_message_has("source.bin: ");
      assert_message_has("Input/output error");
    }

  btf_io io = BTF_IO_INIT; /* without a mapping, a source can still be read */
  char text[6];
  assert_ok(btf_io_file(ctx, path, BTF_IO_READ, &io));
  memset(&faults, 0, sizeof faults);
  faults.until_failure = 1;
  faults.code = ENOMEM;
  btfi_io_fault = fault_at_count;
  assert_null(io.map(io.user, 0, 6));
  btfi_io_fault = NULL;
  assert_ok(btfi_io_read(ctx, &io, text, 6, 0));
  assert_memory_equal(text, "texels", 6);
  assert_non_null(io.map(io.user, 0, 6));
  assert_ok(btfi_io_close(ctx, &io, false));
  test_context_done(ctx, &memory);
}

static void every_failing_allocation_is_told(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const size_t descriptors = open_descriptors();
  const char *path = test_path("allocations.bin");
  for (uint32_t mode = 2; mode-- > 0;) { /* BTF_IO_WRITE makes the file that BTF_IO_READ reads */
    const long live = memory.live_blocks;
    for (int failing = 1;; failing++) {
      btf_io io = BTF_IO_INIT;
      memory.fail_at = memory.total_allocations + failing;
      const btf_status status = btf_io_file(ctx, path, mode, &io);
      memory.fail_at = 0;
      if (status == BTF_OK) {
        assert_int_equal(failing, 3);
        assert_ok(btfi_io_close(ctx, &io, false));
        break;
      }
      assert_int_equal(status, BTF_E_NOMEM);
      assert_int_equal(memory.live_blocks, live);
      assert_int_equal(open_descriptors(), descriptors);
    }
  }
  test_context_done(ctx, &memory);
}

/* ---- whole files ---- */

static void whole_files_are_bounded(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const char *path = test_path("whole.json");
  char *data;
  uint64_t size;
  test_write_bytes(path, "{\"a\":1}", 7);
  assert_ok(btfi_read_file(ctx, path, 7, &data, &size));
  assert_int_equal(size, 7);
  assert_string_equal(data, "{\"a\":1}");
  btfi_free(ctx, data);
  assert_status(btfi_read_file(ctx, path, 6, &data, &size), BTF_E_LIMIT);
  assert_message_has("has 7 bytes; expected at most 6");
  assert_null(data);

  test_write_bytes(path, "", 0);
  assert_ok(btfi_read_file(ctx, path, 0, &data, &size));
  assert_int_equal(size, 0);
  assert_string_equal(data, "");
  btfi_free(ctx, data);
  btfi_mapping mapping;
  assert_ok(btfi_map_file(ctx, path, &mapping));
  assert_non_null(mapping.data);
  assert_int_equal(mapping.size, 0);
  btfi_unmap(&mapping);
  btf_io io = BTF_IO_INIT;
  assert_ok(btf_io_file(ctx, path, BTF_IO_READ, &io));
  assert_int_equal(io.size(io.user), 0);
  assert_non_null(io.map(io.user, 0, 0));
  assert_ok(btfi_io_close(ctx, &io, false));
  assert_status(btfi_map_file(ctx, test_folder(), &mapping), BTF_E_IO);
  assert_status(btfi_read_file(ctx, test_path("absent"), 9, &data, &size), BTF_E_IO);
  test_context_done(ctx, &memory);
}

static void *map_late(void *user) {
  const btf_io *io = user;
  return (void *)(uintptr_t)io->map(io->user, 0, 5);
}

static void several_threads_share_one_mapping(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const char *path = test_path("shared.bin");
  test_write_bytes(path, "texel", 5);
  for (int repeat = 0; repeat < 50; repeat++) {
    btf_io io = BTF_IO_INIT;
    pthread_t threads[4];
    void *places[4];
    assert_ok(btf_io_file(ctx, path, BTF_IO_READ, &io));
    for (int i = 0; i < 4; i++) assert_int_equal(pthread_create(&threads[i], NULL, map_late, &io), 0);
    for (int i = 0; i < 4; i++) pthread_join(threads[i], &places[i]);
    for (int i = 0; i < 4; i++) assert_ptr_equal(places[i], places[0]);
    assert_memory_equal(places[0], "texel", 5);
    assert_ok(btfi_io_close(ctx, &io, false));
  }
  test_context_done(ctx, &memory);
}

/* ---- sources and sinks of the host ---- */

typedef struct odd_host {
  char bytes[64];
  int64_t step; /* most bytes a call moves; 0 ends early, below 0 fails */
  int64_t extra;
  int closed, closed_failed, code;
} odd_host;

static int64_t odd_amount(const odd_host *h, size_t n) {
  errno = h->code;
  return BTFI_MIN(h->step, (int64_t)n) + h->extra;
}
static int64_t odd_read(void *user, void *dst, size_t n, uint64_t offset) {
  const odd_host *h = user;
  const int64_t amount = odd_amount(h, n);
  if (amount > 0 && (size_t)amount <= n) memcpy(dst, h->bytes + offset, (size_t)amount);
  return amount;
}
static int64_t odd_write(void *user, const void *src, size_t n, uint64_t offset) {
  odd_host *h = user;
  const int64_t amount = odd_amount(h, n);
  if (amount > 0 && (size_t)amount <= n) memcpy(h->bytes + offset, src, (size_t)amount);
  return amount;
}
static int32_t odd_close(void *user, int32_t failed) {
  odd_host *h = user;
  h->closed++;
  h->closed_failed = failed;
  errno = h->code;
  return h->code ? -1 : 0;
}

static void short_transfers_are_continued(void **state) {
  (void)state;
  odd_host h = {.step = 3};
  btf_io io = BTF_IO_INIT;
  char text[20];
  io.user = &h;
  io.read = odd_read;
  io.write = odd_write;
  assert_string_equal(btfi_io_name(&io), "(unnamed)");
  io.name = "host";
  assert_ok(btfi_io_write(NULL, &io, "apparent reflectance", 20, 5));
  assert_ok(btfi_io_read(NULL, &io, text, 20, 5));
  assert_memory_equal(text, "apparent reflectance", 20);
  h.step = 0;
  assert_status(btfi_io_read(NULL, &io, text, 20, 5), BTF_E_TRUNCATED);
  assert_status(btfi_io_write(NULL, &io, text, 20, 5), BTF_E_IO);
  h.step = -1;
  assert_status(btfi_io_read(NULL, &io, text, 20, 5), BTF_E_IO);
  assert_message_has("host: cannot read at offset 5: the source reported an error");
  h.code = EIO;
  assert_status(btfi_io_write(NULL, &io, text, 20, 5), BTF_E_IO);
  assert_message_has("host: cannot write at offset 5: Input/output error");
  h.step = 64;
  h.extra = 1;
  assert_status(btfi_io_read(NULL, &io, text, 20, 5), BTF_E_IO);
  assert_message_has("more than was asked for");
  assert_status(btfi_io_write(NULL, &io, text, 20, 5), BTF_E_IO);
  assert_status(btfi_io_write(NULL, &io, text, 2, UINT64_MAX), BTF_E_LIMIT);
}

static void close_is_called_exactly_once(void **state) {
  (void)state;
  odd_host h = {.step = 3};
  btf_io user = BTF_IO_INIT, io;
  user.user = &h;
  user.close = odd_close;
  user.name = "host";
  assert_status(btfi_io_copy(NULL, &user, false, &io), BTF_E_INVALID_ARG);
  assert_message_has("host: btf_io has no read function");
  assert_int_equal(h.closed, 1);
  assert_int_equal(h.closed_failed, 1);
  assert_ok(btfi_io_close(NULL, &io, false));
  assert_int_equal(h.closed, 1);
  user.read = odd_read;
  assert_status(btfi_io_copy(NULL, &user, true, &io), BTF_E_INVALID_ARG);
  assert_int_equal(h.closed, 2);
  assert_ok(btfi_io_copy(NULL, &user, false, &io));
  assert_ok(btfi_io_close(NULL, &io, false));
  assert_int_equal(h.closed, 3);
  assert_int_equal(h.closed_failed, 0);
  h.code = EDQUOT;
  assert_ok(btfi_io_copy(NULL, &user, false, &io));
  assert_status(btfi_io_close(NULL, &io, false), BTF_E_IO);
  assert_message_has("host: could not be written: Disk quota exceeded");
  assert_ok(btfi_io_copy(NULL, &user, false, &io));
  assert_ok(btfi_io_close(NULL, &io, true)); /* what failed before matters, not this */
  user.close = NULL;
  assert_ok(btfi_io_copy(NULL, &user, false, &io));
  assert_ok(btfi_io_close(NULL, &io, false));
  user.struct_size = 12;
  assert_status(btfi_io_copy(NULL, &user, false, &io), BTF_E_ABI);
  assert_int_equal(h.closed, 5);
}

static void memory_is_a_source(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_io io = BTF_IO_INIT;
  char text[4];
  assert_ok(btf_io_memory(ctx, "eigen-texture", 13, &io));
  assert_int_equal(io.size(io.user), 13);
  assert_ok(btfi_io_read(ctx, &io, text, 4, 9));
  assert_memory_equal(text, "ture", 4);
  assert_memory_equal(io.map(io.user, 6, 7), "texture", 7);
  assert_null(io.map(io.user, 6, 8));
  assert_null(io.map(io.user, UINT64_MAX, 2));
  assert_null(io.write);
  assert_status(btfi_io_read(ctx, &io, text, 4, 10), BTF_E_TRUNCATED);
  assert_status(btfi_io_read(ctx, &io, text, 4, 1000), BTF_E_TRUNCATED);
  assert_ok(btfi_io_close(ctx, &io, false));
  assert_ok(btf_io_memory(ctx, NULL, 0, &io));
  assert_int_equal(io.size(io.user), 0);
  assert_non_null(io.map(io.user, 0, 0));
  assert_ok(btfi_io_close(ctx, &io, false));
  assert_status(btf_io_memory(ctx, NULL, 1, &io), BTF_E_INVALID_ARG);
  assert_null(io.user);
  memory.fail_at = memory.total_allocations + 1;
  assert_status(btf_io_memory(ctx, text, 4, &io), BTF_E_NOMEM);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(what_is_written_is_read_back),
      cmocka_unit_test(a_file_is_replaced_as_a_whole),
      cmocka_unit_test(a_relative_path_keeps_its_meaning),
      cmocka_unit_test(what_is_no_file_is_refused),
      cmocka_unit_test(a_folder_without_permission_is_told),
      cmocka_unit_test(a_full_disk_leaves_nothing),
      cmocka_unit_test(every_failing_call_of_a_writer_leaves_the_old_file),
      cmocka_unit_test(every_failing_call_of_a_reader_is_told),
      cmocka_unit_test(every_failing_allocation_is_told),
      cmocka_unit_test(whole_files_are_bounded),
      cmocka_unit_test(several_threads_share_one_mapping),
      cmocka_unit_test(short_transfers_are_continued),
      cmocka_unit_test(close_is_called_exactly_once),
      cmocka_unit_test(memory_is_a_source),
  };
  return btf_run("io", tests);
}
