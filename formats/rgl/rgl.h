/* SPDX-License-Identifier: MIT */
/* rgl.h: BRDFs in the adaptive parameterisation of Dupuy and Jakob (2018), in tensor files of the RGL
 * database. */
#ifndef BTF_FORMATS_RGL_H
#define BTF_FORMATS_RGL_H

#include "source/one_texel.h"

enum { RGL_MOST_FIELDS = 64, RGL_MOST_RANK = 8, RGL_MOST_CHANNELS = 64, RGL_U8 = 1, RGL_F32 = 10 };

typedef struct rgl_field {
  const unsigned char *name; /* not terminated */
  uint32_t name_length, rank, type;
  uint64_t shape[RGL_MOST_RANK];
  const unsigned char *data;
  uint64_t elements;
} rgl_field;

/* A grid of floats over the unit square, columns fastest; many of them follow one another. */
typedef struct rgl_grid {
  const unsigned char *data;
  uint32_t rows, columns; /* at least 2 */
} rgl_grid;

typedef struct rgl_brdf {
  one_texel base;
  rgl_field fields[RGL_MOST_FIELDS];
  uint32_t field_count;
  const unsigned char *thetas, *phis; /* of the first direction, floats in ascending order */
  uint32_t theta_count, phi_count;
  rgl_grid ndf, sigma;    /* one each */
  rgl_grid vndf;          /* for each phi and theta */
  rgl_grid values;        /* for each phi, theta and band */
  uint32_t bands, step;   /* every step-th band is a channel */
  double *row_sums;       /* of vndf, for each phi, theta and row */
  double *totals;         /* of vndf, for each phi and theta */
  bool jacobian;          /* values are divided by what ndf and sigma give */
  uint32_t symmetry;      /* 1; 2: the same after half a turn; 4: mirrored at both axes */
  double symmetry_middle; /* azimuth in the middle of what was measured */
} rgl_brdf;

/* Reads the list of fields; the data of each is inside the file. */
btf_status rgl_read_fields(rgl_brdf *brdf);
/* NULL if there is none. */
const rgl_field *rgl_find(const rgl_brdf *brdf, const char *name);

/* Sums for the warp, after checking that it is one. */
btf_status rgl_prepare(rgl_brdf *brdf);
void rgl_eval(const one_texel *base, const double light[3], const double view[3], double *out);

#endif
