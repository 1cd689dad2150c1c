/* SPDX-License-Identifier: MIT */
/* picture_png.c: PNG pictures by libpng. Palettes and few bits become 8, transparency is left out. */
#include <setjmp.h>
#include <stdlib.h>
#include <string.h>

#include <png.h>

#include "source/picture.h"

enum { MOST_CHUNK_BYTES = 4 << 20, MOST_CHUNKS = 64 };

typedef struct png_source {
  const unsigned char *data;
  size_t left;
  picture_fault *fault;
} png_source;

static void on_error(png_structp png, png_const_charp message) {
  png_source *source = png_get_error_ptr(png);
  picture_fail(source->fault, BTF_E_CORRUPT, "PNG: %.200s", message);
  png_longjmp(png, 1);
}

static void on_warning(png_structp png, png_const_charp message) {
  (void)png, (void)message;
}

static void take(png_structp png, png_bytep dst, size_t count) {
  png_source *source = png_get_io_ptr(png);
  if (count > source->left) png_error(png, "the file ends too early");
  memcpy(dst, source->data, count);
  source->data += count;
  source->left -= count;
}

static btf_status decode(png_structp png, png_infop head, png_source *source, const picture_info *info,
                         unsigned char *codes) {
  const size_t row_bytes = (size_t)info->width * info->channels * (info->depth / 8);
  if (setjmp(png_jmpbuf(png)) != 0) return source->fault->status;
  png_set_user_limits(png, PICTURE_MOST_SIDE, PICTURE_MOST_SIDE);
  png_set_chunk_malloc_max(png, MOST_CHUNK_BYTES);
  png_set_chunk_cache_max(png, MOST_CHUNKS);
  png_set_read_fn(png, source, take);
  png_read_info(png, head);
  png_set_expand(png);
  png_set_strip_alpha(png);
  if (info->depth == 16 && __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__) png_set_swap(png);
  const int passes = png_set_interlace_handling(png);
  png_read_update_info(png, head);
  if (png_get_image_width(png, head) != info->width || png_get_image_height(png, head) != info->height ||
      png_get_rowbytes(png, head) != row_bytes)
    png_error(png, "its header was read in two ways");
  for (int pass = 0; pass < passes; pass++)
    for (uint32_t row = 0; row < info->height; row++) png_read_row(png, codes + row * row_bytes, NULL);
  png_read_end(png, NULL);
  return BTF_OK;
}

btf_status picture_decode_png(const unsigned char *data, size_t size, const picture_info *info,
                              const picture_rules *rules, void *samples, picture_fault *fault) {
  png_source source = {data, size, fault};
  const size_t row_bytes = (size_t)info->width * info->channels * (info->depth / 8);
  unsigned char *codes = calloc(info->height, row_bytes); /* sides are bounded */
  png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &source, on_error, on_warning);
  png_infop head = png != NULL ? png_create_info_struct(png) : NULL;
  btf_status status = BTF_OK;
  if (codes == NULL || head == NULL)
    status = picture_fail(fault, BTF_E_NOMEM, "not enough memory for a PNG");
  else
    status = decode(png, head, &source, info, codes);
  if (status == BTF_OK)
    for (uint32_t row = 0; row < info->height; row++)
      picture_store_row(info, rules, row, codes + row * row_bytes, samples);
  png_destroy_read_struct(&png, &head, NULL);
  free(codes);
  return status;
}
