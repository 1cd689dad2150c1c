/* SPDX-License-Identifier: MIT */
/* fuzz.h: what every fuzz target uses. A target defines LLVMFuzzerTestOneInput, which takes any bytes, and
 * calls fuzz_expect for what must hold whatever they are. Inputs under corpus/NAME are replayed by the test
 * fuzz_NAME. */
#ifndef BTF_FUZZ_H
#define BTF_FUZZ_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <btf/btf.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#define fuzz_expect(condition)                                                                               \
  do {                                                                                                       \
    if (!(condition)) {                                                                                      \
      fprintf(stderr, "%s:%d: %s does not hold; last message: %s\n", __FILE__, __LINE__, #condition,         \
              btf_error_message());                                                                          \
      abort();                                                                                               \
    }                                                                                                        \
  } while (0)

/* An input that is taken apart from the front; beyond its end are zeros. */
typedef struct fuzz_bytes {
  const uint8_t *data;
  size_t size;
} fuzz_bytes;

static inline void fuzz_take(fuzz_bytes *in, void *dst, size_t n) {
  const size_t there = n < in->size ? n : in->size;
  memset(dst, 0, n);
  if (there == 0) return;
  memcpy(dst, in->data, there);
  in->data += there;
  in->size -= there;
}

static inline uint32_t fuzz_u8(fuzz_bytes *in) {
  uint8_t value;
  fuzz_take(in, &value, sizeof value);
  return value;
}

static inline uint32_t fuzz_u16(fuzz_bytes *in) {
  const uint32_t low = fuzz_u8(in);
  return low | fuzz_u8(in) << 8;
}

/* A context with one thread and at most `max_memory` bytes, so that hostile sizes show as BTF_E_LIMIT. */
static inline btf_context *fuzz_context(uint64_t max_memory) {
  btf_limits limits = BTF_LIMITS_INIT;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx = NULL;
  limits.max_memory = max_memory;
  desc.limits = &limits;
  desc.max_threads = 1;
  fuzz_expect(btf_context_create(&desc, &ctx) == BTF_OK);
  return ctx;
}

#endif
