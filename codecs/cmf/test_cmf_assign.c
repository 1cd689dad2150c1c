/* SPDX-License-Identifier: MIT */
/* Vectors are with the nearest entry exactly: close entries, ties, extreme scales. */
#include "test_cmf_vectors.h"

static test_memory memory;

static void check_assign(btf_context *ctx, const sample *s, const float *values, uint32_t entries) {
  const btfi_cmf_vectors vectors = vectors_of(s);
  uint32_t *index = malloc(s->count * sizeof *index);
  double *distance = malloc(s->count * sizeof *distance);
  assert_ok(btfi_cmf_assign(btfi_host(), ctx, &vectors, values, entries, 0, NULL, 0, 1, "", index, distance));
  expect_nearest(s, values, entries, index, distance);
  free(index);
  free(distance);
}

static void test_assignment_is_exact(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const uint32_t lengths[] = {1, 7, 64, 511, 513, 1100};
  for (uint32_t l = 0; l < 6; l++) {
    uint64_t seed = 100 + l;
    const sample s = sample_curves(90, lengths[l], seed), book = sample_curves(31, lengths[l], seed + 50);
    check_assign(ctx, &s, book.values, 31);
    free(s.values);
    free(book.values);
  }
  /* Entries that differ by far less than they are from zero, among them equal ones; vectors that are some of
   * them. */
  uint64_t seed = 8;
  sample s = sample_create(120, 300), book = sample_create(40, 300);
  for (uint64_t i = 0; i < 40 * 300; i++) book.values[i] = (float)(1000.0 + 0.001 * random_normal(&seed));
  memcpy(book.values + 7 * 300, book.values + 3 * 300, 300 * sizeof(float));
  memcpy(book.values + 39 * 300, book.values, 300 * sizeof(float));
  for (uint64_t i = 0; i < 120 * 300; i++) s.values[i] = (float)(1000.0 + 100.0 * random_normal(&seed));
  for (uint64_t e = 0; e < 40; e++) memcpy(s.values + e * 300, book.values + e * 300, 300 * sizeof(float));
  check_assign(ctx, &s, book.values, 40);
  /* Vectors half-way between two entries: rounding them to floats decides, by less than products in floats
   * can tell. */
  for (uint64_t i = 0; i < 40 * 300; i++) book.values[i] = (float)random_normal(&seed);
  for (uint64_t v = 0; v < 120; v++)
    for (uint64_t i = 0; i < 300; i++)
      s.values[v * 300 + i] =
          0.5f * (book.values[v % 40 * 300 + i] + book.values[(v + 1 + v / 40) % 40 * 300 + i]);
  check_assign(ctx, &s, book.values, 40);
  free(s.values);
  free(book.values);
  test_context_done(ctx, &memory);
}

/* Scaling by powers of two scales everything exactly, as long as squares fit a double. */
static void test_extreme_scales(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const sample s = sample_curves(60, 80, 21), book = sample_curves(10, 80, 22);
  const int exponents[] = {-140, -70, -20, 60, 64, 120, 126};
  uint32_t expected[60], index[60];
  const btfi_cmf_vectors vectors = vectors_of(&s);
  assert_ok(btfi_cmf_assign(btfi_host(), ctx, &vectors, book.values, 10, 0, NULL, 0, 1, "", expected, NULL));
  for (uint32_t e = 0; e < 7; e++) {
    sample scaled = sample_create(60, 80), entries = sample_create(10, 80);
    for (uint32_t i = 0; i < 60 * 80; i++) scaled.values[i] = ldexpf(s.values[i], exponents[e]);
    for (uint32_t i = 0; i < 10 * 80; i++) entries.values[i] = ldexpf(book.values[i], exponents[e]);
    const btfi_cmf_vectors of = vectors_of(&scaled);
    assert_ok(btfi_cmf_assign(btfi_host(), ctx, &of, entries.values, 10, 0, NULL, 0, 1, "", index, NULL));
    if (exponents[e] > -140) /* where elements lose bits, exactness is all that is left */
      assert_memory_equal(index, expected, sizeof index);
    expect_nearest(&scaled, entries.values, 10, index, NULL);
    btfi_cmf_codebook made = make_codebook(ctx, &scaled, CMF_KMEANS, 9, 1);
    expect_nearest(&scaled, made.values, made.entries, made.index, NULL);
    free_codebook(ctx, &made);
    free(scaled.values);
    free(entries.values);
  }
  /* Products overflow although the entries' squares do not. */
  sample far = sample_create(60, 80);
  for (uint32_t i = 0; i < 60 * 80; i++) far.values[i] = ldexpf(s.values[i], 72);
  for (uint32_t i = 0; i < 10 * 80; i++)
    book.values[i] = ldexpf(book.values[i], 56) * (i / 80 % 2 ? -1.0f : 1.0f);
  check_assign(ctx, &far, book.values, 10);
  free(far.values);
  free(s.values);
  free(book.values);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_assignment_is_exact),
      cmocka_unit_test(test_extreme_scales),
  };
  return btf_run("cmf_assign", tests);
}
