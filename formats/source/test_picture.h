/* SPDX-License-Identifier: MIT */
/* test_picture.h: JPEG pictures that decode to known codes exactly. */
#ifndef BTF_FORMATS_TEST_PICTURE_H
#define BTF_FORMATS_TEST_PICTURE_H

#include <stddef.h>

/* The code of a square of 8 x 8 pixels; rows are counted from the top of the picture. */
typedef unsigned char (*test_code_fn)(const void *user, int column, int row, int channel);
/* A picture whose squares have one code each: without a change of colours and with steps of 1 nothing is
 * lost. Of one channel or three; from malloc. */
unsigned char *test_squares_jpeg(int width, int height, int channels, test_code_fn code, const void *user,
                                 size_t *size);

#endif
