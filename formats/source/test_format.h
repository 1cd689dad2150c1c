/* SPDX-License-Identifier: MIT */
/* test_format.h: what the suites of all formats share. */
#ifndef BTF_FORMATS_TEST_FORMAT_H
#define BTF_FORMATS_TEST_FORMAT_H

#include "btf_test.h"

#include <stdbool.h>

#include <btf/btf_formats.h>

/* A counting context with all formats. */
btf_context *format_context(test_memory *memory);
/* Opens a file as the format `id`. `settings` is name, value, ..., NULL, or NULL. */
btf_status format_try(btf_context *ctx, const char *path, const char *id, const char *const *settings,
                      btf_dataset **out);
/* Opens the file, which must be refused with one line that begins with the path. */
void format_expect_refusal(btf_context *ctx, const char *path, const char *id);
/* The same with this status, for what is not wrong but cannot be read. */
void format_expect_status(btf_context *ctx, const char *path, const char *id, btf_status expected);
/* Prints how often one of these two held, which must be more than `least` times. */
void format_check_refusals(unsigned least);
/* With BTF_KEEP_REFUSED set, copies a file, or a folder of files, into that folder, for the test
 * hostile_formats. `status` is what its samples are refused with, or with `opens` false it itself. The above
 * keep one of a few. */
void format_keep_refused(const char *path, btf_status status, bool opens);
/* The text of a note of a data set; "" if it has none of that key. */
const char *format_note(const btf_dataset_desc *d, const char *key);
/* Fails each allocation of opening and of reading a sample in turn; there are more than `least`. */
void format_check_allocations(const char *path, const char *id, long least);

#endif
