/* SPDX-License-Identifier: MIT */
/* ABRDFs level by level against filtering the whole texture at once. */
#include "btf_test.h"

#include <pthread.h>
#include <stdatomic.h>
#include <time.h>

#include "registry/registry.h"

#include <btf/btf_sampling.h>

enum { CHANNELS = 2, LIGHTS = 6, VIEWS = 5, LENGTH = VIEWS * LIGHTS * CHANNELS, MOST_TEXELS = 40 * 40 };

/* ---- the data ---- */

typedef struct source {
  uint32_t width;
  pthread_mutex_t mutex;
  uint64_t texels_read; /* times LENGTH */
  int broken;
} source;

static float value_at(uint32_t view, uint32_t light, uint32_t x, uint32_t y, uint32_t channel) {
  uint32_t h = ((((view * 31 + light) * 37 + x) * 41 + y) * 43 + channel) * 2654435761u;
  h ^= h >> 15;
  h *= 2246822519u;
  return (float)(h >> 8) / 16777216.0f;
}

static btf_status read_block(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  source *from = user;
  pthread_mutex_lock(&from->mutex);
  from->texels_read += (uint64_t)b->views * b->lights * b->width * b->height * CHANNELS;
  pthread_mutex_unlock(&from->mutex);
  if (from->broken) return btf_source_error(BTF_E_IO, "the source broke");
  for (uint32_t v = 0; v < b->views; v++)
    for (uint32_t l = 0; l < b->lights; l++)
      for (uint32_t y = 0; y < b->height; y++)
        for (uint32_t x = 0; x < b->width; x++)
          for (uint32_t c = 0; c < CHANNELS; c++)
            *(float *)((char *)dst + (ptrdiff_t)v * s->view + (ptrdiff_t)l * s->light + (ptrdiff_t)y * s->y +
                       (ptrdiff_t)x * s->x + (ptrdiff_t)c * s->channel) =
                value_at(b->view0 + v, b->light0 + l, b->x0 + x, b->y0 + y, c);
  return BTF_OK;
}

static btf_dataset *make_dataset(btf_context *ctx, source *from, uint32_t width, uint32_t height,
                                 uint32_t flags) {
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_dirset *lights, *views;
  btf_dataset *ds;
  from->width = width;
  from->texels_read = 0;
  from->broken = 0;
  pthread_mutex_init(&from->mutex, NULL);
  assert_ok(btf_dirset_create_named(ctx, "grid:3x2", &lights));
  assert_ok(btf_dirset_create_named(ctx, "grid:5x1", &views));
  desc.lights = lights;
  desc.views = views;
  desc.width = width;
  desc.height = height;
  desc.channels = CHANNELS;
  desc.flags = flags;
  desc.read = read_block;
  desc.user = from;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  btf_dirset_release(lights);
  btf_dirset_release(views);
  return ds;
}

/* ---- visiting ---- */

typedef struct visits {
  uint32_t level, width, threads;
  int wrong_level;
  unsigned char seen[MOST_TEXELS];
  float got[MOST_TEXELS * LENGTH];
  int running[64]; /* by thread: one task of a thread at a time */
} visits;

static void visit(void *user, uint32_t level, uint32_t x, uint32_t y, const float *abrdf, uint32_t thread) {
  visits *v = user;
  const size_t texel = (size_t)y * v->width + x;
  if (level != v->level || thread >= v->threads || thread >= 64 || texel >= MOST_TEXELS ||
      v->running[thread]) {
    v->wrong_level = 1;
    return;
  }
  v->running[thread] = 1;
  v->seen[texel]++;
  memcpy(v->got + texel * LENGTH, abrdf, LENGTH * sizeof(float));
  v->running[thread] = 0;
}

static float *whole_texture(uint32_t width, uint32_t height) {
  float *texture = malloc((size_t)width * height * LENGTH * sizeof *texture), *at = texture;
  assert_non_null(texture);
  for (uint32_t y = 0; y < height; y++)
    for (uint32_t x = 0; x < width; x++)
      for (uint32_t view = 0; view < VIEWS; view++)
        for (uint32_t light = 0; light < LIGHTS; light++)
          for (uint32_t c = 0; c < CHANNELS; c++) *at++ = value_at(view, light, x, y, c);
  return texture;
}

/* The smallest budget that visit_abrdfs says would do. */
static uint64_t least_budget(btf_context *ctx, const btf_dataset *ds, uint32_t level) {
  visits unused;
  const char *at;
  assert_status(btfi_host()->visit_abrdfs(ctx, ds, level, 1, visit, &unused, NULL, 0.0, 1.0, "visit"),
                BTF_E_LIMIT);
  assert_non_null(at = strstr(btf_error_message(), "at least "));
  return strtoull(at + 9, NULL, 10);
}

static void check_level(btf_context *ctx, const btf_dataset *ds, uint32_t width, uint32_t height,
                        const float *texture, uint32_t level, uint64_t budget) {
  static visits v;
  static float expected[MOST_TEXELS * LENGTH];
  const uint32_t lw = btf_sampling_level_size(width, level), lh = btf_sampling_level_size(height, level);
  memset(&v, 0, sizeof v);
  v.level = level;
  v.width = lw;
  v.threads = btfi_host()->thread_count(ctx);
  assert_ok(btfi_host()->visit_abrdfs(ctx, ds, level, budget, visit, &v, NULL, 0.0, 1.0, "visit"));
  assert_int_equal(v.wrong_level, 0);
  for (size_t i = 0; i < MOST_TEXELS; i++) assert_int_equal(v.seen[i], i < (size_t)lw * lh);
  assert_ok(btfi_host()->mip_filter(ctx, texture, LENGTH, width, height, LENGTH, level, expected, LENGTH));
  /* Both are rounded to float once from a double that differs in its last bits: one ulp of values below 1. */
  for (size_t i = 0; i < (size_t)lw * lh * LENGTH; i++) assert_near(v.got[i], expected[i], 6e-8);
}

static void levels_are_filtered_textures(void **state) {
  static const uint32_t sizes[][2] = {{1, 1}, {1, 7}, {9, 1}, {8, 8}, {7, 5}, {13, 22}, {33, 12}};
  static const uint32_t flags[] = {0, BTF_DATASET_IMAGE_MAJOR, BTF_DATASET_CONCURRENT_READ};
  (void)state;
  for (uint32_t threads = 1; threads <= 3; threads += 2)
    for (size_t k = 0; k < sizeof sizes / sizeof *sizes; k++) {
      const uint32_t width = sizes[k][0], height = sizes[k][1];
      test_memory memory;
      btf_context *ctx = test_context_with(&memory, NULL, threads);
      source from;
      btf_dataset *ds = make_dataset(ctx, &from, width, height, flags[k % 3]);
      float *texture = whole_texture(width, height);
      for (uint32_t level = 0; level < btfi_host()->mip_count(width, height); level++) {
        const uint64_t least = least_budget(ctx, ds, level);
        const uint64_t budgets[] = {least, least + 500, 2 * least, 10 * least, 0};
        for (size_t b = 0; b < sizeof budgets / sizeof *budgets; b++)
          check_level(ctx, ds, width, height, texture, level, budgets[b]);
        assert_status(
            btfi_host()->visit_abrdfs(ctx, ds, level, least - 1, visit, NULL, NULL, 0.0, 1.0, "visit"),
            BTF_E_LIMIT);
      }
      assert_status(btfi_host()->visit_abrdfs(ctx, ds, btfi_host()->mip_count(width, height), 0, visit, NULL,
                                              NULL, 0.0, 1.0, "visit"),
                    BTF_E_INVALID_ARG);
      free(texture);
      btf_dataset_release(ds);
      test_context_done(ctx, &memory);
    }
}

/* Where footprints have whole texels, each sample is read once whatever the budget. */
static void data_are_read_once(void **state) {
  static visits v;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 2);
  source from;
  btf_dataset *ds = make_dataset(ctx, &from, 16, 32, 0);
  (void)state;
  for (uint32_t level = 0; level < 5; level++) {
    const uint64_t least = least_budget(ctx, ds, level), budgets[] = {least, 3 * least, 0};
    for (size_t b = 0; b < 3; b++) {
      memset(&v, 0, sizeof v);
      v.level = level;
      v.width = btf_sampling_level_size(16, level);
      v.threads = 2;
      from.texels_read = 0;
      assert_ok(btfi_host()->visit_abrdfs(ctx, ds, level, budgets[b], visit, &v, NULL, 0.0, 1.0, "visit"));
      assert_int_equal(from.texels_read, 16 * 32 * LENGTH);
    }
  }
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

/* The data are in memory, so that the context allocates for the visit alone. */
static void budget_is_kept(void **state) {
  static visits v;
  (void)state;
  for (uint32_t level = 0; level < 6; level++) {
    const uint64_t budgets[] = {0, 20000, 100000};
    for (size_t b = 0; b < 3; b++) {
      test_memory memory;
      btf_context *ctx = test_context_with(&memory, NULL, 2);
      btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
      float *texture = whole_texture(33, 21);
      btf_dirset *lights, *views;
      btf_dataset *ds;
      uint64_t base, peak;
      assert_ok(btf_dirset_create_named(ctx, "grid:3x2", &lights));
      assert_ok(btf_dirset_create_named(ctx, "grid:5x1", &views));
      desc.lights = lights;
      desc.views = views;
      desc.width = 33;
      desc.height = 21;
      desc.channels = CHANNELS;
      desc.data = texture;
      desc.strides = (btf_strides){4 * CHANNELS * LIGHTS, 4 * CHANNELS, 4 * LENGTH * 33, 4 * LENGTH, 4};
      assert_ok(btf_dataset_create(ctx, &desc, &ds));
      const uint64_t budget = budgets[b] != 0 ? budgets[b] : least_budget(ctx, ds, level);
      memset(&v, 0, sizeof v);
      v.level = level;
      v.width = btf_sampling_level_size(33, level);
      v.threads = 2;
      btf_context_memory(ctx, &base, &peak);
      /* What making the data set needed is gone again, and is less than the visit's budget. */
      assert_true(peak - base < 16384);
      assert_ok(btfi_host()->visit_abrdfs(ctx, ds, level, budget, visit, &v, NULL, 0.0, 1.0, "visit"));
      btf_context_memory(ctx, NULL, &peak);
      assert_true(peak - base <= (budget > 16384 ? budget : 16384));
      btf_dataset_release(ds);
      btf_dirset_release(lights);
      btf_dirset_release(views);
      free(texture);
      test_context_done(ctx, &memory);
    }
  }
}

typedef struct reports {
  int calls, cancel_at;
  double first, last;
} reports;

static int32_t report(void *user, double fraction, const char *stage) {
  reports *r = user;
  assert_string_equal(stage, "visit");
  assert_true(r->calls == 0 || fraction >= r->last);
  if (r->calls == 0) r->first = fraction;
  r->last = fraction;
  return ++r->calls == r->cancel_at;
}

static void progress_cancel_and_failure(void **state) {
  static visits v;
  test_memory memory;
  btf_context *ctx = test_context_with(&memory, NULL, 2);
  source from;
  btf_dataset *ds = make_dataset(ctx, &from, 13, 22, 0);
  (void)state;
  for (uint32_t level = 0; level < 3; level++)
    for (int cancel = 0; cancel < 2; cancel++) {
      reports r = {.cancel_at = cancel};
      btf_job job = BTF_JOB_INIT;
      btfi_job running;
      job.progress = report;
      job.user = &r;
      memset(&v, 0, sizeof v);
      v.level = level;
      v.width = btf_sampling_level_size(13, level);
      v.threads = 2;
      assert_ok(btfi_job_begin(ctx, &job, &running));
      assert_status(
          btfi_host()->visit_abrdfs(ctx, ds, level, 0, visit, &v, &running.desc, 0.25, 1.0, "visit"),
          cancel ? BTF_E_CANCELLED : BTF_OK);
      assert_true(r.first == 0.25 && r.calls >= 1);
      if (!cancel) assert_true(r.last == 1.0);
    }
  from.broken = 1;
  for (uint32_t level = 0; level < 3; level++) {
    assert_status(btfi_host()->visit_abrdfs(ctx, ds, level, 0, visit, &v, NULL, 0.0, 1.0, "visit"), BTF_E_IO);
    assert_message_has("the source broke");
  }
  btf_dataset_release(ds);
  test_context_done(ctx, &memory);
}

static void memory_runs_out(void **state) {
  static visits v;
  (void)state;
  for (uint32_t level = 0; level < 2; level++)
    for (long n = 1;; n++) {
      test_memory memory;
      btf_context *ctx = test_context_with(&memory, NULL, 2);
      source from;
      btf_dataset *ds = make_dataset(ctx, &from, 7, 5, 0);
      memset(&v, 0, sizeof v);
      v.level = level;
      v.width = btf_sampling_level_size(7, level);
      v.threads = 2;
      memory.fail_at = memory.total_allocations + n;
      const btf_status status =
          btfi_host()->visit_abrdfs(ctx, ds, level, 0, visit, &v, NULL, 0.0, 1.0, "visit");
      memory.fail_at = 0;
      btf_dataset_release(ds);
      test_context_done(ctx, &memory);
      if (status == BTF_OK) {
        assert_true(n > 2);
        break;
      }
      assert_int_equal(status, BTF_E_NOMEM);
    }
}

/* ---- texels without end, and slow ones ---- */

static btf_status read_zeros(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  (void)user;
  (void)s; /* dense */
  memset(dst, 0, (size_t)b->views * b->lights * b->width * b->height);
  return BTF_OK;
}

typedef struct counted {
  atomic_ullong visits;
  long texel_ns;
} counted;

static void count_visit(void *user, uint32_t level, uint32_t x, uint32_t y, const float *abrdf,
                        uint32_t thread) {
  counted *c = user;
  const struct timespec pause = {0, c->texel_ns};
  (void)level, (void)x, (void)y, (void)abrdf, (void)thread;
  if (c->texel_ns > 0) nanosleep(&pause, NULL);
  atomic_fetch_add(&c->visits, 1);
}

static int32_t cancel_once_begun(void *user, double fraction, const char *stage) {
  (void)user;
  (void)stage;
  return fraction > 0.0;
}

static btf_status visit_zeros(uint32_t side, uint64_t budget, counted *c) {
  const btf_limits limits = {.struct_size = sizeof limits, .max_memory = (uint64_t)1 << 30};
  btf_context_desc settings = BTF_CONTEXT_DESC_INIT;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_job job = BTF_JOB_INIT;
  btfi_job running;
  btf_dirset *one;
  btf_dataset *ds;
  btf_context *ctx;
  settings.max_threads = 2;
  settings.limits = &limits;
  assert_ok(btf_context_create(&settings, &ctx));
  assert_ok(btf_dirset_create_named(ctx, "grid:1x1", &one));
  desc.lights = desc.views = one;
  desc.width = desc.height = side;
  desc.channels = 1;
  desc.sample_type = BTF_SAMPLE_U8;
  desc.read = read_zeros;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  job.progress = cancel_once_begun;
  assert_ok(btfi_job_begin(ctx, &job, &running));
  const btf_status status =
      btfi_host()->visit_abrdfs(ctx, ds, 0, budget, count_visit, c, &running.desc, 0.0, 1.0, "visit");
  btf_dataset_release(ds);
  btf_dirset_release(one);
  btf_context_release(ctx);
  return status;
}

/* 2^32 texels, and a budget for all of them at once. */
static void slabs_are_counted_in_32_bits(void **state) {
  counted c = {0};
  (void)state;
  assert_status(visit_zeros(65536, (uint64_t)1 << 36, &c), BTF_E_CANCELLED);
  assert_true(atomic_load(&c.visits) > 0);
}

/* A texel takes 40 ms or more. The first round is one for each of two threads and the next ones take 50 ms or
 * one for each again: those begun within the 100 ms that lie between two reports are 3 rounds of at most 3.
 */
static void slow_texels_hold_up_no_cancel(void **state) {
  counted c = {.texel_ns = 40000000};
  (void)state;
  assert_status(visit_zeros(64, 0, &c), BTF_E_CANCELLED);
  assert_in_range(atomic_load(&c.visits), 1, 9);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(levels_are_filtered_textures),
      cmocka_unit_test(data_are_read_once),
      cmocka_unit_test(budget_is_kept),
      cmocka_unit_test(progress_cancel_and_failure),
      cmocka_unit_test(memory_runs_out),
      cmocka_unit_test(slabs_are_counted_in_32_bits),
      cmocka_unit_test(slow_texels_hold_up_no_cancel),
  };
  return btf_run("visit", tests);
}
