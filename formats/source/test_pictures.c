/* SPDX-License-Identifier: MIT */
/* Decoders of pictures: memory from the host, its limits and failures, and what files of each kind may have
 * beside their pixels. */
#include "test_format.h"
#include "test_picture.h"

#include <jpeglib.h>
#include <png.h>
#include <zlib.h>

#include "registry/registry.h"

#include "picture.h"

enum { WIDTH = 40, HEIGHT = 24, SAMPLES = WIDTH * HEIGHT * 3 };

static unsigned char code(const void *user, int column, int row, int channel) {
  (void)user;
  return (unsigned char)(60 + 31 * column + 17 * row + 41 * channel);
}

/* ---- files ---- */

/* The same coefficients in several scans, by libjpeg's own memory. */
static unsigned char *progressive(size_t *size) {
  struct jpeg_decompress_struct from;
  struct jpeg_compress_struct to;
  struct jpeg_error_mgr errors;
  size_t plain_size;
  unsigned char *plain = test_squares_jpeg(WIDTH, HEIGHT, 3, code, NULL, &plain_size), *data = NULL;
  unsigned long bytes = 0;
  from.err = to.err = jpeg_std_error(&errors);
  jpeg_create_decompress(&from);
  jpeg_create_compress(&to);
  jpeg_mem_src(&from, plain, plain_size);
  jpeg_mem_dest(&to, &data, &bytes);
  (void)jpeg_read_header(&from, TRUE);
  jvirt_barray_ptr *coefficients = jpeg_read_coefficients(&from);
  jpeg_copy_critical_parameters(&from, &to);
  jpeg_simple_progression(&to);
  jpeg_write_coefficients(&to, coefficients);
  jpeg_finish_compress(&to);
  jpeg_destroy_compress(&to);
  jpeg_destroy_decompress(&from);
  free(plain);
  *size = bytes;
  return data;
}

typedef struct bytes {
  unsigned char data[1 << 16];
  size_t size;
} bytes;

static void put(png_structp png, png_bytep data, size_t size) {
  bytes *out = png_get_io_ptr(png);
  assert_true(size <= sizeof out->data - out->size);
  memcpy(out->data + out->size, data, size);
  out->size += size;
}

static void write_png(bytes *out, int interlace) {
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
  png_infop info = png_create_info_struct(png);
  unsigned char pixels[HEIGHT][WIDTH * 3];
  png_bytep rows[HEIGHT];
  for (int y = 0; y < HEIGHT; y++) {
    rows[y] = pixels[y];
    for (int i = 0; i < WIDTH * 3; i++) pixels[y][i] = code(NULL, i / 3 / 8, y / 8, i % 3);
  }
  out->size = 0;
  png_set_write_fn(png, out, put, NULL);
  png_set_IHDR(png, info, WIDTH, HEIGHT, 8, PNG_COLOR_TYPE_RGB, interlace, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  png_write_image(png, rows);
  png_write_end(png, NULL);
  png_destroy_write_struct(&png, &info);
}

static void big_endian(unsigned char *p, uint32_t value) {
  for (int i = 0; i < 4; i++) p[i] = (unsigned char)(value >> (24 - 8 * i));
}

/* A chunk between header and pixels; `wrong` is added to its checksum. */
static void insert_chunk(bytes *png, const char type[5], const void *data, size_t size, uint32_t wrong) {
  enum { HEADER_END = 8 + 25 };
  unsigned char *at = png->data + HEADER_END;
  assert_true(png->size + size + 12 <= sizeof png->data);
  memmove(at + size + 12, at, png->size - HEADER_END);
  big_endian(at, (uint32_t)size);
  memcpy(at + 4, type, 4);
  memcpy(at + 8, data, size);
  big_endian(at + 8 + size, (uint32_t)crc32(0, at + 4, (uInt)size + 4) + wrong);
  png->size += size + 12;
}

/* ---- decoding ---- */

static btf_status decode(btf_context *ctx, const void *data, size_t size, uint32_t sample_size, void *samples,
                         picture_fault *fault) {
  static uint16_t halves[256];
  const source_file file = {.host = btfi_host(), .ctx = ctx, .data = data, .size = size};
  const picture_rules rules = {.sample_size = sample_size, .table = halves};
  picture_info info;
  bool complete;
  *fault = (picture_fault){BTF_OK, ""};
  const btf_status status = picture_look(data, size, &info, &complete, fault);
  if (status != BTF_OK) return status;
  assert_true(complete);
  return picture_decode(&file, &info, &rules, samples, fault);
}

static void expect_codes(const unsigned char *codes) {
  for (int y = 0; y < HEIGHT; y++)
    for (int i = 0; i < WIDTH * 3; i++)
      assert_int_equal(codes[y * WIDTH * 3 + i], code(NULL, i / 3 / 8, (HEIGHT - 1 - y) / 8, i % 3));
}

/* Each allocation fails in turn: that is want of memory, never damage. */
static void fail_each(const void *data, size_t size, long least) {
  static unsigned char codes[SAMPLES];
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  picture_fault fault;
  for (long fail_at = 1;; fail_at++) {
    const long before = memory.live_blocks;
    memory.fail_at = memory.total_allocations + fail_at;
    const btf_status status = decode(ctx, data, size, 1, codes, &fault);
    assert_int_equal(memory.live_blocks, before);
    if (status == BTF_OK) {
      assert_true(memory.total_allocations < memory.fail_at);
      assert_true(fail_at > least);
      expect_codes(codes);
      break;
    }
    assert_int_equal(status, BTF_E_NOMEM);
    assert_true(fault.why[0] != '\0');
  }
  memory.fail_at = 0;
  test_context_done(ctx, &memory);
}

static void test_allocations(void **state) {
  (void)state;
  static bytes png;
  size_t size;
  unsigned char *jpeg = test_squares_jpeg(WIDTH, HEIGHT, 3, code, NULL, &size);
  fail_each(jpeg, size, 10);
  free(jpeg);
  jpeg = progressive(&size);
  fail_each(jpeg, size, 15); /* the coefficients of three components are among them */
  free(jpeg);
  for (int interlace = PNG_INTERLACE_NONE; interlace <= PNG_INTERLACE_ADAM7; interlace++) {
    write_png(&png, interlace);
    fail_each(png.data, png.size, 4);
  }
}

/* A progressive JPEG whose head says more than its data holds: all coefficients would take twice the bytes of
 * its codes. One is too large, the other ends early. */
static void test_jpeg_memory(void **state) {
  (void)state;
  static unsigned char data[1024];
  static const unsigned char sizes[][4] = {{0x20, 0, 0x20, 0}, {0x10, 0, 0x10, 0}};
  static const btf_status expected[] = {BTF_E_LIMIT, BTF_E_CORRUPT};
  size_t size;
  unsigned char *whole = progressive(&size), *frame = memmem(whole, size, "\xff\xc2", 2);
  assert_non_null(frame);
  for (int i = 0; i < 2; i++) {
    test_memory memory;
    btf_context *ctx = test_context(&memory);
    picture_fault fault;
    uint64_t now, peak;
    const uint64_t side = (uint64_t)sizes[i][0] << 8;
    void *samples = malloc(3 * side * side); /* of which nothing is written, and so nothing taken */
    assert_non_null(samples);
    memcpy(frame + 5, sizes[i], 4);
    assert_true(size <= sizeof data);
    memcpy(data, whole, size);
    const btf_status status = decode(ctx, data, size, 1, samples, &fault);
    if (status != expected[i]) fail_msg("%s: %s", btf_status_name(status), fault.why);
    if (i == 0) assert_non_null(strstr(fault.why, "200 MiB"));
    btf_context_memory(ctx, &now, &peak);
    assert_true(peak < (uint64_t)200 << 20);
    /* 4096 x 4096 in three channels of two bytes: they were the host's. */
    if (i == 1) assert_true(peak >= 6 * side * side);
    free(samples);
    test_context_done(ctx, &memory);
  }
  free(whole);
}

static void expect_fault(const void *data, size_t size, btf_status expected, const char *part) {
  static unsigned char codes[SAMPLES];
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  picture_fault fault;
  const btf_status status = decode(ctx, data, size, 1, codes, &fault);
  if (status != expected || strstr(fault.why, part) == NULL)
    fail_msg("%s instead of %s: %s", btf_status_name(status), btf_status_name(expected), fault.why);
  if (status == BTF_OK) expect_codes(codes);
  test_context_done(ctx, &memory);
}

/* Any wrong checksum is damage, of pixels or not. Unknown and damaged texts say nothing on stderr. */
static void test_png_chunks(void **state) {
  (void)state;
  static bytes png;
  static const char *const types[] = {"tEXt", "gAMA", "zzZz", "iCCP"};
  for (size_t i = 0; i < sizeof types / sizeof *types; i++)
    for (uint32_t wrong = 0; wrong < 2; wrong++) {
      write_png(&png, PNG_INTERLACE_NONE);
      insert_chunk(&png, types[i], "a\0\0\0", 4, wrong);
      expect_fault(png.data, png.size, wrong ? BTF_E_CORRUPT : BTF_OK, wrong ? "CRC" : "");
    }
  write_png(&png, PNG_INTERLACE_NONE);
  insert_chunk(&png, "ZzZz", "a", 1, 0); /* one that must be understood */
  expect_fault(png.data, png.size, BTF_E_CORRUPT, "PNG");
}

/* Forty texts of 1 MiB in 1 KiB each: none is unpacked. */
static void test_png_bomb(void **state) {
  (void)state;
  enum { TEXT_BYTES = 1 << 20 };
  static bytes png;
  static unsigned char text[TEXT_BYTES], chunk[4096] = "a\0";
  static unsigned char codes[SAMPLES];
  uLongf packed = sizeof chunk - 3;
  memset(text, 'a', sizeof text);
  assert_int_equal(compress2(chunk + 3, &packed, text, sizeof text, 9), Z_OK);
  write_png(&png, PNG_INTERLACE_NONE);
  for (int i = 0; i < 40; i++) insert_chunk(&png, "zTXt", chunk, packed + 3, 0);
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  picture_fault fault;
  uint64_t now, peak;
  assert_int_equal(decode(ctx, png.data, png.size, 1, codes, &fault), BTF_OK);
  expect_codes(codes);
  btf_context_memory(ctx, &now, &peak);
  assert_true(peak < TEXT_BYTES);
  test_context_done(ctx, &memory);
}

/* Pixels were multiplied by all exposures of the header, which are taken out again. */
static void test_hdr_exposure(void **state) {
  (void)state;
  static const struct {
    const char *lines;
    double factor;
  } cases[] = {{"", 1},
               {"EXPOSURE=2\n", 2},
               {"EXPOSURE= 0.25\nSOFTWARE=x\nEXPOSURE=8\n", 2},
               {"EXPOSURE=1e-1\nEXPOSURE=2.5\nEXPOSURE=4\n", 1}};
  test_memory memory;
  btf_context *ctx = test_context(&memory);
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    char file[256];
    float samples[3];
    picture_fault fault;
    const int size =
        snprintf(file, sizeof file, "#?RADIANCE\n%sFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n%c%c%c%c",
                 cases[i].lines, 16, 32, 64, 129);
    assert_int_equal(decode(ctx, file, (size_t)size, 4, samples, &fault), BTF_OK);
    /* Exponent 129 makes the unit 2^(129 - 136); 0.5 is the middle of a code. Floats, and 0.1 in binary. */
    for (int k = 0; k < 3; k++)
      assert_relative(samples[k], ((16 << k) + 0.5) / 128 / cases[i].factor, 0x1p-23);
  }
  test_context_done(ctx, &memory);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_allocations), cmocka_unit_test(test_jpeg_memory),
                                     cmocka_unit_test(test_png_chunks), cmocka_unit_test(test_png_bomb),
                                     cmocka_unit_test(test_hdr_exposure)};
  return btf_run("pictures", tests);
}
