/* SPDX-License-Identifier: MIT */
/* test_one_view.h: what the suites of formats with many lights and one view share beside test_format.h. */
#ifndef BTF_FORMATS_TEST_ONE_VIEW_H
#define BTF_FORMATS_TEST_ONE_VIEW_H

#include "test_format.h"

/* What the camera would have recorded, 0 to 1; y = 0 is the bottom row. */
typedef double (*one_view_recorded)(const void *user, const double light[3], int x, int y, int channel);
/* Opens the path as detected, which must be as `id`, and compares all samples with what is recorded, made
 * linear by sRGB's curve and taken as it is. `settings` as in format_try, without transfer. Its tolerance is
 * `relative` of the larger of 1 and the sample, before the curve. */
void one_view_check_all(const char *path, const char *id, const char *const *settings, int width, int height,
                        one_view_recorded recorded, const void *user, double relative);
/* Hemispherical harmonics up to degree 3 of a unit vector, from the definition of associated Legendre
 * functions. */
void one_view_harmonics(const double light[3], double out[16]);

#endif
