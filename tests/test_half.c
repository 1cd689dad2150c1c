/* SPDX-License-Identifier: MIT */
/* Half floats against their definition and against a search for the nearest. */
#include "btf_test.h"

#include <btf/btf_half.h>

#include "base/base.h"

enum { first_infinity = 0x7c00 };
static double
    half_values[first_infinity + 1]; /* of the halves 0 to infinity; the last as if the exponent went on */

static void fill_half_values(void) {
  for (int h = 0; h <= first_infinity; h++) {
    const int exponent = h >> 10, fraction = h & 0x3ff;
    half_values[h] = exponent ? ldexp(1024 + fraction, exponent - 25) : ldexp(fraction, -24);
  }
}

/* The nearest half by bisection, the even one on a tie; infinity when it would be nearest if it were 65536.
 */
static uint16_t nearest_half(float value) {
  const double magnitude = fabs((double)value);
  const uint16_t sign = signbit(value) ? 0x8000u : 0;
  int low = 0, high = first_infinity;
  if (magnitude >= half_values[first_infinity]) return (uint16_t)(sign | first_infinity);
  while (high - low > 1) {
    const int middle = (low + high) / 2;
    if (half_values[middle] <= magnitude)
      low = middle;
    else
      high = middle;
  }
  const double below = magnitude - half_values[low], above = half_values[high] - magnitude;
  const int chosen = below < above || (below == above && low % 2 == 0) ? low : high;
  return (uint16_t)(sign | chosen);
}

static void every_half_has_its_value_and_returns(void **state) {
  (void)state;
  for (uint32_t h = 0; h < 65536; h++) {
    const uint16_t magnitude = h & 0x7fff;
    const float value = btf_half_to_float((uint16_t)h);
    assert_int_equal(signbit(value) != 0, h >> 15);
    if (magnitude > first_infinity) {
      assert_true(isnan(value));
      assert_true((btf_float_to_half(value) & 0x7fff) > first_infinity);
      continue;
    }
    if (magnitude == first_infinity)
      assert_true(isinf(value));
    else
      assert_true(fabs((double)value) == half_values[magnitude]);
    assert_int_equal(btf_float_to_half(value), h);
  }
}

static void expect_nearest(float value) {
  if (btf_float_to_half(value) != nearest_half(value))
    fail_msg("%a becomes %04x, the nearest half is %04x", (double)value, btf_float_to_half(value),
             nearest_half(value));
}

static void ties_go_to_even(void **state) {
  (void)state;
  for (int h = 0; h < first_infinity; h++) {
    const float middle =
        (float)((half_values[h] + half_values[h + 1]) / 2); /* exact: one more bit than a half */
    for (int side = 0; side < 2; side++) {
      const float sign = side ? -1.0f : 1.0f;
      expect_nearest(sign * middle);
      expect_nearest(sign * nextafterf(middle, 0.0f));
      expect_nearest(sign * nextafterf(middle, INFINITY));
    }
  }
  assert_int_equal(btf_float_to_half(65519.996f), 0x7bff);
  assert_int_equal(btf_float_to_half(65520.0f), first_infinity);
  assert_int_equal(btf_float_to_half(-INFINITY), 0xfc00);
  assert_int_equal(btf_float_to_half(0x1p-25f), 0);
  assert_int_equal(btf_float_to_half(0x1.000002p-25f), 1);
}

static void any_float_becomes_the_nearest_half(void **state) {
  (void)state;
  btfi_random random;
  btfi_random_seed(&random, 16);
  for (int i = 0; i < 1000000; i++) {
    uint32_t bits = (uint32_t)btfi_random_u64(&random);
    float value;
    memcpy(&value, &bits, sizeof value);
    if (!isnan(value)) expect_nearest(value);
    /* The same fraction and sign with an exponent from half the least subnormal half to beyond the largest.
     */
    bits = (bits & 0x807fffffu) | (uint32_t)(127 - 27 + btfi_random_below(&random, 45)) << 23;
    memcpy(&value, &bits, sizeof value);
    expect_nearest(value);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_half_has_its_value_and_returns),
      cmocka_unit_test(ties_go_to_even),
      cmocka_unit_test(any_float_becomes_the_nearest_half),
  };
  fill_half_values();
  return btf_run("half", tests);
}
