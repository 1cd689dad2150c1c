/* SPDX-License-Identifier: MIT */
/* merl.h: tables over half and difference angles, as of the MERL BRDF database. */
#ifndef BTF_FORMATS_MERL_H
#define BTF_FORMATS_MERL_H

#include "source/one_texel.h"

enum {
  MERL_THETA_H = 90,
  MERL_THETA_D = 90,
  MERL_PHI_D = 180,
  MERL_BINS = MERL_THETA_H * MERL_THETA_D * MERL_PHI_D,
  MERL_HEADER = 12,
  MERL_SIZE = MERL_HEADER + 3 * 8 * MERL_BINS
};

/* f of the bin that the pair of directions falls into. */
void merl_nearest(const one_texel *brdf, const double light[3], const double view[3], double *out);
/* f between the centres of the eight bins around, of which those without a measurement do not count. */
void merl_linear(const one_texel *brdf, const double light[3], const double view[3], double *out);

#endif
