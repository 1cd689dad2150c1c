/* SPDX-License-Identifier: MIT */
#include "base/base.h"

#include <locale.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* ---- reading ---- */

const void *btfi_get_bytes(btfi_cursor *c, uint64_t n) {
  if (c->overrun || c->position > c->size || n > c->size - c->position) {
    c->overrun = true;
    return NULL;
  }
  const void *bytes = c->data ? c->data + c->position : (const void *)"";
  c->position += n;
  return bytes;
}

static uint64_t get_little_endian(btfi_cursor *c, int size) {
  const unsigned char *p = btfi_get_bytes(c, (uint64_t)size);
  uint64_t v = 0;
  if (!p) return 0;
  for (int i = size - 1; i >= 0; i--) v = v << 8 | p[i];
  return v;
}

uint32_t btfi_get_u32(btfi_cursor *c) {
  return (uint32_t)get_little_endian(c, 4);
}
uint64_t btfi_get_u64(btfi_cursor *c) {
  return get_little_endian(c, 8);
}

float btfi_get_f32(btfi_cursor *c) {
  const uint32_t bits = btfi_get_u32(c);
  float v;
  memcpy(&v, &bits, sizeof v);
  return v;
}

double btfi_get_f64(btfi_cursor *c) {
  const uint64_t bits = btfi_get_u64(c);
  double v;
  memcpy(&v, &bits, sizeof v);
  return v;
}

/* ---- writing ---- */

void btfi_buffer_init(btfi_buffer *b, btf_context *ctx) {
  memset(b, 0, sizeof *b);
  b->ctx = ctx;
}

void btfi_buffer_free(btfi_buffer *b) {
  btfi_free(b->ctx, b->data);
  b->data = NULL;
  b->size = b->capacity = 0;
}

btf_status btfi_buffer_status(const btfi_buffer *b) {
  return b->status;
}

/* Makes room for n more bytes and returns where they go, or NULL. */
static unsigned char *grow(btfi_buffer *b, uint64_t n) {
  uint64_t needed;
  if (b->status != BTF_OK) return NULL;
  if (!btfi_add(b->size, n, &needed)) needed = UINT64_MAX;
  if (needed > b->capacity || !b->data) {
    const uint64_t capacity = BTFI_MAX(needed, BTFI_MAX(b->capacity + b->capacity / 2, (uint64_t)256));
    unsigned char *data = btfi_alloc(b->ctx, capacity, 1);
    if (!data) {
      b->status = btfi_alloc_status();
      return NULL;
    }
    if (b->size > 0) memcpy(data, b->data, (size_t)b->size);
    btfi_free(b->ctx, b->data);
    b->data = data;
    b->capacity = capacity;
  }
  unsigned char *p = b->data + b->size;
  b->size = needed;
  return p;
}

void btfi_put_bytes(btfi_buffer *b, const void *src, uint64_t n) {
  if (n == 0) return;
  unsigned char *p = grow(b, n);
  if (p) memcpy(p, src, (size_t)n);
}

static void put_little_endian(btfi_buffer *b, uint64_t v, int size) {
  unsigned char *p = grow(b, (uint64_t)size);
  if (!p) return;
  for (int i = 0; i < size; i++) p[i] = (unsigned char)(v >> 8 * i);
}

void btfi_put_u8(btfi_buffer *b, uint8_t v) {
  put_little_endian(b, v, 1);
}
void btfi_put_u32(btfi_buffer *b, uint32_t v) {
  put_little_endian(b, v, 4);
}
void btfi_put_u64(btfi_buffer *b, uint64_t v) {
  put_little_endian(b, v, 8);
}

void btfi_put_f32(btfi_buffer *b, float v) {
  uint32_t bits;
  memcpy(&bits, &v, sizeof bits);
  btfi_put_u32(b, bits);
}

void btfi_put_f64(btfi_buffer *b, double v) {
  uint64_t bits;
  memcpy(&bits, &v, sizeof bits);
  btfi_put_u64(b, bits);
}

void btfi_put_text_of(btfi_buffer *b, const char *format, va_list arguments) {
  if (b->status != BTF_OK) return;
  /* The host's locale may print numbers with a comma, which no file may contain. */
  const locale_t c_locale = newlocale(LC_ALL_MASK, "C", (locale_t)0);
  const locale_t host_locale = c_locale ? uselocale(c_locale) : (locale_t)0;
  char line[256];
  va_list again;
  va_copy(again, arguments);
  const int length = vsnprintf(line, sizeof line, format, arguments);
  if (length < 0) {
    b->status = btfi_fail(b->ctx, BTF_E_INVALID_ARG, "text: cannot be formatted by \"%s\"", format);
  } else if ((size_t)length < sizeof line) {
    btfi_put_bytes(b, line, (uint64_t)length);
  } else {
    char *p = (char *)grow(b, (uint64_t)length + 1);
    if (p) {
      vsnprintf(p, (size_t)length + 1, format, again);
      b->size--;
    }
  }
  va_end(again);
  if (c_locale) {
    uselocale(host_locale);
    freelocale(c_locale);
  }
}

void btfi_put_text(btfi_buffer *b, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  btfi_put_text_of(b, format, arguments);
  va_end(arguments);
}

/* ---- UTF-8 ---- */

uint32_t btfi_utf8_length(const void *text, uint64_t size) {
  const unsigned char *p = text;
  if (size == 0) return 0;
  if (p[0] < 0x80u) return 1;
  const uint32_t length = p[0] >= 0xf0u ? 4 : p[0] >= 0xe0u ? 3 : 2;
  if (p[0] < 0xc2u || p[0] > 0xf4u || length > size) return 0;
  for (uint32_t i = 1; i < length; i++)
    if ((p[i] & 0xc0u) != 0x80u) return 0;
  /* Overlong forms, surrogates and what lies beyond U+10FFFF differ from valid text in the second byte. */
  if ((p[0] == 0xe0u && p[1] < 0xa0u) || (p[0] == 0xedu && p[1] >= 0xa0u)) return 0;
  if ((p[0] == 0xf0u && p[1] < 0x90u) || (p[0] == 0xf4u && p[1] >= 0x90u)) return 0;
  return length;
}
