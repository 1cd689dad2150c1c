/* SPDX-License-Identifier: MIT */
/* one_view.h: pictures of one view that a formula gives for any light, as a data set seen from straight
 * above.
 */
#ifndef BTF_FORMATS_ONE_VIEW_H
#define BTF_FORMATS_ONE_VIEW_H

#include "source/source_file.h"

enum { ONE_VIEW_MOST_SIDE = 1 << 20, ONE_VIEW_MOST_WEIGHTS = 512 };

/* The parameters of every such format; before its list of parameters. */
#define ONE_VIEW_DIRECTIONS                                                                                  \
  BTF_PARAM(                                                                                                 \
      directions, BTF_PARAM_STRING,                                                                          \
      "lights that the formula is evaluated for: ubo81, ubo151 or grid:PxT (P azimuths, T elevations)",      \
      NULL, "ubo81", NULL, 0, 0)
#define ONE_VIEW_TRANSFER                                                                                    \
  static const char *const one_view_transfers[] = {"srgb", "linear", NULL};                                  \
  BTF_PARAM(transfer, BTF_PARAM_CHOICE, "the curve of the camera's values, which is undone", NULL, "srgb",   \
            one_view_transfers, 0, 0)

/* The first member of a format's state. */
typedef struct one_view {
  source_file file;
  btf_dirset *lights, *views;
  uint32_t width, height;
  bool srgb;
  /* What a light does to all texels: up to ONE_VIEW_MOST_WEIGHTS weights. `light` is a unit vector. */
  void (*weigh)(const struct one_view *map, const double light[3], double *weights);
  /* Red, green and blue on the camera's scale, 0 to 1; row 0 is the bottom one. */
  void (*texel)(const struct one_view *map, uint32_t x, uint32_t y, const double *weights, double out[3]);
  void (*drop)(struct one_view *map); /* frees what the format allocated; may be NULL */
} one_view;

/* A zeroed state of `size` bytes with the file mapped. On failure there is nothing to close. */
btf_status one_view_open(const btf_host *host, btf_context *ctx, const char *path, size_t size,
                         one_view **out);
void one_view_close(one_view *map);
/* Makes the data set, which owns the state from here on, also when this fails. It is named after `path`,
 * which was opened. `kind` is text for the note rti_kind, or NULL. */
btf_status one_view_create(one_view *map, const btf_options *options, const char *path, const char *reader,
                           const char *kind, btf_dataset **out);

#endif
