/* SPDX-License-Identifier: MIT */
/* cmd_bench.c: speed of encoding, loading and evaluation beside what the machine does at best. */
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bench_bounds.h"
#include "bench_queries.h"
#include "commands.h"
#include "input.h"
#include "json_writer.h"
#include "parallel.h"
#include "safe_text.h"

typedef struct eval_mode {
  const char *name;
  int order;
  bool batch, nearest, all_threads;
} eval_mode;

static const eval_mode modes[] = {
    {"single coherent", BENCH_COHERENT, false, false, false},
    {"single random", BENCH_RANDOM, false, false, false},
    {"batch coherent", BENCH_COHERENT, true, false, false},
    {"batch random", BENCH_RANDOM, true, false, false},
    {"batch shared directions", BENCH_SHARED, true, false, false},
    {"nearest single coherent", BENCH_COHERENT, false, true, false},
    {"nearest batch coherent", BENCH_COHERENT, true, true, false},
    {"nearest batch random", BENCH_RANDOM, true, true, false},
    {"batch coherent, all threads", BENCH_COHERENT, true, false, true},
    {"batch random, all threads", BENCH_RANDOM, true, false, true},
};
enum { mode_count = sizeof modes / sizeof *modes };

typedef struct bench {
  const char *codec;
  btf_model_info model;
  double encode_seconds, raw_bytes, open_seconds, trusted_open_seconds;
  double rates[mode_count]; /* queries a second */
  btf_eval_cost costs[mode_count];
  bench_bounds bounds;
} bench;

/* ---- cost ---- */

static void ask_costs(bench *b, const btf_model *model) {
  for (int i = 0; i < mode_count; i++) {
    const uint32_t flags = (modes[i].nearest ? BTF_QUERY_NEAREST : 0u) |
                           (modes[i].order == BENCH_SHARED ? BTF_COST_SHARED_DIRECTIONS : 0u);
    b->costs[i] = (btf_eval_cost)BTF_EVAL_COST_INIT;
    btf_model_cost(model, flags, &b->costs[i]);
  }
}

/* Mean size of what a random query reads at one place; 0 = unknown. */
static double row_bytes(const bench *b) {
  const btf_eval_cost *cost = &b->costs[0];
  return cost->rows > 0 ? cost->bytes / cost->rows : 0;
}

/* ---- measuring ---- */

typedef struct shared_run {
  const bench_queries *queries; /* one for each thread: they hold the results */
  const btf_model *model;
  uint32_t flags;
} shared_run;

static bool run_share(void *user, uint64_t index, uint32_t thread) {
  const shared_run *r = user;
  (void)index;
  bench_queries_batch(&r->queries[thread], r->model, r->flags);
  return true;
}

/* Repeats one mode for about `seconds`; the rate of the best repetition. */
static double time_mode(const cli *c, const eval_mode *mode, const bench_queries *queries,
                        const btf_model *model, double seconds) {
  const uint32_t flags = mode->nearest ? BTF_QUERY_NEAREST : 0;
  const double until = cli_seconds() + seconds;
  double best = 0;
  do {
    const double started = cli_seconds();
    double elapsed, done = BENCH_QUERIES;
    if (mode->all_threads) {
      shared_run r = {queries, model, flags};
      const uint64_t shares = 8 * (uint64_t)c->threads;
      parallel_for(c->threads, shares, run_share, &r);
      done *= (double)shares;
    } else if (mode->batch) {
      bench_queries_batch(queries, model, flags);
    } else {
      bench_queries_single(queries, model, flags);
    }
    elapsed = cli_seconds() - started;
    if (elapsed > 0 && done / elapsed > best) best = done / elapsed;
  } while (cli_seconds() < until);
  return best;
}

/* Bounds and modes take turns, so that a busy moment of the machine falls on all alike. */
static int measure_evaluation(cli *c, bench *b, const btf_model *model, double seconds) {
  enum { rounds = 5 };
  const uint32_t sets = c->threads > 0 ? c->threads : 1;
  bench_queries *queries = calloc((size_t)sets * BENCH_ORDERS, sizeof *queries);
  bench_buffers buffers = {0};
  int failed = queries != NULL ? bench_buffers_create(&buffers) : cli_out_of_memory();
  ask_costs(b, model);
  buffers.row_bytes = (size_t)row_bytes(b);
  buffers.span = (size_t)b->model.resident_bytes;
  for (int order = 0; order < BENCH_ORDERS && !failed; order++)
    for (uint32_t t = 0; t < sets && !failed; t++)
      if (!bench_queries_create(order, &b->model, &queries[(uint32_t)order * sets + t]))
        failed = cli_out_of_memory();
  for (int round = 0; round < rounds && !failed; round++) {
    bench_bounds_measure(&buffers, &b->bounds);
    for (int i = 0; i < mode_count && !failed; i++) {
      const bench_queries *q = &queries[(uint32_t)modes[i].order * sets];
      const double rate = time_mode(c, &modes[i], q, model, seconds / (rounds * mode_count));
      if (rate > b->rates[i]) b->rates[i] = rate;
      if (cli_progress(c, (double)(round * mode_count + i) / (rounds * mode_count), "evaluating"))
        failed = cli_fail_interrupted();
    }
  }
  for (uint32_t i = 0; queries != NULL && i < sets * BENCH_ORDERS; i++) bench_queries_free(&queries[i]);
  free(queries);
  bench_buffers_free(&buffers);
  return failed;
}

/* Opening, loading and the first query; the least of five. */
static int measure_open(cli *c, const char *path, uint32_t flags, double *seconds) {
  btf_context *ctx;
  int failed = cli_context(c, &ctx);
  *seconds = INFINITY;
  for (int i = 0; i < 5 && !failed; i++) {
    const double started = cli_seconds();
    const btf_query query = {{0, 0, 1}, {0, 0, 1}, {0.5f, 0.5f}, 0, 0};
    float result[64];
    btf_file *file = NULL;
    btf_model *model = NULL;
    btf_status status = btf_file_open_path(ctx, path, flags, &file);
    if (status == BTF_OK) status = btf_file_load_model(file, 0, &model);
    if (status == BTF_OK) btf_model_eval(model, &query, result);
    if (status != BTF_OK) failed = cli_fail_library(status);
    if (cli_seconds() - started < *seconds) *seconds = cli_seconds() - started;
    btf_model_release(model);
    btf_file_close(file);
  }
  return failed;
}

/* ---- report ---- */

/* Queries a second at a bound, 0 = unknown. */
static double conversion_bound(const bench *b, int mode) {
  const btf_eval_cost *cost = &b->costs[mode];
  const double rate = cost->bytes == 4 * cost->values ? b->bounds.float_values : b->bounds.half_values;
  return cost->values > 0 ? rate / cost->values : 0;
}
static double flop_bound(const bench *b, int mode) {
  return b->costs[mode].flops > 0 ? b->bounds.flops / b->costs[mode].flops : 0;
}
static double cache_bound(const bench *b, int mode) {
  return b->costs[mode].bytes > 0 ? b->bounds.cache_bytes / b->costs[mode].bytes : 0;
}

static double tightest_bound(const bench *b, int mode) {
  return fmin(conversion_bound(b, mode), fmin(flop_bound(b, mode), cache_bound(b, mode)));
}

/* What random queries would reach if each place they read were a row anywhere in the model's memory; 0 for
 * others. A measure, no bound: places lie side by side, and small tables stay in the cache. */
static double random_rows_rate(const bench *b, int mode) {
  if (modes[mode].order != BENCH_RANDOM || !(b->costs[mode].rows > 0)) return 0;
  return b->bounds.random_rows / b->costs[mode].rows;
}

static void print_report(const cli *c, const bench *b) {
  const bench_bounds *k = &b->bounds;
  safe_text_put(stdout, c->operands[0]);
  printf(": %s, %" PRIu32 " x %" PRIu32 " texels, %" PRIu32 " lights, %" PRIu32 " views, %" PRIu32
         " channels, %.1f MiB resident\n",
         b->codec, b->model.width, b->model.height, btf_dirset_count(b->model.lights),
         btf_dirset_count(b->model.views), b->model.channels, (double)b->model.resident_bytes / 1048576);
  printf("machine, one core (%s; the library uses %s)\n", bench_bounds_isa(), btf_context_isa(c->context));
  printf("  multiply-add            %8.1f GFLOP/s\n", k->flops * 1e-9);
  printf("  halves to floats        %8.1f Gvalues/s\n", k->half_values * 1e-9);
  printf("  floats                  %8.1f Gvalues/s\n", k->float_values * 1e-9);
  printf("  cache read (256 KiB)    %8.1f GB/s\n", k->cache_bytes * 1e-9);
  printf("  memory read             %8.1f GB/s\n", k->memory_bytes * 1e-9);
  if (k->random_rows > 0)
    printf("  random rows in %.1f MiB %9.1f Mrows/s of %.0f bytes\n",
           (double)b->model.resident_bytes / 1048576, k->random_rows * 1e-6, row_bytes(b));
  if (b->encode_seconds > 0)
    printf("encode                    %8.2f s, %.1f MB/s of raw samples, %" PRIu32 " threads\n",
           b->encode_seconds, b->raw_bytes * 1e-6 / b->encode_seconds, c->threads);
  printf("open and first query      %8.3f ms, %.3f ms without checksums of mapped chunks\n",
         1e3 * b->open_seconds, 1e3 * b->trusted_open_seconds);
  if (b->costs[0].bytes > 0)
    printf("a query                   %8.0f bytes in %.0f places, %.0f values, %.0f operations\n",
           b->costs[0].bytes, b->costs[0].rows, b->costs[0].values, b->costs[0].flops);
  printf("evaluation, one core        million queries/s   bounds: conversion   multiply-add    cache   "
         "reached   random rows\n");
  for (int i = 0; i < mode_count; i++) {
    printf("  %-27s %14.3f", modes[i].name, b->rates[i] * 1e-6);
    if (modes[i].all_threads)
      printf("      (%" PRIu32 " threads)", c->threads);
    else if (b->costs[i].values > 0)
      printf("   %26.2f %14.2f %8.2f %7.0f %%", 1e-6 * conversion_bound(b, i), 1e-6 * flop_bound(b, i),
             1e-6 * cache_bound(b, i), 100 * b->rates[i] / tightest_bound(b, i));
    if (!modes[i].all_threads && random_rows_rate(b, i) > 0)
      printf("   %11.2f", 1e-6 * random_rows_rate(b, i));
    putchar('\n');
  }
}

static void write_report(const cli *c, const bench *b) {
  json_writer j;
  json_begin(&j, stdout);
  json_object(&j, NULL);
  json_string(&j, "file", c->operands[0]);
  json_string(&j, "codec", b->codec);
  json_integer(&j, "threads", c->threads);
  json_string(&j, "isa", btf_context_isa(c->context));
  json_integer(&j, "resident_bytes", b->model.resident_bytes);
  json_object(&j, "bounds");
  json_string(&j, "isa", bench_bounds_isa());
  json_number(&j, "flops", b->bounds.flops);
  json_number(&j, "half_values", b->bounds.half_values);
  json_number(&j, "float_values", b->bounds.float_values);
  json_number(&j, "cache_bytes", b->bounds.cache_bytes);
  json_number(&j, "memory_bytes", b->bounds.memory_bytes);
  json_number(&j, "random_rows", b->bounds.random_rows > 0 ? b->bounds.random_rows : NAN);
  json_number(&j, "row_bytes", b->bounds.random_rows > 0 ? row_bytes(b) : NAN);
  json_close(&j, '}');
  json_number(&j, "encode_seconds", b->encode_seconds > 0 ? b->encode_seconds : NAN);
  json_number(&j, "encode_raw_bytes_per_second",
              b->encode_seconds > 0 ? b->raw_bytes / b->encode_seconds : NAN);
  json_number(&j, "open_seconds", b->open_seconds);
  json_number(&j, "trusted_open_seconds", b->trusted_open_seconds);
  json_array(&j, "evaluation");
  for (int i = 0; i < mode_count; i++) {
    const bool known = b->costs[i].values > 0 && !modes[i].all_threads;
    json_object(&j, NULL);
    json_string(&j, "mode", modes[i].name);
    json_integer(&j, "threads", modes[i].all_threads ? c->threads : 1);
    json_number(&j, "queries_per_second", b->rates[i]);
    json_number(&j, "bytes", known ? b->costs[i].bytes : NAN);
    json_number(&j, "places", known ? b->costs[i].rows : NAN);
    json_number(&j, "values", known ? b->costs[i].values : NAN);
    json_number(&j, "operations", known ? b->costs[i].flops : NAN);
    json_number(&j, "conversion_bound", known ? conversion_bound(b, i) : NAN);
    json_number(&j, "multiply_add_bound", known ? flop_bound(b, i) : NAN);
    json_number(&j, "cache_bound", known ? cache_bound(b, i) : NAN);
    json_number(&j, "random_rows_rate", known && random_rows_rate(b, i) > 0 ? random_rows_rate(b, i) : NAN);
    json_close(&j, '}');
  }
  json_close(&j, ']');
  json_close(&j, '}');
  json_end(&j);
}

/* ---- the command ---- */

static int bench_file(cli *c, bench *b, const char *path, double seconds) {
  input in = {0};
  int failed = input_open_model(c, path, &in);
  if (failed) return failed;
  btf_model_describe(in.model, &b->model);
  b->codec = btf_file_model_codec(in.file, 0);
  failed = measure_open(c, path, 0, &b->open_seconds);
  if (!failed) failed = measure_open(c, path, BTF_OPEN_TRUST, &b->trusted_open_seconds);
  if (!failed) failed = measure_evaluation(c, b, in.model, seconds);
  cli_progress_done(c);
  if (!failed && cli_has(c, "json"))
    write_report(c, b);
  else if (!failed)
    print_report(c, b);
  input_close(&in);
  return failed;
}

static int encode_to(cli *c, bench *b, const btf_dataset *dataset, const char *path) {
  const char *codec_id = cli_has(c, "codec") ? cli_value(c, "codec") : "fmf";
  const btf_codec *codec = btf_codec_find(c->context, codec_id);
  btf_options *options = NULL;
  btf_model *model = NULL;
  btf_job job = BTF_JOB_INIT;
  char *command;
  double started;
  btf_status status;
  int failed;
  if (codec == NULL) return cli_unknown_codec(c, c->context, codec_id);
  status = btf_options_create(codec, &options);
  if (status != BTF_OK) return cli_fail_library(status);
  failed = cli_set_options(c, "param", options);
  if (failed) {
    btf_options_release(options);
    return failed;
  }
  command = cli_recorded_command(c);
  cli_job(c, &job);
  started = cli_seconds();
  status = btf_model_fit(dataset, codec, options, &job, &model);
  if (status == BTF_OK) status = btf_model_save(model, path, 0, command, &job);
  b->encode_seconds = cli_seconds() - started;
  cli_progress_done(c);
  btf_model_release(model);
  btf_options_release(options);
  free(command);
  return status == BTF_OK ? EXIT_DONE : cli_fail_library(status);
}

/* A data set is encoded to a file of its own first, which goes at the end. */
static int bench_dataset(cli *c, bench *b, const btf_dataset *dataset, double seconds) {
  const char *folder = secure_getenv("TMPDIR");
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  char path[4096];
  int descriptor, failed;
  btf_dataset_describe(dataset, &d);
  b->raw_bytes = (double)input_value_count(btf_dirset_count(d.views), btf_dirset_count(d.lights), d.width,
                                           d.height, d.channels) *
                 input_sample_size(d.sample_type);
  snprintf(path, sizeof path, "%s/btf-bench-XXXXXX", folder != NULL && folder[0] != '\0' ? folder : "/tmp");
  cli_hold_interrupts();
  descriptor = mkstemp(path);
  if (descriptor < 0) {
    cli_release_interrupts();
    return cli_fail(EXIT_IO, "%s: could not be created: %s", path, strerror(errno));
  }
  close(descriptor);
  failed = encode_to(c, b, dataset, path);
  if (!failed) failed = bench_file(c, b, path, seconds);
  unlink(path);
  cli_release_interrupts();
  return failed;
}

static int run(cli *c) {
  input in = {0};
  bench b = {0};
  double seconds = 10;
  int failed = cli_number(c, "seconds", 0.01, 3600, &seconds);
  if (!failed) failed = input_open(c, c->operands[0], &in);
  if (failed) return failed;
  if (in.dataset == NULL && (cli_has(c, "codec") || cli_has(c, "param"))) {
    input_close(&in);
    return cli_usage(c, "%s: is compressed already; --codec and --param are for data sets", c->operands[0]);
  }
  b.model.struct_size = sizeof b.model;
  if (in.dataset != NULL)
    failed = bench_dataset(c, &b, in.dataset, seconds);
  else
    failed = bench_file(c, &b, c->operands[0], seconds);
  input_close(&in);
  return failed;
}

static const cli_option options_table[] = {
    {"codec", 'c', "NAME", "codec to encode a data set with (default fmf)", 0},
    {"param", 'p', "KEY=VALUE", "set a parameter of the codec; may be repeated", 0},
    {"seconds", 0, "S", "time for evaluation in all (default 10)", CLI_OPTION_UNRECORDED},
    CLI_OPTION_JSON,
    CLI_OPTIONS_END};

const cli_command cmd_bench = {"bench",
                               "measures speed beside the bounds of this machine",
                               "FILE [options]",
                               "Of a data-set folder: encodes it (in TMPDIR), opens the result and evaluates "
                               "it. Of a container: opens and evaluates.\n"
                               "Evaluation is timed for neighbouring pixels, for random queries and for one "
                               "pair of directions; the bounds are what\n"
                               "the values, operations and bytes of a query would take at the rates measured "
                               "beside it, with everything in\n"
                               "the cache. Beside random queries stands what rows read at random would "
                               "allow. A query's bytes, values and operations\n"
                               "are those that the codec states for its method.",
                               options_table,
                               1,
                               1,
                               run};
