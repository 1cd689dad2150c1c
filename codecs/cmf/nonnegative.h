/* SPDX-License-Identifier: MIT */
/* nonnegative.h: non-negative factorisation of a small matrix by hierarchical alternating least squares. */
#ifndef BTFI_CMF_NONNEGATIVE_H
#define BTFI_CMF_NONNEGATIVE_H

#include <stddef.h>
#include <stdint.h>

#include <btf/btf_plugin.h>

/* a (rows x columns, a_ld floats a row) ~ sum over k < rank of p[i * rank + k] q[j * rank + k], all >= 0.
 * `weight` (rows x columns without gaps, >= 0) weights squared errors, NULL = 1; where it is 0, a may be
 * anything finite. Components come one after the other by power iterations on what is left, then all are
 * improved in turn for at most `sweeps` sweeps or until one gains less than `tolerance` of the error. cost
 * (sweeps + 1 values; may be NULL) receives the weighted squared error before the first and after each sweep
 * done, *done their number. Runs on the calling thread, which may be that of a task, with
 * btfi_cmf_nonnegative_scratch floats of scratch (aligned to 8 bytes). */
uint64_t btfi_cmf_nonnegative_scratch(uint32_t rows, uint32_t columns);
void btfi_cmf_nonnegative(uint32_t rows, uint32_t columns, const float *a, size_t a_ld, const float *weight,
                          uint32_t rank, uint32_t sweeps, double tolerance, float *scratch, float *p,
                          float *q, double *cost, uint32_t *done);

#endif
