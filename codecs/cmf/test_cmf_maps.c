/* SPDX-License-Identifier: MIT */
/* Maps of the hemisphere hold every direction once, and the half-difference frame and the pairs of
 * projections can be turned back. */
#include <btf/btf_codec.h>

#include "btf_test.h"

#include "factor.h"

static uint64_t random_state = 1;

static float draw(void) {
  return (float)btf_random_unit(&random_state);
}

static void draw_direction(float d[3]) {
  const double z = (double)draw(), phi = 6.283185307179586 * (double)draw(), r = sqrt(1.0 - z * z);
  d[0] = (float)(r * cos(phi));
  d[1] = (float)(r * sin(phi));
  d[2] = (float)z;
}

static double distance(const float a[3], const float b[3]) {
  double sum = 0.0;
  for (int i = 0; i < 3; i++) sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
  return sqrt(sum);
}

/* ---- maps: PAR01, PAR07 ---- */

static void test_maps_are_bijections(void **unused) {
  (void)unused;
  for (int n = 0; n < 20000; n++) {
    float d[3], back[3], ab[2], again[2];
    draw_direction(d);
    btfi_cmf_parabolic(d, ab);
    assert_true(ab[0] * ab[0] + ab[1] * ab[1] <= 1.0f + 1e-6f);
    btfi_cmf_from_parabolic(ab, back);
    assert_near(distance(d, back), 0.0, 1e-6);
    btfi_cmf_cube(d, ab);
    assert_true(fmaxf(fabsf(ab[0]), fabsf(ab[1])) <= 1.0f);
    assert_true(fminf(fabsf(ab[0]), fabsf(ab[1])) <= 0.5f * CMF_CUBE_BIAS);
    btfi_cmf_from_cube(ab, back);
    assert_near(distance(d, back), 0.0, 1e-6);
    /* Every place of the cross is that of one direction. */
    const float place[2] = {2.0f * draw() - 1.0f, draw() - 0.5f};
    for (int k = 0; k < 2; k++) {
      const float here[2] = {place[k], place[1 - k]};
      btfi_cmf_from_cube(here, d);
      btfi_cmf_cube(d, again);
      assert_near(here[0], again[0], 1e-6);
      assert_near(here[1], again[1], 1e-6);
    }
  }
  /* Over the edge of the top and over the horizon nothing jumps. */
  float above[2], below[2];
  btfi_cmf_cube((const float[]){0.6f, 0.1f, 0.6000001f}, above);
  btfi_cmf_cube((const float[]){0.6f, 0.1f, 0.5999999f}, below);
  assert_near(above[0], below[0], 1e-6);
  assert_near(above[1], below[1], 1e-6);
  /* Beside a diagonal the side is that of x, whichever way a direction was rounded. */
  btfi_cmf_cube((const float[]){0.6f, 0.6000002f, 0.5f}, above);
  btfi_cmf_cube((const float[]){0.6000002f, 0.6f, 0.5f}, below);
  assert_near(above[0], below[0], 1e-6);
  assert_near(above[1], below[1], 1e-6);
  const float strange[][3] = {{NAN, 0, 1}, {INFINITY, 0, 1}, {0, 0, -1}, {1e38f, -1e38f, 0}, {0, 0, 0}};
  for (size_t i = 0; i < 5; i++) {
    btfi_cmf_tap tap;
    for (uint32_t kind = 0; kind < CMF_MAP_KINDS; kind++) {
      const btfi_cmf_map map = btfi_cmf_map_of(kind, 9);
      btfi_cmf_map_locate(&map, strange[i], &tap);
      for (int k = 0; k < 4; k++) assert_true(tap.index[k] < btfi_cmf_map_texels(&map));
    }
  }
}

/* Texel centres are looked up as themselves, weights sum to 1, and solid angles to the hemisphere's. */
static void test_maps(void **unused) {
  (void)unused;
  for (uint32_t kind = 0; kind < CMF_MAP_KINDS; kind++)
    for (uint32_t edge = 4; edge <= 33; edge += 7) {
      const btfi_cmf_map map = btfi_cmf_map_of(kind, edge);
      double sphere = 0.0;
      for (uint32_t i = 0; i < btfi_cmf_map_texels(&map); i++) {
        float d[3];
        btfi_cmf_tap tap;
        sphere += btfi_cmf_map_solid_angle(&map, i);
        if (!btfi_cmf_map_direction(&map, i, d)) continue;
        btfi_cmf_map_locate(&map, d, &tap);
        double itself = 0.0, sum = 0.0;
        for (int k = 0; k < 4; k++) {
          itself += tap.index[k] == i ? (double)tap.weight[k] : 0.0;
          sum += (double)tap.weight[k];
        }
        /* Directions are floats: 1e-7 of the map's side, in texels, on each axis. */
        assert_near(itself, 1.0, 4e-7 * edge);
        assert_near(sum, 1.0, 3e-7);
      }
      /* Midpoint rule and the jagged rim: one texel's width around the horizon, where a texel is (2 /
       * edge)^2. */
      assert_near(sphere, 6.283185307, kind == CMF_ANGULAR ? 1e-6 : 6.2832 * 2.0 / edge);
    }
}

/* No lookup of the hemisphere reads a texel that is said not to be read; all others are read by one. */
static void test_texels_that_are_read(void **unused) {
  (void)unused;
  for (uint32_t kind = 0; kind < CMF_MAP_KINDS; kind++)
    for (uint32_t edge = 5; edge <= 16; edge += 11) {
      const btfi_cmf_map map = btfi_cmf_map_of(kind, edge), fine = btfi_cmf_map_of(kind, 64 * edge);
      unsigned char is_read[256] = {0};
      for (uint32_t i = 0; i < btfi_cmf_map_texels(&fine); i++) {
        float d[3];
        btfi_cmf_tap tap;
        (void)btfi_cmf_map_direction(&fine, i, d); /* directions of the horizon beyond the circle */
        btfi_cmf_map_locate(&map, d, &tap);
        for (int k = 0; k < 4; k++) is_read[tap.index[k]] |= tap.weight[k] > 0.0f;
      }
      for (uint32_t i = 0; i < btfi_cmf_map_texels(&map); i++)
        assert_int_equal(btfi_cmf_map_reads(&map, i), is_read[i]);
    }
}

/* Texels outside the circle hold the value of the nearest one within, by brute force; never 0. */
static void test_corners_are_extrapolated(void **unused) {
  (void)unused;
  for (uint32_t kind = 0; kind < CMF_MAP_KINDS; kind++) {
    const btfi_cmf_map map = btfi_cmf_map_of(kind, 16);
    const uint32_t n = btfi_cmf_map_texels(&map);
    unsigned char known[256];
    uint32_t source[256];
    for (uint32_t i = 0; i < n; i++) {
      float d[3];
      known[i] = btfi_cmf_map_direction(&map, i, d) && (kind == CMF_PARABOLIC || i % 5 == 0);
    }
    assert_true(btfi_cmf_map_sources(&map, known, source));
    for (uint32_t i = 0; i < n; i++) {
      int best = 1 << 30;
      int to_source = 0;
      for (uint32_t j = 0; j < n; j++) {
        int dx = abs((int)(i % map.width) - (int)(j % map.width));
        const int dy = abs((int)(i / map.width) - (int)(j / map.width));
        if (kind == CMF_ANGULAR && dx > (int)map.width / 2) dx = (int)map.width - dx;
        if (j == source[i]) to_source = dx * dx + dy * dy;
        if (known[j] && dx * dx + dy * dy < best) best = dx * dx + dy * dy;
      }
      assert_true(known[source[i]]);
      assert_int_equal(to_source, best);
    }
    memset(known, 0, sizeof known);
    assert_false(btfi_cmf_map_sources(&map, known, source));
  }
}

/* ---- directions: PAR02, PAR03 ---- */

static void test_half_difference(void **unused) {
  (void)unused;
  for (int n = 0; n < 20000; n++) {
    float l[3], v[3], h[3], d[3], h2[3], l2[3], v2[3];
    draw_direction(l);
    draw_direction(v);
    if (n % 4 == 0) memcpy(v, (const float[]){-l[0], -l[1], l[2]}, sizeof v); /* h = N */
    if (n % 16 == 1) memcpy(v, l, sizeof v);                                  /* d = N */
    if (l[2] < 1e-3f || v[2] < 1e-3f) continue;
    btfi_cmf_half(l, v, h);
    btfi_cmf_half(v, l, h2);
    assert_memory_equal(h, h2, sizeof h);
    btfi_cmf_to_hd(l, v, h, d);
    if (n % 4 == 0) assert_near(h[2], 1.0, 1e-6);
    assert_true(btfi_cmf_from_hd(h, d, l2, v2));
    assert_near(distance(l, l2), 0.0, 1e-6);
    assert_near(distance(v, v2), 0.0, 1e-6);
    /* The other way round the difference vector turns by half a turn. */
    float d2[3];
    btfi_cmf_to_hd(v, l, h, d2);
    assert_near(distance(d2, (const float[]){-d[0], -d[1], d[2]}), 0.0, 1e-6);
  }
  /* Half vectors toward the tangent: the frame stays orthonormal. */
  const float steep[][3] = {{1, 0, 0}, {-1, 0, 0}, {0.9999999f, 0, 4e-4f}, {0.6f, 0, 0.8f}};
  for (size_t i = 0; i < 4; i++) {
    float x[3], y[3];
    btfi_cmf_frame(steep[i], x, y);
    assert_near(distance(x, y), sqrt(2.0), 1e-6);
    assert_near(distance(x, steep[i]), sqrt(2.0), 1e-6);
  }
  float l[3], v[3];
  const float up[3] = {0, 0, 1}, low[3] = {0.999f, 0, 0.0447f}, grazing[3] = {0.8f, 0, 0.6f};
  assert_false(btfi_cmf_from_hd(low, grazing, l, v));
  assert_true(btfi_cmf_from_hd(up, grazing, l, v));
}

/* Every built-in pair of projections is inverted by its own inverse; PAR04, PAR05. */
static void test_pairs(void **unused) {
  (void)unused;
  const char *const names[] = {"io", "oi", "ih", "oh", "hd", "dh"};
  for (size_t i = 0; i < 6; i++) {
    const btfi_cmf_pair *pair = btfi_cmf_pair_of(names[i], 2);
    assert_non_null(pair);
    for (int n = 0; n < 2000; n++) {
      float l[3], v[3], l2[3], v2[3], first[3], second[3], stored[3];
      draw_direction(l);
      draw_direction(v);
      if (l[2] < 0.05f || v[2] < 0.05f) continue;
      pair->project(l, v, first, second);
      assert_true(pair->invert(first, second, l2, v2));
      assert_near(distance(l, l2), 0.0, 1e-6);
      assert_near(distance(v, v2), 0.0, 1e-6);
      btfi_cmf_project(pair->projection[0], l, v, stored);
      assert_near(distance(stored, first), 0.0, 1e-7);
      btfi_cmf_project(pair->projection[1], l, v, stored);
      assert_near(distance(stored, second), 0.0, 1e-7);
    }
  }
  assert_null(btfi_cmf_pair_of("id", 2));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_maps_are_bijections),  cmocka_unit_test(test_maps),
      cmocka_unit_test(test_texels_that_are_read), cmocka_unit_test(test_corners_are_extrapolated),
      cmocka_unit_test(test_half_difference),      cmocka_unit_test(test_pairs),
  };
  return btf_run("cmf_maps", tests);
}
