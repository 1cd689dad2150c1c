/* SPDX-License-Identifier: MIT */
/* Lines of queries: any bytes go through `btf eval`, and every word that could be a number through the reader
 * of numbers, which must agree with the C library's. */
#include "fuzz_file.h"

#include <math.h>
#include <unistd.h>

#include "cli.h"
#include "commands.h"
#include "line_source.h"
#include "number_text.h"

static char folder[] = "/tmp/fuzz_queries_XXXXXX";

static void remove_folder(void) {
  char path[64];
  snprintf(path, sizeof path, "%s/samples.bin", folder);
  unlink(path);
  snprintf(path, sizeof path, "%s/manifest.json", folder);
  unlink(path);
  rmdir(folder);
}

/* A data set of two texels, one view and one light. */
static void make_folder(void) {
  static const float samples[2] = {0.25f, 0.5f};
  static const btf_block all = {0, 1, 0, 1, 0, 0, 2, 1};
  static const btf_strides strides = {8, 8, 8, 4, 4};
  btf_context *ctx = fuzz_context((uint64_t)16 << 20);
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  btf_dataset_writer *writer;
  btf_dirset *up;
  fuzz_expect(mkdtemp(folder) != NULL && rmdir(folder) == 0);
  fuzz_expect(btf_dirset_create_named(ctx, "grid:1x1", &up) == BTF_OK);
  desc.lights = desc.views = up;
  desc.width = 2;
  desc.height = desc.channels = 1;
  fuzz_expect(btf_dataset_writer_create(ctx, folder, &desc, BTF_ORDER_VLYXC, &writer) == BTF_OK);
  fuzz_expect(btf_dataset_writer_put(writer, &all, samples, &strides) == BTF_OK);
  fuzz_expect(btf_dataset_writer_finish(writer) == BTF_OK);
  btf_dirset_release(up);
  btf_context_release(ctx);
  atexit(remove_folder);
  fuzz_expect(freopen("/dev/null", "w", stdout) != NULL);
}

static void check_words(const char *p) {
  while (*p != '\0') {
    const char *end = p;
    char *expected_end, written[32];
    float value = 0.0f, again = 0.0f;
    uint32_t index;
    if (number_read(&end, &value)) {
      const float expected = strtof(p, &expected_end);
      fuzz_expect(end == expected_end && end > p);
      fuzz_expect(isnan(value) ? isnan(expected) : memcmp(&value, &expected, sizeof value) == 0);
      const size_t length = number_write(written, value);
      fuzz_expect(length >= 1 && length <= 24);
      written[length] = '\0';
      again = strtof(written, NULL);
      fuzz_expect(isnan(value) ? isnan(again) : value == again);
    }
    end = p;
    if (number_read_index(&end, &index)) fuzz_expect(end > p && strtoull(p, NULL, 10) == index);
    p += strcspn(p, " \t");
    p += strspn(p, " \t");
  }
}

static void check_lines(const char *path) {
  line_source source;
  uint64_t before = 0;
  if (line_source_open(&source, path) != EXIT_DONE) return;
  while (!source.at_end) {
    if (line_source_fill(&source) != EXIT_DONE) break;
    for (char *line; (line = line_next(&source)) != NULL; before = source.line) {
      fuzz_expect(source.line > before);
      fuzz_expect(strchr(line, '\n') == NULL && *line != '\0' && *line != '#');
      check_words(line);
    }
  }
  line_source_close(&source);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static int ready;
  static const char *const extras[] = {"--nearest", "--value=stored", "--lod=1.5", "--value=brdf_cos"};
  if (!ready) make_folder();
  ready = 1;
  fuzz_file file = fuzz_file_make(data, size);
  check_lines(file.path);
  char *argv[] = {folder,    (char *)(uintptr_t) "--threads=1",   (char *)(uintptr_t) "--queries",
                  file.path, (char *)(uintptr_t)extras[size % 4], NULL};
  const int status = cli_run(&cmd_eval, 5, argv);
  fuzz_expect(status == EXIT_DONE || status == EXIT_MALFORMED);
  fuzz_file_drop(&file);
  return 0;
}
