/* SPDX-License-Identifier: MIT */
/* archive.c: the members of a zip archive that are pictures, by minizip over a mapping. Where their bytes lie
 * is noted once; they are read later without minizip. Nothing is ever written by a member's name. */
#include <stdlib.h>

#include <unzip.h>

#include "bonn_images/bonn_images.h"
#include "source/source_file.h"

enum {
  MOST_MEMBERS = 65536, /* ten times what such an archive has */
  MOST_PROBED = 64,
  INFLATE_MOST = 1032, /* bytes that deflate can make of one */
  LOCAL_HEADER_BYTES = 30,
  DIRECTORY_ENTRY_BYTES = 46
};

/* ---- minizip's view of the mapping ---- */

typedef struct mapping {
  const source_file *file;
  uint64_t at;
} mapping;

static voidpf map_open(voidpf opaque, const void *name, int mode) {
  (void)name, (void)mode;
  return opaque;
}
static uLong map_read(voidpf opaque, voidpf stream, void *dst, uLong size) {
  mapping *map = stream;
  (void)opaque;
  const uint64_t left = map->file->size - map->at, count = size < left ? size : left;
  if (count > 0) memcpy(dst, map->file->data + map->at, count);
  map->at += count;
  return (uLong)count;
}
static uLong map_write(voidpf opaque, voidpf stream, const void *src, uLong size) {
  (void)opaque, (void)stream, (void)src, (void)size;
  return 0;
}
static ZPOS64_T map_tell(voidpf opaque, voidpf stream) {
  (void)opaque;
  return ((mapping *)stream)->at;
}
/* Steps back come as offsets that wrap round. */
static long map_seek(voidpf opaque, voidpf stream, ZPOS64_T offset, int origin) {
  mapping *map = stream;
  (void)opaque;
  const uint64_t base = origin == ZLIB_FILEFUNC_SEEK_CUR   ? map->at
                        : origin == ZLIB_FILEFUNC_SEEK_END ? map->file->size
                                                           : 0;
  if (base + offset > map->file->size) return -1;
  map->at = base + offset;
  return 0;
}
static int map_close(voidpf opaque, voidpf stream) {
  (void)opaque, (void)stream;
  return 0;
}
static int map_error(voidpf opaque, voidpf stream) {
  (void)opaque, (void)stream;
  return 0;
}

static unzFile open_directory(mapping *map) {
  zlib_filefunc64_def functions = {.zopen64_file = map_open,
                                   .zread_file = map_read,
                                   .zwrite_file = map_write,
                                   .ztell64_file = map_tell,
                                   .zseek64_file = map_seek,
                                   .zclose_file = map_close,
                                   .zerror_file = map_error,
                                   .opaque = map};
  return map->file->size > 0 ? unzOpen2_64("", &functions) : NULL;
}

/* ---- members ---- */

/* A path that would leave the folder it is unpacked to. No archive of pictures has one. */
static bool leaves_folder(const char *name) {
  if (name[0] == '/' || name[0] == '\\' || (name[0] != '\0' && name[1] == ':')) return true;
  for (const char *part = name; part != NULL; part = strpbrk(part, "/\\")) {
    if (part != name) part++;
    if (strncmp(part, "..", 2) == 0 && (part[2] == '\0' || part[2] == '/' || part[2] == '\\')) return true;
  }
  return false;
}

static btf_status fail_member(images_file *file, btf_status status, const char *name, const char *why) {
  return (file->host->fail)(file->ctx, status, "%s: %s: %s", file->path, name, why);
}

/* What an entry of the directory says. */
typedef struct zip_entry {
  uint32_t flags, method, crc, disk;
  uint64_t packed, size, offset; /* of the local header */
} zip_entry;

static uint32_t get_u16(const unsigned char *p) {
  return (uint32_t)p[0] | (uint32_t)p[1] << 8;
}
static uint64_t get_u64(const unsigned char *p) {
  return (uint64_t)btf_get_u32(p) | (uint64_t)btf_get_u32(p + 4) << 32;
}

/* Values of 32 bits that are all ones stand in the field of zip64, in this order. */
static bool widen(zip_entry *entry, const unsigned char *extra, size_t size) {
  uint64_t *values[] = {&entry->size, &entry->packed, &entry->offset};
  while (size >= 4) {
    const size_t id = get_u16(extra), length = get_u16(extra + 2);
    if (length > size - 4) break;
    for (size_t i = 0, at = 0; id == 1 && i < 3; i++) {
      if (*values[i] != UINT32_MAX) continue;
      if (length - at < 8) return false;
      *values[i] = get_u64(extra + 4 + at);
      at += 8;
    }
    if (id == 1) return true;
    extra += 4 + length;
    size -= 4 + length;
  }
  return entry->size != UINT32_MAX && entry->packed != UINT32_MAX && entry->offset != UINT32_MAX;
}

/* Minizip on Debian leaves the values of zip64 out where long has 64 bits, so the entry it is at is read
 * here. */
static bool read_entry(const source_file *source, uint64_t at, zip_entry *out) {
  if (at > source->size || source->size - at < DIRECTORY_ENTRY_BYTES) return false;
  const unsigned char *p = source->data + at;
  const size_t name = get_u16(p + 28), extra = get_u16(p + 30);
  if (btf_get_u32(p) != 0x02014b50 || name + extra > source->size - at - DIRECTORY_ENTRY_BYTES) return false;
  *out = (zip_entry){.flags = get_u16(p + 8),
                     .method = get_u16(p + 10),
                     .crc = btf_get_u32(p + 16),
                     .packed = btf_get_u32(p + 20),
                     .size = btf_get_u32(p + 24),
                     .disk = get_u16(p + 34),
                     .offset = btf_get_u32(p + 42)};
  return widen(out, p + DIRECTORY_ENTRY_BYTES + name, extra);
}

static btf_status check_entry(images_file *file, const char *name, const zip_entry *entry) {
  if ((entry->flags & 1u) != 0) return fail_member(file, BTF_E_UNSUPPORTED, name, "is encrypted");
  if (entry->method != 0 && entry->method != Z_DEFLATED)
    return fail_member(file, BTF_E_UNSUPPORTED, name, "is compressed by another method than deflate");
  if (entry->disk != 0)
    return fail_member(file, BTF_E_UNSUPPORTED, name, "lies in another part of a split archive");
  const uint64_t most_packed = entry->size + entry->size / 8 + 1024;
  if (entry->method == 0 ? entry->size != entry->packed
                         : entry->size / INFLATE_MOST > entry->packed || entry->packed > most_packed)
    return fail_member(file, BTF_E_CORRUPT, name, "has a size that its bytes cannot unpack to");
  return BTF_OK;
}

/* Where the bytes behind the local header begin. */
static btf_status find_bytes(images_file *file, const source_file *source, const char *name,
                             const zip_entry *entry, uint64_t *out) {
  const size_t length = strlen(name);
  const uint64_t left = entry->offset < source->size ? source->size - entry->offset : 0;
  const unsigned char *p = source->data + (left > 0 ? entry->offset : 0);
  if (left < LOCAL_HEADER_BYTES + length || btf_get_u32(p) != 0x04034b50 || get_u16(p + 8) != entry->method ||
      get_u16(p + 26) != length || memcmp(p + LOCAL_HEADER_BYTES, name, length) != 0)
    return fail_member(file, BTF_E_CORRUPT, name, "its header contradicts the directory, or is not there");
  const uint64_t head = LOCAL_HEADER_BYTES + length + get_u16(p + 28);
  if (head > left || entry->packed > left - head)
    return fail_member(file, BTF_E_TRUNCATED, name, "reaches beyond the end of the archive");
  *out = entry->offset + head;
  return BTF_OK;
}

static btf_status add_member(images_file *file, const source_file *source, unzFile directory) {
  char name[IMAGES_NAME_BYTES];
  unz_file_info64 info;
  image_entry entry = {0};
  picture_fault fault = {BTF_OK, ""};
  if (unzGetCurrentFileInfo64(directory, &info, name, sizeof name, NULL, 0, NULL, 0) != UNZ_OK)
    return (file->host->fail)(file->ctx, BTF_E_CORRUPT, "%s: the directory of the archive is damaged",
                              file->path);
  if (info.size_filename >= sizeof name)
    return (file->host->fail)(file->ctx, BTF_E_LIMIT,
                              "%s: a member's name has %lu bytes; at most %zu are read", file->path,
                              info.size_filename, sizeof name - 1);
  if (strlen(name) != info.size_filename)
    return fail_member(file, BTF_E_CORRUPT, name, "its name has a zero in it");
  if (leaves_folder(name))
    return fail_member(file, BTF_E_CORRUPT, name, "its name leaves the archive's folder");
  switch (images_parse_name(name, &entry.pair, &entry.counter_differs, &fault)) {
  case IMAGE_NAME_OTHER:
    file->list.skipped++;
    return BTF_OK;
  case IMAGE_NAME_BAD:
    return fail_member(file, fault.status, name, fault.why);
  default:
    break;
  }
  zip_entry said;
  if (!read_entry(source, unzGetOffset64(directory), &said))
    return fail_member(file, BTF_E_CORRUPT, name, "its entry in the directory is damaged");
  BTF_TRY(check_entry(file, name, &said));
  BTF_TRY(find_bytes(file, source, name, &said, &entry.offset));
  entry.packed = said.packed;
  entry.size = said.size;
  entry.crc = said.crc;
  entry.deflated = said.method == Z_DEFLATED;
  return images_list_add(file, name, &entry);
}

static btf_status add_members(images_file *file, const source_file *source, unzFile directory) {
  unz_global_info64 info;
  if (unzGetGlobalInfo64(directory, &info) != UNZ_OK || info.number_entry > MOST_MEMBERS)
    return (file->host->fail)(file->ctx, BTF_E_LIMIT, "%s: the archive has more than %d members", file->path,
                              MOST_MEMBERS);
  int at = info.number_entry > 0 ? unzGoToFirstFile(directory) : UNZ_END_OF_LIST_OF_FILE;
  for (; at == UNZ_OK; at = unzGoToNextFile(directory)) BTF_TRY(add_member(file, source, directory));
  return at == UNZ_END_OF_LIST_OF_FILE
             ? BTF_OK
             : (file->host->fail)(file->ctx, BTF_E_CORRUPT, "%s: the directory of the archive is damaged",
                                  file->path);
}

static int by_offset(const void *a, const void *b) {
  const image_entry *first = a, *second = b;
  return (first->offset > second->offset) - (first->offset < second->offset);
}

/* Members that share bytes are how small archives claim to unpack to huge ones. The list stays in this order,
 * in which the archive is read best. */
static btf_status check_overlaps(images_file *file) {
  image_list *list = &file->list;
  if (list->count > 1) qsort(list->entries, list->count, sizeof *list->entries, by_offset);
  for (uint64_t i = 1; i < list->count; i++) {
    const image_entry *before = &list->entries[i - 1], *entry = &list->entries[i];
    if (entry->offset - before->offset < before->packed + LOCAL_HEADER_BYTES)
      return (file->host->fail)(file->ctx, BTF_E_CORRUPT, "%s: %s and %s overlap in the archive", file->path,
                                images_entry_name(file, before), images_entry_name(file, entry));
  }
  return BTF_OK;
}

btf_status images_list_archive(images_file *file) {
  source_file source;
  BTF_TRY(source_file_open(file->host, file->ctx, file->path, &source));
  mapping map = {&source, 0};
  unzFile directory = open_directory(&map);
  btf_status status = BTF_OK;
  if (directory == NULL)
    status = (file->host->fail)(file->ctx, BTF_E_CORRUPT,
                                "%s: no directory of a zip archive is at its end; it is cut short or damaged",
                                file->path);
  if (status == BTF_OK) status = add_members(file, &source, directory);
  if (directory != NULL) (void)unzClose(directory);
  source_file_close(&source);
  return status == BTF_OK ? check_overlaps(file) : status;
}

static btf_status no_message(btf_context *ctx, btf_status code, const char *format, ...) {
  (void)ctx, (void)format;
  return code;
}

/* Of an archive without directory nobody can tell what is in it, but opening it says what is wrong. */
enum { RIGHT_ARCHIVE = 80, CUT_ARCHIVE = 5 };

uint32_t images_archive_probe(const btf_host *host, btf_context *ctx, const char *path) {
  btf_host silent = *host;
  source_file source;
  char name[IMAGES_NAME_BYTES];
  bool found = false;
  silent.fail = no_message;
  if (source_file_open(&silent, ctx, path, &source) != BTF_OK) return 0;
  mapping map = {&source, 0};
  unzFile directory = open_directory(&map);
  int at = directory != NULL ? unzGoToFirstFile(directory) : UNZ_BADZIPFILE;
  for (int i = 0; i < MOST_PROBED && at == UNZ_OK && !found; i++) {
    uint32_t pair;
    bool differs;
    picture_fault fault;
    unz_file_info64 info;
    if (unzGetCurrentFileInfo64(directory, &info, name, sizeof name, NULL, 0, NULL, 0) != UNZ_OK) break;
    name[sizeof name - 1] = '\0';
    found = images_parse_name(name, &pair, &differs, &fault) == IMAGE_NAME_PAIR;
    at = unzGoToNextFile(directory);
  }
  const uint32_t score = directory == NULL ? CUT_ARCHIVE : found ? RIGHT_ARCHIVE : 0;
  if (directory != NULL) (void)unzClose(directory);
  source_file_close(&source);
  return score;
}
