/* SPDX-License-Identifier: MIT */
/* Encoding and decoding of the fixed structures of a container. */
#include "container/format.h"

#include <stdio.h>
#include <string.h>

/* A byte with the high bit set, CR LF, Ctrl-Z and LF show damage by transfers that are not binary. */
static const unsigned char signature[8] = {0x93, 'B', 'T', 'Z', '\r', '\n', 0x1a, '\n'};
static const unsigned char end_signature[8] = {'\n', 0x1a, 'b', 't', 'z', 'E', 'N', 0x93};

static void store16(unsigned char *p, uint32_t v) {
  p[0] = (unsigned char)v;
  p[1] = (unsigned char)(v >> 8);
}
static void store32(unsigned char *p, uint32_t v) {
  store16(p, v);
  store16(p + 2, v >> 16);
}
static void store64(unsigned char *p, uint64_t v) {
  store32(p, (uint32_t)v);
  store32(p + 4, (uint32_t)(v >> 32));
}
static uint32_t load16(const unsigned char *p) {
  return (uint32_t)p[0] | (uint32_t)p[1] << 8;
}
static uint32_t load32(const unsigned char *p) {
  return load16(p) | load16(p + 2) << 16;
}
static uint64_t load64(const unsigned char *p) {
  return (uint64_t)load32(p) | (uint64_t)load32(p + 4) << 32;
}

void btfi_header_encode(const btfi_header *h, unsigned char out[BTFI_HEADER_SIZE]) {
  memcpy(out, signature, sizeof signature);
  store16(out + 8, h->major);
  store16(out + 10, h->minor);
  store32(out + 12, h->required);
  store32(out + 16, h->optional);
  store32(out + 20, h->count);
  store64(out + 24, h->directory_offset);
  store64(out + 32, h->directory_size);
  store64(out + 40, h->file_size);
  store64(out + 48, h->directory_checksum);
  store64(out + 56, btfi_xxh64_of(out, 56));
}

btf_status btfi_header_decode(btf_context *ctx, const char *name, const unsigned char *bytes, uint64_t size,
                              btfi_header *out) {
  const uint64_t head = BTFI_MIN(size, sizeof signature);
  if (memcmp(bytes, signature, (size_t)head) != 0) {
    if (size >= 4 && (bytes[0] & 0x7f) == (signature[0] & 0x7f) && memcmp(bytes + 1, signature + 1, 3) == 0)
      return btfi_fail(ctx, BTF_E_CORRUPT, "%s: the signature is damaged, as by a transfer in text mode",
                       name);
    return btfi_fail(ctx, BTF_E_NOT_BTF,
                     "%s: not a .btfz container (its first bytes are another kind of file's)", name);
  }
  if (size < BTFI_HEADER_SIZE)
    return btfi_fail(ctx, BTF_E_TRUNCATED, "%s: %llu bytes, too few for the header of a container", name,
                     (unsigned long long)size);
  if (load64(bytes + 56) != btfi_xxh64_of(bytes, 56))
    return btfi_fail(ctx, BTF_E_CORRUPT,
                     "%s: the checksum of the file header does not match; the file is damaged", name);
  out->major = load16(bytes + 8);
  out->minor = load16(bytes + 10);
  out->required = load32(bytes + 12);
  out->optional = load32(bytes + 16);
  out->count = load32(bytes + 20);
  out->directory_offset = load64(bytes + 24);
  out->directory_size = load64(bytes + 32);
  out->file_size = load64(bytes + 40);
  out->directory_checksum = load64(bytes + 48);
  if (out->major > BTFI_FORMAT_MAJOR)
    return btfi_fail(ctx, BTF_E_NEWER,
                     "%s: container version %u.%u is newer than this library, which reads %u.x", name,
                     out->major, out->minor, (unsigned)BTFI_FORMAT_MAJOR);
  if (out->major < 1) return btfi_fail(ctx, BTF_E_CORRUPT, "%s: container version 0 does not exist", name);
  if ((out->required & ~BTFI_KNOWN_REQUIRED) != 0)
    return btfi_fail(ctx, BTF_E_NEWER, "%s: needs features this library does not have (mask 0x%x)", name,
                     (unsigned)(out->required & ~BTFI_KNOWN_REQUIRED));
  if (out->directory_offset == 0)
    return btfi_fail(ctx, BTF_E_TRUNCATED, "%s: writing this container was never finished", name);
  return BTF_OK;
}

void btfi_footer_encode(const btfi_header *h, unsigned char out[BTFI_FOOTER_SIZE]) {
  memcpy(out, end_signature, sizeof end_signature);
  store64(out + 8, h->directory_offset);
  store64(out + 16, h->file_size);
  store64(out + 24, btfi_xxh64_of(out, 24));
}

void btfi_entry_encode(const btfi_entry *e, unsigned char out[BTFI_ENTRY_SIZE]) {
  store32(out, e->type);
  store32(out + 4, e->tag);
  store32(out + 8, e->index);
  store32(out + 12, e->flags);
  store32(out + 16, e->model);
  store32(out + 20, e->method);
  store64(out + 24, e->offset);
  store64(out + 32, e->stored);
  store64(out + 40, e->raw);
  store64(out + 48, e->checksum);
  store64(out + 56, btfi_xxh64_of(out, 56));
}

bool btfi_entry_decode(const unsigned char bytes[BTFI_ENTRY_SIZE], btfi_entry *out) {
  out->type = load32(bytes);
  out->tag = load32(bytes + 4);
  out->index = load32(bytes + 8);
  out->flags = load32(bytes + 12);
  out->model = load32(bytes + 16);
  out->method = load32(bytes + 20);
  out->offset = load64(bytes + 24);
  out->stored = load64(bytes + 32);
  out->raw = load64(bytes + 40);
  out->checksum = load64(bytes + 48);
  return load64(bytes + 56) == btfi_xxh64_of(bytes, 56);
}

bool btfi_type_known(uint32_t type) {
  return type == BTFI_TYPE_MODEL || type == BTFI_TYPE_DIRECTIONS || type == BTFI_TYPE_PAYLOAD ||
         type == BTFI_TYPE_METADATA;
}

void btfi_fourcc_text(uint32_t fourcc, char text[16]) {
  bool printable = true;
  for (int i = 0; i < 4; i++) {
    const unsigned char c = (unsigned char)(fourcc >> 8 * i);
    text[i] = (char)c;
    if (c < 0x20 || c > 0x7e) printable = false;
  }
  text[4] = '\0';
  if (!printable) snprintf(text, 16, "0x%08x", (unsigned)fourcc);
}

const char *btfi_entry_name(const btfi_entry *e, char text[BTFI_NAME_SIZE]) {
  char type[16], tag[20] = "", model[24] = "";
  btfi_fourcc_text(e->type, type);
  if (e->tag != 0) {
    tag[0] = ' ';
    btfi_fourcc_text(e->tag, tag + 1);
  }
  if (e->model != BTFI_NO_MODEL) snprintf(model, sizeof model, " of model %u", (unsigned)e->model);
  snprintf(text, BTFI_NAME_SIZE, "chunk %s%s %u%s at offset %llu", type, tag, (unsigned)e->index, model,
           (unsigned long long)e->offset);
  return text;
}

bool btfi_text_valid(const char *text, uint64_t size) {
  const unsigned char *p = (const unsigned char *)text;
  uint64_t i = 0;
  while (i < size) {
    const unsigned char c = p[i];
    uint32_t follow, code, least;
    if (c < 0x80) {
      if ((c < 0x20 && c != '\t' && c != '\n') || c == 0x7f) return false;
      i++;
      continue;
    }
    if (c >= 0xc2 && c <= 0xdf)
      follow = 1, code = c & 0x1fu, least = 0x80;
    else if (c >= 0xe0 && c <= 0xef)
      follow = 2, code = c & 0x0fu, least = 0x800;
    else if (c >= 0xf0 && c <= 0xf4)
      follow = 3, code = c & 0x07u, least = 0x10000;
    else
      return false;
    if (size - i <= follow) return false;
    for (uint32_t k = 1; k <= follow; k++) {
      if ((p[i + k] & 0xc0) != 0x80) return false;
      code = code << 6 | (p[i + k] & 0x3fu);
    }
    if (code < least || code > 0x10ffff || (code >= 0xd800 && code <= 0xdfff)) return false;
    i += follow + 1;
  }
  return true;
}
