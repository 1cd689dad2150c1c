/* SPDX-License-Identifier: MIT */
/* machine_bounds.h: what one core of this machine can do at most, measured. */
#ifndef MACHINE_BOUNDS_H
#define MACHINE_BOUNDS_H

#include <stddef.h>
#include <stdint.h>

typedef struct machine_bounds {
  double convert_f16;  /* half floats converted, multiplied and added from the first-level cache, per second */
  double convert_bf16; /* the same for bfloat16 taken in pairs */
  double convert_q8;
  double fma_values;   /* multiplied and added in registers, per second */
} machine_bounds;

double machine_now(void);      /* seconds */
double machine_cpu_time(void); /* seconds this thread has run: what other programs take does not count */
/* Runs one round and keeps the best of each figure; `isa` as btf_context_isa says. Zeros where it has no code. */
void machine_measure(const char *isa, machine_bounds *best);
/* Seconds to touch one row of `row_bytes` at random in a table, with rows asked for ahead of time. */
double machine_fetch(const unsigned char *table, uint64_t rows, size_t row_step, size_t row_bytes);

#endif
