/* SPDX-License-Identifier: MIT */
#include "test_cmf_vectors.h"

#include <float.h>

static double random_unit(uint64_t *state) {
  *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (double)(*state >> 11) / 9007199254740992.0;
}

double random_normal(uint64_t *state) {
  double sum = -6.0;
  for (int i = 0; i < 12; i++) sum += random_unit(state);
  return sum;
}

static void read_sample(const void *user, uint64_t index, float *dst) {
  const sample *s = user;
  if (s->bytes == NULL)
    memcpy(dst, s->values + index * s->length, s->length * sizeof *dst);
  else
    for (uint32_t i = 0; i < s->length; i++) dst[i] = (float)s->bytes[index * s->length + i] / 255.0f;
}

btfi_cmf_vectors vectors_of(const sample *s) {
  const btfi_cmf_vectors vectors = {s->count, s->length, read_sample, s};
  return vectors;
}

sample sample_create(uint64_t count, uint32_t length) {
  sample s = {count, length, NULL, NULL};
  s.values = malloc(count * length * sizeof *s.values);
  return s;
}

sample sample_curves(uint64_t count, uint32_t length, uint64_t seed) {
  sample s = sample_create(count, length);
  for (uint64_t v = 0; v < count; v++) {
    double amplitude[4], phase[4];
    for (int w = 0; w < 4; w++) {
      amplitude[w] = random_unit(&seed) / (w + 1);
      phase[w] = random_unit(&seed);
    }
    for (uint32_t i = 0; i < length; i++) {
      double value = 0.5;
      for (int w = 0; w < 4; w++)
        value += 0.2 * amplitude[w] * sin((w + 1) * 6.28 * i / length + 2.0 * phase[w]);
      s.values[v * length + i] = (float)value;
    }
  }
  return s;
}

/* In plain order, unlike the library's. */
double distance_to(const sample *s, uint64_t v, const float *entry) {
  double sum = 0.0;
  for (uint32_t i = 0; i < s->length; i++) {
    const double d = (double)s->values[v * s->length + i] - (double)entry[i];
    sum += d * d;
  }
  return sum;
}

/* Sums of squares in another order differ by at most length * 2^-53 of themselves, and so do distances called
 * equal. */
void expect_nearest(const sample *s, const float *values, uint32_t entries, const uint32_t *index,
                    const double *distance) {
  const double tolerance = 2.0 * s->length * DBL_EPSILON;
  for (uint64_t v = 0; v < s->count; v++) {
    double best = INFINITY;
    uint32_t nearest = 0;
    for (uint32_t e = 0; e < entries; e++) {
      const double d = distance_to(s, v, values + (size_t)e * s->length);
      if (d < best) {
        best = d;
        nearest = e;
      }
    }
    assert_true(index[v] < entries);
    const double got = distance_to(s, v, values + (size_t)index[v] * s->length);
    if (index[v] != nearest && !(got <= best * (1.0 + tolerance) && got > best))
      fail_msg("vector %u: entry %u at %.17g instead of %u at %.17g", (unsigned)v, index[v], got, nearest,
               best);
    if (distance != NULL) assert_near(distance[v], best, tolerance * best);
  }
}

btfi_cmf_codebook make_codebook(btf_context *ctx, const sample *s, uint32_t method, uint32_t entries,
                                uint64_t seed) {
  const btfi_cmf_vectors vectors = vectors_of(s);
  const btfi_cmf_cluster_options options = {.method = method, .entries = entries, .seed = seed};
  btfi_cmf_codebook out;
  assert_ok(btfi_cmf_cluster(btfi_host(), ctx, &vectors, &options, NULL, 0, 1, "clustering", &out));
  assert_int_equal(out.length, s->length);
  assert_in_range(out.entries, 1, entries);
  return out;
}

void free_codebook(btf_context *ctx, btfi_cmf_codebook *codebook) {
  btfi_cmf_codebook_free(btfi_host(), ctx, codebook);
}
