/* SPDX-License-Identifier: MIT */
/* images_case.h: archives and folders of pictures with known contents, and archives that are wrong in one
 * thing, written from the description of the formats. */
#ifndef BTF_FORMATS_IMAGES_CASE_H
#define BTF_FORMATS_IMAGES_CASE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { CASE_DIRECTIONS = 81, CASE_PAIRS = 81 * 81 };

typedef enum case_kind {
  CASE_JPEG,
  CASE_PNG,
  CASE_PNG16,
  CASE_HDR,
  CASE_HDR_PLAIN,
  CASE_HDR_COLUMNS
} case_kind;

typedef struct case_bytes {
  unsigned char *data; /* from malloc */
  size_t size, room;
} case_bytes;
void case_append(case_bytes *bytes, const void *data, size_t size);
void case_free(case_bytes *bytes);

/* Degrees of one of the 81 directions. */
void case_angles(uint32_t direction, unsigned *theta, unsigned *phi);
/* Code of a pixel, `row` counted from the top of the picture. */
typedef uint32_t (*case_code_fn)(uint32_t view, uint32_t light, uint32_t x, uint32_t row, uint32_t channel);
uint32_t case_code(uint32_t view, uint32_t light, uint32_t x, uint32_t row, uint32_t channel);

typedef struct picture_case {
  case_kind kind;
  uint32_t width, height, channels;
  case_code_fn code;
} picture_case;
/* Appends a picture's file. */
void case_picture(const picture_case *c, uint32_t view, uint32_t light, case_bytes *out);

/* How a name is made of a pair. */
typedef enum case_names {
  CASE_UBO,
  CASE_WOOL,
  CASE_UTIA,
  CASE_SPECTRAL,
  CASE_HOME,
  CASE_BACKSLASHES
} case_names;
void case_name(case_names names, const char *extension, uint32_t view, uint32_t light, char out[128]);

/* A member of an archive; what is not 0 stands in place of the truth. */
typedef struct zip_member {
  const char *name;
  size_t name_size;
  const void *data;
  size_t size;
  bool deflated, zip64;
  uint32_t flags, method_lie, crc_lie, size_lie, packed_lie, offset_lie, local_signature_lie;
  uint32_t name_size_lie, disk_lie;
  uint64_t size64_lie, packed64_lie, offset64_lie;
} zip_member;
typedef struct zip_writer {
  case_bytes bytes, directory;
  uint32_t count;
  /* of the end, where not 0: numbers of zip64's record, and where the record is */
  uint64_t count64_lie, directory_size64_lie, directory_offset64_lie, record64_lie;
} zip_writer;
void zip_add(zip_writer *zip, const zip_member *member);
/* Ends the archive; its bytes are zip->bytes. */
void zip_end(zip_writer *zip, bool zip64);
void zip_free(zip_writer *zip);

#endif
