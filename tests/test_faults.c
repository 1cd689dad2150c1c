/* SPDX-License-Identifier: MIT */
/*
 * Every allocation, read, write, system call and progress report on the way from samples to an evaluated file
 * is made to fail in turn. Each failure must come back as a status of the right kind, with out-pointers NULL,
 * nothing leaked and no file left behind; the loop ends with the first run in which nothing was left to fail.
 * `test_faults [CODEC...]` does so for the rows of codec_cases.c that ask for it.
 */
#include "btf_test.h"

#include <errno.h>
#include <unistd.h>

#include "codec_cases.h"
#include "io/io.h"

enum { MOST_CHANNELS = 4, MOST_FAULTS = 20000 };

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
  btf_dirset *lights, *views;
} scenario;

static const codec_case *row; /* at hand */
static const codec_material *const material = &codec_materials[MATERIAL_TINY];

static long system_calls, failing_system_call;

static int fail_system_call(const char *call) {
  (void)call;
  return ++system_calls == failing_system_call ? EIO : 0;
}

static btf_status read_samples(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  scenario *sc = user;
  if (++sc->source_reads == sc->fails.source_read) return btf_source_error(BTF_E_IO, "the source broke");
  const float *lights = btf_dirset_directions(sc->lights), *views = btf_dirset_directions(sc->views);
  const uint32_t channels = codec_case_channels(row, 1);
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++)
          for (uint32_t c = 0; c < channels; c++)
            *(float *)((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y +
                       (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel) =
                codec_material_value(material, lights + 3 * (size_t)(b->light0 + l),
                                     views + 3 * (size_t)(b->view0 + v), b->x0 + x, b->y0 + y, c);
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
  float f[MOST_CHANNELS];
  btf_model_eval(model, &query, f);
  for (uint32_t c = 0; c < codec_case_channels(row, 1); c++) assert_true(f[c] > 0.0f && f[c] < 2.0f);
}

/* The whole way. Returns the first status that is not BTF_OK. */
static btf_status run_all(scenario *sc, btf_context *ctx) {
  btf_dataset *dataset = NULL;
  btf_options *options = NULL;
  btf_model *model = NULL, *loaded = NULL;
  btf_job job = BTF_JOB_INIT;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_status status;
  job.progress = progress;
  job.user = sc;
  status = btf_dirset_create_named(ctx, material->lights, &sc->lights);
  if (status != BTF_OK) assert_null(sc->lights);
  if (status == BTF_OK) {
    status = btf_dirset_create_named(ctx, material->views, &sc->views);
    if (status != BTF_OK) assert_null(sc->views);
  }
  if (status == BTF_OK) {
    desc.lights = sc->lights;
    desc.views = sc->views;
    desc.width = material->width;
    desc.height = material->height;
    desc.channels = codec_case_channels(row, 1);
    desc.read = read_samples;
    desc.user = sc;
    status = btf_dataset_create(ctx, &desc, &dataset);
    if (status != BTF_OK) assert_null(dataset);
  }
  if (status == BTF_OK) {
    status = codec_case_options(ctx, row, NULL, &options);
    if (status != BTF_OK) assert_null(options);
  }
  if (status == BTF_OK) {
    status = btf_model_fit(dataset, btf_codec_find(ctx, row->codec), options, &job, &model);
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
  btf_dirset_release(sc->lights);
  btf_dirset_release(sc->views);
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

/* One allocation alone, then it and all after it, of which every fourth will do: what differs is only how a
 * failure is cleaned up. */
static void allocations(void **state) {
  (void)state;
  for (int persistent = 0; persistent <= 1; persistent++) {
    long n = 1;
    for (; n < MOST_FAULTS; n += persistent ? 4 : 1) {
      const btf_status status = run_with((fault){.allocation = n, .persistent = persistent});
      if (status == BTF_OK) break;
      assert_int_equal(status, BTF_E_NOMEM);
    }
    print_message("%ld allocations\n", n - 1);
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

static int in_build(const char *codec) {
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  assert_int_equal(btf_context_create(&desc, &ctx), BTF_OK);
  const btf_codec *found = btf_codec_find(ctx, codec);
  const int usable = found != NULL && (btf_codec_caps(found) & BTF_CAP_FIT) != 0;
  btf_context_release(ctx);
  return usable;
}

static int is_asked(const char *codec, int argc, char **argv) {
  for (int i = 1; i < argc; i++)
    if (strcmp(argv[i], codec) == 0) return 1;
  return argc < 2;
}

int main(int argc, char **argv) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(nothing_fails),    cmocka_unit_test(allocations),
      cmocka_unit_test(source_reads),     cmocka_unit_test(container_reads),
      cmocka_unit_test(container_writes), cmocka_unit_test(system_calls_of_files),
      cmocka_unit_test(cancellations),
  };
  int result = 0, rows = 0;
  for (size_t i = 0; i < codec_case_count; i++) {
    row = &codec_cases[i];
    if (!row->faults || !is_asked(row->codec, argc, argv)) continue;
    if (!in_build(row->codec)) {
      print_message("%s is not in this build: its row is passed over\n", row->codec);
      continue;
    }
    rows++;
    print_message("%s %s\n", row->codec, row->options);
    result |= btf_run("faults", tests);
  }
  if (rows == 0 && argc > 1) {
    print_message("no row of tests/codec_cases.c has .faults for what was asked\n");
    return 1;
  }
  return result;
}
