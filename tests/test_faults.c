/* SPDX-License-Identifier: MIT */
/*
 * Every allocation, read, write, system call and progress report on the way from samples to an evaluated file
 * is made to fail in turn. Each failure must come back as a status of the right kind, with out-pointers NULL,
 * nothing leaked and no file left behind; the loop ends with the first run in which nothing was left to fail.
 */
#include "btf_test.h"

#include <errno.h>
#include <unistd.h>

#include "io/io.h"

enum { SIDE = 6, DIRECTIONS = 10, CHANNELS = 3, MOST_FAULTS = 20000 };

/* What fails, counted from 1; 0 = nothing. */
typedef struct fault {
  long allocation, source_read, container_read, container_write, progress, system_call;
  int32_t persistent; /* and all allocations after it */
} fault;

typedef struct scenario {
  fault fails;
  long source_reads, container_reads, container_writes, progress_calls;
  const char *path;
  unsigned char *bytes; /* the container in memory */
  uint64_t size, capacity;
  int closes, failed_closes;
} scenario;

static long system_calls, failing_system_call;

static int fail_system_call(const char *call) {
  (void)call;
  return ++system_calls == failing_system_call ? EIO : 0;
}

static btf_status read_samples(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  scenario *sc = user;
  if (++sc->source_reads == sc->fails.source_read) return btf_source_error(BTF_E_IO, "the source broke");
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++)
          for (uint32_t c = 0; c < CHANNELS; c++) {
            const uint32_t view = b->view0 + v, light = b->light0 + l, tx = b->x0 + x, ty = b->y0 + y;
            *(float *)((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y +
                       (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel) =
                0.5f + 0.3f * sinf((float)(view * 3 + light) + 0.7f * (float)(tx * ty)) + 0.01f * (float)c;
          }
  return BTF_OK;
}

static int32_t progress(void *user, double fraction, const char *stage) {
  scenario *sc = user;
  assert_true(fraction >= 0.0 && fraction <= 1.0);
  assert_non_null(stage);
  return ++sc->progress_calls == sc->fails.progress;
}

static int64_t memory_size(void *user) {
  return (int64_t)((scenario *)user)->size;
}

static int64_t memory_read(void *user, void *dst, size_t n, uint64_t offset) {
  scenario *sc = user;
  if (++sc->container_reads == sc->fails.container_read) return -1;
  if (offset >= sc->size) return 0;
  if (n > sc->size - offset) n = (size_t)(sc->size - offset);
  memcpy(dst, sc->bytes + offset, n);
  return (int64_t)n;
}

static int64_t memory_write(void *user, const void *src, size_t n, uint64_t offset) {
  scenario *sc = user;
  if (++sc->container_writes == sc->fails.container_write) return -1;
  if (offset + n > sc->capacity) {
    const uint64_t capacity = 2 * (offset + n);
    sc->bytes = realloc(sc->bytes, capacity);
    assert_non_null(sc->bytes);
    memset(sc->bytes + sc->capacity, 0, capacity - sc->capacity);
    sc->capacity = capacity;
  }
  memcpy(sc->bytes + offset, src, n);
  if (offset + n > sc->size) sc->size = offset + n;
  return (int64_t)n;
}

static int32_t memory_close(void *user, int32_t failed) {
  scenario *sc = user;
  sc->closes++;
  if (failed) sc->failed_closes++;
  return 0;
}

static btf_status write_container(btf_context *ctx, scenario *sc, const btf_model *model,
                                  const btf_job *job) {
  btf_io io = BTF_IO_INIT;
  btf_writer *writer;
  btf_status status;
  io.user = sc;
  io.size = memory_size;
  io.read = memory_read;
  io.write = memory_write;
  io.close = memory_close;
  status = btf_writer_open(ctx, &io, 0, &writer);
  if (status != BTF_OK) {
    assert_null(writer);
    return status;
  }
  status = btf_writer_metadata(writer, "btf.command", "a test");
  if (status == BTF_OK) status = btf_writer_model(writer, model, job);
  if (status == BTF_OK) return btf_writer_finish(writer);
  btf_writer_abort(writer);
  return status;
}

static btf_status read_container(btf_context *ctx, scenario *sc, btf_model **out) {
  btf_io io = BTF_IO_INIT;
  btf_file *file;
  btf_status status;
  *out = NULL;
  io.user = sc;
  io.size = memory_size;
  io.read = memory_read;
  io.close = memory_close;
  status = btf_file_open(ctx, &io, 0, &file);
  if (status != BTF_OK) {
    assert_null(file);
    return status;
  }
  status = btf_file_validate(file, NULL, NULL);
  if (status == BTF_OK) status = btf_file_load_model(file, 0, out);
  btf_file_close(file);
  return status;
}

static void expect_plausible(const btf_model *model) {
  const btf_query query = {{0.3f, 0.2f, 0.93f}, {-0.1f, 0.5f, 0.86f}, {0.4f, 0.6f}, 0.5f, 0};
  float f[CHANNELS];
  btf_model_eval(model, &query, f);
  for (int c = 0; c < CHANNELS; c++) assert_true(f[c] > 0.0f && f[c] < 2.0f);
}

/* The whole way. Returns the first status that is not BTF_OK. */
static btf_status run_all(scenario *sc, btf_context *ctx) {
  btf_dirset *directions = NULL;
  btf_dataset *dataset = NULL;
  btf_options *options = NULL;
  btf_model *model = NULL, *loaded = NULL;
  btf_job job = BTF_JOB_INIT;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_status status;
  job.progress = progress;
  job.user = sc;
  status = btf_dirset_create_named(ctx, "grid:5x2", &directions);
  if (status != BTF_OK) assert_null(directions);
  if (status == BTF_OK) {
    desc.lights = desc.views = directions;
    desc.width = desc.height = SIDE;
    desc.channels = CHANNELS;
    desc.read = read_samples;
    desc.user = sc;
    status = btf_dataset_create(ctx, &desc, &dataset);
    if (status != BTF_OK) assert_null(dataset);
  }
  if (status == BTF_OK) status = btf_options_create(btf_codec_find(ctx, "fmf"), &options);
  if (status == BTF_OK) status = btf_options_set(options, "components", "4");
  if (status == BTF_OK) {
    status = btf_model_fit(dataset, btf_codec_find(ctx, "fmf"), options, &job, &model);
    if (status != BTF_OK) assert_null(model);
  }
  if (status == BTF_OK) status = write_container(ctx, sc, model, &job);
  if (status == BTF_OK) {
    status = read_container(ctx, sc, &loaded);
    if (status != BTF_OK) assert_null(loaded);
  }
  if (status == BTF_OK) expect_plausible(loaded);
  btf_model_release(loaded);
  loaded = NULL;
  if (status == BTF_OK) status = btf_model_save(model, sc->path, 0, "a test", &job);
  if (status == BTF_OK) {
    status = btf_model_load(ctx, sc->path, &loaded);
    if (status != BTF_OK) assert_null(loaded);
  }
  if (status == BTF_OK) expect_plausible(loaded);
  btf_model_release(loaded);
  btf_model_release(model);
  btf_options_release(options);
  btf_dataset_release(dataset);
  btf_dirset_release(directions);
  return status;
}

/* One run with a fault; returns its status. Leaks and leftovers fail the test. */
static btf_status run_with(fault fails) {
  test_memory memory = {0};
  scenario sc = {.fails = fails, .path = test_path("fault.btfz")};
  btf_context *ctx = NULL;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  const btf_allocator allocator = test_allocator(&memory);
  btf_status status;
  memory.fail_at = fails.allocation;
  memory.persistent = fails.persistent;
  system_calls = 0;
  failing_system_call = fails.system_call;
  btfi_io_fault = fail_system_call;
  desc.allocator = &allocator;
  desc.max_threads = 2;
  status = btf_context_create(&desc, &ctx);
  if (status != BTF_OK)
    assert_null(ctx);
  else
    status = run_all(&sc, ctx);
  btf_context_release(ctx);
  btfi_io_fault = NULL;
  assert_int_equal(memory.live_blocks, 0);
  if (status != BTF_OK) {
    assert_true(strlen(btf_error_message()) > 0 && strchr(btf_error_message(), '\n') == NULL);
    /* A file stands complete or not at all; one that was complete before a later step failed may stay. */
    const size_t left = test_count_entries(test_folder());
    assert_true(left == 0 || (left == 1 && access(sc.path, F_OK) == 0));
  }
  if (sc.container_writes > 0) assert_true(sc.closes >= 1);
  if (fails.container_write != 0 && status != BTF_OK) assert_int_equal(sc.failed_closes, 1);
  unlink(sc.path);
  free(sc.bytes);
  return status;
}

static void nothing_fails(void **state) {
  (void)state;
  assert_ok(run_with((fault){0}));
}

static void allocations(void **state) {
  (void)state;
  for (int persistent = 0; persistent <= 1; persistent++) {
    long n = 1;
    for (; n < MOST_FAULTS; n++) {
      const btf_status status = run_with((fault){.allocation = n, .persistent = persistent});
      if (status == BTF_OK) break;
      assert_int_equal(status, BTF_E_NOMEM);
    }
    print_message("%ld allocations failed in turn\n", n - 1);
    assert_in_range(n, 20, MOST_FAULTS - 1);
  }
}

#define LOOP(member, expected, at_least)                                                                     \
  do {                                                                                                       \
    long n = 1;                                                                                              \
    for (; n < MOST_FAULTS; n++) {                                                                           \
      const btf_status status = run_with((fault){.member = n});                                              \
      if (status == BTF_OK) break;                                                                           \
      assert_int_equal(status, expected);                                                                    \
    }                                                                                                        \
    print_message("%ld faults of kind " #member "\n", n - 1);                                                \
    assert_in_range(n - 1, at_least, MOST_FAULTS - 2);                                                       \
  } while (0)

static void source_reads(void **state) {
  (void)state;
  LOOP(source_read, BTF_E_IO, 1);
}

static void container_reads(void **state) {
  (void)state;
  LOOP(container_read, BTF_E_IO, 3);
}

static void container_writes(void **state) {
  (void)state;
  LOOP(container_write, BTF_E_IO, 3);
}

static void system_calls_of_files(void **state) {
  (void)state;
  LOOP(system_call, BTF_E_IO, 5);
}

static void cancellations(void **state) {
  (void)state;
  LOOP(progress, BTF_E_CANCELLED, 2);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(nothing_fails),    cmocka_unit_test(allocations),
      cmocka_unit_test(source_reads),     cmocka_unit_test(container_reads),
      cmocka_unit_test(container_writes), cmocka_unit_test(system_calls_of_files),
      cmocka_unit_test(cancellations),
  };
  return btf_run("faults", tests);
}
