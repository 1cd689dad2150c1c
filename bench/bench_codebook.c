/* SPDX-License-Identifier: MIT */
/* bench_codebook: codebooks of the factors of many texels beside the bound that matrix products set, and
 * homomorphic factorisation with one normal matrix for all texels beside a normal matrix for each. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <btf/btf.h>
#include <btf/btf_plugin.h>

#include "codecs/cmf/cluster.h"
#include "codecs/cmf/homomorphic.h"
#include "registry/registry.h"

typedef struct bench_options {
  uint32_t texels, edge, entries, directions, threads, hf_texels;
  double tolerance;
} bench_options;

enum { CHANNELS = 3, FACTORS = 3, MAPS = 3, SEPARATE = 2 };

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Of all threads: what a busy machine changes least. */
static double processor_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double random_unit(uint64_t *state) {
  *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (double)(*state >> 11) / 9007199254740992.0;
}

static void *need(void *memory) {
  if (memory == NULL) {
    fprintf(stderr, "bench_codebook: out of memory\n");
    exit(1);
  }
  return memory;
}

static void expect(btf_status status) {
  if (status == BTF_OK) return;
  fprintf(stderr, "bench_codebook: %s\n", btf_error_message());
  exit(1);
}

/* ---- factors of a bumpy cloth of two yarns ---- */

typedef struct factor_set {
  uint32_t length;
  float *values;
} factor_set;

static void read_factor(const void *user, uint64_t index, float *dst) {
  const factor_set *set = user;
  memcpy(dst, set->values + index * set->length, set->length * sizeof *dst);
}

/* The direction at the centre of a texel of a parabolic map, on the horizon beyond its circle. */
static void texel_direction(uint32_t edge, uint32_t x, uint32_t y, double d[3]) {
  double a = 2.0 * (x + 0.5) / edge - 1.0, b = 2.0 * (y + 0.5) / edge - 1.0;
  const double square = a * a + b * b;
  if (square > 1.0) {
    a /= sqrt(square);
    b /= sqrt(square);
  }
  const double z = square > 1.0 ? 0.0 : (1.0 - square) / (1.0 + square);
  d[0] = a * (1.0 + z);
  d[1] = b * (1.0 + z);
  d[2] = z;
}

/* Normals follow the weave, gloss and colour the yarn; each texel has a roughness and tint of its own. Factor
 * 0 depends on the light, 1 on the half vector, 2 on the view; each is scaled to a largest value of 1. */
static void make_factor(const bench_options *o, uint32_t factor, uint32_t texel, float *dst) {
  const uint32_t side = (uint32_t)ceil(sqrt((double)o->texels)), x = texel % side, y = texel / side;
  uint64_t random = texel * UINT64_C(2654435761) + factor;
  const int warp = (x / 8 + y / 8) % 2 == 0;
  const double across = ((warp ? x : y) % 8 + 0.5) / 4.0 - 1.0,
               along = ((warp ? y : x) % 8 + 0.5) / 4.0 - 1.0;
  const double tilt = 0.8 * across + 0.1 * (random_unit(&random) - 0.5), bend = 0.4 * along;
  const double n[3] = {warp ? tilt : bend, warp ? bend : tilt, 1.0};
  const double length = sqrt(n[0] * n[0] + n[1] * n[1] + 1.0);
  const double gloss = (warp ? 40.0 : 8.0) * (0.8 + 0.4 * random_unit(&random));
  const double colour[3] = {warp ? 0.9 : 0.2, 0.5 + 0.1 * random_unit(&random), warp ? 0.2 : 0.8};
  float largest = 0.0f;
  for (uint32_t i = 0; i < o->edge * o->edge; i++) {
    double d[3];
    texel_direction(o->edge, i % o->edge, i / o->edge, d);
    const double cosine = fmax(0.0, (d[0] * n[0] + d[1] * n[1] + d[2] * n[2]) / length);
    for (uint32_t c = 0; c < CHANNELS; c++) {
      const double lobe = factor == 1 ? 0.1 + pow(cosine, gloss) * (0.5 + 0.5 * colour[c])
                                      : 0.05 + colour[c] * cosine / (1.0 + 0.3 * cosine);
      const float value = (float)(lobe * (0.98 + 0.04 * random_unit(&random)));
      dst[i * CHANNELS + c] = value;
      if (value > largest) largest = value;
    }
  }
  for (uint32_t i = 0; i < o->edge * o->edge * CHANNELS; i++) dst[i] /= largest;
}

static double gemm_rate(btf_context *ctx, const bench_options *o, const float *values, uint32_t length) {
  const uint32_t rows = o->texels < 1024 ? o->texels : 1024,
                 entries = o->entries < o->texels ? o->entries : o->texels;
  float *product = need(malloc((size_t)rows * entries * sizeof *product));
  double best = 0.0;
  for (int turn = 0; turn < 6; turn++) {
    const double start = now();
    expect(btfi_host()->gemm(ctx, BTF_TRANSPOSE_B, rows, entries, length, 1.0f, values, length, values,
                             length, 0.0f, product, entries));
    const double rate = 2.0 * rows * entries * length / (now() - start);
    if (rate > best) best = rate;
  }
  free(product);
  return best;
}

static void bench_codebooks(btf_context *ctx, const bench_options *o) {
  static const char *const factors[] = {"light", "half", "view"}, *const methods[] = {"k-means", "tree",
                                                                                      "median cut"};
  double total[CMF_CLUSTERINGS] = {0}, processor[CMF_CLUSTERINGS] = {0};
  const uint32_t length = o->edge * o->edge * CHANNELS;
  factor_set set = {length, need(malloc((size_t)o->texels * length * sizeof(float)))};
  const btfi_cmf_vectors vectors = {o->texels, length, read_factor, &set};
  printf("codebooks of %u entries from %u texels, %u factors of %u floats\n", o->entries, o->texels, FACTORS,
         length);
  for (uint32_t factor = 0; factor < FACTORS; factor++) {
    double energy = 0.0;
    for (uint32_t t = 0; t < o->texels; t++) make_factor(o, factor, t, set.values + (size_t)t * length);
    for (size_t i = 0; i < (size_t)o->texels * length; i++)
      energy += (double)set.values[i] * (double)set.values[i];
    const double rate = gemm_rate(ctx, o, set.values, length);
    for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++) {
      const btfi_cmf_cluster_options options = {
          .method = method, .entries = o->entries, .tolerance = o->tolerance, .seed = 1};
      btfi_cmf_codebook book;
      const double start = now(), busy = processor_seconds();
      expect(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "", &book));
      const double seconds = now() - start, used = processor_seconds() - busy;
      printf("  %-5s %-10s %6.2f s, %6.2f s of processors; relative error %.5f", factors[factor],
             methods[method], seconds, used, sqrt(book.inertia / energy));
      if (method == CMF_KMEANS)
        printf("; %u iterations; their products at %.0f GFLOP/s: %.2f s", book.iterations, rate * 1e-9,
               2.0 * o->texels * book.entries * length * book.iterations / rate);
      printf("\n");
      total[method] += seconds;
      processor[method] += used;
      btfi_cmf_codebook_free(btfi_host(), ctx, &book);
    }
  }
  for (uint32_t method = 0; method < CMF_CLUSTERINGS; method++)
    printf("  all   %-10s %6.2f s, %6.2f s of processors\n", methods[method], total[method],
           processor[method]);
  free(set.values);
}

/* ---- homomorphic factorisation ---- */

static void locate(uint32_t edge, const double d[3], uint32_t *texel, float *weight) {
  const double x = fmin(fmax((d[0] / (1.0 + d[2]) + 1.0) / 2.0 * edge - 0.5, 0.0), edge - 1.0),
               y = fmin(fmax((d[1] / (1.0 + d[2]) + 1.0) / 2.0 * edge - 0.5, 0.0), edge - 1.0);
  const uint32_t x0 = (uint32_t)fmin(x, edge - 2.0), y0 = (uint32_t)fmin(y, edge - 2.0);
  for (uint32_t i = 0; i < 4; i++) {
    texel[i] = (y0 + i / 2) * edge + x0 + i % 2;
    weight[i] = (float)((i % 2 ? x - x0 : 1.0 - (x - x0)) * (i / 2 ? y - y0 : 1.0 - (y - y0)));
  }
}

/* Directions on a spiral over the hemisphere. */
static void spiral(uint32_t count, uint32_t i, double d[3]) {
  d[2] = 1.0 - (i + 0.5) / count;
  d[0] = sqrt(1.0 - d[2] * d[2]) * cos(2.399963 * i);
  d[1] = sqrt(1.0 - d[2] * d[2]) * sin(2.399963 * i);
}

static void bench_homomorphic(btf_context *ctx, const bench_options *o) {
  const btf_host *host = btfi_host();
  const uint32_t pairs = o->directions * o->directions, taps = 4 * MAPS,
                 map_values = MAPS * o->edge * o->edge * CHANNELS;
  uint32_t *texel = need(malloc((size_t)pairs * taps * sizeof *texel));
  float *weight = need(malloc((size_t)pairs * taps * sizeof *weight));
  float *f = need(malloc((size_t)o->hf_texels * pairs * CHANNELS * sizeof *f));
  float *maps = need(malloc((size_t)o->hf_texels * map_values * sizeof *maps)),
        *alone = need(malloc(map_values * sizeof *alone));
  uint64_t random = 1;
  for (uint32_t p = 0; p < pairs; p++) {
    double light[3], view[3], half[3], square = 0.0;
    spiral(o->directions, p % o->directions, light);
    spiral(o->directions, p / o->directions, view);
    for (int i = 0; i < 3; i++) {
      half[i] = light[i] + view[i];
      square += half[i] * half[i];
    }
    for (int i = 0; i < 3; i++) half[i] /= sqrt(square);
    locate(o->edge, light, texel + (size_t)p * taps, weight + (size_t)p * taps);
    locate(o->edge, half, texel + (size_t)p * taps + 4, weight + (size_t)p * taps + 4);
    locate(o->edge, view, texel + (size_t)p * taps + 8, weight + (size_t)p * taps + 8);
    for (uint32_t t = 0; t < o->hf_texels; t++)
      for (uint32_t c = 0; c < CHANNELS; c++)
        f[((size_t)t * pairs + p) * CHANNELS + c] =
            (float)(light[2] * (0.2 + pow(half[2], 1.0 + t)) * (0.5 + random_unit(&random)));
  }
  const btfi_cmf_hf_geometry geometry = {
      .pairs = pairs, .maps = MAPS, .width = o->edge, .height = o->edge, .texel = texel, .weight = weight};
  btfi_cmf_hf *hf;
  double start = now(), busy = processor_seconds();
  expect(btfi_cmf_hf_create(host, ctx, &geometry, 1.0, 0, &hf));
  const double once = now() - start, once_used = processor_seconds() - busy;
  const uint32_t unknowns = btfi_cmf_hf_unknowns(hf);
  start = now();
  busy = processor_seconds();
  expect(btfi_cmf_hf_solve(host, ctx, hf, o->hf_texels, CHANNELS, f, (uint64_t)pairs * CHANNELS, 1e-4, maps,
                           map_values));
  const double each = (now() - start) / o->hf_texels, each_used = (processor_seconds() - busy) / o->hf_texels;
  btfi_cmf_hf_free(host, ctx, hf);
  double separate = 0.0, separate_used = 0.0, difference = 0.0;
  for (uint32_t t = 0; t < SEPARATE; t++) {
    start = now();
    busy = processor_seconds();
    expect(btfi_cmf_hf_create(host, ctx, &geometry, 1.0, 0, &hf));
    expect(
        btfi_cmf_hf_solve(host, ctx, hf, 1, CHANNELS, f + (size_t)t * pairs * CHANNELS, 0, 1e-4, alone, 0));
    separate += (now() - start) / SEPARATE;
    separate_used += (processor_seconds() - busy) / SEPARATE;
    for (uint32_t i = 0; i < map_values; i++)
      difference = fmax(difference, fabs((double)alone[i] / (double)maps[(size_t)t * map_values + i] - 1.0));
    btfi_cmf_hf_free(host, ctx, hf);
  }
  printf("homomorphic factorisation, %u pairs, %u channels, %u unknowns\n", pairs, CHANNELS, unknowns);
  printf("  normal matrix and its factor, once        %9.2f ms, %9.2f ms of processors\n", 1e3 * once,
         1e3 * once_used);
  printf("  each of %4u texels with it               %9.2f ms, %9.2f ms of processors\n", o->hf_texels,
         1e3 * each, 1e3 * each_used);
  printf("  each texel alone                          %9.2f ms, %9.2f ms of processors; differs by %.1g\n",
         1e3 * separate, 1e3 * separate_used, difference);
  const double shared = (once_used + each_used * o->texels) / o->texels;
  printf("  alone : shared among %u texels = %.0f : 1 by processor time (%.0f : 1 beside the first factor)\n",
         o->texels, separate_used / shared, separate_used / each_used);
  free(texel);
  free(weight);
  free(f);
  free(maps);
  free(alone);
}

static int usage(void) {
  fprintf(stderr,
          "usage: bench_codebook [--texels N] [--edge N] [--entries N] [--directions N] [--tolerance X]\n"
          "                      [--threads N] [--hf-texels N] [--only codebooks|hf]\n");
  return 2;
}

int main(int argc, char **argv) {
  bench_options o = {4096, 32, 256, 81, 0, 64, 0.0};
  const char *only = "";
  for (int i = 1; i < argc; i += 2) {
    const char *name = argv[i], *value = i + 1 < argc ? argv[i + 1] : NULL;
    if (value == NULL) return usage();
    const uint32_t number = (uint32_t)strtoul(value, NULL, 10);
    if (strcmp(name, "--texels") == 0) {
      o.texels = number;
    } else if (strcmp(name, "--edge") == 0) {
      o.edge = number;
    } else if (strcmp(name, "--entries") == 0) {
      o.entries = number;
    } else if (strcmp(name, "--directions") == 0) {
      o.directions = number;
    } else if (strcmp(name, "--tolerance") == 0) {
      o.tolerance = strtod(value, NULL);
    } else if (strcmp(name, "--threads") == 0) {
      o.threads = number;
    } else if (strcmp(name, "--hf-texels") == 0) {
      o.hf_texels = number;
    } else if (strcmp(name, "--only") == 0) {
      only = value;
    } else {
      return usage();
    }
  }
  if (o.texels == 0 || o.edge < 2 || o.entries == 0 || o.directions == 0 || o.hf_texels < SEPARATE)
    return usage();
  btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
  btf_context *ctx;
  desc.max_threads = o.threads;
  expect(btf_context_create(&desc, &ctx));
  if (strcmp(only, "hf") != 0) bench_codebooks(ctx, &o);
  if (strcmp(only, "codebooks") != 0) bench_homomorphic(ctx, &o);
  btf_context_release(ctx);
  return 0;
}
