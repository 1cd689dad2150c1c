/* SPDX-License-Identifier: MIT */
/* source_file.h: a mapped file of measured data and a cursor that cannot leave it. Numbers are little-endian.
 */
#ifndef BTF_FORMATS_SOURCE_FILE_H
#define BTF_FORMATS_SOURCE_FILE_H

#include <btf/btf_codec.h>
#include <stdbool.h>

typedef struct source_file {
  const btf_host *host;
  btf_context *ctx;
  char *path;
  const unsigned char *data;
  uint64_t size;
} source_file;

/* Maps a regular file, which may be empty. On failure there is nothing to close. */
btf_status source_file_open(const btf_host *host, btf_context *ctx, const char *path, source_file *out);
/* The same for a file in the folder of `file`, of whose data it is a part: BTF_E_CORRUPT if it is missing.
 * The message has the path of `file` in front. */
btf_status source_file_open_beside(const source_file *file, const char *name, source_file *out);
void source_file_close(source_file *file);

enum { SOURCE_NAME_BYTES = 256 };
/* The last part of a path to a file or folder, as the data set's name. */
void source_name(const char *path, char name[SOURCE_NAME_BYTES]);

/* Reads one field after the other. Beyond the end it gives zeros and NULL and stays there, so that a
 * structure is read whole and asked once whether it was all there. */
typedef struct cursor {
  const source_file *file;
  uint64_t at;
  bool ended; /* a read would have gone beyond the end */
} cursor;

uint64_t cursor_left(const cursor *c);
uint8_t cursor_u8(cursor *c);
uint32_t cursor_u32(cursor *c);
float cursor_f32(cursor *c);
/* count * size bytes in place; NULL beyond the end. */
const unsigned char *cursor_take(cursor *c, uint64_t count, uint64_t size);

/* ---- headers of text ---- */

enum { CURSOR_WORD_BYTES = 64 };
static inline bool is_blank(unsigned char c) {
  return c == ' ' || c == '\t' || c == '\n' || c == '\r';
}
/* The next word, cut at 63 characters; empty at the end. The cursor stays behind it. */
void cursor_word(cursor *c, char word[CURSOR_WORD_BYTES]);
/* One line end, perhaps after a blank: what looks like more may be data already. */
void cursor_line_end(cursor *c);
/* The next word as a whole number from 1 to `most`. */
bool cursor_count(cursor *c, uint32_t most, uint32_t *out);

#endif
