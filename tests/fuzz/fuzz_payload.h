/* SPDX-License-Identifier: MIT */
/* fuzz_payload.h: chunks of any bytes go straight to a codec's loader, below all checksums; what loads is
 * evaluated with the kernels of each instruction set. */
#ifndef FUZZ_PAYLOAD_H
#define FUZZ_PAYLOAD_H

#include "fuzz.h"

#include "container/container.h"

/* Names of direction sets of a hostile shape. */
enum { FUZZ_SETS = 4 };
extern const char *const fuzz_set_names[FUZZ_SETS];

typedef struct fuzz_shape {
  uint32_t width, height, channels, quantity, wrap;
  const char *lights, *views;
} fuzz_shape;

/* Writes the chunks of a model of that shape, taking from the input what it needs. Returns 0 if it left out
 * what the loader must have. */
typedef int (*fuzz_write_fn)(void *user, btf_chunk_writer *to, const btf_model_shape *shape, fuzz_bytes *in);

/* For each instruction set: writes, loads and, if it loads, evaluates; what is left of the input are queries.
 */
void fuzz_payload_check(const char *codec, const fuzz_shape *shape, fuzz_write_fn write, void *user,
                        fuzz_bytes in);

#endif
