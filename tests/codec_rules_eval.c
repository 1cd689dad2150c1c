/* SPDX-License-Identifier: MIT */
/* Rules of what a fitted model is and how it evaluates. */
#include "codec_rules.h"

#include <btf/btf_sampling.h>

/* ---- what is fitted ---- */

static void expect_sane(const codec_case *row, const btf_model *model, uint32_t material, uint32_t channels) {
  const codec_material *m = &codec_materials[material];
  const btf_model_info info = rule_describe(model);
  uint32_t levels = 1;
  while ((m->width | m->height) >> levels) levels++;
  assert_string_equal(info.codec_id, row->codec);
  assert_int_equal(info.width, m->width);
  assert_int_equal(info.height, m->height);
  assert_int_equal(info.channels, channels);
  assert_int_equal(info.quantity, m->quantity);
  assert_int_equal(info.wrap, m->wrap);
  assert_string_equal(info.name, m->name);
  assert_in_range(info.levels, 1, info.caps & BTF_CAP_LOD ? levels : 1);
  assert_int_equal((uint64_t)btf_dirset_count(info.lights) * btf_dirset_count(info.views) * m->width *
                       m->height * channels,
                   codec_material_samples(material, channels));
  assert_true(info.resident_bytes > 0);
  assert_int_equal(info.stored_bytes, 0);
}

static void materials(const codec_case *row) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  for (uint32_t channels = codec_case_channels(row, 1); channels != 0;
       channels = codec_case_channels(row, channels + 1))
    for (uint32_t material = 0; material < MATERIAL_TINY; material++) {
      btf_model *model = rule_fit(ctx, row, material, channels, NULL);
      double rms, rmse;
      if (model == NULL) continue;
      expect_sane(row, model, material, channels);
      rule_errors(model, material, 0, &rms, &rmse);
      /* Black has nothing to be relative to; its rounding is that of a value of 1. */
      const double bound = row->rmse * (rms > 0.0 ? rms : 1e-6);
      if (!(rmse <= bound))
        fail_msg("%s, %u channels: relative error %.3g of a norm of %.3g, expected at most %.3g",
                 codec_materials[material].name, channels, rmse / (rms > 0.0 ? rms : 1e-6), rms, row->rmse);
      for (uint32_t i = 0; i < 200; i++) {
        const btf_query q = codec_case_query(i);
        float f[RULE_CHANNELS];
        btf_model_eval(model, &q, f);
        for (uint32_t c = 0; c < channels; c++) assert_true(isfinite(f[c]));
      }
      btf_model_release(model);
    }
  test_context_done(ctx, &memory);
}

static void levels_are_averages(const codec_case *row) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  btf_model *model = rule_fit(ctx, row, MATERIAL_SMOOTH, codec_case_channels(row, 1), NULL);
  const btf_model_info info = rule_describe(model);
  for (uint32_t level = 1; level < info.levels; level++) {
    double rms, rmse;
    rule_errors(model, MATERIAL_SMOOTH, level, &rms, &rmse);
    if (!(rmse <= row->level_rmse * rms))
      fail_msg("level %u: relative error %.3g, expected at most %.3g", level, rmse / rms, row->level_rmse);
  }
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* ---- storing ---- */

static void stored_evaluates_alike(const codec_case *row) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  for (uint32_t channels = codec_case_channels(row, 1); channels != 0;
       channels = codec_case_channels(row, channels + 1)) {
    btf_model *model = rule_fit(ctx, row, MATERIAL_SMOOTH, channels, NULL), *loaded;
    rule_file first, second;
    btf_file *file;
    rule_save(ctx, model, &first);
    loaded = rule_load(ctx, &first);
    rule_expect_equal(model, loaded);
    assert_true(rule_describe(loaded).stored_bytes > 0 && rule_describe(loaded).stored_bytes < first.size);
    assert_int_equal(rule_describe(loaded).resident_bytes, rule_describe(model).resident_bytes);
    /* What was stored can be stored again, and is the same file. */
    rule_save(ctx, loaded, &second);
    assert_int_equal(first.size, second.size);
    assert_memory_equal(first.bytes, second.bytes, first.size);
    btf_model_release(loaded);
    free(first.bytes);
    free(second.bytes);
    assert_ok(btf_model_save(model, test_path("rule.btfz"), 0, "a test", NULL));
    for (uint32_t trust = 0; trust < 2; trust++) {
      assert_ok(btf_file_open_path(ctx, test_path("rule.btfz"), trust ? BTF_OPEN_TRUST : 0, &file));
      assert_ok(btf_file_load_model(file, 0, &loaded));
      btf_file_close(file); /* the model keeps the mapping */
      rule_expect_equal(model, loaded);
      btf_model_release(loaded);
    }
    btf_model_release(model);
  }
  test_context_done(ctx, &memory);
}

/* ---- evaluation ---- */

static int inside_domain(const btf_query *q) {
  int finite = isfinite(q->uv[0]) && isfinite(q->uv[1]) && isfinite(q->lod);
  for (int k = 0; k < 3; k++) finite = finite && isfinite(q->light[k]) && isfinite(q->view[k]);
  return finite && q->light[2] > 0.0f && q->view[2] > 0.0f;
}

static void check_batch(const btf_model *model, rule_batch *b, uint32_t first, uint32_t flags, int32_t value,
                        size_t count, int with_lod) {
  const uint32_t channels = rule_describe(model).channels;
  rule_batch_make(b, first, flags);
  b->batch.count = count;
  if (!with_lod) b->batch.lod = NULL;
  btf_model_eval_n(model, &b->batch, value, b->out);
  for (uint32_t i = 0; i < RULE_QUERIES; i++) {
    btf_query q = codec_case_query(first + i);
    float single[RULE_CHANNELS];
    q.flags = flags;
    if (!with_lod) q.lod = 0.0f;
    btf_model_eval_as(model, &q, value, single);
    for (uint32_t c = 0; c < channels; c++) {
      if (i >= count) {
        assert_memory_equal(&b->results[c][i], "\xee\xee\xee\xee", 4);
        continue;
      }
      if (memcmp(&single[c], &b->results[c][i], sizeof(float)) != 0)
        fail_msg("query %u channel %u: %.9g single, %.9g in a batch", i, c, (double)single[c],
                 (double)b->results[c][i]);
      assert_true(isfinite(single[c]));
      if (!inside_domain(&q)) assert_true(single[c] == 0.0f && !signbit(single[c]));
    }
  }
}

static void batch_equals_single(const codec_case *row) {
  static const char *const isas[] = {"scalar", NULL};
  static const size_t counts[] = {RULE_QUERIES, 1, 3, 17, 0};
  static rule_batch b;
  for (int i = 0; i < 2; i++) {
    test_memory memory;
    btf_context *ctx = rule_context(&memory, isas[i], 2);
    for (uint32_t channels = codec_case_channels(row, 1); channels != 0;
         channels = codec_case_channels(row, channels + 1)) {
      btf_model *model = rule_fit(ctx, row, i == 0 ? MATERIAL_SMOOTH : MATERIAL_COSINE, channels, NULL);
      if (model == NULL) continue;
      for (int32_t value = 0; value < 3; value++)
        for (uint32_t flags = 0; flags < 2; flags++)
          check_batch(model, &b, (uint32_t)value * 977, flags, value, RULE_QUERIES, value != 1);
      for (size_t k = 0; k < sizeof counts / sizeof *counts; k++)
        check_batch(model, &b, 40, 0, BTF_VALUE_STORED, counts[k], 1);
      btf_model_release(model);
    }
    test_context_done(ctx, &memory);
  }
}

static void evaluation_allocates_nothing(const codec_case *row) {
  static rule_batch b;
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  btf_model *model = rule_fit(ctx, row, MATERIAL_SMOOTH, codec_case_channels(row, 1), NULL);
  const long before = memory.total_allocations;
  (void)rule_largest(model);
  for (uint32_t flags = 0; flags < 2; flags++) {
    rule_batch_make(&b, 0, flags);
    btf_model_eval_n(model, &b.batch, BTF_VALUE_BRDF, b.out);
    for (uint32_t i = 0; i < RULE_QUERIES; i++) {
      btf_query q = codec_case_query(i);
      const float xi[3] = {0.3f, 0.6f, 0.9f};
      float f[RULE_CHANNELS], light[3];
      q.flags = flags;
      btf_model_eval(model, &q, f);
      (void)btf_model_sample(model, &q, xi, light, f);
      (void)btf_model_pdf(model, &q);
    }
  }
  assert_int_equal(memory.total_allocations, before);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

static void scalar_equals_vector(const codec_case *row) {
  static const char *const isas[] = {"avx2", "avx512", NULL};
  test_memory memory, other_memory;
  btf_context *ctx = rule_context(&memory, "scalar", 2);
  btf_model *model = rule_fit(ctx, row, MATERIAL_SMOOTH, codec_case_channels(row, 3), NULL);
  const double largest = rule_largest(model);
  rule_file file;
  rule_save(ctx, model, &file);
  for (int i = 0; i < 3; i++) {
    btf_context *other = rule_context(&other_memory, isas[i], 2);
    btf_model *loaded = rule_load(other, &file);
    const double difference = rule_difference(model, loaded);
    if (!(difference <= row->isa * largest))
      fail_msg("%s differs by %.3g of the largest value, expected at most %.3g", btf_context_isa(other),
               difference / largest, row->isa);
    btf_model_release(loaded);
    test_context_done(other, &other_memory);
  }
  free(file.bytes);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* At sample directions and texel centres of a level, nearest and interpolated evaluation are the decoded
 * sample. */
static void samples_are_met(const codec_case *row) {
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  btf_model *model = rule_fit(ctx, row, MATERIAL_SMOOTH, codec_case_channels(row, 3), NULL);
  const btf_model_info info = rule_describe(model);
  /* One rounding each of weights and sums where the sum is another, and what row->isa allows for kernels. */
  const double tolerance = (1e-6 + row->isa) * rule_largest(model);
  for (uint32_t level = 0; level < info.levels; level++) {
    const uint32_t width = btf_sampling_level_size(info.width, level),
                   height = btf_sampling_level_size(info.height, level);
    for (uint32_t i = 0; i < width * height; i++)
      for (uint32_t view = 0; view < btf_dirset_count(info.views); view++)
        for (uint32_t light = 0; light < btf_dirset_count(info.lights); light++)
          for (uint32_t flags = 0; flags < 2; flags++) {
            const uint32_t x = i % width, y = i / width;
            btf_query q = {.lod = (float)level, .flags = flags};
            float sample[RULE_CHANNELS], f[RULE_CHANNELS];
            memcpy(q.light, btf_dirset_directions(info.lights) + 3 * (size_t)light, sizeof q.light);
            memcpy(q.view, btf_dirset_directions(info.views) + 3 * (size_t)view, sizeof q.view);
            q.uv[0] = (float)((x + 0.5) / width);
            q.uv[1] = (float)((y + 0.5) / height);
            btf_model_texel(model, level, x, y, light, view, sample);
            btf_model_eval_as(model, &q, BTF_VALUE_STORED, f);
            for (uint32_t c = 0; c < info.channels; c++)
              if (!(fabs((double)f[c] - sample[c]) <= tolerance))
                fail_msg("%s at level %u, texel %u %u, light %u, view %u: %.9g, the sample is %.9g",
                         flags ? "nearest" : "interpolated", level, x, y, light, view, (double)f[c],
                         (double)sample[c]);
          }
  }
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* Between the samples a model is close to the data interpolated. The grids are coarse, so that methods which
 * interpolate otherwise may differ by some hundredths. */
static void interpolation_follows_the_data(const codec_case *row) {
  const codec_dataset_recipe recipe = {
      MATERIAL_SMOOTH, codec_case_channels(row, 3), SOURCE_RESIDENT, 0, 0.0f, 0.0f};
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  btf_model *model = rule_fit(ctx, row, MATERIAL_SMOOTH, recipe.channels, NULL), *raw;
  btf_dataset *ds;
  double error = 0.0, square = 0.0;
  assert_ok(codec_material_dataset(ctx, &recipe, &ds));
  assert_ok(btf_model_from_dataset(ds, NULL, &raw));
  for (uint32_t i = 0; i < RULE_QUERIES; i++) {
    const btf_query q = codec_case_plain_query(i, 0.0f);
    float got[RULE_CHANNELS], expected[RULE_CHANNELS];
    btf_model_eval(model, &q, got);
    btf_model_eval(raw, &q, expected);
    for (uint32_t c = 0; c < recipe.channels; c++) {
      square += (double)expected[c] * expected[c];
      error += ((double)got[c] - expected[c]) * ((double)got[c] - expected[c]);
    }
  }
  const double bound = row->rmse + (row->between > 0.0 ? row->between : 0.08);
  if (!(sqrt(error / square) <= bound))
    fail_msg("relative difference %.3g to the data interpolated, expected at most %.3g", sqrt(error / square),
             bound);
  btf_model_release(raw);
  btf_dataset_release(ds);
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

/* Whole tiles apart, and beyond clamped borders, a position is the same place. */
static void positions_wrap(const codec_case *row) {
  static const uint32_t both[] = {MATERIAL_SMOOTH, MATERIAL_CLAMPED};
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  for (int clamped = 0; clamped < 2; clamped++) {
    btf_model *model = rule_fit(ctx, row, both[clamped], codec_case_channels(row, 1), NULL);
    const uint32_t channels = rule_describe(model).channels;
    for (uint32_t i = 0; i < 500; i++) {
      btf_query q = codec_case_plain_query(i, (float)(i % 5) * 0.5f);
      float one[RULE_CHANNELS], other[RULE_CHANNELS];
      q.flags = i % 3 == 0;
      /* Multiples of 1/64 keep all their bits when a tile is added. */
      q.uv[0] = clamped ? (float)(i & 1) : floorf(64.0f * q.uv[0]) / 64.0f;
      q.uv[1] = clamped ? (float)(i >> 1 & 1) : floorf(64.0f * q.uv[1]) / 64.0f;
      btf_model_eval(model, &q, one);
      if (clamped) {
        for (int k = 0; k < 2; k++) q.uv[k] = q.uv[k] > 0.0f ? 1.75f : -0.4f;
      } else {
        q.uv[0] += 3.0f;
        q.uv[1] -= 2.0f;
      }
      btf_model_eval(model, &q, other);
      assert_memory_equal(one, other, channels * sizeof *one);
    }
    btf_model_release(model);
  }
  test_context_done(ctx, &memory);
}

/* Evaluation is continuous in the level of detail: over a step h no method can change by more than 2 M h plus
 * rounding while it goes from one level to the next, where M is the largest value of any level, and a little
 * more where it interpolates what it does not hold. */
static void detail_is_continuous(const codec_case *row) {
  enum { STEPS = 24 };
  const double h = 1.0 / 2048;
  test_memory memory;
  btf_context *ctx = rule_context(&memory, NULL, 2);
  btf_model *model = rule_fit(ctx, row, MATERIAL_SMOOTH, codec_case_channels(row, 3), NULL);
  const btf_model_info info = rule_describe(model);
  const double largest = rule_largest(model), most = (4.0 * h + 4e-6 + row->isa) * largest;
  for (uint32_t i = 0; i < 100; i++)
    for (int place = -1; place <= (int)(2 * info.levels); place++) { /* around whole and half levels */
      float before[RULE_CHANNELS] = {0};
      for (int step = -STEPS / 2; step <= STEPS / 2; step++) {
        const btf_query q = codec_case_plain_query(i, (float)(0.5 * place + step * h));
        float f[RULE_CHANNELS];
        btf_model_eval(model, &q, f);
        for (uint32_t c = 0; c < info.channels; c++) {
          if (step > -STEPS / 2 && !(fabs((double)f[c] - before[c]) <= most))
            fail_msg("at lod %.6g a step of %.3g changes %.9g to %.9g", (double)q.lod, h, (double)before[c],
                     (double)f[c]);
          before[c] = f[c];
        }
      }
    }
  /* Beyond the first and the last level nothing changes. */
  for (uint32_t i = 0; i < 100; i++) {
    const float beyond[2][2] = {{0.0f, -7.5f}, {(float)info.levels - 1.0f, 3e9f}};
    for (int end = 0; end < 2; end++) {
      const btf_query q = codec_case_plain_query(i, beyond[end][0]),
                      far = codec_case_plain_query(i, beyond[end][1]);
      float one[RULE_CHANNELS], other[RULE_CHANNELS];
      btf_model_eval(model, &q, one);
      btf_model_eval(model, &far, other);
      assert_memory_equal(one, other, info.channels * sizeof *one);
    }
  }
  btf_model_release(model);
  test_context_done(ctx, &memory);
}

const codec_rule codec_eval_rules[] = {
    {"materials", materials},
    {"levels are averages", levels_are_averages},
    {"stored evaluates alike", stored_evaluates_alike},
    {"batch equals single", batch_equals_single},
    {"evaluation allocates nothing", evaluation_allocates_nothing},
    {"scalar equals vector", scalar_equals_vector},
    {"samples are met", samples_are_met},
    {"interpolation follows the data", interpolation_follows_the_data},
    {"positions wrap", positions_wrap},
    {"detail is continuous", detail_is_continuous},
};
const size_t codec_eval_rule_count = sizeof codec_eval_rules / sizeof *codec_eval_rules;
