/* SPDX-License-Identifier: MIT */
/* The JSON parser: what it takes, what it refuses, and what that costs. */
#include "btf_test.h"

#include "base/base.h"

#include <locale.h>

static const char whole[] =
    "{\n"
    "  \"name\": \"wool \\u00e9\\ud83d\\ude00 \\\"x\\\" \\\\ \\/ \\b\\f\\n\\r\\t \xc3\xa9\",\n"
    "  \"size\": [256, -0, 1.5e3, 0.1, 1E-2, 123456789012345678901234567890, 5e-324, "
    "1.7976931348623157e308],\n"
    "  \"flags\": {\"a\": true, \"b\": false, \"c\": null, \"\": {}},\n"
    "  \"empty\": [ ] ,\t\"nested\": [[[]], [{}], \"\"]\r\n"
    "}\n";

static btf_status parse(btf_context *ctx, const char *text, size_t size, btfi_json **out) {
  /* An exact copy on the heap, so that a sanitizer sees a read past the end. */
  char *copy = malloc(size ? size : 1);
  memcpy(copy, text, size);
  const btf_status status = btfi_json_parse(ctx, "wool.json", copy, size, out);
  free(copy);
  return status;
}

static btf_context *json_context(test_memory *memory) {
  return test_context_with(memory, "scalar", 1);
}

static void a_document_is_read(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  btfi_json *root = NULL;
  assert_ok(parse(ctx, whole, sizeof whole - 1, &root));
  assert_int_equal(btfi_json_type(root), BTFI_JSON_OBJECT);
  assert_int_equal(btfi_json_length(root), 5);
  assert_string_equal(btfi_json_string(btfi_json_get(root, "name")),
                      "wool \xc3\xa9\xf0\x9f\x98\x80 \"x\" \\ / \b\f\n\r\t \xc3\xa9");
  const btfi_json *size = btfi_json_get(root, "size");
  static const double numbers[] = {
      256, -0.0, 1500, 0.1, 0.01, 123456789012345678901234567890.0, 5e-324, 1.7976931348623157e308};
  assert_int_equal(btfi_json_type(size), BTFI_JSON_ARRAY);
  assert_int_equal(btfi_json_length(size), 8);
  for (uint64_t i = 0; i < 8; i++) {
    const double got = btfi_json_number(btfi_json_at(size, i));
    assert_memory_equal(&got, &numbers[i], sizeof got);
  }
  assert_null(btfi_json_at(size, 8));
  assert_null(btfi_json_get(size, "name"));
  const btfi_json *flags = btfi_json_get(root, "flags");
  assert_true(btfi_json_bool(btfi_json_get(flags, "a")));
  assert_int_equal(btfi_json_type(btfi_json_get(flags, "b")), BTFI_JSON_BOOL);
  assert_false(btfi_json_bool(btfi_json_get(flags, "b")));
  assert_int_equal(btfi_json_type(btfi_json_get(flags, "c")), BTFI_JSON_NULL);
  assert_int_equal(btfi_json_type(btfi_json_get(flags, "")), BTFI_JSON_OBJECT);
  assert_string_equal(btfi_json_key(btfi_json_at(flags, 1)), "b");
  assert_null(btfi_json_key(root));
  assert_null(btfi_json_get(flags, "absent"));
  assert_int_equal(btfi_json_length(btfi_json_get(root, "empty")), 0);
  const btfi_json *nested = btfi_json_get(root, "nested");
  assert_int_equal(btfi_json_length(nested), 3);
  assert_int_equal(btfi_json_length(btfi_json_at(btfi_json_at(nested, 0), 0)), 0);
  assert_int_equal(btfi_json_type(btfi_json_at(btfi_json_at(nested, 1), 0)), BTFI_JSON_OBJECT);
  assert_string_equal(btfi_json_string(btfi_json_at(nested, 2)), "");
  /* Asking for the wrong type is harmless. */
  assert_null(btfi_json_string(size));
  assert_near(btfi_json_number(flags), 0, 0);
  assert_int_equal(btfi_json_length(btfi_json_at(size, 0)), 0);
  assert_int_equal(btfi_json_length(NULL), 0);
  assert_null(btfi_json_get(NULL, "x"));
  btfi_json_free(root);
  btfi_json_free(NULL);
  test_context_done(ctx, &memory);
}

static void every_kind_may_stand_alone(void **state) {
  (void)state;
  static const char *const good[] = {"0",
                                     " -1.25e+2 ",
                                     "\"\"",
                                     "true",
                                     "false",
                                     "null",
                                     "[]",
                                     "{}",
                                     "\t[1,\r\n2]\n",
                                     "\"\x7f\"",
                                     "1e-400",
                                     "\"\\u0000\"",
                                     "{\"a\":1,\"A\":2,\"a\\u0000\":3}"};
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  for (size_t i = 0; i < sizeof good / sizeof good[0]; i++) {
    btfi_json *root = NULL;
    assert_ok(parse(ctx, good[i], strlen(good[i]), &root));
    btfi_json_free(root);
  }
  btfi_json *root = NULL;
  assert_ok(parse(ctx, "\"a\\u0000b\"", 10, &root));
  assert_null(btfi_json_string(root)); /* as a C string it would be cut */
  btfi_json_free(root);
  assert_ok(parse(ctx, "{\"a\\u0000\":1}", 13, &root));
  assert_null(btfi_json_get(root, "a"));
  btfi_json_free(root);
  test_context_done(ctx, &memory);
}

static void bad_documents_are_refused_at_their_place(void **state) {
  (void)state;
  static const struct {
    const char *text, *place;
  } bad[] = {
      {"", "line 1, column 1: the JSON text ends"},
      {"  \n ", "line 2, column 2: the JSON text ends"},
      {"[1,\n 2,\n 03]", "line 3, column 2: a number must not begin"},
      {"[\"\xc3\xa9\xc3\xa9\", x]", "line 1, column 8: expected a JSON value"},
      {"{\"a\":1,\"a\":2}", "line 1, column 1: this object names the member \"a\" twice"},
      {"[{\"a\":1,\"b\":0,\"\\u0061\":2}]", "line 1, column 2: this object names"},
      {"[1,]", "column 4: expected a JSON value"},
      {"[,1]", "column 2"},
      {"[1 2]", "column 4: expected ',' or ']'"},
      {"{\"a\" 1}", "column 6: expected ':'"},
      {"{\"a\":1,}", "column 8: expected a member name"},
      {"{a:1}", "column 2: expected a member name"},
      {"{\"a\":1 \"b\":2}", "column 8: expected ',' or '}'"},
      {"{1:1}", "column 2"},
      {"[1}", "column 3"},
      {"1 2", "column 3: expected the end"},
      {"[]]", "column 3: expected the end"},
      {"tru", "ends too early"},
      {"trux", "column 4: expected true"},
      {"nul1", "column 4"},
      {"True", "column 1"},
      {"NaN", "column 1"},
      {"Infinity", "column 1"},
      {"-Infinity", "column 2: a number needs a digit"},
      {"+1", "column 1"},
      {".5", "column 1"},
      {"1.", "ends too early"},
      {"[1.]", "column 4: a number needs a digit after"},
      {"[1e]", "column 4: a number needs a digit in"},
      {"[1e+]", "column 5"},
      {"[-]", "column 3"},
      {"00", "column 1"},
      {"-01", "column 2"},
      {"0x10", "column 2"},
      {"1e999", "column 1: number beyond"},
      {"-1e99999999999999999999", "column 1: number beyond"},
      {"'a'", "column 1"},
      {"\"a", "ends too early"},
      {"\"\\", "ends too early"},
      {"\"\\x41\"", "column 2: unknown escape"},
      {"\"\\u12\"", "column 6: \\u needs four"},
      {"\"\\ud800\"", "column 2: high surrogate"},
      {"\"\\ud800\\n\"", "column 2: high surrogate"},
      {"\"\\ud800\\ud800\"", "column 2: high surrogate"},
      {"\"\\udc00\"", "column 2: low surrogate"},
      {"\"a\nb\"", "column 3: control character"},
      {"\"\x01\"", "column 2: control character"},
      {"\"\xff\"", "column 2: bytes that are not UTF-8"},
      {"\"\xc0\x80\"", "not UTF-8"},         /* overlong NUL */
      {"\"\xe0\x9f\xbf\"", "not UTF-8"},     /* overlong */
      {"\"\xed\xa0\x80\"", "not UTF-8"},     /* surrogate */
      {"\"\xf0\x8f\xbf\xbf\"", "not UTF-8"}, /* overlong */
      {"\"\xf4\x90\x80\x80\"", "not UTF-8"}, /* beyond U+10FFFF */
      {"\"\xe2\x82\"", "not UTF-8"},
      {"\xef\xbb\xbf{}", "column 1: expected a JSON value"}, /* byte order mark */
      {"[1] // no comments", "column 5"},
  };
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  const long live = memory.live_blocks;
  for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
    btfi_json *root = (btfi_json *)&memory;
    assert_status(parse(ctx, bad[i].text, strlen(bad[i].text), &root), BTF_E_CORRUPT);
    assert_null(root);
    assert_message_has("wool.json: ");
    assert_message_has(bad[i].place);
    assert_int_equal(memory.live_blocks, live);
  }
  btfi_json *root;
  assert_status(parse(ctx, "[1]\0", 4, &root), BTF_E_CORRUPT);
  assert_status(parse(ctx, "\"\0\"", 3, &root), BTF_E_CORRUPT);
  test_context_done(ctx, &memory);
}

static void no_truncation_passes_for_the_whole(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  btfi_json *root;
  const size_t last_brace = sizeof whole - 3;
  for (size_t size = 0; size <= last_brace; size++) {
    assert_status(parse(ctx, whole, size, &root), BTF_E_CORRUPT);
    assert_null(root);
  }
  assert_ok(parse(ctx, whole, last_brace + 1, &root));
  btfi_json_free(root);
  test_context_done(ctx, &memory);
}

/* Any byte may be changed to any other: it is read or refused, and nothing leaks or strays. */
static void no_changed_byte_does_harm(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  const long live = memory.live_blocks;
  size_t taken = 0, refused = 0;
  for (size_t at = 0; at < sizeof whole - 1; at++)
    for (int value = 0; value < 256; value += 1 + (at % 3 != 0) * 6) {
      char text[sizeof whole];
      btfi_json *root;
      memcpy(text, whole, sizeof whole);
      text[at] = (char)value;
      const btf_status status = parse(ctx, text, sizeof whole - 1, &root);
      assert_true(status == BTF_OK || status == BTF_E_CORRUPT);
      assert_true((status == BTF_OK) == (root != NULL));
      taken += status == BTF_OK;
      refused += status != BTF_OK;
      btfi_json_free(root);
      assert_int_equal(memory.live_blocks, live);
    }
  assert_true(taken > 1000 && refused > 1000);
  test_context_done(ctx, &memory);
}

static void depth_ends_at_64(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  btfi_json *root;
  char text[131];
  memset(text, '[', 65);
  memset(text + 65, ']', 65);
  assert_ok(parse(ctx, text + 1, 128, &root));
  const btfi_json *v = root;
  int depth = 0;
  for (; v; v = btfi_json_at(v, 0)) depth++;
  assert_int_equal(depth, 64);
  btfi_json_free(root);
  assert_status(parse(ctx, text, 130, &root), BTF_E_CORRUPT);
  assert_message_has("column 65: more than 64 levels");
  char row[3 * 100 + 2] = "["; /* neighbours do not add up */
  for (int i = 0; i < 100; i++) strcat(row, i ? ",[]" : "[]");
  strcat(row, "]");
  assert_ok(parse(ctx, row, strlen(row), &root));
  assert_int_equal(btfi_json_length(root), 100);
  btfi_json_free(root);
  const size_t many = 1000000;
  char *deep = malloc(many);
  memset(deep, '[', many);
  assert_status(parse(ctx, deep, many, &root), BTF_E_CORRUPT);
  for (size_t i = 0; i + 5 <= many; i += 5) memcpy(deep + i, "{\"a\":", 5);
  assert_status(parse(ctx, deep, many, &root), BTF_E_CORRUPT);
  free(deep);
  test_context_done(ctx, &memory);
}

/* Writes n members "k<i>": i, with the same long beginning of the names, into a fresh string. */
static char *many_members(size_t n, size_t repeated, size_t *size) {
  char *text = malloc(n * 32 + 3), *p = text;
  *p++ = '{';
  for (size_t i = 0; i < n; i++)
    p += sprintf(p, "%s\"corduroy-%zu\":%zu", i ? "," : "", i == n - 1 ? repeated : i, i);
  *p++ = '}';
  *size = (size_t)(p - text);
  return text;
}

static void cost_grows_with_the_text_only(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  btfi_json *root;
  uint64_t before, peak;
  enum { n = 200000 };
  char *text = malloc(2 * n + 1);
  for (size_t i = 0; i < n; i++) memcpy(text + 2 * i, ",1", 2);
  text[0] = '[';
  text[2 * n] = ']';
  btf_context_memory(ctx, &before, NULL);
  assert_ok(parse(ctx, text, 2 * n + 1, &root));
  btf_context_memory(ctx, NULL, &peak);
  assert_int_equal(btfi_json_length(root), n);
  /* The densest array has a value every two bytes, and a value takes at most 48. */
  assert_true(peak - before <= 25 * (2 * n + 1) + 4096);
  /* A million look-ups would take minutes if each walked the array. */
  double sum = 0;
  for (uint64_t i = 0; i < 1000000; i++) sum += btfi_json_number(btfi_json_at(root, i % n));
  assert_near(sum, 1e6, 0);
  btfi_json_free(root);
  free(text);

  size_t size;
  text = many_members(n, n - 1, &size); /* comparing all pairs of names would take minutes too */
  assert_ok(parse(ctx, text, size, &root));
  assert_near(btfi_json_number(btfi_json_get(root, "corduroy-777")), 777, 0);
  btfi_json_free(root);
  free(text);
  static const size_t twins[] = {0, 1, n / 2, n - 2};
  for (size_t i = 0; i < 4; i++) {
    text = many_members(n, twins[i], &size);
    assert_status(parse(ctx, text, size, &root), BTF_E_CORRUPT);
    assert_message_has("twice");
    free(text);
  }
  test_context_done(ctx, &memory);
}

/* strtod of the C library in the C locale is the authority; it rounds correctly. */
static void numbers_are_the_nearest_doubles(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  btfi_random random;
  btfi_random_seed(&random, 99);
  setlocale(LC_ALL, "de_DE.UTF-8"); /* where there is one, it must make no difference */
  for (int i = 0; i < 30000; i++) {
    char text[64];
    double value;
    const uint64_t bits = btfi_random_u64(&random);
    memcpy(&value, &bits, sizeof value);
    if (i % 3 == 0 && isfinite(value)) {
      setlocale(LC_ALL, "C");
      snprintf(text, sizeof text, "%.17g", value);
    } else {
      static const char *const forms[] = {"%llu.%llue%d", "1%llu%llu.5e%d", "%llu.000%llue%d"};
      snprintf(text, sizeof text, forms[i % 3], (unsigned long long)(bits >> 32) >> (bits & 31),
               (unsigned long long)(bits & 0xffffffffu) >> (bits >> 59),
               (int)btfi_random_below(&random, 60) - 30);
    }
    btfi_json *root;
    assert_ok(parse(ctx, text, strlen(text), &root));
    const double got = btfi_json_number(root);
    btfi_json_free(root);
    setlocale(LC_ALL, "C");
    const double expected = strtod(text, NULL);
    assert_memory_equal(&got, &expected, sizeof got);
    setlocale(LC_ALL, "de_DE.UTF-8");
  }
  setlocale(LC_ALL, "C");
  test_context_done(ctx, &memory);
}

static void written_strings_are_read_back(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  char every[256 + 8];
  for (int i = 1; i < 128; i++) every[i - 1] = (char)i;
  memcpy(every + 127, "\xc3\xa9\xf0\x9f\x98\x80", 7);
  btfi_buffer b;
  btfi_buffer_init(&b, ctx);
  btfi_json_put_string(&b, every);
  assert_ok(btfi_buffer_status(&b));
  btfi_json *root;
  assert_ok(parse(ctx, (const char *)b.data, b.size, &root));
  assert_string_equal(btfi_json_string(root), every);
  btfi_json_free(root);
  btfi_buffer_free(&b);

  btfi_buffer_init(&b, ctx); /* a file name in Latin-1 */
  btfi_json_put_string(&b, "caf\xe9\xc3.btfd");
  assert_ok(parse(ctx, (const char *)b.data, b.size, &root));
  assert_string_equal(btfi_json_string(root), "caf\xef\xbf\xbd\xef\xbf\xbd.btfd");
  btfi_json_free(root);
  btfi_buffer_free(&b);
  test_context_done(ctx, &memory);
}

static void running_out_of_memory_is_told(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = json_context(&memory);
  size_t size;
  char *text = many_members(100, 99, &size);
  const long live = memory.live_blocks, start = memory.total_allocations;
  btfi_json *root;
  int failures = 0;
  for (;; failures++) {
    memory.fail_at = memory.total_allocations + 1 + failures;
    const btf_status status = parse(ctx, text, size, &root);
    if (status == BTF_OK) break;
    assert_int_equal(status, BTF_E_NOMEM);
    assert_null(root);
    assert_int_equal(memory.live_blocks, live);
  }
  assert_int_equal(failures, 2);
  assert_true(memory.total_allocations > start);
  btfi_json_free(root);
  free(text);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_document_is_read),
      cmocka_unit_test(every_kind_may_stand_alone),
      cmocka_unit_test(bad_documents_are_refused_at_their_place),
      cmocka_unit_test(no_truncation_passes_for_the_whole),
      cmocka_unit_test(no_changed_byte_does_harm),
      cmocka_unit_test(depth_ends_at_64),
      cmocka_unit_test(cost_grows_with_the_text_only),
      cmocka_unit_test(numbers_are_the_nearest_doubles),
      cmocka_unit_test(written_strings_are_read_back),
      cmocka_unit_test(running_out_of_memory_is_told),
  };
  return btf_run("json", tests);
}
