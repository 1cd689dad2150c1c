/* SPDX-License-Identifier: MIT */
#include "test_format.h"

btf_context *format_context(test_memory *memory) {
  btf_context *ctx = test_context(memory);
  assert_ok(btf_formats_register(ctx));
  return ctx;
}

btf_status format_try(btf_context *ctx, const char *path, const char *id, const char *const *settings,
                      btf_dataset **out) {
  const btf_format *format = btf_format_find(ctx, id);
  btf_options *options = NULL;
  *out = NULL;
  assert_non_null(format);
  if (settings != NULL) assert_ok(btf_format_options_create(format, &options));
  for (size_t i = 0; settings != NULL && settings[i] != NULL; i += 2)
    assert_ok(btf_options_set(options, settings[i], settings[i + 1]));
  const btf_status status = btf_format_open(ctx, path, format, options, out);
  btf_options_release(options);
  return status;
}

void format_check_allocations(const char *path, const char *id, long least) {
  test_memory memory;
  btf_context *ctx = format_context(&memory);
  const btf_block first = {0, 1, 0, 1, 0, 0, 1, 1};
  const btf_strides strides = {256, 256, 256, 256, 4};
  for (long fail_at = 1;; fail_at++) {
    float samples[64];
    btf_dataset *ds;
    memory.fail_at = memory.total_allocations + fail_at;
    btf_status status = btf_format_open(ctx, path, btf_format_find(ctx, id), NULL, &ds);
    if (status == BTF_OK) {
      status = btf_dataset_read(ds, &first, samples, &strides);
      btf_dataset_release(ds);
    }
    if (status == BTF_OK) {
      assert_true(fail_at > least);
      break;
    }
    assert_int_equal(status, BTF_E_NOMEM);
  }
  memory.fail_at = 0;
  test_context_done(ctx, &memory);
}

void format_expect_refusal(btf_context *ctx, const char *path, const char *id) {
  btf_dataset *ds;
  const btf_status status = format_try(ctx, path, id, NULL, &ds);
  if (status == BTF_OK) fail_msg("%s was opened", path);
  assert_true(status >= BTF_E_NOT_BTF && status < 40);
  assert_null(ds);
  assert_true(strncmp(btf_error_message(), path, strlen(path)) == 0);
  assert_null(strchr(btf_error_message(), '\n'));
}

const char *format_note(const btf_dataset_desc *d, const char *key) {
  for (uint32_t i = 0; d->notes != NULL && d->notes[i] != NULL; i += 2)
    if (strcmp(d->notes[i], key) == 0) return d->notes[i + 1];
  return "";
}
