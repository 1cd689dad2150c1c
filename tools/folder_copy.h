/* SPDX-License-Identifier: MIT */
/* folder_copy.h: samples of any source into a data-set folder. */
#ifndef BTF_TOOLS_FOLDER_COPY_H
#define BTF_TOOLS_FOLDER_COPY_H

#include "input.h"

/* The option --type of the commands that do so, and the sample type of the folder: as it says, or that of the
 * data set, where floats become halves unless they are kept. */
#define CLI_OPTION_SAMPLE_TYPE(unless_given)                                                                 \
  { "type", 0, "TYPE", "type of the samples written: u8, u16, f16 or f32;\n" unless_given, 0 }
int folder_copy_type(const cli *c, const input *in, bool keeps_floats, uint32_t *sample_type);

/* Writes the data set that is open, with its notes and the command as keys of the manifest. The folder
 * appears complete or not at all. How many values integers clip is told. */
int folder_copy(cli *c, input *in, const char *path, uint32_t sample_type);

#endif
