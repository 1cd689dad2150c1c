/* SPDX-License-Identifier: MIT */
/* bench_locate: nanoseconds to find the interpolation weights of a random direction, one at a time and in
 * batches, and to find the nearest sample. Rounds of the three are interleaved; the fastest of each is
 * printed. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <btf/btf.h>

enum { directions = 1 << 14, rounds = 60 };

static float x[directions], y[directions], z[directions];
static btf_interp weights[directions];
static volatile uint32_t nearest_sum; /* keeps the calls from being optimised away */

static double now_ns(void) {
  struct timespec t;
  timespec_get(&t, TIME_UTC);
  return (double)t.tv_sec * 1e9 + (double)t.tv_nsec;
}

/* Uniform over the hemisphere, the same in every run. */
static void choose_directions(void) {
  uint64_t state = 1;
  for (int i = 0; i < directions; i++) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    z[i] = ((float)(state >> 40) + 0.5f) / (float)(1 << 24);
    state = state * 6364136223846793005u + 1442695040888963407u;
    const float phi = (float)(state >> 40) / (float)(1 << 24) * 6.2831853f, r = sqrtf(1.0f - z[i] * z[i]);
    x[i] = r * cosf(phi);
    y[i] = r * sinf(phi);
  }
}

static double fastest(double best, double start) {
  const double each = (now_ns() - start) / directions;
  return each < best ? each : best;
}

static int measure(btf_context *ctx, const char *name) {
  btf_dirset *set;
  const double start = now_ns();
  if (btf_dirset_create_named(ctx, name, &set) != BTF_OK) {
    fprintf(stderr, "bench_locate: %s\n", btf_error_message());
    return 1;
  }
  const double create = now_ns() - start;
  double single = INFINITY, batch = INFINITY, nearest = INFINITY;
  for (int r = 0; r < rounds; r++) {
    double t = now_ns();
    for (int i = 0; i < directions; i++) {
      const float dir[3] = {x[i], y[i], z[i]};
      btf_dirset_locate(set, dir, &weights[i]);
    }
    single = fastest(single, t);
    t = now_ns();
    btf_dirset_locate_n(set, directions, x, y, z, weights);
    batch = fastest(batch, t);
    t = now_ns();
    uint32_t sum = 0;
    for (int i = 0; i < directions; i++) {
      const float dir[3] = {x[i], y[i], z[i]};
      sum += btf_dirset_nearest(set, dir);
    }
    nearest_sum = sum;
    nearest = fastest(nearest, t);
  }
  printf("%-12s %9u %12.2f %10.1f %10.1f %10.1f\n", name, btf_dirset_count(set), create * 1e-6, single, batch,
         nearest);
  btf_dirset_release(set);
  return 0;
}

int main(int argc, char **argv) {
  static const char *const usual[] = {"ubo81", "ubo151", "grid:10x5", "grid:16x8", "grid:512x40"};
  btf_context *ctx;
  if (btf_context_create(NULL, &ctx) != BTF_OK) {
    fprintf(stderr, "bench_locate: %s\n", btf_error_message());
    return EXIT_FAILURE;
  }
  choose_directions();
  printf("%-12s %9s %12s %10s %10s %10s\n", "set", "samples", "create, ms", "locate, ns", "locate_n",
         "nearest");
  int failed = 0;
  if (argc > 1)
    for (int i = 1; i < argc; i++) failed |= measure(ctx, argv[i]);
  else
    for (size_t i = 0; i < sizeof usual / sizeof *usual; i++) failed |= measure(ctx, usual[i]);
  btf_context_release(ctx);
  return failed ? EXIT_FAILURE : EXIT_SUCCESS;
}
