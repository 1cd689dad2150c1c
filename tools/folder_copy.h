/* SPDX-License-Identifier: MIT */
/* folder_copy.h: samples of any source into a data-set folder. */
#ifndef BTF_TOOLS_FOLDER_COPY_H
#define BTF_TOOLS_FOLDER_COPY_H

#include "input.h"

/* The option --type of the commands that do so: halves unless given. */
#define CLI_OPTION_SAMPLE_TYPE                                                                               \
  { "type", 0, "TYPE", "type of the samples written: u8, u16, f16 (default) or f32", 0 }
int folder_copy_type(const cli *c, uint32_t *sample_type);

/* Writes the data set that is open, with its notes and the command as keys of the manifest. The folder
 * appears complete or not at all. */
int folder_copy(cli *c, input *in, const char *path, uint32_t sample_type);

#endif
