/* SPDX-License-Identifier: MIT */
/* Context, memory, growable structs, jobs, checksums, random numbers and byte buffers. */
#include "btf_test.h"

#include "base/base.h"

#include <locale.h>

/* ---- status and context ---- */

static void status_names_are_those_of_the_header(void **state) {
  (void)state;
  assert_string_equal(btf_status_name(BTF_OK), "BTF_OK");
  assert_string_equal(btf_status_name(BTF_E_ABI), "BTF_E_ABI");
  assert_string_equal(btf_status_name(BTF_E_PLUGIN), "BTF_E_PLUGIN");
  assert_non_null(btf_status_name(-7));
  assert_int_equal(btf_version(),
                   LIBBTF_VERSION_MAJOR << 16 | LIBBTF_VERSION_MINOR << 8 | LIBBTF_VERSION_PATCH);
}

static void create_refuses_what_it_cannot_honour(void **state) {
  (void)state;
  btf_context *ctx = (btf_context *)&state;
  assert_status(btf_context_create_abi(LIBBTF_ABI + 1, NULL, &ctx), BTF_E_ABI);
  assert_null(ctx);
  assert_message_has("ABI 2");
  assert_status(btf_context_create(NULL, NULL), BTF_E_INVALID_ARG);

  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  desc.isa = "mmx";
  assert_status(btf_context_create(&desc, &ctx), BTF_E_INVALID_ARG);
  assert_message_has("\"mmx\"");
  desc = (btf_context_desc)BTF_CONTEXT_DESC_INIT;
  desc.flags = 4;
  assert_status(btf_context_create(&desc, &ctx), BTF_E_INVALID_ARG);
  desc = (btf_context_desc)BTF_CONTEXT_DESC_INIT;
  desc.max_threads = 1000000;
  assert_status(btf_context_create(&desc, &ctx), BTF_E_INVALID_ARG);
  assert_message_has("max_threads");
  desc = (btf_context_desc)BTF_CONTEXT_DESC_INIT;
  desc.struct_size = 8;
  assert_status(btf_context_create(&desc, &ctx), BTF_E_ABI);

  test_memory memory = {0};
  btf_allocator allocator = test_allocator(&memory);
  desc = (btf_context_desc)BTF_CONTEXT_DESC_INIT;
  desc.allocator = &allocator;
  memory.fail_at = 1;
  assert_status(btf_context_create(&desc, &ctx), BTF_E_NOMEM);
  assert_int_equal(memory.live_blocks, 0);
  allocator.free = NULL;
  assert_status(btf_context_create(&desc, &ctx), BTF_E_INVALID_ARG);
  assert_null(ctx);
  btf_context_release(NULL);
}

static void a_context_needs_no_description(void **state) {
  (void)state;
  btf_context *ctx = NULL;
  assert_ok(btf_context_create(NULL, &ctx));
  assert_int_equal(btfi_limits(ctx)->max_memory, (uint64_t)64 << 30);
  assert_int_equal(btfi_limits(ctx)->max_chunk_bytes, (uint64_t)16 << 30);
  assert_int_equal(btfi_limits(ctx)->max_chunks, 65536);
  assert_int_equal(btfi_limits(ctx)->max_dimension, 65536);
  assert_int_equal(btfi_limits(ctx)->max_directions, 65536);
  assert_int_equal(btfi_limits(ctx)->max_channels, 64);
  assert_true(btfi_thread_count(ctx) >= 1);
  btf_context_release(ctx);
}

static void isa_is_capped_and_never_raised(void **state) {
  (void)state;
  static const char *const names[] = {"scalar", "avx2", "avx512", "neon"};
  test_memory memory;
  btf_context *best = test_context(&memory);
  const uint32_t machine = btfi_isa(best);
  assert_int_equal(machine, btfi_isa_of_machine());
  test_context_done(best, &memory);
  for (size_t i = 0; i < 4; i++) {
    btf_context *ctx = test_context_with(&memory, names[i], 1);
    assert_true(btfi_isa(ctx) <= machine);
    if (strcmp(btf_context_isa(ctx), names[i]) != 0) /* less than asked for only where the machine has less */
      assert_true(btfi_isa(ctx) == machine || btfi_isa(ctx) == 0);
    if (i == 0) assert_int_equal(btfi_isa(ctx), 0);
    test_context_done(ctx, &memory);
  }
}

static int registry_destroyed;
static void count_destroy(btf_context *ctx, void *registry) {
  assert_ptr_equal(btfi_context_registry(ctx), registry);
  registry_destroyed++;
}

static void the_last_reference_ends_a_context(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  registry_destroyed = 0;
  btfi_context_set_registry(ctx, &memory, count_destroy);
  btfi_context_retain(ctx);
  btf_context_release(ctx);
  assert_int_equal(registry_destroyed, 0);
  assert_int_equal(memory.live_blocks, 1);
  test_context_done(ctx, &memory);
  assert_int_equal(registry_destroyed, 1);
}

typedef struct heard {
  int lines;
  int32_t level;
  btf_status code;
  char message[2048];
} heard;

static void hear(void *user, int32_t level, btf_status code, const char *message) {
  heard *h = user;
  h->lines++;
  h->level = level;
  h->code = code;
  snprintf(h->message, sizeof h->message, "%s", message);
}

static void failures_reach_the_log_as_one_line(void **state) {
  (void)state;
  heard h = {0};
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx = NULL;
  desc.log = hear;
  desc.log_user = &h;
  assert_ok(btf_context_create(&desc, &ctx));
  assert_int_equal(btfi_fail(ctx, BTF_E_CORRUPT, "a\nb\x1b[31m%d", 7), BTF_E_CORRUPT);
  assert_int_equal(h.lines, 1);
  assert_int_equal(h.level, BTF_LOG_ERROR);
  assert_int_equal(h.code, BTF_E_CORRUPT);
  assert_string_equal(h.message, "a?b?[31m7");
  assert_string_equal(btf_error_message(), h.message);
  /* The message may quote the one before it. */
  (void)btfi_fail(ctx, BTF_E_CORRUPT, "again: %s", btf_error_message());
  assert_string_equal(btf_error_message(), "again: a?b?[31m7");
  btfi_log(ctx, BTF_LOG_INFO, "half done");
  assert_int_equal(h.level, BTF_LOG_INFO);
  assert_string_equal(h.message, "half done");

  /* Cut at every phase of a two-byte letter, a long message stays UTF-8. */
  for (int shift = 0; shift < 2; shift++) {
    char text[4001] = "x";
    for (int i = shift; i + 1 < 4000; i += 2) memcpy(text + i, "\xc3\xa9", 2);
    text[3999] = text[4000] = '\0';
    (void)btfi_fail(ctx, BTF_E_IO, "%s", text);
    const char *message = btf_error_message();
    size_t left = strlen(message);
    assert_true(left < 1024 && left > 1000);
    assert_string_equal(message + left - 3, "...");
    for (uint32_t n; left > 0; message += n, left -= n)
      assert_true((n = btfi_utf8_length(message, left)) > 0);
  }
  btf_context_release(ctx);
}

/* ---- memory ---- */

static void memory_is_aligned_and_counted(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  uint64_t start, now, peak;
  btf_context_memory(ctx, &start, NULL);
  void *blocks[100];
  for (size_t i = 0; i < 100; i++) {
    blocks[i] = btfi_alloc(ctx, i, 7);
    assert_non_null(blocks[i]);
    assert_int_equal((uintptr_t)blocks[i] % 64, 0);
    memset(blocks[i], 1, i * 7);
  }
  btf_context_memory(ctx, &now, &peak);
  assert_true(now - start >= 99 * 100 / 2 * 7);
  assert_true(now - start <=
              99 * 100 / 2 * 7 + 100 * 128); /* a prefix and rounding of 64 bytes each at most */
  assert_int_equal(peak, now);
  for (size_t i = 0; i < 100; i++) btfi_free(ctx, blocks[i]);
  btfi_free(ctx, NULL);
  btf_context_memory(ctx, &now, NULL);
  assert_int_equal(now, start);
  btf_context_memory(ctx, NULL, &now);
  assert_int_equal(now, peak);

  unsigned char *zeros = btfi_calloc(ctx, 3, 1000);
  for (size_t i = 0; i < 3000; i++) assert_int_equal(zeros[i], 0);
  char *copy = btfi_strdup(ctx, "corduroy");
  assert_string_equal(copy, "corduroy");
  btfi_free(ctx, zeros);
  btfi_free(ctx, copy);
  test_context_done(ctx, &memory);
}

static void memory_that_cannot_be_had_says_why(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  uint64_t before, after;
  btf_context_memory(ctx, &before, NULL);
  assert_null(btfi_alloc(ctx, (uint64_t)1 << 33, (uint64_t)1 << 33));
  assert_int_equal(btfi_alloc_status(), BTF_E_LIMIT);
  assert_null(btfi_alloc(ctx, UINT64_MAX, 1));
  assert_int_equal(btfi_alloc_status(), BTF_E_LIMIT);
  assert_null(btfi_calloc(ctx, UINT64_MAX - 63, 1));
  memory.fail_at = memory.total_allocations + 1;
  assert_null(btfi_alloc(ctx, 10, 1));
  assert_int_equal(btfi_alloc_status(), BTF_E_NOMEM);
  btf_context_memory(ctx, &after, NULL);
  assert_int_equal(before, after);
  test_context_done(ctx, &memory);
}

static void the_memory_limit_is_exact(void **state) {
  (void)state;
  btf_limits limits = BTF_LIMITS_INIT;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx = NULL;
  limits.max_memory = 4096;
  desc.limits = &limits;
  assert_ok(btf_context_create(&desc, &ctx));
  void *most = btfi_alloc(ctx, 4096 - 64, 1); /* 64 bytes go to the size before the block */
  assert_non_null(most);
  assert_null(btfi_alloc(ctx, 0, 1));
  assert_int_equal(btfi_alloc_status(), BTF_E_LIMIT);
  assert_message_has("limit is 4096");
  btfi_free(ctx, most);
  assert_null(btfi_alloc(ctx, 4096 - 63, 1));
  uint64_t now, peak;
  btf_context_memory(ctx, &now, &peak);
  assert_int_equal(now, 0);
  assert_int_equal(peak, 4096);
  btf_context_release(ctx);
}

static void *crooked_alloc(void *user, size_t size, size_t align) {
  const size_t shift = *(size_t *)user;
  unsigned char *block = aligned_alloc(align, (size + shift + 63) & ~(size_t)63);
  return block ? block + shift : NULL;
}
static void crooked_free(void *user, void *ptr, size_t size) {
  (void)size;
  free((unsigned char *)ptr - *(size_t *)user);
}

static void a_misaligning_allocator_is_refused(void **state) {
  (void)state;
  size_t shift = 0;
  btf_allocator allocator = {&shift, crooked_alloc, crooked_free};
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx = NULL;
  desc.allocator = &allocator;
  assert_ok(btf_context_create(&desc, &ctx));
  shift = 16;
  assert_null(btfi_alloc(ctx, 100, 1));
  assert_int_equal(btfi_alloc_status(), BTF_E_NOMEM);
  shift = 0;
  btf_context_release(ctx);
}

/* ---- growable structs ---- */

typedef struct lamp_first {
  size_t struct_size;
  uint64_t power;
} lamp_first;
typedef struct lamp_now {
  size_t struct_size;
  uint64_t power, colour;
} lamp_now;
typedef struct lamp_later {
  size_t struct_size;
  uint64_t power, colour, shape, spare;
} lamp_later;

static void structs_of_old_and_new_programs_are_understood(void **state) {
  (void)state;
  const lamp_first old = {sizeof old, 11};
  lamp_now got = {1, 2, 3};
  assert_ok(btfi_copy_in(NULL, "lamp", &got, sizeof got, sizeof old, &old));
  assert_int_equal(got.struct_size, sizeof got);
  assert_int_equal(got.power, 11);
  assert_int_equal(got.colour, 0);

  lamp_later newer = {sizeof newer, 21, 22, 0, 0};
  assert_ok(btfi_copy_in(NULL, "lamp", &got, sizeof got, sizeof old, &newer));
  assert_int_equal(got.colour, 22);
  newer.spare = (uint64_t)1 << 63; /* the very last byte */
  assert_status(btfi_copy_in(NULL, "lamp", &got, sizeof got, sizeof old, &newer), BTF_E_ABI);
  assert_message_has("lamp");

  lamp_first shrunk = {sizeof shrunk - 1, 5};
  assert_status(btfi_copy_in(NULL, "lamp", &got, sizeof got, sizeof old, &shrunk), BTF_E_ABI);
  shrunk.struct_size = SIZE_MAX; /* must not be followed into memory that is not there */
  assert_status(btfi_copy_in(NULL, "lamp", &got, sizeof got, sizeof old, &shrunk), BTF_E_ABI);
  assert_status(btfi_copy_in(NULL, "lamp", &got, sizeof got, sizeof old, NULL), BTF_E_INVALID_ARG);
}

static void structs_are_filled_as_far_as_they_have_room(void **state) {
  (void)state;
  const lamp_now ours = {sizeof ours, 31, 32};
  lamp_later newer = {sizeof newer, 0, 0, 7, 7};
  assert_ok(btfi_copy_out(NULL, "lamp", &newer, sizeof(lamp_first), &ours, sizeof ours));
  assert_int_equal(newer.struct_size, sizeof newer);
  assert_int_equal(newer.colour, 32);
  assert_int_equal(newer.shape, 0);
  assert_int_equal(newer.spare, 0);

  struct {
    lamp_first lamp;
    uint64_t neighbour;
  } old = {{sizeof(lamp_first), 0}, 99};
  assert_ok(btfi_copy_out(NULL, "lamp", &old.lamp, sizeof(lamp_first), &ours, sizeof ours));
  assert_int_equal(old.lamp.struct_size, sizeof(lamp_first));
  assert_int_equal(old.lamp.power, 31);
  assert_int_equal(old.neighbour, 99);
  old.lamp.struct_size = 0;
  assert_status(btfi_copy_out(NULL, "lamp", &old.lamp, sizeof(lamp_first), &ours, sizeof ours), BTF_E_ABI);
}

/* ---- jobs ---- */

typedef struct watcher {
  int calls, cancel_at;
  double last;
  char stages[128];
} watcher;

static int32_t watch(void *user, double fraction, const char *stage) {
  watcher *w = user;
  w->last = fraction;
  if (w->calls++ == 0 || strcmp(strrchr(w->stages, ' ') + 1, stage) != 0) {
    strcat(w->stages, " ");
    strcat(w->stages, stage);
  }
  return w->calls == w->cancel_at;
}

static void a_job_has_defaults(void **state) {
  (void)state;
  btfi_job job;
  assert_ok(btfi_job_begin(NULL, NULL, &job));
  assert_int_equal(job.desc.max_working_set, 1 << 30);
  assert_int_equal(job.desc.seed, 0);
  assert_ok(btfi_progress(&job.desc, 0.5, "solve"));
  assert_ok(btfi_progress(NULL, 0.5, "solve"));
  btf_job user = BTF_JOB_INIT;
  user.max_working_set = 12345;
  user.seed = 6;
  assert_ok(btfi_job_begin(NULL, &user, &job));
  assert_int_equal(job.desc.max_working_set, 12345);
  assert_int_equal(job.desc.seed, 6);
  user.struct_size = 3;
  assert_status(btfi_job_begin(NULL, &user, &job), BTF_E_ABI);
}

static void progress_is_thinned_but_never_loses_its_ends(void **state) {
  (void)state;
  watcher w = {0};
  btf_job user = BTF_JOB_INIT;
  btfi_job job;
  user.progress = watch;
  user.user = &w;
  assert_ok(btfi_job_begin(NULL, &user, &job));
  const int64_t start = btfi_now_ns();
  int64_t elapsed = 0;
  assert_ok(btfi_progress(&job.desc, 0.0, "read"));
  assert_int_equal(w.calls, 1);
  while ((elapsed = btfi_now_ns() - start) < 350000000) assert_ok(btfi_progress(&job.desc, 0.3, "read"));
  const int regular = w.calls;
  assert_true(regular >= 3);
  assert_true(regular <= 2 + (int)(elapsed / 100000000));
  char stage[] = "solve"; /* equal text in another buffer is no new stage, other text in the same buffer is */
  assert_ok(btfi_progress(&job.desc, 0.5, stage));
  assert_ok(btfi_progress(&job.desc, 0.5, "solve"));
  memcpy(stage, "write", sizeof stage);
  assert_ok(btfi_progress(&job.desc, 0.9, stage));
  assert_ok(btfi_progress(&job.desc, 1.0, "write"));
  assert_near(w.last, 1.0, 0.0);
  assert_int_equal(w.calls, regular + 3);
  assert_string_equal(w.stages, " read solve write");
  assert_ok(btfi_progress(&job.desc, 7.0, "end"));
  assert_near(w.last, 1.0, 0.0);
  assert_ok(btfi_progress(&job.desc, (double)NAN, "odd"));
  assert_near(w.last, 0.0, 0.0);
}

static void cancelling_sticks(void **state) {
  (void)state;
  watcher w = {0};
  btf_job user = BTF_JOB_INIT;
  btfi_job job;
  user.progress = watch;
  user.user = &w;
  w.cancel_at = 2;
  assert_ok(btfi_job_begin(NULL, &user, &job));
  assert_ok(btfi_progress(&job.desc, 0.0, "read"));
  assert_status(btfi_progress(&job.desc, 0.1, "solve"), BTF_E_CANCELLED);
  assert_message_has("solve");
  assert_status(btfi_progress(&job.desc, 1.0, "write"), BTF_E_CANCELLED);
  assert_int_equal(w.calls, 2);
}

/* ---- checksums ---- */

static void xxh64_gives_the_published_values(void **state) {
  (void)state;
  assert_int_equal(btfi_xxh64_of("", 0), 0xef46db3751d8e999u);
  assert_int_equal(btfi_xxh64_of(NULL, 0), 0xef46db3751d8e999u);
  assert_int_equal(btfi_xxh64_of("a", 1), 0xd24ec4f1a98c6e5bu);
  assert_int_equal(btfi_xxh64_of("abc", 3), 0x44bc2cf5ad770999u);
  assert_int_equal(btfi_xxh64_of("Nobody inspects the spammish repetition", 39), 0xfbcea83c8a378bf1u);
  /* From `xxhsum -H64` 0.8.1 of the first n bytes of this sequence. */
  static const struct {
    size_t n;
    uint64_t hash;
  } vectors[] = {{0, 0xef46db3751d8e999u},   {1, 0xf592c0c7639c4cb6u},    {3, 0xd0166ce23baefadau},
                 {4, 0xb5aaf5b700cb3b0du},   {7, 0x67106e529c6409dau},    {8, 0xd1e135723ae0cd37u},
                 {12, 0xb4034258c0bde992u},  {31, 0xf9a24f601e903459u},   {32, 0x14ea46441aad9823u},
                 {33, 0x8559ec94b99ea0c3u},  {63, 0x6d33bd4cec135324u},   {64, 0x8a139b2eab4b4401u},
                 {100, 0x0a0f2ad70ba8a266u}, {1000, 0xba1080ada20aace0u}, {65537, 0x41640b45fb010ef2u}};
  unsigned char *data = malloc(65538);
  for (uint64_t i = 0; i < 65537; i++) data[i + 1] = (unsigned char)((i * i * 167 + i * 13 + 91) >> 3);
  for (size_t v = 0; v < sizeof vectors / sizeof vectors[0]; v++) {
    assert_int_equal(btfi_xxh64_of(data + 1, vectors[v].n), vectors[v].hash);
    for (size_t piece = 1; piece < 80; piece += 3) {
      btfi_xxh64 stream;
      btfi_xxh64_init(&stream, 0);
      for (size_t at = 0; at < vectors[v].n; at += piece)
        btfi_xxh64_update(&stream, data + 1 + at, BTFI_MIN(piece, vectors[v].n - at));
      assert_int_equal(btfi_xxh64_digest(&stream), vectors[v].hash);
      assert_int_equal(btfi_xxh64_digest(&stream), vectors[v].hash); /* a digest does not end the stream */
    }
  }
  free(data);
}

/* ---- random numbers ---- */

static void random_numbers_are_the_published_sequence(void **state) {
  (void)state;
  static const uint64_t from_1234[] = {11520u,
                                       0u,
                                       1509978240u,
                                       1215971899390074240u,
                                       1216172134540287360u,
                                       607988272756665600u,
                                       16172922978634559625u,
                                       8476171486693032832u,
                                       10595114339597558777u,
                                       2904607092377533576u};
  btfi_random r = {{1, 2, 3, 4}};
  for (size_t i = 0; i < 10; i++) assert_int_equal(btfi_random_u64(&r), from_1234[i]);
  btfi_random_seed(&r, 1234567);
  assert_int_equal(r.s[0], 6457827717110365317u);
  assert_int_equal(r.s[1], 3203168211198807973u);
  assert_int_equal(r.s[2], 9817491932198370423u);
  assert_int_equal(r.s[3], 4593380528125082431u);
}

static void random_numbers_are_uniform_and_normal(void **state) {
  (void)state;
  enum { draws = 1000000 };
  btfi_random r;
  btfi_random_seed(&r, 5);
  double sum = 0, normal[5] = {0};
  long below[7] = {0};
  for (int i = 0; i < draws; i++) {
    const float u = btfi_random_float(&r);
    assert_true(u >= 0.0f && u < 1.0f);
    sum += u;
    const double n = btfi_random_normal(&r);
    for (int p = 1; p <= 4; p++) normal[p] += pow(n, p);
    below[btfi_random_below(&r, 7)]++;
  }
  /* Five standard errors of each mean: a uniform has variance 1/12; the first four powers of a normal have
   * variances 1, 2, 15 and 96; a cell of probability 1/7 has 6/49. */
  const double root = 5.0 / sqrt(draws);
  assert_near(sum / draws, 0.5, root * sqrt(1.0 / 12));
  assert_near(normal[1] / draws, 0.0, root);
  assert_near(normal[2] / draws, 1.0, root * sqrt(2.0));
  assert_near(normal[3] / draws, 0.0, root * sqrt(15.0));
  assert_near(normal[4] / draws, 3.0, root * sqrt(96.0));
  for (int i = 0; i < 7; i++) assert_near((double)below[i] / draws, 1.0 / 7, root * sqrt(6.0 / 49));
  /* 3/4 of 2^64: taking the remainder of one draw would give the lowest third twice as often as the others.
   */
  long low = 0;
  for (int i = 0; i < draws / 10; i++) low += btfi_random_below(&r, (uint64_t)3 << 62) < (uint64_t)1 << 62;
  assert_near((double)low / (draws / 10), 1.0 / 3, 5.0 * sqrt(2.0 / 9 / (draws / 10)));
  for (int i = 0; i < 100; i++) assert_int_equal(btfi_random_below(&r, 1), 0);
}

/* ---- bytes ---- */

static void bytes_are_little_endian_and_bounded(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btfi_buffer b;
  btfi_buffer_init(&b, ctx);
  btfi_put_u8(&b, 0x12);
  btfi_put_u32(&b, 0x789abcdeu);
  btfi_put_u64(&b, 0x0102030405060708u);
  btfi_put_f32(&b, -1.5f);
  btfi_put_f64(&b, 1e300);
  btfi_put_bytes(&b, "knit", 4);
  assert_ok(btfi_buffer_status(&b));
  static const unsigned char first[] = {0x12, 0xde, 0xbc, 0x9a, 0x78, 8, 7,    6,   5,
                                        4,    3,    2,    1,    0,    0, 0xc0, 0xbf};
  assert_memory_equal(b.data, first, sizeof first);

  btfi_cursor c = {b.data, b.size, 0, false};
  assert_memory_equal(btfi_get_bytes(&c, 1), first, 1);
  assert_int_equal(btfi_get_u32(&c), 0x789abcdeu);
  assert_int_equal(btfi_get_u64(&c), 0x0102030405060708u);
  assert_true(btfi_get_f32(&c) == -1.5f);
  assert_true(btfi_get_f64(&c) == 1e300);
  assert_non_null(btfi_get_bytes(&c, 0));
  assert_int_equal(btfi_get_u64(&c), 0); /* four bytes are left */
  assert_true(c.overrun);
  assert_int_equal(btfi_get_u32(&c), 0); /* and a failed cursor stays failed */
  c.overrun = false;
  assert_null(btfi_get_bytes(&c, UINT64_MAX));
  c.overrun = false;
  assert_memory_equal(btfi_get_bytes(&c, 4), "knit", 4);
  assert_false(c.overrun);
  btfi_buffer_free(&b);
  test_context_done(ctx, &memory);
}

static void a_buffer_keeps_its_first_failure(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btfi_buffer b;
  btfi_buffer_init(&b, ctx);
  btfi_put_text(&b, "seed=%d", 1);
  memory.fail_at = memory.total_allocations + 1;
  for (int i = 0; i < 1000; i++) btfi_put_u64(&b, 1);
  assert_int_equal(btfi_buffer_status(&b), BTF_E_NOMEM);
  btfi_put_text(&b, "late");
  assert_int_equal(btfi_buffer_status(&b), BTF_E_NOMEM);
  assert_memory_equal(b.data, "seed=1", 6);
  btfi_buffer_free(&b);

  char longer[1000];
  memset(longer, 'w', 999);
  longer[999] = '\0';
  btfi_buffer_init(&b, ctx);
  btfi_put_text(&b, "%s|%s", longer, longer);
  assert_ok(btfi_buffer_status(&b));
  assert_int_equal(b.size, 1999);
  assert_int_equal(b.data[999], '|');
  btfi_buffer_free(&b);
  test_context_done(ctx, &memory);
}

static void text_does_not_follow_the_locale(void **state) {
  (void)state;
  if (!test_set_comma_locale()) skip();
  btf_context *ctx = NULL;
  assert_ok(btf_context_create(NULL, &ctx));
  btfi_buffer b;
  btfi_buffer_init(&b, ctx);
  btfi_put_text(&b, "%.2f", 0.25);
  char host[16];
  snprintf(host, sizeof host, "%.2f", 0.25);
  setlocale(LC_ALL, "C");
  assert_string_equal(host, "0,25"); /* the host's own printing is left as it was */
  assert_int_equal(b.size, 4);
  assert_memory_equal(b.data, "0.25", 4);
  btfi_buffer_free(&b);
  btf_context_release(ctx);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(status_names_are_those_of_the_header),
      cmocka_unit_test(create_refuses_what_it_cannot_honour),
      cmocka_unit_test(a_context_needs_no_description),
      cmocka_unit_test(isa_is_capped_and_never_raised),
      cmocka_unit_test(the_last_reference_ends_a_context),
      cmocka_unit_test(failures_reach_the_log_as_one_line),
      cmocka_unit_test(memory_is_aligned_and_counted),
      cmocka_unit_test(memory_that_cannot_be_had_says_why),
      cmocka_unit_test(the_memory_limit_is_exact),
      cmocka_unit_test(a_misaligning_allocator_is_refused),
      cmocka_unit_test(structs_of_old_and_new_programs_are_understood),
      cmocka_unit_test(structs_are_filled_as_far_as_they_have_room),
      cmocka_unit_test(a_job_has_defaults),
      cmocka_unit_test(progress_is_thinned_but_never_loses_its_ends),
      cmocka_unit_test(cancelling_sticks),
      cmocka_unit_test(xxh64_gives_the_published_values),
      cmocka_unit_test(random_numbers_are_the_published_sequence),
      cmocka_unit_test(random_numbers_are_uniform_and_normal),
      cmocka_unit_test(bytes_are_little_endian_and_bounded),
      cmocka_unit_test(a_buffer_keeps_its_first_failure),
      cmocka_unit_test(text_does_not_follow_the_locale),
  };
  return btf_run("base", tests);
}
