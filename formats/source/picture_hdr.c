/* SPDX-License-Identifier: MIT */
/* picture_hdr.c: Radiance pictures. The line of sizes usually reads "-Y height +X width"; in ATRIUM it is "+X
 * width -Y height", for which every line of the file is a column. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <btf/btf_half.h>

#include "source/picture.h"

typedef struct hdr_input {
  const unsigned char *data;
  size_t size, at;
} hdr_input;

typedef enum hdr_line { HDR_LINE, HDR_LINE_CUT, HDR_LINE_LONG } hdr_line;

static hdr_line next_line(hdr_input *in, char line[256]) {
  const size_t left = in->size - in->at, most = left < 256 ? left : 256;
  const unsigned char *start = in->data + in->at, *end = memchr(start, '\n', most);
  if (end == NULL) return most < 256 ? HDR_LINE_CUT : HDR_LINE_LONG;
  const size_t length = (size_t)(end - start);
  memcpy(line, start, length);
  line[length] = '\0';
  in->at += length + 1;
  return HDR_LINE;
}

static btf_status read_sizes(const char *line, picture_info *info, picture_fault *fault) {
  char signs[2], axes[2];
  unsigned sizes[2];
  if (sscanf(line, "%c%c %6u %c%c %6u", &signs[0], &axes[0], &sizes[0], &signs[1], &axes[1], &sizes[1]) != 6)
    return picture_fail(fault, BTF_E_CORRUPT, "a Radiance picture without a line of sizes");
  const bool by_columns = axes[0] == 'X';
  const int x = by_columns ? 0 : 1, y = 1 - x;
  if (axes[x] != 'X' || axes[y] != 'Y' || signs[x] != '+' || signs[y] != '-')
    return picture_fail(fault, BTF_E_UNSUPPORTED,
                        "a Radiance picture of sizes \"%.40s\"; -Y H +X W and +X W -Y H are read", line);
  *info = (picture_info){.kind = PICTURE_HDR,
                         .width = sizes[x],
                         .height = sizes[y],
                         .channels = 3,
                         .depth = 32,
                         .by_columns = by_columns};
  return BTF_OK;
}

/* Header lines up to the sizes. */
static btf_status read_head(hdr_input *in, picture_info *info, double *exposure, bool *complete,
                            picture_fault *fault) {
  char line[256];
  hdr_line got;
  bool body = false; /* behind the empty line */
  *complete = false;
  *exposure = 1;
  while ((got = next_line(in, line)) == HDR_LINE) {
    if (body) {
      *complete = true;
      return read_sizes(line, info, fault);
    }
    body = line[0] == '\0';
    if (strncmp(line, "FORMAT=", 7) == 0 && strcmp(line + 7, "32-bit_rle_rgbe") != 0)
      return picture_fail(fault, BTF_E_UNSUPPORTED,
                          "Radiance pixels of the format \"%.40s\"; 32-bit_rle_rgbe is read", line + 7);
    if (strncmp(line, "EXPOSURE=", 9) == 0) {
      const double factor = strtod(line + 9, NULL);
      if (isfinite(factor) && factor > 0) *exposure *= factor;
    }
  }
  return got == HDR_LINE_CUT ? BTF_OK
                             : picture_fail(fault, BTF_E_CORRUPT, "a Radiance header line without end");
}

btf_status picture_look_hdr(const unsigned char *data, size_t size, picture_info *info, bool *complete,
                            picture_fault *fault) {
  hdr_input in = {data, size, 0};
  double exposure;
  return read_head(&in, info, &exposure, complete, fault);
}

/* Each component by itself: 128 + n is a run of n, n up to 128 that many values. */
static bool read_runs(hdr_input *in, unsigned char *line, uint32_t count) {
  for (int component = 0; component < 4; component++)
    for (uint32_t i = 0; i < count;) {
      if (in->size - in->at < 2) return false;
      const uint32_t code = in->data[in->at++], length = code > 128 ? code - 128 : code;
      const uint32_t bytes = code > 128 ? 1 : length;
      if (length == 0 || length > count - i || bytes > in->size - in->at) return false;
      for (uint32_t k = 0; k < length; k++)
        line[4 * (i + k) + (uint32_t)component] = in->data[in->at + (code > 128 ? 0 : k)];
      in->at += bytes;
      i += length;
    }
  return true;
}

/* Pixels one after the other; (1, 1, 1, n) repeats the one before n times, a second such 256 n times, and so
 * on. */
static bool read_plain(hdr_input *in, unsigned char *line, uint32_t count) {
  static const unsigned char repeat[] = {1, 1, 1};
  unsigned shift = 0;
  for (uint32_t i = 0; i < count;) {
    if (in->size - in->at < 4) return false;
    const unsigned char *pixel = in->data + in->at;
    in->at += 4;
    if (i == 0 || memcmp(pixel, repeat, 3) != 0) {
      memcpy(line + 4 * (size_t)i++, pixel, 4);
      shift = 0;
      continue;
    }
    if (shift > 8) return false; /* sides are below 65536 */
    const uint32_t length = (uint32_t)pixel[3] << shift;
    if (length > count - i) return false;
    for (uint32_t k = 0; k < length; k++, i++) memcpy(line + 4 * (size_t)i, line + 4 * ((size_t)i - 1), 4);
    shift += 8;
  }
  return true;
}

static bool read_line(hdr_input *in, unsigned char *line, uint32_t count) {
  const unsigned char *p = in->data + in->at;
  const bool runs =
      count >= 8 && in->size - in->at >= 4 && p[0] == 2 && p[1] == 2 && ((uint32_t)p[2] << 8 | p[3]) == count;
  if (!runs) return read_plain(in, line, count);
  in->at += 4;
  return read_runs(in, line, count);
}

/* Pixel k of line n: its column, and its row counted from the top. */
static void place(const picture_info *info, const picture_rules *rules, uint32_t n, uint32_t k, uint32_t *x,
                  uint32_t *row) {
  if (!info->by_columns) {
    *x = k;
    *row = n;
  } else if (rules->columns_as_rows) {
    *x = k;
    *row = info->height - 1 - n;
  } else {
    *x = n;
    *row = k;
  }
}

/* False for a value that the type does not hold. */
static bool store(const picture_rules *rules, size_t at, double value, void *samples) {
  const bool half = rules->sample_size == 2;
  if (!(value < (half ? 65520.0 : (double)FLT_MAX))) return false; /* less rounds to a finite half float */
  if (half)
    ((uint16_t *)samples)[at] = btf_float_to_half((float)value);
  else
    ((float *)samples)[at] = (float)value;
  return true;
}

btf_status picture_decode_hdr(const source_file *file, const picture_info *info, const picture_rules *rules,
                              void *samples, picture_fault *fault) {
  unsigned char line[4 * PICTURE_MOST_SIDE];
  hdr_input in = {file->data, file->size, 0};
  picture_info found;
  double exposure;
  bool complete;
  const btf_status status = read_head(&in, &found, &exposure, &complete, fault);
  if (status != BTF_OK) return status;
  const uint32_t lines = info->by_columns ? info->width : info->height;
  const uint32_t count = info->by_columns ? info->height : info->width;
  for (uint32_t n = 0; n < lines; n++) {
    if (!read_line(&in, line, count))
      return picture_fail(fault, BTF_E_CORRUPT, "line %u of a Radiance picture is cut short or runs over", n);
    for (uint32_t k = 0; k < count; k++) {
      const unsigned char *p = line + 4 * (size_t)k;
      /* The middle of the values that get this code. */
      const double scale = p[3] > 0 ? ldexp(1, p[3] - 136) / exposure : 0;
      uint32_t x, row;
      place(info, rules, n, k, &x, &row);
      const size_t at = 3 * ((size_t)(rules->upside_down ? row : info->height - 1 - row) * info->width + x);
      for (size_t c = 0; c < 3; c++)
        if (!store(rules, at + c, (p[c] + 0.5) * scale, samples))
          return picture_fail(fault, BTF_E_LIMIT, "the value %.6g at column %u, row %u is beyond %s",
                              (p[c] + 0.5) * scale, x, row,
                              rules->sample_size == 2 ? "half floats; type=f32 takes it" : "floats");
    }
  }
  return BTF_OK;
}
