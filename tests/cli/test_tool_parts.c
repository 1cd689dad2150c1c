/* SPDX-License-Identifier: MIT */
/* The parts of the btf command: numbers as text, pictures, similarity, near misses. */
#include "btf_test.h"

#include <openexr.h>
#include <unistd.h>

#include "cli.h"
#include "image/image.h"
#include "metrics.h"
#include "number_text.h"
#include "parallel.h"
#include "safe_text.h"
#include "sample_walk.h"

/* ---- numbers as text ---- */

static uint64_t random_state = 88172645463325252u;
static uint64_t next_random(void) {
  random_state ^= random_state << 13;
  random_state ^= random_state >> 7;
  return random_state ^= random_state << 17;
}

static float float_of(uint32_t bits) {
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

/* The quick forms must agree with the C library's to the last character and bit. */
static void numbers_are_written_like_printf(void **state) {
  (void)state;
  for (int i = 0; i < 300000; i++) {
    const uint64_t r = next_random();
    char got[40], expected[40];
    /* Any bits; values of ordinary size; neighbours of powers of ten. */
    float value = float_of((uint32_t)r);
    if (i % 3 == 1) value = float_of((uint32_t)((113 + (r >> 40) % 44) << 23 | (r & 0x7fffff)));
    if (i % 3 == 2) {
      uint32_t bits;
      value = (float)pow(10, (int)(r % 14) - 4);
      memcpy(&bits, &value, sizeof bits);
      value = float_of(bits + (uint32_t)(r >> 32) % 9 - 4);
    }
    if (isnan(value)) continue;
    got[number_write(got, value)] = '\0';
    snprintf(expected, sizeof expected, "%.9g", (double)value);
    assert_string_equal(got, expected);
  }
}

static void numbers_are_read_like_strtof(void **state) {
  (void)state;
  for (int i = 0; i < 200000; i++) {
    const uint64_t r = next_random();
    const uint32_t bits = i % 2 ? (uint32_t)((117 + (r >> 40) % 20) << 23 | (r & 0x7fffff)) : (uint32_t)r;
    /* Every fourth lies half-way between two floats, where rounding twice would show. */
    const double value =
        i % 4 < 3 ? (double)float_of(bits) : ((double)float_of(bits) + (double)float_of(bits + 1)) / 2;
    char text[64];
    const char *p = text;
    float got = 0, expected;
    if (!isfinite(value)) continue;
    snprintf(text, sizeof text, i % 8 < 4 ? "%.*g" : "%.*e", (int)(r >> 32) % 20 + 1, value);
    expected = strtof(text, NULL);
    assert_true(number_read(&p, &got));
    assert_memory_equal(&got, &expected, sizeof got);
    assert_int_equal(*p, '\0');
  }
}

static void what_is_no_number_is_refused(void **state) {
  static const char *const wrong[] = {"",     "-",   ".",    "+",  "1e",  "1e+", "0x10",
                                      "1.5f", "--1", "1..2", "e5", "1,5", " 1",  "\n1"};
  static const char *const wrong_index[] = {"",  "-1", "+1", "1.0", "4294967296", "99999999999999999999",
                                            "x", " 1"};
  uint32_t index;
  float value;
  (void)state;
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
    const char *p = wrong[i];
    assert_false(number_read(&p, &value));
    assert_ptr_equal(p, wrong[i]);
  }
  for (size_t i = 0; i < sizeof wrong_index / sizeof *wrong_index; i++) {
    const char *p = wrong_index[i];
    assert_false(number_read_index(&p, &index));
  }
  {
    const char *p = "4294967295 ";
    assert_true(number_read_index(&p, &index));
    assert_int_equal(index, UINT32_MAX);
  }
}

/* ---- pictures ---- */

/* Files that are refused have a line each on standard error: thousands here. */
static int standard_error;
static int silence(void **state) {
  (void)state;
  fflush(stderr);
  standard_error = dup(STDERR_FILENO);
  return freopen("/dev/null", "w", stderr) != NULL && standard_error >= 0 ? 0 : -1;
}
static int speak(void **state) {
  (void)state;
  fflush(stderr);
  return dup2(standard_error, STDERR_FILENO) >= 0 && close(standard_error) == 0 ? 0 : -1;
}

static void fill_with_pattern(image *picture) {
  for (uint32_t y = 0; y < picture->height; y++)
    for (uint32_t x = 0; x < picture->width; x++) {
      float *pixel = image_pixel(picture, x, y);
      pixel[0] = (float)x + 0.25f;
      pixel[1] = (float)y * 0.125f;
      pixel[2] = (float)(x * y) * 1e-3f;
    }
}

static void exr_files_keep_every_value(void **state) {
  static const uint32_t sizes[][2] = {{1, 1}, {17, 5}, {5, 40}, {64, 33}};
  (void)state;
  for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
    image picture, again;
    const char *path = test_path("pattern.exr");
    uint64_t repaired = 1;
    const size_t values = (size_t)sizes[s][0] * sizes[s][1] * 3;
    assert_int_equal(image_create(&picture, sizes[s][0], sizes[s][1]), EXIT_DONE);
    fill_with_pattern(&picture);
    assert_int_equal(image_write(&picture, path), EXIT_DONE);
    assert_int_equal(image_read(path, &again, &repaired), EXIT_DONE);
    assert_int_equal(repaired, 0);
    assert_int_equal(again.width, sizes[s][0]);
    assert_int_equal(again.height, sizes[s][1]);
    assert_memory_equal(picture.rgb, again.rgb, values * sizeof(float));
    image_free(&again);
    /* Halves round to 11 bits. */
    picture.rgb[0] = 1e9f;
    assert_int_equal(image_write_exr(&picture, path, true), EXIT_DONE);
    assert_int_equal(image_read(path, &again, NULL), EXIT_DONE);
    assert_true(again.rgb[0] == 65504.0f);
    for (size_t i = 1; i < values; i++)
      assert_near(again.rgb[i], picture.rgb[i], picture.rgb[i] / 2048.0 + 6e-8);
    image_free(&again);
    image_free(&picture);
  }
}

/* Tiles of 8 x 8 that the picture's right and bottom borders cut; one channel Y when grey. */
static exr_result_t write_tiled(const char *path, const image *picture, bool grey) {
  static const char *const names[] = {"B", "G", "R"};
  exr_context_initializer_t setup = EXR_DEFAULT_CONTEXT_INITIALIZER;
  exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
  exr_context_t ctx = NULL;
  const int channels = grey ? 1 : 3;
  int part = 0;
  bool first = true;
  exr_result_t code = exr_start_write(&ctx, path, EXR_WRITE_FILE_DIRECTLY, &setup);
  if (code != EXR_ERR_SUCCESS) return code;
  code = exr_add_part(ctx, "tiles", EXR_STORAGE_TILED, &part);
  if (code == EXR_ERR_SUCCESS)
    code = exr_initialize_required_attr_simple(ctx, part, (int32_t)picture->width, (int32_t)picture->height,
                                               EXR_COMPRESSION_ZIP);
  if (code == EXR_ERR_SUCCESS)
    code = exr_set_tile_descriptor(ctx, part, 8, 8, EXR_TILE_ONE_LEVEL, EXR_TILE_ROUND_DOWN);
  for (int i = 0; code == EXR_ERR_SUCCESS && i < channels; i++)
    code = exr_add_channel(ctx, part, grey ? "Y" : names[i], EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LOGARITHMIC, 1,
                           1);
  if (code == EXR_ERR_SUCCESS) code = exr_write_header(ctx);
  for (uint32_t y = 0; code == EXR_ERR_SUCCESS && y < picture->height; y += 8)
    for (uint32_t x = 0; code == EXR_ERR_SUCCESS && x < picture->width; x += 8) {
      exr_chunk_info_t chunk;
      code = exr_write_tile_chunk_info(ctx, part, (int)x / 8, (int)y / 8, 0, 0, &chunk);
      if (code == EXR_ERR_SUCCESS)
        code = first ? exr_encoding_initialize(ctx, part, &chunk, &encoder)
                     : exr_encoding_update(ctx, part, &chunk, &encoder);
      for (int i = 0; code == EXR_ERR_SUCCESS && i < channels; i++) {
        encoder.channels[i].user_pixel_stride = 3 * sizeof(float);
        encoder.channels[i].user_line_stride = (int32_t)(picture->width * 3 * sizeof(float));
        encoder.channels[i].encode_from_ptr =
            (const uint8_t *)(image_pixel(picture, x, y) + (grey ? 0 : 2 - i));
      }
      if (code == EXR_ERR_SUCCESS && first) code = exr_encoding_choose_default_routines(ctx, part, &encoder);
      if (code == EXR_ERR_SUCCESS) code = exr_encoding_run(ctx, part, &encoder);
      first = false;
    }
  exr_encoding_destroy(ctx, &encoder);
  return code == EXR_ERR_SUCCESS ? exr_finish(&ctx) : code;
}

static void tiled_and_grey_exr_files_are_read(void **state) {
  const char *path = test_path("tiles.exr");
  (void)state;
  for (int grey = 0; grey < 2; grey++) {
    image picture, again;
    assert_int_equal(image_create(&picture, 21, 13), EXIT_DONE);
    fill_with_pattern(&picture);
    assert_int_equal(write_tiled(path, &picture, grey != 0), EXR_ERR_SUCCESS);
    assert_int_equal(image_read(path, &again, NULL), EXIT_DONE);
    assert_int_equal(again.width, 21);
    for (size_t i = 0; i < 21 * 13 * 3; i++) assert_true(again.rgb[i] == picture.rgb[grey ? i / 3 * 3 : i]);
    image_free(&picture);
    image_free(&again);
  }
}

static void write_bytes(const char *path, const void *bytes, size_t size) {
  FILE *out = fopen(path, "wb");
  assert_non_null(out);
  assert_int_equal(fwrite(bytes, 1, size, out), size);
  assert_int_equal(fclose(out), 0);
}

/* The same picture of 2 x 2 pixels stored in all eight orders. Pixel (x, y) from the top left has mantissa 1
 * + 10 (x + 2 y). */
static void hdr_orders_give_one_picture(void **state) {
  static const char *const orders[] = {"-Y 2 +X 2", "-Y 2 -X 2", "+Y 2 +X 2", "+Y 2 -X 2",
                                       "+X 2 -Y 2", "-X 2 -Y 2", "+X 2 +Y 2", "-X 2 +Y 2"};
  (void)state;
  for (int i = 0; i < 8; i++) {
    const bool column_major = i >= 4;
    unsigned char file[256];
    image picture;
    const char *path = test_path("order.hdr");
    const char *order = orders[i];
    size_t size =
        (size_t)snprintf((char *)file, sizeof file, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n%s\n", order);
    for (int slow = 0; slow < 2; slow++)
      for (int fast = 0; fast < 2; fast++) {
        const bool slow_grows = order[0] == '+', fast_grows = order[5] == '+';
        const int x = column_major ? (slow_grows ? slow : 1 - slow) : (fast_grows ? fast : 1 - fast);
        /* +Y grows upward: the first line is the bottom one. */
        const int y = column_major ? (fast_grows ? 1 - fast : fast) : (slow_grows ? 1 - slow : slow);
        const unsigned char mantissa = (unsigned char)(1 + 10 * (x + 2 * y));
        const unsigned char pixel[4] = {mantissa, 100, 200, 129};
        memcpy(file + size, pixel, 4);
        size += 4;
      }
    write_bytes(path, file, size);
    assert_int_equal(image_read(path, &picture, NULL), EXIT_DONE);
    for (uint32_t y = 0; y < 2; y++)
      for (uint32_t x = 0; x < 2; x++) {
        /* (mantissa + 1/2) 2^(129 - 136), exact in binary. */
        assert_true(image_pixel(&picture, x, y)[0] == (1.5f + 10.0f * (float)(x + 2 * y)) / 128);
        assert_true(image_pixel(&picture, x, y)[2] == 200.5f / 128);
      }
    image_free(&picture);
  }
}

static void hdr_runs_are_unpacked(void **state) {
  /* 10 pixels: each component a run of 7 and three plain bytes. */
  unsigned char file[256];
  size_t size = (size_t)snprintf((char *)file, sizeof file, "#?RGBE\nEXPOSURE=2\n\n-Y 1 +X 10\n");
  image picture;
  const char *path = test_path("runs.hdr");
  (void)state;
  memcpy(file + size, "\2\2\0\12", 4);
  size += 4;
  for (unsigned char c = 0; c < 4; c++) {
    const unsigned char value = c == 3 ? 136 : (unsigned char)(10 * (c + 1));
    const unsigned char packed[6] = {128 + 7, value, 3, value, value, c == 3 ? 137 : value};
    memcpy(file + size, packed, 6);
    size += 6;
  }
  write_bytes(path, file, size);
  assert_int_equal(image_read(path, &picture, NULL), EXIT_DONE);
  for (uint32_t x = 0; x < 10; x++)
    for (uint32_t c = 0; c < 3; c++)
      assert_true(image_pixel(&picture, x, 0)[c] == (10.0f * (float)(c + 1) + 0.5f) / 2 * (x == 9 ? 2 : 1));
  image_free(&picture);
  /* Every shorter file is refused, and so is every file with one byte changed or read without harm. */
  for (size_t length = 0; length < size; length++) {
    write_bytes(path, file, length);
    assert_int_equal(image_read(path, &picture, NULL), EXIT_MALFORMED);
    assert_null(picture.rgb);
  }
  for (size_t at = 0; at < size; at++) {
    file[at] ^= 0x85;
    write_bytes(path, file, size);
    (void)image_read(path, &picture, NULL);
    image_free(&picture);
    file[at] ^= 0x85;
  }
}

static void damaged_exr_files_do_no_harm(void **state) {
  const char *path = test_path("sound.exr"), *other = test_path("damaged.exr");
  unsigned char file[4096];
  size_t size;
  image picture;
  FILE *in;
  (void)state;
  assert_int_equal(image_create(&picture, 9, 20), EXIT_DONE);
  fill_with_pattern(&picture);
  assert_int_equal(image_write(&picture, path), EXIT_DONE);
  image_free(&picture);
  in = fopen(path, "rb");
  assert_non_null(in);
  size = fread(file, 1, sizeof file, in);
  fclose(in);
  assert_in_range(size, 100, sizeof file - 1);
  for (size_t length = 0; length < size; length += 7) {
    write_bytes(other, file, length);
    assert_int_not_equal(image_read(other, &picture, NULL), EXIT_DONE);
  }
  for (size_t at = 0; at < size; at++) {
    file[at] ^= 0xff;
    write_bytes(other, file, size);
    (void)image_read(other, &picture, NULL);
    image_free(&picture);
    file[at] ^= 0xff;
  }
}

static void values_that_are_no_light_become_black(void **state) {
  image picture, again;
  const char *path = test_path("odd.exr");
  uint64_t repaired = 0;
  (void)state;
  assert_int_equal(image_create(&picture, 2, 1), EXIT_DONE);
  picture.rgb[0] = NAN;
  picture.rgb[1] = INFINITY;
  picture.rgb[2] = -1;
  picture.rgb[3] = 2;
  assert_int_equal(image_write(&picture, path), EXIT_DONE);
  assert_int_equal(image_read(path, &again, &repaired), EXIT_DONE);
  assert_int_equal(repaired, 3);
  assert_true(again.rgb[0] == 0 && again.rgb[1] == 0 && again.rgb[2] == 0 && again.rgb[3] == 2);
  image_free(&picture);
  image_free(&again);
}

static void srgb_is_the_standard_curve(void **state) {
  (void)state;
  /* IEC 61966-2-1: 0.18 grey is 0.4613561; the pieces meet at 0.0031308. */
  assert_near(tone_to_srgb(0.18f), 0.46135612950044164, 1e-6);
  assert_near(tone_to_srgb(0.002f), 0.02584, 1e-7);
  assert_true(tone_to_srgb(-1) == 0 && tone_to_srgb(2) == 1 && tone_to_srgb(NAN) == 0);
  for (int i = 0; i <= 255; i++) assert_near(tone_to_srgb(tone_from_srgb((float)i / 255)), i / 255.0, 2e-6);
}

static void percentiles_are_ranks(void **state) {
  image picture;
  (void)state;
  assert_int_equal(image_create(&picture, 1000, 1), EXIT_DONE);
  for (uint32_t i = 0; i < 3000; i++) picture.rgb[(i * 7) % 3000] = (float)i / 3000;
  assert_true(tone_percentile(&picture, 0) == 0);
  assert_near(tone_percentile(&picture, 0.5), 1499 / 3000.0, 1e-7);
  assert_near(tone_percentile(&picture, 1), 2999 / 3000.0, 1e-7);
  image_free(&picture);
}

/* ---- similarity ---- */

/* By the definition: windows of 121 weights, sums in double, indices that wrap. */
static double ssim_by_definition(const float *a, const float *b, int width, int height) {
  double weights[11][11], weight_sum = 0, total = 0;
  for (int j = -5; j <= 5; j++)
    for (int i = -5; i <= 5; i++) weight_sum += weights[j + 5][i + 5] = exp(-(i * i + j * j) / 4.5);
  for (int y = 0; y < height; y++)
    for (int x = 0; x < width; x++) {
      double ma = 0, mb = 0, va = 0, vb = 0, cov = 0;
      for (int pass = 0; pass < 2; pass++)
        for (int j = -5; j <= 5; j++)
          for (int i = -5; i <= 5; i++) {
            const int at = (y + j + 50 * height) % height * width + (x + i + 50 * width) % width;
            const double w = weights[j + 5][i + 5] / weight_sum;
            if (pass == 0) {
              ma += w * a[at];
              mb += w * b[at];
            } else {
              va += w * (a[at] - ma) * (a[at] - ma);
              vb += w * (b[at] - mb) * (b[at] - mb);
              cov += w * (a[at] - ma) * (b[at] - mb);
            }
          }
      total += (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4));
    }
  return total / (width * height);
}

static void ssim_is_what_its_definition_says(void **state) {
  static const int sizes[][2] = {{1, 1}, {3, 2}, {11, 11}, {24, 17}};
  (void)state;
  for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
    const int width = sizes[s][0], height = sizes[s][1], pixels = width * height;
    float *a = malloc(sizeof(float) * (size_t)pixels), *b = malloc(sizeof(float) * (size_t)pixels);
    double *scratch = malloc(sizeof(double) * ssim_scratch((uint32_t)width, (uint32_t)height));
    assert_true(a != NULL && b != NULL && scratch != NULL);
    for (int i = 0; i < pixels; i++) {
      a[i] = (float)(next_random() % 1000) / 999;
      b[i] = 0.7f * a[i] + 0.3f * (float)(next_random() % 1000) / 999;
    }
    /* Variances are differences of sums of about 1 with 22 roundings: errors of some 1e-14 beside 9e-4. */
    assert_near(ssim_mean(a, b, (uint32_t)width, (uint32_t)height, scratch),
                ssim_by_definition(a, b, width, height), 1e-10);
    assert_true(ssim_mean(a, a, (uint32_t)width, (uint32_t)height, scratch) == 1);
    /* Constant images: exactly 1 if equal, else what the means alone give, never above 1. */
    for (int k = 1; k <= 100; k++) {
      const double ma = (float)k / 100, mb = (float)k / 100 + 1e-3f * (float)(k % 7);
      for (int i = 0; i < pixels; i++) a[i] = (float)ma, b[i] = (float)mb;
      const double got = ssim_mean(a, b, (uint32_t)width, (uint32_t)height, scratch), b0 = b[0];
      assert_near(got, (2 * ma * b0 + 1e-4) / (ma * ma + b0 * b0 + 1e-4), 1e-10);
      assert_true(got <= 1 && (k % 7 != 0 || got == 1));
    }
    free(a);
    free(b);
    free(scratch);
  }
}

/* ---- words and threads ---- */

static void near_misses_are_likely_ones(void **state) {
  static const char *const words[] = {"encode", "eval", "export", "info", NULL};
  (void)state;
  assert_string_equal(cli_near_miss("encdoe", words), "encode");
  assert_string_equal(cli_near_miss("enc", words), "encode");
  assert_string_equal(cli_near_miss("evla", words), "eval");
  assert_null(cli_near_miss("frobnicate", words));
  assert_null(cli_near_miss("x", words));
}

static void headings_break_after_words(void **state) {
  (void)state;
  assert_int_equal(font_break("whole", 5), 5);
  assert_int_equal(font_break("", 5), 0);
  assert_int_equal(font_break("fmf-comp-onents", 12), 9);    /* the last that fits */
  assert_int_equal(font_break("fmf-components-16", 15), 15); /* right at the end */
  assert_int_equal(font_break("a-componentsofall", 12), 12); /* none in the latter half */
  assert_int_equal(font_break("long", 0), 1);                /* always goes on */
}

typedef struct visits {
  uint32_t threads;
  uint8_t seen[1000];
  bool wrong_thread;
} visits;

static bool visit(void *user, uint64_t index, uint32_t thread) {
  visits *v = user;
  v->seen[index]++;
  if (thread != index % v->threads) v->wrong_thread = true;
  return true;
}

static bool stop_at_seven(void *user, uint64_t index, uint32_t thread) {
  (void)user;
  (void)thread;
  return index != 7;
}

static void every_task_runs_once_on_its_thread(void **state) {
  (void)state;
  for (uint32_t threads = 1; threads <= 5; threads++) {
    visits v = {threads, {0}, false};
    assert_true(parallel_for(threads, 1000, visit, &v));
    for (int i = 0; i < 1000; i++) assert_int_equal(v.seen[i], 1);
    assert_false(v.wrong_thread);
    assert_false(parallel_for(threads, 1000, stop_at_seven, NULL));
  }
}

/* Every code point, encoded here: shown as it is unless it is a control, then one '?'. Surrogates and what
 * lies beyond Unicode are no UTF-8: a '?' for each byte. */
static void text_for_terminals_has_no_controls(void **state) {
  (void)state;
  for (uint32_t code = 1; code < 0x120000; code++) {
    char text[8] = "a", expected[8] = "a";
    unsigned char c[4];
    size_t length = 1;
    const int surrogate = code >= 0xd800 && code <= 0xdfff;
    const int control = code <= 0x1f || (code >= 0x7f && code <= 0x9f) || code == 0x61c || code == 0x200e ||
                        code == 0x200f || (code >= 0x2028 && code <= 0x202e) ||
                        (code >= 0x2066 && code <= 0x2069);
    c[0] = (unsigned char)code;
    if (code >= 0x80) {
      length = code < 0x800 ? 2 : code < 0x10000 ? 3 : 4;
      for (size_t i = 0; i < length; i++)
        c[i] = (unsigned char)(0x80 | (code >> 6 * (length - 1 - i) & 0x3f));
      c[0] = (unsigned char)((0xf00 >> length & 0xff) | code >> 6 * (length - 1));
    }
    memcpy(text + 1, c, length);
    strcat(text, "z");
    if (surrogate || code > 0x10ffff)
      memset(expected + 1, '?', length);
    else if (control)
      expected[1] = '?';
    else
      memcpy(expected + 1, c, length);
    strcat(expected, "z");
    safe_text_clean(text);
    if (strcmp(text, expected) != 0) fail_msg("U+%04X became \"%s\"", code, text);
  }
  static const char *const broken[][2] = {{"\x9b"
                                           "1m",
                                           "?1m"},
                                          {"\xc0\xaf", "??"},
                                          {"\xe0\x80\x80", "???"},
                                          {"\xf0\x80\x80\x80", "????"},
                                          {"\xe2\x80", "??"},
                                          {"\xc2", "?"},
                                          {"\xff\xfe", "??"},
                                          {"\xe2\x82z", "??z"}};
  for (size_t i = 0; i < sizeof broken / sizeof *broken; i++) {
    char text[8];
    strcpy(text, broken[i][0]);
    safe_text_clean(text);
    assert_string_equal(text, broken[i][1]);
  }
}

/* ---- walks over samples ---- */

static btf_status read_zeros(void *user, const btf_block *b, void *dst, const btf_strides *s) {
  (void)user;
  for (uint32_t l = 0; l < b->lights; l++) memset((char *)dst + (ptrdiff_t)l * s->light, 0, sizeof(float));
  return BTF_OK;
}

static btf_status refuse_block(void *user, const sample_visit *visit) {
  (void)visit;
  ++*(int *)user;
  return btf_source_error(BTF_E_IO, "no room");
}

/* What a visit fails with ends the walk. A block has the lights of one view, so that there are as many blocks
 * as views. */
static void walks_end_at_the_first_failure(void **state) {
  (void)state;
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  btf_dataset_desc d = BTF_DATASET_DESC_INIT;
  btf_dirset *set;
  input in = {.path = "zeros"};
  sample_source source;
  cli c = {.threads = 1, .quiet = true};
  int walked = 0;
  const sample_walk walk = {.a = &source, .visit = refuse_block, .user = &walked, .to = 1};
  assert_ok(btf_dirset_create_named(ctx, "ubo81", &set));
  d.lights = d.views = set;
  d.width = d.height = d.channels = 1;
  d.read = read_zeros;
  assert_ok(btf_dataset_create(ctx, &d, &in.dataset));
  btf_dirset_release(set);
  assert_int_equal(sample_source_open(&in, &source), EXIT_DONE);
  assert_int_equal(sample_walk_run(&c, &walk), EXIT_IO);
  assert_int_equal(walked, 1);
  input_close(&in);
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(numbers_are_written_like_printf),
      cmocka_unit_test(numbers_are_read_like_strtof),
      cmocka_unit_test(what_is_no_number_is_refused),
      cmocka_unit_test(exr_files_keep_every_value),
      cmocka_unit_test(tiled_and_grey_exr_files_are_read),
      cmocka_unit_test(hdr_orders_give_one_picture),
      cmocka_unit_test_setup_teardown(hdr_runs_are_unpacked, silence, speak),
      cmocka_unit_test_setup_teardown(damaged_exr_files_do_no_harm, silence, speak),
      cmocka_unit_test(values_that_are_no_light_become_black),
      cmocka_unit_test(srgb_is_the_standard_curve),
      cmocka_unit_test(percentiles_are_ranks),
      cmocka_unit_test(ssim_is_what_its_definition_says),
      cmocka_unit_test(near_misses_are_likely_ones),
      cmocka_unit_test(headings_break_after_words),
      cmocka_unit_test(text_for_terminals_has_no_controls),
      cmocka_unit_test(every_task_runs_once_on_its_thread),
      cmocka_unit_test_setup_teardown(walks_end_at_the_first_failure, silence, speak),
  };
  return btf_run("tool parts", tests);
}
