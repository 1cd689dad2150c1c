/* SPDX-License-Identifier: MIT */
/* encode.c: samples as the file of a picture, PNG by libpng or Radiance. */
#include <setjmp.h>
#include <stdio.h>

#include <png.h>

#include "bonn_images/bonn_images.h"

/* ---- codes ---- */

static double code_of(bool srgb, double value) {
  if (!srgb) return value;
  return value <= 0.0031308 ? 12.92 * value : 1.055 * pow(value, 1 / 2.4) - 0.055;
}

/* The nearest code; what is beyond the first or last is counted. */
static uint32_t nearest_code(const image_encoding *e, float value, uint64_t *clipped) {
  const uint32_t most = e->kind == IMAGE_PNG16 ? 65535 : 255;
  if (!(value >= 0 && value <= 1)) {
    ++*clipped;
    return value > 1 ? most : 0;
  }
  return (uint32_t)(code_of(e->srgb, (double)value) * most + 0.5);
}

/* ---- PNG ---- */

typedef struct png_target {
  const image_encoding *encoding;
  image_bytes *bytes;
  picture_fault *fault;
} png_target;

static void on_error(png_structp png, png_const_charp message) {
  png_target *target = png_get_error_ptr(png);
  if (target->fault->status == BTF_OK) picture_fail(target->fault, BTF_E_IO, "PNG: %.200s", message);
  png_longjmp(png, 1);
}

static void on_warning(png_structp png, png_const_charp message) {
  (void)png, (void)message;
}

static void append(png_structp png, png_bytep src, size_t count) {
  png_target *target = png_get_io_ptr(png);
  image_bytes *bytes = target->bytes;
  if (count > bytes->room - bytes->size) png_error(png, "it is longer than any should be");
  memcpy(bytes->data + bytes->size, src, count);
  bytes->size += count;
}

static void flush(png_structp png) {
  (void)png;
}

static png_voidp take_memory(png_structp png, png_alloc_size_t size) {
  const png_target *target = png_get_mem_ptr(png);
  void *memory = (target->encoding->host->alloc)(target->encoding->ctx, size, 1);
  if (memory == NULL) picture_fail(target->fault, BTF_E_NOMEM, "not enough memory for a PNG");
  return memory;
}

static void give_memory(png_structp png, png_voidp memory) {
  const png_target *target = png_get_mem_ptr(png);
  (target->encoding->host->free)(target->encoding->ctx, memory);
}

static void fill_row(const image_encoding *e, const float *samples, unsigned char *row, uint64_t *clipped) {
  const size_t count = (size_t)e->width * e->channels;
  for (size_t i = 0; i < count; i++) {
    const uint32_t code = nearest_code(e, samples[i] * e->factor, clipped);
    if (e->kind == IMAGE_PNG16) *row++ = (unsigned char)(code >> 8);
    *row++ = (unsigned char)code;
  }
}

static void put_png(png_structp png, png_infop head, png_target *target, const float *samples,
                    unsigned char *row, uint64_t *clipped) {
  const image_encoding *e = target->encoding;
  if (setjmp(png_jmpbuf(png)) != 0) {
    if (target->fault->status == BTF_OK) picture_fail(target->fault, BTF_E_NOMEM, "PNG: not enough memory");
    return;
  }
  png_set_write_fn(png, target, append, flush);
  png_set_IHDR(png, head, e->width, e->height, e->kind == IMAGE_PNG16 ? 16 : 8,
               e->channels == 1 ? PNG_COLOR_TYPE_GRAY : PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  if (e->srgb)
    png_set_sRGB(png, head, PNG_sRGB_INTENT_RELATIVE);
  else
    png_set_gAMA(png, head, 1);
  png_write_info(png, head);
  for (uint32_t y = e->height; y-- > 0;) {
    fill_row(e, samples + (size_t)y * e->width * e->channels, row, clipped);
    png_write_row(png, row);
  }
  png_write_end(png, head);
}

static void encode_png(const image_encoding *e, const float *samples, unsigned char *row, image_bytes *bytes,
                       uint64_t *clipped, picture_fault *fault) {
  png_target target = {e, bytes, fault};
  png_structp png = png_create_write_struct_2(PNG_LIBPNG_VER_STRING, &target, on_error, on_warning, &target,
                                              take_memory, give_memory);
  png_infop head = png != NULL ? png_create_info_struct(png) : NULL;
  if (head == NULL)
    picture_fail(fault, BTF_E_NOMEM, "not enough memory for a PNG");
  else
    put_png(png, head, &target, samples, row, clipped);
  png_destroy_write_struct(&png, &head);
}

/* ---- Radiance ---- */

/* Readers take the middle of the values that a code stands for, so codes are rounded down. */
static void put_pixel(const float rgb[3], float factor, unsigned char *code, uint64_t *clipped) {
  double value[3], most = 0;
  int exponent;
  for (int c = 0; c < 3; c++) {
    value[c] = (double)(rgb[c] * factor);
    if (value[c] < 0) {
      ++*clipped;
      value[c] = 0;
    }
    most = fmax(most, value[c]);
  }
  frexp(most, &exponent);
  memset(code, 0, 4);
  if (!(most > 0) || exponent < -127) return;
  if (exponent > 127) exponent = 127;
  for (int c = 0; c < 3; c++) {
    const double mantissa = ldexp(value[c], 8 - exponent);
    if (mantissa >= 256) ++*clipped;
    code[c] = (unsigned char)fmin(mantissa, 255);
  }
  code[3] = (unsigned char)(exponent + 128);
}

/* Each component by itself, without repetitions, since measured values have few; the form has lines of 8
 * pixels and more. */
static void put_line(const unsigned char *codes, uint32_t width, image_bytes *bytes) {
  unsigned char *to = bytes->data + bytes->size;
  if (width < 8) {
    memcpy(to, codes, 4 * (size_t)width);
    to += 4 * (size_t)width;
  } else {
    *to++ = 2;
    *to++ = 2;
    *to++ = (unsigned char)(width >> 8);
    *to++ = (unsigned char)width;
    for (int component = 0; component < 4; component++)
      for (uint32_t x = 0; x < width; x++) {
        const uint32_t left = width - x;
        if (x % 128 == 0) *to++ = (unsigned char)(left < 128 ? left : 128);
        *to++ = codes[4 * (size_t)x + (size_t)component];
      }
  }
  bytes->size = (uint64_t)(to - bytes->data);
}

static void encode_hdr(const image_encoding *e, const float *samples, unsigned char *row, image_bytes *bytes,
                       uint64_t *clipped) {
  bytes->size =
      (uint64_t)snprintf((char *)bytes->data, (size_t)bytes->room,
                         "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %u +X %u\n", e->height, e->width);
  for (uint32_t y = e->height; y-- > 0;) {
    for (uint32_t x = 0; x < e->width; x++)
      put_pixel(samples + ((size_t)y * e->width + x) * 3, e->factor, row + 4 * (size_t)x, clipped);
    put_line(row, e->width, bytes);
  }
}

/* ---- both ---- */

uint64_t images_encoded_most(const image_encoding *e) {
  const uint64_t depth = e->kind == IMAGE_PNG16 ? 2 : 1;
  if (e->kind == IMAGE_HDR)
    return 128 + (uint64_t)e->height * (8 + 4 * ((uint64_t)e->width + e->width / 128));
  /* What does not deflate stays as it is, in blocks and chunks with their frames. */
  const uint64_t rows = e->height * (1 + (uint64_t)e->width * e->channels * depth);
  return rows + rows / 64 + 4096;
}

uint64_t images_row_bytes(const image_encoding *e) {
  return (uint64_t)e->width * (e->kind == IMAGE_HDR ? 4 : e->channels * (e->kind == IMAGE_PNG16 ? 2u : 1u));
}

void images_encode(const image_encoding *e, const float *samples, unsigned char *row, image_bytes *bytes,
                   uint64_t *clipped, picture_fault *fault) {
  bytes->size = 0;
  if (e->kind == IMAGE_HDR)
    encode_hdr(e, samples, row, bytes, clipped);
  else
    encode_png(e, samples, row, bytes, clipped, fault);
}
