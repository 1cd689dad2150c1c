/* SPDX-License-Identifier: MIT */
/* cmd_verify.c: verifies every checksum and decodes everything once. */
#include <inttypes.h>
#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "commands.h"
#include "safe_text.h"
#include "sample_walk.h"

typedef struct finite_check {
  const sample_source *source;
  atomic_bool failed;
  uint32_t x, y, light, view; /* of the first value a thread found; written by whoever sets `failed` */
} finite_check;

static btf_status check_block(void *user, const sample_visit *visit) {
  finite_check *f = user;
  const uint64_t values = visit->image_values * visit->lights;
  for (uint64_t i = 0; i < values; i++) {
    bool expected = false;
    const uint64_t texel = i % visit->image_values / f->source->channels;
    if (isfinite(visit->a[i])) continue;
    if (atomic_compare_exchange_strong(&f->failed, &expected, true)) {
      f->x = (uint32_t)(texel % f->source->width);
      f->y = (uint32_t)(texel / f->source->width);
      f->light = visit->light0 + (uint32_t)(i / visit->image_values);
      f->view = visit->view;
    }
    return BTF_OK;
  }
  return BTF_OK;
}

static int decode_level(cli *c, const sample_source *source, uint64_t *samples) {
  finite_check f = {0};
  /* Each level has about a quarter of the samples of the one before it. */
  const double from = 1 - pow(0.25, source->level), to = 1 - pow(0.25, source->level + 1.0);
  const sample_walk walk = {source, NULL, check_block, &f, "decoding", from, to};
  int failed;
  f.source = source;
  failed = sample_walk_run(c, &walk);
  cli_progress_done(c);
  if (failed) return failed;
  if (f.failed)
    return cli_fail(EXIT_MALFORMED,
                    "%s: the value at x %" PRIu32 ", y %" PRIu32 ", light %" PRIu32 ", view %" PRIu32
                    " of level %" PRIu32 " decodes to something not finite",
                    source->path, f.x, f.y, f.light, f.view, source->level);
  *samples += (uint64_t)source->views * source->lights * source->width * source->height;
  return EXIT_DONE;
}

/* Reads or decodes every sample of the opened input, of every level it has. */
static int decode_all(cli *c, input *in, uint64_t *samples) {
  sample_source source;
  int failed = sample_source_open(in, &source);
  source.marks_defects = true;
  for (uint32_t level = 0; !failed && level < source.levels; level++) {
    sample_source_set_level(&source, level);
    failed = decode_level(c, &source, samples);
  }
  return failed;
}

static void on_issue(void *user, uint32_t issue, int32_t severity, uint64_t offset, const char *text) {
  /* The first error ends the command with its own line; what comes here besides are remarks. */
  if (severity != BTF_LOG_ERROR)
    cli_note(user, "note %" PRIu32 " at byte %" PRIu64 ": %s", issue, offset, text);
}

static int verify_container(cli *c, input *in) {
  const uint32_t models = btf_file_model_count(in->file);
  uint64_t samples = 0;
  btf_status status = btf_file_validate(in->file, on_issue, c);
  if (status != BTF_OK) return cli_fail_library(status);
  for (uint32_t i = 0; i < models; i++) {
    int failed;
    status = btf_file_load_model(in->file, i, &in->model);
    if (status != BTF_OK) return cli_fail_library(status);
    failed = decode_all(c, in, &samples);
    btf_model_release(in->model);
    in->model = NULL;
    if (failed) return failed;
  }
  safe_text_put(stdout, in->path);
  printf(": good: %" PRIu32 " chunks, %" PRIu32 " model%s, %" PRIu64 " samples decoded\n",
         btf_file_chunk_count(in->file), models, models == 1 ? "" : "s", samples);
  return EXIT_DONE;
}

static int run(cli *c) {
  input in = {0};
  uint64_t samples = 0;
  int failed = input_open(c, c->operands[0], &in);
  if (failed) return failed;
  if (in.file != NULL) {
    failed = verify_container(c, &in);
  } else {
    failed = decode_all(c, &in, &samples);
    if (!failed) {
      safe_text_put(stdout, in.path);
      printf(": good: %" PRIu64 " samples read\n", samples);
    }
  }
  input_close(&in);
  return failed;
}

static const cli_option options[] = {INPUT_OPTIONS, CLI_OPTIONS_END};

const cli_command cmd_verify = {
    "verify",
    "checks a file and decodes everything once",
    "FILE [options]",
    "Verifies structure and every checksum of a container and decodes every sample "
    "at every level of detail; of a\n"
    "data-set folder it reads every sample. Status 3 at the first fault, which the "
    "message names by its chunk or place;\n"
    "5 if the codec is not there.",
    options,
    1,
    1,
    run};
