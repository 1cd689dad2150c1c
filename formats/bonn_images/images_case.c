/* SPDX-License-Identifier: MIT */
#include "images_case.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jpeglib.h>
#include <png.h>
#include <zlib.h>

static void require(bool condition) {
  if (!condition) abort();
}

void case_append(case_bytes *bytes, const void *data, size_t size) {
  if (bytes->size + size > bytes->room) {
    bytes->room = 2 * (bytes->size + size);
    bytes->data = realloc(bytes->data, bytes->room);
    require(bytes->data != NULL);
  }
  if (size > 0) memcpy(bytes->data + bytes->size, data, size);
  bytes->size += size;
}

void case_free(case_bytes *bytes) {
  free(bytes->data);
  *bytes = (case_bytes){0};
}

static void append_number(case_bytes *bytes, uint64_t value, int size) {
  unsigned char little[8];
  for (int i = 0; i < size; i++) little[i] = (unsigned char)(value >> (8 * i));
  case_append(bytes, little, (size_t)size);
}

/* ---- what is in them ---- */

/* Written out, ring by ring, from the published table. */
void case_angles(uint32_t direction, unsigned *theta, unsigned *phi) {
  static const unsigned per_ring[] = {1, 6, 12, 18, 20, 24};
  unsigned ring = 0, i = direction;
  while (i >= per_ring[ring]) i -= per_ring[ring++];
  *theta = 15 * ring;
  *phi = i * (360 / per_ring[ring]);
}

/* Smooth within a picture, so that JPEG keeps it; red tells the light, green the view. */
uint32_t case_code(uint32_t view, uint32_t light, uint32_t x, uint32_t row, uint32_t channel) {
  const uint32_t pair[] = {20 + 2 * light, 22 + 2 * view, 60};
  return pair[channel] + 4 * x + 6 * row;
}

/* ---- pictures ---- */

static void append_jpeg(const picture_case *c, const unsigned char *codes, case_bytes *out) {
  struct jpeg_compress_struct jpeg;
  struct jpeg_error_mgr errors;
  unsigned char *data = NULL;
  unsigned long size = 0;
  jpeg.err = jpeg_std_error(&errors);
  jpeg_create_compress(&jpeg);
  jpeg_mem_dest(&jpeg, &data, &size);
  jpeg.image_width = c->width;
  jpeg.image_height = c->height;
  jpeg.input_components = (int)c->channels;
  jpeg.in_color_space = c->channels == 3 ? JCS_RGB : JCS_GRAYSCALE;
  jpeg_set_defaults(&jpeg);
  jpeg_set_quality(&jpeg, 100, TRUE);
  jpeg.comp_info[0].h_samp_factor = jpeg.comp_info[0].v_samp_factor = 1;
  jpeg_start_compress(&jpeg, TRUE);
  for (uint32_t row = 0; row < c->height; row++) {
    JSAMPROW line = (JSAMPROW)(uintptr_t)(codes + (size_t)row * c->width * c->channels);
    (void)jpeg_write_scanlines(&jpeg, &line, 1);
  }
  jpeg_finish_compress(&jpeg);
  jpeg_destroy_compress(&jpeg);
  case_append(out, data, size);
  free(data);
}

static void png_put(png_structp png, png_bytep data, size_t size) {
  case_append(png_get_io_ptr(png), data, size);
}
static void png_flush_nothing(png_structp png) {
  (void)png;
}

static void append_png(const picture_case *c, const unsigned char *codes, case_bytes *out) {
  const int depth = c->kind == CASE_PNG16 ? 16 : 8;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
  png_infop info = png_create_info_struct(png);
  require(info != NULL);
  png_set_write_fn(png, out, png_put, png_flush_nothing);
  png_set_IHDR(png, info, c->width, c->height, depth,
               c->channels == 3 ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  for (uint32_t row = 0; row < c->height; row++)
    png_write_row(png, codes + (size_t)row * c->width * c->channels * (size_t)(depth / 8));
  png_write_end(png, NULL);
  png_destroy_write_struct(&png, &info);
}

/* Exponent 128: a code stands for (code + 1/2) / 256. */
static void append_hdr_line(const unsigned char (*pixels)[4], uint32_t count, bool packed, case_bytes *out) {
  if (!packed) {
    case_append(out, pixels, 4 * (size_t)count);
    return;
  }
  const unsigned char head[] = {2, 2, (unsigned char)(count >> 8), (unsigned char)count};
  case_append(out, head, 4);
  for (int k = 0; k < 3; k++) { /* values one by one */
    append_number(out, count, 1);
    for (uint32_t i = 0; i < count; i++) case_append(out, &pixels[i][k], 1);
  }
  append_number(out, 128 + count, 1); /* a run of exponents */
  append_number(out, 128, 1);
}

static void append_hdr(const picture_case *c, uint32_t view, uint32_t light, case_bytes *out) {
  const bool columns = c->kind == CASE_HDR_COLUMNS;
  const uint32_t lines = columns ? c->width : c->height, count = columns ? c->height : c->width;
  unsigned char line[64][4];
  char head[128];
  require(count <= 64);
  const int length = snprintf(head, sizeof head, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n%s %u %s %u\n",
                              columns ? "+X" : "-Y", lines, columns ? "-Y" : "+X", count);
  case_append(out, head, (size_t)length);
  for (uint32_t n = 0; n < lines; n++) {
    for (uint32_t k = 0; k < count; k++) {
      const uint32_t x = columns ? n : k, row = columns ? k : n;
      for (uint32_t ch = 0; ch < 3; ch++) line[k][ch] = (unsigned char)c->code(view, light, x, row, ch);
      line[k][3] = 128;
    }
    append_hdr_line((const unsigned char(*)[4])line, count, c->kind != CASE_HDR_PLAIN, out);
  }
}

void case_picture(const picture_case *c, uint32_t view, uint32_t light, case_bytes *out) {
  unsigned char codes[4096];
  const size_t size = c->kind == CASE_PNG16 ? 2 : 1;
  require((size_t)c->width * c->height * c->channels * size <= sizeof codes);
  if (c->kind >= CASE_HDR) {
    append_hdr(c, view, light, out);
    return;
  }
  size_t at = 0;
  for (uint32_t row = 0; row < c->height; row++)
    for (uint32_t x = 0; x < c->width; x++)
      for (uint32_t ch = 0; ch < c->channels; ch++) {
        const uint32_t code = c->code(view, light, x, row, ch);
        if (size == 2) codes[at++] = (unsigned char)(code >> 8);
        codes[at++] = (unsigned char)code;
      }
  if (c->kind == CASE_JPEG)
    append_jpeg(c, codes, out);
  else
    append_png(c, codes, out);
}

void case_name(case_names names, const char *extension, uint32_t view, uint32_t light, char out[128]) {
  unsigned tl, pl, tv, pv;
  case_angles(light, &tl, &pl);
  case_angles(view, &tv, &pv);
  switch (names) {
  case CASE_UBO:
    snprintf(out, 128, "UBO2003/MANYFILES/tv%03u_pv%03u/%05u tl%03u pl%03u tv%03u pv%03u.%s", tv, pv,
             81 * light + view, tl, pl, tv, pv, extension);
    return;
  case CASE_WOOL:
    snprintf(out, 128, "WoolPKNT256_%05u_tl%03u_pl%03u_tv%03u_pv%03u.%s", 81 * light + view, tl, pl, tv, pv,
             extension);
    return;
  case CASE_UTIA:
    snprintf(out, 128, "tv%03u_pv%03u/tl%03u_pl%03u_tv%03u_pv%03u.%s", tv, pv, tl, pl, tv, pv, extension);
    return;
  case CASE_BACKSLASHES:
    snprintf(out, 128, "images\\tv%03u_pv%03u\\tl%03u_pl%03u_tv%03u_pv%03u.%s", tv, pv, tl, pl, tv, pv,
             extension);
    return;
  case CASE_SPECTRAL:
    snprintf(out, 128, "TV%03u.0_PV%03u.0_TL%03u.0_PL%03u.0.%s", tv, pv, tl, pl, extension);
    return;
  default:
    snprintf(out, 128, "img_tv%u_pv%u_tl%u_pl%u.%s", tv, pv, tl, pl, extension);
  }
}

/* ---- archives ---- */

static uint32_t or_lie(uint32_t truth, uint32_t lie) {
  return lie != 0 ? lie : truth;
}
static uint64_t or_lie64(uint64_t truth, uint64_t lie) {
  return lie != 0 ? lie : truth;
}

static size_t deflate_bytes(const zip_member *m, unsigned char *out, size_t room) {
  z_stream z = {.next_in = (unsigned char *)(uintptr_t)m->data,
                .avail_in = (uInt)m->size,
                .next_out = out,
                .avail_out = (uInt)room};
  require(deflateInit2(&z, 9, Z_DEFLATED, -15, 8, Z_DEFAULT_STRATEGY) == Z_OK);
  require(deflate(&z, Z_FINISH) == Z_STREAM_END);
  const size_t size = z.total_out;
  deflateEnd(&z);
  return size;
}

/* The fields that the local header and the directory share. */
static void append_common(case_bytes *out, const zip_member *m, uint32_t packed, size_t extra) {
  const size_t name_size = m->name_size > 0 ? m->name_size : strlen(m->name);
  append_number(out, m->zip64 ? 45 : 20, 2);
  append_number(out, m->flags, 2);
  append_number(out, or_lie(m->deflated ? 8 : 0, m->method_lie), 2);
  append_number(out, 0, 4); /* no date */
  append_number(out, or_lie((uint32_t)crc32(0, m->data, (uInt)m->size), m->crc_lie), 4);
  append_number(out, m->zip64 ? 0xffffffff : or_lie(packed, m->packed_lie), 4);
  append_number(out, m->zip64 ? 0xffffffff : or_lie((uint32_t)m->size, m->size_lie), 4);
  append_number(out, or_lie((uint32_t)name_size, m->name_size_lie), 2);
  append_number(out, extra, 2);
}

void zip_add(zip_writer *zip, const zip_member *m) {
  const size_t room = m->size + m->size / 2 + 1024,
               name_size = m->name_size > 0 ? m->name_size : strlen(m->name);
  const uint64_t offset = zip->bytes.size;
  unsigned char *packed = malloc(room);
  require(packed != NULL);
  size_t packed_size = m->size;
  if (m->deflated)
    packed_size = deflate_bytes(m, packed, room);
  else if (m->size > 0)
    memcpy(packed, m->data, m->size);
  const uint64_t size = or_lie64(m->size, m->size64_lie), packed64 = or_lie64(packed_size, m->packed64_lie);
  append_number(&zip->bytes, or_lie(0x04034b50, m->local_signature_lie), 4);
  append_common(&zip->bytes, m, (uint32_t)packed_size, m->zip64 ? 20 : 0);
  case_append(&zip->bytes, m->name, name_size);
  if (m->zip64) {
    append_number(&zip->bytes, 1, 2);
    append_number(&zip->bytes, 16, 2);
    append_number(&zip->bytes, size, 8);
    append_number(&zip->bytes, packed64, 8);
  }
  case_append(&zip->bytes, packed, packed_size);
  free(packed);

  append_number(&zip->directory, 0x02014b50, 4);
  append_number(&zip->directory, m->zip64 ? 45 : 20, 2);
  append_common(&zip->directory, m, (uint32_t)packed_size, m->zip64 ? 28 : 0);
  append_number(&zip->directory, 0, 2);
  append_number(&zip->directory, m->disk_lie, 2);
  append_number(&zip->directory, 0, 2);
  append_number(&zip->directory, 0, 4);
  append_number(&zip->directory, m->zip64 ? 0xffffffff : or_lie((uint32_t)offset, m->offset_lie), 4);
  case_append(&zip->directory, m->name, name_size);
  if (m->zip64) {
    append_number(&zip->directory, 1, 2);
    append_number(&zip->directory, 24, 2);
    append_number(&zip->directory, size, 8);
    append_number(&zip->directory, packed64, 8);
    append_number(&zip->directory, or_lie64(offset, m->offset64_lie), 8);
  }
  zip->count++;
}

void zip_end(zip_writer *zip, bool zip64) {
  const uint64_t offset = zip->bytes.size, size = zip->directory.size;
  case_append(&zip->bytes, zip->directory.data, size);
  if (zip64) {
    const uint64_t end = zip->bytes.size;
    append_number(&zip->bytes, 0x06064b50, 4);
    append_number(&zip->bytes, 44, 8);
    append_number(&zip->bytes, 45, 2);
    append_number(&zip->bytes, 45, 2);
    append_number(&zip->bytes, 0, 8); /* this disk and that of the directory */
    append_number(&zip->bytes, or_lie64(zip->count, zip->count64_lie), 8);
    append_number(&zip->bytes, or_lie64(zip->count, zip->count64_lie), 8);
    append_number(&zip->bytes, or_lie64(size, zip->directory_size64_lie), 8);
    append_number(&zip->bytes, or_lie64(offset, zip->directory_offset64_lie), 8);
    append_number(&zip->bytes, 0x07064b50, 4);
    append_number(&zip->bytes, 0, 4);
    append_number(&zip->bytes, or_lie64(end, zip->record64_lie), 8);
    append_number(&zip->bytes, 1, 4);
  }
  append_number(&zip->bytes, 0x06054b50, 4);
  append_number(&zip->bytes, 0, 4);
  append_number(&zip->bytes, zip64 ? 0xffff : zip->count, 2);
  append_number(&zip->bytes, zip64 ? 0xffff : zip->count, 2);
  append_number(&zip->bytes, zip64 ? 0xffffffff : size, 4);
  append_number(&zip->bytes, zip64 ? 0xffffffff : offset, 4);
  append_number(&zip->bytes, 0, 2);
}

void zip_free(zip_writer *zip) {
  case_free(&zip->bytes);
  case_free(&zip->directory);
  zip->count = 0;
}
