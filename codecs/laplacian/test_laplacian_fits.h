/* SPDX-License-Identifier: MIT */
/* test_laplacian_fits.h: fits and pictures for the suites of this codec. */
#ifndef LAPLACIAN_TEST_FITS_H
#define LAPLACIAN_TEST_FITS_H

#include "laplacian.h" /* before cmocka, whose fail() is a macro */

#include "../fmf/test_materials.h" /* data sets */

/* Options as "name=value name=value". */
btf_status laplacian_try_fit(btf_context *ctx, const btf_dataset *ds, const char *settings,
                             const btf_job *job, btf_model **out);
btf_model *laplacian_fit(btf_context *ctx, const material *m, const char *settings);
const btfi_laplacian_state *laplacian_state(const btf_model *model);
/* Squared error of level 0, by decoding every sample. */
double laplacian_squared_error(const btf_model *model, const material *m);

/* Level `level` of a channel of an image, in double and by definition: periodic or clamped, from level 0. The
 * mean filter as area averages of neighbours, the paper's as boxes around every second texel. Even sizes only
 * for those; any size for the mean filter at level 1. From malloc. */
double *low_pass(const double *image, uint32_t width, uint32_t height, uint32_t filter, uint32_t wrap,
                 uint32_t level);
/* Channel of an image of a data set, as Y, Cb or Cr by JPEG's matrix in double. From malloc. */
double *image_channel(const material *m, uint32_t light, uint32_t view, uint32_t channel);

#endif
