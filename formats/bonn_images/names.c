/* SPDX-License-Identifier: MIT */
/* names.c: which light and view a picture is of, from its name. */
#include <stdio.h>
#include <stdlib.h>
#include <strings.h>

#include "bonn_images/bonn_images.h"

typedef struct ring {
  uint32_t theta, step, count, first; /* degrees */
} ring;
static const ring rings[] = {{0, 360, 1, 0},   {15, 60, 6, 1},   {30, 30, 12, 7},
                             {45, 20, 18, 19}, {60, 18, 20, 37}, {75, 15, 24, 57}};
enum { RINGS = sizeof rings / sizeof *rings };
static const double angle_tolerance =
    0.05; /* degrees: less than any rounding that is written with one decimal */

static bool is_digit(char c) {
  return c >= '0' && c <= '9';
}
static bool is_letter(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

static bool has_picture_extension(const char *base) {
  static const char *const extensions[] = {"jpg",  "jpeg", "png", "hdr", "pic",
                                           "rgbe", "exr",  "bmp", "tif", "tiff"};
  const char *dot = strrchr(base, '.');
  if (dot == NULL || base[0] == '.') return false;
  for (size_t i = 0; i < sizeof extensions / sizeof *extensions; i++)
    if (strcasecmp(dot + 1, extensions[i]) == 0) return true;
  return false;
}

/* Digits with an optional decimal part; the dot of an extension is none. */
static double take_number(const char *p) {
  double value = 0, place = 1;
  int digits = 0;
  for (; is_digit(*p) && digits < 9; p++, digits++) value = 10 * value + (*p - '0');
  if (*p == '.' && is_digit(p[1]))
    for (p++; is_digit(*p) && digits < 18; p++, digits++) value += (*p - '0') * (place /= 10);
  return value;
}

/* The number behind a key such as "tl"; returns how often the key is there. */
static int find_angle(const char *base, const char *key, double *angle) {
  int found = 0;
  for (const char *p = base; *p != '\0'; p++)
    if (strncasecmp(p, key, 2) == 0 && is_digit(p[2]) && (p == base || !is_letter(p[-1]))) {
      *angle = take_number(p + 2);
      found++;
    }
  return found;
}

static uint32_t find_direction(double theta, double phi) {
  for (int i = 0; i < RINGS; i++) {
    if (fabs(theta - rings[i].theta) > angle_tolerance) continue;
    const double steps = fmod(phi, 360) / rings[i].step, nearest = floor(steps + 0.5);
    if (fabs(steps - nearest) * rings[i].step > angle_tolerance) return images_none;
    return rings[i].first + (uint32_t)nearest % rings[i].count;
  }
  return images_none;
}

/* A number of five digits counts pairs, view fastest, in the archives that have it. */
static bool counter_differs(const char *base, uint32_t light, uint32_t view) {
  for (const char *p = base; *p != '\0';) {
    size_t length = 0;
    while (is_digit(p[length])) length++;
    if (length == 5 && (p == base || !is_letter(p[-1])))
      return strtoul(p, NULL, 10) != (unsigned long)IMAGES_DIRECTIONS * light + view;
    p += length > 0 ? length : 1;
  }
  return false;
}

image_name images_parse_name(const char *path, uint32_t *pair, bool *differs, picture_fault *fault) {
  static const char *const keys[] = {"tl", "pl", "tv", "pv"};
  const char *base = path; /* some archives have backslashes between folders */
  for (const char *p = path; (p = strpbrk(p, "/\\")) != NULL;) base = ++p;
  double angle[4];
  int found[4], known = 0;
  if (!has_picture_extension(base)) return IMAGE_NAME_OTHER;
  for (int i = 0; i < 4; i++) {
    found[i] = find_angle(base, keys[i], &angle[i]);
    if (found[i] > 0) known++;
  }
  if (known == 0) return IMAGE_NAME_OTHER;
  for (int i = 0; i < 4; i++)
    if (found[i] != 1) {
      picture_fail(fault, BTF_E_CORRUPT, "its name has the angle \"%s\" %s", keys[i],
                   found[i] == 0 ? "missing" : "more than once");
      return IMAGE_NAME_BAD;
    }
  const uint32_t light = find_direction(angle[0], angle[1]), view = find_direction(angle[2], angle[3]);
  if (light == images_none || view == images_none) {
    picture_fail(fault, BTF_E_UNSUPPORTED, "its %s at %g, %g degrees is none of the 81 directions",
                 light == images_none ? "light" : "view", angle[light == images_none ? 0 : 2],
                 angle[light == images_none ? 1 : 3]);
    return IMAGE_NAME_BAD;
  }
  *pair = view * IMAGES_DIRECTIONS + light;
  *differs = counter_differs(base, light, view);
  return IMAGE_NAME_PAIR;
}

static void angles_of(uint32_t direction, uint32_t *theta, uint32_t *phi) {
  int i = RINGS - 1;
  while (rings[i].first > direction) i--;
  *theta = rings[i].theta;
  *phi = (direction - rings[i].first) * rings[i].step;
}

void images_pair_text(uint32_t pair, char text[32]) {
  uint32_t tl, pl, tv, pv;
  angles_of(pair % IMAGES_DIRECTIONS, &tl, &pl);
  angles_of(pair / IMAGES_DIRECTIONS, &tv, &pv);
  snprintf(text, 32, "tl%03u pl%03u tv%03u pv%03u", tl % 1000, pl % 1000, tv % 1000, pv % 1000);
}
