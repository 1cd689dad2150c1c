/* SPDX-License-Identifier: MIT */
/* Readers of measured files: any bytes are refused with one line, or open as a data set whose samples can be
 * read or are refused in their place; by default and with other settings. FUZZ_FORMAT is the format's id.
 * With FUZZ_NAME the input has that name in a folder of pictures, of which it may replace FUZZ_CHANGED. */
#include "fuzz_beside.h"

#include <math.h>
#include <stdbool.h>

#include <btf/btf_formats.h>

static void read_all(const btf_dataset *ds) {
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  fuzz_expect(btf_dataset_describe(ds, &d) == BTF_OK);
  const uint32_t lights = btf_dirset_count(d.lights), views = btf_dirset_count(d.views);
  /* A block across the first texels and one at the last corner, both small. */
  const btf_block blocks[] = {{0, views < 3 ? views : 3, 0, lights < 3 ? lights : 3, 0, 0,
                               d.width < 3 ? d.width : 3, d.height < 2 ? d.height : 2},
                              {views - 1, 1, lights - 1, 1, d.width - 1, d.height - 1, 1, 1}};
  for (int i = 0; i < 2; i++) {
    const btf_block *b = &blocks[i];
    const size_t count = (size_t)b->views * b->lights * b->width * b->height * d.channels;
    const ptrdiff_t x = (ptrdiff_t)(4 * d.channels), y = x * (ptrdiff_t)b->width,
                    light = y * (ptrdiff_t)b->height;
    const btf_strides strides = {light * (ptrdiff_t)b->lights, light, y, x, 4};
    float *values = malloc(count * sizeof *values);
    fuzz_expect(values != NULL);
    const btf_status status = btf_dataset_read(ds, b, values, &strides);
    fuzz_expect(status != BTF_E_INVALID_ARG && status != BTF_E_STATE);
    for (size_t k = 0; k < count && status == BTF_OK; k++) fuzz_expect(isfinite(values[k]));
    free(values);
  }
}

/* Every switch and choice other than it is by default. NULL if the format has none. */
static btf_options *other_settings(const btf_format *format) {
  btf_options *options;
  bool any = false;
  fuzz_expect(btf_format_options_create(format, &options) == BTF_OK);
  for (uint32_t i = 0; i < btf_format_param_count(format); i++) {
    btf_param_desc p = {.struct_size = sizeof p};
    const char *value = NULL;
    fuzz_expect(btf_format_param(format, i, &p) == BTF_OK);
    if (p.type == BTF_PARAM_BOOL) value = strcmp(p.default_text, "true") == 0 ? "false" : "true";
    for (size_t k = 0; p.type == BTF_PARAM_CHOICE && p.choices[k] != NULL; k++)
      if (strcmp(p.choices[k], p.default_text) != 0) value = p.choices[k];
    if (value == NULL) continue;
    fuzz_expect(btf_options_set(options, p.name, value) == BTF_OK);
    any = true;
  }
  if (any) return options;
  btf_options_release(options);
  return NULL;
}

static void open_and_read(btf_context *ctx, const char *path, const btf_format *format,
                          const btf_options *options) {
  btf_dataset *ds = NULL;
  const btf_status status = btf_format_open(ctx, path, format, options, &ds);
  fuzz_expect((status == BTF_OK) == (ds != NULL));
  if (ds != NULL) {
    read_all(ds);
  } else {
    fuzz_expect(strncmp(btf_error_message(), path, strlen(path)) == 0 || status == BTF_E_LIMIT ||
                status == BTF_E_NOMEM || status == BTF_E_INVALID_ARG);
    fuzz_expect(!strchr(btf_error_message(), '\n'));
  }
  btf_dataset_release(ds);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  btf_context *ctx = fuzz_context((uint64_t)64 << 20);
  uint64_t before, now;
  fuzz_expect(btf_formats_register(ctx) == BTF_OK);
  const btf_format *format = btf_format_find(ctx, FUZZ_FORMAT), *found;
  fuzz_expect(format != NULL);
  btf_context_memory(ctx, &before, NULL);
#ifdef FUZZ_NAME
  fuzz_file file = fuzz_beside_make(FUZZ_NAME, FUZZ_CHANGED, data, size);
#else
  fuzz_file file = fuzz_file_make(data, size);
#endif
  (void)!btf_format_detect(ctx, file.path, &found);
  open_and_read(ctx, file.path, format, NULL);
  btf_options *options = other_settings(format);
  if (options != NULL) open_and_read(ctx, file.path, format, options);
  btf_options_release(options);
  fuzz_file_drop(&file);
  btf_context_memory(ctx, &now, NULL);
  fuzz_expect(now == before);
  btf_context_release(ctx);
  return 0;
}
