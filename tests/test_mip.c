/* SPDX-License-Identifier: MIT */
/* Mip levels against the integral over each texel's area, and the sampling rule. */
#include "btf_test.h"

#include "dataset/dataset.h"
#include <btf/btf_sampling.h>

static const uint32_t sizes[][2] = {{1, 1},  {2, 1},   {1, 5},   {4, 4},   {3, 7},
                                    {5, 16}, {17, 31}, {33, 12}, {64, 48}, {100, 3}};

static uint32_t next_random(uint64_t *state) {
  *state = *state * 6364136223846793005u + 1442695040888963407u;
  return (uint32_t)(*state >> 33);
}

static double overlap(double a0, double a1, double b0, double b1) {
  const double low = a0 > b0 ? a0 : b0, high = a1 < b1 ? a1 : b1;
  return high > low ? high - low : 0.0;
}

/* Average of the finest texels over a rectangle, every texel weighed by the area they share. */
static double area_mean(const float *src, size_t ld, uint32_t w, uint32_t h, uint32_t c, double x0, double x1,
                        double y0, double y1) {
  double sum = 0.0;
  for (uint32_t y = 0; y < h; ++y)
    for (uint32_t x = 0; x < w; ++x)
      sum += overlap(x, x + 1.0, x0, x1) * overlap(y, y + 1.0, y0, y1) *
             (double)src[((size_t)y * w + x) * ld + c];
  return sum / ((x1 - x0) * (y1 - y0));
}

static void levels_are_area_averages(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  static const uint32_t components[] = {1, 3, 32, 45};
  uint64_t random = 1;
  for (size_t k = 0; k < sizeof sizes / sizeof sizes[0]; ++k)
    for (size_t n = 0; n < sizeof components / sizeof components[0]; ++n) {
      const uint32_t w = sizes[k][0], h = sizes[k][1], count = components[n];
      const size_t src_ld = count + 2, dst_ld = count + 5;
      float *src = malloc((size_t)w * h * src_ld * sizeof *src),
            *dst = malloc((size_t)w * h * dst_ld * sizeof *dst);
      for (size_t i = 0; i < (size_t)w * h * src_ld; ++i)
        src[i] = (float)(next_random(&random) % 2001) / 1000.0f - 1.0f;
      for (uint32_t level = 0; level < btfi_mip_count(w, h); ++level) {
        const uint32_t lw = w >> level ? w >> level : 1, lh = h >> level ? h >> level : 1;
        for (size_t i = 0; i < (size_t)w * h * dst_ld; ++i) dst[i] = -77.0f;
        assert_ok(btfi_mip_filter(ctx, src, src_ld, w, h, count, level, dst, dst_ld));
        for (uint32_t y = 0; y < lh; ++y)
          for (uint32_t x = 0; x < lw; ++x)
            for (uint32_t c = 0; c < dst_ld; ++c) {
              const float got = dst[((size_t)y * lw + x) * dst_ld + c];
              if (c >= count)
                assert_true(got == -77.0f);
              else if (c < 3 || c == count - 1) /* one rounding to float of a value below 1 */
                assert_near(got,
                            area_mean(src, src_ld, w, h, c, (double)x * w / lw, (x + 1.0) * w / lw,
                                      (double)y * h / lh, (y + 1.0) * h / lh),
                            6.1e-8);
            }
      }
      free(src);
      free(dst);
    }
  test_context_done(ctx, &memory);
}

static void means_are_preserved(void **state) {
  (void)state;
  enum { w = 200, h = 130 };
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  float *src = malloc(w * h * sizeof *src), *dst = malloc(w * h * sizeof *dst);
  uint64_t random = 9;
  double mean = 0.0;
  for (int i = 0; i < w * h; ++i) mean += (double)(src[i] = (float)(next_random(&random) % 1000) * 0.37f);
  mean /= w * h;
  for (uint32_t level = 0; level < btfi_mip_count(w, h); ++level) {
    assert_ok(btfi_mip_filter(ctx, src, 1, w, h, 1, level, dst, 1));
    const uint32_t count = btf_sampling_level_size(w, level) * btf_sampling_level_size(h, level);
    double level_mean = 0.0;
    for (uint32_t i = 0; i < count; ++i) level_mean += (double)dst[i];
    /* Each texel is rounded to float once: relative 2^-24. */
    assert_relative(level_mean / count, mean, 6e-8);
  }
  assert_status(btfi_mip_filter(ctx, src, 0, w, h, 1, 1, dst, 1), BTF_E_INVALID_ARG);
  assert_status(btfi_mip_filter(ctx, src, 1, 0, h, 1, 1, dst, 1), BTF_E_INVALID_ARG);
  free(src);
  free(dst);
  test_context_done(ctx, &memory);
}

static void spans_cover_the_axis_once(void **state) {
  (void)state;
  for (uint32_t size = 1; size < 300; ++size)
    for (uint32_t level = 0; level < 9; ++level) {
      const uint32_t n = btf_sampling_level_size(size, level);
      double *cover = calloc(size, sizeof *cover);
      for (uint32_t i = 0; i < n; ++i) {
        btfi_mip_span span;
        btfi_mip_span_of(size, n, i, &span);
        double total = 0.0;
        assert_true(span.count >= 1 && span.first + span.count <= size);
        for (uint32_t k = 0; k < span.count; ++k) {
          assert_true(btfi_mip_weight(&span, k) > 0.0 && btfi_mip_weight(&span, k) <= 1.0);
          cover[span.first + k] += btfi_mip_weight(&span, k);
          total += btfi_mip_weight(&span, k);
        }
        assert_near(total, (double)size / n, 1e-12 * size);
      }
      for (uint32_t k = 0; k < size; ++k) assert_near(cover[k], 1.0, 1e-12);
      free(cover);
    }
  assert_int_equal(btfi_mip_count(1, 1), 1);
  assert_int_equal(btfi_mip_count(256, 256), 9);
  assert_int_equal(btfi_mip_count(255, 3), 8);
  assert_int_equal(btfi_mip_count(1, 65536), 17);
}

/* ---- the sampling rule ---- */

static void texel_centres_are_hit_exactly(void **state) {
  (void)state;
  for (uint32_t size = 1; size < 2000; ++size)
    for (uint32_t i = 0; i < size; ++i)
      for (uint32_t wrap = 0; wrap < 2; ++wrap) {
        uint32_t index[2];
        float weight[2];
        const float u = (float)(((double)i + 0.5) / size);
        btf_sampling_linear(u, size, wrap, index, weight);
        assert_true(index[0] == i && weight[0] == 1.0f && weight[1] == 0.0f);
        assert_int_equal(btf_sampling_nearest(u, size, wrap), i);
      }
}

/* A value that depends on the index in a way nothing else does. */
static double texture(uint32_t i) {
  return (double)(i * 2654435761u % 1009u);
}

static double reference(double u, uint32_t size, uint32_t wrap) {
  if (wrap == BTF_WRAP_CLAMP) u = u < 0.0 ? 0.0 : u > 1.0 ? 1.0 : u;
  const double p = u * size - 0.5, below = floor(p);
  double value = 0.0;
  for (int k = 0; k < 2; ++k) {
    double i = below + k;
    if (wrap == BTF_WRAP_CLAMP)
      i = i < 0.0 ? 0.0 : i > size - 1.0 ? size - 1.0 : i;
    else
      i -= floor(i / size) * size;
    value += (k ? p - below : 1.0 - (p - below)) * texture((uint32_t)i);
  }
  return value;
}

static void positions_are_interpolated_between_centres(void **state) {
  (void)state;
  uint64_t random = 3;
  for (int trial = 0; trial < 200000; ++trial) {
    const uint32_t size = 1 + next_random(&random) % (trial % 2 ? 7 : 3000), wrap = next_random(&random) % 2;
    const float u = ((float)next_random(&random) / 2147483648.0f - 0.5f) * (trial % 3 ? 1.5f : 20.0f);
    uint32_t index[2];
    float weight[2];
    btf_sampling_linear(u, size, wrap, index, weight);
    assert_true(index[0] < size && index[1] < size);
    assert_true(weight[0] >= 0.0f && weight[1] >= 0.0f && weight[0] + weight[1] == 1.0f);
    /* A float weight, and distances of size / 2^24 texels that count as 0, between values below 1009. */
    assert_near((double)weight[0] * texture(index[0]) + (double)weight[1] * texture(index[1]),
                reference(u, size, wrap), 1009.0 * (size / 16777216.0 + 6e-8));
  }
}

static void hostile_positions_and_levels_are_safe(void **state) {
  (void)state;
  static const float hostile[] = {NAN,         -NAN,        INFINITY,    -INFINITY,   1e38f,
                                  -1e38f,      16777216.0f, 16777215.0f, -16777215.f, 4294967296.f,
                                  0.0f,        -0.0f,       1e-45f,      -1e-45f,     -1e-9f,
                                  0.99999994f, 1.0f,        -1.0f,       -0.5f,       1.0000001f};
  for (size_t k = 0; k < sizeof hostile / sizeof hostile[0]; ++k) {
    for (uint32_t size = 1; size <= 1u << 24; size = size * 3 + 1)
      for (uint32_t wrap = 0; wrap < 3; ++wrap) {
        btf_bilinear b;
        btf_sampling_bilinear(hostile[k], hostile[k], size, size, wrap, &b);
        assert_true(b.x[0] < size && b.x[1] < size && b.y[0] == b.x[0] && b.y[1] == b.x[1]);
        assert_true(b.wx[0] >= 0.0f && b.wx[1] >= 0.0f && b.wx[0] + b.wx[1] == 1.0f);
        assert_true(btf_sampling_nearest(hostile[k], size, wrap) < size);
      }
    for (uint32_t levels = 0; levels < 20; ++levels) {
      btf_level_pair pair;
      const uint32_t last = levels > 1 ? levels - 1 : 0;
      btf_sampling_levels(hostile[k], levels, &pair);
      assert_true(pair.level[0] <= last && pair.level[1] <= last);
      assert_true(pair.weight[0] >= 0.0f && pair.weight[1] >= 0.0f &&
                  pair.weight[0] + pair.weight[1] == 1.0f);
      assert_true(btf_sampling_nearest_level(hostile[k], levels) <= last);
    }
  }
  btf_level_pair pair;
  btf_sampling_levels(2.25f, 5, &pair);
  assert_true(pair.level[0] == 2 && pair.level[1] == 3 && pair.weight[1] == 0.25f);
  btf_sampling_levels(9.0f, 5, &pair);
  assert_true(pair.level[0] == 4 && pair.weight[0] == 1.0f);
  assert_int_equal(btf_sampling_nearest_level(2.4f, 5), 2);
  assert_int_equal(btf_sampling_nearest_level(2.5f, 5), 3);
  assert_int_equal(btf_sampling_level_size(5, 40), 1);
}

/* Weight of a texel of a level in a set, and of the two rules that the set stands for. */
static double weight_in_set(const btf_texel_set *set, uint32_t level, uint32_t x, uint32_t y) {
  double sum = 0.0;
  for (uint32_t i = 0; i < set->count; ++i)
    if (set->level[i] == level && set->x[i] == x && set->y[i] == y) sum += (double)set->weight[i];
  return sum;
}

static double weight_by_rule(const float uv[2], float lod, uint32_t width, uint32_t height, uint32_t wrap,
                             uint32_t levels, uint32_t level, uint32_t x, uint32_t y) {
  btf_level_pair pair;
  double sum = 0.0;
  btf_sampling_levels(lod, levels, &pair);
  for (int k = 0; k < 2; ++k) {
    btf_bilinear b;
    if (pair.level[k] != level) continue;
    btf_sampling_bilinear(uv[0], uv[1], btf_sampling_level_size(width, level),
                          btf_sampling_level_size(height, level), wrap, &b);
    for (int j = 0; j < 2; ++j)
      for (int i = 0; i < 2; ++i)
        if (b.x[i] == x && b.y[j] == y) sum += (double)pair.weight[k] * (double)b.wx[i] * (double)b.wy[j];
  }
  return sum;
}

static void texel_sets_are_levels_times_bilinear(void **state) {
  (void)state;
  static const float hostile[] = {NAN, INFINITY, -INFINITY, 1e38f, -1e38f, 1.0f, -0.0f, 0.5f};
  uint64_t random = 11;
  for (int trial = 0; trial < 20000; ++trial) {
    const uint32_t width = 1 + next_random(&random) % 9, height = 1 + next_random(&random) % 9;
    const uint32_t wrap = next_random(&random) % 2, nearest = trial % 5 == 0;
    const uint32_t levels = 1 + next_random(&random) % btfi_mip_count(width, height);
    float uv[2], lod = (float)(next_random(&random) % 800) / 100.0f - 2.0f;
    for (int k = 0; k < 2; ++k)
      uv[k] = next_random(&random) % 10 == 0 ? hostile[next_random(&random) % 8]
                                             : (float)next_random(&random) / 1e9f - 1.0f;
    if (next_random(&random) % 10 == 0) lod = hostile[next_random(&random) % 8];
    if (next_random(&random) % 4 == 0) lod = floorf(lod);
    btf_texel_set set;
    double total = 0.0;
    btf_sampling_texels(uv, lod, (int)nearest, width, height, wrap, levels, &set);
    assert_in_range(set.count, 1, nearest ? 1 : 8);
    for (uint32_t i = 0; i < set.count; ++i) {
      assert_true(set.level[i] < levels && set.weight[i] > 0.0f);
      assert_true(set.x[i] < btf_sampling_level_size(width, set.level[i]));
      assert_true(set.y[i] < btf_sampling_level_size(height, set.level[i]));
      total += (double)set.weight[i];
    }
    assert_near(total, 1.0, 8 * 6e-8); /* each weight is rounded */
    if (nearest) {
      assert_int_equal(set.level[0], btf_sampling_nearest_level(lod, levels));
      assert_int_equal(set.x[0],
                       btf_sampling_nearest(uv[0], btf_sampling_level_size(width, set.level[0]), wrap));
      assert_int_equal(set.y[0],
                       btf_sampling_nearest(uv[1], btf_sampling_level_size(height, set.level[0]), wrap));
      continue;
    }
    for (uint32_t level = 0; level < levels; ++level)
      for (uint32_t y = 0; y < btf_sampling_level_size(height, level); ++y)
        for (uint32_t x = 0; x < btf_sampling_level_size(width, level); ++x)
          /* Up to four entries fall on one texel; each has two products rounded. */
          assert_near(weight_in_set(&set, level, x, y),
                      weight_by_rule(uv, lod, width, height, wrap, levels, level, x, y), 4 * 2 * 6e-8);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(levels_are_area_averages),
      cmocka_unit_test(means_are_preserved),
      cmocka_unit_test(spans_cover_the_axis_once),
      cmocka_unit_test(texel_centres_are_hit_exactly),
      cmocka_unit_test(positions_are_interpolated_between_centres),
      cmocka_unit_test(hostile_positions_and_levels_are_safe),
      cmocka_unit_test(texel_sets_are_levels_times_bilinear),
  };
  return btf_run("mip", tests);
}
