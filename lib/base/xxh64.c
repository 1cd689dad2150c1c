/* SPDX-License-Identifier: MIT */
/* XXH64, written from its published specification. */
#include "base/base.h"

#include <string.h>

#define PRIME_1 0x9e3779b185ebca87u
#define PRIME_2 0xc2b2ae3d27d4eb4fu
#define PRIME_3 0x165667b19e3779f9u
#define PRIME_4 0x85ebca77c2b2ae63u
#define PRIME_5 0x27d4eb2f165667c5u

enum { stripe_size = 32 };

static uint64_t rotate_left(uint64_t x, unsigned n) {
  return x << n | x >> (64 - n);
}

static uint64_t load_u64(const unsigned char *p) {
#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
  uint64_t v;
  memcpy(&v, p, sizeof v);
  return v;
#else
  uint64_t v = 0;
  for (int i = 7; i >= 0; i--) v = v << 8 | p[i];
  return v;
#endif
}

static uint32_t load_u32(const unsigned char *p) {
  return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static uint64_t mix(uint64_t lane, uint64_t input) {
  return rotate_left(lane + input * PRIME_2, 31) * PRIME_1;
}

/* Feeds whole stripes, one 8-byte word to each of the four lanes. */
static void consume_stripes(uint64_t lane[4], const unsigned char *p, size_t stripes) {
  uint64_t a = lane[0], b = lane[1], c = lane[2], d = lane[3];
  for (; stripes > 0; stripes--, p += stripe_size) {
    a = mix(a, load_u64(p));
    b = mix(b, load_u64(p + 8));
    c = mix(c, load_u64(p + 16));
    d = mix(d, load_u64(p + 24));
  }
  lane[0] = a;
  lane[1] = b;
  lane[2] = c;
  lane[3] = d;
}

void btfi_xxh64_init(btfi_xxh64 *state, uint64_t seed) {
  memset(state, 0, sizeof *state);
  state->seed = seed;
  state->lane[0] = seed + PRIME_1 + PRIME_2;
  state->lane[1] = seed + PRIME_2;
  state->lane[2] = seed;
  state->lane[3] = seed - PRIME_1;
}

void btfi_xxh64_update(btfi_xxh64 *state, const void *data, size_t size) {
  const unsigned char *p = data;
  if (size == 0) return;
  state->total += size;
  if (state->pending_size > 0) {
    const size_t taken = BTFI_MIN(size, (size_t)stripe_size - state->pending_size);
    memcpy(state->pending + state->pending_size, p, taken);
    state->pending_size += (uint32_t)taken;
    p += taken;
    size -= taken;
    if (state->pending_size < stripe_size) return;
    consume_stripes(state->lane, state->pending, 1);
    state->pending_size = 0;
  }
  consume_stripes(state->lane, p, size / stripe_size);
  p += size / stripe_size * stripe_size;
  state->pending_size = (uint32_t)(size % stripe_size);
  memcpy(state->pending, p, state->pending_size);
}

uint64_t btfi_xxh64_digest(const btfi_xxh64 *state) {
  uint64_t hash = state->seed + PRIME_5;
  if (state->total >= stripe_size) {
    const uint64_t *lane = state->lane;
    hash = rotate_left(lane[0], 1) + rotate_left(lane[1], 7) + rotate_left(lane[2], 12) +
           rotate_left(lane[3], 18);
    for (int i = 0; i < 4; i++) hash = (hash ^ mix(0, lane[i])) * PRIME_1 + PRIME_4;
  }
  hash += state->total;

  const unsigned char *p = state->pending, *end = p + state->pending_size;
  for (; end - p >= 8; p += 8) hash = rotate_left(hash ^ mix(0, load_u64(p)), 27) * PRIME_1 + PRIME_4;
  for (; end - p >= 4; p += 4) hash = rotate_left(hash ^ load_u32(p) * PRIME_1, 23) * PRIME_2 + PRIME_3;
  for (; p < end; p++) hash = rotate_left(hash ^ *p * PRIME_5, 11) * PRIME_1;

  hash = (hash ^ hash >> 33) * PRIME_2;
  hash = (hash ^ hash >> 29) * PRIME_3;
  return hash ^ hash >> 32;
}

uint64_t btfi_xxh64_of(const void *data, size_t size) {
  btfi_xxh64 state;
  btfi_xxh64_init(&state, 0);
  btfi_xxh64_update(&state, data, size);
  return btfi_xxh64_digest(&state);
}
