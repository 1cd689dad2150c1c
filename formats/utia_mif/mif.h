/* SPDX-License-Identifier: MIT */
/* mif.h: UTIA's multi-image container. */
#ifndef BTF_FORMATS_MIF_H
#define BTF_FORMATS_MIF_H

#include "source/source_file.h"

typedef struct mif_file {
  source_file file;
  const unsigned char *xml; /* not terminated */
  uint64_t xml_size, chunks;
  btf_dirset *lights, *views;
  uint32_t light_count, view_count;
  uint32_t type, width, height, channels; /* type is that of the container: 9 half, 10 float, 11 double */
  const unsigned char **images;           /* pixels of image light + lights * view */
  bool xyz;
} mif_file;

bool mif_is_signature(const unsigned char *data, uint64_t size);
/* Checks the chunks, makes the direction sets and finds the images. */
btf_status mif_parse(mif_file *mif);

#endif
