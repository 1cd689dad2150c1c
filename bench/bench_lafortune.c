/* SPDX-License-Identifier: MIT */
/* bench_lafortune: milliseconds of processor time to fit lobes to a texel, and the median relative error, for
 * texels spread over a data-set folder. With -p, MINPACK through SciPy (Python) on the same texels
 * (peer_lafortune.py), in turns of a few texels each, so that both meet the same machine.
 *
 *   bench_lafortune FOLDER [-n TEXELS] [-k LOBES] [-s STARTS] [-t TOLERANCE] [-p PYTHON] */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <btf/btf.h>

#include "codecs/lafortune/lafortune.h"
#include "registry/registry.h"

enum { MAX_TEXELS = 4096, TURN = 8 };

typedef struct bench {
  const char *folder, *python;
  uint32_t texels, lobes, starts;
  double tolerance;
  btf_context *ctx;
  btf_dataset *ds;
  btf_dataset_desc desc;
  uint32_t lights, views;
  btfi_lafortune_shared shared;
  void *memory;
  float *abrdf;
} bench;

static int fail(const char *what) {
  fprintf(stderr, "bench_lafortune: %s: %s\n", what, btf_error_message());
  return 1;
}

static double processor_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int compare_doubles(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

static double median(double *values, uint32_t n) {
  qsort(values, n, sizeof *values, compare_doubles);
  return values[n / 2];
}

/* Texels along a line of irrational slope: spread, and each once. */
static uint32_t texel_of(const bench *b, uint32_t i) {
  const uint64_t all = (uint64_t)b->desc.width * b->desc.height;
  return (uint32_t)((i * (uint64_t)(0.6180339887 * (double)all) + i) % all);
}

static int prepare(bench *b) {
  if (btf_context_create(NULL, &b->ctx) != BTF_OK) return fail("context");
  if (btf_dataset_open(b->ctx, b->folder, &b->ds) != BTF_OK) return fail(b->folder);
  b->desc.struct_size = sizeof b->desc;
  if (btf_dataset_describe(b->ds, &b->desc) != BTF_OK) return fail("describe");
  b->lights = btf_dirset_count(b->desc.lights);
  b->views = btf_dirset_count(b->desc.views);
  if (btfi_lafortune_shared_create(btfi_host(), b->ctx, LAF_DIAGONAL, b->desc.quantity, LAF_UNIFORM,
                                   btf_dirset_directions(b->desc.lights), b->lights,
                                   btf_dirset_directions(b->desc.views), b->views, &b->shared) != BTF_OK)
    return fail("terms");
  const uint64_t bytes = btfi_lafortune_scratch_bytes(&b->shared, b->lobes, b->desc.channels);
  b->abrdf = malloc((size_t)b->lights * b->views * b->desc.channels * sizeof *b->abrdf);
  return posix_memalign(&b->memory, 64, bytes) != 0 || b->abrdf == NULL;
}

/* Adds the seconds of one texel; its relative error. */
static int fit_one(bench *b, uint32_t texel, double *seconds, double *iterations, double *error) {
  const btfi_lafortune_settings settings = {b->lobes, b->starts, 60, b->tolerance};
  btfi_lafortune_fitted fitted;
  if (btf_dataset_read_abrdf(b->ds, texel % b->desc.width, texel / b->desc.width, 1, b->abrdf) != BTF_OK)
    return fail("reading");
  const double start = processor_seconds();
  btfi_lafortune_scratch *scratch =
      btfi_lafortune_scratch_init(b->memory, &b->shared, b->lobes, b->desc.channels);
  btfi_lafortune_fit_group(scratch, &settings, b->abrdf, b->desc.channels, b->desc.channels, &fitted);
  btfi_lafortune_fit_albedos(scratch, &fitted);
  *seconds += processor_seconds() - start;
  *iterations += fitted.iterations;
  *error = fitted.energy > 0.0 ? sqrt(fitted.squared_error / fitted.energy) : 0.0;
  return 0;
}

/* The peer's seconds for some texels, and their errors. */
static int fit_peer(const bench *b, uint32_t first, uint32_t count, double *seconds, double *own,
                    double *error) {
  char command[8192], here[4096];
  (void)snprintf(here, sizeof here, "%s", __FILE__);
  char *slash = strrchr(here, '/');
  if (slash != NULL) *slash = '\0';
  int used = snprintf(command, sizeof command, "%s '%s/peer_lafortune.py' '%s' %u", b->python, here,
                      b->folder, b->lobes);
  for (uint32_t i = 0; i < count; i++)
    used += snprintf(command + used, sizeof command - (size_t)used, " %u", texel_of(b, first + i));
  FILE *pipe = popen(command, "r");
  double one_seconds, one_own;
  if (pipe == NULL) return 1;
  for (uint32_t i = 0; i < count; i++) {
    if (fscanf(pipe, "%lf %lf %lf", &one_seconds, &one_own, &error[i]) != 3) {
      fprintf(stderr, "bench_lafortune: the peer said nothing\n");
      (void)pclose(pipe);
      return 1;
    }
    *seconds += one_seconds;
    *own += one_own;
  }
  return pclose(pipe) != 0;
}

int main(int argc, char **argv) {
  static double error[MAX_TEXELS], peer_error[MAX_TEXELS];
  bench b = {.texels = 200, .lobes = 2, .starts = 3, .tolerance = 1e-4};
  double seconds = 0.0, peer_seconds = 0.0, peer_own = 0.0, iterations = 0.0;
  int option, failed = 0;
  while ((option = getopt(argc, argv, "n:k:s:t:p:")) != -1) {
    if (option == 'n')
      b.texels = (uint32_t)atoi(optarg);
    else if (option == 'k')
      b.lobes = (uint32_t)atoi(optarg);
    else if (option == 's')
      b.starts = (uint32_t)atoi(optarg);
    else if (option == 't')
      b.tolerance = atof(optarg);
    else if (option == 'p')
      b.python = optarg;
    else
      return 1;
  }
  if (optind + 1 != argc || b.texels < 1 || b.texels > MAX_TEXELS || b.lobes < 1 || b.lobes > LAF_MAX_LOBES) {
    fprintf(stderr,
            "usage: bench_lafortune FOLDER [-n TEXELS] [-k LOBES] [-s STARTS] [-t TOLERANCE] [-p PYTHON]\n");
    return 1;
  }
  b.folder = argv[optind];
  if (prepare(&b)) return 1;
  for (uint32_t first = 0; first < b.texels && !failed; first += TURN) {
    const uint32_t count = b.texels - first < TURN ? b.texels - first : TURN;
    for (uint32_t i = 0; i < count && !failed; i++)
      failed = fit_one(&b, texel_of(&b, first + i), &seconds, &iterations, &error[first + i]);
    if (b.python != NULL && !failed)
      failed = fit_peer(&b, first, count, &peer_seconds, &peer_own, peer_error + first);
  }
  if (!failed) {
    printf("%s: %u x %u directions, %u channels, %u texels, %u lobes, instructions %s\n", b.folder, b.lights,
           b.views, b.desc.channels, b.texels, b.lobes, btf_context_isa(b.ctx));
    printf(
        "  libbtf   %8.3f ms a texel and core, median relative error %.5f, %.1f iterations from %u starts\n",
        1e3 * seconds / b.texels, median(error, b.texels), iterations / b.texels, b.starts);
    if (b.python != NULL)
      printf("  MINPACK  %8.3f ms a texel and core without SciPy's and NumPy's share, %.3f with it, median "
             "relative error "
             "%.5f: %.1f and %.1f times as long\n",
             1e3 * peer_own / b.texels, 1e3 * peer_seconds / b.texels, median(peer_error, b.texels),
             peer_own / seconds, peer_seconds / seconds);
  }
  btfi_lafortune_shared_free(btfi_host(), b.ctx, &b.shared);
  free(b.memory);
  free(b.abrdf);
  btf_dataset_release(b.ds);
  btf_context_release(b.ctx);
  return failed;
}
