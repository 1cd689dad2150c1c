/* SPDX-License-Identifier: MIT */
#include "test_format.h"

#include <dirent.h>
#include <sys/stat.h>

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

/* ---- files for other tests ---- */

static void copy_file(const char *from, const char *to) {
  size_t size;
  unsigned char *data = test_read_bytes(from, &size);
  test_write_bytes(to, data, size);
  free(data);
}

/* Of a folder the files that can be read; an entry that is none is made a folder. */
static void copy_to(const char *from, const char *to) {
  struct stat about;
  assert_int_equal(stat(from, &about), 0);
  if (S_ISREG(about.st_mode)) {
    copy_file(from, to);
    return;
  }
  DIR *folder = opendir(from);
  assert_non_null(folder);
  assert_int_equal(mkdir(to, 0777), 0);
  for (struct dirent *member; (member = readdir(folder)) != NULL;) {
    char source[4096], target[4096];
    if (strcmp(member->d_name, ".") == 0 || strcmp(member->d_name, "..") == 0) continue;
    snprintf(source, sizeof source, "%s/%s", from, member->d_name);
    snprintf(target, sizeof target, "%s/%s", to, member->d_name);
    copy_to(source, target);
  }
  closedir(folder);
}

void format_keep_refused(const char *path, btf_status status, bool opens) {
  static unsigned kept;
  const char *folder = getenv("BTF_KEEP_REFUSED");
  char target[4096];
  if (folder == NULL) return;
  snprintf(target, sizeof target, "%s/%d-%s-%03u", folder, (int)status, opens ? "read" : "open", ++kept);
  copy_to(path, target);
}

/* ---- refusals ---- */

static unsigned refusals, next_kept, kept_root; /* its root, counted from 0 */

static btf_status refuse(btf_context *ctx, const char *path, const char *id) {
  btf_dataset *ds;
  const btf_status status = format_try(ctx, path, id, NULL, &ds);
  if (status == BTF_OK) fail_msg("%s was opened", path);
  assert_null(ds);
  assert_true(strncmp(btf_error_message(), path, strlen(path)) == 0);
  assert_null(strchr(btf_error_message(), '\n'));
  /* Most are one file, cut at each byte: those whose number is a square are enough. */
  if (refusals++ == next_kept) {
    format_keep_refused(path, status, false);
    next_kept += 2 * kept_root++ + 1;
  }
  return status;
}

void format_expect_refusal(btf_context *ctx, const char *path, const char *id) {
  const btf_status status = refuse(ctx, path, id);
  assert_true(status >= BTF_E_NOT_BTF && status < 40);
}

void format_expect_status(btf_context *ctx, const char *path, const char *id, btf_status expected) {
  assert_status(refuse(ctx, path, id), expected);
}

void format_check_refusals(unsigned least) {
  printf("%u damaged files were refused\n", refusals);
  assert_true(refusals > least);
}

const char *format_note(const btf_dataset_desc *d, const char *key) {
  for (uint32_t i = 0; d->notes != NULL && d->notes[i] != NULL; i += 2)
    if (strcmp(d->notes[i], key) == 0) return d->notes[i + 1];
  return "";
}
