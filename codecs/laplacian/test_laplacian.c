/* SPDX-License-Identifier: MIT */
/* The method: colour, pyramids, decompositions, means, and the rules of every fit. */
#include "test_laplacian_fits.h"

#include "exact_svd.h"

#include "model/model.h"
#include "registry/registry.h"

static test_memory memory;
static const char *const filter_names[] = {"mean", "binomial", "paper"};

/* LAP01, T22: JPEG's full-range matrix, and its inverse. Values up to 1, a few roundings of 6e-8 each. */
static void test_colour(void **unused) {
  (void)unused;
  for (int i = 0; i < 1000; i++) {
    const double rgb[3] = {test_random(), test_random(), test_random()};
    const double expected[3] = {0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2],
                                -0.168735892 * rgb[0] - 0.331264108 * rgb[1] + 0.5 * rgb[2],
                                0.5 * rgb[0] - 0.418687589 * rgb[1] - 0.081312411 * rgb[2]};
    float ycc[3], back[3];
    for (uint32_t c = 0; c < 3; c++) {
      ycc[c] = btfi_laplacian_from_rgb(c, (float)rgb[0], (float)rgb[1], (float)rgb[2]);
      assert_near(ycc[c], expected[c], 1e-6);
    }
    btfi_laplacian_to_rgb(ycc[0], ycc[1], ycc[2], back);
    for (uint32_t c = 0; c < 3; c++) assert_near(back[c], rgb[c], 1e-6);
  }
}

static const uint32_t sizes[][2] = {{64, 64}, {16, 8}, {12, 7}, {1, 9}, {33, 2}, {1, 1}, {5, 3}, {22, 11}};
enum { SIZES = sizeof sizes / sizeof *sizes };

static btfi_laplacian_pyramid *make_pyramid(btf_context *ctx, uint32_t filter, uint32_t wrap, uint32_t levels,
                                            uint32_t width, uint32_t height) {
  const btfi_laplacian_grid grid = btfi_laplacian_grid_of(filter, wrap, levels, width, height);
  btfi_laplacian_pyramid *pyramid;
  assert_ok(btfi_laplacian_pyramid_create(btfi_host(), ctx, &grid, &pyramid));
  return pyramid;
}

/* LAP02, T16, T18: bands add up to the image, and from level k on to the image filtered k times, each time
 * from the level before. Values up to 1 and sums of up to 14 bands, each rounded a few times to 6e-8. */
static void test_reconstruction(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < SIZES; i++)
    for (uint32_t kind = 0; kind < 2 * LAPLACIAN_FILTERS; kind++) {
      const uint32_t width = sizes[i][0], height = sizes[i][1], texels = width * height, wrap = kind % 2,
                     filter = kind / 2, levels = btfi_host()->mip_count(width, height);
      btfi_laplacian_pyramid *pyramid = make_pyramid(ctx, filter, wrap, levels, width, height);
      const uint64_t floats = btfi_laplacian_pyramid_floats(pyramid);
      float *planes = malloc(floats * sizeof *planes), *bands = malloc(floats * sizeof *bands);
      float *scratch = malloc(btfi_laplacian_pyramid_scratch(pyramid) * sizeof *scratch);
      double *image = malloc(texels * sizeof *image);
      for (uint32_t t = 0; t < texels; t++) {
        planes[t] = test_random();
        image[t] = planes[t];
      }
      btfi_laplacian_analyse(pyramid, 0, planes, scratch);
      memcpy(bands, planes, floats * sizeof *bands);
      for (uint32_t k = levels; k-- > 0;) {
        memcpy(planes, bands, floats * sizeof *bands);
        btfi_laplacian_synthesise(pyramid, k, planes, scratch);
        const float *got = planes + btfi_laplacian_pyramid_offset(pyramid, k);
        /* Halves by definition; other ratios are only known to be exact at level 0. */
        if (k > 0 && (width % (1u << k) != 0 || height % (1u << k) != 0)) continue;
        double *expected = low_pass(image, width, height, filter, wrap, k);
        for (uint32_t t = 0; t < btf_sampling_level_size(width, k) * btf_sampling_level_size(height, k); t++)
          if (!(fabs(got[t] - expected[t]) <= 1e-6))
            fail_msg("%s filter, wrap %u, %u x %u, level %u: %.9g instead of %.9g", filter_names[filter],
                     wrap, width, height, k, got[t], expected[t]);
        free(expected);
      }
      free(image);
      free(planes);
      free(bands);
      free(scratch);
      btfi_laplacian_pyramid_destroy(pyramid);
    }
  test_context_done(ctx, &memory);
}

/* LAP03, T17: bands of the mean-preserving filters have mean 0; those of the paper's have not. An impulse
 * shows it: at an even texel, four boxes hold it, a ninth each, at an odd one only one does. */
static void test_means_of_bands(void **unused) {
  (void)unused;
  enum { SIDE = 32, LEVELS = 6 };
  btf_context *ctx = test_context(&memory);
  for (uint32_t filter = 0; filter < LAPLACIAN_FILTERS; filter++) {
    btfi_laplacian_pyramid *pyramid = make_pyramid(ctx, filter, BTF_WRAP_PERIODIC, LEVELS, SIDE, SIDE);
    float *planes = malloc(btfi_laplacian_pyramid_floats(pyramid) * sizeof *planes);
    float *scratch = malloc(btfi_laplacian_pyramid_scratch(pyramid) * sizeof *scratch);
    double worst = 0.0;
    for (int turn = 0; turn < 20; turn++) {
      for (uint32_t t = 0; t < SIDE * SIDE; t++) planes[t] = test_random();
      btfi_laplacian_analyse(pyramid, 0, planes, scratch);
      for (uint32_t k = 0; k + 1 < LEVELS; k++) {
        const float *band = planes + btfi_laplacian_pyramid_offset(pyramid, k);
        double mean = 0.0;
        for (uint32_t t = 0; t < (uint32_t)((SIDE >> k) * (SIDE >> k)); t++) mean += band[t];
        worst = fmax(worst, fabs(mean) / ((SIDE >> k) * (SIDE >> k)));
      }
    }
    print_message("%s filter: largest mean of a band %.3g\n", filter_names[filter], worst);
    if (filter == LAPLACIAN_PAPER_FILTER) {
      assert_true(worst > 1e-4);
    } else {
      assert_true(worst <= 1e-7);
    }
    free(planes);
    free(scratch);
    btfi_laplacian_pyramid_destroy(pyramid);
  }
  /* What an impulse leaves in the mean of F_1: 1 / texels if kept. Odd texels: 2 boxes of 3 along each axis
   * hold one (the one before and the one after), even ones 1 box. */
  btfi_laplacian_pyramid *pyramid = make_pyramid(ctx, LAPLACIAN_PAPER_FILTER, BTF_WRAP_PERIODIC, 2, 8, 8);
  float planes[80], scratch[64];
  assert_true(btfi_laplacian_pyramid_scratch(pyramid) <= 64);
  for (uint32_t x = 0; x < 4; x++) {
    memset(planes, 0, sizeof planes);
    planes[8 * 2 + x] = 1.0f;
    btfi_laplacian_analyse(pyramid, 0, planes, scratch);
    double sum = 0.0;
    for (uint32_t t = 64; t < 80; t++) sum += planes[t];
    assert_near(sum, x % 2 ? 2.0 / 9.0 : 1.0 / 9.0, 1e-7);
  }
  btfi_laplacian_pyramid_destroy(pyramid);
  test_context_done(ctx, &memory);
}

/* The matrix of a band by the pyramid, in double, with a mean taken from the top. */
static double *band_matrix(btf_context *ctx, const material *m, const btfi_laplacian_state *s, uint32_t k,
                           uint32_t c, uint64_t *rows, uint64_t *columns) {
  btfi_laplacian_pyramid *pyramid;
  assert_ok(btfi_laplacian_pyramid_create(btfi_host(), ctx, &s->grid, &pyramid));
  float *planes = malloc(btfi_laplacian_pyramid_floats(pyramid) * sizeof *planes);
  float *scratch = malloc(btfi_laplacian_pyramid_scratch(pyramid) * sizeof *scratch);
  const float *xyz = btf_dirset_directions(m->directions);
  *rows = (uint64_t)m->count * m->count;
  *columns = (uint64_t)s->grid.width[k] * s->grid.height[k];
  double *matrix = malloc(*rows * *columns * sizeof *matrix);
  for (uint64_t pair = 0; pair < *rows; pair++) {
    const uint32_t light = (uint32_t)(pair % m->count), view = (uint32_t)(pair / m->count);
    double *image = image_channel(m, light, view, c);
    for (uint32_t t = 0; t < m->width * m->height; t++) planes[t] = (float)image[t];
    free(image);
    btfi_laplacian_analyse(pyramid, k, planes, scratch);
    const float *band = planes + btfi_laplacian_pyramid_offset(pyramid, k);
    double mean = 0.0;
    if (k + 1 == s->grid.levels)
      mean = c == 0 ? btfi_laplacian_phong_value(&s->head.phong, xyz + 3 * light, xyz + 3 * view)
                    : s->head.chroma[c - 1];
    for (uint64_t t = 0; t < *columns; t++) matrix[pair * *columns + t] = band[t] - mean;
  }
  free(planes);
  free(scratch);
  btfi_laplacian_pyramid_destroy(pyramid);
  return matrix;
}

/* LAP05: at each level and channel the squared error of what the tables hold is the tail of LAPACK's singular
 * values. */
static void test_tail_energy(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  for (uint32_t filter = 0; filter < LAPLACIAN_FILTERS; filter += 2) {
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 16, 12, 3, filter == 0, BTF_WRAP_PERIODIC);
    char settings[128];
    snprintf(settings, sizeof settings, "y=5 cb=2 cr=3 storage=f32 accuracy=1e-6 filter=%s",
             filter_names[filter]);
    btf_model *model = laplacian_fit(ctx, &m, settings);
    const btfi_laplacian_state *s = laplacian_state(model);
    for (uint32_t k = 0; k < s->grid.levels; k++)
      for (uint32_t c = 0; c < 3; c++) {
        uint64_t rows, columns;
        double *matrix = band_matrix(ctx, &m, s, k, c, &rows, &columns),
               *copy = malloc(rows * columns * sizeof *copy);
        const uint64_t count = rows < columns ? rows : columns;
        memcpy(copy, matrix, rows * columns * sizeof *copy);
        double *const sigma = exact_singular_values(copy, rows, columns);
        double error = 0.0;
        const double energy = exact_tail(sigma, count, 0),
                     tail = exact_tail(sigma, count, s->head.count[k][c]);
        uint32_t first = s->layout.first[k];
        for (uint32_t before = 0; before < c; before++) first += s->head.count[k][before];
        for (uint64_t pair = 0; pair < rows; pair++)
          for (uint64_t t = 0; t < columns; t++) {
            const float *row = (const float *)(const void *)(s->eigen + pair * s->layout.row_bytes);
            const float *weights =
                (const float *)(const void *)(s->weights[k] + t * s->layout.texel_bytes[k]);
            double value = 0.0;
            for (uint32_t j = first; j < first + s->head.count[k][c]; j++)
              value += (double)row[j] * weights[j - s->layout.first[k]] * s->scale[c * s->scale_stride + j];
            error += pow(value - matrix[pair * columns + t], 2.0);
          }
        /* The accuracy asked for twice, since squares are compared, and float: 8 eps of the norm of the band
         * and of the image it is a difference of, 1.2e-7 times some 100 here, change the square of the error
         * e by 2 d e. */
        const double d = 8.0 * 1.2e-7 * (sqrt(energy) + 1e-2 * sqrt((double)(rows * columns)));
        const double tolerance = 2.1e-6 * tail + 2.0 * d * sqrt(tail) + d * d;
        assert_near(error, tail, tolerance);
        /* Reported as a difference of float sums over the band. */
        assert_near(s->head.residual[k][c], tail, tolerance + 1e-6 * energy);
        assert_relative(s->head.energy_of[k][c], energy, 1e-5);
        free(sigma);
        free(copy);
        free(matrix);
      }
    btf_model_release(model);
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

static double phong(const double p[4], const float *l, const float *v) {
  double h[3], length = 0.0;
  for (int k = 0; k < 3; k++) {
    h[k] = (double)l[k] + v[k];
    length += h[k] * h[k];
  }
  return p[0] + p[1] * l[2] + p[2] * pow(h[2] / sqrt(length), p[3]);
}

static double phong_cost(const double p[4], const btf_dirset *set, const double *values) {
  const float *xyz = btf_dirset_directions(set);
  const uint32_t n = btf_dirset_count(set);
  double cost = 0.0;
  for (uint32_t i = 0; i < n * n; i++)
    cost += pow(values[3 * i] - phong(p, xyz + 3 * (i % n), xyz + 3 * (i / n)), 2.0);
  return cost;
}

/* LAP06, T19: planted parameters of N.H come back; with noise no step in any direction is better, to first
 * order. */
static void test_phong(void **unused) {
  (void)unused;
  const double planted[][4] = {
      {0.1, 0.6, 0.4, 20.0}, {0.02, 0.3, 2.0, 150.0}, {0.3, 0.1, 0.05, 5.0}, {-0.05, 0.7, 0.2, 1200.0}};
  btf_context *ctx = test_context(&memory);
  btf_dirset *set;
  assert_ok(btf_dirset_create_named(ctx, "grid:10x5", &set));
  const float *xyz = btf_dirset_directions(set);
  const uint32_t n = btf_dirset_count(set);
  double *values = malloc((size_t)3 * n * n * sizeof *values), rms;
  btfi_laplacian_phong got;
  for (size_t k = 0; k < 4; k++) {
    for (int noisy = 0; noisy < 2; noisy++) {
      for (uint32_t i = 0; i < n * n; i++)
        values[3 * i] =
            phong(planted[k], xyz + 3 * (i % n), xyz + 3 * (i / n)) + noisy * 0.05 * test_random();
      assert_ok(btfi_laplacian_fit_phong(btfi_host(), ctx, set, set, BTF_QUANTITY_BRDF, values, &got, &rms));
      const double p[4] = {got.ka, got.kd, got.ks, got.alpha};
      const double cost = phong_cost(p, set, values);
      assert_near(rms, sqrt(cost / (n * n)), 1e-9);
      if (!noisy) {
        for (int j = 0; j < 4; j++) assert_near(p[j], planted[k][j], 1e-6 * fmax(1.0, planted[k][j]));
        continue;
      }
      for (int j = 0; j < 4; j++) {
        /* A central difference of the cost: its slope must vanish beside its curvature times 1e-5 of the
         * value. */
        const double step = 1e-3 * fmax(0.1, fabs(p[j]));
        double up[4], down[4];
        memcpy(up, p, sizeof up);
        memcpy(down, p, sizeof down);
        up[j] += step;
        down[j] -= step;
        const double rise = phong_cost(up, set, values) - cost, fall = phong_cost(down, set, values) - cost;
        assert_true(rise > 0.0 && fall > 0.0);
        assert_true(fabs(rise - fall) <= 0.05 * (rise + fall));
      }
    }
  }
  free(values);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

/* Directions that do not tell the terms of equation 5 apart: a surface without texture is the same between
 * and beyond the samples, too. All is sums and products of floats, some 30 roundings of the largest value. */
static void test_few_directions(void **unused) {
  (void)unused;
  const char *const directions[] = {"grid:1x1", "grid:4x1", "grid:1x4", "grid:4x2"};
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < 4; i++)
    for (int lambert = 0; lambert < 2; lambert++) {
      /* f is constant in both: samples of the first are f, of the other f times the cosine of the light. */
      material m = material_create(ctx, lambert ? MATERIAL_TEXTURED_LAMBERT : MATERIAL_CONSTANT,
                                   directions[i], 6, 4, 3, true, BTF_WRAP_PERIODIC);
      const float *xyz = btf_dirset_directions(m.directions);
      const size_t image = (size_t)3 * m.width * m.height;
      for (size_t k = 0; lambert && k < image * m.count * m.count; k++)
        m.samples[k] = 0.3f * xyz[3 * (k / image % m.count) + 2];
      btf_model *model = laplacian_fit(ctx, &m, "storage=f32");
      const double tolerance = 32.0 * 6e-8 * 0.3;
      for (uint32_t pair = 0; pair < m.count * m.count; pair++)
        for (uint32_t t = 0; t < m.width * m.height; t++) {
          float got[3];
          btf_model_texel(model, 0, t % m.width, t / m.width, pair % m.count, pair / m.count, got);
          for (uint32_t c = 0; c < 3; c++)
            assert_near(got[c],
                        material_sample(&m, t % m.width, t / m.width, pair % m.count, pair / m.count, c),
                        tolerance);
        }
      for (int turn = 0; turn < 300; turn++) {
        btf_query q = {.uv = {test_random(), test_random()}, .lod = 3.0f * test_random()};
        float got[3];
        test_random_direction(q.light);
        test_random_direction(q.view);
        q.flags = turn % 3 == 0 ? BTF_QUERY_NEAREST : 0;
        btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
        for (uint32_t c = 0; c < 3; c++) {
          const double f = lambert ? 0.3 * (double)q.light[2] : 0.1 + 0.07 * c;
          if (!(fabs(got[c] - f) <= tolerance))
            fail_msg("%s, %s, light %g %g %g, channel %u: %.9g instead of %.9g", directions[i],
                     lambert ? "Lambert" : "constant", (double)q.light[0], (double)q.light[1],
                     (double)q.light[2], c, (double)got[c], f);
        }
      }
      btf_model_release(model);
      material_release(&m);
    }
  test_context_done(ctx, &memory);
}

/* Lobes that fit between the samples are no more than twice as high there as at any sample. */
static void test_narrow_lobe(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  btf_dirset *set;
  double values[3 * 16], rms;
  btfi_laplacian_phong got;
  assert_ok(btf_dirset_create_named(ctx, "grid:1x4", &set));
  const float *xyz = btf_dirset_directions(set);
  /* The half vectors next to the normal are 11.25 degrees off: the planted lobe is 4e-9 there. */
  const double planted[4] = {0.1, 0.6, 1e7, 1000.0};
  const float normal[3] = {0.0f, 0.0f, 1.0f};
  for (uint32_t i = 0; i < 16; i++) values[3 * i] = phong(planted, xyz + 3 * (i % 4), xyz + 3 * (i / 4));
  assert_ok(btfi_laplacian_fit_phong(btfi_host(), ctx, set, set, BTF_QUANTITY_BRDF, values, &got, &rms));
  const double lobe[4] = {0.0, 0.0, 1.0, got.alpha};
  double highest = 0.0;
  for (uint32_t i = 0; i < 16; i++)
    highest = fmax(highest, phong(lobe, xyz + 3 * (i % 4), xyz + 3 * (i / 4)));
  assert_near(phong(lobe, normal, normal), 1.0, 1e-12);
  assert_true(highest >= 0.5 * (1.0 - 1e-12));
  /* And all parameters are about as large as the samples are. */
  assert_true(fabs(got.ka) + fabs(got.kd) + fabs(got.ks) < 10.0);
  btf_dirset_release(set);
  test_context_done(ctx, &memory);
}

/* LAP06, LAP07, T17: what the fitted means leave, and the mean that bands below the top lose, as reported. */
static void test_reported_means(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 16, 16, 3, true, BTF_WRAP_PERIODIC);
  for (uint32_t filter = 0; filter < LAPLACIAN_FILTERS; filter += 2) {
    char settings[64];
    snprintf(settings, sizeof settings, "filter=%s levels=3", filter_names[filter]);
    btf_model *model = laplacian_fit(ctx, &m, settings);
    const btfi_laplacian_head *head = &laplacian_state(model)->head;
    const float *xyz = btf_dirset_directions(m.directions);
    const uint32_t pairs = m.count * m.count;
    double sum[3] = {0}, squares[3] = {0}, left = 0.0, lost[2][3] = {{0}};
    for (uint32_t pair = 0; pair < pairs; pair++)
      for (uint32_t c = 0; c < 3; c++) {
        double *image = image_channel(&m, pair % m.count, pair / m.count, c), mean[3];
        for (uint32_t k = 0; k < 3; k++) {
          double *level = low_pass(image, 16, 16, filter, BTF_WRAP_PERIODIC, k);
          mean[k] = 0.0;
          for (uint32_t t = 0; t < 256u >> 2 * k; t++) mean[k] += level[t] / (256 >> 2 * k);
          free(level);
        }
        free(image);
        /* Upsampling by nearest or linear keeps means. */
        for (uint32_t k = 0; k < 2; k++) lost[k][c] += pow(mean[k] - mean[k + 1], 2.0) / pairs;
        sum[c] += mean[2] / pairs;
        squares[c] += mean[2] * mean[2] / pairs;
        const double p[4] = {head->phong.ka, head->phong.kd, head->phong.ks, head->phong.alpha};
        if (c == 0)
          left +=
              pow(mean[2] - phong(p, xyz + 3 * (pair % m.count), xyz + 3 * (pair / m.count)), 2.0) / pairs;
      }
    assert_near(head->mean_residual, sqrt(left), 1e-6);
    for (uint32_t c = 1; c < 3; c++) {
      assert_near(head->chroma[c - 1], sum[c], 1e-6);
      assert_near(head->chroma_rms[c - 1], sqrt(squares[c] - sum[c] * sum[c]), 1e-5);
    }
    print_message(
        "%s filter: luma mean leaves %.3g, chroma %.3g %.3g; lost means of level 0 %.3g, of level 1 %.3g\n",
        filter_names[filter], head->mean_residual, head->chroma_rms[0], head->chroma_rms[1],
        head->mean_norm[0][0], head->mean_norm[1][0]);
    for (uint32_t k = 0; k < 2; k++)
      for (uint32_t c = 0; c < 3; c++) {
        assert_near(head->mean_norm[k][c], sqrt(lost[k][c]), 1e-6);
        if (filter == LAPLACIAN_MEAN_FILTER) assert_true(head->mean_norm[k][c] <= 1e-7);
      }
    if (filter == LAPLACIAN_PAPER_FILTER) assert_true(head->mean_norm[0][0] > 1e-4);
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* With all components every level is exact at its texels, whatever the shape, filter, wrap, mean and storage.
 */
static void test_shapes(void **unused) {
  (void)unused;
  const struct {
    const char *directions;
    uint32_t width, height;
  } shapes[] = {{"grid:4x2", 16, 8}, {"grid:4x2", 5, 3}, {"grid:4x2", 1, 1},  {"one", 6, 5},
                {"one", 1, 1},       {"grid:3x1", 1, 9}, {"grid:3x2", 33, 2}, {"grid:3x1", 22, 11}};
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++)
    for (uint32_t kind = 0; kind < 12; kind++) {
      const uint32_t filter = kind % 3, wrap = kind / 3 % 2, table = kind / 6;
      material m = material_create(ctx, MATERIAL_GLOSSY, shapes[i].directions, shapes[i].width,
                                   shapes[i].height, 3, kind % 2 == 0, wrap);
      char settings[128];
      snprintf(settings, sizeof settings,
               "y=64 cb=64 cr=64 levels=25 accuracy=1e-6 storage=%s filter=%s mean=%s",
               kind % 4 == 3 ? "f16" : "f32", filter_names[filter], table ? "table" : "phong");
      btf_model *model = laplacian_fit(ctx, &m, settings);
      const double relative = sqrt(laplacian_squared_error(model, &m) / material_energy(&m));
      /* Halves: 2^-11 of each value of two factors, of some bands of about the norm of the image. */
      if (relative > (kind % 4 == 3 ? 2e-3 : 2e-6)) fail_msg("shape %zu, %s: %g", i, settings, relative);
      const uint32_t levels = laplacian_state(model)->grid.levels;
      for (uint32_t k = 1; k < levels && kind % 4 != 3; k++) {
        if (m.width % (1u << k) != 0 || m.height % (1u << k) != 0) continue;
        for (uint32_t pair = 0; pair < m.count * m.count; pair += 3) {
          double *level[3];
          for (uint32_t c = 0; c < 3; c++) {
            double *image = image_channel(&m, pair % m.count, pair / m.count, c);
            level[c] = low_pass(image, m.width, m.height, filter, wrap, k);
            free(image);
          }
          for (uint32_t t = 0; t < (m.width >> k) * (m.height >> k); t++) {
            float got[3];
            btf_model_texel(model, k, t % (m.width >> k), t / (m.width >> k), pair % m.count, pair / m.count,
                            got);
            /* Values around 1; a hundred products of f32. */
            assert_near(got[0], level[0][t] + 1.402 * level[2][t], 1e-5);
            assert_near(got[2], level[0][t] + 1.772 * level[1][t], 1e-5);
          }
          for (uint32_t c = 0; c < 3; c++) free(level[c]);
        }
      }
      btf_model_release(model);
      material_release(&m);
    }
  test_context_done(ctx, &memory);
}

/* Nothing but zeros, one value, grey: no component of rounding noise is kept. */
static void test_flat(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const char *const settings[] = {"y=8", "mean=table", "filter=paper storage=f32", "psnr=40",
                                  "rmse=0.1 mean=table"};
  for (size_t i = 0; i < 5; i++)
    for (int black = 0; black < 2; black++) {
      material m = material_create(ctx, MATERIAL_CONSTANT, "grid:4x2", 8, 4, 3, true, BTF_WRAP_PERIODIC);
      if (black) memset(m.samples, 0, (size_t)m.count * m.count * 3 * 32 * sizeof(float));
      btf_model *model = laplacian_fit(ctx, &m, settings[i]);
      const btfi_laplacian_state *s = laplacian_state(model);
      assert_true(s->layout.first[s->grid.levels] <= 3);
      /* The largest value is 0.24; the table's halves are relative to its largest. */
      const double samples = (double)m.count * m.count * 3 * 32;
      assert_true(sqrt(laplacian_squared_error(model, &m) / samples) <= 1e-6);
      btf_model_release(model);
      material_release(&m);
    }
  test_context_done(ctx, &memory);
}

/* Other than RGB is refused by name. */
static void test_channels(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:3x1", 4, 4, 5, true, BTF_WRAP_PERIODIC);
  btf_model *model;
  assert_status(laplacian_try_fit(ctx, m.ds, "", NULL, &model), BTF_E_UNSUPPORTED);
  assert_message_has("3 channels");
  assert_null(model);
  material_release(&m);
  test_context_done(ctx, &memory);
}

static void test_determinism(void **unused) {
  (void)unused;
  const char *const settings[] = {"y=6", "psnr=30 mean=table filter=paper"};
  for (size_t i = 0; i < 2; i++) {
    unsigned char *bytes[2];
    size_t size[2];
    for (int turn = 0; turn < 2; turn++) {
      btf_context *ctx = test_context_with(&memory, NULL, 2);
      material m = material_create(ctx, MATERIAL_GLOSSY, "grid:6x3", 12, 10, 3, true, BTF_WRAP_PERIODIC);
      btf_model *model = laplacian_fit(ctx, &m, settings[i]);
      assert_ok(btf_model_save(model, test_path("same.btfz"), 0, NULL, NULL));
      bytes[turn] = test_read_bytes(test_path("same.btfz"), &size[turn]);
      btf_model_release(model);
      material_release(&m);
      test_context_done(ctx, &memory);
    }
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(bytes[0], bytes[1], size[0]);
    free(bytes[0]);
    free(bytes[1]);
  }
}

/* A fit holds no more than its working set and its result; where that leaves no room for bands, they
 * are made anew for every reading, with the same result but for the accuracy asked for. */
static void test_budget(void **unused) {
  (void)unused;
  const uint64_t budgets[] = {0, 5u << 20, 1000};
  double error[2];
  for (int turn = 0; turn < 3; turn++) {
    btf_context *ctx = test_context_with(&memory, NULL, 2);
    material m = material_create(ctx, MATERIAL_GLOSSY, "grid:12x4", 32, 24, 3, true, BTF_WRAP_PERIODIC);
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    uint64_t before, peak;
    size_t payload;
    job.max_working_set = budgets[turn];
    btf_context_memory(ctx, &before, NULL);
    if (turn == 2) {
      assert_status(laplacian_try_fit(ctx, m.ds, "levels=4", &job, &model), BTF_E_LIMIT);
      assert_message_has("would do");
    } else {
      assert_ok(laplacian_try_fit(ctx, m.ds, "levels=4 accuracy=1e-4", &job, &model));
      btf_context_memory(ctx, NULL, &peak);
      error[turn] = laplacian_squared_error(model, &m);
      print_message("budget %.1f MiB, peak %.1f MiB\n", (double)budgets[turn] / 1048576.0,
                    (double)peak / 1048576.0);
      assert_ok(btf_model_save(model, test_path("budget.btfz"), 0, NULL, NULL));
      free(test_read_bytes(test_path("budget.btfz"), &payload));
      /* Beside: what the data set holds, and some KiB for options, the state and the list of chunks. */
      if (turn == 1) assert_true(peak <= before + budgets[turn] + payload + (64u << 10));
      btf_model_release(model);
    }
    material_release(&m);
    test_context_done(ctx, &memory);
  }
  assert_relative(error[0], error[1], 2e-4 + 1e-5);
}

typedef struct cancel_after {
  int calls, seen;
  double last;
} cancel_after;

static int32_t cancel_progress(void *user, double fraction, const char *stage) {
  cancel_after *c = user;
  assert_non_null(stage);
  assert_true(fraction >= c->last && fraction <= 1.0);
  c->last = fraction;
  return ++c->seen > c->calls;
}

static void test_cancel(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:4x2", 12, 10, 3, true, BTF_WRAP_PERIODIC);
  int cancelled = 0;
  for (int calls = 0; calls < 500; calls++) {
    cancel_after c = {calls, 0, 0.0};
    btf_job job = BTF_JOB_INIT;
    btf_model *model;
    job.progress = cancel_progress;
    job.user = &c;
    const btf_status status = laplacian_try_fit(ctx, m.ds, "psnr=35", &job, &model);
    if (status == BTF_OK) {
      assert_true(c.last == 1.0);
      btf_model_release(model);
      break;
    }
    assert_int_equal(status, BTF_E_CANCELLED);
    assert_null(model);
    cancelled++;
  }
  assert_in_range(cancelled, 5, 499);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Every allocation of fit, save and load fails in turn: a status, and no leak. */
static void test_failing_allocations(void **unused) {
  (void)unused;
  const char *const settings[] = {"y=3 cb=1 cr=1", "psnr=20 mean=table filter=paper levels=2 storage=f32"};
  btf_context *ctx = test_context_with(&memory, NULL, 1);
  material m = material_create(ctx, MATERIAL_GLOSSY, "grid:3x1", 6, 4, 3, true, BTF_WRAP_PERIODIC);
  for (size_t i = 0; i < 2; i++) {
    long failures = 0;
    for (long at = 1; at < 5000; at++) {
      const long live = memory.live_blocks;
      btf_model *model = NULL, *loaded = NULL;
      memory.fail_at = memory.total_allocations + at;
      btf_status status = laplacian_try_fit(ctx, m.ds, settings[i], NULL, &model);
      if (status == BTF_OK) status = btf_model_save(model, test_path("failing.btfz"), 0, NULL, NULL);
      if (status == BTF_OK) status = btf_model_load(ctx, test_path("failing.btfz"), &loaded);
      const int untouched = memory.total_allocations < memory.fail_at;
      memory.fail_at = 0;
      btf_model_release(model);
      btf_model_release(loaded);
      assert_int_equal(memory.live_blocks, live);
      if (untouched) {
        assert_ok(status);
        break;
      }
      if (status != BTF_OK) assert_int_equal(status, BTF_E_NOMEM);
      failures += status != BTF_OK;
    }
    assert_true(failures > 20);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_colour),
                                     cmocka_unit_test(test_reconstruction),
                                     cmocka_unit_test(test_means_of_bands),
                                     cmocka_unit_test(test_tail_energy),
                                     cmocka_unit_test(test_phong),
                                     cmocka_unit_test(test_few_directions),
                                     cmocka_unit_test(test_narrow_lobe),
                                     cmocka_unit_test(test_reported_means),
                                     cmocka_unit_test(test_shapes),
                                     cmocka_unit_test(test_flat),
                                     cmocka_unit_test(test_channels),
                                     cmocka_unit_test(test_determinism),
                                     cmocka_unit_test(test_budget),
                                     cmocka_unit_test(test_cancel),
                                     cmocka_unit_test(test_failing_allocations)};
  return btf_run("laplacian", tests);
}
