/* SPDX-License-Identifier: MIT */
/* cli_codec.c: codecs and their parameters as named on the command line. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "cli.h"
#include "safe_text.h"

int cli_unknown_codec(const cli *c, const btf_context *ctx, const char *id) {
  enum { most = 256 };
  const char *words[most + 1];
  const char *nearest;
  uint32_t count = btf_codec_count(ctx);
  if (count > most) count = most;
  for (uint32_t i = 0; i < count; i++) words[i] = btf_codec_id(btf_codec_at(ctx, i));
  words[count] = NULL;
  nearest = cli_near_miss(id, words);
  if (nearest != NULL) return cli_usage(c, "no codec \"%s\"; did you mean %s?", id, nearest);
  return cli_usage(c, "no codec \"%s\"; btf codecs lists those of this build", id);
}

int cli_set_params(const cli *c, const char *name, const char *lister, btf_options *options) {
  for (int i = 0; i < cli_count(c, name); i++) {
    const char *text = cli_value_at(c, name, i);
    const char *equals = strchr(text, '=');
    char *key;
    btf_status status;
    if (equals == NULL || equals == text)
      return cli_usage(c, "--%s is \"%s\"; it takes key=value (%s lists the keys)", name, text, lister);
    key = strndup(text, (size_t)(equals - text));
    if (key == NULL) return cli_out_of_memory();
    status = btf_options_set(options, key, equals + 1);
    free(key);
    if (status != BTF_OK) return cli_fail_library(status);
  }
  return EXIT_DONE;
}

/* The last value that --param gives a key, or NULL. */
static const char *param_given(const cli *c, const char *key) {
  const size_t length = strlen(key);
  const char *value = NULL;
  for (int i = 0; i < cli_count(c, "param"); i++) {
    const char *text = cli_value_at(c, "param", i);
    if (strncmp(text, key, length) == 0 && text[length] == '=') value = text + length + 1;
  }
  return value;
}

/* A target picks the number of components; of 0 it is none. */
static int refuse_components(const cli *c) {
  static const char *const targets[] = {"psnr", "rmse"};
  if (param_given(c, "components") == NULL) return EXIT_DONE;
  for (int i = 0; i < 2; i++) {
    const char *target = param_given(c, targets[i]);
    if (target != NULL && strtod(target, NULL) > 0)
      return cli_usage(
          c, "components has no effect beside %s, which picks their number (max_components limits it)",
          targets[i]);
  }
  return EXIT_DONE;
}

int cli_codec_options(const cli *c, btf_options *options) {
  const int failed = cli_set_params(c, "param", "btf codecs", options);
  return failed ? failed : refuse_components(c);
}

/* ---- parameters as text ---- */

const char *cli_param_type(uint32_t type) {
  switch (type) {
  case BTF_PARAM_INT:
    return "int";
  case BTF_PARAM_FLOAT:
    return "float";
  case BTF_PARAM_BOOL:
    return "bool";
  case BTF_PARAM_CHOICE:
    return "choice";
  default:
    return "string";
  }
}

/* "1 .. 1024", "at least 0", "a | b", "true | false". */
static void print_range(const btf_param_desc *p) {
  if (p->type == BTF_PARAM_CHOICE) {
    for (int i = 0; p->choices != NULL && p->choices[i] != NULL; i++) {
      if (i > 0) fputs(" | ", stdout);
      safe_text_put(stdout, p->choices[i]);
    }
  } else if (p->type == BTF_PARAM_BOOL) {
    fputs("true | false", stdout);
  } else if (p->type == BTF_PARAM_INT || p->type == BTF_PARAM_FLOAT) {
    if (isfinite(p->minimum) && isfinite(p->maximum))
      fprintf(stdout, "%.10g .. %.10g", p->minimum, p->maximum);
    else if (isfinite(p->minimum))
      fprintf(stdout, "at least %.10g", p->minimum);
    else if (isfinite(p->maximum))
      fprintf(stdout, "at most %.10g", p->maximum);
    else
      fputs("any number", stdout);
    if (p->unit != NULL && p->unit[0] != '\0') fputc(' ', stdout);
    safe_text_put(stdout, p->unit);
  } else {
    fputs("text", stdout);
  }
}

void cli_print_param(const btf_param_desc *p) {
  printf("  -p %s=%s", p->name, cli_param_type(p->type));
  fputs("  (", stdout);
  print_range(p);
  fputs("; default ", stdout);
  safe_text_put(stdout, p->default_text != NULL && p->default_text[0] != '\0' ? p->default_text : "none");
  fputs(")\n      ", stdout);
  safe_text_put(stdout, p->summary);
  putchar('\n');
}

int cli_list_formats(cli *c, bool written) {
  btf_context *ctx;
  const int failed = cli_context(c, &ctx);
  if (failed) return failed;
  for (uint32_t i = 0; i < btf_format_count(ctx); i++) {
    const btf_format *format = btf_format_at(ctx, i);
    const uint32_t count = written ? btf_format_write_param_count(format) : btf_format_param_count(format);
    /* The folder is written by other means. */
    if (written && !btf_format_can_write(format) && strcmp(btf_format_id(format), "folder") != 0) continue;
    printf("%s: ", btf_format_id(format));
    safe_text_put(stdout, btf_format_title(format));
    putchar('\n');
    for (uint32_t k = 0; k < count; k++) {
      btf_param_desc p = {.struct_size = sizeof p};
      const btf_status status =
          written ? btf_format_write_param(format, k, &p) : btf_format_param(format, k, &p);
      if (status == BTF_OK) cli_print_param(&p);
    }
  }
  return EXIT_DONE;
}
