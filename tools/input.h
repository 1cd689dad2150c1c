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
  bool has_settings;        /* options of the command line were for it */
} input;

/* Entries of option tables: of commands that read with input_open; and shorthands for parameters. */
#define INPUT_OPTIONS_SHORT                                                                                  \
  {"allow-missing", 0, NULL, "fill missing and damaged images of measured data", 0}, {                       \
    "transfer", 0, "NAME", "curve that codes of measured data were made with, such as srgb", 0               \
  }
#define INPUT_OPTIONS                                                                                        \
  {"format", 0, "NAME", "format of measured data, instead of recognising it from the content", 0},           \
      {"input", 0, "KEY=VALUE",                                                                              \
       "set a parameter of the format of measured data; may be repeated\n(btf import --list shows them)",    \
       0},                                                                                                   \
      INPUT_OPTIONS_SHORT

/* Opens by what is there: a container, or a data set of the format that --format names or that recognises it,
 * with --input and the shorthands for the format. Zeroed on failure. */
int input_open(cli *c, const char *path, input *out);
/* A data set of the format named by --format, or as recognised, with --param and the
 * shorthands for the format. */
int input_open_import(cli *c, const char *path, input *out);
/* Refuses options for measured data. */
int input_refuse_settings(const cli *c, const char *path);
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
/* The line about what a command wrote. */
void input_print_written(const char *path, const char *what, double seconds);

#endif
