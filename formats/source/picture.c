/* SPDX-License-Identifier: MIT */
/* picture.c: what a picture is, from its first bytes, and what all kinds share. */
#include "source/picture.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

btf_status picture_fail(picture_fault *fault, btf_status status, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(fault->why, sizeof fault->why, format, arguments);
  va_end(arguments);
  fault->status = status;
  return status;
}

const char *picture_kind_name(picture_kind kind) {
  static const char *const names[] = {"JPEG", "PNG", "Radiance HDR"};
  return names[kind];
}

static uint32_t big_u16(const unsigned char *p) {
  return (uint32_t)p[0] << 8 | p[1];
}
static uint32_t big_u32(const unsigned char *p) {
  return big_u16(p) << 16 | big_u16(p + 2);
}

/* Walks the segments up to the frame header, which has the size. */
static btf_status look_jpeg(const unsigned char *data, size_t size, picture_info *info, bool *complete,
                            picture_fault *fault) {
  size_t at = 2;
  *complete = false;
  while (at < size) {
    if (data[at] != 0xff) return picture_fail(fault, BTF_E_CORRUPT, "no JPEG marker at byte %zu", at);
    while (at < size && data[at] == 0xff) at++;
    if (size - at < 3) return BTF_OK;
    const unsigned char marker = data[at];
    const uint32_t length = big_u16(data + at + 1);
    if (marker == 0xda || marker == 0xd9 || marker == 0 || (marker >= 0xd0 && marker <= 0xd8) || length < 2)
      return picture_fail(fault, BTF_E_CORRUPT, "a JPEG without frame header");
    if (marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc) {
      if (size - at < 9) return BTF_OK;
      *info = (picture_info){.kind = PICTURE_JPEG,
                             .depth = data[at + 3],
                             .height = big_u16(data + at + 4),
                             .width = big_u16(data + at + 6),
                             .channels = data[at + 8]};
      *complete = true;
      return info->depth == 8 ? BTF_OK
                              : picture_fail(fault, BTF_E_UNSUPPORTED,
                                             "a JPEG of %u bits a sample; 8 are read", info->depth);
    }
    at += 1 + (size_t)length;
  }
  return BTF_OK;
}

static btf_status look_png(const unsigned char *data, size_t size, picture_info *info, bool *complete,
                           picture_fault *fault) {
  *complete = size >= 29;
  if (!*complete) return BTF_OK;
  if (memcmp(data + 12, "IHDR", 4) != 0) return picture_fail(fault, BTF_E_CORRUPT, "a PNG without header");
  const unsigned depth = data[24], colour = data[25];
  *info = (picture_info){.kind = PICTURE_PNG,
                         .width = big_u32(data + 16),
                         .height = big_u32(data + 20),
                         .channels = (colour & 2u) != 0 ? 3 : 1,
                         .depth = depth == 16 ? 16 : 8};
  return BTF_OK;
}

btf_status picture_look(const unsigned char *data, size_t size, picture_info *info, bool *complete,
                        picture_fault *fault) {
  static const unsigned char png[] = {0x89, 'P', 'N', 'G', 13, 10, 26, 10};
  static const unsigned char exr[] = {0x76, 0x2f, 0x31, 0x01};
  *complete = false;
  btf_status status;
  if (size >= 3 && data[0] == 0xff && data[1] == 0xd8)
    status = look_jpeg(data, size, info, complete, fault);
  else if (size >= sizeof png && memcmp(data, png, sizeof png) == 0)
    status = look_png(data, size, info, complete, fault);
  else if (size >= 2 && data[0] == '#' && data[1] == '?')
    status = picture_look_hdr(data, size, info, complete, fault);
  else if (size >= sizeof exr && memcmp(data, exr, sizeof exr) == 0)
    return picture_fail(fault, BTF_E_UNSUPPORTED, "is OpenEXR; JPEG, PNG and Radiance HDR are read");
  else
    return picture_fail(fault, BTF_E_CORRUPT, "is neither JPEG, PNG nor Radiance HDR");
  if (status != BTF_OK || !*complete) return status;
  if (info->width < 1 || info->height < 1)
    return picture_fail(fault, BTF_E_CORRUPT, "a picture of %u x %u", info->width, info->height);
  if (info->width > PICTURE_MOST_SIDE || info->height > PICTURE_MOST_SIDE)
    return picture_fail(fault, BTF_E_LIMIT, "a picture of %u x %u; at most %d a side are read", info->width,
                        info->height, PICTURE_MOST_SIDE);
  if (info->channels != 1 && info->channels != 3)
    return picture_fail(fault, BTF_E_UNSUPPORTED, "a picture of %u channels; 1 and 3 are read",
                        info->channels);
  return BTF_OK;
}

/* Eight samples are stored at once: a store for each takes as long as decoding the JPEG. */
static void look_up_halves(const unsigned char *codes, size_t count, const uint16_t *table, uint16_t *dst) {
  size_t i = 0;
  for (; i + 8 <= count; i += 8) {
    uint16_t eight[8];
    for (int k = 0; k < 8; k++) eight[k] = table[codes[i + (size_t)k]];
    memcpy(dst + i, eight, sizeof eight);
  }
  for (; i < count; i++) dst[i] = table[codes[i]];
}

static void look_up_floats(const unsigned char *codes, size_t count, const float *table, float *dst) {
  size_t i = 0;
  for (; i + 4 <= count; i += 4) {
    const float four[4] = {table[codes[i]], table[codes[i + 1]], table[codes[i + 2]], table[codes[i + 3]]};
    memcpy(dst + i, four, sizeof four);
  }
  for (; i < count; i++) dst[i] = table[codes[i]];
}

void picture_store_row(const picture_info *info, const picture_rules *rules, uint32_t row, const void *codes,
                       void *samples) {
  const size_t count = (size_t)info->width * info->channels;
  const size_t at = count * (rules->upside_down ? row : info->height - 1 - row);
  const unsigned char *code8 = codes;
  const uint16_t *code16 = codes;
  if (rules->sample_size == 1) {
    memcpy((unsigned char *)samples + at, codes, count);
  } else if (rules->sample_size == 2) {
    const uint16_t *table = rules->table;
    uint16_t *dst = (uint16_t *)samples + at;
    if (info->depth == 8)
      look_up_halves(code8, count, table, dst);
    else
      for (size_t i = 0; i < count; i++) dst[i] = table[code16[i]];
  } else {
    const float *table = rules->table;
    float *dst = (float *)samples + at;
    if (info->depth == 8)
      look_up_floats(code8, count, table, dst);
    else
      for (size_t i = 0; i < count; i++) dst[i] = table[code16[i]];
  }
}

btf_status picture_decode(const source_file *file, const picture_info *info, const picture_rules *rules,
                          void *samples, picture_fault *fault) {
  picture_info found;
  bool complete;
  const btf_status status = picture_look(file->data, file->size, &found, &complete, fault);
  if (status != BTF_OK) return status;
  if (!complete || !picture_alike(&found, info))
    return picture_fail(fault, BTF_E_CORRUPT, "changed since the archive was opened");
  switch (info->kind) {
  case PICTURE_JPEG:
    return picture_decode_jpeg(file, info, rules, samples, fault);
  case PICTURE_PNG:
    return picture_decode_png(file, info, rules, samples, fault);
  default:
    return picture_decode_hdr(file, info, rules, samples, fault);
  }
}
