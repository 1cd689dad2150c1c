/* SPDX-License-Identifier: MIT */
/* cmd_fetch.c: prints samples by their indices. */
#include <stdlib.h>
#include <string.h>

#include "commands.h"
#include "input.h"
#include "line_source.h"
#include "number_text.h"

enum { indices = 4, most_channels = 64 };

static const char *const index_names[indices] = {"x", "y", "light", "view"};

static int read_indices(const line_source *source, const char *line, const uint32_t bounds[indices],
                        uint32_t out[indices]) {
  const char *p = line;
  for (int k = 0; k < indices; k++) {
    while (*p == ' ' || *p == '\t') p++;
    if (*p == '\0') return line_fail(source, "%d numbers; 4 are expected: x y light view", k);
    if (!number_read_index(&p, &out[k])) {
      const size_t length = strcspn(p, " \t");
      return line_fail(source, "\"%.*s\" is not an index", (int)(length > 40 ? 40 : length), p);
    }
    if (out[k] >= bounds[k])
      return line_fail(source, "%s is %u; the file has 0 to %u", index_names[k], (unsigned)out[k],
                       (unsigned)(bounds[k] - 1));
  }
  while (*p == ' ' || *p == '\t') p++;
  if (*p != '\0') return line_fail(source, "more than 4 numbers; expected x y light view");
  return EXIT_DONE;
}

static int fetch_lines(const btf_model *model, line_source *source) {
  btf_model_info info = BTF_MODEL_INFO_INIT;
  uint32_t bounds[indices], at[indices];
  int failed = EXIT_DONE;
  btf_model_describe(model, &info);
  bounds[0] = info.width;
  bounds[1] = info.height;
  bounds[2] = btf_dirset_count(info.lights);
  bounds[3] = btf_dirset_count(info.views);
  while (!failed && !source->at_end) {
    failed = line_source_fill(source);
    for (char *line; !failed && (line = line_next(source)) != NULL;) {
      float sample[most_channels];
      char text[most_channels * 25];
      char *s = text;
      failed = read_indices(source, line, bounds, at);
      if (failed) break;
      btf_model_texel(model, 0, at[0], at[1], at[2], at[3], sample);
      for (uint32_t c = 0; c < info.channels; c++) {
        if (c > 0) *s++ = ' ';
        s += number_write(s, sample[c]);
      }
      *s++ = '\n';
      fwrite(text, 1, (size_t)(s - text), stdout);
    }
    if (failed)
      fflush(stdout);
    else
      failed = cli_flush();
  }
  return failed;
}

static int run(cli *c) {
  input in = {0};
  line_source source = {0};
  int failed = input_open_model(c, c->operands[0], &in);
  if (failed) return failed;
  failed = line_source_open(&source, cli_value(c, "queries"));
  if (!failed) failed = fetch_lines(in.model, &source);
  line_source_close(&source);
  input_close(&in);
  return failed;
}

static const cli_option options[] = {
    {"queries", 'f', "FILE", "read the indices from FILE instead of standard input", CLI_OPTION_PATH},
    INPUT_OPTIONS,
    CLI_OPTIONS_END};

const cli_command cmd_fetch = {"fetch",
                               "prints stored or decoded samples by index",
                               "FILE [options] < INDICES",
                               "A line of input is x y light view, counted from 0; row 0 is the bottom of "
                               "the texture. For each line one line with\n"
                               "a number per channel is printed: the sample as the data set stores it or the "
                               "codec decodes it, not interpolated.",
                               options,
                               1,
                               1,
                               run};
