/* SPDX-License-Identifier: MIT */
/* The JSON parser: any bytes are read or refused, and what was read can be written and read again unchanged.
 */
#include "fuzz.h"

#include "base/base.h"

#include <string.h>

/* False if a member's name holds a NUL, which cannot be written. */
static bool write_value(btfi_buffer *b, const btfi_json *v) {
  const int type = btfi_json_type(v);
  const bool is_object = type == BTFI_JSON_OBJECT;
  if (type == BTFI_JSON_NULL) btfi_put_text(b, "null");
  if (type == BTFI_JSON_BOOL) btfi_put_text(b, btfi_json_bool(v) ? "true" : "false");
  if (type == BTFI_JSON_NUMBER) btfi_put_text(b, "%.17g", btfi_json_number(v));
  if (type == BTFI_JSON_STRING) btfi_json_put_string(b, btfi_json_string(v) ? btfi_json_string(v) : "");
  if (type != BTFI_JSON_ARRAY && !is_object) return true;
  btfi_put_u8(b, is_object ? '{' : '[');
  for (uint64_t i = 0; i < btfi_json_length(v); i++) {
    const btfi_json *child = btfi_json_at(v, i);
    if (i > 0) btfi_put_u8(b, ',');
    if (is_object) {
      const char *key = btfi_json_key(child);
      if (!key) return false;
      fuzz_expect(btfi_json_get(v, key) == child);
      btfi_json_put_string(b, key);
      btfi_put_u8(b, ':');
    }
    if (!write_value(b, child)) return false;
  }
  btfi_put_u8(b, is_object ? '}' : ']');
  return true;
}

static void expect_same(const btfi_json *a, const btfi_json *b) {
  fuzz_expect(btfi_json_type(a) == btfi_json_type(b));
  fuzz_expect(btfi_json_length(a) == btfi_json_length(b));
  const double x = btfi_json_number(a), y = btfi_json_number(b);
  fuzz_expect(memcmp(&x, &y, sizeof x) == 0);
  fuzz_expect(btfi_json_bool(a) == btfi_json_bool(b));
  if (btfi_json_string(a)) fuzz_expect(strcmp(btfi_json_string(a), btfi_json_string(b)) == 0);
  for (uint64_t i = 0; i < btfi_json_length(a); i++) expect_same(btfi_json_at(a, i), btfi_json_at(b, i));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  btf_context *ctx = fuzz_context((uint64_t)1 << 30);
  btfi_json *first = NULL, *second = NULL;
  btfi_buffer text;
  uint64_t now;
  const btf_status status = btfi_json_parse(ctx, "input", (const char *)data, size, &first);
  fuzz_expect(status == BTF_OK || status == BTF_E_CORRUPT || status == BTF_E_LIMIT);
  fuzz_expect((status == BTF_OK) == (first != NULL));
  btfi_buffer_init(&text, ctx);
  if (first && write_value(&text, first)) {
    fuzz_expect(btfi_buffer_status(&text) == BTF_OK);
    fuzz_expect(btfi_json_parse(ctx, "copy", (const char *)text.data, text.size, &second) == BTF_OK);
    expect_same(first, second);
  } else if (!first) {
    fuzz_expect(strncmp(btf_error_message(), "input: line ", 12) == 0 || status == BTF_E_LIMIT);
  }
  btfi_json_free(first);
  btfi_json_free(second);
  btfi_buffer_free(&text);
  btf_context_memory(ctx, &now, NULL);
  fuzz_expect(now == 0);
  btf_context_release(ctx);
  return 0;
}
