/* SPDX-License-Identifier: MIT */
/* dataset_cube.h: small data sets of random samples whose every value can be told without the library. */
#ifndef DATASET_CUBE_H
#define DATASET_CUBE_H

#include "btf_test.h"

/* Random finite samples; number (((v * L + l) * H + y) * W + x) * C + c of `image_major`, and the same by
 * texels. */
typedef struct test_cube {
  uint32_t views, lights, height, width, channels, type, size;
  size_t count;
  unsigned char *image_major, *texel_major;
  btf_dirset *view_set, *light_set;
} test_cube;

uint32_t test_random(uint64_t *state);
float test_uniform(uint64_t *state); /* 0 .. 1 */
/* n directions in a spiral over the hemisphere, turned by `phase`. */
btf_dirset *test_spiral(btf_context *ctx, uint32_t n, double phase);
void test_cube_make(btf_context *ctx, test_cube *cube, uint32_t type, uint32_t views, uint32_t lights,
                    uint32_t height, uint32_t width, uint32_t channels, uint64_t seed);
void test_cube_free(test_cube *cube);
/* A sample decoded by arithmetic of its own. */
float test_cube_value(const test_cube *cube, uint32_t v, uint32_t l, uint32_t y, uint32_t x, uint32_t c);
btf_strides test_cube_strides(const test_cube *cube, uint32_t order, ptrdiff_t size);
btf_dataset_desc test_cube_desc(const test_cube *cube);

enum { TEST_RESIDENT, TEST_CALLBACK, TEST_CONCURRENT, TEST_MAPPED, TEST_SOURCES };
/* The cube as a data set of one kind. The mapped one is written to `folder` without the library. */
btf_dataset *test_cube_dataset(btf_context *ctx, const test_cube *cube, uint32_t order, int source,
                               const char *folder);
/* A folder with the cube's samples and a manifest in which `replace` (may be NULL) stands instead of `find`.
 */
void test_cube_write_folder(const test_cube *cube, uint32_t order, const char *folder, const char *find,
                            const char *replace);

#endif
