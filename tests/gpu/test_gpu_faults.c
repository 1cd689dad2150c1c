/* SPDX-License-Identifier: MIT */
/*
 * Every allocation and every system call on the way from a model to a folder of its export is made to fail in
 * turn, in each layout of each codec. The failure must come back, nothing be leaked or left half written, and
 * the earlier export in the folder's place stay as it was, with what somebody else put into it. Callers'
 * mistakes come back as btf_gpu.h says.
 */
#include "../btf_test.h"

#include <dirent.h>
#include <errno.h>
#include <sys/stat.h>

#include "../codec_cases.h"
#include "io/io.h"

enum { MOST_FAULTS = 20000, MOST_NAME = 512 };
static const char page[] = "<!doctype html>\n", notes[] = "somebody's";

static long system_calls, failing_system_call;

static int fail_system_call(const char *call) {
  (void)call;
  return ++system_calls == failing_system_call ? EIO : 0;
}

static uint64_t hash_bytes(uint64_t hash, const void *data, size_t size) {
  for (size_t i = 0; i < size; i++) hash = (hash ^ ((const unsigned char *)data)[i]) * 0x100000001b3u;
  return hash;
}

/* Of names and bytes of all files, in any order. */
static uint64_t folder_hash(const char *folder) {
  DIR *there = opendir(folder);
  const struct dirent *entry;
  uint64_t sum = 0;
  assert_non_null(there);
  while ((entry = readdir(there)) != NULL) {
    char path[2 * MOST_NAME];
    size_t size;
    if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
    snprintf(path, sizeof path, "%s/%s", folder, entry->d_name);
    unsigned char *bytes = test_read_bytes(path, &size);
    sum += hash_bytes(hash_bytes(0xcbf29ce484222325u, entry->d_name, strlen(entry->d_name)), bytes, size);
    free(bytes);
  }
  closedir(there);
  return sum;
}

static void remove_files(const char *folder) {
  DIR *there = opendir(folder);
  const struct dirent *entry;
  if (there == NULL) return;
  while ((entry = readdir(there)) != NULL) {
    char path[2 * MOST_NAME];
    snprintf(path, sizeof path, "%s/%s", folder, entry->d_name);
    if (entry->d_name[0] != '.') assert_int_equal(remove(path), 0);
  }
  closedir(there);
  assert_int_equal(remove(folder), 0);
}

typedef struct trial {
  test_memory *memory;
  const btf_model *model;
  const char *layout, *folder;
  bool has_earlier; /* an export in the folder's place */
} trial;

static btf_status export_again(const trial *t) {
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  btf_gpu_export *e;
  target.layout = t->layout;
  btf_status status = btf_gpu_export_create(t->model, &target, &e);
  if (status != BTF_OK) {
    assert_null(e);
    return status;
  }
  status = btf_gpu_export_write_page(e, t->folder, 1, page, sizeof page - 1);
  btf_gpu_export_release(e);
  return status;
}

/* An export that differs from what export_again writes in every texture's file, and has a file more. */
static void put_earlier(const trial *t) {
  char path[2 * MOST_NAME];
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  btf_gpu_export *e;
  target.layout = t->layout;
  assert_ok(btf_gpu_export_create(t->model, &target, &e));
  assert_ok(btf_gpu_export_write(e, t->folder, 0));
  btf_gpu_export_release(e);
  snprintf(path, sizeof path, "%s/notes.txt", t->folder);
  test_write_bytes(path, notes, sizeof notes);
}

/* Runs until nothing is left to fail, and returns how often something did. */
static long fail_each(const trial *t, bool allocations, bool persistent) {
  const long live = t->memory->live_blocks;
  const uint64_t earlier = t->has_earlier ? folder_hash(t->folder) : 0;
  long n = 1;
  for (; n < MOST_FAULTS; n += persistent ? 4 : 1) {
    t->memory->total_allocations = 0;
    t->memory->fail_at = allocations ? n : 0;
    t->memory->persistent = persistent;
    system_calls = 0;
    failing_system_call = allocations ? 0 : n;
    btfi_io_fault = fail_system_call;
    const btf_status status = export_again(t);
    btfi_io_fault = NULL;
    t->memory->fail_at = 0;
    assert_int_equal(t->memory->live_blocks, live);
    if (status == BTF_OK) break;
    assert_status(status, allocations ? BTF_E_NOMEM : BTF_E_IO);
    assert_true(strlen(btf_error_message()) > 0 && strchr(btf_error_message(), '\n') == NULL);
    assert_int_equal(test_count_entries(test_folder()), t->has_earlier ? 1 : 0);
    if (t->has_earlier) assert_true(folder_hash(t->folder) == earlier);
  }
  assert_true(n < MOST_FAULTS);
  assert_int_equal(test_count_entries(test_folder()), 1);
  assert_true(folder_hash(t->folder) != earlier);
  return n - 1;
}

/* What is written at last must be what is written into no place at all, with the other's file beside. */
static void expect_complete(const trial *t) {
  char path[2 * MOST_NAME];
  snprintf(path, sizeof path, "%s/notes.txt", t->folder);
  if (t->has_earlier) {
    assert_true(test_exists(path));
    assert_int_equal(remove(path), 0);
  }
  const uint64_t written = folder_hash(t->folder);
  remove_files(t->folder);
  assert_ok(export_again(t));
  assert_true(folder_hash(t->folder) == written);
}

static void check_layout(trial *t, const codec_case *row) {
  static const struct {
    bool allocations, persistent;
    long least;
  } kinds[] = {{true, false, 20}, {true, true, 20}, {false, false, 12}};
  for (size_t k = 0; k < sizeof kinds / sizeof *kinds; k++)
    for (int earlier = 0; earlier <= 1; earlier++) {
      if (kinds[k].persistent && !earlier) continue; /* differs in cleaning up only */
      t->has_earlier = earlier != 0;
      if (t->has_earlier) put_earlier(t);
      const long failed = fail_each(t, kinds[k].allocations, kinds[k].persistent);
      print_message("%s, %s: %ld %s%s failed%s\n", row->codec, t->layout, failed,
                    kinds[k].allocations ? "allocations" : "system calls",
                    kinds[k].persistent ? " and all after them" : "", t->has_earlier ? ", replacing" : "");
      assert_true(failed >= kinds[k].least);
      expect_complete(t);
      remove_files(t->folder);
    }
}

static const char *only; /* this codec, or NULL for all */

static void exports(void **state) {
  const btf_codec *codec;
  const char *last = ""; /* rows of a codec follow each other; one is enough */
  int layouts = 0;
  (void)state;
  for (size_t r = 0; r < codec_case_count; r++) {
    const codec_case *row = &codec_cases[r];
    const codec_dataset_recipe recipe = {.material = MATERIAL_TINY, .channels = codec_case_channels(row, 1)};
    test_memory memory;
    btf_context *ctx;
    btf_model *model;
    if (!row->faults || strcmp(row->codec, last) == 0) continue;
    if (only != NULL && strcmp(row->codec, only) != 0) continue;
    last = row->codec;
    ctx = test_context_with(&memory, NULL, 1);
    codec = btf_codec_find(ctx, row->codec);
    if (codec != NULL && btf_codec_gpu_layout(codec, 0, NULL) != NULL) {
      trial t = {.memory = &memory, .folder = test_path("export")};
      assert_ok(codec_case_fit(ctx, row, &recipe, NULL, NULL, &model));
      t.model = model;
      for (uint32_t i = 0; (t.layout = btf_codec_gpu_layout(codec, i, NULL)) != NULL; i++, layouts++)
        check_layout(&t, row);
      btf_model_release(model);
    }
    test_context_done(ctx, &memory);
  }
  if (layouts == 0) skip();
}

/* The errors that btf_gpu.h lists for what a caller gets wrong. */
static void expect_refusals(const btf_model *model, const char *layout) {
  btf_gpu_target target = BTF_GPU_TARGET_INIT;
  btf_gpu_texture texture = BTF_GPU_TEXTURE_INIT;
  btf_gpu_cost cost = BTF_GPU_COST_INIT;
  const char *path = test_path("refused");
  const int32_t levels[] = {-1, 23};
  btf_gpu_export *e;
  void *data = &e;
  size_t size = 1;
  assert_status(btf_gpu_export_create(NULL, NULL, &e), BTF_E_INVALID_ARG);
  assert_null(e);
  assert_status(btf_gpu_export_create(model, NULL, NULL), BTF_E_INVALID_ARG);
  target.layout = "nonesuch";
  assert_status(btf_gpu_export_create(model, &target, &e), BTF_E_INVALID_ARG);
  target.layout = layout;
  target.reserved = 1;
  assert_status(btf_gpu_export_create(model, &target, &e), BTF_E_INVALID_ARG);
  target.struct_size = 1;
  assert_status(btf_gpu_export_create(model, &target, &e), BTF_E_ABI);
  assert_ok(btf_gpu_export_create(model, NULL, &e));
  const uint32_t count = btf_gpu_texture_count(e);
  assert_status(btf_gpu_texture_at(e, count, &texture), BTF_E_INVALID_ARG);
  assert_status(btf_gpu_texture_at(e, 0, NULL), BTF_E_INVALID_ARG);
  texture.struct_size = 1;
  assert_status(btf_gpu_texture_at(e, 0, &texture), BTF_E_ABI);
  assert_status(btf_gpu_export_cost(e, NULL), BTF_E_INVALID_ARG);
  cost.struct_size = 1;
  assert_status(btf_gpu_export_cost(e, &cost), BTF_E_ABI);
  assert_status(btf_gpu_texture_ktx2(e, count, 0, &data, &size), BTF_E_INVALID_ARG);
  assert_true(data == NULL && size == 0);
  assert_status(btf_gpu_export_write(NULL, path, 0), BTF_E_INVALID_ARG);
  assert_status(btf_gpu_export_write(e, NULL, 0), BTF_E_INVALID_ARG);
  for (size_t i = 0; i < sizeof levels / sizeof *levels; i++) {
    assert_status(btf_gpu_texture_ktx2(e, 0, levels[i], &data, &size), BTF_E_INVALID_ARG);
    assert_status(btf_gpu_export_write(e, path, levels[i]), BTF_E_INVALID_ARG);
  }
  assert_false(test_exists(path));
  test_write_bytes(path, notes, sizeof notes);
  assert_status(btf_gpu_export_write(e, path, 0), BTF_E_IO);
  assert_int_equal(remove(path), 0);
  btf_gpu_export_release(e);
}

static void refusals(void **state) {
  const codec_case *row = codec_cases;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  const btf_codec *codec = NULL;
  btf_model *model;
  (void)state;
  for (; row < codec_cases + codec_case_count; row++) {
    codec = row->faults ? btf_codec_find(ctx, row->codec) : NULL;
    if (codec != NULL && btf_codec_gpu_layout(codec, 0, NULL) != NULL) break;
  }
  if (row < codec_cases + codec_case_count) {
    const codec_dataset_recipe recipe = {.material = MATERIAL_TINY, .channels = codec_case_channels(row, 1)};
    assert_ok(codec_case_fit(ctx, row, &recipe, NULL, NULL, &model));
    expect_refusals(model, btf_codec_gpu_layout(codec, 0, NULL));
    btf_model_release(model);
  }
  test_context_done(ctx, &memory);
  if (row == codec_cases + codec_case_count) skip();
}

int main(int argc, char **argv) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(exports), cmocka_unit_test(refusals)};
  only = argc > 1 ? argv[1] : NULL;
  return btf_run("gpu_faults", tests);
}
