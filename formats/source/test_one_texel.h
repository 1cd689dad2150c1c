/* SPDX-License-Identifier: MIT */
/* test_one_texel.h: what the suites of formats with one texel share beside test_format.h. */
#ifndef BTF_FORMATS_TEST_ONE_TEXEL_H
#define BTF_FORMATS_TEST_ONE_TEXEL_H

#include "test_format.h"

/* Receives each pair of directions with the sample that was read for it. */
typedef void (*one_texel_check)(const double light[3], const double view[3], const float *sample);
/* Opens the file as detected, which must be as `id`, and reads all samples in blocks of one view. */
void one_texel_check_all(const char *path, const char *id, const char *const *settings, uint32_t quantity,
                         one_texel_check check);
/* The angles of a direction in degrees; phi from 0 up to 360. */
void one_texel_angles(const double d[3], double *theta, double *phi);

#endif
