/* SPDX-License-Identifier: MIT */
/* The codec: sizes, normalisation, interpolation over index maps, storage, codebooks, rotation, levels, edge
 * cases, budgets, hostile payloads. */
#include "cmf.h"

#include "btf_test.h"
#include "container/container.h"
#include "model/model.h"
#include "registry/registry.h"

static test_memory memory;
static uint64_t random_state = 1;
extern const btf_codec_vtbl btf_codec_cmf;

static float draw(void) {
  return (float)btf_random_unit(&random_state);
}

static void draw_direction(float d[3]) {
  const float z = draw(), phi = 6.2831853f * draw(), r = sqrtf(1.0f - z * z);
  d[0] = r * cosf(phi);
  d[1] = r * sinf(phi);
  d[2] = z;
}

/* ---- materials ---- */

typedef struct material {
  btf_dataset *ds;
  btf_dirset *set;
  uint32_t count, width, height, channels;
  float *samples; /* [y][x][view][light][channel], owned by ds */
} material;

enum { BUMPS, ZERO, CONSTANT, ROTATED };

/* A tilted glossy facet with a dark side and a side that is hidden. */
static float facet(const float n[3], float hidden, const float l[3], const float v[3], uint32_t c) {
  float h[3];
  btfi_cmf_half(l, v, h);
  const float nl = fmaxf(0.0f, n[0] * l[0] + n[1] * l[1] + n[2] * l[2]);
  const float nh = fmaxf(0.0f, n[0] * h[0] + n[1] * h[1] + n[2] * h[2]);
  const float seen = 1.0f / (1.0f + expf(-hidden * (n[0] * v[0] + n[1] * v[1] + 0.2f)));
  return seen * (0.1f + 0.2f * (float)(c % 3)) * nl / fmaxf(l[2], 0.1f) + seen * powf(nh, 24.0f) + 0.002f;
}

static float value_of(int kind, uint32_t x, uint32_t y, const float l[3], const float v[3], uint32_t c) {
  if (kind == ZERO) return 0.0f;
  if (kind == CONSTANT) return 0.1f + 0.07f * (float)c;
  float tilt = 0.15f + 0.5f * (float)((3 * x + 5 * y) % 16) / 16.0f, turn = 0.7f * (float)(x + 3 * y % 7);
  float hidden = 4.0f + (float)(x % 3);
  if (kind == ROTATED) { /* four facets, each turned by a random angle */
    uint64_t state = 977u * y + x;
    const uint32_t prototype = (x + y) % 4;
    tilt = 0.3f + 0.12f * (float)prototype;
    hidden = 2.0f + 2.0f * (float)prototype;
    turn = 6.2831853f * (float)btf_random_unit(&state);
  }
  const float n[3] = {sinf(tilt) * cosf(turn), sinf(tilt) * sinf(turn), cosf(tilt)};
  return facet(n, hidden, l, v, c);
}

static material material_create(btf_context *ctx, int kind, const char *directions, uint32_t width,
                                uint32_t height, uint32_t channels) {
  material m = {.width = width, .height = height, .channels = channels};
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  const float up[3] = {0.0f, 0.0f, 1.0f};
  if (strcmp(directions, "one") == 0)
    assert_ok(btf_dirset_create(ctx, up, 1, &m.set));
  else
    assert_ok(btf_dirset_create_named(ctx, directions, &m.set));
  m.count = btf_dirset_count(m.set);
  m.samples = malloc((size_t)m.count * m.count * channels * width * height * sizeof *m.samples);
  const float *xyz = btf_dirset_directions(m.set);
  size_t i = 0;
  for (uint32_t y = 0; y < height; y++)
    for (uint32_t x = 0; x < width; x++)
      for (uint32_t v = 0; v < m.count; v++)
        for (uint32_t l = 0; l < m.count; l++)
          for (uint32_t c = 0; c < channels; c++)
            m.samples[i++] = value_of(kind, x, y, xyz + 3 * l, xyz + 3 * v, c);
  const ptrdiff_t pixel = (ptrdiff_t)(sizeof(float) * channels), abrdf = pixel * m.count * m.count;
  desc.lights = desc.views = m.set;
  desc.width = width;
  desc.height = height;
  desc.channels = channels;
  desc.data = desc.user = m.samples;
  desc.release = free;
  desc.strides = (btf_strides){pixel * m.count, pixel, abrdf * width, abrdf, sizeof(float)};
  assert_ok(btf_dataset_create(ctx, &desc, &m.ds));
  return m;
}

static void material_release(material *m) {
  btf_dataset_release(m->ds);
  btf_dirset_release(m->set);
}

static btf_status try_fit(btf_context *ctx, const material *m, const char *settings, const btf_job *job,
                          btf_model **out) {
  char text[512], *rest = NULL;
  btf_options *options;
  *out = NULL;
  assert_ok(btf_options_create(btf_codec_find(ctx, "cmf"), &options));
  snprintf(text, sizeof text, "%s", settings);
  for (char *word = strtok_r(text, " ", &rest); word != NULL; word = strtok_r(NULL, " ", &rest)) {
    char *value = strchr(word, '=');
    *value++ = '\0';
    assert_ok(btf_options_set(options, word, value));
  }
  const btf_status status = btf_model_fit(m->ds, btf_codec_find(ctx, "cmf"), options, job, out);
  btf_options_release(options);
  return status;
}

static btf_model *fit(btf_context *ctx, const material *m, const char *settings) {
  btf_model *model;
  assert_ok(try_fit(ctx, m, settings, NULL, &model));
  return model;
}

static double squared_error(const btf_model *model, const material *m) {
  double error = 0.0;
  size_t i = 0;
  for (uint32_t y = 0; y < m->height; y++)
    for (uint32_t x = 0; x < m->width; x++)
      for (uint32_t v = 0; v < m->count; v++)
        for (uint32_t l = 0; l < m->count; l++) {
          float out[64];
          btf_model_texel(model, 0, x, y, l, v, out);
          for (uint32_t c = 0; c < m->channels; c++, i++) {
            assert_true(isfinite(out[c]));
            const double d = (double)out[c] - (double)m->samples[i];
            error += d * d;
          }
        }
  return error;
}

static double relative_error(const btf_model *model, const material *m) {
  const size_t n = (size_t)m->count * m->count * m->channels * m->width * m->height;
  double energy = 0.0;
  for (size_t i = 0; i < n; i++) energy += (double)m->samples[i] * (double)m->samples[i];
  return sqrt(squared_error(model, m) / energy);
}

static const btfi_cmf_state *state_of(const btf_model *model) {
  return model->state;
}

static uint64_t chunk_bytes(const btf_model *model, uint32_t tag) {
  uint64_t sum = 0;
  for (uint32_t i = 0; i < btfi_payload_chunk_count(model->payload); i++) {
    btfi_chunk chunk;
    assert_ok(btfi_payload_chunk(model->payload, i, &chunk));
    if (chunk.tag == tag) sum += chunk.size;
  }
  return sum;
}

/* ---- FOM01 ---- */

/* 256 entries x 3 factors x 3 channels x 32 x 32 bytes are 2.25 MiB; so are the factors of 16 x 16 texels;
 * those of 64 x 64 are 36 MiB. */
static void test_sizes(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material small = material_create(ctx, ROTATED, "grid:5x3", 17, 16, 3);
  material square = material_create(ctx, ROTATED, "grid:4x2", 16, 16, 3);
  material large = material_create(ctx, BUMPS, "grid:3x1", 64, 64, 3);
  btf_model *clustered = fit(ctx, &small, "codebook=256 levels=1 resolution=8");
  btf_model *own = fit(ctx, &square, "codebook=0 levels=1 resolution=8");
  btf_model *many = fit(ctx, &large, "codebook=0 levels=1 resolution=4 sweeps=0");
  assert_int_equal(chunk_bytes(clustered, CMF_TAG_MAPS), 2359296);
  assert_int_equal(chunk_bytes(clustered, CMF_TAG_INDEX), 3 * 17 * 16);
  assert_int_equal(chunk_bytes(clustered, CMF_TAG_SCALE), 3 * 17 * 16);
  assert_int_equal(chunk_bytes(own, CMF_TAG_MAPS), 2359296);
  assert_int_equal(chunk_bytes(many, CMF_TAG_MAPS), 36 * 1048576);
  btf_model_release(clustered);
  btf_model_release(own);
  btf_model_release(many);
  material_release(&small);
  material_release(&square);
  material_release(&large);
  test_context_done(ctx, &memory);
}

/* ---- FAC09 ---- */

static void test_normalisation(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:8x4", 4, 4, 3);
  btf_model *exact = fit(ctx, &m, "codebook=0 storage=f32 levels=1");
  btf_model *bytes = fit(ctx, &m, "codebook=0 storage=u8 levels=1");
  btf_model *halves = fit(ctx, &m, "codebook=0 storage=f16 levels=1");
  /* In float, normalising changes nothing: the decoded error is that of the maps as they were factored. */
  btfi_cmf_settings settings = {.residue = CMF_WEIGHTED,
                                .grid = CMF_ANGULAR,
                                .resolution = 32,
                                .edge = 32,
                                .sweeps = 1,
                                .epsilon = 1e-3};
  btfi_cmf_geometry *g;
  btfi_cmf_report report = {0};
  assert_null(btfi_cmf_parse_chain("h,io", &settings));
  assert_ok(btfi_cmf_geometry_create(btfi_host(), ctx, &settings, m.set, m.set, 1u << 30, &g));
  void *scratch = aligned_alloc(64, g->scratch_bytes);
  float *maps = malloc(sizeof *maps * g->factors * g->map_texels * 3);
  for (uint32_t t = 0; t < 16; t++)
    btfi_cmf_factor_abrdf(g, 3, m.samples + (size_t)t * m.count * m.count * 3, scratch, maps, &report);
  /* Sums of a few thousand floats, and lookups in float instead of double. */
  assert_relative(squared_error(exact, &m), report.squared_error, 1e-3);
  free(maps);
  free(scratch);
  btfi_cmf_geometry_free(btfi_host(), ctx, g);
  /* A value is G s p q r with s, p, q, r within 0 .. 1 and each off by at most half a step of 1 / 255: the
   * product by at most 4 of them (three for the factors as in the paper, one for the scale), to first order
   * from above since the others are at most 1 + half a step. Halves: 2^-11 relative, so at most that
   * absolute. */
  for (uint32_t i = 0; i < 16 * m.count * m.count; i++) {
    const uint32_t light = i % m.count, view = i / m.count % m.count, t = i / m.count / m.count;
    float a[3], b[3], c[3];
    btf_model_texel(exact, 0, t % 4, t / 4, light, view, a);
    btf_model_texel(bytes, 0, t % 4, t / 4, light, view, b);
    btf_model_texel(halves, 0, t % 4, t / 4, light, view, c);
    for (int k = 0; k < 3; k++) {
      const double most = (double)state_of(exact)->global[k];
      assert_near(b[k], a[k], most * 4.0 * 0.5 / 255.0 * 1.01);
      assert_near(c[k], a[k], most * 4.0 / 2048.0 * 1.01);
    }
  }
  btf_model_release(exact);
  btf_model_release(bytes);
  btf_model_release(halves);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ---- evaluation: INT02, INT03 ---- */

static btf_query query_of(float u, float v, float lod) {
  btf_query q = {{0}, {0}, {u, v}, lod, 0};
  draw_direction(q.light);
  draw_direction(q.view);
  return q;
}

static const char *const cases[] = {
    "codebook=8 levels=0",
    "codebook=0 storage=f16 chain=hd:2,io:2 resolution=6 sweeps=0",
    "codebook=300 storage=f32 method=nonnegative chain=h,io:2 cluster=tree",
    "codebook=6 rotate=1 factors=4 resolution=6 storage=f16 cluster=mediancut",
    "codebook=0 method=homomorphic edge=12",
    "codebook=5 edge=9 average=uniform grid=parabolic residue=ratio symmetric=1 chain=h,io samples=20",
};
enum { CASES = sizeof cases / sizeof *cases };

/* Colours of whole texels are blended, of two levels as well: indices are never filtered. */
static void test_blends_texels(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:5x3", 8, 4, 3);
  for (size_t i = 0; i < CASES; i++) {
    btf_model *model = fit(ctx, &m, cases[i]);
    for (int n = 0; n < 60; n++) {
      const btf_query q = query_of(draw(), draw(), n % 2 ? 2.5f * draw() : 0.0f);
      btf_texel_set set;
      float got[3];
      double expected[3] = {0.0, 0.0, 0.0}, most = 0.0;
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, got);
      btf_sampling_texels(q.uv, q.lod, 0, 8, 4, BTF_WRAP_PERIODIC, state_of(model)->levels, &set);
      for (uint32_t t = 0; t < set.count; t++) {
        btf_query at = q;
        float value[3];
        at.uv[0] = ((float)set.x[t] + 0.5f) / (float)btf_sampling_level_size(8, set.level[t]);
        at.uv[1] = ((float)set.y[t] + 0.5f) / (float)btf_sampling_level_size(4, set.level[t]);
        at.lod = (float)set.level[t];
        btf_model_eval_as(model, &at, BTF_VALUE_STORED, value);
        for (int c = 0; c < 3; c++) {
          expected[c] += (double)set.weight[t] * (double)value[c];
          most = fmax(most, fabs((double)value[c]));
        }
      }
      /* Eight products and sums of floats. */
      for (int c = 0; c < 3; c++) assert_near(got[c], expected[c], 1e-6 * most);
    }
    /* At the directions of the data, evaluation and decoding are the same. */
    const float *xyz = btf_dirset_directions(m.set);
    for (uint32_t l = 0; l < m.count; l++) {
      btf_query q = query_of(2.5f / 8.0f, 1.5f / 4.0f, 0.0f);
      float a[3], b[3];
      memcpy(q.light, xyz + 3 * l, sizeof q.light);
      memcpy(q.view, xyz + 3 * ((l + 4) % m.count), sizeof q.view);
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, a);
      btf_model_texel(model, 0, 2, 1, l, (l + 4) % m.count, b);
      assert_memory_equal(a, b, sizeof a);
      q.flags = BTF_QUERY_NEAREST;
      btf_model_eval_as(model, &q, BTF_VALUE_STORED, a);
      assert_memory_equal(a, b, sizeof a);
    }
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

enum { QUERIES = 200 };

static void make_queries(btf_query *queries) {
  const float strange[] = {NAN, INFINITY, -INFINITY, 1e38f, -1e-42f, 0.0f, -1.0f};
  for (uint32_t n = 0; n < QUERIES; n++) {
    queries[n] = query_of(4.0f * draw() - 2.0f, 4.0f * draw() - 2.0f, n % 3 ? 0.0f : 6.0f * draw() - 1.0f);
    if (n % 4 == 1) memcpy(&queries[n], &queries[n - 1], 6 * sizeof(float));
    if (n % 9 == 5) ((float *)(void *)&queries[n])[n / 9 % 9] = strange[n / 9 % 7];
  }
}

static void eval_batch(const btf_model *model, const btf_query *queries, size_t count, uint32_t flags,
                       float **out) {
  static float columns[9][QUERIES];
  btf_batch batch = BTF_BATCH_INIT;
  batch.count = count;
  batch.flags = flags;
  for (size_t i = 0; i < count; i++)
    for (int k = 0; k < 9; k++) columns[k][i] = ((const float *)(const void *)&queries[i])[k];
  for (int k = 0; k < 3; k++) {
    batch.light[k] = columns[k];
    batch.view[k] = columns[3 + k];
  }
  batch.uv[0] = columns[6];
  batch.uv[1] = columns[7];
  batch.lod = columns[8];
  btf_model_eval_n(model, &batch, BTF_VALUE_STORED, out);
}

/* Batches equal single queries bit for bit, and all instruction sets agree with the scalar reference to
 * rounding. */
static void test_batches_and_instruction_sets(void **unused) {
  (void)unused;
  static btf_query queries[QUERIES];
  static float reference[QUERIES][8], columns[8][QUERIES];
  const char *const sets[] = {"scalar", "avx2", "avx512", "neon"};
  const uint32_t channels[CASES] = {3, 1, 5, 4, 2, 8};
  float *out[8];
  for (int c = 0; c < 8; c++) out[c] = columns[c];
  make_queries(queries);
  for (size_t i = 0; i < CASES; i++) {
    btf_context *ctx = test_context(&memory);
    material m = material_create(ctx, BUMPS, "grid:5x3", 7, 4, channels[i]);
    btf_model *fitted = fit(ctx, &m, cases[i]);
    const char *path = test_path("model.btfz");
    double most = 0.0;
    assert_ok(btf_model_save(fitted, path, 0, NULL, NULL));
    for (uint32_t c = 0; c < channels[i]; c++) most = fmax(most, (double)state_of(fitted)->global[c]);
    for (uint32_t k = 1; k < state_of(fitted)->scales; k++)
      for (uint32_t c = 0; c < channels[i]; c++)
        most *= c == 0 ? 1.0 + (double)state_of(fitted)->global[k * channels[i]] : 1.0;
    for (size_t isa = 0; isa < 4; isa++) {
      btf_context_desc desc = BTF_CONTEXT_DESC_INIT;
      btf_context *other;
      btf_model *model;
      desc.isa = sets[isa];
      if (btf_context_create(&desc, &other) != BTF_OK) continue;
      assert_ok(btf_model_load(other, path, &model));
      for (uint32_t flags = 0; flags < 2; flags++) {
        for (size_t count = 0; count <= QUERIES; count = count < 12 ? count + 1 : count + 94) {
          eval_batch(model, queries, count, flags ? BTF_QUERY_NEAREST : 0, out);
          for (size_t n = 0; n < count; n++) {
            float single[8];
            queries[n].flags = flags ? BTF_QUERY_NEAREST : 0;
            btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, single);
            for (uint32_t c = 0; c < channels[i]; c++)
              assert_memory_equal(&single[c], &columns[c][n], sizeof(float));
          }
        }
      }
      for (size_t n = 0; n < QUERIES; n++) {
        float got[8];
        queries[n].flags = n % 3 == 2 ? BTF_QUERY_NEAREST : 0;
        btf_model_eval_as(model, &queries[n], BTF_VALUE_STORED, got);
        if (isa == 0) memcpy(reference[n], got, sizeof got);
        /* Factors are at most 1 and take 4 products and sums each, 8 factors and 8 texels at most: 48
         * roundings of 2^-24 of the largest possible value. */
        for (uint32_t c = 0; c < channels[i]; c++) {
          assert_true(isfinite(got[c]));
          assert_near(got[c], reference[n][c], most * 48.0 / 16777216.0);
        }
      }
      btf_model_release(model);
      btf_context_release(other);
    }
    btf_model_release(fitted);
    material_release(&m);
    test_context_done(ctx, &memory);
  }
}

/* ---- codebooks: FAC12 to FAC14 ---- */

static void test_codebooks(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:6x3", 12, 12, 3);
  btf_model *own = fit(ctx, &m, "codebook=0 levels=1 edge=16");
  const double least = relative_error(own, &m);
  const char *const kinds[] = {"kmeans", "tree", "mediancut"};
  btf_model_release(own);
  for (int k = 0; k < 3; k++) {
    double before = INFINITY;
    for (uint32_t entries = 4; entries <= 256; entries *= 8) {
      char settings[96];
      snprintf(settings, sizeof settings, "codebook=%u cluster=%s levels=1 edge=16", entries, kinds[k]);
      btf_model *model = fit(ctx, &m, settings);
      const double error = relative_error(model, &m);
      print_message("%s: relative error %.4f; own maps %.4f\n", settings, error, least);
      assert_true(error < before * 1.001);
      before = error;
      btf_model_release(model);
    }
    /* One entry for each texel. */
    assert_near(before, least, 2e-3);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Copies of four ABRDFs at all angles: turned first, a quarter of the entries does as well. */
static void test_rotation_shrinks_codebooks(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, ROTATED, "grid:12x4", 10, 10, 1);
  btf_model *turned = fit(ctx, &m, "codebook=4 rotate=1 levels=1 resolution=16 edge=16");
  btf_model *few = fit(ctx, &m, "codebook=4 levels=1 resolution=16 edge=16");
  btf_model *many = fit(ctx, &m, "codebook=16 levels=1 resolution=16 edge=16");
  const double a = relative_error(turned, &m), b = relative_error(few, &m), c = relative_error(many, &m);
  print_message("turned, 4 entries: %.4f; not turned, 4: %.4f, 16: %.4f\n", a, b, c);
  assert_true(a <= c);
  assert_true(a < 0.6 * b);
  btf_model_release(turned);
  btf_model_release(few);
  btf_model_release(many);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* ---- levels: INT04 ---- */

/* Coarser levels are fits of averaged ABRDFs, so a data set of those averages has the same finest level. */
static void test_levels_are_refits(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:6x3", 8, 8, 3),
           half = material_create(ctx, ZERO, "grid:6x3", 4, 4, 3);
  const size_t length = (size_t)m.count * m.count * 3;
  for (size_t t = 0; t < 16; t++)
    for (size_t i = 0; i < length; i++) {
      const float *from = m.samples + ((t / 4 * 2) * 8 + t % 4 * 2) * length + i;
      half.samples[t * length + i] = (float)(0.25 * ((double)from[0] + (double)from[length] +
                                                     (double)from[8 * length] + (double)from[9 * length]));
    }
  btf_model *fine = fit(ctx, &m, "codebook=0 storage=f32"),
            *coarse = fit(ctx, &half, "codebook=0 storage=f32");
  assert_int_equal(state_of(fine)->levels, 4);
  for (uint32_t i = 0; i < 16 * m.count * m.count; i++) {
    const uint32_t light = i % m.count, view = i / m.count % m.count, t = i / m.count / m.count;
    float a[3], b[3];
    btf_model_texel(fine, 1, t % 4, t / 4, light, view, a);
    btf_model_texel(coarse, 0, t % 4, t / 4, light, view, b);
    /* Averages differ by rounding, by which the few turns of alternating least squares may differ as well. */
    for (int c = 0; c < 3; c++) assert_near(a[c], b[c], 1e-4 * (double)state_of(coarse)->global[c]);
  }
  btf_model_release(fine);
  btf_model_release(coarse);
  material_release(&m);
  material_release(&half);
  test_context_done(ctx, &memory);
}

/* ---- edge cases, budgets, cancelling ---- */

static void test_edge_cases(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  const struct {
    int kind;
    const char *directions;
    uint32_t width, height, channels;
    double error; /* largest relative error; 0 for data of 0 */
  } materials[] = {{BUMPS, "one", 3, 1, 3, 0.02},
                   {ZERO, "grid:4x2", 2, 3, 3, 0.0},
                   {CONSTANT, "grid:5x3", 1, 1, 4, 0.02},
                   {BUMPS, "grid:4x2", 5, 1, 1, 0.9},
                   {CONSTANT, "grid:4x2", 3, 2, 64, 0.02}};
  for (size_t i = 0; i < sizeof materials / sizeof *materials; i++) {
    material m = material_create(ctx, materials[i].kind, materials[i].directions, materials[i].width,
                                 materials[i].height, materials[i].channels);
    for (size_t k = 0; k < CASES; k++) {
      char settings[160];
      snprintf(settings, sizeof settings, "%s resolution=6 edge=10", cases[k]);
      btf_model *model = fit(ctx, &m, settings);
      if (materials[i].error == 0.0)
        assert_true(squared_error(model, &m) == 0.0);
      else if (k != 5) /* cells below the horizon count as 0 in the mean */
        assert_true(relative_error(model, &m) < materials[i].error);
      else
        (void)relative_error(model, &m);
      btf_model_release(model);
    }
    material_release(&m);
  }
  test_context_done(ctx, &memory);
}

static int32_t cancel_late(void *user, double fraction, const char *stage) {
  (void)stage;
  return fraction > *(const double *)user;
}

/* Under a small budget texels are factored in runs; too small a one is refused; cancelling leaves nothing
 * behind. */
static void test_budgets(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  /* The factors of 600 texels are 1.3 MiB, of which about two thirds fit. */
  material m = material_create(ctx, BUMPS, "grid:5x3", 24, 20, 3);
  const char *settings = "codebook=8 resolution=8 levels=2 edge=16 samples=200";
  btf_model *roomy = fit(ctx, &m, settings), *model;
  const double error = relative_error(roomy, &m);
  btf_job job = BTF_JOB_INIT;
  job.max_working_set = 1700u << 10;
  assert_ok(try_fit(ctx, &m, settings, &job, &model));
  /* Another choice of texels to learn from. */
  assert_true(relative_error(model, &m) < 1.25 * error);
  btf_model_release(model);
  job.max_working_set = 4096;
  assert_status(try_fit(ctx, &m, settings, &job, &model), BTF_E_LIMIT);
  assert_message_has("working set");
  job = (btf_job)BTF_JOB_INIT;
  for (double at = 0.0; at < 0.95; at += 0.3) {
    job.progress = cancel_late;
    job.user = &at;
    assert_status(try_fit(ctx, &m, settings, &job, &model), BTF_E_CANCELLED);
  }
  assert_status(try_fit(ctx, &m, "chain=hd,xy", NULL, &model), BTF_E_INVALID_ARG);
  assert_message_has("xy");
  assert_status(try_fit(ctx, &m, "chain=h,io:2 method=homomorphic", NULL, &model), BTF_E_INVALID_ARG);
  btf_model_release(roomy);
  material_release(&m);
  test_context_done(ctx, &memory);
}

/* Every allocation fails in turn. */
static void test_failing_allocations(void **unused) {
  (void)unused;
  const char *const settings[] = {"codebook=3 rotate=1 resolution=4 edge=4 factors=4",
                                  "codebook=0 method=homomorphic edge=4 levels=1"};
  for (size_t i = 0; i < 2; i++)
    for (long at = 1;; at++) {
      btf_context *ctx = test_context_with(&memory, "scalar", 1);
      material m = material_create(ctx, BUMPS, "grid:4x2", 2, 2, 1);
      btf_model *model;
      memory.total_allocations = 0;
      memory.fail_at = at;
      btf_options *options = NULL;
      btf_status status = btf_options_create(btf_codec_find(ctx, "cmf"), &options);
      if (status == BTF_OK) {
        btf_options_release(options);
        memory.total_allocations = 0;
        memory.fail_at = 0;
        char text[128];
        snprintf(text, sizeof text, "%s", settings[i]);
        char *rest = NULL;
        assert_ok(btf_options_create(btf_codec_find(ctx, "cmf"), &options));
        for (char *word = strtok_r(text, " ", &rest); word != NULL; word = strtok_r(NULL, " ", &rest)) {
          char *value = strchr(word, '=');
          *value++ = '\0';
          assert_ok(btf_options_set(options, word, value));
        }
        memory.total_allocations = 0;
        memory.fail_at = at;
        status = btf_model_fit(m.ds, btf_codec_find(ctx, "cmf"), options, NULL, &model);
        const long asked = memory.total_allocations;
        memory.fail_at = 0;
        if (status == BTF_OK) btf_model_release(model);
        btf_options_release(options);
        if (status == BTF_OK && asked < at) {
          material_release(&m);
          test_context_done(ctx, &memory);
          break;
        }
        if (status != BTF_OK) assert_int_equal(status, BTF_E_NOMEM);
      }
      memory.fail_at = 0;
      material_release(&m);
      test_context_done(ctx, &memory);
    }
}

/* ---- hostile payloads ---- */

enum { MAX_CHUNKS = 64 };

typedef struct chunk_list {
  btf_context *ctx;
  btfi_chunk chunk[MAX_CHUNKS];
  unsigned char *copy[MAX_CHUNKS]; /* of exactly the size, so that a sanitizer sees reads beyond it */
  uint32_t count;
} chunk_list;

static btf_status get_listed(btf_chunk_reader *reader, uint32_t tag, uint32_t index, const void **data,
                             uint64_t *size) {
  const chunk_list *list = (const chunk_list *)(const void *)reader;
  for (uint32_t i = 0; i < list->count; i++) {
    if (list->chunk[i].tag != tag || list->chunk[i].index != index) continue;
    *data = list->copy[i];
    *size = list->chunk[i].size;
    return BTF_OK;
  }
  return (btfi_host()->fail)(list->ctx, BTF_E_CORRUPT, "no such chunk");
}

static unsigned char *copy_of(const void *data, uint64_t size) {
  unsigned char *copy = NULL;
  assert_int_equal(posix_memalign((void **)&copy, 64, size > 0 ? size : 1), 0);
  memcpy(copy, data, size);
  return copy;
}

static btf_status try_load(btf_context *ctx, const btf_model *model, chunk_list *list) {
  btf_host host = *btfi_host();
  void *state = NULL;
  host.get = get_listed;
  const btf_status status = btf_codec_cmf.load(&host, ctx, btf_codec_cmf.format_write, &model->shape,
                                               (btf_chunk_reader *)(void *)list, &state);
  if (status != BTF_OK) {
    assert_int_equal(status, BTF_E_CORRUPT);
    assert_null(state);
    return status;
  }
  for (int i = 0; i < 12; i++) {
    btf_query q = query_of(draw(), draw(), 3.0f * draw());
    float out[64];
    q.flags = i % 4 == 0 ? BTF_QUERY_NEAREST : 0;
    btf_codec_cmf.eval(state, &q, out);
    for (uint32_t c = 0; c < model->shape.channels; c++) assert_true(isfinite(out[c]));
    btf_codec_cmf.texel(state, btf_codec_cmf.levels(state) - 1, 0, 0, 1, 2, out);
  }
  btf_codec_cmf.destroy(&host, ctx, state);
  return BTF_OK;
}

static void test_hostile_payloads(void **unused) {
  (void)unused;
  btf_context *ctx = test_context(&memory);
  material m = material_create(ctx, BUMPS, "grid:4x2", 4, 3, 3);
  for (size_t k = 0; k < CASES; k++) {
    char settings[160];
    snprintf(settings, sizeof settings, "%s resolution=6 edge=16 levels=2", cases[k]);
    btf_model *model = fit(ctx, &m, settings);
    chunk_list list = {.ctx = ctx, .count = btfi_payload_chunk_count(model->payload)};
    assert_true(list.count <= MAX_CHUNKS);
    for (uint32_t i = 0; i < list.count; i++) {
      assert_ok(btfi_payload_chunk(model->payload, i, &list.chunk[i]));
      list.copy[i] = copy_of(list.chunk[i].data, list.chunk[i].size);
    }
    assert_ok(try_load(ctx, model, &list));
    for (uint32_t i = 0; i < list.count; i++) {
      const btfi_chunk whole = list.chunk[i];
      unsigned char *copy = list.copy[i];
      list.chunk[i].tag = 0;
      assert_status(try_load(ctx, model, &list), BTF_E_CORRUPT);
      list.chunk[i].tag = whole.tag;
      const uint64_t sizes[] = {0, 1, whole.size / 2 + 1, whole.size - 1, whole.size + 1};
      for (size_t n = 0; n < 5; n++) {
        if (sizes[n] == whole.size) continue;
        list.copy[i] = calloc(1, sizes[n] + 1);
        list.chunk[i].size = sizes[n];
        memcpy(list.copy[i], copy, sizes[n] < whole.size ? sizes[n] : whole.size);
        assert_status(try_load(ctx, model, &list), BTF_E_CORRUPT);
        free(list.copy[i]);
      }
      list.copy[i] = copy;
      list.chunk[i] = whole;
      /* Any single changed byte is refused or harmless. */
      for (uint64_t at = 0; at<whole.size; at += whole.size> 200 ? whole.size / 23 + 1 : 1) {
        const unsigned char was = copy[at], wild[] = {0xff, 0x7f, 0x80, (unsigned char)(was ^ 1)};
        for (size_t n = 0; n < 4; n++) {
          copy[at] = wild[n];
          (void)try_load(ctx, model, &list);
        }
        copy[at] = was;
      }
    }
    assert_ok(try_load(ctx, model, &list));
    for (uint32_t i = 0; i < list.count; i++) free(list.copy[i]);
    btf_model_release(model);
  }
  material_release(&m);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_sizes),
      cmocka_unit_test(test_normalisation),
      cmocka_unit_test(test_blends_texels),
      cmocka_unit_test(test_batches_and_instruction_sets),
      cmocka_unit_test(test_codebooks),
      cmocka_unit_test(test_rotation_shrinks_codebooks),
      cmocka_unit_test(test_levels_are_refits),
      cmocka_unit_test(test_edge_cases),
      cmocka_unit_test(test_budgets),
      cmocka_unit_test(test_failing_allocations),
      cmocka_unit_test(test_hostile_payloads),
  };
  return btf_run("cmf", tests);
}
