/* SPDX-License-Identifier: MIT */
/* json_writer.h: JSON on a stream, indented by two blanks. */
#ifndef BTF_TOOLS_JSON_WRITER_H
#define BTF_TOOLS_JSON_WRITER_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

typedef struct json_writer {
  FILE *out;
  uint32_t depth;
  bool first;    /* nothing written yet at this depth */
  bool flat[32]; /* this depth is written on one line */
} json_writer;

void json_begin(json_writer *j, FILE *out); /* no value yet: the first call makes the root */
void json_end(json_writer *j);              /* the last newline */

/* In an object every value has a key; in an array and at the root key is NULL. */
void json_object(json_writer *j, const char *key);
void json_array(json_writer *j, const char *key);
void json_flat_object(json_writer *j, const char *key); /* on one line */
void json_flat_array(json_writer *j, const char *key);
void json_close(json_writer *j, char bracket);                        /* '}' or ']' */
void json_string(json_writer *j, const char *key, const char *value); /* NULL gives null */
void json_number(json_writer *j, const char *key,
                 double value); /* not finite gives null; shortest that reads back */
void json_float(json_writer *j, const char *key, float value);
void json_integer(json_writer *j, const char *key, uint64_t value);
void json_bool(json_writer *j, const char *key, bool value);
void json_null(json_writer *j, const char *key);

#endif
