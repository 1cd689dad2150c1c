/* SPDX-License-Identifier: MIT */
/*
 * A minified checkerboard, for every codec that has levels of detail: a plane that recedes from the camera, a
 * sample a pixel, once with the level that the footprint asks for and once with the finest. What both should
 * have been is the mean of 256 samples of the finest level over each pixel.
 */
#include "btf_test.h"

enum { SIDE = 32, DIRECTIONS = 10, CHANNELS = 3, PIXELS = 48, GRID = 16 };

/* Squares of 4 texels: bright and glossy, dark and matt. */
static btf_dataset *checker(btf_context *ctx) {
  static float samples[DIRECTIONS * DIRECTIONS * SIDE * SIDE * CHANNELS];
  btf_dirset *directions;
  btf_dataset *dataset;
  btf_dataset_desc desc = BTF_DATASET_DESC_INIT;
  assert_ok(btf_dirset_create_named(ctx, "grid:5x2", &directions));
  const float *d = btf_dirset_directions(directions);
  float *f = samples;
  for (uint32_t v = 0; v < DIRECTIONS; v++)
    for (uint32_t l = 0; l < DIRECTIONS; l++)
      for (uint32_t y = 0; y < SIDE; y++)
        for (uint32_t x = 0; x < SIDE; x++)
          for (uint32_t c = 0; c < CHANNELS; c++) {
            const float mirror =
                fmaxf(0.0f, d[3 * v + 2] * d[3 * l + 2] - d[3 * v] * d[3 * l] - d[3 * v + 1] * d[3 * l + 1]);
            *f++ = (x / 4 + y / 4) % 2 != 0 ? 0.3f - 0.05f * (float)c + 0.4f * powf(mirror, 8.0f)
                                            : 0.02f + 0.01f * (float)c;
          }
  desc.lights = desc.views = directions;
  desc.width = desc.height = SIDE;
  desc.channels = CHANNELS;
  desc.data = samples;
  desc.strides.channel = sizeof(float);
  desc.strides.x = CHANNELS * desc.strides.channel;
  desc.strides.y = SIDE * desc.strides.x;
  desc.strides.light = SIDE * desc.strides.y;
  desc.strides.view = DIRECTIONS * desc.strides.light;
  assert_ok(btf_dataset_create(ctx, &desc, &dataset));
  btf_dirset_release(directions);
  return dataset;
}

/* Position in the picture (0..1 along both sides) to texture: minified 5 times in front, 16 times behind. */
static void position(double px, double py, float uv[2]) {
  const double depth = 1.0 + 2.2 * py, across = 7.5 * depth, along = 7.5 * py * (1.0 + 1.1 * py);
  uv[0] = (float)(across * (px - 0.5) + 0.1);
  uv[1] = (float)(along + 0.2);
}

static float evaluate(const btf_model *model, double px, double py, float lod) {
  btf_query query = {{0.28f, 0.0f, 0.96f}, {0.0f, -0.6f, 0.8f}, {0.0f, 0.0f}, lod, 0};
  float f[CHANNELS];
  position(px, py, query.uv);
  btf_model_eval(model, &query, f);
  return f[1];
}

/* RMS distance to the supersampled picture, with and without levels. */
static void measure(const btf_model *model, double *with, double *without) {
  const double step = 1.0 / PIXELS;
  *with = *without = 0.0;
  for (int j = 0; j < PIXELS; j++)
    for (int i = 0; i < PIXELS; i++) {
      const double px = (i + 0.5) * step, py = (j + 0.5) * step;
      float at[2], right[2], above[2];
      double mean = 0.0;
      for (int k = 0; k < GRID * GRID; k++)
        mean +=
            evaluate(model, (i + (k % GRID + 0.5) / GRID) * step, (j + (k / GRID + 0.5) / GRID) * step, 0.0f);
      mean /= GRID * GRID;
      position(px, py, at);
      position(px + step, py, right);
      position(px, py + step, above);
      const float duvdx[2] = {right[0] - at[0], right[1] - at[1]},
                  duvdy[2] = {above[0] - at[0], above[1] - at[1]};
      const double fine = evaluate(model, px, py, 0.0f) - mean,
                   filtered = evaluate(model, px, py, btf_model_lod(model, duvdx, duvdy)) - mean;
      *without += fine * fine;
      *with += filtered * filtered;
    }
  *with = sqrt(*with / (PIXELS * PIXELS));
  *without = sqrt(*without / (PIXELS * PIXELS));
}

static void levels_remove_aliasing(void **state) {
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset *dataset = checker(ctx);
  uint32_t measured = 0;
  (void)state;
  for (uint32_t i = 0; i < btf_codec_count(ctx); i++) {
    const btf_codec *codec = btf_codec_at(ctx, i);
    const uint64_t needed = BTF_CAP_FIT | BTF_CAP_LOD;
    btf_model *model;
    double with, without;
    if ((btf_codec_caps(codec) & needed) != needed) continue;
    assert_ok(btf_model_fit(dataset, codec, NULL, NULL, &model));
    measure(model, &with, &without);
    print_message("%-10s RMS to 256 samples a pixel: %.4f with levels of detail, %.4f without: %.1f dB\n",
                  btf_codec_id(codec), with, without, 20.0 * log10(without / with));
    /* LAP14. The distance to the supersampled picture is what frequencies above the picture's Nyquist have
     * been folded into, and by Parseval its square is their energy: of that 20 dB are to be gone. A pixel
     * covers from less than one square to a few: without levels a sample is black or white, which is off by
     * the contrast of the filtered picture; with them what is left is the box's shape and the two blended
     * levels. */
    assert_true(20.0 * log10(without / with) >= 20.0);
    btf_model_release(model);
    measured++;
  }
  assert_int_equal(measured, btf_codec_count(ctx)); /* all codecs here have levels */
  btf_dataset_release(dataset);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(levels_remove_aliasing)};
  return btf_run("antialiasing", tests);
}
