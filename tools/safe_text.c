/* SPDX-License-Identifier: MIT */
#include "safe_text.h"

#include <string.h>

int safe_text_character(const char *text, uint32_t *code) {
  static const uint32_t least[5] = {0, 0, 0x80, 0x800,
                                    0x10000}; /* by length; below it the form is overlong */
  const unsigned char *p = (const unsigned char *)text;
  const int length = *p < 0x80 ? 1 : *p < 0xc0 ? 0 : *p < 0xe0 ? 2 : *p < 0xf0 ? 3 : *p < 0xf8 ? 4 : 0;
  uint32_t value = length == 1 ? *p : *p & (0x7fu >> length);
  for (int i = 1; i < length; i++) {
    if ((p[i] & 0xc0) != 0x80) return 0;
    value = value << 6 | (p[i] & 0x3fu);
  }
  if (length == 0 || value < least[length] || value > 0x10ffff || (value >= 0xd800 && value < 0xe000))
    return 0;
  *code = value;
  return length;
}

bool safe_text_is_control(uint32_t code) {
  return code < 0x20 || (code >= 0x7f && code < 0xa0) || code == 0x061c || code == 0x200e || code == 0x200f ||
         (code >= 0x2028 && code <= 0x202e) || (code >= 0x2066 && code <= 0x2069);
}

/* The next piece of the text that may be shown, or one '?'; moves on. */
static int next_piece(const char **at, const char **piece) {
  uint32_t code = 0;
  const int length = safe_text_character(*at, &code);
  const bool shown = length > 0 && !safe_text_is_control(code);
  *piece = shown ? *at : "?";
  *at += length > 0 ? length : 1;
  return shown ? length : 1;
}

int safe_text_put(FILE *out, const char *text) {
  int count = 0;
  while (text != NULL && *text != '\0') {
    const char *piece;
    const int length = next_piece(&text, &piece);
    fwrite(piece, 1, (size_t)length, out);
    count++;
  }
  return count;
}

void safe_text_clean(char *text) {
  const char *at = text;
  while (*at != '\0') {
    const char *piece;
    const int length = next_piece(&at, &piece);
    memmove(text, piece, (size_t)length);
    text += length;
  }
  *text = '\0';
}
