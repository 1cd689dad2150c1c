/* SPDX-License-Identifier: MIT */
/* xoshiro256** of Blackman and Vigna, seeded by splitmix64 as its authors advise. */
#include "base/base.h"

#include <math.h>

static uint64_t rotate_left(uint64_t x, unsigned n) {
  return x << n | x >> (64 - n);
}

void btfi_random_seed(btfi_random *r, uint64_t seed) {
  for (int i = 0; i < 4; i++) {
    seed += 0x9e3779b97f4a7c15u;
    uint64_t z = seed;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    r->s[i] = z ^ z >> 31;
  }
}

uint64_t btfi_random_u64(btfi_random *r) {
  uint64_t *s = r->s;
  const uint64_t result = rotate_left(s[1] * 5, 7) * 9;
  const uint64_t shifted = s[1] << 17;
  s[2] ^= s[0];
  s[3] ^= s[1];
  s[1] ^= s[2];
  s[0] ^= s[3];
  s[2] ^= shifted;
  s[3] = rotate_left(s[3], 45);
  return result;
}

float btfi_random_float(btfi_random *r) {
  return (float)(btfi_random_u64(r) >> 40) * 0x1p-24f;
}

float btfi_random_normal(btfi_random *r) {
  /* Box and Muller; the radius takes a number of (0, 1] so that its logarithm is finite. */
  const double radius = sqrt(-2.0 * log((double)((btfi_random_u64(r) >> 11) + 1) * 0x1p-53));
  const double angle = 6.283185307179586 * ((double)(btfi_random_u64(r) >> 11) * 0x1p-53);
  return (float)(radius * cos(angle));
}

uint64_t btfi_random_below(btfi_random *r, uint64_t n) {
  /* Of the 2^64 draws the first 2^64 mod n are dropped, which leaves a multiple of n. */
  const uint64_t dropped = (0 - n) % n;
  for (;;) {
    const uint64_t draw = btfi_random_u64(r);
    if (draw >= dropped) return draw % n;
  }
}
