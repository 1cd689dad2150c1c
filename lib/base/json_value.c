/* SPDX-License-Identifier: MIT */
#include "base/json_value.h"

#include <string.h>

void btfi_json_free(btfi_json *root) {
  if (!root) return;
  json_document *document = (json_document *)(void *)((char *)root - offsetof(json_document, root));
  btfi_free(document->ctx, document);
}

static bool is_container(const btfi_json *v) {
  return v && (v->type == BTFI_JSON_ARRAY || v->type == BTFI_JSON_OBJECT);
}

int btfi_json_type(const btfi_json *v) {
  return v ? v->type : BTFI_JSON_NULL;
}

uint64_t btfi_json_length(const btfi_json *v) {
  return is_container(v) ? v->length : 0;
}

const btfi_json *btfi_json_at(const btfi_json *v, uint64_t i) {
  return i < btfi_json_length(v) ? &v->u.children[i] : NULL;
}

const char *btfi_json_key(const btfi_json *member) {
  if (!member || !member->key || strlen(member->key) != member->key_length) return NULL;
  return member->key;
}

const btfi_json *btfi_json_get(const btfi_json *object, const char *key) {
  if (!object || object->type != BTFI_JSON_OBJECT) return NULL;
  const size_t length = strlen(key);
  for (uint64_t i = 0; i < object->length; i++) {
    const btfi_json *member = &object->u.children[i];
    if (member->key_length == length && memcmp(member->key, key, length) == 0) return member;
  }
  return NULL;
}

double btfi_json_number(const btfi_json *v) {
  return v && v->type == BTFI_JSON_NUMBER ? v->u.number : 0.0;
}

const char *btfi_json_string(const btfi_json *v) {
  if (!v || v->type != BTFI_JSON_STRING || strlen(v->u.text) != v->length) return NULL;
  return v->u.text;
}

bool btfi_json_bool(const btfi_json *v) {
  return v && v->type == BTFI_JSON_BOOL && v->boolean;
}

void btfi_json_put_string(btfi_buffer *b, const char *text) {
  uint64_t left = strlen(text);
  btfi_put_u8(b, '"');
  while (left > 0) {
    const unsigned char c = (unsigned char)*text;
    const uint32_t length = btfi_utf8_length(text, left);
    if (length == 0)
      btfi_put_bytes(b, "\xef\xbf\xbd",
                     3); /* U+FFFD for a byte that is not UTF-8, which no reader would take */
    else if (c == '"' || c == '\\')
      btfi_put_text(b, "\\%c", c);
    else if (c < 0x20u)
      btfi_put_text(b, "\\u%04x", c);
    else
      btfi_put_bytes(b, text, length);
    text += BTFI_MAX(length, 1u);
    left -= BTFI_MAX(length, 1u);
  }
  btfi_put_u8(b, '"');
}
