/* SPDX-License-Identifier: MIT */
/* bytes.c: the bytes of one picture, from the archive or its own file. */
#include <errno.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <zlib.h>

#include "bonn_images/bonn_images.h"

static bool make_room(const images_file *file, unsigned char **data, uint64_t *room, uint64_t wanted) {
  if (wanted <= *room) return true;
  (file->host->free)(file->ctx, *data);
  *room = 0;
  *data = (file->host->alloc)(file->ctx, wanted, 1);
  if (*data != NULL) *room = wanted;
  return *data != NULL;
}

static btf_status read_at(int descriptor, unsigned char *dst, uint64_t size, uint64_t offset,
                          picture_fault *fault) {
  for (uint64_t done = 0; done < size;) {
    const ssize_t got = pread(descriptor, dst + done, size - done, (off_t)(offset + done));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return picture_fail(fault, BTF_E_IO, "could not be read: %s", strerror(errno));
    if (got == 0)
      return picture_fail(fault, BTF_E_TRUNCATED, "ends %llu bytes too early",
                          (unsigned long long)(size - done));
    done += (uint64_t)got;
  }
  return BTF_OK;
}

/* Memory of zlib. */
static voidpf take_room(voidpf user, uInt count, uInt size) {
  const images_file *file = user;
  return (file->host->alloc)(file->ctx, count, size);
}
static void drop_room(voidpf user, voidpf room) {
  const images_file *file = user;
  (file->host->free)(file->ctx, room);
}

static btf_status inflate_bytes(const images_file *file, const image_bytes *packed, uint64_t packed_size,
                                uint64_t wanted, bool whole, unsigned char *dst, picture_fault *fault) {
  z_stream z = {.next_in = packed->packed,
                .avail_in = (uInt)packed_size,
                .next_out = dst,
                .avail_out = (uInt)wanted,
                .zalloc = take_room,
                .zfree = drop_room,
                .opaque = (voidpf)(uintptr_t)file};
  if (inflateInit2(&z, -MAX_WBITS) != Z_OK)
    return picture_fail(fault, BTF_E_NOMEM, "not enough memory to unpack");
  const int got = inflate(&z, whole ? Z_FINISH : Z_SYNC_FLUSH);
  const bool right = whole ? got == Z_STREAM_END && z.avail_out == 0 && z.avail_in == 0
                           : z.avail_out == 0 && (got == Z_OK || got == Z_STREAM_END || got == Z_BUF_ERROR);
  inflateEnd(&z);
  if (got == Z_MEM_ERROR) return picture_fail(fault, BTF_E_NOMEM, "not enough memory to unpack");
  return right ? BTF_OK
               : picture_fail(fault, BTF_E_CORRUPT, "does not unpack to the %llu bytes the archive says",
                              (unsigned long long)wanted);
}

static btf_status fetch_member(const images_file *file, const image_entry *entry, uint64_t most,
                               image_bytes *bytes, picture_fault *fault) {
  const bool whole = most >= entry->size;
  const uint64_t wanted = whole ? entry->size : most;
  /* The worst code of deflate takes nine bits for a byte, and some more for each block. */
  const uint64_t enough = entry->deflated ? wanted + wanted / 8 + 1024 : wanted;
  const uint64_t packed = whole || enough > entry->packed ? entry->packed : enough;
  if (!make_room(file, &bytes->data, &bytes->room, wanted) ||
      (entry->deflated && !make_room(file, &bytes->packed, &bytes->packed_room, packed)))
    return picture_fail(fault, BTF_E_NOMEM, "not enough memory for its %llu bytes",
                        (unsigned long long)wanted);
  bytes->size = wanted;
  unsigned char *raw = entry->deflated ? bytes->packed : bytes->data;
  BTF_TRY(read_at(file->descriptor, raw, packed, entry->offset, fault));
  if (entry->deflated) BTF_TRY(inflate_bytes(file, bytes, packed, wanted, whole, bytes->data, fault));
  if (whole && crc32(0, bytes->data, (uInt)wanted) != entry->crc)
    return picture_fail(fault, BTF_E_CORRUPT, "does not match its checksum in the archive");
  return BTF_OK;
}

static btf_status fetch_file(const images_file *file, const image_entry *entry, uint64_t most,
                             image_bytes *bytes, picture_fault *fault) {
  const int descriptor =
      openat(file->descriptor, images_entry_name(file, entry), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  struct stat info;
  if (descriptor < 0) return picture_fail(fault, BTF_E_IO, "could not be opened: %s", strerror(errno));
  btf_status status = BTF_OK;
  if (fstat(descriptor, &info) != 0 || !S_ISREG(info.st_mode) || (uint64_t)info.st_size != entry->size)
    status = picture_fail(fault, BTF_E_CORRUPT, "changed since the folder was opened");
  bytes->size = most < entry->size ? most : entry->size;
  if (status == BTF_OK && !make_room(file, &bytes->data, &bytes->room, bytes->size))
    status = picture_fail(fault, BTF_E_NOMEM, "not enough memory for its %llu bytes",
                          (unsigned long long)bytes->size);
  if (status == BTF_OK) status = read_at(descriptor, bytes->data, bytes->size, 0, fault);
  close(descriptor);
  return status;
}

btf_status images_fetch(const images_file *file, const image_entry *entry, uint64_t most, image_bytes *bytes,
                        picture_fault *fault) {
  if (entry->size == 0) return picture_fail(fault, BTF_E_CORRUPT, "is empty");
  return file->is_archive ? fetch_member(file, entry, most, bytes, fault)
                          : fetch_file(file, entry, most, bytes, fault);
}

void images_bytes_free(const images_file *file, image_bytes *bytes) {
  (file->host->free)(file->ctx, bytes->packed);
  (file->host->free)(file->ctx, bytes->data);
  *bytes = (image_bytes){0};
}
