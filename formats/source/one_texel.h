/* SPDX-License-Identifier: MIT */
/* one_texel.h: a measured BRDF as a data set of one texel, evaluated where it is read. */
#ifndef BTF_FORMATS_ONE_TEXEL_H
#define BTF_FORMATS_ONE_TEXEL_H

#include "source/source_file.h"

/* The parameter `directions` of every such format; before its list of parameters. */
#define ONE_TEXEL_DIRECTIONS                                                                                 \
  BTF_PARAM(                                                                                                 \
      directions, BTF_PARAM_STRING,                                                                          \
      "lights and views that it is evaluated for: ubo81, ubo151 or grid:PxT (P azimuths, T elevations)",     \
      NULL, "ubo81", NULL, 0, 0)

/* The first member of a format's state. */
typedef struct one_texel {
  source_file file;
  btf_dirset *directions;
  uint32_t channels;
  /* All channels for unit vectors above the horizon. */
  void (*eval)(const struct one_texel *brdf, const double light[3], const double view[3], double *out);
  void (*drop)(struct one_texel *brdf); /* frees what the format allocated; may be NULL */
} one_texel;

/* A zeroed state of `size` bytes with the file mapped. On failure there is nothing to close. */
btf_status one_texel_open(const btf_host *host, btf_context *ctx, const char *path, size_t size,
                          one_texel **out);
void one_texel_close(one_texel *brdf);
/* Makes the data set, which owns the state from here on, also when this fails. `about` has the quantity,
 * scale, notes and what else is not the same for all such formats. */
btf_status one_texel_create(one_texel *brdf, const btf_options *options, const btf_dataset_desc *about,
                            btf_dataset **out);

#endif
