/* SPDX-License-Identifier: MIT */
/* Memory budgets of reading: pages of a mapping, pieces of a source, statistics and decompositions. */
#include "dataset_cube.h"

#include <pthread.h>
#include <unistd.h>

#include "dataset/dataset.h"
#include "registry/registry.h"

#include <btf/btf_plugin.h>

/* ---- pages of a mapping ---- */

/* Bytes of mapped files that are resident in this process; 0 where the system does not tell. */
static uint64_t mapped_bytes(void) {
  char line[256];
  unsigned long long kib = 0;
  FILE *file = fopen("/proc/self/status", "r");
  if (file == NULL) return 0;
  while (fgets(line, sizeof line, file) != NULL)
    if (sscanf(line, "RssFile: %llu kB", &kib) == 1) break;
  fclose(file);
  return kib * 1024;
}

typedef struct page_watch {
  const btf_dataset *bounded;
  const test_cube *cube;
  uint64_t base, most;
  float *got;
} page_watch;

static void read_watched(page_watch *w, uint32_t view0, uint32_t views, uint32_t light0, uint32_t lights,
                         uint32_t x, uint32_t y, uint32_t width, uint32_t height) {
  const test_cube *cube = w->cube;
  const btf_block b = {view0, views, light0, lights, x, y, width, height};
  const ptrdiff_t channel = sizeof(float), across = channel * (ptrdiff_t)cube->channels,
                  down = across * (ptrdiff_t)width, light = down * (ptrdiff_t)height;
  const btf_strides s = {light * (ptrdiff_t)lights, light, down, across, channel};
  assert_ok(btf_dataset_read(w->bounded, &b, w->got, &s));
  const uint64_t now = mapped_bytes();
  if (now > w->base && now - w->base > w->most) w->most = now - w->base;
  const uint32_t at[5] = {views - 1, lights / 2, height / 3, width - 1, cube->channels - 1};
  const size_t place =
      ((((size_t)at[0] * lights + at[1]) * height + at[2]) * width + at[3]) * cube->channels + at[4];
  assert_true(w->got[0] == test_cube_value(cube, view0, light0, y, x, 0));
  assert_true(w->got[place] ==
              test_cube_value(cube, view0 + at[0], light0 + at[1], y + at[2], x + at[3], at[4]));
}

static void check_pages(btf_context *ctx, const test_cube *cube, uint32_t order, const char *folder) {
  const uint64_t size = (uint64_t)cube->count * cube->size, budget = size / 4;
  btf_dataset *whole = test_cube_dataset(ctx, cube, order, TEST_MAPPED, folder), *reader;
  page_watch w = {.cube = cube, .got = malloc((size_t)cube->count * sizeof(float))};
  assert_non_null(w.got);
  assert_ok(btfi_dataset_within(whole, budget, &reader));
  w.bounded = reader;
  w.base = mapped_bytes();
  /* Image by image, all at once, lines of texels, a block of texels within lines, texel by texel. Where data
   * lie by texels an image is a call for each, which touches one page of three: 1 in 16 touch them all. */
  const uint32_t images = cube->views * cube->lights, step = order == BTF_ORDER_VLYXC ? 1 : 16;
  for (uint32_t i = 0; i < images; i += step)
    read_watched(&w, i / cube->lights, 1, i % cube->lights, 1, 0, 0, cube->width, cube->height);
  read_watched(&w, 0, cube->views, 0, cube->lights, 0, 0, cube->width, cube->height);
  for (uint32_t y = 0; y < cube->height; y += 8)
    read_watched(&w, 0, cube->views, 0, cube->lights, 0, y, cube->width, 8);
  for (uint32_t y = 0; y + 2 <= cube->height; y += 9)
    read_watched(&w, 0, cube->views, 0, cube->lights, 5, y, 20, 2);
  for (uint32_t i = 0; i < 40; i++)
    read_watched(&w, 0, cube->views, 0, cube->lights, i * 37 % cube->width, i * 11 % cube->height, 1, 1);
  assert_true(w.most <= budget);
  btf_dataset_release(reader);
  /* Without a bound they all stay, so the figure would show it. */
  w.bounded = whole;
  w.most = 0;
  read_watched(&w, 0, cube->views, 0, cube->lights, 0, 0, cube->width, cube->height);
  assert_true(w.most > size - size / 8);
  btf_dataset_release(whole);
  free(w.got);
}

static void pages_stay_within_the_budget(void **state) {
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 2);
  test_cube cube;
  (void)state;
  if (mapped_bytes() == 0) skip();
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 42, 40, 80, 80, 3, 5); /* 62 MiB */
  check_pages(ctx, &cube, BTF_ORDER_VLYXC, test_path("by_image"));
  check_pages(ctx, &cube, BTF_ORDER_YXVLC, test_path("by_texel"));
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

static void shortened_files_are_told(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  test_cube cube;
  char path[4096];
  float values[3 * 12 * 10];
  (void)state;
  test_cube_make(ctx, &cube, BTF_SAMPLE_F16, 12, 10, 40, 40, 3, 5);
  btf_dataset *whole = test_cube_dataset(ctx, &cube, BTF_ORDER_VLYXC, TEST_MAPPED, test_path("short")),
              *reader;
  assert_ok(btfi_dataset_within(whole, 1 << 16, &reader));
  assert_ok(btf_dataset_read_abrdf(reader, 39, 39, 1, values));
  snprintf(path, sizeof path, "%s/samples.bin", test_path("short"));
  assert_int_equal(truncate(path, 100000), 0);
  assert_status(btf_dataset_read_abrdf(reader, 39, 39, 1, values), BTF_E_TRUNCATED);
  assert_message_has("the file has become shorter");
  btf_dataset_release(whole); /* the reader keeps what it needs */
  assert_status(btf_dataset_read_abrdf(reader, 39, 39, 1, values), BTF_E_TRUNCATED);
  btf_dataset_release(reader);
  test_cube_free(&cube);
  test_context_done(ctx, &memory);
}

/* ---- two fits of one data set ---- */

enum { SIDE = 512, PAIRS = 4 };

typedef struct one_fit {
  const btf_dataset *ds;
  const btf_codec *codec;
  uint64_t budget, largest; /* bytes of a piece */
  btf_status status;
} one_fit;

static _Thread_local one_fit *fit_of_thread;
static pthread_barrier_t both;

static btf_status fill_piece(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  const uint64_t bytes = sizeof(float) * b->views * b->lights * b->width * b->height;
  (void)user;
  (void)s;
  if (bytes > fit_of_thread->largest) fit_of_thread->largest = bytes;
  memset(dst, 0, (size_t)bytes);
  return BTF_OK;
}

static btf_status read_and_refuse(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                                  const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  const btf_block all = {0, PAIRS, 0, 1, 0, 0, SIDE, SIDE};
  const btf_strides s = {4 * SIDE * SIDE, 4 * SIDE * SIDE, 4 * SIDE, 4, 4};
  float *values = malloc(sizeof *values * SIDE * SIDE * PAIRS);
  (void)options, (void)job, (void)payload;
  if (values == NULL) return (host->fail)(ctx, BTF_E_NOMEM, "no room for the test");
  pthread_barrier_wait(&both); /* both fits have told their budgets */
  const btf_status status = host->dataset_read(ds, &all, values, &s);
  free(values);
  return status == BTF_OK ? (host->fail)(ctx, BTF_E_CANCELLED, "that was all") : status;
}

static btf_status load_nothing(const btf_host *host, btf_context *ctx, uint32_t format,
                               const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  (void)format, (void)shape, (void)payload;
  *state = NULL;
  return (host->fail)(ctx, BTF_E_UNSUPPORTED, "nothing to load");
}
static void destroy_nothing(const btf_host *host, btf_context *ctx, void *state) {
  (void)host, (void)ctx, (void)state;
}
static uint32_t one_level(const void *state) {
  (void)state;
  return 1;
}
static uint64_t no_bytes(const void *state) {
  (void)state;
  return 0;
}
static void eval_nothing(const void *state, const btf_query *query, float *out) {
  (void)state, (void)query;
  out[0] = 0;
}
static void texel_nothing(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                          uint32_t view, float *out) {
  (void)state, (void)level, (void)x, (void)y, (void)light, (void)view;
  out[0] = 0;
}

static const btf_codec_vtbl reading_codec = {
    .struct_size = sizeof(btf_codec_vtbl),
    .abi = LIBBTF_ABI,
    .id = "org.libbtf.reading",
    .title = "reads and keeps nothing",
    .version = "1",
    .caps = BTF_CAP_FIT | BTF_CAP_STREAM_FIT,
    .format_read_min = 1,
    .format_write = 1,
    .fit = read_and_refuse,
    .load = load_nothing,
    .destroy = destroy_nothing,
    .levels = one_level,
    .resident_bytes = no_bytes,
    .eval = eval_nothing,
    .texel = texel_nothing,
};

static void *fit_in_thread(void *user) {
  one_fit *fit = user;
  btf_job job = BTF_JOB_INIT;
  btf_model *model;
  job.max_working_set = fit->budget;
  fit_of_thread = fit;
  fit->status = btf_model_fit(fit->ds, fit->codec, NULL, &job, &model);
  return NULL;
}

static void fits_keep_to_their_own_budgets(void **state) {
  /* A piece is a 32nd of the budget, and 1 MiB at most. */
  static const uint64_t budgets[][2] = {{2 << 20, 32 << 20}, {32 << 20, 2 << 20}, {4 << 20, 0}};
  (void)state;
  for (size_t k = 0; k < sizeof budgets / sizeof *budgets; k++) {
    test_memory memory;
    btf_context *ctx = test_context_with(&memory, NULL, 1);
    btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
    btf_dirset *views = test_spiral(ctx, PAIRS, 0), *lights = test_spiral(ctx, 1, 0);
    btf_dataset *ds;
    pthread_t threads[2];
    one_fit fits[2];
    desc.views = views;
    desc.lights = lights;
    desc.width = desc.height = SIDE;
    desc.channels = 1;
    desc.sample_type = BTF_SAMPLE_F32;
    desc.flags = BTF_DATASET_IMAGE_MAJOR;
    desc.read = fill_piece;
    assert_ok(btf_dataset_create(ctx, &desc, &ds));
    assert_ok(btf_context_register(ctx, &reading_codec));
    assert_int_equal(pthread_barrier_init(&both, NULL, 2), 0);
    for (int i = 0; i < 2; i++) {
      fits[i] = (one_fit){ds, btf_codec_find(ctx, reading_codec.id), budgets[k][i], 0, BTF_OK};
      assert_int_equal(pthread_create(&threads[i], NULL, fit_in_thread, &fits[i]), 0);
    }
    for (int i = 0; i < 2; i++) {
      const uint64_t most = 1 << 20, share = budgets[k][i] / 32;
      pthread_join(threads[i], NULL);
      assert_int_equal(fits[i].status, BTF_E_CANCELLED);
      assert_int_equal(fits[i].largest, share != 0 && share < most ? share : most);
    }
    pthread_barrier_destroy(&both);
    btf_dataset_release(ds);
    btf_dirset_release(views);
    btf_dirset_release(lights);
    test_context_done(ctx, &memory);
  }
}

/* ---- statistics and decompositions ---- */

enum { RANK = 3 };

/* Of RANK components, so that any decomposition finds all of it. */
static float *few_components(uint32_t pairs, uint32_t texels, bool by_image) {
  float *values = malloc(sizeof *values * pairs * texels);
  assert_non_null(values);
  for (uint32_t p = 0; p < pairs; p++)
    for (uint32_t t = 0; t < texels; t++) {
      double sum = 3;
      for (int k = 1; k < RANK; k++) sum += cos(0.37 * k * (p + 1.0)) * sin(0.011 * k * k * (t + 2.0));
      values[by_image ? (size_t)p * texels + t : (size_t)t * pairs + p] = (float)sum;
    }
  return values;
}

static btf_status give_values(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  const btf_dataset *resident = user;
  return btf_dataset_read(resident, b, dst, s);
}

static btf_dataset *shape_dataset(btf_context *ctx, const float *values, uint32_t views, uint32_t lights,
                                  uint32_t width, uint32_t height, bool by_image) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_dirset *view_set = test_spiral(ctx, views, 0), *light_set = test_spiral(ctx, lights, 0);
  btf_dataset *ds;
  const ptrdiff_t pairs = (ptrdiff_t)views * lights, texels = (ptrdiff_t)width * height;
  const ptrdiff_t pair = by_image ? 4 * texels : 4, texel = by_image ? 4 : 4 * pairs;
  desc.views = view_set;
  desc.lights = light_set;
  desc.width = width;
  desc.height = height;
  desc.channels = 1;
  desc.sample_type = BTF_SAMPLE_F32;
  desc.data = values;
  desc.strides = (btf_strides){pair * lights, pair, texel * width, texel, 4};
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  btf_dirset_release(view_set);
  btf_dirset_release(light_set);
  return ds;
}

static btf_dataset *streamed(btf_context *ctx, btf_dataset *resident) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_dataset *ds;
  assert_ok(btf_dataset_describe(resident, &desc));
  desc.data = NULL;
  desc.flags &= BTF_DATASET_IMAGE_MAJOR;
  desc.read = give_values;
  desc.user = resident;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  return ds;
}

static btf_status decompose(btf_context *ctx, const btf_dataset *ds, uint64_t budget, btf_svd_result *out) {
  const btf_svd_desc desc = {
      .struct_size = sizeof desc, .rank = RANK, .max_working_set = budget, .seed = 1, .tolerance = 0.0005};
  *out = (btf_svd_result){.struct_size = sizeof *out};
  return btfi_host()->svd_dataset(ctx, ds, NULL, &desc, NULL, 0, 1, out);
}

/* One of the two ways needs panels of the long side: three of 16 columns. */
static void check_least(btf_context *ctx, const btf_dataset *ds, uint64_t longer) {
  btf_svd_result all, r;
  if (decompose(ctx, ds, 0, &all) == BTF_E_UNSUPPORTED) skip();
  assert_int_equal(all.rank, RANK);
  assert_status(decompose(ctx, ds, 1, &r), BTF_E_LIMIT);
  const uint64_t least = r.least_working_set;
  char named[64];
  snprintf(named, sizeof named, "at least %llu bytes", (unsigned long long)least);
  assert_message_has(named);
  assert_true(least < longer * 3 * 16 * sizeof(float));
  assert_status(decompose(ctx, ds, least - 1, &r), BTF_E_LIMIT);
  const uint64_t budgets[] = {least, least + least / 2, 3 * least};
  for (size_t k = 0; k < 3; k++) {
    assert_ok(decompose(ctx, ds, budgets[k], &r));
    assert_int_equal(r.rank, RANK);
    /* Nothing is left of the matrix beside RANK components; float panels give their values to 1e-5 or so. */
    for (int i = 0; i < RANK; i++) assert_relative(r.sigma[i], all.sigma[i], 1e-4);
    btfi_host()->svd_free(ctx, &r);
  }
  btfi_host()->svd_free(ctx, &all);
}

/* A source gives the same bytes as samples that are mapped, whatever is held. */
static void check_alike(btf_context *ctx, const btf_dataset *a, const btf_dataset *b, uint64_t pairs,
                        uint64_t texels) {
  for (uint64_t budget = (uint64_t)1 << 17; budget <= (uint64_t)1 << 23; budget *= 2) {
    btf_svd_result r[2];
    const btf_status status = decompose(ctx, a, budget, &r[0]);
    assert_status(decompose(ctx, b, budget, &r[1]), status);
    if (status != BTF_OK) continue;
    assert_memory_equal(r[0].sigma, r[1].sigma, RANK * sizeof *r[0].sigma);
    assert_memory_equal(r[0].item_vectors, r[1].item_vectors, texels * RANK * sizeof(float));
    assert_memory_equal(r[0].element_vectors, r[1].element_vectors, pairs * RANK * sizeof(float));
    for (int i = 0; i < 2; i++) btfi_host()->svd_free(ctx, &r[i]);
  }
}

typedef struct error_count {
  int errors, refusals;
} error_count;

static void count_errors(void *user, int32_t level, btf_status code, const char *message) {
  error_count *count = user;
  (void)message;
  if (level != BTF_LOG_ERROR && level != BTF_LOG_WARNING) return;
  count->errors++;
  count->refusals += code == BTF_E_LIMIT;
}

/* By images and by texels need panels of the one side and of the other: under the lesser of the two budgets,
 * the way that is tried first is refused for one of these shapes and orders at least, and succeeds the other
 * way. */
static void only_a_refusal_of_both_ways_is_logged(void **state) {
  (void)state;
  for (int by_image = 0; by_image < 2; by_image++) {
    float *values = few_components(16, 192 * 128, by_image);
    error_count count = {0};
    btf_context_desc settings = BTF_CONTEXT_DESC_INIT;
    btf_context *ctx = NULL;
    settings.log = count_errors;
    settings.log_user = &count;
    assert_ok(btf_context_create(&settings, &ctx));
    btf_dataset *ds = shape_dataset(ctx, values, 4, 4, 192, 128, by_image);
    btf_svd_result r;
    const btf_status status = decompose(ctx, ds, 1, &r);
    if (status == BTF_E_UNSUPPORTED) skip();
    assert_int_equal(status, BTF_E_LIMIT);
    assert_int_equal(count.errors, 1);
    assert_int_equal(count.refusals, 1);
    const uint64_t least = r.least_working_set;
    assert_status(decompose(ctx, ds, least - 1, &r), BTF_E_LIMIT);
    assert_int_equal(count.errors, 2);
    assert_ok(decompose(ctx, ds, least, &r));
    assert_int_equal(count.errors, 2);
    btfi_host()->svd_free(ctx, &r);
    btf_dataset_release(ds);
    btf_context_release(ctx);
    free(values);
  }
}

static void decompositions_take_the_way_that_fits(void **state) {
  static const struct {
    uint32_t views, lights, width, height;
  } shapes[] = {{4, 4, 192, 128}, {96, 96, 6, 5}};
  (void)state;
  for (size_t k = 0; k < 2; k++)
    for (int by_image = 0; by_image < 2; by_image++) {
      const uint32_t pairs = shapes[k].views * shapes[k].lights, texels = shapes[k].width * shapes[k].height;
      test_memory memory;
      btf_context *ctx = test_context_with(&memory, NULL, 2);
      float *values = few_components(pairs, texels, by_image);
      btf_dataset *ds = shape_dataset(ctx, values, shapes[k].views, shapes[k].lights, shapes[k].width,
                                      shapes[k].height, by_image);
      btf_dataset *stream = streamed(ctx, ds);
      check_least(ctx, ds, pairs > texels ? pairs : texels);
      check_least(ctx, stream, pairs > texels ? pairs : texels);
      check_alike(ctx, ds, stream, pairs, texels);
      btf_dataset_release(stream);
      btf_dataset_release(ds);
      free(values);
      test_context_done(ctx, &memory);
    }
}

static void statistics_keep_the_budget(void **state) {
  enum { BUDGET = 8 << 20 };
  (void)state;
  for (int by_image = 0; by_image < 2; by_image++) {
    float *values = few_components(64, 128 * 128, by_image), means[2][64];
    btf_statistics all[2];
    for (int small = 0; small < 2; small++) {
      test_memory memory;
      btf_context *ctx = test_context_with(&memory, NULL, 16);
      btf_dataset *ds = shape_dataset(ctx, values, 8, 8, 128, 128, by_image);
      uint64_t before, peak;
      btf_context_memory(ctx, &before, NULL);
      all[small] = (btf_statistics){.struct_size = sizeof all[small]};
      assert_ok(btfi_host()->measure(ctx, ds, small ? BUDGET : 0, means[small], &all[small], NULL, 0, 1));
      btf_context_memory(ctx, NULL, &peak);
      if (small) assert_true(peak - before <= BUDGET);
      btf_dataset_release(ds);
      test_context_done(ctx, &memory);
    }
    /* The same 2^20 values in another order of double sums: at most 2^20 roundings of 2^-53. */
    assert_relative(all[1].energy, all[0].energy, 1.2e-10);
    assert_true(all[1].peak == all[0].peak);
    for (int i = 0; i < 64; i++) assert_relative(means[1][i], means[0][i], 1.3e-7);
    free(values);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(pages_stay_within_the_budget),
      cmocka_unit_test(shortened_files_are_told),
      cmocka_unit_test(fits_keep_to_their_own_budgets),
      cmocka_unit_test(decompositions_take_the_way_that_fits),
      cmocka_unit_test(only_a_refusal_of_both_ways_is_logged),
      cmocka_unit_test(statistics_keep_the_budget),
  };
  return btf_run("bounds", tests);
}
