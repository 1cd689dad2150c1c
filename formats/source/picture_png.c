/* SPDX-License-Identifier: MIT */
/* picture_png.c: PNG pictures by libpng. Palettes and few bits become 8, transparency is left out. */
#include <setjmp.h>

#include <png.h>

#include "source/picture.h"

enum { MOST_CHUNK_BYTES = 4 << 20, MOST_CHUNKS = 64 };

typedef struct png_source {
  const source_file *file;
  size_t at;
  bool no_memory;       /* the host refused some, whatever libpng made of that */
  unsigned char *codes; /* a row, or all of them of a picture that comes in several passes */
  picture_fault *fault;
} png_source;

static void on_error(png_structp png, png_const_charp message) {
  png_source *source = png_get_error_ptr(png);
  picture_fail(source->fault, source->no_memory ? BTF_E_NOMEM : BTF_E_CORRUPT, "PNG: %.200s", message);
  png_longjmp(png, 1);
}

static void on_warning(png_structp png, png_const_charp message) {
  (void)png, (void)message;
}

static png_voidp take_room(png_structp png, png_alloc_size_t size) {
  png_source *source = png_get_mem_ptr(png);
  void *room = (source->file->host->alloc)(source->file->ctx, size, 1);
  if (room == NULL) source->no_memory = true;
  return room;
}

static void drop_room(png_structp png, png_voidp room) {
  const png_source *source = png_get_mem_ptr(png);
  (source->file->host->free)(source->file->ctx, room);
}

static void take(png_structp png, png_bytep dst, size_t count) {
  png_source *source = png_get_io_ptr(png);
  if (count > source->file->size - source->at) png_error(png, "the file ends too early");
  memcpy(dst, source->file->data + source->at, count);
  source->at += count;
}

static btf_status decode(png_structp png, png_infop head, png_source *source, const picture_info *info,
                         const picture_rules *rules, void *samples) {
  const size_t row_bytes = (size_t)info->width * info->channels * (info->depth / 8);
  if (setjmp(png_jmpbuf(png)) != 0) return source->fault->status;
  png_set_user_limits(png, PICTURE_MOST_SIDE, PICTURE_MOST_SIDE);
  png_set_chunk_malloc_max(png, MOST_CHUNK_BYTES);
  png_set_chunk_cache_max(png, MOST_CHUNKS);
  /* Texts and profiles are neither unpacked nor kept. */
  png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_NEVER, NULL, -1);
  png_set_crc_action(png, PNG_CRC_ERROR_QUIT, PNG_CRC_ERROR_QUIT);
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
  /* Rows of a later pass come on top of what is there. */
  const bool at_once = passes == 1;
  source->codes = png_calloc(png, at_once ? row_bytes : info->height * row_bytes); /* sides are bounded */
  for (int pass = 0; pass < passes; pass++)
    for (uint32_t row = 0; row < info->height; row++) {
      unsigned char *codes = source->codes + (at_once ? 0 : row * row_bytes);
      png_read_row(png, codes, NULL);
      if (pass == passes - 1) picture_store_row(info, rules, row, codes, samples);
    }
  png_read_end(png, NULL);
  return BTF_OK;
}

btf_status picture_decode_png(const source_file *file, const picture_info *info, const picture_rules *rules,
                              void *samples, picture_fault *fault) {
  png_source source = {.file = file, .fault = fault};
  png_structp png = png_create_read_struct_2(PNG_LIBPNG_VER_STRING, &source, on_error, on_warning, &source,
                                             take_room, drop_room);
  png_infop head = png != NULL ? png_create_info_struct(png) : NULL;
  btf_status status = head != NULL ? decode(png, head, &source, info, rules, samples) : BTF_E_NOMEM;
  if (status == BTF_E_NOMEM || source.no_memory)
    status = picture_fail(fault, BTF_E_NOMEM, "not enough memory for a PNG");
  (file->host->free)(file->ctx, source.codes);
  png_destroy_read_struct(&png, &head, NULL);
  return status;
}
