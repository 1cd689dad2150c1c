/* SPDX-License-Identifier: MIT */
/* Homomorphic factorisation against planted maps and LAPACK's least squares. */
#include "btf_test.h"

#include <float.h>
#include <time.h>

#include <lapacke.h>

#include "homomorphic.h"
#include "registry/registry.h"

static test_memory memory;

static double random_unit(uint64_t *state) {
  *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
  return (double)(*state >> 11) / 9007199254740992.0;
}

static double processor_seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* ---- sampling ---- */

typedef struct sampling {
  btfi_cmf_hf_geometry g;
  uint32_t *texel;
  float *weight;
  uint8_t *use_pair, *use_texel;
} sampling;

static void locate(const sampling *s, const double direction[3], uint32_t *texel, float *weight) {
  const double at[2] = {(direction[0] / (1.0 + direction[2]) + 1.0) / 2.0 * s->g.width - 0.5,
                        (direction[1] / (1.0 + direction[2]) + 1.0) / 2.0 * s->g.height - 0.5};
  const double x = fmin(fmax(at[0], 0.0), s->g.width - 1.0), y = fmin(fmax(at[1], 0.0), s->g.height - 1.0);
  const uint32_t x0 = (uint32_t)fmin(x, s->g.width - 2.0), y0 = (uint32_t)fmin(y, s->g.height - 2.0);
  for (uint32_t i = 0; i < 4; i++) {
    const uint32_t right = i % 2, down = i / 2;
    texel[i] = (y0 + down) * s->g.width + x0 + right;
    weight[i] = (float)((right ? x - x0 : 1.0 - (x - x0)) * (down ? y - y0 : 1.0 - (y - y0)));
  }
}

static void random_direction(uint64_t *seed, double direction[3]) {
  const double z = 0.05 + 0.95 * random_unit(seed), phi = 6.283185307 * random_unit(seed);
  direction[0] = sqrt(1.0 - z * z) * cos(phi);
  direction[1] = sqrt(1.0 - z * z) * sin(phi);
  direction[2] = z;
}

/* Maps of the light, the half vector and the view of random pairs. */
static sampling sampling_create(uint32_t pairs, uint32_t width, uint32_t height, uint64_t seed) {
  sampling s = {.g = {.pairs = pairs, .maps = 3, .width = width, .height = height}};
  s.texel = malloc(pairs * 12 * sizeof *s.texel);
  s.weight = malloc(pairs * 12 * sizeof *s.weight);
  s.use_pair = calloc(pairs, 1);
  s.use_texel = calloc(3 * width * height, 1);
  for (uint32_t p = 0; p < pairs; p++) {
    double light[3], view[3], half[3], length = 0.0;
    random_direction(&seed, light);
    random_direction(&seed, view);
    for (int i = 0; i < 3; i++) {
      half[i] = light[i] + view[i];
      length += half[i] * half[i];
    }
    for (int i = 0; i < 3; i++) half[i] /= sqrt(length);
    locate(&s, light, s.texel + p * 12, s.weight + p * 12);
    locate(&s, half, s.texel + p * 12 + 4, s.weight + p * 12 + 4);
    locate(&s, view, s.texel + p * 12 + 8, s.weight + p * 12 + 8);
  }
  s.g.texel = s.texel;
  s.g.weight = s.weight;
  return s;
}

static void sampling_release(sampling *s) {
  free(s->texel);
  free(s->weight);
  free(s->use_pair);
  free(s->use_texel);
}

static uint32_t texels_of(const sampling *s) {
  return s->g.maps * s->g.width * s->g.height;
}

static double predict(const sampling *s, const double *x, uint32_t pair) {
  double sum = 0.0;
  for (uint32_t i = 0; i < 12; i++)
    sum += (double)s->weight[pair * 12 + i] * x[i / 4 * s->g.width * s->g.height + s->texel[pair * 12 + i]];
  return sum;
}

static btfi_cmf_hf *create(btf_context *ctx, const sampling *s, double lambda) {
  btfi_cmf_hf *hf;
  assert_ok(btfi_cmf_hf_create(btfi_host(), ctx, &s->g, lambda, 0, &hf));
  return hf;
}

/* Logarithms of the maps of one channel. */
static void solve_one(btf_context *ctx, const btfi_cmf_hf *hf, const sampling *s, const float *f, double *x) {
  float *maps = malloc(texels_of(s) * sizeof *maps);
  assert_ok(btfi_cmf_hf_solve(btfi_host(), ctx, hf, 1, 1, f, 0, 1e-6, maps, 0));
  for (uint32_t i = 0; i < texels_of(s); i++) x[i] = log((double)maps[i]);
  free(maps);
}

/* ---- the stacked system, dense and by the book ---- */

typedef struct stacked {
  uint32_t rows, data_rows, columns;
  double *a; /* row-major: M; lambda L; equal means; ridge */
  double ridge;
} stacked;

static stacked stacked_create(const sampling *s, double lambda) {
  const uint32_t n = texels_of(s), map = s->g.width * s->g.height;
  stacked m = {.rows = s->g.pairs + n + 2 + n, .data_rows = s->g.pairs, .columns = n};
  double trace = 0.0;
  m.a = calloc((size_t)m.rows * n, sizeof *m.a);
  double *row = m.a;
  for (uint32_t p = 0; p < s->g.pairs; p++, row += n)
    for (uint32_t i = 0; i < 12; i++)
      row[i / 4 * map + s->texel[p * 12 + i]] += (double)s->weight[p * 12 + i];
  for (double *value = m.a; value < row; value++) trace += *value * *value;
  for (uint32_t i = 0; i < n; i++, row += n) {
    const uint32_t j = i % map, x = j % s->g.width, y = j / s->g.width, w = s->g.width;
    const int neighbour[4][2] = {{-1, 0}, {1, 0}, {0, -1}, {0, 1}};
    for (int k = 0; k < 4; k++) {
      int nx = (int)x + neighbour[k][0];
      const int ny = (int)y + neighbour[k][1];
      if (s->g.wrap) nx = (nx + (int)w) % (int)w;
      if (nx < 0 || nx >= (int)w || ny < 0 || ny >= (int)s->g.height) continue;
      row[i] += lambda;
      row[i - j + (uint32_t)ny * w + (uint32_t)nx] -= lambda;
    }
  }
  for (uint32_t k = 0; k < 2; k++, row += n) {
    for (uint32_t i = 0; i < map; i++) {
      row[k * map + i] = sqrt(trace) / map;
      row[(k + 1) * map + i] = -sqrt(trace) / map;
    }
  }
  m.ridge = 1e-9 * trace / n;
  for (uint32_t i = 0; i < n; i++, row += n) row[i] = sqrt(m.ridge);
  return m;
}

/* Eigenvalues of the normal matrix of rows 0 .. rows - 1, upwards. */
static double *normal_eigenvalues(const stacked *m, uint32_t rows) {
  const uint32_t n = m->columns;
  double *g = calloc((size_t)n * n, sizeof *g), *values = malloc(n * sizeof *values);
  for (uint32_t r = 0; r < rows; r++)
    for (uint32_t i = 0; i < n; i++)
      for (uint32_t j = 0; m->a[(size_t)r * n + i] != 0.0 && j < n; j++)
        g[i * n + j] += m->a[(size_t)r * n + i] * m->a[(size_t)r * n + j];
  assert_int_equal(LAPACKE_dsyev(LAPACK_ROW_MAJOR, 'N', 'L', (int)n, g, (int)n, values), 0);
  free(g);
  return values;
}

/* FAC03: the factored normal matrix and LAPACK's QR of the stacked system agree. The normal equations lose
 * n u kappa^2 |x| (Higham, Accuracy and Stability of Numerical Algorithms, 20.4), QR the square root of that
 * and u kappa^2 times the residual over |A|; maps are rounded to floats. */
static void test_least_squares(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint32_t wrap = 0; wrap < 2; wrap++) {
    sampling s = sampling_create(400, 7, 5 + 2 * wrap, 3 + wrap);
    s.g.wrap = wrap;
    const double lambda = wrap ? 0.5 : 0.1;
    const uint32_t n = texels_of(&s);
    stacked m = stacked_create(&s, lambda);
    double *values = normal_eigenvalues(&m, m.rows), *right = calloc(m.rows, sizeof *right), mean = 0.0;
    double *x = malloc(n * sizeof *x), largest = 0.0, worst = 0.0;
    float *f = malloc(s.g.pairs * sizeof *f);
    uint64_t seed = 17;
    for (uint32_t p = 0; p < s.g.pairs; p++) {
      f[p] = (float)exp(2.0 * random_unit(&seed) - 4.0);
      right[p] = log((double)f[p]);
      mean += right[p] / s.g.pairs;
    }
    for (uint32_t p = 0; p < s.g.pairs; p++) right[p] -= mean;
    btfi_cmf_hf *hf = create(ctx, &s, lambda);
    assert_int_equal(btfi_cmf_hf_unknowns(hf), n);
    solve_one(ctx, hf, &s, f, x);
    assert_int_equal(LAPACKE_dgels(LAPACK_ROW_MAJOR, 'N', (int)m.rows, (int)n, 1, m.a, (int)n, right, 1), 0);
    for (uint32_t i = 0; i < n; i++) largest = fmax(largest, fabs(right[i]));
    const double kappa_squared = values[n - 1] / values[0];
    const double tolerance = n * kappa_squared * DBL_EPSILON * largest + ldexp(1.0, -23);
    for (uint32_t i = 0; i < n; i++) worst = fmax(worst, fabs(x[i] - mean / 3.0 - right[i]));
    print_message("%u unknowns, kappa^2 %.2g: logarithms differ from dgels by %.2g (bound %.2g)\n", n,
                  kappa_squared, worst, tolerance);
    assert_true(tolerance < 1e-4);
    assert_true(worst <= tolerance);
    btfi_cmf_hf_free(btfi_host(), ctx, hf);
    free(m.a);
    free(values);
    free(right);
    free(x);
    free(f);
    sampling_release(&s);
  }
  test_context_done(ctx, &memory);
}

/* Smooth positive maps. */
static void plant(const sampling *s, uint64_t seed, double *x) {
  const uint32_t map = s->g.width * s->g.height;
  for (uint32_t j = 0; j < 3; j++) {
    const double a = random_unit(&seed), b = random_unit(&seed), c = random_unit(&seed);
    for (uint32_t i = 0; i < map; i++) {
      const double u = (double)(i % s->g.width) / s->g.width, v = (double)(i / s->g.width) / s->g.height;
      x[j * map + i] = a * sin(4.0 * u + 6.0 * b) + c * cos(5.0 * v + 3.0 * a * u) - 0.5 * j;
    }
  }
}

/* FAC03: a product of three maps is found again up to a factor of each map. With A = M^T M, the solution is
 * x* - (A + R)^-1 R (x* - mean) for R = lambda^2 L^T L + ridge, so its error is at most |R x*| over the least
 * eigenvalue of A that is not of the two free factors; rounding f to floats adds sqrt(pairs) 2^-24 over the
 * root of it, rounding maps 2^-24. */
static void test_planted_maps_are_found(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const double lambda = 1e-4;
  for (uint64_t seed = 1; seed <= 3; seed++) {
    sampling s = sampling_create(3000, 6, 6, seed);
    const uint32_t n = texels_of(&s);
    double x[108], found[108];
    float *f = malloc(s.g.pairs * sizeof *f);
    plant(&s, seed, x);
    for (uint32_t p = 0; p < s.g.pairs; p++) f[p] = (float)exp(predict(&s, x, p));
    stacked m = stacked_create(&s, lambda);
    double *values = normal_eigenvalues(&m, m.data_rows), pull[108] = {0}, square = 0.0;
    assert_true(values[1] < 1e-9 && values[2] > 0.001);
    for (uint32_t r = m.data_rows; r < m.data_rows + n; r++) {
      double product = 0.0;
      for (uint32_t i = 0; i < n; i++) product += m.a[r * n + i] * x[i];
      for (uint32_t i = 0; i < n; i++) pull[i] += m.a[r * n + i] * product;
    }
    for (uint32_t i = 0; i < n; i++) square += pow(fabs(pull[i]) + 2.0 * m.ridge * fabs(x[i]), 2);
    const double tolerance =
        sqrt(square) / values[2] + sqrt(3000.0 / values[2]) * ldexp(1.0, -24) + 2.0 * ldexp(1.0, -24);
    assert_true(tolerance < 1e-3);
    btfi_cmf_hf *hf = create(ctx, &s, lambda);
    solve_one(ctx, hf, &s, f, found);
    double worst = 0.0;
    for (uint32_t j = 0; j < 3; j++) {
      double shift = 0.0;
      for (uint32_t i = 36 * j; i < 36 * (j + 1); i++) shift += (found[i] - x[i]) / 36.0;
      for (uint32_t i = 36 * j; i < 36 * (j + 1); i++) worst = fmax(worst, fabs(found[i] - x[i] - shift));
    }
    print_message("planted maps found within %.2g (bound %.2g)\n", worst, tolerance);
    assert_true(worst <= 2.0 * tolerance); /* twice: the shift has the error as well */
    for (uint32_t p = 0; p < s.g.pairs; p++)
      assert_near(predict(&s, found, p), predict(&s, x, p), 3 * 2 * tolerance);
    btfi_cmf_hf_free(btfi_host(), ctx, hf);
    free(values);
    free(m.a);
    free(f);
    sampling_release(&s);
  }
  test_context_done(ctx, &memory);
}

/* FAC03: with growing lambda the error at the samples grows and the maps become smoother (a property of every
 * such least squares problem; the ridge may move both by 1e-9 of them, floats by 1e-7), while the error
 * between the samples of noisy data has its minimum inside. */
static void test_lambda_sweep(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  sampling s = sampling_create(700, 10, 10, 5), between = sampling_create(2000, 10, 10, 6);
  const uint32_t n = texels_of(&s);
  double x[300], found[300], before = 0.0, rough_before = INFINITY, least = INFINITY, errors[9];
  float *f = malloc(700 * sizeof *f);
  uint64_t seed = 99;
  plant(&s, 12, x);
  for (uint32_t p = 0; p < 700; p++) f[p] = (float)exp(predict(&s, x, p) + 0.6 * (random_unit(&seed) - 0.5));
  for (int step = 0; step < 9; step++) {
    const double lambda = 0.001 * pow(3.1622776601683795, step);
    btfi_cmf_hf *hf = create(ctx, &s, lambda);
    stacked m = stacked_create(&s, 1.0);
    double error = 0.0, rough = 0.0, other = 0.0;
    solve_one(ctx, hf, &s, f, found);
    for (uint32_t p = 0; p < 700; p++) error += pow(predict(&s, found, p) - log((double)f[p]), 2);
    for (uint32_t r = 700; r < 700 + n; r++) {
      double product = 0.0;
      for (uint32_t i = 0; i < n; i++) product += m.a[(size_t)r * n + i] * found[i];
      rough += product * product;
    }
    for (uint32_t p = 0; p < 2000; p++)
      other += pow(predict(&between, found, p) - predict(&between, x, p), 2);
    errors[step] = sqrt(other / 2000);
    print_message("lambda %7.3f: error of logarithms at samples %.4f, between them %.4f; Laplacian %.4f\n",
                  lambda, sqrt(error / 700), errors[step], sqrt(rough / n));
    assert_true(error >= before * (1.0 - 1e-6));
    assert_true(rough <= rough_before * (1.0 + 1e-6));
    before = error;
    rough_before = rough;
    least = fmin(least, errors[step]);
    btfi_cmf_hf_free(btfi_host(), ctx, hf);
    free(m.a);
  }
  assert_true(least < 0.8 * errors[0] && least < 0.8 * errors[8]);
  free(f);
  sampling_release(&s);
  sampling_release(&between);
  test_context_done(ctx, &memory);
}

/* FAC04: all texels with one factor give what each gives with its own, up to the order of sums (the error of
 * a triangular solve is at most n u kappa of L times |x|, here with the bound of test_least_squares). */
static void test_shared_factor(void **unused) {
  (void)unused;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  enum { texels = 24, channels = 3, pairs = 900 };
  sampling s = sampling_create(pairs, 12, 12, 8);
  const uint32_t n = texels_of(&s), map_values = n * channels;
  float *f = malloc(sizeof *f * texels * pairs * channels),
        *shared = malloc(sizeof *shared * texels * map_values), *alone = malloc(sizeof *alone * map_values);
  uint64_t seed = 1;
  for (uint32_t i = 0; i < texels * pairs * channels; i++) f[i] = (float)(0.1 + random_unit(&seed));
  btfi_cmf_hf *hf = create(ctx, &s, 0.3);
  assert_ok(btfi_cmf_hf_solve(btfi_host(), ctx, hf, texels, channels, f, pairs * channels, 1e-3, shared,
                              map_values));
  btfi_cmf_hf_free(btfi_host(), ctx, hf);
  for (uint32_t t = 0; t < texels; t++) {
    hf = create(ctx, &s, 0.3);
    assert_ok(
        btfi_cmf_hf_solve(btfi_host(), ctx, hf, 1, channels, f + t * pairs * channels, 0, 1e-3, alone, 0));
    for (uint32_t i = 0; i < map_values; i++)
      assert_relative(shared[t * map_values + i], alone[i],
                      1e-6); /* kappa^2 is below 1e4 at this lambda: 1e-9; floats */
    btfi_cmf_hf_free(btfi_host(), ctx, hf);
  }
  free(f);
  free(shared);
  free(alone);
  sampling_release(&s);
  test_context_done(ctx, &memory);
}

/* FAC04: the factor is worth sharing. With n unknowns it takes n^3 / 3 multiplications and a texel 2 n^2 a
 * channel, so that at the default edge, n = 3072, 4096 texels that share it take n^3 / 3 / (6 n^2) = 170
 * times less than with factors of their own, and at this n = 1728 96 times less, before all that is not
 * multiplication. A sixth of the 50 that are asked for must be there whatever else the machine does. */
static void test_shared_factor_pays(void **unused) {
  (void)unused;
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  enum { texels = 64, sharing = 4096, channels = 3, pairs = 2000 };
  sampling s = sampling_create(pairs, 24, 24, 8);
  const uint32_t map_values = texels_of(&s) * channels;
  float *f = malloc(sizeof *f * texels * pairs * channels),
        *maps = malloc(sizeof *maps * texels * map_values);
  uint64_t seed = 1;
  for (uint32_t i = 0; i < texels * pairs * channels; i++) f[i] = (float)(0.1 + random_unit(&seed));
  const double start = processor_seconds();
  btfi_cmf_hf *hf = create(ctx, &s, 0.3);
  const double made = processor_seconds();
  assert_int_equal(btfi_cmf_hf_unknowns(hf), 1728);
  assert_ok(
      btfi_cmf_hf_solve(btfi_host(), ctx, hf, texels, channels, f, pairs * channels, 1e-3, maps, map_values));
  const double solving = (processor_seconds() - made) / texels, making = made - start;
  const double factor = (making + solving) / (making / sharing + solving);
  print_message("1728 unknowns: factor %.3f s, a texel with it %.5f s of processor time: %.0f times less\n",
                making, solving, factor);
  assert_true(factor >= 50.0 / 6.0);
  btfi_cmf_hf_free(btfi_host(), ctx, hf);
  free(f);
  free(maps);
  sampling_release(&s);
  test_context_done(ctx, &memory);
}

/* T05: values below the floor count as it, wherever they come from; what is 0 throughout stays 0. */
static void test_floor(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  enum { pairs = 300, channels = 2 };
  sampling s = sampling_create(pairs, 6, 6, 21);
  const uint32_t n = texels_of(&s);
  float f[3][pairs * channels], raised[pairs * channels], maps[3][108 * channels], expected[108 * channels];
  uint64_t seed = 2;
  const float low[] = {0.0f, -1.0f, 1e-30f, -INFINITY, NAN, 0.00399f};
  float largest = 0.0f;
  for (uint32_t i = 0; i < pairs * channels; i++) {
    f[0][i] = (float)(4.0 * random_unit(&seed) + 0.1);
    largest = fmaxf(largest, f[0][i]);
  }
  f[0][10] = largest = 4.2f;
  memcpy(raised, f[0], sizeof raised);
  for (uint32_t i = 0; i < 6; i++) {
    f[0][50 + 31 * i] = low[i];
    raised[50 + 31 * i] = 0.001f * 4.2f;
  }
  for (uint32_t i = 0; i < pairs * channels; i++) {
    f[1][i] = i % 2 == 0 ? f[0][i] : i % 3 == 0 ? -2.0f : 0.0f; /* the second channel is nowhere positive */
    f[2][i] = 0.0f;
  }
  btfi_cmf_hf *hf = create(ctx, &s, 0.2);
  assert_ok(btfi_cmf_hf_solve(btfi_host(), ctx, hf, 1, channels, raised, 0, 1e-9, expected, 0));
  assert_ok(btfi_cmf_hf_solve(btfi_host(), ctx, hf, 3, channels, f[0], pairs * channels, 0.001, maps[0],
                              n * channels));
  for (uint32_t i = 0; i < n * channels; i++) {
    assert_relative(maps[0][i], expected[i],
                    1e-5); /* 0.001f * 4.2f and 0.001 * 4.2: 1e-7 in one of 300 rows */
    if (i % 2 == 0) assert_true(maps[1][i] > 0.0f && isfinite(maps[1][i]));
    if (i % 2 == 1) assert_true(maps[1][i] == 0.0f);
    assert_true(maps[2][i] == 0.0f);
  }
  f[0][0] = INFINITY;
  assert_ok(btfi_cmf_hf_solve(btfi_host(), ctx, hf, 1, channels, f[0], 0, 0.001, maps[0], 0));
  for (uint32_t i = 0; i < n * channels; i++) assert_true(maps[0][i] > 0.0f && isfinite(maps[0][i]));
  btfi_cmf_hf_free(btfi_host(), ctx, hf);
  sampling_release(&s);
  test_context_done(ctx, &memory);
}

/* A constant ABRDF has constant maps, its cube root, also where no pair falls; texels that are no unknowns
 * are 0. */
static void test_texels_without_data(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  sampling s = sampling_create(40, 16, 16, 31);
  const uint32_t n = texels_of(&s);
  float f[40], *maps = malloc(n * sizeof *maps);
  for (uint32_t p = 0; p < 40; p++) f[p] = 0.02f;
  for (uint32_t round = 0; round < 3; round++) {
    uint32_t unknowns = 0;
    s.g.use_texel = round == 0 ? NULL : s.use_texel; /* all; only those with data; and half of the others */
    for (uint32_t i = 0; i < n; i++) s.use_texel[i] = round == 2 && i % 16 < 8;
    btfi_cmf_hf *hf = create(ctx, &s, 0.05);
    assert_ok(btfi_cmf_hf_solve(btfi_host(), ctx, hf, 1, 1, f, 0, 1e-3, maps, 0));
    for (uint32_t i = 0; i < n; i++) {
      int expected = round == 0 || s.use_texel[i];
      for (uint32_t k = 0; k < 40 * 12; k++)
        expected |= s.weight[k] != 0.0f && k % 12 / 4 * 256 + s.texel[k] == i;
      unknowns += maps[i] != 0.0f;
      if (expected)
        assert_relative(maps[i], cbrt(0.02), 1e-6);
      else
        assert_true(maps[i] == 0.0f);
    }
    assert_int_equal(unknowns, btfi_cmf_hf_unknowns(hf));
    btfi_cmf_hf_free(btfi_host(), ctx, hf);
  }
  free(maps);
  sampling_release(&s);
  test_context_done(ctx, &memory);
}

/* Pairs that are left out do not count, whatever their values. */
static void test_pairs_left_out(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  sampling s = sampling_create(300, 6, 6, 41), few = sampling_create(200, 6, 6, 41); /* its first 200 pairs */
  float f[300], all[108], some[108];
  uint64_t seed = 6;
  for (uint32_t p = 0; p < 300; p++) {
    f[p] = p < 200 ? (float)(0.5 + random_unit(&seed)) : p % 2 ? NAN : 1e9f;
    s.use_pair[p] = p < 200;
  }
  s.g.use_pair = s.use_pair;
  btfi_cmf_hf *hf = create(ctx, &s, 0.1), *other = create(ctx, &few, 0.1);
  assert_ok(btfi_cmf_hf_solve(btfi_host(), ctx, hf, 1, 1, f, 0, 1e-3, all, 0));
  assert_ok(btfi_cmf_hf_solve(btfi_host(), ctx, other, 1, 1, f, 0, 1e-3, some, 0));
  assert_memory_equal(all, some, sizeof all);
  btfi_cmf_hf_free(btfi_host(), ctx, hf);
  btfi_cmf_hf_free(btfi_host(), ctx, other);
  memset(s.use_pair, 0, 300);
  assert_status(btfi_cmf_hf_create(btfi_host(), ctx, &s.g, 0.1, 0, &hf), BTF_E_UNSUPPORTED);
  assert_null(hf);
  sampling_release(&s);
  sampling_release(&few);
  test_context_done(ctx, &memory);
}

static void test_budget_and_failures(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  sampling s = sampling_create(150, 8, 8, 51);
  btfi_cmf_hf *hf;
  float f[150], maps[192];
  for (uint32_t p = 0; p < 150; p++) f[p] = 1.0f + (float)p;
  assert_status(btfi_cmf_hf_create(btfi_host(), ctx, &s.g, 0.1, 500000, &hf), BTF_E_LIMIT);
  const char *named = strstr(btf_error_message(), "working set of ");
  assert_non_null(named);
  const uint64_t need = strtoull(named + strlen("working set of "), NULL, 10);
  assert_in_range(need, 2 * 192 * 192 * 8, 2 * 192 * 192 * 8 + 100000);
  assert_ok(btfi_cmf_hf_create(btfi_host(), ctx, &s.g, 0.1, need, &hf));
  assert_true(btfi_cmf_hf_solve_bytes(btfi_host(), ctx, btfi_cmf_hf_unknowns(hf), 10, 3) >= 10 * 3 * 192 * 8);
  btfi_cmf_hf_free(btfi_host(), ctx, hf);
  btfi_cmf_hf_free(btfi_host(), ctx, NULL);
  test_context_done(ctx, &memory);
  for (int persistent = 0; persistent < 2; persistent++) {
    long failed = 0;
    for (long at = 1;; at++) {
      ctx = test_context(&memory);
      memory.fail_at = memory.total_allocations + at;
      memory.persistent = persistent;
      btf_status status = btfi_cmf_hf_create(btfi_host(), ctx, &s.g, 0.1, 0, &hf);
      if (status == BTF_OK) status = btfi_cmf_hf_solve(btfi_host(), ctx, hf, 1, 1, f, 0, 1e-3, maps, 0);
      const int reached = memory.total_allocations >= memory.fail_at;
      memory.fail_at = 0;
      btfi_cmf_hf_free(btfi_host(), ctx, hf);
      test_context_done(ctx, &memory);
      assert_status(status, reached ? BTF_E_NOMEM : BTF_OK);
      if (!reached) break;
      failed++;
    }
    assert_int_equal(failed, 12);
  }
  sampling_release(&s);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_least_squares),       cmocka_unit_test(test_planted_maps_are_found),
      cmocka_unit_test(test_lambda_sweep),        cmocka_unit_test(test_shared_factor),
      cmocka_unit_test(test_shared_factor_pays),  cmocka_unit_test(test_floor),
      cmocka_unit_test(test_texels_without_data), cmocka_unit_test(test_pairs_left_out),
      cmocka_unit_test(test_budget_and_failures),
  };
  return btf_run("cmf_homomorphic", tests);
}
