/* SPDX-License-Identifier: MIT */
/* lp.h: a list of photographs with the position of the light of each. */
#ifndef BTF_FORMATS_LP_H
#define BTF_FORMATS_LP_H

#include "source/picture.h"
#include "source/source_file.h"

enum { LP_MOST_LIGHTS = 4096 };

typedef struct lp_file {
  source_file file; /* the list */
  uint32_t count;
  char *text;        /* the list, in which names end with NUL */
  uint32_t *names;   /* where in it the name of each photograph begins */
  float *directions; /* x y z, of length 1 */
  btf_dirset *lights, *views;
  picture_info info; /* what every photograph is */
  picture_rules rules;
  uint16_t *table;  /* sample of each code */
  uint16_t *pixels; /* the photograph decoded last, rows from the bottom */
  uint32_t decoded; /* its number; UINT32_MAX = none */
} lp_file;

/* Whether text begins as a list does. */
bool lp_looks_right(const btf_host *host, const unsigned char *text, size_t size);
/* Fills count, text, names and directions. */
btf_status lp_read_lights(lp_file *lp);

#endif
