/* SPDX-License-Identifier: MIT */
#include "direction_recipes.h"

/* ---- random directions ---- */

btfi_random dice;

void unit(float x, float y, float z, float d[3]) {
  const double length = sqrt((double)x * x + (double)y * y + (double)z * z);
  d[0] = (float)(x / length);
  d[1] = (float)(y / length);
  d[2] = (float)(z / length);
}

void random_direction(float d[3]) {
  unit(btfi_random_normal(&dice), btfi_random_normal(&dice), fabsf(btfi_random_normal(&dice)) + 1e-7f, d);
}

void parabolic(const float d[3], double p[2]) {
  const double x = d[0], y = d[1], z = d[2] < 0.0f ? 0.0 : d[2], s = 1.0 / (sqrt(x * x + y * y + z * z) + z);
  p[0] = x * s;
  p[1] = y * s;
}

/* ---- the sets under test ---- */

btf_dirset *named(btf_context *ctx, const char *name) {
  btf_dirset *set;
  assert_ok(btf_dirset_create_named(ctx, name, &set));
  return set;
}

/* Drops directions that the library would call duplicates, so that every recipe below gives a legal set. */
static btf_dirset *create_spread(btf_context *ctx, float (*d)[3], uint32_t n) {
  uint32_t kept = 0;
  for (uint32_t i = 0; i < n; i++) {
    bool near = false;
    for (uint32_t j = 0; j < kept && !near; j++) {
      const double x = d[i][0] - d[j][0], y = d[i][1] - d[j][1], z = d[i][2] - d[j][2];
      near = x * x + y * y + z * z < 1.1e-4 * 1.1e-4;
    }
    if (!near) memmove(d[kept++], d[i], sizeof d[i]);
  }
  btf_dirset *set;
  assert_ok(btf_dirset_create(ctx, d[0], kept, &set));
  return set;
}

static btf_dirset *random_set(btf_context *ctx, uint32_t n) {
  float(*d)[3] = malloc(n * sizeof *d);
  for (uint32_t i = 0; i < n; i++) random_direction(d[i]);
  btf_dirset *set = create_spread(ctx, d, n);
  free(d);
  return set;
}

void at_angles(double theta, double phi, float d[3]) {
  d[0] = (float)(sin(theta) * cos(phi));
  d[1] = (float)(sin(theta) * sin(phi));
  d[2] = (float)cos(theta);
}

static btf_dirset *ring_set(btf_context *ctx, uint32_t n, double turn) {
  float(*d)[3] = malloc((4 * n + 1) * sizeof *d);
  const double theta[4] = {0.2, 0.7, 1.1, 1.5};
  for (uint32_t i = 0; i < 4 * n; i++) at_angles(theta[i / n], 2.0 * M_PI * (i % n) / n + turn, d[i]);
  d[4 * n][0] = d[4 * n][1] = 0.0f;
  d[4 * n][2] = 1.0f;
  btf_dirset *set = create_spread(ctx, d, 4 * n + 1);
  free(d);
  return set;
}

/* Most samples in three tiny patches. */
static btf_dirset *clustered_set(btf_context *ctx) {
  enum { N = 1200 };
  float(*d)[3] = malloc(N * sizeof *d);
  const float centre[3][3] = {{0.1f, 0.2f, 0.9f}, {-0.8f, 0.1f, 0.3f}, {0.4f, -0.6f, 0.05f}};
  for (uint32_t i = 0; i < N; i++) {
    if (i % 40 == 0) {
      random_direction(d[i]);
      continue;
    }
    const float *c = centre[i % 3], spread = 0.005f;
    unit(c[0] + spread * btfi_random_normal(&dice), c[1] + spread * btfi_random_normal(&dice),
         c[2] + 0.2f * spread * btfi_random_float(&dice), d[i]);
  }
  btf_dirset *set = create_spread(ctx, d, N);
  free(d);
  return set;
}

/* A half hemisphere whose straight side is rounded at an odd angle: the rim is straight up to noise. */
btf_dirset *half_set(btf_context *ctx) {
  float d[19 * 8 + 1][3];
  for (int i = 0; i < 19 * 8; i++) at_angles((i / 19 + 1) * 0.18, i % 19 * M_PI / 18 + 0.4, d[i]);
  at_angles(0.0, 0.0, d[19 * 8]);
  btf_dirset *set;
  assert_ok(btf_dirset_create(ctx, d[0], 19 * 8 + 1, &set));
  return set;
}

enum { SETS = 13 };
static const char *const set_names[SETS] = {
    "ubo81",     "ubo151",     "grid:10x5",   "grid:16x8",   "grid:64x16", "random 3", "random 4",
    "random 17", "random 300", "random 2000", "rings of 40", "clusters",   "half"};
static btf_dirset *set_under_test(btf_context *ctx, int i) {
  switch (i) {
  case 5:
    return random_set(ctx, 3);
  case 6:
    return random_set(ctx, 4);
  case 7:
    return random_set(ctx, 17);
  case 8:
    return random_set(ctx, 300);
  case 9:
    return random_set(ctx, 2000);
  case 10:
    return ring_set(ctx, 40, 0.1);
  case 11:
    return clustered_set(ctx);
  case 12:
    return half_set(ctx);
  default:
    return named(ctx, set_names[i]);
  }
}

/* Runs a check on every set. */
void for_each_set(void (*check)(const btf_dirset *set, const char *name)) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btfi_random_seed(&dice, 7);
  for (int i = 0; i < SETS; i++) {
    btf_dirset *set = set_under_test(ctx, i);
    check(set, set_names[i]);
    btf_dirset_release(set);
  }
  test_context_done(ctx, &memory);
}

/* ---- geometry by brute force ---- */

double cross(const double a[2], const double b[2], const double c[2]) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

static int by_edge(const void *a, const void *b) {
  return memcmp(a, b, 3 * sizeof(uint32_t));
}

/* Rim: edges that occur once. */
plane_set plane_of(const btf_dirset *set) {
  plane_set s = {.n = btf_dirset_count(set)};
  s.t = btf_dirset_triangles(set, &s.triangles);
  s.p = malloc(s.n * sizeof *s.p);
  for (uint32_t i = 0; i < s.n; i++) parabolic(btf_dirset_directions(set) + 3 * i, s.p[i]);
  uint32_t(*all)[3] = malloc((3 * s.triangles + 1) * sizeof *all);
  for (uint32_t i = 0; i < 3 * s.triangles; i++) {
    const uint32_t a = s.t[i], b = s.t[i - i % 3 + (i % 3 + 1) % 3];
    all[i][0] = a < b ? a : b;
    all[i][1] = a < b ? b : a;
    all[i][2] = a < b;
  }
  qsort(all, 3 * s.triangles, sizeof *all, by_edge);
  s.edge = malloc((3 * s.triangles + 1) * sizeof *s.edge);
  for (uint32_t i = 0; i < 3 * s.triangles; i++) {
    const bool twin = i + 1 < 3 * s.triangles && memcmp(all[i], all[i + 1], 8) == 0;
    if (twin) {
      assert_int_not_equal(all[i][2], all[i + 1][2]); /* once in each sense: no overlap along an edge */
      i++;
      continue;
    }
    s.edge[s.rim][0] = all[i][2] ? all[i][0] : all[i][1];
    s.edge[s.rim++][1] = all[i][2] ? all[i][1] : all[i][0];
  }
  free(all);
  return s;
}

void plane_done(plane_set *s) {
  free(s->p);
  free(s->edge);
}

double nearest_on_segment(const double a[2], const double b[2], const double q[2], double out[2]) {
  const double dx = b[0] - a[0], dy = b[1] - a[1];
  double t = ((q[0] - a[0]) * dx + (q[1] - a[1]) * dy) / (dx * dx + dy * dy);
  t = t < 0.0 ? 0.0 : t > 1.0 ? 1.0 : t;
  out[0] = a[0] + t * dx;
  out[1] = a[1] + t * dy;
  return hypot(q[0] - out[0], q[1] - out[1]);
}

/* The point of the hull nearest to q. */
void onto_hull(const plane_set *s, const double q[2], double out[2]) {
  for (uint32_t i = 0; i < s->triangles; i++) {
    const double *a = s->p[s->t[3 * i]], *b = s->p[s->t[3 * i + 1]], *c = s->p[s->t[3 * i + 2]];
    if (cross(a, b, q) >= 0.0 && cross(b, c, q) >= 0.0 && cross(c, a, q) >= 0.0) {
      out[0] = q[0];
      out[1] = q[1];
      return;
    }
  }
  double best = INFINITY;
  for (uint32_t i = 0; i < s->rim; i++) {
    double there[2];
    const double away = nearest_on_segment(s->p[s->edge[i][0]], s->p[s->edge[i][1]], q, there);
    if (away < best) {
      best = away;
      memcpy(out, there, sizeof there);
    }
  }
}

void interpolated(const plane_set *s, const btf_interp *w, double out[2]) {
  out[0] = out[1] = 0.0;
  for (int k = 0; k < 3; k++) {
    out[0] += w->weight[k] * s->p[w->index[k]][0];
    out[1] += w->weight[k] * s->p[w->index[k]][1];
  }
}

void assert_valid(const btf_interp *w, uint32_t n) {
  double sum = 0.0;
  for (int k = 0; k < 3; k++) {
    assert_true(w->index[k] < n);
    assert_true(w->weight[k] >= 0.0f);
    sum += w->weight[k];
  }
  assert_near(sum, 1.0, 1.2e-7); /* three weights rounded to floats: half a unit in the last place each */
}
