/* SPDX-License-Identifier: MIT */
/* srgb.h: sRGB's curve. */
#ifndef BTF_FORMATS_SRGB_H
#define BTF_FORMATS_SRGB_H

#include <math.h>

/* Linear light of a coded value. Beyond 1 the curve goes on, below 0 it is turned about 0. */
static inline double srgb_linear(double value) {
  const double size = fabs(value);
  return copysign(size <= 0.04045 ? size / 12.92 : pow((size + 0.055) / 1.055, 2.4), value);
}

#endif
