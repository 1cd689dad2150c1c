/* SPDX-License-Identifier: MIT */
/* exr.c: OpenEXR files through OpenEXRCore, read from and written to memory. */
#include <openexr.h>

#include <btf/btf_half.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../cli.h"
#include "../output_file.h"
#include "image_files.h"

enum { message_size = 200, most_side = 65535 };

static const float largest_half = 65504;

typedef struct exr_memory {
  const char *path;
  const unsigned char *source; /* reading */
  uint64_t size;
  unsigned char *written; /* writing */
  uint64_t capacity;
  char message[message_size];
} exr_memory;

/* OpenEXRCore hands its callbacks a context of which only the user data is known here. */
static exr_memory *memory_of(exr_const_context_t ctx) {
  void *user = NULL;
  exr_get_user_data(ctx, &user);
  return user;
}

static void on_error(exr_const_context_t ctx, exr_result_t code, const char *message) {
  exr_memory *m = ctx != NULL ? memory_of(ctx) : NULL;
  (void)code;
  if (m != NULL && m->message[0] == '\0') snprintf(m->message, sizeof m->message, "%s", message);
}

static int64_t size_of_source(exr_const_context_t ctx, void *user) {
  (void)ctx;
  return (int64_t)((exr_memory *)user)->size;
}

static int64_t read_source(exr_const_context_t ctx, void *user, void *dst, uint64_t n, uint64_t offset,
                           exr_stream_error_func_ptr_t error) {
  const exr_memory *m = user;
  (void)ctx;
  (void)error;
  if (offset > m->size) return -1;
  if (n > m->size - offset) n = m->size - offset;
  memcpy(dst, m->source + offset, n);
  return (int64_t)n;
}

static int64_t write_memory(exr_const_context_t ctx, void *user, const void *src, uint64_t n, uint64_t offset,
                            exr_stream_error_func_ptr_t error) {
  exr_memory *m = user;
  (void)ctx;
  (void)error;
  if (offset + n > m->capacity) {
    const uint64_t capacity = 2 * (offset + n) + 65536;
    unsigned char *grown = realloc(m->written, capacity);
    if (grown == NULL) return -1;
    memset(grown + m->capacity, 0, capacity - m->capacity);
    m->written = grown;
    m->capacity = capacity;
  }
  memcpy(m->written + offset, src, n);
  if (offset + n > m->size) m->size = offset + n;
  return (int64_t)n;
}

static int fail(const exr_memory *m, exr_result_t code, const char *what) {
  const char *why = m->message[0] != '\0' ? m->message : exr_get_default_error_message(code);
  const int exit_status = code == EXR_ERR_OUT_OF_MEMORY             ? EXIT_LIMIT
                          : code == EXR_ERR_FEATURE_NOT_IMPLEMENTED ? EXIT_UNSUPPORTED
                                                                    : EXIT_MALFORMED;
  return cli_fail(exit_status, "%s: %s: %s", m->path, what, why);
}

/* ---- reading ---- */

static int channel_slot(const char *name) {
  static const char letters[] = "RGB";
  const char *found = strlen(name) == 1 ? strchr(letters, name[0]) : NULL;
  return found != NULL ? (int)(found - letters) : strcmp(name, "Y") == 0 ? 3 : -1;
}

/* What of a part is used: R, G and B, or Y alone for all three. */
static int choose_channels(const exr_memory *m, exr_context_t ctx, bool *grey) {
  const exr_attr_chlist_t *list = NULL;
  bool present[4] = {false, false, false, false};
  exr_result_t code = exr_get_channels(ctx, 0, &list);
  if (code != EXR_ERR_SUCCESS) return fail(m, code, "no channels");
  for (int i = 0; i < list->num_channels; i++) {
    const exr_attr_chlist_entry_t *entry = &list->entries[i];
    const int slot = channel_slot(entry->name.str);
    if (slot < 0) continue;
    if (entry->x_sampling != 1 || entry->y_sampling != 1)
      return cli_fail(EXIT_UNSUPPORTED, "%s: channel %s is subsampled; full resolution is expected", m->path,
                      entry->name.str);
    present[slot] = true;
  }
  *grey = present[3] && !(present[0] && present[1] && present[2]);
  if (!*grey && !(present[0] && present[1] && present[2]))
    return cli_fail(EXIT_UNSUPPORTED, "%s: has neither channels R, G and B nor Y", m->path);
  return EXIT_DONE;
}

/* The chunks of a part on their way into a picture. */
typedef struct exr_chunks {
  exr_context_t ctx;
  exr_decode_pipeline_t decoder;
  bool started, grey;
  image *out;
  unsigned char *planes; /* the used channels of one chunk, one after the other */
  size_t room;
} exr_chunks;

static bool is_used(const exr_chunks *c, const exr_coding_channel_info_t *channel) {
  const int slot = channel_slot(channel->channel_name);
  return slot >= 0 && c->grey == (slot == 3);
}

static size_t plane_bytes(const exr_coding_channel_info_t *channel) {
  return (size_t)channel->width * (size_t)channel->height * channel->user_bytes_per_element;
}

/* Says where the samples of a chunk whose first pixel is (x, y) of the picture go. They keep their type: the
 * library's routines that also convert expect that every channel is wanted, and write to NULL otherwise. */
static exr_result_t aim_chunk(exr_chunks *c, uint32_t x, uint32_t y) {
  size_t size = 0, offset = 0;
  for (int i = 0; i < c->decoder.channel_count; i++) {
    exr_coding_channel_info_t *channel = &c->decoder.channels[i];
    channel->decode_to_ptr = NULL;
    channel->user_data_type = channel->data_type;
    channel->user_bytes_per_element = channel->bytes_per_element;
    channel->user_pixel_stride = channel->bytes_per_element;
    channel->user_line_stride = channel->width * channel->bytes_per_element;
    if (!is_used(c, channel)) continue;
    if (channel->width < 0 || (uint64_t)x + (uint32_t)channel->width > c->out->width || channel->height < 0 ||
        (uint64_t)y + (uint32_t)channel->height > c->out->height)
      return EXR_ERR_INVALID_ATTR;
    size += plane_bytes(channel);
  }
  if (size > c->room) {
    free(c->planes);
    c->planes = malloc(size);
    c->room = c->planes != NULL ? size : 0;
    if (c->planes == NULL) return EXR_ERR_OUT_OF_MEMORY;
  }
  for (int i = 0; i < c->decoder.channel_count; i++) {
    exr_coding_channel_info_t *channel = &c->decoder.channels[i];
    if (!is_used(c, channel)) continue;
    channel->decode_to_ptr = c->planes + offset;
    offset += plane_bytes(channel);
  }
  return EXR_ERR_SUCCESS;
}

static float sample_value(const unsigned char *sample, uint16_t type) {
  uint16_t half;
  uint32_t whole;
  float value;
  if (type == EXR_PIXEL_HALF) {
    memcpy(&half, sample, sizeof half);
    return btf_half_to_float(half);
  }
  if (type == EXR_PIXEL_UINT) {
    memcpy(&whole, sample, sizeof whole);
    return (float)whole;
  }
  memcpy(&value, sample, sizeof value);
  return value;
}

static void store_chunk(const exr_chunks *c, uint32_t x, uint32_t y) {
  for (int i = 0; i < c->decoder.channel_count; i++) {
    const exr_coding_channel_info_t *channel = &c->decoder.channels[i];
    const unsigned char *sample = channel->decode_to_ptr;
    if (!is_used(c, channel)) continue;
    const int slot = c->grey ? 0 : channel_slot(channel->channel_name);
    for (uint32_t line = 0; line < (uint32_t)channel->height; line++) {
      float *pixel = image_pixel(c->out, x, y + line) + slot;
      for (uint32_t k = 0; k < (uint32_t)channel->width; k++, sample += channel->user_bytes_per_element)
        pixel[3 * (size_t)k] = sample_value(sample, channel->data_type);
    }
  }
}

static exr_result_t decode_chunk(exr_chunks *c, const exr_chunk_info_t *chunk, uint32_t x, uint32_t y) {
  const bool first = !c->started;
  exr_result_t code = first ? exr_decoding_initialize(c->ctx, 0, chunk, &c->decoder)
                            : exr_decoding_update(c->ctx, 0, chunk, &c->decoder);
  c->started = true;
  if (code == EXR_ERR_SUCCESS) code = aim_chunk(c, x, y);
  if (code == EXR_ERR_SUCCESS && first) code = exr_decoding_choose_default_routines(c->ctx, 0, &c->decoder);
  if (code == EXR_ERR_SUCCESS) code = exr_decoding_run(c->ctx, 0, &c->decoder);
  if (code == EXR_ERR_SUCCESS) store_chunk(c, x, y);
  return code;
}

static exr_result_t decode_scanlines(exr_chunks *c, int32_t first_line) {
  int32_t lines = 1;
  exr_result_t code = exr_get_scanlines_per_chunk(c->ctx, 0, &lines);
  if (code == EXR_ERR_SUCCESS && lines < 1) code = EXR_ERR_INVALID_ATTR;
  for (uint32_t y = 0; code == EXR_ERR_SUCCESS && y < c->out->height; y += (uint32_t)lines) {
    exr_chunk_info_t chunk;
    code = exr_read_scanline_chunk_info(c->ctx, 0, first_line + (int32_t)y, &chunk);
    if (code == EXR_ERR_SUCCESS) code = decode_chunk(c, &chunk, 0, y);
  }
  return code;
}

static exr_result_t decode_tiles(exr_chunks *c) {
  int32_t width = 0, height = 0;
  exr_result_t code = exr_get_tile_sizes(c->ctx, 0, 0, 0, &width, &height);
  if (code == EXR_ERR_SUCCESS && (width < 1 || height < 1)) code = EXR_ERR_INVALID_ATTR;
  for (uint32_t ty = 0; code == EXR_ERR_SUCCESS && (uint64_t)ty * (uint32_t)height < c->out->height; ty++) {
    for (uint32_t tx = 0; code == EXR_ERR_SUCCESS && (uint64_t)tx * (uint32_t)width < c->out->width; tx++) {
      exr_chunk_info_t chunk;
      code = exr_read_tile_chunk_info(c->ctx, 0, (int)tx, (int)ty, 0, 0, &chunk);
      if (code == EXR_ERR_SUCCESS)
        code = decode_chunk(c, &chunk, tx * (uint32_t)width, ty * (uint32_t)height);
    }
  }
  return code;
}

static exr_result_t decode_part(exr_context_t ctx, exr_storage_t storage, int32_t first_line, bool grey,
                                image *out) {
  exr_chunks chunks = {.ctx = ctx, .decoder = EXR_DECODE_PIPELINE_INITIALIZER, .grey = grey, .out = out};
  const exr_result_t code =
      storage == EXR_STORAGE_TILED ? decode_tiles(&chunks) : decode_scanlines(&chunks, first_line);
  exr_decoding_destroy(ctx, &chunks.decoder);
  free(chunks.planes);
  return code;
}

static int decode_open_file(exr_memory *m, exr_context_t ctx, image *out) {
  exr_attr_box2i_t window;
  exr_storage_t storage;
  exr_result_t code = exr_get_storage(ctx, 0, &storage);
  bool grey = false;
  int failed;
  if (code == EXR_ERR_SUCCESS) code = exr_get_data_window(ctx, 0, &window);
  if (code != EXR_ERR_SUCCESS) return fail(m, code, "malformed OpenEXR header");
  if (storage != EXR_STORAGE_SCANLINE && storage != EXR_STORAGE_TILED)
    return cli_fail(EXIT_UNSUPPORTED, "%s: holds deep data; a flat picture is expected", m->path);
  if ((int64_t)window.max.x - window.min.x >= most_side ||
      (int64_t)window.max.y - window.min.y >= most_side || window.max.x < window.min.x ||
      window.max.y < window.min.y)
    return cli_fail(EXIT_LIMIT, "%s: data window out of range; at most %d pixels along a side", m->path,
                    most_side);
  failed = choose_channels(m, ctx, &grey);
  if (!failed)
    failed = image_create(out, (uint32_t)(window.max.x - window.min.x) + 1,
                          (uint32_t)(window.max.y - window.min.y) + 1);
  if (failed) return failed;
  code = decode_part(ctx, storage, window.min.y, grey, out);
  if (code != EXR_ERR_SUCCESS) return fail(m, code, "malformed OpenEXR file");
  for (size_t i = 0; grey && i < (size_t)out->width * out->height; i++)
    out->rgb[3 * i + 1] = out->rgb[3 * i + 2] = out->rgb[3 * i];
  return EXIT_DONE;
}

int image_decode_exr(const image_bytes *file, image *out) {
  exr_memory m = {file->path, file->data, file->size, NULL, 0, ""};
  exr_context_initializer_t setup = EXR_DEFAULT_CONTEXT_INITIALIZER;
  exr_context_t ctx = NULL;
  exr_result_t code;
  int failed;
  setup.error_handler_fn = on_error;
  setup.user_data = &m;
  setup.size_fn = size_of_source;
  setup.read_fn = read_source;
  setup.max_image_width = most_side;
  setup.max_image_height = most_side;
  setup.max_tile_width = most_side;
  setup.max_tile_height = most_side;
  code = exr_start_read(&ctx, file->path, &setup);
  if (code != EXR_ERR_SUCCESS) return fail(&m, code, "malformed OpenEXR header");
  failed = decode_open_file(&m, ctx, out);
  exr_finish(&ctx);
  return failed;
}

/* ---- writing ---- */

static exr_result_t encode_chunks(exr_context_t ctx, const image *picture) {
  exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
  int32_t lines = 1;
  exr_result_t code = exr_get_scanlines_per_chunk(ctx, 0, &lines);
  for (uint32_t y = 0; code == EXR_ERR_SUCCESS && y < picture->height; y += (uint32_t)lines) {
    exr_chunk_info_t chunk;
    code = exr_write_scanline_chunk_info(ctx, 0, (int)y, &chunk);
    if (code == EXR_ERR_SUCCESS)
      code = y == 0 ? exr_encoding_initialize(ctx, 0, &chunk, &encoder)
                    : exr_encoding_update(ctx, 0, &chunk, &encoder);
    for (int i = 0; code == EXR_ERR_SUCCESS && i < encoder.channel_count; i++) {
      exr_coding_channel_info_t *channel = &encoder.channels[i];
      channel->user_data_type = EXR_PIXEL_FLOAT;
      channel->user_bytes_per_element = sizeof(float);
      channel->user_pixel_stride = 3 * sizeof(float);
      channel->user_line_stride = (int32_t)(picture->width * 3 * sizeof(float));
      channel->encode_from_ptr =
          (const uint8_t *)(image_pixel(picture, 0, y) + channel_slot(channel->channel_name));
    }
    if (code == EXR_ERR_SUCCESS && y == 0) code = exr_encoding_choose_default_routines(ctx, 0, &encoder);
    if (code == EXR_ERR_SUCCESS) code = exr_encoding_run(ctx, 0, &encoder);
  }
  exr_encoding_destroy(ctx, &encoder);
  return code;
}

static exr_result_t encode(exr_memory *m, const image *picture, bool half) {
  static const char *const names[] = {"B", "G", "R"};
  exr_context_initializer_t setup = EXR_DEFAULT_CONTEXT_INITIALIZER;
  exr_context_t ctx = NULL;
  exr_result_t code;
  int part;
  setup.error_handler_fn = on_error;
  setup.user_data = m;
  setup.write_fn = write_memory;
  /* The name is for messages only: writing goes through write_memory. */
  code = exr_start_write(&ctx, m->path, EXR_WRITE_FILE_DIRECTLY, &setup);
  if (code != EXR_ERR_SUCCESS) return code;
  code = exr_add_part(ctx, "picture", EXR_STORAGE_SCANLINE, &part);
  if (code == EXR_ERR_SUCCESS)
    code = exr_initialize_required_attr_simple(ctx, part, (int32_t)picture->width, (int32_t)picture->height,
                                               EXR_COMPRESSION_ZIP);
  for (int i = 0; code == EXR_ERR_SUCCESS && i < 3; i++)
    code = exr_add_channel(ctx, part, names[i], half ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT,
                           EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
  if (code == EXR_ERR_SUCCESS) code = exr_write_header(ctx);
  if (code == EXR_ERR_SUCCESS) code = encode_chunks(ctx, picture);
  if (code == EXR_ERR_SUCCESS) return exr_finish(&ctx);
  exr_finish(&ctx);
  return code;
}

int image_write_exr(const image *picture, const char *path, bool half) {
  exr_memory m = {path, NULL, 0, NULL, 0, ""};
  image clipped = {0};
  exr_result_t code;
  int failed = EXIT_DONE;
  if (half) {
    const size_t count = (size_t)picture->width * picture->height * 3;
    failed = image_create(&clipped, picture->width, picture->height);
    for (size_t i = 0; !failed && i < count; i++) {
      const float value = picture->rgb[i];
      clipped.rgb[i] = value > largest_half ? largest_half : value < -largest_half ? -largest_half : value;
    }
  }
  if (!failed) {
    code = encode(&m, half ? &clipped : picture, half);
    if (code != EXR_ERR_SUCCESS)
      failed = cli_fail(code == EXR_ERR_OUT_OF_MEMORY ? EXIT_LIMIT : EXIT_FAILED,
                        "%s: OpenEXR encoding failed: %s", path,
                        m.message[0] != '\0' ? m.message : exr_get_default_error_message(code));
  }
  if (!failed) failed = output_write(path, m.written, m.size);
  image_free(&clipped);
  free(m.written);
  return failed;
}
