/* SPDX-License-Identifier: MIT */
/*
 * Eight threads load, evaluate, describe and retain one model of every kind at once, each with its own
 * queries, and get the bits that one thread gets; evaluation allocates and locks nothing, by the context nor
 * behind its back: the C library's functions for it are wrapped. Meant for ThreadSanitizer, and true without
 * it.
 */
#include "btf_test.h"

#include <pthread.h>

#include <stdatomic.h>

#include "codec_cases.h"
#include "copy_codec.h"

enum { CHANNELS = 4, THREADS = 8, QUERIES = 400 };

/* ---- what evaluation must not call ---- */

static _Thread_local int evaluating; /* this thread is inside btf_model_eval or its kin */
static atomic_long taken;            /* calls from there */

#define WRAP(result, name, parameters, arguments)                                                            \
  result __real_##name parameters;                                                                           \
  result __wrap_##name parameters;                                                                           \
  result __wrap_##name parameters {                                                                          \
    if (evaluating) atomic_fetch_add(&taken, 1);                                                             \
    return __real_##name arguments;                                                                          \
  }
WRAP(void *, malloc, (size_t size), (size))
WRAP(void *, calloc, (size_t count, size_t size), (count, size))
WRAP(void *, realloc, (void *block, size_t size), (block, size))
WRAP(void *, aligned_alloc, (size_t align, size_t size), (align, size))
WRAP(int, posix_memalign, (void **block, size_t align, size_t size), (block, align, size))
WRAP(int, pthread_mutex_lock, (pthread_mutex_t * mutex), (mutex))

/* The model of a row, or for NULL the data set as it stands. */
static btf_model *make_model(btf_context *ctx, const codec_case *row) {
  const codec_dataset_recipe recipe = {
      MATERIAL_SMOOTH, row != NULL ? codec_case_channels(row, 3) : 3, SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  btf_dataset *dataset;
  btf_model *model;
  if (row != NULL) {
    assert_ok(codec_case_fit(ctx, row, &recipe, NULL, NULL, &model));
    return model;
  }
  assert_ok(codec_material_dataset(ctx, &recipe, &dataset));
  assert_ok(btf_model_from_dataset(dataset, NULL, &model));
  btf_dataset_release(dataset);
  return model;
}

typedef struct evaluation {
  btf_model *model;
  const btf_file *file; /* where to load it from first, or NULL */
  btf_status status;
  float single[QUERIES][CHANNELS], batch[CHANNELS][QUERIES];
  uint32_t first;
} evaluation;

static btf_query query_number(uint32_t i) {
  const float a = 0.61f * (float)i, b = 1.17f * (float)i, r = 0.9f * fabsf(sinf(0.13f * (float)i));
  const float s = 0.9f * fabsf(cosf(0.29f * (float)i));
  const btf_query q = {{r * cosf(a), r * sinf(a), sqrtf(1.0f - r * r)},
                       {s * cosf(b), s * sinf(b), sqrtf(1.0f - s * s)},
                       {0.07f * (float)i, -0.11f * (float)i},
                       0.01f * (float)(i % 500),
                       0};
  return q;
}

static void *evaluate(void *user) {
  evaluation *e = user;
  static const size_t count = QUERIES;
  float(*columns)[QUERIES] = malloc(9 * sizeof *columns);
  float *out[CHANNELS] = {e->batch[0], e->batch[1], e->batch[2], e->batch[3]};
  btf_batch batch = BTF_BATCH_INIT;
  btf_model_info info = BTF_MODEL_INFO_INIT;
  btf_model *mine = NULL;
  if (e->file != NULL)
    e->status = btf_file_load_model(e->file, 0, &mine);
  else
    mine = btf_model_retain(e->model);
  if (mine == NULL) {
    free(columns);
    return NULL;
  }
  btf_model_describe(mine, &info);
  for (uint32_t i = 0; i < count; i++) {
    const btf_query q = query_number(e->first + i);
    evaluating = 1;
    btf_model_eval(mine, &q, e->single[i]);
    evaluating = 0;
    for (int k = 0; k < 3; k++) {
      columns[k][i] = q.light[k];
      columns[3 + k][i] = q.view[k];
    }
    columns[6][i] = q.uv[0];
    columns[7][i] = q.uv[1];
    columns[8][i] = q.lod;
  }
  batch.count = count;
  for (int k = 0; k < 3; k++) {
    batch.light[k] = columns[k];
    batch.view[k] = columns[3 + k];
  }
  batch.uv[0] = columns[6];
  batch.uv[1] = columns[7];
  batch.lod = columns[8];
  evaluating = 1;
  btf_model_eval_n(mine, &batch, BTF_VALUE_BRDF, out);
  evaluating = 0;
  btf_model_release(mine);
  free(columns);
  return NULL;
}

static evaluation work[THREADS], alone;

static void run_threads(btf_model *model, const btf_file *file) {
  pthread_t threads[THREADS];
  memset(work, 0, sizeof work);
  memset(&alone, 0, sizeof alone);
  for (uint32_t t = 0; t < THREADS; t++) {
    work[t].model = model;
    work[t].file = file;
    work[t].first = 1000 * t;
    assert_int_equal(pthread_create(&threads[t], NULL, evaluate, &work[t]), 0);
  }
  for (uint32_t t = 0; t < THREADS; t++) pthread_join(threads[t], NULL);
  for (uint32_t t = 0; t < THREADS; t++) {
    assert_ok(work[t].status);
    alone.model = model;
    alone.first = 1000 * t;
    evaluate(&alone);
    assert_memory_equal(work[t].single, alone.single, sizeof alone.single);
    assert_memory_equal(work[t].batch, alone.batch, sizeof alone.batch);
    for (uint32_t i = 0; i < QUERIES; i++)
      for (int c = 0; c < CHANNELS; c++)
        assert_memory_equal(&alone.single[i][c], &alone.batch[c][i], sizeof(float));
  }
}

static void check_model(btf_context *ctx, test_memory *memory, const codec_case *row) {
  btf_model *model = make_model(ctx, row);
  const long before = memory->total_allocations;
  btf_file *file;
  run_threads(model, NULL);
  assert_int_equal(memory->total_allocations, before);
  assert_int_equal(atomic_load(&taken), 0);
  if (row != NULL) {
    assert_ok(btf_model_save(model, test_path("threads.btfz"), 0, NULL, NULL));
    assert_ok(btf_file_open_path(ctx, test_path("threads.btfz"), 0, &file));
    run_threads(model, file);
    btf_file_close(file);
    assert_int_equal(atomic_load(&taken), 0);
  }
  btf_model_release(model);
}

static void eight_threads(void **state) {
  (void)state;
  for (size_t i = 0; i <= codec_case_count; i++) {
    const codec_case *row = i < codec_case_count ? &codec_cases[i] : NULL;
    test_memory memory = {0};
    btf_context *ctx = test_context(&memory);
    const btf_codec *codec = row != NULL ? btf_codec_find(ctx, row->codec) : NULL;
    if (row == NULL || (codec != NULL && (btf_codec_caps(codec) & BTF_CAP_FIT) != 0))
      check_model(ctx, &memory, row);
    test_context_done(ctx, &memory);
  }
}

/* ---- codecs that break the rule are noticed ---- */

static int way_taken;
static pthread_mutex_t a_lock = PTHREAD_MUTEX_INITIALIZER;

static void eval_that_takes(const void *state, const btf_query *query, float *out) {
  void *volatile block = NULL; /* volatile, so that no compiler takes the pair out */
  void *aligned = NULL;
  if (way_taken == 0) block = malloc(24);
  if (way_taken == 1) block = calloc(3, 8);
  if (way_taken == 2) block = realloc(block, 24);
  if (way_taken == 3) block = aligned_alloc(64, 64);
  if (way_taken == 4 && posix_memalign(&aligned, 64, 64) == 0) block = aligned;
  if (way_taken == 5 && pthread_mutex_lock(&a_lock) == 0) pthread_mutex_unlock(&a_lock);
  free(block);
  copy_codec.eval(state, query, out);
}

static void what_evaluation_takes_is_counted(void **state) {
  (void)state;
  for (way_taken = 0; way_taken < 7; way_taken++) {
    test_memory memory;
    btf_context *ctx = test_context(&memory);
    btf_codec_vtbl codec = copy_codec_single;
    btf_dataset *dataset = copy_codec_dataset(ctx, 3, 2, 1, BTF_QUANTITY_BRDF);
    static evaluation e;
    codec.id = "org.libbtf.takes";
    codec.eval = eval_that_takes;
    memset(&e, 0, sizeof e);
    assert_ok(btf_context_register(ctx, &codec));
    assert_ok(btf_model_fit(dataset, btf_codec_find(ctx, codec.id), NULL, NULL, &e.model));
    evaluate(&e);
    /* Once for each query alone and once in the batch; those below the horizon do not reach the codec. */
    if (way_taken < 6)
      assert_true(atomic_load(&taken) >= QUERIES);
    else
      assert_int_equal(atomic_load(&taken), 0);
    atomic_store(&taken, 0);
    btf_model_release(e.model);
    btf_dataset_release(dataset);
    test_context_done(ctx, &memory);
  }
}

/* Contexts, direction sets and data sets of one context made and dropped by several threads. */
static void *make_and_drop(void *user) {
  btf_context *ctx = user;
  for (int i = 0; i < 20; i++) {
    btf_dirset *directions;
    if (btf_dirset_create_named(ctx, i % 2 ? "ubo81" : "grid:6x3", &directions) != BTF_OK) return user;
    btf_dirset_release(directions);
    if (btf_dirset_create_named(ctx, "nonsense", &directions) == BTF_OK) return user;
    if (strstr(btf_error_message(), "nonsense") == NULL) return user;
  }
  return NULL;
}

static void objects_of_one_context(void **state) {
  test_memory memory = {0};
  btf_context *ctx = test_context(&memory);
  pthread_t threads[THREADS];
  (void)state;
  for (int t = 0; t < THREADS; t++)
    assert_int_equal(pthread_create(&threads[t], NULL, make_and_drop, ctx), 0);
  for (int t = 0; t < THREADS; t++) {
    void *failed;
    pthread_join(threads[t], &failed);
    assert_null(failed);
  }
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(what_evaluation_takes_is_counted),
      cmocka_unit_test(eight_threads),
      cmocka_unit_test(objects_of_one_context),
  };
  return btf_run("concurrency", tests);
}
