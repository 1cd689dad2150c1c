/* SPDX-License-Identifier: MIT */
/* Which sets there are and which are refused, sets without triangles, odd directions, large sets, failures.
 */
#include "direction_recipes.h"

static void built_in_sets(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const struct {
    const char *name;
    uint32_t count, probe;
    double theta, phi;
  } facts[] = {{"ubo81", 81, 0, 0, 0},           {"ubo81", 81, 6, 15, 300},
               {"ubo81", 81, 19, 45, 0},         {"ubo81", 81, 38, 60, 18},
               {"ubo81", 81, 80, 75, 345},       {"ubo151", 151, 0, 0, 0},
               {"ubo151", 151, 1, 11, 15},       {"ubo151", 151, 7, 23.5, 0},
               {"ubo151", 151, 19, 30, 15},      {"ubo151", 151, 42, 37.5, 330},
               {"ubo151", 151, 61, 52.5, 7.5},   {"ubo151", 151, 103, 67.5, 7.5},
               {"ubo151", 151, 150, 75, 345},    {"grid:10x5", 50, 0, 9, 0},
               {"grid:10x5", 50, 49, 81, 324},   {"grid:16x8", 128, 17, 16.875, 22.5},
               {"grid:8x8", 64, 63, 84.375, 315}};
  for (size_t i = 0; i < sizeof facts / sizeof *facts; i++) {
    btf_dirset *set = named(ctx, facts[i].name);
    assert_int_equal(btf_dirset_count(set), facts[i].count);
    float expected[3];
    at_angles(facts[i].theta * M_PI / 180, facts[i].phi * M_PI / 180, expected);
    for (int k = 0; k < 3; k++)
      assert_near(btf_dirset_directions(set)[3 * facts[i].probe + (uint32_t)k], expected[k], 1e-7);
    btf_dirset_release(set);
  }
  /* Entry 8 of the dome, 23.5 degrees at 30, by hand. */
  btf_dirset *set = named(ctx, "ubo151");
  assert_near(btf_dirset_directions(set)[24], 0.345326823, 1e-7);
  assert_near(btf_dirset_directions(set)[25], 0.199374534, 1e-7);
  assert_near(btf_dirset_directions(set)[26], 0.917060074, 1e-7);
  const double theta[10] = {0, 11, 23.5, 30, 37.5, 45, 52.5, 60, 67.5, 75};
  const uint32_t ring[10] = {1, 6, 12, 12, 12, 18, 18, 24, 24, 24};
  for (uint32_t r = 0, i = 0; r < 10; r++)
    for (uint32_t j = 0; j < ring[r]; j++, i++)
      assert_near(btf_dirset_directions(set)[3 * i + 2], cos(theta[r] * M_PI / 180), 1e-7);
  btf_dirset_release(set);
  const char *const wrong[] = {"",
                               "ubo",
                               "UBO81",
                               "ubo811",
                               "grid",
                               "grid:",
                               "grid:10",
                               "grid:10x",
                               "grid:x5",
                               "grid:0x5",
                               "grid:10x0",
                               "grid:-1x5",
                               "grid:10x5 ",
                               "grid: 10x5",
                               "grid:1025x1",
                               "grid:1x1025",
                               "grid:10x5x2",
                               "grid:010x5",
                               "grid:99999999999999999999x1"};
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
    assert_status(btf_dirset_create_named(ctx, wrong[i], &set), BTF_E_INVALID_ARG);
    assert_null(set);
    assert_message_has(strncmp(wrong[i], "grid:", 5) == 0 ? "1024" : "ubo151");
  }
  assert_status(btf_dirset_create_named(ctx, NULL, &set), BTF_E_INVALID_ARG);
  assert_status(btf_dirset_create_named(ctx, "grid:1024x1024", &set), BTF_E_LIMIT);
  /* 2 pi / 1024 times the innermost elevation of pi / 4 / T: 0.0001004 rad for T = 48. */
  assert_status(btf_dirset_create_named(ctx, "grid:1024x49", &set), BTF_E_INVALID_ARG);
  assert_message_has("grid:1024x49: neighbours on its innermost ring are 9.8");
  assert_ok(btf_dirset_create_named(ctx, "grid:1024x48", &set));
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

static void bad_sets_are_refused(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set = named(ctx, "ubo151");
  float d[151][3];
  const struct {
    uint32_t at;
    float value[3];
    const char *message;
  } faults[] = {{17, {0.0f, 0.0f, 0.93f}, "direction 17: length 0.93, expected 1 within 0.001"},
                {0, {0.0f, 0.0f, 1.0015f}, "direction 0: length 1.0015"},
                {150, {1.0f, 0.0f, 0.0f}, "direction 150: z is 0"},
                {3, {0.6f, 0.0f, -0.8f}, "direction 3: z is -0.8"},
                {5, {NAN, 0.0f, 1.0f}, "direction 5: "},
                {5, {0.0f, INFINITY, 1.0f}, "direction 5: "},
                {5, {0.0f, 0.0f, 0.0f}, "direction 5: length 0"},
                {140, {0.00009f, 0.0f, 1.0f}, "directions 0 and 140: "},
                {1, {0.00001f, 0.0f, 1.0f}, "directions 0 and 1: "}};
  for (size_t i = 0; i < sizeof faults / sizeof *faults; i++) {
    memcpy(d, btf_dirset_directions(set), sizeof d);
    memcpy(d[faults[i].at], faults[i].value, sizeof d[0]);
    btf_dirset *bad = set;
    assert_status(btf_dirset_create(ctx, d[0], 151, &bad), BTF_E_INVALID_ARG);
    assert_null(bad);
    assert_message_has(faults[i].message);
  }
  /* Just far enough apart, at the top and at the horizon, where parabolic distances differ most. */
  const float apart[4][3] = {
      {0.0f, 0.0f, 1.0f}, {0.000102f, 0.0f, 1.0f}, {1.0f, 0.0f, 0.00002f}, {1.0f, 0.000102f, 0.00002f}};
  btf_dirset *fine;
  assert_ok(btf_dirset_create(ctx, apart[0], 4, &fine));
  btf_dirset_release(fine);
  /* A pair at the horizon across the border of any grid of cells. */
  for (int i = 0; i < 200; i++) {
    const double phi = 0.03141 * i;
    float pair[2][3];
    at_angles(1.57, phi, pair[0]);
    at_angles(1.57 - (i % 2 ? 0.9e-4 : 0.0), phi + (i % 2 ? 0.0 : 0.9e-4), pair[1]);
    assert_status(btf_dirset_create(ctx, pair[0], 2, &fine), BTF_E_INVALID_ARG);
    assert_message_has("directions 0 and 1: ");
  }
  assert_status(btf_dirset_create(ctx, apart[0], 0, &fine), BTF_E_INVALID_ARG);
  assert_status(btf_dirset_create(ctx, NULL, 3, &fine), BTF_E_INVALID_ARG);
  assert_status(btf_dirset_create(ctx, apart[0], 65537, &fine), BTF_E_LIMIT); /* looks at the count alone */
  assert_message_has("65536");
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

/* With repeats strewn in, a set gives the triangles, weights and nearest samples of the set without them,
 * under the number of the first of each direction. */
static void check_with_repeats(const btf_dirset *set, const char *name) {
  const uint32_t n = btf_dirset_count(set);
  const float *given = btf_dirset_directions(set);
  float(*d)[3] = malloc(3 * (size_t)n * sizeof *d);
  uint32_t *first = malloc(n * sizeof *first), count = 0, plain_triangles, triangles;
  btf_dirset *repeated;
  for (uint32_t i = 0; i < n; i++) {
    first[i] = count;
    memcpy(d[count++], given + 3 * (size_t)i, sizeof *d);
    if (i % 3 == 0) memcpy(d[count++], given + 3 * (size_t)(i / 2), sizeof *d);
    if (i % 7 == 0) memcpy(d[count++], given, sizeof *d);
  }
  assert_ok(btf_dirset_create(btfi_dirset_context(set), d[0], count, &repeated));
  assert_int_equal(btf_dirset_count(repeated), count);
  assert_memory_equal(btf_dirset_directions(repeated), d[0], count * sizeof *d);
  const uint32_t *expected = btf_dirset_triangles(set, &plain_triangles),
                 *got = btf_dirset_triangles(repeated, &triangles);
  assert_int_equal(triangles, plain_triangles);
  for (uint32_t i = 0; i < 3 * triangles; i++) assert_int_equal(got[i], first[expected[i]]);
  for (int i = 0; i < 1000; i++) {
    float q[3];
    btf_interp plain, w, batched;
    random_direction(q);
    if (i < 2 * (int)n) memcpy(q, given + 3 * (size_t)(i % (int)n), sizeof q);
    btf_dirset_locate(set, q, &plain);
    btf_dirset_locate(repeated, q, &w);
    btf_dirset_locate_n(repeated, 1, &q[0], &q[1], &q[2], &batched);
    assert_memory_equal(w.weight, plain.weight, sizeof w.weight);
    assert_memory_equal(&w, &batched, sizeof w);
    for (int k = 0; k < 3; k++)
      if (w.index[k] != first[plain.index[k]]) fail_msg("%s: another sample has the weight", name);
    assert_int_equal(btf_dirset_nearest(repeated, q), first[btf_dirset_nearest(set, q)]);
  }
  btf_dirset_release(repeated);
  free(first);
  free(d);
}

static void repeats_are_samples_without_a_place(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set;
  for_each_set(check_with_repeats);
  /* Zeros of both signs are one direction. */
  assert_ok(btf_dirset_create(ctx, (const float[6]){-0.0f, 0.0f, 1.0f, 0.0f, -0.0f, 1.0f}, 2, &set));
  assert_int_equal(btf_dirset_nearest(set, (const float[3]){0.3f, 0.0f, 0.9f}), 0);
  btf_dirset_release(set);
  /* As many as there may be, all alike: their pairs would take minutes. */
  float *same = malloc(3 * 65536 * sizeof *same);
  for (uint32_t i = 0; i < 65536; i++) memcpy(same + 3 * (size_t)i, (const float[3]){0.6f, 0.0f, 0.8f}, 12);
  assert_ok(btf_dirset_create(ctx, same, 65536, &set));
  assert_int_equal(btf_dirset_count(set), 65536);
  assert_int_equal(btf_dirset_nearest(set, (const float[3]){0.0f, 0.3f, 0.9f}), 0);
  btf_dirset_release(set);
  free(same);
  test_context_done(ctx, &memory);
}

static void directions_keep_their_floats(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const float given[3][3] = {{0.6f, 0.0f, 0.800003f}, {0.0f, 0.6004f, 0.8004f}, {0.0f, 0.0f, 1.0f}};
  btf_dirset *a, *b;
  assert_ok(btf_dirset_create(ctx, given[0], 3, &a));
  const float *kept = btf_dirset_directions(a);
  assert_memory_equal(kept, given[0], sizeof given[0]);
  assert_near(sqrt((double)kept[4] * kept[4] + (double)kept[5] * kept[5]), 1.0, 1e-7);
  assert_ok(btf_dirset_create(ctx, kept, 3, &b));
  assert_true(btfi_dirset_equal(a, b));
  btf_dirset_release(b);
  b = named(ctx, "grid:3x1");
  assert_false(btfi_dirset_equal(a, b));
  assert_ptr_equal(btfi_dirset_context(b), ctx);
  btf_dirset *again = btf_dirset_retain(b);
  assert_ptr_equal(again, b);
  btf_dirset_release(b);
  assert_int_equal(btf_dirset_count(again), 3);
  btf_dirset_release(again);
  btf_dirset_release(a);
  btf_dirset_release(NULL);
  test_context_done(ctx, &memory);
}

/* Horizon, below it, and what is not a direction. */
static void locate_is_total(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const char *const names[] = {"ubo151", "grid:1x7", "grid:1x1", "grid:5x1"};
  for (int s = 0; s < 4; s++) {
    btf_dirset *set = named(ctx, names[s]);
    const uint32_t n = btf_dirset_count(set);
    for (int i = 0; i < 2000; i++) {
      float d[3], on[3], below[3];
      random_direction(d);
      const float r = hypotf(d[0], d[1]);
      on[0] = d[0] / r;
      on[1] = d[1] / r;
      on[2] = 0.0f;
      memcpy(below, d, sizeof d);
      below[2] = -d[2];
      btf_interp a, b;
      btf_dirset_locate(set, on, &a);
      btf_dirset_locate(set, below, &b);
      assert_valid(&b, n);
      for (int k = 0; k < 3; k++) {
        /* The same up to rounding of the query, over the spacing of the samples (at least 0.1). */
        assert_near(a.weight[k], b.weight[k], 1e-5);
        if (a.weight[k] > 1e-5f) assert_int_equal(a.index[k], b.index[k]);
      }
      assert_int_equal(btf_dirset_nearest(set, on), btf_dirset_nearest(set, below));
    }
    const float odd[] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 9; i++) {
      float d[3] = {0.3f, 0.4f, 0.5f};
      d[i % 3] = odd[i / 3];
      btf_interp w;
      btf_dirset_locate(set, d, &w);
      const btf_interp zero = {{0, 0, 0}, {1.0f, 0.0f, 0.0f}};
      assert_memory_equal(&w, &zero, sizeof w);
      btf_dirset_locate_n(set, 1, &d[0], &d[1], &d[2], &w);
      assert_memory_equal(&w, &zero, sizeof w);
      assert_int_equal(btf_dirset_nearest(set, d), 0);
    }
    const float corner[][3] = {
        {0, 0, -1},          {0, 0, 0},      {3e38f, 3e38f, 3e38f}, {-3e38f, 1e-40f, -3e38f},
        {1e-45f, 0, 1e-45f}, {0, 0, 1e-30f}, {0, 0, -3e38f},        {0, -1, 0},
        {1e-30f, 0, -1}};
    for (size_t i = 0; i < sizeof corner / sizeof *corner; i++) {
      btf_interp w, v;
      btf_dirset_locate(set, corner[i], &w);
      assert_valid(&w, n);
      assert_true(btf_dirset_nearest(set, corner[i]) < n);
      btf_dirset_locate_n(set, 1, &corner[i][0], &corner[i][1], &corner[i][2], &v);
      assert_memory_equal(&w, &v, sizeof w);
    }
    /* Straight down reads as +x. */
    btf_interp down, x;
    btf_dirset_locate(set, (float[3]){0, 0, -1}, &down);
    btf_dirset_locate(set, (float[3]){1, 0, 0}, &x);
    assert_memory_equal(&down, &x, sizeof x);
    assert_int_equal(btf_dirset_nearest(set, (float[3]){0, 0, -1}),
                     btf_dirset_nearest(set, (float[3]){1, 0, 0}));
    btf_dirset_release(set);
  }
  test_context_done(ctx, &memory);
}

/* One sample; two; a fan in a plane, also one whose plane is rounded. */
static void sets_on_a_line(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btfi_random_seed(&dice, 3);
  for (int kind = 0; kind < 5; kind++) {
    const uint32_t n = kind == 0 ? 1 : kind == 1 ? 2 : 11;
    const double phi = kind == 2 ? 0.0 : kind == 3 ? 0.7 : 2.2;
    float d[11][3];
    for (uint32_t i = 0; i < n; i++) { /* order unlike that along the line */
      const double theta = -1.4 + 0.28 * (i * 7 % 11);
      at_angles(theta, phi, d[i]);
      for (int k = 0; kind == 4 && k < 3; k++) d[i][k] = (float)(round(d[i][k] * 1e6) / 1e6);
    }
    btf_dirset *set;
    assert_ok(btf_dirset_create(ctx, d[0], n, &set));
    uint32_t triangles = 1;
    btf_dirset_triangles(set, &triangles);
    assert_int_equal(triangles, 0);
    double p[11][2];
    for (uint32_t i = 0; i < n; i++) {
      parabolic(d[i], p[i]);
      btf_interp w;
      btf_dirset_locate(set, d[i], &w);
      double weight = 0.0;
      for (int k = 0; k < 3; k++) weight += w.index[k] == i ? w.weight[k] : 0.0f;
      assert_true(weight == 1.0);
    }
    for (int i = 0; i < 5000; i++) {
      float q[3];
      random_direction(q);
      btf_interp w;
      btf_dirset_locate(set, q, &w);
      assert_valid(&w, n);
      /* The nearest point of any segment between neighbours. */
      double at[2], expected[2] = {p[0][0], p[0][1]}, best = INFINITY;
      parabolic(q, at);
      for (uint32_t a = 0; a < n; a++) {
        for (uint32_t b = 0; b < n; b++) {
          double there[2];
          if (a == b) continue;
          const double away = nearest_on_segment(p[a], p[b], at, there);
          if (away < best) {
            best = away;
            memcpy(expected, there, sizeof there);
          }
        }
      }
      double got[2] = {0.0, 0.0};
      double span = 0.0;
      for (int k = 0; k < 3; k++) {
        for (int c = 0; c < 2; c++) got[c] += w.weight[k] * p[w.index[k]][c];
        span = fmax(span, hypot(p[w.index[k]][0] - p[w.index[0]][0], p[w.index[k]][1] - p[w.index[0]][1]));
      }
      /* Neighbours are 0.28 rad apart: interpolation must not skip any. Off the line by 2e-6 at most. */
      if (n > 2) assert_true(span < 0.25);
      assert_near(got[0], expected[0], 4e-6);
      assert_near(got[1], expected[1], 4e-6);
    }
    btf_dirset_release(set);
  }
  test_context_done(ctx, &memory);
}

/* Outside a straight side that is only straight up to rounding, all samples of the side take part. */
static void straight_sides_skip_no_sample(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set = half_set(ctx);
  uint8_t seen[19 * 8 + 1] = {0};
  for (int i = 0; i < 20000; i++) {
    float d[3];
    const double theta = 1.44 * (i / 20000.0), side = i % 2 ? 0.4 : 0.4 + M_PI;
    at_angles(theta, side, d);
    d[0] += (float)(0.05 * sin(0.4));
    d[1] -= (float)(0.05 * cos(0.4));
    btf_interp w;
    btf_dirset_locate(set, d, &w);
    for (int k = 0; k < 3; k++)
      if (w.weight[k] > 0.3f) seen[w.index[k]] = 1;
  }
  for (uint32_t ring = 0; ring < 8; ring++) {
    assert_true(seen[19 * ring]);
    assert_true(seen[19 * ring + 18]);
  }
  assert_true(seen[19 * 8]);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

/* Weights follow a set that is turned, ties of rings included: their diagonals depend on the order alone. */
static void turning_a_set_turns_the_result(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btfi_random_seed(&dice, 11);
  const char *const names[] = {"ubo81", "ubo151", "grid:10x5", "grid:16x8"};
  for (int s = 0; s < 4; s++) {
    btf_dirset *set = named(ctx, names[s]);
    const uint32_t n = btf_dirset_count(set);
    float turned[151][3];
    const double turn = 0.3 + s, c = cos(turn), si = sin(turn);
    for (uint32_t i = 0; i < n; i++) {
      const float *d = btf_dirset_directions(set) + 3 * i;
      turned[i][0] = (float)(c * d[0] - si * d[1]);
      turned[i][1] = (float)(si * d[0] + c * d[1]);
      turned[i][2] = d[2];
    }
    btf_dirset *other;
    assert_ok(btf_dirset_create(ctx, turned[0], n, &other));
    for (int i = 0; i < 20000; i++) {
      float d[3];
      random_direction(d);
      const float e[3] = {(float)(c * d[0] - si * d[1]), (float)(si * d[0] + c * d[1]), d[2]};
      btf_interp a, b;
      btf_dirset_locate(set, d, &a);
      btf_dirset_locate(other, e, &b);
      double weight[151] = {0.0};
      for (int k = 0; k < 3; k++) {
        weight[a.index[k]] += a.weight[k];
        weight[b.index[k]] -= b.weight[k];
      }
      /* Positions agree to 4e-7; triangles of these sets are at least 0.02 high. */
      for (int k = 0; k < 3; k++) {
        assert_near(weight[a.index[k]], 0.0, 4e-5);
        assert_near(weight[b.index[k]], 0.0, 4e-5);
      }
    }
    btf_dirset_release(other);
    btf_dirset_release(set);
  }
  test_context_done(ctx, &memory);
}

static void large_sets(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btfi_random_seed(&dice, 5);
  enum { N = 65536 };
  float(*d)[3] = malloc(N * sizeof *d);
  /* A spiral is spread evenly; then a single ring just above the horizon, the worst for rasters and ties. */
  for (int kind = 0; kind < 2; kind++) {
    for (uint32_t i = 0; i < N; i++)
      if (kind == 0)
        at_angles(acos(1.0 - (i + 0.5) / N), 2.399963229728653 * i, d[i]);
      else
        at_angles(i < 55000 ? 1.5 : 0.7, 2.0 * M_PI * i / (i < 55000 ? 55000 : N - 55000), d[i]);
    const int64_t start = btfi_now_ns();
    btf_dirset *set;
    assert_ok(btf_dirset_create(ctx, d[0], N, &set));
    const double seconds = (double)(btfi_now_ns() - start) * 1e-9;
    uint64_t peak;
    btf_context_memory(ctx, NULL, &peak);
    uint32_t triangles;
    btf_dirset_triangles(set, &triangles);
    print_message("65536 directions: %u triangles in %.2f s, peak %.1f MiB\n", triangles, seconds,
                  (double)peak / 1048576.0);
    plane_set s = plane_of(set);
    assert_int_equal(triangles, 2 * N - 2 - s.rim);
    double area = 0.0;
    for (uint32_t i = 0; i < triangles; i++) {
      const double a = cross(s.p[s.t[3 * i]], s.p[s.t[3 * i + 1]], s.p[s.t[3 * i + 2]]);
      /* Samples are rounded by 2e-7 here and there; thin triangles of the ring may look turned by that much.
       */
      assert_true(a > -8.0 * PARABOLIC_ERROR);
      area += a;
    }
    assert_near(0.5 * area, kind == 0 ? M_PI : M_PI * pow(tan(0.75), 2), 2e-2);
    for (uint32_t i = 0; i < N; i += 7) {
      btf_interp w;
      btf_dirset_locate(set, d[i], &w);
      for (int k = 0; k < 3; k++)
        assert_true(w.weight[k] == (w.index[k] == i && w.weight[k] > 0 ? 1.0f : 0.0f));
    }
    for (int i = 0; i < 100000; i++) {
      float q[3];
      random_direction(q);
      btf_interp w;
      btf_dirset_locate(set, q, &w);
      assert_valid(&w, N);
      double at[2], got[2];
      parabolic(q, at);
      interpolated(&s, &w, got);
      const double limit = kind == 0 ? 0.99 : 0.999 * tan(0.75);
      if (hypot(at[0], at[1]) < limit) {
        assert_near(got[0], at[0], 1e-6);
        assert_near(got[1], at[1], 1e-6);
      }
    }
    plane_done(&s);
    btf_dirset_release(set);
  }
  free(d);
  test_context_done(ctx, &memory);
}

/* Every allocation in turn fails: the right status, no set, no leak. */
static void failing_memory_leaves_nothing(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  const char *const names[] = {"ubo151", "grid:1x9", "grid:10x5"};
  for (int s = 0; s < 3; s++) {
    const long before = memory.live_blocks;
    long failures = 0;
    for (long n = 1;; n++) {
      btf_dirset *set = NULL;
      memory.fail_at = memory.total_allocations + n;
      const btf_status status = btf_dirset_create_named(ctx, names[s], &set);
      const bool reached = memory.total_allocations >= memory.fail_at;
      memory.fail_at = 0;
      if (!reached) {
        assert_ok(status);
        btf_dirset_release(set);
        break;
      }
      assert_status(status, BTF_E_NOMEM);
      assert_null(set);
      assert_int_equal(memory.live_blocks, before);
      failures++;
    }
    assert_true(failures > 8);
    assert_int_equal(memory.live_blocks, before);
  }
  test_context_done(ctx, &memory);
}

static void parabolic_maps(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btfi_random_seed(&dice, 9);
  for (int i = 0; i < 100000; i++) {
    float d[3], back[3];
    double p[2];
    random_direction(d);
    parabolic(d, p);
    btfi_parabolic_direction((float)p[0], (float)p[1], back);
    /* dz is 4 |p| / (1 + p^2)^2 at most 1.3 times the rounding of p. */
    for (int k = 0; k < 3; k++) assert_near(back[k], d[k], 2e-7);
  }
  float d[3];
  btfi_parabolic_direction(3.0f, -4.0f, d);
  assert_near(d[0], 0.6, 1e-7);
  assert_near(d[1], -0.8, 1e-7);
  assert_true(d[2] == 0.0f);
  btfi_parabolic_texel(32, 16, 16, d); /* p = (1/32, 1/32) */
  assert_near(d[0], (2.0 / 32) / (1 + 2.0 / 1024), 1e-7);
  assert_near(d[2], (1 - 2.0 / 1024) / (1 + 2.0 / 1024), 1e-7);
  enum { SIZE = 32 };
  static btf_interp map[SIZE * SIZE];
  btf_dirset *set = named(ctx, "ubo81");
  btfi_dirset_rasterise(set, SIZE, map);
  for (uint32_t i = 0; i < SIZE * SIZE; i++) {
    btf_interp w;
    btfi_parabolic_texel(SIZE, i % SIZE, i / SIZE, d);
    btf_dirset_locate(set, d, &w);
    assert_memory_equal(&w, &map[i], sizeof w);
    assert_valid(&w, 81);
  }
  /* The corner holds what the horizon at 45 degrees does: the ring at 75 degrees, between 45 - 15 and 45
   * + 15. */
  for (int k = 0; k < 3; k++)
    if (map[SIZE * SIZE - 1].weight[k] > 0.0f) assert_int_equal(map[SIZE * SIZE - 1].index[k], 57 + 3);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(built_in_sets),
      cmocka_unit_test(bad_sets_are_refused),
      cmocka_unit_test(repeats_are_samples_without_a_place),
      cmocka_unit_test(directions_keep_their_floats),
      cmocka_unit_test(locate_is_total),
      cmocka_unit_test(sets_on_a_line),
      cmocka_unit_test(straight_sides_skip_no_sample),
      cmocka_unit_test(turning_a_set_turns_the_result),
      cmocka_unit_test(large_sets),
      cmocka_unit_test(failing_memory_leaves_nothing),
      cmocka_unit_test(parabolic_maps),
  };
  return btf_run("direction_sets", tests);
}
