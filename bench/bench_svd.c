/* SPDX-License-Identifier: MIT */
/* bench_svd: the truncated SVD of a large mapped data set, against the machine's own bounds and against
 * scikit-learn. The decomposition is reached as codecs reach it: through the host table, from inside a
 * codec's fit. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <cblas.h>

#include <btf/btf.h>
#include <btf/btf_plugin.h>

#include "svd_material.h"
#include "svd_reference.h"

/* ---- options ---- */

typedef struct bench_options {
  char folder[4096];
  const char *directions, *peer;
  int kind;
  uint32_t size, runs, block_items, threads;
  uint64_t memory;
  int by_image, verbose, optimum;
  int only; /* number of the case to run, from 1; 0 = all */
} bench_options;

typedef struct bench_case {
  uint32_t rank;
  double tolerance;
  const char *peer_settings; /* scikit-learn's cheapest that reaches this error: iterations and normaliser */
} bench_case;

static const bench_case cases[] = {
    {32, 0.004, "2 LU"}, {32, 0.0005, "4 LU"}, {100, 0.0125, "2 LU"}, {100, 0.002, "4 LU"}};

/* Of all threads: what a busy machine does not change. */
static double processor_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* ---- memory beside the mapping ---- */

static uint64_t anonymous_bytes(void) {
  char line[256];
  unsigned long long kib = 0;
  FILE *file = fopen("/proc/self/status", "r");
  if (file == NULL) return 0;
  while (fgets(line, sizeof line, file) != NULL) {
    if (sscanf(line, "RssAnon: %llu kB", &kib) == 1) break;
  }
  fclose(file);
  return kib * 1024;
}

/* ---- the decomposition as a codec sees it ---- */

typedef struct bench_run {
  const bench_options *options;
  bench_case what;
  const btf_host *host;
  const btf_dataset *ds;
  btf_dataset_desc shape;
  uint32_t lights, views;
  uint64_t peak, memory;
  double seconds, reading, processor;
  uint32_t passes;
  double said, error; /* as the result has it, and by the differences */
  int optimum;        /* to find that instead */
  int failed;
} bench_run;

static bench_run *current; /* a codec has no user pointer */

/* Items are texels: blocks of neighbours in a row of the texture, or whole rows. */
static btf_status read_texels(void *user, uint64_t item0, uint64_t items, float *dst, size_t ld) {
  bench_run *run = user;
  const double start = now();
  const ptrdiff_t row = (ptrdiff_t)(ld * sizeof(float)), channels = (ptrdiff_t)run->shape.channels;
  const uint64_t width = run->shape.width;
  btf_status status = BTF_OK;
  while (items > 0 && status == BTF_OK) {
    const uint32_t x = (uint32_t)(item0 % width), y = (uint32_t)(item0 / width);
    const uint32_t rows = x == 0 ? (uint32_t)(items / width) : 0;
    const uint32_t count = rows > 0 ? (uint32_t)width : (uint32_t)(items < width - x ? items : width - x);
    const btf_block block = {0, run->views, 0, run->lights, x, y, count, rows > 0 ? rows : 1};
    const btf_strides strides = {row * channels * (ptrdiff_t)run->lights, row * channels,
                                 (ptrdiff_t)(width * sizeof(float)), sizeof(float), row};
    status = run->host->dataset_read(run->ds, &block, dst, &strides);
    const uint64_t done = (uint64_t)block.width * block.height;
    item0 += done;
    items -= done;
    dst += done;
  }
  run->reading += now() - start;
  const uint64_t bytes = anonymous_bytes();
  if (bytes > run->peak) run->peak = bytes;
  return status;
}

/* Items are rows of the matrix: one channel of one image each. */
static btf_status read_images(void *user, uint64_t item0, uint64_t items, float *dst, size_t ld) {
  bench_run *run = user;
  const double start = now();
  const ptrdiff_t row = (ptrdiff_t)(ld * sizeof(float));
  const uint32_t channels = run->shape.channels;
  btf_status status = BTF_OK;
  for (uint64_t done = 0; done < items && status == BTF_OK; done += channels) {
    const uint64_t image = (item0 + done) / channels;
    const btf_block block = {(uint32_t)(image / run->lights),
                             1,
                             (uint32_t)(image % run->lights),
                             1,
                             0,
                             0,
                             run->shape.width,
                             run->shape.height};
    const btf_strides strides = {row, row, (ptrdiff_t)(run->shape.width * sizeof(float)), sizeof(float), row};
    status = run->host->dataset_read(run->ds, &block, dst + done * ld, &strides);
  }
  run->reading += now() - start;
  const uint64_t bytes = anonymous_bytes();
  if (bytes > run->peak) run->peak = bytes;
  return status;
}

static btf_status fit_probe(const btf_host *host, btf_context *ctx, const btf_dataset *ds,
                            const btf_options *options, const btf_job *job, btf_chunk_writer *payload) {
  bench_run *run = current;
  (void)options;
  (void)payload;
  run->host = host;
  run->ds = ds;
  run->shape.struct_size = sizeof run->shape;
  btf_status status = host->dataset_describe(ds, &run->shape);
  if (status != BTF_OK) return status;
  run->lights = host->dirset_count(run->shape.lights);
  run->views = host->dirset_count(run->shape.views);
  const uint64_t texels = (uint64_t)run->shape.width * run->shape.height;
  const uint64_t samples = (uint64_t)run->lights * run->views * run->shape.channels;
  btf_svd_desc desc = {.struct_size = sizeof desc};
  desc.items = run->options->by_image ? samples : texels;
  desc.length = run->options->by_image ? texels : samples;
  desc.layout = run->options->by_image ? BTF_LAYOUT_ITEM_ROWS : BTF_LAYOUT_ITEM_COLUMNS;
  desc.read = run->options->by_image ? read_images : read_texels;
  desc.user = run;
  desc.rank = run->what.rank;
  desc.tolerance = run->what.tolerance;
  desc.max_working_set = run->memory;
  desc.block_items = run->options->block_items;
  if (run->options->by_image) desc.block_items = run->shape.channels;
  desc.seed = job->seed;
  if (run->optimum) {
    run->failed = reference_optimum(&desc, run->what.rank, &run->error) != 0;
    return host->fail(ctx, BTF_E_CANCELLED, "bench_svd: measured");
  }
  btf_svd_result result = {.struct_size = sizeof result};
  const double start = now(), processor_start = processor_seconds();
  status = host->svd(ctx, &desc, job, 0, 1, &result);
  run->seconds = now() - start;
  run->processor = processor_seconds() - processor_start;
  const uint64_t bytes = anonymous_bytes();
  if (bytes > run->peak) run->peak = bytes;
  run->passes = result.passes;
  run->said = result.energy > 0 ? sqrt(result.residual / result.energy) : 0;
  if (status == BTF_OK) {
    const bench_run measured = *run;
    run->failed = reference_error(&desc, &result, &run->error) != 0;
    run->peak = measured.peak; /* these readings are none of the run's */
    run->reading = measured.reading;
  }
  host->svd_free(ctx, &result);
  /* There is no model to be had of it. */
  return status == BTF_OK ? host->fail(ctx, BTF_E_CANCELLED, "bench_svd: measured") : status;
}

static btf_status load_probe(const btf_host *host, btf_context *ctx, uint32_t format,
                             const btf_model_shape *shape, btf_chunk_reader *payload, void **state) {
  (void)format;
  (void)shape;
  (void)payload;
  *state = NULL;
  return host->fail(ctx, BTF_E_UNSUPPORTED, "bench_svd: nothing to load");
}
static void destroy_probe(const btf_host *host, btf_context *ctx, void *state) {
  (void)host;
  (void)ctx;
  (void)state;
}
static uint32_t levels_probe(const void *state) {
  (void)state;
  return 1;
}
static uint64_t bytes_probe(const void *state) {
  (void)state;
  return 0;
}
static void eval_probe(const void *state, const btf_query *query, float *out) {
  (void)state;
  (void)query;
  out[0] = 0;
}
static void texel_probe(const void *state, uint32_t level, uint32_t x, uint32_t y, uint32_t light,
                        uint32_t view, float *out) {
  (void)state, (void)level, (void)x, (void)y, (void)light, (void)view;
  out[0] = 0;
}

static const btf_param_desc *const no_params[] = {NULL};
static const btf_codec_vtbl probe = {
    .struct_size = sizeof(btf_codec_vtbl),
    .abi = LIBBTF_ABI,
    .id = "bench.svd",
    .title = "measures the decomposition and keeps nothing",
    .version = "1",
    .caps = BTF_CAP_FIT | BTF_CAP_STREAM_FIT,
    .params = no_params,
    .format_read_min = 1,
    .format_write = 1,
    .fit = fit_probe,
    .load = load_probe,
    .destroy = destroy_probe,
    .levels = levels_probe,
    .resident_bytes = bytes_probe,
    .eval = eval_probe,
    .texel = texel_probe,
};

static int decompose(btf_context *ctx, const btf_dataset *ds, const bench_options *options, bench_case what,
                     uint64_t memory, int optimum, bench_run *run) {
  const btf_codec *codec = btf_codec_find(ctx, probe.id);
  btf_job job = BTF_JOB_INIT;
  btf_model *model = NULL;
  memset(run, 0, sizeof *run);
  run->options = options;
  run->what = what;
  run->optimum = optimum;
  run->memory = memory; /* the job's budget would hold for the mapping as well */
  job.seed = 1;
  current = run;
  const btf_status status = btf_model_fit(ds, codec, NULL, &job, &model);
  current = NULL;
  if (status == BTF_E_CANCELLED) return run->failed;
  fprintf(stderr, "bench_svd: %s\n", btf_error_message());
  return 1;
}

/* ---- bounds ---- */

static double square_product_rate(void) {
  enum { N = 1536 };
  float *a = malloc(sizeof(float) * N * N), *b = malloc(sizeof(float) * N * N),
        *c = malloc(sizeof(float) * N * N);
  double best = 0;
  if (a != NULL && b != NULL && c != NULL) {
    for (size_t k = 0; k < (size_t)N * N; k++) {
      a[k] = (float)(k % 7) - 3;
      b[k] = (float)(k % 5) - 2;
    }
    for (int round = 0; round < 4; round++) {
      const double start = now();
      cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, N, N, N, 1, a, N, b, N, 0, c, N);
      const double rate = 2e-9 * N * N * N / (now() - start);
      if (rate > best) best = rate;
    }
  }
  free(a);
  free(b);
  free(c);
  return best;
}

/* Bytes a second through the data as it lies, one thread. */
static double read_rate(const btf_dataset_desc *shape, uint64_t bytes) {
  const uint64_t *words = shape->data;
  uint64_t sum[4] = {0};
  const double start = now();
  for (uint64_t k = 0; k + 4 <= bytes / 8; k += 4) {
    for (int l = 0; l < 4; l++) sum[l] += words[k + (uint64_t)l];
  }
  const double seconds = now() - start;
  volatile uint64_t keep = sum[0] + sum[1] + sum[2] + sum[3];
  (void)keep;
  return (double)bytes / seconds;
}

/* ---- optimum, found once and kept beside the data ---- */

static double optimal_error(btf_context *ctx, const btf_dataset *ds, const bench_options *options,
                            uint32_t rank) {
  char path[4200];
  double error = 0;
  snprintf(path, sizeof path, "%s-optimum-%u.txt", options->folder, rank);
  FILE *file = options->optimum ? NULL : fopen(path, "r");
  if (file != NULL) {
    const int found = fscanf(file, "%lf", &error);
    fclose(file);
    if (found == 1) return error;
  }
  bench_run run;
  fprintf(stderr, "bench_svd: finding the optimum at rank %u\n", rank);
  if (decompose(ctx, ds, options, (bench_case){.rank = rank}, options->memory, 1, &run) != 0) return 0;
  error = run.error;
  file = fopen(path, "w");
  if (file != NULL) {
    fprintf(file, "%.9g\n", error);
    fclose(file);
  }
  return error;
}

/* ---- peer ---- */

typedef struct peer_run {
  double seconds, error, conversion, processor;
  char kernel[64];
} peer_run;

static int run_peer(const bench_options *options, const btf_dataset_desc *shape, uint64_t rows,
                    const bench_case *what, peer_run *out) {
  char command[9000], line[512];
  snprintf(command, sizeof command,
           "env -u OPENBLAS_CORETYPE -u OPENBLAS_L2_SIZE %s \"%s/samples.bin\" %llu %u %u %u %s",
           options->peer, options->folder, (unsigned long long)rows, shape->width * shape->height,
           shape->channels, what->rank, what->peer_settings);
  FILE *pipe = popen(command, "r");
  if (pipe == NULL) return 1;
  int fields = 0;
  memset(out, 0, sizeof *out);
  while (fgets(line, sizeof line, pipe) != NULL)
    fields = sscanf(line, "seconds %lf processor %lf error %lf conversion %lf kernel %63s", &out->seconds,
                    &out->processor, &out->error, &out->conversion, out->kernel);
  return pclose(pipe) != 0 || fields != 5;
}

/* ---- main ---- */

static int usage(void) {
  fprintf(
      stderr,
      "usage: bench_svd [--folder DIR] [--material smooth|rare|noisy] [--size N] [--directions NAME]\n"
      "                 [--memory MiB] [--runs N] [--case 1..4] [--block-items N] [--by-image] [--threads "
      "N]\n"
      "                 [--peer \"/usr/bin/python3 bench/peer_svd.py\"] [--verbose]\n"
      "       bench_svd --optimum [--folder DIR] [--case 1..4]\n"
      "DIR gets a data-set folder of 2.6 GB unless it has one; default $TMPDIR/bench_svd-<material>.btfd\n"
      "The optimal error at rank R is kept in DIR-optimum-R.txt; --optimum finds it anew and measures\n"
      "nothing. It has no part of the decomposition that is measured: block Lanczos on M^T M with full\n"
      "reorthogonalisation, in double from the products up, until the squared error is exact to 1e-9 of\n"
      "itself by the residuals of the Ritz vectors. That takes a reading for 32 vectors, minutes in all.\n"
      "The error reached is the sum of squares of M - U S V^T, taken after the clock has stopped, and "
      "beside\n"
      "it stands what the result says of itself.\n");
  return 2;
}

static int parse(int argc, char **argv, bench_options *o) {
  static const char *const kinds[] = {"smooth", "rare", "noisy"};
  const char *temporary = getenv("TMPDIR");
  *o = (bench_options){.directions = "ubo81", .kind = MATERIAL_RARE, .size = 256, .runs = 3, .memory = 560};
  for (int i = 1; i < argc; i++) {
    const char *value = i + 1 < argc ? argv[i + 1] : NULL;
    if (strcmp(argv[i], "--by-image") == 0) {
      o->by_image = 1;
      continue;
    }
    if (strcmp(argv[i], "--optimum") == 0) {
      o->optimum = 1;
      continue;
    }
    if (strcmp(argv[i], "--verbose") == 0) {
      o->verbose = 1;
      continue;
    }
    if (value == NULL) return usage();
    i++;
    if (strcmp(argv[i - 1], "--folder") == 0) {
      snprintf(o->folder, sizeof o->folder, "%s", value);
    } else if (strcmp(argv[i - 1], "--material") == 0) {
      o->kind = -1;
      for (int k = 0; k < 3; k++) {
        if (strcmp(value, kinds[k]) == 0) o->kind = k;
      }
      if (o->kind < 0) return usage();
    } else if (strcmp(argv[i - 1], "--size") == 0) {
      o->size = (uint32_t)strtoul(value, NULL, 10);
    } else if (strcmp(argv[i - 1], "--directions") == 0) {
      o->directions = value;
    } else if (strcmp(argv[i - 1], "--memory") == 0) {
      o->memory = strtoull(value, NULL, 10);
    } else if (strcmp(argv[i - 1], "--runs") == 0) {
      o->runs = (uint32_t)strtoul(value, NULL, 10);
    } else if (strcmp(argv[i - 1], "--block-items") == 0) {
      o->block_items = (uint32_t)strtoul(value, NULL, 10);
    } else if (strcmp(argv[i - 1], "--threads") == 0) {
      o->threads = (uint32_t)strtoul(value, NULL, 10);
    } else if (strcmp(argv[i - 1], "--case") == 0) {
      o->only = (int)strtol(value, NULL, 10);
    } else if (strcmp(argv[i - 1], "--peer") == 0) {
      o->peer = value;
    } else {
      return usage();
    }
  }
  if (o->folder[0] == '\0')
    snprintf(o->folder, sizeof o->folder, "%s/bench_svd-%s.btfd", temporary != NULL ? temporary : "/tmp",
             kinds[o->kind]);
  if (o->size == 0 || o->runs == 0 || o->memory == 0) return usage();
  o->memory <<= 20;
  return 0;
}

static void print_log(void *user, int32_t level, btf_status code, const char *message) {
  (void)user;
  (void)level;
  (void)code;
  fprintf(stderr, "  %s\n", message);
}

static int bench_one(btf_context *ctx, const btf_dataset *ds, const bench_options *o,
                     const btf_dataset_desc *shape, uint64_t rows, const bench_case *what) {
  const double optimum = optimal_error(ctx, ds, o, what->rank);
  if (optimum <= 0) return 1;
  if (o->optimum) {
    printf("rank %3u: optimal error %.9f\n", what->rank, optimum);
    return 0;
  }
  double ours = INFINITY, theirs = INFINITY, ours_processor = INFINITY, theirs_processor = INFINITY,
         worst_error = 0, said = 0, peer_error = 0, conversion = 0;
  uint64_t peak = 0;
  uint32_t passes = 0;
  double reading = 0;
  char kernel[64] = "";
  for (uint32_t round = 0; round < o->runs; round++) {
    bench_run run;
    /* The peer may have driven the file out of the page cache. */
    read_rate(shape, 2 * rows * shape->width * shape->height * shape->channels);
    if (decompose(ctx, ds, o, *what, o->memory, 0, &run) != 0) return 1;
    if (run.seconds < ours) {
      ours = run.seconds;
      reading = run.reading;
    }
    ours_processor = fmin(ours_processor, run.processor);
    if (run.error > worst_error) {
      worst_error = run.error;
      said = run.said;
    }
    peak = run.peak > peak ? run.peak : peak;
    passes = run.passes;
    if (o->peer != NULL) {
      peer_run peer;
      if (run_peer(o, shape, rows, what, &peer) != 0) {
        fprintf(stderr, "bench_svd: the peer failed: %s\n", o->peer);
        return 1;
      }
      theirs_processor = fmin(theirs_processor, peer.processor);
      theirs = peer.seconds < theirs ? peer.seconds : theirs;
      peer_error = peer.error;
      conversion = peer.conversion;
      memcpy(kernel, peer.kernel, sizeof kernel);
    }
  }
  printf("rank %3u within %.4f: %6.2f s (%.2f reading; %.2f processor), %u passes, %4llu MiB beside the "
         "mapping, error %.6f = %.5f of "
         "the optimum (by its own account %.5f)\n",
         what->rank, 1 + what->tolerance, ours, reading, ours_processor, passes,
         (unsigned long long)(peak >> 20), worst_error, worst_error / optimum, said / optimum);
  if (o->peer != NULL)
    printf("    scikit-learn, iterations and normaliser \"%s\", %s kernels: %6.2f s (%.2f processor; and "
           "%.2f to convert), %.5f "
           "of the optimum: %.2f times ours, %.2f in processor time\n",
           what->peer_settings, kernel, theirs, theirs_processor, conversion, peer_error / optimum,
           theirs / ours, theirs_processor / ours_processor);
  fflush(stdout);
  return 0;
}

int main(int argc, char **argv) {
  bench_options options;
  if (parse(argc, argv, &options) != 0) return 2;
  btf_context *ctx = NULL;
  btf_dataset *ds = NULL;
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  desc.max_threads = options.threads;
  if (options.verbose) desc.log = print_log;
  if (btf_context_create(&desc, &ctx) != BTF_OK || btf_context_register(ctx, &probe) != BTF_OK) {
    fprintf(stderr, "bench_svd: %s\n", btf_error_message());
    return 1;
  }
  struct stat entry;
  int failed = 0;
  if (stat(options.folder, &entry) != 0 &&
      material_write(ctx, options.folder, options.kind, options.size, options.directions) != BTF_OK)
    failed = 1;
  if (!failed && btf_dataset_open(ctx, options.folder, &ds) != BTF_OK) failed = 1;
  btf_dataset_desc shape = {.struct_size = sizeof shape};
  if (!failed && btf_dataset_describe(ds, &shape) != BTF_OK) failed = 1;
  if (failed) {
    fprintf(stderr, "bench_svd: %s\n", btf_error_message());
  } else {
    const uint64_t rows = (uint64_t)btf_dirset_count(shape.lights) * btf_dirset_count(shape.views);
    const uint64_t values = rows * shape.width * shape.height * shape.channels;
    const double rate = square_product_rate(), bandwidth = read_rate(&shape, values * 2);
    printf("%s: %llu x %u, %s items, kernels of the library %s, of OpenBLAS %s\n", options.folder,
           (unsigned long long)(rows * shape.channels), shape.width * shape.height,
           options.by_image ? "image" : "texel", btf_context_isa(ctx), openblas_get_corename());
    printf("bounds: square sgemm %.0f GFLOP/s, reading the mapping with one thread %.1f GB/s; one pass with "
           "48 columns "
           "%.2f s, with 112 %.2f s\n",
           rate, 1e-9 * bandwidth, 4e-9 * 48 * (double)values / rate, 4e-9 * 112 * (double)values / rate);
    fflush(stdout);
    for (size_t c = 0; c < sizeof cases / sizeof cases[0] && !failed; c++)
      /* Cases of one rank share their optimum. */
      if ((options.only == 0 || options.only == (int)c + 1) &&
          !(options.optimum && options.only == 0 && c > 0 && cases[c].rank == cases[c - 1].rank))
        failed = bench_one(ctx, ds, &options, &shape, rows, &cases[c]);
  }
  btf_dataset_release(ds);
  btf_context_release(ctx);
  return failed;
}
