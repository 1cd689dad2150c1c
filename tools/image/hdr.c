/* SPDX-License-Identifier: MIT */
/* hdr.c: reads Radiance pictures (RGBE, flat or run-length coded, any orientation). */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../cli.h"
#include "image_files.h"

typedef struct hdr_reader {
  const image_bytes *file;
  size_t position;
  double exposure;
} hdr_reader;

static int malformed(const hdr_reader *r, const char *what) {
  return cli_fail(EXIT_MALFORMED, "%s: %s at byte %zu of a Radiance picture", r->file->path, what,
                  r->position);
}

/* One header line without its line break; false at the end of the file or when it is too long to be one. */
static bool read_line(hdr_reader *r, char *line, size_t room) {
  size_t length = 0;
  while (r->position < r->file->size) {
    const char c = (char)r->file->data[r->position++];
    if (c == '\n') {
      if (length > 0 && line[length - 1] == '\r') length--;
      line[length] = '\0';
      return true;
    }
    if (length + 1 >= room) return false;
    line[length++] = c;
  }
  return false;
}

static int read_header(hdr_reader *r) {
  char line[512];
  r->exposure = 1;
  if (!read_line(r, line, sizeof line)) return malformed(r, "no header line");
  for (;;) {
    if (!read_line(r, line, sizeof line)) return malformed(r, "the header has no end");
    if (line[0] == '\0') return EXIT_DONE;
    if (strncmp(line, "FORMAT=", 7) == 0 && strcmp(line + 7, "32-bit_rle_rgbe") != 0)
      return cli_fail(EXIT_UNSUPPORTED, "%s: pixel format \"%.40s\"; 32-bit_rle_rgbe is expected",
                      r->file->path, line + 7);
    if (strncmp(line, "EXPOSURE=", 9) == 0) {
      const double factor = strtod(line + 9, NULL);
      if (isfinite(factor) && factor > 0) r->exposure *= factor;
    }
  }
}

/* Signs and axes of the line such as "-Y 512 +X 1024": the first pair runs slowest. */
typedef struct orientation {
  char slow_axis;
  bool slow_grows, fast_grows; /* along X to the right, along Y upward */
  uint32_t slow, fast;
} orientation;

static int read_orientation(hdr_reader *r, orientation *o) {
  char line[128], sign[2], axis[2];
  unsigned long size[2];
  if (!read_line(r, line, sizeof line) ||
      sscanf(line, "%c%c %9lu %c%c %9lu", &sign[0], &axis[0], &size[0], &sign[1], &axis[1], &size[1]) != 6)
    return malformed(r, "no line of sizes such as -Y 512 +X 1024");
  for (int k = 0; k < 2; k++)
    if ((sign[k] != '+' && sign[k] != '-') || (axis[k] != 'X' && axis[k] != 'Y') || size[k] < 1 ||
        size[k] > 65535)
      return malformed(r, "a line of sizes out of range");
  if (axis[0] == axis[1]) return malformed(r, "a line of sizes that names one axis twice");
  o->slow_axis = axis[0];
  o->slow_grows = sign[0] == '+';
  o->fast_grows = sign[1] == '+';
  o->slow = (uint32_t)size[0];
  o->fast = (uint32_t)size[1];
  return EXIT_DONE;
}

static bool take(hdr_reader *r, unsigned char *dst, size_t n) {
  if (n > r->file->size - r->position) return false;
  memcpy(dst, r->file->data + r->position, n);
  r->position += n;
  return true;
}

/* One component after the other, runs of more than 128 bytes coded by their value. */
static bool read_packed_line(hdr_reader *r, unsigned char *rgbe, uint32_t n) {
  for (int component = 0; component < 4; component++) {
    for (uint32_t i = 0; i < n;) {
      unsigned char code, value;
      if (!take(r, &code, 1)) return false;
      if (code > 128) {
        const uint32_t run = code - 128u;
        if (run > n - i || !take(r, &value, 1)) return false;
        for (uint32_t k = 0; k < run; k++) rgbe[4 * i++ + (uint32_t)component] = value;
      } else {
        if (code == 0 || code > n - i) return false;
        for (uint32_t k = 0; k < code; k++)
          if (!take(r, &rgbe[4 * i++ + (uint32_t)component], 1)) return false;
      }
    }
  }
  return true;
}

/* Plain pixels, where (1, 1, 1, n) repeats the pixel before; several such in a row are digits of base 256. */
static bool read_old_line(hdr_reader *r, unsigned char *rgbe, uint32_t n) {
  uint32_t shift = 0;
  for (uint32_t i = 0; i < n;) {
    unsigned char *pixel = rgbe + 4 * (size_t)i;
    if (!take(r, pixel, 4)) return false;
    if (pixel[0] == 1 && pixel[1] == 1 && pixel[2] == 1 && i > 0) {
      const uint64_t run = (uint64_t)pixel[3] << shift;
      if (shift > 16 || run > n - i) return false;
      for (uint64_t k = 0; k < run; k++, i++) memcpy(rgbe + 4 * (size_t)i, rgbe + 4 * ((size_t)i - 1), 4);
      shift += 8;
    } else {
      i++;
      shift = 0;
    }
  }
  return true;
}

static bool read_pixels(hdr_reader *r, unsigned char *rgbe, uint32_t n) {
  const unsigned char *head = r->file->data + r->position;
  if (n >= 8 && n <= 32767 && r->file->size - r->position >= 4 && head[0] == 2 && head[1] == 2 &&
      (uint32_t)(head[2] << 8 | head[3]) == n) {
    r->position += 4;
    return read_packed_line(r, rgbe, n);
  }
  return read_old_line(r, rgbe, n);
}

static void store_line(image *out, const orientation *o, uint32_t s, const unsigned char *rgbe,
                       double exposure) {
  for (uint32_t f = 0; f < o->fast; f++) {
    const unsigned char *p = rgbe + 4 * (size_t)f;
    /* Half a step up: the middle of the values that are coded alike. */
    const float scale = p[3] > 0 ? (float)(ldexp(1, p[3] - 136) / exposure) : 0;
    const uint32_t slow = s, along = f;
    uint32_t x, y;
    float *pixel;
    if (o->slow_axis == 'Y') {
      y = o->slow_grows ? out->height - 1 - slow : slow;
      x = o->fast_grows ? along : out->width - 1 - along;
    } else {
      x = o->slow_grows ? slow : out->width - 1 - slow;
      y = o->fast_grows ? out->height - 1 - along : along;
    }
    pixel = image_pixel(out, x, y);
    for (int c = 0; c < 3; c++) pixel[c] = ((float)p[c] + 0.5f) * scale;
  }
}

int image_decode_hdr(const image_bytes *file, image *out) {
  hdr_reader r = {file, 0, 1};
  orientation o = {0};
  unsigned char *rgbe;
  int failed = read_header(&r);
  if (!failed) failed = read_orientation(&r, &o);
  /* A line takes a pixel and, if it is longer, a run at least: no room for a picture that cannot be there. */
  if (!failed && (file->size - r.position) / (o.fast > 1 ? 8 : 4) < o.slow)
    failed = malformed(&r, "the picture is cut short");
  if (!failed)
    failed = o.slow_axis == 'Y' ? image_create(out, o.fast, o.slow) : image_create(out, o.slow, o.fast);
  if (failed) return failed;
  rgbe = malloc((size_t)o.fast * 4);
  if (rgbe == NULL) return cli_out_of_memory();
  for (uint32_t s = 0; s < o.slow && !failed; s++) {
    if (!read_pixels(&r, rgbe, o.fast))
      failed = malformed(&r, "the picture is cut short or a run leaves its line");
    else
      store_line(out, &o, s, rgbe, r.exposure);
  }
  free(rgbe);
  return failed;
}
