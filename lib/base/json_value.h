/* SPDX-License-Identifier: MIT */
/* json_value.h: how a parsed JSON document lies in memory, for json.c and json_value.c. */
#ifndef BTFI_JSON_VALUE_H
#define BTFI_JSON_VALUE_H

#include "base/base.h"

struct btf_json {
  uint8_t type;
  bool boolean;
  const char *key; /* of a member of an object, else NULL */
  uint64_t key_length;
  uint64_t length; /* bytes of a string, children of an array or object */
  union {
    double number;
    const char *text;
    const btfi_json *children; /* contiguous */
  } u;
};

/* One allocation holds the document, then its values, then the text of its strings. */
typedef struct json_document {
  btf_context *ctx;
  btfi_json root;
} json_document;

#endif
