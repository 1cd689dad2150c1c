/* SPDX-License-Identifier: MIT */
/* Triangulation, location and nearest sample against brute force, on many sets. */
#include "direction_recipes.h"

static void check_triangulation(const btf_dirset *set, const char *name) {
  plane_set s = plane_of(set);
  assert_true(s.triangles > 0);
  double area = 0.0, hull = 0.0, worst = 0.0;
  for (uint32_t i = 0; i < s.triangles; i++) {
    const uint32_t *t = s.t + 3 * i;
    const double *a = s.p[t[0]], *b = s.p[t[1]], *c = s.p[t[2]];
    assert_true(cross(a, b, c) > 0.0);
    area += cross(a, b, c);
    if (s.n > 400 && i % 7 != 0) continue; /* enough of the large sets */
    const double ab = hypot(a[0] - b[0], a[1] - b[1]), bc = hypot(b[0] - c[0], b[1] - c[1]),
                 ca = hypot(c[0] - a[0], c[1] - a[1]);
    for (uint32_t j = 0; j < s.n; j++) {
      const double *d = s.p[j];
      const double ax = a[0] - d[0], ay = a[1] - d[1], bx = b[0] - d[0], by = b[1] - d[1], cx = c[0] - d[0],
                   cy = c[1] - d[1];
      const double in = (ax * ax + ay * ay) * (bx * cy - cx * by) -
                        (bx * bx + by * by) * (ax * cy - cx * ay) + (cx * cx + cy * cy) * (ax * by - bx * ay);
      if (in <= 0.0) continue;
      const double ad = hypot(ax, ay), bd = hypot(bx, by), cd = hypot(cx, cy);
      const double best = fmax(fmax(ab * bc * ca, ab * bd * ad), fmax(bc * cd * bd, ca * ad * cd));
      worst = fmax(worst, in / best);
    }
  }
  /* Ties are called within 1e-6 for one edge; a triangle at the end of a fan may have crossed a few of them.
   */
  if (worst > 4e-6) fail_msg("%s: a sample lies %g inside a circle", name, worst);
  /* Gift wrapping gives the hull independently of the triangles. */
  uint32_t start = 0;
  for (uint32_t i = 1; i < s.n; i++)
    if (s.p[i][0] < s.p[start][0]) start = i;
  uint32_t at = start, steps = 0;
  do {
    uint32_t to = at == 0 ? 1 : 0;
    for (uint32_t i = 0; i < s.n; i++)
      if (i != at && cross(s.p[at], s.p[to], s.p[i]) < 0.0) to = i;
    hull += s.p[at][0] * s.p[to][1] - s.p[at][1] * s.p[to][0];
    at = to;
    assert_true(steps++ < s.n);
  } while (at != start);
  /* The rim may lie 2e-6 within the hull (samples on straight sides), along at most 2 pi. */
  assert_near(area, hull, 2.0 * 2e-6 * 2.0 * M_PI);
  /* Euler: every sample is a corner of some triangle. */
  assert_int_equal(s.triangles, 2 * s.n - 2 - s.rim);
  plane_done(&s);
}

static void triangulation_is_delaunay(void **state) {
  (void)state;
  for_each_set(check_triangulation);
}

/* The interpolated position is the query's own inside the hull and its projection outside. */
static void check_locate(const btf_dirset *set, const char *name) {
  plane_set s = plane_of(set);
  const uint32_t tries = s.n > 400 ? 3000 : 20000;
  double worst = 0.0;
  for (uint32_t i = 0; i < tries; i++) {
    float d[3];
    random_direction(d);
    if (i % 4 == 0 && s.n > 1) { /* near a sample: clusters are hit too */
      const float *c = btf_dirset_directions(set) + 3 * btfi_random_below(&dice, s.n);
      const float r = i % 8 == 0 ? 0.002f : 1e-5f;
      unit(c[0] + r * btfi_random_normal(&dice), c[1] + r * btfi_random_normal(&dice), c[2], d);
    }
    btf_interp w;
    btf_dirset_locate(set, d, &w);
    assert_valid(&w, s.n);
    double q[2], expected[2] = {0.0, 0.0}, got[2];
    parabolic(d, q);
    onto_hull(&s, q, expected);
    interpolated(&s, &w, got);
    worst = fmax(worst, hypot(got[0] - expected[0], got[1] - expected[1]));
  }
  /* Rounding of the query and of three samples, and 2e-6 where samples beside a straight side count as on it.
   */
  const double allowed = strcmp(name, "half") == 0 ? 4e-6 : 4.0 * PARABOLIC_ERROR;
  if (worst > allowed) fail_msg("%s: interpolated position off by %g", name, worst);
  plane_done(&s);
}

static void locate_agrees_with_brute_force(void **state) {
  (void)state;
  for_each_set(check_locate);
}

static void check_many(const btf_dirset *set, const char *name) {
  enum { N = 1000 };
  (void)name;
  const uint32_t n = btf_dirset_count(set), rounds = n == 81 || n == 151 ? 1000 : 100;
  static float x[N], y[N], z[N];
  static btf_interp batch[N];
  for (uint32_t r = 0; r < rounds; r++) {
    for (int i = 0; i < N; i++) {
      /* Cheap and anywhere, below the horizon too. */
      const float d[3] = {btfi_random_float(&dice) - 0.5f, btfi_random_float(&dice) - 0.5f,
                          btfi_random_float(&dice) - 0.1f};
      const float s = 1.0f / sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
      x[i] = d[0] * s;
      y[i] = d[1] * s;
      z[i] = d[2] * s;
    }
    btf_dirset_locate_n(set, N, x, y, z, batch);
    for (int i = 0; i < N; i++) {
      const btf_interp *w = &batch[i];
      const double sum = (double)w->weight[0] + w->weight[1] + w->weight[2];
      if (!(w->weight[0] >= 0.0f && w->weight[1] >= 0.0f && w->weight[2] >= 0.0f &&
            fabs(sum - 1.0) <= 1.2e-7 && w->index[0] < n && w->index[1] < n && w->index[2] < n))
        assert_valid(w, n);
      if (r % 8 == 0) {
        btf_interp single;
        btf_dirset_locate(set, (float[3]){x[i], y[i], z[i]}, &single);
        assert_memory_equal(&single, w, sizeof single);
      }
    }
  }
}

static void weights_are_a_partition_of_unity(void **state) {
  (void)state;
  for_each_set(check_many);
}

static void check_samples(const btf_dirset *set, const char *name) {
  const uint32_t n = btf_dirset_count(set);
  for (uint32_t i = 0; i < n; i++) {
    const float *d = btf_dirset_directions(set) + 3 * i;
    btf_interp w;
    btf_dirset_locate(set, d, &w);
    for (int k = 0; k < 3; k++)
      if (w.weight[k] != 0.0f && (w.index[k] != i || w.weight[k] != 1.0f)) fail_msg("%s: sample %u", name, i);
    assert_valid(&w, n);
    assert_int_equal(btf_dirset_nearest(set, d), i);
  }
}

static void samples_are_exact(void **state) {
  (void)state;
  for_each_set(check_samples);
}

static double worst_rate; /* of all sets */

/* Value of a function that is linear in parabolic coordinates, and its rate of change over a step. */
static double rate(const btf_dirset *set, const plane_set *s, const float from[3], const float to[3]) {
  btf_interp a, b;
  double p[2], q[2], u[2], v[2];
  btf_dirset_locate(set, from, &a);
  btf_dirset_locate(set, to, &b);
  parabolic(from, p);
  parabolic(to, q);
  interpolated(s, &a, u);
  interpolated(s, &b, v);
  const double step = hypot(p[0] - q[0], p[1] - q[1]);
  return hypot(u[0] - v[0], u[1] - v[1]) / (step + 4.0 * PARABOLIC_ERROR);
}

/* A function of the samples that is as rough as can be: does the interpolation jump? */
static double rough(const btf_interp *w) {
  double v = 0.0;
  for (int k = 0; k < 3; k++) v += w->weight[k] * (double)((w->index[k] * 2654435761u >> 8) & 1023) / 1023.0;
  return v;
}

static double worst_jump;

static void check_continuity(const btf_dirset *set, const char *name) {
  plane_set s = plane_of(set);
  const uint32_t tries = 80000;
  double worst = 0.0;
  for (uint32_t i = 0; i < tries; i++) {
    float a[3], b[3];
    random_direction(a);
    const float step = i % 2 ? 1e-3f : 1e-5f;
    unit(a[0] + step * btfi_random_normal(&dice), a[1] + step * btfi_random_normal(&dice),
         a[2] + step * btfi_random_normal(&dice), b);
    worst = fmax(worst, rate(set, &s, a, b));
  }
  /* Across the middle and the quarters of every edge, inside and on the rim. */
  for (uint32_t i = 0; i < 3 * s.triangles; i++) {
    const double *p = s.p[s.t[i]], *q = s.p[s.t[i - i % 3 + (i % 3 + 1) % 3]];
    const double length = hypot(q[0] - p[0], q[1] - p[1]), nx = -(q[1] - p[1]) / length,
                 ny = (q[0] - p[0]) / length;
    for (int k = 0; k < 4; k++) {
      const double t = 0.25 * k + 0.1, h = k % 2 ? 1e-6 : 1e-4 * length;
      float a[3], b[3];
      const double x = p[0] + t * (q[0] - p[0]), y = p[1] + t * (q[1] - p[1]);
      btfi_parabolic_direction((float)(x + h * nx), (float)(y + h * ny), a);
      btfi_parabolic_direction((float)(x - h * nx), (float)(y - h * ny), b);
      worst = fmax(worst, rate(set, &s, a, b));
      /* The rough function has a slope of at most 1 over the least height of a triangle, so it may change by
       * the step over that; a jump would change it by a fair part of 1 whatever the step. Only thick
       * triangles tell. */
      if (length < 0.01) continue;
      btf_interp u, v;
      btfi_parabolic_direction((float)(x + 1e-6 * nx), (float)(y + 1e-6 * ny), a);
      btfi_parabolic_direction((float)(x - 1e-6 * nx), (float)(y - 1e-6 * ny), b);
      btf_dirset_locate(set, a, &u);
      btf_dirset_locate(set, b, &v);
      if (strncmp(name, "ubo", 3) == 0 || strncmp(name, "grid", 4) == 0)
        worst_jump = fmax(worst_jump, fabs(rough(&u) - rough(&v)));
    }
  }
  /* Projection onto a convex hull never lengthens a step. Straight sides are off by 2e-6 over the shortest
   * chord. */
  const double allowed = strcmp(name, "half") == 0 ? 1.0 + 1e-3 : 1.0 + 1e-6;
  if (worst > allowed)
    fail_msg("%s: interpolation of a linear function jumps: %g times the step", name, worst);
  worst_rate = fmax(worst_rate, worst);
  plane_done(&s);
}

static void weights_are_continuous(void **state) {
  (void)state;
  for_each_set(check_continuity);
  /* Steps of 2e-6 over heights of at least 0.0024, those of the fan that closes the top of grid:64x16. */
  assert_true(worst_jump < 1e-3);
  print_message("largest change of a linear function: %.7f of the step; of a rough one over 2e-6: %.2g\n",
                worst_rate, worst_jump);
}

/* Nearest by definition: the largest dot product with the normalised samples, the first of equals. */
static uint32_t nearest_of_all(const double (*u)[3], uint32_t n, const float d[3]) {
  uint32_t best = 0;
  double best_dot = -INFINITY;
  const double x = d[0], y = d[1], z = d[2] < 0.0f ? 0.0 : d[2];
  for (uint32_t i = 0; i < n; i++) {
    const double dot = x * u[i][0] + y * u[i][1] + z * u[i][2];
    if (dot > best_dot) {
      best_dot = dot;
      best = i;
    }
  }
  return best;
}

static void check_nearest(const btf_dirset *set, const char *name) {
  const uint32_t n = btf_dirset_count(set), tries = n == 81 ? 1000000 : 20000000 / (n + 200);
  double(*u)[3] = malloc(n * sizeof *u);
  for (uint32_t i = 0; i < n; i++) {
    const float *d = btf_dirset_directions(set) + 3 * i;
    const double x = d[0], y = d[1], z = d[2], scale = 1.0 / sqrt(x * x + y * y + z * z);
    u[i][0] = x * scale;
    u[i][1] = y * scale;
    u[i][2] = z * scale;
  }
  for (uint32_t i = 0; i < tries; i++) {
    float d[3] = {btfi_random_float(&dice) - 0.5f, btfi_random_float(&dice) - 0.5f,
                  btfi_random_float(&dice) * 0.8f};
    if (i % 3 == 0) {
      const float *c = btf_dirset_directions(set) + 3 * btfi_random_below(&dice, n),
                  r = i % 2 ? 0.01f : 3e-4f;
      for (int k = 0; k < 3; k++) d[k] = c[k] + r * (btfi_random_float(&dice) - 0.5f);
    }
    if (i % 100 == 7) d[2] = -d[2];
    if (i % 100 == 8) d[0] = 0.0f; /* symmetric sets have ties there */
    const uint32_t got = btf_dirset_nearest(set, d), expected = nearest_of_all((const double(*)[3])u, n, d);
    if (got != expected)
      fail_msg("%s: nearest to (%g, %g, %g) is %u, got %u", name, d[0], d[1], d[2], expected, got);
  }
  free(u);
}

static void nearest_is_the_nearest(void **state) {
  (void)state;
  for_each_set(check_nearest);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(triangulation_is_delaunay),        cmocka_unit_test(locate_agrees_with_brute_force),
      cmocka_unit_test(weights_are_a_partition_of_unity), cmocka_unit_test(samples_are_exact),
      cmocka_unit_test(weights_are_continuous),           cmocka_unit_test(nearest_is_the_nearest),
  };
  return btf_run("directions", tests);
}
