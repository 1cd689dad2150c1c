/* SPDX-License-Identifier: MIT */
/* cmd_eval.c: evaluates a model at queries given as text. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "commands.h"
#include "input.h"
#include "line_source.h"
#include "number_text.h"

enum { batch_size = 8192, query_numbers = 8, number_room = 25 };

typedef struct evaluation {
  const btf_model *model;
  uint32_t channels;
  int value;
  btf_batch batch;
  float *coordinates[query_numbers]; /* u, v, light, view as on a line */
  float *lods;
  float **results; /* one array for each channel */
  float *result_block;
  char *text;
} evaluation;

static int make_room(evaluation *e, uint32_t channels, double lod) {
  float *block = malloc(sizeof(float) * batch_size * (query_numbers + 1));
  e->channels = channels;
  e->coordinates[0] = block;
  e->result_block = malloc(sizeof(float) * batch_size * channels);
  e->results = malloc(sizeof(float *) * channels);
  e->text = malloc((size_t)batch_size * channels * number_room);
  if (block == NULL || e->result_block == NULL || e->results == NULL || e->text == NULL)
    return cli_out_of_memory();
  for (int k = 0; k < query_numbers; k++) e->coordinates[k] = block + (size_t)k * batch_size;
  e->lods = block + (size_t)query_numbers * batch_size;
  for (int i = 0; i < batch_size; i++) e->lods[i] = (float)lod;
  for (uint32_t c = 0; c < channels; c++) e->results[c] = e->result_block + (size_t)c * batch_size;
  e->batch.struct_size = sizeof e->batch;
  for (int k = 0; k < 2; k++) e->batch.uv[k] = e->coordinates[k];
  for (int k = 0; k < 3; k++) e->batch.light[k] = e->coordinates[2 + k];
  for (int k = 0; k < 3; k++) e->batch.view[k] = e->coordinates[5 + k];
  e->batch.lod = lod != 0 ? e->lods : NULL;
  return EXIT_DONE;
}

static void drop_room(evaluation *e) {
  free(e->coordinates[0]);
  free(e->result_block);
  free(e->results);
  free(e->text);
}

static int check_direction(const line_source *source, const char *name, const float d[3]) {
  const double squared = (double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2];
  /* Below the horizon and not finite have a defined result, 0. */
  if (!(d[2] > 0) || !isfinite(squared) || fabs(sqrt(squared) - 1) <= 1e-3) return EXIT_DONE;
  return line_fail(source, "the %s direction has length %.6g; unit vectors are expected", name,
                   sqrt(squared));
}

static int read_query(evaluation *e, const line_source *source, const char *line, size_t slot) {
  float q[query_numbers];
  const char *p = line;
  int failed;
  for (int k = 0; k < query_numbers; k++) {
    while (*p == ' ' || *p == '\t') p++;
    if (*p == '\0') return line_fail(source, "%d numbers; 8 are expected: u v wix wiy wiz wox woy woz", k);
    if (!number_read(&p, &q[k]))
      return line_fail(source, "\"%.*s\" is not a number",
                       (int)strcspn(p, " \t") > 40 ? 40 : (int)strcspn(p, " \t"), p);
  }
  while (*p == ' ' || *p == '\t') p++;
  if (*p != '\0') return line_fail(source, "more than 8 numbers; expected u v wix wiy wiz wox woy woz");
  failed = check_direction(source, "light", q + 2);
  if (!failed) failed = check_direction(source, "view", q + 5);
  if (failed) return failed;
  for (int k = 0; k < query_numbers; k++) e->coordinates[k][slot] = q[k];
  return EXIT_DONE;
}

static void evaluate(evaluation *e, size_t count) {
  char *s = e->text;
  if (count == 0) return;
  e->batch.count = count;
  btf_model_eval_n(e->model, &e->batch, e->value, e->results);
  for (size_t i = 0; i < count; i++) {
    for (uint32_t c = 0; c < e->channels; c++) {
      if (c > 0) *s++ = ' ';
      s += number_write(s, e->results[c][i]);
    }
    *s++ = '\n';
  }
  fwrite(e->text, 1, (size_t)(s - e->text), stdout);
}

static int evaluate_lines(evaluation *e, line_source *source) {
  int failed = EXIT_DONE;
  while (!failed && !source->at_end) {
    size_t count = 0;
    failed = line_source_fill(source);
    if (failed) break;
    for (char *line; !failed && (line = line_next(source)) != NULL;) {
      failed = read_query(e, source, line, count);
      if (failed) break;
      if (++count == batch_size) {
        evaluate(e, count);
        count = 0;
      }
    }
    evaluate(e, count);
    /* Whoever writes queries one by one and waits for each answer gets it. */
    if (!failed || count > 0) {
      const int flushed = cli_flush();
      if (!failed) failed = flushed;
    }
  }
  return failed;
}

static int run(cli *c) {
  static const char *const values[] = {"brdf", "brdf_cos", "stored", NULL};
  evaluation e = {0};
  line_source source = {0};
  input in = {0};
  btf_model_info info = BTF_MODEL_INFO_INIT;
  double lod = 0;
  int failed = cli_number(c, "lod", 0, 64, &lod);
  e.value = BTF_VALUE_BRDF;
  if (!failed) failed = cli_choice(c, "value", values, &e.value);
  if (failed) return failed;
  failed = input_open_model(c, c->operands[0], &in);
  if (failed) return failed;
  e.model = in.model;
  btf_model_describe(in.model, &info);
  failed = make_room(&e, info.channels, lod);
  if (cli_has(c, "nearest")) e.batch.flags = BTF_QUERY_NEAREST;
  if (!failed) failed = line_source_open(&source, cli_value(c, "queries"));
  if (!failed) failed = evaluate_lines(&e, &source);
  line_source_close(&source);
  drop_room(&e);
  input_close(&in);
  return failed;
}

static const cli_option options[] = {
    {"queries", 'f', "FILE", "read the queries from FILE instead of standard input", CLI_OPTION_PATH},
    {"lod", 0, "L", "level of detail; 0 is the finest (default), +1 halves the resolution", 0},
    {"value", 0, "WHAT",
     "brdf (default): f in 1/sr, without the cosine;\nbrdf_cos: f times wiz; stored: as the file holds it",
     0},
    {"nearest", 0, NULL,
     "nearest stored samples instead of interpolation; what a codec computes\nfrom a formula stays at the "
     "directions given",
     0},
    INPUT_OPTIONS,
    CLI_OPTIONS_END};

const cli_command cmd_eval = {
    "eval",
    "evaluates a model or data set at queries",
    "FILE [options] < QUERIES",
    "A query is a line of 8 numbers, u v wix wiy wiz wox woy woz: the position in "
    "tiles, the unit vector toward the\n"
    "light and the one toward the viewer, in the frame of tangent, bitangent and "
    "normal. For each query one line with\n"
    "a number per channel is printed. Directions below the horizon give 0. Empty "
    "lines and lines that begin with #\n"
    "are passed over. FILE is a container file, a data-set folder or measured data.",
    options,
    1,
    1,
    run};
