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

int cli_set_options(const cli *c, const char *option, btf_options *options) {
  for (int i = 0; i < cli_count(c, option); i++) {
    const char *text = cli_value_at(c, option, i);
    const char *equals = strchr(text, '=');
    char *name;
    btf_status status;
    if (equals == NULL || equals == text)
      return cli_usage(c, "--%s is \"%s\"; it takes key=value (btf codecs lists the keys)", option, text);
    name = strndup(text, (size_t)(equals - text));
    if (name == NULL) return cli_out_of_memory();
    status = btf_options_set(options, name, equals + 1);
    free(name);
    if (status != BTF_OK) return cli_fail_library(status);
  }
  return EXIT_DONE;
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
