/* SPDX-License-Identifier: MIT */
/* format.h: the bytes of a container, as docs/format.md defines them. Private to this layer. */
#ifndef BTFI_FORMAT_H
#define BTFI_FORMAT_H

#include "base/base.h"
#include "io/io.h"
#include <btf/btf_plugin.h>

enum {
  BTFI_FORMAT_MAJOR = 1,
  BTFI_FORMAT_MINOR = 0,
  BTFI_HEADER_SIZE = 64,
  BTFI_ENTRY_SIZE = 64,
  BTFI_FOOTER_SIZE = 32,
  BTFI_ALIGNMENT = 64,
  BTFI_NAME_SIZE = 96 /* room for btfi_entry_name */
};

/* Feature bits of the header this version understands. */
#define BTFI_KNOWN_REQUIRED 0u
#define BTFI_KNOWN_OPTIONAL 0u

/* Chunk types. */
#define BTFI_TYPE_MODEL BTF_TAG('M', 'O', 'D', 'L')
#define BTFI_TYPE_DIRECTIONS BTF_TAG('D', 'I', 'R', 'S')
#define BTFI_TYPE_PAYLOAD BTF_TAG('D', 'A', 'T', 'A')
#define BTFI_TYPE_METADATA BTF_TAG('M', 'E', 'T', 'A')

/* Chunk flags: the low half changes the meaning of a chunk, the high half may be ignored. */
#define BTFI_CHUNK_CRITICAL 1u
#define BTFI_CHUNK_IN_PLACE 2u
#define BTFI_CHUNK_KNOWN (BTFI_CHUNK_CRITICAL | BTFI_CHUNK_IN_PLACE)
#define BTFI_CHUNK_MUST_KNOW 0xffffu

#define BTFI_METHOD_RAW 0u
#define BTFI_METHOD_ZSTD 1u

/* Model number of a chunk that belongs to the file. */
#define BTFI_NO_MODEL 0xffffffffu

/* Most bytes of a MODL chunk, of a META chunk, and of one text. */
#define BTFI_MODEL_CHUNK_LIMIT (1u << 20)
#define BTFI_METADATA_LIMIT (16u << 20)
#define BTFI_TEXT_LIMIT 65535u
#define BTFI_METADATA_PAIRS 1024u

/* Numbers that btf_file_validate reports; docs/format.md lists them. */
enum {
  BTFI_ISSUE_UNREADABLE = 10,
  BTFI_ISSUE_PADDING = 11,
  BTFI_ISSUE_HEAD = 12,
  BTFI_ISSUE_CHECKSUM = 13,
  BTFI_ISSUE_CONTENT = 14,
  BTFI_ISSUE_LIMIT = 15,
  BTFI_ISSUE_UNKNOWN_TYPE = 20,
  BTFI_ISSUE_UNKNOWN_FEATURE = 21,
  BTFI_ISSUE_NEWER_MINOR = 22
};

typedef struct btfi_header {
  uint32_t major, minor, required, optional, count;
  uint64_t directory_offset, directory_size, file_size, directory_checksum;
} btfi_header;

/* One chunk, in the directory and in the head before its stored bytes. */
typedef struct btfi_entry {
  uint32_t type, tag, index, flags, model, method;
  uint64_t offset, stored, raw, checksum;
} btfi_entry;

void btfi_header_encode(const btfi_header *h, unsigned char out[BTFI_HEADER_SIZE]);
/* Judges the first `size` bytes of a file (64 unless the file is shorter): not ours, damaged, newer,
 * unfinished. */
btf_status btfi_header_decode(btf_context *ctx, const char *name, const unsigned char *bytes, uint64_t size,
                              btfi_header *out);
void btfi_footer_encode(const btfi_header *h, unsigned char out[BTFI_FOOTER_SIZE]);
void btfi_entry_encode(const btfi_entry *e, unsigned char out[BTFI_ENTRY_SIZE]);
bool btfi_entry_decode(const unsigned char bytes[BTFI_ENTRY_SIZE],
                       btfi_entry *out); /* false: checksum differs */

/* The next multiple of 64; the caller has bounded n. */
static inline uint64_t btfi_align(uint64_t n) {
  return (n + (BTFI_ALIGNMENT - 1u)) & ~(uint64_t)(BTFI_ALIGNMENT - 1u);
}
bool btfi_type_known(uint32_t type);
/* "chunk DATA BASE 0 of model 0 at offset 192"; returns text. */
const char *btfi_entry_name(const btfi_entry *e, char text[BTFI_NAME_SIZE]);
void btfi_fourcc_text(uint32_t fourcc, char text[16]);

/* A byte source shared by a file and the payloads of its models; closed with the last of them. */
typedef struct btfi_source {
  atomic_uint references;
  btf_context *ctx;
  btf_io io;
  const char *name; /* owned copy, since the host may free its own once the file is open */
  bool trust;
} btfi_source;
btfi_source *btfi_source_retain(btfi_source *source);
void btfi_source_release(btfi_source *source);

/* The unpacked bytes of a chunk, verified: straight from the mapping when the chunk is meant for that (*owned
 * false), else in new memory. Nothing is allocated before the sizes agree with the limits and with the zstd
 * frame. */
btf_status btfi_chunk_read(btfi_source *source, const btfi_entry *e, bool trust, const void **data,
                           bool *owned);
/* BTF_E_CORRUPT when the head before the chunk differs from its directory entry. */
btf_status btfi_chunk_check_head(btfi_source *source, const btfi_entry *e);

/* UTF-8 without control characters other than tab and newline. */
bool btfi_text_valid(const char *text, uint64_t size);

/* ---- metadata (metadata.c) ---- */

typedef struct btfi_metadata {
  btf_context *ctx;
  char **keys, **values;
  uint32_t count, capacity;
} btfi_metadata;
const char *btfi_metadata_find(const btfi_metadata *m, const char *key);
/* Adds or replaces a pair. */
btf_status btfi_metadata_set(btfi_metadata *m, const char *key, const char *value);
btf_status btfi_metadata_decode(btfi_metadata *m, const char *name, const void *data, uint64_t size);
void btfi_metadata_encode(const btfi_metadata *m, btfi_buffer *out);
void btfi_metadata_free(btfi_metadata *m);
/* Notes of model 0 have keys of their own; those of a later model have its number in front. put fails where
 * that is too long for a key; model_of gives 0 for keys that are none of a later model's, else the number,
 * and where the note's key begins. */
bool btfi_note_key_put(uint32_t model, const char *key, char out[256]);
uint32_t btfi_note_model_of(const char *key, const char **rest);

#endif
