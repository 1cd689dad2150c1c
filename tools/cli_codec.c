/* SPDX-License-Identifier: MIT */
/* cli_codec.c: codecs and their parameters as named on the command line. */
#include <stdlib.h>
#include <string.h>

#include "cli.h"

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

int cli_codec_options(const cli *c, btf_options *options) {
  for (int i = 0; i < cli_count(c, "param"); i++) {
    const char *text = cli_value_at(c, "param", i);
    const char *equals = strchr(text, '=');
    char *name;
    btf_status status;
    if (equals == NULL || equals == text)
      return cli_usage(c, "--param is \"%s\"; it takes key=value (btf codecs lists the keys)", text);
    name = strndup(text, (size_t)(equals - text));
    if (name == NULL) return cli_out_of_memory();
    status = btf_options_set(options, name, equals + 1);
    free(name);
    if (status != BTF_OK) return cli_fail_library(status);
  }
  return EXIT_DONE;
}
