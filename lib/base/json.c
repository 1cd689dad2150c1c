/* SPDX-License-Identifier: MIT */
/* Parser of RFC 8259. The number of values is bounded before anything is parsed, so that one allocation of a
 * size proportional to the text holds everything. While a container is open its children stack up from the
 * end of the room for values, downwards; when it closes they move to the front, where they stay. */
#include "base/json_value.h"

#include <errno.h>
#include <inttypes.h>
#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { deepest_level = 64 };

typedef struct json_parser {
  btf_context *ctx;
  const char *name;
  const unsigned char *start, *p, *end;
  btfi_json *values; /* closed groups of children grow from the front */
  uint64_t settled;  /* how many they are */
  btfi_json *stack;  /* newest value whose container is open; grows downwards */
  char *strings;     /* where the text of the next string goes */
  locale_t c_locale;
  int depth;
} json_parser;

static btf_status parse_value(json_parser *j);

static btf_status refuse(const json_parser *j, const unsigned char *where, const char *problem) {
  uint64_t line = 1, column = 1;
  for (const unsigned char *q = j->start; q < where; q++) {
    if (*q == '\n') {
      line++;
      column = 1;
    } else if ((*q & 0xc0u) != 0x80u) {
      column++;
    }
  }
  return btfi_fail(j->ctx, BTF_E_CORRUPT, "%s: line %" PRIu64 ", column %" PRIu64 ": %s", j->name, line,
                   column, where == j->end ? "the JSON text ends too early" : problem);
}

static void skip_space(json_parser *j) {
  while (j->p < j->end && (*j->p == ' ' || *j->p == '\t' || *j->p == '\n' || *j->p == '\r')) j->p++;
}

static btfi_json *push(json_parser *j, int type) {
  btfi_json *v = --j->stack;
  memset(v, 0, sizeof *v);
  v->type = (uint8_t)type;
  return v;
}

/* ---- strings ---- */

static btf_status parse_hex4(json_parser *j, uint32_t *out) {
  uint32_t code = 0;
  for (int i = 0; i < 4; i++, j->p++) {
    const int c = j->p < j->end ? *j->p : 0;
    if (c >= '0' && c <= '9')
      code = code << 4 | (uint32_t)(c - '0');
    else if ((c | 32) >= 'a' && (c | 32) <= 'f')
      code = code << 4 | (uint32_t)((c | 32) - 'a' + 10);
    else
      return refuse(j, j->p, "\\u needs four hexadecimal digits");
  }
  *out = code;
  return BTF_OK;
}

static char *put_utf8(char *out, uint32_t code) {
  if (code < 0x80u) {
    *out++ = (char)code;
  } else if (code < 0x800u) {
    *out++ = (char)(0xc0u | code >> 6);
    *out++ = (char)(0x80u | (code & 0x3fu));
  } else if (code < 0x10000u) {
    *out++ = (char)(0xe0u | code >> 12);
    *out++ = (char)(0x80u | (code >> 6 & 0x3fu));
    *out++ = (char)(0x80u | (code & 0x3fu));
  } else {
    *out++ = (char)(0xf0u | code >> 18);
    *out++ = (char)(0x80u | (code >> 12 & 0x3fu));
    *out++ = (char)(0x80u | (code >> 6 & 0x3fu));
    *out++ = (char)(0x80u | (code & 0x3fu));
  }
  return out;
}

/* After the backslash. */
static btf_status parse_escape(json_parser *j, char **out) {
  static const char letters[] = "\"\\/bfnrt", meanings[] = "\"\\/\b\f\n\r\t";
  const unsigned char *where = j->p - 1;
  if (j->p == j->end) return refuse(j, j->end, "");
  const unsigned char c = *j->p++;
  if (c != 'u') {
    const char *letter = memchr(letters, c, sizeof letters - 1);
    if (!letter)
      return refuse(j, where, "unknown escape; expected one of \\\" \\\\ \\/ \\b \\f \\n \\r \\t \\u");
    *(*out)++ = meanings[letter - letters];
    return BTF_OK;
  }
  uint32_t code = 0, low = 0;
  BTFI_TRY(parse_hex4(j, &code));
  if (code >= 0xdc00u && code <= 0xdfffu)
    return refuse(j, where, "low surrogate without a high one before it");
  if (code >= 0xd800u && code <= 0xdbffu) {
    if (j->p == j->end || (*j->p == '\\' && j->end - j->p == 1)) return refuse(j, j->end, "");
    if (j->p[0] != '\\' || j->p[1] != 'u')
      return refuse(j, where, "high surrogate without a low one after it");
    j->p += 2;
    BTFI_TRY(parse_hex4(j, &low));
    if (low < 0xdc00u || low > 0xdfffu) return refuse(j, where, "high surrogate without a low one after it");
    code = 0x10000u + ((code - 0xd800u) << 10) + (low - 0xdc00u);
  }
  *out = put_utf8(*out, code);
  return BTF_OK;
}

/* At the opening quote. Unescaped text and its NUL never take more room than the literal with its quotes. */
static btf_status parse_string(json_parser *j, const char **text, uint64_t *length) {
  char *out = j->strings;
  *text = out;
  for (j->p++;;) {
    if (j->p == j->end) return refuse(j, j->end, "");
    const unsigned char c = *j->p;
    if (c == '"') break;
    if (c == '\\') {
      j->p++;
      BTFI_TRY(parse_escape(j, &out));
      continue;
    }
    if (c < 0x20u) return refuse(j, j->p, "control character in a string; expected an escape");
    const uint32_t bytes = btfi_utf8_length(j->p, (uint64_t)(j->end - j->p));
    if (bytes == 0) return refuse(j, j->p, "bytes that are not UTF-8");
    memcpy(out, j->p, bytes);
    out += bytes;
    j->p += bytes;
  }
  j->p++;
  *length = (uint64_t)(out - j->strings);
  *out++ = '\0';
  j->strings = out;
  return BTF_OK;
}

/* ---- numbers ---- */

static bool digit_at(const json_parser *j, const unsigned char *q) {
  return q < j->end && *q >= '0' && *q <= '9';
}

static btf_status parse_number(json_parser *j) {
  static const double powers[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                  1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
  const unsigned char *const first = j->p;
  const unsigned char *q = first;
  uint64_t digits = 0, exponent = 0;
  int64_t scale = 0; /* the value is digits times 10 to this power, as long as `exact` holds */
  bool exact = true, exponent_negative = false;
  const bool negative = *q == '-';
  if (negative) q++;
  if (!digit_at(j, q)) return refuse(j, q, "a number needs a digit here");
  if (*q == '0' && digit_at(j, q + 1)) return refuse(j, q, "a number must not begin with zeros");
  for (; digit_at(j, q); q++) {
    if (digits > 900000000000000u) exact = false;
    if (exact) digits = digits * 10 + (uint64_t)(*q - '0');
  }
  if (q < j->end && *q == '.') {
    if (!digit_at(j, ++q)) return refuse(j, q, "a number needs a digit after its point");
    for (; digit_at(j, q); q++) {
      if (digits > 900000000000000u) exact = false;
      if (exact) digits = digits * 10 + (uint64_t)(*q - '0');
      scale--;
    }
  }
  if (q < j->end && (*q | 32) == 'e') {
    q++;
    if (q < j->end && (*q == '+' || *q == '-')) exponent_negative = *q++ == '-';
    if (!digit_at(j, q)) return refuse(j, q, "a number needs a digit in its exponent");
    for (; digit_at(j, q); q++)
      if (exponent < 100000) exponent = exponent * 10 + (uint64_t)(*q - '0');
  }
  scale += exponent_negative ? -(int64_t)exponent : (int64_t)exponent;

  double number;
  if (exact && scale >= -22 && scale <= 22) {
    /* Both factors are exact doubles, so the one operation rounds correctly (Clinger). */
    number = scale < 0 ? (double)digits / powers[-scale] : (double)digits * powers[scale];
    if (negative) number = -number;
  } else {
    const size_t length = (size_t)(q - first);
    memcpy(j->strings, first, length); /* strtod wants a NUL; the room is free until the next string */
    j->strings[length] = '\0';
    number = strtod_l(j->strings, NULL, j->c_locale);
    if (isinf(number)) return refuse(j, first, "number beyond the range of a double");
  }
  j->p = q;
  push(j, BTFI_JSON_NUMBER)->u.number = number;
  return BTF_OK;
}

/* ---- containers ---- */

static int compare_keys(const btfi_json *a, const btfi_json *b) {
  const int order = memcmp(a->key, b->key, (size_t)BTFI_MIN(a->key_length, b->key_length));
  return order ? order : (a->key_length > b->key_length) - (a->key_length < b->key_length);
}

static void sift_down(const btfi_json **heap, uint64_t root, uint64_t count) {
  const btfi_json *item = heap[root];
  for (uint64_t child; (child = 2 * root + 1) < count; root = child) {
    if (child + 1 < count && compare_keys(heap[child], heap[child + 1]) < 0) child++;
    if (compare_keys(item, heap[child]) >= 0) break;
    heap[root] = heap[child];
  }
  heap[root] = item;
}

/* Sets *out to the later of two members of one name, or NULL. Sorting keeps an object of n members at n log
 * n. */
static btf_status find_duplicate(json_parser *j, const btfi_json *members, uint64_t count,
                                 const btfi_json **out) {
  *out = NULL;
  if (count <= 8) {
    for (uint64_t b = 1; b < count; b++)
      for (uint64_t a = 0; a < b; a++)
        if (compare_keys(&members[a], &members[b]) == 0) *out = &members[b];
    return BTF_OK;
  }
  const btfi_json **heap = btfi_alloc(j->ctx, count, sizeof(btfi_json *));
  if (!heap) return btfi_alloc_status();
  for (uint64_t i = 0; i < count; i++) heap[i] = &members[i];
  for (uint64_t i = count / 2; i-- > 0;) sift_down(heap, i, count);
  for (uint64_t left = count; left > 1;) {
    const btfi_json *largest = heap[0];
    heap[0] = heap[--left];
    heap[left] = largest;
    sift_down(heap, 0, left);
  }
  for (uint64_t i = 1; i < count && !*out; i++)
    if (compare_keys(heap[i - 1], heap[i]) == 0) *out = BTFI_MAX(heap[i - 1], heap[i]);
  btfi_free(j->ctx, heap);
  return BTF_OK;
}

/* Moves the newest `count` values, which lie in reverse order, to the settled ones. The two places may
 * overlap. */
static btfi_json *settle(json_parser *j, uint64_t count) {
  for (uint64_t i = 0; i < count / 2; i++) {
    const btfi_json v = j->stack[i];
    j->stack[i] = j->stack[count - 1 - i];
    j->stack[count - 1 - i] = v;
  }
  btfi_json *place = j->values + j->settled;
  if (count > 0) memmove(place, j->stack, (size_t)count * sizeof *place);
  j->stack += count;
  j->settled += count;
  return place;
}

/* At the colon's left: "key" : */
static btf_status parse_key(json_parser *j, const char **key, uint64_t *length) {
  if (j->p == j->end || *j->p != '"') return refuse(j, j->p, "expected a member name in quotes");
  BTFI_TRY(parse_string(j, key, length));
  skip_space(j);
  if (j->p == j->end || *j->p != ':') return refuse(j, j->p, "expected ':' after a member name");
  j->p++;
  return BTF_OK;
}

static btf_status parse_container(json_parser *j, bool is_object) {
  const unsigned char *const opening = j->p;
  const unsigned char closing = is_object ? '}' : ']';
  uint64_t count = 0;
  if (++j->depth > deepest_level) return refuse(j, opening, "more than 64 levels of arrays and objects");
  j->p++;
  skip_space(j);
  if (j->p < j->end && *j->p == closing) {
    j->p++;
  } else {
    for (;;) {
      const char *key = NULL;
      uint64_t key_length = 0;
      skip_space(j);
      if (is_object) BTFI_TRY(parse_key(j, &key, &key_length));
      BTFI_TRY(parse_value(j));
      j->stack->key = key;
      j->stack->key_length = key_length;
      count++;
      skip_space(j);
      if (j->p == j->end || (*j->p != ',' && *j->p != closing))
        return refuse(j, j->p,
                      is_object ? "expected ',' or '}' after a member"
                                : "expected ',' or ']' after an element");
      if (*j->p++ == closing) break;
    }
  }
  btfi_json *children = settle(j, count);
  if (is_object) {
    const btfi_json *duplicate;
    BTFI_TRY(find_duplicate(j, children, count, &duplicate));
    if (duplicate) {
      char problem[128];
      snprintf(problem, sizeof problem, "this object names the member \"%.80s\" twice", duplicate->key);
      return refuse(j, opening, problem);
    }
  }
  btfi_json *v = push(j, is_object ? BTFI_JSON_OBJECT : BTFI_JSON_ARRAY);
  v->length = count;
  v->u.children = children;
  j->depth--;
  return BTF_OK;
}

static btf_status parse_word(json_parser *j, const char *word, int type, bool value) {
  for (const char *w = word; *w; w++, j->p++)
    if (j->p == j->end || *j->p != (unsigned char)*w) return refuse(j, j->p, "expected true, false or null");
  push(j, type)->boolean = value;
  return BTF_OK;
}

static btf_status parse_value(json_parser *j) {
  skip_space(j);
  if (j->p == j->end) return refuse(j, j->end, "");
  switch (*j->p) {
  case '{':
    return parse_container(j, true);
  case '[':
    return parse_container(j, false);
  case 't':
    return parse_word(j, "true", BTFI_JSON_BOOL, true);
  case 'f':
    return parse_word(j, "false", BTFI_JSON_BOOL, false);
  case 'n':
    return parse_word(j, "null", BTFI_JSON_NULL, false);
  case '"': {
    const char *text;
    uint64_t length;
    BTFI_TRY(parse_string(j, &text, &length));
    btfi_json *v = push(j, BTFI_JSON_STRING);
    v->u.text = text;
    v->length = length;
    return BTF_OK;
  }
  default:
    if (*j->p == '-' || digit_at(j, j->p)) return parse_number(j);
    return refuse(j, j->p, "expected a JSON value");
  }
}

static btf_status parse_document(json_parser *j, btfi_json *root) {
  BTFI_TRY(parse_value(j));
  skip_space(j);
  if (j->p != j->end) return refuse(j, j->p, "expected the end of the text after its value");
  *root = *j->stack;
  return BTF_OK;
}

btf_status btfi_json_parse(btf_context *ctx, const char *name, const char *text, uint64_t size,
                           btfi_json **out) {
  if (text == NULL) text = ""; /* of an empty file that was mapped */
  *out = NULL;
  /* Every value but the first follows an opening bracket or a comma. */
  uint64_t most_values = 1, value_bytes, total;
  for (uint64_t i = 0; i < size; i++) most_values += text[i] == ',' || text[i] == '[' || text[i] == '{';
  if (!btfi_mul(most_values, sizeof(btfi_json), &value_bytes) || !btfi_add(value_bytes, size, &total) ||
      !btfi_add(total, sizeof(json_document) + 1, &total))
    total = UINT64_MAX;
  json_document *document = btfi_alloc(ctx, total, 1);
  if (!document) return btfi_alloc_status();
  document->ctx = ctx;

  json_parser j;
  memset(&j, 0, sizeof j);
  j.ctx = ctx;
  j.name = name;
  j.start = j.p = (const unsigned char *)text;
  j.end = j.start + size;
  j.values = (btfi_json *)(document + 1);
  j.stack = j.values + most_values;
  j.strings = (char *)j.stack;
  j.c_locale = newlocale(LC_ALL_MASK, "C", (locale_t)0);
  btf_status status;
  if (!j.c_locale) {
    status = btfi_fail(ctx, BTF_E_NOMEM, "%s: no memory for the C locale", name);
  } else {
    status = parse_document(&j, &document->root);
    freelocale(j.c_locale);
  }
  if (status != BTF_OK) {
    btfi_free(ctx, document);
    return status;
  }
  *out = &document->root;
  return BTF_OK;
}
