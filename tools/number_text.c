/* SPDX-License-Identifier: MIT */
#include "number_text.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

/* A number may end where a blank or the line does. */
static bool ends_number(char c) {
  return c == ' ' || c == '\t' || c == '\r' || c == '\n' || c == '\0';
}

static bool read_slowly(const char **p, float *out) {
  char *end;
  *out = strtof(*p, &end);
  if (end == *p || !ends_number(*end)) return false;
  *p = end;
  return true;
}

bool number_read(const char **p, float *out) {
  static const double powers[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                  1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
  const char *s = *p;
  const bool negative = *s == '-';
  uint64_t digits = 0, bits;
  int count = 0, exponent = 0;
  double value;
  if (*s == '-' || *s == '+') s++;
  if (!is_digit(*s) && *s != '.') {
    /* strtof would skip blanks and line breaks here. */
    return (*s == 'n' || *s == 'N' || *s == 'i' || *s == 'I') && read_slowly(p, out);
  }
  for (; is_digit(*s); s++, count++) digits = digits * 10 + (uint64_t)(*s - '0');
  if (*s == '.')
    for (s++; is_digit(*s); s++, count++, exponent--) digits = digits * 10 + (uint64_t)(*s - '0');
  if (count == 0) return false;
  if (*s == 'e' || *s == 'E') {
    int written = 0;
    const bool small = s[1] == '-';
    s += 1 + (s[1] == '-' || s[1] == '+');
    if (!is_digit(*s)) return false;
    for (; is_digit(*s); s++)
      if (written < 10000) written = written * 10 + (*s - '0');
    exponent += small ? -written : written;
  }
  if (!ends_number(*s)) return false;
  /* Exact as double: up to 2^53 times or over a power of ten that is exact. Rounding it again to float goes
   * wrong only next to the midpoint of two floats. */
  if (count > 19 || digits > UINT64_C(1) << 53 || exponent < -22 || exponent > 22) return read_slowly(p, out);
  value = (double)digits;
  value = exponent < 0 ? value / powers[-exponent] : value * powers[exponent];
  memcpy(&bits, &value, sizeof bits);
  if ((bits & 0x1fffffffu) == 0x10000000u || (value != 0 && value < 1e-37) || value > 1e38)
    return read_slowly(p, out);
  *out = (float)(negative ? -value : value);
  *p = s;
  return true;
}

bool number_read_index(const char **p, uint32_t *out) {
  const char *s = *p;
  uint64_t value = 0;
  if (!is_digit(*s)) return false;
  for (; is_digit(*s); s++) {
    value = value * 10 + (uint64_t)(*s - '0');
    if (value > UINT32_MAX) return false;
  }
  if (!ends_number(*s)) return false;
  *out = (uint32_t)value;
  *p = s;
  return true;
}

/* The nine significant digits of magnitude = mantissa * 2^exponent, whose first digit stands for 10^decade,
 * rounded to even. Needs magnitude in [1e-4, 1e9). */
static uint64_t nine_digits(uint32_t mantissa, int exponent, int decade) {
  static const uint64_t powers[] = {1,           10,           100,          1000,      10000,
                                    100000,      1000000,      10000000,     100000000, 1000000000,
                                    10000000000, 100000000000, 1000000000000};
  unsigned __int128 scaled = (unsigned __int128)mantissa * powers[8 - decade];
  unsigned __int128 rest, half;
  if (exponent >= 0) return (uint64_t)(scaled << exponent);
  half = (unsigned __int128)1 << (-exponent - 1);
  rest = scaled & (2 * half - 1);
  scaled >>= -exponent;
  if (rest > half || (rest == half && (scaled & 1))) scaled++;
  return (uint64_t)scaled;
}

size_t number_write(char *dst, float value) {
  uint32_t bits;
  char *s = dst;
  char digits[9];
  uint64_t number;
  int decade = 0, used = 9;
  float magnitude;
  memcpy(&bits, &value, sizeof bits);
  magnitude = fabsf(value);
  if (!(magnitude >= 1e-4f && magnitude < 1e9f)) {
    if (bits == 0) {
      *dst = '0';
      return 1;
    }
    return (size_t)snprintf(dst, 24, "%.9g", (double)value);
  }
  if (bits >> 31) *s++ = '-';
  if (magnitude >= 1)
    for (float power = 10; magnitude >= power && decade < 8; power *= 10) decade++;
  else
    decade = magnitude >= 0.1f ? -1 : magnitude >= 0.01f ? -2 : magnitude >= 0.001f ? -3 : -4;
  number = nine_digits((bits & 0x7fffffu) | 0x800000u, (int)(bits >> 23 & 0xff) - 150, decade);
  /* The decimal bounds as floats may lie on the wrong side of the power of ten, and rounding may carry. */
  if (number < 100000000u) {
    if (decade == -4) return (size_t)snprintf(dst, 24, "%.9g", (double)value);
    number = nine_digits((bits & 0x7fffffu) | 0x800000u, (int)(bits >> 23 & 0xff) - 150, --decade);
  }
  if (number > 999999999u) {
    number /= 10;
    decade++;
  }
  if (decade > 8) return (size_t)snprintf(dst, 24, "%.9g", (double)value);
  for (int i = 8; i >= 0; i--, number /= 10) digits[i] = (char)('0' + number % 10);
  while (used > 1 && digits[used - 1] == '0') used--;
  if (decade < 0) {
    *s++ = '0';
    *s++ = '.';
    for (int i = -1; i > decade; i--) *s++ = '0';
    for (int i = 0; i < used; i++) *s++ = digits[i];
  } else {
    for (int i = 0; i <= decade; i++) *s++ = digits[i];
    if (used > decade + 1) *s++ = '.';
    for (int i = decade + 1; i < used; i++) *s++ = digits[i];
  }
  return (size_t)(s - dst);
}
