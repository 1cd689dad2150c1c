/* SPDX-License-Identifier: MIT */
/* sample_source.h: all samples of a data set or model, as blocks of images of floats. */
#ifndef BTF_TOOLS_SAMPLE_SOURCE_H
#define BTF_TOOLS_SAMPLE_SOURCE_H

#include "input.h"

typedef struct sample_source {
  const char *path;
  const btf_dataset *dataset; /* read in blocks when there is one; otherwise the model decodes */
  const btf_model *model;
  const btf_dirset *light_set, *view_set;
  uint32_t views, lights, width, height, channels, quantity, wrap;
  uint32_t sample_type; /* of a data set; 0 for a container */
  uint32_t levels, level;
  bool texel_major; /* of a data set: all lights and views of a texel lie together */
  /* NaN in the first channel of a sample that the model decodes to something not finite, where the library
   * gives 0. Off unless set after opening. */
  bool marks_defects;
} sample_source;

/* `in` stays open as long as the source is used. Containers get their model loaded. */
int sample_source_open(input *in, sample_source *out);

/* What is read from now on: width and height become those of the level. Only models have more than one. */
void sample_source_set_level(sample_source *s, uint32_t level); /* not below the present one */

/* Values of one image: width * height * channels. */
static inline uint64_t sample_source_image_values(const sample_source *s) {
  return (uint64_t)s->width * s->height * s->channels;
}
/* How many lights of one view to read at once so that a block stays small; at least 1. */
uint32_t sample_source_block_lights(const sample_source *s);

/* Images of lights light0 .. light0 + lights - 1 seen from one view: stored quantity, image by image, bottom
 * row first, channel fastest. Any thread; the message of a failure belongs to the thread. */
btf_status sample_source_read(const sample_source *s, uint32_t view, uint32_t light0, uint32_t lights,
                              float *dst);

#endif
