/* SPDX-License-Identifier: MIT */
/* kernel.h: numbers that the kernels agree on. */
#ifndef BTFI_LAFORTUNE_KERNEL_H
#define BTFI_LAFORTUNE_KERNEL_H

#include "lafortune.h"

#define LAF_LN2 0.693147180559945309f
#define LAF_LOG2_E 1.44269504088896341f
#define LAF_WARD_NORM 0.0795774715459476679f /* 1 / (4 pi) */
#define LAF_LEWIS_NORM 0.159154943091895336f /* 1 / (2 pi) */
/* Base-2 logarithm below which a lobe counts as 0 while it is fitted: its square must not be subnormal. */
#define LAF_SMALLEST_LOG (-60.0f)
/* Logarithm of how much higher a lobe may be between and beyond the samples than at any of them: what nobody
 * measured must not outshine everything. */
#define LAF_MOST_GROWTH 4.0f
/* Share of the peak at which the derivative by the base stops growing: with exponents below 1 it has a pole
 * at 0. */
#define LAF_SMALLEST_BASE 1e-4f

/* Coefficients that are variables of the fit. */
static inline uint32_t btfi_lafortune_free_terms(uint32_t kind) {
  return kind == LAF_DIAGONAL ? 3u : kind == LAF_FULL ? 9u : 0u;
}
/* Variables of a lobe: its coefficients and the logarithm of its exponent; Ward's logarithms of both
 * coefficients. */
static inline uint32_t btfi_lafortune_variables(uint32_t kind) {
  return kind == LAF_WARD ? 2u : btfi_lafortune_free_terms(kind) + 1u;
}

#endif
