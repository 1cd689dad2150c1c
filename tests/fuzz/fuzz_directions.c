/* SPDX-License-Identifier: MIT */
/* Direction sets: any floats, or the name of a set, make a set or are refused; what was made triangulates
 * without overlap and finds weights for any bits of a direction. */
#include "fuzz.h"

#include <math.h>

enum { MOST = 96, QUERIES = 12 };

/* Tame directions lie on the hemisphere, on a lattice fine enough for neighbours that are too close. */
static void take_direction(fuzz_bytes *in, int raw, float out[3]) {
  if (raw) {
    fuzz_take(in, out, 3 * sizeof *out);
    return;
  }
  const double a = ((double)fuzz_u16(in) - 32768.0) / 32768.0, b = ((double)fuzz_u16(in) - 32768.0) / 32768.0;
  const double square = a * a + b * b;
  out[0] = (float)(2.0 * a / (1.0 + square)); /* from parabolic coordinates; z < 0 outside the disc */
  out[1] = (float)(2.0 * b / (1.0 + square));
  out[2] = (float)((1.0 - square) / (1.0 + square));
}

static void check_weights(const btf_dirset *set, const btf_interp *interp) {
  float sum = 0.0f;
  for (int k = 0; k < 3; k++) {
    fuzz_expect(interp->index[k] < btf_dirset_count(set));
    fuzz_expect(interp->weight[k] >= 0.0f);
    sum += interp->weight[k];
  }
  fuzz_expect(fabsf(sum - 1.0f) <= 4e-7f); /* three roundings of a sum near 1, and of the weights */
}

static void check_query(const btf_dirset *set, const float d[3]) {
  const float *directions = btf_dirset_directions(set);
  const uint32_t count = btf_dirset_count(set), nearest = btf_dirset_nearest(set, d);
  btf_interp one, many;
  btf_dirset_locate(set, d, &one);
  check_weights(set, &one);
  btf_dirset_locate_n(set, 1, &d[0], &d[1], &d[2], &many);
  fuzz_expect(memcmp(&one, &many, sizeof one) == 0);
  fuzz_expect(nearest < count);
  const double length = sqrt((double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2]);
  if (!(length > 1e-3 && length < 1e3) || !(d[2] > 0.0f)) return;
  double best = -2.0, chosen = -2.0;
  for (uint32_t i = 0; i < count; i++) {
    const float *s = directions + 3 * (size_t)i;
    const double cosine = ((double)d[0] * s[0] + (double)d[1] * s[1] + (double)d[2] * s[2]) / length;
    if (cosine > best) best = cosine;
    if (i == nearest) chosen = cosine;
  }
  fuzz_expect(chosen >= best - 1e-6); /* some ten roundings of floats near 1 */
}

/* Twice the area of a triangle in parabolic coordinates. */
static double area(const float *a, const float *b, const float *c) {
  const double ax = (double)a[0] / (1.0 + a[2]), ay = (double)a[1] / (1.0 + a[2]);
  const double bx = (double)b[0] / (1.0 + b[2]), by = (double)b[1] / (1.0 + b[2]);
  const double cx = (double)c[0] / (1.0 + c[2]), cy = (double)c[1] / (1.0 + c[2]);
  return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
}

/* The first sample of the direction of sample i. */
static uint32_t first_of(const float *directions, uint32_t i) {
  const float *d = directions + 3 * (size_t)i;
  for (uint32_t k = 0; k < i; k++) {
    const float *s = directions + 3 * (size_t)k;
    if (s[0] == d[0] && s[1] == d[1] && s[2] == d[2]) return k;
  }
  return i;
}

static void check_set(const btf_dirset *set, fuzz_bytes *in) {
  const float *directions = btf_dirset_directions(set);
  const uint32_t count = btf_dirset_count(set);
  uint32_t triangle_count;
  const uint32_t *triangles = btf_dirset_triangles(set, &triangle_count);
  double total = 0.0;
  fuzz_expect(triangle_count <= 2 * count);
  for (uint32_t t = 0; t < triangle_count; t++) {
    const uint32_t *corner = triangles + 3 * (size_t)t;
    for (int k = 0; k < 3; k++) fuzz_expect(corner[k] < count);
    const double twice = area(directions + 3 * (size_t)corner[0], directions + 3 * (size_t)corner[1],
                              directions + 3 * (size_t)corner[2]);
    fuzz_expect(twice > -1e-6); /* the roundings of coordinates of size 1 */
    total += twice;
  }
  fuzz_expect(total < 2.0 * 3.15); /* twice the unit disc: triangles do not overlap */
  for (uint32_t i = 0; i < count; i++) {
    btf_interp interp;
    float own = 0.0f;
    btf_dirset_locate(set, directions + 3 * (size_t)i, &interp);
    check_weights(set, &interp);
    const uint32_t first = first_of(directions, i);
    for (int k = 0; k < 3; k++)
      if (interp.index[k] == first) own += interp.weight[k];
    fuzz_expect(own >= 1.0f - 4e-7f);
    fuzz_expect(btf_dirset_nearest(set, directions + 3 * (size_t)i) == first);
  }
  for (int q = 0; q < QUERIES; q++) {
    float d[3];
    const int raw = q % 2;
    take_direction(in, raw, d);
    check_query(set, d);
  }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static btf_context *ctx;
  fuzz_bytes in = {data, size};
  btf_dirset *set;
  uint64_t before, after;
  btf_status status;
  if (ctx == NULL) ctx = fuzz_context((uint64_t)64 << 20);
  btf_context_memory(ctx, &before, NULL);
  const uint32_t kind = fuzz_u8(&in);
  if (kind == 'n') { /* the rest is a name */
    char name[64];
    fuzz_take(&in, name, sizeof name - 1);
    name[sizeof name - 1] = '\0';
    status = btf_dirset_create_named(ctx, name, &set);
    fuzz_expect(status == BTF_OK || status == BTF_E_INVALID_ARG || status == BTF_E_LIMIT);
  } else {
    float xyz[3 * MOST];
    const uint32_t count = fuzz_u8(&in) % (MOST + 1);
    for (uint32_t i = 0; i < count; i++) take_direction(&in, kind & 1, xyz + 3 * (size_t)i);
    if (kind & 2) /* a lattice: many directions on a line or a circle */
      for (uint32_t i = 0; i < 3 * count; i++) xyz[i] = rintf(xyz[i] * 8.0f) / 8.0f;
    if (kind & 6)
      for (uint32_t i = 0; i < count; i++) {
        float *d = xyz + 3 * (size_t)i;
        const float length = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        if (!(length > 0.0f)) continue;
        for (int k = 0; k < 3; k++) d[k] /= length;
        if (kind & 8) d[2] = fabsf(d[2]);
      }
    status = btf_dirset_create(ctx, xyz, count, &set);
    fuzz_expect(status == BTF_OK || status == BTF_E_INVALID_ARG || status == BTF_E_LIMIT);
  }
  fuzz_expect((status == BTF_OK) == (set != NULL));
  if (set != NULL && btf_dirset_count(set) <= 4096) check_set(set, &in);
  btf_dirset_release(set);
  btf_context_memory(ctx, &after, NULL);
  fuzz_expect(before == after);
  return 0;
}
