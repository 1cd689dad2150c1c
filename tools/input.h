/* SPDX-License-Identifier: MIT */
/* input.h: what a command reads: a data set (a folder of ours or measured data) or a container file. */
#ifndef BTF_TOOLS_INPUT_H
#define BTF_TOOLS_INPUT_H

#include "cli.h"

typedef struct input {
  const char *path;
  btf_dataset *dataset;     /* otherwise NULL */
  const btf_format *format; /* of the data set */
  btf_file *file;           /* a container; otherwise NULL */
  btf_model *model;         /* after input_load */
  uint64_t bytes;           /* on disk */
} input;

/* Opens by what is there: a container, or a data set of whichever format recognises it. Zeroed on failure. */
int input_open(cli *c, const char *path, input *out);
/* A data set of the format that one option of the command line names, or as recognised, with parameters from
 * another. */
int input_open_measured(cli *c, const char *path, const char *format_option, const char *param_option,
                        input *out);
/* Makes the model: the first of a container, or the data set as it stands. */
int input_load(input *in);
/* Both. */
int input_open_model(cli *c, const char *path, input *out);
void input_close(input *in);

/* Words for codes. */
const char *input_sample_type(uint32_t sample_type); /* "f16" */
uint32_t input_sample_size(uint32_t sample_type);
const char *input_quantity(uint32_t quantity);
const char *input_scale(uint32_t scale);

/* Samples of a model or data set times channels, 0 on overflow. */
uint64_t input_value_count(uint32_t views, uint32_t lights, uint32_t width, uint32_t height,
                           uint32_t channels);
/* Size of a file, or of a data-set folder with its manifest and samples; 0 if unknown. */
uint64_t input_bytes_on_disk(const char *path);

#endif
