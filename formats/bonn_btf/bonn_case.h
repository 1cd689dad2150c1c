/* SPDX-License-Identifier: MIT */
/* bonn_case.h: files of Bonn's containers with known contents, written from the description of the format,
 * and their samples by brute force in double. */
#ifndef BTF_FORMATS_BONN_CASE_H
#define BTF_FORMATS_BONN_CASE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

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
} bonn_case;

typedef struct bonn_bytes {
  unsigned char *data; /* from malloc */
  size_t size, room;
  size_t marks[64]; /* offsets of counts and sizes */
  uint32_t mark_count;
} bonn_bytes;

/* Angles in radians of view or light i of n. */
void bonn_case_angles(uint32_t i, uint32_t n, bool light, float *theta, float *phi);
bonn_bytes bonn_case_write(const bonn_case *c);
/* The sample as the reader should give it: row 0 is the bottom one. */
double bonn_case_sample(const bonn_case *c, uint32_t view, uint32_t light, uint32_t x, uint32_t y,
                        uint32_t channel);

extern const bonn_case bonn_cases[];
extern const size_t bonn_case_count;

#endif
