/* SPDX-License-Identifier: MIT */
/* bonn_case.h: files of Bonn's containers with known contents, written from the description of the format,
 * and their samples by brute force in double. */
#ifndef BTF_FORMATS_BONN_CASE_H
#define BTF_FORMATS_BONN_CASE_H

#include <stdbool.h>

#include "../source/test_format.h"

enum { BONN_CASE_FMF, BONN_CASE_DFMF, BONN_CASE_PVF, BONN_CASE_BDI };

typedef struct bonn_case {
  const char *label, *signature; /* with its R, if any */
  int family;
  uint32_t version, scalar_size, views, lights, width, height, channels, components;
  bool transposed, legacy;
  uint32_t cosine, colour_model, dynamic_range;
  uint32_t rotations, rotation_bytes; /* in files whose signature ends with R */
  uint32_t chunk_rows;                /* BDI */
  bool holes;                         /* BDI: sparse, without every third texel */
  uint32_t setup_bytes;               /* of XML, for sizes that look like an R */
  bool uneven;                        /* numbers of all the bits that the scalar has, or a float */
  bool own_lights;                    /* of each view, instead of `lights`: bonn_case_light */
  float drift;                        /* radians by which lights lie lower from one view to the next */
} bonn_case;

typedef struct bonn_bytes {
  unsigned char *data; /* from malloc */
  size_t size, room;
  size_t marks[64]; /* offsets of counts and sizes */
  uint32_t mark_count;
} bonn_bytes;

/* Angles in radians of view or light i of n. */
void bonn_case_angles(uint32_t i, uint32_t n, bool light, float *theta, float *phi);
/* Lights of a view, and their angles. With own_lights a list is a triangle, at times with one light inside,
 * or a single light: a large triangle, a small one with a light inside, a single light, a large one with a
 * light inside, what the second has, and so on. The small one is inside of the large ones. */
uint32_t bonn_case_lights(const bonn_case *c, uint32_t view);
void bonn_case_light(const bonn_case *c, uint32_t view, uint32_t light, float *theta, float *phi);
/* A set that the reader made of `count` of bonn_case_angles. */
void bonn_case_check_directions(const btf_dirset *set, uint32_t count, bool light);
bonn_bytes bonn_case_write(const bonn_case *c);
/* The sample as the reader should give it: row 0 is the bottom one. */
double bonn_case_sample(const bonn_case *c, uint32_t view, uint32_t light, uint32_t x, uint32_t y,
                        uint32_t channel);

/* What rounding of a sample scales with, where it is a sum: the sum of the sizes of all products in it. */
double bonn_case_size(const bonn_case *c, uint32_t view, uint32_t light, uint32_t x, uint32_t y,
                      uint32_t channel);

/* The case of that label. */
bonn_case bonn_case_named(const char *label);

extern const bonn_case bonn_cases[];
extern const size_t bonn_case_count;

#endif
