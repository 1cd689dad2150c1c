/* SPDX-License-Identifier: MIT */
/* picture.h: JPEG, PNG and Radiance pictures in memory, decoded to linear samples. */
#ifndef BTF_FORMATS_PICTURE_H
#define BTF_FORMATS_PICTURE_H

#include "source/source_file.h"

enum { PICTURE_MOST_SIDE = 8192 };

/* Why something failed, without the file's name. */
typedef struct picture_fault {
  btf_status status;
  char why[240];
} picture_fault;
btf_status picture_fail(picture_fault *fault, btf_status status, const char *format, ...) LIBBTF_PRINTF(3, 4);

typedef enum picture_kind { PICTURE_JPEG, PICTURE_PNG, PICTURE_HDR } picture_kind;

typedef struct picture_info {
  picture_kind kind;
  uint32_t width, height, channels;
  uint32_t depth;  /* bits of a code; 32 for Radiance */
  bool by_columns; /* Radiance: lines of the file are columns */
} picture_info;

/* How decoded samples are stored. */
typedef struct picture_rules {
  uint32_t sample_size; /* 2: half floats, 4: floats; 1: the codes themselves, which have 8 bits */
  bool upside_down;     /* the first row of a picture is the bottom one */
  bool columns_as_rows; /* columns of a Radiance picture are taken for rows, the last one on top */
  const void *table;    /* sample of each code, in the type of samples */
} picture_rules;

/* What the head of a picture says. *complete is false, with BTF_OK, if `size` bytes are not enough to know.
 */
btf_status picture_look(const unsigned char *data, size_t size, picture_info *info, bool *complete,
                        picture_fault *fault);
static inline bool picture_alike(const picture_info *a, const picture_info *b) {
  return a->kind == b->kind && a->width == b->width && a->height == b->height && a->channels == b->channels &&
         a->depth == b->depth && a->by_columns == b->by_columns;
}
const char *picture_kind_name(picture_kind kind);

/* Decodes a picture that must be as `info` says; row 0 of `samples` is the bottom one. Of `file`, host, ctx,
 * data and size count. All memory is the host's. */
btf_status picture_decode(const source_file *file, const picture_info *info, const picture_rules *rules,
                          void *samples, picture_fault *fault);

/* The parts of the above for each kind. */
btf_status picture_decode_jpeg(const source_file *file, const picture_info *info, const picture_rules *rules,
                               void *samples, picture_fault *fault);
btf_status picture_decode_png(const source_file *file, const picture_info *info, const picture_rules *rules,
                              void *samples, picture_fault *fault);
btf_status picture_decode_hdr(const source_file *file, const picture_info *info, const picture_rules *rules,
                              void *samples, picture_fault *fault);
btf_status picture_look_hdr(const unsigned char *data, size_t size, picture_info *info, bool *complete,
                            picture_fault *fault);
/* Looks up a row of codes of 8 bits (16 bits, in the machine's order), counted from the top of the picture.
 */
void picture_store_row(const picture_info *info, const picture_rules *rules, uint32_t row, const void *codes,
                       void *samples);

#endif
