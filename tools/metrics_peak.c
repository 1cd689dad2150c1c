/* SPDX-License-Identifier: MIT */
/* metrics_peak.c: the 99.9th percentile of all values without keeping them. */
#include <stdlib.h>
#include <string.h>

#include "metrics.h"
#include "sample_walk.h"

/* Values are counted by the upper bits of a key that orders floats: sign, exponent and ten bits of mantissa,
 * all that a half float has. The bins of the two ranks are then counted by the lower bits. */
enum {
  upper_bits = 19,
  lower_bits = 32 - upper_bits,
  upper_bins = 1 << upper_bits,
  lower_bins = 1 << lower_bits
};

static uint32_t key_of(float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}

static float value_of(uint32_t key) {
  const uint32_t bits = key & 0x80000000u ? key & 0x7fffffffu : ~key;
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

typedef struct counting {
  uint64_t *counts; /* bins for each thread */
  uint64_t bins;
  uint32_t upper; /* in the second round: the bin looked into */
  bool lower;
} counting;

static btf_status count_values(void *user, const sample_visit *visit) {
  const counting *k = user;
  uint64_t *counts = k->counts + k->bins * visit->thread;
  const uint64_t values = visit->image_values * visit->lights;
  if (!k->lower) {
    for (uint64_t i = 0; i < values; i++) counts[key_of(visit->a[i]) >> lower_bits]++;
  } else {
    for (uint64_t i = 0; i < values; i++) {
      const uint32_t key = key_of(visit->a[i]);
      if (key >> lower_bits == k->upper) counts[key & (lower_bins - 1)]++;
    }
  }
  return BTF_OK;
}

/* Counts in all threads and leaves the sum in the first bins. */
static int count_all(cli *c, const sample_source *reference, counting *k) {
  sample_walk walk = {reference, NULL, count_values, k, "finding the peak", 0, 1};
  int failed;
  free(k->counts);
  k->counts = calloc((size_t)(k->bins * c->threads), sizeof *k->counts);
  if (k->counts == NULL) return cli_out_of_memory();
  failed = sample_walk_run(c, &walk);
  for (uint32_t t = 1; t < c->threads && !failed; t++)
    for (uint64_t b = 0; b < k->bins; b++) k->counts[b] += k->counts[k->bins * t + b];
  return failed;
}

/* The bin that holds a rank, and the rank within it. */
static uint32_t find_rank(const counting *k, uint64_t rank, uint64_t *within) {
  uint32_t bin = 0;
  while (bin + 1 < k->bins && rank >= k->counts[bin]) rank -= k->counts[bin++];
  *within = rank;
  return bin;
}

int metrics_peak(cli *c, const sample_source *reference, double *peak) {
  const uint64_t values = sample_source_image_values(reference) * reference->lights * reference->views;
  const double position = 0.999 * (double)(values - 1);
  uint64_t rank[2], within[2];
  uint32_t upper[2], key[2];
  counting k = {NULL, upper_bins, 0, false};
  int failed;
  rank[0] = (uint64_t)position;
  rank[1] = rank[0] + 1 < values ? rank[0] + 1 : rank[0];
  failed = count_all(c, reference, &k);
  for (int i = 0; i < 2 && !failed; i++) {
    upper[i] = find_rank(&k, rank[i], &within[i]);
    key[i] = upper[i] << lower_bits;
  }
  /* Negative keys are inverted, so that the bits below a half float's are ones there. */
  if (!failed && reference->sample_type == BTF_SAMPLE_F16) {
    for (int i = 0; i < 2; i++)
      if (!(key[i] & 0x80000000u)) key[i] |= lower_bins - 1;
  } else {
    k.lower = true;
    k.bins = lower_bins;
    for (int i = 0; i < 2 && !failed; i++) {
      if (i == 0 || upper[1] != upper[0]) {
        k.upper = upper[i];
        failed = count_all(c, reference, &k);
      }
      if (!failed) key[i] |= find_rank(&k, within[i], &within[i]);
    }
  }
  free(k.counts);
  if (failed) return failed;
  *peak = (double)value_of(key[0]) +
          (position - (double)rank[0]) * ((double)value_of(key[1]) - (double)value_of(key[0]));
  return EXIT_DONE;
}
