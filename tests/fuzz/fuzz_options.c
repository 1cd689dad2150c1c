/* SPDX-License-Identifier: MIT */
/* Options: any text for any parameter of any codec is taken or refused; what is taken lies within its bounds
 * and is given back as it was. An input is lines of NAME=VALUE. */
#include "fuzz.h"

#include "copy_codec.h"
#include "registry/registry.h"

static void check_value(const btf_codec *codec, const btf_options *options, const char *name) {
  for (uint32_t i = 0; i < btf_codec_param_count(codec); i++) {
    btf_param_desc p = {.struct_size = sizeof p};
    uint32_t choices = 0;
    fuzz_expect(btf_codec_param(codec, i, &p) == BTF_OK);
    if (strcmp(p.name, name) != 0) continue;
    const double number = btfi_option(options, name);
    switch (p.type) {
    case BTF_PARAM_INT:
      fuzz_expect(number == (double)(int64_t)number);
      fuzz_expect(number >= p.minimum && number <= p.maximum);
      break;
    case BTF_PARAM_FLOAT:
      fuzz_expect(number >= p.minimum && number <= p.maximum);
      break;
    case BTF_PARAM_BOOL:
      fuzz_expect(number == 0.0 || number == 1.0);
      break;
    case BTF_PARAM_CHOICE:
      while (p.choices[choices] != NULL) choices++;
      fuzz_expect(number >= 0.0 && number < choices);
      break;
    default:
      break;
    }
    return;
  }
  fuzz_expect(!"a parameter that was set is listed");
}

static void set(const btf_codec *codec, btf_options *options, const char *name, const char *value) {
  char text[256];
  char small[4];
  const btf_status status = btf_options_set(options, name, value);
  fuzz_expect(status == BTF_OK || status == BTF_E_INVALID_ARG);
  if (status != BTF_OK) {
    fuzz_expect(btf_error_message()[0] != '\0');
    return;
  }
  check_value(codec, options, name);
  fuzz_expect(btfi_option_is_set(options, name) == 1);
  fuzz_expect(strcmp(btfi_option_text(options, name), value) == 0);
  const btf_status got = btf_options_get(options, name, text, sizeof text);
  fuzz_expect(got == (strlen(value) < sizeof text ? BTF_OK : BTF_E_LIMIT));
  if (got == BTF_OK) fuzz_expect(strcmp(text, value) == 0);
  fuzz_expect(btf_options_get(options, name, small, sizeof small) ==
              (strlen(value) < sizeof small ? BTF_OK : BTF_E_LIMIT));
}

static void set_lines(const btf_codec *codec, char *lines) {
  btf_options *options;
  char *rest;
  fuzz_expect(btf_options_create(codec, &options) == BTF_OK);
  for (char *line = strtok_r(lines, "\n", &rest); line != NULL; line = strtok_r(NULL, "\n", &rest)) {
    char *value = strchr(line, '=');
    if (value != NULL) *value++ = '\0';
    set(codec, options, line, value != NULL ? value : "");
  }
  btf_options_release(options);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static btf_context *ctx;
  uint64_t before, after;
  if (ctx == NULL) {
    ctx = fuzz_context((uint64_t)16 << 20);
    fuzz_expect(btf_context_register(ctx, &copy_codec) == BTF_OK);
  }
  btf_context_memory(ctx, &before, NULL);
  for (uint32_t i = 0; i < btf_codec_count(ctx); i++) {
    char *text = malloc(size + 1);
    fuzz_expect(text != NULL);
    if (size > 0) memcpy(text, data, size);
    text[size] = '\0';
    set_lines(btf_codec_at(ctx, i), text);
    free(text);
  }
  btf_context_memory(ctx, &after, NULL);
  fuzz_expect(before == after);
  return 0;
}
