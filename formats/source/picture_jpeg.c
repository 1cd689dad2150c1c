/* SPDX-License-Identifier: MIT */
/* picture_jpeg.c: JPEG pictures by libjpeg, a line at a time. */
#include "picture_jpeg_memory.h"

#include <setjmp.h>

#include <jerror.h>

#include "source/picture.h"

enum { MOST_SCANS = 64 }; /* a photograph has about ten; thousands of tiny ones only cost time */

typedef struct jpeg_reader {
  jpeg_memory memory; /* first: picture_jpeg_memory.h */
  struct jpeg_decompress_struct info;
  struct jpeg_error_mgr errors;
  struct jpeg_progress_mgr progress;
  jmp_buf leave;
  picture_fault *fault;
} jpeg_reader;

static void fail_from(j_common_ptr info, btf_status status) {
  jpeg_reader *r = info->client_data;
  char why[JMSG_LENGTH_MAX];
  (*info->err->format_message)(info, why);
  picture_fail(r->fault, status, "JPEG: %.200s", why);
  longjmp(r->leave, 1);
}

static void on_error(j_common_ptr info) {
  jpeg_reader *r = info->client_data;
  if (info->err->msg_code == JERR_OUT_OF_MEMORY && r->memory.over) {
    picture_fail(r->fault, BTF_E_LIMIT, "a JPEG that takes more than %d MiB to decode", JPEG_MOST_MIB);
    longjmp(r->leave, 1);
  }
  fail_from(info, info->err->msg_code == JERR_OUT_OF_MEMORY ? BTF_E_NOMEM : BTF_E_CORRUPT);
}

/* Libjpeg warns where it makes up data that is damaged or not there. */
static void on_message(j_common_ptr info, int level) {
  if (level < 0) fail_from(info, BTF_E_CORRUPT);
}

static void on_progress(j_common_ptr info) {
  jpeg_reader *r = info->client_data;
  if (r->info.input_scan_number <= MOST_SCANS) return;
  picture_fail(r->fault, BTF_E_LIMIT, "a JPEG of more than %d scans", MOST_SCANS);
  longjmp(r->leave, 1);
}

static btf_status decode(jpeg_reader *r, const source_file *file, const picture_info *info,
                         const picture_rules *rules, void *samples) {
  /* libjpeg-turbo writes to aligned addresses around the caches, and reading that back costs more than
   * decoding. */
  _Alignas(64) unsigned char aligned[1 + 3 * PICTURE_MOST_SIDE];
  unsigned char *line = aligned + 1;
  JSAMPROW lines[1] = {line};
  if (setjmp(r->leave) != 0) return r->fault->status;
  jpeg_create_decompress(&r->info);
  jpeg_memory_use(&r->info, &r->memory);
  r->progress.progress_monitor = on_progress;
  r->info.progress = &r->progress;
  jpeg_mem_src(&r->info, file->data, (unsigned long)file->size);
  (void)jpeg_read_header(&r->info, TRUE);
  /* The look at the head and the library must agree, since `line` and `samples` have the sizes of the former.
   */
  if (r->info.image_width != info->width || r->info.image_height != info->height ||
      r->info.num_components != (int)info->channels)
    return picture_fail(r->fault, BTF_E_CORRUPT, "a JPEG with two frame headers");
  r->info.out_color_space = info->channels == 3 ? JCS_RGB : JCS_GRAYSCALE;
  (void)jpeg_start_decompress(&r->info);
  while (r->info.output_scanline < r->info.output_height) {
    const uint32_t row = r->info.output_scanline;
    (void)jpeg_read_scanlines(&r->info, lines, 1);
    picture_store_row(info, rules, row, line, samples);
  }
  (void)jpeg_finish_decompress(&r->info);
  return BTF_OK;
}

btf_status picture_decode_jpeg(const source_file *file, const picture_info *info, const picture_rules *rules,
                               void *samples, picture_fault *fault) {
  jpeg_reader r = {.memory = {.host = file->host, .ctx = file->ctx}, .fault = fault};
  r.info.err = jpeg_std_error(&r.errors);
  r.info.client_data = &r;
  r.errors.error_exit = on_error;
  r.errors.emit_message = on_message;
  const btf_status status = decode(&r, file, info, rules, samples);
  jpeg_destroy_decompress(&r.info);
  return status;
}
