/* SPDX-License-Identifier: MIT */
/* The inline helpers of btf_codec.h. */
#include "btf_test.h"

#include "container/container.h"
#include "registry/registry.h"

#include <btf/btf_codec.h>

static void fields_are_little_endian(void **state) {
  static const unsigned char four[] = {0x78, 0x56, 0x34, 0xf2};
  static const unsigned char pi[] = {0x18, 0x2d, 0x44, 0x54, 0xfb, 0x21, 0x09, 0x40}; /* IEEE 754 */
  static const unsigned char half[] = {0x00, 0x00, 0x00, 0xbf};
  static const float floats[] = {0.0f, -0.0f, 1e-45f, 3.4e38f, INFINITY, -INFINITY, -1.5f};
  unsigned char bytes[9];
  (void)state;
  memset(bytes, 0xcc, sizeof bytes);
  btf_put_u32(bytes, 0xf2345678u);
  assert_memory_equal(bytes, four, 4);
  assert_int_equal(bytes[4], 0xcc);
  assert_true(btf_get_u32(four) == 0xf2345678u);
  btf_put_f32(bytes, -0.5f);
  assert_memory_equal(bytes, half, 4);
  assert_true(btf_get_f32(half) == -0.5f);
  btf_put_f64(bytes + 1, 3.14159265358979323846); /* at any address */
  assert_memory_equal(bytes + 1, pi, 8);
  assert_true(btf_get_f64(pi) == 3.14159265358979323846);
  for (size_t i = 0; i < sizeof floats / sizeof *floats; i++) {
    btf_put_f32(bytes, floats[i]);
    const float back = btf_get_f32(bytes);
    assert_memory_equal(&back, &floats[i], sizeof back);
    btf_put_f64(bytes, floats[i]);
    assert_true(btf_get_f64(bytes) == (double)floats[i]);
  }
  btf_put_f32(bytes, NAN);
  assert_true(isnan(btf_get_f32(bytes)));
}

/* The published sequence of splitmix64 for seed 1234567. */
static void random_numbers(void **state) {
  static const uint64_t published[] = {UINT64_C(6457827717110365317), UINT64_C(3203168211198807973),
                                       UINT64_C(9817491932198370423), UINT64_C(4593380528125082431),
                                       UINT64_C(16408922859458223821)};
  uint64_t seed = 1234567;
  double sum = 0.0, least = 1.0, most = 0.0;
  (void)state;
  for (size_t i = 0; i < 5; i++) assert_true(btf_random_u64(&seed) == published[i]);
  for (int i = 0; i < 100000; i++) {
    const double unit = btf_random_unit(&seed);
    sum += unit;
    least = fmin(least, unit);
    most = fmax(most, unit);
  }
  assert_true(least >= 0.0 && most < 1.0 && least < 1e-3 && most > 0.999);
  assert_near(sum / 100000, 0.5, 5.0 * 0.2887 / sqrt(100000)); /* five standard errors */
}

static btf_status stop_at(btf_status status, int *reached) {
  BTF_TRY(status);
  *reached = 1;
  return BTF_OK;
}

typedef struct heard {
  int32_t level;
  char text[256];
} heard;

static void listen(void *user, int32_t level, btf_status code, const char *message) {
  heard *h = user;
  (void)code;
  h->level = level;
  snprintf(h->text, sizeof h->text, "%s", message);
}

static btf_context *context_that_tells(heard *h) {
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  desc.log = listen;
  desc.log_user = h;
  assert_ok(btf_context_create(&desc, &ctx));
  return ctx;
}

/* Twice the squared error of the target is 10 log10 2 = 3.01 dB less, and an rmse root 2 times as large. */
static void missed_targets_are_told_as_asked(void **state) {
  heard h = {0};
  btf_context *ctx = context_that_tells(&h);
  (void)state;
  btf_warn_missed(btfi_host(), ctx, "some", 7, "terms", 0.32, 0.16, 4.0, 40.0);
  assert_int_equal(h.level, BTF_LOG_WARNING);
  assert_string_equal(h.text, "some: 7 terms reach a psnr of 36.99 dB; 40 dB was asked for");
  btf_warn_missed(btfi_host(), ctx, "some", 7, "terms", 0.32, 0.16, 4.0, 0.0);
  assert_string_equal(h.text, "some: 7 terms reach an rmse of 0.282843; 0.2 was asked for");
  btf_context_release(ctx);
}

static void a_model_far_from_the_data_is_told(void **state) {
  heard h = {0};
  btf_context *ctx = context_that_tells(&h);
  (void)state;
  btf_warn_unfit(btfi_host(), ctx, "some", 0.25, 0.25, "another would do");
  assert_string_equal(h.text, "");
  btf_warn_unfit(btfi_host(), ctx, "some", 0.5678, 0.25, "another would do");
  assert_int_equal(h.level, BTF_LOG_WARNING);
  assert_string_equal(h.text, "some: a relative error of 0.568: another would do");
  btf_context_release(ctx);
}

/* Every direction lies where it does on its own; equal neighbours share a place, 0 and -0 do not. */
static void equal_directions_are_located_once(void **state) {
  enum { COUNT = BTF_RUN_DIRECTIONS, FIRST = 3 };
  static const uint32_t lengths[] = {COUNT, 1, 7, 2}; /* of the runs */
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set;
  (void)state;
  assert_ok(btf_dirset_create_named(ctx, "grid:6x3", &set));
  for (size_t k = 0; k < sizeof lengths / sizeof *lengths; k++) {
    float column[3][FIRST + COUNT] = {{0.0f}};
    const float *const direction[3] = {column[0], column[1], column[2]};
    btf_interp places[COUNT], alone;
    uint8_t run[COUNT];
    for (uint32_t i = 0; i < COUNT; i++) {
      const float angle = 0.09f * (float)(i / lengths[k]);
      column[0][FIRST + i] = 0.6f * cosf(angle);
      column[1][FIRST + i] = 0.6f * sinf(angle);
      column[2][FIRST + i] = 0.8f;
    }
    btf_locate_runs(btfi_host(), set, direction, FIRST, COUNT, run, places);
    for (uint32_t i = 0; i < COUNT; i++) {
      const float one[3] = {column[0][FIRST + i], column[1][FIRST + i], column[2][FIRST + i]};
      assert_int_equal(run[i], i / lengths[k]);
      btf_dirset_locate(set, one, &alone);
      assert_memory_equal(alone.index, places[run[i]].index, sizeof alone.index);
      assert_memory_equal(alone.weight, places[run[i]].weight, sizeof alone.weight);
    }
    btf_locate_runs(btfi_host(), set, direction, FIRST, 1, run, places);
    assert_int_equal(run[0], 0);
  }
  const float x[3] = {0.0f, -0.0f, -0.0f}, y[3] = {0.6f, 0.6f, 0.6f}, z[3] = {0.8f, 0.8f, 0.8f};
  const float *const signs[3] = {x, y, z};
  btf_interp places[3];
  uint8_t run[3];
  btf_locate_runs(btfi_host(), set, signs, 0, 3, run, places);
  assert_true(run[0] == 0 && run[1] == 1 && run[2] == 1);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

static int by_value(const void *a, const void *b) {
  const float x = *(const float *)a, y = *(const float *)b;
  return (x > y) - (x < y);
}

/* One in a thousand samples is above the 99.9th percentile; a bin is 2^-10 of its lower edge wide at most. */
static void the_peak_is_the_percentile(void **state) {
  enum { SAMPLES = 25000 };
  static float sample[SAMPLES];
  static uint64_t histogram[BTF_PEAK_BINS];
  uint64_t seed = 7;
  (void)state;
  for (int i = 0; i < SAMPLES; i++) {
    sample[i] = (float)exp(30.0 * btf_random_unit(&seed) - 20.0);
    histogram[btf_peak_bin(sample[i])]++;
  }
  qsort(sample, SAMPLES, sizeof *sample, by_value);
  const double exact = sample[SAMPLES - 1 - SAMPLES / 1000], peak = btf_peak_of(histogram, SAMPLES);
  assert_true(peak <= exact && exact < peak * (1.0 + 1.0 / 1024.0));
  memset(histogram, 0, sizeof histogram);
  histogram[btf_peak_bin(3.0f)] = 25;
  assert_true(btf_peak_of(histogram, SAMPLES) == 0.0);
  histogram[btf_peak_bin(3.0f)] = 26;
  assert_true(btf_peak_of(histogram, SAMPLES) == 3.0);
  histogram[btf_peak_bin(3.4e38f)] = 26; /* the last bin */
  assert_true(btf_peak_of(histogram, SAMPLES) > 3.39e38);
}

static const char *const kinds[] = {"one", "two", NULL};
BTF_PARAM(rounds, BTF_PARAM_INT, "rounds of the search", "rounds", "3", NULL, 1, 64);
BTF_PARAM(kind, BTF_PARAM_CHOICE, "kind of the search", NULL, "two", kinds, 0, 0);

static void statuses_and_parameters(void **state) {
  int reached = 0;
  (void)state;
  assert_int_equal(stop_at(BTF_E_NUMERIC, &reached), BTF_E_NUMERIC);
  assert_int_equal(reached, 0);
  assert_int_equal(stop_at(BTF_OK, &reached), BTF_OK);
  assert_int_equal(reached, 1);
  assert_int_equal(rounds.struct_size, sizeof(btf_param_desc));
  assert_string_equal(rounds.name, "rounds");
  assert_string_equal(rounds.summary, "rounds of the search");
  assert_string_equal(rounds.unit, "rounds");
  assert_string_equal(rounds.default_text, "3");
  assert_true(rounds.minimum == 1.0 && rounds.maximum == 64.0 && rounds.type == BTF_PARAM_INT);
  assert_true(rounds.choices == NULL && rounds.flags == 0);
  assert_ptr_equal(kind.choices, kinds);
  assert_true(kind.type == BTF_PARAM_CHOICE && kind.unit == NULL);
}

static void chunks_have_their_size(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  const uint32_t tag = BTF_TAG('H', 'E', 'A', 'D');
  const float samples[1] = {0.5f};
  btf_dirset *set;
  btf_dataset *ds;
  btfi_payload *payload;
  const void *data = NULL;
  (void)state;
  assert_ok(btf_dirset_create_named(ctx, "grid:1x1", &set));
  desc.lights = desc.views = set;
  desc.width = desc.height = desc.channels = 1;
  desc.data = samples;
  assert_ok(btf_dataset_create(ctx, &desc, &ds));
  assert_ok(btfi_payload_create(ctx, ds, "some", 1, &payload));
  assert_ok(btfi_chunk_put(btfi_payload_writer(payload), tag, 4, 0, "0123456789", 10));
  btfi_payload_seal(payload);
  btf_chunk_reader *reader = btfi_payload_reader(payload);
  assert_ok(btf_get_chunk(btfi_host(), ctx, reader, "some", tag, 4, 10, &data));
  assert_memory_equal(data, "0123456789", 10);
  for (uint64_t size = 0; size < 30; size++)
    if (size != 10) {
      char expected[64];
      assert_status(btf_get_chunk(btfi_host(), ctx, reader, "some", tag, 4, size, &data), BTF_E_CORRUPT);
      snprintf(expected, sizeof expected, "some: chunk HEAD 4 has 10 bytes instead of %u", (unsigned)size);
      assert_message_has(expected);
    }
  assert_status(btf_get_chunk(btfi_host(), ctx, reader, "some", tag, 3, 10, &data), BTF_E_CORRUPT);
  btfi_payload_release(payload);
  btf_dataset_release(ds);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(fields_are_little_endian),
      cmocka_unit_test(random_numbers),
      cmocka_unit_test(missed_targets_are_told_as_asked),
      cmocka_unit_test(a_model_far_from_the_data_is_told),
      cmocka_unit_test(equal_directions_are_located_once),
      cmocka_unit_test(the_peak_is_the_percentile),
      cmocka_unit_test(statuses_and_parameters),
      cmocka_unit_test(chunks_have_their_size),
  };
  return btf_run("codec_header", tests);
}
