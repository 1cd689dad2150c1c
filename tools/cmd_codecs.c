/* SPDX-License-Identifier: MIT */
/* cmd_codecs.c: lists codecs and their parameters. */
#include <stdlib.h>
#include <string.h>

#include "commands.h"
#include "json_writer.h"
#include "safe_text.h"

static const struct {
  uint64_t bit;
  const char *word, *meaning;
} capabilities[] = {
    {BTF_CAP_FIT, "fit", "compresses data sets"},
    {BTF_CAP_STREAM_FIT, "stream-fit", "never holds the whole data set"},
    {BTF_CAP_BATCH, "batch", "has a batch evaluation of its own"},
    {BTF_CAP_LOD, "lod", "has levels of detail"},
    {BTF_CAP_LINEAR, "linear", "filtering the representation equals filtering colours"},
    {BTF_CAP_RGB_ONLY, "rgb-only", "takes three channels only"},
    {BTF_CAP_HARDENED, "hardened", "safe on hostile files"},
};
enum { capability_count = sizeof capabilities / sizeof *capabilities };

static void print_codec(const btf_codec *codec) {
  const uint64_t caps = btf_codec_caps(codec);
  bool first = true;
  printf("%s: ", btf_codec_id(codec));
  safe_text_put(stdout, btf_codec_title(codec));
  fputs("\n  capabilities: ", stdout);
  for (int i = 0; i < capability_count; i++) {
    if (!(caps & capabilities[i].bit)) continue;
    printf("%s%s", first ? "" : ", ", capabilities[i].word);
    first = false;
  }
  puts(first ? "none" : "");
  for (uint32_t i = 0; i < btf_codec_param_count(codec); i++) {
    btf_param_desc p = {0};
    p.struct_size = sizeof p;
    if (btf_codec_param(codec, i, &p) != BTF_OK) continue;
    cli_print_param(&p);
  }
}

static void write_param(json_writer *j, const btf_param_desc *p) {
  const bool is_number = p->type == BTF_PARAM_INT || p->type == BTF_PARAM_FLOAT;
  json_object(j, NULL);
  json_string(j, "name", p->name);
  json_string(j, "summary", p->summary);
  json_string(j, "type", cli_param_type(p->type));
  json_string(j, "unit", p->unit);
  json_string(j, "default", p->default_text);
  if (is_number) {
    json_number(j, "minimum", p->minimum);
    json_number(j, "maximum", p->maximum);
  }
  if (p->type == BTF_PARAM_CHOICE) {
    json_flat_array(j, "choices");
    for (int i = 0; p->choices != NULL && p->choices[i] != NULL; i++) json_string(j, NULL, p->choices[i]);
    json_close(j, ']');
  }
  json_close(j, '}');
}

static void write_codec(json_writer *j, const btf_codec *codec) {
  const uint64_t caps = btf_codec_caps(codec);
  json_object(j, NULL);
  json_string(j, "id", btf_codec_id(codec));
  json_string(j, "title", btf_codec_title(codec));
  json_flat_array(j, "capabilities");
  for (int i = 0; i < capability_count; i++)
    if (caps & capabilities[i].bit) json_string(j, NULL, capabilities[i].word);
  json_close(j, ']');
  json_array(j, "parameters");
  for (uint32_t i = 0; i < btf_codec_param_count(codec); i++) {
    btf_param_desc p = {0};
    p.struct_size = sizeof p;
    if (btf_codec_param(codec, i, &p) == BTF_OK) write_param(j, &p);
  }
  json_close(j, ']');
  json_close(j, '}');
}

static int run(cli *c) {
  btf_context *ctx;
  const btf_codec *only = NULL;
  json_writer j;
  const int failed = cli_context(c, &ctx);
  if (failed) return failed;
  if (c->operand_count > 0) {
    only = btf_codec_find(ctx, c->operands[0]);
    if (only == NULL) return cli_unknown_codec(c, ctx, c->operands[0]);
  }
  if (cli_has(c, "json")) {
    json_begin(&j, stdout);
    json_object(&j, NULL);
    json_array(&j, "codecs");
    for (uint32_t i = 0; i < btf_codec_count(ctx); i++)
      if (only == NULL || only == btf_codec_at(ctx, i)) write_codec(&j, btf_codec_at(ctx, i));
    json_close(&j, ']');
    json_close(&j, '}');
    json_end(&j);
    return EXIT_DONE;
  }
  for (uint32_t i = 0; i < btf_codec_count(ctx); i++) {
    if (only != NULL && only != btf_codec_at(ctx, i)) continue;
    if (only == NULL && i > 0) putchar('\n');
    print_codec(btf_codec_at(ctx, i));
  }
  if (only != NULL) {
    putchar('\n');
    for (int i = 0; i < capability_count; i++)
      if (btf_codec_caps(only) & capabilities[i].bit)
        printf("  %-11s %s\n", capabilities[i].word, capabilities[i].meaning);
  }
  return EXIT_DONE;
}

static const cli_option options[] = {CLI_OPTION_JSON, CLI_OPTIONS_END};

const cli_command cmd_codecs = {"codecs",
                                "lists the codecs and their parameters",
                                "[NAME] [--json]",
                                "Codecs come with the build, from the folders of BTF_PLUGIN_PATH (absolute, "
                                "separated by ':') or the installed\n"
                                "plug-in folder, and from --plugin.",
                                options,
                                0,
                                1,
                                run};
