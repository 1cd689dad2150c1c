/* SPDX-License-Identifier: MIT */
/* btf_test.h: what every suite uses. A suite's main ends with `return btf_run(name, tests)`. The allocator
 * and the files may be used from any thread; assertions belong on the test's own thread. */
#ifndef BTF_TEST_H
#define BTF_TEST_H

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include <btf/btf.h>

/* Expects BTF_OK and prints the library's message otherwise. */
#define assert_ok(expression)                                                                                \
  do {                                                                                                       \
    const btf_status assert_status = (expression);                                                           \
    if (assert_status != BTF_OK)                                                                             \
      fail_msg("%s: %s: %s", #expression, btf_status_name(assert_status), btf_error_message());              \
  } while (0)
#define assert_status(expression, expected)                                                                  \
  do {                                                                                                       \
    const btf_status assert_got = (expression);                                                              \
    if (assert_got != (expected))                                                                            \
      fail_msg("%s: %s instead of %s: %s", #expression, btf_status_name(assert_got),                         \
               btf_status_name(expected), btf_error_message());                                              \
  } while (0)
#define assert_message_has(part)                                                                             \
  do {                                                                                                       \
    if (strstr(btf_error_message(), (part)) == NULL)                                                         \
      fail_msg("message \"%s\" lacks \"%s\"", btf_error_message(), (part));                                  \
  } while (0)
#define assert_near(got, expected, tolerance)                                                                \
  do {                                                                                                       \
    const double near_got = (got), near_expected = (expected), near_tolerance = (tolerance);                 \
    if (!(fabs(near_got - near_expected) <= near_tolerance))                                                 \
      fail_msg("%s = %.9g, expected %.9g within %.3g", #got, near_got, near_expected, near_tolerance);       \
  } while (0)
#define assert_relative(got, expected, tolerance)                                                            \
  assert_near((got), (expected), (tolerance)*fabs((double)(expected)))

/* A context whose allocator counts live bytes and can be told to fail. One per test; teardown checks for
 * leaks. */
typedef struct test_memory {
  long live_blocks, total_allocations;
  size_t live_bytes, peak_bytes;
  long fail_at;   /* the allocation with this number (from 1) fails; 0 = none */
  int persistent; /* and all after it */
} test_memory;
btf_context *test_context(test_memory *memory); /* counting; aborts the test on failure */
btf_context *test_context_with(test_memory *memory, const char *isa, uint32_t threads);
btf_allocator
test_allocator(test_memory *memory); /* for contexts of other settings; the caller zeroes *memory first */
void test_context_done(btf_context *ctx, test_memory *memory); /* releases and expects no live blocks */
const char *test_folder(void);           /* a fresh scratch folder of this process, removed at exit */
const char *test_path(const char *name); /* scratch folder / name; static ring of 16 */

/* Files of the scratch folder, with plain system calls. */
void test_write_bytes(const char *path, const void *data, size_t size);
unsigned char *test_read_bytes(const char *path, size_t *size); /* from malloc; fails the test if it cannot */
int test_exists(const char *path);
size_t test_count_entries(const char *folder); /* hidden ones too, without . and .. */

/* Sets a locale whose numbers have a decimal comma; 0 if none is installed. Before assertions, back to "C".
 */
int test_set_comma_locale(void);

/* cmocka does not tell how many tests were skipped. */
void test_note_skip(void);
#undef skip
#define skip() (test_note_skip(), _skip(__FILE__, __LINE__))

/* Runs the group and ends with the line `N passed, N failed`. Returns 0 if none failed. */
int btf_run_group(const char *name, const struct CMUnitTest *tests, size_t count);
#define btf_run(name, tests) btf_run_group((name), (tests), sizeof(tests) / sizeof((tests)[0]))

#endif
